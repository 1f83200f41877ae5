"""Commands that are killed, or told an error, at one of their own changes of the file system."""
# ruff: noqa: E501  a command a line

from __future__ import annotations

import dataclasses
import hashlib
import json
import random
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

from experiments.attack.files import PROGRAMME, seeds
from experiments.attack.process import command

ERRORS: Final = ("ENOSPC", "EACCES", "EIO", "EROFS", "EDQUOT", "EMFILE")
_VARYING: Final = (
    "provenance",
    "seconds",
    "state",
    "step_ns",
    "salt",
    "created",
    "date",
    "made",
    "sha256",
    "truth_sha256",
    "files",
    "SHA256SUMS",
)
_TEXT: Final = (".md", ".html", "SHA256SUMS")  # hold times or digests of what varies


@dataclasses.dataclass(frozen=True)
class Attacked:
    """A command line with an earlier result and a new one: `{k}` is 0 or 1."""

    name: str
    arguments: tuple[str, ...]
    writes: tuple[str, ...]
    piecewise: bool = False  # fleet and stream go on with what is there
    reader: tuple[str, ...] = ()  # a command that reads files which take their places together

    def line(self, k: int) -> list[str]:
        return [one.replace("{k}", str(k)).replace("{model}", ("lssvm", "cubic")[k]) for one in self.arguments]


COMMANDS: Final = (
    Attacked("train", ("train", "good0.parquet", "good1.parquet", "--features", "temperature", "--averaging-s", "{k}40", "--out", "o"), ("o",)),
    Attacked("train with code", ("train", "good0.parquet", "good1.parquet", "--model", "cubic", "--averaging-s", "1{k}0", "--out", "o", "--export", "o/c"), ("o",)),
    Attacked("fleet", ("fleet", "train", "two.csv", "--model", "cubic", "--averaging-s", "1{k}0", "--out", "o"), ("o",), piecewise=True),
    Attacked("follow", ("compensate", "cubic", "good2.csv", "--follow", "--idle-s", "0", "--out", "o.csv"), ("o.csv",), piecewise=True),
    Attacked("compensate", ("compensate", "cubic", "good{k}.parquet", "--out", "o.csv"), ("o.csv", "o.yaml"), reader=("inspect", "o.csv")),
    Attacked("diagnose", ("diagnose", "--simulator", "sim{k}.yaml", "--train", "good0.parquet", "--test", "good1.parquet", "--out", "o"), ("o",)),
    Attacked("export", ("export", "{model}", "--to", "c", "--no-board", "--name", "n", "--out", "o"), ("o",)),
    Attacked("conceal", ("conceal", "gyro.yaml", "--hide", "thermal_lag", "--seed", "{k}", "--step-s", "20", "--out", "o{k}"), ("o1",)),
    Attacked("simulate", ("simulate", "gyro.yaml", "--profile", PROGRAMME, "--seed", "{k}", "--out", "o.csv"), ("o.csv", "o.yaml"), reader=("inspect", "o.csv")),
    Attacked("calibrate", ("calibrate", "step0.parquet", "step1.parquet", "step2.parquet", "--angle-random-walk", "0.00{k}5", "--report", "o", "--out", "o.json"), ("o.json", "o"), reader=("compensate", "cubic", "good0.parquet", "--calibration", "o.json", "--out", "x.h5")),
    Attacked("merge", ("merge", "good{k}.parquet", "slow.csv", "--offset-s", "0", "--out", "o.h5"), ("o.h5",)),
    Attacked("evaluate", ("evaluate", "cubic", "good{k}.parquet", "--no-comparison", "--out", "o"), ("o",)),
    Attacked("allan", ("allan", "good{k}.parquet", "--out", "o"), ("o",)),
)  # fmt: skip


@dataclasses.dataclass(frozen=True)
class Trial:
    """A command, what was done to it at which of its changes, and what came of it."""

    command: str
    how: str
    at: int
    of: int
    problems: tuple[str, ...]
    finished: bool  # what was killed between two renames was finished by the next command that read there


