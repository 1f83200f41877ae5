"""An empirical law: one regression term in one or two recorded quantities."""

from __future__ import annotations

import dataclasses
import math
from typing import Any, Final

import numpy as np

from rlgcomp.errors import InputError
from rlgcomp.numerics.filters import ahead, lag, rate_per_min, running_mean
from rlgcomp.numerics.hysteresis import STARTS, play_paths
from rlgcomp.physics.mechanism import TABLE_RATE, TEMPERATURE, Array, Mechanism, amplitude, setting, shape
from rlgcomp.recording import Recording
from rlgcomp.recording.motion import rate_deg_s
from rlgcomp.report.messages import Message, message
from rlgcomp.units import column_unit

SMOOTHING_S: Final = 20.0  # a law follows the quantity, not its read noise
MEMORIES: Final = ("static", "lag", "rate", "play", "plays")
PARITIES: Final = ("none", "even", "odd")
FORMS: Final = ("power", "above", "below", "step", "saturation", "bump", "resonance", "dispersion", "periodic")
NARROW: Final = ("saturation", "bump", "resonance", "dispersion", "periodic")  # forms that have a width
RATE_INDEPENDENT: Final = ("play", "plays")
_SHARES: Final = -np.log1p(-(np.arange(8) + 0.5) / 8)  # radii at equal steps of an exponential distribution of mean one
_ROUNDING: Final = 1e-9  # of half the range: a middle nearer to zero is zero
_FURTHER: Final = 0.2  # of the range of a driver: further beyond, a law is called extrapolated
_LARGEST: Final = 1e9
_UNITS: Final = {TEMPERATURE: "degC", TABLE_RATE: "deg/s"}
_AS_THEY_ARE: Final = ("deg", "deg/s")


