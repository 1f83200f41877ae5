"""Whole commands in processes of their own, start included: fleets, the demo, a calibration, a turning run, diagnoses."""

from __future__ import annotations

import collections
import functools
import hashlib
import itertools
import json
import subprocess
import sys
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Final

from experiments.liu_2019.rotation_table import RotatingGyro, liu_harmonics, simulate_rotation
from experiments.liu_2019.triads import drawn_triads
from experiments.speed.measure import Case, Peer, Row, Timed
from experiments.speed.whole import simulated_case, size_text
from rlgcomp.noise.processes import NoiseModel
from rlgcomp.recording import Recording
from rlgcomp.recording.formats import write
from rlgcomp.simulation.random_units import simulated_unit
from rlgcomp.simulation.simulator import Simulator
from rlgcomp.simulation.triad_errors import TriadErrors
from rlgcomp.simulation.two_axis_table import PROGRAMMES

GYROS: Final = 20  # whose files a fleet's units have in turn
_CUBIC: Final = ("--model", "cubic", "--features", "temperature")
_TIMING: Final = """
import contextlib, ctypes, json, os, resource, subprocess, sys, time
with contextlib.suppress(AttributeError, OSError):
    ctypes.CDLL(None).prctl(36, 1)  # PR_SET_CHILD_SUBREAPER of Linux: workers of a server become children of this process
began = time.perf_counter()
done = subprocess.run(sys.argv[1:], stdout=subprocess.DEVNULL)
wall_s = time.perf_counter() - began
with contextlib.suppress(ChildProcessError):
    while True:
        os.wait()
spent = resource.getrusage(resource.RUSAGE_CHILDREN)
print(json.dumps([wall_s, spent.ru_utime + spent.ru_stime, spent.ru_maxrss / 1024]))
sys.exit(done.returncode)
"""
_TOLD: Final = 500  # characters of what a command that failed says last
_FOLDERS: Final[list[tempfile.TemporaryDirectory[str]]] = []
PEAK_MIB: Final[collections.deque[float]] = collections.deque([0.0], maxlen=1)  # most memory resident in the last command


def timed_command(*arguments: object) -> Timed:
    """Time of a command of ours in a process of its own, that of the processes that it starts included; its result is None."""
    code = "from rlgcomp.cli import main; main()"
    command = [sys.executable, "-c", _TIMING, sys.executable, "-c", code, *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, check=False)  # noqa: S603
    if done.returncode:
        told = done.stderr.decode(errors="replace")[-_TOLD:]
        raise RuntimeError(f"rlgcomp {' '.join(map(str, arguments))} ended with {done.returncode}: {told}")
    wall_s, cpu_s, peak_MiB = json.loads(done.stdout)
    PEAK_MIB.append(peak_MiB)
    return Timed(None, wall_s, cpu_s)


def folder_of_data() -> Path:
    """A new folder, removed when Python ends."""
    folder = tempfile.TemporaryDirectory()
    _FOLDERS.append(folder)
    return Path(folder.name)


# --- fleets --------------------------------------------------------------------------------------------------------------------


@functools.cache
def _gyros() -> Path:
    """Two short runs of each gyro, a sample in ten seconds."""
    folder = folder_of_data()
    for seed, run in itertools.product(range(GYROS), (1, 2)):
        write(simulated_unit(seed).simulate("short", seed=run, step_s=10.0), folder / f"{seed}-{run}.parquet")
    return folder


def fleet_table(units: int) -> Path:
    """Table of as many units, which have the files of the gyros in turn."""
    files, table = _gyros(), folder_of_data() / "units.csv"
    lines = [f"unit-{k},{files / f'{k % GYROS}-1.parquet'};{files / f'{k % GYROS}-2.parquet'}" for k in range(units)]
    table.write_text("\n".join(["unit,train", *lines]) + "\n", encoding="utf-8")
    return table


def fleet_command(table: Path, out: Path, *options: object) -> Timed:
    """The command that trains a cubic in temperature for each unit; its result is a digest of the models."""
    done = timed_command("fleet", "train", table, "--out", out, *_CUBIC, *options)
    return Timed(_digest(out), done.wall_s, done.cpu_s)


def _digest(out: Path) -> str:
    """Of all numbers of all units' models, bit for bit."""
    digest = hashlib.sha256()
    for path in sorted(out.rglob("*.npy")):
        digest.update(str(path.relative_to(out)).encode() + path.read_bytes())
    return digest.hexdigest()


