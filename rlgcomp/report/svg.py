"""Figures as SVG: text that can be read and searched, a title, a description, and what a page's viewer needs to zoom and hover.

The viewer (`viewer.js`) reads the attribute `data-axes`: the place of each axes in the drawing, its limits, and the elements that
show data. Without it the drawing is complete.
"""

from __future__ import annotations

import contextlib
import dataclasses
import html
import io
import json
import re
from collections.abc import Iterator
from typing import Any, Final

from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.collections import PathCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Rectangle
from matplotlib.text import Text
from matplotlib.ticker import FixedFormatter, FuncFormatter, NullFormatter

from rlgcomp.report.page import Picture

_POINTS_PER_INCH: Final = 72.0
_FONTS: Final = "'DejaVu Sans', Verdana, 'Segoe UI', sans-serif"  # Verdana has the widths of DejaVu Sans
_REFERENCE: Final = re.compile(r'( id="|url\(#|href="#)')


def picture(figure: Figure, name: str, title: str, description: str) -> Picture:
    """The picture of a Matplotlib figure.

    Parameters
    ----------
    figure : Figure
    name, title, description : str
        As of :class:`~rlgcomp.report.page.Picture`; what a file may not be named is replaced.
    """
    name = re.sub(r"[^A-Za-z0-9_.-]+", "-", name).strip("-") or "figure"
    return Picture(name, title, description, svg(figure, name, title, description))


def svg(figure: Figure, name: str = "figure", title: str = "", description: str = "") -> str:
    """The figure as SVG text.

    Parameters
    ----------
    figure : Figure
    name : str
        Beginning of the identifiers, so that a page may hold several figures.
    title, description : str
    """
    names_as_they_are(figure)
    marked = [_Marked.of(axes, f"a{k}") for k, axes in enumerate(figure.axes)]
    buffer = io.StringIO()
    with rc_context({"svg.fonttype": "none", "svg.hashsalt": name}), _laid_out(figure):
        figure.savefig(buffer, format="svg", metadata={"Date": None, "Creator": None, "Type": None, "Format": None})
    text = buffer.getvalue()
    text = text[text.index("<svg") :].replace("'DejaVu Sans'", _FONTS)
    text = _REFERENCE.sub(rf"\1{name}.", text)
    axes = [entry for one in marked if (entry := one.entry(figure)) is not None]
    head, body = text.split(">", 1)
    spoken = (
        f' role="img" aria-labelledby="{name}.title {name}.desc" data-name="{name}" '
        f'data-axes="{html.escape(json.dumps(axes, ensure_ascii=False, separators=(",", ":")))}">'
        f'<title id="{name}.title">{html.escape(title)}</title><desc id="{name}.desc">{html.escape(description)}</desc>'
    )
    return head + spoken + body


@contextlib.contextmanager
def _laid_out(figure: Figure) -> Iterator[None]:
    """The figure as its layout engine places it, then without the engine, for which `savefig` draws everything twice."""
    engine, dpi, canvas = figure.get_layout_engine(), figure.dpi, figure.canvas
    if engine is None:
        yield
        return
    FigureCanvasSVG(figure)  # it measures the texts as they are drawn
    figure.dpi = _POINTS_PER_INCH
    engine.execute(figure)
    figure.dpi = dpi
    figure.set_canvas(canvas)
    with rc_context({"figure.autolayout": False, "figure.constrained_layout.use": False}):
        figure.set_layout_engine(None)  # "none" would leave an engine that does nothing, and the drawing in vain
    try:
        yield
    finally:
        figure.set_layout_engine(engine)


