"""Challenges: hidden causes have their size, only truth.json reveals them, a changed truth is refused, the score is fair."""

from __future__ import annotations

import functools
import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from pyarrow import parquet
from typer.testing import CliRunner, Result

import rlgcomp as rlg
from rlgcomp.challenge.conceal import PROGRAMMES, RUNS, Challenge, conceal
from rlgcomp.challenge.injection import Projection, drawn, injected, scaled, strongest_intervals
from rlgcomp.challenge.score import Hidden, Score
from rlgcomp.challenge.seal import reveal, seal
from rlgcomp.cli import register_commands
from rlgcomp.cli.base import app
from rlgcomp.files import sha256
from rlgcomp.physics import CATALOGUE
from tests.own_mechanism import write_bellows

CHAMBER = [name for name, form in CATALOGUE.items() if form.kind == "chamber" and not form.empirical]
SIMULATOR = {
    "kind": "chamber",
    "mechanisms": [
        {"thermal_polynomial": {"degree": 3}},
        {"temperature_rate": {"k_deg_h_min_K": 0.004}},
    ],
    "noise": {"angle_random_walk_deg_sqrt_h": 0.0004},
}


@functools.cache
def challenge(hide: str, seed: int = 3, strength: float | None = None) -> Challenge:
    return conceal(rlg.Simulator.from_mapping(SIMULATOR), hide, seed=seed, strength=strength, step_s=10.0)


@functools.cache
def projection() -> Projection:
    made = challenge("warm_up")
    return Projection.of(made.simulator, made.train)


def finding(name: str, *others: str, **parameters: tuple[float, float]) -> dict[str, Any]:
    estimates = {key: {"value": value, "sd": sd, "unit": ""} for key, (value, sd) in parameters.items()}
    return {"mechanism": name, "probability": 0.9, "parameters": estimates, "indistinguishable_from": list(others)}


def diagnosis(verdict: str, *findings: Mapping[str, Any], where: Any = (), test: Any = None) -> dict[str, Any]:
    places = [{"run": run, "start_s": start, "end_s": end} for run, start, end in where]
    return {
        "schema": "rlgcomp.diagnosis/1",
        "verdict": verdict,
        "mismatch": {"p_value": 0.0, "where": places},
        "findings": list(findings),
        "fit": {"test": test},
    }


class TestInjection:
    @given(st.sampled_from(CHAMBER), st.integers(0, 1000))
    @settings(max_examples=40, deadline=None)
    def test_drawn_mechanisms_are_possible_and_scale(self, name: str, seed: int) -> None:
        made = challenge("warm_up")
        mechanism = drawn(CATALOGUE[name], made.train, np.random.default_rng(seed), 100.0)
        assert type(mechanism).from_mapping(mechanism.to_mapping()) == mechanism
        half = scaled(mechanism, 0.5)
        run = made.train[0]
        whole = mechanism.contribution(run, np.random.default_rng(1))
        assert half.contribution(run, np.random.default_rng(1)) == pytest.approx(0.5 * whole, rel=1e-9, abs=1e-15)

    def test_the_unabsorbed_part_is_orthogonal_to_the_baseline(self) -> None:
        rng = np.random.default_rng(0)
        residual = projection().unabsorbed([rng.standard_normal(len(run)) for run in projection().recordings])
        design = projection().columns
        assert np.abs(design.T @ residual).max() < 1e-8 * np.linalg.norm(residual)

    def test_the_simulator_absorbs_its_own_terms(self) -> None:
        cubic = [1e-6 * run.column("temperature_block_degC") ** 3 for run in projection().recordings]
        assert np.abs(projection().unabsorbed(cubic)).max() < 1e-6

    def test_white_noise_is_estimated_in_spite_of_the_effect(self) -> None:
        assert projection().white_deg_h == pytest.approx(6.0 * 0.0004, rel=0.1)

    def test_the_strongest_intervals_hold_most_of_a_burst(self) -> None:
        bursts = [np.exp(-0.5 * ((run.time_s - 9000.0) / 600.0) ** 2) for run in projection().recordings]
        effect = projection().unabsorbed(bursts)
        spans = strongest_intervals(projection(), effect)
        for run in projection().recordings:
            assert any(start < 9000.0 < end for start, end in spans[run.name])
        assert strongest_intervals(projection(), np.ones(len(effect))) == {}

    @pytest.mark.parametrize(("column", "factor"), [("gyro_deg_h", 1.0), ("gyro_deg_s", 3600.0)])
    def test_an_error_is_added_in_the_gyros_own_unit(self, column: str, factor: float) -> None:
        run = rlg.Recording(pd.DataFrame({"time_s": np.arange(50.0), column: np.linspace(-1.0, 1.0, 50)}))
        error = np.linspace(0.0, 0.5, 50)
        assert injected(run, error).rate_deg_h() - run.rate_deg_h() == pytest.approx(error, abs=1e-9)
        assert (injected(run, error).column(column) - run.column(column)) * factor == pytest.approx(error, abs=1e-9)

    def test_pulses_stay_whole_and_add_up(self) -> None:
        table = pd.DataFrame({"time_s": np.arange(5000.0), "gyro_pulses": np.full(5000, 7.0)})
        run = rlg.Recording(table, rlg.Metadata(pulse_arcsec=0.9))
        counted = injected(run, np.full(5000, 0.05)).column("gyro_pulses")
        assert np.array_equal(counted, np.rint(counted))
        assert (counted - 7.0).sum() == pytest.approx(5000 * 0.05 / 0.9, abs=0.51)


