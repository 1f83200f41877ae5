"""Kill commands, fill their disk, close their streams; print the counts and what went wrong."""

from __future__ import annotations

import argparse
import itertools
import signal
import sys
import tempfile
from pathlib import Path

from experiments.faults import kills, others, page
from experiments.faults.commands import COMMANDS, prepare
from experiments.work import import_all


def main() -> None:
    """Parse the options and print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--kills", type=int, default=120)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only-kills", action="store_true")
    parser.add_argument("--commands", nargs="*", choices=[one.name for one in COMMANDS], metavar="COMMAND", help="these alone")
    options = parser.parse_args()
    signal.signal(signal.SIGINT, signal.default_int_handler)
    import_all()
    with tempfile.TemporaryDirectory(prefix="faults-") as scratch:
        folder = Path(scratch)
        prepare(folder / "inputs")
        commands = [one for one in COMMANDS if one.name in (options.commands or [one.name])]
        more = iter(()) if options.only_kills else others(folder, commands)
        trials = []
        try:
            for trial in itertools.chain(kills(folder, options.kills, options.seed, commands), more):
                trials.append(trial)
                outcome = "; ".join(trial.problems) or "no problem"
                print(f"- {trial.command}, {trial.fault}, {trial.seconds:.2f} s: {outcome}", file=sys.stderr, flush=True)
        except KeyboardInterrupt:
            print("stopped before the end", file=sys.stderr)
    print(page(trials))


if __name__ == "__main__":
    main()
