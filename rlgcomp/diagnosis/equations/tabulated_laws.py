"""Terms as tabulated laws: bases with their weights as tables that a simulator file holds."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable, Collection, Iterable
from types import SimpleNamespace
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from rlgcomp.diagnosis.answer.fit import Fit
from rlgcomp.diagnosis.forms.bases import Basis, Glitch, Product, Shift, Times, gaussian_process
from rlgcomp.diagnosis.forms.drivers import BEYOND, Driver, Path
from rlgcomp.diagnosis.forms.histories import sides
from rlgcomp.diagnosis.forms.memories import Curves, Plays, Preisach, Relays, dense
from rlgcomp.diagnosis.forms.relaxations import Conduction, Distributed, Lag, Spectrum
from rlgcomp.diagnosis.forms.symmetries import Sign
from rlgcomp.diagnosis.forms.times import Following, Since, SmoothSince, Wave
from rlgcomp.diagnosis.noise.errors import columns_of
from rlgcomp.diagnosis.regions.lateness import Late
from rlgcomp.physics.tabulated_law import TabulatedLaw

Array = npt.NDArray[np.float64]
_Law = Callable[..., TabulatedLaw]  # :func:`_law` of a cause and a step
_PRECISE: Final = 0.003  # of the white noise of a window mean: error of a table between its knots
_KNOTS: Final = 27
_MOST_KNOTS: Final = 600
_KNOTS_OF_CURVES: Final = 161
_LONGER: Final = 3.0  # run lengths over which a law of time is tabulated
_FAR: Final = 1.0  # range beyond a table's end over which its slope is taken
_TAIL: Final = 10.0  # widths of a step beyond which it is level
_STEP: Final = 1e-6  # of a column's largest size, over which its sign is a straight line
_EACH_ROW_S: Final = 1e-9  # of a law that is evaluated at each row
_SMALL: Final = 1e-9  # of the largest weight of a sum of relays


def laws_of(fit: Fit, parts: Iterable[tuple[Basis, Array]], cause: str) -> tuple[list[TabulatedLaw], bool]:
    """Bases with their weights as tabulated laws, and whether they are all: what belongs to single runs is none.

    Functions of one path are one table.
    """
    found: list[TabulatedLaw] = []
    functions: dict[Path, list[tuple[Basis, Array]]] = {}
    whole = True
    for basis, weights in parts:
        path = getattr(basis, "path", None)
        if isinstance(path, Path):
            functions.setdefault(path, []).append((basis, weights))
            continue
        pieces, complete = _laws_of_basis(fit, basis, weights, cause)
        found, whole = found + pieces, whole and complete
    of_rows = {law.driver for law in found if law.step_s == _EACH_ROW_S}
    tables = [_table(fit, path, of_path, cause) for path, of_path in functions.items()]
    tables = [dataclasses.replace(one, step_s=_EACH_ROW_S) if _beside(one, of_rows) else one for one in tables]
    return [*tables, *found], whole


def _laws_of_basis(fit: Fit, basis: Basis, weights: Array, cause: str) -> tuple[list[TabulatedLaw], bool]:
    """A basis that is no function of a path as tabulated laws; False beside none where it belongs to single runs."""
    law = functools.partial(_law, cause=cause, step_s=fit.data.runs[0].grid.bin_s)
    match basis:
        case Shift() | Glitch():
            pieces, whole = laws_of(fit, [(basis.basis, weights)], cause)
            change = "derivative" if isinstance(basis, Shift) else "glitch"
            return [dataclasses.replace(piece, change=change) for piece in pieces], whole
        case Lag() if not basis.behind:
            (w,), d = weights.tolist(), basis.driver
            ends, slope = (d.centre - d.half, d.centre + d.half), w / d.half
            of = _driver(d) | {"memory": "lag", "time_s": basis.time_constant_s}
            return [law(**of, knots=ends, weights=(-w, w), slope_below=slope, slope_above=slope)], True
        case Lag() | Conduction() | Distributed() | Spectrum():
            times, mixture = basis.mixture()
            mixed = mixture @ weights / basis.driver.half
            return [law(**_driver(basis.driver), memory="lags", knots=times, weights=mixed)], True
        case Plays():
            radii = basis.radii() * basis.driver.half
            radii = radii[:-1] if basis.spread else radii[-1:]
            each = np.full(len(radii), float(weights[0]) / basis.driver.half / len(radii))
            of = _driver(basis.driver) | {"memory": "plays", "start": basis.start}
            return [law(**of, knots=radii, knots_2=basis.driver.in_unit(basis.before()), weights=each)], True
        case Curves():
            return [_of_curves(law, basis, weights)], True
        case Relays() | Preisach():
            return _of_relays(law, basis, weights), True
        case Product():
            one, other = basis.one.driver, basis.other.driver
            product = float(weights[0]) / (one.half * other.half)
            of = {"driver": one.columns[0], "driver_2": other.columns[0], "memory": "product"}
            return [law(**of, knots=(one.centre, other.centre), weights=(product,))], True
        case Wave() | Following():
            return _waves(basis, weights, law), True
        case Times():
            return _times(fit, basis, weights, cause)
        case Sign():
            return [_of_sign(fit, basis, float(weights[0]), cause)], True
        case Since() | SmoothSince():
            return [_table_of_time(fit, basis, weights, law)], True
        case Late():
            return _of_late(fit, basis, float(weights[0]), cause)
    return [], False


def _times(fit: Fit, basis: Times, weights: Array, cause: str) -> tuple[list[TabulatedLaw], bool]:
    """A basis times a column, less that basis times the middle of the column's range."""
    pieces, whole = laws_of(fit, [(basis.basis, weights)], cause)
    driver = basis.by.driver
    found = [dataclasses.replace(one, factor=driver.columns[0], scale=one.scale / driver.half) for one in pieces]
    if driver.centre:
        found += [dataclasses.replace(one, scale=-one.scale * driver.centre / driver.half) for one in pieces]
    return found, whole


