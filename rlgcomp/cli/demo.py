"""The demo: the main job from end to end on simulated chamber runs."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from rlgcomp.cli.base import AsJson, Jobs, command, progress, say
from rlgcomp.cli.show import show_evaluation, show_json

UNIT = 1


@command("demo")
def demo(
    out: Annotated[Path, typer.Option("--out", "-o", metavar="DIR", help="Folder for everything it makes.")] = Path("rlgcomp-demo"),
    quick: Annotated[bool, typer.Option("--quick", help="Shorter chamber runs.")] = False,
    jobs: Jobs = 2,
    as_json: AsJson = False,
) -> None:
    """The main job end to end: simulate a gyro's chamber runs, train, evaluate on a run held out, write model and report.

    Example: `rlgcomp demo --out demo`
    """
    from rlgcomp.compensation.compensator import Compensator
    from rlgcomp.evaluation import evaluate
    from rlgcomp.files import require_writable, whole_folder
    from rlgcomp.formats import write
    from rlgcomp.report.page import write_report
    from rlgcomp.simulation.fleet import simulated_unit

    require_writable(out)
    unit = simulated_unit(UNIT)
    programmes = (
        {"train-1": "short", "train-2": "short", "held-out": "short"}
        if quick
        else {"train-1": "paper", "train-2": "minor-loops", "held-out": "reversed"}
    )
    say(f"simulating {len(programmes)} chamber runs of {unit.unit}")
    runs = [unit.simulate(programme, seed=seed, name=name) for seed, (name, programme) in enumerate(programmes.items(), start=1)]
    say("training the LS-SVM, parameters selected by leaving runs out")
    compensator = Compensator(n_jobs=jobs)
    with progress("selecting") as advance:
        compensator.fit(runs[:2], progress=advance)
    say("evaluating on the run held out")
    evaluation = evaluate(compensator, runs[2:], n_jobs=jobs)
    with whole_folder(out, ours="report.html") as folder:
        for run in runs:
            write(run, folder / f"{run.name}.parquet")
        unit.to_yaml(folder / "simulator.yaml")
        compensator.save(folder / "model")
        write_report(folder, evaluation, compensator, title="Bias compensation of a simulated ring laser gyro", simulated=runs[2:])
    if as_json:
        show_json(evaluation.to_mapping())
        return
    show_evaluation(evaluation)
    say(
        f"\n{out}/\n"
        "  report.html       look at it in a browser\n"
        "  model/            the compensation, with its card\n"
        "  *.parquet         the chamber runs\n"
        "  simulator.yaml    the gyro they came from"
    )
