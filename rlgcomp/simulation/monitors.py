r"""The monitors of a simulated chamber run: the quantities themselves, and the readings of the sensors.

Temperatures come from the thermal plant, the readout's RMS values and the light intensity from where the two beams fall on the
detector, the rest are Gauss–Markov processes. The beams' mean shift follows temperature, hysteresis of the mounts and, sometimes,
a **mutation**: a part slips, the beams jump and creep back. Mutations come with probability proportional to \|dT/dt\|, none at a
steady temperature.

The beams' fields on the detector, a bi-planar photodiode, are :math:`E_i \propto \exp(-(x - d_i)^2 / w^2)`. Their interference
term,

.. math:: I_{AC}(x) = 2 A_1 A_2 \, e^{-(d_1-d_2)^2 / 2 w^2} \, e^{-2 (x - \bar x)^2 / w^2}
          \cos(2\pi \Delta f t + 2\pi\gamma x/\lambda), \qquad \bar x = \tfrac12 (d_1 + d_2),

is integrated over each half, :math:`\pm[s - h/2, s + h/2]`; the modulus of that complex integral over :math:`\sqrt2` is the half's
RMS. The difference of the two RMS values therefore senses the mean shift of the beams, for small halves as

.. math:: \frac{A - B}{A + B} = \tanh\frac{4 s \bar x}{w^2},

while a purely opposite shift lowers both halves alike, and an angle between the beams turns the phase between them but leaves the
difference alone.

Source: Opt. Express 23, 13320 (2015), eqs. (3) and (4) and figs. 2 and 3, with the beams' finite size added.
"""

from __future__ import annotations

import dataclasses
import math
from typing import Final

import numpy as np
import numpy.typing as npt
import pandas as pd

from rlgcomp.errors import InputError
from rlgcomp.noise.processes import stream
from rlgcomp.numerics.filters import decaying, rate_per_min
from rlgcomp.numerics.hysteresis import Play
from rlgcomp.recording import TIME
from rlgcomp.simulation.plant import PlatinumThermometer, ThermalPlant
from rlgcomp.simulation.programme import Programme, sample_count
from rlgcomp.units import HELIUM_NEON_WAVELENGTH_M

Array = npt.NDArray[np.float64]
NOMINAL_DEG_C: Final = 20.0
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(24)


@dataclasses.dataclass(frozen=True)
class Readout:
    """Geometry of the readout.

    Parameters
    ----------
    beam_radius_m : float
        w, 1/e² radius of each beam.
    half_centre_m, half_width_m : float
        s and h: centre and width of each half of the photodiode.
    fringe_angle_rad : float
        gamma, angle between the beams.
    full_scale_V : float
        RMS of a half for centred beams of unit power.
    """

    beam_radius_m: float = 0.5e-3
    half_centre_m: float = 0.30e-3
    half_width_m: float = 0.50e-3
    fringe_angle_rad: float = 200e-6
    full_scale_V: float = 1.0

    def __post_init__(self) -> None:
        if not (self.beam_radius_m > 0 and self.half_width_m > 0 and self.half_centre_m >= 0.5 * self.half_width_m):
            raise InputError(f"{self}: beam radius and half width must be positive, and the halves must not overlap")

    def rms_V(
        self, shift_cw_m: Array, shift_ccw_m: Array, power_cw: Array | float = 1.0, power_ccw: Array | float = 1.0
    ) -> tuple[Array, Array]:
        """RMS voltages of the two halves.

        Parameters
        ----------
        shift_cw_m, shift_ccw_m : ndarray, shape (n,)
            d1 and d2: where each beam meets the detector.
        power_cw, power_ccw : float or ndarray
            Powers, 1 at the nominal operating point.

        Returns
        -------
        a_V, b_V : ndarray, shape (n,)
            The half at +s and the half at -s.
        """
        mean, difference = 0.5 * (shift_cw_m + shift_ccw_m), shift_cw_m - shift_ccw_m
        contrast = np.sqrt(power_cw * power_ccw) * np.exp(-(difference**2) / (2.0 * self.beam_radius_m**2))
        nominal = self._amplitude(np.zeros(1), +1.0)[0]
        scale = self.full_scale_V * contrast / nominal
        return scale * self._amplitude(mean, +1.0), scale * self._amplitude(mean, -1.0)

    def _amplitude(self, mean_m: Array, side: float) -> Array:
        x = side * self.half_centre_m + 0.5 * self.half_width_m * _NODES
        phase = np.exp(2j * math.pi * self.fringe_angle_rad * x / HELIUM_NEON_WAVELENGTH_M)
        envelope = np.exp(-2.0 * (x - mean_m[:, None]) ** 2 / self.beam_radius_m**2)
        return np.asarray(np.abs(envelope @ (_WEIGHTS * phase)))


