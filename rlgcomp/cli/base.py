"""The application: how commands are registered, how they fail, how they show progress and results."""

from __future__ import annotations

import contextlib
import contextvars
import functools
import logging
import math
import os
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

import typer

from rlgcomp import __version__
from rlgcomp.cli.ending import ending, notify
from rlgcomp.cli.help import DocumentedCommand, DocumentedGroup
from rlgcomp.errors import InputError

_arguments: contextvars.ContextVar[str] = contextvars.ContextVar("arguments", default="")  # of the command
# findings said once for all runs: they doubt the unit, which is that of the gyro
_ONCE = {"recording.mean_above_earth_rate", "recording.noise_of_a_large_ring"}
app = typer.Typer(
    name="rlgcomp",
    cls=DocumentedGroup,
    help="Ring laser gyros: from raw recordings to a deployed bias compensation, and to the physics that a simulator is missing.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    context_settings={"help_option_names": ["-h", "--help"]},
)

Runs = Annotated[
    list[str],
    typer.Argument(
        metavar="RUN...",
        help="Recordings: .parquet, .csv, .h5, .mat and others. RUN@START:STOP is an interval in seconds, RUN@3600: all after "
        "an hour.",
    ),
]
Map = Annotated[
    list[str] | None,
    typer.Option(
        "--map",
        metavar="TARGET=SOURCE",
        help="Read a column of the file under a standard name, its unit in brackets: gyro_deg_h='Gyro Z [deg/s]'. Repeatable. "
        "README lists the names, docs/formats.md what brackets may hold; inspect FILE proposes the map of the time and the gyro.",
    ),
]
Drop = Annotated[list[str] | None, typer.Option("--drop", metavar="COLUMN", help="Leave a column of the file out. Repeatable.")]
Gyro = Annotated[
    str | None, typer.Option("--gyro", metavar="COLUMN", help="Gyro to use, where the recordings have several: gyro_z_deg_h.")
]
PulseArcsec = Annotated[
    float | None,
    typer.Option("--pulse-arcsec", metavar="ARCSEC", help="Angle of one pulse in arcsec, where the file does not state it."),
]
PeriodS = Annotated[float | None, typer.Option("--period-s", metavar="S", help="Sample period in s of a file without time stamps.")]
CalibrationFile = Annotated[
    Path | None,
    typer.Option(
        "--calibration",
        metavar="CAL.json",
        help="Calibration of calibrate or scale-factor, applied to the raw gyros: their columns then end in _deg_h.",
    ),
]
MechanismFiles = Annotated[
    list[Path] | None,
    typer.Option(
        "--mechanisms", metavar="my_physics.py", help="Python files with mechanisms of your own, which join the catalogue."
    ),
]
OnlyOwn = Annotated[
    bool,
    typer.Option("--only-mechanisms", help="Use those of --mechanisms alone, none of the catalogue: for a sensor that is no gyro."),
]
Offset = Annotated[
    tuple[str, float] | None,
    typer.Option(
        "--offset",
        metavar="zero-at-start S",
        help="Take the offset of this run, new at each switch-on, from its first S seconds, at rest and without Earth rate.",
    ),
]
Overwrite = Annotated[bool, typer.Option("--overwrite", help="Replace an output file that rlgcomp did not write.")]
AsJson = Annotated[bool, typer.Option("--json", help="Print JSON instead of tables.")]
Jobs = Annotated[int, typer.Option("--jobs", "-j", min=1, metavar="N", help="Worker processes.")]


def _version(requested: bool) -> None:
    if requested:
        typer.echo(f"rlgcomp {__version__}")
        raise typer.Exit


@app.callback()
def _application(
    version: Annotated[
        bool, typer.Option("--version", help="Print the version and exit.", callback=_version, is_eager=True)
    ] = False,
) -> None:
    pass


