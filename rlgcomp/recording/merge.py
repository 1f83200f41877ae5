r"""Two loggers of one run as one recording: each has its own clock, period and start.

The clock of the second file reads :math:`t_2` where that of the first reads :math:`t_1 = t_2 + o + d\,(t_2 - t_{2,0})`, with the
offset :math:`o` and the drift :math:`d`. Where both logged one quantity they are found from it: the lag of the largest
cross-correlation over all lags, then least squares of :math:`x_1(t_1) = a + b\,x_2(t_2)` in a, b, o and d by Gauss and Newton,
with standard errors that allow for the correlation of the residual. Where more than one lag fits, as of a periodic signal, none is
taken. Without a common quantity the dates of both files, where they have them, give the offset.

Rows are those of the first file. A channel of the second is interpolated only where it is slow for its logger: where nearly all its
power lies in the lower half of the band up to its Nyquist rate. Samples of a faster logger are averaged over the first's period.
"""

from __future__ import annotations

import dataclasses
import math
import re
from typing import Final

import numpy as np
import numpy.typing as npt
import pandas as pd
from scipy import signal

from rlgcomp.errors import InputError
from rlgcomp.recording import GAP_PERIODS, TIME, Finding, Recording, is_gyro
from rlgcomp.report.messages import message

Array = npt.NDArray[np.float64]
PPM: Final = 1e-6
LEAST_OVERLAP: Final = 0.2  # of the shorter file, at a lag that is tried
LEAST_CORRELATION: Final = 0.9
RIVAL_CORRELATION: Final = 0.98  # of the residual's decrease: a second lag as good as this makes the first ambiguous
FASTEST_SHARE: Final = 0.1  # of a channel's variance that may lie above half its Nyquist rate
_STEPS: Final = 20
_ZONE: Final = re.compile(r":\d\d(?:[.,]\d+)?\s*(?:Z|[+-]\d\d:?\d\d)$")
_MOST_GRID: Final = 1 << 20


@dataclasses.dataclass(frozen=True)
class ClockOffset:
    """The second file's clock against the first's.

    Parameters
    ----------
    offset_s : float
        To be added to the second's time at its first sample.
    drift_ppm : float
        By how much the second's clock is slow.
    offset_sd_s, drift_sd_ppm : float, optional
        Standard errors where they were found.
    column : str, optional
        The channel by which they were found.
    """

    offset_s: float
    drift_ppm: float = 0.0
    offset_sd_s: float | None = None
    drift_sd_ppm: float | None = None
    column: str | None = None

    def applied(self, time_s: Array) -> Array:
        """Times of the second file on the clock of the first."""
        return np.asarray(time_s + self.offset_s + PPM * self.drift_ppm * (time_s - time_s[0]))


def merge(
    recording: Recording,
    other: Recording,
    *,
    offset_s: float | None = None,
    drift_ppm: float | None = None,
    shared: tuple[str, str] | None = None,
    averaging_s: float | None = None,
) -> Recording:
    """The first recording with the channels of the second, on the first's clock and rows.

    Parameters
    ----------
    recording : Recording
    other : Recording
        It need have no gyro; see `gyro_required` of :func:`rlgcomp.recording.formats.read`.
    offset_s : float, optional
        To be added to the second's time; by default found from a channel that both have, or else from the dates of both.
    drift_ppm : float, optional
        By how much the second's clock is slow; by default found with the offset, or zero where the offset is given.
    shared : (str, str), optional
        Columns of the first and the second that hold one quantity; by default those of equal name.
    averaging_s : float, optional
        Means over this time of the second's channels, for channels that are too fast to be interpolated.

    Returns
    -------
    Recording
        What was done stands in its `findings`.

    Raises
    ------
    InputError
        The clocks cannot be compared, the two have less than half of the first's rows in common, or a channel is too fast.
    """
    twice = [column for column in other.columns if column != TIME and column in recording]
    channels = [column for column in other.columns if column not in (TIME, *twice)]
    if not channels:
        raise InputError(
            f"{other.name} has no channel that {recording.name} lacks: {', '.join(other.columns)}; if it goes on where "
            f"{recording.name} ends, join the two with rlgcomp merge --join"
        )
    clock, findings = _clock(recording, other, offset_s, drift_ppm, shared)
    findings += [Finding("noted", message("recording.merged_twice", name=recording.name), column) for column in twice]
    time_s = clock.applied(other.time_s)
    inside = _covered(recording, other, time_s)
    findings += _left_out(recording, other, inside)
    rows = recording.time_s[inside]
    table, more = _on_rows(recording, other, channels, time_s, rows, averaging_s)
    merged = recording.table[inside].reset_index(drop=True)
    truth = None if recording.truth is None else recording.truth[inside]
    both = (*recording.findings, *(_of_file(finding, other.name) for finding in other.findings), *findings, *more)
    return Recording(
        pd.concat([merged, table], axis="columns"), recording.metadata, name=recording.name, truth=truth, findings=both
    )


