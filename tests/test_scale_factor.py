"""Whole revolutions, the conventional scale factor, and the command that reads them from files."""

from __future__ import annotations

import contextlib
import dataclasses
import json
import math
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from typer.testing import CliRunner

import rlgcomp as rlg
from rlgcomp.calibration.revolutions import constant_rate_segments, whole_revolutions
from rlgcomp.calibration.scale_factor import conventional_scale_factor, conventional_scale_factors
from rlgcomp.calibration.scale_factor_calibration import calibrate_scale_factor
from rlgcomp.cli import register_commands
from rlgcomp.cli.base import app
from rlgcomp.errors import InputError
from rlgcomp.simulation.position_table import PositionTable, TableErrors
from rlgcomp.units import EARTH_RATE_DEG_H

TABLE = PositionTable()
IDEAL = PositionTable(errors=TableErrors().only(), angle_random_walk_deg_sqrt_h=0.0, rate_error=0.0, period_error=0.0)
POSITIONS = [0.0, 90.0, 180.0, 270.0]


def turntable(time_s: np.ndarray, angle_deg: np.ndarray, pulses: np.ndarray, **other: np.ndarray) -> rlg.Recording:
    frame = pd.DataFrame({"time_s": time_s, "gyro_pulses": pulses, "table_angle_deg": angle_deg, **other})
    return rlg.Recording(frame, rlg.Metadata(kind="turntable"), name="made")


# --- whole revolutions ---------------------------------------------------------------------------------------------------------


def test_every_revolution_of_an_ideal_table_counts_the_same() -> None:
    """Reversals just beyond the mark, low rates and high: the interpolation at the mark must not see the run-in."""
    recording = IDEAL.rate_recording(2, 0, rates_deg_s=[1.0, 6.0, 30.0, 150.0], revolutions=2, step_s=0.02)
    turns = whole_revolutions(recording, "table_angle_deg")
    assert len(turns) == 2 * 4 * 2 * 2
    earth = (EARTH_RATE_DEG_H * math.sin(math.radians(IDEAL.latitude_deg)) * math.cos(math.radians(646.75 / 3600.0)) + 0.02) * (
        turns["stop_s"] - turns["start_s"]
    )
    expected = turns["direction"] * 1296000.0 / IDEAL.conventional_arcsec + earth / IDEAL.scale_arcsec
    # the perpendicular Earth rate over a sampled revolution, and a straight line through a curved run-in, leave a millipulse
    assert (turns["pulses"] - expected).abs().max() < 2e-3


@pytest.mark.parametrize("reference_deg", [0.0, 123.4])
def test_wrapped_and_running_encoders_are_the_same(reference_deg: float) -> None:
    recording = TABLE.rate_recording(1, 1, revolutions=4)
    table = recording.table
    wrapped = recording.replace(table=table.assign(table_angle_deg=table["table_angle_deg"] % 360.0))
    one, other = (whole_revolutions(run, "table_angle_deg", reference_deg=reference_deg) for run in (recording, wrapped))
    pd.testing.assert_frame_equal(one, other, atol=1e-6)
    assert len(one) == (8 if reference_deg == 0.0 else 6)


def test_a_gap_costs_its_revolution_and_no_other() -> None:
    recording = TABLE.rate_recording(1, 1, revolutions=4)
    time_s = recording.time_s
    turns = whole_revolutions(recording, "table_angle_deg")
    middle = float(turns["start_s"][1]) + 1.0
    broken = recording.replace(table=recording.table[(time_s < middle) | (time_s > middle + 0.2)])
    remaining = whole_revolutions(broken, "table_angle_deg")
    assert remaining["start_s"].to_numpy() == pytest.approx(turns["start_s"].drop(1).to_numpy(), abs=1e-9)
    assert remaining["pulses"].to_numpy() == pytest.approx(turns["pulses"].drop(1).to_numpy(), abs=1e-9)
    assert constant_rate_segments(remaining)["turns"].tolist() == [1, 2, 4]


def test_an_uneven_revolution_is_left_out() -> None:
    time_s = 0.01 * np.arange(6001)
    speed = np.where(time_s < 30.0, 30.0, np.where(time_s < 36.0, 30.0 + 3.0 * (time_s - 30.0), 48.0))
    angle = -5.0 + np.r_[0.0, np.cumsum(0.01 * 0.5 * (speed[1:] + speed[:-1]))]
    turns = whole_revolutions(turntable(time_s, angle, np.ones(6001)), "table_angle_deg")
    rates = turns["rate_deg_s"].round(2).tolist()
    assert rates == [30.0, 30.0, 48.0, 48.0]
    assert constant_rate_segments(turns)["turns"].tolist() == [2, 2]