@dataclasses.dataclass(frozen=True)
class Beams:
    """How the two beams move and how bright they are.

    Parameters
    ----------
    shift_um_K : float
        Mean shift per kelvin.
    slip_um_K, slip_radius_K : float
        Hysteretic part of the mean shift (play of that radius).
    wander_um, wander_correlation_s : float
        Standard deviation and correlation time of a Gauss–Markov process in the mean shift.
    mutation_um : float
        Standard deviation of a mutation's jump; 0 for none.
    mutations_per_100_K : float
        Expected number of mutations for every 100 K that the block passes through.
    mutation_creep_s : float
        Time constant with which a jump creeps back to half its size.
    opposite_um_K : float
        Opposite shift of the two beams per kelvin.
    intensity_per_K, intensity_per_K2, intensity_per_um : float
        Relative change of the light intensity with temperature and with the clockwise beam's shift.
    intensity_wander : float
        Standard deviation of a Gauss–Markov process in the light intensity, relative (servo).
    """

    shift_um_K: float = 0.01
    slip_um_K: float = 0.05
    slip_radius_K: float = 15.0
    wander_um: float = 0.5
    wander_correlation_s: float = 3000.0
    mutation_um: float = 6.0
    mutations_per_100_K: float = 1.5
    mutation_creep_s: float = 1500.0
    opposite_um_K: float = 0.05
    intensity_per_K: float = -4e-4
    intensity_per_K2: float = -8e-6
    intensity_per_um: float = 0.004
    intensity_wander: float = 0.002

    def __post_init__(self) -> None:
        for field in dataclasses.fields(self):
            value = getattr(self, field.name)
            if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
                raise InputError(f"beams: {field.name} is {value!r}; it must be a number")

    def shifts_m(self, block_degC: Array, time_s: Array, seed: int) -> tuple[Array, Array]:
        """Positions of the clockwise and the counter-clockwise beam on the detector.

        Parameters
        ----------
        block_degC, time_s : ndarray, shape (n,)
        seed : int

        Returns
        -------
        clockwise_m, counter_clockwise_m : ndarray, shape (n,)
        """
        warmth = block_degC - NOMINAL_DEG_C
        play = Play((self.slip_radius_K,))
        states, _ = play.run(play.init(warmth[0]), warmth)
        mean_um = self.shift_um_K * warmth + self.slip_um_K * (states[:, 0] - warmth)
        mean_um += gauss_markov(self.wander_um, self.wander_correlation_s, time_s, stream(seed, "monitor:beam_wander"))
        mean_um += self._mutations_um(block_degC, time_s, stream(seed, "monitor:mutations"))
        half_um = 0.5 * self.opposite_um_K * warmth
        return 1e-6 * (mean_um + half_um), 1e-6 * (mean_um - half_um)

    def _mutations_um(self, block_degC: Array, time_s: Array, rng: np.random.Generator) -> Array:
        passed_K = np.cumsum(np.abs(rate_per_min(block_degC, time_s))) * (time_s[1] - time_s[0]) / 60.0
        count = rng.poisson(self.mutations_per_100_K * passed_K[-1] / 100.0)
        total = np.zeros(len(time_s))
        for place_K, jump_um in zip(
            np.sort(rng.uniform(0.0, passed_K[-1], count)), rng.normal(0.0, self.mutation_um, count), strict=True
        ):
            row = int(np.searchsorted(passed_K, place_K))
            after_s = time_s[row:] - time_s[row]
            total[row:] += jump_um * 0.5 * (1.0 + np.exp(-after_s / self.mutation_creep_s))
        return total


