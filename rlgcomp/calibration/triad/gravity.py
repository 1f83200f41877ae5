"""Whether a triad's accelerometers show up where the encoders put it, and if not, what was mistaken for what.

At rest but for rotation a triad feels gravity alone, so that the accelerometers are to the encoders' angles what the gyros are to
their rates. A zero of the outer encoder that is off, or an accelerometer with the wrong sign, would else pass for a triad that
stands turned by as much, or for vibration.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from typing import Final

import numpy as np
import numpy.typing as npt

from rlgcomp import units
from rlgcomp.errors import InputError
from rlgcomp.numerics import frames

Array = npt.NDArray[np.float64]
Readings = tuple[Array, Array, Array]
"""What the accelerometers felt of up in the body, outer and inner angle in deg."""
_AXES: Final = "xyz"
WORST_AGREEMENT: Final = 0.02
_WINDOW_S: Final = 0.5


def require_gravity(name: str, pushed_m_s: Array, outer_deg: Array, inner_deg: Array, step_s: float) -> None:
    """Raise unless accelerometers and encoders agree within 2 % and the turn in a sample: no encoder's instant is known better.

    Raises
    ------
    InputError
        They do not; the message says with what change they would.
    """
    mean_m_s = float(np.mean(np.linalg.norm(pushed_m_s, axis=1)))
    if not mean_m_s > 0.0:
        return
    felt = pushed_m_s[1:] / mean_m_s
    outer, inner = (0.5 * (angle[1:] + angle[:-1]) for angle in (outer_deg, inner_deg))
    every = max(1, round(_WINDOW_S / step_s))
    steps = np.diff(np.stack([outer_deg, inner_deg]), axis=1) * units.RAD_PER_DEG
    allowed = WORST_AGREEMENT + float(np.sqrt(np.mean(np.sum(steps**2, axis=0))))
    misfit = _misfit(felt, outer, inner, every)
    if misfit <= allowed:
        return
    kinds = (_other_axes(felt, outer, inner), _other_encoders(felt, outer, inner))
    agreeing = [next((words for words, readings in kind if _misfit(*readings, every) <= allowed), None) for kind in kinds]
    said = " or with ".join(words for words in agreeing if words is not None)
    would = f"they agree with {said}" if said else "no order, sign or zero makes them agree"
    raise InputError(
        f"{name}: the accelerometers disagree with the encoders by {100 * misfit:.3g} % of gravity, and {100 * allowed:.2g} % is "
        f"allowed; {would}; check the order and signs of accel_x, accel_y and accel_z, and that the outer encoder is zero with the "
        "inner axis upright"
    )


def _misfit(felt: Array, outer_deg: Array, inner_deg: Array, every: int) -> float:
    """Rms, over windows, of what is felt less up as the encoders have it."""
    left = felt - _up(outer_deg, inner_deg)
    windows = len(left) // every
    means = left[: windows * every].reshape(windows, every, 3).mean(axis=1)
    return float(np.sqrt(np.mean(np.sum(means**2, axis=1))))


def _up(outer_deg: Array, inner_deg: Array) -> Array:
    """Up in the body, shape (n, 3)."""
    return np.asarray(frames.table_attitude(outer_deg, inner_deg)[:, 2, :])


def _other_axes(felt: Array, outer: Array, inner: Array) -> Iterator[tuple[str, Readings]]:
    """Accelerometers taken in another order and with other signs, the fewest changes first: in words, and what is then read."""
    taken = itertools.product(itertools.permutations(range(3)), itertools.product((1.0, -1.0), repeat=3))
    changes = {
        (order, signs): [
            f"{axis} = {'-' if sign < 0.0 else ''}accel_{_AXES[k]}"
            for axis, k, sign in zip(_AXES, order, signs, strict=True)
            if _AXES[k] != axis or sign < 0.0
        ]
        for order, signs in taken
    }
    for (order, signs), changed in sorted(changes.items(), key=lambda item: len(item[1])):
        yield ", ".join(changed), (felt[:, order] * np.array(signs), outer, inner)


def _other_encoders(felt: Array, outer: Array, inner: Array) -> Iterator[tuple[str, Readings]]:
    """Encoders taken with another sign or zero."""
    yield "the other sign of angle_outer_deg", (felt, -outer, inner)
    outer_rad, inner_rad = outer * units.RAD_PER_DEG, inner * units.RAD_PER_DEG
    level = (1j * felt[:, 1] - felt[:, 0]) * np.exp(-1j * inner_rad)  # sin(outer), were both right; a wrong inner zero turns it
    off_deg = float(np.angle(np.sum((felt[:, 2] + 1j * level.real) * np.exp(-1j * outer_rad)))) / units.RAD_PER_DEG
    yield f"{off_deg:.4g} deg added to angle_outer_deg", (felt, outer + off_deg, inner)
    off_deg = float(np.angle(np.sum(level * np.sin(outer_rad)))) / units.RAD_PER_DEG
    yield f"{off_deg:.4g} deg added to angle_inner_deg", (felt, outer, inner + off_deg)
