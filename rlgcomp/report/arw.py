"""Figures and page of the angle random walk under rotation: orders, before and after, Allan deviation, spectrum."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
import pandas as pd

from rlgcomp.noise.angle_harmonics import FALSE_ALARM
from rlgcomp.noise.angle_random_walk import DISAGREES_P, RotationNoise
from rlgcomp.noise.constant_rate_segment import AngleRandomWalk
from rlgcomp.report.drawing import FIT, FLOOR, RAW, RESIDUAL, WARM, legend, page_figure, plain_powers, time_axis
from rlgcomp.report.messages.wording import estimate_text, p_text
from rlgcomp.report.page import Picture, Results, Section
from rlgcomp.report.svg import picture

SHOWN_MEANS_S: Final = 60


def orders(one: AngleRandomWalk) -> Picture:
    """Amplitude of every order of the rotation, the detected ones in colour, with the threshold."""
    with page_figure(3.4) as (figure, axes):
        spectrum = one.spectrum
        amplitude = np.abs(spectrum.coefficient_deg_h)
        detected = spectrum.p_value < FALSE_ALARM
        axes.vlines(spectrum.orders[~detected], amplitude.min() / 2, amplitude[~detected], color=RAW, lw=1.2)
        axes.plot(spectrum.orders[~detected], amplitude[~detected], "o", color=RAW, ms=2.5, label="not detected")
        axes.vlines(spectrum.orders[detected], amplitude.min() / 2, amplitude[detected], color=FIT, lw=1.8)
        axes.plot(spectrum.orders[detected], amplitude[detected], "o", color=FIT, ms=5, label="detected and fitted")
        crowded = np.diff(spectrum.orders[detected], prepend=-9) < 3
        for order, height, close in zip(spectrum.orders[detected], amplitude[detected], crowded, strict=True):
            place = (5, 0) if close else (0, 5)
            axes.annotate(
                str(order), (order, height), place, textcoords="offset points", ha="left" if close else "center", fontsize=8.5
            )
        axes.plot(spectrum.orders, 6.0 * spectrum.sd_deg_h, color=WARM, lw=1.0, ls="--", label="6 standard deviations")
        axes.set_yscale("log")
        plain_powers(axes.yaxis)
        axes.set_ylim(amplitude.min() / 2, 3.0 * amplitude.max())
        axes.set_xlabel("order (cycles in a revolution)")
        axes.set_ylabel("amplitude in deg/h")
        axes.set_title(f"Harmonics of the table angle, {_name(one)}")
        legend(axes)
        return picture(
            figure,
            f"{_stem(one)}-orders",
            f"Harmonics of the table angle, {_name(one)}",
            f"Amplitude of each order in deg/h; {len(one.harmonics.orders)} detected and fitted; dashed: six s.d.",
        )


def output(one: AngleRandomWalk) -> Picture:
    """1 s means over the run, mean removed, before and after; the trend; and one minute of both."""
    with page_figure(5.2, 2, 2, sharey="row", width_ratios=[2.6, 1.0]) as (figure, grid):
        (top, minute_before), (bottom, minute_after) = grid
        table = one.means
        since = table["time_s"] - table["time_s"].iloc[0]
        unit_s, label = time_axis(float(since.iloc[-1]))
        at = since / unit_s
        trend = table["trend_deg_h"] - table["trend_deg_h"].mean()
        top.plot(at, table["before_deg_h"] + trend, color=RAW, lw=0.3, rasterized=True, label="1 s means")
        top.plot(at, trend, color=WARM, lw=1.6, label="trend")
        bottom.plot(at, table["after_deg_h"], color=RESIDUAL, lw=0.3, rasterized=True, label="1 s means")
        minute = table.iloc[:SHOWN_MEANS_S]
        seconds = minute["time_s"] - minute["time_s"].iloc[0]
        minute_before.plot(seconds, (table["before_deg_h"] + trend).iloc[:SHOWN_MEANS_S], "-o", color=RAW, ms=2, lw=0.9)
        minute_after.plot(seconds, minute["after_deg_h"], "-o", color=RESIDUAL, ms=2, lw=0.9)
        top.set_title(f"Before, {_name(one)}")
        bottom.set_title("After harmonics and trend")
        minute_before.set_title("first minute")
        bottom.set_xlabel(label)
        minute_after.set_xlabel("time in s")
        for axes in (top, bottom):
            axes.set_ylabel("deg/h")
        handles, labels = top.get_legend_handles_labels()
        figure.legend(handles[::-1], labels[::-1], loc="outside lower left", ncols=2)
        return picture(
            figure,
            f"{_stem(one)}-output",
            f"Output before and after, {_name(one)}",
            "Means of 1 s in deg/h over the run, mean removed, with the trend; and the first minute",
        )


def allan(one: AngleRandomWalk) -> Picture:
    """Allan deviation of 1 s means before and after, the five-term fit, and the result with its error."""
    with page_figure(4.0) as (figure, axes):
        before, after = one.before, one.after
        axes.loglog(before.tau_s, before.deviation_deg_h, "-o", color=RAW, ms=3, lw=1.2, label="before")
        errors = [after.deviation_deg_h - after.lower_deg_h, after.upper_deg_h - after.deviation_deg_h]
        axes.errorbar(after.tau_s, after.deviation_deg_h, errors, fmt="o", color=RESIDUAL, ms=3.5, lw=1.0, label="after, 68 %")
        tau = np.geomspace(after.tau_s[0], after.tau_s[-1], 200)
        axes.loglog(tau, np.sqrt(one.coefficients.terms(tau).sum(axis=0)), color=FIT, lw=1.4, label="five-term fit")
        n, sd = one.angle_random_walk_deg_sqrt_h, one.angle_random_walk_deg_sqrt_h_sd
        axes.fill_between(tau, 60 * (n - 2 * sd) / np.sqrt(tau), 60 * (n + 2 * sd) / np.sqrt(tau), color=FLOOR, alpha=0.25, lw=0)
        axes.loglog(tau, 60 * n / np.sqrt(tau), color=FLOOR, lw=1.2, ls="--", label=f"N = {estimate_text(n, sd, 'deg/√h')}")
        plain_powers(axes.xaxis, axes.yaxis)
        axes.set_xlabel("averaging time in s")
        axes.set_ylabel("Allan deviation in deg/h")
        axes.set_title(f"Allan deviation, {_name(one)}")
        legend(axes)
        return picture(
            figure,
            f"{_stem(one)}-allan",
            f"Allan deviation, {_name(one)}",
            f"Deviation in deg/h against averaging time in s, before and after harmonics and trend; "
            f"dashed: N = {estimate_text(n, sd, 'deg/√h')}",
        )


def spectrum(one: AngleRandomWalk) -> Picture:
    """Spectrum after harmonics and trend, the four noises fitted to it, and the band of the fit."""
    with page_figure(3.8) as (figure, axes):
        frequency, density = one.density.bands()
        axes.loglog(frequency, density, "o", color=RESIDUAL, ms=3, label="means over bands")
        f = np.geomspace(one.density.frequency_hz[0], one.density.frequency_hz[-1], 300)
        fitted = one.noise.density(f, one.density.period_s)
        inside = f <= one.noise.highest_hz * 1.001
        axes.loglog(f[inside], fitted[inside], color=FIT, lw=1.5, label="fitted noises")
        axes.axhline((60 * one.angle_random_walk_deg_sqrt_h) ** 2, color=FLOOR, lw=1.2, ls="--", label="(60 N)²")
        axes.axvline(one.noise.highest_hz, color="#c4c8ce", lw=1.0, label="end of the fit")
        plain_powers(axes.xaxis, axes.yaxis)
        axes.set_xlabel("frequency in Hz")
        axes.set_ylabel("(deg/h)²/Hz")
        axes.set_title(f"Spectrum of the residual, {_name(one)}")
        legend(axes)
        return picture(
            figure,
            f"{_stem(one)}-spectrum",
            f"Spectrum of the residual, {_name(one)}",
            f"Density in (deg/h)²/Hz against frequency in Hz, with the fitted noises up to "
            f"{one.noise.highest_hz:.3g} Hz; dashed: the white part",
        )


def pictures(one: AngleRandomWalk) -> dict[str, Picture]:
    """All figures of one gyro, by name."""
    return {"orders": orders(one), "output": output(one), "allan": allan(one), "spectrum": spectrum(one)}


def _name(one: AngleRandomWalk) -> str:
    return f"{one.gyro.removesuffix('_deg_h').removesuffix('_deg_s').removesuffix('_pulses')} at {one.rate_deg_s:.4g} deg/s"


def _stem(one: AngleRandomWalk) -> str:
    """Beginning of the names of a gyro's figures."""
    return f"{one.run}-{one.gyro}-{abs(one.rate_deg_s):.3g}"


