"""What the prior of the coefficients of rate, lag and memory does on real legs: all sensors, other legs held out."""

from __future__ import annotations

from pathlib import Path
from typing import Final

import numpy as np

import rlgcomp as rlg
from rlgcomp.compensation.models import MODELS
from rlgcomp.compensation.window_means import window_means

CHANNELS: Final = {f"gyro {axis}": f"gyro_{axis}" for axis in "xyz"} | {f"acc {axis}": f"acc_{axis}_mps2" for axis in "xyz"}
SPLITS: Final = {  # runs of training, each from one leg to another; the leg held out
    "1 to 2 in one run; 3": (((1, 2),), 3),
    "2 to 3 in one run; 1": (((2, 3),), 1),
    "1 and 2; 3": (((1, 1), (2, 2)), 3),
    "2 and 3; 1": (((2, 2), (3, 3)), 1),
}


def table(data: Path, turns_s: tuple[float, ...], averaging_s: float) -> list[dict[str, str]]:
    """Rms of the leg held out with the prior over that without one; a row for each division of the legs.

    Parameters
    ----------
    data : path
        Folder of the recording.
    turns_s : tuple of float
        Where the legs begin and end.
    averaging_s : float
        Length of a window.
    """
    ratios = {split: {name: _ratio(_read(data, name), split, turns_s, averaging_s) for name in CHANNELS} for split in SPLITS}
    rows = [
        {"trained on; held out": split}
        | {name: f"{ratio:.2f}" for name, ratio in of.items()}
        | {"geometric mean": f"{np.exp(np.mean(np.log(list(of.values())))):.2f}"}
        for split, of in ratios.items()
    ]
    each = {name: [of[name] for of in ratios.values()] for name in CHANNELS}
    means = {name: f"{np.exp(np.mean(np.log(values))):.2f}" for name, values in each.items()}
    return [*rows, {"trained on; held out": "geometric mean"} | means | {"geometric mean": f"{_mean(ratios):.2f}"}]


def _mean(ratios: dict[str, dict[str, float]]) -> float:
    return float(np.exp(np.mean([np.log(ratio) for of in ratios.values() for ratio in of.values()])))


def _read(data: Path, name: str) -> rlg.Recording:
    """The recording with one of its sensors for the gyro."""
    columns = {"time_s": "t_s", "temperature_block_degC": "temp_C", "gyro_deg_s": f"{CHANNELS[name]} [deg/s]"}
    dropped = [column for column in CHANNELS.values() if column != CHANNELS[name]]
    return rlg.read(data / "imu_thermal.csv.gz", columns=columns, drop=dropped)


def _ratio(whole: rlg.Recording, split: str, turns_s: tuple[float, ...], averaging_s: float) -> float:
    def legs(first: int, last: int) -> rlg.Recording:
        return whole.between(turns_s[first - 1], turns_s[last], keep_history=True, name=f"legs {first} to {last}")

    training, held_out = SPLITS[split]
    runs, test = [legs(*span) for span in training], legs(held_out, held_out)
    rms = []
    for prior in (MODELS["lssvm-dynamic"].make().linear_prior, None):
        model = rlg.Compensator(MODELS["lssvm-dynamic"].make().set_params(linear_prior=prior), averaging_s=averaging_s).fit(runs)
        windows = window_means(test, model.pipeline_, averaging_s)
        rms.append(float(np.sqrt(np.mean((windows.y_deg_h - model.predict_rows(windows.X)) ** 2))))
    return rms[0] / rms[1]
