"""Calibration of a triad on a two-axis table: exact integration, whole linear model, recovery, honest errors, refusals."""

from __future__ import annotations

import dataclasses
import json
import re
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from typer.testing import CliRunner

import rlgcomp as rlg
from experiments.liu_2019.first_step import first_step
from rlgcomp import units
from rlgcomp.calibration.file import Calibration, triad_content, write_calibration
from rlgcomp.calibration.triad import strapdown
from rlgcomp.calibration.triad.calibrate import calibrate_turntable, navigator_remarks, predicted, rate_bias
from rlgcomp.calibration.triad.estimate import TriadCalibration, calibrate_triad
from rlgcomp.calibration.triad.information import Noise, angle_random_walk_deg_sqrt_h
from rlgcomp.calibration.triad.knocks import without_knocks
from rlgcomp.calibration.triad.run import TableRun
from rlgcomp.numerics import frames
from rlgcomp.recording.formats import write
from rlgcomp.report.calibration import render
from rlgcomp.simulation.triad_errors import ACCELEROMETER, GYRO, M12, TriadErrors
from rlgcomp.simulation.two_axis_table import PROGRAMMES, Triad, TwoAxisProgramme, drawn_triads, reversing

PUBLISHED = TriadErrors(  # means of Liu 2019, Table 4
    {
        "scale_x_ppm": 9.233,
        "scale_y_ppm": 6.933,
        "scale_z_ppm": 3.433,
        "bias_x_deg_h": 0.017,
        "bias_y_deg_h": 0.011,
        "bias_z_deg_h": 0.0203,
        "alpha_gy_arcsec": 5.13,
        "delta_gx_arcsec": 3.43,
        "delta_gy_arcsec": 5.37,
        "beta_gx_arcsec": -3.67,
        "beta_gy_arcsec": -6.4,
    }
)
STEP_S = 0.005
SILENT = Triad(
    angle_random_walk_deg_sqrt_h=0.0,
    velocity_random_walk_ug_sqrt_hz=0.0,
    velocity_noise_m_s=0.0,
    whole_pulses=False,
    encoder_arcsec=0.0,
)
SHORT = {
    "step-1": reversing(30.0, revolutions=2, repeats=2, outer_start_deg=90.0),
    "step-2": reversing(30.0, revolutions=2, repeats=2),
    "step-3": reversing(30.0, outer_deg_s=60.0, revolutions=1, repeats=4),
}


def short_runs(triad: Triad, seed: int = 1) -> list[rlg.Recording]:
    return [triad.simulate(programme, seed=10 * seed + k, name=name) for k, (name, programme) in enumerate(SHORT.items())]


@pytest.fixture(scope="module")
def triad() -> Triad:
    return next(drawn_triads(1, PUBLISHED, seed=5))


@pytest.fixture(scope="module")
def recordings(triad: Triad) -> list[rlg.Recording]:
    return short_runs(triad)


@pytest.fixture(scope="module")
def found(recordings: list[rlg.Recording]) -> TriadCalibration:
    return calibrate_triad([TableRun.of(recording) for recording in recordings])


# --- the table and the strapdown solution -----------------------------------------------------------------------------------


def solution(programme: TwoAxisProgramme, samples: int | None = None) -> strapdown.Trajectory:
    run = TableRun.of(SILENT.simulate(programme))
    part = slice(None, samples)
    return strapdown.integrate(
        run.delta_theta_rad[part],
        run.delta_v_m_s[part],
        STEP_S,
        frames.table_attitude(programme.outer_start_deg, programme.inner_start_deg),
        frames.earth_rate_n_rad_s(run.latitude_deg),
        SILENT.gravity_m_s2,
    )


@pytest.mark.parametrize("name", SHORT)
def test_exact_increments_bring_the_navigator_back_to_rest(name: str) -> None:
    trajectory = solution(SHORT[name])
    assert np.abs(trajectory.velocity_m_s).max() < 1e-4
    outer, inner, _, _ = SHORT[name].motion(trajectory.time_s[-1:])
    level = strapdown.earth_turn(trajectory.earth_rad_s, trajectory.time_s[-1]) @ trajectory.C_bi[-1]
    assert level == pytest.approx(frames.table_attitude(outer, inner)[0], abs=0.01 * units.RAD_PER_ARCSEC)


def test_without_the_coning_term_it_does_not() -> None:
    """The whole third step, 1208 s."""
    programme = PROGRAMMES["step-3"]
    run = TableRun.of(SILENT.simulate(programme))
    attitude = frames.table_attitude(programme.outer_start_deg, programme.inner_start_deg)
    turns = frames.running_product(frames.quaternion_of(run.delta_theta_rad))
    naive = (
        strapdown.earth_turn(frames.earth_rate_n_rad_s(run.latitude_deg), programme.duration_s)
        @ attitude
        @ frames.matrix_of(turns[-1])
    )
    outer, inner, _, _ = programme.motion(np.array([programme.duration_s]))
    tilt_rad = np.abs(naive @ frames.table_attitude(outer, inner)[0].T - np.eye(3)).max()
    assert tilt_rad > 2.0 * units.RAD_PER_ARCSEC
    assert np.abs(solution(programme).velocity_m_s).max() < 1e-4


