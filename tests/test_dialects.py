"""Tables as loggers, spreadsheets and other programs write them: each is read as it is, and what was done is reported."""

from __future__ import annotations

import gzip
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from typer.testing import CliRunner

import rlgcomp as rlg
from rlgcomp.cli import app, register_commands
from rlgcomp.recording.formats import csv
from rlgcomp.recording.formats.dialect import dialect_of
from rlgcomp.recording.formats.mapping import sources_of
from tests.cases import by_code, case

ROWS = 300
GYRO = 1.0 + 0.5 * np.random.default_rng(1).standard_normal(ROWS)
BLOCK = 20.0 + 0.01 * np.arange(ROWS)


def written(path: Path, text: str) -> Path:
    path.write_bytes(gzip.compress(text.encode()) if path.suffix == ".gz" else text.encode())
    return path


def rows(separator: str, decimal: str = ".", time: Callable[[int], str] = lambda k: f"{k}", end: str = "") -> list[str]:
    numbers = zip(GYRO.tolist(), BLOCK.tolist(), strict=True)
    return [
        separator.join([time(k), f"{w:.6f}".replace(".", decimal), f"{T:.3f}".replace(".", decimal)]) + end
        for k, (w, T) in enumerate(numbers)
    ]


def expect(run: rlg.Recording) -> dict[str, object]:
    """The run holds the numbers; its findings by code."""
    assert run.time_s - run.time_s[0] == pytest.approx(np.arange(float(ROWS)), abs=1e-6)
    assert run.rate_deg_h() == pytest.approx(GYRO, abs=1e-6)
    assert run.column("temperature_block_degC") == pytest.approx(BLOCK, abs=1e-3)
    return by_code(run.findings)


NAMES = ["time_s", "gyro_deg_h", "temperature_block_degC"]
OWN = {"time_s": "t", "gyro_deg_h": "w", "temperature_block_degC": "T"}


@pytest.mark.parametrize("name", ["run.csv", "run.txt", "run.csv.gz", "run.dat"])
@pytest.mark.parametrize("separator", [",", ";", "\t", "|", " ", "   ", " ; "])
def test_separators(tmp_path: Path, separator: str, name: str) -> None:
    expect(rlg.read(written(tmp_path / name, "\n".join([separator.join(NAMES), *rows(separator)]) + "\n")))


def test_blanks_align_columns(tmp_path: Path) -> None:
    lines = [f"{k:8d} {w:14.6f}   {T:10.3f}" for k, (w, T) in enumerate(zip(GYRO, BLOCK, strict=True))]
    expect(rlg.read(written(tmp_path / "run.txt", "\r\n".join(["  " + "    ".join(NAMES), *lines]) + "\r\n")))


@pytest.mark.parametrize(
    "time",
    [
        lambda k: f"{20 + (k + 280) // 300:02d}.01.2021 {23 if k < 20 else 0:02d}:{(3580 + k) // 60 % 60:02d}:{(k + 40) % 60:02d}",
        lambda k: f"08:{k // 60:02d}:{k % 60:02d}.000",
        lambda k: f"2021-01-20 22:{k // 60:02d}:{k % 60:02d},250",
        lambda k: f"20.01.2021 22:{k // 60:02d}:{k % 60:02d},250",
    ],
)
@pytest.mark.parametrize("separator", [";", "\t"])
def test_dots_and_commas_of_times_are_no_decimal_signs(tmp_path: Path, separator: str, time: Callable[[int], str]) -> None:
    lines = rows(separator, ",", time)
    found = expect(rlg.read(written(tmp_path / "run.csv", "\n".join([separator.join(NAMES), *lines]) + "\n")))
    assert "decimal_comma" in found
    points = rows(separator, ".", time)
    assert "decimal_comma" not in expect(
        rlg.read(written(tmp_path / "run.csv", "\n".join([separator.join(NAMES), *points]) + "\n"))
    )


def test_a_decimal_comma_that_comes_late(tmp_path: Path) -> None:
    """Whole numbers alone in the first 400 lines: the column's own entries decide."""
    lines = [f"{k};{k % 7};20" if k < 9000 else f"{k};{k % 7},5;20,5" for k in range(12000)]
    run = rlg.read(written(tmp_path / "run.csv", "\n".join([";".join(NAMES), *lines]) + "\n"))
    assert run.rate_deg_h()[9000:9003] == pytest.approx([9000 % 7 + 0.5, 9001 % 7 + 0.5, 9002 % 7 + 0.5])
    assert "decimal_comma" in by_code(run.findings)


@pytest.mark.parametrize("mark", ["# ", "#", "% ", "%", "// ", "## "])
@pytest.mark.parametrize(("separator", "of_names"), [(",", ","), (" ", " "), ("\t", " "), (",", " ")])
def test_names_behind_a_mark(tmp_path: Path, mark: str, separator: str, of_names: str) -> None:
    text = f"# made by a logger\n{mark}{of_names.join(NAMES)}\n" + "\n".join(rows(separator)) + "\n"
    expect(rlg.read(written(tmp_path / "run.txt", text)))


