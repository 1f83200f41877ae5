"""Window means of bases, computed once: as their forms have them, and less what the baseline absorbs."""

from __future__ import annotations

import copy
import math
from collections.abc import Iterable, Sequence
from typing import Final, Self

import numpy as np
import numpy.typing as npt

from rlgcomp.diagnosis import priors
from rlgcomp.diagnosis.baseline import Baseline
from rlgcomp.diagnosis.bases import Basis, EachRun
from rlgcomp.diagnosis.data import Data
from rlgcomp.diagnosis.noise import Noise, Whitened
from rlgcomp.diagnosis.selections import OnlyIn
from rlgcomp.diagnosis.terms import Form

Array = npt.NDArray[np.float64]
_ABSORBED: Final = 1e-7  # share of a column's square below which the baseline has all of it
_KEPT_COLUMNS: Final = 4000  # window means of bases, and as many reduced ones, that were last asked for
_AT_ONCE: Final = 500  # columns that are reduced together
_NOISES: Final = 40  # whose factors are kept
_PROJECTED: Final = 400  # columns under one of them
_WIDE: Final = 8  # columns of a basis, from which on their covariance may be that of fewer
_UNSEEN: Final = 1e-9  # of its variance, in a direction that no size brings above the noise
Scaled = Sequence[tuple[Basis, float]]


class Recent:
    """Columns of bases, those that were last asked for.

    Parameters
    ----------
    most : int
        Columns of all of them.
    """

    def __init__(self, most: int) -> None:
        self._most, self._count = most, 0
        self._arrays: dict[Basis, Array] = {}

    def get(self, basis: Basis) -> Array | None:
        """Those of a basis; None where they are gone."""
        found = self._arrays.pop(basis, None)
        if found is not None:
            self._arrays[basis] = found
        return found

    def put(self, basis: Basis, columns: Array) -> None:
        """Those of a basis that has none here; the oldest make room."""
        self._arrays[basis] = columns
        self._count += columns.shape[1]
        while self._count > self._most and len(self._arrays) > 1:
            self._count -= self._arrays.pop(next(iter(self._arrays))).shape[1]


