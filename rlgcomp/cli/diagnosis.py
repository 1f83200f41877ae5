"""Commands on what a simulator is missing: diagnose."""

from __future__ import annotations

import contextlib
import dataclasses
import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final

import typer

from rlgcomp.cli.base import (
    AsJson,
    CalibrationFile,
    Drop,
    Gyro,
    Map,
    MechanismFiles,
    OnlyOwn,
    PeriodS,
    PulseArcsec,
    calibrated_name,
    candidates_of,
    command,
    compared,
    interval_of,
    progress,
    read_runs,
    require_folder,
)
from rlgcomp.cli.ending import notify
from rlgcomp.cli.show import show_json, show_text

if TYPE_CHECKING:
    from concurrent.futures import Executor

    from rlgcomp.diagnosis.simulators.user_simulator import UserSimulator
    from rlgcomp.noise.processes import NoiseModel
    from rlgcomp.physics.mechanism import Mechanism
    from rlgcomp.recording import Recording
    from rlgcomp.simulation.simulator import Simulator

RUNS = "RUN..."
Reading = tuple[list[str] | None, list[str] | None, float | None, Path | None, float | None]  # --map --drop --pulse-arcsec, …
ONE_MODEL: Final = "one-model"
ENGINES: Final = ("catalogue", ONE_MODEL)
FILES: Final = ("diagnosis.json", "augmented.yaml", "report.html")  # what `diagnose` writes
_SLOW_IMPORTS: Final = (  # for the LS-SVM, then for the pictures
    "rlgcomp.compensation.compensator",
    "rlgcomp.diagnosis.proof.black_box",
    "rlgcomp.diagnosis.result.page",
    "rlgcomp.diagnosis.result.pictures",
    "matplotlib.backends.backend_svg",
)


