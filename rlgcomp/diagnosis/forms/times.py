"""Bases of the time in a run: laws of the time since switch-on, and waves."""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Mapping
from typing import Final, Literal, Self

import numpy as np
import numpy.typing as npt

from rlgcomp.diagnosis import priors
from rlgcomp.diagnosis.data import Run
from rlgcomp.diagnosis.forms.bases import Basis, gaussian_process
from rlgcomp.diagnosis.forms.drivers import Path
from rlgcomp.units import SECONDS_PER_DAY

Array = npt.NDArray[np.float64]
_PER_KNOT: Final = 16  # points of time, at which a wave's envelope is evaluated
_RIDGE: Final = 1e-3  # of the phase of an envelope
_FARTHEST_STEP: Final = 1.0  # of a weight of a course, radians
_EXPONENT_RATIO: Final = 1.4  # from one point of the grid to the next


@dataclasses.dataclass(frozen=True)
class Since(Basis):
    r"""A function of the time since switch-on.

    :math:`e^{-(t/\tau)^q}`, :math:`(1 + t/\tau)^{-q}`, :math:`\ln(1 + t/\tau)`, or :math:`t^p` of the run's length.
    """

    law: Literal["exponential", "hyperbola", "logarithm", "power"]
    value: float
    unit_s: float
    ratio: float = 1.4
    exponent: float = 1.0

    def columns(self, run: Run) -> Array:
        return self._at(run.elapsed_s)[:, None]

    def _at(self, elapsed_s: Array) -> Array:
        if self.law == "power":
            return np.asarray((elapsed_s / self.unit_s) ** self.value)
        scaled = elapsed_s / self.value
        if self.law == "hyperbola":
            return np.asarray((1.0 + scaled) ** -self.exponent)
        return np.asarray(np.exp(-(scaled**self.exponent)) if self.law == "exponential" else np.log1p(scaled))

    @property
    def settles(self) -> bool:
        """Whether it may be a warm-up: of one that has not settled within a run nobody can tell that it will."""
        return self.law in ("logarithm", "power") or float(self._at(np.asarray(self.unit_s))) <= priors.WARM_UP_LEFT

    def nearby(self, step: float) -> tuple[Self, ...]:
        if self.law == "power" and self.value == 1.0:
            return ()
        found = [dataclasses.replace(self, value=self.value * f) for f in (self.ratio**step, self.ratio**-step)]
        if self.law == "hyperbola" or self.exponent != 1.0:
            found += [
                dataclasses.replace(self, exponent=self.exponent * f) for f in (_EXPONENT_RATIO**step, _EXPONENT_RATIO**-step)
            ]
        return tuple(one for one in found if one.settles)

    def parameters(self) -> dict[str, float]:
        if self.law == "power":
            return {} if self.value == 1.0 else {"exponent": self.value}
        own = {"q": self.exponent} if self.law == "hyperbola" or self.exponent != 1.0 else {}
        return {"time_constant_s": self.value, **own}

    @property
    def of_mechanism(self) -> bool:
        """Of the laws, the exponential and the straight line are equations of the catalogue."""
        return self.value == 1.0 if self.law == "power" else self.law == "exponential" and self.exponent == 1.0

    def per_unit(self) -> float:
        return SECONDS_PER_DAY / self.unit_s if self.law == "power" and self.value == 1.0 else 1.0


@dataclasses.dataclass(frozen=True)
class SmoothSince(Basis):
    """A Gaussian process of the logarithm of the time since switch-on."""

    shortest_s: float
    longest_s: float
    width: float = 0.4
    knots: int = 10

    def columns(self, run: Run) -> Array:
        scaled = 2.0 * np.log1p(run.elapsed_s / self.shortest_s) / math.log1p(self.longest_s / self.shortest_s) - 1.0
        return gaussian_process(np.minimum(scaled, 1.1), self.width, self.knots)


@dataclasses.dataclass(frozen=True)
class Wave(Basis):
    """Cosine and sine of one frequency, their phase counted from the beginning of the run; `growing`, times the time."""

    frequency_hz: float
    resolution_hz: float
    growing: bool = False

    def columns(self, run: Run) -> Array:
        turn = 2.0 * math.pi * self.frequency_hz * run.elapsed_s
        waves = np.column_stack([np.cos(turn), np.sin(turn)])
        return waves * (2.0 * run.elapsed_s / run.elapsed_s[-1] - 1.0)[:, None] if self.growing else waves

    def nearby(self, step: float) -> tuple[Self, ...]:
        moves = step * self.resolution_hz, -step * self.resolution_hz
        return tuple(dataclasses.replace(self, frequency_hz=self.frequency_hz + move) for move in moves)

    def parameters(self) -> dict[str, float]:
        return {"frequency_hz": self.frequency_hz}


