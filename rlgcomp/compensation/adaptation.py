r"""Adapting a compensation of many units to another unit, from a short run: empirical Bayes.

A cubic or dynamic model is linear in its coefficients. Each unit u has its own, drawn from what units of this make are like,

.. math:: y_u = \Phi_u \beta_u + \epsilon, \qquad \beta_u \sim N(\mu, \Sigma), \qquad \epsilon \sim N(0, \sigma^2),

offset included. Expectation maximisation estimates mu, Sigma and sigma from the training runs of several units; the short run of a
new unit then gives the posterior mean of its coefficients,

.. math:: \hat\beta = \mu + (\Phi^T\Phi/\sigma^2 + \Sigma^{-1})^{-1}\, \Phi^T (y - \Phi \mu) / \sigma^2.

Where units are alike the prior decides, where they differ the run does; there is no parameter to tune. The interval is calibrated
on units: each known unit is adapted to in turn from the same number of windows, with the prior of the others, and scored on the
rest of its windows.

Reference
---------
N. M. Laird, J. H. Ware, Random-effects models for longitudinal data, Biometrics 38, 963 (1982).
"""

from __future__ import annotations

import dataclasses
import logging
from collections.abc import Sequence
from typing import Final, Self

import numpy as np
import numpy.typing as npt
import pandas as pd
from sklearn.base import clone

from rlgcomp.compensation.compensator import Compensator
from rlgcomp.compensation.correction import require_distinct, require_raw
from rlgcomp.compensation.interval import Interval
from rlgcomp.compensation.models.cubic import CubicLeastSquares
from rlgcomp.compensation.selection import Selection
from rlgcomp.compensation.untold_inputs import UntoldInputs
from rlgcomp.compensation.window_means import WindowMeans, window_means
from rlgcomp.errors import InputError
from rlgcomp.recording import Recording
from rlgcomp.recording.argument_checks import require_recordings
from rlgcomp.recording.outliers import without_outliers
from rlgcomp.report.messages import message

Array = npt.NDArray[np.float64]
logger = logging.getLogger(__name__)
FEWEST_UNITS: Final = 3
_ROUNDS: Final = 100
_FLOOR: Final = 1e-12  # of the variances, relative to the largest: coefficients that do not differ between units stay fixed


@dataclasses.dataclass(frozen=True)
class Population:
    """Distribution of the coefficients of units of one make.

    Parameters
    ----------
    mean : ndarray, shape (p,)
        mu; the first is the offset.
    covariance : ndarray, shape (p, p)
        Sigma, from unit to unit.
    noise : float
        sigma, of a window.
    """

    mean: Array
    covariance: Array
    noise: float

    @classmethod
    def of(cls, designs: Sequence[Array], targets: Sequence[Array]) -> Self:
        """By expectation maximisation, from the windows of each unit.

        Fewer units than coefficients do not determine all correlations. An inverse-Wishart prior regularises them: one pseudo-unit
        a coefficient, uncorrelated and with the variances of the real units.

        Parameters
        ----------
        designs : sequence of ndarray, shape (n_u, p)
        targets : sequence of ndarray, shape (n_u,)
        """
        p, count = designs[0].shape[1], sum(len(y) for y in targets)
        grams = np.array([phi.T @ phi for phi in designs])
        crosses = np.array([phi.T @ y for phi, y in zip(designs, targets, strict=True)])
        power = sum(float(y @ y) for y in targets)
        all_rows = np.vstack(designs)
        mean, variance = np.zeros(p), float(np.concatenate(targets).var())
        covariance = np.diag(variance / np.maximum((all_rows**2).mean(axis=0), 1e-12) / p)
        for _ in range(_ROUNDS):
            middles, spreads = _posterior(grams, crosses, mean, covariance, variance)
            mean = middles.mean(axis=0)
            about = middles - mean
            total = about.T @ about + spreads.sum(axis=0)
            own = np.diag(np.maximum(np.diag(total) / len(grams), _FLOOR * np.diag(total).max()))
            covariance = (total + p * own) / (len(grams) + p)
            explained = np.sum(middles * (2.0 * crosses - _times(grams, middles)))
            residual = power - explained + np.sum(grams * spreads)
            variance = max(float(residual) / count, np.finfo(np.float64).tiny)
        return cls(mean, covariance, float(np.sqrt(variance)))

    def adapted(self, design: Array, target: Array) -> Array:
        """Posterior mean of the coefficients of a unit with these windows, shape (p,)."""
        return _posterior(design.T @ design, design.T @ target, self.mean, self.covariance, self.noise**2)[0]


