"""Whether anything is missing, as a p-value, and where: run, regime of a driver and interval."""

from __future__ import annotations

import dataclasses
from typing import Final, Literal

import numpy as np
import numpy.typing as npt

from rlgcomp.diagnosis import priors
from rlgcomp.diagnosis.answer.fit import Fit
from rlgcomp.diagnosis.data import Run
from rlgcomp.diagnosis.evidence.closed_form import Set
from rlgcomp.diagnosis.evidence.screen import Panel, Products, Screen
from rlgcomp.diagnosis.forms.drivers import Driver, Path
from rlgcomp.numerics.robust import LEAST_P_VALUE

Array = npt.NDArray[np.float64]
Regime = Literal["rising", "falling", "steady"]
DRAWS: Final = 200
_TAIL: Final = 0.1  # of the draws, beyond which exceedances are exponential: the statistic is a maximum of log likelihood ratios
_STEADY: Final = 0.1  # of the 95 % quantile of the rate's magnitude, below which a temperature is steady
_MOST: Final = 0.8  # of a run's share, that its interval holds


# --- is anything missing? --------------------------------------------------------------------------------------------------------


def screened(screen: Screen, offsets: Array, members: Set = (), *, draws: int = DRAWS, seed: int = 0) -> float:
    """Probability that noise alone would gain as much by its best term as the data do.

    The statistic is the largest log posterior odds of one form of one size against none, over all forms but those that a residual
    proposes; its distribution is that of draws of the noise. In the tail of it exceedances are exponential.

    Parameters
    ----------
    screen : Screen
        Of all forms under the noise of the null.
    offsets : ndarray, shape (forms,)
        Log prior odds of each form; -inf of what is no missing physics.
    members : tuple of Member
        Beside which a further one is sought: what they take is taken of data and draws.
    draws : int
    seed : int
    """
    if not np.any(np.isfinite(offsets)):
        return 1.0
    evidence, rng = screen.evidence, np.random.default_rng(seed)
    key = evidence.noise, draws, seed, offsets.tobytes()
    if not members and key in screen.layout.drawn:
        found = statistics(screen, offsets, evidence.output[:, None])
        return tail_probability(float(found[0]), screen.layout.drawn[key])
    drawn = rng.standard_normal((len(evidence.output), draws))
    known = evidence.bank.data.known
    if known.windows:
        drawn *= known.white * np.sqrt(known.windows / rng.chisquare(known.windows, draws))
    outputs = np.column_stack([evidence.output, evidence.whitened.off(drawn)])
    if members:
        table = evidence.table(members)
        outputs -= table @ np.linalg.solve(np.eye(table.shape[1]) + table.T @ table, table.T @ outputs)
    found = statistics(screen, offsets, outputs)
    if not members:
        screen.layout.drawn[key] = found[1:]
    return tail_probability(float(found[0]), found[1:])


def statistics(screen: Screen, offsets: Array, outputs: Array) -> Array:
    """Largest log posterior odds of a form against none, of each of several outputs, shape (d,).

    Parameters
    ----------
    screen : Screen
    offsets : ndarray, shape (forms,)
        Log prior odds of each form.
    outputs : ndarray, shape (n, d)
        Whitened and projected off the baseline.
    """
    whitened = screen.evidence.whitened
    adjoint, squares = whitened.adjoint(outputs), np.sum(outputs**2, axis=0) + screen.evidence.bank.data.known.square
    found = np.full(outputs.shape[1], -np.inf)
    for number, section in enumerate(screen.layout.sections):
        vectors = section.table.T @ adjoint
        for panel, products in zip(section.panels, screen.products(number), strict=True):
            log_dets, falls = _changes(panel, products, vectors)
            rest = np.log1p(-np.minimum(falls / squares, 1.0 - 1e-12))
            gains = -0.5 * log_dets[..., None] - 0.5 * whitened.freedom * rest + offsets[panel.forms][:, None, None]
            found = np.maximum(found, gains.max(axis=(0, 1)))
    return found


