"""Run it and print one row for each model, law of hysteresis and number of training runs."""

from __future__ import annotations

import argparse
import logging
from collections.abc import Sequence

import numpy as np
import pandas as pd

import rlgcomp as rlg
from experiments.mems_thermal_chamber import __main__ as mems
from experiments.tables import FOLDER, show_table
from experiments.work import Work
from rlgcomp.compensation.held_out_errors import HeldOutErrors
from rlgcomp.compensation.interval import COVERAGE, Interval, excess
from rlgcomp.compensation.models import MODELS
from rlgcomp.compensation.window_means import window_means
from rlgcomp.noise.processes import stream

HELD_OUT = 3
TURN_ON_DEG_H = 0.01
OFFSET_S = 600.0
DRAWS = {"dynamic": 10, "lssvm": 2}
STEP_S = 10.0
TURN_ON_CASES = [
    *(("dynamic", runs, False) for runs in (1, 2, 4, 6)),
    *(("dynamic", runs, True) for runs in (1, 2, 4, 6)),
    *(("lssvm", runs, True) for runs in (1, 2)),
]
IMU_CASES = [("dynamic", runs, False) for runs in (2, 4, 6)]
IMU_UNITS = 1000, 2000  # added to a unit's number: the two other gyros of its IMU
LEG_OFFSET_S = 60.0
LEGS_MODELS = (
    ("dynamic", "temperature,temperature_rate", False),
    ("dynamic", "all", False),
    ("lssvm", "temperature", False),
    ("lssvm-dynamic", "all", False),
    ("lssvm-dynamic", "all", True),
)
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


def covered(seed: int, model: str, law: str, training: int) -> list[dict[str, float]]:
    """Shares of windows held by their intervals, one row for each run held out of a unit."""
    logging.disable(logging.WARNING)
    unit, rng = rlg.simulated_unit(seed, hysteresis=law), stream(seed, "programmes")
    runs = [unit.simulate(programme(rng), seed=k, step_s=10.0, name=f"{k}") for k in range(training + HELD_OUT)]
    compensator = rlg.Compensator(MODELS[model].make()).fit(runs[:training])
    found = []
    for run in runs[training:]:
        windows = window_means(run, compensator.pipeline_, compensator.averaging_s)
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
    return found


def covered_with_turn_on(seed: int, model: str, training: int, stated: bool, imu: bool = False) -> list[dict[str, float]]:
    """Shares of windows held, one row for each draw of the runs' biases, mean of the runs held out.

    Parameters
    ----------
    seed : int
        Of the unit.
    model : str
    training : int
        Number of training runs.
    stated : bool
        The repeatability is stated.
    imu : bool
        The recordings have the gyros of two further units, with biases of their own.
    """
    logging.disable(logging.WARNING)
    unit, rng = rlg.simulated_unit(seed), stream(seed, "programmes")
    texts = [programme(rng) for _ in range(training + HELD_OUT)]
    runs = [unit.simulate(text, seed=k, step_s=STEP_S, name=f"{k}") for k, text in enumerate(texts)]
    others = [rlg.simulated_unit(seed + further) for further in IMU_UNITS] if imu else []
    of_others = [
        [other.simulate(text, seed=k, step_s=STEP_S).column("gyro_deg_h") for k, text in enumerate(texts)] for other in others
    ]
    found = []
    for _ in range(DRAWS[model]):
        biases = TURN_ON_DEG_H * rng.standard_normal(len(runs))
        shifted = [run.with_column("gyro_deg_h", run.column("gyro_deg_h") + bias) for run, bias in zip(runs, biases, strict=True)]
        for axis, columns in zip("yz", of_others, strict=False):
            own = TURN_ON_DEG_H * rng.standard_normal(len(runs))
            shifted = [
                run.with_column(f"gyro_{axis}_deg_h", column + bias)
                for run, column, bias in zip(shifted, columns, own, strict=True)
            ]
        stated_deg_h = TURN_ON_DEG_H if stated else None
        compensator = rlg.Compensator(MODELS[model].make(), gyro="gyro_deg_h", turn_on_deg_h=stated_deg_h)
        compensator.fit(shifted[:training], screen=False)
        held, zeroed = [], []
        interval = compensator.offset_interval(OFFSET_S)
        for run in shifted[training:]:
            windows = window_means(run, compensator.pipeline_, compensator.averaging_s, compensator.gyro)
            error = windows.y_deg_h - compensator.predict_rows(windows.X)
            held.append(float(np.mean(np.abs(error) <= compensator.half_widths(windows.X))))
            first = windows.time_s < windows.time_s[0] + OFFSET_S
            widths = compensator.half_widths(windows.X) + interval.inside_deg_h - compensator.interval_.inside_deg_h
            zeroed.append(float(np.mean((np.abs(error - error[first].mean()) <= widths)[~first])))
        found.append(
            {
                "unit": seed,
                "covered": float(np.mean(held)),
                "zeroed": float(np.mean(zeroed)),
                "width": compensator.interval_.inside_deg_h,
                "zeroed width": interval.inside_deg_h,
            }
        )
    return found


