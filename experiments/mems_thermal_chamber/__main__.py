"""Run it and print, axis by axis, what each model leaves on the leg held out."""

from __future__ import annotations

import argparse
import logging
from pathlib import Path

import numpy as np

import rlgcomp as rlg
from rlgcomp.compensation import MODELS

LEG_ENDS_S = 3127.0  # the temperature turns for the second time; `rlgcomp inspect` lists the legs
CANDIDATES = (
    ("cubic", "temperature"),
    ("dynamic", "temperature,temperature_rate"),
    ("dynamic", "temperature,temperature_rate,lag"),
    ("dynamic", "all"),
    ("lssvm", "temperature"),
    ("lssvm", "all"),
)


def main() -> None:
    """Command line of the experiment."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "--data", type=Path, default=Path("../shared/data/real/mems_imu_thermal_chamber"), help="folder of the recording"
    )
    options = parser.parse_args()
    logging.getLogger("rlgcomp").setLevel(logging.ERROR)
    columns = {"time_s": "t_s", "temperature_block_degC": "temp_C"} | {f"gyro_{axis}_deg_s": f"gyro_{axis}" for axis in "xyz"}
    cycle = rlg.read(options.data / "imu_thermal.csv.gz", columns=columns)
    train = cycle.between(1.0, LEG_ENDS_S, keep_history=True)  # the first second is a turn-on outlier
    test = cycle.between(LEG_ENDS_S, np.inf, keep_history=True)
    print("# MEMS IMU, last leg held out: rms (and standard deviation) of 10 s means in the recording's own unit\n")
    print("| model | inputs | x | y | z |\n|---|---|---|---|---|")
    best: dict[str, tuple[float, str]] = {}
    for name, features in CANDIDATES:
        cells = []
        for axis in "xyz":
            model = rlg.Compensator(MODELS[name].make(), features=features, averaging_s=10.0, gyro=f"gyro_{axis}_deg_s").fit(
                [train]
            )
            (run,) = rlg.evaluate(model, [test], compare=False).runs
            rms, std = run.residual_rms_deg_h / 3600.0, run.residual_std_deg_h / 3600.0
            cells.append(f"{rms:.2e} ({std:.1e})")
            best[axis] = min(best.get(axis, (np.inf, "")), (rms, f"{name} on {features}"))
        print(f"| {name} | {features} | {' | '.join(cells)} |")
    print()
    for axis, (rms, label) in best.items():
        print(f"- {axis}: least rms {rms:.2e}, {label}.")


if __name__ == "__main__":
    main()
