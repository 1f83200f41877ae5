r"""Lines within the averaging windows, and harmonics of a table's angle, in what is left of a gyro at its full rate.

A harmonic k has columns :math:`\cos k\theta, \sin k\theta`. Their window means B and their deviations W within windows are tested
at once: with the residual's means b (standard deviation one) and deviations w (standard deviation s),

.. math:: g = r^T A^{-1} r, \qquad r = B^T b + W^T w / s^2, \qquad A = B^T B + W^T W / s^2

is :math:`\chi^2` with two degrees of freedom where there is nothing. A line's power P is compared with the M powers about it.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from typing import Final, Self

import numpy as np
import numpy.typing as npt

from rlgcomp.diagnosis.question.problem import Problem
from rlgcomp.diagnosis.question.pulses import beat_deg_h, step_deg_h
from rlgcomp.diagnosis.question.regimes import AT_REST
from rlgcomp.diagnosis.question.windows import Windows
from rlgcomp.errors import InputError
from rlgcomp.physics.mechanism import Mechanism
from rlgcomp.physics.rotation_harmonics import highest_order
from rlgcomp.recording.motion import angle_deg, rate_deg_s, sampling_candidates
from rlgcomp.units import DEG_PER_TURN, RAD_PER_DEG

Array = npt.NDArray[np.float64]
_FEWEST: Final = 4  # rows in a window, for anything to be seen within it
_NEIGHBOURS: Final = 256  # on either side of a line
_MEDIAN_ODDS: Final = math.log(2.0)  # median of an exponential variable of mean one
_MEDIAN_COST: Final = 2.08  # a median of M is as uncertain as a mean of M / 2.08
_CERTAIN: Final = 1e-3  # p-value below which a line is taken up by the search for causes
_ORDERS: Final = 8  # searched, for their median to be a level
_ABOUT: Final = 10  # on either side of an order, that this is the median of


@dataclasses.dataclass(frozen=True)
class Line:
    """A line at one frequency.

    Parameters
    ----------
    run : int
    frequency_hz : float
    variance_deg_h2 : float
        Half the square of its amplitude.
    p_value : float
        Corrected for all frequencies and runs.
    """

    run: int
    frequency_hz: float
    variance_deg_h2: float
    p_value: float


@dataclasses.dataclass(frozen=True)
class Within:
    """What is left of each run's gyro within its windows, once the simulator's free part is fitted to it.

    Parameters
    ----------
    windows : tuple of Windows
    left_deg_h : tuple of ndarray
        Deviations from window means, one array a run.
    design : ndarray, shape (rows, k)
        Orthonormal: what the free part can take up.
    steps_deg_h : tuple of float
        In which the gyro of each run moves, where it is read in whole pulses.
    """

    windows: tuple[Windows, ...]
    left_deg_h: tuple[Array, ...]
    design: Array
    steps_deg_h: tuple[float, ...]

    @classmethod
    def of(cls, problem: Problem) -> Self | None:
        """None where windows hold too few rows."""
        if min(int(part.counts[part.kept].min()) for part in problem.windows) < _FEWEST:
            return None
        used = {name for name, _ in problem.baseline_names}
        free = [mechanism for mechanism in problem.simulator.mechanisms if mechanism.name in used]
        blocks = [np.concatenate([part.within(mechanism.basis(part.full)) for part in problem.windows]) for mechanism in free]
        design = np.column_stack(blocks) if blocks else np.empty((sum(int(p.counts[p.kept].sum()) for p in problem.windows), 0))
        size = np.sqrt((design**2).sum(axis=0))
        u, w, _ = np.linalg.svd(design[:, size > 0.0] / size[size > 0.0], full_matrices=False)
        steps = tuple(step_deg_h(part.full.rate_deg_h(problem.channel)) for part in problem.windows)
        bare = cls(problem.windows, (), u[:, w > 1e-6 * w.max(initial=0.0)], steps)
        return dataclasses.replace(bare, left_deg_h=bare.free(problem.unexplained_deg_h))

    def free(self, values: Sequence[Array]) -> tuple[Array, ...]:
        """Deviations from window means, in each run, that the simulator's free part does not take up."""
        deviations = [part.within(rows) for part, rows in zip(self.windows, values, strict=True)]
        whole = np.concatenate(deviations)
        whole = whole - self.design @ (self.design.T @ whole)
        return tuple(np.split(whole, np.cumsum([len(rows) for rows in deviations])[:-1]))

    @property
    def variance_deg_h2(self) -> float:
        """Of the full-rate noise."""
        rows = sum(len(values) for values in self.left_deg_h)
        lost = sum(int(part.kept.sum()) for part in self.windows)
        return float(sum((values**2).sum() for values in self.left_deg_h)) / max(1, rows - lost)

    def without(self, pieces: Sequence[Array]) -> Self:
        """The same less something known, one array a run."""
        return dataclasses.replace(self, left_deg_h=tuple(a - b for a, b in zip(self.left_deg_h, pieces, strict=True)))

    def lines(self, known_hz: Sequence[float] = ()) -> list[Line]:
        """The strongest line of each run above the windows' highest frequency, rounding to whole pulses left out.

        Parameters
        ----------
        known_hz : sequence of float
            Frequencies at which the noise itself has a line.
        """
        found = []
        for k, (part, values) in enumerate(zip(self.windows, self.left_deg_h, strict=True)):
            period_s = part.full.period_s
            since = part.rows_within(part.full.time_s)
            grid = np.rint((since - since[0]) / period_s).astype(np.intp)
            even = np.zeros(int(grid[-1]) + 1)
            even[grid] = values
            power = np.abs(np.fft.rfft(even)) ** 2
            frequency_hz = np.asarray(np.fft.rfftfreq(len(even), period_s), dtype=np.float64)
            inside = frequency_hz > 0.5 / part.window_s
            for known in known_hz:
                inside &= np.abs(frequency_hz - known) > 2.0 / (len(even) * period_s)
            inside[-1] = False
            if inside.sum() < _NEIGHBOURS:
                continue
            ratio, many = _prominence(power[inside])
            if self.steps_deg_h[k]:
                amplitude = 2.0 * np.sqrt(power[inside]) / len(values)
                ratio = ratio * (amplitude > beat_deg_h(self.steps_deg_h[k], frequency_hz, period_s)[inside])
            best = int(np.argmax(ratio))
            alone = (1.0 + ratio[best] / many) ** -many
            p_value = min(1.0, float(alone) * int(inside.sum()) * len(self.windows))
            variance = 2.0 * float(power[inside][best]) / len(values) ** 2
            found.append(Line(k, float(frequency_hz[inside][best]), variance, p_value))
        return sorted(found, key=lambda line: line.p_value)


