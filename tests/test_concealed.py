"""The concealed benchmark: its independent physics by identities and closed forms, its cases by their definitions, its tables."""

from __future__ import annotations

import itertools
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import rlgcomp as rlg
from experiments.concealed import __main__ as program
from experiments.concealed import tables, turntable
from experiments.concealed.__main__ import main
from experiments.concealed.cases import KINDS, STRENGTHS, dump, make_case, means, plan, read_in_pulses, stream
from experiments.concealed.chamber import Unit, two_halves
from experiments.concealed.effects import INDEPENDENT, OUTSIDE, catalogued
from experiments.concealed.noise import Noise
from experiments.concealed.operators import Relays, first_order, slab
from experiments.concealed.programmes import COLDEST_DEG_C, HOTTEST_DEG_C, random_programme
from experiments.concealed.score import Manner, died
from rlgcomp.physics import CATALOGUE


@pytest.fixture(scope="module")
def runs() -> list[Any]:
    return [Unit.draw(stream(seed, "unit")).run(stream(seed, "run")) for seed in range(4)]


class TestOperators:
    def test_a_slab_follows_its_series(self) -> None:
        """A front that rises by a unit within a sample: 1 - sum 8 / (pi² m²) exp(-m² t / tau), m odd (Carslaw and Jaeger, 3.4)."""
        step_s, slowest_s = 5.0, 1000.0
        front = np.r_[0.0, np.ones(600)]
        time_s = step_s * (np.arange(601) - 0.5)
        odd = np.arange(1, 400, 2)[:, None]
        mean = 1.0 - (8.0 / (np.pi**2 * odd**2) * np.exp(-(odd**2) * time_s / slowest_s)).sum(axis=0)
        back = 1.0 - (4.0 / (np.pi * odd) * (-1.0) ** ((odd - 1) / 2) * np.exp(-(odd**2) * time_s / slowest_s)).sum(axis=0)
        assert slab(front, step_s, slowest_s)[5:] == pytest.approx(mean[5:], abs=2e-3)
        assert slab(front, step_s, slowest_s, at="back")[5:] == pytest.approx(back[5:], abs=2e-3)

    def test_lock_in_follows_the_mean_over_a_beat_and_stands_still_below(self) -> None:
        """sgn(W) sqrt(W² - W_L²) above lock-in, nothing below (Aronowitz 1999)."""
        rate = np.repeat([-40.0, -2.0, -0.05, -0.02, 0.01, 0.029, 0.04, 0.5, 10.0], 30)[:, None] * np.ones(turntable.INSTANTS)
        turn = turntable.Turn(rate, np.full(rate.shape, 20.0), 0.0)
        out = 3600.0 * rate[:, 0] + turntable.locked(turn, 0.03)
        mean = 3600.0 * np.sign(rate[:, 0]) * np.sqrt(np.maximum(rate[:, 0] ** 2 - 0.03**2, 0.0))
        settled = np.arange(len(out)) % 30 > 4
        assert np.abs(out - mean)[settled & (np.abs(rate[:, 0]) < 0.03)].max() < 1e-9
        for level in np.unique(rate[:, 0]):
            here = settled & (rate[:, 0] == level)
            assert out[here].mean() == pytest.approx(mean[here].mean(), abs=0.8427 / here.sum() + 1e-6)

    def test_a_lag_settles_with_its_time_constant(self) -> None:
        response = first_order(np.r_[0.0, np.ones(5000)], 1.0, 500.0)
        assert response[500] == pytest.approx(1.0 - np.exp(-499.5 / 500.0), abs=1e-4)
        assert first_order(np.full(50, 7.0), 1.0, 20.0) == pytest.approx(np.full(50, 7.0))

    @given(st.lists(st.floats(0.0, 39.0), max_size=12))
    def test_relays_wipe_out_smaller_swings(self, swings: list[float]) -> None:
        relays = Relays(-70.0, 95.0, 40, 12.0)
        _, straight = relays.run(np.array([0.0, 40.0]), relays.start(0.0))
        _, wandered = relays.run(np.array([0.0, *swings, 40.0]), relays.start(0.0))
        assert np.array_equal(straight, wandered)

    @given(st.floats(-60.0, 80.0), st.booleans())
    def test_minor_loops_between_the_same_ends_are_congruent(self, history: float, from_below: bool) -> None:
        """Whatever came before, a loop from 10 to 30 and back gains and loses the same."""
        relays = Relays(-70.0, 95.0, 40, 12.0)
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
    def test_a_programme_lasts_8_to_12_h_within_its_span(self, seed: int) -> None:
        times, temperatures = random_programme(np.random.default_rng(seed))
        assert 8.0 * 3600.0 <= times[-1] <= 12.0 * 3600.0
        assert (np.diff(times) > 0.0).all()
        assert temperatures.min() >= COLDEST_DEG_C
        assert temperatures.max() <= HOTTEST_DEG_C
        assert (np.abs(np.diff(temperatures) / np.diff(times)) * 60.0 <= 1.81).all()

    def test_rate_is_the_derivative_of_the_block(self, runs: list[Any]) -> None:
        for run in runs:
            assert np.gradient(run.block) * 60.0 == pytest.approx(run.rate_K_min, abs=2e-3)

    def test_rate_and_gradient_are_two_things(self, runs: list[Any]) -> None:
        """In the plant of rlgcomp the correlation is one, so no diagnosis could tell them apart."""
        for run in runs:
            columns = np.column_stack([means(run.rate_K_min), means(run.block - run["temperature_shell_degC"])])
            design = np.vander((means(run.block) - 10.0) / 50.0, 4)
            left = columns - design @ np.linalg.lstsq(design, columns, rcond=None)[0]
            assert 0.5 < abs(np.corrcoef(left.T)[0, 1]) < 0.995

    def test_a_beam_off_centre_shifts_the_halves_against_each_other(self) -> None:
        a, b = two_halves(np.array([-20.0, 0.0, 20.0]))
        assert a[1] == b[1] == pytest.approx(1.0)
        assert a[2] == pytest.approx(b[0])
        assert a[2] > 1.0 > b[2]


