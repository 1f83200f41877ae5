"""Runs before and after: how far the simulator is off them, window by window, and how its clock stands against theirs."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np
import numpy.typing as npt
import pandas as pd

from rlgcomp.diagnosis.result.findings import Estimate
from rlgcomp.physics.mechanism import Mechanism

Array = npt.NDArray[np.float64]
_WORSE: Final = 1.05  # times as far off


@dataclasses.dataclass(frozen=True)
class RunFit:
    """One run before and after.

    Parameters
    ----------
    run : str
    baseline_rms, augmented_rms, noise_floor_rms : float
        Of window means, a constant offset of the run included.
    baseline_std, augmented_std : float
        About the run's own mean, which a gyro changes from switch-on to switch-on.
    improvement : float
        1 - augmented / baseline, of the rms.
    improvement_ci95 : tuple of float
        By circular block bootstrap.
    compensation_rms : float, optional
        That the black box leaves.
    """

    run: str
    baseline_rms: float
    augmented_rms: float
    noise_floor_rms: float
    baseline_std: float
    augmented_std: float
    improvement: float
    improvement_ci95: tuple[float, float]
    compensation_rms: float | None = None


@dataclasses.dataclass(frozen=True)
class Fit:
    """A set of runs before and after.

    Parameters
    ----------
    baseline_rms, augmented_rms : float
        Of window means of what the calibrated and the augmented simulator leave, a constant offset of each run included.
    noise_floor_rms : float
        What the noise model alone would leave in window means, its correlated part included.
    unit : str
    averaging_s : float
    improvement : float
        1 - augmented / baseline.
    improvement_ci95 : tuple of float
        By circular block bootstrap within runs.
    per_run : tuple of RunFit
    compensation_rms : float, optional
        What an LS-SVM leaves that was trained on the same training runs.
    baseline_std, augmented_std, compensation_std : float, optional
        The same about each run's own mean: what counts where a gyro's bias changes from switch-on to switch-on.
    improvement_std, improvement_std_ci95 : optional
        Improvement about each run's own mean.
    white_floor_rms : float, optional
        Of the white part of the noise alone.
    whiteness_p_value : float, optional
        That what the augmented simulator leaves is nothing but the noise of its model.
    """

    baseline_rms: float
    augmented_rms: float
    noise_floor_rms: float
    unit: str
    averaging_s: float
    improvement: float
    improvement_ci95: tuple[float, float]
    per_run: tuple[RunFit, ...] = ()
    compensation_rms: float | None = None
    baseline_std: float | None = None
    augmented_std: float | None = None
    compensation_std: float | None = None
    improvement_std: float | None = None
    improvement_std_ci95: tuple[float, float] | None = None
    white_floor_rms: float | None = None
    whiteness_p_value: float | None = None

    @property
    def worsened(self) -> bool:
        """Whether what was added makes these runs worse for certain, and not by an offset of each run's own."""
        about_own_means = self.improvement_std_ci95 or self.improvement_ci95
        certain = max(self.improvement_ci95[1], about_own_means[1]) < 0.0
        return certain and self.augmented_rms > _WORSE * self.baseline_rms

    @property
    def gains_nothing(self) -> bool:
        """Whether what was added makes these runs worse for certain, and no better about their own means."""
        about_own_means = self.improvement if self.improvement_std is None else self.improvement_std
        return self.improvement_ci95[1] < 0.0 >= about_own_means


@dataclasses.dataclass(frozen=True)
class Trace:
    """Window means of one run, for pictures.

    Parameters
    ----------
    run : str
    held_out : bool
    time_s : ndarray, shape (n,)
        Middle of each window.
    before_deg_h, after_deg_h : ndarray, shape (n,)
        What the calibrated and the augmented simulator leave.
    compensation_deg_h : ndarray, shape (n,), optional
        What the black box leaves.
    monitors : pandas.DataFrame
        Window means of the recorded columns that are no gyro.
    added_deg_h : mapping of str to ndarray, shape (n,)
        What each mechanism contributes that the augmented simulator has and the calibrated one lacks.
    channel : str
        Gyro column.
    unit : str
        Serial number of the gyro, where the recording says it.
    """

    run: str
    held_out: bool
    time_s: Array
    before_deg_h: Array
    after_deg_h: Array
    compensation_deg_h: Array | None
    monitors: pd.DataFrame
    added_deg_h: Mapping[str, Array]
    channel: str
    unit: str = ""


@dataclasses.dataclass(frozen=True)
class Alignment:
    """How the clock of the user's simulation of one run stands against that of the recording.

    Parameters
    ----------
    run : str
    offset_s, offset_sd_s : float
        The recording shows at time t what the simulation shows at t - epoch - offset - drift · (t - start).
    drift_ppm, drift_ppm_sd : float
    p_value : float
        That there is neither offset nor drift.
    compared : str
        The column both were compared in.
    epoch_s : float
        What was added to the simulation's time beforehand, because the two did not count from one epoch.
    taken_out : bool
        Offset and drift were taken out: they are significant, and nothing else explains them.
    together : bool
        The gyro of all runs together told the offset; one run's does not.
    """

    run: str
    offset_s: float
    offset_sd_s: float
    drift_ppm: float
    drift_ppm_sd: float
    p_value: float
    compared: str
    epoch_s: float = 0.0
    taken_out: bool = True
    together: bool = False

    @property
    def offset(self) -> Estimate:
        return Estimate(self.offset_s, self.offset_sd_s, "s")

    @property
    def drift(self) -> Estimate:
        return Estimate(self.drift_ppm, self.drift_ppm_sd, "ppm")


def contradicted(test: Fit | None, named: Sequence[Mechanism]) -> bool:
    """Whether held-out runs deny what is named: some of it should repeat there, and with all of it they are surely worse."""
    return test is not None and test.worsened and any(mechanism.repeats() for mechanism in named)
