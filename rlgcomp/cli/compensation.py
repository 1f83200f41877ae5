"""Commands on compensations: train, evaluate, compensate."""

from __future__ import annotations

import dataclasses
import glob
import os
import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

import typer

from rlgcomp.cli.base import (
    AsJson,
    CalibrationFile,
    Drop,
    Gyro,
    Jobs,
    Map,
    Offset,
    Overwrite,
    PeriodS,
    PulseArcsec,
    Runs,
    calibrated_name,
    command,
    compared,
    interval_of,
    offset_seconds,
    place_with,
    progress,
    read_runs,
    require_folder,
    require_recording,
)
from rlgcomp.cli.ending import notify
from rlgcomp.cli.physics import AUTO, MODEL_OF_PHYSICS, physics_of, require_physics
from rlgcomp.cli.show import show_evaluation, show_json, show_table

if TYPE_CHECKING:
    from rlgcomp.compensation.compensator import Compensator
    from rlgcomp.export.target import Exported
    from rlgcomp.recording import Recording
    from rlgcomp.report.messages import Message

MANY_ROWS: Final = 5000  # that a processor fits in minutes, not seconds
EVALUATION: Final = ("evaluation.json", "report.html", "figures/*.svg")  # what `evaluate` writes
Model = Annotated[Path, typer.Argument(metavar="MODEL", help="Model folder, as `train` writes it.")]


