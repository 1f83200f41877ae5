r"""The evidence of a set of forms, in closed form.

With data y and columns A = [s_1 B_1 … s_K B_K] whitened and projected off the baseline, and :math:`M = I + A^T A`,

.. math:: \log p = c_N - \tfrac12 \log|M| - \tfrac12 (n - p) \log\left(y^T y - y^T A M^{-1} A^T y\right)

since the variance of the noise is integrated with the prior 1 / σ². For a further form of size s with Gram matrix G and b = Bᵀy,
both reduced by the set, log|M| grows by log|I + s² G| and the square falls by s² bᵀ(I + s² G)⁻¹b: one Cholesky factor gives both.
Columns that many forms share are turned to their principal directions first, in which they are divided by 1 + s² λ.
"""

from __future__ import annotations

import dataclasses
import functools
import itertools
import math
from collections.abc import Collection, Iterable, Sequence
from typing import Final

import numpy as np
import numpy.typing as npt

from rlgcomp.diagnosis import priors
from rlgcomp.diagnosis.evidence.bank import Bank, Scaled
from rlgcomp.diagnosis.forms.bases import Basis
from rlgcomp.diagnosis.forms.terms import Form
from rlgcomp.diagnosis.noise.errors import Errors, errors_of
from rlgcomp.diagnosis.noise.model import Noise
from rlgcomp.diagnosis.regions.lateness import Late, Prediction
from rlgcomp.numerics.bordered_factors import completed

Array = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.intp]
_LEAST: Final = 1e-12  # of a square, that a set leaves
LOG_SIZE: Final = -math.log(len(priors.SIZES))


@dataclasses.dataclass(frozen=True)
class Member:
    """A form of a certain strength."""

    form: Form
    size: float

    @property
    def log_prior(self) -> float:
        """Of the form within its region, and of the size."""
        return self.form.log_share + LOG_SIZE + float(self.of_sizes[int(np.argmin(np.abs(priors.SIZES - self.size)))])

    @property
    def of_sizes(self) -> Array:
        """Log prior of each size of the form over that of the usual ones, shape (sizes,)."""
        return np.array(self.form.sizes or np.zeros(len(priors.SIZES)))