def mechanisms_at_lines(
    problem: Problem, within: Within | None, catalogue: Mapping[str, type[Mechanism]]
) -> tuple[list[Mechanism], float]:
    """Mechanisms that could make the lines within windows, and among how many frequencies these were sought."""
    if within is None or problem.simulator.kind != "chamber":
        return [], 1.0
    noise = problem.simulator.noise
    known = () if noise is None or not noise.dither_residual_arcsec else (noise.dither_residual_frequency_hz,)
    found = [line for line in within.lines(known) if line.p_value < _CERTAIN][:1]
    longest_s = max(part.full.duration_s for part in problem.windows)
    rows = max(len(part.full) for part in problem.windows)
    kinds = [kind for kind in catalogue.values() if kind.is_candidate(problem.simulator.kind)]
    return [m for line in found for kind in kinds for m in kind.at_line(line.frequency_hz, 1.0 / longest_s)], float(rows)


@dataclasses.dataclass(frozen=True)
class Harmonic:
    """Columns of one order of the angle, one entry a run.

    Parameters
    ----------
    order : int
    means, within : tuple of ndarray, shape (n, 2)
        In windows and within them, where it is sampled twice a cycle.
    whole : Harmonic, optional
        The same with what sampling folds down; None where it folds nothing.
    """

    order: int
    means: tuple[Array, ...]
    within: tuple[Array, ...]
    whole: Harmonic | None = None