@command("diagnose", several=("--train", "--test", "--confirm", "--simulated", "--mechanisms", "--without", "--only"))
def diagnose(
    train: Annotated[list[str], typer.Option("--train", metavar=RUNS, help="Recordings to explain, or parts RUN@START:STOP.")],
    out: Annotated[
        Path,
        typer.Option(
            "--out", "-o", metavar="DIR", help="Folder for diagnosis.json, augmented.yaml and report.html, replaced as a whole."
        ),
    ],
    test: Annotated[
        list[str] | None, typer.Option("--test", metavar=RUNS, help="Recordings held out, best of other programmes: the proof.")
    ] = None,
    simulator: Annotated[
        str | None,
        typer.Option(
            "--simulator",
            metavar="SIM.yaml|my_sim.py:function",
            help="Simulator file, or your own Python function: of a recording (run.column(NAME), run.table), deg/h a row.",
        ),
    ] = None,
    simulated: Annotated[
        list[str] | None,
        typer.Option("--simulated", metavar=RUNS, help="Output of your own simulator: a file a run, in the order of the runs."),
    ] = None,
    mechanisms: MechanismFiles = None,
    only_own: OnlyOwn = False,
    gyro: Gyro = None,
    averaging_s: Annotated[
        float | None,
        typer.Option(
            "--averaging-s",
            help="Averaging time; 100 s, or a two hundredth of the longest run where that is less.",
            show_default=False,
        ),
    ] = None,
    noise: Annotated[
        Path | None,
        typer.Option(
            metavar="NOISE",
            help="The gyro's noise at rest: coefficients.json of `rlgcomp allan --out`, or a .yaml of strengths.",
        ),
    ] = None,
    chamber: Annotated[
        tuple[float, float, float] | None,
        typer.Option(
            metavar="LOWEST HIGHEST FASTEST",
            help="What the chamber can do, in degC and degC/min (-40 70 2), for the next experiment; as recorded unless given.",
            show_default=False,
        ),
    ] = None,
    confirm: Annotated[
        list[str] | None,
        typer.Option(
            "--confirm", metavar=RUNS, help="Recordings that take part in the choice, not in the fit (--engine one-model)."
        ),
    ] = None,
    no_confirm: Annotated[
        bool, typer.Option("--no-confirm", help="--engine catalogue: let the held-out runs prove and decide nothing.")
    ] = False,
    without: Annotated[
        list[str] | None, typer.Option("--without", metavar="NAME...", help="Candidates to leave out (--engine one-model).")
    ] = None,
    only: Annotated[
        list[str] | None, typer.Option("--only", metavar="NAME...", help="The only candidates (--engine one-model).")
    ] = None,
    output: Annotated[
        str | None,
        typer.Option("--output", metavar="COLUMN", help="Another quantity than a gyro's output, as force_N (--engine one-model)."),
    ] = None,
    engine: Annotated[
        str,
        typer.Option(
            "--engine",
            metavar="catalogue|one-model",
            help="catalogue: mechanisms, then laws; held-out runs are asked. one-model: one evidence; test runs only prove.",
        ),
    ] = "catalogue",
    seed: Annotated[int, typer.Option(min=0, help="Seed of all random streams.")] = 0,
    mapping: Map = None,
    drop: Drop = None,
    pulse_arcsec: PulseArcsec = None,
    period_s: PeriodS = None,
    calibration: CalibrationFile = None,
    as_json: AsJson = False,
) -> None:
    """What physics a simulator is missing: where, what, how sure, and what it gains on runs held out.

    The simulator's free parameters are calibrated first, so that wrong numbers are not taken for missing physics.

    Example: `rlgcomp diagnose --simulator gyro.yaml --train cold.parquet hot.parquet --test new.parquet --out diagnosis`
    """
    from rlgcomp.errors import InputError
    from rlgcomp.files import from_json, read_text, whole_folder

    require_folder(out, FILES, train, test, confirm, simulator, simulated, mechanisms, noise, calibration)
    if averaging_s is not None and not 0.0 < averaging_s < math.inf:
        raise InputError(f"--averaging-s is {averaging_s:g}; it must be positive and finite")
    _require_of_engine(engine, confirm=confirm, without=without, only=only, output=output, no_confirm=no_confirm)
    if engine == ONE_MODEL:
        _diagnose_on_one_model(
            train,
            test or [],
            confirm or [],
            out,
            simulator=simulator,
            simulated=simulated,
            candidates=candidates_of(mechanisms, only_own),
            without=without or [],
            only=only or [],
            gyro=gyro,
            output=output,
            averaging_s=averaging_s,
            noise=None if noise is None else measured_noise(noise, gyro),
            chamber=chamber,
            seed=seed,
            reading=(mapping, drop, pulse_arcsec, calibration, period_s),
            as_json=as_json,
        )
        return
    with background_process(_SLOW_IMPORTS) as executor:
        from rlgcomp.diagnosis.diagnose import diagnose as diagnose_runs
        from rlgcomp.physics import CATALOGUE

        candidates = candidates_of(mechanisms, only_own)
        catalogue = {**CATALOGUE, **candidates}
        chosen = _simulator(simulator, simulated, catalogue)
        measured = None if noise is None else measured_noise(noise, gyro)
        specs = [*train, *(test or [])]
        runs, own = _runs(specs, simulated, gyro, (mapping, drop, pulse_arcsec, calibration, period_s))
        compared(runs, calibrated_name(gyro, calibration))
        with progress("diagnosing", 100) as advance:
            diagnosis = diagnose_runs(
                chosen,
                runs[: len(train)],
                runs[len(train) :],
                simulated=own,
                mechanisms=candidates,
                gyro=calibrated_name(gyro, calibration),
                window_s=averaging_s,
                noise=measured,
                chamber=chamber,
                confirm=not no_confirm,
                seed=seed,
                progress=lambda fraction: advance(round(100 * fraction), 100),
                executor=executor,
            )
        train_files, test_files = ([interval_of(spec)[0] for spec in runs or []] for runs in (train, test))
        diagnosis = diagnosis.of_files(train_files, test_files, _file_of(simulator))
        with whole_folder(out, writes=FILES) as folder:
            diagnosis.save(folder)
            diagnosis.report(folder / "report.html", None if mechanisms else executor)  # the worker cannot import a user's file
    if as_json:
        show_json(from_json(read_text(out / "diagnosis.json")))
        return
    show_text(str(diagnosis))
    notify(f"{out / 'report.html'}: written, with diagnosis.json and augmented.yaml beside it")


def _require_of_engine(engine: str, **given: object) -> None:
    """Refuse an unknown engine, and options that belong to the other one.

    Raises
    ------
    InputError
        An option was given that this engine does not have.
    """
    from rlgcomp.errors import InputError

    if engine not in ENGINES:
        raise InputError(f"--engine is {engine!r}; it must be one of {', '.join(ENGINES)}")
    other = ("no_confirm",) if engine == ONE_MODEL else ("confirm", "without", "only", "output")
    foreign = [f"--{name.replace('_', '-')}" for name in other if given[name]]
    if foreign:
        owner = next(name for name in ENGINES if name != engine)
        raise InputError(f"{', '.join(foreign)} goes with --engine {owner}; this is --engine {engine}")


