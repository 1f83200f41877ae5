"""What the package must know of a model beyond scikit-learn's contract: its name, what to search over, what to save.

Every model's file ends with its `FORM`; :data:`rlgcomp.compensation.MODELS` lists them.
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
    """Residuals of each candidate with each group left out, by fitting again: shape (candidates, n)."""
    residuals = np.empty((len(candidates), len(y)))
    for k, parameters in enumerate(candidates):
        for label in np.unique(groups):
            out = groups == label
            fitted = clone(model).set_params(**parameters)
            fitted.fit(X[~out], y[~out], **({"groups": groups[~out]} if sequential(model) else {}))
            residuals[k, out] = y[out] - fitted.predict(X[out])
    return residuals


def residuals_left_out(model: Any, X: Array, y: Array, groups: Labels) -> Array:
    """Residuals of a fitted model with each group left out: in closed form where it has one, otherwise by fitting again."""
    if hasattr(model, "leave_groups_out"):
        return np.asarray(model.leave_groups_out(groups))
    return np.asarray(refit_residuals(model, [{}], X, y, groups)[0])


def refit_rmse(model: Any, candidates: Candidates, X: Array, y: Array, groups: Labels) -> Array:
    """Root mean square of :func:`refit_residuals`, one a candidate."""
    return rms(refit_residuals(model, candidates, X, y, groups))


def rms(residuals: Array) -> Array:
    """Root mean squares of rows."""
    return np.asarray(np.sqrt(np.mean(residuals**2, axis=1)))


def sequential(model: Any) -> bool:
    """Whether the model reads rows as a sequence, so that `fit` must be told which recording each belongs to."""
    return bool(getattr(model, "reads_sequences", False))


def parameters_of(model: Any) -> dict[str, Any]:
    """What was set of a model, but for the device it is computed on, which another machine may not have."""
    return {name: value for name, value in model.get_params().items() if name != "device"}


@dataclasses.dataclass(frozen=True)
class ModelForm:
    """A model that can be selected, saved and loaded.

    Parameters
    ----------
    name : str
        As on the command line.
    estimator : type
        The scikit-learn estimator.
    defaults : mapping
        Parameters that make this form of the estimator.
    batches : callable
        Number of features to batches of candidates; a batch is scored in one piece of work.
    rmse : callable
        Scores a batch: the error of each candidate with groups left out; see :func:`refit_rmse`.
    threads : bool
        Whether that is all linear algebra, which threads do side by side; processes, which cost more to start, serve the others.
    reach : float
        How far beyond the training range the model may be asked, in spans of it; further out its inputs are held. 0 for a model
        that diverges there, such as a cubic.
    numbers, arrays : tuple of str
        Fitted attributes to save; an array may also be a list of arrays.
    check : callable
        Given a model that was read from a file and its number of features, raises `InputError` unless its parameters are
        allowed and its arrays fit each other: what is read is not to be trusted.
    """

    name: str
    estimator: type
    batches: Callable[[int], list[list[dict[str, Any]]]]
    numbers: tuple[str, ...]
    arrays: tuple[str, ...]
    check: Callable[[Any, int], None]
    defaults: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    rmse: Callable[[Any, Candidates, Array, Array, Labels], Array] = refit_rmse
    threads: bool = False
    reach: float = 0.0

    def make(self) -> Any:
        """An unfitted estimator."""
        return self.estimator(**self.defaults)

    def pack(self, model: Any) -> tuple[dict[str, Any], dict[str, Array]]:
        """A fitted model as plain settings and arrays."""
        settings = {"parameters": parameters_of(model), "numbers": {name: float(getattr(model, name)) for name in self.numbers}}
        arrays: dict[str, Array] = {}
        for name in self.arrays:
            value = getattr(model, name)
            parts = {f"{name}.{k}": part for k, part in enumerate(value)} if isinstance(value, list) else {name: value}
            arrays |= {key: np.ascontiguousarray(part, dtype=np.float64) for key, part in parts.items()}
        return settings, arrays

    def unpack(self, settings: Mapping[str, Any], arrays: Mapping[str, Array], features: int) -> Any:
        """The fitted model of so many features back from :meth:`pack`.

        Raises
        ------
        InputError
            Something is missing or of the wrong kind.
        """
        try:
            model = self.estimator(**settings["parameters"])
            for name in self.numbers:
                setattr(model, name, finite(settings["numbers"][name], name))
            for name in self.arrays:
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
    """A number that was read from a file.

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

    Raises
    ------
    InputError
        It has not.
    """
    found = np.shape(getattr(model, name))
    if found != shape:
        raise InputError(f"{name} has the shape {found}; expected {shape}")