class TestNoise:
    def test_flicker_has_the_allan_floor_of_its_strength(self) -> None:
        """AVAR = (2 ln 2 / pi) B² between the relaxation times, and what white noise there is besides."""
        noise = Noise(1e-12, flicker=1e-3)
        tau = 300
        variances = []
        for seed in range(30):
            blocks = noise.simulate(30_000, np.random.default_rng(seed)).reshape(-1, tau).mean(axis=1)
            variances.append(0.5 * np.mean(np.diff(blocks) ** 2))
        assert np.mean(variances) == pytest.approx(2.0 * np.log(2.0) / np.pi * 1e-6, rel=0.1)

    def test_white_noise_and_random_walk_have_their_sizes(self) -> None:
        white = Noise(5e-4).simulate(100_000, np.random.default_rng(0))
        assert means(white).std() == pytest.approx(Noise(5e-4).white_100_s_deg_h, rel=0.05)
        ends = [Noise(1e-12, walk=2e-4).simulate(3600, np.random.default_rng(seed))[-1] for seed in range(300)]
        assert np.std(ends) == pytest.approx(2e-4, rel=0.15)

    def test_covariance_is_that_of_the_means(self) -> None:
        noise = Noise(3e-4, flicker=1e-3, walk=5e-4)
        windows = np.array([means(noise.simulate(2000, np.random.default_rng(seed))) for seed in range(1500)])
        expected = noise.covariance(20, 100.0)
        found = windows.T @ windows / len(windows)
        spread = np.sqrt((expected**2 + np.outer(np.diag(expected), np.diag(expected))) / len(windows))
        assert np.sqrt(np.mean(((found - expected) / spread) ** 2)) < 1.5


