"""Recordings of others that are of no gyro: a pendulum, and what is said of columns that are readings of the output."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

import rlgcomp as rlg
from rlgcomp.diagnosis.diagnose import Diagnosis, diagnose

REAL = Path(__file__).resolve().parents[2] / "shared" / "data" / "real"


def recording(table: pd.DataFrame, name: str) -> rlg.Recording:
    """A table of other quantities: a recording has a gyro."""
    return rlg.Recording(table.assign(gyro_deg_h=0.0).reset_index(drop=True), name=name)


@pytest.fixture(scope="module")
def swings() -> list[rlg.Recording]:
    folder = REAL / "pendulum"
    if not folder.exists():
        pytest.skip(f"no recordings of a pendulum in {folder}")
    tables = {name: pd.read_csv(folder / f"{name}.csv") for name in ("train1", "train2", "test")}
    return [recording(table.rename(columns={"gyro_deg_h": "acceleration_rad_s2"}), name) for name, table in tables.items()]


@pytest.fixture(scope="module")
def pendulum(swings: list[rlg.Recording]) -> Diagnosis:
    def small_angles(run: rlg.Recording) -> np.ndarray:
        return np.asarray(-1.2622 * run.column("angle_rad"))

    return diagnose(small_angles, swings[:2], swings[2:], output="acceleration_rad_s2", black_box=False)


def test_a_pendulum_lacks_a_law_of_the_angle(pendulum: Diagnosis) -> None:
    law, *perhaps = pendulum.members
    assert all(one.drivers == ("rate_rad_s",) for one in perhaps)  # friction, of which two swings show little
    assert all(one.probability < 0.9 for one in pendulum.decision.named[1:])
    assert law.drivers == ("angle_rad",)
    assert law.memory == "static"
    assert law.equation == "b = odd function of angle_rad"
    assert pendulum.test is not None
    assert pendulum.test.improvement > 0.75  # a sine of the angle and damping, fitted to the test swing itself gain 0.80


def test_its_rate_is_told_as_a_reading_of_the_output(pendulum: Diagnosis) -> None:
    (told,) = (one for one in pendulum.remarks if one.code == "diagnosis.identity")
    assert told.data == {"column": "rate_rad_s", "output_is": "rate"}
    assert not any("rate_rad_s" in law.drivers and law.memory != "static" for law in pendulum.members)


@pytest.mark.parametrize(
    ("column", "of_output", "expected"),
    [
        ("angular_acceleration", lambda t, y: np.gradient(y, t), [("angular_acceleration", "integral")]),
        ("angle_arcsec", lambda t, y: 3600.0 * np.cumsum(y) * (t[1] - t[0]), [("angle_arcsec", "rate")]),
        ("temperature_case_degC", lambda t, y: np.cumsum(y) * (t[1] - t[0]), []),  # of another unit: a cause
        ("sum_counts", lambda t, y: np.cumsum(y) * (t[1] - t[0]), [("sum_counts", "rate")]),
        ("other_V", lambda t, y: 3.0 * np.cumsum(y) * (t[1] - t[0]), []),  # a law of its rate of change
    ],
)
def test_a_reading_of_the_output_is_known_by_its_factor(
    column: str, of_output: Callable[[np.ndarray, np.ndarray], np.ndarray], expected: list[tuple[str, str]]
) -> None:
    rng = np.random.default_rng(1)
    runs = []
    for k in range(2):
        time_s = 0.1 * np.arange(2000)
        turn = np.sin(time_s / 7.0 + k) + 0.5 * np.sin(time_s / 3.0) + 1e-3 * rng.standard_normal(len(time_s))
        smooth = np.convolve(turn, np.ones(25) / 25, "same")
        table = pd.DataFrame({"time_s": time_s, "turn_deg_s": smooth, column: of_output(time_s, smooth)})
        runs.append(recording(table.iloc[30:-30], f"run{k}"))
    options: dict[str, Any] = {"output": "turn_deg_s", "window_s": 4.0, "only": ["warm_up"], "black_box": False}
    found = diagnose(lambda run: np.zeros(len(run)), runs, **options)
    told = [(one.data["column"], one.data["output_is"]) for one in found.remarks if one.code == "diagnosis.identity"]
    assert told == expected


@pytest.mark.parametrize("width_m_s", [0.0, 0.05])
def test_a_friction_is_found_with_its_coefficients_and_written(width_m_s: float) -> None:
    """At rest half of the time, and with 20 samples a window: the sign of a mean is not the mean of the signs."""
    rng, runs = np.random.default_rng(2), []
    for k in range(2):
        time_s = 1e-3 * np.arange(8000)
        velocity = np.sin(2.0 * np.pi * time_s / (0.9 + 0.1 * k)) + 0.3 * np.sin(2.0 * np.pi * time_s / 0.37)
        sign = np.tanh(velocity / width_m_s) if width_m_s else np.sign(velocity)
        force = 3.0 * sign + 1.5 * velocity + 0.5 * rng.standard_normal(len(time_s))
        runs.append(recording(pd.DataFrame({"time_s": time_s, "force_N": force, "velocity_m_s": velocity}), f"run{k}"))
    found = diagnose(lambda run: np.zeros(len(run)), runs[:1], runs[1:], output="force_N", only=["ageing"], black_box=False)
    (law,) = found.members
    assert law.equation.startswith("b = c sign" if width_m_s == 0.0 else "b = c tanh")
    for name, truth, unit in (("c", 3.0, "N"), ("k", 1.5, "N/(m/s)")):
        assert abs(law.parameters[name].value - truth) < 3.0 * law.parameters[name].sd
        assert law.parameters[name].unit == unit
    if width_m_s:
        assert abs(law.parameters["w"].value - width_m_s) < 4.0 * law.parameters["w"].sd
        assert law.parameters["w"].unit == "m/s"
    assert found.augmented_file.left_out == ()
    assert found.augmented_file.error < 0.5


@pytest.mark.slow
def test_a_positioning_system_lacks_coulomb_friction() -> None:
    """Beside a simulator of mass and viscous friction: a law with the sign of the velocity, its friction as published."""
    file = REAL / "emps" / "emps.csv.gz"
    if not file.exists():
        pytest.skip(f"no recording of a positioning system in {file.parent}")
    table = pd.read_csv(file)
    parts = [recording(table.iloc[k * 8280 : (k + 1) * 8280], f"part{k}") for k in range(3)]

    def viscous(run: rlg.Recording) -> np.ndarray:
        return np.asarray(95.1 * run.column("acceleration_m_s2") + 203.5 * run.column("velocity_m_s"))

    found = diagnose(viscous, parts[:2], parts[2:], output="force_N", black_box=False)
    assert found.test is not None
    assert found.test.improvement > 0.9
    law = next(one for one in found.members if one.name == "law:velocity_m_s")
    assert law.equation in ("b = c sign(velocity_m_s)", "b = c tanh(velocity_m_s / w)")
    friction = law.parameters["c"]
    assert friction.unit == "N"
    assert abs(friction.value - 20.39) < 2.0 * friction.sd
    assert law.rms == max(one.rms for one in found.members)
