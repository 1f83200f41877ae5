"""Run it and print one row for each model, law of hysteresis and number of training runs."""

from __future__ import annotations

import argparse
import logging
from collections.abc import Sequence

import joblib
import numpy as np
import pandas as pd

import rlgcomp as rlg
from experiments.tables import show_table
from rlgcomp.compensation import MODELS
from rlgcomp.compensation.interval import COVERAGE, excess
from rlgcomp.compensation.rows import rows
from rlgcomp.noise import stream

HELD_OUT = 3
NORMAL = 1.645  # 90 % of a normal distribution lie within so many standard deviations
CASES = [
    *(("dynamic", "play", runs) for runs in (1, 2, 3, 5, 9)),
    *(("dynamic", law, 5) for law in ("preisach", "bouc_wen")),
    ("cubic", "play", 5),
    *(("lssvm", "play", runs) for runs in (2, 3)),
]


def programme(rng: np.random.Generator) -> str:
    """A chamber programme between -40 and 60 degC, of four to seven ramps."""
    steps = [
        f"ramp {rng.integers(-40, 60)} {rng.choice([0.5, 0.7, 1.0, 1.3])}, hold {rng.integers(30, 100)}"
        for _ in range(rng.integers(4, 8))
    ]
    return ", ".join([f"start 20, hold {rng.integers(30, 90)}", *steps])


def covered(seed: int, model: str, law: str, training: int) -> pd.DataFrame:
    """Shares of windows held by their intervals, one row for each run held out of a unit."""
    logging.disable(logging.WARNING)
    unit, rng = rlg.simulated_unit(seed, hysteresis=law), stream(seed, "programmes")
    runs = [unit.simulate(programme(rng), seed=k, step_s=10.0, name=f"{k}") for k in range(training + HELD_OUT)]
    compensator = rlg.Compensator(MODELS[model].make()).fit(runs[:training])
    found = []
    for run in runs[training:]:
        windows = rows(run, compensator.recipe_, compensator.averaging_s)
        outside = excess(windows.X, compensator.scaling_.low, compensator.scaling_.high) > 0.0
        held = np.abs(windows.y_deg_h - compensator.predict_rows(windows.X)) <= compensator.half_widths(windows.X)
        found.append(
            {
                "unit": seed,
                "covered": held.mean(),
                "within": held[~outside].mean() if not outside.all() else np.nan,
                "beyond": held[outside].mean() if outside.any() else np.nan,
                "outside": outside.mean(),
                "width": compensator.interval_.inside_deg_h / (NORMAL * np.std(windows.noise_deg_h)),
            }
        )
    return pd.DataFrame(found)


def main(argv: Sequence[str] | None = None) -> None:
    """Command line of the experiment."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="two units, two cases")
    parser.add_argument("--units", type=int, default=20, help="simulated gyro units (default 20)")
    parser.add_argument("--jobs", type=int, default=2, help="worker processes (default 2)")
    options = parser.parse_args(argv)
    units, cases = (2, CASES[1:3]) if options.quick else (options.units, CASES)
    print(f"# Coverage of {100 * COVERAGE:.0f} % intervals, {units} units, {HELD_OUT} runs held out of each\n")
    table = []
    for model, law, training in cases:
        work = (joblib.delayed(covered)(seed, model, law, training) for seed in range(units))
        found = pd.concat(joblib.Parallel(n_jobs=options.jobs)(work))
        by_unit = found.groupby("unit").mean()
        mean, error = by_unit.mean(), by_unit["covered"].std() / np.sqrt(units)
        table.append(
            {
                "model": model,
                "hysteresis": law,
                "training runs": training,
                "covered, %": f"{100 * mean['covered']:.1f} ± {100 * error:.1f}",
                "inputs within the range": f"{100 * mean['within']:.1f}",
                "beyond it": f"{100 * mean['beyond']:.1f}",
                "windows beyond it, %": f"{100 * mean['outside']:.0f}",
                "worst run": f"{100 * found['covered'].min():.0f}",
                "half width / that of the noise": f"{by_unit['width'].median():.2f}",
            }
        )
    show_table("Windows of runs held out that lie in their interval", table)


if __name__ == "__main__":
    main()