class TestConceal:
    def test_one_that_the_simulator_lacks_acts_with_strength_one(self) -> None:
        made = challenge("light_intensity")
        assert made.hidden.mechanisms == ("light_intensity",)
        assert made.strengths["light_intensity"] == pytest.approx(1.0, rel=1e-6)
        assert made.simulator == rlg.Simulator.from_mapping(SIMULATOR)
        assert set(made.hidden.parameters) == {"light_intensity.k_deg_h_V"}
        healthy = challenge("warm_up")
        assert np.abs(made.train[0].column("gyro_deg_h") - healthy.train[0].column("gyro_deg_h")).max() > 0.0

    def test_one_that_the_simulator_has_is_taken_out_with_its_own_size(self) -> None:
        made = challenge("temperature_rate")
        assert [mechanism.name for mechanism in made.simulator.mechanisms] == ["thermal_polynomial"]
        assert made.hidden.parameters["temperature_rate.k_deg_h_min_K"] == 0.004
        assert challenge("temperature_rate", strength=2.0).strengths["temperature_rate"] == pytest.approx(2.0, rel=1e-6)

    def test_a_share_that_is_one_in_nature_is_one(self) -> None:
        """A lock-in whose share was drawn read backwards within its dead zone, and no diagnosis could be right about it."""
        table = rlg.Simulator.from_mapping(
            {"kind": "turntable", "mechanisms": ["scale_factor", "lock_in"], "noise": {"angle_random_walk_deg_sqrt_h": 1e-3}}
        )
        for seed in range(3):
            (hidden,) = conceal(table, "lock_in", seed=seed, step_s=1.0).mechanisms
            assert hidden.fraction == 1.0

    def test_several_at_once_and_effects_that_no_run_repeats(self) -> None:
        made = challenge("random_telegraph,ambient_pressure", strength=0.5)
        assert set(made.strengths) == {"random_telegraph", "ambient_pressure"}
        assert list(made.strengths.values()) == pytest.approx([0.5, 0.5], rel=1e-6)
        noise = 6.0 * 0.0004
        assert made.possible_rms_deg_h > 1.05 * noise  # the telegraph cannot be predicted
        assert challenge("light_intensity").possible_rms_deg_h == pytest.approx(noise, rel=0.1)

    def test_an_effect_far_above_its_usual_size_has_a_remark(self) -> None:
        def remarks(mechanisms: list[object], hide: str, **options: float) -> list[tuple[str, str]]:
            simulator = rlg.Simulator.from_mapping(SIMULATOR | {"mechanisms": mechanisms})
            return [(one.code, one.data["mechanism"]) for one in conceal(simulator, hide, step_s=60.0, **options).remarks]

        static = {"thermal_polynomial": {"degree": 3}}
        absorbed = [("challenge.absorbed_by_the_simulator", "thermal_gradient")]
        assert remarks([static, "temperature_rate"], "thermal_gradient", seed=5, strength=0.6) == absorbed
        assert remarks([static], "thermal_gradient", seed=5, strength=0.6) == []
        large = [("challenge.far_above_usual_size", "supply_voltage")]
        assert remarks([static], "supply_voltage", seed=5, strength=60.0) == large

    def test_random_hides_nothing_one_or_two(self) -> None:
        gyro = rlg.Simulator.from_mapping(SIMULATOR)
        counts = {len(conceal(gyro, "random", seed=seed, step_s=60.0).hidden.mechanisms) for seed in range(5)}
        assert counts == {0, 1, 2}

    def test_nothing_hidden_is_a_healthy_gyro(self, tmp_path: Path) -> None:
        made = challenge("none")
        assert made.mechanisms == ()
        assert made.simulator == rlg.Simulator.from_mapping(SIMULATOR)
        seal(made, tmp_path / "c")
        (tmp_path / "d.json").write_text(json.dumps(diagnosis("none")))
        assert reveal(tmp_path / "c", tmp_path / "d.json").score.exact

    def test_a_seed_makes_it_again_and_none_is_secret(self) -> None:
        """Without one, no two challenges have a monitor alike, and the seed in truth.json makes it again."""
        gyro = rlg.Simulator.from_mapping(SIMULATOR)
        first, second = (conceal(gyro, "ageing", step_s=60.0) for _ in range(2))
        again = conceal(gyro, "ageing", step_s=60.0, seed=first.seed)
        assert min(first.seed, second.seed) > 2**64
        for run, other, same in zip(first.train, second.train, again.train, strict=True):
            assert not np.isin(run.column("supply_voltage_V"), other.column("supply_voltage_V")).any()
            pd.testing.assert_frame_equal(run.table, same.table)

    def test_runs_held_out_follow_other_programmes(self) -> None:
        made = challenge("warm_up")
        paths = [run.column("temperature_block_degC")[:2000:10].round(0).tolist() for run in (*made.train, *made.test)]
        assert len({str(path) for path in paths}) == len(RUNS) == len(PROGRAMMES["chamber"])

    @pytest.mark.parametrize("hide", ["gravity", "ageing,ageing", "", "lock_in"])
    def test_unknown_and_repeated_names_are_refused(self, hide: str) -> None:
        with pytest.raises(rlg.InputError, match="cannot hide"):
            challenge(hide)

    @pytest.mark.parametrize("strength", [0.0, -1.0, float("nan"), float("inf")])
    def test_impossible_strengths_are_refused(self, strength: float) -> None:
        with pytest.raises(rlg.InputError, match="strength"):
            conceal(rlg.Simulator.from_mapping(SIMULATOR), "ageing", strength=strength)


