r"""One gyro in a chamber, what is there and what its sensors record: four thermal nodes, wandering supplies, two beams.

.. math::

    C_s \dot T_s &= G_{as}(T_a - T_s) + G_{sm}(T_m - T_s) + G_{sb}(T_b - T_s) + P_s \\
    C_m \dot T_m &= G_{am}(T_a - T_m) + G_{sm}(T_s - T_m) + G_{mb}(T_b - T_m) \\
    C_b \dot T_b &= G_{sb}(T_s - T_b) + G_{mb}(T_m - T_b) + P_b

The heavy mount stands in the chamber's air too and the electronics' heat wanders, so the block's rate of change and its
difference to the shell are not one and the same. Times are those of a chamber of hours here; a case stretches them all alike
(:class:`experiments.concealed.logger.Scale`).
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping

import numpy as np
import numpy.typing as npt
from scipy import interpolate, linalg, signal, special

from experiments.concealed.programmes import COLDEST_DEG_C, HOTTEST_DEG_C, random_programme
from rlgcomp.simulation.programme import Programme

Array = npt.NDArray[np.float64]
WINDOW_S = 100.0
NOMINAL_DEG_C = 20.0

# mean, wander, correlation time in s
SUPPLIES = {
    "supply_voltage_V": (15.0, 0.02, 3600.0),
    "discharge_current_a_mA": (0.65, 0.003, 5400.0),
    "discharge_current_b_mA": (0.65, 0.003, 5400.0),
    "magnetic_field_uT": (48.0, 3.0, 4000.0),
    "pressure_hPa": (1010.0, 2.5, 14400.0),
    "humidity_percent": (45.0, 6.0, 5000.0),
}


@dataclasses.dataclass(frozen=True)
class Chamber:
    """What is there in one run.

    Parameters
    ----------
    time_s : ndarray, shape (n,)
    rate_K_min : ndarray, shape (n,)
        Rate of change of the block's temperature.
    monitors : mapping of str to ndarray, shape (n,)
        By column.
    history_degC : ndarray
        Temperatures between which the block went before the run.
    """

    time_s: Array
    rate_K_min: Array
    monitors: dict[str, Array]
    history_degC: Array

    def __getitem__(self, column: str) -> Array:
        return self.monitors[column]

    @property
    def block(self) -> Array:
        return self.monitors["temperature_block_degC"]

    @property
    def step_s(self) -> float:
        return float(self.time_s[1] - self.time_s[0])

    def with_monitors(self, monitors: Mapping[str, Array]) -> Chamber:
        """The same run with some monitors changed."""
        return dataclasses.replace(self, monitors={**self.monitors, **monitors})


@dataclasses.dataclass(frozen=True)
class Unit:
    """A gyro unit in its chamber, all sizes drawn about typical ones; runs differ by their generators.

    Before its first run the unit rested at room temperature, after ever smaller swings; or it went between random temperatures
    before every run; or each run begins where the one before it ended.
    """

    capacities_J_K: Array  # shell, mount, block
    conductances_W_K: dict[str, float]
    heat_W: Array  # into the shell and the block
    heat_wander: float  # of the electronics' heat into the shell, relative
    air_time_constant_s: float
    beam_um_K: float
    intensity_per_K: float
    intensity_per_K2: float
    warmth: dict[str, float]  # wander of a supply per 100 K of the block
    step_s: float
    before: str

    @classmethod
    def draw(cls, rng: np.random.Generator) -> Unit:
        """A unit."""
        return cls(
            capacities_J_K=rng.uniform([1500.0, 35000.0, 1800.0], [3500.0, 80000.0, 3200.0]),
            conductances_W_K={
                "as": rng.uniform(5.0, 10.0),
                "am": rng.uniform(6.0, 12.0),
                "sm": rng.uniform(0.1, 0.5),
                "sb": rng.uniform(3.0, 6.0),
                "mb": rng.uniform(1.5, 6.0),
            },
            heat_W=rng.uniform([2.0, 0.8], [8.0, 2.0]),
            heat_wander=rng.uniform(0.1, 0.4),
            air_time_constant_s=rng.uniform(100.0, 300.0),
            beam_um_K=rng.normal(0.0, 0.08),
            intensity_per_K=rng.normal(0.0, 5e-4),
            intensity_per_K2=rng.normal(0.0, 6e-6),
            warmth={
                name: rng.normal(0.0, 0.5) for name in ("supply_voltage_V", "discharge_current_a_mA", "discharge_current_b_mA")
            },
            step_s=float(rng.choice([5.0, 10.0, 20.0])),
            before=str(rng.choice(["rest", "cycles", "the run before"])),
        )

    def run(self, rng: np.random.Generator, programme: str | None = None, previous: Chamber | None = None) -> Chamber:
        """One run, on a random programme unless one is given; `previous` is the run before it."""
        corners_s, corners_degC = random_programme(rng) if programme is None else Programme.parse(programme).corners
        windows = math.floor(corners_s[-1] / WINDOW_S)
        time_s: Array = self.step_s * np.arange(round(windows * WINDOW_S / self.step_s))
        shell_W = self.heat_W[0] * (1.0 + self.heat_wander * wander(time_s, 5400.0, rng))
        shell, mount, block = self._temperatures(np.interp(time_s, corners_s, corners_degC), shell_W)
        rate_K_min = 60.0 * np.asarray(interpolate.CubicSpline(time_s, block)(time_s, 1))
        temperatures = {"temperature_block_degC": block, "temperature_shell_degC": shell, "temperature_mount_degC": mount}
        history = self._history(rng, float(block[0]), previous)
        warm = temperatures["temperature_block_degC"] - NOMINAL_DEG_C
        supplies = {}
        for name, (mean, sd, correlation_s) in SUPPLIES.items():
            supplies[name] = mean + sd * (wander(time_s, correlation_s, rng) + self.warmth.get(name, 0.0) * warm / 100.0)
        beam_um = self.beam_um_K * warm + 0.7 * wander(time_s, 3000.0, rng) + creeping_jumps(time_s, 2.5, rng)
        intensity = 1.0 + self.intensity_per_K * warm + self.intensity_per_K2 * warm**2 + 0.003 * beam_um
        intensity += 0.002 * wander(time_s, 2400.0, rng)
        a, b = two_halves(beam_um)
        optics = {"light_intensity_V": intensity, "readout_a_V": a * intensity, "readout_b_V": b * intensity}
        return Chamber(time_s, rate_K_min, {**temperatures, **optics, **supplies}, history)

    def _history(self, rng: np.random.Generator, first_degC: float, previous: Chamber | None) -> Array:
        cycles = swings_degC(rng)
        if self.before == "rest":
            return np.asarray(first_degC + 150.0 * (-0.9) ** np.arange(60))
        if self.before == "cycles" or previous is None:
            return cycles
        turns = np.flatnonzero(np.diff(np.sign(previous.rate_K_min), prepend=0.0))
        return np.r_[previous.history_degC, previous.block[turns], previous.block[-1]]

    def _temperatures(self, set_point_degC: Array, shell_W: Array) -> tuple[Array, Array, Array]:
        g = self.conductances_W_K
        a = np.array(
            [
                [-1.0 / self.air_time_constant_s, 0.0, 0.0, 0.0],
                [g["as"], -g["as"] - g["sm"] - g["sb"], g["sm"], g["sb"]],
                [g["am"], g["sm"], -g["am"] - g["sm"] - g["mb"], g["mb"]],
                [0.0, g["sb"], g["mb"], -g["sb"] - g["mb"]],
            ]
        )
        a[1:] /= self.capacities_J_K[:, None]
        b = np.diag([1.0 / self.air_time_constant_s, *1.0 / self.capacities_J_K])[:, [0, 1, 3]]
        grown = linalg.expm(np.block([[a, b], [np.zeros((3, 7))]]) * self.step_s)
        phi, gamma = grown[:4, :4], grown[:4, 4:]
        state = np.full(4, set_point_degC[0])
        states = np.empty((len(set_point_degC), 4))
        states[0] = state
        inputs = np.column_stack([set_point_degC, shell_W, np.full(len(shell_W), self.heat_W[1])])
        drive = 0.5 * (inputs[1:] + inputs[:-1]) @ gamma.T
        for k, push in enumerate(drive, start=1):
            state = phi @ state + push
            states[k] = state
        return states[:, 1], states[:, 2], states[:, 3]


def swings_degC(rng: np.random.Generator) -> Array:
    """Random temperatures between which a unit went before a run."""
    return rng.uniform(COLDEST_DEG_C - 10.0, HOTTEST_DEG_C + 10.0, int(rng.integers(2, 9)))


def wander(time_s: Array, correlation_s: float, rng: np.random.Generator) -> Array:
    """Slow wander of about unit size: an Ornstein–Uhlenbeck process, a sine of some hours, and up to three steps."""
    keep = math.exp(-(time_s[1] - time_s[0]) / correlation_s)
    kicks = rng.standard_normal(len(time_s)) * math.sqrt(1.0 - keep**2)
    kicks[0] = rng.standard_normal()
    total = 0.8 * signal.lfilter([1.0], [1.0, -keep], kicks)
    total += rng.uniform(0.0, 0.7) * np.sin(2.0 * math.pi * time_s / rng.uniform(3600.0, 21600.0) + rng.uniform(0.0, 2.0 * math.pi))
    for _ in range(int(rng.integers(0, 4))):
        total += rng.normal(0.0, 0.6) * (time_s > rng.uniform(0.0, time_s[-1]))
    return np.asarray(total)


def creeping_jumps(time_s: Array, size: float, rng: np.random.Generator) -> Array:
    """Up to three jumps that creep back to half their size."""
    total = np.zeros(len(time_s))
    for _ in range(int(rng.integers(0, 4))):
        since_s = time_s - rng.uniform(0.0, time_s[-1])
        total += np.where(since_s >= 0.0, rng.normal(0.0, size) * 0.5 * (1.0 + np.exp(-np.maximum(since_s, 0.0) / 1800.0)), 0.0)
    return total


def two_halves(beam_um: Array, radius_um: float = 500.0, inner_um: float = 40.0, outer_um: float = 540.0) -> tuple[Array, Array]:
    """Share of a Gaussian beam on each half of a split detector, 1 for a centred beam."""

    def share(side: float) -> Array:
        edges = [math.sqrt(2.0) * (edge - side * beam_um) / radius_um for edge in (inner_um, outer_um)]
        return np.asarray(special.erf(edges[1]) - special.erf(edges[0]))

    centred = special.erf(math.sqrt(2.0) * outer_um / radius_um) - special.erf(math.sqrt(2.0) * inner_um / radius_um)
    return share(1.0) / centred, share(-1.0) / centred
