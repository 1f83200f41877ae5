"""A recording of a triad on a two-axis table, prepared for calibration: body increments and encoders that agree.

Where gyros or accelerometers have outliers against the encoders, the triad moved or the logger erred. Attitude is not carried
across: the run is cut there, and its parts are runs of their own.
"""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Iterator
from typing import Final, Literal

import numpy as np
import numpy.typing as npt

from rlgcomp import units
from rlgcomp.errors import InputError
from rlgcomp.numerics import frames
from rlgcomp.numerics.robust import SD_OF_MAD, segments, widened
from rlgcomp.recording import Recording
from rlgcomp.report.messages import Message, message

Array = npt.NDArray[np.float64]
AXES: Final = "xyz"
STILL_DEG: Final = 1.0
LEAST_RATE_DEG_S: Final = 0.1
GRAVITY_M_S2: Final = (9.7, 9.9)
COARSE_DEG: Final = 3.0
WORST_AGREEMENT: Final = 0.02
_AGREEMENT_WINDOW_S: Final = 0.5
_FAR_SD: Final = 30.0  # standard deviations of a sample
_LEAST_ARCSEC, _LEAST_M_S2 = 1.0, 1e-3  # no standard deviation of a sample is taken to be smaller
_MARGIN_S: Final = 1.0
_MOST_OUTLIERS: Final = 3  # more belong to the table
Readings = tuple[Array, Array, Array]
"""Direction of up in the body by the accelerometers, outer and inner angle in deg."""


