"""Window means: the averages of features and gyro that models are trained on, and how they are scaled."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any, Final, Self

import numpy as np
import numpy.typing as npt

from rlgcomp.compensation.feature_pipeline import FeatureRecipe
from rlgcomp.errors import InputError
from rlgcomp.noise.processes import NOISES
from rlgcomp.recording import Recording, rate_name

Array = npt.NDArray[np.float64]
BLOCKS_OF_ONE_RUN: Final = 5
PHYSICS_REACH: Final = 10.0  # spans of its range to which a term of known physics goes on: a cubic at twice the range has four
MARGIN: Final = 0.05  # of the training span, by which an input may exceed it without a flag


@dataclasses.dataclass(frozen=True)
class WindowMeans:
    """Means of one recording over the averaging time.

    Parameters
    ----------
    run : str
    time_s : ndarray, shape (n,)
        Middle of each window.
    X : ndarray, shape (n, features)
    y_deg_h : ndarray, shape (n,)
        Gyro.
    noise_deg_h : ndarray, shape (n,), optional
        Noise of a simulated run, which no compensation can remove.
    other_gyros : mapping of str to ndarray, shape (n,)
        The other gyros of the recording, by their columns.
    """

    run: str
    time_s: Array
    X: Array
    y_deg_h: Array
    noise_deg_h: Array | None = None
    other_gyros: Mapping[str, Array] = dataclasses.field(default_factory=dict)


@dataclasses.dataclass(frozen=True)
class Scaling:
    """Scaling of inputs and output, and the range of the inputs in training.

    Parameters
    ----------
    mean, scale : ndarray, shape (features,)
    low, high : ndarray, shape (features,)
        Range of the training samples, with a margin of 5 %. A sample with an input beyond it is flagged.
    y_mean_deg_h, y_scale_deg_h : float
    reach : float
        Inputs further out than this, in spans of the range, are clipped, so that the output stays bounded for any input.
    linear : tuple of int
        Inputs that are known physics, which holds beyond the range: they are not flagged, and clipped at ten spans.
    """

    mean: Array
    scale: Array
    low: Array
    high: Array
    y_mean_deg_h: float
    y_scale_deg_h: float
    reach: float = 0.0
    linear: tuple[int, ...] = ()

    @classmethod
    def of(cls, training: Sequence[WindowMeans], samples: Sequence[Array], reach: float, linear: tuple[int, ...] = ()) -> Self:
        """Scaling by training windows.

        Parameters
        ----------
        training : sequence of WindowMeans
        samples : sequence of ndarray, shape (samples, features)
            Features of every sample of the training runs, for the range.
        reach : float
            In spans of the range. With known physics it is 0: what is learnt beside it keeps its value at the edge.
        linear : tuple of int
            Inputs that are known physics.
        """
        X = np.vstack([part.X for part in training])
        y = np.concatenate([part.y_deg_h for part in training])
        low = np.min([part.min(axis=0) for part in samples], axis=0)
        high = np.max([part.max(axis=0) for part in samples], axis=0)
        spread = X.std(axis=0)
        return cls(
            mean=X.mean(axis=0),
            scale=np.where(spread > 0.0, spread, 1.0),
            low=low - MARGIN * (high - low),
            high=high + MARGIN * (high - low),
            y_mean_deg_h=float(y.mean()),
            y_scale_deg_h=float(y.std()) or 1.0,
            reach=0.0 if linear else reach,
            linear=linear,
        )

    def inputs(self, X: Array) -> Array:
        """Scaled inputs, clipped to the reach of the training range; shape (n, features) as X."""
        return (np.clip(X, *self.limits()) - self.mean) / self.scale

    def limits(self) -> tuple[Array, Array]:
        """Where inputs are clipped, below and above, shape (features,) each."""
        margin = np.where(self.ranged, self.reach, PHYSICS_REACH) * (self.high - self.low)
        return self.low - margin, self.high + margin

    def outside(self, X: Array) -> npt.NDArray[np.bool_]:
        """Rows with an input beyond the training range, shape (n,)."""
        return np.asarray(((self.low > X) | (self.high < X))[:, self.ranged].any(axis=1))

    @property
    def ranged(self) -> npt.NDArray[np.bool_]:
        """The inputs whose range counts, shape (features,)."""
        return np.isin(np.arange(len(self.mean)), self.linear, invert=True)


def require_averaging(averaging_s: Any) -> None:
    """Raise unless an averaging time is a number above zero.

    Raises
    ------
    InputError
        It is anything else.
    """
    if isinstance(averaging_s, bool) or not isinstance(averaging_s, int | float | np.number) or not 0.0 < averaging_s < np.inf:
        raise InputError(f"averaging_s is {averaging_s!r}; it must be a number of seconds above zero")


def window_means(recording: Recording, pipeline: FeatureRecipe, averaging_s: float, gyro: str | None = None) -> WindowMeans:
    """Means of features and gyro over the scored part of a recording.

    Parameters
    ----------
    recording : Recording
    pipeline : FeatureRecipe
    averaging_s : float
        Length of a window.
    gyro : str, optional
        Gyro column, where there are several.

    Raises
    ------
    InputError
        A monitor is missing or the recording is too short.
    """
    column = rate_name(recording.gyro_column(gyro))
    features = pipeline.transform(recording).add_prefix("feature ")
    averaged = recording.averaged(averaging_s, extra=features)
    truth = averaged.truth
    noises = [] if truth is None else [name for name in NOISES if name in truth]
    return WindowMeans(
        recording.name,
        averaged.time_s,
        averaged.table[list(features.columns)].to_numpy(),
        averaged.column(column),
        truth[noises].to_numpy().sum(axis=1) if truth is not None and noises else None,
        {name: averaged.column(name) for name in averaged.gyro_columns if name != column},
    )


def run_labels(training: Sequence[WindowMeans]) -> npt.NDArray[np.int64]:
    """Number of the run that each training row belongs to."""
    return np.repeat(np.arange(len(training)), [len(part.y_deg_h) for part in training])


def scaled_rows(training: Sequence[WindowMeans], scaling: Scaling) -> tuple[Array, Array, npt.NDArray[np.int64]]:
    """Scaled inputs, scaled output and fold label of every training row: its run, or its block of a single run."""
    X = scaling.inputs(np.vstack([part.X for part in training]))
    y = (np.concatenate([part.y_deg_h for part in training]) - scaling.y_mean_deg_h) / scaling.y_scale_deg_h
    groups = run_labels(training)
    if len(training) == 1:
        groups = np.arange(len(y)) * BLOCKS_OF_ONE_RUN // len(y)
    return X, y, groups
