"""Filters: against closed forms and SciPy's integrator, whole and in pieces."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import solve_ivp
from scipy.signal import lfilter

from rlgcomp.numerics.filters import decaying, lag, low_pass, rate_per_min, rate_window_s


def test_lag_solves_its_equation() -> None:
    """tau y' = x - y for a broken line, against an adaptive integrator of order 8."""
    time_s = np.array([0.0, 10.0, 20.0, 25.0, 60.0, 61.0, 100.0])
    values = np.array([1.0, 3.0, 2.0, 2.0, -4.0, 0.0, 1.0])
    exact = solve_ivp(
        lambda t, y: (np.interp(t, time_s, values) - y) / 17.0,
        (0.0, 100.0),
        [1.0],
        method="DOP853",
        t_eval=time_s,
        rtol=1e-11,
        atol=1e-12,
        max_step=0.5,
    )
    assert lag(values, time_s, 17.0) == pytest.approx(exact.y[0], abs=1e-8)


@pytest.mark.parametrize(("share", "size"), [(0.97, 500), (0.9 + 0.1j, 500), (0.97, 25_000)])  # the last is compiled
def test_values_that_decay_are_those_of_scipys_filter(share: complex, size: int) -> None:
    values = np.random.default_rng(0).standard_normal(size) * (share / abs(share))
    assert np.array_equal(decaying(np.array([share]), values), lfilter([1.0], [1.0, -share], values))


def test_lag_of_uniform_and_uneven_time_agree() -> None:
    values = np.random.default_rng(0).standard_normal(500).cumsum()
    time_s = 2.0 * np.arange(500)
    uneven = time_s.copy()
    uneven[-1] += 1e-4  # takes the other path through the code
    assert lag(values, time_s, 30.0)[:-1] == pytest.approx(lag(values, uneven, 30.0)[:-1], abs=1e-12)


def test_lag_of_a_ramp() -> None:
    """After many time constants the output is behind by rate times tau."""
    time_s = np.arange(2000.0)
    behind = 0.01 * time_s - lag(0.01 * time_s, time_s, 100.0)
    assert behind[-1] == pytest.approx(0.01 * 100.0, rel=1e-6)


@given(st.lists(st.floats(-1e6, 1e6), min_size=2, max_size=60), st.floats(0.0, 1e4), st.integers(0, 59))
def test_low_pass_in_pieces_gives_the_same_bits(values: list[float], time_constant_s: float, cut: int) -> None:
    x, steps = np.array(values), np.full(len(values), 0.7)
    steps[0] = 0.0
    whole, last = low_pass(x[0], x, steps, time_constant_s)
    first, state = low_pass(x[0], x[:cut], steps[:cut], time_constant_s)
    second, end = low_pass(state, x[cut:], steps[cut:], time_constant_s)
    assert np.array_equal(whole, np.r_[first, second])
    assert last == end


def test_low_pass_approaches_its_equation() -> None:
    time_s = np.arange(0.0, 500.0, 0.1)
    values = np.sin(time_s / 40.0)
    filtered, _ = low_pass(0.0, values, np.diff(time_s, prepend=0.0), 50.0)
    assert filtered == pytest.approx(lag(values, time_s, 50.0), abs=3e-3)


def test_low_pass_without_time_constant_passes_through() -> None:
    values = np.array([1.0, 5.0, -2.0])
    assert np.array_equal(low_pass(1.0, values, np.array([0.0, 1.0, 1.0]), 0.0)[0], values)


def test_rate_of_a_straight_line_is_exact_even_at_the_ends_and_over_gaps() -> None:
    time_s = np.r_[np.arange(300.0), 400.0 + np.arange(300.0)]
    assert rate_per_min(3.0 + 0.02 * time_s, time_s) == pytest.approx(np.full(600, 1.2), rel=1e-9)


@pytest.mark.parametrize("window_s", [120.0, 1200.0])
def test_rate_at_the_end_of_a_year_is_as_good_as_on_its_first_day(window_s: float) -> None:
    """Sums of t² carried on from the beginning of a year hold no digit of a window of minutes."""
    day = np.arange(0.0, 86400.0, 60.0)
    time_s = np.arange(0.0, 365.0 * 86400.0, 60.0)
    values = 20.0 + 10.0 * np.sin(2.0 * np.pi * time_s / 86400.0)
    rate = rate_per_min(values, time_s, window_s)
    inside = slice(30, len(day) - 30)
    assert rate[-len(day) :][inside] == pytest.approx(rate_per_min(values[: len(day)], day, window_s)[inside], abs=1e-9)
    true = 60.0 * 10.0 * 2.0 * np.pi / 86400.0 * np.cos(2.0 * np.pi * time_s / 86400.0)
    assert np.abs(rate - true)[30:-30].max() < 1e-3 * true.std()


