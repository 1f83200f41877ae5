r"""Selection of inputs: which of the candidates the training runs can give a weight, and which further monitors they gain from.

*Told apart.* In a warm-up, rate, lag and memory of temperature are functions of temperature itself, so that training cannot say
which of them drives the bias; in another programme they go apart, and a shared weight is wrong there. An input of the history of
temperature gets no weight where cubics and piecewise linear functions of temperature, with an offset for each run, leave less than
30 % of the variance of each of its columns (one-way warm-ups: below 21 %; programmes of ramps and holds: above 50 %).

*Gain in company.* A further monitor is used where it lowers the error of runs left out in the company of the others: forward
selection with additive cubics under a ridge, whose sums over blocks of rows leave every run out of every subset in closed form.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Sequence
from typing import Final, Self

import numpy as np
import numpy.typing as npt

from rlgcomp.compensation.feature_pipeline import DYNAMIC, FeatureRecipe
from rlgcomp.compensation.untold_inputs import UntoldInputs
from rlgcomp.compensation.window_means import WindowMeans
from rlgcomp.report.messages import Message, message

Array = npt.NDArray[np.float64]
NOT_TOLD_APART: Final = 0.3  # of an input's variance: the part that is no function of temperature
LEAST_GAIN: Final = 0.05  # of the mean square error of runs left out
_DEVIATIONS: Final = 2.0  # of the gain from zero, by blocks
_PLACES: Final = np.arange(0.05, 1.0, 0.05)
_ROWS_OF_A_KINK: Final = 8  # rows of training for each place of kinks: fewer follow the noise of a short run
_BLOCKS: Final = 4  # of each run
_OVERLAP: Final = 0.5  # share of a run within the range of the others
_MOST_PAIRED: Final = 8  # further monitors that are tried two by two
_POWER_SCALES: Final = (1.0, 0.5, 0.25)  # prior standard deviations of the coefficients of the powers, as of a wide Gaussian kernel
_RIDGES: Final = 10.0 ** np.arange(-7.0, 0.0)  # of the number of rows
_TELLING_RUN: Final = {  # by itself: what differs between runs may as well be their turn-on biases
    "gradient": "holds its temperature, or changes the rate of its ramp on the way",
    "temperature_rate": "both warms and cools, or changes the rate of its ramp on the way",
    "lag": "holds its temperature after a ramp",
    "memory": "turns from warming to cooling or back",
}


@dataclasses.dataclass(frozen=True)
class InputSelection:
    """Result of the selection.

    Parameters
    ----------
    used : tuple of int
        Numbers of the features that are used.
    not_told_apart : tuple of int
        Features of the history of temperature that training cannot tell apart from those used.
    gains : dict of str to float
        Relative gain in mean square error over runs left out of each further monitor, used or not: geometric mean over blocks. Zero
        where the runs do not overlap in it.
    """

    used: tuple[int, ...]
    not_told_apart: tuple[int, ...]
    gains: dict[str, float]


@dataclasses.dataclass(frozen=True)
class ChosenInputs:
    """The inputs that training can give a weight.

    Parameters
    ----------
    pipeline : FeatureRecipe
    training : tuple of WindowMeans
    samples : list of ndarray, shape (samples, features)
        Features of every sample of each run.
    unused : dict of str to float
        Relative gain in mean square error over runs left out of each further monitor that is not used.
    untold : UntoldInputs
        Those that training cannot tell apart.
    remarks : list of Message
        On them.
    """

    pipeline: FeatureRecipe
    training: tuple[WindowMeans, ...]
    samples: list[Array]
    unused: dict[str, float]
    untold: UntoldInputs
    remarks: list[Message]

    @classmethod
    def of(cls, pipeline: FeatureRecipe, training: Sequence[WindowMeans], samples: Sequence[Array], further: Sequence[str]) -> Self:
        """Choose among the features of a pipeline.

        Parameters
        ----------
        pipeline : FeatureRecipe
            All candidates.
        training : sequence of WindowMeans
        samples : sequence of ndarray, shape (samples, features)
            Features of every sample of each run.
        further : sequence of str
            Columns of the further monitors among the candidates.
        """
        selection = select_inputs(pipeline, training, further)
        owner = np.repeat(np.arange(len(pipeline.features)), [len(feature.names) for feature in pipeline.features])
        used = np.isin(owner, selection.used)
        chosen = FeatureRecipe(tuple(pipeline.features[k] for k in selection.used))
        return cls(
            chosen,
            tuple(dataclasses.replace(part, X=np.ascontiguousarray(part.X[:, used])) for part in training),
            [values[:, used] for values in samples],
            {column: gain for column, gain in selection.gains.items() if column not in chosen.columns},
            UntoldInputs.of(pipeline, selection.not_told_apart, samples),
            remarks_on(pipeline, selection),
        )


def select_inputs(pipeline: FeatureRecipe, training: Sequence[WindowMeans], further: Sequence[str]) -> InputSelection:
    """Select among the features of a pipeline.

    Parameters
    ----------
    pipeline : FeatureRecipe
        All candidates.
    training : sequence of WindowMeans
    further : sequence of str
        Columns of the further monitors among them.
    """
    owner = np.repeat(np.arange(len(pipeline.features)), [len(feature.names) for feature in pipeline.features])
    runs = np.repeat(np.arange(len(training)), [len(part.y_deg_h) for part in training])
    X = np.vstack([part.X for part in training])
    groups = [feature.group for feature in pipeline.features]
    extra = [k for k, feature in enumerate(pipeline.features) if feature.kind == "level" and feature.columns[0] in further]
    standard = [k for k in range(len(groups)) if k not in extra]
    used = [k for k in standard if groups[k] not in DYNAMIC]
    apart: list[int] = []
    company = np.isin(owner, [k for k in used if groups[k] == "temperature"])
    for k in (k for k in standard if groups[k] in DYNAMIC):
        columns = owner == k
        if company.any() and _unexplained(X[:, columns], X[:, company], runs).max() < NOT_TOLD_APART:
            apart.append(k)
        else:
            used.append(k)
    gains_by_name: dict[str, float] = {}
    if extra:
        y = np.concatenate([part.y_deg_h for part in training])
        judged = [k for k in extra if _overlap(X[:, np.argmax(owner == k)], runs)]
        gains = dict.fromkeys(extra, 0.0)
        added, judged_gains = _forward(X, y, runs, owner, sorted(used), judged)
        gains |= judged_gains
        used += added
        gains_by_name = {pipeline.features[k].columns[0]: gain for k, gain in gains.items()}
    return InputSelection(tuple(sorted(used)), tuple(apart), gains_by_name)


def remarks_on(pipeline: FeatureRecipe, selection: InputSelection) -> list[Message]:
    """A remark on each feature that training cannot tell apart from the others, with the run that would, and what follows."""
    groups = [pipeline.features[k].group for k in selection.not_told_apart]
    company = ", ".join(dict.fromkeys(pipeline.features[k].group for k in selection.used))
    remarks = [
        message("compensation.not_told_apart", group=group, company=company, telling_run=_TELLING_RUN[group]) for group in groups
    ]
    return [*remarks, message("compensation.like_runs_alone", groups=groups)] if groups else []


def _overlap(values: Array, runs: npt.NDArray[np.int64]) -> bool:
    """Whether most of every run lies within the range of the other runs: elsewhere a run left out shows no gain."""
    if runs.max() == 0:
        return True
    for run in range(runs.max() + 1):
        own, others = values[runs == run], values[runs != run]
        if np.mean((own >= others.min()) & (own <= others.max())) < _OVERLAP:
            return False
    return True


def _unexplained(columns: Array, company: Array, runs: npt.NDArray[np.int64]) -> Array:
    """Share of each column's variance within runs that functions of the company leave, shape (columns,)."""
    Z = np.eye(runs.max() + 1)[runs]

    def within_runs(values: Array) -> Array:
        return np.asarray(values - Z @ (Z.T @ values / Z.sum(axis=0)[:, None]))

    kinks = min(len(_PLACES), len(runs) // (_ROWS_OF_A_KINK * company.shape[1]))
    design = within_runs(np.hstack([_powers(company), *(_hats(column, kinks) for column in company.T)]))
    target = within_runs(columns)
    numbers, _, rank, _ = np.linalg.lstsq(design, target, rcond=1e-10)
    residual = target - design @ numbers
    variance = (target**2).sum(axis=0)
    share = np.divide((residual**2).sum(axis=0), variance, out=np.zeros(len(variance)), where=variance > 0.0)
    free = len(runs) - Z.shape[1]  # of which the design takes its rank, whatever it says
    return np.asarray(share * free / max(1, free - rank))


def _hats(values: Array, count: int) -> Array:
    """Piecewise linear functions of one input, with so many kinks at quantiles and as many at equal steps, shape (n, kinks)."""
    places = _PLACES if count == len(_PLACES) else np.arange(1.0, count + 1.0) / (count + 1.0)
    knots = np.unique([*np.quantile(values, places), *(values.min() + places * np.ptp(values))])
    return np.maximum(values[:, None] - knots, 0.0) / (float(np.ptp(values)) or 1.0)


def _powers(X: Array) -> Array:
    spread = X.std(axis=0)
    scaled = (X - X.mean(axis=0)) / np.where(spread > 0.0, spread, 1.0)
    return np.hstack([scale * scaled ** (k + 1) for k, scale in enumerate(_POWER_SCALES)])


def _forward(
    X: Array, y: Array, runs: npt.NDArray[np.int64], owner: npt.NDArray[np.int64], start: list[int], extra: list[int]
) -> tuple[list[int], dict[int, float]]:
    """Further features that lower the error, in the order of their gain, and the last gain of each, used or not."""
    errors = _LeftOut(X, y, runs)
    added: list[int] = []
    gains: dict[int, float] = {}
    present = errors.of(np.isin(owner, start))
    while remaining := [k for k in extra if k not in added]:
        tried: dict[tuple[int, ...], Array] = {(k,): errors.of(np.isin(owner, [*start, *added, k])) for k in remaining}
        gains |= {k[0]: _gain(present, error) for k, error in tried.items()}
        best = max(tried, key=lambda k: _gain(present, tried[k]))
        if not _certain(present, tried[best]) and len(remaining) <= _MOST_PAIRED:  # two may gain what neither does alone
            tried = {pair: errors.of(np.isin(owner, [*start, *added, *pair])) for pair in itertools.combinations(remaining, 2)}
            best = max(tried, key=lambda k: _gain(present, tried[k]), default=best)
        if best not in tried or not _certain(present, tried[best]):
            break
        added += best
        present = tried[best]
    return added, gains


def _gain(before: Array, after: Array) -> float:
    """Relative gain in squared error, geometric mean over blocks."""
    return float(1.0 - np.exp(-np.log(before / after).mean()))


def _certain(before: Array, after: Array) -> bool:
    """Whether the gain is large enough, and more than its scatter from block to block explains."""
    ratios = np.log(before / after)
    enough = _gain(before, after) > LEAST_GAIN
    return bool(enough and ratios.mean() > _DEVIATIONS * ratios.std(ddof=1) / np.sqrt(len(ratios)))


class _LeftOut:
    """Squared errors of additive cubics with each run left out, about the mean error of the run, block by block."""

    def __init__(self, X: Array, y: Array, runs: npt.NDArray[np.int64]) -> None:
        counts = np.bincount(runs)
        parts = _BLOCKS if len(counts) > 1 else 2 * _BLOCKS
        blocks = np.concatenate([np.arange(count) * parts // count for count in counts]) + parts * runs
        folds = np.arange(len(counts) * parts) // parts if len(counts) > 1 else np.arange(parts)
        used, numbers = np.unique(blocks, return_inverse=True)
        self.fold = folds[used]
        columns = np.column_stack([_powers(X), np.ones(len(y)), (y - y.mean()) / (y.std() or 1.0)])
        self.sums = np.stack([columns[numbers == k].T @ columns[numbers == k] for k in range(len(used))])
        # runs have biases of their own: the sums about the mean of each run
        run_of_block = runs[np.unique(numbers, return_index=True)[1]]
        total = np.stack([self.sums[run_of_block == run].sum(axis=0) for run in range(len(counts))])
        self.within = {
            fold: sum(
                (_centred(total[run]) for run in range(len(counts)) if run != fold or len(counts) == 1),
                np.zeros(columns.shape[1] * np.ones(2, dtype=int)),
            )
            - (_centred(self.sums[self.fold == fold].sum(axis=0)) if len(counts) == 1 else 0.0)
            for fold in np.unique(self.fold)
        }

    def of(self, used: npt.NDArray[np.bool_]) -> Array:
        """Of the ridge that is best, shape (blocks,)."""
        powers = np.flatnonzero(np.tile(used, len(_POWER_SCALES)))
        last = self.sums.shape[1] - 1
        everything = np.r_[powers, last - 1, last]
        errors = np.zeros((len(_RIDGES), len(self.sums)))
        for fold, within in self.within.items():
            values, vectors = np.linalg.eigh(within[np.ix_(powers, powers)])
            rows = self.sums[self.fold != fold, last - 1, last - 1].sum()
            turned = vectors.T @ within[powers, last]
            weights = vectors @ (turned / (np.maximum(values, 0.0) + rows * _RIDGES[:, None])).T
            out = np.flatnonzero(self.fold == fold)
            together = self.sums[out].sum(axis=0)[np.ix_(everything, everything)]
            design = np.vstack([weights, np.zeros(len(_RIDGES)), -np.ones(len(_RIDGES))])
            design[-2] = -(together[-2] @ design) / together[-2, -2]  # the run's mean error is taken out
            for block in out:
                part = self.sums[block][np.ix_(everything, everything)]
                errors[:, block] = np.einsum("im,im->m", design, part @ design)
        errors = np.maximum(errors, np.finfo(np.float64).tiny)
        return np.asarray(errors[np.argmin(np.log(errors).sum(axis=1))])


def _centred(sums: Array) -> Array:
    """Sums of products about the means; the last but one row has the sums, and their number."""
    of_ones = sums[-2]
    return np.asarray(sums - np.outer(of_ones, of_ones) / of_ones[-2])