def test_a_noisy_encoder_standing_on_the_mark_makes_no_revolutions() -> None:
    rng = np.random.default_rng(0)
    still = turntable(0.01 * np.arange(3000), 0.01 * rng.standard_normal(3000), rng.integers(0, 2, 3000).astype(float))
    with pytest.raises(InputError, match="no whole revolution"):
        whole_revolutions(still, "table_angle_deg")


def test_cutting_into_repeats() -> None:
    turns = whole_revolutions(TABLE.rate_recording(1, 1, revolutions=7), "table_angle_deg")
    assert constant_rate_segments(turns, 3)["turns"].tolist() == [3, 3, 3, 3]
    with pytest.raises(InputError, match="the longest has 7"):
        constant_rate_segments(turns, 8)
    with pytest.raises(InputError, match="at least 1"):
        constant_rate_segments(turns, 0)


# --- the conventional scale factor ---------------------------------------------------------------------------------------------


@given(
    scale=st.floats(0.1, 10.0),
    rate=st.floats(-40.0, 40.0),
    revolutions=st.integers(1, 20),
    period_s=st.floats(0.5, 400.0),
)
@settings(max_examples=60)
def test_what_does_not_turn_with_the_table_cancels(scale: float, rate: float, revolutions: int, period_s: float) -> None:
    turned, drifted = 1296000.0 * revolutions, rate * period_s * revolutions
    plus, minus = (turned + drifted) / scale, (-turned + drifted) / scale
    found = conventional_scale_factor([plus], [minus], revolutions, period_s=period_s)
    assert found.scale_arcsec == pytest.approx(scale, rel=1e-12)
    assert found.axis_rate_deg_h == pytest.approx(rate, abs=1e-6)


def test_published_spread_is_that_of_counting_and_the_mark() -> None:
    """4e-8 published; one count and 0.1 arcsec a passage, five revolutions each way."""
    plus, minus = TABLE.rate_table_counts(3000, np.random.default_rng(0))
    found = conventional_scale_factor(plus, minus, 5, period_s=2.4)
    assert found.relative_spread == pytest.approx(4e-8, abs=0.5e-8)
    assert found.relative_expected == pytest.approx(3.86e-8, abs=0.02e-8)
    assert abs(found.scale_arcsec / TABLE.conventional_arcsec - 1.0) < 4.0 * found.relative_sd
    earth = EARTH_RATE_DEG_H * math.sin(math.radians(TABLE.latitude_deg)) + TABLE.bias_deg_h
    assert found.axis_rate_deg_h == pytest.approx(earth, abs=0.01)


@pytest.mark.parametrize("repeats", [1, 2, 4, 12, 40, 300])
def test_standard_error_of_the_mean_is_true(repeats: int) -> None:
    rng, scores = np.random.default_rng(repeats), []
    for _ in range(250):
        found = conventional_scale_factor(*TABLE.rate_table_counts(repeats, rng), 5)
        scores.append((found.scale_arcsec / TABLE.conventional_arcsec - 1.0) / found.relative_sd)
    assert 0.8 < math.sqrt(np.mean(np.square(scores))) < 1.25


def test_slow_drift_of_the_scale_factor_widens_its_error() -> None:
    """A random walk over the repeats, as in the paper's figure 5: white statistics would give a third of the error."""
    rng = np.random.default_rng(1)
    plus, minus = TABLE.rate_table_counts(300, rng)
    drift = 1.0 + 1e-8 * np.cumsum(rng.standard_normal(300))
    found = conventional_scale_factor(plus / drift, minus / drift, 5)
    assert found.relative_sd > 2.0 * found.relative_spread / math.sqrt(300)


def test_recordings_give_the_scale_factor_within_its_error() -> None:
    (found,), remarks = conventional_scale_factors([TABLE.rate_recording(20, 5)])
    assert not remarks
    assert abs(found.scale_arcsec / TABLE.conventional_arcsec - 1.0) < 4.0 * found.relative_sd
    assert found.relative_sd < 2e-8
    assert found.repeats[["turns_plus", "turns_minus"]].to_numpy().tolist() == [[5, 5]] * 20


