"""Extents of columns against NumPy, and that what they prove without looking at every value is true."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import rlgcomp as rlg
from rlgcomp.numerics import column_ranges
from rlgcomp.recording.repair import repair


@pytest.fixture(params=[1 << 15, 7])
def blocks(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(column_ranges, "BLOCK", request.param)
    monkeypatch.setattr(column_ranges, "LONG", 50)


@pytest.mark.usefixtures("blocks")
def test_extents_are_those_of_numpy() -> None:
    rng = np.random.default_rng(0)
    columns = [rng.normal(size=n) for n in (1, 2, 7, 8, 100, 1001)]
    for values, extent in zip(columns, column_ranges.extents(columns), strict=True):
        assert (extent.least, extent.greatest, extent.missing) == (values.min(), values.max(), False)
        assert extent.within(np.abs(values).max())
        assert not extent.within(0.99 * np.abs(values).max())
        steps = np.diff(values)
        if len(steps):
            assert column_ranges.step_extent(values) == column_ranges.Extent(steps.min(), steps.max())


@pytest.mark.usefixtures("blocks")
@pytest.mark.parametrize("row", [0, 6, 7, 99])
def test_one_missing_value_is_seen_wherever_it_stands(row: int) -> None:
    values = np.arange(100.0)
    values[row] = np.nan
    (extent,) = column_ranges.extents([values])
    assert extent.missing
    assert not extent.within(np.inf)
    assert np.isnan(column_ranges.step_extent(values).least)
    values[row] = -np.inf
    (extent,) = column_ranges.extents([values])
    assert (extent.missing, extent.within(1e300)) == (False, False)


def test_nothing_has_no_extent() -> None:
    (extent,) = column_ranges.extents([np.empty(0)])
    assert extent.missing
    assert np.isnan(column_ranges.step_extent(np.ones(1)).greatest)


@settings(max_examples=300, deadline=None)
@given(
    values=st.lists(st.integers(0, 2), max_size=120),
    run=st.integers(0, 60),
    at=st.integers(0, 120),
    samples=st.integers(2, 60),
)
def test_equal_values_in_a_row_are_never_overlooked(values: list[int], run: int, at: int, samples: int) -> None:
    column = np.array([*values[:at], *([1] * run), *values[at:]], dtype=np.float64)
    edges = np.flatnonzero(np.diff(column) != 0) + 1
    longest = int(np.diff(np.r_[0, edges, len(column)]).max()) if len(column) else 0
    if longest >= samples:
        assert column_ranges.may_hold(column, samples)


def test_noise_holds_no_row_of_equal_values_and_coarse_values_little() -> None:
    rng = np.random.default_rng(1)
    assert not column_ranges.may_hold(rng.normal(size=10_000), 20)
    assert not column_ranges.may_hold(np.round(rng.normal(size=10_000), 1), 20)
    assert not column_ranges.may_hold(np.empty(0), 20)


@settings(max_examples=40, deadline=None)
@given(
    seed=st.integers(0, 1000),
    noise=st.sampled_from([0.0, 1e-9, 1e-6, 1e-3, 1.0]),
    mean=st.sampled_from([0.0, 15.0, 99.0, 101.0, 1e4]),
    digits=st.integers(0, 12),
    temperature=st.sampled_from([20.0, 179.0, 181.0, 300.0, 500.0]),
    faults=st.sets(st.sampled_from(["stuck", "gap", "uneven", "missing", "absurd", "frozen", "kelvin", "backward", "constant"])),
)
def test_bounds_find_what_looking_at_every_value_finds(
    seed: int, noise: float, mean: float, digits: int, temperature: float, faults: set[str]
) -> None:
    """The same table and the same findings, in the same order, where bounds may prove nothing."""
    rng = np.random.default_rng(seed)
    n = 1500
    time_s = np.arange(n, dtype=np.float64)
    rate = np.round(mean + noise * rng.normal(size=n), digits)
    shell = temperature + 0.01 * np.round(100.0 * np.sin(time_s / 200.0) * 5.0)
    frame = pd.DataFrame({"time_s": time_s, "gyro_deg_h": rate, "temperature_block_degC": shell})
    frame["temperature_shell_degC"] = shell[::-1].copy()
    frame["light_intensity_V"] = 1.0 if "constant" in faults else rng.normal(size=n)
    if "stuck" in faults:
        frame.loc[300:340, "gyro_deg_h"] = 7.25
    if "gap" in faults:
        frame.loc[700:, "time_s"] += 30.0
    if "uneven" in faults:
        frame["time_s"] += 0.3 * rng.uniform(size=n)
    if "missing" in faults:
        frame.loc[50:55, "light_intensity_V"] = np.nan
    if "absurd" in faults:
        frame.loc[60, "gyro_deg_h"] = np.inf
    if "frozen" in faults:
        frame.loc[100:900, "temperature_shell_degC"] = temperature
    if "backward" in faults:
        frame.loc[1000, "time_s"] = 990.5

    def outcome() -> tuple[pd.DataFrame | None, list[str]]:
        try:
            table, findings = repair(frame, rlg.Metadata(), name="file")
        except rlg.InputError as error:
            return None, str(error).splitlines()
        return table, [str(finding) for finding in findings]

    quick = outcome()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("rlgcomp.recording.repair.context.step_extent", lambda values: column_ranges.Extent(-np.inf, 1e9))
        patch.setattr("rlgcomp.recording.repair.channels.may_hold", lambda values, samples: True)
        patch.setattr("rlgcomp.recording.repair.wrong_units.plainly_in_its_unit", lambda table, column, context: False)
        slow = outcome()
    assert quick[1] == slow[1]
    if quick[0] is not None and slow[0] is not None:
        pd.testing.assert_frame_equal(quick[0], slow[0])
        rlg.Recording(quick[0])  # what is repaired is valid
