r"""The evidence of sets of causes, in closed form, for many shapes and many noises at once.

.. math:: y = X \beta + \sum_m \Phi_m(\theta_m) a_m + \epsilon, \qquad \epsilon \sim N(0, \sigma^2 \Sigma_\eta)

The baseline's parameters :math:`\beta` have a flat prior and :math:`\sigma` the prior :math:`1/\sigma`. The columns of a cause are
scaled so that :math:`a_m` is its size: the standard deviation of what the baseline cannot absorb, over that of the white noise of
a window mean. Its prior is :math:`a_m \sim N(0, s^2 \sigma^2 / p_m)`, with the size s spread evenly in its logarithm over
`SIZES`. Then, with :math:`\nu` rows less baseline columns,

.. math::

    \log p(y \mid S, \theta, s, \eta) = -\tfrac12 \log |\Sigma_\eta| - \tfrac12 \log |X^T \Sigma_\eta^{-1} X|
        - \tfrac12 \log |I + \Lambda^{-1} G| - \tfrac{\nu}{2} \log Q

where G is the Gram matrix of the whitened columns with the baseline projected out, :math:`\Lambda = \mathrm{diag}(p_m / s_m^2)`,
and Q what is left of :math:`y^T y`. All that is needed is one Gram matrix a noise.

References
----------
D. J. C. MacKay, "Bayesian interpolation", Neural Computation 4, 415 (1992) (evidence of linear models).
F. Liang et al., "Mixtures of g priors for Bayesian variable selection", J. Am. Stat. Assoc. 103, 410 (2008)
(a prior over the size).
"""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Sequence
from typing import Final

import numpy as np
import numpy.typing as npt
from scipy.special import log_ndtr

from rlgcomp.diagnosis.naming.candidates import Candidate
from rlgcomp.diagnosis.noise.loops import log_extensions, log_sums
from rlgcomp.diagnosis.noise.whitening import NoiseShape, Whitener, norms
from rlgcomp.diagnosis.question.problem import Problem
from rlgcomp.numerics.compiled import available, in_threads, threads
from rlgcomp.physics.mechanism import Mechanism

Array = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.intp]
SIZES: Final = np.geomspace(0.06, 40.0, 8)
_WORTH_A_THREAD: Final = 2000  # candidates times noises
_ABSORBED: Final = 1e-5  # of a column's norm: less than this left by the baseline is nothing


@dataclasses.dataclass(frozen=True, order=True)
class Member:
    """A candidate in a model, with the size that its prior has there."""

    candidate: int
    size: int


@dataclasses.dataclass(frozen=True)
class Extension:
    """Log evidences, relative to nothing, of a model and of the model with any one candidate more.

    Parameters
    ----------
    point : ndarray, shape (noises,)
        The model itself.
    extended : ndarray, shape (noises, candidates)
        With a candidate more, its size averaged over; the candidate's own weight is not in it.
    best_size : ndarray, shape (candidates,)
        Index into `SIZES` where that is largest over all noises.
    at_best_size : ndarray, shape (noises, candidates)
        At that size alone, the weight of the size included.
    """

    point: Array
    extended: Array
    best_size: IntArray
    at_best_size: Array

    def and_more(self, other: Extension) -> Extension:
        """The same, and the candidates of another after these."""
        return Extension(
            self.point,
            np.concatenate([self.extended, other.extended], axis=1),
            np.concatenate([self.best_size, other.best_size]),
            np.concatenate([self.at_best_size, other.at_best_size], axis=1),
        )


