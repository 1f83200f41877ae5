"""Parameters of an equation, and whether it describes the function that was found.

A term is its leading bases and departures from them, which are not at right angles: the weight of a leading basis alone is no
parameter. With the columns E of an equation, the term f = B w, and both whitened and projected off the baseline, the parameters are

.. math:: a = (E^T E)^{-1} E^T B w, \\qquad \\mathrm{cov}(a) = P C P^T, \\quad P = (E^T E)^{-1} E^T B

with C the posterior covariance of all weights of the term; what the baseline may take of the equation is no part of its parameters.
What the equation leaves of the function, beyond what the covariance allows, is its misfit. A parameter could be off by all of it
were other windows weighted, so that it is in their errors; where it exceeds the discrepancy of a law and a twentieth of the noise,
no parameters are stated.
"""

from __future__ import annotations

import contextlib
import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt

from rlgcomp.diagnosis import priors
from rlgcomp.diagnosis.answer.fit import Estimate, Fit
from rlgcomp.diagnosis.data import Run
from rlgcomp.diagnosis.equations.stated import all_names, are_decays, number_of, ranks, together
from rlgcomp.diagnosis.forms.bases import Basis, EachRun, Own, Smooth, Times, Unsettled
from rlgcomp.diagnosis.forms.memories import Relays, Undecided
from rlgcomp.diagnosis.regions.passages import scatter_of
from rlgcomp.diagnosis.regions.selections import by_run, in_all_runs, runs_of
from rlgcomp.diagnosis.regions.turntable import RatePower
from rlgcomp.errors import InputError
from rlgcomp.physics.mechanism import Mechanism
from rlgcomp.physics.rotation_harmonics import RotationHarmonics

Array = npt.NDArray[np.float64]
_SAME: Final = 0.05  # of the white noise of a window mean: what leaves less, or less than a law's discrepancy, describes it
_CHANCE: Final = 2.0  # times the square that errors of the weights leave: a misfit within it is chance
_ABSORBED: Final = 1e-6  # of a column beside the baseline, or of a term: an amplitude of which no more is left is none of its own
_STEP: Final = 1.0 / 32.0  # of the grid, at which amplitudes' changes with a shape are taken
_UNITS: Final = {"time_constant_s": "s", "delay_s": "s", "w": ""}  # of what a smooth function is of


class _Nearest(NamedTuple):
    """Coefficients of some columns with which they come nearest to a term.

    Parameters
    ----------
    values : ndarray, shape (e,)
    covariance : ndarray, shape (e, e)
    most : ndarray, shape (e,)
        What the misfit could change of each.
    holds : bool
        They describe the term.
    limit : float
        Root mean square up to which a misfit would be none.
    columns : ndarray, shape (n, e)
        Whitened, and projected off the baseline.
    """

    values: Array
    covariance: Array
    most: Array
    holds: bool
    limit: float
    columns: Array


def _nearest(fit: Fit, k: int, columns: Array, *beside: Array) -> _Nearest:
    """Coefficients of window means of columns with which they come nearest to the k-th member.

    Parameters
    ----------
    fit : Fit
    k : int
    columns : ndarray, shape (n, e)
    beside : ndarray, shape (n, h)
        Columns of the member that are no part of the equation, as of what was before a run.
    """
    e, covariance = columns.shape[1], fit.covariance(k)
    before = [fit.bank.columns(basis) for basis, _ in fit.parts[k][1] if isinstance(basis, Unsettled)]
    columns = np.hstack([columns, *beside, *before])
    projected = fit.projected(np.hstack([columns, *(scale * fit.bank.columns(basis) for basis, scale in fit.parts[k][1])]))
    if runs := runs_of(fit.parts[k][0].form):  # the constant of some runs is not the baseline's
        constant = fit.projected(fit.data.means(lambda run: np.full((run.bins, 1), float(run.name in runs))))
        projected = projected - constant @ (np.linalg.pinv(constant, rcond=1e-10) @ projected)
    equation, term = projected[:, : columns.shape[1]], projected[:, columns.shape[1] :]
    inverse = np.linalg.pinv(equation, rcond=1e-10)
    of_weights = inverse @ term
    values = of_weights @ fit.weights(k)
    function = term @ fit.weights(k)
    rest = term - equation @ of_weights
    by_chance = float(np.einsum("ij,jk,ik->", rest, covariance, rest)) / len(rest)
    misfit = math.sqrt(max(float(np.mean((function - equation @ values) ** 2)) - _CHANCE * by_chance, 0.0))
    limit = max(_SAME * fit.white, priors.DISCREPANCY * float(np.sqrt(np.mean(function**2))))
    most = misfit * math.sqrt(len(rest)) * np.linalg.norm(inverse, axis=1)
    errors = of_weights @ covariance @ of_weights.T
    return _Nearest(values[:e], errors[:e, :e], most[:e], misfit <= limit, limit, equation[:, :e])


