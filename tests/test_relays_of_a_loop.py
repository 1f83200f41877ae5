"""Hysteresis of few relays, each with a level of its own: of the temperature, and of a monitor."""

from __future__ import annotations

import dataclasses
import itertools
import math

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.ndimage import gaussian_filter1d

import rlgcomp as rlg
from rlgcomp.diagnosis import priors
from rlgcomp.diagnosis.data import Grid
from rlgcomp.diagnosis.diagnose import Diagnosis, diagnose
from rlgcomp.diagnosis.forms.drivers import Driver
from rlgcomp.diagnosis.forms.memories import Relays
from rlgcomp.diagnosis.forms.terms import Form, log_odds_of_more
from rlgcomp.diagnosis.regions.loops import as_hops, as_relays
from rlgcomp.numerics.relays import Start
from tests.few_monitors import few_monitors

Array = npt.NDArray[np.float64]
PROGRAMMES = (
    "start 20, hold 30, ramp -10 1, hold 60, ramp 40 1, hold 60, ramp 5 1, hold 60",
    "start 30, hold 50, ramp 0 1, hold 60, ramp 35 1, hold 60, ramp -5 1, hold 60",
    "start 25, hold 60, ramp 45 1, hold 60, ramp -10 1, hold 60",
)


def loop(values: Array, up: Array, down: Array, weights: Array) -> Array:
    """Relays of some weights after a rest, minus or plus one half each."""
    rows = np.arange(len(values))[:, None]
    on, off = values[:, None] >= up, values[:, None] <= down
    last = np.maximum.accumulate(np.where(on | off, rows, -1), axis=0)
    state = np.where(last < 0, values[0] >= 0.5 * (up + down), np.take_along_axis(on, np.maximum(last, 0), axis=0))
    return np.asarray((state - 0.5) @ weights)


def diagnosed(column: str, up: Array, down: Array, weights: Array, windows: float = 3.0) -> Diagnosis:
    """Of two runs with such a loop of a column, tested on a third."""
    noise = {"angle_random_walk_deg_sqrt_h": 3e-4}
    simulator = rlg.Simulator.from_mapping({"kind": "chamber", "mechanisms": ["thermal_polynomial"], "noise": noise})
    runs = []
    for k, programme in enumerate(PROGRAMMES):
        run = simulator.simulate(programme, seed=k, step_s=10.0, name=f"run{k}")
        drawn = gaussian_filter1d(np.random.default_rng(80 + k).standard_normal(len(run)), 60.0)
        pressure = 1000.0 + 20.0 * drawn / np.std(drawn)
        table = run.table.assign(pressure_hPa=pressure, gyro_deg_h=run.rate_deg_h())
        table["gyro_deg_h"] += loop(table[column].to_numpy(), up, down, weights)
        runs.append(few_monitors(run.replace(table=table, truth=None), column))
    fitted = rlg.Simulator.from_mapping({"kind": "chamber", "mechanisms": [{"thermal_polynomial": {"degree": 3}}]})
    return diagnose(fitted, runs[:2], runs[2:], window_s=windows * Grid.of(runs).window_s, black_box=False)


def test_two_relays_far_apart_may_be_hops_or_a_hysteresis() -> None:
    """They were told as a hysteresis with certainty: a ladder had one dead band. No run of the temperature parts the two."""
    up, down, weights = np.array([18.0, 36.0]), np.array([12.5, 27.0]), np.array([0.03, 0.02])
    found = diagnosed("temperature_block_degC", up, down, weights, windows=2.0)
    (cause,) = found.causes
    assert {cause.name, *cause.indistinguishable_from} == {"thermal_hysteresis", "mode_hop"}
    assert min(found.posterior.of_region("mode_hop"), found.posterior.of_region("thermal_hysteresis")) > 0.02
    assert found.test is not None
    assert found.test.augmented_rms < 1.2 * found.test.noise_floor_rms


def test_few_relays_are_found_one_by_one() -> None:
    """They were told as jumps between levels of their own: a search from a coarse plane stopped at two relays."""
    found = diagnosed(
        "temperature_block_degC",
        np.array([31.0, 27.0, 18.0, 24.0]),
        np.array([9.0, 19.0, -2.0, 1.0]),
        np.array([0.03, -0.02, 0.015, 0.02]),
    )
    assert found.verdict == "explained"
    assert [cause.name for cause in found.causes] == ["thermal_hysteresis"]
    assert found.test is not None
    assert found.test.augmented_std < 1.5 * found.test.noise_floor_rms
    assert found.file_rms == pytest.approx(found.test.augmented_rms, rel=0.2)


