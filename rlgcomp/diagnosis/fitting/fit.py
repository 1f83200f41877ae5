r"""Parameters of a chosen set of causes with their standard deviations, and the simulators that follow from them.

Generalised least squares of baseline and causes together, shapes linearised about their values and moved by Gauss–Newton:

.. math:: (\hat\beta, \hat a, \hat\theta) : \quad \min \lVert L^{-1} (y - X \beta - \sum_m \Phi_m(\theta_m) a_m) \rVert^2,
    \qquad \mathrm{cov} = \hat\sigma^2 (J^T \Sigma^{-1} J)^{-1}

A weak step's place is far less certain than its slope says: where the likelihood along a shape is wider than that, the standard
deviation is the likelihood's. A thermometer that is late by some seconds moves a threshold and makes a loop look narrower: what it
would do to each parameter adds to the standard deviations.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Collection, Mapping, Sequence
from typing import Final

import numpy as np
import numpy.typing as npt

from rlgcomp.diagnosis.fitting.design import Design, steady_columns
from rlgcomp.diagnosis.fitting.drawn_paths import DrawnPaths
from rlgcomp.diagnosis.fitting.linearised import STEPS, amplitudes, moved, slopes, solve, whole
from rlgcomp.diagnosis.naming.candidates import Candidate
from rlgcomp.diagnosis.naming.telegraph import likeliest_dwell_s
from rlgcomp.diagnosis.noise.whitening import NoiseShape, Rows
from rlgcomp.diagnosis.question.events import PARTLY, STEP
from rlgcomp.diagnosis.question.free_part import OWN_BIAS
from rlgcomp.diagnosis.question.problem import Problem
from rlgcomp.diagnosis.question.windows import Windows
from rlgcomp.diagnosis.result import Estimate
from rlgcomp.noise.processes import NoiseModel
from rlgcomp.physics.mechanism import Mechanism
from rlgcomp.simulation.simulator import Simulator
from rlgcomp.units import SECONDS_PER_HOUR

Array = npt.NDArray[np.float64]
_CANCELLING: Final = 0.5  # of the rms of the smallest law


@dataclasses.dataclass(frozen=True)
class FittedCause:
    """A cause with its parameters and what it adds to the training rows.

    Parameters
    ----------
    mechanism : Mechanism
    estimates : mapping
        Value, standard deviation and unit by parameter.
    contribution_deg_h : ndarray, shape (n,)
    known : bool
        The simulator has it, with other numbers.
    chi_square : float
        Of its amplitudes together against none, shapes held: one whose shape is hardly known may be sure all the same.
    """

    mechanism: Mechanism
    estimates: dict[str, Estimate]
    contribution_deg_h: Array
    known: bool
    chi_square: float = math.inf

    @property
    def vanishes(self) -> bool:
        """Whether its size is nothing: its amplitudes together, within what noise makes of so many, or each of the wrong sign; of a
        mechanism that is settled, each number within a standard deviation of zero."""
        if self.known or self.mechanism.empirical:
            return False
        sizes = {p.name: p.low for p in self.mechanism.parameters() if p.role == "amplitude" and p.name in self.estimates}
        if type(self.mechanism).canonical is not Mechanism.canonical:
            lowest = sizes or dict.fromkeys(self.estimates, 0.0)
            return all(abs(max(self.estimates[name].value, low)) <= self.estimates[name].sd for name, low in lowest.items())
        wrong = [self.estimates[name].value <= low for name, low in sizes.items() if low == 0.0]
        return self.chi_square <= len(sizes) or (len(wrong) == len(sizes) > 0 and all(wrong))

    def as_told(self) -> FittedCause:
        """The same without the shapes of which runs tell no more than that they are within their bounds."""
        widths = {one.name: one.high - one.low for one in self.mechanism.shape_parameters()}
        told = {name: one for name, one in self.estimates.items() if not one.sd > widths.get(name, math.inf)}
        return dataclasses.replace(self, estimates=told)


@dataclasses.dataclass(frozen=True)
class Fitted:
    """A fit of baseline and causes.

    Parameters
    ----------
    simulator : Simulator
        With all that was fitted in it, as free parameters.
    baseline : mapping of mechanism to estimates
    causes : tuple of FittedCause
    white_deg_h : float
        Standard deviation of the white noise of a full window's mean.
    residual_deg_h : ndarray, shape (n,)
    """

    simulator: Simulator
    baseline: dict[str, dict[str, Estimate]]
    causes: tuple[FittedCause, ...]
    white_deg_h: float
    residual_deg_h: Array

    @property
    def cancels(self) -> bool:
        """Whether laws in the same columns come to much less than each of them: small differences of large numbers are no law."""
        laws = [one for one in self.causes if one.mechanism.empirical]
        if len(laws) < 2 or len({frozenset(one.mechanism.driver_names()) for one in laws}) > 1:
            return False
        each = np.array([one.contribution_deg_h for one in laws])
        return float(np.std(each.sum(axis=0))) < _CANCELLING * float(np.std(each, axis=1).min())


def fit(
    problem: Problem, chosen: Sequence[Candidate], noise: NoiseShape, likely: Sequence[tuple[NoiseShape, float]] = ()
) -> Fitted:
    """Fit a set of causes together with the simulator's free parameters.

    Parameters
    ----------
    problem : Problem
    chosen : sequence of Candidate
    noise : NoiseShape
        By which it is weighed.
    likely : sequence of (NoiseShape, float)
        What the noise may be, and how likely that is: standard deviations are over all of these. `noise` by default.
    """
    if any(candidate.mechanism.constant for candidate in chosen):
        problem = _without(problem, {""})
    problem = _without(problem, {candidate.name for candidate in chosen if not candidate.known})  # longer, it has these columns too
    at = _settled_down(problem, chosen, [candidate.mechanism for candidate in chosen], noise)
    jumps = [k for k, candidate in enumerate(chosen) if not steady_columns(candidate)]
    drawn = at.drawn_paths(jumps[0], noise) if len(jumps) == 1 else None
    if drawn is not None:  # then they are known
        chosen = [dataclasses.replace(one, columns=one.columns[:, :0]) if k in jumps else one for k, one in enumerate(chosen)]
        problem = dataclasses.replace(at.problem, target_deg_h=at.problem.target_deg_h - drawn.mean_deg_h)
        at = _settled_down(problem, chosen, at.mechanisms, noise)
    at = at.with_laws()
    problem, plain = at.problem, at.plain
    weights = solve(problem, at.with_slopes, noise)[0]
    own = problem.baseline.shape[1]
    held = np.r_[problem.held(), np.ones(plain.shape[1] - own, dtype=np.bool_)]
    final, covariance, square = _within_limits(problem, plain, held, noise)  # the simulator's own shapes are at their best
    freedom = len(problem.rows) - at.with_slopes.shape[1]
    sd = at.standard_deviations(weights, final, square, noise, likely)
    if drawn is not None:
        apart, loose = drawn.apart(problem, at.with_slopes, noise)
        sd, square = np.hypot(sd, apart), square + loose
    baseline, simulator = _baseline(problem, final[:own], sd)
    beside = [*at.columns, *(column[:, None] for found in at.derived for _, column in found)]
    baseline, simulator = _own_settled(problem, baseline, simulator, beside, noise)
    left = problem.target_deg_h - plain @ final
    causes = _causes(problem, chosen, at.mechanisms, at.columns, at.derived, final, sd, covariance * square / freedom, left, drawn)
    if any(cause.mechanism.canonical() != cause.mechanism for cause in causes):
        causes = _settled(problem, chosen, causes, at.columns, noise)
    causes = [cause.as_told() for cause in causes]
    for cause in causes:
        simulator = _joined(simulator, cause)
    return Fitted(_with_mean_of_jumps(problem, simulator, causes), baseline, tuple(causes), math.sqrt(square / freedom), left)


def _settled_down(problem: Problem, chosen: Sequence[Candidate], mechanisms: Sequence[Mechanism], noise: NoiseShape) -> Design:
    """Baseline and causes linearised where Gauss–Newton ends."""
    columns = [
        problem.columns(one) if steady_columns(candidate) else candidate.columns
        for candidate, one in zip(chosen, mechanisms, strict=True)
    ]
    at = Design.of(problem, chosen, mechanisms, columns, noise)
    for _ in range(STEPS):
        further = at.moved(noise)
        if further is None:
            break
        at = further
    return at


def noise_model(noise: NoiseShape, white_deg_h: float, windows: Windows) -> NoiseModel:
    """Noise coefficients from a shape and the white noise of a window mean: of the rate, and of the angle where it has a knee.

    Of a gyro read in whole pulses the angle errs by their rounding at least: what of it stands in lines, the knee does not show.
    """
    angle_arcsec = white_deg_h * math.sqrt(windows.white_s * windows.knee_s)  # a deg/h for a second
    rounded_arcsec = windows.step_deg_h * windows.full.period_s / math.sqrt(12.0) if windows.knee_s else 0.0
    return NoiseModel(
        angle_random_walk_deg_sqrt_h=white_deg_h * math.sqrt(windows.white_s / SECONDS_PER_HOUR),
        quantization_arcsec=max(angle_arcsec, rounded_arcsec),
        bias_instability_deg_h=noise.flicker * white_deg_h,
        rate_random_walk_deg_h_sqrt_h=noise.walk * white_deg_h,
    )


def _without(problem: Problem, names: Collection[str]) -> Problem:
    """The problem without the columns of some mechanisms of the simulator: a cause has its own. The bias added has no name."""
    kept = [k for k, (name, _) in enumerate(problem.baseline_names) if name not in names]
    return dataclasses.replace(
        problem, baseline=problem.baseline[:, kept], baseline_names=tuple(problem.baseline_names[k] for k in kept)
    )


def _within_limits(problem: Problem, design: Array, held: npt.NDArray[np.bool_], noise: NoiseShape) -> tuple[Array, Array, float]:
    """Weights of the columns that are held, the others nothing; covariance and square as :func:`solve` gives them.

    An amplitude of the simulator that would be beyond its limits is at its limit, and all else what it is best beside that.
    """
    weights, free = np.zeros(design.shape[1]), held.copy()
    low, high = _limits(problem, design.shape[1])
    while True:
        stays = held & ~free
        beside = dataclasses.replace(problem, target_deg_h=problem.target_deg_h - design[:, stays] @ weights[stays])
        weights[free], covariance, square = solve(beside, design[:, free], noise)
        beyond = free & ((weights < low) | (weights > high))
        if not beyond.any():
            return weights, covariance, square
        weights, free = np.clip(weights, low, high), free & ~beyond


def _with_mean_of_jumps(problem: Problem, simulator: Simulator, causes: Sequence[FittedCause]) -> Simulator:
    """The simulator whose constant bias is that of runs that jump, and not the middle between the two values: no path is predicted,
    and a run may be at one of them for most of its time."""
    windows = slice(len(problem.rows) - problem.rows.contrasts)
    means = [float(cause.contribution_deg_h[windows].mean()) for cause in causes if cause.mechanism.is_telegraph()]
    bias = dataclasses.replace(problem, simulator=simulator).constant(sum(means)) if means else None
    return simulator if bias is None else simulator.with_mechanism(bias)


def _limits(problem: Problem, count: int) -> tuple[Array, Array]:
    """Limits of the weights of so many columns, of which those of the baseline that are amplitudes have some."""
    low, high = np.full(count, -math.inf), np.full(count, math.inf)
    amplitudes_of = {one.name: {p.name: p for p in one.amplitude_parameters()} for one in problem.simulator.mechanisms}
    for k, (name, parameter) in enumerate(problem.baseline_names):
        described = amplitudes_of.get(name, {}).get(parameter)
        if described is not None and problem.baseline_names.count((name, parameter)) == 1:
            low[k], high[k] = described.low, described.high
    return low, high


def _baseline(problem: Problem, weights: Array, sd: Array) -> tuple[dict[str, dict[str, Estimate]], Simulator]:
    """Estimates of the simulator's free parameters, and the simulator that has them."""
    simulator = problem.simulator
    estimates: dict[str, dict[str, Estimate]] = {}
    for k, (name, parameter) in enumerate(problem.baseline_names):
        if parameter.startswith((OWN_BIAS, STEP, PARTLY)):
            estimates.setdefault("gyro", {})[f"{parameter}:{name}"] = Estimate(float(weights[k]), float(sd[k]), "deg/h")
            continue
        mechanism = next((mechanism for mechanism in simulator.mechanisms if mechanism.name == name), None)
        if mechanism is None:
            estimates.setdefault("gyro", {})["bias_deg_h"] = Estimate(float(weights[k]), float(sd[k]), "deg/h")
            continue
        described = next(p for p in mechanism.parameters() if p.name == parameter)
        own = [j for j, named in enumerate(problem.baseline_names) if named == (name, parameter)]  # an amplitude of each run's own
        size = weights[k] if len(own) == 1 else np.sqrt(np.mean(weights[own] ** 2))
        value = size + (getattr(mechanism, parameter) if described.role == "shape" else 0.0)
        value = float(np.clip(value, described.low, described.high))
        spread = float(np.sqrt(np.mean(sd[own] ** 2) / len(own)))
        estimates.setdefault(name, {})[parameter] = Estimate(value, spread, described.unit)
        simulator = simulator.with_mechanism(dataclasses.replace(mechanism, **{parameter: value}))  # type: ignore[type-var]
    constant = estimates.get("gyro", {}).get("bias_deg_h")
    bias = None if constant is None else problem.constant(constant.value)
    if bias is not None:
        simulator = simulator.with_mechanism(bias)
    return estimates, simulator


