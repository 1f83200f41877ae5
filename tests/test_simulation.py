"""Simulation: programmes, plant, monitors, and the simulator."""

from __future__ import annotations

import contextlib
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

import rlgcomp as rlg
from rlgcomp.noise.processes import NOISES
from rlgcomp.simulation.monitors import Beams, Monitors, Readout, gauss_markov
from rlgcomp.simulation.plant import (
    PlatinumThermometer,
    ThermalPlant,
    platinum_resistance_ohm,
    platinum_temperature_degC,
)
from rlgcomp.simulation.programme import PRESETS


class TestProgramme:
    def test_the_papers_takes_680_min(self) -> None:
        """120+60+120+100+120+40+120 min: 408 means of 100 s, breaks at 72, 108, 180, 240(*), 312, 336, 408."""
        programme = rlg.Programme.parse("paper")
        times, temperatures = programme.corners
        assert programme.duration_s == 680 * 60
        assert (times / 100.0).tolist() == [0, 72, 108, 180, 240, 312, 336, 408]
        assert temperatures.tolist() == [20, 20, -40, -40, 60, 60, 20, 20]

    @pytest.mark.parametrize("name", PRESETS)
    def test_text_and_back(self, name: str) -> None:
        programme = rlg.Programme.parse(name)
        assert rlg.Programme.parse(str(programme)) == programme

    def test_set_point_runs_straight(self) -> None:
        programme = rlg.Programme.parse("start 10, ramp 40 2, hold 5")
        assert programme.set_point_degC([0, 450, 900, 1200, 9999]).tolist() == [10, 25, 40, 40, 40]

    def test_from_a_file(self, tmp_path: Path) -> None:
        (tmp_path / "p.yaml").write_text("programme: start 10, hold 5\n")
        assert rlg.Programme.parse(str(tmp_path / "p.yaml")).duration_s == 300

    @pytest.mark.parametrize(
        "text",
        [
            "",
            "nonsense",
            "hold 5",
            "start 20",
            "start x, hold 5",
            "start 20, hold -5",
            "start 20, hold nan",
            "start 20, ramp 40",
            "start 20, ramp 40 0",
            "start 20, ramp 40 99",
            "start 20, ramp 300 1",
            "start 20, ramp 20 1",
            "absent.yaml",
        ],
    )
    def test_what_no_chamber_can_do_is_refused(self, text: str) -> None:
        with pytest.raises(rlg.InputError, match="programme"):
            rlg.Programme.parse(text)

    @given(st.text(max_size=40))
    def test_any_text_is_a_programme_or_refused(self, text: str) -> None:
        with contextlib.suppress(rlg.InputError):
            assert rlg.Programme.parse(text).duration_s > 0


