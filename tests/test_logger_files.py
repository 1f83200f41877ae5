"""Files as loggers and laboratories write them, each with known content: read as meant, or refused with what to do."""

from __future__ import annotations

import datetime
from pathlib import Path

import h5py
import numpy as np
import pandas as pd
import pytest

import rlgcomp as rlg
from rlgcomp.recording import Finding
from rlgcomp.recording.formats.pieces import read_pieces
from tests.cases import by_code

ROWS = 200
TIME = np.arange(float(ROWS))
GYRO = np.round(9.0 + 0.5 * np.random.default_rng(7).standard_normal(ROWS), 5)
BLOCK = np.round(20.0 + 6.0 * TIME / ROWS + 0.3 * np.sin(TIME / 30.0), 3)
NAMES = ("t [s]", "w [deg/h]", "T [degC]")
OWN = {"time_s": "t [s]", "gyro_deg_h": "w [deg/h]", "temperature_block_degC": "T [degC]"}


def digits(values: np.ndarray, count: int = 5, comma: bool = False) -> list[str]:
    return [f"{value:.{count}f}".replace(".", "," if comma else ".") for value in values.tolist()]


def text(*columns: list[str], names: tuple[str, ...] = NAMES, separator: str = ";") -> str:
    return "".join(f"{separator.join(row)}\n" for row in [names, *zip(*columns, strict=True)])


def plain() -> str:
    return text(digits(TIME, 1), digits(GYRO), digits(BLOCK, 3))


def read(tmp_path: Path, content: str | bytes, name: str = "run.csv", **how: object) -> rlg.Recording:
    path = tmp_path / name
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return rlg.read(path, **{"columns": OWN, **how})


def expect(run: rlg.Recording, rows: slice | np.ndarray = slice(None)) -> dict[str, Finding]:
    """The run holds those rows of the known numbers; its findings by code."""
    assert run.time_s - run.time_s[0] == pytest.approx(TIME[rows] - TIME[rows][0], abs=1e-4)
    assert run.rate_deg_h() == pytest.approx(GYRO[rows], abs=1e-4)
    assert run.column("temperature_block_degC") == pytest.approx(BLOCK[rows], abs=2e-3)
    return by_code(run.findings)


# --- signs within entries ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("word", ["1.#QNAN", "-1.#IND", "-1.#IND00", "1.#QNAN0", "#N/A", "nan"])
def test_what_windows_writes_for_no_number_is_missing(tmp_path: Path, word: str) -> None:
    gyro = digits(GYRO)
    gyro[50] = word
    run = read(tmp_path, text(digits(TIME), gyro, digits(BLOCK)))
    assert "missing_gyro_values" in expect(run, np.arange(ROWS) != 50)


def test_a_number_sign_within_an_entry_is_no_remark(tmp_path: Path) -> None:
    events = ["step #3" if k == 70 else "" if k % 2 else "#" for k in range(ROWS)]
    content = text(digits(TIME), events, digits(GYRO), digits(BLOCK), names=(NAMES[0], "event", *NAMES[1:]))
    lines = content.splitlines()
    lines[20:20] = ["# the heater is on", "  # and hot"]
    lines[30] += " # a remark behind the numbers"
    lines[31] += ";# one behind the last separator"
    expect(read(tmp_path, "\n".join(lines) + "\n"))
    pieces = read_pieces(tmp_path / "run.csv", "gyro_deg_h", columns=OWN)
    assert pd.concat([piece.table for piece in pieces])["gyro_deg_h"].to_numpy() == pytest.approx(GYRO)


@pytest.mark.parametrize("kept", [1, 3])
def test_a_last_line_that_ends_within_a_number_is_left_out(tmp_path: Path, kept: int) -> None:
    content = plain().rstrip()
    run = read(tmp_path, content[: len(content) - 6 + kept])
    assert "cut_line" in expect(run, slice(ROWS - 1))
    *_, last = read_pieces(tmp_path / "run.csv", "gyro_deg_h", columns=OWN)
    assert last.time_s[-1] == TIME[-2]
    assert "cut_line" not in expect(read(tmp_path, content))


