"""Export to C: every sample agrees with Python on every compiler found, whatever the model, the precision and the samples."""

from __future__ import annotations

import errno
import functools
import json
import os
import re
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from sklearn.base import clone
from typer.testing import CliRunner

import rlgcomp as rlg
from rlgcomp.cli import app, register_commands
from rlgcomp.compensation.models import MODELS
from rlgcomp.errors import InputError
from rlgcomp.export import toolchain as tools
from rlgcomp.export.accuracy import bounds_of, span_deg_h
from rlgcomp.export.c import CExport
from rlgcomp.export.c_features import identifiers
from rlgcomp.export.c_source import Design, render, state_bytes, table_bytes
from rlgcomp.export.expansion import Expansion, expansion_of, expansion_of_model, third_remainder
from rlgcomp.export.golden import INVALID, Stream, golden_stream, stream_of
from rlgcomp.export.reduction import Reduction, reduction_of, size_curve, smallest_within
from rlgcomp.export.target import Options, export
from rlgcomp.files import sha256

GCC = tools.TOOLCHAINS[0]
needs_gcc = pytest.mark.skipif(shutil.which("gcc") is None, reason="gcc is not installed")
SUMMARY = {
    "model": "unit", "precision": "double", "sha256": "0", "kind": "wide", "centres": 1, "centres_of_model": 1, "inputs": 1,
    "table_bytes": 1, "state_bytes": 1, "measured": [], "operations": {}, "step_ns": {}, "allowed_deg_h": 1.0,
    "allowed_of_span": 1.0, "changed_deg_h": 0.0, "smallest_within_1_percent": 1, "span_deg_h": 1.0,
}  # fmt: skip
register_commands()


def rendered(model: rlg.Compensator, precision: str = "double", *, libm: bool = True) -> dict[str, str]:
    """C text of a whole model, as `model`."""
    expansion = expansion_of(model)
    golden, quiet = golden_stream(model, expansion, full=True)
    bounds = bounds_of(golden, model, expansion, precision)
    return render(Design("model", model, expansion, precision, libm, "0" * 64), golden, bounds, quiet)


def narrow(model: rlg.Compensator, sigma: float, c: float, **parameters: object) -> rlg.Compensator:
    """The same training with a kernel that selection would not choose."""
    other = rlg.Compensator()
    other.__dict__.update(model.__dict__)
    X, y, _ = model.training_rows()
    other.model_ = clone(model.model_).set_params(sigma=sigma, c=c, **parameters).fit(X, y)
    return other


@pytest.fixture(scope="module")
def models(short_runs: list[rlg.Recording], trained: rlg.Compensator) -> dict[str, rlg.Compensator]:
    """A model of every form in C."""
    runs = short_runs[:2]
    return {
        "wide": trained,
        "wide, its exponential needed": narrow(trained, 8.0, 1e5),
        "gaussian": narrow(trained, 3.0, 100.0),
        "power": narrow(trained, 1.0, 0.1, kernel="polynomial"),
        "sigmoid": narrow(trained, 1.0, 10.0, kernel="sigmoid"),
        "linear": narrow(trained, 1.0, 10.0, kernel="linear"),
        "matern": rlg.Compensator(MODELS["gaussian-process"].make(), features="temperature,lag").fit(runs),
        "support vectors": rlg.Compensator(MODELS["svr"].make(), features="temperature,memory").fit(runs),
        "cubic, mean kept": rlg.Compensator(rlg.CubicLeastSquares(), features="lag", keep_mean=True).fit(runs),
        "dynamic": rlg.Compensator(MODELS["dynamic"].make()).fit(runs),
        "fixed size": rlg.Compensator(MODELS["fixed-size"].make().set_params(centres=40), features="temperature").fit(runs),
    }


class Streams(NamedTuple):
    """A model's expansion, its golden recording with the number of quiet samples, and a recording that it was not trained on."""

    expansion: Expansion
    golden: Stream
    quiet: int
    held_out: Stream


@pytest.fixture(scope="module")
def streams(models: dict[str, rlg.Compensator], short_runs: list[rlg.Recording]) -> Callable[[str], Streams]:
    """Those of each model, computed by Python once."""

    @functools.cache
    def of(name: str) -> Streams:
        expansion = expansion_of(models[name])
        golden, quiet = golden_stream(models[name], expansion, full=True)
        return Streams(expansion, golden, quiet, stream_of(short_runs[2], models[name], expansion, full=True))

    return of


NAMES = [
    "wide",
    "wide, its exponential needed",
    "gaussian",
    "power",
    "sigmoid",
    "linear",
    "matern",
    "support vectors",
    "cubic, mean kept",
    "dynamic",
    "fixed size",
]

# their weights cancel, so that Python's own sum is good to fewer digits; the bound derived from the weights holds for them too
CANCELLING = ("power", "wide, its exponential needed", "support vectors", "fixed size")


def test_every_form_is_among_the_models(models: dict[str, rlg.Compensator]) -> None:
    assert list(models) == NAMES
    forms = {expansion_of(model).form for model in models.values()}
    assert forms == {"polynomial", "gaussian", "wide", "matern", "power", "sigmoid"}
    assert expansion_of(models["wide, its exponential needed"]).largest_argument > 1.0


@pytest.mark.parametrize("name", NAMES)
def test_the_expansion_is_the_model(
    models: dict[str, rlg.Compensator], streams: Callable[[str], Streams], short_runs: list[rlg.Recording], name: str
) -> None:
    model = models[name]
    expansion, _, _, stream = streams(name)
    X = model.pipeline_.transform(short_runs[2]).to_numpy()
    off = np.abs(expansion.bias_deg_h(X) - model.predict_rows(X))
    assert (off <= bounds_of(stream, model, expansion, "double").bias_deg_h).all()
    assert (expansion.outside(X) == model.scaling_.outside(X)).all()


