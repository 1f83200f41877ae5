"""Streaming: sample by sample as all at once to the last bit, files that grow, interruption, restart."""

from __future__ import annotations

import itertools
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from typer.testing import CliRunner, Result

import rlgcomp as rlg
from rlgcomp.calibration.file import Calibration
from rlgcomp.cli import register_commands
from rlgcomp.cli.base import app
from rlgcomp.compensation.growing_files import agrees
from rlgcomp.compensation.models import MODELS
from rlgcomp.compensation.models.fixed_size import FixedSizeLSSVM
from rlgcomp.compensation.streaming import StreamCompensator, to_lines
from rlgcomp.errors import InputError
from rlgcomp.recording.formats.dialect import dialect_of

MONITORS = ("temperature_block_degC", "temperature_shell_degC", "light_intensity_V", "readout_a_V", "readout_b_V")
ESTIMATORS = {
    **{
        f"lssvm {kernel}": rlg.LSSVMRegressor(kernel, c=10.0, sigma=9.0)
        for kernel in ("gaussian", "linear", "polynomial", "sigmoid")
    },
    "fixed size": FixedSizeLSSVM(centres=30, c=10.0, sigma=9.0),
    "cubic": rlg.CubicLeastSquares(),
    "dynamic": rlg.CubicLeastSquares(linear="dynamics"),
    **{method: rlg.KernelBaselines(method, sigma=9.0) for method in ("kernel_ridge", "svr", "gaussian_process")},
}


