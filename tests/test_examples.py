"""Example data: what README and tutorials use is made quickly, the same for a seed, and read as the documents say."""

from __future__ import annotations

import hashlib
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import rlgcomp as rlg
from rlgcomp.cli import register_commands
from rlgcomp.cli.base import app
from rlgcomp.simulation.examples import EXAMPLES, LOGGER


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    register_commands()
    folder = tmp_path_factory.mktemp("examples")
    for kind in EXAMPLES:
        result = CliRunner().invoke(app, ["example", kind, "--out", str(folder / kind)])
        assert result.exit_code == 0, result.output
    return folder


@pytest.mark.parametrize("kind", EXAMPLES)
def test_every_file_is_named(made: Path, kind: str) -> None:
    patterns = EXAMPLES[kind].files
    files = {path.name for path in (made / kind).iterdir()}
    assert all(list((made / kind).glob(pattern)) for pattern in patterns)
    assert files == {path.name for pattern in patterns for path in (made / kind).glob(pattern)}


def test_the_same_seed_gives_the_same_files(made: Path, tmp_path: Path) -> None:
    EXAMPLES["noise"].make(tmp_path, 1)
    for path in tmp_path.iterdir():
        assert hashlib.sha256(path.read_bytes()).digest() == hashlib.sha256((made / "noise" / path.name).read_bytes()).digest()


def test_the_loggers_file_is_the_cold_run(made: Path) -> None:
    logged = rlg.read(made / "chamber/logger.csv", columns=LOGGER)
    cold = rlg.read(made / "chamber/cold.parquet")
    np.testing.assert_allclose(logged.rate_deg_h(), cold.rate_deg_h(), rtol=1e-6)
    np.testing.assert_allclose(logged["temperature_shell_degC"], cold["temperature_shell_degC"], atol=1e-5)  # K of nine digits


def test_two_loggers_merge(made: Path) -> None:
    from rlgcomp.recording.formats import read
    from rlgcomp.recording.merge import merge

    other = read(made / "chamber/thermometers.csv", gyro_required=False)
    merged = merge(rlg.read(made / "chamber/gyro.csv"), other)
    hot = rlg.read(made / "chamber/hot.parquet")
    shell = np.interp(merged.time_s, hot.time_s, hot["temperature_shell_degC"])
    np.testing.assert_allclose(merged["temperature_shell_degC"], shell, atol=0.1)  # K: five seconds of a ramp


def test_no_run_tells_what_is_concealed(made: Path) -> None:
    for path in (made / "chamber").glob("*.parquet"):
        run = rlg.read(path)
        assert run.truth is None
        assert not run.metadata.notes
    believed, true = (rlg.Simulator.from_yaml(made / "chamber" / name) for name in ("simulator.yaml", "truth.yaml"))
    assert {one.name for one in true.mechanisms} - {one.name for one in believed.mechanisms} == {"thermal_hysteresis"}


def test_pulses_hold_the_earths_rate(made: Path) -> None:
    run = rlg.read(made / "turntable/pulses-1.parquet", metadata={"pulse_arcsec": 0.0527})
    assert run.rate_deg_h().mean() == pytest.approx(15.041 * np.sin(np.deg2rad(28.2)), abs=0.05)
