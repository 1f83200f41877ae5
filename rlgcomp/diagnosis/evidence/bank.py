"""Window means of bases, computed once: as their forms have them, and less what the baseline absorbs."""

from __future__ import annotations

import copy
import functools
import math
from collections.abc import Iterable, Sequence
from typing import Final, Self

import numpy as np
import numpy.typing as npt

from rlgcomp.diagnosis import priors
from rlgcomp.diagnosis.data import Data
from rlgcomp.diagnosis.evidence.recent import Recent
from rlgcomp.diagnosis.forms.bases import Basis, EachRun, columns_together
from rlgcomp.diagnosis.forms.terms import Form
from rlgcomp.diagnosis.noise.model import Noise, Whitened
from rlgcomp.diagnosis.regions.baseline import Baseline
from rlgcomp.diagnosis.regions.selections import OnlyIn

Array = npt.NDArray[np.float64]
_ABSORBED: Final = 1e-7  # share of a column's square below which the baseline has all of it
_KEPT_COLUMNS: Final = 3000  # window means of bases, and as many columns under noises, that were last asked for
_KEPT_REDUCED: Final = 9000  # and reduced columns: those of a form that is polished are asked for under several noises
_TOGETHER: Final = 32  # bases that are made and reduced together
_NOISES: Final = 40  # whose factors are kept
_WIDE: Final = 8  # columns of a basis, from which on their covariance may be that of fewer
_UNSEEN: Final = 1e-9  # of its variance, in a direction that no size brings above the noise
Scaled = Sequence[tuple[Basis, float]]


