"""Writing whole or not at all, wherever a user points it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from rlgcomp.errors import InputError
from rlgcomp.files import require_folder, whole_file, whole_folder


def everything(folder: Path) -> set[str]:
    return {str(path.relative_to(folder)) for path in folder.rglob("*")}


def test_missing_parents_of_a_folder_are_made_and_go_again_where_the_work_fails(tmp_path: Path) -> None:
    with whole_folder(tmp_path / "a" / "b", ours="mine") as folder:
        (folder / "mine").write_text("1")
    with pytest.raises(ZeroDivisionError), whole_folder(tmp_path / "a" / "c" / "d", ours="mine") as folder:
        (folder / "mine").write_text(str(1 / 0))
    assert everything(tmp_path) == {"a", "a/b", "a/b/mine"}


@pytest.mark.parametrize("target", ["gone", "empty", "made"])
def test_what_a_link_points_to_is_written(tmp_path: Path, target: str) -> None:
    (tmp_path / "empty").mkdir()
    (tmp_path / "made").mkdir()
    (tmp_path / "made" / "mine").write_text("0")
    (tmp_path / "link").symlink_to(tmp_path / target)
    with whole_folder(tmp_path / "link", ours="mine") as folder:
        (folder / "mine").write_text("1")
    assert (tmp_path / "link").is_symlink()
    assert (tmp_path / target / "mine").read_text() == "1"
    assert not [name for name in everything(tmp_path) if name.startswith(".")]


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


REFUSED: dict[str, tuple[Callable[[Path], Path | str], str]] = {
    "holds something else": (_full, "holds no mine, so it is left untouched"),
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
        require_folder(path, ours="mine")
    with pytest.raises(InputError, match=message), whole_folder(path, ours="mine"):
        pass
    assert everything(tmp_path) == before


@pytest.mark.parametrize(("name", "message"), [("absent/file", "create it first"), ("x" * 300, "too long"), (".", "is a folder")])
def test_a_place_for_a_file_is_refused(tmp_path: Path, name: str, message: str) -> None:
    with pytest.raises(InputError, match=message), whole_file(tmp_path / name):
        pass
    assert not everything(tmp_path)