def _of_history(basis: Basis) -> bool:
    """Whether a leading basis is of what was before the runs."""
    return isinstance(basis, EachRun) and isinstance(basis.basis, Undecided)


def of_mechanism(fit: Fit, k: int, mechanism: type[Mechanism]) -> tuple[dict[str, Estimate], tuple[str, ...]]:
    """Amplitudes and nonlinear parameters of the k-th member in the mechanism's own names; none where its equation is another.

    Last those that are not determined because the function departs from that equation.
    """
    member, bases = fit.parts[k]
    if bases and not by_run(member.form) and (orders := together(member.form.lead)) is not None:
        return _of_each_order(fit, k, orders)
    if not bases or not member.form.lead or by_run(member.form):
        return {}, ()
    lead, *histories = member.form.lead
    if not lead.of_mechanism or not all(_of_history(basis) for basis in histories):
        return {}, ()
    found = _nearest(fit, k, *(fit.bank.columns(basis) for basis in member.form.lead))
    if not found.holds:
        return {}, tuple(p.name for p in mechanism().amplitude_parameters()[:1] if found.columns.shape[1] == 1)
    shapes = {
        same.name: Estimate(value, _error_of_shape(fit, k, name, value), same.unit)
        for name, value in lead.parameters().items()
        if (same := next((p for p in mechanism.parameters() if p.name.startswith(name)), None)) is not None
    }
    own = _own_names(fit, k, found, mechanism, {name: one.value for name, one in shapes.items()})
    if own is None:
        return {}, ()
    names, change = own
    sds = [{name: shapes[same].sd for name in lead.parameters() for same in shapes if same.startswith(name)}]
    covariance = found.covariance + _of_shapes(fit, k, found.values, sds, own_units=False)
    values = change @ found.values
    variance = np.diag(change @ covariance @ change.T) + (np.abs(change) @ found.most) ** 2
    if len(names) == 1:
        variance = variance + _of_orders(fit, k, found, mechanism, shapes, float(values[0]))
    units = {parameter.name: parameter.unit for parameter in mechanism.parameters()}
    amplitudes = {
        name: Estimate(float(value), math.sqrt(square), units[name])
        for name, value, square in zip(names, values, variance, strict=True)
    }
    return {**amplitudes, **shapes}, ()


def _error_of_shape(fit: Fit, k: int, name: str, value: float) -> float:
    """Standard deviation of a nonlinear parameter; thresholds that scatter are means of those of their passages."""
    lead = in_all_runs(fit.state.members[k].form.lead[0])
    if not isinstance(lead, Relays) or not lead.passages:
        return fit.spread(k, name, value)
    up, down = scatter_of(lead, fit.data)
    squares = [float(np.mean(one**2)) / len(one) if len(one) else 0.0 for one in (up, down)]
    return math.sqrt(squares[0] + (squares[1] if name == "dead_band" else 0.0))


