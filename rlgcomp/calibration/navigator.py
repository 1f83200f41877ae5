"""What a calibration does for a navigator on the turning table: its largest velocity error before and after."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from rlgcomp.calibration.triad.estimate import RunResult


def largest(runs: Sequence[RunResult]) -> tuple[float, float] | None:
    """Largest velocity error over runs in m/s, before and after, each wherever it is; None where no run shows velocity."""
    errors = [_largest_of(run) for run in runs if run.shows == "velocity"]
    return (max(before for before, _ in errors), max(after for _, after in errors)) if errors else None


def worse(runs: Sequence[RunResult]) -> list[str]:
    """A sentence on each run whose navigator errs more with the calibrated gyros."""
    said = []
    for run in runs:
        before, after = _largest_of(run) if run.shows == "velocity" else (0.0, 0.0)
        if after > before:
            said.append(
                f"{run.name}: the calibration makes its navigator worse: largest velocity error {before:.2g} m/s before, "
                f"{after:.2g} m/s after"
            )
    return said


def _largest_of(run: RunResult) -> tuple[float, float]:
    return float(np.abs(run.before_m_s).max()), float(np.abs(run.after_m_s).max())
