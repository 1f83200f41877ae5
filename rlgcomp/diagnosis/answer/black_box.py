"""The compensation at its best on the same split: the package's LS-SVM, trained on the training runs, evaluated on the others.

It learns the output itself or what the calibrated simulator leaves of it, from the compensation's features, with further recorded
columns or without; the choice is that of the least error with training runs left out, as is that of its parameters.
"""

from __future__ import annotations

import contextlib
import dataclasses
import itertools
import logging
import math
from collections.abc import Callable, Iterator, Sequence
from typing import TYPE_CHECKING, Any, Final, Literal, Self

import numpy as np
import numpy.typing as npt

from rlgcomp.diagnosis.answer.fit import Fit
from rlgcomp.diagnosis.data import Run
from rlgcomp.errors import InputError
from rlgcomp.numerics.compiled import one_blas_thread
from rlgcomp.recording import TIME, Recording

if TYPE_CHECKING:
    from rlgcomp.compensation.compensator import Compensator

Array = npt.NDArray[np.float64]
Target = Literal["output", "residual"]
REFERENCE: Final = "J. A. K. Suykens et al., Least Squares Support Vector Machines, World Scientific, 2002 (LS-SVM)."
GYRO: Final = "gyro_deg_h"
_ROWS: Final = 600  # its selection takes the cube of their number;
_FEWER: Final = 300  # so what it learns from what is chosen on longer means


@dataclasses.dataclass(frozen=True, eq=False)
class BlackBox:
    """An LS-SVM beside the diagnosis.

    Parameters
    ----------
    target : {"output", "residual"}
        What it learns: the output, or the output less the calibrated simulator.
    features : tuple of str
        As of :func:`rlgcomp.compensation.feature_pipeline.pipeline_for`.
    left_out_rms : float
        Error of means over `averaging_s`, with training runs left out (parts of it, if there is but one).
    averaging_s : float
        Of the rows that it is trained on.
    model : Compensator
    before : Fit
        The calibrated simulator.
    recorded, unstated : callable
        The output of a recording of bin means as it was recorded, and less what the simulator states of it; shape (bins,).
    """

    target: Target
    features: tuple[str, ...]
    left_out_rms: float
    averaging_s: float
    model: Compensator
    before: Fit
    recorded: Callable[[Recording], Array]
    unstated: Callable[[Recording], Array]

    @classmethod
    def of(
        cls, before: Fit, recorded: Callable[[Recording], Array], unstated: Callable[[Recording], Array], others: Sequence[Run] = ()
    ) -> Self | None:
        """Trained on the training runs; None where no column can teach it.

        Parameters
        ----------
        before : Fit
            The calibrated simulator on the training runs.
        recorded, unstated : callable
            As of the class.
        others : sequence of Run
            That it is evaluated on: it reads only columns that they have.
        """
        runs = before.data.runs
        rows = sum(len(run.windows) for run in runs)
        averaging_s, longer_s = (runs[0].grid.window_s * math.ceil(rows / most) for most in (_ROWS, _FEWER))
        columns = set.intersection(*(set(_inputs(run, before)) for run in (*runs, *others)))
        varying = sorted(c for c in columns if not c.endswith("_angle_deg") and any(np.ptp(run.column(c)) > 0.0 for run in runs))
        targets: tuple[Target, ...] = ("residual",) if before.data.turns else ("residual", "output")
        best: Self | None = None
        for features, target in itertools.product(_choices(varying, before.data.turns), targets):
            if features[0] != "all" and best is not None:
                break
            untrained = cls(target, features, math.inf, longer_s, _untrained(features, longer_s), before, recorded, unstated)
            found = untrained.trained()
            if found is not None and (best is None or found.left_out_rms < best.left_out_rms):
                best = found
        if best is None or best.averaging_s == averaging_s:
            return best
        return dataclasses.replace(best, averaging_s=averaging_s, model=_untrained(best.features, averaging_s)).trained() or best

    @one_blas_thread
    def trained(self) -> Self | None:
        """The same, trained; None where no column can teach it."""
        with _without_advice():
            try:
                model = self.model.fit([self._recording(run) for run in self.before.data.runs], screen=False)
            except InputError:
                return None
        return dataclasses.replace(
            self, model=model, left_out_rms=float(model.selection_.rmse or 0.0) * model.scaling_.y_scale_deg_h
        )

    def to_mapping(self, unit: str) -> dict[str, Any]:
        """Plain data: what it learnt, of what, and its error with training runs left out."""
        return {
            "model": "lssvm",
            "target": self.target,
            "features": list(self.features),
            "left_out_rms": {"value": self.left_out_rms, "unit": unit},
            "averaging_s": self.averaging_s,
        }

    def residual(self, run: Run) -> Array:
        """What a run's window means hold beyond what it predicts."""
        predicted = self.model.predict(self._recording(run))["bias_deg_h"].to_numpy()
        return run.window_means(run.on_bins(self._target(run) - predicted))

    def _target(self, run: Run) -> Array:
        """What it learns, at the recorded bins."""
        if self.target == "output":
            return self.recorded(run.binned)
        since = run.binned.time_s - run.binned.time_s[0] + 0.5 * run.grid.bin_s
        return np.asarray(self.unstated(run.binned) - np.interp(since, run.elapsed_s, self.before.predicted(run)))

    def _recording(self, run: Run) -> Recording:
        table = run.binned.table[[TIME, *_inputs(run, self.before)]].copy()
        table.insert(1, GYRO, self._target(run))
        lead_in_s = run.windows[0] * run.grid.window_s
        metadata = dataclasses.replace(run.binned.metadata, lead_in_s=lead_in_s)
        return run.binned.replace(table=table, metadata=metadata, truth=None)


def _inputs(run: Run, before: Fit) -> list[str]:
    """Columns that it may read."""
    without = {TIME, *run.binned.gyro_columns, *before.data.other}
    return [column for column in run.binned.columns if column not in without]


def _choices(varying: Sequence[str], turns: bool) -> tuple[tuple[str, ...], ...]:
    """Features: the compensation's, the same with every column that varies, the columns alone; on a table only these."""
    alone = (tuple(varying),) if varying else ()
    return alone if turns else (("all",), ("all", *varying), *alone)


def _untrained(features: Sequence[str], averaging_s: float) -> Compensator:
    from rlgcomp.compensation.compensator import Compensator
    from rlgcomp.compensation.models.lssvm import LSSVMRegressor

    return Compensator(LSSVMRegressor(), features=list(features), averaging_s=averaging_s)


@contextlib.contextmanager
def _without_advice() -> Iterator[None]:
    """Advice to those who train is not for those who diagnose."""
    logger = logging.getLogger("rlgcomp.compensation")
    level = logger.level
    logger.setLevel(logging.ERROR)
    try:
        yield
    finally:
        logger.setLevel(level)
