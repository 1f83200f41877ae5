"""The concealed benchmark: its physics by identities and closed forms, its cases by their definitions, its score and its page."""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

import rlgcomp as rlg
from experiments.concealed import __main__ as program
from experiments.concealed import baseline, bench, effects, functions, observer, page, rules, turntable
from experiments.concealed.__main__ import main
from experiments.concealed.bench import chamber_case
from experiments.concealed.case import Case, dump, means
from experiments.concealed.cases import make_case
from experiments.concealed.chamber import WINDOW_S, Chamber, Unit, two_halves
from experiments.concealed.effects import CATALOGUED, MONITORS, OUTSIDE
from experiments.concealed.logger import Logger, Scale
from experiments.concealed.noise import Noise
from experiments.concealed.operators import Relays, first_order, slab
from experiments.concealed.plan import KINDS, NUISANCES, NUMBERS, Kind, Nuisance, Plan, plan, seed_of, stream
from experiments.concealed.programmes import random_programme
from experiments.concealed.score import (
    died,
    forget_peak_memory,
    held_out_error,
    improvement,
    key_of,
    nuisance_found,
    peak_memory_mib,
    run_case,
    set_probability,
)
from rlgcomp.physics import CATALOGUE

BLOCK = "temperature_block_degC"


@pytest.fixture(scope="module")
def runs() -> list[Chamber]:
    return [Unit.draw(stream(seed, "unit")).run(stream(seed, "run")) for seed in range(4)]


def single(name: str, strength: float = 1.0, seed: int = 11) -> Plan:
    return Plan("single", (name,), (strength,), "", seed)


@pytest.fixture(scope="module")
def case() -> Case:
    return make_case(single("magnetic_field"))


class TestOperators:
    def test_a_slab_follows_its_series(self) -> None:
        """A front that rises by a unit within a sample: 1 - sum 8 / (pi² m²) exp(-m² t / tau), m odd (Carslaw and Jaeger, 3.4)."""
        step_s, slowest_s = 5.0, 1000.0
        front = np.r_[0.0, np.ones(600)]
        time_s = step_s * (np.arange(601) - 0.5)
        orders = np.arange(1, 400, 2)[:, None]
        mean = 1.0 - (8.0 / (np.pi**2 * orders**2) * np.exp(-(orders**2) * time_s / slowest_s)).sum(axis=0)
        back = 1.0 - (4.0 / (np.pi * orders) * (-1.0) ** ((orders - 1) / 2) * np.exp(-(orders**2) * time_s / slowest_s)).sum(axis=0)
        assert slab(front, step_s, slowest_s)[5:] == pytest.approx(mean[5:], abs=2e-3)
        assert slab(front, step_s, slowest_s, at="back")[5:] == pytest.approx(back[5:], abs=2e-3)

    def test_lock_in_follows_the_mean_over_a_beat_and_stands_still_below(self) -> None:
        """sgn(W) sqrt(W² - W_L²) above lock-in, nothing below (Aronowitz 1999)."""
        rate = np.repeat([-40.0, -2.0, -0.05, -0.02, 0.01, 0.029, 0.04, 0.5, 10.0], 30)[:, None] * np.ones(turntable.INSTANTS)
        turn = turntable.Turn(rate, np.full(rate.shape, 20.0), 0.0)
        out = 3600.0 * rate[:, 0] + turntable.locked(turn, 0.03)
        mean = 3600.0 * np.sign(rate[:, 0]) * np.sqrt(np.maximum(rate[:, 0] ** 2 - 0.03**2, 0.0))
        late = np.arange(len(out)) % 30 > 4
        assert np.abs(out - mean)[late & (np.abs(rate[:, 0]) < 0.03)].max() < 1e-9
        for level in np.unique(rate[:, 0]):
            here = late & (rate[:, 0] == level)
            assert out[here].mean() == pytest.approx(mean[here].mean(), abs=0.8427 / here.sum() + 1e-6)

    @pytest.mark.parametrize("step_s", [1.0, 20.0, 2000.0])
    def test_a_lag_follows_a_ramp_late_by_its_time_constant(self, step_s: float) -> None:
        """Exact at any step: t - tau (1 - exp(-t / tau))."""
        time_s = step_s * np.arange(200)
        assert first_order(time_s, step_s, 500.0) == pytest.approx(time_s + 500.0 * np.expm1(-time_s / 500.0), abs=1e-6)

    @given(st.lists(st.floats(0.0, 39.0), max_size=12), st.integers(0, 9))
    def test_relays_wipe_out_smaller_swings(self, swings: list[float], seed: int) -> None:
        relays = Relays.smooth(-70.0, 95.0, 16, np.random.default_rng(seed))
        _, straight = relays.run(np.array([0.0, 40.0]), relays.start(0.0))
        _, wandered = relays.run(np.array([0.0, *swings, 40.0]), relays.start(0.0))
        assert np.array_equal(straight, wandered)

    @given(st.floats(-60.0, 80.0), st.booleans())
    def test_minor_loops_between_the_same_ends_are_congruent(self, history: float, from_below: bool) -> None:
        """Whatever came before, a loop from 10 to 30 and back gains and loses the same."""
        relays = Relays.exponential(-70.0, 95.0, 40, 12.0)
        loop = np.r_[np.linspace(10.0, 30.0, 21), np.linspace(29.0, 10.0, 20)]
        _, state = relays.run(np.array([history, 10.0]), relays.start(history, from_below=from_below))
        _, virgin = relays.run(np.array([10.0, 30.0, 10.0]), relays.start(10.0))
        first, _ = relays.run(loop, relays.run(np.array([30.0, 10.0]), state)[1])
        second, _ = relays.run(loop, virgin)
        assert np.diff(first) == pytest.approx(np.diff(second), abs=1e-12)
        assert first[-1] == pytest.approx(first[0], abs=1e-12)
        assert np.ptp(first) > 0.01


