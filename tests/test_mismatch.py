"""The p-value of the one model's mismatch is uniform where nothing is missing; what is missing has its place."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy import stats

from rlgcomp.diagnosis.answer.fit import Fit
from rlgcomp.diagnosis.answer.mismatch import parts, screened, statistics, tail_probability
from rlgcomp.diagnosis.data import Data, Grid, Run
from rlgcomp.diagnosis.evidence.bank import Bank
from rlgcomp.diagnosis.evidence.closed_form import Evidence, Member
from rlgcomp.diagnosis.evidence.screen import Layout, Screen
from rlgcomp.diagnosis.forms.bases import Moment, Power, Smooth
from rlgcomp.diagnosis.forms.drivers import Driver, Path
from rlgcomp.diagnosis.forms.memories import Plays
from rlgcomp.diagnosis.forms.terms import Form, Region
from rlgcomp.diagnosis.noise.model import Noise
from rlgcomp.diagnosis.regions.baseline import Baseline
from rlgcomp.diagnosis.search.states import State
from rlgcomp.simulation.simulator import Simulator

SIMULATOR = Simulator.from_mapping({"kind": "chamber", "mechanisms": ["thermal_polynomial"]})


@pytest.fixture(scope="module")
def data() -> Data:
    recording = SIMULATOR.simulate("start 20, hold 60, ramp 40 1, hold 60, ramp 0 1, hold 30", seed=1, step_s=20.0)
    run = Run.of(recording, Grid.of([recording]), lambda binned: 0.0 * binned.time_s)
    return Data((dataclasses.replace(run, output=np.random.default_rng(2).standard_normal(len(run.output))),))


def regions_of(data: Data) -> list[Region]:
    path, temperature = (Path(Driver.of(data, column)) for column in ("supply_voltage_V", "temperature_block_degC"))
    plays = [(Plays(temperature.driver, r, spread=False),) for r in (0.1, 0.2, 0.3, 0.4, 0.6)]
    line = Form("line", "b = k u", (Power(path),), (Smooth(path, 0.5, 8),))
    loops = tuple(Form("loop", "b = play", lead, (Smooth(temperature, 0.5, 8),)) for lead in plays)
    return [Region("line", None, -3.0, (line,)), Region("loop", None, -3.0, loops)]


def test_statistic_is_the_evidence_of_the_best_form(data: Data) -> None:
    bank, forms = Bank(data, np.ones((len(data), 1))), [form for region in regions_of(data) for form in region.forms]
    bank.prepare(forms)
    evidence = Evidence(bank, Noise(flicker=0.35), 0.0)
    screen = Screen(evidence, Layout(bank, forms))
    given = evidence.given(())
    best = float((screen.gains(given) - given.log_evidence).max())
    assert statistics(screen, np.zeros(len(forms)), evidence.output[:, None]) == pytest.approx([best])


def test_p_values_of_noise_are_uniform(data: Data) -> None:
    found, rng = [], np.random.default_rng(5)
    forms = [form for region in regions_of(data) for form in region.forms]
    for k in range(80):
        drawn = Data((dataclasses.replace(data.runs[0], output=rng.standard_normal(len(data))),))
        bank = Bank(drawn, np.ones((len(data), 1)))
        bank.prepare(forms)
        screen = Screen(Evidence(bank, Noise(), 0.0), Layout(bank, forms))
        found.append(screened(screen, np.array([form.log_share for form in forms]), draws=100, seed=k))
    assert stats.kstest(found, "uniform").pvalue > 0.01


def test_tail_goes_on_beyond_the_draws() -> None:
    drawn = np.random.default_rng(3).exponential(1.0, 400)
    assert tail_probability(2.0, drawn) == pytest.approx(np.exp(-2.0), abs=0.04)
    assert np.log(tail_probability(20.0, drawn)) == pytest.approx(-20.0, rel=0.3)


def test_a_step_is_missing_from_its_moment_on(data: Data) -> None:
    run = data.runs[0]
    at_s = 0.75 * run.elapsed_s[-1]
    form = Form("step", "b = step", (Moment(run.name, at_s, run.grid.window_s, (0.0, float(run.elapsed_s[-1]))),))
    stepped = dataclasses.replace(run, output=run.output + 8.0 * (run.means(run.elapsed_s) > at_s))
    of_step = Data((stepped,))
    baseline = Baseline(Simulator.from_mapping({"kind": "chamber", "mechanisms": []}))
    bank = Bank(of_step, baseline.design(of_step))
    bank.prepare([form])
    states = [State(members, Noise(), 0.0) for members in ((), (Member(form, 5.4),))]
    before, after = (Fit(of_step, baseline, bank, state) for state in states)
    interval, *regimes = sorted(parts(before, after, Driver.of(data, "temperature_block_degC")), key=lambda one: one.regime or "")
    assert interval.start_s > 0.4 * run.elapsed_s[-1]
    assert sum(one.share for one in regimes) == pytest.approx(1.0)