@command("train")
def train(
    runs: Runs,
    out: Annotated[Path, typer.Option("--out", "-o", metavar="MODEL", help="Model folder to write; an earlier run's is replaced.")],
    model: Annotated[
        str | None,
        typer.Option(
            metavar="NAME",
            help="lssvm-dynamic (every input linearly, and a kernel of those that are no rate, lag or memory of temperature; the "
            "default), lssvm (a kernel of all inputs; the default with --physics or --device), "
            "fixed-size (for many rows), cubic, dynamic, kernels, kernel-ridge, svr, gaussian-process or sequence.",
        ),
    ] = None,
    features: Annotated[
        str,
        typer.Option(
            metavar="NAME,NAME,...",
            help="all (each further monitor is used if it reduces the error of runs left out), or some of temperature, "
            "gradient, temperature_rate, "
            "lag, memory, light_intensity, readout_difference, and names of further columns.",
        ),
    ] = "all",
    averaging_s: Annotated[
        float, typer.Option(metavar="S", help="Averaging time in s: the model is trained on means over it.")
    ] = 100.0,
    keep_mean: Annotated[
        bool,
        typer.Option("--keep-mean", help="Keep the mean of the training runs, for example the Earth rate, in the corrected gyro."),
    ] = False,
    turn_on_deg_h: Annotated[
        float | None,
        typer.Option(
            metavar="DEG_H",
            min=0.0,
            help="Repeatability of the bias from switch-on to switch-on in deg/h, one standard deviation, as of a data sheet: "
            "for the interval of a model of few runs, which hardly show it. With one run, the standard deviation of its bias is "
            "assumed unless it is stated.",
        ),
    ] = None,
    adapt: Annotated[
        Path | None,
        typer.Option(
            "--adapt",
            metavar="MODEL",
            help="Cubic or dynamic model of several units, which is adapted to these runs of one more unit.",
        ),
    ] = None,
    physics: Annotated[
        str | None,
        typer.Option(
            "--physics",
            metavar="SIM.yaml|auto",
            help="Of lssvm: the mean is this simulator, as `diagnose` writes augmented.yaml, its amplitudes fitted with the model; "
            "auto diagnoses the runs first.",
        ),
    ] = None,
    simulator: Annotated[
        Path | None,
        typer.Option(
            "--simulator",
            metavar="SIM.yaml",
            help="Of --physics auto: what is known before; else a cubic in temperature and its rate.",
        ),
    ] = None,
    export: Annotated[
        Path | None,
        typer.Option(
            "--export",
            metavar="DIR",
            help="Also write C code and its report; it is compiled and compared with Python at every sample of the runs.",
        ),
    ] = None,
    gyro: Gyro = None,
    mapping: Map = None,
    drop: Drop = None,
    pulse_arcsec: PulseArcsec = None,
    period_s: PeriodS = None,
    calibration: CalibrationFile = None,
    device: Annotated[
        str | None,
        typer.Option(
            metavar="NAME", help="Of lssvm: compute by torch on auto, cpu, cuda or cuda:0, for tens of thousands of averaged rows."
        ),
    ] = None,
    jobs: Jobs = 1,
    as_json: AsJson = False,
) -> None:
    """Train a bias compensation; hyperparameters by leave-one-run-out cross-validation.

    Two runs of 11 h take seconds. The same command resumes a search that was interrupted. With --adapt, model, features and
    averaging are those of the adapted model.

    Example: `rlgcomp train cold.parquet hot.parquet --model lssvm-dynamic --features all --out models/unit-17`

    Example: `rlgcomp train cold.parquet hot.parquet --physics diagnosis/augmented.yaml --out models/unit-17`

    Example: `rlgcomp train two-hours.parquet --adapt models/fleet --out models/unit-18`

    Example: `rlgcomp train cold.parquet hot.parquet --out models/unit-17 --export unit-17-c`

    Example: `rlgcomp train cold.parquet hot.parquet --averaging-s 1 --device cuda --out models/unit-17`
    """
    from rlgcomp.compensation.artefact import identity
    from rlgcomp.compensation.compensator import Compensator, load
    from rlgcomp.compensation.models import DEFAULT, MODELS
    from rlgcomp.compensation.models.specification import sequential
    from rlgcomp.errors import InputError
    from rlgcomp.recording.provenance import with_digests

    _require_folders(out, export, runs, adapt, calibration, simulator, None if physics in (None, AUTO) else Path(physics))
    _require_options(adapt, model, features, averaging_s)
    if model is None:
        model = DEFAULT if physics is None and device is None else MODEL_OF_PHYSICS
    if model not in MODELS:
        raise InputError(f"--model {model!r} is unknown; known are {', '.join(MODELS)}")
    require_physics(physics, simulator, model=model, device=device, adapted=adapt is not None)
    if export is not None and sequential(MODELS[model].make()):
        raise InputError(f"--export: a {model} model has no sample-by-sample form; train another model to export one")
    estimator = _estimator(model, device, adapted=adapt is not None)
    fleet = None if adapt is None else load(adapt)
    recordings = read_runs(
        runs, mapping, drop, pulse_arcsec, calibration, gyro=gyro if fleet is None else fleet.gyro, period_s=period_s
    )
    differences = compared(recordings, calibrated_name(gyro, calibration) if fleet is None else fleet.gyro)
    _warn_of_long_fit(device, recordings, averaging_s)
    journal = out.absolute().with_name(f".{out.name}.selection.jsonl")
    if fleet is not None:
        from rlgcomp.compensation.adaptation import adapt as adapt_to

        _require_the_same_calibration(fleet, recordings)
        compensator = adapt_to(fleet, recordings)
        model = fleet.specification_.name if fleet.specification_ is not None else model
    else:
        chosen = calibrated_name(gyro, calibration)
        compensator = Compensator(
            estimator,
            features=features,
            averaging_s=averaging_s,
            gyro=chosen,
            keep_mean=keep_mean,
            n_jobs=jobs,
            physics=physics_of(physics, simulator, recordings, chosen),
            turn_on_deg_h=turn_on_deg_h,
        )
        with progress("selecting") as advance:
            compensator.fit(recordings, journal=journal if journal.parent.is_dir() else None, progress=advance)
    compensator.provenance_ = with_digests(compensator.provenance_, [interval_of(spec)[0] for spec in runs])
    exported = _saved(compensator, out, export, recordings)
    journal.unlink(missing_ok=True)
    rmse = compensator.selection_.rmse
    summary = {
        "model": str(out),
        "sha256": identity(out),
        "kind": model,
        "inputs": list(compensator.pipeline_.names),
        "selected": compensator.selection_.best,
        "left_out_rms_deg_h": None if rmse is None else rmse * compensator.scaling_.y_scale_deg_h,
        "before_rms_deg_h": compensator.scaling_.y_scale_deg_h,
        "half_width_deg_h": compensator.interval_.inside_deg_h,
        "unused": compensator.unused_,
        **({} if physics is None else {"parts": compensator.parts().to_dict("records")}),
        "remarks": [remark.to_mapping() for remark in (*differences, *compensator.remarks_)],
    } | ({} if exported is None else {"export": exported.to_mapping()})
    if as_json:
        show_json(summary)
    else:
        known = compensator.interval_.basis != "unknown"
        show_table(
            f"{model} on {len(compensator.pipeline_.names)} inputs",
            [
                {"": "before, deg/h", " ": f"{summary['before_rms_deg_h']:.3g}"},
                {
                    "": f"with {'runs' if adapt is None else 'units'} left out, rms, deg/h",
                    " ": "–" if rmse is None else f"{summary['left_out_rms_deg_h']:.3g}",
                },
                {"": "90 % interval, ± deg/h", " ": f"{summary['half_width_deg_h']:.3g}" if known else "not known from these runs"},
                *([{"": "not used, no gain shown", " ": ", ".join(compensator.unused_)}] if compensator.unused_ else []),
                {"": "selected", " ": compensator.selection_.text},
            ],
        )
        if physics is not None:
            shown = [
                {
                    "part": part["part"],
                    "rms, deg/h": part["rms_deg_h"],
                    "share of the bias's variance": f"{100 * part['share']:.1f} %",
                }
                for part in compensator.parts().to_dict("records")
            ]
            show_table("What each part does in training", shown)
        for title, rows in () if exported is None else exported.tables:
            show_table(title, rows)
        notify(f"{out}: written; `rlgcomp evaluate {shlex.quote(str(out))} RUN... --out REPORT` tests it on runs it has not seen")


