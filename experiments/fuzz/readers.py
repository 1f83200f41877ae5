"""Every reader of the package with a file for it to mutate."""
# ruff: noqa: ARG001, E501  readers are called alike; tables of values are one a line

from __future__ import annotations

import functools
import gzip
import json
import shutil
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd
from pyarrow.parquet import write_table

import rlgcomp as rlg
from experiments.fuzz.containers import MAKERS, MAPPINGS, arrow_of
from experiments.fuzz.mutations import NUMBERS, bytes_of, data_of, mutated_json, mutated_table, mutated_yaml, tokens_of
from experiments.fuzz.results import HYBRIDS, command, pages, physics_file, result_seeds, turntable, two_loggers
from rlgcomp.calibration.file import Calibration
from rlgcomp.challenge.seal import reveal
from rlgcomp.cli import register_commands
from rlgcomp.cli.diagnosis import measured_noise
from rlgcomp.compensation.compensator import load
from rlgcomp.compensation.models.specification import ModelSpecification
from rlgcomp.compensation.selection import select
from rlgcomp.files import from_json, from_yaml, sha256
from rlgcomp.fleet import read_fleet, run_fleet
from rlgcomp.recording.formats import FORMATS, column_names, csv, hdf5, matlab, parquet, read
from rlgcomp.recording.formats.pieces import gyros_of, read_pieces
from rlgcomp.report.inspection import outlier_findings, summarise
from rlgcomp.simulation.programme import Programme

Reader = Callable[[dict[str, Any], Path, np.random.Generator], object]
SIMULATOR: Final = """
kind: chamber
unit: S/N 7
mechanisms:
  - thermal_polynomial: {degree: 3}
  - temperature_rate: {k_deg_h_min_K: 0.02}
  - thermal_hysteresis
  - warm_up: {initial_deg_h: {value: 0.01, free: true}}
noise: {angle_random_walk_deg_sqrt_h: 0.0003, bias_instability_deg_h: 0.0005}
"""
COEFFICIENTS: Final = [
    {"gyro": "gyro_deg_h", "coefficients": {"angle_random_walk_deg_sqrt_h": {"value": 0.0003, "sd": 1e-5, "upper_limit": None}}}
]
CALIBRATIONS: Final = (
    {"schema": "rlgcomp.calibration/1", "kind": "gyro", "pulse_arcsec": 0.84, "bias_deg_h": 0.1},
    {
        "schema": "rlgcomp.calibration/1", "kind": "triad", "pulse_arcsec": None, "gyro_axes": "orthogonal",
        "parameters": [{"parameter": "bias_x_deg_h", "value": 0.1, "sd": 0.01}, {"parameter": "scale_x_ppm", "value": 12.0}],
    },
)  # fmt: skip
OPTIONS: Final = (
    "--averaging-s", "--model", "--features", "--gyro", "--map", "--drop", "--pulse-arcsec", "--jobs", "--seed", "--step-s", "--profile",
    "--json", "--calibration", "--out", "--noise", "--train", "--test", "--simulator", "--idle-s", "--follow", "--overwrite", "--to",
    "--period-s", "--help", "-x", "--", "--device", "--adapt", "--export",
    "--physics", "--max-bytes", "--max-centres", "--report", "--offset", "--offset-s", "--shared", "--hide", "--mechanism", "--tau",
)  # fmt: skip


def seeds(folder: Path) -> dict[str, Any]:
    """Small files of every kind, in a new folder."""
    register_commands()
    folder.mkdir(parents=True)
    (folder / "gyro.yaml").write_text(SIMULATOR, encoding="utf-8")
    simulator = rlg.Simulator.from_yaml(folder / "gyro.yaml")
    runs = [
        simulator.simulate("start 20, hold 10, ramp 40 2, hold 15", seed=seed, step_s=10.0, name=f"run{seed}") for seed in (1, 2)
    ]
    for run in runs:
        rlg.write(run, folder / f"{run.name}.parquet")
    model = rlg.Compensator(rlg.CubicLeastSquares(), features="temperature").fit(runs)
    model.save(folder / "model")
    X = np.linspace(0.0, 1.0, 40).reshape(-1, 2)
    choice = (rlg.LSSVMRegressor(), X, X.sum(axis=1), np.repeat([0, 1], 10))
    _select(choice, folder / "journal.jsonl")
    run_fleet(_touch, [rlg_unit("gyro-1", folder)], folder / "fleet")
    made = {"folder": folder, "runs": runs, "table": runs[0].table.iloc[:120], "metadata": runs[0].metadata.to_mapping()}
    return {**made, "choice": choice, **result_seeds(folder, runs)}


