"""Two small turntable runs for tests of diagnosis, made by other formulas than the package's own."""

from __future__ import annotations

import numpy as np
import pandas as pd

import rlgcomp as rlg

SIMULATOR = rlg.Simulator.from_mapping({"kind": "turntable", "mechanisms": ["scale_factor"]})
RATES = ((0, 0.5, 1, 2, 5, 10, 20, 40, 60), (0.8, 3, 7, 15, 30, 50))
NOISE_1S_DEG_H = 0.018
BIAS_DEG_H = 7.3


def motion(programme: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Rate, angle and temperature every second: 400 s at each rate, each way, 20 deg/s² between."""
    rate, pieces = 0.0, []
    for target in (sign * r for r in RATES[programme] for sign in (1, -1)):
        pieces += [np.linspace(rate, target, int(abs(target - rate) / 20.0), endpoint=False), np.full(400, target)]
        rate = target
    W = np.concatenate(pieces)
    t = np.arange(len(W), dtype=float)
    return W, np.cumsum(W), 22.0 + 3.0 * (1.0 - np.exp(-t / 3000.0)) + np.sin(t / 1400.0)


def locked(W: np.ndarray) -> np.ndarray:
    return np.sign(W) * np.sqrt(np.maximum(W**2 - 0.02**2, 0.0))


EFFECTS = {
    "scale_factor_temperature": lambda W, theta, T: W * (T - 25.0),
    "scale_factor_asymmetry": lambda W, theta, T: W * (W > 0.0),
    "scale_factor_nonlinearity": lambda W, theta, T: W * np.abs(W),
    "scale_factor_nonlinearity, cubic": lambda W, theta, T: W**3,
    "lock_in": lambda W, theta, T: locked(W) - W,
    "lock_in of the total rate": lambda W, theta, T: locked(W + BIAS_DEG_H / 3600.0) - W - BIAS_DEG_H / 3600.0,
    "misalignment": lambda W, theta, T: W * np.sin(np.radians(theta) + 1.0),
    "earth_rate_leak": lambda W, theta, T: np.cos(np.radians(theta) - 0.5),
    "rotation_harmonics": lambda W, theta, T: np.sin(6.0 * np.radians(theta) + 2.0),
    "encoder_delay": lambda W, theta, T: np.gradient(W),
}


def runs(effect: str | None, strength: float = 1.0, *columns: str) -> list[rlg.Recording]:
    """Two runs; the effect's part that a scale factor and a bias do not take has so many times the noise of 100 s means."""
    made = [motion(programme) for programme in (0, 1)]
    errors = [np.zeros(len(W)) if effect is None else 3600.0 * EFFECTS[effect](W, theta, T) for W, theta, T in made]
    if effect is not None and not effect.startswith("lock_in"):
        means = np.concatenate([e[: len(e) // 100 * 100].reshape(-1, 100).mean(axis=1) for e in errors])
        rates = np.concatenate([W[: len(W) // 100 * 100].reshape(-1, 100).mean(axis=1) for W, _, _ in made])
        plain = np.column_stack([rates, np.ones(len(rates))])
        size = np.std(means - plain @ np.linalg.lstsq(plain, means, rcond=None)[0])
        errors = [strength * 0.1 * NOISE_1S_DEG_H / size * e for e in errors]
    recordings = []
    for k, ((W, theta, T), error) in enumerate(zip(made, errors, strict=True)):
        noise = NOISE_1S_DEG_H * np.random.default_rng(k).standard_normal(len(W))
        table = pd.DataFrame(
            {
                "time_s": np.arange(len(W), dtype=float),
                "gyro_deg_s": W * (1.0 + 35e-6) + (BIAS_DEG_H + error + noise) / 3600.0,
                "table_angle_deg": theta % 360.0,
                "table_rate_deg_s": W,
                "temperature_block_degC": T,
            }
        )
        recordings.append(rlg.Recording(table.drop(columns=list(columns)), rlg.Metadata(kind="turntable"), name=f"run{k}"))
    return recordings
