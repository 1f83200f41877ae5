"""Fleets: results bit for bit the same however they are worked on, failures reported, kept results kept, deaths survived."""

from __future__ import annotations

import functools
import json
import logging
import os
import shutil
import signal
import time
from collections.abc import Callable
from datetime import datetime
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import experiments.work
import rlgcomp as rlg
from experiments.cluster import Cluster
from rlgcomp.cli import register_commands
from rlgcomp.cli.base import app
from rlgcomp.cli.fleet import USUAL, workers_pay
from rlgcomp.compensation.models import MODELS
from rlgcomp.errors import InputError
from rlgcomp.files import sha256
from rlgcomp.fleet import NOTE, SUMMARY, Unit, diagnose_unit, read_fleet, run_fleet, train_unit
from rlgcomp.recording.provenance import recorded_command

register_commands()
TRAIN = functools.partial(train_unit, model="cubic", features="temperature")


@pytest.fixture(scope="module")
def units(tmp_path_factory: pytest.TempPathFactory) -> list[Unit]:
    """Three gyros, the second of which has a damaged file."""
    folder = tmp_path_factory.mktemp("runs")
    lines = ["unit,train"]
    for k in range(3):
        paths = [folder / f"{k}-{seed}.parquet" for seed in (1, 2)]
        for seed, path in enumerate(paths, start=1):
            rlg.write(rlg.simulated_unit(k).simulate("short", seed=seed, step_s=10.0), path)
        lines.append(f"gyro-{k},{paths[0].name};{paths[1].name}")
    (folder / "1-2.parquet").write_bytes(b"PAR1 and nothing more")
    (folder / "units.csv").write_text("\n".join(lines) + "\n")
    return read_fleet(folder / "units.csv")


def arrays(out: Path, unit: str) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in sorted((out / unit / "model" / "arrays").iterdir())}


def test_results_are_the_same_by_one_and_by_two_processes(units: list[Unit], tmp_path: Path) -> None:
    one = run_fleet(TRAIN, units, tmp_path / "one")
    two = run_fleet(TRAIN, units, tmp_path / "two", n_jobs=2)
    assert [outcome.state for outcome in one] == [outcome.state for outcome in two] == ["done", "failed", "done"]
    assert "1-2.parquet is a damaged Parquet file" in one[1].message
    assert not (tmp_path / "one" / "gyro-1").exists()
    for unit in ("gyro-0", "gyro-2"):
        assert arrays(tmp_path / "one", unit) == arrays(tmp_path / "two", unit)
    written = json.loads((tmp_path / "one" / SUMMARY).read_text())
    assert [row["unit"] for row in written] == ["gyro-0", "gyro-1", "gyro-2"]
    loaded = rlg.load(tmp_path / "one" / "gyro-0" / "model")
    assert np.isfinite(loaded.predict(rlg.read(units[0].train[0]))["bias_deg_h"]).all()


def test_units_state_the_command_its_date_and_the_digests_of_their_files(units: list[Unit], tmp_path: Path) -> None:
    with recorded_command("rlgcomp fleet train units.csv", None):
        run_fleet(TRAIN, [units[0], units[2]], tmp_path / "out", n_jobs=2)
    made = json.loads((tmp_path / "out" / "gyro-2" / NOTE).read_text())["provenance"]
    assert made["command"] == "rlgcomp fleet train units.csv"
    assert datetime.fromisoformat(made["date"])
    assert made["inputs"] == {str(path): sha256(path) for path in units[2].train}
    manifest = json.loads((tmp_path / "out" / "gyro-2" / "model" / "manifest.json").read_text())
    assert manifest["provenance"]["command"] == "rlgcomp fleet train units.csv"
    assert [run["sha256"] for run in manifest["runs"]] == [sha256(path) for path in units[2].train]


def test_what_is_said_of_a_unit_begins_with_its_name(units: list[Unit], tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.INFO, logger="rlgcomp")  # a quiet command may have run before
    run_fleet(TRAIN, [Unit("lone", units[0].train[:1])], tmp_path / "out")
    messages = [record.getMessage() for record in caplog.records]
    assert any(message.startswith("lone: one run only: 5 blocks of it choose the model") for message in messages)
    caplog.clear()
    train_unit(Unit("lone", units[0].train[:1]), tmp_path, model="cubic", features="temperature")
    assert not any(record.getMessage().startswith("lone") for record in caplog.records)