def test_each_direction_may_be_a_file_of_its_own() -> None:
    recording = TABLE.rate_recording(1, 5)
    turned = recording.time_s[int(np.argmax(recording.column("table_angle_deg")))]
    parts = [recording.between(0.0, turned), recording.between(turned, np.inf)]
    (whole,), _ = conventional_scale_factors([recording])
    (split,), _ = conventional_scale_factors(parts)
    assert split.scale_arcsec == pytest.approx(whole.scale_arcsec, rel=1e-12)


def test_a_counter_the_other_way_round_is_a_negative_scale_factor() -> None:
    recording = TABLE.rate_recording(2, 5)
    reversed_ = recording.replace(table=recording.table.assign(gyro_pulses=-recording.column("gyro_pulses")))
    (found,), _ = conventional_scale_factors([reversed_])
    assert found.scale_arcsec == pytest.approx(-TABLE.conventional_arcsec, rel=1e-7)


def test_counts_that_cannot_be_right_are_refused() -> None:
    with pytest.raises(InputError, match="one of each"):
        conventional_scale_factor([1.0, 2.0], [1.0], 5)
    with pytest.raises(InputError, match="counts of both directions differ"):
        conventional_scale_factor([5.0], [5.0], 5)
    with pytest.raises(InputError, match="counts of both directions differ"):
        conventional_scale_factor([5.0, math.nan], [-5.0, -5.0], 5)
    with pytest.raises(InputError, match="at least one"):
        conventional_scale_factor([5.0], [-5.0], 0)
    with pytest.raises(InputError, match="must be positive"):
        conventional_scale_factor([5.0], [-5.0], 1, period_s=0.0)


def from_turn_to_turn(start_deg: float) -> rlg.Recording:
    """10, -10, 20 and -20 deg/s for 2.1 revolutions each, between rests at `start_deg` and where the table turns back."""
    rate = np.repeat([0.0, 10.0, 0.0, -10.0, 0.0, 20.0, 0.0, -20.0, 0.0], [60, 1512, 60, 1512, 60, 756, 60, 756, 60])
    angle = start_deg + 0.05 * np.cumsum(rate)
    pulses = np.diff(np.floor(np.cumsum(180.0 * rate + 0.6)), prepend=0.0)
    return turntable(0.05 * np.arange(len(rate)), angle % 360.0, pulses)


@pytest.mark.parametrize("start_deg", [0.0, 100.0])
def test_a_table_that_turns_back_at_the_mark_loses_no_revolution(start_deg: float) -> None:
    found, remarks = conventional_scale_factors([from_turn_to_turn(start_deg)], revolutions=2)
    assert [round(factor.rate_deg_s) for factor in found] == [10, 20]
    assert [factor.repeats[["turns_plus", "turns_minus"]].to_numpy().tolist() for factor in found] == [[[2, 2]]] * 2
    chosen, *_ = [remark for remark in remarks if remark.code == "calibration.reference_mark_chosen"]
    assert 0.0 < (chosen.data["reference_deg"] - start_deg) % 360.0 < 36.0
    assert chosen.data["revolutions"] == 8 > chosen.data["revolutions_at_zero"]
    assert "--reference-deg" in str(chosen)


def test_the_mark_is_zero_where_no_other_keeps_more() -> None:
    found, remarks = conventional_scale_factors([from_turn_to_turn(340.0)], revolutions=2)
    assert len(found) == 2
    assert "calibration.reference_mark_chosen" not in [remark.code for remark in remarks]


def test_segments_left_out_name_the_mark_that_was_stated() -> None:
    recording = from_turn_to_turn(0.0)
    last = recording.between(0.0, float(recording.time_s[-500]))
    _, remarks = conventional_scale_factors([last], reference_deg=15.0)
    (unpaired,) = [remark for remark in remarks if remark.code == "calibration.segments_unpaired"]
    assert (unpaired.data["segments"], unpaired.data["reference_deg"]) == (1, 15.0)
    assert "--reference-deg" in str(unpaired)


# --- counters that cannot be believed, and angle random walk -------------------------------------------------------------------


