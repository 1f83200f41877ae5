"""Selecting an LS-SVM: width and weight on a 15 x 15 grid with ten folds, against grid searches that fit again.

The rows are those of simulated chamber runs at 100 s, 10 s and 1 s, the folds contiguous blocks, as thermal data ask for.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from experiments.speed.lssvmlab import lssvmlab
from experiments.speed.measure import Case, Peer, Row
from rlgcomp.compensation.feature_pipeline import pipeline_for
from rlgcomp.compensation.models import lssvm
from rlgcomp.compensation.models.lssvm import LSSVMRegressor
from rlgcomp.compensation.models.specification import Labels, ModelSpecification
from rlgcomp.compensation.selection import Selection, select
from rlgcomp.compensation.window_means import window_means
from rlgcomp.simulation.random_units import simulated_unit

Array = npt.NDArray[np.float64]
FOLDS: Final = 10
WIDTHS: Final = np.sqrt(12.0) * np.geomspace(16.0, 0.25, 15)
WEIGHTS: Final = 10.0 ** np.linspace(-1.0, 6.0, 15)
RUN_S: Final = 40_800.0
SPECIFICATION: Final = ModelSpecification(
    name=lssvm.SPECIFICATION.name,
    estimator=LSSVMRegressor,
    batches=lambda features: [[{"sigma": float(s), "c": float(c)} for c in WEIGHTS] for s in WIDTHS],
    rmse=lssvm.SPECIFICATION.rmse,
    threads=True,
    numbers=(),
    arrays=(),
    check=lssvm.SPECIFICATION.check,
)


@functools.cache
def thermal_rows(n: int) -> tuple[Array, Array, Labels]:
    """Scaled inputs (12 of them) and output of two chamber runs, n rows in all, and the blocks that are left out."""
    averaging_s = 2.0 * RUN_S / n
    unit = simulated_unit(1)
    step_s = averaging_s / np.ceil(averaging_s / 10.0)
    runs = [unit.simulate(name, seed=seed, step_s=step_s) for seed, name in enumerate(("paper", "minor-loops"), start=1)]
    pipeline = pipeline_for(runs, "all")
    parts = [window_means(run, pipeline, max(averaging_s, run.period_s)) for run in runs]
    X = np.vstack([np.column_stack([part.X, np.linspace(0.0, 1.0, len(part.X))]) for part in parts])[:n]
    y = np.concatenate([part.y_deg_h for part in parts])[:n]
    X = (X - X.mean(axis=0)) / X.std(axis=0)
    return X, (y - y.mean()) / y.std(), np.arange(len(y)) * FOLDS // len(y)


def _ours(X: Array, y: Array, groups: Labels) -> Selection:
    return select(SPECIFICATION, LSSVMRegressor(), X, y, groups, n_jobs=2)


def _case(n: int, few: int, goals: tuple[float | None, float | None, float | None]) -> Callable[[bool], Case]:
    def prepare(quick: bool) -> Case:
        X, y, groups = thermal_rows(few if quick else n)
        peers = [
            Peer("scikit-learn, Nyström 500 + RidgeCV", lambda: _smart(X, y), _winner_apart, 0.05, goals[1]),
        ]
        if len(y) <= 5000:
            best = _ours(X, y, groups).best
            peers.append(Peer("the exact folds, at our winner", lambda: _exact(best, X, y, groups), _error_apart, 1e-4))
            share = 1.0 if len(y) < 1000 else 1.0 / 225.0 / FOLDS
            peers.append(
                Peer("scikit-learn GridSearchCV(KernelRidge)", lambda: _grid(X, y, groups, share), _anything, 0.05, goals[0], share)
            )
        if len(y) < 1000:
            octave = functools.partial(lssvmlab, X, y, WIDTHS, WEIGHTS, FOLDS)
            peers.append(Peer("LS-SVMlab 1.8 in Octave, the same grid and folds", octave, _same_folds_apart, 1e-6, goals[2]))
            peers.append(Peer("neo-ls-svm, which has no widths to select", lambda: _neo(X, y), lambda ours, theirs: 0.0, 1.0))
        return Case(lambda: _ours(X, y, groups), peers, size=f"n = {len(y)}, d = {X.shape[1]}", memory=len(y) > 10_000, n=len(y))

    return prepare


def _exact(best: dict[str, Any], X: Array, y: Array, groups: Labels) -> float:
    """The error on all rows as centres, its runs' biases of the same variance as in the selection."""
    from rlgcomp.compensation.models.fixed_size import run_variance_over_noise  # here: older packages lack them
    from rlgcomp.compensation.models.lssvm_search import CENTRES_OF_MANY, MANY_ROWS

    variance = None
    if len(y) > MANY_ROWS:
        variance = run_variance_over_noise(X, y, groups, CENTRES_OF_MANY, best["sigma"], WEIGHTS) / best["c"]
    model = LSSVMRegressor(c=best["c"], sigma=best["sigma"], run_variance=variance).fit(X, y, runs=groups)
    return float(np.sqrt(np.mean(model.leave_groups_out(groups) ** 2)))