def _own_names(
    fit: Fit, k: int, found: _Nearest, mechanism: type[Mechanism], shapes: Mapping[str, float]
) -> tuple[tuple[str, ...], Array] | None:
    """Amplitudes of a mechanism, and the matrix that makes them of coefficients of the leading basis; None where none does.

    The choice of its settings that is the leading basis itself comes before those that are nearly so, which have other equations.
    """
    lead = fit.state.members[k].form.lead[0]
    inner = in_all_runs(lead)
    if isinstance(inner, Own):
        names = tuple(p.name for p in inner.mechanism.amplitude_parameters())
        return names, np.eye(len(names))
    wanted = found.columns @ found.values
    best: tuple[tuple[bool, int, float], tuple[str, ...], Array] | None = None
    for point in _points(mechanism, shapes):
        names = tuple(p.name for p in point.amplitude_parameters())
        columns = fit.data.means(_basis_of(point, runs_of(fit.state.members[k].form)))
        projected = fit.projected(columns)
        there = np.linalg.norm(projected, axis=0) > _ABSORBED * np.linalg.norm(columns, axis=0)
        change = np.linalg.pinv(projected[:, there], rcond=1e-10) @ found.columns
        parts = projected[:, there] * (change @ found.values)
        off = float(np.sqrt(np.mean((wanted - parts.sum(axis=1)) ** 2)))
        takes_part = np.linalg.norm(parts, axis=0) > _ABSORBED * np.linalg.norm(wanted)  # others are no part of the leading basis
        there[there], change = takes_part, change[takes_part]
        rank = off > _ABSORBED * float(np.sqrt(np.mean(wanted**2))), len(names), off
        if there.any() and off <= found.limit and (best is None or rank < best[0]):
            best = rank, tuple(itertools.compress(names, there)), change
    if best is not None:
        return best[1:]
    amplitudes = [p.name for p in mechanism.parameters() if p.role == "amplitude"]
    if isinstance(inner, Times | RatePower) or found.columns.shape[1] != 1 or len(amplitudes) != 1:
        return None
    return tuple(amplitudes), np.array([[lead.per_unit()]])  # the driver's noise alone is what its own column differs by


def _of_orders(
    fit: Fit, k: int, found: _Nearest, mechanism: type[Mechanism], shapes: Mapping[str, Estimate], value: float
) -> float:
    """Variance that the error of an order, a whole number, brings into an amplitude: the amplitude is that of a reference value."""
    total, wanted = 0.0, found.columns @ found.values
    for name in (p.name for p in mechanism.parameters() if p.whole and p.name in shapes):
        changes = [0.0]
        for order in (round(shapes[name].value) - 1, round(shapes[name].value) + 1):
            try:
                point = mechanism(**{name: order})
            except InputError:
                continue
            other = fit.projected(fit.data.means(_basis_of(point, runs_of(fit.state.members[k].form))))
            changes.append(abs(float((np.linalg.pinv(other, rcond=1e-10) @ wanted)[0]) - value))
        total += (max(changes) * shapes[name].sd) ** 2
    return total


def _points(mechanism: type[Mechanism], shapes: Mapping[str, float]) -> list[Mechanism]:
    """The mechanism with these shapes and each choice of its settings; all its shapes are needed."""
    choices, whole = settings_of(mechanism), [p for p in mechanism.parameters() if p.whole]
    choices |= {p.name: tuple(range(int(p.low), int(p.high) + 1)) for p in whole if p.high - p.low < 10}
    choices |= {p.name: (round(shapes[p.name]),) for p in whole if p.name in shapes}
    shapes = {name: value for name, value in shapes.items() if name not in choices}
    points = points_of(mechanism, choices | {name: (value,) for name, value in shapes.items()})
    return [one for one in points if {p.name for p in one.shape_parameters()} <= set(shapes)]


def settings_of(mechanism: type[Mechanism]) -> dict[str, tuple[Any, ...]]:
    """Choices of its settings, by name."""
    return {p.name: p.choices for p in mechanism.parameters() if p.role == "setting" and p.choices}


def points_of(mechanism: type[Mechanism], choices: Mapping[str, Sequence[Any]]) -> list[Mechanism]:
    """The mechanism with each choice of some parameters that it allows."""
    points = []
    for values in itertools.product(*choices.values()):
        with contextlib.suppress(InputError):
            points.append(mechanism(**dict(zip(choices, values, strict=True))))
    return points


def _basis_of(point: Mechanism, runs: Sequence[str]) -> Callable[[Run], Array]:
    """Columns of a mechanism on the bins of a run; nothing in runs in which a term does not act."""
    return lambda run: np.asarray(run.on_bins(point.basis(run.binned)) * (not runs or run.name in runs))


