"""Three chamber programmes of two hours, and runs of a gyro whose simulator lacks its supply voltage."""

from __future__ import annotations

from rlgcomp.recording import Recording
from rlgcomp.simulation.simulator import Simulator
from tests.few_monitors import few_monitors

PROGRAMMES = (
    "start 20, hold 20, ramp -20 2, hold 30, ramp 40 2, hold 20, ramp 10 2, hold 20",
    "start 25, hold 20, ramp 45 2, hold 30, ramp -10 2, hold 20, ramp 30 2, hold 10",
    "start 10, hold 20, ramp 35 2, hold 30, ramp -15 2, hold 20, ramp 20 2, hold 10",
)
BASELINE = Simulator.from_mapping({"kind": "chamber", "mechanisms": [{"thermal_polynomial": {"degree": 2}}]})
REAL = Simulator.from_mapping(
    {
        "kind": "chamber",
        "mechanisms": [{"thermal_polynomial": {"degree": 2}}, {"supply_voltage": {"k_deg_h_V": 0.5}}],
        "noise": {"angle_random_walk_deg_sqrt_h": 0.0005},
    }
)


def runs_of(simulator: Simulator, count: int = len(PROGRAMMES)) -> list[Recording]:
    """A run of each of the first programmes."""
    runs = (simulator.simulate(p, seed=k, step_s=20.0, name=f"run{k}") for k, p in enumerate(PROGRAMMES[:count]))
    return [few_monitors(run, "magnetic_field_uT", "pressure_hPa") for run in runs]
