"""Messages of simulation."""

from __future__ import annotations

from collections.abc import Sequence


def law_extrapolated(run: str, law: str, quantity: str, unit: str, recorded: Sequence[float], learnt: Sequence[float]) -> str:
    with_unit = f" {unit}" if unit else ""
    return (
        f"{run}: {quantity} goes from {recorded[0]:.4g} to {recorded[1]:.4g}{with_unit}, and the law {law} was learnt from "
        f"{learnt[0]:.4g} to {learnt[1]:.4g}{with_unit}: it is extrapolated, and may be wrong there"
    )