def _causes(
    problem: Problem,
    chosen: Sequence[Candidate],
    mechanisms: Sequence[Mechanism],
    columns: Sequence[Array],
    derived: Sequence[list[tuple[str, Array]]],
    weights: Array,
    sd: Array,
    covariance: Array,
    left: Array,
    drawn: DrawnPaths | None,
) -> list[FittedCause]:
    """The causes with their numbers; the covariance is that of all amplitudes, shapes held, the causes' last; `left` by all. Of the
    cause whose paths are drawn there is no column."""
    causes = []
    held = len(covariance) - len(weights)  # the simulator's own shapes are not among them
    place = problem.baseline.shape[1]
    slope_place = place + sum(block.shape[1] for block in columns)
    for candidate, mechanism, block, found in zip(chosen, mechanisms, columns, derived, strict=True):
        if drawn is not None and not block.shape[1]:
            causes.append(_jumping(problem.rows, mechanism, drawn, left, known=candidate.known))
            continue
        part = slice(place, place + block.shape[1])
        place = part.stop
        there = slice(part.start + held, part.stop + held)
        if len(weights[part]) > len(mechanism.amplitude_parameters()) > 0:
            estimates = _of_each_run(mechanism, weights[part], covariance[there, there])
        elif steady_columns(candidate):
            estimates = _estimates(problem, candidate, mechanism, weights[part], sd[part])
        else:
            half_step = Estimate(float(weights[part.start]), float(sd[part.start]), "deg/h")
            estimates = _of_jumps(problem.rows, mechanism, block @ weights[part], left, half_step)
        for name, _ in found:
            unit = next(p.unit for p in mechanism.parameters() if p.name == name)
            estimates[name] = Estimate(float(getattr(mechanism, name)), float(sd[slope_place]), unit)
            slope_place += 1
        chi_square = float(weights[part] @ np.linalg.pinv(covariance[there, there], hermitian=True) @ weights[part])
        causes.append(FittedCause(_filled(mechanism, estimates), estimates, block @ weights[part], candidate.known, chi_square))
    return causes


