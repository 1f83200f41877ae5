"""One case diagnosed and scored, as one line of JSON."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from experiments.concealed.cases import Case, NoiseOfUnits, make_case, means, read_in_pulses
from rlgcomp.challenge.score import Hidden, Score
from rlgcomp.noise.processes import NoiseModel
from rlgcomp.simulation.simulator import Simulator
from rlgcomp.workers import DIED

Array = npt.NDArray[np.float64]
Arguments = tuple[Any, tuple[str, ...], float, int, bool]


@dataclasses.dataclass(frozen=True)
class Manner:
    """How cases are made and asked about, other than usual.

    Parameters
    ----------
    stated : bool
        The diagnosis is told the unit's true noise.
    pulse_arcsec : float
        The gyro is read in whole pulses of so much, dithered; not where it is zero.
    noise : {"drawn", "whole", "white"}
        What a unit has, and what strengths are relative to: see :func:`experiments.concealed.cases.make_case`.
    """

    stated: bool = False
    pulse_arcsec: float = 0.0
    noise: NoiseOfUnits = "drawn"

    def key_of(self, arguments: Arguments) -> str:
        """What a case is known by among the lines of a file."""
        pulses = f" in pulses of {self.pulse_arcsec:g} arcsec" if self.pulse_arcsec else ""
        noise = {"drawn": "", "whole": " relative to all noise", "white": " in white noise"}[self.noise]
        return repr(arguments) + " with its noise stated" * self.stated + pulses + noise

    def asked(self, arguments: Arguments) -> dict[str, Any]:
        """What a case's line begins with."""
        kind, effects, strength, seed, independent = arguments
        return {
            "key": self.key_of(arguments),
            "kind": kind,
            "hidden": list(effects),
            "strength": strength,
            "seed": seed,
            "independent": independent,
        }


def run_case(arguments: Arguments, manner: Manner = Manner()) -> dict[str, Any]:
    """Make a case, diagnose it, score it. A failure is an answer too: it is scored as such and the rest goes on."""
    asked = manner.asked(arguments)
    try:
        case = make_case(*arguments, noise_of_units=manner.noise)
        if manner.pulse_arcsec:
            case = read_in_pulses(case, manner.pulse_arcsec)
        return asked | diagnosed(case, manner.stated)
    except Exception as error:  # noqa: BLE001  whatever it is, it is counted and the next case begins
        return asked | {"failure": f"{type(error).__name__}: {error}"}


def died(arguments: Arguments, manner: Manner = Manner()) -> dict[str, Any]:
    """The line of a case that takes its worker with it each time."""
    return manner.asked(arguments) | {"failure": DIED}


def diagnosed(case: Case, stated: bool = False) -> dict[str, Any]:
    """Score of one case; `stated` tells the diagnosis the unit's true noise."""
    from rlgcomp.diagnosis.diagnose import diagnose

    simulator = Simulator.from_mapping(case.simulator_mapping)
    begun, begun_cpu = time.perf_counter(), time.process_time()
    noise = NoiseModel.from_mapping(case.noise) if stated else None
    diagnosis = diagnose(simulator, train=case.train, test=case.test, noise=noise)
    seconds, cpu_seconds = time.perf_counter() - begun, time.process_time() - begun_cpu
    content = diagnosis.to_mapping()
    named = case.hidden if case.kind in ("single", "pair", "triple", "table", "unequal") else ()
    intervals: dict[str, list[tuple[float, float]]] = {}
    for by_run in case.intervals.values():
        for run, spans in zip(case.train, by_run, strict=True):
            intervals.setdefault(run.name, []).extend(spans)
    score = Score.of(Hidden(named, case.sizes, intervals), content)
    ours = [diagnosis.augmented.predict(recording).rate_deg_h() for recording in case.test]
    error, oracle = held_out_error(ours, case.truth_held_out), held_out_error(case.oracle, case.truth_held_out)
    unexplained = content["unexplained"]
    return score.to_mapping() | {
        "name": case.name,
        "p_value": content["mismatch"]["p_value"],
        "findings": [finding["mechanism"] for finding in content["findings"]],
        "probabilities": [finding["probability"] for finding in content["findings"]],
        "classes": [finding["indistinguishable_from"] for finding in content["findings"]],
        "frequencies_hz": [place["frequency_hz"] for place in content["mismatch"]["where"] if place["frequency_hz"]],
        "drivers": sorted(unexplained["drivers"]),
        "memory": unexplained["memory"],
        "equation": unexplained["equation"],
        "true_drivers": sorted(case.drivers),
        "true_memory": case.memory,
        "repeats": case.repeats,
        "white_noise": not (case.noise["bias_instability_deg_h"] or case.noise["rate_random_walk_deg_h_sqrt_h"]),
        "information_nats": case.information_nats,
        "promised": None if diagnosis.test is None else diagnosis.test.improvement,
        "error_to_oracle": error / oracle,
        "error_to_white": error / case.white_100_s_deg_h,
        "seconds": seconds,
        "cpu_seconds": cpu_seconds,
    }


def held_out_error(predictions: Sequence[Array], truths: Sequence[Array]) -> float:
    """Root mean square of the 100 s means of prediction less noise-free truth, over the held-out runs."""
    left = np.concatenate([means(prediction - truth) for prediction, truth in zip(predictions, truths, strict=True)])
    return float(np.sqrt(np.mean(left**2)))
