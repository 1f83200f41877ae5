"""Effects concealed in recordings by another implementation of the physics, diagnosed and scored."""

from __future__ import annotations

import argparse
import functools
import shlex
import sys
from collections.abc import Sequence
from pathlib import Path

from experiments.concealed import tables
from experiments.concealed.cases import KINDS, Kind, dump, make_case, plan
from experiments.concealed.score import Manner, died, run_case
from experiments.work import Work

CASES: dict[Kind, int] = {
    "single": 102, "pair": 40, "triple": 20, "null": 200, "open": 30, "driverless": 36, "table": 36, "unequal": 40
}  # fmt: skip
QUICK: dict[Kind, int] = {
    "single": 17, "pair": 4, "triple": 2, "null": 8, "open": 5, "driverless": 3, "table": 9, "unequal": 4
}  # fmt: skip


def main(argv: Sequence[str] | None = None) -> None:
    """Command line of the experiment."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="a few cases of each kind")
    parser.add_argument("--cases", type=int, help="cases of each kind, instead of the usual numbers")
    parser.add_argument("--first", type=int, default=0, help="number of the first case: others than those tuned on")
    parser.add_argument("--only", choices=KINDS, action="append", help="only this kind; may be given again")
    parser.add_argument("--noise-stated", action="store_true", help="tell the diagnosis each unit's true noise")
    parser.add_argument("--pulse-arcsec", type=float, default=0.0, help="the gyros are read in whole pulses of so much, dithered")
    parser.add_argument("--strength", type=float, help="only cases of this strength")
    noise = parser.add_mutually_exclusive_group()
    whole = "strengths are relative to flicker and walk as well as white noise"
    noise.add_argument("--whole-noise", dest="noise", action="store_const", const="whole", default="drawn", help=whole)
    white = "units have white noise alone: none has flicker and walk"
    noise.add_argument("--white-noise", dest="noise", action="store_const", const="white", help=white)
    Work.add_options(parser, "concealed")
    parser.add_argument("--dump", type=Path, metavar="DIR", help="write the cases as files for the command line; score nothing")
    options = parser.parse_args(argv)
    numbers = QUICK if options.quick else CASES
    planned = [
        arguments for kind in options.only or KINDS for arguments in plan(kind, options.cases or numbers[kind], options.first)
    ]
    wanted = [arguments for arguments in planned if options.strength in (None, arguments[2])]
    if options.dump:
        for arguments in wanted:
            case = make_case(*arguments, noise_of_units=options.noise)
            dump(case, options.dump / case.name)
            print(options.dump / case.name)
        return
    manner = Manner(options.noise_stated, options.pulse_arcsec, options.noise)
    cases = {manner.key_of(arguments): arguments for arguments in wanted}
    run, lost = (functools.partial(function, manner=manner) for function in (run_case, died))
    rows = Work.of(options).rows(run, cases, died=lost, describe=tables.mark)
    print(f"# Concealed physics: `python -m experiments.concealed {shlex.join(sys.argv[1:] if argv is None else argv)}`\n")
    tables.show(rows)


if __name__ == "__main__":
    main()
