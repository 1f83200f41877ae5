"""Allan deviation: NIST's published values, the definition itself as referee, gaps, and the noise floor."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import rlgcomp as rlg


def nist_1000() -> np.ndarray:
    """The 1000-point set of W. J. Riley, NIST SP 1065 (2008), section 12.4: n -> 16807 n mod 2147483647 from 1234567890."""
    numbers = [1234567890]
    for _ in range(999):
        numbers.append(16807 * numbers[-1] % 2147483647)
    return np.array(numbers) / 2147483647


def test_published_values_of_nist() -> None:
    curve = rlg.allan_deviation(nist_1000(), np.arange(1000.0), [1.0, 10.0, 100.0])
    assert curve.deviation_deg_h == pytest.approx([2.922319e-01, 9.159953e-02, 3.241343e-02], rel=5e-7)


def test_published_values_against_the_file(shared: Path) -> None:
    series = np.loadtxt(shared / "real" / "allan_reference_sets" / "nbs14_1000_frequency.txt", comments="#")
    assert nist_1000() == pytest.approx(series.ravel()[:1000], abs=1e-9)


def test_its_definition() -> None:
    rate = np.random.default_rng(5).standard_normal(300).cumsum()
    m = 7
    means = np.convolve(rate, np.ones(m) / m, mode="valid")
    expected = np.sqrt(0.5 * np.mean((means[m:] - means[:-m]) ** 2))
    curve = rlg.allan_deviation(rate, 0.5 * np.arange(300), [3.5])
    assert curve.deviation_deg_h[0] == pytest.approx(expected, rel=1e-10)
    assert (curve.tau_s[0], curve.differences[0]) == (3.5, 300 - 2 * m + 1)


def test_no_difference_spans_a_gap() -> None:
    rng = np.random.default_rng(6)
    rate = rng.standard_normal(5000)
    time_s = np.arange(5000.0)
    time_s[2000:] += 777.0
    rate[2000:] += 50.0  # a jump that only a difference across the gap would see
    curve = rlg.allan_deviation(rate, time_s, [1.0, 10.0, 100.0])
    assert curve.deviation_deg_h == pytest.approx([1.0, 0.316, 0.1], rel=0.2)
    assert curve.differences.tolist() == [5000 - 2 * (2 * m - 1) for m in (1, 10, 100)]


def test_a_constant_has_none() -> None:
    assert rlg.allan_deviation(np.full(100, 11.7), np.arange(100.0)).deviation_deg_h.max() < 1e-12


def test_noise_floor_is_the_white_part() -> None:
    """With drift and quantization added, the white noise of 100 s means is still found within 5 %."""
    model = rlg.NoiseModel(0.0003, quantization_arcsec=0.02)
    rate = sum(model.simulate(40_000, 1.0, 2).values()) + 1e-6 * np.arange(40_000)
    floor = rlg.allan_deviation(rate, np.arange(40_000.0)).white_noise_deg_h(100.0)
    assert floor == pytest.approx(0.0018, rel=0.05)


def test_interpolation_and_table() -> None:
    curve = rlg.allan_deviation(nist_1000(), np.arange(1000.0), [1.0, 10.0, 100.0])
    assert curve.at(10.0) == pytest.approx(curve.deviation_deg_h[1])
    assert list(curve.to_frame())[:4] == ["tau_s", "deviation_deg_h", "lower_deg_h", "upper_deg_h"]


@pytest.mark.parametrize(("rate", "tau"), [([1.0, 2.0], None), (np.arange(10.0), [100.0])])
def test_too_short_a_record_is_refused(rate: np.ndarray, tau: list[float] | None) -> None:
    with pytest.raises(rlg.InputError):
        rlg.allan_deviation(rate, np.arange(float(len(rate))), tau)
