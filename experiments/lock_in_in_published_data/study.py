"""Naming what the linear scale factor lacks, the lock-in rate power-up by power-up, and what lock-in leaves."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
import pandas as pd

import rlgcomp as rlg
from experiments.lock_in_in_published_data.recordings import recording, table_3
from rlgcomp.calibration.rate_dependence import RateTable, fit_lock_in
from rlgcomp.calibration.scale_factor import sd_of_mean
from rlgcomp.diagnosis.explain import Explanations, explain, fitted
from rlgcomp.diagnosis.problem import Problem
from rlgcomp.physics.lock_in import LockIn
from rlgcomp.physics.mechanism import Mechanism
from rlgcomp.physics.scale_factor import ScaleFactor
from rlgcomp.units import PPM, SECONDS_PER_HOUR

Array = npt.NDArray[np.float64]
TRAINED, HELD_OUT = (0, 1, 2), (3, 4)
SIMULATOR = rlg.Simulator.from_mapping({"kind": "turntable", "mechanisms": ["scale_factor"]})
HUMP_DEG_S = (3.0, 12.0)
_OWN = len(ScaleFactor().amplitude_parameters())


@dataclasses.dataclass(frozen=True)
class Fit:
    """One set of mechanisms fitted to each power-up by itself, every value alike in deg/h.

    Parameters
    ----------
    members : tuple of Mechanism
        Beside the scale factor; lock-in among them.
    lock_in_deg_s : ndarray, shape (runs,)
    left_ppm : ndarray, shape (rates, runs)
    """

    members: tuple[Mechanism, ...]
    lock_in_deg_s: Array
    left_ppm: Array

    @property
    def rate_deg_s(self) -> tuple[float, float]:
        """Mean over the power-ups and its standard error."""
        return float(self.lock_in_deg_s.mean()), sd_of_mean(pd.Series(self.lock_in_deg_s))

    @property
    def left(self) -> tuple[Array, Array]:
        """Mean over the power-ups at each rate and its standard error, ppm."""
        runs = self.left_ppm.shape[1]
        return self.left_ppm.mean(axis=1), self.left_ppm.std(axis=1, ddof=1) / math.sqrt(runs)


def named(power_ups: Sequence[int] = TRAINED) -> tuple[Problem, Explanations]:
    """What the simulator with a linear scale factor lacks in these power-ups."""
    problem = Problem.of(SIMULATOR, [recording(table_3(), power_ups, "training power-ups")])
    return problem, explain(problem, rlg.CATALOGUE)


def members_of(explanations: Explanations, place: int) -> tuple[Mechanism, ...]:
    """The mechanisms of one of the sets."""
    return fitted(explanations.evidence, explanations.models[place].members)


def held_out_rms_deg_h(members: Sequence[Mechanism]) -> float:
    """Rms of the held-out power-ups less what was fitted to the training ones."""
    design, target = zip(*(_system(recording(table_3(), runs, "runs"), members) for runs in (TRAINED, HELD_OUT)), strict=True)
    found = np.linalg.lstsq(design[0], target[0], rcond=None)[0]
    return float(np.sqrt(np.mean((target[1] - design[1] @ found) ** 2)))


def fit_each(table: RateTable, members: Sequence[Mechanism]) -> Fit:
    """Fit a set of mechanisms to every power-up by itself."""
    rates, left = [], []
    for power_up in range(table.error_ppm.shape[1]):
        run = recording(table, [power_up], f"power-up {power_up + 1}")
        design, target = _system(run, members)
        found = np.linalg.lstsq(design, target, rcond=None)[0]
        for place, member in enumerate(members):
            if isinstance(member, LockIn):
                settled = dataclasses.replace(member, fraction=float(found[_OWN + place])).settled()
                rates.append(settled.lock_in_deg_s if settled.fraction == 1.0 else math.nan)
        left.append((target - design @ found) / (PPM * SECONDS_PER_HOUR * run.column("table_rate_deg_s")))
    return Fit(tuple(members), np.array(rates), np.array(left).T)


def other_models(table: RateTable) -> dict[str, tuple[float, float]]:
    """The lock-in rate, deg/s, by models that weigh the rates otherwise or add a bias."""
    fits = {
        "k0, by the scatter of the repeats in ppm": fit_lock_in(table),
        "k0, rates alike in ppm": fit_lock_in(table, weighted=False),
        "k0 and a bias, by the scatter": fit_lock_in(table, with_bias=True),
        "k0 and a bias, rates alike": fit_lock_in(table, with_bias=True, weighted=False),
    }
    return {name: (fit.lock_in_deg_s, fit.lock_in_sd_deg_s) for name, fit in fits.items()}


def hump(table: RateTable, fit: Fit) -> str:
    """What lies above all that lock-in can do, in a sentence."""
    rate, mean = table.rate_deg_s, table.mean_ppm
    inside = (rate >= HUMP_DEG_S[0]) & (rate <= HUMP_DEG_S[1])
    plateau = mean[-3:].mean()
    above = mean - plateau
    sure = inside & (above > 3.0 * table.std_ppm / math.sqrt(table.error_ppm.shape[1]))
    left, sd = fit.left
    return (
        f"From {rate[-3]:g} deg/s on the scale-factor error is level at {plateau:+.1f} ppm. At {rate[sure].min():g} to "
        f"{rate[sure].max():g} deg/s the means lie {above[sure].min():+.1f} to {above[sure].max():+.1f} ppm above that level; lock-in "
        f"only ever lowers the output, so all of this is left, and with lock-in taken out {left[inside].min():+.0f} to "
        f"{left[inside].max():+.0f} ppm at {rate[inside].min():g} to {rate[inside].max():g} deg/s (standard errors "
        f"{sd[inside].min():.1f} to {sd[inside].max():.1f} ppm): a hump that lock-in does not explain."
    )


def _system(run: rlg.Recording, members: Sequence[Mechanism]) -> tuple[Array, Array]:
    design = np.column_stack([mechanism.basis(run) for mechanism in (ScaleFactor(), *members)])
    return design, run.rate_deg_h() - SIMULATOR.nominal_deg_h(run)
