"""Sensitivity: recovery of a known curve, size of the injections, the command on one small recording."""

from __future__ import annotations

import dataclasses
import functools
import json
from pathlib import Path

import numpy as np
import pytest
import yaml
from matplotlib.figure import Figure
from typer.testing import CliRunner, Result

import rlgcomp as rlg
from rlgcomp.challenge.injection import Projection, contributions, distinct_injections, sized_injection
from rlgcomp.challenge.sensitivity import (
    Curve,
    Sensitivity,
    extrapolation_remarks,
    sensitivity,
)
from rlgcomp.cli import register_commands
from rlgcomp.cli.base import app
from rlgcomp.noise.processes import stream
from rlgcomp.physics import CATALOGUE
from rlgcomp.report.sensitivity import FoundCurve, curves_picture
from tests.few_monitors import few_monitors
from tests.own_mechanism import write_bellows

SIMULATOR = {"kind": "chamber", "mechanisms": [{"thermal_polynomial": {"degree": 3}}]}
FEW = {name: CATALOGUE[name] for name in ("thermal_polynomial", "supply_voltage", "magnetic_field")}


@functools.cache
def recordings() -> tuple[rlg.Recording, ...]:
    gyro = rlg.Simulator.from_mapping(SIMULATOR | {"noise": {"angle_random_walk_deg_sqrt_h": 0.0004}})
    runs = (gyro.simulate("short", seed=seed, step_s=30.0, name=f"run{seed}") for seed in (1, 2))
    return tuple(few_monitors(run, "magnetic_field_uT") for run in runs)


def every_other(run: rlg.Recording) -> rlg.Recording:
    """For the commands, which try all that may be missing."""
    return run.replace(table=run.table.iloc[::2].reset_index(drop=True), truth=None)


@functools.cache
def found() -> Sensitivity:
    simulator = rlg.Simulator.from_mapping(SIMULATOR)
    return sensitivity(simulator, recordings(), "supply_voltage", strengths=(0.03, 1.5), draws=2, seed=1, catalogue=FEW)


class TestCurve:
    def test_a_known_curve_is_recovered(self) -> None:
        """500 trials a strength: s50 within 5 %, s90 within 10 %, both inside their intervals."""
        rng = np.random.default_rng(0)
        strengths = np.repeat([0.1, 0.2, 0.4, 0.8, 1.6], 500)
        width = 0.35
        chance = 1.0 / (1.0 + np.exp(-np.log(strengths / 0.3) / width))
        curve = Curve.fit(strengths, (rng.random(len(strengths)) < chance).astype(float))
        s90 = 0.3 * np.exp(width * np.log(9.0))
        assert curve.s50 == pytest.approx(0.3, rel=0.05)
        assert curve.s90 == pytest.approx(s90, rel=0.1)
        assert curve.s50_interval[0] < 0.3 < curve.s50_interval[1]
        assert curve.s90_interval[0] < s90 < curve.s90_interval[1]
        assert curve.probability(np.array([curve.s50])) == pytest.approx(0.5)

    def test_intervals_have_their_coverage(self) -> None:
        """Six trials a strength, two hundred experiments: the 95 % interval of s50 holds the truth in 90 % of them at least."""
        rng = np.random.default_rng(1)
        strengths = np.repeat([0.1, 0.2, 0.4, 0.8, 1.6], 6)
        chance = 1.0 / (1.0 + np.exp(-np.log(strengths / 0.35) / 0.3))
        covered = 0
        for _ in range(200):
            low, high = Curve.fit(strengths, (rng.random(len(strengths)) < chance).astype(float)).s50_interval
            covered += low <= 0.35 <= high
        assert covered >= 180

    @pytest.mark.parametrize("share", [0.0, 1.0])
    def test_nothing_or_everything_found_gives_a_bound(self, share: float) -> None:
        strengths = np.repeat([0.1, 0.4, 1.6], 6)
        curve = Curve.fit(strengths, np.full(len(strengths), share))
        if share:
            assert curve.s50 < 0.1
            assert curve.s50_interval[0] < 0.04
        else:
            assert curve.s50 > 1.6
            assert curve.s50_interval[1] > 5.0

    def test_a_curve_beyond_the_strengths_tried_has_a_remark(self) -> None:
        strengths = np.repeat([0.1, 0.4], 2)
        (below,) = extrapolation_remarks("named", strengths, np.ones(4))
        assert (below.code, below.data["strength"]) == ("challenge.found_at_smallest_strength", 0.1)
        (above,) = extrapolation_remarks("named", strengths, np.array([1.0, 0.0, 0.0, 0.0]))
        assert (above.code, above.data["strength"]) == ("challenge.missed_at_largest_strength", 0.4)
        assert not extrapolation_remarks("named", strengths, np.array([1.0, 0.0, 1.0, 0.0]))

    def test_more_found_is_a_lower_curve(self) -> None:
        strengths = np.repeat([0.1, 0.4, 1.6], 4)
        few = Curve.fit(strengths, np.repeat([0.0, 0.0, 1.0], 4))
        many = Curve.fit(strengths, np.repeat([0.0, 1.0, 1.0], 4))
        assert few.probability(np.array([few.s50, few.s90])) == pytest.approx([0.5, 0.9])
        assert many.s50 < few.s50
        assert many.s90 < few.s90


