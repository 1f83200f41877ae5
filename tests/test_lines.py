"""Lines of the spectrum in a diagnosis: their frequency, an amplitude that follows a column, and what is smooth but no line."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest
from scipy.ndimage import gaussian_filter1d

import rlgcomp as rlg
from rlgcomp.diagnosis.data import Data, Grid, Run
from rlgcomp.diagnosis.diagnose import Diagnosis, diagnose
from rlgcomp.diagnosis.forms.bases import EachRun
from rlgcomp.diagnosis.forms.terms import Form
from rlgcomp.diagnosis.forms.times import Modulated, Straying, Wave
from rlgcomp.diagnosis.regions.waves import as_wander
from tests.few_monitors import few_monitors

Array = npt.NDArray[np.float64]
PERIOD_S = 1700.0
PROGRAMMES = (
    "start 20, hold 30, ramp -10 1, hold 60, ramp 40 1, hold 60",
    "start 30, hold 50, ramp 0 1, hold 60, ramp 25 1, hold 60",
    "start 25, hold 60, ramp 45 1, hold 60, ramp 10 1, hold 30",
)


def diagnosed(stray: Callable[[rlg.Recording, int], Array], windows: float = 4.0) -> Diagnosis:
    """Of two runs with what no simulator foresees, tested on a third, on windows so many times as long as by default."""
    noise = {"angle_random_walk_deg_sqrt_h": 5e-4}
    simulator = rlg.Simulator.from_mapping({"kind": "chamber", "mechanisms": ["thermal_polynomial"], "noise": noise})
    runs = []
    for k, programme in enumerate(PROGRAMMES):
        run = simulator.simulate(programme, seed=k, step_s=10.0, name=f"run{k}")
        runs.append(few_monitors(run.replace(table=run.table.assign(gyro_deg_h=run.rate_deg_h() + stray(run, k)), truth=None)))
    fitted = rlg.Simulator.from_mapping({"kind": "chamber", "mechanisms": [{"thermal_polynomial": {"degree": 3}}]})
    return diagnose(fitted, runs[:2], runs[2:], window_s=windows * Grid.of(runs).window_s, black_box=False)


def wandering(run: rlg.Recording, k: int) -> Array:
    """A line whose phase strays by some radians in a run."""
    stray = 1.5 * np.sin(2.0 * np.pi * (run.time_s / 9000.0 + 0.3 * k))
    return np.asarray(0.03 * np.sin(2.0 * np.pi * run.time_s / PERIOD_S + stray))


def each_run(run: rlg.Recording, k: int) -> Array:
    return np.asarray(0.01 * np.sin(2.0 * np.pi * run.time_s / PERIOD_S + 2.1 * k))


@pytest.mark.parametrize("stray", [wandering, each_run])
def test_a_line_has_a_frequency(stray: Callable[[rlg.Recording, int], Array]) -> None:
    (finding,) = diagnosed(stray).to_mapping()["findings"]
    assert finding["mechanism"] == "periodic_interference"
    frequency = finding["parameters"]["frequency_hz"]
    assert frequency["unit"] == "Hz"
    assert frequency["value"] == pytest.approx(1.0 / PERIOD_S, abs=4.0 * frequency["sd"])
    assert 0.0 < frequency["sd"] < 0.1 / PERIOD_S
    if stray is wandering:  # of a sine of 1.5 rad and 9000 s
        width = finding["parameters"]["linewidth_hz"]
        assert width["value"] == pytest.approx(1.5 / 9000.0 / np.sqrt(2.0), rel=0.3)


def test_harmonics_of_a_loud_line_follow_its_frequency() -> None:
    """Were they left at the frequency that the periodogram shows, a slow error or a frequency that wanders would make up for it."""

    def stray(run: rlg.Recording, k: int) -> Array:
        turn = 2.0 * np.pi * run.time_s / 1643.0 + 2.1 * k
        return np.asarray(0.1 * (np.sin(turn) + 0.45 * np.sin(2.0 * turn + 1.0) + 0.3 * np.sin(4.0 * turn + 2.0)))

    diagnosis = diagnosed(stray, 2.0)
    assert diagnosis.verdict == "explained"
    assert not diagnosis.decision.wander
    (cause,) = diagnosis.causes
    assert cause.equation == "b = wave of frequency_hz, of a phase in each run"
    frequency = cause.parameters["frequency_hz"]
    assert frequency.value == pytest.approx(1.0 / 1643.0, abs=4.0 * frequency.sd)


def test_the_amplitude_of_a_line_may_follow_a_column() -> None:
    def stray(run: rlg.Recording, k: int) -> Array:
        voltage = run.table["supply_voltage_V"].to_numpy()
        del k
        return np.asarray((0.02 + 1.5 * (voltage - 15.0)) * np.sin(2.0 * np.pi * run.time_s / PERIOD_S))

    diagnosis = diagnosed(stray, 2.0)
    (cause,) = diagnosis.causes
    assert "follows supply_voltage_V" in cause.equation
    assert cause.parameters["frequency_hz"].value == pytest.approx(1.0 / PERIOD_S, rel=0.01)
    assert diagnosis.test is not None
    assert diagnosis.test.augmented_rms < 1.3 * diagnosis.test.noise_floor_rms
    assert diagnosis.file_rms == pytest.approx(diagnosis.test.augmented_rms, rel=0.1)


def smooth(run: rlg.Recording, k: int) -> Array:
    """Two or three turns a run, others in each."""
    found = gaussian_filter1d(np.random.default_rng(k).standard_normal(len(run)), 60.0)
    return np.asarray(0.02 * found / np.std(found))


def oscillating(run: rlg.Recording, k: int) -> Array:
    """Four cycles a run, whose phase strays by radians."""
    u = run.time_s / 13800.0
    stray = 2.5 * np.sin(2.0 * np.pi * (1.3 * u + 0.4 * k)) + 2.1 * k
    return np.asarray(0.02 * np.sin(2.0 * np.pi * 4.0 * u + stray))


def resonant(run: rlg.Recording, k: int) -> Array:
    """White noise through a resonance of quality two: phase and amplitude are forgotten together."""
    frequency = np.fft.rfftfreq(len(run), 10.0)
    drawn = np.random.default_rng(k).standard_normal((2, len(frequency)))
    answer = 1.0 / (PERIOD_S**-2.0 - frequency**2 + 0.5j * frequency / PERIOD_S)
    found = np.fft.irfft(answer * (drawn[0] + 1j * drawn[1]), len(run))
    return np.asarray(0.02 * found / np.std(found))


@pytest.mark.usefixtures("undrawn")
@pytest.mark.parametrize("stray", [smooth, oscillating, resonant])
def test_what_keeps_its_phase_for_less_than_a_cycle_is_no_line(
    stray: Callable[[rlg.Recording, int], Array], tmp_path: Path
) -> None:
    diagnosis = diagnosed(stray)
    assert diagnosis.verdict == "unknown"
    assert not diagnosis.members
    assert diagnosis.decision.wander
    found = diagnosis.to_mapping()
    assert found["unexplained"]["drivers"] == []
    assert diagnosis.slow_error_rms == pytest.approx(0.02 / np.sqrt(2.0), rel=1.5)
    diagnosis.save(tmp_path)
    diagnosis.report(tmp_path / "report.html")
    assert "periodic_interference" not in diagnosis.messages[0].text


def test_a_smooth_course_that_nobody_recorded_is_no_mechanism() -> None:
    """Two or three turns in each of two runs: a loop or a lag of the temperature makes up for them beside noise that is rough."""

    def course(run: rlg.Recording, k: int) -> Array:
        drawn = np.random.default_rng([2680, k]).standard_normal(len(run) + 2000)
        slow = gaussian_filter1d(drawn, 268.0)[1000:-1000]
        return np.asarray(0.015 * slow / np.std(slow))

    diagnosis = diagnosed(course)
    assert diagnosis.verdict == "unknown"
    assert diagnosis.decision.wander
    assert not diagnosis.causes


@pytest.mark.parametrize("cycles", [4, 20])
def test_a_steady_amplitude_is_seen_in_many_pieces_alone(cycles: int) -> None:
    """Phases that stray as fast, over the frequency: chance explains a steady amplitude of four cycles a run, and not of twenty."""
    simulator = rlg.Simulator.from_mapping({"kind": "chamber", "mechanisms": ["thermal_polynomial"]})
    runs = [simulator.simulate(PROGRAMMES[k], seed=k, step_s=10.0, name=f"run{k}") for k in (0, 1)]
    grid = Grid.of(runs)
    data = Data(tuple(Run.of(run, grid, lambda binned: binned.rate_deg_h()) for run in runs))
    knots = 4 * cycles
    wave = Modulated(Wave(cycles / data.longest_s, 0.1 / data.longest_s), knots)
    table = np.array([wave.envelope(one) for one in np.eye(2 * knots)]).T
    turns = np.linspace(0.0, 1.0, len(table))
    weights = []
    for k in range(2):
        phase = 0.28 * cycles / 1.5 * np.sin(2.0 * np.pi * (1.5 * turns + 0.3 * k))  # a frequency of a standard deviation of 0.2
        both = np.vstack([table.real, table.imag])
        weights.append(np.linalg.lstsq(both, np.r_[np.cos(phase), np.sin(phase)], rcond=1e-9)[0])
    form = Form("periodic_interference", "", (EachRun(wave, tuple(run.name for run in runs)),))
    assert (as_wander(form, np.concatenate(weights), data) is None) == (cycles == 20)


def test_a_straying_wave_is_linear_in_the_course_of_its_phase() -> None:
    """Its columns are the derivatives of the wave by amplitude and course; Gauss-Newton steps find it from 0.3 rad off."""
    rng = np.random.default_rng(0)
    simulator = rlg.Simulator.from_mapping({"kind": "chamber", "mechanisms": ["thermal_polynomial"]})
    recording = simulator.simulate(PROGRAMMES[0], seed=0, step_s=10.0, name="run0")
    run = Run.of(recording, Grid.of([recording]), lambda binned: binned.rate_deg_h())
    course = np.array([0.4, *rng.normal(size=6)])
    wave = Straying(Wave(1.0 / PERIOD_S, 1e-6), (("run0", tuple(course)),), 0.3)

    def about(moved: Array) -> Array:
        return np.asarray(np.cos(dataclasses.replace(wave, courses=(("run0", tuple(moved)),)).turn(run)))

    table, step = wave.columns(run), 1e-6
    assert table[:, 0] == pytest.approx(about(course), abs=1e-12)
    for k in range(7):
        moved = course + step * np.eye(7)[k]
        slope = -table[:, 1] if k == 0 else table[:, k + 1] / wave.spread
        assert (about(moved) - about(course)) / step == pytest.approx(slope, abs=1e-5)
    off = course + rng.uniform(-0.3, 0.3, 7)
    found = dataclasses.replace(wave, courses=(("run0", tuple(off)),))
    for _ in range(4):
        weights = np.linalg.lstsq(found.columns(run), 2.0 * about(course), rcond=None)[0]
        found = found.renewed(weights[None])
    assert found.turn(run) == pytest.approx(wave.turn(run), abs=1e-4)


def test_a_loud_line_whose_phase_strays_leaves_no_slow_error(tmp_path: Path) -> None:
    """Ninety times as loud as the noise: neither does its amplitude come and go, nor is its phase rough."""

    def stray(run: rlg.Recording, k: int) -> Array:
        phase = gaussian_filter1d(np.random.default_rng([8, k]).standard_normal(len(run)), 396.0)
        turn = 2.0 * np.pi * run.time_s / PERIOD_S + 1.1 * phase / np.std(phase)
        turned.append(float(np.ptp(turn[[0, -1]]) / np.ptp(run.time_s)))
        return np.asarray(0.357 * (np.sin(turn) + 0.3 * np.sin(2.0 * turn + 1.0)))

    turned: list[float] = []  # in each run on average, rad/s
    diagnosis = diagnosed(stray, 2.0)
    assert diagnosis.verdict == "explained"
    assert not diagnosis.decision.wander
    (cause,) = diagnosis.causes
    assert cause.equation == "b = wave of a steady amplitude, whose frequency wanders about frequency_hz"
    frequency, width = cause.parameters["frequency_hz"], cause.parameters["linewidth_hz"]
    assert frequency.value == pytest.approx(np.mean(turned[:2]) / (2.0 * np.pi), abs=4.0 * frequency.sd)
    assert 0.0 < width.value < 0.35 / PERIOD_S
    diagnosis.save(tmp_path)
    diagnosis.report(tmp_path / "report.html")
    assert rlg.Simulator.from_yaml(tmp_path / "augmented.yaml").mechanisms
