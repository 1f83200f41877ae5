"""The page of a diagnosis: complete, self-contained, the data reach the drawing, and a browser shows it."""

from __future__ import annotations

import dataclasses
import re
import shutil
import subprocess
import unicodedata
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from matplotlib.figure import Figure
from matplotlib.ticker import LogFormatterSciNotation

import rlgcomp as rlg
from rlgcomp.cli.diagnosis import background_process
from rlgcomp.diagnosis.noise.whitening import NoiseShape
from rlgcomp.diagnosis.proof.before_after import prove
from rlgcomp.diagnosis.result import Alternative, Cause, Diagnosis, Estimate, NextExperiment, Place, Unexplained, pictures
from rlgcomp.diagnosis.result.channel_shares import channel_shares
from rlgcomp.diagnosis.result.page import render
from rlgcomp.report.drawing import Powers

CATALOGUE = rlg.CATALOGUE
BASE = rlg.Simulator((CATALOGUE["thermal_polynomial"](),), noise=rlg.NoiseModel(angle_random_walk_deg_sqrt_h=0.0003))
TRUE = BASE.with_mechanism(CATALOGUE["thermal_hysteresis"]())


@pytest.fixture(scope="module")
def diagnosis() -> Diagnosis:
    runs = [TRUE.simulate("short", seed=seed, step_s=5.0, name=f"run <{seed}>") for seed in (1, 2)]
    proof = prove(BASE, TRUE, runs[:1], runs[1:], window_s=100.0, shape=NoiseShape(), white_deg_h=0.0018)
    swept = CATALOGUE["thermal_hysteresis"](start="from_below")
    cause = Cause(swept, 0.9, {"radius_K": Estimate(12.0, 0.4, "K")}, 0.004, drivers=("temperature_block_degC",))
    return Diagnosis(
        verdict="explained",
        p_value=1e-20,
        where=(Place("run <1>", "gyro_deg_h", 3600.0, 5400.0, "cooling", share=0.6, p_value=1e-8),),
        causes=(cause,),
        alternatives=(Alternative(("thermal_hysteresis",), 0.9), Alternative(("thermal_lag",), 0.1)),
        unexplained=Unexplained(0.5),
        train=proof.train,
        test=proof.test,
        next_experiment=NextExperiment(("thermal_lag", "thermal_hysteresis"), "start 20, ramp 50 0.5", 0.99),
        calibrated=BASE,
        augmented=TRUE,
        noise=rlg.NoiseModel(angle_random_walk_deg_sqrt_h=0.0003),
        traces=proof.traces,
    )


@pytest.fixture(scope="module")
def page(diagnosis: Diagnosis) -> str:
    return render(diagnosis)


def test_it_needs_nothing_else_and_is_small(page: str) -> None:
    assert not re.search(r"<(script|link|img|iframe)\b", page)
    assert not re.search(r"(src|href)=[\"']?(https?:)?//", page)
    assert page.count("<svg") == 9
    assert len(page) < 1_500_000


def test_its_numbers_are_those_of_the_diagnosis(page: str, diagnosis: Diagnosis) -> None:
    for number in (diagnosis.test.baseline_rms, diagnosis.test.augmented_rms, diagnosis.test.compensation_rms):
        assert f"{number:.5f}" in page
    assert "12.00 ± 0.40 K" in page
    assert "from_below" in page  # an unusual form
    assert ">play<" not in page  # the usual one
    assert "start = from_below" in str(diagnosis)
    assert CATALOGUE["thermal_hysteresis"].equation.split("=")[1].strip()[:10] in page
    assert "start 20, ramp 50 0.5" in page


def test_it_cites_only_what_was_used(page: str) -> None:
    assert "Visintin" in page
    assert "Incropera" not in page  # thermal_lag was only an alternative


def test_text_is_escaped(page: str) -> None:
    assert "run &lt;1&gt;" in page
    assert "<1>" not in page


def test_every_verdict_has_its_page(diagnosis: Diagnosis) -> None:
    none = dataclasses.replace(
        diagnosis, verdict="none", causes=(), where=(), alternatives=(), next_experiment=None, augmented=BASE, p_value=0.4
    )
    assert "No interval, regime or frequency stands out" in render(none)
    assert "<h1>Nothing is missing that these runs show</h1>" in render(none)
    unknown = dataclasses.replace(
        none, verdict="unknown", test=None, unexplained=Unexplained(1e-9, ("light_intensity_V",), "static", "b = 2 light<br>")
    )
    page = render(unknown)
    assert "What no known mechanism explains" in page
    assert "b = 2 light&lt;br&gt;" in page
    assert "The fit: no run was held out, so this proves nothing" in page
    assert "The proof" not in page
    assert "Green band" not in page
    assert render(dataclasses.replace(unknown, traces=()))


