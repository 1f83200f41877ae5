"""The mounting angle: exact identities, the paper's numbers, recovery with true standard errors, refusals."""

from __future__ import annotations

import dataclasses
import math
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from experiments.zhan_2010.monte_carlo import monte_carlo, printed_four_positions
from rlgcomp.calibration.mounting import error_budget, mounting_angle, mounting_angle_of
from rlgcomp.errors import InputError
from rlgcomp.simulation.position_table import PositionTable, TableErrors
from rlgcomp.units import ARCSEC_PER_TURN, RAD_PER_ARCSEC

IDEAL = PositionTable(errors=TableErrors().only(), angle_random_walk_deg_sqrt_h=0.0, rate_error=0.0, period_error=0.0)
slopes = st.fractions(min_value=Fraction(1, 50), max_value=Fraction(49, 50), max_denominator=60)


def _on_circle(slope: Fraction) -> tuple[Fraction, Fraction]:
    """Cosine and sine that are both rational."""
    return (1 - slope**2) / (1 + slope**2), 2 * slope / (1 + slope**2)


@given(tilt=slopes, mounting=slopes, phase=slopes)
def test_right_hand_side_of_18_is_the_tangent_exactly(tilt: Fraction, mounting: Fraction, phase: Fraction) -> None:
    """In rational arithmetic, without any rounding: K-tilde absorbs the cosine that the paper says it neglects."""
    (ca, sa), (ct, st_), (cb, sb) = _on_circle(tilt), _on_circle(mounting), _on_circle(phase)
    turned, scale = Fraction(1296000), Fraction(84279066, 10**8)
    n1, n2, n3, n4 = (turned * (ca * ct - sa * cosine * st_) / scale for cosine in (cb, -sb, -cb, sb))
    conventional = scale / ct
    squared = conventional**2 * ((n1 - n3) ** 2 + (n2 - n4) ** 2) / ((2 * turned) ** 2 - conventional**2 * (n1 + n3) ** 2)
    assert squared == (st_ / ct) ** 2
    assert scale * (n1 + n2 + n3 + n4) / (4 * turned * ct) == ca  # (17) over all four
    assert scale * (n2 - n4) / (2 * turned * sa * st_) == sb  # (16)
    assert -scale * (n1 - n3) / (2 * turned * sa * st_) == cb  # and its quadrant


@settings(max_examples=60)
@given(
    theta=st.floats(20.0, 9000.0),
    tilt=st.floats(5.0, 175.0),
    phase=st.floats(0.0, 359.99),
    positions=st.integers(3, 24),
    start=st.floats(0.0, 360.0),
)
def test_exact_counts_give_the_angles_back(theta: float, tilt: float, phase: float, positions: int, start: float) -> None:
    table = dataclasses.replace(IDEAL, mounting_arcsec=theta, tilt_deg=tilt, phase_deg=phase)
    beta = start + 360.0 * np.arange(positions) / positions
    plus, minus = table.position_counts(beta, np.random.default_rng(0))
    found = mounting_angle(beta, 0.5 * (plus - minus), table.conventional_arcsec, stated=table)
    assert found.theta_sd_arcsec < 1e-3
    assert found.theta_arcsec == pytest.approx(theta, abs=1e-5)
    assert found.alpha_deg == pytest.approx(tilt, abs=1e-8)
    assert (found.beta0_deg - phase + 180.0) % 360.0 - 180.0 == pytest.approx(0.0, abs=1e-5)
    assert found.conventional_arcsec * found.cosine == pytest.approx(table.scale_arcsec, rel=1e-13)
    assert found.theta_printed_arcsec == pytest.approx(math.tan(theta * RAD_PER_ARCSEC) / RAD_PER_ARCSEC, abs=1e-5)


def test_harmonic_fit_over_four_positions_is_the_papers_formula() -> None:
    rng = np.random.default_rng(3)
    beta = 17.0 + 90.0 * np.arange(4)
    plus, minus = PositionTable().position_counts(np.broadcast_to(beta, (50, 4)), rng)
    counts = 0.5 * (plus - minus)
    fitted = [mounting_angle(beta, row, 0.8427948).theta_printed_arcsec for row in counts]
    printed = printed_four_positions(counts, 0.8427948) / RAD_PER_ARCSEC
    # (18) has N1 + N3 in the root where the fit has all four; with counts in error these differ by less than 0.01 arcsec
    assert np.abs(fitted - printed).max() < 0.01


