"""Sixty faults of a laboratory in recordings of a gyro of its own: which commands notice each."""
# ruff: noqa: E501  a fault a line

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt
import pandas as pd

from experiments.attack.process import Result, command

_TOLD: Final = r": (noted|repaired):|WARNING"
Array = npt.NDArray[np.float64]
Runs = list[pd.DataFrame]
STEP_S: Final = 5.0
GYRO, BLOCK, SHELL, LIGHT, SUPPLY = (
    "gyro_deg_h",
    "temperature_block_degC",
    "temperature_shell_degC",
    "light_intensity_V",
    "supply_voltage_V",
)
_PLANS: Final = (
    ((20, 1800), (-15, 5400), (45, 7200), (20, 3600)),
    ((25, 1200), (50, 6000), (-10, 6000), (30, 3600)),
    ((10, 1800), (-20, 4800), (20, 4800), (48, 5400)),
    ((20, 1500), (40, 5400), (0, 5400), (35, 4800)),
)


def gyro_run(seed: int, plan: int = 0, *, unit: int = 0) -> pd.DataFrame:
    """One run: a shell that follows the chamber, a block that follows the shell, and a gyro with drift by temperature, rate and lag."""
    rng = np.random.default_rng([seed, unit])
    chamber = np.concatenate(
        [np.full(round(seconds / STEP_S), degrees, dtype=float) for degrees, seconds in _PLANS[plan % len(_PLANS)]]
    )
    rate = 1.2 * STEP_S / 60.0
    air = np.empty_like(chamber)
    air[0] = chamber[0]
    for k in range(1, len(chamber)):
        air[k] = air[k - 1] + np.clip(chamber[k] - air[k - 1], -rate, rate)
    shell, block, core = (np.full(len(air), air[0]) for _ in range(3))
    for k in range(1, len(air)):
        shell[k] = shell[k - 1] + STEP_S / 240.0 * (air[k - 1] - shell[k - 1])
        block[k] = block[k - 1] + STEP_S / 700.0 * (shell[k - 1] + 0.8 - block[k - 1])
        core[k] = core[k - 1] + STEP_S / 900.0 * (block[k - 1] - core[k - 1])
    slopes = np.array([0.004, 4e-5, 0.03, 0.002]) * (1.0 if unit == 0 else np.array([-0.7, 2.0, 0.4, -1.0]))
    bias = (
        slopes[0] * block
        + slopes[1] * (block - 20.0) ** 2
        + slopes[2] * np.gradient(block, STEP_S / 60.0)
        + slopes[3] * (core - block)
    )
    n = len(air)
    noise = lambda sd: rng.normal(0.0, sd, n)  # noqa: E731
    return pd.DataFrame(
        {
            "time_s": STEP_S * np.arange(n),
            GYRO: 7.3 + bias + noise(0.012),
            BLOCK: block + noise(0.004),
            SHELL: shell + noise(0.004),
            LIGHT: 2.1 - 0.002 * (block - 20.0) + noise(5e-4),
            SUPPLY: 15.0 + 0.01 * np.sin(np.arange(n) / 900.0 + seed) + noise(2e-3),
        }
    )


_R = np.random.default_rng(77)


def _at(name: str, change: Callable[[Array], Any]) -> Callable[[Runs], Runs]:
    """One column of the second run changed."""
    return lambda runs: [runs[0], runs[1].assign(**{name: change(runs[1][name].to_numpy().copy())}), runs[2]]


def _with(change: Callable[[pd.DataFrame, Runs], pd.DataFrame]) -> Callable[[Runs], Runs]:
    return lambda runs: [runs[0], change(runs[1], runs).reset_index(drop=True), runs[2]]


def _lowpass(values: Array, samples: float) -> Array:
    return pd.Series(values).ewm(alpha=1.0 / samples).mean().to_numpy()


def _bursts(values: Array, put: float | None, share: float, length: int) -> Array:
    for start in _R.choice(len(values) - length, int(share * len(values) / length), replace=False):
        values[start : start + length] = values[start] if put is None else put
    return values


