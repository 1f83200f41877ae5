"""The page of a diagnosis: complete, self-contained, its names escaped, and a browser shows it."""

from __future__ import annotations

import dataclasses
import re
import shutil
import subprocess
from pathlib import Path

import pytest

import rlgcomp as rlg
from rlgcomp.diagnosis.decide import Decision
from rlgcomp.diagnosis.report.page import render
from rlgcomp.report.messages import message
from tests.few_monitors import few_monitors

VOLTAGE = rlg.CATALOGUE["supply_voltage"](k_deg_h_V=0.5)
BASE = rlg.Simulator((rlg.CATALOGUE["thermal_polynomial"](),), noise=rlg.NoiseModel(angle_random_walk_deg_sqrt_h=0.0005))


@pytest.fixture(scope="module")
def diagnosis() -> rlg.Diagnosis:
    true = BASE.with_mechanism(VOLTAGE)
    runs = [few_monitors(true.simulate("short", seed=seed, step_s=20.0, name=f"run <{seed}>")) for seed in (1, 2)]
    return rlg.diagnose(BASE, runs[:1], runs[1:], only=["supply_voltage"])


@pytest.fixture(scope="module")
def page(diagnosis: rlg.Diagnosis) -> str:
    return render(diagnosis)


def test_it_needs_nothing_else_and_is_small(page: str) -> None:
    assert not re.search(r"<(script src|link|img|iframe)\b", page)
    assert not re.search(r"(src|href)=[\"']?(https?:)?//", page)
    assert page.count("<svg") >= 2
    assert len(page) < 1_500_000


def test_its_numbers_are_those_of_the_diagnosis(page: str, diagnosis: rlg.Diagnosis) -> None:
    assert diagnosis.test is not None
    for number in (diagnosis.test.baseline_rms, diagnosis.test.augmented_rms):
        assert f"{number:.5f}" in page
    assert VOLTAGE.reference.split(",")[0] in page
    assert rlg.CATALOGUE["thermal_lag"].reference not in page  # not used


def test_names_are_escaped(page: str) -> None:
    assert "run &lt;1&gt;" in page
    assert "<1>" not in page


def test_units_are_printed_as_people_write_them(diagnosis: rlg.Diagnosis) -> None:
    remark = message("diagnosis.other_form", mechanism="x", equation="48 uT at 20 degC, 3e-6 deg/h/K^2 by temperature_block_degC")
    assert "48 µT at 20 °C, 3e-6 deg/h/K² by temperature_block_degC" in render(dataclasses.replace(diagnosis, warnings=(remark,)))


def test_a_page_without_findings_shows_less(diagnosis: rlg.Diagnosis, page: str) -> None:
    none = dataclasses.replace(diagnosis, decision=Decision("none", ()), after=diagnosis.before, test_runs=())
    plain = render(none)
    assert "<h1>Nothing is missing that the training runs show</h1>" in plain
    assert plain.count("<svg") < page.count("<svg")


@pytest.mark.parametrize("width", [420, 1280])
def test_a_browser_shows_it(page: str, tmp_path: Path, width: int) -> None:
    browser = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    if browser is None:
        pytest.skip("no Chromium on this machine (Debian: apt-get install chromium)")
    probe = (
        "<script>const boxes = [...document.querySelectorAll('figure svg')].map(svg => svg.getBoundingClientRect());"
        "document.title = ['seen', boxes.length, boxes.filter(box => box.width < 300 || box.height < 60).length, "
        "document.documentElement.scrollWidth - window.innerWidth, "
        "[...document.querySelectorAll('table')].filter(table => table.rows.length < 2).length].join(' ');</script></body>"
    )
    file = tmp_path / "report.html"
    file.write_text(page.replace("</body>", probe), encoding="utf-8")
    options = [
        "--headless",
        "--no-sandbox",
        "--disable-gpu",
        f"--user-data-dir={tmp_path / 'profile'}",
        f"--window-size={width},900",
    ]
    done = subprocess.run([browser, *options, "--dump-dom", file.as_uri()], capture_output=True, text=True, timeout=120, check=True)
    seen = re.search(r"<title>seen (\d+) (\d+) (-?\d+) (\d+)</title>", done.stdout)
    assert seen is not None
    shown, empty, overflow, empty_tables = (int(number) for number in seen.groups())
    assert shown == page.count("<svg")
    assert (empty, empty_tables) == (0, 0)
    assert overflow <= 0