def arw_page(result: RotationNoise, shown: Sequence[dict[str, Picture]]) -> Results:
    """The page of the angle random walk of turning gyros.

    Parameters
    ----------
    result : RotationNoise
    shown : sequence of dict of str to Picture
        Of each gyro, as :func:`pictures` gives them.
    """
    texts = [estimate_text(one.angle_random_walk_deg_sqrt_h, one.angle_random_walk_deg_sqrt_h_sd, "") for one in result.gyros]
    least = min((one.agreement_p_value for one in result.gyros), default=1.0)
    agree = least >= DISAGREES_P
    frame = result.to_frame()
    delay = result.delay
    lag = "unknown: one rate alone" if delay is None else f"{1e3 * delay.delay_s:.4f} ± {1e3 * delay.sd_s:.4f} ms ({delay.source})"
    table = pd.DataFrame(
        {
            "run": frame["run"],
            "gyro": frame["gyro"],
            "rate, deg/s": [f"{value:.4g}" for value in frame["rate_deg_s"]],
            "N, deg/√h": texts,
            "whole turns, deg/√h": [
                estimate_text(
                    one.whole_revolutions.angle_random_walk_deg_sqrt_h, one.whole_revolutions.angle_random_walk_deg_sqrt_h_sd, ""
                )
                for one in result.gyros
            ],
            "agree, p": [f"{one.agreement_p_value:.2g}" for one in result.gyros],
            "orders": frame["orders"],
        }
    )
    runs = ", ".join(dict.fromkeys(one.run for one in result.gyros))
    return Results(
        title=f"Angle random walk under rotation, {runs}",
        kind="angle random walk",
        badge="cross-check agrees" if agree else "cross-check disagrees",
        answer=f"The angle random walk of {_name(result.gyros[0])} is {texts[0]} deg/√h; the cross-check without harmonics "
        f"{'agrees' if agree else 'disagrees'} ({p_text(least)}).",
        headline=tuple((text, f"deg/√h, {_name(one)}") for text, one in zip(texts, result.gyros, strict=True))[:3],
        facts=(
            ("Encoder's delay", lag),
            ("Next", "Read the remarks; a second rate gives the encoder's delay." if delay is None else "Read the remarks."),
        ),
        sections=(
            Section(
                "Results",
                (table, "N of the spectrum with its standard deviation; whole turns: the cross-check that needs no harmonic fit."),
            ),
            *(Section(f"{one.run}, {_name(one)}", tuple(of.values())) for one, of in zip(result.gyros, shown, strict=True)),
        ),
        remarks=result.remarks,
        footer="Numbers are in arw.json and arw.csv, orders and deviations in tables beside this page.",
    )
