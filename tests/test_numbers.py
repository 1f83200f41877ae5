"""Large tables of numbers: the compiled reader against Arrow's and Python's float, to the last bit, across the edges of pieces."""

from __future__ import annotations

import itertools
from fractions import Fraction
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from hypothesis import HealthCheck, assume, example, given, settings
from hypothesis import strategies as st

from rlgcomp.numerics.compiled import Compiled, available
from rlgcomp.recording.formats import csv, numbers

pytestmark = pytest.mark.skipif(not available(), reason="Numba is not installed, or switched off")
FILES = settings(max_examples=150, suppress_health_check=[HealthCheck.function_scoped_fixture])
SIGN = st.sampled_from(["", "", "-", "+"])
EXPONENT = st.one_of(
    st.just(""), st.builds("{}{}{}".format, st.sampled_from("eE"), SIGN, st.integers(0, 400)), st.sampled_from(["e-0007", "E+05"])
)
DIGITS = st.text("0123456789", max_size=25)
DOUBLES = st.one_of(st.floats(allow_nan=False, allow_infinity=False), st.floats(-1e-300, 1e-300), st.floats(-1e3, 1e3))


def half_way(value: float, digits: int) -> str:
    """A number between a double and the next one, to so many digits."""
    exact = (Fraction(value) + Fraction(float(np.nextafter(value, np.inf)))) / 2
    power = digits - len(str(int(exact))) if exact >= 1 else digits + len(str(int(1 / exact))) - 1
    return f"{int(exact * 10**power)}e{-power}"


CELL = st.one_of(
    st.just(""),
    st.integers(-(10**20), 10**20).map(str),
    DOUBLES.map(repr),
    st.builds(format, DOUBLES, st.sampled_from([".17g", ".5f", ".20f", ".6e", ".24e", "+.9E"])),
    st.builds(half_way, st.floats(1e-300, 1e300), st.integers(15, 21)),
    st.builds(
        "{}{}.{}{}".format, SIGN, st.one_of(DIGITS, st.just("000")), st.one_of(DIGITS, st.just("0" * 30 + "12")), EXPONENT
    ).filter(lambda cell: any(sign.isdigit() for sign in cell.lower().split("e")[0])),
    st.builds("{}{}{}".format, SIGN, st.text("0123456789", min_size=1, max_size=25), EXPONENT),
)


@pytest.fixture
def small_pieces(monkeypatch: pytest.MonkeyPatch) -> None:
    """Every few lines are a piece of their own, and so are files of a few lines worth reading."""
    monkeypatch.setattr(numbers, "PIECE", 40)
    monkeypatch.setattr(csv, "LARGE", 0)
    monkeypatch.setattr(numbers, "LARGE", 0)


def by_arrow(path: Path, monkeypatch: pytest.MonkeyPatch) -> pd.DataFrame | None:
    with monkeypatch.context() as without:
        without.setattr(numbers, "pays", lambda size: False)
        return csv.read_numbers(path)


def bits(table: pd.DataFrame) -> np.ndarray:
    values = table.to_numpy()
    return np.where(np.isnan(values), 0.5, values).view(np.uint64)  # a missing value has many bit patterns


