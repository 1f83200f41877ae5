"""Errors that repeat several times a turn: the encoder's graduation, the table's bearing and motor, fields in the room."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Final, Self

import numpy as np

from rlgcomp.physics.mechanism import TABLE_ANGLE, TABLE_RATE, Array, Mechanism, Parameter, amplitude, setting
from rlgcomp.recording import Recording
from rlgcomp.recording.motion import (
    TAKEN,
    harmonic,
    identifiable_by_values,
    rate_deg_s,
    reference_angle_deg,
    sampling_candidates,
)
from rlgcomp.recording.time_stamp_convention import reference_rate_deg_s
from rlgcomp.units import DEG_PER_TURN, SECONDS_PER_HOUR

LOWER: Final = 12  # orders tried one by one; higher ones only where the spectrum shows them
HIGHEST: Final = 80
MOST: Final = 4  # orders at once
_BINS: Final = 2048  # of a turn
_STEADY: Final = 0.01  # of the highest rate: above, the table turns
_SLOWEST_SHARE: Final = 0.2  # of the turning rows in which an order must be sampled twice a cycle
_PLAIN: Final = 40.0  # power over that of noise from which an order is significant


@dataclasses.dataclass(frozen=True)
class RotationHarmonics(Mechanism):
    r"""Up to four orders of the table's angle, equally large at every rate or growing with it.

    .. math:: b = s(W) \sum_j a_j \cos k_j\theta + c_j \sin k_j\theta, \qquad s = 1 \text{ or } W / W_r

    With "rate", amplitudes hold at the reference rate W_r: the cyclic error :math:`\sum A_k \sin k\theta` of an encoder makes the
    rate err by :math:`k A_k W \cos k\theta`. An order of zero is not in use. Order 1 is `earth_rate_leak` or `misalignment`.
    """

    name = "rotation_harmonics"
    kind = "turntable"
    equation = "b = sum_j (cosine_j_deg_h * cos(order_j theta) + sine_j_deg_h * sin(order_j theta)) [* W / reference_deg_s]"
    reference = "Z. Liu et al., Sensors 19, 4754 (2019), eqs. 16 and 17 (ten orders from 2 to 78 of a rate table's angle)."
    drivers = (TABLE_RATE, TABLE_ANGLE)
    stage = "readout"
    fast = True

    order_1: int = setting(2, low=2, high=720)
    order_2: int = setting(0, low=0, high=720)
    order_3: int = setting(0, low=0, high=720)
    order_4: int = setting(0, low=0, high=720)
    scaling: str = setting("constant", choices=("constant", "rate"))
    reference_deg_s: float = setting(30.0, "deg/s", low=1e-3, high=1e5)
    taken: str = setting("before", choices=TAKEN)
    cosine_1_deg_h: float = amplitude(0.005, "deg/h")
    sine_1_deg_h: float = amplitude(0.005, "deg/h")
    cosine_2_deg_h: float = amplitude(0.005, "deg/h")
    sine_2_deg_h: float = amplitude(0.005, "deg/h")
    cosine_3_deg_h: float = amplitude(0.005, "deg/h")
    sine_3_deg_h: float = amplitude(0.005, "deg/h")
    cosine_4_deg_h: float = amplitude(0.005, "deg/h")
    sine_4_deg_h: float = amplitude(0.005, "deg/h")

    @property
    def orders(self) -> tuple[int, ...]:
        """The orders in use."""
        return tuple(int(order) for order in (self.order_1, self.order_2, self.order_3, self.order_4) if order)

    def amplitude_parameters(self) -> tuple[Parameter, ...]:
        used = {j for j in range(1, MOST + 1) if getattr(self, f"order_{j}")}
        return tuple(parameter for parameter in super().amplitude_parameters() if int(parameter.name.split("_")[1]) in used)

    def stated(self) -> str:
        """The equation with the orders in use."""
        used = {name: name.split("_") for name in (parameter.name for parameter in self.amplitude_parameters())}
        terms = [
            f"{name} * {'cos' if kind == 'cosine' else 'sin'}({getattr(self, f'order_{j}')} theta)"
            for name, (kind, j, *_) in used.items()
        ]
        total = " + ".join(terms)
        return f"b = {total}" if self.scaling == "constant" else f"b = ({total}) * W / reference_deg_s"

    @classmethod
    def grid(cls, recordings: Sequence[Recording]) -> tuple[Self, ...]:
        """The lower orders that the sampling resolves, one by one; of the higher ones the significant, alone and together."""
        highest = highest_order(recordings)
        points = []
        for scaling in ("constant", "rate"):
            for order in range(2, min(highest, LOWER) + 1):
                points += [cls(order_1=order, scaling=scaling, taken=taken) for taken in _ways(recordings, order)]
            for taken in _ways(recordings, highest):
                alone = [cls(order_1=order, scaling=scaling, taken=taken) for order in range(2, highest + 1)]
                plain = _plain_orders(recordings, alone)
                points += [cls(order_1=order, scaling=scaling, taken=taken) for order in plain if order > LOWER]
                if len(plain) > 1:
                    points.append(cls(**{f"order_{j}": k for j, k in enumerate(plain, 1)}, scaling=scaling, taken=taken))
        return tuple(points)

    def basis(self, recording: Recording) -> Array:
        columns = [column for order in self.orders for column in harmonic(recording, order, self.taken)]
        table = np.column_stack(columns)
        return table if self.scaling == "constant" else table * (rate_deg_s(recording) / self.reference_deg_s)[:, None]


def _ways(recordings: Sequence[Recording], order: int) -> tuple[str, ...]:
    """Conventions for the angle within a sample, as far as the recordings separate them at this order."""
    return sampling_candidates(recordings, order) if identifiable_by_values(recordings, order) else TAKEN[:1]


def highest_order(recordings: Sequence[Recording]) -> int:
    """The highest order that is sampled twice a cycle in a fifth of the rows in which the table turns."""
    steps = [np.abs(rate_deg_s(run)) * run.period_s for run in recordings]
    top = max(float(step.max()) for step in steps)
    turning = np.concatenate([step[step > _STEADY * top] for step in steps])
    slow = float(np.quantile(turning, _SLOWEST_SHARE)) if len(turning) else 180.0
    return int(min(max(180.0 / slow, 2.0), HIGHEST))


def _plain_orders(recordings: Sequence[Recording], points: Sequence[RotationHarmonics]) -> list[int]:
    """Significant orders of the gyros' residuals after a scale factor and a bias; each is subtracted before the next is sought.

    Parameters
    ----------
    recordings : sequence of Recording
    points : sequence of RotationHarmonics
        One order each, equal otherwise.
    """
    residuals, angles, weights = [], [], []
    for run in recordings:
        if len(run.gyro_columns) != 1 or (run.gyro_columns[0].endswith("_pulses") and run.metadata.pulse_arcsec is None):
            return []
        gyro = run.rate_deg_h()
        rate = reference_rate_deg_s(run, gyro)
        residuals.append(_freed(gyro - SECONDS_PER_HOUR * rate, np.column_stack([np.ones(len(rate)), rate])))
        angles.append(reference_angle_deg(run, points[0].taken))
        weights.append(rate / points[0].reference_deg_s if points[0].scaling == "rate" else np.ones(len(rate)))
    place = np.floor(np.concatenate(angles) * (_BINS / DEG_PER_TURN)).astype(np.int64) % _BINS
    weight = np.concatenate(weights)
    orders = np.array([point.order_1 for point in points])
    significant: list[int] = []
    while len(significant) < MOST:
        values = np.concatenate(residuals)
        spectrum = np.fft.rfft(np.bincount(place, weight * values, _BINS))[orders]
        power = 2.0 * np.abs(spectrum) ** 2 / max(float(weight @ weight) * float(np.var(values)), 1e-300)
        power[np.isin(orders, significant)] = 0.0
        strongest = int(np.argmax(power))
        if power[strongest] < _PLAIN:
            break
        significant.append(int(orders[strongest]))
        residuals = [_freed(part, points[strongest].basis(run)) for part, run in zip(residuals, recordings, strict=True)]
    return significant


def _freed(values: Array, design: Array) -> Array:
    return np.asarray(values - design @ np.linalg.lstsq(design, values, rcond=None)[0])