@pytest.fixture(scope="module")
def compensators(short_runs: list[rlg.Recording]) -> dict[str, rlg.Compensator]:
    """Every model that answers sample by sample, fitted; its parameters are of no consequence here, so none are searched."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("rlgcomp.compensation.compensator.specification_of", lambda model: None)
        return {name: rlg.Compensator(estimator).fit(short_runs[:2]) for name, estimator in ESTIMATORS.items()}


def recording(seed: int, rows: int) -> rlg.Recording:
    """Irregular steps, gaps, monitors that jump, stand still and leave the training range."""
    rng = np.random.default_rng(seed)
    time_s = np.cumsum(rng.choice([0.01, 1.0, 5.0, 5.000001, 600.0], size=rows)) - rng.uniform(0.0, 1e6)
    walk = np.cumsum(rng.choice([0.0, 0.1, -0.1, 3.0, -3.0], size=(rows, len(MONITORS))), axis=0)
    monitors = np.array([20.0, 20.0, 1.0, 1.0, 1.0]) + walk * np.array([1.0, 1.0, 0.01, 0.01, 0.01])
    table = pd.DataFrame(dict(zip(MONITORS, monitors.T, strict=True)))
    return rlg.Recording(table.assign(time_s=time_s, gyro_deg_h=rng.standard_normal(rows)))


@settings(max_examples=15, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(seed=st.integers(0, 10**6), rows=st.integers(3, 90), cuts=st.lists(st.integers(0, 90), max_size=4))
@pytest.mark.parametrize("name", ESTIMATORS)
def test_any_pieces_give_the_bits_of_the_whole(
    compensators: dict[str, rlg.Compensator], name: str, seed: int, rows: int, cuts: list[int]
) -> None:
    model, run = compensators[name], recording(seed, rows)
    whole = model.predict(run)
    model.restart()
    assert pd.DataFrame([model.step(sample) for sample in run.table.to_dict("records")]).equals(whole)
    model.restart()
    edges = sorted({0, rows, *(cut for cut in cuts if cut < rows)})
    parts = [model.steps(run.table.iloc[a:b]) for a, b in itertools.pairwise(edges)]
    assert pd.concat(parts, ignore_index=True).equals(whole)


DARK = {"readout_a_V": 0.0, "readout_b_V": 0.0}
LARGE = {"temperature_block_degC": 1.7e308, "temperature_shell_degC": -1.7e308}


@pytest.mark.parametrize(
    "spoilt", [{"readout_a_V": np.nan}, {"readout_a_V": np.inf}, {"time_s": 40.0}, {"time_s": np.nan}, DARK, LARGE]
)
def test_a_sample_that_is_refused_leaves_no_trace(
    trained: rlg.Compensator, short_runs: list[rlg.Recording], spoilt: dict[str, float]
) -> None:
    samples = short_runs[2].table.iloc[:30].to_dict("records")
    trained.restart()
    expected = [trained.step(sample) for sample in samples]
    trained.restart()
    if spoilt in (DARK, LARGE):
        with pytest.raises(rlg.InputError, match="leave that sample out"):
            trained.step(samples[0] | spoilt)
    rows = [trained.step(sample) for sample in samples[:10]]
    with pytest.raises(rlg.InputError, match="sample"):
        trained.step(samples[10] | spoilt)
    assert rows + [trained.step(sample) for sample in samples[10:]] == expected


def test_every_model_of_the_package_is_tried_here() -> None:
    tried = {type(estimator) for estimator in ESTIMATORS.values()}
    assert {form.estimator for form in MODELS.values() if not getattr(form.estimator, "reads_sequences", False)} == tried


# --- lines ----------------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def model(short_runs: list[rlg.Recording]) -> rlg.Compensator:
    return rlg.Compensator(rlg.CubicLeastSquares(linear="dynamics")).fit(short_runs[:2])


@pytest.fixture(scope="module")
def csv(short_runs: list[rlg.Recording], tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("csv") / "run.csv"
    run = short_runs[2]
    rlg.write(run.replace(table=run.table.iloc[:300], truth=None, name="run"), path)
    return path


def fed(model: rlg.Compensator, lines: list[str], cuts: list[int], **settings_: object) -> tuple[list[str], StreamCompensator]:
    stream = StreamCompensator(model, lines[0], **settings_)
    edges = sorted({1, len(lines), *(cut for cut in cuts if 1 < cut < len(lines))})
    return [line for a, b in itertools.pairwise(edges) for line in to_lines(stream.feed(lines[a:b]))], stream


def whole(model: rlg.Compensator, path: Path) -> list[str]:
    rlg.write(model.correct(rlg.read(path)), path.with_name("whole.csv"))
    return path.with_name("whole.csv").read_text().splitlines()


def spoil(lines: list[str], seed: int) -> list[str]:
    """Missing monitors, dark readouts, missing gyro values, rows left out or doubled, absurd and textual entries: few of each."""
    rng = np.random.default_rng(seed)
    table = [line.split(",") for line in lines]
    for column in (2, 4):
        start, length = rng.integers(1, 250), rng.integers(1, 40)
        for row in table[start : start + length]:
            row[column] = ""
    table[rng.integers(1, 300)][1] = ""
    table[rng.integers(1, 300)][5] = "1e300"
    table[rng.integers(1, 300)][5] = "broken"
    start, length = rng.integers(1, 250), rng.integers(1, 40)
    for row in table[start : start + length]:
        row[-2:] = "0", "0"
    gone = rng.integers(1, 250)
    del table[gone : gone + rng.integers(0, 30)]
    place = rng.integers(1, len(table))
    table.insert(place, list(table[place]))
    return [",".join(row) for row in table]


@settings(max_examples=12, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(seed=st.integers(0, 10**6), cuts=st.lists(st.integers(1, 300), max_size=5))
def test_a_spoilt_stream_is_mended_as_the_whole_file_is(model: rlg.Compensator, csv: Path, seed: int, cuts: list[int]) -> None:
    lines = spoil(csv.read_text().splitlines(), seed)
    path = csv.with_name("spoilt.csv")
    path.write_text("\n".join(lines) + "\n")
    expected = whole(model, path)
    rows, stream = fed(model, lines, cuts)
    assert [",".join(stream.columns), *rows] == expected
    assert sum(stream.left_out.values()) == len(lines) - len(expected)


def test_lines_with_too_much_are_left_out(model: rlg.Compensator, csv: Path) -> None:
    lines = csv.read_text().splitlines()
    rows, _ = fed(model, lines, [])
    again, stream = fed(model, [*lines[:50], lines[50] + ",1", *lines[50:]], [20])
    assert again == rows
    assert dict(stream.left_out) == {"with more entries than columns": 1}


def test_between_blanks_a_line_with_too_little_is_left_out(model: rlg.Compensator, csv: Path) -> None:
    """It does not show which entry is empty."""
    lines = [line.replace(",", " ") for line in csv.read_text().splitlines()]
    stream = StreamCompensator(model, dialect_of(lines[:20]))
    without = to_lines(stream.feed([*lines[1:50], *lines[51:]]))
    stream = StreamCompensator(model, dialect_of(lines[:20]))
    assert to_lines(stream.feed([*lines[1:50], lines[50].rpartition(" ")[0], *lines[51:]])) == without
    assert dict(stream.left_out) == {"with fewer entries than columns": 1}


def test_pulses_names_and_a_calibration_of_ones_own(
    model: rlg.Compensator, short_runs: list[rlg.Recording], csv: Path, tmp_path: Path
) -> None:
    """Pulses without time stamps under the laboratory's names, calibrated: as the whole file gives."""
    run = short_runs[2].table.iloc[:300]
    calibration = Calibration(pulse_arcsec=0.5, bias_deg_h=0.25)
    table = run.drop(columns=["time_s", "gyro_deg_h"]).assign(N=np.round(1e4 * run["gyro_deg_h"]))
    table.rename(columns={"temperature_block_degC": "T"}).assign(T=run["temperature_block_degC"] + 273.15).to_csv(
        tmp_path / "raw.csv", index=False, float_format="%.17g"
    )
    mapping = {"gyro_pulses": "N", "temperature_block_degC": "T [K]"}
    read = rlg.read(tmp_path / "raw.csv", columns=mapping, metadata={"pulse_arcsec": 0.5}, period_s=5.0)
    expected = model.correct(calibration.apply(read))
    rows, stream = fed(
        model, (tmp_path / "raw.csv").read_text().splitlines(), [7, 100], mapping=mapping, period_s=5.0, calibration=calibration
    )
    assert stream.columns == expected.columns
    values = np.array([[float(part) for part in line.split(",")] for line in rows])
    assert values == pytest.approx(expected.table.to_numpy(), rel=1e-13)
    bias = stream.columns.index("compensation_deg_h")
    assert (values[:, bias] == expected.column("compensation_deg_h")).all()


