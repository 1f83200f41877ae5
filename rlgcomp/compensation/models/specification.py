"""Model specification: the data of a model beyond scikit-learn's contract: its name, its search, its saved numbers.

Every model's file ends with its `SPECIFICATION`; :data:`rlgcomp.compensation.models.MODELS` lists them. The checks of
parameters and arrays that models share stand at the end.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
from sklearn.base import clone

from rlgcomp.errors import InputError

Array = npt.NDArray[np.float64]
Labels = npt.NDArray[Any]
Candidates = Sequence[Mapping[str, Any]]


def refit_residuals(model: Any, candidates: Candidates, X: Array, y: Array, groups: Labels) -> Array:
    """Cross-validation residuals of each candidate, by fitting again without each group.

    Parameters
    ----------
    model : estimator
        Parameters that a candidate does not set are taken from it.
    candidates : sequence of mapping
        Parameters to set.
    X : ndarray, shape (n, features)
    y : ndarray, shape (n,)
    groups : ndarray, shape (n,)
        Label of each row's group.

    Returns
    -------
    ndarray, shape (candidates, n)
    """
    residuals = np.empty((len(candidates), len(y)))
    for k, parameters in enumerate(candidates):
        for label in np.unique(groups):
            out = groups == label
            fitted = clone(model).set_params(**parameters)
            fitted.fit(X[~out], y[~out], **grouping(fitted, groups[~out]))
            residuals[k, out] = y[out] - fitted.predict(X[out])
    return residuals


def cross_validation_residuals(model: Any, X: Array, y: Array, groups: Labels) -> Array:
    """Residuals of a fitted model with each group left out, in closed form where the model has one, otherwise by fitting again.

    Parameters
    ----------
    model : estimator
        Fitted on these rows.
    X : ndarray, shape (n, features)
    y : ndarray, shape (n,)
    groups : ndarray, shape (n,)
        Label of each row's group.

    Returns
    -------
    ndarray, shape (n,)
    """
    if hasattr(model, "leave_groups_out"):
        return np.asarray(model.leave_groups_out(groups))
    return np.asarray(refit_residuals(model, [{}], X, y, groups)[0])


def grouping(model: Any, runs: Labels) -> dict[str, Labels]:
    """How `fit` of this model takes the run of each row: as a sequence, as runs with biases of their own, or not at all."""
    if sequential(model):
        return {"groups": runs}
    return {"runs": runs} if "run_variance" in model.get_params() else {}


def refit_rmse(model: Any, candidates: Candidates, X: Array, y: Array, groups: Labels) -> Array:
    """Root mean square of :func:`refit_residuals`, one a candidate.

    Parameters
    ----------
    model : estimator
    candidates : sequence of mapping
    X : ndarray, shape (n, features)
    y : ndarray, shape (n,)
    groups : ndarray, shape (n,)

    Returns
    -------
    ndarray, shape (candidates,)
    """
    return rms(refit_residuals(model, candidates, X, y, groups))


def between_and_within(residuals: Array, groups: Labels) -> Array:
    """Root mean squares of the groups' mean residuals, and of the residuals about them, shape (candidates, 2)."""
    Z = np.unique(groups, return_inverse=True)[1]
    counts = np.bincount(Z)
    means = residuals @ np.eye(len(counts))[Z] / counts
    between = means**2 @ counts / len(Z)
    return np.sqrt(np.column_stack([between, np.mean((residuals - means[:, Z]) ** 2, axis=1)]))


def rms(residuals: Array) -> Array:
    """Root mean squares of rows."""
    return np.asarray(np.sqrt(np.mean(residuals**2, axis=1)))


def require_regressor(model: Any) -> None:
    """Raise unless a model can be fitted and predicts.

    Raises
    ------
    InputError
        It is a class, or lacks a method.
    """
    if isinstance(model, type) or not (hasattr(model, "fit") and hasattr(model, "predict")):
        raise InputError(
            f"model is {model!r:.100}; it must be a regressor that was made, as rlgcomp.LSSVMRegressor(), or None for that one"
        )