def test_points_between_thousands_beside_decimal_commas(tmp_path: Path) -> None:
    time_ms = [f"{round(1000 * value):,}".replace(",", ".") for value in TIME.tolist()]
    content = text(time_ms, digits(GYRO, comma=True), digits(BLOCK, comma=True), names=("t [ms]", *NAMES[1:]))
    found = expect(read(tmp_path, content, columns=OWN | {"time_s": "t [ms]"}))
    assert {"thousands", "decimal_comma"} <= found.keys()


@pytest.mark.parametrize("sign", [".", ","])
def test_a_column_that_increases_shows_signs_between_thousands(tmp_path: Path, sign: str) -> None:
    """980, 990, 1.000: nothing else in the file shows a decimal sign."""
    columns = [[f"{round(count):,}".replace(",", sign) for count in counts] for counts in (1e1 * TIME, 1e3 * GYRO, 1e3 * BLOCK)]
    names = ("t [0.1 s]", "w [0.001 deg/h]", "T [0.001 degC]")
    run = read(tmp_path, text(*columns, names=names), columns=dict(zip(OWN, names, strict=True)))
    assert run.time_s == pytest.approx(TIME)
    assert run.rate_deg_h() == pytest.approx(GYRO, abs=1e-3)
    assert run.column("temperature_block_degC") == pytest.approx(BLOCK, abs=1e-3)
    assert "thousands" in by_code(run.findings)


def test_what_may_be_thousands_is_said(tmp_path: Path) -> None:
    content = text([f"{k}.000" if k else "0" for k in range(ROWS)], digits(GYRO, 3), digits(BLOCK, 3))
    assert "perhaps_thousands" in expect_coarse(read(tmp_path, content))


def expect_coarse(run: rlg.Recording) -> dict[str, Finding]:
    assert run.rate_deg_h() == pytest.approx(GYRO, abs=1e-3)
    return by_code(run.findings)


def test_decimal_commas_in_quotes_between_commas(tmp_path: Path) -> None:
    quoted = [[f'"{entry}"' for entry in digits(values, comma=True)] for values in (TIME, GYRO, BLOCK)]
    assert "decimal_comma" in expect(read(tmp_path, text(*quoted, separator=",")))


@pytest.mark.parametrize("style", ["sign and blanks", "D for E"])
def test_numbers_of_recorders_and_of_fortran(tmp_path: Path, style: str) -> None:
    def spelt(values: np.ndarray) -> list[str]:
        blanks = [f"{'-' if value < 0 else '+'}{abs(value):9.5f}" for value in values.tolist()]
        return blanks if style == "sign and blanks" else [f"{value:.7E}".replace("E", "D") for value in values.tolist()]

    expect(read(tmp_path, text(digits(TIME), spelt(GYRO), spelt(BLOCK), separator=",")))


def test_hexadecimal_counts(tmp_path: Path) -> None:
    counts = [f"0x{round(1000 * value) & 0xFFFF:04X}" for value in (GYRO - 9.0).tolist()]
    columns = OWN | {"gyro_deg_h": "N [0.001 deg/h]"}
    run = read(tmp_path, text(digits(TIME), counts, digits(BLOCK), names=(NAMES[0], "N", NAMES[2])), columns=columns)
    assert run.rate_deg_h() == pytest.approx(GYRO - 9.0, abs=1e-3)
    assert {"hexadecimal", "counter_overflow"} <= by_code(run.findings).keys()


# --- units ------------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("header", "in_deg_h"),
    [
        ("Скорость [град/ч]", 1.0),
        ("ω_z, °/с", 3600.0),
        ("角速度(度/小时)", 1.0),
        ("角速度[度/秒]", 3600.0),
        ("Vitesse (degrés/heure)", 1.0),
        ("Velocidad (grados/hora)", 1.0),
        ("Drehrate in Grad pro Stunde", 1.0),
        ("wz [ERU]", 15.041067),
        ("wz_meru", 0.015041067),
        ("wz [0.1 deg/h]", 0.1),
        ("wz [1/10 deg/h]", 0.1),
        ("Rate, deg/h (S/N: 10123, cable 4)", 1.0),
    ],
)
def test_units_of_a_gyro_in_the_words_of_laboratories(tmp_path: Path, header: str, in_deg_h: float) -> None:
    content = text(digits(TIME), digits(GYRO / in_deg_h, 9), digits(BLOCK), names=(NAMES[0], header, NAMES[2]))
    expect(read(tmp_path, content, columns=OWN | {"gyro_deg_h": header}))