@dataclasses.dataclass(frozen=True)
class TableRun:
    """One run on the table.

    Parameters
    ----------
    name : str
    step_s : float
    delta_theta_rad : ndarray, shape (n, 3)
        Gyro increments, taken from the sensitive axes to the body by their nominal geometry.
    delta_v_m_s : ndarray, shape (n, 3), or None
        Velocity increments of the accelerometers.
    outer_deg, inner_deg : ndarray, shape (n,)
        Encoders at the end of each sample, running on.
    gyro_axes : str
        "oblique" or "orthogonal".
    latitude_deg : float
    angle_noise_arcsec : float
        White noise of each gyro's accumulated angle from counting whole pulses.
    pulse_arcsec : float or None
        None where the gyros came as rates.
    unit : str
        Serial number.
    """

    name: str
    step_s: float
    delta_theta_rad: Array
    delta_v_m_s: Array | None
    outer_deg: Array
    inner_deg: Array
    gyro_axes: str
    latitude_deg: float
    angle_noise_arcsec: float = 0.0
    pulse_arcsec: float | None = None
    unit: str = ""

    @classmethod
    def of(cls, recording: Recording, *, gyro_axes: str | None = None) -> TableRun:
        """From a recording.

        Parameters
        ----------
        recording : Recording
            Columns `gyro_x_...`, `gyro_y_...`, `gyro_z_...`, `angle_inner_deg`, `angle_outer_deg`, and to compare velocities
            `accel_x_m_s` (or `_m_s2`), `accel_y_...`, `accel_z_...`; metadata `latitude_deg`.
        gyro_axes : {"oblique", "orthogonal"}, optional
            By default whichever agrees with the encoders.

        Raises
        ------
        InputError
            A column or the latitude is missing, there are gaps, the table stands still, or the encoders disagree with the gyros or
            the accelerometers.
        """
        for column in ("angle_inner_deg", "angle_outer_deg"):
            if column not in recording:
                raise InputError(
                    f"{recording.name} has no column {column}; a triad is calibrated on a table with two encoders; "
                    f"map it with --map {column}=NAME; the columns are {', '.join(recording.columns)}"
                )
        columns = [_gyro(recording, axis) for axis in AXES]
        if recording.metadata.latitude_deg is None:
            raise InputError(f"{recording.name}: the latitude is not known, and with it Earth's rotation; give --latitude DEG")
        if len(recording.gaps):
            raise InputError(
                f"{recording.name}: {len(recording.gaps)} gaps in time, the first after row {recording.gaps[0]}; attitude cannot "
                "be integrated across a gap; calibrate on RUN@START:STOP without one"
            )
        step_s = recording.period_s
        rates = [recording.rate_deg_h(column) for column in columns]
        axes_rad = np.stack(rates, axis=1) * (units.RAD_PER_DEG / units.SECONDS_PER_HOUR * step_s)
        outer, inner = recording.column("angle_outer_deg"), recording.column("angle_inner_deg")
        if max(np.ptp(inner), np.ptp(outer)) < 360.0:
            raise InputError(
                f"{recording.name}: the table turns by less than a revolution ({np.ptp(inner):.1f} deg inner, {np.ptp(outer):.1f} "
                "deg outer); rate-biased gyros are calibrated turning; for a gyro at rest use rlgcomp allan"
            )
        chosen = _agreeing_axes(recording.name, axes_rad, outer, inner, step_s, gyro_axes)
        delta_v_m_s = _velocity_increments(recording, step_s)
        if delta_v_m_s is not None:
            _require_gravity(recording.name, delta_v_m_s, outer, inner, step_s)
        return cls(
            name=recording.name,
            step_s=step_s,
            delta_theta_rad=axes_rad @ frames.GYRO_AXES[chosen].T,
            delta_v_m_s=delta_v_m_s,
            outer_deg=outer,
            inner_deg=inner,
            gyro_axes=chosen,
            latitude_deg=recording.metadata.latitude_deg,
            angle_noise_arcsec=_counting_noise_arcsec(recording, columns),
            pulse_arcsec=recording.metadata.pulse_arcsec if all(column.endswith("_pulses") for column in columns) else None,
            unit=recording.metadata.unit,
        )

    @property
    def shows(self) -> Literal["rate", "velocity"]:
        """The quantity that is compared with the truth: velocity, or mean rates with the inner axis upright or no accelerometers.

        About an upright axis that does not move the accelerometers are insensitive to the gyros' errors, but each horizontal gyro's
        bias is its mean rate: Earth's rotation averages out over a turn.

        Raises
        ------
        InputError
            Both axes turn and there are no accelerometers.
        """
        if self.delta_v_m_s is None:
            if np.ptp(self.outer_deg) > STILL_DEG:
                raise InputError(
                    f"{self.name}: both axes turn and there are no accelerometers (accel_x_m_s2, ... or accel_x_m_s, ...); nothing "
                    "shows the errors then; record them, or leave this run out"
                )
            return "rate"
        upright = abs(math.cos(float(np.mean(self.outer_deg)) * units.RAD_PER_DEG)) > 0.9
        return "rate" if np.ptp(self.outer_deg) < STILL_DEG and upright else "velocity"

    @property
    def gravity_m_s2(self) -> float:
        """Gravity where the table stands, from the accelerometers, which are calibrated and only rotate.

        Raises
        ------
        InputError
            Their mean is far from gravity.
        """
        if self.delta_v_m_s is None:
            raise InputError(f"{self.name} has no accelerometers (accel_x_m_s2, ... or accel_x_m_s, ...)")
        gravity = float(np.mean(np.linalg.norm(self.delta_v_m_s, axis=1))) / self.step_s
        if not GRAVITY_M_S2[0] < gravity < GRAVITY_M_S2[1]:
            raise InputError(
                f"{self.name}: the accelerometers show {gravity:.4g} m/s^2 in the mean instead of gravity; check their unit "
                "(accel_x_m_s2 is specific force, accel_x_m_s the velocity increment over a sample)"
            )
        return gravity

    @property
    def inner_middle_rad(self) -> Array:
        """Inner angle in the middle of each sample, where its mean rate belongs."""
        before = np.r_[self.start()[1], self.inner_deg[:-1]]
        return np.asarray(0.5 * units.RAD_PER_DEG * (before + self.inner_deg))

    def start(self) -> tuple[float, float]:
        """Outer and inner angle in deg at the start of the first sample."""
        return float(2.0 * self.outer_deg[0] - self.outer_deg[1]), float(2.0 * self.inner_deg[0] - self.inner_deg[1])

    def cut_at_outliers(self) -> tuple[list[TableRun], Message | None]:
        """The parts of the run before, between and after outliers that turn by a revolution; the run itself where it has none."""
        far = _outliers(self)
        margins = segments(widened(far, round(_MARGIN_S / self.step_s)))
        if not 0 < len(margins) <= _MOST_OUTLIERS:
            return [self], None
        between = [slice(start, stop) for start, stop in np.r_[0, margins.ravel(), len(far)].reshape(-1, 2)]
        parts = [self._part(rows) for rows in between if self._turns(rows)]
        return parts or [self], message(
            "calibration.outliers",
            run=self.name,
            at_s=[self.step_s * (start + int(np.argmax(far[start:stop]))) for start, stop in margins],
            limit_sd=_FAR_SD,
            margin_s=_MARGIN_S,
            cut=bool(parts),
        )

    def _turns(self, rows: slice) -> bool:
        """Whether a part turns by a revolution, as every run must."""
        return rows.stop - rows.start > 2 and bool(max(np.ptp(self.outer_deg[rows]), np.ptp(self.inner_deg[rows])) >= 360.0)

    def _part(self, rows: slice) -> TableRun:
        return dataclasses.replace(
            self,
            name=f"{self.name} from {self.step_s * rows.start:.6g} s",
            delta_theta_rad=self.delta_theta_rad[rows],
            delta_v_m_s=None if self.delta_v_m_s is None else self.delta_v_m_s[rows],
            outer_deg=self.outer_deg[rows],
            inner_deg=self.inner_deg[rows],
        )


