"""Drawing: one style for all pictures, and what is drawn from plain arrays; pages, files and notebooks show the same.

Functions named `draw_...` draw onto axes that :func:`panels` provides: the caller's own, or those of a new figure, which a
notebook shows. They compute no result. Matplotlib is imported with this module, so the module is imported where it is used.
"""

from __future__ import annotations

import contextlib
import math
import re
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Final

import numpy as np
import numpy.typing as npt
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.ticker import LogFormatterSciNotation, LogLocator
from matplotlib.transforms import ScaledTranslation

from rlgcomp.errors import InputError
from rlgcomp.report.svg import names_as_they_are
from rlgcomp.units import SECONDS_PER_HOUR, SECONDS_PER_MINUTE, column_unit, display_unit, typeset

Array = npt.NDArray[np.float64]
# Okabe and Ito's palette, which colour-blind readers can distinguish
RAW: Final = "#8a8f98"
FIT: Final = "#d55e00"
RESIDUAL: Final = "#0072b2"
FLOOR: Final = "#009e73"
WARM: Final = "#cc3311"
INK: Final = "#23272e"
FAINT: Final = "#c4c8ce"
WIDTH_IN: Final = 6.8  # legible on a narrow screen, and half a page wide in print
_LINES: Final = (RESIDUAL, FIT, FLOOR, "#cc79a7", "#e69f00", "#56b4e9", INK, RAW)
_RAISED: Final = str.maketrans("-−0123456789", "⁻⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
STYLE: Final[Any] = {
    "font.family": "DejaVu Sans",
    "font.size": 10.0,
    "text.color": INK,
    "axes.edgecolor": FAINT,
    "axes.labelcolor": INK,
    "axes.titlesize": 11.0,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "axes.titley": 1.0,  # the place that Matplotlib would find after measuring every label
    "axes.facecolor": "none",
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": "#eceef1",
    "grid.linewidth": 0.8,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "xtick.color": "#6b7280",
    "ytick.color": "#6b7280",
    "xtick.labelcolor": INK,
    "ytick.labelcolor": INK,
    "legend.frameon": False,
    "svg.hashsalt": "rlgcomp",
    "figure.dpi": 100,
}
_BESIDE_LETTERS: Final = 24  # of the longest line of a legend that stands beside its axes; a wider one stands below
_BELOW_IN: Final = 0.56
_MOST_DOTS: Final = 4000  # more samples are drawn as the band from least to greatest, with the mean
_BINS: Final = 1500
_MOST_SPANS: Final = 10.0  # of the narrowest channel of a panel, in the panel
_LETTERS: Final = 24  # of a legend's line
# Symbol, unit and colour of the five noises
NOISES: Final = (
    ("Q", "arcsec", "#cc79a7"),
    ("N", "deg/√h", FLOOR),
    ("B", "deg/h", "#e69f00"),
    ("K", "deg/h/√h", FIT),
    ("R", "deg/h²", WARM),
)


@contextlib.contextmanager
def page_figure(height_in: float, rows: int = 1, columns: int = 1, **options: Any) -> Iterator[tuple[Figure, Any]]:
    """A figure of a page with its axes, in the style of all pictures; options of Matplotlib's `subplots`."""
    with rc_context(STYLE):
        figure = Figure(figsize=(WIDTH_IN, height_in), layout="constrained")
        yield figure, figure.subplots(rows, columns, **options)


def panels(ax: Any, heights: Sequence[float], *, sharex: bool = True) -> list[Axes]:
    """Axes to draw on.

    To be called outside of a context of style, since a notebook's back end sets options of its own with the first figure.

    Parameters
    ----------
    ax : Axes, sequence of Axes, or None
        The caller's own: one for the first panel alone, or one for each panel. None makes a figure.
    heights : sequence of float
        Of each panel in inches.
    sharex : bool

    Raises
    ------
    InputError
        There are more axes than panels, or something is no Axes.
    """
    if ax is None:
        from matplotlib import pyplot

        figure = pyplot.figure(figsize=(WIDTH_IN, 0.45 + sum(heights)), layout="constrained")
        options: Any = {"squeeze": False, "sharex": sharex, "gridspec_kw": {"height_ratios": heights}}
        with rc_context(STYLE):
            return list(figure.subplots(len(heights), 1, **options)[:, 0])
    own = [ax] if isinstance(ax, Axes) else list(np.ravel(ax))
    if not all(isinstance(each, Axes) for each in own):
        raise InputError(f"ax is {ax!r:.80}; it must be Axes of Matplotlib, or one for each panel")
    if len(own) > len(heights):
        raise InputError(f"ax holds {len(own)} axes; this picture has {len(heights)} panel{'s' if len(heights) > 1 else ''}")
    return own


def returned(axes: Sequence[Axes]) -> Any:
    """What `plot` returns: the axes, or an array of them where there are several."""
    for figure in {_figure(one) for one in axes} - {None}:
        names_as_they_are(figure)
    if len(axes) == 1:
        return axes[0]
    array = np.empty(len(axes), dtype=object)
    array[:] = axes
    return array


def _figure(axes: Axes) -> Figure | None:
    """The figure that holds axes, also those of a part of it."""
    parent = axes.figure
    return None if parent is None else parent.figure  # a part of a figure names the whole one, which names itself


def legend(axes: Axes) -> None:
    """A legend outside of the axes where the figure's layout makes room for it, within them elsewhere."""
    figure = _figure(axes)
    roomy = figure is not None and isinstance(figure.get_layout_engine(), ConstrainedLayoutEngine)
    labels = axes.get_legend_handles_labels()[1]
    if not labels:
        return
    longest = max(len(line) for label in labels for line in label.split("\n"))
    if figure is None or not roomy:
        axes.legend(loc="best")
    elif longest <= _BESIDE_LETTERS:
        axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
    else:
        columns = 2 if longest <= 2 * _BESIDE_LETTERS else 1
        under = _BELOW_IN if axes.get_xlabel() else 0.5 * _BELOW_IN
        below = axes.transAxes + ScaledTranslation(0.0, -under, figure.dpi_scale_trans)
        axes.legend(
            loc="upper left", bbox_to_anchor=(0.0, 0.0), bbox_transform=below, borderaxespad=0.0, ncols=min(columns, len(labels))
        )


def time_axis(duration_s: float) -> tuple[float, str]:
    """Seconds in a unit of the axis of time, and its label.

    >>> time_axis(7200.0), time_axis(90.0)
    ((3600.0, 'time in h'), (1.0, 'time in s'))
    """
    if duration_s >= SECONDS_PER_HOUR:
        return SECONDS_PER_HOUR, "time in h"
    return (SECONDS_PER_MINUTE, "time in min") if duration_s >= 10.0 * SECONDS_PER_MINUTE else (1.0, "time in s")


def power(size: float, unit: str) -> tuple[float, str]:
    """Factor and unit in which numbers of a size are read well, and take little room.

    >>> power(0.004, "deg/h"), power(2.0, "deg/h"), power(5e4, "deg/h")
    ((1000.0, '10⁻³ deg/h'), (1.0, 'deg/h'), (0.001, '10³ deg/h'))
    """
    for least, factor, prefix in ((1e3, 1e-3, "10³ "), (0.1, 1.0, ""), (1e-4, 1e3, "10⁻³ ")):
        if size > least:
            return factor, f"{prefix}{unit}"
    return 1e6, f"10⁻⁶ {unit}"


def column_label(column: str) -> str:
    """A column's name as a reader would say it.

    >>> column_label("temperature_block_degC"), column_label("angular_acceleration_rad_s2")
    ('temperature block, °C', 'angular acceleration, rad/s²')
    """
    unit = display_unit(column)
    return f"{column_words(column)}, {typeset(unit)}" if unit else column.replace("_", " ")


def column_words(column: str) -> str:
    """A column's name without its unit.

    >>> column_words("gyro_x_deg_h"), column_words("humidity_percent")
    ('gyro x', 'humidity')
    """
    unit = display_unit(column)
    stem = column if not unit else re.sub("_(percent|pct)$", "", column).removesuffix("_" + unit.replace("/", "_").replace("^", ""))
    return stem.replace("_", " ")


def draw_channels(ax: Any, time_s: Array, period_s: float, columns: Mapping[str, Array], title: str) -> Any:
    """Channels against time; those of one unit share a panel where none of them becomes a flat line by it.

    Parameters
    ----------
    ax : Axes, sequence of Axes, or None
    time_s : ndarray, shape (n,)
    period_s : float
        A longer step than one and a half of it interrupts the lines.
    columns : mapping of str to ndarray, shape (n,)
    title : str
    """
    factor, label = time_axis(float(time_s[-1] - time_s[0]))
    groups = _sharing(columns)
    axes = panels(ax, [2.4, *[1.25] * (len(groups) - 1)])
    with rc_context(STYLE):
        for panel, group in zip(axes, groups, strict=False):
            unit = column_unit(group[0])
            level = max(float(np.abs(columns[column]).max()) for column in group)
            scale, scaled = power(level if 0.0 < level < 1.0 else 1.0, typeset(unit or ""))
            for k, column in enumerate(group):
                colour, name = _LINES[k % len(_LINES)], wrapped(column_words(column))
                _draw_series(panel, time_s / factor, 1.5 * period_s / factor, scale * columns[column], colour, name)
            panel.set_ylabel(scaled.strip() or "value")
            panel.ticklabel_format(axis="y", useOffset=False)
            legend(panel)
        axes[0].set_title(title)
        axes[-1].set_xlabel(label)
        return returned(axes)


def _sharing(columns: Mapping[str, Array]) -> list[list[str]]:
    """Columns that share a panel: of one unit, and each at least a tenth as wide as all of them together."""
    groups: list[list[str]] = []
    spans: list[tuple[float, float, float]] = []  # least, greatest, and smallest span of one column that is not constant
    for column, values in columns.items():
        low, high = float(values.min()), float(values.max())
        own = high - low or math.inf
        for k, group in enumerate(groups):
            least, greatest, smallest = min(low, spans[k][0]), max(high, spans[k][1]), min(own, spans[k][2])
            if column_unit(group[0]) == column_unit(column) is not None and greatest - least <= _MOST_SPANS * smallest:
                group.append(column)
                spans[k] = (least, greatest, smallest)
                break
        else:
            groups.append([column])
            spans.append((low, high, own))
    return groups


def _draw_series(axes: Axes, time: Array, gap: float, values: Array, colour: str, label: str) -> None:
    """One channel; of many samples the mean, with a band from least to greatest."""
    if len(values) <= _MOST_DOTS:
        after = np.flatnonzero(np.diff(time) > gap) + 1
        axes.plot(np.insert(time, after, np.nan), np.insert(values, after, np.nan), color=colour, lw=0.9, label=label)
        return
    edges = np.linspace(time[0], time[-1], _BINS + 1)
    starts = np.searchsorted(time, edges[:-1])
    counts = np.diff(np.r_[starts, len(values)])
    full = counts > 0
    table = np.full((3, _BINS), np.nan)
    for row, operation in enumerate((np.minimum, np.maximum, np.add)):
        table[row, full] = operation.reduceat(values, starts[full])
    middles = 0.5 * (edges[:-1] + edges[1:])
    axes.fill_between(middles, table[0], table[1], color=colour, alpha=0.3, lw=0)
    axes.plot(middles, table[2] / np.maximum(counts, 1), color=colour, lw=0.9, label=label)


def draw_deviation(
    ax: Any, tau_s: Array, deviation_deg_h: Array, interval: tuple[Array, Array], *, kind: str, confidence: float
) -> Axes:
    """An Allan or Hadamard deviation with its interval, on logarithmic axes.

    Parameters
    ----------
    ax : Axes or None
    tau_s, deviation_deg_h : ndarray, shape (m,)
    interval : (ndarray, ndarray), shape (m,) each
        Lower and upper end.
    kind : str
        "Allan deviation" or "Hadamard deviation".
    confidence : float
        Probability of the interval.
    """
    lower, upper = interval
    (axes,) = panels(ax, [3.7])
    with rc_context(STYLE):
        axes.fill_between(tau_s, lower, upper, color=RESIDUAL, alpha=0.18, lw=0, label=f"{100 * confidence:g} % interval")
        axes.plot(tau_s, deviation_deg_h, "-o", color=RESIDUAL, ms=3, lw=1.0, label=kind)
        logarithmic(axes, f"{kind} in deg/h")
        axes.set_xlim(tau_s[0] / 1.3, tau_s[-1] * 1.3)
        positive = lower[lower > 0.0]
        if len(positive):
            axes.set_ylim(0.4 * float(positive.min()), 2.0 * float(upper.max()))
        legend(axes)
        return axes


def draw_noises(ax: Any, tau_s: Array, variances: Array, texts: Sequence[str], *, misfit: bool) -> Axes:
    """The five fitted noises and their sum; the limits of axes that have a curve already stay.

    Parameters
    ----------
    ax : Axes or None
    tau_s : ndarray, shape (m,)
    variances : ndarray, shape (5, m)
        Of each noise in (deg/h)²; a noise of zero is named in the legend alone.
    texts : sequence of str
        Value and error of each coefficient, empty where the curve cannot show it.
    misfit : bool
        Whether the five noises do not describe the curve.
    """
    total = np.sqrt(variances.sum(axis=0))
    (axes,) = panels(ax, [3.7])
    with rc_context(STYLE):
        limits = (axes.get_xlim(), axes.get_ylim()) if axes.has_data() else None
        axes.plot(tau_s, total, color=INK, lw=1.4, label="five noises, fitted" + (" (they do not fit)" if misfit else ""))
        for (symbol, unit, colour), variance, text in zip(NOISES, variances, texts, strict=True):
            if variance.any():
                equals = "" if text.startswith("<") else "= "
                axes.plot(tau_s, np.sqrt(variance), color=colour, lw=1.2, ls="--", label=f"{symbol} {equals}{text} {unit}")
            elif text:
                axes.plot([], [], color=RAW, lw=0, label=f"{symbol} {text} {unit}")
        if limits is None:
            logarithmic(axes, "deviation in deg/h")
            axes.set_xlim(float(tau_s[0]), float(tau_s[-1]))
            if total.any():
                axes.set_ylim(0.2 * float(total.min()), 2.0 * float(total.max()))
        else:
            axes.set(xlim=limits[0], ylim=limits[1])
        legend(axes)
        return axes


def logarithmic(axes: Axes, label: str) -> None:
    """Logarithmic axes over the averaging time, with plain labels."""
    axes.set(xscale="log", yscale="log", xlabel="averaging time in s", ylabel=label)
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_locator(LogLocator(numticks=12))
    plain_powers(axes.xaxis, axes.yaxis)


def plain_powers(*logarithmic_axes: Axis) -> None:
    """Labels of logarithmic axes in plain characters."""
    for axis in logarithmic_axes:
        axis.set_major_formatter(Powers())
        axis.set_minor_formatter(Powers())


def draw_bars(ax: Any, names: Sequence[str], values: Array, *, label: str, unit: str, title: str) -> Axes:
    """Horizontal bars, one a name, the first at the top.

    Parameters
    ----------
    ax : Axes or None
    names : sequence of str
    values : ndarray, shape (n,)
    label : str
        Of the axis, without unit.
    unit : str
    title : str
    """
    factor, scaled = power(float(np.max(values, initial=0.0)), unit)
    axes, *_ = panels(ax, [0.5 + 0.27 * len(names)])
    with rc_context(STYLE):
        axes.barh(range(len(names)), factor * values, height=0.6, color=RESIDUAL)
        axes.set_yticks(range(len(names)), [wrapped(name, 40) for name in names])
        axes.set_ylim(len(names) - 0.4, -0.6)
        axes.grid(visible=False, axis="y")
        axes.set_xlabel(f"{label} in {scaled}")
        axes.set_title(title)
        return axes


def wrapped(name: str, letters: int = _LETTERS) -> str:
    """A name on as many lines as it needs, broken between its parts and never within one.

    >>> wrapped("temperature-cycle_2024-11-17", 12)
    'temperature-\\ncycle_2024-\\n11-17'
    """
    lines = [""]
    for part in re.findall(r"[^ _/.-]*[ _/.-]?", name):
        if lines[-1] and len(lines[-1]) + len(part.rstrip()) > letters:
            lines.append("")
        lines[-1] += part
    return "\n".join(line.rstrip(" ") for line in lines)


class Powers(LogFormatterSciNotation):
    """Labels of a logarithmic axis in plain characters, 2×10⁻³, since Matplotlib parses its own as formulas, which is slow."""

    def __call__(self, x: float, pos: int | None = None) -> str:
        label = re.sub(r"\$\\mathdefault\{(.*)\}\$", r"\1", super().__call__(x, pos))
        raised = re.sub(r"\^\{(.*?)\}", lambda found: found[1].translate(_RAISED), label)
        return raised.replace(r"\times", "×")
