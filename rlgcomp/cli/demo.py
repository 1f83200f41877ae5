"""The demo: the main job from end to end on simulated chamber runs."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final

import typer

from rlgcomp.cli.base import AsJson, Jobs, command, progress, require_folder
from rlgcomp.cli.ending import notify
from rlgcomp.cli.show import show_evaluation, show_json, show_table, show_text

if TYPE_CHECKING:
    from rlgcomp.diagnosis.report.result import Diagnosis

UNIT = 1
# Concealed, by chamber programmes: short runs show too little hysteresis to name it with certainty.
CONCEALED, CONCEALED_QUICK = "thermal_hysteresis", "readout_incoherence"
AVERAGING_S, AVERAGING_QUICK_S = 600.0, 120.0  # of the diagnosis: what is concealed is slow, and fewer windows take less time

OWN: Final = ("held-out.parquet", "train-1.parquet", "train-2.parquet", "simulator.yaml")  # what no other command writes


@command("demo")
def demo(
    out: Annotated[
        Path, typer.Option("--out", "-o", metavar="DIR", help="Folder for everything it makes, replaced as a whole.")
    ] = Path("rlgcomp-demo"),
    quick: Annotated[bool, typer.Option("--quick", help="Shorter chamber runs: half of the time.")] = False,
    jobs: Jobs = 2,
    as_json: AsJson = False,
) -> None:
    """The main job end to end on simulated chamber runs.

    Three runs of a gyro are simulated, a compensation is trained on two and evaluated on the third. Then one effect is taken out of
    the simulator, its other numbers are made wrong, and diagnosis finds what is missing. Takes about ten seconds.

    Example: `rlgcomp demo --out demo`
    """
    from rlgcomp.challenge.conceal import lacking
    from rlgcomp.cli.compensation import EVALUATION
    from rlgcomp.cli.diagnosis import FILES as DIAGNOSIS
    from rlgcomp.compensation import artefact
    from rlgcomp.compensation.compensator import Compensator
    from rlgcomp.diagnosis.diagnose import diagnose
    from rlgcomp.evaluation.evaluation import evaluate
    from rlgcomp.evaluation.page import write_report
    from rlgcomp.files import whole_folder
    from rlgcomp.recording.formats import write
    from rlgcomp.simulation.random_units import simulated_unit

    diagnosis_files = (f"diagnosis/{name}" for name in (*DIAGNOSIS, "simulator.yaml"))
    writes = (*OWN, *EVALUATION, *diagnosis_files, *(f"model/{name}" for name in artefact.FILES))
    require_folder(out, writes)
    unit = simulated_unit(UNIT)
    programmes = (
        {"train-1": "short", "train-2": "short", "held-out": "short"}
        if quick
        else {"train-1": "paper", "train-2": "minor-loops", "held-out": "reversed"}
    )
    notify(f"simulating {len(programmes)} chamber runs of {unit.unit}")
    runs = [unit.simulate(programme, seed=seed, name=name) for seed, (name, programme) in enumerate(programmes.items(), start=1)]
    notify("training the LS-SVM: hyperparameters by leave-one-run-out cross-validation")
    compensator = Compensator(n_jobs=jobs)
    with progress("selecting") as advance:
        compensator.fit(runs[:2], progress=advance)
    notify("evaluating on the run held out")
    evaluation = evaluate(compensator, runs[2:], compare=False, n_jobs=jobs)
    concealed = CONCEALED_QUICK if quick else CONCEALED
    notify(f"concealing {concealed} and diagnosing the simulator without it")
    simulator = lacking(unit, concealed, seed=UNIT)
    with progress("diagnosing", 100) as advance:
        diagnosis = diagnose(
            simulator,
            runs[:2],
            runs[2:],
            window_s=AVERAGING_QUICK_S if quick else AVERAGING_S,
            seed=UNIT,
            progress=lambda fraction: advance(round(100 * fraction), 100),
        )
    with whole_folder(out, writes=writes) as folder:
        for run in runs:
            write(run, folder / f"{run.name}.parquet")
        unit.to_yaml(folder / "simulator.yaml")
        compensator.save(folder / "model")
        write_report(
            folder,
            evaluation,
            compensator,
            title="Bias compensation of a simulated ring laser gyro",
            simulated=runs[2:],
            tested=[run.metadata for run in runs],
        )
        (folder / "diagnosis").mkdir()
        simulator.to_yaml(folder / "diagnosis" / "simulator.yaml")
        diagnosis.save(folder / "diagnosis")
        truth = {mechanism.name: mechanism for mechanism in unit.mechanisms if mechanism.name == concealed}
        diagnosis.report(folder / "diagnosis" / "report.html", truth=truth, figures=folder / "diagnosis" / "figures")
    if as_json:
        show_json(evaluation.to_mapping() | {"concealed": concealed, "diagnosis": diagnosis.to_mapping()})
        return
    show_evaluation(evaluation)
    show_text(f"\nConcealed from the simulator: {concealed}. {diagnosis.sentence}\n")
    show_table("Findings", _findings(diagnosis))
    notify(
        f"\n{out}/\n"
        "  report.html             look at it in a browser\n"
        "  model/                  the compensation, with its card\n"
        "  *.parquet               the chamber runs\n"
        "  simulator.yaml          the gyro they came from\n"
        f"  diagnosis/report.html   what the simulator lacked without {concealed}\n"
        "  diagnosis/              that simulator, diagnosis.json, and augmented.yaml: the simulator with the findings\n"
        f"rlgcomp evaluate {shlex.join([f'{out}/model', f'{out}/held-out.parquet'])} --out report  # the same run by other "
        "features and models"
    )


def _findings(diagnosis: Diagnosis) -> list[dict[str, str | float]]:
    """One row a parameter of each finding; its equation where it has none."""
    from rlgcomp.report.messages.wording import probability_text

    return [
        {
            "mechanism": cause.name,
            "probability": probability_text(cause.probability),
            "rms deg/h": cause.rms,
            "parameter": name,
            "value": value,
        }
        for cause in diagnosis.causes
        for name, value in ({name: one.text for name, one in cause.parameters.items()} or {"": cause.equation}).items()
    ]
