"""The simulated tables against a direct integration of the geometry, which shares no formula with them."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.spatial.transform import Rotation

from rlgcomp.calibration.revolutions import constant_rate_segments, direction_pairs, whole_revolutions
from rlgcomp.errors import InputError
from rlgcomp.simulation.position_table import PositionTable, TableErrors
from rlgcomp.units import ARCSEC_PER_TURN, EARTH_RATE_RAD_S, RAD_PER_ARCSEC

NO_ERRORS = TableErrors().only()
IDEAL = PositionTable(errors=NO_ERRORS, angle_random_walk_deg_sqrt_h=0.0, rate_error=0.0, period_error=0.0)


def integrated_arcsec(
    table: PositionTable, beta_deg: float, period_s: float, *, sign: float = 1.0, hunting: float = 0.0, phase: float = 0.0
) -> float:
    """One revolution of the position table: the gyro's axis carried round by rotation matrices, its rate integrated."""
    axis = np.array([0.0, 0.0, 1.0])
    tilt, theta = math.radians(table.tilt_deg), table.mounting_arcsec * RAD_PER_ARCSEC
    z = np.array([math.sin(tilt), 0.0, math.cos(tilt)])
    x = z * math.cos(tilt) - axis  # in the plane of both axes, square to Z, and with ON . X = -sin(alpha)
    x /= np.linalg.norm(x)
    y = np.cross(z, x)
    beta = math.radians(beta_deg + table.phase_deg)
    gyro = math.sin(theta) * (math.cos(beta) * x + math.sin(beta) * y) + math.cos(theta) * z
    latitude = math.radians(table.latitude_deg)
    earth = EARTH_RATE_RAD_S * np.array([math.cos(latitude), 0.0, math.sin(latitude)])

    def rate(angle: float) -> float:
        return sign * 2.0 * math.pi / period_s * (1.0 + hunting * math.cos(angle + phase))

    def sensed(angle: float) -> float:
        turned = Rotation.from_rotvec(angle * axis).apply(gyro)
        return float(turned @ (rate(angle) * axis + earth)) / rate(angle)  # per unit of angle

    return quad(sensed, 0.0, sign * 2.0 * math.pi, epsabs=1e-14, epsrel=1e-13, limit=200)[0] / RAD_PER_ARCSEC


@pytest.mark.parametrize("beta_deg", [0.0, 77.0, 190.0, 301.0])
@pytest.mark.parametrize("sign", [1, -1])
def test_counts_of_one_revolution(beta_deg: float, sign: int) -> None:
    table = dataclasses.replace(IDEAL, mounting_arcsec=4000.0, bias_deg_h=0.0)
    counts = table.position_counts(beta_deg, np.random.default_rng(0))[0 if sign > 0 else 1]
    assert table.scale_arcsec * counts == pytest.approx(integrated_arcsec(table, beta_deg, 36.0, sign=sign), abs=1e-7)


def test_square_part_of_earth_rate_by_direct_integration() -> None:
    """With the rate varying once a revolution, -omega_h sin(gamma) r tau / 2 cos(phases) remains; 0.17 arcsec at most for 1e-3."""
    r, period_s = 1e-3, 36.0
    table = dataclasses.replace(IDEAL, mounting_arcsec=0.0)
    residuals = [
        integrated_arcsec(table, 0.0, period_s, hunting=r, phase=phase) - integrated_arcsec(table, 0.0, period_s)
        for phase in np.linspace(0.0, 2.0 * math.pi, 8, endpoint=False)
    ]
    horizontal = EARTH_RATE_RAD_S * math.cos(math.radians(table.latitude_deg)) / RAD_PER_ARCSEC
    expected = horizontal * period_s * r / 2.0 * math.sin(math.radians(table.tilt_deg))
    assert expected == pytest.approx(0.17, abs=0.005)
    assert max(residuals) == pytest.approx(expected, rel=0.01)
    drawn = dataclasses.replace(table, rate_error=r, bias_deg_h=0.0).position_counts(np.zeros(20000), np.random.default_rng(1))[0]
    drawn_arcsec = table.scale_arcsec * (drawn - drawn.mean())
    assert drawn_arcsec.std() == pytest.approx(expected / math.sqrt(2.0), rel=0.02)


