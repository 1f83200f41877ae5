"""The figure of Allan deviations: a panel a gyro, with the curve, its interval, the five fitted noises and their sum."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure

from rlgcomp.noise.analysis import NoiseAnalysis
from rlgcomp.report.drawing import STYLE, WIDTH_IN
from rlgcomp.report.svg import png


def allan_picture(analyses: Sequence[NoiseAnalysis], title: str) -> bytes:
    """PNG with one panel a gyro."""
    with rc_context(STYLE):
        figure = Figure(figsize=(WIDTH_IN, 0.5 + 4.2 * len(analyses)), layout="constrained", dpi=130)
        figure.suptitle(title, x=0.01, ha="left", fontsize=12, fontweight="bold")
        for axes, analysis in zip(np.atleast_1d(figure.subplots(len(analyses), 1)), analyses, strict=True):
            analysis.plot(axes)
        return png(figure)
