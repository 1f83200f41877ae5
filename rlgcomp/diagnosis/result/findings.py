"""What is missing: the causes and where they show, what else could be, what is left, and the run that would tell."""

from __future__ import annotations

import dataclasses
import math
import re
import sys
from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from rlgcomp.diagnosis.result import equations
from rlgcomp.diagnosis.result.phrases import raised_text, sure_text
from rlgcomp.errors import InputError
from rlgcomp.physics.mechanism import TABLE_ANGLE, TABLE_RATE, TEMPERATURE, Mechanism, Parameter
from rlgcomp.recording import Recording

Array = npt.NDArray[np.float64]
_SYMBOLS: Final = {TEMPERATURE: "T", TABLE_RATE: "W", TABLE_ANGLE: "theta"}
_SMALLEST, _LARGEST = -3, 5  # powers of ten that numbers are printed without


@dataclasses.dataclass(frozen=True)
class Place:
    """Where the mismatch is: a run and interval, a regime of the monitors, a frequency, or a harmonic of the table's angle.

    Parameters
    ----------
    run, channel : str
    start_s, end_s : float, optional
        Interval in the run's own time; None where the place is no interval.
    regime : str, optional
        As "temperature_block_degC > 31, cooling".
    frequency_hz, angle_harmonic : float, optional
    share : float
        Of the sum of squares that the baseline leaves beyond white noise, between 0 and 1, what was found before taken out.
    p_value : float
        Corrected for everything that was searched.
    """

    run: str
    channel: str
    start_s: float | None = None
    end_s: float | None = None
    regime: str | None = None
    frequency_hz: float | None = None
    angle_harmonic: float | None = None
    share: float = 0.0
    p_value: float = 1.0


@dataclasses.dataclass(frozen=True)
class Estimate:
    """A number with its standard deviation and unit, "1" of a plain number; printed, both have two digits of the latter and one
    power of ten.

    >>> str(Estimate(0.0123456, 0.00056, "deg/h/K")), str(Estimate(1834.2, 41.0, "s")), str(Estimate(3.0, 0.0, "1"))
    ('0.01235 ± 0.00056 deg/h/K', '1834 ± 41 s', '3')
    >>> str(Estimate(-8.51e-7, 1.23e-7, "deg/h/K^2")), str(Estimate(3.1e7, 1.9e4, "s"))
    ('(-8.5 ± 1.2)·10⁻⁷ deg/h/K^2', '(3.1000 ± 0.0019)·10⁷ s')
    """

    value: float
    sd: float
    unit: str = ""

    def __str__(self) -> str:
        unit = "" if self.unit == "1" else self.unit
        if not (math.isfinite(self.sd) and self.sd > 0.0):
            return f"{self.value:.6g} {unit}".rstrip()
        of_sd = math.floor(math.log10(self.sd))
        power = max(of_sd, math.floor(math.log10(abs(self.value)))) if self.value else of_sd
        power = power if power < _SMALLEST or power > _LARGEST else 0
        digits = max(0, 1 - of_sd + power)
        value, sd = (f"{number * 10.0**-power:.{digits}f}" for number in (self.value, self.sd))
        if not power:
            return f"{value} ± {sd} {unit}".rstrip()
        return f"({value} ± {sd})·10{raised_text(power)} {unit}".rstrip()