@pytest.mark.parametrize("separator", [",", " ", "\t"])
def test_columns_without_names_are_mapped_by_place(tmp_path: Path, separator: str) -> None:
    path = written(tmp_path / "run.txt", "\n".join(rows(separator)) + "\n")
    with pytest.raises(rlg.InputError, match="name one by its place, as in --map gyro_z_deg_s=3"):
        rlg.read(path)
    assert "no_names" in expect(rlg.read(path, columns=dict(zip(NAMES, "123", strict=True))))
    with pytest.raises(rlg.InputError, match="no column '4' to map"):
        rlg.read(path, columns=dict(zip(NAMES, "124", strict=True)))


def test_words_among_the_numbers_make_the_first_row_no_names(tmp_path: Path) -> None:
    lines = [f"{line},OK" for line in rows(",")]
    expect(rlg.read(written(tmp_path / "run.csv", "\n".join(lines) + "\n"), columns=dict(zip(NAMES, "123", strict=True))))
    named = "\n".join(["%" + ",".join([*NAMES, "status"]), *lines]) + "\n"
    expect(rlg.read(written(tmp_path / "run.csv", named)))
    numbered = "\n".join([",".join([*NAMES, "4"]), *(f"{line},1" for line in rows(","))]) + "\n"
    expect(rlg.read(written(tmp_path / "run.csv", numbered)))


def test_places_count_where_there_are_names_too(tmp_path: Path) -> None:
    path = written(tmp_path / "run.csv", "\n".join(["t,w,T", *rows(",")]) + "\n")
    expect(rlg.read(path, columns=dict(zip(NAMES, ["1", "2 [deg/h]", "3 [degC]"], strict=True))))


@pytest.mark.parametrize(
    ("below", "count"),
    [(["s;°/h;°C"], 1), (["[s];(deg/h);[degC]", ";;"], 2), ([";;", "sec;deg/hr;Celsius"], 2), (["-;°/h;Deg C"], 1)],
)
def test_a_row_of_units_states_the_units(tmp_path: Path, below: list[str], count: int) -> None:
    found = expect(rlg.read(written(tmp_path / "run.csv", "\n".join(["t;w;T", *below, *rows(";", ",")]) + "\n"), columns=OWN))
    assert found["units_row"].message.data["rows"] == count
    assert list(found["units_row"].message.data["units"])[-2:] == ["w", "T"]


def test_units_of_a_row_convert_and_contradictions_are_refused(tmp_path: Path) -> None:
    lines = [f"{1000 * k};{w * 3600:.6f};{T + 273.15:.3f}" for k, (w, T) in enumerate(zip(GYRO, BLOCK, strict=True))]
    path = written(tmp_path / "run.csv", "\n".join(["t;w;T", "ms;arcsec/h;K".replace("arcsec/h", "°/h"), *lines]) + "\n")
    run = rlg.read(path, columns=OWN)
    assert run.time_s == pytest.approx(np.arange(float(ROWS)))
    assert run.column("temperature_block_degC") == pytest.approx(BLOCK, abs=2e-3)
    path = written(tmp_path / "run.csv", "\n".join([";".join(NAMES), "s;rad/s;°C", *rows(";")]) + "\n")
    with pytest.raises(rlg.InputError, match=r"in deg/h by its name and in rad/s by the row of units; state which is right"):
        rlg.read(path)
    expect(rlg.read(path, columns={"gyro_deg_h": "gyro_deg_h [deg/h]"}))


@pytest.mark.parametrize("separator", [",", ";", "\t", " "])
@pytest.mark.parametrize("every", [7, 100])
@pytest.mark.parametrize("units_row", [False, True])
def test_names_that_come_again_are_left_out(tmp_path: Path, separator: str, every: int, units_row: bool) -> None:
    top = [separator.join(NAMES), *([separator.join(["s", "deg/h", "degC"])] if units_row else [])]
    lines = rows(separator)
    blocks = [line for k in range(0, ROWS, every) for line in (*top, *lines[k : k + every])]
    found = expect(rlg.read(written(tmp_path / "run.csv", "\n".join(blocks) + "\n")))
    assert found["repeated_header"].message.data["rows"] == (len(range(0, ROWS, every)) - 1) * len(top)


LVM = """LabVIEW Measurement\t
Writer_Version\t2
Reader_Version\t2
Separator\tTab
Decimal_Separator\t{decimal}
Multi_Headings\tNo
X_Columns\t{x}
Time_Pref\tRelative
Date\t2024/03/11
***End_of_Header***\t
\t
Channels\t2\t\t
Samples\t300\t300\t
Y_Unit_Label\tdeg/h\tDeg C\t
X_Dimension\tTime\tTime\t
X0\t0{decimal}5\t0{decimal}5\t
Delta_X\t1{decimal}000000\t1{decimal}000000\t
***End_of_Header***\t\t\t
X_Value\tGyro\tBlock\tComment
"""