@pytest.mark.parametrize("name", SHORT)
def test_sensitivities_are_the_derivatives(name: str) -> None:
    """Against a second, disturbed integration, parameter by parameter."""
    trajectory = solution(SHORT[name])
    linear = strapdown.sensitivity(trajectory, 200, GYRO, ACCELEROMETER)
    for column, parameter in enumerate((*GYRO, *ACCELEROMETER)):
        size = {"ppm": 1.0, "deg/h": 0.01, "arcsec": 1.0, "ug": 10.0}[parameter.unit]
        gyro = TriadErrors({parameter.name: size}) if column < len(GYRO) else TriadErrors()
        accelerometer = TriadErrors({parameter.name: size} if column >= len(GYRO) else {}, ACCELEROMETER)
        other = strapdown.integrate(
            gyro.disturb(trajectory.delta_theta_rad, STEP_S),
            accelerometer.disturb(trajectory.delta_v_m_s, STEP_S),
            STEP_S,
            trajectory.C_bi[0],
            trajectory.earth_rad_s,
            trajectory.gravity_m_s2,
        )
        off = (other.velocity_m_s - trajectory.velocity_m_s)[::200, :2]
        assert size * linear.velocity[:, :2, column] == pytest.approx(off, abs=1e-3 * np.abs(off).max() + 1e-9), parameter.name


def test_on_a_flat_earth_at_rest_the_first_step_has_the_papers_corrected_form(monkeypatch: pytest.MonkeyPatch) -> None:
    """delta V_E = g (dk_z int phi dt + eps_z t²/2) and delta V_N = g (beta_gx int (1 - cos phi) dt - beta_gy int sin phi dt)."""
    from experiments.liu_2019.first_step import NAMES, regressors

    programme = SHORT["step-1"]
    monkeypatch.setattr(frames, "earth_rate_n_rad_s", lambda latitude_deg: np.zeros(3))
    there = solution(programme)
    phi = programme.motion(there.time_s)[1] * units.RAD_PER_DEG
    printed = regressors(phi[1:], STEP_S, there.gravity_m_s2)[199::200]
    whole = strapdown.sensitivity(there, 200, GYRO, ()).velocity[1:, :2]
    for k, name in enumerate(NAMES):
        column = [parameter.name for parameter in GYRO].index(name)
        unit = abs(GYRO[column].si)
        assert whole[:, :, column] == pytest.approx(unit * printed[:, :, k], abs=2e-4 * unit * np.abs(printed[:, :, k]).max())


# --- the estimate -----------------------------------------------------------------------------------------------------------


def test_it_recovers_the_published_errors_within_its_own(found: TriadCalibration) -> None:
    off = (found.errors.vector() - PUBLISHED.vector()) / found.sd
    assert all(found.seen)
    assert np.abs(off).max() < 4.0
    assert 0.4 < np.sqrt(np.mean(off**2)) < 1.7


@pytest.mark.slow
@pytest.mark.parametrize("whole_pulses", [True, False])
def test_stated_errors_are_true_and_small(whole_pulses: bool) -> None:
    """40 triads with Table 4's errors and Table 1's noise in rate-biased mode, the three steps in full."""
    from experiments.liu_2019.monte_carlo import study, summary

    table = summary(study(40, PUBLISHED, whole_pulses=whole_pulses)).set_index("parameter")
    assert table["rms error / sd"].between(0.8, 1.25).all()
    assert table.loc[["Δk_x", "Δk_y", "Δk_z"], "rms error"].max() <= 0.015
    assert table.loc[["ε_x", "ε_y"], "rms error"].max() <= 0.0009
    assert table.loc["α_gy", "rms error"] <= 0.01


def test_noise_free_the_second_pass_takes_out_the_squares() -> None:
    """One linear solution leaves what is of second order in the errors; the Gauss-Newton pass takes it out."""
    runs = [TableRun.of(run) for run in short_runs(dataclasses.replace(SILENT, gyro=PUBLISHED))]
    noise = Noise(accelerometer={"ug": 1e-6, "ppm": 1e-6, "arcsec": 1e-6}, tilt_arcsec=(1e-3, 1e-3, 1e-3))
    off = {
        passes: np.abs(calibrate_triad(runs, noise=noise, passes=passes).errors.vector() - PUBLISHED.vector()).max()
        for passes in (1, 2)
    }
    assert off[2] < 5e-4
    assert off[2] < 0.3 * off[1]


