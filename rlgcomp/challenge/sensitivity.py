r"""The smallest effect that would be found: a mechanism injected into its own recordings at growing strengths.

Each trial draws nonlinear parameters, signs and relative sizes anew; of equal trials one is made and counted. All share the noise
of the recordings, one realisation of it: curves and intervals are those of these recordings. The chance of finding an effect of
strength s (see :mod:`rlgcomp.challenge.injection`) is taken as logistic in its logarithm,

.. math:: P(s) = \frac{1}{1 + \exp\!\big(-(\ln s - \ln s_{50})/w\big)}, \qquad \ln s_{90} = \ln s_{50} + w \ln 9,

and s50 and w have a posterior on a grid: flat in ln s50 from a quarter of the smallest to four times the largest strength tried,
and log-normal in w about 0.3. Where no effect or every effect was found, the interval reaches the end of that grid.
"""

from __future__ import annotations

import dataclasses
import math
import os
import uuid
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, Final

import joblib
import numpy as np
import pandas as pd
from scipy import special

from rlgcomp.challenge.injection import Array, Projection, contributions, distinct_injections, injected, sized_injection
from rlgcomp.challenge.repeated import Repeated
from rlgcomp.diagnosis.decide import decided
from rlgcomp.diagnosis.diagnose import diagnose
from rlgcomp.diagnosis.report.result import Diagnosis
from rlgcomp.errors import InputError
from rlgcomp.noise.processes import stream
from rlgcomp.numerics.worker_processes import end_with
from rlgcomp.physics import CATALOGUE
from rlgcomp.physics.mechanism import Mechanism
from rlgcomp.physics.plugins import LoadedFirst
from rlgcomp.recording import Recording
from rlgcomp.recording.argument_checks import require_recordings, require_seed, require_workers
from rlgcomp.report.messages import Message, message
from rlgcomp.simulation.simulator import Simulator

STRENGTHS: Final = (0.1, 0.2, 0.4, 0.8, 1.6)
DRAWS: Final = 6
DETECTED_P: Final = 0.01
_USUAL_WIDTH: Final = 0.3
_REPEATED: Final[dict[str, Repeated]] = {}  # of the measurement that this process works on


