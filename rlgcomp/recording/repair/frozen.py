"""Monitors that freeze part-way through a run: a thermometer while another moves, any monitor whose last digit was alive."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Sequence
from typing import Final

import numpy as np
import numpy.typing as npt
import pandas as pd

from rlgcomp.numerics.column_ranges import may_hold, step_extent
from rlgcomp.recording import TIME, is_compensation, is_gyro
from rlgcomp.recording.repair.channels import ENCODERS
from rlgcomp.recording.repair.context import Array, Context, Rows

FROZEN_S: Final = 600.0
FROZEN_WHILE_OTHERS_MOVE_K: Final = 2.0
FEWEST_SAMPLES: Final = 100  # of a stretch, and of what the monitor does elsewhere
# Share of samples elsewhere that lie above both neighbours or below both. Noise in the last digit gives more, two values that
# alternate by chance just as many; set points, slow courses with few digits and readings that are held give next to none.
_ALIVE: Final = 0.25
# Of a frozen thermometer that shows no noise: how far it is off what another foresees, over how far it is off elsewhere (rms).
_ASTRAY: Final = 5.0
_MOTION: Final = (*ENCODERS, "table_rate_deg_s")  # a table stands still by right


@dataclasses.dataclass(frozen=True)
class Stretch:
    """A stretch of rows throughout which a monitor keeps exactly one value, though elsewhere its last digit is alive."""

    column: str
    start: int
    stop: int
    value: float
    from_s: float
    to_s: float


def frozen_stretches(table: pd.DataFrame) -> list[Stretch]:
    """Where monitors are frozen, column by column: for ten minutes and a hundred samples, or longer."""
    time_s = table[TIME].to_numpy()
    fewest = max(FEWEST_SAMPLES, 1 + int(FROZEN_S / step_extent(time_s).greatest)) if len(time_s) > 1 else FEWEST_SAMPLES
    found = []
    for column in monitors(table.columns):
        values = table[column].to_numpy()
        if len(values) < 2 * fewest or not may_hold(values, fewest):
            continue
        starts, stops = _repeats(values)
        long = (stops - starts >= FEWEST_SAMPLES) & (time_s[stops - 1] - time_s[starts] >= FROZEN_S)
        spans = list(zip(starts[long].tolist(), stops[long].tolist(), strict=True))
        if spans and _alive(values[~_covered(spans, len(values))]):
            found += [Stretch(column, a, b, float(values[a]), float(time_s[a]), float(time_s[b - 1])) for a, b in spans]
    return found


def monitors(columns: Iterable[object]) -> list[str]:
    """What is neither time, nor a gyro, nor a table's motion, nor what a compensation left."""
    return [name for name in map(str, columns) if name not in (TIME, *_MOTION) and not (is_gyro(name) or is_compensation(name))]


def said_of(stretches: Sequence[Stretch]) -> dict[str, str]:
    """What to say of each column that is frozen somewhere: where it is, and at which value."""
    said: dict[str, str] = {}
    for one in stretches:
        place = f"at {one.value:.6g} from {one.from_s:.6g} to {one.to_s:.6g} s"
        said[one.column] = f"{said[one.column]}, {place}" if one.column in said else f"frozen {place}"
    return said


def frozen_monitors(table: pd.DataFrame, context: Context) -> pd.DataFrame:
    stretches = [] if context.computed else frozen_stretches(table)
    first = {one.column: one.start for one in reversed(stretches)}
    for column, said in said_of(stretches).items():
        context.add(
            "noted",
            f"{said}, though elsewhere it changes from sample to sample: it tells nothing there; leave that out with "
            f"RUN@START:STOP, or the column with --drop {column}",
            column,
            first[column],
        )
    return table


def frozen_thermometers(table: pd.DataFrame, context: Context) -> pd.DataFrame:
    """Leave out rows where a thermometer keeps one value while another moves, if elsewhere it shows noise or follows that other.

    Set points, rooms that are kept at a temperature and thermometers of few digits stand still by right.
    """
    thermometers = [str(column) for column in table.columns if str(column).endswith("_degC")]
    if len(thermometers) < 2:
        return table
    spoilt = np.zeros(len(table), dtype=np.bool_)
    time_s = table[TIME].to_numpy()
    fewest = 1 + int(FROZEN_S / context.steps(table).greatest)
    for column in (name for name in thermometers if may_hold(table[name].to_numpy(), fewest)):
        starts, stops = _repeats(table[column].to_numpy())
        long = time_s[stops - 1] - time_s[starts] >= FROZEN_S
        spans = list(zip(starts[long].tolist(), stops[long].tolist(), strict=True))
        elsewhere = ~_covered(spans, len(table))
        alive = bool(spans) and _alive(table[column].to_numpy()[elsewhere])
        for start, stop in spans:
            others = table[[other for other in thermometers if other != column]]
            moved = others.iloc[start:stop].max() - others.iloc[start:stop].min()
            if moved.max() <= FROZEN_WHILE_OTHERS_MOVE_K:
                continue
            if alive or _astray(table[column].to_numpy(), others[moved.idxmax()].to_numpy(), slice(start, stop), elsewhere):
                lasted = time_s[stop - 1] - time_s[start]
                context.add("repaired", f"frozen for {lasted:.0f} s while another thermometer moved, rows left out", column, start)
                spoilt[start:stop] = True
    return table[~spoilt] if spoilt.any() else table


def _alive(values: Array) -> bool:
    """Whether a monitor goes to and fro from sample to sample, as noise in its last digit does."""
    steps = np.sign(np.diff(values))
    return len(values) >= FEWEST_SAMPLES and float(np.mean(steps[1:] * steps[:-1] < 0.0)) > _ALIVE


def _astray(values: Array, other: Array, stretch: slice, elsewhere: Rows) -> bool:
    """Whether a stretch leaves the straight line on another thermometer that the rest of the run keeps to."""
    elsewhere = elsewhere & np.isfinite(values) & np.isfinite(other)
    if np.count_nonzero(elsewhere) < FEWEST_SAMPLES or np.ptp(other[elsewhere]) == 0.0:
        return False
    line = np.polynomial.Polynomial.fit(other[elsewhere], values[elsewhere], 1)
    off = np.abs(values - line(other))
    return float(np.nanmax(off[stretch])) > _ASTRAY * float(np.sqrt(np.mean(off[elsewhere] ** 2)))


def _covered(spans: Sequence[tuple[int, int]], rows: int) -> Rows:
    """Mask of the rows that any of the spans covers."""
    mask = np.zeros(rows, dtype=np.bool_)
    for start, stop in spans:
        mask[start:stop] = True
    return mask


def _repeats(values: Array) -> tuple[npt.NDArray[np.intp], npt.NDArray[np.intp]]:
    """Starts and stops of the runs of two and more equal consecutive values."""
    same = np.flatnonzero(values[1:] == values[:-1])
    apart = np.diff(same) > 1
    return same[np.r_[True, apart][: len(same)]], same[np.r_[apart, True][: len(same)]] + 2
