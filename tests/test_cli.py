"""The command line as a user meets it: what it prints, what it writes, how it fails."""

from __future__ import annotations

import contextlib
import dataclasses
import errno
import json
import os
import re
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from typer.testing import CliRunner

import rlgcomp as rlg
from rlgcomp.cli import main, register_commands
from rlgcomp.cli.base import app
from rlgcomp.diagnosis.diagnose import diagnose
from tests.own_mechanism import write_bellows

COMMANDS = ["demo", "inspect", "simulate", "mechanisms", "predict", "train", "evaluate", "compensate", "allan"]
SIMULATOR = """
kind: chamber
mechanisms:
  - thermal_polynomial: {degree: 3}
  - temperature_rate: {k_deg_h_min_K: 0.02}
  - thermal_hysteresis
noise: {angle_random_walk_deg_sqrt_h: 0.0003}
"""


@pytest.fixture(scope="module", autouse=True)
def registered() -> None:
    """Commands are registered when the console script starts."""
    register_commands()


def run(*arguments: object) -> object:
    return CliRunner().invoke(app, [str(argument) for argument in arguments])


def test_what_doubts_the_unit_of_a_gyro_is_said_once_for_all_runs(tmp_path: Path) -> None:
    for k in range(3):
        gyro = (300.0 if k else 9.0) + np.random.default_rng(k).standard_normal(300)
        pd.DataFrame({"time_s": np.arange(300.0), "gyro_deg_h": gyro}).to_csv(tmp_path / f"run{k}.csv", index=False)
    result = run("inspect", *sorted(tmp_path.glob("*.csv")))
    (line,) = [line for line in result.output.splitlines() if "more than Earth rate" in line]
    assert line.startswith("run1: noted: gyro_deg_h: the mean is ")
    assert line.endswith("; likewise in 1 of 2 other runs")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A simulator file, three recordings and a model, made by the commands themselves."""
    folder = tmp_path_factory.mktemp("cli")
    (folder / "gyro.yaml").write_text(SIMULATOR)
    for seed in (1, 2, 3):
        made = run(
            "simulate",
            folder / "gyro.yaml",
            "--profile",
            "short",
            "--seed",
            seed,
            "--step-s",
            5,
            "--out",
            folder / f"run{seed}.parquet",
        )
        assert made.exit_code == 0, made.output
    trained = run("train", folder / "run1.parquet", folder / "run2.parquet", "--model", "dynamic", "--out", folder / "model")
    assert trained.exit_code == 0, trained.output
    return folder


def refused(*arguments: object) -> str:
    """Exit code 2, one clear message, no traceback."""
    result = run(*arguments)
    assert result.exit_code == 2, result.output
    assert "Traceback" not in result.output
    assert "internal fault" not in result.output
    return result.output


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_has_help_with_an_example(command: str) -> None:
    result = run(command, "--help")
    assert result.exit_code == 0
    assert f"rlgcomp {command}" in result.output.replace("\n", " ")


def test_help_names_options_in_full_at_80_columns() -> None:
    import typer

    for command, each in typer.main.get_command(app).commands.items():
        text = CliRunner().invoke(app, [command, "--help"], env={"COLUMNS": "80", "TERMINAL_WIDTH": "80"}).output
        assert max(map(len, text.splitlines())) <= 80, command
        for parameter in each.params:
            names = parameter.opts if parameter.param_type_name == "option" else [parameter.metavar.strip("[]")]
            assert all(name in text for name in names), command
        assert text.rstrip().endswith(f"commands.html#{command}")


def test_every_command_is_in_one_group_of_the_help() -> None:
    import typer

    from rlgcomp.cli.help import COMMANDS as GROUPS

    assert sorted(name for names in GROUPS.values() for name in names) == sorted(typer.main.get_command(app).commands)


def test_the_version_is_printed() -> None:
    result = run("--version")
    assert result.exit_code == 0
    assert result.output == f"rlgcomp {rlg.__version__}\n"


@pytest.mark.usefixtures("undrawn")
def test_the_whole_way(folder: Path, tmp_path: Path) -> None:
    result = run("evaluate", folder / "model", folder / "run3.parquet", "--out", tmp_path / "report")
    assert result.exit_code == 0
    assert "Bias stability held out" in result.output
    assert "By feature and model" in result.output
    assert {item.name for item in (tmp_path / "report").iterdir()} == {"report.html", "evaluation.json", "figures"}
    result = run("compensate", folder / "model", folder / "run3.parquet", "--out", tmp_path / "clean.csv.gz")
    assert result.exit_code == 0
    before, after = rlg.read(folder / "run3.parquet"), rlg.read(tmp_path / "clean.csv.gz")
    assert after.averaged().rate_deg_h().std() < 0.5 * before.averaged().rate_deg_h().std()


@pytest.mark.usefixtures("undrawn")
def test_json_is_json(folder: Path, tmp_path: Path) -> None:
    calls = [
        ("inspect", folder / "run1.parquet"),
        ("simulate", folder / "gyro.yaml", "--profile", "short", "--step-s", 20, "--out", tmp_path / "a.parquet"),
        ("train", folder / "run1.parquet", folder / "run2.parquet", "--model", "cubic", "--out", tmp_path / "m"),
        ("evaluate", folder / "model", folder / "run3.parquet", "--out", tmp_path / "r", "--no-comparison"),
        ("compensate", folder / "model", folder / "run3.parquet", "--out", tmp_path / "c.parquet"),
    ]
    for call in calls:
        result = run(*call, "--json")
        assert result.exit_code == 0, result.output
        assert json.loads(result.stdout)


def test_mechanisms_tells_what_a_simulator_file_may_hold() -> None:
    listed = run("mechanisms")
    assert all(name in listed.stdout for name in rlg.CATALOGUE)
    reported = run("mechanisms", "thermal_hysteresis")
    assert "radius_K" in reported.stdout
    assert "rested, from_below, from_above" in reported.stdout
    assert "Visintin" in reported.stdout
    (entry,) = json.loads(run("mechanisms", "mode_hop", "--json").stdout)
    usual = {parameter["name"]: parameter["usual"] for parameter in entry["parameters"]}
    assert rlg.CATALOGUE["mode_hop"].from_mapping(usual) == rlg.CATALOGUE["mode_hop"]()
    swallowed = run("mechanisms", "--mechanisms", "mine.py", "mode_hop")
    assert swallowed.exit_code == 2
    assert "mode_hop: expected a Python file" in swallowed.stderr
    assert "the name of a mechanism goes before --mechanisms" in swallowed.stderr
    unknown = run("mechanisms", "phlogiston")
    assert unknown.exit_code == 2
    assert "no mechanism is called 'phlogiston'" in unknown.output


@pytest.mark.parametrize("name", rlg.CATALOGUE)
def test_each_mechanism_is_described(name: str) -> None:
    described = run("mechanisms", name)
    assert described.exit_code == 0, described.output
    assert rlg.CATALOGUE[name].equation in " ".join(described.stdout.split())


def test_inspect_names_what_was_found(folder: Path, tmp_path: Path) -> None:
    recording = rlg.read(folder / "run1.parquet")
    table = recording.table
    table.loc[5:9, "gyro_deg_h"] = np.nan
    table.drop(index=range(100, 160)).to_csv(tmp_path / "holes.csv", index=False)
    result = run("inspect", tmp_path / "holes.csv")
    assert result.exit_code == 0
    assert "5 values missing, rows left out" in result.output
    assert "2 gaps" in result.output
    assert "Thermal legs" in result.output


def test_predict_keeps_the_rows(folder: Path, tmp_path: Path) -> None:
    assert run("predict", folder / "gyro.yaml", folder / "run1.parquet", "--out", tmp_path / "p.parquet").exit_code == 0
    assert len(rlg.read(tmp_path / "p.parquet")) == len(rlg.read(folder / "run1.parquet"))


def test_predict_tells_machines_what_it_made(folder: Path, tmp_path: Path) -> None:
    out = tmp_path / "p.parquet"
    content = json.loads(run("predict", folder / "gyro.yaml", folder / "run1.parquet", "--out", out, "--json").stdout)
    predicted = rlg.read(out)
    assert content["rows"] == len(predicted)
    assert content["columns"] == list(predicted.columns)
    assert content["gyro"] == "gyro_deg_h"
    assert content["mechanisms"] == ["thermal_polynomial", "temperature_rate", "thermal_hysteresis"]
    assert content["mean_deg_h"] == pytest.approx(predicted.rate_deg_h().mean())


@pytest.mark.parametrize("ending", ["parquet", "csv"])
def test_what_predict_wrote_is_read_as_it_stands(tmp_path: Path, ending: str) -> None:
    """It has no noise, and stands still where nothing moves: in a recording both would be faults."""
    (tmp_path / "table.yaml").write_text("kind: turntable\nmechanisms: [scale_factor]\n")
    made = run("simulate", tmp_path / "table.yaml", "--profile", "rates", "--out", tmp_path / "r.parquet")
    assert made.exit_code == 0, made.output
    out = tmp_path / f"p.{ending}"
    assert run("predict", tmp_path / "table.yaml", tmp_path / "r.parquet", "--out", out).exit_code == 0
    assert len(rlg.read(out)) == len(rlg.read(tmp_path / "r.parquet"))


def test_predict_follows_no_fault_of_the_logger(folder: Path, tmp_path: Path) -> None:
    recording = rlg.read(folder / "run1.parquet")
    table = recording.table.copy()
    table.loc[500, "temperature_block_degC"] += 60.0
    rlg.write(recording.replace(table=table), tmp_path / "wild.parquet")
    assert run("predict", folder / "gyro.yaml", folder / "run1.parquet", "--out", tmp_path / "p.parquet").exit_code == 0
    result = run("predict", folder / "gyro.yaml", tmp_path / "wild.parquet", "--out", tmp_path / "w.parquet")
    assert "temperature_block_degC: 1 sample" in " ".join(result.output.split())  # wherever the line is broken
    quiet, wild = (rlg.read(tmp_path / name).rate_deg_h() for name in ("p.parquet", "w.parquet"))
    assert np.abs(quiet - wild).max() < 1e-3


def test_a_programme_of_thirty_years_is_refused(folder: Path, tmp_path: Path) -> None:
    result = run("simulate", folder / "gyro.yaml", "--profile", "start 20, hold 1e9", "--out", tmp_path / "r.parquet")
    assert result.exit_code == 2
    assert "make it shorter, or sample more slowly (--step-s)" in result.output


def test_every_command_answers_machines_and_says_what_its_arguments_are() -> None:
    import typer

    for name, each in typer.main.get_command(app).commands.items():
        assert any("--json" in parameter.opts for parameter in each.params), name
        assert all(getattr(parameter, "help", "there") for parameter in each.params), name


def test_the_module_runs_as_a_program() -> None:
    done = subprocess.run([sys.executable, "-m", "rlgcomp", "--version"], capture_output=True, text=True, timeout=60, check=True)
    assert done.stdout.strip() == f"rlgcomp {rlg.__version__}"


def test_an_interval_of_a_run(folder: Path, tmp_path: Path) -> None:
    result = run(
        "train", f"{folder / 'run1.parquet'}@1000:9000", "--model", "cubic", "--features", "temperature", "--out", tmp_path / "m"
    )
    assert result.exit_code == 0
    (part,) = rlg.load(tmp_path / "m").training_
    assert part.run == "run1 from 1000 s to 9000 s"
    assert part.time_s[0] > 1000
    assert part.time_s[-1] < 9000
    assert "START, 5000 s, is after STOP, 100 s" in refused("inspect", f"{folder / 'run1.parquet'}@5000:100")
    assert "expected FILE@START:STOP" in refused("inspect", f"{folder / 'run1.parquet'}@soon")


def bad_files(folder: Path, tmp_path: Path) -> dict[str, tuple[Path, str]]:
    good = rlg.read(folder / "run1.parquet").table
    (tmp_path / "empty.csv").write_bytes(b"")
    (tmp_path / "text.parquet").write_text("time_s,gyro_deg_h\n1,2\n")
    good.drop(columns="gyro_deg_h").to_csv(tmp_path / "nogyro.csv", index=False)
    good.assign(gyro_deg_h=np.nan).to_csv(tmp_path / "nan.csv", index=False)
    pd.concat([good.iloc[1000::-1], good.iloc[:1000:-1]]).to_csv(tmp_path / "backwards.csv", index=False)
    good.iloc[:2].to_csv(tmp_path / "two.csv", index=False)
    return {
        "an empty file": (tmp_path / "empty.csv", "is empty"),
        "a text file named parquet": (tmp_path / "text.parquet", "is no Parquet file"),
        "no gyro": (tmp_path / "nogyro.csv", "no gyro column"),
        "an all-NaN gyro": (tmp_path / "nan.csv", "gyro_deg_h: every value is missing"),
        "time running backwards": (tmp_path / "backwards.csv", "time runs backwards"),
        "two rows": (tmp_path / "two.csv", "2 rows: too short"),
        "no file": (tmp_path / "absent.csv", "does not exist"),
    }


@pytest.mark.parametrize(
    "case",
    [
        "an empty file",
        "a text file named parquet",
        "no gyro",
        "an all-NaN gyro",
        "time running backwards",
        "two rows",
        "no file",
    ],
)
def test_bad_recordings_end_every_command_with_one_message(folder: Path, tmp_path: Path, case: str) -> None:
    path, message = bad_files(folder, tmp_path)[case]
    before = sorted(item.name for item in tmp_path.iterdir())
    out = tmp_path / "out"
    for call in (
        ("inspect", path),
        ("predict", folder / "gyro.yaml", path, "--out", tmp_path / "out.parquet"),
        ("train", path, "--out", out),
        ("train", folder / "run1.parquet", path, "--out", out),
        ("evaluate", folder / "model", path, "--out", out),
        ("compensate", folder / "model", path, "--out", tmp_path / "out.parquet"),
    ):
        assert message in refused(*call)
    assert sorted(item.name for item in tmp_path.iterdir()) == before


def test_a_model_with_a_changed_byte_or_a_missing_file(folder: Path, tmp_path: Path) -> None:
    for spoil, message in (
        (lambda file: file.write_bytes(file.read_bytes()[:-1] + b"?"), "has changed"),
        (Path.unlink, "is missing"),
    ):
        copy = Path(shutil.copytree(folder / "model", tmp_path / "copy"))
        spoil(copy / "arrays" / "model_coef_.npy")
        for command in (("evaluate", "--out", tmp_path / "r"), ("compensate", "--out", tmp_path / "r.parquet")):
            assert message in refused(command[0], copy, folder / "run3.parquet", *command[1:])
        shutil.rmtree(copy)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("train", "{run}", "--model", "magic", "--out", "{tmp}/m"), "'magic' is unknown"),
        (("train", "{run}", "--features", "colour", "--out", "{tmp}/m"), "neither a group"),
        (("simulate", "{sim}", "--out", "{tmp}/absent/r.parquet"), "does not exist; create it first"),
        (("train", "{run}", "--out", "{run}/m"), "is no folder"),
        (("train", "{run}", "--averaging-s", "0.001", "--out", "{tmp}/m"), "cannot average over"),
        (("train", "{run}", "--map", "nonsense", "--out", "{tmp}/m"), "expected TARGET=SOURCE"),
        (("train", "{run}", "--gyro", "gyro_q_deg_h", "--out", "{tmp}/m"), "or choose one of them"),
        (("train", "{run}", "--drop", "colour", "--out", "{tmp}/m"), "cannot drop colour"),
        (("simulate", "{sim}", "--profile", "dance", "--out", "{tmp}/r.parquet"), "is not understood"),
        (("simulate", "{sim}", "--step-s", "-1", "--out", "{tmp}/r.parquet"), "must be positive"),
        (("simulate", "{sim}", "--out", "{tmp}/r.docx"), "no known format"),
        (("simulate", "{tmp}/absent.yaml", "--out", "{tmp}/r.parquet"), "does not exist"),
        (("evaluate", "{tmp}/absent", "{run}", "--out", "{tmp}/r"), "does not exist"),
        (("train",), "Missing argument"),
        (("dance",), "No such command"),
        (("simulate", "{sim}", "--seed", "x", "--out", "{tmp}/r.parquet"), "integer"),
    ],
)
def test_wrong_arguments_end_with_one_message(folder: Path, tmp_path: Path, arguments: tuple[str, ...], message: str) -> None:
    places = {"run": folder / "run1.parquet", "sim": folder / "gyro.yaml", "model": folder / "model", "tmp": tmp_path}
    output = refused(*(argument.format(**places) for argument in arguments))
    assert message in re.sub(r"\s*│?\n│?\s*", " ", output)
    assert list(tmp_path.iterdir()) == []


@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    st.lists(st.text(st.characters(codec="utf-8", exclude_characters="\0"), max_size=12), max_size=4), st.sampled_from(COMMANDS[1:])
)
def test_no_arguments_make_a_traceback(tmp_path: Path, words: list[str], command: str) -> None:
    result = run(command, *words, "--out", tmp_path / "out") if command != "inspect" else run(command, *words)
    assert result.exit_code in (0, 2)
    assert "internal fault" not in result.output
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    "arguments",
    [
        ("simulate", "{tmp}/gyro.yaml", "--out", "{tmp}/gyro.csv"),
        ("predict", "{tmp}/gyro.yaml", "{run}", "--out", "{tmp}/gyro.csv"),
        ("compensate", "{model}", "{run}", "--out", "{tmp}/gyro.csv.gz"),
    ],
)
def test_a_simulator_file_is_not_written_over(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, arguments: tuple[str, ...]
) -> None:
    shutil.copy(folder / "gyro.yaml", tmp_path / "gyro.yaml")
    monkeypatch.setattr(rlg.Simulator, "from_yaml", lambda *given: pytest.fail("refused after the work began"))
    places = {"run": folder / "run1.parquet", "model": folder / "model", "tmp": tmp_path}
    printed = refused(*(argument.format(**places) for argument in arguments))
    assert "exists and is no recording's metadata that was written here: it holds mechanisms, noise; give another name" in printed
    assert [path.name for path in tmp_path.iterdir()] == ["gyro.yaml"]
    assert (tmp_path / "gyro.yaml").read_text() == SIMULATOR


@pytest.mark.usefixtures("undrawn")
def test_a_command_replaces_what_it_wrote_and_nothing_else(folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("rlgcomp.export.toolchain.TOOLCHAINS", ())
    shutil.copytree(folder / "model", tmp_path / "a" / "model")
    shutil.copy(folder / "run3.parquet", tmp_path / "a" / "run3.parquet")
    model, report = tmp_path / "a" / "model", tmp_path / "report"
    small = (f"{folder / 'run1.parquet'}@0:5000", "--model", "cubic", "--features", "temperature")
    train = ("train", *small, "--out", model, "--export", model / "c")
    evaluate = ("evaluate", model, tmp_path / "a" / "run3.parquet", "--no-comparison", "--out")
    for _ in range(2):
        for command in (train, (*evaluate, report), ("export", model, "--to", "c", "--out", tmp_path / "c")):
            done = run(*command)
            assert done.exit_code == 0, done.output
    (report / "notes.txt").write_text("years of work")
    (model / "c" / "main.c").write_text("int main(void) { return 0; }")
    (tmp_path / "c" / "main.c").write_text("int main(void) { return 0; }")
    before = {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()}
    assert "holds notes.txt, which an earlier run did not write" in refused(*evaluate, report)
    assert "holds main.c, which" in refused(*train)
    assert "holds c, which" in refused(*train[:-2])
    assert "holds main.c, which" in refused("export", model, "--to", "c", "--out", tmp_path / "c")
    assert "which an earlier run did not write" in refused("export", model, "--to", "onnx", "--out", tmp_path / "c")
    assert "left untouched" in refused(*evaluate, tmp_path / "a")
    assert {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()} == before


@pytest.mark.parametrize("place", ["model/c", "code"])
def test_a_model_and_the_code_in_its_folder_or_beside_it_are_replaced_together(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, place: str
) -> None:
    model, code = tmp_path / "model", tmp_path / place
    monkeypatch.setattr("rlgcomp.export.toolchain.TOOLCHAINS", ())
    small = (f"{folder / 'run1.parquet'}@0:5000", "--model", "cubic", "--features", "temperature")
    train = ("train", *small, "--out", model, "--export", code)
    assert run(*train).exit_code == 0
    before = {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()}
    with monkeypatch.context() as broken:
        broken.setattr("rlgcomp.export.c.golden_stream", lambda *_, **__: 1 / 0)
        assert run(*train, "--averaging-s", "200").exit_code != 0
    assert {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()} == before
    assert run(*train, "--averaging-s", "200").exit_code == 0
    after = {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()}
    assert after.keys() == before.keys()
    assert after[code / "report.json"] != before[code / "report.json"]


def test_what_a_command_reads_is_not_replaced(folder: Path, tmp_path: Path) -> None:
    out = tmp_path / "model"
    shutil.copytree(folder / "model", out)
    shutil.copy(folder / "run1.parquet", out / "card.md")  # a name that `train` writes
    (tmp_path / "link.parquet").symlink_to(out / "card.md")
    for recording in (out / "card.md", f"{out / 'card.md'}@0:600", tmp_path / "link.parquet"):
        printed = refused("train", folder / "run2.parquet", recording, "--out", out)
        assert f"{str(recording).removesuffix('@0:600')} lies in {out}, which is to be replaced" in printed
    assert "lies in" in refused("train", folder / "run1.parquet", "--adapt", out, "--out", out)
    inside = ("--out", tmp_path / "code" / "model", "--export", tmp_path / "code")
    assert "give two folders" in refused("train", folder / "run1.parquet", *inside)


def test_a_fault_of_ours_ends_with_1_and_no_traceback(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("rlgcomp.report.inspection.summarise", lambda recording: 1 / 0)
    result = run("inspect", folder / "run1.parquet")
    assert result.exit_code == 1
    assert "internal fault: ZeroDivisionError" in result.output
    assert "Traceback" not in result.output


def test_a_disk_that_is_full_is_named(folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*arguments: object, **named: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(tmp_path / "out.parquet"))

    monkeypatch.setattr("rlgcomp.report.inspection.summarise", full)
    output = refused("inspect", folder / "run1.parquet")
    assert f"cannot write {tmp_path / 'out.parquet'}: {os.strerror(errno.ENOSPC)}; make room" in output


def test_a_search_stopped_by_a_signal_leaves_no_model_and_goes_on(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """SIGINT in the middle of `train`: exit code 130, a journal, no model; the same command again finishes from there."""
    runs = [folder / f"run{seed}.parquet" for seed in (1, 2)]
    arguments = ["train", *runs, "--model", "kernels", "--averaging-s", "400", "--out", tmp_path / "model"]
    journal = tmp_path / ".model.selection.jsonl"

    @contextlib.contextmanager
    def interrupted(title: str) -> Iterator[Callable[[int, int], None]]:
        yield lambda done, total: signal.raise_signal(signal.SIGINT) if done == 3 else None

    usual = signal.signal(signal.SIGINT, signal.default_int_handler)  # ignored where tests run in the background
    try:
        with monkeypatch.context() as stopped:
            stopped.setattr("rlgcomp.cli.compensation.progress", interrupted)
            first = run(*arguments)
    finally:
        signal.signal(signal.SIGINT, usual)
    assert first.exit_code == 130, first.output
    assert "stopped" in first.stderr
    assert [path.name for path in tmp_path.iterdir()] == [journal.name]
    assert len(journal.read_text().splitlines()) == 1 + 3
    again = run(*arguments)
    assert again.exit_code == 0, again.output
    assert "resuming: 3 of 15" in again.stderr
    rlg.load(tmp_path / "model")
    assert not journal.exists()


@pytest.mark.usefixtures("undrawn")
def test_demo_quick(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    found = []

    def kept(*arguments: object, **options: object) -> rlg.Diagnosis:
        found.append(diagnose(*arguments, **options))
        return found[0]

    monkeypatch.setattr("rlgcomp.diagnosis.diagnose.diagnose", kept)
    result = run("demo", "--quick", "--out", tmp_path / "demo", "--json")
    assert result.exit_code == 0, result.output
    reported = json.loads(result.stdout)
    assert reported["pooled"]["factor"] > 1.2
    assert [finding["mechanism"] for finding in reported["diagnosis"]["findings"]] == [reported["concealed"]]
    assert reported["diagnosis"]["fit"]["test"]["improvement_ci95"][0] > 0.0
    made = {item.name for item in (tmp_path / "demo").iterdir()}
    assert made == {
        "report.html",
        "evaluation.json",
        "figures",
        "model",
        "simulator.yaml",
        "diagnosis",
        "train-1.parquet",
        "train-2.parquet",
        "held-out.parquet",
    }
    rlg.load(tmp_path / "demo" / "model")
    diagnosis = tmp_path / "demo" / "diagnosis"
    files = {"report.html", "diagnosis.json", "augmented.yaml", "simulator.yaml"}
    assert {item.name for item in diagnosis.iterdir()} == {*files, "figures"}
    written = json.loads((diagnosis / "diagnosis.json").read_text())
    assert written.pop("provenance")["command"].startswith("rlgcomp demo")
    assert written == {key: value for key, value in reported["diagnosis"].items() if key != "provenance"}
    lacking, augmented = (rlg.Simulator.from_yaml(diagnosis / f"{name}.yaml") for name in ("simulator", "augmented"))
    added = {m.name for m in augmented.mechanisms} - {m.name for m in lacking.mechanisms}
    assert added - {"tabulated_law"} <= {reported["concealed"]}  # the equation where it expresses the law, else the law as a table
    assert added
    monkeypatch.setattr("rlgcomp.diagnosis.diagnose.diagnose", lambda *_, **__: found[0])
    again = run("demo", "--quick", "--out", tmp_path / "demo")  # its own folder may be made again
    assert again.exit_code == 0, again.output
    assert reported["diagnosis"]["sentence"] in " ".join(again.stdout.split())
    recording = tmp_path / "demo" / "held-out.parquet"
    printed = refused("evaluate", tmp_path / "demo" / "model", recording, "--out", tmp_path / "demo")
    assert "holds diagnosis, held-out.parquet, model, simulator.yaml, train-1.parquet and 1 more, which" in printed
    (tmp_path / "demo" / "model" / "c").mkdir()
    assert "holds model/c, which an earlier run did not write" in refused("demo", "--quick", "--out", tmp_path / "demo")


def test_demo_leaves_other_folders_alone(tmp_path: Path) -> None:
    (tmp_path / "mine.txt").write_text("x")
    assert "left untouched" in refused("demo", "--quick", "--out", tmp_path)


def test_mapping_on_the_command_line(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    table = pd.DataFrame({"t_ms": 1000.0 * np.arange(600), "w": rng.normal(size=600), "T": 290 + rng.normal(size=600)})
    table.to_csv(tmp_path / "lab.csv", index=False)
    maps = ["--map", "time_s=t_ms [ms]", "--map", "gyro_deg_h=w", "--map", "temperature_block_degC=T [K]"]
    summary = json.loads(run("inspect", tmp_path / "lab.csv", *maps, "--json").stdout)[0]
    assert [column["column"] for column in summary["columns"]] == ["time_s", "gyro_deg_h", "temperature_block_degC"]
    assert summary["period_s"] == 1.0


def test_a_mapped_column_need_not_be_in_every_file(tmp_path: Path, short_runs: list[rlg.Recording]) -> None:
    rlg.write(short_runs[0], tmp_path / "ours.parquet")
    short_runs[1].table.rename(columns={"gyro_deg_h": "Rate"}).to_csv(tmp_path / "theirs.csv", index=False)
    files = [tmp_path / "ours.parquet", tmp_path / "theirs.csv"]
    ours, theirs = json.loads(run("inspect", *files, "--map", "gyro_deg_h=Rate [deg/h]", "--json").stdout)
    assert [column["column"] for column in ours["columns"]] == [column["column"] for column in theirs["columns"]]
    refused = run("inspect", *files, "--map", "gyro_deg_h=Rat")
    assert refused.exit_code == 2
    assert "ours.parquet: no column 'Rat' to map" in refused.stderr


def test_the_console_script_is_the_application() -> None:
    assert callable(main)


def test_raw_pulses_are_calibrated_on_the_way_in(tmp_path: Path, short_runs: list[rlg.Recording]) -> None:
    """A run in pulses with its calibration trains the model that the run in deg/h trains."""
    (tmp_path / "k.json").write_text('{"schema": "rlgcomp.calibration/1", "kind": "gyro", "pulse_arcsec": 0.8}')
    for name, recording in zip(("a", "b"), short_runs, strict=False):
        table = recording.table
        table["gyro_pulses"] = table.pop("gyro_deg_h") * recording.period_s / 0.8
        rlg.write(recording.replace(table=table, truth=None), tmp_path / f"{name}.parquet")
        rlg.write(recording, tmp_path / f"{name}-rate.parquet")
    arguments = ["--model", "cubic", "--features", "temperature"]
    raw = run("train", tmp_path / "a.parquet", *arguments, "--calibration", tmp_path / "k.json", "--out", tmp_path / "raw")
    assert raw.exit_code == 0, raw.output
    assert run("train", tmp_path / "a-rate.parquet", *arguments, "--out", tmp_path / "rate").exit_code == 0
    corrected = [
        rlg.load(tmp_path / model).predict(rlg.read(tmp_path / "b-rate.parquet"))["bias_deg_h"].to_numpy()
        for model in ("raw", "rate")
    ]
    assert corrected[0] == pytest.approx(corrected[1], abs=1e-9)
    (tmp_path / "other.json").write_text('{"schema": "rlgcomp.calibration/1", "kind": "gyro", "pulse_arcsec": 0.8001}')
    for options, message in (
        (["--calibration", tmp_path / "no.json"], "does not exist"),
        (["--calibration", tmp_path / "other.json"], "was trained on gyros calibrated with"),
        (["--pulse-arcsec", 0.8], "give that file with --calibration"),
    ):
        refused = run("evaluate", tmp_path / "raw", tmp_path / "b.parquet", *options, "--out", tmp_path / "e")
        assert refused.exit_code == 2, refused.output
        assert message in refused.output
        assert not (tmp_path / "e").exists()


@pytest.mark.parametrize("known", [None, 0.8], ids=["size unknown", "size known"])
@pytest.mark.usefixtures("undrawn")
def test_one_gyros_calibration_is_applied_to_that_of_several(
    tmp_path: Path, short_runs: list[rlg.Recording], known: float | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    """--gyro, or the model's own gyro, says which; both of its names are understood, and the others stay as they are."""
    monkeypatch.setattr("rlgcomp.export.toolchain.TOOLCHAINS", ())
    (tmp_path / "k.json").write_text('{"schema": "rlgcomp.calibration/1", "kind": "gyro", "pulse_arcsec": 0.8}')
    for name, recording in zip(("a", "b"), short_runs, strict=False):
        table = recording.table
        pulses = table.pop("gyro_deg_h") * recording.period_s / 0.8
        table = table.assign(gyro_x_pulses=pulses, gyro_y_pulses=2.0 * pulses)
        imu = recording.replace(table=table, truth=None, metadata=dataclasses.replace(recording.metadata, pulse_arcsec=known))
        rlg.write(imu, tmp_path / f"{name}.parquet")
        rlg.write(imu.replace(table=table.drop(columns="gyro_y_pulses")), tmp_path / f"{name}-alone.parquet")
    rlg.write(imu, tmp_path / "b.csv")
    calibrated = ["--calibration", tmp_path / "k.json"]
    train = ["--model", "cubic", "--features", "temperature", *calibrated]
    found = []
    for model, file, gyro in (
        ("pulses", "a", ["--gyro", "gyro_x_pulses"]),
        ("rate", "a", ["--gyro", "gyro_x_deg_h"]),
        ("alone", "a-alone", []),
    ):
        done = run("train", tmp_path / f"{file}.parquet", *gyro, *train, "--out", tmp_path / model)
        assert done.exit_code == 0, done.output
        out = tmp_path / f"{model}.parquet"
        done = run("compensate", tmp_path / model, tmp_path / "b.parquet", *calibrated, "--out", out)
        assert done.exit_code == 0, done.output
        found.append(rlg.read(out))
    assert found[0].gyro_columns == ("gyro_x_deg_h", "gyro_y_pulses")
    assert found[0].metadata.pulse_arcsec == known
    raw = rlg.read(tmp_path / "b.parquet")
    assert (found[0].column("gyro_y_pulses") == raw.column("gyro_y_pulses")).all()
    for other in found[1:]:
        pd.testing.assert_frame_equal(other.table, found[0].table)
    followed = run(
        "compensate",
        tmp_path / "rate",
        tmp_path / "b.csv",
        "--follow",
        "--idle-s",
        0,
        "--period-s",
        5,
        *calibrated,
        "--out",
        tmp_path / "f.csv",
    )
    assert followed.exit_code == 0, followed.output
    stream = pd.read_csv(tmp_path / "f.csv")
    assert list(stream.columns) == list(found[0].columns)
    assert stream["gyro_x_deg_h"].to_numpy() == pytest.approx(found[0].column("gyro_x_deg_h"), rel=1e-12)
    assert stream["gyro_y_pulses"].to_numpy() == pytest.approx(raw.column("gyro_y_pulses"), rel=1e-12)
    done = run("evaluate", tmp_path / "rate", tmp_path / "b.parquet", *calibrated, "--no-comparison", "--out", tmp_path / "e")
    assert done.exit_code == 0, done.output
    done = run("export", tmp_path / "rate", "--test", tmp_path / "b.parquet", *calibrated, "--out", tmp_path / "c")
    assert done.exit_code == 0, done.output
    text = " ".join(refused("train", tmp_path / "a.parquet", *train, "--out", tmp_path / "m").split())
    assert "none was chosen; choose with --gyro COLUMN, or leave the others out with --drop COLUMN" in text
    table = raw.table.rename(columns={"gyro_x_pulses": "gyro_z_pulses"})
    rlg.write(raw.replace(table=table), tmp_path / "zy.parquet")
    text = " ".join(
        refused("compensate", tmp_path / "rate", tmp_path / "zy.parquet", *calibrated, "--out", tmp_path / "o.csv").split()
    )
    assert "'gyro_x_deg_h' is not among them; name it so with --map gyro_x_deg_h=" in text