class TestNothingLeaks:
    """Everything but truth.json is for whoever diagnoses: it must contain no more than the gyro's output does."""

    @pytest.fixture(scope="class")
    @classmethod
    def folders(cls, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
        base = tmp_path_factory.mktemp("challenges")
        hidden = ["light_intensity", "mode_hop", "random_telegraph", "thermal_hysteresis", "magnetic_field", "temperature_rate"]
        for name in hidden:
            seal(challenge(name), base / name)
        return {name: base / name for name in hidden}

    @pytest.mark.parametrize("name", ["light_intensity", "mode_hop", "random_telegraph", "thermal_hysteresis", "temperature_rate"])
    def test_no_byte_names_it(self, folders: dict[str, Path], name: str) -> None:
        truth = json.loads((folders[name] / "truth.json").read_text())
        for path in folders[name].iterdir():
            if path.name == "truth.json":
                continue
            content = path.read_bytes().replace(b"light_intensity_V", b"").replace(b"magnetic_field_uT", b"")
            for trace in (name, "truth_", "seed", "programme", "strength", truth["salt"]):
                assert trace.encode() not in content.replace(b"truth_sha256", b""), (path.name, trace)

    def test_folders_differ_in_the_gyro_and_the_hash_alone(self, folders: dict[str, Path]) -> None:
        """Same seed, other cause: names, order, rows, columns, metadata and every monitor are the same to the last bit."""
        first, *others = [folders[name] for name in folders if name != "temperature_rate"]
        names = sorted(path.name for path in first.iterdir())
        for other in others:
            assert sorted(path.name for path in other.iterdir()) == names
            assert (other / "simulator.yaml").read_bytes() == (first / "simulator.yaml").read_bytes()
            ours, theirs = (json.loads((folder / "challenge.json").read_text()) for folder in (first, other))
            assert ours | {"truth_sha256": ""} == theirs | {"truth_sha256": ""}
            for run in RUNS:
                a, b = (parquet.read_table(folder / f"{run}.parquet") for folder in (first, other))
                assert a.schema.metadata == b.schema.metadata
                assert a.column_names == b.column_names
                assert a.drop(["gyro_deg_h"]).equals(b.drop(["gyro_deg_h"]))

    def test_the_hash_cannot_be_found_by_trying_the_catalogue(self, tmp_path: Path) -> None:
        """The same truth sealed twice has two hashes."""
        for name in ("a", "b"):
            seal(challenge("mode_hop"), tmp_path / name)
        first, second = (json.loads((tmp_path / name / "challenge.json").read_text())["truth_sha256"] for name in ("a", "b"))
        assert first != second

    def test_the_simulator_file_of_a_cause_taken_out_is_as_if_it_never_had_it(self, folders: dict[str, Path]) -> None:
        content = yaml.safe_load((folders["temperature_rate"] / "simulator.yaml").read_text())
        assert [list(item) for item in content["mechanisms"]] == [["thermal_polynomial"]]


class TestReveal:
    @pytest.fixture
    def folder(self, tmp_path: Path) -> Path:
        seal(challenge("temperature_rate"), tmp_path / "challenge")
        return tmp_path / "challenge"

    def write(self, folder: Path, content: Mapping[str, Any]) -> Path:
        path = folder.parent / "diagnosis.json"
        path.write_text(json.dumps(content))
        return path

    def test_a_right_answer(self, folder: Path) -> None:
        right = finding("temperature_rate", "thermal_gradient", k_deg_h_min_K=(0.0041, 0.0001))
        held_out = {"baseline_rms": 0.004, "augmented_rms": 0.0025}
        revealed = reveal(folder, self.write(folder, diagnosis("explained", right, test=held_out)).parent)
        assert revealed.score.exact
        assert revealed.score.errors_sd == {"temperature_rate.k_deg_h_min_K": pytest.approx(1.0)}
        assert revealed.improvement == pytest.approx(0.375)
        assert revealed.possible_improvement == pytest.approx(0.4, abs=0.05)
        assert revealed.hidden["temperature_rate"]["k_deg_h_min_K"] == 0.004

    def test_what_the_true_law_gains_is_in_the_windows_of_the_answer(self, folder: Path) -> None:
        """White noise alone is left: of means over four times as long half of it."""
        made = challenge("temperature_rate")
        left = made.possible_rms_deg_h
        (window_s,) = (time_s for time_s, rms in made.possible_by_averaging_s.items() if rms == left)
        for factor in (0.25, 1.0, 3.0):
            held_out = {"baseline_rms": 0.008, "augmented_rms": 0.0025, "averaging_s": factor * window_s}
            path = self.write(folder, diagnosis("none", test=held_out))
            assert reveal(folder, path).possible_improvement == pytest.approx(1.0 - left / math.sqrt(factor) / 0.008, abs=0.03)

    def test_a_changed_truth_is_refused(self, folder: Path) -> None:
        path = self.write(folder, diagnosis("none"))
        truth = folder / "truth.json"
        truth.write_text(truth.read_text().replace("temperature_rate", "thermal_gradient"))
        with pytest.raises(rlg.InputError, match="not the truth that was sealed"):
            reveal(folder, path)

    @pytest.mark.parametrize("name", ["test1.parquet", "simulator.yaml"])
    def test_a_changed_or_missing_file_is_refused(self, folder: Path, name: str) -> None:
        path = self.write(folder, diagnosis("none"))
        (folder / name).unlink()
        with pytest.raises(rlg.InputError, match=name):
            reveal(folder, path)

    @pytest.mark.parametrize(("key", "value"), [("kind", "turntable"), ("note", "mine")])
    def test_an_edited_challenge_is_refused(self, folder: Path, key: str, value: str) -> None:
        path = folder / "challenge.json"
        path.write_text(json.dumps(json.loads(path.read_text()) | {key: value}))
        with pytest.raises(rlg.InputError, match=f"{key} changed since it was sealed"):
            reveal(folder, self.write(folder, diagnosis("none")))

    @pytest.mark.parametrize(
        ("content", "refused"),
        [
            (diagnosis("maybe"), "the verdict is 'maybe'; it must be one of none"),
            (diagnosis("none", finding("ageing")), "the verdict is 'none', yet ageing is found"),
            (diagnosis("explained", finding("ageing") | {"probability": 7.0}), "probability of ageing is 7.0"),
            (diagnosis("explained", finding("ageing") | {"probability": float("nan")}), "probability of ageing is nan"),
            (diagnosis("none") | {"alternatives": [{"mechanisms": [], "probability": -1.0}]}, "of alternative 0 is -1.0"),
            (diagnosis("explained", finding("temperature_rate", k_deg_h_min_K=(float("nan"), 0.1))), "is nan in the diagnosis"),
            (diagnosis("none", test={"baseline_rms": 0.004, "augmented_rms": float("nan")}), "fit.test has rms 0.004 and nan"),
        ],
    )
    def test_impossible_diagnoses_are_refused(self, folder: Path, content: Mapping[str, Any], refused: str) -> None:
        with pytest.raises(rlg.InputError, match=refused) as error:
            reveal(folder, self.write(folder, content))
        assert "Error" not in str(error.value)

    def test_a_truth_kept_elsewhere(self, folder: Path) -> None:
        truth = folder.parent / "kept.json"
        (folder / "truth.json").rename(truth)
        path = self.write(folder, diagnosis("none"))
        with pytest.raises(rlg.InputError, match="--truth"):
            reveal(folder, path)
        assert not reveal(folder, path, truth=truth).score.detected

    def test_a_diagnosis_of_other_recordings_is_refused(self, folder: Path) -> None:
        own = {name: sha256(folder / name) for name in ("train0.parquet", "train1.parquet", "test0.parquet")}
        train, test = dict(list(own.items())[:2]), dict(list(own.items())[2:])
        assert reveal(folder, self.write(folder, diagnosis("none") | {"recordings": {"train": train, "test": test}}))
        recordings = {"train": train, "test": test, "simulator": {"simulator.yaml": sha256(folder / "simulator.yaml")}}
        assert reveal(folder, self.write(folder, diagnosis("none") | {"recordings": recordings}))  # as diagnose writes it
        for recordings in ({"train": {"mine.parquet": "0" * 64}, "test": test}, {"train": own, "test": {}}):
            with pytest.raises(rlg.InputError, match="not one of this challenge"):
                reveal(folder, self.write(folder, diagnosis("none") | {"recordings": recordings}))

    @pytest.mark.parametrize("text", ["", "[]", "{}", "null", '{"schema": "rlgcomp.diagnosis/1"}', '{"schema": "other"}'])
    def test_files_that_are_no_diagnosis_are_refused(self, folder: Path, text: str) -> None:
        path = folder.parent / "diagnosis.json"
        path.write_text(text)
        with pytest.raises(rlg.InputError):
            reveal(folder, path)

    @pytest.mark.parametrize(("name", "sd"), [("k_deg_h_min_K", None), ("k_deg_h_min_K", 0.1), ("of_another", 0.1)])
    def test_text_in_place_of_an_estimate_is_refused(self, folder: Path, name: str, sd: float | None) -> None:
        edited = finding("temperature_rate", **{name: ("abc", sd)})
        with pytest.raises(rlg.InputError, match=f"temperature_rate.{name} is 'abc' in the diagnosis; it must be a number"):
            reveal(folder, self.write(folder, diagnosis("explained", edited)))

    def test_a_choice_is_no_estimate(self, folder: Path) -> None:
        chosen = finding("thermal_hysteresis", start=("from_above", None))
        assert reveal(folder, self.write(folder, diagnosis("explained", chosen))).score.errors_sd == {}

    @pytest.mark.parametrize(
        ("file", "key", "value"),
        [
            ("challenge.json", "train", ["nothing.parquet"]),
            ("challenge.json", "train", 7),
            ("truth.json", "files", [1]),
            ("truth.json", "hidden", None),
            ("truth.json", "intervals", {"train0": [["a", 1]]}),
            ("truth.json", "strengths", {}),
            ("truth.json", "parameters", {"temperature_rate.k_deg_h_min_K": "x"}),
            ("truth.json", "possible_rms_deg_h", None),
            ("diagnosis.json", "recordings", [1]),
            ("diagnosis.json", "fit", [1]),
            ("diagnosis.json", "mismatch", {"where": [{"run": "train0", "start_s": "a", "end_s": "b"}]}),
        ],
    )
    def test_edited_files_are_refused(self, folder: Path, file: str, key: str, value: Any) -> None:
        path = self.write(folder, diagnosis("none") | {"recordings": {"train": {"t": sha256(folder / "train0.parquet")}}})
        changed = path if file == "diagnosis.json" else folder / file
        changed.write_text(json.dumps(json.loads(changed.read_text()) | {key: value}))
        if file == "truth.json":  # sealed anew, so that it is read
            challenge_file = folder / "challenge.json"
            content = json.loads(challenge_file.read_text()) | {"truth_sha256": sha256(changed)}
            challenge_file.write_text(json.dumps(content))
        with pytest.raises(rlg.InputError, match="is not as it was written"):
            reveal(folder, path)


class TestScore:
    HIDDEN = Hidden(("warm_up", "ageing"), {"ageing.k_deg_h_day": 0.1}, {"run0": [(0.0, 100.0)], "run1": [(0.0, 100.0)]})

    def test_sets_and_classes(self) -> None:
        exact = Score.of(self.HIDDEN, diagnosis("explained", finding("ageing"), finding("warm_up")))
        assert (exact.exact, exact.in_class, exact.named, exact.verdict_right) == (True, True, True, True)
        near = Score.of(self.HIDDEN, diagnosis("ambiguous", finding("ageing"), finding("thermal_lag", "warm_up")))
        assert (near.exact, near.in_class) == (False, True)
        # one class cannot answer for both
        twice = Score.of(self.HIDDEN, diagnosis("ambiguous", finding("ageing", "warm_up"), finding("mode_hop")))
        assert not twice.in_class
        more = Score.of(self.HIDDEN, diagnosis("explained", finding("ageing"), finding("warm_up"), finding("mode_hop")))
        assert not more.exact
        assert not more.in_class

    def test_a_healthy_gyro(self) -> None:
        clean = Score.of(Hidden(), diagnosis("none"))
        assert clean.exact
        assert clean.named
        assert clean.verdict_right
        assert not clean.detected
        assert clean.overlap is None
        accused = Score.of(Hidden(), diagnosis("explained", finding("ageing")))
        assert [accused.exact, accused.named, accused.verdict_right] == [False, False, False]

    def test_overlap_is_intersection_over_union(self) -> None:
        content = diagnosis("explained", where=[("run0", 50.0, 150.0), ("run0", 60.0, 70.0), ("run1", None, None)])
        assert Score.of(self.HIDDEN, content).overlap == pytest.approx(50.0 / (150.0 + 100.0))
        perfect = diagnosis("explained", where=[("run0", 0.0, 100.0), ("run1", 0.0, 40.0), ("run1", 40.0, 100.0)])
        assert Score.of(self.HIDDEN, perfect).overlap == pytest.approx(1.0)

    def test_parameters_without_a_standard_deviation_are_left_out(self) -> None:
        content = diagnosis("explained", finding("ageing", k_deg_h_day=(0.13, 0.01)))
        assert Score.of(self.HIDDEN, content).errors_sd == {"ageing.k_deg_h_day": pytest.approx(3.0)}
        unsure = diagnosis("explained", {**finding("ageing"), "parameters": {"k_deg_h_day": {"value": 0.13, "sd": None}}})
        assert Score.of(self.HIDDEN, unsure).errors_sd == {}

    @given(
        st.recursive(
            st.none() | st.integers() | st.text(max_size=5), lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner)
        )
    )
    def test_anything_else_is_refused(self, content: Any) -> None:
        with pytest.raises(rlg.InputError, match="no diagnosis"):
            Score.of(self.HIDDEN, content if isinstance(content, dict) else {"verdict": content})


