"""Run times of the package and of its peers: `python -m experiments.speed`."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import typer

from experiments.speed import chosen, growth, measure
from experiments.speed.against import compare
from experiments.speed.machine import machine
from experiments.speed.measure import PATIENCE_S, Measured, Row, failed
from experiments.speed.page import markdown, require_page, row_of, shortfalls, write_page
from rlgcomp.cli.base import AsJson, progress
from rlgcomp.cli.ending import BAD_INPUT, notify
from rlgcomp.cli.show import show_json, show_table
from rlgcomp.errors import InputError
from rlgcomp.files import require_writable, write_json

application = typer.Typer(add_completion=False, pretty_exceptions_enable=False, rich_markup_mode="markdown")


@application.command()
def speed(
    only: Annotated[
        list[str] | None,
        typer.Option(
            "--only",
            metavar="ROW",
            help="Rows whose names begin with this; may be repeated. By default all but the long ones, diagnose-long and "
            "diagnose-90-days.",
        ),
    ] = None,
    quick: Annotated[bool, typer.Option("--quick", help="Small data: checks agreement; goals are not judged.")] = False,
    repeats: Annotated[int, typer.Option(min=1, help="Paired repeats a peer, fewer where they would take too long.")] = 5,
    patience_s: Annotated[
        float, typer.Option("--patience", min=0.0, metavar="S", help="Time in s for all repeats of one side.")
    ] = PATIENCE_S,
    grows: Annotated[
        bool, typer.Option("--growth", help="Exponent of our processor time between small and full data, instead of peers.")
    ] = False,
    against: Annotated[
        str | None,
        typer.Option("--against", metavar="REV", help="This tree and the package of another revision in turn, instead of peers."),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option("--out", "-o", metavar="FILE.json", help="JSON file to write besides the table, anew after each row."),
    ] = None,
    page: Annotated[
        Path | None,
        typer.Option(
            "--page",
            metavar="FILE.md",
            help="Markdown file to write besides the table, anew after each row: between two marks where it exists.",
        ),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Measure run times of rlgcomp and of its peers in the same run, and the agreement of their results.

    The ratio is the median over paired repeats of the peer's time divided by ours. Rows that miss a goal, differ from their peer or
    fail are printed first. `pip install 'rlgcomp[bench]'` installs the peers; the note of a row names a peer that is not installed.

    Example: `python -m experiments.speed --only allan --only bouc --out bench.json`

    Example: `python -m experiments.speed --page docs/performance.md --out peers.json`

    Example: `python -m experiments.speed --only diagnose-long --growth --repeats 1`

    Example: `python -m experiments.speed --only calibrate --against HEAD~20 --repeats 7`
    """
    os.environ.pop("PYTHONDONTWRITEBYTECODE", None)  # a command is timed as its user starts it the second time, compiled by then
    if out is not None:
        require_writable(out)
    if page is not None:
        require_page(page)
    rows = chosen(only)
    if grows:
        _show_growth(rows, repeats, out, as_json)
        return
    if against is not None:
        _compare(against, [row.name for row in rows], repeats, quick, out, as_json)
        return
    command = " ".join(["python -m experiments.speed", *(f"--only {name}" for name in only or []), *(["--quick"] if quick else [])])
    on, measured = machine(), list[Measured]()
    with progress("measuring", len(rows)) as advance:
        for done, row in enumerate(rows, start=1):
            measured += _measured(row, quick, repeats, patience_s)
            result = {"machine": on | {"load at the end": machine()["load"]}, "quick": quick}
            result["rows"] = [one.to_mapping() for one in measured]
            if out is not None:
                write_json(out, result)
            if page is not None:
                write_page(page, markdown(measured, result["machine"], command))
            advance(done, len(rows))
    if as_json:
        show_json(result)
    else:
        missing = shortfalls(measured)
        if missing:
            show_table("Not reached", missing)
        show_table("Measured against peers" + (" (small data: no goal is judged)" * quick), [row_of(one) for one in measured])
        notify(", ".join(f"{key} {value}" for key, value in result["machine"].items()))
    if any(one.failed for one in measured):
        raise InputError("rows failed: " + ", ".join(one.row for one in measured if one.failed))


def _measured(row: Row, quick: bool, repeats: int, patience_s: float) -> list[Measured]:
    """A row against its peers; an error is its result, so that a page of an hour is not lost by one row."""
    try:
        return measure(row, quick=quick, repeats=repeats, patience_s=patience_s)
    except Exception as error:  # noqa: BLE001
        return [failed(row, error)]


def _show_growth(rows: Sequence[Row], repeats: int, out: Path | None, as_json: bool) -> None:
    exponents = [one for one in (growth(row, repeats) for row in rows) if one is not None]
    if out is not None:
        write_json(out, {"machine": machine(), "growth": exponents})
    if as_json:
        show_json(exponents)
    else:
        show_table("Processor time as a power of n", [_grown(one) for one in exponents])


def _compare(revision: str, names: list[str], pairs: int, quick: bool, out: Path | None, as_json: bool) -> None:
    compared = []
    with progress("measuring", len(names)) as advance:
        for done, one in enumerate(compare(revision, names, pairs=pairs, quick=quick), start=1):
            compared.append(one)
            advance(done, len(names))
    if out is not None:
        write_json(out, {"machine": machine(), "against": revision, "rows": compared})
    if as_json:
        show_json(compared)
    else:
        show_table(f"Time at {revision} over that of this tree: median (least to greatest)", [_pairs(one) for one in compared])


def _grown(one: dict[str, Any]) -> dict[str, Any]:
    grown = {
        "row": one["row"],
        "n": ", ".join(map(str, one["n"])),
        "cpu s": ", ".join(f"{seconds:.3g}" for seconds in one["cpu_s"]),
        "exponent": f"{one['exponent']:.2f}",
    }
    if len(one["n"]) > 2:
        grown["last exponent"] = f"{one['last_exponent']:.2f}"
    return grown | ({"MiB": ", ".join(f"{peak:.0f}" for peak in one["MiB"])} if one["MiB"] else {})


def _pairs(one: dict[str, Any]) -> dict[str, Any]:
    texts = {
        label: f"{one[key]['median']:.3g} ({one[key]['least']:.3g} to {one[key]['greatest']:.3g})"
        for label, key in (("wall clock", "wall"), ("processor time", "cpu"))
    }
    return {"row": one["row"], "pairs": one["pairs"], **texts}


def main(arguments: Sequence[str] | None = None) -> None:
    """The command line; bad input ends it with exit code 2 and one message."""
    try:
        application(arguments, prog_name="python -m experiments.speed")
    except InputError as error:
        notify(f"error: {error}")
        raise SystemExit(BAD_INPUT) from None


if __name__ == "__main__":
    main()