@pytest.mark.parametrize(
    ("header", "message"),
    [
        ("a,b", "no column time_s"),
        ("time_s,gyro_deg_h", "which the model needs"),
        ("time_s," + ",".join(MONITORS), "no gyro column"),
        ("time_s,gyro_x_deg_h,gyro_y_deg_h," + ",".join(MONITORS), "the model corrects gyro_deg_h"),
        ("time_s,gyro_pulses," + ",".join(MONITORS), "give --pulse-arcsec and --period-s"),
    ],
)
def test_a_stream_that_cannot_be_used_is_refused_at_its_header(model: rlg.Compensator, header: str, message: str) -> None:
    with pytest.raises(rlg.InputError, match=message):
        StreamCompensator(model, header)


@pytest.mark.parametrize("period_s", [0.0, -1.0, np.nan, "soon"])
def test_a_sample_period_that_is_none_is_refused(model: rlg.Compensator, period_s: object) -> None:
    with pytest.raises(rlg.InputError, match="must be a positive number of seconds"):
        StreamCompensator(model, "gyro_deg_h," + ",".join(MONITORS), period_s=period_s)


def test_numbers_agree_or_not() -> None:
    assert agrees("1,2.0000000001", "1,2")
    for written in ("1,2.1", "1", "1,2,3", "1,x", "1,nan"):
        assert not agrees(written, "1,2")


# --- the command ----------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def saved(model: rlg.Compensator, tmp_path_factory: pytest.TempPathFactory) -> Path:
    register_commands()
    path = tmp_path_factory.mktemp("model") / "model"
    model.save(path)
    return path