def test_large_errors_are_found_as_well() -> None:
    """100 arcsec, 1 deg/h and 100 ppm: passes go on until they no longer move."""
    names = [parameter.name for parameter in GYRO]
    size = {"ppm": 100.0, "deg/h": 1.0, "arcsec": 100.0}
    large = TriadErrors({p.name: size[p.unit] * (-1.0) ** k for k, p in enumerate(GYRO)})
    angles = TriadErrors({name: 100.0 * (-1.0) ** k for k, name in enumerate(names) if name.endswith("arcsec")})
    for errors in (large, angles):
        triad = next(drawn_triads(1, errors, seed=2))
        found = calibrate_triad([TableRun.of(recording) for recording in short_runs(triad, 3)])
        off = (found.errors.vector() - errors.vector()) / found.sd
        assert np.abs(off).max() < 4.0


@pytest.mark.parametrize("walk", [2.0, 20.0])
def test_the_accelerometers_noise_comes_from_the_runs_themselves(walk: float) -> None:
    """Typical are 5 ug/sqrt(Hz): taken for granted, they would be a sixth and sixteen times the variance."""
    shaken = Triad(PUBLISHED, velocity_random_walk_ug_sqrt_hz=walk, whole_pulses=False)
    runs = [TableRun.of(run) for run in short_runs(shaken)]
    found = calibrate_triad(runs)
    assert found.noise.velocity_random_walk_ug_sqrt_hz == pytest.approx(walk, rel=0.2)
    assert np.abs((found.errors.vector() - PUBLISHED.vector()) / found.sd).max() < 4.0
    taken = calibrate_triad(runs, noise=dataclasses.replace(found.noise, velocity_random_walk_ug_sqrt_hz=5.0))
    assert taken.noise.velocity_random_walk_ug_sqrt_hz == 5.0
    assert np.sign(taken.sd - found.sd)[0] == np.sign(5.0 - walk)


def coarser(run: TableRun, times: int) -> TableRun:
    """The same run recorded more slowly: nothing but sums of increments."""
    whole = len(run.delta_theta_rad) // times * times
    turned, pushed = (part[:whole].reshape(-1, times, 3).sum(axis=1) for part in (run.delta_theta_rad, run.delta_v_m_s))
    outer, inner = (angle[:whole][times - 1 :: times] for angle in (run.outer_deg, run.inner_deg))
    step_s = times * run.step_s
    return dataclasses.replace(run, step_s=step_s, delta_theta_rad=turned, delta_v_m_s=pushed, outer_deg=outer, inner_deg=inner)


@pytest.mark.parametrize(("hertz", "off_sd"), [(100, 0.02), (20, 0.1), (10, 0.4)])
def test_slow_sampling_is_no_error(hertz: int, off_sd: float) -> None:
    """At 10 Hz the table's third step turns the triad by 6.7 deg in a sample."""
    runs = [TableRun.of(run) for run in short_runs(dataclasses.replace(SILENT, gyro=PUBLISHED))]
    found = calibrate_triad([coarser(run, round(1.0 / STEP_S / hertz)) for run in runs], noise=Noise())
    assert np.abs((found.errors.vector() - PUBLISHED.vector()) / found.sd).max() < off_sd
    with pytest.raises(rlg.InputError, match=r"13.4 deg in a sample.* 6.7 Hz or more"):
        calibrate_triad([coarser(run, 40) for run in runs], noise=Noise())


def test_parts_of_a_sample_follow_a_polynomial_and_add_up() -> None:
    t = np.arange(0.0, 8.1, 0.25)
    angle = np.stack([t**5 - 3.0 * t**2, t**4, np.ones_like(t)], axis=1)
    assert strapdown.divided(np.diff(angle[::4], axis=0), 4) == pytest.approx(np.diff(angle, axis=0), rel=1e-9, abs=1e-8)
    drawn = np.random.default_rng(1).normal(size=(9, 3))
    assert strapdown.divided(drawn, 3).reshape(9, 3, 3).sum(axis=1) == pytest.approx(drawn)


