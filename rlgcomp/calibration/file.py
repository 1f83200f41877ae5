"""The calibration file: result of a calibration as JSON, and its application to raw recordings.

Schema `rlgcomp.calibration/1` holds a triad (its axes, eleven parameters with standard deviations, their covariance) or a single
gyro (its scale factor and bias), and the runs that it comes from. Applied, a triad's `gyro_x_...`, `gyro_y_...`, `gyro_z_...`
become body rates `gyro_x_deg_h`, ...; a single gyro's pulses become `gyro_deg_h`. Earth's rotation stays in both: its part depends
on the orientation, which a table or a chamber knows.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final, Self

import numpy as np
import numpy.typing as npt

from rlgcomp import units
from rlgcomp.calibration.triad.estimate import TriadCalibration
from rlgcomp.calibration.triad.run import AXES
from rlgcomp.errors import InputError
from rlgcomp.files import from_json, read_text, sha256, write_result
from rlgcomp.numerics import frames
from rlgcomp.recording import Recording, rate_name
from rlgcomp.report.messages import Message
from rlgcomp.scratch import recover
from rlgcomp.simulation.triad_errors import GYRO, TriadErrors

Array = npt.NDArray[np.float64]
SCHEMA: Final = "rlgcomp.calibration/1"
PULSE_AGREEMENT: Final = 1e-3


@dataclasses.dataclass(frozen=True)
class Calibration:
    """A calibration, to be applied to raw recordings.

    Parameters
    ----------
    pulse_arcsec : float or None
        Angle of a pulse that the parameters refer to; of a single gyro its scale factor.
    gyro_axes : {"oblique", "orthogonal"} or None
        Of a triad; None for a single gyro.
    errors : TriadErrors
        Of a triad.
    bias_deg_h : float
        Of a single gyro; zero where it could not be separated from Earth's rotation.
    content : mapping
        The whole file.
    identity : str
        SHA-256 of the file, "" before it is written.
    """

    pulse_arcsec: float | None = None
    gyro_axes: str | None = None
    errors: TriadErrors = dataclasses.field(default_factory=TriadErrors)
    bias_deg_h: float = 0.0
    content: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    identity: str = ""

    @classmethod
    def from_mapping(cls, content: Mapping[str, Any], identity: str = "") -> Self:
        """From a file's content.

        Raises
        ------
        InputError
            It is of another schema, or a value is missing or out of bounds.
        """
        if not isinstance(content, Mapping) or content.get("schema") != SCHEMA:
            schema = content.get("schema") if isinstance(content, Mapping) else type(content).__name__
            raise InputError(f"its schema is {schema!r}; this version reads {SCHEMA!r}; write it again with rlgcomp calibrate")
        try:
            pulse = content.get("pulse_arcsec")
            pulse = None if pulse is None else _number(pulse, "pulse_arcsec", 1e-9, 1e3)
            if content["kind"] == "gyro":
                bias = _number(content.get("bias_deg_h", 0.0), "bias_deg_h", -1e4, 1e4)
                if pulse is None:
                    raise InputError("pulse_arcsec is missing, and with it the scale factor")
                return cls(pulse, None, TriadErrors(), bias, content, identity)
            if content["kind"] != "triad":
                raise InputError(f"kind is {content['kind']!r}; allowed are gyro and triad")
            axes = str(content["gyro_axes"])
            if axes not in frames.GYRO_AXES:
                raise InputError(f"gyro_axes is {axes!r}; allowed are {', '.join(frames.GYRO_AXES)}")
            values = {
                str(row["parameter"]): _number(row["value"], str(row["parameter"]), -1e6, 1e6) for row in content["parameters"]
            }
            return cls(pulse, axes, TriadErrors(values), 0.0, content, identity)
        except (KeyError, TypeError, AttributeError) as error:
            raise InputError(f"schema {SCHEMA} requires other content: {type(error).__name__}: {error}") from None

    @classmethod
    def read(cls, path: str | Path) -> Self:
        """From a file.

        Raises
        ------
        InputError
            It cannot be read or is no calibration.
        """
        path = Path(path)
        recover(path.absolute().parent, reading=path.name)
        try:
            content = from_json(read_text(path))
        except FileNotFoundError:
            raise InputError(f"calibration file {path} does not exist") from None
        except (OSError, ValueError) as error:
            raise InputError(f"calibration file {path}: not readable as JSON: {error}") from None
        try:
            return cls.from_mapping(content, sha256(path))
        except InputError as error:
            raise InputError(f"calibration file {path}: {error}") from None

    def apply(self, recording: Recording, gyro: str | None = None) -> Recording:
        """The recording with its gyros calibrated, in deg/h.

        Parameters
        ----------
        recording : Recording
        gyro : str, optional
            Of a single gyro's calibration: its column where there are several, as recorded or as it is called once in deg/h. The
            others stay as they are.

        Raises
        ------
        InputError
            The recording holds other gyros than the calibrated ones, or pulses of another size, or several gyros fit.
        """
        if "calibration" in recording.metadata.notes:
            raise InputError(f"{recording.name} is calibrated already (notes: calibration)")
        columns = [_raw_column(recording, gyro)] if self.gyro_axes is None else self._triad_columns(recording)
        others_count = any(column.endswith("_pulses") and column not in columns for column in recording.gyro_columns)
        remaining_pulse = recording.metadata.pulse_arcsec if others_count else None
        recording = self._with_pulse(recording, columns)
        table = recording.table
        calibrated = self.rates_deg_h(np.stack([recording.rate_deg_h(column) for column in columns], axis=1))
        for column, values in zip(columns, calibrated.T, strict=True):
            table = table.rename(columns={column: rate_name(column)})
            table[rate_name(column)] = values
        notes = {**recording.metadata.notes, "calibration": self.identity or "unsaved"}
        return recording.replace(
            table=table, metadata=dataclasses.replace(recording.metadata, pulse_arcsec=remaining_pulse, notes=notes)
        )

    def rates_deg_h(self, rates_deg_h: Array) -> Array:
        """Calibrated rates of raw ones, shape (n, gyros): the triad's x, y and z, or the single gyro."""
        if self.gyro_axes is None:
            return rates_deg_h - self.bias_deg_h
        arcsec = rates_deg_h @ frames.GYRO_AXES[self.gyro_axes].T  # deg/h, which is arcsec in a second
        return self.errors.correct(arcsec * units.RAD_PER_ARCSEC, 1.0) / units.RAD_PER_ARCSEC

    def _with_pulse(self, recording: Recording, columns: Sequence[str]) -> Recording:
        if not any(column.endswith("_pulses") for column in columns):
            if self.gyro_axes is None:
                raise InputError(
                    f"{recording.name} holds no pulses ({', '.join(columns)}); the calibration of a single gyro is "
                    "the angle of its pulse; give the raw recording"
                )
            return recording
        known = recording.metadata.pulse_arcsec
        if self.pulse_arcsec is None:
            return recording
        if known is not None and abs(known / self.pulse_arcsec - 1.0) > PULSE_AGREEMENT:
            raise InputError(
                f"{recording.name} counts pulses of {known:g} arcsec, the calibration was made with {self.pulse_arcsec:g} arcsec; "
                "they are not of one gyro"
            )
        return recording.replace(metadata=dataclasses.replace(recording.metadata, pulse_arcsec=self.pulse_arcsec))

    def _triad_columns(self, recording: Recording) -> list[str]:
        by_axis = [[column for column in recording.gyro_columns if column.startswith(f"gyro_{axis}_")] for axis in AXES]
        if any(len(columns) != 1 for columns in by_axis):
            raise InputError(
                f"{recording.name} holds {', '.join(recording.gyro_columns)}; the calibration is of a triad and needs one each of "
                "gyro_x_..., gyro_y_..., gyro_z_..."
            )
        return [columns[0] for columns in by_axis]


