r"""A step of the bias in one run, which no other run shows: one event, of which no law can be learnt.

From some moment on, or until then, one run is apart from all others,

.. math:: y = X \beta + \sum_m \Phi_m a_m + a \, [t \ge t_0] + \epsilon

beside each likely set of causes that holds no path of jumps. Its odds are those of the Bayes factor, averaged over noises, over the
number of moments; all sets without it stand against it, several flips of a telegraph and something that wanders among them.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np
import numpy.typing as npt

from rlgcomp.diagnosis.naming.background import Background
from rlgcomp.diagnosis.naming.explain import Explanations, considered
from rlgcomp.diagnosis.naming.inadequacy import inadequacy
from rlgcomp.diagnosis.naming.search import Model
from rlgcomp.diagnosis.naming.telegraph import best_path
from rlgcomp.diagnosis.noise.whitening import norms
from rlgcomp.diagnosis.question.events import BiasStep
from rlgcomp.diagnosis.question.problem import Problem
from rlgcomp.diagnosis.result import Estimate, Place, Step, chance

Array = npt.NDArray[np.float64]
STEP: Final = 0.03  # before the data are seen: that the bias steps once in one of the runs
_SURE: Final = 0.95  # probability from which that is said
_SHORTEST: Final = 4  # windows on either side
_BY: Final = 3.0  # standard deviations by which a step is no nothing
_SETS: Final = 4  # beside which it is sought
_COARSE: Final = 100  # moments of a run that are tried first
_FINER: Final = 8  # parts of a window


def sought(problem: Problem, explanations: Explanations, whole: Problem | None = None) -> BiasStep | None:
    """The step that training runs show beside a likely set of causes; None where there is hardly one.

    Parameters
    ----------
    problem : Problem
        Of the training runs, window means alone.
    explanations : Explanations
    whole : Problem, optional
        The same of training and held-out runs.
    """
    calm = explanations.calm
    noises, prior, _ = considered(problem)
    found = []
    for model in dict.fromkeys([*calm[:_SETS], explanations.nothing]):
        background = Background(problem, _design(problem, explanations, model), noises, prior)
        log_factor, step = _likeliest(problem, background)
        toll = inadequacy(explanations.evidence.explained(model.members, int(np.argmax(model.noise_log))))
        found.append((model.log_posterior + log_factor - toll, step))
    against = calm if _flips_once(problem, explanations, whole) else explanations.models
    log_odds = explanations.log_odds_of_event([log for log, _ in found], STEP, against)
    step = dataclasses.replace(max(found, key=lambda one: one[0])[1], log_odds=log_odds)
    return step if step.probability > _SURE else None


def told(problem: Problem, baseline: Mapping[str, Mapping[str, Estimate]]) -> tuple[Step, ...]:
    """The steps of a problem with their sizes, from what was fitted of its baseline; not one whose size is nothing, all being
    fitted together."""
    found = []
    for step in problem.steps:
        run = problem.runs[step.run].name
        apart = baseline["gyro"][f"{step.parameter}:{run}"]
        size = dataclasses.replace(apart, value=apart.value if step.after else -apart.value)
        if abs(size.value) > _BY * size.sd:
            found.append(Step(run, step.at_s, size, step.probability))
    return tuple(found)


def places(problem: Problem, steps: Sequence[Step]) -> list[tuple[Place, Array]]:
    """Where steps of a problem are, with what they do, from what :func:`told` gives of them."""
    known = {(problem.runs[step.run].name, step.at_s): step for step in problem.steps}
    found = []
    for one in steps:
        step = known[one.run, one.at_s]
        place = Place(one.run, problem.channel, one.at_s, float(problem.runs[step.run].time_s[-1]), p_value=chance([one]))
        found.append((place, problem.step_column(step) * one.size.value))
    return found


def with_places(
    where: Sequence[Place], problem: Problem, events: Sequence[tuple[Place, Array]], white_deg_h: float
) -> tuple[Place, ...]:
    """Places of a mismatch, and those of events, with their shares of it all together: the most significant first.

    Parameters
    ----------
    where : sequence of Place
    problem : Problem
    events : sequence of tuple
        Steps and causes in a part of the runs: the place of each, and what it does there.
    white_deg_h : float
        Standard deviation of the white noise of a full window's mean.
    """
    if not events:
        return tuple(where)
    bare = problem.with_steps(()).with_partly(()).baseline
    design = np.linalg.qr(bare / norms(bare))[0]
    columns = (problem.target_deg_h, *(column for _, column in events))
    left, *parts = (values - design @ (design.T @ values) for values in columns)
    squares = [float(part @ part) for part in parts]
    beyond_noise = max(float(left @ left) - white_deg_h**2 * float(problem.rows.white.sum()), sum(squares), 1e-300)
    shares = [square / beyond_noise for square in squares]
    rest = max(0.0, 1.0 - sum(shares))
    found = [dataclasses.replace(place, share=share) for (place, _), share in zip(events, shares, strict=True)]
    others = (dataclasses.replace(place, share=place.share * rest) for place in where)
    return tuple(sorted([*found, *others], key=lambda place: place.p_value))


def _likeliest(problem: Problem, background: Background) -> tuple[float, BiasStep]:
    """The logarithm of a step's Bayes factor over the number of moments, and the likeliest step: between any two windows of a run,
    but at its ends, and then within a window."""
    window_s = problem.rows.window_s
    begins = [(problem.rows.time_s[part] - 0.5 * window_s)[_SHORTEST:-_SHORTEST] for part in problem.rows.runs]
    strides = [math.ceil(len(of_run) / _COARSE) for of_run in begins]
    some = [(run, at_s) for run, (of_run, stride) in enumerate(zip(begins, strides, strict=True)) for at_s in of_run[::stride]]
    screen = background.few()
    best, _ = _best(problem, screen, [BiasStep(run, float(at_s), after) for run, at_s in some for after in (True, False)])
    near = begins[best.run][np.abs(begins[best.run] - best.at_s) < strides[best.run] * window_s]
    best, _ = _best(problem, screen, [dataclasses.replace(best, at_s=float(at_s)) for at_s in near])
    within = best.at_s + window_s / _FINER * np.arange(1 - _FINER, _FINER)
    best, _ = _best(problem, screen, [dataclasses.replace(best, at_s=float(at_s)) for at_s in within])
    best, log_factor = _best(problem, background, [best])
    return log_factor - math.log(2 * sum(map(len, begins))), best


def _best(problem: Problem, background: Background, steps: Sequence[BiasStep]) -> tuple[BiasStep, float]:
    """The likeliest of some steps, and the logarithm of its Bayes factor."""
    logs = background.log_bayes_factors(np.column_stack([problem.step_column(step) for step in steps]))
    return steps[int(np.argmax(logs))], float(logs.max())


def _flips_once(problem: Problem, explanations: Explanations, whole: Problem | None) -> bool:
    """Whether the likeliest set has a path of jumps that is one step: it flips once in the training runs, and in no other."""
    likeliest = explanations.likeliest
    paths = [one.columns[:, 0] for one in explanations.candidates(likeliest) if one.mechanism.is_telegraph()]
    if not paths or sum(int((np.diff(np.sign(paths[0][part])) != 0.0).sum()) for part in problem.rows.runs) != 1:
        return False
    if whole is None:
        return True
    beside = [
        whole.columns(one.mechanism)[: len(whole.rows)]
        for one in explanations.candidates(likeliest)
        if not one.mechanism.is_telegraph()
    ]
    design = np.column_stack([whole.baseline, *beside])
    return (
        best_path(whole.rows, whole.target_deg_h / np.std(whole.target_deg_h), np.linalg.qr(design / norms(design))[0]).flips <= 1
    )


def _design(problem: Problem, explanations: Explanations, model: Model) -> Array:
    columns = [one.columns[: len(problem.rows)] for one in explanations.candidates(model)]
    return np.column_stack([problem.baseline, *columns])