def _settled(
    problem: Problem, chosen: Sequence[Candidate], causes: Sequence[FittedCause], columns: Sequence[Array], noise: NoiseShape
) -> list[FittedCause]:
    """The causes, those settled whose parameters trade against each other."""
    derived = [
        slopes(problem, cause.mechanism, amplitudes(cause.mechanism)) if steady_columns(candidate) else []
        for candidate, cause in zip(chosen, causes, strict=True)
    ]
    found = list(causes)
    for k, (candidate, cause) in enumerate(zip(chosen, causes, strict=True)):
        if cause.mechanism.canonical() != cause.mechanism:
            around = [slope for j, shapes in enumerate(derived) for _, slope in shapes if j != k]
            others = np.column_stack([problem.baseline, *columns[:k], *columns[k + 1 :], *around])
            has = cause.known and not _free(problem, candidate)
            taken = whole(problem, candidate.mechanism) if has else np.zeros(len(problem.rows))
            found[k] = settle(problem, cause, taken, others, noise)
    return found


def _own_settled(
    problem: Problem, baseline: dict[str, dict[str, Estimate]], simulator: Simulator, beside: Sequence[Array], noise: NoiseShape
) -> tuple[dict[str, dict[str, Estimate]], Simulator]:
    """The simulator's own mechanisms, those settled whose parameters trade against each other, all of them free."""
    found = dict(baseline)
    for mechanism in simulator.mechanisms:
        fitted = {parameter.name for parameter in mechanism.parameters() if parameter.role != "setting"}
        if mechanism.canonical() == mechanism or fitted != baseline.get(mechanism.name, {}).keys():
            continue
        theirs = [k for k, (name, _) in enumerate(problem.baseline_names) if name != mechanism.name]
        nothing = np.zeros(len(problem.rows))
        cause = FittedCause(mechanism, baseline[mechanism.name], nothing, known=True)
        settled = settle(problem, cause, nothing, np.column_stack([problem.baseline[:, theirs], *beside]), noise)
        simulator, found[mechanism.name] = simulator.with_mechanism(settled.mechanism), settled.estimates
    return found, simulator


