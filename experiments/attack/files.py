"""Cases: a hostile file in the place of a good one, and the command that reads it."""
# ruff: noqa: E501  tables of values are one a line

from __future__ import annotations

import copy
import dataclasses
import hashlib
import json
import os
import random
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Final

import yaml

from experiments.attack.process import Result, apart, command
from experiments.attack.tables import ENTRIES, NAMES, csv_bytes, document, file_bytes, healthy, splice, strange
from rlgcomp.recording.formats import write
from rlgcomp.simulation.two_axis_table import Triad, reversing

SIMULATOR: Final = """
kind: chamber
mechanisms:
  - thermal_polynomial: {degree: 2, c1_deg_h_K: {value: 0.01, free: true}}
  - thermal_lag: {time_constant_s: 600}
noise: {angle_random_walk_deg_sqrt_h: 0.0005}
"""
TURNTABLE: Final = """
kind: turntable
mechanisms: [scale_factor, {lock_in: {}}, rotation_harmonics]
noise: {angle_random_walk_deg_sqrt_h: 0.001}
"""
PROGRAMME: Final = "start 20, hold 10, ramp 35 2, hold 10"
MEMORY_GB: Final = 6.0
CONTROL: Final = ("stdout.txt", "stderr.txt", "changes.txt")


@dataclasses.dataclass(frozen=True)
class Case:
    """A case that went wrong: its number, what was read, the command, and the problem."""

    number: int
    kind: str
    arguments: tuple[str, ...]
    problem: str
    message: str


def seeds(folder: Path) -> None:
    """Good files of all kinds that commands read."""
    folder.mkdir(parents=True)
    apart(lambda: _recordings(folder))
    (folder / "gyro.yaml").write_text(SIMULATOR)
    (folder / "table.yaml").write_text(TURNTABLE)
    (folder / "programme.yaml").write_text(yaml.safe_dump({"programme": PROGRAMME}))
    for arguments in (
        [
            "train",
            "good0.parquet",
            "good1.parquet",
            "--model",
            "cubic",
            "--features",
            "temperature,temperature_rate",
            "--out",
            "cubic",
        ],
        ["train", "good0.parquet", "good1.parquet", "--model", "lssvm", "--features", "temperature", "--out", "lssvm"],
        ["conceal", "gyro.yaml", "--hide", "thermal_lag", "--seed", "3", "--step-s", "20", "--out", "challenge"],
        ["simulate", "table.yaml", "--profile", "rate 10 300, rate -10 300", "--out", "table.parquet"],
        ["compensate", "cubic", "good2.csv", "--follow", "--idle-s", "0", "--out", "stream.csv"],
    ):
        result = command(arguments, folder, longest_s=600.0)
        if result.code:
            raise RuntimeError(f"{arguments}: {result.error}")
    (folder / "units.csv").write_text("unit,train\nu1,good0.parquet;good1.parquet\n")
    diagnosis = {"schema": "rlgcomp.diagnosis/1", "verdict": "explained", "mismatch": {"p_value": 0.001, "where": []}}
    diagnosis |= {
        "findings": [
            {
                "mechanism": "thermal_lag",
                "probability": 0.99,
                "parameters": {},
                "drivers": [],
                "equation": "",
                "rms": {"value": 0.1, "unit": "deg/h"},
            }
        ],
        "alternatives": [],
    }
    diagnosis["findings"][0]["indistinguishable_from"] = []
    diagnosis["unexplained"] = {"p_value": 0.4, "drivers": [], "memory": "none", "equation": None}
    part = {"baseline_rms": 1.0, "augmented_rms": 0.5, "noise_floor_rms": 0.4, "unit": "deg/h", "averaging_s": 100, "per_run": []}
    diagnosis["fit"] = {"train": part, "test": part | {"improvement": 0.5, "improvement_ci95": [0.4, 0.6]}}
    (folder / "diagnosis.json").write_text(json.dumps(diagnosis))
    result = command(["calibrate", *(f"step{k}.parquet" for k in range(3)), "--out", "calibration.json"], folder, longest_s=600.0)
    if result.code:
        raise RuntimeError(result.error)


