"""The figure of a sensitivity: the shares detected and named at each strength, and the curves through them."""

from __future__ import annotations

import dataclasses
import io
import textwrap
from typing import Any, Final

import numpy as np
import numpy.typing as npt
from matplotlib import rc_context
from matplotlib.figure import Figure

from rlgcomp.report.drawing import FIT, RAW, RESIDUAL, STYLE, WIDTH_IN
from rlgcomp.report.svg import names_as_they_are

Array = npt.NDArray[np.float64]
_MOST: Final = 0.9  # share of trials at which intervals are drawn


@dataclasses.dataclass(frozen=True)
class FoundCurve:
    """Shares found at the strengths tried, and the curve through them with its 90 % point and that point's interval."""

    label: str
    strengths: Array
    shares: Array
    at: Array
    chance: Array
    s90: float
    s90_interval: tuple[float, float]


def curves_picture(title: str, white_deg_h: float, detected: FoundCurve, named: FoundCurve, note: str) -> bytes:
    """PNG with both curves over the strength, in deg/h as well, and a note below.

    Parameters
    ----------
    title : str
    white_deg_h : float
        Rms of the part that the simulator cannot absorb, at strength one.
    detected, named : FoundCurve
        The area where more are named than detected is filled.
    note : str
    """
    with rc_context(STYLE):
        figure = Figure(figsize=(WIDTH_IN, 4.4), layout="constrained", dpi=130)
        axes = figure.subplots()
        earlier = named.chance > detected.chance
        filled: dict[str, Any] = {"where": earlier, "color": FIT, "alpha": 0.12, "lw": 0.0, "label": "named before it is detected"}
        axes.fill_between(detected.at, detected.chance, named.chance, **filled)
        square: dict[str, Any] = {"color": FIT, "marker": "s", "mfc": "none", "ms": 9.0}  # neither hides the other
        for curve, dots, width in ((named, square, 5.0), (detected, {"color": RESIDUAL, "marker": "o", "ms": 5.0}, 2.5)):
            colour = dots["color"]
            axes.plot(curve.at, curve.chance, color=colour, lw=1.6)
            axes.plot(curve.strengths, curve.shares, ls="", label=curve.label, **dots)
            low, high = np.clip(curve.s90_interval, curve.at[0], curve.at[-1])
            axes.hlines(_MOST, low, high, color=colour, lw=width, alpha=0.35)
            axes.plot([curve.s90], [_MOST], "|", color=colour, ms=14, mew=2)
        axes.plot([], [], color=RAW, lw=2.5, alpha=0.6, label="bars: 90 % found, with its 95 % interval")
        axes.set_xscale("log")
        axes.set_xlim(float(detected.at[0]), float(detected.at[-1]))
        tried = detected.strengths
        axes.set_xticks(tried, [f"{strength:g}\n{strength * white_deg_h:.2g} deg/h" for strength in tried])
        axes.set_xticks([], minor=True)
        axes.set_ylim(-0.03, 1.05)
        axes.set_xlabel("strength; below it the rms that the simulator cannot absorb")
        figure.supxlabel(textwrap.fill(note, 165), fontsize=7.5, ha="left", x=0.01)
        axes.set_ylabel("share of trials")
        axes.set_title(title, loc="left")
        axes.legend(loc="lower right")
        buffer = io.BytesIO()
        names_as_they_are(figure)
        figure.savefig(buffer, format="png", metadata={"Software": None})
        return buffer.getvalue()
