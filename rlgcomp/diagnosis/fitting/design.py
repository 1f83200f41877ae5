"""What is fitted as columns: baseline and causes, linearised where the shapes stand and moved by Gauss–Newton."""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Sequence
from typing import Final, Self

import numpy as np
import numpy.typing as npt

from rlgcomp.diagnosis.fitting.drawn_paths import DrawnPaths
from rlgcomp.diagnosis.fitting.linearised import late, moved, slopes, solve, wider
from rlgcomp.diagnosis.naming.candidates import Candidate
from rlgcomp.diagnosis.noise.whitening import NoiseShape, norms
from rlgcomp.diagnosis.question.free_part import law_slopes
from rlgcomp.diagnosis.question.problem import Problem
from rlgcomp.physics.empirical_law import EmpiricalLaw
from rlgcomp.physics.mechanism import Mechanism

Array = npt.NDArray[np.float64]
_OWN_STEPS: Final = 8  # of the simulator's own shapes, each time
_NO_BETTER: Final = 1e-5  # of the square that is left: a step that takes less is the last
_TOLD: Final = 1e-6  # of a derivative: with less beyond its own amplitudes a shape is not told
_MADE_UP_FOR: Final = 0.01  # of a derivative by a law's shape: with less beyond all else, what that is off by passes unseen


@dataclasses.dataclass(frozen=True)
class Design:
    """Baseline and causes as columns, linearised where the shapes stand.

    Parameters
    ----------
    problem : Problem
        With the simulator's own shapes where they lie beside the causes.
    chosen : sequence of Candidate
    mechanisms : sequence of Mechanism
        The causes at the shapes at which they are linearised.
    columns, amplitudes : sequence of ndarray
        Of each cause, shapes (n, k) and (k,).
    derived : list of list of (str, ndarray)
        Of each cause, its shapes' names and derivatives, shape (n,).
    square : float
        What is left with the shapes where they stand.
    """

    problem: Problem
    chosen: Sequence[Candidate]
    mechanisms: Sequence[Mechanism]
    columns: Sequence[Array]
    amplitudes: Sequence[Array]
    derived: list[list[tuple[str, Array]]]
    square: float

    @classmethod
    def of(
        cls,
        problem: Problem,
        chosen: Sequence[Candidate],
        mechanisms: Sequence[Mechanism],
        columns: Sequence[Array],
        noise: NoiseShape,
    ) -> Self:
        """At shapes; a law has no derivatives yet, since it is at its best."""
        problem = _beside_causes(problem, columns, noise)
        weights, _, square = solve(problem, np.column_stack([problem.baseline, *columns]), noise)
        amplitudes = np.split(weights, np.cumsum([problem.baseline.shape[1], *(block.shape[1] for block in columns)])[:-1])[1:]
        derived = [
            _told(slopes(problem, mechanism, part), mechanism, block) if steady_columns(one) and not mechanism.empirical else []
            for one, mechanism, part, block in zip(chosen, mechanisms, amplitudes, columns, strict=True)
        ]
        return cls(problem, chosen, mechanisms, columns, amplitudes, derived, square)

    @functools.cached_property
    def plain(self) -> Array:
        """All but derivatives, shape (n, p)."""
        return np.column_stack([self.problem.baseline, *self.columns])

    @functools.cached_property
    def with_slopes(self) -> Array:
        """All of it, derivatives last, shape (n, q)."""
        return np.column_stack([self.plain, *(column for found in self.derived for _, column in found)])

    def moved(self, noise: NoiseShape) -> Self | None:
        """The same a step of Gauss–Newton on, where that leaves less."""
        weights = solve(self.problem, self.with_slopes, noise)[0]
        shifted = moved(self.problem, self.mechanisms, self.derived, weights[self.plain.shape[1] :])
        if shifted == self.mechanisms:
            return None
        found = zip(self.chosen, shifted, self.columns, strict=True)
        columns = [self.problem.columns(mechanism) if steady_columns(one) else block for one, mechanism, block in found]
        if solve(self.problem, np.column_stack([self.problem.baseline, *columns]), noise)[2] >= self.square:
            return None
        return self.of(self.problem, self.chosen, shifted, columns, noise)

    def drawn_paths(self, k: int, noise: NoiseShape) -> DrawnPaths:
        """Of a cause that jumps, beside all else."""
        place = self.problem.baseline.shape[1] + sum(block.shape[1] for block in self.columns[:k])
        return DrawnPaths.of(self.problem, np.delete(self.with_slopes, place, axis=1), noise)

    def with_laws(self) -> Self:
        """The same with derivatives by the shapes of laws, which are uncertain all the same."""
        derived = [
            _of_law(self.problem, mechanism, float(part[0]), self.plain) if isinstance(mechanism, EmpiricalLaw) else found
            for mechanism, part, found in zip(self.mechanisms, self.amplitudes, self.derived, strict=True)
        ]
        return dataclasses.replace(self, derived=derived)

    def standard_deviations(
        self, weights: Array, final: Array, square: float, noise: NoiseShape, likely: Sequence[tuple[NoiseShape, float]]
    ) -> Array:
        """Of all columns and derivatives, about their weights: by the noises that are likely, widened where the likelihood along a
        shape is, and by what a late thermometer does. Numbers of laws are rounded to those of the weights that are told."""
        problem, own = self.problem, self.problem.baseline.shape[1]
        widened = [1.0] * self.plain.shape[1]
        for k, found in enumerate(self.derived):
            if found:
                names, directions = zip(*found, strict=True)
                others = [problem.baseline, *self.columns[:k], *self.columns[k + 1 :]]
                beside = np.column_stack([self.plain, *directions])
                widened += wider(problem, self.mechanisms[k], names, beside, others, noise, square)
        steady = [k for k, candidate in enumerate(self.chosen) if steady_columns(candidate)]
        lateness = late(problem, [self.mechanisms[k] for k in steady], [self.amplitudes[k] for k in steady])
        moved_by = solve(dataclasses.replace(problem, target_deg_h=lateness), self.with_slopes, noise)[0]
        sd = np.sqrt(np.square(widened) * _variances(problem, self.with_slopes, weights, likely or [(noise, 1.0)]) + moved_by**2)
        laws, widths = [mechanism.empirical for mechanism in self.mechanisms], [block.shape[1] for block in self.columns]
        of_laws = np.repeat([False, *laws, *laws], [own, *widths, *map(len, self.derived)])
        rounded = weights - np.r_[final, np.zeros(len(weights) - len(final))]
        return np.where(of_laws, np.hypot(sd, rounded), sd)


