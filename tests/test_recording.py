"""The recording: frozen, valid, averaging that knows about gaps."""

from __future__ import annotations

import dataclasses
import pickle

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import rlgcomp as rlg
from rlgcomp.recording.sampling import Sampling


def make(rows: int = 1000, period_s: float = 1.0, **columns: object) -> rlg.Recording:
    rng = np.random.default_rng(0)
    table = {"time_s": period_s * np.arange(rows), "gyro_deg_h": rng.normal(0.01, 0.02, rows), **columns}
    return rlg.Recording(pd.DataFrame(table))


def test_it_is_frozen() -> None:
    recording = make()
    with pytest.raises(dataclasses.FrozenInstanceError, match="replace"):
        recording.name = "other"
    table = recording.table
    table.loc[0, "gyro_deg_h"] = 99.0
    assert recording.column("gyro_deg_h")[0] != 99.0
    with pytest.raises(ValueError, match="read-only"):
        recording.column("gyro_deg_h")[0] = 99.0


def test_the_table_it_was_made_from_may_change() -> None:
    table = pd.DataFrame({"time_s": np.arange(5.0), "gyro_deg_h": np.zeros(5)})
    recording = rlg.Recording(table)
    table.loc[0, "gyro_deg_h"] = 7.0
    assert recording.column("gyro_deg_h")[0] == 0.0


@pytest.mark.parametrize(
    ("table", "message"),
    [
        ({"time_s": [0.0, 1.0], "gyro_deg_h": [1.0, 2.0]}, "2 rows"),
        ({"gyro_deg_h": [1.0, 2.0, 3.0]}, "no column time_s"),
        ({"time_s": [0.0, 1.0, 2.0]}, "no gyro column"),
        ({"time_s": [0.0, 2.0, 1.0], "gyro_deg_h": [1.0, 2.0, 3.0]}, "does not increase"),
        ({"time_s": [0.0, 1.0, 2.0], "gyro_deg_h": [1.0, np.nan, 3.0]}, "missing or infinite"),
        ({"time_s": [0.0, 1.0, 2.0], "gyro_deg_h": ["a", "b", "c"]}, "not numeric"),
    ],
)
def test_what_is_no_recording_is_refused(table: dict[str, list[object]], message: str) -> None:
    with pytest.raises(rlg.InputError, match=message):
        rlg.Recording(pd.DataFrame(table))


@pytest.mark.parametrize(
    "values", [{"kind": "oven"}, {"latitude_deg": 91.0}, {"pulse_arcsec": 0.0}, {"lead_in_s": -1.0}, {"pulse_arcsec": "much"}]
)
def test_wrong_metadata_is_refused(values: dict[str, object]) -> None:
    with pytest.raises(rlg.InputError, match="metadata"):
        rlg.Metadata.from_mapping(values)


def test_metadata_and_back() -> None:
    metadata = rlg.Metadata("turntable", "A7", 51.0, 0.84, 12.0, {"chamber": "B"})
    assert rlg.Metadata.from_mapping(metadata.to_mapping()) == metadata
    assert rlg.Metadata.from_mapping({"operator": "N"}).notes == {"operator": "N"}


def test_rates_come_out_in_deg_h() -> None:
    time_s = 0.5 * np.arange(10)
    in_s = rlg.Recording(pd.DataFrame({"time_s": time_s, "gyro_deg_s": np.full(10, 0.001)}))
    assert in_s.rate_deg_h() == pytest.approx(np.full(10, 3.6))
    pulses = rlg.Recording(pd.DataFrame({"time_s": time_s, "gyro_pulses": np.full(10, 4.0)}), rlg.Metadata(pulse_arcsec=0.8))
    assert pulses.rate_deg_h() == pytest.approx(np.full(10, 4 * 0.8 / 0.5))  # 1 arcsec/s is 1 deg/h
    with pytest.raises(rlg.InputError, match="pulse_arcsec"):
        pulses.replace(metadata=rlg.Metadata()).rate_deg_h()


def test_several_gyros_need_a_choice() -> None:
    recording = make(gyro_z_deg_s=np.arange(1000.0))
    with pytest.raises(rlg.InputError, match=r"choose with --gyro"):
        recording.rate_deg_h()
    assert recording.rate_deg_h("gyro_z_deg_s")[-1] == pytest.approx(999 * 3600)
    with pytest.raises(rlg.InputError, match="'gyro_q' is not among them; name it so with --map gyro_q="):
        recording.rate_deg_h("gyro_q")


