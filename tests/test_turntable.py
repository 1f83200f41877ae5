"""Turntable programmes, the simulator of kind turntable, and what only each of its mechanisms does."""

from __future__ import annotations

import contextlib
import dataclasses
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import solve_ivp
from typer.testing import CliRunner

import rlgcomp as rlg
from rlgcomp.cli import register_commands
from rlgcomp.cli.base import app
from rlgcomp.noise.processes import stream
from rlgcomp.physics.lock_in import LockIn
from rlgcomp.physics.rotation_harmonics import RotationHarmonics
from rlgcomp.physics.scale_factor import ScaleFactor
from rlgcomp.recording.motion import averaged_at_rest
from rlgcomp.simulation.table_programme import PRESETS, TableProgramme
from rlgcomp.simulation.turntable import Turntable

TURNTABLE = tuple(mechanism for mechanism in rlg.CATALOGUE.values() if mechanism.kind == "turntable")
QUIET = rlg.NoiseModel()
COUNTS_PER_RAD = 91_237.0  # S = 4A / (lambda L) of a triangle of 0.3 m: counts per rad


def of(*mechanisms: rlg.Mechanism, **fields: object) -> rlg.Simulator:
    return rlg.Simulator(mechanisms, kind="turntable", noise=QUIET, **fields)


@pytest.fixture(scope="module")
def everything() -> rlg.Simulator:
    return rlg.Simulator(tuple(mechanism() for mechanism in TURNTABLE), kind="turntable", table=Turntable(latitude_deg=48.0))


class TestProgramme:
    @pytest.mark.parametrize("name", PRESETS)
    def test_text_and_back(self, name: str) -> None:
        programme = TableProgramme.parse(name)
        assert TableProgramme.parse(str(programme)) == programme

    def test_rates_are_reached_at_the_stated_acceleration(self) -> None:
        times, rates = TableProgramme.parse("acceleration 5, rate 10 60, rate -10 60, rest 30, sweep 1 -1 100").corners
        assert times.tolist() == [0, 2, 62, 66, 126, 128, 158, 158.2, 258.2, 258.4]
        assert rates.tolist() == [0, 10, 10, -10, -10, 0, 0, 1, -1, 0]

    def test_the_angle_is_the_integral_of_the_rate(self) -> None:
        programme = TableProgramme.parse("rate 10 60, sweep 3 -20 100, rest 5")
        fine_s = np.linspace(0.0, programme.duration_s, 100_001)
        rate = np.interp(fine_s, *programme.corners)
        expected = np.concatenate([[0.0], np.cumsum(0.5 * (rate[1:] + rate[:-1]) * np.diff(fine_s))])
        assert programme.angle_deg(fine_s) == pytest.approx(expected, abs=1e-4)

    def test_from_a_file(self, tmp_path: Path) -> None:
        (tmp_path / "p.yaml").write_text("programme: rate 10 60\n")
        assert TableProgramme.parse(str(tmp_path / "p.yaml")) == TableProgramme.parse("rate 10 60")

    @pytest.mark.parametrize(
        "text",
        [
            "",
            "nonsense",
            "rate 10",
            "rate 10 60 5",
            "rate x 60",
            "rate 10 -60",
            "rate nan 60",
            "rate 1e9 60",
            "rest 0",
            "sweep 1 60",
            "rate 10 60, acceleration 5",
            "acceleration 0, rate 10 60",
            "acceleration 5",
            "absent.yaml",
        ],
    )
    def test_what_no_table_can_do_is_refused(self, text: str) -> None:
        with pytest.raises(rlg.InputError, match="programme"):
            TableProgramme.parse(text)

    @given(st.text(max_size=40))
    def test_any_text_is_a_programme_or_refused(self, text: str) -> None:
        with contextlib.suppress(rlg.InputError):
            assert TableProgramme.parse(text).duration_s > 0