@pytest.mark.usefixtures("undrawn")
def test_a_diagnosis_takes_one_gyros_calibration_too(tmp_path: Path, short_runs: list[rlg.Recording]) -> None:
    (tmp_path / "k.json").write_text('{"schema": "rlgcomp.calibration/1", "kind": "gyro", "pulse_arcsec": 0.8}')
    (tmp_path / "gyro.yaml").write_text("kind: chamber\nmechanisms: []\n")
    recording = short_runs[0]
    table = recording.table.iloc[:800]
    pulses = table.pop("gyro_deg_h") * recording.period_s / 0.8
    table = table.assign(gyro_x_pulses=pulses, gyro_y_pulses=0.0 * pulses + np.arange(len(pulses)) % 7)
    rlg.write(recording.replace(table=table, truth=None), tmp_path / "imu.parquet")
    given = ["--simulator", tmp_path / "gyro.yaml", "--train", tmp_path / "imu.parquet", "--out", tmp_path / "d", "--json"]
    only = ["--mechanisms", write_bellows(tmp_path / "own.py"), "--only-mechanisms"]
    gyro = ["--gyro", "gyro_x_pulses", "--calibration", tmp_path / "k.json", "--averaging-s", 200]
    done = run("diagnose", *given, *only, *gyro)
    assert done.exit_code == 0, done.output
    assert "gyro_x_deg_h" in done.stdout
    assert "gyro_y" not in done.stdout


