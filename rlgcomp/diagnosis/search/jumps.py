r"""Jumps to levels of their own: beside a set, something unrecorded is constant for a while and then takes another value.

.. math:: y = X\beta + A w + \ell + \epsilon, \qquad \ell_t = c_k \text{ within the } k\text{-th part of a run},
          \quad c_k \sim N(0, \lambda \sigma^2)

with white noise, and a jump in each window with probability h. It is the rival of a two-state process
(:mod:`~rlgcomp.diagnosis.search.telegraph`), whose parts have two values alone. For given parts the evidence is in closed form; the
likeliest parts are found for given β and w, these for given parts, in turn. The sum over all parts follows from the recursion that
finds the likeliest ones.

References
----------
D. Barry and J. A. Hartigan, "Product partition models for change point problems", Ann. Statist. 20, 260 (1992).
P. Fearnhead, "Exact and efficient Bayesian inference for multiple changepoint problems", Stat. Comput. 16, 203 (2006).
"""

from __future__ import annotations

import dataclasses
import math
from typing import Final

import numpy as np
import numpy.typing as npt

from rlgcomp.diagnosis import priors
from rlgcomp.diagnosis.data import Data
from rlgcomp.diagnosis.search.process import Problem, Process

Array = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.intp]
_ROUNDS: Final = 12
_SAME: Final = 0.1  # nats of one round
_FEWEST: Final = 4  # jumps between parts that last: fewer are steps of the bias
_LASTING: Final = 3  # windows: what is back where it was after fewer is an outlier
_APART: Final = 3.0  # standard deviations between two levels, from which on they are not the same
_RANGE_OF_RATES: Final = 100.0  # between the most and the fewest jumps a window


def jumps(data: Data, design: Array, table: Array, start: Process, white: Array) -> Process | None:
    """The likeliest jumps between levels of their own beside a set; None where they are few.

    Parameters
    ----------
    data : Data
    design : ndarray, shape (n, p)
        Columns of the baseline, flat.
    table : ndarray, shape (n, r)
        Columns of the set, weights of variance σ².
    start : Process
        A two-state process, whose jumps are the first ones.
    white : ndarray, shape (n,)
        Variance of the white noise, over that of a window mean.
    """
    problem = Divided.of(data, design, table, white)
    found = problem.at(_parts_of(start.path, data), (2.0 * start.half_step / start.sigma) ** 2)
    for _ in range(_ROUNDS):
        parts, more = problem.likeliest_parts(found)
        found = dataclasses.replace(found, log_parts=more)
        again = problem.at(parts, found.size)
        if again.log_evidence < found.log_evidence + _SAME:
            break
        found = again
    return None if problem.lasting_jumps(found) < _FEWEST else problem.as_process(found)


def _parts_of(path: Array, data: Data) -> IntArray:
    """Number of the part that each window lies in, from the jumps of a path; runs begin parts."""
    begins = np.zeros(len(path), np.bool_)
    begins[1:] = np.sign(path[1:]) != np.sign(path[:-1])
    begins[[rows.start for rows in data.slices]] = True
    return np.cumsum(begins) - 1


@dataclasses.dataclass(frozen=True, eq=False)
class Parts:
    """Parts with what follows from them.

    Parameters
    ----------
    parts : ndarray of int, shape (n,)
    size : float
        λ, the variance of the levels over that of the white noise.
    rate : float
        h, jumps a window.
    left : ndarray, shape (n,)
        Output less baseline and set, in its unit.
    levels : ndarray, shape (n,)
    variance : float
        Of the white noise.
    log_evidence : float
        Of these very parts.
    log_parts : float
        How much likelier all parts are than the likeliest ones, as a logarithm.
    """

    parts: IntArray
    size: float
    rate: float
    left: Array
    levels: Array
    variance: float
    log_evidence: float
    log_parts: float = 0.0

    @property
    def count(self) -> int:
        return int(self.parts[-1]) + 1


