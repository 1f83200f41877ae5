"""Which cases are made: kinds, strengths, and seeds, those for tuning apart from those of the printed page."""

from __future__ import annotations

import dataclasses
import math
import zlib
from collections.abc import Mapping
from typing import Literal

import numpy as np

from experiments.concealed.effects import CATALOGUED, OUTSIDE, UNRECORDED
from experiments.concealed.observer import STRONGEST, WEAKEST
from experiments.concealed.turntable import EFFECTS

Kind = Literal["single", "weak", "pair", "triple", "unequal", "nuisance", "healthy", "outside", "unrecorded", "turntable"]
Nuisance = Literal["", "step", "run bias", "wrong number"]
NUMBERS: Mapping[Kind, int] = {
    "single": 170, "weak": 68, "pair": 51, "triple": 34, "unequal": 34, "nuisance": 51, "healthy": 100, "outside": 50,
    "unrecorded": 30, "turntable": 54,
}  # fmt: skip
KINDS: tuple[Kind, ...] = tuple(NUMBERS)
NUISANCES: tuple[Nuisance, ...] = ("step", "run bias", "wrong number")
NAMED: tuple[Kind, ...] = ("single", "weak", "pair", "triple", "unequal", "nuisance", "turntable")
_MANY = 1_000_000  # seeds of a kind
EDITION = 12  # of the page's cases: raised once those of a page were looked at one by one
_OF_EDITION = 10_000  # seeds


@dataclasses.dataclass(frozen=True)
class Plan:
    """What a case is to be.

    Parameters
    ----------
    kind : str
    hidden : tuple of str
        Names in the catalogue, or of laws outside it; none for a healthy gyro.
    strengths : tuple of float
        Root mean square of what the simulator cannot absorb of each effect, over the white noise of a window's mean.
    nuisance : {"", "step", "run bias", "wrong number"}
        Beside the effects: one or two steps of the bias in training runs, a bias a run, or a number that is stated as known and
        wrong.
    seed : int
    """

    kind: Kind
    hidden: tuple[str, ...]
    strengths: tuple[float, ...]
    nuisance: Nuisance
    seed: int

    @property
    def name(self) -> str:
        nuisance = f"+{self.nuisance.replace(' ', '_')}" if self.nuisance else ""
        strengths = "/".join(f"{strength:.2g}" for strength in self.strengths) or "0"
        return f"{self.kind}-{'+'.join(self.hidden) or 'healthy'}{nuisance}-{strengths}-{self.seed}"


def stream(seed: int, name: str) -> np.random.Generator:
    """Random numbers of a seed and a name."""
    return np.random.default_rng([seed, zlib.crc32(name.encode())])


def seed_of(kind: Kind, number: int, *, tuning: bool) -> int:
    """Seed of a case: those for tuning are never those of the page, and those of one edition of it none of another."""
    return _MANY * (2 * KINDS.index(kind) + 2 + tuning) + (0 if tuning else EDITION * _OF_EDITION) + number


def plan(kind: Kind, cases: int, first: int = 0, *, tuning: bool = False) -> list[Plan]:
    """So many cases of a kind, every name in turn."""
    return [_planned(kind, number, tuning) for number in range(first, first + cases)]


def _planned(kind: Kind, number: int, tuning: bool) -> Plan:
    seed = seed_of(kind, number, tuning=tuning)
    rng = stream(seed, "plan")

    def between(low: float, high: float) -> float:
        return math.exp(rng.uniform(math.log(low), math.log(high)))

    nuisance: Nuisance = NUISANCES[number % len(NUISANCES)] if kind == "nuisance" else ""
    several = {"pair": 2, "unequal": 2, "triple": 3}.get(kind, 1)
    if kind in ("pair", "unequal", "triple"):
        others = [name for name in CATALOGUED if name != "thermal_polynomial"]  # without one there is no simulator to speak of
        names = tuple(str(name) for name in rng.choice(others, several, replace=False))
    else:
        pool = {"outside": list(OUTSIDE), "unrecorded": list(UNRECORDED), "turntable": [*EFFECTS, ""], "healthy": [""]}.get(
            kind, list(CATALOGUED)
        )
        names = (pool[number % len(pool)],)
    hidden = tuple(name for name in names if name)
    if kind == "single":
        strengths = [between(WEAKEST, STRONGEST)]
    elif kind == "weak":
        strengths = [WEAKEST]
    elif kind == "unequal":
        weaker = between(1.0, 3.2)
        strengths = [weaker * between(5.0, 10.0), weaker]
    else:
        weakest = between(1.0, 8.0) if kind in ("pair", "triple", "nuisance") else between(0.5, 8.0)
        strengths = [weakest, *(weakest * between(1.0, 4.0) for _ in range(several - 1))]
    return Plan(kind, hidden, tuple(strengths[: len(hidden)]), nuisance, seed)
