r"""A gyro on a rate table in another implementation than rlgcomp's, and the effects that turning brings out.

Everything is computed at twenty instants a sample and then averaged over the sample, as a counter of pulses does. Lock-in is not
the mean over a beat: the phase between the beams is followed through Adler's equation
:math:`\dot\psi = 2\pi S (W - W_L \sin\psi)`. With :math:`\tan(\psi/2) = u/v` it is linear while the rate W stands still,

.. math:: \frac{d}{dt} \begin{pmatrix} u \\ v \end{pmatrix} = M \begin{pmatrix} u \\ v \end{pmatrix}, \qquad
    M = \pi S \begin{pmatrix} -W_L & W \\ -W & W_L \end{pmatrix}, \qquad M^2 = (\pi S)^2 (W_L^2 - W^2),

so that a step is :math:`\exp(Mt) = \cosh\lambda t + M \sinh(\lambda t) / \lambda` with :math:`\lambda^2 = M^2`; whole beats are
counted.

References
----------
R. Adler, "A study of locking phenomena in oscillators", Proc. IRE 34, 351 (1946).
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping

import numpy as np
import numpy.typing as npt
import pandas as pd
from scipy import optimize

from experiments.concealed import functions
from rlgcomp.recording import Metadata, Recording

Array = npt.NDArray[np.float64]
INSTANTS = 20  # a sample
SAMPLE_S = 1.0
PULSES_PER_DEG = 3600.0 / 0.8427
ACCELERATION_DEG_S2 = 15.0
ARCSEC = 3600.0  # of a degree; deg/h of one deg/s


@dataclasses.dataclass(frozen=True)
class Turn:
    """How the table turns in one run: rate and temperature at the instants, shape (samples, instants), and the first angle."""

    rate_deg_s: Array
    temperature_degC: Array
    start_deg: float

    @property
    def edges_deg(self) -> Array:
        """Angle turned where each instant begins, and at the end."""
        return np.r_[self.start_deg, self.start_deg + SAMPLE_S / INSTANTS * np.cumsum(self.rate_deg_s)]

    @property
    def angle_deg(self) -> Array:
        """Angle in the middle of each instant, shape (samples, instants)."""
        edges = self.edges_deg
        return np.asarray(0.5 * (edges[1:] + edges[:-1]).reshape(self.rate_deg_s.shape))

    @classmethod
    def draw(cls, rng: np.random.Generator) -> Turn:
        """Rates each way in random order for ten minutes, two sweeps through zero, a rest: about two and a half hours."""
        rates = rng.permutation(np.exp(rng.uniform(np.log([0.5, 2.0, 6.0, 20.0, 45.0]), np.log([2.0, 6.0, 20.0, 45.0, 70.0]))))
        targets: list[tuple[float, float, float]] = [(0.0, 0.0, 300.0)]
        for rate in rates.tolist():
            sign = float(rng.choice([-1.0, 1.0]))
            targets += [(sign * rate, sign * rate, 600.0), (-sign * rate, -sign * rate, 600.0)]
        for span in rng.uniform([1.0, 20.0], [4.0, 60.0]).tolist():
            targets.insert(int(rng.integers(1, len(targets) + 1)), (-span, span, 1200.0))
        step_s = SAMPLE_S / INSTANTS
        pieces, now = [], 0.0
        for first, last, seconds in targets:
            pieces.append(np.linspace(now, first, max(1, round(abs(first - now) / ACCELERATION_DEG_S2 / step_s)), endpoint=False))
            pieces.append(np.linspace(first, last, round(seconds / step_s)))
            now = last
        rate = np.concatenate(pieces)
        rate = rate[: len(rate) // INSTANTS * INSTANTS]
        time_s = step_s * (np.arange(len(rate)) + 0.5)
        swing = np.sin(2.0 * np.pi * time_s / rng.uniform(3000.0, 6000.0) + rng.uniform(0.0, 2.0 * np.pi))
        temperature = rng.uniform(20.0, 26.0) + 4.0 * -np.expm1(-time_s / rng.uniform(1500.0, 3500.0)) + swing
        return cls(rate.reshape(-1, INSTANTS), temperature.reshape(-1, INSTANTS), rng.uniform(0.0, 360.0))

    def recording(
        self,
        gyro_deg_h: Array,
        rng: np.random.Generator,
        *,
        name: str,
        delay_s: float = 0.0,
        encoder_arcsec: float = 0.0,
        time: float = 1.0,
    ) -> Recording:
        """What is recorded at the end of each sample.

        Parameters
        ----------
        gyro_deg_h : ndarray, shape (samples,)
        rng : Generator
        name : str
        delay_s : float
            Age of the encoder's angle.
        encoder_arcsec : float
            Standard deviation of one reading.
        time : float
            How much longer all times are, and slower all rates.
        """
        ends_s = SAMPLE_S * np.arange(len(self.rate_deg_s) + 1)
        edges_s = SAMPLE_S / INSTANTS * np.arange(self.rate_deg_s.size + 1)
        before = self.rate_deg_s[0, 0] * np.minimum(ends_s - delay_s, 0.0)
        seen = np.interp(ends_s - delay_s, edges_s, self.edges_deg) + before
        temperature = self.temperature_degC.mean(axis=1) + 0.002 * rng.standard_normal(len(gyro_deg_h))
        seen += encoder_arcsec / ARCSEC * rng.standard_normal(len(seen))
        columns = {
            "time_s": time * ends_s[1:],
            "gyro_deg_h": gyro_deg_h / time,
            "table_angle_deg": np.mod(seen[1:], 360.0),
            "table_rate_deg_s": np.diff(seen) / (time * SAMPLE_S),
            "temperature_block_degC": temperature,
        }
        return Recording(pd.DataFrame(columns), Metadata(kind="turntable"), name=name)


@dataclasses.dataclass(frozen=True)
class TableEffect:
    """One effect.

    Parameters
    ----------
    name : str
        In the catalogue.
    form : str
        What was drawn.
    error : callable
        Error in deg/h of each sample, from the turn and the size.
    linear : bool
        Whether the error is the size times that of size one.
    delays : bool
        Whether the size is a delay of the encoder, which the recording shows and the gyro does not.
    """

    name: str
    form: str
    error: Callable[[Turn, float], Array]
    linear: bool = True
    delays: bool = False


def _mean(values: Array) -> Array:
    return np.asarray(ARCSEC * values.mean(axis=1))


def _of_angle(order: int, phase: float, *, with_rate: bool) -> Callable[[Turn, float], Array]:
    def error(turn: Turn, size: float) -> Array:
        wave = np.cos(order * np.radians(turn.angle_deg) - phase)
        return size * _mean(wave * turn.rate_deg_s if with_rate else wave)

    return error


def locked(turn: Turn, lock_in_deg_s: float) -> Array:
    """What lock-in makes of the rate, less the rate, in deg/h of each sample."""
    step_s = SAMPLE_S / INSTANTS
    b = math.pi * PULSES_PER_DEG * lock_in_deg_s
    u, v = 0.0, 1.0
    turned = []
    for a in (math.pi * PULSES_PER_DEG * turn.rate_deg_s.ravel()).tolist():
        square = a * a - b * b
        beats = 0.0
        if square > 0.0:  # the phase runs
            w = math.sqrt(square)
            beats = math.floor(w * step_s / math.pi)
            rest_s = step_s - beats * math.pi / w
            c, s = math.cos(w * rest_s), math.sin(w * rest_s) / w
        else:  # it stands, or creeps to where it will
            w = math.sqrt(-square)
            fade = math.exp(-2.0 * w * step_s)  # cosh and sinh over their exponential, which the direction does not need
            c, s = 0.5 * (1.0 + fade), 0.5 * (1.0 - fade) / w if w > 0.0 else step_s
        u_next, v_next = (c - b * s) * u + a * s * v, -a * s * u + (c + b * s) * v
        turned.append(2.0 * (math.copysign(beats * math.pi, a) + math.atan2(v * u_next - u * v_next, v * v_next + u * u_next)))
        length = math.hypot(u_next, v_next)
        u, v = u_next / length, v_next / length
    out = np.array(turned).reshape(turn.rate_deg_s.shape).sum(axis=1) / (2.0 * math.pi * PULSES_PER_DEG * SAMPLE_S)
    return np.asarray(ARCSEC * (out - turn.rate_deg_s.mean(axis=1)))


def _temperature(rng: np.random.Generator) -> TableEffect:
    function = functions.linear(rng) if rng.random() < 0.4 else functions.monotone(rng)
    return TableEffect(
        "scale_factor_temperature",
        function.form,
        lambda t, size: (
            size * _mean(t.rate_deg_s * function((t.temperature_degC.ravel() - 25.0) / 2.0).reshape(t.rate_deg_s.shape))
        ),
    )


def _asymmetry(rng: np.random.Generator) -> TableEffect:
    power = 1.0 if rng.random() < 0.4 else rng.uniform(0.8, 1.25)
    form = "one slope each way" if power == 1.0 else "even power"
    return TableEffect("scale_factor_asymmetry", form, lambda t, size: size * _mean(np.abs(t.rate_deg_s) ** power))


def _nonlinearity(rng: np.random.Generator) -> TableEffect:
    power = rng.uniform(1.5, 3.5)
    return TableEffect(
        "scale_factor_nonlinearity",
        "odd power",
        lambda t, size: size * _mean(np.sign(t.rate_deg_s) * np.abs(t.rate_deg_s) ** power),
    )


def _lock_in(_: np.random.Generator) -> TableEffect:
    return TableEffect("lock_in", "Adler's equation", locked, linear=False)


def _wobble(rng: np.random.Generator) -> TableEffect:
    return TableEffect("misalignment", "once a turn, with the rate", _of_angle(1, rng.uniform(0.0, 2.0 * np.pi), with_rate=True))


def _leak(rng: np.random.Generator) -> TableEffect:
    return TableEffect("earth_rate_leak", "once a turn", _of_angle(1, rng.uniform(0.0, 2.0 * np.pi), with_rate=False))


def _harmonics(rng: np.random.Generator) -> TableEffect:
    """One to three orders, all with the rate or none."""
    with_rate, count = bool(rng.random() < 0.5), int(rng.integers(1, 4))
    waves = [
        _of_angle(int(order), rng.uniform(0.0, 2.0 * np.pi), with_rate=with_rate)
        for order in rng.choice(np.arange(2, 9), count, replace=False)
    ]
    heights = np.r_[1.0, rng.uniform(0.4, 1.0, count - 1)].tolist()
    return TableEffect(
        "rotation_harmonics",
        f"{count} order{'s' * (count > 1)}",
        lambda t, size: np.asarray(sum(height * wave(t, size) for height, wave in zip(heights, waves, strict=True))),
    )


def _late(turn: Turn, delay_s: float) -> Array:
    """What the gyro shows beyond the rate of an encoder that is late."""
    still, rng = np.zeros(len(turn.rate_deg_s)), np.random.default_rng(0)
    prompt, late = (turn.recording(still, rng, name="", delay_s=delay).column("table_rate_deg_s") for delay in (0.0, delay_s))
    return np.asarray(ARCSEC * (prompt - late))


def _delay(_: np.random.Generator) -> TableEffect:
    return TableEffect("encoder_delay", "constant", _late, delays=True)


EFFECTS: Mapping[str, Callable[[np.random.Generator], TableEffect]] = {
    "scale_factor_temperature": _temperature,
    "scale_factor_asymmetry": _asymmetry,
    "scale_factor_nonlinearity": _nonlinearity,
    "lock_in": _lock_in,
    "encoder_delay": _delay,
    "misalignment": _wobble,
    "earth_rate_leak": _leak,
    "rotation_harmonics": _harmonics,
}


def sized(effect: TableEffect, turns: list[Turn], strength: float, white_1_s_deg_h: float) -> float:
    """The size at which the part that a scale factor and a bias do not take has as much power as `strength` asks for.

    What repeats with the angle averages out over 100 s and is seen within them, so strength counts samples here: sum of squares
    over the noise's variance is that of an effect of this strength in means over 100 s.
    """
    rate = np.concatenate([turn.rate_deg_s.mean(axis=1) for turn in turns])
    design = np.column_stack([rate, np.ones(len(rate))])

    def strength_of(size: float) -> float:
        values = np.concatenate([effect.error(turn, size) for turn in turns])
        remainder = values - design @ np.linalg.lstsq(design, values, rcond=None)[0]
        return float(np.sqrt(np.mean(remainder**2)) / white_1_s_deg_h * 10.0)

    if effect.linear:
        unit = 1e-3 if effect.delays else 1.0
        return strength / strength_of(unit) * unit
    return math.exp(optimize.brentq(lambda x: math.log(strength_of(math.exp(x)) / strength), math.log(1e-5), 0.0, xtol=0.02))
