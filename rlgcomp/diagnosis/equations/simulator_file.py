"""The fitted model as a simulator: mechanisms of the catalogue where their parameters express a term, tabulated laws elsewhere."""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np
import numpy.typing as npt

from rlgcomp.diagnosis.answer.fit import Fit
from rlgcomp.diagnosis.data import Run
from rlgcomp.diagnosis.equations.parameters import points_of, settings_of
from rlgcomp.diagnosis.equations.stated import are_decays, together
from rlgcomp.diagnosis.equations.tabulated_laws import laws_of
from rlgcomp.diagnosis.forms.bases import Basis, Own
from rlgcomp.diagnosis.forms.drivers import Path
from rlgcomp.diagnosis.forms.memories import Followed
from rlgcomp.diagnosis.regions.baseline import CONSTANT, amplitude_of_run
from rlgcomp.errors import InputError
from rlgcomp.noise.processes import NoiseModel
from rlgcomp.physics.mechanism import Mechanism
from rlgcomp.physics.tabulated_law import TabulatedLaw
from rlgcomp.simulation.simulator import Simulator
from rlgcomp.units import SECONDS_PER_HOUR

Array = npt.NDArray[np.float64]
_Catalogue = Mapping[str, type[Mechanism]]
_OF_WINDOWS: Final = 0.2  # the same of a slope over rows for one over bins: its numbers are worth more than what it is off by
_SAME: Final = 0.05  # of the white noise of a window mean, or of a term that no table holds: a mechanism off by less expresses it


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


def simulator_of(fit: Fit, catalogue: _Catalogue) -> SimulatorFile:
    """The fitted model as a simulator, the terms of the catalogue's mechanisms among it by their names."""
    constant, mechanisms = _baseline(fit)
    left_out, repeating = list(fit.baseline.by_run), np.zeros(len(fit.data))
    for k, (member, bases) in enumerate(fit.parts):
        if any(isinstance(basis, Own) and basis.column is not None for basis, _ in bases):
            repeating += fit.data.means(functools.partial(fit.term, k))
            continue
        more, shift, whole = _term(fit, k, catalogue)
        mechanisms += more
        constant += shift
        if not whole:
            left_out.append(member.form.region)
        repeating += _repeating(fit, k, catalogue)
    simulator = _with_constant(fit, mechanisms, constant)
    calibrated = fit.data.means(fit.baseline.columns) @ fit.baseline.repeating(fit.solution.numbers)
    fitted = calibrated + fit.data.means(fit.baseline.changed) + repeating
    own = np.concatenate([run.means(_beyond_stated(simulator, fit, run)) for run in fit.data.runs])
    error = float(np.sqrt(np.mean((own - fitted) ** 2))) / max(fit.white, 1e-300)
    return SimulatorFile(dataclasses.replace(simulator, noise=noise_of(fit)), tuple(left_out), error)


def residual_of(simulator: Simulator, fit: Fit, run: Run) -> Array:
    """What a run's window means hold beyond the prediction of a simulator that was made of a fit, shape (windows,)."""
    return np.asarray(run.output[: len(run.windows)] - run.window_means(_beyond_stated(simulator, fit, run)))


def _beyond_stated(simulator: Simulator, fit: Fit, run: Run) -> Array:
    """A simulator's prediction of a run less what the given simulator states, shape (bins,)."""
    stated = fit.baseline.stated_on(run) - fit.baseline.changed(run)
    return run.on_bins_of_rows(simulator.expected_deg_h(run.recording)) - stated


def mechanisms_of(fit: Fit, k: int, catalogue: _Catalogue) -> tuple[Mechanism, ...]:
    """What of the k-th member holds in other runs, as mechanisms whose sum it is; none where all of it belongs to single runs."""
    mechanisms, constant, _ = _term(fit, k, catalogue)
    return tuple([*mechanisms, _bias(constant)] if mechanisms and constant else mechanisms)


def _bias(constant: float) -> TabulatedLaw:
    return TabulatedLaw(cause="constant bias", knots=(0.0,), weights=(constant,))


def noise_of(fit: Fit) -> NoiseModel:
    """The noise of the fitted model, a wander of something unrecorded left out."""
    window_h = fit.data.runs[0].grid.window_s / SECONDS_PER_HOUR
    longest_h = window_h * fit.data.longest
    return NoiseModel(
        angle_random_walk_deg_sqrt_h=fit.white * math.sqrt(window_h),
        bias_instability_deg_h=fit.white * fit.state.noise.flicker,
        rate_random_walk_deg_h_sqrt_h=fit.white * fit.state.noise.walk / math.sqrt(longest_h),
    )


