"""One case diagnosed and scored, as one line of JSON; the diagnosis is read through its mapping and its simulators' predictions."""

from __future__ import annotations

import contextlib
import functools
import importlib
import math
import resource
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from experiments.concealed.case import Case, means
from experiments.concealed.cases import make_case
from experiments.concealed.chamber import WINDOW_S
from experiments.concealed.plan import NAMED, Plan
from experiments.concealed.rules import without_rules
from rlgcomp.challenge.score import Hidden, Score
from rlgcomp.simulation.simulator import Simulator
from rlgcomp.workers import DIED

Array = npt.NDArray[np.float64]
Row = dict[str, Any]
DIAGNOSE = "rlgcomp:diagnose"
_KIB = 1024
_NEAR_WINDOWS = 3.0  # between a step and where it is found
_CLOSER = 0.5  # of what a stated number is wrong by


def key_of(plan: Plan, function: str = DIAGNOSE, told: bool = False) -> str:
    """What a case is known by among the lines of a file."""
    return plan.name + (f" by {function}" if function != DIAGNOSE else "") + (" told" if told else "")


def heading(plan: Plan, function: str = DIAGNOSE, told: bool = False) -> Row:
    """What a case's line begins with."""
    return {
        "key": key_of(plan, function, told),
        "name": plan.name,
        "kind": plan.kind,
        "hidden": list(plan.hidden),
        "strengths": list(plan.strengths),
        "nuisance": plan.nuisance,
        "seed": plan.seed,
    }


def run_case(plan: Plan, function: str = DIAGNOSE, told: bool = False) -> Row:
    """Make a case, diagnose it by MODULE:FUNCTION, score it; a failure is scored as a wrong answer and the rest goes on.

    Parameters
    ----------
    plan : Plan
    function : str
    told : bool
        The hidden effects are its only candidates.
    """
    known = heading(plan, function, told)
    try:
        case = make_case(plan)
        known |= reachable(case)
        diagnose = loaded(function)
        return known | scored(case, functools.partial(diagnose, only=list(plan.hidden)) if told else diagnose)
    except Exception as error:  # noqa: BLE001  whatever it is, it is counted and the next case begins
        return known | {"failure": f"{type(error).__name__}: {error}"}


def died(plan: Plan, function: str = DIAGNOSE, told: bool = False) -> Row:
    """The line of a case that takes its worker with it each time."""
    return heading(plan, function, told) | {"failure": DIED}


def loaded(function: str) -> Callable[..., Any]:
    """The function of MODULE:FUNCTION."""
    module, _, name = function.partition(":")
    found: Callable[..., Any] = getattr(importlib.import_module(module), name)
    return found


def reachable(case: Case) -> Row:
    """What could be known of a case, and what it is."""
    return {
        "forms": list(case.forms),
        "true_drivers": sorted(case.drivers),
        "true_memory": case.memory,
        "white_noise": case.noise.white,
        "log_bayes_factor": case.log_bayes_factor,
        "separation_nats": case.separation_nats if math.isfinite(case.separation_nats) else None,
        "period_s": case.scale.period_s,
        "size_deg_h": case.scale.size_deg_h,
        "rows": sum(len(run) for run in (*case.train, *case.test)),
    }


def scored(case: Case, diagnose: Callable[..., Any]) -> Row:
    """Score of one case.

    Parameters
    ----------
    case : Case
    diagnose : callable
        Of (simulator, train=…, test=…); its result has `to_mapping()`, and simulators `calibrated` and `augmented` that predict.
    """
    simulator = Simulator.from_mapping(case.simulator_mapping)
    forget_peak_memory()
    begun, begun_cpu = time.perf_counter(), time.process_time()
    diagnosis = diagnose(simulator, train=case.train, test=case.test)
    seconds, cpu_seconds = time.perf_counter() - begun, time.process_time() - begun_cpu
    memory_mib = peak_memory_mib()
    content: Mapping[str, Any] = diagnosis.to_mapping()
    intervals: dict[str, list[tuple[float, float]]] = {}
    for by_run in case.intervals.values():
        for run, spans in zip(case.train, by_run, strict=True):
            intervals.setdefault(run.name, []).extend(spans)
    named = case.plan.hidden if case.plan.kind in NAMED else ()
    score = Score.of(Hidden(named, {}, intervals), content)
    before, after = (
        [predicted.predict(run).rate_deg_h() for run in case.test] for predicted in (diagnosis.calibrated, diagnosis.augmented)
    )
    error = held_out_error(case, after)
    unexplained = content["unexplained"]
    return {
        "verdict": score.verdict,
        "exact": score.exact,
        "in_class": score.in_class,
        "overlap": score.overlap,
        "p_value": content["mismatch"]["p_value"],
        "findings": [finding["mechanism"] for finding in content["findings"]],
        "probabilities": [finding["probability"] for finding in content["findings"]],
        "set_probability": set_probability(content),
        "drivers": sorted(unexplained["drivers"]),
        "memory": unexplained["memory"],
        "equation": unexplained["equation"],
        "nuisance_found": nuisance_found(case, content),
        "improvement": improvement(case, content, before, after),
        "error_to_oracle": error / held_out_error(case, case.oracle),
        "error_to_white": error / case.white_deg_h,
        "seconds": seconds,
        "cpu_seconds": cpu_seconds,
        "memory_mib": memory_mib,
        "without_rules": without_rules(diagnosis),
    }


