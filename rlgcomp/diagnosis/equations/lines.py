"""Frequency of a line that is not the mechanism's own, and its width where it wanders; in hertz of the runs' time."""

from __future__ import annotations

import math
from typing import Final

import numpy as np
import numpy.typing as npt

from rlgcomp.diagnosis.answer.fit import Estimate, Fit
from rlgcomp.diagnosis.forms.bases import EachRun
from rlgcomp.diagnosis.forms.times import Modulated, Straying, mean_and_width, moments

Array = npt.NDArray[np.float64]
_DRAWS: Final = 200  # of the weights, for standard deviations


def line_of(fit: Fit, k: int) -> dict[str, Estimate]:
    """Frequency of the k-th member with its standard deviation, and the width of one that wanders; none of another member.

    The width is the standard deviation of the line's spectrum about its mean; 1 / (2 pi width) is its coherence time.
    """
    lead = fit.parts[k][1][0][0] if fit.parts[k][1] else None
    if isinstance(lead, EachRun) and isinstance(lead.basis, Modulated | Straying):
        return _wandering(fit, k, lead.basis, lead.runs)
    value = None if lead is None else lead.parameters().get("frequency_hz")
    return {} if value is None else {"frequency_hz": Estimate(value, fit.spread(k, "frequency_hz", value), "Hz")}


def _wandering(fit: Fit, k: int, line: Modulated | Straying, names: tuple[str, ...]) -> dict[str, Estimate]:
    """Of the envelope of each run: mean and standard deviation of its spectrum.

    The mean is that of all time as far as runs differ among each other and weights are known.
    """
    of_runs, first = [run for run in fit.data.runs if run.name in names], fit.inside(k).start
    count = fit.bank.columns(EachRun(line, names)).shape[1] // len(names)
    inside = slice(first, first + count * len(names))
    rng = np.random.default_rng(0)
    covariance = fit.solution.covariance[inside, inside]
    drawn = rng.multivariate_normal(fit.solution.weights[inside], covariance, _DRAWS, method="eigh")
    weights = np.vstack([fit.solution.weights[inside], drawn]).reshape(-1, len(names), count)
    found = np.zeros((len(weights), len(names), 3))
    for run in of_runs:
        j = names.index(run.name)
        found[:, j] = moments(line.envelope(weights[:, j], run.name), run.elapsed_s[-1])
    mean, width = mean_and_width(found)
    own = found[0, :, 1] / np.maximum(found[0, :, 0], 1e-300) - mean[0]
    shares = found[0, :, 0] / found[0, :, 0].sum()
    between = math.sqrt(float(shares**2 @ own**2))
    return {
        "frequency_hz": Estimate(line.wave.frequency_hz + float(mean[0]), math.hypot(float(np.std(mean[1:])), between), "Hz"),
        "linewidth_hz": Estimate(float(width[0]), float(np.std(width[1:])), "Hz"),
    }
