"""Whether what follows no recorded column is what its name says."""

from __future__ import annotations

import itertools
from collections.abc import Callable

import numpy as np
import pandas as pd
import pytest
from numpy.typing import NDArray
from scipy.stats import multivariate_normal

import rlgcomp as rlg
from rlgcomp.diagnosis.naming.signatures import _keeps_time, _log_likelihood_of_any_level
from rlgcomp.diagnosis.noise.whitening import Rows

Array = NDArray[np.float64]
SIMULATOR = rlg.Simulator.from_mapping({"kind": "chamber", "mechanisms": [{"thermal_polynomial": {"degree": 2}}]})
WHITE_DEG_H = 0.002


def test_all_ways_to_jump_are_summed_over() -> None:
    """Against every partition of eight rows in two runs, levels integrated out as a covariance."""
    rng = np.random.default_rng(4)
    time_s = np.array([0.0, 100.0, 200.0, 400.0, 500.0, 0.0, 100.0, 200.0])
    rows = Rows(time_s, np.array([0, 0, 0, 0, 0, 1, 1, 1]), np.ones(8), 100.0)
    values = rng.standard_normal(8)
    level, noise, dwell_s = 1.3, 0.7, 350.0
    total = 0.0
    for part in rows.runs:
        steps, y = np.diff(rows.time_s[part]), values[part]
        likelihoods = []
        for jumps in itertools.product((False, True), repeat=len(steps)):
            jumped = -np.expm1(-steps / dwell_s)
            prior = np.prod(np.where(jumps, jumped, 1.0 - jumped))
            stay = np.r_[0, np.cumsum(jumps)]
            covariance = level**2 * (stay[:, None] == stay) + noise**2 * np.eye(len(y))
            likelihoods.append(prior * multivariate_normal.pdf(y, cov=covariance))
        total += np.log(np.sum(likelihoods))
    found = _log_likelihood_of_any_level(rows, values, np.array([level]), np.array([noise]), np.array([dwell_s]))
    assert found == pytest.approx([total], rel=1e-12)


def stays_to_path(stays: Array, rows: int) -> Array:
    """A sign for each window of 100 s, flipped after each stay."""
    return np.asarray(1.0 - 2.0 * (np.searchsorted(np.cumsum(stays), np.arange(rows)) % 2))


@pytest.mark.parametrize("mean", [12.0, 30.0])
def test_stays_of_chance_are_not_too_alike_and_those_of_a_clock_are(mean: float) -> None:
    rng = np.random.default_rng(3)
    rows = Rows(100.0 * np.arange(432.0), np.zeros(432, dtype=np.intp), np.ones(432), 100.0)
    random = [rng.exponential(mean, 400) for _ in range(150)]
    seen = [one[one > 3.0] for one in random]  # short stays are missed
    alike = [_keeps_time(stays_to_path(one, 432), rows) for one in (*random, *seen)]
    assert sum(alike) <= 1  # of three hundred, at five in ten thousand
    kept = [_keeps_time(stays_to_path(mean * rng.uniform(0.9, 1.1, 400), 432), rows) for _ in range(25)]
    assert np.mean(kept) > 0.9
    unequal = np.tile([0.6 * mean, 1.4 * mean], 200)
    kept = [_keeps_time(stays_to_path(unequal * rng.uniform(0.9, 1.1, 400), 432), rows) for _ in range(25)]
    assert np.mean(kept) > 0.95
    assert not _keeps_time(stays_to_path(np.full(9, 100.0), 432), rows)  # three stays tell nothing


def sawtooth(time_s: Array, rng: np.random.Generator) -> Array:
    """Ramps that fall back at irregular times."""
    starts = np.cumsum(rng.uniform(2000.0, 5000.0, 60))
    since = time_s - np.r_[0.0, starts][np.searchsorted(starts, time_s, side="right")]
    return np.asarray(since / 2000.0)


def blows(time_s: Array, rng: np.random.Generator) -> Array:
    """Blows at irregular times, each of which dies away."""
    since = time_s[:, None] - np.cumsum(rng.uniform(5400.0, 12600.0, 60))
    return np.asarray(np.sum(np.where(since >= 0.0, 6.0 * np.exp(-np.maximum(since, 0.0) / 3000.0), 0.0), axis=1))


def telegraph(time_s: Array, rng: np.random.Generator) -> Array:
    return np.asarray(np.where(np.cumsum(rng.random(len(time_s)) < np.diff(time_s)[0] / 3000.0) % 2, 1.2, -1.2))