class TestChamber:
    @given(st.integers(0, 2**32))
    def test_a_programme_lasts_5_to_10_h_within_its_span(self, seed: int) -> None:
        times, temperatures = random_programme(np.random.default_rng(seed))
        assert 5.0 * 3600.0 <= times[-1] <= 10.0 * 3600.0
        assert (np.diff(times) > 0.0).all()
        assert temperatures.min() >= -40.0
        assert temperatures.max() <= 60.0
        assert (np.abs(np.diff(temperatures) / np.diff(times)) * 60.0 <= 1.81).all()

    def test_rate_is_the_derivative_of_the_block(self, runs: list[Chamber]) -> None:
        for run in runs:
            assert np.gradient(run.block, run.step_s)[1:-1] * 60.0 == pytest.approx(run.rate_K_min[1:-1], abs=0.02)

    def test_rate_and_gradient_are_two_things(self, runs: list[Chamber]) -> None:
        """In the plant of rlgcomp the correlation is one, so no diagnosis could tell them apart."""
        for run in runs:
            columns = np.column_stack([run.rate_K_min, run.block - run["temperature_shell_degC"]])
            left = observer.residual(np.vander((run.block - 10.0) / 50.0, 4), columns)
            assert 0.5 < abs(np.corrcoef(left.T)[0, 1]) < 0.997

    def test_a_beam_off_centre_shifts_the_halves_against_each_other(self) -> None:
        a, b = two_halves(np.array([-20.0, 0.0, 20.0]))
        assert a[1] == b[1] == pytest.approx(1.0)
        assert a[2] == pytest.approx(b[0])
        assert a[2] > 1.0 > b[2]

    def test_the_run_before_is_part_of_a_runs_history(self) -> None:
        unit = dataclasses.replace(Unit.draw(stream(1, "unit")), before="the run before")
        first = unit.run(stream(1, "run"))
        second = unit.run(stream(2, "run"), previous=first)
        assert second.history_degC[-1] == first.block[-1]
        reached = second.history_degC[len(first.history_degC) :]
        assert [reached.min(), reached.max()] == pytest.approx([first.block.min(), first.block.max()], abs=0.2)


class TestNoise:
    def test_flicker_has_the_allan_floor_of_its_strength(self) -> None:
        """AVAR = (2 ln 2 / pi) B² between the relaxation times, white noise apart."""
        noise = Noise(flicker=10.0)
        blocks = [noise.simulate(30_000, 1.0, np.random.default_rng(seed)).reshape(-1, 300).mean(axis=1) for seed in range(30)]
        variance = np.mean([0.5 * np.mean(np.diff(block) ** 2) for block in blocks]) - WINDOW_S / 300.0
        assert variance == pytest.approx(2.0 * np.log(2.0) / np.pi * 100.0, rel=0.1)

    @pytest.mark.parametrize("step_s", [5.0, 20.0])
    def test_covariance_is_that_of_the_window_means(self, step_s: float) -> None:
        noise, samples = Noise(flicker=0.5, walk=0.3), round(WINDOW_S / step_s)
        windows = np.array([means(noise.simulate(20 * samples, step_s, np.random.default_rng(k)), samples) for k in range(1500)])
        expected = noise.covariance(20)
        found = windows.T @ windows / len(windows)
        spread = np.sqrt((expected**2 + np.outer(np.diag(expected), np.diag(expected))) / len(windows))
        assert np.sqrt(np.mean(((found - expected) / spread) ** 2)) < 1.5

    def test_stated_noise_is_the_packages(self) -> None:
        """A window is 100 s, times 36 here: an hour's mean has the standard deviation of a random walk of one hour."""
        assert Noise(0.4, 0.2).to_mapping(36.0, 7.0) == pytest.approx(
            {
                "angle_random_walk_deg_sqrt_h": 7.0,
                "bias_instability_deg_h": 2.8,
                "rate_random_walk_deg_h_sqrt_h": 1.4 / 6.0,
            }
        )


