"""Mutations of bytes, of tokens in text, of plain data and of tables."""

from __future__ import annotations

import copy
import json
import re
from typing import Any, Final

import numpy as np
import pandas as pd
import yaml

from rlgcomp.files import to_json

NUMBERS: Final = (
    *(
        "1e308",
        "-1e308",
        "1e16",
        "-1e15",
        "1.7976931348623157e308",
        "1e400",
        "-1e400",
        "nan",
        "inf",
        "-inf",
        "-0",
        "-1",
        "0",
        "1e-320",
    ),
    *("9" * 400, "0x10", "1_000", "", "null", "true", "1,5", "--1", "1e", "\u0661\u0662", "2026-99-99", "12:61:00"),
)
VALUES: Final = (
    *(
        None,
        True,
        False,
        0,
        -1,
        1e308,
        -1e308,
        float("inf"),
        float("-inf"),
        float("nan"),
        10**400,
        -(10**25),
        5e-324,
        1e-300,
        2**63,
    ),
    *("", "\x00", "a" * 5000, "nan", "../../etc/passwd", "\x1b[2J", "$x^{", "<script>", "\ud800", "2026-01-01"),
    *([], {}, [[]], [None], {"value": None, "free": True}, {"value": "x", "free": 1}, {"": {}}, [1, 2, 3], {"a": [1, {"b": 2}]}),
)
SIGNS: Final = ("", "x", '"', "'", "NaN", "#", "\t", ";", "\r", "\u2028", "é", "\x00")
NAMES: Final = ("", "time_s", "gyro_deg_h", "x", "\x1b[2J", "$a^{", "gyro_pulses", "a/b", "<script>alert(1)</script>", "é %s {x}")
_TOKEN: Final = re.compile(r"[+-]?\d+\.?\d*(?:[eE][+-]?\d+)?")


def bytes_of(content: bytes, rng: np.random.Generator) -> bytes:
    """Content with some of its bytes changed, removed, repeated, moved or cut off."""
    content = bytearray(content)
    for _ in range(int(rng.integers(1, 6))):
        at = int(rng.integers(0, max(1, len(content)))) if rng.random() < 0.5 else int(min(len(content), rng.exponential(200.0)))
        size = int(rng.choice([1, 1, 2, 4, 8, 64, 1000]))
        kind = rng.integers(0, 8)
        if kind == 0:
            content[at : at + size] = rng.bytes(size)
        elif kind == 1 and at < len(content):
            content[at] ^= 1 << int(rng.integers(0, 8))
        elif kind == 2:
            del content[at : at + size]
        elif kind == 3:
            content[at:at] = content[at : at + size]
        elif kind == 4:
            content[at:at] = rng.bytes(size)
        elif kind == 5:
            content[at : at + size] = bytes(size)
        elif kind == 6:
            content[at : at + size] = b"\xff" * size
        else:
            del content[max(1, at) :]
    return bytes(content)


def tokens_of(text: str, rng: np.random.Generator) -> str:
    """Text with numbers, lines, separators and names changed."""
    for _ in range(int(rng.integers(1, 5))):
        kind = rng.integers(0, 9)
        lines = text.split("\n")
        at = int(rng.integers(0, len(lines))) if rng.random() < 0.7 else 0
        if kind <= 2:
            found = list(_TOKEN.finditer(text))
            if found:
                one = found[int(rng.integers(0, len(found)))]
                text = text[: one.start()] + str(rng.choice(NUMBERS)) + text[one.end() :]
            continue
        if kind == 3:
            lines.insert(at, lines[int(rng.integers(0, len(lines)))])
        elif kind == 4:
            del lines[at]
        elif kind == 5:
            entries = lines[at].split(",")
            entries[int(rng.integers(0, len(entries)))] = str(rng.choice(SIGNS))
            lines[at] = ",".join(entries)
        elif kind == 6:
            entries = lines[at].split(",")
            rng.shuffle(entries)
            lines[at] = ",".join(entries + entries[: int(rng.integers(0, 2))])
        elif kind == 7:
            sign = str(rng.choice([";", "\t", "|", "  ", ",,", "\r\n,"]))
            lines = [line.replace(",", sign) for line in lines]
        else:
            column, value = int(rng.integers(0, 5)), str(rng.choice(NUMBERS))
            rows = [line.split(",") for line in lines]
            for row in rows[1:]:
                if column < len(row):
                    row[column] = value
            lines = [",".join(row) for row in rows]
        text = "\n".join(lines)
    return text


