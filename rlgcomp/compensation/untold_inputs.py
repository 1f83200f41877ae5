"""Inputs without a weight, for training could not tell them apart from others, and the range that training showed of them.

A run that only warms says what rate, lag and memory of temperature do together with temperature, and not what each does where they
go apart. The interval, which such runs calibrate, does not hold there either: a run beyond the range is remarked on.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any, Final, Self

import numpy as np
import numpy.typing as npt

from rlgcomp.compensation.feature_pipeline import FeatureRecipe
from rlgcomp.compensation.window_means import MARGIN
from rlgcomp.errors import InputError
from rlgcomp.recording import Recording
from rlgcomp.report.messages import Message, message

Array = npt.NDArray[np.float64]
OFTEN_BEYOND: Final = 0.05  # of the samples: a single reading of a rate is noisy


@dataclasses.dataclass(frozen=True)
class UntoldInputs:
    """Inputs without a weight and their ranges in training.

    Parameters
    ----------
    recipe : FeatureRecipe, optional
        None where training told all apart.
    low, high : tuple of float
        Range of each of its names, with the usual margin.
    """

    recipe: FeatureRecipe | None = None
    low: tuple[float, ...] = ()
    high: tuple[float, ...] = ()

    @classmethod
    def of(cls, candidates: FeatureRecipe, numbers: Sequence[int], samples: Sequence[Array]) -> Self:
        """Of these features among the candidates.

        Parameters
        ----------
        candidates : FeatureRecipe
        numbers : sequence of int
        samples : sequence of ndarray, shape (samples, names of the candidates)
            Features of every sample of each training run.
        """
        if not numbers:
            return cls()
        owner = np.repeat(np.arange(len(candidates.features)), [len(feature.names) for feature in candidates.features])
        values = np.vstack(samples)[:, np.isin(owner, numbers)]
        low, high = values.min(axis=0), values.max(axis=0)
        margin = MARGIN * (high - low)
        recipe = FeatureRecipe(tuple(candidates.features[k] for k in sorted(numbers)))
        return cls(recipe, tuple((low - margin).tolist()), tuple((high + margin).tolist()))

    def remarks(self, run: Recording) -> list[Message]:
        """A remark where one of them often lies beyond its range in a run; a run may lack the monitors of some."""
        there = [] if self.recipe is None else [one for one in self.recipe.features if set(one.columns) <= set(run.columns)]
        if self.recipe is None or not there:
            return []
        own = np.isin(self.recipe.names, [name for feature in there for name in feature.names])
        values = FeatureRecipe(tuple(there)).transform(run).to_numpy()[run.scored]
        beyond = ((values < np.array(self.low)[own]) | (values > np.array(self.high)[own])).mean(axis=0)
        if beyond.max() <= OFTEN_BEYOND:
            return []
        groups = [feature.group for feature in there for _ in feature.names]
        names = dict.fromkeys(group for group, share in zip(groups, beyond, strict=True) if share > OFTEN_BEYOND)
        return [message("evaluation.untold", run=run.name, percent=100.0 * float(beyond.max()), inputs=list(names))]

    def to_mapping(self) -> dict[str, Any]:
        """Plain data, for the artefact."""
        return {"features": [] if self.recipe is None else self.recipe.to_list(), "low": list(self.low), "high": list(self.high)}

    @classmethod
    def from_mapping(cls, values: Mapping[str, Any]) -> Self:
        """From an artefact; nothing from one that an earlier version wrote.

        Raises
        ------
        InputError
            A feature is unknown, or a range is missing or no number.
        """
        if not values.get("features"):
            return cls()
        recipe = FeatureRecipe.from_list(values["features"])
        low, high = (tuple(float(value) for value in values[name]) for name in ("low", "high"))
        if not len(low) == len(high) == len(recipe.names) or not np.isfinite([*low, *high]).all():
            raise InputError(
                f"not_told_apart: {len(low)} and {len(high)} ends of ranges for {len(recipe.names)} inputs; each needs two"
            )
        return cls(recipe, low, high)
