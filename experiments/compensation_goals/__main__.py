"""Run it and print one table for each goal."""

from __future__ import annotations

import argparse
import functools
import logging
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from sklearn.base import clone

import rlgcomp as rlg
from experiments.tables import show_table
from experiments.work import Work
from rlgcomp.compensation.models import MODELS
from rlgcomp.compensation.models.specification import refit_residuals
from rlgcomp.compensation.window_means import window_means
from rlgcomp.export.accuracy import span_deg_h
from rlgcomp.export.target import Options, export
from rlgcomp.noise.processes import stream

STEP_S = 10.0
WARM_UPS = {
    "alike": ("start 20, hold 10, ramp 50 1, hold 90", "start 20, hold 10, ramp 50 1, hold 90"),
    "at two rates": ("start 20, hold 10, ramp 50 1, hold 90", "start 20, hold 10, ramp 50 0.5, hold 60"),
}
OTHERS = ("start 50, hold 30, ramp 20 1, hold 90", "start 20, hold 10, ramp 50 1, hold 20, ramp 20 1, hold 20, ramp 45 1, hold 60")
TRAINING, HELD_OUT = ("paper", "minor-loops"), "reversed"
TURN_ON_DEG_H = 0.01
DRAWS = 5  # of the runs' biases: two runs show one difference of them
SECTIONS = ("one-way", "turn-on", "prior", "folds", "c")
CHAMBER = {
    "kind": "chamber",
    "mechanisms": [
        {"thermal_polynomial": {"degree": 3}},
        "temperature_rate",
        "thermal_lag",
        {"thermal_hysteresis": {"law": "preisach"}},
    ],
}


def errors_of(model: rlg.Compensator, run: rlg.Recording) -> np.ndarray:
    """Errors of the means of a run."""
    windows = window_means(run, model.pipeline_, model.averaging_s)
    return np.asarray(windows.y_deg_h - model.predict_rows(windows.X))


def one_way(seed: int, kind: str) -> dict[str, Any]:
    """Two warm-ups and nothing else: the default and the cubic in temperature on a run that cools, and up and down."""
    unit = rlg.simulated_unit(seed)
    runs = [unit.simulate(text, seed=10 * seed + k, step_s=STEP_S, name=f"run{k}") for k, text in enumerate(WARM_UPS[kind])]
    default = rlg.Compensator().fit(runs)
    cubic = rlg.Compensator(MODELS["cubic"].make(), features="temperature").fit(runs)
    row: dict[str, Any] = {"unit": seed}
    for label, text, number in zip(("cools", "up and down"), OTHERS, (7, 8), strict=True):
        test = unit.simulate(text, seed=10 * seed + number, step_s=STEP_S)
        left = [float(np.sqrt(np.mean(errors_of(model, test) ** 2))) for model in (default, cubic)]
        row |= {f"{label}: default, deg/h": left[0], f"{label}: cubic, deg/h": left[1], f"{label}: ratio": left[0] / left[1]}
        (result,) = rlg.evaluate(default, [test], compare=False).runs
        row |= {f"{label}: default's 90 % interval holds, %": 100.0 * result.in_interval}
    return row


def turn_on(seed: int) -> dict[str, Any]:
    """Shape and coverage held out, with and without biases of the runs' own."""
    unit, rng = rlg.simulated_unit(seed), stream(seed, "turn-on")
    names = (*TRAINING, HELD_OUT)
    runs = [unit.simulate(text, seed=10 * seed + k, step_s=STEP_S, name=text) for k, text in enumerate(names)]
    row: dict[str, Any] = {"unit": seed}
    for label, biases in (("without", np.zeros((1, len(runs)))), ("with", TURN_ON_DEG_H * rng.standard_normal((DRAWS, len(runs))))):
        found = []
        for of_draw in biases:
            *training, test = (
                run.with_column("gyro_deg_h", run.column("gyro_deg_h") + bias) for run, bias in zip(runs, of_draw, strict=True)
            )
            model = rlg.Compensator().fit(training, screen=False)
            found += rlg.evaluate(model, [test], compare=False).runs
        row |= {f"{label}: std / floor": float(np.mean([one.residual_std_deg_h / one.noise_floor_deg_h for one in found]))}
        row |= {f"{label}: covered, %": float(np.mean([100.0 * one.in_interval for one in found]))}
    return row | {"with: covered, least draw, %": min(100.0 * one.in_interval for one in found)}


def history_prior(seed: int) -> dict[str, Any]:
    """Shape held out, with the prior of the coefficients of the history of temperature and without one."""
    unit = rlg.simulated_unit(seed)
    names = (*TRAINING, HELD_OUT)
    *runs, test = (unit.simulate(text, seed=10 * seed + k, step_s=STEP_S, name=text) for k, text in enumerate(names))
    default = rlg.Compensator().fit(runs)
    without = rlg.Compensator(MODELS["lssvm-dynamic"].make().set_params(linear_prior=None)).fit(runs)
    noise = np.std(np.asarray(window_means(test, default.pipeline_, default.averaging_s).noise_deg_h), ddof=1)
    left = [float(np.std(errors_of(model, test), ddof=1) / noise) for model in (without, default)]
    prior = default.model_.linear_prior
    return {"unit": seed, "no prior: std / noise": left[0], "default: std / noise": left[1], "its prior": prior}


