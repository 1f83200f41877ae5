"""A black box as a yardstick: what the simulator leaves of each run, and an LS-SVM that learns it from the training runs."""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import logging
import math
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor
from typing import Final

import numpy as np
import numpy.typing as npt

from rlgcomp.diagnosis.question.departures import not_comparable
from rlgcomp.diagnosis.question.pulses import step_of
from rlgcomp.diagnosis.question.windows import Windows
from rlgcomp.errors import InputError
from rlgcomp.numerics.compiled import one_blas_thread
from rlgcomp.recording import TIME, Recording
from rlgcomp.simulation.simulator import Simulator

Array = npt.NDArray[np.float64]
_ROWS: Final = 900  # its selection takes the cube of their number


@dataclasses.dataclass(frozen=True)
class Mismatch:
    """What a simulator leaves of one run.

    Parameters
    ----------
    run : Recording
        With the one gyro.
    said_deg_h, mismatch_deg_h : ndarray, shape (n,)
        What the simulator says, and the gyro less all that is said of it.
    windows : Windows
        Of the run whose gyro is the mismatch.
    """

    run: Recording
    said_deg_h: Array
    mismatch_deg_h: Array
    windows: Windows

    @classmethod
    def of(
        cls,
        before: Simulator,
        whole: Recording,
        gyro: str | None,
        predicted: Callable[[Recording], Array] | None,
        window_s: float,
        knee_s: float = 0.0,
    ) -> Mismatch:
        """Of one run.

        Parameters
        ----------
        before : Simulator
        whole : Recording
        gyro : str, optional
        predicted : callable, optional
            Further prediction in deg/h: the user's own simulator.
        window_s : float
        knee_s : float
            Of the errors of the gyro's angle.

        Raises
        ------
        InputError
            The run is too short or lacks a monitor.
        """
        column = whole.gyro_column(gyro)
        others = [other for other in whole.gyro_columns if other != column]
        run = whole.replace(table=whole.table.drop(columns=others), truth=None)
        said = before.predict(run).rate_deg_h()
        # the user's simulation holds what a perfect gyro would show, and so does ours: it counts once
        own = 0.0 if predicted is None else predicted(whole) - before.nominal_deg_h(run)
        mismatch = run.rate_deg_h() - said - own
        table = run.table.drop(columns=column)
        table.insert(1, "gyro_deg_h", mismatch)
        left_out = not_comparable(before, run, predicted)
        return cls(run, said, mismatch, Windows.of(run.replace(table=table), window_s, knee_s, left_out, step_of(run, column)))

    def as_loud(self, as_these: Windows) -> Mismatch:
        """The same of a run whose white noise is as loud, and where it is, as that of these windows of it, rounding among it."""
        known = {name: getattr(as_these, name) for name in ("loudness", "bursts", "white_deg_h2", "rounded")}
        loud = dataclasses.replace(self.windows, **known)
        return dataclasses.replace(self, windows=loud)


def learned(mismatches: Sequence[Mismatch], training: int, executor: Executor | None = None) -> Callable[[], list[Array] | None]:
    """Start to train an LS-SVM on the mismatch of the first runs, and call what is returned for what it says of all.

    Parameters
    ----------
    mismatches : sequence of Mismatch
    training : int
        Runs that it is trained on.
    executor : Executor, optional
        That trains it, while this process goes on.

    Returns
    -------
    callable
        Window means of what it says, an array a run; None where no monitor can teach it.
    """
    windows = [one.windows for one in mismatches]
    fine = [one.fine for one in windows]
    rows = sum(int(one.kept.sum()) for one in windows[:training])
    averaging_s = max(windows[0].window_s * math.ceil(rows / _ROWS), *(run.period_s for run in fine))  # windows may be rows
    taught = [one.fine_unfrozen for one in windows[:training]]
    future = None if executor is None else executor.submit(_trained, taught, fine, averaging_s)

    @functools.cache  # where held-out runs deny a law, they are compared twice
    def means() -> list[Array] | None:
        said = _trained(taught, fine, averaging_s) if future is None else future.result()
        return said and [one.means(values, of_fine=True) for one, values in zip(windows, said, strict=True)]

    return means


@contextlib.contextmanager
def _without_advice() -> Iterator[None]:
    """What training says to those who train is not for those who diagnose."""
    logger = logging.getLogger("rlgcomp.compensation")
    level = logger.level
    logger.setLevel(logging.ERROR)
    try:
        yield
    finally:
        logger.setLevel(level)


def _of_all(taught: Sequence[Recording], levels: Sequence[str]) -> Sequence[str]:
    """The features of a compensation, and the levels of columns that it does not read."""
    from rlgcomp.compensation.feature_pipeline import pipeline_for

    try:
        read = pipeline_for(taught).columns
    except InputError:
        return levels
    varying = [column for column in levels if any(np.ptp(run.column(column)) > 0.0 for run in taught)]
    return ["all", *(column for column in varying if column not in read)]


@one_blas_thread
@_without_advice()
def _trained(taught: Sequence[Recording], fine: Sequence[Recording], averaging_s: float) -> list[Array] | None:
    from rlgcomp.compensation.compensator import Compensator
    from rlgcomp.compensation.models.lssvm import LSSVMRegressor

    common = set.intersection(*(set(run.columns) for run in fine)) - {TIME, "gyro_deg_h"}
    levels = sorted(column for column in common if not column.endswith("_angle_deg"))  # an angle only counts turns
    for features in (levels,) if fine[0].metadata.kind == "turntable" else (_of_all(taught, levels), levels):
        try:
            model = Compensator(LSSVMRegressor(), features=features, averaging_s=averaging_s).fit(taught, screen=False)
            return [model.predict(run)["bias_deg_h"].to_numpy() for run in fine]
        except InputError:
            continue
    return None
