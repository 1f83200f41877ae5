"""The scale factor against rate: the published table, recovery with true errors when runs differ as a whole, refusals."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rlgcomp.calibration.rate_dependence import RateTable, fit_lock_in, rate_table
from rlgcomp.calibration.scale_factor import conventional_scale_factors
from rlgcomp.errors import InputError
from rlgcomp.simulation.position_table import PositionTable

RATES = np.array([1.0, 2.0, 3.0, 6.0, 9.0, 12.0, 15.0, 18.0, 24.0, 30.0, 40.0, 50.0, 60.0])


@pytest.fixture(scope="module")
def published() -> RateTable:
    path = Path(__file__).resolve().parents[2] / "shared" / "data" / "published" / "liu_table3.csv"
    if not path.exists():
        pytest.skip("no published tables next to the project (../shared/data/published)")
    table = pd.read_csv(path)
    return RateTable(table["rate_dps"].to_numpy(dtype=float), table.filter(regex="^r[0-9]").to_numpy())


def drawn(rng: np.random.Generator, *, runs: int = 5, by_run: float = 0.02, offset_ppm: float = 0.5) -> RateTable:
    """Runs of one gyro whose lock-in and offset change at every power-up."""
    lock_in = 0.03 * (1.0 + by_run * rng.standard_normal(runs))
    error = (np.sqrt(1.0 - (lock_in / RATES[:, None]) ** 2) - 1.0) * 1e6
    offset = -3.0 + offset_ppm * rng.standard_normal(runs)
    return RateTable(RATES, error + offset + 0.2 * rng.standard_normal((len(RATES), runs)))


def test_published_spreads_are_sample_spreads_but_one(published: RateTable) -> None:
    printed = [13.2, 10.2, 5.5, 2.3, 1.3, 0.7, 0.8, 0.6, 0.5, 0.6, 0.4, 0.6, 0.4]
    apart = [rate for rate, ours, theirs in zip(RATES, published.std_ppm, printed, strict=True) if abs(ours - theirs) > 0.0501]
    assert apart == [30.0]
    assert published.std_ppm[9] == pytest.approx(0.651, abs=5e-4)


def test_published_rule_of_the_operating_rate(published: RateTable) -> None:
    """Less than 1 ppm from 12 deg/s on; constant to 1 ppm only at 40, to 1.2 ppm at the paper's choice of 24 to 30 deg/s."""
    assert published.repeatable_from_deg_s() == 12.0
    assert published.constant_from_deg_s(1.0) == 40.0
    assert published.constant_from_deg_s(1.2) == 24.0
    assert published.operating_rate_deg_s() == 40.0
    assert math.isnan(published.repeatable_from_deg_s(0.01))


@pytest.mark.parametrize(
    ("options", "chi2", "freedom", "lock_in", "offset", "bias"),
    [
        ({}, 1408, 11, 0.0273, -0.76, 0.0),
        ({"with_bias": True}, 66, 10, 0.0337, -5.9, 140.0),
        ({"weighted": False}, None, 11, 0.0293, 4.2, 0.0),
    ],
)
def test_published_table_fits_as_it_should(
    published: RateTable, options: dict[str, bool], chi2: float | None, freedom: int, lock_in: float, offset: float, bias: float
) -> None:
    fit = fit_lock_in(published, **options)
    assert fit.freedom == freedom
    assert chi2 is None or fit.chi2 == pytest.approx(chi2, rel=2e-3)
    assert fit.lock_in_deg_s == pytest.approx(lock_in, abs=6e-5)
    assert fit.offset_ppm == pytest.approx(offset, abs=0.03)
    assert fit.bias_ppm_deg_s == pytest.approx(bias, abs=1.0)
    if not options.get("weighted", True):
        assert fit.residuals["residual_ppm"].pow(2).mean() ** 0.5 == pytest.approx(7.3, abs=0.05)


def test_a_hump_above_the_plateau_is_not_explained_by_lock_in(published: RateTable) -> None:
    assessment = fit_lock_in(published).assessment
    assert assessment.code == "calibration.lock_in_does_not_explain_the_curve"
    assert assessment.data["hump_rates_deg_s"] == [6.0, 30.0]
    clean = fit_lock_in(drawn(np.random.default_rng(0), by_run=0.0, offset_ppm=0.0)).assessment
    assert clean.code == "calibration.lock_in_explains_the_curve"


def test_repeatability_is_a_message(published: RateTable) -> None:
    assert published.repeatability.data == {"rate_deg_s": 40.0}
    assert RateTable(RATES, published.error_ppm[:, :1]).repeatability.code == "calibration.one_repeat"
    noisy = RateTable(RATES, 100.0 * published.error_ppm)
    assert noisy.repeatability.code == "calibration.no_operating_rate"


