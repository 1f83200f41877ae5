"""The compensator: units, streaming, range guard, and how near it comes to the noise floor."""

from __future__ import annotations

import logging

import numpy as np
import pandas as pd
import pytest
from sklearn.neighbors import KNeighborsRegressor

import rlgcomp as rlg
from rlgcomp.compensation.models import MODELS


def test_it_removes_the_bias_of_a_run_held_out(trained: rlg.Compensator, short_runs: list[rlg.Recording]) -> None:
    run = short_runs[2]
    corrected = trained.correct(run)
    before, after = (part.averaged().rate_deg_h().std() for part in (run, corrected))
    assert after < 0.5 * before
    assert corrected.rate_deg_h() + corrected.column("compensation_deg_h") == pytest.approx(run.rate_deg_h(), abs=1e-15)
    assert len(corrected) == len(run)


@pytest.mark.parametrize("column", ["gyro_deg_s", "gyro_pulses"])
def test_any_gyro_unit_gives_the_same_correction(short_runs: list[rlg.Recording], column: str) -> None:
    """Trained and used on the same run in deg/h, deg/s and pulses."""
    run = short_runs[0]
    factor = {"gyro_deg_s": 1 / 3600.0, "gyro_pulses": run.period_s / 0.5}[column]
    table = run.table.rename(columns={"gyro_deg_h": column})
    table[column] *= factor
    other = run.replace(table=table, metadata=rlg.Metadata(pulse_arcsec=0.5))
    expected, corrected = (
        rlg.Compensator(rlg.CubicLeastSquares(), features="temperature").fit([part]).correct(part) for part in (run, other)
    )
    assert corrected.rate_deg_h() == pytest.approx(expected.rate_deg_h(), abs=1e-12)
    assert corrected.gyro_columns == (("gyro_deg_s",) if column == "gyro_deg_s" else ("gyro_deg_h",))


def test_a_stream_gives_what_the_whole_gives(trained: rlg.Compensator, short_runs: list[rlg.Recording]) -> None:
    run = short_runs[2].between(0.0, 5000.0)
    whole = trained.predict(run)
    trained.restart()
    steps = [trained.step(sample) for sample in run.table.to_dict("records")]
    trained.restart()
    assert np.array([step.bias_deg_h for step in steps]) == pytest.approx(whole["bias_deg_h"].to_numpy(), abs=1e-12)
    assert [step.out_of_range for step in steps] == whole["out_of_range"].tolist()


def test_inputs_beyond_training_are_flagged_and_the_output_stays_bounded(
    trained: rlg.Compensator, short_runs: list[rlg.Recording]
) -> None:
    run = short_runs[2]
    wild = run.table
    wild.loc[500:, "temperature_block_degC"] += 400.0
    wild.loc[500:, "light_intensity_V"] *= 50.0
    predicted = trained.predict(run.replace(table=wild))
    assert not predicted["out_of_range"][:500].any()
    assert predicted["out_of_range"][500:].all()
    within = trained.predict(run)["bias_deg_h"]
    assert np.abs(predicted["bias_deg_h"]).max() < 3.0 * np.ptp(within) + np.abs(within).max()


def test_the_mean_is_preserved_on_request(short_runs: list[rlg.Recording]) -> None:
    turned = [run.replace(table=run.table.assign(gyro_deg_h=run.rate_deg_h() + 11.7)) for run in short_runs]
    for keep, expected in ((True, 11.7), (False, 0.0)):
        model = rlg.Compensator(rlg.CubicLeastSquares(), features="temperature", keep_mean=keep).fit(turned[:2])
        assert model.correct(turned[2]).rate_deg_h().mean() == pytest.approx(expected, abs=0.02)


def test_earth_rate_in_the_mean_is_logged(short_runs: list[rlg.Recording], caplog: pytest.LogCaptureFixture) -> None:
    turned = [run.replace(table=run.table.assign(gyro_deg_h=run.rate_deg_h() + 11.7)) for run in short_runs[:2]]
    with caplog.at_level(logging.WARNING):
        rlg.Compensator(rlg.CubicLeastSquares(), features="temperature").fit(turned)
    assert "may hold Earth rate" in caplog.text


def test_one_run_is_split_into_blocks_with_a_warning(short_runs: list[rlg.Recording], caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.WARNING):
        model = rlg.Compensator(rlg.CubicLeastSquares(), features="temperature").fit(short_runs[:1])
    assert "one run only" in caplog.text
    assert set(model.training_rows()[2]) == {0, 1, 2, 3, 4}