def forget_peak_memory() -> None:
    """Count the largest memory from now on, where the system can (Linux, proc(5))."""
    with contextlib.suppress(OSError):
        Path("/proc/self/clear_refs").write_text("5", encoding="ascii")


def peak_memory_mib() -> float:
    """The largest resident memory since it was last forgotten; of the whole process where the system knows no other."""
    with contextlib.suppress(OSError):
        for line in Path("/proc/self/status").read_text(encoding="ascii").splitlines():
            if line.startswith("VmHWM:"):
                return float(line.split()[1]) / _KIB
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / _KIB


def set_probability(content: Mapping[str, Any]) -> float | None:
    """Probability that is stated of the chosen set, of none where none is missing; None where something else is there."""
    if content["verdict"] == "none":
        stated = content.get("nothing_missing")
    elif not content["findings"]:
        return None
    else:
        stated = content.get("probability")
        if stated is None:
            stated = min(finding["probability"] for finding in content["findings"])
    return None if stated is None else float(stated)


def held_out_error(case: Case, predictions: Sequence[Array]) -> float:
    """Root mean square of the window means of prediction less truth; about each run's mean where every run has a bias."""
    remainder = []
    for prediction, truth in zip(predictions, case.truth_held_out, strict=True):
        run = means(prediction - truth, case.samples)
        remainder.append(run - run.mean() if case.plan.nuisance == "run bias" else run)
    return float(np.sqrt(np.mean(np.concatenate(remainder) ** 2)))


def nuisance_found(case: Case, content: Mapping[str, Any]) -> bool | None:
    """Whether the steps, the run biases or the wrong number are recognised; None where there are none."""
    if case.steps:
        near_s = _NEAR_WINDOWS * case.samples * case.scale.period_s
        found = [(step["run"], step["at_s"]) for step in content.get("steps", ())]
        return all(any(run == other and abs(at_s - other_s) <= near_s for other, other_s in found) for run, at_s in case.steps)
    baseline = content.get("baseline_with_findings") or content.get("baseline") or {}
    if case.plan.nuisance == "run bias":
        names = {run.name for run in case.train}
        return any(name in key.split(":") for parameters in baseline.values() for key in parameters for name in names)
    if case.wrong is not None:
        mechanism, parameter, true, stated = case.wrong
        estimate = baseline.get(mechanism, {}).get(parameter)
        return estimate is not None and abs(estimate["value"] - true) < _CLOSER * abs(stated - true)
    return None


def improvement(case: Case, content: Mapping[str, Any], before: Sequence[Array], after: Sequence[Array]) -> Row | None:
    """The stated improvement, its interval, and what the same predictions gain on average over noise; None where none is stated."""
    stated = content["fit"]["test"]
    if stated is None or not content["findings"] or stated["improvement_ci95"][0] is None:
        return None
    samples = max(1, round(float(stated["averaging_s"]) / case.scale.period_s))
    square = {"before": 0.0, "after": 0.0}
    windows, noise = 0, 0.0
    for k, signal in enumerate(case.signal_held_out):
        count = len(signal) // samples
        windows += count
        noise += float(np.trace(case.noise.covariance(count, WINDOW_S * samples / case.samples))) * case.white_deg_h**2
        for key, predictions in (("before", before), ("after", after)):
            square[key] += float(np.sum(means(predictions[k] - signal, samples) ** 2))
    expected = 1.0 - math.sqrt((square["after"] + noise) / (square["before"] + noise))
    low, high = stated["improvement_ci95"]
    return {"stated": stated["improvement"], "low": low, "high": high, "expected": expected}