def _gyro(recording: Recording, axis: str) -> str:
    columns = [column for column in recording.gyro_columns if column.startswith(f"gyro_{axis}_")]
    if not columns:
        raise InputError(
            f"{recording.name} has no gyro_{axis}_pulses (or gyro_{axis}_deg_h); a triad has three gyros; it has "
            f"{', '.join(recording.gyro_columns)}; for a single gyro use rlgcomp scale-factor"
        )
    if len(columns) > 1:
        raise InputError(f"{recording.name} has {' and '.join(columns)} for one axis; leave one out with --drop {columns[0]}")
    return columns[0]


def _counting_noise_arcsec(recording: Recording, columns: list[str]) -> float:
    """A pulse over sqrt(12), where whole pulses are counted."""
    if not all(column.endswith("_pulses") for column in columns) or recording.metadata.pulse_arcsec is None:
        return 0.0
    whole = all(np.array_equal(counts, np.rint(counts)) for counts in map(recording.column, columns))
    return recording.metadata.pulse_arcsec / math.sqrt(12.0) if whole else 0.0


def _velocity_increments(recording: Recording, step_s: float) -> Array | None:
    if all(f"accel_{axis}_m_s" in recording for axis in AXES):
        return np.stack([recording.column(f"accel_{axis}_m_s") for axis in AXES], axis=1)
    if all(f"accel_{axis}_m_s2" in recording for axis in AXES):
        return np.stack([recording.column(f"accel_{axis}_m_s2") for axis in AXES], axis=1) * step_s
    return None


