"""Evaluation: the numbers are what they say, intervals cover, and the floor is the floor."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

import rlgcomp as rlg
from rlgcomp.cli.show import show_evaluation
from rlgcomp.compensation.selection import Selection, select
from rlgcomp.evaluation import comparison
from rlgcomp.evaluation.comparison import correlation_table
from rlgcomp.evaluation.evaluation import improvement
from rlgcomp.evaluation.page import render
from rlgcomp.files import to_json
from rlgcomp.noise.processes import NOISES


@pytest.fixture(scope="module")
def evaluation(trained: rlg.Compensator, short_runs: list[rlg.Recording]) -> rlg.Evaluation:
    return rlg.evaluate(trained, short_runs[2:])


def test_bias_stability_is_the_standard_deviation_of_means(
    evaluation: rlg.Evaluation, trained: rlg.Compensator, short_runs: list[rlg.Recording]
) -> None:
    (result,), run = evaluation.runs, short_runs[2]
    assert result.raw_std_deg_h == pytest.approx(np.std(run.averaged().rate_deg_h(), ddof=1))
    corrected = trained.correct(run).averaged().rate_deg_h()
    assert result.residual_std_deg_h == pytest.approx(np.std(corrected, ddof=1), rel=1e-9)
    assert result.residual_rms_deg_h == pytest.approx(np.sqrt(np.mean(corrected**2)), rel=1e-9)
    assert result.factor == pytest.approx(result.raw_std_deg_h / result.residual_std_deg_h)
    assert result.factor_low < result.factor < result.factor_high


def test_the_floor_of_a_simulated_run_is_its_noise(evaluation: rlg.Evaluation, short_runs: list[rlg.Recording]) -> None:
    truth = short_runs[2].averaged().truth
    noise = truth[[name for name in NOISES if name in truth]].sum(axis=1)
    assert evaluation.noise_floor_deg_h == pytest.approx(noise.std(), rel=1e-9)


def test_the_floor_of_a_real_run_is_near_it(
    evaluation: rlg.Evaluation, trained: rlg.Compensator, short_runs: list[rlg.Recording]
) -> None:
    """Without truth the floor comes from the Allan deviation: within 15 % of the noise that was put in."""
    blind = rlg.evaluate(trained, [short_runs[2].replace(truth=None)], compare=False)
    assert blind.noise_floor_deg_h == pytest.approx(evaluation.noise_floor_deg_h, rel=0.15)


def test_a_model_that_adds_noise_does_not_raise_the_floor(trained: rlg.Compensator, short_runs: list[rlg.Recording]) -> None:
    """The floor is the gyro's, whatever model is evaluated; noise of an input is named."""
    run = short_runs[2].replace(truth=None)
    noise_degC = 20.0 * np.random.default_rng(0).standard_normal(len(run))
    noisy = run.replace(table=run.table.assign(temperature_shell_degC=run.column("temperature_shell_degC") + noise_degC))
    good, worse = (rlg.evaluate(trained, [one], compare=False) for one in (run, noisy))
    assert worse.residual_std_deg_h > 1.5 * good.residual_std_deg_h
    assert worse.noise_floor_deg_h == pytest.approx(good.noise_floor_deg_h, rel=0.05)
    assert "evaluation.adds_noise" not in [remark.code for remark in good.remarks]
    (remark,) = [remark for remark in worse.remarks if remark.code == "evaluation.adds_noise"]
    added = np.sqrt(worse.residual_std_deg_h**2 - good.residual_std_deg_h**2)
    assert remark.data["added_deg_h"] == pytest.approx(added, rel=0.3)


def test_each_group_is_judged_in_the_company_of_the_others(evaluation: rlg.Evaluation, trained: rlg.Compensator) -> None:
    """Each group is left out in turn; alone, an input that corrects a small part would look useless."""
    table = evaluation.comparison
    groups = [feature.group for feature in trained.pipeline_.features]
    listed = list(dict.fromkeys(table["features"]))
    assert listed == [groups[0], *(f"all without {group}" for group in groups), "all"]
    residuals = table[table["model"] == "lssvm"].set_index("features")["residual_std_deg_h"]
    assert residuals["all"] <= 1.02 * residuals.min()
    assert residuals[groups[0]] == residuals.max()
    assert residuals["all without readout_difference"] > 1.5 * residuals["all"]
    assert set(table["model"]) == {"cubic", "lssvm"}
    assert (table["factor"] * table["residual_std_deg_h"]).to_numpy() == pytest.approx(
        np.full(len(table), evaluation.raw_std_deg_h)
    )


