"""Rows: the averages that models are trained on, and how they are scaled."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Final, Self

import numpy as np
import numpy.typing as npt

from rlgcomp.compensation.feature_pipeline import FeatureRecipe
from rlgcomp.noise.processes import NOISES
from rlgcomp.recording import Recording, rate_name

Array = npt.NDArray[np.float64]
MARGIN: Final = 0.05  # of the training span, by which an input may leave it unflagged


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

    @classmethod
    def of(cls, training: Sequence[Rows], samples: Sequence[Array], reach: float) -> Self:
        """Scaling of training rows, and the range of the samples that they are means of."""
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
            reach=reach,
        )

    def inputs(self, X: Array) -> Array:
        """Scaled inputs, held within reach of the training range."""
        beyond = self.reach * (self.high - self.low)
        return (np.clip(X, self.low - beyond, self.high + beyond) - self.mean) / self.scale

    def outside(self, X: Array) -> npt.NDArray[np.bool_]:
        """Rows with an input beyond the training range."""
        return np.asarray(((self.low > X) | (self.high < X)).any(axis=1))


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
