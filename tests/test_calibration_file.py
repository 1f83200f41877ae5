"""The calibration file: applied to raw pulses, refused where it is damaged."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import rlgcomp as rlg
from rlgcomp.calibration.file import Calibration, triad_content, write_calibration
from rlgcomp.calibration.triad.estimate import TriadCalibration
from rlgcomp.numerics import frames
from rlgcomp.scratch import PUBLISHED
from tests import triads
from tests.triads import SHORT, SILENT


@pytest.fixture(scope="module")
def recordings() -> list[rlg.Recording]:
    return triads.recordings()


@pytest.fixture(scope="module")
def found() -> TriadCalibration:
    return triads.calibration()


def test_a_calibration_takes_the_errors_out_of_raw_pulses(
    tmp_path: Path, recordings: list[rlg.Recording], found: TriadCalibration
) -> None:
    write_calibration(tmp_path / "cal.json", triad_content(found, recordings, [], "0", "now"))
    calibration = Calibration.read(tmp_path / "cal.json")
    recording = dataclasses.replace(SILENT, gyro=found.errors).simulate(SHORT["step-3"])
    true = SILENT.simulate(SHORT["step-3"])
    clean = calibration.apply(recording)
    assert clean.gyro_columns == ("gyro_x_deg_h", "gyro_y_deg_h", "gyro_z_deg_h")
    expected = np.stack([true.rate_deg_h(f"gyro_{axis}_pulses") for axis in "xyz"], axis=1) @ frames.OBLIQUE_TO_BODY.T
    assert np.stack([clean.column(column) for column in clean.gyro_columns], axis=1) == pytest.approx(expected, abs=1e-4)
    with pytest.raises(rlg.InputError, match="calibrated already"):
        calibration.apply(clean)


def test_a_single_gyros_scale_factor_is_applied(tmp_path: Path) -> None:
    write_calibration(tmp_path / "k.json", {"schema": "rlgcomp.calibration/1", "kind": "gyro", "pulse_arcsec": 0.84279066})
    table = pd.DataFrame({"time_s": np.arange(10.0), "gyro_pulses": np.arange(10.0)})
    clean = Calibration.read(tmp_path / "k.json").apply(rlg.Recording(table, rlg.Metadata(kind="static")))
    assert clean.column("gyro_deg_h") == pytest.approx(0.84279066 * np.arange(10.0))


def test_a_calibration_whose_publication_was_killed_is_finished_by_its_reader(tmp_path: Path) -> None:
    content = {"schema": "rlgcomp.calibration/1", "kind": "gyro"}
    write_calibration(tmp_path / "k.json", {**content, "pulse_arcsec": 1.0})
    rest = tmp_path / f"{PUBLISHED}x"
    rest.mkdir()
    write_calibration(rest / "k.json", {**content, "pulse_arcsec": 2.0})
    assert Calibration.read(tmp_path / "k.json").content["pulse_arcsec"] == 2.0
    assert [path.name for path in tmp_path.iterdir()] == ["k.json"]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda c: c.update(schema="rlgcomp.calibration/9"), "this version reads"),
        (lambda c: c.update(kind="odd"), "allowed are gyro and triad"),
        (lambda c: c.update(gyro_axes="skew"), "allowed are oblique, orthogonal"),
        (lambda c: c["parameters"][0].update(value=None), "must be a number"),
        (lambda c: c["parameters"][0].update(value=1e300), "must be a number"),
        (lambda c: c["parameters"][0].update(parameter="odd"), "unknown 'odd'"),
        (lambda c: c.pop("parameters"), "requires"),
        (lambda c: c.update(pulse_arcsec="wide"), "must be a number"),
    ],
)
def test_a_hostile_calibration_file_is_refused(
    tmp_path: Path, recordings: list[rlg.Recording], found: TriadCalibration, change: object, message: str
) -> None:
    path = tmp_path / "cal.json"
    write_calibration(path, triad_content(found, recordings, [], "0", "now"))
    content = json.loads(path.read_text())
    change(content)
    path.write_text(json.dumps(content))
    with pytest.raises(rlg.InputError, match=message):
        Calibration.read(path)


@given(st.binary(max_size=200))
@settings(max_examples=40)
def test_no_bytes_make_a_traceback(tmp_path_factory: pytest.TempPathFactory, content: bytes) -> None:
    path = tmp_path_factory.mktemp("cal") / "cal.json"
    path.write_bytes(content)
    with pytest.raises(rlg.InputError):
        Calibration.read(path)
