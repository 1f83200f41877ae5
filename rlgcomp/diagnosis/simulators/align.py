r"""The clock of a simulation against that of a recording: offset and drift, from a column that both have.

A column r(t) of the recording is compared with the simulation's s(t) in the model

.. math:: r(t) = a + b\, s(t - \delta - \epsilon\,(t - t_0)) + \text{nuisance} + e(t),

e being first-order autoregressive; delta and epsilon follow from Gauss–Newton steps of generalised least squares at window means.
Monitors tell best, because both files hold the same quantity. Where they share none the gyro must serve, and there slow physics
that the simulation lacks (a rate term, a lag, hysteresis) looks like a late clock: what one run says is known only as well as it is
the same beside such nuisance columns, and nothing is taken out. On a turning table no physics moves as the gyro does: it tells the
time itself.

References
----------
D. Cochrane, G. H. Orcutt, J. Am. Stat. Assoc. 44, 32 (1949) (autoregressive residuals).
D. Mills et al., Network Time Protocol Version 4, RFC 5905 (2010), appendix A.1.1 (frequency tolerance of clocks).
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from typing import Final

import numpy as np
import numpy.typing as npt
from scipy import special

from rlgcomp.diagnosis.simulators.resampling import (
    DRIFT_SEEN,
    GAP,
    MAD,
    UNKNOWN,
    Alignment,
    clear,
    doubts,
    gaps,
    means_in,
    same_axis,
    values_at,
)
from rlgcomp.numerics.filters import lag, rate_per_min
from rlgcomp.numerics.hysteresis import Play
from rlgcomp.numerics.robust import LEAST_P_VALUE
from rlgcomp.recording import TIME, Recording, is_gyro
from rlgcomp.report.messages import Message, message
from rlgcomp.units import PPM, is_thermometer

Array = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]
SIGNIFICANT: Final = 0.01
_WINDOWS: Final = 2000  # that a run is compared in, at most
_TRIALS: Final = 81  # offsets that are tried before the steps
_STEPS: Final = 20
_PLAIN_STEPS: Final = 6
_SETTLED: Final = 0.02  # standard deviations: a step so small is the last
_LIKE: Final = 0.95  # share of a monitor's variance that the simulation's must explain to be the same quantity
_TURNS: Final = 0.99  # the same of a gyro that turns with its table
_LEAST_OVERLAP: Final = 0.8
_FARTHEST: Final = 0.1  # of the run, how far the clocks may be apart
_WELL_TOLD: Final = 0.02  # of a period: a clock known so well needs no other column
CLOCK_DRIFT: Final = 300.0 * PPM  # usual between two clocks, at most
_ANY_CLOCK_PPM: Final = 500.0  # no computer's or logger's clock is off by more (MAXFREQ in RFC 5905)
_LAGS_S: Final = (300.0, 1200.0, 4800.0)
_RADII_OF_SPAN: Final = (0.02, 0.06, 0.2)


@dataclasses.dataclass(frozen=True)
class _Clock:
    offset_s: float
    offset_sd_s: float
    drift: float
    drift_sd: float
    p_value: float
    explained: float  # share of the recording's variance


@dataclasses.dataclass(frozen=True)
class _Settled:
    clock: _Clock
    left: Array  # white noise of the windows that told it; NaN of the others


_UNTOLD: Final = _Clock(0.0, math.inf, 0.0, math.inf, 1.0, 0.0)
_UNSETTLED: Final = _Settled(_UNTOLD, np.zeros(0))


def clock_of(recording: Recording, simulated: Recording, *, gyro: str | None = None) -> Alignment:
    """How the simulation's clock stands, to be taken out where it differs beyond doubt (p < 0.01).

    Parameters
    ----------
    recording, simulated : Recording
        Of one run, of any sampling and epoch.
    gyro : str, optional
        Gyro column of the recording, where there are several; the simulation has one, or one of the same axis.

    Raises
    ------
    InputError
        Its gyro cannot be told.
    """
    rate = simulated.rate_deg_h(same_axis(recording.gyro_column(gyro), simulated))
    epoch_s = _epoch(recording, simulated)
    column, clock, certain = _clock(recording, simulated, rate, epoch_s, gyro)
    return Alignment(
        run=recording.name,
        offset_s=clock.offset_s,
        offset_sd_s=clock.offset_sd_s,
        drift_ppm=clock.drift / PPM,
        drift_ppm_sd=clock.drift_sd / PPM,
        p_value=clock.p_value,
        compared=column,
        epoch_s=epoch_s,
        taken_out=certain and clock.p_value < SIGNIFICANT,
    )


def no_clocks(alignments: Sequence[Alignment]) -> Message | None:
    """The message that time offsets which would be taken out cannot be a clock's: one is larger than any clock's drift."""
    shifts = sorted((one for one in alignments if one.taken_out), key=lambda one: one.drift_ppm)
    if not any(abs(one.drift_ppm) - DRIFT_SEEN * one.drift_ppm_sd > _ANY_CLOCK_PPM for one in shifts):
        return None
    return message(
        "diagnosis.no_clock",
        columns=sorted({one.compared for one in shifts}),
        drifts_ppm={one.run: one.drift_ppm for one in shifts},
        sds_ppm={one.run: one.drift_ppm_sd for one in shifts},
        limit_ppm=_ANY_CLOCK_PPM,
    )


def _clock(recording: Recording, simulated: Recording, rate: Array, epoch_s: float, gyro: str | None) -> tuple[str, _Clock, bool]:
    """The column that tells time well, what it tells, and whether nothing but another clock can explain it."""
    grid = _Grid.of(recording, simulated, epoch_s)
    shared = [column for column in recording.columns if column in simulated and column != TIME and not is_gyro(column)]
    candidates = []
    for column in shared:
        clock = grid.compare(recording.column(column), simulated.column(column))
        if clock.explained > _LIKE and math.isfinite(clock.offset_sd_s):
            candidates.append((column, clock))
            if clock.offset_sd_s < _WELL_TOLD * recording.period_s:
                break
    if candidates:
        return *min(candidates, key=lambda pair: pair[1].offset_sd_s), True
    measured = recording.rate_deg_h(gyro)
    clock = grid.compare(measured, rate)
    if recording.metadata.kind == "turntable" and clock.explained > _TURNS and math.isfinite(clock.offset_sd_s):
        same_rows = epoch_s == 0.0 and np.array_equal(recording.time_s, simulated.time_s)  # made from this run, on its clock
        return recording.gyro_column(gyro), clock, not same_rows or abs(clock.offset_s) > recording.period_s
    return recording.gyro_column(gyro), _doubted(grid.compare(measured, rate, _slow_physics(recording)), clock), False


def _doubted(clock: _Clock, plain: _Clock) -> _Clock:
    """A clock whose standard deviations and p-value hold what slow physics changes of it, for it may be there or not."""
    offset_sd_s = math.hypot(clock.offset_sd_s, clock.offset_s - plain.offset_s)
    drift_sd = math.hypot(clock.drift_sd, clock.drift - plain.drift)
    furthest = max(abs(clock.offset_s) / offset_sd_s, abs(clock.drift) / drift_sd) if offset_sd_s > 0.0 < drift_sd else math.inf
    either = min(1.0, 2.0 * math.erfc(furthest / math.sqrt(2.0)))
    return dataclasses.replace(clock, offset_sd_s=offset_sd_s, drift_sd=drift_sd, p_value=max(clock.p_value, either))


@dataclasses.dataclass(frozen=True)
class _Grid:
    """Windows in which a run and its simulation are compared."""

    time_s: Array  # of the recording
    simulated_s: Array  # of the simulation, its epoch moved to the recording's
    edges_s: Array
    recorded: Flags  # windows that no gap of the recording reaches
    gaps_s: Array  # of the simulation, (n, 2): where each begins and ends

    @classmethod
    def of(cls, recording: Recording, simulated: Recording, epoch_s: float) -> _Grid:
        time_s, simulated_s = recording.time_s, simulated.time_s + epoch_s
        rows = max(recording.duration_s / _WINDOWS, 3.0 * recording.period_s, simulated.period_s) / recording.period_s
        window_s = recording.period_s * math.ceil(rows - 1e-6)  # of whole rows, whose means are the recording's own
        count = max(2, math.floor((time_s[-1] - time_s[0]) / window_s))
        edges_s = time_s[0] - 0.5 * recording.period_s + window_s * np.arange(count + 1)
        recorded = clear(edges_s[:-1], edges_s[1:], gaps(time_s, window_s))
        return cls(time_s, simulated_s, edges_s, recorded, gaps(simulated_s, max(window_s, GAP * simulated.period_s)))

    def compare(self, recorded: Array, simulated: Array, nuisance: Sequence[Array] = ()) -> _Clock:
        """Offset and drift between a column of the recording and the simulation's."""
        target, fixed = self.means(recorded, nuisance)
        if np.ptp(simulated) == 0.0 or np.ptp(target) == 0.0:
            return _UNTOLD
        span_s = self.edges_s[-1] - self.edges_s[0]
        trials_s = span_s * _FARTHEST * np.linspace(-1.0, 1.0, _TRIALS)
        misfits = [self._misfit(target, fixed, simulated, trial) for trial in trials_s]
        here = self.settle(target, fixed, simulated, 0.0)
        there = self.settle(target, fixed, simulated, float(trials_s[int(np.argmin(misfits))]))
        searched = dataclasses.replace(there.clock, p_value=min(1.0, _TRIALS * there.clock.p_value))
        found = searched if _clearly_better(there, here) and searched.p_value < SIGNIFICANT else here.clock
        calm = self._without_corners(target, fixed, simulated, found)
        if calm is None:
            return found
        refined = calm.settle(*calm.means(recorded, nuisance), simulated, found.offset_s, found.drift).clock
        return dataclasses.replace(refined, p_value=found.p_value) if math.isfinite(refined.offset_sd_s) else found

    def means(self, recorded: Array, nuisance: Sequence[Array]) -> tuple[Array, Array]:
        """Window means of a column, and of a constant and nuisance columns."""
        target, *others = (means_in(self.time_s, column, self.edges_s)[0] for column in (recorded, *nuisance))
        return target, np.column_stack([np.ones(len(target)), *others])

    def _without_corners(self, target: Array, fixed: Array, simulated: Array, clock: _Clock) -> _Grid | None:
        """The same, no window beginning or ending near a corner of a table's rate, where a simulation's samples do not tell how far
        the table has turned; None where they tell everywhere, or hardly anywhere."""
        if not math.isfinite(clock.offset_sd_s):
            return None
        shown, _, inside = self._shifted(simulated, clock.offset_s, clock.drift)
        left = np.diff((target - _fit(np.column_stack([fixed, shown]), target, inside))[inside])
        noise = float(np.median(np.abs(left))) / (MAD * math.sqrt(2.0))
        edges_s = self._moved(clock.offset_s, clock.drift)
        doubt = doubts(self.simulated_s, simulated, edges_s, edges_s) * float(np.median(np.diff(self.simulated_s)))
        sure = doubt <= UNKNOWN * noise * float(np.median(np.diff(self.edges_s)))
        if sure.all() or 2 * sure.sum() < len(sure):
            return None
        kept = np.flatnonzero(sure)
        recorded = np.logical_and.reduceat(self.recorded[: kept[-1]], kept[:-1])
        return dataclasses.replace(self, edges_s=self.edges_s[kept], recorded=recorded)

    def _misfit(self, target: Array, fixed: Array, simulated: Array, offset_s: float) -> float:
        edges_s = self._moved(offset_s, 0.0)
        inside = self._inside(edges_s)
        shown, _ = means_in(self.simulated_s, simulated, edges_s)
        design = np.column_stack([fixed, shown])[inside]
        if len(design) <= design.shape[1]:
            return math.inf
        left = target[inside] - _projected(design, target[inside])
        return float(left @ left) / max(1, int(inside.sum()))

    def settle(self, target: Array, fixed: Array, simulated: Array, offset_s: float, drift: float = 0.0) -> _Settled:
        """Gauss–Newton steps of generalised least squares; drifts beyond what clocks do are held back by a prior."""
        along_s, weights = 0.5 * (self.edges_s[1:] + self.edges_s[:-1]) - self.time_s[0], self._weights
        target, fixed = weights * target, weights[:, None] * fixed
        limit_s = _FARTHEST * along_s[-1]
        least = (1e-9 * float(np.std(target))) ** 2
        for step in range(_STEPS):
            shown, slope, inside = self._shifted(simulated, offset_s, drift)
            design = np.column_stack([fixed, weights * shown, -weights * slope, -weights * slope * along_s])[inside]
            if len(design) <= design.shape[1]:
                return _UNSETTLED
            rest = target[inside] - _projected(design[:, :-2], target[inside])
            keep = _autocorrelation(rest) if step >= _PLAIN_STEPS else 0.0  # far from the minimum what is left is no noise yet
            white, aim = _quasi_difference(design, keep), _quasi_difference(target[inside], keep)
            gain = float(_solved(white[:, :-2], aim)[-1])
            freedom = max(1, len(aim) - white.shape[1])
            variance = max(float(np.sum((aim - _projected(white, aim)) ** 2)) / freedom, least)
            if gain == 0.0 or np.linalg.matrix_rank(white / _norms(white)) < white.shape[1]:
                return _UNSETTLED
            held = np.zeros(white.shape[1])
            held[-1] = math.sqrt(variance) / (gain * CLOCK_DRIFT)
            white, aim = np.vstack([white, held]), np.r_[aim, -drift * gain * held[-1]]
            change_s, change = _solved(white, aim)[-2:] / gain
            offset_s = float(np.clip(offset_s + change_s, -limit_s, limit_s))
            drift += float(change)
            sd = _sds(white, aim - _projected(white, aim), variance)[-2:] / abs(gain)
            if step > _PLAIN_STEPS and abs(change_s) < _SETTLED * sd[0] and abs(change) < _SETTLED * sd[1]:
                break
        if abs(offset_s) >= limit_s:
            return _UNSETTLED
        still, _, there = self._shifted(simulated, 0.0, 0.0)
        unmoved = _quasi_difference(np.column_stack([fixed, weights * still])[inside & there], keep)
        its_aim = _quasi_difference(target[inside & there], keep)
        worse = float(np.sum((its_aim - _projected(unmoved, its_aim)) ** 2)) * (len(aim) - 1) / max(1, len(its_aim))
        f_statistic = max(0.0, 0.5 * (worse - freedom * variance) / variance)
        spread = target[inside] - _projected(fixed[inside], target[inside])
        explained = 1.0 - float(rest @ rest) / max(float(spread @ spread), least)
        p_value = max(float(special.fdtrc(2, freedom, f_statistic)), LEAST_P_VALUE)
        left = np.full(len(target), np.nan)
        left[inside] = (aim - _projected(white, aim))[:-1]
        return _Settled(_Clock(offset_s, float(sd[0]), drift, float(sd[1]), p_value, explained), left)

    @property
    def _weights(self) -> Array:
        """Of windows, for their white noise."""
        widths_s = np.diff(self.edges_s)
        return np.asarray(np.sqrt(widths_s / np.median(widths_s)))

    def _moved(self, offset_s: float, drift: float) -> Array:
        """Where windows begin and end by the simulation's clock."""
        return self.edges_s - offset_s - drift * (self.edges_s - self.time_s[0])

    def _shifted(self, simulated: Array, offset_s: float, drift: float) -> tuple[Array, Array, Flags]:
        """Window means of the simulation at shifted times, their derivative, and which windows both files cover."""
        edges_s = self._moved(offset_s, drift)
        slope = np.diff(values_at(self.simulated_s, simulated, edges_s)[0]) / np.diff(edges_s)
        return means_in(self.simulated_s, simulated, edges_s)[0], slope, self._inside(edges_s)

    def _inside(self, edges_s: Array) -> Flags:
        """Windows that both files cover, of edges by the simulation's clock."""
        covered = (edges_s[:-1] >= self.simulated_s[0]) & (edges_s[1:] <= self.simulated_s[-1])
        return np.asarray(covered & self.recorded & clear(edges_s[:-1], edges_s[1:], self.gaps_s))