def _of_shapes(fit: Fit, k: int, values: Array, sds: Sequence[Mapping[str, float]], *, own_units: bool) -> Array:
    """Covariance that errors of the shapes of leading bases bring into their coefficients, shape (e, e).

    `sds` are of the shapes of each of the first leading bases; with `own_units` coefficients are by the units of the drivers.
    """
    lead = fit.state.members[k].form.lead[: len(sds)]

    def columns(bases: Sequence[Basis]) -> Array:
        return np.hstack([fit.data.means(basis.columns) / (basis.per_unit() if own_units else 1.0) for basis in bases])

    total = np.zeros((len(values), len(values)))
    function = fit.projected(columns(lead)) @ values
    for j, of_lead in enumerate(sds):
        for name, sd in of_lead.items():
            slopes = []
            for moved in lead[j].nearby(_STEP):
                if (by := moved.parameters()[name] - lead[j].parameters()[name]) != 0.0:
                    equation = fit.projected(columns([*lead[:j], moved, *lead[j + 1 :]]))
                    slopes.append((np.linalg.pinv(equation, rcond=1e-10) @ function - values) / by)
            if slopes:
                slope = np.mean(slopes, axis=0) * sd
                total += np.outer(slope, slope)
    return total


# --- equations without a name ----------------------------------------------------------------------------------------------------


def of_law(fit: Fit, k: int, unit: str) -> tuple[dict[str, Estimate], tuple[str, ...]]:
    """Numbers of the equation of the k-th member, and those that are not determined because its function is another.

    The unit is that of the output.
    """
    member, bases = fit.parts[k]
    lead = member.form.lead
    names = all_names(lead, unit)
    if not bases or by_run(member.form) or not all(names):
        return (_of_path(fit, k, lead[0]) if bases and len(lead) == 1 else {}), ()
    found = _nearest(fit, k, np.hstack([fit.bank.columns(basis) / basis.per_unit() for basis in lead]))
    if not found.holds:
        return {}, tuple(name for of_lead in names for name, _ in of_lead.values())
    estimates: dict[str, Estimate] = {}
    sds = []
    for j, (basis, of_lead) in enumerate(zip(lead, names, strict=True)):
        spreads = {name: fit.spread(k, name, value, j) for name, value in basis.parameters().items()}
        sds.append(spreads)
        for own, value in basis.parameters().items():
            name, of = of_lead[own]
            estimates[name] = Estimate(value, spreads[own], of)
    covariance = found.covariance + _of_shapes(fit, k, found.values, sds, own_units=True) + np.diag(found.most**2)
    if are_decays(lead) and np.prod(found.values) > 0.0:
        return {**_shares(found.values, covariance, ranks(lead), unit), **estimates}, ()
    amplitudes = {
        name: Estimate(float(value), math.sqrt(square), of)
        for (name, of), value, square in zip((one[""] for one in names), found.values, np.diag(covariance), strict=True)
    }
    ordered = sorted({**amplitudes, **estimates}.items(), key=lambda item: number_of(item[0]))
    return dict(ordered), ()


def _shares(values: Array, covariance: Array, ranks: Sequence[int], unit: str) -> dict[str, Estimate]:
    """Amplitudes of two decays of one sign as the warm-up of the catalogue has them: their sum, and the share of the slower one."""
    total, slow = float(values.sum()), np.array(ranks, dtype=np.float64)
    share = float(slow @ values) / total
    slope = (slow - share) / total
    sd, of_share = math.sqrt(float(covariance.sum())), math.sqrt(float(slope @ covariance @ slope))
    return {"initial_deg_h": Estimate(total, sd, unit), "slower_share": Estimate(share, of_share, "1")}


def _of_each_order(fit: Fit, k: int, orders: RotationHarmonics) -> tuple[dict[str, Estimate], tuple[str, ...]]:
    """Amplitudes of several orders of a table's angle, each a leading basis."""
    lead, parameters = fit.parts[k][0].form.lead, orders.amplitude_parameters()
    found = _nearest(fit, k, np.hstack([fit.bank.columns(basis) for basis in lead]))
    if not found.holds:
        return {}, tuple(p.name for p in parameters)
    sds = np.sqrt(np.diag(found.covariance) + found.most**2)
    values = zip(parameters, found.values, sds, strict=True)
    return {p.name: Estimate(float(value), float(sd), p.unit) for p, value, sd in values}, ()


def _of_path(fit: Fit, k: int, basis: Basis) -> dict[str, Estimate]:
    """What a smooth function is of: the time constant of a column's lag, the place between two columns."""
    basis = in_all_runs(basis)
    if not isinstance(basis, Smooth):
        return {}
    return {name: Estimate(value, fit.spread(k, name, value), _UNITS[name]) for name, value in basis.parameters().items()}
