"""Hops of a ladder with their thresholds and steps, as printed."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from rlgcomp.diagnosis.diagnose import diagnose
from rlgcomp.diagnosis.report.result import Diagnosis
from rlgcomp.recording import Metadata, Recording
from rlgcomp.simulation.simulator import Simulator

UP, DOWN, STEPS = np.array([5.0, 18.0, 33.0]), np.array([3.0, 15.5, 31.0]), np.array([0.05, -0.03, 0.08])


def run(seed: int) -> Recording:
    """A block that is swept over three hops, each with a step of its own, in white noise of 0.004 deg/h a window."""
    rng = np.random.default_rng(seed)
    time_s = 10.0 * np.arange(2400)
    block = 20.0 + 24.0 * np.interp(time_s / 24000.0, [0.0, 0.2, 0.5, 0.8, 1.0], [-1.0, 0.4, -0.8 + 0.1 * seed, 1.0, -1.0])
    on, bias = np.zeros(3, dtype=bool), []
    for value in block:
        on = np.where(value >= UP, True, np.where(value <= DOWN, False, on))
        bias.append(STEPS @ on)
    gyro = 0.001 * block + np.array(bias) + 0.012 * rng.standard_normal(len(block))
    table = {"time_s": time_s, "gyro_deg_h": gyro, "temperature_block_degC": block + 0.001 * rng.standard_normal(len(block))}
    return Recording(pd.DataFrame(table), Metadata(kind="chamber"), name=f"run{seed}")


@pytest.fixture(scope="module")
def found() -> Diagnosis:
    simulator = Simulator.from_mapping({"kind": "chamber", "mechanisms": [{"thermal_polynomial": {"degree": 1}}]})
    return diagnose(simulator, [run(1), run(2)], only=["mode_hop"], window_s=190.0, black_box=False)


def test_each_hop_has_its_thresholds_and_its_step(found: Diagnosis) -> None:
    (hop,) = found.members
    assert hop.name == "mode_hop"
    assert not hop.parameters
    assert [one.step.unit for one in hop.switches] == ["deg/h"] * 3
    np.testing.assert_allclose([one.up for one in hop.switches], UP, atol=1.2)  # up to 1.2 K a window
    np.testing.assert_allclose([one.down for one in hop.switches], DOWN, atol=1.2)
    for one, step in zip(hop.switches, STEPS, strict=True):
        assert abs(one.step.value - step) < 4.0 * one.step.sd + 0.002
        assert 0.0 < one.step.sd < 0.01


def test_each_threshold_has_an_error(found: Diagnosis) -> None:
    """Dead bands were printed to four digits that nothing resolves."""
    (hop,) = found.members
    for one, up, down in zip(hop.switches, UP, DOWN, strict=True):
        for value, sd, true in ((one.up, one.up_sd, up), (one.down, one.down_sd, down)):
            assert 0.1 < sd < 1.2  # a window of 210 s moves by up to 1.2 K
            assert abs(value - true) < 3.0 * sd
    first = hop.switches[0]
    assert first.place == f"from {first.up:.2f} ± {first.up_sd:.2f} degC on, until {first.down:.2f} ± {first.down_sd:.2f} degC"


def test_they_are_printed(found: Diagnosis) -> None:
    (hop,) = found.members
    content = found.to_mapping()["findings"][0]["switches"]
    assert [entry["up"]["unit"] for entry in content] == ["degC"] * 3
    assert content[0]["step"]["value"] == hop.switches[0].step.value
    assert content[0]["up"]["sd"] == hop.switches[0].up_sd
    assert all(one.text in str(found) for one in hop.switches)
