"""The published tables of the experiments, read from `../shared`, and tables in markdown."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import pandas as pd

FOLDER = Path(__file__).resolve().parents[2] / "shared" / "data" / "published"


def published(name: str) -> pd.DataFrame:
    """A published table by the name of its file; ends the experiment with a message where it is absent."""
    path = FOLDER / f"{name}.csv"
    if not path.is_file():
        raise SystemExit(f"{path} is not there: the published tables are kept beside the project, in ../shared/data/published")
    return pd.read_csv(path)


def show_table(title: str, rows: Sequence[Mapping[str, object]]) -> None:
    """Print rows as a markdown table under a heading."""
    print(f"## {title}\n")
    header = list(rows[0])
    print("| " + " | ".join(header) + " |")
    print("|" + "---|" * len(header))
    for row in rows:
        print("| " + " | ".join(str(row[column]) for column in header) + " |")
    print()


def show_frame(title: str, table: pd.DataFrame) -> None:
    """Print a frame, its index first, as a markdown table under a heading."""
    rows = [
        {"": name, **dict(zip(table.columns, map(_cell, row), strict=True))}
        for name, row in zip(table.index, table.to_numpy(), strict=True)
    ]
    show_table(title, rows)


def _cell(value: object) -> str:
    return f"{value:.5g}" if isinstance(value, float) else str(value)


def show_list(title: str, sentences: Sequence[str]) -> None:
    """Print sentences as a markdown list under a heading."""
    print(f"## {title}\n")
    for sentence in sentences:
        print(f"- {sentence}")
    print()
