"""Readers of further inputs: known physics, two loggers of one run, runs on tables, and the pages made of recordings."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final
from xml.etree import ElementTree

import numpy as np
import pandas as pd
from typer.testing import CliRunner

import rlgcomp as rlg
from experiments.fuzz.mutations import bytes_of, mutated_table, mutated_yaml, tokens_of
from rlgcomp.cli.base import app
from rlgcomp.compensation.feature_pipeline import FeatureRecipe
from rlgcomp.compensation.known_physics import known_physics
from rlgcomp.errors import InputError
from rlgcomp.files import from_yaml
from rlgcomp.recording.formats import csv, parquet
from rlgcomp.simulation.position_table import PositionTable
from rlgcomp.simulation.two_axis_table import Triad, reversing

PHYSICS: Final = """
kind: chamber
mechanisms:
  - thermal_polynomial: {degree: 2}
  - thermal_lag: {time_constant_s: 700}
  - thermal_hysteresis: {law: preisach, start: from_below, centre_degC: 15, span_K: 80}
  - mode_hop: {threshold_degC: 30, dead_band_K: 4, spacing_K: 10, hops: 2}
  - warm_up: {terms: two, time_constant_s: 900, slower_time_constant_s: 600}
  - tabulated_law: {cause: a curve, driver: temperature_block_degC, memory: none, knots: [-20, 0, 10, 50], weights: [0, 0.001, -0.001, 0.002]}
  - tabulated_law: {cause: lags, driver: temperature_block_degC, memory: lags, knots: [100, 2000], weights: [1.0e-4, -2.0e-4]}
  - tabulated_law: {cause: plays, driver: temperature_block_degC, memory: plays, start: below, knots: [1, 9], weights: [1.0e-4, 2.0e-4]}
  - tabulated_law: {cause: relays, driver: temperature_block_degC, memory: relays, start: unknown, knots: [20, 45], knots_2: [5, 30], weights: [0.001, -0.002]}