class Divided(Problem):
    """A problem whose runs are divided into parts with a level each."""

    def at(self, parts: IntArray, size: float) -> Parts:
        """The exact evidence of given parts, and the levels' variance one step nearer to its likeliest value."""
        starts, precision = np.flatnonzero(np.r_[True, parts[1:] != parts[:-1]]), self.root**-2
        weight = np.add.reduceat(precision, starts)
        both = np.column_stack([self.columns, self.output])
        shrink = (1.0 - 1.0 / np.sqrt(1.0 + size * weight)) / weight
        met = np.add.reduceat(both / self.root[:, None], starts, axis=0)
        both = both - (shrink[:, None] * met)[parts] / self.root[:, None]
        columns, output = both[:, :-1], both[:, -1]
        information, along = self.information(columns), columns.T @ output
        weights = np.linalg.solve(information, along)
        known = self.data.known
        square = max(float(output @ output - along @ weights), 1e-300) + known.square
        freedom = len(output) - self.flat + known.windows
        variance = square / freedom
        gaps = len(output) - len(self.data.runs)
        count = len(starts) - len(self.data.runs)
        rate = (count + 0.5) / (gaps + 1.0)
        value = -float(np.sum(np.log(self.root))) - 0.5 * float(np.sum(np.log1p(size * weight)))
        value -= 0.5 * float(np.linalg.slogdet(information)[1]) + 0.5 * freedom * math.log(square)
        value += count * math.log(rate) + (gaps - count) * math.log1p(-rate)
        left = (self.output - self.columns @ weights) * self.root
        mean = size * np.add.reduceat(left * precision, starts) / (1.0 + size * weight)
        return Parts(
            parts,
            float(np.mean(mean**2 / variance + size / (1.0 + size * weight))),
            rate,
            left,
            mean[parts],
            variance,
            value + self._log_volume(count, len(starts)),
        )

    def _log_volume(self, count: int, levels: int) -> float:
        """Of the rate of jumps and of the size of levels, each log-uniform, about their likeliest values."""
        of_rate = math.sqrt(2.0 * math.pi / (count + 1.0)) / math.log(_RANGE_OF_RATES)
        of_size = math.sqrt(math.pi / levels) / math.log(priors.SIZES[-1] / priors.SIZES[0])
        return math.log(min(of_rate, 1.0)) + math.log(min(of_size, 1.0))

    def likeliest_parts(self, found: Parts) -> tuple[IntArray, float]:
        """The likeliest parts for given weights, and how much likelier all of them are, as a logarithm."""
        begins, more = [], 0.0
        for rows in self.data.slices:
            places, gain = division(found.left[rows], self.root[rows] ** -2, found)
            begins.append(places)
            more += gain
        first = np.concatenate([rows.start + places for rows, places in zip(self.data.slices, begins, strict=True)])
        parts = np.zeros(len(self.output), np.intp)
        parts[first] = 1
        return np.cumsum(parts) - 1, more

    def lasting_jumps(self, found: Parts) -> int:
        """Jumps from one part that lasts to the next that does, at another level."""
        total = 0
        for rows in self.data.slices:
            _, first, windows = np.unique(found.parts[rows], return_index=True, return_counts=True)
            lasts = windows >= _LASTING
            levels, error = found.levels[rows][first[lasts]], np.sqrt(found.variance / windows[lasts])
            total += int(np.sum(np.abs(np.diff(levels)) > _APART * np.hypot(error[1:], error[:-1])))
        return total

    def as_process(self, found: Parts) -> Process:
        """As what the other rooms read: the levels over their standard deviation."""
        spread = max(float(np.std(found.levels)), 1e-300)
        return Process(
            spread,
            math.sqrt(found.variance),
            1.0 / found.rate,
            found.levels / spread,
            float(found.count - len(self.data.runs)),
            found.log_evidence + found.log_parts,
            kind="levels",
        )


def division(left: Array, precision: Array, found: Parts) -> tuple[IntArray, float]:
    """Where the likeliest parts of one run begin, and the logarithm of how much likelier all divisions are."""
    n = len(left)
    weights, sums = np.r_[0.0, np.cumsum(precision)], np.r_[0.0, np.cumsum(left * precision)]
    grown = 1.0 + found.size * np.maximum(weights[None, :] - weights[:, None], 0.0)
    value = 0.5 * (found.size / found.variance) * (sums[None, :] - sums[:, None]) ** 2 / grown - 0.5 * np.log(grown)
    stay = math.log1p(-found.rate)
    value += stay * (np.arange(n + 1)[None, :] - np.arange(n + 1)[:, None] - 1.0)
    value[1:] += math.log(found.rate)
    best, total, come_from = np.zeros(n + 1), np.zeros(n + 1), np.zeros(n + 1, np.intp)
    for end in range(1, n + 1):
        one = value[:end, end]
        along = best[:end] + one
        come_from[end] = k = int(np.argmax(along))
        best[end] = along[k]
        summed = total[:end] + one
        top = float(np.max(summed))
        total[end] = top + math.log(float(np.sum(np.exp(summed - top))))
    places, end = [], n
    while end:
        end = int(come_from[end])
        places.append(end)
    return np.array(places[::-1], np.intp), float(total[n] - best[n])