def test_a_recording_at_10_hz_agrees_with_its_encoders() -> None:
    """The middle of a window of five samples is no sample's end."""
    table = SILENT.simulate(SHORT["step-3"]).table
    slow = table.groupby(np.arange(len(table)) // 20).agg({c: "last" if c[:5] in ("time_", "angle") else "sum" for c in table})
    metadata = SILENT.simulate(SHORT["step-3"]).metadata
    assert TableRun.of(rlg.Recording(slow.iloc[:1000], metadata)).step_s == pytest.approx(0.1)
    with pytest.raises(rlg.InputError, match=r"disagree with the encoders.*record faster"):
        TableRun.of(rlg.Recording(slow.iloc[:1000].assign(gyro_x_pulses=-slow["gyro_x_pulses"]), metadata))


def readings(table: pd.DataFrame, **other: np.ndarray | pd.Series) -> rlg.Recording:
    return rlg.Recording(table.assign(**other), SILENT.simulate(SHORT["step-2"]).metadata)


def test_accelerometers_and_encoders_that_disagree_are_refused_with_the_change_that_makes_them_agree() -> None:
    """Each passed for vibration, or for a triad that stands turned by as much."""
    level = SILENT.simulate(SHORT["step-1"]).table
    both = SILENT.simulate(SHORT["step-3"]).table
    for table, other, text in (
        (level, {"accel_x_m_s": -level["accel_x_m_s"]}, "agree with x = -accel_x;"),
        (level, {"accel_x_m_s": level["accel_y_m_s"], "accel_y_m_s": level["accel_x_m_s"]}, "agree with x = accel_y, y = accel_x;"),
        (both, {f"accel_{axis}_m_s": -both[f"accel_{axis}_m_s"] for axis in "xyz"}, "x = -accel_x, y = -accel_y, z = -accel_z or"),
        (both, {"angle_outer_deg": both["angle_outer_deg"] + 90.0}, "agree with -90 deg added to angle_outer_deg;"),
        (level, {"angle_outer_deg": level["angle_outer_deg"] - 5.0}, "agree with 5 deg added to angle_outer_deg;"),
        (level, {"angle_inner_deg": level["angle_inner_deg"] + 37.0}, "agree with -37 deg added to angle_inner_deg;"),
        (both, {"accel_y_m_s": 0.0 * both["accel_x_m_s"]}, "no order, sign or zero"),
    ):
        with pytest.raises(rlg.InputError, match=re.escape(text)):
            TableRun.of(readings(table, **other))


def test_an_outer_zero_off_by_a_degree_is_found_as_the_triads_stand_and_moves_no_error() -> None:
    recordings = short_runs(dataclasses.replace(SILENT, gyro=PUBLISHED))
    off = [readings(run.table, angle_outer_deg=run.table["angle_outer_deg"] + 1.0) for run in recordings]
    found = calibrate_triad([TableRun.of(run) for run in off], noise=Noise())
    assert np.abs((found.errors.vector() - PUBLISHED.vector()) / found.sd).max() < 0.02
    assert found.mount_arcsec[1] == pytest.approx(-3600.0, abs=1.0)


@pytest.mark.parametrize("mount_arcsec", [(0.0, -100.0, 0.0), (60.0, -300.0, 200.0), (-900.0, 1200.0, 1800.0)])
def test_turning_the_whole_triad_on_the_table_changes_none_of_its_errors(mount_arcsec: tuple[float, ...]) -> None:
    """Gyros and accelerometers are bolted on together, by minutes of arc from the table's axes: no gyro moves in its triad."""
    turn = frames.matrix_of(frames.quaternion_of(np.array(mount_arcsec) * units.RAD_PER_ARCSEC))
    runs = [
        dataclasses.replace(
            run, delta_theta_rad=PUBLISHED.disturb(run.delta_theta_rad @ turn, STEP_S), delta_v_m_s=run.delta_v_m_s @ turn
        )
        for run in map(TableRun.of, short_runs(SILENT))
    ]
    found = calibrate_triad(runs, noise=Noise())
    assert np.abs((found.errors.vector() - PUBLISHED.vector()) / found.sd).max() < 0.02
    assert (found.sd[-4:] < 1.0).all()
    assert max(run.chi_squared_ratio for run in found.runs if run.shows == "velocity") < 0.01
    assert np.abs(np.subtract(found.mount_arcsec, mount_arcsec) / found.mount_sd_arcsec).max() < 0.1


def test_biases_and_scale_factors_of_the_accelerometers_are_found_and_pull_at_nothing() -> None:
    values = {"accel_bias_x_ug": 50.0, "accel_bias_y_ug": -80.0, "accel_scale_x_ppm": 40.0, "accel_scale_y_ppm": -60.0}
    accelerometer = TriadErrors(values, ACCELEROMETER)
    runs = [TableRun.of(run) for run in short_runs(dataclasses.replace(SILENT, gyro=PUBLISHED, accelerometer=accelerometer))]
    found = calibrate_triad(runs, noise=Noise())
    assert np.abs((found.errors.vector() - PUBLISHED.vector()) / found.sd).max() < 0.05
    assert found.accelerometer.values["accel_bias_y_ug"] == pytest.approx(-80.0, abs=0.5)


def test_gyros_turned_about_z_against_the_accelerometers_change_nothing_but_alpha() -> None:
    """The body's x-z plane holds the x gyro: alpha is the sum of both angles, wherever the accelerometers point."""
    both = TriadErrors({**PUBLISHED.values, M12.name: 20.0}, (*GYRO, M12))
    runs = [TableRun.of(run) for run in short_runs(dataclasses.replace(SILENT, gyro=both))]
    found = calibrate_triad(runs, noise=Noise())
    off = found.errors.vector() - PUBLISHED.vector()
    off[[parameter.name for parameter in GYRO].index("alpha_gy_arcsec")] -= 20.0
    assert np.abs(off / found.sd).max() < 0.1


def test_orthogonal_gyros_that_do_not_turn_are_reported() -> None:
    orthogonal = dataclasses.replace(SILENT, gyro_axes="orthogonal", angle_random_walk_deg_sqrt_h=0.0004)
    bias = rate_bias(TableRun.of(orthogonal.simulate(SHORT["step-2"])))
    assert bias.idle == "xy"
    assert bias.crossings[:2] == (0, 0)
    assert bias.remark.code == "calibration.gyros_hardly_turn"
    assert bias.remark.data["axes"] == ["x", "y"]


def test_the_order_of_the_runs_does_not_matter(recordings: list[rlg.Recording], found: TriadCalibration) -> None:
    backward = calibrate_triad([TableRun.of(recording) for recording in reversed(recordings)])
    assert backward.errors.vector() == pytest.approx(found.errors.vector(), abs=1e-6)
    assert backward.sd == pytest.approx(found.sd, rel=1e-6)


def test_the_last_point_of_the_curves_is_the_estimate(found: TriadCalibration) -> None:
    last = found.curves.iloc[-1]
    for parameter, value, sd in zip(GYRO, found.errors.vector(), found.sd, strict=True):
        assert last[parameter.name] == pytest.approx(value, rel=1e-6, abs=1e-9)
        assert last[f"{parameter.name}_sd"] == pytest.approx(sd, rel=1e-6)


def test_calibrated_it_navigates_better(found: TriadCalibration) -> None:
    for run in found.runs:
        if run.shows == "velocity":
            assert np.abs(run.after_m_s).max() < 0.25 * np.abs(run.before_m_s).max()
            assert 0.8 < run.chi_squared_ratio < 1.25


def test_the_printed_recursion_is_many_times_worse(triad: Triad) -> None:
    run = TableRun.of(triad.simulate("step-1", seed=3))
    printed = first_step(run)
    ours = calibrate_triad([run])
    worse = abs(printed["scale_z_ppm"] - PUBLISHED.values["scale_z_ppm"])
    assert worse > 5.0 * abs(ours.errors.values["scale_z_ppm"] - PUBLISHED.values["scale_z_ppm"])
    assert not ours.seen[0]
    assert ours.errors.values["scale_x_ppm"] == 0.0  # a level inner axis does not show it, and so nothing is invented


@pytest.mark.parametrize("whole", [True, False])
def test_the_random_walk_comes_from_the_runs_themselves(whole: bool) -> None:
    turning = dataclasses.replace(
        SILENT, gyro=PUBLISHED, whole_pulses=whole, angle_random_walk_deg_sqrt_h=0.0004, encoder_arcsec=3.0
    )
    runs = [TableRun.of(turning.simulate("step-2", seed=seed)) for seed in (1, 2)]
    assert angle_random_walk_deg_sqrt_h(runs) == pytest.approx(0.0004, rel=0.15)


def test_orthogonal_gyros_are_recognised() -> None:
    run = TableRun.of(dataclasses.replace(SILENT, gyro_axes="orthogonal").simulate(SHORT["step-3"]))
    assert run.gyro_axes == "orthogonal"
    with pytest.raises(rlg.InputError, match="disagree with the encoders"):
        TableRun.of(SILENT.simulate(SHORT["step-3"]), gyro_axes="orthogonal")


def test_both_axes_reversing_together_cannot_separate_x_from_y() -> None:
    together = TwoAxisProgramme.of([(60.0 * s, 30.0 * s, 24.0) for s in (1, -1, 1, -1)])
    runs = [TableRun.of(SILENT.simulate(p)) for p in (SHORT["step-1"], SHORT["step-2"], together)]
    poor = calibrate_triad(runs, noise=Noise(), passes=1).sd[:2]
    runs[2] = TableRun.of(SILENT.simulate(SHORT["step-3"]))
    assert (poor > 5.0 * calibrate_triad(runs, noise=Noise(), passes=1).sd[:2]).all()


# --- remarks and refusals ----------------------------------------------------------------------------------------------------


def test_the_third_step_crosses_zero_rate(recordings: list[rlg.Recording]) -> None:
    biases = {recording.name: rate_bias(TableRun.of(recording)) for recording in recordings}
    assert not biases["step-1"].violated
    assert not biases["step-2"].violated
    assert biases["step-3"].violated
    assert biases["step-1"].slowest_deg_s == pytest.approx(30.0 / np.sqrt(3.0), rel=1e-3)


@pytest.mark.parametrize("name", ["step-3-slow-outer", "step-3-modulated"])
def test_the_alternatives_stay_out_of_lock_in(name: str) -> None:
    bias = rate_bias(TableRun.of(SILENT.simulate(name)))
    assert not bias.violated
    assert bias.slowest_deg_s == pytest.approx(10.15, abs=0.1)


def test_alternatives_come_with_their_standard_deviations() -> None:
    table = predicted(Noise(), 39.98).set_index("third step")
    assert table.loc["step-3", "scale_x_ppm"] < 0.015
    assert table.loc["step-3-modulated", "scale_x_ppm"] == pytest.approx(0.04, abs=0.01)
    assert 0.3 < table.loc["step-3-slow-outer", "scale_x_ppm"] < 0.8


def test_an_outlier_has_a_remark_with_its_time_and_the_run_is_cut_there(
    recordings: list[rlg.Recording], found: TriadCalibration
) -> None:
    """It passed for noise of the accelerometers in every run, and the errors stated were thirty times what they are."""
    table = recordings[0].table.copy()
    table.loc[9000:9003, "accel_x_m_s"] += 3.0 * STEP_S
    cut = calibrate_turntable([recordings[0].replace(table=table), *recordings[1:]])
    assert cut.remarks[0].code == "calibration.outliers"
    assert cut.remarks[0].text.startswith("step-1: gyros or accelerometers stand 30 standard deviations off the encoders 45")
    assert [run.name for run in cut.triad.runs] == ["step-1 from 0 s", "step-1 from 46.02 s", "step-2", "step-3"]
    assert (cut.triad.sd < 2.0 * found.sd).all()  # two halves of the run, each with a tilt of its own
    assert all(without_knocks(TableRun.of(recording))[1] is None for recording in recordings)


def test_biases_that_change_from_run_to_run_widen_their_standard_deviations() -> None:
    """Each step twice, the biases 0.02 deg/h apart: 0.003 deg/h was stated."""
    runs = []
    for k, sign in enumerate((1.0, -1.0)):
        moved = {p.name: sign * 0.01 for p in GYRO if p.unit == "deg/h"}
        shifted = Triad(TriadErrors({name: value + moved.get(name, 0.0) for name, value in PUBLISHED.values.items()}))
        runs.append([TableRun.of(run) for run in short_runs(shifted, seed=k + 1)])
    once = calibrate_triad(runs[0])
    both = calibrate_triad([*runs[0], *runs[1]])
    assert once.noise.run_bias_deg_h == 0.0
    assert 0.005 < both.noise.run_bias_deg_h < 0.03
    off = (both.errors.vector() - PUBLISHED.vector())[3:6]
    assert (np.abs(off) < 2.0 * both.sd[3:6]).all()
    assert (both.sd[3:5] > once.sd[3:5]).all()


@pytest.mark.parametrize("stated_deg", [40.98, 39.48, -39.98])
def test_a_wrong_latitude_is_refused_with_the_one_that_the_runs_show(recordings: list[rlg.Recording], stated_deg: float) -> None:
    """It went into ε_z and the scale factors by a hundred standard deviations, without a remark."""
    wrong = [run.replace(metadata=dataclasses.replace(run.metadata, latitude_deg=stated_deg)) for run in recordings]
    with pytest.raises(rlg.InputError, match=r"as at latitude (39\.9|40\.0)\d* ± 0\.0\d+ deg, and -?\d+\.\d+ deg is stated"):
        calibrate_turntable(wrong)


def test_a_table_that_leans_moves_no_latitude(found: TriadCalibration) -> None:
    """About an upright axis a degree towards north looks like a degree of latitude, but for the accelerometers."""
    tilted = dataclasses.replace(SILENT, gyro=PUBLISHED, angle_random_walk_deg_sqrt_h=0.0004)
    start = {"step-1": 91.0, "step-2": 1.0, "step-3": 1.0}
    leaning = [
        tilted.simulate(dataclasses.replace(SHORT[name], outer_start_deg=outer_deg), seed=k, name=name)
        for k, (name, outer_deg) in enumerate(start.items())
    ]
    leaning = [run.replace(table=run.table.assign(angle_outer_deg=run.table["angle_outer_deg"] - 1.0)) for run in leaning]
    seen = calibrate_triad([TableRun.of(run) for run in leaning]).latitude
    assert seen.sd_deg < 0.1
    assert abs(seen.seen_deg - 39.98) < 4.0 * seen.sd_deg
    assert abs(found.latitude.seen_deg - 39.98) < 4.0 * found.latitude.sd_deg


def test_lock_in_kicks_have_the_stated_size() -> None:
    """0.1375 arcsec rms at 24 deg/s² and a lock-in rate of 0.0173 deg/s."""
    quiet = dataclasses.replace(SILENT, lock_in_deg_s=0.0173)
    kicked = quiet.simulate("step-3", seed=2)
    plain = SILENT.simulate("step-3", seed=2)
    rates = [np.stack([run.rate_deg_h(f"gyro_{axis}_pulses") for axis in "xyz"]) for run in (kicked, plain)]
    kicks = (rates[0] - rates[1]) * STEP_S / 3600.0 * 3600.0
    kicks = kicks[np.abs(kicks) > 1e-6]
    assert len(kicks) > 500
    assert np.sqrt(np.mean(kicks**2)) == pytest.approx(0.1375, rel=0.35)


# --- the file, the command ----------------------------------------------------------------------------------------------------


@given(st.integers(0, 1000))
@settings(max_examples=20)
def test_correct_undoes_disturb(seed: int) -> None:
    rng = np.random.default_rng(seed)
    errors = TriadErrors.of(rng.normal(0.0, 100.0, len(GYRO)))
    increments = rng.normal(0.0, 1e-3, (5, 3))
    assert errors.correct(errors.disturb(increments, 0.005), 0.005) == pytest.approx(increments, abs=1e-16)


def test_a_calibration_takes_the_errors_out_of_raw_pulses(
    tmp_path: Path, recordings: list[rlg.Recording], found: TriadCalibration
) -> None:
    write_calibration(tmp_path / "cal.json", triad_content(found, recordings, [], "0", "now"))
    calibration = Calibration.read(tmp_path / "cal.json")
    recording = dataclasses.replace(SILENT, gyro=found.errors).simulate(SHORT["step-3"])
    true = SILENT.simulate(SHORT["step-3"])
    clean = calibration.apply(recording)
    assert clean.gyro_columns == ("gyro_x_deg_h", "gyro_y_deg_h", "gyro_z_deg_h")
    expected = np.stack([true.rate_deg_h(f"gyro_{axis}_pulses") for axis in "xyz"], axis=1) @ frames.OBLIQUE_TO_BODY.T
    assert np.stack([clean.column(column) for column in clean.gyro_columns], axis=1) == pytest.approx(expected, abs=1e-4)
    with pytest.raises(rlg.InputError, match="calibrated already"):
        calibration.apply(clean)


def test_a_single_gyros_scale_factor_is_applied(tmp_path: Path) -> None:
    write_calibration(tmp_path / "k.json", {"schema": "rlgcomp.calibration/1", "kind": "gyro", "pulse_arcsec": 0.84279066})
    table = pd.DataFrame({"time_s": np.arange(10.0), "gyro_pulses": np.arange(10.0)})
    clean = Calibration.read(tmp_path / "k.json").apply(rlg.Recording(table, rlg.Metadata(kind="static")))
    assert clean.column("gyro_deg_h") == pytest.approx(0.84279066 * np.arange(10.0))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda c: c.update(schema="rlgcomp.calibration/9"), "this version reads"),
        (lambda c: c.update(kind="odd"), "allowed are gyro and triad"),
        (lambda c: c.update(gyro_axes="skew"), "allowed are oblique, orthogonal"),
        (lambda c: c["parameters"][0].update(value=None), "must be a number"),
        (lambda c: c["parameters"][0].update(value=1e300), "must be a number"),
        (lambda c: c["parameters"][0].update(parameter="odd"), "unknown 'odd'"),
        (lambda c: c.pop("parameters"), "requires"),
        (lambda c: c.update(pulse_arcsec="wide"), "must be a number"),
    ],
)
def test_a_hostile_calibration_file_is_refused(
    tmp_path: Path, recordings: list[rlg.Recording], found: TriadCalibration, change: object, message: str
) -> None:
    path = tmp_path / "cal.json"
    write_calibration(path, triad_content(found, recordings, [], "0", "now"))
    content = json.loads(path.read_text())
    change(content)
    path.write_text(json.dumps(content))
    with pytest.raises(rlg.InputError, match=message):
        Calibration.read(path)


