"""What makes the one model fast leaves its numbers as they are; and how a hysteresis of relays grows."""

from __future__ import annotations

import dataclasses
import itertools
from typing import Any

import numpy as np
import pandas as pd
import pytest

import rlgcomp as rlg
from rlgcomp.diagnosis import priors
from rlgcomp.diagnosis.data import Data, Grid, Run
from rlgcomp.diagnosis.evidence.bank import Bank
from rlgcomp.diagnosis.forms.drivers import Driver, Path
from rlgcomp.diagnosis.forms.memories import Plays, Preisach, Relays
from rlgcomp.diagnosis.forms.relaxations import Spectrum
from rlgcomp.diagnosis.forms.terms import Form, Region
from rlgcomp.diagnosis.regions.baseline import Baseline
from rlgcomp.diagnosis.regions.chamber import named
from rlgcomp.diagnosis.regions.setting import Setting
from rlgcomp.diagnosis.search.sharpening import Sharpening
from rlgcomp.diagnosis.search.telegraph import two_state
from rlgcomp.numerics.relays import relay_states
from rlgcomp.simulation.simulator import Simulator


def test_equal_bases_have_the_same_hash() -> None:
    driver = Driver(("a",), half=2.0)
    one, other = (Relays(dataclasses.replace(driver), (0.5,), (0.1,)) for _ in range(2))
    assert hash(one) == hash(other)
    assert {one: 1}[other] == 1
    moved = dataclasses.replace(one, up=(0.6,))
    assert hash(moved) != hash(one)
    assert hash(Path(driver)) != hash(driver)


def test_chains_are_joined_as_independent() -> None:
    ratios, flip = [np.array([0.7, -1.2, 0.4]), np.array([2.0, -0.1])], 0.2
    alone = [two_state(ratio, np.full(len(ratio), 1.5), flip) for ratio in ratios]
    likelihood, mean, _, changes = two_state(np.concatenate(ratios), np.full(5, 1.5), flip, np.array([0, 3]))
    assert likelihood == pytest.approx(sum(one[0] for one in alone))
    assert mean == pytest.approx(np.concatenate([one[1] for one in alone]))
    assert changes == pytest.approx(sum(one[3] for one in alone))


def test_a_run_with_another_column_keeps_only_what_does_not_follow_it() -> None:
    simulator = Simulator.from_mapping({"kind": "chamber", "mechanisms": ["thermal_polynomial"]})
    recording = simulator.simulate("start 20, hold 20, ramp 40 1, hold 20", seed=1, step_s=10.0)
    run = Run.of(recording, Grid.of([recording]), lambda binned: binned.rate_deg_h())
    block, volts = (Driver((column,)) for column in ("temperature_block_degC", "supply_voltage_V"))
    plays = Plays(block, 0.3, spread=False)
    before = plays.columns(run), Path(block).values(run), Path(volts).values(run)
    other = run.with_column("temperature_block_degC", run.column("temperature_block_degC") + 1.0)
    assert Path(volts).values(other) is before[2]
    assert Path(block).values(other) == pytest.approx(before[1] + 1.0)
    assert other.binned.column("temperature_block_degC") == pytest.approx(run.binned.column("temperature_block_degC") + 1.0)
    assert plays.columns(other) == pytest.approx(before[0], abs=1e-9)