"""  # noqa: E501  a law a line
HYBRIDS: Final = ("hybrid", "laws", "dynamic")
STEPS: Final = ("step1", "step2", "step3")  # of a triad
_LONGEST_MESSAGE: Final = 8000
_CONTROL: Final = frozenset(map(chr, range(32))) - set("\t\n\r")  # no page holds one


def result_seeds(folder: Path, runs: list[rlg.Recording]) -> dict[str, Any]:
    """Models with known physics in a folder, and tables of runs on turntables.

    Parameters
    ----------
    folder : path
    runs : list of Recording
        Of a chamber.
    """
    mechanisms = from_yaml(PHYSICS)["mechanisms"]
    model = rlg.LSSVMRegressor(c=10.0, sigma=3.0)
    smooth = {"thermal_hysteresis": {"law": "bouc_wen"}}
    for name, part in {"hybrid": mechanisms[:5], "laws": [*mechanisms[5:], smooth]}.items():
        physics = rlg.Simulator.from_mapping({"kind": "chamber", "mechanisms": part})
        rlg.Compensator(model, features="temperature", physics=physics).fit(runs).save(folder / name)
    dynamic = rlg.LSSVMRegressor(c=10.0, sigma=3.0, linear="dynamics")
    rlg.Compensator(dynamic, features="temperature,lag").fit(runs).save(folder / "dynamic")
    turning = rlg.Simulator.from_mapping({"kind": "turntable", "mechanisms": ["scale_factor", "rotation_harmonics"]})
    programmes = (
        reversing(60.0, revolutions=1, repeats=2, outer_start_deg=90.0),
        reversing(60.0, revolutions=1, repeats=2),
        reversing(60.0, outer_deg_s=60.0, revolutions=1, repeats=4),
    )
    table = PositionTable()
    return {
        "to-and-fro": table.rate_recording(1, seed=1, step_s=0.05).table,
        "positions": table.position_recording([0, 90, 180], seed=2, step_s=0.1).table,
        "turning": turning.simulate("rate 60 900", seed=3, step_s=0.25).table,
        **{name: Triad().simulate(one, seed=4, step_s=0.05).table for name, one in zip(STEPS, programmes, strict=True)},
    }


def command(arguments: list[str]) -> None:
    """Run a command in this process.

    Raises
    ------
    InputError
        It ends with exit code 2 and a message.
    RuntimeError
        It ends with exit code 1, without a message, or with a very long one. What else it raises goes through.
    """
    result = CliRunner().invoke(app, arguments, env={"RLGCOMP_DEBUG": "1"})
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    if result.exit_code == 1:
        raise RuntimeError(f"exit code 1: {result.output[-200:]}")
    if result.exit_code == 2:
        if not 0 < len(result.stderr.strip()) < _LONGEST_MESSAGE:
            raise RuntimeError(f"exit code 2 with a message of {len(result.stderr.strip())} characters: {result.stderr[:100]}")
        raise InputError(result.stderr)


def physics_file(made: dict[str, Any], folder: Path, rng: np.random.Generator) -> None:
    """A mutated simulator as the known physics of a compensation: its causal terms, and now and then a whole training."""
    path, runs = folder / "augmented.yaml", made["runs"]
    path.write_bytes(mutated_yaml(from_yaml(PHYSICS), rng))
    if rng.random() < 0.2:
        files = [str(made["folder"] / f"{run.name}.parquet") for run in runs]
        fixed = ["--features", "temperature", "--out", str(folder / "model")]
        command(["train", *files, "--physics", str(path), *fixed])
        return
    terms = FeatureRecipe(known_physics(rlg.Simulator.from_yaml(path), runs).terms)
    terms.transform(runs[0])
    if FeatureRecipe.from_list(terms.to_list()) != terms:
        raise RuntimeError("the terms differ from their plain description")


def _saved(path: Path, table: pd.DataFrame, rng: np.random.Generator) -> Path:
    """A table as a file, some values, names or bytes of it changed; CSV by tokens too."""
    if rng.random() < 0.7:
        table = mutated_table(table, rng)
    form = csv if path.suffix == ".csv" else parquet
    try:
        form.save(path, table, {})
    except Exception:  # noqa: BLE001  what cannot be written is no file to read
        table.iloc[:, :1].to_csv(path.with_suffix(".csv"), index=False)
        return path.with_suffix(".csv")
    if form is csv and rng.random() < 0.4:
        path.write_bytes(tokens_of(path.read_text(encoding="utf-8"), rng).encode(errors="surrogatepass"))
    elif rng.random() < 0.2:
        path.write_bytes(bytes_of(path.read_bytes(), rng))
    return path


def two_loggers(made: dict[str, Any], folder: Path, rng: np.random.Generator) -> None:
    """The gyro and the thermometers of one run in two files, each mutated."""
    table = made["table"]
    thermometers = table[["time_s", "temperature_block_degC", "temperature_shell_degC"]].iloc[::2]
    thermometers = thermometers.assign(time_s=thermometers["time_s"] + 137.0)
    gyro = table.drop(columns="temperature_shell_degC")
    suffix = str(rng.choice([".csv", ".parquet"]))
    both = [_saved(folder / f"{name}{suffix}", one, rng) for name, one in (("gyro", gyro), ("slow", thermometers))]
    more = [[], ["--offset-s", "-137"], ["--drift-ppm", "1e9"], ["--averaging-s", "1e-9"], ["--shared", "temperature_block_degC"]]
    arguments = ["merge", *map(str, both), *more[int(rng.integers(0, len(more)))]]
    command([*arguments, "--out", str(folder / f"whole{rng.choice(['.csv', '.parquet', '.h5', '.mat'])}")])


def turntable(made: dict[str, Any], folder: Path, rng: np.random.Generator) -> None:
    """Runs on a rate table and a position table, or of a triad, one of them mutated, and their calibration with its page."""
    name, runs = [("scale-factor", ("to-and-fro", "positions")), ("calibrate", STEPS)][int(rng.integers(0, 2))]
    at = int(rng.integers(0, len(runs)))
    suffix = str(rng.choice([".csv", ".parquet"]))
    files = []
    for k, run in enumerate(runs):
        path = folder / f"{run}{suffix}"
        if k == at:
            path = _saved(path, made[run], rng)
        else:
            (csv if suffix == ".csv" else parquet).save(path, made[run], {})
        files.append(str(path))
    more = ["--latitude", "40", "--pulse-arcsec", "0.84279"] if name == "calibrate" else []
    more += ["--report", str(folder / "page")] if more and rng.random() < 0.3 else []
    command([name, *files, "--out", str(folder / "calibration.json"), *more])
    require_harmless(folder)


def pages(made: dict[str, Any], folder: Path, rng: np.random.Generator) -> None:
    """Pages of a mutated recording."""
    name = str(rng.choice(["allan", "arw", "evaluate", "train"]))
    path = folder / str(rng.choice(["run.parquet", "run.csv", "$x^{<b>.csv", "a b'.parquet"]))
    path = _saved(path, made["turning" if name == "arw" else "table"], rng)
    start = ["evaluate", str(made["folder"] / "model")] if name == "evaluate" else [name]
    more = {"train": ["--model", "cubic"], "evaluate": ["--no-comparison"]}.get(name, [])
    command([*start, str(path), *more, "--out", str(folder / "out")])
    require_harmless(folder / "out")


def require_harmless(folder: Path) -> None:
    """Refuse pages with text of a recording that is markup, and figures that are no XML.

    Raises
    ------
    RuntimeError
        There is one.
    """
    for page in folder.rglob("*.html"):
        text = page.read_text(encoding="utf-8")
        if "<script>alert" in text or _CONTROL & set(text):
            raise RuntimeError(f"{page.name} holds text of the recording as markup, or control characters")
    for figure in folder.rglob("*.svg"):
        ElementTree.parse(figure)  # noqa: S314  the package's own
