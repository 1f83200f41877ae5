r"""The evidence of many forms at once beside a set.

Columns lie side by side, in the unit of the output, and stay as they are: a noise needs only the Gram matrices of forms, and a set
with columns A is met by :math:`A^T B` alone. Forms of the same departures K, each with a few columns L of its own, share one
eigenproblem :math:`K^T K = U \Lambda U^T`; of size s, the rest of

.. math:: M = I + s^2 \begin{pmatrix} K^T K & K^T L \\ L^T K & L^T L \end{pmatrix}

is the small matrix :math:`S = I + s^2 L^T L - W^T \mathrm{diag}(s^4 / (1 + s^2 \lambda)) W` with :math:`W = U^T K^T L`.
"""

from __future__ import annotations

import dataclasses
import functools
from collections import defaultdict
from collections.abc import Hashable, Mapping, Sequence
from typing import Final, Self

import numpy as np
import numpy.typing as npt

from rlgcomp.diagnosis import priors
from rlgcomp.diagnosis.evidence.bank import Bank
from rlgcomp.diagnosis.evidence.closed_form import Conditional, Evidence
from rlgcomp.diagnosis.evidence.recent import Recent
from rlgcomp.diagnosis.forms.bases import Basis
from rlgcomp.diagnosis.forms.terms import Form
from rlgcomp.diagnosis.noise.model import Noise, Whitened

Array = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.intp]
Scaled = tuple[tuple[Basis, float], ...]
_OWN: Final = 8  # columns of a form beside those that it shares
_SHARED: Final = 4  # columns that are shared, at least
_ALIKE: Final = 4  # forms that share them, at least
_MOST: Final = 0.5  # of a section's columns, from which on no part of them is copied
_KEPT: Final = 8_000_000  # numbers of products of sections under noises of a gyro alone, and as many beside errors of drivers
KEPT_BY_REPEATED: Final = 40_000_000  # of the first where a search is repeated with other outputs


@dataclasses.dataclass(frozen=True)
class Panel:
    """Forms of equally many columns that share some: numbers of the forms, places among a section's columns, and scales.

    Parameters
    ----------
    forms : ndarray of int, shape (f,)
    own : ndarray of int, shape (f, l)
    own_scale : ndarray, shape (f, l)
    shared : ndarray of int, shape (k,)
    shared_scale : ndarray, shape (k,)
    """

    forms: IntArray
    own: IntArray
    own_scale: Array
    shared: IntArray
    shared_scale: Array

    def only(self, kept: npt.NDArray[np.bool_]) -> Self:
        """Some of its forms."""
        return dataclasses.replace(self, forms=self.forms[kept], own=self.own[kept], own_scale=self.own_scale[kept])


@dataclasses.dataclass(frozen=True)
class Section:
    """Columns side by side, shape (n, C), and the forms that are made of them."""

    table: Array
    panels: tuple[Panel, ...]
    forms: IntArray

    def cross(self, given: Conditional, panels: Sequence[Panel]) -> Array:
        """L⁻¹ AᵀB of a set with the columns of some panels, shape (r, C); others are of no account."""
        used = np.zeros(self.table.shape[1], np.bool_)
        for panel in panels:
            used[panel.own] = True
            used[panel.shared] = True
        if used.mean() > _MOST:
            return given.cross(self.table)
        found = np.zeros((len(given.weights_half), len(used)))
        found[:, used] = given.cross(self.table[:, used])
        return found

    @classmethod
    def of(cls, bank: Bank, forms: Sequence[Form], numbers: Sequence[int]) -> Self:
        """The section of some forms of those numbers; each has a scale."""
        scaled = [bank.scaled(form) or () for form in forms]
        bases = dict.fromkeys(basis for one in scaled for basis, _ in one)
        edges = np.cumsum([0, *(bank.width(basis) for basis in bases)])
        place = {basis: np.arange(a, b) for basis, a, b in zip(bases, edges[:-1], edges[1:], strict=True)}

        def places(parts: Scaled) -> tuple[IntArray, Array]:
            index = np.concatenate([np.empty(0, np.intp), *(place[basis] for basis, _ in parts)])
            return index, np.concatenate([np.empty(0), *(np.full(len(place[basis]), scale) for basis, scale in parts)])

        widths = {basis: len(index) for basis, index in place.items()}
        panels = []
        for (shared, _), alike in _families(forms, scaled, widths).items():
            rows = [places(own) for _, own in alike]
            index, scale = (np.array(part) for part in zip(*rows, strict=True))
            panels.append(Panel(np.array([numbers[k] for k, _ in alike]), index, scale, *places(shared)))
        return cls(bank.side_by_side(list(bases)), tuple(panels), np.array(numbers))