@pytest.mark.parametrize("decimal", [".", ","])
@pytest.mark.parametrize("x", ["One", "No"])
@pytest.mark.parametrize("name", ["run.lvm", "run.txt"])
def test_labview_measurements(tmp_path: Path, decimal: str, x: str, name: str) -> None:
    lines = rows("\t", decimal, (lambda k: f"{k}{decimal}000") if x == "One" else (lambda k: ""), "\t")
    text = LVM.format(decimal=decimal, x=x) + "\n".join(lines) + "\n"
    mapping = {"time_s": "X_Value", "gyro_deg_h": "Gyro", "temperature_block_degC": "Block"}
    run = rlg.read(written(tmp_path / name, text), columns=mapping)
    found = expect(run)
    assert run.time_s[0] == (0.0 if x == "One" else 0.5)
    assert found["units_row"].message.data["units"]["Block"] == "Deg C"


@pytest.mark.parametrize("sign", ["..", "x", ", ."])
def test_labview_measurements_of_another_decimal_sign_are_refused(tmp_path: Path, sign: str) -> None:
    text = LVM.format(decimal=".", x="One").replace("Decimal_Separator\t.", f"Decimal_Separator\t{sign}")
    path = written(tmp_path / "run.lvm", text + "\n".join(rows("\t", ".", str, "\t")) + "\n")
    with pytest.raises(rlg.InputError, match=r"run\.lvm.*Decimal_Separator is .*it may be '\.' or ','"):
        rlg.read(path, columns={"time_s": "X_Value", "gyro_deg_h": "Gyro"})


def test_rows_that_end_in_a_separator(tmp_path: Path) -> None:
    for separator, end in ((",", ","), (";", ";"), ("\t", "\t")):
        expect(rlg.read(written(tmp_path / "run.csv", "\n".join([separator.join(NAMES), *rows(separator, end=end)]) + "\n")))
    with pytest.raises(rlg.InputError, match="rows have 4 entries and 3 columns have names"):
        rlg.read(written(tmp_path / "run.csv", "\n".join([",".join(NAMES), *rows(",", end=",7")]) + "\n"))


def test_names_that_stand_twice(tmp_path: Path) -> None:
    lines = [f"{line},5" for line in rows(",")]
    with pytest.raises(rlg.InputError, match="column names appear twice: gyro_deg_h; rename one"):
        rlg.read(written(tmp_path / "run.csv", "\n".join(["time_s,gyro_deg_h,temperature_block_degC,gyro_deg_h", *lines]) + "\n"))
    path = written(tmp_path / "run.csv", "\n".join(["t,w,T,w", *lines]) + "\n")
    with pytest.raises(rlg.InputError, match=r"the columns are t, w.1, T, w.2"):
        rlg.read(path, columns=OWN)
    expect(rlg.read(path, columns=OWN | {"gyro_deg_h": "w.1"}))


def test_a_number_sign_in_a_name_is_no_remark(tmp_path: Path) -> None:
    path = written(tmp_path / "run.csv", "\n".join(["time_s,Gyro #1 [deg/h],T#2", *rows(",")]) + "\n")
    expect(rlg.read(path, columns={"gyro_deg_h": "Gyro #1", "temperature_block_degC": "T#2"}))


@pytest.mark.parametrize("source", ["w", "w [deg/h]", "2", "2 [deg/h]"])
@pytest.mark.parametrize(("bad", "severity"), [(2, "repaired"), (100, "refused")])
def test_words_among_numbers_are_reported_alike_with_and_without_a_unit(
    tmp_path: Path, source: str, bad: int, severity: str
) -> None:
    lines = [f"{k},{'OVERRANGE' if k < bad else f'{w:.6f}'},{T:.3f}" for k, (w, T) in enumerate(zip(GYRO, BLOCK, strict=True))]
    path = written(tmp_path / "run.csv", "\n".join(["t,w,T", *lines]) + "\n")
    try:
        findings = rlg.read(path, columns=OWN | {"gyro_deg_h": source}).findings
    except rlg.recording.repair.UnusableRecordingError as error:
        findings = error.findings
    (finding,) = [one for one in findings if one.message.code in ("recording.not_numbers", "recording.too_many_words")]
    assert (finding.severity, finding.row) == (severity, 0)
    assert (finding.message.data["entries"], finding.message.data["first"]) == (bad, "OVERRANGE")
    if severity == "refused":
        assert f"of {len(GYRO)} entries" in str(finding)
        assert f"{int(0.01 * len(GYRO))} are allowed" in str(finding)


# --- the language of maps ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("source", "unit", "factor", "offset"),
    [
        ("gz", None, 1.0, 0.0),
        ("gz [rad/s]", "rad/s", 1.0, 0.0),
        ("gz [0.00122 rad/s]", "rad/s", 0.00122, 0.0),
        ("gz [-1e-3 deg/s]", "deg/s", -1e-3, 0.0),
        ("gz [-deg/s]", "-deg/s", 1.0, 0.0),
        ("gz (0.1 degC) - 40", "degC", 0.1, -40.0),
        ("gz [K] + 1.5", "K", 1.0, 1.5),
        ("gz [degC]+2", "degC", 1.0, 2.0),
    ],
)
def test_sources_state_unit_factor_and_offset(source: str, unit: str | None, factor: float, offset: float) -> None:
    (found,) = sources_of(["t", "gz"], source, "file")
    assert found == ("gz", unit, factor, offset)