def _touch(unit: Any, folder: Path) -> dict[str, Any]:
    (folder / "value").write_text(unit.name)
    return {}


def rlg_unit(name: str, folder: Path) -> Any:
    """A unit of a fleet with one run."""
    from rlgcomp.fleet import Unit

    return Unit(name, (folder / "run1.parquet",))


def _select(choice: Any, journal: Path) -> None:
    from rlgcomp.compensation.models import MODELS

    model, X, y, groups = choice
    specification: ModelSpecification = MODELS["lssvm"]
    select(specification, model, X, y, groups, journal=journal)


def _inspect(path: Path, columns: dict[str, str] | None = None) -> None:
    column_names(path)
    run = read(path, columns=columns)
    outlier_findings(run)
    summarise(run)


def _recording(made: dict[str, Any], folder: Path, rng: np.random.Generator, *, form: Any, suffix: str) -> None:
    """A recording's file, mutated in its bytes, its table or its metadata."""
    path = folder / f"run{suffix}"
    table, metadata = made["table"].copy(), made["metadata"]
    if form is csv:
        text = table.to_csv(index=False)
        content = bytes_of(text.encode(), rng) if rng.random() < 0.4 else tokens_of(text, rng).encode(errors="surrogatepass")
        zipped = gzip.compress(content, 1) if suffix.endswith("gz") else content
        path.write_bytes(bytes_of(zipped, rng) if suffix.endswith("gz") and rng.random() < 0.3 else zipped)
    else:
        if rng.random() < 0.7:
            table = mutated_table(table, rng)
        if rng.random() < 0.5:
            metadata = data_of(metadata, rng)
        try:
            _save(form, path, table, metadata)
        except Exception:  # noqa: BLE001  what cannot be written is no file to read
            form.save(path, made["table"], made["metadata"])
        if rng.random() < 0.5:
            path.write_bytes(bytes_of(path.read_bytes(), rng))
    _inspect(path)


def _save(form: Any, path: Path, table: pd.DataFrame, metadata: dict[str, Any]) -> None:
    """As the format writes it; names that stand twice by Arrow, since the package does not write them."""
    if form is parquet and not table.columns.is_unique:
        write_table(arrow_of(table), path)
    else:
        form.save(path, table, metadata)


def _sidecar(made: dict[str, Any], folder: Path, rng: np.random.Generator) -> None:
    csv.save(folder / "run.csv", made["table"], {})
    stated = {**made["metadata"], "columns": {"gyro_deg_h": "gyro_deg_h"}, "pulse_arcsec": 0.8, "period_s": None}
    (folder / "run.yaml").write_bytes(mutated_yaml(stated, rng))
    _inspect(folder / "run.csv")


def _container(made: dict[str, Any], folder: Path, rng: np.random.Generator, *, suffix: str) -> None:
    """A file that the package only reads, mutated in its bytes or made of a mutated table; nothing where its library is absent."""
    table = made["table"]
    if rng.random() < 0.6:
        table = mutated_table(table, rng)
    path = folder / f"run{suffix}"
    try:
        MAKERS[suffix](path, table)
    except ImportError:
        return
    except Exception:  # noqa: BLE001  what cannot be written is no file to read
        path.unlink(missing_ok=True)
        MAKERS[suffix](path, made["table"])
    if rng.random() < 0.6:
        path.write_bytes(bytes_of(path.read_bytes(), rng))
    _inspect(path, MAPPINGS.get(suffix))


def _pieces(made: dict[str, Any], folder: Path, rng: np.random.Generator) -> None:
    suffix = str(rng.choice([".csv", ".parquet"]))
    with_fault = folder / f"run{suffix}"
    form = csv if suffix == ".csv" else parquet
    try:
        _save(form, with_fault, mutated_table(made["table"], rng), {})
    except Exception:  # noqa: BLE001  what cannot be written is no file to read
        form.save(with_fault, made["table"], {})
    if rng.random() < 0.6:
        with_fault.write_bytes(bytes_of(with_fault.read_bytes(), rng))
    for gyro in gyros_of(with_fault):
        for _ in read_pieces(with_fault, gyro, rows=1000):
            pass