def test_what_is_done_is_kept_until_its_files_or_settings_change(units: list[Unit], tmp_path: Path) -> None:
    healthy = [units[0], units[2]]
    run_fleet(TRAIN, healthy, tmp_path / "out")
    before = (tmp_path / "out" / "gyro-0" / NOTE).stat().st_mtime_ns
    assert [one.state for one in run_fleet(TRAIN, healthy, tmp_path / "out")] == ["kept", "kept"]
    assert (tmp_path / "out" / "gyro-0" / NOTE).stat().st_mtime_ns == before
    other = functools.partial(train_unit, model="cubic", features="all")
    assert [one.state for one in run_fleet(other, healthy, tmp_path / "out")] == ["done", "done"]
    changed = [Unit("gyro-0", units[0].train[:1]), healthy[1]]
    assert [one.state for one in run_fleet(other, changed, tmp_path / "out")] == ["done", "kept"]


def test_what_else_stands_in_a_units_folder_is_kept(units: list[Unit], tmp_path: Path) -> None:
    out, unit = tmp_path / "out", units[0]
    run_fleet(TRAIN, [unit], out)
    other = functools.partial(train_unit, model="cubic", features="all")
    (out / unit.name / "model" / "c").mkdir()
    (out / unit.name / "model" / "c" / "model.c").write_text("code")
    (one,) = run_fleet(other, [unit], out)
    assert "holds model/c, which an earlier run did not write" in one.message
    shutil.rmtree(out / unit.name / "model" / "c")
    (one,) = run_fleet(always_dies, [unit], out)  # another task
    assert "holds model, which an earlier run did not write" in one.message
    inside = out / unit.name / "model" / "card.md"
    (one,) = run_fleet(other, [Unit(unit.name, (*unit.train, inside))], out)
    assert f"{inside} lies in {out / unit.name}" in one.message
    assert [one.state for one in run_fleet(other, [unit], out)] == ["done"]


def test_a_changed_yaml_or_package_is_no_longer_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "run.csv"
    path.write_text("time_s,gyro_deg_h\n0,0.1\n")
    fleet, out = [Unit("gyro-0", (path,))], tmp_path / "out"

    def state() -> str:
        (outcome,) = run_fleet(always_dies, fleet, out)
        return outcome.state

    assert [state(), state()] == ["done", "kept"]
    (tmp_path / "run.yaml").write_text("unit: A\n")
    assert [state(), state()] == ["done", "kept"]
    (tmp_path / "run.yaml").write_text("unit: B\n")
    assert [state(), state()] == ["done", "kept"]
    monkeypatch.setattr("rlgcomp.fleet.__version__", "0.0.0")
    assert [state(), state()] == ["done", "kept"]


def test_a_unit_held_out_from_itself_fails_and_runs_of_one_name_are_told_apart(units: list[Unit], tmp_path: Path) -> None:
    simulator = tmp_path / "sim.yaml"
    simulator.write_text("kind: chamber\nmechanisms: [temperature_rate]\n")
    (tmp_path / "other").mkdir()
    same = tmp_path / "other" / units[0].train[0].name
    same.write_bytes(units[0].train[0].read_bytes())
    (outcome,) = run_fleet(diagnose_unit, [Unit("gyro-0", units[0].train, (same,), simulator)], tmp_path / "out")
    assert outcome.state == "failed"
    assert f"{same} is given both to train and to test, at least in part" in outcome.message


def dies_once(unit: Unit, folder: Path, *, marks: str) -> dict[str, object]:
    """A task whose first worker is killed in the middle of the second unit, as by a want of memory."""
    mark = Path(marks) / unit.name
    if unit.name == "gyro-1" and not mark.exists():
        mark.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    (folder / "value").write_text(str(np.random.default_rng(int(unit.name[-1])).normal()))
    return {"value": 1.0}


def always_dies(unit: Unit, folder: Path) -> dict[str, object]:
    if unit.name == "gyro-1":
        os.kill(os.getpid(), signal.SIGKILL)
    (folder / "value").touch()
    return {}


@pytest.mark.filterwarnings("ignore:A worker stopped")
def test_a_process_that_is_killed_takes_no_unit_with_it(tmp_path: Path) -> None:
    fleet = [Unit(f"gyro-{k}", ()) for k in range(4)]
    outcomes = run_fleet(functools.partial(dies_once, marks=str(tmp_path)), fleet, tmp_path / "out", n_jobs=2)
    assert [one.state for one in outcomes] == ["done"] * 4


