"""Intervals of the bias: what they hold, on runs that were held out and beyond the training range."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from sklearn.neighbors import KNeighborsRegressor

import rlgcomp as rlg
from experiments.coverage.__main__ import main, programme
from rlgcomp.compensation.interval import Interval, excess, noise_of_windows_deg_h, quantile
from rlgcomp.compensation.window_means import window_means


def test_ninety_percent_of_windows_held_out_by_run_lie_within() -> None:
    """Ten units, programmes of their own for each run, four runs to train on: 87 to 93 % (measured in docs/results/coverage.md)."""
    shares = []
    for seed in range(10):
        unit, rng = rlg.simulated_unit(seed), np.random.default_rng(seed)
        runs = [unit.simulate(programme(rng), seed=k, step_s=20.0, name=f"{k}") for k in range(6)]
        compensator = rlg.Compensator(rlg.CubicLeastSquares(linear="dynamics")).fit(runs[:4])
        for run in runs[4:]:
            windows = window_means(run, compensator.pipeline_, 100.0)
            error = np.abs(windows.y_deg_h - compensator.predict_rows(windows.X))
            shares.append(np.mean(error <= compensator.half_widths(windows.X)))
    assert 0.87 < np.mean(shares) < 0.93


@pytest.mark.parametrize("spread", [0.0, 0.3])
def test_runs_that_differ_are_covered_on_average(spread: float) -> None:
    """Errors drawn run by run with a scale of their own: what is calibrated on six runs holds 90 % of a seventh's, on average."""
    rng = np.random.default_rng(4)
    covered = []
    for _ in range(300):
        errors = rng.standard_normal((7, 60)) * np.exp(spread * rng.standard_normal((7, 1)))
        X = rng.uniform(size=(360, 1))
        interval = Interval.calibrated(errors[:6].ravel(), X, errors[:6].ravel(), np.repeat(np.arange(6), 60), runs=6)
        covered.append(np.mean(np.abs(errors[6]) <= interval.inside_deg_h))
    assert np.mean(covered) == pytest.approx(0.9, abs=0.03)


@pytest.mark.parametrize("runs", [2, 4])
@pytest.mark.parametrize("between", [0.0, 5.0])
def test_gyros_of_the_same_runs_show_together_how_runs_differ(runs: int, between: float) -> None:
    """Three gyros whose biases differ from run to run in proportion to their scatter: 90 % of another run, in less width."""
    rng = np.random.default_rng(runs)
    covered, narrower = [], []
    groups = np.repeat(np.arange(runs), 60)
    X = rng.uniform(size=(60 * runs, 1))
    for _ in range(300):
        biases = between * rng.standard_normal((3, runs + 1))
        left_out = biases[:, :runs] - (biases[:, :runs].sum(axis=1, keepdims=True) - biases[:, :runs]) / (runs - 1)
        noise = rng.standard_normal((3, 60 * runs))
        errors = np.array([[0.01], [1.0], [100.0]]) * (noise + left_out[:, groups])
        arguments = errors[0], X, errors[0], groups
        interval = Interval.calibrated(*arguments, runs=runs, other_gyros=errors[1:])
        new = 0.01 * (rng.standard_normal(60) + biases[0, -1] - biases[0, :runs].mean())
        covered.append(np.mean(np.abs(new) <= interval.inside_deg_h))
        if between > 0.0:
            narrower.append(interval.inside_deg_h / Interval.calibrated(*arguments, runs=runs).inside_deg_h)
    assert interval.gyros == 3
    assert 0.86 < np.mean(covered) < 0.96
    assert between == 0.0 or np.median(narrower) < 1.0


def test_a_gyro_that_does_not_vary_shows_nothing() -> None:
    rng = np.random.default_rng(0)
    X, errors, groups = rng.uniform(size=(120, 1)), rng.standard_normal(120), np.repeat([0, 1], 60)
    alone = Interval.calibrated(errors, X, errors, groups, runs=2)
    assert Interval.calibrated(errors, X, errors, groups, runs=2, other_gyros=np.zeros((1, 120))) == alone
    assert alone.gyros == 1


