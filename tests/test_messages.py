"""Messages: every code that is used has a text, every text is used, and its data are what the text asks for."""

from __future__ import annotations

import ast
import functools
import inspect
import string
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import rlgcomp
from rlgcomp.report import messages
from rlgcomp.report.messages import CATALOGUE, ROOMS, Message, message

PACKAGE = Path(rlgcomp.__file__).parent


@functools.cache
def _calls() -> list[tuple[str, set[str] | None]]:
    """Code and names of data of every call of `message`; None where data are handed on as ``**data``."""
    found = []
    for path in PACKAGE.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "message":
                assert isinstance(node.args[0], ast.Constant), f"{path}:{node.lineno}: a code is written out"
                names = {keyword.arg for keyword in node.keywords}
                found.append((node.args[0].value, None if None in names else names))
    return found


def _asked(text: str | Callable[..., str]) -> tuple[set[str], set[str]]:
    """Data that a text needs, and all that it takes."""
    if isinstance(text, str):
        fields = {name.partition(".")[0].partition("[")[0] for _, name, _, _ in string.Formatter().parse(text) if name}
        return fields, fields
    parameters = inspect.signature(text).parameters.values()
    return {p.name for p in parameters if p.default is p.empty}, {p.name for p in parameters}


def test_every_code_has_a_text_and_every_text_is_used() -> None:
    assert {code for code, _ in _calls()} == set(CATALOGUE)


def test_data_are_what_the_text_asks_for() -> None:
    for code, names in _calls():
        needed, taken = _asked(CATALOGUE[code])
        if names is not None:
            assert needed <= names, code
            assert isinstance(CATALOGUE[code], str) or names <= taken, code


def test_a_code_has_one_text() -> None:
    for room in ROOMS:
        assert not [name for name in getattr(room, "TEXTS", {}) if hasattr(room, name)]


def test_a_message_is_plain_data_and_comes_back(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(messages.CATALOGUE, "noise.example", "{runs} runs differ by {ratio:.1f}")
    made = message("noise.example", runs=np.int64(3), ratio=np.float64(1.25))
    assert str(made) == made.text == "3 runs differ by 1.2"
    assert made.to_mapping() == {"code": "noise.example", "data": {"runs": 3, "ratio": 1.25}, "text": "3 runs differ by 1.2"}
    assert type(made.data["ratio"]) is float
    assert Message.from_mapping(made.to_mapping()) == made
    with pytest.raises(TypeError, match="code, data and text"):
        Message.from_mapping({"code": "noise.example"})
