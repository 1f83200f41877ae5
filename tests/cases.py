"""Inputs that are kept outside the project: tests read them where they are, and skip elsewhere."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import pytest

from rlgcomp.recording import Finding

CASES = Path(__file__).resolve().parents[2] / "shared" / "cases"


def case(name: str) -> Path:
    """The path of an input of shared cases."""
    path = CASES / name
    if not path.exists():
        pytest.skip(f"no shared inputs beside the project (../shared/cases/{name})")
    return path


def by_code(findings: Iterable[Finding]) -> dict[str, Finding]:
    """Findings by their codes without the room; of several with one code, the first."""
    found: dict[str, Finding] = {}
    for finding in findings:
        found.setdefault(finding.message.code.removeprefix("recording."), finding)
    return found
