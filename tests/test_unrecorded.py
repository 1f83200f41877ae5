"""Something unrecorded that acts through a function that bends: told from a two-state process, and named as neither."""

from __future__ import annotations

import dataclasses
import itertools
import math

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from rlgcomp.diagnosis.data import Data, Grid, Run
from rlgcomp.diagnosis.diagnose import diagnose
from rlgcomp.diagnosis.search.telegraph import telegraph
from rlgcomp.diagnosis.search.unrecorded import PLACES, USUAL, moves_in_a_window, over_paths, unrecorded
from rlgcomp.noise.processes import NoiseModel
from rlgcomp.recording import Recording
from tests.two_hour_runs import BASELINE, runs_of

FEW = ("supply_voltage", "random_telegraph")


def wander(rng: np.random.Generator, count: int, windows: float) -> np.ndarray:
    """A Gauss-Markov process of unit variance, of a correlation time in windows."""
    keep, found = math.exp(-1.0 / windows), np.empty(count)
    found[0] = rng.standard_normal()
    for k in range(1, count):
        found[k] = keep * found[k - 1] + math.sqrt(1.0 - keep**2) * rng.standard_normal()
    return found


@pytest.fixture(scope="module")
def data() -> Data:
    runs = runs_of(dataclasses.replace(BASELINE, noise=NoiseModel(angle_random_walk_deg_sqrt_h=0.0005)))
    grid = Grid.of(runs)
    return Data(tuple(Run.of(run, grid, Recording.rate_deg_h) for run in runs))


def with_output(data: Data, output: np.ndarray) -> Data:
    runs = [dataclasses.replace(run, output=output[rows]) for run, rows in zip(data.runs, data.slices, strict=True)]
    return Data(tuple(runs))


def test_all_paths_are_summed() -> None:
    rng = np.random.default_rng(5)
    log_likelihood, usual = rng.normal(0.0, 2.0, (6, 3)), np.array([0.2, 0.5, 0.3])
    moves, begin = rng.dirichlet(np.ones(3), 3), np.array([True, False, False, True, False, False])
    total, shares = 0.0, np.zeros((6, 3))
    for path in itertools.product(range(3), repeat=6):
        p = math.prod(usual[j] if begin[k] else moves[path[k - 1], j] for k, j in enumerate(path))
        p *= math.exp(sum(log_likelihood[k, j] for k, j in enumerate(path)))
        total += p
        shares[range(6), path] += p
    found, posterior = over_paths(log_likelihood, moves, usual, begin)
    assert found == pytest.approx(math.log(total), abs=1e-12)
    np.testing.assert_allclose(posterior, shares / total, atol=1e-12)


@pytest.mark.parametrize(("windows", "size"), [(4.0, 3.0), (12.0, 1.0), (40.0, 3.0)])
def test_through_a_straight_law_it_is_a_gauss_markov_process(windows: float, size: float) -> None:
    rng = np.random.default_rng(6)
    output = size * wander(rng, 80, windows) + rng.standard_normal(80)
    begin = np.arange(80) == 0
    found, _ = over_paths(
        -0.5 * (output[:, None] - size * PLACES) ** 2 - 0.5 * math.log(2.0 * math.pi), moves_in_a_window(windows), USUAL, begin
    )
    apart = np.abs(np.subtract.outer(np.arange(80), np.arange(80)))
    exact = multivariate_normal.logpdf(output, cov=size**2 * np.exp(-apart / windows) + np.eye(80))
    assert found == pytest.approx(exact, abs=0.5)


def test_a_wander_that_is_bent_and_a_process_of_two_values_are_told_apart(data: Data) -> None:
    rng, n = np.random.default_rng(7), len(data)
    slope = np.concatenate([np.linspace(-1.0, 1.0, len(run.windows)) for run in data.runs])
    design, none = np.column_stack([np.ones(n), slope]), np.empty((n, 0))
    z = np.concatenate([wander(rng, len(run.windows), 0.1 * len(run.windows)) for run in data.runs])
    two_valued = 2.0 * np.where(np.cumsum(rng.random(n) < 0.04) % 2, 1.0, -1.0)
    for path, bent in ((2.0 * z**2, True), (np.maximum(np.abs(3.0 * z) - 3.0, 0.0), True), (two_valued, False)):
        some = with_output(data, path + 3.0 * slope + rng.standard_normal(n))
        courses = [np.convolve(some.output - 3.0 * slope, np.ones(5) / 5.0, "same")]
        two, through = (found(some, design, none, courses, data.white) for found in (telegraph, unrecorded))
        assert through is not None
        if bent:
            assert two is None or through.log_evidence > two.log_evidence + 10.0
            assert through.sigma == pytest.approx(1.0, abs=0.15)
            assert np.corrcoef(through.path, path)[0, 1] > 0.9
        else:
            assert two is not None
            assert two.log_evidence > through.log_evidence + 10.0


def test_the_unit_of_the_output_tells_nothing(data: Data) -> None:
    rng, n = np.random.default_rng(9), len(data)
    z = np.concatenate([wander(rng, len(run.windows), 0.1 * len(run.windows)) for run in data.runs])
    output, design = 2.0 * z**2 + rng.standard_normal(n), np.ones((n, 1))
    by_unit = {}
    for unit in (1.0, 1e5):
        some = with_output(data, unit * output)
        courses = [np.convolve(some.output, np.ones(5) / 5.0, "same")]
        by_unit[unit] = unrecorded(some, design, np.empty((n, 0)), courses, data.white)
    one, other = by_unit[1.0], by_unit[1e5]
    assert one is not None
    assert other is not None
    assert other.log_evidence == pytest.approx(one.log_evidence - (n - 1) * math.log(1e5), abs=1e-6)
    assert other.half_step == pytest.approx(1e5 * one.half_step)
    np.testing.assert_allclose(other.path, one.path, atol=1e-8)


def test_white_noise_is_nothing_unrecorded(data: Data) -> None:
    rng, n = np.random.default_rng(8), len(data)
    some = with_output(data, rng.standard_normal(n))
    found = unrecorded(some, np.ones((n, 1)), np.empty((n, 0)), [np.convolve(some.output, np.ones(15) / 15.0, "same")], data.white)
    null = -0.5 * (n - 1) * math.log(float(np.sum((some.output - some.output.mean()) ** 2))) - 0.5 * math.log(n)
    assert found is None or found.log_evidence < null


def test_the_square_of_something_unrecorded_is_no_random_telegraph() -> None:
    runs = []
    for k, run in enumerate(runs_of(dataclasses.replace(BASELINE, noise=NoiseModel(angle_random_walk_deg_sqrt_h=0.0005)))):
        z = wander(np.random.default_rng(50 + k), len(run), 0.15 * len(run))
        runs.append(Recording(run.table.assign(gyro_deg_h=run["gyro_deg_h"] + 0.02 * z**2), run.metadata))
    found = diagnose(BASELINE, runs, only=FEW, window_s=3.2 * Grid.of(runs).window_s, black_box=False)
    assert found.verdict == "unknown"
    assert found.messages[0].code == "diagnosis.wander"
    assert not found.to_mapping()["findings"]
