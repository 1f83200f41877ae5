"""The fitted model of a diagnosis as a simulator file."""

from __future__ import annotations

import dataclasses
from pathlib import Path as File
from typing import Any

import numpy as np
import pandas as pd
import pytest

from rlgcomp.diagnosis.answer.fit import Fit
from rlgcomp.diagnosis.data import Data, Grid, Run
from rlgcomp.diagnosis.diagnose import diagnose
from rlgcomp.diagnosis.equations.simulator_file import simulator_of
from rlgcomp.diagnosis.evidence.bank import Bank
from rlgcomp.diagnosis.evidence.closed_form import Member
from rlgcomp.diagnosis.forms.bases import Glitch, Magnitude, Power, Product, Shift, Smooth, SmoothBetween
from rlgcomp.diagnosis.forms.drivers import Driver, Path
from rlgcomp.diagnosis.forms.histories import after_rest
from rlgcomp.diagnosis.forms.memories import Curves, Followed, Plays, Preisach, Relays
from rlgcomp.diagnosis.forms.nonlinearities import Hinge, Saturation, SignedPower
from rlgcomp.diagnosis.forms.relaxations import Conduction, Distributed, Lag, Spectrum
from rlgcomp.diagnosis.forms.symmetries import Sign, about_zero
from rlgcomp.diagnosis.forms.terms import Form
from rlgcomp.diagnosis.forms.times import Since, SmoothSince, Wave
from rlgcomp.diagnosis.noise.model import Noise
from rlgcomp.diagnosis.regions.baseline import Baseline
from rlgcomp.diagnosis.search.states import State
from rlgcomp.errors import InputError
from rlgcomp.physics import CATALOGUE
from rlgcomp.physics.tabulated_law import TabulatedLaw
from rlgcomp.recording import Recording
from rlgcomp.simulation.simulator import Simulator
from tests.few_monitors import few_monitors

PROGRAMMES = (
    "start 20, hold 40, ramp -30 1, hold 60, ramp 50 1.2, hold 40, ramp 10 0.8, hold 40, ramp 35 1, hold 30",
    "start 25, hold 30, ramp 55 0.9, hold 60, ramp -20 1.1, hold 50, ramp 30 0.7, hold 30, ramp 0 1, hold 30",
)


@pytest.fixture(scope="module")
def runs() -> list[Recording]:
    real = Simulator.from_mapping({"kind": "chamber", "mechanisms": ["thermal_polynomial"]})
    return [real.simulate(p, seed=k, step_s=20.0, name=f"run{k}") for k, p in enumerate(PROGRAMMES)]


@pytest.fixture(scope="module")
def root(runs: list[Recording]) -> Data:
    """An output that follows a temperature's square root, so that all weights of the forms are used."""
    grid = Grid.of(runs)
    return Data(tuple(Run.of(run, grid, lambda binned: np.sqrt(60.0 + binned.column("temperature_block_degC"))) for run in runs))


def fit_with(data: Data, *forms: Form) -> Fit:
    simulator = Simulator.from_mapping({"kind": "chamber", "mechanisms": ["light_intensity"]})
    baseline = Baseline(simulator).linearised(data)
    bank = Bank(data, baseline.design(data))
    return Fit(data, baseline, bank, State(tuple(Member(form, 30.0) for form in forms), Noise(), 0.0))


def forms_of(data: Data) -> dict[str, tuple[Any, ...]]:
    block = Driver.of(data, "temperature_block_degC")
    gradient = Path(Driver.of(data, "temperature_block_degC", "temperature_shell_degC", combination="difference"))
    contrast = Path(Driver.of(data, "readout_a_V", "readout_b_V", combination="contrast"))
    between = Driver.of(data, "temperature_block_degC", "temperature_shell_degC", combination="between", share=0.4)
    hop = Relays(block, (0.3, -0.4), (0.25, -0.45), "below")
    times = (100.0, 700.0, 3000.0)
    return {
        "polynomial and smooth": (Power(Path(block), 3), Smooth(Path(block))),
        "difference": (Power(gradient), Smooth(gradient), Shift(Power(gradient))),
        "contrast": (Power(contrast), Smooth(contrast)),
        "between": (SmoothBetween(Path(between)), Smooth(Path(block))),
        "nonlinearities": (Saturation(Path(block), 0.3, 0.2), Hinge(Path(block), 0.4, -1), SignedPower(gradient, 0.6, False)),
        "rate": (Power(Path.rate(data, block)), Magnitude(Path.rate(data, block))),
        "late": (Power(Path(block, "lag", 900.0)), Lag(block, 500.0, 1.4, behind=False)),
        "lags": (Lag(block, 900.0, 1.4), Conduction(block, 4000.0, True, 1.4), Spectrum(block, times)),
        "distributed lags": (Distributed(block, 1500.0, 0.6, 1.4),),
        "plays": (Plays(block, 0.2, True), Plays(block, 0.3, False, "above")),
        "a rest": (Plays(block, 0.3, True, histories=after_rest(-0.5)), Preisach(block, 0.6, False, histories=after_rest(0.4))),
        "relays": (hop, Shift(hop), Glitch(hop)),
        "curves": (Curves(block, 0.4),),
        "density": (Preisach(block, 0.6, True, 0.5, 20),),
        "product": (Product(Path(block), Path(Driver.of(data, "supply_voltage_V"))),),
        "time": (Since("exponential", 1500.0, 20000.0), Since("power", 0.5, 20000.0), SmoothSince(70.0, 20000.0)),
        "waves": (Wave(1e-3, 1e-5), Wave(1e-3, 1e-5, True)),
    }