def _clearly_better(there: _Settled, here: _Settled) -> bool:
    """Whether a clock that was searched for leaves less than one near by, by more than noise does in windows that tell of both: by
    whole swings of a table clocks are alike."""
    if not (len(there.left) and len(here.left)):
        return len(there.left) > 0
    both = np.isfinite(there.left) & np.isfinite(here.left)
    far, near = (max(float(np.sum(one.left[both] ** 2)), np.finfo(float).tiny) for one in (there, here))
    return int(both.sum()) * math.log(near / far) > 2.0 * math.log(_TRIALS / SIGNIFICANT)


def _slow_physics(recording: Recording) -> list[Array]:
    """What a simulation may lack that looks like a late clock."""
    columns = []
    for name in recording.columns:
        if is_thermometer(name):
            values, time_s = recording.column(name), recording.time_s
            if np.ptp(values) == 0.0:
                continue
            warmth = (values - values.mean()) / values.std()
            rate = rate_per_min(values, time_s)
            play = Play(tuple(share * float(np.ptp(values)) for share in _RADII_OF_SPAN))
            states, _ = play.run(play.init(values[0]), values)
            columns += [warmth, warmth**2, warmth**3, rate, np.abs(rate), *(states - values[:, None]).T]
            columns += [lag(values, time_s, time_constant_s) - values for time_constant_s in _LAGS_S]
    return columns


