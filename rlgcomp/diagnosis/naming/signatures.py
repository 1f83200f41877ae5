r"""Whether what follows no recorded column is what its name says: jumps between two values, a line of one frequency.

A path of jumps or a line takes after whatever jumps or swings. Jumps between two values are judged against jumps to any value: in
window means y with white noise of variance sigma^2 in a full window, levels drawn anew from N(0, A^2) at each jump, summed over
all times since the last jump, r,

.. math:: p(y_{1:k}, r_k) = \sum_{r_{k-1}} p(y_{1:k-1}, r_{k-1}) \, p(r_k \mid r_{k-1}) \, p(y_k \mid r_k, y_{1:k-1})

against the same sum over paths between two values, less what slow noise beside these explains. A line is one where its frequency
holds more than those next to it. Stays of a random telegraph are exponential; those of a switch that keeps time are alike, or those
at each value. And a telegraph that is not certain must be twenty times likelier than slow normal noise of its spectrum.

References
----------
R. P. Adams, D. J. C. MacKay, "Bayesian online changepoint detection", arXiv:0710.3742 (2007).
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from typing import Any, Final

import numpy as np
import numpy.typing as npt
from scipy import special

from rlgcomp.diagnosis.naming.evidence import Member, log_sum_exp
from rlgcomp.diagnosis.naming.explain import Explanations
from rlgcomp.diagnosis.naming.search import Label, Model
from rlgcomp.diagnosis.naming.two_levels import DWELLS_S, log_likelihood
from rlgcomp.diagnosis.noise.whitening import NoiseShape, Rows, whiten
from rlgcomp.physics.mechanism import Mechanism

Array = npt.NDArray[np.float64]
_SIZES: Final = (0.8, 1.0, 1.25)  # half steps that are averaged over, of the one found
_LEVELS: Final = (0.6, 1.0, 1.5)  # standard deviations of levels, of the same
_NOISES: Final = (0.85, 1.0)  # of what the path leaves
_PASTS: Final = 80  # times since the last jump that are reckoned with
_MANY: Final = 120  # before unlikely ones are dropped
_CERTAIN: Final = 0.99  # probability of jumps from which they are named; less likely ones
_TOLD: Final = math.log(20.0)  # have these odds against slow noise of their spectrum, or are not reckoned with
_NOT_THEIRS: Final = "is none: held-out runs do not jump as the training runs do"
_FEWEST_STAYS: Final = 6
_UNSEEN: Final = 5.0  # windows: shorter stays are missed
_DRAWS: Final = 20_000
_RARELY: Final = 5e-4
_NEAR: Final = tuple(k for k in range(-5, 6) if k)  # neighbours of a line, in steps of 1 / duration
_BROAD: Final = 0.01  # p-value of what the neighbours hold: with more, noise alone does
_AROUND: Final = tuple(k for k in range(-20, 21) if abs(k) > 8)  # those that show the noise there


def undoubted(explanations: Explanations) -> Explanations:
    """The same without paths of jumps, where the likeliest set holds one that slow noise explains nearly as well.

    Such a path is not certain, and not twenty times likelier than normal noise of its spectrum.
    """
    likeliest = explanations.likeliest
    for member in likeliest.members:
        candidate = explanations.evidence.candidates[member.candidate]
        if not candidate.mechanism.is_telegraph() or explanations.probability_of(candidate.name) > _CERTAIN:
            continue  # slow noise of any spectrum had its say
        values, left = _alone(explanations, likeliest, member)
        two, slow = (_by_size(law, explanations.evidence.problem.rows, values, left) for law in (log_likelihood, _slow_noise))
        if two - slow < _TOLD:
            return explanations.without(candidate.name, "slow noise of its spectrum explains it nearly as well")
    return explanations


def misnamed(explanations: Explanations, model: Model) -> dict[Label, str]:
    """Causes of a set that are not what they are named for in the training runs, or not in held-out runs that no set accounts for,
    and what they are not.

    Parameters
    ----------
    explanations : Explanations
    model : Model
        One of its models.
    """
    found = {}
    for member in model.members:
        candidate = explanations.evidence.candidates[member.candidate]
        frequency_hz = _frequency_hz(candidate.mechanism)
        why = None
        if candidate.mechanism.is_telegraph():
            alone = len(model.labels) == 1 and explanations.unaccounted
            why = _NOT_THEIRS if alone else _no_jumps_between_two_levels(explanations, model, member)
        elif frequency_hz is not None and not _is_a_line(explanations, model, member, frequency_hz):
            why = "is none: its frequency does not stay the same"
        if why is not None:
            found[candidate.name, candidate.known] = why
    return found


def _no_jumps_between_two_levels(explanations: Explanations, model: Model, path: Member) -> str | None:
    """Why a path is not said to be one of random jumps between two values."""
    evidence = explanations.evidence
    rows = evidence.problem.rows
    values, left = _alone(explanations, model, path)
    two = _by_size(log_likelihood, rows, values, left)
    in_training = explanations.in_training(model).noise_log
    if _any_level(rows, values, left) - two > float(in_training.max() - in_training[evidence.calmest]):
        return "is none: it has more than two levels"
    if _keeps_time(evidence.candidates[path.candidate].columns[:, 0], rows):
        return "is none: its stays are too alike to be random"
    return None


def _by_size(law: Callable[[Rows, Array, float, float], Array], rows: Rows, jumps: Array, left: Array) -> float:
    """Log likelihood of jumps and what they leave by a law of half step and noise, averaged over these, near those found."""
    half_step, noise = _size(jumps), rows.white_level(left)
    grid = itertools.product((half_step * x for x in _SIZES), (noise * x for x in _NOISES))
    return _mean_of_logs(np.concatenate([law(rows, jumps + left, step, white) for step, white in grid]))


def _size(jumps: Array) -> float:
    return float(np.sqrt(np.mean(jumps**2)))


def _keeps_time(path: Array, rows: Rows) -> bool:
    """Whether stays at one value, or at each, are more alike than chance makes them, short ones unseen."""
    stays, high = [], []
    for part in rows.runs:
        flips = np.flatnonzero(np.diff(np.sign(path[part])) != 0.0) + 1
        stays += list(np.diff(rows.time_s[part][flips]) / rows.window_s)
        high += list(path[part][flips[:-1]] > 0.0)
    if len(stays) < _FEWEST_STAYS or np.mean(stays) < 2.0 * _UNSEEN:
        return False
    chance = np.random.default_rng(0).exponential(np.mean(stays) - _UNSEEN, (_DRAWS, len(stays))) + _UNSEEN
    return any(_alike(np.array(stays), chance, groups) for groups in (np.zeros(len(stays)), np.array(high)))


def _alike(stays: Array, chance: Array, groups: npt.NDArray[Any]) -> bool:
    """Whether stays are nearer the mean of their group, of shape (n,), than chance makes them, shape (draws, n)."""

    def spread(values: Array) -> Array:
        parts = [values[..., groups == group] for group in np.unique(groups)]
        apart = np.concatenate([part / part.mean(axis=-1, keepdims=True) - 1.0 for part in parts], axis=-1)
        return np.asarray(np.sqrt((apart**2).mean(axis=-1)))

    return bool(np.mean(spread(chance) <= spread(stays)) < _RARELY)


def _any_level(rows: Rows, jumps: Array, left: Array) -> float:
    """The same of jumps to any level of about this size."""
    half_step, noise = _size(jumps), rows.white_level(left)
    grid = itertools.product((half_step * x for x in _LEVELS), (noise * x for x in _NOISES), DWELLS_S)
    models = (np.array(column) for column in zip(*grid, strict=True))
    return _mean_of_logs(_log_likelihood_of_any_level(rows, jumps + left, *models))


def _slow_noise(rows: Rows, values: Array, half_step: float, noise: float) -> Array:
    """Log likelihood of normal noise with the covariance of jumps between two values and white noise, for each dwell."""
    windows = len(rows) - rows.contrasts
    shapes = [NoiseShape(wander=half_step / noise, wander_s=0.5 * dwell_s) for dwell_s in DWELLS_S]
    whitened, log_determinant = whiten(rows, values[:, None] / noise, shapes)
    square = (whitened[:, :windows] ** 2).sum(axis=(1, 2))
    return np.asarray(-0.5 * (square + log_determinant) - windows * math.log(noise * math.sqrt(2.0 * math.pi)))


def _log_likelihood_of_any_level(rows: Rows, values: Array, level: Array, noise: Array, dwell_s: Array) -> Array:
    """Of white noise about levels that change at random times, for models side by side, shape (m,)."""
    total = np.zeros(len(level))
    for part in rows.runs:
        steps = np.diff(rows.time_s[part], prepend=rows.time_s[part.start])
        log_weight, sums, counts = np.zeros((1, len(level))), np.zeros(1), np.zeros(1)
        for k, (value, white) in enumerate(zip(values[part], rows.white[part], strict=True)):
            if k:  # a jump, or none
                jump = -np.expm1(-steps[k] / dwell_s)
                log_weight = np.vstack([log_weight + np.log1p(-jump), log_sum_exp(log_weight, axis=0) + np.log(jump)])
                sums, counts = np.append(sums, 0.0), np.append(counts, 0.0)
            if len(sums) > _MANY:
                kept = np.sort(np.argsort(-log_weight.max(axis=1))[:_PASTS])
                log_weight, sums, counts = log_weight[kept], sums[kept], counts[kept]
            precision = level**-2 + counts[:, None] / noise**2
            variance = 1.0 / precision + white * noise**2
            expected = sums[:, None] / noise**2 / precision
            log_weight = log_weight - 0.5 * (np.log(2.0 * math.pi * variance) + (value - expected) ** 2 / variance)
            sums, counts = sums + value / white, counts + 1.0 / white
        total += log_sum_exp(log_weight, axis=0)
    return total


def _frequency_hz(mechanism: Mechanism) -> float | None:
    """Of a line; None of anything else."""
    found = [getattr(mechanism, parameter.name) for parameter in mechanism.parameters() if parameter.unit == "Hz"]
    return float(found[0]) if found else None


def _is_a_line(explanations: Explanations, model: Model, line: Member, frequency_hz: float) -> bool:
    """Whether a frequency holds more of the runs than those next to it do beyond the noise there; what is faster than window means
    is not judged."""
    rows = explanations.evidence.problem.rows
    if rows.contrasts or frequency_hz > 0.5 / rows.window_s:
        return True
    wave, left = _alone(explanations, model, line)
    near, around = (_held_beside(rows, left, frequency_hz, steps) for steps in (_NEAR, _AROUND))
    powers = 2 * len(rows.runs)  # squares in each of these
    noise = float(np.median(around)) / float(special.chdtri(powers, 0.5)) if len(around) else 0.0
    beyond = float(near.sum()) - noise * powers * len(near)
    chance = noise > 0.0 and float(special.chdtrc(powers * len(near), near.sum() / noise)) > _BROAD
    return chance or float(wave @ wave) > beyond


def _held_beside(rows: Rows, left: Array, frequency_hz: float, steps: Sequence[int]) -> Array:
    """What the runs hold together of each frequency so many steps of 1 / duration away, where windows show it in all of them."""
    found = []
    for step in steps:
        held = 0.0
        for part in rows.runs:
            time_s = rows.time_s[part]
            duration_s = float(np.ptp(time_s))
            other_hz = frequency_hz + step / duration_s
            if not 1.0 / duration_s < other_hz < 0.5 / rows.window_s:
                break
            turns = 2.0 * math.pi * other_hz * time_s
            waves = np.linalg.qr(np.column_stack([np.ones(len(turns)), np.cos(turns), np.sin(turns)]))[0][:, 1:]
            held += float(np.sum((waves.T @ left[part]) ** 2))
        else:
            found.append(held)
    return np.array(found)


def _alone(explanations: Explanations, model: Model, member: Member) -> tuple[Array, Array]:
    """What one member makes of the target beside the others of a set, and what all of it leaves, in one unit."""
    evidence = explanations.evidence
    columns = evidence.candidates[member.candidate].columns
    target, known = evidence.unexplained([other for other in model.members if other != member])
    own, rest = (values - known @ (known.T @ values) for values in (columns, target))
    amplitudes = np.linalg.lstsq(own, rest, rcond=1e-10)[0]
    return columns @ amplitudes, rest - own @ amplitudes


def _mean_of_logs(values: Array) -> float:
    """Logarithm of the mean of exponentials."""
    return float(log_sum_exp(values)) - math.log(len(values))