def _told(derived: list[tuple[str, Array]], mechanism: Mechanism, columns: Array) -> list[tuple[str, Array]]:
    """Derivatives by shapes that do what amplitudes cannot; mechanisms that settle tell of both."""
    if type(mechanism).canonical is not Mechanism.canonical:
        return derived
    basis = np.linalg.qr(columns)[0]
    return [
        (name, slope)
        for name, slope in derived
        if np.linalg.norm(slope - basis @ (basis.T @ slope)) > _TOLD * np.linalg.norm(slope)
    ]


def _of_law(problem: Problem, law: EmpiricalLaw, amplitude_deg_h: float, plain: Array) -> list[tuple[str, Array]]:
    """Derivatives by a law's shapes, which are at their best, and uncertain all the same; none that other columns make up for."""
    basis = np.linalg.qr(plain / norms(plain))[0]
    slopes = {name: amplitude_deg_h * slope for name, slope in law_slopes(problem, law).items()}
    left = {name: np.linalg.norm(slope - basis @ (basis.T @ slope)) for name, slope in slopes.items()}
    return [(name, slope) for name, slope in slopes.items() if left[name] > _MADE_UP_FOR * np.std(slope) * math.sqrt(len(slope))]


def _variances(problem: Problem, design: Array, weights: Array, likely: Sequence[tuple[NoiseShape, float]]) -> Array:
    """Of all that is fitted, about the weights: within each noise, and between noises."""
    freedom = len(problem.rows) - design.shape[1]
    total = np.zeros(len(weights))
    for noise, share in likely:
        found, covariance, square = solve(problem, design, noise)
        total += share * (np.maximum(np.diag(covariance), 0.0) * square / freedom + (found - weights) ** 2)
    return total / sum(share for _, share in likely)


def _beside_causes(problem: Problem, columns: Sequence[Array], noise: NoiseShape) -> Problem:
    """The problem linearised about where the simulator's own shapes lie beside the causes: they were calibrated without them.

    Gauss–Newton. A step counts where it explains more with the shapes held, not with their derivatives: beside an amplitude that is
    all but nothing, these reach far beyond what any shape does.
    """
    lowest = solve(problem, np.column_stack([problem.baseline[:, problem.held()], *columns]), noise)[2]
    for _ in range(_OWN_STEPS):
        weights = solve(problem, np.column_stack([problem.baseline, *columns]), noise)[0]
        shifted = problem.moved(weights[: problem.baseline.shape[1]])
        if shifted is problem:
            break
        square = solve(shifted, np.column_stack([shifted.baseline[:, shifted.held()], *columns]), noise)[2]
        if square >= lowest * (1.0 - _NO_BETTER):
            break
        problem, lowest = shifted, square
    return problem


def steady_columns(candidate: Candidate) -> bool:
    """Whether its columns follow from the monitors; a path of jumps does not."""
    return bool(candidate.mechanism.amplitude_parameters())
