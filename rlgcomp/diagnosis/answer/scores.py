"""Runs before and after: what the calibrated simulator leaves of them, and what the one with the findings does."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Final

import numpy as np
import numpy.typing as npt

from rlgcomp.diagnosis.answer.black_box import BlackBox
from rlgcomp.diagnosis.answer.fit import Fit
from rlgcomp.diagnosis.data import Run
from rlgcomp.numerics.bootstrap import drawn_squares

Array = npt.NDArray[np.float64]
_BLOCKS: Final = 8  # of a run, of the bootstrap
_INTERVAL: Final = (0.025, 0.975)


@dataclasses.dataclass(frozen=True)
class RunScore:
    """One run before and after.

    Parameters
    ----------
    run : str
    baseline_rms, augmented_rms, noise_floor_rms : float
        Of window means, a constant offset of the run included.
    baseline_std, augmented_std : float
        About the run's own mean.
    improvement : float
        1 - augmented / baseline, of the rms.
    improvement_ci95 : tuple of float
        By circular block bootstrap.
    compensation_rms : float, optional
        Of an LS-SVM that was trained on the training runs, of other runs.
    compensation_std : float, optional
        The same about the run's own mean.
    """

    run: str
    baseline_rms: float
    augmented_rms: float
    noise_floor_rms: float
    baseline_std: float
    augmented_std: float
    improvement: float
    improvement_ci95: tuple[float, float]
    compensation_rms: float | None = None
    compensation_std: float | None = None


@dataclasses.dataclass(frozen=True)
class Score:
    """A group of runs before and after; numbers as of :class:`RunScore`, over all of them.

    Parameters
    ----------
    unit : str
        Of the output.
    averaging_s : float
    over_compensation_ci95 : tuple of float, optional
        Of 1 - augmented / compensation: where it is below zero, the LS-SVM beats the findings.
    over_compensation_std_ci95 : tuple of float, optional
        The same, each run about its own mean.
    per_run : tuple of RunScore
    """

    baseline_rms: float
    augmented_rms: float
    noise_floor_rms: float
    unit: str
    averaging_s: float
    improvement: float
    improvement_ci95: tuple[float, float]
    baseline_std: float
    augmented_std: float
    improvement_std: float
    improvement_std_ci95: tuple[float, float]
    per_run: tuple[RunScore, ...]
    compensation_rms: float | None = None
    over_compensation_ci95: tuple[float, float] | None = None
    compensation_std: float | None = None
    over_compensation_std_ci95: tuple[float, float] | None = None


def score(before: Fit, after: Fit, runs: Sequence[Run], unit: str, seed: int, box: BlackBox | None = None) -> Score | None:
    """Root mean squares of runs before and after, and the improvement with its interval; None of no runs.

    Parameters
    ----------
    before, after : Fit
    runs : sequence of Run
    unit : str
        Of the output.
    seed : int
        Of the draws that intervals are made of.
    box : BlackBox, optional
        Evaluated as well, on runs that it was not trained on.
    """
    pairs = [(before.residual(run), after.residual(run)) for run in runs]
    if not pairs:
        return None
    centred = [(left - left.mean(), right - right.mean()) for left, right in pairs]
    per_run = []
    learnt = [None if box is None else box.residual(run) for run in runs]
    compensated = [(left, pair[1]) for left, pair in zip(learnt, pairs, strict=True) if left is not None]
    of_own_mean = [(left - left.mean(), right - right.mean()) for left, right in compensated]
    for run, pair, about, left in zip(runs, pairs, centred, learnt, strict=True):
        one, other = _rms([pair[0]]), _rms([pair[1]])
        stds = _rms([about[0]]), _rms([about[1]])
        whole = RunScore(run.name, one, other, after.noise_rms, *stds, 1.0 - other / one, _interval([pair], seed))
        if left is not None:
            whole = dataclasses.replace(whole, compensation_rms=_rms([left]), compensation_std=_rms([left - left.mean()]))
        per_run.append(whole)
    sizes = [[_rms([pair[k] for pair in group]) for k in (0, 1)] for group in (pairs, centred)]
    (one, other), (one_std, other_std) = sizes
    return Score(
        baseline_rms=one,
        augmented_rms=other,
        noise_floor_rms=after.noise_rms,
        unit=unit,
        averaging_s=after.data.runs[0].grid.window_s,
        improvement=1.0 - other / one,
        improvement_ci95=_interval(pairs, seed),
        baseline_std=one_std,
        augmented_std=other_std,
        improvement_std=1.0 - other_std / one_std,
        improvement_std_ci95=_interval(centred, seed),
        per_run=tuple(per_run),
        compensation_rms=_rms([left for left, _ in compensated]) if compensated else None,
        over_compensation_ci95=_interval(compensated, seed) if compensated else None,
        compensation_std=_rms([left for left, _ in of_own_mean]) if compensated else None,
        over_compensation_std_ci95=_interval(of_own_mean, seed) if compensated else None,
    )


def _interval(pairs: Sequence[tuple[Array, Array]], seed: int) -> tuple[float, float]:
    rng = np.random.default_rng(seed)
    drawn = [drawn_squares(pair, block=max(1, len(pair[0]) // _BLOCKS), rng=rng)[0] for pair in pairs]
    low, high = np.quantile(1.0 - np.sqrt(sum(b[1] for b in drawn) / sum(b[0] for b in drawn)), _INTERVAL)
    return float(low), float(high)


def _rms(parts: Sequence[Array]) -> float:
    return max(float(np.sqrt(np.mean(np.concatenate(parts) ** 2))), 1e-300)