class TestForms:
    """What is drawn, and that it is what its cause is named for."""

    def forms(self, draw: Callable[[np.random.Generator], str], draws: int = 80) -> set[str]:
        return {draw(np.random.default_rng(seed)) for seed in range(draws)}

    def test_every_form_is_drawn(self, runs: list[Chamber]) -> None:
        assert self.forms(lambda rng: functions.of_monitor(rng).form) == {
            "linear", "saturating", "square", "dead zone", "monotone", "smooth"
        }  # fmt: skip
        laws = self.forms(lambda rng: functions.settling(rng)[0].form) | self.forms(lambda rng: functions.lasting(rng).form)
        assert {law.split(" (")[0] for law in laws} == {
            "exponentials", "stretched exponential", "hyperbolic", "logarithm", "power"
        }  # fmt: skip
        for name, count in (("thermal_hysteresis", 2), ("mode_hop", 3), ("thermal_lag", 8), ("random_telegraph", 2)):
            assert len(self.forms(lambda rng, name=name: CATALOGUED[name](rng, runs).form)) == count

    def test_functions_are_monotone_odd_and_even_as_they_say(self) -> None:
        u = np.linspace(-3.0, 3.0, 301)
        for seed in range(30):
            rng = np.random.default_rng(seed)
            assert (np.diff(functions.monotone(rng)(u)) > 0.0).all()
            one, other = functions.odd(rng), functions.even(rng)
            assert one(-u) == pytest.approx(-one(u))
            assert other(-u) == pytest.approx(other(u))
            time_s = np.linspace(0.0, 36000.0, 50)
            assert len(set(np.sign(np.diff(functions.settling(rng)[0](time_s))))) == 1

    def test_a_ladder_has_one_to_nine_hops_to_levels_of_their_own_or_two(self, runs: list[Chamber]) -> None:
        hops = []
        for seed in range(40):
            effect = effects.mode_hop(np.random.default_rng(seed), runs)
            levels = np.unique(np.concatenate([effect.law(run, np.random.default_rng(0)) for run in runs]))
            hops.append(len(levels) - 1)
            assert len(levels) == 2 or effect.form.startswith("2 to 9")
        assert min(hops) == 1
        assert 6 <= max(hops) <= 9

    def test_hysteresis_depends_on_what_came_before(self, runs: list[Chamber]) -> None:
        effect = effects.thermal_hysteresis(np.random.default_rng(3), runs)
        cold, hot = (
            effect.law(dataclasses.replace(runs[0], history_degC=np.array([first])), np.random.default_rng(0))
            for first in (-90.0, 120.0)
        )
        assert hot[0] > cold[0]
        assert hot[-1] - cold[-1] < hot[0] - cold[0]

    @pytest.mark.parametrize("name", ["random_telegraph", "periodic_interference"])
    @pytest.mark.parametrize("seed", [1, 2, 6])
    def test_what_no_two_runs_repeat_has_its_correlation(self, name: str, seed: int, runs: list[Chamber]) -> None:
        effect = next(
            effect for k in range(100) if not (effect := CATALOGUED[name](np.random.default_rng(100 * seed + k), runs)).repeats
        )
        run = dataclasses.replace(runs[0], time_s=runs[0].time_s[::20])
        drawn = np.array([effect.law(run, np.random.default_rng(k)) for k in range(600)])
        drawn -= drawn.mean()
        assert effect.correlation is not None
        for apart in (1, 3, 10, 30):
            found = np.mean(drawn[:, apart:] * drawn[:, :-apart]) / np.mean(drawn**2)
            assert found == pytest.approx(float(effect.correlation(np.array([apart * run.step_s]))[0]), abs=0.08)


