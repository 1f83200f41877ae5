r"""The next experiment: the feasible programme on which the likely sets differ most by what each predicts of it.

For sets A and B, fitted to the runs there are, the difference of their predictions d of window means of the new run is compared
with what B may still be: its weights have the covariance :math:`\Sigma_B`, and the baseline's numbers are free,

.. math:: D^2_{AB} = d^T (\sigma^2 N + A_B \Sigma_B A_B^T + \infty\, X X^T)^{-1} d .

The log likelihood ratio after the run, if A is true, is then normal with mean :math:`D^2/2` and variance :math:`D^2`; the expected
probability of whichever is true follows, averaged over the sets. Shapes of B stay as they are fitted, so the promise is an upper
bound where B could bend; where even this bound is small, no programme parts the sets.

References
----------
G. E. P. Box, W. J. Hill, Technometrics 9, 57 (1967) (experiments that discriminate among models).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Final

import numpy as np
import numpy.typing as npt

from rlgcomp.diagnosis.answer.fit import Fit
from rlgcomp.diagnosis.answer.posterior import Posterior
from rlgcomp.diagnosis.data import Data, Run
from rlgcomp.diagnosis.decide import EXCHANGED
from rlgcomp.diagnosis.next_experiment.laboratory import Laboratory, RateTable
from rlgcomp.diagnosis.next_experiment.programmes import ChamberRange, chamber_programmes, table_programmes
from rlgcomp.diagnosis.regions.baseline import independent
from rlgcomp.diagnosis.regions.turntable import with_angle_rows
from rlgcomp.diagnosis.report.record import NextExperiment
from rlgcomp.diagnosis.search.states import State
from rlgcomp.errors import InputError
from rlgcomp.recording import Recording
from rlgcomp.report.messages import Message, message
from rlgcomp.simulation.programme import Programme
from rlgcomp.simulation.table_programme import TableProgramme

Array = npt.NDArray[np.float64]
_MOST: Final = 4  # sets that are parted
LONGEST: Final = 8.0  # longest recorded runs that a programme may take: the plant is known on their scale
_PARTED: Final = 3.0  # standard deviations from which a programme parts two sets
_ENOUGH: Final = 0.99  # expected probability from which the shorter programme is preferred
_NODES, _WEIGHTS = np.polynomial.hermite_e.hermegauss(21)


def next_experiment(
    posterior: Posterior, fits: Sequence[Fit], states: Sequence[State], chamber: ChamberRange | None
) -> tuple[NextExperiment | None, Message | None]:
    """The programme that parts the likely sets, and what it promises, or that none does; neither where one set is likely.

    Parameters
    ----------
    posterior : Posterior
    fits : sequence of Fit
        Of each of the likely sets.
    states : sequence of State
        The same sets in the posterior.
    chamber : ChamberRange, optional
        What the chamber can do, instead of what was recorded.
    """
    if len(fits) < 2:
        return None, None
    weights = np.array([posterior.of_effects[posterior.effects_of(state)] for state in states])
    prior = weights / weights.sum()
    names = _names(posterior, states)
    tried = []
    for programme, run in possible_runs(posterior, fits, states, chamber):
        squares = distances(fits, run)
        tried.append((float(prior @ expected(prior, squares)), programme.duration_s, squares, programme))
    if not tried:
        return None, None
    probability, duration_s, squares, programme = min(tried, key=lambda one: (-min(one[0], _ENOUGH), one[1]))
    separation = math.sqrt(max(min(one[2][0, 1], one[2][1, 0]) for one in tried))
    if separation < _PARTED:
        return None, message("diagnosis.no_programme_parts", sets=names, separation=separation)
    found = NextExperiment(tuple(names), str(programme), probability, math.sqrt(min(squares[0, 1], squares[1, 0])), duration_s)
    promise = message("diagnosis.next_experiment", sets=names, profile=str(programme), duration_s=duration_s, expected=probability)
    return found, promise


def possible_runs(
    posterior: Posterior, fits: Sequence[Fit], states: Sequence[State], chamber: ChamberRange | None
) -> Iterator[tuple[Programme | TableProgramme, Run]]:
    """Programmes that chamber or table can run, with the runs that they would be; parameters as of :func:`next_experiment`."""
    data = fits[0].data
    recorded, longest_s, grid = [run.binned for run in data.runs], LONGEST * data.longest_s, data.runs[0].grid
    try:
        if data.turns:
            read = {column for state in states for key in state.key[0] for column in posterior.regions[key].drivers}
            table, bases = RateTable.of(recorded, read), [basis for fit in fits for _, bases in fit.parts for basis, _ in bases]
            for turning in (one for one in table_programmes(recorded) if one.duration_s <= longest_s):
                plain = Data((Run.of(table.run_of(turning), grid, _nothing),))
                yield turning, with_angle_rows(plain, bases, _nothing).runs[0]
            return
        laboratory = Laboratory.of(recorded)
        plant = fits[0].baseline.simulator.monitors.plant
        for programme in (one for one in chamber_programmes(recorded, chamber) if one.duration_s <= longest_s):
            yield programme, Run.of(laboratory.run_of(programme, plant, grid.bin_s), grid, _nothing)
    except InputError:  # no thermometer that could be commanded, a monitor that a table does not tell
        return


def _nothing(binned: Recording) -> Array:
    return np.zeros(len(binned))


def likely(posterior: Posterior) -> list[State]:
    """Sets that are nearly as likely as the named one and hold other effects, the likeliest first."""
    found: list[State] = []
    own = posterior.of_effects[posterior.effects_of(posterior.best)]
    for state in posterior.states:
        effects = posterior.effects(state.key)
        near = posterior.of_effects[posterior.effects_of(state)] > EXCHANGED * own
        if near and not state.key[1] and all(effects != posterior.effects(other.key) for other in found):
            found.append(state)
    return found[:_MOST]


def distances(fits: Sequence[Fit], run: Run) -> Array:
    """D² of each set (column) from each truth (row) on a run."""
    whitened = [_Whitened(fit, run) for fit in fits]
    found = np.zeros((len(fits), len(fits)))
    for k, truth in enumerate(fits):
        for j, rival in enumerate(fits):
            if k != j:
                found[k, j] = whitened[j].square(run.means(truth.predicted(run) - rival.predicted(run)))
    return found


class _Whitened:
    """A run under the noise of a fit: what it may still be in whitened columns."""

    def __init__(self, fit: Fit, run: Run) -> None:
        length = max(len(one.full) for one in fit.data.runs)
        covariance = fit.white**2 * fit.state.noise.of_run(run, length)
        self._root = np.linalg.cholesky(covariance)
        members = [scale * run.means(basis.columns(run)) for _, bases in fit.parts for basis, scale in bases]
        table = np.hstack([np.empty((len(run.output), 0)), *members])
        if table.shape[1]:
            values, vectors = np.linalg.eigh(fit.solution.covariance)
            table = table @ (vectors * np.sqrt(np.maximum(values, 0.0)))
        free = independent(self._whitened(run.means(fit.baseline.columns(run))))
        own = self._whitened(table)
        self._free, self._own = free, own - free @ (free.T @ own)

    def _whitened(self, columns: Array) -> Array:
        from scipy.linalg import solve_triangular

        return np.asarray(solve_triangular(self._root, columns, lower=True, check_finite=False))

    def square(self, difference: Array) -> float:
        """D² of a difference of predictions."""
        d = self._whitened(difference)
        d = d - self._free @ (self._free.T @ d)
        along = self._own.T @ d
        inner = np.eye(len(along)) + self._own.T @ self._own
        return max(float(d @ d - along @ np.linalg.solve(inner, along)), 0.0)


def expected(prior: Array, squares: Array) -> Array:
    """Expected probability of each set, were it true: log likelihood ratios are normal, mean D²/2, variance D²."""
    found = np.empty(len(prior))
    for k, probability in enumerate(prior):
        ratios = 0.5 * squares[k][:, None] + np.sqrt(squares[k])[:, None] * _NODES
        against = np.exp(-np.clip(ratios, -700.0, 700.0)) * prior[:, None] / max(float(probability), 1e-300)
        after = 1.0 / (1.0 + np.delete(against, k, axis=0).sum(axis=0))
        found[k] = after @ _WEIGHTS / _WEIGHTS.sum()
    return found


def _names(posterior: Posterior, states: Sequence[State]) -> list[str]:
    """What each set is called among the others: what it does not share with all."""
    effects = [posterior.effects(state.key) for state in states]
    shared = frozenset.intersection(*effects)
    return [" + ".join(sorted(one - shared)) or "nothing more" for one in effects]
