"""The artefact: it comes back bit for bit, and anything changed in it is refused with one message."""

from __future__ import annotations

import dataclasses
import json
import logging
import os
import shutil
import subprocess
import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import rlgcomp as rlg
from rlgcomp.compensation.artefact import MANIFEST, SUMS, identity
from rlgcomp.compensation.models import MODELS
from rlgcomp.files import sha256
from rlgcomp.scratch import PUBLISHED


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
    assert again.pipeline_ == trained.pipeline_
    assert again.selection_.best == trained.selection_.best
    assert len(again.training_) == 2


def test_a_model_whose_publication_was_killed_is_finished_by_its_reader(saved: Path, tmp_path: Path) -> None:
    """Between the two renames of a system that exchanges no names, the model's place is empty."""
    (tmp_path / f"{PUBLISHED}x").mkdir()
    shutil.copytree(saved, tmp_path / f"{PUBLISHED}x" / "model")
    rlg.load(tmp_path / "model")
    assert [path.name for path in tmp_path.iterdir()] == ["model"]


def test_saving_what_was_loaded_gives_the_same_numbers(saved: Path, tmp_path: Path) -> None:
    rlg.load(saved).save(tmp_path / "again")
    for file in (saved / "arrays").iterdir():
        assert (tmp_path / "again" / "arrays" / file.name).read_bytes() == file.read_bytes()


@pytest.mark.parametrize("name", [name for name in MODELS if name not in ("kernels", "sequence")])
def test_every_model_comes_back(short_runs: list[rlg.Recording], tmp_path: Path, name: str) -> None:
    model = rlg.Compensator(MODELS[name].make(), features="temperature,temperature_rate").fit(short_runs[:2])
    model.save(tmp_path / "model")
    assert rlg.load(tmp_path / "model").predict(short_runs[2]).equals(model.predict(short_runs[2]))


@pytest.mark.needs("torch")
def test_the_sequence_model_comes_back_without_torch(
    short_runs: list[rlg.Recording], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
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


def test_every_changed_byte_is_refused(saved: Path, tmp_path: Path) -> None:
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


def test_every_missing_file_is_refused(saved: Path, tmp_path: Path) -> None:
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


def test_an_added_array_is_refused(copy: Path) -> None:
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
        {"runs": []},
        {"runs": [{"run": "a", "hours": 1.0}]},
        {"selection": 3},
        {"selection": {"best": {}, "rmse": "nan"}},
        {"interval": None},
        {"interval": {"inside_deg_h": 1e308, "per_span_deg_h": 1e308, "coverage": 0.9, "runs": 2}},
        {"inputs": ["a"]},
        {"averaging_s": "nan"},
        {"averaging_s": True},
        {"averaging_s": 10**400},
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
    for declared in (b"(9999999999999,), }", b"(10**12,), }", b"(11,), 'x': 0}", b"((((11,)))), }"):
        path.write_bytes(header.replace(b"(11,), }", declared))
        reseal(copy)
        with pytest.raises(rlg.InputError, match=r"not readable|declares the shape"):
            rlg.load(copy)


def test_pickled_arrays_are_refused(copy: Path) -> None:
    np.save(copy / "arrays" / "mean.npy", np.array([{"a": 1}], dtype=object), allow_pickle=True)
    reseal(copy)
    with pytest.raises(rlg.InputError, match="not readable"):
        rlg.load(copy)


@pytest.mark.parametrize(
    "line",
    [
        "0" * 64 + "  ../outside",
        "0" * 64 + "  /etc/passwd",
        "nonsense",
        "0" * 64 + "  a\\b",
        "0" * 64 + "  arrays/../../outside.npy",
        "0" * 64 + "  code.py",
        "0" * 64 + "  arrays/mean.npy",  # a second time
        "0" * 63 + "  card.md",
    ],
)
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


def test_a_folder_that_holds_a_model_says_which(saved: Path, tmp_path: Path) -> None:
    shutil.copytree(saved, tmp_path / "unit" / "model")
    with pytest.raises(rlg.InputError, match=f"give {tmp_path / 'unit' / 'model'}$"):
        rlg.load(tmp_path / "unit")


def test_a_folder_of_something_else_is_not_overwritten(trained: rlg.Compensator, tmp_path: Path) -> None:
    (tmp_path / "thesis.tex").write_text("years of work")
    with pytest.raises(rlg.InputError, match="left untouched"):
        trained.save(tmp_path)
    assert (tmp_path / "thesis.tex").read_text() == "years of work"


def test_a_model_may_be_replaced_and_a_failure_leaves_the_old_one(
    trained: rlg.Compensator, copy: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = identity(copy)
    monkeypatch.setattr("numpy.save", lambda *args, **kwargs: (_ for _ in ()).throw(OSError("disk full")))
    with pytest.raises(OSError, match="disk full"):
        trained.save(copy)
    assert identity(copy) == before
    assert [item.name for item in copy.parent.iterdir()] == ["model"]
    monkeypatch.undo()
    trained.save(copy)
    rlg.load(copy)


def test_a_folder_of_arrays_that_is_a_link_is_refused(copy: Path, tmp_path: Path) -> None:
    (copy / "arrays").rename(tmp_path / "elsewhere")
    (copy / "arrays").symlink_to(tmp_path / "elsewhere")
    with pytest.raises(rlg.InputError, match="is missing"):
        rlg.load(copy)


def test_what_is_no_plain_file_is_refused_without_waiting_for_it(copy: Path) -> None:
    (copy / "card.md").unlink()
    os.mkfifo(copy / "card.md")
    with pytest.raises(rlg.InputError, match="is missing"):
        rlg.load(copy)


@pytest.mark.parametrize("name", [MANIFEST, SUMS, "selection.csv", "arrays/mean.npy"])
def test_files_of_absurd_size_are_refused_unread(copy: Path, name: str) -> None:
    with (copy / name).open("r+b") as stream:
        stream.truncate(1 << 36)  # sparse: it takes no room
    with pytest.raises(rlg.InputError, match="larger than any model"):
        rlg.load(copy)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[" * 100_000 + "]" * 100_000, "nested deeper"),
        ('{"schema": ' + "[" * 40 + "]" * 40 + "}", "nested deeper"),
        ('{"schema": "rlgcomp.model/2", "schema": "rlgcomp.model/1"}', "'schema' twice"),
        ('{"schema": NaN}', "not finite"),
        ('{"schema": 1e999}', "not finite"),
        ('{"schema": ' + "9" * 5000 + "}", "not finite"),
        ("[]", "expected an object"),
        ('{"schema": "\\ud800"}', "half of a surrogate pair"),
        ("{", "not readable"),
        ("", "not readable"),
    ],
)
def test_hostile_json_is_refused(copy: Path, text: str, message: str) -> None:
    (copy / MANIFEST).write_text(text)
    reseal(copy)
    with pytest.raises(rlg.InputError, match=message):
        rlg.load(copy)


