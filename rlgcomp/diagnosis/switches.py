"""Switches of a member that is a sum of relays, such as a ladder of mode hops: where each goes up and down, and its step."""

from __future__ import annotations

import dataclasses
import math
from typing import Any, Final

from rlgcomp.diagnosis.fit import Estimate, Fit
from rlgcomp.diagnosis.memories import Relays
from rlgcomp.diagnosis.selections import in_all_runs
from rlgcomp.units import display_unit

_MOST: Final = 12  # of a ladder; a density of relays has more, and none of them means anything singly


@dataclasses.dataclass(frozen=True)
class Switch:
    """A relay with its step.

    Parameters
    ----------
    up, down : float
        Where it goes on as its driver rises, and off as it falls.
    of_unit : str
        Of the driver.
    step : Estimate
        What it adds where it is on.
    """

    up: float
    down: float
    of_unit: str
    step: Estimate

    @property
    def place(self) -> str:
        """Where it switches, in words."""
        return f"from {self.up:.4g} {self.of_unit} on, until {self.down:.4g} {self.of_unit}"

    @property
    def text(self) -> str:
        """Its step and where it switches."""
        return f"{self.step.text} {self.place}"

    def to_mapping(self) -> dict[str, Any]:
        """An entry of a finding's `switches`."""
        places = {"up": self.up, "down": self.down}
        return {name: {"value": value, "unit": self.of_unit} for name, value in places.items()} | {"step": self.step.to_mapping()}


def switches_of(fit: Fit, k: int, unit: str) -> tuple[Switch, ...]:
    """Switches of the k-th member in the order of their thresholds; none where it is no sum of a few relays."""
    member, bases = fit.parts[k]
    leading = [(in_all_runs(basis), scale) for basis, scale in bases[: len(member.form.lead)]]
    relays = [(basis, scale) for basis, scale in leading if isinstance(basis, Relays)]
    if not relays or len(relays) < len(leading) or sum(len(basis.up) for basis, _ in relays) > _MOST:
        return ()
    weights, covariance = fit.weights(k), fit.covariance(k)
    found, at = [], 0
    for basis, scale in relays:
        driver = basis.driver
        for up, down in zip(basis.up, basis.down, strict=True):
            step = Estimate(float(weights[at] * scale), math.sqrt(covariance[at, at]) * scale, unit)
            raw_up, raw_down = (driver.centre + driver.half * level for level in (up, down))
            found.append(Switch(raw_up, raw_down, display_unit(driver.columns[0]) or "", step))
            at += 1
    return tuple(sorted(found, key=lambda switch: switch.up))
