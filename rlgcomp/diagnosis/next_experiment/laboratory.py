r"""What a laboratory's monitors would read in a run that has not been made, learnt from the runs there are.

Rivals are told apart by what their monitors do, and how a block follows its shell is a matter of this gyro in this chamber: where
the one is exactly a lag of the other, no programme tells the gradient between them from the block's rate. The temperature that
leads all others is taken to follow the chamber; the others answer it as a sum of lags,

.. math:: T_j = c_j + \sum_k w_{jk} \, L_{\tau_k} T_1, \qquad w_{jk} \ge 0, \qquad \tau_k \dot{(L T)} = T - L T,

with self-heating since the start of the run added. Every other monitor is a function of a few of: that temperature, its lags, the
rates of all temperatures, the clock, and the monitors before it; of its means over ten minutes,

.. math:: x = c_{run} + Z_S b + e, \qquad b \sim N(0, \lambda \sigma^2 I), \qquad e \sim \text{white noise of variance } \sigma^2
    \text{ and a random walk},

Z being scaled to one. The weights b are averaged over all small sets S, over :math:`\lambda` and over walks, by their evidence:
what walks at random looks for one run like much that moves as slowly, and would be foreseen far from where it was ever recorded.
What these leave of a monitor in the longest run is kept: what wandered together there wanders together again.

References
----------
J. A. Hoeting et al., "Bayesian model averaging: a tutorial", Statist. Sci. 14, 382 (1999).
L. Ljung, *System Identification: Theory for the User*, 2nd ed., Prentice Hall, 1999, ch. 10 (linear regression on filtered inputs).
"""

from __future__ import annotations

import dataclasses
import functools
import itertools
import math
from collections.abc import Collection, Mapping, Sequence
from typing import Final, NamedTuple, Self

import numpy as np
import numpy.typing as npt
import pandas as pd
from scipy import linalg, optimize

from rlgcomp.errors import InputError
from rlgcomp.numerics.filters import lag, rate_per_min
from rlgcomp.physics.ageing import Ageing
from rlgcomp.physics.mechanism import TABLE_ANGLE, TABLE_RATE, TEMPERATURE
from rlgcomp.recording import TIME, Metadata, Recording
from rlgcomp.recording.motion import RATE
from rlgcomp.simulation.monitors import NOMINAL_DEG_C
from rlgcomp.simulation.plant import ThermalPlant
from rlgcomp.simulation.programme import Programme, sample_count
from rlgcomp.simulation.table_programme import TableProgramme
from rlgcomp.simulation.turntable import Turntable
from rlgcomp.units import SECONDS_PER_HOUR, is_thermometer

Array = npt.NDArray[np.float64]
_LAGS_S: Final = np.geomspace(50.0, 15_000.0, 16)
_WARM_K: Final = 30.0
_WARMING_S: Final = (900.0, 3600.0)  # self-heating since the start of a run
_MONITOR_LAGS_S: Final = (1800.0, 7200.0)
_MEAN_S: Final = 600.0  # of monitors, when it is asked what they follow
_WALKS: Final = (0.0, *np.geomspace(0.1, 1000.0, 9))  # standard deviation gathered in an hour, over that of the white noise
_LARGEST: Final = 4  # quantities that a monitor follows at once
_VARIANCES: Final = np.geomspace(1e-2, 1e8, 6)  # of a weight, over that of the white noise of a mean
_EXACTLY: Final = 1e-12  # of a square: rounding
_OF_THE_TABLE: Final = frozenset((RATE, "table_angle_deg", TABLE_RATE, TABLE_ANGLE, TEMPERATURE))  # what it tells of itself


