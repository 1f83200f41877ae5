"""Compensation: models under scikit-learn's contract, their selection over runs, and the compensator that joins them to features.

To add a model, write its file, end it with its `FORM`, and name it in `MODELS`.
"""

from __future__ import annotations

from types import MappingProxyType
from typing import Any, Final

from rlgcomp.compensation import baselines, cubic, fixed_size, lssvm, sequence
from rlgcomp.compensation.model_specification import ModelForm

MODELS: Final[MappingProxyType[str, ModelForm]] = MappingProxyType(
    {form.name: form for form in (lssvm.FORM, fixed_size.FORM, *cubic.FORMS, *baselines.FORMS, sequence.FORM)}
)


def form_of(model: Any) -> ModelForm | None:
    """The form that selects and saves this model, or None for a regressor of the user's own."""
    fitting = [form for form in MODELS.values() if form.estimator is type(model)]
    exact = [form for form in fitting if all(model.get_params().get(key) == value for key, value in form.defaults.items())]
    return max(exact or fitting, key=lambda form: len(form.defaults), default=None)