class TestSimulator:
    def test_the_truth_sums_to_the_error(self, everything: rlg.Simulator) -> None:
        """To the last digits of a gyro in deg/s: 1e-16 of 30 deg/s is 1e-11 deg/h."""
        run = everything.simulate("short-turns", seed=2)
        vertical = 15.041067 * np.sin(np.radians(48.0))
        error = run.rate_deg_h() - 3600.0 * run.column("table_rate_deg_s") - vertical
        assert run.truth.sum(axis=1).to_numpy() == pytest.approx(error, abs=3e-4)  # half a step of the recorded rate
        assert set(run.truth) == {mechanism.name for mechanism in TURNTABLE} | {"angle_random_walk"}
        assert (run.metadata.kind, run.metadata.latitude_deg, run.gyro_columns) == ("turntable", 48.0, ("gyro_deg_s",))

    def test_a_perfect_gyro_shows_the_rate(self) -> None:
        run = of().simulate("short-turns", step_s=0.1)
        assert run.rate_deg_h() == pytest.approx(3600.0 * run.column("table_rate_deg_s"), abs=3e-4)
        assert of().nominal_deg_h(run) == pytest.approx(run.rate_deg_h(), abs=3e-4)
        turned = np.cumsum(run.column("gyro_deg_s")) * 0.1
        encoder = np.unwrap(run.column("table_angle_deg"), period=360.0)
        assert turned - turned[0] == pytest.approx(encoder - encoder[0], abs=1e-4)

    def test_a_chamber_has_no_rate(self) -> None:
        assert not rlg.Simulator().nominal_deg_h(rlg.Simulator().simulate("short", step_s=20.0)).any()

    def test_leaving_a_mechanism_out_leaves_the_rest_bit_identical(self, everything: rlg.Simulator) -> None:
        """But for lock-in, which acts on what the others make of the rate."""
        whole = everything.simulate("short-turns", seed=4)
        for mechanism in everything.mechanisms:
            less = everything.without(mechanism.name).simulate("short-turns", seed=4)
            rest = whole.truth.drop(columns={mechanism.name, "lock_in"})
            pd.testing.assert_frame_equal(less.truth[list(rest)], rest, check_exact=True)
            monitors = [column for column in whole.columns if column != "gyro_deg_s"]
            pd.testing.assert_frame_equal(less.table[monitors], whole.table[monitors], check_exact=True)

    def test_the_order_of_mechanisms_does_not_matter(self, everything: rlg.Simulator) -> None:
        backwards = dataclasses.replace(everything, mechanisms=everything.mechanisms[::-1])
        one, other = everything.simulate("short-turns", seed=4), backwards.simulate("short-turns", seed=4)
        assert other.rate_deg_h() == pytest.approx(one.rate_deg_h(), abs=1e-9)
        pd.testing.assert_frame_equal(other.truth[list(one.truth)], one.truth, check_exact=False, rtol=0, atol=1e-9)

    def test_a_prediction_is_the_simulation_without_noise(self, everything: rlg.Simulator) -> None:
        """From rate and angle, from the angle alone, and in the gyro's own unit; the encoder's step of 0.1 arcsec is 0.05 deg/h."""
        quiet = dataclasses.replace(everything, noise=QUIET)
        run = quiet.simulate("short-turns", seed=4)
        assert quiet.predict(run).rate_deg_h() == pytest.approx(run.rate_deg_h(), abs=0.05)
        angle_only = run.replace(table=run.table.drop(columns="table_rate_deg_s"))
        assert quiet.predict(angle_only).rate_deg_h()[1:] == pytest.approx(run.rate_deg_h()[1:], abs=0.2)
        per_hour = run.replace(table=run.table.drop(columns="gyro_deg_s").assign(gyro_deg_h=run.rate_deg_h()))
        assert quiet.predict(per_hour).gyro_columns == ("gyro_deg_h",)
        assert quiet.predict(per_hour).rate_deg_h() == pytest.approx(quiet.predict(run).rate_deg_h(), abs=1e-9)

    def test_the_prediction_holds_the_earth_where_it_is_known(self) -> None:
        run = of(table=Turntable(latitude_deg=90.0)).simulate("rest 60")
        assert of().predict(run).rate_deg_h() == pytest.approx(np.full(60, 15.041067), abs=1e-5)

    def test_a_simulator_predicts_no_run_of_the_other_kind(self) -> None:
        with pytest.raises(rlg.InputError, match="has no motion of the table"):
            of(ScaleFactor()).predict(rlg.Simulator().simulate("short", step_s=20.0))
        with pytest.raises(rlg.InputError, match="one of its own kind"):
            rlg.Simulator().simulate(TableProgramme.parse("rest 60"))
        with pytest.raises(rlg.InputError, match="belong to the other kind"):
            rlg.Simulator((ScaleFactor(),))

    def test_too_short_a_programme_is_refused(self) -> None:
        with pytest.raises(rlg.InputError, match="less than ten samples"):
            of().simulate("rest 5")

    @pytest.mark.parametrize(
        "values", [{"warm_up_s": 0.0}, {"encoder_arcsec": -1.0}, {"room_degC": float("nan")}, {"start_deg": "a"}]
    )
    def test_impossible_tables_are_refused(self, values: dict[str, float]) -> None:
        with pytest.raises(rlg.InputError, match="table"):
            Turntable(**values)


