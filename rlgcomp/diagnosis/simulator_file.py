"""The fitted model as a simulator: mechanisms of the catalogue where their parameters express a term, tabulated laws elsewhere."""

from __future__ import annotations

import dataclasses
import functools
import itertools
import math
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from types import SimpleNamespace
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from rlgcomp.diagnosis.baseline import CONSTANT, amplitude_of_run
from rlgcomp.diagnosis.bases import Basis, Glitch, Own, Product, Shift, gaussian_process
from rlgcomp.diagnosis.data import Run
from rlgcomp.diagnosis.drivers import BEYOND, Driver, Path
from rlgcomp.diagnosis.errors import columns_of
from rlgcomp.diagnosis.fit import Fit
from rlgcomp.diagnosis.lateness import Late
from rlgcomp.diagnosis.memories import Curves, Followed, Plays, Preisach, Relays, dense, sides
from rlgcomp.diagnosis.relaxations import Conduction, Distributed, Lag, Spectrum
from rlgcomp.diagnosis.symmetries import Sign
from rlgcomp.diagnosis.times import Following, Since, SmoothSince, Wave
from rlgcomp.diagnosis.turning import TimesRate
from rlgcomp.errors import InputError
from rlgcomp.noise.processes import NoiseModel
from rlgcomp.physics.mechanism import Mechanism
from rlgcomp.physics.rotation_harmonics import RotationHarmonics
from rlgcomp.physics.tabulated_law import TabulatedLaw
from rlgcomp.simulation.simulator import Simulator
from rlgcomp.units import SECONDS_PER_HOUR

Array = npt.NDArray[np.float64]
_SAME: Final = 0.05  # of the white noise of a window mean, or of a term that no table holds: a mechanism off by less expresses it
_PRECISE: Final = 0.003  # of the same: error of a table between its knots
_KNOTS: Final = 27
_MOST_KNOTS: Final = 600
_KNOTS_OF_CURVES: Final = 161
_LONGER: Final = 3.0  # run lengths over which a law of time is tabulated
_FAR: Final = 1.0  # range beyond a table's end over which its slope is taken
_TAIL: Final = 10.0  # widths of a step beyond which it is level
_STEP: Final = 1e-6  # of a column's largest size, over which its sign is a straight line
_EACH_ROW_S: Final = 1e-9  # of a law that is evaluated at each row
_SMALL: Final = 1e-9  # of the largest weight of a sum of relays


@dataclasses.dataclass(frozen=True)
class SimulatorFile:
    """A simulator, and what of the fitted model it cannot hold.

    Parameters
    ----------
    simulator : Simulator
    left_out : tuple of str
        Regions of which a part belongs to single runs: histories, steps, phases.
    error : float
        Root mean square of window means of the training runs by which its prediction is off the fitted model's, terms of single
        runs left out, in units of the white noise.
    """

    simulator: Simulator
    left_out: tuple[str, ...]
    error: float


def simulator_of(fit: Fit, catalogue: Mapping[str, type[Mechanism]]) -> SimulatorFile:
    """The fitted model as a simulator.

    Parameters
    ----------
    fit : Fit
    catalogue : mapping of str to type of Mechanism
    """
    written = _Written(fit, catalogue)
    constant, mechanisms = written.baseline()
    left_out, repeating = list(fit.baseline.by_run), np.zeros(len(fit.data))
    for k, (member, bases) in enumerate(fit.parts):
        if any(isinstance(basis, Own) and basis.column is not None for basis, _ in bases):
            repeating += fit.data.means(functools.partial(fit.term, k))
            continue
        more, shift, whole = written.term(k)
        mechanisms += more
        constant += shift
        if not whole:
            left_out.append(member.form.region)
        repeating += written.repeating(k)
    simulator = written.with_constant(mechanisms, constant)
    fitted = fit.data.means(fit.baseline.columns) @ fit.baseline.repeating(fit.solution.numbers) + repeating
    own = [
        run.means(run.on_bins_of_rows(simulator.expected_deg_h(run.recording)) - run.on_bins(written.stated(run)))
        for run in fit.data.runs
    ]
    error = float(np.sqrt(np.mean((np.concatenate(own) - fitted) ** 2))) / max(fit.white, 1e-300)
    noise = noise_of(fit)
    return SimulatorFile(dataclasses.replace(simulator, noise=noise), tuple(left_out), error)