def settle(problem: Problem, cause: FittedCause, taken: Array, others: Array, noise: NoiseShape) -> FittedCause:
    """A cause whose fitted parameters trade against each other, in the numbers that people use: its shapes fitted alone.

    Parameters
    ----------
    problem : Problem
    cause : FittedCause
    taken : ndarray, shape (n,)
        What the target lacks of it already, because the simulator has it.
    others : ndarray, shape (n, p)
        Columns of all else, derivatives by shapes among them.
    noise : NoiseShape

    Notes
    -----
    Gauss–Newton. What the law leaves open (:meth:`Mechanism.unmodelled`) widens the standard deviations.
    """
    mechanism = cause.mechanism.canonical()
    for _ in range(STEPS):
        reached = mechanism
        left = dataclasses.replace(problem, target_deg_h=problem.target_deg_h + taken - whole(problem, mechanism))
        derived = slopes(problem, mechanism, amplitudes(mechanism))
        design = np.column_stack([others, *(slope for _, slope in derived)])
        weights, covariance, square = solve(left, design, noise)
        mechanism = moved(problem, [mechanism], [derived], weights[others.shape[1] :])[0]
    variance = np.diag(covariance) * square / (len(problem.rows) - design.shape[1])
    for disturbance in problem.scatter(reached).T:
        variance += solve(dataclasses.replace(problem, target_deg_h=disturbance), design, noise)[0] ** 2
    sd = np.sqrt(np.maximum(variance, 0.0))[others.shape[1] :]
    estimates = {
        name: dataclasses.replace(cause.estimates[name], value=float(getattr(mechanism, name)), sd=float(each))
        for (name, _), each in zip(derived, sd, strict=True)
    }
    return dataclasses.replace(cause, mechanism=mechanism, estimates=estimates)


