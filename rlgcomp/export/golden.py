"""Streams for comparing exported code with Python: samples, refused ones included, and Python's answer to each."""

from __future__ import annotations

import dataclasses
from typing import Final

import numpy as np
import numpy.typing as npt

from rlgcomp.compensation.compensator import Compensator
from rlgcomp.compensation.feature_pipeline import FeatureRecipe
from rlgcomp.compensation.features import Difference, Level, ReadoutDifference
from rlgcomp.compensation.start_offset import StartOffset
from rlgcomp.errors import InputError
from rlgcomp.export.expansion import Expansion
from rlgcomp.recording import TIME, Recording

Array = npt.NDArray[np.float64]
OK, OUT_OF_RANGE, INVALID, EITHER = 0, 1, 2, -1
LONGEST_STEP_S: Final = 86_400.0  # of time, that exported code believes at once
_LONGEST: Final = 400
_EPISODE: Final = 20


@dataclasses.dataclass(frozen=True)
class Stream:
    """Samples and the answers expected.

    Parameters
    ----------
    name : str
    time_s : ndarray, shape (n,)
    monitors : ndarray, shape (n, monitors)
    X : ndarray, shape (n, features)
        The model's inputs; NaN where a sample was refused.
    bias_deg_h, half_width_deg_h : ndarray, shape (n,)
    status : ndarray, shape (n,)
        `OK`, `OUT_OF_RANGE`, `INVALID`, or `EITHER` of the first two where an input is too near the limit to decide.
    rate_deg_h : ndarray, shape (n,), optional
        The gyro, where its offset is zeroed at the start; bias and half width then have that offset.
    """

    name: str
    time_s: Array
    monitors: Array
    X: Array
    bias_deg_h: Array
    half_width_deg_h: Array
    status: npt.NDArray[np.int64]
    rate_deg_h: Array | None = None

    @property
    def samples(self) -> Array:
        """The numbers of each sample that exported code takes, its time first, shape (n, numbers)."""
        return np.column_stack([self.time_s, self.monitors, *([] if self.rate_deg_h is None else [self.rate_deg_h])])

    @property
    def valid(self) -> npt.NDArray[np.bool_]:
        return np.asarray(self.status != INVALID)


def stream_of(
    recording: Recording, compensator: Compensator, expansion: Expansion, *, full: bool, offset_s: float | None = None
) -> Stream:
    """A recording and what Python answers: the compensator itself for the `full` model, its expansion for a reduced one.

    Parameters
    ----------
    recording : Recording
    compensator : Compensator
    expansion : Expansion
    full : bool
        Whether the expansion is the whole model, not a reduced one.
    offset_s : float, optional
        Zero the offset of the run over so many seconds at its start.
    """
    long = np.flatnonzero(np.diff(recording.time_s) > LONGEST_STEP_S)
    rows = slice(0, 1 + int(long[0]) if len(long) else len(recording))  # exported code leaves out the sample after a longer step
    X = compensator.pipeline_.transform(recording).to_numpy()[rows]
    monitors = recording.table[list(compensator.pipeline_.columns)].to_numpy()[rows]
    bias = compensator.predict_rows(X) if full else expansion.bias_deg_h(X)
    status = expansion.outside(X).astype(np.int64)
    stream = Stream(recording.name, recording.time_s[rows], monitors, X, bias, compensator.half_widths(X), status)
    return stream if offset_s is None else _zeroed(stream, compensator, recording.rate_deg_h(compensator.gyro_)[rows], offset_s)


def golden_stream(
    compensator: Compensator, expansion: Expansion, *, full: bool, offset_s: float | None = None
) -> tuple[Stream, int]:
    """The golden recording, made from the artefact alone, and how many of its rows from the second on are undisturbed.

    An invalid sample; the first training run's averages, one sample each, turned back into monitors; then a gap, inputs
    a little beyond the training range, samples that are invalid or come at a wrong time, an ordinary segment, and inputs far
    out. An invalid sample is not finite, or its readouts are both 0. Each sample goes through the pipeline's own `step`.

    Parameters
    ----------
    compensator : Compensator
    expansion : Expansion
    full : bool
        Whether the expansion is the whole model, not a reduced one.
    offset_s : float, optional
        Zero the offset over so many seconds at the start, of a gyro made up here; one of its samples is not finite.
    """
    time_s, monitors = _episodes(compensator)
    pipeline = compensator.pipeline_
    rate_deg_h = _made_up_rate(compensator, len(time_s))
    X = np.full((len(time_s), len(pipeline.names)), np.nan)
    state = None
    for k, (now_s, row) in enumerate(zip(time_s, monitors, strict=True)):
        if offset_s is not None and not np.isfinite(rate_deg_h[k]):
            continue
        try:
            X[k], state = pipeline.step(state, {TIME: now_s, **dict(zip(pipeline.columns, row, strict=True))})
        except InputError:
            continue
    valid = np.isfinite(X).all(axis=1)
    bias = np.full(len(X), np.nan)
    bias[valid] = compensator.predict_rows(X[valid]) if full else expansion.bias_deg_h(X[valid])
    half_width = np.full(len(X), np.nan)
    half_width[valid] = compensator.half_widths(X[valid])
    last = np.maximum.accumulate(np.where(valid, np.arange(len(X)), -1))
    bias = np.where(last >= 0, bias[last], expansion.y_mean_deg_h)
    half_width = np.where(last >= 0, half_width[last], compensator.interval_.per_span_deg_h)
    status = np.where(valid, expansion.outside(X), INVALID)
    stream = Stream("golden", time_s, monitors, X, bias, half_width, status)
    stream = stream if offset_s is None else _zeroed(stream, compensator, rate_deg_h, offset_s)
    return stream, min(len(compensator.training_[0].time_s), _LONGEST)


