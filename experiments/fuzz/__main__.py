"""Make mutated files and command lines, read each, and print how many were read, refused and faulty."""

from __future__ import annotations

import argparse
import collections
import concurrent.futures
import multiprocessing
import time
from pathlib import Path

from experiments.fuzz import Counts, cases
from experiments.fuzz.readers import READERS

_AT_ONCE = 2000  # whose process imports the package once


def main() -> None:
    """Parse the options and print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cases", type=int, default=10_000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--only", type=int, nargs="*", help="numbers of cases")
    parser.add_argument("--readers", nargs="*", choices=list(READERS), metavar="READER", help="their cases alone")
    parser.add_argument("--keep", type=Path, help="folder for the files of faults")
    options = parser.parse_args()
    began = time.monotonic()
    names = list(READERS)
    numbers = [case for case in options.only or range(options.cases) if names[case % len(names)] in (options.readers or names)]
    pieces = [numbers[first : first + _AT_ONCE] for first in range(0, len(numbers), _AT_ONCE)]
    total = Counts(collections.Counter(), collections.Counter(), [])
    crashed = 0
    context = multiprocessing.get_context("spawn")
    for first in range(0, len(pieces), options.jobs):
        with concurrent.futures.ProcessPoolExecutor(options.jobs, context) as pool:  # a crash takes one batch alone
            for future in [
                pool.submit(cases, piece, seed=options.seed, keep=options.keep) for piece in pieces[first : first + options.jobs]
            ]:
                try:
                    counts = future.result()
                except concurrent.futures.process.BrokenProcessPool:
                    crashed += 1
                    continue
                total.read.update(counts.read)
                total.refused.update(counts.refused)
                total.faults.extend(counts.faults)
    faulty = collections.Counter(fault.reader for fault in total.faults)
    print("| reader | cases | read | refused | faults |\n|---|---|---|---|---|")
    for name in READERS:
        read, refused = total.read[name], total.refused[name]
        print(f"| {name} | {read + refused + faulty[name]} | {read} | {refused} | {faulty[name]} |")
    count = total.read.total() + total.refused.total() + len(total.faults)
    print(f"| all | {count} | {total.read.total()} | {total.refused.total()} | {len(total.faults)} |")
    print(
        f"\n{len(total.faults)} faults in {len({fault.place for fault in total.faults})} places, {crashed} crashes of a process, "
        f"{time.monotonic() - began:.0f} s"
    )
    shown: set[tuple[str, str]] = set()
    for fault in total.faults:
        if (fault.place, fault.error[:20]) not in shown:
            shown.add((fault.place, fault.error[:20]))
            print(f"- case {fault.case}, {fault.reader}: {fault.place}: {fault.error}")


if __name__ == "__main__":
    main()