def _of_each_run(mechanism: Mechanism, weights: Array, covariance: Array) -> dict[str, Estimate]:
    """Of amplitudes of which each run has its own, their root mean square, with its error to first order.

    Their covariance is that with the shapes held: a frequency that is a little off turns a phase and leaves the size as it is.
    """
    size = float(np.sqrt(np.mean(weights**2)))
    direction = weights / (float(np.linalg.norm(weights)) or 1.0)
    sd = math.sqrt(max(0.0, float(direction @ covariance @ direction)) / len(weights))
    return {p.name: Estimate(size, sd, p.unit) for p in mechanism.amplitude_parameters()}


def _estimates(problem: Problem, candidate: Candidate, mechanism: Mechanism, weights: Array, sd: Array) -> dict[str, Estimate]:
    """Of the amplitudes."""
    parameters = mechanism.amplitude_parameters()
    has = candidate.known or any(held.name == candidate.name for held in problem.simulator.mechanisms)
    known = {p.name: getattr(candidate.mechanism, p.name) for p in parameters} if has else {}
    free = _free(problem, candidate) if has else frozenset()
    return {
        p.name: Estimate(float(w + (known.get(p.name, 0.0) if p.name not in free else 0.0)), float(s), p.unit)
        for p, w, s in zip(parameters, weights, sd, strict=True)
    }


