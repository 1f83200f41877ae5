"""The picture of README and of the site's first page: what was concealed, found, and gained on a held-out run.

    python docs/images/found.py

The recordings are those of `rlgcomp example chamber`; writes found.svg beside this file and prints what README says of it.
"""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

import rlgcomp as rlg
from rlgcomp.simulation.examples import EXAMPLES

RAW, FOUND, TRUE = "#7f8a93", "#0072b2", "#d55e00"


def main() -> None:
    """Diagnose the example and draw it."""
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        EXAMPLES["chamber"].make(folder, 1)
        cold, hot, new = (rlg.read(folder / f"{name}.parquet") for name in ("cold", "hot", "new"))
        believed, true = (rlg.Simulator.from_yaml(folder / name) for name in ("simulator.yaml", "truth.yaml"))
    diagnosis = rlg.diagnose(believed, train=[cold, hot], test=[new])
    (cause,) = diagnosis.causes
    mpl.rcParams.update({"svg.fonttype": "none", "svg.hashsalt": "rlgcomp", "font.family": "sans-serif", "font.size": 9})
    figure = Figure(figsize=(9.0, 3.3), layout="constrained")
    left, right = figure.subplots(1, 2, width_ratios=(1.35, 1.0))
    _held_out(left, diagnosis, new)
    _loop(right, cause, {"cold": cold, "hot": hot}, true)
    figure.savefig(
        Path(__file__).parent / "found.svg", metadata={"Date": None, "Title": "Concealed, found, and gained on a held-out run"}
    )
    print(sentence(diagnosis, cause))


def sentence(diagnosis: rlg.Diagnosis, cause: Any) -> str:
    """What README says below the picture."""
    probability = "above 0.999" if cause.probability > 0.999 else f"of {cause.probability:.3f}"
    gain, low, high = (f"{100 * share:.0f}" for share in (diagnosis.test.improvement, *diagnosis.test.improvement_ci95))
    return (
        f"Concealed from a simulator: {cause.name.replace('_', ' ')}. Found from two chamber runs with a probability "
        f"{probability}, and proved on a third run that decided nothing: {gain} % less error (95 % interval {low} to {high} %)."
    )


def _held_out(ax: mpl.axes.Axes, diagnosis: rlg.Diagnosis, new: rlg.Recording) -> None:
    recorded = new.averaged(diagnosis.test.averaging_s)
    for simulator, colour, name, rms in (
        (diagnosis.calibrated, RAW, "simulator, calibrated", diagnosis.test.baseline_rms),
        (diagnosis.augmented, FOUND, "with the finding", diagnosis.test.augmented_rms),
    ):
        residual = recorded.rate_deg_h() - simulator.predict(new).averaged(diagnosis.test.averaging_s).rate_deg_h()
        ax.plot(recorded.time_s / 3600.0, 1e3 * residual, color=colour, lw=0.9, label=f"{name}: rms {1e3 * rms:.2f}")
    low, high = diagnosis.test.improvement_ci95
    ax.set_title(
        f"Held-out run: {100 * diagnosis.test.improvement:.0f} % less error ({100 * low:.0f} to {100 * high:.0f} %)", fontsize=10
    )
    ax.set_xlabel("time, h")
    ax.set_ylabel("recording less simulation, 10⁻³ deg/h")
    ax.legend(frameon=False, loc="lower left", fontsize=8)


def _loop(ax: mpl.axes.Axes, cause: object, runs: dict[str, rlg.Recording], true: rlg.Simulator) -> None:
    table = cause.function
    at, value, sd = (np.asarray(column) for column in (table.at, table.value, table.sd))
    run = runs[table.run]
    (hysteresis,) = [one for one in true.mechanisms if one.name == cause.name]
    concealed = run.replace(table=run.table.assign(gyro_deg_h=hysteresis.contribution(run, np.random.default_rng(0))))
    averaged = concealed.averaged(300.0)
    truth = averaged.rate_deg_h()
    ax.plot(averaged["temperature_block_degC"], 1e3 * (truth - truth.mean()), color=TRUE, lw=2.2, label="concealed")
    for k in range(len(at) - 1):  # a band along a path that turns back
        ax.fill_between(
            at[k : k + 2], 1e3 * (value - 2 * sd)[k : k + 2], 1e3 * (value + 2 * sd)[k : k + 2], color=FOUND, alpha=0.18, lw=0
        )
    ax.plot(at, 1e3 * value, color=FOUND, lw=1.1, label="found, ± 2 standard deviations")
    ax.set_title(f"{cause.name.replace('_', ' ').capitalize()}, run {table.run}", fontsize=10)
    ax.set_xlabel("temperature of the block, °C")
    ax.set_ylabel("bias, 10⁻³ deg/h")
    ax.legend(frameon=False, fontsize=8)


if __name__ == "__main__":
    main()