def _agreeing_axes(name: str, axes_rad: Array, outer: Array, inner: Array, step_s: float, stated: str | None) -> str:
    """The geometry whose body rates are the table's, within 2 %."""
    if stated is not None and stated not in frames.GYRO_AXES:
        raise InputError(f"gyro axes are {stated!r}; allowed are {', '.join(frames.GYRO_AXES)}")
    every = max(1, round(_AGREEMENT_WINDOW_S / step_s))
    windows = (len(inner) - 1) // every
    phi = 0.5 * (inner[1:] + inner[:-1]) * units.RAD_PER_DEG
    steps = np.stack([np.diff(outer) * np.sin(phi), np.diff(outer) * np.cos(phi), np.diff(inner)], axis=1)
    table = steps[: windows * every].reshape(windows, every, 3).sum(axis=1) / (every * step_s)
    if np.sqrt(np.mean(table**2)) < LEAST_RATE_DEG_S:
        raise InputError(f"{name}: the table turns at less than {LEAST_RATE_DEG_S} deg/s; rate-biased gyros are calibrated turning")
    rotations = axes_rad[1 : windows * every + 1].reshape(windows, every, 3).sum(axis=1)
    gyros = rotations / (units.RAD_PER_DEG * every * step_s)
    misfit = {
        key: float(np.sqrt(np.mean((gyros @ matrix.T - table) ** 2) / np.mean(table**2)))
        for key, matrix in frames.GYRO_AXES.items()
        if stated in (None, key)
    }
    best = min(misfit, key=misfit.__getitem__)
    if misfit[best] > WORST_AGREEMENT:
        coarse = float(np.max(np.linalg.norm(steps, axis=1)))
        sampling = f"; or record faster, for the table turns by {coarse:.3g} deg in a sample" if coarse > COARSE_DEG else ""
        raise InputError(
            f"{name}: the gyros disagree with the encoders by {100 * misfit[best]:.3g} % even when taken as {best}; check the "
            f"order and signs of the axes, pulse_arcsec, and which encoder is inner and outer{sampling}"
        )
    return best


def _require_gravity(name: str, delta_v_m_s: Array, outer_deg: Array, inner_deg: Array, step_s: float) -> None:
    """Raise unless accelerometers and encoders agree within 2 % and the turn in a sample: no encoder's instant is known better.

    At rest but for rotation a triad measures gravity alone, so that the accelerometers are to the encoders' angles as the gyros are
    to their rates. A zero of the outer encoder that is off, or an accelerometer with the wrong sign, would otherwise pass for a
    triad that stands turned by as much, or for vibration.

    Raises
    ------
    InputError
        They disagree; the message names the change of order, sign or zero with which they would agree.
    """
    mean_m_s = float(np.mean(np.linalg.norm(delta_v_m_s, axis=1)))
    if not mean_m_s > 0.0:
        return
    up = delta_v_m_s[1:] / mean_m_s
    outer, inner = (0.5 * (angle[1:] + angle[:-1]) for angle in (outer_deg, inner_deg))
    every = max(1, round(_AGREEMENT_WINDOW_S / step_s))
    steps = np.diff(np.stack([outer_deg, inner_deg]), axis=1) * units.RAD_PER_DEG
    allowed = WORST_AGREEMENT + float(np.sqrt(np.mean(np.sum(steps**2, axis=0))))
    misfit = _misfit(up, outer, inner, every)
    if misfit <= allowed:
        return
    kinds = (_other_axes(up, outer, inner), _other_encoders(up, outer, inner))
    agreeing = [next((change for change, readings in kind if _misfit(*readings, every) <= allowed), None) for kind in kinds]
    changes = " or with ".join(change for change in agreeing if change is not None)
    would = f"they agree with {changes}" if changes else "no order, sign or zero makes them agree"
    raise InputError(
        f"{name}: the accelerometers disagree with the encoders by {100 * misfit:.3g} % of gravity, and {100 * allowed:.2g} % is "
        f"allowed; {would}; check the order and signs of accel_x, accel_y and accel_z, and that the outer encoder is zero with the "
        "inner axis upright"
    )


