"""Which size is exported: what a budget leaves, and the smallest model that is as good as the best."""

from __future__ import annotations

import pandas as pd

from rlgcomp.compensation.compensator import Compensator
from rlgcomp.errors import InputError
from rlgcomp.export.c_source import table_bytes
from rlgcomp.export.expansion import Expansion
from rlgcomp.export.reduce import reduction_of, size_curve, smallest_within
from rlgcomp.export.target import Options


def sized(compensator: Compensator, whole: Expansion, options: Options) -> tuple[Expansion, pd.DataFrame]:
    """The expansion to export, and the curve of stability against size; see :func:`rlgcomp.export.reduce.size_curve`.

    Without a budget that is the whole model. A budget alone takes the largest model within it; `smallest` takes the smallest that
    is within 1 % of the best that the budget leaves.

    Raises
    ------
    InputError
        The budget cannot be met, or the model cannot be made smaller.
    """
    centres = len(whole.weights)
    limit = centres if options.max_centres is None else min(centres, options.max_centres)
    if options.max_bytes is not None:
        limit = _fitting(whole, limit, options)
    asked = options.smallest or limit < centres
    if not centres or not (asked or options.runs):
        return whole, pd.DataFrame()
    if whole.form == "sigmoid" and not asked:
        return whole, pd.DataFrame()
    curve = size_curve(compensator, options.runs, [limit])
    curve.insert(1, "table_bytes", [table_bytes(whole, int(m), options.precision) for m in curve["centres"]])
    if options.smallest:
        limit = smallest_within(curve[curve["centres"] <= limit])
    return (whole if limit == centres else reduction_of(compensator).with_centres(limit)), curve


def _fitting(whole: Expansion, limit: int, options: Options) -> int:
    """Most centres, up to a limit, whose tables fit."""
    fewest = 0 if whole.form in ("wide", "polynomial") else 1
    fitting = [m for m in range(fewest, limit + 1) if table_bytes(whole, m, options.precision) <= (options.max_bytes or 0)]
    if not fitting:
        least = table_bytes(whole, fewest, options.precision)
        advice = "try --precision float, or train on fewer --features" if options.precision == "double" else "use fewer --features"
        raise InputError(
            f"--max-bytes {options.max_bytes} cannot be met: the smallest tables of this model take {least} bytes in "
            f"{options.precision}; {advice}"
        )
    return fitting[-1]
