r"""The sums behind Allan and Hadamard variances: squared differences of the angle at every sample, for many averaging times.

Long records are summed for all averaging times in one pass over blocks of the angle that stay in the processor's cache, compiled
and in threads; short ones by NumPy, one averaging time after the other. Both add the same squares, in another order.
"""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt

from rlgcomp.numerics.compiled import available, compiled, in_threads, threads

Array = npt.NDArray[np.float64]
Whole = npt.NDArray[np.int64]
MANY: Final = 300_000  # samples from which compiling pays
BLOCK: Final = 2048  # samples: those of one averaging time stay in the first-level cache
SAMPLES_AT_ONCE: Final = 1 << 20  # samples a NumPy operation
PIECE: Final = 1 << 17  # samples a piece of work; fixed, so that the sums do not depend on the number of threads


def angle_of(rate: Array, workers: int | None = None) -> Array:
    """Cumulative sums of a rate less its mean, from zero: n + 1 values, in periods of the rate's unit."""
    angle = aligned(len(rate) + 1)
    angle[0] = 0.0
    if len(rate) < MANY or not available():
        np.cumsum(rate - rate.mean(), out=angle[1:])
        return angle
    firsts = list(range(0, len(rate), PIECE))
    lasts = [*firsts[1:], len(rate)]
    totals = np.empty((len(firsts), 1))
    in_threads(_total, [(rate, first, last, totals[k]) for k, (first, last) in enumerate(zip(firsts, lasts, strict=True))], workers)
    mean = float(totals.sum()) / len(rate)
    before = np.cumsum(totals[:, 0] - mean * (np.array(lasts) - firsts))
    starts = [0.0, *before[:-1].tolist()]
    pieces = [(rate, mean, first, last, start, angle) for first, last, start in zip(firsts, lasts, starts, strict=True)]
    in_threads(_accumulate, pieces, workers)
    return angle


def sums_of_squares(angle: Array, ends: Whole, counts: Whole, order: int, workers: int | None = None) -> tuple[Array, Whole]:
    """Sums of squared differences of second or third order at every sample, and their numbers.

    Parameters
    ----------
    angle : ndarray, shape (n + 1,)
        The parts between gaps in one row.
    ends : ndarray of int, shape (parts,)
        Index after the last sample of each part, at last n; no difference spans two parts.
    counts : ndarray of int, shape (m,)
        Averaging times in samples.
    order : int
        2 for Allan, 3 for Hadamard.
    workers : int, optional
        Threads; by default the cores that this process has.

    Returns
    -------
    sums : ndarray, shape (m,)
    taken : ndarray of int, shape (m,)
    """
    lengths = np.diff(np.r_[0, ends])
    taken = np.array([int(np.maximum(lengths - order * m + 1, 0).sum()) for m in counts.tolist()], dtype=np.int64)
    if len(angle) <= MANY or not available():
        part = np.repeat(np.arange(len(ends), dtype=np.int32), lengths) if len(ends) > 1 else None
        return np.array([_one_sum(angle, part, m, order) for m in counts.tolist()]), taken
    starts = np.arange(0, len(angle), PIECE)
    sums = np.zeros((len(starts), len(counts)))
    begins = np.r_[0, ends[:-1]]
    loop = squares_2 if order == 2 else _squares_3
    in_threads(
        loop,
        [(angle, begins, ends, counts, int(start), int(start) + PIECE, BLOCK, sums[k]) for k, start in enumerate(starts)],
        threads() if workers is None else workers,
    )
    return sums.sum(axis=0), taken


def plain_sum_of_squares(angle: Array, parts: Whole, m: int, order: int) -> tuple[float, int]:
    """Sum of squared differences at every m-th sample of each part, and their number.

    Parameters
    ----------
    angle : ndarray, shape (n + 1,)
    parts : ndarray of int
        Numbers of samples between gaps.
    m : int
        Averaging time in samples.
    order : int
        2 for Allan, 3 for Hadamard.
    """
    first, _ = starts_of_spans(parts, m, order)
    difference = np.diff(angle[first[:, None] + m * np.arange(order + 1)], order)[:, 0]
    return float(np.dot(difference, difference)), len(difference)


