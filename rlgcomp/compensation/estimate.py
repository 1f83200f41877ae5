"""The estimate of a fitted model: the bias of rows of inputs, the half width of its interval, and what each input contributes."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any, Final

import numpy as np
import numpy.typing as npt
import pandas as pd

from rlgcomp.compensation.feature_pipeline import FeatureRecipe
from rlgcomp.compensation.interval import Interval, excess
from rlgcomp.compensation.models.specification import sequential
from rlgcomp.compensation.window_means import Scaling
from rlgcomp.recording import Recording

Array = npt.NDArray[np.float64]
_BATCH_ROWS: Final = 2048


@dataclasses.dataclass(frozen=True)
class Estimate:
    """A fitted model with the scaling of its inputs and its interval.

    Parameters
    ----------
    model : estimator
    scaling : Scaling
    interval : Interval
    """

    model: Any
    scaling: Scaling
    interval: Interval

    def bias_deg_h(self, X: Array) -> Array:
        """Bias for unscaled inputs of shape (n, features)."""
        scaled = self.scaling.inputs(X)
        if sequential(self.model):
            values = self.model.predict(scaled)
        else:
            parts = [self.model.predict(scaled[start : start + _BATCH_ROWS]) for start in range(0, len(X), _BATCH_ROWS)]
            values = np.concatenate(parts)
        return np.asarray(self.scaling.y_mean_deg_h + self.scaling.y_scale_deg_h * values)

    def half_width_deg_h(self, X: Array) -> Array:
        """Half width of the interval about the bias for unscaled inputs of shape (n, features)."""
        ranged = self.scaling.ranged
        return self.interval.half_width_deg_h(excess(X[:, ranged], self.scaling.low[ranged], self.scaling.high[ranged]))

    def table(self, X: Array, bias_deg_h: Array | None = None) -> pd.DataFrame:
        """`bias_deg_h`, `out_of_range` and `half_width_deg_h`, one row for each row of unscaled inputs."""
        bias_deg_h = self.bias_deg_h(X) if bias_deg_h is None else bias_deg_h
        return pd.DataFrame(
            {"bias_deg_h": bias_deg_h, "out_of_range": self.scaling.outside(X), "half_width_deg_h": self.half_width_deg_h(X)}
        )

    def of_recording(self, recording: Recording, pipeline: FeatureRecipe, averaging_s: float) -> pd.DataFrame:
        """As :meth:`table`, one row a sample.

        Parameters
        ----------
        recording : Recording
        pipeline : FeatureRecipe
        averaging_s : float
            Of the windows that a sequence model reads: each sample gets the bias of the last full window before it.
        """
        X = pipeline.transform(recording).to_numpy()
        if not sequential(self.model):
            return self.table(X)
        all_samples = recording.replace(metadata=dataclasses.replace(recording.metadata, lead_in_s=0.0))
        columns = [f"feature {name}" for name in pipeline.names]
        averaged = all_samples.averaged(averaging_s, extra=pd.DataFrame(X, columns=columns))
        values = self.bias_deg_h(averaged.table[columns].to_numpy())
        ends = averaged.time_s + 0.5 * averaging_s
        return self.table(X, values[np.maximum(np.searchsorted(ends, recording.time_s, side="right") - 1, 0)])

    def contributions(self, X: Array, names: Sequence[str]) -> pd.DataFrame:
        """Root mean square of the change of the bias where one input alone stays at its mean over training.

        Parameters
        ----------
        X : ndarray, shape (n, features)
            Unscaled.
        names : sequence of str
            Of the inputs.
        """
        bias = self.bias_deg_h(X)
        changes = []
        for k in range(X.shape[1]):
            without = X.copy()
            without[:, k] = self.scaling.mean[k]
            changes.append(float(np.sqrt(np.mean((bias - self.bias_deg_h(without)) ** 2))))
        table = pd.DataFrame({"input": list(names), "rms_deg_h": changes})
        return table.sort_values("rms_deg_h", ascending=False, kind="stable", ignore_index=True)
