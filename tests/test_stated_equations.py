"""Equations as they were found: every symbol that their numbers have, and the catalogue's own where it is that."""

from __future__ import annotations

import dataclasses
import re
from typing import Any

import numpy as np
import pytest

from rlgcomp.diagnosis.answer.fit import Fit
from rlgcomp.diagnosis.data import Data, Grid, Run
from rlgcomp.diagnosis.decide import Named
from rlgcomp.diagnosis.equations.equations import symbols
from rlgcomp.diagnosis.equations.findings import Cause, cause_of
from rlgcomp.diagnosis.equations.simulator_file import simulator_of
from rlgcomp.diagnosis.equations.stated import equation_of
from rlgcomp.diagnosis.evidence.bank import Bank
from rlgcomp.diagnosis.evidence.closed_form import Member
from rlgcomp.diagnosis.forms.bases import Basis, Own, Power, Smooth
from rlgcomp.diagnosis.forms.drivers import Driver, Path
from rlgcomp.diagnosis.forms.nonlinearities import Hinge, Saturation, SignedPower
from rlgcomp.diagnosis.forms.relaxations import Lag
from rlgcomp.diagnosis.forms.terms import Form
from rlgcomp.diagnosis.forms.times import Since
from rlgcomp.diagnosis.noise.model import Noise
from rlgcomp.diagnosis.regions.baseline import Baseline
from rlgcomp.diagnosis.regions.chamber import named
from rlgcomp.diagnosis.regions.setting import Setting
from rlgcomp.diagnosis.search.states import State
from rlgcomp.physics import CATALOGUE
from rlgcomp.physics.rotation_harmonics import RotationHarmonics
from rlgcomp.simulation.simulator import Simulator
from tests.two_hour_runs import BASELINE, runs_of

VOLTS = Path(Driver(("supply_voltage_V",), centre=15.0, half=0.1))
GRADIENT = Path(Driver(("temperature_block_degC", "temperature_shell_degC"), "difference", 0.0, 2.0))
D = "(temperature_block_degC - temperature_shell_degC)"
ONE, OTHER = RotationHarmonics(order_1=2), RotationHarmonics(order_1=6)


@pytest.mark.parametrize(
    ("lead", "equation"),
    [
        ((Hinge(VOLTS, 0.1, 1),), "b = k max(supply_voltage_V - c, 0)"),
        ((Hinge(VOLTS, 0.1, -1),), "b = k max(c - supply_voltage_V, 0)"),
        ((Hinge(GRADIENT, 0.1, -1),), f"b = k max(c - {D}, 0)"),
        ((Saturation(GRADIENT, 0.4, 0.1),), f"b = k tanh(({D} - c) / w)"),
        ((SignedPower(GRADIENT, 1.5, False, 0.1),), f"b = k sgn({D} - c) |{D} - c|^p"),
        ((Hinge(VOLTS, 0.0, 1, fixed=True),), "as the family has it"),
        ((Power(VOLTS), Smooth(VOLTS)), "as the family has it"),
        ((Own(ONE), Own(OTHER)), "b = cosine_1_deg_h * cos(2 theta) + sine_1_deg_h * sin(2 theta)"
                                 " + cosine_2_deg_h * cos(6 theta) + sine_2_deg_h * sin(6 theta)"),
        ((Own(RotationHarmonics(order_1=7)),), "b = cosine_1_deg_h * cos(7 theta) + sine_1_deg_h * sin(7 theta)"),
    ],
)  # fmt: skip
def test_an_equation_has_the_symbols_of_its_numbers(lead: tuple[Basis, ...], equation: str) -> None:
    assert equation_of(Form("some", "as the family has it", lead)) == equation
    meanings = dict(symbols(equation, ["supply_voltage_V"]))
    for symbol in ("c", "p", "w"):
        assert (symbol in meanings) == bool(re.search(rf"(?<!\w){symbol}(?!\w)", equation) and equation.startswith("b = k"))


@pytest.fixture(scope="module")
def data() -> Data:
    runs = runs_of(BASELINE, 2)
    return Data(tuple(Run.of(run, Grid.of(runs), lambda binned: binned.rate_deg_h()) for run in runs))


