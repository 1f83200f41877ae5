"""Pages and their figures: titles, descriptions, units, texts inside of their drawing, contrast, contents, the order of remarks."""

from __future__ import annotations

import io
import json
import re
from collections import Counter
from html import unescape
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pandas as pd
import pytest
from matplotlib import rc_context
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.text import Text

from rlgcomp.diagnosis.answer.scores import RunScore, Score
from rlgcomp.diagnosis.report.pictures import draw_scores, scores
from rlgcomp.report import page as pages
from rlgcomp.report.drawing import STYLE, WIDTH_IN, draw_bars, legend, wrapped
from rlgcomp.report.messages import CATALOGUE, message
from rlgcomp.report.messages.consequence import DECISIVE, LIMITING, by_consequence, level
from rlgcomp.report.page import Picture, Results, Section, in_words, is_page
from rlgcomp.report.svg import picture, svg

SVG = "{http://www.w3.org/2000/svg}"
LONG = "temperature-cycle_unit-0017_chamber-B_2024-11-17_second-attempt_with-the-new-thermometer_rev.C-final"
AA = 4.5
MADE = {"version": "1", "date": "2024-01-01T00:00:00+00:00", "command": "allan x", "seed": None, "inputs": {"x.csv": "ab" * 32}}


def example(name: str = "example") -> Picture:
    with rc_context(STYLE):
        figure = Figure(figsize=(WIDTH_IN, 3.0), layout="constrained")
        axes = figure.subplots()
        axes.plot([0.0, 1.0], [1.0, 2.0], "-o", label="a < b")
        axes.axhline(1.5, ls="--", label="limit")
        axes.set(xlabel="time in h", ylabel="deg/h", title="Example")
        legend(axes)
        return picture(figure, name, "An <example>", "A line in deg/h against time in h; dashed: the limit")


def results() -> Results:
    table = pd.DataFrame({"quantity": ["N"], "value": ["0.1 deg/√h"]})
    sections = (Section("One", (example("one"), table)), Section("Two", (example("two"), "a note")))
    remarks = tuple(message("evaluation.trained_on", run=f"run{k}") for k in range(5))
    facts = (("Next", "do <this>"),)
    return Results("A title", "test", "An answer.", (("1", "deg/h"),), facts, sections, remarks, "beside", "verdict")


class TestFigures:
    def test_an_svg_has_a_title_a_description_and_texts(self) -> None:
        root = ElementTree.fromstring(example().svg)  # noqa: S314  made here
        assert root.get("role") == "img"
        title, description = root.find(f"{SVG}title"), root.find(f"{SVG}desc")
        assert title is not None
        assert description is not None
        assert root.get("aria-labelledby") == f"{title.get('id')} {description.get('id')}"
        assert title.text == "An <example>"
        texts = {"".join(one.itertext()).strip() for one in root.iter(f"{SVG}text")}
        assert {"time in h", "deg/h", "Example", "a < b", "limit"} <= texts

    def test_a_figure_that_is_drawn_once_is_laid_out_as_by_matplotlib(self) -> None:
        figure = Figure(figsize=(WIDTH_IN, 4.0), layout="constrained")
        for axes in figure.subplots(2, 1, sharex=True):
            axes.loglog([1.0, 30.0], [2e-5, 3e-4], label="a line")
            axes.set(xlabel="time in s", ylabel="deg/h", title="Example")
            legend(axes)
        buffer, options = io.StringIO(), {"svg.fonttype": "none", "svg.hashsalt": "x"}
        with rc_context(options):
            drawn = svg(figure, "x")
            assert isinstance(figure.get_layout_engine(), ConstrainedLayoutEngine)
            figure.savefig(buffer, format="svg")
        paths = [re.findall(r'<path d="([^"]+)"', text) for text in (drawn, buffer.getvalue())]
        assert paths[0] == paths[1]

    def test_the_viewer_knows_place_limits_and_units_of_the_axes(self) -> None:
        root = ElementTree.fromstring(example().svg)  # noqa: S314  made here
        (axes,) = json.loads(str(root.get("data-axes")))
        left, bottom, right, top = axes["box"]
        width, height = (float(part) for part in str(root.get("viewBox")).split()[2:])
        assert 0.0 <= left < right <= width
        assert 0.0 <= top < bottom <= height
        assert (axes["x"]["label"], axes["y"]["label"]) == ("time in h", "deg/h")
        names = {one.get("id") for one in root.iter()}
        assert all(f"example.{name}" in names for name in axes["moved"])
        assert axes["series"][0][1] == "a < b"

    def test_the_viewer_is_small(self) -> None:
        assert len(pages.script().encode()) < 10_000

    def test_a_long_name_is_broken_and_never_cut(self) -> None:
        lines = wrapped(LONG, 40).split("\n")
        assert "".join(lines) == LONG
        assert max(map(len, lines)) <= 40

    @pytest.mark.parametrize("runs", [1, 3])
    def test_names_of_runs_lie_within_the_drawing_of_their_errors(self, runs: int) -> None:
        one = RunScore(LONG, 0.004, 0.002, 0.0015, 0.004, 0.002, 0.5, (0.4, 0.6), 0.0025)
        each = tuple(one for _ in range(runs))
        both = (0.4, 0.6)
        score = Score(0.004, 0.002, 0.0015, "deg/h", 100.0, 0.5, both, 0.004, 0.002, 0.5, both, each)
        assert "deg/h" in scores(score).svg
        with rc_context(STYLE):
            figure = Figure(figsize=(WIDTH_IN, 1.0 + 1.3 * (1 + runs)), layout="constrained")
            draw_scores(figure.subplots(), score)
            require_texts_inside(figure)
            assert LONG in "".join(text.get_text() for text in figure.axes[0].texts).replace("\n", "")

    def test_names_of_bars_lie_within_their_drawing(self) -> None:
        with rc_context(STYLE):
            figure = Figure(figsize=(WIDTH_IN, 2.5), layout="constrained")
            draw_bars(figure.subplots(), [LONG, "b"], np.array([1.0, 2.0]), label="rms", unit="deg/h", title="Bars")
            require_texts_inside(figure)


