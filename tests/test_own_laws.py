"""The very law of a mechanism that the simulator has is no other form of it, and the window of its rate is the simulator's."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd

from rlgcomp.diagnosis.data import Grid
from rlgcomp.diagnosis.diagnose import Diagnosis, diagnose
from rlgcomp.diagnosis.forms.drivers import lagged
from rlgcomp.recording import Metadata, Recording
from rlgcomp.simulation.simulator import Simulator
from tests.few_monitors import FEWER

STEP_S = 10.0


def made(*, coarse_K: float = 0.0, of_rate: float = 0.0, of_field: float = 0.0, of_supply: float = 0.0) -> list[Recording]:
    """Runs of a gyro with errors of a rate of change, a field and a supply; its thermometer reads in steps, and as noisily."""
    runs = []
    for k in range(3):
        rng = np.random.default_rng([11, k])
        n = 2400
        time_s = STEP_S * np.arange(n)
        corners = [-1.0, 1.2, 1.2, -0.5, -0.5, 1.0, -1.0][:: 1 - 2 * (k % 2)]
        block = lagged(20.0 + 30.0 * np.interp(time_s, np.linspace(0.0, time_s[-1], 7), corners), STEP_S, 600.0)
        field, volts = (np.cumsum(rng.standard_normal(n)) / 40.0 for _ in range(2))
        gyro = 0.01 * block + of_rate * 60.0 * np.gradient(block, STEP_S) + of_field * field + 0.02 * rng.standard_normal(n)
        gyro += of_supply * np.tanh(2.0 * volts)
        read = block + coarse_K * rng.standard_normal(n)
        table = {
            "time_s": time_s,
            "gyro_deg_h": gyro,
            "temperature_block_degC": coarse_K * np.round(read / coarse_K) if coarse_K else read,
            "magnetic_field_uT": 30.0 + field,
            "supply_voltage_V": 15.0 + volts,
        }
        runs.append(Recording(pd.DataFrame(table), Metadata(kind="chamber"), name=f"run{k}"))
    return runs


def asked(runs: list[Recording], *mechanisms: Any) -> Diagnosis:
    simulator = Simulator.from_mapping({"kind": "chamber", "mechanisms": [{"thermal_polynomial": {"degree": 1}}, *mechanisms]})
    return diagnose(simulator, runs, window_s=2.0 * Grid.of(runs).window_s, black_box=False, **FEWER)


def names(found: Diagnosis) -> list[str]:
    return sorted(one["mechanism"] for one in found.to_mapping()["findings"])


def test_a_rate_that_the_simulator_has_is_not_found_again_over_another_window() -> None:
    """What is missing decides over which window a coarse thermometer's rate is taken: another one is likelier before."""
    found = asked(made(coarse_K=0.15, of_rate=0.2, of_supply=2.0), "temperature_rate")
    assert names(found) == ["supply_voltage"]
    assert found.verdict == "explained"


def test_a_stated_number_that_is_wrong_is_no_other_form_of_its_mechanism() -> None:
    """Beside an effect as well; it is said with the number that the runs ask for."""
    found = asked(made(of_field=0.03, of_supply=0.2), {"magnetic_field": {"k_deg_h_uT": 0.02}})
    assert names(found) == ["supply_voltage"]
    assert found.recalibration["magnetic_field"]["k_deg_h_uT"].value > 0.025
    others = {form.equation for form in found.posterior.regions["form:magnetic_field"].forms}
    assert others
    assert "b = k (magnetic_field_uT)" not in others


def test_another_form_of_what_the_simulator_has_is_said_as_that() -> None:
    found = asked(made(of_supply=0.5), {"supply_voltage": {}})
    assert names(found) == ["supply_voltage"]
    (finding,) = found.to_mapping()["findings"]
    assert finding["other_form"]
    assert "lacks another form of supply_voltage (" in found.sentence