def found(data: Data, term: Any, *lead: Basis, region: str, equation: str) -> tuple[Cause, Fit]:
    """A finding of such leading bases, in runs that hold a term beside noise."""
    rng = np.random.default_rng(4)
    runs = [
        dataclasses.replace(run, output=run.means(term(run)) + 0.01 * rng.standard_normal(len(run.output))) for run in data.runs
    ]
    data = Data(tuple(dataclasses.replace(run, cache={}) for run in runs))
    simulator = Simulator.from_mapping({"kind": "chamber", "mechanisms": ["magnetic_field"]})
    baseline = Baseline(simulator).linearised(data)
    bank = Bank(data, baseline.design(data), baseline)
    fit = Fit(data, baseline, bank, State((Member(Form(region, equation, lead), 30.0),), Noise(), 0.0))
    setting = Setting(data, Driver.of(data, "temperature_block_degC"))
    regions = {one.key: one for one in named(setting, {region: CATALOGUE[region]}, ())}
    posterior: Any = type("Stub", (), {"regions": regions, "instead_of": lambda self, _: {}})()
    return cause_of(Named(region, region, 1.0, ()), fit, posterior, CATALOGUE, "deg/h"), fit


def decays(data: Data, slow: float) -> tuple[Cause, Fit]:
    longest = data.longest_s

    def term(run: Run) -> Any:
        return np.exp(-run.elapsed_s / (0.03 * longest)) + slow * np.exp(-run.elapsed_s / (0.3 * longest))

    lead = [Since("exponential", share * longest, longest) for share in (0.3, 0.03)]  # polished past each other
    family = "b = a exp(-t / time_constant_s) + c exp(-t / slower_time_constant_s)"
    return found(data, term, *lead, region="warm_up", equation=family)


def test_two_exponentials_of_one_sign_are_the_catalogues(data: Data) -> None:
    cause, fit = decays(data, 0.5)
    assert not cause.own_form
    assert cause.formula == cause.equation == CATALOGUE["warm_up"](terms="two").stated()
    truth = {"initial_deg_h": 1.5, "slower_share": 1.0 / 3.0}
    truth |= {"time_constant_s": 0.03 * data.longest_s, "slower_time_constant_s": 0.3 * data.longest_s}
    assert {name: one.value for name, one in cause.parameters.items()} == pytest.approx(truth, rel=0.05)
    assert all(one.sd > 0.0 for one in cause.parameters.values())
    written = simulator_of(fit, CATALOGUE)
    (mechanism,) = [one for one in written.simulator.mechanisms if one.name == "warm_up"]
    assert mechanism.terms == "two"
    assert written.error < 0.05


def test_two_exponentials_of_opposite_signs_have_their_numbers(data: Data) -> None:
    cause, fit = decays(data, -0.5)
    assert cause.own_form
    assert cause.states_its_numbers
    truth = {"a": 1.0, "c": -0.5, "time_constant_s": 0.03 * data.longest_s, "slower_time_constant_s": 0.3 * data.longest_s}
    assert {name: one.value for name, one in cause.parameters.items()} == pytest.approx(truth, rel=0.05)
    assert "warm_up" not in {one.name for one in simulator_of(fit, CATALOGUE).simulator.mechanisms}


def test_several_lags_are_not_told_as_one(data: Data) -> None:
    """Two were stated as one, with the numbers of the second."""
    block, longest = Driver.of(data, "temperature_block_degC"), data.longest_s
    slow, fast = (Lag(block, share * longest, 1.4) for share in (0.2, 0.02))
    equation = "b = k (lag(T, time_constant_s) - T)"

    def term(run: Run) -> Any:
        return (slow.columns(run) - 2.0 * fast.columns(run))[:, 0]

    cause, _ = found(data, term, slow, fast, region="thermal_lag", equation=equation)
    assert cause.equation == "b = k_1 (lag(T, time_constant_1_s) - T) + k_2 (lag(T, time_constant_2_s) - T)"
    assert list(cause.parameters) == ["k_1", "time_constant_1_s", "k_2", "time_constant_2_s"]
    values = {name: one.value for name, one in cause.parameters.items()}
    assert values["k_2"] * block.half == pytest.approx(1.0, rel=0.05)
    assert values["k_1"] * block.half == pytest.approx(-2.0, rel=0.05)
    assert values["time_constant_1_s"] == pytest.approx(0.02 * longest)
    one, _ = found(data, term, slow, region="thermal_lag", equation=equation)
    assert one.equation == equation