def places(value: object, path: tuple[object, ...] = ()) -> Iterator[tuple[object, ...]]:
    """Every place in nested plain data."""
    yield path
    items = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, item in items:
        yield from places(item, (*path, key))


WRONG = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(-3, 3),
    st.sampled_from([10**400, -1, 10**9, 1e308, -1e308, 5e-324]),
    st.text(max_size=5),
    st.sampled_from(["nan", "inf", "__import__('os').system('true')", "../../x", "\x1b[2J"]),
    st.lists(st.integers(-1, 2), max_size=3),
    st.dictionaries(st.text(max_size=3), st.integers(), max_size=2),
)


@pytest.mark.parametrize("form", ["lssvm", "cubic", "kernel-ridge"])
@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_anything_put_anywhere_in_the_manifest_is_refused_or_harmless(
    short_runs: list[rlg.Recording], tmp_path_factory: pytest.TempPathFactory, form: str, data: st.DataObject
) -> None:
    """Resealed, so only what the reader checks stands in the way: an `InputError`, or a model that gives its golden vectors."""
    saved, copy = (tmp_path_factory.getbasetemp() / f"hostile-{form}{end}" for end in ("", "-copy"))
    if not saved.exists():
        rlg.Compensator(MODELS[form].make(), features="temperature,temperature_rate").fit(short_runs[:2]).save(saved)
        shutil.copytree(saved, copy)  # its other files are those of every example
    manifest = json.loads((saved / MANIFEST).read_text())
    *way, last = data.draw(st.sampled_from([place for place in places(manifest) if place]))
    target = manifest
    for key in way:
        target = target[key]
    if data.draw(st.booleans()):
        target[last] = data.draw(WRONG)
    else:
        del target[last]
    (copy / MANIFEST).write_text(json.dumps(manifest))
    reseal(copy)
    try:
        model = rlg.load(copy)
    except rlg.InputError:
        return
    predicted = model.predict(short_runs[2])
    assert np.isfinite(predicted["bias_deg_h"]).all()
    assert (predicted["half_width_deg_h"] >= 0.0).all()


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_arrays_of_other_shapes_or_bytes_are_refused(saved: Path, data: st.DataObject) -> None:
    with tempfile.TemporaryDirectory() as scratch:
        copy = Path(shutil.copytree(saved, Path(scratch) / "model"))
        path = data.draw(st.sampled_from(sorted((copy / "arrays").iterdir())))
        if data.draw(st.booleans()):
            values = np.load(path)
            other = data.draw(st.sampled_from([values[:-1], values[None], values.ravel()[:1], np.zeros(0), values.astype("<f4")]))
            np.save(path, other)
            manifest = json.loads((copy / MANIFEST).read_text())
            manifest["arrays"][path.stem] = list(other.shape)
            (copy / MANIFEST).write_text(json.dumps(manifest))
        else:
            content = bytearray(path.read_bytes())
            place = data.draw(st.integers(0, 127))
            content[place] = (content[place] + data.draw(st.integers(1, 255))) % 256
            path.write_bytes(content)
        reseal(copy)
        with pytest.raises(rlg.InputError):
            rlg.load(copy)


