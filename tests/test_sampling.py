"""The sample period and the gaps of stamps that are rounded, late or missing."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

import rlgcomp as rlg
from rlgcomp.recording.sampling import FullWindows, Sampling

N = 30000


@pytest.mark.parametrize("period_s", [0.1, 1.0, 1 / 3])
def test_exact_stamps_keep_their_median_step_and_every_gap(period_s: float) -> None:
    time_s = period_s * np.delete(np.arange(N), [100, 5000, 5001, 9000])
    clock = Sampling.of(time_s)
    assert clock.period_s == float(np.median(np.diff(time_s)))
    assert clock.gaps.tolist() == [99, 4998, 8996]


@pytest.mark.parametrize("scatter", [0.01, 0.1])
@pytest.mark.parametrize("missing", [[], [700, 15000]])
def test_scattered_stamps_tell_the_period_and_invent_no_gaps(scatter: float, missing: list[int]) -> None:
    jitter = scatter * np.random.default_rng(1).normal(size=N)
    clock = Sampling.of(np.delete(0.1 * (np.arange(N) + jitter), missing))
    assert clock.period_s == pytest.approx(0.1, rel=1e-6)
    assert clock.gaps.tolist() == [row - 1 - k for k, row in enumerate(missing)]


def test_rounded_stamps_bend_no_rate() -> None:
    true_s, arcsec = 0.10003, 0.8428
    counts = np.diff(np.r_[0.0, np.floor(np.cumsum(np.full(N, 7.2 * true_s)) / arcsec)])
    table = pd.DataFrame({"time_s": np.round(true_s * np.arange(N), 3), "gyro_pulses": counts})
    rate = rlg.Recording(table, rlg.Metadata("static", pulse_arcsec=arcsec)).rate_deg_h()
    assert rate.mean() == pytest.approx(counts.sum() * arcsec / (true_s * N), abs=1e-5)  # deg/h; the median step is off by 2e-3


@pytest.mark.parametrize("periods", [1, 2, 5, 100, 2.5, 10 / 3])
def test_scattered_stamps_leave_each_sample_in_its_window(periods: float) -> None:
    period_s, samples = 0.41138146, np.arange(3000)
    scatter = 0.05 * np.random.default_rng(2).uniform(-1.0, 1.0, len(samples))
    exact, scattered = (
        FullWindows.of(period_s * (samples + late), periods * period_s, period_s, name="run") for late in (0.0, scatter)
    )
    assert np.all(exact.full[:-1])  # the last may be cut short
    np.testing.assert_array_equal(scattered.starts, exact.starts)
    np.testing.assert_array_equal(scattered.full, exact.full)


@pytest.mark.parametrize("digits", [6, 8])
def test_rounded_stamps_drop_no_window(digits: int) -> None:
    period_s = 0.17314526675377873
    time_s = np.array([float(f"{t:.{digits}g}") for t in period_s * np.arange(4000)])
    values = np.random.default_rng(3).normal(size=len(time_s))
    exact, rounded = (
        rlg.Recording(pd.DataFrame({"time_s": t, "gyro_deg_h": values}), rlg.Metadata("static")).averaged(2.0 * period_s)
        for t in (period_s * np.arange(4000), time_s)
    )
    np.testing.assert_array_equal(rounded.column("gyro_deg_h"), exact.column("gyro_deg_h"))