def test_taking_the_tangent_for_the_angle_errs_by_two_thousandths() -> None:
    counts = IDEAL.position_counts(90.0 * np.arange(4), np.random.default_rng(0))
    found = mounting_angle(90.0 * np.arange(4), 0.5 * (counts[0] - counts[1]), IDEAL.conventional_arcsec)
    assert found.theta_printed_arcsec - found.theta_arcsec == pytest.approx(0.0021, abs=5e-5)


def test_scale_factor_of_the_published_values() -> None:
    """0.84279480 and 646.75 arcsec give 0.84279066; 300 arcsec neglected is 1.06e-6."""
    beta = 45.0 * np.arange(8)
    published = dataclasses.replace(IDEAL, scale_arcsec=0.84279480 * math.cos(646.75 * RAD_PER_ARCSEC))
    plus, minus = published.position_counts(beta, np.random.default_rng(0))
    found = mounting_angle(beta, 0.5 * (plus - minus), 0.84279480)
    assert f"{found.conventional_arcsec * found.cosine:.8f}" == "0.84279066"
    assert found.conventional_arcsec * found.cosine == pytest.approx(0.8427906570, abs=5e-11)
    assert 1.0 - math.cos(300.0 * RAD_PER_ARCSEC) == pytest.approx(1.0577e-6, abs=5e-11)


def test_budget_of_the_paper() -> None:
    budget = error_budget(PositionTable(mounting_arcsec=300.0))
    assert budget.terms["bound_arcsec"].tolist() == pytest.approx([0.318, 0.5, 0.145, 1.0, 0.0], abs=5e-4)
    assert budget.bound_arcsec == pytest.approx(2.78, abs=5e-3)
    assert budget.bound_arcsec < 4.0
    exact, printed = budget.scale_per_arcsec, budget.scale_per_arcsec_printed
    assert exact == pytest.approx(math.tan(300.0 * RAD_PER_ARCSEC) * RAD_PER_ARCSEC, rel=1e-12)
    assert exact / printed == pytest.approx(1.0 / math.cos(300.0 * RAD_PER_ARCSEC), rel=1e-12)


def test_marks_at_their_worst_bound_the_monte_carlo() -> None:
    """Four passages, each of a uniform distribution: none goes beyond the bound, and some come near."""
    alone = PositionTable(
        errors=TableErrors().only("sync_arcsec"),
        latitude_deg=0.0,
        bias_deg_h=0.0,
        angle_random_walk_deg_sqrt_h=0.0,
        period_error=0.0,
    )
    bound = error_budget(alone).marks_relative_bound
    plus, minus = alone.rate_table_counts(200_000, np.random.default_rng(4))
    off = np.abs(2.0 * ARCSEC_PER_TURN * 5 / (plus - minus) / alone.conventional_arcsec - 1.0)
    assert bound == pytest.approx(4 * 0.1 / (2_592_000 * 5))
    assert 0.9 * bound < off.max() < bound * (1.0 + 1e-6)


@pytest.mark.parametrize("reading", ["uniform", "gaussian"])
@pytest.mark.parametrize(
    ("row", "name"),
    list(enumerate(["positioning_arcsec", "wobble_arcsec", "setting_arcsec", "runout_arcsec", "counting"])),
)
def test_budget_agrees_with_monte_carlo_by_term(row: int, name: str, reading: str) -> None:
    column = "uniform_arcsec" if reading == "uniform" else "three_sigma_arcsec"
    table = dataclasses.replace(IDEAL, errors=TableErrors().only(name), reading=reading)
    drawn = monte_carlo(table, np.random.default_rng(row), experiments=60)
    expected = error_budget(PositionTable()).terms[column][row]
    # rounding depends on where each fixed position's count falls between whole pulses, so it is only near its mean
    assert drawn.std() == pytest.approx(expected, rel=0.15 if name == "counting" else 0.04)


def test_eighty_positions_scatter_as_stated_and_are_unbiased() -> None:
    drawn = monte_carlo(PositionTable(), np.random.default_rng(5), experiments=300)
    assert round(float(drawn.std()), 2) <= 0.31
    assert abs(drawn.mean() - 646.75) < 0.02
    gaussian = monte_carlo(PositionTable(reading="gaussian"), np.random.default_rng(6), experiments=300)
    assert gaussian.std() < 0.21 < drawn.std()  # the published scatter lies between the two readings
    scale = PositionTable().conventional_arcsec * np.cos(drawn.mean(axis=1) * RAD_PER_ARCSEC)
    assert np.abs(scale / PositionTable().scale_arcsec - 1.0).max() < 1e-8


