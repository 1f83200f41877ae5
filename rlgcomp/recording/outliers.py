"""Knocks at the chamber and faults of the logger: samples far beyond any noise, of gyro and monitors, and monitors that freeze."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

import numpy as np
import numpy.typing as npt
import pandas as pd

from rlgcomp.numerics.robust import SD_OF_MAD, stretches
from rlgcomp.recording import TIME, Recording, is_gyro
from rlgcomp.recording.count_errors import counting_deg_h, miscounts_in, without_miscounts
from rlgcomp.recording.repair.frozen import frozen_stretches, said_of

Rows = npt.NDArray[np.bool_]
_FAR: Final = 30.0  # standard deviations of a sample: at 1 Hz one such sample shifts the mean of 100 s by three of its own
_OFF: Final = 4.0  # standard deviations of a sample, by which all of several in a row are off the same way,
_IN_A_ROW: Final = 3  # so many at least,
_ABRUPT: Final = 0.5  # their course beginning and ending with so much of what they are off by: what noise never does
_LASTS_S: Final = 60.0  # a knock is over by then
_FEWEST: Final = 5  # samples on either side, where they are far apart
_SHARE: Final = 0.05  # of the samples: what stands off more often is the gyro's own
_USUAL: Final = 0.99  # of the samples of a monitor are no further off the middle of their neighbours than is usual
_TALL: Final = 8.0  # times that: a spike,
_ALONE: Final = 0.2  # if its neighbours differ by less of it
_FEW: Final = 0.005  # of the samples: more are the monitor's own


def knocks_in(run: Recording, gyro: str | None) -> tuple[Rows, str]:
    """Samples that stand off their neighbours' median, of a turning run as its table turns, and what they look like, in words."""
    none = np.zeros(len(run), dtype=np.bool_), ""
    if run.metadata.kind == "turntable":
        far, _, said = miscounts_in(run, gyro)
        return far, said
    rate_deg_h = run.rate_deg_h(gyro)
    sample_deg_h = SD_OF_MAD / math.sqrt(2.0) * float(np.median(np.abs(np.diff(rate_deg_h)))) or counting_deg_h(run, gyro)
    if not sample_deg_h > 0.0:
        return none
    steps, reach = np.abs(np.diff(rate_deg_h)) / sample_deg_h, max(_FEWEST, math.ceil(_LASTS_S / run.period_s))
    if not ((steps > _FAR).any() or _in_a_row(_off_blocks(rate_deg_h, reach) / sample_deg_h).any()):
        return none
    usual = pd.Series(rate_deg_h).rolling(2 * reach + 1, center=True, min_periods=1).median().to_numpy()
    off = (rate_deg_h - usual) / sample_deg_h
    far, jumps = np.abs(off) > _FAR, np.r_[True, steps > _FAR, True]
    for start, stop in stretches(far):
        far[start:stop] = jumps[start] and jumps[stop]  # the tip of a steep course is no knock
    for start, stop in stretches(_in_a_row(off)):
        edges = np.r_[math.inf, steps, math.inf][[start, stop]]
        height, lasts_s = abs(float(off[start:stop].mean())), (stop - start) * run.period_s
        far[start:stop] |= edges.min() > _ABRUPT * height and height * (stop - start) > _FAR and lasts_s <= _LASTS_S
    count = int(far.sum())
    if not 0 < count <= _SHARE * len(far):
        return none
    furthest = float(np.max(np.abs(off[far])))
    stand, whose = ("samples stand", "their") if count > 1 else ("sample stands", "its")
    return far, (
        f"{count} {stand} up to {furthest:.0f} standard deviations off {whose} neighbours, the first at "
        f"{run.time_s[far][0]:.6g} s: a knock or a fault of the logger"
    )