def require_texts_inside(figure: Figure) -> None:
    figure.canvas.draw()
    texts = [text for text in figure.findobj(Text) if text.get_text() and text.get_visible()]
    ticks = {id(label) for axes in figure.axes for axis in (axes.xaxis, axes.yaxis) for label in axis.get_ticklabels()}
    for text in texts:
        box = text.get_window_extent()
        if id(text) not in ticks:
            assert box.x0 >= -1.0, text
            assert box.x1 <= figure.bbox.x1 + 1.0, text


class TestPage:
    def test_contents_lead_to_sections_and_identifiers_are_unique(self) -> None:
        page = results().render(MADE)
        identifiers = Counter(re.findall(r'\sid="([^"]+)"', page))
        assert {name for name, count in identifiers.items() if count > 1} == set()
        links = re.findall(r'<a href="#([^"]+)"', page)
        assert {"one", "two", "remarks", "test-record"} <= set(links) <= set(identifiers)

    def test_the_answer_comes_before_all_sections(self) -> None:
        page = results().render(MADE)
        places = [
            page.index(part) for part in ("<h1>A title</h1>", "An answer.", "do &lt;this&gt;", 'class="remarks"', "<section>")
        ]
        assert places == sorted(places)

    def test_three_remarks_stand_beside_the_answer_and_the_others_are_folded(self) -> None:
        page = results().render(MADE)
        header = page[: page.index("</header>")]
        assert header.count('<li class="decisive">') == 3
        assert "All 5 remarks" in header
        assert "<details" in page[page.index('id="remarks"') :]

    def test_the_record_of_the_test_names_files_command_and_versions(self) -> None:
        page = unescape(results().render(MADE, files=[("read", "x.csv", "ab" * 32)]))
        for part in ("Operator", "Latitude", "allan x", "rlgcomp 1", "numpy", "ab" * 32):
            assert part in page

    def test_it_needs_nothing_from_elsewhere_and_is_readable_without_its_script(self) -> None:
        page = results().render(MADE)
        assert not re.search(r"<(script src|link|img|iframe)\b", page)
        bare = re.sub(r"<script>.*?</script>", "", page, flags=re.DOTALL)
        assert bare.count("<svg") == bare.count("<figcaption>") == 2

    def test_tables_have_heads_with_a_scope(self) -> None:
        page = results().render(MADE)
        assert page.count("<th ") == page.count('<th scope="col"')

    def test_a_page_is_known_as_such(self, tmp_path: Path) -> None:
        results().write(tmp_path / "page.html", MADE, figures=tmp_path / "figures")
        assert is_page(tmp_path / "page.html")
        assert {path.name for path in (tmp_path / "figures").iterdir()} == {"one.svg", "two.svg"}
        (tmp_path / "other.html").write_text("<!doctype html><p>mine</p>")
        assert not is_page(tmp_path / "other.html")
        assert not is_page(tmp_path / "absent.html")

    def test_names_are_words_and_columns_stay(self) -> None:
        assert in_words("light_intensity and light_intensity_V", ["light_intensity"]) == "light intensity and light_intensity_V"


@pytest.mark.parametrize("dark", [False, True])
def test_texts_contrast_with_their_grounds(dark: bool) -> None:
    """WCAG 2.1, level AA: 4.5 for texts of usual size."""
    style = pages.resource("style.css")
    roots = re.findall(r":root \{(.*?)\}", style, flags=re.DOTALL)
    colours = dict(re.findall(r"--([a-z-]+): (#[0-9a-f]{3,6})", roots[1] if dark else roots[0]))
    for ink in ("ink", "soft", "link", "good"):
        for ground in ("page", "card"):
            assert contrast(colours[ink], colours[ground]) >= AA, (ink, ground)
    for ground in ("warn", "bad", "badge"):
        assert contrast(colours["ink"], colours[ground]) >= AA, ground


def contrast(one: str, other: str) -> float:
    high, low = sorted((luminance(one), luminance(other)), reverse=True)
    return (high + 0.05) / (low + 0.05)


def luminance(colour: str) -> float:
    digits = colour[1:] if len(colour) == 7 else "".join(2 * digit for digit in colour[1:])
    parts = np.array([int(digits[k : k + 2], 16) for k in (0, 2, 4)]) / 255.0
    linear = np.where(parts <= 0.04045, parts / 12.92, ((parts + 0.055) / 1.055) ** 2.4)
    return float(linear @ np.array([0.2126, 0.7152, 0.0722]))


def test_remarks_are_ordered_by_consequence() -> None:
    assert set(CATALOGUE) >= DECISIVE | LIMITING
    assert not DECISIVE & LIMITING
    note, limit = message("diagnosis.confirmed", runs=["a"]), message("diagnosis.null_possible", probability=0.1)
    decisive = message("evaluation.trained_on", run="a")
    assert [level(one) for one in by_consequence([note, limit, decisive, note])] == ["decisive", "limiting", "note", "note"]
