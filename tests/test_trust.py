"""What files of strangers cannot do: name files out of their folder, steer a terminal; and how commands end."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from typer.testing import CliRunner

import rlgcomp as rlg
from rlgcomp.challenge import seal
from rlgcomp.cli import register_commands
from rlgcomp.cli.base import app
from rlgcomp.errors import InputError
from rlgcomp.files import sha256
from rlgcomp.scratch import PREFIX

COMMAND = [sys.executable, "-m", "rlgcomp"]
SIMULATOR = "kind: chamber\nmechanisms:\n  - thermal_polynomial: {degree: 3}\nnoise: {angle_random_walk_deg_sqrt_h: 0.0003}\n"


@pytest.mark.parametrize("name", ["../truth.json", "/etc/passwd", "a" * 5000, "", "a/b", "\x1b[2J", 3, None, ["truth.json"]])
def test_a_challenge_names_files_of_its_own_folder_alone(tmp_path: Path, name: object) -> None:
    (tmp_path / "truth.json").write_text(json.dumps({"schema": seal.TRUTH_SCHEMA, "files": {}}))
    folder = tmp_path / "challenge"
    folder.mkdir()
    content = {"schema": seal.CHALLENGE_SCHEMA, "truth": name, "truth_sha256": sha256(tmp_path / "truth.json")}
    (folder / "challenge.json").write_text(json.dumps(content))
    with pytest.raises(InputError, match=r"lies in no challenge"):
        seal.reveal(folder, folder)


@pytest.fixture
def simulator(tmp_path: Path) -> Path:
    (tmp_path / "gyro.yaml").write_text(SIMULATOR)
    return tmp_path / "gyro.yaml"


def test_a_signal_leaves_no_scratch(simulator: Path, tmp_path: Path) -> None:
    """A long simulation is stopped while it writes or before: what is there is whole, and nothing else is."""
    out = tmp_path / "out"
    out.mkdir()
    line = [
        *COMMAND,
        "simulate",
        str(simulator),
        "--profile",
        "start 20, hold 120",
        "--step-s",
        "0.2",
        "--out",
        str(out / "run.csv"),
    ]
    for number in (signal.SIGTERM, signal.SIGINT):
        process = subprocess.Popen(line, stderr=subprocess.PIPE)
        until = time.monotonic() + 120.0
        while not any(out.iterdir()) and process.poll() is None and time.monotonic() < until:
            time.sleep(0.02)
        process.send_signal(number)
        _, error = process.communicate(timeout=120)
        assert process.returncode in (0, 128 + number, -number)
        assert b"Traceback" not in error
        assert not [path for path in out.iterdir() if path.name.startswith(PREFIX)]
        for path in out.iterdir():
            path.unlink()


def test_an_interrupt_before_the_command_runs_is_quiet() -> None:
    text = (  # a job of a shell ignores the signal
        "import os, signal, rlgcomp.cli as cli; signal.signal(signal.SIGINT, signal.default_int_handler);"
        "cli.register_commands = lambda: os.kill(os.getpid(), signal.SIGINT); cli.main()"
    )
    done = subprocess.run([sys.executable, "-c", text], capture_output=True, check=False)
    assert done.returncode == -signal.SIGINT
    assert not done.stderr


_TABLE_AND_JSON = """
import sys
from rlgcomp.cli import main
for option in ([], ["--json"]):
    sys.argv[3:] = option
    try:
        main()
    except SystemExit as ended:
        print(end=f"\\0{ended.code}\\0")
