"""Faults around the commands: kills at random moments, full disks, closed streams, two writers.

Each command has an earlier result in place. After a fault its output must be the earlier result or the new one, whole; the same
command must then succeed and leave no scratch behind.
"""

from __future__ import annotations

import collections
import dataclasses
import hashlib
import os
import resource
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Final

import numpy as np

from rlgcomp.scratch import PREFIX

SIMULATOR: Final = """
kind: chamber
mechanisms:
  - thermal_polynomial: {degree: 3}
  - temperature_rate: {k_deg_h_min_K: 0.02}
noise: {angle_random_walk_deg_sqrt_h: 0.0003}
"""
SIGNALS: Final = {"SIGKILL": signal.SIGKILL, "SIGTERM": signal.SIGTERM, "SIGINT": signal.SIGINT}
# files that state how long the work took, or hold a random salt
TIMED: Final = ("unit.json", "SHA256SUMS", "report.md", "report.json", "challenge.json", "truth.json")
DISK_BYTES: Final = (0, 1000, 20_000)
_FRACTIONS: Final = 0.02, 1.05  # of the time that a command takes, between which it is killed
_LONGEST_S: Final = 600.0


@dataclasses.dataclass(frozen=True)
class Command:
    """A command line, with `{variant}` in it, and the names of what it writes."""

    name: str
    arguments: tuple[str, ...]
    writes: tuple[str, ...]

    def line(self, variant: int) -> list[str]:
        """Arguments of the earlier result (0) or of the new one (1)."""
        return [one.replace("{variant}", str(1 + variant)) for one in self.arguments]


_SHORT: Final = ("simulate", "gyro.yaml", "--profile", "short", "--seed", "{variant}", "--out")
_FLEET: Final = ("fleet", "train", "units{variant}.csv", "--model", "cubic", "--jobs", "2", "--out", "fleet")
_FOLLOW: Final = ("compensate", "cubic", "run3.csv", "--follow", "--idle-s", "0", "--out", "f.csv")
_CONCEAL: Final = ("conceal", "gyro.yaml", "--hide", "temperature_rate", "--seed", "{variant}", "--out", "challenge{variant}")
COMMANDS: Final = (
    Command("simulate csv", (*_SHORT, "o.csv"), ("o.csv", "o.yaml")),
    Command("simulate parquet", (*_SHORT, "o.parquet"), ("o.parquet",)),
    Command("simulate hdf5", (*_SHORT, "o.h5"), ("o.h5",)),
    Command("predict", ("predict", "gyro.yaml", "run{variant}.parquet", "--out", "p.tsv"), ("p.tsv", "p.yaml")),
    Command("train", ("train", "run1.parquet", "run2.parquet", "--averaging-s", "{variant}00", "--out", "model"), ("model",)),
    Command("fleet", _FLEET, ("fleet/a", "fleet/b")),
    Command("compensate", ("compensate", "cubic", "run{variant}.parquet", "--out", "c.parquet"), ("c.parquet",)),
    Command("follow", _FOLLOW, ("f.csv",)),
    Command("evaluate", ("evaluate", "cubic", "run{variant}.parquet", "--no-comparison", "--out", "report"), ("report",)),
    Command("export", ("export", "cubic{variant}", "--to", "c", "--name", "m", "--out", "code"), ("code",)),
    Command("conceal", _CONCEAL, ("challenge2",)),
    Command("allan", ("allan", "run{variant}.parquet", "--out", "allan"), ("allan",)),
)


def prepare(folder: Path) -> None:
    """Inputs of all commands, in a new folder."""
    folder.mkdir(parents=True)
    (folder / "gyro.yaml").write_text(SIMULATOR, encoding="utf-8")
    for seed in (1, 2, 3):
        out = "run3.csv" if seed == 3 else f"run{seed}.parquet"
        run(
            folder, ["simulate", "gyro.yaml", "--profile", "short", "--step-s", "5", "--seed", str(10 + seed), "--out", out]
        ).check()
    for variant, averaging in ((1, "100"), (2, "200")):
        train = [
            "train",
            "run1.parquet",
            "run2.parquet",
            "--model",
            "cubic",
            "--averaging-s",
            averaging,
            "--out",
            f"cubic{variant}",
        ]
        run(folder, train).check()
        other = "run1.parquet;run2.parquet" if variant == 1 else "run2.parquet;run1.parquet"
        (folder / f"units{variant}.csv").write_text(f"unit,train\na,{other}\nb,{other}\n")
    shutil.copytree(folder / "cubic1", folder / "cubic")


@dataclasses.dataclass(frozen=True)
class Ended:
    """How a process ended."""

    code: int
    error: str
    seconds: float

    def check(self) -> None:
        """Raise unless it succeeded."""
        if self.code:
            raise RuntimeError(f"exit code {self.code}: {self.error[-500:]}")