@pytest.mark.needs("mpmath")
def test_the_third_remainder_is_what_it_says() -> None:
    import mpmath

    u = np.r_[np.linspace(-16.0, 16.0, 400), np.geomspace(1e-8, 1.0, 50), -np.geomspace(1e-8, 1.0, 50)]
    with mpmath.workdps(50):
        exact = np.array([float(mpmath.exp(v) - 1 - v - mpmath.mpf(v) ** 2 / 2) for v in u.tolist()])
    assert third_remainder(u) == pytest.approx(exact, rel=3e-15)


@needs_gcc
@pytest.mark.parametrize("precision", ["double", "float"])
@pytest.mark.parametrize("name", NAMES)
def test_every_sample_agrees(
    models: dict[str, rlg.Compensator],
    streams: Callable[[str], Streams],
    short_runs: list[rlg.Recording],
    tmp_path: Path,
    name: str,
    precision: str,
) -> None:
    model = models[name]
    expansion, golden, quiet, held_out = streams(name)
    bounds = [bounds_of(stream, model, expansion, precision) for stream in (golden, held_out)]
    design = Design("unit", model, expansion, precision, libm=True, sha256="0" * 64)
    for file, text in render(design, golden, bounds[0], quiet).items():
        (tmp_path / file).write_text(text, encoding="ascii")
    command = tools.build(GCC, [tmp_path / "unit.c", tmp_path / "unit_selftest.c"], tmp_path)
    printed = tools.selftest(GCC, command)
    assert f"state {state_bytes(design)} bytes" in printed
    found = [tools.check(GCC, command, stream, each) for stream, each in zip((golden, held_out), bounds, strict=True)]
    assert [check.wrong for check in found] == [0, 0]
    assert found[1].samples == len(short_runs[2])
    if precision == "double" and name not in CANCELLING:
        assert all(check.largest_deg_h <= 1e-12 * span_deg_h(model) for check in found)
    if precision == "float" and name in ("wide", "linear", "dynamic"):
        assert all(check.largest_deg_h <= 1e-5 * span_deg_h(model) for check in found)


@needs_gcc
def test_a_model_that_is_left_out_is_found_in_single_precision(short_runs: list[rlg.Recording], tmp_path: Path) -> None:
    """A bound of rounding above the bias itself, as sums that cancel have, passed a bias of zero; with an offset from the start."""
    model = narrow(rlg.Compensator(features="temperature").fit(short_runs[:2]), 60.0, 1e7)
    expansion = expansion_of(model)
    golden, quiet = golden_stream(model, expansion, full=True, offset_s=600.0)
    bounds = bounds_of(golden, model, expansion, "float")
    design = Design("unit", model, expansion, "float", libm=True, sha256="0" * 64, offset_s=600.0)
    files = render(design, golden, bounds, quiet)
    right = "next.bias_deg_h = bias_of(inputs, &outside, &flagged);"
    assert right in files["unit.c"]
    for wrong in ("0.0f *", "-1.0f *"):
        for file, text in files.items():
            spoilt = text.replace(right, right.replace("= bias_of", f"= {wrong} bias_of"))
            (tmp_path / file).write_text(spoilt, encoding="ascii")
        command = tools.build(GCC, [tmp_path / "unit.c", tmp_path / "unit_selftest.c"], tmp_path)
        assert tools.check(GCC, command, golden, bounds).wrong > 0, wrong


@needs_gcc
def test_a_wrong_answer_is_found(models: dict[str, rlg.Compensator], streams: Callable[[str], Streams], tmp_path: Path) -> None:
    """The comparison can fail: a bias off by 1e-11 of its span, a flag, a half width, a play, a filter, the order in time."""
    model = models["dynamic"]
    expansion, golden, _, _ = streams("dynamic")
    bounds = bounds_of(golden, model, expansion, "double")
    files = rendered(model)
    inside_deg_h = model.interval_.inside_deg_h
    spoilt = {
        f"v = {expansion.constant!r};": f"v = {expansion.constant + 1e-10!r};",
        "*flagged = 1;": "*flagged = 0;",
        f"= {inside_deg_h!r} +": f"= {1.00001 * inside_deg_h!r} +",
        "= monitor - radius;": "= monitor;",
        "(time_constant_s + step_s)": "(time_constant_s)",
        "time_s <= state->time_s": "time_s < state->time_s",
    }
    for right, wrong in spoilt.items():
        assert right in files["model.c"]
        for file, text in files.items():
            (tmp_path / file).write_text(text.replace(right, wrong), encoding="ascii")
        command = tools.build(GCC, [tmp_path / "model.c", tmp_path / "model_selftest.c"], tmp_path)
        with pytest.raises(RuntimeError, match="self-test fails"):
            tools.selftest(GCC, command)
        assert tools.check(GCC, command, golden, bounds).wrong > 0, wrong


@needs_gcc
@pytest.mark.parametrize(("column", "factor"), [("gyro_deg_h", 1.0), ("gyro_deg_s", 1.0 / 3600.0), ("gyro_pulses", 5.0 / 0.5)])
def test_the_corrected_rate_is_that_of_correct(short_runs: list[rlg.Recording], tmp_path: Path, column: str, factor: float) -> None:
    runs = [
        run.replace(
            table=run.table.rename(columns={"gyro_deg_h": column}).assign(**{column: run.rate_deg_h() * factor}),
            metadata=rlg.Metadata(pulse_arcsec=0.5),
        )
        for run in short_runs[:2]
    ]
    model = rlg.Compensator(rlg.CubicLeastSquares(), features="temperature", keep_mean=True).fit(runs)
    for file, text in rendered(model).items():
        (tmp_path / file).write_text(text)
    given = "gyro, 0.5, 5.0" if column == "gyro_pulses" else "gyro"
    (tmp_path / "t.c").write_text(
        '#include <stdio.h>\n#include "model.h"\nint main(void) { double t, gyro, m; model_state s; model_result r; '
        "model_init(&s);\n"
        'while (scanf("%lf %lf %lf", &t, &gyro, &m) == 3) { model_step(&s, t, &m, &r); '
        f'printf("%.17g\\n", model_correct_deg_h({given}, &r)); }} return 0; }}\n'
    )
    subprocess.run(["gcc", *tools.STRICT, "t.c", "model.c", "-o", "t"], cwd=tmp_path, check=True)
    rows = runs[1].table[["time_s", column, "temperature_block_degC"]].to_numpy()
    text = "\n".join(" ".join(map(repr, row)) for row in rows.tolist())
    done = subprocess.run([tmp_path / "t"], input=text, capture_output=True, text=True, check=True)
    assert np.array(done.stdout.split(), dtype=np.float64) == pytest.approx(model.correct(runs[1]).rate_deg_h(), abs=1e-12)