class Evidence:
    """Gram matrices of the target and all candidates' columns, one a noise.

    Parameters
    ----------
    problem : Problem
    candidates : sequence of Candidate
    noises : sequence of NoiseShape
    """

    def __init__(self, problem: Problem, candidates: Sequence[Candidate], noises: Sequence[NoiseShape]) -> None:
        self.problem = problem
        self.noises = tuple(noises)
        self.candidates: list[Candidate] = []
        self.scale_deg_h = float(np.std(problem.target_deg_h)) or 1.0
        self.freedom = len(problem.rows) - problem.baseline.shape[1]
        self.leftovers: dict[Mechanism, Array] = {}  # what an equation may be wrong by, once it was asked
        self._slices: list[slice] = []
        self._signs: list[float] = []  # of each column: whether preparing it turned it round
        self._table = np.empty((len(problem.rows), 0))
        self._whitened_baseline: list[Array] = []
        self._constant = np.empty(len(self.noises))
        self._targets = np.empty((len(self.noises), len(problem.rows)))
        baseline = problem.baseline / norms(problem.baseline)
        self._orthogonal = np.linalg.qr(baseline)[0]
        self.whitener = Whitener(problem.rows, self.noises)
        log_determinant = self.whitener.log_determinant
        whitened = self.whitener(np.column_stack([self._orthogonal, problem.target_deg_h / self.scale_deg_h]))
        for k, table in enumerate(whitened):
            q, r = np.linalg.qr(table[:, :-1])
            self._whitened_baseline.append(q)
            self._constant[k] = -0.5 * log_determinant[k] - np.log(np.abs(np.diag(r))).sum()
            self._targets[k] = table[:, -1] - q @ (q.T @ table[:, -1])
        self._found: dict[tuple[Member, ...], Extension] = {}
        self.gram = np.einsum("en,en->e", self._targets, self._targets)[:, None, None]
        self.add(candidates)

    def add(self, candidates: Sequence[Candidate]) -> None:
        """More candidates, whose columns join the Gram matrices."""
        blocks: list[Array] = []
        for candidate in candidates:
            block = self._prepared(candidate.columns)
            if block.shape[1]:
                start = self._table.shape[1] + sum(b.shape[1] for b in blocks)
                self._slices.append(slice(start, start + block.shape[1]))
                self.candidates.append(candidate)
                blocks.append(block)
                self._signs.extend(np.sign(candidate.columns[:, : block.shape[1]].T @ block).diagonal())
        if not blocks:
            return
        fresh = np.column_stack(blocks)
        before, after = self._table.shape[1], self._table.shape[1] + fresh.shape[1]
        gram = np.empty((len(self.noises), after + 1, after + 1))
        old = np.r_[:before, after]

        def join(k: int) -> None:  # whitened anew: to keep every noise's columns would take gigabytes where runs are many
            columns = self.left(k, self.whitener.of(k, fresh))
            known = self.whitener.of(k, self._table)
            table = np.concatenate([known.T @ columns, columns.T @ columns, self._targets[k : k + 1] @ columns])
            gram[k, old[:, None], old] = self.gram[k]
            gram[k, :, before:after], gram[k, before:after] = table, table.T

        in_threads(join, [(k,) for k in range(len(self.noises))])
        self._table = np.column_stack([self._table, fresh])
        self.gram = gram
        widths = np.array([part.stop - part.start for part in self._slices])
        self._groups = [
            (width, np.flatnonzero(widths == width), np.array([self._slices[c].start for c in np.flatnonzero(widths == width)]))
            for width in sorted(set(widths.tolist()))
        ]
        self._set_blocks()

    def _set_blocks(self) -> None:
        """The candidates' own blocks of the Gram matrices, by width."""
        self._blocks = {}
        for width, _, starts in self._groups:
            places = starts[:, None] + np.arange(width)
            self._blocks[width] = self.gram[:, places[:, :, None], places[:, None, :]]
        starts = np.array([part.start for part in self._slices])
        widths = np.array([part.stop - part.start for part in self._slices])
        blocks = np.zeros((len(starts), len(self.noises), widths.max(), widths.max()))
        for width, which, _ in self._groups:
            blocks[which, :, :width, :width] = self._blocks[width].swapaxes(0, 1)
        self._own = blocks, starts, widths
        self._crosses = np.ascontiguousarray(self.gram[:, :-1, -1].T)

    def keep(self, noises: IntArray) -> None:
        """Go on with some of the noises: those that no likely model gives any weight are dropped."""
        self._found = {}
        self.noises = tuple(self.noises[k] for k in noises)
        self.whitener = self.whitener.keep(noises)
        self._whitened_baseline = [self._whitened_baseline[k] for k in noises]
        self._constant, self._targets = self._constant[noises], self._targets[noises]
        self.gram = self.gram[noises]
        self._set_blocks()

    def _prepared(self, columns: Array) -> Array:
        """An orthogonal basis of what the baseline leaves of the columns, with unit mean square; empty where it leaves nothing."""
        scaled = columns / norms(columns)
        left = scaled - self._orthogonal @ (self._orthogonal.T @ scaled)
        left -= self._orthogonal @ (self._orthogonal.T @ left)
        u, w, _ = np.linalg.svd(left, full_matrices=False)
        return np.asarray(u[:, w > _ABSORBED] * math.sqrt(len(columns)))

    def extensions(self, members: Sequence[Member]) -> Extension:
        """The evidence of a model and of every model with one candidate more; what was found before is kept."""
        known = self._found.get(tuple(members))
        first = 0 if known is None else len(known.best_size)
        if known is not None and first == len(self.candidates):
            return known
        inside = self._places(members)
        begin = self._slices[first].start if self.candidates else 0
        point, left = self._constant.copy(), self.gram[:, -1, -1]
        half = np.zeros((len(self.noises), 0, self.gram.shape[2] - begin))
        if len(inside):
            weights = np.concatenate([self._precision(member) for member in members])
            factor = np.linalg.cholesky(self.gram[:, inside[:, None], inside] + np.diag(weights))
            point -= np.log(np.diagonal(factor, axis1=1, axis2=2)).sum(axis=1) - 0.5 * np.log(weights).sum()
            half = np.linalg.solve(factor, self.gram[:, inside, begin:])
            left = left - (half[:, :, -1] ** 2).sum(axis=1)
        point -= 0.5 * self.freedom * np.log(left)
        if not self.candidates:
            none = np.empty((len(self.noises), 0))
            return Extension(point, none, np.empty(0, dtype=np.intp), none)
        extended, best, at_best = (self._extended if available() else self._extended_plainly)(half, left, point, first)
        found = Extension(point, extended + point[:, None], best, at_best + point[:, None])
        if known is not None:
            found = known.and_more(found)
        self._found[tuple(members)] = found
        return found

    def _extended(self, half: Array, left: Array, point: Array, first: int) -> tuple[Array, IntArray, Array]:
        """What each candidate from the first on adds, its size averaged over; its best size; what it adds at that."""
        blocks, starts, widths = (part[first:] for part in self._own)
        begin, count = starts[0], len(starts)
        extended, at_best = np.empty((2, len(self.noises), count))
        best = np.empty(count, dtype=np.intp)
        reached = np.ascontiguousarray(half[:, :, :-1].transpose(2, 0, 1))
        taken = np.ascontiguousarray(half[:, :, -1])
        given = blocks, self._crosses[begin:], reached, taken, left, point, starts - begin, widths, SIZES, self.freedom
        pieces = min(threads(), 1 + count * len(self.noises) // _WORTH_A_THREAD)
        edges = np.linspace(0, count, pieces + 1).astype(int)
        in_threads(log_extensions, [(*given, a, b, extended, best, at_best) for a, b in itertools.pairwise(edges)])
        return extended, best, at_best

    def _extended_plainly(self, half: Array, left: Array, point: Array, first: int) -> tuple[Array, IntArray, Array]:
        """The same without compiled loops."""
        begin = self._slices[first].start
        gains = np.empty((len(SIZES), len(self.noises), len(self.candidates)))
        cross = self.gram[:, begin:-1, -1] - (np.swapaxes(half[:, :, -1:], 1, 2) @ half)[:, 0, :-1]
        for width, which, starts in self._groups:
            fresh = which >= first
            places = starts[fresh, None] + np.arange(width)
            reached = half[:, :, places - begin]  # (noises, inside, candidates, width)
            values, vectors = np.linalg.eigh(self._blocks[width][:, fresh] - np.einsum("epcj,epck->ecjk", reached, reached))
            squares = np.einsum("ecji,ecj->eci", vectors, cross[:, places - begin]) ** 2
            gains[:, :, which[fresh]] = self._gains(values, squares, left[:, None])
        gains = gains[:, :, first:] - math.log(len(SIZES))
        best = np.argmax(log_sum_exp(gains + point[:, None], axis=1), axis=0)
        return log_sum_exp(gains, axis=0), best, gains[best, :, np.arange(len(best))].T

    def couples(self, noise: int) -> tuple[IntArray, Array, IntArray]:
        """Candidates of one column, and for every two of them, in one noise: the log evidence that both add, at the best size that
        both might have, and which that is."""
        _, starts, widths = self._own
        which = np.flatnonzero(widths == 1)
        places, gram = starts[which], self.gram[noise]
        between, cross, left = gram[np.ix_(places, places)], gram[places, -1], gram[-1, -1]
        best, sizes = np.full(between.shape, -np.inf), np.zeros(between.shape, dtype=np.intp)
        for k, size in enumerate(SIZES):
            prior = size**-2.0
            own = np.diagonal(between) + prior
            determinant = np.maximum(own[:, None] * own - between**2, prior**2)
            weighed = cross[:, None] ** 2 * own + cross**2 * own[:, None] - 2.0 * cross[:, None] * cross * between
            explained = np.minimum(weighed / determinant / left, 1.0 - 1e-12)
            gain = (
                math.log(prior) - 0.5 * np.log(determinant) - 0.5 * self.freedom * np.log1p(-explained) - 2.0 * math.log(len(SIZES))
            )
            better = gain > best
            best[better], sizes[better] = gain[better], k
        return which, best, sizes

    def _places(self, members: Sequence[Member]) -> IntArray:
        parts = [self._slices[member.candidate] for member in members]
        return np.array([place for part in parts for place in range(part.start, part.stop)], dtype=np.intp)

    def _precision(self, member: Member) -> Array:
        part = self._slices[member.candidate]
        width = part.stop - part.start
        return np.full(width, width / SIZES[member.size] ** 2)

    def averaged(self, noise: int, targets: Array, log_weights: Array) -> Array:
        """For other targets, as :meth:`left` gives them, the log of the evidence that any of the first candidates adds: averaged
        over sizes and summed with weights, one a candidate; shape (targets,)."""
        left = np.einsum("nt,nt->t", targets, targets)
        last = self._slices[len(log_weights) - 1].stop
        cross = self.whitener.of(noise, self._table[:, :last]).T @ targets
        found = np.full(len(left), -np.inf)
        for width, which, starts in self._groups:
            here = which < len(log_weights)
            values, vectors = np.linalg.eigh(self._blocks[width][noise][here])
            squares = (np.swapaxes(vectors, 1, 2) @ cross[starts[here][:, None] + np.arange(width)]) ** 2
            if available():
                log_sums(np.maximum(values, 0.0), squares, left, log_weights[which[here]], width / SIZES**2, self.freedom, found)
            elif here.any():
                gains = self._gains(values[:, None], np.swapaxes(squares, 1, 2), left) + log_weights[which[here]][:, None]
                found = np.logaddexp(found, log_sum_exp(log_sum_exp(gains, axis=0), axis=0))
        return found - math.log(len(SIZES))

    def _gains(self, values: Array, squares: Array, left: Array) -> Array:
        """Log evidence that columns add at each size: from the eigenvalues of their Gram matrix and the squares of their products
        with the target along its vectors, shapes (..., width), and what was left of the target's square; shape (sizes, ...)."""
        values = np.maximum(values, 0.0)
        precisions = squares.shape[-1] / SIZES**2
        explained = np.array([(squares / (values + prior)).sum(axis=-1) / left for prior in precisions])
        occam = np.array([0.5 * np.log1p(values / prior).sum(axis=-1) for prior in precisions])
        return np.asarray(-occam - 0.5 * self.freedom * np.log1p(-np.minimum(explained, 1.0 - 1e-12)))

    def _amplitudes(self, members: Sequence[Member], noise: int) -> tuple[IntArray, Array, Array]:
        """Places of the members' columns, their likeliest amplitudes, and the inverse of their precision."""
        inside = self._places(members)
        weights = np.concatenate([self._precision(member) for member in members])
        inverse = np.linalg.inv(self.gram[noise][np.ix_(inside, inside)] + np.diag(weights))
        return inside, inverse @ self.gram[noise][inside, -1], inverse

    def left(self, noise: int, whitened: Array) -> Array:
        """What the baseline leaves of targets whitened with one noise, shape (n, targets)."""
        q = self._whitened_baseline[noise]
        return np.asarray(whitened - q @ (q.T @ whitened))

    def constant(self, noise: int) -> float:
        """The part of the log evidence that does not depend on the target."""
        return float(self._constant[noise])

    @property
    def calmest(self) -> int:
        """The noise that has least of all that is slow."""
        return min(range(len(self.noises)), key=lambda k: self.noises[k].flicker + self.noises[k].walk + self.noises[k].wander)

    def unexplained(self, members: Sequence[Member]) -> tuple[Array, Array]:
        """The target in units of `scale_deg_h`, shape (n,), and an orthonormal basis of baseline and members, shape (n, p)."""
        design = np.column_stack([self._orthogonal, self._table[:, self._places(members)]])
        return self.problem.target_deg_h / self.scale_deg_h, np.linalg.qr(design)[0]

    def explained(self, members: Sequence[Member], noise: int) -> float:
        """Chi-square that members take from what the baseline leaves, for one noise."""
        whole = self._taken(members, noise)
        return float(self.freedom * whole / max(self.gram[noise][-1, -1] - whole, 1e-300))

    def explained_by_each(self, members: Sequence[Member], noise: int) -> list[float]:
        """The same of each member, alone or beside the others, whichever is more: causes may hide one another."""
        whole = self._taken(members, noise)
        unit = max(self.gram[noise][-1, -1] - whole, 1e-300) / self.freedom
        others = [[other for other in members if other != member] for member in members]
        alone = [self._taken([member], noise) for member in members]
        return [max(taken, whole - self._taken(rest, noise)) / unit for taken, rest in zip(alone, others, strict=True)]

    def _taken(self, members: Sequence[Member], noise: int) -> float:
        """Whitened square that members take from what the baseline leaves."""
        if not members:
            return 0.0
        inside, amplitudes, _ = self._amplitudes(members, noise)
        return float(self.gram[noise][inside, -1] @ amplitudes)

    def spans(self, members: Sequence[Member], column: Array) -> float:
        """Multiple correlation of a column with members' columns, all less what the baseline absorbs."""
        prepared = self._prepared(column.reshape(-1, 1))
        inside = self._places(members)
        if not prepared.shape[1] or not len(inside):
            return 0.0
        basis = np.linalg.qr(self._table[:, inside])[0]
        return float(np.linalg.norm(basis.T @ prepared[:, 0]) / np.linalg.norm(prepared[:, 0]))

    def resembles(self, column: Array) -> float:
        """Largest correlation of a column with a candidate of one column, both less what the baseline absorbs."""
        return self.nearest(column)[1]

    def nearest(self, column: Array) -> tuple[Candidate | None, float]:
        """The candidate of one column that correlates best with a column, both less what the baseline absorbs, and how much."""
        prepared = self._prepared(column.reshape(-1, 1))
        single = [k for k, part in enumerate(self._slices) if part.stop - part.start == 1]
        if not prepared.shape[1] or not single:
            return None, 0.0
        correlations = np.abs(prepared[:, 0] @ self._table[:, [self._slices[k].start for k in single]]) / len(prepared)
        best = int(np.argmax(correlations))
        return self.candidates[single[best]], float(correlations[best])

    def likeness(self, which: Sequence[int] | IntArray, columns: Array) -> float:
        """Largest squared correlation of candidates with any of other columns, all less what the baseline absorbs."""
        left = columns / norms(columns)
        left = left - self._orthogonal @ (self._orthogonal.T @ left)
        left = left / norms(left)
        shares = [((self._table[:, self._slices[k]].T @ left) ** 2).sum(axis=0) / len(left) for k in which]
        return min(1.0, float(np.max(shares)))

    def log_allowed(self, members: Sequence[Member], noise: int) -> float:
        """Log probability, over its prior, that amplitudes which cannot be negative are not."""
        bound = [k for k, member in enumerate(members) if self._positive(member)]
        if not bound:
            return 0.0
        inside, solution, inverse = self._amplitudes(members, noise)
        left = float(self.gram[noise][-1, -1] - self.gram[noise][inside, -1] @ solution)
        sd = np.sqrt(np.diag(inverse) * left / self.freedom)
        places = [self._places([members[k]])[0] for k in bound]
        signed = [self._signs[place] * solution[inside == place][0] / sd[inside == place][0] for place in places]
        return float(np.sum(log_ndtr(np.array(signed)) + math.log(2.0)))

    def _positive(self, member: Member) -> bool:
        """Whether it has one amplitude, which cannot be negative; what a stated number is wrong by can."""
        candidate = self.candidates[member.candidate]
        parameters = candidate.mechanism.amplitude_parameters()
        return not candidate.known and len(parameters) == 1 and parameters[0].low >= 0.0

    def beside(self, members: Sequence[Member], noise: int, columns: Array) -> Array:
        """Whitened columns less what baseline and members absorb of them, for one noise, shape (n, k)."""
        left = self.left(noise, self.whitener.of(noise, columns))
        inside = self._places(members)
        if not len(inside):
            return left
        basis = np.linalg.qr(self.left(noise, self.whitener.of(noise, self._table[:, inside])))[0]
        return np.asarray(left - basis @ (basis.T @ left))

    def residual(self, members: Sequence[Member], noise: int) -> Array:
        """Whitened target less baseline and members, for one noise, shape (n,)."""
        target = self._targets[noise]
        if not members:
            return target
        inside, amplitudes, _ = self._amplitudes(members, noise)
        return np.asarray(target - self.left(noise, self.whitener.of(noise, self._table[:, inside])) @ amplitudes)


def log_sum_exp(values: Array, axis: int = -1) -> Array:
    """Logarithm of a sum of exponentials; the search calls it thousands of times, and SciPy's checks would be most of its time."""
    largest = values.max(axis=axis, keepdims=True)
    largest = np.where(np.isfinite(largest), largest, 0.0)
    with np.errstate(divide="ignore"):
        return np.asarray(np.log(np.exp(values - largest).sum(axis=axis)) + np.squeeze(largest, axis=axis))