def _saved(compensator: Compensator, out: Path, export: Path | None, recordings: list[Recording]) -> Exported | None:
    """Write the model and its code; where the code lies in the model's folder or beside it, both take their places together."""
    if export is None:
        compensator.save(out)
        return None
    from rlgcomp.export.target import Options, written
    from rlgcomp.export.target import export as export_model
    from rlgcomp.files import whole_folder

    options = Options(runs=recordings)
    with whole_folder(out, writes=_written(out, export)) as folder:
        compensator.save(folder)
        if (together := place_with(folder, out, _real(export))) is not None:
            exported = export_model(folder, together, "c", options)
            if not _lies_in(export, out):
                require_folder(export, written(out, "c"))  # the work may have taken hours
            return exported
    return export_model(out, export, "c", options)


def _written(out: Path, export: Path | None) -> list[str]:
    """Names of the files in a model's folder, with its code where that lies in it."""
    from rlgcomp.compensation.artefact import FILES
    from rlgcomp.export.target import written

    if export is None or not _lies_in(export, out):
        return list(FILES)
    inside = glob.escape(_real(export).relative_to(_real(out)).as_posix())
    return [*FILES, *(f"{inside}/{name}" for name in written(out, "c"))]


def _require_folders(out: Path, export: Path | None, *read: Path | list[str] | None) -> None:
    """Refuse places that `train` could not write; the code may lie in the model's folder, and is replaced with it."""
    from rlgcomp.errors import InputError
    from rlgcomp.export.target import written

    if export is not None:
        require_folder(export, written(out, "c"), *read)
        if _lies_in(out, export) or _real(out) == _real(export):
            raise InputError(f"--out {out} lies in --export {export}, which the code would fill; give two folders")
    require_folder(out, _written(out, export), *read)


def _require_options(adapt: Path | None, model: str | None, features: str, averaging_s: float) -> None:
    """Refuse an averaging time that is none, and what an adapted model has already."""
    from rlgcomp.compensation.window_means import require_averaging
    from rlgcomp.errors import InputError
    from rlgcomp.recording import DEFAULT_AVERAGING_S

    require_averaging(averaging_s)
    if adapt is not None and (model is not None or features != "all" or averaging_s != DEFAULT_AVERAGING_S):
        raise InputError("--adapt takes model, features and averaging time from the adapted model; leave out those that you give")


