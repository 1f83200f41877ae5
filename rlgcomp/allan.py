r"""Overlapping Allan deviation of a rate, on data with gaps, and the noise floor that follows from it.

With the angle :math:`\theta_k = \tau_0 \sum_{i<k} \Omega_i` and :math:`\tau = m \tau_0`,

.. math:: \sigma^2(\tau) = \frac{1}{2 \tau^2 M} \sum_k (\theta_{k+2m} - 2\theta_{k+m} + \theta_k)^2

over the M differences whose 2m samples are all there.

References
----------
IEEE Std 647-2006, annex C. W. J. Riley, *Handbook of Frequency Stability Analysis*, NIST SP 1065 (2008), eq. 11.
"""

from __future__ import annotations

import dataclasses

import numpy as np
import numpy.typing as npt
import pandas as pd

from rlgcomp.errors import InputError

Array = npt.NDArray[np.float64]


@dataclasses.dataclass(frozen=True)
class AllanDeviation:
    """Allan deviation against averaging time.

    Parameters
    ----------
    tau_s : ndarray, shape (m,)
    deviation_deg_h : ndarray, shape (m,)
    differences : ndarray, shape (m,)
        Number of second differences that each value rests on.
    """

    tau_s: Array
    deviation_deg_h: Array
    differences: npt.NDArray[np.int64]

    def to_frame(self) -> pd.DataFrame:
        return pd.DataFrame(dataclasses.asdict(self))

    def at(self, tau_s: float) -> float:
        """Deviation at tau, interpolated on the logarithmic plot."""
        return float(np.exp(np.interp(np.log(tau_s), np.log(self.tau_s), np.log(self.deviation_deg_h))))

    def white_noise_deg_h(self, averaging_s: float) -> float:
        r"""Noise that no compensation can remove from means over `averaging_s`.

        The smallest :math:`\sigma(\tau)\sqrt{\tau / T}` over :math:`\tau \le T`. White noise gives the same value at every tau;
        what falls faster (quantization) or rises (drift) only adds, so the smallest is the white part's.
        """
        within = self.tau_s <= averaging_s * (1.0 + 1e-9)
        if not within.any():
            return float(self.deviation_deg_h[0])
        return float(np.min(self.deviation_deg_h[within] * np.sqrt(self.tau_s[within] / averaging_s)))


def allan_deviation(rate_deg_h: npt.ArrayLike, time_s: npt.ArrayLike, tau_s: npt.ArrayLike | None = None) -> AllanDeviation:
    """Overlapping Allan deviation.

    Parameters
    ----------
    rate_deg_h, time_s : array_like, shape (n,)
        Gaps are allowed; no difference spans one.
    tau_s : array_like, optional
        Averaging times, rounded to whole periods; by default about ten a decade, up to a fifth of the record.

    Returns
    -------
    AllanDeviation

    Raises
    ------
    InputError
        Fewer than five samples, or no averaging time that the record can hold.
    """
    rate = np.asarray(rate_deg_h, dtype=np.float64)
    time = np.asarray(time_s, dtype=np.float64)
    if len(rate) < 5 or len(rate) != len(time):
        raise InputError(f"{len(rate)} rates at {len(time)} times; an Allan deviation needs at least five of both")
    period_s = float(np.median(np.diff(time)))
    place = np.rint((time - time[0]) / period_s).astype(np.int64)
    place = np.maximum.accumulate(place)
    present = np.zeros(place[-1] + 1, dtype=np.bool_)
    present[place] = True
    filled = np.zeros(len(present))
    filled[place] = rate - rate.mean()
    angle = np.r_[0.0, np.cumsum(filled)]  # in periods of deg/h
    absent = np.r_[0, np.cumsum(~present)]

    longest = len(present) // 5
    if tau_s is None:
        counts = np.unique(np.rint(np.geomspace(1, max(1, longest), max(2, 10 * int(np.log10(max(longest, 10)))))).astype(np.int64))
    else:
        counts = np.unique(np.rint(np.atleast_1d(np.asarray(tau_s, dtype=np.float64)) / period_s).astype(np.int64))
    rows = []
    for m in counts[(counts >= 1) & (2 * counts < len(angle))].tolist():
        whole = absent[2 * m :] == absent[: -2 * m]
        second = (angle[2 * m :] - 2.0 * angle[m:-m] + angle[: -2 * m])[whole]
        if len(second):
            rows.append((m * period_s, float(np.sqrt(0.5 * np.mean(second**2))) / m, len(second)))
    if not rows:
        raise InputError(f"no averaging time fits a record of {len(rate)} samples every {period_s:g} s")
    taus, deviations, differences = zip(*rows, strict=True)
    return AllanDeviation(np.array(taus), np.array(deviations), np.array(differences, dtype=np.int64))