# --- the clock -------------------------------------------------------------------------------------------------------------


def _clock(
    recording: Recording, other: Recording, offset_s: float | None, drift_ppm: float | None, shared: tuple[str, str] | None
) -> tuple[ClockOffset, list[Finding]]:
    for name, value in (("offset_s", offset_s), ("drift_ppm", drift_ppm)):
        if value is not None and not math.isfinite(value):
            raise InputError(f"{name} is {value}; it must be a finite number")
    if offset_s is not None:
        clock = ClockOffset(offset_s, drift_ppm or 0.0)
        data = {"other": other.name, "offset_s": clock.offset_s, "drift_ppm": clock.drift_ppm}
        return clock, [Finding("noted", message("recording.merged_stated_clock", **data))]
    pairs = [shared] if shared is not None else [(c, c) for c in other.columns if c != TIME and c in recording]
    for own, theirs in pairs:
        recording.column(own)
        other.column(theirs)
    moving = [(own, theirs) for own, theirs in pairs if min(np.ptp(recording.column(own)), np.ptp(other.column(theirs))) > 0.0]
    if not moving and (dated := _by_dates(recording, other)) is not None:
        return dated, [
            Finding("noted", message("recording.merged_dates", other=other.name, name=recording.name, offset_s=dated.offset_s))
        ]
    if not moving:
        raise InputError(
            f"{recording.name} and {other.name} share no channel that changes, so their clocks cannot be compared: state the "
            "offset with --offset-s, or name one quantity that both logged with --shared OWN=THEIRS"
        )
    own, theirs = moving[0]
    clock = clock_offset(recording, other, own, theirs, drift_ppm)
    data = {key: value for key, value in dataclasses.asdict(clock).items() if key != "column"}
    return clock, [Finding("repaired", message("recording.merged_clock", other=other.name, column=theirs, **data), own)]


def _by_dates(recording: Recording, other: Recording) -> ClockOffset | None:
    """The offset by the dates of both files, whose times are counted from the first; None where only one has them, or a zone."""
    dates = [[f.message.data for f in run.findings if f.message.code == "recording.dates"] for run in (recording, other)]
    if not all(dates):
        return None
    own, theirs = (found[0] for found in dates)
    if bool(_ZONE.search(own["written"])) != bool(_ZONE.search(theirs["written"])):
        return None
    return ClockOffset((pd.Timestamp(theirs["first"]) - pd.Timestamp(own["first"])).total_seconds())


def clock_offset(recording: Recording, other: Recording, own: str, theirs: str, drift_ppm: float | None = None) -> ClockOffset:
    """Offset and drift of the second's clock from a quantity that both logged.

    Parameters
    ----------
    recording, other : Recording
    own, theirs : str
        Its column in the first and in the second.
    drift_ppm : float, optional
        Where it is known.

    Raises
    ------
    InputError
        No lag makes the two agree, or more than one does.
    """
    step_s = max(recording.period_s, other.period_s)
    longest_s = max(recording.duration_s, other.duration_s)
    step_s = max(step_s, 2.0 * longest_s / _MOST_GRID)
    first, second = (_on_grid(run, column, step_s) for run, column in ((recording, own), (other, theirs)))
    lags, correlation = _correlation(first, second)
    best = int(np.argmax(correlation))
    names = f"{own} of {recording.name} and {theirs} of {other.name}"
    if not correlation[best] >= LEAST_CORRELATION:
        raise InputError(
            f"{names} correlate by {max(0.0, float(correlation[best])):.2f} at most, at any lag: they show no common signal; state "
            "the offset with --offset-s"
        )
    left, right = best, best  # the peak: as far as the correlation falls
    while left > 0 and correlation[left - 1] <= correlation[left]:
        left -= 1
    while right < len(correlation) - 1 and correlation[right + 1] <= correlation[right]:
        right += 1
    elsewhere = np.r_[correlation[:left], correlation[right + 1 :]]
    unexplained = 1.0 - correlation[best]
    if len(elsewhere) and 1.0 - elsewhere.max() < unexplained + (1.0 - RIVAL_CORRELATION) * (1.0 - np.median(elsewhere)):
        raise InputError(
            f"{names} agree at more than one lag, as periodic signals do; state the offset with --offset-s, to the nearest period"
        )
    start_s = recording.time_s[0] - other.time_s[0] + step_s * float(lags[best])
    return _refined(recording, other, own, theirs, start_s, step_s, drift_ppm)


