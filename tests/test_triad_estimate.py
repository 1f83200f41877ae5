"""The estimate of a triad's errors: recovery with true standard errors, whatever the mounting, sampling and order of the runs."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

import rlgcomp as rlg
from experiments.liu_2019.first_step import first_step
from experiments.liu_2019.triads import drawn_triads
from rlgcomp import units
from rlgcomp.calibration.triad.estimate import TriadCalibration, calibrate_triad
from rlgcomp.calibration.triad.information import Noise, angle_random_walk_deg_sqrt_h
from rlgcomp.calibration.triad.run import TableRun
from rlgcomp.numerics import frames
from rlgcomp.simulation.triad_errors import ACCELEROMETER, GYRO, M12, TriadErrors
from rlgcomp.simulation.two_axis_table import Triad, TwoAxisProgramme
from tests import triads
from tests.triads import PUBLISHED, SHORT, SILENT, STEP_S, readings, short_runs


@pytest.fixture(scope="module")
def triad() -> Triad:
    return triads.triad()


@pytest.fixture(scope="module")
def recordings() -> list[rlg.Recording]:
    return triads.recordings()


@pytest.fixture(scope="module")
def found() -> TriadCalibration:
    return triads.calibration()


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
    """The same run recorded more slowly: sums of increments."""
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


def test_biases_and_scale_factors_of_the_accelerometers_are_estimated_and_shift_no_other_parameter() -> None:
    values = {"accel_bias_x_ug": 50.0, "accel_bias_y_ug": -80.0, "accel_scale_x_ppm": 40.0, "accel_scale_y_ppm": -60.0}
    accelerometer = TriadErrors(values, ACCELEROMETER)
    runs = [TableRun.of(run) for run in short_runs(dataclasses.replace(SILENT, gyro=PUBLISHED, accelerometer=accelerometer))]
    found = calibrate_triad(runs, noise=Noise())
    assert np.abs((found.errors.vector() - PUBLISHED.vector()) / found.sd).max() < 0.05
    assert found.accelerometer.values["accel_bias_y_ug"] == pytest.approx(-80.0, abs=0.5)


def test_gyros_turned_about_z_against_the_accelerometers_change_only_alpha() -> None:
    """The body's x-z plane holds the x gyro: alpha is the sum of both angles, wherever the accelerometers point."""
    both = TriadErrors({**PUBLISHED.values, M12.name: 20.0}, (*GYRO, M12))
    runs = [TableRun.of(run) for run in short_runs(dataclasses.replace(SILENT, gyro=both))]
    found = calibrate_triad(runs, noise=Noise())
    off = found.errors.vector() - PUBLISHED.vector()
    off[[parameter.name for parameter in GYRO].index("alpha_gy_arcsec")] -= 20.0
    assert np.abs(off / found.sd).max() < 0.1


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
    assert ours.errors.values["scale_x_ppm"] == 0.0  # a level inner axis does not determine it


@pytest.mark.parametrize("whole", [True, False])
def test_the_random_walk_comes_from_the_runs_themselves(whole: bool) -> None:
    turning = dataclasses.replace(
        SILENT, gyro=PUBLISHED, whole_pulses=whole, angle_random_walk_deg_sqrt_h=0.0004, encoder_arcsec=3.0
    )
    runs = [TableRun.of(turning.simulate("step-2", seed=seed)) for seed in (1, 2)]
    assert angle_random_walk_deg_sqrt_h(runs) == pytest.approx(0.0004, rel=0.15)


def test_both_axes_reversing_together_cannot_separate_x_from_y() -> None:
    together = TwoAxisProgramme.of([(60.0 * s, 30.0 * s, 24.0) for s in (1, -1, 1, -1)])
    runs = [TableRun.of(SILENT.simulate(p)) for p in (SHORT["step-1"], SHORT["step-2"], together)]
    poor = calibrate_triad(runs, noise=Noise(), passes=1).sd[:2]
    runs[2] = TableRun.of(SILENT.simulate(SHORT["step-3"]))
    assert (poor > 5.0 * calibrate_triad(runs, noise=Noise(), passes=1).sd[:2]).all()


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
