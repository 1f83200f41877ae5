"""Units of the experiment: simulated ones, and those of the benchmark of concealed causes; their noise floor and residuals."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

import rlgcomp as rlg
from experiments.concealed.bench import Bench
from experiments.concealed.plan import Plan, plan
from rlgcomp.noise.processes import NOISES

Array = npt.NDArray[np.float64]
AVERAGING_S = 100.0
SIZE_DEG_H = 0.01
OTHER = ("paper", "minor-loops"), "reversed"
NARROW = (
    (
        "start 20, hold 60, ramp -5 1, hold 90, ramp 45 1, hold 90, ramp 20 1, hold 60",
        "start 20, hold 60, ramp 40 1, hold 45, ramp 15 1, hold 45, ramp 30 1, hold 45, ramp -5 1, hold 60, ramp 45 0.7, hold 60, "
        "ramp 10 1, hold 45",
    ),
    "start 20, hold 60, ramp -30 1, hold 120, ramp 70 1, hold 120, ramp 20 1, hold 60",
)
PROGRAMMES = {"other programme": OTHER, "twice the range": NARROW}
FORMS = {
    "Preisach": ("thermal_hysteresis", "smooth density"),
    "ladder": ("thermal_lag", "2 to 6 time constants"),
    "diffusive": ("thermal_lag", "slab"),
}


def simulated(seed: int, law: str, programme: str) -> tuple[rlg.Simulator, list[rlg.Recording], rlg.Recording, float]:
    """A simulated unit, its training runs, its held-out run and the noise floor of that."""
    gyro = rlg.simulated_unit(seed, hysteresis=law)
    training, held_out = PROGRAMMES[programme]
    runs = [gyro.simulate(text, seed=10 * seed + k, name=f"run{k}") for k, text in enumerate(training)]
    test = gyro.simulate(held_out, seed=10 * seed + 9, name="test")
    truth = test.truth
    assert truth is not None  # noqa: S101
    noise = np.asarray(truth[[name for name in NOISES if name in truth]].to_numpy().sum(axis=1))
    return gyro, runs, test, pooled([means(test, noise, AVERAGING_S)])


def cases(form: str, count: int) -> list[Plan]:
    """So many cases of a form, of the benchmark's seeds for tuning."""
    name, wanted = FORMS[form]
    found: list[Plan] = []
    for one in plan("single", 2000, tuning=True):
        if one.hidden == (name,):
            bench = Bench.of(one, None)
            try:
                effect = bench.acting(name, 0, plain=True)
            except ValueError:
                continue
            if effect.form.startswith(wanted):
                found.append(one)
        if len(found) == count:
            break
    return found


def floor_of(tests: Sequence[rlg.Recording], signals: Sequence[Array], averaging_s: float) -> float:
    """Noise floor of runs whose signal is known."""
    return pooled([means(run, run.rate_deg_h() - signal, averaging_s) for run, signal in zip(tests, signals, strict=True)])


def residual(model: rlg.Compensator, tests: Sequence[rlg.Recording], averaging_s: float) -> float:
    """Standard deviation of what a model leaves of held-out means."""
    left = [means(run, run.rate_deg_h() - model.predict(run)["bias_deg_h"].to_numpy(), averaging_s) for run in tests]
    return pooled(left)


def means(run: rlg.Recording, values: Array, averaging_s: float) -> Array:
    """Means over windows of the scored part of a run."""
    values = values[run.scored]
    rows = max(1, round(averaging_s / run.period_s))
    count = len(values) // rows
    return np.asarray(values[: count * rows].reshape(count, rows).mean(axis=1))


def pooled(parts: Sequence[Array]) -> float:
    """Root of the mean variance of the parts."""
    return float(np.sqrt(np.mean([np.var(part, ddof=1) for part in parts])))
