"""Run it and print one row for each method."""

from __future__ import annotations

import argparse
import logging
import time
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

import rlgcomp as rlg
from experiments.earlier_compensations.methods import neural_network, sensor_selection, swarm_support_vectors
from experiments.mems_thermal_chamber import __main__ as mems
from experiments.tables import FOLDER, show_table
from experiments.work import Work
from rlgcomp.compensation.models import MODELS
from rlgcomp.compensation.window_means import window_means

TRAINING = ("paper", "minor-loops")
HELD_OUT = "reversed"
FOUR = ("temperature", "temperature_rate", "light_intensity", "readout_difference")
OWN = ("cubic", "dynamic", "lssvm", "lssvm-dynamic")
EARLIER: dict[str, Callable[..., tuple[Any, Any]]] = {
    "sensors by sum of squared errors, cubic": sensor_selection,
    "support vectors by particle swarm": swarm_support_vectors,
    "neural network, 10 neurons": neural_network,
}


def compared(
    runs: Sequence[rlg.Recording], test: rlg.Recording, features: str, averaging_s: float, gyro: str | None, own: bool = False
) -> dict[str, list[float]]:
    """Standard deviation and root mean square held out in deg/h, and processor seconds, by method.

    Parameters
    ----------
    runs : sequence of Recording
        Of training.
    test : Recording
        Held out.
    features : str
        As the compensator takes them.
    averaging_s : float
    gyro : str, optional
    own : bool
        The package's models alone.
    """
    logging.disable(logging.WARNING)
    results: dict[str, list[float]] = {}

    def add(name: str, residuals: np.ndarray, seconds: float) -> None:
        results[name] = [float(np.std(residuals, ddof=1)), float(np.sqrt(np.mean(residuals**2))), seconds]

    with threadpool_limits(1):
        for name in OWN:
            begin = time.process_time()
            model = rlg.Compensator(MODELS[name].make(), features=features, averaging_s=averaging_s, gyro=gyro).fit(runs)
            seconds = time.process_time() - begin
            held_out = window_means(test, model.pipeline_, averaging_s, gyro)
            add(name, held_out.y_deg_h - model.predict_rows(held_out.X), seconds)
        (X, y, _), groups = model.training_rows(), model.run_labels()
        scaling = model.scaling_
        rows = scaling.inputs(held_out.X)
        for name, method in ({} if own else EARLIER).items():
            begin = time.process_time()
            _, predict = method(X, y, groups)
            seconds = time.process_time() - begin
            add(name, held_out.y_deg_h - scaling.y_mean_deg_h - scaling.y_scale_deg_h * predict(rows), seconds)
    add("none", held_out.y_deg_h - scaling.y_mean_deg_h, 0.0)
    if held_out.noise_deg_h is not None:
        add("noise of the means", held_out.noise_deg_h, 0.0)
    return results


def of_unit(seed: int, features: str, own: bool = False) -> dict[str, list[float]]:
    """:func:`compared` for one simulated unit: another programme is held out than those trained on."""
    gyro = rlg.simulated_unit(seed)
    runs = [gyro.simulate(programme, seed=10 * seed + k, name=programme) for k, programme in enumerate(TRAINING)]
    return compared(runs, gyro.simulate(HELD_OUT, seed=10 * seed + 9), features, 100.0, None, own)


def of_axis(axis: str) -> dict[str, list[float]]:
    """:func:`compared` for one axis of the MEMS IMU: the last leg is held out."""
    whole = mems.cycle(FOLDER.parent / "real" / "mems_imu_thermal_chamber")
    gyro = f"gyro_{axis}_deg_s"
    return compared([mems.leg(whole, 1), mems.leg(whole, 2)], mems.leg(whole, 3), "all", mems.AVERAGING_S, gyro)


def main(argv: Sequence[str] | None = None) -> None:
    """Command line of the experiment."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--units", type=int, default=10, help="simulated gyro units (default 10)")
    parser.add_argument("--legs", action="store_true", help="the legs of a MEMS IMU's thermal cycle (../shared/data/real)")
    parser.add_argument("--own", action="store_true", help="the package's models alone, on the simulated units")
    Work.add_options(parser, "earlier_compensations")
    options = parser.parse_args(argv)
    work = Work.of(options)
    if options.legs:
        axes = work.results("earlier methods, leg", of_axis, [(axis,) for axis in mems.AXES])
        show_table("MEMS IMU, last leg held out: rms in deg/h, all inputs", _legs(axes))
        return
    for title, features in (("all inputs", "all"), ("the paper's four inputs", ",".join(FOUR))):
        units = work.results("earlier methods", of_unit, [(seed, features, options.own) for seed in range(options.units)])
        show_table(f"{len(units)} simulated units, '{HELD_OUT}' held out: bias stability in deg/h, {title}", _units(units))


def _units(units: Sequence[dict[str, list[float]]]) -> list[dict[str, str]]:
    floor = np.array([unit["noise of the means"][0] for unit in units])
    table = []
    for name in [name for name in ("none", *OWN, *EARLIER, "noise of the means") if name in units[0]]:
        values, seconds = (np.array([unit[name][k] for unit in units]) for k in (0, 2))
        table.append(
            {
                "method": name,
                "mean": f"{values.mean():.5f}",
                "worst unit": f"{values.max():.5f}",
                "/ noise, median": f"{np.median(values / floor):.3f}",
                "processor time, s, median": f"{np.median(seconds):.2f}" if seconds.any() else "",
            }
        )
    return table


def _legs(axes: Sequence[dict[str, list[float]]]) -> list[dict[str, str]]:
    table = []
    for name in ("none", *OWN, *EARLIER):
        seconds = float(np.median([axis[name][2] for axis in axes]))
        cells = {letter: f"{axis[name][1]:.2f} ({axis[name][0]:.2f})" for letter, axis in zip(mems.AXES, axes, strict=True)}
        table.append({"method": name, **cells, "processor time, s, median": f"{seconds:.2f}" if seconds else ""})
    return table


if __name__ == "__main__":
    main()
