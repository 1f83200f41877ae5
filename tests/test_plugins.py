"""A user's Python file: loaded once, able to import its neighbours, refused with the line at fault."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

import rlgcomp as rlg
from rlgcomp.physics.plugins import load_python


def test_a_file_becomes_a_module_once(tmp_path: Path) -> None:
    file = tmp_path / "mine.py"
    file.write_text("VALUE = 3\n\n\ndef double(x):\n    return 2 * x\n")
    module = load_python(file)
    assert module.double(module.VALUE) == 6
    assert load_python(str(file)) is module
    file.write_text("VALUE = 4\n")
    assert load_python(file).VALUE == 4
    assert not (tmp_path / "__pycache__").exists()


def test_it_may_import_its_neighbours_and_restores_the_path(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "dont_write_bytecode", True)
    (tmp_path / "neighbour_of_mine.py").write_text("K = 5\n")
    (tmp_path / "mine.py").write_text("from neighbour_of_mine import K\n")
    before = list(sys.path)
    assert load_python(tmp_path / "mine.py").K == 5
    assert sys.path == before
    del sys.modules["neighbour_of_mine"]


def test_a_dataclass_with_postponed_annotations_works(tmp_path: Path) -> None:
    text = "from __future__ import annotations\nimport dataclasses\nfrom typing import ClassVar\n\n\n"
    (tmp_path / "mine.py").write_text(
        text + "@dataclasses.dataclass\nclass A:\n    name: ClassVar[str] = 'a'\n    k: float = 1.0\n"
    )
    assert load_python(tmp_path / "mine.py").A().k == 1.0


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (b"x = 1\nif x\n", "line 2: expected ':'"),
        (b"x = 1\n\ny = 1 / 0\n", "line 3: ZeroDivisionError: division by zero"),
        (b"import nothing_of_this_name\n", "line 1: ModuleNotFoundError: No module named 'nothing_of_this_name'"),
        (b"raise SystemExit(3)\n", "line 1: SystemExit: 3"),
        (b"x = '\xff'\n", "mine.py"),
        (b"x = 1\0\n", "mine.py"),
    ],
)
def test_faults_are_reported_with_their_line(tmp_path: Path, text: bytes, message: str) -> None:
    (tmp_path / "mine.py").write_bytes(text)
    loaded = set(sys.modules)
    with pytest.raises(rlg.InputError, match=message):
        load_python(tmp_path / "mine.py")
    assert not [name for name in set(sys.modules) - loaded if name.startswith("rlgcomp_plugin")]


def test_files_that_are_none(tmp_path: Path) -> None:
    with pytest.raises(rlg.InputError, match="does not exist"):
        load_python(tmp_path / "absent.py")
    with pytest.raises(rlg.InputError, match=r"ends in \.py"):
        load_python(tmp_path / "data.csv")
    (tmp_path / "folder.py").mkdir()
    with pytest.raises(rlg.InputError, match="cannot be read"):
        load_python(tmp_path / "folder.py")