def _recordings(folder: Path) -> None:
    """Chamber runs of a gyro and of a triad, and the triad on a table."""
    import numpy as np
    import pandas as pd

    for k in range(3):
        frame = pd.DataFrame(healthy(np.random.default_rng(k), 1800))
        frame.to_csv(folder / "good2.csv", index=False) if k == 2 else frame.to_parquet(folder / f"good{k}.parquet")
    rng = np.random.default_rng(9)
    for k in range(2):
        table = healthy(rng, 1800)
        rate = table.pop("gyro_deg_h")
        pulses = {f"gyro_{axis}_pulses": np.round(rate * 2.0 / 0.84279) for axis in "xyz"}
        pd.DataFrame(table | pulses).to_csv(folder / f"triad{k}.csv", index=False)
        (folder / f"triad{k}.yaml").write_text("pulse_arcsec: 0.84279\nlatitude_deg: 40.0\n")
    programmes = {
        "step0": reversing(30.0, revolutions=1, repeats=2, outer_start_deg=90.0),
        "step1": reversing(30.0, revolutions=1, repeats=2),
    }
    programmes["step2"] = reversing(30.0, outer_deg_s=60.0, revolutions=1, repeats=4)
    for k, (name, programme) in enumerate(programmes.items()):
        write(Triad().simulate(programme, seed=k, step_s=0.01, name=name), folder / f"{name}.parquet")


def _graft(value: Any, rng: random.Random, words: list[Any]) -> Any:
    """Plain data in which one part stands in the place of another, or is of another type."""
    value = copy.deepcopy(value)
    places: list[tuple[Any, Any]] = []

    def walk(part: Any) -> None:
        for key in part if isinstance(part, dict) else range(len(part)) if isinstance(part, list) else ():
            places.append((part, key))
            walk(part[key])

    walk(value)
    if not places:
        return document(rng)
    for _ in range(rng.choice((1, 1, 2, 4))):
        part, key = rng.choice(places)
        source, other = rng.choice(places)
        try:
            old = part[key]
            what = rng.randrange(9)
            if what == 0:
                part[key] = copy.deepcopy(source[other])
            elif what == 1:
                part[key] = document(rng)
            elif what == 2:
                part[key] = [old] * rng.choice((0, 1, 3, 1000))
            elif what == 3:
                part[key] = {str(rng.choice(words)): old}
            elif what == 4:
                part[key] = rng.choice((float("nan"), float("inf"), -1, 0, 10**19, 1e-300, 1e300, -1e300, 2**63))
            elif what == 5:
                part[key] = str(old)
            elif what == 6 and isinstance(part, dict):
                part[rng.choice(words)] = part.pop(key)
            elif what == 7:
                del part[key]
            else:
                part[key] = rng.choice(words)
        except (KeyError, IndexError, TypeError):
            continue
    return value


def _words(value: Any) -> list[Any]:
    if isinstance(value, dict):
        return [*map(str, value), *(word for one in value.values() for word in _words(one))]
    if isinstance(value, list):
        return [word for one in value for word in _words(one)]
    return [str(value), *NAMES[:4], *ENTRIES[:4]]


def _hostile_yaml(path: Path, rng: random.Random) -> None:
    value = (
        yaml.safe_load(path.read_text())
        if path.exists()
        else {"kind": "chamber", "unit": "A", "notes": {"x": 1}, "columns": {"gyro_deg_h": "gyro_deg_h"}}
    )
    text = yaml.safe_dump(_graft(value, rng, _words(value)), allow_unicode=True, default_flow_style=rng.choice((None, True, False)))
    if rng.random() < 0.25:
        lines = text.splitlines()
        lines.insert(rng.randrange(len(lines) + 1), rng.choice(("- - - [", "&a [*a, *a]", "? {a: b}", "<<: {kind: x}", "!!python/object:os.system x", "\tx: 1", "%YAML 9.9", "---", "...", "x: !!binary ====", "x: !!set {a, b}", "x: 0o777777777777777777777777", "x: 190:20:30", "kind: chamber")))  # fmt: skip
        text = "\n".join(lines)
    path.write_text(text)


def _hostile_json(path: Path, rng: random.Random) -> None:
    try:
        value = json.loads(path.read_text())
    except ValueError:  # grafted already
        return
    text = json.dumps(_graft(value, rng, _words(value)), default=str)
    if rng.random() < 0.2:
        text = splice(text.encode(), text.encode(), rng).decode(errors="replace")
    path.write_text(text)