def turn_on(work: Work, units: int, cases: Sequence[tuple[str, int, bool]], *, imu: bool = False) -> list[dict[str, object]]:
    """One row for each model and number of training runs.

    Parameters
    ----------
    work : Work
    units : int
    cases : sequence of (model, training runs, whether the repeatability is stated)
    imu : bool
        The recordings have the gyros of two further units.
    """
    pieces = [(seed, *case, *([True] if imu else [])) for case in cases for seed in range(units)]
    made = work.results("coverage turn-on", covered_with_turn_on, pieces)
    table: list[dict[str, object]] = []
    for k, (model, training, stated) in enumerate(cases):
        found = pd.DataFrame([row for rows in made[k * units : (k + 1) * units] for row in rows], dtype=float)
        means, errors = found.mean(), found.groupby("unit").mean().std() / np.sqrt(units)
        table.append(
            {
                "model": model,
                "turn-on stated": "yes" if stated else "no",
                "training runs": training,
                "covered, %": f"{100 * means['covered']:.1f} ± {100 * errors['covered']:.1f}",
                "half width, median, deg/h": f"{found['width'].median():.4f}",
                f"offset zeroed over {OFFSET_S:.0f} s: covered, %": f"{100 * means['zeroed']:.1f} ± {100 * errors['zeroed']:.1f}",
                "its half width, median, deg/h": f"{found['zeroed width'].median():.4f}",
            }
        )
    return table


def legs() -> list[dict[str, object]]:
    """Shares held on each leg of each axis, trained on the two other legs, and how large the errors are in half widths."""
    logging.disable(logging.WARNING)
    whole = mems.cycle(FOLDER.parent / "real" / "mems_imu_thermal_chamber")
    parts = [mems.leg(whole, number) for number in (1, 2, 3)]
    table: list[dict[str, object]] = []
    for model, features, known in LEGS_MODELS:
        found, in_half_widths, zeroed = {}, [], []
        for axis in mems.AXES:
            for k, part in enumerate(parts):
                compensator = rlg.Compensator(
                    MODELS[model].make(), features=features, averaging_s=mems.AVERAGING_S, gyro=f"gyro_{axis}_deg_s"
                ).fit(parts[:k] + parts[k + 1 :])
                if known:
                    compensator.interval_ = _of_known_spread(compensator)
                (result,) = rlg.evaluate(compensator, [part], compare=False).runs
                found[f"{axis}, leg {k + 1}"] = 100.0 * result.in_interval
                in_half_widths.append(result.residual_rms_deg_h / compensator.interval_.inside_deg_h)
                (started,) = rlg.evaluate(compensator, [part], compare=False, offset_s=LEG_OFFSET_S).runs
                zeroed.append(100.0 * started.in_interval)
        table.append(
            {
                "model": f"{model}, {features}" + (", spread known" if known else ""),
                "mean": f"{float(np.mean(list(found.values()))):.0f}",
                **{key: f"{share:.0f}" for key, share in found.items()},
                "rms error / half width, median": f"{float(np.median(in_half_widths)):.2f}",
                f"offset zeroed over {LEG_OFFSET_S:.0f} s, mean": f"{float(np.mean(zeroed)):.0f}",
            }
        )
    return table


def _of_known_spread(compensator: rlg.Compensator) -> Interval:
    """The interval of one who knows that runs spread as these do, and not by chance: as if it were stated."""
    errors = HeldOutErrors.of(compensator.model_, compensator.training_, compensator.scaling_)
    means = np.array([errors.errors_deg_h[errors.groups == label].mean() for label in np.unique(errors.groups)])
    return errors.interval(float(np.sqrt(np.mean(means**2) * (len(means) - 1) / len(means))))


def main(argv: Sequence[str] | None = None) -> None:
    """Command line of the experiment."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="two units, two cases")
    parser.add_argument("--units", type=int, default=20, help="simulated gyro units (default 20)")
    Work.add_options(parser, "coverage")
    parser.add_argument("--turn-on", action="store_true", help="runs with biases of their own")
    parser.add_argument("--imu", action="store_true", help="such runs, with three gyros each")
    parser.add_argument("--legs", action="store_true", help="the legs of a MEMS IMU's thermal cycle (../shared/data/real)")
    options = parser.parse_args(argv)
    if options.legs:
        show_table("Legs of a MEMS IMU held out in turn: windows of 10 s in their 90 % interval, %", legs())
        return
    if options.turn_on:
        title = f"Windows in their 90 % interval, turn-on biases of {TURN_ON_DEG_H:g} deg/h rms, {options.units} units"
        show_table(title, turn_on(Work.of(options), options.units, TURN_ON_CASES))
        return
    if options.imu:
        title = f"The same of an IMU's three gyros, {options.units} units"
        show_table(title, turn_on(Work.of(options), options.units, IMU_CASES, imu=True))
        return
    units, cases = (2, CASES[1:3]) if options.quick else (options.units, CASES)
    print(f"# Coverage of {100 * COVERAGE:.0f} % intervals, {units} units, {HELD_OUT} runs held out of each\n")
    made = Work.of(options).results("coverage", covered, [(seed, *case) for case in cases for seed in range(units)])
    table = []
    for k, (model, law, training) in enumerate(cases):
        found = pd.DataFrame([row for rows in made[k * units : (k + 1) * units] for row in rows], dtype=float)
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