def test_the_other_gyros_of_a_recording_narrow_its_interval() -> None:
    """Two runs of three gyros: the interval says of how many gyros it is, on the card as well, and survives being saved."""
    rng = np.random.default_rng(1)
    runs = []
    for k in range(2):
        run = rlg.simulated_unit(1).simulate("short", seed=k, step_s=20.0, name=f"run{k}")
        for axis in "yz":
            run = run.with_column(f"gyro_{axis}_deg_h", run.column("gyro_deg_h") + 0.002 * rng.standard_normal(len(run)))
        runs.append(run)
    model = rlg.CubicLeastSquares()
    three = rlg.Compensator(model, features="temperature", gyro="gyro_deg_h").fit(runs)
    alone = rlg.Compensator(model, features="temperature").fit(
        [run.replace(table=run.table.drop(columns=["gyro_y_deg_h", "gyro_z_deg_h"])) for run in runs]
    )
    assert (three.interval_.gyros, alone.interval_.gyros) == (3, 1)
    assert three.interval_.inside_deg_h != alone.interval_.inside_deg_h
    assert three.offset_interval(600.0) == alone.offset_interval(600.0)


def test_the_quantile_counts_runs_not_windows() -> None:
    long, short = np.zeros(900), np.ones(100)
    assert quantile([long, short], 0.5) == 0.0
    assert quantile([long, short], 0.51) == 1.0
    assert quantile([np.arange(10.0)], 0.9) == 8.0


def test_windows_beyond_the_range_of_the_others_do_not_tell_of_what_is_within() -> None:
    """One run reaches further, with errors tenfold there: the half width within stays what it is without that part."""
    rng = np.random.default_rng(0)
    X = np.r_[np.linspace(0, 1, 50), np.linspace(0, 1, 50), np.linspace(0, 2, 100)][:, None]
    errors = 0.01 * rng.standard_normal(200)
    groups = np.repeat([0, 1, 2], [50, 50, 100])
    plain = Interval.calibrated(errors, X, X[:, 0], groups, runs=3)
    errors[155:] *= 10.0
    assert Interval.calibrated(errors, X, X[:, 0], groups, runs=3) == plain
    assert plain.per_span_deg_h == 2.0


@settings(max_examples=100, deadline=None)
@given(st.lists(st.floats(-1e6, 1e6), min_size=2, max_size=2), st.floats(0.0, 1e3))
def test_it_widens_with_every_step_outside_and_not_within(x: list[float], further: float) -> None:
    low, high = np.array([-1.0, 3.0]), np.array([2.0, 3.0])  # the second input stood still in training
    interval = Interval(0.002, 0.05, 0.9, 4)
    here = interval.half_width_deg_h(excess(np.array([x]), low, high))[0]
    outward = np.array(x) + further * np.where(np.array(x) > high, 1.0, np.where(np.array(x) < low, -1.0, 0.0))
    there = interval.half_width_deg_h(excess(outward[None], low, high))[0]
    assert there >= here >= 0.002
    assert (here == 0.002) == bool((low <= x).all() and (x <= high).all())


def test_it_is_in_what_a_compensator_says(trained: rlg.Compensator, short_runs: list[rlg.Recording]) -> None:
    run = short_runs[2]
    wild = run.table
    wild.loc[500:, "temperature_block_degC"] += 200.0
    predicted = trained.predict(run.replace(table=wild))["half_width_deg_h"].to_numpy()
    assert (predicted[~trained.predict(run)["out_of_range"]][:400] == trained.interval_.inside_deg_h).all()
    assert (predicted[500:] > trained.interval_.inside_deg_h + trained.interval_.per_span_deg_h).all()
    assert (trained.correct(run.replace(table=wild)).column("compensation_half_width_deg_h") == predicted).all()
    assert 0.8 < rlg.evaluate(trained, [run], compare=False).runs[0].in_interval <= 1.0


def test_a_model_of_the_users_own_has_one_too(short_runs: list[rlg.Recording]) -> None:
    model = rlg.Compensator(KNeighborsRegressor(), features="temperature").fit(short_runs[:2])
    assert model.interval_.inside_deg_h > 0.0