@dataclasses.dataclass(frozen=True)
class Laboratory:
    """How monitors answer the temperature that leads, and what else they do.

    Parameters
    ----------
    lead : str
        The temperature column that others follow.
    followers : mapping of str to ndarray
        Weights of each other temperature's answer.
    others : mapping of str to (ndarray, ndarray)
        Of each other monitor, weights of what it follows and what these leave of it in the longest run, row by row.
    since_s : ndarray
        Times of these rows, from the first on.
    clock : Ageing
        Says whether time is counted from each start or runs on from one run to the next.
    begins_s : float
        When the next run begins, by that clock.
    """

    lead: str
    followers: Mapping[str, Array]
    others: Mapping[str, tuple[Array, Array]]
    since_s: Array
    clock: Ageing
    begins_s: float

    @classmethod
    def of(cls, runs: Sequence[Recording]) -> Self:
        """Learn from runs, sampled coarsely enough to be quick; the lead is the temperature from which the others follow best.

        Raises
        ------
        InputError
            No thermometer is in all of them.
        """
        shared = [name for name in runs[0].columns if all(name in run for run in runs)]
        temperatures = [name for name in shared if is_thermometer(name)]
        if not temperatures:
            raise InputError(f"{', '.join(run.name for run in runs)} have no thermometer in common; record one in all of them")
        answers = {lead: {name: _answer(runs, lead, name) for name in temperatures if name != lead} for lead in temperatures}
        lead = min(temperatures, key=lambda name: sum(missed for _, missed in answers[name].values()))
        clock = Ageing.grid(runs)[-1]
        ends_s = max(float(run.time_s[-1]) + run.period_s for run in runs)
        followers = {name: weights for name, (weights, _) in answers[lead].items()}
        longest = max(runs, key=len)
        since_s = longest.time_s - longest.time_s[0]
        found = cls(lead, followers, {}, since_s, clock, ends_s if clock.since == "clock" else 0.0)
        learnt, own = np.concatenate([found._followed(run) for run in runs]), found._followed(longest)
        starts, means = _means_of(runs)
        others = {}
        for name in shared:
            if name not in (TIME, *temperatures, *runs[0].gyro_columns):
                target, its_own = np.concatenate([run.column(name) for run in runs]), longest.column(name)
                weights = _weights(learnt, target, starts, means)
                others[name] = weights, its_own - own @ weights
                learnt, own = np.column_stack([learnt, target]), np.column_stack([own, its_own])
        return dataclasses.replace(found, others=others)

    def run_of(self, programme: Programme, plant: ThermalPlant, step_s: float) -> Recording:
        """The monitors in a run of a programme, its gyro zero; by the plant the temperature that leads follows the chamber."""
        since_s: Array = np.arange(sample_count(programme.duration_s, step_s), dtype=np.float64) * step_s
        shell_degC, block_degC = plant.temperatures(programme.set_point_degC(since_s), step_s)
        leading = shell_degC if self.followers else block_degC
        time_s = self.begins_s + since_s
        table = {TIME: time_s, "gyro_deg_h": np.zeros(len(time_s)), self.lead: leading} | self._following(leading, time_s)
        run = Recording(pd.DataFrame(table), Metadata(kind="chamber"), name="next")
        followed = self._followed(run)
        whole_s = float(self.since_s[-1])
        as_then_s = whole_s - np.abs(whole_s - since_s % (2.0 * whole_s))  # there and back
        monitors = {}
        for name, (weights, left) in self.others.items():
            monitors[name] = followed @ weights + np.interp(as_then_s, self.since_s, left)
            followed = np.column_stack([followed, monitors[name]])
        return run.replace(table=run.table.assign(**monitors))

    def _following(self, temperature_degC: Array, time_s: Array) -> dict[str, Array]:
        """The other temperatures, from the one that leads."""
        answering = np.column_stack([_lagged(temperature_degC, time_s), _since_start(time_s)])
        return {name: answering @ weights for name, weights in self.followers.items()}

    def _followed(self, run: Recording) -> Array:
        """What a monitor that is no thermometer may follow: a constant, the temperature that leads, its square, its lags; rates,
        with their sign and without; the clock."""
        leading, time_s = run.column(self.lead), run.time_s
        warm = (leading - NOMINAL_DEG_C) / _WARM_K
        lags = [lag(warm, time_s, lag_s) for lag_s in _MONITOR_LAGS_S]
        rates = [rate_per_min(one, time_s) for one in (leading, *self._following(leading, time_s).values())]
        either_way = [np.abs(rate) for rate in rates]
        return np.column_stack([np.ones(len(warm)), warm, warm**2, *lags, *rates, *either_way, self.clock.basis(run)])


