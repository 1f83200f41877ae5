"""Jumps to levels of their own, the rival of a two-state process."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Sequence

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from rlgcomp.diagnosis.data import Data, Grid, Run
from rlgcomp.diagnosis.noise.model import Noise
from rlgcomp.diagnosis.search.jumps import Divided, Parts, division, jumps
from rlgcomp.diagnosis.search.process import Process
from rlgcomp.diagnosis.search.states import State
from rlgcomp.diagnosis.search.telegraph import telegraph
from rlgcomp.simulation.simulator import Simulator


@pytest.fixture(scope="module")
def data() -> Data:
    """Windows of two runs."""
    gyro = Simulator.from_mapping({"kind": "chamber", "mechanisms": ["thermal_polynomial"]})
    runs = [gyro.simulate(f"start 20, ramp {20 + 10 * k} 1, hold 30", seed=k, step_s=10.0, name=f"run{k}") for k in range(2)]
    grid = Grid.of(runs)
    return Data(tuple(Run.of(run, grid, lambda binned: binned.column("gyro_deg_h")) for run in runs))


def with_output(data: Data, output: np.ndarray) -> Data:
    runs = [dataclasses.replace(run, output=output[rows]) for run, rows in zip(data.runs, data.slices, strict=True)]
    return Data(tuple(runs))


def courses(rng: np.random.Generator, data: Data, levels: Sequence[float] | None) -> np.ndarray:
    """Constant for some twenty windows, then at another of the levels, or at one drawn anew."""
    found = []
    for run in data.runs:
        path: list[float] = []
        while len(path) < len(run.windows):
            level = 4.0 * rng.standard_normal() if levels is None else levels[path[-1:] == [levels[0]]]
            path += [level] * int(rng.geometric(0.05))
        found += path[: len(run.windows)]
    return np.array(found)


@pytest.mark.parametrize("levels", [None, (-2.0, 2.0)])
def test_levels_of_their_own_and_two_levels_are_told_apart(data: Data, levels: tuple[float, float] | None) -> None:
    rng = np.random.default_rng(4)
    path = courses(rng, data, levels)
    slope = np.linspace(-1.0, 1.0, len(data))
    some = with_output(data, path + 3.0 * slope + rng.standard_normal(len(data)))
    design, none = np.column_stack([np.ones(len(data)), slope]), np.empty((len(data), 0))
    two = telegraph(some, design, none, [np.convolve(some.output, np.ones(5) / 5.0, "same")], data.white)
    assert two is not None
    many = jumps(some, design, none, two, data.white)
    assert many is not None
    if levels is None:
        assert many.log_evidence > two.log_evidence + 30.0
        assert many.sigma == pytest.approx(1.0, abs=0.1)
        assert np.corrcoef(many.half_step * many.path, path)[0, 1] > 0.95
    else:
        assert two.log_evidence > many.log_evidence + 5.0


def test_all_divisions_are_summed() -> None:
    rng = np.random.default_rng(2)
    left, precision, size, variance, rate = rng.normal(0.0, 2.0, 7), rng.uniform(0.5, 2.0, 7), 5.0, 1.3, 0.2
    found = Parts(np.zeros(7, np.intp), size, rate, left, left, variance, 0.0)
    values = {}
    for begins in itertools.product([False, True], repeat=6):
        parts = np.cumsum([0, *begins])
        covariance = variance * (np.diag(1.0 / precision) + size * np.equal.outer(parts, parts))
        prior = sum(begins) * np.log(rate) + (6 - sum(begins)) * np.log1p(-rate)
        values[tuple(np.flatnonzero([True, *begins]))] = multivariate_normal.logpdf(left, cov=covariance) + prior
    places, more = division(left, precision, found)
    likeliest = max(values, key=lambda one: values[one])
    assert tuple(places) == likeliest
    assert more == pytest.approx(np.logaddexp.reduce(list(values.values())) - values[likeliest])


def test_given_parts_have_the_gaussian_evidence(data: Data) -> None:
    rng = np.random.default_rng(3)
    n, size = len(data), 7.0
    some = with_output(data, rng.standard_normal(n))
    design, table = rng.standard_normal((n, 3)), rng.standard_normal((n, 2))
    white = rng.uniform(0.5, 2.0, n)
    begins = np.zeros(n, np.intp)
    begins[[20, 60, data.slices[1].start, n - 30]] = 1
    problem, parts = Divided.of(some, design, table, white), np.cumsum(begins)

    def dense(square_of_levels: float) -> float:
        covariance = np.diag(white) + square_of_levels * np.equal.outer(parts, parts) + table @ table.T
        inverse = np.linalg.inv(covariance)
        of_design = design.T @ inverse @ design
        left = some.output @ inverse @ some.output
        left -= some.output @ inverse @ design @ np.linalg.solve(of_design, design.T @ inverse @ some.output)
        log_dets = np.linalg.slogdet(covariance)[1] + np.linalg.slogdet(of_design)[1]
        return float(-0.5 * log_dets - 0.5 * (n - 3) * np.log(left))

    found = [problem.at(parts, one).log_evidence - dense(one) for one in (size, 0.1)]
    assert found[0] == pytest.approx(found[1], abs=1e-6)  # what is left is the prior of the parts


def test_what_jumps_between_levels_of_its_own_is_something_unrecorded(data: Data) -> None:
    path = np.where(np.arange(len(data)) % 40 < 30, 1.0, -1.0)
    two = Process(3.0, 1.0, 20.0, path, 30.0, 0.0)
    assert State((), Noise(), 0.0, process=two).key[1] == "telegraph"
    many = State((), Noise(), 0.0, process=dataclasses.replace(two, kind="levels"))
    assert many.key[1] == "wander"
    assert many.wander == pytest.approx(3.0)