def residual_of(simulator: Simulator, fit: Fit, run: Run) -> Array:
    """What a run's window means hold beyond the prediction of a simulator file.

    Parameters
    ----------
    simulator : Simulator
        Made of the fit.
    fit : Fit
    run : Run
    """
    predicted = run.on_bins_of_rows(simulator.expected_deg_h(run.recording)) - run.on_bins(fit.baseline.stated(run.binned))
    return np.asarray(run.output[: len(run.windows)] - run.window_means(predicted))


def mechanisms_of(fit: Fit, k: int, catalogue: Mapping[str, type[Mechanism]]) -> tuple[Mechanism, ...]:
    """What of the k-th member holds in other runs, as mechanisms whose sum it is; none where all of it belongs to single runs."""
    mechanisms, constant, _ = _Written(fit, catalogue).term(k)
    if mechanisms and constant:
        mechanisms = [*mechanisms, TabulatedLaw(cause="constant bias", knots=(0.0,), weights=(constant,))]
    return tuple(mechanisms)


def noise_of(fit: Fit) -> NoiseModel:
    """The noise of the fitted model, a wander of something unrecorded left out."""
    window_h = fit.data.runs[0].grid.window_s / SECONDS_PER_HOUR
    longest_h = window_h * max(len(run.full) for run in fit.data.runs)
    return NoiseModel(
        angle_random_walk_deg_sqrt_h=fit.white * math.sqrt(window_h),
        bias_instability_deg_h=fit.white * fit.state.noise.flicker,
        rate_random_walk_deg_h_sqrt_h=fit.white * fit.state.noise.walk / math.sqrt(longest_h),
    )


