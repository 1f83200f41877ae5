"""What observers who know more than a hybrid leave of the same units: the bound of what any model could reach.

Of simulated units: one who knows every law and fits its numbers. Of units of the benchmark: one who knows every form and nonlinear
parameter and fits amplitudes; and one who knows the family alone (relays of any smooth density, lags of any spectrum), with the
history before each run and with the recording alone. The weight of the family's smoothness is the best on the held-out runs.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

import rlgcomp as rlg
from experiments.concealed.bench import Bench, chamber_case
from experiments.concealed.chamber import Chamber
from experiments.concealed.logger import Scale
from experiments.concealed.operators import Relays, first_order
from experiments.hybrid import units

Array = npt.NDArray[np.float64]
_EDGES_DEGC = np.linspace(-50.0, 65.0, 26)
_SMOOTH_K = 15.0, 12.0  # over which the density of relays is alike, by centre and by width
_LAGS_S = np.geomspace(100.0, 10_000.0, 16)
_SMOOTH_LAG = 1.0  # in logarithms of the time constant
_WEIGHTS = 10.0 ** np.arange(-8.0, 3.0)


def of_unit(seed: int, law: str, programme: str) -> dict[str, Any]:
    """The hybrid of one who knows the laws of a simulated unit."""
    gyro, runs, test, floor = units.simulated(seed, law, programme)
    known = gyro.freed([mechanism.name for mechanism in gyro.mechanisms])
    hybrid = rlg.Compensator(averaging_s=units.AVERAGING_S, physics=known).fit(runs)
    return {"every law": units.residual(hybrid, [test], units.AVERAGING_S) / floor}


def of_case(form: str, number: int) -> dict[str, Any]:
    """Of one unit of the benchmark."""
    one = units.cases(form, number + 1)[number]
    bench = Bench.of(one, None)
    case = chamber_case(one, scale=Scale(bench.chambers[0].step_s, units.SIZE_DEG_H))
    averaging_s = case.samples * bench.chambers[0].step_s
    runs, count = [*case.train, *case.test], len(case.train)
    floor = units.floor_of(case.test, case.signal_held_out, averaging_s)
    every = [units.means(run, run.rate_deg_h() - known, averaging_s) for run, known in zip(case.test, case.oracle, strict=True)]
    y = [units.means(run, run.rate_deg_h(), averaging_s) for run in runs]
    base = [
        np.column_stack([units.means(run, column, averaging_s) for column in block.T])
        for run, block in zip(runs, bench.columns(bench.chambers), strict=True)
    ]
    found: dict[str, Any] = {"every form": units.pooled(every) / floor}
    for label, history in (("family, with the history", True), ("family, the recording alone", False)):
        courses = [_courses(form, chamber, history) for chamber in bench.chambers]
        table = [
            np.column_stack([units.means(run, column, averaging_s) for column in course.T])
            for run, course in zip(runs, courses, strict=True)
        ]
        found[label] = _least(table, base, y, _alike(form), count) / floor
        if form != "Preisach":
            break  # a lag begins at rest, and needs no history
    return found


def _courses(form: str, chamber: Chamber, history: bool) -> Array:
    """The family's members in a run, shape (rows, members)."""
    if form != "Preisach":
        lags = [first_order(chamber[column], chamber.step_s, tau_s) - chamber[column] for column in _COLUMNS for tau_s in _LAGS_S]
        return np.column_stack(lags)
    up, down = _relays()
    relays = Relays(up, down, np.ones(len(up)))
    state = relays.run(chamber.history_degC, np.zeros(len(up), bool))[1] if history else relays.start(chamber.block[0])
    return np.asarray(2.0 * relays.states(chamber.block, state) - 1.0)


_COLUMNS = ("temperature_block_degC", "temperature_shell_degC")


def _relays() -> tuple[Array, Array]:
    down, up = np.meshgrid(_EDGES_DEGC, _EDGES_DEGC, indexing="ij")
    wide = up > down
    return up[wide], down[wide]


def _alike(form: str) -> Array:
    """Covariance of the members' amplitudes."""
    if form == "Preisach":
        up, down = _relays()
        places = np.column_stack([0.5 * (up + down) / _SMOOTH_K[0], (up - down) / _SMOOTH_K[1]])
    else:
        places = np.tile(np.log(_LAGS_S) / _SMOOTH_LAG, len(_COLUMNS))[:, None]
    covariance = np.exp(-0.5 * ((places[:, None] - places) ** 2).sum(axis=2))
    if form != "Preisach":
        covariance *= np.kron(np.eye(len(_COLUMNS)), np.ones((len(_LAGS_S), len(_LAGS_S))))
    return np.asarray(covariance)


def _least(table: Sequence[Array], base: Sequence[Array], y: Sequence[Array], alike: Array, count: int) -> float:
    """Least residual of the runs after the first `count`, over the weights of smoothness; biases of runs and base are free.

    Parameters
    ----------
    table, base : sequence of ndarray, shape (windows, members) and (windows, columns)
        Run by run.
    y : sequence of ndarray, shape (windows,)
    alike : ndarray, shape (members, members)
    count : int
        Training runs.
    """
    own = [np.column_stack([np.tile(np.eye(count)[k], (len(block), 1)), block]) for k, block in enumerate(base[:count])]
    F, S, target = np.vstack(own), np.vstack(table[:count]), np.concatenate(y[:count])
    gram = S @ alike @ S.T
    residuals = []
    for weight in _WEIGHTS:
        solved = np.linalg.solve(gram + weight * np.trace(gram) / len(gram) * np.eye(len(gram)), np.column_stack([target, F]))
        slopes = np.linalg.lstsq(F.T @ solved[:, 1:], F.T @ solved[:, 0], rcond=1e-12)[0]
        amplitudes = alike @ (S.T @ (solved[:, 0] - solved[:, 1:] @ slopes))
        parts = zip(table[count:], base[count:], y[count:], strict=True)
        residuals.append(units.pooled([values - S_ @ amplitudes - block @ slopes[count:] for S_, block, values in parts]))
    return float(min(residuals))