def run(
    folder: Path,
    arguments: list[str],
    *,
    kill: tuple[signal.Signals, float] | None = None,
    disk_bytes: int | None = None,
    environment: dict[str, str] | None = None,
    stdout: int | None = subprocess.DEVNULL,
    close: bool = False,
) -> Ended:
    """Run a command in a folder.

    Parameters
    ----------
    folder : Path
    arguments : list of str
    kill : (signal, seconds), optional
        What is sent to its process group, and when.
    disk_bytes : int, optional
        No file may become larger.
    environment : dict, optional
        Further variables.
    stdout : int, optional
        As of `subprocess`.
    close : bool
        Its standard output is a pipe that nobody reads.
    """
    limit: Callable[[], None] | None = None
    if disk_bytes is not None:

        def limit() -> None:
            signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
            resource.setrlimit(resource.RLIMIT_FSIZE, (disk_bytes, disk_bytes))

    (folder / "tmp").mkdir(exist_ok=True)
    settings = {
        **os.environ,
        "SOURCE_DATE_EPOCH": "0",
        "TMPDIR": str(folder / "tmp"),
        "OPENBLAS_NUM_THREADS": "1",
        **(environment or {}),
    }
    began = time.monotonic()
    command = [sys.executable, "-m", "rlgcomp", *arguments]
    error_file = folder / "tmp" / "stderr.txt"
    with error_file.open("wb") as errors:
        process = subprocess.Popen(  # noqa: S603
            command, cwd=folder, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE if close else stdout,
            stderr=subprocess.PIPE if disk_bytes is not None else errors, env=settings, start_new_session=True, preexec_fn=limit,  # noqa: PLW1509
        )  # fmt: skip
        if close and process.stdout is not None:
            process.stdout.close()
        if kill is not None:
            try:
                process.wait(kill[1])
            except subprocess.TimeoutExpired:
                os.kill(process.pid, kill[0])
        text = process.communicate(timeout=_LONGEST_S)[1] if disk_bytes is not None else b""
        code = process.wait(_LONGEST_S)
    message = text.decode(errors="replace") or error_file.read_text(errors="replace")
    error_file.unlink()
    return Ended(code, message, time.monotonic() - began)


def contents(folder: Path, writes: tuple[str, ...]) -> str | None:
    """Digest of what a command wrote, times of day left out; None where nothing is there."""
    digest = hashlib.sha256()
    found = False
    for name in writes:
        path = folder / name
        files = sorted(path.rglob("*")) if path.is_dir() else [path] if path.exists() else []
        for file in files:
            if file.is_file() and file.name not in TIMED:
                found = True
                digest.update(file.relative_to(folder).as_posix().encode() + hashlib.sha256(file.read_bytes()).digest())
    return digest.hexdigest() if found else None


def scratch(folder: Path) -> list[str]:
    """Scratch that is left in a folder and in its TMPDIR."""
    left = [path.relative_to(folder).as_posix() for path in folder.rglob(f"{PREFIX}*")]
    return left + [path.name for path in (folder / "tmp").iterdir() if not path.name.startswith(("joblib", "loky"))]


@dataclasses.dataclass
class Trial:
    """A fault and what came of it: problems, none of a good one."""

    command: str
    fault: str
    seconds: float
    problems: list[str]


def kills(folder: Path, count: int, seed: int) -> Iterator[Trial]:
    """Kill the commands in turn at random moments, and run each again."""
    rng = np.random.default_rng(seed)
    whole: dict[str, tuple[str | None, str | None, float]] = {}
    for trial in range(count):
        command = COMMANDS[trial % len(COMMANDS)]
        if command.name not in whole:
            whole[command.name] = _whole(folder, command)
        old, new, seconds = whole[command.name]
        place = folder / f"kill{trial}"
        _with_earlier(folder, place, command)
        name = list(SIGNALS)[int(rng.choice(3, p=[0.6, 0.2, 0.2]))]
        at_s = float(rng.uniform(*_FRACTIONS)) * seconds
        ended = run(place, command.line(1), kill=(SIGNALS[name], at_s))
        problems = []
        now = contents(place, command.writes)
        partial = command.name in ("fleet", "follow")  # unit by unit, line by line
        if not partial and now not in (old, new):
            problems.append("neither the earlier result nor the new one")
        if "Traceback" in ended.error:
            problems.append("a traceback")
        time.sleep(1.0 if command.name == "fleet" else 0.0)
        if _processes(place):
            problems.append("processes outlive it")
        if name != "SIGKILL" and (left := scratch(place)):
            problems.append(f"scratch after {name}: {left[0]}")
        again = run(place, command.line(1))
        if again.code:
            problems.append(f"the rerun ends with {again.code}: {again.error[-200:]}")
        elif contents(place, command.writes) != new:
            problems.append("the rerun makes another result")
        if left := [one for one in scratch(place) if one.startswith(PREFIX) or f"/{PREFIX}" in one]:
            problems.append(f"scratch after the rerun: {left[0]}")
        shutil.rmtree(place)
        yield Trial(command.name, name, at_s, problems)