def _families(
    forms: Sequence[Form], scaled: Sequence[Scaled], widths: Mapping[Basis, int]
) -> dict[tuple[Scaled, int], list[tuple[int, Scaled]]]:
    """Forms by what they share and the number of their own columns: number of each form, and its own bases."""

    def width(parts: Scaled) -> int:
        return sum([widths[basis] for basis, _ in parts])

    split = []
    for form, parts in zip(forms, scaled, strict=True):
        shared = tuple(part for part in parts if part[0] in form.smooth and part[0] not in form.lead)
        own = tuple(part for part in parts if part not in shared)
        split.append((shared, own) if width(own) <= _OWN and width(shared) >= _SHARED else ((), parts))
    found: dict[tuple[Scaled, int], list[tuple[int, Scaled]]] = defaultdict(list)
    for k, (shared, own) in enumerate(split):
        found[shared, width(own)].append((k, own))
    for key, alike in list(found.items()):
        if key[0] and len(alike) < _ALIKE:
            del found[key]
            for k, _ in alike:
                found[(), width(scaled[k])].append((k, scaled[k]))
    return found


class Layout:
    """Forms in sections, the same under all noises.

    Parameters
    ----------
    bank : Bank
    forms : sequence of Form
        Each with a scale.
    labels : sequence, optional
        A section each; without them there is one.
    """

    def __init__(self, bank: Bank, forms: Sequence[Form], labels: Sequence[Hashable] | None = None) -> None:
        self.forms = tuple(forms)
        self.sized = [(k, np.array(form.sizes)) for k, form in enumerate(forms) if form.sizes]  # priors of sizes of their own
        self.drawn: dict[Hashable, Array] = {}  # the statistic of draws of a noise
        self._of_gyro, self._beside_errors = (Recent[tuple[Noise, int], tuple[Products, ...]](_KEPT, _numbers) for _ in range(2))
        by_label: dict[Hashable, list[int]] = defaultdict(list)
        for k in range(len(forms)):
            by_label[labels[k] if labels else None].append(k)
        self.sections = tuple(Section.of(bank, [forms[k] for k in numbers], numbers) for numbers in by_label.values())

    def products(self, number: int, whitened: Whitened) -> tuple[Products, ...]:
        """Of each panel of a section under a noise; those that were last asked for are kept."""
        known = self._of_gyro if whitened.noise.errors is None else self._beside_errors
        return known.of((whitened.noise, number), lambda: _products(self.sections[number], whitened))

    def forget(self) -> None:
        """Forget products, which can be computed anew."""
        self._of_gyro.clear()
        self._beside_errors.clear()

    def keep(self, most: int) -> None:
        """Keep so many numbers of products under noises of a gyro alone."""
        self._of_gyro.most = most


@dataclasses.dataclass(frozen=True)
class Products:
    """Products of a panel's columns under a noise.

    Parameters
    ----------
    own : ndarray, shape (f, l, l)
        Of the own columns of each form.
    both : ndarray, shape (k, f, l)
        Of shared columns with own ones.
    shared : ndarray, shape (k, k)
        Of the shared columns.
    """

    own: Array
    both: Array
    shared: Array

    @property
    def size(self) -> int:
        """Numbers that it holds."""
        return self.own.size + self.both.size + self.shared.size

    @functools.cached_property
    def principal(self) -> tuple[Array, Array]:
        """Squares and directions of the own columns of each form, or of the shared ones where there are some."""
        values, turns = np.linalg.eigh(self.shared if len(self.shared) else self.own)
        return values, turns

    def only(self, kept: npt.NDArray[np.bool_]) -> Self:
        """Of some of the forms."""
        return dataclasses.replace(self, own=self.own[kept], both=self.both[:, kept])


