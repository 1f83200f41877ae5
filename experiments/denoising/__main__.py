"""Run it and print one row for each method of de-noising."""

from __future__ import annotations

import argparse
import logging
from collections.abc import Sequence

import numpy as np

import rlgcomp as rlg
from experiments.denoising.methods import METHODS
from experiments.mems_thermal_chamber import __main__ as mems
from experiments.tables import FOLDER, show_table
from experiments.work import Work
from rlgcomp.compensation.models import MODELS
from rlgcomp.compensation.window_means import window_means

TRAINING = ("paper", "minor-loops")
HELD_OUT = "reversed"
MODELS_COMPARED = ("cubic", "dynamic", "lssvm")
STEP_S = 10.0


def compared(
    runs: Sequence[rlg.Recording], test: rlg.Recording, method: str, averaging_s: float, gyro: str
) -> dict[str, list[float]]:
    """Standard deviation and root mean square of what each model leaves of a run held out, deg/h.

    Parameters
    ----------
    runs : sequence of Recording
        Of training, which are smoothed.
    test : Recording
        As recorded.
    method : str
        Of `METHODS`.
    averaging_s : float
    gyro : str
    """
    logging.disable(logging.WARNING)
    runs = [run.with_column(gyro, METHODS[method](run, gyro)) for run in runs]
    results = {}
    for name in MODELS_COMPARED:
        model = rlg.Compensator(MODELS[name].make(), averaging_s=averaging_s, gyro=gyro).fit(runs, screen=False)
        held_out = window_means(test, model.pipeline_, averaging_s, gyro)
        left = held_out.y_deg_h - model.predict_rows(held_out.X)
        results[name] = [float(np.std(left, ddof=1)), float(np.sqrt(np.mean(left**2)))]
    if held_out.noise_deg_h is not None:
        results["noise"] = [float(np.std(held_out.noise_deg_h, ddof=1))] * 2
    return results


def of_unit(seed: int, method: str) -> dict[str, list[float]]:
    """:func:`compared` for one simulated unit: another programme is held out than those trained on."""
    gyro = rlg.simulated_unit(seed)
    runs = [gyro.simulate(name, seed=10 * seed + k, name=name, step_s=STEP_S) for k, name in enumerate(TRAINING)]
    return compared(runs, gyro.simulate(HELD_OUT, seed=10 * seed + 9, step_s=STEP_S), method, 100.0, "gyro_deg_h")


def of_axis(axis: str, method: str) -> dict[str, list[float]]:
    """:func:`compared` for one axis of the MEMS IMU: the last leg is held out."""
    whole = mems.cycle(FOLDER.parent / "real" / "mems_imu_thermal_chamber")
    return compared([mems.leg(whole, 1), mems.leg(whole, 2)], mems.leg(whole, 3), method, mems.AVERAGING_S, f"gyro_{axis}_deg_s")


def main(argv: Sequence[str] | None = None) -> None:
    """Command line of the experiment."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--units", type=int, default=10, help="simulated gyro units (default 10)")
    parser.add_argument("--legs", action="store_true", help="the legs of a MEMS IMU's thermal cycle (../shared/data/real)")
    Work.add_options(parser, "denoising")
    options = parser.parse_args(argv)
    work = Work.of(options)
    if options.legs:
        pieces = [(axis, method) for method in METHODS for axis in mems.AXES]
        made = dict(zip(pieces, work.results("de-noising, leg", of_axis, pieces), strict=True))
        for axis in mems.AXES:
            table = [
                {"training target": method} | {name: f"{made[axis, method][name][1]:.2f}" for name in MODELS_COMPARED}
                for method in METHODS
            ]
            show_table(f"MEMS IMU, axis {axis}, last leg held out: rms in deg/h", table)
        return
    pieces = [(seed, method) for method in METHODS for seed in range(options.units)]
    made = dict(zip(pieces, work.results("de-noising", of_unit, pieces), strict=True))
    table = []
    for method in METHODS:
        row = {"training target": method}
        for name in MODELS_COMPARED:
            before, after, noise = (
                np.array([made[seed, which][key][0] for seed in range(options.units)])
                for which, key in (("as recorded", name), (method, name), (method, "noise"))
            )
            better = int((after < before).sum())
            row[f"{name}: mean, deg/h"] = f"{after.mean():.5f}"
            row[f"{name}: / noise, median"] = f"{np.median(after / noise):.3f}"
            row[f"{name}: better in"] = f"{better} of {options.units}" if method != "as recorded" else ""
        table.append(row)
    show_table(f"{options.units} simulated units, '{HELD_OUT}' held out", table)


if __name__ == "__main__":
    main()