@given(st.binary(max_size=200))
@settings(max_examples=40)
def test_no_bytes_make_a_traceback(tmp_path_factory: pytest.TempPathFactory, content: bytes) -> None:
    path = tmp_path_factory.mktemp("cal") / "cal.json"
    path.write_bytes(content)
    with pytest.raises(rlg.InputError):
        Calibration.read(path)


def invoke(*arguments: object) -> object:
    from rlgcomp.cli import register_commands
    from rlgcomp.cli.base import app

    register_commands()
    return CliRunner().invoke(app, [str(argument) for argument in arguments])


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory, recordings: list[rlg.Recording]) -> list[Path]:
    folder = tmp_path_factory.mktemp("runs")
    for recording in recordings:
        write(recording, folder / f"{recording.name}.parquet")
    return [folder / f"{recording.name}.parquet" for recording in recordings]


def test_the_command_writes_a_calibration_and_a_report(tmp_path: Path, files: list[Path]) -> None:
    result = invoke("calibrate", *files, "--out", tmp_path / "cal.json", "--report", tmp_path / "report")
    assert result.exit_code == 0, result.output
    assert "pass through zero rate" in result.output
    assert "alpha_gy_arcsec" in result.output
    assert "condition number" in result.output
    refused = invoke("calibrate", *files, "--out", tmp_path / "cal.json", "--report", tmp_path)
    assert refused.exit_code == 2
    assert "left untouched" in refused.output
    content = json.loads((tmp_path / "cal.json").read_text())
    remarks = {remark["code"]: remark["data"] for remark in content["remarks"]}
    assert remarks["calibration.gyros_cross_zero_rate"]["run"] == "step-3"
    assert remarks["calibration.angle_random_walk"]["estimated"]
    assert {row["parameter"] for row in content["parameters"]} == {parameter.name for parameter in GYRO}
    assert np.isfinite([row["sd"] for row in content["parameters"]]).all()
    page = (tmp_path / "report" / "report.html").read_text()
    assert page.count("<svg") == 3
    assert "http" not in page.replace("http://www.w3.org", "").replace("http://purl.org", "").replace(
        "http://creativecommons.org", ""
    )
    again = invoke("calibrate", *files[:2], "--out", tmp_path / "again.json", "--json", "--angle-random-walk", "0.0004")
    assert json.loads(again.stdout)["schema"] == "rlgcomp.calibration/1"