def wait_for(condition: Callable[[], bool]) -> None:
    end = time.monotonic() + 60.0
    while not condition():
        assert time.monotonic() < end, "nothing came"
        time.sleep(0.05)


def started(saved: Path, source: str, out: Path | str, **options: object) -> subprocess.Popen[bytes]:
    code = "import sys; from rlgcomp.cli import main; sys.argv[0] = 'rlgcomp'; main()"
    command = [sys.executable, "-c", code, "compensate", str(saved), source, "--follow", "--out", str(out), "--json"]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, **options)


def followed_until(condition: Callable[[], bool], then: Callable[[], None], saved: Path, source: Path, out: Path) -> Result:
    """The command in this process, which imports nothing anew; once something holds, another thread does what ends it."""

    def end() -> None:
        wait_for(condition)
        then()

    arguments = ["compensate", str(saved), str(source), "--follow", "--idle-s", "90", "--out", str(out), "--json"]
    with ThreadPoolExecutor(1) as threads:
        ended = threads.submit(end)
        result = CliRunner().invoke(app, arguments)
        ended.result()
    return result


def lines_of(path: Path) -> list[str]:
    return path.read_text().splitlines() if path.exists() else []


def test_a_growing_file_interrupted_killed_and_resumed(saved: Path, model: rlg.Compensator, csv: Path, tmp_path: Path) -> None:
    lines, expected = csv.read_text().splitlines(), whole(model, csv)
    growing, out = tmp_path / "growing.csv", tmp_path / "out.csv"
    with growing.open("w", buffering=1) as stream:
        stream.write("\n".join(lines[:50]) + "\n" + lines[50][:30])
        first = started(saved, str(growing), out)
        wait_for(lambda: len(lines_of(out)) == 50)
        time.sleep(0.3)
        assert lines_of(out) == expected[:50]  # nothing for the line whose end is not there
        stream.write(lines[50][30:] + "\n")
        stream.flush()
        wait_for(lambda: len(lines_of(out)) == 51)
        first.send_signal(signal.SIGINT)
        output, errors = first.communicate(timeout=60)
        assert first.returncode == 130
        assert json.loads(output)["signal"] == signal.SIGINT
        assert b"goes on from here" in errors
        stream.write("\n".join(lines[51:100]) + "\n")
        stream.flush()

        second = started(saved, str(growing), out)
        wait_for(lambda: len(lines_of(out)) == 100)
        second.kill()
        second.communicate(timeout=60)
        with out.open("a") as torn:
            torn.write(expected[100][:20])  # as a machine that lost its power leaves it

        stream.write("\n".join(lines[100:]) + "\n")
        stream.flush()
        third = followed_until(
            lambda: len(lines_of(out)) == len(expected), lambda: os.kill(os.getpid(), signal.SIGTERM), saved, growing, out
        )
        assert third.exit_code == 143
        assert json.loads(third.stdout)["found_there"] == 99
    assert lines_of(out) == expected


def test_standard_input_line_by_line(saved: Path, model: rlg.Compensator, csv: Path) -> None:
    lines, expected = csv.read_text().splitlines(), whole(model, csv)
    process = started(saved, "-", "-", stdin=subprocess.PIPE)
    assert process.stdin is not None
    assert process.stdout is not None
    for k in range(20):
        process.stdin.write(f"{lines[k]}\n".encode())
        process.stdin.flush()
        assert process.stdout.readline().decode().strip() == expected[k]
    process.stdin.write(f"{lines[20]}\n{lines[21][:10]}".encode())
    rest, errors = process.communicate(timeout=60)
    assert process.returncode == 0
    assert rest.decode().splitlines() == expected[20:21]
    assert b"has no end and was left out" in errors


def follow(*arguments: object) -> tuple[int, str]:
    result = CliRunner().invoke(app, ["compensate", *map(str, arguments), "--follow", "--idle-s", "0"])
    assert "Traceback" not in result.output
    return result.exit_code, result.output


