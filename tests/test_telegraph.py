"""Jumps between two values: the hidden Markov model of window means, and what is known of its likeliest path."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable

import numpy as np
import numpy.typing as npt
import pytest
from scipy import integrate, stats

from rlgcomp.diagnosis.naming import telegraph, two_levels
from rlgcomp.diagnosis.naming.two_levels import Models, drawn_signs, likeliest_signs, log_likelihood, smoothed
from rlgcomp.diagnosis.noise.whitening import Rows

Array = npt.NDArray[np.float64]
WINDOW_S = 100.0
STEP, NOISE, DWELL_S = 0.9, 0.7, 250.0


def rows_of(middles_s: Array, contrasts: int = 0) -> Rows:
    n = len(middles_s)
    time_s, run = np.r_[middles_s, np.zeros(contrasts)], np.repeat([0, 1], [n, contrasts])
    return Rows(time_s, run, np.ones(n + contrasts), WINDOW_S, contrasts)


def telegraph_means(count: int, dwell_s: float, rng: np.random.Generator) -> Array:
    """Window means of a sign that flips at any time."""
    length_s = count * WINDOW_S
    flips = np.r_[0.0, np.cumsum(rng.exponential(dwell_s, int(3.0 * length_s / dwell_s) + 30))]
    signs = rng.choice([-1.0, 1.0]) * (-1.0) ** np.arange(len(flips) - 1)
    area = np.r_[0.0, np.cumsum(np.diff(flips) * signs)]
    return np.asarray(np.diff(np.interp(WINDOW_S * np.arange(count + 1), flips, area)) / WINDOW_S)


def smear(value: float, power: int = 0) -> float:
    """Normal noise about every level between the two alike, times x to a power: by another's integral."""
    found, _ = integrate.quad(lambda x: 0.5 * x**power * stats.norm.pdf(value, STEP * x, NOISE), -1.0, 1.0, epsabs=1e-13)
    return float(found)


def all_ways(middles_s: Array, values: Array) -> tuple[float, Array, Array]:
    """Log likelihood, expected x and expected products of two, from every way that signs can take."""
    never, odd = math.exp(-WINDOW_S / DWELL_S), 0.5 * -math.expm1(-2.0 * WINDOW_S / DWELL_S)
    total, first, second = 0.0, np.zeros(len(values)), np.zeros((len(values), len(values)))
    between = [[smear(float(value), power) for power in (0, 1, 2)] for value in values]
    for ways in itertools.product(itertools.product((1.0, -1.0), ("flat", "again", "change")), repeat=len(values)):
        likely, x, square, last = 1.0, [], [], None
        for k, (begins, how) in enumerate(ways):
            gap = 0.5 if last is None else 0.5 * -math.expm1(-2.0 * (middles_s[k] - middles_s[k - 1] - WINDOW_S) / DWELL_S)
            likely *= 0.5 if last is None else (1.0 - gap if begins == last else gap)
            last = -begins if how == "change" else begins
            if how == "flat":
                likely *= never * float(stats.norm.pdf(values[k], STEP * begins, NOISE))
                x.append(begins)
                square.append(1.0)
            else:
                likely *= (odd if how == "change" else 1.0 - never - odd) * between[k][0]
                x.append(between[k][1] / between[k][0])
                square.append(between[k][2] / between[k][0])
        total += likely
        first += likely * np.array(x)
        products = np.outer(x, x)
        np.fill_diagonal(products, square)
        second += likely * products
    return math.log(total), first / total, second / total


