"""Dialects of text files of numbers: separator, decimal sign, and where the names and units of the columns stand.

The separator is the one by which most lines, also the names, have as many entries, and those of rows of numbers are numbers,
dates, clock times or empty; blanks come last. A decimal comma shows in numbers alone, never in dates (`20.01.2021`) or clock times
(`08:00:00.000`, `22:09:43,250`). The names are the line of words above most of the numbers. Names with blanks above columns of
fixed width belong to the columns that they stand over.
"""

from __future__ import annotations

import csv as text
import dataclasses
import itertools
import re
from collections import Counter
from collections.abc import Iterable, Sequence
from typing import Final

from rlgcomp import units
from rlgcomp.errors import InputError
from rlgcomp.recording import Finding
from rlgcomp.report.messages import message

BLANKS: Final = " "
SEPARATORS: Final = ("\t", ";", ",", "|", BLANKS)  # of two that leave as many numbers the first is taken
REMARK: Final = ("#", "%", "//")  # begins of lines that may name the columns, though they are no data
_MARKS: Final = ("*", "!", ";", "--")  # of remarks above the numbers, as other programs begin them
_SHOWING: Final = 60  # lines that show the separator and the line of names
_MOST_BELOW: Final = 3  # rows of units, kinds or blanks between the names and the numbers

MINUS: Final = "−–﹣－"  # signs that typeset numbers have in place of the hyphen
_SIGN: Final = rf"[+{MINUS}-]?"
_POINT: Final = re.compile(
    rf"{_SIGN}\s*(\d+\.?\d*|\.\d+)([eEdD]{_SIGN}\d+)?|{_SIGN}(nan|inf(inity)?|1\.#[a-z]+\d*)|0x[\da-f]+", re.IGNORECASE
)
_COMMA: Final = re.compile(rf"{_SIGN}\d*,\d+([eE]{_SIGN}\d+)?")
_FRACTION: Final = re.compile(rf"{_SIGN}\d*\.\d+([eE]{_SIGN}\d+)?")
_WITH_UNIT: Final = re.compile(rf"{_SIGN}\d+([.,]\d+)?\s*(?P<unit>[^\d\s].*)")
_GROUPED: Final = re.compile(_SIGN + r"\d{1,3}(?:(?P<group>[.,'’\s])\d{3})(?:(?P=group)\d{3})*(?:(?P<decimal>[.,])\d*)?")
_CLOCK: Final = r"(\d+(\.| days?,? ))?\d{1,4}:\d{2}(:\d{2}([.,:]\d+)?)?( ?[AaPp]\.?[Mm]\.?)?"
_DATE: Final = (
    r"(\d{1,4}[-/.](\d{1,2}|[^\W\d]{3,9}\.?)[-/.]\d{1,4}|\d{1,2}\.? ?[^\W\d]{3,9}\.?,? \d{4}|[^\W\d]{3,9}\.? \d{1,2},? \d{4})"
)
_STATED: Final = re.compile(r'"?sep=(.)"?\s*', re.IGNORECASE)  # the first line of Excel, for itself
_MARKED: Final = re.compile(r"(#|%|//|[*!;]|--)+\s*")  # what stands before the names in a remark
_TIME: Final = re.compile(rf"{_DATE}([T ,_]+{_CLOCK} ?(Z|UTC|[+-]\d\d:?\d\d)?)?|{_CLOCK}")


@dataclasses.dataclass(frozen=True)
class Dialect:
    """How a file of numbers is written.

    Parameters
    ----------
    separator : str
        One character; a blank stands for any number of blanks.
    decimal : str
        A point where no number showed it.
    names : tuple of str
        Names of the columns, as many as the rows have entries; an entry behind the last separator has an empty name.
    first : int
        Lines above the first row of numbers.
    units : tuple of str or None
        Units of a row of units, of each column that has one.
    above : tuple of str
        Lines above the names: the recorder's notes.
    plain : bool
        The first line alone stands above the numbers, and names them.
    findings : tuple of Finding
    below : tuple of tuple of str
        Entries of the rows between names and numbers: where they come again, they are no numbers either.
    clock : tuple of str, float and float, optional
        Name, first value and step of a column that is empty in the rows.
    segments : bool
        Further headers may stand between the rows.
    decimal_seen : bool
        Whether a number showed the decimal sign.
    thousands : str, optional
        A sign that a column shows to stand between thousands.
    padded : int
        Last columns that have no name: the rows end in a separator.
    surplus : int
        Names beyond the entries of the rows: which name is whose is unknown.
    encoding : str
    cut : bool
        The last line ends within a number.
    """

    separator: str
    decimal: str
    names: tuple[str, ...]
    first: int
    units: tuple[str | None, ...] = ()
    above: tuple[str, ...] = ()
    plain: bool = True
    findings: tuple[Finding, ...] = ()
    below: tuple[tuple[str, ...], ...] = ()
    clock: tuple[str, float, float] | None = None
    padded: int = 0
    surplus: int = 0
    segments: bool = False
    decimal_seen: bool = True
    thousands: str | None = None
    encoding: str = "utf-8"
    cut: bool = False