@pytest.mark.parametrize("interval", ["500:100", "1e6:", ":-5"])
def test_an_interval_outside_the_run_is_refused(folder: Path, interval: str) -> None:
    result = run("inspect", f"{folder / 'run1.parquet'}@{interval}")
    assert result.exit_code == 2
    assert "the run covers" in result.output


def test_what_is_suggested_and_named_is_that_of_the_files(short_runs: list[rlg.Recording], tmp_path: Path) -> None:
    """Paths with blanks are quoted, files of one name in two folders are told apart, times have all their digits."""
    for folder in ("cold run", "hot run"):
        (tmp_path / folder).mkdir()
        rlg.write(short_runs[0], tmp_path / folder / "run.parquet")
    one, other = (tmp_path / folder / "run.parquet" for folder in ("cold run", "hot run"))
    text = " ".join(refused("train", one, other, "--out", tmp_path / "m").split())
    assert f"{other} holds rows of {one}" in text
    assert "runs[" not in text
    done = run("train", one, "--model", "cubic", "--out", tmp_path / "my model")
    assert done.exit_code == 0, done.output
    assert f"rlgcomp evaluate '{tmp_path / 'my model'}'" in " ".join(done.output.split())
    late = short_runs[0].replace(table=short_runs[0].table.assign(time_s=short_runs[0].time_s + 4287770.0))
    rlg.write(late, tmp_path / "late.parquet")
    assert f"covers {late.time_s[0]:.0f} to {late.time_s[-1]:.0f} s" in " ".join(
        refused("inspect", f"{tmp_path / 'late.parquet'}@2000:14000").split()
    )


def test_a_thermometer_that_was_not_mapped_is_suggested(short_runs: list[rlg.Recording], tmp_path: Path) -> None:
    monitors = short_runs[0].table[["time_s", "gyro_deg_h", "temperature_block_degC", "pressure_hPa"]]
    monitors.rename(columns={"temperature_block_degC": "T_block_K", "pressure_hPa": "pressure"}).to_csv(
        tmp_path / "a.csv", index=False
    )
    text = " ".join(refused("train", tmp_path / "a.csv", "--out", tmp_path / "m").split())
    assert "or map a temperature, here probably with --map temperature_block_degC=T_block_K" in text
