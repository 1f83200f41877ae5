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


LIGHT = [
    "Blue Basketball",
    "Green Basketball",
    "Volleyball",
    "Tennis Ball",
    "Whiffle Ball 1",
    "Whiffle Ball 2",
    "Yellow Whiffle Ball",
    "Orange Whiffle Ball",
]


@pytest.mark.parametrize("ball", LIGHT)
def test_drag_is_found_for_light_balls(table: pd.DataFrame, ball: str) -> None:
    """Height and speed at the release of the second drop are its own; the velocity is the rate of change of the height."""
    diagnosis = diagnosed(table, ball)
    assert {cause.name for cause in diagnosis.members} <= set(DRAGS)
    assert diagnosis.members
    assert diagnosis.test.augmented_rms < 0.35 * diagnosis.test.baseline_rms
    assert any(one.code == "diagnosis.identity" for one in diagnosis.remarks)
    assert "late velocity_mps" not in diagnosis.posterior.regions  # the height would tell the delay of its own rate of change


@pytest.mark.parametrize("ball", ["Bowling Ball", "Golf Ball"])
def test_nothing_is_claimed_for_heavy_balls(table: pd.DataFrame, ball: str) -> None:
    diagnosis = diagnosed(table, ball)
    assert diagnosis.verdict == "none"
    assert not diagnosis.causes
