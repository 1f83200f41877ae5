"""Comparison tables: models with and without each feature group, trained on the windows of one compensation; correlations."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np
import numpy.typing as npt
import pandas as pd
from sklearn.base import clone

from rlgcomp.compensation.compensator import Compensator
from rlgcomp.compensation.models import MODELS
from rlgcomp.compensation.models.cubic import DYNAMICS
from rlgcomp.compensation.models.specification import ModelSpecification, grouping
from rlgcomp.compensation.selection import select
from rlgcomp.compensation.window_means import Scaling, WindowMeans

Array = npt.NDArray[np.float64]
ALWAYS: Final = ("cubic", "lssvm")
ALL_BUT: Final = "all without"


def correlation_table(held_out: Sequence[WindowMeans], names: Sequence[str]) -> pd.DataFrame:
    """Correlation coefficient of each input with the gyro, within runs, over all of them.

    Returns
    -------
    pandas.DataFrame
        Columns `input` and `correlation`.
    """
    X = np.vstack([part.X - part.X.mean(axis=0) for part in held_out])
    y = np.concatenate([part.y_deg_h - part.y_deg_h.mean() for part in held_out])
    spread = np.sqrt((X**2).sum(axis=0) * (y**2).sum())
    coefficient = np.divide(X.T @ y, spread, out=np.zeros(len(names)), where=spread > 0.0)
    return pd.DataFrame({"input": list(names), "correlation": coefficient})


def comparison_table(compensator: Compensator, held_out: Sequence[WindowMeans], *, n_jobs: int = 1) -> pd.DataFrame:
    """Held-out residuals of each model, on all feature groups and without each of them, trained on the same windows.

    An input is judged in the company of the others, by what is lost without it: alone, one that corrects a small part of the bias
    would look useless. The first group alone, temperature where it is recorded, is the first row.

    Parameters
    ----------
    compensator : Compensator
        Its training rows and scaling are used. The models are the cubic, the LS-SVM, and its own kind.
    held_out : sequence of WindowMeans
    n_jobs : int
        Worker processes of the selection.

    Returns
    -------
    pandas.DataFrame
        Columns `features`, `model`, `residual_std_deg_h`, `residual_rms_deg_h`, `reduction_percent`, `factor`; the last two compare
        standard deviations.
    """
    own = compensator.specification_
    specifications = [MODELS[name] for name in ALWAYS] + ([own] if own is not None and own.name not in ALWAYS else [])
    raw = _pooled([np.std(part.y_deg_h, ddof=1) for part in held_out])
    table = []
    for group, places in _inputs_by_group(compensator).items():
        for specification in specifications:
            model = _fitted(compensator, specification, places, n_jobs)
            scaling = dataclasses.replace(compensator.scaling_, reach=specification.reach)
            residuals = [part.y_deg_h - _predict(model, scaling, part, places) for part in held_out]
            deviation = _pooled([np.std(values, ddof=1) for values in residuals])
            table.append(
                {
                    "features": group,
                    "model": specification.name,
                    "residual_std_deg_h": deviation,
                    "residual_rms_deg_h": _pooled([np.sqrt(np.mean(values**2)) for values in residuals]),
                    "reduction_percent": 100.0 * (1.0 - deviation / raw),
                    "factor": raw / deviation,
                }
            )
    return pd.DataFrame(table)


def _fitted(compensator: Compensator, specification: ModelSpecification, places: list[int], n_jobs: int) -> Any:
    X, y, groups = compensator.training_rows()
    model = specification.make()
    if model.get_params().get("linear") == DYNAMICS:
        model.set_params(linear=tuple(k for k, place in enumerate(places) if place in compensator.pipeline_.dynamic))
    if len(compensator.training_) == 1 and model.get_params().get("run_variance", 0.0) is None:
        model.set_params(run_variance=0.0)  # blocks of one run have one bias
    if is_own_model(compensator, specification, model, places):
        return compensator.model_
    best = select(specification, model, X[:, places], y, groups, n_jobs=n_jobs).best
    model = clone(model).set_params(**best)
    return model.fit(X[:, places], y, **grouping(model, compensator.run_labels()))


def is_own_model(compensator: Compensator, specification: ModelSpecification, model: Any, places: list[int]) -> bool:
    """Whether the compensation's own model is the one that would be selected and fitted: same kind, options, inputs and rows."""
    every = list(range(len(compensator.pipeline_.names)))
    if specification is not compensator.specification_ or places != every or len(compensator.selection_.table) < 2:
        return False  # a model that was adapted to its unit has one candidate
    own = {  # a list in a saved model's file is a tuple here
        name: tuple(value) if isinstance(value, list) else value for name, value in compensator.model_.get_params().items()
    }
    return bool(own == model.get_params() | compensator.selection_.best)


def _predict(model: Any, scaling: Scaling, part: WindowMeans, places: list[int]) -> Array:
    return np.asarray(scaling.y_mean_deg_h + scaling.y_scale_deg_h * model.predict(scaling.inputs(part.X)[:, places]))


def _inputs_by_group(compensator: Compensator) -> Mapping[str, list[int]]:
    """Columns of the inputs of the first feature group, of all but one, and of all together."""
    owners = [feature.group for feature in compensator.pipeline_.features for _ in feature.names]
    places = [place for place in range(len(owners)) if place not in compensator.scaling_.linear]  # known physics is no input
    groups = list(dict.fromkeys(owners[place] for place in places))
    subsets = {groups[0]: [place for place in places if owners[place] == groups[0]]}
    if len(groups) == 1:
        return subsets
    for group in groups:
        others = [place for place in places if owners[place] != group]
        if others not in subsets.values():  # of two groups the first alone is all without the second
            subsets[f"{ALL_BUT} {group}"] = others
    return subsets | {"all": places}


def _pooled(deviations: Sequence[float | np.floating[Any]]) -> float:
    return float(np.sqrt(np.mean(np.square(np.array(deviations)))))
