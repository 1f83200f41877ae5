r"""The clock of a user's simulation, where no monitor tells it: it may be late in all runs alike, or in each by its own.

With s the simulated output, the baseline lacks :math:`s(t - \delta) - s(t)`. One column for each δ of a grid, whose weight is about
one: it moves as the simulation itself does, where missing physics moves as a temperature or its rate. One run hardly tells them
apart, all runs together may.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator
from typing import Final, Self

import numpy as np
import numpy.typing as npt

from rlgcomp.diagnosis import priors
from rlgcomp.diagnosis.data import Data, Run
from rlgcomp.diagnosis.forms.bases import Basis
from rlgcomp.diagnosis.forms.terms import Form, Left, Region
from rlgcomp.diagnosis.regions.lateness import white_noise

Array = npt.NDArray[np.float64]
CLOCK: Final = "simulation's clock"
_RATIO: Final = 2.0  # from one offset to the next
_USUAL: Final = 3  # place of the size at which a weight is about one
_UNSEEN: Final = 0.03  # strength of a term that nothing can be said of
_PARTS: Final = 8  # of what is beyond an end
_LEAST: Final = 0.1  # of the smallest offset that is tried


@dataclasses.dataclass(frozen=True)
class Offset(Basis):
    """What a simulated output changes by where it is later, in all runs alike or by a weight of each.

    What it would show before its beginning or after its end is not known: it leaves its last value at slopes of their own, as large
    as its slopes elsewhere.

    Parameters
    ----------
    column : str
        The simulated output.
    runs : tuple of str
    offsets_s : tuple of float
        By how much, of each run.
    each : bool
        Each run has a weight of its own.
    """

    column: str
    runs: tuple[str, ...]
    offsets_s: tuple[float, ...]
    each: bool = False

    def columns(self, run: Run) -> Array:
        values, weights = run.column(self.column), len(self.runs) if self.each else 1
        beyond = np.zeros((run.bins, len(self.runs), _PARTS))
        moved = np.zeros((run.bins, weights))
        known = run.name in self.runs
        if known or not self.each:  # what is beyond the ends of a further run is as unknown as it was
            place = self.runs.index(run.name) if known else 0
            offset_s = self.offsets_s[place]
            moved[:, min(place, weights - 1)] = np.interp(run.elapsed_s - offset_s, run.elapsed_s, values) - values
            if known:
                beyond[:, place] = _beyond(run, values, offset_s)
        return np.hstack([moved, beyond.reshape(run.bins, -1)])

    def nearby(self, step: float) -> tuple[Self, ...]:
        factors = _RATIO**step, _RATIO**-step
        return tuple(self.with_offsets(factor * np.array(self.offsets_s)) for factor in factors)

    def with_offsets(self, offsets_s: Array) -> Self:
        return dataclasses.replace(self, offsets_s=tuple(offsets_s.tolist()))


def _beyond(run: Run, values: Array, offset_s: float) -> Array:
    """What a simulated output does beyond an end by a slope in each of a few parts, shape (bins, parts)."""
    reach_s, window_s = abs(offset_s), run.grid.window_s
    beyond_s = reach_s + run.elapsed_s[0] - (run.elapsed_s if offset_s > 0.0 else run.elapsed_s[::-1])
    squares = np.gradient(values, run.grid.bin_s) ** 2
    slope = math.sqrt(max(np.mean(squares), np.mean(squares[beyond_s > -window_s])))
    part_s = max(reach_s / _PARTS, window_s)
    return slope * np.clip(beyond_s[:, None] - part_s * np.arange(_PARTS), 0.0, part_s)


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
    offsets = [Offset(column, names, (float(sign * size_s),) * len(names)) for size_s in sizes_s for sign in (1.0, -1.0)]
    kinds = [("b = s(t - offset_s) - s(t)", offsets)]
    if len(names) > 1:
        kinds.append(("b = s(t - offset_s) - s(t), an offset a run", [dataclasses.replace(one, each=True) for one in offsets]))
    share = -math.log(len(kinds) * len(offsets))
    forms = [_form(data, design, basis, equation, noise, share) for equation, bases in kinds for basis in bases]
    shown = tuple(form for form in forms if form is not None)

    def renew(form: Form, left: Left) -> Iterator[tuple[Form, ...]]:
        """An offset by as much as its weight says."""
        (lead,) = form.lead
        assert isinstance(lead, Offset)  # noqa: S101
        moved_s = np.array(lead.offsets_s) * left.weights[0][: len(names) if lead.each else 1]
        moved_s = np.where(moved_s < 0.0, -1.0, 1.0) * np.clip(np.abs(moved_s), _LEAST * low, high)
        moved = _form(data, design, lead.with_offsets(moved_s), form.equation, noise, share)
        yield () if moved is None else (moved,)

    if shown:
        log_odds = math.log(priors.CLOCK_ODDS)
        yield Region(CLOCK, None, log_odds, shown, memory="dynamic", renew=renew, nuisance=True)


def largest_offset_s(data: Data) -> float:
    """Of a clock that is tried: a simulation that is off by more covers another run."""
    return priors.CLOCK_OFFSET * min(run.bins * run.grid.bin_s for run in data.runs)


def _form(data: Data, design: Array, basis: Offset, equation: str, noise: float, share: float) -> Form | None:
    """The form of an offset, its weight about one; None where it cannot be seen."""
    table = data.means(basis.columns)
    table = table - design @ (design.T @ table)
    strength = math.sqrt(float(np.sum(table**2)) / len(data)) / max(noise, 1e-300)
    if strength < _UNSEEN:
        return None
    sizes = np.full(len(priors.SIZES), -np.inf)
    sizes[_USUAL] = math.log(len(priors.SIZES))
    unit = strength / float(priors.SIZES[_USUAL])
    return Form(CLOCK, equation, (basis,), log_share=share, unit=unit, sizes=tuple(sizes.tolist()))
