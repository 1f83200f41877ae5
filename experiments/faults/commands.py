"""The commands that are disturbed, and the inputs of all of them."""

from __future__ import annotations

import dataclasses
import shutil
from pathlib import Path
from typing import Final

import numpy as np

from experiments.faults.process import in_a_process, run

SIMULATOR: Final = """
kind: chamber
mechanisms:
  - thermal_polynomial: {degree: 3}
  - temperature_rate: {k_deg_h_min_K: 0.02}
noise: {angle_random_walk_deg_sqrt_h: 0.0003}
"""
PHYSICS: Final = """
kind: chamber
mechanisms:
  - thermal_polynomial: {degree: 2}
  - thermal_hysteresis: {law: plays, radius_K: 8}
  - thermal_lag: {time_constant_s: 700}
  - mode_hop: {threshold_degC: 30, dead_band_K: 4}
"""


@dataclasses.dataclass(frozen=True)
class Command:
    """A command line, with `{variant}` in it, and the names of what it writes.

    Parameters
    ----------
    name : str
    arguments : tuple of str
    writes : tuple of str
    grows : {"", "lines", "units"}
        What its output is finished by, one after another, instead of as a whole. Output that grows by lines has nothing in place
        before: a stream goes on with what an earlier one of the same input wrote.
    """

    name: str
    arguments: tuple[str, ...]
    writes: tuple[str, ...]
    grows: str = ""

    def line(self, variant: int) -> list[str]:
        """Arguments of the earlier result (0) or of the new one (1)."""
        return [one.replace("{variant}", str(1 + variant)) for one in self.arguments]


_SHORT: Final = ("simulate", "gyro.yaml", "--profile", "short", "--seed", "{variant}", "--out")
_FLEET: Final = ("fleet", "train", "units{variant}.csv", "--model", "cubic", "--jobs", "2", "--out", "fleet")
_FOLLOW: Final = ("run3.csv", "--follow", "--idle-s", "0", "--out", "f.csv")
_TRAIN: Final = ("train", "run1.parquet", "run2.parquet", "--averaging-s", "{variant}00")
_CONCEAL: Final = (
    "conceal",
    "gyro.yaml",
    "--hide",
    "temperature_rate",
    "--seed",
    "{variant}",
    "--step-s",
    "10",
    "--out",
    "challenge{variant}",
)
_DIAGNOSE: Final = (
    "diagnose",
    "--simulator",
    "poly{variant}.yaml",
    "--train",
    "run1.parquet",
    "--test",
    "run2.parquet",
    "--only",
    "temperature_rate",
    "--out",
    "diagnosis",
)
_CALIBRATE: Final = (
    "calibrate",
    "step1.parquet",
    "step2.parquet",
    "step3.parquet",
    "--angle-random-walk",
    "0.000{variant}",
    "--out",
    "calibration.json",
)
_SCALE_FACTOR: Final = ("scale-factor", "turns{variant}.parquet", "positions.parquet", "--out", "k.json")
COMMANDS: Final = (
    Command("simulate csv", (*_SHORT, "o.csv"), ("o.csv", "o.yaml")),
    Command("simulate parquet", (*_SHORT, "o.parquet"), ("o.parquet",)),
    Command("simulate hdf5", (*_SHORT, "o.h5"), ("o.h5",)),
    Command("predict", ("predict", "gyro.yaml", "run{variant}.parquet", "--out", "p.tsv"), ("p.tsv", "p.yaml")),
    Command("train", (*_TRAIN, "--out", "model"), ("model",)),
    Command("train physics", (*_TRAIN, "--physics", "physics.yaml", "--features", "temperature", "--out", "model"), ("model",)),
    Command("fleet", _FLEET, ("fleet/a", "fleet/b"), grows="units"),
    Command("compensate", ("compensate", "cubic", "run{variant}.parquet", "--out", "c.parquet"), ("c.parquet",)),
    Command("follow", ("compensate", "cubic", *_FOLLOW), ("f.csv",), grows="lines"),
    Command("follow physics", ("compensate", "hybrid", *_FOLLOW), ("f.csv",), grows="lines"),
    Command("evaluate", ("evaluate", "cubic", "run{variant}.parquet", "--no-comparison", "--out", "report"), ("report",)),
    Command("export", ("export", "cubic{variant}", "--to", "c", "--no-board", "--name", "m", "--out", "code"), ("code",)),
    Command("conceal", _CONCEAL, ("challenge2",)),
    Command("allan", ("allan", "run{variant}.parquet", "--out", "allan"), ("allan",)),
    Command("arw", ("arw", "turning{variant}.parquet", "--out", "arw"), ("arw",)),
    Command("scale-factor", _SCALE_FACTOR, ("k.json", "k.html")),
    Command("diagnose", _DIAGNOSE, ("diagnosis",)),
    Command("calibrate", _CALIBRATE, ("calibration.json",)),
    Command("merge", ("merge", "run{variant}.parquet", "slow.csv", "--offset-s", "0", "--out", "m.csv"), ("m.csv", "m.yaml")),
    Command("example", ("example", "chamber", "--seed", "{variant}", "--out", "example"), ("example",)),
)  # fmt: skip


