"""Where the residual of each published row comes from, by mechanism, and which sizes of a unit would bring the published numbers.

A fitted cubic or LS-SVM is linear in its training output, f = S y, and the gyro is the sum of its mechanisms and its noise. The
residual of a run held out is therefore the sum of the residuals y_k - S y_k of the mechanisms, without approximation.

The recorded monitors do not depend on the sizes of the mechanisms. Another size is another weight of a known contribution; only
the beams, which move the readout itself, are simulated again.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Mapping
from typing import Any, Final

import numpy as np
import numpy.typing as npt
from scipy import optimize
from sklearn.base import clone

import rlgcomp as rlg
from experiments.optica_2015.study import INPUTS, PROGRAMME, PUBLISHED
from rlgcomp.compensation.feature_pipeline import pipeline_for
from rlgcomp.compensation.models import MODELS
from rlgcomp.compensation.selection import select
from rlgcomp.compensation.window_means import BLOCKS_OF_ONE_RUN, Scaling, WindowMeans, window_means
from rlgcomp.noise.processes import NOISES

Array = npt.NDArray[np.float64]
Rows = dict[str, float]
READOUT: Final = (INPUTS.index("readout_difference"),)
ROWS: Final = {
    "cubic, readout_difference": ("cubic", READOUT),
    "lssvm, readout_difference": ("lssvm", READOUT),
    "lssvm, paper's four": ("lssvm", tuple(range(len(INPUTS)))),
}
NOISE: Final = "noise"
BEAMS: Final = {
    "mutations of the beams": ("mutation_um",),
    "thermal shift of the beams": ("shift_um_K", "slip_um_K"),
    "wander of the beams": ("wander_um",),
}
FACTORS: Final = (0.25, 0.5, 2.0, 4.0)
MATCHED: Final = 0.1  # relative error of a row that counts as brought
_AVERAGING_S: Final = 100.0
_STEP_S: Final = 5.0
SEARCH_STEPS: Final = 120
_SPREAD_OF_STARTS: Final = 0.5  # of the logarithms of factors
_PRIOR: Final = 0.03  # of a squared logarithm of a factor, in squared logarithms of a row's error


@dataclasses.dataclass(frozen=True)
class Pair:
    """Window means of a unit's training run and of its test run.

    Parameters
    ----------
    names : tuple of str
        Mechanisms, and "noise" for all noises together.
    X : tuple of two ndarray, shape (n, inputs)
    contributions : tuple of two ndarray, shape (n, mechanisms)
        Of the gyro in deg/h.
    """

    names: tuple[str, ...]
    X: tuple[Array, Array]
    contributions: tuple[Array, Array]


@functools.lru_cache(maxsize=64)
def pair_of(seed: int, beams: str = "", factor: float = 1.0) -> Pair:
    """The runs of a unit.

    Parameters
    ----------
    seed : int
    beams : str
        One of `BEAMS` whose sizes are multiplied.
    factor : float
    """
    unit = rlg.simulated_unit(seed)
    changed = {name: factor * getattr(unit.monitors.beams, name) for name in BEAMS.get(beams, ())}
    monitors = dataclasses.replace(unit.monitors, beams=dataclasses.replace(unit.monitors.beams, **changed))
    unit = dataclasses.replace(unit, monitors=monitors)
    runs = [unit.simulate(PROGRAMME, seed=10 * seed + run, step_s=_STEP_S) for run in (1, 2)]
    pipeline = pipeline_for(runs, list(INPUTS))
    truths = [run.averaged(_AVERAGING_S).truth for run in runs]
    names = tuple(name for name in truths[0].columns if name not in NOISES)
    noises = [name for name in truths[0].columns if name in NOISES]
    X = [window_means(run, pipeline, _AVERAGING_S).X for run in runs]
    parts = [np.column_stack([truth[list(names)].to_numpy(), truth[noises].to_numpy().sum(axis=1)]) for truth in truths]
    return Pair((*names, NOISE), (X[0], X[1]), (parts[0], parts[1]))


def residuals(pair: Pair, row: str, weights: Array | None = None, *, interleaved: bool = False) -> Array:
    """Residual of each mechanism on the held-out windows, shape (n, mechanisms); their sum is the residual.

    Parameters
    ----------
    pair : Pair
    row : str
        Of `ROWS`.
    weights : ndarray, shape (mechanisms,), optional
        Factors of the mechanisms' sizes.
    interleaved : bool
        Train on every other window of the test run and hold out the windows between them, in selecting as well. Neighbours know
        each other: that is no test of another run, but a paper may report it.
    """
    fitted, parts = _fitted(pair, row, weights, interleaved=interleaved)
    left = [part - fitted.predicted(trained) for trained, part in zip(parts[0].T, parts[1].T, strict=True)]
    return np.column_stack(left)


@dataclasses.dataclass(frozen=True)
class _Fitted:
    """A model with its selected parameters, and scaled inputs of training and of the windows held out."""

    model: Any
    X: Array
    held_out: Array

    def predicted(self, y: Array) -> Array:
        """For the windows held out, trained on this output."""
        size = float(y.std())
        if size == 0.0:
            return np.full(len(self.held_out), y.mean())
        return np.asarray(size * clone(self.model).fit(self.X, y / size).predict(self.held_out))


def _fitted(
    pair: Pair, row: str, weights: Array | None, *, interleaved: bool = False, coarse: bool = False
) -> tuple[_Fitted, list[Array]]:
    """The selected model, and the contributions of training and of the windows held out."""
    name, places = ROWS[row]
    X = [values[:, list(places)] for values in pair.X]
    parts = [values * (1.0 if weights is None else weights) for values in pair.contributions]
    if interleaved:
        X, parts = [X[1][::2], X[1][1::2]], [parts[1][::2], parts[1][1::2]]
    y = parts[0].sum(axis=1)
    specification = MODELS[name]
    if coarse:
        every = specification.batches
        specification = dataclasses.replace(specification, batches=lambda features: [batch[::2] for batch in every(features)[::2]])
    scaling = Scaling.of([WindowMeans("train", np.arange(len(y)), X[0], y)], [X[0]], specification.reach)
    scaled, target = scaling.inputs(X[0]), (y - scaling.y_mean_deg_h) / scaling.y_scale_deg_h
    numbers = np.arange(len(y))
    groups = numbers % BLOCKS_OF_ONE_RUN if interleaved else numbers * BLOCKS_OF_ONE_RUN // len(y)
    model = specification.make()
    if "run_variance" in model.get_params():
        model.set_params(run_variance=0.0)
    model.set_params(**select(specification, model, scaled, target, groups).best)
    return _Fitted(model, scaled, scaling.inputs(X[1])), parts


def shares(left: Array) -> Array:
    """Share of each mechanism in the variance of the residual, shape (mechanisms,); they sum to one."""
    centred = left - left.mean(axis=0)
    total = centred.sum(axis=1)
    return np.asarray(centred.T @ total / (total @ total))


def rows_of(pair: Pair, weights: Array | None = None, *, interleaved: bool = False, coarse: bool = False) -> Rows:
    """Bias stability of the published rows.

    Parameters
    ----------
    pair : Pair
    weights : ndarray, shape (mechanisms,), optional
    interleaved : bool
    coarse : bool
        Search a quarter of the LS-SVM's grid.
    """
    found = {}
    for row in ROWS:
        fitted, parts = _fitted(pair, row, weights, interleaved=interleaved, coarse=coarse)
        held_out = parts[1].sum(axis=1)
        found.setdefault("raw", float(np.std(held_out, ddof=1)))
        found[row] = float(np.std(held_out - fitted.predicted(parts[0].sum(axis=1)), ddof=1))
    return found


def decomposed(seed: int) -> dict[str, Any]:
    """Rows of a unit under both ways of holding out, and the share of each mechanism in each row."""
    pair = pair_of(seed)
    shares_of = {row: dict(zip(pair.names, shares(residuals(pair, row)).tolist(), strict=True)) for row in ROWS}
    return {"rows": rows_of(pair), "interleaved": rows_of(pair, interleaved=True), "shares": shares_of}


def with_factor(seed: int, parameter: str, factor: float) -> Rows:
    """Rows of a unit with one of its sizes multiplied.

    Parameters
    ----------
    seed : int
    parameter : str
        A mechanism, "noise", or one of `BEAMS`.
    factor : float
    """
    if parameter in BEAMS:
        return rows_of(pair_of(seed, parameter, factor))
    pair = pair_of(seed)
    return rows_of(pair, np.array([factor if name == parameter else 1.0 for name in pair.names]))


def distance(found: Mapping[str, float]) -> float:
    """Root mean square of the logarithms of the rows over the published ones."""
    return float(np.sqrt(np.mean([np.log(found[row] / value) ** 2 for row, value in PUBLISHED.items()])))


def saturating(pair: Pair, sharpness: float) -> Pair:
    """The same unit where the bias follows the readout difference d as tanh(sharpness d / its rms), of the same rms.

    Parameters
    ----------
    pair : Pair
    sharpness : float
        Zero is the simulator's law, proportional to d.
    """
    column = pair.names.index("readout_incoherence")
    mean, spread = pair.contributions[0][:, column].mean(), pair.contributions[0][:, column].std()
    bent = [np.tanh(sharpness * (part[:, column] - mean) / spread) for part in pair.contributions]
    parts = [part.copy() for part in pair.contributions]
    for part, values in zip(parts, bent, strict=True):
        part[:, column] = mean + spread * values / bent[0].std()
    return dataclasses.replace(pair, contributions=(parts[0], parts[1]))


def nearest(seed: int, law: str, start: int = 0, steps: int = SEARCH_STEPS) -> dict[str, Any]:
    """Factors of a unit's mechanisms and noise that bring its rows nearest to the published ones, all at once.

    Parameters
    ----------
    seed : int
    law : {"proportional", "saturating"}
        Of the bias by the readout difference; the sharpness of the second is searched as well.
    start : int
        From the unit as drawn (0), whose factors then are rather near one; or from factors drawn at random by this seed.
    steps : int
        Trials.
    """
    pair = pair_of(seed)
    names = (*pair.names, *(("sharpness",) if law == "saturating" else ()))
    tried: list[tuple[float, Array]] = []

    def of(logs: Array) -> tuple[Pair, Array]:
        factors = np.exp(logs)
        return (saturating(pair, factors[-1]) if law == "saturating" else pair), factors[: len(pair.names)]

    def loss(logs: Array) -> float:
        found = rows_of(*of(logs), coarse=True)
        value = len(PUBLISHED) * distance(found) ** 2 + (0.0 if start else _PRIOR) * float(logs @ logs) / len(logs)
        tried.append((value, logs.copy()))
        return value

    first = np.random.default_rng(start).normal(0.0, _SPREAD_OF_STARTS, len(names)) if start else np.zeros(len(names))
    optimize.minimize(loss, first, method="Powell", options={"maxfev": steps, "xtol": 0.02, "ftol": 1e-3})
    _, best = min(tried, key=lambda one: one[0])
    return {"factors": dict(zip(names, np.exp(best).tolist(), strict=True)), "rows": rows_of(*of(best))}