def test_published_runs_differ_as_a_whole(published: RateTable) -> None:
    correlation = published.correlation()
    low_rates = correlation[:6, :6][np.triu_indices(6, 1)]
    assert low_rates.min() > 0.6
    assert low_rates.max() > 0.9


@pytest.mark.parametrize("with_bias", [False, True])
@pytest.mark.parametrize("form", ["exact", "series"])
def test_exact_curves_give_their_parameters_back(form: str, with_bias: bool) -> None:
    lock_in, offset, bias = 0.05, 2.0, 30.0 * with_bias
    curve = (np.sqrt(1.0 - (lock_in / RATES) ** 2) - 1.0) * 1e6 if form == "exact" else -0.5e6 * (lock_in / RATES) ** 2
    table = RateTable(RATES, np.repeat((curve + offset + bias / RATES)[:, None], 3, axis=1))
    fit = fit_lock_in(table, form=form, with_bias=with_bias)
    assert fit.lock_in_deg_s == pytest.approx(lock_in, rel=1e-6)
    assert fit.offset_ppm == pytest.approx(offset, abs=1e-4)
    assert fit.bias_ppm_deg_s == pytest.approx(bias, abs=1e-3)


def test_a_curve_without_lock_in_gives_none() -> None:
    table = RateTable(RATES, np.repeat((5.0 / RATES)[:, None], 2, axis=1))
    assert fit_lock_in(table).lock_in_deg_s == 0.0


@pytest.mark.parametrize("by_run", [0.0, 0.02])
def test_standard_errors_are_true_when_runs_differ_as_a_whole(by_run: float) -> None:
    rng, scores, naive = np.random.default_rng(7), [], []
    for _ in range(120):
        table = drawn(rng, by_run=by_run)
        fit = fit_lock_in(table)
        scores.append(((fit.lock_in_deg_s - 0.03) / fit.lock_in_sd_deg_s, (fit.offset_ppm + 3.0) / fit.offset_sd_ppm))
        design = np.column_stack([-1e6 / RATES**2, np.ones_like(RATES)]) / fit.residuals["sd_ppm"].to_numpy()[:, None]
        naive.append((fit.lock_in_deg_s - 0.03) * fit.lock_in_deg_s / math.sqrt(np.linalg.inv(design.T @ design)[0, 0]))
    rms = np.sqrt(np.mean(np.square(scores), axis=0))
    assert (rms > 0.8).all()
    assert (rms < 1.25).all()
    if by_run:  # repeats taken for independent noise at each rate
        assert math.sqrt(np.mean(np.square(naive))) > 1.5


def test_recordings_become_a_table_a_column_a_power_up() -> None:
    runs = [
        PositionTable(lock_in_deg_s=lock_in).rate_recording(2, seed, rates_deg_s=[3.0, 20.0, 60.0], revolutions=1, step_s=0.05)
        for seed, lock_in in enumerate((0.02, 0.03))
    ]
    factors, _ = conventional_scale_factors(runs)
    table, columns = rate_table(factors)
    assert columns == "recording"
    assert table.error_ppm.shape == (3, 2)
    assert table.error_ppm[0] == pytest.approx([-0.5e6 * (0.02 / 3.0) ** 2, -0.5e6 * (0.03 / 3.0) ** 2], abs=1.0)
    alone, columns = rate_table(conventional_scale_factors(runs[:1])[0], PositionTable().conventional_arcsec)
    assert columns == "repeat"
    assert alone.mean_ppm[-1] == pytest.approx(0.0, abs=0.5)


@settings(max_examples=50)
@given(
    rates=st.lists(st.floats(allow_nan=True), max_size=5),
    values=st.lists(st.lists(st.floats(allow_nan=True), min_size=2, max_size=2), max_size=5),
)
def test_no_table_makes_anything_but_a_table_or_a_refusal(rates: list[float], values: list[list[float]]) -> None:
    try:
        table = RateTable(np.array(rates), np.array(values).reshape(-1, 2))
    except InputError:
        return
    assert np.isfinite(table.error_ppm).all()


def test_fits_that_cannot_be_are_refused() -> None:
    two = RateTable(RATES[:2], np.zeros((2, 3)))
    with pytest.raises(InputError, match="measure at least 3"):
        fit_lock_in(two, with_bias=True)
    with pytest.raises(InputError, match="exact or series"):
        fit_lock_in(two, form="cubic")
    with pytest.raises(InputError, match="at least two"):
        rate_table([])