@dataclasses.dataclass(frozen=True)
class EmpiricalLaw(Mechanism):
    r"""One term: an amplitude times a form of a driver's memory, times a second driver where there is one.

    .. math:: b = A \, f(m) \, \frac{u_2 - a_2}{h_2}, \qquad m = M[u + \tau_s \dot u]

    u is a recorded column (`driver`), or the difference of two (`driver` less `less`), averaged over 20 s; or "table_rate" in
    deg/s, derived from the encoder's angle where no rate was recorded. A sensor that lags by :math:`\tau_s` (`lead_s`) is read
    ahead. The memory M is "static" (m = u), "lag" (:math:`\tau \dot m = u - m`), "rate" (du/dt per minute), "play" (backlash of the
    given radius: rate independent) or "plays" (the mean of play operators whose radii are distributed as exp(-r / radius): a
    Prandtl-Ishlinskii operator). `start` is their history before the run. With a `parity` the law is one of \|u\|, equal for both
    signs ("even") or of opposite sign ("odd"), as laws of a rate are. With x = (m - at) / h, z = (m - at) / width and h half the
    range of m where the law was found, the form f is

    =============  ==========================  ================================================
    power          x^exponent                  continued straight beyond the range
    above, below   max(0, x), max(0, -x)       a threshold, linear beyond
    step           1 where m > at, else 0      a threshold that switches; with play, a relay
    saturation     tanh z
    bump           exp(-z²/2)                  0 far from `at`
    resonance      1 / (1 + z²)                likewise
    dispersion     2 z / (1 + z²)              likewise
    periodic       cos(2 pi z)                 constant beyond the range
    =============  ==========================  ================================================

    A law is not known outside the range in which it was found, so no form grows there faster than linearly. Most effects are nearly
    linear over a little more range; a square or a cosine continued would be a guess.
    """

    name = "empirical_law"
    kind = "any"
    equation = "b = amplitude_deg_h * form(memory(driver)) * (driver_2 - at_2) / half range of driver_2"
    reference = (
        "S. L. Brunton, J. L. Proctor, J. N. Kutz, Discovering governing equations from data by sparse identification, PNAS 113, "
        "3932 (2016) (laws from a dictionary); A. Visintin, Differential Models of Hysteresis, Springer, 1994 (play)."
    )
    drivers = (TEMPERATURE,)
    empirical = True

    amplitude_deg_h: float = amplitude(0.005, "deg/h", limit=1e15)
    driver: str = setting(TEMPERATURE)
    less: str = setting("")
    driver_2: str = setting("")
    less_2: str = setting("")
    parity: str = setting("none", choices=PARITIES)
    memory: str = setting("static", choices=MEMORIES)
    start: str = setting("rested", choices=tuple(STARTS))
    form: str = setting("power", choices=FORMS)
    exponent: int = setting(1, low=1, high=5)
    low: float = setting(-40.0, "unit of m", low=-_LARGEST, high=_LARGEST)
    high: float = setting(60.0, "unit of m", low=-_LARGEST, high=_LARGEST)
    low_2: float = setting(0.0, "unit of driver_2", low=-_LARGEST, high=_LARGEST)
    high_2: float = setting(1.0, "unit of driver_2", low=-_LARGEST, high=_LARGEST)
    lag_s: float = shape(1800.0, "s", 1e-3, 1e6)
    radius: float = shape(1.0, "unit of driver", 0.0, _LARGEST)
    at: float = shape(10.0, "unit of m", -_LARGEST, _LARGEST)
    width: float = shape(10.0, "unit of m", 1.0 / _LARGEST, _LARGEST)
    lead_s: float = shape(0.0, "s", 0.0, 600.0)
    at_2: float = shape(0.5, "unit of driver_2", -_LARGEST, _LARGEST)

    def __post_init__(self) -> None:
        Mechanism.__post_init__(self)
        if not self.driver:
            raise InputError("empirical_law: driver is ''; give the name of a recorded column")
        if self.less_2 and not self.driver_2:
            raise InputError(f"empirical_law: less_2 is {self.less_2!r} and driver_2 is ''; give driver_2, which it is taken off")
        for low, high, names in ((self.low, self.high, "low and high"), (self.low_2, self.high_2, "low_2 and high_2")):
            if not low < high:
                raise InputError(f"empirical_law: {names} are {low:g} and {high:g}; the first must be less than the second")

    @classmethod
    def grid(cls, recordings: Any) -> tuple[EmpiricalLaw, ...]:
        """Empty: diagnosis finds laws by other terms."""
        del recordings
        return ()

    def driver_names(self) -> tuple[str, ...]:
        return tuple(name for pair in self._quantities() for name in pair if name)

    def _quantities(self) -> tuple[tuple[str, str], ...]:
        """The columns of each factor, a pair each: the second, where there is one, is subtracted from the first."""
        pairs = (self.driver, self.less), (self.driver_2, self.less_2)
        return pairs if self.driver_2 else pairs[:1]

    def _read_from(self, recording: Recording) -> list[str]:
        """The columns that it reads of a recording; the table's rate by its own name, whichever column gives it."""
        columns = zip(self.driver_names(), self.driver_columns(recording), strict=True)
        return [name if name == TABLE_RATE else column for name, column in columns]

    def basis(self, recording: Recording) -> Array:
        columns = iter(self._read_from(recording))
        first, *second = (reading(recording, *(next(columns) for name in pair if name)) for pair in self._quantities())
        sign = np.sign(first) if self.parity == "odd" else 1.0
        first = ahead(np.abs(first) if self.parity != "none" else first, recording.time_s, self.lead_s)
        swept = STARTS[self.start]
        column = self.shaped(remembered(first, recording.time_s, self.memory, self.lag_s, self.radius, swept))
        for other in second:
            column = column * self.factor(other)
        return np.asarray(sign * column)[:, None]

    def extrapolation(self, recording: Recording) -> tuple[Message, ...]:
        columns = iter(self._read_from(recording))
        quantities = [tuple(next(columns) for name in pair if name) for pair in self._quantities()]
        learnt = [] if self.memory == "rate" else [(quantities[0], self.low, self.high)]
        learnt += [(quantity, self.low_2, self.high_2) for quantity in quantities[1:]]
        remarks = []
        for quantity, low, high in learnt:
            values = reading(recording, *quantity)
            values = np.abs(values) if self.parity != "none" and quantity is quantities[0] else values
            if max(low - values.min(), values.max() - high) > _FURTHER * (high - low):
                unit = self._unit(self.driver if quantity is quantities[0] else self.driver_2)
                remarks.append(
                    message(
                        "simulation.law_extrapolated",
                        run=recording.name,
                        law=self.stated(),
                        quantity=named(*quantity),
                        unit=unit,
                        recorded=[values.min(), values.max()],
                        learnt=[low, high],
                    )
                )
        return tuple(remarks)

    def shaped(self, m: Array) -> Array:
        """The form of the memory, dimensionless."""
        return form_of(m, self.form, self.exponent, (self.low, self.high), self.at, self.width)

    def factor(self, second: Array) -> Array:
        """The factor of the second driver, dimensionless."""
        return np.asarray((second - self.at_2) / (0.5 * (self.high_2 - self.low_2)))

    def stated(self) -> str:
        """The equation with its numbers, drivers and units."""
        unit = self.unit_of("at")
        half = 0.5 * (self.high - self.low)
        signed, *second = (named(*(name for name in pair if name)) for pair in self._quantities())
        first = f"|{signed}|" if self.parity != "none" else signed
        u = f"ahead({first}, {self.lead_s:.3g} s)" if self.lead_s else first
        began = "" if self.start == "rested" else f", {self.start.replace('_', ' ')}"
        m = {
            "static": u,
            "lag": f"lag({u}, {self.lag_s:.4g} s)",
            "rate": f"d/dt {u}",
            "play": f"play({u}, {_with(self.radius, unit)}{began})",
            "plays": f"mean play({u}, r ~ exp(-r / {_with(self.radius, unit)}){began})",
        }[self.memory]
        at = self.at if abs(self.at) > _ROUNDING * half else 0.0
        from_at = f"{m} {'-' if at >= 0.0 else '+'} {_with(abs(at), unit)}"
        x, z = f"({from_at}) / {_with(half, unit)}", f"({from_at}) / {_with(self.width, unit)}"
        text = {
            "power": x if self.exponent == 1 else f"({x})^{self.exponent}",
            "above": f"max(0, {x})",
            "below": f"max(0, -{x})",
            "step": f"({m} > {_with(self.at, unit)})",
            "saturation": f"tanh({z})",
            "bump": f"exp(-({z})^2 / 2)",
            "resonance": f"1 / (1 + ({z})^2)",
            "dispersion": f"2 z / (1 + z^2) with z = {z}",
            "periodic": f"cos(2 pi {z})",
        }[self.form]
        if self.parity == "odd":
            text = f"sgn({signed}) * {text}"
        for quantity in second:
            other = self._unit(self.driver_2)
            text += f" * ({quantity} - {_with(self.at_2, other)}) / {_with(0.5 * (self.high_2 - self.low_2), other)}"
        return f"b = {self.amplitude_deg_h:.4g} deg/h * {text}"

    def unit_of(self, parameter: str) -> str:
        """Unit of one of its parameters, derived from the columns that it reads.

        >>> EmpiricalLaw(driver="pressure_hPa").unit_of("at"), EmpiricalLaw().unit_of("lag_s")
        ('hPa', 's')
        """
        unit = next(one.unit for one in self.parameters() if one.name == parameter)
        of_driver = self._unit(self.driver)
        return {
            "unit of driver": of_driver,
            "unit of m": f"{of_driver}/min" if self.memory == "rate" else of_driver,
            "unit of driver_2": self._unit(self.driver_2),
        }.get(unit, unit)

    @staticmethod
    def _unit(driver: str) -> str:
        return _UNITS.get(driver) or column_unit(driver) or ""