@pytest.mark.parametrize("name", [
    "polynomial and smooth", "difference", "contrast", "between", "nonlinearities", "rate", "late", "lags", "plays", "a rest",
    "relays", "density", "curves", "distributed lags", "product", "time", "waves",
])  # fmt: skip
def test_every_form_is_written_and_predicts_the_same(name: str, runs: list[Recording], root: Data, tmp_path: File) -> None:
    bases = forms_of(root)[name]
    fit = fit_with(root, Form("term", "b = f", bases[:1], bases[1:]))
    written = simulator_of(fit, CATALOGUE)
    assert not written.left_out
    assert written.error < 0.02
    written.simulator.to_yaml(tmp_path / "augmented.yaml")
    again = Simulator.from_yaml(tmp_path / "augmented.yaml")
    assert again == dataclasses.replace(written.simulator, free=again.free)
    for run in runs:
        one, other = (simulator.predict(run).rate_deg_h() for simulator in (written.simulator, again))
        np.testing.assert_array_equal(one, other)
        fitted = fit.rate_deg_h(run, Grid.of(runs))  # constant after the last whole window
        assert np.std((one - fitted)[:-10]) < 0.05 * np.std(one)


def test_a_law_of_rows_and_a_line_that_cancels_it_are_written_for_the_same_rows() -> None:
    """A cubic spring as a wide hyperbolic tangent less its tangent: the line of bin means left 76 times the noise."""
    time_s = 0.05 * np.arange(12000)
    displacement = 10.0 * np.sin(2.0 * np.pi * time_s / 1.1) * (0.6 + 0.4 * np.sin(time_s / 70.0))
    force = 2e-3 * displacement**3 + np.random.default_rng(0).normal(0.0, 0.02, len(time_s))
    other = {"light_intensity_V": 1.0 + 1e-3 * np.sin(time_s / 40.0)}
    table = {"time_s": time_s, "displacement_mm": displacement, "gyro_deg_h": force} | other
    runs = [Recording(pd.DataFrame(table))]
    data = Data(tuple(Run.of(run, Grid.of(runs), lambda binned: binned.column("gyro_deg_h")) for run in runs))
    driver = about_zero(Driver.of(data, "displacement_mm"))
    assert driver is not None
    fit = fit_with(data, Form("law:displacement_mm", "b = c tanh(u / w) + k u", (Sign(driver, 2.0), Power(Path(driver)))))
    written = simulator_of(fit, CATALOGUE)
    assert max(np.abs(one.weights).max() for one in written.simulator.mechanisms if isinstance(one, TabulatedLaw)) > 20.0
    assert written.error < 0.05


def test_a_loop_about_a_curve_is_written_as_the_mechanism_that_has_its_law(root: Data) -> None:
    block = forms_of(root)["lags"][0].driver
    curve = Followed(block, 0.3, -0.2, 0.4)
    fit = fit_with(root, Form("thermal_hysteresis", "b = k z", (curve,)))
    written = simulator_of(fit, CATALOGUE)
    assert not written.left_out
    (mechanism,) = [one for one in written.simulator.mechanisms if one.name == "thermal_hysteresis"]
    assert mechanism.law == "coleman_hodgdon"
    assert mechanism.radius_K == pytest.approx(0.3 * block.half)
    assert mechanism.curve_centre_degC == pytest.approx(block.centre - 0.2 * block.half)
    assert mechanism.curve_K == pytest.approx(0.4 * block.half)
    assert written.error < 0.02