def _free(problem: Problem, candidate: Candidate) -> frozenset[str]:
    """Parameters that the simulator leaves to be found: the target still holds what they make."""
    return problem.simulator.free.get(candidate.name, frozenset())


def _jumping(rows: Rows, mechanism: Mechanism, drawn: DrawnPaths, left: Array, *, known: bool) -> FittedCause:
    """A cause that jumps, on all its paths."""
    jumps, half_step = drawn.mean_deg_h, drawn.half_step
    estimates = _of_jumps(rows, mechanism, jumps, left, half_step, drawn.jumps_deg_h.var(axis=1))
    chi_square = (half_step.value / half_step.sd) ** 2
    return FittedCause(_filled(mechanism, estimates), estimates, jumps, known, chi_square)


def _filled(mechanism: Mechanism, estimates: Mapping[str, Estimate]) -> Mechanism:
    """A mechanism with numbers as they were estimated, within its limits."""
    limits = {p.name: (p.low, p.high) for p in mechanism.parameters()}
    return dataclasses.replace(mechanism, **{k: float(np.clip(one.value, *limits[k])) for k, one in estimates.items()})  # type: ignore[type-var]


def _of_jumps(
    rows: Rows, mechanism: Mechanism, jumps: Array, left: Array, half_step: Estimate, unsure: Array | float = 0.0
) -> dict[str, Estimate]:
    """Of paths: their size as fitted, and the mean time between flips that is likeliest of jumps beside what is left; `unsure` is
    the jumps' variance."""
    size = dataclasses.replace(half_step, value=abs(half_step.value))
    windows = slice(len(rows) - rows.contrasts)
    noise_deg_h = math.sqrt(float(np.mean(((left**2 + unsure) / rows.white)[windows])))
    dwell_s, sd_s = likeliest_dwell_s(rows, jumps + left, size.value, noise_deg_h)
    renewed = type(mechanism).as_telegraph(size.value, dwell_s)
    step_name, dwell_name = (p.name for p in (renewed or mechanism).parameters()[:2])
    return {step_name: size, dwell_name: Estimate(dwell_s, sd_s, "s")}


def _joined(simulator: Simulator, cause: FittedCause) -> Simulator:
    """The simulator with a cause in it, its fitted parameters free to be calibrated again; of a law, its amplitude."""
    free, fitted = dict(simulator.free), frozenset(cause.estimates)
    if cause.mechanism.empirical:
        fitted &= {parameter.name for parameter in cause.mechanism.amplitude_parameters()}
    free[cause.mechanism.name] = free.get(cause.mechanism.name, frozenset()) | fitted
    return dataclasses.replace(simulator.with_mechanism(cause.mechanism), free=free)
