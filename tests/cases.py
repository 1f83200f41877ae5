"""Inputs that are kept outside the project: tests read them where they are, and skip elsewhere."""

from __future__ import annotations

import os
from collections.abc import Iterable
from pathlib import Path

import pytest

from rlgcomp.recording import Finding

CASES = Path(os.environ.get("RLGCOMP_CASES", "/work/shared/cases"))


def case(name: str) -> Path:
    """The path of an input of shared cases."""
    path = CASES / name
    if not path.exists():
        pytest.skip(f"{name} is not here: RLGCOMP_CASES names the folder of shared cases")
    return path


def by_code(findings: Iterable[Finding]) -> dict[str, Finding]:
    """Findings by their codes without the room; of several with one code, the first."""
    found: dict[str, Finding] = {}
    for finding in findings:
        found.setdefault(finding.message.code.removeprefix("recording."), finding)
    return found
