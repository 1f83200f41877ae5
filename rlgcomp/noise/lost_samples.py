r"""Lost samples of a record: a mean over a window counts where 80 % of its samples are there, as in every average of the package.

The record lies on the places of its clock, with and without a sample. At an averaging time of m places, a gap longer than a fifth
of m ends a part; over a shorter one the clock runs on. A difference counts where each of its windows has 80 % of its samples. Its
square is divided by the factor by which white noise exceeds that of full windows, :math:`m \sum_i c_i^2 / n_i / \sum_i c_i^2`, the
:math:`c_i` being 1, -1 or 1, -2, 1 and :math:`n_i` the samples of the windows, so that white noise keeps its variance.
"""

from __future__ import annotations

import dataclasses
import functools
import itertools
import math
from typing import Final, Self

import numpy as np
import numpy.typing as npt

from rlgcomp.noise import allan_sums
from rlgcomp.noise.allan_sums import PIECE, starts_of_spans
from rlgcomp.numerics.compiled import available, compiled, in_threads, threads
from rlgcomp.recording.sampling import LEAST_COVERAGE

Array = npt.NDArray[np.float64]
Whole = npt.NDArray[np.int64]
_WEIGHTS: Final = {2: (-1.0, 1.0), 3: (1.0, -2.0, 1.0)}
_ROUNDING: Final = 1e-9
PLACES_EXAMINED: Final = 1 << 20  # of a long record; they show how much of its differences is lost


def most_lost(m: int) -> int:
    """Samples that a window of m may lack."""
    return m - math.ceil(LEAST_COVERAGE * m - _ROUNDING)


