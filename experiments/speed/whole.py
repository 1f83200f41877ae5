"""Whole jobs: one prediction as a real-time box asks for it, a diagnosis of four runs of twelve hours, and one of a table."""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Final, Literal

import numpy as np

from experiments.speed.measure import Case, Peer, Row
from rlgcomp.diagnosis.report.result import Diagnosis
from rlgcomp.recording import Recording
from rlgcomp.simulation.simulator import Simulator

CALLS: Final = 200
_PARTS: Final = {  # of a diagnosis, by the share that it then says is done
    0.05: "runs prepared",
    0.9: "sets compared",
    1.0: "fitted",
}
CENTRES, INPUTS = 430, 12


def _prediction(quick: bool) -> Case:
    from sklearn.gaussian_process import GaussianProcessRegressor
    from sklearn.gaussian_process.kernels import RBF
    from sklearn.kernel_ridge import KernelRidge

    from rlgcomp.compensation.models.lssvm import LSSVMRegressor

    del quick
    rng = np.random.default_rng(0)
    X = rng.normal(size=(CENTRES, INPUTS))
    y = np.sin(X[:, 0]) + 0.1 * X[:, 1]
    y -= y.mean()
    sigma, c = 5.0, 1e3
    model = LSSVMRegressor(c=c, sigma=sigma).fit(X, y)
    at = X[7] + 0.1
    row = at[None, :]
    one = model.row_predictor()
    ridge = KernelRidge(kernel="rbf", gamma=0.5 / sigma**2, alpha=1.0 / c).fit(X, y)
    process = GaussianProcessRegressor(RBF(sigma), alpha=1.0 / c, optimizer=None).fit(X, y)

    def many(predict: object) -> list[float]:
        return [predict() for _ in range(CALLS)]  # type: ignore[operator]

    def close(ours: list[float], theirs: list[float]) -> float:
        return abs(ours[0] - theirs[0])

    return Case(
        lambda: many(lambda: one(at)),
        [
            Peer("the same model's predict", lambda: many(lambda: float(model.predict(row)[0])), close, 1e-9),
            Peer("scikit-learn KernelRidge", lambda: many(lambda: float(ridge.predict(row)[0])), close, 0.05),
            Peer("scikit-learn GaussianProcess", lambda: many(lambda: float(process.predict(row)[0])), close, 0.05),
        ],
        size=f"{CALLS} predictions, {CENTRES} centres x {INPUTS}",
    )


def simulated_case(length: Literal["short", "half", "whole"]) -> tuple[Simulator, list[Recording]]:
    """A simulator that lacks one mechanism, and runs of the gyro that has it: the last is held out.

    Whole runs last 8 to 12 h at 1 Hz; halves are their first halves; short ones are of another programme, a sample in ten seconds.
    """
    from rlgcomp.challenge.conceal import lacking
    from rlgcomp.simulation.random_units import simulated_unit

    unit = simulated_unit(1)
    programmes = ("short", "short") if length == "short" else ("paper", "minor-loops", "paper", "reversed")
    step_s = 10.0 if length == "short" else 1.0
    runs = [unit.simulate(name, seed=seed, step_s=step_s, name=f"run-{seed}") for seed, name in enumerate(programmes, start=1)]
    if length == "half":
        runs = [run.between(0.0, run.duration_s / 2.0) for run in runs]
    return lacking(unit, "readout_incoherence", seed=1), runs


def size_text(runs: Sequence[Recording]) -> str:
    """Number of runs and their total duration."""
    return f"{len(runs)} runs, {sum(run.duration_s for run in runs) / 3600.0:.1f} h in all"


def _diagnosis(quick: bool) -> Case:
    return _diagnosis_of(*simulated_case("short" if quick else "whole"))


def _diagnosis_longer(short: bool) -> Case:
    return _diagnosis_of(*simulated_case("half" if short else "whole"))


def _diagnosis_of_a_table(quick: bool) -> Case:
    rates = ("rate 2 300, rate 10 300, rate 40 300, rate -2 300, rate -10 300, rate -40 300", "rate 5 900, rate -20 900")
    gyro = {"kind": "turntable", "mechanisms": ["scale_factor"], "noise": {"angle_random_walk_deg_sqrt_h": 5e-4}}
    lacking = Simulator.from_mapping(gyro)
    whole = Simulator.from_mapping({**gyro, "mechanisms": ["scale_factor", {"lock_in": {"lock_in_deg_s": 0.02}}]})
    step_s = 0.5 if quick else 0.01
    return _diagnosis_of(lacking, [whole.simulate(rates[k % 2], seed=k, step_s=step_s, name=f"run-{k}") for k in range(1, 5)])


def _diagnosis_of(simulator: Simulator, runs: Sequence[Recording]) -> Case:
    from rlgcomp.diagnosis.diagnose import diagnose

    parts: dict[str, float] = {}

    def ours() -> Diagnosis:
        began = time.perf_counter()

        def record_part(fraction: float) -> None:
            parts[_PARTS[fraction]] = time.perf_counter() - began - sum(parts[_PARTS[done]] for done in _PARTS if done < fraction)

        diagnosis = diagnose(simulator, runs[:-1], runs[-1:], seed=1, progress=record_part)
        record_part(1.0)
        return diagnosis

    return Case(ours, size=size_text(runs), n=sum(map(len, runs)), parts=parts)


ROWS: Final = (
    Row("predict", "one prediction at a time", _prediction, goal_s=CALLS * 10e-6),
    Row("diagnose", "whole diagnosis, runs at 1 Hz", _diagnosis, goal_s=5.0, grown=_diagnosis_longer),
    Row("diagnose-table", "whole diagnosis, a table at 100 Hz", _diagnosis_of_a_table, goal_s=20.0),
)
