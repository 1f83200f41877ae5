"""Whitening: against dense matrices, and against the noise it is meant for."""

from __future__ import annotations

import numpy as np
import pytest

from rlgcomp.diagnosis.naming.two_levels import Models, smoothed
from rlgcomp.diagnosis.noise.whitening import NoiseShape, Rows, Whitener, simulate, whiten
from tests.dense_noise import dense

SHAPES = (
    NoiseShape(),
    NoiseShape(flicker=0.4),
    NoiseShape(walk=0.3),
    NoiseShape(0.2, 0.1),
    NoiseShape(wander=0.8, wander_s=900.0),
    NoiseShape(walk=0.2, wander=1.2, wander_s=2000.0, swing_s=1500.0),
    NoiseShape(flicker=0.2, wander=1.2, wander_s=2000.0, at_deg_s=30.0),
    NoiseShape(wander=0.8, wander_s=2000.0, swing_s=1500.0, at_deg_s=30.0),
)
RATES_DEG_S = np.array([-60.0, 10.0, 0.5, 40.0, 0.0, 0.0, 30.0])


def rows(*lengths: int, contrasts: int = 0) -> Rows:
    times = [100.0 * np.arange(n) + (np.arange(n) > n // 2) * 700.0 for n in lengths]  # with a gap
    run = np.repeat(np.arange(len(lengths)), lengths)
    white = np.where(np.arange(len(run)) % 7 == 3, 1.25, 1.0)
    more = np.zeros(contrasts)
    run_of_all, white = np.r_[run, more + 9].astype(int), np.r_[white, more + 1.0]
    rate_deg_s = np.resize(RATES_DEG_S, len(run))
    return Rows(np.r_[np.concatenate(times), more], run_of_all, white, 100.0, contrasts, rate_deg_s)


@pytest.mark.parametrize("shape", SHAPES)
def test_innovations_are_those_of_the_dense_factor(shape: NoiseShape) -> None:
    where = rows(40, 25, contrasts=4)
    columns = np.random.default_rng(1).standard_normal((len(where), 3))
    whitened, log_determinant = whiten(where, columns, (shape,))
    factor = np.linalg.cholesky(dense(where, shape))
    np.testing.assert_allclose(whitened[0], np.linalg.solve(factor, columns), atol=1e-9)
    assert log_determinant[0] == pytest.approx(2.0 * np.log(np.diag(factor)).sum(), abs=1e-9)


def test_many_shapes_at_once_are_each_alone() -> None:
    where = rows(30, 30)
    columns = np.random.default_rng(2).standard_normal((60, 2))
    together = Whitener(where, SHAPES)
    for k, shape in enumerate(SHAPES):
        np.testing.assert_allclose(together(columns)[k], whiten(where, columns, (shape,))[0][0], atol=1e-12)
    some = together.keep(np.array([4, 1]))
    np.testing.assert_allclose(some(columns), together(columns)[[4, 1]], atol=1e-12)
    np.testing.assert_allclose(some.log_determinant, together.log_determinant[[4, 1]])


def test_one_shape_alone_is_as_among_all(monkeypatch: pytest.MonkeyPatch) -> None:
    where = rows(50, 41, contrasts=3)
    columns = np.random.default_rng(0).normal(size=(len(where), 4))
    whitener = Whitener(where, SHAPES)
    together = whitener(columns)
    for flag in ("1", "0"):
        monkeypatch.setenv("RLGCOMP_NUMBA", flag)
        for k in range(len(SHAPES)):
            np.testing.assert_allclose(whitener.of(k, columns), together[k], rtol=1e-12, atol=1e-14)


@pytest.mark.parametrize("shape", SHAPES)
def test_simulated_noise_is_the_same_compiled(shape: NoiseShape, monkeypatch: pytest.MonkeyPatch) -> None:
    compiled = simulate(rows(60, 45), shape, 5, np.random.default_rng(3))
    monkeypatch.setenv("RLGCOMP_NUMBA", "0")
    np.testing.assert_allclose(compiled, simulate(rows(60, 45), shape, 5, np.random.default_rng(3)), rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("shape", SHAPES[1:])
def test_simulated_noise_is_white_once_whitened(shape: NoiseShape) -> None:
    where = rows(60, 50)
    noise = simulate(where, shape, 600, np.random.default_rng(3))
    whitened = whiten(where, noise, (shape,))[0][0]
    covariance = whitened @ whitened.T / 600.0
    off = covariance - np.eye(len(where))
    assert np.abs(np.diag(off)).mean() < 0.07  # sqrt(2 / 600) is 0.058
    assert np.abs(off[~np.eye(len(where), dtype=bool)]).mean() < 0.04  # sqrt(1 / 600) times 0.8 is 0.033


def test_flicker_has_the_allan_variance_of_its_coefficient() -> None:
    where = Rows(100.0 * np.arange(4000), np.zeros(4000, dtype=int), np.ones(4000), 100.0)
    noise = simulate(where, NoiseShape(flicker=1.0), 40, np.random.default_rng(4))
    means = noise.reshape(-1, 16, 40).mean(axis=1)  # 1600 s: white noise adds 1/16
    allan = 0.5 * np.mean(np.diff(means, axis=0) ** 2)
    assert allan - 1.0 / 16.0 == pytest.approx(2.0 * np.log(2.0) / np.pi, rel=0.12)


def test_compiled_and_plain_agree(monkeypatch: pytest.MonkeyPatch) -> None:
    many = rows(60, 45, contrasts=5)
    columns = np.random.default_rng(3).standard_normal((len(many), 4))
    windows, models = slice(len(many) - many.contrasts), Models(np.ones(2), np.array([0.8, 1.3]), np.array([3000.0, 900.0]))
    answers = []
    for allowed in ("1", "0"):
        monkeypatch.setenv("RLGCOMP_NUMBA", allowed)
        hidden = smoothed(many, (np.sign(columns[:, :2]) + columns[:, 2:])[windows], models)
        answers.append([*whiten(many, columns, SHAPES), *hidden])
    for fast, plain in zip(*answers, strict=True):
        np.testing.assert_allclose(fast, plain, rtol=1e-10, atol=1e-12)