class Bank:
    """Window means of bases, each computed once, and the scales of forms.

    Parameters
    ----------
    data : Data
    design : ndarray, shape (n, p)
        The baseline.
    baseline : Baseline, optional
        What it is made of, without which drivers have no errors.
    """

    def __init__(self, data: Data, design: Array, baseline: Baseline | None = None) -> None:
        self.data, self.design, self.baseline = data, design, baseline
        self.white = Whitened(data, design, Noise())
        self._whitened: dict[Noise, Whitened] = {}
        self._projected: dict[Noise, Recent] = {}
        self._columns = Recent(_KEPT_COLUMNS)
        self._reduced = Recent(_KEPT_COLUMNS)
        self._held: dict[Basis, Array] = {}  # reduced columns of the forms of all regions
        self._squares: dict[Basis, tuple[float, float]] = {}
        self._scaled: dict[Form, tuple[tuple[Basis, float], ...] | None] = {}

    def with_output(self, data: Data) -> Self:
        """The same bases and noises with another output of the same windows; what does not depend on it is shared."""
        found = copy.copy(self)
        found.data, found.white = data, self.white.with_output(data)
        return found

    def whitened(self, noise: Noise) -> Whitened:
        """The data under a noise."""
        if noise == Noise():
            return self.white
        if noise not in self._whitened:
            if len(self._whitened) >= _NOISES:
                self._whitened.pop(next(iter(self._whitened)))
            self._whitened[noise] = Whitened(self.data, self.design, noise)
        return self._whitened[noise].with_output(self.data)

    def projected_under(self, noise: Noise) -> Recent:
        """Columns that were whitened under a noise and projected off the baseline."""
        if noise not in self._projected:
            if len(self._projected) >= _NOISES:
                self._projected.pop(next(iter(self._projected)))
            self._projected[noise] = Recent(_PROJECTED)
        return self._projected[noise]

    def columns(self, basis: Basis) -> Array:
        """Window means of a basis, shape (n, k)."""
        found = self._columns.get(basis)
        if found is None:
            found = self._of_runs(basis) if isinstance(basis, OnlyIn | EachRun) else self.data.means(basis.columns)
            self._columns.put(basis, found)
        return found

    def _of_runs(self, basis: OnlyIn | EachRun) -> Array:
        """Window means of a basis in some of the runs, of those that are known of it in all."""
        every, rows = self.columns(basis.basis), zip(self.data.runs, self.data.slices, strict=True)
        of_run = {run.name: part for run, part in rows if run.name in basis.runs}
        found = []
        for runs in [basis.runs] if isinstance(basis, OnlyIn) else [(name,) for name in basis.runs]:
            table = np.zeros_like(every)
            for part in (of_run[name] for name in runs if name in of_run):
                table[part] = every[part]
            found.append(table)
        return np.hstack(found)

    def scaled(self, form: Form) -> tuple[tuple[Basis, float], ...] | None:
        """The bases of a form and their scales: what the baseline cannot absorb has a mean square of one; None where it has all."""
        if form not in self._scaled:
            self._scaled[form] = self._scale(form)
        return self._scaled[form]

    def reduced(self, basis: Basis) -> Array:
        """Window means of a basis less what the baseline absorbs under white noise, in fewer columns of the same covariance."""
        found = self._held.get(basis)
        if found is None:
            found = self._reduced.get(basis)
        if found is None:
            found = _reduced(self.white.project(self.columns(basis)) * np.sqrt(self.data.white)[:, None])
            self._reduced.put(basis, found)
        return found

    def side_by_side(self, bases: Sequence[Basis]) -> Array:
        """Reduced columns of bases in one table, of which those that are held become parts."""
        tables = [self.reduced(basis) for basis in bases]
        table = np.hstack(tables)
        edges = np.cumsum([0, *(one.shape[1] for one in tables)])
        for basis, a, b in zip(bases, edges[:-1], edges[1:], strict=True):
            if basis in self._held:
                self._held[basis] = table[:, a:b]
        return table

    def prepare(self, forms: Iterable[Form], *, hold: bool = False) -> None:
        """Compute the squares of all bases of some forms together, and hold their reduced columns where so is asked."""
        bases = dict.fromkeys(basis for form in forms for basis in (*form.lead, *form.departures) if basis not in self._squares)
        some: list[tuple[Basis, Array]] = []
        for basis in bases:
            some.append((basis, self.columns(basis)))
            if sum(table.shape[1] for _, table in some) >= _AT_ONCE:
                self._prepare(some, hold)
                some = []
        if some:
            self._prepare(some, hold)

    def _prepare(self, some: Sequence[tuple[Basis, Array]], hold: bool) -> None:
        projected = self.white.project(np.hstack([table for _, table in some]))
        squares = np.sum(projected**2, axis=0) / len(self.data)
        root = np.sqrt(self.data.white)[:, None]
        edges = np.cumsum([0, *(table.shape[1] for _, table in some)])
        for (basis, table), a, b in zip(some, edges[:-1], edges[1:], strict=True):
            whole = float(np.sum(np.mean(table**2 / self.data.white[:, None], axis=0)))
            self._squares[basis] = float(squares[a:b].sum()), whole
            reduced = _reduced(root * projected[:, a:b])
            if hold:
                self._held[basis] = reduced
            else:
                self._reduced.put(basis, reduced)

    def _scale(self, form: Form) -> tuple[tuple[Basis, float], ...] | None:
        self.prepare([form])
        found = []
        for group, size in ((form.lead, form.unit), (form.departures, priors.DISCREPANCY * form.unit)):
            shown = [basis for basis in group if self._squares[basis][0] > _ABSORBED * self._squares[basis][1]]
            if group is form.lead and len(shown) < len(group):
                return None
            found += [(basis, size / math.sqrt(len(shown) * self._squares[basis][0])) for basis in shown]
        return tuple(found)


def _reduced(columns: Array) -> Array:
    """Columns, or fewer of the same covariance: directions that no size could bring above the noise are left out."""
    if columns.shape[1] < _WIDE:
        return np.ascontiguousarray(columns)
    values, vectors = np.linalg.eigh(columns.T @ columns)
    used = values > _UNSEEN * max(float(values.sum()), 1e-300)
    return np.ascontiguousarray(columns @ vectors[:, used])