class TestFiles:
    def test_a_simulator_file_and_back(self, everything: rlg.Simulator, tmp_path: Path) -> None:
        everything.to_yaml(tmp_path / "table.yaml")
        again = rlg.Simulator.from_yaml(tmp_path / "table.yaml")
        assert (again.mechanisms, again.table, again.kind) == (everything.mechanisms, everything.table, "turntable")

    def test_the_contracts_names(self) -> None:
        text = "kind: turntable\nmechanisms:\n  - scale_factor\n  - lock_in: {lock_in_deg_s: 0.05}\ntable: {latitude_deg: 51}\n"
        simulator = rlg.Simulator.from_mapping(yaml.safe_load(text))
        assert simulator.free["scale_factor"] == {"k_ppm", "bias_deg_h"}
        assert simulator.table.latitude_deg == 51
        assert rlg.Simulator.from_mapping(simulator.to_mapping()) == simulator

    @pytest.mark.parametrize("suffix", [".parquet", ".csv", ".h5", ".mat"])
    def test_a_recording_comes_back(self, everything: rlg.Simulator, tmp_path: Path, suffix: str) -> None:
        run = everything.simulate("short-turns", seed=1)
        rlg.write(run, tmp_path / f"run{suffix}")
        again = rlg.read(tmp_path / f"run{suffix}")
        rest = run.table.drop(columns="table_angle_deg")
        pd.testing.assert_frame_equal(again.table[list(rest)], rest, check_exact=True)
        turned = again.column("table_angle_deg") - run.column("table_angle_deg")  # read without its wrap
        assert turned == pytest.approx(360.0 * np.rint(turned / 360.0), abs=1e-9)
        assert again.metadata.to_mapping() == run.metadata.to_mapping()

    def test_a_file_with_a_table_in_it_is_of_a_turntable(self, tmp_path: Path) -> None:
        of().simulate("short-turns").table.to_csv(tmp_path / "bare.csv", index=False)
        assert rlg.read(tmp_path / "bare.csv").metadata.kind == "turntable"
        (tmp_path / "bare.yaml").write_text("kind: chamber\n")
        assert rlg.read(tmp_path / "bare.csv").metadata.kind == "chamber"

    def test_commands_serve_both_kinds(self, tmp_path: Path) -> None:
        register_commands()
        (tmp_path / "table.yaml").write_text("kind: turntable\nmechanisms: [scale_factor: {k_ppm: 20}, lock_in]\n")
        sim, run, out = (str(tmp_path / name) for name in ("table.yaml", "run.csv", "out.csv"))
        made = CliRunner().invoke(app, ["simulate", sim, "--profile", "rate 10 60, rate -10 60", "--seed", "3", "--out", run])
        assert made.exit_code == 0, made.output
        done = CliRunner().invoke(app, ["predict", sim, run, "--out", out])
        assert done.exit_code == 0, done.output
        recorded, predicted = rlg.read(run), rlg.read(out)
        assert len(recorded) == len(predicted)
        assert np.std(recorded.rate_deg_h() - predicted.rate_deg_h()) < 0.03
        wrong = CliRunner().invoke(app, ["simulate", sim, "--profile", "start 20, hold 60", "--out", run])
        assert wrong.exit_code == 2


