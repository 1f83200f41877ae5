"""The meaning of the symbols in an equation, for readers who see it for the first time."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Final

from rlgcomp.report.messages.wording import listing

_MEANINGS: Final = (
    ("b", r"^b = ", "contribution to the output"),
    ("k", r"\bk\b(?!\()", "amplitude: output per unit of what it multiplies"),
    ("u", r"\bu\b", "{drivers}"),
    ("T", r"\bT\b(?!_)", "{temperature}"),
    ("D", r"\bD\b", "{drivers}"),
    ("W", r"\bW\b", "rate of the table"),
    ("theta", r"\btheta\b", "angle of the table"),
    ("t", r"(?<![\w/])t\b", "time since the start of the run"),
    ("d…/dt", r"\bd\w+/dt|\bd\(\w+\)/dt", "rate of change"),
    (
        "play(…; r)",
        r"\bplay\(",
        "play operator: its value stands still while the driver moves within ± r of it, and is dragged along at a distance r "
        "beyond; so the loop of a cycle is 2 r wide",
    ),
    ("r", r"[;,~] r\b|; radius", "threshold of the play, in the driver's unit"),
    ("relay", r"\brelays?\b", "switch that goes up at its upper threshold and down at its lower one, and keeps its state between"),
    ("lag(…)", r"\blag\(", "first-order lag: the driver as seen through an exponential delay of that time constant"),
    ("slab", r"\bslab\b", "layer that conducts heat from the driver's side"),
    ("f", r"\bf\(", "smooth function, drawn below with its band"),
    ("s", r"\bs\(", "output of the simulator"),
    ("w", r"\+ w \(", "how far from the one place to the other, 0 to 1"),
    ("z", r"\bz\b", "inner state of the loop, from -1 to 1"),
)


def symbols(equation: str, drivers: Sequence[str] = ()) -> list[tuple[str, str]]:
    """Symbols of an equation with their meanings, in the order of reading.

    Parameters
    ----------
    equation : str
        As a finding states it.
    drivers : sequence of str
        Columns that it reads.

    Examples
    --------
    >>> symbols("b = k_deg_h_min_K * |dT/dt|", ["temperature_block_degC"])
    [('b', 'contribution to the output'), ('T', 'temperature_block_degC'), ('d…/dt', 'rate of change')]
    """
    named = listing(drivers) or "driver"
    temperature = named if len(drivers) == 1 else "temperature"
    plain = equation.replace("dT/dt", "T d_/dt")
    return [
        (symbol, meaning.format(drivers=named, temperature=temperature))
        for symbol, pattern, meaning in _MEANINGS
        if re.search(pattern, plain if symbol == "T" else equation)
    ]