@dataclasses.dataclass(frozen=True)
class _Marked:
    """Axes whose elements bear names in the SVG."""

    axes: Axes
    name: str
    moved: list[str]
    series: list[list[str]]
    texts: list[tuple[str, Text]]

    @classmethod
    def of(cls, axes: Axes, name: str) -> _Marked:
        axes.set_gid(name)
        axes.xaxis.set_gid(f"{name}x")
        axes.yaxis.set_gid(f"{name}y")
        labels = {id(patch): str(bars.get_label()) for bars in axes.containers for patch in _patches(bars)}
        moved, series, texts = [], [], []
        for k, artist in enumerate([*axes.collections, *axes.lines, *axes.patches, *axes.images]):
            artist.set_gid(f"{name}d{k}")
            moved.append(f"{name}d{k}")
            label = labels.get(id(artist), str(artist.get_label()))
            bar = isinstance(artist, Rectangle) and id(artist) in labels
            if bar or isinstance(artist, Line2D | PathCollection):
                series.append([f"{name}d{k}", "" if label.startswith("_") else label])
        for k, text in enumerate(axes.texts):
            text.set_gid(f"{name}t{k}")
            if text.get_transform() == axes.transData:
                texts.append((f"{name}t{k}", text))
        return cls(axes, name, moved, series, texts)

    def entry(self, figure: Figure) -> dict[str, Any] | None:
        """What the viewer needs; None of axes without data. To be called once the figure is laid out."""
        axes = self.axes
        if not axes.axison or not self.moved or axes.get_label() == "<colorbar>":
            return None
        width, height = (float(size) * _POINTS_PER_INCH for size in figure.get_size_inches())
        box = axes.get_position()
        labels = [axis.get_label().get_text() for axis in (axes.xaxis, axes.yaxis)]
        kinds = ["names" if _names(axis) else axis.get_scale() for axis in (axes.xaxis, axes.yaxis)]
        corners = (box.x0 * width, (1.0 - box.y0) * height, box.x1 * width, (1.0 - box.y1) * height)
        return {
            "id": self.name,
            "box": [round(value, 3) for value in corners],  # left, bottom, right, top, y downwards
            "x": {"limits": _limits(axes.get_xlim()), "kind": kinds[0], "label": labels[0] or _shared_label(axes)},
            "y": {"limits": _limits(axes.get_ylim()), "kind": kinds[1], "label": labels[1]},
            "moved": self.moved,
            "series": self.series,
            "texts": [[name, *_place(text, axes, figure)] for name, text in self.texts],
        }


def _patches(container: Any) -> Iterator[Any]:
    yield from getattr(container, "patches", ())


def _names(axis: Any) -> bool:
    """Whether the places on an axis are names, as of bars."""
    return isinstance(axis.get_major_formatter(), FixedFormatter | FuncFormatter | NullFormatter) or not len(
        axis.get_majorticklocs()
    )


def _limits(pair: tuple[float, float]) -> list[float]:
    return [float(f"{value:.9g}") for value in pair]


def _shared_label(axes: Axes) -> str:
    """The label of the axis that axes share with those below them."""
    siblings = axes.get_shared_x_axes().get_siblings(axes)
    return next((one.get_xlabel() for one in siblings if one.get_xlabel()), "")


def _place(text: Text, axes: Axes, figure: Figure) -> tuple[float, float]:
    x, y = axes.transData.transform(text.get_position()) * _POINTS_PER_INCH / figure.dpi
    return round(float(x), 2), round(float(figure.get_size_inches()[1]) * _POINTS_PER_INCH - float(y), 2)


def names_as_they_are(figure: Any) -> None:
    """Take a dollar sign in the name of a run or a column for one, not for the beginning of a formula."""
    for text in _texts(figure):
        if "$" in text.get_text() and "\\mathdefault" not in text.get_text():
            text.set_parse_math(False)


def _texts(artist: Any) -> Iterator[Text]:
    """Texts of a figure; of an axis with numbers for labels its name alone, since looking at the labels would make all of them."""
    if isinstance(artist, Axis) and not isinstance(artist.get_major_formatter(), FixedFormatter | FuncFormatter):
        yield artist.label
    elif isinstance(artist, Text):
        yield artist
    else:
        for child in artist.get_children():
            yield from _texts(child)


def png(figure: Figure) -> bytes:
    """The figure as PNG."""
    names_as_they_are(figure)
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", metadata={"Software": None})
    return buffer.getvalue()