def _changes(panel: Panel, products: Products, vectors: Array) -> tuple[Array, Array]:
    """Growth of the log determinant, shape (forms, sizes), and fall of the square, shape (forms, sizes, d)."""
    squares = priors.SIZES**2
    own = vectors[panel.own] * panel.own_scale[..., None]  # (f, l, d)
    if not len(panel.shared):
        values, turns = products.principal
        grown = 1.0 + squares[:, None] * np.maximum(values, 0.0)[:, None, :]  # (f, sizes, l)
        return np.sum(np.log(grown), axis=2), (squares[:, None] / grown) @ (np.swapaxes(turns, 1, 2) @ own) ** 2
    values, turns = products.principal
    along = turns.T @ (vectors[panel.shared] * panel.shared_scale[:, None])  # (k, d)
    k, f, width = products.both.shape
    turned = (turns.T @ products.both.reshape(k, -1)).reshape(k, f, width)
    log_dets, falls = [], []
    for square in squares.tolist():
        grown = 1.0 + square * np.maximum(values, 0.0)
        heavy = np.moveaxis(turned * (square / grown)[:, None, None], 0, 2)  # (f, l, k)
        schur = np.eye(width) + square * (products.own - heavy @ np.moveaxis(turned, 1, 0))
        left = own - heavy @ along
        log_dets.append(np.sum(np.log(grown)) + np.linalg.slogdet(schur)[1])
        falls.append((square / grown) @ along**2 + square * np.sum(left * (np.linalg.inv(schur) @ left), axis=1))
    return np.stack(log_dets, axis=1), np.stack(falls, axis=1)


def tail_probability(value: float, drawn: Array) -> float:
    """Share of draws that reach a value; beyond most of them by an exponential."""
    start = float(np.quantile(drawn, 1.0 - _TAIL))
    if value <= start:
        return float((1 + np.sum(drawn >= value)) / (1 + len(drawn)))
    beyond = drawn[drawn > start] - start
    return max(float(_TAIL * np.exp(-(value - start) / max(float(beyond.mean()), 1e-12))), LEAST_P_VALUE)


# --- where? ----------------------------------------------------------------------------------------------------------------------


@dataclasses.dataclass(frozen=True)
class Part:
    """A part of the mismatch.

    Parameters
    ----------
    run : str
    start_s, end_s : float
        In the run's own time.
    regime : {"rising", "falling", "steady"}, optional
        Of a driver.
        None: the shortest interval that holds most of what the run has.
    share : float
        Of the sum of squares of what is missing, over all runs.
    """

    run: str
    start_s: float
    end_s: float
    regime: Regime | None
    share: float


def parts(before: Fit, after: Fit, driver: Driver | None = None) -> tuple[Part, ...]:
    """Where what is missing acts: by run its interval, and by run and regime of a driver, the largest shares first.

    What is missing is the posterior mean of the set less what the simulator alone would take of it; of a cause that is known by
    its path alone, or by nothing, it is what the simulator leaves.

    Parameters
    ----------
    before, after : Fit
        The simulator calibrated, and with the set.
    driver : Driver, optional
        Without one there are no regimes.
    """
    runs = after.data.runs
    latent = bool(after.state.key[1]) or not after.state.members
    missing = [before.residual(run) if latent else run.window_means(after.predicted(run) - before.predicted(run)) for run in runs]
    total = max(sum(float(one @ one) for one in missing), 1e-300)
    rate = None if driver is None else Path.rate(after.data, driver)
    found = []
    for run, one in zip(runs, missing, strict=True):
        square = one**2 / total
        first, last = _shortest(square)
        found.append(Part(run.name, *_span(run, first, last), None, float(square[first : last + 1].sum())))
        if rate is not None:
            found += _regimes(run, square, run.window_means(rate.values(run)))
    return tuple(sorted(found, key=lambda part: part.share, reverse=True))


def _regimes(run: Run, square: Array, rate: Array) -> list[Part]:
    least = _STEADY * float(np.quantile(np.abs(rate), 0.95))
    inside: dict[Regime, npt.NDArray[np.bool_]] = {
        "rising": rate > least,
        "falling": rate < -least,
        "steady": np.abs(rate) <= least,
    }
    span = _span(run, 0, len(square) - 1)
    return [Part(run.name, *span, regime, float(square[which].sum())) for regime, which in inside.items() if which.any()]


def _shortest(square: Array) -> tuple[int, int]:
    """First and last window of the shortest interval that holds most of a sum."""
    upto = np.r_[0.0, np.cumsum(square)]
    ends = np.searchsorted(upto, upto[:-1] + _MOST * upto[-1] * (1.0 - 1e-9))
    possible = np.flatnonzero(ends < len(upto))
    first = int(possible[np.argmin((ends - np.arange(len(ends)))[possible])])
    return first, max(int(ends[first]) - 1, first)


def _span(run: Run, first: int, last: int) -> tuple[float, float]:
    start = float(run.recording.time_s[0])
    return start + run.windows[first] * run.grid.window_s, start + (run.windows[last] + 1.0) * run.grid.window_s