def test_the_golden_recording_holds_what_must_be_tested(trained: rlg.Compensator) -> None:
    expansion = expansion_of(trained)
    golden, quiet = golden_stream(trained, expansion, full=True)
    assert set(golden.status.tolist()) == {0, 1, INVALID}
    assert quiet == len(trained.training_[0].time_s)
    assert (golden.status[1 : quiet + 1] != INVALID).all()
    assert np.isnan(golden.monitors).any()
    assert np.isinf(golden.monitors).any()
    assert np.isnan(golden.time_s).any()
    late = golden.time_s[(golden.status == INVALID) & np.isfinite(golden.monitors).all(axis=1)]
    last_s = golden.time_s[golden.status == 1].min() + 100.0 * 19
    assert (late == last_s).any()  # the same time again
    assert (late < last_s).any()  # and an earlier one
    assert np.nanmax(np.diff(golden.time_s)) > 5.0 * trained.averaging_s
    inside = golden.X[1 : quiet + 1]
    covered = np.ptp(inside, axis=0) / np.ptp(trained.training_[0].X, axis=0)
    assert (covered > 0.5).all()


def test_the_golden_answers_are_those_of_step(trained: rlg.Compensator) -> None:
    golden, _ = golden_stream(trained, expansion_of(trained), full=True)
    trained.restart()
    columns = ("time_s", *trained.pipeline_.columns)
    for k in range(len(golden.time_s)):
        sample = dict(zip(columns, (golden.time_s[k], *golden.monitors[k]), strict=True))
        if golden.status[k] == INVALID:
            with pytest.raises(rlg.InputError):
                trained.step(sample)
        else:
            answer = trained.step(sample)
            assert answer.bias_deg_h == golden.bias_deg_h[k]
            assert answer.half_width_deg_h == golden.half_width_deg_h[k]
            assert answer.out_of_range == bool(golden.status[k])
    trained.restart()


@needs_gcc
@pytest.mark.parametrize("precision", ["double", "float"])
def test_an_invalid_sample_changes_nothing(models: dict[str, rlg.Compensator], tmp_path: Path, precision: str) -> None:
    """Dark readouts and numbers too large, before the first valid sample and after it: the state keeps every byte."""
    model = models["dynamic"]
    for file, text in rendered(model, precision).items():
        (tmp_path / file).write_text(text, encoding="ascii")
    usual = {"temperature_block_degC": 20.0, "temperature_shell_degC": 20.0}
    monitors = [usual.get(column, 1.0) for column in model.pipeline_.columns]
    shell = model.pipeline_.columns.index("temperature_shell_degC")
    block = model.pipeline_.columns.index("temperature_block_degC")
    largest = "FLT_MAX" if precision == "float" else "DBL_MAX"
    main = f"""#include <float.h>
#include <string.h>
#include "model.h"
int main(void)
{{
    model_real good[MODEL_MONITORS] = {{ {", ".join(map(str, monitors))} }}, dark[MODEL_MONITORS] = {{ 0 }}, large[MODEL_MONITORS];
    model_state state, before;
    model_result result;
    int k, faults = 0;

    memset(&state, 0, sizeof state);
    model_init(&state);
    memcpy(large, good, sizeof good);
    large[{block}] = {largest};
    large[{shell}] = -{largest};
    for (k = 0; k < 5; ++k) {{
        memcpy(&before, &state, sizeof state);
        faults += model_step(&state, 10.0 * k, dark, &result) != MODEL_INVALID;
        faults += model_step(&state, 10.0 * k, large, &result) != MODEL_INVALID;
        faults += memcmp(&before, &state, sizeof state) != 0;
        faults += model_step(&state, 10.0 * k, good, &result) == MODEL_INVALID;
    }}
    return faults;
}}
"""
    (tmp_path / "main.c").write_text(main, encoding="ascii")
    subprocess.run(["gcc", "-std=c99", "-O2", "main.c", "model.c", "-lm", "-o", "main"], cwd=tmp_path, check=True)
    assert subprocess.run([tmp_path / "main"], check=False).returncode == 0


# --- own mathematics ---------------------------------------------------------------------------------------------------------


