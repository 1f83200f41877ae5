"""Time to start, beside an empty Python process."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from typing import Final

from experiments.speed.measure import Case, Peer, Row


def _run(code: str, *arguments: str) -> str:
    return subprocess.run([sys.executable, "-c", code, *arguments], capture_output=True, text=True, check=True).stdout  # noqa: S603


def _case(code: str, *arguments: str) -> Callable[[bool], Case]:
    heavy = ["torch", "matplotlib", "sklearn", "numba", "scipy", "pandas", "numpy"]
    ask = f"{code.replace('; main()', '')}; import sys; print(*[name for name in {heavy} if name in sys.modules])"

    def prepare(quick: bool) -> Case:
        del quick  # starting has no size
        return Case(
            lambda: _run(code, *arguments),
            [Peer("python -c pass", lambda: _run("pass"), lambda ours, theirs: len(_run(ask).split()), 0.0)],
            size="heavy libraries imported count as disagreement",
        )

    return prepare


ROWS: Final = (
    Row("start-help", "rlgcomp --help", _case("from rlgcomp.cli import main; main()", "--help"), goal_extra_s=0.35),
    Row("start-import", "import rlgcomp", _case("import rlgcomp"), goal_extra_s=0.35),
)
