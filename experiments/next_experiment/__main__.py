r"""Whether the next experiment that a diagnosis proposes tells what it promises, on gyros and chambers of another implementation.

A laboratory knows one programme and runs it twice; one effect is concealed. Where the diagnosis is ambiguous, the run that it
proposes is made of the same gyro, and all three are diagnosed: what it promised, on average over the rivals, is to be what came
out, on average over the cases,

.. math:: E[P(\text{true rival} \mid \text{all runs})] = \text{expected\_probability\_after} .

Beside it stands what the old programme, run a third time, would have told.
"""

from __future__ import annotations

import argparse
import itertools
import math
from collections.abc import Collection, Sequence
from typing import Any, Final

import numpy as np

from experiments.concealed.bench import Laboratory, chamber_case
from experiments.concealed.logger import Scale
from experiments.concealed.plan import Plan
from experiments.tables import show_table
from experiments.work import Row, Work
from rlgcomp.simulation.simulator import Simulator

EFFECTS: Final = (
    "temperature_rate",
    "thermal_lag",
    "thermal_gradient",
    "rate_asymmetry",
    "thermal_hysteresis",
    "ageing",
    "warm_up",
    "light_intensity",
    "discharge_imbalance",
    "supply_voltage",
    "magnetic_field",
    "readout_incoherence",
)
PROGRAMMES: Final = {
    "rests": "start 20, hold 300",
    "heats": "start -10, hold 60, ramp 45 0.4, hold 120",
    "heats and cools": "start 20, hold 30, ramp 50 0.7, hold 60, ramp 20 0.7, hold 60",
}
NEEDS: Final = {"thermal_hysteresis": "heats and cools"}  # a programme, to show anything
STRENGTHS: Final = (0.2, 0.4)
TRAINING: Final = ("run0", "run1")
HELD_OUT: Final = ("run2", "run3")
STEP_S: Final = 10.0
SIZE_DEG_H: Final = 0.05
MONITORS: Final = frozenset({"light_intensity", "discharge_imbalance", "supply_voltage", "magnetic_field", "readout_incoherence"})


def proposed_and_run(effect: str, known: str, strength: float, seed: int) -> dict[str, Any]:
    """One gyro: what is said before, what is promised, and what comes out."""
    from rlgcomp.diagnosis.diagnose import diagnose

    def case_of(third: str | None = None) -> Any:
        programmes = dict.fromkeys((*TRAINING, *HELD_OUT), PROGRAMMES[known]) | ({} if third is None else {HELD_OUT[0]: third})
        plan = Plan("single", (effect,), (strength,), "", seed)
        return chamber_case(plan, laboratory=Laboratory(programmes, len(TRAINING), STEP_S), scale=Scale(STEP_S, SIZE_DEG_H))

    case = case_of()
    simulator = Simulator.from_mapping(case.simulator_mapping)
    before = diagnose(simulator, case.train)
    row = {"effect": effect, "known": known, "strength": strength, "verdict": before.verdict, "shares": _sets(before.to_mapping())}
    row["named"] = [cause.name for cause in before.causes]
    proposed = before.next_experiment
    if proposed is not None:
        new, old = case_of(proposed.profile).test
        row |= {"rivals": proposed.separates, "profile": proposed.profile, "promised": proposed.expected_probability_after}
        for key, run in (("after", new), ("repeated", old)):
            row[key] = _sets(diagnose(simulator, [*case.train, run]).to_mapping())
    return row


def _sets(found: dict[str, Any]) -> dict[str, float]:
    """Probability of each set of causes."""
    shares = {"+".join(one["mechanisms"]): float(one["probability"]) for one in found["alternatives"]}
    return shares | {"+".join(sorted(one["mechanism"] for one in found["findings"])): float(found["probability"] or 0.0)}


def of_truth(shares: dict[str, float], truth: str, rivals: Collection[str]) -> float:
    """Probability of the truth, if it is that or one of its rivals."""
    total = sum(shares.get(name, 0.0) for name in {truth, *rivals})
    return shares.get(truth, 0.0) / total if total > 0.0 else 0.0


def main(argv: Sequence[str] | None = None) -> None:
    """Command line of the experiment."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=4, help="gyros for each effect, programme and strength (default 4)")
    Work.add_options(parser, "next_experiment")
    options = parser.parse_args(argv)
    gyros = [
        (effect, known, strength, seed)
        for seed in range(options.seeds)
        for strength in STRENGTHS
        for known in PROGRAMMES
        for effect in EFFECTS
        if NEEDS.get(effect, known) == known
    ]
    pieces = [(*gyro, 910_000 + k) for k, (*gyro, _) in enumerate(gyros)]
    found: list[Row] = Work.of(options).results("next", proposed_and_run, pieces)
    print("# What the next experiment promises: `python -m experiments.next_experiment`\n")
    verdicts = {
        verdict: [row for row in found if row["verdict"] == verdict] for verdict in ("none", "explained", "ambiguous", "unknown")
    }
    show_table(
        f"{len(found)} gyros",
        [
            {
                "verdict": verdict,
                "gyros": len(rows),
                "the effect alone is named": sum(row["named"] == [row["effect"]] for row in rows),
                "an experiment is proposed": sum("promised" in row for row in rows),
            }
            for verdict, rows in verdicts.items()
        ],
    )
    run = [row for row in found if "promised" in row and row["effect"] in row["rivals"]]
    with_monitors = [row for row in run if MONITORS & set(row["rivals"])]
    groups = {"all": run, "rivals that monitors drive": with_monitors, "others": [row for row in run if row not in with_monitors]}
    edges = (0.0, 0.6, 0.8, 0.95, 1.0)
    for low, high in itertools.pairwise(edges):
        groups[f"promised {low:g} to {high:g}"] = [row for row in run if low < row["promised"] <= high]
    show_table("Probability of the truth among its rivals", [_line(name, rows) for name, rows in groups.items() if rows])


def _line(name: str, rows: Sequence[Row]) -> dict[str, object]:
    def mean(key: str) -> tuple[float, np.ndarray]:
        values = np.array([of_truth(row[key], row["effect"], row["rivals"]) for row in rows])
        return float(values.mean()), values

    promised = np.array([row["promised"] for row in rows])
    after, each = mean("after")
    error = float(np.std(each - promised, ddof=1)) / math.sqrt(len(rows)) if len(rows) > 1 else math.nan
    return {
        "": name,
        "gyros": len(rows),
        "before": f"{mean('shares')[0]:.2f}",
        "promised": f"{promised.mean():.2f}",
        "after the run proposed": f"{after:.2f} ± {error:.2f}",
        "after the old programme again": f"{mean('repeated')[0]:.2f}",
    }


if __name__ == "__main__":
    main()