def prepare(folder: Path) -> None:
    """Inputs of all commands, in a new folder."""
    folder.mkdir(parents=True)
    (folder / "gyro.yaml").write_text(SIMULATOR, encoding="utf-8")
    for variant in (1, 2):
        text = SIMULATOR.replace("  - temperature_rate: {k_deg_h_min_K: 0.02}\n", "").replace("degree: 3", f"degree: {variant + 1}")
        (folder / f"poly{variant}.yaml").write_text(text, encoding="utf-8")
    for seed in (1, 2, 3):
        out = "run3.csv" if seed == 3 else f"run{seed}.parquet"
        simulate = ["simulate", "gyro.yaml", "--profile", "short", "--step-s", "5", "--seed", str(10 + seed), "--out", out]
        run(folder, simulate).check()
    lines = (folder / "run3.csv").read_text().splitlines()
    times_and_temperatures = [",".join(np.take(line.split(","), [0, 2])) for line in lines[::12]]
    (folder / "slow.csv").write_text("\n".join(times_and_temperatures).replace("temperature_block", "temperature_wall") + "\n")
    for variant, averaging in ((1, "100"), (2, "200")):
        model = ["--model", "cubic", "--averaging-s", averaging, "--out", f"cubic{variant}"]
        run(folder, ["train", "run1.parquet", "run2.parquet", *model]).check()
        other = "run1.parquet;run2.parquet" if variant == 1 else "run2.parquet;run1.parquet"
        (folder / f"units{variant}.csv").write_text(f"unit,train\na,{other}\nb,{other}\n")
    shutil.copytree(folder / "cubic1", folder / "cubic")
    (folder / "physics.yaml").write_text(PHYSICS, encoding="utf-8")
    hybrid = ["--physics", "physics.yaml", "--features", "temperature", "--out", "hybrid"]
    run(folder, ["train", "run1.parquet", "run2.parquet", *hybrid]).check()
    in_a_process(lambda: _table_runs(folder))


def _table_runs(folder: Path) -> None:
    """Runs of a gyro that turns, to and fro or on, and a triad's three steps on a two-axis table, shortened."""
    import rlgcomp as rlg
    from rlgcomp.simulation.position_table import PositionTable
    from rlgcomp.simulation.two_axis_table import Triad, reversing

    programmes = (
        reversing(30.0, revolutions=1, repeats=2, outer_start_deg=90.0),
        reversing(30.0, revolutions=1, repeats=2),
        reversing(30.0, outer_deg_s=60.0, revolutions=1, repeats=4),
    )
    for k, programme in enumerate(programmes, start=1):
        rlg.write(Triad().simulate(programme, seed=k, step_s=0.02, name=f"step{k}"), folder / f"step{k}.parquet")
    turning = rlg.Simulator.from_mapping({"kind": "turntable", "mechanisms": ["scale_factor", "rotation_harmonics"]})
    table = PositionTable()
    rlg.write(table.position_recording([0, 60, 120, 180], seed=5), folder / "positions.parquet")
    for k in (1, 2):
        rlg.write(turning.simulate("rate 60 900", seed=k, step_s=0.25), folder / f"turning{k}.parquet")
        rlg.write(table.rate_recording(3, seed=k), folder / f"turns{k}.parquet")
