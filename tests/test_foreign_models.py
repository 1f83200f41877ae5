"""Models of scikit-learn that are not the package's own: saved by skops where all their types are trusted, refused otherwise."""

from __future__ import annotations

import shutil
import sys
import zipfile
from pathlib import Path

import numpy as np
import pytest
from sklearn.base import BaseEstimator, RegressorMixin
from sklearn.ensemble import GradientBoostingRegressor, RandomForestRegressor
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.linear_model import Ridge
from sklearn.neighbors import KNeighborsRegressor
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import PolynomialFeatures
from sklearn.tree import DecisionTreeRegressor
from sklearn.tree._tree import Tree

import rlgcomp as rlg
from rlgcomp.compensation import foreign_models
from rlgcomp.compensation.foreign_models import packed
from rlgcomp.files import sha256

MODELS = [
    RandomForestRegressor(n_estimators=5, random_state=0),
    GradientBoostingRegressor(n_estimators=5, random_state=0),
    KNeighborsRegressor(algorithm="brute"),
    GaussianProcessRegressor(alpha=0.1, optimizer=None),
    make_pipeline(PolynomialFeatures(), Ridge()),
]


class OwnRegressor(RegressorMixin, BaseEstimator):
    """A class of the user's own, whose code no file can hold."""

    def fit(self, X: np.ndarray, y: np.ndarray) -> OwnRegressor:
        self.mean_ = float(np.mean(y))
        return self

    def predict(self, X: np.ndarray) -> np.ndarray:
        return np.full(len(X), self.mean_)


@pytest.fixture(scope="module")
def runs() -> list[rlg.Recording]:
    gyro = rlg.simulated_unit(1)
    return [gyro.simulate("short", seed=seed, step_s=20.0) for seed in (1, 2)]


def saved(model: object, runs: list[rlg.Recording], folder: Path) -> rlg.Compensator:
    compensator = rlg.Compensator(model, features="temperature,temperature_rate").fit(runs)
    compensator.save(folder)
    return compensator


@pytest.mark.needs("skops")
@pytest.mark.parametrize("model", MODELS, ids=lambda model: type(model).__name__)
def test_a_model_of_scikit_learn_comes_back(model: object, runs: list[rlg.Recording], tmp_path: Path) -> None:
    before = saved(model, runs, tmp_path / "model")
    again = rlg.load(tmp_path / "model")
    assert (again.predict(runs[0]) == before.predict(runs[0])).all(axis=None)
    assert type(model).__name__ in repr(again)
    again.save(tmp_path / "again")
    assert rlg.evaluate(again, runs[1:], compare=False).residual_std_deg_h > 0.0


@pytest.mark.needs("skops")
def test_a_class_of_ones_own_is_refused_with_its_name(runs: list[rlg.Recording], tmp_path: Path) -> None:
    with pytest.raises(rlg.InputError, match=r"OwnRegressor cannot be saved: it holds .*OwnRegressor, which is not among"):
        saved(OwnRegressor(), runs, tmp_path / "model")
    assert not (tmp_path / "model").exists()


def test_without_skops_the_message_says_what_to_install(
    runs: list[rlg.Recording], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "skops.io", None)
    with pytest.raises(rlg.InputError, match=r"Ridge cannot be saved without skops.*rlgcomp\[python\]"):
        saved(Ridge(), runs, tmp_path / "model")


def resealed(folder: Path) -> None:
    """The list of checksums as it would be had the files been written so."""
    names = [line.partition("  ")[2] for line in (folder / "SHA256SUMS").read_text().splitlines()]
    (folder / "SHA256SUMS").write_text("".join(f"{sha256(folder / name)}  {name}\n" for name in names))


@pytest.mark.needs("skops")
def test_a_file_that_holds_more_is_refused_unread(runs: list[rlg.Recording], tmp_path: Path) -> None:
    import skops.io as skops

    saved(Ridge(), runs, tmp_path / "model")
    for name, content, message in (
        ("own", skops.dumps(OwnRegressor().fit(np.zeros((3, 2)), np.zeros(3))), "model.skops is refused: it holds"),
        ("damaged", b"PK\x03\x04 no archive", "model.skops is damaged"),
        ("other", skops.dumps(Ridge().fit(np.eye(3), np.zeros(3))), "no fitted model of 2 inputs"),
        ("no model", skops.dumps({"a": 1}), "holds a dict, which is no fitted model"),
    ):
        folder = tmp_path / name
        shutil.copytree(tmp_path / "model", folder)
        (folder / "model.skops").write_bytes(content)
        with pytest.raises(rlg.InputError, match="has changed since it was written"):
            rlg.load(folder)
        resealed(folder)
        with pytest.raises(rlg.InputError, match=message):
            rlg.load(folder)


@pytest.mark.needs("skops")
def test_a_tree_that_leads_nowhere_is_refused(runs: list[rlg.Recording], tmp_path: Path) -> None:
    """Its compiled code would read beyond its arrays."""
    model = saved(DecisionTreeRegressor(max_depth=3), runs, tmp_path / "model").model_
    tree = model.tree_
    for name, value in (("left_child", 10**6), ("left_child", 0), ("feature", 7), ("right_child", -5)):
        state = tree.__getstate__()
        nodes = state["nodes"].copy()
        nodes[name][0] = value
        wrong = Tree(tree.n_features, tree.n_classes, tree.n_outputs)
        wrong.__setstate__(state | {"nodes": nodes})
        model.tree_ = wrong
        (tmp_path / "model" / "model.skops").write_bytes(packed(model))
        resealed(tmp_path / "model")
        with pytest.raises(rlg.InputError, match="a decision tree leads beyond"):
            rlg.load(tmp_path / "model")


@pytest.mark.needs("skops")
def test_a_file_that_unpacks_to_more_than_any_model_is_refused(
    runs: list[rlg.Recording], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of 1 GiB; here a limit of 1 MiB stands for it, which is packed sooner."""
    assert foreign_models.LARGEST_BYTES == 1 << 30
    monkeypatch.setattr(foreign_models, "LARGEST_BYTES", 1 << 20)
    saved(Ridge(), runs, tmp_path / "model")
    with zipfile.ZipFile(tmp_path / "model" / "model.skops", "w", zipfile.ZIP_DEFLATED) as archive, archive.open("a", "w") as item:
        for _ in range(1025):
            item.write(bytes(1 << 10))
    resealed(tmp_path / "model")
    with pytest.raises(rlg.InputError, match="unpacks to 1049600 bytes"):
        rlg.load(tmp_path / "model")
