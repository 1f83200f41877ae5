"""Many gyros at once: each unit one task, on one machine or on a cluster; failures are reported and the others finished.

A table names the units and their runs. Each unit's result is a folder, written atomically with a note that identifies its inputs:
a fleet that was stopped resumes, and a unit whose files or settings have changed is done again. :mod:`rlgcomp.workers` distributes
the work.
"""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import glob
import hashlib
import io
import logging
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import pandas as pd

from rlgcomp import __version__
from rlgcomp.errors import InputError
from rlgcomp.files import from_json, read_text, require_apart, sha256, to_json, whole_folder, write_json, write_text
from rlgcomp.recording.argument_checks import require_workers
from rlgcomp.recording.formats import sidecar
from rlgcomp.recording.provenance import provenance, recorded_command, running_command, with_digests
from rlgcomp.scratch import PREFIX, recover
from rlgcomp.workers import DIED, imports_of, spread

NOTE: Final = "unit.json"
SUMMARY: Final = "fleet.json"
Task = Callable[["Unit", Path], Mapping[str, Any]]
logger = logging.getLogger(__name__)
_UNIT, _TRAIN = "unit", "train"
_ENDING_S: Final = 3.0  # within which workers end with this process


@dataclasses.dataclass(frozen=True)
class Unit:
    """One gyro.

    Parameters
    ----------
    name : str
        Also the name of its folder.
    train, test : tuple of Path
        Its recordings.
    simulator : Path, optional
    """

    name: str
    train: tuple[Path, ...]
    test: tuple[Path, ...] = ()
    simulator: Path | None = None

    @property
    def files(self) -> tuple[Path, ...]:
        return (*self.train, *self.test, *(() if self.simulator is None else (self.simulator,)))


@dataclasses.dataclass(frozen=True)
class Outcome:
    """The outcome of one unit.

    Parameters
    ----------
    unit : str
    state : {"done", "kept", "failed"}
        "kept": an earlier run had finished it.
    seconds : float
        Duration of its task.
    result : mapping
        Result of its task.
    message : str
        Reason of the failure.
    """

    unit: str
    state: str
    seconds: float = 0.0
    result: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    message: str = ""

    def to_mapping(self) -> dict[str, Any]:
        """Plain mapping, for JSON."""
        return dataclasses.asdict(self)


def read_fleet(path: str | Path) -> list[Unit]:
    """Units of a CSV table with the columns `unit` and `train`, and if wanted `test` and `simulator`.

    Several recordings stand in one field, with semicolons between them; paths are taken from the table's folder.

    Raises
    ------
    InputError
        The table cannot be read, lacks a column, names a unit twice, or names no recording of one.
    """
    path = Path(path)
    try:
        text = read_text(path).lstrip("\ufeff")
        header = next((line for line in text.splitlines() if line.strip()), "")
        separator = max((",", ";", "\t"), key=lambda sign: len({_UNIT, _TRAIN} & {name.strip(' "') for name in header.split(sign)}))
        table = pd.read_csv(io.StringIO(text), sep=separator, dtype=str, keep_default_na=False, skipinitialspace=True)
        table = table.rename(columns=lambda name: str(name).strip())
    except FileNotFoundError:
        raise InputError(f"{path} does not exist; give a CSV table of units") from None
    except (pd.errors.ParserError, pd.errors.EmptyDataError, ValueError, OSError) as error:
        raise InputError(f"{path} is not readable as CSV: {str(error).splitlines()[0]}") from None
    missing = [column for column in (_UNIT, _TRAIN) if column not in table]
    if missing or table.empty:
        received = f"lacks the column {missing[0]}" if missing else "has no rows"
        apart = {",": "commas", ";": "semicolons", "\t": "tabs"}[separator]
        raise InputError(
            f"{path} {received}; it needs the columns unit and train, recordings with semicolons between them, and has "
            f"{', '.join(table.columns)}, read between {apart}"
        )
    unused = [column for column in table.columns if column not in (_UNIT, _TRAIN, "test", "simulator")]
    if unused:
        logger.warning("%s: not used: the columns %s; used are unit, train, test and simulator", path, ", ".join(unused))
    units = []
    for row in table.to_dict("records"):
        name = str(row[_UNIT]).strip()
        if not name or name.startswith(".") or Path(name).name != name:
            raise InputError(f"{path}: the unit's name {name!r} cannot name a folder; use letters, digits and dashes")
        train, test = (_paths(path, str(row.get(column, ""))) for column in (_TRAIN, "test"))
        simulator = _paths(path, str(row.get("simulator", "")))
        if not train:
            raise InputError(f"{path}: unit {name} has no recording under train; name at least one")
        units.append(Unit(name, train, test, simulator[0] if simulator else None))
    names = [unit.name for unit in units]
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise InputError(f"{path}: units are named twice: {', '.join(twice)}; put all recordings of a unit into one row")
    return units