def test_an_output_that_is_not_its_own_is_left_untouched(
    saved: Path, csv: Path, short_runs: list[rlg.Recording], tmp_path: Path
) -> None:
    out, other = tmp_path / "out.csv", tmp_path / "other.csv"
    assert follow(saved, csv, "--out", out)[0] == 0
    before = out.read_bytes()
    rlg.write(short_runs[0].replace(truth=None), other)
    code, output = follow(saved, other, "--out", out)
    assert (code, out.read_bytes()) == (2, before)
    assert "differs from what this model computes from this input" in output
    (tmp_path / "thesis.csv").write_text("years of work")
    code, output = follow(saved, csv, "--out", tmp_path / "thesis.csv")
    assert (code, (tmp_path / "thesis.csv").read_text()) == (2, "years of work")
    assert "left untouched" in output


def test_a_simulator_file_is_not_written_over(saved: Path, csv: Path, tmp_path: Path) -> None:
    shutil.copy(csv, tmp_path / "run.csv")
    (tmp_path / "run.yaml").write_text("unit: S/N 3\n")
    (tmp_path / "gyro.yaml").write_text("kind: chamber\nmechanisms: [temperature_rate]\n")
    code, output = follow(saved, tmp_path / "run.csv", "--out", tmp_path / "gyro.csv")
    assert code == 2
    assert "is no recording's metadata that was written here: it holds mechanisms" in output
    assert not (tmp_path / "gyro.csv").exists()
    for _ in range(2):  # its own may be
        assert follow(saved, tmp_path / "run.csv", "--out", tmp_path / "out.csv")[0] == 0
        assert (tmp_path / "out.yaml").exists()


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("absent.csv", None, "does not exist"),
        ("run.parquet", b"PAR1", "reads plain CSV"),
        ("empty.csv", b"", "no line with the names"),
        ("bytes.csv", b"\xff\xfe\x00\x01\n", "not UTF-8"),
        ("long.csv", b"x" * (3 << 20), "has no end"),
    ],
)
def test_what_is_no_stream_is_refused(saved: Path, tmp_path: Path, name: str, content: bytes | None, message: str) -> None:
    if content is not None:
        (tmp_path / name).write_bytes(content)
    code, output = follow(saved, tmp_path / name, "--out", tmp_path / "out.csv")
    assert code == 2
    assert message in " ".join(output.split())
    assert not (tmp_path / "out.csv").exists()


def test_columns_beside_it_that_are_no_mapping_are_refused(saved: Path, csv: Path, tmp_path: Path) -> None:
    (tmp_path / "run.csv").write_bytes(csv.read_bytes())
    (tmp_path / "run.yaml").write_text("columns: [time_s, gyro_deg_h]\n")
    code, output = follow(saved, tmp_path / "run.csv", "--out", tmp_path / "out.csv")
    assert code == 2
    assert "run.yaml: columns is" in " ".join(output.split())
    assert "internal fault" not in output


def test_a_file_that_is_replaced_is_noticed(saved: Path, csv: Path, tmp_path: Path) -> None:
    growing = tmp_path / "growing.csv"
    growing.write_bytes(csv.read_bytes())
    out = tmp_path / "out.csv"
    ended = followed_until(lambda: len(lines_of(out)) == 301, lambda: os.truncate(growing, 10), saved, growing, out)
    assert ended.exit_code == 2
    assert "was replaced or cut" in " ".join(ended.stderr.split())


def test_a_row_far_ahead_is_believed_only_if_the_next_one_follows(compensators: dict[str, rlg.Compensator]) -> None:
    compensator = compensators["cubic"]
    whole = recording(7, 60).table.assign(time_s=np.arange(60.0))
    header, *lines = whole.to_csv(index=False).splitlines()
    wild = whole.assign(time_s=np.where(np.arange(60) == 20, 1e9, whole["time_s"])).to_csv(index=False).splitlines()[1:]
    gap = whole.assign(time_s=whole["time_s"] + np.where(np.arange(60) >= 20, 1e6, 0.0)).to_csv(index=False).splitlines()[1:]
    for chosen, rows in ((lines, 60), (wild, 59), (gap, 60)):
        for size in (1, 7, 60):
            stream = StreamCompensator(compensator, header)
            fed = [stream.feed(chosen[k : k + size]) for k in range(0, 60, size)]
            assert sum(map(len, fed)) == rows
            assert sum(stream.left_out.values()) == 60 - rows