def sequential(model: Any) -> bool:
    """Whether the model reads rows as a sequence, so that `fit` needs the recording that each row belongs to."""
    return bool(getattr(model, "reads_sequences", False))


def parameters_of(model: Any) -> dict[str, Any]:
    """Parameters of an estimator, without the device that computes it, which another machine may not have."""
    return {name: value for name, value in model.get_params().items() if name != "device"}


@dataclasses.dataclass(frozen=True)
class ModelSpecification:
    """A model that can be selected, saved and loaded.

    Parameters
    ----------
    name : str
        As on the command line.
    estimator : type
        The scikit-learn estimator.
    defaults : mapping
        Parameters that make the estimator this model.
    batches : callable
        Number of features to batches of candidates; a batch is scored in one piece of work.
    batches_of : callable, optional
        The same from the model and the number of features, where the candidates depend on the model's own parameters.
    beyond : callable, optional
        Model, number of features, batches and the best candidate to the batches with further candidates beyond the edges of the
        grid, in the same order; the same batches where there are none.
    at_limits : callable, optional
        Model, number of features and the selected parameters to those that lie where the search ends.
    rmse : callable
        Scores a batch: the error of each candidate with groups left out, see :func:`refit_rmse`; or the two parts of that error,
        see :func:`between_and_within`.
    threads : bool
        Whether `rmse` is linear algebra alone, which threads compute in parallel. Other models are scored in processes.
    reach : float
        How far beyond the training range the model extrapolates, in spans of the range; inputs further out are clipped. 0 for a
        model that diverges there, such as a cubic.
    numbers, arrays : tuple of str
        Fitted attributes to save; an array may also be a list of arrays.
    check : callable
        Called with a model that was read from a file and its number of features: raises `InputError` unless its parameters are
        allowed and the shapes of its arrays agree.
    """

    name: str
    estimator: type
    batches: Callable[[int], list[list[dict[str, Any]]]]
    numbers: tuple[str, ...]
    arrays: tuple[str, ...]
    check: Callable[[Any, int], None]
    defaults: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    batches_of: Callable[[Any, int], list[list[dict[str, Any]]]] | None = None
    beyond: Callable[[Any, int, Sequence[Candidates], Mapping[str, Any]], list[list[dict[str, Any]]]] | None = None
    at_limits: Callable[[Any, int, Mapping[str, Any]], dict[str, float]] | None = None
    rmse: Callable[[Any, Candidates, Array, Array, Labels], Array] = refit_rmse
    threads: bool = False
    reach: float = 0.0

    def candidates(self, model: Any, features: int) -> list[list[dict[str, Any]]]:
        """Batches of candidates for this model of so many features."""
        return self.batches(features) if self.batches_of is None else self.batches_of(model, features)

    def make(self) -> Any:
        """An unfitted estimator."""
        return self.estimator(**self.defaults)

    def pack(self, model: Any) -> tuple[dict[str, Any], dict[str, Array]]:
        """A fitted model as plain settings and arrays, for :meth:`unpack`."""
        settings = {"parameters": parameters_of(model), "numbers": {name: float(getattr(model, name)) for name in self.numbers}}
        arrays: dict[str, Array] = {}
        for name in self.arrays:
            value = getattr(model, name)
            if value is None:
                continue
            parts = {f"{name}.{k}": part for k, part in enumerate(value)} if isinstance(value, list) else {name: value}
            arrays |= {key: np.ascontiguousarray(part, dtype=np.float64) for key, part in parts.items()}
        return settings, arrays

    def unpack(self, settings: Mapping[str, Any], arrays: Mapping[str, Array], features: int) -> Any:
        """The fitted model that :meth:`pack` took apart.

        Parameters
        ----------
        settings : mapping
        arrays : mapping of str to ndarray
        features : int
            Number of its inputs.

        Raises
        ------
        InputError
            Something is missing or of the wrong kind.
        """
        try:
            model = self.estimator(**settings["parameters"])
            for name in self.numbers:
                if name in settings["numbers"] or not hasattr(self.estimator, name):  # a default of the class is for earlier files
                    setattr(model, name, finite(settings["numbers"][name], name))
            for name in self.arrays:
                if hasattr(self.estimator, name) and name not in arrays:
                    continue
                listed = sorted((key for key in arrays if key.startswith(f"{name}.")), key=lambda key: int(key.rsplit(".", 1)[1]))
                setattr(model, name, [arrays[key] for key in listed] if listed else arrays[name])
            self.check(model, features)
        except InputError as error:
            raise InputError(f"{self.name} model: {error}") from None
        except (KeyError, TypeError, ValueError) as error:
            raise InputError(f"{self.name} model: {type(error).__name__}: {error}") from None
        model.n_features_in_ = features
        return model