def beat_deg_s(rate_deg_s: float, lock_in_deg_s: float, seconds: float) -> float:
    """Mean output of the phase equation psi' = 2 pi S (W - W_L sin psi), integrated."""
    scale = 2.0 * np.pi * COUNTS_PER_RAD
    w, lock = np.radians(rate_deg_s), np.radians(lock_in_deg_s)
    solved = solve_ivp(
        lambda _, psi: scale * (w - lock * np.sin(psi)), (0.0, seconds), [0.3], method="DOP853", rtol=1e-9, atol=1e-9
    )
    return float(np.degrees((solved.y[0, -1] - 0.3) / (scale * seconds)))


class TestLockIn:
    @pytest.mark.parametrize("rate", [0.02, -0.049, 0.051, 0.06, -0.1, 0.3])
    def test_the_phase_equation_is_the_referee(self, rate: float) -> None:
        """Over 2 s a part of a fringe remains: 1 / (2 S) rad in 2 s, 1.6e-4 deg/s."""
        table = {"time_s": np.arange(3.0), "gyro_deg_s": np.zeros(3), "table_rate_deg_s": np.full(3, rate)}
        error = LockIn(lock_in_deg_s=0.05).contribution(rlg.Recording(pd.DataFrame(table)), stream(0, "lock_in"))[1]
        assert rate + error / 3600.0 == pytest.approx(beat_deg_s(rate, 0.05, 2.0), abs=1.6e-4)

    def test_far_above_only_the_square_counts(self) -> None:
        """-W_L² / 2W: 12.5 ppm at 10 deg/s for 0.05 deg/s."""
        table = {"time_s": np.arange(3.0), "gyro_deg_s": np.zeros(3), "table_rate_deg_s": np.array([10.0, -10.0, 60.0])}
        error = LockIn(lock_in_deg_s=0.05).basis(rlg.Recording(pd.DataFrame(table)))[:, 0]
        assert error / (3600.0 * table["table_rate_deg_s"]) == pytest.approx(
            -0.5 * (0.05 / table["table_rate_deg_s"]) ** 2, rel=1e-4
        )
        other = dataclasses.replace(LockIn(lock_in_deg_s=0.01), fraction=25.0)
        assert 25.0 * other.basis(rlg.Recording(pd.DataFrame(table)))[:, 0] == pytest.approx(error, rel=1e-4)
        assert (other.canonical().lock_in_deg_s, other.canonical().fraction) == (pytest.approx(0.05), 1.0)

    def test_it_locks_the_bias_with_the_rest(self) -> None:
        """A table at rest: the gyro shows neither its bias nor the Earth."""
        table = Turntable(latitude_deg=60.0)
        run = of(ScaleFactor(bias_deg_h=5.0), LockIn(lock_in_deg_s=0.05), table=table).simulate("rest 60, rate 5 60")
        assert np.abs(run.rate_deg_h()[:59]).max() < 1e-9
        free = of(ScaleFactor(bias_deg_h=5.0), LockIn(lock_in_deg_s=0.05, acts_on="table"), table=table).simulate("rest 60")
        assert free.rate_deg_h() == pytest.approx(np.full(60, 5.0 + 15.041067 * np.sin(np.pi / 3.0)), abs=1e-5)

    def test_the_grid_contains_the_simulators_effect(self) -> None:
        """With the offset read off the recording, the column on the bare table rate is what the simulator adds."""
        truth = LockIn(lock_in_deg_s=0.05)
        run = of(ScaleFactor(bias_deg_h=8.0), truth).simulate("rest 300, rate 1 300, rate -1 300, rate 20 300, rate -20 300")
        tried = LockIn.grid((run,))
        assert sorted({mechanism.offset_deg_h for mechanism in tried}) == pytest.approx([0.0, 8.0], abs=0.05)
        nearest = min(tried, key=lambda m: (abs(np.log(m.lock_in_deg_s / 0.05)), -m.offset_deg_h))
        found = dataclasses.replace(nearest, lock_in_deg_s=0.05).basis(run)[:, 0]
        assert found == pytest.approx(run.truth["lock_in"].to_numpy(), abs=0.05)
        assert max(mechanism.lock_in_deg_s for mechanism in tried) < 20.0