Set = tuple[Member, ...]


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
        self.whitened = bank.whitened(noise)
        self._values: dict[Set, float] = {}

    @property
    def output(self) -> Array:
        return self.whitened.output

    @functools.cached_property
    def adjoint_output(self) -> Array:
        """What has with columns of window means the products that the whitened data have with projected ones."""
        return self.whitened.adjoint(self.output[:, None])[:, 0]

    def projected(self, bases: Iterable[Basis]) -> list[Array]:
        """Columns of bases, whitened and projected off the baseline; those that were last asked for are kept."""
        listed, known = list(bases), self.bank.projected
        found = {basis: known.get((self.noise, basis)) for basis in listed}
        lacking = [basis for basis, one in found.items() if one is None]
        if lacking:
            tables = self.bank.reduced_together(lacking)
            white = self.whitened.project(np.hstack(tables))
            edges = np.cumsum([0, *(table.shape[1] for table in tables)])
            for basis, a, b in zip(lacking, edges[:-1], edges[1:], strict=True):
                found[basis] = known.put((self.noise, basis), white[:, a:b].copy())
        return [one for basis in listed if (one := found[basis]) is not None]

    def columns(self, parts: Scaled) -> Array:
        """Columns of bases side by side, each times its scale, shape (n, m)."""
        tables = self.projected(basis for basis, _ in parts)
        edges = list(itertools.accumulate((one.shape[1] for one in tables), initial=0))
        found = np.empty((len(self.output), edges[-1]))
        for (_, scale), one, a, b in zip(parts, tables, edges[:-1], edges[1:], strict=True):
            np.multiply(one, scale, out=found[:, a:b])
        return found

    def prediction(self, members: Set) -> tuple[Prediction, Conditional] | None:
        """The baseline and a set fitted under this noise, late terms left out, and the evidence; None without a baseline."""
        bank = self.bank
        if (baseline := bank.baseline) is None:
            return None
        given = self.given(members)
        left = self.whitened.adjoint(given.residual()[:, None])[:, 0]  # weights are products of their columns with it
        parts = [(basis, (member.size * scale) ** 2) for member in members for basis, scale in bank.scaled(member.form) or ()]
        weights = [square * (bank.columns(basis).T @ left) for basis, square in parts]
        terms = sum((bank.columns(basis) @ w for (basis, _), w in zip(parts, weights, strict=True)), np.zeros(len(bank.data)))
        design = self.whitened.whiten(bank.of_baseline)
        size = np.maximum(np.linalg.norm(design, axis=0), 1e-300)
        unmet = self.whitened.whiten((bank.data.output - terms)[:, None])[:, 0]
        numbers = np.linalg.lstsq(design / size, unmet, rcond=1e-9)[0] / size
        weighted = [(basis, w) for (basis, _), w in zip(parts, weights, strict=True)]
        on_time = tuple((basis, w) for basis, w in weighted if not isinstance(basis, Late))
        lags = {basis.column: float(w[0]) for basis, w in weighted if isinstance(basis, Late)}
        return Prediction(baseline, numbers, on_time, lags), given

    def errors(self, members: Set, among: Collection[int] | None = None) -> Errors | None:
        """Errors that drivers bring into the baseline and a set, fitted under this noise; None where they are next to nothing.

        Parameters
        ----------
        members : tuple of Member
        among : collection of int, optional
            Windows that may be outliers; all may be without it.
        """
        fitted = self.prediction(members)
        if fitted is None:
            return None
        prediction, given = fitted
        variance = given.square / self.whitened.freedom
        found = errors_of(self.bank.data, prediction.values, prediction.made_of, variance)
        known = () if self.noise.errors is None else self.noise.errors.outliers
        found = found.with_outliers(*self.whitened.given_others(given.residual() / math.sqrt(variance)), known, among)
        return found if found.count else None

    def block(self, member: Member) -> Array:
        """Columns of a member with weights of unit variance, shape (n, m)."""
        scaled = self.bank.scaled(member.form)
        assert scaled is not None  # noqa: S101  (only forms with a scale become members)
        return self.columns([(basis, member.size * scale) for basis, scale in scaled])

    def all_columns(self, members: Set) -> Array:
        """Columns of a set as its bases have them, shape (n, r)."""
        parts = [(m.size * scale, basis) for m in members for basis, scale in self.bank.scaled(m.form) or ()]
        tables = [factor * self.whitened.project(self.bank.columns(basis)) for factor, basis in parts]
        return np.hstack([np.empty((len(self.output), 0)), *tables])

    def table(self, members: Set) -> Array:
        """Columns of a set, shape (n, r)."""
        return self.columns([(basis, m.size * scale) for m in members for basis, scale in self.bank.scaled(m.form) or ()])

    def log_evidence(self, members: Set) -> float:
        """Of a set under this noise; priors of the set and of the noise are not in it, but that some weights are positive is."""
        if members not in self._values:
            self._values[members] = self._log_evidence(members)
        return self._values[members]

    def _log_evidence(self, members: Set) -> float:
        given = self.given(members)
        if not any(member.form.positive for member in members):
            return given.log_evidence
        widths = [sum(self.bank.width(basis) for basis, _ in self.bank.scaled(m.form) or ()) for m in members]
        last = np.cumsum(widths) - 1
        return given.log_evidence + given.log_positive([int(k) for k, m in zip(last, members, strict=True) if m.form.positive])

    def given(self, members: Set) -> Conditional:
        """The evidence with a set in the model."""
        return Conditional(self, self.table(members))


def columns_of(bank: Bank, members: Set) -> Array:
    """Window means of a set's columns as they are, shape (n, r), the weights of which are about as large as the white noise."""
    parts = [m.size * scale * bank.columns(basis) for m in members for basis, scale in bank.scaled(m.form) or ()]
    return np.hstack([np.empty((len(bank.data), 0)), *parts])


@dataclasses.dataclass(frozen=True, eq=False)
class Shared:
    """Bases that forms share, along their principal directions beside a set.

    Parameters
    ----------
    parts : frozenset of (Basis, float)
        With their scales.
    values : ndarray, shape (k,)
        Squares of the directions.
    along : ndarray, shape (k,)
        Their products with the data.
    columns : ndarray, shape (n, k)
        What has their products with whitened columns.
    """

    parts: frozenset[tuple[Basis, float]]
    values: Array
    along: Array
    columns: Array


