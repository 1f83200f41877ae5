"""Knocks of a triad on its table: samples of gyros or accelerometers far off what the encoders say; the run is cut there.

Whether the triad moved or the logger erred, attitude is not carried across: what comes before and after are runs of their own.
"""

from __future__ import annotations

import dataclasses
from typing import Final

import numpy as np
import numpy.typing as npt

from rlgcomp import units
from rlgcomp.calibration.triad.run import TableRun
from rlgcomp.numerics import frames
from rlgcomp.numerics.robust import SD_OF_MAD, stretches

Array = npt.NDArray[np.float64]
_FAR: Final = 30.0  # standard deviations of a sample
_LEAST_ARCSEC, _LEAST_M_S2 = 1.0, 1e-3  # no sample's standard deviation is taken to be smaller
_AROUND_S: Final = 1.0
_MOST: Final = 3  # more are the table's own


def without_knocks(run: TableRun) -> tuple[list[TableRun], str | None]:
    """A run's parts between knocks, and what to say of them."""
    far = _far(run)
    around = round(_AROUND_S / run.step_s)
    near = np.convolve(far, np.ones(2 * around + 1), mode="same") > 0.5
    knocked = stretches(near)
    if not 0 < len(knocked) <= _MOST:
        return [run], None
    calm = np.r_[0, knocked.ravel(), len(far)].reshape(-1, 2)
    parts = [_part(run, slice(start, stop)) for start, stop in calm if _turns(run, slice(start, stop))]
    first = [start + int(np.argmax(far[start:stop])) for start, stop in knocked]
    times = ", ".join(f"{run.step_s * row:.6g} s" for row in first)
    said = f"{run.name}: gyros or accelerometers stand {_FAR:g} standard deviations off the encoders {times} after the start"
    if not parts:
        return [run], f"{said}: a knock or a fault of the logger; nothing long enough is left of the run without it"
    return parts, f"{said}: a knock or a fault of the logger; the run is cut there, {_AROUND_S:g} s on either side left out"


def _far(run: TableRun) -> npt.NDArray[np.bool_]:
    """Samples that the encoders do not explain, where the table turns steadily."""
    starts = run.start()
    outer, inner = (
        np.diff(angle, prepend=start) * units.RAD_PER_DEG
        for angle, start in zip((run.outer_deg, run.inner_deg), starts, strict=True)
    )
    phi = run.inner_middle_rad
    theta_deg = run.outer_deg - 0.5 * outer / units.RAD_PER_DEG
    turning = np.stack([outer * np.sin(phi), outer * np.cos(phi), inner], axis=1)
    far = _off(run.delta_theta_rad, turning, _LEAST_ARCSEC * units.RAD_PER_ARCSEC)
    if run.delta_v_m_s is not None:
        up = frames.table_attitude(theta_deg, phi / units.RAD_PER_DEG)[:, 2, :]
        far |= _off(run.delta_v_m_s, up, _LEAST_M_S2 * run.step_s)
    speed = np.stack([outer, inner], axis=1)
    jerk = np.abs(np.diff(speed, axis=0, prepend=speed[:1]))
    unsteady = np.any(jerk > 10.0 * (SD_OF_MAD * np.median(jerk, axis=0) + 1e-5), axis=1)
    return np.asarray(far & ~(np.convolve(unsteady, np.ones(5), mode="same") > 0.5))


def _off(seen: Array, said: Array, least: float) -> npt.NDArray[np.bool_]:
    """Samples far off their best fit by what the encoders say."""
    design = np.column_stack([said, np.ones(len(said))])
    left = seen - design @ np.linalg.lstsq(design, seen, rcond=None)[0]
    sd = np.maximum(SD_OF_MAD * np.median(np.abs(left - np.median(left, axis=0)), axis=0), least)
    return np.asarray(np.any(np.abs(left) > _FAR * sd, axis=1))


def _turns(run: TableRun, rows: slice) -> bool:
    """Whether a part turns by a revolution, as every run must."""
    return rows.stop - rows.start > 2 and bool(max(np.ptp(run.outer_deg[rows]), np.ptp(run.inner_deg[rows])) >= 360.0)


def _part(run: TableRun, rows: slice) -> TableRun:
    pushed = None if run.delta_v_m_s is None else run.delta_v_m_s[rows]
    return dataclasses.replace(
        run,
        name=f"{run.name} from {run.step_s * rows.start:.6g} s",
        delta_theta_rad=run.delta_theta_rad[rows],
        delta_v_m_s=pushed,
        outer_deg=run.outer_deg[rows],
        inner_deg=run.inner_deg[rows],
    )
