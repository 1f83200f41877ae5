"""Parameters of a law of the time in a run that is no mechanism's own equation: its amplitude, time constant and exponent."""

from __future__ import annotations

import math
from typing import Final

import numpy as np
import numpy.typing as npt

from rlgcomp.diagnosis.answer.fit import Estimate, Fit
from rlgcomp.diagnosis.forms.times import Since
from rlgcomp.diagnosis.regions.selections import in_all_runs
from rlgcomp.units import SECONDS_PER_DAY

Array = npt.NDArray[np.float64]
_STEP: Final = 1.0 / 32.0  # of the grid, at which the amplitude's change with a shape is taken


def time_law_of(fit: Fit, k: int) -> dict[str, Estimate]:
    """Parameters of the k-th member in the names of its own equation; none of another member.

    The amplitude of a logarithm is what is gained in each e-fold of 1 + t / time_constant_s; of a power, what is gained in the
    first day. Its standard deviation holds those of the shapes.
    """
    bases, form = fit.parts[k][1], fit.state.members[k].form
    law = in_all_runs(bases[0][0]) if bases else None
    if len(form.lead) != 1 or not isinstance(law, Since) or law.of_mechanism:
        return {}
    (lead,), (_, scale) = form.lead, bases[0]
    size = float(fit.weights(k)[0] * scale)
    variance = float(fit.covariance(k)[0, 0]) * scale**2
    shapes = {
        name: Estimate(value, fit.spread(k, name, value), "s" if name.endswith("_s") else "")
        for name, value in law.parameters().items()
    }
    column = fit.data.means(lead.columns)
    for name, one in shapes.items():
        slopes = [
            (_nearest(fit.data.means(moved.columns), column) - 1.0) / (moved.parameters()[name] - one.value)
            for moved in lead.nearby(_STEP)
            if moved.parameters()[name] != one.value
        ]
        variance += (size * float(np.mean(slopes)) * one.sd) ** 2 if slopes else 0.0
    if law.law == "power":
        to_day, name, unit = (SECONDS_PER_DAY / law.unit_s) ** law.value, "k", f"deg/h/day^{law.value:.3g}"
    else:
        to_day, name, unit = 1.0, "k" if law.law == "logarithm" else "initial", "deg/h"
    return {name: Estimate(size * to_day, math.sqrt(variance) * to_day, unit), **shapes}


def _nearest(table: Array, column: Array) -> float:
    """The factor of a column, beside a constant, with which it comes nearest to another."""
    one, other = table[:, 0] - table[:, 0].mean(), column[:, 0] - column[:, 0].mean()
    return float(one @ other / (one @ one))
