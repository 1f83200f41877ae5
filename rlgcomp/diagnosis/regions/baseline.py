"""The simulator s(t; β): what is stated is taken off, free amplitudes are columns, free shapes enter by their derivatives."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable, Collection, Mapping, Sequence
from typing import Final, Self

import numpy as np
import numpy.typing as npt

from rlgcomp.diagnosis.data import Data, Run
from rlgcomp.diagnosis.forms.bases import Basis, Own
from rlgcomp.physics.mechanism import Mechanism, Parameter
from rlgcomp.recording import Recording
from rlgcomp.simulation.simulator import Simulator

Array = npt.NDArray[np.float64]
CONSTANT: Final = "constant_deg_h"
_STEP: Final = 1e-3  # of a shape, relative, for its derivative
_FIRST_STEP: Final = 0.3  # of a shape, relative
_ROUNDS: Final = 12  # of halved steps
_STARTS: Final = 5  # of a calibration: one of a memory has several least squares


@dataclasses.dataclass(frozen=True)
class Baseline:
    """The simulator and its free numbers.

    Parameters
    ----------
    simulator : Simulator
        Its free shapes are calibrated.
    amplitudes : mapping of str to ndarray
        By mechanism, at which derivatives by free shapes are taken.
    own : mapping of str to Basis
        Columns of mechanisms that are not computed by themselves.
    runs : tuple of str
        The training runs: mechanisms with amplitudes by run have columns in each of them.
    given : Simulator, optional
        Before its shapes were calibrated; what it states is taken off the runs.
    """

    simulator: Simulator
    amplitudes: Mapping[str, Array] = dataclasses.field(default_factory=dict)
    own: Mapping[str, Basis] = dataclasses.field(default_factory=dict)
    runs: tuple[str, ...] = ()
    given: Simulator | None = None

    def free(self, mechanism: Mechanism, role: str) -> tuple[Parameter, ...]:
        """Parameters in use of a role that are to be calibrated."""
        named = self.simulator.free.get(mechanism.name, frozenset())
        used = mechanism.amplitude_parameters() if role == "amplitude" else mechanism.shape_parameters()
        return tuple(parameter for parameter in used if parameter.name in named)

    def known(self, mechanism: Mechanism) -> tuple[tuple[int, Parameter], ...]:
        """Amplitudes in use that are stated, with their places among the mechanism's columns."""
        names = {parameter.name for parameter in self.free(mechanism, "amplitude")}
        return tuple((k, p) for k, p in enumerate(mechanism.amplitude_parameters()) if p.name not in names)

    def names(self) -> tuple[tuple[str, str, str], ...]:
        """Mechanism, parameter and unit of each column that :meth:`columns` gives; a constant where no mechanism has one."""
        found = [] if self._has_constant() else [("", CONSTANT, "deg/h")]
        for mechanism in self.simulator.mechanisms:
            runs = self.runs_of(mechanism)
            found += [
                (mechanism.name, p.name if len(runs) == 1 else amplitude_of_run(p.name, run), p.unit)
                for run in runs
                for p in self.free(mechanism, "amplitude")
            ]
            if mechanism.name in self.amplitudes:
                found += [(mechanism.name, p.name, p.unit) for p in self.free(mechanism, "shape")]
        return tuple(found)

    def runs_of(self, mechanism: Mechanism) -> tuple[str, ...]:
        """Runs in which a mechanism has columns of its own: the training runs where its amplitudes are by run; else one entry."""
        return self.runs if mechanism.each_run and self.runs else ("",)

    def _has_constant(self) -> bool:
        """Whether a mechanism has the constant bias among its free amplitudes."""
        return any(p.name == one.constant for one in self.simulator.mechanisms for p in self.free(one, "amplitude"))

    def stated(self, binned: Recording) -> Array:
        """What the simulator states for certain of a recording of bin means, shape (bins,)."""
        total = self.simulator.nominal_deg_h(binned)
        for mechanism in self.simulator.mechanisms:
            names = {parameter.name for parameter in self.free(mechanism, "amplitude")}
            known = [0.0 if p.name in names else float(getattr(mechanism, p.name)) for p in mechanism.amplitude_parameters()]
            if any(known):
                total = total + mechanism.basis(binned) @ np.array(known)
        return np.asarray(total)

    def stated_on(self, run: Run) -> Array:
        """The same on the bins of a run, columns that are not a mechanism's own as they are; shape (bins,)."""
        total = run.on_bins(self.stated(run.binned))
        for mechanism in self._stated_of_own():
            places = [k for k, _ in self.known(mechanism)]
            known = np.array([float(getattr(mechanism, p.name)) for _, p in self.known(mechanism)])
            total = total + (self._table(mechanism, run) - run.on_bins(mechanism.basis(run.binned)))[:, places] @ known
        return np.asarray(total)

    def changed(self, run: Run) -> Array:
        """What is stated beyond what the given simulator states: known amplitudes by shapes that were calibrated; shape (bins,)."""
        if self.given is None:
            return np.zeros(run.bins)
        return self.stated_on(run) - run.on_bins(Baseline(self.given).stated(run.binned))

    def _stated_of_own(self) -> list[Mechanism]:
        return [one for one in self.simulator.mechanisms if one.name in self.own and self.known(one)]

    def less_stated(self, data: Data) -> Data:
        """The runs less what this simulator states, where that is not what the given one states."""
        if self.given is None:
            return data
        given, pairs = Baseline(self.given), zip(self.given.mechanisms, self.simulator.mechanisms, strict=True)
        same = all(not given.known(one) or (one == other and given.known(one) == self.known(other)) for one, other in pairs)
        return data if same and not self._stated_of_own() else dataclasses.replace(data, changed=self.changed)

    def columns(self, run: Run) -> Array:
        """Free columns on the bins of a run, shape (bins, p): a constant, amplitudes, and derivatives by shapes.

        A mechanism with amplitudes by run has none in a run that was not trained on.
        """
        found = [np.empty((run.bins, 0)) if self._has_constant() else np.ones((run.bins, 1))]
        for mechanism in self.simulator.mechanisms:
            table, shares = self._table(mechanism, run), self._shares(mechanism, run)
            free = self._of_amplitudes(mechanism, table)
            found += [share * free for share in shares]
            for shape in self.free(mechanism, "shape") if mechanism.name in self.amplitudes else ():
                change = Own(_moved(mechanism, shape, 1.0 + _STEP)).columns(run) - table
                found.append((change @ (shares @ self.amplitudes[mechanism.name]))[:, None] / _STEP)
        return np.hstack(found)

    def repeating(self, numbers: Array) -> Array:
        """Numbers of :meth:`columns` with amplitudes by run at zero, shape (p,)."""
        by_run = {mechanism.name for mechanism in self.simulator.mechanisms if mechanism.each_run}
        return np.where([name in by_run for name, _, _ in self.names()], 0.0, numbers)

    @property
    def by_run(self) -> tuple[str, ...]:
        """Mechanisms with amplitudes by run."""
        return tuple(one.name for one in self.simulator.mechanisms if one.each_run and one.amplitude_parameters())

    def own_columns(self, run: Run) -> Array:
        """Columns of amplitudes that a run has of its own and that no other run tells, shape (bins, k); none of a training run."""
        if run.name in self.runs:
            return np.empty((run.bins, 0))
        by_run = [mechanism for mechanism in self.simulator.mechanisms if mechanism.each_run]
        return np.hstack([np.empty((run.bins, 0)), *(self._of_amplitudes(one, self._table(one, run)) for one in by_run)])

    def _of_amplitudes(self, mechanism: Mechanism, table: Array) -> Array:
        used = [p.name for p in mechanism.amplitude_parameters()]
        return table[:, [used.index(p.name) for p in self.free(mechanism, "amplitude")]]

    def _shares(self, mechanism: Mechanism, run: Run) -> Array:
        """Of the amplitudes of each of a mechanism's runs in a run, shape (runs,)."""
        runs = self.runs_of(mechanism)
        return np.array([name in ("", run.name) for name in runs], dtype=np.float64)

    def _table(self, mechanism: Mechanism, run: Run) -> Array:
        basis = self.own.get(mechanism.name)
        return Own(mechanism).columns(run) if basis is None else basis.columns(run) / basis.per_unit()

    def design(self, data: Data) -> Array:
        """Columns of all training runs, orthonormal, dependent ones left out, shape (n, p)."""
        return independent(data.means(self.columns))

    def linearised(self, data: Data, beside: Array | None = None) -> Self:
        """The same with amplitudes by least squares, at which derivatives by shapes are taken, shape (runs, k) each."""
        plain = dataclasses.replace(self, amplitudes={}, runs=tuple(run.name for run in data.runs))
        less = Less.of(beside)
        output = less(self.less_stated(data).output)
        weights = np.linalg.lstsq(less(data.means(plain.columns)), output, rcond=1e-12)[0]
        amplitudes, at = {}, 0 if self._has_constant() else 1
        for mechanism in self.simulator.mechanisms:
            names = {p.name for p in self.free(mechanism, "amplitude")}
            stated = np.array([[float(getattr(mechanism, p.name)) for p in mechanism.amplitude_parameters()]])
            before = self.amplitudes.get(mechanism.name, stated).mean(axis=0)  # of stated ones, which are as in every run
            values = np.tile(before, (len(plain.runs_of(mechanism)), 1))
            places = [k for k, p in enumerate(mechanism.amplitude_parameters()) if p.name in names]
            count = len(places) * len(values)
            values[:, places] = weights[at : at + count].reshape(len(values), -1)
            at += count
            amplitudes[mechanism.name] = values
        return dataclasses.replace(plain, amplitudes=amplitudes)

    def with_own(self, candidates: Sequence[Mapping[str, Basis]], data: Data, beside: Array | None = None) -> Self:
        """The same with the likeliest columns of mechanisms that are not computed by themselves, their amplitudes free.

        Parameters
        ----------
        candidates : sequence of mapping of str to Basis
            Of the same mechanisms.
        data : Data
        beside : ndarray, shape (n, r), optional
            As of :meth:`calibrated`.
        """
        less, free = Less.of(beside), dict(self.simulator.free)
        for mechanism in self.simulator.mechanisms:
            if mechanism.name in candidates[0]:
                free[mechanism.name] = frozenset(p.name for p in mechanism.amplitude_parameters())
        freed = dataclasses.replace(self, simulator=dataclasses.replace(self.simulator, free=free), amplitudes={})

        def misfit(own: Mapping[str, Basis]) -> float:
            tried = dataclasses.replace(freed, own=own)
            table, output = less(data.means(tried.columns)), less(tried.less_stated(data).output)
            size = np.maximum(np.linalg.norm(table, axis=0), 1e-300)
            left = output - table / size @ np.linalg.lstsq(table / size, output, rcond=1e-10)[0]
            return float(left @ left)

        best = min(candidates, key=misfit) if len(candidates) > 1 else candidates[0]
        return dataclasses.replace(self, own=best).linearised(data, beside)

    @classmethod
    def calibrated(
        cls, simulator: Simulator, data: Data, beside: Array | None = None, wrong: Mapping[str, Collection[str]] | None = None
    ) -> Self:
        """The simulator with its free shapes at their least squares, from the best points of each mechanism's grid on.

        Parameters
        ----------
        simulator : Simulator
        data : Data
        beside : ndarray, shape (n, r), optional
            Columns that are fitted as well, their weights about as large as the white noise.
        wrong : mapping of str to collection of str, optional
            By mechanism, amplitudes that are stated and may be wrong: shapes are calibrated, and derivatives taken, with them free.
        """
        names_of_runs, less = tuple(run.name for run in data.runs), Less.of(beside)
        given, free = simulator, {name: simulator.free.get(name, frozenset()) | set(more) for name, more in (wrong or {}).items()}
        simulator = dataclasses.replace(simulator, free={**simulator.free, **free})
        for mechanism in simulator.mechanisms:
            own = cls(simulator)
            shapes = own.free(mechanism, "shape")
            if not shapes:
                continue

            @functools.cache
            def misfit(candidate: Mechanism, others: Simulator = simulator) -> float:
                tried = cls(others.with_mechanism(candidate), runs=names_of_runs, given=given)
                output = less(tried.less_stated(data).output)
                table = data.means(tried.columns)
                table = less(table / np.maximum(np.linalg.norm(table, axis=0), 1e-300))
                left = output - table @ np.linalg.lstsq(table, output, rcond=1e-10)[0]
                return float(left @ left)

            names = [shape.name for shape in shapes]
            grid = type(mechanism).grid([run.binned for run in data.runs])
            points = [_with(mechanism, {name: getattr(point, name) for name in names}) for point in grid]
            starts = sorted(dict.fromkeys((*points, mechanism)), key=misfit)[:_STARTS]
            best = min((_descended(start, shapes, misfit) for start in starts), key=misfit)
            simulator = simulator.with_mechanism(best)
        found = cls(simulator, given=given).linearised(data, beside)
        return dataclasses.replace(found, simulator=dataclasses.replace(simulator, free=given.free))