def test_a_table_is_straight_beyond_its_knots_and_monotone_between() -> None:
    law = TabulatedLaw(driver="x_V", memory="none", knots=(0.0, 1.0, 3.0), weights=(0.0, 2.0, 2.0), slope_below=5.0, step_s=1.0)
    x = np.array([-1.0, 0.0, 0.5, 1.0, 2.0, 3.0, 9.0])
    table = pd.DataFrame({"time_s": np.arange(7.0), "gyro_deg_h": 0.0, "x_V": x})
    values = law.basis(Recording(table))[:, 0]
    assert values[[0, 1, 3, 4, 5, 6]] == pytest.approx([-5.0, 0.0, 2.0, 2.0, 2.0, 2.0])
    assert 0.0 < values[2] < 2.0


def test_a_rate_that_jumps_from_row_to_row_is_read_as_it_is() -> None:
    """Liu's table 3 as a recording: a smoothed rate left 150 times the noise of a window."""
    rates = np.tile([1.0, -60.0, 30.0, -2.0, 60.0, -9.0], 40)
    run = Recording(
        pd.DataFrame({"time_s": 100.0 * np.arange(len(rates)), "gyro_deg_s": rates, "table_rate_deg_s": rates}), name="rates"
    )
    law = TabulatedLaw(driver="table_rate_deg_s", memory="none", knots=(-60.0, 0.0, 60.0), weights=(-3.0, 0.0, 5.0), step_s=100.0)
    of_each = law.basis(run)[:, 0]
    for rate, value in ((-60.0, -3.0), (60.0, 5.0)):
        assert of_each[rates == rate] == pytest.approx(value)


@pytest.mark.parametrize(
    "wrong",
    [
        {"memory": "none"},
        {"driver": "x_V", "memory": "none", "knots": [0.0, 1.0], "weights": [1.0]},
        {"driver": "x_V", "memory": "none", "knots": [1.0, 0.0], "weights": [1.0, 2.0]},
        {"driver": "x_V", "memory": "relays", "knots": [1.0], "weights": [1.0]},
        {"driver": "x_V", "memory": "curves", "knots": [0.0, 1.0], "weights": [1.0, 2.0], "knots_2": [1.0]},
        {"driver": "x_V", "memory": "curves", "knots": [0.0, 1.0], "weights": [1.0, 2.0], "weights_2": [1.0, 2.0]},
        {"driver": "x_V", "memory": "product", "knots": [1.0, 2.0], "weights": [1.0]},
        {"knots": "many"},
        {"knots": [float("nan")]},
    ],
)
def test_a_table_that_is_none_is_refused(wrong: dict[str, Any]) -> None:
    with pytest.raises(InputError, match="tabulated_law"):
        TabulatedLaw.from_mapping(wrong)


def test_a_rate_of_noisy_readings_comes_back_as_the_mechanism(tmp_path: File) -> None:
    """Its slopes are over a window that the readings' noise asks for; it was a table of 27 knots without a number to read."""
    mechanisms = [{"thermal_polynomial": {"degree": 1}}, {"temperature_rate": {"k_deg_h_min_K": -0.4}}]
    noise = {"angle_random_walk_deg_sqrt_h": 0.005}
    real = Simulator.from_mapping({"kind": "chamber", "mechanisms": mechanisms, "noise": noise})
    rng, noisy = np.random.default_rng(2), []
    for run in (real.simulate(p, seed=k, step_s=20.0, name=f"run{k}") for k, p in enumerate(PROGRAMMES)):
        block = run.column("temperature_block_degC") + 0.02 * rng.standard_normal(len(run))
        noisy.append(few_monitors(run.replace(table=run.table.assign(temperature_block_degC=block), truth=None)))
    free = {"temperature_rate": {"k_deg_h_min_K": "free"}}
    known = Simulator.from_mapping({"kind": "chamber", "mechanisms": [mechanisms[0], free]})
    found = diagnose(known, noisy, only=["supply_voltage"], black_box=False)
    found.augmented.to_yaml(tmp_path / "augmented.yaml")
    again = Simulator.from_yaml(tmp_path / "augmented.yaml")
    (rate,) = [one for one in again.mechanisms if one.name == "temperature_rate"]
    estimate = found.recalibration["temperature_rate"]["k_deg_h_min_K"]
    assert rate.k_deg_h_min_K == pytest.approx(estimate.value)
    assert rate.averaging_s > 0.0
    assert again.free["temperature_rate"] == {"k_deg_h_min_K"}
    assert found.augmented_file.error < 0.2
