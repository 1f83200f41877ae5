r"""The evidence of a set of forms, in closed form.

With data y and columns A = [s_1 B_1 … s_K B_K] whitened and projected off the baseline, and :math:`M = I + A^T A`,

.. math:: \log p = c_N - \tfrac12 \log|M| - \tfrac12 (n - p) \log\left(y^T y - y^T A M^{-1} A^T y\right)

since the variance of the noise is integrated with the prior 1 / σ². For a further form with Gram matrix G and b = Bᵀy, both reduced
by the set, one eigenproblem G = U Λ Uᵀ gives every size s: log|M| grows by Σ log(1 + s² λ), the square falls by
Σ s² (Uᵀb)² / (1 + s² λ).
"""

from __future__ import annotations

import dataclasses
import math
from collections import defaultdict
from collections.abc import Iterable, Sequence
from typing import Final

import numpy as np
import numpy.typing as npt

from rlgcomp.diagnosis.engine import priors
from rlgcomp.diagnosis.engine.bases import Basis
from rlgcomp.diagnosis.engine.data import Data
from rlgcomp.diagnosis.engine.noise import Noise, Whitened
from rlgcomp.diagnosis.engine.terms import Form

Array = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.intp]
_ABSORBED: Final = 1e-7  # share of a column's square below which the baseline has all of it
_KEPT: Final = 150  # projected bases of one noise
LOG_SIZE: Final = -math.log(len(priors.SIZES))


@dataclasses.dataclass(frozen=True)
class Member:
    """A form of a certain strength."""

    form: Form
    size: float


Set = tuple[Member, ...]


class Bank:
    """Window means of bases, each computed once, and the scales of forms.

    Parameters
    ----------
    data : Data
    design : ndarray, shape (n, p)
        The baseline.
    """

    def __init__(self, data: Data, design: Array) -> None:
        self.data, self.design = data, design
        self.white = Whitened(data, design, Noise())
        self._columns: dict[Basis, Array] = {}
        self._squares: dict[Basis, tuple[float, float]] = {}
        self._scaled: dict[Form, tuple[tuple[Basis, float], ...] | None] = {}

    def columns(self, basis: Basis) -> Array:
        """Window means of a basis, shape (n, k)."""
        if basis not in self._columns:
            self._columns[basis] = self.data.means(basis.columns)
        return self._columns[basis]

    def scaled(self, form: Form) -> tuple[tuple[Basis, float], ...] | None:
        """The bases of a form and their scales: what the baseline cannot absorb has a mean square of one; None where it has all."""
        if form not in self._scaled:
            self._scaled[form] = self._scale(form)
        return self._scaled[form]

    def prepare(self, forms: Iterable[Form]) -> None:
        """Compute the squares of all bases of some forms at once."""
        bases = dict.fromkeys(basis for form in forms for basis in (*form.lead, *form.departures) if basis not in self._squares)
        if not bases:
            return
        tables = [self.columns(basis) for basis in bases]
        projected = self.white.project(np.hstack(tables))
        squares = np.sum(projected**2, axis=0) / len(self.data)
        edges = np.r_[0, np.cumsum([table.shape[1] for table in tables])]
        for basis, table, a, b in zip(bases, tables, edges[:-1], edges[1:], strict=True):
            whole = float(np.sum(np.mean(table**2 / self.data.white[:, None], axis=0)))
            self._squares[basis] = float(squares[a:b].sum()), whole

    def _scale(self, form: Form) -> tuple[tuple[Basis, float], ...] | None:
        self.prepare([form])
        found = []
        for group, size in ((form.lead, 1.0), (form.departures, priors.DISCREPANCY)):
            shown = [basis for basis in group if self._squares[basis][0] > _ABSORBED * self._squares[basis][1]]
            if size == 1.0 and len(shown) < len(group):
                return None
            found += [(basis, size / math.sqrt(len(shown) * self._squares[basis][0])) for basis in shown]
        return tuple(found)


class Evidence:
    """Evidence under one hypothesis of the noise.

    Parameters
    ----------
    bank : Bank
    noise : Noise
    log_prior : float
        Of the noise.
    """

    def __init__(self, bank: Bank, noise: Noise, log_prior: float) -> None:
        self.bank, self.noise, self.log_prior = bank, noise, log_prior
        self.whitened = bank.white if noise == Noise() else Whitened(bank.data, bank.design, noise)
        self._projected: dict[Basis, Array] = {}

    @property
    def output(self) -> Array:
        return self.whitened.output

    def projected(self, basis: Basis) -> Array:
        """Columns of a basis, whitened and projected off the baseline."""
        if basis not in self._projected:
            if len(self._projected) >= _KEPT:
                self._projected.clear()
            self._projected[basis] = self.whitened.project(self.bank.columns(basis))
        return self._projected[basis]

    def block(self, member: Member) -> Array:
        """Columns of a member with weights of unit variance, shape (n, m)."""
        scaled = self.bank.scaled(member.form)
        assert scaled is not None  # noqa: S101  (only forms with a scale become members)
        return np.hstack([member.size * scale * self.projected(basis) for basis, scale in scaled])

    def table(self, members: Set) -> Array:
        """Columns of a set, shape (n, r)."""
        return np.hstack([np.empty((len(self.output), 0)), *(self.block(member) for member in members)])

    def log_evidence(self, members: Set) -> float:
        """Of a set under this noise; priors of the set and of the noise are not in it."""
        return self.given(members).log_evidence

    def given(self, members: Set) -> Conditional:
        """The evidence with a set in the model."""
        return Conditional(self, self.table(members))