def _simulator(made: dict[str, Any], folder: Path, rng: np.random.Generator) -> None:
    (folder / "gyro.yaml").write_bytes(mutated_yaml(from_yaml(SIMULATOR), rng))
    simulator = rlg.Simulator.from_yaml(folder / "gyro.yaml")
    run = simulator.simulate("start 20, hold 10, ramp 30 2", seed=1, step_s=20.0)
    simulator.predict(run)
    simulator.to_yaml(folder / "again.yaml")
    rlg.Simulator.from_yaml(folder / "again.yaml")


def _programme(made: dict[str, Any], folder: Path, rng: np.random.Generator) -> None:
    text = tokens_of("start 20, hold 60, ramp -40 1, hold 120".replace(", ", ",\n"), rng).replace("\n", " ")
    Programme.parse(text)
    made["simulator"] = made.get("simulator") or rlg.Simulator.from_yaml(made["folder"] / "gyro.yaml")
    made["simulator"].simulate(text, seed=1, step_s=30.0)


def _noise(made: dict[str, Any], folder: Path, rng: np.random.Generator) -> None:
    value: Any = COEFFICIENTS if rng.random() < 0.5 else {"noise": {"angle_random_walk_deg_sqrt_h": 0.0003}}
    (folder / "noise.json").write_bytes(mutated_json(value, rng) if rng.random() < 0.5 else mutated_yaml(value, rng))
    measured_noise(folder / "noise.json", None)


def _calibration(made: dict[str, Any], folder: Path, rng: np.random.Generator) -> None:
    value = CALIBRATIONS[int(rng.integers(0, 2))]
    (folder / "cal.json").write_bytes(mutated_json(value, rng))
    Calibration.read(folder / "cal.json")


def _model(made: dict[str, Any], folder: Path, rng: np.random.Generator, *, names: Sequence[str] = ("model",)) -> None:
    model = folder / "model"
    shutil.copytree(made["folder"] / str(rng.choice(names)), model)
    files = sorted(path for path in model.rglob("*") if path.is_file())
    file = files[int(rng.integers(0, len(files)))]
    if file.name == "manifest.json" and rng.random() < 0.8:
        file.write_bytes(mutated_json(from_json(file.read_bytes()), rng))
    else:
        file.write_bytes(bytes_of(file.read_bytes(), rng))
    if rng.random() < 0.8 and file.name != "SHA256SUMS":
        listed = [path for path in files if path.name != "SHA256SUMS"]
        (model / "SHA256SUMS").write_text("".join(f"{sha256(path)}  {path.relative_to(model).as_posix()}\n" for path in listed))
    loaded = load(model)
    loaded.correct(rlg.Recording(made["table"]))


def _challenge(made: dict[str, Any], folder: Path, rng: np.random.Generator) -> None:
    truth = {
        "schema": "rlgcomp.truth/1", "hidden": ["warm_up"], "parameters": {"warm_up.amplitude_deg_h": 0.01}, "intervals": {"run1": [[0, 10]]},
        "files": {}, "strengths": {"warm_up": 1.0}, "possible_rms_deg_h": 0.001,
    }  # fmt: skip
    from rlgcomp.challenge import seal

    challenge = {"schema": seal.CHALLENGE_SCHEMA, "train": [], "test": [], "truth": "truth.json"}
    answer = {
        "schema": "rlgcomp.diagnosis/1", "verdict": "explained", "findings": [{"mechanism": "warm_up", "probability": 0.9, "parameters": {}, "indistinguishable_from": []}],
        "mismatch": {"where": [{"run": "run1", "start_s": 0, "end_s": 5}]}, "fit": {"test": {"baseline_rms": 1.0, "augmented_rms": 0.5}},
    }  # fmt: skip
    truth |= {"schema": seal.TRUTH_SCHEMA, "challenge": challenge}
    for name, value in {"truth": truth, "challenge": challenge, "diagnosis": answer}.items():
        content = mutated_json(value, rng) if rng.random() < 0.5 else json.dumps(value).encode()
        (folder / f"{name}.json").write_bytes(content)
    try:
        stated = from_json((folder / "challenge.json").read_bytes())
        stated["truth_sha256"] = sha256(folder / "truth.json")
        (folder / "challenge.json").write_text(json.dumps(stated))
    except (ValueError, TypeError):
        pass
    reveal(folder, folder / "diagnosis.json")


def _journal(made: dict[str, Any], folder: Path, rng: np.random.Generator) -> None:
    lines = (made["folder"] / "journal.jsonl").read_bytes().splitlines()
    at = int(rng.integers(0, len(lines)))
    lines[at] = mutated_json(from_json(lines[at]), rng)
    (folder / "journal.jsonl").write_bytes(b"\n".join(lines))
    _select(made["choice"], folder / "journal.jsonl")