def test_names_of_the_file_come_before_the_language() -> None:
    columns = ["a + b", "T [0.1 degC] - 40", "4", "x", "%time", "Gyro Z [deg/s]"]
    for source in columns[:4]:
        assert sources_of(columns, source, "file", parts=True)[0].column == source
    assert sources_of(columns, "3", "file")[0].column == "4"
    assert sources_of(columns, "Gyro Z", "file")[0][:2] == ("Gyro Z [deg/s]", "deg/s")
    assert sources_of(["time"], "%time [ns]", "file")[0][:2] == ("time", "ns")
    for wrong in ("0", "9", "y", "Gyro"):
        with pytest.raises(rlg.InputError, match="to map; the columns are"):
            sources_of(columns, wrong, "file")


def test_factors_and_offsets_give_the_numbers(tmp_path: Path) -> None:
    counts = [f"{k},{round(w / 0.00122)},{round((T + 40) / 0.1)}" for k, (w, T) in enumerate(zip(GYRO, BLOCK, strict=True))]
    path = written(tmp_path / "run.csv", "\n".join(["t,gz,T", *counts]) + "\n")
    mapping = {"time_s": "t", "gyro_deg_h": "gz [0.00122 deg/h]", "temperature_block_degC": "T [0.1 degC] - 40"}
    run = rlg.read(path, columns=mapping)
    assert run.rate_deg_h() == pytest.approx(GYRO, abs=0.00062)
    assert run.column("temperature_block_degC") == pytest.approx(BLOCK, abs=0.051)
    with pytest.raises(rlg.InputError, match="unknown unit"):
        rlg.read(path, columns=mapping | {"gyro_deg_h": "gz [0.00122 furlong]"})


# --- commands ---------------------------------------------------------------------------------------------------------------


def test_a_file_without_time_is_read_by_every_command_that_maps(tmp_path: Path) -> None:
    register_commands()
    path = written(tmp_path / "run.csv", "\n".join(["w;T", *(line.partition(";")[2] for line in rows(";", ","))]) + "\n")
    maps = ["--map", "gyro_deg_h=w", "--map", "temperature_block_degC=T"]
    failed = CliRunner().invoke(app, ["inspect", str(path), *maps])
    assert failed.exit_code == 2
    assert "--period-s" in failed.output
    done = CliRunner().invoke(app, ["inspect", str(path), *maps, "--period-s", "0.5"])
    assert done.exit_code == 0
    assert "300 rows every 0.5 s" in done.output
    for name in (
        "train",
        "evaluate",
        "compensate",
        "diagnose",
        "predict",
        "calibrate",
        "scale-factor",
        "arw",
        "allan",
        "sensitivity",
    ):
        assert "--period-s" in CliRunner().invoke(app, [name, "--help"], env={"COLUMNS": "200"}).output, name


@settings(max_examples=300, deadline=None)
@given(st.text(alphabet=" \t,;|#%\"'.:-+eE0123456789aZ°\n", max_size=300))
def test_any_text_has_a_dialect_or_is_refused(text: str) -> None:
    lines = text.split("\n")
    written_as = dialect_of(lines)
    assert 0 <= written_as.first <= len(lines)
    try:
        table = csv.parse(lines[written_as.first :], written_as, "text")
    except (rlg.InputError, ValueError):
        return
    assert len(table) <= len(lines)


@pytest.mark.parametrize(
    ("name", "columns", "rows_read"),
    [
        ("09-header-behind-hash-or-none/euroc.csv", {"time_s": "timestamp", "gyro_z_deg_h": "w_RS_S_z"}, 1800),
        ("09-header-behind-hash-or-none/savetxt.txt", {}, 1800),
        ("09-header-behind-hash-or-none/savetxt_space.txt", {}, 1800),
        ("09-header-behind-hash-or-none/noheader.txt", {"time_s": "1", "gyro_z_deg_h": "3"}, 600),
        (
            "12-units-row-repeated-header-lvm/unitsrow.csv",
            {"time_s": "date", "gyro_deg_h": "gyro", "temperature_block_degC": "temp"},
            1800,
        ),
        ("12-units-row-repeated-header-lvm/headereach100.csv", {}, 1800),
        ("12-units-row-repeated-header-lvm/chamber.lvm", {"time_s": "X_Value", "gyro_deg_h": "Gyro"}, 1800),
        ("12-units-row-repeated-header-lvm/chamber_lvm.txt", {"time_s": "X_Value", "gyro_deg_h": "Gyro"}, 1800),
        ("20-trailing-comma/trail.csv", {}, 4000),
    ],
)
def test_shared_cases(name: str, columns: dict[str, str], rows_read: int) -> None:
    assert len(rlg.read(case(name), columns=columns)) == rows_read


