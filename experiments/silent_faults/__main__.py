"""Print a table of faults by commands: the codes of the messages that notice each, beyond those of healthy runs."""

from __future__ import annotations

import argparse
import logging
import tempfile
from pathlib import Path

from experiments.silent_faults import FAULTS, healthy_messages, noticed

COMMANDS = ("inspect", "train", "evaluate", "diagnose")


def main() -> None:
    """Parse the options and print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--diagnose", action="store_true", help="make a diagnosis of each fault as well")
    parser.add_argument(
        "--healthy", type=int, metavar="N", help="compare N sets of healthy runs instead, none of which should raise one"
    )
    options = parser.parse_args()
    logging.disable(logging.WARNING)
    if options.healthy:
        raised = {seed: codes for seed in range(options.healthy) if (codes := [one.code for one in healthy_messages(seed)])}
        print(f"{options.healthy} sets of healthy runs, {len(raised)} with messages: {raised}")
        return
    commands = COMMANDS if options.diagnose else COMMANDS[:3]
    columns = (*commands, "verdict") if options.diagnose else commands
    print(f"| fault of one run | {' | '.join(columns)} |\n|---|{'---|' * len(columns)}")
    healthy: dict[str, list[str]] = {}
    unnoticed = []
    for name in FAULTS:
        with tempfile.TemporaryDirectory(prefix="silent-") as folder:
            codes = noticed(name, Path(folder), diagnosed=options.diagnose)
        if name == "none":
            healthy = codes
        new = {command: [code for code in codes[command] if code not in healthy[command]] for command in commands}
        told = {**new, "verdict": codes.get("verdict", [])}
        print(f"| {name} | {' | '.join(', '.join(told[column]) or '-' for column in columns)} |", flush=True)
        if not any(new.values()) and name != "none":
            unnoticed.append(name)
    print(f"\nNoticed nowhere: {', '.join(unnoticed) or 'none'}.")


if __name__ == "__main__":
    main()