def _on_grid(run: Recording, column: str, step_s: float) -> Array:
    """Means over steps from the run's start; steps without a sample are interpolated."""
    bins = np.floor((run.time_s - run.time_s[0]) / step_s + 1e-9).astype(np.intp)
    counts = np.bincount(bins)
    means = np.bincount(bins, run.column(column)) / np.maximum(counts, 1)
    full = np.flatnonzero(counts)
    return np.interp(np.arange(len(counts)), full, means[full])


def _correlation(first: Array, second: Array) -> tuple[npt.NDArray[np.int64], Array]:
    """Correlation over the overlap at every lag that leaves a fifth of the shorter, lag k: second begins k steps after first."""
    x, y = first - first.mean(), second - second.mean()
    ones_x, ones_y = np.ones(len(x)), np.ones(len(y))
    lags = signal.correlation_lags(len(x), len(y))

    def summed(a: Array, b: Array) -> Array:
        return np.asarray(signal.correlate(a, b, method="fft"))

    count = np.maximum(np.rint(summed(ones_x, ones_y)), 1.0)
    sum_x, sum_y = summed(x, ones_y), summed(ones_x, y)
    variance_x = summed(x**2, ones_y) - sum_x**2 / count
    variance_y = summed(ones_x, y**2) - sum_y**2 / count
    covariance = summed(x, y) - sum_x * sum_y / count
    least = 1e-3 * count * np.array([x.var(), y.var()])[:, None]  # of an overlap in which nearly nothing happens
    told_apart = (count >= LEAST_OVERLAP * min(len(x), len(y))) & (variance_x > least[0]) & (variance_y > least[1])
    scale = np.sqrt(np.maximum(variance_x, least[0]) * np.maximum(variance_y, least[1]))
    return lags, np.where(told_apart, covariance / scale, -1.0)


def _refined(
    recording: Recording, other: Recording, own: str, theirs: str, offset_s: float, step_s: float, drift_ppm: float | None
) -> ClockOffset:
    """Least squares about the lag found, in offset, drift, scale and level."""
    fixed, drift = drift_ppm is not None, PPM * (drift_ppm or 0.0)
    x1, x2 = _on_grid(recording, own, step_s), _on_grid(other, theirs, step_s)
    t1 = recording.time_s[0] + step_s * (np.arange(len(x1)) + 0.5) - 0.5 * recording.period_s
    t2 = other.time_s[0] + step_s * (np.arange(len(x2)) + 0.5) - 0.5 * other.period_s
    slope = np.gradient(x2, step_s)
    for _ in range(_STEPS):
        at = _inverse(t1, t2[0], offset_s, drift)
        inside = (at > t2[0]) & (at < t2[-1])
        there, since = at[inside], at[inside] - t2[0]
        value, rate = np.interp(there, t2, x2), np.interp(there, t2, slope)
        design = np.column_stack([np.ones(len(there)), value, -rate, *([] if fixed else [-rate * since])])
        size = np.sqrt(np.mean(design**2, axis=0))
        size[size == 0.0] = 1.0
        solution = np.linalg.lstsq(design / size, x1[inside], rcond=None)[0] / size
        gain = solution[1] or 1.0
        offset_s += solution[2] / gain
        drift += 0.0 if fixed else solution[3] / gain
        if abs(solution[2] / gain) < 1e-6 * step_s:
            break
    sd = _standard_errors(design, x1[inside] - design @ solution) / abs(gain)
    return ClockOffset(float(offset_s), float(drift / PPM), float(sd[2]), None if fixed else float(sd[3] / PPM), theirs)


def _inverse(t1: Array, start_s: float, offset_s: float, drift: float) -> Array:
    """Time of the second's clock when the first's reads t1."""
    return np.asarray((t1 - offset_s + drift * start_s) / (1.0 + drift))


def _standard_errors(design: Array, residual: Array) -> Array:
    """Of least squares whose residual is correlated from sample to sample as an autoregression of first order."""
    free = max(1, len(residual) - design.shape[1])
    power = float(residual @ residual)
    rho = float(np.clip(residual[1:] @ residual[:-1] / power, 0.0, 0.99)) if power > 0.0 else 0.0
    size = np.sqrt(np.mean(design**2, axis=0))
    size[size == 0.0] = 1.0
    inverse = np.linalg.pinv((design / size).T @ (design / size))
    return np.asarray(np.sqrt(power / free * (1.0 + rho) / (1.0 - rho) * np.diag(inverse)) / size)


# --- the channels ----------------------------------------------------------------------------------------------------------