def test_pictures_show_what_they_are_given(diagnosis: Diagnosis) -> None:
    moved = dataclasses.replace(
        diagnosis, traces=tuple(dataclasses.replace(t, after_deg_h=t.after_deg_h + 1e-3) for t in diagnosis.traces)
    )
    drawn = (pictures.timeline, pictures.loop, pictures.driver_map, pictures.held_out, pictures.what_is_left)
    for draw in drawn:
        assert draw(diagnosis) == draw(diagnosis)
    for draw in (pictures.timeline, pictures.loop, pictures.driver_map, pictures.held_out):
        assert draw(moved) != draw(diagnosis)
    elsewhere = dataclasses.replace(diagnosis, where=(dataclasses.replace(diagnosis.where[0], start_s=0.0),))
    assert pictures.timeline(elsewhere) != pictures.timeline(diagnosis)


def test_where_nothing_was_added_nothing_is_shown_twice(diagnosis: Diagnosis, page: str) -> None:
    same = tuple(dataclasses.replace(trace, after_deg_h=trace.before_deg_h) for trace in diagnosis.traces)
    none = dataclasses.replace(diagnosis, verdict="none", causes=(), alternatives=(), augmented=BASE, p_value=0.4, traces=same)
    assert diagnosis.changed
    assert not none.changed
    assert 'class="arrow"' in page
    plain = render(none)
    assert 'class="arrow"' not in plain
    assert plain.count("<svg") == 7  # no bars, and no probabilities
    for draw in (pictures.loop, pictures.driver_map, pictures.held_out):
        assert draw(none).count('id="axes_') == draw(diagnosis).count('id="axes_') - 1
    for draw in (pictures.channels, pictures.what_is_left):
        assert len(draw(none)) < len(draw(diagnosis))


def test_it_says_what_it_is_about(diagnosis: Diagnosis, tmp_path: Path) -> None:
    files = [tmp_path / name for name in ("gyro 7.yaml", "cold.parquet", "run <2>.parquet")]
    for file in files:
        file.write_text("content", encoding="utf-8")
    page = render(diagnosis.of_files(files[1:2], files[2:], files[0]))
    assert "<dt>Simulator</dt><dd>gyro 7.yaml</dd>" in page
    assert "<dt>Gyro</dt><dd>simulated, gyro_deg_h</dd>" in page
    assert f"<dt>Trained on</dt><dd>run &lt;1&gt; ({files[1]})</dd>" in page
    assert "<dt>Held out</dt><dd>run &lt;2&gt;</dd>" in page


def test_units_are_printed_as_people_write_them(diagnosis: Diagnosis) -> None:
    said = "In 48 uT at 20 degC, 3e-6 deg/h/K^2 by temperature_block_degC."
    page = render(dataclasses.replace(diagnosis, remarks=(said,)))
    assert "In 48 µT at 20 °C, 3e-6 deg/h/K² by temperature_block_degC." in page


def test_each_finding_is_drawn_less_the_others(diagnosis: Diagnosis) -> None:
    lag = Cause(CATALOGUE["thermal_lag"](), 0.9, {}, 0.004, drivers=("temperature_block_degC",))
    gradient = Cause(CATALOGUE["thermal_gradient"](), 0.9, {}, 0.004, drivers=("temperature_block_degC", "temperature_shell_degC"))
    starting = Cause(CATALOGUE["warm_up"](), 0.9, {}, 0.004)
    added = {name: np.sin(diagnosis.traces[0].time_s / 900.0) for name in ("thermal_lag", "thermal_gradient", "warm_up")}
    traces = (dataclasses.replace(diagnosis.traces[0], added_deg_h=added),)
    three = dataclasses.replace(diagnosis, causes=(lag, gradient, starting), traces=traces)
    views = pictures.views(three)
    assert [view.label for view in views] == ["temperature block, °C", "what thermal_gradient adds, 10⁻³ deg/h", "time in h"]
    assert np.array_equal(views[0].before[0], traces[0].after_deg_h + added["thermal_lag"])
    assert np.array_equal(views[2].x[0], traces[0].time_s / 3600.0)
    (alone,) = pictures.views(dataclasses.replace(three, causes=(lag,)))
    assert np.array_equal(alone.before[0], traces[0].before_deg_h)