def adapt(compensator: Compensator, runs: Sequence[Recording]) -> Compensator:
    """A compensation for one more unit.

    Parameters
    ----------
    compensator : Compensator
        Cubic or dynamic, trained on runs of several units, which their metadata's `unit` names.
    runs : sequence of Recording
        Of the new unit; a part of a chamber programme may do.

    Returns
    -------
    Compensator
        With the features, scaling and averaging time of the old one; its range is that of all units and the new runs.

    Raises
    ------
    InputError
        The model is not linear in its coefficients, or fewer than three units are known, or a run is compensated or cannot be used.
    """
    model = getattr(compensator, "model_", None)
    if not isinstance(model, CubicLeastSquares):
        raise InputError(
            f"only cubic and dynamic models can be adapted, not {type(model).__name__}; train one with --model dynamic"
        )
    runs = require_recordings(runs, "runs")
    if not runs:
        raise InputError("no runs to adapt to; give at least one recording")
    for run in runs:
        require_raw(run.name, run.columns)
    require_distinct(runs)
    raw, (runs, outliers) = runs, without_outliers(runs, compensator.gyro)
    units = [str(run.get("unit") or "") for run in compensator.provenance_]
    known = sorted(set(units) - {""})
    if len(known) < FEWEST_UNITS:
        raise InputError(
            f"it was trained on {len(known)} units that are named ({', '.join(known) or 'none'}); at least {FEWEST_UNITS} are "
            "needed to know how units differ; train on runs of more units, whose metadata name the `unit`"
        )
    own = sorted({run.metadata.unit for run in runs if run.metadata.unit})
    if len(own) > 1:
        raise InputError(f"the runs are of {len(own)} units ({', '.join(own)}); adapt to each by itself")
    parts = {unit: [part for part, owner in zip(compensator.training_, units, strict=True) if owner == unit] for unit in known}
    basis = _Basis(compensator, model)
    windows = tuple(window_means(run, compensator.pipeline_, compensator.averaging_s, compensator.gyro) for run in runs)
    population = Population.of(*basis.stacked(list(parts.values())))
    (design,), (target,) = basis.stacked([windows])
    new = Compensator(
        clone(model),
        features=list(compensator.pipeline_.names),
        averaging_s=compensator.averaging_s,
        gyro=compensator.gyro,
        keep_mean=compensator.keep_mean,
    )
    samples = np.vstack([compensator.pipeline_.transform(run).to_numpy()[run.scored] for run in runs])
    new.specification_, new.pipeline_, new.training_ = compensator.specification_, compensator.pipeline_, windows
    new.scaling_ = dataclasses.replace(
        compensator.scaling_,
        low=np.minimum(compensator.scaling_.low, samples.min(axis=0)),
        high=np.maximum(compensator.scaling_.high, samples.max(axis=0)),
    )
    new.unused_, new.untold_ = {}, UntoldInputs()
    new.gyro_, new.schema_ = compensator.gyro_, compensator.schema_
    new.model_ = basis.model(population.adapted(design, target))
    scale_deg_h = compensator.scaling_.y_scale_deg_h
    errors, X, y, owner = _left_out(parts, basis, sum(len(part.y_deg_h) for part in windows))
    new.interval_ = Interval.calibrated(errors, X, y, owner, runs=len(known), noise_deg_h=population.noise * scale_deg_h)
    rmse = float(np.sqrt(np.mean(errors**2))) / compensator.scaling_.y_scale_deg_h
    new.selection_ = Selection({}, rmse, pd.DataFrame({"rmse": [rmse], "chosen": [True]}))
    hours = float(sum(run["hours"] for run in compensator.provenance_))
    new.provenance_ = [
        {
            "run": run.name,
            **run.metadata.to_mapping(),
            "rows": len(run),
            "hours": run.duration_s / 3600.0,
            "adapted_from": {"units": len(known), "hours": hours},
        }
        for run in raw
    ]
    new.remarks_ = (
        *outliers,
        *(message("compensation.adapted_to_known", unit=unit) for unit in own if unit in known),
        *new.selection_.remarks(compensator.scaling_.y_scale_deg_h, "units"),
    )
    for remark in new.remarks_:
        logger.warning("%s", remark)
    new.restart()
    return new