def _answer(runs: Sequence[Recording], lead: str, name: str) -> tuple[Array, float]:
    """Weights of the lagged lead and of the time since the start, averaged over runs; and the share of a column that they miss."""
    target = [run.column(name) for run in runs]
    lagged = np.concatenate([_lagged(run.column(lead), run.time_s) for run in runs])
    own = linalg.block_diag(*(_since_start(run.time_s) for run in runs))
    basis = np.linalg.qr(own)[0]
    free, wanted = (block - basis @ (basis.T @ block) for block in (lagged, np.concatenate(target)))
    factor = np.asarray(np.linalg.qr(np.column_stack([free, wanted]), mode="r"))  # as many rows as columns: the rest is quick
    weights, missed = optimize.nnls(factor[:, :-1], factor[:, -1])
    starting = np.linalg.lstsq(own, np.concatenate(target) - lagged @ weights, rcond=1e-9)[0].reshape(len(runs), -1).mean(axis=0)
    return np.r_[weights, starting], float(missed**2 / max(wanted @ wanted, np.finfo(float).tiny))


class _Means(NamedTuple):
    """When means begin, and of which run each is."""

    time_s: Array
    run: npt.NDArray[np.intp]


def _means_of(runs: Sequence[Recording]) -> tuple[npt.NDArray[np.intp], _Means]:
    """The rows with which means over some minutes begin, and these means."""
    first, starts, run, times_s = 0, [], [], []
    for k, one in enumerate(runs):
        length = max(1, round(_MEAN_S / one.period_s))
        begins = np.arange(0, max(1, len(one) - length // 2), length)
        starts.append(first + begins)
        times_s.append(one.time_s[begins])
        run.append(np.full(len(begins), k))
        first += len(one)
    return np.concatenate(starts), _Means(np.concatenate(times_s), np.concatenate(run))


def _whitened(means: _Means, table: Array, walk: float) -> tuple[Array, float]:
    """Columns, shape (n, k), whitened for white noise of unit variance and a random walk, and the log determinant.

    The walk begins anew in each run and gathers a standard deviation of `walk` in an hour.
    """
    white, log_determinant = np.empty_like(table), 0.0
    level, variance = np.zeros(table.shape[1]), 0.0
    for k, row in enumerate(table):
        if k == 0 or means.run[k] != means.run[k - 1]:
            level, variance = np.zeros(table.shape[1]), 0.0
        else:
            variance += walk**2 * (means.time_s[k] - means.time_s[k - 1]) / SECONDS_PER_HOUR
        total = variance + 1.0
        white[k] = (row - level) / math.sqrt(total)
        log_determinant += math.log(total)
        level = level + variance / total * (row - level)
        variance /= total
    return white, log_determinant


def _weights(learnt: Array, target: Array, starts: npt.NDArray[np.intp], rows: _Means) -> Array:
    """Weights of what a monitor follows, the first of a constant: the mean of those that runs have of their own."""
    counts = np.diff(np.r_[starts, len(target)])
    means = np.add.reduceat(np.column_stack([learnt[:, 1:], target]), starts) / counts[:, None]
    means -= means.mean(axis=0)
    lengths = np.sqrt((means**2).sum(axis=0))
    sizes = np.where(lengths > 0.0, lengths, 1.0) / math.sqrt(len(means))
    level = (rows.run[:, None] == np.unique(rows.run)).astype(np.float64)
    evidence, which, found = [], [], []
    for walk in _WALKS:
        table, log_determinant = _whitened(rows, np.column_stack([level, means / sizes]), walk)
        own, factor = np.linalg.qr(table[:, : level.shape[1]])
        free = table[:, level.shape[1] :] - own @ (own.T @ table[:, level.shape[1] :])
        gram = free.T @ free
        least = max(_EXACTLY * float(gram[-1, -1]), np.finfo(np.float64).tiny)  # a monitor may never move
        constant = -0.5 * log_determinant - np.log(np.abs(np.diag(factor))).sum()
        for sets in _small_sets(len(sizes) - 1):
            shown, among = gram[sets, -1], gram[sets[:, :, None], sets[:, None, :]]
            for variance in _VARIANCES:
                scaled = np.eye(sets.shape[1]) + variance * among
                weights = variance * np.linalg.solve(scaled, shown[:, :, None])[:, :, 0]
                missed = np.maximum(gram[-1, -1] - (weights * shown).sum(axis=1), least)
                log_missed = 0.5 * (len(means) - level.shape[1]) * np.log(missed)
                evidence.append(constant - math.log(len(sets)) - 0.5 * np.linalg.slogdet(scaled)[1] - log_missed)
                which.append(sets)
                found.append(weights)
    shares = np.exp(np.concatenate(evidence) - max(each.max() for each in evidence))
    shares /= shares.sum()
    mean, place = np.zeros(len(sizes) - 1), 0
    for sets, weights in zip(which, found, strict=True):
        np.add.at(mean, sets, shares[place : place + len(sets), None] * weights)
        place += len(sets)
    mean *= sizes[-1] / sizes[:-1]
    return np.r_[float(np.mean(target - learnt[:, 1:] @ mean)), mean]


@functools.lru_cache(maxsize=32)
def _small_sets(count: int) -> tuple[npt.NDArray[np.intp], ...]:
    """All sets of so many quantities, none, one, two, … of them, shape (sets, members)."""
    return tuple(
        np.array([*itertools.combinations(range(count), members)], dtype=np.intp).reshape(math.comb(count, members), members)
        for members in range(min(_LARGEST, count) + 1)
    )


def _lagged(temperature_degC: Array, time_s: Array) -> Array:
    return np.column_stack([temperature_degC, *(lag(temperature_degC, time_s, lag_s) for lag_s in _LAGS_S)])


def _since_start(time_s: Array) -> Array:
    """A constant, and self-heating since the start of a run."""
    return np.exp(-np.divide.outer(time_s - time_s[0], np.array([math.inf, *_WARMING_S])))


@dataclasses.dataclass(frozen=True)
class RateTable:
    """What a table's monitors read in a run that has not been made.

    Parameters
    ----------
    like : Recording
        A recorded run: its sample period, latitude, columns and the name of its thermometer are kept.
    table : Turntable
    """

    like: Recording
    table: Turntable

    @classmethod
    def of(cls, runs: Sequence[Recording], read: Collection[str]) -> RateTable:
        """Learn from recorded runs, for sets that read some columns.

        Raises
        ------
        InputError
            A column that is read is none that a table tells.
        """
        like = max(runs, key=lambda run: run.duration_s)
        thermometer = thermometer_of(like)
        unknown = set(read) - _OF_THE_TABLE - {thermometer}
        if unknown or RATE not in like:
            raise InputError(f"{like.name}: what {', '.join(sorted(unknown)) or RATE} reads in another run is not known")
        temperature = like.column(thermometer) if thermometer else np.zeros(2)
        table = Turntable(
            latitude_deg=like.metadata.latitude_deg, room_drift_K=0.0, warm_up_K=max(float(temperature[-1] - temperature[0]), 0.0)
        )
        return cls(like, table)

    def run_of(self, programme: TableProgramme) -> Recording:
        """The run that a programme would be, its gyro zero."""
        _, recorded = self.table.simulate(programme, self.like.period_s, 0)
        names = {"temperature_block_degC": thermometer_of(self.like) or "temperature_block_degC"}
        frame = pd.DataFrame(recorded).rename(columns=names).assign(gyro_deg_h=0.0)
        kept = [column for column in frame.columns if column in self.like or column in ("time_s", "gyro_deg_h")]
        metadata = dataclasses.replace(self.like.metadata, lead_in_s=0.0)
        return Recording(frame[kept], metadata, name="next")


def thermometer_of(run: Recording) -> str | None:
    """The column that the catalogue means by temperature; None of a run without thermometers."""
    return run.temperature_column if any(is_thermometer(column) for column in run.columns) else None