def named(column: str, less: str = "") -> str:
    """Name of a quantity: a column, or the difference of two.

    >>> named("readout_a_V", "readout_b_V")
    '(readout_a_V - readout_b_V)'
    """
    return f"({column} - {less})" if less else column


def reading(recording: Recording, column: str, less: str = "") -> Array:
    """A quantity: a column, or the difference of two, smoothed against read noise.

    Parameters
    ----------
    recording : Recording
    column : str
    less : str
        Column to subtract; empty for none.
    """
    values = smoothed(recording, column)
    return values - smoothed(recording, less) if less else values


def smoothed(recording: Recording, column: str) -> Array:
    """A driver smoothed against read noise by a mean over 20 s; an angle, which wraps, and a rate, which steps, unchanged."""
    if column == TABLE_RATE:
        return rate_deg_s(recording)
    values = recording.column(column)
    return values if column_unit(column) in _AS_THEY_ARE else running_mean(values, recording.time_s, SMOOTHING_S)


def remembered(values: Array, time_s: Array, memory: str, lag_s: float, radius: float, swept: float = 0.0) -> Array:
    """State of a memory of a driver, in the driver's unit, per minute for "rate".

    Parameters
    ----------
    values, time_s : ndarray, shape (n,)
        Driver, and times in s.
    memory : str
        One of `MEMORIES`.
    lag_s : float
        Time constant of "lag".
    radius : float
        Of "play" and "plays", in the driver's unit.
    swept : float
        History before the first value, as for :class:`rlgcomp.numerics.hysteresis.Play`.
    """
    if memory == "lag":
        return lag(values, time_s, lag_s)
    if memory == "rate":
        return rate_per_min(values, time_s)
    if memory in RATE_INDEPENDENT:
        return played(values[:, None], memory, np.array([radius]), np.array([swept]))[:, 0]
    return values


