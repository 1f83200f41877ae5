r"""The smallest effect that a laboratory would find: a mechanism put into its own recordings at growing strengths, and sought.

Each trial draws shapes, signs and relative sizes anew; of those that come out alike one is made and counted. All share the noise of
the recordings, one realisation of it: curves and intervals are those of these recordings. The chance of finding an effect of
strength s (see :mod:`rlgcomp.challenge.injection`) is taken as logistic in its logarithm,

.. math:: P(s) = \frac{1}{1 + \exp\!\big(-(\ln s - \ln s_{50})/w\big)}, \qquad \ln s_{90} = \ln s_{50} + w \ln 9,

and s50 and w have a posterior on a grid: flat in ln s50 from a quarter of the smallest to four times the largest strength tried,
and log-normal in w about 0.3. Where nothing or everything was found, the interval says so by reaching the end of that grid.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, Final

import joblib
import numpy as np
import pandas as pd
from scipy import special

from rlgcomp.challenge.injection import Array, drawn, injected, scaled, unabsorbed, white_deg_h
from rlgcomp.diagnosis.diagnose import diagnose
from rlgcomp.diagnosis.question.problem import Problem
from rlgcomp.diagnosis.result import Diagnosis
from rlgcomp.errors import InputError
from rlgcomp.noise.processes import stream
from rlgcomp.physics import CATALOGUE
from rlgcomp.physics.mechanism import Mechanism
from rlgcomp.physics.plugins import LoadedFirst
from rlgcomp.recording import Recording
from rlgcomp.recording.argument_checks import require_recordings, require_seed, require_workers
from rlgcomp.simulation.simulator import Simulator

STRENGTHS: Final = (0.1, 0.2, 0.4, 0.8, 1.6)
DRAWS: Final = 6
DETECTED_P: Final = 0.01
MEANING: Final = (
    f"Detected asks whether anything is left: the mismatch's p-value is below {DETECTED_P:g}. Named asks what it most probably is: "
    "the most probable set of mechanisms holds it, at whatever p-value, so that a faint effect may be named in more trials "
    "than it is detected in. All trials share the noise of these recordings, one realisation of it: others may show other limits, "
    "and the intervals do not hold that."
)
_USUAL_WIDTH: Final = 0.3
_REDRAWS: Final = 20
_ALIKE: Final = 1e-6  # of an effect


@dataclasses.dataclass(frozen=True)
class Trial:
    """One injection and what the diagnosis made of it.

    Parameters
    ----------
    strength : float
    mechanism : Mechanism
        As injected.
    p_value : float
    detected : bool
        The mismatch has a p-value below 0.01.
    named : bool
        The mechanism is among the findings, that is in the most probable set, at whatever p-value.
    in_class : bool
        It is among them, or among what they are indistinguishable from.
    found : tuple of str
    """

    strength: float
    mechanism: Mechanism
    p_value: float
    detected: bool
    named: bool
    in_class: bool
    found: tuple[str, ...]


@dataclasses.dataclass(frozen=True)
class Curve:
    """A detection curve: strengths at which half and nine tenths are found, medians with 95 % intervals.

    Parameters
    ----------
    s50, s90 : float
    s50_interval, s90_interval : tuple of float
    width : float
        w, of the logarithm of the strength: that of the curve through both.
    """

    s50: float
    s90: float
    s50_interval: tuple[float, float]
    s90_interval: tuple[float, float]
    width: float

    @classmethod
    def fit(cls, strengths: Array, found: Array) -> Curve:
        """Curve through what was found (1) and missed (0) at strengths, shape (n,) each."""
        low, high = math.log(strengths.min() / 4.0), math.log(strengths.max() * 4.0)
        middle = np.linspace(low, high, 241)[:, None, None]
        width = np.geomspace(0.05, 2.0, 40)[None, :, None]
        score = np.where(found > 0.5, 1.0, -1.0) * (np.log(strengths) - middle) / width
        log_posterior = special.log_expit(score).sum(axis=-1) - 0.5 * (np.log(width[..., 0] / _USUAL_WIDTH) / 0.7) ** 2
        weight = np.exp(log_posterior - log_posterior.max())
        weight /= weight.sum()
        at90 = middle[..., 0] + width[..., 0] * math.log(9.0)
        half, most = (_quantiles(np.broadcast_to(at, weight.shape), weight) for at in (middle[..., 0], at90))
        return cls(half[1], most[1], (half[0], half[2]), (most[0], most[2]), math.log(most[1] / half[1]) / math.log(9.0))

    def probability(self, strengths: Array) -> Array:
        """Chance of finding an effect of each strength."""
        return np.asarray(special.expit((np.log(strengths) - math.log(self.s50)) / self.width))


@dataclasses.dataclass(frozen=True)
class Sensitivity:
    """What this laboratory would find of one mechanism.

    Parameters
    ----------
    mechanism : str
    white_deg_h : float
        Standard deviation of the white noise of a window mean: strength 1 leaves as much that the simulator cannot absorb.
    averaging_s : float
    trials : tuple of Trial
    detection, naming : Curve
    remarks : tuple of str
    """

    mechanism: str
    white_deg_h: float
    averaging_s: float
    trials: tuple[Trial, ...]
    detection: Curve
    naming: Curve
    remarks: tuple[str, ...] = ()

    def to_frame(self) -> pd.DataFrame:
        """One row a strength: shares detected, named, named in class, and of these with a p-value that detects nothing."""
        rows = pd.DataFrame(
            {
                "strength": trial.strength,
                "rms_deg_h": trial.strength * self.white_deg_h,
                "detected": float(trial.detected),
                "named": float(trial.named),
                "in_class": float(trial.in_class),
                "undetected": float(trial.in_class and not trial.detected),
                "trials": 1,
            }
            for trial in self.trials
        )
        shares = {"detected": "mean", "named": "mean", "in_class": "mean", "undetected": "mean", "trials": "sum"}
        return rows.groupby(["strength", "rms_deg_h"], as_index=False).agg(shares)

    def sizes(self, strength: float) -> dict[str, tuple[float, str]]:
        """Median absolute value of each amplitude at a strength, with its unit; shapes being as drawn."""
        found: dict[str, tuple[float, str]] = {}
        for parameter in self.trials[0].mechanism.amplitude_parameters():
            relative = [abs(getattr(trial.mechanism, parameter.name, 0.0)) / trial.strength for trial in self.trials]
            found[parameter.name] = (strength * float(np.median(relative)), parameter.unit)
        return found

    def to_mapping(self) -> dict[str, Any]:
        """Plain data."""
        curves = {}
        for name, curve in (("detection", self.detection), ("naming", self.naming)):
            curves[name] = dataclasses.asdict(curve) | {
                "s50_rms_deg_h": curve.s50 * self.white_deg_h,
                "s90_rms_deg_h": curve.s90 * self.white_deg_h,
                "s50_sizes": {key: {"value": value, "unit": unit} for key, (value, unit) in self.sizes(curve.s50).items()},
                "s90_sizes": {key: {"value": value, "unit": unit} for key, (value, unit) in self.sizes(curve.s90).items()},
            }
        return {
            "mechanism": self.mechanism,
            "meaning": MEANING,
            "white_deg_h": self.white_deg_h,
            "averaging_s": self.averaging_s,
            **curves,
            "table": self.to_frame().to_dict("records"),
            "trials": [dataclasses.asdict(trial) | {"mechanism": trial.mechanism.to_mapping()} for trial in self.trials],
            "remarks": list(self.remarks),
        }


def sensitivity(
    simulator: Simulator,
    runs: Sequence[Recording],
    mechanism: str,
    *,
    strengths: Sequence[float] = STRENGTHS,
    draws: int = DRAWS,
    seed: int = 0,
    gyro: str | None = None,
    catalogue: Mapping[str, type[Mechanism]] = CATALOGUE,
    jobs: int = 1,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> Sensitivity:
    """Inject a mechanism into recordings at growing strengths and see from when on it is found.

    What the recordings hold already is diagnosed first: it is put into the simulator, and the mechanism itself is taken off them,
    so that only the injection is sought.

    Parameters
    ----------
    simulator : Simulator
    runs : sequence of Recording
    mechanism : str
        A name in the catalogue that the simulator does not have.
    strengths : sequence of float
    draws : int
        Trials a strength, each of other shapes and signs; fewer where these come out alike.
    seed : int
    gyro : str, optional
    catalogue : mapping
        Candidates, the mechanism among them.
    jobs : int
        Worker processes.
    progress : callable
        Told (done, total).

    Raises
    ------
    InputError
        The mechanism is not in the catalogue, of the other kind, or in the simulator already; the runs cannot show it; or a
        strength is not positive.
    """
    runs, jobs, seed = require_recordings(runs, "runs"), require_workers(jobs, "jobs"), require_seed(seed)
    form = _checked(simulator, mechanism, strengths, draws, catalogue)
    for run in runs:
        form().driver_columns(run)
    total = 1 + len(strengths) * draws
    background = diagnose(simulator, train=runs, gyro=gyro, mechanisms=catalogue, black_box=False)
    progress(1, total)
    simulator, runs, remarks = _cleared(simulator, runs, mechanism, background, gyro)
    problem = Problem.of(simulator, runs, gyro=gyro)
    white = white_deg_h(problem)
    drawn_plans = [
        [_injection(form, problem, strength * white, stream(seed, f"sensitivity:{k}:{draw}")) for draw in range(draws)]
        for k, strength in enumerate(strengths)
    ]
    kept = [_distinct(alike, problem) for alike in drawn_plans]
    plans = [plan for different in kept for plan in different]
    sizes = np.repeat(np.asarray(strengths, dtype=np.float64), [len(different) for different in kept]).tolist()
    if len(plans) < len(strengths) * draws:
        remarks.append(
            f"{len(plans)} of {len(strengths) * draws} trials are made and counted: the others have the same effect as one of "
            f"them, for little but the sign of {mechanism} can be varied; more strengths make the curves surer, more draws do not"
        )
    files = LoadedFirst.of(catalogue.values())
    work = (
        joblib.delayed(_trial)(files, simulator, runs, made, strength, gyro, catalogue)
        for made, strength in zip(plans, sizes, strict=True)
    )
    trials = tuple(_counted(joblib.Parallel(n_jobs=jobs, return_as="generator")(work), 1 + len(plans), progress))
    tried = np.array(sizes)
    detected = np.array([trial.detected for trial in trials], dtype=np.float64)
    named = np.array([trial.in_class for trial in trials], dtype=np.float64)
    remarks += [*_beyond("detected", tried, detected), *_beyond("named", tried, named)]
    return Sensitivity(
        mechanism,
        white,
        problem.rows.window_s,
        trials,
        Curve.fit(tried, detected),
        Curve.fit(tried, named),
        tuple(remarks),
    )


def _cleared(
    simulator: Simulator, runs: Sequence[Recording], mechanism: str, background: Diagnosis, gyro: str | None
) -> tuple[Simulator, Sequence[Recording], list[str]]:
    """Simulator and recordings less what these hold before anything is injected, and what to say of it."""
    before = "before anything is injected"
    if not background.causes:
        said = f"something unexplained is in these recordings {before} (p = {background.p_value:.2g})"
        return simulator, runs, [said] * (background.verdict != "none")
    own = next((cause.mechanism for cause in background.causes if cause.name == mechanism), None)
    others = [cause.name for cause in background.causes if cause.name != mechanism]
    remarks = [f"{', '.join(others)} found in these recordings {before}; added to the simulator"] * bool(others)
    augmented = background.augmented
    kept = tuple(one for one in augmented.mechanisms if one.name != mechanism)
    simulator = dataclasses.replace(
        augmented, mechanisms=kept, free={name: free for name, free in augmented.free.items() if name != mechanism}
    )
    if own is None:
        return simulator, runs, remarks
    if not own.repeats() or own.each_run:
        said = f"{mechanism} is found in these recordings {before}; what is injected comes on top of it: the curves mean little"
        return simulator, runs, [said, *remarks]
    cleared = [injected(run, -own.contribution(run, np.random.default_rng(0)), gyro) for run in runs]  # it draws nothing
    return simulator, cleared, [f"{mechanism} is found in these recordings {before}; it is taken off them", *remarks]


def _beyond(what: str, strengths: Array, found: Array) -> list[str]:
    """Where a curve leaves what was tried."""
    least, most = strengths.min(), strengths.max()
    if found[strengths == least].all():
        return [f"every effect of the smallest strength, {least:g}, was {what}: below it the curve is a guess; try smaller ones"]
    if not found[strengths == most].any():
        return [f"no effect of the largest strength, {most:g}, was {what}: above it the curve is a guess; try larger ones"]
    return []


def _checked(
    simulator: Simulator, mechanism: str, strengths: Sequence[float], draws: int, catalogue: Mapping[str, type[Mechanism]]
) -> type[Mechanism]:
    fitting = [name for name, form in catalogue.items() if form.named_for(simulator.kind)]
    if mechanism not in fitting:
        raise InputError(f"{mechanism!r} is not in the catalogue of kind {simulator.kind!r}; it has {', '.join(fitting)}")
    if mechanism in [own.name for own in simulator.mechanisms]:
        raise InputError(f"the simulator has {mechanism} already and would absorb it; take it out of its file first")
    if not strengths or not all(0.0 < strength < math.inf for strength in strengths):
        raise InputError(f"strengths are {list(strengths)}; give at least one, each positive")
    if draws < 1:
        raise InputError(f"{draws} draws a strength; at least 1 is needed")
    return catalogue[mechanism]


def _injection(form: type[Mechanism], problem: Problem, size_deg_h: float, rng: np.random.Generator) -> tuple[Mechanism, int]:
    """A mechanism of random shape, made so large that this much is left of it, and the seed of what no two runs repeat."""
    why = f"the simulator absorbs all of it, or {', '.join(run.name for run in problem.runs)} never excite it"
    for _ in range(_REDRAWS):
        mechanism, number = drawn(form, problem.runs, rng, problem.rows.window_s), int(rng.integers(2**31))
        errors = _errors(mechanism, problem.runs, number)
        left, whole = float(np.std(unabsorbed(problem, errors))), float(np.std(np.concatenate(errors)))
        if left > 1e-3 * whole:
            try:
                return scaled(mechanism, size_deg_h / left), number
            except InputError as error:
                why = str(error)
    raise InputError(f"{form.name} cannot be injected at {size_deg_h:.3g} deg/h: {why}")


def _distinct(plans: Sequence[tuple[Mechanism, int]], problem: Problem) -> list[tuple[Mechanism, int]]:
    """Those of injections that differ in what is left of them to be found."""
    kept: list[tuple[Mechanism, int]] = []
    effects: list[Array] = []
    for mechanism, number in plans:
        effect = unabsorbed(problem, _errors(mechanism, problem.runs, number))
        if all(np.linalg.norm(effect - other) > _ALIKE * np.linalg.norm(other) for other in effects):
            kept.append((mechanism, number))
            effects.append(effect)
    return kept


def _errors(mechanism: Mechanism, runs: Sequence[Recording], number: int) -> list[Array]:
    return [mechanism.contribution(run, stream(number, f"run{k}")) for k, run in enumerate(runs)]


def _trial(
    files: LoadedFirst,
    simulator: Simulator,
    runs: Sequence[Recording],
    made: tuple[Mechanism, int],
    strength: float,
    gyro: str | None,
    catalogue: Mapping[str, type[Mechanism]],
) -> Trial:
    del files  # a worker has loaded them by now
    mechanism, number = made
    errors = _errors(mechanism, runs, number)
    changed = [injected(run, error, gyro) for run, error in zip(runs, errors, strict=True)]
    diagnosis = diagnose(simulator, train=changed, gyro=gyro, mechanisms=catalogue, black_box=False)
    found = tuple(cause.name for cause in diagnosis.causes)
    classes = {name for cause in diagnosis.causes for name in (cause.name, *cause.indistinguishable_from)}
    detected = diagnosis.p_value < DETECTED_P
    return Trial(strength, mechanism, diagnosis.p_value, detected, mechanism.name in found, mechanism.name in classes, found)


def _counted(trials: Iterator[Trial], total: int, progress: Callable[[int, int], None]) -> Iterator[Trial]:
    for done, trial in enumerate(trials, start=2):
        progress(done, total)
        yield trial


def _quantiles(values: Array, weight: Array) -> tuple[float, float, float]:
    order = np.argsort(values, axis=None)
    total = np.cumsum(weight.ravel()[order])
    low, middle, high = np.exp(values.ravel()[order][np.searchsorted(total, [0.025, 0.5, 0.975])])
    return float(low), float(middle), float(high)
