"""What is missing: the causes and where they show, what else could be, what is left, and the run that would tell."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from typing import Any

from rlgcomp.physics.mechanism import Mechanism


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
        Of the sum of squares that the baseline leaves beyond noise, between 0 and 1.
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
    """A number with its standard deviation and unit; printed, both have two digits of the latter.

    >>> str(Estimate(0.0012345, 0.000056, "deg/h/K")), str(Estimate(1834.2, 41.0, "s")), str(Estimate(3.0, 0.0))
    ('0.001234 ± 0.000056 deg/h/K', '1834 ± 41 s', '3')
    """

    value: float
    sd: float
    unit: str = ""

    def __str__(self) -> str:
        if not (math.isfinite(self.sd) and self.sd > 0.0):
            return f"{self.value:.6g} {self.unit}".rstrip()
        digits = max(0, 1 - math.floor(math.log10(self.sd)))
        if digits > 8:
            return f"{self.value:.4g} ± {self.sd:.2g} {self.unit}".rstrip()
        return f"{self.value:.{digits}f} ± {self.sd:.{digits}f} {self.unit}".rstrip()


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
    """

    mechanism: Mechanism
    probability: float
    parameters: Mapping[str, Estimate]
    rms_deg_h: float
    indistinguishable_from: tuple[str, ...] = ()
    drivers: tuple[str, ...] = ()
    probability_in_training: float | None = None

    @property
    def name(self) -> str:
        return self.mechanism.name

    def numbers(self) -> dict[str, str]:
        """What was found of it, for a reader: parameters with their standard deviations, and forms that are not the usual ones."""
        fitted = {name: str(estimate) for name, estimate in self.parameters.items()}
        forms = {p.name: (str(getattr(self.mechanism, p.name)), p.typical) for p in self.mechanism.parameters() if p.choices}
        return fitted | {name: form for name, (form, usual) in forms.items() if form != usual}

    def to_mapping(self) -> dict[str, Any]:
        """An entry of `findings`."""
        return {
            "mechanism": self.name,
            "probability": self.probability,
            "probability_in_training": self.probability_in_training,
            "parameters": {name: dataclasses.asdict(estimate) for name, estimate in self.parameters.items()},
            "settings": {p.name: getattr(self.mechanism, p.name) for p in self.mechanism.parameters() if p.role == "setting"},
            "equation": self.mechanism.stated(),
            "drivers": list(self.drivers or self.mechanism.driver_names()),
            "rms": {"value": self.rms_deg_h, "unit": "deg/h"},
            "indistinguishable_from": list(self.indistinguishable_from),
            "reference": self.mechanism.reference,
        }


@dataclasses.dataclass(frozen=True)
class Alternative:
    """Another set of mechanisms, the empty one included, and its probability."""

    mechanisms: tuple[str, ...]
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
    """

    p_value: float
    drivers: tuple[str, ...] = ()
    memory: str = "none"
    equation: str | None = None


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
    """

    separates: tuple[str, ...]
    profile: str
    expected_probability_after: float
    if_true: tuple[float, ...] = ()

    @property
    def by_truth(self) -> str:
        """The expected probability of each, were it the true one."""
        return ", ".join(f"{name} {p:.2f}" for name, p in zip(self.separates, self.if_true, strict=False))