def data_of(value: Any, rng: np.random.Generator) -> Any:
    """Plain data with some of their parts replaced, removed, repeated, renamed or nested."""
    value = copy.deepcopy(value)
    for _ in range(int(rng.integers(1, 4))):
        places = list(_places(value, ()))
        path = places[int(rng.integers(0, len(places)))]
        value = _changed(value, path, rng)
    return value


def _places(value: Any, path: tuple[Any, ...]) -> list[tuple[Any, ...]]:
    inside = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    return [path, *(place for key, item in inside for place in _places(item, (*path, key)))]


def _changed(value: Any, path: tuple[Any, ...], rng: np.random.Generator) -> Any:
    if path:
        value[path[0]] = _changed(value[path[0]], path[1:], rng)
        return value
    kind = rng.integers(0, 6)
    if kind == 0 and isinstance(value, dict) and value:
        del value[list(value)[int(rng.integers(0, len(value)))]]
        return value
    if kind == 1 and isinstance(value, list) and value:
        return value * 2 if rng.random() < 0.5 else value[:-1]
    if kind == 2 and isinstance(value, dict):
        value[str(rng.choice(["", "x", "kind", "columns", "notes", "free", "value", "\x00", "__class__"]))] = _any(rng)
        return value
    if kind == 3:
        for _ in range(int(rng.choice([1, 3, 50, 200]))):
            value = [value] if rng.random() < 0.5 else {"x": value}
        return value
    if kind == 4 and isinstance(value, int | float) and not isinstance(value, bool) and abs(value) < 1e300:
        return value * float(rng.choice([-1.0, 1e3, 1e-3, 1e100, 0.0]))
    return _any(rng)


def _any(rng: np.random.Generator) -> Any:
    return copy.deepcopy(VALUES[int(rng.integers(0, len(VALUES)))])


def mutated_table(table: pd.DataFrame, rng: np.random.Generator) -> pd.DataFrame:
    """A table with values, types, names and rows of some columns changed."""
    for _ in range(int(rng.integers(1, 4))):
        column = str(rng.choice(list(map(str, table.columns))))
        kind = rng.integers(0, 9)
        if column not in table or isinstance(table[column], pd.DataFrame):
            continue
        if kind <= 3:
            rows = rng.random(len(table)) < rng.choice([0.01, 0.3, 1.0])
            value = float(rng.choice([1e308, -1e308, 1e16, np.nan, np.inf, -np.inf, 0.0, -1.0, 1e-320, 1e100, -273.15, 1e6]))
            table = table.assign(**{column: table[column].mask(rows, value)})
        elif kind == 4:
            table = table.assign(**{column: table[column].astype(str)})
        elif kind == 5:
            table = table.assign(**{column: [[1.0, 2.0] for _ in range(len(table))]})
        elif kind == 6:
            table = table.rename(columns={column: str(rng.choice(NAMES))})
        elif kind == 7:
            table = table.assign(**{column: table[column].to_numpy()[::-1]})
        else:
            table = table.iloc[: int(rng.integers(0, 4))]
    return table


def mutated_yaml(value: Any, rng: np.random.Generator) -> bytes:
    """YAML of changed data, or changed YAML."""
    if rng.random() < 0.5:
        try:
            text = yaml.safe_dump(data_of(value, rng), allow_unicode=True)
        except RecursionError:  # too deep for the writer; the reader's own limit is far below
            text = "[" * 500 + "]" * 500
    else:
        text = tokens_of(yaml.safe_dump(value), rng)
        if rng.random() < 0.4:
            tag = str(
                rng.choice(
                    [
                        "!!int",
                        "!!float",
                        "!!bool",
                        "!!timestamp",
                        "!!set",
                        "!!omap",
                        "!!binary",
                        "!!python/name:os.system",
                        "&a",
                        "*a",
                    ]
                )
            )
            text = text.replace(": ", f": {tag} ", int(rng.integers(1, 4)))
    content = text.encode(errors="surrogatepass")
    return bytes_of(content, rng) if rng.random() < 0.3 else content


def mutated_json(value: Any, rng: np.random.Generator) -> bytes:
    """JSON of changed data, or changed JSON."""
    if rng.random() < 0.6:
        content = json.dumps(data_of(value, rng)).encode(errors="surrogatepass")
    else:
        content = tokens_of(to_json(value), rng).encode(errors="surrogatepass")
    return bytes_of(content, rng) if rng.random() < 0.3 else content