@pytest.mark.parametrize(
    ("header", "values"),
    [
        ("T [°С]", BLOCK),  # a Cyrillic letter
        ("T [degK]", BLOCK + 273.15),
        ("T [K] (filtered)", BLOCK + 273.15),
        ("温度(摄氏度)", BLOCK),
        ("Temp, °F (LGR S/N: 10123, SEN S/N: 10124)", 1.8 * BLOCK + 32.0),
        ("Temperature (degrees Celsius)", BLOCK),
    ],
)
def test_units_of_a_thermometer_in_the_words_of_laboratories(tmp_path: Path, header: str, values: np.ndarray) -> None:
    content = text(digits(TIME), digits(GYRO), digits(values), names=(*NAMES[:2], header))
    expect(read(tmp_path, content, columns=OWN | {"temperature_block_degC": header}))


@pytest.mark.parametrize("name", ["Temp_F", "TempF", "Block Temp F"])
def test_a_letter_that_may_be_a_unit_or_a_label_is_asked_about(tmp_path: Path, name: str) -> None:
    content = text(digits(TIME), digits(GYRO), digits(1.8 * BLOCK + 32.0), names=(*NAMES[:2], name))
    with pytest.raises(rlg.InputError, match=rf"'{name} \[degF\]' or .*'{name} \[degC\]'"):
        read(tmp_path, content, columns=OWN | {"temperature_block_degC": name})
    expect(read(tmp_path, content, columns=OWN | {"temperature_block_degC": f"{name} [degF]"}))


@pytest.mark.parametrize(("name", "ohm"), [("PT100", 100.0), ("Pt1000 block", 1000.0)])
def test_a_platinum_thermometer_without_a_unit_is_asked_about(tmp_path: Path, name: str, ohm: float) -> None:
    resistance = ohm * (1.0 + 3.9083e-3 * BLOCK - 5.775e-7 * BLOCK**2)
    content = text(digits(TIME), digits(GYRO), digits(resistance), names=(*NAMES[:2], name))
    with pytest.raises(rlg.InputError, match=rf"'{name} \[Ohm Pt{ohm:.0f}\]' or .*'{name} \[degC\]'"):
        read(tmp_path, content, columns=OWN | {"temperature_block_degC": name})
    expect(read(tmp_path, content, columns=OWN | {"temperature_block_degC": f"{name} [Ohm Pt{ohm:.0f}]"}))
    content = text(digits(TIME), digits(GYRO), digits(BLOCK), names=(*NAMES[:2], name))  # no resistance: its temperature
    expect(read(tmp_path, content, columns=OWN | {"temperature_block_degC": name}))


def test_a_map_may_say_of_which_thermometer_a_resistance_is(tmp_path: Path) -> None:
    ohm = 100.0 * (1.0 + 3.9083e-3 * BLOCK - 5.775e-7 * BLOCK**2)
    content = text(digits(TIME), digits(GYRO), digits(ohm), names=(*NAMES[:2], "R1 (Ohm)"))
    expect(read(tmp_path, content, columns=OWN | {"temperature_block_degC": "R1 [Ohm Pt100]"}))
    content = text(digits(TIME), digits(GYRO), digits(BLOCK), names=(NAMES[0], "dtheta [arcsec]", NAMES[2]))
    expect(read(tmp_path, content, columns=OWN | {"gyro_deg_h": "dtheta [1 arcsec/s]"}))  # a degree an hour at a sample a second


# --- times ------------------------------------------------------------------------------------------------------------------

BEGAN = datetime.datetime(2021, 12, 31, 23, 58, 20)  # a year ends after 100 s


def stamps(layout: str) -> list[str]:
    return [(BEGAN + datetime.timedelta(seconds=second)).strftime(layout) for second in TIME.tolist()]


def with_times(times: list[list[str]], names: tuple[str, ...]) -> str:
    return text(*times, digits(GYRO), digits(BLOCK), names=(*names, *NAMES[1:]))


