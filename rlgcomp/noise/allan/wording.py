"""Deviations and coefficients as text for a terminal or a notebook."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

import numpy as np
import pandas as pd

from rlgcomp.noise.processes import upper_limit

if TYPE_CHECKING:
    from rlgcomp.noise.allan.analysis import NoiseAnalysis
    from rlgcomp.noise.allan.coefficients import NoiseCoefficients
    from rlgcomp.noise.allan.deviation import AllanDeviation

SHOWN: Final = 12  # averaging times
_UNITS: Final = {
    "quantization_arcsec": ("Q", "quantization", "arcsec"),
    "angle_random_walk_deg_sqrt_h": ("N", "angle random walk", "deg/sqrt(h)"),
    "bias_instability_deg_h": ("B", "bias instability", "deg/h"),
    "rate_random_walk_deg_h_sqrt_h": ("K", "rate random walk", "deg/h/sqrt(h)"),
    "rate_ramp_deg_h2": ("R", "rate ramp", "deg/h²"),
}


def deviation_text(deviation: AllanDeviation) -> str:
    """A table of some averaging times, from the shortest to the longest."""
    count = len(deviation.tau_s)
    rows = np.unique(np.linspace(0, count - 1, min(count, SHOWN)).round().astype(int))
    frame = deviation.to_frame().iloc[rows].drop(columns="differences")
    gaps = len(deviation.parts) - 1
    kind = "Hadamard" if deviation.order == 3 else "Allan"
    head = (
        f"{kind} deviation ({deviation.estimator}): {int(deviation.parts.sum())} samples every {deviation.period_s:.6g} s, "
        f"{gaps} gap{'' if gaps == 1 else 's'}, {100 * deviation.confidence:g} % intervals"
    )
    tail = [] if len(rows) == count else [f"{len(rows)} of {count} averaging times; .to_frame() has all"]
    return "\n".join([head, frame.to_string(index=False, float_format="{:.4g}".format), *tail])


def coefficients_text(coefficients: NoiseCoefficients) -> str:
    """One line a noise, with its standard error; for one that is not seen its upper limit."""
    lines = [f"{letter}  {noise:<17}  {seen}" for letter, noise, seen in _coefficient_rows(coefficients)]
    if coefficients.misfit:
        lines.append(f"the five noises do not describe the curve: off by {100 * coefficients.misfit:.0f} % beyond chance")
    return "\n".join(lines)


def coefficients_table(coefficients: NoiseCoefficients) -> pd.DataFrame:
    """The same as a table."""
    return pd.DataFrame(_coefficient_rows(coefficients), columns=["", "noise", "coefficient"])


def _coefficient_rows(coefficients: NoiseCoefficients) -> list[tuple[str, str, str]]:
    rows = []
    for name, (letter, noise, unit) in _UNITS.items():
        value, sd = getattr(coefficients, name), getattr(coefficients, f"{name}_sd")
        rows.append((letter, noise, f"{value_text(value, sd)} {unit}" if math.isfinite(sd) else "not seen"))
    return rows


def analysis_text(analysis: NoiseAnalysis) -> str:
    """Mean, coefficients and what was found."""
    said = [f"- {finding}" for finding in analysis.findings]
    return "\n".join([f"{analysis.gyro}: mean {analysis.mean_deg_h:.6g} deg/h", coefficients_text(analysis.coefficients), *said])


def short(value: float) -> str:
    """A standard error to two digits.

    >>> short(12.7), short(0.0213)
    ('13', '0.021')
    """
    return f"{float(f'{value:.2g}'):g}"


def value_text(value: float, sd: float) -> str:
    """A coefficient with its standard error, or its :func:`rlgcomp.noise.processes.upper_limit` where it is not seen.

    >>> value_text(0.5, 0.01), value_text(0.002, 0.001), value_text(0.0, 0.1)
    ('0.5 ± 0.01', '< 0.003 (95 %)', '< 0.13 (95 %)')
    """
    limit = upper_limit(value, sd)
    return f"{value:.3g} ± {short(sd)}" if limit is None else f"< {short(limit)} (95 %)"
