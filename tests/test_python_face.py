"""The names that a notebook user guesses, and the shapes in which they are called."""

from __future__ import annotations

import dataclasses
import pickle
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from sklearn.base import clone

import rlgcomp as rlg
from rlgcomp.simulation.two_axis_table import reversing
from tests.few_monitors import few_monitors
from tests.two_hour_runs import BASELINE, REAL, runs_of


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three short runs of one gyro as files."""
    folder = tmp_path_factory.mktemp("face")
    gyro = rlg.simulated_unit(1)
    for seed, name in enumerate(("cold", "hot", "new"), start=1):
        rlg.write(gyro.simulate("short", seed=seed, step_s=10.0), folder / f"{name}.parquet")
    return folder


@pytest.fixture(scope="module")
def runs(folder: Path) -> list[rlg.Recording]:
    return [rlg.read(folder / "cold.parquet"), rlg.read(folder / "hot.parquet")]


@pytest.fixture(scope="module")
def fitted(runs: list[rlg.Recording]) -> rlg.Compensator:
    return rlg.Compensator(rlg.CubicLeastSquares(), features="temperature").fit(runs)


@pytest.fixture(scope="module")
def static() -> rlg.Recording:
    """Two gyros at rest, the first 200 s a lead-in in which they are far off."""
    time = 0.5 * np.arange(8000)
    noise = np.random.default_rng(1).normal(size=(2, len(time)))
    x, y = 10.0 + noise + np.where(time < 200.0, 1e3, 0.0)
    table = pd.DataFrame({"time_s": time, "gyro_x_deg_h": x, "gyro_y_deg_s": 2.0 * y / 3600.0})
    return rlg.Recording(table, rlg.Metadata(kind="static", lead_in_s=200.0))


def test_train_correct_save_and_load(folder: Path, runs: list[rlg.Recording], tmp_path: Path) -> None:
    model = rlg.Compensator(rlg.LSSVMRegressor(), features="all").fit(runs)
    new = rlg.read(folder / "new.parquet")
    clean = model.correct(new)
    assert isinstance(clean, rlg.Recording)
    sample = {name: float(new.column(name)[0]) for name in new.columns}
    assert model.step(sample).bias_deg_h == model.predict(new)["bias_deg_h"].iloc[0]
    model.save(tmp_path / "unit-17")
    pd.testing.assert_frame_equal(rlg.load(tmp_path / "unit-17").correct(new).table, clean.table)
    assert rlg.evaluate(model, [new], compare=False).residual_std_deg_h < np.std(new.column("gyro_deg_h"))


@pytest.mark.parametrize("regressor", ["CubicLeastSquares", "KernelBaselines"])
def test_other_regressors_are_made_without_arguments(regressor: str) -> None:
    assert hasattr(getattr(rlg, regressor)(), "fit")


def test_results_print_as_a_few_lines(runs: list[rlg.Recording], folder: Path, tmp_path: Path) -> None:
    model = rlg.Compensator(rlg.CubicLeastSquares(), features="temperature")
    assert str(model).startswith("Compensator, not fitted: CubicLeastSquares")
    model.fit(runs)
    model.save(tmp_path / "model")
    evaluation = rlg.evaluate(model, [rlg.read(folder / "new.parquet"), runs[0]])
    deviation = rlg.allan_deviation(runs[0])
    for shown, lines, words in (
        (model, 5, ("cubic on 1 input, 100 s means", "trained on: cold, hot", "with runs left out")),
        (rlg.load(tmp_path / "model"), 5, ("cubic on 1 input", "trained on: cold, hot")),
        (evaluation, 12, ("new", "noise floor", "together", "cold was used for training")),
        (deviation, 15, ("tau_s", "1260 samples every 10 s", "12 of 22 averaging times")),
        (deviation.noise(), 6, ("N  angle random walk  (3.10 ± 0.17)·10⁻⁴ deg", "deg/√h", "R  rate ramp")),
        (rlg.analyse_noise(runs[0]), 12, ("gyro_deg_h: mean", "temperature_block_degC changes")),
        (rlg.simulated_unit(1), 12, ("6 mechanisms", "temperature_rate: k_deg_h_min_K = -0.01", "noise: angle_random_walk")),
        (rlg.Simulator.from_mapping({"mechanisms": ["supply_voltage"]}), 3, ("(free)", "noise: to be estimated")),
    ):
        for word in words:
            assert word in str(shown)
        assert str(shown) == repr(shown)
        assert len(str(shown).splitlines()) <= lines
        assert max(map(len, str(shown).splitlines())) <= 200
    assert "R  rate ramp          not observable" in str(rlg.allan_deviation(runs[0], estimator="hadamard").noise())


def test_a_compensator_is_an_estimator(runs: list[rlg.Recording]) -> None:
    """Its settings are as they were given, before and after a fit, and a clone is unfitted and fits alike."""
    bare = rlg.Compensator()
    assert bare.get_params(deep=False) == {
        "model": None, "features": "all", "averaging_s": 100.0, "gyro": None, "keep_mean": False, "n_jobs": 1,
        "physics": None, "turn_on_deg_h": None,
    }  # fmt: skip
    assert str(bare).startswith("Compensator, not fitted: LSSVMRegressor, features all")
    features = ["temperature", "temperature_rate"]
    cubic = rlg.CubicLeastSquares(degree=2)
    model = rlg.Compensator(cubic, features=features, averaging_s=200.0).fit(runs)
    assert model.model is cubic
    assert not hasattr(cubic, "coef_")
    assert model.features is features
    assert model.get_params()["model__degree"] == 2
    again = clone(model)
    assert not hasattr(again, "model_")
    assert again.get_params(deep=False) | {"model": None} == model.get_params(deep=False) | {"model": None}
    new = runs[0]
    assert (again.fit(run for run in runs).predict(new) == model.predict(new)).all(axis=None)  # any iterable will do
    coarser = clone(model).set_params(model__degree=1, averaging_s=100.0).fit(runs)
    assert coarser.model_.degree == 1
    assert (pickle.loads(pickle.dumps(model)).predict(new) == model.predict(new)).all(axis=None)  # noqa: S301


GYRO = rlg.simulated_unit(1)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda runs, model: rlg.Compensator().fit(runs[0]), r"runs is one recording, cold; .* give \[runs\]"),
        (lambda runs, model: rlg.Compensator().fit(["cold.parquet"]), r"runs\[0\] is 'cold.parquet', which is no Recording"),
        (lambda runs, model: rlg.Compensator().fit(None), "runs is None"),
        (lambda runs, model: rlg.Compensator(features=None).fit(runs), "features is None"),
        (lambda runs, model: rlg.Compensator("lssvm").fit(runs), "model is 'lssvm'; it must be a regressor that was made"),
        (lambda runs, model: rlg.Compensator(rlg.CubicLeastSquares).fit(runs), "a regressor that was made"),
        (lambda runs, model: rlg.Compensator(n_jobs=0).fit(runs), "n_jobs is 0"),
        (lambda runs, model: rlg.Compensator(n_jobs=1.5).fit(runs), "n_jobs is 1.5; it must be a whole number"),
        (lambda runs, model: rlg.evaluate(rlg.Compensator(), runs), "not fitted yet"),
        (lambda runs, model: rlg.evaluate(model, runs[0]), "runs is one recording"),
        (lambda runs, model: rlg.evaluate(model, runs, n_jobs=0), "n_jobs is 0"),
        (lambda runs, model: rlg.adapt(model, runs[0]), "runs is one recording"),
        (lambda runs, model: rlg.diagnose(GYRO, train=runs[0]), r"train is one recording, cold; .* give \[train\]"),
        (lambda runs, model: rlg.diagnose(GYRO, train=runs, test=runs[0]), "test is one recording"),
        (lambda runs, model: rlg.diagnose(GYRO, train=[runs[0].table[["time_s"]]]), r"train\[0\] cannot be used"),
        (lambda runs, model: rlg.diagnose(GYRO, train=runs, seed=-1), "seed is -1; it must be a whole number, 0 or more"),
        (lambda runs, model: GYRO.simulate("short", seed=-1), "seed is -1"),
        (lambda runs, model: GYRO.simulate("short", seed=1.5), "seed is 1.5"),
        (lambda runs, model: rlg.calibrate_scale_factor(runs[0]), "recordings is one recording"),
        (lambda runs, model: rlg.calibrate_turntable(runs[0]), "recordings is one recording"),
        (lambda runs, model: rlg.allan_deviation(runs[0], per_decade=0.0), "per_decade is 0.0; it must be a positive number"),
        (lambda runs, model: rlg.allan_deviation(runs[0], per_decade=-1.0), "per_decade is -1.0"),
        (lambda runs, model: rlg.allan_deviation(runs[0], per_decade=float("nan")), "per_decade is nan"),
    ],
)
def test_what_cannot_be_used_is_refused_at_the_entry(
    call: Callable[..., object], message: str, runs: list[rlg.Recording], fitted: rlg.Compensator
) -> None:
    with pytest.raises(rlg.InputError, match=message):
        call(runs, fitted)


def test_results_are_tables_in_a_notebook(runs: list[rlg.Recording], fitted: rlg.Compensator) -> None:
    deviation = rlg.allan_deviation(runs[0])
    evaluation = rlg.evaluate(fitted, runs, compare=False)
    for shown, words in (
        (deviation, ("<p>Allan deviation (overlapping): 1260 samples", "<th>deviation_deg_h</th>")),
        (deviation.noise(), ("<p>Noise from 10 to ", "<td>angle random walk</td>", "deg/√h")),
        (evaluation, ("<p>Bias stability", "<th>noise floor</th>", "<td>cold</td>", "<li>cold was used for training")),
    ):
        page = shown._repr_html_()  # the name that notebooks call
        for word in words:
            assert word in page
        assert page.count("<table") == 1


def test_diagnose_and_simulate_better(tmp_path: Path) -> None:
    BASELINE.to_yaml(tmp_path / "gyro.yaml")
    simulator = rlg.Simulator.from_yaml(tmp_path / "gyro.yaml")
    *runs, held_out = runs_of(REAL)
    few = {name: rlg.CATALOGUE[name] for name in ("supply_voltage", "thermal_lag")}
    diagnosis = rlg.diagnose(simulator, train=runs, test=[held_out], mechanisms=few, window_s=320.0, black_box=False)
    assert "supply_voltage" in str(diagnosis)
    assert "supply_voltage" in str(diagnosis.findings)
    page = diagnosis._repr_html_()
    assert page.startswith("<p>The simulator lacks supply_voltage")
    assert "<td>supply_voltage</td>" in page
    better = diagnosis.augmented
    assert isinstance(better.simulate("short", seed=2, step_s=10.0), rlg.Recording)
    assert len(better.predict(held_out)) == len(held_out)
    diagnosis.report(tmp_path / "report.html")
    assert (tmp_path / "report.html").stat().st_size > 0
    assert issubclass(rlg.CATALOGUE["supply_voltage"], rlg.Mechanism)


def test_the_allan_deviation_of_a_recording(static: rlg.Recording) -> None:
    scored = static.scored
    for gyro, size in (("gyro_x_deg_h", 1.0), ("gyro_y_deg_s", 2.0)):
        dev = rlg.allan_deviation(static, gyro=gyro)
        of_arrays = rlg.allan_deviation(static.rate_deg_h(gyro)[scored], static.time_s[scored])
        assert (dev.deviation_deg_h == of_arrays.deviation_deg_h).all()
        assert list(dev.to_frame().columns) == [
            "tau_s", "deviation_deg_h", "lower_deg_h", "upper_deg_h", "differences", "edf", "noise",
        ]  # fmt: skip
        noise = dev.noise()
        assert isinstance(noise, rlg.NoiseCoefficients)
        expected = size * np.sqrt(0.5 / 3600.0)
        assert noise.angle_random_walk_deg_sqrt_h == pytest.approx(expected, rel=0.05)
        assert 0.0 < noise.angle_random_walk_deg_sqrt_h_sd < 0.05 * expected
    alone = static.replace(table=static.table.drop(columns="gyro_y_deg_s"))
    assert rlg.allan_deviation(alone, tau_s=[1.0, 10.0]).tau_s.tolist() == [1.0, 10.0]


def test_what_does_not_fit_together_is_refused(static: rlg.Recording) -> None:
    rate, time = static.column("gyro_x_deg_h"), static.time_s
    with pytest.raises(rlg.InputError, match="none was chosen"):
        rlg.allan_deviation(static)
    with pytest.raises(rlg.InputError, match="averaging times as tau_s="):
        rlg.allan_deviation(static, [1.0, 10.0], gyro="gyro_x_deg_h")
    with pytest.raises(rlg.InputError, match="rates without their times; give a Recording"):
        rlg.allan_deviation(rate)
    with pytest.raises(rlg.InputError, match="gyro='gyro_x_deg_h' with an array"):
        rlg.allan_deviation(rate, time, gyro="gyro_x_deg_h")


def test_calibrate_turntable_takes_recordings() -> None:
    triad = dataclasses.replace(rlg.Triad(), gyro=rlg.TriadErrors({"scale_z_ppm": 50.0}))
    level = reversing(30.0, revolutions=2, repeats=2, outer_start_deg=90.0)
    found = rlg.calibrate_turntable([triad.simulate(level, seed=1, name="level")])
    scale = found.triad.to_frame().set_index("parameter").loc["scale_z_ppm"]
    assert scale["value"] == pytest.approx(50.0, abs=5.0 * scale["sd"])


def test_a_function_is_a_simulator(runs: list[rlg.Recording]) -> None:
    """What `--simulator my_sim.py:bias` takes, `diagnose` takes."""

    def bias(recording: rlg.Recording) -> np.ndarray:
        return np.zeros(len(recording))

    few = {name: rlg.CATALOGUE[name] for name in ("thermal_polynomial", "temperature_rate")}
    train, test = ([few_monitors(run)] for run in runs)
    diagnosis = rlg.diagnose(bias, train=train, test=test, mechanisms=few, window_s=600.0, black_box=False)
    assert diagnosis.verdict in ("none", "explained", "ambiguous", "unknown")

    def broken(recording: rlg.Recording) -> np.ndarray:
        raise KeyError("nothing")

    with pytest.raises(rlg.InputError, match="broken failed on"):
        rlg.diagnose(broken, train=runs[:1], test=runs[1:])