def columns_of(width: tuple[int, int, int]) -> list[str]:
    return [
        "".join(f"{one:{w}.6f}" for one, w in zip(row, width, strict=True)) for row in zip(range(ROWS), GYRO, BLOCK, strict=True)
    ]


@pytest.mark.parametrize(
    "names",
    [
        "    TIME(S)    RATE(DEG/HR)       TEMP(DEG C)",  # one blank within a name, wide gaps between
        "     TIME S     RATE DEG/H        TEMP DEG C",
        "  Time (s) Gyro Z (deg/h) T block (degC)",  # over their columns alone
    ],
)
def test_names_with_blanks_belong_to_the_columns_below_them(tmp_path: Path, names: str) -> None:
    path = written(tmp_path / "run.dat", "\n".join([names, *columns_of((11, 16, 18))]) + "\n")
    expect(rlg.read(path, columns={"time_s": "1", "gyro_deg_h": "2 [deg/h]", "temperature_block_degC": "3 [degC]"}))


def test_more_names_than_columns_are_refused(tmp_path: Path) -> None:
    """Nobody knows which name is whose: the names may not shift."""
    for header, separator in (("time_s gyro_deg_h temp block degC", " "), ("time_s,sample,gyro_deg_h,temperature_block_degC", ",")):
        path = written(tmp_path / "run.txt", "\n".join(["A note.", header, *rows(separator)]) + "\n")
        with pytest.raises(rlg.InputError, match="its line of names has"):
            rlg.read(path)


@pytest.mark.parametrize("mark", ["; ", "! ", "* ", "-- "])
def test_names_behind_marks_of_other_programs(tmp_path: Path, mark: str) -> None:
    expect(rlg.read(written(tmp_path / "run.txt", "\n".join([mark + " ".join(NAMES), *rows(" ")]) + "\n")))


def test_the_line_of_excel_states_the_separator(tmp_path: Path) -> None:
    for line in ("sep=;", '"sep=;"', "SEP=;"):
        expect(rlg.read(written(tmp_path / "run.csv", "\r\n".join([line, ";".join(NAMES), *rows(";", ",")]) + "\r\n")))


@pytest.mark.parametrize("width", [4, 8])
def test_four_lines_of_campbell(tmp_path: Path, width: int) -> None:
    """TOA5: the logger, names, units and kinds, the logger's line as wide as the rows; NAN in quotes where nothing was read."""
    head = [
        '"TOA5","CR1000","CR1000","12345","CR1000.Std.32","CPU:gyro.CR1","1234","Table1"',
        '"TIMESTAMP","RECORD","Gyro","T"' + "".join(f',"V{k}"' for k in range(width - 4)),
        '"TS","RN","deg/h","Deg C"' + ',"Volts"' * (width - 4),
        '"","","Smp","Avg"' + ',"Smp"' * (width - 4),
    ]
    body = [
        f'"2024-03-11 14:{k // 60:02d}:{k % 60:02d}",{k},{w:.6f},{chr(34) + "NAN" + chr(34) if k == 7 else f"{T:.3f}"}'
        + ",0" * (width - 4)
        for k, (w, T) in enumerate(zip(GYRO, BLOCK, strict=True))
    ]
    path = written(tmp_path / "run.dat", "\r\n".join([*head, *body]) + "\r\n")
    run = rlg.read(path, columns={"time_s": "TIMESTAMP", "gyro_deg_h": "Gyro", "temperature_block_degC": "T"})
    assert run.rate_deg_h() == pytest.approx(GYRO, abs=1e-6)
    found = by_code(run.findings)
    assert found["units_row"].message.data["units"]["Gyro"] == "deg/h"
    assert "Avg" in found["units_row"].message.data["other"]
    assert found["missing_values"].message.data["held"] == 1


@pytest.mark.parametrize(
    ("separator", "number", "first"),
    [
        (",", lambda value: f'"{value:,.1f}"', "1,000.0"),
        (";", lambda value: f"{value:,.1f}".replace(",", "~").replace(".", ",").replace("~", "."), "1.000,0"),
        (";", lambda value: f"{value:,.1f}".replace(",", "'"), "1'000.0"),
        ("\t", lambda value: f"{value:,.1f}".replace(",", "\u202f").replace(".", ","), "1\u202f000,0"),
    ],
)
def test_signs_between_thousands(tmp_path: Path, separator: str, number: Callable[[float], str], first: str) -> None:
    pressure = 995.0 + np.arange(ROWS)
    lines = [
        f"{k}{separator}{number(w)}{separator}{number(p)}"
        for k, (w, p) in enumerate(zip(np.round(1e3 * GYRO, 1), pressure, strict=True))
    ]
    run = rlg.read(
        written(tmp_path / "run.csv", "\n".join([separator.join(["time_s", "gyro_deg_h", "pressure_hPa"]), *lines]) + "\n")
    )
    assert run.column("pressure_hPa") == pytest.approx(pressure)
    assert run.rate_deg_h() == pytest.approx(1e3 * GYRO, abs=0.051)
    assert any(f.column == "pressure_hPa" and f.message.data.get("written") == first for f in run.findings)


