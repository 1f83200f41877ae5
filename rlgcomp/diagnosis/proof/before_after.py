r"""Proof on runs held out: what the calibrated and the augmented simulator leave, beside the noise floor and a black box.

The improvement is :math:`1 - r_a / r_b`, r being the root mean square of window means over all runs. Its interval comes from a
circular block bootstrap within runs (blocks of an hour, longer than the memory of chamber and noise). A gyro's bias changes from
switch-on to switch-on, which no simulator foresees: the rms counts that offset, and the same numbers are given about each run's own
mean.

References
----------
M. S. Bartlett, *An Introduction to Stochastic Processes*, Cambridge, 1955 (cumulative periodogram).
M. A. Stephens, J. R. Stat. Soc. B 32, 115 (1970) (the Kolmogorov–Smirnov statistic of few values).
"""

from __future__ import annotations

import dataclasses
import math
import sys
from collections.abc import Callable, Sequence

import numpy as np
import numpy.typing as npt
import pandas as pd
from scipy import special

from rlgcomp.diagnosis.noise.whitening import NoiseShape, Rows, whiten
from rlgcomp.diagnosis.proof.black_box import Mismatch, learned
from rlgcomp.diagnosis.question.windows import Windows, turning_deg_s
from rlgcomp.diagnosis.result import Fit, RunFit, Trace
from rlgcomp.errors import InputError
from rlgcomp.numerics.bootstrap import BLOCK_S, DRAWS, drawn_squares
from rlgcomp.recording import TIME, Recording, is_gyro
from rlgcomp.simulation.simulator import Simulator

Array = npt.NDArray[np.float64]
Prediction = Callable[[Recording], Array]


@dataclasses.dataclass(frozen=True)
class Proof:
    """Training and held-out runs before and after, and their window means."""

    train: Fit
    test: Fit | None
    traces: tuple[Trace, ...]


@dataclasses.dataclass(frozen=True)
class _Left:
    """Window means of one run: what each simulator leaves, and what each added mechanism contributes."""

    run: Recording
    windows: Windows  # of the run whose gyro is what the simulator before leaves
    before: Array
    after: Array
    added: dict[str, Array]


def prove(
    before: Simulator,
    after: Simulator,
    train: Sequence[Recording],
    test: Sequence[Recording],
    *,
    window_s: float,
    shape: NoiseShape,
    white_deg_h: float,
    gyro: str | None = None,
    predicted: Prediction | None = None,
    black_box: bool = True,
    seed: int = 0,
) -> Proof:
    """What two simulators leave on runs that they were and were not fitted to.

    Parameters
    ----------
    before, after : Simulator
        Calibrated without and with the causes found.
    train, test : sequence of Recording
    window_s : float
    shape : NoiseShape
    white_deg_h : float
        Standard deviation of the white noise of a full window's mean.
    gyro : str, optional
    predicted : callable, optional
        Further prediction in deg/h that both have in common: the user's own simulator.
    black_box : bool
        Also train an LS-SVM on what `before` leaves of the training runs, and apply it to all.
    seed : int

    Raises
    ------
    InputError
        A run is too short or lacks a monitor.
    """
    runs = (*train, *test)
    mismatches = [Mismatch.of(before, run, gyro, predicted, window_s) for run in runs]
    box = learned(mismatches, len(train)) if black_box and test else None
    return proved(mismatches, len(train), before, after, shape=shape, white_deg_h=white_deg_h, box=box, seed=seed)


def proved(
    mismatches: Sequence[Mismatch],
    training: int,
    before: Simulator,
    after: Simulator,
    *,
    shape: NoiseShape,
    white_deg_h: float,
    box: Callable[[], list[Array] | None] | None = None,
    seed: int = 0,
) -> Proof:
    """The same where it is known what `before` leaves of the runs, the first of which were trained on.

    Parameters
    ----------
    mismatches : sequence of Mismatch
    training : int
    before, after, shape, white_deg_h, seed
        As in :func:`prove`.
    box : callable, optional
        As :func:`rlgcomp.diagnosis.proof.black_box.learned` gives it.

    Runs of which `after` reads a column that they lack take no part in it: see :func:`unreadable`.
    """
    whole: Sequence[Array | None] = (box() if box is not None else None) or [None] * len(mismatches)
    readable = [k for k, one in enumerate(mismatches) if unreadable(after, one.run) is None]
    left, biases = [_left(before, after, mismatches[k]) for k in readable], [whole[k] for k in readable]
    traces = tuple(
        Trace(
            run=one.run.name,
            held_out=k >= training,
            time_s=one.windows.middles_s,
            before_deg_h=one.before,
            after_deg_h=one.after,
            compensation_deg_h=None if bias is None else one.before - bias,
            monitors=pd.DataFrame(
                {c: one.windows.means(one.run.column(c)) for c in one.run.columns if c != TIME and not is_gyro(c)}
            ),
            added_deg_h=one.added,
            channel=one.run.gyro_columns[0],
            unit=one.run.metadata.unit or "",
        )
        for k, (one, bias) in enumerate(zip(left, biases, strict=True))
    )
    fits = [
        _fit([one.windows for one in left[part]], traces[part], after, shape, white_deg_h, seed)
        for part in (slice(0, training), slice(training, None))
        if traces[part]
    ]
    return Proof(fits[0], fits[1] if len(fits) > 1 else None, traces)


