r"""What a laboratory's monitors would read in a run that has not been made, learnt from the runs there are.

Rivals are told apart by what their monitors do, and how a block follows its shell is a matter of this gyro in this chamber: where
the one is exactly a lag of the other, no programme tells the gradient between them from the block's rate. The temperature that
leads all others is taken to follow the chamber; the others answer it as a sum of lags,

.. math:: T_j = c_j + \sum_k w_{jk} \, L_{\tau_k} T_1, \qquad w_{jk} \ge 0, \qquad \tau_k \dot{(L T)} = T - L T,

with self-heating since the start of the run added. Every other monitor is a function of that temperature, its lags, the rates of
all temperatures and the clock, and keeps what these leave of it in the longest run: what wandered together there wanders together
again.

References
----------
L. Ljung, *System Identification: Theory for the User*, 2nd ed., Prentice Hall, 1999, ch. 10 (linear regression on filtered inputs).
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from typing import Final, Self

import numpy as np
import numpy.typing as npt
import pandas as pd
from scipy import linalg, optimize

from rlgcomp.errors import InputError
from rlgcomp.filters import lag, rate_per_min
from rlgcomp.physics.ageing import Ageing
from rlgcomp.recording import TIME, Metadata, Recording
from rlgcomp.simulation.monitors import NOMINAL_DEG_C
from rlgcomp.simulation.plant import ThermalPlant
from rlgcomp.simulation.programme import Programme, sample_count

Array = npt.NDArray[np.float64]
_LAGS_S: Final = np.geomspace(50.0, 15_000.0, 16)
_WARM_K: Final = 30.0
_WARMING_S: Final = (900.0, 3600.0)  # self-heating since the start of a run
_MONITOR_LAGS_S: Final = (1800.0, 7200.0)


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
    clock : Ageing
        Says whether time is counted from each start or runs on from one run to the next.
    begins_s : float
        When the next run begins, by that clock.
    """

    lead: str
    followers: Mapping[str, Array]
    others: Mapping[str, tuple[Array, Array]]
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
        temperatures = [name for name in shared if name.startswith("temperature_")]
        if not temperatures:
            raise InputError(f"{', '.join(run.name for run in runs)} have no thermometer in common; record one in all of them")
        answers = {lead: {name: _answer(runs, lead, name) for name in temperatures if name != lead} for lead in temperatures}
        lead = min(temperatures, key=lambda name: sum(missed for _, missed in answers[name].values()))
        clock = Ageing.grid(runs)[-1]
        ends_s = max(float(run.time_s[-1]) + run.period_s for run in runs)
        followers = {name: weights for name, (weights, _) in answers[lead].items()}
        found = cls(lead, followers, {}, clock, ends_s if clock.since == "clock" else 0.0)
        learnt = np.concatenate([found._followed(run) for run in runs])
        longest = max(runs, key=len)
        own = found._followed(longest)
        others = {}
        for name in shared:
            if name not in (TIME, *temperatures, *runs[0].gyro_columns):
                weights = np.linalg.lstsq(learnt, np.concatenate([run.column(name) for run in runs]), rcond=1e-9)[0]
                others[name] = weights, longest.column(name) - own @ weights
        return dataclasses.replace(found, others=others)

    def foreseen(self, programme: Programme, plant: ThermalPlant, step_s: float) -> Recording:
        """The monitors in a run of a programme; its gyro reads nothing.

        Parameters
        ----------
        programme : Programme
        plant : ThermalPlant
            Says how the temperature that leads follows the chamber.
        step_s : float
        """
        since_s: Array = np.arange(sample_count(programme.duration_s, step_s), dtype=np.float64) * step_s
        shell_degC, block_degC = plant.temperatures(programme.set_point_degC(since_s), step_s)
        leading = shell_degC if self.followers else block_degC
        time_s = self.begins_s + since_s
        table = {TIME: time_s, "gyro_deg_h": np.zeros(len(time_s)), self.lead: leading} | self._following(leading, time_s)
        run = Recording(pd.DataFrame(table), Metadata(kind="chamber"), name="next")
        followed = self._followed(run)
        return run.replace(
            table=run.table.assign(
                **{
                    name: followed @ weights + np.pad(left, (0, len(time_s)), mode="symmetric")[: len(time_s)]
                    for name, (weights, left) in self.others.items()
                }
            )
        )

    def _following(self, temperature_degC: Array, time_s: Array) -> dict[str, Array]:
        """The other temperatures, from the one that leads."""
        answering = np.column_stack([_lagged(temperature_degC, time_s), _since_start(time_s)])
        return {name: answering @ weights for name, weights in self.followers.items()}

    def _followed(self, run: Recording) -> Array:
        """What a monitor that is no thermometer may follow: the temperature that leads, its square, its lags; rates, with
        their sign and without; the clock."""
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


def _lagged(temperature_degC: Array, time_s: Array) -> Array:
    return np.column_stack([temperature_degC, *(lag(temperature_degC, time_s, lag_s) for lag_s in _LAGS_S)])


def _since_start(time_s: Array) -> Array:
    """A constant, and self-heating since the start of a run."""
    return np.exp(-np.divide.outer(time_s - time_s[0], np.array([math.inf, *_WARMING_S])))
