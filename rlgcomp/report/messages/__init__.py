"""Messages: remarks and findings of a result, each as a code, its data and a text made from them.

A remark or a finding is made where its cause is detected, by :func:`message` with a code and data; its text stands here. Scripts
and tests read code and data, people the text. The text of the code `noise.misfit` is in `noise.py`: a template of
:meth:`str.format` in its `TEXTS`, in which a list stands as "a, b and c", or, where words depend on numbers, the function `misfit`.
"""

from __future__ import annotations

import dataclasses
import inspect
from collections.abc import Callable, Mapping
from types import ModuleType
from typing import Any, Final

import numpy as np

from rlgcomp.report.messages import (
    calibration,
    challenge,
    compensation,
    diagnosis,
    evaluation,
    export,
    noise,
    recording,
    simulation,
)
from rlgcomp.report.messages.wording import listing

Text = str | Callable[..., str]

ROOMS: Final = (recording, noise, simulation, calibration, compensation, evaluation, diagnosis, export, challenge)


def texts_of(room: ModuleType) -> dict[str, Text]:
    """Texts of a room by code: its templates and its public functions."""
    functions = {name: one for name, one in inspect.getmembers(room, inspect.isfunction) if one.__module__ == room.__name__}
    public = {name: one for name, one in functions.items() if not name.startswith("_")}
    prefix = room.__name__.rpartition(".")[2]
    return {f"{prefix}.{name}": text for name, text in (getattr(room, "TEXTS", {}) | public).items()}


CATALOGUE: Final[dict[str, Text]] = {code: text for room in ROOMS for code, text in texts_of(room).items()}


@dataclasses.dataclass(frozen=True)
class Message:
    """A code, its data and the text made from them; `str` of it is the text.

    Parameters
    ----------
    code : str
        The kind of message, for example ``noise.runs_differ``; stable, so that scripts may rely on it.
    data : dict
        The numbers and names of this case: plain Python values, units in the keys.
    text : str
        One or two sentences in plain English.
    """

    code: str
    data: Mapping[str, Any]
    text: str

    def __str__(self) -> str:
        return self.text

    def __hash__(self) -> int:
        return hash((self.code, self.text))

    def to_mapping(self) -> dict[str, Any]:
        """`code`, `data` and `text`, as JSON has them."""
        return {"code": self.code, "data": dict(self.data), "text": self.text}

    @classmethod
    def from_mapping(cls, mapping: Mapping[str, Any]) -> Message:
        """A message as :meth:`to_mapping` gave it. The text is kept as it was written, whatever version wrote it.

        Raises
        ------
        TypeError
            `code` or `text` is no string, or `data` no mapping.
        """
        code, data, text = mapping.get("code"), mapping.get("data"), mapping.get("text")
        if not (isinstance(code, str) and isinstance(data, Mapping) and isinstance(text, str)):
            raise TypeError(f"a message is a mapping of code, data and text; received {dict(mapping)!r}")
        return cls(code, dict(data), text)


def message(code: str, /, **data: Any) -> Message:
    """The message of a code: its text from the catalogue, its data as plain Python values.

    Raises
    ------
    KeyError
        The catalogue has no such code, or its text asks for data that are not given: a fault of this package, never of input.
    """
    plain = {name: _plain(value) for name, value in data.items()}
    text = CATALOGUE[code]
    if not isinstance(text, str):
        return Message(code, plain, text(**plain))
    shown = {name: listing([*map(str, value)]) if isinstance(value, list) else value for name, value in plain.items()}
    return Message(code, plain, text.format(**shown))


def _plain(value: Any) -> Any:
    """Arrays and NumPy numbers as lists and Python numbers, tuples as lists, messages within messages as mappings."""
    if isinstance(value, (np.ndarray, np.generic)):
        return value.tolist()
    if isinstance(value, Mapping):
        return {str(key): _plain(each) for key, each in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(each) for each in value]
    return value
