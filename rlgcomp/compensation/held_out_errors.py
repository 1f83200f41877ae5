"""Errors of a fitted model on its training windows, each with its run left out, and the interval that they give."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any, Self

import numpy as np
import numpy.typing as npt
from sklearn.base import clone

from rlgcomp.compensation.interval import Interval, noise_of_windows_deg_h
from rlgcomp.compensation.models.specification import between_and_within, cross_validation_residuals, grouping, sequential
from rlgcomp.compensation.window_means import Scaling, WindowMeans, run_labels, scaled_rows

Array = npt.NDArray[np.float64]


@dataclasses.dataclass(frozen=True)
class HeldOutErrors:
    """Errors with each run, or block of a single run, left out.

    Parameters
    ----------
    training : sequence of WindowMeans
    errors_deg_h : ndarray, shape (n,)
        Of all training windows.
    groups : ndarray of int, shape (n,)
        Labels of the runs or blocks.
    counted : ndarray of bool, shape (n,)
        The windows that calibrate the interval.
    ranged : ndarray of bool, shape (features,)
        The inputs whose range counts.
    other_gyros : ndarray, shape (gyros, n)
        Errors of the other gyros of the same runs, each in a unit of its own.
    """

    training: Sequence[WindowMeans]
    errors_deg_h: Array
    groups: npt.NDArray[np.int64]
    counted: npt.NDArray[np.bool_]
    ranged: npt.NDArray[np.bool_]
    other_gyros: Array

    @classmethod
    def of(cls, model: Any, training: Sequence[WindowMeans], scaling: Scaling) -> Self:
        """Errors of a fitted model.

        Parameters
        ----------
        model : estimator
            Fitted on the scaled rows.
        training : sequence of WindowMeans
        scaling : Scaling
        """
        X, y, groups = scaled_rows(training, scaling)
        errors = cross_validation_residuals(model, X, y, groups) * scaling.y_scale_deg_h
        return cls(training, errors, groups, np.ones(len(errors), dtype=np.bool_), scaling.ranged, np.empty((0, len(errors))))

    @property
    def about_means_deg_h(self) -> tuple[float, float]:
        """Root mean squares of the gyro and of the errors, each about the mean of every run or block."""
        y_deg_h = np.concatenate([part.y_deg_h for part in self.training])
        before, after = (between_and_within(values[None], self.groups)[0, 1] for values in (y_deg_h, self.errors_deg_h))
        return float(before), float(after)

    def with_other_gyros(self, model: Any, scaling: Scaling) -> Self:
        """With the errors of the same model, fitted to each other gyro that all runs have: they show how runs differ as well.

        Parameters
        ----------
        model : estimator
            Fitted on the scaled rows. One that reads sequences, whose folds take long, is not fitted again.
        scaling : Scaling
        """
        names = set.intersection(*(set(part.other_gyros) for part in self.training))
        if len(self.training) == 1 or sequential(model):
            return self
        X, _, groups = scaled_rows(self.training, scaling)
        errors = []
        for name in sorted(names):
            y = np.concatenate([part.other_gyros[name] for part in self.training])
            if not np.isfinite(y).all() or np.ptp(y) == 0.0:
                continue
            y = (y - y.mean()) / y.std()
            fitted = clone(model).fit(X, y, **grouping(model, run_labels(self.training)))
            errors.append(cross_validation_residuals(fitted, X, y, groups))
        return dataclasses.replace(self, other_gyros=np.array(errors).reshape(len(errors), len(self.errors_deg_h)))

    def zeroed_at_start(self, offset_s: float, averaging_s: float) -> Self:
        """The errors of each run less their mean over so many seconds at its start; later windows alone are counted.

        Parameters
        ----------
        offset_s : float
        averaging_s : float
            Length of a window.
        """
        errors, labels = self.errors_deg_h.copy(), run_labels(self.training)
        later = np.ones(len(errors), dtype=np.bool_)
        for label, part in enumerate(self.training):
            rows = np.flatnonzero(labels == label)
            begin_s = part.time_s[0] - 0.5 * averaging_s
            start = rows[: max(1, int(np.searchsorted(part.time_s, begin_s + offset_s)))]
            errors[rows] -= errors[start].mean()
            later[start] = len(start) == len(rows)
        return dataclasses.replace(self, errors_deg_h=errors, counted=later, other_gyros=np.empty((0, len(errors))))

    def interval(self, turn_on_deg_h: float | None = None) -> Interval:
        """The interval that the counted windows calibrate.

        Parameters
        ----------
        turn_on_deg_h : float, optional
            Stated repeatability from switch-on to switch-on. Of a single run, the standard deviation of its bias by default.
        """
        y_deg_h = [part.y_deg_h for part in self.training]
        assumed = turn_on_deg_h is None and len(self.training) == 1
        if turn_on_deg_h is None:
            turn_on_deg_h = float(np.std(y_deg_h[0])) if assumed else 0.0
        interval = Interval.calibrated(
            self.errors_deg_h[self.counted],
            np.vstack([part.X for part in self.training])[self.counted][:, self.ranged],
            np.concatenate(y_deg_h)[self.counted],
            self.groups[self.counted],
            runs=len(self.training),
            noise_deg_h=noise_of_windows_deg_h(y_deg_h),
            blocks=len(self.training) == 1,
            turn_on_deg_h=turn_on_deg_h,
            other_gyros=self.other_gyros[:, self.counted],
        )
        return dataclasses.replace(interval, basis="assumed") if assumed and interval.basis == "blocks" else interval
