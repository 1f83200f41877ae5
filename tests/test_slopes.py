"""Segments of constant slope, the noise that each indicates, and other findings of a curve."""

from __future__ import annotations

import numpy as np
import pytest

import rlgcomp as rlg
from rlgcomp.noise.slopes import curve_findings, slope_segments
from rlgcomp.report.messages import Message
from tests.noise_records import HOURS_5, WHITE, deviation, record


def findings(curve: rlg.AllanDeviation, **options: bool) -> tuple[Message, ...]:
    return curve_findings(curve, curve.noise(), **options)


def test_an_oscillation_is_reported_with_the_misfit_and_widens_the_errors() -> None:
    """An oscillation of 0.2 deg/h in white noise."""
    rate = record(WHITE, 1)
    white = deviation(rate)
    disturbed = deviation(rate + 0.2 * np.sin(2.0 * np.pi * np.arange(HOURS_5) / 60.0))
    assert white.noise().misfit == 0.0
    assert disturbed.noise().misfit > 0.1
    assert disturbed.noise().p_value < 1e-10
    assert disturbed.noise().angle_random_walk_deg_sqrt_h_sd > 3.0 * white.noise().angle_random_walk_deg_sqrt_h_sd
    by_code = {finding.code: finding.data for finding in findings(disturbed)}
    assert by_code["noise.misfit"]["misfit"] == disturbed.noise().misfit
    assert by_code["noise.maximum"]["frequency_hz"] == pytest.approx(1.0 / 60.0, rel=0.25)


def test_each_segment_indicates_its_noise() -> None:
    curve = deviation(record(rlg.NoiseModel(0.0004, quantization_arcsec=1.0), 2))
    segment = next(segment for segment in slope_segments(curve) if segment.long_enough)
    assert segment.nearest == -1.0
    assert segment.slope == pytest.approx(-1.0, abs=0.02)
    first = findings(curve)[0]
    assert (first.code, first.data["slope"]) == ("noise.slope_quantization", segment.slope)
    assert first.data["apparent_angle_random_walk_deg_sqrt_h"] == pytest.approx(curve.at(1.0) / 60.0)
    assert first.data["largest_angle_random_walk_deg_sqrt_h"] < 0.1 * curve.at(1.0) / 60.0
    (white,) = findings(deviation(record(WHITE, 2)))
    assert (white.code, white.data["coefficient"]) == ("noise.slope", "angle_random_walk_deg_sqrt_h")
    assert white.data["value"] == pytest.approx(0.0004, abs=4.0 * white.data["sd"])
    assert findings(curve, base_motion=True)[0].code == "noise.slope_with_base_motion"


def test_a_segment_ends_where_the_curve_departs_from_its_line() -> None:
    """Five decades of white noise, then flicker: no single step shows the departure from the line, together they do."""
    noise = rlg.NoiseModel(5e-4, bias_instability_deg_h=0.002)
    curve = deviation(sum(noise.simulate(1_000_000, 0.1, 4).values()), 0.1)
    white, flicker = (segment for segment in slope_segments(curve) if segment.long_enough)
    assert (white.nearest, flicker.nearest) == (-0.5, 0.0)
    assert 200.0 < white.to_s < 1500.0  # equal at (60 N)² / (B² 2 ln 2 / pi) = 510 s


def test_gaps_that_end_the_curve_early_are_reported() -> None:
    present = np.arange(HOURS_5) % 120 < 60
    curve = rlg.allan_deviation(record(WHITE, 2)[present], np.flatnonzero(present).astype(float))
    (early,) = [finding.data for finding in findings(curve) if finding.code == "noise.curve_ends_early"]
    assert (early["gaps"], early["longest_part_s"], early["averaging_s"]) == (len(curve.parts) - 1, 60.0, 10.0)
    assert early["last_tau_s"] == curve.tau_s[-1]
    assert "noise.curve_ends_early" not in {finding.code for finding in findings(deviation(record(WHITE, 2)))}