def test_a_month_behind_a_dot_and_units_in_capitals(tmp_path: Path) -> None:
    lines = rows(";", ",", time=lambda k: f"11. März 2024 14:{k // 60:02d}:{k % 60:02d}")
    path = written(tmp_path / "run.csv", "\n".join(["t;Rate [DEG/H];T [DEG C]", *lines]) + "\n")
    expect(rlg.read(path, columns={"time_s": "t", "gyro_deg_h": "Rate", "temperature_block_degC": "T"}))


def test_few_words_among_a_monitors_numbers_are_missing_values(tmp_path: Path) -> None:
    texts = [f"{k},{w:.6f},{'OVERRANGE' if k % 30 == 5 else f'{T:.3f}'}" for k, (w, T) in enumerate(zip(GYRO, BLOCK, strict=True))]
    found = by_code(rlg.read(written(tmp_path / "run.csv", "\n".join([",".join(NAMES), *texts]) + "\n")).findings)
    assert found["not_numbers"].message.data == {"entries": 10, "first": "OVERRANGE"}


def test_a_text_without_a_table_is_refused(tmp_path: Path) -> None:
    for text in ("T=1.0 G=2.0\n" * 20, "%A,1,2\n" * 20, "a word\nanother word\nand a third\nand more\n"):
        with pytest.raises(rlg.InputError, match="no line has numbers"):
            rlg.read(written(tmp_path / "run.txt", text))


def test_advice_names_the_files_own_column(tmp_path: Path) -> None:
    path = written(
        tmp_path / "run.csv",
        "clock,w,T1\n"
        + "".join(
            f"{1700000000000 + 1000 * k},{w:.6f},{T + 273.15:.3f}\n" for k, (w, T) in enumerate(zip(GYRO, BLOCK, strict=True))
        ),
    )
    own = {"time_s": "clock", "gyro_deg_h": "w", "temperature_block_degC": "T1"}
    with pytest.raises(rlg.InputError, match=r"--map time_s='clock \[ms\]'"):
        rlg.read(path, columns=own)
    with pytest.raises(rlg.InputError, match=r"--map temperature_block_degC='T1 \[K\]'"):
        rlg.read(path, columns=own | {"time_s": "clock [ms]"})
    expect(rlg.read(path, columns=own | {"time_s": "clock [ms]", "temperature_block_degC": "T1 [K]"}))


@pytest.mark.parametrize("x", ["One", "No"])
@pytest.mark.parametrize("decimal", [".", ","])
@pytest.mark.parametrize("restart", [False, True])
def test_labview_with_several_headings(tmp_path: Path, restart: bool, decimal: str, x: str) -> None:
    """Each of three segments has a header; where their times begin again, the dates of the headers place them."""
    lines = [
        LVM.format(decimal=decimal, x=x).replace("Multi_Headings\tNo", "Multi_Headings\tYes").split("Channels")[0].rstrip("\n")
    ]
    for first in range(0, ROWS, 100):
        began = f"14:{37 + first // 60}:{first % 60:02d}{decimal}250"
        at = 0 if restart else first
        lines += ["Channels\t2\t\t", "Samples\t100\t100\t", "Date\t2024/03/11\t2024/03/11\t", f"Time\t{began}\t{began}\t"]
        lines += ["Y_Unit_Label\tdeg/h\tDeg C\t", "X_Dimension\tTime\tTime\t", f"X0\t{at}{decimal}0\t{at}{decimal}0\t"]
        lines += [f"Delta_X\t1{decimal}000000\t1{decimal}000000\t", "***End_of_Header***\t\t\t", "X_Value\tGyro\tBlock\tComment"]
        stamp = (lambda k, at=at, first=first: f"{at + k - first}{decimal}000") if x == "One" else (lambda k: "")
        lines += [*rows("\t", decimal, stamp, "\t")[first : first + 100], ""]
    mapping = {"time_s": "X_Value", "gyro_deg_h": "Gyro", "temperature_block_degC": "Block"}
    found = expect(rlg.read(written(tmp_path / "run.lvm", "\n".join(lines) + "\n"), columns=mapping))
    assert found["repeated_header"].message.data["rows"] == 2 * 10
    assert ("segments" in found) == restart


def test_segments_without_dates_that_begin_again_are_refused(tmp_path: Path) -> None:
    head = LVM.format(decimal=".", x="One").replace("Multi_Headings\tNo", "Multi_Headings\tYes")
    again = "Channels\t2\t\nX0\t0.0\t0.0\t\n***End_of_Header***\t\t\nX_Value\tGyro\tBlock\tComment\n"
    text = head + "\n".join(rows("\t", end="\t")) + "\n" + again + "\n".join(rows("\t", end="\t")) + "\n"
    with pytest.raises(rlg.InputError, match="2 segments whose times begin again, and not all of their headers have a date"):
        rlg.read(written(tmp_path / "run.lvm", text), columns={"time_s": "X_Value", "gyro_deg_h": "Gyro"})


