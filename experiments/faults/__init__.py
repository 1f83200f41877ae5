"""Faults around the commands: kills at random moments, full and read-only disks, closed streams, two writers.

Each command has an earlier result in place. After a fault its output must be the earlier result or the new one, whole; the same
command must then succeed and leave no scratch behind. A command is a process forked from one that has imported the package, so that
its time is spent on its work. Disks are small file systems in memory where they can be mounted; else files are limited in size.
"""

from __future__ import annotations

import collections
import contextlib
import dataclasses
import hashlib
import os
import shutil
import signal
import subprocess
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Final

import numpy as np

from experiments.faults.commands import COMMANDS, Command
from experiments.faults.process import LONGEST_S, run, start, wait
from rlgcomp.scratch import PREFIX

SIGNALS: Final = {"SIGKILL": signal.SIGKILL, "SIGTERM": signal.SIGTERM, "SIGINT": signal.SIGINT}
# files that state how long the work took or when, or hold a random salt
TIMED: Final = ("unit.json", "fleet.json", "SHA256SUMS", "report.md", "report.json", "report.html", "challenge.json", "truth.json")
FREE_BYTES: Final = (0, 8192, 65536)  # of a disk that is full, or becomes full
DISK_MB: Final = 48
_FRACTIONS: Final = 0.02, 1.05  # of the time that a command takes, between which it is killed
_ENDING_S: Final = 20.0  # within which workers of a killed process must end


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


def kills(folder: Path, count: int, seed: int, commands: Sequence[Command] = COMMANDS) -> Iterator[Trial]:
    """Kill the commands in turn at random moments, and run each again."""
    rng = np.random.default_rng(seed)
    whole: dict[str, tuple[str | None, str | None, float]] = {}
    for trial in range(count):
        command = commands[trial % len(commands)]
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
        if not command.grows and now not in (old, new):
            problems.append("neither the earlier result nor the new one")
        if "Traceback" in ended.error:
            problems.append("a traceback")
        if _outlived(place):  # workers and compilers end by themselves
            problems.append("processes outlive it")
        if name != "SIGKILL" and (left := scratch(place)):
            problems.append(f"scratch after {name}: {left[0]}")
        again = run(place, command.line(1))
        sealed = command.name == "conceal" and now == new and "holds a challenge already" in again.error  # it was complete
        if again.code and not sealed:
            problems.append(f"the rerun ends with {again.code}: {again.error[-200:]}")
        elif contents(place, command.writes) != new:
            problems.append("the rerun makes another result")
        if left := scratch(place):
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
            shutil.copytree(place, folder / f"earlier {command.name}", ignore=shutil.ignore_patterns("tmp"))
    shutil.rmtree(place)
    return digests[0], digests[1], seconds


def _with_earlier(folder: Path, place: Path, command: Command) -> None:
    shutil.copytree(folder / f"earlier {command.name}", place, dirs_exist_ok=True)
    if command.grows == "lines":
        for name in command.writes:
            (place / name).unlink()


def _copy(folder: Path, place: Path) -> None:
    place.mkdir()
    for path in (folder / "inputs").iterdir():
        (shutil.copytree if path.is_dir() else shutil.copy2)(path, place / path.name)


def _outlived(place: Path) -> bool:
    until = time.monotonic() + _ENDING_S
    while _processes(place):
        if time.monotonic() > until:
            return True
        time.sleep(0.2)
    return False


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


@contextlib.contextmanager
def disk(place: Path) -> Iterator[bool]:
    """A small file system in memory at a folder; whether it could be mounted."""
    place.mkdir(exist_ok=True)
    mounted = _mount("-t", "tmpfs", "-o", f"size={DISK_MB}m", "none", str(place))
    try:
        yield mounted
    finally:
        if mounted:
            subprocess.run(["umount", "-l", str(place)], check=True)  # noqa: S603, S607
        shutil.rmtree(place, ignore_errors=True)


def _mount(*arguments: str) -> bool:
    try:
        return subprocess.run(["mount", *arguments], check=False, capture_output=True).returncode == 0  # noqa: S603, S607
    except OSError:
        return False


@contextlib.contextmanager
def _filled(place: Path, free: int) -> Iterator[None]:
    """All of a disk taken but `free` bytes."""
    ballast = place / "ballast"
    space = os.statvfs(place)
    with ballast.open("wb") as file, contextlib.suppress(OSError):
        file.write(bytes(max(0, space.f_bavail * space.f_frsize - free)))
        file.flush()
    try:
        yield
    finally:
        ballast.unlink()


def others(folder: Path, commands: Sequence[Command] = COMMANDS) -> Iterator[Trial]:
    """Full and read-only disks, unusable folders for scratch and for compiled code, closed streams, two writers at once."""
    for command in commands:
        old, new, _ = _whole(folder, command)
        yield from _full_disks(folder, command, new)
        yield _read_only(folder, command)
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
        if not command.grows:
            yield _two_writers(folder, command, old, new)


def _full_disks(folder: Path, command: Command, new: str | None) -> Iterator[Trial]:
    """The disk of the output, of TMPDIR or of the cache is full; without mounts, files beyond a size cannot be written."""
    cases = [("output", free) for free in FREE_BYTES] + [("TMPDIR", 0), ("cache", 0)]
    for which, free in cases:
        place = folder / "disk"
        with disk(place) as mounted, disk(folder / "full") as other:
            if not (mounted and other):
                _with_earlier(folder, place, command)
                before = contents(place, command.writes)
                yield _full(place, command, before, new, f"no file beyond {free} bytes", lambda: None, largest_bytes=free)
                continue
            _with_earlier(folder, place, command)
            before = contents(place, command.writes)
            filled = contextlib.ExitStack()
            filled.enter_context(_filled(place if which == "output" else folder / "full", free))
            variable = {"TMPDIR": "TMPDIR", "cache": "NUMBA_CACHE_DIR"}.get(which)
            environment = {variable: str(folder / "full")} if variable else {}
            name = f"full disk of {which}" + (f", {free} bytes free" if free else "")
            yield _full(place, command, before, new, name, filled.close, environment=environment)