# --- the baseline ----------------------------------------------------------------------------------------------------------


def _baseline(fit: Fit) -> tuple[float, list[Mechanism]]:
    """The constant, and the simulator's mechanisms with their fitted numbers."""
    found: list[Mechanism] = []
    constant = 0.0
    for mechanism in fit.baseline.simulator.mechanisms:
        fitted = _with(mechanism, _values(fit, mechanism))
        own = fit.baseline.own.get(mechanism.name)
        if own is not None and fitted.amplitude_parameters():
            weights = fitted.amplitude_values() / own.per_unit()
            column = fit.bank.columns(own) @ weights
            other, limit = _means(fit, fitted), _SAME
            if np.std(column - other) > limit * fit.white and (over := _over_window(fitted, own)) != fitted:
                fitted, other, limit = over, _means(fit, over), _OF_WINDOWS
            if np.std(column - other) > limit * fit.white:
                pieces, whole = laws_of(fit, [(own, weights)], mechanism.name)
                if whole:
                    found += pieces
                    continue
            constant += float(np.mean(column - other))
        found.append(fitted)
    fitted_constant = fit.numbers.get("", {}).get(CONSTANT)
    return constant + (0.0 if fitted_constant is None else float(fitted_constant.value)), found


def _values(fit: Fit, mechanism: Mechanism) -> dict[str, float]:
    """Fitted numbers of a mechanism of the baseline; of an amplitude by run their root mean square."""
    estimates = {name: one.value for name, one in fit.numbers.get(mechanism.name, {}).items()}
    runs = [run.name for run in fit.data.runs]
    for parameter in mechanism.amplitude_parameters():
        of_runs = [estimates[name] for run in runs if (name := amplitude_of_run(parameter.name, run)) in estimates]
        if of_runs:
            estimates[parameter.name] = float(np.copysign(np.sqrt(np.mean(np.square(of_runs))), np.mean(of_runs)))
    return estimates


def _with_constant(fit: Fit, mechanisms: list[Mechanism], constant: float) -> Simulator:
    """The simulator with a constant bias in the mechanism that has one, or as a law by itself."""
    base = fit.baseline.simulator
    holder = next((k for k, one in enumerate(mechanisms) if one.constant and not one.empirical), None)
    if holder is not None:
        one = mechanisms[holder]
        with_it = _with(one, {one.constant: getattr(one, one.constant) + constant})
        constant -= getattr(with_it, one.constant) - getattr(one, one.constant)
        mechanisms = [*mechanisms[:holder], with_it, *mechanisms[holder + 1 :]]
    if abs(constant) > 1e-12 * fit.white:
        mechanisms = [*mechanisms, _bias(constant)]
    names = {one.name for one in mechanisms}
    free = {name: names_of for name, names_of in base.free.items() if name in names}
    return dataclasses.replace(base, mechanisms=tuple(mechanisms), free=free)


# --- terms -----------------------------------------------------------------------------------------------------------------


def _term(fit: Fit, k: int, catalogue: _Catalogue) -> tuple[list[Mechanism], float, bool]:
    """Mechanisms that are one term together, a constant, and whether they are all of it."""
    member, _ = fit.parts[k]
    named, rest = _leading(fit, k, catalogue)
    pieces, whole = laws_of(fit, rest, member.form.region)
    mechanism, constant = ([], 0.0) if named is None else ([named[0]], named[1])
    return [*mechanism, *pieces], constant, whole


def _leading(fit: Fit, k: int, catalogue: _Catalogue) -> tuple[tuple[Mechanism, float] | None, list[tuple[Basis, Array]]]:
    """The mechanism that expresses the leading bases of a term, with a constant, and the other bases with their weights."""
    member, bases = fit.parts[k]
    weights, lead = fit.weights(k), len(member.form.lead)
    form = catalogue.get(member.form.region)
    edges = np.cumsum([0, *(fit.bank.columns(basis).shape[1] for basis, _ in bases)])
    parts = [(basis, scale * weights[a:b]) for (basis, scale), a, b in zip(bases, edges[:-1], edges[1:], strict=True)]
    if form is not None and lead == 1:
        named = _named(fit, k, parts[0], form)
    else:
        named = _orders(parts[:lead]) or (None if form is None else _decays(fit, parts[:lead], form))
    return named, parts if named is None else parts[lead:]