class TestCommands:
    def run(self, *arguments: object) -> Result:
        register_commands()
        return CliRunner().invoke(app, [str(argument) for argument in arguments])

    def test_ones_own_physics_is_sealed_found_and_revealed(self, tmp_path: Path) -> None:
        """Of kind "any", which a chamber's simulator accepts too; by the commands that are printed, so that the diagnosis names the
        simulator file."""
        (tmp_path / "gyro.yaml").write_text(yaml.safe_dump(SIMULATOR))
        write_bellows(tmp_path / "own.py", "any")
        options = ["--mechanisms", tmp_path / "own.py"]
        hidden = ["--hide", "bellows", "--strength", 2, "--seed", 5, "--step-s", 60, "--out", tmp_path / "c"]
        assert self.run("conceal", tmp_path / "gyro.yaml", *hidden).exit_code == 2
        done = self.run("conceal", tmp_path / "gyro.yaml", *options, *hidden)
        assert done.exit_code == 0, done.output
        assert f"--mechanisms {tmp_path / 'own.py'} --out DIAGNOSIS" in done.stderr
        revealed = self.as_printed(done, tmp_path)
        assert revealed["score"]["exact"] is True
        assert revealed["hidden"]["bellows"]["k_deg_h_hPa2"] > 0.0
        recordings = json.loads((tmp_path / "d" / "diagnosis.json").read_text())["recordings"]
        assert set(recordings) >= {"train", "test", "simulator"}

    def as_printed(self, concealed: Result, folder: Path) -> Any:
        """Output of `reveal --json` after the two commands that conceal printed, split into words as by a shell; the diagnosis
        tries few."""
        printed = [line.partition("rlgcomp ")[2].replace("DIAGNOSIS", str(folder / "d")) for line in concealed.stderr.splitlines()]
        for line in filter(None, printed):
            expanded = [sorted(map(str, Path("/").glob(word[1:]))) if "*" in word else [word] for word in line.split()]
            words = [word for words in expanded for word in words]
            more = ["--json"] if words[0] == "reveal" else ["--averaging-s", 480, "--only", "bellows", "ambient_pressure"]
            done = self.run(*words, *more)
            assert done.exit_code == 0, done.output
        return json.loads(done.stdout)

    def test_conceal_and_reveal(self, tmp_path: Path) -> None:
        (tmp_path / "gyro.yaml").write_text(yaml.safe_dump(SIMULATOR))
        options = ["--hide", "ageing", "--step-s", 10, "--json"]
        sealed = self.run("conceal", tmp_path / "gyro.yaml", *options, "--out", tmp_path / "c")
        assert sealed.exit_code == 0, sealed.output
        assert len(json.loads(sealed.stdout)["truth_sha256"]) == 64
        (tmp_path / "d.json").write_text(json.dumps(diagnosis("explained", finding("ageing", k_deg_h_day=(0.1, 0.1)))))
        shown = self.run("reveal", tmp_path / "c", tmp_path / "d.json")
        assert shown.exit_code == 0
        assert "ageing" in shown.stdout
        score = json.loads(self.run("reveal", tmp_path / "c", tmp_path / "d.json", "--json").stdout)["score"]
        assert score["exact"] is True
        assert self.run("reveal", tmp_path / "c", tmp_path / "d.json", "--out", tmp_path / "r").exit_code == 0
        page = (tmp_path / "r" / "report.html").read_text()
        assert "Concealed was ageing; found was ageing" in page
        assert json.loads((tmp_path / "r" / "reveal.json").read_text())["score"]["exact"] is True
        (tmp_path / "c" / "truth.json").write_text("{}")
        refused = self.run("reveal", tmp_path / "c", tmp_path / "d.json")
        assert refused.exit_code == 2
        assert "sealed" in refused.stderr

    def test_bad_input_ends_with_2_and_writes_no_file(self, tmp_path: Path) -> None:
        (tmp_path / "gyro.yaml").write_text(yaml.safe_dump(SIMULATOR))
        for arguments in (["--hide", "gravity"], ["--hide", "ageing", "--strength", "-1"]):
            done = self.run("conceal", tmp_path / "gyro.yaml", *arguments, "--out", tmp_path / "c")
            assert done.exit_code == 2
            assert "error:" in done.stderr
        assert [path.name for path in tmp_path.iterdir()] == ["gyro.yaml"]