def _hostile_model(folder: Path, rng: random.Random) -> None:
    """A part of a model folder replaced, and its checksums mostly made anew, as who writes the folder can."""
    import numpy as np

    files = sorted(path for path in folder.rglob("*") if path.is_file() and path.name != "SHA256SUMS")
    for _ in range(rng.choice((1, 1, 2))):
        path = rng.choice([*files, *([folder / "manifest.json"] * 8)])
        if path.suffix == ".json":
            _hostile_json(path, rng)
        elif path.suffix == ".npy":
            try:
                values = np.load(path)
            except ValueError:  # replaced already
                continue
            with np.errstate(all="ignore"):
                kinds: list[Callable[[], Any]] = [
                    lambda values=values: values[:-1],
                    lambda values=values: np.nextafter(values, np.inf),
                    lambda values=values: values.reshape(-1),
                    lambda values=values: values[None],
                    lambda values=values: values.astype(np.float32),
                    lambda values=values: np.full_like(values, rng.choice((np.nan, np.inf, 0.0, 1e308, -1e200))),
                    lambda values=values: np.empty((0, *values.shape[1:])),
                    lambda values=values: np.array([{"a": 1}], dtype=object),
                    lambda values=values: values * 1e200,
                    lambda values=values: np.asfortranarray(np.atleast_2d(values)),
                    lambda values=values: np.repeat(values, 3, axis=0),
                ]
                np.save(path, rng.choice(kinds)(), allow_pickle=True)
        else:
            path.write_bytes(splice(path.read_bytes(), path.read_bytes(), rng))
    if rng.random() < 0.85:
        names = sorted(path for path in folder.rglob("*") if path.is_file() and path.name != "SHA256SUMS")
        lines = [f"{hashlib.sha256(path.read_bytes()).hexdigest()}  {path.relative_to(folder).as_posix()}" for path in names]
        (folder / "SHA256SUMS").write_text("\n".join(lines) + "\n")


def _recording(place: Path, rng: random.Random) -> list[str]:
    ending, content = file_bytes(rng)
    name = f"x{ending}"
    (place / name).write_bytes(content)
    if rng.random() < 0.05:
        (place / "x.yaml").write_text(yaml.safe_dump(document(rng), allow_unicode=True))
    return rng.choice(
        (
            ["inspect", name],
            ["inspect", name, "good0.parquet", "--json"],
            ["allan", name, "--out", "out"],
            ["allan", name, "--in-pieces", "--json"],
            ["arw", name, "--json"],
            ["scale-factor", name],
            ["merge", "good0.parquet", name, "--out", "out.parquet"],
            ["merge", name, "good0.parquet", "--out", "out.csv"],
            ["train", name, "good1.parquet", "--model", "cubic", "--out", "out"],
            ["train", name, name, "--model", "lssvm", "--averaging-s", "30", "--out", "out"],
            ["compensate", "cubic", name, "--out", "out.h5"],
            ["compensate", "lssvm", name, "--out", "out.csv"],
            ["evaluate", "cubic", name, "--no-comparison", "--out", "out"],
            ["predict", "gyro.yaml", name, "--out", "out.csv"],
            ["calibrate", name, "--out", "out.json"],
        )
    )


def _sidecar(place: Path, rng: random.Random) -> list[str]:
    name = "good2.yaml" if rng.random() < 0.5 else "good0.yaml"
    _hostile_yaml(place / name, rng)
    return ["inspect", "good2.csv" if name == "good2.yaml" else "good0.parquet"]


def _simulator(place: Path, rng: random.Random) -> list[str]:
    name = rng.choice(("gyro.yaml", "table.yaml"))
    _hostile_yaml(place / name, rng)
    if name == "gyro.yaml" and rng.random() < 0.4:
        return ["predict", name, "good0.parquet", "--out", "out.parquet"]
    return ["simulate", name, "--profile", PROGRAMME if name == "gyro.yaml" else "rate 5 60, rate -5 60", "--out", "out.csv"]