def _units(made: dict[str, Any], folder: Path, rng: np.random.Generator) -> None:
    text = "unit,train,test,simulator\ngyro-1,run1.parquet;run2.parquet,run2.parquet,gyro.yaml\ngyro-2,run2.parquet,,\n"
    content = tokens_of(text, rng).encode(errors="surrogatepass") if rng.random() < 0.5 else bytes_of(text.encode(), rng)
    (folder / "units.csv").write_bytes(content)
    read_fleet(folder / "units.csv")


def _unit_note(made: dict[str, Any], folder: Path, rng: np.random.Generator) -> None:
    shutil.copytree(made["folder"] / "fleet", folder / "fleet")
    note = folder / "fleet" / "gyro-1" / "unit.json"
    note.write_bytes(mutated_json(from_json(note.read_bytes()), rng))
    run_fleet(_touch, [rlg_unit("gyro-1", made["folder"])], folder / "fleet")


def _resumed(made: dict[str, Any], folder: Path, rng: np.random.Generator, *, names: Sequence[str] = ("model",)) -> None:
    """A stream and its output of an earlier run, each mutated; a resumed state."""
    model = str(rng.choice(names))
    earlier = f"output of {model}"
    made["table"].to_csv(folder / "in.csv", index=False)
    arguments = [
        "compensate",
        str(made["folder"] / model),
        str(folder / "in.csv"),
        "--follow",
        "--idle-s",
        "0",
        "--out",
        str(folder / "out.csv"),
    ]
    if rng.random() < 0.6:
        text = (folder / "in.csv").read_text()
        content = tokens_of(text, rng).encode(errors="surrogatepass") if rng.random() < 0.6 else bytes_of(text.encode(), rng)
        (folder / "in.csv").write_bytes(content)
    elif earlier not in made:
        command(arguments)
        made[earlier] = (folder / "out.csv").read_bytes()
    if earlier in made and rng.random() < 0.6:
        (folder / "out.csv").write_bytes(bytes_of(made[earlier], rng))
    command(arguments)


def _command_line(made: dict[str, Any], folder: Path, rng: np.random.Generator) -> None:
    """A command with options that are no good."""
    root = made["folder"]
    values = [
        str(root / "run1.parquet"),
        str(root / "gyro.yaml"),
        str(root / "model"),
        str(root),
        "-",
        "",
        "\x1b[2J",
        "a=b",
        "x@0:1",
        "x@:",
        *NUMBERS,
    ]
    name = str(rng.choice(["inspect", "simulate", "predict", "train", "evaluate", "compensate", "allan", "arw", "export", "calibrate",
                           "scale-factor", "fleet", "conceal", "reveal", "mechanisms", "models", "example", "merge", "diagnose",
                           "sensitivity", "nonsense"]))  # fmt: skip
    arguments = [name]
    arguments += [str(rng.choice(OPTIONS if rng.random() < 0.45 else values)) for _ in range(int(rng.integers(0, 7)))]
    arguments += ["--out", str(folder / f"out{rng.choice(['', '.csv', '.h5', '.parquet', '.json'])}")] if rng.random() < 0.5 else []
    command([one.replace("\x00", "") for one in arguments])


READERS: Final[dict[str, Reader]] = {
    "csv": functools.partial(_recording, form=csv, suffix=".csv"),
    "csv.gz": functools.partial(_recording, form=csv, suffix=".csv.gz"),
    "parquet": functools.partial(_recording, form=parquet, suffix=".parquet"),
    "hdf5": functools.partial(_recording, form=hdf5, suffix=".h5"),
    "matlab": functools.partial(_recording, form=matlab, suffix=".mat"),
    **{suffix: functools.partial(_container, suffix=suffix) for suffix in MAKERS},
    "sidecar": _sidecar,
    "pieces": _pieces,
    "simulator": _simulator,
    "programme": _programme,
    "noise": _noise,
    "calibration": _calibration,
    "model": _model,
    "model with physics": functools.partial(_model, names=HYBRIDS),
    "physics": physics_file,
    "challenge": _challenge,
    "journal": _journal,
    "units": _units,
    "unit.json": _unit_note,
    "follow": _resumed,
    "follow with physics": functools.partial(_resumed, names=HYBRIDS),
    "merge": two_loggers,
    "turntable": turntable,
    "pages": pages,
    "command line": _command_line,
}
assert {csv, hdf5, matlab, parquet} <= set(FORMATS)  # noqa: S101  each of the package's formats is mutated