def test_a_spike_or_a_dead_counter_costs_its_revolutions_alone_and_is_named() -> None:
    recording = TABLE.rate_recording(5, 3, rates_deg_s=60.0)
    pulses, time_s = recording.column("gyro_pulses"), recording.time_s
    spike = np.where(np.arange(len(time_s)) == 1500, pulses + 5000.0, pulses)
    dead = np.where((time_s > 40.0) & (time_s < 60.0), 0.0, pulses)
    for faulty, first_s, last_s in ((spike, time_s[1500], time_s[1500]), (dead, 40.0, 60.0)):
        (found,), remarks = conventional_scale_factors([recording.replace(table=recording.table.assign(gyro_pulses=faulty))])
        (remark,) = [remark for remark in remarks if remark.code == "calibration.counter_does_not_follow"]
        assert remark.data["column"] == "table_angle_deg"
        assert (remark.data["first_s"], remark.data["last_s"]) == pytest.approx((first_s, last_s), abs=0.3)
        assert abs(found.scale_arcsec / TABLE.conventional_arcsec - 1.0) < 4.0 * found.relative_sd
        assert found.relative_sd < 5e-8


def test_an_encoders_wrong_reading_is_no_fault_of_the_counter() -> None:
    recording = TABLE.rate_recording(2, 3, rates_deg_s=60.0)
    angle = recording.column("table_angle_deg").copy()
    angle[1500] += 1.0
    _, remarks = conventional_scale_factors([recording.replace(table=recording.table.assign(table_angle_deg=angle))])
    assert not remarks


def test_directions_that_do_not_oppose_are_refused() -> None:
    recording = TABLE.rate_recording(2, 3)
    unsigned = recording.table.assign(gyro_pulses=recording.column("gyro_pulses") ** 2 / 640.7)
    with pytest.raises(InputError, match="do not oppose"):
        conventional_scale_factors([recording.replace(table=unsigned)])
    with pytest.raises(InputError, match="do not oppose"):
        conventional_scale_factor([7.2e6], [-7.0e6], 5, period_s=2.4)


def test_a_repeat_beyond_the_scatter_of_the_others_is_named() -> None:
    recording = TABLE.rate_recording(5, 3, rates_deg_s=60.0)
    few = np.where(np.arange(len(recording)) == 1500, 30.0, 0.0)  # too few to be seen sample by sample
    more = recording.table.assign(gyro_pulses=recording.column("gyro_pulses") + few)
    _, (remark,) = conventional_scale_factors([recording.replace(table=more)])
    assert (remark.code, remark.data["others"]) == ("calibration.outlying_repeat", 4)
    assert not conventional_scale_factors([recording])[1]


def test_angle_random_walk_is_in_the_standard_error_of_few_repeats() -> None:
    noisy = dataclasses.replace(TABLE, angle_random_walk_deg_sqrt_h=0.002)
    scores, walks = [], []
    for seed in range(30):
        (found,), _ = conventional_scale_factors([noisy.rate_recording(1, seed, rates_deg_s=60.0, step_s=0.02)])
        scores.append((found.scale_arcsec / noisy.conventional_arcsec - 1.0) / found.relative_sd)
        walks.append(found.angle_random_walk_deg_sqrt_h)
    assert np.median(walks) == pytest.approx(0.002, rel=0.1)
    assert 0.7 < math.sqrt(np.mean(np.square(scores))) < 1.35


def test_one_revolution_each_way_does_not_determine_random_walk() -> None:
    (found,), (remark,) = conventional_scale_factors([TABLE.rate_recording(1, 0, revolutions=1)])
    assert math.isnan(found.angle_random_walk_deg_sqrt_h)
    assert remark.code == "calibration.random_walk_unknown"
    assert remark.data["rates_deg_s"] == pytest.approx([150.0], rel=1e-3)


# --- together, and from files --------------------------------------------------------------------------------------------------


def test_scale_factor_to_better_than_a_tenth_of_a_millionth() -> None:
    found = calibrate_scale_factor([TABLE.rate_recording(10, 2), TABLE.position_recording(POSITIONS, 3)])
    assert abs(found.scale_arcsec / TABLE.scale_arcsec - 1.0) < 1e-7
    assert abs(found.scale_arcsec / TABLE.scale_arcsec - 1.0) < 4.0 * found.relative_sd
    assert abs(found.conventional.scale_arcsec / TABLE.scale_arcsec - 1.0) > 4e-6  # what the mounting angle is worth


