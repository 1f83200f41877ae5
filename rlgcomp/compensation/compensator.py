"""The compensator: features, scaling, model and range guard, from recordings to corrected recordings."""

from __future__ import annotations

import dataclasses
import logging
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple, Self

import numpy as np
import numpy.typing as npt
import pandas as pd
from sklearn.base import clone

from rlgcomp.compensation import MODELS
from rlgcomp.compensation.cubic import DYNAMICS
from rlgcomp.compensation.form import ModelForm, sequential
from rlgcomp.compensation.lssvm import LSSVMRegressor
from rlgcomp.compensation.selection import Progress, Selection, select
from rlgcomp.errors import InputError
from rlgcomp.features import FeatureRecipe, recipe_for
from rlgcomp.noise import NOISES
from rlgcomp.recording import DEFAULT_AVERAGING_S, Recording, rate_name
from rlgcomp.units import EARTH_RATE_DEG_H

Array = npt.NDArray[np.float64]
logger = logging.getLogger(__name__)
MARGIN: Final = 0.05  # of the training span, by which an input may leave it unflagged
BLOCKS_OF_ONE_RUN: Final = 5
_ROWS_AT_ONCE: Final = 2048
_MUCH_OF_EARTH_RATE: Final = 0.1


class Correction(NamedTuple):
    """What the compensator says of one sample."""

    bias_deg_h: float
    out_of_range: bool


@dataclasses.dataclass(frozen=True)
class Rows:
    """Averages of one recording, as models see them.

    Parameters
    ----------
    run : str
    time_s : ndarray, shape (n,)
        Middle of each window.
    X : ndarray, shape (n, features)
    y_deg_h : ndarray, shape (n,)
        Gyro.
    noise_deg_h : ndarray, shape (n,), optional
        Of a simulated run: what no compensation can remove.
    """

    run: str
    time_s: Array
    X: Array
    y_deg_h: Array
    noise_deg_h: Array | None = None


@dataclasses.dataclass(frozen=True)
class Scaling:
    """How inputs and output are scaled, and where the inputs have been.

    Parameters
    ----------
    mean, scale : ndarray, shape (features,)
    low, high : ndarray, shape (features,)
        Range of the training samples, a margin of 5 % included. A sample with an input beyond it is flagged.
    reach : float
        An input further out than this, in spans of the range, is held there, so that the output stays bounded whatever comes in.
    y_mean_deg_h, y_scale_deg_h : float
    """

    mean: Array
    scale: Array
    low: Array
    high: Array
    y_mean_deg_h: float
    y_scale_deg_h: float
    reach: float = 0.0

    def inputs(self, X: Array) -> Array:
        """Scaled inputs, held within reach of the training range."""
        beyond = self.reach * (self.high - self.low)
        return (np.clip(X, self.low - beyond, self.high + beyond) - self.mean) / self.scale

    def outside(self, X: Array) -> npt.NDArray[np.bool_]:
        """Rows with an input beyond the training range."""
        return np.asarray(((self.low > X) | (self.high < X)).any(axis=1))