@dataclasses.dataclass(frozen=True)
class Trial:
    """One injection and its diagnosis.

    Parameters
    ----------
    strength : float
    mechanism : Mechanism
        As injected.
    p_value : float
    detected : bool
        The mismatch has a p-value below 0.01.
    named : bool
        The mechanism is among the findings, that is in the most probable set, at any p-value.
    in_class : bool
        It is among them, or indistinguishable from one of them.
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
        """Curve through effects found (1) and missed (0) at strengths, shape (n,) each."""
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
    """Detection limit of one mechanism in recordings.

    Parameters
    ----------
    mechanism : str
    white_deg_h : float
        Standard deviation of the white noise of a window mean: at strength 1 the simulator cannot absorb as much.
    averaging_s : float
    trials : tuple of Trial
    detection, naming : Curve
    remarks : tuple of Message
    """

    mechanism: str
    white_deg_h: float
    averaging_s: float
    trials: tuple[Trial, ...]
    detection: Curve
    naming: Curve
    remarks: tuple[Message, ...] = ()

    @property
    def meaning(self) -> Message:
        """Meaning of detected and named."""
        return message("challenge.detected_and_named", p_value=DETECTED_P)

    def to_frame(self) -> pd.DataFrame:
        """One row a strength: shares detected, named, named in class, and of these those without a significant p-value."""
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
        """Median absolute value of each amplitude at a strength, with its unit, over the nonlinear parameters drawn."""
        sizes: dict[str, tuple[float, str]] = {}
        for parameter in self.trials[0].mechanism.amplitude_parameters():
            relative = [abs(getattr(trial.mechanism, parameter.name, 0.0)) / trial.strength for trial in self.trials]
            sizes[parameter.name] = (strength * float(np.median(relative)), parameter.unit)
        return sizes

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
            "meaning": self.meaning.to_mapping(),
            "white_deg_h": self.white_deg_h,
            "averaging_s": self.averaging_s,
            **curves,
            "table": self.to_frame().to_dict("records"),
            "trials": [dataclasses.asdict(trial) | {"mechanism": trial.mechanism.to_mapping()} for trial in self.trials],
            "remarks": [remark.to_mapping() for remark in self.remarks],
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
    """Inject a mechanism into recordings at growing strengths and determine from which on it is found.

    Effects in the recordings are diagnosed first: they are added to the simulator, and the mechanism itself is subtracted from the
    recordings, so that only the injection remains.

    Parameters
    ----------
    simulator : Simulator
    runs : sequence of Recording
    mechanism : str
        A name in the catalogue that the simulator does not have.
    strengths : sequence of float
    draws : int
        Trials a strength, each with other nonlinear parameters and signs; equal trials count once.
    seed : int
    gyro : str, optional
        Gyro column, where there are several.
    catalogue : mapping
        Candidates, the mechanism among them.
    jobs : int
        Worker processes.
    progress : callable
        Called with trials done and in all.

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
    background = diagnose(simulator, runs, gyro=gyro, mechanisms=catalogue, black_box=False)
    progress(1, total)
    simulator, runs, remarks = _cleared(simulator, runs, mechanism, background, gyro)
    projection = Projection.of(simulator, runs, gyro)
    white = projection.white_deg_h
    drawn_plans = [
        [sized_injection(form, projection, strength * white, stream(seed, f"sensitivity:{k}:{draw}")) for draw in range(draws)]
        for k, strength in enumerate(strengths)
    ]
    distinct = [distinct_injections(equal, projection) for equal in drawn_plans]
    plans = [plan for different in distinct for plan in different]
    sizes = np.repeat(np.asarray(strengths, dtype=np.float64), [len(different) for different in distinct]).tolist()
    if len(plans) < len(strengths) * draws:
        remarks.append(message("challenge.equal_trials", made=len(plans), planned=len(strengths) * draws, mechanism=mechanism))
    files, common = LoadedFirst.of(catalogue.values()), _Common(simulator, tuple(runs), gyro, catalogue, uuid.uuid4().hex)
    work = (joblib.delayed(_trial)(os.getpid(), files, common, made, strength) for made, strength in zip(plans, sizes, strict=True))
    trials = tuple(_counted(joblib.Parallel(n_jobs=jobs, return_as="generator")(work), 1 + len(plans), progress))
    tried = np.array(sizes)
    detected = np.array([trial.detected for trial in trials], dtype=np.float64)
    named = np.array([trial.in_class for trial in trials], dtype=np.float64)
    remarks += [*extrapolation_remarks("detected", tried, detected), *extrapolation_remarks("named", tried, named)]
    return Sensitivity(
        mechanism,
        white,
        projection.window_s,
        trials,
        Curve.fit(tried, detected),
        Curve.fit(tried, named),
        tuple(remarks),
    )


@dataclasses.dataclass(frozen=True)
class _Common:
    """What all trials share; each process computes the rest of it once.

    Parameters
    ----------
    simulator : Simulator
    runs : tuple of Recording
    gyro : str, optional
    catalogue : mapping
    key : str
        Of this measurement.
    """

    simulator: Simulator
    runs: tuple[Recording, ...]
    gyro: str | None
    catalogue: Mapping[str, type[Mechanism]]
    key: str

    def repeated(self) -> Repeated:
        if self.key not in _REPEATED:
            _REPEATED.clear()
            _REPEATED[self.key] = Repeated.of(self.simulator, self.runs, gyro=self.gyro, mechanisms=self.catalogue)
        return _REPEATED[self.key]


