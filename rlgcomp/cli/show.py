"""How results are shown: tables for people, JSON for machines."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import typer

from rlgcomp.cli.ending import printable

if TYPE_CHECKING:
    from rlgcomp.report.messages import Message


def show_text(text: str = "") -> None:
    """Print a line for people on standard output."""
    typer.echo(printable(text))


def show_json(value: Any) -> None:
    """Print a result for machines on standard output; messages in it as code, data and text."""
    from rlgcomp.files import to_json

    text = to_json(_plain(value))
    try:
        text.encode(sys.stdout.encoding or "ascii")
    except UnicodeError:  # a terminal of another encoding: escapes of JSON instead
        import json

        text = json.dumps(json.loads(text), indent=2)
    typer.echo(text)


def show_remarks(remarks: Iterable[Message | str]) -> None:
    """Print remarks as a list on standard output."""
    for remark in remarks:
        show_text(f"- {remark}")


def _plain(value: Any) -> Any:
    from rlgcomp.report.messages import Message

    if isinstance(value, Message):
        return value.to_mapping()
    if isinstance(value, Mapping):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    return value


def show_table(title: str, rows: Sequence[Mapping[str, Any]]) -> None:
    """A table for people, on standard output."""
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text  # a str would be searched for markup, as which names in brackets would pass

    table = Table(header_style="bold", box=None, pad_edge=False)
    columns = list(rows[0]) if rows else []
    for column in columns:
        table.add_column(Text(printable(column)), justify="left" if isinstance(rows[0][column], str) else "right", overflow="fold")
    for row in rows:
        table.add_row(*(Text(_cell(row[column])) for column in columns))
    console = Console(width=None if sys.stdout.isatty() else 160)
    try:
        console.print(Text(printable(title), style="bold"))  # apart from the table, whose width would break it
        console.print(table)
    except SystemExit:  # Rich ends the process where nobody reads
        raise BrokenPipeError from None


def show_evaluation(evaluation: Any) -> None:
    """Print the tables of an evaluation."""
    from rlgcomp.evaluation.evaluation import stability_rows

    digits = {"better by": 2, "after / floor": 3}
    rows = [
        {key: f"{value:.{digits[key]}f}" if key in digits else value for key, value in row.items()}
        for row in stability_rows(evaluation)
    ]
    show_table(evaluation.title, rows)
    if not evaluation.comparison.empty:
        table = evaluation.comparison
        rows = [
            {
                "features": group,
                **{row.model: f"{row.residual_std_deg_h:.5f} ({row.residual_rms_deg_h:.5f})" for row in part.itertuples()},
            }
            for group, part in table.groupby("features", sort=False)
        ]
        show_table("By feature and model, deg/h: bias stability (rms, offset included)", rows)
    rows = [row | {"correlation": f"{row['correlation']:.3f}"} for row in evaluation.correlation.to_dict("records")]
    show_table("Correlation with the gyro", rows)
    show_remarks(evaluation.remarks)


def _cell(value: Any) -> str:
    if isinstance(value, float):
        return (
            f"{value:.5g}"
            if abs(value) >= 1.0 or value == 0.0
            else f"{value:.5f}".rstrip("0").rstrip(".")
            if abs(value) >= 1e-4
            else f"{value:.3g}"
        )
    return printable(str(value))