def unreadable(simulator: Simulator, run: Recording) -> str | None:
    """Why a simulator cannot be proved on a run, where it reads a column that this lacks; None where it can."""
    for mechanism in simulator.mechanisms:
        try:
            mechanism.driver_columns(run)
        except InputError:
            wanted = ", ".join(name for name in mechanism.driver_names() if name not in run)
            return f"{run.name} lacks {wanted}, which {mechanism.name} reads: it takes no part in the proof."
    return None


def noise_floor(rows: Rows, shape: NoiseShape) -> float:
    r"""Expected standard deviation of one run's window means about their own mean, for noise whose white part is one.

    .. math:: E[s^2] = \frac{1}{n(n-1)} \sum_{m=1}^{n-1} (n - m) \, D(m \tau), \qquad D(t) = E[(x_{i+m} - x_i)^2]

    Nothing in it goes with a table's rate.
    """
    n = len(rows)
    lag_s = rows.window_s * np.arange(1, n)
    differing = np.zeros(n - 1)
    for time_constant_s, stationary, diffusion, swing, _ in zip(*shape.processes(rows.window_s), strict=True):
        differing += 2.0 * stationary * (1.0 - np.exp(-lag_s / time_constant_s) * np.cos(swing * lag_s)) + diffusion * lag_s
    correlated = ((n - np.arange(1, n)) * differing).sum() / (n * (n - 1))
    return math.sqrt(float(rows.white.mean()) + correlated)


