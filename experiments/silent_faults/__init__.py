"""Faults of a laboratory that leave a readable file: which message notices each in inspect, train, evaluate and diagnose."""
# ruff: noqa: ARG001  changes are called alike

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Final

import numpy as np
import pandas as pd
from scipy.ndimage import uniform_filter1d

import rlgcomp as rlg
from rlgcomp.errors import InputError
from rlgcomp.recording.comparison import compare
from rlgcomp.report.inspection import outlier_findings
from rlgcomp.report.messages import Message
from rlgcomp.simulation.random_units import simulated_unit

SIMULATOR: Final = {
    "mechanisms": [
        {"thermal_polynomial": {"degree": 2, "c1_deg_h_K": 0.002, "c2_deg_h_K2": 0.00002}},
        {"temperature_rate": {"k_deg_h_min_K": 0.02}},
    ],
    "noise": {"angle_random_walk_deg_sqrt_h": 0.0003},
}
PROGRAMMES: Final = (
    "start 20, hold 60, ramp -20 1, hold 80, ramp 45 1, hold 60",
    "start 20, hold 40, ramp 50 1, hold 60, ramp -10 0.7, hold 60",
    "start 0, hold 30, ramp 40 0.7, hold 60, ramp 10 1, hold 40",
)
Change = Callable[[pd.DataFrame, pd.DataFrame], pd.DataFrame]
GYRO, BLOCK, LIGHT = "gyro_deg_h", "temperature_block_degC", "light_intensity_V"
_rng = np.random.default_rng(0)


def _times(column: str, factor: float, offset: float = 0.0) -> Change:
    return lambda table, other: table.assign(**{column: factor * table[column] + offset})


def _some(column: str, value: float, share: float = 0.01) -> Change:
    return lambda table, other: table.assign(**{column: table[column].mask(_rng.random(len(table)) < share, value)})


def _thermometers(factor: float, offset: float) -> Change:
    return lambda table, other: table.assign(
        **{name: factor * table[name] + offset for name in table.columns if name.endswith("_degC")}
    )


def _clipped(table: pd.DataFrame, other: pd.DataFrame) -> pd.DataFrame:
    low, high = np.quantile(table[GYRO], [0.1, 0.9])
    return table.assign(**{GYRO: table[GYRO].clip(low, high)})


def _spliced(table: pd.DataFrame, other: pd.DataFrame) -> pd.DataFrame:
    half = min(len(table), len(other)) // 2
    return table.assign(**{GYRO: np.r_[table[GYRO][:half], other[GYRO][half : 2 * half], table[GYRO][2 * half :]]})


def _interpolated(table: pd.DataFrame, other: pd.DataFrame) -> pd.DataFrame:
    rows = np.arange(len(table))
    return table.assign(**{GYRO: np.interp(rows, rows[::3], table[GYRO].to_numpy()[::3])})


