"""De-noising of the experiment: smoothers keep what is smooth, and the likelihood finds how smooth it is."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

import rlgcomp as rlg
from experiments.denoising import methods

N = 600


def _run(values: np.ndarray) -> rlg.Recording:
    return rlg.recording(pd.DataFrame({"time_s": 10.0 * np.arange(len(values)), "gyro_deg_h": values}))


NAMES = [
    pytest.param(name, marks=pytest.mark.needs("pywt")) if "wavelet" in name else name
    for name in methods.METHODS
    if name != "as recorded"
]


@pytest.mark.parametrize("name", NAMES)
def test_noise_falls_and_the_bias_stays(name: str) -> None:
    rng = np.random.default_rng(4)
    bias = 0.05 * np.sin(np.linspace(0.0, 7.0, N))
    run = _run(bias + 0.02 * rng.standard_normal(N))
    smoothed = methods.METHODS[name](run, "gyro_deg_h")
    assert np.std(smoothed - bias) < 0.5 * 0.02


def test_smoother_is_the_posterior_mean() -> None:
    """Against the mean of the joint Gaussian distribution, in one solve."""
    values = np.cumsum(np.random.default_rng(2).standard_normal(40))
    ratio = 0.3
    differences = np.diff(np.eye(40), axis=0)
    expected = np.linalg.solve(np.eye(40) + differences.T @ differences / ratio, values)
    assert methods.smooth(values, ratio, trend=False)[0] == pytest.approx(expected, abs=1e-5)


def test_a_line_stays_a_line() -> None:
    line = np.linspace(-1.0, 2.0, 200)
    assert methods.smooth(line, 1e-8, trend=True)[0] == pytest.approx(line, abs=1e-5)
    assert methods.moving_average(300.0)(_run(line), "gyro_deg_h") == pytest.approx(line, abs=1e-12)


def test_likelihood_finds_the_smoothness() -> None:
    rng = np.random.default_rng(5)
    values = np.cumsum(0.5 * rng.standard_normal(1500)) + rng.standard_normal(1500)
    tried = [0.25 / 30.0, 0.25, 0.25 * 30.0]
    likelihood = [methods.smooth(values, ratio, trend=False)[1] for ratio in tried]
    assert int(np.argmax(likelihood)) == 1