def hum(time_s: Array, rng: np.random.Generator) -> Array:
    """A swing whose period wanders by an eighth."""
    keep = np.exp(-np.diff(time_s)[0] / 9000.0)
    wander = np.zeros(len(time_s))
    for k in range(1, len(wander)):
        wander[k] = keep * wander[k - 1] + np.sqrt(1.0 - keep**2) * rng.standard_normal()
    return np.asarray(2.0 * np.sin(2.0 * np.pi / 2200.0 * np.cumsum(np.diff(time_s)[0] * (1.0 + 0.125 * wander))))


def steady(time_s: Array, rng: np.random.Generator) -> Array:
    return np.asarray(2.0 * np.sin(2.0 * np.pi * time_s / 2200.0 + rng.uniform(0.0, 6.0)))


def run(effect: Callable[[Array, np.random.Generator], Array], number: int, rng: np.random.Generator) -> rlg.Recording:
    time_s = 100.0 * np.arange(400.0)
    gyro = WHITE_DEG_H * (effect(time_s, rng) + rng.standard_normal(400))
    block = 10.0 + 30.0 * np.sin(2.0 * np.pi * time_s / (3600.0 * (2.3 + 0.7 * number)))
    table = pd.DataFrame({"time_s": time_s, "gyro_deg_h": gyro, "temperature_block_degC": block})
    return rlg.Recording(table, name=f"run{number}")


def diagnosed(effect: Callable[[Array, np.random.Generator], Array], seed: int) -> rlg.Diagnosis:
    rng = np.random.default_rng(seed)
    return rlg.diagnose(SIMULATOR, [run(effect, k, rng) for k in range(2)], window_s=100.0, black_box=False)


@pytest.mark.parametrize("seed", [1, pytest.param(2, marks=pytest.mark.slow)])
@pytest.mark.parametrize(
    ("effect", "named", "why"),
    [
        (sawtooth, set(), None),
        (blows, set(), "random_telegraph and is none: it has more than two levels"),
        (telegraph, {"random_telegraph"}, None),
        (hum, set(), "periodic_interference and is none: its frequency does not stay the same"),
        (steady, {"periodic_interference"}, None),
    ],
)
def test_what_only_takes_after_it_is_not_named(
    effect: Callable[[Array, np.random.Generator], Array], named: set[str], why: str | None, seed: int
) -> None:
    diagnosis = diagnosed(effect, seed)
    assert {cause.name for cause in diagnosis.causes} == named
    assert diagnosis.verdict == ("explained" if named else "unknown")
    assert diagnosis.p_value < 0.01
    if why is not None:
        assert any(f"What there is takes after {why}" in remark for remark in diagnosis.remarks)
        assert not any(why.split()[0] in item.mechanisms for item in diagnosis.alternatives)


def levels(time_s: Array, rng: np.random.Generator) -> Array:
    """Steps to any value, as of a supply that is switched."""
    changes = np.cumsum(rng.random(len(time_s)) < np.diff(time_s)[0] / 5000.0)
    return np.asarray(rng.normal(0.0, 4.0, changes[-1] + 1)[changes])


@pytest.mark.parametrize("seed", [1, pytest.param(2, marks=pytest.mark.slow), pytest.param(3, marks=pytest.mark.slow)])
@pytest.mark.parametrize(("later", "named"), [(telegraph, {"random_telegraph"}), (levels, set())])
def test_jumps_between_two_values_are_none_where_held_out_runs_jump_otherwise(
    later: Callable[[Array, np.random.Generator], Array], named: set[str], seed: int
) -> None:
    rng = np.random.default_rng(seed)
    train, test = [run(telegraph, k, rng) for k in (0, 1)], [run(later, k, rng) for k in (2, 3)]
    diagnosis = rlg.diagnose(SIMULATOR, train, test, window_s=100.0, black_box=False)
    assert {cause.name for cause in diagnosis.causes} == named
    assert diagnosis.verdict == ("explained" if named else "unknown")
    assert any("held-out runs do not jump as the training runs do" in remark for remark in diagnosis.remarks) == (not named)


@pytest.mark.parametrize("seed", [1, 4, pytest.param(9, marks=pytest.mark.slow), pytest.param(10, marks=pytest.mark.slow)])
def test_a_weak_line_that_is_slow_is_one_where_noise_alone_is_beside_it(seed: int) -> None:
    diagnosis = diagnosed(lambda time_s, rng: 0.15 * steady(0.5 * time_s, rng), seed)
    assert not any("What there is takes after" in remark for remark in diagnosis.remarks)
    assert {cause.name for cause in diagnosis.causes} <= {"periodic_interference"}