class TestSensitivity:
    def test_the_strong_is_found_and_the_faint_is_not(self) -> None:
        table = found().to_frame().set_index("strength")
        assert table.loc[1.5, "detected"] == table.loc[1.5, "named"] == 1.0
        assert table.loc[0.03, "named"] <= 0.5
        assert 0.03 < found().naming.s50 < 1.5
        assert found().naming.s90 > found().naming.s50
        assert {remark.code for remark in found().remarks} <= {"challenge.equal_trials"}

    def test_equal_trials_are_made_and_counted_once(self) -> None:
        """Of a cause without nonlinear parameters there are two: it and its negative; otherwise as many as are drawn."""
        projection = Projection.of(rlg.Simulator.from_mapping(SIMULATOR), recordings())
        for name, count in (("supply_voltage", 2), ("thermal_lag", 6)):
            plans = [sized_injection(CATALOGUE[name], projection, 0.002, stream(1, f"{name}{draw}")) for draw in range(6)]
            assert len(distinct_injections(plans, projection)) == count

    def test_trials_named_but_not_detected_are_counted(self) -> None:
        trial = found().trials[0]
        made = [
            dataclasses.replace(trial, strength=0.1, detected=detected, in_class=named)
            for detected, named in ((True, True), (False, True), (False, True), (True, False))
        ]
        (row,) = dataclasses.replace(found(), trials=tuple(made)).to_frame().to_dict("records")
        assert (row["detected"], row["in_class"], row["undetected"]) == (0.5, 0.75, 0.5)

    def test_the_picture_holds_each_curve_at_its_place(self, monkeypatch: pytest.MonkeyPatch) -> None:
        drawn: list[Figure] = []
        save = Figure.savefig
        monkeypatch.setattr(
            Figure, "savefig", lambda figure, *args, **options: [drawn.append(figure), save(figure, *args, **options)]
        )
        at = np.geomspace(0.05, 3.2, 50)
        curves = [
            FoundCurve(label, np.array([0.1, 1.6]), np.array([0.2, 1.0]), at, np.clip(at * rise, 0.0, 1.0), 0.9 / rise, (0.5, 1.5))
            for label, rise in (("detected", 1.0), ("named", 1.5))
        ]
        assert curves_picture("mode_hop", 0.002, *curves, "note").startswith(b"\x89PNG")
        (axes,) = drawn[0].axes
        assert [text.get_text() for text in axes.get_xticklabels()] == ["0.1\n0.0002", "1.6\n0.0032"]
        assert "rms in deg/h" in axes.get_xlabel()
        assert [text.get_text() for text in axes.get_legend().get_texts()][:1] == ["named before it is detected"]

    def test_injections_have_the_stated_size(self) -> None:
        """The recordings are the simulator's own noise, so the white noise is known: 6 N for 100 s, more for shorter means."""
        known = 60.0 * 0.0004 / np.sqrt(found().averaging_s)
        assert found().white_deg_h == pytest.approx(known, rel=0.1)
        size, unit = found().sizes(1.0)["k_deg_h_V"]
        assert unit == "deg/h/V"
        ratios = [abs(trial.mechanism.k_deg_h_V) / trial.strength for trial in found().trials]
        assert size == pytest.approx(np.median(ratios))

    def test_a_trial_is_determined_by_its_stream_and_has_its_strength(self) -> None:
        projection = Projection.of(rlg.Simulator.from_mapping(SIMULATOR), recordings())
        first, again, other = (
            sized_injection(CATALOGUE["mode_hop"], projection, 0.002, stream(1, name)) for name in ("a", "a", "b")
        )
        assert first == again
        assert first[0] != other[0]
        for mechanism, number in (first, other):
            assert np.std(projection.unabsorbed(contributions(mechanism, recordings(), number))) == pytest.approx(0.002, rel=1e-6)

    @pytest.mark.parametrize(
        ("changes", "message"),
        [
            ({"mechanism": "gravity"}, "not in the catalogue"),
            ({"mechanism": "thermal_polynomial"}, "already"),
            ({"strengths": ()}, "strengths"),
            ({"strengths": (0.1, -1.0)}, "positive"),
            ({"strengths": (float("nan"),)}, "positive"),
            ({"draws": 0}, "draws"),
        ],
    )
    def test_bad_input_is_refused_before_any_work(self, changes: dict[str, object], message: str) -> None:
        arguments = {"mechanism": "supply_voltage"} | changes
        with pytest.raises(rlg.InputError, match=message):
            sensitivity(rlg.Simulator.from_mapping(SIMULATOR), recordings(), arguments.pop("mechanism"), **arguments)

    def test_a_driver_that_was_not_recorded_cannot_be_injected(self) -> None:
        bare = [run.replace(table=run.table.drop(columns="supply_voltage_V"), truth=None) for run in recordings()]
        with pytest.raises(rlg.InputError, match="supply_voltage_V"):
            sensitivity(rlg.Simulator.from_mapping(SIMULATOR), bare, "supply_voltage", strengths=(1.0,), draws=1, catalogue=FEW)