@dataclasses.dataclass(frozen=True)
class Modulated(Basis):
    """A wave whose amplitude and phase change slowly, as of a frequency that wanders: Gaussian processes of the time in a run."""

    wave: Wave
    knots: int

    @property
    def width(self) -> float:
        """Correlation length of the processes over half a run."""
        return 2.0 / self.knots

    def columns(self, run: Run) -> Array:
        time = 2.0 * run.elapsed_s / run.elapsed_s[-1] - 1.0
        return (self.wave.columns(run)[:, :, None] * self._slow(time)[:, None, :]).reshape(run.bins, -1)

    def nearby(self, step: float) -> tuple[Self, ...]:
        return tuple(dataclasses.replace(self, wave=wave) for wave in self.wave.nearby(step))

    def parameters(self) -> dict[str, float]:
        return self.wave.parameters()

    def envelope(self, weights: Array, run: str = "") -> npt.NDArray[np.complex128]:
        """Its complex amplitude at even places of a run, of weights of shape (..., 2 knots)."""
        del run
        cosine, sine = np.moveaxis(weights.reshape(*weights.shape[:-1], 2, self.knots), -2, 0)
        return np.asarray((cosine - 1j * sine) @ self._slow(_places(self.knots)).T)

    def _slow(self, time: Array) -> Array:
        return gaussian_process(time, self.width, self.knots)


def moments(envelope: npt.NDArray[np.complex128], seconds: float) -> Array:
    """Of the power of a complex amplitude in a run: integral, mean and mean square of its frequency, by Parseval's theorem.

    Parameters
    ----------
    envelope : ndarray, shape (..., places)
        At even places.
    seconds : float
        Length of the run.

    Returns
    -------
    ndarray, shape (..., 3)
        The latter two times the integral, in hertz and its square.
    """
    step = seconds / (envelope.shape[-1] - 1.0)
    slope = np.gradient(envelope, step, axis=-1) / (2.0 * math.pi)
    powers = np.abs(envelope) ** 2, np.imag(np.conj(envelope) * slope), np.abs(slope) ** 2
    return np.stack([step * power.sum(axis=-1) for power in powers], axis=-1)


def mean_and_width(moments: Array) -> tuple[Array, Array]:
    """Of moments of runs, shape (..., runs, 3): mean frequency less the wave's own and standard deviation of the spectrum."""
    power, first, second = np.moveaxis(moments.sum(axis=-2), -1, 0)
    mean = first / power
    return mean, np.sqrt(np.maximum(second / power - mean**2, 0.0))


@dataclasses.dataclass(frozen=True)
class Wide(Modulated):
    """The same with a spectrum so wide that its frequency is not polished: it would become a line."""

    def nearby(self, step: float) -> tuple[Self, ...]:
        del step
        return ()


