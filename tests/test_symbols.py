"""The meanings of symbols in equations of findings."""

from __future__ import annotations

import pytest

from rlgcomp.diagnosis.equations.equations import symbols
from rlgcomp.physics import CATALOGUE

COLUMN = "temperature_block_degC"


@pytest.mark.parametrize(
    ("equation", "expected"),
    [
        ("b = play(u; r) - u", ["b", "u", "play(…; r)", "r"]),
        ("b = play(u; radius) - u", ["b", "u", "play(…; r)", "r"]),
        ("b = k_deg_h_K * (lag(T, time_constant_s) - T)", ["b", "T", "lag(…)"]),
        ("b = f(T), finely", ["b", "T", "f"]),
        ("b = k t^exponent", ["b", "k", "t"]),
        ("b = k d(supply_voltage_V)/dt", ["b", "k", "d…/dt"]),
        ("b = step * relay(T; up at threshold, down at dead_band below)", ["b", "T", "relay"]),
        ("b = k_deg_h_V * (supply_voltage_V - reference_V)", ["b"]),
    ],
)
def test_symbols_of_an_equation(equation: str, expected: list[str]) -> None:
    assert [symbol for symbol, _ in symbols(equation, [COLUMN])] == expected


def test_the_driver_is_named() -> None:
    assert ("u", COLUMN) in symbols("b = play(u; r) - u", [COLUMN])
    assert ("T", "temperature") in symbols("b = f(T) W", [COLUMN, "table_rate_deg_s"])


@pytest.mark.parametrize("name", sorted(CATALOGUE))
def test_equations_of_the_catalogue_have_meanings_without_braces(name: str) -> None:
    for symbol, meaning in symbols(CATALOGUE[name].equation, [COLUMN]):
        assert symbol
        assert "{" not in meaning
