"""What a logger makes of a run: thermometers that round, lag and have noise, monitors with noise, on a scale of times and rates."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Collection, Mapping, Sequence

import numpy as np
import numpy.typing as npt
import pandas as pd
from scipy import ndimage

from experiments.concealed.chamber import WINDOW_S, Chamber
from experiments.concealed.operators import first_order
from rlgcomp.recording import Metadata, Recording

Array = npt.NDArray[np.float64]
SECONDS_PER_HOUR = 3600.0
_PERIODS_S = (0.001, 60.0)
_SIZES_DEG_H = (1e-4, 1e5)
_TOGETHER = {  # columns that a logger records all or not at all
    "light": ("light_intensity_V",),
    "readout": ("readout_a_V", "readout_b_V"),
    "supply": ("supply_voltage_V",),
    "discharge": ("discharge_current_a_mA", "discharge_current_b_mA"),
    "field": ("magnetic_field_uT",),
    "pressure": ("pressure_hPa",),
    "humidity": ("humidity_percent",),
    "mount": ("temperature_mount_degC",),
}
_ABSENT = {"humidity": 0.6, "mount": 0.7}  # probability that a logger has none; of the others
_SELDOM = 0.12
_SMOOTHINGS = (0.0, 0.2, 0.4, 0.8, 1.6, 3.2, 6.4)  # of a window


@dataclasses.dataclass(frozen=True)
class Scale:
    """Sample period, and root mean square of the training runs' gyro: a case's times and rates are stretched to these.

    Parameters
    ----------
    period_s : float
    size_deg_h : float
    """

    period_s: float
    size_deg_h: float

    @classmethod
    def draw(cls, rng: np.random.Generator) -> Scale:
        """Periods from 0.001 to 60 s, gyros from 1e-4 to 1e5 deg/h."""
        period, size = (math.exp(rng.uniform(*np.log(span))) for span in (_PERIODS_S, _SIZES_DEG_H))
        return cls(period, size)


@dataclasses.dataclass(frozen=True)
class Logger:
    """Sensors of one unit.

    Parameters
    ----------
    lag_s : mapping of str to float
        Of each thermometer.
    offset_K : mapping of str to float
    resolution_K, read_noise_K : float
        Of all thermometers.
    monitor_noise : mapping of str to float
        Standard deviation of one reading, by column.
    absent : frozenset of str
        Columns that are not recorded.
    gyro : str
        The gyro's column: its unit is deg/h or deg/s.
    """

    lag_s: Mapping[str, float]
    offset_K: Mapping[str, float]
    resolution_K: float
    read_noise_K: float
    monitor_noise: Mapping[str, float]
    absent: frozenset[str]
    gyro: str

    @classmethod
    def draw(
        cls, rng: np.random.Generator, training: Sequence[Chamber], needed: Collection[str], without: Collection[str]
    ) -> Logger:
        """A logger that records what is needed and nothing of what it is to be without."""
        columns = list(training[0].monitors)
        thermometers = [column for column in columns if column.startswith("temperature")]
        lag_s = math.exp(rng.uniform(math.log(1.0), math.log(25.0)))
        lags = {column: lag_s * rng.uniform(0.7, 1.3) for column in thermometers}
        offsets = {column: rng.normal(0.0, 0.2) for column in thermometers}
        resolution, read_noise = (math.exp(rng.uniform(math.log(1e-3), math.log(most))) for most in (1.0, 0.1))
        noises = {}
        for column in columns:
            fraction = math.exp(rng.uniform(math.log(0.003), math.log(1.0 / 3.0)))
            noises[column] = fraction * float(np.std(np.concatenate([chamber[column] for chamber in training])))
        absent = set(without)
        for name, group in _TOGETHER.items():
            if rng.random() < _ABSENT.get(name, _SELDOM) and not set(group) & set(needed):
                absent |= set(group)
        gyro = "gyro_deg_s" if rng.random() < 0.2 else "gyro_deg_h"
        return cls(lags, offsets, resolution, read_noise, noises, frozenset(absent), gyro)

    def readings(self, chamber: Chamber, rng: np.random.Generator) -> dict[str, Array]:
        """All monitors as they are read, those that are not recorded among them."""
        read = {}
        for column, values in chamber.monitors.items():
            noise = rng.standard_normal(len(values))
            if column in self.lag_s:
                late = first_order(values, chamber.step_s, self.lag_s[column]) + self.offset_K[column] + self.read_noise_K * noise
                read[column] = np.round(late / self.resolution_K) * self.resolution_K
            else:
                read[column] = values + self.monitor_noise[column] * noise
        return read

    def recording(self, readings: Mapping[str, Array], gyro_deg_h: Array, period_s: float, name: str) -> Recording:
        """A run as it is recorded."""
        unit = SECONDS_PER_HOUR if self.gyro == "gyro_deg_s" else 1.0
        columns = {"time_s": period_s * np.arange(len(gyro_deg_h)), self.gyro: gyro_deg_h / unit}
        columns |= {column: values for column, values in readings.items() if column not in self.absent}
        return Recording(pd.DataFrame(columns), Metadata(kind="chamber", unit="bench"), name=name)

    def reconstructed(self, chamber: Chamber, readings: Mapping[str, Array]) -> Chamber:
        """The run as one knows it who has the readings, the sensors' lags and offsets, and the best width of smoothing."""
        step_s = chamber.step_s
        monitors = {}
        for column, values in readings.items():
            late, true_level = self.lag_s.get(column, 0.0) / step_s, values - self.offset_K.get(column, 0.0)
            tried = [_smooth(true_level, share * WINDOW_S / step_s, late) for share in _SMOOTHINGS]
            monitors[column] = _nearest(tried, chamber[column])
            if column == "temperature_block_degC":
                rate = _nearest([60.0 * np.gradient(one, step_s) for one in tried], chamber.rate_K_min)
        return dataclasses.replace(chamber, rate_K_min=rate, monitors=monitors)


def _nearest(tried: Sequence[Array], truth: Array) -> Array:
    return min(tried, key=lambda one: float(np.mean((one - truth) ** 2)))


def _smooth(values: Array, width: float, late: float) -> Array:
    """Smoothed over so many samples, and so many samples earlier; beyond its ends a series goes on as it came."""
    rows = min(len(values) - 1, math.ceil(4.0 * width + late) + 1)
    longer = np.pad(values, rows, mode="reflect", reflect_type="odd")
    smooth = ndimage.gaussian_filter1d(longer, width) if width > 0.0 else longer
    return np.interp(np.arange(len(values)) + rows + late, np.arange(len(longer)), smooth)