@pytest.mark.parametrize("beta_deg", [10.0, 250.0])
def test_counts_of_a_recording_agree_with_direct_integration(beta_deg: float) -> None:
    """One revolution, from 100 Hz samples: half a sample's rounding of the perpendicular Earth rate is all that differs."""
    table = dataclasses.replace(IDEAL, bias_deg_h=0.0)
    turns = whole_revolutions(table.position_recording(beta_deg, 1), "angle_outer_deg")
    for sign, counts in zip(turns["direction"], turns["pulses"], strict=True):
        assert table.scale_arcsec * counts == pytest.approx(integrated_arcsec(table, beta_deg, 36.0, sign=sign), abs=2e-3)


def test_rate_recording_has_every_revolution_and_the_rate_that_was_asked_for() -> None:
    recording = PositionTable().rate_recording(2, 3, rates_deg_s=[20.0, 90.0], revolutions=3, step_s=0.02)
    found = constant_rate_segments(whole_revolutions(recording, "table_angle_deg"))
    assert found["turns"].tolist() == [3] * 8
    assert found["direction"].tolist() == [1, -1] * 4
    assert found["rate_deg_s"].abs().to_numpy() == pytest.approx(np.repeat([20.0, 90.0], 4), rel=1e-4)


def test_lock_in_lowers_a_steady_rate_by_the_root() -> None:
    table = dataclasses.replace(IDEAL, lock_in_deg_s=0.5, latitude_deg=0.0, mounting_arcsec=0.0, bias_deg_h=0.0)
    runs = constant_rate_segments(
        whole_revolutions(table.rate_recording(1, 0, rates_deg_s=5.0, revolutions=2), "table_angle_deg")
    ).assign(run=0)
    (pulses,) = direction_pairs(runs, ["run"])["pulses_plus"]
    assert pulses * table.scale_arcsec / ARCSEC_PER_TURN == pytest.approx(math.sqrt(1.0 - 0.01), abs=1e-6)


@pytest.mark.parametrize("reading", ["uniform", "gaussian"])
def test_stated_errors_are_drawn_as_read(reading: str) -> None:
    table = dataclasses.replace(
        IDEAL,
        reading=reading,
        errors=TableErrors().only("positioning_arcsec"),
        latitude_deg=0.0,
        bias_deg_h=0.0,
        mounting_arcsec=0.0,
    )
    counts = table.position_counts(np.zeros(40000), np.random.default_rng(2))[0] * table.scale_arcsec
    error = counts / math.cos(math.radians(45.0)) - ARCSEC_PER_TURN
    assert error.std() == pytest.approx(2.0 / math.sqrt(3.0) if reading == "uniform" else 2.0 / 3.0, rel=0.02)
    assert (np.abs(error) <= 2.0 + 1e-6).all() == (reading == "uniform")


def test_same_seed_same_recording() -> None:
    one, other, third = (PositionTable().rate_recording(1, seed, revolutions=1).table for seed in (1, 1, 2))
    assert one.equals(other)
    assert not one["gyro_pulses"].equals(third["gyro_pulses"])


@pytest.mark.parametrize(
    "wrong", [{"scale_arcsec": 0.0}, {"tilt_deg": 180.0}, {"reading": "worst"}, {"scale_arcsec": math.nan}, {"tilt_deg": math.nan}]
)
def test_impossible_tables_are_refused(wrong: dict[str, object]) -> None:
    with pytest.raises(InputError, match=next(iter(wrong))):
        PositionTable(**wrong)


def test_negative_errors_and_empty_motions_are_refused() -> None:
    with pytest.raises(InputError, match="wobble_arcsec"):
        TableErrors(wobble_arcsec=-1.0)
    with pytest.raises(InputError, match="must be positive"):
        PositionTable().rate_recording(1, 0, rates_deg_s=0.0)
    with pytest.raises(InputError, match="must be positive"):
        PositionTable().position_recording([0.0], 0, revolutions=0)
