"""Messages: remarks and findings of a result, each as a code, its data and a text made from them.

A remark or a finding is made where its cause is detected, by :func:`message` with a code and data; its text stands here, in the
catalogue of its room. Scripts and tests read code and data, people the text. To add one, write its text in the file of its
room: a template of :meth:`str.format`, or a function of the data where words depend on numbers."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
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

Text = str | Callable[..., str]

ROOMS: Final = (recording, noise, simulation, calibration, compensation, evaluation, diagnosis, export, challenge)
CATALOGUE: Final[dict[str, Text]] = {code: text for room in ROOMS for code, text in room.TEXTS.items()}


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
    return Message(code, plain, text.format(**plain) if isinstance(text, str) else text(**plain))


def _plain(value: Any) -> Any:
    """Arrays and NumPy numbers as lists and Python numbers, tuples as lists, messages within messages as mappings."""
    if isinstance(value, (np.ndarray, np.generic)):
        return value.tolist()
    if isinstance(value, Mapping):
        return {str(key): _plain(each) for key, each in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(each) for each in value]
    return value
