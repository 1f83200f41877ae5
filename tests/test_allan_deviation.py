"""Allan deviation: values published by NIST and by Stable32, the definition itself as referee, gaps, intervals, the noise floor."""

from __future__ import annotations

import itertools
from pathlib import Path

import numpy as np
import pytest

import rlgcomp as rlg

# Stable32's results: file of the results, of the data, estimator
STABLE32 = [
    ("Cs5071A_adev_decade.txt", "Cs5071A_5071A_phase.txt.gz", "plain"),
    ("Cs5071A_oadev_decade.txt", "Cs5071A_5071A_phase.txt.gz", "overlapping"),
    ("gps_stable32_OADEV_octave.txt", "gps_gps_1pps_phase_data.txt.gz", "overlapping"),
    ("phasedat_phase_dat_adev.txt", "phasedat_PHASE.DAT", "plain"),
    ("phasedat_phase_dat_oadev.txt", "phasedat_PHASE.DAT", "overlapping"),
    ("ocxo_stable32_adev_alltau.txt", "ocxo_ocxo_frequency.txt.gz", "plain"),
    ("ocxo_stable32_oadev_alltau.txt", "ocxo_ocxo_frequency.txt.gz", "overlapping"),
    ("ocxo_stable32_hdev_alltau.txt", "ocxo_ocxo_frequency.txt.gz", "plain-hadamard"),
]


def nist_1000() -> np.ndarray:
    """The 1000-point set of W. J. Riley, NIST SP 1065 (2008), section 12.4: n -> 16807 n mod 2147483647 from 1234567890."""
    numbers = [1234567890]
    for _ in range(999):
        numbers.append(16807 * numbers[-1] % 2147483647)
    return np.array(numbers) / 2147483647


@pytest.mark.parametrize(
    ("estimator", "published"),
    [
        ("plain", [2.922319e-01, 9.965736e-02, 3.897804e-02]),
        ("overlapping", [2.922319e-01, 9.159953e-02, 3.241343e-02]),
        ("plain-hadamard", [2.943883e-01, 1.052754e-01, 3.910860e-02]),
        ("hadamard", [2.943883e-01, 9.581083e-02, 3.237638e-02]),
    ],
)
def test_published_values_of_nist(estimator: str, published: list[float]) -> None:
    """NIST SP 1065, table 31."""
    curve = rlg.allan_deviation(nist_1000(), np.arange(1000.0), [1.0, 10.0, 100.0], estimator=estimator)
    assert curve.deviation_deg_h == pytest.approx(published, rel=5e-7)


def stable32(folder: Path, results: str, data: str, estimator: str) -> tuple[np.ndarray, rlg.AllanDeviation]:
    """Stable32's table (factor, tau, number, alpha, lower, deviation, upper), and ours at the same averaging times."""
    lines = [line.split() for line in (folder / results).read_text().splitlines() if line.strip() and not line.startswith("#")]
    table = np.array([line for line in lines if len(line) == 7], dtype=float)
    values = np.loadtxt(folder / data)
    if "frequency" in data:
        rate, time_s = (values - 1e7) / 1e7, np.arange(float(len(values)))
    else:
        rate, time_s = np.diff(values), np.arange(1.0, len(values))
    return table, rlg.allan_deviation(rate, time_s, table[:, 1], estimator=estimator)


@pytest.mark.parametrize(("results", "data", "estimator"), STABLE32)
def test_stable32_to_the_printed_digits(shared: Path, results: str, data: str, estimator: str) -> None:
    table, curve = stable32(shared / "real" / "allan_reference_sets", results, data, estimator)
    assert len(table) > 10
    assert curve.tau_s == pytest.approx(table[:, 1])
    assert curve.differences.tolist() == table[:, 2].astype(int).tolist()
    assert [f"{value:.4e}" for value in curve.deviation_deg_h] == [f"{value:.4e}" for value in table[:, 5]]


@pytest.mark.parametrize(("results", "data", "estimator"), STABLE32[:3])
def test_intervals_of_stable32(shared: Path, results: str, data: str, estimator: str) -> None:
    """Where both name the same noise (all but the last three of one set), the bounds agree to 4e-4 of the deviation.

    Stable32's own chi-square is an approximation; the last digit printed would be 1e-5.
    """
    table, curve = stable32(shared / "real" / "allan_reference_sets", results, data, estimator)
    same = curve.alpha == table[:, 3]
    assert same.sum() >= len(table) - 3
    assert same[table[:, 2] > 5000].sum() >= 13 or estimator == "plain"
    for ours, column in ((curve.lower_deg_h, 4), (curve.upper_deg_h, 6)):
        assert np.abs(ours / table[:, column] - 1.0)[same].max() < 4e-4


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


