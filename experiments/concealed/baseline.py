"""The simulator that lacks something: what it has, its true numbers, and its file."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Collection, Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from experiments.concealed.chamber import Chamber
from experiments.concealed.effects import BLOCK, SHELL
from experiments.concealed.operators import first_order
from rlgcomp.physics import CATALOGUE

Array = npt.NDArray[np.float64]
_KIN_OF_LAG = {"temperature_rate", "thermal_gradient", "thermal_hysteresis"}


@dataclasses.dataclass(frozen=True)
class Part:
    """A mechanism that the simulator has.

    Parameters
    ----------
    name : str
        In the catalogue, as are the parameters.
    parameters : tuple of str
    weights : ndarray
        True amplitudes, over the white noise of a window's mean.
    columns : callable
        Of a chamber, shape (n, weights).
    drivers : tuple of str
    power : float
        Of time in the amplitudes' units: one for a rate of change.
    settings : mapping
    """

    name: str
    parameters: tuple[str, ...]
    weights: Array
    columns: Callable[[Chamber], Array]
    drivers: tuple[str, ...]
    power: float = 0.0
    settings: Mapping[str, float] = dataclasses.field(default_factory=dict)


def draw(rng: np.random.Generator, hidden: Collection[str]) -> list[Part]:
    """A polynomial of the temperature unless that is hidden, and often one mechanism more, of sizes up to tens of the noise."""
    size = math.exp(rng.uniform(math.log(3.0), math.log(60.0)))
    polynomial = Part(
        "thermal_polynomial",
        ("c0_deg_h", "c1_deg_h_K", "c2_deg_h_K2", "c3_deg_h_K3"),
        size * rng.normal(0.0, [1.0, 1.0, 0.4, 0.2]) / 50.0 ** np.arange(4),
        lambda c: np.vander(c.block - 20.0, 4, increasing=True),
        (BLOCK,),
        settings={"degree": 3},
    )
    lag_s = float(rng.uniform(600.0, 4000.0))
    weight = size * rng.normal(0.0, 0.3)
    others = [
        Part("temperature_rate", ("k_deg_h_min_K",), np.array([weight]), lambda c: c.rate_K_min[:, None], (BLOCK,), power=1.0),
        Part("thermal_gradient", ("k_deg_h_K",), np.array([weight / 5.0]), lambda c: (c.block - c[SHELL])[:, None], (BLOCK, SHELL)),
        Part(
            "light_intensity",
            ("k_deg_h_V",),
            np.array([weight / 0.01]),
            lambda c: (c["light_intensity_V"] - 1.0)[:, None],
            ("light_intensity_V",),
        ),
        Part(
            "thermal_lag",
            ("k_deg_h_K",),
            np.array([weight / 10.0]),
            lambda c: (first_order(c.block, c.step_s, lag_s) - c.block)[:, None],
            (BLOCK,),
        ),
    ]
    chosen = others[0] if rng.random() < 0.35 else others[int(rng.integers(1, 4))] if rng.random() < 0.3 else None
    if chosen is not None and chosen.name == "thermal_lag" and set(hidden) & _KIN_OF_LAG:
        chosen = None  # with a free time constant it leaves nothing by which these could be told apart
    parts = [part for part in (polynomial, chosen) if part is not None and part.name not in hidden]
    return parts or [next(part for part in others if part.name not in hidden)]


def largest(mechanism: str, parameter: str) -> float:
    """The largest number that a simulator's file takes."""
    return next(one.high for one in CATALOGUE[mechanism].parameters() if one.name == parameter)


def columns(parts: Sequence[Part], chamber: Chamber) -> Array:
    """Of all parts, shape (n, weights)."""
    return np.column_stack([part.columns(chamber) for part in parts])


def with_bias(known: Array) -> Array:
    """The same and a bias: every gyro has one, whatever its simulator lacks."""
    return np.column_stack([known, np.ones(len(known))])


def to_mapping(
    parts: Sequence[Part],
    rng: np.random.Generator,
    *,
    time: float,
    rate_deg_h: float,
    wrong: tuple[str, str, float] | None = None,
) -> dict[str, Any]:
    """The simulator's file: for half of the gyros its free numbers are stated, and wrong.

    Parameters
    ----------
    parts : sequence of Part
    rng : Generator
    time, rate_deg_h : float
        How much longer times are, and the unit of rate in deg/h.
    wrong : (str, str, float), optional
        Mechanism, parameter, and by how much it is wrong though it is stated as known, in units of the part's weight.
    """
    free = bool(rng.random() < 0.5)
    listed: list[Any] = []
    for part in parts:
        values: dict[str, Any] = dict(part.settings)
        unit = rate_deg_h * time**part.power
        for parameter, weight in zip(part.parameters, part.weights.tolist(), strict=True):
            factor = rng.uniform(0.2, 1.8)
            if wrong is not None and wrong[:2] == (part.name, parameter):
                values[parameter] = unit * (weight + wrong[2])
            elif free and abs(unit * weight * factor) <= largest(part.name, parameter):
                values[parameter] = {"value": unit * weight * factor, "free": True}
        listed.append({part.name: values} if values else part.name)
    return {"kind": "chamber", "mechanisms": listed}
