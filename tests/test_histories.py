"""What relays and plays remember of the runs before a run."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rlgcomp.diagnosis import priors
from rlgcomp.diagnosis.data import Data, Grid, Run
from rlgcomp.diagnosis.diagnose import diagnose
from rlgcomp.diagnosis.forms.bases import EachRun
from rlgcomp.diagnosis.forms.drivers import Driver
from rlgcomp.diagnosis.forms.histories import after_rest, one_after_the_other, sides
from rlgcomp.diagnosis.forms.memories import (
    Plays,
    Preisach,
    Relays,
    Undecided,
    dense,
    plane,
    relays,
    rest_of,
)
from rlgcomp.diagnosis.forms.terms import Form
from rlgcomp.diagnosis.regions.loops import one_history, rougher
from rlgcomp.diagnosis.regions.selections import OnlyIn
from rlgcomp.numerics.hysteresis import play_paths
from rlgcomp.numerics.relays import Switches, relay_states, states_after, states_before, turning_points
from rlgcomp.recording import Recording
from rlgcomp.simulation.simulator import Simulator
from tests.few_monitors import few_monitors

PROGRAMMES = (
    "start 20, ramp -30 1.5, hold 20, ramp 50 1.5, hold 20, ramp 10 1, hold 20",
    "start 10, ramp 35 1, hold 20, ramp -5 1, hold 20",
    "start -5, ramp 20 1, hold 20, ramp 0 1, hold 20",
)


@settings(max_examples=60, deadline=None)
@given(path=st.lists(st.floats(-1.5, 1.5), min_size=1, max_size=30))
def test_turning_points_leave_relays_as_the_path_does(path: Sequence[float]) -> None:
    up, down = plane(16)
    first = np.full(len(up), 0.5)
    found = turning_points(np.array(path), 0.0)
    np.testing.assert_array_equal(states_after(found, up, down, first), states_after(path, up, down, first))
    swings = np.abs(np.diff(found))
    assert np.all(np.diff(swings[: len(swings) - 1]) <= 0.0)


@pytest.mark.parametrize("numba", ["1", "0"])
@pytest.mark.parametrize("start", ["rested", "above", "unknown"])
def test_sums_over_switches_are_those_over_states(numba: str, start: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("RLGCOMP_NUMBA", numba)
    rng = np.random.default_rng(3)
    values = np.repeat(np.cumsum(rng.standard_normal(60)) / 6.0, [1] * 40 + [3] * 20)
    up, down = dense(12)
    weights = rng.standard_normal((len(up), 3))
    one, other = (states_before(values[0], up, down, name) for name in (start, "below"))
    states, rest = (relay_states(values, up, down, first) for first in (one, other))
    switches = Switches.of(values, up, down, one)
    assert len(switches.changes) < 0.2 * states.size
    np.testing.assert_allclose(switches.sums(weights), states @ weights, atol=1e-12)
    less = switches.less(Switches.of(values, up, down, other))
    np.testing.assert_allclose(less.sums(weights), (states - rest) @ weights, atol=1e-12)


def test_least_swings_are_left_out() -> None:
    path = np.r_[0.0, 1.0, -1.0, 0.5, 0.5 + 0.01 * np.sin(np.arange(20))]
    assert len(turning_points(path, 0.05)) == 3
    assert len(turning_points(path, 0.0)) > 3


@pytest.fixture(scope="module")
def recordings() -> list[Recording]:
    plant = Simulator.from_mapping({"kind": "chamber", "mechanisms": ["thermal_polynomial"]})
    return [plant.simulate(p, seed=k, step_s=10.0, name=f"run{k}") for k, p in enumerate(PROGRAMMES)]


def data_of(recordings: Sequence[Recording]) -> Data:
    grid = Grid.of(recordings)
    return Data(tuple(Run.of(one, grid, lambda binned: np.zeros(len(binned))) for one in recordings))


def test_runs_one_after_the_other_are_one_long_run(recordings: list[Recording]) -> None:
    data = data_of(recordings)
    driver = Driver.of(data, "temperature_block_degC")
    histories = one_after_the_other(driver, data.runs)
    assert [name for name, _ in histories] == ["run0", "run1", "run2", ""]
    assert histories[0][1] == ()
    up, down = plane(24, 1.0)
    long = np.concatenate([driver.values(run) for run in data.runs])
    states = relay_states(long, up, down, np.full(len(up), 0.5))
    for run, (_, turns), end in zip(data.runs, histories[:3], np.cumsum([run.bins for run in data.runs]), strict=True):
        first = states_after(turns, up, down, np.full(len(up), 0.5))
        own = relay_states(driver.values(run), up, down, first)
        np.testing.assert_array_equal(own[1:-1], states[end - run.bins + 1 : end - 1])  # shares of the end bins apart


def test_a_further_run_begins_where_the_last_ended_in_the_file_of_the_simulator_as_well(recordings: list[Recording]) -> None:
    *earlier, last = recordings
    data = data_of(earlier)
    driver = Driver.of(data, "temperature_block_degC")
    histories = one_after_the_other(driver, data.runs)
    further = Run.of(last, Grid.of(recordings), lambda binned: np.zeros(len(binned)))
    basis = Preisach(driver, 0.6, False, start="unknown", histories=histories)
    expected = basis.columns(further)[:, 0]
    up, down = dense(basis.levels)
    weights, values = basis.densities()[:, 0], driver.values(further)
    found = np.zeros(further.bins)
    for start, rows in sides(up, down, basis.start, histories).items():
        first = states_before(values[0], up[rows], down[rows], start)
        found += (relay_states(values, up[rows], down[rows], first) - 0.5) @ weights[rows]
    np.testing.assert_allclose(found, expected, atol=1e-3 * np.ptp(expected))
    rested = Preisach(driver, 0.6, False).columns(further)[:, 0]
    assert np.max(np.abs(rested - expected)) > 0.05 * np.ptp(expected)


@pytest.mark.parametrize("spread", [True, False])
def test_a_play_goes_on_from_the_run_before(recordings: list[Recording], spread: bool) -> None:
    data = data_of(recordings)
    driver = Driver.of(data, "temperature_block_degC")
    histories = one_after_the_other(driver, data.runs)
    alone, after = (Plays(driver, 0.4, spread, "rested", known) for known in ((), histories))
    np.testing.assert_array_equal(alone.columns(data.runs[0]), after.columns(data.runs[0]))
    (radius,) = alone.radii()[-1:]
    values = np.concatenate([driver.values(run) for run in data.runs[:2]])
    state, path = values[0], []
    for value in values:
        state = min(max(state, value - radius), value + radius)
        path.append(state - value)
    if not spread:
        np.testing.assert_allclose(after.columns(data.runs[1])[:, 0], path[data.runs[0].bins :], atol=1e-2)
    assert np.max(np.abs(alone.columns(data.runs[1]) - after.columns(data.runs[1]))) > 0.05


@pytest.mark.parametrize("rest", [-0.7, 0.1, 0.9])
def test_a_rest_elsewhere_is_a_way_from_there_to_the_first_value(recordings: list[Recording], rest: float) -> None:
    data = data_of(recordings)
    driver = Driver.of(data, "temperature_block_degC")
    run = data.runs[1]
    values = driver.values(run)
    path = np.r_[np.linspace(rest, values[0], 40), values]
    play = Plays(driver, 0.4, False, histories=after_rest(rest))
    state, expected = rest, []
    for value in path:
        state = min(max(state, value - 0.4), value + 0.4)
        expected.append(state - value)
    np.testing.assert_allclose(play.columns(run)[:, 0], expected[40:], atol=1e-12)
    density = Preisach(driver, 0.6, False, levels=20, histories=after_rest(rest))
    up, down = dense(20)
    on = (rest >= 0.5 * (up + down)).astype(float)
    whole = (relay_states(path, up, down, on) - 0.5) @ density.densities()
    np.testing.assert_allclose(density.columns(run)[1:], whole[41:], atol=1e-6 * np.ptp(whole))
    assert rest_of(play) == pytest.approx(driver.centre + driver.half * rest)


def test_a_unit_that_rests_in_the_laboratory_before_each_run_is_predicted() -> None:
    """Histories of their own, or one run after the other, fitted the training runs as well and left all of a further run."""
    noise = {"angle_random_walk_deg_sqrt_h": 4e-4}
    plant = Simulator.from_mapping({"kind": "chamber", "mechanisms": ["thermal_polynomial"], "noise": noise})
    runs = []
    for k, programme in enumerate(PROGRAMMES):
        run = plant.simulate(programme, seed=40 + k, step_s=20.0, name=f"run{k}")
        block, radii = run.column("temperature_block_degC"), np.linspace(2.0, 30.0, 15)
        path = np.r_[np.linspace(23.0, block[0], 50), block]
        plays = play_paths(path[:, None], radii, np.full(15, 23.0))[50:].mean(axis=1)
        runs.append(run.replace(table=run.table.assign(gyro_deg_h=run.rate_deg_h() + 2e-3 * (plays - block)), truth=None))
    fitted = Simulator.from_mapping({"kind": "chamber", "mechanisms": [{"thermal_polynomial": {"degree": 3}}]})
    *train, test = (few_monitors(run) for run in runs)
    found = diagnose(fitted, train, [test], window_s=2.5 * Grid.of(train).window_s, black_box=False)
    assert [cause.name for cause in found.causes] == ["thermal_hysteresis"]
    assert found.test is not None
    assert found.test.augmented_rms < 1.3 * found.test.noise_floor_rms
    assert found.file_rms == pytest.approx(found.test.augmented_rms, rel=0.1)
    (rested,) = (one for one in found.remarks if one.code == "diagnosis.rested")
    assert abs(rested.data["value"] - 23.0) < 5.0


@pytest.mark.parametrize(("compiled", "every"), [("1", 1), ("0", 8)])
def test_relays_are_summed_from_their_switches(
    recordings: list[Recording], compiled: str, every: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also on runs of fewer rows, without compiled code."""
    monkeypatch.setenv("RLGCOMP_NUMBA", compiled)
    runs = [run.replace(table=run.table.iloc[::every].reset_index(drop=True), truth=None) for run in recordings]
    data, rng = data_of(runs), np.random.default_rng(0)
    driver, names = Driver.of(data, "temperature_block_degC"), ("run0", "run2")
    smooth = Preisach(driver, 0.4, True, 0.6, 16, start="unknown", histories=one_after_the_other(driver, data.runs))
    for run in data.runs:
        before = dict(smooth.histories)[run.name]
        states = relays(driver.values(run), *dense(16), "unknown", before)
        np.testing.assert_allclose(smooth.columns(run), (states - 0.5) @ smooth.densities(), atol=1e-9)
        for basis in (smooth, Undecided(driver, 1.5, 16, 4), EachRun(Undecided(driver, 0.7, 16), names), OnlyIn(smooth, names)):
            columns = basis.columns(run)
            weights = rng.standard_normal(columns.shape[1])
            np.testing.assert_allclose(basis.weighted(run, weights), columns @ weights, atol=1e-9)


