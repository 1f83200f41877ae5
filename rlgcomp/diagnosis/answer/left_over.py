"""Runs of which more is left than noise: where what is named, or that nothing is, does not hold."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from typing import Final, NamedTuple

import numpy as np

from rlgcomp.diagnosis.answer.fit import Fit
from rlgcomp.diagnosis.data import Run

_MORE: Final = 1.5  # times the noise about a run's mean, or at its mean, from which on it is told
_CHANCE: Final = 1e-3  # probability of as much, above which it is none
_CLEAR_MEAN: Final = 4.0  # standard deviations of a mean


class LeftOver(NamedTuple):
    """What is left of one run, in the unit of the output.

    Parameters
    ----------
    run : str
    std, noise : float
        Of window means about the run's mean: what is left, and the noise that there would be.
    mean : float
        What is left of the run's mean; zero where noise, or a bias that each run has, may be that large.
    """

    run: str
    std: float
    noise: float
    mean: float


def left_over(fit: Fit, runs: Iterable[Run], *, biases: bool) -> Iterator[LeftOver]:
    r"""Runs of which clearly more is left than noise.

    With the residual r of n windows, the centring matrix H = 1 - 11ᵀ/n and the noise's covariance C, slow noise included,

    .. math::
        q = \frac{r^T H r}{\operatorname{tr} H C} , \qquad \nu q \sim \chi^2_\nu , \qquad
        \nu = \frac{(\operatorname{tr} H C)^2}{\operatorname{tr} (H C)^2} .

    Parameters
    ----------
    fit : Fit
    runs : iterable of Run
        The training runs or others.
    biases : bool
        Each run has a bias of its own, so that a mean tells nothing.

    Notes
    -----
    F. E. Satterthwaite, Biometrics Bull. 2, 110 (1946) (the degrees of freedom).
    """
    from scipy.stats import chi2

    noise, longest = fit.state.noise.without_wander, fit.data.longest
    for run in runs:
        count = len(run.windows)
        if count < 2:
            continue
        residual = fit.residual(run)
        covariance = fit.white**2 * noise.of_run(run, longest)[:count, :count]
        of_mean = math.sqrt(covariance.mean())
        centred = covariance - covariance.mean(axis=0) - covariance.mean(axis=1)[:, None] + covariance.mean()
        expected = float(np.trace(centred))
        freedom, mean = expected**2 / float(np.sum(centred * centred.T)), float(residual.mean())
        ratio = float(np.sum((residual - mean) ** 2)) / expected
        rms = math.sqrt(expected / count)
        apart = not biases and abs(mean) > max(_CLEAR_MEAN * of_mean, _MORE * rms)
        if apart or (ratio > _MORE**2 and chi2.sf(freedom * ratio, freedom) < _CHANCE):
            yield LeftOver(run.name, rms * math.sqrt(ratio), rms, mean if apart else 0.0)
