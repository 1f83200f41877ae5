"""Bases with a memory: lags of the first order and their spectra, plays and relays, and the history before a run."""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Sequence
from typing import Any, Final, NamedTuple, Self

import numpy as np
import numpy.typing as npt

from rlgcomp.diagnosis import priors
from rlgcomp.diagnosis.data import Run
from rlgcomp.diagnosis.forms.bases import Basis, gaussian_process, kernel, kernel_root
from rlgcomp.diagnosis.forms.drivers import BEYOND, Driver
from rlgcomp.diagnosis.forms.histories import Histories, one_rest, rests_beside, turns_before, turns_before_others
from rlgcomp.numerics.hysteresis import ColemanHodgdon, duhem_paths, exponential_radii, middles_of_steps, play_paths
from rlgcomp.numerics.relays import STARTS, Start, Switches, relay_states, states_after, states_before

Array = npt.NDArray[np.float64]
SIDES: Final[tuple[Start, ...]] = ("rested", "below", "above")
_OTHER_HISTORY: Final = 0.25  # of a polishing step, from which on other histories are tried
PLANE: Final = 1.6  # ranges of the driver over which relays are laid: other runs go beyond
_KNOTS: Final = 24  # of a smooth density, along the middles of loops and along their widths
_SMALL: Final = 1e-3  # of the largest square of a column of densities
_PLASTIC: Final = 1.324717957244746  # the real root of x³ = x + 1
_SMOOTH_HISTORY: Final = 0.5  # correlation length over the plane of what was before a run
_CURVES: Final = 2.2  # of radii and widths of a curve that is followed, from one point of their grid to the next


class Passage(NamedTuple):
    """A part of a run in which a relay switches at a moment, wherever its driver is.

    Parameters
    ----------
    run : str
    from_s, to_s : float
        Since the beginning of the run.
    at_s : float
        The moment.
    up : bool
        Whether it switches on.
    """

    run: str
    from_s: float
    to_s: float
    at_s: float
    up: bool

    def within(self, run: Run) -> npt.NDArray[np.bool_]:
        """Bins of a run that are part of it."""
        return np.asarray((run.elapsed_s >= self.from_s) & (run.elapsed_s < self.to_s) & (run.name == self.run))

    def states(self, run: Run) -> Array:
        """Of the relay, before the moment and after it, on the bins of a run."""
        after = np.clip((run.elapsed_s - self.at_s) / run.grid.bin_s + 0.5, 0.0, 1.0)
        return after if self.up else 1.0 - after