def test_departures_of_each_relay_go_on_from_the_history_of_their_density(recordings: list[Recording]) -> None:
    data = data_of(recordings)
    driver = Driver.of(data, "temperature_block_degC")
    histories = one_after_the_other(driver, data.runs)
    smooth = Preisach(driver, 0.4, True, 0.6, start="unknown", histories=histories)
    form = rougher(Form("loop", "relays of smooth density", (smooth,), (Preisach(driver, 0.7, True, 1.0),)))
    assert form is not None
    (rough,) = form.smooth
    up, down = dense(priors.ROUGH_LEVELS)
    within = np.maximum(np.abs(up), np.abs(down)) <= 1.0
    for run in data.runs:
        states = relays(driver.values(run), up, down, "unknown", dict(histories)[run.name])
        np.testing.assert_allclose(rough.columns(run), states[:, within] - 0.5, atol=1e-9)


def test_the_same_basis_with_another_history_is_computed_anew(recordings: list[Recording]) -> None:
    data = data_of(recordings)
    driver = Driver.of(data, "temperature_block_degC")
    run, half = data.runs[2], 0.8
    columns = [
        Preisach(driver, 0.4, True, 0.6, start="unknown", histories=histories).columns(run)
        for histories in ((), (("run2", (-half, half)),), (("run2", (half, -half)),))
    ]
    assert len({table.tobytes() for table in columns}) == 3


