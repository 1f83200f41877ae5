"""A simulator as text for a terminal or a notebook."""

from __future__ import annotations

import textwrap
from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from rlgcomp.noise.processes import NoiseModel
    from rlgcomp.physics.mechanism import Mechanism, Parameter
    from rlgcomp.simulation.simulator import Simulator


_WIDTH: Final = 110


def as_text(simulator: Simulator) -> str:
    """One line a mechanism with its parameters, and the noise."""
    count = len(simulator.mechanisms)
    head = f"Simulator of a {simulator.kind} gyro {simulator.unit!r}: {count} mechanism{'' if count == 1 else 's'}"
    free = simulator.free
    lines = [_of_mechanism(mechanism, free.get(mechanism.name, frozenset())) for mechanism in simulator.mechanisms]
    return "\n  ".join([head, *lines, f"noise: {_of_noise(simulator.noise)}"])


def _of_mechanism(mechanism: Mechanism, free: frozenset[str]) -> str:
    idle = mechanism.idle_parameters()
    said = [_of_parameter(mechanism, p, p.name in free) for p in mechanism.parameters() if p not in idle]
    return textwrap.fill(f"{mechanism.name}{': ' if said else ''}{', '.join(said)}", _WIDTH, subsequent_indent=" " * 6)


def _of_parameter(mechanism: Mechanism, parameter: Parameter, free: bool) -> str:
    unit = f" {parameter.unit}" if parameter.unit else ""
    return f"{parameter.name} = {_short(getattr(mechanism, parameter.name))}{unit}{' (free)' if free else ''}"


def _of_noise(noise: NoiseModel | None) -> str:
    if noise is None:
        return "to be estimated"
    idle = "" if noise.dither_residual_arcsec else "dither_residual_frequency_hz"
    said = [f"{name} = {_short(value)}" for name, value in noise.to_mapping().items() if value and name != idle]
    return textwrap.fill(", ".join(said) or "none", _WIDTH, subsequent_indent=" " * 6)


def _short(value: Any) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)