def command(name: str, *, several: Sequence[str] = ()) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Register a function as a command: bad input ends it with exit code 2 and one message, an internal fault with 1.

    Options in `several` take all values up to the next option (`--train a b c`), and may be repeated as well.
    """

    def register(function: Callable[..., None]) -> Callable[..., None]:
        @functools.wraps(function)
        def run(*args: Any, **kwargs: Any) -> None:
            _log_to_stderr()
            with ending():
                from rlgcomp.recording.provenance import recorded_command

                _require_numbers(kwargs)
                with recorded_command(f"rlgcomp {_arguments.get() or name}", kwargs.get("seed")):
                    function(*args, **kwargs)

        app.command(name, cls=_with_list_options(name, several))(run)
        return run

    return register


def offset_seconds(offset: tuple[str, float] | None) -> float | None:
    """The seconds at the start of a run over which its offset is taken; None without the option.

    Raises
    ------
    InputError
        The name is unknown, or the time is not positive.
    """
    from rlgcomp.compensation.start_offset import ZERO_AT_START, StartOffset

    if offset is None:
        return None
    name, duration_s = offset
    if name != ZERO_AT_START:
        raise InputError(f"--offset {name!r} is unknown; give --offset {ZERO_AT_START} and a number of seconds")
    return StartOffset(duration_s).duration_s


def mapped_output(output: str | None, spec: str, of: str = "for --output") -> list[str]:
    """The mapping that reads an output as a gyro where the file has none: a recording holds one.

    Parameters
    ----------
    output : str, optional
        Column that is no gyro.
    spec : str
        File, or an interval FILE@START:STOP of it.
    of : str
        What the output belongs to, for messages.

    Raises
    ------
    InputError
        The file has no such column.
    """
    from rlgcomp.errors import InputError
    from rlgcomp.recording import is_gyro
    from rlgcomp.recording.formats import column_names

    if not output:
        return []
    path = interval_of(spec)[0]
    names = column_names(path)
    if any(is_gyro(name) for name in names):
        return []
    if output not in names:
        raise InputError(f"{path.name} has no column {output!r} {of}; its columns are {', '.join(names)}")
    return [f"gyro_deg_h={output} [deg/h]"]


def read_runs(
    specs: Sequence[str],
    mapping: Sequence[str] | None = None,
    drop: Sequence[str] | None = None,
    pulse_arcsec: float | None = None,
    calibration: Path | None = None,
    *,
    gyro: str | None = None,
    period_s: float | None = None,
    history: bool = True,
    simulated: bool = False,
    also: Sequence[str] = (),
) -> list[Any]:
    """Read recordings, cut intervals out and calibrate them; findings are printed on standard error.

    Parameters
    ----------
    specs : sequence of str
        Files, or intervals FILE@START:STOP in s.
    mapping : sequence of str, optional
        TARGET=SOURCE, as of `--map`. A mapped column must be in one of the files or of those in `also`, not in each.
    drop : sequence of str, optional
        Columns that are not read.
    pulse_arcsec : float, optional
        Angle of one pulse, where the file does not state it.
    calibration : Path, optional
        Calibration applied to the raw gyros.
    gyro : str, optional
        Gyro to which the calibration of a single gyro is applied, where there are several.
    period_s : float, optional
        Sample period of a file without time stamps.
    history : bool
        Whether samples before an interval stay as its lead-in. Turntable calibrations do not use them.
    simulated : bool
        Whether a simulator computed the files: their columns may be constant and free of noise.
    also : sequence of str
        Further files of the command, in which a mapped column may be.

    Raises
    ------
    InputError
        A file cannot be used, or no file has a column that is mapped.
    """
    from rlgcomp.recording.argument_checks import with_distinct_names
    from rlgcomp.recording.formats import column_names, read
    from rlgcomp.recording.formats.mapping import has_column, parse_mapping, require_mapped

    columns = parse_mapping(list(mapping or []))
    files = [interval_of(spec)[0] for spec in (*specs, *also)] if columns else []
    names = {path: column_names(path, list(columns.values())) for path in files}
    require_mapped(columns, names)
    calibrated = None
    if calibration is not None:
        from rlgcomp.calibration.file import Calibration

        calibrated = Calibration.read(calibration)
    recordings: list[Any] = []
    once: dict[tuple[str, str | None], list[str]] = {}
    with progress("reading", len(specs)) as advance:
        for done, spec in enumerate(specs, start=1):
            path, interval = interval_of(spec)
            recording = read(
                path,
                columns={target: source for target, source in columns.items() if has_column(names[path], source)},
                drop=list(drop or []),
                metadata={"pulse_arcsec": pulse_arcsec},
                period_s=period_s,
                simulated=simulated,
            )
            for finding in recording.findings:
                if finding.message.code in _ONCE:
                    once.setdefault((finding.message.code, finding.column), []).append(f"{recording.name}: {finding}")
                else:
                    notify(f"{recording.name}: {finding}")
            if interval is not None:
                _require_rows(recording, interval, spec)
                recording = recording.between(*interval, keep_history=history, name=f"{recording.name}{_interval_text(*interval)}")
            if calibrated is not None:
                recording = calibrated.apply(recording, gyro if len(recording.gyro_columns) > 1 else None)
            recordings.append(recording)
            advance(done, len(specs))
    for first, *others in once.values():
        notify(f"{first}; likewise in {len(others)} of {len(specs) - 1} other runs" if others else first)
    return with_distinct_names(specs, recordings)


def compared(recordings: Sequence[Any], gyro: str | None = None) -> list[Any]:
    """Messages on runs of one gyro that differ from each other or are copies, printed on standard error before the work goes on."""
    from rlgcomp.recording.comparison import compare

    messages = list(compare(recordings, gyro))
    for one in messages:
        notify(f"warning: {one.text}")
    return messages


def calibrated_name(gyro: str | None, calibration: Path | None) -> str | None:
    """The column of the chosen gyro after calibration."""
    from rlgcomp.recording import rate_name

    return gyro if gyro is None or calibration is None else rate_name(gyro)


def candidates_of(mechanisms: Sequence[Path] | None, only: bool) -> Any:
    """Candidate mechanisms: the catalogue with the user's mechanisms, or the user's alone.

    Raises
    ------
    InputError
        A file defines no mechanism, or `only` is set without a file.
    """
    from rlgcomp.errors import InputError
    from rlgcomp.physics.user import user_catalogue

    if only and not mechanisms:
        raise InputError("--only-mechanisms tries none of the catalogue; give your own with --mechanisms my_physics.py")
    return user_catalogue(mechanisms or [], {}) if only else user_catalogue(mechanisms or [])


def require_folder(out: Path, writes: Sequence[str], *read: str | Path | Sequence[str | Path] | None) -> None:
    """Raise unless a command can write a folder of this name; called before the work.

    Parameters
    ----------
    out : path
    writes : sequence of str
        As :func:`rlgcomp.files.whole_folder` takes them.
    *read : str, path, sequence of them, or None
        Inputs of the command, also as RUN@START:STOP or FILE.py:FUNCTION: none may lie in the folder.

    Raises
    ------
    InputError
        As :func:`rlgcomp.files.require_folder`, or an input lies in the folder.
    """
    from rlgcomp.files import require_apart
    from rlgcomp.files import require_folder as require_place

    require_place(out, writes=writes)
    for inputs in read:
        for file in [inputs] if isinstance(inputs, str | Path) else inputs or []:
            text = str(file)
            require_apart(out, text, text.rpartition("@")[0], text.rpartition(":")[0])


def place_with(scratch: Path, folder: Path, other: Path) -> Path | None:
    """The path at which a further output is written so that it takes its place together with a folder.

    Parameters
    ----------
    scratch : Path
        As :func:`rlgcomp.files.whole_folder` yields it for the folder.
    folder, other : Path
        Final places of the folder and of the further output.

    Returns
    -------
    Path or None
        None where the output lies neither in the folder nor beside it: then it has to be written by itself.
    """
    place = Path(os.path.realpath(folder))
    final = Path(os.path.realpath(other.absolute().parent)) / other.name
    if place in final.parents:
        return scratch / final.relative_to(place)
    return scratch.parent / final.name if final.parent == place.parent else None


def require_recording(out: Path, *read: str | Path | Sequence[str | Path] | None, overwrite: bool = False) -> None:
    """Raise unless a command can write a recording of this name; called before the work.

    Parameters
    ----------
    out : Path
    *read : str, path, sequence of them, or None
        Inputs of the command.
    overwrite : bool
        Whether a file that rlgcomp did not write may be replaced.

    Raises
    ------
    InputError
        As :func:`require_unread` and :func:`rlgcomp.recording.formats.require_recordable`.
    """
    from rlgcomp.recording.formats import require_recordable, written_beside

    require_recordable(out, overwrite=overwrite)
    for file in written_beside(out):
        require_unread(file, *read)


def require_unread(out: Path, *read: str | Path | Sequence[str | Path] | None) -> None:
    """Raise where the output file of a command is one of its inputs, also as RUN@START:STOP.

    Raises
    ------
    InputError
        The output would overwrite an input.
    """
    from rlgcomp.files import same_file

    for inputs in read:
        for file in [inputs] if isinstance(inputs, str | Path) else inputs or []:
            if same_file(out, file) or same_file(out, interval_of(str(file))[0]):
                raise InputError(f"{out} would be overwritten, and it is read: {file}; give another name with --out")


@contextlib.contextmanager
def progress(what: str, total: int | None = None) -> Iterator[Callable[[int, int], None]]:
    """A progress bar on standard error; quiet where that is no terminal."""
    if not sys.stderr.isatty():
        yield lambda done, total: None
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(what, total=total)
        yield lambda done, total: bar.update(task, completed=done, total=total)


def repeated_options(arguments: Sequence[str], several: Sequence[str]) -> list[str]:
    """Arguments in which each value of a list option follows an option of its own.

    >>> repeated_options(["--train", "a", "b", "--out", "c"], ["--train"])
    ['--train', 'a', '--train', 'b', '--out', 'c']
    """
    repeated: list[str] = []
    option, values = None, 0
    for argument in arguments:
        name, equals, _ = argument.partition("=")
        if argument.startswith("-") and argument != "-":
            option, values = (name, int(bool(equals))) if name in several else (None, 0)
            repeated.append(argument)
            continue
        if option is not None and values:
            repeated.append(option)
        values += 1
        repeated.append(argument)
    return repeated


def _require_numbers(options: Mapping[str, Any]) -> None:
    """Refuse NaN, which passes every bound."""
    for name, value in options.items():
        if any(isinstance(one, float) and math.isnan(one) for one in (value if isinstance(value, list | tuple) else [value])):
            raise InputError(f"--{name.replace('_', '-')} is nan, which is no number; give a number, or leave it out")


def _with_list_options(name: str, several: Sequence[str]) -> type[DocumentedCommand]:
    """A command that knows its own arguments, in which options take all values up to the next one."""

    class WithListOptions(DocumentedCommand):
        def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
            import shlex

            _arguments.set(shlex.join([name, *args]))
            return super().parse_args(ctx, repeated_options(args, several))

    return WithListOptions


def _require_rows(recording: Any, interval: tuple[float, float], spec: str) -> None:
    from rlgcomp.errors import InputError

    start, stop = float(recording.time_s[0]), float(recording.time_s[-1])
    if interval[0] >= interval[1]:
        after = "after" if interval[0] > interval[1] else "at"
        raise InputError(
            f"{spec}: START, {interval[0]:.10g} s, is {after} STOP, {interval[1]:.10g} s; write the smaller first; the run "
            f"covers {start:.10g} to {stop:.10g} s"
        )
    if interval[1] <= start or interval[0] > stop:
        raise InputError(
            f"{spec}: nothing lies between {interval[0]:.10g} and {interval[1]:.10g} s; the run covers {start:.10g} to "
            f"{stop:.10g} s"
        )


def interval_of(spec: str) -> tuple[Path, tuple[float, float] | None]:
    """The file of FILE@START:STOP, and its interval in s where there is one."""
    path, at, span = spec.rpartition("@")
    if not at or Path(spec).exists():
        return Path(spec), None
    start, colon, stop = span.partition(":")
    try:
        if not colon:
            raise ValueError
        return Path(path), (float(start) if start else float("-inf"), float(stop) if stop else float("inf"))
    except ValueError:
        raise InputError(f"{spec}: expected FILE@START:STOP with times in seconds, as in run.parquet@0:3600") from None


def _interval_text(start_s: float, stop_s: float) -> str:
    since = f" from {start_s:g} s" if math.isfinite(start_s) else ""
    return since + (f" to {stop_s:g} s" if math.isfinite(stop_s) else "")


class _StderrHandler(logging.StreamHandler):  # type: ignore[type-arg]  # generic in stubs alone
    """Writes to what is standard error at the moment, also where a program that runs several commands replaces it."""

    def emit(self, record: logging.LogRecord) -> None:
        self.stream = sys.stderr
        super().emit(record)


def _log_to_stderr() -> None:
    logger = logging.getLogger("rlgcomp")
    if not logger.handlers:
        handler = _StderrHandler()
        handler.setFormatter(logging.Formatter("%(levelname)s: %(message)s"))
        logger.addHandler(handler)
        logger.setLevel(logging.INFO)
