"""Run it and print one row for each law of hysteresis and choice of training runs."""

from __future__ import annotations

import argparse
import itertools
from collections.abc import Sequence

import numpy as np

import rlgcomp as rlg
from experiments.work import Work
from rlgcomp.compensation.models import DEFAULT

LAWS = ("play", "preisach", "bouc_wen")
TRAINING = {"paper twice": ("paper", "paper"), "paper and minor-loops": ("paper", "minor-loops")}
HELD_OUT = "reversed"


def ratio(seed: int, law: str, programmes: tuple[str, ...]) -> tuple[float, float]:
    """Bias stability held out over the noise floor, and raw bias stability in deg/h, for one unit."""
    gyro = rlg.simulated_unit(seed, hysteresis=law)
    runs = [gyro.simulate(programme, seed=10 * seed + k, name=f"{programme}-{k}") for k, programme in enumerate(programmes)]
    evaluation = rlg.evaluate(rlg.Compensator().fit(runs), [gyro.simulate(HELD_OUT, seed=10 * seed + 9)], compare=False)
    return evaluation.residual_std_deg_h / evaluation.noise_floor_deg_h, evaluation.raw_std_deg_h


def main(argv: Sequence[str] | None = None) -> None:
    """Command line of the experiment."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--units", type=int, default=10, help="simulated gyro units (default 10)")
    Work.add_options(parser, "noise_floor")
    options = parser.parse_args(argv)
    print(f"# {DEFAULT} on all features, held out on the programme '{HELD_OUT}', {options.units} units\n")
    print("| hysteresis | trained on | raw, deg/h, mean | residual / noise floor, mean | min | max |\n|---|---|---|---|---|---|")
    cases = list(itertools.product(LAWS, TRAINING))
    pieces = [(seed, law, TRAINING[name]) for law, name in cases for seed in range(options.units)]
    made = np.array(Work.of(options).results("noise floor", ratio, pieces)).reshape(len(cases), options.units, 2)
    for (law, name), of_units in zip(cases, made, strict=True):
        ratios, raw = of_units.T
        print(f"| {law} | {name} | {raw.mean():.4f} | {ratios.mean():.3f} | {ratios.min():.3f} | {ratios.max():.3f} |")


if __name__ == "__main__":
    main()