# --- dialects ---------------------------------------------------------------------------------------------------------------


def german(lines: list[str], dates: bool) -> list[str]:
    """Lines with semicolons, decimal commas and, where asked for, dates as dd.mm.yyyy that begin shortly before midnight."""
    start, rows = pd.Timestamp("2021-01-20 23:59:00"), []
    for line in lines[1:]:
        time_s, *rest = line.split(",")
        moment = (
            (start + pd.Timedelta(seconds=float(time_s))).strftime("%d.%m.%Y %H:%M:%S.%f") if dates else time_s.replace(".", ",")
        )
        rows.append(";".join([moment, *(entry.replace(".", ",") for entry in rest)]))
    return [lines[0].replace(",", ";"), *rows]


@pytest.mark.parametrize("dates", [False, True])
@pytest.mark.parametrize("above", [[], ["# logger 7"], ["Recorder v2;7", ""]])
def test_a_growing_file_is_read_in_any_dialect(saved: Path, csv: Path, tmp_path: Path, dates: bool, above: list[str]) -> None:
    source, out, expected = tmp_path / "run.csv", tmp_path / "out.csv", tmp_path / "expected.csv"
    lines = csv.read_text().splitlines()
    assert follow(saved, csv, "--out", expected)[0] == 0
    source.write_text("\n".join([*above, *german(lines, dates)]) + "\n")
    code, output = follow(saved, source, "--out", out)
    assert (code, "decimal comma" in output) == (0, True)
    first, second = (pd.read_csv(path) for path in (expected, out))
    shift_s = 0.0 if not dates else first["time_s"][0]
    assert second["time_s"].to_numpy() == pytest.approx(first["time_s"].to_numpy() - shift_s, abs=1e-5)
    assert second["compensation_deg_h"].to_numpy() == pytest.approx(first["compensation_deg_h"].to_numpy(), rel=1e-6, abs=1e-9)


def test_dates_that_may_be_read_two_ways_and_rows_without_use_end_a_stream_with_2(saved: Path, csv: Path, tmp_path: Path) -> None:
    lines = csv.read_text().splitlines()
    source = tmp_path / "run.csv"
    for stamp, text in (("01/02/2021 08:00:00", "may begin with the day or with the month"), ("soon", "no row could be used")):
        source.write_text("\n".join([lines[0], *(f"{stamp},{line.partition(',')[2]}" for line in lines[1:50])]) + "\n")
        code, output = follow(saved, source, "--out", tmp_path / f"{len(text)}.csv")
        assert (code, text in " ".join(output.split())) == (2, True)


def test_numbers_without_sense_are_undone_as_far_as_earlier_lines_show_them(model: rlg.Compensator) -> None:
    """Temperatures below absolute zero, error values and overflows: a stream gives what it gives without them."""
    clean = recording(3, 400).table[["time_s", "gyro_deg_h", *MONITORS]]
    clean["time_s"] = np.arange(400.0)
    clean["temperature_block_degC"] = 20.0 + 5.0 * np.sin(np.arange(400.0) / 50.0)
    clean["light_intensity_V"] = 2.5 + 0.01 * np.sin(np.arange(400.0))
    spoilt, held = clean.copy(), clean.copy()
    spoilt.loc[[5, 100, 101], "temperature_block_degC"] = [-9999.0, -300.0, 850.0]
    spoilt.loc[200:210, "temperature_block_degC"] = -127.0
    spoilt.loc[300, "light_intensity_V"] = 999.9
    for column, rows in (("temperature_block_degC", [5, 100, 101, *range(200, 211)]), ("light_intensity_V", [300])):
        held.loc[rows, column] = np.nan
    found, expected = streamed(model, spoilt), streamed(model, held)
    pd.testing.assert_frame_equal(found[0], expected[0], check_exact=True)
    assert dict(found[1].changed) == {"impossible temperatures": 2, "error values of loggers": 13}
    assert not expected[1].changed