def test_a_run_whose_navigator_is_made_worse_has_a_remark(found: TriadCalibration) -> None:
    """Another run that was worse before gains."""
    run = next(run for run in found.runs if run.shows == "velocity")
    better = dataclasses.replace(run, name="better", before_m_s=np.full((2, 2), -0.052), after_m_s=np.full((2, 2), 0.009))
    lost = dataclasses.replace(run, name="lost", before_m_s=np.full((2, 2), 0.022), after_m_s=np.full((2, 2), -0.027))
    (remark,) = navigator_remarks([better, lost])
    assert remark.code == "calibration.navigator_worse"
    assert remark.data == {"run": "lost", "before_m_s": 0.022, "after_m_s": 0.027}


def test_the_report_says_where_nothing_is_better(recordings: list[rlg.Recording]) -> None:
    found = calibrate_turntable(recordings)
    assert 'class="unit">better' in render(found)
    runs = tuple(dataclasses.replace(run, after_m_s=2.0 * run.before_m_s) for run in found.triad.runs)
    page = render(dataclasses.replace(found, triad=dataclasses.replace(found.triad, runs=runs)))
    assert "no better" in page
    assert 'class="unit">better' not in page


def test_an_interval_is_calibrated_alone(tmp_path: Path, files: list[Path]) -> None:
    """From the second turn on: what came before the interval is not integrated."""
    result = invoke("calibrate", f"{files[0]}@24:", files[1], "--out", tmp_path / "cal.json", "--json")
    assert result.exit_code == 0, result.output
    hours = [run["hours"] for run in json.loads(result.stdout)["runs"]]
    assert hours[0] == pytest.approx(hours[1] - 24.0 / 3600.0, rel=1e-3)


