"""Messages of export."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

TEXTS: Final[dict[str, str | Callable[..., str]]] = {
    "export.toolchain_not_requested": "{toolchain}: skipped, as requested",
    "export.toolchain_missing": "{toolchain}: skipped, {program} is not installed",
    "export.toolchain_broken": "{toolchain}: installed, but a trivial program cannot be built and run: {reason}",
    "export.not_compiled": "The code was not compiled: no working C compiler was found. It is unverified on this machine.",
    "export.smallest_within_1_percent": "The smallest model within 1 % of the best on the curve has {centres} centres.",
    "export.not_compared": 'not compared with Python: onnxruntime is not installed; pip install "rlgcomp[onnx]"',
}