def harmonics(problem: Problem, within: Within) -> list[Harmonic]:
    """The orders that the sampling shows, equally large at every rate and growing with it; none where the angle is not known.

    Each is sought where its frequency is below half the sampling rate, and taken out where it is not as well.
    """
    if problem.simulator.kind != "turntable":
        return []
    try:
        turns = [_turn(part) for part in problem.windows]
        orders = range(1, highest_order(problem.runs) + 1)
    except InputError:
        return []
    powers = [np.ones_like(turn) for turn, _, _ in turns]
    found = []
    for order in orders:
        powers = [power * turn for power, (turn, _, _) in zip(powers, turns, strict=True)]
        for taken in sampling_candidates(problem.runs, order):
            seen = [_seen(power, order * moved, taken) for power, (_, moved, _) in zip(powers, turns, strict=True)]
            if order > 1:
                moving = [_moving(part, order * moved, rate) for part, (_, moved, rate) in zip(problem.windows, turns, strict=True)]
                seen = [np.where(inside[:, None], s, 0.0) for s, inside in zip(seen, moving, strict=True)]
            sampled = [order * np.abs(moved) < 0.5 * DEG_PER_TURN for _, moved, _ in turns]
            for weighted in (False, True):
                columns = [s * (rate[:, None] if weighted else 1.0) for s, (_, _, rate) in zip(seen, turns, strict=True)]
                whole = _columns(problem, within, order, columns)
                if all(part.all() for part in sampled):
                    found.append(whole)
                    continue
                plain = [np.where(inside[:, None], c, 0.0) for c, inside in zip(columns, sampled, strict=True)]
                found.append(dataclasses.replace(_columns(problem, within, order, plain), whole=whole))
    return found


def _columns(problem: Problem, within: Within, order: int, columns: list[Array]) -> Harmonic:
    means = tuple(part.means(c) for part, c in zip(problem.windows, columns, strict=True))
    return Harmonic(order, means, within.free(columns))


def _turn(part: Windows) -> tuple[npt.NDArray[np.complex128], Array, Array]:
    """The angle as a number on the unit circle, what was turned within each sample, and the rate relative to the highest."""
    angle, rate = angle_deg(part.full), rate_deg_s(part.full)
    moved = np.diff(angle, prepend=2.0 * angle[0] - angle[1])
    return np.exp(1j * RAD_PER_DEG * angle), moved, rate / max(float(np.abs(rate).max()), 1e-12)


def _seen(turn: npt.NDArray[np.complex128], moved_deg: Array, taken: str) -> Array:
    """Cosine and sine, as a mean over the sample or at its end."""
    value = turn
    if taken == "before":
        value = turn * np.exp(-0.5j * RAD_PER_DEG * moved_deg) * np.sinc(moved_deg / DEG_PER_TURN)
    return np.column_stack([value.real, value.imag])


def _moving(part: Windows, moved_deg: Array, rate: Array) -> npt.NDArray[np.bool_]:
    """Where a harmonic is no constant: a table at rest, or one sampled at whole cycles, shows an offset that anything may cause."""
    apparent = np.abs(np.remainder(moved_deg + 0.5 * DEG_PER_TURN, DEG_PER_TURN) - 0.5 * DEG_PER_TURN)
    sampled = np.abs(moved_deg) < 0.5 * DEG_PER_TURN
    return np.asarray(np.where(sampled, np.abs(rate) > AT_REST, apparent * part.window_s > DEG_PER_TURN * part.full.period_s))


def levels(gains: Array) -> Array:
    """What gains of many orders are in units of their expected size where most of them are noise, each by those about it: errors of
    an encoder's angle make the rate the noisier, the higher the order."""
    if len(gains) < _ORDERS:
        return np.ones(len(gains))
    about = [gains[max(0, k - _ABOUT) : k + _ABOUT + 1] for k in range(len(gains))]
    return np.array([float(np.median(some)) for some in about]) / (2.0 * _MEDIAN_ODDS)


def _prominence(power: Array) -> tuple[Array, float]:
    """Power over the local level, and how many powers that level is worth."""
    width = min(_NEIGHBOURS, (len(power) - 1) // 2)
    centres = np.arange(0, len(power), max(1, width // 4))
    medians = [float(np.median(power[max(0, c - width) : c + width + 1])) for c in centres]
    local = np.interp(np.arange(len(power)), centres, medians) / _MEDIAN_ODDS
    return power / np.maximum(local, np.finfo(np.float64).tiny), width / _MEDIAN_COST