def test_bad_input_to_the_command(tmp_path: Path, files: list[Path], recordings: list[rlg.Recording]) -> None:
    table = recordings[0].table
    nowhere = recordings[0].replace(metadata=dataclasses.replace(recordings[0].metadata, latitude_deg=None))
    bad = {
        "latitude": (nowhere, "latitude is not known"),
        "encoder": (recordings[0].replace(table=table.drop(columns="angle_inner_deg")), "no column angle_inner_deg"),
        "two": (recordings[0].replace(table=table.drop(columns="gyro_z_pulses")), "no gyro_z_pulses"),
        "gap": (recordings[0].replace(table=table.drop(index=range(4000, 4500))), "1 gaps in time"),
        "still": (
            recordings[0].replace(table=table.assign(angle_inner_deg=np.linspace(0.0, 1.0, len(table)))),
            "less than a revolution",
        ),
        "swapped": (
            recordings[0].replace(
                table=table.rename(columns={"gyro_x_pulses": "gyro_y_pulses", "gyro_y_pulses": "gyro_x_pulses"}).assign(
                    gyro_z_pulses=-table["gyro_z_pulses"]
                )
            ),
            "disagree with the encoders",
        ),
        "weak": (
            recordings[0].replace(table=table.assign(**{f"accel_{a}_m_s": 0.1 * table[f"accel_{a}_m_s"] for a in "xyz"})),
            "instead of gravity",
        ),
        "blind": (
            recordings[2].replace(table=recordings[2].table.drop(columns=[f"accel_{a}_m_s" for a in "xyz"])),
            "no accelerometers",
        ),
    }
    noise = ["--angle-random-walk", "0.0004"]
    for name, (recording, message) in bad.items():
        write(recording, tmp_path / f"{name}.parquet")
        result = invoke("calibrate", tmp_path / f"{name}.parquet", "--out", tmp_path / "cal.json", *noise)
        assert result.exit_code == 2, (name, result.output)
        assert message in result.output.replace("\n", " "), (name, result.output)
        assert not (tmp_path / "cal.json").exists()
    twice = recordings[0].replace(table=table.assign(gyro_x_deg_s=1.0 + np.arange(len(table)) % 7))
    write(twice, tmp_path / "twice.parquet")
    other = recordings[1].replace(metadata=dataclasses.replace(recordings[1].metadata, pulse_arcsec=0.8))
    write(other, tmp_path / "other.parquet")
    for arguments, message in (
        ([*files, "--angle-random-walk", "-1"], "must lie between 0 and 1"),
        ([*files, "--latitude", "41"], "says latitude 39.98 deg"),
        ([files[0], files[0], files[1]], "hold the same data"),
        ([tmp_path / "twice.parquet"], "leave one out with --drop"),
        ([files[0], tmp_path / "other.parquet"], "disagree with the encoders"),
    ):
        result = invoke("calibrate", *arguments, "--out", tmp_path / "cal.json")
        assert result.exit_code == 2, result.output
        assert message in result.output.replace("\n", " "), result.output
