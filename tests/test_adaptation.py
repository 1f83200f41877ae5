"""Adapting to a new unit: the population is recovered, a short run improves the model, the interval holds."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import rlgcomp as rlg
from experiments.new_unit.__main__ import main
from rlgcomp.cli import register_commands
from rlgcomp.cli.base import app
from rlgcomp.compensation.adaptation import Population
from rlgcomp.compensation.models import MODELS


def units_of(
    rng: np.random.Generator, units: int, mean: np.ndarray, covariance: np.ndarray, noise: float
) -> tuple[list, list, np.ndarray]:
    coefficients = rng.multivariate_normal(mean, covariance, size=units)
    designs = [np.column_stack([np.ones(40), rng.standard_normal((40, len(mean) - 1))]) for _ in range(units)]
    targets = [phi @ beta + noise * rng.standard_normal(40) for phi, beta in zip(designs, coefficients, strict=True)]
    return designs, targets, coefficients


MEAN = np.array([1.0, -2.0, 0.0])
COVARIANCE = np.array([[1.0, 0.8, 0.0], [0.8, 1.0, 0.0], [0.0, 0.0, 1e-4]])


def test_the_population_is_recovered() -> None:
    designs, targets, coefficients = units_of(np.random.default_rng(1), 300, MEAN, COVARIANCE, 0.3)
    population = Population.of(designs, targets)
    assert population.mean == pytest.approx(MEAN, abs=4.0 / np.sqrt(300))
    assert population.covariance == pytest.approx(np.cov(coefficients.T), abs=0.03)
    assert population.noise == pytest.approx(0.3, rel=0.02)


def test_shrinkage_is_the_posterior_mean_of_a_gaussian_process() -> None:
    """Another way to the same number: conditioning the joint normal of coefficients and windows."""
    rng = np.random.default_rng(2)
    population = Population(MEAN, COVARIANCE, 0.3)
    phi, y = rng.standard_normal((7, 3)), rng.standard_normal(7)
    joint = phi @ COVARIANCE @ phi.T + 0.09 * np.eye(7)
    expected = MEAN + COVARIANCE @ phi.T @ np.linalg.solve(joint, y - phi @ MEAN)
    assert population.adapted(phi, y) == pytest.approx(expected, rel=1e-9)


def test_no_windows_give_the_mean_and_many_give_least_squares() -> None:
    rng = np.random.default_rng(3)
    population = Population(MEAN, COVARIANCE, 0.3)
    assert population.adapted(np.zeros((0, 3)), np.zeros(0)) == pytest.approx(MEAN)
    phi = rng.standard_normal((200_000, 3))
    y = phi @ np.array([3.0, 3.0, 0.05]) + 0.3 * rng.standard_normal(200_000)
    assert population.adapted(phi, y) == pytest.approx(np.linalg.lstsq(phi, y, rcond=None)[0], abs=1e-3)


def test_shrinkage_beats_both_the_mean_and_least_squares_on_few_windows() -> None:
    rng = np.random.default_rng(4)
    population = Population.of(*units_of(rng, 30, MEAN, COVARIANCE, 0.5)[:2])
    errors = {"shrunk": 0.0, "mean": 0.0, "least squares": 0.0}
    for _ in range(200):
        designs, targets, (truth,) = units_of(rng, 1, MEAN, COVARIANCE, 0.5)
        phi, y = designs[0][:4], targets[0][:4]
        errors["shrunk"] += float(np.sum((population.adapted(phi, y) - truth) ** 2))
        errors["mean"] += float(np.sum((population.mean - truth) ** 2))
        errors["least squares"] += float(np.sum((np.linalg.lstsq(phi, y, rcond=None)[0] - truth) ** 2))
    assert errors["shrunk"] < 0.5 * min(errors["mean"], errors["least squares"])


@pytest.fixture(scope="module")
def fleet() -> rlg.Compensator:
    runs = [
        rlg.simulated_unit(seed).simulate(programme, seed=10 * seed + k, step_s=20.0, name=f"{seed}-{programme}")
        for seed in range(100, 108)
        for k, programme in enumerate(("paper", "minor-loops"))
    ]
    return rlg.Compensator(MODELS["dynamic"].make()).fit(runs)


def test_two_hours_are_worth_more_after_a_fleet(fleet: rlg.Compensator) -> None:
    """Medians over six new units of what is left on another programme: less than half of what a fit from scratch leaves."""
    left, scratch, held = [], [], []
    for seed in range(6):
        unit = rlg.simulated_unit(seed)
        part = unit.simulate("minor-loops", seed=1, step_s=20.0).between(0.0, 7200.0)
        test = [unit.simulate("reversed", seed=2, step_s=20.0)]
        evaluation = rlg.evaluate(rlg.adapt(fleet, [part]), test, compare=False)
        left.append(evaluation.residual_rms_deg_h)
        held.append(evaluation.runs[0].in_interval)
        own = rlg.Compensator(MODELS["dynamic"].make()).fit([part])
        scratch.append(rlg.evaluate(own, test, compare=False).residual_rms_deg_h)
    assert np.median(left) < 0.5 * np.median(scratch)
    assert np.mean(held) > 0.87


def test_an_adapted_model_is_a_model_like_any_other(fleet: rlg.Compensator, tmp_path: Path) -> None:
    register_commands()
    run = rlg.simulated_unit(3).simulate("short", seed=1, step_s=20.0, name="short")
    fleet.save(tmp_path / "fleet")
    rlg.write(run, tmp_path / "short.parquet")
    command = ["train", tmp_path / "short.parquet", "--adapt", tmp_path / "fleet", "--out", tmp_path / "model", "--json"]
    result = CliRunner().invoke(app, [str(part) for part in command])
    assert result.exit_code == 0, result.output
    assert json.loads(result.stdout)["kind"] == "dynamic"
    model = rlg.load(tmp_path / "model")
    assert model.predict(run)["bias_deg_h"].to_numpy() == pytest.approx(
        rlg.adapt(fleet, [run]).predict(run)["bias_deg_h"].to_numpy(), abs=1e-12
    )
    model.restart()
    assert model.step(run.table.iloc[0].to_dict()).bias_deg_h == model.predict(run)["bias_deg_h"][0]
    card = " ".join((tmp_path / "model" / "card.md").read_text().split())
    assert "Adapted from what 8 other units have in common" in card
    assert "calibrated on 8 units" in card


def test_what_cannot_be_adapted_is_refused(
    fleet: rlg.Compensator, trained: rlg.Compensator, short_runs: list[rlg.Recording]
) -> None:
    with pytest.raises(rlg.InputError, match="train one with --model dynamic"):
        rlg.adapt(trained, short_runs)
    with pytest.raises(rlg.InputError, match="trained on 1 units that are named"):
        rlg.adapt(rlg.Compensator(rlg.CubicLeastSquares()).fit(short_runs[:2]), short_runs)
    with pytest.raises(rlg.InputError, match="no runs to adapt to"):
        rlg.adapt(fleet, [])
    two = [run.replace(metadata=dataclasses.replace(run.metadata, unit=unit)) for run, unit in zip(short_runs, "ab", strict=False)]
    with pytest.raises(rlg.InputError, match=r"of 2 units \(a, b\)"):
        rlg.adapt(fleet, two)


def test_a_unit_of_the_fleet_is_no_new_one(fleet: rlg.Compensator, short_runs: list[rlg.Recording]) -> None:
    for unit, told in ((fleet.provenance_[0]["unit"], True), ("another", False)):
        own = short_runs[0].replace(metadata=dataclasses.replace(short_runs[0].metadata, unit=unit))
        assert ("compensation.adapted_to_known" in [one.code for one in rlg.adapt(fleet, [own]).remarks_]) is told


def test_the_experiment_prints_its_tables(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    main(["--quick", "--jobs", "1", "--rows", str(tmp_path / "rows")])
    output = capsys.readouterr().out
    assert output.count("| adapted |") == 4
    assert "Noise floor" in output