def _waves(basis: Wave | Following, weights: Array, law: _Law) -> list[TabulatedLaw]:
    """A wave, and that times a column."""
    wave = basis if isinstance(basis, Wave) else basis.wave
    of = {"memory": "growing wave" if wave.growing else "wave", "knots": (wave.frequency_hz,)}
    if isinstance(basis, Wave):
        cosine, sine = weights.tolist()
        return [law(**of, weights=(cosine,), weights_2=(sine,))]
    driver, path = basis.by.driver, basis.by
    slope = weights[2:] / (driver.half * path.half)
    constant = weights[:2] - slope * (driver.centre + driver.half * path.centre)
    (cosine, sine), (cosine_of, sine_of) = constant.tolist(), slope.tolist()
    following = law(**of, weights=(cosine_of,), weights_2=(sine_of,), factor=driver.columns[0])
    return [law(**of, weights=(cosine,), weights_2=(sine,)), following]


def _of_late(fit: Fit, late: Late, lag: float, cause: str) -> tuple[list[TabulatedLaw], bool]:
    """What a column brings that is late by a lag in windows, as derivatives by time of functions of it.

    False beside none where it has other parts.
    """
    prediction, functions = late.prediction, []
    for basis, weights in prediction.parts:
        path = getattr(basis, "path", None)
        if isinstance(path, Path) and path.memory == "none" and path.driver.columns == (late.column,):
            functions.append((basis, weights * lag * fit.data.runs[0].grid.bins))
        elif late.column in columns_of([basis], fit.data):
            return [], False
    if late.column in columns_of(prediction.baseline.simulator.mechanisms, fit.data):
        return [], False
    tables, whole = laws_of(fit, functions, cause)
    return [dataclasses.replace(table, change="derivative") for table in tables], whole


def _table(fit: Fit, path: Path, parts: list[tuple[Basis, Array]], cause: str) -> TabulatedLaw:
    """Functions of one path together as one table."""

    def function(v: Array) -> Array:
        run: Any = SimpleNamespace(cache={path: v}, bins=len(v))
        return np.sum([basis.columns(run) @ weights for basis, weights in parts], axis=0)

    reach = max(basis.reach for basis, _ in parts)
    knots = _knots(function, np.linspace(-reach, reach, _KNOTS), _PRECISE * fit.white)
    values = function(knots)
    half = path.driver.half * path.half
    offset = 0.0 if path.memory == "rate" else path.driver.centre
    raw = offset + path.driver.half * path.centre + half * knots
    below = (values[0] - function(knots[:1] - _FAR)[0]) / (_FAR * half)
    above = (function(knots[-1:] + _FAR)[0] - values[-1]) / (_FAR * half)
    memory = {"memory": "none"} if path.memory == "none" else {"memory": path.memory, "time_s": path.time_s}
    ends = {"slope_below": float(below), "slope_above": float(above)}
    return _law(cause, fit.data.runs[0].grid.bin_s, **_driver(path.driver), **memory, knots=raw, weights=values, **ends)