@pytest.mark.parametrize("name", ["run.csv", "run.csv.gz"])
def test_a_line_of_names_may_be_long(tmp_path: Path, name: str) -> None:
    """More than the bytes that show how a file is written: no column of thousands is lost."""
    more = [f"strain_gauge_{k}_of_the_left_hand_side_V" for k in range(2000)]
    lines = [",".join(["time_s", "gyro_deg_h", "temperature_block_degC", *more])]
    lines += [",".join([row, *(f"{k % 7}" for k in range(2000))]) for row in rows(",")[:20]]
    assert len(lines[0]) > 1 << 16
    table = rlg.read(written(tmp_path / name, "\n".join(lines) + "\n")).table
    assert list(table.columns[:3]) == ["time_s", "gyro_deg_h", "temperature_block_degC"]
    assert set(more) <= set(table.columns)


def test_entries_without_a_name_are_never_dropped(tmp_path: Path) -> None:
    """Rows with one entry more than the names, which pandas would cut with a warning, are refused."""
    lines = ["time_s,gyro_deg_h,temperature_block_degC", *rows(",")]
    dialect = csv.names_and_dialect(written(tmp_path / "good.csv", "\n".join(lines) + "\n"))[1]
    wide = [f"{line},7" for line in lines[1:]]
    with pytest.raises(rlg.InputError, match="more entries than there are names"):
        csv.parse(wide, dialect, "stream")


@pytest.mark.parametrize("minus", ["\u2212", "\u2013"])
@pytest.mark.parametrize(("separator", "decimal"), [(";", ","), (",", "."), ("\t", ".")])
def test_typeset_minus_signs_are_read(tmp_path: Path, separator: str, decimal: str, minus: str) -> None:
    lines = [line.replace("-", minus) for line in rows(separator, decimal)]
    assert any(minus in line for line in lines)
    path = written(tmp_path / "run.csv", "\n".join([separator.join(["t", "w", "T"]), *lines]) + "\n")
    expect(rlg.read(path, columns=OWN))


@pytest.mark.parametrize("separator", [",", ";", "\t"])
def test_units_in_the_cells_are_named_as_the_cause(tmp_path: Path, separator: str) -> None:
    lines = [f"{k}.0 s{separator}{w:.4f} deg/h" for k, w in enumerate(GYRO)]
    path = written(tmp_path / "run.csv", "\n".join([f"time{separator}rate", *lines]) + "\n")
    with pytest.raises(rlg.InputError, match=r"cells hold units beside their numbers, the first '0\.0 s'; write numbers alone"):
        rlg.read(path)


# --- separators, empty cells, units -----------------------------------------------------------------------------------------

FIXED = "fixed width"


@pytest.mark.parametrize("till", [0, 10_000])
def test_a_column_that_begins_empty_is_a_column(tmp_path: Path, till: int) -> None:
    """Tabs before blanks: an empty cell does not move its neighbours, nor names."""
    count = max(ROWS, till + 5)
    lines = [f"{k}\t{'' if till == 0 or k < till else k}\t{k % 7}.5\t{20 + k % 5}.25" for k in range(count)]
    read = csv.load(written(tmp_path / "run.txt", "\n".join(["time_s\tutc\tgyro_deg_h\tT [degC]", *lines]) + "\n")).table
    assert list(read.columns) == ["time_s", "utc", "gyro_deg_h", "T [degC]"]
    assert read["utc"].notna().sum() == (5 if till else 0)
    assert read["gyro_deg_h"].tolist() == [k % 7 + 0.5 for k in range(count)]


def test_an_empty_cell_between_blanks_is_refused(tmp_path: Path) -> None:
    lines = rows(" ")
    lines[7] = lines[7].rpartition(" ")[0]
    with pytest.raises(rlg.InputError, match="line 9 has 2 entries and there are 3 columns; blanks do not show which is empty"):
        rlg.read(written(tmp_path / "run.txt", "\n".join([" ".join(NAMES), *lines]) + "\n"))
    lines[7:] = [lines[7]]  # the last line may be cut
    assert len(rlg.read(written(tmp_path / "run.txt", "\n".join([" ".join(NAMES), *lines]) + "\n"))) == 8


@pytest.mark.parametrize("names", ["t;w;;T;", "t;w;w;T;T"])
def test_units_are_those_of_the_columns_whatever_their_names(tmp_path: Path, names: str) -> None:
    """Merged titles leave names empty; a title may stand twice."""
    lines = [
        f"{k};{w / 3600:.9f};{2 * w / 3600:.9f};{T:.3f};{1.8 * T + 32:.3f}"
        for k, (w, T) in enumerate(zip(GYRO, BLOCK, strict=True))
    ]
    path = written(tmp_path / "run.csv", "\n".join([names, "s;°/s;°/s;°C;°F", *lines]) + "\n")
    mapping = {
        "time_s": "t",
        "gyro_x_deg_h": "2",
        "gyro_z_deg_h": "3",
        "temperature_block_degC": "4",
        "temperature_shell_degC": "5",
    }
    run = rlg.read(path, columns=mapping)
    assert run.column("gyro_z_deg_h") == pytest.approx(2.0 * GYRO, abs=1e-5)
    assert run.column("temperature_shell_degC") == pytest.approx(BLOCK, abs=2e-3)