@dataclasses.dataclass(frozen=True)
class Cause:
    """A mechanism that the simulator is missing.

    Parameters
    ----------
    mechanism : Mechanism
        With the fitted parameters.
    probability : float
        That it is part of the truth: the sum over all sets that hold it.
    parameters : mapping of str to Estimate
        The fitted ones, by name.
    rms_deg_h : float
        Of its contribution at window means over the training runs.
    indistinguishable_from : tuple of str
        Mechanisms that these data cannot tell from it.
    drivers : tuple of str
        Columns that it read; by default those that it names itself.
    probability_in_training : float, optional
        The same probability by the training runs alone, where held-out runs were asked as well.
    rival_probabilities : tuple of float
        Of each in `indistinguishable_from`, that it is part of the truth.
    """

    mechanism: Mechanism
    probability: float
    parameters: Mapping[str, Estimate]
    rms_deg_h: float
    indistinguishable_from: tuple[str, ...] = ()
    drivers: tuple[str, ...] = ()
    probability_in_training: float | None = None
    rival_probabilities: tuple[float, ...] = ()

    @property
    def name(self) -> str:
        return self.mechanism.name

    @property
    def symbols(self) -> dict[str, str]:
        """The columns that letters of its equation stand for."""
        names = self.mechanism.driver_names()
        if len(names) != len(self.drivers):
            return {}
        letters = {_SYMBOLS[name]: column for name, column in zip(names, self.drivers, strict=True) if name in _SYMBOLS}
        said = self.mechanism.stated()
        return {letter: column for letter, column in letters.items() if re.search(rf"\bd?{letter}\b", said)}

    @property
    def driven_by(self) -> str:
        """What it follows, for a reader."""
        if columns := self.drivers or self.mechanism.driver_names():
            return ", ".join(columns)
        if self.mechanism.is_telegraph():
            return "nothing recorded"
        return "time by the clock" if getattr(self.mechanism, "since", "start") == "clock" else "time since the run's start"

    def numbers(self) -> dict[str, str]:
        """What was found of it, for a reader: parameters with their standard deviations, and forms that are not the usual ones."""
        fitted = {name: str(estimate) for name, estimate in self.parameters.items()}
        return fitted | {p.name: self._setting(p) for p in self.mechanism.parameters() if p.role == "setting" and self._tells(p)}

    def _setting(self, parameter: Parameter) -> str:
        value = getattr(self.mechanism, parameter.name)
        return value if isinstance(value, str) else f"{value:.6g} {parameter.unit}".rstrip()

    def _tells(self, parameter: Parameter) -> bool:
        """Whether a setting is needed to know the law: it is not the usual one, or its equation leaves it open."""
        if getattr(self.mechanism, parameter.name) != parameter.typical or parameter.name == "phase":
            return True
        if parameter.choices or parameter.typical == 0:
            return False
        named = re.sub(r"_\d$", "_", parameter.name)  # order_1 as order_j, where the equation is that of any number of orders
        said = self.mechanism.stated() if named == parameter.name else self.mechanism.equation
        return re.search(rf"\b{named}", said) is not None

    @property
    def latex(self) -> str:
        """The equation as LaTeX: of its line of text or, where this is in words, the formula of the mechanism's description."""
        return equations.latex(self.mechanism.stated(), type(self.mechanism).__doc__ or "")

    def sympy(self, *, numbers: bool = False) -> Any:
        """The equation's right side as an expression of SymPy, in deg/h; with `numbers`, parameters have their fitted values.

        Raises
        ------
        InputError
            SymPy is not installed, or the equation is stated in words.
        """
        expression = equations.sympy(self.mechanism.stated())
        if not numbers:
            return expression
        values = {p.name: getattr(self.mechanism, p.name) for p in self.mechanism.parameters()}
        return expression.subs({symbol: values[str(symbol)] for symbol in expression.free_symbols if str(symbol) in values})

    def __call__(self, recording: Recording) -> Array:
        """What the mechanism contributes to a recording's gyro in deg/h, by its drivers; shape (n,).

        Raises
        ------
        InputError
            It has no amplitude that holds for other runs, or the recording lacks a driver.
        """
        if not self.mechanism.repeats():
            raise InputError(f"{self.name} differs from run to run: what was found of one run says nothing of another")
        return self.mechanism.contribution(recording, np.random.default_rng(0))

    def to_mapping(self) -> dict[str, Any]:
        """An entry of `findings`."""
        return {
            "mechanism": self.name,
            "probability": self.probability,
            "probability_in_training": self.probability_in_training,
            "parameters": {name: dataclasses.asdict(estimate) for name, estimate in self.parameters.items()},
            "settings": {p.name: getattr(self.mechanism, p.name) for p in self.mechanism.parameters() if p.role == "setting"},
            "equation": self.mechanism.stated(),
            "symbols": self.symbols,
            "drivers": list(self.drivers or self.mechanism.driver_names()),
            "rms": {"value": self.rms_deg_h, "unit": "deg/h"},
            "indistinguishable_from": list(self.indistinguishable_from),
            "rival_probabilities": list(self.rival_probabilities),
            "reference": self.mechanism.reference,
        }


@dataclasses.dataclass(frozen=True)
class Alternative:
    """Another set of mechanisms, the empty one included, and its probability."""

    mechanisms: tuple[str, ...]
    probability: float


