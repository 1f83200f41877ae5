"""Programmes of a turntable, and the runs that they would be: within the rates and temperatures that were recorded."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Collection, Sequence
from typing import Final

import numpy as np
import pandas as pd

from rlgcomp.diagnosis.programmes import LONGEST_S, settable
from rlgcomp.errors import InputError
from rlgcomp.physics.mechanism import TABLE_ANGLE, TABLE_RATE, TEMPERATURE
from rlgcomp.recording import Recording
from rlgcomp.recording.motion import RATE, rate_deg_s
from rlgcomp.simulation import table_programme as table
from rlgcomp.simulation.table_programme import TableProgramme
from rlgcomp.simulation.turntable import Turntable

ANOTHER_K: Final = 5.0  # from the usual temperature: less is a room that drifts and a gyro that warms itself
_SURE_K: Final = 0.05  # a range that was recorded to within this of a number reaches it
_OF_THE_TABLE: Final = frozenset((RATE, "table_angle_deg", TABLE_RATE, TABLE_ANGLE, TEMPERATURE))  # what it tells of itself


def table_programmes(runs: Sequence[Recording]) -> list[TableProgramme]:
    """Presets and variants of them that turn no faster than what was recorded, none longer than 14 h; none for a table that stood.

    Rates in equal ratios both ways, sweeps through zero, slow turns, and the same turned with accelerations ten times apart, all
    at the usual temperature; where others were recorded, rates both ways at the coldest and the hottest of them as well.
    """
    fastest = max(float(np.abs(rate_deg_s(run)).max()) for run in runs)
    if fastest == 0.0:
        return []
    fastest = settable(fastest)
    rates = [settable(rate) for rate in np.geomspace(fastest / 60.0, fastest, 10)]
    both_ways = ", ".join(f"rate {sign * rate:g} 300" for rate in rates for sign in (1, -1))
    slow = ", ".join(f"rate {sign * rate:g} 900" for rate in rates[:4] for sign in (1, -1))
    near_zero = ", ".join(
        f"sweep {-ends:g} {ends:g} 1200, sweep {ends:g} {-ends:g} 1200"
        for ends in (settable(part * fastest) for part in (1.0, 0.1, 0.02))
    )
    swinging = ", ".join([f"rate {fastest:g} 60, rate {-fastest:g} 60"] * 15)
    texts = [both_ways, slow, near_zero, swinging, f"acceleration 2, {swinging}", f"acceleration 20, {swinging}"]
    texts += [f"rest 600, {both_ways}, {near_zero}"]
    usual, others = _room_temperatures(runs)
    made = [dataclasses.replace(TableProgramme.parse(text), room_degC=usual) for text in [*texts, *table.PRESETS]]
    made += [dataclasses.replace(TableProgramme.parse(text), room_degC=room) for room in others for text in (both_ways, texts[-1])]
    return [one for one in made if one.duration_s <= LONGEST_S and float(np.abs(one.corners[1]).max()) <= 1.05 * fastest]


def _room_temperatures(runs: Sequence[Recording]) -> tuple[float | None, list[float]]:
    """The usual temperature in degC and, well away from it, the coldest and the hottest recorded; None without thermometers."""
    with_thermometer = [run for run in runs if any(column.startswith("temperature_") for column in run.columns)]
    if not with_thermometer:
        return None, []
    recorded = np.concatenate([run.column(run.temperature_column) for run in with_thermometer])
    usual, *ends = float(np.median(recorded)), math.ceil(recorded.min() - _SURE_K), math.floor(recorded.max() + _SURE_K)
    return round(usual, 1), [float(end) for end in ends if abs(end - usual) >= ANOTHER_K]


@dataclasses.dataclass(frozen=True)
class RateTable:
    """What a table's monitors read in a run that has not been made.

    Parameters
    ----------
    like : Recording
        A recorded run: its sample period, latitude, columns and the name of its thermometer are kept.
    table : Turntable
    """

    like: Recording
    table: Turntable

    @classmethod
    def of(cls, runs: Sequence[Recording], read: Collection[str]) -> RateTable:
        """Of the recorded runs, for sets that read some columns.

        Raises
        ------
        InputError
            A column that is read is none that a table tells.
        """
        like = max(runs, key=lambda run: run.duration_s)
        thermometer = _thermometer(like)
        unknown = set(read) - _OF_THE_TABLE - {thermometer}
        if unknown or RATE not in like:
            raise InputError(f"{like.name}: what {', '.join(sorted(unknown)) or RATE} reads in another run is not known")
        temperature = like.column(thermometer) if thermometer else np.zeros(2)
        table = Turntable(
            latitude_deg=like.metadata.latitude_deg, room_drift_K=0.0, warm_up_K=max(float(temperature[-1] - temperature[0]), 0.0)
        )
        return cls(like, table)

    def run_of(self, programme: TableProgramme) -> Recording:
        """The run that a programme would be, its gyro zero."""
        _, recorded = self.table.simulate(programme, self.like.period_s, 0)
        names = {"temperature_block_degC": _thermometer(self.like) or "temperature_block_degC"}
        frame = pd.DataFrame(recorded).rename(columns=names).assign(gyro_deg_h=0.0)
        kept = [column for column in frame.columns if column in self.like or column in ("time_s", "gyro_deg_h")]
        metadata = dataclasses.replace(self.like.metadata, lead_in_s=0.0)
        return Recording(frame[kept], metadata, name="next")


def _thermometer(run: Recording) -> str | None:
    return run.temperature_column if any(column.startswith("temperature_") for column in run.columns) else None
