"""Tables of a gyro's recording with strange values, and files of every format that hold them in strange ways."""
# ruff: noqa: B023, E501, PLR0912  tables of values are one a line; functions are called at once; accidents are many

from __future__ import annotations

import gzip
import io
import json
import random
import zipfile
from collections.abc import Callable
from typing import Any, Final

import numpy as np
import pandas as pd

Table = dict[str, Any]
NAMES: Final = (
    "gyro_deg_h", "gyro_deg_s", "gyro_pulses", "gyro_rad_s", "gyro_x_deg_h", "gyro_y_pulses", "Gyro Z [deg/s]", "temperature_block_degC",
    "temperature_shell_degC", "temperature_shell_K", "temperature__degC", "temperature_1_degF", "light_intensity_V", "readout_a_V",
    "readout_b_V", "supply_voltage_V", "magnetic_field_uT", "pressure_hPa", "discharge_current_a_mA", "table_rate_deg_s",
    "table_angle_deg", "angle_inner_deg", "angle_outer_deg", "accel_x_m_s2", "accel_x_m_s", "truth_thermal_lag_deg_h", "truth_deg_h",
    "compensation_deg_h", "compensation_out_of_range", "time_ms", "time_s", "t", "sample", "", " ", "1", "nan", "None", "index", "level_0",
    "__index_level_0__", "$x$", r"$\frac{", "<script>alert(1)</script>", "a\nb", "\x1b[31mred", "../../etc/passwd", "a" * 3000, "é", "𝛼", "*", "{x}",
    "%s%n", "gyro_deg_h.1", "gyro_deg_h ", "GYRO_DEG_H", "gyro_furlong_fortnight", "x_1e400", "-", "#c", "'", '"', "constructor",
)  # fmt: skip
EXTREMES: Final = (
    0.0, -0.0, 1.0, -1.0, 1e-320, 5e-324, 1e-300, 1e-30, 1e10, 1e15, 9007199254740993.0, 1e30, 1e100, 1e154, 1e200, 1e300, 1.7e308, -1.7e308,
    float("nan"), float("inf"), float("-inf"), 255.0, 65535.0, 2147483648.0, -999.0, -273.15, -273.16, 85.0,
)  # fmt: skip


def healthy(rng: np.random.Generator, rows: int) -> Table:
    """Columns of a recording without a fault."""
    time = 2.0 * np.arange(rows)
    block = 20.0 + 15.0 * np.sin(2.0 * np.pi * time / (2.0 * max(rows, 2))) + rng.normal(0.0, 0.01, rows)
    shell = block + rng.normal(0.0, 0.02, rows) + 0.3
    return {
        "time_s": time,
        "gyro_deg_h": 0.5 + 0.01 * block + rng.normal(0.0, 0.02, rows),
        "temperature_block_degC": block,
        "temperature_shell_degC": shell,
        "light_intensity_V": 1.0 + 1e-3 * (block - 20.0) + rng.normal(0.0, 1e-4, rows),
    }