def finite(value: Any, name: str, *, low: float = -math.inf, open_low: bool = False) -> float:
    """A number that was read from a file, as a float.

    Parameters
    ----------
    value : object
    name : str
        For the error.
    low : float
        The smallest number that is allowed.
    open_low : bool
        `low` itself is not allowed.

    Raises
    ------
    InputError
        It is no number, not finite, below `low`, or equal to it where `open_low`.
    """
    number = isinstance(value, int | float) and not isinstance(value, bool) and abs(value) < math.inf
    if not (number and (value > low if open_low else value >= low)):
        bound = "" if low == -math.inf else f"{' above' if open_low else ' from'} {low:g}"
        raise InputError(f"{name} is {str(value)[:40]!r}; it must be a finite number{bound}")
    return float(value)


def require_shape(model: Any, name: str, *shape: int) -> None:
    """Raise unless the model's array has this shape.

    Parameters
    ----------
    model : estimator
    name : str
        Of the attribute.
    *shape : int

    Raises
    ------
    InputError
        It has not.
    """
    received = np.shape(getattr(model, name))
    if received != shape:
        raise InputError(f"{name} has the shape {received}; expected {shape}")


def require_number(
    owner: object, name: str, *, low: float = -math.inf, high: float = math.inf, open_low: bool = False, whole: bool = False
) -> None:
    """Raise unless an estimator's parameter is a number within its bounds, with scikit-learn's sentence.

    Parameters
    ----------
    owner : object
        The estimator.
    name : str
        Of its parameter.
    low, high : float
        The bounds.
    open_low : bool
        The lower bound itself is not allowed.
    whole : bool
        Only whole numbers are allowed.

    Raises
    ------
    InputError
        It is not.
    """
    value: Any = getattr(owner, name)
    kinds = (int, np.integer) if whole else (int, float, np.integer, np.floating)
    number = isinstance(value, kinds) and not isinstance(value, bool) and math.isfinite(value)
    if not (number and (low < value if open_low else low <= value) and value <= high):
        interval = f"{'(' if open_low else '['}{low:g}, {high:g}{')' if high == math.inf else ']'}"
        what = "an int" if whole else "a float"
        raise InputError(
            f"The {name!r} parameter of {type(owner).__name__} must be {what} in the range {interval}. Got {value!r} instead."
        )


def require_choice(owner: object, name: str, choices: tuple[object, ...]) -> None:
    """Raise unless an estimator's parameter is one of the choices.

    Parameters
    ----------
    owner : object
        The estimator.
    name : str
        Of its parameter.
    choices : tuple

    Raises
    ------
    InputError
        It is not.
    """
    value = getattr(owner, name)
    if value not in choices:
        allowed = ", ".join(map(repr, choices))
        raise InputError(f"The {name!r} parameter of {type(owner).__name__} must be one of {allowed}. Got {value!r} instead.")
