"""Tables in memory become recordings as files do: pandas, polars, Arrow, xarray, NumPy, mappings of arrays."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow
import pytest

import rlgcomp as rlg

ROWS = 500
TIME = 0.5 * np.arange(ROWS)
RATE = 1.2 + 0.01 * np.random.default_rng(3).normal(size=ROWS)
BLOCK = 25.0 + np.linspace(0.0, 3.0, ROWS)
COLUMNS = {"time_s": "t", "gyro_deg_h": "Gyro Z [rad/s]", "temperature_block_degC": "T1 [K]"}
OWN = {"t": TIME, "Gyro Z": np.deg2rad(RATE) / 3600.0, "T1": BLOCK + 273.15}


def polars_frame() -> Any:
    import polars

    return polars.DataFrame(OWN)


def xarray_set(**attributes: str) -> Any:
    import xarray

    return xarray.Dataset({"Gyro Z": ("t", OWN["Gyro Z"], attributes), "T1": ("t", OWN["T1"])}, coords={"t": TIME})


def structured() -> np.ndarray:
    array = np.zeros(ROWS, dtype=[(name, float) for name in OWN])
    for name, values in OWN.items():
        array[name] = values
    return array


KINDS: dict[str, Callable[[], Any]] = {
    "pandas": lambda: pd.DataFrame(OWN),
    "pandas, time in the index": lambda: pd.DataFrame(OWN).set_index("t"),
    "mapping": lambda: OWN,
    "lists": lambda: {name: values.tolist() for name, values in OWN.items()},
    "structured array": structured,
    "record array": lambda: structured().view(np.recarray),
    "Arrow": lambda: pyarrow.table(OWN),
    "polars": polars_frame,
    "xarray": xarray_set,
}


LIBRARIES = ("polars", "xarray")


@pytest.mark.parametrize("kind", [pytest.param(k, marks=pytest.mark.needs(k)) if k in LIBRARIES else k for k in KINDS])
def test_every_kind_of_table_is_the_recording_that_a_file_is(kind: str, tmp_path: Path) -> None:
    pd.DataFrame(OWN).to_parquet(tmp_path / "run.parquet")
    expected = rlg.read(tmp_path / "run.parquet", columns=COLUMNS)
    made = rlg.recording(KINDS[kind](), columns=COLUMNS, name="run")
    pd.testing.assert_frame_equal(made.table[list(expected.columns)], expected.table)
    assert made.findings == expected.findings
    assert made["temperature_block_degC"] == pytest.approx(BLOCK)


def test_a_plain_array_needs_names() -> None:
    array = np.column_stack([TIME, RATE])
    assert rlg.recording(array, names=["time_s", "gyro_deg_h"])["gyro_deg_h"].tolist() == RATE.tolist()
    with pytest.raises(rlg.InputError, match="no column names; give names="):
        rlg.recording(array)
    with pytest.raises(rlg.InputError, match=r"shape \(500, 2\); with these 1 names"):
        rlg.recording(array, names=["time_s"])
    with pytest.raises(rlg.InputError, match="a DataFrame has its own"):
        rlg.recording(pd.DataFrame(OWN), names=["time_s"])


START = pd.Timestamp("2026-03-29T00:59:00", tz="Europe/Berlin")


@pytest.mark.parametrize(
    "index",
    [
        START + pd.to_timedelta(TIME, unit="s"),
        pd.DatetimeIndex(pd.Timestamp("2026-01-02") + pd.to_timedelta(TIME, unit="s"), name="when"),
        pd.to_timedelta(TIME + 7.0, unit="s"),
        pd.Index(TIME, name="time_s"),
        pd.Index(TIME),
    ],
    ids=["dates with a zone", "named dates", "differences", "time_s", "floats"],
)
def test_the_index_is_the_time(index: pd.Index) -> None:
    run = rlg.recording(pd.DataFrame({"gyro_deg_h": RATE}, index=index))
    assert run.columns == ("time_s", "gyro_deg_h")
    assert run.time_s - run.time_s[0] == pytest.approx(TIME)


def test_an_index_of_whole_numbers_is_no_time() -> None:
    table = pd.DataFrame({"gyro_deg_h": RATE})
    with pytest.raises(rlg.InputError, match="time_s"):
        rlg.recording(table)
    assert rlg.recording(table, period_s=0.5).time_s == pytest.approx(TIME)
    thinned = table[::2]
    with pytest.raises(rlg.InputError, match="time_s"):
        rlg.recording(thinned)


def test_a_column_of_time_goes_before_the_index_and_columns_of_differences_are_in_seconds() -> None:
    table = pd.DataFrame({"time_s": TIME, "gyro_deg_h": RATE}, index=START + pd.to_timedelta(TIME, unit="h"))
    assert rlg.recording(table).period_s == 0.5
    elapsed = pd.DataFrame({"elapsed": pd.to_timedelta(TIME, unit="s"), "gyro_deg_h": RATE})
    assert rlg.recording(elapsed, columns={"time_s": "elapsed"}).time_s == pytest.approx(TIME)


def test_a_table_is_repaired_and_the_repairs_are_reported() -> None:
    rate = RATE.copy()
    rate[40] = np.nan
    run = rlg.recording({"time_s": TIME, "gyro_deg_h": rate})
    assert [finding.message.code for finding in run.findings][:1] == ["recording.missing_gyro_values"]
    assert len(run) == ROWS - 1


@pytest.mark.needs("xarray")
def test_units_of_xarray_are_read() -> None:
    run = rlg.recording(xarray_set(units="rad/s"), columns=COLUMNS | {"gyro_deg_h": "Gyro Z"})
    assert run["gyro_deg_h"] == pytest.approx(RATE)


def test_metadata_and_tables_of_a_turntable() -> None:
    run = rlg.recording(
        {"time_s": TIME, "gyro_pulses": np.arange(ROWS) % 3, "table_rate_deg_s": 10.0 + 0.0 * TIME},
        metadata={"pulse_arcsec": 0.84, "unit": "17", "operator": "K"},
    )
    assert (run.metadata.kind, run.metadata.unit, run.metadata.notes) == ("turntable", "17", {"operator": "K"})


def shaped(*shape: int) -> dict[str, np.ndarray]:
    return {"time_s": TIME, "gyro_deg_h": np.zeros(shape)}


@pytest.mark.parametrize(
    ("data", "message"),
    [
        ("run.csv", r"'run.csv' is no table; .* rlgcomp.read\(path\)"),
        (None, "None is no table"),
        (pd.Series(RATE), "a Series is one column"),
        (shaped(ROWS, 3), r"gyro_deg_h \(500, 3\); each must be one column"),
        (shaped(ROWS - 1), "all of the same length"),
        ({"time_s": TIME}, "no gyro column"),
        (pd.DataFrame([[0, 1, 2]] * 5, columns=["time_s", "gyro_deg_h", "gyro_deg_h"]), "gyro_deg_h is the name of several"),
    ],
)
def test_what_is_no_table_is_refused(data: Any, message: str) -> None:
    with pytest.raises(rlg.InputError, match=message):
        rlg.recording(data)


@pytest.mark.needs("polars", "xarray")
def test_lazy_frames_and_planes_are_refused_with_the_remedy() -> None:
    with pytest.raises(rlg.InputError, match=r"give .collect\(\)"):
        rlg.recording(polars_frame().lazy())
    import xarray

    with pytest.raises(rlg.InputError, match="the dimensions are t, axis"):
        rlg.recording(xarray.DataArray(np.zeros((5, 3)), dims=("t", "axis"), name="gyro_deg_h"))


def test_a_recording_is_frozen() -> None:
    """Neither what is handed out nor what it was made of reaches it."""
    own = pd.DataFrame({"time_s": TIME, "gyro_deg_h": RATE})
    arrays = {"time_s": TIME.copy(), "gyro_deg_h": RATE.copy()}
    for made, source in ((rlg.Recording(own), own), (rlg.recording(own), own), (rlg.recording(arrays), arrays)):
        before = float(made["gyro_deg_h"][0])
        with pytest.raises(ValueError, match="read-only"):
            made["gyro_deg_h"][0] = 99.0
        handed = made.table
        handed.loc[0, "gyro_deg_h"] = 99.0
        handed["gyro_deg_h"] *= 2.0
        if isinstance(source, pd.DataFrame):
            source.loc[0, "gyro_deg_h"] = 98.0
        else:
            source["gyro_deg_h"][0] = 98.0
        assert made["gyro_deg_h"][0] == made.table["gyro_deg_h"].iloc[0] == before
        if isinstance(source, pd.DataFrame):
            source.loc[0, "gyro_deg_h"] = before


def test_a_recording_is_no_sequence_of_columns() -> None:
    run = rlg.recording({"time_s": TIME, "gyro_deg_h": RATE})
    with pytest.raises(rlg.InputError, match="no column 0"):
        list(run)
    with pytest.raises(rlg.InputError, match="no column 'x'; it has time_s, gyro_deg_h"):
        _ = run["x"]


@pytest.mark.needs("xarray")
def test_a_unit_of_xarray_that_contradicts_the_name_is_refused() -> None:
    import xarray

    own = {"gyro_deg_h": ("time_s", RATE / 3600.0, {"units": "deg/s"})}
    with pytest.raises(rlg.InputError, match="gyro_deg_h is in deg/h by its name and in deg/s by its attribute units"):
        rlg.recording(xarray.Dataset(own, coords={"time_s": TIME}))