def test_values_at_rows_are_averaged_over_bins_and_those_after_the_last_window_are_left_out() -> None:
    simulator = Simulator.from_mapping({"kind": "chamber", "mechanisms": ["thermal_polynomial"]})
    recording = simulator.simulate("start 20, hold 20, ramp 40 1, hold 20", seed=1, step_s=1.0)
    recording = recording.replace(table=recording.table.drop(index=np.arange(300, 320)).reset_index(drop=True), truth=None)
    run = Run.of(recording, Grid.of([recording]), lambda binned: binned.rate_deg_h())
    values = np.random.default_rng(0).normal(size=len(recording))
    place = ((recording.time_s - recording.time_s[0] + 0.5 * recording.period_s) // run.grid.bin_s).astype(int)
    filled = [k for k in range(run.bins) if np.any(place == k)]
    assert len(filled) < run.bins
    means = [values[place == k].mean() for k in filled]
    for _ in range(2):  # places of rows are computed once
        assert run.on_bins_of_rows(values) == pytest.approx(np.interp(run.elapsed_s, run.elapsed_s[filled], means), abs=1e-12)


def test_each_recording_of_a_diagnosis_is_brought_onto_the_grid_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Long recordings make that a part that one waits for."""
    names, of = [], Run.of

    def counted(recording: rlg.Recording, *others: Any) -> Run:
        names.append(recording.name)
        return of(recording, *others)

    monkeypatch.setattr(Run, "of", counted)
    simulator = Simulator.from_mapping({"kind": "chamber", "mechanisms": ["thermal_polynomial"]})
    runs = [simulator.simulate("short", seed=seed, step_s=30.0, name=f"run-{seed}") for seed in (1, 2)]
    rlg.diagnose(simulator, runs[:1], runs[1:], only=["temperature_rate"], black_box=False)
    assert sorted(names) == ["run-1", "run-2"]


def region_of(mechanism: str, simulator: Simulator) -> tuple[Region, Run]:
    """The region of a mechanism over one run, and the run."""
    recording = simulator.simulate("start 20, hold 20, ramp 40 1, ramp -10 1, ramp 60 1, hold 20", seed=1, step_s=10.0)
    run = Run.of(recording, Grid.of([recording]), lambda binned: binned.rate_deg_h())
    data = Data((run,))
    setting = Setting(data, Driver.of(data, "temperature_block_degC"))
    return next(named(setting, {mechanism: rlg.CATALOGUE[mechanism]}, ())), run


@pytest.fixture(scope="module")
def hysteresis() -> tuple[Region, Run]:
    return region_of("thermal_hysteresis", Simulator.from_mapping({"kind": "chamber", "mechanisms": ["thermal_polynomial"]}))


def test_a_relay_that_has_not_switched_yet_may_have_come_from_either_side(hysteresis: tuple[Region, Run]) -> None:
    region, run = hysteresis
    single = [form for form in region.forms if isinstance(form.lead[0], Relays) and len(form.lead[0].up) == 1]
    first = next(iter(single)).lead[0].begins[0][1]
    undecided = [form.lead[0] for form in single if form.lead[0].down[0] < first < form.lead[0].up[0]]
    assert undecided
    for relay in undecided:
        (other,) = (moved for moved in relay.nearby(0.5) if moved.opposite)
        one, opposite = relay.columns(run)[:, 0], other.columns(run)[:, 0]
        assert {one[0], opposite[0]} == {0.0, 1.0}
        values = relay.driver.values(run)
        switched = np.flatnonzero((values >= relay.up[0]) | (values <= relay.down[0]))
        if len(switched):
            assert one[switched[0] + 1 :] == pytest.approx(opposite[switched[0] + 1 :])
        assert any(not moved.opposite for moved in other.nearby(0.5) if moved.up == other.up)
        assert not any(moved.opposite for moved in relay.nearby(0.05))


def test_a_hysteresis_takes_up_a_hop_as_a_relay_that_is_wide_enough(hysteresis: tuple[Region, Run]) -> None:
    region, _ = hysteresis
    assert region.absorb is not None
    smooth = next(form for form in region.forms if isinstance(form.lead[0], Preisach))
    driver = smooth.lead[0].driver
    hop = Form("mode_hop", "a hop", (Relays(driver, (0.3,), (0.25,)),))
    both = region.absorb(smooth, hop)
    assert both is not None
    assert both.lead[:-1] == smooth.lead
    relay = both.lead[-1]
    assert isinstance(relay, Relays)
    assert relay.up == (0.3,)
    assert relay.up[0] - relay.down[0] == pytest.approx(priors.NARROWEST_LOOP)
    assert region.absorb(smooth, smooth) is None
    assert region.absorb(smooth, dataclasses.replace(hop, lead=(Relays(Driver(("other",)), (0.3,), (0.25,)),))) is None


def test_a_ladder_takes_up_relays_that_are_hops_beside_its_own() -> None:
    region, _ = region_of("mode_hop", Simulator.from_mapping({"kind": "chamber", "mechanisms": ["thermal_polynomial"]}))
    assert region.absorb is not None
    hop = next(form for form in region.forms if isinstance(form.lead[0], Relays) and len(form.lead[0].up) == 1)
    driver = hop.lead[0].driver

    def relays(*places: tuple[float, float]) -> Form:
        return Form("thermal_hysteresis", "relays", tuple(Relays(driver, (up,), (down,)) for up, down in places))

    one = dataclasses.replace(hop, lead=(dataclasses.replace(hop.lead[0], up=(0.3,), down=(0.25,)),))
    ladder = region.absorb(one, relays((-0.1, -0.27), (0.8, 0.7)))
    assert ladder is not None
    assert [(hop.up, hop.down) for hop in ladder.lead if isinstance(hop, Relays)] == [
        ((0.3,), (0.25,)),
        ((-0.1,), (-0.27,)),
        ((0.8,), (0.7,)),
    ]
    assert ladder.log_share < one.log_share
    assert region.absorb(one, relays((0.5, 0.1))) is None  # it overlaps the hop, and is wide
    assert region.absorb(one, dataclasses.replace(one, lead=(Relays(Driver(("other",)), (0.3,), (0.25,)),))) is None


@pytest.fixture(scope="module")
def ladders() -> tuple[Region, Run]:
    simulator = Simulator.from_mapping({"kind": "chamber", "mechanisms": ["thermal_polynomial"]})
    recording = simulator.simulate("start 20, hold 20, ramp 40 1, ramp -10 1, ramp 60 1, hold 20", seed=1, step_s=10.0)
    run = Run.of(recording, Grid.of([recording]), lambda binned: binned.rate_deg_h())
    data = Data((run,))
    setting = Setting(data, Driver.of(data, "temperature_block_degC"))
    return next(named(setting, {"mode_hop": rlg.CATALOGUE["mode_hop"]}, ())), run


@pytest.mark.parametrize("band", [0.05, 0.3])
def test_wide_dead_bands_of_a_ladder_overlap_none_however_their_hops_move(ladders: tuple[Region, Run], band: float) -> None:
    """Relays whose wide dead bands overlap are a hysteresis."""
    region, _ = ladders
    assert region.grow is not None
    first = next(form for form in region.forms if len(form.lead) == 1 and len(form.lead[0].up) == 1)
    hop = dataclasses.replace(first.lead[0], up=(0.4,), down=(0.4 - band,))
    grown = list(region.grow(dataclasses.replace(first, lead=(hop,))))
    assert {round(form.lead[1].up[0] - form.lead[1].down[0], 9) for form in grown} == {*priors.DEAD_BANDS, *priors.WIDE_DEAD_BANDS}
    for form in grown:
        lower, upper = sorted(form.lead, key=lambda relay: relay.up[0])
        wide = max(relay.up[0] - relay.down[0] for relay in form.lead) > priors.WIDEST_DEAD_BAND
        for one, other in itertools.product(lower.nearby(1.0), upper.nearby(1.0)):
            assert not wide or one.up[0] <= other.down[0]
            for moved, before in ((one, lower), (other, upper)):
                narrow = before.up[0] - before.down[0] <= priors.WIDEST_DEAD_BAND
                most = priors.WIDEST_DEAD_BAND if narrow else priors.WIDEST_OF_ONE
                assert -1e-9 <= moved.up[0] - moved.down[0] <= most + 1e-9


def test_a_hop_in_whose_dead_band_a_run_begins_may_have_come_from_either_side_whatever_the_others_did(
    ladders: tuple[Region, Run],
) -> None:
    region, run = ladders
    single = [form.lead[0] for form in region.forms if len(form.lead[0].up) == 1]
    assert {hop.start for hop in single} == {"rested", "below", "above"}
    within = [hop for hop in single if dict(hop.begins) and hop.down[0] < hop.begins[0][1] < hop.up[0]]
    assert {hop.start for hop in within} == {"rested", "below", "above"}
    for hop in within:
        (other,) = (moved for moved in hop.nearby(0.5) if moved.opposite)
        assert {hop.columns(run)[0, 0], other.columns(run)[0, 0]} == {0.0, 1.0}


def test_no_relay_of_a_hysteresis_is_as_narrow_as_a_hop(hysteresis: tuple[Region, Run]) -> None:
    region, _ = hysteresis
    assert region.grow is not None
    single = next(form for form in region.forms if isinstance(form.lead[0], Relays) and len(form.lead[0].up) == 1)
    widths = [form.lead[-1].up[0] - form.lead[-1].down[0] for form in region.grow(single)]
    assert len(widths) > 500
    assert min(widths) >= priors.NARROWEST_LOOP


def test_a_lag_is_no_longer_than_a_run() -> None:
    """One that is much longer is a function of where each run begins, and makes up for any bias of a run."""
    region, run = region_of("thermal_lag", Simulator.from_mapping({"kind": "chamber", "mechanisms": ["thermal_polynomial"]}))
    longest_s = run.bins * run.grid.bin_s

    def time_s(form: Form) -> float:
        basis = form.lead[0]
        return getattr(basis, "slowest_s", None) or getattr(basis, "time_constant_s", None) or basis.path.time_s

    slow = [form for form in region.forms if not isinstance(form.lead[0], Spectrum) and time_s(form) > 0.6 * longest_s]
    assert len({form.equation for form in slow}) == 11  # of the block and of the shell, of which there is one more
    for form in slow:
        assert all(time_s(moved) <= longest_s for moved in form.nearby(1.0))
        assert any(time_s(moved) < time_s(form) for moved in form.nearby(1.0))


def test_a_wander_does_not_outlive_the_form_that_it_stood_for() -> None:
    """From a noise that wanders a climb leads to no noise that does not. One relay acts, up at 24 and down at 10 degC."""
    runs, n, up, down = [], 900, np.array([24.0]), np.array([10.0])
    for seed in range(3):
        rng, t = np.random.default_rng(seed), np.linspace(0.0, 1.0, n)
        waves = zip((14.0, 9.0, 5.0), (1.3, 3.1, 5.7), rng.random(3), strict=True)
        celsius = 17.0 + sum(size * np.sin(2.0 * np.pi * (f * t + phase)) for size, f, phase in waves)
        on = relay_states(celsius, up, down, np.array([float(celsius[0] >= 17.0)]))[:, 0]
        gyro = 0.1 * on + 0.01 * rng.normal(size=n)
        table = pd.DataFrame({"time_s": 10.0 * np.arange(n), "gyro_deg_h": gyro, "temperature_block_degC": celsius})
        runs.append(rlg.recording(table, name=f"run{seed}"))
    grid = Grid.of(runs)
    data = Data(tuple(Run.of(run, grid, lambda binned: binned.rate_deg_h()) for run in runs))
    baseline = Baseline.calibrated(Simulator.from_mapping({"kind": "chamber", "mechanisms": ["thermal_polynomial"]}), data)
    driver = Driver.of(data, "temperature_block_degC")
    regions = list(named(Setting(data, driver), {"mode_hop": rlg.CATALOGUE["mode_hop"]}, ()))
    search = Sharpening(Bank(data, baseline.design(data), baseline), regions)
    levels = [tuple((level - driver.centre) / driver.half) for level in (up, down)]
    calm = search.hypotheses.calmest
    _, member = search.best(search.given(calm, ()), Form("mode_hop", "b = one relay", (Relays(driver, *levels),)))
    wandering = dataclasses.replace(calm, wander=1.5)
    assert search.converged((member,), wandering).noise.wander > 0.0
    assert search.without_wander_too((member,), wandering).noise.wander == 0.0
