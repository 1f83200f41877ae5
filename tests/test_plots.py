"""Pictures in Python: `.plot` of recordings and results, on axes of one's own or of a new figure; results in a notebook."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
import pandas as pd
import pytest
from matplotlib import pyplot
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb

import rlgcomp as rlg
from tests.two_hour_runs import BASELINE, REAL, runs_of

DARK = 0.25  # luminance of a text
GYRO = rlg.simulated_unit(1)


@pytest.fixture(autouse=True)
def _without_display() -> Iterator[None]:
    with mpl.rc_context({"backend": "agg"}):
        pyplot.switch_backend("agg")
        yield
        pyplot.close("all")


@pytest.fixture(scope="module")
def runs() -> list[rlg.Recording]:
    return [GYRO.simulate("short", seed=seed, step_s=10.0) for seed in (1, 2, 3)]


@pytest.fixture(scope="module")
def model(runs: list[rlg.Recording]) -> rlg.Compensator:
    return rlg.Compensator(rlg.CubicLeastSquares(), features="all").fit(runs[:2])


@pytest.fixture(scope="module")
def evaluation(runs: list[rlg.Recording], model: rlg.Compensator) -> rlg.Evaluation:
    return rlg.evaluate(model, runs[2:], compare=False)


@pytest.fixture(scope="module")
def diagnosis() -> rlg.Diagnosis:
    """Of a gyro of little else: what is drawn is the matter."""
    *train, test = runs_of(REAL)
    return rlg.diagnose(BASELINE, train=train, test=[test], only=["supply_voltage"], window_s=80.0, black_box=False)


@pytest.fixture(scope="module")
def shown(runs: list[rlg.Recording], model: Any, evaluation: Any, diagnosis: Any) -> dict[str, Any]:
    deviation = rlg.allan_deviation(runs[0])
    return {
        "recording": runs[0],
        "deviation": deviation,
        "noise": deviation.noise(),
        "analysis": rlg.analyse_noise(runs[0]),
        "evaluation": evaluation,
        "compensator": model,
        "diagnosis": diagnosis,
    }


# Object, panels, and words that axes carry
PICTURES = [
    ("recording", 7, ("10⁻³ deg/h", "°C", "V", "mA", "µT", "hPa", "time in h")),
    ("deviation", 1, ("averaging time in s", "Allan deviation in deg/h")),
    ("noise", 1, ("averaging time in s", "deviation in deg/h")),
    ("analysis", 1, ("averaging time in s", "Allan deviation in deg/h")),
    ("evaluation", 3, ("10⁻³ deg/h", "°C", "time in h")),
    ("compensator", 1, ("rms of the bias that the input makes in training in 10⁻³ deg/h",)),
    ("diagnosis", 3, ("10⁻³ deg/h", "time in h", "supply voltage, V", "s means in 10⁻³ deg/h")),
]


def texts(axes: Axes) -> list[Any]:
    """Title, labels and those labels of ticks that lie within the limits: others are not drawn."""
    ticks = [
        label
        for axis in (axes.xaxis, axes.yaxis)
        for place, label in zip(axis.get_majorticklocs(), axis.get_majorticklabels(), strict=False)
        if min(axis.get_view_interval()) <= place <= max(axis.get_view_interval())
    ]
    return [axes.title, axes.xaxis.label, axes.yaxis.label, *ticks]


@pytest.mark.parametrize(("name", "count", "words"), PICTURES, ids=[name for name, *_ in PICTURES])
def test_a_picture_has_units_dark_texts_and_nothing_over_its_legends(
    name: str, count: int, words: tuple[str, ...], shown: dict[str, Any]
) -> None:
    returned = shown[name].plot()
    axes = [returned] if isinstance(returned, Axes) else list(returned)
    assert len(axes) == count
    figure = axes[0].figure
    figure.canvas.draw()
    labels = {text.get_text() for each in axes for text in (each.xaxis.label, each.yaxis.label)}
    assert all(any(word in label for label in labels) for word in words), labels
    for each in axes:
        for text in texts(each):
            assert np.dot(to_rgb(text.get_color()), (0.2126, 0.7152, 0.0722)) < DARK, text
        written = [text.get_window_extent() for text in texts(each)[1:] if text.get_text() and text.get_visible()]
        legend = each.get_legend()
        if legend is not None:
            place = legend.get_window_extent()
            assert not any(place.overlaps(box) for box in written)
            assert place.x1 <= figure.bbox.x1 + 1


@pytest.mark.parametrize("name", [name for name, *_ in PICTURES])
def test_one_axes_gets_the_first_panel_and_no_figure_is_made(name: str, shown: dict[str, Any]) -> None:
    figure, axes = pyplot.subplots()
    assert shown[name].plot(axes) is axes
    assert axes.has_data()
    assert pyplot.get_fignums() == [figure.number]
    figure.canvas.draw()


def test_axes_for_each_panel_and_what_is_no_axes(evaluation: rlg.Evaluation) -> None:
    axes = pyplot.subplots(3)[1]
    assert list(evaluation.plot(axes)) == list(axes)
    with pytest.raises(rlg.InputError, match="ax holds 4 axes; this picture has 3 panels"):
        evaluation.plot(pyplot.subplots(4)[1])
    with pytest.raises(rlg.InputError, match="it must be Axes of Matplotlib"):
        evaluation.plot("axes")
    with pytest.raises(rlg.InputError, match="no run 'x' was evaluated; the runs are short-3"):
        evaluation.plot(run="x")


def test_noises_are_drawn_onto_their_deviation(shown: dict[str, Any]) -> None:
    axes = shown["deviation"].plot()
    limits = axes.get_xlim(), axes.get_ylim()
    assert shown["noise"].plot(axes) is axes
    assert (axes.get_xlim(), axes.get_ylim()) == limits
    labels = [text.get_text() for text in axes.get_legend().get_texts()]
    assert "Allan deviation" in labels
    assert any(label.startswith("five noises, fitted") for label in labels)


def test_a_long_recording_is_a_band_with_its_mean() -> None:
    time = np.arange(200_000.0)
    rate = np.where(np.arange(len(time)) == 100_000, 50.0, np.random.default_rng(1).normal(size=len(time)))
    kept = (time < 50_000.0) | (time > 80_000.0)
    axes = rlg.recording({"time_s": time[kept], "gyro_deg_h": rate[kept]}).plot()
    (band,) = axes.collections
    assert max(path.vertices[:, 1].max() for path in band.get_paths()) == pytest.approx(50.0)
    (line,) = axes.lines
    assert len(line.get_xdata()) < 3000
    assert np.isnan(line.get_ydata()).any()  # the gap is left open


def test_a_figure_is_made_outside_of_the_style(runs: list[rlg.Recording], monkeypatch: pytest.MonkeyPatch) -> None:
    """A notebook's back end sets options with the first figure, which would end with the context of the style."""
    make = pyplot.figure

    def figure(*arguments: Any, **options: Any) -> Any:
        mpl.rcParams["savefig.dpi"] = 77.0
        return make(*arguments, **options)

    monkeypatch.setattr(pyplot, "figure", figure)
    runs[0].plot()
    assert mpl.rcParams["savefig.dpi"] == 77.0
    assert mpl.rcParams["axes.titleweight"] == mpl.rcParamsDefault["axes.titleweight"]


