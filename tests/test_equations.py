"""Equations of findings as LaTeX, as SymPy's expressions, and as functions of a recording."""

from __future__ import annotations

import io
import re

import numpy as np
import pytest
from matplotlib.figure import Figure

import rlgcomp as rlg
from rlgcomp.diagnosis.answer.fit import Estimate
from rlgcomp.diagnosis.equations.equations import latex, sympy
from rlgcomp.diagnosis.equations.findings import Cause

IN_WORDS = {"thermal_polynomial", "thermal_hysteresis", "mode_hop", "random_telegraph", "tabulated_law"}


def cause(name: str, **parameters: float) -> Cause:
    mechanism = rlg.CATALOGUE[name]
    fitted = mechanism(**parameters)
    values = {p.name: Estimate(getattr(fitted, p.name), 0.1, p.unit) for p in fitted.amplitude_parameters()}
    terms = (fitted,) if fitted.repeats() else ()
    given = values or {"k": Estimate(1.0, 0.1, "")}
    return Cause(name, True, 1.0, given, (), "b = f(T)", False, (), "static", None, 0.001, mechanism=mechanism, terms=lambda: terms)


@pytest.mark.parametrize(
    ("equation", "expected"),
    [
        ("b = k_deg_h_min_K * dT/dt", r"b = k \, \dot{T}"),
        ("b = 1e-6 k_ppm * W + bias_deg_h", r"b = 10^{-6} \, k \, W + \mathrm{bias}"),
        ("b = k_deg_h * (readout_a_V - readout_b_V) / (readout_a_V + readout_b_V)",
         r"b = \frac{k \, \left(\mathrm{readout}_{\mathrm{a}} - \mathrm{readout}_{\mathrm{b}}\right)}"
         r"{\mathrm{readout}_{\mathrm{a}} + \mathrm{readout}_{\mathrm{b}}}"),
        ("b = 0.005 deg/h * (temperature - 10 degC) / 50 degC",
         r"b = \frac{0.005\,\mathrm{deg/h} \, \left(\mathrm{temperature} - 10\,\mathrm{degC}\right)}{50\,\mathrm{degC}}"),
        ("b = W^2 |dT/dt| sqrt(T)", r"b = {W}^{2} \, \left|\dot{T}\right| \, \sqrt{T}"),
        ("b = this, as nobody computes it", r"b = \text{this, as nobody computes it}"),
    ],
)  # fmt: skip
def test_latex(equation: str, expected: str) -> None:
    assert latex(equation) == expected


@pytest.mark.parametrize("name", rlg.CATALOGUE)
def test_latex_of_every_mechanism_can_be_typeset(name: str) -> None:
    text = cause(name).latex
    assert text.startswith("b = ")
    if name not in IN_WORDS:  # Matplotlib typesets a part of LaTeX, and the formulas of descriptions need more
        figure = Figure()
        figure.text(0.0, 0.5, "$" + re.sub(r"\\operatorname\{(\w+)\}", r"\\mathrm{\1}", text) + "$")
        figure.savefig(io.BytesIO(), format="svg")


@pytest.mark.needs("sympy")
@pytest.mark.parametrize("name", sorted(set(rlg.CATALOGUE) - IN_WORDS))
def test_every_formula_is_an_expression(name: str) -> None:
    import sympy as library

    expression = cause(name).sympy()
    assert isinstance(expression, library.Expr)
    names = {parameter.name for parameter in rlg.CATALOGUE[name]().amplitude_parameters()}
    assert names <= {str(symbol) for symbol in expression.free_symbols}


@pytest.mark.needs("sympy")
def test_an_expression_is_the_function() -> None:
    import sympy as library

    run = rlg.simulated_unit(1).simulate("short", seed=1, step_s=20.0)
    found = cause("readout_incoherence", k_deg_h=0.8)
    expression = found.sympy(numbers=True)
    assert {str(symbol) for symbol in expression.free_symbols} == {"readout_a_V", "readout_b_V"}
    function = library.lambdify(sorted(expression.free_symbols, key=str), expression)
    a, b = run["readout_a_V"], run["readout_b_V"]
    assert function(a, b) == pytest.approx(found(run))
    assert found(run) == pytest.approx(0.8 * (a - b) / (a + b))


@pytest.mark.needs("sympy")
def test_what_is_in_words_has_a_function_but_no_expression() -> None:
    run = rlg.simulated_unit(1).simulate("short", seed=1, step_s=20.0)
    found = cause("thermal_hysteresis", k1_deg_h_K=1e-3)
    with pytest.raises(rlg.InputError, match=r"stated in words.* call the finding with a recording"):
        found.sympy()
    assert found(run).shape == (len(run),)
    assert r"\sum" in found.latex
    with pytest.raises(rlg.InputError, match="random_telegraph differs from run to run"):
        cause("random_telegraph")(run)


@pytest.mark.needs("sympy")
def test_powers_bind_before_products_and_bars_nest_in_parentheses() -> None:
    import sympy as library

    values = {"W": -3.0, "k": 2.0}
    expression = sympy("b = k W^2 * |W / (1 + 2)| - W")
    assert float(expression.subs({library.Symbol(name, real=True): value for name, value in values.items()})) == 2 * 9 * 1 + 3
    assert np.isfinite(float(sympy("b = 1e-6 * 3")))