@dataclasses.dataclass(frozen=True)
class Places:
    """Places of a record's clock at one averaging time.

    Parameters
    ----------
    ends : ndarray of int, shape (parts,)
        Place after the last one of each part.
    lost : ndarray of int
        Places without a sample, in order.
    """

    ends: Whole
    lost: Whole

    @property
    def parts(self) -> Whole:
        """Places of each part."""
        return np.diff(self.ends, prepend=0)

    def samples_before(self, place: Whole) -> Whole:
        """Number of samples before each place."""
        return np.asarray(place - np.searchsorted(self.lost, place), dtype=np.int64)

    def of_samples(self, sample: npt.NDArray[np.intp]) -> npt.NDArray[np.intp]:
        """Place of each sample, or the place after the last one."""
        return sample + np.searchsorted(self.lost - np.arange(len(self.lost)), sample, side="right")

    def differences(self, angle: Array, first: Whole, m: int, order: int) -> tuple[Array, npt.NDArray[np.bool_]]:
        """Differences of the angle over windows that begin at places, m times those of the means, and which of them count.

        Parameters
        ----------
        angle : ndarray, shape (n + 1,)
            Cumulative sums of the rate at its samples.
        first : ndarray of int
            Places at which the first window of each difference begins; all windows lie within one part.
        m : int
            Places of a window.
        order : int
            2 for Allan, 3 for Hadamard.
        """
        before = [self.samples_before(first + k * m) for k in range(order + 1)]
        counts = [after - at for at, after in itertools.pairwise(before)]
        counted = np.minimum.reduce(counts) >= m - most_lost(m)
        total, variance = np.zeros(len(first)), np.zeros(len(first))
        for k, weight in enumerate(_WEIGHTS[order]):
            samples = np.maximum(counts[k], 1)
            total += weight * (angle[before[k + 1]] - angle[before[k]]) / samples
            variance += weight * weight / samples
        usual = sum(weight * weight for weight in _WEIGHTS[order]) / m
        return m * total * np.sqrt(usual / variance), counted

    def sum_of_squares(self, angle: Array, m: int, order: int, *, overlapping: bool) -> tuple[float, int]:
        """Sum of squared differences at every place of each part, or at every m-th, and their number.

        Parameters
        ----------
        angle : ndarray, shape (n + 1,)
        m : int
            Places of a window.
        order : int
            2 for Allan, 3 for Hadamard.
        overlapping : bool
            At every place.
        """
        if not overlapping:
            difference, counted = self.differences(angle, starts_of_spans(self.parts, m, order)[0], m, order)
            return float(np.dot(difference[counted], difference[counted])), int(counted.sum())
        if len(angle) > allan_sums.MANY and available():
            starts = range(0, int(self.ends[-1]), PIECE)
            sums = np.zeros((len(starts), 2))
            pieces = [
                (angle, self.ends - self.parts, self.ends, self.lost, m, order, start, start + PIECE, m - most_lost(m), sums[k])
                for k, start in enumerate(starts)
            ]
            in_threads(_squares, pieces, threads())
            return float(sums[:, 0].sum()), int(sums[:, 1].sum())
        total, taken = 0.0, 0
        for begin, end in zip((self.ends - self.parts).tolist(), self.ends.tolist(), strict=True):
            last = end - order * m + 1
            for first in range(begin, last, allan_sums.SAMPLES_AT_ONCE):
                places = np.arange(first, min(first + allan_sums.SAMPLES_AT_ONCE, last))
                difference, counted = self.differences(angle, places, m, order)
                total += float(np.dot(difference[counted], difference[counted]))
                taken += int(counted.sum())
        return total, taken

    def starts(
        self, m: int, order: int, *, overlapping: bool, most: int = PLACES_EXAMINED
    ) -> tuple[npt.NDArray[np.bool_], npt.NDArray[np.bool_]]:
        """Whether a difference that begins at a place counts, and whether it would without lost samples.

        Parameters
        ----------
        m : int
            Places of a window.
        order : int
            2 for Allan, 3 for Hadamard.
        overlapping : bool
            At every place.
        most : int
            Places of a long record that are examined, the first ones.
        """
        end = min(int(self.ends[-1]), max(most, 8 * order * m))
        present = np.ones(end, dtype=np.int64)
        present[self.lost[self.lost < end]] = 0
        before = np.r_[0, np.cumsum(present)]
        enough = before[m:] - before[:-m] >= m - most_lost(m)
        total = end - order * m + 1
        possible = np.zeros(total, dtype=np.bool_)
        first = starts_of_spans(self.parts, m, order)[0] if not overlapping else np.empty(0, dtype=np.int64)
        possible[first[first < total]] = True
        if overlapping:
            long = self.parts >= order * m
            edges = np.zeros(total + 1, dtype=np.int64)
            np.add.at(edges, np.minimum((self.ends - self.parts)[long], total), 1)
            np.add.at(edges, np.minimum(self.ends[long] - order * m + 1, total), -1)
            possible = np.cumsum(edges)[:-1] > 0
        kept = np.logical_and.reduce([possible, *(enough[k * m : k * m + total] for k in range(order))])
        return kept, possible

    def means(self, angle: Array, m: int, most: int) -> tuple[Array, Whole]:
        """Means over consecutive windows that count, and a number that those next to each other share.

        Parameters
        ----------
        angle : ndarray, shape (n + 1,)
        m : int
            Places of a window.
        most : int
            Greatest number of windows, the first ones.
        """
        first, groups = starts_of_spans(self.parts, m, 1, most)
        at, after = self.samples_before(first), self.samples_before(first + m)
        counted = after - at >= m - most_lost(m)
        groups = groups + np.cumsum(~counted)
        return ((angle[after] - angle[at])[counted] / (after - at)[counted]), np.unique(groups[counted], return_inverse=True)[1]