def test_standard_error_of_the_corrected_scale_factor_is_true() -> None:
    scores = []
    for seed in range(40):
        rate = TABLE.rate_recording(3, 2 * seed, revolutions=2, step_s=0.02)
        positions = TABLE.position_recording(POSITIONS, 2 * seed + 1, rate_deg_s=40.0, step_s=0.04)
        found = calibrate_scale_factor([rate, positions])
        scores.append((found.scale_arcsec / TABLE.scale_arcsec - 1.0) / found.relative_sd)
    assert 0.8 < math.sqrt(np.mean(np.square(scores))) < 1.25


def test_two_tables_alone_serve_for_both_measurements() -> None:
    """No `table_angle_deg`: the inner table turning with the outer at rest is the conventional measurement."""
    turning = TABLE.rate_recording(3, 2)
    table = turning.table.rename(columns={"table_angle_deg": "angle_inner_deg"}).assign(angle_outer_deg=12.0)
    both = calibrate_scale_factor([turning.replace(table=table), TABLE.position_recording(POSITIONS, 3)])
    apart = calibrate_scale_factor([turning, TABLE.position_recording(POSITIONS, 3)])
    assert both.scale_arcsec == apart.scale_arcsec


def test_one_file_may_hold_everything() -> None:
    turning, positions = TABLE.rate_recording(3, 2), TABLE.position_recording(POSITIONS, 3)
    first = turning.table.rename(columns={"table_angle_deg": "angle_inner_deg"}).assign(angle_outer_deg=0.0)
    second = positions.table.assign(time_s=positions.time_s + turning.duration_s + 60.0)
    both = turning.replace(table=pd.concat([first, second])[first.columns])
    assert calibrate_scale_factor([both]).scale_arcsec == pytest.approx(
        calibrate_scale_factor([turning, positions]).scale_arcsec, rel=1e-13
    )


def test_positions_during_which_the_inner_table_crept_are_left_out() -> None:
    positions = TABLE.position_recording([*POSITIONS, 45.0], 3)
    crept = positions.table.assign(
        angle_inner_deg=positions.column("angle_inner_deg") + np.where(positions.time_s > 300.0, positions.time_s / 60.0, 0.0)
    )
    found = calibrate_scale_factor([positions.replace(table=crept)], conventional_arcsec=TABLE.conventional_arcsec)
    assert len(found.mounting.positions) == 4
    moved = [remark.data for remark in found.remarks if remark.code == "calibration.table_moved"]
    assert [(data["column"], data["segments"]) for data in moved] == [("angle_inner_deg", 2)]


def test_positions_more_than_once_round_are_no_conventional_measurement() -> None:
    """Steps of 100 degrees without unwinding: the inner table turns by three revolutions, and never steadily."""
    positions = TABLE.position_recording(100.0 * np.arange(12), 3, rate_deg_s=40.0)
    found = calibrate_scale_factor([positions], conventional_arcsec=TABLE.conventional_arcsec)
    assert found.conventional is None
    assert len(found.mounting.positions) == 12
    assert found.mounting.theta_arcsec == pytest.approx(TABLE.mounting_arcsec, abs=1.0)


def test_a_gyro_along_its_table_has_no_significant_mounting_angle() -> None:
    aligned = dataclasses.replace(TABLE, mounting_arcsec=0.1)
    found = calibrate_scale_factor([aligned.position_recording(POSITIONS, 3)], conventional_arcsec=TABLE.scale_arcsec)
    assert "calibration.mounting_angle_near_zero" in [remark.code for remark in found.remarks]


@settings(max_examples=60, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    rows=st.integers(3, 400),
    step_deg=st.floats(-200.0, 200.0),
    shake_deg=st.floats(0.0, 400.0),
    pulses=st.sampled_from([0.0, 1.0, 1e4, -1e6]),
    columns=st.sampled_from([("table_angle_deg",), ("angle_inner_deg", "angle_outer_deg"), ("angle_outer_deg",)]),
)
def test_no_recording_makes_anything_but_an_answer_or_a_refusal(
    seed: int, rows: int, step_deg: float, shake_deg: float, pulses: float, columns: tuple[str, ...]
) -> None:
    rng = np.random.default_rng(seed)
    frame = pd.DataFrame({"time_s": np.cumsum(rng.uniform(0.01, 0.2, rows)), "gyro_pulses": pulses * rng.standard_normal(rows)})
    for column in columns:
        frame[column] = np.cumsum(step_deg * rng.choice([0.0, 1.0, -1.0]) + shake_deg * rng.standard_normal(rows))
    with contextlib.suppress(InputError):
        found = calibrate_scale_factor([rlg.Recording(frame)], conventional_arcsec=1.0)
        assert np.isnan(found.scale_arcsec) or 0.0 < found.scale_arcsec < np.inf
        assert np.isnan(found.relative_sd) or found.relative_sd >= 0.0
        assert str(found.to_frame())