def _strange_values(rng: random.Random, values: np.ndarray) -> np.ndarray:
    n = len(values)
    generator = np.random.default_rng(rng.getrandbits(32))
    one, other = rng.choice(EXTREMES), rng.choice(EXTREMES)
    with np.errstate(all="ignore"):
        kinds: list[Callable[[], Any]] = [
            lambda: np.full(n, one),
            lambda: np.where(generator.random(n) < 0.01, one, values),
            lambda: np.where(np.arange(n) % 2, one, other),
            lambda: values * one,
            lambda: values + one,
            lambda: np.r_[np.full(n // 2, one), values[n // 2 :]],
            lambda: np.r_[values[: n - 1], [one] * min(n, 1)],
            lambda: np.cumsum(np.full(n, one)),
            lambda: np.sign(values - np.median(values)) * np.exp(np.clip(np.abs(generator.normal(0.0, 300.0, n)), 0.0, 709.0)),
            lambda: values[::-1],
            lambda: np.sort(values),
            lambda: generator.permutation(values),
            lambda: np.round(values, -rng.randrange(6)),
            lambda: values.astype(np.float16).astype(float),
            lambda: generator.integers(0, 2, n).astype(float),
            lambda: np.where(np.isin(np.arange(n), [0, 1, n - 1]), one, values),
            lambda: np.roll(values, n // 3),
        ]
        return np.asarray(rng.choice(kinds)(), dtype=float)


def _strange_times(rng: random.Random, time: np.ndarray) -> np.ndarray:
    n = len(time)
    generator = np.random.default_rng(rng.getrandbits(32))
    kinds: list[Callable[[], Any]] = [
        lambda: time + 1e18,
        lambda: time * 1e-15,
        lambda: time * 1e12,
        lambda: time * -1.0,
        lambda: np.cumsum(generator.exponential(1.0, n)),
        lambda: np.cumsum(10.0 ** generator.uniform(-6.0, 6.0, n)),
        lambda: np.floor(time / 60.0) * 60.0,
        lambda: np.mod(time, 256.0),
        lambda: np.where(np.arange(n) == n // 2, 1e15, time),
        lambda: np.where(np.arange(n) == n // 2, np.nan, time),
        lambda: np.r_[time[: n // 2], time[: n - n // 2]],
        lambda: np.r_[time[: n // 2], time[n // 2 :] + 3e7],
        lambda: 1.7e9 + time,
        lambda: 1.7e18 + time * 1e9,
        lambda: np.full(n, 5.0),
        lambda: time + generator.normal(0.0, 0.9, n),
        lambda: np.r_[time[:1] * 0.0, time[1:] + 1e9],
    ]
    return np.asarray(rng.choice(kinds)(), dtype=float)


def strange(rng: random.Random) -> Table:
    """A recording with one to three things wrong in its values, times or columns."""
    rows = rng.choice((0, 1, 2, 3, 19, 60, 200, 400, *([900] * 12)))
    table = healthy(np.random.default_rng(rng.getrandbits(32)), rows)
    for _ in range(rng.choice((1, 1, 1, 2, 3))):
        name = rng.choice(list(table))
        what = rng.randrange(8)
        if what == 0:
            table["time_s"] = _strange_times(rng, np.arange(rows) * 2.0)
        elif what == 1:
            table = {rng.choice(NAMES) if key == name else key: values for key, values in table.items()}
        elif what == 2:
            table[rng.choice(NAMES)] = _strange_values(rng, np.asarray(table[name], dtype=float))
        elif what == 3 and len(table) > 1:
            table.pop(name)
        else:
            table[name] = _strange_values(rng, np.asarray(table[name], dtype=float))
    return table


# --- CSV -------------------------------------------------------------------------------------------------------------------------

ENTRIES: Final = (
    "", "nan", "NaN", "NA", "null", "-", "--", "inf", "-Infinity", "1e308", "1e309", "-1e-400", "0x1F", "1_000", "1,5", "1.2.3", "١٢٣", "−5", "½", "TRUE",
    "None", "=1+1", "2020-02-30", "2024-01-01T00:00:00Z", "12:30:00", "'", '"', '""', "\x00", "\ufeff", "\u202e", "\x1b[31m", "a" * 9000, "#", "# x", "\r",
    "\x0c", "1e", "++1", "1d5", "*", "1" * 400, "0." + "3" * 400, "NaN(7)", "1 2", " 7 ", "7;8", "7\t8", "True", "1j",
)  # fmt: skip


def csv_bytes(table: Table, rng: random.Random) -> bytes:
    """Text of a table in a dialect drawn at random, with accidents."""
    separator = rng.choice((",",) * 8 + (";", "\t", " ", "|", ", ", ",,", "  "))
    end = rng.choice(("\n",) * 8 + ("\r\n", "\r", "\n\n", "\n\r"))
    comma = rng.random() < 0.15
    names = list(table)
    columns = [np.asarray(values, dtype=float) for values in table.values()]
    form = rng.choice(("%.17g", "%.17g", "%.6f", "%g", "%d", "%.3e", "%+.4f"))
    lines = []
    for k in range(len(columns[0]) if columns else 0):
        entries = []
        for values in columns:
            try:
                text = form % values[k]
            except (OverflowError, ValueError):
                text = "nan"
            entries.append(text.replace(".", ",") if comma else text)
        lines.append(separator.join(entries))
    header = separator.join(names)
    shape = rng.randrange(20)
    lines = {
        1: lines,
        2: [header, header, *lines],
        3: ["# " + header, *lines],
        4: ["", "", header, *lines],
        5: ["title", "10.1.2024", header, *lines],
    }.get(shape, [header, *lines])
    if shape == 6:
        lines.insert(1, separator.join("[deg/h]" for _ in names))
    for _ in range(rng.choice((0, 0, 1, 1, 2, 5))):
        if not lines:
            break
        k = rng.randrange(len(lines))
        what = rng.randrange(9)
        if what == 0:
            lines[k] += separator
        elif what == 1:
            lines[k] = lines[k][: len(lines[k]) // 2]
        elif what == 2:
            lines.insert(k, lines[rng.randrange(len(lines))])
        elif what == 3:
            lines.insert(k, rng.choice(ENTRIES))
        elif what == 4:
            lines = [line + separator for line in lines]
        elif what == 5:
            lines[k] = separator.join([lines[k]] * 50)
        else:
            parts = lines[k].split(separator)
            parts[rng.randrange(len(parts))] = rng.choice(ENTRIES)
            lines[k] = separator.join(parts)
    text = end.join(lines) + (end if rng.random() < 0.8 else "")
    encoding = rng.choice(("utf-8",) * 20 + ("utf-8-sig", "utf-16", "utf-32", "latin-1", "cp037", "utf-7"))
    return text.encode(encoding, errors="replace")


# --- other formats ---------------------------------------------------------------------------------------------------------------


def _strange_type(values: np.ndarray, rng: random.Random) -> Any:
    """The values under another type, as far as they go into it."""
    n = len(values)
    with np.errstate(all="ignore"):
        kinds: list[Callable[[], Any]] = [
            lambda: values.astype(np.float16),
            lambda: values.astype(">f8"),
            lambda: values.astype(np.float32),
            lambda: np.nan_to_num(values).astype(np.int8),
            lambda: np.nan_to_num(values).astype(np.uint64),
            lambda: values + 1j,
            lambda: values > 0.0,
            lambda: values.reshape(-1, 1),
            lambda: np.stack([values, values]),
            lambda: np.float64(values[0]) if n else np.float64(1.0),
            lambda: values[: n - 1],
            lambda: np.array([str(one) for one in values], dtype="S24"),
            lambda: values.astype(np.longdouble),
            lambda: np.zeros(n, dtype=[("a", "f8"), ("b", "S3")]),
            lambda: np.empty(0),
        ]
        return rng.choice(kinds)()


def _arrays(table: Table, rng: random.Random) -> Table:
    arrays = {name: np.asarray(values) for name, values in table.items()}
    for _ in range(rng.choice((0, 0, 0, 1, 2))):
        if arrays:
            name = rng.choice(list(arrays))
            if np.asarray(arrays[name]).dtype == float and np.ndim(arrays[name]) == 1:
                arrays[name] = _strange_type(arrays[name], rng)
    return arrays


def document(rng: random.Random, depth: int = 0) -> Any:
    """Plain data of any kind."""
    what = rng.randrange(10 if depth < 4 else 7)
    if what < 7:
        return rng.choice(
            (
                None,
                True,
                0,
                -1,
                10**30,
                0.5,
                1e308,
                float("inf"),
                "",
                "x",
                "1e5",
                "2024-01-01",
                "\x1b[2J",
                "$",
                "a" * 500,
                *ENTRIES[:12],
            )
        )
    if what == 7:
        return [document(rng, depth + 1) for _ in range(rng.randrange(4))]
    keys = ("kind", "unit", "latitude_deg", "pulse_arcsec", "notes", "columns", "period_s", "x", "schema", "", "inputs", *NAMES[:6])
    return {rng.choice(keys): document(rng, depth + 1) for _ in range(rng.randrange(5))}


def parquet_bytes(table: Table, rng: random.Random) -> bytes:
    """Parquet of types and metadata drawn at random."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    columns, names = [], []
    for name, stored in table.items():
        values = np.asarray(stored, dtype=float)
        what = rng.randrange(50)
        finite = np.clip(np.nan_to_num(values), -1e6, 1e6)
        array = {
            0: lambda: pa.array(values.astype(np.float32)),
            1: lambda: pa.array([str(one) for one in values]),
            2: lambda: pa.array(finite.astype(np.int64)).cast(pa.decimal128(20, 0)),
            3: lambda: pa.array([[one] for one in values], pa.list_(pa.float64())),
            4: lambda: pa.array(finite.astype(np.int64), pa.timestamp("ns", rng.choice((None, "UTC")))),
            5: lambda: pa.array(np.round(finite, 1)).dictionary_encode(),
            6: lambda: pa.array([None if k % 3 else float(one) for k, one in enumerate(values)], pa.float64()),
            7: lambda: pa.nulls(len(values)),
        }.get(what, lambda: pa.array(values))()
        columns.append(array)
        names.append(name)
    if names and rng.random() < 0.1:
        columns, names = [*columns, columns[0]], [*names, names[rng.randrange(len(names))]]
    made = pa.Table.from_arrays(columns, names=names)
    if rng.random() < 0.5:
        text = json.dumps(document(rng), default=str)
        made = made.replace_schema_metadata({rng.choice((b"rlgcomp.recording", b"pandas", b"rlgcomp")): text.encode()})
    buffer = io.BytesIO()
    pq.write_table(
        made, buffer, row_group_size=rng.choice((7, 100, 10_000)), compression=rng.choice(("none", "snappy", "gzip", "zstd"))
    )
    return buffer.getvalue()


def feather_bytes(table: Table, rng: random.Random) -> bytes:
    """Feather of the table."""
    import pyarrow as pa
    from pyarrow import feather

    made = pa.table({name: pa.array(np.asarray(values, dtype=float)) for name, values in table.items()})
    if rng.random() < 0.5:
        made = made.replace_schema_metadata({b"rlgcomp.recording": json.dumps(document(rng), default=str).encode()})
    buffer = io.BytesIO()
    feather.write_feather(made, buffer, compression=rng.choice(("uncompressed", "zstd", "lz4")))
    return buffer.getvalue()


def hdf5_bytes(table: Table, rng: random.Random) -> bytes:
    """HDF5 with groups, links, attributes and types drawn at random."""
    import h5py

    buffer = io.BytesIO()
    with h5py.File(buffer, "w") as file:
        group = file if rng.random() < 0.6 else file.create_group(rng.choice(("a", "a/b/c", "run [1]", "é")))
        for name, values in _arrays(table, rng).items():
            settings: dict[str, Any] = {}
            if np.ndim(values) == 1 and len(values) and rng.random() < 0.3:
                settings = {"chunks": True, "compression": rng.choice(("gzip", "lzf")), "shuffle": True}
            try:
                group.create_dataset(name.strip("/") or "_", data=values, **settings)
            except (TypeError, ValueError):
                continue
        for key, value in (
            (rng.choice(("kind", "unit", "rlgcomp_metadata", "metadata", "CLASS")), document(rng)) for _ in range(rng.randrange(3))
        ):
            target = rng.choice([group, *group.values()])
            try:
                target.attrs[key] = rng.choice((json.dumps(value, default=str), np.arange(3), b"\xff\xfe", h5py.Empty("f8")))
            except (TypeError, ValueError, RuntimeError):
                continue
        what = rng.randrange(7)
        if what == 0:
            group["loop"] = h5py.SoftLink("/")
        elif what == 1:
            group["dangling"] = h5py.SoftLink("/nowhere")
        elif what == 2:
            group["self"] = group
        elif what == 3:
            group["outside"] = h5py.ExternalLink("/etc/passwd", "/x")
    return buffer.getvalue()


def matlab_bytes(table: Table, rng: random.Random) -> bytes:
    """MATLAB 5 or 4 of types drawn at random."""
    from scipy.io import savemat

    arrays = {
        name[:30]: values
        for name, values in _arrays(table, rng).items()
        if name and name.isidentifier() and np.asarray(values).dtype != np.longdouble
    }
    if rng.random() < 0.4:
        arrays["rlgcomp_metadata"] = rng.choice((json.dumps(document(rng), default=str), np.arange(4.0), "", {"a": 1}))
    if rng.random() < 0.2:
        arrays = {"data": arrays}
    if rng.random() < 0.1:
        arrays["cell"] = np.array([1.0, "x", np.arange(3)], dtype=object)
    buffer = io.BytesIO()
    try:
        savemat(
            buffer,
            arrays,
            do_compression=rng.random() < 0.5,
            format=rng.choice(("5", "5", "4")),
            oned_as=rng.choice(("row", "column")),
        )
    except (TypeError, ValueError, NotImplementedError):
        savemat(buffer, {"time_s": np.arange(5.0)})
    return buffer.getvalue()


def npz_bytes(table: Table, rng: random.Random) -> bytes:
    """npz, also with objects in it and with members that are no arrays."""
    buffer = io.BytesIO()
    arrays = {
        name.replace("/", "_").replace("\x00", "") or "_": values for name, values in _arrays(table, rng).items() if len(name) < 200
    }
    if rng.random() < 0.2:
        arrays["objects"] = np.array([{"a": 1}, None], dtype=object)
    np.savez(buffer, **{name: values for name, values in arrays.items() if name != "file"})
    if rng.random() < 0.3:
        with zipfile.ZipFile(buffer, "a") as archive:
            archive.writestr(
                rng.choice(("note.txt", "../up.npy", "time_s.npy", "metadata.json")), rng.randbytes(rng.randrange(200))
            )
    return buffer.getvalue()


def excel_bytes(table: Table, rng: random.Random) -> bytes:
    """Excel, where openpyxl is installed; else a zip file that claims to be one."""
    buffer = io.BytesIO()
    frame = pd.DataFrame({name: np.asarray(values, dtype=float) for name, values in table.items()}).head(300)
    try:
        frame.to_excel(buffer, index=rng.random() < 0.3)
    except (ImportError, ValueError, TypeError):
        with zipfile.ZipFile(buffer, "w") as archive:
            archive.writestr("xl/workbook.xml", "<workbook/>")
    return buffer.getvalue()


MAKERS: Final[dict[str, Callable[[Table, random.Random], bytes]]] = {
    ".csv": csv_bytes,
    ".tsv": csv_bytes,
    ".txt": csv_bytes,
    ".csv.gz": lambda table, rng: gzip.compress(csv_bytes(table, rng)),
    ".parquet": parquet_bytes,
    ".feather": feather_bytes,
    ".h5": hdf5_bytes,
    ".mat": matlab_bytes,
    ".npz": npz_bytes,
    ".xlsx": excel_bytes,
}
OTHER_ENDINGS: Final = (".lvm", ".tdms", ".mf4", ".ulg", ".bag", ".db3", ".xls", ".hdf5", ".zip", "")


def splice(one: bytes, other: bytes, rng: random.Random) -> bytes:
    """Two files as one: head and tail, a block of one in the other, blocks exchanged, doubled or left out."""
    cut, at = rng.randrange(len(one) + 1), rng.randrange(len(other) + 1)
    size = 1 << rng.randrange(3, 12)
    return rng.choice(
        (
            one[:cut] + other[at:],
            one[:cut] + other[at : at + size] + one[cut + size :],
            one[:cut] + one[cut : cut + size] * rng.choice((0, 2, 50)) + one[cut + size :],
            one[cut:] + one[:cut],
            one + other,
            one[: -rng.choice((1, 4, 8, 100))],
            b"".join(one[k : k + size][::-1] for k in range(0, len(one), size)),
            one[:cut] + bytes(size) + one[cut + size :],
        )
    )


def file_bytes(rng: random.Random) -> tuple[str, bytes]:
    """Ending and content of a recording's file."""
    ending = rng.choice((*MAKERS, ".csv", ".parquet", ".h5", ".mat", ".csv", ".parquet"))
    content = MAKERS[ending](strange(rng), rng)
    if rng.random() < 0.25:
        other = rng.choice(list(MAKERS))
        content = splice(content, MAKERS[other](strange(rng), rng) if rng.random() < 0.5 else content, rng)
    if rng.random() < 0.06:
        ending = rng.choice((*MAKERS, *OTHER_ENDINGS))
    return ending, content
