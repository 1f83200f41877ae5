r"""Hops whose thresholds scatter: at each passage a hop switches a little before or after its thresholds.

A mode hop follows the path length, of which a thermometer shows a part: gradients, the gain of the gas and the thermometer's own
error move the threshold from one passage to the next. Without that, what jumps where the temperature passes is a process of two
values that nothing recorded drives, for such a process meets every jump.

Each passage has a threshold of its own, :math:`\delta_k` from the relay's, with a spread s that is one of a few,

.. math:: p = q \, \mathrm{mean}_s \prod_k r_k \, N(\delta_k; 0, s^2),

r being what the driver passes in a bin, to which a switch is placed. The relay's thresholds are the means of those of its passages.
"""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from rlgcomp.diagnosis import priors
from rlgcomp.diagnosis.data import Data, Run
from rlgcomp.diagnosis.forms.memories import Passage, Relays
from rlgcomp.diagnosis.forms.terms import Form, Left
from rlgcomp.diagnosis.regions.setting import Setting

Array = npt.NDArray[np.float64]
SCATTERS: Final = ", at each passage from a threshold of its own"
_SHIFTS: Final = (0.5, 1, 1.5, 2, 3, 5, 8, 13, 21, 34, 55)  # bins by which a passage is tried earlier and later
_WORTH: Final = 3.0  # nats that a passage gains elsewhere
_LEAST_STEP: Final = 1e-3  # of the driver in a bin: what a resting one passes by its noise
_PARTS: Final = (1.0, 0.5, 0.25)  # of the passages that gain most, moved together


class Switch(NamedTuple):
    """Where a relay switches in a run.

    Parameters
    ----------
    run : Run
    at_s : float
        Since the beginning of the run.
    up : bool
        Whether it switches on.
    value : float
        Of the driver, in units of its range.
    step : float
        What the driver passes in a bin.
    """

    run: Run
    at_s: float
    up: bool
    value: float
    step: float


def scattering(setting: Setting) -> Callable[[Form, Left], Iterator[tuple[Form, ...]]]:
    """A sum of hops with passages elsewhere, where what is left shows them to be; none of any other form."""
    data = setting.data

    def renew(form: Form, left: Left) -> Iterator[tuple[Form, ...]]:
        relays = [one for one in form.lead if isinstance(one, Relays) and len(one.up) == 1]
        if len(relays) < len(form.lead):
            return
        moved: list[tuple[float, int, int, float]] = []
        for k, (relay, weights) in enumerate(zip(relays, left.weights, strict=True)):
            for n, (gain, at_s) in enumerate(_likeliest(relay, data, left, float(weights[0]))):
                if gain > _WORTH:
                    moved.append((gain, k, n, at_s))
        moved.sort(reverse=True)
        counts = dict.fromkeys(math.ceil(part * len(moved)) for part in _PARTS) if moved else {}
        yield tuple(_with(form, relays, moved[:count], data) for count in counts)

    return renew


def log_prior(relay: Relays, data: Data) -> float:
    """Of the passages that a relay has, over that of none."""
    if not relay.passages:
        return 0.0
    passed = [(one.step, one.value - (relay.up[0] if one.up else relay.down[0])) for one in switches_of(relay, data)]
    of_spreads = [
        sum(math.log(step / spread / math.sqrt(2.0 * math.pi)) - 0.5 * (offset / spread) ** 2 for step, offset in passed)
        for spread in priors.SCATTERS
    ]
    top = max(of_spreads)
    return math.log(priors.SCATTER_ODDS) + top + math.log(sum(math.exp(one - top) for one in of_spreads) / len(of_spreads))


def scatter_of(relay: Relays, data: Data) -> tuple[Array, Array]:
    """Offsets of the thresholds of a relay at its passages up and down in the training runs, in the unit of the driver's column."""
    switches, half = switches_of(relay, data), relay.driver.half
    up, down = (
        [half * (one.value - level) for one in switches if one.up == on]
        for on, level in ((True, relay.up[0]), (False, relay.down[0]))
    )
    return np.array(up), np.array(down)


def switches_of(relay: Relays, data: Data) -> list[Switch]:
    """Where a relay switches in the training runs, in order."""
    return [switch for run in data.runs for switch in _switches_in(relay, run)]