class TestRotation:
    def test_harmonics_are_found_in_the_grid(self) -> None:
        """Three orders at once stand out and are offered together, in the scaling they have."""
        hidden = RotationHarmonics(
            order_1=6, order_2=2, order_3=24, cosine_1_deg_h=0.4, sine_2_deg_h=0.3, cosine_3_deg_h=0.2, scaling="rate"
        )
        simulator = rlg.Simulator((ScaleFactor(), hidden), kind="turntable")
        run = simulator.simulate("rate 5 600, rate -10 600, rate 30 300", seed=1, step_s=0.1)
        together = [mechanism for mechanism in RotationHarmonics.grid((run,)) if len(mechanism.orders) > 1]
        assert any(set(m.orders) >= {2, 6, 24} and m.scaling == "rate" for m in together)

    def test_healthy_runs_offer_single_orders_only(self) -> None:
        run = rlg.Simulator((ScaleFactor(),), kind="turntable").simulate("rates", seed=1)
        tried = RotationHarmonics.grid((run,))
        assert {len(mechanism.orders) for mechanism in tried} == {1}
        assert {mechanism.scaling for mechanism in tried} == {"constant", "rate"}

    def test_no_order_is_tried_that_the_sampling_cannot_show(self) -> None:
        """At 30 deg/s and 1 Hz a turn has twelve rows: order 7 would look like order 5."""
        run = rlg.Simulator(kind="turntable").simulate("rate 30 600, rate -30 600", seed=1)
        assert max(order for mechanism in RotationHarmonics.grid((run,)) for order in mechanism.orders) == 6

    def test_whole_turns_hide_the_earth(self) -> None:
        leak = rlg.CATALOGUE["earth_rate_leak"](cosine_deg_h=1.0, sine_deg_h=0.5)
        run = of(leak).simulate("acceleration 10, rate 10 396")  # 36 s a turn
        assert abs(run.truth["earth_rate_leak"].to_numpy()[36:360].mean()) < 1e-9
        assert run.truth["earth_rate_leak"].std() == pytest.approx(np.hypot(1.0, 0.5) / np.sqrt(2.0), rel=0.05)

    def test_a_wobble_grows_with_the_rate_and_a_leak_does_not(self) -> None:
        simulator = of(*(rlg.CATALOGUE[name]() for name in ("misalignment", "earth_rate_leak")))
        slow, fast = (simulator.simulate(f"rate {rate} 720", step_s=0.1).truth.std() for rate in (2, 20))
        assert fast["misalignment"] == pytest.approx(10.0 * slow["misalignment"], rel=0.02)
        assert fast["earth_rate_leak"] == pytest.approx(slow["earth_rate_leak"], rel=0.02)

    def test_a_late_encoder_errs_only_in_acceleration(self) -> None:
        """10 us at 10 deg/s² is 0.36 deg/h."""
        run = of(rlg.CATALOGUE["encoder_delay"](delay_s=1e-5)).simulate("rate 30 60, rest 60", step_s=0.05)
        error = run.truth["encoder_delay"].to_numpy()
        assert error[20:40] == pytest.approx(np.full(20, 0.36), abs=1e-6)
        assert error[100:1200] == pytest.approx(np.zeros(1100), abs=1e-6)
        assert error.min() == pytest.approx(-0.36, abs=1e-6)

    def test_a_shifted_encoder_is_the_delays_referee(self) -> None:
        """The gyro less the difference of an angle read 2 ms late, by interpolating the programme, is the mechanism's column."""
        programme, step_s, delay_s = TableProgramme.parse("rate 30 60, sweep 20 -20 60"), 0.1, 0.002
        edges_s = np.arange(0.0, programme.duration_s, step_s)
        true, late = (np.diff(programme.angle_deg(np.maximum(edges_s - shift, 0.0))) / step_s for shift in (0.0, delay_s))
        table = {"time_s": edges_s[1:], "gyro_deg_s": true, "table_rate_deg_s": late}
        column = rlg.CATALOGUE["encoder_delay"](delay_s=delay_s).basis(rlg.Recording(pd.DataFrame(table)))[:, 0]
        steady = np.abs(np.diff(column, prepend=0.0, append=0.0)[:-1]) < 1.0
        steady = steady & np.roll(steady, 1) & np.roll(steady, -1)
        assert 3600.0 * (true - late)[steady] == pytest.approx(delay_s * column[steady], abs=0.2)

    @pytest.mark.parametrize("programme", ["rate 30 60, rate -10 60, rate 3 60, rest 40", "sweep 20 -20 60, rate 30 30, rest 30"])
    def test_a_sample_in_which_the_table_sets_off_tells_the_delay_as_well(self, programme: str) -> None:
        """A second holds two rates there: the delay is found to a thousandth all the same, it was 2 to 7 percent off."""
        motion, delay_s = TableProgramme.parse(f"acceleration 5, {programme}"), 0.002
        edges_s = np.arange(0.0, motion.duration_s)
        true, late = (np.diff(motion.angle_deg(np.maximum(edges_s - shift, 0.0))) for shift in (0.0, delay_s))
        table = {"time_s": edges_s[1:], "gyro_deg_s": true, "table_rate_deg_s": late}
        column = rlg.CATALOGUE["encoder_delay"]().basis(rlg.Recording(pd.DataFrame(table)))[2:-3, 0]
        assert column @ (3600.0 * (true - late)[2:-3]) / (column @ column) == pytest.approx(delay_s, rel=2e-3)


