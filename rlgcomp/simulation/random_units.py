"""Gyro units drawn at random, of the kind described in Opt. Express 23, 13320 (2015): no two alike, none tuned to a result."""

from __future__ import annotations

import math
from typing import Final

from rlgcomp.noise.processes import NoiseModel, stream
from rlgcomp.physics.light_intensity import LightIntensity
from rlgcomp.physics.readout_incoherence import ReadoutIncoherence
from rlgcomp.physics.temperature_rate import TemperatureRate
from rlgcomp.physics.thermal_gradient import ThermalGradient
from rlgcomp.physics.thermal_hysteresis import ThermalHysteresis
from rlgcomp.physics.thermal_polynomial import ThermalPolynomial
from rlgcomp.simulation.monitors import Beams, Monitors
from rlgcomp.simulation.simulator import Simulator

SPREAD: Final = 0.3  # standard deviation of the logarithm of every size, unit to unit
# Noise of a navigation-grade gyro; the angle random walk gives 0.0018 deg/h in 100 s, below the source's best 0.0023 deg/h.
NOISE: Final = NoiseModel(
    angle_random_walk_deg_sqrt_h=0.0003,
    bias_instability_deg_h=0.0002,
    rate_random_walk_deg_h_sqrt_h=0.0001,
    quantization_arcsec=0.005,
)


def simulated_unit(seed: int, *, hysteresis: str = "play") -> Simulator:
    """A gyro unit whose sizes are drawn about typical ones (log-normal, 30 %) with random signs.

    Parameters
    ----------
    seed : int
        The unit; runs of one unit differ by the seed of :meth:`Simulator.simulate`.
    hysteresis : {"play", "preisach", "bouc_wen"}
        Law of its thermal hysteresis.
    """
    rng = stream(seed, "unit")

    def about(size: float) -> float:
        return float(size * math.exp(SPREAD * rng.standard_normal()) * rng.choice([-1.0, 1.0]))

    play = [about(2.5e-4) for _ in range(3)]
    mechanisms = (
        ThermalPolynomial(c0_deg_h=about(0.01), c1_deg_h_K=about(1.2e-4), c2_deg_h_K2=about(1e-6), c3_deg_h_K3=about(1e-8)),
        TemperatureRate(k_deg_h_min_K=about(0.008)),
        ThermalGradient(k_deg_h_K=about(2e-4)),
        ThermalHysteresis(
            law=hysteresis, k1_deg_h_K=play[0] if hysteresis == "play" else 2.0 * play[0], k2_deg_h_K=play[1], k3_deg_h_K=play[2]
        ),
        LightIntensity(k_deg_h_V=about(0.1)),
        ReadoutIncoherence(k_deg_h=about(1.1)),
    )
    beams = Beams(
        shift_um_K=about(0.04),
        slip_um_K=about(0.12),
        mutation_um=abs(about(6.0)),
        mutations_per_100_K=2.0,
        intensity_per_K=about(4e-4),
        intensity_per_K2=about(8e-6),
        intensity_per_um=about(0.002),
    )
    return Simulator(mechanisms, noise=NOISE, monitors=Monitors(beams=beams), unit=f"simulated-{seed}")
