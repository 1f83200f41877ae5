"""Work of experiments: the pieces on several workers, and a file of finished rows from which a killed experiment resumes.

A piece has a key and gives one row of plain JSON data, so that a row read from the file equals the row computed. The file does not
record the version of the code: resume with the same code.
"""

from __future__ import annotations

import argparse
import contextlib
import functools
import json
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Self, TypeVar

from rlgcomp.errors import InputError
from rlgcomp.files import to_json, write_text
from rlgcomp.workers import DIED, spread

Row = dict[str, Any]
Piece = TypeVar("Piece")


class Work:
    """Workers of the pieces and the file of their rows.

    Parameters
    ----------
    jobs : int
        Worker processes on this machine.
    scheduler : str, optional
        Address of a Dask scheduler whose workers do the work instead.
    rows : path, optional
        File of rows, a line each.
    resume : bool
        Keep the rows that are there and did not fail; otherwise the file begins anew.
    """

    def __init__(self, jobs: int = 2, scheduler: str | None = None, rows: Path | None = None, *, resume: bool = False) -> None:
        self._jobs, self._scheduler, self._file = jobs, scheduler, rows
        self._finished_rows = _finished(rows) if resume and rows is not None else {}
        if rows is not None:
            rows.parent.mkdir(parents=True, exist_ok=True)
            write_text(rows, "".join(line_of(row) for row in self._finished_rows.values()))

    @staticmethod
    def add_options(parser: argparse.ArgumentParser, name: str) -> None:
        """The options of :meth:`of`, for the experiment of this name."""
        parser.add_argument("--jobs", type=int, default=2, help="worker processes (default 2)")
        parser.add_argument("--scheduler", metavar="tcp://HOST:PORT", help="Dask scheduler whose workers do the work instead")
        parser.add_argument("--rows", type=Path, default=Path(f"build/{name}.jsonl"), help="where rows are kept as they finish")
        parser.add_argument("--resume", action="store_true", help="keep the rows that are there already and make the others")

    @staticmethod
    def without_options(argv: Sequence[str]) -> list[str]:
        """Arguments of a command line without these: what is left says which pieces, and belongs on a page."""
        parser = argparse.ArgumentParser(add_help=False, allow_abbrev=False)
        Work.add_options(parser, "")
        return parser.parse_known_args(argv)[1]

    @classmethod
    def of(cls, options: argparse.Namespace) -> Self:
        """As the command line says."""
        return cls(options.jobs, options.scheduler, options.rows, resume=options.resume)

    def rows(
        self,
        run: Callable[[Piece], Row],
        pieces: Mapping[str, Piece],
        *,
        died: Callable[[Piece], Row],
        describe: Callable[[Row], str],
    ) -> list[Row]:
        """Rows of the pieces, in their order; rows already in the file are not computed again.

        Parameters
        ----------
        run : callable
            Picklable, from a piece to its row. A row has its `key`; a row with `failure` is computed again on resuming.
        pieces : mapping
            By key.
        died : callable
            The row of a piece whose worker dies each time.
        describe : callable
            Text of a finished row for standard error.
        """
        missing = [piece for key, piece in pieces.items() if key not in self._finished_rows]
        try:
            for done, row in enumerate(spread(run, missing, died=died, n_jobs=self._jobs, scheduler=self._scheduler), start=1):
                line = line_of(row)
                self._finished_rows[row["key"]] = json.loads(line)
                if self._file is not None:
                    with self._file.open("a", encoding="utf-8") as lines:
                        lines.write(line)
                print(f"{done}/{len(missing)} {describe(row)}", file=sys.stderr, flush=True)
        except InputError as error:
            print(f"error: {error}", file=sys.stderr)
            raise SystemExit(2) from None
        return [self._finished_rows[key] for key in pieces]

    def results(self, name: str, function: Callable[..., Any], pieces: Sequence[tuple[Any, ...]]) -> list[Any]:
        """Results of the function for each piece's arguments, in their order: plain data, NaN as None.

        The name and the arguments are the key; settings that are no arguments belong into the name.
        """
        keys = {f"{name}{piece!r}": piece for piece in pieces}
        run = functools.partial(_result, function)
        rows = self.rows(run, {key: (key, piece) for key, piece in keys.items()}, died=_died, describe=lambda row: row["key"])
        if failed := [row["key"] for row in rows if "failure" in row]:
            print(
                f"error: {len(failed)} of {len(rows)} failed, the first {failed[0]}: {DIED}; --resume tries again", file=sys.stderr
            )
            raise SystemExit(1)
        return [row["result"] for row in rows]


def _result(function: Callable[..., Any], keyed: tuple[str, tuple[Any, ...]]) -> Row:
    key, piece = keyed
    return {"key": key, "result": function(*piece)}


def _died(keyed: tuple[str, tuple[Any, ...]]) -> Row:
    return {"key": keyed[0], "failure": DIED}


def line_of(row: Row) -> str:
    """A row as a line of the file of rows."""
    return to_json(row, indent=None) + "\n"


def _finished(path: Path) -> dict[str, Row]:
    """Rows that did not fail, by their keys; a last line cut short by a kill is made again."""
    rows = {}
    for line in path.read_text(encoding="utf-8").splitlines() if path.exists() else []:
        with contextlib.suppress(json.JSONDecodeError):
            row = json.loads(line)
            if isinstance(row, dict) and "key" in row and "failure" not in row:
                rows[row["key"]] = row
    return rows


def import_all() -> None:
    """Import what commands import when they run, so that processes forked from this one begin with their work."""
    import importlib

    from rlgcomp.cli import register_commands

    register_commands()
    modules = "pandas pyarrow.parquet h5py scipy.io scipy.optimize scipy.stats scipy.signal sklearn.kernel_ridge matplotlib.figure"
    ours = "compensation.compensator simulation.simulator evaluation.evaluation evaluation.page recording.merge export.c fleet"
    for name in (*modules.split(), *(f"rlgcomp.{one}" for one in ours.split())):
        importlib.import_module(name)
