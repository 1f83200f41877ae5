"""Air drag through a user's mechanism file: found for light balls, nothing claimed for heavy ones."""

from __future__ import annotations

from pathlib import Path

import pandas as pd
import pytest

import rlgcomp as rlg
from experiments.ball_drops import falling
from experiments.ball_drops.__main__ import FOLDER, GRAVITY, drop
from rlgcomp.physics.user import user_catalogue

DRAGS = ("linear_drag", "quadratic_drag")


@pytest.fixture(scope="module")
def table() -> pd.DataFrame:
    if not (FOLDER / "ball_drops.csv").exists():
        pytest.skip(f"no recordings of ball drops in {FOLDER}")
    return pd.read_csv(FOLDER / "ball_drops.csv")


def diagnosed(table: pd.DataFrame, ball: str) -> rlg.Diagnosis:
    catalogue = user_catalogue([Path(falling.__file__)])
    return rlg.diagnose(
        GRAVITY,
        train=[drop(table, ball, 1)],
        test=[drop(table, ball, 2)],
        mechanisms={name: catalogue[name] for name in DRAGS},
    )


@pytest.mark.parametrize("ball", ["Whiffle Ball 1", "Tennis Ball", "Volleyball"])
def test_a_law_of_the_velocity_is_found_for_light_balls(table: pd.DataFrame, ball: str) -> None:
    """A drag or, with as much right, a law of the velocity with memory."""
    diagnosis = diagnosed(table, ball)
    assert {cause.name for cause in diagnosis.causes} <= set(DRAGS)
    assert {driver for member in diagnosis.members for driver in member.drivers} == {"velocity_mps"}
    assert diagnosis.p_value < 1e-6
    assert diagnosis.test.augmented_rms < 0.5 * diagnosis.test.baseline_rms


@pytest.mark.parametrize("ball", ["Bowling Ball", "Golf Ball"])
def test_nothing_is_claimed_for_heavy_balls(table: pd.DataFrame, ball: str) -> None:
    diagnosis = diagnosed(table, ball)
    assert diagnosis.verdict == "none"
    assert not diagnosis.causes
