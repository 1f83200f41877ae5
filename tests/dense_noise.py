"""The covariance of a noise by its definition, as a referee of the recursions."""

from __future__ import annotations

import numpy as np

from rlgcomp.diagnosis.noise.whitening import NoiseShape, Rows


def dense(rows: Rows, shape: NoiseShape) -> np.ndarray:
    """Covariance by its definition."""
    covariance = np.diag(rows.white).astype(float)
    for part in rows.runs:
        time_s = rows.time_s[part]
        lag = np.abs(time_s[:, None] - time_s)
        since = np.minimum(time_s[:, None], time_s) - time_s[0] + rows.window_s
        for time_constant, stationary, diffusion, swing, at_deg_s in zip(*shape.processes(rows.window_s), strict=True):
            by_rate = rows.rate_deg_s[part] / at_deg_s if at_deg_s else np.ones(len(time_s))
            kept = np.exp(-lag / time_constant) * np.cos(swing * lag)
            covariance[part, part] += diffusion * since + stationary * kept * np.outer(by_rate, by_rate)
    return covariance
