"""Commands on what a simulator is missing: diagnose."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
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
    mapped_output,
    progress,
    read_runs,
    require_folder,
)
from rlgcomp.cli.ending import notify
from rlgcomp.cli.show import show_json, show_text

if TYPE_CHECKING:
    from rlgcomp.diagnosis.simulators.user_simulator import UserSimulator
    from rlgcomp.noise.processes import NoiseModel
    from rlgcomp.physics.mechanism import Mechanism
    from rlgcomp.recording import Recording
    from rlgcomp.simulation.simulator import Simulator

RUNS = "RUN..."
Reading = tuple[list[str] | None, list[str] | None, float | None, Path | None, float | None]  # --map --drop --pulse-arcsec, …
FILES: Final = ("diagnosis.json", "augmented.yaml", "report.html", "figures/*.svg")  # what `diagnose` writes


@command("diagnose", several=("--train", "--test", "--confirm", "--simulated", "--mechanisms", "--without", "--only"))
def diagnose(
    train: Annotated[
        list[str],
        typer.Option(
            "--train",
            metavar=RUNS,
            help="Recordings from which missing physics is named and fitted. RUN@START:STOP is an interval in seconds.",
        ),
    ],
    out: Annotated[
        Path,
        typer.Option(
            "--out", "-o", metavar="DIR", help="Folder for diagnosis.json, augmented.yaml and report.html, replaced as a whole."
        ),
    ],
    test: Annotated[
        list[str] | None,
        typer.Option(
            "--test", metavar=RUNS, help="Recordings held out, best of other programmes: they decide nothing and prove the result."
        ),
    ] = None,
    simulator: Annotated[
        str | None,
        typer.Option(
            "--simulator",
            metavar="SIM",
            help="Simulator: a file SIM.yaml, or your own Python function my_sim.py:function, which maps a recording "
            "(run.column(NAME), run.table) to the predicted gyro in deg/h, a number a row.",
        ),
    ] = None,
    simulated: Annotated[
        list[str] | None,
        typer.Option(
            "--simulated",
            metavar=RUNS,
            help="Output of your own simulator: a file for each run, in the order --train, --confirm, --test. Clocks are "
            "aligned by a temperature, where both files have one; otherwise they must agree.",
        ),
    ] = None,
    mechanisms: MechanismFiles = None,
    only_own: OnlyOwn = False,
    gyro: Gyro = None,
    averaging_s: Annotated[
        float | None,
        typer.Option(
            "--averaging-s",
            metavar="S",
            help="Averaging time in s; unless given, a 400th of the longest run, or longer, so that all runs make up to 1000 "
            "windows.",
            show_default=False,
        ),
    ] = None,
    noise: Annotated[
        Path | None,
        typer.Option(
            metavar="NOISE",
            help="Noise of the gyro at rest: coefficients.json of `rlgcomp allan --out`, or a .yaml of strengths. Unless given, "
            "it is estimated from the runs.",
        ),
    ] = None,
    chamber: Annotated[
        tuple[float, float, float] | None,
        typer.Option(
            metavar="LOWEST HIGHEST FASTEST",
            help="Range of the chamber in degC and its fastest ramp in degC/min (-40 70 2), for the proposed next experiment; "
            "unless given, as recorded.",
            show_default=False,
        ),
    ] = None,
    confirm: Annotated[
        list[str] | None,
        typer.Option("--confirm", metavar=RUNS, help="Recordings that take part in the choice of mechanisms, and not in the fit."),
    ] = None,
    without: Annotated[
        list[str] | None, typer.Option("--without", metavar="NAME...", help="Mechanisms that are no candidates.")
    ] = None,
    only: Annotated[
        list[str] | None,
        typer.Option("--only", metavar="NAME...", help="The only mechanisms that are candidates; laws in recorded columns remain."),
    ] = None,
    output: Annotated[
        str | None,
        typer.Option(
            "--output", metavar="COLUMN", help="Quantity to explain, where it is no gyro: force_N. Parameters are then in its unit."
        ),
    ] = None,
    seed: Annotated[int, typer.Option(min=0, metavar="N", help="Seed of the draws of p-values and intervals.")] = 0,
    mapping: Map = None,
    drop: Drop = None,
    pulse_arcsec: PulseArcsec = None,
    period_s: PeriodS = None,
    calibration: CalibrationFile = None,
    as_json: AsJson = False,
) -> None:
    """What physics a simulator is missing, with probabilities and a proof on held-out runs.

    The free parameters of the simulator are calibrated first, so that wrong numbers are not taken for missing physics. Three runs
    of 11 h take 15 to 45 s of one core; several effects at once, or a hysteresis far above the noise, take up to some minutes.

    Example: `rlgcomp diagnose --simulator simulator.yaml --train cold.parquet hot.parquet --test new.parquet --out diagnosis`
    """
    from rlgcomp.diagnosis.diagnose import diagnose as diagnose_runs
    from rlgcomp.errors import InputError
    from rlgcomp.files import from_json, read_text, whole_folder
    from rlgcomp.physics import CATALOGUE

    require_folder(out, FILES, train, test, confirm, simulator, simulated, mechanisms, noise, calibration)
    if averaging_s is not None and not 0.0 < averaging_s < math.inf:
        raise InputError(f"--averaging-s is {averaging_s:g}; it must be positive and finite")
    candidates = candidates_of(mechanisms, only_own)
    chosen = _simulator(simulator, simulated, {**CATALOGUE, **candidates}, output)
    output = output or getattr(chosen, "output", None) or None
    measured = None if noise is None else measured_noise(noise, gyro)
    groups = [train, confirm or [], test or []]
    specs = [spec for group in groups for spec in group]
    mapping = [*(mapping or []), *mapped_output(output, specs[0])]
    runs, own = _runs(specs, simulated, gyro, (mapping, drop, pulse_arcsec, calibration, period_s))
    if output is None:
        compared(runs, calibrated_name(gyro, calibration))
    else:
        runs = [run if output in run else run.replace(table=run.table.assign(**{output: run.rate_deg_h()})) for run in runs]
    train_runs, confirm_runs, test_runs = _parts(runs, [len(group) for group in groups])
    with progress("diagnosing", 100) as advance:
        diagnosis = diagnose_runs(
            chosen,
            train_runs,
            test_runs,
            confirm=confirm_runs,
            simulated=own,
            mechanisms=candidates,
            without=without or (),
            only=only or (),
            gyro=calibrated_name(gyro, calibration),
            output=output,
            window_s=averaging_s,
            noise=measured,
            chamber=chamber,
            seed=seed,
            progress=lambda fraction: advance(round(100 * fraction), 100),
        )
    files = [[interval_of(spec)[0] for spec in group] for group in groups]
    diagnosis = diagnosis.of_files(files[0], files[2], _file_of(simulator), files[1])
    with whole_folder(out, writes=FILES) as folder:
        diagnosis.save(folder)
        diagnosis.report(folder / "report.html", figures=folder / "figures")
    if as_json:
        show_json(from_json(read_text(out / "diagnosis.json")))
        return
    show_text(str(diagnosis))
    notify(f"{out / 'report.html'}: written, with diagnosis.json and augmented.yaml beside it")


def _parts(runs: Sequence[Recording], lengths: Sequence[int]) -> list[Sequence[Recording]]:
    """Runs cut into groups of given lengths."""
    ends = [sum(lengths[: k + 1]) for k in range(len(lengths))]
    return [runs[end - length : end] for end, length in zip(ends, lengths, strict=True)]


def _runs(
    specs: Sequence[str], simulated: Sequence[str] | None, gyro: str | None, reading: Reading
) -> tuple[list[Recording], list[Recording] | None]:
    """Runs as the options of reading state, and simulated ones beside them, each by a name of its own."""
    mapping, drop, pulse_arcsec, calibration, period_s = reading
    runs = read_runs(specs, mapping, drop, pulse_arcsec, calibration, gyro=gyro, also=simulated or (), period_s=period_s)
    own = None
    if simulated:
        own = read_runs(simulated, mapping, drop, pulse_arcsec, simulated=True, also=specs, period_s=period_s)
    return runs, own


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
    source: str | None, simulated: Sequence[str] | None, catalogue: Mapping[str, type[Mechanism]], output: str | None
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
        own = PythonSimulator.load(source if ".py:" in source else f"{source}:")
        return own if output is None else dataclasses.replace(own, expected=f"in the unit of {output}")
    return Simulator.from_yaml(source, catalogue)