@pytest.mark.parametrize("middles_s", [np.array([50.0, 150.0, 250.0, 350.0, 450.0]), np.array([50.0, 150.0, 700.0, 800.0, 1400.0])])
@pytest.mark.parametrize("compiled", [True, False])
def test_forward_and_backward_are_the_sum_over_all_ways(middles_s: Array, compiled: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    if compiled and not two_levels.available():
        pytest.skip("numba is not installed")
    monkeypatch.setattr(two_levels, "available", lambda: compiled)
    values = np.array([0.9, 1.3, 0.1, -1.1, -4.0])
    mean, square, found = smoothed(rows_of(middles_s), values[:, None], Models(*(np.array([x]) for x in (STEP, NOISE, DWELL_S))))
    log_total, first, second = all_ways(middles_s, values)
    assert found[0] == pytest.approx(log_total, abs=1e-9)
    np.testing.assert_allclose(mean[:, 0], first, atol=1e-9)
    np.testing.assert_allclose(square[:, 0], np.diag(second), atol=1e-9)


@pytest.mark.parametrize("compiled", [True, False])
def test_drawn_signs_are_as_usual_as_all_ways_say(compiled: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    if compiled and not two_levels.available():
        pytest.skip("numba is not installed")
    if not compiled:
        monkeypatch.setattr(two_levels, "draw_back", two_levels.draw_back.plain)
    middles_s, values, many = np.array([50.0, 150.0, 700.0, 800.0, 900.0]), np.array([0.9, 0.2, -0.3, 0.1, -1.1]), 20_000
    model = Models(np.array([STEP]), np.array([NOISE]), np.array([DWELL_S]))
    drawn = drawn_signs(rows_of(middles_s), values[:, None] * np.ones(many), model.times(many), np.random.default_rng(3))
    _, first, second = all_ways(middles_s, values)
    np.testing.assert_allclose(drawn.mean(axis=1), first, atol=5.0 / math.sqrt(many))
    np.testing.assert_allclose(drawn @ drawn.T / many, second, atol=5.0 / math.sqrt(many))
    assert (np.abs(drawn) <= 1.0).all()


def test_numbers_far_from_both_levels_are_no_trouble() -> None:
    values = np.array([0.0, 1e3, -1e3, 50.0, 0.5])
    models = Models(np.array([1e-3, 1.0, 20.0]), np.array([0.1, 0.01, 5.0]), np.array([400.0, 1e4, 1e6]))
    mean, square, found = smoothed(rows_of(50.0 + WINDOW_S * np.arange(5)), values[:, None] * np.ones(3), models)
    assert np.isfinite(found).all()
    assert (np.abs(mean) <= 1.0).all()
    assert (mean**2 <= square + 1e-12).all()
    assert (square <= 1.0 + 1e-12).all()


def test_windows_that_flip_are_no_noise() -> None:
    rng = np.random.default_rng(3)
    rows = rows_of(50.0 + WINDOW_S * np.arange(400))
    means = telegraph_means(400, 600.0, rng)
    values = 4.0 * means + rng.standard_normal(400)
    path, flips = likeliest_signs(rows, values, Models(np.array([4.0]), np.array([1.0]), np.array([600.0])))
    assert np.sqrt(np.mean((path - means) ** 2)) < 0.2
    assert flips > 40


def test_the_dwell_that_is_likeliest_is_the_true_one() -> None:
    rng = np.random.default_rng(4)
    rows, dwells = rows_of(50.0 + WINDOW_S * np.arange(864)), [300.0, 600.0, 1200.0, 2400.0]
    several = [telegraph_means(864, 600.0, rng) + rng.standard_normal(864) for _ in range(6)]
    assert int(np.argmax(sum(log_likelihood(rows, values, 1.0, 1.0, dwells) for values in several))) == 1


# --- the path, and how sure it is ------------------------------------------------------------------------------------------


def smooth_columns(count: int, contrasts: int = 0) -> Array:
    rng = np.random.default_rng(1)
    columns = np.vstack([np.vander(np.linspace(-1.0, 1.0, count), 4), 0.1 * rng.standard_normal((contrasts, 4))])
    return np.asarray(np.linalg.qr(columns)[0])


def test_a_path_of_jumps_is_found_and_noise_has_none_to_speak_of() -> None:
    rng = np.random.default_rng(9)
    rows, smooth = rows_of(50.0 + WINDOW_S * np.arange(400)), smooth_columns(400)
    means = telegraph_means(400, 3000.0, rng)
    path = telegraph.best_path(rows, 1.5 * means + rng.standard_normal(400) + smooth[:, 0] * 20.0, smooth)
    assert np.mean(np.abs(path.signs - means) < 0.3) > 0.9
    assert path.half_step == pytest.approx(1.5, abs=0.15)
    assert 1500.0 < path.dwell_s < 6000.0
    quiet = telegraph.best_path(rows, rng.standard_normal(400), smooth)
    column = quiet.signs - smooth @ (smooth.T @ quiet.signs)
    assert quiet.log_weight < -0.4 * float(column @ column) / 400.0 * 10.0


def test_rows_within_windows_have_no_part_in_a_path() -> None:
    rng = np.random.default_rng(10)
    rows, smooth = rows_of(50.0 + WINDOW_S * np.arange(300), contrasts=40), smooth_columns(300, 40)
    target = np.r_[2.0 * telegraph_means(300, 2000.0, rng), np.zeros(40)] + rng.standard_normal(340)
    path = telegraph.best_path(rows, target, smooth)
    assert not path.signs[300:].any()
    assert path.half_step == pytest.approx(2.0, abs=0.2)


def test_a_path_of_no_flip_is_no_trouble() -> None:
    rows, smooth = rows_of(50.0 + WINDOW_S * np.arange(200)), smooth_columns(200)
    assert math.isfinite(telegraph.best_path(rows, np.random.default_rng(2).standard_normal(200), smooth).log_weight)


def test_curvature_is_that_of_the_summed_likelihood() -> None:
    rng = np.random.default_rng(11)
    rows, smooth = rows_of(50.0 + WINDOW_S * np.arange(300)), smooth_columns(300)
    target = telegraph._Target(rows, 0.8 * telegraph_means(300, 900.0, rng) + rng.standard_normal(300), smooth)
    at = np.r_[smooth.T @ target.values, math.log(0.8), math.log(1.0)]

    def height(point: Array) -> float:
        values = target.without(point[:4, None])[:, 0]
        return float(log_likelihood(rows, values, math.exp(point[4]), math.exp(point[5]), [900.0])[0])

    found = telegraph._curvature(target, at[:4], Models(np.array([0.8]), np.array([1.0]), np.array([900.0])))
    np.testing.assert_allclose(found, -hessian(height, at, 0.01), atol=0.02 * np.abs(found).max())
    np.testing.assert_allclose(found[:4, :4], -hessian(height, at, 0.01)[:4, :4], atol=0.02)


def hessian(height: Callable[[Array], float], at: Array, nudge: float) -> Array:
    ways = nudge * np.eye(len(at))
    table = [[height(at + a + b) - height(at + a - b) - height(at - a + b) + height(at - a - b) for b in ways] for a in ways]
    return np.array(table) / (4.0 * nudge**2)


def test_a_path_weighs_what_the_average_over_the_smooth_part_says() -> None:
    r"""Against the integral, done by sums, of the likelihood of all paths over a bias: a path that is not sure leaves it free."""
    rng = np.random.default_rng(12)
    rows, bias = rows_of(50.0 + WINDOW_S * np.arange(250)), np.full((250, 1), 250.0**-0.5)
    for dwell_s, step in ((600.0, 0.5), (1200.0, 0.8), (1200.0, 3.0), (3600.0, 1.5)):
        values = step * telegraph_means(250, dwell_s, rng) + rng.standard_normal(250)
        target = telegraph._Target(rows, values, bias)
        model = Models(np.array([step]), np.array([1.0]), np.array([dwell_s]))
        grid = np.linspace(-50.0, 50.0, 4001) + float(bias[:, 0] @ values)
        heights = np.array([float(log_likelihood(rows, values - bias[:, 0] * b, step, 1.0, [dwell_s])[0]) for b in grid])
        summed = np.logaddexp.reduce(heights) + math.log(grid[1] - grid[0])
        curvature = telegraph._curvature(target, grid[[int(np.argmax(heights))]], model)[0, 0]
        laplace = heights.max() + 0.5 * math.log(2.0 * math.pi / curvature)
        known = heights.max() + 0.5 * math.log(2.0 * math.pi)
        assert laplace == pytest.approx(summed, abs=0.05)
        assert step > 0.5 or summed > known + 0.3


def test_standard_deviation_of_the_dwell_holds_the_chance_of_flips_and_those_unseen() -> None:
    rng = np.random.default_rng(6)
    rows = rows_of(WINDOW_S * (np.arange(700) + 0.5))
    off = []
    for dwell_s, half_step in itertools.product(np.repeat([1500.0, 3000.0], 20), [1.0, 3.0]):
        values = half_step * telegraph_means(len(rows), dwell_s, rng) + rng.standard_normal(len(rows))
        found_s, sd_s = telegraph.likeliest_dwell_s(rows, values, half_step, 1.0)
        assert sd_s > 0.9 * found_s / math.sqrt(len(rows) * WINDOW_S / found_s)
        off.append(math.log(found_s / dwell_s) * found_s / sd_s)
    assert stats.chi2.sf(float(np.square(off).sum()), len(off)) > 0.001
    assert stats.chi2.cdf(float(np.square(off).sum()), len(off)) > 0.001


def test_a_level_that_never_flips_leaves_its_dwell_open() -> None:
    rows = rows_of(WINDOW_S * (np.arange(300) + 0.5))
    found_s, sd_s = telegraph.likeliest_dwell_s(rows, 1.0 + 0.3 * np.random.default_rng(1).standard_normal(300), 1.0, 0.3)
    assert sd_s >= 0.9 * found_s


def test_a_strong_path_is_found_whole_beside_a_smooth_part_that_could_take_up_much_of_it() -> None:
    """From a smooth part that has taken up what it can of the jumps, expectation and maximisation end elsewhere."""
    count, wrong = 400, []
    share = np.linspace(-1.0, 1.0, count)
    columns = np.column_stack([np.ones(count), share, share**2, share**3, np.exp(-(share + 1.0) / 0.1)])
    for seed in range(12):
        rng = np.random.default_rng(seed)
        jumps = telegraph_means(count, 5000.0, rng)
        values = 2.8 * jumps + columns @ rng.normal(0.0, 5.0, 5) + rng.standard_normal(count)
        orthonormal = np.linalg.qr(columns)[0]
        path = telegraph.best_path(
            rows_of(WINDOW_S * (np.arange(count) + 0.5)), values - orthonormal @ (orthonormal.T @ values), orthonormal
        )
        wrong.append(int((np.sign(path.signs) != np.sign(jumps)).sum()))
    assert max(wrong) <= 0.02 * count