class TestPlant:
    def test_it_solves_its_equations(self) -> None:
        """Against an adaptive integrator of order 8, within 1e-6 K."""
        plant, programme = ThermalPlant(), rlg.Programme.parse("start 20, hold 10, ramp -10 1, hold 20")
        time_s = np.arange(0.0, programme.duration_s, 10.0)
        shell, block = plant.temperatures(programme.set_point_degC(time_s), 10.0)

        def rhs(t: float, state: np.ndarray) -> list[float]:
            air, s, b = state
            into_shell_W = plant.chamber_shell_W_K * (air - s) + plant.shell_block_W_K * (b - s) + plant.electronics_W
            into_block_W = plant.shell_block_W_K * (s - b) + plant.discharge_W
            return [
                (float(programme.set_point_degC(t)) - air) / plant.chamber_time_constant_s,
                into_shell_W / plant.shell_capacity_J_K,
                into_block_W / plant.block_capacity_J_K,
            ]

        exact = solve_ivp(rhs, (0, time_s[-1]), [20.0] * 3, method="DOP853", t_eval=time_s, rtol=1e-10, atol=1e-9, max_step=10.0)
        assert shell == pytest.approx(exact.y[1], abs=1e-6)
        assert block == pytest.approx(exact.y[2], abs=1e-6)

    def test_self_heating_settles_at_the_heat_balance(self) -> None:
        plant = ThermalPlant()
        shell, block = plant.temperatures(np.full(100_000, 20.0), 10.0)
        assert shell[-1] == pytest.approx(20.0 + (plant.electronics_W + plant.discharge_W) / plant.chamber_shell_W_K, abs=1e-6)
        assert block[-1] - shell[-1] == pytest.approx(plant.discharge_W / plant.shell_block_W_K, abs=1e-6)

    @pytest.mark.parametrize("values", [{"shell_capacity_J_K": 0.0}, {"discharge_W": -1.0}, {"shell_block_W_K": float("nan")}])
    def test_impossible_plants_are_refused(self, values: dict[str, float]) -> None:
        with pytest.raises(rlg.InputError, match="plant"):
            ThermalPlant(**values)

    @given(st.floats(-180.0, 500.0))
    def test_platinum_and_back(self, temperature_degC: float) -> None:
        assert platinum_temperature_degC(platinum_resistance_ohm(temperature_degC)) == pytest.approx(temperature_degC, abs=2e-4)

    def test_platinum_of_the_standard(self) -> None:
        """IEC 60751, table 1."""
        expected_ohm = [60.26, 84.27, 100.0, 107.79, 123.24, 138.51]
        assert platinum_resistance_ohm([-100, -40, 0, 20, 60, 100]) == pytest.approx(expected_ohm, abs=0.005)

    def test_a_thermometer_lags_errs_and_rounds(self) -> None:
        rng = np.random.default_rng(0)
        time_s = np.arange(4000.0)
        thermometer = PlatinumThermometer(time_constant_s=20.0, noise_K=0.003, resolution_K=0.002, tolerance=1.0)
        reading = thermometer.read(0.01 * time_s, time_s, rng)
        offset = 0.15 + 0.002 * 0.01 * (time_s - 20.0)
        error = (reading - (0.01 * (time_s - 20.0) + offset))[200:]
        assert abs(error.mean()) < 2e-4
        assert error.std() == pytest.approx(np.hypot(0.003, 0.002 / np.sqrt(12)), rel=0.05)


class TestReadout:
    """A common shift changes the difference; an opposite shift and an angle do not."""

    def test_small_halves_follow_the_closed_form(self) -> None:
        readout = Readout(half_centre_m=0.3e-3, half_width_m=1e-6, fringe_angle_rad=0.0)
        shift = np.array([-50e-6, 5e-6, 100e-6])
        a, b = readout.rms_V(shift, shift)
        assert (a - b) / (a + b) == pytest.approx(np.tanh(4 * 0.3e-3 * shift / 0.5e-3**2), rel=1e-5)

    def test_a_common_shift_is_seen_and_half_of_it_with_one_beam(self) -> None:
        shift, still = np.array([10e-6]), np.zeros(1)
        a, b = Readout().rms_V(shift, shift)
        one_a, one_b = Readout().rms_V(shift, still)
        both, one = float(((a - b) / (a + b))[0]), float(((one_a - one_b) / (one_a + one_b))[0])
        small_halves = float(np.tanh(4 * 0.3e-3 * 10e-6 / 0.5e-3**2))
        assert 0.6 * small_halves < both < small_halves
        assert one == pytest.approx(0.5 * both, rel=1e-3)

    def test_an_opposite_shift_lowers_both_halves_alike(self) -> None:
        shift = np.array([40e-6])
        a, b = Readout().rms_V(shift, -shift)
        assert a == pytest.approx(b, rel=1e-12)
        assert a[0] == pytest.approx(np.exp(-(80e-6**2) / (2 * 0.5e-3**2)), rel=1e-9)

    def test_an_angle_leaves_the_difference_of_centred_beams_at_zero(self) -> None:
        a, b = Readout(fringe_angle_rad=300e-6).rms_V(np.zeros(1), np.zeros(1))
        assert a == pytest.approx(b, rel=1e-12)

    def test_power_cancels_in_the_relative_difference(self) -> None:
        shift = np.array([20e-6])
        a, b = Readout().rms_V(shift, shift)
        dim_a, dim_b = Readout().rms_V(shift, shift, 0.7, 0.5)
        assert (dim_a - dim_b) / (dim_a + dim_b) == pytest.approx((a - b) / (a + b), rel=1e-12)
        assert dim_a == pytest.approx(np.sqrt(0.35) * a)

    def test_an_integral_over_the_detector_is_the_referee(self) -> None:
        """RMS over time of the fringe pattern integrated over a half, by brute force."""
        readout, shift = Readout(), np.array([15e-6])
        x = np.linspace(0.3e-3 - 0.25e-3, 0.3e-3 + 0.25e-3, 4001)
        phases = np.linspace(0, 2 * np.pi, 400, endpoint=False)
        envelope = np.exp(-2 * (x - 15e-6) ** 2 / 0.5e-3**2)
        carrier = 2 * np.pi * 200e-6 * x / 632.8e-9
        signals = np.array([np.trapezoid(envelope * np.cos(phase + carrier), x) for phase in phases])
        centred = np.array([np.trapezoid(np.exp(-2 * x**2 / 0.5e-3**2) * np.cos(phase + carrier), x) for phase in phases])
        a, _ = readout.rms_V(shift, shift)
        assert a[0] == pytest.approx(signals.std() / centred.std(), rel=1e-6)


