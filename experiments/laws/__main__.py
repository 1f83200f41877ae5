"""Find laws outside the catalogue by four methods, score drivers, memory and held-out error, and count false discoveries."""

from __future__ import annotations

import argparse
import dataclasses
import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

import rlgcomp as rlg
from experiments.concealed.case import Case
from experiments.concealed.cases import make_case
from experiments.concealed.plan import Plan, plan
from experiments.laws.stlsq import drivers_of, library, stlsq
from experiments.tables import show_table
from experiments.work import Work
from rlgcomp.diagnosis.laws.dictionary import MEMORY_CLASS, Dictionary, recorded_drivers
from rlgcomp.diagnosis.laws.discover import discover
from rlgcomp.diagnosis.noise.noises import ordinary_noise, unrecorded_cause
from rlgcomp.diagnosis.noise.whitening import NoiseShape
from rlgcomp.diagnosis.question.problem import Problem
from rlgcomp.diagnosis.question.windows import Windows

Array = npt.NDArray[np.float64]
METHODS = ("laws", "laws, white noise alone", "laws, static alone", "STLSQ")
WANDERING = 0.05  # before the data are seen: that something unrecorded wanders


@dataclasses.dataclass(frozen=True)
class Score:
    """One method on one case: what it found, and its held-out error over the oracle's."""

    effect: str
    method: str
    found: bool
    drivers: bool
    memory: bool
    ratio: float


def judge(planned: Plan) -> list[dict[str, Any]]:
    """All methods on one case."""
    case = make_case(planned)
    problem = Problem.of(rlg.Simulator.from_mapping(case.simulator_mapping), list(case.train))
    held_out = [Windows.of(run, problem.rows.window_s) for run in case.test]
    truth, oracle = (
        np.concatenate([part.means(values) for part, values in zip(held_out, series, strict=True)])
        for series in (case.truth_held_out, case.oracle)
    )
    least = float(np.sqrt(np.mean((oracle - truth) ** 2)))
    return [dataclasses.asdict(_score(method, case, problem, held_out, truth, least)) for method in METHODS]


def _score(method: str, case: Case, problem: Problem, held_out: list[Windows], truth: Array, least: float) -> Score:
    memory = "static"
    if method == "STLSQ":
        names = recorded_drivers(problem.runs)
        seen = {name: problem.driver(name) for name in names}
        terms, columns = library(seen)
        kept, _ = stlsq(problem.baseline, columns, problem.target_deg_h)
        drivers = drivers_of(terms, kept)
        new = {name: np.concatenate([part.means(part.full.column(name)) for part in held_out]) for name in names}
        both = library({name: np.r_[seen[name], new[name]] for name in names})[1][:, kept]
        known, unseen = both[: len(problem.rows)], both[len(problem.rows) :]
    else:
        dictionary = Dictionary(problem)
        if method == "laws, static alone":
            dictionary.families = tuple(family for family in dictionary.families if MEMORY_CLASS[family.memory] == "static")
        usual, (unusual, log_share) = ordinary_noise(), unrecorded_cause()
        noises: tuple[NoiseShape, ...] = (*usual, *unusual)
        weights = [(1.0 - WANDERING) / len(usual)] * len(usual) + (WANDERING * np.exp(log_share)).tolist()
        if method == "laws, white noise alone":
            noises, weights = (NoiseShape(),), [1.0]
        law = discover(problem, problem.baseline, noises, np.log(weights), dictionary=dictionary)
        drivers = set() if law is None else set(law.drivers)
        memory = "none" if law is None else law.memory
        laws = [] if law is None else [law.mechanism]
        known = np.column_stack([np.empty((len(problem.rows), 0)), *(problem.columns(one) for one in laws)])
        blocks = [[Problem.run_columns(one, part) for part in held_out] for one in laws]
        unseen = np.column_stack([np.empty((len(truth), 0)), *(np.concatenate(parts) for parts in blocks)])
    error = _held_out_error(problem, held_out, known, unseen, truth)
    return Score(
        case.plan.hidden[0] if case.plan.hidden else "healthy",
        method,
        bool(drivers),
        drivers == set(case.drivers),
        memory == case.memory,
        error / least,
    )


def _held_out_error(problem: Problem, held_out: list[Windows], known: Array, unseen: Array, truth: Array) -> float:
    """RMS error against the noise-free truth, baseline and law refitted by least squares."""
    mechanisms = [one for one in problem.simulator.mechanisms if one.amplitude_parameters()]

    def table(parts: Sequence[Windows], law: Array) -> Array:
        columns = [np.concatenate([Problem.run_columns(one, part) for part in parts]) for one in mechanisms]
        return np.column_stack([np.ones(len(law)), *columns, law])

    gyro = np.concatenate([part.means(part.full.rate_deg_h()) for part in problem.windows])
    design = table(problem.windows, known)
    size = np.sqrt((design**2).mean(axis=0))
    weights = np.linalg.lstsq(design / size, gyro, rcond=1e-10)[0] / size
    return float(np.sqrt(np.mean((table(held_out, unseen) @ weights - truth) ** 2)))


def main(argv: Sequence[str] | None = None) -> None:
    """Command line of the experiment."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cases", type=int, default=30, help="cases with a law outside the catalogue (default 30)")
    parser.add_argument("--nulls", type=int, default=40, help="healthy gyros (default 40)")
    parser.add_argument("--first", type=int, default=0, help="number of the first case")
    Work.add_options(parser, "laws")
    options = parser.parse_args(argv)
    wanted = [*plan("outside", options.cases, options.first), *plan("healthy", options.nulls, options.first)]
    pieces = [(one,) for one in wanted]
    scores = [Score(**score) for case in Work.of(options).results("laws", judge, pieces) for score in case]
    print(f"# Laws outside the catalogue: `python -m experiments.laws --cases {options.cases} --nulls {options.nulls}`\n")
    rows = []
    for effect in dict.fromkeys(score.effect for score in scores):
        for method in METHODS:
            of = [score for score in scores if (score.effect, score.method) == (effect, method)]
            healthy = effect == "healthy"
            rows.append(
                {
                    "effect": effect,
                    "method": method,
                    "cases": len(of),
                    "something found": sum(score.found for score in of),
                    "drivers right": "" if healthy else sum(score.drivers for score in of),
                    "memory right": "" if healthy else sum(score.drivers and score.memory for score in of),
                    "held-out error / oracle, median": f"{np.median([score.ratio for score in of]):.2f}",
                    "at most 2": sum(score.ratio <= 2.0 for score in of),
                    "largest": f"{max((score.ratio for score in of), default=math.nan):.1f}",
                }
            )
    show_table("Drivers, memory, held-out error", rows)


if __name__ == "__main__":
    main()