@pytest.mark.parametrize(
    ("runs", "promise"), [(1, "no share is promised"), (2, "promise no share for the next"), (12, "holds on average")]
)
def test_the_card_promises_no_more_than_the_runs_allow(
    trained: rlg.Compensator, tmp_path: object, runs: int, promise: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(trained, "interval_", Interval(0.002, 0.05, 0.9, runs))
    trained.save(tmp_path / "model")
    assert promise in " ".join((tmp_path / "model" / "card.md").read_text().split())
    assert rlg.load(tmp_path / "model").interval_ == trained.interval_


@pytest.mark.parametrize(
    "change",
    [{"runs": 0}, {"runs": True}, {"coverage": 1.0}, {"inside_deg_h": -1.0}, {"inside_deg_h": "1"}, {"per_span_deg_h": None}],
)
def test_a_wrong_interval_is_refused(change: dict[str, object]) -> None:
    good = Interval(0.002, 0.05, 0.9, 3).to_mapping()
    assert Interval.from_mapping(good).to_mapping() == good
    with pytest.raises(rlg.InputError, match="interval"):
        Interval.from_mapping(good | change)


def test_the_experiment_prints_its_table(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    main(["--quick", "--jobs", "1", "--rows", str(tmp_path / "rows")])
    output = capsys.readouterr().out
    assert "windows beyond it" in output
    assert output.count("| dynamic | play |") == 2


def _ramp(low: float, high: float, seed: int) -> rlg.Recording:
    """A warm-up from one temperature to another, of a gyro with a slope of 1 deg/h/K and noise of 1 deg/h."""
    rng = np.random.default_rng(seed)
    temperature = np.linspace(low, high, 3000)
    table = {
        "time_s": np.arange(3000) * 2.0,
        "gyro_deg_h": temperature + rng.standard_normal(3000),
        "temperature_block_degC": temperature,
    }
    return rlg.Recording(pd.DataFrame(table), name=f"{low:g} to {high:g}")


def test_runs_that_do_not_overlap_give_their_error_from_each_other_and_a_remark() -> None:
    model = rlg.Compensator(features="temperature").fit([_ramp(-40.0, 0.0, 1), _ramp(20.0, 60.0, 2)])
    *_, groups = model.training_rows()
    errors = np.abs(model.model_.leave_groups_out(groups)) * model.scaling_.y_scale_deg_h
    assert model.interval_.basis == "spread"
    assert model.interval_.inside_deg_h >= np.quantile(errors, 0.9) > 0.0
    (remark,) = [remark for remark in model.remarks_ if remark.code == "compensation.no_overlap"]
    assert remark.data == {"half_width_deg_h": model.interval_.inside_deg_h}


def test_it_is_never_less_than_the_noise_of_the_means() -> None:
    rng = np.random.default_rng(0)
    y = rng.standard_normal(200)
    interval = Interval.calibrated(0.01 * y, np.zeros((200, 1)), y, np.arange(200) // 100, runs=2, noise_deg_h=1.0)
    assert interval.inside_deg_h == pytest.approx(1.645, rel=1e-3)
    assert noise_of_windows_deg_h([np.linspace(0.0, 30.0, 200) + y]) == pytest.approx(1.0, rel=0.15)


def test_errors_of_zero_without_noise_make_it_unknown_and_not_zero() -> None:
    y = np.linspace(0.0, 3.0, 40)
    interval = Interval.calibrated(np.zeros(40), np.tile(y[:20], 2)[:, None], y, np.arange(40) // 20, runs=2)
    assert (interval.basis, interval.inside_deg_h) == ("unknown", 3.0)
    constant = Interval.calibrated(np.zeros(40), np.zeros((40, 1)), np.full(40, 2.0), np.arange(40) // 20, runs=2)
    assert constant.basis == "unknown"
    assert constant.inside_deg_h > 0.0


@pytest.mark.parametrize("runs", [2, 4, 6])
def test_runs_with_biases_of_their_own_are_covered_on_average(runs: int) -> None:
    """Each run left out is compared with the mean of the others, and a new run with the mean of all."""
    rng = np.random.default_rng(5)
    covered = []
    for _ in range(400):
        bias, noise = 5.0 * rng.standard_normal(runs + 1), rng.standard_normal((runs + 1, 40))
        left_out = [(bias[k] - np.delete(bias[:runs], k).mean()) + noise[k] for k in range(runs)]
        errors, X = np.concatenate(left_out), rng.uniform(size=(40 * runs, 1))
        interval = Interval.calibrated(errors, X, errors, np.repeat(np.arange(runs), 40), runs=runs)
        covered.append(np.mean(np.abs(bias[runs] - bias[:runs].mean() + noise[runs]) <= interval.inside_deg_h))
    assert 0.87 < np.mean(covered) < 0.94


def test_a_stated_repeatability_covers_runs_after_a_single_one() -> None:
    """Runs with biases of their own, drawn many times: the interval of one run holds them only where it was stated."""
    rng = np.random.default_rng(7)
    covered: dict[float, list[float]] = {0.0: [], 0.5: []}
    groups = np.repeat(np.arange(5), 40)
    for _ in range(300):
        new = 0.5 * (rng.standard_normal() - rng.standard_normal())  # of a new run, less that of the only run of training
        errors, later = 0.1 * rng.standard_normal(200), 0.1 * rng.standard_normal(200)
        for stated, shares in covered.items():
            interval = Interval.calibrated(
                errors, np.linspace(0.0, 1.0, 200)[:, None], errors, groups, runs=1, blocks=True, turn_on_deg_h=stated
            )
            shares.append(float(np.mean(np.abs(new + later) <= interval.inside_deg_h)))
    assert np.mean(covered[0.0]) < 0.35
    assert 0.88 < np.mean(covered[0.5]) < 0.96


def test_a_stated_repeatability_counts_less_the_more_runs_there_are() -> None:
    rng = np.random.default_rng(8)
    widths = {}
    for runs in (2, 40):
        groups = np.repeat(np.arange(runs), 50)
        errors = 0.2 * rng.standard_normal(runs)[groups] + 0.02 * rng.standard_normal(len(groups))
        for stated in (0.0, 0.05):
            X = np.tile(np.linspace(0.0, 1.0, 50), runs)[:, None]
            interval = Interval.calibrated(errors, X, errors, groups, runs=runs, turn_on_deg_h=stated)
            assert Interval.from_mapping(interval.to_mapping()) == interval
            widths[runs, stated] = interval.inside_deg_h
    assert widths[2, 0.05] < 0.6 * widths[2, 0.0]
    assert widths[40, 0.05] > 0.85 * widths[40, 0.0]


def test_one_run_assumes_a_repeatability(short_runs: list[rlg.Recording], tmp_path: Path) -> None:
    models = {
        stated: rlg.Compensator(rlg.CubicLeastSquares(), features="temperature", turn_on_deg_h=stated).fit(short_runs[:1])
        for stated in (None, 0.0, 0.3)
    }
    assumed, same_run, stated = (model.interval_ for model in models.values())
    assert [interval.basis for interval in (assumed, same_run, stated)] == ["assumed", "blocks", "blocks"]
    assert assumed.turn_on_deg_h == pytest.approx(np.std(models[None].training_[0].y_deg_h))
    assert same_run.turn_on_deg_h == 0.0
    assert assumed.inside_deg_h > same_run.inside_deg_h
    (remark,) = [one for one in models[None].remarks_ if one.code == "compensation.turn_on_assumed"]
    assert remark.data["turn_on_deg_h"] == assumed.turn_on_deg_h
    models[None].save(tmp_path / "model")
    assert rlg.load(tmp_path / "model").interval_ == assumed
    assert models[None].offset_interval(600.0) == models[0.0].offset_interval(600.0)


@pytest.mark.parametrize("stated", [-1.0, np.nan, "0.01", True])
def test_a_repeatability_that_is_no_number_is_refused(stated: object, short_runs: list[rlg.Recording]) -> None:
    with pytest.raises(rlg.InputError, match="turn_on_deg_h"):
        rlg.Compensator(rlg.CubicLeastSquares(), turn_on_deg_h=stated).fit(short_runs[:1])  # type: ignore[arg-type]


def test_nearly_as_many_errors_far_off_as_may_be_outside() -> None:
    """The rest must be held almost wholly, so the half width lies far out in the tail of the runs' own means."""
    errors, far = 1e-3 * np.random.default_rng(9).standard_normal(2000), np.arange(198)
    errors[10 * far + far // 2 % 2] = 1e9 * np.where(far % 2, 1.0, -1.0)
    X, groups = np.linspace(0.0, 1.0, 2000)[:, None], np.arange(2000) % 2
    interval = Interval.calibrated(errors, X, errors, groups, runs=2, turn_on_deg_h=0.01)
    assert np.mean(np.abs(errors) <= interval.inside_deg_h) == 1.0 - 198 / 2000
    assert 0.02 < interval.inside_deg_h < 1.0
