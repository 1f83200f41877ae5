"""Run times of the package and of its peers: `python -m experiments.speed`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import typer

from experiments.speed import chosen, growth, measure
from experiments.speed.against import compare
from experiments.speed.machine import machine
from experiments.speed.measure import Row
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
        typer.Option("--only", metavar="ROW", help="Rows whose names begin with this; may be repeated. All rows by default."),
    ] = None,
    quick: Annotated[bool, typer.Option("--quick", help="Small data: checks agreement; goals are not judged.")] = False,
    repeats: Annotated[int, typer.Option(min=1, help="Paired repeats a peer, fewer where they would take more than 10 s.")] = 5,
    grows: Annotated[
        bool, typer.Option("--growth", help="Exponent of our processor time between small and full data, instead of peers.")
    ] = False,
    against: Annotated[
        str | None,
        typer.Option("--against", metavar="REV", help="This tree and the package of another revision in turn, instead of peers."),
    ] = None,
    out: Annotated[
        Path | None, typer.Option("--out", "-o", metavar="FILE.json", help="JSON file to write besides the table.")
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Measure run times of rlgcomp and of its peers in the same run, and the agreement of their results.

    The ratio is the median over paired repeats of the peer's time divided by ours. `pip install 'rlgcomp[bench]'` installs the
    peers; the note of a row names a peer that is not installed.

    Example: `python -m experiments.speed --only allan --only bouc --out bench.json`

    Example: `python -m experiments.speed --only calibrate --against HEAD~20 --repeats 7`
    """
    if out is not None:
        require_writable(out)
    rows = chosen(only)
    if grows:
        _show_growth(rows, repeats, out, as_json)
        return
    if against is not None:
        _compare(against, [row.name for row in rows], repeats, quick, out, as_json)
        return
    measured = []
    with progress("measuring", len(rows)) as advance:
        for done, row in enumerate(rows, start=1):
            measured += measure(row, quick=quick, repeats=repeats)
            advance(done, len(rows))
    result = {"machine": machine(), "quick": quick, "rows": [one.to_mapping() for one in measured]}
    if out is not None:
        write_json(out, result)
    if as_json:
        show_json(result)
        return
    show_table("Measured against peers" + (" (small data: no goal is judged)" if quick else ""), [_row(one) for one in measured])
    notify(", ".join(f"{key} {value}" for key, value in result["machine"].items()))  # type: ignore[attr-defined]


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
    (small, full), (few, many) = one["n"], one["cpu_s"]
    return {"row": one["row"], "n": f"{small} to {full}", "cpu s": f"{few:.3g} to {many:.3g}", "exponent": f"{one['exponent']:.2f}"}


def _pairs(one: dict[str, Any]) -> dict[str, Any]:
    texts = {
        label: f"{one[key]['median']:.3g} ({one[key]['least']:.3g} to {one[key]['greatest']:.3g})"
        for label, key in (("wall clock", "wall"), ("processor time", "cpu"))
    }
    return {"row": one["row"], "pairs": one["pairs"], **texts}


def _row(one: Any) -> dict[str, Any]:
    memory = "" if one.ours_MiB is None else f"{one.ours_MiB:.0f}" + ("" if one.peer_MiB is None else f" / {one.peer_MiB:.0f}")
    return {
        "row": one.row,
        "size": one.size,
        "threads": one.threads,
        "ours s": f"{one.ours_s:.3g} (cpu {one.ours_cpu_s:.3g})",
        "peer": one.peer or "none",
        "peer s": "" if one.peer_s is None else f"{one.peer_s:.3g}",
        "ratio": "" if one.ratio is None else f"{one.ratio:.3g} (cpu {one.ratio_cpu:.3g})",
        "goal": one.goal,
        "reached": {True: "yes", False: "no", None: ""}[one.reached],
        "agreement": "" if one.agrees is None else f"{one.disagreement:.1e} {'ok' if one.agrees else 'NOT ok'}",
        "MiB": memory,
        "note": one.note,
    }


def main(arguments: Sequence[str] | None = None) -> None:
    """The command line; bad input ends it with exit code 2 and one message."""
    try:
        application(arguments, prog_name="python -m experiments.speed")
    except InputError as error:
        notify(f"error: {error}")
        raise SystemExit(BAD_INPUT) from None


if __name__ == "__main__":
    main()
