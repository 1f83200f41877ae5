"""Earlier compensation methods of the experiment: each finds what rows of a known law hold."""

from __future__ import annotations

import numpy as np
import pytest

from experiments.earlier_compensations.methods import neural_network, sensor_selection, swarm_support_vectors


def _rows(features: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Rows of three runs whose output is a function of the second and the last input."""
    rng = np.random.default_rng(seed)
    X = rng.uniform(-1.5, 1.5, (180, features))
    return X, X[:, 1] ** 3 - 0.5 * X[:, -1] + 0.05 * rng.standard_normal(len(X)), np.repeat([0, 1, 2], 60)


@pytest.mark.parametrize("features", [4, 11])  # all subsets; one input after another
def test_sensor_selection_finds_the_inputs_of_the_law(features: int) -> None:
    X, y, groups = _rows(features)
    places, predict = sensor_selection(X, y, groups)
    assert {1, features - 1} <= set(places)
    assert len(places) <= 3
    assert np.std(y - predict(X)) < 0.06


def test_neural_network_learns_the_law() -> None:
    X, y, groups = _rows(3)
    penalty, predict = neural_network(X, y, groups)
    assert penalty > 0.0
    assert np.std(y - predict(X)) < 0.12


@pytest.mark.needs("pymoo")
def test_swarm_tunes_support_vectors(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("experiments.earlier_compensations.methods.GENERATIONS", 4)
    monkeypatch.setattr("experiments.earlier_compensations.methods.PARTICLES", 10)
    X, y, groups = (values[::2] for values in _rows(3))
    parameters, predict = swarm_support_vectors(X, y, groups)
    assert set(parameters) == {"C", "gamma", "epsilon"}
    others, truth, _ = _rows(3, seed=1)
    assert np.std(truth - predict(others)) < 0.12
    assert swarm_support_vectors(X, y, groups)[0] == parameters  # the same swarm again
