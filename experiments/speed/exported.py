"""One step of exported C, its features and its interval included, compiled on this machine."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Final, Literal

import numpy as np

from experiments.speed.measure import Case, Peer, Row, Timed

STEPS: Final = 1000
_PREDICTIONS: Final = 200  # of the peer


def _case(precision: Literal["double", "float"], flags: tuple[str, ...], tolerance: float) -> Callable[[bool], Case]:
    def prepare(quick: bool) -> Case:
        from sklearn.kernel_ridge import KernelRidge

        from rlgcomp.compensation.compensator import Compensator
        from rlgcomp.compensation.models.lssvm import LSSVMRegressor
        from rlgcomp.export import toolchain as tools
        from rlgcomp.export.accuracy import bounds_of, span_deg_h
        from rlgcomp.export.c_source import Design, render
        from rlgcomp.export.expansion import expansion_of
        from rlgcomp.export.golden import golden_stream
        from rlgcomp.simulation.random_units import simulated_unit

        toolchain = tools.Toolchain(f"gcc {' '.join(flags)}", "gcc", flags)
        if toolchain.missing:
            return Case(lambda: None, [Peer(toolchain.compiler, _absent, lambda ours, theirs: 0.0, 0.0)])
        run = simulated_unit(1).simulate("short" if quick else "paper", seed=1, step_s=10.0)
        half_s = run.duration_s / 2.0
        halves = [run.between(0.0, half_s, name="first"), run.between(half_s, run.duration_s, name="second")]
        compensator = Compensator(LSSVMRegressor(c=1e4, sigma=3.0), features="all").fit(halves)
        expansion = expansion_of(compensator)
        design = Design("step", compensator, expansion, precision, True, "0" * 64)
        golden, quiet_rows = golden_stream(compensator, expansion, full=True)
        bounds = bounds_of(golden, compensator, expansion, precision)
        sources = render(design, golden, bounds, quiet_rows)
        X = np.vstack([part.X for part in compensator.training_])
        ridge = KernelRidge(kernel="rbf", gamma=0.5 / 3.0**2, alpha=1e-4).fit(X, X[:, 0])

        def ours() -> Timed:
            with tempfile.TemporaryDirectory() as folder:
                written = []
                for name, text in sources.items():
                    (Path(folder) / name).write_text(text, encoding="ascii")
                    written += [Path(folder) / name] * name.endswith(".c")
                command = tools.build(toolchain, written, Path(folder))
                found = tools.check(toolchain, command, golden, bounds)
                seconds = STEPS * 1e-9 * tools.time_ns(command)
            return Timed(found.largest_deg_h / span_deg_h(compensator), seconds, seconds)

        def theirs() -> list[float]:
            return [float(ridge.predict(X[k % len(X)][None, :])[0]) for k in range(_PREDICTIONS)]

        peer = Peer("scikit-learn KernelRidge", theirs, lambda share, _: share, tolerance, scale=_PREDICTIONS / STEPS)
        return Case(ours, [peer], size=f"{STEPS} steps, {len(expansion.weights)} centres x {X.shape[1]}")

    return prepare


def _absent() -> None:
    raise ImportError("gcc", name="gcc")


ROWS: Final = (
    Row("step-c", "a step of exported C, double", _case("double", ("-O2",), 1e-9), goal_s=STEPS * 4.5e-6),
    Row(
        "step-c-float",
        "the same in float, for vectors",
        _case("float", ("-O3", "-march=native"), 1e-5),
        goal_s=STEPS * 0.4e-6,
    ),
)
