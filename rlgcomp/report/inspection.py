"""Summary of a recording: rows, gyros with their noise, channels, thermal legs, and findings."""

from __future__ import annotations

import contextlib
import itertools
from typing import Any, Final

import numpy as np

from rlgcomp.errors import InputError
from rlgcomp.noise.allan_deviation import allan_deviation
from rlgcomp.numerics.hysteresis import Play
from rlgcomp.recording import DEFAULT_AVERAGING_S, Finding, Recording
from rlgcomp.recording.outliers import gyro_outliers, monitor_outliers
from rlgcomp.recording.stuck_channels import sample_and_hold_message, sample_and_hold_readings
from rlgcomp.units import SECONDS_PER_HOUR

TURN: Final = 0.1  # of the span of temperature: smaller reversals are no turning points


def summarise(recording: Recording) -> dict[str, Any]:
    """Summary of a recording, as plain data.

    Returns
    -------
    dict
        `name`, `kind`, `unit`, `rows`, `period_s`, `hours`, `gaps`, and lists of `gyros`, `columns`, `legs` and `findings`.
    """
    table = recording.table
    return {
        "name": recording.name,
        "kind": recording.metadata.kind,
        "unit": recording.metadata.unit,
        "rows": len(recording),
        "period_s": recording.period_s,
        "hours": recording.duration_s / SECONDS_PER_HOUR,
        "gaps": len(recording.gaps),
        "gyros": [_gyro(recording, column) for column in recording.gyro_columns],
        "columns": [
            {
                "column": column,
                "min": float(table[column].min()),
                "mean": float(table[column].mean()),
                "max": float(table[column].max()),
                "distinct values": int(np.unique(table[column].to_numpy()).size),
            }
            for column in recording.columns
        ],
        "legs": legs(recording),
        "findings": [
            finding.to_mapping()
            for finding in (*recording.findings, *outlier_findings(recording), *sample_and_hold_findings(recording))
        ],
    }


def outlier_findings(recording: Recording) -> list[Finding]:
    """Outliers of gyros and monitors."""
    outliers = []
    for column in recording.gyro_columns:
        with contextlib.suppress(InputError):  # pulses of unknown size
            outliers.append(gyro_outliers(recording, column))
    outliers_of_all = [each for each in (*outliers, *monitor_outliers(recording)) if each is not None]
    return [Finding("noted", each.message("inspected"), each.column, int(np.argmax(each.rows))) for each in outliers_of_all]


def sample_and_hold_findings(recording: Recording) -> list[Finding]:
    """Monitors that a slower logger reads, in one finding."""
    monitors_read = sample_and_hold_readings(recording)
    return [Finding("noted", sample_and_hold_message(monitors_read))] if monitors_read else []


def legs(recording: Recording) -> list[dict[str, Any]]:
    """Segments of monotonic temperature, between turning points larger than a tenth of its span."""
    try:
        temperature_degC, time_s = recording.column(recording.temperature_column), recording.time_s
    except InputError:
        return []
    span_K = float(np.ptp(temperature_degC))
    if span_K == 0.0:
        return []
    play = Play((0.5 * TURN * span_K,))
    states, _ = play.run(play.init(temperature_degC[0]), temperature_degC)
    steps = np.diff(states[:, 0])
    moving = np.flatnonzero(steps)
    turns = moving[1:][np.sign(steps[moving[1:]]) != np.sign(steps[moving[:-1]])]
    last = moving[np.searchsorted(moving, turns) - 1] + 1  # where the operator stopped before it turned
    return [
        {
            "from_s": float(time_s[start]),
            "to_s": float(time_s[stop]),
            "from_degC": float(temperature_degC[start]),
            "to_degC": float(temperature_degC[stop]),
            "going": "up" if temperature_degC[stop] > temperature_degC[start] else "down",
        }
        for start, stop in itertools.pairwise([0, *last.tolist(), len(time_s) - 1])
    ]


def _gyro(recording: Recording, column: str) -> dict[str, Any]:
    values: dict[str, Any] = {"gyro": column}
    try:
        rate = recording.rate_deg_h(column)
        curve = allan_deviation(rate, recording.time_s)
    except InputError as error:
        return {**values, "note": str(error)}
    white = curve.white_noise_deg_h(DEFAULT_AVERAGING_S)
    return {
        **values,
        "mean, deg/h": float(rate.mean()),
        "std, deg/h": float(rate.std()),
        f"white noise of {DEFAULT_AVERAGING_S:g} s means, deg/h": white,
    }
