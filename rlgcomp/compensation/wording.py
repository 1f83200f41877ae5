"""A compensation as text for a terminal or a notebook."""

from __future__ import annotations

import textwrap
from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from rlgcomp.compensation.compensator import Compensator


_WIDTH: Final = 110


def as_text(compensator: Compensator) -> str:
    """What it is, what it was trained on, and what is left with runs left out."""
    if not hasattr(compensator, "model_"):
        model = "LSSVMRegressor" if compensator.model is None else type(compensator.model).__name__
        return f"Compensator, not fitted: {model}, features {_listed(compensator.features)}, {compensator.averaging_s:g} s means"
    kind = type(compensator.model_).__name__ if compensator.form_ is None else compensator.form_.name
    before, rmse = compensator.scaling_.y_scale_deg_h, compensator.selection_.rmse
    left = "not known" if rmse is None else f"{rmse * before:.3g} deg/h"
    hours = sum(float(run["hours"]) for run in compensator.provenance_)
    selected = ", ".join(f"{name} = {_short(value)}" for name, value in compensator.selection_.best.items())
    count = f"{len(compensator.recipe_.names)} input{'s' if len(compensator.recipe_.names) > 1 else ''}"
    inputs, within = compensator.recipe_.names, compensator.interval_.inside_deg_h
    lines = [
        f"Compensator of {compensator.gyro_}: {kind} on {count}, {compensator.averaging_s:g} s means",
        textwrap.fill(f"  inputs: {', '.join(inputs)}", _WIDTH, subsequent_indent=" " * 6),
        f"  trained on: {', '.join(str(run['run']) for run in compensator.provenance_)} ({hours:.1f} h)",
        f"  selected: {selected or 'nothing to select'}",
        f"  rms before {before:.3g} deg/h, with runs left out {left}; 90 % interval ± {within:.2g} deg/h",
    ]
    return "\n".join(lines)


def _listed(features: Any) -> str:
    return features if isinstance(features, str) else ", ".join(map(str, features))


def _short(value: Any) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)