@FILES
@pytest.mark.usefixtures("small_pieces")
@given(
    rows=st.lists(st.lists(CELL, min_size=3, max_size=3), max_size=12),
    separator=st.sampled_from([",", ";", "\t"]),
    end=st.sampled_from(["\n", "\r\n"]),
    last=st.booleans(),
)
def test_numbers_are_those_of_arrow_and_of_python(
    tmp_path: Path, rows: list[list[str]], separator: str, end: str, last: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    assume(not rows or any(rows[0]))  # blanks below the names are no row of numbers
    path = tmp_path / "run.csv"
    names = ["time_s", "gyro_deg_h", "T [°C]"]
    path.write_bytes((end.join([separator.join(row) for row in [names, *rows]]) + (end if last or not rows else "")).encode())
    found = numbers.read(path, names, separator)
    assert found is not None
    python = pd.DataFrame([[float(cell or "nan") for cell in row] for row in rows], columns=names, dtype=float)
    np.testing.assert_array_equal(bits(found), bits(python))
    arrow = by_arrow(path, monkeypatch)
    np.testing.assert_array_equal(bits(found), bits(arrow))
    pd.testing.assert_frame_equal(found, arrow)
    assert found.columns.dtype == arrow.columns.dtype


LINES = st.one_of(
    st.text("0123456789.,", max_size=12),
    st.text("01.+-eE,;\t\r \"#naNif'_x\0", max_size=12),
    st.sampled_from(["1,2", "-3.5,4e5", ",", "1,2,3"]),
    st.sampled_from(["1", "", "nan,1", "inf,2", "NA,", "1 ,2", '"1",2', "#1,2", "1,+", "1,2\r", "1e,2"]),
)


@settings(FILES, max_examples=400)
@pytest.mark.usefixtures("small_pieces")
@given(
    header=st.sampled_from(["a,b", "a,b\r", "a,b\r\r", "a, b", '"a",b', "#a,b", "a,a", "a", "a,b,c", "\ufeffa,b", "a,", "a,°"]),
    lines=st.lists(LINES, max_size=6),
    end=st.sampled_from(["\n", "\r\n"]),
    last=st.booleans(),
)
@example(header="a,b", lines=["1,2", "3,."], end="\n", last=True)
@example(header="a,b", lines=["1,2", "3,-"], end="\n", last=False)
@example(header="a,b", lines=["1,2", "3"], end="\n", last=False)
@example(header="a,b", lines=["1,2\r\r", "3,4"], end="\n", last=True)
def test_whatever_is_read_is_what_arrow_reads(
    tmp_path: Path, header: str, lines: list[str], end: str, last: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "run.csv"
    path.write_bytes((end.join([header, *lines]) + (end if last else "")).encode())
    found, arrow = csv.read_numbers(path), by_arrow(path, monkeypatch)
    assert (found is None) == (arrow is None)
    if found is not None:
        np.testing.assert_array_equal(bits(found), bits(arrow))
        pd.testing.assert_frame_equal(found, arrow)


def test_long_numbers_near_half_way_between_doubles(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """At all powers of ten; those as near to the middle of two doubles as 17 to 19 digits allow; and the middles themselves."""
    rng = np.random.default_rng(5)
    cells = [f"{w}e{q}" for w, q in zip(rng.integers(10**15, 2**63 - 1, 40_000), rng.integers(-345, 312, 40_000), strict=True)]
    doubles = np.exp(rng.uniform(-680, 680, 6000)).tolist()
    cells += [half_way(value, digits) for value in doubles for digits in (17, 18, 19)]
    cells += [f"{int(cell.split('e')[0]) + 1}e{cell.split('e')[1]}" for cell in cells[-18_000:]]
    for q in range(1, 28):  # 2^53 to 2^54, odd, is half-way between whole doubles; times 5^q and a power of two it has q zeros
        least = 2**53 // 5**q + 1
        cells += [f"{odd << (q % 8)}e{q}" for odd in range(least | 1, (least | 1) + 40, 2) if 2**53 < odd * 5**q < 2**54]
    cells += [f"{odd * 5**q}e-{q}" for q in range(5) for odd in range(2**53 + 1, 2**53 + 41, 2) if odd * 5**q < 2**64]
    monkeypatch.setattr(numbers, "MOST_LEFTOVER", 1 << 15)
    path = tmp_path / "run.csv"
    path.write_text("a,b\n" + "".join(f"{one},-{two}\n" for one, two in itertools.pairwise(cells)))
    found = numbers.read(path, ["a", "b"], ",")
    expected = np.array([float(cell) for cell in cells])
    np.testing.assert_array_equal(found["a"].to_numpy().view(np.uint64), expected[:-1].view(np.uint64))
    np.testing.assert_array_equal(found["b"].to_numpy().view(np.uint64), (-expected[1:]).view(np.uint64))


def test_few_numbers_are_left_to_python(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "run.csv"
    path.write_text("a,b\n" + "1,0.1234567890123456789012\n" * 9)
    assert numbers.read(path, ["a", "b"], ",") is not None
    monkeypatch.setattr(numbers, "MOST_LEFTOVER", 8)
    assert numbers.read(path, ["a", "b"], ",") is None
    drawn = np.random.default_rng(0).normal(size=(20_000, 2))
    pd.DataFrame(drawn, columns=["a", "b"]).to_csv(path, index=False, float_format="%.17g")
    monkeypatch.setattr(numbers, "MOST_LEFTOVER", 64)  # of 26 000 numbers a piece
    np.testing.assert_array_equal(numbers.read(path, ["a", "b"], ",").to_numpy(), drawn)


def test_lines_that_are_too_long_are_left_to_others(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "run.csv"
    path.write_text("a,b\n" + ("1," + "0" * 60 + "2\n") * 4)
    monkeypatch.setattr(numbers, "PIECE", 40)
    assert numbers.read(path, ["a", "b"], ",") is not None
    monkeypatch.setattr(numbers, "LONGEST_LINE", 8)
    assert numbers.read(path, ["a", "b"], ",") is None


def test_short_lines_ask_for_no_memory(tmp_path: Path) -> None:
    path = tmp_path / "run.csv"
    names = [f"column_{k}" for k in range(20_000)]
    path.write_text(",".join(names) + "\n" * 4_000_000)  # a table of 600 GB
    assert numbers.read(path, names, ",") is None


def test_numba_is_not_started_for_little_text(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Compiled, "ready", False)
    assert not numbers.pays(numbers.LARGE - 1)
    assert numbers.pays(numbers.LARGE)
    monkeypatch.setattr(Compiled, "ready", True)
    assert numbers.pays(1)
    monkeypatch.setenv("RLGCOMP_NUMBA", "0")
    assert not numbers.pays(1 << 40)