def run_fleet(
    task: Task,
    units: Sequence[Unit],
    out: str | Path,
    *,
    n_jobs: int = 1,
    scheduler: str | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> list[Outcome]:
    """Do a task for every unit; results in one folder a unit, a summary beside them.

    Parameters
    ----------
    task : callable
        (unit, folder) to a mapping of results; it writes its files into the folder. It must be picklable, and its `repr` or that of
        its arguments must state its settings.
    units : sequence of Unit
    out : path
        Made where it does not exist.
    n_jobs : int
        Worker processes on this machine.
    scheduler : str, optional
        Address of a Dask scheduler, as tcp://host:8786.
    progress : callable, optional
        Called with (done, total).

    Returns
    -------
    list of Outcome
        In the order of the units.

    Raises
    ------
    InputError
        The folder cannot be made, or the scheduler cannot be reached.
    """
    n_jobs = require_workers(n_jobs)
    out = Path(out).absolute()
    try:
        out.mkdir(exist_ok=True)
    except OSError as error:
        raise InputError(f"cannot make the folder {out}: {error.strerror or error}; give another place") from None
    by_unit: dict[str, Outcome] = {}
    waiting = []
    for unit in units:
        earlier = _earlier_outcome(task, unit, out)
        if earlier is None:
            waiting.append(unit)
        else:
            by_unit[unit.name] = earlier
    advance = progress or (lambda done, total: None)
    advance(len(by_unit), len(units))
    attempt = functools.partial(_attempt, task, out, running_command())
    finished = spread(attempt, waiting, died=_died, n_jobs=n_jobs, scheduler=scheduler, modules=imports_of(_name_of(task)))
    try:
        for outcome in finished:
            by_unit[outcome.unit] = outcome
            advance(len(by_unit), len(units))
    except BaseException:
        _sweep(out)
        raise
    outcomes = [by_unit[unit.name] for unit in units]
    write_json(out / SUMMARY, [outcome.to_mapping() for outcome in outcomes])
    return outcomes


def _sweep(out: Path) -> None:
    """Remove the scratch of workers that were ended with this process."""
    until = time.monotonic() + _ENDING_S
    while any(path.name.startswith(PREFIX) for path in out.iterdir()) and time.monotonic() < until:
        recover(out)
        time.sleep(0.1)


def train_unit(
    unit: Unit,
    folder: Path,
    *,
    model: str = "lssvm-dynamic",
    features: str = "all",
    averaging_s: float = 100.0,
    keep_mean: bool = False,
    gyro: str | None = None,
) -> dict[str, Any]:
    """A task: train a compensation on the unit's runs.

    Parameters
    ----------
    unit : Unit
    folder : Path
        The model is written to its subfolder `model`.
    model, features : str
        As of `rlgcomp train`.
    averaging_s : float
        The model is trained on means over this time.
    keep_mean : bool
        As of :class:`rlgcomp.Compensator`.
    gyro : str, optional
        Gyro column, where the recordings have several.
    """
    from rlgcomp.compensation.compensator import Compensator
    from rlgcomp.compensation.models import MODELS
    from rlgcomp.recording.formats import read

    compensator = Compensator(MODELS[model].make(), features=features, averaging_s=averaging_s, keep_mean=keep_mean, gyro=gyro)
    compensator.fit([read(path) for path in unit.train])
    compensator.provenance_ = with_digests(compensator.provenance_, unit.train)
    compensator.save(folder / "model")
    rmse = compensator.selection_.rmse
    scale = compensator.scaling_.y_scale_deg_h
    return {
        "selected": compensator.selection_.best,
        "before_rms_deg_h": scale,
        "left_out_rms_deg_h": None if rmse is None else rmse * scale,
    }


def diagnose_unit(unit: Unit, folder: Path, *, seed: int = 0, gyro: str | None = None) -> dict[str, Any]:
    """A task: diagnose the unit's simulator.

    Parameters
    ----------
    unit : Unit
        With a simulator file.
    folder : Path
        Receives `diagnosis.json`, `augmented.yaml`, `report.html` and its `figures`.
    seed : int
        Of all random streams.
    gyro : str, optional
        Gyro column, where the recordings have several.

    Raises
    ------
    InputError
        The unit has no simulator.
    """
    from rlgcomp.diagnosis.diagnose import diagnose
    from rlgcomp.recording.argument_checks import with_distinct_names
    from rlgcomp.recording.formats import read
    from rlgcomp.simulation.simulator import Simulator

    if unit.simulator is None:
        raise InputError(f"unit {unit.name} has no simulator; name its file in the table's column simulator")
    simulator = Simulator.from_yaml(unit.simulator)
    paths = [*unit.train, *unit.test]
    runs = with_distinct_names([str(path) for path in paths], [read(path) for path in paths])
    diagnosis = diagnose(simulator, runs[: len(unit.train)], runs[len(unit.train) :], gyro=gyro, seed=seed).of_files(
        unit.train, unit.test
    )
    diagnosis.save(folder)
    diagnosis.report(folder / "report.html", figures=folder / "figures")
    return {"verdict": diagnosis.verdict, "found": [cause.name for cause in diagnosis.causes], "p_value": diagnosis.p_value}


# --- one unit ------------------------------------------------------------------------------------------------------------------


def _attempt(task: Task, out: Path, command: tuple[str | None, int | None], unit: Unit) -> Outcome:
    """Do one unit's task, of a command where one is running; every exception becomes a failed outcome."""
    began = time.perf_counter()
    place = out / unit.name
    try:
        require_apart(place, *unit.files)
        with whole_folder(place, writes=_written(task, place)) as folder, _named(unit.name), recorded_command(*command):
            result = dict(task(unit, folder))
            note = {
                "made_from": _fingerprint(task, unit),
                "task": _name_of(task),
                "provenance": provenance(unit.files),
                "files": {
                    path.relative_to(folder).as_posix(): sha256(path) for path in sorted(folder.rglob("*")) if path.is_file()
                },
                "seconds": time.perf_counter() - began,
                "result": result,
            }
            write_text(folder / NOTE, to_json(note) + "\n")
    except InputError as error:
        return Outcome(unit.name, "failed", time.perf_counter() - began, message=str(error))
    except OSError as error:
        reason = f"cannot use {error.filename or place}: {error.strerror or error}"
        return Outcome(unit.name, "failed", time.perf_counter() - began, message=reason)
    except Exception as error:  # noqa: BLE001  one unit's fault must not take the fleet with it
        return Outcome(unit.name, "failed", time.perf_counter() - began, message=f"{type(error).__name__}: {error}")
    return Outcome(unit.name, "done", time.perf_counter() - began, result)


@contextlib.contextmanager
def _named(unit: str) -> Iterator[None]:
    """Messages logged meanwhile begin with the unit's name."""
    usual = logging.getLogRecordFactory()

    def named(*args: Any, **kwargs: Any) -> logging.LogRecord:
        record = usual(*args, **kwargs)
        record.msg, record.args = f"{unit}: {record.getMessage()}", ()
        return record

    logging.setLogRecordFactory(named)
    try:
        yield
    finally:
        logging.setLogRecordFactory(usual)


def _earlier_outcome(task: Task, unit: Unit, out: Path) -> Outcome | None:
    """The outcome of an earlier run that was made from the same inputs and whose files are as it wrote them."""
    try:
        note = from_json(read_text(out / unit.name / NOTE))
        if note["made_from"] == _fingerprint(task, unit) and _undamaged(out / unit.name, note["files"]):
            return Outcome(unit.name, "kept", float(note["seconds"]), note["result"])
    except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError):
        pass
    return None


