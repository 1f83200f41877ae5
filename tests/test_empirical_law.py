"""The empirical law: its forms and memories against other implementations, its text, its file, and what it does out of range."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import integrate

import rlgcomp as rlg
from rlgcomp.physics.empirical_law import FORMS, MEMORIES, EmpiricalLaw

TIME_S = 20.0 * np.arange(1200.0)
VOLTAGE = 15.0 + 0.03 * np.sin(TIME_S / 900.0) + 0.02 * np.sin(TIME_S / 3100.0 + 1.0)
FIELD = 48.0 + 3.0 * np.cos(TIME_S / 2000.0)


def recording(voltage: np.ndarray = VOLTAGE) -> rlg.Recording:
    table = {
        "time_s": TIME_S[: len(voltage)],
        "gyro_deg_h": 0.0,
        "supply_voltage_V": voltage,
        "magnetic_field_uT": FIELD[: len(voltage)],
    }
    return rlg.Recording(pd.DataFrame(table))


def law(**changes: Any) -> EmpiricalLaw:
    usual: dict[str, Any] = {"driver": "supply_voltage_V", "low": 14.95, "high": 15.05, "at": 15.0, "width": 0.02}
    return EmpiricalLaw(**(usual | {"amplitude_deg_h": 1.0} | changes))


def value(x: float, **changes: Any) -> float:
    """The law at a constant voltage."""
    return float(law(**changes).basis(recording(np.full(50, x)))[-1, 0])


@pytest.mark.parametrize(
    ("form", "expected"),
    [
        ("power", lambda u: (u - 15.0) / 0.05),
        ("above", lambda u: max(0.0, (u - 15.0) / 0.05)),
        ("below", lambda u: max(0.0, (15.0 - u) / 0.05)),
        ("step", lambda u: float(u > 15.0)),
        ("saturation", lambda u: math.tanh((u - 15.0) / 0.02)),
        ("bump", lambda u: math.exp(-((u - 15.0) ** 2) / (2 * 0.02**2))),
        ("resonance", lambda u: 0.02**2 / (0.02**2 + (u - 15.0) ** 2)),
        ("dispersion", lambda u: 2 * 0.02 * (u - 15.0) / (0.02**2 + (u - 15.0) ** 2)),
        ("periodic", lambda u: math.cos(2 * math.pi * (u - 15.0) / 0.02)),
    ],
)
def test_forms_agree_with_their_table(form: str, expected: Any) -> None:
    for u in (14.951, 14.99, 15.003, 15.02, 15.049):
        assert value(u, form=form) == pytest.approx(expected(u), abs=1e-9)


def test_every_form_is_tested() -> None:
    assert len(FORMS) == 9
    for form in FORMS:
        for memory in MEMORIES:
            basis = law(form=form, memory=memory, radius=0.01).basis(recording())
            assert np.isfinite(basis).all()


@pytest.mark.parametrize("exponent", [2, 3])
def test_a_power_goes_on_straight_beyond_its_range(exponent: int) -> None:
    slope = exponent * 1.0 ** (exponent - 1)
    assert value(15.1, exponent=exponent) == pytest.approx(1.0 + slope * 1.0)
    assert value(14.9, exponent=exponent) == pytest.approx((-1.0) ** exponent + slope * (-1.0) ** (exponent - 1) * -1.0)
    assert value(15.0499999, exponent=exponent) == pytest.approx(value(15.0500001, exponent=exponent), abs=3e-5)


def test_local_forms_stay_local_and_saturating_forms_saturate() -> None:
    assert value(16.0, form="bump") < 1e-9
    assert value(16.0, form="resonance") < 1e-3
    assert abs(value(16.0, form="dispersion")) < 0.05
    assert value(16.0, form="saturation") == pytest.approx(1.0)
    assert value(16.0, form="periodic") == pytest.approx(value(15.05, form="periodic"), abs=1e-6)


def test_lag_is_the_differential_equation_it_states() -> None:
    """Against a general solver of ordinary differential equations."""
    tau = 1500.0

    def slope(t: float, y: np.ndarray) -> np.ndarray:
        return (np.interp(t, TIME_S, VOLTAGE) - y) / tau

    solved = integrate.solve_ivp(slope, (0.0, TIME_S[-1]), VOLTAGE[:1], t_eval=TIME_S, rtol=1e-8, atol=1e-10, max_step=20.0)
    found = law(memory="lag", lag_s=tau).basis(recording())[:, 0] * 0.05 + 15.0
    assert found == pytest.approx(solved.y[0], abs=2e-5)


@pytest.mark.parametrize("tau", [30.0, 60.0])
def test_a_late_sensor_is_read_ahead(tau: float) -> None:
    """Of a reading that solves tau du/dt = quantity - u, the law is that of the quantity itself."""
    ramp = 15.0 + 0.04 * np.sin(TIME_S / 1500.0)
    late = integrate.solve_ivp(
        lambda t, y: (np.interp(t, TIME_S, ramp) - y) / tau, (0.0, TIME_S[-1]), ramp[:1], t_eval=TIME_S, rtol=1e-9, max_step=20.0
    ).y[0]
    narrow: dict[str, Any] = {"form": "resonance", "width": 0.004}
    true, as_read, ahead = (
        law(**narrow, **changes).basis(recording(values))[10:-10, 0]
        for values, changes in ((ramp, {}), (late, {}), (late, {"lead_s": tau}))
    )
    assert np.abs(as_read - true).max() > 0.1
    assert ahead == pytest.approx(true, abs=0.02)


def relays(u: np.ndarray, half_widths: np.ndarray, low: float, high: float, levels: int) -> np.ndarray:
    """Mean over relays whose middles lie evenly between two bounds, each switching half_width above and below its middle."""
    middle = low + (high - low) * (np.arange(levels) + 0.5) / levels
    up, down = np.add.outer(half_widths, middle).ravel(), np.add.outer(-half_widths, middle).ravel()
    state = np.where(u[0] >= 0.5 * (up + down), 1.0, -1.0)
    out = np.empty(len(u))
    for k, x in enumerate(u):
        state[x >= up], state[x <= down] = 1.0, -1.0
        out[k] = state.mean()
    return out


@pytest.mark.parametrize("memory", ["play", "plays"])
def test_play_is_the_sum_of_relays(memory: str) -> None:
    """Relays of one width, evenly spread, are a play operator; of exponentially distributed widths, the mean of plays."""
    radius = 0.012
    widths = np.array([radius]) if memory == "play" else -radius * np.log1p(-(np.arange(60) + 0.5) / 60)
    expected = relays(VOLTAGE, widths, 14.7, 15.3, 400) * 0.3 + 15.0
    found = law(memory=memory, radius=radius).basis(recording())[:, 0] * 0.05 + 15.0
    assert np.ptp(expected) > 0.05
    assert found == pytest.approx(expected, abs=2e-3 if memory == "play" else 4e-3)


def test_rate_is_per_minute() -> None:
    ramp = law(memory="rate", low=-1.0, high=1.0, at=0.0).basis(recording(15.0 + 0.001 * TIME_S))[:, 0]
    assert ramp == pytest.approx(0.06)


def test_a_product_of_two_drivers() -> None:
    product = law(driver_2="magnetic_field_uT", low_2=44.0, high_2=52.0, at_2=48.0)
    expected = (VOLTAGE - 15.0) / 0.05 * (FIELD - 48.0) / 4.0
    assert product.basis(recording())[:, 0] == pytest.approx(expected, abs=1e-9)
    assert product.driver_columns(recording()) == ("supply_voltage_V", "magnetic_field_uT")


def test_a_difference_is_taken_of_the_first_factor_and_of_the_second() -> None:
    arms = recording().table.assign(arm_a_mA=3.0, arm_b_mA=1.0, spare_V=5.0)
    table = rlg.Recording(arms)
    straight = law(less="spare_V").basis(table)[:, 0] - law().basis(table)[:, 0]
    assert straight == pytest.approx(-5.0 / 0.05)
    product = law(driver_2="arm_a_mA", less_2="arm_b_mA", low_2=0.0, high_2=1.0, at_2=1.0)
    assert product.basis(table)[:, 0] == pytest.approx(2.0 * law().basis(table)[:, 0])
    assert product.driver_columns(table) == ("supply_voltage_V", "arm_a_mA", "arm_b_mA")


def test_the_noise_of_a_reading_is_averaged_and_an_angle_is_not() -> None:
    time_s = np.arange(600.0)
    values = np.tile([0.0, 1.0], 300)
    table = pd.DataFrame({"time_s": time_s, "gyro_deg_h": 0.0, "supply_voltage_V": values, "table_angle_deg": values})
    for driver, spread in (("supply_voltage_V", 0.05), ("table_angle_deg", 1.0)):
        smooth = law(driver=driver, low=-1.0, high=1.0, at=0.0).basis(rlg.Recording(table))[20:-20, 0]
        assert np.ptp(smooth) == pytest.approx(spread, abs=0.05)


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"amplitude_deg_h": 0.0031}, "b = 0.0031 deg/h * (supply_voltage_V - 15 V) / 0.05 V"),
        (
            {"memory": "play", "radius": 0.02, "amplitude_deg_h": 0.0031},
            "b = 0.0031 deg/h * (play(supply_voltage_V, 0.02 V) - 15 V) / 0.05 V",
        ),
        ({"memory": "lag", "lag_s": 600.0}, "b = 1 deg/h * (lag(supply_voltage_V, 600 s) - 15 V) / 0.05 V"),
        ({"memory": "rate", "at": -0.1}, "b = 1 deg/h * (d/dt supply_voltage_V + 0.1 V/min) / 0.05 V/min"),
        ({"lead_s": 24.3}, "b = 1 deg/h * (ahead(supply_voltage_V, 24.3 s) - 15 V) / 0.05 V"),
        ({"form": "step"}, "b = 1 deg/h * (supply_voltage_V > 15 V)"),
        ({"form": "power", "exponent": 2}, "b = 1 deg/h * ((supply_voltage_V - 15 V) / 0.05 V)^2"),
        (
            {"driver_2": "magnetic_field_uT", "low_2": 44.0, "high_2": 52.0, "at_2": 48.0},
            "b = 1 deg/h * (supply_voltage_V - 15 V) / 0.05 V * (magnetic_field_uT - 48 uT) / 4 uT",
        ),
        ({"driver": "heater_state", "form": "step", "at": 0.5}, "b = 1 deg/h * (heater_state > 0.5)"),
        (
            {"driver_2": "arm_a_mA", "less_2": "arm_b_mA", "low_2": -1.0, "high_2": 1.0, "at_2": 0.0, "less": "spare_V", "at": 0.0},
            "b = 1 deg/h * ((supply_voltage_V - spare_V) - 0 V) / 0.05 V * ((arm_a_mA - arm_b_mA) - 0 mA) / 1 mA",
        ),
    ],
)
def test_it_states_its_equation(changes: dict[str, Any], text: str) -> None:
    assert law(**changes).stated() == text


@pytest.mark.parametrize("form", FORMS)
def test_every_form_states_driver_and_unit(form: str) -> None:
    text = law(form=form).stated()
    assert "supply_voltage_V" in text
    assert " V" in text
    assert "15 V" in text


def test_it_goes_through_a_simulator_file(tmp_path: Path) -> None:
    found = law(memory="lag", lag_s=1234.5, lead_s=12.5, form="saturation", amplitude_deg_h=0.0123)
    before = rlg.Simulator(mechanisms=(found,))
    before.to_yaml(tmp_path / "augmented.yaml")
    after = rlg.Simulator.from_yaml(tmp_path / "augmented.yaml")
    assert after.mechanisms == (found,)
    assert not after.free["empirical_law"]
    assert after.predict(recording()).column("gyro_deg_h") == pytest.approx(0.0123 * found.basis(recording())[:, 0], abs=1e-15)


def test_two_laws_in_one_simulator(tmp_path: Path) -> None:
    one, two = law(amplitude_deg_h=0.01), law(driver="magnetic_field_uT", low=44.0, high=52.0, at=48.0, amplitude_deg_h=0.02)
    simulator = (
        rlg.Simulator().with_mechanism(one).with_mechanism(two).with_mechanism(dataclasses.replace(one, amplitude_deg_h=0.03))
    )
    assert [mechanism.amplitude_deg_h for mechanism in simulator.mechanisms] == [0.02, 0.03]
    simulator.to_yaml(tmp_path / "two.yaml")
    again = rlg.Simulator.from_yaml(tmp_path / "two.yaml")
    assert again.mechanisms == simulator.mechanisms
    run = again.simulate("short", step_s=20.0)
    assert {"empirical_law", "empirical_law_2"} <= set(run.truth.columns)
    assert run.truth.to_numpy().sum(axis=1) == pytest.approx(run.column("gyro_deg_h"))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"driver": ""}, "driver is ''"),
        ({"driver": 3}, "driver is 3"),
        ({"memory": "forever"}, "memory is 'forever'"),
        ({"low": 2.0, "high": 1.0}, "low and high"),
        ({"low_2": 1.0, "high_2": 1.0}, "low_2 and high_2"),
        ({"width": 0.0}, "width is 0.0"),
        ({"less_2": "spare_V"}, "less_2 is 'spare_V' and driver_2 is ''"),
        ({"radius": -1.0}, "radius is -1.0"),
    ],
)
def test_what_makes_no_sense_is_refused(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(rlg.InputError, match=message):
        law(**changes)


def test_a_driver_that_was_not_recorded_is_named() -> None:
    with pytest.raises(rlg.InputError, match="pressure_hPa"):
        law(driver_2="pressure_hPa").basis(recording())


@given(st.floats(-1e6, 1e6), st.sampled_from(FORMS), st.integers(1, 5))
def test_nothing_grows_faster_than_straight(u: float, form: str, exponent: int) -> None:
    found = dataclasses.replace(law(form=form), exponent=exponent)
    x = (u - 15.0) / 0.05
    out = float(found.basis(recording(np.full(3, u)))[-1, 0])
    assert math.isfinite(out)
    assert abs(out) <= 1.0 + 5.0 * max(1.0, abs(x)) * (1.0 + 1e-9)


def test_a_recording_beyond_the_range_of_a_law_has_a_remark() -> None:
    time_s = np.arange(2000.0)
    table = pd.DataFrame({"time_s": time_s, "gyro_deg_h": 0.0 * time_s, "supply_voltage_V": 12.0 + 0.1 * np.sin(time_s / 200.0)})
    run = rlg.Recording(table, name="run")
    law = EmpiricalLaw(driver="supply_voltage_V", low=11.9, high=12.1, at=12.0)
    assert law.extrapolation(run) == ()
    (remark,) = law.extrapolation(run.replace(table=table.assign(supply_voltage_V=table["supply_voltage_V"] + 3.0)))
    assert remark.code == "simulation.law_extrapolated"
    assert remark.data["quantity"] == "supply_voltage_V"
    assert remark.data["recorded"] == pytest.approx([14.9, 15.1], abs=1e-3)
    assert remark.data["learnt"] == [11.9, 12.1]
    assert rlg.CATALOGUE["supply_voltage"]().extrapolation(run) == ()


def test_lags_of_less_than_a_second_are_laws_too() -> None:
    assert EmpiricalLaw(memory="lag", lag_s=0.4).lag_s == 0.4


def test_a_middle_that_is_nought_but_for_rounding_is_printed_as_nought() -> None:
    of_rate = EmpiricalLaw(memory="rate", form="above", low=-0.5, high=0.5, at=3.5e-15, amplitude_deg_h=0.002)
    assert " - 0 degC/min" in of_rate.stated()
    assert " - 0.1 degC/min" in dataclasses.replace(of_rate, at=0.1).stated()
    assert " + 0.1 degC/min" in dataclasses.replace(of_rate, at=-0.1).stated()
