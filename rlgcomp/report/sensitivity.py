"""The picture of a sensitivity: what was found at each strength, and the curves through it."""

from __future__ import annotations

import dataclasses
import io
import textwrap
from collections.abc import Sequence
from typing import Final

import numpy as np
import numpy.typing as npt
from matplotlib import rc_context
from matplotlib.figure import Figure

from rlgcomp.report.figures import RAW, RESIDUAL, STYLE, WIDTH_IN

Array = npt.NDArray[np.float64]
_COLOURS: Final = (RESIDUAL, RAW)


@dataclasses.dataclass(frozen=True)
class FoundCurve:
    """Shares found at the strengths tried, and the curve through them with the interval of its 90 % point."""

    label: str
    strengths: Array
    shares: Array
    at: Array
    chance: Array
    s90_interval: tuple[float, float]


def curves_picture(title: str, strength: str, curves: Sequence[FoundCurve], note: str) -> bytes:
    """PNG with the curves over the strength, which `strength` explains, and a note below."""
    with rc_context(STYLE):
        figure = Figure(figsize=(WIDTH_IN, 4.0), layout="constrained", dpi=130)
        axes = figure.subplots()
        for curve, colour in zip(curves, _COLOURS, strict=False):
            axes.plot(curve.at, curve.chance, color=colour, lw=1.6, label=curve.label)
            axes.plot(curve.strengths, curve.shares, "o", color=colour, ms=5)
            axes.axvspan(*curve.s90_interval, color=colour, alpha=0.08, lw=0)
        axes.set_xscale("log")
        axes.set_xlim(float(curves[0].at[0]), float(curves[0].at[-1]))
        axes.set_ylim(-0.03, 1.03)
        axes.set_xlabel(strength)
        figure.supxlabel(textwrap.fill(note, 165), fontsize=7.5, ha="left", x=0.01)
        axes.set_ylabel("share of trials")
        axes.set_title(title, loc="left")
        axes.legend(loc="lower right")
        buffer = io.BytesIO()
        figure.savefig(buffer, format="png", metadata={"Software": None})
        return buffer.getvalue()