class TestCases:
    @pytest.mark.parametrize("name", ["warm_up", "thermal_hysteresis", "random_telegraph"])
    def test_strength_is_what_it_is_defined_to_be(self, name: str) -> None:
        """The same case with next to nothing of the effect: the difference, projected, has the size that was asked for."""
        with_it, without = (make_case(single(name, strength)) for strength in (0.5, 1e-9))
        windows = [
            np.concatenate([means(run.rate_deg_h(), one.samples) for run in one.train]) / one.white_deg_h
            for one in (with_it, without)
        ]
        made = bench.Bench.of(with_it.plan, None)
        made = dataclasses.replace(made, parts=bench.identifiable_parts(made, stream(with_it.plan.seed, "lag")))
        left = observer.residual(made.means(made.columns(made.chambers)), windows[0] - windows[1])
        assert np.sqrt(np.mean(left**2)) == pytest.approx(0.5, rel=1e-6)

    def test_relays_that_no_run_passes_are_no_effect(self, monkeypatch: pytest.MonkeyPatch) -> None:
        """Of such a draw, one of the first edition, the rounding of a constant was the effect, and the gyro as loud as that."""
        monkeypatch.setattr("experiments.concealed.plan.EDITION", 1)
        (drawn,) = plan("pair", 1, 12)
        assert drawn.hidden[0] == "thermal_hysteresis"
        case = make_case(drawn)
        assert case.white_deg_h > 1e-9 * case.scale.size_deg_h

    def test_the_same_seed_makes_the_same_case_and_another_seed_another(self) -> None:
        first, again, other = (make_case(Plan("pair", ("ageing", "warm_up"), (1.0, 2.0), "", seed)) for seed in (3, 3, 4))
        assert first.train[0].table.equals(again.train[0].table)
        assert json.dumps(first.truth()) == json.dumps(again.truth())
        assert not first.train[0].table.equals(other.train[0].table)

    @pytest.mark.parametrize("name", ["thermal_lag", "periodic_interference"])
    def test_a_case_of_another_scale_is_the_same_stretched(self, name: str) -> None:
        """Times by 1000 and rates by 1e5: all else is the same, to rounding."""
        plain = Plan("nuisance", (name,), (1.0,), "wrong number", 5)
        one, other = (chamber_case(plain, scale=Scale(*scale)) for scale in ((0.01, 3e-4), (10.0, 30.0)))
        for before, after in zip((*one.train, *one.test), (*other.train, *other.test), strict=True):
            assert after.time_s == pytest.approx(1e3 * before.time_s, rel=1e-12)
            assert after.rate_deg_h() == pytest.approx(1e5 * before.rate_deg_h(), rel=1e-9)
            monitors = [column for column in before.columns if column != "time_s" and not column.startswith("gyro")]
            assert before.table[monitors].equals(after.table[monitors])
        for series in ("truth_held_out", "oracle"):
            for before, after in zip(getattr(one, series), getattr(other, series), strict=True):
                assert after == pytest.approx(1e5 * before, rel=1e-9)
        assert other.log_bayes_factor == pytest.approx(one.log_bayes_factor)
        assert other.white_deg_h == pytest.approx(1e5 * one.white_deg_h)
        assert other.wrong is not None
        assert one.wrong is not None
        unit = 1e5 * (1e3 if other.wrong[1] == "k_deg_h_min_K" else 1.0)
        assert other.wrong[2:] == pytest.approx((unit * one.wrong[2], unit * one.wrong[3]))

    def test_the_simulators_file_has_the_true_numbers_in_the_units_of_the_case(self) -> None:
        """Of a number that is stated as known, and wrong by nothing: the package's column times it is the part of the truth."""
        made = bench.Bench.of(next(one for one in plan("healthy", 30) if len(bench.Bench.of(one, None).parts) > 1), None)
        chamber, time, rate_deg_h = made.chambers[0], 40.0, 7.0
        columns = {"time_s": time * chamber.time_s, "gyro_deg_h": 0.0 * chamber.time_s, **chamber.monitors}
        perfect = rlg.Recording(pd.DataFrame(columns), rlg.Metadata(kind="chamber"), name="perfect")
        for part in made.parts:
            for k, (parameter, weight) in enumerate(zip(part.parameters, part.weights, strict=True)):
                mapping = baseline.to_mapping(
                    made.parts, np.random.default_rng(0), time=time, rate_deg_h=rate_deg_h, wrong=(part.name, parameter, 0.0)
                )
                (mechanism,) = (one for one in rlg.Simulator.from_mapping(mapping).mechanisms if one.name == part.name)
                if part.name != "thermal_lag":  # its time constant is for the diagnosis to find
                    found = getattr(mechanism, parameter) * mechanism.basis(perfect)[5:-5, k]
                    expected = rate_deg_h * weight * part.columns(chamber)[5:-5, k]
                    assert found == pytest.approx(expected, abs=0.01 * np.abs(expected).max())

    def test_what_is_hidden_is_not_in_the_simulator_and_the_driver_not_in_the_recording(self) -> None:
        for one in (made for kind in KINDS for made in plan(kind, 1)):
            made = make_case(one)
            simulator = rlg.Simulator.from_mapping(made.simulator_mapping)
            assert not {mechanism.name for mechanism in simulator.mechanisms} & set(one.hidden)
            columns = set(made.train[0].columns)
            if one.kind == "unrecorded":
                assert not columns & set(MONITORS[one.hidden[0]][0])
            elif one.kind != "turntable":
                assert {driver for name in one.hidden if name in MONITORS for driver in MONITORS[name][0]} <= columns
            assert set(made.drivers) <= columns
            assert 2 <= len(made.train) <= 6
            assert 1 <= len(made.test) <= 3
            for series in (made.truth_held_out, made.signal_held_out, made.oracle):
                assert [len(values) for values in series] == [len(run) for run in made.test]

    def test_an_oracle_comes_close_to_the_truth_of_weak_effects(self) -> None:
        errors = []
        for name in list(CATALOGUED)[::2]:
            made = make_case(single(name, 0.5, 17))
            errors.append(held_out_error(made, made.oracle) / made.white_deg_h)
        assert np.median(errors) < 0.25
        assert max(errors) < 1.0

    def test_an_effect_that_no_run_repeats_is_not_in_the_truth(self) -> None:
        made = make_case(single("random_telegraph", 2.0))
        jumps = np.concatenate([a - b for a, b in zip(made.signal_held_out, made.truth_held_out, strict=True)])
        assert len(np.unique(np.round(jumps / made.white_deg_h, 9))) == 2

    def test_nuisances_are_no_part_of_the_truth_and_of_what_they_say(self) -> None:
        step, biases, number = (make_case(Plan("nuisance", ("ageing",), (2.0,), kind, 21)) for kind in NUISANCES)
        assert step.steps
        for run, at_s in step.steps:
            (recording,) = (one for one in step.train if one.name == run)
            assert 0.1 < at_s / recording.time_s[-1] < 0.9
        offsets = [np.unique(np.round(s - t, 9)) for s, t in zip(biases.signal_held_out, biases.truth_held_out, strict=True)]
        assert all(len(one) == 1 for one in offsets)
        assert number.wrong is not None
        mechanism, parameter, true, stated = number.wrong
        simulator = rlg.Simulator.from_mapping(number.simulator_mapping)
        assert parameter not in simulator.free[mechanism]
        (fixed,) = (one for one in simulator.mechanisms if one.name == mechanism)
        assert getattr(fixed, parameter) == pytest.approx(stated)
        assert true != stated

    def test_thermometers_round_lag_and_are_noisy_and_monitors_too(self, runs: list[Chamber]) -> None:
        loggers = [Logger.draw(np.random.default_rng(seed), runs, (), ()) for seed in range(60)]
        resolutions = [logger.resolution_K for logger in loggers]
        assert min(resolutions) < 0.003
        assert 0.3 < max(resolutions) <= 1.0
        logger = dataclasses.replace(loggers[0], resolution_K=0.25, read_noise_K=1e-9)
        read = logger.readings(runs[0], np.random.default_rng(0))
        late = np.interp(runs[0].time_s - logger.lag_s[BLOCK], runs[0].time_s, runs[0].block) + logger.offset_K[BLOCK]
        assert np.array_equal(read[BLOCK], np.round(read[BLOCK] * 4.0) / 4.0)
        assert np.abs(read[BLOCK] - late).max() < 0.25
        for logger in loggers:
            for column, noise in logger.monitor_noise.items():
                assert noise <= 0.334 * np.std(np.concatenate([run[column] for run in runs]))

    def test_readings_are_reconstructed_as_well_as_they_can_be(self, runs: list[Chamber]) -> None:
        logger = dataclasses.replace(Logger.draw(np.random.default_rng(1), runs, (), ()), resolution_K=0.2, read_noise_K=0.05)
        read = logger.readings(runs[0], np.random.default_rng(0))
        seen = logger.reconstructed(runs[0], read)
        assert np.std(seen.block - runs[0].block) < 0.05
        assert np.abs(seen.block - runs[0].block)[-10:].max() < 0.2
        assert np.std(seen.rate_K_min - runs[0].rate_K_min) < 0.2 * np.std(runs[0].rate_K_min)

    def test_seeds_for_tuning_are_not_the_pages(self) -> None:
        page_seeds, tuning = ({seed_of(kind, k, tuning=one) for kind in KINDS for k in range(1000)} for one in (False, True))
        assert len(page_seeds) == len(tuning) == 1000 * len(KINDS)
        assert not page_seeds & tuning
        assert {one.seed for one in plan("single", 5)} <= page_seeds
        assert {one.seed for one in plan("single", 5, tuning=True)} <= tuning

    def test_the_plan_has_every_cause_and_strengths_as_the_goals_ask(self) -> None:
        assert sum(NUMBERS.values()) >= 600
        assert {one.hidden[0] for one in plan("single", 17)} == set(CATALOGUED)
        chamber = {name for name, form in CATALOGUE.items() if form.kind == "chamber" and not form.empirical}
        assert set(CATALOGUED) == chamber
        turning = {name for name, form in CATALOGUE.items() if form.kind == "turntable" and not form.empirical}
        assert {*turntable.EFFECTS, "scale_factor"} == turning  # a scale factor every simulator of a table has
        assert {one.hidden[0] for one in plan("outside", 5)} == set(OUTSIDE)
        strengths = [one.strengths[0] for one in plan("single", 300)]
        assert np.mean(np.log(strengths)) == pytest.approx(np.log(math.sqrt(0.25 * 32.0)), abs=0.3)
        assert 0.25 <= min(strengths) < 0.3
        assert 28.0 < max(strengths) <= 32.0
        for several in (*plan("pair", 40), *plan("triple", 40)):
            assert 1.0 <= min(several.strengths)
            assert len(set(several.hidden)) == len(several.strengths) == (2 if several.kind == "pair" else 3)
        assert all(5.0 <= one.strengths[0] / one.strengths[1] <= 10.0 for one in plan("unequal", 40))

    def test_a_dumped_case_is_read_by_the_command_line(self, tmp_path: Path) -> None:
        made = make_case(Plan("outside", ("unnamed_channel",), (1.0,), "", 5))
        dump(made, tmp_path)
        assert rlg.Simulator.from_yaml(tmp_path / "sim.yaml") == rlg.Simulator.from_mapping(made.simulator_mapping)
        assert rlg.read(tmp_path / "run0.parquet").table.equals(made.train[0].table)
        truth = json.loads((tmp_path / "truth.json").read_text())
        assert truth["hidden"] == ["unnamed_channel"]
        assert truth["drivers"] == ["humidity_percent"]