@dataclasses.dataclass(frozen=True)
class Relays(Basis):
    """Relays, 0 or 1, each on from where the driver has come up to `up` until it has gone down to `down`.

    Parameters
    ----------
    driver : Driver
    up, down : tuple of float
        In units of the driver's range.
    start : {"rested", "below", "above"}
        What was before the run: from where the driver came to its first value; rested, the nearer level decides.
    narrowest, widest : float
        Dead bands that are the same cause.
    low, high : float
        Levels between which it stays, beside relays of the same cause.
    begins : tuple of (str, float)
        Runs by name in which a single relay may have come from either side, and their first values.
    opposite : tuple of str
        Those of them in which its state at first is the other one; further runs may then be either.
    histories : tuple of (str, tuple of float)
        What was before runs, where that is known.
    passages : tuple of Passage
        Of a single relay, at which it switches elsewhere.
    """

    driver: Driver
    up: tuple[float, ...]
    down: tuple[float, ...]
    start: Start = "rested"
    narrowest: float = 0.0
    widest: float = math.inf
    low: float = -math.inf
    high: float = math.inf
    begins: tuple[tuple[str, float], ...] = ()
    opposite: tuple[str, ...] = ()
    histories: Histories = ()
    passages: tuple[Passage, ...] = ()

    def columns(self, run: Run) -> Array:
        return self.together([self], run)[0]

    @classmethod
    def together(cls, bases: Sequence[Any], run: Run) -> list[Array]:
        found: dict[Relays, Array] = {}
        for driver in dict.fromkeys(basis.driver for basis in bases):
            values, alike = driver.values(run), [basis for basis in bases if basis.driver == driver]
            relays_of = [basis.relays_of(run, values) for basis in alike]
            up, down, first = (np.concatenate(parts) for parts in zip(*relays_of, strict=True))
            edges = np.cumsum([len(basis.up) for basis in alike])[:-1]
            found |= zip(alike, np.hsplit(relay_states(values, up, down, first), edges), strict=True)
        for basis in found:
            for passage in basis.passages:
                within = passage.within(run)
                found[basis][within, 0] = passage.states(run)[within]
        return [found[basis] for basis in bases]

    @property
    def dead_band(self) -> float:
        """Of a single relay, over half the driver's range."""
        return self.up[0] - self.down[0]

    def relays_of(self, run: Run, values: Array) -> tuple[Array, Array, Array]:
        """Thresholds, up and down, and states before a run in which the driver has values."""
        up, down = np.array(self.up), np.array(self.down)
        if self.histories:
            return up, down, _first(values, up, down, self.start, turns_before(run, self.histories))
        if run.name in self.opposite:
            start = self._other_side_than(values[0])
        else:
            start = self.start if run.name in dict(self.begins) else self.start_of_others
        return up, down, states_before(values[0], up, down, start)

    def _other_side_than(self, first: float) -> Start:
        """The side from which a single relay has come to a first value where its state is the other one."""
        if self.start == "rested":
            return "below" if first >= 0.5 * (self.up[0] + self.down[0]) else "above"
        return "below" if self.start == "above" else "above"

    @property
    def start_of_others(self) -> Start:
        """What was before a run that is none of those whose histories were found: anything, if these differ."""
        return "unknown" if self.opposite else self.start

    def nearby(self, step: float) -> tuple[Self, ...]:
        found = []
        for move in (2.0 * step / priors.THRESHOLDS, -2.0 * step / priors.THRESHOLDS):
            up, down = (tuple(level + move for level in levels) for levels in (self.up, self.down))
            found.append(dataclasses.replace(self, up=up, down=down))
            if self.narrowest <= up[0] - self.down[0] <= self.widest:
                found.append(dataclasses.replace(self, up=up))
            if self.narrowest <= self.up[0] - down[0] <= self.widest:
                found.append(dataclasses.replace(self, down=down))
        within = [one for one in found if self.low <= min(one.down) and max(one.up) <= self.high]
        return (*within, *(self.from_other_sides() if step >= _OTHER_HISTORY else ()))

    def from_other_sides(self) -> tuple[Self, ...]:
        """The same from the other side in one more, or one less, of the runs that begin within the dead band."""
        return tuple(self._from_other_side(name) for name, first in self.begins if self.down[0] < first < self.up[0])

    def _from_other_side(self, run: str) -> Self:
        opposite = tuple(name for name, _ in self.begins if (name in self.opposite) != (name == run))
        return dataclasses.replace(self, opposite=opposite)

    def after(self, histories: Histories, first: Run) -> Self:
        """The same with histories of runs in place of a side in each; a first run without one keeps its side."""
        start = self.start
        if not turns_before(first, histories):
            value = dict(self.begins)[first.name]
            on = states_before(value, np.array(self.up), np.array(self.down), self.start)[0] > 0.5
            start = "above" if on != (first.name in self.opposite) else "below"
        return dataclasses.replace(self, start=start, histories=histories, begins=(), opposite=())

    def parameters(self) -> dict[str, float]:
        centre, half = self.driver.centre, self.driver.half
        return {"threshold": centre + half * self.up[0], "dead_band": half * self.dead_band}


@dataclasses.dataclass(frozen=True)
class Plays(Basis):
    """The mean over plays of exponentially spread radii, or one play, less the driver."""

    driver: Driver
    radius: float
    spread: bool
    start: Start = "rested"
    histories: Histories = ()

    def columns(self, run: Run) -> Array:
        key = ("plays", self.driver, self.start, turns_before(run, self.histories))
        if key not in run.cache:
            run.cache[key] = self._states(run, np.concatenate([self._radii(radius) for radius in priors.RADII]))
        values, radii = self.driver.values(run), self._radii(self.radius)
        if self.radius in priors.RADII:
            at = len(radii) * priors.RADII.index(self.radius)
            states = run.cache[key][:, at : at + len(radii)]
        else:
            states = self._states(run, radii)
        chosen = states[:, :-1].mean(axis=1) if self.spread else states[:, -1]
        return np.asarray((chosen - values)[:, None])

    def radii(self) -> Array:
        """Radii of its plays in units of the driver's range, spread exponentially, and last the one radius."""
        return self._radii(self.radius)

    def before(self) -> Array:
        """Where its plays stand before a further run, in units of the driver's range; none where that hangs on its first value."""
        after = turns_before_others(self.histories)
        if not after:
            return np.empty(0)
        radii, values = self.radii(), np.array(after)
        states = play_paths(values[:, None], radii, values[0] - STARTS[self.start] * radii)[-1]
        return np.asarray(states[:-1] if self.spread else states[-1:])

    def _radii(self, radius: float) -> Array:
        """Radii spread exponentially about one, and that one."""
        return np.r_[exponential_radii(radius), radius]

    def _states(self, run: Run, radii: Array) -> Array:
        before = turns_before(run, self.histories)
        values = np.r_[before, self.driver.values(run)]
        return play_paths(values[:, None], radii, values[0] - STARTS[self.start] * radii)[len(before) :]

    def nearby(self, step: float) -> tuple[Self, ...]:
        ratio = priors.RADII[1] / priors.RADII[0]
        radii = (dataclasses.replace(self, radius=self.radius * f) for f in (ratio**step, ratio**-step))
        return *radii, *(dataclasses.replace(self, histories=rest) for rest in rests_beside(self.histories, step))

    def parameters(self) -> dict[str, float]:
        return {"radius": self.driver.half * self.radius}

    def per_unit(self) -> float:
        return 1.0 / (self.driver.half)


