r"""A cause that acts in a part of the runs: something that was not recorded switches it on.

.. math:: y = X \beta + \sum_m \Phi_m a_m + a \, \phi \, [r \in A] + \epsilon

with phi the one column of a mechanism that follows a recorded channel, or dies away from a run's beginning as what a cold start
makes, and A some of the training runs, one of which it may act in from some moment on, or until then. Its odds are as those of a
step (:mod:`rlgcomp.diagnosis.bias_steps`), over the number of mechanisms, of their shapes and of parts. Where it acts in the other
runs as well, only less, it is none: then its equation is another.
"""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np
import numpy.typing as npt

from rlgcomp.diagnosis.fitting.linearised import solve
from rlgcomp.diagnosis.naming.background import Background
from rlgcomp.diagnosis.naming.explain import Explanations, considered
from rlgcomp.diagnosis.naming.inadequacy import inadequacy
from rlgcomp.diagnosis.naming.search import Model
from rlgcomp.diagnosis.naming.signatures import misnamed
from rlgcomp.diagnosis.noise.whitening import NoiseShape
from rlgcomp.diagnosis.question.events import PARTLY as PART
from rlgcomp.diagnosis.question.events import BiasStep, Partly, probability_of
from rlgcomp.diagnosis.question.problem import Problem
from rlgcomp.diagnosis.result import Estimate, InPart, Place, chance
from rlgcomp.physics.mechanism import Mechanism

Array = npt.NDArray[np.float64]
PARTLY: Final = 0.03  # before the data are seen: that a cause acts in a part of the runs
_SURE: Final = 0.95  # probability from which that is said
_LESS: Final = 0.5  # of what it is where it acts, that a cause is less than where it does not,
_BY: Final = 3.0  # by so many standard deviations
_LITTLE: Final = 0.1  # of what it is where a run begins
_ALL_PARTS: Final = 4  # runs, of which all parts are tried; of more, one run or all but one
_MOMENTS: Final = 60  # of a run
_SHORTEST: Final = 10  # windows on either side of a moment


def sought(problem: Problem, explanations: Explanations) -> Partly | None:
    """The cause that training runs show in a part of them; None where there is hardly one.

    Parameters
    ----------
    problem : Problem
        Of the training runs, window means alone.
    explanations : Explanations
    """
    columns, parts = _columns(explanations, len(problem.rows)), _parts(len(problem.windows))
    if not columns or not parts:
        return None
    noises, prior, _ = considered(problem)
    switches = {one: [_switches(column[rows]) for rows in problem.rows.runs] for one, column in columns.items() if one.thresholds()}

    def acting(one: Mechanism, part: tuple[int, ...]) -> bool:
        """Whether it is more than one step of the bias."""
        return one not in switches or sum(switches[one][run] for run in part) > 1

    shapes = Counter(one.name for one in columns)
    found = []
    for model in _sets(explanations):
        named = {name for name, _ in model.labels}
        tried = [Partly(one, part) for one in columns if one.name not in named for part in parts if acting(one, part)]
        if not tried:
            continue  # all are named for all runs
        causes = [candidate.columns[: len(problem.rows)] for candidate in explanations.candidates(model)]
        design = np.column_stack([problem.baseline, *causes])
        background = Background(problem, design, noises, prior)
        best, _ = _best(problem, background.few(), tried, columns, shapes)
        best, log_factor = _best(problem, background, [best], columns, shapes)
        toll = inadequacy(explanations.evidence.explained(model.members, int(np.argmax(model.noise_log))))
        found.append((model.log_posterior + log_factor - math.log(len(shapes) * len(parts)) - toll, best, background, design))
    log_odds = explanations.log_odds_of_event([one[0] for one in found], PARTLY, _against(explanations)) if found else -math.inf
    if probability_of(log_odds) < _SURE:
        return None
    _, best, background, design = max(found, key=lambda one: one[0])
    best = dataclasses.replace(_from_a_moment_on(problem, background, best, columns), log_odds=log_odds)
    return best if _silent_elsewhere(problem, best, design, background.noises, prior) else None


