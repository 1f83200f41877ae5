"""The simulated triad on a two-axis table: errors and their inverse, lock-in."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rlgcomp.simulation.triad_errors import GYRO, TriadErrors
from tests.triads import SILENT, STEP_S


@given(st.integers(0, 1000))
@settings(max_examples=20)
def test_correct_undoes_disturb(seed: int) -> None:
    rng = np.random.default_rng(seed)
    errors = TriadErrors.of(rng.normal(0.0, 100.0, len(GYRO)))
    increments = rng.normal(0.0, 1e-3, (5, 3))
    assert errors.correct(errors.disturb(increments, 0.005), 0.005) == pytest.approx(increments, abs=1e-16)


def test_lock_in_kicks_have_the_stated_size() -> None:
    """0.1375 arcsec rms at 24 deg/s² and a lock-in rate of 0.0173 deg/s."""
    quiet = dataclasses.replace(SILENT, lock_in_deg_s=0.0173)
    kicked = quiet.simulate("step-3", seed=2)
    plain = SILENT.simulate("step-3", seed=2)
    rates = [np.stack([run.rate_deg_h(f"gyro_{axis}_pulses") for axis in "xyz"]) for run in (kicked, plain)]
    kicks = (rates[0] - rates[1]) * STEP_S / 3600.0 * 3600.0
    kicks = kicks[np.abs(kicks) > 1e-6]
    assert len(kicks) > 500
    assert np.sqrt(np.mean(kicks**2)) == pytest.approx(0.1375, rel=0.35)