def test_a_map_has_the_second_driver_beside_the_first(diagnosis: Diagnosis) -> None:
    """Two thermometers by their difference; nothing beside a table's rate alone, which jumps."""
    (trace, *_), (cause, *_) = diagnosis.traces, diagnosis.causes
    n = len(trace.time_s)
    monitors = trace.monitors.assign(
        pressure_hPa=np.random.default_rng(0).normal(size=n),
        table_rate_deg_s=np.arange(n) % 7.0,
        temperature_shell_degC=trace.monitors["temperature_block_degC"] + np.sin(np.arange(n)),
    )
    block = "temperature_block_degC"

    def axes_of(*drivers: str) -> tuple[np.ndarray, np.ndarray, str, str] | None:
        of_these = dataclasses.replace(cause, drivers=drivers)
        return pictures.map_axes(
            dataclasses.replace(diagnosis, causes=(of_these,), traces=(dataclasses.replace(trace, monitors=monitors),))
        )

    assert axes_of(block)[3] == "rate of change, °C/min"
    assert axes_of("pressure_hPa", block)[2:] == ("pressure, hPa", "temperature block, °C")
    _, difference, _, label = axes_of(block, "temperature_shell_degC")
    assert difference == pytest.approx(np.sin(np.arange(n)))
    assert label == "temperature shell\nless temperature block, °C"
    assert axes_of("table_rate_deg_s") is None
    assert axes_of("table_rate_deg_s", block)[3] == "temperature block, °C"


def test_shares_of_channels_know_what_chance_gives(diagnosis: Diagnosis) -> None:
    rng = np.random.default_rng(0)
    trace = diagnosis.traces[0]
    n = len(trace.time_s)
    monitors = trace.monitors.assign(idle=rng.normal(size=n))
    follows = dataclasses.replace(
        trace, monitors=monitors, before_deg_h=monitors["light_intensity_V"].to_numpy() - 1.0, after_deg_h=rng.normal(size=n)
    )
    shares = channel_shares([follows], diagnosis.noise, 100.0).set_index("channel")
    assert shares["before"].idxmax() == "light_intensity_V"
    assert shares.loc["light_intensity_V", "before"] > 0.9
    assert shares["after"].max() < 0.2
    assert shares.loc["idle", "before"] < 0.2


def test_what_noise_alone_reaches_is_marked(diagnosis: Diagnosis) -> None:
    """Of noise drawn anew, one in twenty goes beyond the mark; slow noise goes with a slow channel, white noise with none."""
    n = 400
    slow = np.cumsum(np.random.default_rng(1).normal(size=n))
    marks = {}
    for name, noise in (("white", rlg.NoiseModel(0.0003)), ("slow", rlg.NoiseModel(0.0003, rate_random_walk_deg_h_sqrt_h=0.002))):
        beyond = []
        for seed in range(100):
            left = sum(noise.simulate(n, 100.0, 5000 + seed).values())
            trace = dataclasses.replace(
                diagnosis.traces[0],
                time_s=100.0 * np.arange(n),
                before_deg_h=left,
                after_deg_h=left,
                monitors=pd.DataFrame({"pressure_hPa": slow}),
            )
            (row,) = channel_shares([trace], noise, 100.0).to_dict("records")
            beyond.append(row["after"] > row["noise"])
        marks[name] = row["noise"]
        assert 0.0 < np.mean(beyond) < 0.13
    assert marks["white"] < 0.05
    assert marks["slow"] > 0.3
    assert "noise alone" in pictures.channels(diagnosis)


def test_the_chosen_set_has_its_own_probability_and_no_more(diagnosis: Diagnosis) -> None:
    others = tuple(Alternative((f"other_{k}",), 0.05 if k < 4 else 1e-5) for k in range(8))
    half = dataclasses.replace(diagnosis, verdict="explained", alternatives=others, probability=0.5)
    names, shares = zip(*pictures.likely_sets(half), strict=True)
    assert shares == pytest.approx((0.5, 0.05, 0.05, 0.05, 0.05, 0.3))
    assert names[-1] == ("any other set",)
    assert pictures.likely_sets(dataclasses.replace(half, probability=None))[0][1] == pytest.approx(0.8, abs=1e-3)


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
    pictures_shown, empty, overflow, empty_tables = (int(number) for number in seen.groups())
    assert pictures_shown == 9
    assert (empty, empty_tables) == (0, 0)
    assert overflow <= 0


def test_powers_are_those_of_matplotlib_in_plain_characters() -> None:
    axes = Figure().subplots()
    axes.set_yscale("log")
    for low, high, expected in ((1e-4, 5e-2, "10⁻³"), (0.2, 3000.0, "10²"), (1.5e-3, 8e-3, "2×10⁻³")):
        axes.set_ylim(low, high)
        values = np.sort(np.r_[axes.yaxis.get_majorticklocs(), axes.yaxis.get_minorticklocs()])
        plain, theirs = Powers(), LogFormatterSciNotation()
        for formatter in (plain, theirs):
            formatter.set_axis(axes.yaxis)
            formatter.set_locs(values)
        said = [plain(value) for value in values]
        assert expected in said
        for one, other in zip(said, (theirs(value) for value in values), strict=True):
            normal = unicodedata.normalize("NFKC", one).replace("−", "-")
            assert normal == re.sub(r"[${}^]|\\mathdefault", "", other).replace(r"\times", "×")


def test_the_second_process_draws_the_same_page(diagnosis: Diagnosis) -> None:
    with background_process(["rlgcomp.diagnosis.result.page"]) as other:
        assert render(diagnosis, other) == render(diagnosis)