@pytest.mark.parametrize(
    "layout",
    [
        "%Y-%jT%H:%M:%S",
        "%Y/%j/%H:%M:%S.000",
        "%Y%m%d_%H%M%S",
        "%Y-%m-%d-%H-%M-%S",
        "%a %b %d %H:%M:%S %Y",
        "%a, %d %b %Y %H:%M:%S +0000",
        "%Y-%m-%d %H:%M:%S CET",
        "%Y-%m-%dT%H:%M:%S+00:00[Europe/London]",
        "%Y年%m月%d日 %H时%M分%S秒",
    ],
)
def test_dates_of_further_layouts(tmp_path: Path, layout: str) -> None:
    run = read(tmp_path, with_times([stamps(layout)], ("t",)), columns=OWN | {"time_s": "t"})
    assert expect(run)["dates"].message.data["first"] == BEGAN.isoformat()


@pytest.mark.parametrize(
    ("layouts", "names"),
    [
        (["%Y", "%m", "%d", "%H", "%M", "%S.00"], ("Year", "Month", "Day", "Hour", "Minute", "Second")),
        (["%y", "%m", "%d", "%H", "%M", "%S"], ("YY", "MM", "DD", "hh", "mm", "ss")),
        (["%Y", "%j", "%H", "%M", "%S"], ("Year", "DOY", "h", "min", "s")),
        (["%Y", "%m", "%d", "%H:%M:%S"], ("Jahr", "Monat", "Tag", "Zeit")),
    ],
)
def test_a_calendar_in_columns(tmp_path: Path, layouts: list[str], names: tuple[str, ...]) -> None:
    content = with_times([stamps(layout) for layout in layouts], names)
    run = read(tmp_path, content, columns=OWN | {"time_s": " + ".join(names)})
    assert expect(run)["dates"].message.data["first"] == BEGAN.isoformat()
    assert not {"unit_not_stated", "unit_of_name"} & by_code(run.findings).keys()


def test_a_calendar_in_another_order_is_refused(tmp_path: Path) -> None:
    content = with_times([stamps(layout) for layout in ("%Y", "%d", "%m")], ("Year", "Day", "Month"))
    with pytest.raises(rlg.InputError, match="no year, month and day in this order"):
        read(tmp_path, content, columns=OWN | {"time_s": "Year + Day + Month"})
    content = with_times([stamps(layout) for layout in ("%Y", "%m", "%d", "%H%M")], ("Year", "Month", "Day", "HHMM"))
    with pytest.raises(rlg.InputError, match="HHMM goes up to 2359; behind year, month and day stand hours"):
        read(tmp_path, content, columns=OWN | {"time_s": "Year + Month + Day + HHMM"})


def test_layouts_that_the_header_says_are_no_units(tmp_path: Path) -> None:
    names = ("Date [dd.mm.yyyy]", "Time [hh:mm:ss.fff]")
    content = with_times([stamps("%d.%m.%Y"), stamps("%H:%M:%S.000")], names)
    expect(read(tmp_path, content, columns=OWN | {"time_s": " + ".join(names)}))


@pytest.mark.parametrize("written", ["digits that end after midnight", "many hours", "days before a point"])
def test_clock_times_of_further_layouts(tmp_path: Path, written: str) -> None:
    seconds = [round(second) for second in (TIME + 100 * 86400 + 86300).tolist()]
    if written == "days before a point":
        times = [f"{one // 86400}.{one // 3600 % 24:02d}:{one // 60 % 60:02d}:{one % 60:02d}.0000000" for one in seconds]
    elif written == "many hours":
        times = [f"{one // 3600}:{one // 60 % 60:02d}:{one % 60:02d}" for one in seconds]
    else:
        times = stamps("%H%M%S.00")
    expect(read(tmp_path, with_times([times], ("t",)), columns=OWN | {"time_s": "t"}))


# --- headers, footers and the order of rows ---------------------------------------------------------------------------------


def test_notes_in_columns_above_the_names(tmp_path: Path) -> None:
    """As of a scanning multimeter: notes with as many entries as the rows, and names that begin with digits."""
    notes = "Instrument:,34970A,Address:,GPIB0::9::INSTR\nChannels:,2\nChannel,Name,Function,Range,Label\n101,<w>,DC,10,V\n"
    names = ("Scan", "Time", "101 <w> (V)", "102 <T> (C)")
    content = notes + text(
        [f"{k}" for k in range(ROWS)], stamps("%m/%d/%Y %H:%M:%S"), digits(GYRO), digits(BLOCK), names=names, separator=","
    )
    columns = {"time_s": "Time", "gyro_deg_h": "101 <w> (V) [1 deg/h]", "temperature_block_degC": "102 <T> (C)"}
    expect(read(tmp_path, content.encode("utf-16"), columns=columns))