def test_averages_are_means_of_their_windows() -> None:
    recording = make(1050, temperature_block_degC=np.arange(1050.0))
    averaged = recording.averaged(100.0)
    assert len(averaged) == 10  # the last 50 s fill half a window
    expected = recording.column("gyro_deg_h")[:1000].reshape(10, 100).mean(axis=1)
    assert averaged.column("gyro_deg_h") == pytest.approx(expected, rel=1e-12)
    assert averaged.time_s == pytest.approx(49.5 + 100.0 * np.arange(10))
    assert averaged.column("temperature_block_degC")[0] == pytest.approx(49.5)


def test_a_gap_leaves_windows_out_and_bends_none() -> None:
    whole = make(1000)
    table = whole.table
    gap = (table["time_s"] >= 250) & (table["time_s"] < 430)
    averaged = rlg.Recording(table[~gap]).averaged(100.0)
    kept = [k for k in range(10) if k not in (2, 3, 4)]  # 50, 0 and 70 of 100 samples are there
    assert averaged.time_s == pytest.approx([100.0 * k + 49.5 for k in kept])
    assert averaged.column("gyro_deg_h") == pytest.approx(whole.averaged(100.0).column("gyro_deg_h")[kept])
    assert len(averaged.gaps) == 1


@settings(max_examples=50, deadline=None)
@given(st.integers(0, 2**32 - 1), st.floats(0.0, 0.6), st.sampled_from([10.0, 33.0, 100.0]))
def test_any_missing_rows_keep_averages_within_their_window(seed: int, missing: float, window_s: float) -> None:
    rng = np.random.default_rng(seed)
    table = make(2000).table
    table["marker_V"] = table["time_s"]
    start = int(rng.integers(0, 2000 * (1 - missing) + 1))
    table = table.drop(index=range(start, start + int(2000 * missing)))
    averaged = rlg.Recording(table).averaged(window_s)
    assert (np.abs(averaged.column("marker_V") - averaged.time_s) <= 0.1 * window_s + 1e-9).all()
    assert (np.diff(averaged.time_s) > 0).all()


def test_short_runs_cannot_be_averaged() -> None:
    with pytest.raises(rlg.InputError, match="too short to average"):
        make(250).averaged(100.0)
    with pytest.raises(rlg.InputError, match="one sample takes 1 s"):
        make().averaged(0.5)


def test_an_interval_keeps_its_history_on_request() -> None:
    recording = make(1000)
    cold = recording.between(400.0, 800.0)
    assert (cold.time_s[0], len(cold), cold.scored.all()) == (400.0, 400, True)
    warm = recording.between(400.0, 800.0, keep_history=True)
    assert (warm.time_s[0], len(warm), int(warm.scored.sum())) == (0.0, 800, 400)
    assert warm.averaged(100.0).column("gyro_deg_h") == pytest.approx(cold.averaged(100.0).column("gyro_deg_h"))


def test_it_can_be_pickled_for_workers() -> None:
    recording = make()
    again = pickle.loads(pickle.dumps(recording))  # noqa: S301
    pd.testing.assert_frame_equal(again.table, recording.table)


def test_it_prints_what_it_is() -> None:
    assert "1000 rows every 1 s, 0.28 h, 0 gaps" in repr(make())


@pytest.mark.parametrize("rate_hz", [45.0, 50.0, 60.0])
@pytest.mark.parametrize("gaps", [0, 40])
def test_times_of_single_precision_are_rounded_and_have_no_gaps_but_their_own(rate_hz: float, gaps: int) -> None:
    """Seconds of a GPS week in four bytes come in steps of 1/64 s: one or two of them a sample."""
    number = np.arange(20_000)
    number += np.searchsorted(np.linspace(300, 19_000, gaps).astype(int), number) * 50
    time_s = (252_000.0 + number / rate_hz).astype(np.float32).astype(np.float64)
    clock = Sampling.of(time_s)
    assert clock.period_s == pytest.approx(1.0 / rate_hz, rel=1e-4)
    assert clock.step_s == 1.0 / 64.0
    assert len(clock.gaps) == gaps
    gyro = np.random.default_rng(1).normal(size=len(number))
    (finding,) = [f for f in rlg.recording({"time_s": time_s, "gyro_deg_h": gyro}).findings if "time_in" in f.message.code]
    assert finding.message.data == {"step_s": 1.0 / 64.0, "period_s": clock.period_s}


@pytest.mark.parametrize("share", [0.0, 0.01, 0.03, 0.04, 0.05, 0.2, 0.4])
def test_samples_that_are_lost_at_random_are_gaps(share: float) -> None:
    """They too leave steps of one period and of two."""
    kept = np.flatnonzero(np.random.default_rng(3).random(20_000) >= share)
    clock = Sampling.of(0.02 * kept)
    assert clock.step_s is None
    assert clock.period_s == pytest.approx(0.02, rel=1e-6)
    assert len(clock.gaps) == np.count_nonzero(np.diff(kept) > 1)