def _of_sign(fit: Fit, basis: Sign, weight: float, cause: str) -> TabulatedLaw:
    """A sign, or a hyperbolic tangent of a width, at each row."""
    at = np.array([-1.0, 1.0])
    values = weight * at
    if basis.width:
        at = _knots(lambda v: weight * np.tanh(v), np.linspace(-_TAIL, _TAIL, _KNOTS), _PRECISE * fit.white)
        values = weight * np.tanh(at)
    knots = at * (basis.width or _STEP) * basis.driver.half
    return _law(cause, _EACH_ROW_S, **_driver(basis.driver), memory="none", knots=knots, weights=values)


def _table_of_time(fit: Fit, basis: Basis, weights: Array, law: _Law) -> TabulatedLaw:
    def function(t: Array) -> Array:
        run: Any = SimpleNamespace(cache={}, elapsed_s=t, bins=len(t))
        return np.asarray(basis.columns(run) @ weights)

    first, last = 0.5 * fit.data.runs[0].grid.bin_s, _LONGER * fit.data.longest_s
    knots = _knots(function, np.geomspace(first, last, _KNOTS), _PRECISE * fit.white)
    return law(memory="time", knots=knots, weights=function(knots))


def _beside(table: TabulatedLaw, of_rows: Collection[str]) -> bool:
    """Whether a function of one column is evaluated at each row: what a law of rows may cancel is no function of means."""
    return table.memory == "none" and not table.driver_2 and table.driver in of_rows


def _knots(function: Any, knots: Array, precision: float) -> Array:
    """Knots at which a function is known so well that monotone cubics between them are as precise as that."""
    from scipy.interpolate import PchipInterpolator

    while len(knots) < _MOST_KNOTS:
        middles = np.sort(np.r_[0.5 * (knots[1:] + knots[:-1]), 0.75 * knots[1:] + 0.25 * knots[:-1]])
        off = np.abs(PchipInterpolator(knots, function(knots))(middles) - function(middles)) > precision
        if not off.any():
            break
        knots = np.unique(np.r_[knots, middles[off]])
    return knots


def _of_curves(law: _Law, basis: Curves, weights: Array) -> TabulatedLaw:
    """Loops about two curves, each as a table over somewhat more than the range of the driver, straight between its knots."""
    driver, at = basis.driver, np.linspace(-BEYOND, BEYOND, _KNOTS_OF_CURVES)
    columns = gaussian_process(at, basis.width, basis.knots)
    mean, half = columns @ weights[: basis.knots], columns @ weights[basis.knots :]
    return law(
        **_driver(driver),
        memory="curves",
        knots=driver.in_unit(at),
        knots_2=(basis.radius * driver.half,),
        weights=mean + half,
        weights_2=mean - half,
    )


def _of_relays(law: _Law, basis: Relays | Preisach, weights: Array) -> list[TabulatedLaw]:
    """Single relays, or those of a density, half of which is on on average."""
    if isinstance(basis, Relays):
        return _relays(law, basis, np.array(basis.up), np.array(basis.down), weights)
    of_each = basis.densities() @ weights
    relays = _relays(law, basis, *dense(basis.levels), of_each)
    return [*relays, law(knots=(0.0,), weights=(-0.5 * float(np.sum(of_each)),))]


def _relays(law: _Law, basis: Relays | Preisach, up: Array, down: Array, weights: Array) -> list[TabulatedLaw]:
    """Relays as laws, one for each start that some of them have; those of next to no weight are left out."""
    driver, found = basis.driver, []
    used = np.abs(weights) > _SMALL * np.abs(weights).max(initial=0.0)
    used = used if used.any() else np.arange(len(weights)) == 0
    of_others = basis.start_of_others if isinstance(basis, Relays) else basis.start
    for start, there in sides(up, down, of_others, basis.histories).items():
        rows = used & there
        if rows.any():
            tables = {"knots": driver.in_unit(up[rows]), "knots_2": driver.in_unit(down[rows]), "weights": weights[rows]}
            found.append(law(**_driver(driver), **tables, memory="relays", start=start))
    return found


def _driver(driver: Driver) -> dict[str, Any]:
    found: dict[str, Any] = {"driver": driver.columns[0]}
    if driver.combination != "column":
        found |= {"driver_2": driver.columns[1], "combination": driver.combination}
    if driver.combination == "between":
        found["share"] = driver.share
    return found


def _law(cause: str, step_s: float, **fields: Any) -> TabulatedLaw:
    """A law of means over a step, its tables as arrays or tuples."""
    plain: dict[str, Any] = {
        name: tuple(value.tolist()) if isinstance(value, np.ndarray) else value for name, value in fields.items()
    }
    return TabulatedLaw(cause=cause, step_s=step_s, **plain)