def _warn_of_long_fit(device: str | None, recordings: list[Recording], averaging_s: float) -> None:
    """Warn where `--device` finds no graphics card and many rows are fitted on the processor."""
    rows = sum(round(recording.duration_s / averaging_s) for recording in recordings)
    if device is None or rows <= MANY_ROWS:
        return
    from rlgcomp.compensation.models.kkt_system import device_named
    from rlgcomp.report.messages import message

    if device_named(device).type == "cpu":
        notify(f"WARNING: {message('compensation.on_the_processor', rows=rows)}")


def _lies_in(folder: Path, other: Path) -> bool:
    return _real(other) in _real(folder).parents


def _real(folder: Path) -> Path:
    return Path(os.path.realpath(folder))


def _estimator(model: str, device: str | None, *, adapted: bool) -> Any:
    """An unfitted estimator of this kind, to be computed on this device."""
    from rlgcomp.compensation.models import MODELS
    from rlgcomp.compensation.models.kkt_system import device_named
    from rlgcomp.errors import InputError

    estimator = MODELS[model].make()
    if device is not None:
        other = "--adapt" if adapted else model
        if adapted or "device" not in estimator.get_params():
            raise InputError(f"--device is for --model lssvm alone, not for {other}; leave it out")
        estimator.set_params(device=device).check_parameters()
        device_named(device)
    return estimator


@command("evaluate")
def evaluate(
    model: Model,
    runs: Runs,
    out: Annotated[
        Path, typer.Option("--out", "-o", metavar="DIR", help="Folder for report.html and evaluation.json, replaced as a whole.")
    ],
    no_comparison: Annotated[
        bool, typer.Option("--no-comparison", help="Leave out the tables of features and models, which take most of the time.")
    ] = False,
    offset: Offset = None,
    mapping: Map = None,
    drop: Drop = None,
    pulse_arcsec: PulseArcsec = None,
    period_s: PeriodS = None,
    calibration: CalibrationFile = None,
    jobs: Jobs = 1,
    as_json: AsJson = False,
) -> None:
    """Bias stability before and after compensation on runs held out.

    Example: `rlgcomp evaluate models/unit-17 new.parquet --out report`

    Example: `rlgcomp evaluate models/unit-17 new.parquet --offset zero-at-start 600 --out report`
    """
    from rlgcomp.compensation.compensator import load
    from rlgcomp.evaluation.evaluation import evaluate as evaluate_runs
    from rlgcomp.evaluation.page import write_report
    from rlgcomp.files import from_json, read_text, whole_folder

    offset_s = offset_seconds(offset)
    require_folder(out, EVALUATION, model, runs, calibration)
    compensator = load(model)
    recordings = read_runs(runs, mapping, drop, pulse_arcsec, calibration, gyro=compensator.gyro, period_s=period_s)
    _require_the_same_calibration(compensator, recordings)
    differences = compared(recordings, compensator.gyro)
    evaluation = evaluate_runs(compensator, recordings, compare=not no_comparison, n_jobs=jobs, offset_s=offset_s)
    inputs = [model, *(interval_of(spec)[0] for spec in runs), *filter(None, [calibration])]
    evaluation = dataclasses.replace(evaluation, input_remarks=(*differences, *evaluation.input_remarks))
    with whole_folder(out, writes=EVALUATION) as folder:
        write_report(
            folder,
            evaluation,
            compensator,
            title=f"Bias compensation: {model.name}",
            simulated=recordings[:1],
            inputs=inputs,
            tested=[run.metadata for run in recordings],
        )
    if as_json:
        show_json(from_json(read_text(out / EVALUATION[0])))
        return
    show_evaluation(evaluation)
    notify(f"{out / 'report.html'}: written")


