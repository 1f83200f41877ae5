"""Compensation: models under scikit-learn's contract, their selection over runs, and the compensator that joins them to features.

To add a model, write its file, end it with its `FORM`, and name it in `MODELS`.
"""

from __future__ import annotations

from types import MappingProxyType
from typing import Final

from rlgcomp.compensation import baselines, cubic, lssvm, sequence
from rlgcomp.compensation.form import ModelForm

MODELS: Final[MappingProxyType[str, ModelForm]] = MappingProxyType(
    {form.name: form for form in (lssvm.FORM, *cubic.FORMS, *baselines.FORMS, sequence.FORM)}
)