def _misfit(up: Array, outer_deg: Array, inner_deg: Array, every: int) -> float:
    """Rms, over windows, of the measured direction of up less that of the encoders."""
    residual = up - frames.table_up(outer_deg, inner_deg)
    windows = len(residual) // every
    means = residual[: windows * every].reshape(windows, every, 3).mean(axis=1)
    return float(np.sqrt(np.mean(np.sum(means**2, axis=1))))


def _other_axes(up: Array, outer: Array, inner: Array) -> Iterator[tuple[str, Readings]]:
    """Accelerometers taken in another order and with other signs, the fewest changes first: change and readings."""
    combinations = itertools.product(itertools.permutations(range(3)), itertools.product((1.0, -1.0), repeat=3))
    changes = {
        (order, signs): [
            f"{axis} = {'-' if sign < 0.0 else ''}accel_{AXES[k]}"
            for axis, k, sign in zip(AXES, order, signs, strict=True)
            if AXES[k] != axis or sign < 0.0
        ]
        for order, signs in combinations
    }
    for (order, signs), changed in sorted(changes.items(), key=lambda item: len(item[1])):
        yield ", ".join(changed), (up[:, order] * np.array(signs), outer, inner)


def _other_encoders(up: Array, outer: Array, inner: Array) -> Iterator[tuple[str, Readings]]:
    """Encoders taken with another sign or zero."""
    yield "the other sign of angle_outer_deg", (up, -outer, inner)
    outer_rad, inner_rad = outer * units.RAD_PER_DEG, inner * units.RAD_PER_DEG
    level = (1j * up[:, 1] - up[:, 0]) * np.exp(-1j * inner_rad)  # sin(outer), were both right; a wrong inner zero turns it
    off_deg = float(np.angle(np.sum((up[:, 2] + 1j * level.real) * np.exp(-1j * outer_rad)))) / units.RAD_PER_DEG
    yield f"{off_deg:.4g} deg added to angle_outer_deg", (up, outer + off_deg, inner)
    off_deg = float(np.angle(np.sum(level * np.sin(outer_rad)))) / units.RAD_PER_DEG
    yield f"{off_deg:.4g} deg added to angle_inner_deg", (up, outer, inner + off_deg)


def _outliers(run: TableRun) -> npt.NDArray[np.bool_]:
    """Samples that the encoders do not explain, where the table turns steadily."""
    starts = run.start()
    outer, inner = (
        np.diff(angle, prepend=start) * units.RAD_PER_DEG
        for angle, start in zip((run.outer_deg, run.inner_deg), starts, strict=True)
    )
    phi = run.inner_middle_rad
    theta_deg = run.outer_deg - 0.5 * outer / units.RAD_PER_DEG
    turning = np.stack([outer * np.sin(phi), outer * np.cos(phi), inner], axis=1)
    far = _far_from_fit(run.delta_theta_rad, turning, _LEAST_ARCSEC * units.RAD_PER_ARCSEC)
    if run.delta_v_m_s is not None:
        up = frames.table_up(theta_deg, phi / units.RAD_PER_DEG)
        far |= _far_from_fit(run.delta_v_m_s, up, _LEAST_M_S2 * run.step_s)
    speed = np.stack([outer, inner], axis=1)
    jerk = np.abs(np.diff(speed, axis=0, prepend=speed[:1]))
    unsteady = np.any(jerk > 10.0 * (SD_OF_MAD * np.median(jerk, axis=0) + 1e-5), axis=1)
    return np.asarray(far & ~widened(unsteady, 2))


def _far_from_fit(measured: Array, reference: Array, least_sd: float) -> npt.NDArray[np.bool_]:
    """Samples far from the best linear fit by the encoders."""
    design = np.column_stack([reference, np.ones(len(reference))])
    residual = measured - design @ np.linalg.lstsq(design, measured, rcond=None)[0]
    sd = np.maximum(SD_OF_MAD * np.median(np.abs(residual - np.median(residual, axis=0)), axis=0), least_sd)
    return np.asarray(np.any(np.abs(residual) > _FAR_SD * sd, axis=1))