@pytest.mark.parametrize("window_s", [3.0, 700.0, 40_000.0])
def test_rate_is_that_of_a_straight_line_fitted_to_each_window(window_s: float) -> None:
    rng = np.random.default_rng(3)
    time_s = np.cumsum(rng.uniform(0.5, 1.5, 5000))
    values = 20.0 + np.cumsum(rng.standard_normal(5000))
    half = max(1, round(0.5 * window_s / float(np.median(np.diff(time_s)))))
    rate = rate_per_min(values, time_s, window_s)
    for k in (0, 1, 511, 512, 2047, 2500, 4999):
        window = slice(max(k - half, 0), k + half + 1)
        slope = np.polynomial.polynomial.polyfit(time_s[window] - time_s[k], values[window], 1)[1]
        assert rate[k] == pytest.approx(60.0 * slope, rel=1e-6, abs=1e-9)


def test_rate_has_the_noise_of_a_fitted_slope() -> None:
    """Slope over m samples of step h: sd = sigma sqrt(12 / m (m² - 1)) / h."""
    noise = np.random.default_rng(1).standard_normal(200_000)
    slope = rate_per_min(noise, np.arange(200_000.0), 120.0)[200:-200]
    m = 121
    assert slope.std() == pytest.approx(60.0 * np.sqrt(12.0 / (m * (m**2 - 1))), rel=0.03)


@pytest.mark.parametrize(
    ("amplitude_K", "period_s", "step_s", "rounded_K", "noise_K", "most"),
    [
        (1.0, 86400.0, 10.0, 0.0, 0.01, 0.15),  # a laboratory's day: over two minutes noise has half again the rate's size
        (20.0, 21600.0, 1.0, 0.5, 0.01, 0.15),  # a thermometer of half a kelvin: two fifths
        (2.0, 300.0, 1.0, 0.0, 0.01, 0.2),  # a thermostat's cycle is no noise: four minutes would halve it
    ],
)
def test_window_of_a_rate_is_as_long_as_noise_and_rounding_ask_and_no_longer(
    amplitude_K: float, period_s: float, step_s: float, rounded_K: float, noise_K: float, most: float
) -> None:
    time_s = np.arange(0.0, 43200.0, step_s)
    phase = 2.0 * np.pi * time_s / period_s
    true = 60.0 * amplitude_K * 2.0 * np.pi / period_s * np.cos(phase)
    values = amplitude_K * np.sin(phase) + noise_K * np.random.default_rng(5).standard_normal(len(time_s))
    if rounded_K:
        values = np.round(values / rounded_K) * rounded_K
    error = (rate_per_min(values, time_s) - true)[150:-150]
    assert error.std() < most * true.std()


def test_window_of_a_rate_is_two_minutes_for_a_chamber_thermometer() -> None:
    time_s = np.arange(0.0, 43200.0)
    values = 20.0 * np.sin(2.0 * np.pi * time_s / 21600.0) + 0.02 * np.random.default_rng(6).standard_normal(len(time_s))
    assert rate_window_s(values, time_s) == 120.0
    assert rate_window_s(np.full(3001, 20.0), time_s[:3001]) == 120.0
    assert rate_window_s(np.full(501, 20.0), time_s[:501]) == pytest.approx(20.0)


@pytest.mark.parametrize("lasts_s", [0.3, 40.0, 2400.0])
def test_rate_of_a_short_run_is_as_good_as_that_of_a_long_one(lasts_s: float) -> None:
    """A run of seconds, in which a window of two minutes would take a straight line through all of it."""
    time_s = np.linspace(0.0, lasts_s, 5001)
    phase = 2.0 * np.pi * 2.0 * time_s / lasts_s
    values = 2.0 * np.sin(phase) + 0.002 * np.random.default_rng(5).standard_normal(len(time_s))
    true = 60.0 * 2.0 * 2.0 * np.pi * 2.0 / lasts_s * np.cos(phase)
    error = (rate_per_min(values, time_s) - true)[150:-150]
    assert error.std() < 0.15 * true.std()


def test_rate_is_the_same_of_a_run_in_another_unit_of_time() -> None:
    time_s = np.arange(0.0, 3000.0)
    values = 0.2 * np.round(5.0 * (20.0 * np.sin(time_s / 500.0) + 0.2 * np.random.default_rng(7).standard_normal(len(time_s))))
    assert 1e-3 * rate_per_min(values, 1e-3 * time_s) == pytest.approx(rate_per_min(values, time_s), rel=1e-6, abs=1e-9)
