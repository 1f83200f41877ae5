"""Models of a gyro's bias: regressors under scikit-learn's contract, each with the specification that selects and saves it.

To add a model, write its file, end it with its `SPECIFICATION`, and name it in `MODELS`.
"""

from __future__ import annotations

from types import MappingProxyType
from typing import Any, Final

from rlgcomp.compensation.models import baselines, cubic, fixed_size, lssvm, sequence
from rlgcomp.compensation.models.specification import ModelSpecification

MODELS: Final[MappingProxyType[str, ModelSpecification]] = MappingProxyType(
    {
        specification.name: specification
        for specification in (
            *lssvm.SPECIFICATIONS,
            fixed_size.SPECIFICATION,
            *cubic.SPECIFICATIONS,
            *baselines.SPECIFICATIONS,
            sequence.SPECIFICATION,
        )
    }
)
DEFAULT: Final = "lssvm-dynamic"  # of a compensation without known physics


def specification_of(model: Any) -> ModelSpecification | None:
    """The specification that selects and saves this model, or None for a regressor of the user's own."""
    candidates = [each for each in MODELS.values() if each.estimator is type(model)]
    parameters = model.get_params() if candidates else {}
    exact = [each for each in candidates if all(parameters.get(key) == value for key, value in each.defaults.items())]
    return max(exact or candidates, key=lambda each: len(each.defaults), default=None)