@pytest.mark.filterwarnings("ignore:A worker stopped")
def test_a_unit_that_kills_its_process_each_time_fails_alone(tmp_path: Path) -> None:
    fleet = [Unit(f"gyro-{k}", ()) for k in range(3)]
    outcomes = run_fleet(always_dies, fleet, tmp_path / "out", n_jobs=2)
    assert [one.state for one in outcomes] == ["done", "failed", "done"]
    assert "process died" in outcomes[1].message


def writes_one(unit: Unit, folder: Path) -> dict[str, object]:
    (folder / "value").write_text(unit.name)
    return {}


def test_a_unit_whose_files_are_damaged_is_done_again(tmp_path: Path) -> None:
    fleet = [Unit(f"gyro-{k}", ()) for k in range(2)]
    run_fleet(writes_one, fleet, tmp_path / "out")
    (tmp_path / "out" / "gyro-0" / "value").write_text("gyro-9")
    assert [one.state for one in run_fleet(writes_one, fleet, tmp_path / "out")] == ["done", "kept"]
    assert (tmp_path / "out" / "gyro-0" / "value").read_text() == "gyro-0"
    (tmp_path / "out" / "gyro-1" / "value").unlink()
    assert [one.state for one in run_fleet(writes_one, fleet, tmp_path / "out")] == ["kept", "done"]


def slow(unit: Unit, folder: Path) -> dict[str, object]:
    time.sleep(0.2)
    (folder / "value").write_text(repr(np.random.default_rng(int(unit.name[-1])).normal(size=50).tolist()))
    return {"pid": os.getpid()}


def drawn(seed: int) -> list[float]:
    time.sleep(0.2)
    return np.random.default_rng(seed).normal(size=20).tolist()


