"""Waves that a residual proposes: lines, whose spectrum is narrow, and what turns some times in a run and is none.

A wave whose frequency wanders is the narrower the longer it keeps its phase. Where that spectrum is as wide as its frequency
is high it is a smooth function of the time in each run: something unrecorded that wanders, and not a source of a period.
"""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Callable, Iterator
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from rlgcomp.diagnosis import priors
from rlgcomp.diagnosis.data import Data
from rlgcomp.diagnosis.forms.bases import Basis, EachRun
from rlgcomp.diagnosis.forms.drivers import Driver, Path
from rlgcomp.diagnosis.forms.terms import WANDER, Form, Left
from rlgcomp.diagnosis.forms.times import Following, Modulated, Overtone, Straying, Wave, Wide, mean_and_width, moments
from rlgcomp.diagnosis.regions.selections import OnlyIn
from rlgcomp.diagnosis.regions.setting import Setting

_CYCLES: Final = 3  # in the longest run, at least: fewer are a drift
_OVERSAMPLING: Final = 3  # frequencies in each resolution cell
_PEAKS: Final = 2
_HARMONICS: Final = 5
_MODULATIONS: Final = (6, 10, 16)  # knots of a run, of a wave whose frequency wanders
_FINER, _FINEST, _MOST_COURSES = 1.6, 42, 130  # knots of a phase over those before, and the most in a run and in all
_MOST_KNOTS: Final = 24  # of a harmonic
_WIDTH: Final = math.sqrt(2.0 * math.log(2.0)) / math.pi  # cycles a run and knot: of such a wave's spectrum at half of its height
_QUALITY: Final = 1.0  # of a line, its frequency over that width, at least: what has less wanders
_FORGETFUL: Final = 0.1  # standard deviation of its spectrum over its frequency: its phase is forgotten within two cycles
_NO_PERIOD: Final = 0.35  # the same of what has none, steady as its amplitude may be: it is forgotten within half a cycle
_BY_CHANCE: Final = 3.3  # of Gaussian noise one in twenty has an amplitude as steady: 1.64 standard deviations, each 2 / sqrt(n)
_WANDERING: Final = "b = wave of a frequency that wanders about frequency_hz"
_STRAYING: Final = "b = wave of a steady amplitude, whose frequency wanders about frequency_hz"
_WANDER: Final = "b = smooth function of the time in each run"