@dataclasses.dataclass(frozen=True)
class Straying(Basis):
    r"""A wave of a steady amplitude whose phase strays, linear about a course of its phase in each run.

    With T the turn along the course and :math:`g_k` a Gaussian process of the time in a run,
    :math:`A \cos(T + \sum_k \delta_k g_k) \approx A \cos T - A \sin T \sum_k \delta_k g_k`. It has weights for the amplitude
    and a constant of the phase, and for each :math:`\delta_k / \sigma`.

    Parameters
    ----------
    wave : Wave
    courses : tuple of (str, tuple of float)
        By run: a constant of the phase and its weights along the Gaussian process, in radians.
    spread : float
        Standard deviation of those by their prior, sigma.
    smooth : float
        Knots of the process in its correlation length.
    """

    wave: Wave
    courses: tuple[tuple[str, tuple[float, ...]], ...]
    spread: float
    smooth: float = 1.0

    @classmethod
    def of(cls, modulated: Modulated, envelopes: Mapping[str, npt.NDArray[np.complex128]], smooth: float = 1.0) -> Self:
        """About the phases of a modulated wave in each run."""
        phases = {run: np.unwrap(np.angle(one)) for run, one in envelopes.items()}
        return cls._about(modulated.wave, {run: _course(one, modulated.knots, smooth) for run, one in phases.items()}, smooth)

    @classmethod
    def _about(cls, wave: Wave, courses: Mapping[str, Array], smooth: float) -> Self:
        size = math.sqrt(float(np.mean([np.mean(course[1:] ** 2) for course in courses.values()])))
        spread = min(priors.PHASES, key=lambda one: abs(math.log(max(size, priors.PHASES[0]) / one)))
        return cls(wave, tuple((run, tuple(course.tolist())) for run, course in courses.items()), spread, smooth)

    def finer(self, knots: int) -> Self:
        """About the same courses along more knots."""
        along = _course_columns(self.knots, _places(self.knots), self.smooth)
        courses = {run: _course(along @ np.array(course), knots, self.smooth) for run, course in self.courses}
        return self._about(self.wave, courses, self.smooth)

    @property
    def knots(self) -> int:
        return len(self.courses[0][1]) - 1

    @property
    def log_prior(self) -> float:
        """Of its courses, over that of none: the weights about them have a prior about zero."""
        return -0.5 * sum(weight**2 for _, course in self.courses for weight in course[1:]) / self.spread**2

    def turn(self, run: Run) -> Array:
        """In radians; straight in a run without a course."""
        return self._turn(run, self._along(run))

    def columns(self, run: Run) -> Array:
        along = self._along(run)
        turn = self._turn(run, along)
        return np.column_stack([np.cos(turn), np.sin(turn), -self.spread * np.sin(turn)[:, None] * along[:, 1:]])

    def _along(self, run: Run) -> Array:
        return _course_columns(self.knots, 2.0 * run.elapsed_s / run.elapsed_s[-1] - 1.0, self.smooth)

    def _turn(self, run: Run, along: Array) -> Array:
        straight = 2.0 * math.pi * self.wave.frequency_hz * run.elapsed_s
        return np.asarray(straight + along @ np.array(dict(self.courses).get(run.name, np.zeros(self.knots + 1))))

    def renewed(self, weights: Array) -> Self:
        """About the courses that weights show, shape (runs, 2 + knots), or what is in proportion to them: a Gauss-Newton step."""
        courses = {}
        for (run, course), (cosine, sine, *others) in zip(self.courses, weights, strict=True):
            found = np.array(course)
            found[0] -= math.atan2(sine, cosine)
            if abs(sine) < abs(cosine):
                step = self.spread * np.array(others) / cosine
                found[1:] += step * min(1.0, _FARTHEST_STEP / max(float(np.abs(step).max()), 1e-300))
            courses[run] = found
        return self._about(self.wave, courses, self.smooth)

    def envelope(self, weights: Array, run: str) -> npt.NDArray[np.complex128]:
        """Its complex amplitude at even places of a run, of weights of shape (..., 2 + knots)."""
        along = _course_columns(self.knots, _places(self.knots), self.smooth)
        stray = (self.spread * weights[..., 2:] / weights[..., :1]) @ along[:, 1:].T
        course = along @ np.array(dict(self.courses)[run])
        return np.asarray((weights[..., :1] - 1j * weights[..., 1:2]) * np.exp(1j * (course + stray)))

    def parameters(self) -> dict[str, float]:
        return self.wave.parameters()


@dataclasses.dataclass(frozen=True)
class Overtone(Basis):
    """Cosine and sine of a harmonic of a wave whose phase strays: it strays by as many times as much."""

    of: Straying
    order: int

    def columns(self, run: Run) -> Array:
        turn = self.order * self.of.turn(run)
        return np.column_stack([np.cos(turn), np.sin(turn)]) * (run.name in dict(self.of.courses))


def _places(knots: int) -> Array:
    return np.linspace(-1.0, 1.0, _PER_KNOT * knots)


def _course(phase: Array, knots: int, smooth: float) -> Array:
    """Weights of a phase at even places of a run, in radians."""
    design = _course_columns(knots, np.linspace(-1.0, 1.0, len(phase)), smooth)
    ridge = np.diag([0.0, *np.full(knots, _RIDGE)])
    return np.asarray(np.linalg.solve(design.T @ design + ridge, design.T @ phase))


def _course_columns(knots: int, time: Array, smooth: float) -> Array:
    """One, and a Gaussian process of the time in a run, which is -1 to 1, with so many knots in its correlation length."""
    return _columns_at(knots, np.asarray(time, np.float64).tobytes(), smooth)


@functools.lru_cache(maxsize=16)
def _columns_at(knots: int, times: bytes, smooth: float) -> Array:
    """Those of times as they lie in memory: they are the same for all waves that are tried on a run."""
    time = np.frombuffer(times)
    found = np.column_stack([np.ones(len(time)), gaussian_process(time, 2.0 * smooth / knots, knots)])
    found.flags.writeable = False
    return found


@dataclasses.dataclass(frozen=True)
class Following(Basis):
    """A wave, and the same wave times a recorded column: its amplitude follows the column, or its phase does."""

    wave: Wave
    by: Path

    def columns(self, run: Run) -> Array:
        waves = self.wave.columns(run)
        return np.hstack([waves, waves * self.by.values(run)[:, None]])

    def nearby(self, step: float) -> tuple[Self, ...]:
        return tuple(dataclasses.replace(self, wave=wave) for wave in self.wave.nearby(step))

    def parameters(self) -> dict[str, float]:
        return self.wave.parameters()

    @property
    def of_mechanism(self) -> bool:
        """Its weights are not all amplitudes of the mechanism."""
        return False
