"""Causes of drawn forms concealed in recordings by another implementation of the physics, diagnosed and scored.

Cases for tuning (`--tuning`) have seeds of their own: the printed page's are never tuned on.
"""

from __future__ import annotations

import argparse
import functools
import shlex
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

from experiments.concealed import page
from experiments.concealed.case import dump
from experiments.concealed.cases import make_case
from experiments.concealed.plan import KINDS, NAMED, NUMBERS, Kind, plan
from experiments.concealed.score import DIAGNOSE, died, key_of, run_case
from experiments.work import Work

QUICK: Mapping[Kind, int] = {kind: max(3, count // 10) for kind, count in NUMBERS.items()}


def main(argv: Sequence[str] | None = None) -> None:
    """Command line of the experiment."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="a tenth of the cases")
    parser.add_argument(
        "--cases",
        type=_number,
        action="append",
        default=[],
        metavar="N|KIND=N",
        help="cases of each kind, or of one, and only of those that are named; may be given again",
    )
    parser.add_argument("--first", type=int, default=0, help="number of the first case of each kind")
    parser.add_argument("--tuning", action="store_true", help="cases for tuning, none of which is on the printed page")
    parser.add_argument("--only", choices=KINDS, action="append", help="only this kind; may be given again")
    parser.add_argument("--diagnose", default=DIAGNOSE, metavar="MODULE:FUNCTION", help=f"what diagnoses (default {DIAGNOSE})")
    parser.add_argument("--told", action="store_true", help="the hidden effects are the only candidates; kinds that have names")
    Work.add_options(parser, "concealed")
    parser.add_argument("--dump", type=Path, metavar="DIR", help="write the cases as files for the command line; score nothing")
    options = parser.parse_args(argv)
    chosen = {kind: count for numbers in options.cases for kind, count in numbers.items()}
    numbers: Mapping[Kind, int] = chosen or (QUICK if options.quick else NUMBERS)
    plans = [
        one
        for kind in options.only or KINDS
        if kind in numbers and (kind in NAMED or not options.told)
        for one in plan(kind, numbers[kind], options.first, tuning=options.tuning)
    ]
    if options.dump:
        for one in plans:
            dump(make_case(one), options.dump / one.name)
            print(options.dump / one.name)
        return
    run, lost = (functools.partial(one, function=options.diagnose, told=options.told) for one in (run_case, died))
    cases = {key_of(one, options.diagnose, options.told): one for one in plans}
    rows = Work.of(options).rows(run, cases, died=lost, describe=page.mark)
    own = Work.without_options(sys.argv[1:] if argv is None else argv)
    print(f"# Concealed physics: `python -m experiments.concealed {shlex.join(own)}`\n")
    if options.tuning:
        print("These cases are for tuning: what is tuned on them is shown on others, of other seeds (without `--tuning`).\n")
    else:
        print("Nothing is tuned on these cases: those for tuning have other seeds (`--tuning`).\n")
    page.show(rows)


def _number(text: str) -> Mapping[Kind, int]:
    if text.isdecimal():
        return dict.fromkeys(KINDS, int(text))
    name, _, count = text.partition("=")
    kind = next((kind for kind in KINDS if kind == name), None)
    if kind is None or not count.isdecimal():
        raise argparse.ArgumentTypeError(f"{text!r} is not understood; write N, or KIND=N with a kind of {', '.join(KINDS)}")
    return {kind: int(count)}


if __name__ == "__main__":
    main()