def _full(
    place: Path,
    command: Command,
    before: str | None,
    new: str | None,
    name: str,
    free: Callable[[], None],
    *,
    largest_bytes: int | None = None,
    environment: dict[str, str] | None = None,
) -> Trial:
    """Run a command on a full disk, free the disk, and run it again."""
    ended = run(place, command.line(1), largest_bytes=largest_bytes, environment=environment)
    after = contents(place, command.writes)
    free()
    problems = [] if command.grows or after in (before, new) else ["the earlier result is damaged"]
    if ended.code not in (0, 2) or "Traceback" in ended.error or "internal fault" in ended.error:
        problems.append(f"exit code {ended.code}: {ended.error[-300:]}")
    elif ended.code == 0 and after != new:
        problems.append("success without the new result")
    if left := [one for one in scratch(place) if PREFIX in one]:
        problems.append(f"scratch: {left[0]}")
    again = run(place, command.line(1))
    sealed = command.name == "conceal" and after == new
    if (again.code and not sealed) or contents(place, command.writes) != new:
        problems.append(f"the rerun ends with {again.code}: {again.error[-200:]}")
    return Trial(command.name, name, 0.0, problems)


def _read_only(folder: Path, command: Command) -> Trial:
    """Nothing can be written where the output should go."""
    place = folder / "read-only"
    with disk(place) as mounted:
        _with_earlier(folder, place, command)
        (place / "tmp").mkdir(exist_ok=True)
        before = contents(place, command.writes)
        if mounted:
            _mount("-o", "remount,ro", str(place))
        else:
            place.chmod(0o555)
        environment = {"TMPDIR": str(folder)}
        ended = run(place, command.line(1), environment=environment)
        if mounted:
            _mount("-o", "remount,rw", str(place))
        else:
            place.chmod(0o755)
        problems = [] if contents(place, command.writes) == before else ["the earlier result is changed"]
        if ended.code != 2 or "Traceback" in ended.error or not ended.error.strip():
            problems.append(f"exit code {ended.code}: {ended.error[-200:]}")
        again = run(place, command.line(1))
        if again.code:
            problems.append(f"the rerun ends with {again.code}: {again.error[-200:]}")
    return Trial(command.name, "read-only output", 0.0, problems)


def _two_writers(folder: Path, command: Command, old: str | None, new: str | None) -> Trial:
    place = folder / "two"
    _with_earlier(folder, place, command)
    logs = [folder / f"two{k}.stderr" for k in (0, 1)]
    both = [start(place, command.line(k), logs[k]) for k in (0, 1)]
    codes = [wait(process, LONGEST_S) for process in both]
    problems = [] if contents(place, command.writes) in (old, new) else ["neither result is whole"]
    if not set(codes) <= {0, 2}:
        problems.append(f"exit codes {codes}: {logs[0].read_text()[-200:]} {logs[1].read_text()[-200:]}")
    shutil.rmtree(place)
    return Trial(command.name, "two writers", 0.0, problems)


def page(trials: Iterable[Trial]) -> str:
    """The page of the results."""
    trials = list(trials)
    killed = [trial for trial in trials if trial.fault in SIGNALS]
    by_signal = collections.Counter(trial.fault for trial in killed)
    counted = ", ".join(f"{count} by {name}" for name, count in by_signal.items())
    bad = [trial for trial in trials if trial.problems]
    lines = [
        "# Faults around the commands",
        "",
        "Printed by `python -m experiments.faults`. It kills commands at random moments, fills the disk of their output, of",
        "TMPDIR and of their compiled code, makes the output read-only, closes their standard output, and lets two write at",
        "once. An earlier result is in place each time. Afterwards the output must be the earlier result or the new one, whole;",
        "an error must be exit code 2 with one message; and the same command must then succeed, make the same result as without",
        "the fault, and leave no scratch. In a cell: trials / trials with a problem.",
        "",
        f"{len(killed)} kills ({counted}) and {len(trials) - len(killed)} other faults over {len(COMMANDS)} commands: "
        f"{len(bad)} trials with a problem.",
        "",
        table(trials),
    ]
    if bad:
        lines += [
            "",
            *(f"- {one.command}, {one.fault}, {one.seconds:.2f} s: {'; '.join(one.problems)}".replace("\n", " ") for one in bad),
        ]
    return "\n".join(lines)


def table(trials: Iterable[Trial]) -> str:
    """Trials and, after a slash, those with a problem, by command and fault, as Markdown."""
    counts: dict[tuple[str, str], list[int]] = collections.defaultdict(lambda: [0, 0])
    faults: dict[str, None] = {}
    for trial in trials:
        faults[trial.fault] = None
        for key in ((trial.command, trial.fault), ("all", trial.fault)):
            counts[key][0] += 1
            counts[key][1] += bool(trial.problems)
    names = [*(command.name for command in COMMANDS), "all"]
    lines = [f"| fault | {' | '.join(names)} |", f"|---|{'---|' * len(names)}"]
    for fault in faults:
        cells = ["{} / {}".format(*counts[name, fault]) if (name, fault) in counts else "-" for name in names]
        lines.append(f"| {fault} | {' | '.join(cells)} |")
    return "\n".join(lines)
