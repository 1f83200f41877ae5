"""The command for many gyros at once: fleet."""

from __future__ import annotations

import csv
import functools
from pathlib import Path
from typing import Annotated, Final

import typer

from rlgcomp.cli.base import AsJson, Gyro, Jobs, command, progress
from rlgcomp.cli.ending import notify
from rlgcomp.cli.show import show_json, show_table

USUAL: Final = ("lssvm-dynamic", "lssvm", "cubic", "dynamic")  # whose names are known before scikit-learn is imported for all
_AVERAGING_S: Final = 100.0
_UNIT_S, _BYTES_PER_S = 0.05, 75e6  # least time of a training by a usual model, and the recordings that it reads in more time
_PAYS_S: Final = 0.6  # of work, from which several workers end sooner than one: docs/performance.md, Fleets


@command("fleet")
def fleet(
    task: Annotated[str, typer.Argument(metavar="TASK", help="train or diagnose.")],
    table: Annotated[
        Path,
        typer.Argument(metavar="UNITS.csv", help="Columns unit and train, for diagnose also test and simulator; ';' between runs."),
    ],
    out: Annotated[Path, typer.Option("--out", "-o", metavar="DIR", help="Folder for one folder a unit, and fleet.json.")],
    model: Annotated[str, typer.Option(metavar="NAME", help="Of train: as for `rlgcomp train`.")] = "lssvm-dynamic",
    features: Annotated[str, typer.Option(metavar="NAME,NAME,...", help="Of train: as for `rlgcomp train`.")] = "all",
    averaging_s: Annotated[float, typer.Option(metavar="S", help="Of train: averaging time in s.")] = _AVERAGING_S,
    keep_mean: Annotated[bool, typer.Option("--keep-mean", help="Of train: as for `rlgcomp train`.")] = False,
    gyro: Gyro = None,
    seed: Annotated[int, typer.Option(min=0, metavar="N", help="Of diagnose: seed of the draws of p-values and intervals.")] = 0,
    scheduler: Annotated[
        str | None, typer.Option("--scheduler", metavar="tcp://HOST:PORT", help="Dask scheduler whose workers do the work.")
    ] = None,
    jobs: Jobs = 1,
    as_json: AsJson = False,
) -> None:
    """Train or diagnose many gyros at once.

    Each unit is a task of its own: failures are reported and the others finished. The same command resumes a
    fleet that was stopped. Several workers take a moment to start: a few small units are trained by one.

    Example: `rlgcomp fleet train units.csv --out models --jobs 2`
    """
    from rlgcomp.workers import imports_of, prepare

    quick = task == "train" and model in USUAL and averaging_s >= _AVERAGING_S
    if jobs > 1 and not scheduler and quick and not workers_pay(table):
        notify(f"{table}: one worker trains these units; {jobs} would take longer to start than they save")
        jobs = 1
    prepare(1 if scheduler else jobs, imports_of(f"rlgcomp.fleet.{task}_unit"))

    from rlgcomp.errors import InputError
    from rlgcomp.files import require_writable
    from rlgcomp.fleet import Task, diagnose_unit, read_fleet, run_fleet, train_unit

    require_writable(out)
    if model not in USUAL:
        from rlgcomp.compensation.models import MODELS

        if model not in MODELS:
            raise InputError(f"--model {model!r} is unknown; known are {', '.join(MODELS)}")
    tasks: dict[str, Task] = {
        "train": functools.partial(
            train_unit, model=model, features=features, averaging_s=averaging_s, keep_mean=keep_mean, gyro=gyro
        ),
        "diagnose": functools.partial(diagnose_unit, seed=seed, gyro=gyro),
    }
    if task not in tasks:
        raise InputError(f"the task {task!r} is unknown; give train or diagnose")
    units = read_fleet(table)
    with progress(task, len(units)) as advance:
        outcomes = run_fleet(tasks[task], units, out, n_jobs=jobs, scheduler=scheduler, progress=advance)
    failed = [outcome for outcome in outcomes if outcome.state == "failed"]
    if as_json:
        show_json([outcome.to_mapping() for outcome in outcomes])
    else:
        rows = [
            {
                "unit": one.unit,
                "": one.state,
                "s": f"{one.seconds:.1f}",
                "result": one.message
                or ", ".join(f"{key} {_value_text(value)}" for key, value in one.result.items() if value != {}),
            }
            for one in outcomes
        ]
        show_table(f"{task}: {len(outcomes) - len(failed)} of {len(outcomes)} units", rows)
    if failed:
        raise InputError(f"{len(failed)} of {len(outcomes)} units failed, the first {failed[0].unit}: {failed[0].message}")
    notify(f"{out}: written")


def workers_pay(table: Path) -> bool:
    """Whether to train the units of a table takes so long that several workers end sooner than one, by the sizes of their files.

    A table that cannot be read is left to :func:`rlgcomp.fleet.read_fleet`, which says what is wrong with it.
    """
    if not table.is_file():
        return True
    work_s = 0.0
    try:
        with table.open(encoding="utf-8", newline="") as stream:
            for row in csv.DictReader(stream, skipinitialspace=True):
                files = [table.parent / name.strip() for name in (row.get("train") or "").split(";")]
                work_s += _UNIT_S + sum(file.stat().st_size for file in files if file.is_file()) / _BYTES_PER_S
                if work_s >= _PAYS_S:
                    return True
    except (OSError, ValueError, csv.Error):
        return True
    return False


def _value_text(value: object) -> str:
    if isinstance(value, dict):
        return " ".join(f"{key}={_value_text(item)}" for key, item in value.items())
    return f"{value:.4g}" if isinstance(value, float) else str(value)