@pytest.mark.needs("distributed")
@pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::UserWarning", "ignore::ResourceWarning")
def test_a_cluster_gives_the_same_bits_though_a_worker_is_killed(
    cluster: Cluster, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A fleet, in the middle of which a worker is killed, then pieces of an experiment, in the middle of which another one is."""
    address, processes = cluster
    fleet = [Unit(f"gyro-{k}", ()) for k in range(8)]
    expected = run_fleet(slow, fleet, tmp_path / "here")

    def shown(done: int, total: int) -> None:
        if done == 3:
            processes[1].send_signal(signal.SIGKILL)

    outcomes = run_fleet(slow, fleet, tmp_path / "there", scheduler=address, progress=shown)
    assert [one.state for one in outcomes] == [one.state for one in expected] == ["done"] * 8
    for unit in fleet:
        assert (tmp_path / "here" / unit.name / "value").read_bytes() == (tmp_path / "there" / unit.name / "value").read_bytes()
    assert processes[1].poll() is not None
    pids = {one.result["pid"] for one in outcomes}
    assert os.getpid() not in pids
    pieces = [(seed,) for seed in range(8)]
    written = []

    def line(row: dict[str, object], *, usual: Callable[[dict[str, object]], str] = experiments.work.line_of) -> str:
        written.append(row)
        if len(written) == 3:
            processes[2].send_signal(signal.SIGKILL)
        return usual(row)

    monkeypatch.setattr("experiments.work.line_of", line)
    found = experiments.work.Work(scheduler=address, rows=tmp_path / "rows").results("drawn", drawn, pieces)
    assert processes[2].poll() is not None
    assert len((tmp_path / "rows").read_text().splitlines()) == 8
    assert found == experiments.work.Work(1).results("drawn", drawn, pieces)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("unit\na\n", "lacks the column train"),
        ("unit,train\n", "has no rows"),
        ("unit,train\na,x.csv\na,y.csv\n", "named twice: a"),
        ("unit,train\n../a,x.csv\n", "cannot name a folder"),
        ("unit,train\n,x.csv\n", "cannot name a folder"),
        ("unit,train\na, ; \n", "no recording under train"),
        ("", "not readable as CSV"),
    ],
)
def test_bad_tables_are_refused(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "units.csv"
    path.write_text(text)
    with pytest.raises(InputError, match=message):
        read_fleet(path)


def test_the_command_reports_each_unit_and_ends_with_two_where_one_failed(units: list[Unit], tmp_path: Path) -> None:
    table = units[0].train[0].parent / "units.csv"
    arguments = ["fleet", "train", str(table), "--out", str(tmp_path / "out"), "--model", "cubic", "--features", "temperature"]
    done = CliRunner().invoke(app, arguments)
    assert done.exit_code == 2
    assert "2 of 3 units" in done.output
    assert "selected" not in done.output  # a cubic has nothing to select
    assert "1 of 3 units failed, the first gyro-1" in done.output
    assert (tmp_path / "out" / "gyro-2" / "model" / "manifest.json").exists()


@pytest.mark.parametrize(
    ("number", "size", "pay"), [(1, 10, False), (10, 250_000, False), (11, 250_000, True), (2, 10_000_000, True), (0, 10, False)]
)
def test_several_workers_pay_from_some_work_on(tmp_path: Path, number: int, size: int, pay: bool) -> None:
    with (tmp_path / "run.csv").open("wb") as stream:
        stream.truncate(size)
    lines = [f"unit-{k}, run.csv; run.csv; absent.csv" for k in range(number)]
    (tmp_path / "units.csv").write_text("\n".join(["unit,train", *lines]) + "\n")
    assert workers_pay(tmp_path / "units.csv") is pay


def test_a_table_that_cannot_be_read_is_not_judged(tmp_path: Path) -> None:
    assert workers_pay(tmp_path / "none.csv")
    assert workers_pay(tmp_path)
    (tmp_path / "units.csv").write_bytes(b"unit,train\n\xff,\xff\n")
    assert workers_pay(tmp_path / "units.csv")


def test_a_few_small_units_are_trained_by_one_worker_which_is_said(units: list[Unit], tmp_path: Path) -> None:
    table = units[0].train[0].parent / "units.csv"
    arguments = ["fleet", "train", str(table), "--model", "cubic", "--features", "temperature", "--jobs", "2"]
    done = CliRunner().invoke(app, [*arguments, "--out", str(tmp_path / "few")])
    assert "one worker trains these units; 2 would take longer to start than they save" in " ".join(done.output.split())
    done = CliRunner().invoke(app, [*arguments, "--averaging-s", "60", "--out", str(tmp_path / "other")])
    assert "one worker" not in done.output
    assert arrays(tmp_path / "few", "gyro-0").keys() == arrays(tmp_path / "other", "gyro-0").keys()


def test_models_that_need_no_look_up_are_models() -> None:
    assert set(USUAL) <= set(MODELS)


@pytest.mark.parametrize("keep", [False, True])
def test_the_mean_is_kept_as_advised(units: list[Unit], tmp_path: Path, caplog: pytest.LogCaptureFixture, keep: bool) -> None:
    run = rlg.read(units[0].train[0])
    turned = run.replace(table=run.table.assign(**{run.gyro_columns[0]: run.rate_deg_h() + 9.7}))
    rlg.write(turned, tmp_path / "run.parquet")
    (tmp_path / "units.csv").write_text("unit,train\ngyro,run.parquet\n")
    options = ["--model", "cubic", "--features", "temperature", *(["--keep-mean"] if keep else [])]
    caplog.set_level(logging.WARNING, logger="rlgcomp")
    done = CliRunner().invoke(app, ["fleet", "train", str(tmp_path / "units.csv"), "--out", str(tmp_path / "out"), *options])
    assert done.exit_code == 0, done.output
    messages = " ".join(done.output.split()) + " ".join(record.getMessage() for record in caplog.records)
    assert ("Use --keep-mean to keep it" in messages) is not keep
    assert abs(rlg.load(tmp_path / "out" / "gyro" / "model").reference_deg_h - (9.7 if keep else 0.0)) < 0.1


@pytest.mark.parametrize("arguments", [["dance"], ["train", "--model", "none"], ["train", "--scheduler", "nonsense://here"]])
def test_bad_input_ends_with_one_message(units: list[Unit], tmp_path: Path, arguments: list[str]) -> None:
    table = units[0].train[0].parent / "units.csv"
    task, *options = arguments
    done = CliRunner().invoke(app, ["fleet", task, str(table), "--out", str(tmp_path / "out"), *options])
    assert done.exit_code == 2
    assert done.output.count("error:") == 1


@pytest.mark.parametrize("sign", [",", ";", "\t"])
def test_a_table_of_units_has_any_separator(tmp_path: Path, sign: str) -> None:
    path = tmp_path / "units.csv"
    path.write_text(f'unit{sign}train\nA{sign}"a.parquet;b.parquet"\nB{sign}c.parquet\n')
    assert [(one.name, [run.name for run in one.train]) for one in read_fleet(path)] == [
        ("A", ["a.parquet", "b.parquet"]), ("B", ["c.parquet"])
    ]  # fmt: skip
    path.write_text(f"unit{sign}run\nA{sign}a.parquet\n")
    apart = {",": "commas", ";": "semicolons", "\t": "tabs"}[sign]
    with pytest.raises(InputError, match=f"lacks the column train; .* and has unit, run, read between {apart}"):
        read_fleet(path)
