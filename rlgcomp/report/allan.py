"""Allan deviations as pictures and a page: the curve, its interval, the five fitted noises and their sum, a gyro each."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd
from matplotlib import rc_context
from matplotlib.figure import Figure

from rlgcomp.noise.analysis import NoiseAnalysis
from rlgcomp.noise.processes import coefficient_text
from rlgcomp.report.drawing import STYLE, WIDTH_IN, page_figure
from rlgcomp.report.messages.wording import time_text
from rlgcomp.report.page import Picture, Results, Section
from rlgcomp.report.svg import picture, png

_MOST_HEADLINES = 3


def allan_picture(analyses: Sequence[NoiseAnalysis], title: str) -> bytes:
    """PNG with one panel a gyro."""
    with rc_context(STYLE):
        figure = Figure(figsize=(1.4 * WIDTH_IN, 0.5 + 4.2 * len(analyses)), layout="constrained", dpi=130)
        figure.suptitle(title, x=0.01, ha="left", fontsize=12, fontweight="bold")
        for axes, analysis in zip(np.atleast_1d(figure.subplots(len(analyses), 1)), analyses, strict=True):
            analysis.plot(axes)
        return png(figure)


def allan_page(analyses: Sequence[NoiseAnalysis], title: str) -> Results:
    """The page of a recording's noise.

    Parameters
    ----------
    analyses : sequence of NoiseAnalysis
        One a gyro.
    title : str
        Name of the recording.
    """
    texts = [_angle_random_walk(one) for one in analyses]
    spans = {one.gyro: one.coefficients.tau_s for one in analyses}
    misfit = [one.gyro for one in analyses if one.coefficients.misfit]
    fit = f"does not describe {', '.join(misfit)}" if misfit else "describes every curve"
    return Results(
        title=f"Noise of {title}",
        kind="Allan deviation",
        badge="misfit" if misfit else "fitted",
        answer=f"The angle random walk of {analyses[0].gyro} is {texts[0]} deg/√h; a sum of five noises {fit}.",
        headline=tuple((text, f"deg/√h, {one.gyro}") for text, one in zip(texts, analyses, strict=True))[:_MOST_HEADLINES],
        facts=(
            ("Averaging", "; ".join(f"{name} {time_text(tau[0])} to {time_text(tau[-1])}" for name, tau in spans.items())),
            ("Estimator", analyses[0].deviation.estimator),
            ("Next", "Read the remarks, then give coefficients.json to diagnose with --noise."),
        ),
        sections=tuple(_section(one) for one in analyses),
        remarks=tuple(dict.fromkeys(finding for one in analyses for finding in one.findings)),
        footer="The curve is in allan.csv and the coefficients are in coefficients.json beside this page.",
    )


def _angle_random_walk(one: NoiseAnalysis) -> str:
    """N with its error, or its limit, without unit."""
    return coefficient_text(one.coefficients.angle_random_walk_deg_sqrt_h, one.coefficients.angle_random_walk_deg_sqrt_h_sd)


def _section(one: NoiseAnalysis) -> Section:
    coefficients = one.coefficients.shown().rename(columns={"": "symbol", "coefficient": "value ± standard error"})
    frame = one.deviation.to_frame()
    curve = pd.DataFrame(
        {
            "averaging time, s": [f"{value:.4g}" for value in frame["tau_s"]],
            "deviation, deg/h": [f"{value:.4g}" for value in frame["deviation_deg_h"]],
            "from": [f"{value:.4g}" for value in frame["lower_deg_h"]],
            "to": [f"{value:.4g}" for value in frame["upper_deg_h"]],
        }
    )
    note = f"Mean {one.mean_deg_h:.6g} deg/h. Dashed lines: the fitted noises, each alone; the dark line: their sum."
    return Section(one.gyro, (_picture(one), note, coefficients, curve))


def _picture(one: NoiseAnalysis) -> Picture:
    with page_figure(4.6) as (figure, axes):
        one.plot(axes)
        return picture(
            figure,
            f"allan-{one.gyro}",
            f"Allan deviation, {one.gyro}",
            f"Deviation in deg/h against averaging time in s, with its interval; N = {_angle_random_walk(one)} deg/√h",
        )