def _undamaged(folder: Path, digests: Mapping[str, str]) -> bool:
    return all(sha256(folder / name) == digest for name, digest in digests.items())


def _written(task: Task, place: Path) -> tuple[str, ...]:
    """Files that an earlier run of the same task wrote for a unit, its note the first."""
    try:
        note = from_json(read_text(place / NOTE))
        files = tuple(map(glob.escape, note["files"])) if note["task"] == _name_of(task) else ()
    except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError):
        files = ()
    return (NOTE, *files)


def _name_of(task: Task) -> str:
    function = task.func if isinstance(task, functools.partial) else task
    return f"{function.__module__}.{function.__qualname__}"


def _fingerprint(task: Task, unit: Unit) -> str:
    """Digest of the version, the task and its settings, and the names and contents of the files and their sidecars."""
    settings = task.keywords if isinstance(task, functools.partial) else {}
    digest = hashlib.sha256(f"{__version__} {_name_of(task)} {sorted(settings.items())!r}".encode())
    for group in (unit.train, unit.test, () if unit.simulator is None else (unit.simulator,)):
        digest.update(b"|")
        for path in group:
            digest.update(f"{path.name} {sha256(path)} ".encode())
            if (metadata := sidecar(path)).is_file():
                digest.update(f"{metadata.name} {sha256(metadata)} ".encode())
    return digest.hexdigest()


def _died(unit: Unit) -> Outcome:
    return Outcome(unit.name, "failed", message=DIED)


def _paths(table: Path, field: str) -> tuple[Path, ...]:
    return tuple(table.absolute().parent / part.strip() for part in field.split(";") if part.strip())
