"""Strapdown integration of a triad: exact increments, sensitivities, division of samples."""

from __future__ import annotations

import numpy as np
import pytest

from rlgcomp import units
from rlgcomp.calibration.triad import strapdown
from rlgcomp.calibration.triad.run import TableRun
from rlgcomp.numerics import frames
from rlgcomp.simulation.triad_errors import ACCELEROMETER, GYRO, ErrorParameter, TriadErrors
from rlgcomp.simulation.two_axis_table import PROGRAMMES, TwoAxisProgramme
from tests.triads import SHORT, SILENT, STEP_S


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


def test_sums_over_epochs_are_those_over_samples() -> None:
    """Sensitivities by sums within epochs against the same integrals taken sample by sample."""
    rng = np.random.default_rng(4)
    n, every, step_s = 1003, 50, 0.02
    earth = np.array([0.0, 3e-3, 4e-3])  # a fast Earth, which turns far within an epoch
    turned, moved = 0.01 * rng.normal(size=(n, 3)), rng.normal(size=(n, 3))
    trajectory = strapdown.integrate(turned, moved, step_s, np.eye(3), earth, 9.8)
    quick = strapdown.sensitivity(trajectory, every, GYRO, ACCELEROMETER).joined(
        strapdown.earth_sensitivity(trajectory, every, 1e-3)
    )
    turn = strapdown.earth_turn(earth, trajectory.time_s)
    half = strapdown.earth_turn(earth, trajectory.time_s[:-1] + 0.5 * step_s)
    middle = 0.5 * (trajectory.C_bi[1:] + trajectory.C_bi[:-1])
    fixed = np.swapaxes(0.5 * (turn[1:] + turn[:-1]), 1, 2)

    def tilted(driven: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        phi = np.einsum("nij,nj->ni", turn, np.vstack([np.zeros(3), np.cumsum(driven, axis=0)]))
        angle = np.vstack([np.zeros(3), np.cumsum(0.5 * (phi[1:] + phi[:-1]), axis=0)])
        return phi[::every], 9.8 * step_s * np.stack([-angle[:, 1], angle[:, 0], 0.0 * angle[:, 0]], axis=1)[::every]

    def drive(increments: np.ndarray, parameter: ErrorParameter) -> np.ndarray:
        return np.full(n, step_s) if parameter.column is None else increments[:, parameter.column]

    plain = [tilted(-one.si * drive(turned, one)[:, None] * middle[:, :, one.row]) for one in GYRO]
    for one in ACCELEROMETER:
        level = np.einsum("nij,nj->ni", half, one.si * drive(moved, one)[:, None] * middle[:, :, one.row])
        velocity = np.vstack([np.zeros(3), np.cumsum(level, axis=0)])[::every]
        plain.append((np.zeros_like(velocity), velocity))
    plain += [tilted(1e-3 * step_s * fixed[:, :, axis]) for axis in (1, 2)]
    for k, (tilt, velocity) in enumerate(plain):
        assert quick.tilt[:, :, k] == pytest.approx(tilt, rel=1e-10, abs=1e-12 * np.abs(tilt).max())
        assert quick.velocity[:, :, k] == pytest.approx(velocity, rel=1e-10, abs=1e-12 * np.abs(velocity).max())


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


def test_parts_of_a_sample_follow_a_polynomial_and_add_up() -> None:
    t = np.arange(0.0, 8.1, 0.25)
    angle = np.stack([t**5 - 3.0 * t**2, t**4, np.ones_like(t)], axis=1)
    assert strapdown.divided(np.diff(angle[::4], axis=0), 4) == pytest.approx(np.diff(angle, axis=0), rel=1e-9, abs=1e-8)
    drawn = np.random.default_rng(1).normal(size=(9, 3))
    assert strapdown.divided(drawn, 3).reshape(9, 3, 3).sum(axis=1) == pytest.approx(drawn)