def _part(values: Array, first: float, last: float, put: Callable[[Array], Any] | float) -> Array:
    a, b = int(first * len(values)), int(last * len(values))
    values[a:b] = put(values[a:b]) if callable(put) else put
    return values


def _own_polynomial(table: pd.DataFrame) -> Array:
    T = table[BLOCK].to_numpy()
    return np.asarray(np.polyval(np.polyfit(T, table[GYRO], 3), T))


FAULTS: Final[dict[str, Callable[[Runs], Runs]]] = {
    "healthy": lambda runs: runs,
    "gyro twice as large": _at(GYRO, lambda y: 2.0 * y),
    "gyro 20 % larger": _at(GYRO, lambda y: 1.2 * y),
    "gyro in deg/min under deg/h": _at(GYRO, lambda y: y / 60.0),
    "gyro without its mean": _at(GYRO, lambda y: y - y.mean()),
    "gyro already compensated": _with(lambda run, _: run.assign(**{GYRO: run[GYRO] - _own_polynomial(run) + run[GYRO].mean()})),
    "gyro compensated twice": _with(lambda run, _: run.assign(**{GYRO: run[GYRO] - 2.0 * _own_polynomial(run) + 2.0 * run[GYRO].mean()})),
    "gyro limited on one side": _at(GYRO, lambda y: np.minimum(y, np.quantile(y, 0.8))),
    "gyro dead in the last third": _at(GYRO, lambda y: _part(y, 0.67, 1.0, y[len(y) // 2])),
    "gyro wraps": _at(GYRO, lambda y: (y - 7.3 + 0.05) % 0.1 + 7.25),
    "gyro 50 times coarser": _at(GYRO, lambda y: np.round(y / 0.05) * 0.05),
    "gyro printed with two digits": _at(GYRO, lambda y: np.round(y, 2)),
    "gyro late by 60 s": _at(GYRO, lambda y: np.roll(y, 12)),
    "gyro late by 600 s": _at(GYRO, lambda y: np.roll(y, 120)),
    "gyro backwards in time": _at(GYRO, lambda y: y[::-1]),
    "gyro through a low-pass of 30 s": _at(GYRO, lambda y: _lowpass(y, 6.0)),
    "gyro through a median of five": _at(GYRO, lambda y: pd.Series(y).rolling(5, center=True, min_periods=1).median().to_numpy()),
    "gyro with a strong line": _at(GYRO, lambda y: y + 0.03 * np.sin(2.0 * np.pi * np.arange(len(y)) / 7.3)),
    "5 % of the gyro missing": _at(GYRO, lambda y: np.where(_R.random(len(y)) < 0.05, np.nan, y)),
    "gyro zero in bursts": _at(GYRO, lambda y: _bursts(y, 0.0, 0.02, 20)),
    "gyro held in bursts": _at(GYRO, lambda y: _bursts(y, None, 0.05, 50)),
    "gyro with a step of 0.05": _at(GYRO, lambda y: _part(y, 0.5, 1.0, lambda v: v + 0.05)),
    "gyro twice as noisy in one half": _at(GYRO, lambda y: _part(y, 0.5, 1.0, lambda v: v + _R.normal(0.0, 0.02, len(v)))),
    "gyro summed up": _at(GYRO, lambda y: np.cumsum(y) * STEP_S / 3600.0),
    "gyro differenced": _at(GYRO, lambda y: np.r_[0.0, np.diff(y)]),
    "another unit's run": _with(lambda run, _: gyro_run(11, 1, unit=1)),
    "another unit's gyro": _with(lambda run, _: run.assign(**{GYRO: gyro_run(11, 1, unit=1)[GYRO]})),
    "gyro with spikes of 5 deg/h": _at(GYRO, lambda y: np.where(_R.random(len(y)) < 0.003, y + 5.0, y)),
    "time in hours": _at("time_s", lambda t: t / 3600.0),
    "time in us": _at("time_s", lambda t: t * 1e6),
    "time in days": _at("time_s", lambda t: t / 86400.0),
    "clock 1 % fast": _at("time_s", lambda t: 1.01 * t),
    "clock 10 % fast": _at("time_s", lambda t: 1.1 * t),
    "an hour back in the middle": _at("time_s", lambda t: _part(t, 0.5, 1.0, lambda v: v - 3600.0)),
    "time stamps rounded to 20 s": _at("time_s", lambda t: np.floor(t / 20.0) * 20.0),
    "an hour cut out and closed up": _with(lambda run, _: run.drop(range(1500, 2220)).assign(time_s=STEP_S * np.arange(len(run) - 720))),
    "1 % of the rows twice": _with(lambda run, _: run.loc[np.sort(np.r_[np.arange(len(run)), _R.choice(len(run), len(run) // 100)])].assign(time_s=STEP_S * np.arange(len(run) + len(run) // 100))),
    "rows sorted by temperature": _with(lambda run, _: run.sort_values(BLOCK).assign(time_s=run["time_s"].to_numpy())),
    "shell a copy of the block": _with(lambda run, _: run.assign(**{SHELL: run[BLOCK]})),
    "block 5 K too high": _at(BLOCK, lambda T: T + 5.0),
    "block in tenths of a degree": _at(BLOCK, lambda T: 10.0 * T),
    "block without its sign": _at(BLOCK, np.abs),
    "block limited at 30 degC": _at(BLOCK, lambda T: np.minimum(T, 30.0)),
    "block open, 850 degC": _at(BLOCK, lambda T: _part(T, 0.6, 0.7, 850.0)),
    "block at 85 degC now and then": _at(BLOCK, lambda T: np.where(_R.random(len(T)) < 0.005, 85.0, T)),
    "block at -127 degC now and then": _at(BLOCK, lambda T: np.where(_R.random(len(T)) < 0.005, -127.0, T)),
    "block of another run": _with(lambda run, runs: run.assign(**{BLOCK: np.resize(runs[0][BLOCK].to_numpy(), len(run))})),
    "block ten times as noisy": _at(BLOCK, lambda T: T + _R.normal(0.0, 0.04, len(T))),
    "block backwards in time": _at(BLOCK, lambda T: T[::-1]),
    "block read every 500 s": _at(BLOCK, lambda T: T[np.arange(len(T)) // 100 * 100]),
    "a bit of 8 K flips in the block": _at(BLOCK, lambda T: np.where(_R.random(len(T)) < 0.01, T + 8.0, T)),
    "block and shell exchanged": _with(lambda run, _: run.rename(columns={BLOCK: SHELL, SHELL: BLOCK})),
    "block in K in one half": _at(BLOCK, lambda T: _part(T, 0.5, 1.0, lambda v: v + 273.15)),
    "block in degF in one half": _at(BLOCK, lambda T: _part(T, 0.5, 1.0, lambda v: 1.8 * v + 32.0)),
    "decimal comma lost in the block": _at(BLOCK, lambda T: np.where(_R.random(len(T)) < 0.01, 1000.0 * T, T)),
    "block and light exchanged": _with(lambda run, _: run.rename(columns={BLOCK: LIGHT, LIGHT: BLOCK})),
    "block late by 200 s": _at(BLOCK, lambda T: np.r_[np.full(40, T[0]), T[:-40]]),
    "light zero in one half": _at(LIGHT, lambda v: _part(v, 0.5, 1.0, 0.0)),
    "light of the other sign": _at(LIGHT, lambda v: -v),
    "light frozen": _at(LIGHT, lambda v: np.full(len(v), v[0])),
    "supply and light exchanged": _with(lambda run, _: run.rename(columns={SUPPLY: LIGHT, LIGHT: SUPPLY})),
    "the same run twice": lambda runs: [runs[0], runs[0].copy(), runs[2]],
    "a copy without 1 % of its rows": lambda runs: [runs[0], runs[0].drop(_R.choice(len(runs[0]), len(runs[0]) // 100, replace=False)).reset_index(drop=True), runs[2]],
    "a copy with noise of a tenth": lambda runs: [runs[0], runs[0].assign(**{GYRO: runs[0][GYRO] + _R.normal(0.0, 0.0012, len(runs[0]))}), runs[2]],
    "a copy scaled by 1.001": lambda runs: [runs[0], runs[0].assign(**{GYRO: 1.001 * runs[0][GYRO]}), runs[2]],
    "a copy backwards in time": lambda runs: [runs[0], runs[0].iloc[::-1].assign(time_s=runs[0]["time_s"].to_numpy()).reset_index(drop=True), runs[2]],
    "a copy at 6 s by interpolation": lambda runs: [runs[0], _resampled(runs[0], 6.0), runs[2]],
    "the mean of two runs": _with(lambda run, runs: run.assign(**{GYRO: 0.5 * (run[GYRO] + np.resize(runs[0][GYRO].to_numpy(), len(run)))})),
    "two runs one behind the other": _with(lambda run, runs: pd.concat([runs[0], run]).assign(time_s=STEP_S * np.arange(len(run) + len(runs[0])))),
    "10 Hz and 1 Hz, as one of 5 s and one of 1 s": _with(lambda run, _: _resampled(run, 1.0, noise=0.012 * np.sqrt(5.0))),
}  # fmt: skip


def _resampled(run: pd.DataFrame, step_s: float, noise: float | None = None) -> pd.DataFrame:
    """A run interpolated to another period; with `noise`, one that was sampled at it."""
    time = np.arange(0.0, float(run["time_s"].iloc[-1]), step_s)
    made = pd.DataFrame(
        {"time_s": time} | {name: np.interp(time, run["time_s"], run[name]) for name in run.columns if name != "time_s"}
    )
    if noise is not None:
        smooth = run[GYRO].rolling(60, center=True, min_periods=1).mean()
        made[GYRO] = np.interp(time, run["time_s"], smooth) + _R.normal(0.0, noise, len(time))
        for name in (BLOCK, SHELL, LIGHT, SUPPLY):
            made[name] += _R.normal(0.0, float(np.diff(run[name]).std()) / np.sqrt(2.0), len(time))
    return made


def noticed(name: str, place: Path) -> dict[str, set[str]]:
    """What inspect, train and evaluate print of a fault: codes of messages, or that they refuse.

    Parameters
    ----------
    name : str
        Of the fault.
    place : Path
        Folder with the model `healthy` of runs 0 and 2.
    """
    runs = [gyro_run(k, k) for k in range(3)]
    files = []
    for k, run in enumerate(FAULTS[name](runs)):
        files.append(f"run{k}.npz")
        np.savez(place / files[-1], **{column: run[column].to_numpy() for column in run.columns})
    features = ["--model", "cubic", "--features", "temperature,temperature_rate,lag"]
    return {
        "inspect": _messages(command(["inspect", *files, "--json"], place)),
        "train": _messages(command(["train", *files, *features, "--json", "--out", "trained"], place)),
        "evaluate": _messages(command(["evaluate", "healthy", files[1], "--no-comparison", "--json", "--out", "report"], place)),
    }


def prepare(place: Path) -> None:
    """A model of two healthy runs."""
    place.mkdir(parents=True)
    for k in (0, 2):
        np.savez(place / f"good{k}.npz", **{column: values.to_numpy() for column, values in gyro_run(100 + k, k).items()})
    result = command(
        [
            "train",
            "good0.npz",
            "good2.npz",
            "--model",
            "cubic",
            "--features",
            "temperature,temperature_rate,lag",
            "--out",
            "healthy",
        ],
        place,
    )
    if result.code:
        raise RuntimeError(result.error)


def _messages(result: Result) -> set[str]:
    if result.problem:
        return {f"FAULT: {result.problem}"}
    if result.code == 2:
        return {"refused"}
    try:
        codes = set(_codes(json.loads(result.output)))
    except ValueError:
        codes = set()
    told = [line.split(": ", 2)[-1] for line in result.error.splitlines() if re.search(_TOLD, line)]
    lines = {re.sub(r"[-+]?[0-9][-+0-9.e]*", "#", line)[:40] for line in told}
    return codes | {f"“{line} …”" for line in lines if not codes}


def _codes(value: Any) -> list[str]:
    if isinstance(value, dict):
        own = [value["code"]] if isinstance(value.get("code"), str) else []
        return own + [code for part in value.values() for code in _codes(part)]
    if isinstance(value, list):
        return [code for part in value for code in _codes(part)]
    return []