def test_a_word_below_a_name_is_no_unit_by_chance(tmp_path: Path) -> None:
    """`Tag` is a day in German, `Min` a minute: only a row of units states units."""
    header = "Ch;;CH1;CH2\nTag;;w;block\nUnit;;deg/h;°C\nDate;Time;;\n"
    content = header + text(stamps("%Y/%m/%d"), stamps("%H:%M:%S"), digits(GYRO), digits(BLOCK), names=("",) * 4).split("\n", 1)[1]
    found = expect(read(tmp_path, content, columns={"time_s": "1 + 2", "gyro_deg_h": "CH1", "temperature_block_degC": "CH2"}))
    assert found["units_row"].message.data["units"] == {"CH1": "deg/h", "CH2": "°C"}


@pytest.mark.parametrize("layout", ["%S", "%Y-%m-%d %H:%M:%S"])
def test_statistics_below_the_rows_are_left_out(tmp_path: Path, layout: str) -> None:
    times = digits(TIME) if layout == "%S" else stamps(layout)
    footer = "".join(f"{word};9.0;23.0\n" for word in ("Min", "Max", "Mean", "Std. dev.", "END"))
    found = expect(
        read(tmp_path, with_times([times], ("t",)) + footer, columns=OWN | {"time_s": "t" if layout != "%S" else "t [s]"})
    )
    assert found["words_at_the_end"].message.data["rows"] == 5


def test_rows_that_run_from_the_last_to_the_first(tmp_path: Path) -> None:
    lines = with_times([stamps("%Y-%m-%d %H:%M:%S")], ("t",)).splitlines()
    run = read(tmp_path, "\n".join([lines[0], *lines[:0:-1]]) + "\n", columns=OWN | {"time_s": "t"})
    found = expect(run)
    assert run.time_s[0] == 0.0
    assert found["dates"].message.data["first"] == BEGAN.isoformat()
    assert "newest_first" in found


def test_rows_that_are_written_twice(tmp_path: Path) -> None:
    names, *lines = plain().splitlines()
    found = expect(read(tmp_path, "\n".join([names, *(line for line in lines for _ in range(2))]) + "\n"))
    assert found["repeated_rows"].message.data["rows"] == ROWS
    coarse = [f"{k // 4}" for k in range(ROWS)]
    with pytest.raises(rlg.InputError, match="too few digits"):
        read(tmp_path, text(coarse, digits(GYRO), digits(BLOCK)))


def test_a_gyro_of_words_is_refused_as_such(tmp_path: Path) -> None:
    with pytest.raises(rlg.InputError, match="none of its 200 entries is a number, the first 'ok'"):
        read(tmp_path, text(digits(TIME), ["ok"] * ROWS, digits(BLOCK)))


def test_the_gyro_that_is_proposed_has_the_unit_of_the_row_of_units(tmp_path: Path) -> None:
    content = "t;Rate;T\ns;deg/s;°C\n" + plain().split("\n", 1)[1]
    with pytest.raises(rlg.InputError, match=r"--map gyro_deg_h=Rate$"):
        read(tmp_path, content, columns={"time_s": "t"})


# --- letters and containers -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("encoding", "names", "guessed"),
    [
        ("cp1251", ("Время [с]", "Скорость [град/ч]", "Температура [°C]"), True),
        ("gb18030", ("时间(秒)", "角速度(度/小时)", "温度(℃)"), True),
        ("shift_jis", ("時間[s]", "角速度[度/h]", "温度[℃]"), True),
        ("cp1252", ("Zeit [s]", "Größe [°/h]", "Gehäuse [°C]"), False),
        ("utf-16-le", ("Zeit [s]", "Größe [°/h]", "T [°C]"), False),
        ("utf-16-be", ("t [s]", "w [deg/h]", "T [K]"), False),
    ],
)
def test_letters_of_older_encodings(tmp_path: Path, encoding: str, names: tuple[str, ...], guessed: bool) -> None:
    block = BLOCK + 273.15 if names[2] == "T [K]" else BLOCK
    content = text(digits(TIME), digits(GYRO), digits(block), names=names).encode(encoding)
    found = expect(read(tmp_path, content, columns=dict(zip(OWN, names, strict=True))))
    assert ("alphabet" in found) == guessed