def whiteness_p_value(series: Sequence[Array]) -> float:
    """That whitened series are white: Kolmogorov–Smirnov test on the cumulative periodogram of all of them.

    Parameters
    ----------
    series : sequence of ndarray
        One a run; their means are taken out.
    """
    power, frequency = [], []
    for values in series:
        spectrum = np.abs(np.fft.rfft(values - values.mean()))[1 : (len(values) + 1) // 2] ** 2
        power.append(spectrum / max(float(np.mean(spectrum)), np.finfo(np.float64).tiny))
        frequency.append(np.arange(1, len(spectrum) + 1) / len(values))
    ordered = np.concatenate(power)[np.argsort(np.concatenate(frequency), kind="stable")]
    cumulative = np.cumsum(ordered)[:-1] / ordered.sum()
    n = len(cumulative)
    apart = max(float(np.max(np.arange(1, n + 1) / n - cumulative)), float(np.max(cumulative - np.arange(n) / n)))
    p_value = float(special.kolmogorov((math.sqrt(n) + 0.12 + 0.11 / math.sqrt(n)) * apart))
    return max(p_value, sys.float_info.min)


def improvement_interval(
    before: Sequence[Array], after: Sequence[Array], *, block: int, seed: int = 0
) -> tuple[tuple[float, float], tuple[float, float]]:
    """95 % intervals of the improvement of the rms, and of the standard deviation about each run's mean.

    Parameters
    ----------
    before, after : sequence of ndarray
        Window means, one array a run, drawn together in circular blocks.
    block : int
        Length of a block in windows; at most a fifth of a run is used.
    seed : int

    Returns
    -------
    of the rms, about the mean : tuple of (low, high)
    """
    rng = np.random.default_rng(seed)
    squares, about_mean = np.zeros((2, DRAWS)), np.zeros((2, DRAWS))
    for pair in zip(before, after, strict=True):
        of_run = drawn_squares(pair, block=block, rng=rng)
        squares += of_run[0]
        about_mean += of_run[1]
    return _interval(squares), _interval(about_mean)


def _left(before: Simulator, after: Simulator, known: Mismatch) -> _Left:
    run, windows = known.run, known.windows
    expected = after.predict(run).rate_deg_h()
    names = {mechanism.name for mechanism in before.mechanisms}
    added = {
        mechanism.name: windows.means(expected - after.without(mechanism.name).predict(run).rate_deg_h())
        for mechanism in after.mechanisms
        if mechanism.name not in names and mechanism.amplitude_parameters()
    }
    own_columns = [windows.means(m.basis(run)) for m in before.mechanisms if m.each_run and m.amplitude_parameters()]
    means, left = windows.means(known.mismatch_deg_h), windows.means(known.mismatch_deg_h - (expected - known.said_deg_h))
    return _Left(run, windows, _without(means, own_columns), _without(left, own_columns), added)


def _without(values: Array, blocks: Sequence[Array]) -> Array:
    """Values less what the simulator says each run has of its own, as the height and speed of a release: it tests no physics."""
    if not blocks:
        return values
    design, _ = np.linalg.qr(np.column_stack(blocks))
    return np.asarray(values - design @ (design.T @ values))


def _fit(
    windows: Sequence[Windows], traces: Sequence[Trace], simulator: Simulator, shape: NoiseShape, white_deg_h: float, seed: int
) -> Fit:
    window_s = windows[0].window_s
    block = max(1, round(BLOCK_S / window_s))
    rows = [_rows(one, simulator, white_deg_h) for one in windows]
    calm = dataclasses.replace(shape, wander=0.0)  # what wanders unrecorded is no noise of the gyro
    expected = [white_deg_h * noise_floor(one, calm) for one in rows]
    floors = [min(floor, _rms(_centred([trace.after_deg_h]))) for floor, trace in zip(expected, traces, strict=True)]  # not above
    per_run = tuple(_run_fit(trace, floor, block, seed) for trace, floor in zip(traces, floors, strict=True))
    before = [trace.before_deg_h for trace in traces]
    after = [trace.after_deg_h for trace in traces]
    black = [trace.compensation_deg_h for trace in traces if trace.compensation_deg_h is not None]
    whitened = [whiten(one, values[:, None], [shape])[0][0, :, 0] for one, values in zip(rows, after, strict=True)]
    of_rms, about_mean = improvement_interval(before, after, block=block, seed=seed)
    sizes = [len(values) for values in before]
    return Fit(
        baseline_rms=_rms(before),
        augmented_rms=_rms(after),
        noise_floor_rms=float(np.sqrt(np.average(np.square(floors), weights=sizes))),
        unit="deg/h",
        averaging_s=window_s,
        improvement=_improvement(_rms(before), _rms(after)),
        improvement_ci95=of_rms,
        per_run=per_run,
        compensation_rms=_rms(black) if black else None,
        baseline_std=_rms(_centred(before)),
        augmented_std=_rms(_centred(after)),
        compensation_std=_rms(_centred(black)) if black else None,
        improvement_std=_improvement(_rms(_centred(before)), _rms(_centred(after))),
        improvement_std_ci95=about_mean,
        white_floor_rms=white_deg_h * math.sqrt(float(np.concatenate([one.white for one in rows]).mean())),
        whiteness_p_value=whiteness_p_value(whitened),
    )


def _run_fit(trace: Trace, floor: float, block: int, seed: int) -> RunFit:
    before, after, black = [trace.before_deg_h], [trace.after_deg_h], trace.compensation_deg_h
    of_rms, _ = improvement_interval(before, after, block=block, seed=seed)
    return RunFit(
        run=trace.run,
        baseline_rms=_rms(before),
        augmented_rms=_rms(after),
        noise_floor_rms=floor,
        baseline_std=_rms(_centred(before)),
        augmented_std=_rms(_centred(after)),
        improvement=_improvement(_rms(before), _rms(after)),
        improvement_ci95=of_rms,
        compensation_rms=None if black is None else _rms([black]),
    )


def _rows(windows: Windows, simulator: Simulator, white_deg_h: float) -> Rows:
    """The windows of a run, whose noise is the greater where a law of the simulator leaves something open."""
    white = windows.white
    for left_open in (mechanism.unmodelled(windows.full) for mechanism in simulator.mechanisms):
        if left_open is not None:
            white += (windows.means(left_open) ** 2).sum(axis=1) / white_deg_h**2
    time_s = windows.middles_s
    rate_deg_s = turning_deg_s(simulator.kind, [windows])
    return Rows(time_s, np.zeros(len(time_s), dtype=np.intp), white, windows.window_s, rate_deg_s=rate_deg_s)


def _interval(sums: Array) -> tuple[float, float]:
    low, high = np.quantile(1.0 - np.sqrt(_ratio(sums[1], sums[0])), [0.025, 0.975])
    return float(low), float(high)


def _improvement(before: float, after: float) -> float:
    return float(1.0 - _ratio(np.array(after), np.array(before)))


def _ratio(after: Array, before: Array) -> Array:
    return np.asarray(np.where(before > 0.0, after / np.where(before > 0.0, before, 1.0), 1.0))


def _rms(series: Sequence[Array]) -> float:
    return float(np.sqrt(np.mean(np.square(np.concatenate(series)))))


def _centred(series: Sequence[Array]) -> list[Array]:
    return [values - values.mean() for values in series]
