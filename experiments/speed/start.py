"""Time to start, beside an empty Python process."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from typing import Final

from experiments.speed.measure import Case, Peer, Row, Timed


def _run(code: str, *arguments: str) -> Timed:
    """Output of a Python process, with its time."""
    with tempfile.TemporaryFile("w+") as output:
        began = time.perf_counter()
        process = subprocess.Popen([sys.executable, "-c", code, *arguments], stdout=output)  # noqa: S603
        _, status, spent = os.wait4(process.pid, 0)
        wall_s = time.perf_counter() - began
        process.returncode = os.waitstatus_to_exitcode(status)
        if process.returncode:
            raise subprocess.CalledProcessError(process.returncode, process.args)
        output.seek(0)
        return Timed(output.read(), wall_s, spent.ru_utime + spent.ru_stime)


def _case(code: str, *arguments: str) -> Callable[[bool], Case]:
    heavy = ["torch", "matplotlib", "sklearn", "numba", "scipy", "pandas", "numpy"]
    ask = f"{code.replace('; main()', '')}; import sys; print(*[name for name in {heavy} if name in sys.modules])"

    def prepare(quick: bool) -> Case:
        del quick  # starting has no size
        return Case(
            lambda: _run(code, *arguments),
            [Peer("python -c pass", lambda: _run("pass"), lambda ours, theirs: len(_run(ask).result.split()), 0.0)],
            size="heavy libraries imported count as disagreement",
        )

    return prepare


ROWS: Final = (
    Row("start-help", "rlgcomp --help", _case("from rlgcomp.cli import main; main()", "--help"), goal_extra_s=0.35),
    Row("start-import", "import rlgcomp", _case("import rlgcomp"), goal_extra_s=0.35),
)