def folds(seed: int) -> dict[str, Any]:
    """Largest difference of folds in closed form from fits without each run, over the largest residual."""
    rng = np.random.default_rng(seed)
    X, groups = rng.standard_normal((200, 5)), np.repeat(np.arange(5), 40)
    y = np.sin(X[:, 0]) + X @ rng.standard_normal(5) + 0.1 * rng.standard_normal(200) + rng.standard_normal(5)[groups]
    row: dict[str, Any] = {"data": seed}
    for label, linear, trend, prior in (
        ("kernel", (), False, None),
        ("physics' columns", (1, 3), False, None),
        ("trend", (1,), True, None),
        ("trend and a prior", (1, 3), True, 0.1),
    ):
        model = rlg.LSSVMRegressor(c=50.0, sigma=2.0, run_variance=0.6, linear=linear, trend=trend, linear_prior=prior)
        fitted = clone(model).fit(X, y, runs=groups)
        closed = fitted.leave_groups_out(groups)
        brute = refit_residuals(model, [{}], X, y, groups)[0] if prior is None else _with_one_prior(fitted, X, y, groups)
        row[label] = f"{np.abs(closed - brute).max() / np.abs(brute).max():.1e}"
    return row


def _with_one_prior(fitted: rlg.LSSVMRegressor, X: np.ndarray, y: np.ndarray, groups: np.ndarray) -> np.ndarray:
    """Errors of the rows of each run by the whole system of the others, the variances of the fitted model as they are."""
    smooth, P = np.delete(X, fitted.linear, axis=1), X[:, fitted.linear]
    distances = ((smooth[:, None] - smooth[None]) ** 2).sum(axis=2)
    covariance = np.exp(-0.5 * distances / fitted.sigma**2) + fitted.linear_variance_ * P @ P.T
    F = np.column_stack([np.ones(len(y)), smooth])
    H = covariance + fitted.run_variance_ * (groups[:, None] == groups) + np.eye(len(y)) / fitted.c
    errors = np.empty(len(y))
    for label in np.unique(groups):
        rest, out = groups != label, groups == label
        border = F[rest]
        whole = np.block([[np.zeros((F.shape[1], F.shape[1])), border.T], [border, H[np.ix_(rest, rest)]]])
        beta, alpha = np.split(np.linalg.solve(whole, np.r_[np.zeros(F.shape[1]), y[rest]]), [F.shape[1]])
        errors[out] = y[out] - F[out] @ beta - covariance[np.ix_(out, rest)] @ alpha
    return errors


def exported() -> list[dict[str, Any]]:
    """Checks of a hybrid's C: every compiler that is found and a Cortex-M4 under QEMU."""
    unit = rlg.simulated_unit(1, hysteresis="preisach")
    runs = [unit.simulate("short", seed=seed, step_s=STEP_S, name=f"run{seed}") for seed in (1, 2, 3)]
    model = rlg.Compensator(physics=rlg.Simulator.from_mapping(CHAMBER), features="temperature").fit(runs[:2])
    X, y, _ = model.training_rows()
    model.model_ = rlg.LSSVMRegressor(c=100.0, sigma=3.0, linear=model.scaling_.linear).fit(X, y)  # a kernel, whatever was selected
    with tempfile.TemporaryDirectory() as folder:
        model.save(Path(folder) / "model")
        options = Options(runs=[runs[2].between(0.0, 7000.0)])
        made = export(Path(folder) / "model", Path(folder) / "c", "c", options).to_mapping()
    span = span_deg_h(model)
    counted = ", ".join(f"{name.replace('_', ' ')} {count}" for name, count in made["operations"].items() if count)
    sizes = {"centres": made["centres"], "tables, bytes": made["table_bytes"], "state, bytes": made["state_bytes"]}
    return [
        {
            "compiler": check["toolchain"],
            "stream": check["stream"],
            "samples": check["samples"],
            "largest difference / span": f"{check['largest_deg_h'] / span:.1e}",
            "wrong": check["wrong"],
            **sizes,
            "operations a step": counted,
        }
        for check in made["checks"]
    ]


def main(argv: Sequence[str] | None = None) -> None:
    """Command line of the experiment."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--section", choices=SECTIONS, action="append", help="which goal; all by default")
    parser.add_argument("--units", type=int, default=10, help="simulated gyro units (default 10)")
    Work.add_options(parser, "compensation_goals")
    options = parser.parse_args(argv)
    logging.disable(logging.WARNING)
    sections = options.section or SECTIONS
    results = functools.partial(Work.of(options).results)
    seeds = [(seed,) for seed in range(options.units)]
    if "one-way" in sections:
        for kind in WARM_UPS:
            title = f"Two warm-ups {kind} in training; goal: at most 1.5 times the cubic in temperature"
            _show(title, results("one-way", one_way, [(*seed, kind) for seed in seeds]))
    if "turn-on" in sections:
        title = f"Turn-on biases of {TURN_ON_DEG_H:g} deg/h, {DRAWS} draws, two training runs, '{HELD_OUT}' held out"
        _show(title, results("turn-on", turn_on, seeds))
    if "prior" in sections:
        title = f"A prior of the coefficients of rate, lag, memory and gradient, two training runs, '{HELD_OUT}' held out"
        _show(title, results("prior", history_prior, seeds))
    if "folds" in sections:
        show_table("Folds with run borders: closed form less brute force, relative", [folds(seed) for seed in range(5)])
    if "c" in sections:
        show_table("C of a hybrid (polynomial, rate, lag, Preisach hysteresis, kernel), every sample of a held-out run", exported())


def _show(title: str, rows: Sequence[dict[str, Any]]) -> None:
    first, *names = rows[0]
    columns = {name: [row[name] for row in rows] for name in names}
    bottom = [{first: "median"} | {name: float(np.median(values)) for name, values in columns.items()}]
    bottom += [{first: "largest"} | {name: max(values) for name, values in columns.items()}]
    shown = [{first: row[first], **{name: f"{row[name]:.3g}" for name in names}} for row in (*rows, *bottom)]
    show_table(title, shown)


if __name__ == "__main__":
    main()