def _cleared(
    simulator: Simulator,
    runs: Sequence[Recording],
    mechanism: str,
    background: Diagnosis,
    gyro: str | None,
) -> tuple[Simulator, Sequence[Recording], list[Message]]:
    """Simulator and recordings without the effects that these hold before the injection, and remarks on them."""
    if not background.causes:
        unexplained = background.verdict != "none"
        return simulator, runs, [message("challenge.unexplained_before", p_value=background.p_value)] * unexplained
    own = _parts(background, mechanism)
    others = [cause.name for cause in background.causes if cause.name != mechanism]
    remarks = [message("challenge.causes_before", mechanisms=others)] * bool(others)
    augmented = background.augmented
    mechanisms = tuple(one for one in augmented.mechanisms if one.name != mechanism and one not in own)
    simulator = dataclasses.replace(
        augmented, mechanisms=mechanisms, free={name: free for name, free in augmented.free.items() if name != mechanism}
    )
    if not own:
        return simulator, runs, remarks
    if any(not one.repeats() or one.each_run for one in own):
        return simulator, runs, [message("challenge.mechanism_before_kept", mechanism=mechanism), *remarks]
    rng = np.random.default_rng(0)  # no random numbers are drawn
    cleared = [injected(run, -np.sum([one.contribution(run, rng) for one in own], axis=0), gyro) for run in runs]
    return simulator, cleared, [message("challenge.mechanism_before_removed", mechanism=mechanism), *remarks]


def _parts(background: Diagnosis, mechanism: str) -> list[Mechanism]:
    """What of the augmented simulator is a cause of this name; empty where there is none."""
    if mechanism not in [cause.name for cause in background.causes]:
        return []
    return [one for one in background.augmented.mechanisms if mechanism in (one.name, getattr(one, "cause", ""))]


def extrapolation_remarks(criterion: str, strengths: Array, found: Array) -> list[Message]:
    """A remark where a curve extends beyond the strengths tried.

    Parameters
    ----------
    criterion : str
        "detected" or "named".
    strengths, found : ndarray, shape (trials,)
        `found` is 1 where the effect was found, else 0.
    """
    least, most = strengths.min(), strengths.max()
    if found[strengths == least].all():
        return [message("challenge.found_at_smallest_strength", criterion=criterion, strength=least)]
    if not found[strengths == most].any():
        return [message("challenge.missed_at_largest_strength", criterion=criterion, strength=most)]
    return []


def _checked(
    simulator: Simulator, mechanism: str, strengths: Sequence[float], draws: int, catalogue: Mapping[str, type[Mechanism]]
) -> type[Mechanism]:
    fitting = [name for name, form in catalogue.items() if form.is_candidate(simulator.kind)]
    if mechanism not in fitting:
        raise InputError(f"{mechanism!r} is not in the catalogue of kind {simulator.kind!r}; it has {', '.join(fitting)}")
    if mechanism in [own.name for own in simulator.mechanisms]:
        raise InputError(f"the simulator has {mechanism} already and would absorb it; take it out of its file first")
    if not strengths or not all(0.0 < strength < math.inf for strength in strengths):
        raise InputError(f"strengths are {list(strengths)}; give at least one, each positive")
    if draws < 1:
        raise InputError(f"{draws} draws a strength; at least 1 is needed")
    return catalogue[mechanism]


def _trial(
    parent: int,
    files: LoadedFirst,
    common: _Common,
    made: tuple[Mechanism, int],
    strength: float,
) -> Trial:
    end_with(parent)
    del files  # a worker loads them on receiving this
    mechanism, number = made
    errors = contributions(mechanism, common.runs, number)
    posterior = common.repeated().posterior([run.time_s for run in common.runs], errors)
    named = [one for one in decided(posterior).named if one.mechanism is not None]
    found = tuple(str(one.mechanism) for one in named)
    classes = {name for one in named for name in (one.mechanism, *one.indistinguishable_from)}
    detected = posterior.p_value < DETECTED_P
    return Trial(strength, mechanism, posterior.p_value, detected, mechanism.name in found, mechanism.name in classes, found)


def _counted(trials: Iterator[Trial], total: int, progress: Callable[[int, int], None]) -> Iterator[Trial]:
    for done, trial in enumerate(trials, start=2):
        progress(done, total)
        yield trial


def _quantiles(values: Array, weight: Array) -> tuple[float, float, float]:
    order = np.argsort(values, axis=None)
    total = np.cumsum(weight.ravel()[order])
    low, middle, high = np.exp(values.ravel()[order][np.searchsorted(total, [0.025, 0.5, 0.975])])
    return float(low), float(middle), float(high)