class _Written:
    """Parts of a fit as mechanisms."""

    def __init__(self, fit: Fit, catalogue: Mapping[str, type[Mechanism]]) -> None:
        self.fit, self.catalogue = fit, catalogue
        self.grid = fit.data.runs[0].grid

    def stated(self, run: Run) -> Array:
        return self.fit.baseline.stated(run.binned)

    # --- the baseline ----------------------------------------------------------------------------------------------------------

    def baseline(self) -> tuple[float, list[Mechanism]]:
        """The constant, and the simulator's mechanisms with their fitted numbers."""
        fit = self.fit
        found: list[Mechanism] = []
        constant = 0.0
        for mechanism in fit.baseline.simulator.mechanisms:
            fitted = _with(mechanism, self._values(mechanism))
            own = fit.baseline.own.get(mechanism.name)
            if own is not None and fitted.amplitude_parameters():
                weights = np.array([getattr(fitted, p.name) for p in fitted.amplitude_parameters()]) / own.per_unit()
                column = self.fit.bank.columns(own) @ weights
                other = self._means(fitted)
                if np.std(column - other) > _SAME * fit.white:
                    pieces, whole = self._pieces(own, weights, mechanism.name)
                    if whole:
                        found += pieces
                        continue
                constant += float(np.mean(column - other))
            found.append(fitted)
        return constant + float(fit.numbers.get("", {}).get(CONSTANT, _ZERO).value), found

    def _values(self, mechanism: Mechanism) -> dict[str, float]:
        """Fitted numbers of a mechanism of the baseline; of an amplitude by run their root mean square."""
        estimates = {name: one.value for name, one in self.fit.numbers.get(mechanism.name, {}).items()}
        runs = [run.name for run in self.fit.data.runs]
        for parameter in mechanism.amplitude_parameters():
            of_runs = [estimates[name] for run in runs if (name := amplitude_of_run(parameter.name, run)) in estimates]
            if of_runs:
                estimates[parameter.name] = float(np.copysign(np.sqrt(np.mean(np.square(of_runs))), np.mean(of_runs)))
        return estimates

    def with_constant(self, mechanisms: list[Mechanism], constant: float) -> Simulator:
        """The simulator with a constant bias in the mechanism that has one, or as a law by itself."""
        base = self.fit.baseline.simulator
        holder = next((k for k, one in enumerate(mechanisms) if one.constant and not one.empirical), None)
        if holder is not None:
            one = mechanisms[holder]
            with_it = _with(one, {one.constant: getattr(one, one.constant) + constant})
            constant -= getattr(with_it, one.constant) - getattr(one, one.constant)
            mechanisms = [*mechanisms[:holder], with_it, *mechanisms[holder + 1 :]]
        if abs(constant) > 1e-12 * self.fit.white:
            mechanisms = [*mechanisms, TabulatedLaw(cause="constant bias", knots=(0.0,), weights=(constant,))]
        names = {one.name for one in mechanisms}
        free = {name: names_of for name, names_of in base.free.items() if name in names}
        return dataclasses.replace(base, mechanisms=tuple(mechanisms), free=free)

    # --- terms -----------------------------------------------------------------------------------------------------------------

    def term(self, k: int) -> tuple[list[Mechanism], float, bool]:
        """Mechanisms that are one term together, a constant, and whether they are all of it."""
        member, _ = self.fit.parts[k]
        named, rest = self._leading(k)
        pieces, whole = self._all(rest, member.form.region)
        mechanism, constant = ([], 0.0) if named is None else ([named[0]], named[1])
        return [*mechanism, *pieces], constant, whole

    def _leading(self, k: int) -> tuple[tuple[Mechanism, float] | None, list[tuple[Basis, Array]]]:
        """The mechanism that expresses the leading bases of a term, with a constant, and the other bases with their weights."""
        member, bases = self.fit.parts[k]
        weights, lead = self.fit.weights(k), len(member.form.lead)
        name = member.form.region if member.form.region in self.catalogue else ""
        edges = np.cumsum([0, *(self.fit.bank.columns(basis).shape[1] for basis, _ in bases)])
        parts = [(basis, scale * weights[a:b]) for (basis, scale), a, b in zip(bases, edges[:-1], edges[1:], strict=True)]
        named = self._named(k, parts[0], name) if lead == 1 and name else _orders(parts[:lead])
        return named, parts if named is None else parts[lead:]

    def _named(self, k: int, part: tuple[Basis, Array], name: str) -> tuple[Mechanism, float] | None:
        """The mechanism whose parameters express the leading basis, where one does, and by what constant it is off."""
        basis, weights = part
        if isinstance(basis, Own):
            amplitudes = basis.mechanism.amplitude_parameters()
            values = {p.name: float(w) for p, w in zip(amplitudes, weights, strict=True)}
            point = _checked(basis.mechanism, values)
            return None if point is None else (point, 0.0)
        estimates = self.fit.parameters(k, self.catalogue[name])
        if not estimates:
            return None
        values = {key: one.value for key, one in estimates.items()}
        wanted = self.fit.bank.columns(basis) @ weights
        scale = max(self.fit.white, float(np.std(wanted))) if isinstance(basis, Followed) else self.fit.white
        best: tuple[float, Mechanism, float] | None = None
        for point in _settings(self.catalogue[name]):
            mechanism = _checked(point, values)
            if mechanism is None or not _used(mechanism) <= set(values):
                continue
            off = wanted - self._means(mechanism)
            size = float(np.std(off))
            if size < _SAME * scale and (best is None or size < best[0]):
                best = size, mechanism, float(np.mean(off))
        return None if best is None else best[1:]

    def _means(self, mechanism: Mechanism) -> Array:
        weights = np.array([float(getattr(mechanism, p.name)) for p in mechanism.amplitude_parameters()])
        return self.fit.data.means(lambda run: run.on_bins_of_rows(mechanism.basis(run.recording) @ weights))

    def repeating(self, k: int) -> Array:
        """Window means of what of a term does not belong to single runs."""
        _, rest = self._leading(k)
        total = self.fit.data.means(functools.partial(self.fit.term, k))
        for basis, weights in rest:
            if not self._pieces(basis, np.zeros(len(weights)), "")[1]:
                total = total - self.fit.bank.columns(basis) @ weights
        return np.asarray(total)

    def _all(self, parts: Iterable[tuple[Basis, Array]], cause: str) -> tuple[list[TabulatedLaw], bool]:
        """Parts as tabulated laws, those that are functions of one path in one table, and whether they are all."""
        found: list[TabulatedLaw] = []
        functions: dict[Path, list[tuple[Basis, Array]]] = {}
        whole = True
        for basis, weights in parts:
            path = getattr(basis, "path", None)
            if isinstance(path, Path):
                functions.setdefault(path, []).append((basis, weights))
                continue
            pieces, complete = self._pieces(basis, weights, cause)
            found, whole = found + pieces, whole and complete
        of_rows = {law.driver for law in found if law.step_s == _EACH_ROW_S}
        tables = [self._table(path, of_path, cause) for path, of_path in functions.items()]
        tables = [dataclasses.replace(one, step_s=_EACH_ROW_S) if _beside(one, of_rows) else one for one in tables]
        return [*tables, *found], whole

    def _pieces(self, basis: Basis, weights: Array, cause: str) -> tuple[list[TabulatedLaw], bool]:
        """A basis with its weights as tabulated laws; False beside none where it belongs to single runs."""
        law = functools.partial(TabulatedLaw, cause=cause, step_s=self.grid.bin_s)
        if isinstance(getattr(basis, "path", None), Path):
            return [self._table(basis.path, [(basis, weights)], cause)], True  # type: ignore[attr-defined]
        match basis:
            case Shift() | Glitch():
                pieces, whole = self._pieces(basis.basis, weights, cause)
                change = "derivative" if isinstance(basis, Shift) else "glitch"
                return [dataclasses.replace(piece, change=change) for piece in pieces], whole
            case Lag() if not basis.behind:
                (w,), d = weights.tolist(), basis.driver
                ends, slope = (d.centre - d.half, d.centre + d.half), w / d.half
                of = _driver(d) | {"memory": "lag", "time_s": basis.time_constant_s}
                return [law(**of, knots=ends, weights=(-w, w), slope_below=slope, slope_above=slope)], True
            case Lag() | Conduction() | Distributed() | Spectrum():
                times, mixed = _lags(basis, weights)
                of = _driver(basis.driver) | {"memory": "lags"}
                return [law(**of, knots=tuple(times), weights=tuple((mixed / basis.driver.half).tolist()))], True
            case Plays():
                radii = basis.radii() * basis.driver.half
                radii = radii[:-1] if basis.spread else radii[-1:]
                each = np.full(len(radii), float(weights[0]) / basis.driver.half / len(radii))
                of = _driver(basis.driver) | {"memory": "plays", "start": basis.start}
                of["knots_2"] = tuple((basis.driver.centre + basis.driver.half * basis.before()).tolist())
                return [law(**of, knots=tuple(radii.tolist()), weights=tuple(each.tolist()))], True
            case Relays() | Preisach() | Curves():
                return _of_loops(law, basis, weights), True
            case Product():
                one, other = basis.one.driver, basis.other.driver
                product = float(weights[0]) / (one.half * other.half)
                of = {"driver": one.columns[0], "driver_2": other.columns[0], "memory": "product"}
                return [law(**of, knots=(one.centre, other.centre), weights=(product,))], True
            case Wave() | Following():
                return self._waves(basis, weights, law), True
            case TimesRate():
                pieces, whole = self._pieces(basis.basis, weights, cause)
                rate = basis.rate.driver
                return [dataclasses.replace(one, factor=rate.columns[0], scale=one.scale / rate.half) for one in pieces], whole
            case Sign():
                return [self._of_sign(basis, float(weights[0]), cause)], True
            case Since() | SmoothSince():
                return [self._table_of_time(basis, weights, law)], True
            case Late():
                return self._of_late(basis, float(weights[0]), cause)
        return [], False

    def _waves(self, basis: Wave | Following, weights: Array, law: Callable[..., TabulatedLaw]) -> list[TabulatedLaw]:
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

    def _of_late(self, late: Late, lag: float, cause: str) -> tuple[list[TabulatedLaw], bool]:
        """What a late column brings, as derivatives by time of functions of it; False beside none where it has other parts.

        Parameters
        ----------
        late : Late
        lag : float
            In windows.
        cause : str
        """
        baseline, parts, data = late.prediction.baseline, late.prediction.parts, self.fit.data
        functions: dict[Path, list[tuple[Basis, Array]]] = {}
        for basis, weights in parts:
            path = getattr(basis, "path", None)
            if isinstance(path, Path) and path.memory == "none" and path.driver.columns == (late.column,):
                functions.setdefault(path, []).append((basis, weights * lag * self.grid.bins))
            elif late.column in columns_of([basis], data):
                return [], False
        if late.column in columns_of([baseline.simulator.mechanisms, baseline.own], data):
            return [], False
        tables = [self._table(path, of_path, cause) for path, of_path in functions.items()]
        return [dataclasses.replace(table, change="derivative") for table in tables], True

    def _table(self, path: Path, parts: list[tuple[Basis, Array]], cause: str) -> TabulatedLaw:
        """Functions of one path together as one table."""

        def function(v: Array) -> Array:
            run: Any = SimpleNamespace(cache={path: v}, bins=len(v))
            return np.sum([basis.columns(run) @ weights for basis, weights in parts], axis=0)

        reach = max(basis.reach for basis, _ in parts)
        knots = tabulated(function, np.linspace(-reach, reach, _KNOTS), _PRECISE * self.fit.white)
        values = function(knots)
        half = path.driver.half * path.half
        offset = 0.0 if path.memory == "rate" else path.driver.centre
        raw = offset + path.driver.half * path.centre + half * knots
        below = (values[0] - function(knots[:1] - _FAR)[0]) / (_FAR * half)
        above = (function(knots[-1:] + _FAR)[0] - values[-1]) / (_FAR * half)
        of = _driver(path.driver) | ({} if path.memory == "none" else {"memory": path.memory, "time_s": path.time_s})
        return TabulatedLaw(
            cause=cause,
            step_s=self.grid.bin_s,
            knots=tuple(raw.tolist()),
            weights=tuple(values.tolist()),
            slope_below=float(below),
            slope_above=float(above),
            **({"memory": "none"} | of),
        )

    def _of_sign(self, basis: Sign, weight: float, cause: str) -> TabulatedLaw:
        """A sign, or a hyperbolic tangent of a width, at each row."""
        at = np.array([-1.0, 1.0])
        values = weight * at
        if basis.width:
            at = tabulated(lambda v: weight * np.tanh(v), np.linspace(-_TAIL, _TAIL, _KNOTS), _PRECISE * self.fit.white)
            values = weight * np.tanh(at)
        knots = at * (basis.width or _STEP) * basis.driver.half
        made = functools.partial(TabulatedLaw, cause=cause, step_s=_EACH_ROW_S, memory="none", **_driver(basis.driver))
        return made(knots=tuple(knots.tolist()), weights=tuple(values.tolist()))

    def _table_of_time(self, basis: Basis, weights: Array, law: Any) -> TabulatedLaw:
        def function(t: Array) -> Array:
            run: Any = SimpleNamespace(cache={}, elapsed_s=t, bins=len(t))
            return np.asarray(basis.columns(run) @ weights)

        first, last = 0.5 * self.grid.bin_s, _LONGER * self.fit.data.longest_s
        knots = tabulated(function, np.geomspace(first, last, _KNOTS), _PRECISE * self.fit.white)
        return law(memory="time", knots=tuple(knots.tolist()), weights=tuple(function(knots).tolist()))