class Compensator:
    """Bias compensation of one gyro.

    Parameters
    ----------
    model : estimator, optional
        A scikit-learn regressor; by default :class:`~rlgcomp.LSSVMRegressor`.
    features : str or sequence of str
        "all", groups such as "temperature,temperature_rate", or further columns; see :func:`rlgcomp.features.recipe_for`.
    averaging_s : float
        The model is trained on means over this time.
    gyro : str, optional
        Gyro column, where there are several.
    keep_mean : bool
        Remove only how the bias differs from its mean over training: for runs whose gyro still holds Earth rate.
    n_jobs : int
        Worker processes of the selection.

    Attributes
    ----------
    form_ : ModelForm or None
        How the model is selected and saved; None for a regressor of the user's own.
    recipe_ : FeatureRecipe
    scaling_ : Scaling
    model_ : estimator
        Fitted with the selected parameters.
    selection_ : Selection
    training_ : tuple of Rows
        What it was trained on.
    provenance_ : list of dict
        Where the training runs came from.

    Examples
    --------
    >>> import rlgcomp as rlg
    >>> runs = [rlg.simulated_unit(1).simulate("short", seed=seed) for seed in (1, 2)]
    >>> model = rlg.Compensator(rlg.CubicLeastSquares(), features="temperature").fit(runs)
    >>> model.correct(runs[0]).columns[:4]
    ('time_s', 'gyro_deg_h', 'compensation_deg_h', 'compensation_out_of_range')
    """

    def __init__(
        self,
        model: Any = None,
        *,
        features: str | Sequence[str] = "all",
        averaging_s: float = DEFAULT_AVERAGING_S,
        gyro: str | None = None,
        keep_mean: bool = False,
        n_jobs: int = 1,
    ) -> None:
        self.model = LSSVMRegressor() if model is None else model
        self.features = features
        self.averaging_s = averaging_s
        self.gyro = gyro
        self.keep_mean = keep_mean
        self.n_jobs = n_jobs
        self._state: Any = None

    # --- training ----------------------------------------------------------------------------------------------------------

    def fit(self, runs: Sequence[Recording], *, journal: Path | None = None, progress: Progress | None = None) -> Self:
        """Select parameters by leaving runs out, then fit on all of them.

        Parameters
        ----------
        runs : sequence of Recording
            With a single run, five contiguous blocks take the place of runs.
        journal : path, optional
            Where the selection keeps finished work; see :mod:`rlgcomp.compensation.selection`.
        progress : callable, optional
            Called with (done, total).

        Raises
        ------
        InputError
            A run is too short, lacks a monitor, or its gyro cannot be told.
        """
        if not runs:
            raise InputError("no runs to train on; give at least one recording")
        self.recipe_ = recipe_for(runs, self.features)
        samples = [self.recipe_.transform(run).to_numpy()[run.scored] for run in runs]
        self.training_ = tuple(rows(run, self.recipe_, self.averaging_s, self.gyro) for run in runs)
        self.gyro_ = runs[0].gyro_column(self.gyro)
        self.form_ = form_of(self.model)
        self.scaling_ = _scaling(
            np.vstack([part.X for part in self.training_]),
            np.concatenate([part.y_deg_h for part in self.training_]),
            samples,
            reach=0.0 if self.form_ is None else self.form_.reach,
        )
        self._warn_of_earth_rate(runs)
        X, y, groups = self.training_rows()
        if len(runs) == 1:
            logger.warning(
                "one run only: parameters are selected on %d blocks of it; expect less on another programme", BLOCKS_OF_ONE_RUN
            )
        model = clone(self.model)
        if model.get_params().get("linear") == DYNAMICS:
            model.set_params(linear=self.recipe_.dynamic)
        self.selection_ = (
            Selection({}, None, pd.DataFrame())
            if self.form_ is None
            else select(self.form_, model, X, y, groups, journal=journal, n_jobs=self.n_jobs, progress=progress)
        )
        self.model_ = model.set_params(**self.selection_.best)
        self.model_.fit(X, y, **({"groups": self.run_labels()} if sequential(self.model_) else {}))
        self.provenance_ = [
            {"run": run.name, **run.metadata.to_mapping(), "rows": len(run), "hours": run.duration_s / 3600.0} for run in runs
        ]
        self.restart()
        return self

    def training_rows(self) -> tuple[Array, Array, npt.NDArray[np.int64]]:
        """Scaled inputs, scaled output and fold label of every training row."""
        X = self.scaling_.inputs(np.vstack([part.X for part in self.training_]))
        y = (np.concatenate([part.y_deg_h for part in self.training_]) - self.scaling_.y_mean_deg_h) / self.scaling_.y_scale_deg_h
        groups = self.run_labels()
        if len(self.training_) == 1:
            groups = np.arange(len(y)) * BLOCKS_OF_ONE_RUN // len(y)
        return X, y, groups

    def run_labels(self) -> npt.NDArray[np.int64]:
        """Number of the run that each training row belongs to."""
        return np.repeat(np.arange(len(self.training_)), [len(part.y_deg_h) for part in self.training_])

    # --- using it ----------------------------------------------------------------------------------------------------------

    def predict(self, recording: Recording) -> pd.DataFrame:
        """Bias of every sample.

        Parameters
        ----------
        recording : Recording

        Returns
        -------
        pandas.DataFrame
            `bias_deg_h` and `out_of_range`, one row a sample.
        """
        self._require_fitted()
        X = self.recipe_.transform(recording).to_numpy()
        bias = self._by_windows(recording, X) if sequential(self.model_) else self.predict_rows(X)
        return pd.DataFrame({"bias_deg_h": bias, "out_of_range": self.scaling_.outside(X)})

    def correct(self, recording: Recording) -> Recording:
        """The recording with its bias removed.

        The gyro comes out as a rate (pulses become deg/h); `compensation_deg_h` holds what was subtracted and
        `compensation_out_of_range` is 1 where an input lay beyond the training range.
        """
        predicted = self.predict(recording)
        removed = predicted["bias_deg_h"].to_numpy() - self.reference_deg_h
        column = recording.gyro_column(self.gyro)
        table = recording.table
        if column.endswith("_deg_s"):
            corrected, name = recording.column(column) - removed / 3600.0, column
        else:
            corrected, name = recording.rate_deg_h(column) - removed, rate_name(column)
        place = list(table.columns).index(column)
        table = table.drop(columns=[column, *(extra for extra in table.columns if extra.startswith("compensation_"))])
        table.insert(place, name, corrected)
        table.insert(place + 1, "compensation_deg_h", removed)
        table.insert(place + 2, "compensation_out_of_range", predicted["out_of_range"].to_numpy().astype(np.float64))
        return recording.replace(table=table)

    def step(self, sample: Mapping[str, float]) -> Correction:
        """Bias of one sample, as a real-time box computes it; :meth:`restart` begins a new recording.

        Raises
        ------
        InputError
            A monitor is missing, or the model reads sequences of averages and has no sample-by-sample form.
        """
        self._require_fitted()
        if sequential(self.model_):
            raise InputError("a sequence model answers once an averaging time, not sample by sample; use predict, or another model")
        values, self._state = self.recipe_.step(self._state, sample)
        X = values[None, :]
        return Correction(float(self.predict_rows(X)[0]), bool(self.scaling_.outside(X)[0]))

    def restart(self) -> None:
        """Forget what :meth:`step` has seen."""
        self._state = None

    def predict_rows(self, X: Array) -> Array:
        """Bias in deg/h for unscaled inputs, shape (n, features)."""
        scaled = self.scaling_.inputs(X)
        if sequential(self.model_):
            values = self.model_.predict(scaled)
        else:
            parts = [self.model_.predict(scaled[start : start + _ROWS_AT_ONCE]) for start in range(0, len(X), _ROWS_AT_ONCE)]
            values = np.concatenate(parts)
        return np.asarray(self.scaling_.y_mean_deg_h + self.scaling_.y_scale_deg_h * values)

    @property
    def reference_deg_h(self) -> float:
        """What is left in the corrected gyro when nothing differs from training."""
        return self.scaling_.y_mean_deg_h if self.keep_mean else 0.0

    # --- keeping it --------------------------------------------------------------------------------------------------------

    def save(self, path: str | Path) -> None:
        """Write the artefact, a folder of JSON and arrays; see :mod:`rlgcomp.compensation.artefact`."""
        from rlgcomp.compensation.artefact import save

        self._require_fitted()
        save(self, path)

    # --- inside ------------------------------------------------------------------------------------------------------------

    def _by_windows(self, recording: Recording, X: Array) -> Array:
        """For a model of averages: each sample gets what the last full window before it gave."""
        everything = recording.replace(metadata=dataclasses.replace(recording.metadata, lead_in_s=0.0))
        averaged = everything.averaged(
            self.averaging_s, extra=pd.DataFrame(X, columns=[f"feature {name}" for name in self.recipe_.names])
        )
        values = self.predict_rows(averaged.table[[f"feature {name}" for name in self.recipe_.names]].to_numpy())
        ends = averaged.time_s + 0.5 * self.averaging_s
        return np.asarray(values[np.maximum(np.searchsorted(ends, recording.time_s, side="right") - 1, 0)])

    def _require_fitted(self) -> None:
        if not hasattr(self, "model_"):
            raise InputError("this Compensator is not fitted yet; call .fit(runs), or load one with rlgcomp.load")

    def _warn_of_earth_rate(self, runs: Sequence[Recording]) -> None:
        mean = self.scaling_.y_mean_deg_h
        if not self.keep_mean and abs(mean) > _MUCH_OF_EARTH_RATE * EARTH_RATE_DEG_H and runs[0].metadata.kind != "turntable":
            logger.warning(
                "the mean of the training runs is %.4g deg/h, which may hold Earth rate; it is subtracted with the bias. "
                "Use --keep-mean to keep it",
                mean,
            )