def _switches_in(relay: Relays, run: Run) -> list[Switch]:
    states, values = relay.columns(run)[:, 0], relay.driver.values(run)
    own = {passage.at_s for passage in relay.passages if passage.run == run.name}
    found = []
    for place in (np.flatnonzero(np.diff(states > 0.5)) + 1).tolist():  # between the middles of these two bins
        up, before, after = bool(states[place] > 0.5), float(values[place - 1]), float(values[place])
        level = relay.up[0] if up else relay.down[0]
        part = min(max((level - before) / (after - before), 0.0), 1.0) if after != before else 0.5
        at_s = float(run.elapsed_s[place - 1]) + part * run.grid.bin_s
        at_s = min(own, key=lambda one: abs(one - at_s)) if own else at_s
        step = max(0.5 * abs(float(values[min(place + 1, run.bins - 1)]) - before), _LEAST_STEP)
        found.append(Switch(run, at_s, up, float(np.interp(at_s, run.elapsed_s, values)), step))
    return found


def _likeliest(relay: Relays, data: Data, left: Left, step: float) -> Iterator[tuple[float, float]]:
    """For each switch what it gains where it is likeliest, and when that is."""
    for run, rows in zip(data.runs, data.slices, strict=True):
        switches = _switches_in(relay, run)
        times = [one.at_s for one in switches]
        for n, switch in enumerate(switches):
            first = times[n - 1] if n else 0.0
            last = times[n + 1] if n + 1 < len(times) else float(run.elapsed_s[-1])
            tried = [switch.at_s + sign * shift * run.grid.bin_s for shift in _SHIFTS for sign in (1.0, -1.0)]
            tried = [at_s for at_s in tried if first < at_s < last]
            if not tried:
                yield 0.0, switch.at_s
                continue
            columns = [_elsewhere(relay, switches, {n: at_s}).columns(run)[:, 0] for at_s in tried]
            change = run.means(np.column_stack(columns) - relay.columns(run))
            gains = step * (left.residual[rows] @ change) - 0.5 * step**2 * np.sum(change**2 / data.white[rows, None], axis=0)
            best = int(np.argmax(gains))
            yield float(gains[best]) / left.variance, tried[best]


def _elsewhere(relay: Relays, switches: Sequence[Switch], at_s: Mapping[int, float]) -> Relays:
    """A relay with passages at its switches, some of them at other times."""
    passages = []
    for run in dict.fromkeys(one.run for one in switches):
        here = [(at_s.get(n, one.at_s), one.up) for n, one in enumerate(switches) if one.run is run]
        edges = [0.0, *(0.5 * (a + b) for (a, _), (b, _) in itertools.pairwise(here)), math.inf]
        passages += [Passage(run.name, a, b, *one) for one, a, b in zip(here, edges[:-1], edges[1:], strict=True)]
    return dataclasses.replace(relay, passages=tuple(passages))


def _about_their_means(relay: Relays, data: Data) -> Relays:
    """A relay with the means of the thresholds of its passages, where it may have these."""
    switches = switches_of(relay, data)
    up, down = ([one.value for one in switches if one.up == on] for on in (True, False))
    ups, downs = float(np.mean(up)) if up else relay.up[0], float(np.mean(down)) if down else relay.down[0]
    possible = relay.narrowest <= ups - downs <= relay.widest and relay.low <= downs and ups <= relay.high
    return dataclasses.replace(relay, up=(ups,), down=(downs,)) if possible else relay


def _with(form: Form, relays: Sequence[Relays], moved: Sequence[tuple[float, int, int, float]], data: Data) -> Form:
    """A form whose relays switch elsewhere at some passages: all passages have thresholds of their own then."""
    lead = []
    for k, relay in enumerate(relays):
        at_s = {n: at_s for _, one, n, at_s in moved if one == k}
        lead.append(_about_their_means(_elsewhere(relay, switches_of(relay, data), at_s), data) if at_s else relay)
    more = sum(log_prior(one, data) for one in lead) - sum(log_prior(one, data) for one in relays)
    equation = form.equation.removesuffix(SCATTERS) + SCATTERS
    return dataclasses.replace(form, equation=equation, lead=tuple(lead), log_share=form.log_share + more)
