"""What a gyro shows beyond what its simulator says for certain, and whether that can be physics at all."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Final

import numpy as np
import numpy.typing as npt

from rlgcomp.diagnosis.windows import Windows
from rlgcomp.errors import InputError
from rlgcomp.motion import ANGLES, RATE
from rlgcomp.recording import Recording
from rlgcomp.simulation.simulator import Simulator
from rlgcomp.units import column_unit

Array = npt.NDArray[np.float64]
_FARTHEST_SCALE: Final = 0.5  # that a gyro's scale factor can be off
_TURNS_DEG_H: Final = 100.0  # standard deviation: less may be noise, of the gyro or of an encoder
_LARGEST_DEPARTURE_DEG_H: Final = 1e7  # no gyro measures so high a rate


def departures_deg_h(
    simulator: Simulator, windows: Sequence[Windows], gyro: str | None, predicted: Callable[[Recording], Array] | None
) -> tuple[Array, ...]:
    """Of each run at its full rate: the gyro less the simulator's fixed part."""
    departures = tuple(_unexplained(simulator, part.full, gyro, predicted) for part in windows)
    for part, values in zip(windows, departures, strict=True):
        _require_sane(part.full, values)
    return departures


def _unexplained(simulator: Simulator, run: Recording, gyro: str | None, predicted: Callable[[Recording], Array] | None) -> Array:
    expected = simulator.nominal_deg_h(run, gyro) if predicted is None else predicted(run)
    if predicted is None and simulator.kind == "turntable":
        _require_following(run, run.gyro_column(gyro), run.rate_deg_h(gyro), expected)
    rate = run.rate_deg_h(gyro) - expected
    for mechanism in simulator.mechanisms:
        parameters = mechanism.amplitude_parameters()
        free = simulator.free.get(mechanism.name, frozenset())
        known = [(k, p.name) for k, p in enumerate(parameters) if p.name not in free]
        if known:
            basis = mechanism.basis(run)
            rate = rate - sum(getattr(mechanism, name) * basis[:, k] for k, name in known)
    return np.asarray(rate)


def _require_following(run: Recording, channel: str, rate_deg_h: Array, table_deg_h: Array) -> None:
    """Refuse a gyro that does not turn with its table: no scale factor is so far off, but a unit or a sense may be."""
    turning = table_deg_h - table_deg_h.mean()
    if not min(np.std(rate_deg_h), np.std(turning)) > _TURNS_DEG_H:
        return
    slope = float(turning @ rate_deg_h / (turning @ turning))
    if abs(slope - 1.0) <= _FARTHEST_SCALE:
        return
    motion = next(name for name in (RATE, *ANGLES) if name in run)
    radians = "rad/s" if motion == RATE else "rad"
    if channel.endswith("_pulses"):
        likely = f"pulse_arcsec is not {run.metadata.pulse_arcsec:g}"
    elif abs(slope + 1.0) <= _FARTHEST_SCALE:
        likely = f"its sense is reversed: say --map {channel}='{channel} [-{column_unit(channel)}]'"
    else:
        likely = f"{motion} is in {radians}: say --map {motion}='{motion} [{radians}]'"
    raise InputError(
        f"{run.name}: {channel} reads {slope:.4g} times the rate of its table ({motion}), beyond any scale factor's error; "
        f"perhaps {likely}"
    )


def _require_sane(run: Recording, departure_deg_h: Array) -> None:
    row = int(np.argmax(np.abs(departure_deg_h)))
    if not abs(departure_deg_h[row]) <= _LARGEST_DEPARTURE_DEG_H:
        raise InputError(
            f"{run.name}: at row {row} the gyro is {departure_deg_h[row]:.3g} deg/h off what the simulator says; up to "
            f"{_LARGEST_DEPARTURE_DEG_H:.0e} deg/h is taken for physics: mend the unit (--map) or take out the wild samples"
        )