def _width(table: Array) -> int:
    return table.shape[1]


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
        self.projected = Recent[tuple[Noise, Basis], Array](_KEPT_COLUMNS, _width)
        self._whitened = Recent[Noise, Whitened](_NOISES)
        self._columns = Recent[Basis, Array](_KEPT_COLUMNS, _width)
        self._reduced = Recent[Basis, Array](_KEPT_REDUCED, _width)
        self._held: dict[Basis, Array] = {}  # reduced columns of the forms of all regions
        self._squares: dict[Basis, tuple[float, float]] = {}
        self._widths: dict[Basis, int] = {}
        self._scaled: dict[Form, tuple[tuple[Basis, float], ...] | None] = {}

    def with_output(self, data: Data) -> Self:
        """The same bases and noises with another output of the same windows; what does not depend on it is shared."""
        found = copy.copy(self)
        found.data, found.white = data, self.white.with_output(data)
        return found

    def forget(self) -> None:
        """Forget what can be computed anew."""
        for kept in (self.projected, self._whitened, self._columns, self._reduced):
            kept.clear()

    @functools.cached_property
    def of_baseline(self) -> Array:
        """Window means of the baseline's free columns, shape (n, p)."""
        assert self.baseline is not None  # noqa: S101
        return self.data.means(self.baseline.columns)

    def whitened(self, noise: Noise) -> Whitened:
        """The data under a noise."""
        if noise == Noise():
            return self.white
        return self._whitened.of(noise, lambda: Whitened(self.data, self.design, noise)).with_output(self.data)

    def columns(self, basis: Basis) -> Array:
        """Window means of a basis, shape (n, k)."""
        return self.columns_together([basis])[0]

    def columns_together(self, bases: Sequence[Basis]) -> list[Array]:
        """The same of several bases."""
        found = {basis: self._columns.get(basis) for basis in bases}
        lacking = [basis for basis, one in found.items() if one is None]
        plain = [basis for basis in lacking if not isinstance(basis, OnlyIn | EachRun)]
        if plain:
            tables = [columns_together(plain, run) for run in self.data.runs]
            means = np.vstack([run.means(np.hstack(of_run)) for run, of_run in zip(self.data.runs, tables, strict=True)])
            for basis, part in zip(plain, np.hsplit(means, np.cumsum([one.shape[1] for one in tables[0]])[:-1]), strict=True):
                found[basis] = self._columns.put(basis, np.ascontiguousarray(part))
        for basis in lacking:
            if isinstance(basis, OnlyIn | EachRun):
                found[basis] = self._columns.put(basis, self._of_runs(basis))
        return [one for basis in bases if (one := found[basis]) is not None]

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
        try:
            return self._scaled[form]
        except KeyError:
            pass
        try:
            found = self._scale(form)
        except KeyError:  # its bases are met for the first time
            self.prepare([form])
            found = self._scale(form)
        self._scaled[form] = found
        return found

    def reduced(self, basis: Basis) -> Array:
        """Window means of a basis less what the baseline absorbs under white noise, in fewer columns of the same covariance."""
        return self.reduced_together([basis])[0]

    def reduced_together(self, bases: Sequence[Basis]) -> list[Array]:
        """The same of several bases."""
        found = {basis: self._held.get(basis, self._reduced.get(basis)) for basis in bases}
        lacking = [basis for basis, one in found.items() if one is None]
        found |= dict(zip(lacking, self._prepare(lacking, self.columns_together(lacking), hold=False), strict=True))
        return [one for basis in bases if (one := found[basis]) is not None]

    def width(self, basis: Basis) -> int:
        """Number of its reduced columns."""
        width = self._widths.get(basis)
        if width is None:
            self.reduced(basis)
            width = self._widths[basis]
        return width

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
        self.prepare_bases((basis for form in forms for basis in form.bases), hold=hold)

    def prepare_bases(self, wanted: Iterable[Basis], *, hold: bool = False) -> None:
        """The same of bases."""
        bases = list(dict.fromkeys(basis for basis in wanted if basis not in self._squares))
        for first in range(0, len(bases), _TOGETHER):
            some = bases[first : first + _TOGETHER]
            self._prepare(some, self.columns_together(some), hold)

    def _prepare(self, bases: Sequence[Basis], tables: Sequence[Array], hold: bool) -> list[Array]:
        """Reduced columns of bases of window means, which are kept with their squares and widths."""
        if not bases:
            return []
        table = np.hstack(tables)
        projected = self.white.project(table)
        squares, wholes = np.mean(projected**2, axis=0), np.mean(table**2 / self.data.white[:, None], axis=0)
        projected *= np.sqrt(self.data.white)[:, None]
        edges, found = np.cumsum([0, *(one.shape[1] for one in tables)]), []
        for basis, a, b in zip(bases, edges[:-1], edges[1:], strict=True):
            self._squares[basis] = float(squares[a:b].sum()), float(wholes[a:b].sum())
            found.append(_reduced(projected[:, a:b], self._widths.get(basis)))
            self._widths[basis] = found[-1].shape[1]
            if hold:
                self._held[basis] = found[-1]
            else:
                self._reduced.put(basis, found[-1])
        return found

    def scale_of_lead(self, form: Form, basis: Basis) -> float:
        """Scale of a basis in the place of one of a form's leading ones; zero where the baseline has it. It was prepared."""
        square, whole = self._squares[basis]
        return form.unit / math.sqrt(len(form.lead) * square) if square > _ABSORBED * whole else 0.0

    def _scale(self, form: Form) -> tuple[tuple[Basis, float], ...] | None:
        found: list[tuple[Basis, float]] = []
        for group, size in ((form.lead, form.unit), (form.departures, priors.DISCREPANCY * form.unit)):
            squares = [(basis, *self._squares[basis]) for basis in group]
            shown = [(basis, square) for basis, square, whole in squares if square > _ABSORBED * whole]
            if group is form.lead and len(shown) < len(group):
                return None
            of_lead = dict(found)
            departures = sum(basis.in_units_of is None for basis, _ in shown)
            for basis, square in shown:
                beside = basis.in_units_of
                found.append((basis, size / math.sqrt(departures * square) if beside is None else of_lead[beside]))
        return tuple(found)


def _reduced(columns: Array, width: int | None = None) -> Array:
    """Columns, or fewer of the same covariance: directions that no size could bring above the noise are left out.

    Parameters
    ----------
    columns : ndarray, shape (n, k)
    width : int, optional
        Number of directions, where it is known.
    """
    if columns.shape[1] < _WIDE:
        return np.ascontiguousarray(columns)
    values, vectors = np.linalg.eigh(columns.T @ columns)
    first = len(values) - width if width is not None else int(np.sum(values <= _UNSEEN * max(float(values.sum()), 1e-300)))
    return np.ascontiguousarray(columns @ vectors[:, first:])
