r"""The clock of a user's simulation, where no monitor tells it: it may be late in all runs alike, or in each by its own.

With s the simulated output, the baseline lacks :math:`s(t - \delta) - s(t)`. One column for each δ of a grid, whose weight is about
one: it moves as the simulation itself does, where missing physics moves as a temperature or its rate. One run hardly tells them
apart, all runs together may.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator, Sequence
from typing import Final, Self

import numpy as np
import numpy.typing as npt

from rlgcomp.diagnosis import priors
from rlgcomp.diagnosis.data import Data, Run
from rlgcomp.diagnosis.forms.bases import Basis, EachRun
from rlgcomp.diagnosis.forms.terms import Form, Region
from rlgcomp.diagnosis.regions.lateness import white_noise

Array = npt.NDArray[np.float64]
CLOCK: Final = "simulation's clock"
_RATIO: Final = 2.0  # from one offset to the next
_USUAL: Final = 3  # place of the size at which a weight is about one
_UNSEEN: Final = 0.03  # strength of a term that nothing can be said of


@dataclasses.dataclass(frozen=True)
class Offset(Basis):
    """What a simulated output changes by where it is later by so many seconds.

    Parameters
    ----------
    column : str
        The simulated output.
    offset_s : float
    """

    column: str
    offset_s: float

    def columns(self, run: Run) -> Array:
        values = run.column(self.column)
        return (np.interp(run.elapsed_s - self.offset_s, run.elapsed_s, values) - values)[:, None]

    def nearby(self, step: float) -> tuple[Self, ...]:
        factors = _RATIO**step, _RATIO**-step
        return tuple(dataclasses.replace(self, offset_s=self.offset_s * factor) for factor in factors)


def clock_regions(data: Data, design: Array, column: str) -> Iterator[Region]:
    """The region of the clock of simulated runs that no monitor tells.

    Parameters
    ----------
    data : Data
    design : ndarray, shape (n, p)
        The baseline, orthonormal.
    column : str
        The simulated output.
    """
    window_s = data.runs[0].grid.window_s
    low, high = 0.5 * window_s, largest_offset_s(data)
    sizes_s = np.geomspace(low, high, max(2, round(math.log(high / low) / math.log(_RATIO)) + 1))
    names, noise = tuple(run.name for run in data.runs), white_noise(data, design)
    offsets = [Offset(column, float(sign * size_s)) for size_s in sizes_s for sign in (1.0, -1.0)]
    kinds: list[tuple[str, Sequence[Basis]]] = [("b = s(t - offset_s) - s(t)", offsets)]
    if len(names) > 1:
        kinds.append(("b = s(t - offset_s) - s(t), an offset a run", [EachRun(offset, names) for offset in offsets]))
    share = -math.log(len(kinds) * len(offsets))
    forms = [_form(data, design, basis, equation, noise, share) for equation, bases in kinds for basis in bases]
    shown = tuple(form for form in forms if form is not None)
    if shown:
        yield Region(CLOCK, None, math.log(priors.CLOCK_ODDS), shown, memory="dynamic", nuisance=True)


def largest_offset_s(data: Data) -> float:
    """Of a clock that is tried: a simulation that is off by more covers another run."""
    return priors.CLOCK_OFFSET * min(run.bins * run.grid.bin_s for run in data.runs)


def _form(data: Data, design: Array, basis: Basis, equation: str, noise: float, share: float) -> Form | None:
    """The form of an offset, its weight about one; None where it cannot be seen."""
    table = data.means(basis.columns)
    table = table - design @ (design.T @ table)
    strength = math.sqrt(float(np.sum(table**2)) / len(data) / table.shape[1]) / max(noise, 1e-300)
    if strength < _UNSEEN:
        return None
    sizes = np.full(len(priors.SIZES), -np.inf)
    sizes[_USUAL] = math.log(len(priors.SIZES))
    unit = strength / float(priors.SIZES[_USUAL])
    return Form(CLOCK, equation, (basis,), log_share=share, unit=unit, sizes=tuple(sizes.tolist()))
