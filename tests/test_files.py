"""Writing whole or not at all, wherever a user points it; reading what a float cannot hold, and what is no plain data."""

from __future__ import annotations

import datetime
import json
import math
from collections.abc import Callable
from pathlib import Path

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from rlgcomp.errors import InputError
from rlgcomp.files import from_json, from_yaml, require_folder, to_json, whole_file, whole_folder


def everything(folder: Path) -> set[str]:
    return {str(path.relative_to(folder)) for path in folder.rglob("*")}


def test_missing_parents_of_a_folder_are_made_and_go_again_where_the_work_fails(tmp_path: Path) -> None:
    with whole_folder(tmp_path / "a" / "b", writes=("mine",)) as folder:
        (folder / "mine").write_text("1")
    with pytest.raises(ZeroDivisionError), whole_folder(tmp_path / "a" / "c" / "d", writes=("mine",)) as folder:
        (folder / "mine").write_text(str(1 / 0))
    assert everything(tmp_path) == {"a", "a/b", "a/b/mine"}


@pytest.mark.parametrize("target", ["gone", "empty", "made"])
def test_what_a_link_points_to_is_written(tmp_path: Path, target: str) -> None:
    (tmp_path / "empty").mkdir()
    (tmp_path / "made").mkdir()
    (tmp_path / "made" / "mine").write_text("0")
    (tmp_path / "link").symlink_to(tmp_path / target)
    with whole_folder(tmp_path / "link", writes=("mine",)) as folder:
        (folder / "mine").write_text("1")
    assert (tmp_path / "link").is_symlink()
    assert (tmp_path / target / "mine").read_text() == "1"
    assert not [name for name in everything(tmp_path) if name.startswith(".")]


def test_what_an_earlier_run_wrote_is_replaced(tmp_path: Path) -> None:
    for runs in ("ab", "b"):
        with whole_folder(tmp_path / "out", writes=("mine", "[[]*.csv", "arrays/*.npy")) as folder:
            (folder / "arrays").mkdir()
            for name in ("mine", *(f"[{run}.csv" for run in runs), "arrays/x.npy"):
                (folder / name).write_text(runs)
    assert everything(tmp_path / "out") == {"mine", "[b.csv", "arrays", "arrays/x.npy"}


@pytest.mark.parametrize("name", ["notes.txt", "arrays/notes.txt", "sub/mine"])
def test_what_is_put_in_during_the_work_is_kept(tmp_path: Path, name: str) -> None:
    (tmp_path / "out" / "arrays").mkdir(parents=True)
    (tmp_path / "out" / "mine").write_text("0")

    def work() -> None:
        with whole_folder(tmp_path / "out", writes=("mine", "arrays/*.npy")) as folder:
            (folder / "mine").write_text("1")
            (tmp_path / "out" / name).parent.mkdir(exist_ok=True)
            (tmp_path / "out" / name).write_text("mine")

    with pytest.raises(InputError, match="would be lost") as raised:
        work()
    assert (tmp_path / "out" / name).read_text() == "mine"
    assert (tmp_path / "out" / "mine").read_text() == "0"
    (kept,) = (path for path in tmp_path.iterdir() if path.name != "out")  # nor is the work
    assert f"what was made lies in {kept}" in str(raised.value)
    assert (kept / "mine").read_text() == "1"


def test_many_foreign_names_are_told_in_short(tmp_path: Path) -> None:
    for k in range(9):
        (tmp_path / f"{k}.txt").touch()
    (tmp_path / "mine").touch()
    with pytest.raises(InputError, match=r"holds 0\.txt, 1\.txt, 2\.txt, 3\.txt, 4\.txt and 4 more, which"):
        require_folder(tmp_path, writes=("mine",))


def _full(folder: Path) -> Path:
    (folder / "full").mkdir()
    (folder / "full" / "theirs").write_text("1")
    return folder / "full"


def _file(folder: Path) -> Path:
    (folder / "file").write_text("1")
    return folder / "file"


def _here(folder: Path) -> Path:
    (folder / "here").mkdir()
    return folder / "here"