def _named(fit: Fit, k: int, part: tuple[Basis, Array], form: type[Mechanism]) -> tuple[Mechanism, float] | None:
    """The mechanism whose parameters express the leading basis, where one does, and by what constant it is off."""
    basis, weights = part
    if isinstance(basis, Own):
        amplitudes = basis.mechanism.amplitude_parameters()
        values = {p.name: float(w) for p, w in zip(amplitudes, weights, strict=True)}
        point = _checked(basis.mechanism, values)
        return None if point is None else (point, 0.0)
    values = fit.parameters(k, form)
    if not values:
        return None
    wanted = fit.bank.columns(basis) @ weights
    scale = max(fit.white, float(np.std(wanted))) if isinstance(basis, Followed) else fit.white
    best: tuple[float, Mechanism, float] | None = None
    for point in points_of(form, settings_of(form)):
        mechanism = _checked(_over_window(point, basis), values)
        if mechanism is None or not _used(mechanism) <= set(values):
            continue
        off = wanted - _means(fit, mechanism)
        size = float(np.std(off))
        if size < _SAME * scale and (best is None or size < best[0]):
            best = size, mechanism, float(np.mean(off))
    return None if best is None else best[1:]


def _over_window(mechanism: Mechanism, basis: Basis) -> Mechanism:
    """A mechanism of a rate of change with slopes over the window of a basis; any other as it is."""
    path = getattr(basis, "path", None)
    if not isinstance(path, Path) or path.memory != "rate" or not hasattr(mechanism, "averaging_s"):
        return mechanism
    return _with(mechanism, {"averaging_s": path.time_s})


def _means(fit: Fit, mechanism: Mechanism) -> Array:
    return fit.data.means(lambda run: run.on_bins_of_rows(mechanism.basis(run.recording) @ mechanism.amplitude_values()))


def _repeating(fit: Fit, k: int, catalogue: _Catalogue) -> Array:
    """Window means of what of a term does not belong to single runs."""
    _, rest = _leading(fit, k, catalogue)
    total = fit.data.means(functools.partial(fit.term, k))
    for basis, weights in rest:
        if not laws_of(fit, [(basis, np.zeros(len(weights)))], "")[1]:
            total = total - fit.bank.columns(basis) @ weights
    return np.asarray(total)


def _orders(parts: Sequence[tuple[Basis, Array]]) -> tuple[Mechanism, float] | None:
    """Several orders of a table's angle as one mechanism, and no constant; None where they are something else."""
    found = together([basis for basis, _ in parts])
    if found is None:
        return None
    values = np.concatenate([weights for _, weights in parts])
    numbers = {p.name: float(value) for p, value in zip(found.amplitude_parameters(), values, strict=True)}
    return dataclasses.replace(found, **numbers), 0.0  # type: ignore[arg-type]


def _decays(fit: Fit, parts: Sequence[tuple[Basis, Array]], form: type[Mechanism]) -> tuple[Mechanism, float] | None:
    """Two decays of one sign as one mechanism, and by what constant it is off; None where they are something else."""
    if "two" not in settings_of(form).get("terms", ()) or not are_decays([basis for basis, _ in parts]):
        return None
    fast_s, slow_s = sorted(basis.parameters()["time_constant_s"] for basis, _ in parts)
    times = {"time_constant_s": fast_s, "slower_time_constant_s": slow_s}
    single = [_checked(form(terms="two"), {**times, "initial_deg_h": 1.0, "slower_share": share}) for share in (0.0, 1.0)]  # type: ignore[call-arg]
    if None in single:
        return None
    term = np.sum([fit.bank.columns(basis) @ weights for basis, weights in parts], axis=0)
    columns = np.column_stack([_means(fit, one) for one in single if one is not None])
    fast, slow = np.linalg.lstsq(columns, term, rcond=1e-12)[0].tolist()  # rows count from the first one, bins from its beginning
    if fast * slow <= 0.0 or np.std(columns @ (fast, slow) - term) > _SAME * fit.white:
        return None
    values = times | {"initial_deg_h": fast + slow, "slower_share": slow / (fast + slow)}
    mechanism = _checked(form(terms="two"), values)  # type: ignore[call-arg]
    return None if mechanism is None else (mechanism, float(np.mean(term - columns @ (fast, slow))))


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