def _runs(
    specs: Sequence[str], simulated: Sequence[str] | None, gyro: str | None, reading: Reading
) -> tuple[list[Recording], list[Recording] | None]:
    """Runs as the options of reading state, and simulated ones beside them, each by a name of its own."""
    from rlgcomp.diagnosis.question.held_out import told_apart

    mapping, drop, pulse_arcsec, calibration, period_s = reading
    runs = read_runs(specs, mapping, drop, pulse_arcsec, calibration, gyro=gyro, also=simulated or (), period_s=period_s)
    own = None
    if simulated:
        own = read_runs(simulated, mapping, drop, pulse_arcsec, simulated=True, also=specs, period_s=period_s)
    return told_apart(specs, runs), None if own is None or simulated is None else told_apart(simulated, own)


def _diagnose_on_one_model(
    train: Sequence[str],
    test: Sequence[str],
    confirm: Sequence[str],
    out: Path,
    *,
    simulator: str | None,
    simulated: Sequence[str] | None,
    candidates: Mapping[str, type[Mechanism]],
    without: Sequence[str],
    only: Sequence[str],
    gyro: str | None,
    output: str | None,
    averaging_s: float | None,
    noise: NoiseModel | None,
    chamber: tuple[float, float, float] | None,
    seed: int,
    reading: Reading,
    as_json: bool,
) -> None:
    """`diagnose` by the engine of one model; parameters are those of the command."""
    from rlgcomp.diagnosis.engine.diagnose import diagnose as diagnose_runs
    from rlgcomp.files import whole_folder
    from rlgcomp.physics import CATALOGUE

    mapping, drop, pulse_arcsec, calibration, period_s = reading
    chosen = _simulator(simulator, simulated, {**CATALOGUE, **candidates})
    specs = [*train, *confirm, *test]
    mapping = [*(mapping or []), *_mapped_output(output, specs)]
    runs, own = _runs(specs, simulated, gyro, (mapping, drop, pulse_arcsec, calibration, period_s))
    if output is not None:
        runs = [run if output in run else run.replace(table=run.table.assign(**{output: run.rate_deg_h()})) for run in runs]
    with progress("diagnosing", 100) as advance:
        diagnosis = diagnose_runs(
            chosen,
            runs[: len(train)],
            runs[len(train) + len(confirm) :],
            confirm=runs[len(train) : len(train) + len(confirm)],
            simulated=own,
            mechanisms=candidates,
            without=without,
            only=only,
            gyro=calibrated_name(gyro, calibration),
            output=output,
            window_s=averaging_s,
            noise=noise,
            chamber=chamber,
            seed=seed,
            progress=lambda fraction: advance(round(100 * fraction), 100),
        )
    files = [[interval_of(spec)[0] for spec in group] for group in (train, test, confirm)]
    diagnosis = diagnosis.of_files(files[0], files[1], _file_of(simulator), files[2])
    with whole_folder(out, writes=FILES) as folder:
        diagnosis.save(folder)
        diagnosis.report(folder / "report.html")
    if as_json:
        show_json(diagnosis.to_mapping())
        return
    typer.echo(str(diagnosis))
    notify(f"{out / 'report.html'}: written, with diagnosis.json and augmented.yaml beside it")


def _mapped_output(output: str | None, specs: Sequence[str]) -> list[str]:
    """The mapping that reads an output as a gyro where the files have none: a recording holds one."""
    from rlgcomp.recording import is_gyro
    from rlgcomp.recording.formats import column_names

    if output is None or any(is_gyro(name) for name in column_names(interval_of(specs[0])[0])):
        return []
    return [f"gyro_deg_h={output} [deg/h]"]