class TestMonitors:
    def test_wander_has_its_size_and_memory(self) -> None:
        series = np.array([gauss_markov(2.0, 100.0, np.arange(5000.0), np.random.default_rng(seed)) for seed in range(40)])
        assert series.std() == pytest.approx(2.0, rel=0.05)
        assert np.mean(series[:, :-100] * series[:, 100:]) / 4.0 == pytest.approx(np.exp(-1.0), abs=0.06)

    def test_mutations_come_only_while_temperature_moves(self) -> None:
        beams = Beams(mutations_per_100_K=40.0, wander_um=0.0, shift_um_K=0.0, slip_um_K=0.0, opposite_um_K=0.0)
        time_s = np.arange(20_000.0)
        block = np.interp(time_s, [0, 8000, 12_000, 20_000], [20, 20, -40, -40])
        cw, ccw = beams.shifts_m(block, time_s, 1)
        assert not cw[:7900].any()
        assert np.abs(np.diff(cw))[8000:12_000].max() > 1e-6
        assert np.abs(np.diff(cw))[12_100:].max() < 1e-8  # only creep
        assert np.array_equal(cw, ccw)

    def test_readings_are_near_the_quantities(self) -> None:
        actual, recorded = Monitors().simulate(rlg.Programme.parse("short"), 5.0, 2)
        assert list(actual) == list(recorded)
        noise = {"supply_voltage_V": 1e-3, "discharge_current_a_mA": 3e-4, "magnetic_field_uT": 0.02, "pressure_hPa": 0.03}
        for name, sd in noise.items():
            assert (recorded[name] - actual[name]).std() == pytest.approx(sd, rel=0.1)
        assert np.abs(recorded["temperature_block_degC"] - actual["temperature_block_degC"]).max() < 0.5