class _Basis:
    """The columns that a cubic's coefficients multiply, in its own mapping of the scaled inputs."""

    def __init__(self, compensator: Compensator, model: CubicLeastSquares) -> None:
        self.scaling, self.fitted = compensator.scaling_, model
        self.used = np.ones(model.coef_.shape, dtype=np.bool_)
        self.used[1:, [int(column) for column in model.linear]] = False

    def design(self, X: Array) -> Array:
        """Columns, the offset's first, for unscaled inputs."""
        mapped = (self.scaling.inputs(X) - self.fitted.centre_) / self.fitted.half_range_
        powers = np.stack([mapped**power for power in range(1, self.fitted.degree + 1)], axis=1)
        return np.column_stack([np.ones(len(X)), powers[:, self.used]])

    def target(self, y_deg_h: Array) -> Array:
        """The gyro, scaled."""
        return (y_deg_h - self.scaling.y_mean_deg_h) / self.scaling.y_scale_deg_h

    def stacked(self, units: Sequence[Sequence[WindowMeans]]) -> tuple[list[Array], list[Array]]:
        """Design and target of each unit's windows."""
        return (
            [np.vstack([self.design(part.X) for part in parts]) for parts in units],
            [np.concatenate([self.target(part.y_deg_h) for part in parts]) for parts in units],
        )

    def model(self, coefficients: Array) -> CubicLeastSquares:
        """The estimator with these coefficients."""
        model = clone(self.fitted)
        model.centre_, model.half_range_ = self.fitted.centre_.copy(), self.fitted.half_range_.copy()
        model.n_features_in_ = len(model.centre_)
        model.intercept_, model.coef_ = float(coefficients[0]), np.zeros(self.used.shape)
        model.coef_[self.used] = coefficients[1:]
        return model


def _left_out(
    parts: dict[str, list[WindowMeans]], basis: _Basis, windows: int
) -> tuple[Array, Array, Array, npt.NDArray[np.int64]]:
    """Errors of each unit's later windows, adapted to from its first ones with the prior of the other units."""
    errors, X, y, owner = [], [], [], []
    for k, unit in enumerate(parts):
        population = Population.of(*basis.stacked([others for other, others in parts.items() if other != unit]))
        (design,), (target,) = basis.stacked([parts[unit]])
        first = min(windows, len(target) // 2)
        coefficients = population.adapted(design[:first], target[:first])
        errors.append((target[first:] - design[first:] @ coefficients) * basis.scaling.y_scale_deg_h)
        X.append(np.vstack([part.X for part in parts[unit]])[first:])
        y.append(np.concatenate([part.y_deg_h for part in parts[unit]])[first:])
        owner.append(np.full(len(target) - first, k))
    return np.concatenate(errors), np.vstack(X), np.concatenate(y), np.concatenate(owner)


def _posterior(gram: Array, cross: Array, mean: Array, covariance: Array, variance: float) -> tuple[Array, Array]:
    """Posterior mean and covariance of a unit's coefficients, or of several units', by S (I + G S / v)^-1: no inverse of S."""
    half: Array = np.asarray(0.5 * np.linalg.solve(np.eye(len(mean)) + covariance @ gram / variance, covariance), dtype=np.float64)
    spread = half + np.swapaxes(half, -1, -2)
    return mean + _times(spread, cross - gram @ mean) / variance, spread


def _times(matrices: Array, vectors: Array) -> Array:
    """Each matrix times its vector."""
    return np.asarray((matrices @ vectors[..., None])[..., 0])
