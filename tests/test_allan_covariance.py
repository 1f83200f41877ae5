"""Covariance of Allan variances at different averaging times, against simulations."""

from __future__ import annotations

import numpy as np
import pytest

import rlgcomp as rlg
from rlgcomp.noise.allan_covariance import covariance_products, design_matrix
from tests.noise_records import WHITE, deviation, record


@pytest.mark.parametrize("estimator", ["overlapping", "hadamard"])
@pytest.mark.parametrize(
    "model",
    [WHITE, rlg.NoiseModel(rate_random_walk_deg_h_sqrt_h=1.0), rlg.NoiseModel(bias_instability_deg_h=1.0)],
    ids=["white", "random-walk", "flicker"],
)
def test_covariance_between_averaging_times_is_that_of_simulations(model: rlg.NoiseModel, estimator: str) -> None:
    """Of 300 records, for tau of 8 s and more, where a sum of steps and Kasdin's filter are the noise they stand for."""
    taus = [8.0, 16.0, 32.0, 128.0, 400.0]
    curves = [deviation(record(model, seed, 2000), tau_s=taus, estimator=estimator) for seed in range(300)]
    sample = np.array([curve.deviation_deg_h**2 for curve in curves])
    m, order = np.array(taus, dtype=int), curves[0].order
    variances = np.zeros(5)
    design = design_matrix(m, order)
    j = {60.0 * model.angle_random_walk_deg_sqrt_h: 1, model.bias_instability_deg_h: 2, model.rate_random_walk_deg_h_sqrt_h: 3}
    which = next(place for strength, place in j.items() if strength)
    variances[which] = float(np.mean(sample[:, 1]) / design[1, which])
    products = covariance_products(m, curves[0].parts, order)
    expected = np.einsum("ikjl,j,l->ik", products, variances, variances)
    assert np.std(sample, axis=0) == pytest.approx(np.sqrt(np.diag(expected)), rel=0.2)
    correlation = expected / np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    assert np.corrcoef(sample.T) == pytest.approx(correlation, abs=0.2)