def _beside(table: TabulatedLaw, of_rows: Collection[str]) -> bool:
    """Whether a function of one column is evaluated at each row: what a law of rows may cancel is no function of means."""
    return table.memory == "none" and not table.driver_2 and table.driver in of_rows


@dataclasses.dataclass(frozen=True)
class _Zero:
    value: float = 0.0


_ZERO: Final = _Zero()


def _orders(parts: Sequence[tuple[Basis, Array]]) -> tuple[Mechanism, float] | None:
    """Several orders of a table's angle as one mechanism, and no constant; None where they are something else."""
    found: RotationHarmonics | None = None
    for j, (basis, weights) in enumerate(parts, 1):
        if not isinstance(basis, Own) or not isinstance(basis.mechanism, RotationHarmonics) or len(basis.mechanism.orders) > 1:
            return None
        numbers = {f"cosine_{j}_deg_h": float(weights[0]), f"sine_{j}_deg_h": float(weights[1])}
        found = dataclasses.replace(found or basis.mechanism, **{f"order_{j}": basis.mechanism.order_1}, **numbers)  # type: ignore[arg-type]
    return None if found is None else (found, 0.0)


def tabulated(function: Any, knots: Array, precision: float) -> Array:
    """Knots at which a function is known so well that monotone cubics between them are as precise as that."""
    from scipy.interpolate import PchipInterpolator

    while len(knots) < _MOST_KNOTS:
        middles = np.sort(np.r_[0.5 * (knots[1:] + knots[:-1]), 0.75 * knots[1:] + 0.25 * knots[:-1]])
        off = np.abs(PchipInterpolator(knots, function(knots))(middles) - function(middles)) > precision
        if not off.any():
            break
        knots = np.unique(np.r_[knots, middles[off]])
    return knots


