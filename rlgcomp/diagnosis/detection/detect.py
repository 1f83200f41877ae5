r"""Is there anything beyond noise: a p-value from replicates of noise to which all is done that was done to the data.

The statistic is the log of the evidence of "one cause more, or something unrecorded, or a line" against none, averaged over shapes,
sizes and noises. Under the null its distribution is that of replicates

.. math:: y^* = \sigma \, \epsilon^*, \qquad \epsilon^* \sim N(0, \Sigma_\eta), \qquad \eta \sim p(\eta \mid y, \text{no cause})

(the baseline's parameters do not matter, for it is projected out). Beyond the largest replicates the tail is exponential, as that
of a log evidence is at most.

Noise that by chance looks like something missing also looks coarser than it is, so such p-values lean to one half; and those of
white noise lean to one, since some flicker is always reckoned with. Each replicate therefore gets a p-value of its own, from the
same replicates weighted to the noises that it would have been credited with, and the data's p-value is where theirs stands among
these (prepivoting). Each further round takes off most of the error that is left.

References
----------
R. Beran, "Prepivoting test statistics: a bootstrap view of asymptotic refinements", J. Am. Stat. Assoc. 83, 687 (1988).
"""

from __future__ import annotations

import dataclasses
import functools
import math
import sys
from typing import Final

import numpy as np
import numpy.typing as npt

from rlgcomp.diagnosis.naming.evidence import SIZES, Evidence, log_sum_exp
from rlgcomp.diagnosis.noise.loops import table_sums
from rlgcomp.diagnosis.noise.whitening import simulate
from rlgcomp.numerics.compiled import available, in_threads

Array = npt.NDArray[np.float64]
REPLICATES: Final = 400
_REACH: Final = 300.0  # log units up to which Bayes factors of lines are read off a table
_STEP: Final = 0.005  # of that table, in log units: cubics between are right to 1e-12
_ROUNDS: Final = 5  # of prepivoting
_TAIL: Final = 0.025  # of the replicates: beyond these they are too few to count


@dataclasses.dataclass(frozen=True)
class Detection:
    """Whether there is a mismatch.

    Parameters
    ----------
    p_value : float
    statistic : float
        Log evidence for something against nothing.
    replicates : ndarray
        The statistic of noise.
    """

    p_value: float
    statistic: float
    replicates: Array


def detect(
    evidence: Evidence, noise_log_prior: Array, ordinary: npt.NDArray[np.bool_], count: int, rng: np.random.Generator
) -> Detection:
    """Test the null hypothesis that the calibrated simulator lacks nothing.

    Parameters
    ----------
    evidence : Evidence
    noise_log_prior : ndarray, shape (noises,)
    ordinary : ndarray of bool, shape (noises,)
        Noises that the null hypothesis allows.
    count : int
        Candidates that were there before the data were looked at.
    rng : numpy.random.Generator
    """
    nothing = (evidence.extensions(()).point + noise_log_prior)[ordinary]
    share = np.exp(nothing - log_sum_exp(nothing))
    drawn = np.flatnonzero(ordinary)[rng.choice(len(share), size=REPLICATES, p=share / share.sum())]
    rows = evidence.problem.rows
    targets = np.empty((len(rows), REPLICATES + 1))
    targets[:, 0] = evidence.problem.target_deg_h / evidence.scale_deg_h
    for k in np.unique(drawn):
        chosen = np.flatnonzero(drawn == k)
        targets[:, chosen + 1] = simulate(rows, evidence.noises[k], len(chosen), rng)
    found, likelihood = _statistics(evidence, noise_log_prior, ordinary, count, targets)
    weights = _credited(likelihood[:, 1:], noise_log_prior[ordinary], share)
    return Detection(_prepivoted(float(found[0]), found[1:], weights), float(found[0]), found[1:])


def _prepivoted(value: float, replicates: Array, weights: Array, rounds: int = _ROUNDS) -> float:
    """p-value of a statistic among its replicates, each of which weighs all by its row of weights, after so many rounds."""
    for _ in range(rounds):
        value, replicates = -math.log(tail_probability(value, replicates)), -np.log(_own_p_values(replicates, weights))
    return tail_probability(value, replicates)


def _own_p_values(found: Array, weights: Array) -> Array:
    """p-value of each replicate's statistic among all, each weighing them by its row of weights."""
    return np.asarray((weights * (found >= found[:, None])).sum(axis=1))


def _credited(log_likelihood: Array, noise_log_prior: Array, share: Array) -> Array:
    """Weights of replicates as if drawn from the noises that each is credited with itself, shape (replicates, replicates), rows
    adding up to one.

    Parameters
    ----------
    log_likelihood : ndarray, shape (noises, replicates)
        Of nothing missing.
    noise_log_prior, share : ndarray, shape (noises,)
        `share` of the replicates were drawn from each noise.
    """
    posterior = log_likelihood + noise_log_prior[:, None]
    credited = np.exp(posterior - log_sum_exp(posterior, axis=0))
    likelihood = np.exp(log_likelihood - log_likelihood.max(axis=0))
    weights = credited.T @ (likelihood / (share @ likelihood))  # (credited, drawn)
    return np.asarray(weights / weights.sum(axis=1, keepdims=True))


