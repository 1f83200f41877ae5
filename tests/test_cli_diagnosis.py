"""The command diagnose: its command line, its files, and everything that can be wrong with what it is given."""

from __future__ import annotations

import json
import shutil
import sys
import types
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner, Result

import rlgcomp as rlg
from rlgcomp.cli import register_commands
from rlgcomp.cli.base import app, repeated_options
from rlgcomp.diagnosis.diagnose import diagnose as diagnose_runs
from rlgcomp.diagnosis.report.result import Diagnosis
from rlgcomp.diagnosis.simulators.user_simulator import SimulatedRuns
from tests.few_monitors import few_monitors

register_commands()
OWN_MECHANISM = """
import dataclasses
import numpy as np
from rlgcomp.physics.mechanism import Mechanism, amplitude

@dataclasses.dataclass(frozen=True)
class Square(Mechanism):
    name = "square"
    kind = "chamber"
    equation = "b = k * T**2"
    reference = "A note of this laboratory."
    drivers = ("temperature",)
    k_deg_h_K2: float = amplitude(1e-5, "deg/h/K^2")

    def basis(self, recording):
        (temperature,) = self.read(recording)
        return temperature[:, None] ** 2
"""


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("runs")
    unit, kept = rlg.simulated_unit(1), ("light_intensity_V", "readout_a_V", "readout_b_V")
    for seed in range(4):
        run = few_monitors(unit.simulate("short", seed=seed, step_s=20.0, name=f"run{seed}"), *kept)
        rlg.write(run, folder / f"run{seed}.parquet")
        rlg.write(unit.predict(rlg.read(folder / f"run{seed}.parquet")), folder / f"sim{seed}.parquet")
    (folder / "sim.yaml").write_text("kind: chamber\nmechanisms:\n  - thermal_polynomial: {degree: 3}\n  - temperature_rate\n")
    (folder / "gyros.json").write_text(json.dumps([{"gyro": name, "coefficients": {}} for name in "ab"]))
    (folder / "flicker.yaml").write_text("bias_instability_deg_h: 0.001\n")
    (folder / "below.yaml").write_text("bias_instability_deg_h: -1.0\n")
    (folder / "my_sim.py").write_text("def gyro(r):\n    return 0.001 * r.column('temperature_block_degC')\n")
    (folder / "my_physics.py").write_text(OWN_MECHANISM)
    return folder


@pytest.fixture(scope="module")
def found(files: Path) -> rlg.Diagnosis:
    runs = [rlg.read(files / f"run{k}.parquet") for k in range(2)]
    return diagnose_runs(rlg.Simulator.from_yaml(files / "sim.yaml"), runs[:1], runs[1:], only=["supply_voltage"], window_s=240.0)


