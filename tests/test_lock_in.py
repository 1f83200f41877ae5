"""Lock-in where a table sweeps through zero, with the integrated phase equation as referee."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
from scipy import integrate

import rlgcomp as rlg
from experiments.concealed import turntable
from experiments.concealed.turntable import PULSES_PER_DEG, SAMPLE_S, Turn, locked
from rlgcomp.physics.lock_in import LockIn
from rlgcomp.units import SECONDS_PER_HOUR

FINE = 400  # instants a sample, where a table sets off


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
    """Where pulses are so fine that many beats pass before the rate changes."""
    law = LockIn(lock_in_deg_s=0.01, acts_on="table")
    rate = sweep(slope, first)

    def error(at: float) -> float:
        return float(np.sign(at) * np.sqrt(max(at**2 - 0.01**2, 0.0)) - at)

    found = law.basis(at_rates(rate, pulse_arcsec=1e-4))[1:-1, 0]
    for value, middle in zip(found, rate[1:-1], strict=True):
        low, high = middle - 0.5 * abs(slope), middle + 0.5 * abs(slope)
        edges = [edge for edge in (-0.01, 0.01) if low < edge < high]
        total = integrate.quad(error, low, high, points=edges or None, epsabs=1e-13)[0]
        assert value == pytest.approx(SECONDS_PER_HOUR * total / abs(slope), rel=1e-5, abs=1e-6)


@pytest.mark.parametrize("starts_within", [0.0, 0.4, 0.75])
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
    assert found == pytest.approx(expected, abs=0.5)  # of 36 deg/h; 16 if it stood, 8 if it ran through the sample
    backwards = law.basis(at_rates(table.reshape(-1, instants).mean(axis=1)[::-1]))[:, 0]
    assert backwards == pytest.approx(expected[::-1], abs=0.5)


def test_a_recording_that_begins_and_ends_in_a_sweep_has_the_same_basis() -> None:
    law = LockIn(lock_in_deg_s=0.01, acts_on="table", offset_deg_h=3.0)
    rate = sweep(0.05, 0.011)
    whole, piece = law.basis(at_rates(rate)), law.basis(at_rates(rate[18:23]))
    assert piece == pytest.approx(whole[18:23], rel=1e-9)


@pytest.mark.parametrize("rests", [0, 5])
def test_the_offset_is_estimated_from_all_rows(rests: int) -> None:
    """Of a slow swing no steady row is slow, and of a table that rests for five samples hardly one."""
    time_s = np.arange(3000.0)
    swing = 60.0 * np.sin(2.0 * np.pi * time_s / 900.0)
    rate = np.r_[np.repeat([20.0, -40.0, 60.0, -7.0], 700), np.zeros(rests)] if rests else swing
    run = at_rates(rate)
    gyro = run.rate_deg_h() + 55.6 + LockIn(0.06, acts_on="table", offset_deg_h=55.6).basis(run)[:, 0]
    shown = rlg.Recording(run.table.assign(gyro_deg_h=gyro), rlg.Metadata(kind="turntable"))
    offsets = {one.offset_deg_h for one in LockIn.grid((shown,)) if one.acts_on == "total"}
    assert list(offsets) == pytest.approx([55.6], abs=0.05)


def test_where_the_rates_do_not_determine_the_offset_the_latitude_does() -> None:
    run = at_rates(np.repeat([20.0, -20.0, 60.0], 50), latitude_deg=30.0)
    offsets = {one.offset_deg_h for one in LockIn.grid((run,)) if one.acts_on == "total"}
    assert list(offsets) == pytest.approx([7.52], abs=0.01)


def test_where_the_rate_steps_it_is_the_error_at_the_rate() -> None:
    rate = np.repeat([0.02, -0.02, 5.0, 0.02], 6)
    found = LockIn(lock_in_deg_s=0.01, acts_on="table").basis(at_rates(rate))[:, 0]
    plain = np.sign(rate) * np.sqrt(rate**2 - 0.01**2) - rate
    assert found == pytest.approx(SECONDS_PER_HOUR * plain, rel=1e-9)


@pytest.fixture
def fine_instants(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(turntable, "INSTANTS", FINE)


def swept(slope_deg_s2: float, first_deg_s: float, lock_in_deg_s: float, phases: int) -> tuple[np.ndarray, rlg.Recording]:
    """Errors in deg/h of the samples of a sweep, by phases at which it begins, evenly spread; and its recording."""
    rate = sweep(slope_deg_s2, first_deg_s)
    within = (np.arange(FINE) + 0.5) / FINE - 0.5
    course = rate[:, None] + slope_deg_s2 * SAMPLE_S * within
    errors = []
    for turn in (np.arange(phases) + 0.5) / phases:
        lead_in = np.full((1, FINE), course[0, 0] + turn / (PULSES_PER_DEG * SAMPLE_S))
        whole = np.vstack([lead_in, course])
        errors.append(locked(Turn(whole, np.zeros_like(whole), 0.0), lock_in_deg_s)[1:])
    return np.array(errors), at_rates(rate, pulse_arcsec=SECONDS_PER_HOUR / PULSES_PER_DEG)


@pytest.mark.usefixtures("fine_instants")
@pytest.mark.parametrize("lock_in", [4e-4, 2e-3])
def test_a_passage_that_is_too_fast_to_lock_loses_less(lock_in: float) -> None:
    """The mean over phases of each sample; W_L is a third of the rate below which there is no beat, or more than that."""
    errors, run = swept(0.02, 0.01, lock_in, 60)
    expected = errors.mean(axis=0)[1:-1]
    found = LockIn(lock_in_deg_s=lock_in, acts_on="table").basis(run)[1:-1, 0]
    assert found == pytest.approx(expected, abs=0.05 * np.abs(expected).max())


def course(targets_deg_s: list[float], seconds: int, *, smooth: bool, begins_s: float) -> np.ndarray:
    """Rates at the instants of one-second samples, each target for a while; between them 2 deg/s² even, or sine-shaped."""
    pieces, now = [np.zeros(round((200.0 + begins_s) * FINE))], 0.0
    for target in targets_deg_s:
        count = round(abs(target - now) / 2.0 * FINE)
        way = (np.arange(count) + 0.5) / max(count, 1)
        pieces += [now + (target - now) * (0.5 - 0.5 * np.cos(np.pi * way) if smooth else way), np.full(seconds * FINE, target)]
        now = target
    rate = np.concatenate(pieces)
    return rate[: len(rate) // FINE * FINE].reshape(-1, FINE)


def gyro_on(rate_deg_s: np.ndarray, lock_in_deg_s: float, felt_deg_h: float, seed: int) -> rlg.Recording:
    """What a gyro of 8 deg/h bias shows: by the phase equation where the table speeds up, by the mean over a beat elsewhere."""
    felt = rate_deg_s + felt_deg_h / SECONDS_PER_HOUR
    error = np.sign(felt[:, 0]) * np.sqrt(np.maximum(felt[:, 0] ** 2 - lock_in_deg_s**2, 0.0)) - felt[:, 0]
    error *= SECONDS_PER_HOUR
    moving = np.flatnonzero(np.ptp(rate_deg_s, axis=1))
    for ramp in np.split(moving, np.flatnonzero(np.diff(moving) > 1) + 1):
        error[ramp] = locked(Turn(felt[ramp], np.zeros_like(felt[ramp]), 0.0), lock_in_deg_s)
    mean = rate_deg_s.mean(axis=1)
    noise = 0.02 * np.random.default_rng(seed).standard_normal(len(mean))
    shown = SECONDS_PER_HOUR * mean * (1.0 + 5e-6) + 8.0 + error + noise
    table = at_rates(mean).table.assign(gyro_deg_h=shown)
    return rlg.Recording(table, rlg.Metadata(kind="turntable"), name=f"run{seed}")


@pytest.mark.parametrize(("acts_on", "smooth"), [("table", False)])
def test_of_a_table_that_rests_and_turns_one_way_the_lock_in_rate_is_right(
    acts_on: str, smooth: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In one direction the bias holds lock-in's own deficit, and the samples in which the table sets off hold most of its error."""
    monkeypatch.setattr(turntable, "INSTANTS", FINE)
    simulator = rlg.Simulator.from_mapping({"kind": "turntable", "mechanisms": ["scale_factor"]})
    programmes = ([5.0, 10.0, 20.0, 40.0, 0.0], [30.0, 15.0, 7.0, 0.0])
    runs = [
        gyro_on(course(one, 300, smooth=smooth, begins_s=0.3), 0.05, 8.0 * (acts_on == "total"), seed)
        for seed, one in enumerate(programmes)
    ]
    found = rlg.diagnose(simulator, runs, black_box=False)
    (cause,) = found.causes
    assert (found.verdict, cause.name) == ("explained", "lock_in")
    estimate = cause.parameters["lock_in_deg_s"]
    assert abs(estimate.value - 0.05) < 4.0 * estimate.sd
    assert estimate.sd < 5e-4
    (law,) = cause.terms()
    assert isinstance(law, LockIn)
    assert law.acts_on == acts_on
    assert law.offset_deg_h == pytest.approx(8.0 if acts_on == "total" else 0.0, abs=0.02)


def test_passages_through_zero_separate_laws_that_two_rates_do_not(monkeypatch: pytest.MonkeyPatch) -> None:
    """At two rates each way a cubic scale factor is as good as lock-in, but not while the table reverses."""
    monkeypatch.setattr(turntable, "INSTANTS", FINE)
    simulator = rlg.Simulator.from_mapping({"kind": "turntable", "mechanisms": ["scale_factor"]})
    runs = []
    for seed, size in enumerate((10.0, 30.0)):
        whole = gyro_on(course([size, -size] * 3, 300, smooth=False, begins_s=0.0), 0.05, 0.0, seed)
        runs.append(whole.replace(table=whole.table[whole.table["time_s"] > 260.0].reset_index(drop=True)))
    found = rlg.diagnose(simulator, runs, black_box=False)
    assert [cause.name for cause in found.causes] == ["lock_in"]
    estimate = found.causes[0].parameters["lock_in_deg_s"]
    assert abs(estimate.value - 0.05) < 4.0 * estimate.sd
