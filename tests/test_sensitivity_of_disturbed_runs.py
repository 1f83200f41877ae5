"""Detection limits on recordings that hold an effect already."""

from __future__ import annotations

from rlgcomp.challenge.sensitivity import sensitivity
from rlgcomp.physics import CATALOGUE
from rlgcomp.simulation.simulator import Simulator
from tests.few_monitors import few_monitors

FEW = {name: CATALOGUE[name] for name in ("supply_voltage", "magnetic_field")}
BASELINE = Simulator.from_mapping({"kind": "chamber", "mechanisms": [{"thermal_polynomial": {"degree": 2}}]})
REAL = {
    "kind": "chamber",
    "mechanisms": [{"thermal_polynomial": {"degree": 2}}, {"magnetic_field": {"k_deg_h_uT": 0.004}}],
    "noise": {"angle_random_walk_deg_sqrt_h": 0.0005},
}


def test_an_effect_is_injected_and_found() -> None:
    """The effect that the recording has already is taken into the simulator first."""
    run = Simulator.from_mapping(REAL).simulate("start 20, hold 20, ramp -20 2, hold 30, ramp 40 2, hold 30", step_s=20.0)
    run = few_monitors(run, "magnetic_field_uT")
    found = sensitivity(BASELINE, [run], "supply_voltage", strengths=[0.05, 8.0], draws=1, catalogue=FEW)
    weak, strong = found.trials
    assert not weak.named
    assert strong.named
    assert strong.found == ("supply_voltage",)
    assert "challenge.causes_before" in {remark.code for remark in found.remarks}