def starts_of_spans(parts: Whole, m: int, length: int, most: int | None = None) -> tuple[Whole, Whole]:
    """First sample of each span, and the part that it lies in; the spans of a part start every m samples.

    Parameters
    ----------
    parts : ndarray of int
        Numbers of samples between gaps.
    m : int
        Averaging time in samples.
    length : int
        Length of a span in m samples.
    most : int, optional
        Greatest number of spans, the first ones.
    """
    counts = np.maximum(parts // m - length + 1, 0)
    if most is not None:
        counts = np.clip(most - (np.cumsum(counts) - counts), 0, counts)
    part = np.repeat(np.arange(len(parts)), counts)
    within = np.arange(len(part)) - np.repeat(np.cumsum(counts) - counts, counts)
    return (np.cumsum(parts) - parts)[part] + m * within, part


def aligned(values: int) -> Array:
    """Memory that begins at a cache line: a vector across two lines takes longer to load."""
    memory = np.empty(values + 8)
    first = -memory.ctypes.data // 8 % 8
    return memory[first : first + values]


def _one_sum(angle: Array, part: npt.NDArray[np.int32] | None, m: int, order: int) -> float:
    return sum(
        _sum_between(angle, part, m, order, first, min(first + SAMPLES_AT_ONCE, len(angle) - order * m))
        for first in range(0, len(angle) - order * m, SAMPLES_AT_ONCE)
    )


def _sum_between(angle: Array, part: npt.NDArray[np.int32] | None, m: int, order: int, first: int, stop: int) -> float:
    if order == 2:
        difference = angle[first + m : stop + m] * -2.0
        difference += angle[first:stop]
    else:
        difference = angle[first + m : stop + m] - angle[first + 2 * m : stop + 2 * m]
        difference *= 3.0
        difference -= angle[first:stop]
    difference += angle[first + order * m : stop + order * m]
    if part is not None:
        difference = difference[part[first + order * m - 1 : stop + order * m - 1] == part[first:stop]]
    return float(np.dot(difference, difference))


@compiled()
def _accumulate(rate: Array, mean: float, first: int, last: int, start: float, angle: Array) -> None:
    total = start
    for k in range(first, last):
        total += rate[k] - mean
        angle[k + 1] = total


@compiled(reassociate=True)
def _total(rate: Array, first: int, last: int, out: Array) -> None:
    part = rate[first:last]  # counted from its start, the loop goes in vectors
    total = 0.0
    for k in range(len(part)):
        total += part[k]
    out[0] = total


@compiled(reassociate=True)
def squares_2(angle: Array, begins: Whole, ends: Whole, counts: Whole, low: int, high: int, block: int, sums: Array) -> None:
    """Add the sums of squared second differences of the angle at each averaging time, block by block.

    Parameters
    ----------
    angle : ndarray, shape (n + 1,)
        The integrated rate.
    begins, ends : ndarray of int, shape (parts,)
        Where each part without a gap begins and ends, in samples.
    counts : ndarray of int, shape (m,)
        Averaging times in samples, rising.
    low, high : int
        Rows at which the differences may begin: from `low`, before `high`.
    block : int
        Rows at a time, so that what is read stays in the processor's cache.
    sums : ndarray, shape (m,)
        The sums so far, which are added to.
    """
    for p in range(len(ends)):
        first = max(low, begins[p])
        while first < min(high, ends[p]):
            last = min(first + block, high, ends[p])
            j = 0
            while j < len(counts):
                m = counts[j]
                m_2, m_3 = counts[min(j + 1, len(counts) - 1)], counts[min(j + 2, len(counts) - 1)]
                if j + 2 < len(counts) and last + 2 * max(m, m_2, m_3) <= ends[p] + 1:  # three share their samples
                    near, one, two = angle[first:last], angle[first + m : last + m], angle[first + 2 * m : last + 2 * m]
                    two_2, two_3 = angle[first + 2 * m_2 : last + 2 * m_2], angle[first + 2 * m_3 : last + 2 * m_3]
                    total = total_2 = total_3 = 0.0
                    if m_2 == 2 * m and m_3 == 4 * m:  # octaves: five loads for nine
                        for k in range(last - first):
                            by = two[k] - 2.0 * one[k] + near[k]
                            by_2 = two_2[k] - 2.0 * two[k] + near[k]
                            by_3 = two_3[k] - 2.0 * two_2[k] + near[k]
                            total += by * by
                            total_2 += by_2 * by_2
                            total_3 += by_3 * by_3
                    else:
                        one_2, one_3 = angle[first + m_2 : last + m_2], angle[first + m_3 : last + m_3]
                        for k in range(last - first):
                            by = two[k] - 2.0 * one[k] + near[k]
                            by_2 = two_2[k] - 2.0 * one_2[k] + near[k]
                            by_3 = two_3[k] - 2.0 * one_3[k] + near[k]
                            total += by * by
                            total_2 += by_2 * by_2
                            total_3 += by_3 * by_3
                    sums[j] += total
                    sums[j + 1] += total_2
                    sums[j + 2] += total_3
                    j += 3
                    continue
                stop = max(first, min(last, ends[p] - 2 * m + 1))
                near, one, two = angle[first:stop], angle[first + m : stop + m], angle[first + 2 * m : stop + 2 * m]
                total = 0.0
                for k in range(stop - first):
                    difference = two[k] - 2.0 * one[k] + near[k]
                    total += difference * difference
                sums[j] += total
                j += 1
            first = last


@compiled(reassociate=True)
def _squares_3(angle: Array, begins: Whole, ends: Whole, counts: Whole, low: int, high: int, block: int, sums: Array) -> None:
    for p in range(len(ends)):
        first = max(low, begins[p])
        while first < min(high, ends[p]):
            last = min(first + block, high, ends[p])
            for j in range(len(counts)):
                m = counts[j]
                stop = max(first, min(last, ends[p] - 3 * m + 1))
                near, one = angle[first:stop], angle[first + m : stop + m]
                two, three = angle[first + 2 * m : stop + 2 * m], angle[first + 3 * m : stop + 3 * m]
                total = 0.0
                for k in range(stop - first):
                    difference = three[k] - near[k] - 3.0 * (two[k] - one[k])
                    total += difference * difference
                sums[j] += total
            first = last
