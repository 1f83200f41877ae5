"""What the search may not stop at: a set beside which no single step leads to the likelier one."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt
import pandas as pd
import pytest
from scipy import signal

import rlgcomp as rlg
from rlgcomp.diagnosis.answer.posterior import Posterior
from rlgcomp.diagnosis.decide import decided
from rlgcomp.diagnosis.evidence.closed_form import Member
from rlgcomp.diagnosis.forms.bases import Smooth
from rlgcomp.diagnosis.forms.drivers import Driver, Path
from rlgcomp.diagnosis.forms.terms import Form, Region
from rlgcomp.diagnosis.noise.model import Noise
from rlgcomp.diagnosis.search.states import State

Array = npt.NDArray[np.float64]
STEP_S, HOURS = 20.0, 6.0
NOISE_DEG_H = 4e-3
CUBIC = {"c1_deg_h_K": 1e-2, "c2_deg_h_K2": 2e-4, "c3_deg_h_K3": 0.0}


def monitors(rng: np.random.Generator) -> pd.DataFrame:
    """Two thermometers, of which the shell leads the block, and a supply voltage."""
    time_s = np.arange(0.0, HOURS * 3600.0, STEP_S)
    shell = np.interp(time_s, np.linspace(0.0, time_s[-1], 9), rng.uniform(-20.0, 55.0, 9)) + 3.0 * np.sin(time_s / 2500.0)
    keep = math.exp(-STEP_S / 900.0)
    block, _ = signal.lfilter([1.0 - keep], [1.0, -keep], shell, zi=[keep * shell[0]])
    supply = 15.0 + 0.02 * np.interp(time_s, np.linspace(0.0, time_s[-1], 14), rng.uniform(-1.5, 1.5, 14))
    columns = {"temperature_block_degC": block, "temperature_shell_degC": shell, "supply_voltage_V": supply}
    return pd.DataFrame({"time_s": time_s, **columns})


def run(name: str, table: pd.DataFrame, gyro_deg_h: Array, rng: np.random.Generator) -> rlg.Recording:
    noisy = gyro_deg_h + NOISE_DEG_H * rng.standard_normal(len(table))
    return rlg.Recording(table.assign(gyro_deg_h=noisy), name=name)


def cubic(table: pd.DataFrame) -> Array:
    warm = table["temperature_block_degC"].to_numpy() - 20.0
    return np.asarray(CUBIC["c1_deg_h_K"] * warm + CUBIC["c2_deg_h_K2"] * warm**2)


def test_a_process_that_jumps_a_few_times_is_no_steps_of_the_bias() -> None:
    """Each step of the bias is one likelier set, and beside steps nothing is left that jumps."""
    rng, runs = np.random.default_rng(3), []
    for name, jumps_h in (("first", (1.3, 2.1, 2.6)), ("second", (1.6, 3.4, 4.7)), ("held out", (0.9, 3.0))):
        table = monitors(rng)
        above = np.maximum(table["supply_voltage_V"].to_numpy() - 15.01, 0.0)
        hours = table["time_s"].to_numpy() / 3600.0
        path = 0.004 * (-1.0) ** sum((hours > at).astype(int) for at in jumps_h)
        runs.append(run(name, table, cubic(table) + 2.0 * above + path, rng))
    simulator = rlg.Simulator((rlg.CATALOGUE["thermal_polynomial"](**CUBIC),)).with_own_amplitudes_free()
    found = rlg.diagnose(simulator, runs[:2], test=runs[2:], black_box=False)
    assert sorted(one.name for one in found.causes) == ["random_telegraph", "supply_voltage"]
    assert not found.laws


def test_a_gradient_beside_a_wrong_number_is_no_law_between_two_thermometers() -> None:
    """One smooth law of both thermometers follows both, and no step over either alone leads to the pair."""
    rng, runs = np.random.default_rng(5), []
    for name in ("first", "second", "third", "held out"):
        table = monitors(rng)
        apart = (table["temperature_block_degC"] - table["temperature_shell_degC"]).to_numpy()
        runs.append(run(name, table, cubic(table) + 4e-3 * apart, rng))
    stated = CUBIC | {"c2_deg_h_K2": 1e-4}
    simulator = rlg.Simulator((rlg.CATALOGUE["thermal_polynomial"](**stated),))
    found = rlg.diagnose(simulator, runs[:3], test=runs[3:], black_box=False)
    assert [one.name for one in found.causes] == ["thermal_gradient"]
    assert not found.laws


@pytest.mark.parametrize("departs", [False, True])
def test_a_small_member_is_a_form_of_mechanisms_alone_that_no_form_lets_depart(departs: bool) -> None:
    """Where a region has forms with departures the model has weighed them, and what is beside an exact one stands."""
    smooth = (Smooth(Path(Driver(("T",)))),)
    forms = (Form("thermal_lag", "departing", (), smooth if departs else ()),)
    regions = {
        "thermal_lag": Region("thermal_lag", "thermal_lag", 0.0, forms, ("T",), "dynamic"),
        "rate_asymmetry": Region("rate_asymmetry", "rate_asymmetry", 0.0, (), ("T",), "dynamic"),
    }
    exact = (Member(Form("thermal_lag", "spectrum", smooth), 48.6), Member(Form("rate_asymmetry", "power", ()), 5.4))
    decision = decided(Posterior((State(exact, Noise(), 0.0),), regions))
    assert ("rate_asymmetry" in {one.region for one in decision.named}) == departs