class Screen:
    """The forms of a layout under one noise; Gram matrices of a section are made when one of its forms is first wanted.

    Parameters
    ----------
    evidence : Evidence
    layout : Layout
    """

    def __init__(self, evidence: Evidence, layout: Layout) -> None:
        self.evidence, self.layout = evidence, layout
        self._vectors: dict[int, Array] = {}

    def gains(self, given: Conditional, wanted: npt.NDArray[np.bool_] | None = None) -> Array:
        """Log evidence with each form and of each size, shape (forms, sizes); -inf for forms that are not wanted.

        Parameters
        ----------
        given : Conditional
            Under the same noise; it keeps what was asked of it.
        wanted : ndarray of bool, shape (forms,), optional
        """
        key = b"" if wanted is None else wanted.tobytes()
        if key in given.gains:
            return given.gains[key]
        found = np.full((len(self.layout.forms), len(priors.SIZES)), -np.inf)
        for k, section in enumerate(self.layout.sections):
            if wanted is None or wanted[section.forms].any():
                self._fill(found, given, k, wanted)
        for k, of_sizes in self.layout.sized:
            found[k] += of_sizes
        found.flags.writeable = False
        given.gains[key] = found
        return found

    def _fill(self, found: Array, given: Conditional, number: int, wanted: npt.NDArray[np.bool_] | None) -> None:
        section, chosen = self.layout.sections[number], []
        for panel, products in zip(section.panels, self.products(number), strict=True):
            kept = np.ones(len(panel.forms), np.bool_) if wanted is None else wanted[panel.forms]
            if kept.all():
                chosen.append((panel, products))
            elif kept.any():
                chosen.append((panel.only(kept), products.only(kept)))
        cross = section.cross(given, [panel for panel, _ in chosen])
        vector = self._vector(number) - cross.T @ given.weights_half
        for panel, products in chosen:
            found[panel.forms] = _panel_gains(given, panel, products, cross, vector)

    def products(self, number: int) -> tuple[Products, ...]:
        """Of each panel of the section of a number."""
        return self.layout.products(number, self.evidence.whitened)

    def _vector(self, number: int) -> Array:
        """Products of a section's columns with the data, shape (C,)."""
        if number not in self._vectors:
            self._vectors[number] = self.layout.sections[number].table.T @ self.evidence.adjoint_output
        return self._vectors[number]


def _numbers(panels: Sequence[Products]) -> int:
    return sum(one.size for one in panels)


def _products(section: Section, whitened: Whitened) -> tuple[Products, ...]:
    """Of the panels of a section."""
    white = np.ascontiguousarray(whitened.project(section.table).T)
    panels = []
    for panel in section.panels:
        own = white[panel.own] * panel.own_scale[..., None]  # (f, l, n)
        shared = white[panel.shared] * panel.shared_scale[:, None]
        both = (shared @ own.reshape(-1, white.shape[1]).T).reshape(len(shared), *panel.own.shape)
        panels.append(Products(np.matmul(own, np.swapaxes(own, 1, 2)), both, shared @ shared.T))
    return tuple(panels)


def _panel_gains(given: Conditional, panel: Panel, products: Products, cross: Array, vector: Array) -> Array:
    """Log evidence with each form of a panel and of each size, shape (forms, sizes).

    Parameters
    ----------
    given : Conditional
    panel : Panel
    products : Products
    cross : ndarray, shape (r, C)
        L⁻¹ AᵀB of the section's columns.
    vector : ndarray, shape (C,)
        Products of the section's columns with the data beside the set.
    """
    of_own, of_shared = np.swapaxes(cross[:, panel.own] * panel.own_scale, 0, 1), cross[:, panel.shared] * panel.shared_scale
    v_own, v_shared = vector[panel.own] * panel.own_scale, vector[panel.shared] * panel.shared_scale
    own = products.own - np.matmul(np.swapaxes(of_own, 1, 2), of_own)
    if not len(panel.shared):
        return given.of_sizes(own, v_own)
    both = products.both - np.tensordot(of_shared, of_own, (0, 1))
    values, turns = np.linalg.eigh(products.shared - of_shared.T @ of_shared)
    turned = (turns.T @ both.reshape(len(values), -1)).reshape(both.shape)
    return given.beside_shared(np.maximum(values, 0.0), turns.T @ v_shared, turned, own, v_own)
