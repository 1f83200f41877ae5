"""The offset of a new run, zeroed at its start: exact, causal, the same in a file and in a stream, and covered by its interval."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from typer.testing import CliRunner

import rlgcomp as rlg
from rlgcomp.cli import register_commands
from rlgcomp.cli.base import app
from rlgcomp.compensation.start_offset import StartOffset

register_commands()
OFFSET_DEG_H = 0.3


@pytest.fixture(scope="module")
def model(short_runs: list[rlg.Recording]) -> rlg.Compensator:
    shifted = [shift(run, b) for run, b in zip(short_runs[:2], (0.05, -0.04), strict=True)]
    return rlg.Compensator(rlg.CubicLeastSquares(), features="temperature,readout_difference").fit(shifted)


def shift(run: rlg.Recording, offset_deg_h: float) -> rlg.Recording:
    return run.replace(table=run.table.assign(gyro_deg_h=run.rate_deg_h() + offset_deg_h))


@settings(max_examples=50, deadline=None)
@given(st.lists(st.integers(0, 60), max_size=5), st.floats(0.1, 400.0))
def test_any_pieces_give_the_bits_of_the_whole(cuts: list[int], duration_s: float) -> None:
    rng = np.random.default_rng(0)
    time_s, difference = np.cumsum(rng.uniform(1.0, 10.0, 60)), rng.standard_normal(60)
    whole, over = StartOffset(duration_s).run(time_s, difference)
    pieces = StartOffset(duration_s)
    parts = [pieces.run(t, d) for t, d in zip(np.split(time_s, sorted(cuts)), np.split(difference, sorted(cuts)), strict=True)]
    assert np.array_equal(np.concatenate([offsets for offsets, _ in parts]), whole)
    within = time_s - time_s[0] < duration_s
    assert np.array_equal(over, ~within)
    assert whole[-1] == pytest.approx(difference[within].mean())
    assert whole[0] == difference[0]


@pytest.mark.parametrize("duration_s", [0.0, -1.0, np.nan, np.inf])
def test_a_start_of_no_length_is_refused(duration_s: float) -> None:
    with pytest.raises(rlg.InputError, match="offset_s"):
        StartOffset(duration_s)


def test_an_offset_of_a_run_is_taken_away_and_the_interval_covers(model: rlg.Compensator, short_runs: list[rlg.Recording]) -> None:
    run = shift(short_runs[2], OFFSET_DEG_H)
    (plain,) = rlg.evaluate(model, [run], compare=False).runs
    (zeroed,) = rlg.evaluate(model, [run], compare=False, offset_s=1200.0).runs
    assert plain.residual_rms_deg_h > 0.9 * OFFSET_DEG_H
    assert zeroed.residual_rms_deg_h < 0.1 * OFFSET_DEG_H
    assert zeroed.in_interval > 0.8
    assert model.offset_interval(1200.0).inside_deg_h < model.interval_.inside_deg_h


def test_a_stream_gives_what_the_file_gives(model: rlg.Compensator, short_runs: list[rlg.Recording], tmp_path: Path) -> None:
    run = shift(short_runs[2], OFFSET_DEG_H)
    model.save(tmp_path / "model")
    run.table.to_csv(tmp_path / "run.csv", index=False)
    options = ["compensate", str(tmp_path / "model"), str(tmp_path / "run.csv"), "--offset", "zero-at-start", "1200", "--out"]
    assert CliRunner().invoke(app, [*options, str(tmp_path / "file.csv")]).exit_code == 0
    assert CliRunner().invoke(app, [*options, str(tmp_path / "stream.csv"), "--follow", "--idle-s", "0"]).exit_code == 0
    in_file, in_stream = (pd.read_csv(tmp_path / f"{name}.csv") for name in ("file", "stream"))
    for column in ("compensation_deg_h", "compensation_half_width_deg_h"):
        assert in_stream[column].to_numpy() == pytest.approx(in_file[column].to_numpy(), rel=1e-9)
    later = in_file["time_s"] >= 1200.0
    assert (in_file["gyro_deg_h"][later].mean()) == pytest.approx(0.0, abs=0.1 * OFFSET_DEG_H)


def test_another_offset_is_refused(model: rlg.Compensator, tmp_path: Path) -> None:
    model.save(tmp_path / "model")
    result = CliRunner().invoke(app, ["compensate", str(tmp_path / "model"), "run.csv", "--offset", "none", "6", "--out", "x.csv"])
    assert result.exit_code == 2
    assert "zero-at-start" in result.output


@pytest.mark.parametrize(
    ("offset_s", "expected"),
    [(5.0, "compensation.zeroed_by_noise"), (600.0, None), (1e6, "compensation.zeroed_throughout")],
)
def test_a_start_that_is_noise_or_the_whole_run_is_told(
    model: rlg.Compensator, short_runs: list[rlg.Recording], offset_s: float, expected: str | None
) -> None:
    found = rlg.evaluate(model, short_runs[2:], compare=False, offset_s=offset_s).remarks
    told = [one for one in found if one.code in ("compensation.zeroed_by_noise", "compensation.zeroed_throughout")]
    assert [one.code for one in told] == ([] if expected is None else [expected])
    if expected == "compensation.zeroed_by_noise":
        steps = np.diff(short_runs[2].rate_deg_h())
        assert told[0].data["samples"] == 1
        assert told[0].data["noise_deg_h"] == pytest.approx(np.std(steps) / np.sqrt(2.0), rel=0.2)


def test_an_offset_that_makes_the_gyro_worse_is_told(model: rlg.Compensator, short_runs: list[rlg.Recording]) -> None:
    """By its scatter the run is better, and its rms is many times that without a compensation."""
    for offset_deg_h, worse in ((1.0, True), (0.0, False)):
        training = [shift(run, offset_deg_h) for run in short_runs[:2]]
        shifted = rlg.Compensator(rlg.CubicLeastSquares(), features="temperature").fit(training)
        remarks = {one.code: one.data for one in rlg.evaluate(shifted, short_runs[2:], compare=False).remarks}
        assert ("evaluation.worse_with_offset" in remarks) is worse
        if worse:
            assert remarks["evaluation.worse_with_offset"]["residual_rms_deg_h"] == pytest.approx(1.0, rel=0.1)


@pytest.mark.parametrize(("earth_deg_h", "keep_mean", "told"), [(11.2, False, True), (0.0, True, True), (0.0, False, False)])
def test_earth_rate_that_the_offset_takes_away_is_told(
    short_runs: list[rlg.Recording], earth_deg_h: float, keep_mean: bool, told: bool, tmp_path: Path
) -> None:
    runs = [shift(run, earth_deg_h) for run in short_runs]
    model = rlg.Compensator(rlg.CubicLeastSquares(), features="temperature", keep_mean=keep_mean).fit(runs[:2])
    codes = [remark.code for remark in rlg.evaluate(model, runs[2:], compare=False, offset_s=600.0).remarks]
    assert ("compensation.zeroed_with_earth_rate" in codes) is told
    assert "compensation.zeroed_with_earth_rate" not in [one.code for one in rlg.evaluate(model, runs[2:], compare=False).remarks]
    model.save(tmp_path / "model")
    rlg.write(runs[2], tmp_path / "new.parquet")
    model_and_run, out = (tmp_path / "model", tmp_path / "new.parquet"), tmp_path / "c.csv"
    arguments = ["compensate", *model_and_run, "--offset", "zero-at-start", 600, "--out", out]
    result = CliRunner().invoke(app, [str(argument) for argument in arguments])
    assert result.exit_code == 0, result.output
    assert ("Earth rate is lost" in " ".join(result.output.split())) is told
