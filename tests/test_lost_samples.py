"""Lost samples: a mean counts where 80 % of its samples are there, in memory, in pieces and for stationarity alike."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import rlgcomp as rlg
from rlgcomp.noise import allan_sums as sums
from rlgcomp.noise.allan_deviation import gaps_of
from rlgcomp.noise.analysis import analyse_noise
from rlgcomp.noise.lost_samples import Gaps, most_lost
from rlgcomp.noise.out_of_core import analyse_pieces
from rlgcomp.noise.stationarity import check_stationarity
from rlgcomp.recording.formats.pieces import read_pieces
from tests.noise_records import rate_table, written

Array = np.ndarray
N = 4000


def with_losses(kind: str, seed: int = 1, n: int = N) -> Array:
    """Rows that are there."""
    rng = np.random.default_rng(seed)
    present = np.ones(n, dtype=bool)
    if kind == "one":
        present[n // 3] = False
    elif kind == "few":
        present[[50, 51, 52, 900, 1500, 1502, n - 60]] = False
    elif kind == "many":
        present = rng.random(n) > 0.03
    elif kind == "long":  # one that short windows cannot span, some that they can, and one that no window spans
        present[700:760] = present[2000:2003] = present[2500:2502] = False
        present[3000:3900] = False
    present[[0, n - 1]] = True
    return np.flatnonzero(present)


def by_definition(rate: Array, at: Array, m: int, order: int, *, every: int) -> tuple[float, int]:
    """Sum of squares and number of differences, from the definition: means of what is there, window by window."""
    grid = np.full(at[-1] + 1, np.nan)
    grid[at] = rate
    gaps = np.diff(at) - 1
    bridged = Gaps(np.r_[np.flatnonzero(gaps) + 1, len(at)], gaps[gaps > 0]).bridged
    broken = [at[row] + 1 for row, over in zip(np.flatnonzero(gaps), bridged, strict=True) if gaps[row] > most_lost(m) or not over]
    total, taken = 0.0, 0
    starts, stops = [0, *broken], [*broken, len(grid)]
    weights = np.array({2: (-1.0, 1.0), 3: (1.0, -2.0, 1.0)}[order])
    for begin, stop in zip(starts, stops, strict=True):
        start = begin + int(np.isfinite(grid[begin:stop]).argmax())  # a gap that ends a part has no place
        if stop - start < order * m:
            continue
        windows = np.lib.stride_tricks.sliding_window_view(grid[start:stop], m)
        counts = np.isfinite(windows).sum(axis=1)
        means = np.nansum(windows, axis=1) / np.maximum(counts, 1)
        at_windows = np.arange(0, stop - start - order * m + 1, every)[:, None] + m * np.arange(order)
        whole = counts[at_windows].min(axis=1) >= 0.8 * m - 1e-9
        lack = (weights**2 * m / counts[at_windows[whole]]).sum(axis=1) / (weights**2).sum()
        total += float(((means[at_windows[whole]] @ weights) ** 2 / lack).sum())
        taken += int(whole.sum())
    return total, taken


@pytest.mark.parametrize("many", [100, 1 << 40], ids=["compiled", "NumPy"])
@pytest.mark.parametrize("estimator", ["overlapping", "plain", "hadamard", "plain-hadamard"])
@pytest.mark.parametrize("kind", ["one", "few", "many", "long"])
def test_the_curve_is_that_of_the_definition(kind: str, estimator: str, many: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sums, "MANY", many)
    at = with_losses(kind)
    rate = np.random.default_rng(2).standard_normal(len(at))
    counts = [1, 4, 5, 13, 100, 400]
    curve = rlg.allan_deviation(rate, at.astype(float), counts, estimator=estimator)
    order = 3 if "hadamard" in estimator else 2
    for m, deviation, taken in zip(curve.tau_s.astype(int), curve.deviation_deg_h, curve.differences, strict=True):
        total, number = by_definition(rate, at, m, order, every=m if "plain" in estimator else 1)
        assert taken == number
        assert deviation == pytest.approx(np.sqrt(total / number / (2.0 if order == 2 else 6.0)), rel=1e-10)
    assert curve.tau_s.astype(int).tolist() == counts
    assert curve.parts.sum() == len(at)


@pytest.mark.parametrize("lost", [[5000], [2000, 2001, 2002, 9000], [100, 5000, 5003, 15000]])
def test_few_lost_samples_do_not_cut_an_allan_curve(lost: list[int]) -> None:
    rate = np.random.default_rng(10).standard_normal(20_000)
    time_s = np.arange(20_000.0)
    whole = rlg.allan_deviation(rate, time_s)
    kept = np.delete(np.arange(20_000), lost)
    curve = rlg.allan_deviation(rate[kept], time_s[kept])
    assert curve.tau_s == pytest.approx(whole.tau_s)
    assert curve.deviation_deg_h == pytest.approx(whole.deviation_deg_h, rel=0.03)
    assert curve.edf == pytest.approx(whole.edf, rel=0.01)
    assert (curve.spans.tolist(), int(curve.parts.sum())) == ([20_000], len(kept))
    given = rlg.allan_deviation(rate[kept], time_s[kept], [1.0, 100.0, 3000.0])
    assert given.tau_s == pytest.approx([1.0, 100.0, 3000.0])


def test_a_long_gap_ends_the_curve() -> None:
    rate = np.random.default_rng(11).standard_normal(20_000)
    kept = np.r_[0:9000, 14000:20000]
    curve = rlg.allan_deviation(rate[kept], kept.astype(float))
    assert curve.tau_s[-1] <= 9000 / 2
    assert curve.parts.tolist() == curve.spans.tolist() == [9000, 6000]


@pytest.mark.parametrize("share", [0.01, 0.1])
def test_lost_samples_leave_no_bias_and_true_intervals(share: float) -> None:
    """White noise, 200 times, averaging times far beyond the parts between losses."""
    rng = np.random.default_rng(9)
    variances, edf = [], []
    for _ in range(200):
        kept = np.flatnonzero(rng.random(4000) > share)
        curve = rlg.allan_deviation(rng.standard_normal(len(kept)), kept.astype(float), [16.0, 100.0, 400.0])
        variances.append(curve.deviation_deg_h**2 * curve.tau_s)
        edf.append(curve.edf)
    scatter = np.std(variances, axis=0, ddof=1)
    assert (np.abs(np.mean(variances, axis=0) - 1.0) < 4.0 * scatter / np.sqrt(200)).all()
    assert scatter == pytest.approx(np.sqrt(2.0 / np.mean(edf, axis=0)), rel=0.3)


@pytest.mark.parametrize("estimator", ["overlapping", "plain", "hadamard"])
def test_degrees_of_freedom_are_those_of_the_differences_that_are_left(estimator: str) -> None:
    """Three samples in ten lost: at long averaging times a few differences count, most of them next to each other."""
    rng = np.random.default_rng(12)
    kept = np.flatnonzero(rng.random(4000) > 0.3)
    curves = [
        rlg.allan_deviation(rng.standard_normal(len(kept)), kept.astype(float), [10.0, 20.0, 40.0, 80.0], estimator=estimator)
        for _ in range(300)
    ]
    scatter = [
        np.var(variances, ddof=1) / np.mean(variances) ** 2 for variances in np.transpose([c.deviation_deg_h**2 for c in curves])
    ]
    edf = np.median([curve.edf for curve in curves], axis=0)
    assert (edf <= curves[0].differences).all()
    assert edf == pytest.approx(2.0 / np.array(scatter), rel=0.4)
    assert curves[0].differences.min() < 60


def test_white_noise_with_many_lost_samples_is_white_noise() -> None:
    """N within its error and hardly a misfit: the few differences of long averaging times weigh as little as they should."""
    rng = np.random.default_rng(13)
    fits = []
    for _ in range(10):
        kept = np.flatnonzero(rng.random(8000) > 0.3)
        fits.append(rlg.allan_deviation(rng.standard_normal(len(kept)), kept.astype(float)).noise())
    assert sum(fit.misfit > 0.0 for fit in fits) <= 3
    assert max(fit.misfit for fit in fits) < 0.2
    scores = [(60.0 * fit.angle_random_walk_deg_sqrt_h - 1.0) / (60.0 * fit.angle_random_walk_deg_sqrt_h_sd) for fit in fits]
    assert np.sqrt(np.mean(np.square(scores))) < 1.6


@pytest.mark.parametrize("estimator", ["overlapping", "hadamard"])
@pytest.mark.parametrize("kind", ["one", "few", "many", "long"])
def test_pieces_give_the_curve_of_the_whole(tmp_path: Path, kind: str, estimator: str) -> None:
    path = written(rate_table(9000).iloc[with_losses(kind, n=9000)].reset_index(drop=True), tmp_path / "run.parquet")
    whole = analyse_noise(rlg.read(path), estimator=estimator, per_decade=5.0)
    found = analyse_pieces(read_pieces(path, "gyro_z_deg_h", rows=1700), "gyro_z_deg_h", estimator=estimator, per_decade=5.0)
    for name in ("tau_s", "differences", "alpha", "parts", "spans"):
        assert np.array_equal(getattr(found.deviation, name), getattr(whole.deviation, name))
    np.testing.assert_allclose(found.deviation.deviation_deg_h, whole.deviation.deviation_deg_h, rtol=1e-9)
    np.testing.assert_allclose(found.deviation.edf, whole.deviation.edf, rtol=1e-9)


@pytest.mark.parametrize("kind", ["whole", "one", "few", "many"])
def test_stationarity_compares_the_deviations_of_the_curve(kind: str) -> None:
    """Each segment's deviation is that of the segment taken alone."""
    at = with_losses(kind)
    rate = np.random.default_rng(3).standard_normal(len(at)) * np.where(at > N // 2, 2.0, 1.0)
    found = check_stationarity(rate, at.astype(float), segments=4)
    edges = np.searchsorted(at, np.linspace(at[0], at[-1] + 1.0, 5))
    for k, deviation in enumerate(found.deviation_deg_h):
        inside = slice(edges[k], edges[k + 1])
        alone = rlg.allan_deviation(rate[inside], at[inside].astype(float), [found.tau_s])
        assert deviation == pytest.approx(alone.deviation_deg_h[0], rel=1e-9)
    assert not found.stationary
    assert found.furthest_s > N // 2 - found.tau_s


def test_without_lost_samples_nothing_changes_by_a_bit() -> None:
    """The sums are those of the complete record, in the same order, also between gaps that no window spans."""
    for at in (np.arange(N), np.r_[0:1500, 9000:12000], np.r_[0:30, 90:120, 180:240]):
        rate = np.random.default_rng(4).standard_normal(len(at))
        period_s, gaps = gaps_of(at.astype(float))
        curve = rlg.allan_deviation(rate, at.astype(float))
        assert (period_s, gaps.bridged.any()) == (1.0, False)
        assert (curve.spans == curve.parts).all()
        total, taken = sums.sums_of_squares(sums.angle_of(rate), gaps.ends, np.rint(curve.tau_s).astype(np.int64), 2)
        assert (curve.deviation_deg_h == np.sqrt(total / taken / 2.0) / curve.tau_s).all()


def test_short_windows_end_at_each_gap() -> None:
    """Below five samples a window may lack none."""
    assert [most_lost(m) for m in (1, 4, 5, 9, 10, 35, 100)] == [0, 0, 1, 1, 2, 7, 20]
    at = with_losses("few")
    _, gaps = gaps_of(at.astype(float))
    assert gaps.shortest == 5
    assert not len(gaps.places(4).lost)
    places = gaps.places(100)
    rows = np.arange(len(at))
    assert (places.of_samples(rows) == at).all()
    assert (places.samples_before(at) == rows).all()
