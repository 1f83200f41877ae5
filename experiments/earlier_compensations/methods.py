"""The earlier methods: each is fitted to scaled rows with the label of their run, and predicts scaled rows."""

from __future__ import annotations

import itertools
import warnings
from collections.abc import Callable, Sequence
from typing import Any, Final

import numpy as np
import numpy.typing as npt
from sklearn.exceptions import ConvergenceWarning

from rlgcomp.compensation.models.cubic import CubicLeastSquares
from rlgcomp.compensation.models.specification import refit_residuals

Array = npt.NDArray[np.float64]
Labels = npt.NDArray[np.int64]
Predictor = Callable[[Array], Array]
MOST_EXHAUSTIVE: Final = 10  # inputs whose subsets are all tried
PARTICLES: Final = 20
GENERATIONS: Final = 15
_SWARM_LOW: Final = (-1.0, -3.0, -3.0)  # powers of ten of C, gamma and epsilon
_SWARM_HIGH: Final = (4.0, 1.0, 0.0)
_NEURONS: Final = 10
_PENALTIES: Final = (1e-4, 1e-2, 1.0, 10.0)
_STARTS: Final = 5


def sensor_selection(X: Array, y: Array, groups: Labels) -> tuple[tuple[int, ...], Predictor]:
    """Inputs of the smallest sum of squared errors with runs left out, of an additive cubic, and that cubic.

    Parameters
    ----------
    X : ndarray, shape (n, features)
        Every subset of up to ten inputs is tried; of more inputs one is added at a time, and the best of the sizes is taken.
    y : ndarray, shape (n,)
    groups : ndarray of int, shape (n,)
        Run of each row. The sum within training rows would fall with every input that is added.
    """

    def squares(places: Sequence[int]) -> float:
        residuals = refit_residuals(CubicLeastSquares(), [{}], X[:, list(places)], y, groups)
        return float((residuals**2).sum())

    features = range(X.shape[1])
    if X.shape[1] <= MOST_EXHAUSTIVE:
        subsets = [places for size in range(1, X.shape[1] + 1) for places in itertools.combinations(features, size)]
    else:
        subsets, added = [], ()
        while len(added) < X.shape[1]:
            added = min(((*added, k) for k in features if k not in added), key=squares)
            subsets.append(added)
    best = min(subsets, key=squares)
    model = CubicLeastSquares().fit(X[:, list(best)], y)
    return best, lambda rows: model.predict(rows[:, list(best)])


def swarm_support_vectors(X: Array, y: Array, groups: Labels, *, seed: int = 0) -> tuple[dict[str, float], Predictor]:
    """Support vector regression whose C, gamma and epsilon a particle swarm chooses by the error with runs left out.

    Parameters
    ----------
    X : ndarray, shape (n, features)
    y : ndarray, shape (n,)
    groups : ndarray of int, shape (n,)
    seed : int
        Of the swarm.
    """
    from pymoo.algorithms.soo.nonconvex.pso import PSO
    from pymoo.core.problem import ElementwiseProblem
    from pymoo.optimize import minimize

    class _Error(ElementwiseProblem):  # type: ignore[misc]
        def _evaluate(self, x: Array, out: dict[str, Any], *_: Any, **__: Any) -> None:
            out["F"] = float(np.sqrt(np.mean(refit_residuals(_support_vectors(x), [{}], X, y, groups) ** 2)))

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ConvergenceWarning)  # of particles far out
        problem = _Error(n_var=3, n_obj=1, xl=np.array(_SWARM_LOW), xu=np.array(_SWARM_HIGH))
        best = minimize(problem, PSO(pop_size=PARTICLES), ("n_gen", GENERATIONS), seed=seed, verbose=False)
        model = _support_vectors(best.X).fit(X, y)
    return {name: float(value) for name, value in model.get_params().items() if name in ("C", "gamma", "epsilon")}, model.predict


def _support_vectors(powers: Array) -> Any:
    from sklearn.svm import SVR

    c, gamma, epsilon = (10.0 ** np.asarray(powers)).tolist()
    return SVR(C=c, gamma=gamma, epsilon=epsilon, cache_size=200, max_iter=200_000)


def neural_network(X: Array, y: Array, groups: Labels) -> tuple[float, Predictor]:
    """Ten neurons in one layer, the mean of five starts; the penalty on the weights is chosen with runs left out.

    Parameters
    ----------
    X : ndarray, shape (n, features)
    y : ndarray, shape (n,)
    groups : ndarray of int, shape (n,)
    """

    def network(penalty: float, start: int) -> Any:
        from sklearn.neural_network import MLPRegressor

        return MLPRegressor(
            hidden_layer_sizes=(_NEURONS,), activation="tanh", solver="lbfgs", alpha=penalty, max_iter=400, random_state=start
        )

    def error(penalty: float) -> float:
        return float(np.mean(refit_residuals(network(penalty, 0), [{}], X, y, groups) ** 2))

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ConvergenceWarning)  # stopped early, which limits the weights as the penalty does
        best = min(_PENALTIES, key=error)
        fitted = [network(best, start).fit(X, y) for start in range(_STARTS)]
    return best, lambda rows: np.mean([model.predict(rows) for model in fitted], axis=0)
