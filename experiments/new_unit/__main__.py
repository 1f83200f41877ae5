"""Run it and print the learning curve."""

from __future__ import annotations

import argparse
import copy
import dataclasses
import functools
import logging
from collections.abc import Sequence

import pandas as pd

import rlgcomp as rlg
from experiments.tables import show_table
from experiments.work import Work
from rlgcomp.compensation.compensator import Compensator
from rlgcomp.compensation.models import MODELS

PROGRAMMES = ("paper", "minor-loops")
SHOWN, HELD_OUT = "minor-loops", "reversed"
STEP_S = 10.0
FIRST_OF_FLEET = 1000  # seeds of the fleet's units, apart from those of the new ones
HOURS = (0.5, 1.0, 2.0, 3.0, 4.0, 6.0, 8.0, 11.0)


def fleet(units: int) -> Compensator:
    """A dynamic model of many units."""
    runs = [
        rlg.simulated_unit(seed).simulate(programme, seed=10 * seed + k, step_s=STEP_S, name=f"{seed}-{programme}")
        for seed in range(FIRST_OF_FLEET, FIRST_OF_FLEET + units)
        for k, programme in enumerate(PROGRAMMES)
    ]
    return Compensator(MODELS["dynamic"].make()).fit(runs)


def learning(seed: int, known: Compensator, hours: Sequence[float], kernels: bool) -> list[dict[str, object]]:
    """What is left on a run held out of one new unit, by method and hours."""
    logging.disable(logging.WARNING)
    unit = rlg.simulated_unit(seed)
    shown = unit.simulate(SHOWN, seed=1, step_s=STEP_S)
    test = unit.simulate(HELD_OUT, seed=2, step_s=STEP_S)
    found = [_scored("fleet as it is", 0.0, known, test)]
    for hour in hours:
        part = shown.between(0.0, 3600.0 * hour)
        found.append(_scored("fleet, offset moved", hour, _moved(known, part), test))
        found.append(_scored("adapted", hour, rlg.adapt(known, [part]), test))
        found.append(_scored("dynamic from scratch", hour, Compensator(MODELS["dynamic"].make()).fit([part]), test))
        if kernels:
            found.append(_scored("LS-SVM from scratch", hour, Compensator().fit([part]), test))
    return found


def main(argv: Sequence[str] | None = None) -> None:
    """Command line of the experiment."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="a fleet of four, two new units, two points, no LS-SVM")
    parser.add_argument("--fleet", type=int, default=12, help="units known (default 12)")
    parser.add_argument("--units", type=int, default=12, help="new units (default 12)")
    Work.add_options(parser, "new_unit")
    options = parser.parse_args(argv)
    size, units, hours = (4, 2, (2.0, 8.0)) if options.quick else (options.fleet, options.units, HOURS)
    known = fleet(size)
    learn = functools.partial(learning, known=known, hours=hours, kernels=not options.quick)
    made = Work.of(options).results(f"new unit, fleet of {size}, hours {hours}", learn, [(seed,) for seed in range(units)])
    found = pd.DataFrame([row for rows in made for row in rows])
    print(f"# Hours of chamber time for a new unit: fleet of {size}, {units} new units, held out on '{HELD_OUT}'\n")
    print(
        f"Noise floor {found['floor'].median():.5f}, raw bias stability {found['raw'].median():.4f} deg/h (medians over units).\n"
    )
    for title, column, form in (
        ("Left, rms, offset included, deg/h, median over units", "rms", "{:.5f}"),
        ("Bias stability left, deg/h, median over units", "std", "{:.5f}"),
        ("Windows within the 90 % interval, %, mean over units", "covered", "{:.0f}"),
        ("Half width within the range, deg/h, median over units", "width", "{:.4f}"),
    ):
        methods = list(dict.fromkeys(found["method"]))
        rows = []
        for hour in sorted(set(found["hours"])):
            here = found[found["hours"] == hour].groupby("method")[column]
            values = here.mean() if column == "covered" else here.median()
            cells = {method: form.format(values[method]) if method in values else "" for method in methods}
            rows.append({"hours": f"{hour:g}"} | cells)
        show_table(title, rows)


def _moved(known: Compensator, part: rlg.Recording) -> Compensator:
    """The fleet's compensation with its mean error on a run taken off."""
    moved = copy.copy(known)
    error = part.averaged().rate_deg_h().mean() - known.predict(part)["bias_deg_h"].mean()
    moved.scaling_ = dataclasses.replace(moved.scaling_, y_mean_deg_h=moved.scaling_.y_mean_deg_h + float(error))
    return moved


def _scored(method: str, hours: float, model: Compensator, test: rlg.Recording) -> dict[str, object]:
    (result,) = rlg.evaluate(model, [test], compare=False).runs
    return {
        "method": method,
        "hours": hours,
        "rms": result.residual_rms_deg_h,
        "std": result.residual_std_deg_h,
        "covered": 100.0 * result.in_interval,
        "width": model.interval_.inside_deg_h,
        "floor": result.noise_floor_deg_h,
        "raw": result.raw_std_deg_h,
    }


if __name__ == "__main__":
    main()