@dataclasses.dataclass(frozen=True)
class Ambient:
    """A Gauss–Markov process: mean, standard deviation, correlation time, and the noise of one reading."""

    mean: float
    sd: float
    correlation_s: float
    reading_noise: float


AMBIENT: Final[dict[str, Ambient]] = {
    "supply_voltage_V": Ambient(15.0, 0.02, 3600.0, 0.001),
    "discharge_current_a_mA": Ambient(0.65, 0.003, 5400.0, 0.0003),
    "discharge_current_b_mA": Ambient(0.65, 0.003, 5400.0, 0.0003),
    "magnetic_field_uT": Ambient(48.0, 3.0, 4000.0, 0.02),
    "pressure_hPa": Ambient(1013.25, 2.5, 14400.0, 0.03),
}


@dataclasses.dataclass(frozen=True)
class Monitors:
    """Everything that makes the monitors of a run.

    Parameters
    ----------
    plant : ThermalPlant
    beams : Beams
    readout : Readout
    thermometer : PlatinumThermometer
    voltage_noise_V : float
        Noise of one reading of light intensity and readout.
    """

    plant: ThermalPlant = dataclasses.field(default_factory=ThermalPlant)
    beams: Beams = dataclasses.field(default_factory=Beams)
    readout: Readout = dataclasses.field(default_factory=Readout)
    thermometer: PlatinumThermometer = dataclasses.field(default_factory=PlatinumThermometer)
    voltage_noise_V: float = 2e-4

    def simulate(self, programme: Programme, step_s: float, seed: int) -> tuple[pd.DataFrame, pd.DataFrame]:
        """The quantities themselves and their readings: two tables with the same columns.

        Parameters
        ----------
        programme : Programme
        step_s : float
            Sample period.
        seed : int

        Returns
        -------
        actual, recorded : pandas.DataFrame
            The mechanisms act on the first; a recording holds the second.
        """
        samples = sample_count(programme.duration_s, step_s)
        time_s: Array = step_s * np.arange(samples, dtype=np.float64)
        shell, block = self.plant.temperatures(programme.set_point_degC(time_s), step_s)
        cw_m, ccw_m = self.beams.shifts_m(block, time_s, seed)
        a_V, b_V = self.readout.rms_V(cw_m, ccw_m)
        warmth = block - NOMINAL_DEG_C
        intensity = 1.0 + self.beams.intensity_per_K * warmth + self.beams.intensity_per_K2 * warmth**2
        intensity += self.beams.intensity_per_um * 1e6 * cw_m
        intensity += gauss_markov(self.beams.intensity_wander, 2400.0, time_s, stream(seed, "monitor:intensity"))
        actual = {
            TIME: time_s,
            "temperature_block_degC": block,
            "temperature_shell_degC": shell,
            "light_intensity_V": intensity,
            "readout_a_V": a_V,
            "readout_b_V": b_V,
        }
        for name, ambient in AMBIENT.items():
            actual[name] = ambient.mean + gauss_markov(ambient.sd, ambient.correlation_s, time_s, stream(seed, f"monitor:{name}"))
        recorded = {name: self._read(name, values, time_s, seed) for name, values in actual.items()}
        return pd.DataFrame(actual), pd.DataFrame(recorded)

    def _read(self, name: str, values: Array, time_s: Array, seed: int) -> Array:
        rng = stream(seed, f"sensor:{name}")
        if name == TIME:
            return values
        if name.endswith("_degC"):
            return self.thermometer.read(values, time_s, rng)
        noise = AMBIENT[name].reading_noise if name in AMBIENT else self.voltage_noise_V
        return values + noise * rng.standard_normal(len(values))


def gauss_markov(sd: float, correlation_s: float, time_s: Array, rng: np.random.Generator) -> Array:
    """First-order Gauss–Markov process whose correlation falls by e in `correlation_s`.

    Parameters
    ----------
    sd, correlation_s : float
    time_s : ndarray, shape (n,)
    rng : numpy.random.Generator
    """
    decay = math.exp(-(time_s[1] - time_s[0]) / correlation_s)
    innovations = rng.standard_normal(len(time_s))
    innovations[1:] *= math.sqrt(1.0 - decay**2)
    return sd * decaying(np.array([decay]), innovations)