def test_the_lead_in_is_neither_fitted_nor_scored(short_runs: list[rlg.Recording]) -> None:
    run = short_runs[0]
    spoilt = run.table
    spoilt.loc[: len(run) // 2, "gyro_deg_h"] += 5.0
    later = run.replace(table=spoilt).between(run.time_s[len(run) // 2 + 1], np.inf, keep_history=True)
    model = rlg.Compensator(rlg.CubicLeastSquares(), features="temperature,lag").fit([later])
    assert abs(model.scaling_.y_mean_deg_h) < 0.1
    assert len(model.training_[0].time_s) == pytest.approx(len(run) * 5 / 100 / 2, abs=2)


def test_dynamics_are_linear_in_the_dynamic_model(short_runs: list[rlg.Recording]) -> None:
    model = rlg.Compensator(MODELS["dynamic"].make()).fit(short_runs[:2])
    places = model.pipeline_.dynamic
    assert len(places) > 3
    assert not model.model_.coef_[1:, list(places)].any()
    assert model.model_.coef_[1:, 0].any()


def test_a_model_of_the_users_own(short_runs: list[rlg.Recording], tmp_path: object) -> None:
    model = rlg.Compensator(KNeighborsRegressor(), features="temperature").fit(short_runs[:2])
    assert np.isfinite(model.correct(short_runs[2]).rate_deg_h()).all()


@pytest.mark.needs("torch")
def test_the_sequence_model_answers_a_window_late(short_runs: list[rlg.Recording]) -> None:
    model = rlg.Compensator(rlg.SequenceRegressor(epochs=30), features="temperature")
    model.model.set_params(epochs=30)
    model.fit(short_runs[:2])
    bias = model.predict(short_runs[2])["bias_deg_h"].to_numpy().reshape(-1, 20)  # 100 s are 20 samples of 5 s
    assert (np.ptp(bias, axis=1) == 0.0).all()
    with pytest.raises(rlg.InputError, match="not sample by sample"):
        model.step({"time_s": 0.0, "temperature_block_degC": 20.0})


def test_an_unfitted_one_is_refused(short_runs: list[rlg.Recording]) -> None:
    with pytest.raises(rlg.InputError, match="not fitted yet"):
        rlg.Compensator().predict(short_runs[0])
    with pytest.raises(rlg.InputError, match="no runs to train on"):
        rlg.Compensator().fit([])


def test_a_missing_monitor_is_named(trained: rlg.Compensator, short_runs: list[rlg.Recording]) -> None:
    bare = short_runs[2].replace(table=short_runs[2].table.drop(columns="readout_a_V"))
    with pytest.raises(rlg.InputError, match="has no readout_a_V"):
        trained.predict(bare)


def test_a_recording_with_dark_readouts_is_refused(trained: rlg.Compensator, short_runs: list[rlg.Recording]) -> None:
    run = short_runs[2]
    table = run.table.copy()
    table.loc[table.index[7], ["readout_a_V", "readout_b_V"]] = 0.0
    with pytest.raises(rlg.InputError, match=f"at {run.time_s[7]:g} s readout_difference is undefined for .*readout_a_V = 0"):
        trained.predict(run.replace(table=table))


def test_runs_too_short_are_refused() -> None:
    table = pd.DataFrame(
        {"time_s": np.arange(50.0), "gyro_deg_h": np.sin(np.arange(50.0)), "temperature_block_degC": np.arange(50.0)}
    )
    with pytest.raises(rlg.InputError, match="too short to average"):
        rlg.Compensator().fit([rlg.Recording(table)])


@pytest.mark.parametrize(("hysteresis", "limit"), [("play", 1.15), ("preisach", 1.30)])
@pytest.mark.parametrize("seed", [0, 1, *(pytest.param(seed, marks=pytest.mark.slow) for seed in range(2, 10))])
def test_it_reaches_the_noise_floor_on_another_programme(hysteresis: str, limit: float, seed: int) -> None:
    """Paper-like units, all features, LS-SVM, held out on a programme not trained on; Preisach's law is not in the features."""
    gyro = rlg.simulated_unit(seed, hysteresis=hysteresis)
    runs = [gyro.simulate(programme, seed=10 * seed + k, name=programme) for k, programme in enumerate(("paper", "minor-loops"))]
    held_out = gyro.simulate("reversed", seed=10 * seed + 9)
    evaluation = rlg.evaluate(rlg.Compensator().fit(runs), [held_out], compare=False)
    assert evaluation.residual_std_deg_h < limit * evaluation.noise_floor_deg_h
