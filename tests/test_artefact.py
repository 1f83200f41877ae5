"""The artefact: it comes back bit for bit, and anything changed in it is refused with one message."""

from __future__ import annotations

import json
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

import rlgcomp as rlg
from rlgcomp.compensation import MODELS
from rlgcomp.compensation.artefact import MANIFEST, SUMS, identity
from rlgcomp.files import sha256


@pytest.fixture(scope="module")
def saved(trained: rlg.Compensator, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("artefact") / "model"
    trained.save(path)
    return path


@pytest.fixture
def copy(saved: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(saved, tmp_path / "model"))


def reseal(folder: Path) -> None:
    """Make the checksums fit again, as whoever tampers on purpose would."""
    files = sorted(path for path in folder.rglob("*") if path.is_file() and path.name != SUMS)
    (folder / SUMS).write_text("".join(f"{sha256(path)}  {path.relative_to(folder).as_posix()}\n" for path in files))


def test_it_predicts_the_same_to_the_last_bit(saved: Path, trained: rlg.Compensator, short_runs: list[rlg.Recording]) -> None:
    again = rlg.load(saved)
    for run in short_runs:
        assert again.predict(run).equals(trained.predict(run))
    assert again.recipe_ == trained.recipe_
    assert again.selection_.best == trained.selection_.best
    assert len(again.training_) == 2


def test_saving_what_was_loaded_gives_the_same_numbers(saved: Path, tmp_path: Path) -> None:
    rlg.load(saved).save(tmp_path / "again")
    for file in (saved / "arrays").iterdir():
        assert (tmp_path / "again" / "arrays" / file.name).read_bytes() == file.read_bytes()


@pytest.mark.parametrize("name", [name for name in MODELS if name not in ("kernels", "sequence")])
def test_every_model_comes_back(short_runs: list[rlg.Recording], tmp_path: Path, name: str) -> None:
    model = rlg.Compensator(MODELS[name].make(), features="temperature,temperature_rate").fit(short_runs[:2])
    model.save(tmp_path / "model")
    assert rlg.load(tmp_path / "model").predict(short_runs[2]).equals(model.predict(short_runs[2]))


def test_the_sequence_model_comes_back_without_torch(
    short_runs: list[rlg.Recording], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("torch", reason="torch is not installed (pip install 'rlgcomp[torch]')")
    model = rlg.Compensator(rlg.SequenceRegressor(epochs=20), features="temperature").fit(short_runs[:2])
    model.save(tmp_path / "model")
    monkeypatch.setitem(__import__("sys").modules, "torch", None)
    assert rlg.load(tmp_path / "model").predict(short_runs[2]).equals(model.predict(short_runs[2]))


def test_the_checksums_are_those_of_sha256sum(saved: Path) -> None:
    if shutil.which("sha256sum") is None:
        pytest.skip("no sha256sum on this machine")
    done = subprocess.run(["sha256sum", "--check", "--strict", SUMS], cwd=saved, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout


def test_nothing_in_it_is_pickled(saved: Path) -> None:
    for file in saved.rglob("*.npy"):
        assert np.load(file, allow_pickle=False).dtype == np.dtype("<f8")
    assert {file.suffix for file in saved.rglob("*") if file.is_file()} <= {".npy", ".json", ".csv", ".md", ""}


def test_the_card_says_what_matters(saved: Path) -> None:
    text = (saved / "card.md").read_text()
    for word in ("lssvm", "simulated-1", "runs left out", "temperature_block_degC", "short-1", "Where it holds"):
        assert word in text


def test_every_changed_byte_is_found(saved: Path, tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    for file in [path for path in saved.rglob("*") if path.is_file()]:
        copy = Path(shutil.copytree(saved, tmp_path / "copy"))
        target = copy / file.relative_to(saved)
        content = bytearray(target.read_bytes())
        content[int(rng.integers(len(content)))] ^= 0x20
        target.write_bytes(content)
        with pytest.raises(rlg.InputError):
            rlg.load(copy)
        shutil.rmtree(copy)


def test_every_missing_file_is_found(saved: Path, tmp_path: Path) -> None:
    for file in [path for path in saved.rglob("*") if path.is_file()]:
        copy = Path(shutil.copytree(saved, tmp_path / "copy"))
        (copy / file.relative_to(saved)).unlink()
        with pytest.raises(rlg.InputError):
            rlg.load(copy)
        shutil.rmtree(copy)


def test_a_changed_byte_is_named(copy: Path) -> None:
    with (copy / "arrays" / "model_alpha_.npy").open("r+b") as stream:
        stream.seek(-1, 2)
        stream.write(b"\x00" if stream.read(1) != b"\x00" else b"\x01")
    with pytest.raises(rlg.InputError, match=r"arrays/model_alpha_\.npy has changed since it was written"):
        rlg.load(copy)


def test_an_added_array_is_found(copy: Path) -> None:
    np.save(copy / "arrays" / "more.npy", np.ones(3))
    with pytest.raises(rlg.InputError, match="not in SHA256SUMS"):
        rlg.load(copy)


def change(copy: Path, **changes: object) -> None:
    manifest = json.loads((copy / MANIFEST).read_text())
    (copy / MANIFEST).write_text(json.dumps(manifest | changes))
    reseal(copy)


@pytest.mark.parametrize(
    "changes",
    [
        {"schema": "rlgcomp.model/0"},
        {"schema": None},
        {"model": {"name": "magic"}},
        {"model": {"name": "lssvm", "parameters": {"c": "x"}, "numbers": {}}},
        {"features": [{"kind": "eval", "code": "1"}]},
        {"features": []},
        {"output": {}},
        {"arrays": {"../../secret": [1]}},
        {"arrays": {"mean": [10**12]}},
        {"arrays": {}},
        {"averaging_s": "long"},
        {"runs": None},
        {"selection": 3},
    ],
)
def test_a_resealed_but_wrong_manifest_is_refused(copy: Path, changes: dict[str, object]) -> None:
    change(copy, **changes)
    with pytest.raises(rlg.InputError):
        rlg.load(copy)


@pytest.mark.parametrize(
    ("name", "values", "message"),
    [
        ("model_alpha_", np.nan, "not finite"),
        ("scale", np.inf, "not finite"),
        ("model_alpha_", 1.0, "golden vectors"),
        ("mean", 1e3, "golden vectors"),
    ],
)
def test_resealed_but_wrong_numbers_are_refused(copy: Path, name: str, values: float, message: str) -> None:
    path = copy / "arrays" / f"{name}.npy"
    np.save(path, np.full_like(np.load(path), values))
    reseal(copy)
    with pytest.raises(rlg.InputError, match=message):
        rlg.load(copy)


def test_a_header_that_declares_a_huge_array_is_refused(copy: Path) -> None:
    path = copy / "arrays" / "mean.npy"
    header = path.read_bytes()
    path.write_bytes(header.replace(b"(11,)", b"(10**12,)").replace(b"'shape': (", b"'shape': (9999999999,"))
    reseal(copy)
    with pytest.raises(rlg.InputError):
        rlg.load(copy)


def test_pickled_arrays_are_refused(copy: Path) -> None:
    np.save(copy / "arrays" / "mean.npy", np.array([{"a": 1}], dtype=object), allow_pickle=True)
    reseal(copy)
    with pytest.raises(rlg.InputError, match="not readable"):
        rlg.load(copy)


@pytest.mark.parametrize("line", ["0" * 64 + "  ../outside", "0" * 64 + "  /etc/passwd", "nonsense", "0" * 64 + "  a\\b"])
def test_paths_that_lead_out_are_refused(copy: Path, line: str) -> None:
    with (copy / SUMS).open("a") as stream:
        stream.write(line + "\n")
    with pytest.raises(rlg.InputError, match="no file of a model"):
        rlg.load(copy)


def test_links_are_refused(copy: Path, tmp_path: Path) -> None:
    (copy / "arrays" / "mean.npy").rename(tmp_path / "elsewhere.npy")
    (copy / "arrays" / "mean.npy").symlink_to(tmp_path / "elsewhere.npy")
    with pytest.raises(rlg.InputError, match="is missing"):
        rlg.load(copy)


def test_what_is_no_model_is_refused(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("x")
    for path, message in (
        (tmp_path / "absent", "does not exist"),
        (tmp_path / "file", "a model is a folder"),
        (tmp_path, "no readable SHA256SUMS"),
    ):
        with pytest.raises(rlg.InputError, match=message):
            rlg.load(path)


def test_a_folder_of_something_else_is_not_overwritten(trained: rlg.Compensator, tmp_path: Path) -> None:
    (tmp_path / "thesis.tex").write_text("years of work")
    with pytest.raises(rlg.InputError, match="left untouched"):
        trained.save(tmp_path)
    assert (tmp_path / "thesis.tex").read_text() == "years of work"


def test_a_model_may_be_replaced_and_a_failure_leaves_the_old_one(
    trained: rlg.Compensator, copy: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = identity(copy)
    monkeypatch.setattr("rlgcomp.compensation.artefact.card", lambda *args: (_ for _ in ()).throw(OSError("disk full")))
    with pytest.raises(OSError, match="disk full"):
        trained.save(copy)
    assert identity(copy) == before
    assert [item.name for item in copy.parent.iterdir()] == ["model"]
    monkeypatch.undo()
    trained.save(copy)
    rlg.load(copy)


MODELS_KEPT = sorted(path.parent for path in (Path(__file__).parents[1] / "models").glob("*/manifest.json"))


@pytest.mark.parametrize("path", MODELS_KEPT, ids=lambda path: path.name)
def test_every_model_kept_still_loads_and_compensates(path: Path) -> None:
    model = rlg.load(path)  # its golden vectors come out again
    evaluation = rlg.evaluate(model, [rlg.simulated_unit(1).simulate("reversed", seed=3, step_s=5.0)], compare=False)
    assert evaluation.residual_std_deg_h < 1.15 * evaluation.runs[0].noise_floor_deg_h


def test_there_are_models_kept() -> None:
    assert MODELS_KEPT