def test_single_relays_share_what_was_before_the_runs(recordings: list[Recording]) -> None:
    """A relay that no run has switched yet stands, in a further run, where the runs before it left it."""
    data = data_of(recordings[:2])
    further = Run.of(recordings[2], Grid.of(recordings), lambda binned: np.zeros(len(binned)))
    driver = Driver.of(data, "temperature_block_degC")
    begins = tuple((run.name, float(driver.values(run)[0])) for run in data.runs)
    band = Relays(driver, (0.9,), (-0.9,), narrowest=0.1, begins=begins)
    form = Form("thermal_hysteresis", "", (dataclasses.replace(band, opposite=("run1",)),))
    own, *others = one_history(data.runs)(form)
    relays_alike = [one.lead[0] for one in others if isinstance(one.lead[0], Relays)]
    assert own.lead == form.lead
    assert len(relays_alike) == len(others)
    free = sum(-0.9 < first < 0.9 for _, first in begins)
    assert own.log_share == pytest.approx(form.log_share - free * np.log(2.0))
    assert form.lead[0].columns(further)[0, 0] == 0.5  # by itself, nothing is known of a further run
    assert {float(relay.columns(further)[0, 0]) for relay in relays_alike} == {0.0, 1.0}
    (followed,) = (relay for relay in relays_alike if len(relay.histories) == 3)
    long = np.concatenate([driver.values(run) for run in (*data.runs, further)])
    for start in (0.0, 1.0):
        states = relay_states(long, np.array([0.9]), np.array([-0.9]), np.array([start]))
        if states[0, 0] == followed.columns(data.runs[0])[0, 0]:
            np.testing.assert_array_equal(followed.columns(further)[2:, 0], states[-further.bins :][2:, 0])
    assert one_history(data.runs)(Form("", "", (Preisach(driver, 0.6, False, levels=20),))) == []
