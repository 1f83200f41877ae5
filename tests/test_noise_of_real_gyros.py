"""Noise of real ring laser gyros: residual dither, base motion, and Earth rate."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import rlgcomp as rlg
from rlgcomp.noise.analysis import NoiseAnalysis, analyse_noise
from rlgcomp.noise.slopes import slope_segments
from rlgcomp.units import EARTH_RATE_DEG_H

LN100 = (
    {"time_s": "t_s"}
    | {f"gyro_{axis}_deg_s": f"gyro_{axis}_dps" for axis in "xyz"}
    | {f"accel_{axis}_m_s2": f"acc_{axis}_mps2" for axis in "xyz"}
)
PSINS = {f"gyro_{axis}_pulses": f"g{axis}_cnt" for axis in "xyz"} | {f"accel_{axis}": f"a{axis}_cnt" for axis in "xyz"}


def ln100(shared: Path, direction: str) -> rlg.Recording:
    return rlg.read(shared / "real" / "rlg_ln100_up_down" / f"ln100_x_{direction}.parquet", columns=LN100)


@pytest.fixture
def vehicle(shared: Path) -> list[NoiseAnalysis]:
    path = shared / "real" / "rlg_psins_vehicle_static" / "lasergyro_counts.parquet"
    recording = rlg.read(path, columns=PSINS, metadata={"pulse_arcsec": 0.1}, period_s=0.01)
    return [analyse_noise(recording, column) for column in recording.gyro_columns]


def test_earth_rate_from_the_pair_up_and_down(shared: Path) -> None:
    """11.70 deg/h expected at 51.0784 deg; half the difference cancels the bias and shows 11.73, the rest is not noise."""
    up, down = (float(ln100(shared, direction).rate_deg_h("gyro_x_deg_s").mean()) for direction in ("up", "down"))
    assert 0.5 * (up - down) == pytest.approx(11.732, abs=0.001)
    assert EARTH_RATE_DEG_H * np.sin(np.radians(51.0784)) == pytest.approx(11.702, abs=0.001)
    assert 0.5 * (up + down) == pytest.approx(-0.254, abs=0.001)


@pytest.mark.parametrize("direction", ["up", "down"])
@pytest.mark.parametrize("axis", ["x", "y", "z"])
def test_ln100_shows_residual_dither_and_no_angle_random_walk(shared: Path, direction: str, axis: str) -> None:
    analysis = analyse_noise(ln100(shared, direction), f"gyro_{axis}_deg_s")
    (segment,) = [one for one in slope_segments(analysis.deviation) if one.long_enough]
    assert (segment.from_s < 0.05, segment.to_s > 30.0) == (True, True)
    assert segment.slope == pytest.approx(-1.0, abs=0.12)
    assert analysis.findings[0].code == "noise.slope_quantization"
    # an N read at 1 s, and the fitted one
    read_at_1_s = analysis.findings[0].data["apparent_angle_random_walk_deg_sqrt_h"]
    assert read_at_1_s == pytest.approx(analysis.deviation.at(1.0) / 60.0)
    assert read_at_1_s > 0.02
    assert analysis.coefficients.angle_random_walk_deg_sqrt_h < 0.1 * read_at_1_s
    assert analysis.coefficients.angle_random_walk_deg_sqrt_h_sd < 0.5 * read_at_1_s
    # its lines are the dither of three gyros, sampled at 64 Hz; the accelerometers on the block show them too
    assert analysis.stationarity is not None
    assert analysis.stationarity.lines.share > 0.7
    assert any(abs(frequency - 29.9) < 0.2 for frequency in analysis.stationarity.lines.frequency_hz)
    assert not analysis.stationarity.base_motion
    assert "noise.narrow_lines" in {finding.code for finding in analysis.findings}


def test_the_accelerometers_show_the_motion_of_a_parked_vehicle(vehicle: list[NoiseAnalysis]) -> None:
    assert [analysis.mean_deg_h for analysis in vehicle] == pytest.approx([-12.271, 0.438, 8.357], abs=0.001)
    for analysis in vehicle:
        found = analysis.stationarity
        assert found is not None
        assert not found.stationary
        assert found.base_motion
        assert max(motion.coherence for motion in found.motions) > 0.9
        assert analysis.findings[0].code == "noise.slope_with_base_motion"
        codes = {finding.code for finding in analysis.findings}
        assert {"noise.not_stationary", "noise.base_motion", "noise.base_motion_limits", "noise.maximum"} <= codes
    sway = max((motion for motion in vehicle[1].stationarity.motions), key=lambda motion: motion.share)  # type: ignore[union-attr]
    assert sway.accelerometer == "accel_x"
    assert sway.share > 0.7


def test_first_half_of_the_vehicle_is_the_noisier(shared: Path) -> None:
    """10 s means scatter by 11, 17, 1.7 deg/h in the first half and 6, 10, 1.0 in the second."""
    recording = rlg.read(
        shared / "real" / "rlg_psins_vehicle_static" / "lasergyro_counts.parquet",
        columns=PSINS,
        metadata={"pulse_arcsec": 0.1},
        period_s=0.01,
    )
    for column in recording.gyro_columns:
        rate = recording.rate_deg_h(column)
        halves = [rlg.allan_deviation(part, 0.01 * np.arange(len(part)), [10.0]) for part in np.array_split(rate, 2)]
        assert halves[0].lower_deg_h[0] > halves[1].upper_deg_h[0]