class TestSimulator:
    def test_the_truth_sums_to_the_gyro(self, short_runs: list[rlg.Recording]) -> None:
        run = short_runs[0]
        assert run.truth.sum(axis=1).to_numpy() == pytest.approx(run.column("gyro_deg_h"), abs=1e-15)
        assert set(run.truth) >= {"readout_incoherence", "thermal_hysteresis", "angle_random_walk"}

    def test_leaving_a_mechanism_out_leaves_the_rest_bit_identical(self, unit: rlg.Simulator) -> None:
        whole = unit.simulate("short", seed=4, step_s=20.0)
        for mechanism in unit.mechanisms:
            less = unit.without(mechanism.name).simulate("short", seed=4, step_s=20.0)
            pd.testing.assert_frame_equal(less.truth, whole.truth.drop(columns=mechanism.name), check_exact=True)
            monitors = [column for column in whole.columns if column != "gyro_deg_h"]
            pd.testing.assert_frame_equal(less.table[monitors], whole.table[monitors], check_exact=True)

    def test_the_order_of_mechanisms_does_not_matter(self, unit: rlg.Simulator) -> None:
        backwards = rlg.Simulator(unit.mechanisms[::-1], noise=unit.noise, monitors=unit.monitors)
        one, other = unit.simulate("short", seed=4, step_s=20.0), backwards.simulate("short", seed=4, step_s=20.0)
        assert other.rate_deg_h() == pytest.approx(one.rate_deg_h(), abs=1e-15)
        pd.testing.assert_frame_equal(other.truth[list(one.truth)], one.truth, check_exact=True)

    def test_another_seed_is_another_run_of_the_same_gyro(self, unit: rlg.Simulator) -> None:
        one, other = (unit.simulate("short", seed=seed, step_s=20.0) for seed in (1, 2))
        assert np.array_equal(one.truth["thermal_polynomial"], other.truth["thermal_polynomial"])
        assert not np.array_equal(one.truth["angle_random_walk"], other.truth["angle_random_walk"])

    def test_a_prediction_is_the_simulation_without_noise(self, unit: rlg.Simulator) -> None:
        """The recorded monitors differ from the actual by sensor noise only: a hundredth of the bias."""
        run = unit.simulate("short", seed=4, step_s=5.0)
        expected = run.truth.drop(columns=[name for name in NOISES if name in run.truth]).sum(axis=1)
        predicted = unit.predict(run)
        assert len(predicted) == len(run)
        error = predicted.averaged().rate_deg_h() - run.replace(table=run.table.assign(gyro_deg_h=expected)).averaged().rate_deg_h()
        assert np.std(error) < 0.02 * expected.std()
        assert np.array_equal(unit.expected_deg_h(run), predicted.rate_deg_h())
        parts = [rlg.Simulator((mechanism,)).expected_deg_h(run) for mechanism in unit.mechanisms]
        assert np.array_equal(unit.expected_deg_h(run), sum(parts))

    def test_runs_are_named_by_programme_and_seed(self, unit: rlg.Simulator, tmp_path: Path) -> None:
        (tmp_path / "soak.yaml").write_text("programme: start 20, hold 30\n")
        programmes = ("short", rlg.Programme.parse("short"), "start 20, hold 30", str(tmp_path / "soak.yaml"))
        names = [unit.simulate(programme, seed=2, step_s=60.0).name for programme in programmes]
        assert names == ["short-2", "short-2", "simulated-2", "soak-2"]
        assert unit.simulate("short", step_s=60.0, name="mine").name == "mine"

    def test_telegraph_noise_cannot_be_predicted(self) -> None:
        simulator = rlg.Simulator((rlg.CATALOGUE["random_telegraph"](),))
        assert not simulator.predict(simulator.simulate("short", step_s=20.0)).rate_deg_h().any()

    def test_without_mechanisms_and_noise_the_gyro_is_zero(self) -> None:
        assert not rlg.Simulator(noise=rlg.NoiseModel()).simulate("short", step_s=20.0).rate_deg_h().any()


