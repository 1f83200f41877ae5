"""The picture of a sensitivity: what was detected and named at each strength, and the curves through it."""

from __future__ import annotations

import io

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure

from rlgcomp.diagnosis.sensitivity import Sensitivity
from rlgcomp.report.figures import RAW, RESIDUAL, STYLE, WIDTH_IN


def curves_picture(found: Sensitivity) -> bytes:
    """PNG with the detection and the naming curve over the strength."""
    table = found.to_frame()
    strengths = np.geomspace(table["strength"].min() / 2.0, table["strength"].max() * 2.0, 200)
    with rc_context(STYLE):
        figure = Figure(figsize=(WIDTH_IN, 4.0), layout="constrained", dpi=130)
        axes = figure.subplots()
        lines = (("detected", found.detection, table["detected"], RESIDUAL), ("named", found.naming, table["in_class"], RAW))
        for label, curve, shares, colour in lines:
            axes.plot(strengths, curve.probability(strengths), color=colour, lw=1.6, label=label)
            axes.plot(table["strength"], shares, "o", color=colour, ms=5)
            axes.axvspan(*curve.s90_interval, color=colour, alpha=0.08, lw=0)
        axes.set_xscale("log")
        axes.set_xlim(strengths[0], strengths[-1])
        axes.set_ylim(-0.03, 1.03)
        axes.set_xlabel(f"strength (1 = {found.white_deg_h:.3g} deg/h rms that the simulator cannot absorb)")
        axes.set_ylabel("share of trials")
        axes.set_title(f"{found.mechanism}: found in these recordings; shaded: 90 % with its 95 % interval", loc="left")
        axes.legend(loc="lower right")
        buffer = io.BytesIO()
        figure.savefig(buffer, format="png", metadata={"Software": None})
        return buffer.getvalue()
