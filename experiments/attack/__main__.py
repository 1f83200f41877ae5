"""Attack the package a second time, and print the page of what came out."""
# ruff: noqa: E501  a page

from __future__ import annotations

import argparse
import collections
import concurrent.futures
import functools
import multiprocessing
import shutil
import sys
import tempfile
import time
from collections.abc import Iterable
from pathlib import Path

from experiments.attack import files, kills, silent
from experiments.work import import_all

PAGE = """# A second attack

Printed by `python -m experiments.attack`, which shares nothing with the harnesses of [fuzz.md](fuzz.md), [faults.md](faults.md) and
[silent_faults.md](silent_faults.md): files are made from random parts, grafted or spliced instead of mutated, and whole commands
read them in processes of their own; kills and failing calls hit the n-th change that a command makes to the file system instead of a
moment; and the silent faults are those of a gyro that the package did not simulate.
"""


def main() -> None:
    """Parse the options and print the page."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--files", type=int, default=2000)
    parser.add_argument("--kills", type=int, default=40)
    parser.add_argument("--errors", type=int, default=40)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--jobs", type=int, default=2, help="processes that read files")
    parser.add_argument("--no-silent", action="store_true", help="leave the silent faults out")
    options = parser.parse_args()
    import_all()
    with tempfile.TemporaryDirectory(prefix="attack-") as scratch:
        folder = Path(scratch)
        print(PAGE)
        if options.files:
            print(_files(folder / "files", range(options.files), options.seed, options.jobs), flush=True)
        if options.kills + options.errors:
            print(_kills(kills.trials(folder / "kills", options.kills, options.errors, options.seed)), flush=True)
        if not options.no_silent:
            print(_silent(folder / "silent"))


def _files(folder: Path, numbers: range, seed: int, jobs: int) -> str:
    files.seeds(folder / "seeds")
    began = time.monotonic()
    counts: dict[str, collections.Counter[str]] = collections.defaultdict(collections.Counter)
    problems = []
    with concurrent.futures.ProcessPoolExecutor(jobs, multiprocessing.get_context("fork")) as pool:
        parts = pool.map(functools.partial(_part, folder, seed), [numbers[first::jobs] for first in range(jobs)])
        rows = sorted(row for part in parts for row in part)
    for number, kind, arguments, code, error, problem in rows:
        for key in (kind, "all"):
            counts[key]["cases"] += 1
            counts[key]["problem" if problem else "read" if code == 0 else "refused"] += 1
        if problem:
            message = " ".join(error.split())[-200:]
            problems.append(f"- case {number}, {kind}, `{' '.join(arguments)}`: {problem}: {message}")
    shutil.rmtree(folder)
    lines = [
        f"## {len(numbers)} files and command lines",
        "",
        "| kind | cases | read | refused | problems |",
        "|---|---|---|---|---|",
    ]
    for kind in (*files.KINDS, "all"):
        one = counts[kind]
        lines.append(f"| {kind} | {one['cases']} | {one['read']} | {one['refused']} | {one['problem']} |")
    text = (
        "\nA problem is an exit code other than 0 and 2, an internal fault, a crash, no end within a minute, 6 GB of memory, a changed "
        "input, scratch that is left, an output in spite of a refusal, or control characters on the terminal. "
        f"{time.monotonic() - began:.0f} s.\n"
    )
    return "\n".join([*lines, text, *problems])


def _part(folder: Path, seed: int, numbers: range) -> list[tuple[int, str, tuple[str, ...], int, str, str]]:
    rows = []
    for number, kind, arguments, result, problem in files.cases(folder, numbers, seed):
        rows.append((number, kind, arguments, result.code, result.error, problem or ""))
        if problem:
            print(number, kind, arguments, problem, result.error[-200:], file=sys.stderr, flush=True)
    return rows


def _kills(trials: Iterable[kills.Trial]) -> str:
    counts: dict[str, collections.Counter[str]] = collections.defaultdict(collections.Counter)
    problems = []
    for trial in trials:
        for key in (trial.command, "all"):
            counts[key]["kills" if trial.how == "kill" else "errors"] += 1
            counts[key]["problems"] += bool(trial.problems)
            counts[key]["finished"] += trial.finished
        if trial.problems:
            text = "; ".join(trial.problems).replace("\n", " ")
            problems.append(f"- {trial.command}, {trial.how} at change {trial.at} of {trial.of}: {text}")
            print(problems[-1], file=sys.stderr, flush=True)
    lines = [
        "## Kills and failing calls",
        "",
        "| command | kills | failing calls | finished by the next reader | problems |",
        "|---|---|---|---|---|",
    ]
    lines += [
        f"| {name} | {counts[name]['kills']} | {counts[name]['errors']} | {counts[name]['finished']} | {counts[name]['problems']} |"
        for name in (*(one.name for one in kills.COMMANDS), "all")
    ]
    text = (
        "\nA command is killed, or one of its calls fails with ENOSPC, EACCES, EIO, EROFS, EDQUOT or EMFILE, at one of the changes that "
        "it makes to the file system. The output must be the earlier result or the new one, the same command must then make the new "
        "one, and no scratch may be left. Files that belong together take their places one after the other; where a kill came between, "
        "the next command that reads there finishes it, and the page looks once more.\n"
    )
    return "\n".join([*lines, text, *problems])


def _silent(folder: Path) -> str:
    silent.prepare(folder)
    healthy: dict[str, set[str]] = {}
    lines = [
        f"## {len(silent.FAULTS) - 1} silent faults",
        "",
        "| fault of one of three runs | inspect | train | evaluate |",
        "|---|---|---|---|",
    ]
    unnoticed = []
    for name in silent.FAULTS:
        found = silent.noticed(name, folder)
        healthy = healthy or found
        new = {command: sorted(found[command] - healthy[command]) for command in found}
        if name != "healthy":
            lines.append(f"| {name} | {' | '.join(', '.join(codes) or '-' for codes in new.values())} |")
            unnoticed += [] if any(new.values()) else [name]
            print(lines[-1], file=sys.stderr, flush=True)
    noticed = len(silent.FAULTS) - 1 - len(unnoticed)
    return "\n".join([*lines, "", f"{noticed} of {len(silent.FAULTS) - 1} are noticed. Noticed nowhere: {', '.join(unnoticed)}."])


if __name__ == "__main__":
    main()