def told(
    problem: Problem, whole: Problem | None, baseline: Mapping[str, Mapping[str, Estimate]], noise: NoiseShape
) -> tuple[InPart, ...]:
    """Causes of a problem that act in a part of the runs, with their sizes, from what was fitted of its baseline; and what held-out
    runs show of them, in the whole problem. Not one whose size is nothing, all being fitted together."""
    found, names = [], [run.name for run in problem.runs]
    for one in problem.partly:
        size = baseline["gyro"].get(f"{PART}:{one.mechanism.name}")
        if size is None:
            continue  # biases of each run's own take all of it
        size = dataclasses.replace(size, unit=one.mechanism.amplitude_parameters()[0].unit)
        if abs(size.value) < _BY * size.sd:
            continue
        mentioned = {*one.runs, *([one.moment.run] if one.moment else [])}
        acts = [names[run] for run in one.runs]
        silent = [name for run, name in enumerate(names) if run not in mentioned]
        for name, (theirs, sd) in {} if whole is None else _held_out(whole, one, noise).items():
            acts += [name] if abs(theirs - size.value) < _BY * sd < _LESS * abs(size.value) else []
            silent += [name] if abs(theirs) + _BY * sd < _LESS * abs(size.value) else []
        drivers = one.mechanism.driver_columns(problem.runs[0])
        told_of = InPart(one.mechanism.name, drivers, size, tuple(acts), tuple(silent), one.probability)
        if one.moment is not None:
            at = one.moment
            told_of = dataclasses.replace(told_of, run=names[at.run], at_s=at.at_s, after=at.after)
        found.append(told_of)
    return tuple(found)


def places(problem: Problem, in_part: Sequence[InPart]) -> list[tuple[Place, Array]]:
    """Where causes act in a part of a problem's runs, with what they do there, from what :func:`told` gives of them."""
    found = []
    for told_of in in_part:
        one = next(one for one in problem.partly if one.mechanism.name == told_of.mechanism)
        column, moment = problem.partly_column(one) * told_of.size.value, one.moment
        for k in sorted({*one.runs, *([moment.run] if moment else [])}):
            start_s, end_s = (float(problem.runs[k].time_s[end]) for end in (0, -1))
            if moment and moment.run == k:
                start_s, end_s = (moment.at_s, end_s) if moment.after else (start_s, moment.at_s)
            place = Place(problem.runs[k].name, problem.channel, start_s, end_s, p_value=chance([told_of]))
            found.append((place, column * (problem.rows.run == k)))
    return found


def _held_out(whole: Problem, one: Partly, noise: NoiseShape) -> dict[str, tuple[float, float]]:
    """A cause's amplitude in each held-out run, and its standard deviation."""
    weights, covariance, square = solve(whole, whole.baseline, noise)
    variance = np.diag(covariance) * square / (len(whole.rows) - whole.baseline.shape[1])
    return {
        parameter.removeprefix(f"{PART}:"): (float(weights[k]), math.sqrt(max(float(variance[k]), 0.0)))
        for k, (name, parameter) in enumerate(whole.baseline_names)
        if name == one.mechanism.name and parameter.startswith(f"{PART}:")
    }


def _sets(explanations: Explanations) -> list[Model]:
    """Beside which it is sought: the likeliest without a path of jumps and biases of each run's own; it less one cause; nothing."""
    calm = explanations.calm
    less = [one for one in calm if any(len(other.labels - one.labels) == 1 and one.labels < other.labels for other in calm[:1])]
    return list(dict.fromkeys([*calm[:1], *less, explanations.nothing]))


def _against(explanations: Explanations) -> Sequence[Model]:
    """The sets that stand against it: without paths of jumps, where the likeliest holds one that no chance draws."""
    model, search = explanations.likeliest, explanations.search
    jumps = model.labels - search.without_jumps(model.labels)
    if not jumps or jumps.isdisjoint(misnamed(explanations, model)):
        return explanations.models
    return [one for one in explanations.models if search.without_jumps(one.labels) == one.labels]