class TestCases:
    @pytest.mark.parametrize("independent", [True, False])
    @pytest.mark.parametrize("name", ["warm_up", "light_intensity", "thermal_hysteresis", "mode_hop", "random_telegraph"])
    def test_strength_is_what_it_is_defined_to_be(self, name: str, independent: bool) -> None:
        """The same case with next to nothing of the effect: the difference, projected, has the size that was asked for."""
        with_it, without = (make_case("single", (name,), strength, 11, independent) for strength in (0.5, 1e-9))
        design, effect = [], []
        for a, b in zip(with_it.train, without.train, strict=True):
            effect.append(means(a.column("gyro_deg_h") - b.column("gyro_deg_h")))
            design.append(np.vander(means(a.column("temperature_block_degC")) / 50.0, 4))
            if len(with_it.simulator_mapping["mechanisms"]) > 1:
                design[-1] = np.column_stack([design[-1], _known(with_it, a)])
        columns, target = np.vstack(design), np.concatenate(effect)
        left = target - columns @ np.linalg.lstsq(columns, target, rcond=None)[0]
        assert left.std() / with_it.white_100_s_deg_h == pytest.approx(0.5, rel=0.05)

    def test_the_same_seed_makes_the_same_case_and_another_seed_another(self) -> None:
        first, again, other = (make_case("pair", ("ageing", "warm_up"), 1.0, seed, True) for seed in (3, 3, 4))
        assert first.train[0].table.equals(again.train[0].table)
        assert first.sizes == again.sizes
        assert not np.array_equal(first.train[0].column("gyro_deg_h")[:100], other.train[0].column("gyro_deg_h")[:100])

    def test_what_is_hidden_is_not_in_the_simulator_and_the_driver_not_in_the_recording(self) -> None:
        for arguments in (plan(kind, 4)[k] for kind in KINDS for k in range(4)):
            case = make_case(*arguments)
            simulator = rlg.Simulator.from_mapping(case.simulator_mapping)
            assert not {mechanism.name for mechanism in simulator.mechanisms} & set(case.hidden)
            assert all(simulator.free[mechanism.name] for mechanism in simulator.mechanisms)
            columns = set(case.train[0].columns)
            if case.kind == "driverless":
                assert not columns & set(CATALOGUE[case.hidden[0]].drivers)
            elif case.kind != "table":
                assert {"supply_voltage_V", "pressure_hPa", "magnetic_field_uT"} <= columns
            assert set(case.drivers) <= columns
            assert len(case.truth_held_out) == len(case.oracle) == len(case.test) == 2
            assert all(len(t) == len(o) == len(r) for t, o, r in zip(case.truth_held_out, case.oracle, case.test, strict=True))

    def test_an_oracle_that_knows_the_law_comes_close_to_the_truth(self) -> None:
        """White noise only: the error is that of a handful of fitted numbers among several hundred means."""
        for arguments in plan("single", 17):
            case = make_case(*arguments)
            noise = case.simulator_mapping.get("noise", {"bias_instability_deg_h": 1.0})
            if case.repeats and not noise["bias_instability_deg_h"]:
                left = np.concatenate([means(o - t) for o, t in zip(case.oracle, case.truth_held_out, strict=True)])
                assert left.std() < 0.35 * case.white_100_s_deg_h

    def test_an_effect_that_the_training_runs_cannot_show_is_drawn_again(self) -> None:
        """The first hop of this seed lies outside both programmes: scaled up it would be 1e10 deg/h held out."""
        case = make_case("single", ("mode_hop",), 0.5, 104_018, True)
        assert case.information_nats > 10.0
        assert abs(case.sizes["mode_hop.step_deg_h"]) < 1.0

    def test_information_grows_with_the_square_of_the_strength(self) -> None:
        weak, strong = (make_case("single", ("ambient_pressure",), s, 2, True) for s in (0.25, 0.5))
        assert strong.information_nats == pytest.approx(4.0 * weak.information_nats)
        assert make_case("null", (), 0.0, 2, True).information_nats == 0.0

    @pytest.mark.parametrize("seed", [150_048, 150_150, 150_252])
    def test_a_bias_is_no_part_of_an_effect(self, seed: int) -> None:
        """A polynomial has a mean, which every gyro's bias absorbs: in white noise a strength tells no more than this."""
        case = make_case("single", ("thermal_polynomial",), 0.25, seed, True)
        windows = sum(len(run) // 100 for run in case.train)
        assert case.information_nats <= 0.5 * 0.25**2 * windows * (1.0 + 1e-9)

    def test_strengths_may_be_relative_to_all_noise(self) -> None:
        noise = Noise(5e-4, 8e-4, 4e-4)
        rng = np.random.default_rng(5)
        drawn = [means(noise.simulate(36_000, rng)).std() for _ in range(30)]
        assert noise.std_100_s_deg_h(360) == pytest.approx(np.sqrt(np.mean(np.square(drawn))), rel=0.05)
        assert Noise(5e-4).std_100_s_deg_h(360) == pytest.approx(6.0 * 5e-4, rel=0.01)
        loud = next(seed for seed in range(9) if Noise.draw(stream(seed, "noise")).flicker)
        sizes = [
            make_case("single", ("ambient_pressure",), 0.25, loud, True, noise_of_units=one).sizes["ambient_pressure.k_deg_h_hPa"]
            for one in ("drawn", "whole")
        ]
        own = Noise.draw(stream(loud, "noise"))
        assert 1.0 < sizes[1] / sizes[0] < 2.0 * own.std_100_s_deg_h(400) / own.white_100_s_deg_h

    def test_the_plan_has_every_effect_at_every_strength_by_both_makers(self) -> None:
        made = {(names[0], strength, independent) for _, names, strength, _, independent in plan("single", 102)}
        assert made == set(itertools.product(INDEPENDENT, STRENGTHS["single"], (True, False)))
        assert {names[0] for _, names, *_ in plan("open", 10)} == set(OUTSIDE)
        assert {(s, i) for _, _, s, _, i in plan("pair", 8)} == set(itertools.product(STRENGTHS["pair"], (True, False)))

    def test_the_catalogue_is_covered_and_shapes_carry_its_names(self) -> None:
        chamber = {name for name, form in CATALOGUE.items() if form.kind == "chamber" and not form.empirical}
        assert set(INDEPENDENT) == chamber
        turning = {name for name, form in CATALOGUE.items() if form.kind == "turntable" and not form.empirical}
        assert {*turntable.EFFECTS, "scale_factor"} == turning  # a scale factor every simulator of a table has
        for name in INDEPENDENT:
            names = {parameter.name for parameter in CATALOGUE[name].parameters()}
            for effect in (INDEPENDENT[name](np.random.default_rng(0)), catalogued(name, np.random.default_rng(0))):
                assert ({effect.size} - {""}) | set(effect.shapes) <= names

    def test_a_dumped_case_is_read_by_the_command_line(self, tmp_path: Path) -> None:
        case = make_case("open", ("resonance",), 1.0, 5, True)
        dump(case, tmp_path)
        assert rlg.Simulator.from_yaml(tmp_path / "sim.yaml") == rlg.Simulator.from_mapping(case.simulator_mapping)
        assert rlg.read(tmp_path / "run0.parquet").table.equals(case.train[0].table)
        truth = json.loads((tmp_path / "truth.json").read_text())
        assert truth["hidden"] == ["resonance"]
        assert truth["drivers"] == ["temperature_block_degC"]


def _known(case: Any, run: rlg.Recording) -> np.ndarray:
    mapping = {"kind": "chamber", "mechanisms": case.simulator_mapping["mechanisms"][1:]}
    (mechanism,) = rlg.Simulator.from_mapping(mapping).mechanisms
    return means(mechanism.basis(run))


class TestTables:
    ROW: dict[str, Any] = {  # noqa: RUF012
        "independent": True,
        "seed": 1,
        "verdict": "explained",
        "detected": True,
        "verdict_right": True,
        "named": True,
        "exact": True,
        "in_class": True,
        "overlap": 0.5,
        "errors_sd": {"ageing.k_deg_h_day": 1.0},
        "p_value": 1e-5,
        "findings": ["ageing"],
        "probabilities": [0.9],
        "drivers": [],
        "memory": "none",
        "true_drivers": [],
        "true_memory": "none",
        "repeats": True,
        "error_to_oracle": 1.1,
        "seconds": 2.0,
        "information_nats": 20.0,
        "white_noise": True,
    }

    def row(self, kind: str, hidden: str, **changes: Any) -> dict[str, Any]:
        return self.ROW | {"key": kind + hidden, "name": kind + hidden, "kind": kind, "hidden": [hidden], "strength": 1.0} | changes

    def test_a_failure_counts_as_a_wrong_answer(self, capsys: pytest.CaptureFixture[str]) -> None:
        failed = {"key": "x", "kind": "single", "hidden": ["ageing"], "strength": 1.0, "independent": True, "failure": "Boom: x"}
        tables.show([self.row("single", "ageing"), failed])
        text = capsys.readouterr().out
        assert "50 % (1/2" in text
        assert "Boom" in text

    def test_units_with_flicker_are_counted_by_themselves(self) -> None:
        noisy = [
            self.row("pair", "ageing", white_noise=False, exact=False, in_class=right, information_nats=tables.THRESHOLD_NATS)
            for right in (True, False)
        ]
        (line,) = tables.by_noise([self.row("pair", "ageing", information_nats=50.0), *noisy])
        said = [line[key].split(";")[0] for key in list(line)[2:]]
        assert said == ["100 % (1/1", "100 % (1/1", "100 %", "0 % (0/2", "50 % (1/2", "50 %"]

    def test_named_causes_are_counted_by_the_probability_they_were_given(self) -> None:
        sure = [self.row("single", "ageing", findings=["ageing"], probabilities=[p]) for p in (0.992, 1.0)]
        wrong = self.row("null", "", findings=["warm_up", "ageing"], probabilities=[0.65, 0.55])
        half = self.row("single", "warm_up", findings=["warm_up"], probabilities=[0.6])
        lines = tables.by_probability([*sure, wrong, half])
        assert [line["named"] for line in lines] == ["3", "2"]
        assert [line["said, mean"] for line in lines] == ["60.0 %", "99.6 %"]
        assert [line["so"].split(";")[0] for line in lines] == ["33.3 % (1", "100.0 % (2"]

    def test_what_counts_as_right(self) -> None:
        assert tables.right(self.row("null", "", verdict="none"))
        assert not tables.right(self.row("null", "", verdict="unknown"))
        assert tables.right(self.row("driverless", "magnetic_field", verdict="unknown", findings=[]))
        assert not tables.right(self.row("driverless", "magnetic_field", verdict="unknown", findings=["ageing"]))
        outside = self.row("open", "product", verdict="unknown", drivers=["a", "b"], true_drivers=["a", "b"])
        assert tables.right(outside)
        assert not tables.right(outside | {"drivers": ["a"]})
        assert not tables.right(outside | {"memory": "dynamic"})
        assert not tables.right(outside | {"error_to_oracle": 2.1})

    def test_every_kind_is_shown(self, capsys: pytest.CaptureFixture[str]) -> None:
        rows = [self.row(kind, name) for kind, name in zip(KINDS, (*list(INDEPENDENT)[:6], "lock_in", "ageing"), strict=True)]
        tables.show(
            [
                *rows,
                self.row("single", "ageing", strength=0.5, findings=["ageing", "warm_up"], probabilities=[0.6, 0.5], exact=False),
            ]
        )
        text = capsys.readouterr().out
        assert all(
            title in text for title in ("Goals", "One effect", "Healthy gyros", "Outside the catalogue", "Driver not recorded")
        )

    def test_dumping_needs_no_diagnosis(self, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
        main(["--only", "null", "--cases", "1", "--dump", str(tmp_path / "made")])
        (folder,) = (tmp_path / "made").iterdir()
        assert str(folder) in capsys.readouterr().out
        assert (folder / "sim.yaml").is_file()


class TestManyCases:
    """A run that is stopped goes on where it was, and says what failed."""

    @pytest.fixture
    def made(self, monkeypatch: pytest.MonkeyPatch) -> list[str]:
        """Keys of the cases that are diagnosed, which is not done here."""
        keys: list[str] = []

        def run(arguments: Any, manner: Manner) -> dict[str, Any]:
            keys.append(manner.key_of(arguments))
            return {"key": keys[-1], "kind": "null", "verdict": "none", "name": "n", "findings": [], "seconds": 1.0}

        monkeypatch.setattr(program, "run_case", run)
        monkeypatch.setattr(program.tables, "show", len)
        monkeypatch.setattr(program.tables, "mark", lambda row: row["key"])
        return keys

    def test_it_goes_on_after_a_kill(self, made: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
        """Of three lines one tells of a failure and one was cut short: both are made again, and two cases more."""
        rows = tmp_path / "rows.jsonl"
        options = ["--only", "null", "--jobs", "1", "--rows", str(rows), "--cases"]
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
        assert capsys.readouterr().out.startswith("# Concealed physics: `python -m experiments.concealed --only null")

    def test_cases_with_their_noise_stated_or_in_pulses_are_others(self, made: list[str], tmp_path: Path) -> None:
        options = ["--only", "null", "--cases", "2", "--jobs", "1", "--resume", "--rows", str(tmp_path / "rows.jsonl")]
        main(options)
        main([*options, "--noise-stated"])
        main([*options, "--noise-stated"])
        main([*options, "--pulse-arcsec", "1.13"])
        main([*options, "--whole-noise"])
        main([*options, "--white-noise"])
        assert len(made) == len(set(made)) == 10

    def test_cases_of_one_strength_in_white_noise(self, tmp_path: Path) -> None:
        """As they were but for flicker and walk."""
        options = ["--only", "single", "--first", "3", "--cases", "18", "--strength", "0.25", "--white-noise"]
        main([*options, "--dump", str(tmp_path)])
        folders = sorted(tmp_path.iterdir())
        assert len(folders) == 6
        for folder in folders:
            assert "-0.25-" in folder.name
        loud = next(arguments for arguments in plan("single", 18, 3) if Noise.draw(stream(arguments[3], "noise")).flicker)
        drawn, white = (make_case(*loud, noise_of_units=one) for one in ("drawn", "white"))
        assert drawn.sizes == white.sizes
        assert white.noise == drawn.noise | {"bias_instability_deg_h": 0.0, "rate_random_walk_deg_h_sqrt_h": 0.0}

    def test_a_gyro_in_pulses_is_the_same_gyro(self) -> None:
        case = make_case("null", (), 0.0, 400_000, True)
        read = read_in_pulses(case, 1.13)
        for before, after in zip((*case.train, *case.test), (*read.train, *read.test), strict=True):
            turned = np.cumsum(after.column("gyro_deg_h") - before.column("gyro_deg_h"))  # arcsec
            assert np.ptp(turned) <= 2.0 * 2.0 * 1.13  # rounding and dither, at the beginning and now
            assert np.std(turned) == pytest.approx(1.13 / np.sqrt(6.0), rel=0.05)
            assert len(np.unique(np.round(after.column("gyro_deg_h"), 6))) < 12
        assert [one.name for one in read.train] == [one.name for one in case.train]

    def test_a_scheduler_that_does_not_answer_ends_with_a_message(
        self, made: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
        arguments = ["--only", "null", "--cases", "1", "--rows", str(tmp_path / "rows"), "--scheduler", "nonsense://here"]
        with pytest.raises(SystemExit, match="2"):
            main(arguments)
        assert capsys.readouterr().err.startswith("error: ")
        assert not made

    def test_a_case_that_kills_its_worker_is_counted_as_failed(self) -> None:
        (arguments,) = plan("null", 1, 0)
        row = died(arguments)
        assert row["key"] == repr(arguments)
        assert "died" in row["failure"]
        assert not tables.right(row)
