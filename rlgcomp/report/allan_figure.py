"""The figure of an Allan deviation: the curve with its interval, the five fitted noises and their sum."""

from __future__ import annotations

import io
from collections.abc import Sequence
from typing import Final

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from rlgcomp.noise.analysis import NoiseAnalysis
from rlgcomp.noise.processes import coefficient_text
from rlgcomp.report.figures import FIT, FLOOR, INK, RAW, RESIDUAL, STYLE, WARM, WIDTH_IN

# One line a noise, in the order of the coefficients: letter, unit, colour
_NOISES: Final = (
    ("Q", "arcsec", "#cc79a7"),
    ("N", "deg/√h", FLOOR),
    ("B", "deg/h", "#e69f00"),
    ("K", "deg/h/√h", FIT),
    ("R", "deg/h²", WARM),
)


def allan_picture(analyses: Sequence[NoiseAnalysis], title: str) -> bytes:
    """PNG with one panel a gyro."""
    with rc_context(STYLE):
        figure = Figure(figsize=(WIDTH_IN, 0.5 + 4.2 * len(analyses)), layout="constrained", dpi=130)
        figure.suptitle(title, x=0.01, ha="left", fontsize=12, fontweight="bold")
        for axes, analysis in zip(np.atleast_1d(figure.subplots(len(analyses), 1)), analyses, strict=True):
            _panel(axes, analysis)
        buffer = io.BytesIO()
        figure.savefig(buffer, format="png", metadata={"Software": None})
        return buffer.getvalue()


def _panel(axes: Axes, analysis: NoiseAnalysis) -> None:
    deviation, coefficients = analysis.deviation, analysis.coefficients
    kind = "Hadamard deviation" if deviation.order == 3 else "Allan deviation"
    tau = np.geomspace(deviation.tau_s[0] / 1.3, deviation.tau_s[-1] * 1.3, 200)
    axes.fill_between(
        deviation.tau_s,
        deviation.lower_deg_h,
        deviation.upper_deg_h,
        color=RESIDUAL,
        alpha=0.18,
        lw=0,
        label=f"{100 * deviation.confidence:g} % interval",
    )
    axes.plot(deviation.tau_s, deviation.deviation_deg_h, "-o", color=RESIDUAL, ms=3, lw=1.0, label=kind)
    terms = np.sqrt(coefficients.terms(tau, deviation.order))
    axes.plot(
        tau,
        np.sqrt((terms**2).sum(axis=0)),
        color=INK,
        lw=1.4,
        label="five noises, fitted" + (" (they do not fit)" if coefficients.misfit else ""),
    )
    values = coefficients.to_frame()
    for (letter, unit, colour), term, value, sd in zip(_NOISES, terms, values["value"], values["sd"], strict=True):
        number = coefficient_text(value, sd)
        if value > 0.0:
            label = f"{letter} {number} {unit}" if number.startswith("<") else f"{letter} = {number} {unit}"
            axes.plot(tau, term, color=colour, lw=1.2, ls="--", label=label)
        elif np.isfinite(sd):
            axes.plot([], [], color=RAW, lw=0, label=f"{letter} {number} {unit}")
    axes.set(xscale="log", yscale="log", xlabel="averaging time in s", ylabel=f"{kind} in deg/h", xlim=(tau[0], tau[-1]))
    axes.set_ylim(0.4 * float(deviation.lower_deg_h.min()), 2.0 * float(deviation.upper_deg_h.max()))
    axes.set_title(analysis.gyro)
    axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