@pytest.mark.slow
def test_bias_over_very_many_positions() -> None:
    drawn = monte_carlo(PositionTable(), np.random.default_rng(8), experiments=4000)
    assert drawn.std() == pytest.approx(error_budget().uniform_arcsec, rel=0.01)
    assert abs(drawn.mean() - 646.75) < 0.002


@pytest.mark.parametrize("positions", [3, 4, 8, 12, 36])
@pytest.mark.parametrize("reading", ["uniform", "gaussian"])
def test_standard_errors_are_true(positions: int, reading: str) -> None:
    table = PositionTable(reading=reading)
    beta = 7.0 + 360.0 * np.arange(positions) / positions
    rng, scores = np.random.default_rng(positions), []
    for _ in range(300):
        plus, minus = table.position_counts(beta, rng)
        found = mounting_angle(beta, 0.5 * (plus - minus), table.conventional_arcsec, stated=table)
        scores.append(
            (
                (found.theta_arcsec - table.mounting_arcsec) / found.theta_sd_arcsec,
                (found.beta0_deg - table.phase_deg) / found.beta0_sd_deg,
                (found.alpha_deg - table.tilt_deg) / found.alpha_sd_deg,
            )
        )
    rms = np.sqrt(np.mean(np.square(scores), axis=0))
    assert (rms > 0.8).all()
    assert (rms < 1.25).all()


def test_tables_worse_than_stated_are_noticed() -> None:
    worse = PositionTable(errors=TableErrors(runout_arcsec=20.0))
    beta = 60.0 * np.arange(6)
    plus, minus = worse.position_counts(beta, np.random.default_rng(0))
    found = mounting_angle(beta, 0.5 * (plus - minus), worse.conventional_arcsec)
    assert found.sd_from == "scatter about the fit"
    assert found.theta_sd_arcsec > 1.0


def test_files_in_any_order_and_split_are_the_same() -> None:
    table = PositionTable()
    one, _ = mounting_angle_of([table.position_recording([0.0, 90.0, 180.0, 270.0], 4)], table.conventional_arcsec)
    parts = [table.position_recording(beta, seed) for seed, beta in enumerate((270.0, 0.0, 180.0, 90.0))]
    split, remarks = mounting_angle_of(parts, table.conventional_arcsec)
    assert not remarks
    for found in (one, split):
        assert abs(found.theta_arcsec - table.mounting_arcsec) < 4.0 * found.theta_sd_arcsec
        assert abs(found.beta0_deg - table.phase_deg) < 4.0 * found.beta0_sd_deg
    assert sorted(split.positions["beta_deg"].round(6)) == sorted(one.positions["beta_deg"].round(6))


@pytest.mark.parametrize(
    ("beta", "pulses", "text"),
    [
        ([0.0, 90.0], [1.0, 1.0], "cannot separate"),
        ([10.0, 10.0, 10.0, 10.0], [1.0] * 4, "cannot separate"),
        ([0.0, 180.0, 0.0, 180.0], [1.0] * 4, "cannot separate"),
        ([0.0, 1.0, 2.0, 3.0], [1.0] * 4, "cannot separate"),
        ([0.0, 120.0, 240.0], [1.6e6] * 3, "senses less than all"),
        ([0.0, 120.0, 240.0], [1.0, math.nan, 1.0], "finite"),
        ([0.0, 120.0, 240.0], [1.0, 2.0], "one count an angle"),
    ],
)
def test_measurements_without_an_angle_are_refused(beta: list[float], pulses: list[float], text: str) -> None:
    with pytest.raises(InputError, match=text):
        mounting_angle(beta, pulses, 0.8427948)


@settings(max_examples=60)
@given(
    beta=st.lists(st.floats(allow_nan=True), max_size=6),
    pulses=st.lists(st.floats(allow_nan=True), max_size=6),
    scale=st.floats(allow_nan=True),
)
@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_no_numbers_make_anything_but_an_answer_or_a_refusal(beta: list[float], pulses: list[float], scale: float) -> None:
    try:
        found = mounting_angle(beta, pulses, scale)
    except InputError:
        return
    assert 0.0 <= found.theta_arcsec <= ARCSEC_PER_TURN / 4.0