@dataclasses.dataclass(frozen=True)
class Gaps:
    """The gaps of a record.

    Parameters
    ----------
    ends : ndarray of int, shape (parts,)
        Index after the last sample of each part without a gap.
    lost : ndarray of int, shape (parts - 1,)
        Samples that each gap lacks.
    """

    ends: Whole
    lost: Whole

    @classmethod
    def of_steps(cls, ends: Whole, steps_s: Array, period_s: float) -> Self:
        """Gaps of the steps of time across them.

        Parameters
        ----------
        ends : ndarray of int, shape (parts,)
        steps_s : ndarray, shape (parts - 1,)
            From the last sample before each gap to the first after it.
        period_s : float
        """
        lost = np.maximum(np.rint(steps_s / period_s) - 1.0, 1.0)
        return cls(np.asarray(ends, dtype=np.int64), np.minimum(lost, 2.0**62).astype(np.int64))

    @functools.cached_property
    def bridged(self) -> npt.NDArray[np.bool_]:
        """Gaps that a window may span: what they lack is at most a quarter of the samples of the two spans beside them.

        Short gaps come first, and what they join counts for longer ones.
        """
        parts = np.diff(self.ends, prepend=0).tolist()
        lost = self.lost.tolist()
        span = list(range(len(parts)))  # of each part, by union

        def root(part: int) -> int:
            while span[part] != part:
                span[part] = span[span[part]]
                part = span[part]
            return part

        bridged = np.zeros(len(lost), dtype=np.bool_)
        waiting = np.argsort(self.lost, kind="stable").tolist()
        joined = True
        while joined and waiting:
            joined, later = False, []
            for gap in waiting:
                left, right = root(gap), root(gap + 1)
                if LEAST_COVERAGE * lost[gap] <= (1.0 - LEAST_COVERAGE) * (parts[left] + parts[right]):
                    span[right] = left
                    parts[left] += parts[right]
                    bridged[gap] = joined = True
                else:
                    later.append(gap)
            waiting = later
        return bridged

    @functools.cached_property
    def shortest(self) -> int:
        """Places of the shortest window that may lack what a gap lacks; no window is as long where none is bridged."""
        if not self.bridged.any():
            return 1 << 62
        return math.ceil(int(self.lost[self.bridged].min()) / (1.0 - LEAST_COVERAGE) - _ROUNDING)

    def places(self, m: int | None = None) -> Places:
        """Places at an averaging time; without one, with all gaps that a window may span."""
        over = self.bridged if m is None else self.bridged & (self.lost <= most_lost(m))
        before = np.cumsum(np.where(over, self.lost, 0))
        ends = np.r_[self.ends[:-1] + before, self.ends[-1:] + before[-1:].sum()]
        counts = self.lost[over]
        first = (self.ends[:-1] + before - self.lost)[over]
        lost = np.repeat(first - np.cumsum(counts) + counts, counts) + np.arange(int(counts.sum()))
        return Places(ends[np.r_[~over, True]], lost)


@compiled(reassociate=True)
def _squares(
    angle: Array, begins: Whole, ends: Whole, lost: Whole, m: int, order: int, low: int, high: int, fewest: int, out: Array
) -> None:
    """Sum of squared differences that begin at places from low, before high, and their number.

    From one place to the next the samples of the windows change only where an edge of theirs passes a lost sample.
    """
    at, edge = np.empty(order + 1, np.int64), np.empty(order + 1, np.int64)
    for p in range(len(ends)):
        k, last = max(low, begins[p]), min(high, ends[p] - order * m + 1)
        for j in range(order + 1):
            at[j] = np.searchsorted(lost, k + j * m)
        while k < last:
            stop, least = last, m
            for j in range(order + 1):
                while at[j] < len(lost) and lost[at[j]] < k + j * m:
                    at[j] += 1
                edge[j] = k + j * m - at[j]
                least = min(least, edge[j] - edge[j - 1]) if j > 0 else least
                stop = min(stop, lost[at[j]] - j * m + 1) if at[j] < len(lost) else stop
            many = stop - k
            k = stop
            if least < fewest:
                continue
            near, one, two = angle[edge[0] : edge[0] + many], angle[edge[1] : edge[1] + many], angle[edge[2] : edge[2] + many]
            by_1, by_2 = 1.0 / (edge[1] - edge[0]), 1.0 / (edge[2] - edge[1])
            total = 0.0
            if order == 2:
                usual, variance = 2.0 / m, by_1 + by_2
                for i in range(many):
                    difference = by_2 * (two[i] - one[i]) - by_1 * (one[i] - near[i])
                    total += difference * difference
            else:
                three, by_3 = angle[edge[3] : edge[3] + many], 1.0 / (edge[3] - edge[2])
                usual, variance = 6.0 / m, by_1 + 4.0 * by_2 + by_3
                for i in range(many):
                    difference = by_3 * (three[i] - two[i]) - 2.0 * by_2 * (two[i] - one[i]) + by_1 * (one[i] - near[i])
                    total += difference * difference
            out[0] += total * m * m * (usual / variance)
            out[1] += many
