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
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator
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
# files that state how long the work took or when, or hold a random salt
TIMED: Final = ("unit.json", "fleet.json", "SHA256SUMS", "report.md", "report.json", "report.html", "challenge.json", "truth.json")
FREE_BYTES: Final = (0, 8192, 65536)  # of a disk that is full, or becomes full
DISK_MB: Final = 48
_FRACTIONS: Final = 0.02, 1.05  # of the time that a command takes, between which it is killed
_LONGEST_S: Final = 600.0
_ENDING_S: Final = 20.0  # within which workers of a killed process must end
_POLL_S: Final = 0.002


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
    Command("export", ("export", "cubic{variant}", "--to", "c", "--no-board", "--name", "m", "--out", "code"), ("code",)),
    Command("conceal", _CONCEAL, ("challenge2",)),
    Command("allan", ("allan", "run{variant}.parquet", "--out", "allan"), ("allan",)),
    Command("diagnose", _DIAGNOSE, ("diagnosis",)),
    Command("calibrate", _CALIBRATE, ("calibration.json",)),
    Command("merge", ("merge", "run{variant}.parquet", "slow.csv", "--offset-s", "0", "--out", "m.csv"), ("m.csv", "m.yaml")),
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
    _in_a_process(lambda: _table_runs(folder))


def _table_runs(folder: Path) -> None:
    """A triad's three steps on a two-axis table, shortened."""
    import rlgcomp as rlg
    from rlgcomp.simulation.two_axis_table import Triad, reversing

    programmes = (
        reversing(30.0, revolutions=1, repeats=2, outer_start_deg=90.0),
        reversing(30.0, revolutions=1, repeats=2),
        reversing(30.0, outer_deg_s=60.0, revolutions=1, repeats=4),
    )
    for k, programme in enumerate(programmes, start=1):
        rlg.write(Triad().simulate(programme, seed=k, step_s=0.02, name=f"step{k}"), folder / f"step{k}.parquet")


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
    largest_bytes: int | None = None,
    environment: dict[str, str] | None = None,
    close: bool = False,
    log: Path | None = None,
) -> Ended:
    """Run a command in a folder.

    Parameters
    ----------
    folder : Path
    arguments : list of str
    kill : (signal, seconds), optional
        What is sent to it, and when.
    largest_bytes : int, optional
        No file may become larger.
    environment : dict, optional
        Further variables.
    close : bool
        Its standard output is a pipe that nobody reads.
    log : Path, optional
        Folder for what it prints; by default beside its working folder.
    """
    error_file = (log or folder.parent) / f"{folder.name}.stderr"
    began = time.monotonic()
    child = start(folder, arguments, error_file, largest_bytes=largest_bytes, environment=environment, close=close)
    if kill is not None and (code := _wait(child, kill[1])) is None:
        with contextlib.suppress(ProcessLookupError):
            os.kill(child, kill[0])
    elif kill is not None:
        return Ended(code or 0, _taken(error_file), time.monotonic() - began)
    code = _wait(child, _LONGEST_S)
    if code is None:
        os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)
    return Ended(-99 if code is None else code, _taken(error_file), time.monotonic() - began)


def _taken(file: Path) -> str:
    text = file.read_text(errors="replace")
    file.unlink()
    return text


def start(
    folder: Path,
    arguments: list[str],
    error_file: Path,
    *,
    largest_bytes: int | None = None,
    environment: dict[str, str] | None = None,
    close: bool = False,
) -> int:
    """Start a command as :func:`run` does; its process."""
    (folder / "tmp").mkdir(exist_ok=True)
    child = os.fork()
    if child:
        return child
    code = 70
    try:
        os.setsid()
        os.chdir(folder)
        os.environ.update(
            {"SOURCE_DATE_EPOCH": "0", "TMPDIR": str(folder / "tmp"), "OPENBLAS_NUM_THREADS": "1", **(environment or {})}
        )
        nothing, errors = os.open(os.devnull, os.O_RDWR), os.open(error_file, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
        output = nothing
        if close:
            reading, output = os.pipe()
            os.close(reading)
        for number, handle in enumerate((nothing, output, errors)):
            os.dup2(handle, number)
        tempfile.tempdir = None  # of the process that was forked
        encoding = os.environ.get("PYTHONIOENCODING", "utf-8")
        sys.stdout, sys.stderr = (open(number, "w", encoding=encoding, closefd=False) for number in (1, 2))  # noqa: SIM115
        if largest_bytes is not None:
            signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
            resource.setrlimit(resource.RLIMIT_FSIZE, (largest_bytes, largest_bytes))
        sys.argv = ["rlgcomp", *arguments]
        from rlgcomp.cli import main

        main()
        code = 0
    except SystemExit as end:
        code = end.code if isinstance(end.code, int) else 0 if end.code is None else 1
    except BaseException:  # noqa: BLE001  what a process prints when it ends so
        import traceback

        traceback.print_exc()
        code = 1
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(OSError, ValueError):
            stream.flush()
    os._exit(code)


def _wait(child: int, longest_s: float) -> int | None:
    """Exit code of a process, minus the signal that ended it; None where it does not end in time."""
    until = time.monotonic() + longest_s
    while time.monotonic() < until:
        found, status = os.waitpid(child, os.WNOHANG)
        if found:
            return os.waitstatus_to_exitcode(status)
        time.sleep(_POLL_S)
    return None


def _in_a_process(work: Callable[[], object]) -> None:
    child = os.fork()
    if child == 0:
        code = 1
        try:
            work()
            code = 0
        finally:
            os._exit(code)
    if _wait(child, _LONGEST_S) != 0:
        raise RuntimeError("the inputs could not be made")


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
    shutil.copytree(folder / f"earlier {command.name}", place, dirs_exist_ok=True)
    if command.name == "follow":
        (place / "f.csv").unlink()


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


def others(folder: Path) -> Iterator[Trial]:
    """Full and read-only disks, unusable folders for scratch and for compiled code, closed streams, two writers at once."""
    for command in COMMANDS:
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
        if command.name not in ("follow", "fleet"):
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
    partial = command.name in ("fleet", "follow")
    problems = [] if after in (before, new) or partial else ["the earlier result is damaged"]
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
    codes = [_wait(process, _LONGEST_S) for process in both]
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