@dataclasses.dataclass(frozen=True)
class Followed(Basis):
    r"""Coleman and Hodgdon's loop about a curve, as :class:`~rlgcomp.physics.thermal_hysteresis.ThermalHysteresis` has it.

    The law is differential: what a turning point leaves fades with the way that the driver goes, and no relays are such a law.
    """

    driver: Driver
    radius: float
    centre: float
    width: float

    def columns(self, run: Run) -> Array:
        values, curve = self.driver.values(run), ColemanHodgdon(self.radius, self.centre, self.width)
        return self.width * curve.run(curve.init(float(values[0])), values)[0][:, None]

    def nearby(self, step: float) -> tuple[Self, ...]:
        ratio, move = _CURVES**step, priors.CURVE_CENTRES[1] - priors.CURVE_CENTRES[0]
        factors, moves = (ratio, 1.0 / ratio), (move * step, -move * step)
        return (
            *(dataclasses.replace(self, radius=self.radius * factor) for factor in factors),
            *(dataclasses.replace(self, centre=self.centre + more) for more in moves),
            *(dataclasses.replace(self, width=self.width * factor) for factor in factors),
        )

    def parameters(self) -> dict[str, float]:
        centre, half = self.driver.centre, self.driver.half
        return {"radius": half * self.radius, "curve_centre": centre + half * self.centre, "curve_K": half * self.width}

    def per_unit(self) -> float:
        return 1.0 / self.driver.half


@dataclasses.dataclass(frozen=True)
class Curves(Basis):
    """Duhem's loops about two smooth curves, one as the driver rises and one as it falls (:func:`duhem_paths`): their mean, and
    half their difference."""

    driver: Driver
    radius: float
    width: float = 0.6
    knots: int = 8

    def columns(self, run: Run) -> Array:
        values = self.driver.values(run)
        curves = gaussian_process(np.clip(middles_of_steps(values), -BEYOND, BEYOND), self.width, self.knots)
        mean = duhem_paths(values, self.radius, curves, curves)
        return np.hstack([mean, duhem_paths(values, self.radius, curves, -curves)])

    def nearby(self, step: float) -> tuple[Self, ...]:
        return tuple(dataclasses.replace(self, radius=self.radius * factor) for factor in (_CURVES**step, _CURVES**-step))

    def parameters(self) -> dict[str, float]:
        return {"radius": self.driver.half * self.radius}


@dataclasses.dataclass(frozen=True)
class Fading(Basis):
    """What is left of the history before a run, of such loops: it fades along the way of the driver."""

    driver: Driver
    radius: float

    def columns(self, run: Run) -> Array:
        way = np.abs(np.diff(self.driver.values(run), prepend=self.driver.values(run)[:1]))
        return np.exp(-np.cumsum(way) / self.radius)[:, None]


@dataclasses.dataclass(frozen=True)
class Preisach(Basis):
    r"""Relays over the Preisach plane. With `free` their density is a Gaussian process about zero, else it is the one column of
    :math:`e^{-(\alpha - \beta) / r}`. Of no width, the process is white: each relay within the range has a level of its own.

    I. D. Mayergoyz, Mathematical Models of Hysteresis, Springer, 1991.
    """

    driver: Driver
    radius: float
    free: bool
    width: float = 0.5
    levels: int = priors.PREISACH_LEVELS
    start: Start = "rested"
    histories: Histories = ()

    def columns(self, run: Run) -> Array:
        return self._sums(run, self.densities())

    def nearby(self, step: float) -> tuple[Self, ...]:
        return tuple(dataclasses.replace(self, histories=rest) for rest in rests_beside(self.histories, step))

    def weighted(self, run: Run, weights: Array) -> Array:
        return self._sums(run, (self.densities() @ weights)[:, None])[:, 0]

    def _sums(self, run: Run, densities: Array) -> Array:
        """Sums over the relays, each one half on or off, with some densities, shape (bins, k)."""
        key = ("plane", self.driver, self.levels, self.start, before := turns_before(run, self.histories))
        if key not in run.cache:
            up, down = dense(self.levels)
            run.cache[key] = _switches(self.driver.values(run), up, down, self.start, before)
        switches: Switches = run.cache[key]
        return switches.sums(densities) - 0.5 * densities.sum(axis=0)

    def densities(self) -> Array:
        """Weights of the relays, shape (relays, k)."""
        return _densities(self.radius, self.free, self.width, self.levels)