def _columns(explanations: Explanations, rows: int) -> dict[Mechanism, Array]:
    """Of mechanisms with one that follow a recorded channel, or die away, at the shapes that were tried before the data were looked
    at."""
    problem = explanations.evidence.problem
    run, parts = problem.runs[0], problem.rows.runs
    tried = explanations.evidence.candidates[: explanations.coarse]
    return {
        one.mechanism: one.columns[:rows, 0]
        for one in tried
        if one.columns.shape[1] == 1 and not (one.known or one.mechanism.empirical) and one.mechanism.repeats()
        if one.mechanism.driver_columns(run) or _dies_away(one.columns[:rows, 0], parts)
    }


def _switches(column: Array) -> int:
    """How often a relay switches in a run."""
    return int(np.count_nonzero(np.diff(column > 0.5 * (column.min() + column.max()))))


def _dies_away(column: Array, parts: Sequence[slice]) -> bool:
    """Whether a column is largest where runs begin, and little where they end."""
    sizes = [np.abs(column[part]) for part in parts]
    return all(size[0] == size.max() > 0.0 and size[-1] < _LITTLE * size[0] for size in sizes)


def _parts(runs: int) -> list[tuple[int, ...]]:
    """Parts of so many runs, neither none nor all."""
    sizes = range(1, runs) if runs <= _ALL_PARTS else sorted({1, runs - 1})
    return [part for size in sizes for part in itertools.combinations(range(runs), size)]


def _best(
    problem: Problem,
    background: Background,
    tried: Sequence[Partly],
    columns: Mapping[Mechanism, Array],
    shapes: Mapping[str, int] | None = None,
) -> tuple[Partly, float]:
    """The likeliest, and the logarithm of its Bayes factor over the number of shapes of its name, where that is given."""
    table = np.column_stack([problem.in_part(columns[one.mechanism], one) for one in tried])
    logs = background.log_bayes_factors(table)
    if shapes is not None:
        logs = logs - np.log([shapes[one.mechanism.name] for one in tried])
    return tried[int(np.argmax(logs))], float(logs.max())


def _from_a_moment_on(problem: Problem, background: Background, best: Partly, columns: Mapping[Mechanism, Array]) -> Partly:
    """The same, acting in one run from some moment on, or until then, where that explains more than the choice of a moment does."""
    tried = []
    for run, part in enumerate(problem.rows.runs):
        begins_s = (problem.rows.time_s[part] - 0.5 * problem.rows.window_s)[_SHORTEST:-_SHORTEST]
        others = tuple(other for other in best.runs if other != run)
        for at_s in begins_s[:: math.ceil(len(begins_s) / _MOMENTS)]:
            tried += [Partly(best.mechanism, others, BiasStep(run, float(at_s), after)) for after in (True, False)]
    if not tried:
        return best
    _, plain = _best(problem, background, [best], columns)
    sooner, _ = _best(problem, background.few(), tried, columns)
    sooner, log_factor = _best(problem, background, [sooner], columns)
    return sooner if log_factor - math.log(len(tried)) > plain else best


def _silent_elsewhere(problem: Problem, found: Partly, design: Array, noises: Sequence[NoiseShape], prior: Array) -> bool:
    """Whether it is certain that the cause hardly acts in each of the other runs."""
    column = problem.partly_column(found)
    size, _ = Background(problem, design, noises, prior).amplitude(column)
    rest = Background(problem, np.column_stack([design, column]), noises, prior)
    for run in set(range(len(problem.windows))) - {*found.runs, *([found.moment.run] if found.moment else [])}:
        theirs, sd = rest.amplitude(problem.partly_column(Partly(found.mechanism, (run,))))
        if abs(theirs) + _BY * sd > _LESS * abs(size):
            return False
    return True
