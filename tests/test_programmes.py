"""Programmes that a chamber can run, as recordings show it or as the user states it."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

import rlgcomp as rlg
from rlgcomp.diagnosis.next_experiment.programmes import LONGEST_S, ChamberRange, chamber_programmes
from rlgcomp.simulation.programme import PRESETS, Hold, Programme, Ramp

BASE = rlg.Simulator((rlg.CATALOGUE["thermal_polynomial"](),))
ONE_RAMP = "start 20, hold 30, ramp 50 1, hold 60, ramp 20 1, hold 30"


def test_no_step_of_a_programme_is_empty() -> None:
    cold_start = BASE.simulate("start -30, hold 20, ramp 45 0.5, hold 20, ramp -30 0.5, hold 20", step_s=10.0)
    for run in (cold_start, cold_start.replace(metadata=rlg.Metadata())):
        found = chamber_programmes([run])
        assert found
        for programme in found:
            at = programme.start_degC
            for step in programme.steps:
                if isinstance(step, Ramp):
                    assert abs(step.to_degC - at) > 0.4
                    at = step.to_degC
            assert not any(isinstance(a, Hold) and isinstance(b, Hold) for a, b in itertools.pairwise(programme.steps))
    longest_cycle = chamber_programmes([cold_start])[0]
    assert str(longest_cycle).endswith("hold 120")
    assert longest_cycle.duration_s == pytest.approx(60.0 * (30.0 + 60.0 + 120.0 + 2.0 * 75.0 / 0.5), rel=0.02)


def test_chamber_programmes_stay_within_what_was_recorded() -> None:
    told = BASE.simulate("start 15, hold 20, ramp 40 0.8, hold 20, ramp -10 0.8, hold 20", step_s=10.0)
    silent = told.replace(metadata=rlg.Metadata())
    for run in (told, silent):
        found = chamber_programmes([run])
        assert len(found) >= 8
        for programme in found:
            assert -12.0 <= programme.corners[1].min()
            assert programme.corners[1].max() <= 42.0
            assert max(step.rate_degC_min for step in programme.steps if isinstance(step, Ramp)) <= 0.85
            assert Programme.parse(str(programme)) == programme


def test_programmes_are_in_numbers_that_can_be_set() -> None:
    """Thermometers that err, and a chamber that does not quite follow: whole degrees, two digits of a rate, nothing beyond."""
    told = BASE.simulate("start 0, hold 20, ramp 40 0.5, hold 20, ramp -10 0.5, hold 20, ramp 0 0.5", step_s=10.0)
    odd = told.table.assign(temperature_block_degC=0.971 * told.column("temperature_block_degC") + 0.00312)
    for programme in chamber_programmes([rlg.Recording(odd, rlg.Metadata(kind="chamber"), name="odd")]):
        if str(programme) in PRESETS.values():
            continue
        ramps = [step for step in programme.steps if isinstance(step, Ramp)]
        assert all(value == round(value) for value in (programme.start_degC, *(ramp.to_degC for ramp in ramps)))
        assert all(ramp.rate_degC_min == float(f"{ramp.rate_degC_min:.2g}") <= 0.5 for ramp in ramps)
        assert odd["temperature_block_degC"].min() - 0.1 <= programme.corners[1].min()
        assert programme.corners[1].max() <= odd["temperature_block_degC"].max() + 0.1
        assert "-0," not in str(programme)
    narrow = odd.assign(temperature_block_degC=20.0 + 0.08 * odd["temperature_block_degC"])
    few_degrees = chamber_programmes([rlg.Recording(narrow, rlg.Metadata(kind="chamber"), name="narrow")])
    assert few_degrees[0].start_degC == 20.0
    assert all(10.0 * one.corners[1][1:] == pytest.approx(np.rint(10.0 * one.corners[1][1:])) for one in few_degrees)


def test_a_slow_chamber_goes_less_far() -> None:
    """Runs that only heat, at 0.2 K/min."""
    heating = ("start 20, hold 60, ramp 60 0.2, hold 60", "start -10, hold 60, ramp 40 0.2, hold 60")
    made = chamber_programmes([BASE.simulate(text, seed=k, step_s=10.0) for k, text in enumerate(heating)])
    assert len(made) >= 8
    assert all(programme.duration_s <= LONGEST_S for programme in made)
    assert min(np.ptp(programme.corners[1]) for programme in made) >= 10.0


def test_what_a_chamber_can_do_may_be_stated() -> None:
    runs = [BASE.simulate(ONE_RAMP, step_s=10.0)]
    wider = chamber_programmes(runs, ChamberRange.of((-40, 70, 2)))
    ends = [temperature for programme in wider for temperature in programme.corners[1]]
    assert (min(ends), max(ends)) == (-40.0, 70.0)
    assert max(step.rate_degC_min for one in wider for step in one.steps if isinstance(step, Ramp)) == 2.0
    narrow = chamber_programmes(runs, ChamberRange.of((25, 40, 0.5)))
    assert all(25.0 - 2.0 <= one.corners[1].min() and one.corners[1].max() <= 40.0 + 2.0 for one in narrow)
    for wrong in ((70, -40, 2), (-40, 70, 0), (-40, np.inf, 2), (-40, 70)):
        with pytest.raises(rlg.InputError, match="as -40 70 2"):
            ChamberRange.of(wrong)
    with pytest.raises(rlg.InputError, match="the chamber's range is 70 -40 2"):
        rlg.diagnose(BASE, runs, chamber=(70, -40, 2))