def _programme(place: Path, rng: random.Random) -> list[str]:
    if rng.random() < 0.5:
        _hostile_yaml(place / "programme.yaml", rng)
        return ["simulate", "gyro.yaml", "--profile", "programme.yaml", "--step-s", "10", "--out", "out.csv"]
    words = (
        "start",
        "hold",
        "ramp",
        "rate",
        "rest",
        "sweep",
        "-1e9",
        "1e300",
        "nan",
        "0",
        "20",
        "5",
        ",",
        ",,",
        "",
        "1e-9",
        "inf",
        "10 10 10",
    )
    text = " ".join(rng.choice(words) for _ in range(rng.randrange(1, 12)))
    return ["simulate", rng.choice(("gyro.yaml", "table.yaml")), f"--profile={text}", "--step-s", rng.choice(("10", "1e-9", "0", "nan", "1e9", "-1")), "--out", "out.csv"]  # fmt: skip


def _model(place: Path, rng: random.Random) -> list[str]:
    model = rng.choice(("cubic", "lssvm"))
    _hostile_model(place / model, rng)
    return rng.choice(
        (
            ["compensate", model, "good0.parquet", "--out", "out.parquet"],
            ["compensate", model, "good2.csv", "--follow", "--idle-s", "0", "--out", "out.csv"],
            ["models", "."],
            ["evaluate", model, "good1.parquet", "--no-comparison", "--out", "out"],
            ["export", model, "--to", "c", "--no-board", "--out", "out"],
            ["train", "good1.parquet", "--adapt", model, "--out", "out"],
        )
    )


def _challenge(place: Path, rng: random.Random) -> list[str]:
    path = place / "challenge" / rng.choice(("challenge.json", "truth.json"))
    if rng.random() < 0.4:
        path = place / "diagnosis.json"
    _hostile_json(path, rng)
    if path.name == "truth.json" and rng.random() < 0.7:  # sealed anew
        index = place / "challenge" / "challenge.json"
        index.write_text(
            json.dumps(json.loads(index.read_text()) | {"truth_sha256": hashlib.sha256(path.read_bytes()).hexdigest()})
        )
    return ["reveal", "challenge", "diagnosis.json"]


def _calibration(place: Path, rng: random.Random) -> list[str]:
    _hostile_json(place / "calibration.json", rng)
    return [
        "train",
        "triad0.csv",
        "triad1.csv",
        "--gyro",
        "gyro_x_deg_h",
        "--calibration",
        "calibration.json",
        "--model",
        "cubic",
        "--out",
        "out",
    ]


def _units(place: Path, rng: random.Random) -> list[str]:
    cells = (
        "u1",
        "u2",
        "",
        "..",
        "a/b",
        "good0.parquet;good1.parquet",
        "good0.parquet",
        ";",
        "nowhere.csv",
        "/dev/zero",
        "é",
        "\x00",
        "u1 ",
        "x" * 300,
        "fleet.json",
    )
    lines = [",".join(rng.choice(cells) for _ in range(rng.choice((2, 2, 2, 3)))) for _ in range(rng.randrange(4))]
    header = rng.choice(
        ("unit,train", "unit,train", "train,unit", "unit;train", "unit,train,train", "unit", "", "unit,train,test,simulator")
    )
    (place / "units.csv").write_bytes("\n".join([header, *lines]).encode(rng.choice(("utf-8", "utf-8", "utf-16"))))
    return ["fleet", "train", "units.csv", "--model", "cubic", "--out", "out"]


def _stream(place: Path, rng: random.Random) -> list[str]:
    """A growing file and what an earlier run wrote of it."""
    text = (place / "stream.csv").read_bytes()
    lines = text.splitlines(keepends=True)
    what = rng.randrange(5)
    if what == 0:
        (place / "stream.csv").write_bytes(b"".join(lines[: rng.randrange(len(lines))]) + splice(lines[-1], lines[0], rng))
    elif what == 1:
        (place / "stream.csv").write_bytes(splice(text, text, rng))
    elif what == 2:
        (place / "good2.csv").write_bytes(csv_bytes(strange(rng), rng))
        (place / "stream.csv").unlink()
    elif what == 3:
        _hostile_yaml(place / "stream.yaml", rng)
    else:
        source = (place / "good2.csv").read_bytes()
        (place / "good2.csv").write_bytes(splice(source, source, rng))
        (place / "stream.csv").write_bytes(b"".join(lines[: rng.randrange(len(lines))]))
    return ["compensate", "cubic", "good2.csv", "--follow", "--idle-s", "0", "--out", "stream.csv"]