class Conditional:
    """The evidence with a set in the model: M = L Lᵀ, and what the set leaves of data and columns."""

    def __init__(self, evidence: Evidence, table: Array) -> None:
        self.evidence, self.table = evidence, table
        self.shared: list[Shared] = []  # of forms that were asked for
        self.gains: dict[bytes, Array] = {}  # of forms of a layout that were wanted
        self.polished: dict[tuple[Member, bool, float], tuple[float, Member]] = {}  # down to a least step, all or the last
        self.proposed: dict[str, tuple[float, Member] | None] = {}  # the likeliest of what the residual proposes, by region
        self.root: Array = np.asarray(np.linalg.cholesky(np.eye(table.shape[1]) + table.T @ table), dtype=np.float64)
        self.weights_half = _solved(self.root, table.T @ evidence.output)
        self.log_det = 2.0 * float(np.sum(np.log(np.diag(self.root))))
        self.square = max(evidence.whitened.square - float(self.weights_half @ self.weights_half), 1e-300)

    @functools.cached_property
    def _half(self) -> Array:
        return _solved(self.root, np.eye(len(self.root)))

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

    def log_leading(self, members: Set) -> float:
        r"""Log prior of the strengths of leading parts of the set, given those of their forms (:data:`priors.LEADING`).

        The rms s of a form's leading weights in units of their prior, :math:`s^2 = E[w^\top w] / k`, is 1 where the form is what it
        is called. Where departures have nearly all of what is there, s is near zero: that is a law of another form, and its
        Gaussian prior alone would hardly charge for it. With :math:`\ln s \sim N(0, \sigma^2)` below 1,

        .. math:: \log p = -\frac{(\ln s)^2}{2 \sigma^2}.

        V. E. Johnson, D. Rossell, "On the use of non-local prior densities in Bayesian hypothesis tests", J. R. Stat. Soc. B 72,
        143-170 (2010).
        """
        total, first = 0.0, 0
        for member in members:
            places: list[int] = []
            for basis, _ in self.evidence.bank.scaled(member.form) or ():
                last = first + self.evidence.bank.width(basis)
                places += range(first, last) if basis in member.form.lead else ()
                first = last
            if member.form.departures and places:
                total -= 0.5 * (min(math.log(self._strength(places)), 0.0) / priors.LEADING) ** 2
        return total

    def _strength(self, places: Sequence[int]) -> float:
        """Root mean square of weights at some places, in units of their prior: mean over their posterior."""
        variance = self.square / self.evidence.whitened.freedom
        return math.sqrt(float(np.mean(self.weights[places] ** 2 / variance + np.sum(self._half[:, places] ** 2, axis=0))))

    def log_positive(self, places: Sequence[int]) -> float:
        """Log of how much likelier weights at some places are positive given the data than before: half of each was negative."""
        from scipy.special import log_ndtr

        sigma = math.sqrt(self.square / self.evidence.whitened.freedom)
        spread = np.maximum(sigma * np.linalg.norm(self._half[:, places], axis=0), 1e-300)
        return float(np.sum(log_ndtr(self.weights[places] / spread) + math.log(2.0)))

    @functools.cached_property
    def _adjoint(self) -> Array:
        return self.evidence.whitened.adjoint(self.table)

    def cross(self, columns: Array) -> Array:
        """L⁻¹ AᵀB with columns B of window means, shape (r, k)."""
        return np.asarray(self._half @ (self._adjoint.T @ columns))

    def reduced_by(self, columns: Array) -> Array:
        """L⁻¹ AᵀB with whitened columns B, shape (r, k)."""
        return np.asarray(self._half @ (self.table.T @ columns))

    def off(self, columns: Array) -> Array:
        """Whitened columns less what the set takes of them."""
        return np.asarray(columns - self.table @ (self._half.T @ self.reduced_by(columns)))

    def turned(self, parts: Scaled) -> Shared:
        """Bases along their principal directions beside the set."""
        columns = self.evidence.columns(parts)
        left = self.off(columns)
        values, turns = np.linalg.eigh(columns.T @ left)
        along = left @ turns
        return Shared(frozenset(parts), np.maximum(values, 0.0), along.T @ self.evidence.output, along)

    def residual(self) -> Array:
        """Whitened data less the posterior mean of the set."""
        return np.asarray(self.evidence.output - self.table @ self.weights)

    def gain(self, form: Form) -> Array:
        """Log evidence with a further form of each size, shape (sizes,)."""
        gram, vector = self.products(self.evidence.block(Member(form, 1.0)))
        return self.of_sizes(gram[None], vector[None])[0]

    def products(self, columns: Array) -> tuple[Array, Array]:
        """Of projected columns with one another and with the data, beside the set; shapes (m, m) and (m,)."""
        cross = self.reduced_by(columns)
        return columns.T @ columns - cross.T @ cross, columns.T @ self.evidence.output - cross.T @ self.weights_half

    def of_sizes(self, gram: Array, vector: Array) -> Array:
        """Log evidence with further forms of each size, shape (forms, sizes).

        Parameters
        ----------
        gram : ndarray, shape (forms, m, m)
            Beside the set.
        vector : ndarray, shape (forms, m)
            Products with the data beside the set.
        """
        none = np.zeros(0)
        return self.beside_shared(none, none, np.zeros((0, *vector.shape)), gram, vector)

    def beside_shared(self, values: Array, along: Array, both: Array, own: Array, v_own: Array) -> Array:
        """Log evidence with further forms that share columns, of each size, shape (forms, sizes); all products are beside the set.

        Parameters
        ----------
        values, along : ndarray, shape (k,)
            Squares of the shared columns along their principal directions, and products of these with the data.
        both : ndarray, shape (k, forms, l)
            Products of the directions with the own columns of each form.
        own : ndarray, shape (forms, l, l)
        v_own : ndarray, shape (forms, l)
            Products with the data.
        """
        squares = priors.SIZES**2
        count, width = v_own.shape
        stack = np.empty((len(squares), count, width + 1, width + 1))
        gram, vector = stack[..., :width, :width], stack[..., width, :width]
        square, log_det = np.full(len(squares), self.square), np.full(len(squares), self.log_det)
        if len(values):
            grown = 1.0 + squares[:, None] * values  # (sizes, k)
            share = squares[:, None] / grown
            products = (both[:, :, :, None] * both[:, :, None, :]).reshape(len(values), count * width**2)
            np.subtract(own, (share @ products).reshape(gram.shape), out=gram)
            np.subtract(v_own, ((share * along) @ both.reshape(len(values), count * width)).reshape(vector.shape), out=vector)
            square, log_det = square - share @ along**2, log_det + np.sum(np.log(grown), axis=1)
            gram *= squares[:, None, None, None]
            vector *= priors.SIZES[:, None, None]
        else:
            np.multiply(own, squares[:, None, None, None], out=gram)
            np.multiply(v_own, priors.SIZES[:, None, None], out=vector)
        stack[..., width, width] = np.maximum(square, _LEAST * self.square)[:, None]
        log_dets, left_over = completed(stack)
        return np.asarray(self.of(log_dets + log_det[:, None], np.maximum(left_over, _LEAST * self.square))).T

    def of_changes(self, log_det: Array, fallen: Array) -> Array:
        """Log evidence where a determinant has grown and the square has fallen by so much."""
        return np.asarray(self.of(self.log_det + log_det, np.maximum(self.square - fallen, _LEAST * self.square)))


def _solved(root: Array, right: Array) -> Array:
    """L⁻¹ of a right side: what `solve_triangular` calls, whose checks take ten times as long as this."""
    from scipy.linalg.lapack import dtrtrs

    return np.asarray(dtrtrs(root.T, right, lower=0, trans=1)[0]) if len(root) else right


def cholesky_roots(schur: Array) -> Array:
    """Cholesky factors of matrices that are at least one, of which rounding may have taken a little."""
    if schur.shape[-1] == 1:
        return np.asarray(np.sqrt(np.maximum(schur, 1.0)))
    try:
        return np.asarray(np.linalg.cholesky(schur))
    except np.linalg.LinAlgError:
        values, vectors = np.linalg.eigh(schur)
        safe = np.matmul(vectors * np.maximum(values, 1.0)[..., None, :], np.swapaxes(vectors, -1, -2))
        return np.asarray(np.linalg.cholesky(safe))
