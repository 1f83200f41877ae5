"""Selection: the right winner, the same with any number of workers, and resumable after a kill."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from sklearn.kernel_ridge import KernelRidge
from sklearn.model_selection import GridSearchCV, GroupKFold

import rlgcomp as rlg
from rlgcomp.compensation.models import MODELS
from rlgcomp.compensation.models.lssvm_search import batches, beyond
from rlgcomp.compensation.selection import select
from rlgcomp.errors import InputError


@pytest.fixture(scope="module")
def data() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(0)
    X = rng.uniform(-2, 2, size=(120, 2))
    y = np.sin(2 * X[:, 0]) + 0.5 * X[:, 1] + 0.1 * rng.normal(size=120)
    return X, y - y.mean(), np.arange(120) // 30


def choose(data: tuple[np.ndarray, np.ndarray, np.ndarray], name: str = "lssvm", **options: object) -> object:
    return select(MODELS[name], MODELS[name].make(), *data, **options)


@pytest.mark.parametrize(("name", "every"), [("lssvm", 1), ("kernels", 3)])
def test_every_score_is_the_error_with_groups_left_out(
    data: tuple[np.ndarray, np.ndarray, np.ndarray], name: str, every: int
) -> None:
    """A few candidates of the table, fitted again here; "kernels" are all three baselines, on fewer rows: libsvm is slow."""
    X, y, groups = (values[::every] for values in data)
    selection = choose((X, y, groups), name)
    for _, row in selection.table.iloc[:: max(1, len(selection.table) // 3)].iterrows():
        parameters = {key: value for key, value in row.items() if key not in ("rmse", "chosen")}
        residuals = np.empty(len(y))
        for label in range(4):
            out = groups == label
            residuals[out] = y[out] - MODELS[name].make().set_params(**parameters).fit(X[~out], y[~out]).predict(X[out])
        assert row["rmse"] == pytest.approx(np.sqrt(np.mean(residuals**2)), rel=1e-6)


def test_the_smoothest_of_the_best_is_chosen(data: tuple[np.ndarray, np.ndarray, np.ndarray]) -> None:
    selection = choose(data)
    good = selection.table[selection.table["rmse"] <= 1.01 * selection.table["rmse"].min()]
    assert selection.best["sigma"] == good["sigma"].max()
    assert selection.table["chosen"].sum() == 1
    assert selection.rmse == selection.table.loc[selection.table["chosen"], "rmse"].item()


def test_scikit_learns_grid_search_selects_the_same(data: tuple[np.ndarray, np.ndarray, np.ndarray]) -> None:
    X, y, groups = data
    table = choose(data, "kernel-ridge").table
    # pooled error over folds of equal size is what the mean of squared errors gives
    grid = {"gamma": sorted({0.5 / sigma**2 for sigma in table["sigma"]}), "alpha": sorted({1 / c for c in table["c"]})}
    search = GridSearchCV(KernelRidge(kernel="rbf"), grid, cv=GroupKFold(4), scoring="neg_mean_squared_error").fit(
        X, y, groups=groups
    )
    best = table.loc[table["rmse"].idxmin()]
    assert (0.5 / best["sigma"] ** 2, 1 / best["c"]) == pytest.approx((search.best_params_["gamma"], search.best_params_["alpha"]))


def test_workers_change_nothing(data: tuple[np.ndarray, np.ndarray, np.ndarray]) -> None:
    assert choose(data, n_jobs=2).table["rmse"].to_numpy() == pytest.approx(choose(data).table["rmse"].to_numpy(), rel=1e-9)


def test_an_interrupted_search_resumes(data: tuple[np.ndarray, np.ndarray, np.ndarray], tmp_path: Path) -> None:
    journal = tmp_path / "journal.jsonl"

    def stop(done: int, total: int) -> None:
        if done == 4:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        choose(data, journal=journal, progress=stop)
    lines = journal.read_text().splitlines()
    assert len(lines) == 1 + 4
    journal.write_text("\n".join(lines) + '\n{"piece": 7, "rm')  # the last line cut short by the kill

    seen = []
    selection = choose(data, journal=journal, progress=lambda done, total: seen.append((done, total)))
    assert seen[0] == (4, 9)
    assert seen[-1] == (9, 9)
    assert selection.table["rmse"].to_numpy() == pytest.approx(choose(data).table["rmse"].to_numpy(), rel=1e-12)
    assert json.loads(journal.read_text().splitlines()[0]).keys() == {"fingerprint"}
    seen.clear()
    choose(data, journal=journal, progress=lambda done, total: seen.append((done, total)))
    assert seen == [(9, 9)]


def test_an_interrupted_search_whose_errors_are_not_finite_resumes(
    data: tuple[np.ndarray, np.ndarray, np.ndarray], tmp_path: Path
) -> None:
    """JSON has no number that is none: what was not finite when it was written is not when it is read, and is refused the same."""
    X, y, groups = data
    y = np.where(np.arange(len(y)) == 7, np.nan, y)
    for _ in range(2):
        with pytest.raises(InputError, match="no setting of the model has a finite error"):
            choose((X, y, groups), journal=tmp_path / "journal.jsonl")


def test_a_journal_of_other_data_is_ignored(data: tuple[np.ndarray, np.ndarray, np.ndarray], tmp_path: Path) -> None:
    X, y, groups = data
    journal = tmp_path / "journal.jsonl"
    choose(data, journal=journal)
    seen = []
    choose((X, y + 1e-9, groups), journal=journal, progress=lambda done, total: seen.append(done))
    assert seen[0] == 0
    journal.write_text("not json at all\n")
    assert choose(data, journal=journal).best == choose(data).best


def test_a_model_without_parameters_is_scored_all_the_same(data: tuple[np.ndarray, np.ndarray, np.ndarray]) -> None:
    selection = choose(data, "cubic")
    assert selection.best == {}
    assert 0.1 < selection.rmse < 1.0


def test_the_grid_goes_on_beyond_the_edge_at_which_the_best_candidate_lies(
    data: tuple[np.ndarray, np.ndarray, np.ndarray],
) -> None:
    X, _, groups = data
    within = choose(data)
    assert within.table["c"].max() <= 1e8
    assert not within.at_limits
    edge = choose((X, X[:, 0] ** 3 - X[:, 0] * X[:, 1], groups))  # without noise every larger c is better
    assert edge.best["c"] == pytest.approx(1e8)
    assert edge.at_limits == {"c": edge.best["c"]}
    assert [one.code for one in edge.remarks(1.0, "runs")] == ["compensation.at_limits"]
    model, grid = rlg.LSSVMRegressor(), batches(1)
    widest, narrowest = grid[0][0]["sigma"], grid[-1][0]["sigma"]
    wider = beyond(model, 1, grid, {"sigma": widest, "c": 10.0})
    assert [batch[0]["sigma"] for batch in wider] == [2.0 * widest, *(batch[0]["sigma"] for batch in grid)]
    narrower = beyond(model, 1, grid, {"sigma": narrowest, "c": 0.1})
    assert narrower[-1][0]["sigma"] == 0.5 * narrowest
    assert [one["c"] for one in narrower[-2][:3]] == pytest.approx([0.001, 0.01, 0.1])
    assert beyond(model, 1, grid, {"sigma": grid[3][0]["sigma"], "c": 10.0}) == grid


def test_public_name() -> None:
    assert rlg.LSSVMRegressor is MODELS["lssvm"].estimator


def _shorter(line: str) -> str:
    entry = json.loads(line)
    return json.dumps(entry | {"rmse": entry["rmse"][:-1]})


def _better(line: str) -> str:
    entry = json.loads(line)
    return json.dumps(entry | {"rmse": [0.0 for _ in entry["rmse"]]})


@pytest.mark.parametrize(
    "damage",
    [_shorter, _better, lambda line: line.replace('"piece": ', '"piece": 99'), lambda line: "[1, 2]", lambda line: "\udcff"],
    ids=["short", "altered", "no such batch", "a list", "no UTF-8"],
)
def test_damaged_lines_of_a_journal_are_computed_again(
    data: tuple[np.ndarray, np.ndarray, np.ndarray], tmp_path: Path, damage: Callable[[str], str]
) -> None:
    journal = tmp_path / "journal.jsonl"
    expected = choose(data, journal=journal)
    lines = journal.read_text().splitlines()
    lines[1:3] = map(damage, lines[1:3])
    journal.write_bytes("\n".join(lines).encode(errors="surrogateescape"))
    seen: list[int] = []
    selection = choose(data, journal=journal, progress=lambda done, total: seen.append(done))
    assert seen[0] == len(lines) - 3
    pd.testing.assert_frame_equal(selection.table, expected.table)