def test_asymmetry_is_even_and_nonlinearity_odd() -> None:
    table = {"time_s": np.arange(4.0), "gyro_deg_s": np.zeros(4), "table_rate_deg_s": np.array([-50.0, -10.0, 10.0, 50.0])}
    run = rlg.Recording(pd.DataFrame(table))
    even = rlg.CATALOGUE["scale_factor_asymmetry"]().basis(run)[:, 0]
    assert even.tolist() == even[::-1].tolist()
    for nonlinear in rlg.CATALOGUE["scale_factor_nonlinearity"].grid((run,)):
        odd = nonlinear.basis(run)[:, 0]
        assert odd.tolist() == (-odd[::-1]).tolist()
        assert odd[3] / odd[2] == pytest.approx(5.0**nonlinear.order)


def test_a_simulators_output_may_stand_still(tmp_path: Path) -> None:
    """A gyro at rest without noise is dead where it was recorded, and quite in order where it was computed."""
    quiet = of(ScaleFactor(bias_deg_h=3.0))
    run = quiet.simulate("sweep -5 5 1500, rest 300")
    predicted = quiet.predict(run)
    rlg.write(predicted.replace(metadata=run.metadata), tmp_path / "as_recorded.parquet")
    assert len(rlg.read(tmp_path / "as_recorded.parquet", simulated=True)) == len(run)
    assert len(rlg.read(tmp_path / "as_recorded.parquet")) < len(run)
    rlg.write(predicted, tmp_path / "predicted.parquet")
    assert len(rlg.read(tmp_path / "predicted.parquet")) == len(run)


