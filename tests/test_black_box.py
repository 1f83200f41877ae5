"""The compensation beside the diagnosis: at its best, on the same split, and told where it beats the physics."""

from __future__ import annotations

import dataclasses
import html
from pathlib import Path

import numpy as np
import pytest

import rlgcomp as rlg
from rlgcomp.diagnosis.decide import Decision
from rlgcomp.diagnosis.diagnose import diagnose
from rlgcomp.diagnosis.report.result import Diagnosis
from rlgcomp.recording import Recording
from tests.two_hour_runs import BASELINE, REAL, runs_of

FEW = ("supply_voltage", "magnetic_field")


@pytest.fixture(scope="module")
def runs() -> list[Recording]:
    return runs_of(REAL)


@pytest.fixture(scope="module")
def found(runs: list[Recording]) -> Diagnosis:
    return diagnose(BASELINE, runs[:2], runs[2:], only=FEW)


def test_it_leaves_no_more_than_the_package_s_own_compensation(found: Diagnosis, runs: list[Recording]) -> None:
    """Fault 15: a straw man beside the physics."""
    assert found.test is not None
    own = rlg.Compensator(rlg.LSSVMRegressor(), averaging_s=found.train.averaging_s).fit(runs[:2])
    left = runs[2].rate_deg_h() - own.predict(runs[2])["bias_deg_h"].to_numpy()
    (run,) = found.test_runs
    of_package = np.sqrt(np.mean(run.window_means(run.on_bins_of_rows(left)) ** 2))
    assert found.test.compensation_rms < 1.05 * of_package
    assert found.train.compensation_rms is None
    content = found.to_mapping()
    assert content["fit"]["test"]["compensation_rms"] == content["fit"]["test"]["per_run"][0]["compensation_rms"]
    assert content["black_box"]["target"] in ("output", "residual")
    assert content["black_box"]["left_out_rms"]["value"] < found.train.baseline_rms


def test_one_run_has_one_noise_floor(found: Diagnosis) -> None:
    """Fault 16."""
    assert found.test is not None
    floors = {found.train.noise_floor_rms, found.test.noise_floor_rms}
    floors |= {one.noise_floor_rms for one in (*found.train.per_run, *found.test.per_run)}
    assert len(floors) == 1
    assert found.train.augmented_rms > 0.9 * floors.pop()


def test_where_it_beats_the_physics_the_report_tells_it(found: Diagnosis, tmp_path: Path) -> None:
    """Fault 5: a latent cause is named, and recorded columns have the mismatch."""
    wandering = dataclasses.replace(found, after=found.before, decision=Decision("unknown", (), wander=True))
    codes = {one.code: one.data for one in wandering.remarks}
    assert codes["diagnosis.compensation_better"]["compensation"] < wandering.test.augmented_rms
    assert codes["diagnosis.compensation_better"]["runs"] == "test"
    low, high = codes["diagnosis.compensation_better"]["less_ci95"]
    assert 0.0 < low < 1.0 - wandering.test.compensation_std / wandering.test.augmented_std < high < 1.0
    assert codes["diagnosis.learnt_from_columns"]["causes"] == ["wander"]
    assert codes["diagnosis.learnt_from_columns"]["share"] > 0.5
    wandering.report(tmp_path / "report.html")
    page = html.unescape((tmp_path / "report.html").read_text())
    assert next(one.text for one in wandering.remarks if one.code == "diagnosis.compensation_better") in page
    assert not {"diagnosis.compensation_better", "diagnosis.learnt_from_columns"} & {one.code for one in found.remarks}


def test_columns_hold_no_more_where_noise_alone_is_left(found: Diagnosis) -> None:
    wandering = dataclasses.replace(found, after=found.before, decision=Decision("unknown", (), wander=True))
    vars(wandering)["test"] = dataclasses.replace(wandering.test, noise_floor_rms=wandering.test.augmented_std)
    codes = {one.code for one in wandering.remarks}
    assert "diagnosis.learnt_from_columns" in codes
    assert "diagnosis.compensation_better" not in codes


def test_a_better_mean_of_a_run_is_no_law_of_recorded_columns(found: Diagnosis) -> None:
    """A gyro that drifts has another mean in each run, which an LS-SVM meets by chance."""
    wandering = dataclasses.replace(found, after=found.before, decision=Decision("unknown", (), wander=True))
    assert wandering.test is not None
    assert wandering.test.over_compensation_ci95[1] < -0.02
    vars(wandering)["test"] = dataclasses.replace(wandering.test, over_compensation_std_ci95=(-0.1, 0.1))
    codes = {one.code for one in wandering.remarks}
    assert not {"diagnosis.compensation_better", "diagnosis.learnt_from_columns"} & codes
    assert wandering.learnt is None


def test_findings_that_make_test_runs_worse_are_told_first(found: Diagnosis) -> None:
    """An LS-SVM that had learnt nothing was better than a law that did harm: "recorded columns hold more than is named"."""
    worse, before = dataclasses.replace(found), found.test
    assert before is not None
    rms, std = before.baseline_rms, before.baseline_std
    changed = {"augmented_rms": 1.31 * rms, "augmented_std": 1.31 * std, "improvement": -0.31, "improvement_ci95": (-0.5, -0.16)}
    nothing = {"compensation_rms": 0.999 * rms, "compensation_std": 0.999 * std}
    over = {"over_compensation_ci95": (-0.5, -0.16), "over_compensation_std_ci95": (-0.5, -0.16)}
    vars(worse)["test"] = dataclasses.replace(before, **changed, **nothing, **over)
    first, *others = worse.remarks
    assert first.code == "diagnosis.findings_worse"
    assert first.data["mechanisms"] == ["supply_voltage"]
    assert "31 % more error" in first.text
    assert "LS-SVM learns nothing" in first.text
    assert "diagnosis.compensation_better" not in {one.code for one in others}
    learnt = dataclasses.replace(found)
    vars(learnt)["test"] = dataclasses.replace(before, **changed, **over)
    first, second, *_ = learnt.remarks
    assert "LS-SVM" not in first.text
    assert second.code == "diagnosis.compensation_better"
    assert "diagnosis.findings_worse" not in {one.code for one in found.remarks}


def test_it_can_be_left_out(found: Diagnosis) -> None:
    alone = dataclasses.replace(found, black_box=None)
    assert alone.to_mapping()["black_box"] is None
    assert alone.test.compensation_rms is None
    assert "LS-SVM" in str(found)
    assert "LS-SVM" not in str(alone)