def test_columns_are_chosen(runs: list[rlg.Recording]) -> None:
    axes = runs[0].plot(columns=["temperature_block_degC", "temperature_shell_degC"])
    assert axes.get_ylabel() == "°C"
    with pytest.raises(rlg.InputError, match="no column 'x'"):
        runs[0].plot(columns=["x"])
    with pytest.raises(rlg.InputError, match="give one column at least"):
        runs[0].plot(columns=[])


def test_contributions_are_of_each_input(model: rlg.Compensator) -> None:
    table = model.contributions()
    assert set(table["input"]) == set(model.pipeline_.names)
    assert (table["rms_deg_h"].diff().dropna() <= 0.0).all()
    line = rlg.Compensator(rlg.CubicLeastSquares(degree=1), features="temperature")
    one = line.fit([GYRO.simulate("short", seed=k, step_s=20.0) for k in (4, 5)]).contributions()
    X = np.vstack([part.X for part in line.training_])
    assert one["rms_deg_h"][0] == pytest.approx(line.predict_rows(X).std(), rel=1e-9)  # of a straight line all of it


def test_a_report_is_written(evaluation: rlg.Evaluation, tmp_path: Path) -> None:
    evaluation.report(tmp_path / "evaluation.html")
    page = (tmp_path / "evaluation.html").read_text(encoding="utf-8")
    assert page.count("<svg") >= 3
    assert f"{evaluation.residual_std_deg_h:.5f}" in page


EVIL = "<b>run</b>"


def test_names_are_escaped_in_a_notebook(runs: list[rlg.Recording], model: rlg.Compensator) -> None:
    table = pd.DataFrame({"time_s": runs[0].time_s, "gyro_deg_h": runs[0]["gyro_deg_h"], "<i>x</i>": 1.5 + runs[0].time_s})
    run = rlg.recording(table, name=EVIL)
    results: list[Callable[[], Any]] = [
        lambda: run,
        lambda: rlg.evaluate(model, [runs[0].replace(name=EVIL)], compare=False),
    ]
    for make in results:
        page = make()._repr_html_()
        assert "<b>" not in page
        assert "<i>" not in page
        assert "&lt;b&gt;run" in page
    assert "cubic on" in model._repr_html_()
    assert model._repr_mimebundle_()["text/html"] == model._repr_html_()


def test_nothing_is_drawn_before_it_is_asked_for() -> None:
    code = "import sys, rlgcomp as rlg; rlg.Recording, rlg.Evaluation, rlg.AllanDeviation; print('matplotlib' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"