@pytest.mark.parametrize("estimator", ["overlapping", "plain", "hadamard", "plain-hadamard"])
def test_gaps_leave_the_estimate_over_the_parts(estimator: str) -> None:
    """With gaps: the mean over the parts, each taken alone, weighted with its differences."""
    rng = np.random.default_rng(8)
    rate = rng.standard_normal(3000).cumsum()
    lengths = (700, 41, 1300, 9, 950)
    edges = np.cumsum((0, *lengths))
    time_s = np.arange(3000.0) + 1000.0 * np.repeat(np.arange(5), lengths)
    whole = rlg.allan_deviation(rate, time_s, [1.0, 8.0, 64.0], estimator=estimator)
    total, taken = np.zeros(3), np.zeros(3, dtype=int)
    for start, stop in itertools.pairwise(edges):
        part = rlg.allan_deviation(rate[start:stop], time_s[start:stop], [1.0, 8.0, 64.0], estimator=estimator)
        fits = len(part.tau_s)
        total[:fits] += part.deviation_deg_h**2 * part.differences
        taken[:fits] += part.differences
    assert whole.parts.tolist() == list(lengths)
    assert whole.differences.tolist() == taken.tolist()
    assert whole.deviation_deg_h == pytest.approx(np.sqrt(total / taken), rel=1e-9)


def test_random_gaps_leave_no_bias_and_true_intervals() -> None:
    """White noise with 2 % of the samples lost, 200 times: mean within 4 standard errors, scatter as the degrees of freedom say."""
    rng = np.random.default_rng(9)
    variances, edf = [], []
    for _ in range(200):
        kept = np.flatnonzero(rng.random(4000) > 0.02)
        curve = rlg.allan_deviation(rng.standard_normal(len(kept)), kept.astype(float), [1.0, 4.0, 16.0])
        variances.append(curve.deviation_deg_h**2 * curve.tau_s)
        edf.append(curve.edf)
    scatter = np.std(variances, axis=0, ddof=1)
    assert (np.abs(np.mean(variances, axis=0) - 1.0) < 4.0 * scatter / np.sqrt(200)).all()
    assert scatter == pytest.approx(np.sqrt(2.0 / np.mean(edf, axis=0)), rel=0.25)


def test_hadamard_does_not_see_a_drift() -> None:
    rng = np.random.default_rng(10)
    rate, time_s = rng.standard_normal(5000), np.arange(5000.0)
    for estimator in ("hadamard", "plain-hadamard"):
        still = rlg.allan_deviation(rate, time_s, estimator=estimator)
        drifting = rlg.allan_deviation(rate + 0.01 * time_s, time_s, estimator=estimator)
        assert drifting.deviation_deg_h == pytest.approx(still.deviation_deg_h, rel=1e-6)
    assert rlg.allan_deviation(rate + 0.01 * time_s, time_s).deviation_deg_h[-1] == pytest.approx(
        1000 * 0.01 / np.sqrt(2), rel=0.02
    )


@pytest.mark.parametrize("confidence", [0.683, 0.95])
def test_intervals_hold_the_truth_as_often_as_they_say(confidence: float) -> None:
    """500 white records: coverage within 4 standard errors, at many and at few degrees of freedom."""
    rng = np.random.default_rng(11)
    held = []
    for _ in range(500):
        curve = rlg.allan_deviation(rng.standard_normal(600), np.arange(600.0), [1.0, 10.0, 120.0], confidence=confidence)
        truth = 1.0 / np.sqrt(curve.tau_s)
        held.append((curve.lower_deg_h <= truth) & (truth <= curve.upper_deg_h))
    error = np.sqrt(confidence * (1.0 - confidence) / 500)
    assert np.abs(np.mean(held, axis=0) - confidence).max() < 4.0 * error + 0.01  # 0.01: noise types found amiss at 5 means


def test_jittered_stamps_are_no_gaps() -> None:
    """Time stamps of 64 Hz rounded to milliseconds step by 15 or 16 ms; the period is their mean."""
    time_s = np.round(np.arange(6400) / 64.0, 3)
    curve = rlg.allan_deviation(np.random.default_rng(13).standard_normal(6400), time_s)
    assert curve.parts.tolist() == [6400]
    assert curve.period_s == pytest.approx(1.0 / 64.0, rel=1e-5)


def test_a_constant_has_none() -> None:
    assert rlg.allan_deviation(np.full(100, 11.7), np.arange(100.0)).deviation_deg_h.max() < 1e-12