@needs_gcc
@pytest.mark.parametrize(("precision", "stated"), [("double", 4e-16), ("float", 2e-7)])
def test_the_error_of_the_own_exponential_is_what_the_code_states(
    models: dict[str, rlg.Compensator], streams: Callable[[str], Streams], tmp_path: Path, precision: str, stated: float
) -> None:
    model = models["gaussian"]
    expansion, golden, quiet, _ = streams("gaussian")
    bounds = bounds_of(golden, model, expansion, precision)
    source = render(Design("unit", model, expansion, precision, libm=False, sha256="0" * 64), golden, bounds, quiet)
    assert f"Relative error below {stated:.0e}".replace("e-0", "e-") in source["unit.c"]
    main = (
        '#include <stdio.h>\nint main(void) { double t; while (scanf("%lf", &t) == 1) '
        'printf("%.17g\\n", (double)exponential((real)t)); return 0; }\n'
    )
    (tmp_path / "unit.h").write_text(source["unit.h"])
    (tmp_path / "t.c").write_text(source["unit.c"] + main)
    subprocess.run(["gcc", "-std=c99", "-O2", "t.c", "-o", "t"], cwd=tmp_path, check=True)
    least = -700.0 if precision == "double" else -87.0
    kind = np.float64 if precision == "double" else np.float32
    t = np.r_[np.linspace(least, 16.0, 20_000), np.linspace(-1.0, 1.0, 20_000), -np.geomspace(1e-20, 1.0, 1000)].astype(kind)
    text = "\n".join(f"{float(value)!r}" for value in [*t, -1e4, -1e5])
    done = subprocess.run([tmp_path / "t"], input=text, capture_output=True, text=True, check=True)
    found = np.array(done.stdout.split(), dtype=np.float64)
    exact = np.exp(t.astype(np.longdouble))
    assert np.abs((found[:-2] - exact) / exact).max() < stated
    assert found[-2:].tolist() == [0.0, 0.0]


@needs_gcc
@pytest.mark.parametrize("precision", ["double", "float"])
@pytest.mark.parametrize("name", ["matern", "wide, its exponential needed", "sigmoid"])
def test_no_library_is_needed(
    models: dict[str, rlg.Compensator], streams: Callable[[str], Streams], tmp_path: Path, name: str, precision: str
) -> None:
    model = models[name]
    expansion, golden, quiet, _ = streams(name)
    bounds = bounds_of(golden, model, expansion, precision)
    design = Design("unit", model, expansion, precision, libm=False, sha256="0" * 64)
    for file, text in render(design, golden, bounds, quiet).items():
        (tmp_path / file).write_text(text, encoding="ascii")
    assert "math.h" not in (tmp_path / "unit.c").read_text()
    command = tools.build(GCC, [tmp_path / "unit.c", tmp_path / "unit_selftest.c"], tmp_path)
    assert tools.check(GCC, command, golden, bounds).wrong == 0
    subprocess.run(["gcc", "-std=c99", "-O2", "-c", "unit.c", "-o", "unit.o"], cwd=tmp_path, check=True)
    if shutil.which("nm"):
        undefined = subprocess.run(["nm", "-u", "unit.o"], cwd=tmp_path, capture_output=True, text=True, check=True).stdout
        assert set(undefined.replace("U", "").split()) <= {"memcpy", "memset", "__stack_chk_fail", "_GLOBAL_OFFSET_TABLE_"}


# --- size --------------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["wide", "wide, its exponential needed", "gaussian", "power"])
def test_with_every_centre_the_reduced_model_is_the_model(models: dict[str, rlg.Compensator], name: str) -> None:
    """The least squares on the chosen centres has the model as its solution, once they are all chosen that matter."""
    model = models[name]
    reduction = reduction_of(model)
    X = np.vstack([part.X for part in model.training_])
    found = reduction.with_centres(reduction.most).bias_deg_h(X)
    assert found == pytest.approx(model.predict_rows(X), abs=1e-6 * span_deg_h(model))


def test_the_greedy_choice_explains_more_than_a_random_one(models: dict[str, rlg.Compensator]) -> None:
    model = models["gaussian"]
    expansion, reduction = expansion_of(model), reduction_of(model)
    X = np.vstack([part.X for part in model.training_])
    x, f = expansion.inputs(X), expansion.values(expansion.inputs(X)) - expansion.constant
    rng = np.random.default_rng(0)

    def unexplained(places: np.ndarray) -> float:
        """What is left of f's squared RKHS norm: a^T K a less that of its projection onto these centres."""
        gram = expansion.gram(x[places], x[places])
        return -float(f[places] @ np.linalg.lstsq(gram, f[places], rcond=1e-12)[0])

    for m in (3, 10, 30):
        chosen = np.array([int(np.flatnonzero((x == z).all(axis=1))[0]) for z in reduction.with_centres(m).centres])
        others = [unexplained(rng.choice(len(x), m, replace=False)) for _ in range(20)]
        assert unexplained(chosen) < min(others)


def test_the_curve_ends_at_the_whole_model_and_the_smallest_is_within_one_percent(
    trained: rlg.Compensator, short_runs: list[rlg.Recording]
) -> None:
    curve = size_curve(trained, short_runs[2:])
    residual = rlg.evaluate(trained, short_runs[2:], compare=False).residual_std_deg_h
    last = curve.iloc[-1]
    assert last["unseen_deg_h"] == pytest.approx(residual, rel=1e-3)
    assert last["left_out_loss"] == last["unseen_loss"] == 0.0
    best = smallest_within(curve)
    assert curve.set_index("centres").loc[best, "left_out_deg_h"] <= 1.01 * curve["left_out_deg_h"].min()
    assert smallest_within(size_curve(trained)) == best  # runs not trained on take no part in the choice
    assert best == 0  # paper-like biases: the first orders of the wide kernel are the model


def test_runs_trained_on_are_not_called_otherwise(trained: rlg.Compensator, short_runs: list[rlg.Recording]) -> None:
    curve = size_curve(trained, short_runs[:2]).assign(table_bytes=1)
    assert "trained_on_deg_h" in curve
    assert "unseen_deg_h" not in curve
    (title, rows), *_ = [table for table in CExport(SUMMARY, (), (), curve).tables if table[0].startswith("Size")]
    assert title == "Size against bias stability, training runs left out in turn"
    assert "the training runs, deg/h" in rows[0]
    assert "runs not trained on, deg/h" not in rows[0]
    both = size_curve(trained, short_runs)
    assert both["trained_on_deg_h"].equals(curve["trained_on_deg_h"])
    assert both["unseen_deg_h"].equals(size_curve(trained, short_runs[2:])["unseen_deg_h"])


