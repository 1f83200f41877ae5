"""Example data: small sets of files as a laboratory would have them, the same for README, tutorials and tests.

Each kind is a function that fills a folder. Recordings have the standard column names, but for those that loggers wrote under
names and units of their own. What README and tutorials state of these files is computed from them.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Final

import numpy as np
import pandas as pd

from rlgcomp.files import write_text
from rlgcomp.noise.processes import stream
from rlgcomp.recording import TIME, Recording
from rlgcomp.recording.formats import write
from rlgcomp.simulation.position_table import PositionTable
from rlgcomp.simulation.random_units import simulated_unit
from rlgcomp.simulation.simulator import Simulator
from rlgcomp.simulation.triad_errors import TriadErrors
from rlgcomp.simulation.two_axis_table import Triad
from rlgcomp.units import EARTH_RATE_DEG_H, RAD_PER_DEG, SECONDS_PER_HOUR, convert

STEP_S: Final = 5.0  # of chamber runs
LOGGER: Final = {  # the logger's names of columns; its gyro is in deg/s, its thermometers in K
    TIME: "Time [s]",
    "gyro_deg_h": "Gyro Z [deg/s]",
    "temperature_block_degC": "T1 [K]",
    "temperature_shell_degC": "T2 [K]",
    "light_intensity_V": "PLC [V]",
    "readout_a_V": "PD A [V]",
    "readout_b_V": "PD B [V]",
    "supply_voltage_V": "Supply [V]",
}
PULSE_ARCSEC: Final = 0.0527  # of a readout that divides a fringe of 0.843 arcsec by 16
CLOCK_OFFSET_S: Final = 137.0  # by which the thermometers' logger was switched on before the gyro's

_SIMULATOR: Final = """\
# What the laboratory believes of its gyro RLG-17. Numbers that are not stated are calibrated from recordings.
kind: chamber
unit: RLG-17
mechanisms:
  - thermal_polynomial: {degree: 3}
  - temperature_rate
  - light_intensity
"""
_TRUTH: Final = """\
# The gyro RLG-17 that made the recordings. simulator.yaml lacks the last mechanism.
kind: chamber
unit: RLG-17
mechanisms:
  - thermal_polynomial: {degree: 3, c0_deg_h: -0.015, c1_deg_h_K: -1.6e-4, c2_deg_h_K2: -1.0e-6, c3_deg_h_K3: 9.0e-9}
  - temperature_rate: {k_deg_h_min_K: -0.0068}
  - light_intensity: {k_deg_h_V: 0.14}
  - thermal_hysteresis: {law: plays, k1_deg_h_K: 1.3e-3, radius_K: 8}