def trials(folder: Path, kills: int, errors: int, seed: int) -> Iterator[Trial]:
    """Kill and disturb the commands in turn.

    Parameters
    ----------
    folder : Path
        For the files.
    kills, errors : int
        Numbers of trials.
    seed : int
    """
    rng = random.Random(seed)  # noqa: S311
    seeds(folder / "seeds")
    (folder / "seeds" / "two.csv").write_text("unit,train\nu1,good0.parquet;good1.parquet\nu2,good1.parquet;good0.parquet\n")
    lines = (folder / "seeds" / "good2.csv").read_text().splitlines()
    slow = [",".join(line.split(",")[0:3:2]) for line in lines[::30]]
    (folder / "seeds" / "slow.csv").write_text("\n".join(slow).replace("temperature_block", "temperature_wall") + "\n")
    text = (folder / "seeds" / "gyro.yaml").read_text()
    for k in (0, 1):
        (folder / "seeds" / f"sim{k}.yaml").write_text(f"{text}unit: U{k}\n")
    known: dict[str, tuple[Path, Any, Any, int]] = {}
    for trial in range(kills + errors):
        attacked = COMMANDS[trial % len(COMMANDS)]
        if attacked.name not in known:
            known[attacked.name] = _known(folder, attacked)
        earlier, old, new, changes = known[attacked.name]
        at = rng.randrange(changes)
        how = "kill" if trial < kills else rng.choice(ERRORS)
        place = folder / f"trial{trial}"
        shutil.copytree(earlier, place, symlinks=True)
        result = command(attacked.line(1), place, at=at, how=how, longest_s=300.0)
        problems = []
        if how != "kill" and result.problem:
            problems.append(f"{result.problem}: {result.error[-200:]}")
        now, finished = _contents(place, attacked), False
        if now not in (old, new) and attacked.reader:
            command(list(attacked.reader), place, longest_s=300.0)
            now, finished = _contents(place, attacked), True
        if now not in (old, new) and not attacked.piecewise:
            problems.append("neither the earlier result nor the new one is whole")
        if how != "kill" and (scratch := _scratch(place)):
            problems.append(f"{scratch} is left after the error")
        again = command(attacked.line(1), place, longest_s=300.0)
        if again.code or again.problem:
            complete = attacked.name == "conceal" and "holds a challenge already" in again.error and now == new
            if not complete:
                problems.append(f"the rerun ends with {again.code}: {again.error[-200:]}")
        elif _contents(place, attacked) != new:
            problems.append("the rerun makes another result")
        if scratch := _scratch(place):
            problems.append(f"{scratch} is left after the rerun")
        shutil.rmtree(place)
        yield Trial(attacked.name, how, at, changes, tuple(problems), finished)


def _known(folder: Path, attacked: Attacked) -> tuple[Path, Any, Any, int]:
    """A folder with the earlier result, contents of it and of the new one, and how many changes the latter takes."""
    place = folder / f"earlier {attacked.name}"
    shutil.copytree(folder / "seeds", place, symlinks=True)
    if attacked.name != "follow":
        _require(command(attacked.line(0), place, longest_s=300.0))
    old = _contents(place, attacked)
    after = folder / f"later {attacked.name}"
    shutil.copytree(place, after, symlinks=True)
    result = command(attacked.line(1), after, longest_s=300.0)
    _require(result)
    new = _contents(after, attacked)
    shutil.rmtree(after)
    return place, old, new, result.changes


def _require(result: Any) -> None:
    if result.code:
        raise RuntimeError(result.error)


def _contents(place: Path, attacked: Attacked) -> dict[str, Any]:
    """What each file of the output holds, without times and digests."""
    found: dict[str, Any] = {}
    for name in attacked.writes:
        path = place / name
        for file in sorted(path.rglob("*")) if path.is_dir() else [path] if path.exists() else []:
            if file.is_file():
                found[file.relative_to(place).as_posix()] = _content(file)
    return found


def _content(file: Path) -> Any:
    if file.name.endswith(_TEXT):
        return file.stat().st_size > 0
    if file.suffix == ".json":
        return _without_times(json.loads(file.read_text()))
    return hashlib.sha256(file.read_bytes()).hexdigest()


def _without_times(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _without_times(part) for key, part in value.items() if key not in _VARYING}
    return [_without_times(part) for part in value] if isinstance(value, list) else value


def _scratch(place: Path) -> str | None:
    found = [path.relative_to(place).as_posix() for path in place.rglob(".rlgcomp-*")]
    found += [f"tmp/{path.name}" for path in (place / "tmp").iterdir()]
    return found[0] if found else None
