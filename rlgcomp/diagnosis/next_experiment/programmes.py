"""Programmes that a chamber or a turntable can run: within the temperatures and rates that were recorded or are stated."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from typing import Final, NamedTuple, Self

import numpy as np

from rlgcomp.diagnosis.next_experiment.laboratory import thermometer_of
from rlgcomp.errors import InputError
from rlgcomp.numerics.filters import rate_per_min
from rlgcomp.recording import Recording
from rlgcomp.recording.motion import rate_deg_s
from rlgcomp.simulation import programme as chamber
from rlgcomp.simulation import table_programme as table
from rlgcomp.simulation.programme import Hold, Programme, Ramp
from rlgcomp.simulation.table_programme import TableProgramme

LONGEST_S: Final = 14.0 * 3600.0
_MARGIN_K: Final = 2.0
_SLOWEST_DEG_C_MIN: Final = 0.05
_SHARES: Final = np.linspace(1.0, 0.2, 41)  # of the recorded range, the largest that fits being taken
_GRIDS_K: Final = (1.0, 0.1)  # temperatures are multiples of the first that leaves the range so many steps:
_STEPS_IN_RANGE: Final = 20
_SURE_K: Final = 0.05  # a range that was recorded to within this of a number reaches it
_SURE: Final = 0.005  # the same of a rate, relative
_ANOTHER_K: Final = 5.0  # from the usual temperature: less is a room that drifts and a gyro that warms itself
_SAME_K: Final = 0.5  # thermometers and chambers are no surer of where they are


class ChamberRange(NamedTuple):
    """What a chamber can do: set points in degC, and the fastest ramp in degC/min."""

    coldest_degC: float
    hottest_degC: float
    fastest_degC_min: float

    @classmethod
    def of(cls, given: Sequence[float]) -> Self:
        """From three numbers.

        Raises
        ------
        InputError
            They are no range.
        """
        found = cls(*map(float, given)) if len(given) == len(cls._fields) else None
        if found is None or not (math.isfinite(sum(found)) and found[0] < found[1] and found[2] > 0.0):
            received = " ".join(f"{number:g}" for number in given)
            raise InputError(
                f"the chamber's range is {received}; give its lowest and highest temperature in degC and its fastest ramp "
                "in degC/min, as -40 70 2"
            )
        return found


def chamber_programmes(runs: Sequence[Recording], within: ChamberRange | None = None) -> list[Programme]:
    """Presets and variants of them that stay within what was recorded, or what the chamber can do where that is told; none longer
    than 14 h, in numbers that can be set.

    Full cycles at the usual and at half the rate, up and down once, long dwells, reversals at mid range, minor loops, stairs, two
    rates in one run. What takes too long at the rates there are goes less far from the middle.
    """
    cold, hot, start, rate = _chamber_limits(runs)
    if within is not None:
        cold, hot, rate = within.coldest_degC, within.hottest_degC, min(within.fastest_degC_min, chamber.FASTEST_DEG_C_MIN)
        start = min(max(start, cold), hot)
    variants = [_variants(cold, hot, start, rate, share) for share in _SHARES]
    made = [next((one for one in same if one.duration_s <= LONGEST_S), None) for same in zip(*variants, strict=True)]
    presets = [Programme.parse(name) for name in chamber.PRESETS]
    return [one for one in [*made, *presets] if one is not None and one.duration_s <= LONGEST_S and _within(one, cold, hot, rate)]


def _variants(cold: float, hot: float, start: float, rate: float, share: float) -> list[Programme]:
    """Programmes that use so much of the range about its middle."""
    middle = 0.5 * (cold + hot)
    grid = next(step for step in _GRIDS_K if share * (hot - cold) >= _STEPS_IN_RANGE * step or step == _GRIDS_K[-1])
    cold, hot = (middle + share * (end - middle) for end in (cold, hot))
    cold, hot = grid * math.ceil((cold - _SURE_K) / grid), grid * math.floor((hot + _SURE_K) / grid)
    span = hot - cold
    quarter, slow = 0.25 * span, settable(max(0.5 * rate, _SLOWEST_DEG_C_MIN))

    def at(temperature_degC: float) -> str:
        return f"{min(max(grid * round(temperature_degC / grid), cold), hot) + 0.0:.4g}"

    rate = settable(rate)
    low, mid, high = at(cold), at(middle), at(hot)
    start_at = at(middle + share * (start - middle))
    texts = [
        f"ramp {high} {rate}, hold 60, ramp {low} {rate}, hold 60, ramp {start_at} {rate}, hold 60",
        f"ramp {high} {slow}, hold 60, ramp {low} {slow}, hold 60, ramp {start_at} {slow}, hold 60",
        f"ramp {high} {rate}, hold 180, ramp {low} {rate}, hold 180",
        f"ramp {high} {rate}, ramp {mid} {rate}, hold 90, ramp {high} {rate}, ramp {low} {rate}, "
        f"ramp {mid} {rate}, hold 90, ramp {low} {rate}, ramp {start_at} {rate}, hold 60",
        ", ".join(
            f"ramp {at(to)} {rate}, hold 45"
            for to in (hot, middle, hot - quarter, cold, cold + quarter, middle - 0.1 * span, middle + 0.1 * span, start)
        ),
        ", ".join(f"ramp {at(to)} {rate}, hold 60" for to in np.r_[np.linspace(middle, hot, 3), np.linspace(hot, cold, 5)[1:]]),
        f"ramp {high} {rate}, hold 45, ramp {low} {rate}, hold 45, ramp {high} {slow}, hold 45, ramp {low} {slow}, hold 45",
        ", ".join([f"ramp {at(middle + quarter)} {rate}, ramp {at(middle - quarter)} {rate}"] * 6),
        f"ramp {high} {rate}, hold 60, ramp {low} {rate}, hold 60",
    ]
    return [_without_empty_steps(Programme.parse(f"start {start_at}, hold 30, {text}")) for text in texts]


def _chamber_limits(runs: Sequence[Recording]) -> tuple[float, float, float, float]:
    """Coldest, hottest and usual starting temperature in degC and fastest ramp in degC/min: as told, or else as recorded."""
    lows, highs, starts, rates = [], [], [], []
    for run in runs:
        temperature = run.column(run.temperature_column)
        starts.append(float(temperature[0]))
        lows.append(float(temperature.min()))
        highs.append(float(temperature.max()))
        rates.append(float(np.quantile(np.abs(rate_per_min(temperature, run.time_s, 600.0)), 0.99)))
        try:
            programme = Programme.parse(str(run.metadata.notes.get("programme", "")))
        except InputError:
            continue
        ramps = [step for step in programme.steps if isinstance(step, Ramp)]
        lows.append(float(programme.corners[1].min()))
        highs.append(float(programme.corners[1].max()))
        rates += [step.rate_degC_min for step in ramps]
    rate = max(*rates, _SLOWEST_DEG_C_MIN)
    return min(lows), max(highs), float(np.median(starts)), min(rate, chamber.FASTEST_DEG_C_MIN)


def _without_empty_steps(programme: Programme) -> Programme:
    """The programme without ramps to where the chamber is already; two holds in a row become one."""
    at_degC, steps = programme.start_degC, list[Hold | Ramp]()
    for step in programme.steps:
        if isinstance(step, Ramp):
            if abs(step.to_degC - at_degC) >= _SAME_K:
                at_degC = step.to_degC
                steps.append(step)
        elif steps and isinstance(steps[-1], Hold):
            steps[-1] = Hold(steps[-1].minutes + step.minutes)
        else:
            steps.append(step)
    return Programme(programme.start_degC, tuple(steps))


def settable(rate: float) -> float:
    """A rate in two digits, no faster than it is.

    >>> settable(0.4853), settable(0.4998), settable(39.99)
    (0.48, 0.5, 40.0)
    """
    grid = 10.0 ** (math.floor(math.log10(rate * (1.0 + _SURE))) - 1)
    return float(f"{grid * math.floor(rate * (1.0 + _SURE) / grid * (1.0 + 1e-12)):.2g}")


def _within(one: Programme, cold: float, hot: float, rate: float) -> bool:
    temperatures = one.corners[1]
    fastest = max((step.rate_degC_min for step in one.steps if isinstance(step, Ramp)), default=0.0)
    return bool(temperatures.min() >= cold - _MARGIN_K and temperatures.max() <= hot + _MARGIN_K and fastest <= 1.05 * rate)


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
    with_thermometer = [run for run in runs if thermometer_of(run)]
    if not with_thermometer:
        return None, []
    recorded = np.concatenate([run.column(run.temperature_column) for run in with_thermometer])
    usual, *ends = float(np.median(recorded)), math.ceil(recorded.min() - _SURE_K), math.floor(recorded.max() + _SURE_K)
    return round(usual, 1), [float(end) for end in ends if abs(end - usual) >= _ANOTHER_K]