def test_relays_of_a_monitor_are_a_law_of_that_monitor() -> None:
    """They were told as a slow error of no recorded column."""
    found = diagnosed(
        "pressure_hPa", np.array([1012.0, 1024.0, 1001.0]), np.array([990.0, 1004.0, 975.0]), np.array([0.03, 0.02, -0.025])
    )
    content = found.to_mapping()["unexplained"]
    assert found.verdict == "unknown"
    assert (content["drivers"], content["memory"]) == (["pressure_hPa"], "rate-independent")
    assert not found.decision.wander
    assert found.test is not None
    assert found.test.augmented_rms < 2.0 * found.test.noise_floor_rms


def relay(up: float, down: float, start: Start = "below") -> Relays:
    driver = Driver(("temperature_block_degC",), centre=20.0, half=25.0)
    return Relays(driver, (up,), (down,), start, begins=(("run0", 0.1),))


def form(region: str, *lead: Relays) -> Form:
    return Form(region, "b = relays", lead, log_share=-3.0)


@given(count=st.integers(1, 3), band=st.floats(0.15, 0.5))
def test_relays_of_one_dead_band_are_a_ladder_and_a_hysteresis_alike(count: int, band: float) -> None:
    """Which of the two a likelier form is follows from their priors alone: the columns are the same."""
    levels = [-0.7 + 0.6 * k for k in range(count)]
    one_loop = form("thermal_hysteresis", dataclasses.replace(relay(0.0, 0.0), narrowest=priors.NARROWEST_LOOP))
    hops = form("mode_hop", *(relay(level, level - band) for level in levels))
    as_loop = as_relays(one_loop, hops)
    assert as_loop is not None
    assert [(r.up, r.down, r.start, r.opposite) for r in as_loop.lead] == [(r.up, r.down, r.start, r.opposite) for r in hops.lead]
    assert as_loop.log_share == pytest.approx(-3.0 + log_odds_of_more(1, len(levels) - 1, priors.RELAYS))
    again = as_hops(form("mode_hop", relay(0.0, 0.0)), as_loop)
    assert again is not None
    assert [(r.up, r.down) for r in again.lead] == [(r.up, r.down) for r in hops.lead]
    assert all(r.narrowest <= r.up[0] - r.down[0] <= r.widest for r in again.lead)


@pytest.mark.parametrize("members", [1, 2, 3, 4])
def test_members_of_a_form_have_no_order(members: int) -> None:
    """Of all ways to draw so many places one after the other, those that give one set of places are counted one by one."""
    places, wanted = 6, set(range(members))
    drawn = [set(draw) == wanted for draw in itertools.product(range(places), repeat=members)]
    of_number = priors.MORE_STEPS**members
    assert log_odds_of_more(0, members, places) == pytest.approx(math.log(of_number * np.mean(drawn)))


@given(members=st.integers(1, 30), more=st.integers(1, 10), places=st.integers(1, 1000))
def test_a_member_more_and_one_less_are_as_likely_as_before(members: int, more: int, places: int) -> None:
    there = log_odds_of_more(members, more, places)
    assert there == pytest.approx(sum(log_odds_of_more(members + k, 1, places) for k in range(more)), abs=1e-9)
    assert there + log_odds_of_more(members + more, -more, places) == pytest.approx(0.0, abs=1e-9)


def test_wide_dead_bands_of_a_ladder_overlap_none_and_none_is_wider_than_half_of_half_the_range() -> None:
    single, narrow = form("mode_hop", relay(0.0, 0.0)), priors.NARROWEST_LOOP
    assert as_hops(single, form("thermal_hysteresis", relay(0.3, 0.0), relay(0.5, 0.2))) is None
    assert as_hops(single, form("thermal_hysteresis", relay(0.3, 0.0), relay(0.5, -0.3))) is None
    assert as_hops(single, form("thermal_hysteresis", relay(0.3, -0.3))) is None
    alone = as_hops(single, form("thermal_hysteresis", relay(0.3, 0.15)))
    assert alone is not None
    assert alone.lead[0].widest == priors.WIDEST_OF_ONE  # type: ignore[attr-defined]
    widened = as_relays(
        form("thermal_hysteresis", dataclasses.replace(relay(0.0, 0.0), narrowest=narrow)), form("", relay(0.3, 0.29))
    )
    assert widened is not None
    assert widened.lead[0].up[0] - widened.lead[0].down[0] == pytest.approx(narrow)  # type: ignore[attr-defined]
