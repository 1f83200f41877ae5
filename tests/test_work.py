"""Pieces of experiments: kept, resumed, spread over processes of which one dies; results as if they had been made at once."""

from __future__ import annotations

import importlib
import json
import os
import signal
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from experiments import work as module
from experiments.cluster import Cluster
from experiments.work import Work
from rlgcomp.workers import DIED


def drawn(seed: int, scale: float, log: str = "") -> dict[str, Any]:
    """Plain data and NumPy's, one of them not a number."""
    if log:
        with Path(log).open("a") as lines:
            lines.write(f"{seed}\n")
    values = scale * np.random.default_rng(seed).normal(size=3)
    return {"values": values, "mean": values.mean(), "none": np.nan, "pair": (seed, "ü")}


def kills(seed: int) -> int:
    if seed == 1:
        os.kill(os.getpid(), signal.SIGKILL)
    return seed


@pytest.mark.parametrize("jobs", [1, 2])
def test_results_are_plain_data_in_the_order_of_the_pieces(jobs: int, tmp_path: Path) -> None:
    found = Work(jobs, rows=tmp_path / "deep" / "rows.jsonl").results("drawn", drawn, [(seed, 2.0) for seed in (3, 1, 2)])
    for seed, one in zip((3, 1, 2), found, strict=True):
        expected = drawn(seed, 2.0)
        assert one == {"values": expected["values"].tolist(), "mean": float(expected["mean"]), "none": None, "pair": [seed, "ü"]}


def test_what_was_finished_is_not_made_again_and_comes_back_to_the_last_bit(tmp_path: Path) -> None:
    rows, log = tmp_path / "rows.jsonl", tmp_path / "log"
    pieces = [(seed, 0.1, str(log)) for seed in range(4)]
    whole = Work(1, rows=rows).results("drawn", drawn, pieces)
    first, second, third, fourth = rows.read_text().splitlines()
    failed = json.dumps({"key": json.loads(second)["key"], "failure": DIED})
    rows.write_text(f"{first}\n{failed}\n[1]\n{fourth}\n{third[:25]}")
    log.write_text("")
    assert Work(1, rows=rows, resume=True).results("drawn", drawn, pieces) == whole
    assert log.read_text().split() == ["1", "2"]
    assert len(rows.read_text().splitlines()) == 4
    log.write_text("")
    Work(1, rows=rows, resume=True).results("drawn otherwise", drawn, pieces)
    assert log.read_text().split() == ["0", "1", "2", "3"]
    Work(1, rows=rows)
    assert rows.read_text() == ""


@pytest.mark.filterwarnings("ignore:A worker stopped")
def test_a_piece_that_kills_its_worker_ends_with_a_message_and_the_others_are_kept(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rows = tmp_path / "rows.jsonl"
    with pytest.raises(SystemExit, match="1"):
        Work(2, rows=rows).results("kills", kills, [(seed,) for seed in range(3)])
    assert "error: 1 of 3 failed, the first kills(1,)" in capsys.readouterr().err
    kept = Work(1, rows=rows, resume=True)
    assert kept.results("kills", kills, [(0,), (2,)]) == [0, 2]


@pytest.mark.slow
@pytest.mark.needs("distributed")
@pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::UserWarning", "ignore::ResourceWarning")
def test_the_concealed_benchmark_on_a_cluster_whose_worker_is_killed(
    cluster: Cluster, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Three cases are diagnosed by one process, and by three workers of which one is killed half-way: the same but for seconds."""
    from experiments.concealed.__main__ import main

    address, processes = cluster
    options = ["--only", "turntable", "--cases", "3", "--tuning", "--rows"]
    main([*options, str(tmp_path / "one"), "--jobs", "1"])
    kill_after(1, processes, monkeypatch)
    main([*options, str(tmp_path / "two"), "--scheduler", address])
    assert processes[1].poll() is not None
    one, two = ({row["key"]: row for row in map(json.loads, (tmp_path / name).read_text().splitlines())} for name in ("one", "two"))
    for rows in (one, two):
        for row in rows.values():
            assert row.pop("seconds") > 0.0
            assert row.pop("cpu_seconds") > 0.0
            assert row.pop("memory_mib") > 0.0
    assert len(one) == 3
    assert one == two


def kill_after(rows: int, processes: list[Any], monkeypatch: pytest.MonkeyPatch) -> None:
    """Kill the first worker when so many rows have come."""
    come = []
    finished = module.line_of

    def line(row: dict[str, Any]) -> str:
        come.append(row)
        if len(come) == rows:
            processes[1].send_signal(signal.SIGKILL)
        return finished(row)

    monkeypatch.setattr(module, "line_of", line)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "options"),
    [("noise_floor", ["--units", "1"]), ("laws", ["--cases", "1", "--nulls", "1"]), ("optica_2015", ["--units", "2"])],
)
def test_experiments_print_the_same_by_two_processes_and_when_resumed(
    name: str, options: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    program = importlib.import_module(f"experiments.{name}.__main__")
    outputs = []
    for more in (["--jobs", "1"], ["--jobs", "2"], ["--resume"]):
        program.main([*options, "--rows", str(tmp_path / "rows"), *more])
        outputs.append(capsys.readouterr().out)
    assert outputs[0].count("|") > 50
    assert outputs[0] == outputs[1] == outputs[2]