def _epoch(recording: Recording, simulated: Recording) -> float:
    """What to add to the simulation's time: 0 where both count from one epoch, otherwise their starts are put together; that of the
    rows that count, where no more was simulated."""
    begin, last = recording.time_s[[0, -1]]
    first = recording.time_s[recording.scored][0]
    overlap_s = min(last, simulated.time_s[-1]) - max(first, simulated.time_s[0])
    if overlap_s >= _LEAST_OVERLAP * (last - first):
        return 0.0
    start = begin if simulated.duration_s >= _LEAST_OVERLAP * (last - begin) else first
    return float(start - simulated.time_s[0])


def _autocorrelation(left: Array) -> float:
    power = float(left @ left)
    return float(np.clip(left[1:] @ left[:-1] / power, 0.0, 0.999)) if power > 0.0 else 0.0


def _quasi_difference(rows: Array, keep: float) -> Array:
    return np.concatenate([math.sqrt(1.0 - keep**2) * rows[:1], rows[1:] - keep * rows[:-1]])


def _sds(white: Array, left: Array, variance: float) -> Array:
    """Standard deviations of weights, larger where the rows that tell most are left with more than their noise: missing physics."""
    scale = _norms(white)
    inverse = np.linalg.inv((white / scale).T @ (white / scale))
    of_rows = white / scale @ inverse * left[:, None]
    return np.asarray(np.sqrt(np.maximum(variance * np.diag(inverse), np.sum(of_rows**2, axis=0))) / scale)


def _solved(design: Array, target: Array) -> Array:
    scale = _norms(design)
    return np.asarray(np.linalg.lstsq(design / scale, target, rcond=1e-10)[0] / scale)


def _fit(design: Array, target: Array, rows: Flags) -> Array:
    return np.asarray(design @ _solved(design[rows], target[rows]))


def _projected(design: Array, target: Array) -> Array:
    return np.asarray(design @ _solved(design, target))


def _norms(columns: Array) -> Array:
    """Length of each column, one for a column of zeros: to scale a design by."""
    lengths = np.sqrt((columns**2).sum(axis=0))
    return np.asarray(np.where(lengths > 0.0, lengths, 1.0))