class Conditional:
    """The evidence with a set in the model: M = L Lᵀ, and what the set leaves of data and columns."""

    def __init__(self, evidence: Evidence, table: Array) -> None:
        self.evidence, self.table = evidence, table
        output = evidence.output
        self.root = np.linalg.cholesky(np.eye(table.shape[1]) + table.T @ table)
        self._half = np.linalg.inv(self.root) if table.shape[1] else np.empty((0, 0))
        self.weights_half = self._half @ (table.T @ output)
        self.log_det = 2.0 * float(np.sum(np.log(np.diag(self.root))))
        self.square = max(evidence.whitened.square - float(self.weights_half @ self.weights_half), 1e-300)

    @property
    def log_evidence(self) -> float:
        return float(self.of(self.log_det, self.square))

    def of(self, log_det: Array | float, square: Array | float) -> Array | float:
        """Log evidence of a determinant and a square."""
        white = self.evidence.whitened
        return white.log_normaliser - 0.5 * log_det - 0.5 * white.freedom * np.log(square)

    @property
    def weights(self) -> Array:
        """Posterior mean of the weights, shape (r,)."""
        return np.asarray(self._half.T @ self.weights_half)

    def residual(self) -> Array:
        """Whitened data less the posterior mean of the set."""
        return np.asarray(self.evidence.output - self.table @ self.weights)

    def gain(self, form: Form) -> Array:
        """Log evidence with a further form of each size, shape (sizes,)."""
        block = self.evidence.block(Member(form, 1.0))
        cross = self._half @ (self.table.T @ block)
        gram = block.T @ block - cross.T @ cross
        vector = block.T @ self.evidence.output - cross.T @ self.weights_half
        return self._of_sizes(gram[None], vector[None])[0]

    def gains_of_columns(self, columns: Array) -> Array:
        """Log evidence with each of some columns, shape (k,); each has a weight of unit variance."""
        cross = self._half @ (self.table.T @ columns)
        values = 1.0 + np.sum(columns**2, axis=0) - np.sum(cross**2, axis=0)
        along = columns.T @ self.evidence.output - cross.T @ self.weights_half
        return np.asarray(self.of(self.log_det + np.log(values), np.maximum(self.square - along**2 / values, 1e-12 * self.square)))

    def gains(self, screen: Screen, wanted: npt.NDArray[np.bool_] | None = None) -> Array:
        """Log evidence with each form of a screen and of each size, shape (forms, sizes); -inf for forms that are not wanted."""
        found = np.full((len(screen.forms), len(priors.SIZES)), -np.inf)
        groups = screen.groups if wanted is None else [group.only(wanted) for group in screen.groups]
        cross = self._half @ (self.table.T @ screen.columns)
        reduced = screen.vector - cross.T @ self.weights_half
        for group in groups:
            if not len(group.forms):
                continue
            gram = group.gram
            if len(cross):
                part = np.moveaxis(cross[:, group.index] * group.scale, 0, 1)  # (forms, r, m)
                gram = gram - np.matmul(np.swapaxes(part, 1, 2), part)
            found[group.forms] = self._of_sizes(gram, reduced[group.index] * group.scale)
        return found

    def _of_sizes(self, gram: Array, vector: Array) -> Array:
        values, vectors = np.linalg.eigh(gram)
        values = np.maximum(values, 0.0)
        along = np.einsum("fij,fi->fj", vectors, vector) ** 2
        squared = priors.SIZES**2
        grown = 1.0 + squared[:, None] * values[:, None, :]  # (forms, sizes, m)
        fallen = np.sum(squared[:, None] * along[:, None, :] / grown, axis=2)
        square = np.maximum(self.square - fallen, 1e-12 * self.square)
        return np.asarray(self.of(self.log_det + np.sum(np.log(grown), axis=2), square))


@dataclasses.dataclass(frozen=True)
class _Group:
    """Forms of equally many columns: places among the screen's columns, scales, Gram matrices."""

    forms: IntArray
    index: IntArray
    scale: Array
    gram: Array

    def only(self, wanted: npt.NDArray[np.bool_]) -> _Group:
        """The forms that are wanted."""
        kept = wanted[self.forms]
        return _Group(self.forms[kept], self.index[kept], self.scale[kept], self.gram[kept])


class Screen:
    """All forms of a search under one hypothesis of the noise: columns whitened once, a Gram matrix a form.

    Parameters
    ----------
    evidence : Evidence
    forms : sequence of Form
        Each with a scale.
    """

    def __init__(self, evidence: Evidence, forms: Sequence[Form]) -> None:
        bank = evidence.bank
        self.evidence, self.forms = evidence, tuple(forms)
        bases = dict.fromkeys(basis for form in forms for basis, _ in bank.scaled(form) or ())
        tables = [bank.columns(basis) for basis in bases]
        self.columns = evidence.whitened.project(np.hstack(tables))
        edges = np.r_[0, np.cumsum([table.shape[1] for table in tables])]
        place = {basis: np.arange(a, b) for basis, a, b in zip(bases, edges[:-1], edges[1:], strict=True)}
        self.vector = self.columns.T @ evidence.output
        by_width: dict[int, list[tuple[int, IntArray, Array]]] = defaultdict(list)
        for k, form in enumerate(forms):
            scaled = bank.scaled(form) or ()
            index = np.concatenate([place[basis] for basis, _ in scaled])
            scale = np.concatenate([np.full(len(place[basis]), size) for basis, size in scaled])
            by_width[len(index)].append((k, index, scale))
        self.groups = [self._group(found) for found in by_width.values()]

    def _group(self, found: list[tuple[int, IntArray, Array]]) -> _Group:
        numbers, index, scale = (np.array(part) for part in zip(*found, strict=True))
        gram = np.empty((len(numbers), index.shape[1], index.shape[1]))
        for k in range(len(numbers)):
            block = self.columns[:, index[k]] * scale[k]
            gram[k] = block.T @ block
        return _Group(numbers, index, scale, gram)