@pytest.mark.slow
def test_standard_error_of_the_corrected_scale_factor_over_many_recordings() -> None:
    """As the paper measures: five revolutions at 150 deg/s and 100 Hz, four positions of one revolution in 36 s."""
    scores, off = [], []
    for seed in range(150):
        rate, positions = TABLE.rate_recording(20, 2 * seed), TABLE.position_recording(POSITIONS, 2 * seed + 1)
        found = calibrate_scale_factor([rate, positions])
        off.append(found.scale_arcsec / TABLE.scale_arcsec - 1.0)
        scores.append((off[-1] / found.relative_sd, (found.mounting.theta_arcsec - 646.75) / found.mounting.theta_sd_arcsec))
    assert np.max(np.abs(off)) < 1e-7
    assert (np.abs(np.sqrt(np.mean(np.square(scores), axis=0)) - 1.025) < 0.225).all()


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    register_commands()
    folder = tmp_path_factory.mktemp("runs")
    rlg.write(TABLE.rate_recording(8, 1), folder / "turning.parquet")
    rlg.write(TABLE.position_recording(POSITIONS, 2), folder / "positions.parquet")
    for k, beta in enumerate(POSITIONS):
        rlg.write(TABLE.position_recording(beta, 10 + k), folder / f"position{k}.csv.gz")
    for k in range(4):
        gyro = dataclasses.replace(TABLE, lock_in_deg_s=0.017 * (1.0 + 0.02 * (-1) ** k))
        run = gyro.rate_recording(1, k, rates_deg_s=[2.0, 4.0, 12.0, 40.0, 60.0], revolutions=2, step_s=0.05)
        rlg.write(run, folder / f"rates{k}.parquet")
    return folder


def command(*arguments: object) -> object:
    return CliRunner().invoke(app, ["scale-factor", *[str(argument) for argument in arguments]])


def refused(*arguments: object) -> str:
    result = command(*arguments)
    assert result.exit_code == 2, result.output
    assert "Traceback" not in result.output
    return " ".join(result.output.split())


def test_command_gives_k_from_one_file_or_many(folder: Path, tmp_path: Path) -> None:
    scales = []
    for positions in (["positions.parquet"], [f"position{k}.csv.gz" for k in (2, 0, 3, 1)]):
        out = tmp_path / "k.json"
        result = command(folder / "turning.parquet", *[folder / name for name in positions], "--out", out, "--json")
        assert result.exit_code == 0, result.output
        found = json.loads(result.stdout)
        assert found == json.loads(out.read_text())
        assert abs(found["pulse_arcsec"] / TABLE.scale_arcsec - 1.0) < min(1e-7, 4.0 * found["relative_sd"])
        assert found["mounting"]["theta_arcsec"] == pytest.approx(646.75, abs=1.5)
        assert not found["remarks"]
        scales.append(found["pulse_arcsec"])
        raw = rlg.read(folder / "turning.parquet")
        calibrated = rlg.Calibration.read(out).apply(raw)
        assert calibrated.column("gyro_deg_h") == pytest.approx(raw.column("gyro_pulses") * found["pulse_arcsec"] / raw.period_s)
    assert scales[0] != scales[1]  # other noise, the same answer