def _covered(recording: Recording, other: Recording, time_s: Array) -> npt.NDArray[np.bool_]:
    """Rows of the first within the second's span and none of its gaps."""
    own = recording.time_s
    half = 0.5 * other.period_s if other.period_s < recording.period_s else 0.0
    inside = (own >= time_s[0] - half) & (own <= time_s[-1] + half)
    after = np.clip(np.searchsorted(time_s, own), 1, len(time_s) - 1)
    longest = GAP_PERIODS * max(other.period_s, recording.period_s)
    return np.asarray(inside & (time_s[after] - time_s[after - 1] <= longest))


def _left_out(recording: Recording, other: Recording, inside: npt.NDArray[np.bool_]) -> list[Finding]:
    if inside.mean() < 0.5:
        raise InputError(
            f"{other.name} covers {100.0 * inside.mean():.0f} % of the rows of {recording.name}; at least half must be covered: "
            "check that both are of one run, and the offset"
        )
    if inside.all():
        return []
    rows = int((~inside).sum())
    return [Finding("repaired", message("recording.merged_uncovered", rows=rows, other=other.name), TIME, int(np.argmin(inside)))]


def _on_rows(
    recording: Recording, other: Recording, channels: list[str], time_s: Array, rows: Array, averaging_s: float | None
) -> tuple[pd.DataFrame, list[Finding]]:
    """The second's channels at the first's rows, and how they came there."""
    period_s = recording.period_s
    if averaging_s is not None and not averaging_s >= other.period_s:
        raise InputError(f"averaging_s is {averaging_s}; it must be at least the period of {other.name}, {other.period_s:.6g} s")
    window_s = averaging_s or (period_s if other.period_s <= 0.5 * period_s else None)
    data = {"columns": channels, "other": other.name, "period_s": other.period_s}
    if window_s is not None:
        table = {column: _window_means(time_s, other.column(column), rows, window_s) for column in channels}
        return pd.DataFrame(table), [Finding("noted", message("recording.merged_averaged", window_s=window_s, **data))]
    fast = {column: share for column in channels if (share := fast_share(other, column)) > FASTEST_SHARE}
    fast |= {column: 1.0 for column in channels if is_gyro(column) or column.endswith("_pulses")}
    if fast:
        listed = ", ".join(f"{column} ({100.0 * share:.0f} %)" for column, share in fast.items())
        raise InputError(
            f"{other.name}: {listed} has power above half the Nyquist rate of its logger, which reads every {other.period_s:.6g} "
            "s, so that values between its samples are not known; leave it out with --drop, or take means with --averaging-s"
        )
    table = {column: np.interp(rows, time_s, other.column(column)) for column in channels}
    return pd.DataFrame(table), [Finding("noted", message("recording.merged_interpolated", **data))]


def fast_share(run: Recording, column: str) -> float:
    """Share of a channel's variance above half its Nyquist rate, less what rounding to its steps makes.

    Parameters
    ----------
    run : Recording
    column : str
    """
    values = run.column(column)
    number = np.arange(len(values))
    values = signal.detrend(np.interp(number, number, values))
    total = float(np.mean(values**2))
    steps = np.unique(np.abs(np.diff(run.column(column))))
    steps = steps[steps > 1e-12 * max(1.0, float(np.abs(run.column(column)).max()))]
    rounding = float(steps[0]) ** 2 / 12.0 if len(steps) and len(steps) < len(values) // 4 else 0.0
    spectrum = np.abs(np.fft.rfft(values * np.hanning(len(values)))) ** 2
    if not total > 2.0 * rounding or not spectrum.sum() > 0.0:
        return 0.0
    share = float(spectrum[len(spectrum) // 2 :].sum() / spectrum.sum())
    return max(0.0, share - 0.5 * rounding / total)


def _window_means(time_s: Array, values: Array, rows: Array, window_s: float) -> Array:
    """Means over a window about each row; of the nearest sample where it holds none."""
    total = np.r_[0.0, np.cumsum(values - values.mean())]
    first = np.searchsorted(time_s, rows - 0.5 * window_s, side="left")
    last = np.searchsorted(time_s, rows + 0.5 * window_s, side="left")
    count = last - first
    nearest = np.clip(np.searchsorted(0.5 * (time_s[1:] + time_s[:-1]), rows), 0, len(values) - 1)
    means = (total[last] - total[first]) / np.maximum(count, 1) + values.mean()
    return np.where(count > 0, means, values[nearest])


def _of_file(finding: Finding, name: str) -> Finding:
    """A finding of the second file, whose rows are not those of the result."""
    return dataclasses.replace(finding, column=f"{name}, {finding.column}" if finding.column else name, row=None)