@dataclasses.dataclass(frozen=True, eq=False)
class _Waves:
    """Frequencies of the waves that runs can show, and the waves at them."""

    data: Data

    @functools.cached_property
    def names(self) -> tuple[str, ...]:
        return tuple(run.name for run in self.data.runs)

    @functools.cached_property
    def cells(self) -> int:
        return _OVERSAMPLING * self.data.longest

    @property
    def step_hz(self) -> float:
        return 1.0 / (self.cells * self.data.runs[0].grid.window_s)

    @functools.cached_property
    def places(self) -> npt.NDArray[np.intp]:
        """In steps."""
        return np.arange(_CYCLES * _OVERSAMPLING, self.cells // 2)

    @property
    def log_share(self) -> float:
        """Of a form at one place, be it a line or wider: the prior does not jump where the name does."""
        return -math.log(2.0 * max(1, len(self.places)))

    def one(self, place: float) -> Wave:
        return Wave(place * self.step_hz, self.step_hz)

    def modulated(self, place: float, knots: int) -> EachRun:
        """A wave of a frequency that wanders."""
        of = Modulated if _is_line(place, knots) else Wide
        return EachRun(of(self.one(place), knots), self.names)

    def peaks(self, residual: np.ndarray[Any, Any], each: bool) -> Iterator[int]:
        """Places of the highest peaks of the periodogram, of all runs together or with a phase in each."""
        transforms = []
        for run, rows in zip(self.data.runs, self.data.slices, strict=True):
            even = np.zeros(self.cells)
            even[run.windows] = residual[rows]
            transforms.append(np.fft.rfft(even)[self.places])
        power = np.sum(np.abs(transforms) ** 2, axis=0) if each else np.abs(np.sum(transforms, axis=0)) ** 2
        for _ in range(_PEAKS if len(self.places) else 0):
            k = int(np.argmax(power))
            yield int(self.places[k])
            power[max(0, k - 3 * _OVERSAMPLING) : k + 3 * _OVERSAMPLING + 1] = 0.0


def _is_line(place: float, knots: int) -> bool:
    """Whether the spectrum of a wave whose frequency wanders is narrow."""
    return place / _OVERSAMPLING >= _QUALITY * _WIDTH * knots


def _with_wave(basis: Basis, change: Callable[[Wave], Wave]) -> Basis:
    """The wave of a basis changed, where it acts as the basis does: in each run or in some of them."""
    if isinstance(basis, EachRun | OnlyIn):
        return dataclasses.replace(basis, basis=_with_wave(basis.basis, change))
    wave = basis if isinstance(basis, Wave) else getattr(basis, "wave", None)
    assert isinstance(wave, Wave)  # noqa: S101
    return change(wave)


@dataclasses.dataclass(frozen=True)
class _Harmonic:
    """Makes the harmonic of an order of a wave; it goes with the wave's frequency while that is polished."""

    order: int

    def __call__(self, basis: Basis) -> Basis:
        return _with_wave(basis, lambda wave: dataclasses.replace(wave, frequency_hz=self.order * wave.frequency_hz))


def _growing(basis: Basis) -> Basis:
    """A wave whose amplitude grows with the time in a run."""
    return _with_wave(basis, lambda wave: dataclasses.replace(wave, growing=True))


_HIGHER: Final[tuple[Callable[[Basis], Basis], ...]] = tuple(_Harmonic(order) for order in range(2, _HARMONICS + 1))


def lines(setting: Setting, key: str) -> Callable[[np.ndarray[Any, Any]], tuple[Form, ...]]:
    """Proposals of a line: peaks of the periodogram, with one phase in all runs or with one in each.

    One of one phase may have an amplitude that follows a recorded column, as of a source on the supply that is recorded.
    """
    waves, data = _Waves(setting.data), setting.data
    columns = [Path(Driver.of(data, column)) for column in data.columns]

    def forms(place: float, each: bool) -> Form:
        first = EachRun(waves.one(place), waves.names) if each else waves.one(place)
        own = _HIGHER if each else (*_HIGHER, _growing)
        phase = "of a phase in each run" if each else "of one phase"
        return Form(key, f"b = wave of frequency_hz, {phase}", (first,), (), own, waves.log_share)

    def wandering(place: float, knots: int) -> Iterator[Form]:
        steady = EachRun(waves.one(place), waves.names)
        harmonics = tuple(one(steady) for one in _HIGHER)
        for smooth in ((), harmonics) if knots < _MODULATIONS[-1] else ((),):
            yield Form(key, _WANDERING, (waves.modulated(place, knots),), smooth, (), waves.log_share - math.log(2.0))

    def following(place: float, by: Path) -> Form:
        equation = f"b = wave of frequency_hz, of one phase, whose amplitude follows {by.driver.symbol}"
        share = waves.log_share - math.log(len(columns))
        return dataclasses.replace(forms(place, False), equation=equation, lead=(Following(waves.one(place), by),), log_share=share)

    def propose(residual: np.ndarray[Any, Any]) -> tuple[Form, ...]:
        found = []
        for each in (False, True):
            for place in waves.peaks(residual, each):
                found += [forms(place + shift, each) for shift in (-0.5, 0.0, 0.5)]
                found += [form for knots in _MODULATIONS if each and _is_line(place, knots) for form in wandering(place, knots)]
                found += [following(place, by) for by in columns if not each]
        return tuple(found)

    return propose


def harmonics(setting: Setting) -> Callable[[Form], Iterator[Form]]:
    """A line whose frequency wanders with one more harmonic, which wanders by as many times as much."""
    highest_hz = 0.5 / setting.data.runs[0].grid.window_s

    def grow(form: Form) -> Iterator[Form]:
        first = form.lead[0]
        if not isinstance(first, EachRun) or not isinstance(first.basis, Modulated | Straying):
            return
        wave, knots = first.basis.wave, first.basis.knots
        for order in range(2, _HARMONICS + 2):
            harmonic = dataclasses.replace(wave, frequency_hz=order * wave.frequency_hz)
            basis: Basis = EachRun(Wide(harmonic, min(order * knots, _MOST_KNOTS)), first.runs)
            if isinstance(first.basis, Straying):
                basis = Overtone(first.basis, order)
            if basis not in form.lead and harmonic.frequency_hz < highest_hz:
                yield dataclasses.replace(form, lead=(*form.lead, basis))

    return grow


def steadied(form: Form, left: Left) -> Iterator[tuple[Form, ...]]:
    """A line whose frequency wanders as one of a steady amplitude, about the courses of its phase; none of any other form.

    A phase that is rough and one that is smooth are of kinds of their own, for steps of the rough one would overtake the other's.

    Parameters
    ----------
    form : Form
    left : Left
    """
    first = form.lead[0]
    if not isinstance(first, EachRun) or not isinstance(first.basis, Modulated | Straying):
        return
    of_runs = left.weights[0].reshape(len(first.runs), -1)
    if isinstance(first.basis, Straying):
        yield tuple(_about(form, first.runs, first.basis.renewed(of_runs), first.basis.log_prior))
        return
    phases = {run: first.basis.envelope(own) for run, own in zip(first.runs, of_runs, strict=True)}
    counted = math.log(len(priors.PHASES) * len(priors.SMOOTHNESSES))
    for smooth in priors.SMOOTHNESSES:
        yield tuple(_about(form, first.runs, Straying.of(first.basis, phases, smooth), counted))


def _about(form: Form, runs: tuple[str, ...], straying: Straying, counted: float) -> Iterator[Form]:
    """A line as a straying wave, on its knots and on more, without and with harmonics.

    Parameters
    ----------
    form : Form
    runs : tuple of str
    straying : Straying
    counted : float
        Of the log prior of its courses, what the form has already.
    """
    more = round(_FINER * straying.knots)
    for one in (straying, straying.finer(more)) if more <= min(_FINEST, _MOST_COURSES / len(runs)) else (straying,):
        lead = (EachRun(one, runs), *(Overtone(one, basis.order) for basis in form.lead[1:] if isinstance(basis, Overtone)))
        share = form.log_share + one.log_prior - counted
        for overtones in (), tuple(Overtone(one, order) for order in range(2, _HARMONICS + 1)):
            smooth = tuple(basis for basis in overtones if basis not in lead)
            yield dataclasses.replace(form, equation=_STRAYING, lead=lead, smooth=smooth, log_share=share)


def strays(form: Form) -> Modulated | Straying | None:
    """The wave of a line whose frequency wanders; None of any other form."""
    first = form.lead[0]
    basis = first.basis if isinstance(first, EachRun) else None
    return basis if isinstance(basis, Modulated | Straying) and not isinstance(basis, Wide) else None


def as_wander(form: Form, weights: np.ndarray[Any, Any], data: Data) -> Form | None:
    """A line that is none, as what wanders unrecorded: its phase is soon forgotten, and its amplitude is not steady; else None.

    A source of a period has an amplitude, were its phase to stray; of what is random both come and go together, and the mean square
    of its power is twice the square of the mean, as far as n independent pieces show it. What forgets its phase within half a cycle
    has no period, whatever its amplitude.

    Parameters
    ----------
    form : Form
    weights : ndarray, shape (m,)
        Of its first leading basis, or in proportion to them.
    data : Data
    """
    wave, first = strays(form), form.lead[0]
    if wave is None or not isinstance(first, EachRun):
        return None
    of_runs = dict(zip(first.runs, weights.reshape(len(first.runs), -1), strict=True))
    known = [(run, wave.envelope(of_runs[run.name], run.name)) for run in data.runs if run.name in of_runs]
    mean, width = mean_and_width(np.array([moments(envelope, float(run.elapsed_s[-1])) for run, envelope in known]))
    share = width / (wave.wave.frequency_hz + mean)
    power = np.abs([envelope for _, envelope in known]) ** 2
    pieces = sum(max(1.0, float(2.0 * math.sqrt(math.pi) * width * run.elapsed_s[-1])) for run, _ in known)
    least = 2.0 - _BY_CHANCE / math.sqrt(pieces)
    steady = isinstance(wave, Straying) or bool(np.mean(power**2) < least * np.mean(power) ** 2)
    if share < (_NO_PERIOD if steady else _FORGETFUL):
        return None
    wide = first if isinstance(wave, Straying) else EachRun(Wide(wave.wave, wave.knots), first.runs)
    return dataclasses.replace(form, region=WANDER, equation=_WANDER, lead=(wide, *form.lead[1:]))


def wanders(setting: Setting) -> Callable[[np.ndarray[Any, Any]], tuple[Form, ...]]:
    """Proposals of what turns some times in a run and is no line, for its spectrum is wide: something unrecorded that wanders."""
    waves = _Waves(setting.data)

    def propose(residual: np.ndarray[Any, Any]) -> tuple[Form, ...]:
        return tuple(
            Form(WANDER, _WANDER, (waves.modulated(place, knots),), (), (), waves.log_share)
            for place in waves.peaks(residual, True)
            for knots in _MODULATIONS
            if not _is_line(place, knots)
        )

    return propose
