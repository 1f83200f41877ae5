"""Lock-in where a table sweeps through zero, with the integrated phase equation as referee."""

from __future__ import annotations

import dataclasses

import numpy as np
import pandas as pd
import pytest
from scipy import integrate

import rlgcomp as rlg
from experiments.concealed.turntable import INSTANTS, PULSES_PER_DEG, SAMPLE_S, Turn, locked
from rlgcomp.physics.lock_in import LockIn
from rlgcomp.units import SECONDS_PER_HOUR


def at_rates(rate_deg_s: np.ndarray, **metadata: float) -> rlg.Recording:
    table = pd.DataFrame({"time_s": 1.0 + np.arange(len(rate_deg_s)), "table_rate_deg_s": rate_deg_s})
    table["gyro_deg_h"] = SECONDS_PER_HOUR * rate_deg_s
    return rlg.Recording(table, rlg.Metadata(kind="turntable", **metadata), name="sweep")


def sweep(slope_deg_s2: float, first_deg_s: float, samples: int = 41) -> np.ndarray:
    """Mean rates of one-second samples while the table passes through zero."""
    return first_deg_s + slope_deg_s2 * (np.arange(samples) - samples // 2)


@pytest.mark.parametrize("slope", [0.004, 0.05, -0.6])
@pytest.mark.parametrize("first", [0.0, 0.0011, -0.02])
def test_in_a_sweep_the_error_is_the_mean_over_each_sample(slope: float, first: float) -> None:
    law = LockIn(lock_in_deg_s=0.01, acts_on="table")
    rate = sweep(slope, first)

    def error(at: float) -> float:
        return float(np.sign(at) * np.sqrt(max(at**2 - 0.01**2, 0.0)) - at)

    found = law.basis(at_rates(rate))[1:-1, 0]
    for value, middle in zip(found, rate[1:-1], strict=True):
        low, high = middle - 0.5 * abs(slope), middle + 0.5 * abs(slope)
        edges = [edge for edge in (-0.01, 0.01) if low < edge < high]
        total = integrate.quad(error, low, high, points=edges or None, epsabs=1e-13)[0]
        assert value == pytest.approx(SECONDS_PER_HOUR * total / abs(slope), rel=1e-5, abs=1e-6)


@pytest.mark.parametrize("starts_within", [0.0, 0.4])
def test_a_ramp_that_begins_with_a_sample_runs_through_it(starts_within: float) -> None:
    """From rest 0.002 deg/s off, 0.04 deg/s a sample: the angle lost at lock-in by the rates of each instant."""
    law = LockIn(lock_in_deg_s=0.01, acts_on="table", offset_deg_h=7.2)
    instants = 2000
    time_s = (np.arange(20 * instants) + 0.5) / instants - 10.0 - starts_within
    table = 0.04 * np.maximum(time_s, 0.0)
    felt = table + 0.002
    exact = np.where(felt > 0.01, np.sqrt(np.maximum(felt**2 - 0.01**2, 0.0)), 0.0) - felt
    found = law.basis(at_rates(table.reshape(-1, instants).mean(axis=1)))[:, 0]
    expected = SECONDS_PER_HOUR * exact.reshape(-1, instants).mean(axis=1)
    assert found == pytest.approx(expected, abs=0.5 if starts_within == 0.0 else 8.0)  # of 36 deg/h; 16 if it stood


def test_where_the_rate_steps_it_is_the_error_at_the_rate() -> None:
    rate = np.repeat([0.02, -0.02, 5.0, 0.02], 6)
    found = LockIn(lock_in_deg_s=0.01, acts_on="table").basis(at_rates(rate))[:, 0]
    plain = np.sign(rate) * np.sqrt(rate**2 - 0.01**2) - rate
    assert found == pytest.approx(SECONDS_PER_HOUR * plain, rel=1e-9)


def test_passages_through_zero_scatter_as_the_phase_equation_does() -> None:
    """The angle lost in a fast sweep, over many phases at which it begins: its spread is what the law leaves open."""
    lock_in, slope = 4e-4, 0.02
    edges = slope * SAMPLE_S * ((np.arange(41 * INSTANTS) + 0.5) / INSTANTS - 20.5)
    lost = []
    for phase in np.random.default_rng(3).uniform(0.0, 2.0 * np.pi, 300):
        lead_in = np.full(INSTANTS, edges[0] + phase / (2.0 * np.pi * PULSES_PER_DEG))  # a second at another rate turns the phase
        rate = np.r_[lead_in, edges].reshape(-1, INSTANTS)
        error = locked(Turn(rate, np.zeros_like(rate), 0.0), lock_in)
        lost.append(error[1:].sum() * SAMPLE_S / SECONDS_PER_HOUR)
    law = dataclasses.replace(LockIn(), lock_in_deg_s=lock_in, acts_on="table")
    run = at_rates(sweep(slope, 0.0), pulse_arcsec=SECONDS_PER_HOUR / PULSES_PER_DEG)
    scatter_deg = law.scatter(run) * SAMPLE_S / SECONDS_PER_HOUR
    through = scatter_deg[:, scatter_deg.sum(axis=0) > 1e-12]  # the angle within a beat comes back
    assert np.count_nonzero(through) == 1
    assert np.std(lost) == pytest.approx(float(through.sum()), rel=0.15)  # 4 % by chance, and higher orders


def test_where_a_sample_ends_within_a_beat_the_angle_is_ahead_or_behind() -> None:
    """At twice the lock-in rate: the angle at the ends of samples against its mean course, over many samples."""
    lock_in, rate_deg_s = 4e-4, 8.13e-4
    rate = np.full((400, INSTANTS), rate_deg_s)
    error = locked(Turn(rate, np.zeros_like(rate), 0.0), lock_in)
    angle_deg = np.cumsum(error) * SAMPLE_S / SECONDS_PER_HOUR
    steady = np.polyval(np.polyfit(np.arange(400), angle_deg, 1), np.arange(400))
    law = LockIn(lock_in_deg_s=lock_in, acts_on="table")
    scatter = law.scatter(at_rates(np.full(400, rate_deg_s), pulse_arcsec=SECONDS_PER_HOUR / PULSES_PER_DEG))
    ahead_deg = np.abs(scatter).max() * SAMPLE_S / SECONDS_PER_HOUR
    assert ahead_deg == pytest.approx(np.std(angle_deg - steady), rel=0.3)


def test_a_table_that_does_not_sweep_leaves_nothing_open() -> None:
    assert not LockIn(acts_on="table").scatter(at_rates(np.repeat([1.0, -1.0, 3.0], 9))).any()
    assert not LockIn(acts_on="table", offset_deg_h=9.0).scatter(at_rates(np.zeros(30))).any()