def test_a_size_beyond_the_most_useful_one_is_on_the_curve_as_that(
    models: dict[str, rlg.Compensator], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("rlgcomp.export.reduction.SMALLEST_PIVOT", 1e-4)
    model = models["gaussian"]
    reduction = reduction_of(model)
    asked = len(reduction.expansion.weights) - 1
    assert reduction.most < asked
    assert len(reduction.with_centres(asked).weights) in size_curve(model, sizes=[asked])["centres"].tolist()


def test_a_narrow_kernel_needs_centres(models: dict[str, rlg.Compensator], short_runs: list[rlg.Recording]) -> None:
    curve = size_curve(models["gaussian"], short_runs[2:], [7])
    assert 7 in curve["centres"].tolist()
    assert curve["unseen_loss"].iloc[0] > 0.1
    assert 1 < smallest_within(curve) < len(models["gaussian"].model_.alpha_)


def test_left_out_runs_are_left_out_of_the_smooth_part_too(trained: rlg.Compensator, monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[int] = []
    first = Reduction.__init__

    def noted(self: Reduction, expansion: object, model: object, X: np.ndarray, y: np.ndarray) -> None:
        seen.append(len(model.X_fit_))
        first(self, expansion, model, X, y)

    monkeypatch.setattr(Reduction, "__init__", noted)
    size_curve(trained)
    whole = sum(len(part.y_deg_h) for part in trained.training_)
    assert seen == [whole, *(len(part.y_deg_h) for part in reversed(trained.training_))]


@needs_gcc
@pytest.mark.parametrize(
    ("options", "centres", "toolchains"),
    [
        (Options(max_centres=20), 20, (GCC,)),
        (Options(max_centres=10**6), 252, ()),  # the whole model, which is compiled above
        (Options(precision="float", max_bytes=3000), None, (GCC,)),
        (Options(smallest=True), 0, ()),  # compiled below
    ],
)
def test_budgets_are_kept(
    trained: rlg.Compensator,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    options: Options,
    centres: int | None,
    toolchains: tuple[tools.Toolchain, ...],
) -> None:
    monkeypatch.setattr(tools, "TOOLCHAINS", toolchains)
    trained.save(tmp_path / "model")
    found = export(tmp_path / "model", tmp_path / "out", "c", options).to_mapping()
    assert centres is None or found["centres"] == min(centres, found["centres_of_model"])
    if options.max_bytes:
        assert found["table_bytes"] <= options.max_bytes < found["table_bytes"] + 16 * 4 * (found["inputs"] + 1)
    assert found["verified"] == bool(toolchains)
    text = (tmp_path / "out" / "model.c").read_text()
    tables = text[text.index("static const real LOW") : text.index("/* Infinity")]
    bodies = re.findall(r"= (\{.*?\});", re.sub(r"/\*.*?\*/", "", tables, flags=re.DOTALL), flags=re.DOTALL)
    numbers = sum(len(re.findall(r"[^{},\s]+", body)) for body in bodies)
    assert found["table_bytes"] == numbers * {"double": 8, "float": 4}[options.precision]


def test_a_budget_that_cannot_be_met_says_what_can(
    trained: rlg.Compensator, models: dict[str, rlg.Compensator], tmp_path: Path
) -> None:
    trained.save(tmp_path / "model")
    least = table_bytes(expansion_of(trained), 0, "double")
    with pytest.raises(rlg.InputError, match=f"cannot be met: the smallest tables of this model take {least} bytes in double"):
        export(tmp_path / "model", tmp_path / "out", "c", Options(max_bytes=100))
    with pytest.raises(rlg.InputError, match="indefinite kernel"):
        reduction_of(models["sigmoid"])
    assert not (tmp_path / "out").exists()


# --- the command ---------------------------------------------------------------------------------------------------------------


def run(*arguments: object) -> tuple[int, str, str]:
    done = CliRunner().invoke(app, [str(argument) for argument in arguments])
    return done.exit_code, done.stdout, done.stderr


@needs_gcc
def test_from_a_recording_to_a_verified_module(unit: rlg.Simulator, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Two chamber runs to a compiled module, every sample of a third compared, on every toolchain of this machine."""
    monkeypatch.chdir(tmp_path)
    for seed in (1, 2, 3):
        rlg.write(unit.simulate("short", seed=seed, step_s=20.0), tmp_path / f"run{seed}.parquet")
    with monkeypatch.context() as first:
        first.setattr(tools, "TOOLCHAINS", (GCC,))  # all of them below
        code, out, err = run(
            "train", "run1.parquet", "run2.parquet", "--model", "lssvm", "--out", "Unit-17", "--export", "straight", "--json"
        )
    assert code == 0, err
    at_once = json.loads(out)["export"]
    assert at_once == json.loads((tmp_path / "straight" / "report.json").read_text())
    assert {check["stream"] for check in at_once["checks"]} <= {"golden", "run1", "run2"}
    assert all(check["wrong"] == 0 for check in at_once["checks"])
    command = ("export", "Unit-17", "--precision", "float", "--smallest", "--test", "run3.parquet", "--out", "box")
    code, out, err = run(*command)
    assert code == 0, err
    assert "Every sample compared with Python" in out
    assert "smallest model within 1 %" in out
    found = json.loads((tmp_path / "box" / "report.json").read_text())
    assert sorted(path.name for path in (tmp_path / "box").iterdir()) == found["files"]
    assert found["name"] == "unit_17"
    assert found["sha256"] == sha256(tmp_path / "Unit-17" / "SHA256SUMS")
    assert f'"{found["sha256"]}"' in (tmp_path / "box" / "unit_17.h").read_text()
    installed = [toolchain.name for toolchain in tools.TOOLCHAINS if toolchain.missing is None]
    assert {check["toolchain"] for check in found["checks"]} <= set(installed)
    assert len(found["checks"]) + 2 * len(found["skipped"]) == 2 * len(tools.TOOLCHAINS)
    assert all(check["wrong"] == 0 for check in found["checks"])
    rows = len(rlg.read(tmp_path / "run3.parquet"))
    assert {check["samples"] for check in found["checks"] if check["stream"] == "run3"} == {rows}
    assert found["allowed_of_span"] < 1e-4


@pytest.mark.skipif(tools.TOOLCHAINS[-1].missing is not None, reason="arm-none-eabi-gcc or qemu-system-arm is not installed")
@pytest.mark.parametrize("precision", ["double", "float"])
def test_a_cortex_m4_gives_what_python_gives(
    models: dict[str, rlg.Compensator], streams: Callable[[str], Streams], tmp_path: Path, precision: str
) -> None:
    """A whole recording through an emulated Cortex-M4, in hardware single and software double precision."""
    board, model = tools.TOOLCHAINS[-1], models["matern"]
    expansion, golden, quiet, held_out = streams("matern")
    design = Design("unit", model, expansion, precision, libm=True, sha256="0" * 64)
    for file, text in render(design, golden, bounds_of(golden, model, expansion, precision), quiet).items():
        (tmp_path / file).write_text(text, encoding="ascii")
    try:
        command = tools.build(board, [tmp_path / "unit.c", tmp_path / "unit_selftest.c"], tmp_path)
    except tools.ToolchainError as error:
        pytest.skip(str(error))
    assert f"state {state_bytes(design)} bytes" in tools.selftest(board, command)
    assert tools.check(board, command, held_out, bounds_of(held_out, model, expansion, precision)).wrong == 0
    size = tools.sizes(board, tmp_path / "unit.c", tmp_path)
    assert size is not None
    assert size["static_ram_bytes"] == 0
    assert 0 < size["flash_bytes"] - design.table_bytes < 4096


def test_without_a_compiler_it_says_that_nothing_was_verified(
    trained: rlg.Compensator, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(shutil, "which", lambda program: None)
    trained.save(tmp_path / "model")
    code, out, err = run("export", tmp_path / "model", "--max-centres", 5, "--out", tmp_path / "out")
    assert code == 0, err
    assert "gcc is not installed" in out
    assert "unverified on this machine" in out
    assert not json.loads((tmp_path / "out" / "report.json").read_text())["verified"]


@needs_gcc
def test_a_compiler_that_does_not_work_is_told_from_code_that_does_not_compile(tmp_path: Path) -> None:
    (tmp_path / "bad.c").write_text("int main(void) { return undeclared; }\n")
    with pytest.raises(RuntimeError, match="does not compile the exported C"):
        tools.build(GCC, [tmp_path / "bad.c"], tmp_path)
    broken = tools.Toolchain("broken", "gcc", ("-O2", "-lno-such-library"))
    with pytest.raises(tools.ToolchainError):
        tools.build(broken, [tmp_path / "bad.c"], tmp_path)


def test_a_machine_that_is_short_of_room_is_no_broken_compiler(
    trained: rlg.Compensator, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Else the code would be exported unverified, or a fault of the export be reported."""
    trained.save(tmp_path / "model")
    for number in (errno.ENOSPC, errno.EDQUOT, errno.EMFILE, errno.EIO):
        with monkeypatch.context() as short:

            def fails(*_: object, number: int = number, **__: object) -> None:
                raise OSError(number, os.strerror(number))

            short.setattr(shutil, "which", lambda program: program)
            short.setattr(subprocess, "run", fails)
            with pytest.raises(OSError, match=os.strerror(number)):
                tools.build(GCC, [], tmp_path)
            if number in (errno.ENOSPC, errno.EIO):  # with an advice of its own, and without
                code, _, err = run("export", tmp_path / "model", "--max-centres", 5, "--out", tmp_path / "out")
                assert code == 2
                assert os.strerror(number) in err
                assert not (tmp_path / "out").exists()
    compiler = tmp_path / "full"
    compiler.write_text("#!/bin/sh\necho 'cc1: fatal error: x.s: No space left on device' >&2\nexit 1\n")
    compiler.chmod(0o755)
    with pytest.raises(InputError, match=r"cannot compile: cc1: fatal error: x\.s: No space left on device; make room"):
        tools.build(tools.Toolchain("full", str(compiler), ()), [], tmp_path)
    with pytest.raises(tools.ToolchainError, match="No such file"):
        tools.build(tools.Toolchain("absent", str(tmp_path / "absent"), ()), [], tmp_path)


@needs_gcc
def test_code_that_disagrees_is_not_written(trained: rlg.Compensator, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tools, "TOOLCHAINS", (GCC,))
    spoilt = {file: text.replace("*flagged = 1", "*flagged = 0") for file, text in rendered(trained).items()}
    monkeypatch.setattr("rlgcomp.export.c.render", lambda *given: spoilt)
    trained.save(tmp_path / "model")
    code, _, err = run("export", tmp_path / "model", "--out", tmp_path / "out")
    assert code == 1
    assert "the self-test fails" in err
    assert not (tmp_path / "out").exists()


# --- what is refused ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--to", "fortran"], "--to 'fortran' is unknown"),
        (["--precision", "half"], "must be double or float"),
        (["--max-bytes", "0"], "--max-bytes is 0"),
        (["--max-centres", "-3"], "--max-centres is -3"),
        (["--name", "int main"], "cannot begin C identifiers"),
        (["--name", "../x"], "cannot begin C identifiers"),
    ],
)
def test_bad_options_are_refused(trained: rlg.Compensator, tmp_path: Path, arguments: list[str], message: str) -> None:
    trained.save(tmp_path / "model")
    code, _, err = run("export", tmp_path / "model", "--out", tmp_path / "out", *arguments)
    assert code == 2
    assert message in " ".join(err.split())
    assert not (tmp_path / "out").exists()


def test_a_sequence_model_is_refused_in_words(trained: rlg.Compensator) -> None:
    with pytest.raises(rlg.InputError, match="a SequenceRegressor has no sample-by-sample form"):
        expansion_of_model(rlg.SequenceRegressor(), trained.scaling_)


def test_damaged_artefacts_are_refused(trained: rlg.Compensator, tmp_path: Path) -> None:
    trained.save(tmp_path / "model")
    for spoil in (
        lambda folder: (folder / "arrays" / "mean.npy").write_bytes(b"\x93NUMPY"),
        lambda folder: (folder / "manifest.json").write_text("{}"),
        lambda folder: (folder / "SHA256SUMS").write_text("0" * 64 + "  ../../etc/passwd\n"),
        shutil.rmtree,
    ):
        copy = Path(shutil.copytree(tmp_path / "model", tmp_path / "copy"))
        spoil(copy)
        code, _, err = run("export", copy, "--out", tmp_path / "out")
        assert (code, "Traceback" in err) == (2, False)
        assert not (tmp_path / "out").exists()
        shutil.rmtree(copy, ignore_errors=True)


def test_a_kernel_too_narrow_for_c_is_refused(trained: rlg.Compensator, tmp_path: Path) -> None:
    narrow(trained, 1e-3, 1.0).save(tmp_path / "model")
    with pytest.raises(rlg.InputError, match="too narrow to compute safely in C"):
        export(tmp_path / "model", tmp_path / "out")


@needs_gcc
def test_names_from_outside_cannot_become_code(
    short_runs: list[rlg.Recording], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Columns, units and runs named by whoever: they end up in comments and identifiers, never in code."""
    evil = ["x*/ } int evil(void) { /*", 'q" ??/', "a b", "a_b", "MONITORS", "ü"]
    runs = []
    for recording in short_runs[:2]:
        table = recording.table
        for k, name in enumerate(evil):
            table[name] = table["temperature_block_degC"] + np.sin(k + np.arange(len(table)))
        named = rlg.Metadata(unit="*/ #include <stdlib.h> /* \\\n??/", notes={"calibration": "*/ abort(); /*"})
        runs.append(recording.replace(table=table, metadata=named, name="*/ run"))
    rlg.Compensator(rlg.CubicLeastSquares(), features=evil).fit(runs).save(tmp_path / "model")
    monkeypatch.setattr(tools, "TOOLCHAINS", tools.TOOLCHAINS[:2])
    found = export(tmp_path / "model", tmp_path / "out")
    text = "".join((tmp_path / "out" / f"model{end}").read_text() for end in (".h", ".c"))
    assert text.count("/*") == text.count("*/")
    assert "#include <stdlib.h>" not in [line.strip() for line in text.splitlines()]
    assert "??/" not in text
    assert found.to_mapping()["verified"]


def test_identifiers_differ() -> None:
    names = identifiers(["a b", "a_b", "a-b", "MONITORS", "x" * 90, "x" * 91])
    assert len(set(names)) == 6
    assert all(name.isidentifier() and name.isascii() for name in names)


def test_numbers_too_large_for_single_precision_are_refused(trained: rlg.Compensator, tmp_path: Path) -> None:
    large = narrow(trained, 212.0, 1e5)
    large.scaling_ = type(large.scaling_)(**{**large.scaling_.__dict__, "high": large.scaling_.high + 1e39})
    golden, quiet = golden_stream(trained, expansion_of(trained), full=True)
    bounds = bounds_of(golden, trained, expansion_of(trained), "float")
    with pytest.raises(rlg.InputError, match="export it with --precision double"):
        render(Design("unit", large, expansion_of(large), "float", libm=True, sha256=""), golden, bounds, quiet)


MAIN_OF_TIMES = """
#include <math.h>
#include <stdio.h>
#include "m.h"
int main(void)
{
    static const double times[] = { %s };
    m_state state;
    m_result result;
    m_real monitors[M_MONITORS];
    unsigned k, j;

    for (j = 0; j < M_MONITORS; ++j) {
        monitors[j] = 1;
    }
    m_init(&state);
    for (k = 0; k < sizeof times / sizeof *times; ++k) {
        if (isnan(times[k])) { /* between two streams */
            m_init(&state);
            printf("\\n");
        } else {
            printf("%%d", m_step(&state, times[k], monitors, &result) == M_INVALID);
        }
    }
    return 0;
}
"""


@needs_gcc
def test_one_wild_time_stamp_refuses_no_more_than_a_few_samples(trained: rlg.Compensator, tmp_path: Path) -> None:
    refused = {
        "0, 1, 2, 1e12, 4, 5": "000100",
        "0, 1, 2, 1e12, 1e12 + 1, 1e12 + 2": "000100",
        "0, 1, 5000, 2, 3, 4, 5, 6, 7": "000111000",
        "0, 1, 2, 2, 1, 3": "000110",
    }
    for name, text in rendered(trained).items():
        (tmp_path / name).write_text(text)
    header = next(path for path in tmp_path.iterdir() if path.suffix == ".h")
    stem = header.stem
    main = (MAIN_OF_TIMES % ", NAN, ".join(refused)).replace("m.h", header.name)
    main = main.replace("m_", f"{stem}_").replace("M_", f"{stem.upper()}_")
    (tmp_path / "main.c").write_text(main)
    subprocess.run(
        ["gcc", "-std=c99", str(tmp_path / f"{stem}.c"), str(tmp_path / "main.c"), "-o", str(tmp_path / "main"), "-lm"], check=True
    )
    printed = subprocess.run([str(tmp_path / "main")], capture_output=True, text=True, check=True).stdout
    assert printed.splitlines() == list(refused.values())


# --- the offset of a run, zeroed at its start ---------------------------------------------------------------------------------


def _shifted(run: rlg.Recording, offset_deg_h: float, gyro: str = "gyro_deg_h") -> rlg.Recording:
    rate, pulse_arcsec = run.rate_deg_h() + offset_deg_h, 1e-3
    values = {"gyro_deg_h": rate, "gyro_deg_s": rate / 3600.0, "gyro_pulses": np.round(rate * run.period_s / pulse_arcsec)}[gyro]
    metadata = rlg.Metadata(kind="chamber", pulse_arcsec=pulse_arcsec if gyro == "gyro_pulses" else None)
    return rlg.Recording(run.table.drop(columns="gyro_deg_h").assign(**{gyro: values}), metadata, name=run.name)


@needs_gcc
@pytest.mark.parametrize("gyro", ["gyro_deg_h", "gyro_deg_s", "gyro_pulses"])
def test_offset_zeroed_at_the_start_agrees_with_python(
    short_runs: list[rlg.Recording], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, gyro: str
) -> None:
    if gyro != "gyro_pulses":  # every compiler once for each precision: a factor is all that differs in the C
        monkeypatch.setattr(tools, "TOOLCHAINS", (GCC,))
    train = [_shifted(run, offset, gyro) for run, offset in zip(short_runs[:2], (0.05, -0.04), strict=True)]
    test = _shifted(short_runs[2], 0.3, gyro)
    model = rlg.Compensator(rlg.CubicLeastSquares(), features="temperature,temperature_rate,readout_difference").fit(train)
    model.save(tmp_path / "model")
    for precision in ("double", "float"):
        options = Options(precision, runs=[test], board=False, offset_s=1200.0)
        result = export(tmp_path / "model", tmp_path / precision, "c", options)
        compared = [check for check in result.checks if check.stream == test.name]
        assert compared
        assert all(check.wrong == 0 for check in result.checks)
        if precision == "double":
            assert max(check.largest_deg_h for check in compared) <= 1e-12 * max(1.0, span_deg_h(model))
    expected = model.predict(test, offset_s=1200.0)
    stream = stream_of(test, model, expansion_of(model), full=True, offset_s=1200.0)
    assert stream.bias_deg_h == pytest.approx(expected["bias_deg_h"].to_numpy(), abs=1e-12)
    assert stream.half_width_deg_h == pytest.approx(expected["half_width_deg_h"].to_numpy(), rel=1e-12)


@needs_gcc
def test_state_with_an_offset_has_the_bytes_that_are_stated(
    short_runs: list[rlg.Recording], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tools, "TOOLCHAINS", (GCC,))
    model = rlg.Compensator(rlg.CubicLeastSquares(), features="temperature").fit(short_runs[:2])
    model.save(tmp_path / "model")
    result = export(tmp_path / "model", tmp_path / "c", "c", Options(board=False, offset_s=600.0))
    tools.build(GCC, [tmp_path / "c" / "model.c", tmp_path / "c" / "model_selftest.c"], tmp_path)
    printed = subprocess.run([tmp_path / "selftest"], capture_output=True, text=True, check=True).stdout
    assert f"state {result.to_mapping()['state_bytes']} bytes: PASS" in printed
    plain = export(tmp_path / "model", tmp_path / "plain", "c", Options(board=False))
    assert "step_zeroed" not in (tmp_path / "plain" / "model.c").read_text(encoding="ascii")
    assert result.to_mapping()["state_bytes"] - plain.to_mapping()["state_bytes"] == 24


CLOCK = """
#include <stdio.h>
#include "model.h"
int main(void)
{
    model_state state;
    model_result result;
    model_real monitors[MODEL_MONITORS] = { 20 };
    int k;

    model_init(&state);
    for (k = 0; k < 40; ++k) {
        /* a clock set back by 5000 s within the start, which lasts 100 s: the offset goes on for as many samples as without */
        (void)model_step_zeroed(&state, k < 4 ? 10.0 * k : 10.0 * k - 5000.0, monitors, k < 12 ? 1.0 : 9.0, &result);
        printf("%d %.17g\\n", result.status, (double)result.bias_deg_h);
    }
    return 0;
}
"""


@needs_gcc
def test_a_clock_set_back_does_not_lengthen_the_start(
    short_runs: list[rlg.Recording], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tools, "TOOLCHAINS", (GCC,))
    model = rlg.Compensator(rlg.CubicLeastSquares(), features="temperature").fit(short_runs[:2])
    model.save(tmp_path / "model")
    export(tmp_path / "model", tmp_path / "c", "c", Options(board=False, offset_s=100.0))
    (tmp_path / "c" / "clock.c").write_text(CLOCK, encoding="ascii")
    sources = [str(tmp_path / "c" / name) for name in ("model.c", "clock.c")]
    subprocess.run(["gcc", "-std=c99", "-Wall", "-Werror", *sources, "-o", str(tmp_path / "clock")], check=True)
    lines = subprocess.run([tmp_path / "clock"], capture_output=True, text=True, check=True).stdout.splitlines()
    status, bias = np.array([line.split() for line in lines], dtype=float).T
    assert status[4:7].tolist() == [INVALID] * 3  # until the fourth that follows
    assert bias[10] == pytest.approx(1.0)  # the gyro, as long as it is averaged
    assert np.ptp(bias[16:]) == 0.0  # over
    assert bias[-1] < 5.0


def test_an_offset_is_for_c_alone(short_runs: list[rlg.Recording], tmp_path: Path) -> None:
    rlg.Compensator(rlg.CubicLeastSquares(), features="temperature").fit(short_runs[:2]).save(tmp_path / "model")
    arguments = [
        "export",
        str(tmp_path / "model"),
        "--to",
        "onnx",
        "--offset",
        "zero-at-start",
        "600",
        "--out",
        str(tmp_path / "o"),
    ]
    result = CliRunner().invoke(app, arguments)
    assert result.exit_code == 2
    assert "--offset is for --to c" in result.output