@pytest.mark.parametrize(
    ("name", "first", "advice"),
    [
        ("run.csv", b"\x1f\x8b\x08\x00\xff", "compressed by gzip; add .gz"),
        ("run.txt", b"PK\x03\x04\x14\x00\xff", r"a zip archive, or an Excel workbook.*\.xlsx"),
        ("run.csv", b"%PDF-1.4\n\x00\xff", "it is a PDF"),
        ("run.zip", b"PK\x03\x04", r"unpack it \(unzip\)"),
        ("run.npy", b"\x93NUMPY", r"numpy\.savez\('RUN\.npz', data=array\)"),
        ("run.xls", b"\xd0\xcf\x11\xe0", r"save it as \.xlsx"),
        ("run.jsonl", b"{}", r"read_json"),
        ("run", b"t;w\n", r"give it the ending \.csv or \.txt"),
    ],
)
def test_what_is_no_text_is_named(tmp_path: Path, name: str, first: bytes, advice: str) -> None:
    with pytest.raises(rlg.InputError, match=advice):
        read(tmp_path, first + bytes(50), name)


@pytest.mark.parametrize("name", ["run.log", "run.prn", "run.TAB"])
def test_further_endings_of_text(tmp_path: Path, name: str) -> None:
    expect(read(tmp_path, plain(), name))


def test_packed_numbers_of_netcdf(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "run.h5", "w") as file:
        file["t"] = TIME
        file["w"] = np.rint(1e5 * (GYRO - 9.0)).astype("i4")
        file["w"].attrs.update({"scale_factor": 1e-5, "add_offset": 9.0})
        block = np.rint(1000.0 * BLOCK).astype("i4")
        block[50] = -9999
        file["T"] = block
        file["T"].attrs.update({"scale_factor": 1e-3, "_FillValue": np.int32(-9999), "units": "degC"})
        file["extra"] = TIME**2
        file["extra"].attrs["gain"] = 0.5
    run = rlg.read(tmp_path / "run.h5", columns={"time_s": "t [s]", "gyro_deg_h": "w [deg/h]", "temperature_block_degC": "T"})
    assert run.rate_deg_h() == pytest.approx(GYRO, abs=1e-6)
    assert run.column("temperature_block_degC") == pytest.approx(np.where(TIME == 50.0, BLOCK[49], BLOCK), abs=1e-6)
    assert run.column("extra") == pytest.approx(TIME**2)
    assert {"packed", "scale_beside", "missing_values"} <= by_code(run.findings).keys()


@pytest.mark.parametrize("bits", [16, 32])
def test_a_counter_that_begins_again_between_two_files(tmp_path: Path, bits: int) -> None:
    counts = [f"{(2**bits - 250 * 100 + 250 * k) % 2**bits}" for k in range(ROWS)]
    for name, part in (("a.csv", slice(100)), ("b.csv", slice(100, None))):
        columns = (counts[part], digits(GYRO[part]), digits(BLOCK[part]))
        (tmp_path / name).write_text(text(*columns, names=("N", *NAMES[1:])))
    run = rlg.read([tmp_path / "a.csv", tmp_path / "b.csv"], columns=OWN | {"time_s": "N [4 ms]"})
    assert expect(run)["joined"].message.data["pause_s"] == pytest.approx(1.0)


def test_dates_of_numpy(tmp_path: Path) -> None:
    np.savez(tmp_path / "run.npz", t=np.datetime64(BEGAN) + TIME.astype("timedelta64[s]"), w=GYRO, T=BLOCK)
    columns = {"time_s": "t", "gyro_deg_h": "w [deg/h]", "temperature_block_degC": "T [degC]"}
    assert expect(rlg.read(tmp_path / "run.npz", columns=columns))["dates"].message.data["first"] == BEGAN.isoformat()
