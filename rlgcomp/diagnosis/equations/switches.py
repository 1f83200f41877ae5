"""Switches of a member that is a sum of relays, such as a ladder of mode hops: where each goes up and down, and its step."""

from __future__ import annotations

import dataclasses
import math
from typing import Any, Final, Literal

import numpy as np

from rlgcomp.diagnosis.answer.fit import Estimate, Fit
from rlgcomp.diagnosis.forms.memories import Relays
from rlgcomp.diagnosis.forms.terms import Form
from rlgcomp.diagnosis.regions.selections import in_all_runs
from rlgcomp.units import display_unit

_MOST: Final = 12  # of a ladder; a density of relays has more, and none of them means anything singly
_RANGE: Final = 2.0  # halves of the driver's range, over which levels are tried to both sides of a threshold,
_LEVELS: Final = 16  # so many
_BEYOND: Final = 1.05  # of the range, beyond which the driver hardly goes


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
    up_sd, down_sd : float
        Standard deviations of the thresholds; zero where they are not known.
    """

    up: float
    down: float
    of_unit: str
    step: Estimate
    up_sd: float = 0.0
    down_sd: float = 0.0

    @property
    def place(self) -> str:
        """Where it switches, in words."""
        up, down = (Estimate(*of, self.of_unit).text for of in ((self.up, self.up_sd), (self.down, self.down_sd)))
        return f"from {up} on, until {down}"

    @property
    def text(self) -> str:
        """Its step and where it switches."""
        return f"{self.step.text} {self.place}"

    def to_mapping(self) -> dict[str, Any]:
        """An entry of a finding's `switches`."""
        up, down = Estimate(self.up, self.up_sd, self.of_unit), Estimate(self.down, self.down_sd, self.of_unit)
        return {"up": up.to_mapping(), "down": down.to_mapping(), "step": self.step.to_mapping()}


def switches_of(fit: Fit, k: int, unit: str) -> tuple[Switch, ...]:
    """Switches of the k-th member in the order of their thresholds; none where it is no sum of a few relays."""
    member, bases = fit.parts[k]
    leading = [(in_all_runs(basis), scale) for basis, scale in bases[: len(member.form.lead)]]
    relays = [(basis, scale) for basis, scale in leading if isinstance(basis, Relays)]
    if not relays or len(relays) < len(leading) or sum(len(basis.up) for basis, _ in relays) > _MOST:
        return ()
    weights, covariance = fit.weights(k), fit.covariance(k)
    found, at = [], 0
    for j, (basis, scale) in enumerate(relays):
        driver = basis.driver
        for i, (up, down) in enumerate(zip(basis.up, basis.down, strict=True)):
            step = Estimate(float(weights[at] * scale), math.sqrt(covariance[at, at]) * scale, unit)
            raw_up, raw_down = (driver.centre + driver.half * level for level in (up, down))
            up_sd, down_sd = (driver.half * _spread(fit, k, j, i, side) for side in ("up", "down"))
            found.append(Switch(raw_up, raw_down, display_unit(driver.columns[0]) or "", step, up_sd, down_sd))
            at += 1
    return tuple(sorted(found, key=lambda switch: switch.up))


def _spread(fit: Fit, k: int, j: int, i: int, side: Literal["up", "down"]) -> float:
    """Standard deviation of a threshold of the j-th leading basis, over half the driver's range.

    It is that of the evidence over levels to both sides, and of what the driver moves by in a window, within which no window tells
    one level from another.
    """
    form = fit.state.members[k].form
    basis = in_all_runs(form.lead[j])
    assert isinstance(basis, Relays)  # noqa: S101
    level = getattr(basis, side)[i]
    step = _passes_by(fit, basis, level)
    far = np.geomspace(0.5 * step, max(_RANGE, step), _LEVELS)
    levels = [one for one in np.r_[level - far[::-1], level + far].tolist() if abs(one) <= _BEYOND and _apart(basis, i, side, one)]
    falls = fit.falls(k, [_moved(form, j, i, side, one) for one in levels])
    at = np.array([*levels, level])
    order = np.argsort(at)
    moves, likely = at[order] - level, np.exp(-np.maximum([*falls, 0.0], 0.0))[order]
    variance = np.trapezoid(likely * moves**2, moves) / np.trapezoid(likely, moves) if len(moves) > 1 else 0.0
    return math.sqrt(variance + step**2 / 12.0)


def _passes_by(fit: Fit, basis: Relays, level: float) -> float:
    """What the driver moves by in a window as it passes a level most slowly; in any window, where it never does."""
    means = [run.window_means(basis.driver.values(run)) for run in fit.data.runs]
    moves = np.concatenate([np.abs(np.diff(one)) for one in means])
    passes = np.concatenate([(one[1:] - level) * (one[:-1] - level) <= 0.0 for one in means]) & (moves > 0.0)
    usual = float(np.median(moves)) or float(np.max(moves, initial=0.0))
    return float(np.min(moves[passes])) if passes.any() else usual


def _apart(basis: Relays, i: int, side: str, level: float) -> bool:
    """Whether a relay with one threshold at another level still goes on above where it goes off."""
    return level > basis.down[i] if side == "up" else level < basis.up[i]


def _moved(form: Form, j: int, i: int, side: str, level: float) -> Form:
    """A form with one threshold of its j-th leading basis at another level."""
    whole: Any = form.lead[j]
    basis: Any = in_all_runs(whole)
    levels = getattr(basis, side)
    other = dataclasses.replace(basis, **{side: (*levels[:i], level, *levels[i + 1 :])})
    placed = other if whole is basis else dataclasses.replace(whole, basis=other)
    return dataclasses.replace(form, lead=(*form.lead[:j], placed, *form.lead[j + 1 :]))
