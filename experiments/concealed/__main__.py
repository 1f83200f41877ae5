"""Make the cases."""

from __future__ import annotations

import argparse
from pathlib import Path

from experiments.concealed.cases import KINDS, dump, make_case, plan


def main() -> None:
    """Command line of the experiment."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cases", type=int, default=5, help="cases of each kind")
    parser.add_argument("--only", choices=KINDS, action="append", help="only this kind; may be given again")
    parser.add_argument("--dump", type=Path, metavar="DIR", help="write the cases as files instead of scoring them")
    options = parser.parse_args()
    for kind in options.only or KINDS:
        for arguments in plan(kind, options.cases):
            case = make_case(*arguments)
            dump(case, options.dump / case.name)
            print(case.name)


if __name__ == "__main__":
    main()
