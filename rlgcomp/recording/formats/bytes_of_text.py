"""What the first bytes of a file show: the encoding of its letters, or that it is no text, and what to do then."""

from __future__ import annotations

import re
from typing import Final

from rlgcomp.errors import InputError

CONTROL: Final = rb"[\x00-\x08\x0e-\x1f"
NO_TEXT: Final = re.compile(CONTROL + rb"\x81\x8d\x8f\x90\x9d]")  # of these, text in Windows-1252 holds none
_CONTROL: Final = re.compile(CONTROL + rb"]")
_WORDS: Final = re.compile(rb"[\x80-\xff]{3,}")  # Western words have two such letters beside each other at most
_CYRILLIC: Final = re.compile(rb"[\x00-\x7f\xc0-\xff\xa8\xb8\xb0\xb5\xb9\xab\xbb\x96\x97\xa0]*")  # letters, ° µ № quotes and dashes
_OF_TWO_BYTES: Final = re.compile(rb"(?:[\x00-\x7f]|[\xa1-\xf7][\xa1-\xfe])*")  # GB 2312
_HALF: Final = 0.4  # of every second byte is zero in UTF-16
_KINDS: Final = (
    (b"\x1f\x8b", "it is compressed by gzip; add .gz to its name"),
    (b"PK\x03\x04", "it is a zip archive, or an Excel workbook: unpack it (unzip), or give it the ending .xlsx"),
    (b"\xfd7zXZ", "it is compressed by xz; unpack it (unxz)"),
    (b"BZh", "it is compressed by bzip2; unpack it (bunzip2)"),
    (b"\x28\xb5\x2f\xfd", "it is compressed by zstd; unpack it (unzstd)"),
    (b"\xd0\xcf\x11\xe0", "it is an Excel workbook of the old kind (.xls); save it as .xlsx or as text"),
    (b"%PDF", "it is a PDF; write its table as text"),
    (b"\x89HDF", "it is HDF5; give it the ending .h5"),
    (b"MATLAB 5", "it is a file of MATLAB; give it the ending .mat"),
    (b"MATLAB 7", "it is a file of MATLAB; give it the ending .mat"),
    (b"PAR1", "it is Parquet; give it the ending .parquet"),
    (b"ARROW1", "it is a file of Arrow; give it the ending .feather"),
    (b"TDSm", "it is TDMS; give it the ending .tdms"),
    (b"MDF  ", "it is MDF; give it the ending .mf4"),
    (b"ULog", "it is a log of PX4; give it the ending .ulg"),
    (b"SQLite", "it is a database of SQLite; write its table as text"),
)
_ENDINGS: Final = {
    ".gz": "unpack it (gunzip)", ".xz": "unpack it (unxz)", ".bz2": "unpack it (bunzip2)", ".zip": "unpack it (unzip)",
    ".zst": "unpack it (unzstd)", ".7z": "unpack it (7z x)", ".rar": "unpack it",
    ".xls": "save it as .xlsx; where it is text, as some programs write it, rename it to .csv",
    ".ods": "save it as .xlsx or .csv",
    ".npy": "write the array into an archive, numpy.savez('RUN.npz', data=array), whose columns are data_1, data_2 and so on",
    ".json": "write its table as .csv or .parquet, as pandas does",
    ".jsonl": "write its table as .csv or .parquet, as pandas does: read_json(FILE, lines=True).to_csv(RUN)",
}  # fmt: skip


def what_to_do(suffix: str) -> str:
    """What to do with a file whose ending is no known format."""
    return _ENDINGS.get(suffix.lower(), "where it is a table as text, give it the ending .csv or .txt")


def encoding_of(head: bytes) -> tuple[str, bool]:
    """The encoding of a text, and whether it was guessed from bytes that may be letters of several alphabets.

    Parameters
    ----------
    head : bytes
        The first of the file.

    Raises
    ------
    InputError
        It is no text; the message says what it is.
    """
    if head.startswith((b"\xff\xfe", b"\xfe\xff")):
        return "utf-16", False
    for first, encoding in ((1, "utf-16-le"), (0, "utf-16-be")):
        if head[first::2].count(0) > _HALF * len(head[first::2]) and head[1 - first :: 2].count(0) == 0:
            return encoding, False
    kind = next((how for magic, how in _KINDS if head.startswith(magic)), None)
    try:
        head[: head.rfind(b"\n") + 1 or None].decode("utf-8")  # a character may be cut at the end of what was read
    except UnicodeError as error:
        if not _CONTROL.search(head) and (found := _of_alphabet(head)) is not None:
            return found, True
        if NO_TEXT.search(head):
            how = kind or f"it is no text ({str(error).splitlines()[0]}); write it as text in UTF-8, or give its own ending"
            raise InputError(how) from None
        return "cp1252", False
    if kind is not None and _CONTROL.search(head):
        raise InputError(kind)
    return "utf-8", False


def _of_alphabet(head: bytes) -> str | None:
    """Encoding of words that are no Western ones; None where there are none."""
    if not _WORDS.search(head):
        return None
    if _CYRILLIC.fullmatch(head):
        return "cp1251"
    whole = head[: head.rfind(b"\n") + 1 or None]
    candidates = ("gb18030", "shift_jis") if _OF_TWO_BYTES.fullmatch(whole) else ("shift_jis", "gb18030")
    for encoding in candidates:
        try:
            whole.decode(encoding)
        except UnicodeError:
            continue
        return encoding
    return None
