"""The turntable of a simulated run: its motion, the readings of its encoder, and the warm-up of the gyro in the room."""

from __future__ import annotations

import dataclasses
import math
from typing import Final

import numpy as np
import numpy.typing as npt
import pandas as pd

from rlgcomp.errors import InputError
from rlgcomp.noise.processes import stream
from rlgcomp.recording import TIME, Metadata
from rlgcomp.simulation.monitors import gauss_markov
from rlgcomp.simulation.plant import PlatinumThermometer
from rlgcomp.simulation.programme import sample_count
from rlgcomp.simulation.table_programme import TableProgramme
from rlgcomp.units import ARCSEC_PER_DEG, DEG_PER_TURN

Array = npt.NDArray[np.float64]
_TIMES: Final = ("room_drift_s", "warm_up_s")
_MAY_BE_ZERO: Final = ("room_drift_K", "warm_up_K", "encoder_arcsec", "rate_resolution_deg_s")


@dataclasses.dataclass(frozen=True)
class Turntable:
    """A one-axis rate table with its axis upright, in a room.

    Parameters
    ----------
    latitude_deg : float, optional
        Of the table; without it the Earth's part is left out, and a bias replaces it.
    start_deg : float
        Angle at the start.
    encoder_arcsec : float
        Step of the encoder; 0 for none.
    rate_resolution_deg_s : float
        Step of the recorded rate; 0 for none.
    room_degC, room_drift_K, room_drift_s : float
        Temperature of the room, where the programme does not set it, standard deviation and correlation time of its drift.
    warm_up_K, warm_up_s : float
        How far and how slowly the gyro warms itself from switching on.

    Raises
    ------
    InputError
        A value is out of bounds.
    """

    latitude_deg: float | None = None
    start_deg: float = 0.0
    encoder_arcsec: float = 0.1
    rate_resolution_deg_s: float = 1e-7
    room_degC: float = 23.0
    room_drift_K: float = 1.0
    room_drift_s: float = 7200.0
    warm_up_K: float = 4.0
    warm_up_s: float = 2400.0

    def __post_init__(self) -> None:
        for field in dataclasses.fields(self):
            value = getattr(self, field.name)
            if field.name == "latitude_deg" and value is None:
                continue
            if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
                raise InputError(f"table: {field.name} is {value!r}; it must be a number")
            least = 0.0 if field.name in _MAY_BE_ZERO else math.ulp(0.0) if field.name in _TIMES else -math.inf
            if value < least:
                raise InputError(f"table: {field.name} is {value!r}; it must be {'zero or ' if least == 0.0 else ''}positive")

    def metadata(self) -> Metadata:
        """Metadata of its recordings."""
        return Metadata(kind="turntable", latitude_deg=self.latitude_deg)

    def simulate(self, programme: TableProgramme, step_s: float, seed: int) -> tuple[pd.DataFrame, pd.DataFrame]:
        """The quantities themselves and their readings: two tables with the same columns.

        A row belongs to the sample that ends at its time: the rate is the mean over it, the angle that at its end.

        Parameters
        ----------
        programme : TableProgramme
        step_s : float
            Sample period.
        seed : int

        Returns
        -------
        actual, recorded : pandas.DataFrame
            The mechanisms act on the first; a recording holds the second.
        """
        samples = sample_count(programme.duration_s, step_s)
        edges_s = step_s * np.arange(samples + 1, dtype=np.float64)
        angle = self.start_deg + programme.angle_deg(edges_s)
        rate = np.diff(angle) / step_s
        time_s: Array = edges_s[1:]
        room = self.room_degC if programme.room_degC is None else programme.room_degC
        block = room + self.warm_up_K * -np.expm1(-time_s / self.warm_up_s)
        block += gauss_markov(self.room_drift_K, self.room_drift_s, time_s, stream(seed, "monitor:room"))
        read = PlatinumThermometer().read(block, time_s, stream(seed, "sensor:temperature_block_degC"))
        encoder = _quantised(angle[1:], self.encoder_arcsec / ARCSEC_PER_DEG)
        columns = (TIME, "table_angle_deg", "table_rate_deg_s", "temperature_block_degC")
        actual = dict(zip(columns, (time_s, angle[1:], rate, block), strict=True))
        shown = _quantised(rate, self.rate_resolution_deg_s)
        recorded = dict(zip(columns, (time_s, np.mod(encoder, DEG_PER_TURN), shown, read), strict=True))
        return pd.DataFrame(actual), pd.DataFrame(recorded)


def _quantised(values: Array, step: float) -> Array:
    return step * np.rint(values / step) if step else values
