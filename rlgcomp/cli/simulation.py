"""Commands on simulators: simulate, predict."""

from __future__ import annotations

import logging
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from rlgcomp.cli.base import (
    AsJson,
    Drop,
    Map,
    MechanismFiles,
    Overwrite,
    PeriodS,
    PulseArcsec,
    command,
    mapped_output,
    read_runs,
    require_recording,
)
from rlgcomp.cli.ending import notify
from rlgcomp.cli.show import show_json

if TYPE_CHECKING:
    from rlgcomp.recording import Recording
    from rlgcomp.report.messages import Message
    from rlgcomp.simulation.simulator import Simulator

logger = logging.getLogger(__name__)
SimulatorFile = Annotated[Path, typer.Argument(metavar="SIM.yaml", help="Simulator file.")]
Out = Annotated[Path, typer.Option("--out", "-o", metavar="RUN", help="Recording to write: .parquet, .csv, .csv.gz, .h5 or .mat.")]


@command("simulate", several=("--mechanisms",))
def simulate(
    simulator: SimulatorFile,
    out: Out,
    profile: Annotated[
        str | None,
        typer.Option(
            metavar="NAME|TEXT|FILE",
            help="Chamber programme: paper, reversed, minor-loops, slow, short, a .yaml, or steps: 'start 20, hold 60, ramp -40 "
            "1' is "
            "20 degC, 60 min there, then to -40 degC at 1 degC/min. Turntable programme: rates, other-rates, sweeps, slow-turns, "
            "to-and-fro, short-turns, a .yaml, or steps: 'rate 10 600, rest 120, sweep -1 1 1800' is 10 deg/s for 600 s, rest for "
            "120 s, from -1 to 1 deg/s in 1800 s. Unless given, paper or rates.",
        ),
    ] = None,
    seed: Annotated[int, typer.Option(min=0, metavar="N", help="Seed of all random streams.")] = 0,
    step_s: Annotated[float, typer.Option(metavar="S", help="Sample period in s.")] = 1.0,
    mechanisms: MechanismFiles = None,
    overwrite: Overwrite = False,
    as_json: AsJson = False,
) -> None:
    """Make a recording of a simulator file.

    Contributions of the mechanisms are stored as columns truth_...

    Example: `rlgcomp simulate gyro.yaml --profile 'start 20, hold 60, ramp -40 1, hold 120' --seed 1 --out cold.parquet`

    On a table: `rlgcomp simulate table.yaml --profile 'rate 10 600, rate -10 600, rest 120, sweep -1 1 1800' --out table.parquet`
    """
    from rlgcomp.physics.user import user_catalogue
    from rlgcomp.recording.formats import write
    from rlgcomp.simulation.simulator import Simulator

    require_recording(out, simulator, mechanisms, overwrite=overwrite)
    made = Simulator.from_yaml(simulator, user_catalogue(mechanisms or []))
    recording = made.simulate(profile, seed=seed, step_s=step_s, name=out.stem)
    write(recording, out, overwrite=overwrite)
    remarks = _extrapolations(made, recording)
    truth = recording.truth
    if as_json:
        spread = {} if truth is None else truth.std().to_dict()
        show_json(
            {
                "out": out,
                "rows": len(recording),
                "hours": recording.duration_s / 3600.0,
                "truth_std_deg_h": spread,
                "remarks": [remark.to_mapping() for remark in remarks],
            }
        )
    else:
        notify(f"{out}: {len(recording)} rows, {recording.duration_s / 3600.0:.2f} h")


@command("predict", several=("--mechanisms",))
def predict(
    simulator: SimulatorFile,
    run: Annotated[
        str,
        typer.Argument(
            metavar="RUN", help="Recording whose monitors drive the simulator. RUN@START:STOP is an interval in seconds."
        ),
    ],
    out: Out,
    mechanisms: MechanismFiles = None,
    mapping: Map = None,
    drop: Drop = None,
    pulse_arcsec: PulseArcsec = None,
    period_s: PeriodS = None,
    overwrite: Overwrite = False,
    as_json: AsJson = False,
) -> None:
    """The gyro, or other output, that a simulator predicts from the monitors of a recording.

    The prediction has the rows of the recording and no noise. Effects that no two runs repeat (random jumps) are left out.

    Example: `rlgcomp predict gyro.yaml run.parquet --out predicted.parquet`
    """
    from rlgcomp.physics.user import user_catalogue
    from rlgcomp.recording.formats import write
    from rlgcomp.recording.outliers import without_monitor_outliers
    from rlgcomp.simulation.simulator import Simulator

    require_recording(out, simulator, mechanisms, run, overwrite=overwrite)
    made = Simulator.from_yaml(simulator, user_catalogue(mechanisms or []))
    as_gyro = mapped_output(made.output, run, "that the simulator predicts")
    (recording,) = read_runs([run], [*(mapping or []), *as_gyro], drop, pulse_arcsec, period_s=period_s)
    recording, remarks = without_monitor_outliers(recording, made.driver_columns(recording))
    predicted = made.predict(recording)
    write(predicted, out, overwrite=overwrite, left_out=predicted.gyro_columns if as_gyro else ())
    for remark in remarks:
        logger.warning("%s", remark)
    extrapolations = _extrapolations(made, recording)
    column = made.output or predicted.gyro_columns[0]
    if as_json:
        rate, unit = (predicted.column(column), "") if made.output else (predicted.rate_deg_h(), "_deg_h")
        show_json(
            {
                "out": out,
                "rows": len(predicted),
                "output" if made.output else "gyro": column,
                "columns": [name for name in predicted.columns if not as_gyro or name not in predicted.gyro_columns],
                "mechanisms": [mechanism.name for mechanism in made.mechanisms if mechanism.repeats()],
                "left_out": [mechanism.name for mechanism in made.mechanisms if not mechanism.repeats()],
                f"mean{unit}": float(rate.mean()),
                f"std{unit}": float(rate.std()),
                "remarks": [remark.to_mapping() for remark in (*remarks, *extrapolations)],
            }
        )
    else:
        notify(f"{out}: {len(predicted)} rows, column {column}")


def _extrapolations(simulator: Simulator, recording: Recording) -> list[Message]:
    """Remarks, logged as warnings, where the recording leaves the range in which an empirical law was found."""
    remarks = [remark for mechanism in simulator.mechanisms for remark in mechanism.extrapolation(recording)]
    for remark in remarks:
        logger.warning("%s", remark)
    return remarks
