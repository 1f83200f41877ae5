"""Simulated runs of gyros on a rotating table, shared by the tests of the angle random walk under rotation."""

from __future__ import annotations

import numpy as np

import rlgcomp as rlg
from experiments.liu_2019.rotation_table import RotatingGyro, RotationTable, liu_harmonics, simulate_rotation

IDEAL = RotationTable(jitter_deg_s=0.0, encoder_noise_arcsec=0.0, encoder_resolution_arcsec=0.0)
STEADY = RotationTable(jitter_deg_s=0.0)


def gyro(noise: float = 4e-4, seed: int = 0, **changes: object) -> RotatingGyro:
    return RotatingGyro(rlg.NoiseModel(angle_random_walk_deg_sqrt_h=noise), liu_harmonics(seed), **changes)  # type: ignore[arg-type]


def turned(legs: tuple[tuple[float, float], ...], seed: int = 0, noise: float = 4e-4, **changes: object) -> rlg.Recording:
    return simulate_rotation({"z": gyro(noise, seed)}, legs, seed=seed, **changes)  # type: ignore[arg-type]


def angles(revolutions: int, speed_offset: float = 0.0, samples: int = 1200) -> np.ndarray:
    """Table angle in degrees at constant rate, with so many samples a revolution."""
    return 360.0 / samples * (1.0 + speed_offset) * np.arange(revolutions * samples)