def _off_blocks(values: npt.NDArray[np.float64], block: int) -> npt.NDArray[np.float64]:
    """How far values are off the median of so many in a row, which takes a moment; the last of them are looked at once more."""
    whole, last = values[: len(values) // block * block].reshape(-1, block), values[-block:]
    return np.r_[(whole - np.median(whole, axis=1, keepdims=True)).ravel(), last - np.median(last)]


def _in_a_row(off: npt.NDArray[np.float64]) -> Rows:
    """Samples off the same way, several in a row; `off` in standard deviations of one."""
    rows = np.zeros(len(off), dtype=np.bool_)
    for beyond in (off > _OFF, off < -_OFF):
        for start, stop in stretches(beyond):
            rows[start:stop] = stop - start >= _IN_A_ROW
    return rows


def without_knocks(run: Recording, gyro: str | None) -> tuple[Recording, str | None]:
    """A run less the samples that stand off their neighbours' median, and what to say of them; turning, its motion must stay whole,
    and they are mended."""
    if run.metadata.kind == "turntable":
        return without_miscounts(run, gyro)
    far, said = knocks_in(run, gyro)
    if not said:
        return run, None
    left = run.replace(table=run.table[~far], truth=None if run.truth is None else run.truth[~far])
    return left, f"{run.name}: {said}, left out."


def spikes_in(run: Recording) -> dict[str, tuple[Rows, str]]:
    """Single wild samples of the monitors of a chamber or static run, by column, and what they look like, in words."""
    found: dict[str, tuple[Rows, str]] = {}
    if run.metadata.kind == "turntable":
        return found
    for column in run.columns:
        if column == TIME or is_gyro(column):
            continue
        spikes = _spikes(run.column(column))
        count = int(spikes.sum())
        if 0 < count <= _FEW * len(spikes):
            samples = f"{count} samples that stand" if count > 1 else "1 sample that stands"
            first_s = run.time_s[spikes][0]
            found[column] = spikes, f"{samples} off both neighbours as no other does, the first at {first_s:.6g} s"
    return found


def without_spikes(run: Recording, columns: Sequence[str] | None = None) -> tuple[Recording, list[str]]:
    """A chamber or static run whose monitors' single wild samples lie between their neighbours, and what to say of them.

    Of these columns only, where they are given.
    """
    mended, remarks = {}, []
    for column, (spikes, said) in spikes_in(run).items():
        if columns is not None and column not in columns:
            continue
        values, good = run.column(column), ~spikes
        mended[column] = np.where(spikes, np.interp(run.time_s, run.time_s[good], values[good]), values)
        remarks.append(f"{run.name}: {column} has {said}: taken for faults of the logger, and put between the neighbours.")
    return (run.replace(table=run.table.assign(**mended)) if mended else run), remarks


def undisturbed(runs: Sequence[Recording], gyro: str | None) -> tuple[list[Recording], list[str]]:
    """Runs without knocks and spikes, and what to say of them."""
    calm = [without_knocks(run, gyro) for run in runs]
    found = [without_spikes(run) for run, _ in calm]
    remarks = [said for _, said in calm if said is not None]
    return [run for run, _ in found], [*remarks, *(line for _, said in found for line in said)]


def _spikes(values: npt.NDArray[np.float64]) -> Rows:
    """Samples far off the middle of their two neighbours, which are near each other."""
    off = np.abs(values[1:-1] - 0.5 * (values[:-2] + values[2:]))
    usual = float(np.nanquantile(off, _USUAL)) if len(off) else 0.0
    if not usual > 0.0:
        return np.zeros(len(values), dtype=np.bool_)
    apart = np.abs(values[2:] - values[:-2])
    return np.r_[False, (off > _TALL * usual) & (apart < _ALONE * off), False]


def frozen_in(run: Recording) -> list[str]:
    """What to say of monitors that freeze part-way through a run: its windows leave those stretches out."""
    return [
        f"{run.name}: {column} is {said}: windows in which it tells nothing are left out; --drop {column} keeps them."
        for column, said in said_of(frozen_stretches(run.table)).items()
    ]
