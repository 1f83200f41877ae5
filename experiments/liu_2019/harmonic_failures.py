"""How not to do it: treatments of the harmonics and fits of the Allan variance that bias N (seed-mathematics.md, §2)."""

from __future__ import annotations

import warnings

import numpy as np
from scipy import optimize

from experiments.liu_2019.rotation_table import LIU_ORDERS
from rlgcomp.errors import InputError
from rlgcomp.noise.allan_deviation import AllanDeviation, allan_deviation, fit_coefficients
from rlgcomp.noise.angle_harmonics import fit_harmonics, spectra, without
from rlgcomp.noise.encoder import middle_deg, table_angle_deg
from rlgcomp.noise.spectral_fit import fit_widest, periodogram
from rlgcomp.recording import Recording


def failure_row(made: Recording, treatment: str) -> dict[str, float]:
    """N in deg/sqrt(h) by every fit, after one treatment of the harmonics of the recording's first gyro."""
    rate = made.rate_deg_h(made.gyro_columns[0])
    x = np.linspace(-1.0, 1.0, len(rate))
    rate = rate - np.polynomial.legendre.Legendre.fit(x[::200], np.add.reduceat(rate, np.arange(0, len(rate), 200)) / 200, 5)(x)
    angle = middle_deg(table_angle_deg(made))
    per_turn = round(360.0 / abs(angle[-1] - angle[0]) * (len(angle) - 1))
    if treatment == "global":
        (spectrum,) = spectra([rate], angle)
        rate = without(rate, angle, fit_harmonics(rate, angle, spectrum))
    elif treatment == "reshaped":  # every revolution has exactly 1200 samples: the mean revolution is taken out
        turns = rate[: len(rate) // per_turn * per_turn].reshape(-1, per_turn)
        rate = (turns - turns.mean(axis=0)).ravel()
    elif treatment.endswith(("revolution", "revolutions")):
        rate = _piecewise(rate, angle, per_turn * int(treatment.split(maxsplit=1)[0]))
    seconds = rate[: len(rate) // 200 * 200].reshape(-1, 200).mean(axis=1)
    curve = allan_deviation(seconds, np.arange(float(len(seconds))))
    found = periodogram(rate, np.arange(len(rate)), made.period_s, 2.0)
    return {
        "spectrum (ours)": fit_widest(found, leave_out=np.zeros(len(found.density), dtype=bool)).angle_random_walk_deg_sqrt_h,
        "five terms, covariance": _covariance_fit(curve),
        **_five_term_fits(curve),
    }


def _piecewise(rate: np.ndarray, angle_deg: np.ndarray, rows: int) -> np.ndarray:
    """The paper's fit (eq. 16) in every piece by itself: twenty columns of every 1200 degrees of freedom go with it."""
    clean = np.array(rate)
    for start in range(0, len(rate) - rows + 1, rows):
        part = slice(start, start + rows)
        phase = np.radians(np.outer(np.remainder(angle_deg[part], 360.0), LIU_ORDERS))
        design = np.hstack([np.cos(phase), np.sin(phase)])
        clean[part] -= design @ np.linalg.solve(design.T @ design, design.T @ rate[part])
    return clean


def _covariance_fit(curve: AllanDeviation) -> float:
    try:
        return fit_coefficients(curve).angle_random_walk_deg_sqrt_h
    except (InputError, np.linalg.LinAlgError):
        return float("nan")


def _five_term_fits(curve: AllanDeviation) -> dict[str, float]:
    """N by the fits one meets; a negative N² is shown as minus the root of its size."""
    tau, variance = curve.tau_s, curve.deviation_deg_h**2
    design = tau[:, None] ** np.array([-2.0, -1.0, 0.0, 1.0, 2.0])
    size = np.linalg.norm(design, axis=0)

    def weighted(weight: np.ndarray, *, positive: bool) -> float:
        left = design * weight[:, None]
        scale = np.linalg.norm(left, axis=0)
        right = variance * weight
        found = optimize.nnls(left / scale, right)[0] if positive else np.linalg.lstsq(left / scale, right, rcond=None)[0]
        square = float((found / scale)[1])
        return float(np.sign(square) * np.sqrt(abs(square)) / 60.0)

    def logarithmic(logs: np.ndarray) -> np.ndarray:
        return np.log((design / size) @ np.exp(logs)) - np.log(variance)

    start = np.log(np.maximum(optimize.nnls(design / size / variance[:, None], np.ones(len(tau)))[0], 1e-12))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)
        logs = optimize.least_squares(logarithmic, start, max_nfev=200).x
    short = tau <= 100.0
    return {
        "NNLS, edf weights": weighted(np.sqrt(curve.edf / 2.0) / variance, positive=True),
        "at τ = 1 s": float(np.sqrt(variance[0] * tau[0]) / 60.0),
        "slope, τ ≤ 100 s": float(np.sqrt(np.mean(variance[short] * tau[short])) / 60.0),
        "OLS": weighted(np.ones(len(tau)), positive=False),
        "relative LS": weighted(1.0 / variance, positive=False),
        "log space": float(np.sqrt(np.exp(logs[1]) / size[1]) / 60.0),
    }