@dataclasses.dataclass(frozen=True)
class Undecided(Basis):
    """What is left of the history before a run: relays that the run has not switched yet, coming from above less from below.

    Parameters
    ----------
    driver : Driver
    radius : float
    levels : int
    count : int
        Of their densities: one, exponential in the width of a loop, or so many smooth ones that have most of the variance.
    """

    driver: Driver
    radius: float
    levels: int
    count: int = 1

    def columns(self, run: Run) -> Array:
        return self._switches(run).sums(_principal(self.radius, self.levels, self.count))

    def weighted(self, run: Run, weights: Array) -> Array:
        return self._switches(run).sums((_principal(self.radius, self.levels, self.count) @ weights)[:, None])[:, 0]

    def _switches(self, run: Run) -> Switches:
        key = ("undecided", self.driver, self.levels)
        if key not in run.cache:
            values, (up, down) = self.driver.values(run), dense(self.levels)
            run.cache[key] = _switches(values, up, down, "above").less(_switches(values, up, down, "below"))
        switches: Switches = run.cache[key]
        return switches


@functools.lru_cache(maxsize=8)
def _principal(radius: float, levels: int, count: int) -> Array:
    """Densities of the largest variance, shape (relays, count)."""
    if count == 1:
        return _densities(radius, False, 0.0, levels)
    vectors, sizes, _ = np.linalg.svd(_densities(radius, True, _SMOOTH_HISTORY, levels), full_matrices=False)
    return np.asarray((vectors * sizes)[:, :count])


@functools.lru_cache(maxsize=64)
def _densities(radius: float, free: bool, width: float, levels: int) -> Array:
    up, down = dense(levels)
    weights = np.exp(-(up - down) / radius)[:, None]
    if not free:
        return weights
    if not width:
        return np.eye(len(up))[:, (up <= 1.0) & (down >= -1.0)] * weights
    middles, widths = 0.5 * (up + down), up - down
    of_middle, of_width = (
        np.column_stack([np.interp(places, knots, column) for column in kernel_root(kernel(knots / width)).T])
        for places, knots in ((middles, np.linspace(-PLANE, PLANE, _KNOTS)), (widths, np.linspace(0.0, 2.0 * PLANE, _KNOTS)))
    )
    both = (of_middle[:, :, None] * of_width[:, None, :]).reshape(len(up), -1)
    sizes = np.sum(both**2, axis=0)
    return np.asarray(weights * both[:, sizes > _SMALL * sizes.max()])


def plane(count: int, reach: float = PLANE) -> tuple[Array, Array]:
    """Thresholds (up, down) of relays of the Preisach plane at so many levels over so many ranges, up > down."""
    levels = np.linspace(-reach, reach, count)
    up, down = np.meshgrid(levels, levels, indexing="ij")
    above = up > down
    return up[above], down[above]


@functools.lru_cache(maxsize=8)
def dense(count: int) -> tuple[Array, Array]:
    """The same for a density: each relay elsewhere in its cell, so that those of a level do not switch at once.

    The places are a sequence of low discrepancy (the R2 sequence: powers of the inverse plastic number).
    """
    up, down = plane(count)
    cell, k = 2.0 * PLANE / (count - 1), np.arange(len(up))
    return up + cell * ((0.5 + k / _PLASTIC) % 1.0 - 0.5), down + cell * ((0.5 + k / _PLASTIC**2) % 1.0 - 0.5)


def relays(values: Array, up: Array, down: Array, start: Start, before: Sequence[float] = ()) -> Array:
    """States of relays, 0 or 1, shape (bins, relays); 0.5 until the run, or what was before it, decides an unknown state."""
    return relay_states(values, up, down, _first(values, up, down, start, before))


def _switches(values: Array, up: Array, down: Array, start: Start, before: Sequence[float] = ()) -> Switches:
    """Changes of these states from bin to bin."""
    return Switches.of(values, up, down, _first(values, up, down, start, before))


def _first(values: Array, up: Array, down: Array, start: Start, before: Sequence[float]) -> Array:
    """States of relays before the first value, shape (relays,)."""
    return states_after(before, up, down, states_before(before[0] if len(before) else values[0], up, down, start))


def rest_of(basis: Plays | Preisach) -> float | None:
    """Where its driver rested before each run, in the driver's unit; None of other histories."""
    value = one_rest(basis.histories)
    return None if value is None else basis.driver.centre + basis.driver.half * value
