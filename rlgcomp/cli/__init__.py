"""The command line. One module a family of commands; each is thin over the Python face and imports what it needs when it runs."""

from __future__ import annotations

import gc
import importlib

from rlgcomp.cli.base import app
from rlgcomp.cli.ending import interrupt_quietly, prepare_streams

COMMANDS = (
    "demo",
    "example",
    "recordings",
    "allan",
    "arw",
    "scale_factor",
    "calibration",
    "simulation",
    "mechanisms",
    "diagnosis",
    "compensation",
    "models",
    "export",
    "conceal",
    "sensitivity",
    "fleet",
)  # the order in which --help lists them


def register_commands() -> None:
    """Import the modules of commands, which registers them."""
    for module in COMMANDS:
        importlib.import_module(f"rlgcomp.cli.{module}")


def main() -> None:
    """Entry point of the console script."""
    interrupt_quietly()
    prepare_streams()
    gc.set_threshold(10_000)  # what imports make stays: to look through it every 700 objects took 0.3 s of a diagnosis
    register_commands()
    app()