@pytest.fixture(scope="module")
def page(found: rlg.Diagnosis, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder with the page of what the engine's stand-in finds, and its figures; drawn once."""
    folder = tmp_path_factory.mktemp("page")
    found.report(folder / "report.html", figures=folder / "figures")
    return folder


@pytest.fixture
def engine(monkeypatch: pytest.MonkeyPatch, found: rlg.Diagnosis, page: Path) -> dict[str, Any]:
    """A stand-in for the engine that keeps what it is given and always finds the same."""
    seen: dict[str, Any] = {}

    def write_page(path: Path, record: Any, *, truth: Any = None, figures: Path | None = None) -> None:
        shutil.copy(page / "report.html", path)
        if figures is not None:
            shutil.copytree(page / "figures", figures)

    monkeypatch.setattr("rlgcomp.diagnosis.report.result.write_page", write_page)

    def diagnose(simulator: Any, train: Any, test: Any, **options: Any) -> rlg.Diagnosis:
        seen.update(options, simulator=simulator, train=train, test=test)
        if options["simulated"] is not None:
            SimulatedRuns.of([*train, *options["confirm"], *test], options["simulated"])
        options["progress"](0.5)
        return found

    monkeypatch.setitem(sys.modules, "rlgcomp.diagnosis.diagnose", types.SimpleNamespace(diagnose=diagnose))
    return seen


def run(*arguments: object) -> Result:
    return CliRunner().invoke(app, [str(argument) for argument in arguments])


def test_the_command_line_of_the_contract(files: Path, engine: dict[str, Any], tmp_path: Path) -> None:
    runs = [files / f"run{k}.parquet" for k in range(4)]
    out = tmp_path / "out"
    done = run("diagnose", "--simulator", files / "sim.yaml", "--train", *runs[:2], "--test", *runs[2:], "--out", out)
    assert done.exit_code == 0, done.output
    assert {path.name for path in out.iterdir()} == {"diagnosis.json", "augmented.yaml", "report.html", "figures"}
    assert json.loads((out / "diagnosis.json").read_text())["schema"] == "rlgcomp.diagnosis/1"
    assert "simulator" in done.output
    assert [r.name for r in engine["train"]] == ["run0", "run1"]
    assert [r.name for r in engine["test"]] == ["run2", "run3"]
    repeated = [item for path in runs[:2] for item in ("--train", path)]
    again = run("diagnose", "--simulator", files / "sim.yaml", *repeated, f"--test={runs[2]}", runs[3], "-o", out, "--json")
    assert again.exit_code == 0, again.output
    assert json.loads(again.stdout) == json.loads((out / "diagnosis.json").read_text())
    assert len(engine["train"]) == len(engine["test"]) == 2


def test_what_is_written_is_what_was_proved(files: Path, tmp_path: Path) -> None:
    """The engine itself: the augmented simulator, read back and asked to predict, leaves what the diagnosis says it leaves."""
    out = tmp_path / "out"
    runs = [files / f"run{k}.parquet" for k in range(3)]
    few = ["--averaging-s", 240, "--only", "supply_voltage", "readout_incoherence"]
    arguments = ["--train", *runs[:2], "--test", runs[2], *few]
    done = run("diagnose", "--simulator", files / "sim.yaml", *arguments, "--out", out, "--json")
    assert done.exit_code == 0, done.output
    found = json.loads(done.stdout)
    assert found == json.loads((out / "diagnosis.json").read_text())
    fit = found["fit"]["test"]
    assert run("predict", out / "augmented.yaml", runs[2], "--out", tmp_path / "said.parquet").exit_code == 0
    recorded, said = (rlg.read(path).averaged(fit["averaging_s"]) for path in (runs[2], tmp_path / "said.parquet"))
    rms = float(np.sqrt(np.mean((recorded.column("gyro_deg_h") - said.column("gyro_deg_h")) ** 2)))
    assert rms == pytest.approx(fit["augmented_rms"], rel=0.02)
    assert fit["improvement"] == pytest.approx(1.0 - fit["augmented_rms"] / fit["baseline_rms"])


def test_the_users_own_simulator(files: Path, engine: dict[str, Any], tmp_path: Path) -> None:
    runs = [files / f"run{k}.parquet" for k in (0, 1)]
    common = ["--train", runs[0], "--test", runs[1], "--out", tmp_path / "out"]
    done = run("diagnose", "--simulated", files / "sim0.parquet", files / "sim1.parquet", *common)
    assert done.exit_code == 0, done.output
    assert [run.name for run in engine["simulated"]] == ["sim0", "sim1"]
    assert engine["simulator"] is None
    done = run("diagnose", "--simulator", f"{files / 'my_sim.py'}:gyro", *common)
    assert done.exit_code == 0, done.output
    rate = engine["simulator"].predict_deg_h(engine["train"][0])
    assert rate == pytest.approx(0.001 * engine["train"][0].column("temperature_block_degC"))


def test_mechanisms_of_the_users_own(files: Path, engine: dict[str, Any], tmp_path: Path) -> None:
    simulator = tmp_path / "sim.yaml"
    simulator.write_text("kind: chamber\nmechanisms: [square]\n")
    options = ["--mechanisms", files / "my_physics.py"]
    given = ["diagnose", "--simulator", simulator, "--train", files / "run0.parquet", "--out", tmp_path / "out"]
    done = run(*given, *options)
    assert done.exit_code == 0, done.output
    assert set(engine["mechanisms"]) == {*rlg.CATALOGUE, "square"}
    assert run(*given, *options, "--only-mechanisms").exit_code == 0
    assert set(engine["mechanisms"]) == {"square"}
    refused = run(*given, "--only-mechanisms")
    assert refused.exit_code == 2
    assert "give your own with --mechanisms" in refused.stderr
    made = tmp_path / "made.parquet"
    assert run("simulate", simulator, "--profile", "short", "--step-s", "10", "--out", made, *options).exit_code == 0
    assert run("predict", simulator, made, "--out", tmp_path / "said.parquet", *options).exit_code == 0


def test_noise_measured_at_rest(files: Path, engine: dict[str, Any], tmp_path: Path) -> None:
    rest = rlg.Simulator.from_mapping({"noise": {"angle_random_walk_deg_sqrt_h": 3e-4, "bias_instability_deg_h": 1e-3}})
    rlg.write(rest.simulate("start 20, hold 300", seed=1, step_s=5.0), tmp_path / "rest.parquet")
    assert run("allan", tmp_path / "rest.parquet", "--out", tmp_path / "noise").exit_code == 0
    (tmp_path / "typed.yaml").write_text("noise: {angle_random_walk_deg_sqrt_h: 0.0003, bias_instability_deg_h: 0.001}\n")
    (measured,) = json.loads((tmp_path / "noise/coefficients.json").read_text())
    for name, flicker in (("noise/coefficients.json", measured["coefficients"]["bias_instability_deg_h"]), ("typed.yaml", 0.001)):
        arguments = ["--simulator", files / "sim.yaml", "--train", files / "run0.parquet", "--noise", tmp_path / name]
        done = run("diagnose", *arguments, "--out", tmp_path / "out")
        assert done.exit_code == 0, done.output
        assert engine["noise"].angle_random_walk_deg_sqrt_h == pytest.approx(3e-4, rel=0.05)
        assert engine["noise"].bias_instability_deg_h == flicker > 0.0


def test_runs_of_one_name_are_told_apart(files: Path, engine: dict[str, Any], tmp_path: Path) -> None:
    (tmp_path / "other").mkdir()
    other = tmp_path / "other" / "run0.parquet"
    other.write_bytes((files / "run1.parquet").read_bytes())
    done = run(
        "diagnose", "--simulator", files / "sim.yaml", "--train", files / "run0.parquet", "--test", other, "--out", tmp_path / "out"
    )
    assert done.exit_code == 0, done.output
    assert engine["train"][0].name != engine["test"][0].name


def test_a_run_in_another_format_is_no_other_run(files: Path, tmp_path: Path) -> None:
    """A CSV file rounds."""
    run0 = rlg.read(files / "run0.parquet")
    rounded = tmp_path / "held_out.csv"
    run0.table.to_csv(rounded, index=False, float_format="%.6g")
    done = run(
        "diagnose", "--simulator", files / "sim.yaml", "--train", files / "run0.parquet", "--test", rounded, "--out", tmp_path / "o"
    )
    assert done.exit_code == 2, done.output
    assert "both to train and to test" in " ".join(done.output.split())


SIM, RUN0, RUN1 = "{files}/sim.yaml", "{files}/run0.parquet", "{files}/run1.parquet"
WRONG = {
    "no simulator": (["--train", RUN0], "no simulator"),
    "simulator is not there": (["--simulator", "nowhere.yaml", "--train", RUN0], "does not exist"),
    "function is not there": (["--simulator", "{files}/my_sim.py:other", "--train", RUN0], "has no function 'other'; it has gyro"),
    "no function": (["--simulator", "{files}/my_sim.py", "--train", RUN0], "has no function ''; it has gyro"),
    "both": (["--simulator", "{files}/my_sim.py:gyro", "--simulated", RUN0, "--train", RUN0], "give one of them"),
    "run is not there": (["--simulator", SIM, "--train", "nowhere.parquet"], "nowhere.parquet"),
    "too few simulations": (["--simulated", "{files}/sim0.parquet", "--train", RUN0, RUN1], "1 simulated runs for 2 recordings"),
    "averaging": (["--simulator", SIM, "--train", RUN0, "--averaging-s", "-5"], "must be positive"),
    "averaging without end": (["--simulator", SIM, "--train", RUN0, "--averaging-s", "inf"], "must be positive and finite"),
    "noise is not there": (["--simulator", SIM, "--train", RUN0, "--noise", "nowhere.yaml"], "nowhere.yaml: not readable"),
    "noise of no gyro": (
        ["--simulator", SIM, "--train", RUN0, "--noise", "{files}/gyros.json"],
        "of a, b; choose one",
    ),
    "noise of another kind": (["--simulator", SIM, "--train", RUN0, "--noise", SIM], "unknown 'kind', 'mechanisms'"),
    "noise below zero": (["--simulator", SIM, "--train", RUN0, "--noise", "{files}/below.yaml"], "it must be a number, zero or"),
    "noise without its white part": (
        ["--simulator", SIM, "--train", RUN0, "--noise", "{files}/flicker.yaml"],
        "angle_random_walk_deg_sqrt_h is missing or zero",
    ),
    "noise of nothing": (["--simulator", SIM, "--train", RUN0, "--noise", "{files}/my_sim.py"], "--noise"),
    "mechanisms": (["--simulator", SIM, "--train", RUN0, "--mechanisms", "{files}/my_sim.py"], "defines no mechanism"),
    "no such option": (["--simulator", SIM, "--train", RUN0, "--tests", RUN1], "--tests"),
    "no training runs": (["--simulator", SIM], "--train"),
    "a stray value": ([RUN0, "--simulator", SIM, "--train", RUN1], "unexpected extra argument"),
}


@pytest.mark.parametrize(("arguments", "message"), WRONG.values(), ids=WRONG)
def test_bad_input_ends_with_one_message(
    files: Path, engine: dict[str, Any], tmp_path: Path, arguments: list[str], message: str
) -> None:
    done = run("diagnose", *(argument.format(files=files) for argument in arguments), "--out", tmp_path / "out")
    assert done.exit_code == 2, done.output
    assert message in done.output
    assert "Traceback" not in done.output
    assert not list(tmp_path.iterdir())


TWICE = {
    "trained on and held out": (["--train", RUN0, RUN1, "--test", RUN1], "run1.parquet (3) is given both to train and to test"),
    "a run given twice": (["--train", RUN0, RUN0], "run0.parquet (1) is given twice to train"),
    "parts overlap": (["--train", f"{RUN0}@0:6000", "--test", f"{RUN0}@5000:12000"], "is given both to train and to test"),
}


@pytest.mark.parametrize(("arguments", "message"), TWICE.values(), ids=TWICE)
def test_a_run_given_twice_is_refused(files: Path, tmp_path: Path, arguments: list[str], message: str) -> None:
    given = [argument.format(files=files) for argument in ["--simulator", SIM, *arguments]]
    done = run("diagnose", *given, "--out", tmp_path / "out")
    assert done.exit_code == 2, done.output
    assert message in " ".join(done.output.split())
    assert not list(tmp_path.iterdir())


def test_a_folder_of_something_else_is_refused_before_the_work(files: Path, engine: dict[str, Any], tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("1")
    done = run("diagnose", "--simulator", files / "sim.yaml", "--train", files / "run0.parquet", "--out", tmp_path)
    assert done.exit_code == 2, done.output
    assert "left untouched" in done.output
    assert not engine


@pytest.mark.parametrize("simulator", ["augmented.yaml", "report.html:gyro"])
def test_a_diagnosis_does_not_replace_its_own_simulator(
    files: Path, engine: dict[str, Any], tmp_path: Path, simulator: str
) -> None:
    out = tmp_path / "out"
    done = run("diagnose", "--simulator", files / "sim.yaml", "--train", files / "run0.parquet", "--out", out)
    assert done.exit_code == 0, done.output
    before = {path: path.read_bytes() for path in out.rglob("*") if path.is_file()}
    engine.clear()
    done = run("diagnose", "--simulator", out / simulator, "--train", files / "run0.parquet", "--out", out)
    assert done.exit_code == 2, done.output
    assert f"{out / simulator.removesuffix(':gyro')} lies in {out}, which is to be replaced" in done.output
    assert not engine
    assert {path: path.read_bytes() for path in out.rglob("*") if path.is_file()} == before


def test_what_is_wrong_with_a_mechanism_is_said(files: Path, engine: dict[str, Any], tmp_path: Path) -> None:
    own = tmp_path / "own.py"
    own.write_text(OWN_MECHANISM.replace("temperature[:, None] ** 2", "1 / 0"))
    given = ["--simulator", files / "sim.yaml", "--train", files / "run0.parquet", "--mechanisms", own, "--out", tmp_path / "o"]
    done = run("diagnose", *given)
    assert done.exit_code == 2, done.output
    assert "line 17: ZeroDivisionError" in done.output


def test_nothing_is_left_when_the_page_fails(
    files: Path, engine: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fails(self: Diagnosis, path: Path) -> None:
        raise RuntimeError("no page")

    monkeypatch.setattr(Diagnosis, "report", fails)
    done = run("diagnose", "--simulator", files / "sim.yaml", "--train", files / "run0.parquet", "--out", tmp_path / "out")
    assert done.exit_code == 1
    assert not list(tmp_path.iterdir())


def test_a_folder_that_is_not_ours_is_left_alone(files: Path, engine: dict[str, Any], tmp_path: Path) -> None:
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "thesis.tex").write_text("important")
    done = run("diagnose", "--simulator", files / "sim.yaml", "--train", files / "run0.parquet", "--out", tmp_path / "out")
    assert done.exit_code == 2
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["thesis.tex"]


def test_spreading_keeps_what_is_not_several() -> None:
    several = ["--train", "--test"]
    assert repeated_options(["--train=a", "b", "--json", "--test", "c", "d", "-o", "e"], several) == [
        *("--train=a", "--train", "b", "--json", "--test", "c", "--test", "d", "-o", "e")
    ]
    assert repeated_options([], several) == []