def _fleet(units: int, goal: float) -> Callable[[bool], Case]:
    def prepare(quick: bool) -> Case:
        number = min(units, GYROS // 2) if quick else units
        table, folder = fleet_table(number), folder_of_data()
        places = (folder / f"out-{k}" for k in itertools.count())
        one = Peer("one worker", lambda: fleet_command(table, next(places)), different, 0.0, goal)
        return Case(lambda: fleet_command(table, next(places), "--jobs", 2), [one], size=f"{number} units", n=number)

    return prepare


def different(ours: object, theirs: object) -> float:
    """Disagreement of results that should be the same: 0 or 1."""
    return float(ours != theirs)


# --- a demo, a calibration, a turning run -------------------------------------------------------------------------------------


def _demo(quick: bool) -> Case:
    places = (folder_of_data() / "demo" for _ in itertools.count())
    return Case(lambda: timed_command("demo", *(["--quick"] if quick else []), "--out", next(places)), size="three runs")


def _calibration(quick: bool) -> Case:
    folder, files = folder_of_data(), []
    triad = next(drawn_triads(1, TriadErrors(), seed=5))
    for k, name in enumerate(("step-1", "step-2", "step-3")):
        files.append(folder / f"{name}.parquet")
        write(triad.simulate(PROGRAMMES[name], seed=k, step_s=0.02 if quick else 0.005, name=name), files[-1])
    ends = (("--out", folder / f"{k}.json", "--report", folder / f"report-{k}") for k in itertools.count())
    return Case(lambda: timed_command("calibrate", *files, *next(ends)), size="three steps of 20 min")


def _turning(quick: bool) -> Case:
    folder = folder_of_data()
    noise = NoiseModel(angle_random_walk_deg_sqrt_h=4e-4)
    gyros = {axis: RotatingGyro(noise, liu_harmonics(k)) for k, axis in enumerate("xyz")}
    write(simulate_rotation(gyros, ((60.0, 600.0 if quick else 7200.0),), seed=1), folder / "turning.parquet")
    places = (folder / f"arw-{k}" for k in itertools.count())
    return Case(lambda: timed_command("arw", folder / "turning.parquet", "--out", next(places)), size="three gyros at 200 Hz")


# --- a diagnosis ---------------------------------------------------------------------------------------------------------------


def _diagnose(quick: bool) -> Case:
    return _diagnosis_of(*simulated_case("short" if quick else "whole"))


def _diagnose_longer(short: bool) -> Case:
    return _diagnosis_of(*simulated_case("half" if short else "whole"))


def _diagnosis_of(simulator: Simulator, runs: Sequence[Recording]) -> Case:
    file, files = _written(simulator, runs)
    return _command_on(runs, "diagnose", "--simulator", file, "--train", *files[:-1], "--test", files[-1])


def _sensitivity(quick: bool) -> Case:
    simulator, runs = simulated_case("short" if quick else "whole")
    file, files = _written(simulator, runs[:2])
    fewer = ("--draws", 1, "--strengths", "0.4,1.6") if quick else ()
    return _command_on(runs[:2], "sensitivity", file, *files, "--mechanism", "supply_voltage", "--jobs", 2, *fewer)


def _written(simulator: Simulator, runs: Sequence[Recording]) -> tuple[Path, list[Path]]:
    """Files of a simulator and of runs."""
    folder = folder_of_data()
    simulator.to_yaml(folder / "sim.yaml")
    files = [folder / f"run-{k}.parquet" for k in range(len(runs))]
    for path, run in zip(files, runs, strict=True):
        write(run, path)
    return folder / "sim.yaml", files


def _command_on(runs: Sequence[Recording], *arguments: object) -> Case:
    """A command that reads runs and writes a folder."""
    places = (folder_of_data() / "out" for _ in itertools.count())
    return Case(lambda: timed_command(*arguments, "--out", next(places)), size=size_text(runs), n=sum(map(len, runs)))


ROWS: Final = (
    Row("fleet-10", "rlgcomp fleet train by two workers", _fleet(10, 1.0), threads=2),
    Row("fleet-100", "rlgcomp fleet train by two workers", _fleet(100, 1.7), threads=2),
    Row("fleet-1000", "rlgcomp fleet train by two workers", _fleet(1000, 1.85), threads=2),
    Row("demo", "rlgcomp demo", _demo),
    Row("calibrate", "rlgcomp calibrate, report included", _calibration),
    Row("arw", "rlgcomp arw, pictures included", _turning),
    Row("diagnose-command", "rlgcomp diagnose, report included", _diagnose, threads=2, goal_s=8.0, grown=_diagnose_longer),
    Row("sensitivity", "rlgcomp sensitivity, thirty trials by two workers", _sensitivity, threads=2, goal_s=60.0, long=True),
)