def _with_notes(folder: Path) -> Path:
    for name in ("mine", "notes.txt", "c/code.c", "pictures/a.png", "pictures/b.txt"):
        (folder / "made" / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / "made" / name).write_text("1")
    return folder / "made"


REFUSED: dict[str, tuple[Callable[[Path], Path | str], str]] = {
    "holds something else": (_full, "holds no mine, so it is left untouched"),
    "holds something else too": (_with_notes, r"holds c, notes\.txt, pictures/b\.txt, which an earlier run did not write"),
    "is a file": (_file, "holds no mine, so it is left untouched"),
    "below a file": (lambda folder: _file(folder) / "out", "file is no folder"),
    "name too long": (lambda folder: folder / ("x" * 300), "too long"),
    "the folder one is in": (lambda folder: (_here(folder), ".")[1], "the folder you are in"),
}


@pytest.mark.parametrize(("place", "message"), REFUSED.values(), ids=REFUSED)
def test_a_place_for_a_folder_is_refused_before_the_work(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, place: Callable[[Path], Path | str], message: str
) -> None:
    path = place(tmp_path)
    if path == ".":
        monkeypatch.chdir(tmp_path / "here")
    before = everything(tmp_path)
    with pytest.raises(InputError, match=message):
        require_folder(path, writes=("mine", "pictures/*.png"))
    with pytest.raises(InputError, match=message), whole_folder(path, writes=("mine", "pictures/*.png")):
        pass
    assert everything(tmp_path) == before


@pytest.mark.parametrize(("name", "message"), [("absent/file", "create it first"), ("x" * 300, "too long"), (".", "is a folder")])
def test_a_place_for_a_file_is_refused(tmp_path: Path, name: str, message: str) -> None:
    with pytest.raises(InputError, match=message), whole_file(tmp_path / name):
        pass
    assert not everything(tmp_path)


PLAIN = st.recursive(
    st.none() | st.booleans() | st.integers(-(10**298), 10**298) | st.floats(allow_nan=False, allow_infinity=False) | st.text(),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=5), inner, max_size=3),
    max_leaves=8,
)


@given(PLAIN)
def test_json_comes_back_as_it_was(value: object) -> None:
    assert from_json(to_json(value)) == value
    assert from_json(to_json(value).encode()) == value


@given(PLAIN)
def test_yaml_is_read_as_pyyaml_reads_it(value: object) -> None:
    text = yaml.safe_dump(value)
    assert from_yaml(text) == yaml.safe_load(text)


@pytest.mark.parametrize("text", ["6e-06", "1e+05", "-2.5e-3", ".5e+1", "1E-9"])
def test_numbers_are_read_as_python_writes_them(text: str) -> None:
    assert from_yaml(f"value: {text}") == {"value": float(text)}
    assert from_yaml("unit: 12E4") == {"unit": "12E4"}  # a serial number


@pytest.mark.parametrize("digits", [301, 400, 5000])
def test_a_number_too_large_for_a_float_is_infinite(digits: int) -> None:
    text = "9" * digits
    assert from_json(f'{{"a": {text}}}') == from_yaml(f"a: {text}") == {"a": math.inf}
    assert from_json(f"[-{text}]") == from_yaml(f"- -{text}") == [-math.inf]


@pytest.mark.parametrize("text", ["a: [", "2026-99-99", "!!python/object:os.system {}", "a: &x [*x", "[" * 3000, "\x00"])
def test_text_that_is_no_plain_data_is_a_value_error(text: str) -> None:
    with pytest.raises(ValueError, match=r"."):
        from_yaml(text)


@pytest.mark.parametrize("text", ["{", "[" * 100_000, "nil", ""])
def test_text_that_is_no_json_is_a_value_error(text: str) -> None:
    with pytest.raises(ValueError, match=r"."):
        from_json(text)
    with pytest.raises(json.JSONDecodeError):
        from_json("{'a': 1}")


def test_dates_are_written_as_iso_text() -> None:
    value = {"day": datetime.date(2024, 3, 1), "time": [datetime.datetime(2024, 3, 1, 10, 30)]}
    assert from_json(to_json(value)) == {"day": "2024-03-01", "time": ["2024-03-01T10:30:00"]}