class TestSimulatorFile:
    def test_file_and_back(self, unit: rlg.Simulator, tmp_path: Path) -> None:
        unit.to_yaml(tmp_path / "unit.yaml")
        again = rlg.Simulator.from_yaml(tmp_path / "unit.yaml")
        assert again.mechanisms == unit.mechanisms
        assert (again.noise, again.monitors, again.unit) == (unit.noise, unit.monitors, unit.unit)

    def test_the_contracts_example(self) -> None:
        content = yaml.safe_load(
            "kind: chamber\nmechanisms:\n  - thermal_polynomial: {degree: 3}\n  - temperature_rate\n"
            "  - thermal_hysteresis: {radius_K: 9, k1_deg_h_K: {value: 0.001, free: true}}\n"
            "noise: {angle_random_walk_deg_sqrt_h: 0.0003}\n"
        )
        simulator = rlg.Simulator.from_mapping(content)
        hysteresis = simulator.mechanisms[2]
        assert (hysteresis.radius_K, hysteresis.k1_deg_h_K) == (9, 0.001)
        assert simulator.free["thermal_hysteresis"] == {"k1_deg_h_K", "k2_deg_h_K", "k3_deg_h_K"}
        assert simulator.free["temperature_rate"] == {"k_deg_h_min_K"}
        assert rlg.Simulator.from_mapping(simulator.to_mapping()) == simulator

    @pytest.mark.parametrize("entry", ["free", {"free": True}, {"value": 0.005, "unit": "deg/h per K/min", "free": True}])
    def test_free_is_written_in_several_ways(self, entry: object) -> None:
        item = {"temperature_rate": {"k_deg_h_min_K": entry}}
        made = rlg.Simulator.from_mapping({"kind": "chamber", "mechanisms": [item]})
        assert made.free["temperature_rate"] == {"k_deg_h_min_K"}

    @pytest.mark.parametrize(
        "entry", [{"value": 0.005, "free": "maybe"}, {"value": 0.005, "unit": "deg/s"}, "maybe", {"valu": 1.0}]
    )
    def test_malformed_entries_are_refused(self, entry: object) -> None:
        item = {"temperature_rate": {"k_deg_h_min_K": entry}}
        with pytest.raises(rlg.InputError, match="temperature_rate: k_deg_h_min_K"):
            rlg.Simulator.from_mapping({"kind": "chamber", "mechanisms": [item]})

    def test_amplitudes_that_are_not_in_use_are_not_listed(self) -> None:
        cubic = rlg.Simulator.from_mapping({"kind": "chamber", "mechanisms": ["thermal_polynomial"]})
        assert set(cubic.to_mapping()["mechanisms"][0]["thermal_polynomial"]) == {
            *("c0_deg_h", "c1_deg_h_K", "c2_deg_h_K2", "c3_deg_h_K3", "degree", "reference_degC")
        }
        assert rlg.Simulator.from_mapping(cubic.to_mapping()) == cubic
        content = {"kind": "chamber", "mechanisms": [{"thermal_polynomial": {"c4_deg_h_K4": 1e-9}}]}
        assert rlg.Simulator.from_mapping(content).to_mapping()["mechanisms"][0]["thermal_polynomial"]["c4_deg_h_K4"] == 1e-9

    @pytest.mark.parametrize(
        ("content", "message"),
        [
            ("mechanisms: [warp_drive]", "'warp_drive' is not in the catalogue"),
            ("mechanisms: [temperature_rate, temperature_rate]", "listed twice"),
            ("mechanisms: {temperature_rate: 1}", "must be a list"),
            ("mechanisms: [temperature_rate: {speed: 1}]", "unknown 'speed'"),
            ("mechanisms: [thermal_lag: {time_constant_s: -1}]", "time_constant_s is -1"),
            ("mechanisms: [thermal_lag: {time_constant_s: {worth: 3}}]", "write a number"),
            ("mechanisms: [[1, 2]]", "not understood"),
            ("noise: {loudness: 1}", "unknown 'loudness'"),
            ("noise: loud", "noise: is 'loud'"),
            ("plant: {size: 1}", "plant: unknown size"),
            ("beams: {shift_um_K: wide}", "beams: shift_um_K"),
            ("colour: red", "unknown section colour"),
            ("kind: oven", "kind is 'oven'"),
            ("- a\n- list", "expected 'kind: chamber'"),
            ("a: [1", "not readable as YAML"),
        ],
    )
    def test_a_wrong_file_is_refused(self, tmp_path: Path, content: str, message: str) -> None:
        (tmp_path / "sim.yaml").write_text(content)
        with pytest.raises(rlg.InputError, match=message):
            rlg.Simulator.from_yaml(tmp_path / "sim.yaml")

    def test_an_absent_file(self) -> None:
        with pytest.raises(rlg.InputError, match="does not exist"):
            rlg.Simulator.from_yaml("absent.yaml")


def test_units_differ_and_repeat() -> None:
    assert rlg.simulated_unit(3) == rlg.simulated_unit(3)
    assert rlg.simulated_unit(3).mechanisms != rlg.simulated_unit(4).mechanisms


def test_units_are_like_the_papers() -> None:
    """Raw bias stability of the paper's programme: 0.0157 deg/h published; the mean of ten drawn units lies within a factor 1.3."""
    runs = [rlg.simulated_unit(seed).simulate("paper", step_s=5.0, seed=seed) for seed in range(10)]
    spread = [run.averaged().rate_deg_h().std(ddof=1) for run in runs]
    assert 0.0157 / 1.3 < np.mean(spread) < 0.0157 * 1.3