FAULTS: Final[dict[str, Change]] = {
    "none": lambda table, other: table,
    "gyro in deg/s": _times(GYRO, 1 / 3600.0),
    "gyro in rad/s": _times(GYRO, np.pi / 180.0 / 3600.0),
    "sign of the gyro reversed": _times(GYRO, -1.0),
    "time in ms": _times("time_s", 1000.0),
    "time in minutes": _times("time_s", 1 / 60.0),
    "thermometers in degF": _thermometers(1.8, 32.0),
    "thermometers in K": _thermometers(1.0, 273.15),
    "one thermometer in degF": _times(BLOCK, 1.8, 32.0),
    "one thermometer in K": _times(BLOCK, 1.0, 273.15),
    "degC and K mixed in one thermometer": lambda table, other: table.assign(
        **{BLOCK: table[BLOCK].where(np.arange(len(table)) % 2 > 0, table[BLOCK] + 273.15)}
    ),
    "light in mV": _times(LIGHT, 1000.0),
    "temperature columns swapped": lambda table, other: table.rename(
        columns={BLOCK: "temperature_shell_degC", "temperature_shell_degC": BLOCK}
    ),
    "gyro and temperature swapped": lambda table, other: table.rename(columns={GYRO: BLOCK, BLOCK: GYRO}),
    "gyro clipped": _clipped,
    "1 % zeros in the gyro": _some(GYRO, 0.0),
    "1 % zeros in a thermometer": _some(BLOCK, 0.0),
    "1 % of -999 in a thermometer": _some(BLOCK, -999.0),
    "10 % of the gyro held": lambda table, other: table.assign(
        **{GYRO: table[GYRO].mask(_rng.random(len(table)) < 0.1).ffill().bfill()}
    ),
    "gyro held for three samples": lambda table, other: table.assign(
        **{GYRO: table[GYRO].to_numpy()[np.arange(len(table)) // 3 * 3]}
    ),
    "gyro interpolated": _interpolated,
    "gyro smoothed over 300 s": lambda table, other: table.assign(**{GYRO: uniform_filter1d(table[GYRO].to_numpy(), 60)}),
    "thermometer smoothed over 300 s": lambda table, other: table.assign(**{BLOCK: uniform_filter1d(table[BLOCK].to_numpy(), 60)}),
    "monitors late by 300 s": lambda table, other: table.assign(
        **{name: table[name].shift(60).bfill() for name in table.columns if name not in ("time_s", GYRO)}
    ),
    "thermometer frozen": lambda table, other: table.assign(**{BLOCK: table[BLOCK].where(np.arange(len(table)) < 1500).ffill()}),
    "thermometer with steps of 0.5 K": lambda table, other: table.assign(**{BLOCK: (2.0 * table[BLOCK]).round() / 2.0}),
    "one tenth of the samples, picked": lambda table, other: table.iloc[::10],
    "one tenth of the samples, averaged": lambda table, other: (
        table.iloc[: len(table) // 10 * 10].groupby(np.arange(len(table) // 10 * 10) // 10).mean()
    ),
    "half of another run spliced in": _spliced,
    "the same run under two names": lambda table, other: other,
    "another run under another clock": lambda table, other: other.assign(time_s=other["time_s"] + 12345.678),
    "another run with an offset": lambda table, other: other.assign(**{GYRO: other[GYRO] + 1.0}),
    "another run, cut out": lambda table, other: other.iloc[400:2000],
    "an offset of 1 deg/h": _times(GYRO, 1.0, 1.0),
    "a drift of 1 deg/h": lambda table, other: table.assign(**{GYRO: table[GYRO] + np.linspace(0.0, 1.0, len(table))}),
    "rows shuffled in blocks": lambda table, other: table.assign(**{GYRO: np.roll(table[GYRO].to_numpy(), len(table) // 3)}),
    "noise ten times as large": lambda table, other: table.assign(**{GYRO: table[GYRO] + _rng.normal(0.0, 0.1, len(table))}),
}


def healthy_messages(seed: int) -> list[Message]:
    """Messages of the comparison of two or three healthy runs of a random gyro, on random programmes and periods.

    Parameters
    ----------
    seed : int
    """
    rng = np.random.default_rng(seed)
    unit = simulated_unit(seed)
    runs = []
    period_s = float(rng.choice([1.0, 2.0, 5.0, 10.0]))
    for k in range(int(rng.integers(2, 4))):
        low, high = rng.uniform(-30.0, 15.0), rng.uniform(30.0, 60.0)
        order = (low, high) if rng.random() < 0.5 else (high, low)
        start, rate = rng.uniform(-10.0, 40.0), rng.uniform(0.4, 1.5)
        legs = ", ".join(f"ramp {value:.0f} {rate:.2f}, hold {rng.integers(20, 90)}" for value in (*order, rng.uniform(0.0, 30.0)))
        own_s = period_s if rng.random() < 0.7 else float(rng.choice([1.0, 2.0, 5.0, 10.0]))
        programme = f"start {start:.0f}, hold {rng.integers(10, 60)}, {legs}"
        runs.append(unit.simulate(programme, seed=100 * seed + k, step_s=own_s, name=f"run{k}"))
    return list(compare(runs))


def noticed(name: str, folder: Path, *, diagnosed: bool) -> dict[str, list[str]]:
    """Codes of the messages that a fault of one of three runs raises, by command; more than those of healthy runs.

    Parameters
    ----------
    name : str
        Of the fault.
    folder : Path
        Receives the files.
    diagnosed : bool
        Whether a diagnosis is made too, which takes a while.
    """
    unit = rlg.Simulator.from_mapping(SIMULATOR)
    runs = [unit.simulate(text, seed=k, step_s=5.0, name=f"run{k}") for k, text in enumerate(PROGRAMMES)]
    table = FAULTS[name](runs[1].table, runs[0].table).reset_index(drop=True)
    path = folder / "faulty.parquet"
    table.to_parquet(path)
    try:
        faulty = rlg.read(path)
    except InputError:
        return {command: ["refused"] for command in ("inspect", "train", "evaluate", "diagnose")} | {"verdict": ["-"]}
    findings = [finding.message for finding in (*faulty.findings, *outlier_findings(faulty))]
    together = [runs[0], faulty, runs[2]]
    differing = list(compare(together))
    codes = {"inspect": _codes([*findings, *differing])}
    codes["train"] = _or_refused(
        lambda: [*findings, *differing, *rlg.Compensator(rlg.CubicLeastSquares(linear="dynamics")).fit(together).remarks_]
    )
    healthy = rlg.Compensator(rlg.CubicLeastSquares(linear="dynamics")).fit([runs[0], runs[2]])
    codes["evaluate"] = _or_refused(lambda: [*findings, *rlg.evaluate(healthy, [faulty], compare=False).remarks])
    if diagnosed:
        try:
            diagnosis = rlg.diagnose(unit, train=[runs[0], faulty], test=[runs[2]])
        except InputError:
            return codes | {"diagnose": ["refused"], "verdict": ["-"]}
        codes["diagnose"] = _codes([*findings, *differing, *diagnosis.remarks])
        codes["verdict"] = [" ".join([diagnosis.verdict, *(cause.name for cause in diagnosis.causes)])]
    return codes


def _or_refused(work: Callable[[], Iterable[Message]]) -> list[str]:
    try:
        return _codes(work())
    except InputError:
        return ["refused"]


def _codes(messages: Iterable[Message]) -> list[str]:
    return sorted({one.code for one in messages if isinstance(one, Message)})