noise: {angle_random_walk_deg_sqrt_h: 0.0003, bias_instability_deg_h: 0.0002, rate_random_walk_deg_h_sqrt_h: 0.0001}
"""


def chamber(folder: Path, seed: int) -> None:
    """Three chamber runs of one gyro and a simulator that lacks one effect, which is named in truth.yaml alone."""
    for name, text in (("simulator.yaml", _SIMULATOR), ("truth.yaml", _TRUTH)):
        write_text(folder / name, text)
    gyro = Simulator.from_yaml(folder / "truth.yaml")
    runs = {}
    for number, (name, programme) in enumerate({"cold": "paper", "hot": "minor-loops", "new": "reversed"}.items(), start=1):
        runs[name] = _without_truth(gyro.simulate(programme, seed=10 * seed + number, step_s=STEP_S, name=name))
        write(runs[name], folder / f"{name}.parquet")
    _as_logged(runs["cold"].table).to_csv(folder / "logger.csv", sep=";", index=False, float_format="%.9g")
    table = runs["hot"].table
    table[[TIME, "gyro_deg_h", "temperature_block_degC"]].to_csv(folder / "gyro.csv", index=False, float_format="%.9g")
    thermometers = table[[TIME, "temperature_block_degC", "temperature_shell_degC", "light_intensity_V"]].iloc[::2]
    thermometers = thermometers.assign(**{TIME: thermometers[TIME] + CLOCK_OFFSET_S})
    thermometers.to_csv(folder / "thermometers.csv", index=False, float_format="%.9g")


def turntable(folder: Path, seed: int) -> None:
    """One gyro on a rate table and a position table, chamber runs of it in pulses, and three gyros on a table of two axes."""
    table = PositionTable(scale_arcsec=PULSE_ARCSEC)
    write(_without_truth(table.rate_recording(5, seed=seed)), folder / "to-and-fro.parquet")
    write(_without_truth(table.position_recording([0, 45, 90, 135, 180], seed=seed + 1)), folder / "positions.parquet")
    gyro = Simulator.from_mapping(
        {"kind": "chamber", "mechanisms": ["thermal_polynomial", "temperature_rate", "thermal_hysteresis"]}
    )
    for number, programme in enumerate(("paper", "minor-loops"), start=1):
        run = _without_truth(gyro.simulate(programme, seed=10 * seed + number, step_s=STEP_S, name=f"pulses-{number}"))
        write(_in_pulses(run, table, seed + number), folder / f"pulses-{number}.parquet")
    triad = Triad(TriadErrors({"scale_x_ppm": 9.2, "bias_z_deg_h": 0.02, "alpha_gy_arcsec": 5.1}))
    for step in (1, 2, 3):
        write(_without_truth(triad.simulate(f"step-{step}", seed=seed + step, step_s=0.02)), folder / f"step-{step}.parquet")


def noise(folder: Path, seed: int) -> None:
    """A gyro at rest for fifteen hours, as a logger wrote it, and one that turns on a table for an hour."""
    gyro = Simulator.from_mapping(
        {
            "kind": "chamber",
            "mechanisms": [{"warm_up": {"initial_deg_h": 0.02, "time_constant_s": 3600.0}}],
            "noise": {
                "angle_random_walk_deg_sqrt_h": 0.0003,
                "bias_instability_deg_h": 0.0006,
                "rate_random_walk_deg_h_sqrt_h": 0.0004,
                "quantization_arcsec": 0.005,
            },
        }
    )
    rest = gyro.simulate("start 20, hold 900", seed=seed, step_s=1.0).table
    names = {TIME: "Time [s]", "gyro_deg_h": "Gyro [deg/h]", "temperature_block_degC": "T [degC]"}
    rest[list(names)].rename(columns=names).to_csv(folder / "rest.csv", index=False, float_format="%.7g")
    turning = Simulator.from_mapping({"kind": "turntable", "mechanisms": ["scale_factor", "rotation_harmonics"]})
    write(_without_truth(turning.simulate("rate 60 3600", seed=seed, step_s=0.1)), folder / "turning.parquet")


def fleet(folder: Path, seed: int) -> None:
    """Four units with three short chamber runs each, the table of units, and two hours of a fifth unit."""
    rows = []
    for number in range(1, 5):
        name, gyro = f"unit-{number}", simulated_unit(seed + number)
        gyro.to_yaml(folder / f"{name}.yaml")
        for run in (1, 2, 3):
            recording = _without_truth(gyro.simulate("short", seed=10 * number + run, step_s=STEP_S, name=f"{name}-run-{run}"))
            write(recording, folder / f"{recording.name}.parquet")
        train = ";".join(f"{name}-run-{run}.parquet" for run in (1, 2))
        rows.append({"unit": name, "train": train, "test": f"{name}-run-3.parquet", "simulator": f"{name}.yaml"})
    pd.DataFrame(rows).to_csv(folder / "units.csv", index=False)
    new = simulated_unit(seed + 5).simulate("start 20, hold 15, ramp -20 1, hold 20, ramp 20 1, hold 5", seed=51, step_s=STEP_S)
    write(_without_truth(new), folder / "unit-5-two-hours.parquet")


@dataclasses.dataclass(frozen=True)
class Example:
    """A set of example data.

    Parameters
    ----------
    make : callable
        (folder, seed): writes the files.
    files : mapping of str to str
        Each file, or a pattern of several, with its content in words.
    """

    make: Callable[[Path, int], None]
    files: Mapping[str, str]

    @property
    def title(self) -> str:
        return str(self.make.__doc__)


EXAMPLES: Final = {
    "chamber": Example(
        chamber,
        {
            "simulator.yaml": "the laboratory's simulator of the gyro, which lacks one effect",
            "cold.parquet": "a chamber run of 11 h, cold side first",
            "hot.parquet": "another, hot side first, with minor loops",
            "new.parquet": "a third, on another programme: held out",
            "logger.csv": "the run cold as a logger wrote it: names and units of its own",
            "gyro.csv": "the run hot as two loggers wrote it: the gyro,",
            "thermometers.csv": "and the thermometers, on a clock of their own",
            "truth.yaml": "the gyro that made the runs: open it after the diagnosis",
        },
    ),
    "turntable": Example(
        turntable,
        {
            "to-and-fro.parquet": "a rate-biased gyro turned both ways by the rate table",
            "positions.parquet": "the same on a position table, at five settings of the rate table",
            "pulses-?.parquet": "two chamber runs of that gyro, in pulses",
            "step-?.parquet": "three gyros and accelerometers on a two-axis table, in three steps",
        },
    ),
    "noise": Example(
        noise,
        {
            "rest.csv": "a gyro at rest for 15 h, its first hours warming up",
            "turning.parquet": "a gyro at 60 deg/s for an hour, with the table's angle",
        },
    ),
    "fleet": Example(
        fleet,
        {
            "units.csv": "four units with their runs",
            "unit-?-run-?.parquet": "three chamber runs of each, 4 h",
            "unit-?.yaml": "the simulator of each",
            "unit-5-two-hours.parquet": "two hours of a fifth unit",
        },
    ),
}


def _without_truth(recording: Recording) -> Recording:
    """The recording as an instrument would have made it: without contributions, seed and programme."""
    return recording.replace(truth=None, metadata=dataclasses.replace(recording.metadata, notes={}))


def _as_logged(table: pd.DataFrame) -> pd.DataFrame:
    logged = table[list(LOGGER)].rename(columns=LOGGER)
    logged["Gyro Z [deg/s]"] /= SECONDS_PER_HOUR
    for name in ("T1 [K]", "T2 [K]"):
        logged[name] = convert(logged[name].to_numpy(), "degC", "K")
    return logged


def _in_pulses(run: Recording, table: PositionTable, seed: int) -> Recording:
    """The run as whole pulses of a gyro whose axis stands upright: the Earth's rate is in it."""
    upwards = EARTH_RATE_DEG_H * np.sin(table.latitude_deg * RAD_PER_DEG)
    arcsec = (run.rate_deg_h() + upwards) * STEP_S  # deg/h is arcsec/s
    counted = np.floor(np.cumsum(arcsec) / table.scale_arcsec + stream(seed, "pulse").uniform())
    pulses = np.diff(counted, prepend=counted[0] - round(arcsec[0] / table.scale_arcsec))
    columns = run.table.drop(columns=list(run.gyro_columns)).assign(gyro_pulses=pulses)
    return run.replace(table=columns, metadata=dataclasses.replace(run.metadata, latitude_deg=table.latitude_deg))