def _error_apart(ours: Selection, exact: float) -> float:
    return abs(float(ours.rmse or 0.0) / exact - 1.0)


def _same_folds_apart(ours: Selection, theirs: float) -> float:
    return abs(theirs / float(ours.table["rmse"].min()) - 1.0)


def _smart(X: Array, y: Array) -> float:
    """The best a skilled user of scikit-learn does: a Nyström map a width, ridge regressions in closed form a fold."""
    from sklearn.kernel_approximation import Nystroem
    from sklearn.linear_model import RidgeCV

    best = np.inf
    for sigma in WIDTHS:
        Z = Nystroem(gamma=0.5 / sigma**2, n_components=min(500, len(y)), random_state=0).fit_transform(X)
        found = RidgeCV(alphas=1.0 / WEIGHTS, scoring="neg_mean_squared_error").fit(Z, y)
        best = min(best, float(np.sqrt(-found.best_score_)))
    return best


def _winner_apart(ours: Selection, theirs: float) -> float:
    """How far their error is from ours; theirs leaves single rows out, not blocks, so it may only be smaller."""
    return max(0.0, theirs / float(ours.table["rmse"].min()) - 1.0)


def _grid(X: Array, y: Array, groups: Labels, share: float) -> float:
    from sklearn.kernel_ridge import KernelRidge
    from sklearn.model_selection import GridSearchCV, PredefinedSplit

    if share < 1.0:
        out = groups == 0
        model = KernelRidge(kernel="rbf", gamma=0.5 / WIDTHS[7] ** 2, alpha=1e-3).fit(X[~out], y[~out])
        return float(np.sqrt(np.mean((model.predict(X[out]) - y[out]) ** 2)))
    grid = {"gamma": (0.5 / WIDTHS**2).tolist(), "alpha": (1.0 / WEIGHTS).tolist()}
    found = GridSearchCV(KernelRidge(kernel="rbf"), grid, scoring="neg_mean_squared_error", cv=PredefinedSplit(groups))
    return float(np.sqrt(-found.fit(X, y).best_score_))


def _anything(ours: Selection, theirs: float) -> float:
    """A search that was cut short has no winner to compare; a whole one may differ by its missing intercept."""
    return abs(theirs / float(ours.table["rmse"].min()) - 1.0) if len(ours.table) and theirs < 1.5 else 0.0


def _neo(X: Array, y: Array) -> Any:
    from neo_ls_svm import NeoLSSVM

    return NeoLSSVM().fit(X, y)


ROWS: Final = (
    Row("select-430", "LS-SVM selection, means of 100 s", _case(430, 200, (27.0, None, 15.0)), threads=2, goal_s=0.2),
    Row("select-4300", "LS-SVM selection, means of 10 s", _case(4300, 1600, (400.0, 4.0, None)), threads=2, goal_s=2.0),
    Row("select-43000", "LS-SVM selection, a run at 1 Hz", _case(43_000, 6000, (None, None, None)), threads=2, goal_s=8.0),
)
