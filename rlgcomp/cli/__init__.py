"""The command line. One module a family of commands; each is thin over the Python face and imports what it needs when it runs."""

from __future__ import annotations

import importlib

from rlgcomp.cli.base import app


def main() -> None:
    """Entry point of the console script."""
    for commands in ("demo", "recordings", "simulation", "compensation", "rotation"):  # the order in which --help lists them
        importlib.import_module(f"rlgcomp.cli.{commands}")
    app()