@pytest.mark.parametrize("modulus", [256.0, 65536.0])
def test_an_overflow_in_a_stream_runs_on(model: rlg.Compensator, modulus: float) -> None:
    clean = recording(3, 400).table[["time_s", "gyro_deg_h", *MONITORS]]
    clean["time_s"] = np.arange(400.0)
    clean["temperature_block_degC"] = 1.5 * np.cos(np.arange(400.0) / 50.0)
    spoilt = clean.assign(temperature_block_degC=clean["temperature_block_degC"] % modulus)
    found, expected = streamed(model, spoilt), streamed(model, clean)
    assert found[0]["gyro_deg_h"].to_numpy() == pytest.approx(expected[0]["gyro_deg_h"].to_numpy(), abs=1e-9)
    assert found[1].changed["overflows of counters"] == 3


def streamed(model: rlg.Compensator, table: pd.DataFrame) -> tuple[pd.DataFrame, StreamCompensator]:
    """What a stream gives of a table, in batches of 50 lines."""
    stream = StreamCompensator(model, ",".join(table.columns))
    lines = to_lines(table)
    return pd.concat([stream.feed(lines[first : first + 50]) for first in range(0, len(lines), 50)], ignore_index=True), stream


@pytest.mark.parametrize(
    ("changed", "mapping", "message"),
    [
        ({"time_s": lambda run: 45000.0 + run["time_s"] / 86400.0}, {}, r"--map time_s='time_s \[excel\]'"),
        ({"temperature_block_degC": lambda run: run["temperature_block_degC"] + 273.15}, {}, "temperature_block_degC.*kelvin"),
        ({}, {"temperature_block_degC": "temperature_block_degC [K]"}, "absolute zero"),
    ],
    ids=["days for seconds", "kelvin for degC", "degC for kelvin"],
)
def test_a_stream_in_other_units_is_refused_as_a_whole_file_is(
    model: rlg.Compensator,
    csv: Path,
    changed: dict[str, Callable[[pd.DataFrame], pd.Series]],
    mapping: dict[str, str],
    message: str,
) -> None:
    """Whether the lines come one by one or all at once, once there are twenty."""
    table = pd.read_csv(csv)[["time_s", "gyro_deg_h", *MONITORS]].head(60).assign(**changed)
    lines = to_lines(table)
    for size in (1, 20):
        stream = StreamCompensator(model, ",".join(table.columns), mapping=mapping)
        for first in range(0, 20 - size, size):
            stream.feed(lines[first : first + size])
        with pytest.raises(InputError, match=re.compile(message, re.DOTALL)):
            stream.feed(lines[20 - size : 20])


def test_what_the_name_of_a_mapped_column_states_is_said_of_a_stream(saved: Path, csv: Path, tmp_path: Path) -> None:
    source, out, expected = tmp_path / "run.csv", tmp_path / "out.csv", tmp_path / "expected.csv"
    assert follow(saved, csv, "--out", expected)[0] == 0
    table = pd.read_csv(csv)
    for name, factor, said in (("w", 1.0, "'w' states no unit that is known"), ("w_mdps", 1.0 / 3.6, "read in mdeg/s")):
        table.assign(gyro_deg_h=factor * table["gyro_deg_h"]).rename(columns={"gyro_deg_h": name}).to_csv(source, index=False)
        code, output = follow(saved, source, "--map", f"gyro_deg_h={name}", "--out", out)
        assert (code, output.count(said)) == (0, 1)
        first, second = (pd.read_csv(path)["gyro_deg_h"].to_numpy() for path in (expected, out))
        assert second == pytest.approx(first, rel=1e-6, abs=1e-9)
        out.unlink()