def dialect_of(lines: Sequence[str]) -> Dialect:
    """Dialect of a file's first lines."""
    places = [place for place, line in enumerate(lines) if line.strip() and not line.startswith(REMARK)]
    stated = _STATED.fullmatch(lines[places[0]]) if places else None
    places = places[1:] if stated else places
    top = [lines[place] for place in places[:_SHOWING]]
    separator = stated[1] if stated else _separator(top)
    _require_plain_cells(top)
    rows = [entries(line, separator) for line in top]
    if not rows or (len(rows) > _MOST_BELOW and not any(map(_has_value, rows))):
        return Dialect(separator, ".", (), len(lines), above=tuple(lines))
    width = Counter(len(row) for row in rows[len(rows) // 2 :]).most_common(1)[0][0]
    begins = next((at for at, row in enumerate(rows) if len(row) == width and _has_value(row) and row[0] not in _MARKS), 0)
    kept = [at for at, row in enumerate(rows) if at >= begins or not _is_remark(top[at], row, width)]
    places = [places[at] for at in kept] + places[len(rows) :]
    top, rows = [top[at] for at in kept], [rows[at] for at in kept]
    named = _names_at(rows, width)
    findings: list[Finding] = []
    below: list[list[str]] = []
    if named is None:
        at = 0
        above = list(lines[: places[0]])
        in_remark = _named_in_remark(above, width, separator)
        names = in_remark or [str(k) for k in range(1, 1 + width)]
        about = message("recording.names_in_remark", columns=names) if in_remark else message("recording.no_names", columns=names)
        findings.append(Finding("noted", about))
    else:
        names = [name.lstrip("\ufeff") for name in rows[named]]
        below = _below(rows[named + 1 :])
        at = named + 1 + len(below)
        above = list(lines[: places[named]])
        unused = [top[k] for k, row in enumerate(rows[:named]) if len(row) == width and _has_value(row)]
        if unused:
            findings.append(Finding("noted", message("recording.numbers_above_names", rows=len(unused), first=unused[0].strip())))
    first = places[at] if at < len(places) else len(lines)
    data = rows[at:]
    most = max((len(row) for row in data), default=len(names))
    if named is not None and len(names) > most:
        names = _fewer_names(names, most, top[named], top[at:], separator)
    width = max([len(names), *(len(row) for row in data[:1])])
    padded = width - len(names)
    names += [""] * padded
    units_below = _units_of(width, below)
    findings += _findings_below(names, below, units_below)
    seen, between, of_signs = _signs(separator, [lines[place] for place in places[at:]])
    findings += of_signs
    decimal = seen or "."
    return Dialect(
        separator,
        decimal,
        tuple(names),
        first,
        units_below,
        tuple(above),
        plain=named == 0 and first == 1,
        findings=tuple(findings),
        below=tuple(map(tuple, below)),
        padded=padded,
        surplus=sum(map(bool, names[most:])) if data else 0,
        decimal_seen=seen is not None,
        thousands=between,
    )


def _has_value(row: Iterable[str]) -> bool:
    return any(map(is_value, row))


def _is_remark(line: str, row: Sequence[str], width: int) -> bool:
    """Whether a line above the numbers is a remark behind a mark, and no row whose first entry begins with such a sign."""
    return line.startswith(_MARKS) and (len(row) != width or row[0] in _MARKS)


def _require_plain_cells(lines: Sequence[str]) -> None:
    """Raise where most cells hold a number and its unit, as in `0.0 s,-0.45 deg/h`.

    Raises
    ------
    InputError
        They do.
    """
    for separator in SEPARATORS[:-1]:
        cells = [cell for line in lines[1:] if separator in line for cell in entries(line, separator) if cell]
        if not cells or sum(map(is_value, cells)) >= 0.5 * len(cells):
            continue
        with_unit = [cell for cell in cells if (found := _WITH_UNIT.fullmatch(cell)) and units.is_unit(found["unit"])]
        if len(with_unit) >= 0.5 * len(cells):
            raise InputError(
                f"its cells hold units beside their numbers, the first {with_unit[0]!r}; write numbers alone, and a unit once, in "
                "the name of its column, as 'rate [deg/h]'"
            )


def entries(line: str, separator: str) -> list[str]:
    """Entries of a line, without the blanks and quotes around them."""
    if separator == BLANKS:
        return line.split()
    if '"' in line and "\r" not in line:
        return [entry.strip() for entry in next(text.reader([line], delimiter=separator, skipinitialspace=True), [])]
    return [entry.strip() for entry in line.split(separator)]


def is_value(entry: str) -> bool:
    """Whether an entry is a number, with decimal point or comma, a date or a clock time."""
    return bool(_POINT.fullmatch(entry) or _COMMA.fullmatch(entry) or _TIME.fullmatch(entry) or _decimal_of_groups(entry))


def is_decimal_comma(entry: str) -> bool:
    """Whether an entry is a number with a decimal comma."""
    return bool(_COMMA.fullmatch(entry))


def _may_be_thousands(entry: str) -> bool:
    """Whether the points or commas of a number may stand between its thousands."""
    return bool(re.fullmatch(_SIGN + r"[1-9]\d{0,2}([.,])\d{3}(\1\d{3})*", entry))


def _decimal_of_groups(entry: str) -> str | None:
    """Decimal sign of a number with signs between thousands, such as 1.013,25; None of anything else."""
    grouped = _GROUPED.fullmatch(entry)
    return grouped["decimal"] if grouped and grouped["decimal"] != grouped["group"] else None


def without_thousands(entry: str, written: Dialect) -> str:
    """A number without signs between its thousands, with a decimal point; anything else as it is.

    A comma or a point alone between thousands may be a decimal sign unless the file's separator or its decimal sign excludes it.
    """
    grouped = _GROUPED.fullmatch(entry)
    if grouped is None:
        return entry.replace(",", ".") if written.decimal == "," and is_decimal_comma(entry) else entry
    group, decimal = grouped["group"], grouped["decimal"]
    certain = group not in ",." or decimal or entry.count(group) > 1 or (group == "," and written.separator == ",")
    certain = certain or group == written.thousands
    if not certain or group == decimal:
        return entry
    return entry.replace(group, "").replace(",", ".")


def _separator(lines: Sequence[str]) -> str:
    """The separator by which most lines agree in the number of their entries, and most entries of rows of numbers are values.

    Lines of words count by their width alone, and empty cells are cells: so a column that is empty throughout is a column.
    """
    best, highest = ",", 0.0
    for separator in SEPARATORS:
        rows = [entries(line, separator) for line in lines]
        width, agreeing = Counter(map(len, rows)).most_common(1)[0] if rows else (0, 0)
        filled = [entry for row in rows if len(row) == width > 1 and _has_value(row) for entry in row if entry]
        score = sum(map(is_value, filled)) / max(1, len(filled)) * agreeing / max(1, len(rows))
        if score > highest + 1e-9:
            best, highest = separator, score
    if highest == 0.0 and lines:  # names alone
        return max((",", ";", "\t"), key=lines[0].count)
    return best


def _names_at(rows: Sequence[Sequence[str]], width: int) -> int | None:
    """The row that names the columns: of the rows of words as wide as the numbers, that with most rows of numbers below it."""
    numbers = [row for row in rows if len(row) == width and _has_value(row)]
    padded = bool(numbers) and not any(row[-1] for row in numbers)  # the rows end in a separator, the names need not
    below: Counter[tuple[str, ...]] = Counter()  # rows of numbers, by the names above them
    named, open_block = None, False
    for place, row in enumerate(rows):
        fits = len(row) == width or len(row) == width - padded or (len(row) == width + 1 and not row[-1])
        if _has_value(row):
            open_block = False
            if named is not None and len(row) == width:
                below[named] += 1
        elif not fits:
            open_block = False
        elif (
            not open_block
            and len({entry for entry in row if entry}) > 1
            and (named is None or _are_names(row) or not (below[named] or _unit_count(row)))
        ):
            named, open_block = tuple(rows[_without_repetition(rows, place)]), True
            below[named] += 0
    if below:
        most = below.most_common(1)[0][0]
        return next(place for place, row in enumerate(rows) if tuple(row) == most)
    worded = next((place for place, row in enumerate(rows) if len(row) == width and _has_value(row)), 0) - 1
    if worded >= 0 and not _has_value(rows[worded]):
        return worded  # names that hold the separator, or more of them than entries
    if not rows or all(not entry or is_value(entry) for entry in rows[0]):
        return None
    kinds = [[is_value(entry) for entry in row] for row in rows[:2]]
    return None if len(rows) > 1 and any(kinds[0]) and kinds[0] == kinds[1] else 0  # words among numbers, as in the row after it


def _without_repetition(rows: Sequence[Sequence[str]], place: int) -> int:
    """The row of names: the first, or, where an entry repeats in it, a later one above the numbers whose entries all differ."""
    for later, row in enumerate(rows[place : place + _MOST_BELOW], start=place):
        if _has_value(row) or (later > place and (_unit_count(row) or len(row) != len(rows[place]))):
            break
        if all(row) and len(set(row)) == len(row):
            return later
    return place


def _are_names(row: Sequence[str]) -> bool:
    """Whether words below numbers may name columns again: each begins with a letter, and no two are alike."""
    return all(entry[:1].isalpha() for entry in row) and len(set(row)) == len(row)


def _fewer_names(names: list[str], width: int, line: str, data: Sequence[str], separator: str) -> list[str]:
    """Names as many as the entries of the rows, where more were read: behind an empty one, between wide gaps, over the columns."""
    if len(names) == width + 1 and not names[0]:
        return names[1:]
    return (_names_between(line, width) or _names_over_columns(line, data, width) or names) if separator == BLANKS else names


def _names_between(line: str, width: int) -> list[str] | None:
    """So many names of a line between wide gaps or signs; None where there are more or less."""
    every = (re.split(between, line.strip()) for between in (r"\s{2,}", r"\t", r"\s*[,;|]\s*"))
    return next((names for names in every if len(names) == width and all(names)), None)


def _names_over_columns(line: str, data: Sequence[str], width: int) -> list[str] | None:
    """Names of columns of fixed width, each word belonging to the column nearest to it.

    None where the columns are not aligned, or where words with a wide gap between them fall to one: a column is then empty.
    """
    used = [False] * max(map(len, [line, *data]))
    for row in data:
        for place, sign in enumerate(row.expandtabs()[: len(used)]):
            used[place] = used[place] or sign != " "
    columns = [(found.start(), found.end()) for found in re.finditer("1+", "".join("01"[one] for one in used))]
    if len(columns) != width:
        return None
    names = [""] * width
    for word in re.finditer(r"\S+", line.expandtabs()):
        gaps = [max(start - word.end(), word.start() - stop) for start, stop in columns]
        nearest = gaps.index(min(gaps))
        names[nearest] = f"{names[nearest]} {word[0]}".strip()
    return names if all(names) and all(name in line.expandtabs() for name in names) else None


def _named_in_remark(above: Sequence[str], width: int, separator: str) -> list[str] | None:
    """The names in the last remark above the numbers that has as many entries as these."""
    for line in reversed(above):
        if line.startswith(REMARK + _MARKS):
            inside = _MARKED.sub("", line.strip(), count=1)
            every = [entries(inside, sign) for sign in dict.fromkeys((separator, *SEPARATORS))]
            for names in (*every, (line is above[-1] and _names_between(inside, width)) or []):
                if len(names) == width and all(names) and not _has_value(names):
                    return names
    return None


def _below(rows: Sequence[Sequence[str]]) -> list[list[str]]:
    """Rows between the names and the numbers: units, kinds of the columns, blanks."""
    first = next((place for place, row in enumerate(rows[: _MOST_BELOW + 1]) if any(map(is_value, row))), len(rows))
    if first <= _MOST_BELOW:
        return [list(row) for row in rows[:first]]
    below: list[list[str]] = []
    for row in rows[:_MOST_BELOW]:
        if not _unit_count(row) and any(row):
            break
        below.append(list(row))
    return below


def _unit_of(entry: str) -> str | None:
    """The unit that an entry of a row of units states, or None."""
    inside = re.sub(r"^[\[(](.*)[\])]$", r"\1", entry.strip())
    return inside if units.is_unit(inside) else None


def _unit_count(row: Sequence[str]) -> int:
    return sum(_unit_of(entry) is not None for entry in row)


def _units_of(width: int, below: Iterable[Sequence[str]]) -> tuple[str | None, ...]:
    """Unit of each column: the rows of units are those with a unit in every second filled cell; words may be units by chance."""
    rows = [row[:width] for row in below if 2 * _unit_count(row) >= sum(map(bool, row))]
    stated = [[_unit_of(entry) for entry in row] for row in rows]
    return tuple(next((row[k] for row in stated if k < len(row) and row[k] is not None), None) for k in range(width))


def _findings_below(names: Sequence[str], below: Sequence[Sequence[str]], stated: Sequence[str | None]) -> list[Finding]:
    """A finding of the rows between names and numbers: which units they state, and what is left out."""
    if not below:
        return []
    known = {name or f"column {place}": unit for place, (name, unit) in enumerate(zip(names, stated, strict=True), 1) if unit}
    other = [entry for row in below for entry in row if entry and _unit_of(entry) is None]
    return [Finding("noted", message("recording.units_row", rows=len(below), units=known, other=other))]


def _signs(separator: str, lines: Sequence[str]) -> tuple[str | None, str | None, list[Finding]]:
    """The decimal sign and the sign between thousands, as far as lines show them, and findings."""
    seen = decimal_of(separator, lines)
    if separator == ",":
        return seen, None, []
    rows = [entries(line, separator) for line in lines]
    between, doubtful = _between_thousands(rows)
    shown = any(_is_fraction(entry) and not _may_be_thousands(entry) for row in rows for entry in row)
    findings = []
    if between is not None and seen in (None, between):
        seen = "," if between == "." else "."
    elif doubtful and not shown:
        findings.append(Finding("noted", message("recording.perhaps_thousands", grouped=doubtful[0], whole=doubtful[1])))
    if seen == ",":
        findings.append(Finding("noted", message("recording.decimal_comma")))
    return seen, between, findings


def _is_fraction(entry: str) -> bool:
    return bool(_FRACTION.fullmatch(entry) or _COMMA.fullmatch(entry))


def _between_thousands(rows: Sequence[Sequence[str]]) -> tuple[str | None, tuple[str, str] | None]:
    """The point or comma that stands between thousands, as a column shows that increases by it alone, such as 980, 990, 1.000.

    Besides, where no column shows it, the first number with three digits behind a sign and the first whole one of a column that has
    both, such as 1.000 and 0.
    """
    doubtful = None
    width = Counter(map(len, rows)).most_common(1)[0][0] if rows else 0
    for column in zip(*(row for row in rows if len(row) == width), strict=True):
        filled = [entry for entry in column if entry]
        grouped = [entry for entry in filled if _may_be_thousands(entry)]
        whole = [entry for entry in filled if re.fullmatch(_SIGN + r"\d{1,3}", entry)]
        signs = {sign for entry in grouped for sign in ".," if sign in entry}
        if not grouped or not whole or len(grouped) + len(whole) < len(filled) or len(signs) > 1:
            continue
        sign = signs.pop()
        if any(entry.count(sign) > 1 for entry in grouped):
            return sign, None
        counts = [re.sub(f"[{MINUS}]", "-", entry) for entry in filled]
        with_point, without = ([float(entry.replace(sign, as_this)) for entry in counts] for as_this in (".", ""))
        if _increases(without) and not _increases(with_point):
            return sign, None
        doubtful = doubtful or (grouped[0], whole[0])
    return None, doubtful


def _increases(values: Sequence[float]) -> bool:
    return all(after > before for before, after in itertools.pairwise(values))


def decimal_of(separator: str, lines: Iterable[str]) -> str | None:
    """The decimal sign: a comma where numbers have commas and none has a point; None where no number shows it.

    A point or a comma that may stand between thousands decides only where no other number does.
    """
    if separator == ",":
        return "."
    certain, possible = False, set()
    for line in lines:
        for entry in entries(line, separator):
            if (sign := _decimal_of_groups(entry)) is not None:
                return sign
            point = _FRACTION.fullmatch(entry) is not None
            if not point and _COMMA.fullmatch(entry) is None:
                continue
            if _may_be_thousands(entry):
                possible.add("." if point else ",")
            elif point:
                return "."
            else:
                certain = True
    if certain:
        return ","
    return "." if "." in possible else "," if possible else None
