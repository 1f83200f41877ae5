"""The bias that a fitted compensation predicts: of a recording, of samples as they come, of rows of inputs."""

from __future__ import annotations

import abc
from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd

from rlgcomp.compensation.correction import Correction, corrected_table, require_raw
from rlgcomp.compensation.estimate import Estimate
from rlgcomp.compensation.feature_pipeline import FeatureRecipe
from rlgcomp.compensation.held_out_errors import HeldOutErrors
from rlgcomp.compensation.interval import Interval
from rlgcomp.compensation.models.specification import sequential
from rlgcomp.compensation.start_offset import StartOffset
from rlgcomp.compensation.window_means import Scaling, WindowMeans
from rlgcomp.errors import InputError
from rlgcomp.recording import TIME, Recording
from rlgcomp.recording.argument_checks import require_recording

Array = npt.NDArray[np.float64]


class Prediction(abc.ABC):
    """What a :class:`~rlgcomp.Compensator`, which sets these attributes, does once it is fitted."""

    averaging_s: float
    gyro: str | None
    keep_mean: bool
    pipeline_: FeatureRecipe
    scaling_: Scaling
    model_: Any
    interval_: Interval
    training_: tuple[WindowMeans, ...]
    _state: Any = None  # of the features, between calls of `step`
    _offset_interval: tuple[float, Interval, Interval] | None = None  # the last that was calibrated, and the one it narrows

    def predict(self, recording: Recording, *, offset_s: float | None = None) -> pd.DataFrame:
        """Bias of every sample.

        Parameters
        ----------
        recording : Recording or table
            A table as :func:`rlgcomp.recording` takes it.
        offset_s : float, optional
            Zero the offset of this run by its gyro over so many seconds at its start; see
            :mod:`rlgcomp.compensation.start_offset`.

        Returns
        -------
        pandas.DataFrame
            `bias_deg_h`, `out_of_range` and `half_width_deg_h`, one row a sample.
        """
        self.require_fitted()
        recording = require_recording(recording, "recording")
        predicted = self._estimate.of_recording(recording, self.pipeline_, self.averaging_s)
        if offset_s is None:
            return predicted
        offset, scored = StartOffset(offset_s), recording.scored
        zeroed = self.zeroed(offset, recording.time_s[scored], recording.rate_deg_h(self.gyro)[scored], predicted[scored])
        return pd.concat([predicted[~scored], zeroed]).sort_index()

    def zeroed(self, offset: StartOffset, time_s: Array, rate_deg_h: Array, predicted: pd.DataFrame) -> pd.DataFrame:
        """Predictions of consecutive samples with the offset of their run, and its interval once the start is over.

        Parameters
        ----------
        offset : StartOffset
            Its state goes on from sample to sample.
        time_s, rate_deg_h : ndarray, shape (n,)
        predicted : pandas.DataFrame
            As :meth:`steps` returns it.
        """
        bias = predicted["bias_deg_h"].to_numpy()
        offsets, over = offset.run(time_s, rate_deg_h - bias)
        narrower = self.offset_interval(offset.duration_s).inside_deg_h - self.interval_.inside_deg_h
        half_width = predicted["half_width_deg_h"].to_numpy() + np.where(over, narrower, 0.0)
        return predicted.assign(bias_deg_h=bias + offsets, half_width_deg_h=half_width)

    def correct(self, recording: Recording, *, offset_s: float | None = None) -> Recording:
        """The recording with its bias removed.

        The gyro comes out as a rate (pulses become deg/h); `compensation_deg_h` holds what was subtracted and
        `compensation_out_of_range` is 1 where an input lay beyond the training range. 90 % of the
        corrected gyro's means over the averaging time lie within `compensation_half_width_deg_h` of zero.

        Parameters
        ----------
        recording : Recording or table
            A table as :func:`rlgcomp.recording` takes it.
        offset_s : float, optional
            As for :meth:`predict`.

        Raises
        ------
        InputError
            It was corrected already, lacks a monitor, or is no recording.
        """
        recording = require_recording(recording, "recording")
        require_raw(recording.name, recording.columns)
        column = recording.gyro_column(self.gyro)
        rate_deg_h, predicted = recording.rate_deg_h(column), self.predict(recording, offset_s=offset_s)
        table = corrected_table(recording.table, column, rate_deg_h, predicted, reference_deg_h=self.reference_deg_h)
        return recording.replace(table=table)

    def step(self, sample: Mapping[str, float]) -> Correction:
        """Bias of one sample, as a real-time box computes it; :meth:`restart` begins a new recording.

        Every model of the package gives the bits that :meth:`predict` gives for the whole recording.

        Parameters
        ----------
        sample : mapping of str to float
            `time_s` and the monitors; other entries are ignored.

        Raises
        ------
        InputError
            A monitor is missing or not finite, a feature is undefined, time does not increase, or the model reads sequences of
            averages and has no sample-by-sample form. The state is not changed then.
        """
        self._require_steps()
        values, self._state = self.pipeline_.step(self._state, sample)
        X = values[None, :]
        return Correction(float(self.predict_rows(X)[0]), bool(self.scaling_.outside(X)[0]), float(self.half_widths(X)[0]))

    def steps(self, samples: pd.DataFrame) -> pd.DataFrame:
        """Bias of the next samples, with the same bits as :meth:`step` for each.

        Parameters
        ----------
        samples : pandas.DataFrame
            `time_s`, increasing and after that of the last sample, and the monitors, all finite.

        Returns
        -------
        pandas.DataFrame
            As :meth:`predict` returns it.
        """
        self._require_steps()
        time_s, monitors = (
            samples[TIME].to_numpy(dtype=np.float64),
            samples[list(self.pipeline_.columns)].to_numpy(dtype=np.float64),
        )
        X, self._state = self.pipeline_.run(self._state, time_s, monitors)
        return self._estimate.table(X)

    def restart(self) -> None:
        """Begin a new recording for :meth:`step` and :meth:`steps`."""
        self._state = None

    def predict_rows(self, X: Array) -> Array:
        """Bias in deg/h for unscaled inputs, shape (n, features)."""
        return self._estimate.bias_deg_h(X)

    def half_widths(self, X: Array) -> Array:
        """Half width of the interval about the bias in deg/h, for unscaled inputs, shape (n, features)."""
        return self._estimate.half_width_deg_h(X)

    @property
    def reference_deg_h(self) -> float:
        """Mean of the corrected gyro under the conditions of training."""
        return self.scaling_.y_mean_deg_h if self.keep_mean else 0.0

    def offset_interval(self, offset_s: float) -> Interval:
        """The interval of a run whose offset is zeroed over so many seconds at its start, from runs left out and zeroed alike."""
        known = self._offset_interval
        if known is None or known[0] != offset_s or known[1] is not self.interval_:
            errors = HeldOutErrors.of(self.model_, self.training_, self.scaling_).zeroed_at_start(offset_s, self.averaging_s)
            known = self._offset_interval = offset_s, self.interval_, errors.interval(0.0)
        return known[2]

    @property
    def _estimate(self) -> Estimate:
        return Estimate(self.model_, self.scaling_, self.interval_)

    def _require_steps(self) -> None:
        self.require_fitted()
        if sequential(self.model_):
            raise InputError("a sequence model answers once an averaging time, not sample by sample; use predict, or another model")

    def require_fitted(self) -> None:
        """Raise `InputError` unless it is fitted."""
        if not hasattr(self, "model_"):
            raise InputError("this Compensator is not fitted yet; call .fit(runs), or load one with rlgcomp.load")