def test_the_own_model_is_the_one_that_would_be_selected_anew(
    trained: rlg.Compensator, short_runs: list[rlg.Recording], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """Its selection is not repeated, of a model that was saved neither."""
    trained.save(tmp_path / "model")
    calls = []

    def counted(*arguments: Any, **options: Any) -> Selection:
        calls.append(arguments[0].name)
        return select(*arguments, **options)

    monkeypatch.setattr(comparison, "select", counted)
    own = [rlg.evaluate(one, short_runs[2:]).comparison for one in (trained, rlg.load(tmp_path / "model"))]
    count = len(calls)
    monkeypatch.setattr(comparison, "is_own_model", lambda *_: False)
    anew = rlg.evaluate(trained, short_runs[2:]).comparison
    assert (count, len(calls)) == (2 * (len(anew) - 1), count + len(anew))
    for one in own:
        pd.testing.assert_frame_equal(one, anew, check_exact=True)


def test_several_runs_are_pooled_by_variance(trained: rlg.Compensator, short_runs: list[rlg.Recording]) -> None:
    both = rlg.evaluate(trained, short_runs[1:], compare=False)
    each = [run.residual_std_deg_h for run in both.runs]
    assert both.residual_std_deg_h == pytest.approx(np.sqrt(np.mean(np.square(each))))


def test_a_shift_of_the_mean_is_not_instability(trained: rlg.Compensator, short_runs: list[rlg.Recording]) -> None:
    run = short_runs[2]
    shifted = run.replace(table=run.table.assign(gyro_deg_h=run.rate_deg_h() + 1.0))
    one, other = rlg.evaluate(trained, [run], compare=False), rlg.evaluate(trained, [shifted], compare=False)
    assert other.residual_std_deg_h == pytest.approx(one.residual_std_deg_h, rel=1e-9)
    assert other.runs[0].residual_mean_deg_h == pytest.approx(one.runs[0].residual_mean_deg_h + 1.0)


def test_correlation_is_pearsons(trained: rlg.Compensator, short_runs: list[rlg.Recording]) -> None:
    part = trained.training_[0]
    table = correlation_table([part], trained.pipeline_.names)
    expected = [np.corrcoef(column, part.y_deg_h)[0, 1] for column in part.X.T]
    assert table["correlation"].to_numpy() == pytest.approx(np.array(expected), abs=1e-12)


def test_the_bootstrap_interval_covers() -> None:
    """White noise of known ratio 2, correlated raw: the 95 % interval holds the true ratio in 90 to 99 % of 200 runs."""
    rng = np.random.default_rng(0)
    inside = []
    for seed in range(200):
        residual, more = rng.standard_normal((2, 400))
        raw = residual + np.sqrt(3.0) * more
        factor, low, high = improvement(raw, residual, block=10, seed=seed)
        assert low < factor < high
        inside.append(low <= 2.0 <= high)
    assert 0.90 <= np.mean(inside) <= 0.99


def test_everything_is_plain_json(evaluation: rlg.Evaluation) -> None:
    content = json.loads(to_json(evaluation.to_mapping()))
    assert content["schema"] == "rlgcomp.evaluation/1"
    assert content["pooled"]["floor_ratio"] == pytest.approx(evaluation.residual_std_deg_h / evaluation.noise_floor_deg_h)
    assert len(content["traces"][0]["time_s"]) == evaluation.runs[0].windows


@pytest.mark.usefixtures("undrawn")
def test_a_run_that_was_trained_on_has_a_remark(
    trained: rlg.Compensator, short_runs: list[rlg.Recording], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    trained.save(tmp_path / "model")
    known = short_runs[0]
    rounded = known.replace(table=known.table.assign(gyro_deg_h=known.rate_deg_h().round(5)), name="rounded")
    part = known.between(5010.0, 20000.0, name="part")
    model = rlg.load(tmp_path / "model")
    evaluation = rlg.evaluate(model, [known, rounded, part, *short_runs[2:]], compare=False)
    assert [run.trained_on for run in evaluation.runs] == [True, True, True, False]  # windows off the grid by their noise
    assert rlg.evaluate(model, [known.between(5000.0, 20000.0)], compare=False).runs[0].trained_on
    remark = next(remark for remark in evaluation.remarks if remark.code == "evaluation.trained_on")
    assert remark.data == {"run": "short-1"}
    assert remark.to_mapping() in json.loads(to_json(evaluation.to_mapping()))["remarks"]
    other = rlg.evaluate(model, short_runs[2:], compare=False)
    assert not any(remark.code == "evaluation.trained_on" for remark in other.remarks)
    page = render(evaluation, model)
    assert remark.text in page
    assert "was not trained on" not in page
    show_evaluation(evaluation)
    out = capsys.readouterr().out
    assert remark.text in out
    assert "held out" not in out


def test_a_model_that_makes_a_run_worse_has_a_remark(trained: rlg.Compensator, short_runs: list[rlg.Recording]) -> None:
    run = short_runs[2]
    turned = run.replace(table=run.table.assign(gyro_deg_h=-run.rate_deg_h()), name="turned")
    (result,) = (evaluation := rlg.evaluate(trained, [turned], compare=False)).runs
    assert result.factor_high < 1.0
    (remark,) = (remark for remark in evaluation.remarks if remark.code in ("evaluation.worse", "evaluation.no_gain"))
    assert remark.code == "evaluation.worse"
    factors = {"times": 1.0 / result.factor, "factor_low": result.factor_low, "factor_high": result.factor_high}
    assert remark.data == {"run": "turned", **factors}


def test_a_run_of_which_many_windows_are_left_out_has_a_remark(trained: rlg.Compensator, short_runs: list[rlg.Recording]) -> None:
    run = short_runs[2]
    there = np.random.default_rng(0).random(len(run)) > 0.25
    there[: int(run.scored.argmax()) + 200] = there[-200:] = True
    whole, broken = rlg.evaluate(trained, [run, run.replace(table=run.table[there], truth=None, name="broken")], compare=False).runs
    assert "evaluation.windows_left_out" not in [remark.code for remark in whole.remarks]
    assert whole.windows_left_out == 0
    (remark,) = [remark for remark in broken.remarks if remark.code == "evaluation.windows_left_out"]
    assert remark.data["used"] == broken.windows < whole.windows
    assert (remark.data["left_out"], remark.data["windows"]) == (broken.windows_left_out, broken.windows + broken.windows_left_out)
    assert remark.data["windows"] == pytest.approx(whole.windows, abs=1)


def test_a_run_of_another_unit_than_the_only_one_trained_on_has_a_remark(
    trained: rlg.Compensator, short_runs: list[rlg.Recording], monkeypatch: pytest.MonkeyPatch
) -> None:
    run = short_runs[2]

    def remarked(unit: str | None, *trained_on: str | None) -> bool:
        monkeypatch.setattr(trained, "provenance_", [{"unit": one} for one in trained_on])
        other = run.replace(metadata=dataclasses.replace(run.metadata, unit=unit))
        remarks = rlg.evaluate(trained, [other], compare=False).remarks
        data = [remark.data for remark in remarks if remark.code == "compensation.other_unit"]
        assert data in ([], [{"run": run.name, "unit": unit, "trained_unit": "SN1"}])
        return bool(data)

    assert remarked("SN2", "SN1", "SN1")
    assert not remarked("sn1", "SN1")
    assert not remarked("SN2", "SN1", "SN3")
    assert not remarked("SN2", "SN1", None)
    assert not remarked(None, "SN1")


def test_nothing_to_evaluate_is_refused(trained: rlg.Compensator) -> None:
    with pytest.raises(rlg.InputError, match="no runs to evaluate"):
        rlg.evaluate(trained, [])