def test_a_model_of_schema_1_is_migrated(
    saved: Path, copy: Path, trained: rlg.Compensator, caplog: pytest.LogCaptureFixture
) -> None:
    """It had no interval: the one calibrated from its training rows is that of the fit, and saving it makes schema 2 of it."""
    manifest = json.loads((copy / MANIFEST).read_text())
    del manifest["interval"], manifest["arrays"]["golden_half_width_deg_h"]
    (copy / "arrays" / "golden_half_width_deg_h.npy").unlink()
    (copy / MANIFEST).write_text(json.dumps(manifest | {"schema": "rlgcomp.model/1"}))
    reseal(copy)
    with caplog.at_level(logging.INFO):
        old = rlg.load(copy)
    assert "calibrated from the training rows" in caplog.text
    assert old.schema_ == "rlgcomp.model/1"
    assert old.interval_.inside_deg_h == pytest.approx(trained.interval_.inside_deg_h, rel=1e-9)
    assert old.interval_ == dataclasses.replace(trained.interval_, inside_deg_h=old.interval_.inside_deg_h)
    old.save(copy)
    assert rlg.load(copy).schema_ == json.loads((saved / MANIFEST).read_text())["schema"] == "rlgcomp.model/2"


def test_a_schema_to_come_is_refused_with_what_to_do(copy: Path) -> None:
    change(copy, schema="rlgcomp.model/3")
    with pytest.raises(rlg.InputError, match=r"reads rlgcomp.model/2 and rlgcomp.model/1; train the model again"):
        rlg.load(copy)


SAVED_MODELS = sorted(path.parent for path in (Path(__file__).parents[1] / "models").glob("*/manifest.json"))


@pytest.mark.parametrize("path", SAVED_MODELS, ids=lambda path: path.name)
def test_every_saved_model_gives_its_golden_vectors(path: Path) -> None:
    model, golden = rlg.load(path), path / "arrays"
    X = np.load(golden / "golden_X.npy")
    assert model.predict_rows(X) == pytest.approx(np.load(golden / "golden_bias_deg_h.npy"), rel=0.0, abs=1e-12)
    assert model.half_widths(X) == pytest.approx(np.load(golden / "golden_half_width_deg_h.npy"), rel=1e-12)
    assert model.scaling_.outside(X).any()
    assert not model.scaling_.outside(X).all()


@pytest.mark.parametrize("path", SAVED_MODELS, ids=lambda path: path.name)
def test_every_saved_model_compensates(path: Path) -> None:
    model = rlg.load(path)
    seed = int(path.name.rsplit("-", 1)[1])
    evaluation = rlg.evaluate(model, [rlg.simulated_unit(seed).simulate("reversed", seed=3, step_s=5.0)], compare=False)
    assert evaluation.residual_std_deg_h < 1.15 * evaluation.runs[0].noise_floor_deg_h


def test_two_kinds_of_model_are_saved_with_card_and_code() -> None:
    assert len({rlg.load(path).specification_.name for path in SAVED_MODELS}) >= 2
    for path in SAVED_MODELS:
        assert (path / "card.md").is_file()
        (header,) = (path / "c").glob("*.h")
        assert f'MODEL_SHA256 "{identity(path)}"' in header.read_text()


def test_a_run_with_a_date_in_its_sidecar_is_trained_on_and_saved(short_runs: list[rlg.Recording], tmp_path: Path) -> None:
    rlg.write(short_runs[0], tmp_path / "run.csv")
    (tmp_path / "run.yaml").write_text("recorded: 2024-03-01\nnotes: second bake, fan off\n")
    model = rlg.Compensator(rlg.CubicLeastSquares(), features="temperature").fit([rlg.read(tmp_path / "run.csv")])
    model.save(tmp_path / "model")
    (run,) = rlg.load(tmp_path / "model").provenance_
    assert run["notes"] == {"notes": "second bake, fan off", "recorded": "2024-03-01"}