class TestObserver:
    def test_a_bayes_factor_is_seldom_large_where_nothing_is(self) -> None:
        """It is one on average, so it is above ten in at most a tenth."""
        column = 0.4 * np.random.default_rng(0).standard_normal(40)
        found = [observer.log_bayes_factor(column, draw) for draw in np.random.default_rng(1).standard_normal((2000, 40))]
        assert np.mean(np.array(found) > math.log(10.0)) < 0.1
        assert np.median(found) < 0.0

    def test_a_bayes_factor_grows_as_the_square_of_the_strength(self) -> None:
        column = np.ones(100)
        for strength in (1.0, 4.0):
            peak = 0.5 * 100.0 * strength**2
            found = observer.log_bayes_factor(column, strength * column)
            share = math.sqrt(2.0 * np.pi / 100.0) / strength / (2.0 * math.log(observer.STRONGEST / observer.WEAKEST))
            assert found == pytest.approx(peak + math.log(share), abs=0.1)

    def test_evidence_is_that_of_any_bias(self) -> None:
        """Against a bias of a very wide prior, the difference of two covariances."""
        rng = np.random.default_rng(2)
        target, column = rng.standard_normal(12), np.ones((12, 1))
        covariances = [Noise().covariance(12), Noise(walk=1.0).covariance(12)]
        found = [observer.log_evidence([np.linalg.cholesky(one)], [column], [target]) for one in covariances]

        def wide(covariance: np.ndarray) -> float:
            total = covariance + 1e8
            return float(-0.5 * np.linalg.slogdet(total)[1] - 0.5 * target @ np.linalg.solve(total, target))

        assert found[0] - found[1] == pytest.approx(wide(covariances[0]) - wide(covariances[1]), abs=1e-4)

    def test_the_observer_sees_strong_effects_and_not_what_is_hardly_there(self) -> None:
        for name in ("mode_hop", "random_telegraph"):
            weak, strong = (make_case(single(name, strength, 3)) for strength in (0.01, 1.0))
            assert weak.log_bayes_factor < page.EVEN_ODDS < strong.log_bayes_factor

    def test_a_cause_beats_its_rivals_where_they_differ(self) -> None:
        assert make_case(single("warm_up", 2.0, 9)).separation_nats > 10.0