def _zeroed(stream: Stream, compensator: Compensator, rate_deg_h: Array, offset_s: float) -> Stream:
    """The stream with the offset of its gyro zeroed; a refused sample has the offset and the width of the last valid one."""
    valid = stream.valid
    offsets, over = np.zeros(len(valid)), np.zeros(len(valid), dtype=np.bool_)
    difference = rate_deg_h - stream.bias_deg_h
    offsets[valid], over[valid] = StartOffset(offset_s).run(stream.time_s[valid], difference[valid])
    last = np.maximum.accumulate(np.where(valid, np.arange(len(valid)), -1))
    offsets, over = np.where(last >= 0, offsets[last], 0.0), (last >= 0) & over[last]
    narrower = compensator.offset_interval(offset_s).inside_deg_h - compensator.interval_.inside_deg_h
    return dataclasses.replace(
        stream,
        bias_deg_h=stream.bias_deg_h + offsets,
        half_width_deg_h=stream.half_width_deg_h + np.where(over, narrower, 0.0),
        rate_deg_h=rate_deg_h,
    )


def _made_up_rate(compensator: Compensator, rows: int) -> Array:
    """A gyro of another switch-on, in deg/h: an offset of a span of the bias, and a wave; the fourth sample is not finite."""
    scaling = compensator.scaling_
    rate = scaling.y_mean_deg_h + scaling.y_scale_deg_h * (1.0 + np.sin(np.arange(rows)))
    rate[3] = np.nan
    return np.asarray(rate)


def _episodes(compensator: Compensator) -> tuple[Array, Array]:
    quiet_s = compensator.training_[0].time_s[:_LONGEST]
    quiet = _monitors(compensator)[:_LONGEST]
    span = np.ptp(quiet, axis=0) + 1e-3
    again = quiet[-_EPISODE:][::-1]
    beyond = again + 0.4 * span
    far = again[:4] * np.array([[50.0], [-50.0], [1e6], [-1e6]])  # last: single precision takes long to forget it
    dark = any(isinstance(feature, ReadoutDifference) for feature in compensator.pipeline_.features)
    invalid = np.full_like(quiet[:1], 0.0 if dark else np.nan)
    bad = np.vstack([np.repeat(quiet[-1:], 5, axis=0), invalid])
    bad[0, 0], bad[1, -1] = np.nan, np.inf
    monitors = np.vstack([invalid, quiet, again, beyond, bad, again, far])
    period_s = compensator.averaging_s
    added_s = quiet_s[-1] + 10.0 * period_s + period_s * np.arange(1, len(monitors) - len(quiet))
    time_s = np.r_[quiet_s[0] - period_s, quiet_s, added_s]
    first_bad = 1 + len(quiet) + len(again) + len(beyond)
    time_s[first_bad + 2 : first_bad + 5] = np.nan, time_s[first_bad - 1], time_s[0]
    return time_s, monitors


def _monitors(compensator: Compensator) -> Array:
    """Monitors that give about the inputs of the first training run."""
    pipeline, X = compensator.pipeline_, compensator.training_[0].X
    places = _places(pipeline)
    known = {feature.column: X[:, place] for feature, place in places if isinstance(feature, Level)}
    for feature, place in places:
        if isinstance(feature, Difference):
            if feature.second in known:
                known.setdefault(feature.first, known[feature.second] + X[:, place])
            first = known.setdefault(feature.first, _sweep(len(X)))
            known.setdefault(feature.second, first - X[:, place])
        elif isinstance(feature, ReadoutDifference):
            known.setdefault("readout_a_V", 0.5 + 0.5 * X[:, place])
            known.setdefault("readout_b_V", 0.5 - 0.5 * X[:, place])
    return np.column_stack([known.get(column, _sweep(len(X))) for column in pipeline.columns])


def _places(pipeline: FeatureRecipe) -> list[tuple[object, int]]:
    starts = np.cumsum([0, *(len(feature.names) for feature in pipeline.features)])
    return list(zip(pipeline.features, starts.tolist(), strict=False))


def _sweep(rows: int) -> Array:
    """A monitor of which the artefact keeps no level: between -40 and 60, as a chamber goes."""
    return 10.0 + 50.0 * np.sin(np.linspace(0.0, 4.0 * np.pi, rows))