"""


def test_closed_and_narrow_streams_are_no_fault(simulator: Path, tmp_path: Path) -> None:
    simulate = [
        *COMMAND,
        "simulate",
        str(simulator),
        "--profile",
        "short",
        "--step-s",
        "20",
        "--out",
        str(tmp_path / "run.parquet"),
    ]
    assert subprocess.run(["bash", "-c", '"$@" >&- 2>&- <&-', "-", *simulate], check=False).returncode == 0
    narrow = {**os.environ, "PYTHONIOENCODING": "ascii", "PYTHONUTF8": "0", "LC_ALL": "C", "NO_COLOR": "1"}
    inspect = [sys.executable, "-c", _TABLE_AND_JSON, "inspect", str(tmp_path / "run.parquet")]
    done = subprocess.run(inspect, env=narrow, capture_output=True, check=True)
    assert done.stdout.isascii()
    assert not done.stderr  # quiet where there is no terminal
    assert b"\x1b" not in done.stdout
    table, code, as_json, code_of_json, _ = done.stdout.decode().split("\0")
    assert "Thermal legs" in table
    assert json.loads(as_json)[0]["name"] == "run"
    assert (code, code_of_json) == ("0", "0")
    full = [*COMMAND, "mechanisms"]
    assert subprocess.run(["bash", "-c", '"$@" > /dev/full', "-", *full], capture_output=True, check=False).returncode == 2


def test_a_reader_that_has_seen_enough_is_no_fault(tmp_path: Path) -> None:
    """A table as its first output, and nobody who reads it."""
    time_s = 10.0 * np.arange(900.0)
    rng = np.random.default_rng(0)
    for k in range(2):
        table = {"time_s": time_s, "gyro_deg_h": rng.normal(size=900), "temperature_block_degC": 20.0 + 1e-3 * time_s + k}
        pd.DataFrame(table).to_parquet(tmp_path / f"run{k}.parquet")
    runs = [str(tmp_path / f"run{k}.parquet") for k in range(2)]
    train = [*COMMAND, "train", *runs, "--model", "cubic", "--features", "temperature", "--out", str(tmp_path / "model")]
    reading, writing = os.pipe()
    os.close(reading)
    done = subprocess.run(train, stdout=writing, stderr=subprocess.PIPE, check=False)
    os.close(writing)
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "model" / "SHA256SUMS").exists()


def test_names_do_not_steer_the_terminal(simulator: Path, tmp_path: Path) -> None:
    path = tmp_path / "run\x1b[2J.csv"
    rlg.write(rlg.Simulator.from_yaml(simulator).simulate("short", step_s=20.0), path)
    register_commands()
    for given in (path, tmp_path / "absent\x1b[2J.csv"):
        done = CliRunner().invoke(app, ["inspect", str(given)])
        assert r"\x1b[2J" in done.output
        assert "\x1b[2J" not in done.output


_ON_A_FULL_DISK = """
import resource, signal, sys
from typer.testing import CliRunner
from rlgcomp.cli import register_commands
from rlgcomp.cli.base import app
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (8192, 8192))
register_commands()
for path in sys.argv[2:]:
    done = CliRunner().invoke(app, ["simulate", sys.argv[1], "--profile", "short", "--step-s", "5", "--out", path])
    print(path, done.exit_code, done.stderr.count("error:"), done.stderr.count("Traceback"))
"""


def test_a_full_disk_is_one_message(simulator: Path, tmp_path: Path) -> None:
    """No file may grow beyond 8 KiB."""
    runs = [str(tmp_path / name) for name in ("run.h5", "run.parquet", "run.csv", "run.mat")]
    command = [sys.executable, "-c", _ON_A_FULL_DISK, str(simulator), *runs]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert done.stdout.splitlines() == [f"{run} 2 1 0" for run in runs], done.stderr
    assert not done.stderr
    assert {path.name for path in tmp_path.iterdir()} == {"gyro.yaml"}


def test_the_threat_model_names_tests_that_exist() -> None:
    root = Path(__file__).parents[1]
    text = (root / "docs" / "threat_model.md").read_text(encoding="utf-8")
    tests = "".join(path.read_text(encoding="utf-8") for path in (root / "tests").glob("test_*.py"))
    assert not [name for name in re.findall(r"`(test_[a-z_0-9]+)`", text) if f"def {name}(" not in tests]
    sentences = [part.split("\n\n")[0] for part in re.split(r"^- ", text, flags=re.MULTILINE)[1:]]
    assert len(sentences) > 20
    assert all(
        "(" in line for line in sentences if "model's SHA-256" not in line and "large honest" not in line and "invented" not in line
    )