def _places(place: Path, rng: random.Random) -> list[str]:
    """Something else in the place of a file."""
    victim = place / rng.choice(
        (
            "good0.parquet",
            "good2.csv",
            "gyro.yaml",
            "good2.yaml",
            "programme.yaml",
            "units.csv",
            "calibration.json",
            "diagnosis.json",
        )
    )
    victim.unlink(missing_ok=True)
    what = rng.randrange(7)
    if what == 0:
        os.mkfifo(victim)
    elif what == 1:
        victim.mkdir()
    elif what == 2:
        victim.symlink_to(victim.name)
    elif what == 3:
        victim.symlink_to(rng.choice(("/dev/zero", "/dev/full", "/dev/null", "/proc/self/mem", "/nowhere")))
    elif what == 4:
        with victim.open("wb") as stream:
            stream.truncate(rng.choice((0, 1, 1 << 33)))
    elif what == 5:
        victim.write_bytes(rng.randbytes(rng.randrange(5000)))
    else:
        victim.symlink_to("challenge")
    lines = {
        "gyro.yaml": ["simulate", "gyro.yaml", "--profile", PROGRAMME, "--out", "out.csv"],
        "programme.yaml": ["simulate", "gyro.yaml", "--profile", "programme.yaml", "--out", "out.csv"],
        "units.csv": ["fleet", "train", "units.csv", "--model", "cubic", "--out", "out"],
        "calibration.json": ["train", "good0.parquet", "--calibration", "calibration.json", "--out", "out"],
        "diagnosis.json": ["reveal", "challenge", "diagnosis.json"],
        "good2.yaml": ["inspect", "good2.csv"],
    }
    return lines.get(
        victim.name,
        rng.choice((["inspect", victim.name], ["train", victim.name, "good1.parquet", "--model", "cubic", "--out", "out"])),
    )


KINDS: Final[dict[str, tuple[int, Callable[[Path, random.Random], list[str]]]]] = {
    "recording": (10, _recording),
    "sidecar": (1, _sidecar),
    "simulator": (2, _simulator),
    "programme": (1, _programme),
    "model": (2, _model),
    "challenge": (1, _challenge),
    "calibration": (1, _calibration),
    "units": (1, _units),
    "stream": (1, _stream),
    "something else": (1, _places),
}


def cases(folder: Path, numbers: range, seed: int) -> Iterator[tuple[int, str, tuple[str, ...], Result, str | None]]:
    """Make each case, run its command, and say what went wrong."""
    names = [name for name, (weight, _) in KINDS.items() for _ in range(weight)]
    for number in numbers:
        rng = random.Random(f"{seed}/{number}")  # noqa: S311
        kind = rng.choice(names)
        place = folder / f"case{number}"
        shutil.copytree(folder / "seeds", place, symlinks=True)
        arguments = KINDS[kind][1](place, rng)
        before = _state(place)
        result = command(arguments, place, memory_gb=MEMORY_GB)
        yield number, kind, tuple(arguments), result, result.problem or _left(place, before, result)
        shutil.rmtree(place, ignore_errors=True)


def _state(place: Path) -> dict[str, str]:
    state = {}
    for path in sorted(place.rglob("*")):
        name = path.relative_to(place).as_posix()
        if path.is_file() and not path.is_symlink() and path.stat().st_size < 1 << 26 and not name.startswith("tmp/"):
            state[name] = hashlib.sha256(path.read_bytes()).hexdigest()
    return state


def _left(place: Path, before: dict[str, str], result: Result) -> str | None:
    """What a command should not have left or changed."""
    after = _state(place)
    changed = [name for name in before if after.get(name) != before[name] and not name.startswith("stream.")]
    if changed:
        return f"{changed[0]} was changed"
    if scratch := [name for name in after if "/.rlgcomp-" in f"/{name}"]:
        return f"{scratch[0]} was left"
    if strays := [path.name for path in (place / "tmp").iterdir() if path.name not in CONTROL]:
        return f"{strays[0]} was left in TMPDIR"
    if result.code == 2 and (new := [name for name in after if name not in before and name.startswith("out")]):
        return None if (place / "out" / "fleet.json").exists() else f"refused, but {new[0]} was written"
    return None