@dataclasses.dataclass(frozen=True, eq=False)
class Less:
    r"""Columns less what others take up, so that their squares are those of least squares with :math:`w` free beside.

    .. math:: \min_w \lVert y - A w\rVert^2 + \lVert w\rVert^2 = \lVert (I - U (1 - (1 + s^2)^{-1/2}) U^\top) y\rVert^2,
        \quad A = U s V^\top

    Parameters
    ----------
    directions : ndarray, shape (n, r)
        U.
    shares : ndarray, shape (r,)
    """

    directions: Array
    shares: Array

    @classmethod
    def of(cls, columns: Array | None) -> Self:
        """Of A; of nothing, all is left."""
        if columns is None:
            return cls(np.empty((0, 0)), np.empty(0))
        directions, sizes, _ = np.linalg.svd(columns, full_matrices=False)
        return cls(directions, 1.0 - 1.0 / np.sqrt(1.0 + sizes**2))

    def __call__(self, table: Array) -> Array:
        if not len(self.shares):
            return table
        return np.asarray(table - (self.directions * self.shares) @ (self.directions.T @ table))


def amplitude_of_run(name: str, run: str) -> str:
    """What an amplitude of one run is called."""
    return f"{name} of {run}"


def independent(table: Array) -> Array:
    """Columns of unit size that are linearly independent of those before them."""
    kept: list[Array] = []
    for column in table.T:
        size = np.linalg.norm(column)
        if size == 0.0:
            continue
        left = column / size
        for _ in range(2):
            for other in kept:
                left = left - other * (other @ left)
        if np.linalg.norm(left) > 1e-6:
            kept.append(left / np.linalg.norm(left))
    return np.column_stack(kept)


def _descended(start: Mechanism, shapes: Sequence[Parameter], misfit: Callable[[Mechanism], float]) -> Mechanism:
    """The least misfit that steps of each shape lead to."""
    best, step = start, _FIRST_STEP
    for _ in range(_ROUNDS):
        moved = [_moved(best, shape, 1.0 + sign * step) for shape in shapes for sign in (-1.0, 1.0)]
        nearer = min([best, *moved], key=misfit)
        step = step if nearer != best else 0.5 * step
        best = nearer
    return best


def _moved(mechanism: Mechanism, shape: Parameter, factor: float) -> Mechanism:
    value = float(getattr(mechanism, shape.name))
    moved = value * factor if value else factor - 1.0
    return _with(mechanism, {shape.name: float(np.clip(moved, shape.low, shape.high))})


def _with(mechanism: Mechanism, values: Mapping[str, float]) -> Mechanism:
    return type(mechanism)(**(mechanism.to_mapping() | dict(values)))
