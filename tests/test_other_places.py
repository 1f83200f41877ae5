"""Mechanisms of the temperature may follow another place that has a thermometer: they bear their names and say its column."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pandas as pd
import pytest

from rlgcomp.diagnosis.data import Grid
from rlgcomp.diagnosis.diagnose import diagnose
from rlgcomp.diagnosis.forms.drivers import lagged
from rlgcomp.recording import Metadata, Recording
from rlgcomp.simulation.simulator import Simulator

Array = npt.NDArray[np.float64]
SHELL, BLOCK = "temperature_shell_degC", "temperature_block_degC"
STEP_S = 10.0


def relay(values: Array, up: float, down: float) -> Array:
    """On above one threshold until below the other."""
    on, found = values[0] > up, np.empty(len(values))
    for k, value in enumerate(values):
        on = value > (down if on else up)
        found[k] = on
    return found


def play(values: Array, radius: float) -> Array:
    """What follows once it is pushed, and stays where it is between."""
    at, found = values[0], np.empty(len(values))
    for k, value in enumerate(values):
        at = min(max(at, value - radius), value + radius)
        found[k] = at
    return found


LAWS = {
    "temperature_rate": lambda shell: 0.1 * 60.0 * np.gradient(shell, STEP_S),
    "thermal_hysteresis": lambda shell: 0.01 * play(shell, 6.0),
    "thermal_lag": lambda shell: 0.005 * lagged(shell, STEP_S, 3000.0),
    "mode_hop": lambda shell: 0.1 * relay(shell, 31.0, 29.5),
}


@pytest.mark.parametrize("name", LAWS)
def test_of_the_shell_a_mechanism_bears_its_name_and_says_where(name: str) -> None:
    runs = []
    for k in range(4):
        rng = np.random.default_rng([31, k])
        n = 2400
        time_s = STEP_S * np.arange(n)
        corners = rng.uniform(-1.0, 1.0, 8)
        shell = lagged(20.0 + 30.0 * np.interp(time_s, np.linspace(0.0, time_s[-1], 8), corners), STEP_S, 300.0)
        block = lagged(lagged(shell, STEP_S, 900.0), STEP_S, 600.0)
        gyro = 0.01 * block + LAWS[name](shell) + 0.02 * rng.standard_normal(n)
        table = {"time_s": time_s, "gyro_deg_h": gyro, BLOCK: block, SHELL: shell}
        runs.append(Recording(pd.DataFrame(table), Metadata(kind="chamber"), name=f"run{k}"))
    simulator = Simulator.from_mapping({"kind": "chamber", "mechanisms": [{"thermal_polynomial": {"degree": 1}}]})
    found = diagnose(simulator, runs[:3], test=runs[3:], window_s=2.0 * Grid.of(runs).window_s, black_box=False)
    (finding,) = found.to_mapping()["findings"]
    assert (finding["mechanism"], finding["drivers"]) == (name, [SHELL])
    assert finding["probability"] > 0.95
    recorded = runs[3].rate_deg_h()
    left, before = (float(np.std(one.predict(runs[3]).rate_deg_h() - recorded)) for one in (found.augmented, found.calibrated))
    assert left < 0.022 < before
