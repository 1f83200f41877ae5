"""What a linear scale factor lacks, the lock-in rate by several models, and what lock-in leaves at each rate."""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
import pandas as pd

import rlgcomp as rlg
from experiments.lock_in_in_published_data.recordings import recording, table_3
from rlgcomp.calibration.rate_dependence import fit_lock_in
from rlgcomp.calibration.scale_factor import sd_of_mean
from rlgcomp.diagnosis.diagnose import diagnose
from rlgcomp.diagnosis.report.result import Diagnosis
from rlgcomp.noise.processes import stream
from rlgcomp.physics.lock_in import LockIn
from rlgcomp.physics.mechanism import Mechanism
from rlgcomp.physics.scale_factor import ScaleFactor
from rlgcomp.physics.scale_factor_nonlinearity import ScaleFactorNonlinearity
from rlgcomp.units import PPM, SECONDS_PER_HOUR

Array = npt.NDArray[np.float64]
TRAINED, HELD_OUT = (0, 1, 2), (3, 4)
SIMULATOR = rlg.Simulator.from_mapping({"kind": "turntable", "mechanisms": ["scale_factor"]})
HUMP_DEG_S = (3.0, 12.0)
PLATEAU_DEG_S = 40.0


@functools.cache
def diagnosis() -> Diagnosis:
    """What the simulator lacks in the training power-ups, proved on the others."""
    train, test = (
        recording(table_3(), runs, name) for runs, name in ((TRAINED, "power-ups 1 to 3"), (HELD_OUT, "power-ups 4 and 5"))
    )
    return diagnose(SIMULATOR, [train], [test])


def contributions_ppm(simulator: rlg.Simulator) -> pd.DataFrame:
    """What each mechanism of a simulator adds to the scale-factor error at the rates of the table."""
    run = recording(table_3(), (0,), "one power-up")
    nominal = PPM * SECONDS_PER_HOUR * run.column("table_rate_deg_s")
    return pd.DataFrame(
        {m.name: m.contribution(run, stream(0, m.name)) / nominal for m in simulator.mechanisms},
        index=table_3().rate_deg_s,
    )


@dataclasses.dataclass(frozen=True)
class Fit:
    """A set of mechanisms fitted to each power-up by itself, every value alike in deg/h.

    Parameters
    ----------
    lock_in_deg_s : ndarray, shape (runs,)
    left_ppm : ndarray, shape (rates, runs)
    """

    lock_in_deg_s: Array
    left_ppm: Array

    @property
    def rate_deg_s(self) -> tuple[float, float]:
        """Mean over the power-ups and its standard error."""
        return float(self.lock_in_deg_s.mean()), sd_of_mean(pd.Series(self.lock_in_deg_s))

    @property
    def left(self) -> tuple[Array, Array]:
        """Mean over the power-ups at each rate and its standard error, ppm."""
        return self.left_ppm.mean(axis=1), self.left_ppm.std(axis=1, ddof=1) / math.sqrt(self.left_ppm.shape[1])


def fit_each(others: Sequence[Mechanism] = ()) -> Fit:
    """Fit lock-in, and other mechanisms beside it, to every power-up by itself."""
    table, rates, left = table_3(), [], []
    for power_up in range(table.error_ppm.shape[1]):
        run = recording(table, [power_up], f"power-up {power_up + 1}")
        design = np.column_stack([mechanism.basis(run) for mechanism in (LockIn(), ScaleFactor(), *others)])
        target = run.rate_deg_h() - SIMULATOR.nominal_deg_h(run)
        found = np.linalg.lstsq(design, target, rcond=None)[0]
        rates.append(LockIn(fraction=float(found[0])).canonical().lock_in_deg_s)
        left.append((target - design @ found) / (PPM * SECONDS_PER_HOUR * run.column("table_rate_deg_s")))
    return Fit(np.array(rates), np.array(left).T)


def lock_in_rates() -> dict[str, tuple[float, float]]:
    """The lock-in rate and its standard deviation, deg/s, by model."""
    table = table_3()
    found = next(cause for cause in diagnosis().causes if cause.name == "lock_in").parameters
    rate, fraction = found["lock_in_deg_s"].value, found["fraction"]  # far above lock-in their product with the rate squared counts
    named = rate * math.sqrt(fraction.value), rate * math.sqrt(fraction.value) * 0.5 * fraction.sd / fraction.value
    fits = {
        "k0, by the scatter of the repeats in ppm": fit_lock_in(table),
        "k0, rates alike in ppm": fit_lock_in(table, weighted=False),
        "k0 and a bias, by the scatter in ppm": fit_lock_in(table, with_bias=True),
        "k0 and a bias, rates alike in ppm": fit_lock_in(table, with_bias=True, weighted=False),
    }
    return {
        "the diagnosis": named,
        "k0, rates alike in deg/h": fit_each().rate_deg_s,
        "k0 and k ∝ rate, rates alike in deg/h": fit_each([ScaleFactorNonlinearity()]).rate_deg_s,
        **{name: (fit.lock_in_deg_s, fit.lock_in_sd_deg_s) for name, fit in fits.items()},
    }


def hump(left_ppm: Array) -> str:
    """What lies above all that lock-in can do, in a sentence.

    Parameters
    ----------
    left_ppm : ndarray, shape (rates,)
        Means less lock-in.
    """
    table = table_3()
    rate, mean, error = table.rate_deg_s, table.mean_ppm, table.std_ppm / math.sqrt(table.error_ppm.shape[1])
    inside = (rate >= HUMP_DEG_S[0]) & (rate <= HUMP_DEG_S[1])
    plateau = mean[rate >= PLATEAU_DEG_S].mean()
    sure = inside & (mean - plateau > 3.0 * error)
    above, left = (mean - plateau)[sure], left_ppm[inside]
    return (
        f"From {PLATEAU_DEG_S:g} deg/s on the scale-factor error is level at {plateau:+.1f} ppm; at {rate[sure].min():g} to "
        f"{rate[sure].max():g} deg/s the means lie {above.min():+.1f} to {above.max():+.1f} ppm above that (standard errors up to "
        f"{error[sure].max():.1f} ppm). Lock-in lowers every output, so at least that much of a hump is left which it does not "
        f"explain; with its own part taken out, {left.min():+.0f} to {left.max():+.0f} ppm at {HUMP_DEG_S[0]:g} to "
        f"{HUMP_DEG_S[1]:g} deg/s."
    )