@contextlib.contextmanager
def background_process(modules: Sequence[str]) -> Iterator[Executor | None]:
    """A worker process that imports slow modules while this process computes; None where this process has but one core.

    The worker is killed at the end of the block, whatever it still computes, and ends with this process if that is killed.
    """
    from rlgcomp.numerics.compiled import threads

    if threads() < 2:
        yield None
        return
    import multiprocessing
    import signal
    from concurrent.futures import ProcessPoolExecutor

    others = multiprocessing.active_children()
    with ProcessPoolExecutor(1, multiprocessing.get_context("spawn"), _import_in_worker, (tuple(modules),)) as executor:
        handler = signal.signal(signal.SIGINT, signal.SIG_IGN)  # inherited: Ctrl-C reaches the worker through this process alone
        try:
            executor.submit(int)  # starts the worker
        finally:
            signal.signal(signal.SIGINT, handler)
        try:
            yield executor
        finally:
            for worker in multiprocessing.active_children():
                if worker not in others:
                    worker.kill()


def _import_in_worker(modules: Sequence[str]) -> None:
    import gc
    import importlib
    import multiprocessing
    import os
    import threading

    def end_with_parent() -> None:
        parent = multiprocessing.parent_process()
        if parent is not None:
            parent.join()
            os._exit(1)

    threading.Thread(target=end_with_parent, daemon=True).start()
    gc.disable()  # the worker lives too briefly to need it
    for module in modules:
        importlib.import_module(module)


def _file_of(simulator: str | None) -> Path | None:
    """The file of a simulator; None where its output stands for it."""
    path = None if simulator is None else Path(simulator)
    if path is None or path.is_file():
        return path
    return Path(str(path).rpartition(":")[0])


def measured_noise(path: Path, gyro: str | None) -> NoiseModel:
    """Noise from the coefficients of `rlgcomp allan`, or from a YAML file of strengths as under `noise:` in a simulator file.

    Raises
    ------
    InputError
        The file cannot be read, is neither, or has several gyros of which none was chosen.
    """
    from rlgcomp.errors import InputError
    from rlgcomp.files import from_yaml, read_text
    from rlgcomp.noise.processes import SLOW, NoiseModel, upper_limits

    limits, errors = (0.0, 0.0), (0.0, 0.0, 0.0)
    try:
        content = from_yaml(read_text(path))  # JSON is YAML
    except (OSError, ValueError) as error:
        raise InputError(f"--noise {path}: not readable: {error}") from None
    if isinstance(content, list):
        by_gyro = {str(one.get("gyro")): one.get("coefficients") for one in content if isinstance(one, dict)}
        chosen = by_gyro.get(next(iter(by_gyro)) if len(by_gyro) == 1 else str(gyro))
        if not isinstance(chosen, dict):
            raise InputError(f"--noise {path}: coefficients of {', '.join(by_gyro) or 'no gyro'}; choose one of them with --gyro")
        # a fit without flicker bounds it from above and does not exclude it
        limits = upper_limits(chosen)
        sds = [chosen.get(f"{name}_sd") or 0.0 for name in ("angle_random_walk_deg_sqrt_h", *SLOW)]
        errors = sds[0], sds[1], sds[2]
        content = {key: value for key, value in chosen.items() if key in NoiseModel().strengths() and value}
    if not isinstance(content, dict) or not content:
        raise InputError(f"--noise {path}: expected coefficients.json of rlgcomp allan, or 'angle_random_walk_deg_sqrt_h: 0.0003'")
    section = content.get("noise", content)
    try:
        strengths = dataclasses.replace(NoiseModel.from_mapping(section), at_most=limits, sds=errors)
    except (InputError, TypeError) as error:
        raise InputError(f"--noise {path}: {error}") from None
    if strengths.angle_random_walk_deg_sqrt_h == 0.0:
        raise InputError(f"--noise {path}: angle_random_walk_deg_sqrt_h is missing or zero; the other noises are judged beside it")
    return strengths


def _simulator(
    source: str | None, simulated: Sequence[str] | None, catalogue: Mapping[str, type[Mechanism]]
) -> Simulator | UserSimulator | None:
    """The simulator of a file; None where its output stands for it."""
    from rlgcomp.diagnosis.simulators.user_simulator import PythonSimulator
    from rlgcomp.errors import InputError
    from rlgcomp.simulation.simulator import Simulator

    if source is not None and simulated:
        raise InputError("--simulator and --simulated were given; give one of them: a simulator, or its output")
    if source is None:
        if not simulated:
            raise InputError("no simulator: give --simulator SIM.yaml or my_sim.py:function, or its output with --simulated RUN...")
        return None
    if ".py:" in source or source.endswith(".py"):
        return PythonSimulator.load(source if ".py:" in source else f"{source}:")
    return Simulator.from_yaml(source, catalogue)