def silent(simulator: rlg.Simulator, train: Any, test: Any) -> Any:
    """A diagnosing function that finds nothing."""
    del train, test
    content = {
        "verdict": "none",
        "mismatch": {"p_value": 0.5, "where": []},
        "findings": [],
        "nothing_missing": 0.9,
        "unexplained": {"drivers": [], "memory": "none", "equation": None},
        "fit": {"test": None},
    }
    still = SimpleNamespace(predict=lambda run: run.replace(table=run.table.assign(**{run.gyro_columns[0]: 0.0})))
    assert simulator.mechanisms
    return SimpleNamespace(to_mapping=lambda: content, calibrated=still, augmented=still)


class TestScore:
    def test_any_function_may_diagnose(self) -> None:
        function = f"{__name__}:silent"
        healthy, hidden = (run_case(one, function) for one in (plan("healthy", 1)[0], plan("single", 1)[0]))
        assert page.right(healthy)
        assert not page.right(hidden)
        assert healthy["set_probability"] == 0.9
        assert hidden["log_bayes_factor"] > 0.0
        assert healthy["key"].endswith(f" by {function}")
        assert "failure" in run_case(plan("healthy", 1)[0], f"{__name__}:absent")

    def test_a_rule_is_counted_where_it_makes_an_answer_right_and_where_it_makes_it_wrong(self) -> None:
        right = {"verdict": "explained", "findings": ["warm_up"], "drivers": [], "memory": "none"}
        wrong = {**right, "findings": ["warm_up", "ageing"]}
        case = {"kind": "single", "hidden": ["warm_up"]}
        rows = [
            {**case, **right, "exact": True, "without_rules": {rules.OWNED: wrong, rules.EQUATION: wrong}},
            {**case, **wrong, "exact": False, "without_rules": {rules.OWNED: right}},
            {**case, **right, "exact": True, "without_rules": {}},
            {**case, **right, "exact": True},
        ]
        owned, of_equation = rules.effects(rows, page.right)
        assert list(owned.values())[1:] == ["2 of 3", 1, 1]
        assert list(of_equation.values())[1:] == ["1 of 3", 1, 0]

    def test_errors_are_about_each_runs_mean_where_runs_have_biases(self, case: Case) -> None:
        shifted = [truth + 3.0 for truth in case.truth_held_out]
        assert held_out_error(case, shifted) == pytest.approx(3.0)
        biased = dataclasses.replace(case, plan=dataclasses.replace(case.plan, nuisance="run bias"))
        assert held_out_error(biased, shifted) == pytest.approx(0.0, abs=1e-12)

    def test_memory_is_that_of_the_case_not_of_the_process(self) -> None:
        block = np.ones(40_000_000)
        before = peak_memory_mib()
        del block
        forget_peak_memory()
        if not Path("/proc/self/clear_refs").exists():
            pytest.skip("the system cannot forget a peak of memory")
        assert peak_memory_mib() < before - 250.0

    def test_the_probability_of_the_set(self) -> None:
        found = [{"mechanism": "ageing", "probability": 0.8}, {"mechanism": "warm_up", "probability": 0.7}]
        assert set_probability({"verdict": "none", "findings": [], "nothing_missing": 0.99}) == 0.99
        assert set_probability({"verdict": "explained", "findings": found, "probability": 0.6}) == 0.6
        assert set_probability({"verdict": "explained", "findings": found}) == 0.7
        assert set_probability({"verdict": "unknown", "findings": [], "probability": 0.6}) is None

    def test_steps_biases_and_wrong_numbers_are_recognised_or_not(self, case: Case) -> None:
        def among(nuisance: Nuisance, **changes: Any) -> Case:
            return dataclasses.replace(case, plan=dataclasses.replace(case.plan, nuisance=nuisance), **changes)

        window_s = case.samples * case.scale.period_s
        step = among("step", steps=(("run0", 50.0 * window_s),))
        assert nuisance_found(step, {"steps": [{"run": "run0", "at_s": 51.0 * window_s}]})
        assert not nuisance_found(step, {"steps": [{"run": "run1", "at_s": 51.0 * window_s}]})
        assert not nuisance_found(step, {"steps": [{"run": "run0", "at_s": 60.0 * window_s}]})
        biases = among("run bias")
        assert nuisance_found(biases, {"baseline_with_findings": {"gyro": {"own_bias_deg_h:run1": {"value": 1.0}}}})
        assert not nuisance_found(biases, {"baseline_with_findings": {"gyro": {"bias_deg_h": {"value": 1.0}}}})
        number = among("wrong number", wrong=("temperature_rate", "k_deg_h_min_K", 1.0, 2.0))
        for value, close in ((1.1, True), (1.8, False)):
            content = {"baseline_with_findings": {"temperature_rate": {"k_deg_h_min_K": {"value": value}}}}
            assert nuisance_found(number, content) is close
        assert nuisance_found(number, {"baseline": {}}) is False
        assert nuisance_found(case, {}) is None

    def test_the_improvement_of_perfect_predictions_is_limited_by_noise(self, case: Case) -> None:
        white = dataclasses.replace(case, noise=Noise())
        averaging_s = 2.0 * case.samples * case.scale.period_s
        content = {
            "findings": [{}],
            "fit": {"test": {"averaging_s": averaging_s, "improvement": 0.5, "improvement_ci95": [0.4, 0.6]}},
        }
        zero = [np.zeros(len(signal)) for signal in case.signal_held_out]
        found = improvement(white, content, before=zero, after=case.signal_held_out)
        assert found is not None
        windows = np.concatenate([means(signal, 2 * case.samples) for signal in case.signal_held_out])
        noise = case.white_deg_h**2 / 2.0
        assert found["expected"] == pytest.approx(1.0 - math.sqrt(noise / (np.mean(windows**2) + noise)))
        assert improvement(white, content | {"findings": []}, zero, zero) is None