class TestCommand:
    def run(self, *arguments: object) -> Result:
        register_commands()
        return CliRunner().invoke(app, [str(argument) for argument in arguments])

    def test_table_json_and_folder(self, tmp_path: Path) -> None:
        (tmp_path / "gyro.yaml").write_text(yaml.safe_dump(SIMULATOR))
        paths = [tmp_path / "run.parquet"]
        rlg.write(every_other(recordings()[0]), paths[0])
        options = ["--mechanism", "supply_voltage", "--strengths", "1.5", "--draws", 1, "--out", tmp_path / "s"]
        done = self.run("sensitivity", tmp_path / "gyro.yaml", *paths, *options, "--json")
        assert done.exit_code == 0, done.output
        content = json.loads(done.stdout)
        assert content["meaning"]["code"] == "challenge.detected_and_named"
        assert content["meaning"]["data"] == {"p_value": 0.01}
        assert content["detection"]["s90_rms_deg_h"] == pytest.approx(content["detection"]["s90"] * content["white_deg_h"])
        names = sorted(path.name for path in (tmp_path / "s").iterdir())
        assert names == ["curves.png", "figures", "report.html", "sensitivity.json", "shares.csv"]
        refused = self.run("sensitivity", tmp_path / "gyro.yaml", *paths, "--mechanism", "supply_voltage", "--strengths", "a")
        assert refused.exit_code == 2
        assert "--strengths" in refused.stderr

    def test_ones_own_physics_has_a_detection_limit(self, tmp_path: Path) -> None:
        """In worker processes, which have to load the file."""
        (tmp_path / "gyro.yaml").write_text(yaml.safe_dump(SIMULATOR))
        write_bellows(tmp_path / "own.py")
        run = every_other(recordings()[0])
        pressure = 1010.0 + 4.0 * np.sin(run.time_s / 1500.0)
        rlg.write(run.replace(table=run.table.assign(pressure_hPa=pressure)), tmp_path / "run.parquet")
        options = ["--mechanism", "bellows", "--strengths", "3", "--draws", 1, "--jobs", 2, "--json"]
        refused = self.run("sensitivity", tmp_path / "gyro.yaml", tmp_path / "run.parquet", *options)
        assert refused.exit_code == 2
        assert "'bellows' is not in the catalogue" in refused.stderr
        options += ["--mechanisms", tmp_path / "own.py", "--only-mechanisms"]
        done = self.run("sensitivity", tmp_path / "gyro.yaml", tmp_path / "run.parquet", *options)
        assert done.exit_code == 0, done.output
        (trial,) = json.loads(done.stdout)["trials"]
        assert trial["found"] == ["bellows"]
        assert trial["mechanism"]["k_deg_h_hPa2"] > 0.0


def test_an_effect_in_the_recordings_is_subtracted_before_the_injection() -> None:
    """A voltage's effect in the recordings would add to what is injected, or undo it."""
    simulator = rlg.Simulator.from_mapping(SIMULATOR)
    disturbed = [
        run.replace(table=run.table.assign(gyro_deg_h=run.column("gyro_deg_h") + 0.1 * (run.column("supply_voltage_V") - 15.0)))
        for run in recordings()
    ]
    few = {name: CATALOGUE[name] for name in ("supply_voltage", "magnetic_field")}
    study = sensitivity(simulator, disturbed, "supply_voltage", strengths=(1e-6, 1.5), draws=1, seed=1, catalogue=few)
    assert study.remarks[0].code == "challenge.mechanism_before_removed"
    assert study.remarks[0].data == {"mechanism": "supply_voltage"}
    assert all(trial.detected is (trial.strength > 1.0) for trial in study.trials)
    assert all(trial.named is (trial.strength > 1.0) for trial in study.trials)