@command("compensate")
def compensate(
    model: Model,
    run: Annotated[str, typer.Argument(metavar="RUN", help="Recording; with --follow a CSV file, or - for standard input.")],
    out: Annotated[Path, typer.Option("--out", "-o", metavar="RUN", help="Corrected recording; with --follow also -.")],
    follow: Annotated[
        bool, typer.Option("--follow", help="Continue while the file grows; each line is written once it is complete.")
    ] = False,
    idle_s: Annotated[
        float | None, typer.Option("--idle-s", min=0.0, metavar="S", help="With --follow: end after S seconds without growth.")
    ] = None,
    offset: Offset = None,
    mapping: Map = None,
    drop: Drop = None,
    pulse_arcsec: PulseArcsec = None,
    period_s: PeriodS = None,
    calibration: CalibrationFile = None,
    overwrite: Overwrite = False,
    as_json: AsJson = False,
) -> None:
    """A corrected recording: the gyro without its estimated bias, and the half width of a 90 % interval.

    Single outliers of a monitor are interpolated, outliers of the gyro stay; both are reported. With --follow, which does not know
    later samples, outliers of monitors are used as they are.

    Ctrl-C ends --follow; the same command resumes.

    Example: `rlgcomp compensate models/unit-17 new.parquet --out corrected.parquet`

    Example: `rlgcomp compensate models/unit-17 growing.csv --follow --out corrected.csv`
    """
    from rlgcomp.compensation.compensator import load
    from rlgcomp.compensation.start_offset import on_start
    from rlgcomp.recording.formats import write

    offset_s = offset_seconds(offset)
    if follow:
        from rlgcomp.calibration.file import Calibration
        from rlgcomp.compensation.streaming import compensate_stream

        summary = compensate_stream(
            load(model),
            run,
            out,
            mapping=mapping or [],
            drop=drop or [],
            pulse_arcsec=pulse_arcsec,
            period_s=period_s,
            calibration=None if calibration is None else Calibration.read(calibration),
            idle_s=idle_s,
            offset_s=offset_s,
            notify=lambda remark: notify(remark.text),
        )
        if as_json and str(out) != "-":
            show_json(summary.to_mapping())
        notify(summary.message.text)
        raise typer.Exit(summary.exit_code)
    require_recording(out, run, calibration, overwrite=overwrite)
    compensator = load(model)
    (recording,) = read_runs([run], mapping, drop, pulse_arcsec, calibration, gyro=compensator.gyro, period_s=period_s)
    _require_the_same_calibration(compensator, [recording])
    recording, remarks = _repaired_monitors(compensator, recording)
    remarks += on_start(recording, compensator.gyro, offset_s, keep_mean=compensator.keep_mean, averaging_s=compensator.averaging_s)
    remarks += compensator.untold_.remarks(recording)
    for remark in remarks:
        notify(remark.text)
    corrected = compensator.correct(recording, offset_s=offset_s)
    write(corrected, out, overwrite=overwrite)
    outside = float(corrected.column("compensation_out_of_range").mean())
    if as_json:
        show_json(
            {"out": out, "rows": len(corrected), "out_of_range": outside, "remarks": [remark.to_mapping() for remark in remarks]}
        )
    else:
        notify(f"{out}: {len(corrected)} rows, {100 * outside:.1f} % with an input outside the training range")


def _repaired_monitors(compensator: Compensator, recording: Recording) -> tuple[Recording, list[Message]]:
    """The run with single outliers of its monitors interpolated, and remarks on it."""
    from rlgcomp.compensation.correction import other_unit
    from rlgcomp.recording.outliers import gyro_outliers, without_monitor_outliers

    repaired, interpolated = without_monitor_outliers(recording, compensator.pipeline_.columns)
    outliers = gyro_outliers(recording, compensator.gyro)
    remarks = [*interpolated, *([outliers.message("as_recorded", recording.name)] if outliers else [])]
    return repaired, remarks + other_unit(compensator.provenance_, recording.name, recording.metadata.unit)


def _require_the_same_calibration(compensator: Compensator, recordings: list[Recording]) -> None:
    """Refuse runs calibrated otherwise than those that the model was trained on."""
    from rlgcomp.compensation.correction import calibration_mismatch
    from rlgcomp.errors import InputError

    for recording in recordings:
        used = recording.metadata.notes.get("calibration")
        if (problem := calibration_mismatch(compensator.provenance_, used)) is not None:
            raise InputError(f"{recording.name}: {problem}")