def tail_probability(value: float, replicates: Array) -> float:
    """Probability of at least this value, by rank among replicates, and beyond the largest few by an exponential tail.

    The tail falls by e a unit: so does that of -log p, and no log evidence falls slower (Markov's inequality). It ends where
    numbers do, so that every probability has a logarithm.
    """
    ordered = np.sort(replicates)
    count = max(5, int(_TAIL * len(ordered)))
    above = int((replicates >= value).sum())
    if above >= count:
        return (above + 1.0) / (len(ordered) + 1.0)
    beyond = math.exp(min(float(ordered[-count]) - value, 0.0))
    return max((count + 1.0) / (len(ordered) + 1.0) * beyond, sys.float_info.min)


def _line(evidence: Evidence, left: Array) -> Array:
    """Log Bayes factor of a line at some frequency, its phase kept or drawn anew, for whitened targets, shape (n, targets)."""
    parts = evidence.problem.rows.runs
    size = 2 * max(part.stop - part.start for part in parts)
    spectra = [np.fft.rfft(left[part], size, axis=0)[2:-1] for part in parts]
    square = np.einsum("nt,nt->t", left, left)
    kept = _squared(sum(spectra[1:], spectra[0]))
    anew = len(parts) * sum((_squared(spectrum) for spectrum in spectra), np.zeros(kept.shape))
    summed = _of_many if available() else _of_each
    factors = [
        summed(power * (2.0 / len(left) / square), len(left), amplitudes, evidence.freedom)
        for power, amplitudes in ((kept, 2), (anew, 2 * len(parts)))
    ]
    return np.asarray(log_sum_exp(np.array(factors), axis=0) - math.log(2.0 * len(SIZES) * len(kept)))


def _squared(spectrum: npt.NDArray[np.complex128]) -> Array:
    return np.asarray(spectrum.real**2 + spectrum.imag**2)


def _line_factors(rows: int, amplitudes: int) -> tuple[Array, Array]:
    """Of a line at each of `SIZES`: by how much what it explains is shrunk, and its Occam factor."""
    shrunk = rows / (rows + amplitudes / SIZES**2)
    return shrunk, 0.5 * amplitudes * np.log1p(rows * SIZES**2 / amplitudes)


def _of_each(shares: Array, rows: int, amplitudes: int, freedom: int) -> Array:
    """Log of the sum of Bayes factors over frequencies and sizes, of shares of the square, shape (frequencies, targets)."""
    logs = [
        log_sum_exp(-occam - 0.5 * freedom * np.log1p(-np.minimum(shrunk * shares, 1.0 - 1e-12)), axis=0)
        for shrunk, occam in zip(*_line_factors(rows, amplitudes), strict=True)
    ]
    return log_sum_exp(np.array(logs), axis=0)


def _of_many(shares: Array, rows: int, amplitudes: int, freedom: int) -> Array:
    """The same by a table of the sum over sizes, which is a smooth function of the share; shares beyond it are few."""
    table, slopes, step = _table(rows, amplitudes, freedom)
    sums = np.zeros(shares.shape[1])
    table_sums(shares, table, slopes, step, sums)
    beyond = np.where(shares >= (len(table) - 1) * step, shares, -np.inf)
    strong = np.flatnonzero(np.isfinite(beyond).any(axis=0))
    with np.errstate(divide="ignore"):
        logs = np.log(sums)
    logs[strong] = np.logaddexp(logs[strong], _of_each(beyond[:, strong], rows, amplitudes, freedom))
    return logs


@functools.lru_cache(maxsize=4)
def _table(rows: int, amplitudes: int, freedom: int) -> tuple[Array, Array, float]:
    """The sum over sizes at multiples of a step, its derivative times the step, and the step: the same for every noise."""
    step = 2.0 * _STEP / freedom
    places = step * np.arange(math.ceil(min(-math.expm1(-2.0 * _REACH / freedom), 0.5) / step) + 1)
    shrunk, occam = (column[:, None] for column in _line_factors(rows, amplitudes))
    rest = 1.0 - shrunk * places
    each = np.exp(-occam - 0.5 * freedom * np.log(rest))
    return each.sum(axis=0), step * (0.5 * freedom * shrunk / rest * each).sum(axis=0), step


def _statistics(
    evidence: Evidence, noise_log_prior: Array, ordinary: npt.NDArray[np.bool_], count: int, targets: Array
) -> tuple[Array, Array]:
    """The statistic of every column of targets, and its log likelihood with nothing missing, by ordinary noise."""
    weights = np.array([candidate.log_weight for candidate in evidence.candidates[:count]])
    per_name = -math.log(len({candidate.name for candidate in evidence.candidates[:count]}))
    whitened = evidence.whitener(targets)
    points, something = np.empty((2, len(whitened), targets.shape[1]))

    def fill(k: int) -> None:
        left = evidence.left(k, whitened[k])
        points[k] = evidence.constant(k) + noise_log_prior[k] - 0.5 * evidence.freedom * np.log(np.einsum("nt,nt->t", left, left))
        something[k] = points[k]
        if ordinary[k]:
            something[k] += per_name + np.logaddexp(evidence.averaged(k, left, weights), _line(evidence, left))

    in_threads(fill, [(k,) for k in range(len(whitened))])
    nothing = points[ordinary]
    statistic = log_sum_exp(something, axis=0) - log_sum_exp(nothing, axis=0)
    return np.asarray(statistic), nothing - noise_log_prior[ordinary][:, None]