def form_of(model: Any) -> ModelForm | None:
    """The form that selects and saves this model, or None for a regressor of the user's own."""
    fitting = [form for form in MODELS.values() if form.estimator is type(model)]
    exact = [form for form in fitting if all(model.get_params().get(key) == value for key, value in form.defaults.items())]
    return max(exact or fitting, key=lambda form: len(form.defaults), default=None)


def rows(recording: Recording, recipe: FeatureRecipe, averaging_s: float, gyro: str | None = None) -> Rows:
    """Averages of features and gyro over the scored part of a recording.

    Raises
    ------
    InputError
        A monitor is missing or the recording is too short.
    """
    column = rate_name(recording.gyro_column(gyro))
    prefixed = recipe.transform(recording).add_prefix("feature ")
    averaged = recording.averaged(averaging_s, extra=prefixed)
    truth = averaged.truth
    noises = [] if truth is None else [name for name in NOISES if name in truth]
    return Rows(
        recording.name,
        averaged.time_s,
        averaged.table[list(prefixed.columns)].to_numpy(),
        averaged.column(column),
        truth[noises].to_numpy().sum(axis=1) if truth is not None and noises else None,
    )


def _scaling(X: Array, y: Array, samples: Sequence[Array], reach: float) -> Scaling:
    low = np.min([part.min(axis=0) for part in samples], axis=0)
    high = np.max([part.max(axis=0) for part in samples], axis=0)
    spread = X.std(axis=0)
    return Scaling(
        mean=X.mean(axis=0),
        scale=np.where(spread > 0.0, spread, 1.0),
        low=low - MARGIN * (high - low),
        high=high + MARGIN * (high - low),
        y_mean_deg_h=float(y.mean()),
        y_scale_deg_h=float(y.std()) or 1.0,
        reach=reach,
    )