class TestPage:
    ROW: dict[str, Any] = {  # noqa: RUF012
        "seed": 1,
        "nuisance": "",
        "forms": ["linear"],
        "verdict": "explained",
        "exact": True,
        "in_class": True,
        "overlap": 0.5,
        "p_value": 1e-5,
        "findings": ["ageing"],
        "probabilities": [0.9],
        "set_probability": 0.9,
        "drivers": [],
        "memory": "none",
        "true_drivers": [],
        "true_memory": "none",
        "nuisance_found": None,
        "improvement": {"stated": 0.5, "low": 0.4, "high": 0.6, "expected": 0.55},
        "error_to_oracle": 1.1,
        "seconds": 2.0,
        "cpu_seconds": 2.0,
        "memory_mib": 300.0,
        "log_bayes_factor": 20.0,
        "separation_nats": 5.0,
        "white_noise": True,
    }

    def row(self, kind: Kind, *hidden: str, **changes: Any) -> dict[str, Any]:
        name = f"{kind}-{'+'.join(hidden)}"
        return (
            self.ROW | {"key": name, "name": name, "kind": kind, "hidden": list(hidden), "strengths": [1.0] * len(hidden)} | changes
        )

    def test_a_failure_counts_as_a_wrong_answer(self, capsys: pytest.CaptureFixture[str]) -> None:
        failed = {
            "key": "x",
            "name": "x",
            "kind": "single",
            "hidden": ["ageing"],
            "strengths": [1.0],
            "nuisance": "",
            "failure": "Boom",
        }
        page.show([self.row("single", "ageing"), failed])
        text = capsys.readouterr().out
        assert "50 % (1/2" in text
        assert "Boom" in text

    def test_intervals_are_wilsons(self) -> None:
        """Wilson 1927; 8 of 10: 49 to 94 %."""
        assert page.proportion(8, 10) == "80 % (8/10; 49–94)"

    def test_what_is_reachable_is_detected_and_preferred_to_rivals(self) -> None:
        rows = [
            self.row("single", "ageing"),
            self.row("single", "ageing", log_bayes_factor=1.0),
            self.row("single", "ageing", separation_nats=-0.1),
            self.row("single", "random_telegraph", separation_nats=None),
        ]
        assert page.reachable(rows) == "50 %"

    def test_reliability_counts_sets_and_causes_by_their_probability(self) -> None:
        sure = [self.row("single", "ageing", set_probability=p, probabilities=[p]) for p in (0.992, 1.0)]
        wrong = self.row("healthy", findings=["warm_up", "ageing"], probabilities=[0.65, 0.55], set_probability=0.6)
        healthy = self.row("healthy", verdict="none", findings=[], probabilities=[], set_probability=0.995)
        outside = self.row("outside", "product", probabilities=[0.999], set_probability=0.999)
        stated = page.statements([*sure, wrong, healthy, outside])
        lines = page.reliability(stated)
        sets, causes = ([line for line in lines if line["of"] == of] for of in ("set", "cause"))
        assert [(line["stated"], line["so"].split(";")[0]) for line in sets[:-1]] == [("1", "0 % (0/1"), ("4", "75 % (3/4")]
        assert [(line["stated"], line["so"].split(";")[0]) for line in causes[:-1]] == [("2", "0 % (0/2"), ("3", "67 % (2/3")]
        assert len(page.certain_and_wrong([*sure, wrong, healthy, outside])) == 1

    def test_what_counts_as_right(self) -> None:
        assert page.right(self.row("single", "ageing"))
        assert not page.right(self.row("single", "ageing", verdict="unknown"))
        assert page.right(self.row("turntable", verdict="none"))
        assert page.right(self.row("healthy", verdict="none"))
        assert not page.right(self.row("healthy", verdict="unknown"))
        assert page.right(self.row("unrecorded", "magnetic_field", verdict="unknown", findings=[]))
        assert not page.right(self.row("unrecorded", "magnetic_field", verdict="unknown"))
        outside = self.row("outside", "product", verdict="unknown", drivers=["a", "b"], true_drivers=["a", "b"])
        assert page.right(outside)
        assert not page.right(outside | {"drivers": ["a"]})
        assert not page.right(outside | {"memory": "dynamic"})
        assert page.right(self.row("nuisance", "ageing", nuisance="step", nuisance_found=True))
        assert not page.right(self.row("nuisance", "ageing", nuisance="step", nuisance_found=False))

    def test_every_kind_is_shown(self, capsys: pytest.CaptureFixture[str]) -> None:
        hidden: dict[str, tuple[str, ...]] = {
            "healthy": (),
            "pair": ("ageing", "warm_up"),
            "outside": ("product",),
            "turntable": ("lock_in",),
        }
        faults = {"nuisance": {"nuisance": "step", "nuisance_found": True}}
        page.show([self.row(kind, *hidden.get(kind, ("ageing",)), **faults.get(kind, {})) for kind in KINDS])
        text = capsys.readouterr().out
        for title in (
            "Goals",
            "One effect, by strength",
            "Healthy gyros",
            "On a turntable",
            "Outside the catalogue",
            "Reliability",
        ):
            assert f"## {title}" in text
        assert "held-out error / oracle, median, one effect | ≤ 1.2 | 1.10" in text