def _whole(folder: Path, command: Command) -> tuple[str | None, str | None, float]:
    """Digests of the earlier and the new result, and the seconds that the latter takes."""
    place = folder / f"whole {command.name}"
    _copy(folder, place)
    digests, seconds = [], 0.0
    for variant in (0, 1):
        ended = run(place, command.line(variant))
        ended.check()
        digests.append(contents(place, command.writes))
        seconds = ended.seconds
        if variant == 0:
            shutil.rmtree(folder / f"earlier {command.name}", ignore_errors=True)
            shutil.copytree(place, folder / f"earlier {command.name}")
    shutil.rmtree(place)
    return digests[0], digests[1], seconds


def _with_earlier(folder: Path, place: Path, command: Command) -> None:
    shutil.copytree(folder / f"earlier {command.name}", place)
    if command.name == "follow":
        (place / "f.csv").unlink()


def _copy(folder: Path, place: Path) -> None:
    place.mkdir()
    for path in (folder / "inputs").iterdir():
        (shutil.copytree if path.is_dir() else shutil.copy2)(path, place / path.name)


def _processes(place: Path) -> list[int]:
    found = []
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit():
            try:
                if Path(os.readlink(entry / "cwd")) == place:  # noqa: PTH115
                    found.append(int(entry.name))
            except OSError:
                continue
    return found


def others(folder: Path) -> Iterator[Trial]:
    """Full disks, unusable folders for scratch and for compiled code, closed streams, and two writers at once."""
    for command in COMMANDS:
        old, new, _ = _whole(folder, command)
        for size in DISK_BYTES:
            place = folder / "disk"
            _with_earlier(folder, place, command)
            before = contents(place, command.writes)
            ended = run(place, command.line(1), disk_bytes=size)
            after = contents(place, command.writes)
            problems = [] if after in (before, new) or command.name in ("fleet", "follow") else ["the earlier result is damaged"]
            if ended.code not in (0, 2) or "Traceback" in ended.error or "internal fault" in ended.error:
                problems.append(f"exit code {ended.code}: {ended.error[-200:]}")
            again = run(place, command.line(1))
            if again.code or contents(place, command.writes) != new:
                problems.append(f"the rerun ends with {again.code}: {again.error[-200:]}")
            shutil.rmtree(place)
            yield Trial(command.name, f"no file beyond {size} bytes", 0.0, problems)
        faults: dict[str, dict[str, object]] = {
            "no cache": {"environment": {"NUMBA_CACHE_DIR": "/proc/none", "HOME": "/proc/none"}},
            "no reader of the output": {"close": True},
            "ASCII output": {"environment": {"LC_ALL": "C", "PYTHONIOENCODING": "ascii", "PYTHONUTF8": "0"}},
        }
        for name, settings in faults.items():
            place = folder / "other"
            _with_earlier(folder, place, command)
            ended = run(place, command.line(1), **settings)  # type: ignore[arg-type]
            problems = []
            if ended.code or contents(place, command.writes) != new:
                problems.append(f"exit code {ended.code}: {ended.error[-200:]}")
            shutil.rmtree(place)
            yield Trial(command.name, name, 0.0, problems)
        if command.name not in ("follow", "fleet"):
            yield _two_writers(folder, command, old, new)


def _two_writers(folder: Path, command: Command, old: str | None, new: str | None) -> Trial:
    place = folder / "two"
    _with_earlier(folder, place, command)
    line = [sys.executable, "-m", "rlgcomp"]
    settings = {**os.environ, "SOURCE_DATE_EPOCH": "0", "TMPDIR": str(place / "tmp"), "OPENBLAS_NUM_THREADS": "1"}
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    both = [subprocess.Popen([*line, *command.line(k)], cwd=place, env=settings, **quiet) for k in (0, 1)]  # type: ignore[call-overload]  # noqa: S603
    codes = [process.wait(_LONGEST_S) for process in both]
    problems = [] if contents(place, command.writes) in (old, new) else ["neither result is whole"]
    if not set(codes) <= {0, 2}:
        problems.append(f"exit codes {codes}")
    shutil.rmtree(place)
    return Trial(command.name, "two writers", 0.0, problems)


def table(trials: list[Trial]) -> str:
    """Counts by command, as Markdown."""
    rows = collections.defaultdict(lambda: [0, 0])
    for trial in trials:
        rows[trial.command, trial.fault][0] += 1
        rows[trial.command, trial.fault][1] += bool(trial.problems)
    lines = ["| command | fault | trials | with problems |", "|---|---|---|---|"]
    lines += [f"| {command} | {fault} | {count} | {bad} |" for (command, fault), (count, bad) in sorted(rows.items())]
    lines.append(f"| all | | {len(trials)} | {sum(bool(trial.problems) for trial in trials)} |")
    return "\n".join(lines)
