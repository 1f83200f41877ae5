"""Effects concealed in recordings by another implementation of the physics, diagnosed and scored."""

from __future__ import annotations

import argparse
import contextlib
import functools
import json
import shlex
import sys
from collections.abc import Sequence
from pathlib import Path

from experiments.concealed import tables
from experiments.concealed.cases import KINDS, Kind, dump, make_case, plan
from experiments.concealed.score import died, key_of, run_case
from rlgcomp.errors import InputError
from rlgcomp.files import to_json
from rlgcomp.workers import spread

CASES: dict[Kind, int] = {"single": 102, "pair": 40, "triple": 20, "null": 200, "open": 30, "driverless": 36, "table": 36}
QUICK: dict[Kind, int] = {"single": 17, "pair": 4, "triple": 2, "null": 8, "open": 5, "driverless": 3, "table": 9}


def main(argv: Sequence[str] | None = None) -> None:
    """Command line of the experiment."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="a few cases of each kind")
    parser.add_argument("--cases", type=int, help="cases of each kind, instead of the usual numbers")
    parser.add_argument("--first", type=int, default=0, help="number of the first case: others than those tuned on")
    parser.add_argument("--only", choices=KINDS, action="append", help="only this kind; may be given again")
    parser.add_argument("--noise-stated", action="store_true", help="tell the diagnosis each unit's true noise")
    parser.add_argument("--jobs", type=int, default=2, help="worker processes (default 2)")
    parser.add_argument("--scheduler", metavar="tcp://HOST:PORT", help="Dask scheduler whose workers do the work instead")
    parser.add_argument("--rows", type=Path, default=Path("build/concealed.jsonl"), help="where each case is kept as it finishes")
    parser.add_argument("--resume", action="store_true", help="keep the cases that are there already and make the others")
    parser.add_argument("--dump", type=Path, metavar="DIR", help="write the cases as files for the command line; score nothing")
    options = parser.parse_args(argv)
    numbers = QUICK if options.quick else CASES
    wanted = [
        arguments for kind in options.only or KINDS for arguments in plan(kind, options.cases or numbers[kind], options.first)
    ]
    if options.dump:
        for arguments in wanted:
            case = make_case(*arguments)
            dump(case, options.dump / case.name)
            print(options.dump / case.name)
        return
    kept = _kept(options.rows) if options.resume else {}
    options.rows.parent.mkdir(parents=True, exist_ok=True)
    options.rows.write_text("".join(to_json(row, indent=None) + "\n" for row in kept.values()), encoding="utf-8")
    keys = {arguments: key_of(arguments, options.noise_stated) for arguments in wanted}
    missing = [arguments for arguments in wanted if keys[arguments] not in kept]
    run, lost = (functools.partial(function, stated=options.noise_stated) for function in (run_case, died))
    work = spread(run, missing, died=lost, n_jobs=options.jobs, scheduler=options.scheduler)
    try:
        for done, row in enumerate(work, start=1):
            kept[row["key"]] = row
            with options.rows.open("a", encoding="utf-8") as lines:
                lines.write(to_json(row, indent=None) + "\n")
            print(f"{done}/{len(missing)} {tables.mark(row)}", file=sys.stderr, flush=True)
    except InputError as error:
        parser.exit(2, f"error: {error}\n")
    print(f"# Concealed physics: `python -m experiments.concealed {shlex.join(sys.argv[1:] if argv is None else argv)}`\n")
    tables.show([kept[key] for key in keys.values()])


def _kept(path: Path) -> dict[str, dict[str, object]]:
    """Cases that were finished and did not fail, by their keys; a last line cut short by a kill is made again."""
    kept = {}
    for line in path.read_text(encoding="utf-8").splitlines() if path.exists() else []:
        with contextlib.suppress(json.JSONDecodeError):
            row = json.loads(line)
            if "failure" not in row:
                kept[row["key"]] = row
    return kept


if __name__ == "__main__":
    main()
