r"""Overlapping Allan deviations of one long record at short averaging times and at multiples of a long one, such as octaves.

The angle is never stored as a whole. The record is cut into cells, and only the angle at the start of each cell is stored; parts of
the angle are summed again from there, in the processor's cache. Short averaging times use consecutive rows of the record. Long ones
use columns: cells a fixed number of samples apart contain all samples of the differences at multiples of that number. So every rate
is read three times, with a few megabytes of memory.
"""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt

from rlgcomp.errors import InputError
from rlgcomp.noise.allan_sums import BLOCK, MANY, aligned, angle_of, squares_2, sums_of_squares
from rlgcomp.numerics.compiled import available, compiled, in_threads, threads

Array = npt.NDArray[np.float64]
Whole = npt.NDArray[np.int64]
CELL: Final = 512  # samples
STRIDE: Final = 1 << 15  # samples of the shortest long averaging time; a whole number of cells, like ROWS
ROWS: Final = 1 << 17  # consecutive samples a piece of work
LONG: Final = 1 << 23  # samples from which two threads are faster than one


def overlapping_deviation(rate: Array, counts: Whole, workers: int | None = None) -> Array:
    """Overlapping Allan deviations of a record without gaps, without intervals and identification of noises.

    For many records, or one that is very long; :func:`rlgcomp.allan_deviation` gives intervals too.

    Parameters
    ----------
    rate : ndarray, shape (n,)
    counts : ndarray of int, shape (m,)
        Averaging times in samples, at most n / 2.
    workers : int, optional
        Threads; by default the cores that this process has.

    Returns
    -------
    ndarray, shape (m,)
        In the unit of the rate.

    Raises
    ------
    InputError
        An averaging time is not a whole number of samples, or longer than half the record.
    """
    rate, counts = np.ascontiguousarray(rate, dtype=np.float64), np.asarray(counts)
    whole = rate.ndim == counts.ndim == 1 and counts.dtype.kind in "iu" and counts.size
    if not whole or counts.min() < 1 or 2 * int(counts.max()) > len(rate):
        raise InputError(
            f"a rate of shape {rate.shape} and averaging times of {counts.tolist()[:8] if counts.ndim else counts} samples; give "
            "one column, and whole numbers from 1 to half its length"
        )
    taken = len(rate) - 2 * counts + 1
    fits = bool(((2 * counts <= STRIDE) | (counts % STRIDE == 0)).all())
    if fits and len(rate) >= MANY and available():
        sums = _sums(rate, counts, threads() if workers is None else workers)
    else:
        sums, _ = sums_of_squares(angle_of(rate, workers), np.array([len(rate)]), counts, 2, workers)
    return np.sqrt(sums / (2.0 * taken)) / counts


def _sums(rate: Array, counts: Whole, workers: int) -> Array:
    cells, apart = -(-(len(rate) + 1) // CELL), STRIDE // CELL
    totals, starts = np.empty(cells), np.zeros(cells)
    pieces = [(rate, k, k + apart, CELL, totals) for k in range(0, cells, apart)]
    in_threads(_totals, pieces, workers if len(rate) >= LONG else 1)
    mean = float(totals.sum()) / len(rate)
    np.cumsum(totals[:-1] - mean * CELL, out=starts[1:])

    short = counts < STRIDE
    blocks, column = range(0, len(rate), ROWS), -(-cells // apart)  # a column's cells
    tiles = [
        *((first // CELL, 1, (ROWS + STRIDE) // CELL, ROWS, counts[short]) for first in blocks),
        *((first, apart, column, column * CELL, counts[~short] // apart) for first in range(apart if not short.all() else 0)),
    ]
    sums = [np.zeros(len(tile[-1])) for tile in tiles]
    buffers = [aligned(max(ROWS + STRIDE, column * CELL)) for _ in range(workers)]
    fill, squares, begin = _fill.fast(), squares_2.fast(), np.array([0])

    def sum_up(first: int, step: int, many: int, taken: int, lags: Whole, total: Array) -> None:
        buffer = buffers.pop()
        size = fill(rate, mean, starts, first, step, many, CELL, buffer)
        squares(buffer[:size], begin, np.array([size - 1]), lags, 0, taken, BLOCK, total)
        buffers.append(buffer)

    in_threads(sum_up, [(*tile, total) for tile, total in zip(tiles, sums, strict=True)], workers)
    whole = np.empty(len(counts))
    whole[short] = np.sum(sums[: len(blocks)], axis=0)
    whole[~short] = np.sum(sums[len(blocks) :], axis=0)
    return whole


@compiled(reassociate=True)
def _totals(rate: Array, first: int, last: int, cell: int, totals: Array) -> None:
    for c in range(first, min(last, len(totals))):
        part = rate[c * cell : (c + 1) * cell]  # counted from its start, the loop goes in vectors
        total = 0.0
        for k in range(len(part)):
            total += part[k]
        totals[c] = total


@compiled()
def _fill(rate: Array, mean: float, starts: Array, first: int, step: int, many: int, cell: int, buffer: Array) -> int:
    """Angles of so many cells, a step apart, into the buffer; how many angles they are. Four sums go side by side."""
    done, apart = 0, step * cell
    while done + 4 <= many and (first + (done + 3) * step + 1) * cell <= len(rate):
        c = first + done * step
        a, b, d, e = starts[c], starts[c + step], starts[c + 2 * step], starts[c + 3 * step]
        from_a, to_a = rate[c * cell :], buffer[done * cell :]
        from_b, from_d, from_e = from_a[apart:], from_a[2 * apart :], from_a[3 * apart :]
        to_b, to_d, to_e = to_a[cell:], to_a[2 * cell :], to_a[3 * cell :]
        for k in range(cell):
            to_a[k], to_b[k], to_d[k], to_e[k] = a, b, d, e
            a += from_a[k] - mean
            b += from_b[k] - mean
            d += from_d[k] - mean
            e += from_e[k] - mean
        done += 4
    size = done * cell
    while done < many and (first + done * step) * cell <= len(rate):
        at = (first + done * step) * cell
        total = starts[first + done * step]
        for k in range(at, min(at + cell, len(rate) + 1)):
            buffer[size] = total
            size += 1
            total += rate[k] - mean if k < len(rate) else 0.0
        done += 1
    return size