def test_remarks_behind_stars_above_numbers_without_names(tmp_path: Path) -> None:
    head = ["* UNIT  RLG17", "* SF  1.113 ARCSEC/COUNT", "* RATE  1 HZ", "* COLUMNS   TIME  RATE(DEG/H)  TEMP(DEGC)"]
    path = written(tmp_path / "run.dat", "\n".join([*head, *rows("   ")]) + "\n")
    assert "no_names" in expect(rlg.read(path, columns=dict(zip(NAMES, "123", strict=True))))


@pytest.mark.parametrize("separator", [",", ";", "\t"])
@pytest.mark.parametrize("every", [0, 20])
def test_numbers_above_the_names_are_left_out_by_name(tmp_path: Path, separator: str, every: int) -> None:
    matrix = ["Device,RLG17,", "Cal matrix,,", "1.001,0.002,0.0001", "0.0002,0.999,0.0003", "Sample rate,1,Hz"]
    head, body = [line.replace(",", separator) for line in matrix], rows(separator)
    again = [line for k in range(0, ROWS, every or ROWS) for line in (separator.join(NAMES), *body[k : k + (every or ROWS)])]
    found = expect(rlg.read(written(tmp_path / "run.csv", "\n".join([*head, *again]) + "\n")))
    assert found["numbers_above_names"].message.data == {"rows": 3, "first": head[2]}


def test_words_alone_within_the_numbers_name_nothing(tmp_path: Path) -> None:
    """Counters in hexadecimal digits: a row of them without a decimal one is no line of names."""
    lines = [f"{k:04d},{w:.6f},{T:.3f}" for k, (w, T) in enumerate(zip(GYRO, BLOCK, strict=True))]
    lines[3] = "0A0C,0B0D,0FFE"
    assert list(csv.load(written(tmp_path / "run.csv", "\n".join([",".join(NAMES), *lines]) + "\n")).table.columns) == NAMES


@st.composite
def tables(draw: st.DrawFn) -> tuple[str, str, list[str], list[str], np.ndarray]:
    """A table written with any separator, columns and cells empty at random, with or without a row of units and a preamble."""
    separator = draw(st.sampled_from([",", ";", "\t", "|", " ", FIXED]))
    width, length = draw(st.integers(2, 6)), draw(st.integers(4, 70))
    names = draw(st.permutations(["time_s", "gyro_deg_h", "temperature_block_degC", "note", "GNSS_velocity_north", "q"]))[:width]
    units = draw(st.sampled_from([[], ["s", "deg/s", "degF", "K", "V", "rad/s"][:width]]))
    numbers = np.round(np.random.default_rng(draw(st.integers(0, 1000))).normal(20.0, 40.0, (length, width)), 4)
    numbers[:, 0] = np.arange(length) * draw(st.sampled_from([1.0, 0.1, 1e7]))
    if separator != " ":
        numbers[:, draw(st.lists(st.integers(0, width - 1), max_size=width - 2, unique=True))] = np.nan
        for row, column in draw(st.lists(st.tuples(st.integers(0, length - 1), st.integers(1, width - 1)), max_size=4)):
            numbers[row, column] = np.nan
    decimal = draw(st.sampled_from(".,")) if separator != "," else "."
    cells = [["" if np.isnan(one) else f"{one:.4f}".replace(".", decimal) for one in row] for row in numbers]
    sign, size = (" ", 24) if separator == FIXED else (separator, 0)
    lines = [sign.join(f"{one:>{size}}" if size else one for one in row) for row in ([names, units] if units else [names])]
    lines += [sign.join(f"{one:>{size}}" if size else one for one in row) for row in cells]
    return "\n".join(lines) + "\n", separator, list(names), units, numbers


@settings(max_examples=200, deadline=None)
@given(
    table=tables(),
    note=st.sampled_from(["", "# a remark\n", "* RATE 200 HZ\n* COLUMNS below\n", "Device one on the bench in the cellar\n"]),
)
def test_any_table_reads_back_under_its_own_names_or_is_refused(
    tmp_path_factory: pytest.TempPathFactory, table: tuple[str, str, list[str], list[str], np.ndarray], note: str
) -> None:
    text, separator, names, units, numbers = table
    path = written(tmp_path_factory.mktemp("any") / "run.txt", note + text)
    try:
        read = csv.load(path)
    except rlg.InputError:
        assert separator == FIXED, text  # an empty column of fixed width: which name is whose?
        return
    if separator == FIXED and list(read.table.columns) != names:
        assert not set(read.table.columns) & {"time_s", "gyro_deg_h", "temperature_block_degC"}
        return
    assert list(read.table.columns) == names
    values = read.table.to_numpy(dtype=np.float64)
    values, numbers = (rows[~np.isnan(rows).all(axis=1)] for rows in (values, numbers))
    assert np.allclose(values, numbers, rtol=1e-12, atol=1e-12, equal_nan=True)
    assert dict(read.units) == dict(zip(names, units, strict=False))
