"""The report: one self-contained page, looked at by a browser."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure

import rlgcomp as rlg
from rlgcomp.evaluation import figures
from rlgcomp.evaluation.evaluation import Trace
from rlgcomp.evaluation.page import render, write_report
from rlgcomp.report.svg import svg

# Put into a copy of the page, it writes into the title what a browser made of it.
PROBE = """<script>
const boxes = [...document.querySelectorAll('figure svg')].map(svg => svg.getBoundingClientRect());
document.title = JSON.stringify({
  pictures: boxes.length,
  empty: boxes.filter(box => box.width < 300 || box.height < 80).length,
  overflow: document.documentElement.scrollWidth - window.innerWidth,
  tables: document.querySelectorAll('table').length,
  emptyTables: [...document.querySelectorAll('table')].filter(table => table.rows.length < 2).length,
  resources: performance.getEntriesByType('resource').length,
  text: document.querySelector('.headline').innerText,
});
</script></body>"""


@pytest.fixture(scope="module")
def evaluation(trained: rlg.Compensator, short_runs: list[rlg.Recording]) -> rlg.Evaluation:
    return rlg.evaluate(trained, short_runs[2:])


@pytest.fixture(scope="module")
def page(evaluation: rlg.Evaluation, trained: rlg.Compensator, short_runs: list[rlg.Recording]) -> str:
    return render(evaluation, trained, title="Unit <1> & co", simulated=short_runs[2:])


def test_it_is_self_contained(page: str) -> None:
    assert not re.search(r"<(script src|link|img|iframe)\b", page)
    assert not re.search(r"(src|href)=[\"']?(https?:)?//", page)
    assert page.count("<svg") >= 6


def test_text_is_escaped(page: str) -> None:
    assert "Unit &lt;1&gt; &amp; co" in page
    assert "<1>" not in page


def test_its_numbers_are_those_of_the_evaluation(page: str, evaluation: rlg.Evaluation) -> None:
    assert f"{evaluation.raw_std_deg_h:.5f}" in page
    assert f"{evaluation.residual_std_deg_h:.5f}" in page
    assert f"{evaluation.runs[0].noise_floor_deg_h:.5f}" in page


def test_page_and_data_are_written_together(evaluation: rlg.Evaluation, trained: rlg.Compensator, tmp_path: Path) -> None:
    write_report(tmp_path, evaluation, trained)
    assert {item.name for item in tmp_path.iterdir()} == {"report.html", "evaluation.json", "figures"}
    assert json.loads((tmp_path / "evaluation.json").read_text())["runs"][0]["run"] == "short-3"


def test_recordings_without_notes_unit_and_latitude_have_their_page(
    trained: rlg.Compensator, short_runs: list[rlg.Recording], tmp_path: Path
) -> None:
    bare = [rlg.recording(run.table) for run in short_runs]
    assert not bare[2].metadata.notes
    model = rlg.Compensator(rlg.CubicLeastSquares(), features="light_intensity").fit(bare[:2])
    write_report(tmp_path, rlg.evaluate(model, bare[2:], compare=False), model, tested=[run.metadata for run in bare[2:]])
    assert "not stated" in (tmp_path / "report.html").read_text(encoding="utf-8")


def test_the_same_evaluation_gives_the_same_picture(evaluation: rlg.Evaluation) -> None:
    trace = evaluation.traces[0]
    assert figures.over_time(trace, 0.002) == figures.over_time(trace, 0.002)


def test_a_run_without_thermometer_has_its_pictures(trained: rlg.Compensator, short_runs: list[rlg.Recording]) -> None:
    bare = [run.replace(table=run.table[["time_s", "gyro_deg_h", "light_intensity_V"]]) for run in short_runs]
    model = rlg.Compensator(rlg.CubicLeastSquares(), features="light_intensity").fit(bare[:2])
    assert "<svg" in render(rlg.evaluate(model, bare[2:], compare=False), model)


@pytest.mark.parametrize("width", [420, 1280])
def test_a_browser_shows_it(page: str, tmp_path: Path, width: int) -> None:
    browser = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    if browser is None:
        pytest.skip("no Chromium on this machine (Debian: apt-get install chromium)")
    file = tmp_path / "report.html"
    file.write_text(page.replace("</body>", PROBE), encoding="utf-8")
    options = [
        "--headless",
        "--no-sandbox",
        "--disable-gpu",
        "--disable-background-networking",
        f"--user-data-dir={tmp_path / 'profile'}",
    ]
    command = [browser, *options, f"--window-size={width},900", "--dump-dom", file.as_uri()]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=True)
    title = re.search(r"<title>(.*?)</title>", done.stdout, re.DOTALL)
    seen = json.loads(title.group(1).replace("&lt;", "<").replace("&gt;", ">").replace("&amp;", "&"))
    assert seen["pictures"] >= 6
    assert (seen["empty"], seen["emptyTables"], seen["resources"]) == (0, 0, 0)
    assert seen["tables"] >= 4
    assert seen["overflow"] <= 0
    assert "noise floor" in seen["text"]


def test_pictures_show_what_they_are_given(evaluation: rlg.Evaluation) -> None:
    """Another residual is another picture: the data reach the drawing."""
    trace = evaluation.traces[0]
    moved = Trace(
        trace.run,
        trace.time_s,
        trace.raw_deg_h + np.linspace(0, 0.05, len(trace.time_s)),
        trace.bias_deg_h,
        trace.temperature_degC,
        trace.allan_raw,
        trace.allan_residual,
    )
    assert figures.over_time(moved, 0.002) != figures.over_time(trace, 0.002)
    assert figures.loop(moved) != figures.loop(trace)


def test_a_dollar_sign_in_a_name_is_no_formula() -> None:
    figure = Figure()
    axes = figure.add_subplot()
    axes.loglog([1.0, 100.0], [1.0, 100.0], label="gyro_$x^{_deg_h")
    axes.set_title("run $a^{")
    axes.legend()
    assert "<svg" in svg(figure)