def test_noise_floor_is_the_white_part() -> None:
    """With drift and quantization added, the white noise of 100 s means is still found within 5 %."""
    model = rlg.NoiseModel(0.0003, quantization_arcsec=0.02)
    rate = sum(model.simulate(40_000, 1.0, 2).values()) + 1e-6 * np.arange(40_000)
    floor = rlg.allan_deviation(rate, np.arange(40_000.0)).white_noise_deg_h(100.0)
    assert floor == pytest.approx(0.0018, rel=0.05)


@pytest.mark.parametrize(
    ("model", "hours", "draws", "within"),
    [
        (rlg.NoiseModel(0.0003), 1.0, 120, 0.01),  # the smallest measured value lies 6 % below it
        (rlg.NoiseModel(0.0003), 11.0, 20, 0.01),
        (rlg.NoiseModel(0.0003, 0.002), 1.0, 40, 0.01),
        (rlg.NoiseModel(0.0003, 0.0, 0.02), 1.0, 40, 0.01),
        (rlg.NoiseModel(0.0003, quantization_arcsec=0.2), 1.0, 40, 0.015),
        (rlg.NoiseModel(0.0003, 0.001, 0.01, 0.05), 4.0, 40, 0.02),
    ],
    ids=["white", "long", "flicker", "walk", "quantization", "all"],
)
def test_noise_floor_is_not_the_smallest_of_values_that_scatter(
    model: rlg.NoiseModel, hours: float, draws: int, within: float
) -> None:
    samples = round(3600 * hours)
    found = []
    for seed in range(draws):
        rate = np.sum([values[-samples:] for values in model.simulate(2 * samples, 1.0, seed).values()], axis=0)
        curve = rlg.allan_deviation(rate, np.arange(float(samples)))
        found.append(curve.white_noise_deg_h(100.0))
    tau_s = curve.tau_s[curve.tau_s <= 100.0]
    true = np.sqrt((model.allan_variance(tau_s) * tau_s / 100.0).min())
    assert np.mean(found) == pytest.approx(true, rel=within)


def test_noise_floor_is_not_above_a_curve_that_is_no_sum_of_noises() -> None:
    """Between the humps of a strong line the curve comes down to the white noise, where no sum of powers of tau goes."""
    line = rlg.NoiseModel(0.0003, dither_residual_arcsec=0.2, dither_residual_frequency_hz=0.03)
    rate = np.sum(list(line.simulate(40_000, 1.0, 3).values()), axis=0)
    curve = rlg.allan_deviation(rate, np.arange(40_000.0))
    inside = curve.tau_s <= 100.0
    at_most = curve.deviation_deg_h[inside] * np.sqrt(curve.tau_s[inside] / 100.0) * (1.0 + 1.5 * np.sqrt(2.0 / curve.edf[inside]))
    assert curve.white_noise_deg_h(100.0) <= at_most.min()
    assert rlg.allan_deviation(np.full(100, 11.0), np.arange(100.0)).white_noise_deg_h(10.0) == 0.0


def test_interpolation_and_table() -> None:
    curve = rlg.allan_deviation(nist_1000(), np.arange(1000.0), [1.0, 10.0, 100.0])
    assert curve.at(10.0) == pytest.approx(curve.deviation_deg_h[1])
    assert [curve.at(1.0), curve.at(100.0)] == pytest.approx(curve.deviation_deg_h[[0, 2]].tolist())
    for outside in (0.9, 0.0, -1.0, 1e9, float("nan")):
        with pytest.raises(rlg.InputError, match="goes from 1 to 100 s"):
            curve.at(outside)
    assert list(curve.to_frame())[:4] == ["tau_s", "deviation_deg_h", "lower_deg_h", "upper_deg_h"]


@pytest.mark.parametrize(
    ("rate", "time_s", "options", "message"),
    [
        ([1.0, 2.0], [0.0, 1.0], {}, "at least"),
        (np.arange(10.0), np.arange(10.0), {"tau_s": [100.0]}, "no averaging time"),
        (np.arange(10.0), np.arange(9.0), {}, "one column"),
        (np.r_[np.arange(9.0), np.nan], np.arange(10.0), {}, "not finite"),
        (np.arange(10.0), np.zeros(10), {}, "do not increase"),
        (np.arange(10.0), np.arange(10.0), {"estimator": "modified"}, "known are overlapping"),
        (np.arange(10.0), np.arange(10.0), {"confidence": 95.0}, "between 0 and 1"),
        (np.arange(10.0), np.arange(10.0), {"tau_s": [np.inf]}, "not finite"),
    ],
)
def test_bad_input_is_refused(rate: np.ndarray, time_s: np.ndarray, options: dict[str, object], message: str) -> None:
    with pytest.raises(rlg.InputError, match=message):
        rlg.allan_deviation(rate, time_s, **options)