def test_the_file_and_its_page_are_replaced_together(folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    runs = [folder / "turning.parquet", folder / "positions.parquet"]
    assert command(*runs, "--out", tmp_path / "k.json").exit_code == 0
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    assert before.keys() == {"k.json", "k.html"}
    with monkeypatch.context() as broken:
        broken.setattr("rlgcomp.report.page.write_text", lambda *_: 1 / 0)
        assert command(*runs[:1], "--out", tmp_path / "k.json").exit_code == 1
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == before
    assert command(*runs[:1], "--out", tmp_path / "k.json").exit_code == 0
    after = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    assert after.keys() == before.keys()
    assert all(after[name] != before[name] for name in before)


def test_command_for_people(folder: Path) -> None:
    result = command(folder / "turning.parquet", folder / "positions.parquet")
    assert result.exit_code == 0
    for text in ("Conventional scale factor", "theta, arcsec", "Error budget", "K = 0.84279"):
        assert text in result.output
    helped = command("--help")
    assert "rlgcomp scale-factor" in " ".join(helped.output.split())


def test_the_spread_of_one_repeat_is_an_empty_cell(tmp_path: Path) -> None:
    register_commands()
    rlg.write(from_turn_to_turn(0.0), tmp_path / "once.parquet")
    result = command(tmp_path / "once.parquet")
    assert result.exit_code == 0, result.output
    assert "relative spread" in result.output
    assert "nan" not in result.output


def test_no_lock_in_is_stated_of_one_repeat(folder: Path) -> None:
    """It would have no error: three rates with one repeat each gave 0.00198 deg/s of a gyro without lock-in."""
    runs = [rlg.read(folder / f"rates{k}.parquet") for k in range(4)]
    one, four = calibrate_scale_factor(runs[:1]), calibrate_scale_factor(runs)
    assert one.lock_in is None
    assert one.rates is not None
    assert one.rates.repeatability.code == "calibration.one_repeat"
    assert four.lock_in is not None


def test_command_against_rate(folder: Path) -> None:
    result = command(*[folder / f"rates{k}.parquet" for k in range(4)], "--json")
    assert result.exit_code == 0, result.output
    found = json.loads(result.stdout)
    assert found["pulse_arcsec"] is None
    assert [rate["repeats"] for rate in found["rates"]] == [4] * 5
    assert abs(found["lock_in"]["lock_in_deg_s"] - 0.017) < 4.0 * found["lock_in"]["lock_in_sd_deg_s"]
    # lock-in of 0.017 deg/s costs 9 ppm at 4 deg/s and 1.003 ppm at 12, where the mean of the higher rates is down by 0.07
    assert found["conventional"]["rate_deg_s"] == pytest.approx(12.0, rel=1e-3)


def test_command_without_a_conventional_measurement(folder: Path) -> None:
    assert "--conventional" in refused(folder / "positions.parquet")
    result = command(folder / "positions.parquet", "--conventional", 0.8427948, "--json")
    assert result.exit_code == 0
    found = json.loads(result.stdout)
    assert found["pulse_arcsec"] == pytest.approx(TABLE.scale_arcsec, rel=1e-7)
    assert found["relative_sd"] is None


def test_command_names_the_fault_of_its_input(folder: Path, tmp_path: Path) -> None:
    turning = rlg.read(folder / "turning.parquet")
    reversal = turning.time_s[int(np.argmax(turning.column("table_angle_deg") > 1800.0))]
    rlg.write(turning.between(0.0, reversal), tmp_path / "forwards.parquet")
    rlg.write(turning.between(0.0, 2.0), tmp_path / "short.parquet")
    rlg.write(turning.replace(table=turning.table.drop(columns="table_angle_deg")), tmp_path / "blind.parquet")
    in_degrees = turning.table.rename(columns={"gyro_pulses": "gyro_deg_s"})
    rlg.write(turning.replace(table=in_degrees), tmp_path / "degrees.parquet")
    assert "one direction only" in refused(tmp_path / "forwards.parquet")
    assert "no table turns a whole revolution" in refused(tmp_path / "short.parquet")
    assert "there is no encoder column" in refused(tmp_path / "blind.parquet")
    assert "not in pulses" in refused(tmp_path / "degrees.parquet", "--map", "gyro_deg_s=gyro_deg_s [deg/s]")
    assert "cannot separate" in refused(folder / "turning.parquet", folder / "position0.csv.gz", folder / "position2.csv.gz")
    assert "the longest has 5" in refused(folder / "turning.parquet", "--revolutions", 6)
    assert "--stated" in refused(folder / "turning.parquet", "--stated", "wobble=0.5")
    assert "does not exist" in refused(folder / "turning.parquet", "--out", tmp_path / "nowhere" / "k.json")
    assert "gyro columns" in refused(folder / "turning.parquet", "--gyro", "gyro_x_pulses")
    assert not list(tmp_path.glob("*.json"))
