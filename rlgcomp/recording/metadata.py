"""Metadata of a recording, and findings of its file."""

from __future__ import annotations

import dataclasses
import datetime
import math
from collections.abc import Mapping
from typing import Any, Final, Literal, Self, get_args

from rlgcomp.errors import InputError
from rlgcomp.report.messages import Message

Kind = Literal["chamber", "turntable", "static"]
PREDICTED: Final = "predicted"  # note of a recording whose gyro was predicted by a simulator


@dataclasses.dataclass(frozen=True)
class Metadata:
    """Metadata of a recording.

    Parameters
    ----------
    kind : {"chamber", "turntable", "static"}
    unit : str
        Serial number of the gyro.
    latitude_deg : float, optional
    pulse_arcsec : float, optional
        Angle of one pulse; needed to read gyro columns that end in `_pulses`.
    lead_in_s : float
        The first seconds only set the state of filters and hysteresis: they are neither fitted nor scored.
    notes : mapping
        Anything else, as it came; from a file dates are ISO text, and free text stands under `notes`.
    angle_step_deg : float, optional
        Resolution of the table's encoder; where absent, a diagnosis estimates it.
    after_start_s : float
        Time from the first sample to the first row, where rows are means of samples.
    """

    kind: Kind = "chamber"
    unit: str = ""
    latitude_deg: float | None = None
    pulse_arcsec: float | None = None
    lead_in_s: float = 0.0
    notes: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    angle_step_deg: float | None = None
    after_start_s: float = 0.0

    def __post_init__(self) -> None:
        if self.kind not in get_args(Kind):
            raise InputError(f"metadata: kind is {self.kind!r}; it must be one of {', '.join(get_args(Kind))}")
        if self.latitude_deg is not None and not -90.0 <= self.latitude_deg <= 90.0:
            raise InputError(f"metadata: latitude_deg is {self.latitude_deg}; it must lie between -90 and 90")
        if self.pulse_arcsec is not None and not 0.0 < self.pulse_arcsec < math.inf:
            raise InputError(f"metadata: pulse_arcsec is {self.pulse_arcsec}; it must be positive")
        if self.angle_step_deg is not None and not 0.0 < self.angle_step_deg < math.inf:
            raise InputError(f"metadata: angle_step_deg is {self.angle_step_deg}; it must be positive")
        if not 0.0 <= self.lead_in_s < math.inf:
            raise InputError(f"metadata: lead_in_s is {self.lead_in_s}; it must be zero or positive")
        if not 0.0 <= self.after_start_s < math.inf:
            raise InputError(f"metadata: after_start_s is {self.after_start_s}; it must be zero or positive")

    @classmethod
    def from_mapping(cls, values: Mapping[str, Any]) -> Self:
        """Metadata from a mapping read from a file: numbers may come as text, unknown keys go to `notes`."""
        known: dict[str, Any] = {}
        plain: dict[str, Any] = _plain(values)
        free = plain.pop("notes", None)
        notes: dict[str, Any] = free if isinstance(free, dict) else {} if free is None else {"notes": free}
        for key, value in plain.items():
            if value is None:
                continue
            if key in ("latitude_deg", "pulse_arcsec", "angle_step_deg", "lead_in_s", "after_start_s"):
                try:
                    known[key] = float(value)
                except (TypeError, ValueError, OverflowError):
                    raise InputError(f"metadata: {key} is {str(value)[:80]!r}; it must be a number") from None
            elif key in ("kind", "unit"):
                if isinstance(value, dict | list):
                    raise InputError(f"metadata: {key} is a {type(value).__name__}; it must be text")
                known[key] = str(value)
            else:
                notes[key] = value
        return cls(**known, notes=notes)

    def to_mapping(self) -> dict[str, Any]:
        """Plain mapping, without empty values; the inverse of `from_mapping`."""
        plain = {field.name: getattr(self, field.name) for field in dataclasses.fields(self)}
        return {key: value for key, value in plain.items() if value not in (None, "", 0.0) and value != {}}


def _plain(value: Any) -> Any:
    """A value of a file with dates as ISO text, so that every format and every artefact can hold it."""
    if isinstance(value, datetime.date):
        return value.isoformat()
    if isinstance(value, Mapping):
        return {str(_plain(key)): _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    return value


@dataclasses.dataclass(frozen=True)
class Finding:
    """One observation on a recording.

    Parameters
    ----------
    severity : {"repaired", "noted", "refused"}
    message : Message
    column : str, optional
    row : int, optional
        First row of it.
    """

    severity: Literal["repaired", "noted", "refused"]
    message: Message
    column: str | None = None
    row: int | None = None

    def __str__(self) -> str:
        place = ", ".join(part for part in (self.column, None if self.row is None else f"row {self.row}") if part is not None)
        return f"{self.severity}: {place + ': ' if place else ''}{self.message}"

    def to_mapping(self) -> dict[str, Any]:
        """`severity`, `column`, `row`, and `code`, `data` and `text` of the message, as JSON has them."""
        return {"severity": self.severity, "column": self.column, "row": self.row, **self.message.to_mapping()}