def _of_loops(law: Any, basis: Relays | Preisach | Curves, weights: Array) -> list[TabulatedLaw]:
    return [_of_curves(law, basis, weights)] if isinstance(basis, Curves) else _of_relays(law, basis, weights)


def _of_curves(law: Any, basis: Curves, weights: Array) -> TabulatedLaw:
    """Loops about two curves, each as a table over somewhat more than the range of the driver, straight between its knots."""
    driver, at = basis.driver, np.linspace(-BEYOND, BEYOND, _KNOTS_OF_CURVES)
    columns = gaussian_process(at, basis.width, basis.knots)
    mean, half = columns @ weights[: basis.knots], columns @ weights[basis.knots :]
    return law(
        **_driver(driver),
        memory="curves",
        knots=tuple((driver.centre + driver.half * at).tolist()),
        knots_2=(basis.radius * driver.half,),
        weights=tuple((mean + half).tolist()),
        weights_2=tuple((mean - half).tolist()),
    )


def _of_relays(law: Any, basis: Relays | Preisach, weights: Array) -> list[TabulatedLaw]:
    """Single relays, or those of a density, half of which is on on average."""
    if isinstance(basis, Relays):
        return _relays(law, basis, np.array(basis.up), np.array(basis.down), weights)
    of_each = basis.densities() @ weights
    relays = _relays(law, basis, *dense(basis.levels), of_each)
    return [*relays, law(knots=(0.0,), weights=(-0.5 * float(np.sum(of_each)),))]