class TestManyCases:
    """A run that is stopped goes on where it was, and says what failed."""

    @pytest.fixture
    def made(self, monkeypatch: pytest.MonkeyPatch) -> list[str]:
        """Keys of the cases that are diagnosed, which is not done here."""
        keys: list[str] = []

        def run(one: Plan, function: str, told: bool = False) -> dict[str, Any]:
            keys.append(key_of(one, function))
            return {"key": keys[-1]}

        monkeypatch.setattr(program, "run_case", run)
        monkeypatch.setattr(program.page, "show", len)
        monkeypatch.setattr(program.page, "mark", lambda row: row["key"])
        return keys

    def test_it_goes_on_after_a_kill(self, made: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
        """Of three lines one tells of a failure and one was cut short: both are made again, and two cases more."""
        rows = tmp_path / "rows.jsonl"
        options = ["--only", "healthy", "--jobs", "1", "--rows", str(rows), "--cases"]
        main([*options, "3"])
        first, second, third = rows.read_text().splitlines()
        failed = json.dumps(json.loads(second) | {"failure": "its worker died"})
        rows.write_text(f"{first}\n{failed}\n{third[:20]}")
        before = list(made)
        made.clear()
        main([*options, "5", "--resume"])
        assert made[:2] == before[1:]
        assert len(made) == 4
        assert [json.loads(line)["key"] for line in rows.read_text().splitlines()] == [before[0], *made]
        assert capsys.readouterr().out.startswith("# Concealed physics: `python -m experiments.concealed --only healthy")

    def test_cases_for_tuning_or_of_another_function_are_others(self, made: list[str], tmp_path: Path) -> None:
        options = ["--cases", "healthy=2", "--cases", "single=1", "--jobs", "1", "--resume", "--rows", str(tmp_path / "rows.jsonl")]
        main(options)
        main([*options, "--tuning"])
        main([*options, "--tuning"])
        main([*options, "--diagnose", "another:function"])
        assert len(made) == len(set(made)) == 9

    def test_the_page_says_which_seeds_it_shows(self, made: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
        options = ["--cases", "healthy=1", "--jobs", "1", "--rows", str(tmp_path / "rows.jsonl")]
        main(options)
        main([*options, "--tuning"])
        shown, tuning = capsys.readouterr().out.split("# Concealed physics")[1:]
        assert "Nothing is tuned on these cases" in shown
        assert "These cases are for tuning" in tuning
        assert len(made) == 2

    def test_numbers_that_are_none_are_refused(self, made: list[str], capsys: pytest.CaptureFixture[str]) -> None:
        with pytest.raises(SystemExit, match="2"):
            main(["--cases", "healthy=x"])
        assert "KIND=N" in capsys.readouterr().err
        assert not made

    def test_dumping_needs_no_diagnosis(self, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
        main(["--only", "healthy", "--cases", "1", "--dump", str(tmp_path / "made")])
        (folder,) = (tmp_path / "made").iterdir()
        assert str(folder) in capsys.readouterr().out
        assert (folder / "sim.yaml").is_file()

    def test_a_scheduler_that_does_not_answer_ends_with_a_message(
        self, made: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
        arguments = ["--only", "healthy", "--cases", "1", "--rows", str(tmp_path / "rows"), "--scheduler", "nonsense://here"]
        with pytest.raises(SystemExit, match="2"):
            main(arguments)
        assert capsys.readouterr().err.startswith("error: ")
        assert not made

    def test_a_case_that_kills_its_worker_is_counted_as_failed(self) -> None:
        (one,) = plan("healthy", 1)
        row = died(one)
        assert row["key"] == key_of(one)
        assert "died" in row["failure"]
        assert not page.right(row)


def test_what_can_be_known_of_biases_of_runs() -> None:
    """Biases of runs that are nearly alike cannot be seen, those of another case are plain; without any the effect alone counts."""
    hidden, seen, none = (
        make_case(one).log_bayes_factor
        for one in (
            Plan("nuisance", ("temperature_rate",), (1.0,), "run bias", 12080001),
            Plan("nuisance", ("temperature_rate",), (1.0,), "run bias", 12080037),
            Plan("single", ("temperature_rate",), (1.0,), "", 12080001),
        )
    )
    assert hidden < page.EVEN_ODDS < min(seen, none)


@pytest.mark.slow
@pytest.mark.parametrize(
    "one",
    [
        pytest.param(Plan("single", ("periodic_interference",), (26.856245820706686,), "", 2080015), id="a line that strays"),
        pytest.param(Plan("pair", ("mode_hop", "ageing"), (3.7660165327337487, 7.5217751030221205), "", 6080025), id="a ladder"),
        pytest.param(Plan("nuisance", ("thermal_lag",), (2.5890198731287954,), "run bias", 12080037), id="biases of runs"),
    ],
)
def test_cases_of_an_earlier_page_that_were_wrong(one: Plan) -> None:
    row = run_case(one)
    assert row["exact"]
    assert row["nuisance_found"] is not False