def _raw_column(recording: Recording, gyro: str | None) -> str:
    """The gyro column of that name, or of that name once it is in deg/h."""
    if gyro is None or gyro in recording:
        return recording.gyro_column(gyro)
    matching = [column for column in recording.gyro_columns if rate_name(column) == rate_name(gyro)]
    return recording.gyro_column(matching[0] if len(matching) == 1 else gyro)


def triad_content(
    triad: TriadCalibration, recordings: Sequence[Recording], remarks: Sequence[Message], version: str, made: str
) -> dict[str, Any]:
    """Content of the file of a triad's calibration.

    Parameters
    ----------
    triad : TriadCalibration
    recordings : sequence of Recording
    remarks : sequence of Message
    version, made : str
        Version of rlgcomp, and time in ISO 8601.
    """
    return {
        "schema": SCHEMA,
        "kind": "triad",
        "made": made,
        "version": version,
        "unit": recordings[0].metadata.unit,
        "pulse_arcsec": recordings[0].metadata.pulse_arcsec,
        "gyro_axes": triad.gyro_axes,
        "latitude_deg": triad.latitude_deg,
        "parameters": triad.to_frame().to_dict("records"),
        "covariance": {"order": [parameter.name for parameter in GYRO], "values": triad.covariance},
        "accelerometer_residuals": dict(triad.accelerometer.values),
        "mount_arcsec": {"value": triad.mount_arcsec, "sd": triad.mount_sd_arcsec},
        "noise": dataclasses.asdict(triad.noise)
        | {
            "angle_random_walk_estimated": triad.noise_estimated,
            "velocity_random_walk_estimated": triad.velocity_noise_estimated,
        },
        "runs": [
            {"run": run.name, "shows": run.shows, "hours": run.hours, "chi_squared_ratio": run.chi_squared_ratio}
            for run in triad.runs
        ],
        "remarks": [remark.to_mapping() for remark in remarks],
    }


def write_calibration(path: str | Path, content: Mapping[str, Any], *, overwrite: bool = False) -> None:
    """Write a calibration file, whole or not at all.

    Parameters
    ----------
    path : path
    content : mapping
    overwrite : bool
        Whether a file that is no result of this package is replaced.

    Raises
    ------
    InputError
        The content is no calibration, or the file may not be replaced.
    """
    Calibration.from_mapping(content)
    write_result(path, content, overwrite=overwrite)


def _number(value: Any, name: str, low: float, high: float) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not (math.isfinite(value) and low <= value <= high):
        raise InputError(f"{name} is {value!r}; it must be a number between {low:g} and {high:g}")
    return float(value)