def _relays(law: Any, basis: Relays | Preisach, up: Array, down: Array, weights: Array) -> list[TabulatedLaw]:
    """Relays as laws, one for each start that some of them have; those of next to no weight are left out."""
    driver, found = basis.driver, []
    used = np.abs(weights) > _SMALL * np.abs(weights).max(initial=0.0)
    used = used if used.any() else np.arange(len(weights)) == 0
    of_others = basis.start_of_others if isinstance(basis, Relays) else basis.start
    for start, there in sides(up, down, of_others, basis.histories).items():
        rows = used & there
        if rows.any():
            raw_up, raw_down = (driver.centre + driver.half * level[rows] for level in (up, down))
            tables = {
                "knots": tuple(raw_up.tolist()),
                "knots_2": tuple(raw_down.tolist()),
                "weights": tuple(weights[rows].tolist()),
            }
            found.append(law(**_driver(driver), **tables, memory="relays", start=start))
    return found


def _lags(basis: Lag | Conduction | Distributed | Spectrum, weights: Array) -> tuple[list[float], Array]:
    """Time constants and weights of what is behind the driver."""
    if isinstance(basis, Lag):
        return [basis.time_constant_s], weights
    times, mixture = basis.mixture()
    return times.tolist(), mixture @ weights


def _driver(driver: Driver) -> dict[str, Any]:
    found: dict[str, Any] = {"driver": driver.columns[0]}
    if driver.combination != "column":
        found |= {"driver_2": driver.columns[1], "combination": driver.combination}
    if driver.combination == "between":
        found["share"] = driver.share
    return found


def _settings(mechanism: type[Mechanism]) -> Iterable[Mechanism]:
    """The mechanism with each choice of its settings."""
    choices = [(p.name, p.choices) for p in mechanism.parameters() if p.role == "setting" and p.choices]
    for values in itertools.product(*(options for _, options in choices)):
        try:
            yield mechanism(**dict(zip((name for name, _ in choices), values, strict=True)))
        except InputError:
            continue


def _used(mechanism: Mechanism) -> set[str]:
    """Parameters in use that are numbers to be found."""
    return {p.name for p in (*mechanism.amplitude_parameters(), *mechanism.shape_parameters())}


def _checked(mechanism: Mechanism, values: Mapping[str, float]) -> Mechanism | None:
    """The mechanism with some values; None where they are out of bounds."""
    try:
        return type(mechanism)(**(mechanism.to_mapping() | dict(values)))
    except InputError:
        return None


def _with(mechanism: Mechanism, values: Mapping[str, float]) -> Mechanism:
    """The mechanism with some values, each within its bounds."""
    bounds = {p.name: (p.low, p.high) for p in mechanism.parameters()}
    inside = {name: float(np.clip(value, *bounds[name])) for name, value in values.items() if name in bounds}
    return type(mechanism)(**(mechanism.to_mapping() | inside))