class TestWhatTheTableRecords:
    """An encoder's noise and the rounding to whole pulses are in the residual, and are no physics of the gyro."""

    PROGRAMME = "rest 600, rate 5 600, rate -5 600, rate 30 600, rest 600, rate -30 600, rate 10 600, rate -10 600"

    @staticmethod
    def noisy(run: rlg.Recording, encoder_arcsec: float, seed: int) -> rlg.Recording:
        """The run as an encoder of so much noise records it."""
        jitter = encoder_arcsec / 3600.0 * np.random.default_rng(seed).standard_normal(len(run) + 1)
        seen = run.column("table_rate_deg_s") + np.diff(jitter) / run.period_s
        return run.replace(table=run.table.assign(table_rate_deg_s=seen), truth=None)

    @pytest.mark.parametrize("encoder_arcsec", [0.005, 0.02, 0.1])
    def test_the_noise_of_an_encoder_is_no_lock_in(self, encoder_arcsec: float) -> None:
        simulator = rlg.Simulator.from_mapping({"kind": "turntable", "mechanisms": ["scale_factor"]})
        gyro = rlg.Simulator.from_mapping(
            {"kind": "turntable", "mechanisms": ["scale_factor"], "noise": {"angle_random_walk_deg_sqrt_h": 1.5e-3}}
        )
        runs = [self.noisy(gyro.simulate(self.PROGRAMME, seed=seed, step_s=1.0), encoder_arcsec, seed) for seed in range(2)]
        found = rlg.diagnose(simulator, train=runs, black_box=False)
        assert found.verdict == "none"

    def test_a_table_that_stands_has_no_rate_and_one_that_moves_keeps_it(self) -> None:
        rng = np.random.default_rng(0)
        rest = np.diff(1e-5 * rng.standard_normal(301))
        sweep, swing, crawl = np.linspace(-3.0, 3.0, 300), 0.5 * np.sin(0.3 * np.arange(1.0, 301.0)), np.full(300, 0.02)
        rate = np.concatenate([rest, sweep, rest, swing, rest, crawl])
        run = rlg.Recording(pd.DataFrame({"time_s": np.arange(1800.0), "gyro_deg_s": rate, "table_rate_deg_s": rate}))
        found = averaged_at_rest(run, rate)
        for start in (0, 600, 1200):
            assert np.ptp(found[start : start + 300]) == 0.0
            assert found[start] == pytest.approx(rate[start : start + 300].mean(), abs=1e-9)
        for start in (300, 900, 1500):
            np.testing.assert_array_equal(found[start : start + 300], rate[start : start + 300])


def test_predict_takes_the_size_of_a_pulse(tmp_path: Path) -> None:
    """On a table the gyro itself tells how the table turned, so that its pulses must have a size."""
    run = rlg.Simulator.from_mapping({"kind": "turntable", "mechanisms": []}).simulate("rate 7 60, rate -25 90")
    table = run.table
    table["gyro_pulses"] = table.pop("gyro_deg_s") * 3600.0 * run.period_s / 0.8
    rlg.write(run.replace(table=table, truth=None), tmp_path / "run.parquet")
    (tmp_path / "sim.yaml").write_text("kind: turntable\nmechanisms: []\n")
    register_commands()
    arguments = ["predict", str(tmp_path / "sim.yaml"), str(tmp_path / "run.parquet"), "--out", str(tmp_path / "predicted.parquet")]
    refused = CliRunner().invoke(app, arguments)
    assert refused.exit_code == 2
    assert "give --pulse-arcsec" in " ".join(refused.output.split())
    done = CliRunner().invoke(app, [*arguments, "--pulse-arcsec", "0.8"])
    assert done.exit_code == 0, done.output
    assert rlg.read(tmp_path / "predicted.parquet").column("gyro_deg_s") == pytest.approx(run.column("gyro_deg_s"), abs=0.01)
