"""The figure and page of a sensitivity: the shares detected and named at each strength, and the curves through them."""

from __future__ import annotations

import dataclasses
import textwrap
from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np
import numpy.typing as npt
import pandas as pd
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from rlgcomp.physics import CATALOGUE
from rlgcomp.report.drawing import FIT, RAW, RESIDUAL, STYLE, WIDTH_IN, page_figure
from rlgcomp.report.messages import Message
from rlgcomp.report.page import Picture, Results, Section
from rlgcomp.report.svg import picture, png

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


def draw_curves(axes: Axes, white_deg_h: float, detected: FoundCurve, named: FoundCurve) -> None:
    """Both curves over the strength, in deg/h as well; the area where more are named than detected is filled.

    Parameters
    ----------
    axes : Axes
    white_deg_h : float
        Rms of the part that the simulator cannot absorb, at strength one.
    detected, named : FoundCurve
    """
    earlier = named.chance > detected.chance
    filled: dict[str, Any] = {"where": earlier, "color": FIT, "alpha": 0.12, "lw": 0.0, "label": "named before it is detected"}
    if earlier.any():
        axes.fill_between(detected.at, detected.chance, named.chance, **filled)
    square: dict[str, Any] = {"color": FIT, "marker": "s", "mfc": "none", "ms": 9.0}  # neither hides the other
    for curve, dots, width in ((named, square, 5.0), (detected, {"color": RESIDUAL, "marker": "o", "ms": 5.0}, 2.5)):
        colour = dots["color"]
        axes.plot(curve.at, curve.chance, color=colour, lw=1.6)
        axes.plot(curve.strengths, curve.shares, ls="", label=curve.label, **dots)
        low, high = np.clip(curve.s90_interval, curve.at.min(), curve.at.max())
        axes.hlines(_MOST, low, high, color=colour, lw=width, alpha=0.35)
        axes.plot([curve.s90], [_MOST], "|", color=colour, ms=14, mew=2)
    axes.plot([], [], color=RAW, lw=2.5, alpha=0.6, label="bars: 90 % found, with its 95 % interval")
    axes.set_xscale("log")
    axes.set_xlim(float(detected.at.min()), float(detected.at.max()))
    tried = detected.strengths
    axes.set_xticks(tried, [f"{strength:g}\n{strength * white_deg_h:.2g}" for strength in tried])
    axes.set_xticks([], minor=True)
    axes.set_ylim(-0.03, 1.05)
    axes.set_xlabel("strength, and below it the rms in deg/h that the simulator cannot fit")
    axes.set_ylabel("share of trials")


def curves_picture(title: str, white_deg_h: float, detected: FoundCurve, named: FoundCurve, note: str) -> bytes:
    """PNG with both curves, and a note below.

    Parameters
    ----------
    title : str
    white_deg_h : float
        Rms of the part that the simulator cannot absorb, at strength one.
    detected, named : FoundCurve
    note : str
    """
    with rc_context(STYLE):
        figure = Figure(figsize=(1.4 * WIDTH_IN, 4.4), layout="constrained", dpi=130)
        axes = figure.subplots()
        draw_curves(axes, white_deg_h, detected, named)
        figure.supxlabel(textwrap.fill(note, 165), fontsize=7.5, ha="left", x=0.01)
        axes.set_title(title, loc="left")
        axes.legend(loc="lower right")
        return png(figure)


def curves(white_deg_h: float, detected: FoundCurve, named: FoundCurve) -> Picture:
    """Both curves as a picture of a page; parameters as of :func:`draw_curves`."""
    with page_figure(5.0) as (figure, axes):
        draw_curves(axes, white_deg_h, detected, named)
        figure.legend(loc="outside lower left")
        return picture(
            figure,
            "curves",
            "Share of trials in which the effect is found",
            f"Share against strength; 90 % are detected at {detected.s90:.2g} and named at {named.s90:.2g} times the white noise, "
            f"{detected.s90 * white_deg_h:.2g} and {named.s90 * white_deg_h:.2g} deg/h",
        )


def sensitivity_page(
    mechanism: str,
    white_deg_h: float,
    shown: tuple[FoundCurve, FoundCurve],
    tables: Mapping[str, pd.DataFrame],
    notes: tuple[Message, Sequence[Message]],
) -> Results:
    """The page of a sensitivity.

    Parameters
    ----------
    mechanism : str
    white_deg_h : float
        Rms of the part that the simulator cannot absorb, at strength one.
    shown : (FoundCurve, FoundCurve)
        Detected and named.
    tables : mapping of str to pandas.DataFrame
        By the title of its section.
    notes : (Message, sequence of Message)
        The meaning of detected and named; remarks.
    """
    words = mechanism.replace("_", " ")
    detected, named = shown
    sizes = [one.s90 * white_deg_h for one in shown]
    low, high = (end * white_deg_h for end in named.s90_interval)
    return Results(
        title=f"Smallest effect of {words} found in these recordings",
        kind="sensitivity",
        answer=f"In nine of ten trials an effect of {words} is detected at {sizes[0]:.2g} deg/h rms, and named at "
        f"{sizes[1]:.2g} deg/h rms.",
        headline=((f"{sizes[0]:.2g}", "deg/h rms detected"), (f"{sizes[1]:.2g}", "deg/h rms named")),
        facts=(
            ("Interval", f"named in nine of ten from {low:.2g} to {high:.2g} deg/h (95 %)"),
            ("Strength", f"1 is {white_deg_h:.2g} deg/h, the white noise of a 100 s mean; rms: of what the simulator cannot fit"),
            ("Next", "Record longer or wider programmes where a smaller effect must be found."),
        ),
        sections=(
            Section("Share found", (curves(white_deg_h, detected, named), notes[0].text)),
            *(Section(title, (table,)) for title, table in tables.items()),
        ),
        remarks=tuple(notes[1]),
        words=tuple(CATALOGUE),
        footer="Trials are in sensitivity.json, shares in shares.csv beside this page.",
    )