@dataclasses.dataclass(frozen=True)
class Law:
    """A law that was found in recorded columns.

    Parameters
    ----------
    equation : str
    drivers : tuple of str
    memory : {"static", "dynamic", "rate-independent"}
    parameters : mapping of str to Estimate
        Its numbers, by name, with their standard deviations, each with all others uncertain as well. None is here that the runs
        leave open, because the simulator's own terms make up for it, nor the half ranges by which the equation is scaled.
    """

    equation: str
    drivers: tuple[str, ...]
    memory: str
    parameters: Mapping[str, Estimate]


@dataclasses.dataclass(frozen=True)
class Nearest:
    """The law that comes nearest to one that would be claimed, where none is.

    Parameters
    ----------
    equation : str
    drivers : tuple of str
    memory : str
    probability : float
    """

    equation: str
    drivers: tuple[str, ...]
    memory: str
    probability: float


@dataclasses.dataclass(frozen=True)
class Unexplained:
    """What is left when the named mechanisms are taken out.

    Parameters
    ----------
    p_value : float
        That it is noise.
    drivers : tuple of str
        Recorded columns that it follows; empty when it follows none.
    memory : {"static", "dynamic", "rate-independent", "none"}
    equation : str, optional
        The best law found.
    probability : float, optional
        That there is such a law, or something that wanders unrecorded; None where neither is claimed.
    laws : tuple of Law
        One for each term of the equation.
    memory_probabilities : mapping of str to float
        Of each memory of the first law, given its drivers; a law that a simpler one explains as well counts with that.
    nearest : Nearest, optional
        Of something that wanders: the law that comes near.
    """

    p_value: float
    drivers: tuple[str, ...] = ()
    memory: str = "none"
    equation: str | None = None
    probability: float | None = None
    laws: tuple[Law, ...] = ()
    memory_probabilities: Mapping[str, float] = dataclasses.field(default_factory=dict)
    nearest: Nearest | None = None

    @property
    def latex(self) -> str | None:
        """The best law found as LaTeX."""
        return None if self.equation is None else equations.latex(self.equation)


@dataclasses.dataclass(frozen=True)
class Step:
    """A step of the bias in one training run, which no other run shows: no law can be learnt of one event.

    Parameters
    ----------
    run : str
    at_s : float
        In the run's own time.
    size : Estimate
        What the bias is more by, afterwards.
    probability : float
    """

    run: str
    at_s: float
    size: Estimate
    probability: float


@dataclasses.dataclass(frozen=True)
class InPart:
    """A cause that acts in a part of the training runs: something that was not recorded switches it on.

    Parameters
    ----------
    mechanism : str
        That does as it does.
    drivers : tuple of str
    size : Estimate
        Of its amplitude, where it acts.
    acts : tuple of str
        Runs, those held out included, in which it acts throughout.
    silent : tuple of str
        Runs in which it does not act; what others show is not certain.
    probability : float
    run : str, optional
        One more run in which it acts,
    at_s : float, optional
        by a moment:
    after : bool
        after that, or before.
    """

    mechanism: str
    drivers: tuple[str, ...]
    size: Estimate
    acts: tuple[str, ...]
    silent: tuple[str, ...]
    probability: float
    run: str | None = None
    at_s: float | None = None
    after: bool = True


def chance(events: Sequence[Step | InPart]) -> float:
    """That none of these is there."""
    return min((max(1.0 - one.probability, sys.float_info.epsilon) for one in events), default=1.0)


@dataclasses.dataclass(frozen=True)
class NextExperiment:
    """The programme that would tell rival explanations apart.

    Parameters
    ----------
    separates : tuple of str
    profile : str
        A chamber or turntable programme that `rlgcomp simulate --profile` takes.
    expected_probability_after : float
        Of whichever explanation is true, once that programme was run.
    if_true : tuple of float
        The same of each of those it separates, were it the true one.
    duration_s : float, optional
    shows_s : (float, float), optional
        The shortest part of it, from its start, that holds half of what tells the two likeliest apart.
    probability_of_these : float
        That the true one is among those it separates.
    """

    separates: tuple[str, ...]
    profile: str
    expected_probability_after: float
    if_true: tuple[float, ...] = ()
    duration_s: float | None = None
    shows_s: tuple[float, float] | None = None
    probability_of_these: float = 1.0

    @property
    def by_truth(self) -> str:
        """The expected probability of each, were it the true one."""
        return ", ".join(f"{name} {sure_text(p, 2)}" for name, p in zip(self.separates, self.if_true, strict=False))
