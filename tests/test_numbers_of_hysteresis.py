"""Numbers of a hysteresis that is told are those of the equation beside them, whatever was before the runs."""

from __future__ import annotations

import dataclasses

import pytest

import rlgcomp as rlg
from rlgcomp.diagnosis.answer.fit import Fit
from rlgcomp.diagnosis.data import Data, Grid, Run
from rlgcomp.diagnosis.equations.parameters import of_mechanism
from rlgcomp.diagnosis.evidence.bank import Bank
from rlgcomp.diagnosis.evidence.closed_form import Member
from rlgcomp.diagnosis.forms.bases import EachRun
from rlgcomp.diagnosis.forms.drivers import Driver
from rlgcomp.diagnosis.forms.memories import Plays, Undecided
from rlgcomp.diagnosis.forms.terms import Form
from rlgcomp.diagnosis.noise.model import Noise
from rlgcomp.diagnosis.regions.baseline import Baseline
from rlgcomp.diagnosis.search.states import State
from rlgcomp.physics.thermal_hysteresis import ThermalHysteresis
from tests.few_monitors import few_monitors

PROGRAMMES = (
    "start 20, hold 20, ramp -20 1, hold 30, ramp 50 1, hold 30, ramp 25 1, hold 20",
    "start 5, hold 20, ramp 40 1, hold 30, ramp 0 1, hold 30, ramp 30 1, hold 20",
)
TRUE = ThermalHysteresis(k1_deg_h_K=0.0, k2_deg_h_K=0.0, k3_deg_h_K=0.003, radius_K=2.5)


BELIEVED = rlg.Simulator.from_mapping(
    {"kind": "chamber", "mechanisms": ["thermal_polynomial"], "noise": {"angle_random_walk_deg_sqrt_h": 5e-4}}
)


def recorded(*starts: str) -> list[rlg.Recording]:
    """Runs of a unit with the loop, each after a history of its own."""
    runs = []
    for k, (programme, start) in enumerate(zip(PROGRAMMES, starts, strict=True)):
        run, mechanism = BELIEVED.simulate(programme, seed=k, step_s=10.0, name=f"run{k}"), dataclasses.replace(TRUE, start=start)
        loop = mechanism.basis(run) @ mechanism.amplitude_values()
        runs.append(few_monitors(run.replace(table=run.table.assign(gyro_deg_h=run.rate_deg_h() + loop), truth=None)))
    return runs


@pytest.mark.parametrize("starts", [("rested", "rested"), ("from_below", "from_above")])
def test_its_numbers_are_those_of_its_equation(starts: tuple[str, str]) -> None:
    """A loop of another law and sign comes near a play, and has fewer amplitudes.

    Relays that a run has not switched yet are beside the play, with weights of their own in each run.
    """
    runs, constant = recorded(*starts), {"kind": "chamber", "mechanisms": [{"thermal_polynomial": {"degree": 0}}]}
    grid = Grid.of(runs)
    data = Data(tuple(Run.of(run, grid, lambda binned: binned.rate_deg_h() - BELIEVED.expected_deg_h(binned)) for run in runs))
    baseline = Baseline(rlg.Simulator.from_mapping(constant))
    bank = Bank(data, baseline.design(data), baseline)
    driver = Driver.of(data, "temperature_block_degC")
    history = () if starts[0] == "rested" else (EachRun(Undecided(driver, 0.7, 40), tuple(run.name for run in runs)),)
    member = Member(Form("thermal_hysteresis", "", (Plays(driver, TRUE.radius_K / driver.half, False), *history)), 20.0)
    found, left = of_mechanism(Fit(data, baseline, bank, State((member,), Noise(), 0.0)), 0, ThermalHysteresis)
    assert not left
    assert set(found) == {"k3_deg_h_K", "radius_K"}
    for name, estimate in found.items():
        assert abs(estimate.value - getattr(TRUE, name)) < 4.0 * estimate.sd
        assert estimate.sd < 0.3 * estimate.value