def played(values: Array, memory: str, radii: Array, swept: Array) -> Array:
    """States of "play" or "plays" for several drivers at once, each with its radius and history.

    Parameters
    ----------
    values : ndarray, shape (n, k)
    memory : {"play", "plays"}
    radii, swept : ndarray, shape (k,)

    Returns
    -------
    ndarray, shape (n, k)
    """
    shares = _SHARES if memory == "plays" else np.ones(1)
    inputs, spread = np.repeat(values, len(shares), axis=1), np.multiply.outer(radii, shares).ravel()
    states = play_paths(inputs, spread, inputs[0] - np.repeat(swept, len(shares)) * spread)
    return np.asarray(states.reshape(*values.shape, len(shares)).mean(axis=2))


def form_of(m: Array, form: str, exponent: int, span: tuple[float, float], at: float | Array, width: float | Array) -> Array:
    """A form of a memory; `at` and `width` may be arrays that broadcast against it.

    Parameters
    ----------
    m : ndarray
    form : str
        One of `FORMS`.
    exponent : int
        Of "power".
    span : tuple of float
        Range of m where the law was found.
    at, width : float or ndarray
        In the unit of m.
    """
    low, high = span
    z = (m - at) / (width if form in NARROW else 0.5 * (high - low))
    match form:
        case "above":
            return np.maximum(z, 0.0)
        case "below":
            return np.maximum(-z, 0.0)
        case "step":
            return np.asarray(z > 0.0, dtype=np.float64)
        case "saturation":
            return np.tanh(z)
        case "bump":
            return np.exp(-0.5 * np.minimum(z**2, 1400.0))
        case "resonance":
            return np.asarray(1.0 / (1.0 + z**2))
        case "dispersion":
            return np.asarray(2.0 * z / (1.0 + z**2))
        case "periodic":
            return np.cos(2.0 * math.pi * (np.clip(m, low, high) - at) / width)
    if exponent == 1:
        return np.asarray(z)
    clipped = np.clip(m, low, high)
    excess = (m - clipped) / (0.5 * (high - low))
    inside = z - excess
    return np.asarray(inside**exponent + exponent * inside ** (exponent - 1) * excess)


def _with(value: float, unit: str) -> str:
    return f"{value:.5g} {unit}".rstrip()
