"""Errors of the drivers: how they are estimated, that they join the noise, and that they are not taken for physics."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pandas as pd
import pytest

from rlgcomp.diagnosis.answer.posterior import Posterior
from rlgcomp.diagnosis.data import Data, Grid, Run
from rlgcomp.diagnosis.decide import decided
from rlgcomp.diagnosis.diagnose import Diagnosis, diagnose
from rlgcomp.diagnosis.evidence.closed_form import Member
from rlgcomp.diagnosis.forms.bases import Smooth
from rlgcomp.diagnosis.forms.drivers import Driver, Path
from rlgcomp.diagnosis.forms.memories import Relays
from rlgcomp.diagnosis.forms.terms import Form, Region
from rlgcomp.diagnosis.noise.errors import Errors, errors_of
from rlgcomp.diagnosis.noise.model import Noise
from rlgcomp.diagnosis.search.states import State
from rlgcomp.numerics.readings import Readings, bin_of_each, noise_variance, readings_of, rounding_step, smoothed
from rlgcomp.recording import Metadata, Recording
from rlgcomp.simulation.simulator import Simulator
from tests.few_monitors import FEWER, few_monitors

STATIC: dict[str, Any] = {"kind": "chamber", "mechanisms": [{"thermal_polynomial": {"degree": 3}}]}


def wandering(samples: int, correlation: float, rng: np.random.Generator) -> np.ndarray[Any, np.dtype[np.float64]]:
    """An Ornstein–Uhlenbeck process of unit size."""
    from scipy.signal import lfilter

    keep = np.exp(-1.0 / correlation)
    kicks = rng.standard_normal(samples) * np.r_[1.0, np.full(samples - 1, np.sqrt(1.0 - keep**2))]
    return np.asarray(lfilter([1.0], [1.0, -keep], kicks))


def made(seed: int, *, slope: float, read_noise: float, step_K: float = 0.0) -> list[Recording]:
    """Runs whose gyro follows the square of the light; of monitors that are read with noise, and a thermometer that rounds."""
    runs = []
    for k in range(2):
        rng = np.random.default_rng([seed, k])
        time_s = 10.0 * np.arange(3000)
        corners = [-1.0, -1.0, 1.2, 1.2, -0.5, -0.5, 0.5][:: 1 - 2 * k]
        block = 20.0 + 30.0 * np.interp(time_s, [0.0, 3e3, 9e3, 12e3, 19e3, 23e3, 3e4], corners)
        light, beam, supply = (wandering(3000, 200.0, rng) for _ in range(3))
        gyro = 0.02 * (block - 20.0) + slope * light**2 + np.sqrt(10.0) * rng.standard_normal(3000)
        read = block + 0.003 * rng.standard_normal(3000)
        table = {
            "time_s": time_s,
            "gyro_deg_h": gyro,
            "temperature_block_degC": np.round(read / step_K) * step_K if step_K else read,
            "light_intensity_V": 1.0 + 0.01 * (light + read_noise * rng.standard_normal(3000)),
            "readout_a_V": 1.0 + 0.01 * (light + beam + read_noise * rng.standard_normal(3000)),
            "supply_voltage_V": 15.0 + supply,
        }
        runs.append(Recording(pd.DataFrame(table), Metadata(kind="chamber"), name=f"run{k}"))
    return runs


def test_noise_of_readings_is_not_wander() -> None:
    rng = np.random.default_rng(1)
    course = wandering(20_000, 300.0, rng)
    assert noise_variance(course) < 2e-4
    assert noise_variance(course + 0.2 * rng.standard_normal(20_000)) == pytest.approx(0.04, rel=0.1)


def test_a_rounded_column_tells_its_step() -> None:
    values = np.linspace(0.0, 20.0, 5000)
    assert rounding_step(values) == 0.0
    assert rounding_step(np.round(values / 0.25) * 0.25) == pytest.approx(0.25)


@pytest.mark.parametrize("diffuses", [True, False])
@pytest.mark.parametrize("noise", [0.002, 0.1])
def test_the_course_behind_rounded_readings_is_nearer_the_driver(noise: float, diffuses: bool) -> None:
    rng = np.random.default_rng(4)
    driver = 20.0 + 15.0 * np.interp(
        np.arange(3000), [0.0, 400.0, 1200.0, 1700.0, 2600.0, 3000.0], [0.0, 0.02, 1.0, 1.03, -0.6, -0.6]
    )
    read = np.round(driver + noise * rng.standard_normal(3000))
    readings = Readings.of(read, read.reshape(600, 5).mean(axis=1), diffuses=diffuses)
    left = (readings.values - driver.reshape(600, 5).mean(axis=1)) ** 2
    assert left.mean() < 0.5 * np.mean((read - driver) ** 2)
    stated = float(np.mean(readings.variance + readings.rounding))
    assert left.mean() < 2.0 * stated < 1.2 / 12.0


@pytest.mark.parametrize("samples", [6000, 5997])  # the last bin is full or not
def test_a_warm_up_read_in_whole_kelvin_is_known_to_a_fiftieth(samples: int) -> None:
    rng = np.random.default_rng(4)
    time = np.arange(samples, dtype=np.float64)
    driver = -5.0 + 55.0 * (1.0 - np.exp(-time / 2200.0))
    read = np.round(driver + 0.05 * rng.standard_normal(samples))
    middles = np.arange(1200) * 5.0 + 2.0
    bins = bin_of_each(time, middles)
    binned, true = (np.bincount(bins, one)[:1200] / np.bincount(bins)[:1200] for one in (read, driver))
    alone = Readings.of(read, binned, bins, diffuses=True)
    assert alone.course is not None
    assert alone.course.readings.noise == pytest.approx(0.05**2, rel=0.7)
    course = alone.following([])
    left = course.values - true
    assert np.std(binned - true) > 0.08
    assert np.std(left) < min(0.02, 0.5 * float(np.std(alone.values - true)))
    assert np.mean(left**2) < 3.0 * np.mean(course.variance)


def test_bins_of_samples() -> None:
    assert bin_of_each(np.array([0.0, 1.0, 2.0, 3.0, 5.0, 6.0, 7.0, 9.0]), np.array([1.0, 4.0, 7.0])).tolist() == [
        0,
        0,
        0,
        1,
        1,
        2,
        2,
        3,
    ]
    assert bin_of_each(np.arange(12.0), np.array([1.0, 4.0, 10.0])) is None  # a bin is missing


def test_noise_that_dithers_is_smoothed() -> None:
    rng = np.random.default_rng(4)
    driver = 20.0 + 8.0 * np.sin(np.arange(3000) / 120.0)
    read = np.round(driver + 0.6 * rng.standard_normal(3000))
    binned = read.reshape(600, 5).mean(axis=1)
    monitor, thermometer = Readings.of(read, binned), Readings.of(read, binned, diffuses=True)
    assert np.array_equal(monitor.values, smoothed(binned, noise_variance(read) / 5.0)[0])
    assert monitor.rounding[0] == pytest.approx(1.0 / 12.0)
    left = (thermometer.values - driver.reshape(600, 5).mean(axis=1)) ** 2
    assert 0.2 < left.mean() / thermometer.variance.mean() < 4.0


def test_states_and_jumps_are_no_steps_of_rounding() -> None:
    rng = np.random.default_rng(4)
    states = np.repeat(rng.integers(0, 3, 100), 20).astype(np.float64)
    readings = Readings.of(states, states.reshape(400, 5).mean(axis=1))
    assert np.array_equal(readings.values, states.reshape(400, 5).mean(axis=1))
    jumping = np.repeat(rng.integers(0, 40, 100), 20).astype(np.float64)
    assert np.std(Readings.of(jumping, jumping.reshape(400, 5).mean(axis=1)).values - jumping.reshape(400, 5).mean(axis=1)) < 0.1


def test_a_thermometer_that_jumps_is_left_as_it_is_read() -> None:
    rng = np.random.default_rng(5)
    read = np.where(np.arange(4000) < 2000, 20.0, 30.0) + 0.01 * rng.standard_normal(4000)
    binned = read.reshape(800, 5).mean(axis=1)
    readings = Readings.of(read, binned, diffuses=True)
    assert np.max(np.abs(readings.values - np.where(np.arange(800) < 400, 20.0, 30.0))) < 0.1


def test_two_columns_that_read_one_quantity_help_each_other() -> None:
    rng = np.random.default_rng(6)
    light = wandering(3000, 30.0, rng)
    full = {
        "light_intensity_V": light + 0.3 * rng.standard_normal(3000),
        "readout_a_V": 0.5 * light + 0.01 * rng.standard_normal(3000),
        "pressure_hPa": wandering(3000, 30.0, rng),
    }
    alone = Readings.of(full["light_intensity_V"], full["light_intensity_V"])
    together = readings_of(full, full)
    left = np.mean((together["light_intensity_V"].values - light) ** 2)
    assert left < 0.3 * np.mean((alone.values - light) ** 2)
    assert 0.3 < left / together["light_intensity_V"].variance.mean() < 3.0
    unrelated = readings_of(
        {"a_V": full["light_intensity_V"], "pressure_hPa": full["pressure_hPa"]},
        {"a_V": full["light_intensity_V"], "pressure_hPa": full["pressure_hPa"]},
    )
    assert np.std(unrelated["a_V"].values - alone.values) < 0.1 * np.std(alone.values - light)


def test_columns_that_read_two_quantities_are_told_as_two() -> None:
    """Light, and both readouts of it: a relation that holds nothing but noise is left out of all three."""
    rng = np.random.default_rng(7)
    light, beam = (wandering(3000, 40.0, rng) for _ in range(2))
    true = {"light_intensity_V": light, "readout_a_V": light + beam, "readout_b_V": light - beam, "supply_voltage_V": 0.0 * light}
    true["supply_voltage_V"] = wandering(3000, 40.0, rng)
    noise = {"light_intensity_V": 0.3, "readout_a_V": 0.1, "readout_b_V": 0.3, "supply_voltage_V": 0.2}
    read = {name: values + noise[name] * rng.standard_normal(3000) for name, values in true.items()}
    found = readings_of(read, read)
    left = found["readout_a_V"].values + found["readout_b_V"].values - 2.0 * found["light_intensity_V"].values
    assert np.std(left) < 0.02
    for name, one in found.items():
        square = float(np.mean((one.values - true[name]) ** 2))
        assert 0.6 < square / one.variance.mean() < 1.6
        assert square < 1.05 * float(np.mean((Readings.of(read[name], read[name]).values - true[name]) ** 2))
    assert np.mean((found["light_intensity_V"].values - light) ** 2) < 0.5 * 0.3**2


def test_smooth_is_nearer_the_driver_and_keeps_jumps() -> None:
    rng = np.random.default_rng(2)
    truth = wandering(3000, 300.0, rng) + 5.0 * (np.arange(3000) > 1500)
    found, variance, widths = smoothed(truth + 0.3 * rng.standard_normal(3000), 0.09)
    assert np.mean((found - truth) ** 2) < 0.4 * 0.09
    assert variance.mean() == pytest.approx(np.mean((found - truth) ** 2), rel=0.4)
    assert np.abs(found - truth)[1480:1520].max() < 1.5
    assert widths.max() > 1.0


def test_errors_of_a_driver_are_what_they_bring_into_the_output() -> None:
    runs = made(5, slope=0.0, read_noise=0.0)
    rng = np.random.default_rng(3)
    noisy = [
        run.replace(table=run.table.assign(supply_voltage_V=run.column("supply_voltage_V") + 0.5 * rng.standard_normal(len(run))))
        for run in runs
    ]
    grid = Grid.of(runs)
    exact, read = (
        Data(tuple(Run.of(run, grid, lambda binned: binned.rate_deg_h()) for run in recordings)) for recordings in (runs, noisy)
    )

    def predicted(run: Run) -> np.ndarray[Any, np.dtype[np.float64]]:
        return np.asarray((run.column("supply_voltage_V") - 15.0) ** 2)

    variance = 0.01
    errors = errors_of(read, predicted, [Driver(("supply_voltage_V",))], variance)
    seen = (read.means(predicted) - exact.means(predicted)) / np.sqrt(variance)
    roots = [np.linalg.cholesky(block + 1e-9 * np.eye(len(block))) for block in errors.blocks]
    white = np.concatenate([np.linalg.solve(root, seen[rows]) for root, rows in zip(roots, read.slices, strict=True)])
    assert np.mean(seen**2) == pytest.approx(errors.variances.mean(), rel=0.5)
    assert np.mean(white**2) == pytest.approx(1.0, abs=0.6)


def asked(runs: list[Recording], windows: float = 4.0, **fewer: Any) -> Diagnosis:
    """On windows so many times as long as by default, among all candidates or fewer."""
    return diagnose(Simulator.from_mapping(STATIC), runs, window_s=windows * Grid.of(runs).window_s, black_box=False, **fewer)


def test_a_strong_monitor_with_noise_has_no_second_law() -> None:
    content = asked(made(6, slope=12.0, read_noise=0.3), **FEWER).to_mapping()
    assert [finding["mechanism"] for finding in content["findings"]] == ["light_intensity"]
    assert content["verdict"] == "explained"


@pytest.mark.parametrize("step_K", [0.25, 1.0])
def test_a_thermometer_that_rounds_is_no_physics(step_K: float) -> None:
    runs = [
        run.replace(table=run.table.assign(gyro_deg_h=run.column("gyro_deg_h") + 4.0 * run.column("temperature_block_degC")))
        for run in made(7, slope=0.0, read_noise=0.0)
    ]
    rounded = [
        few_monitors(run.replace(table=run.table.assign(temperature_block_degC=other.column("temperature_block_degC"))))
        for run, other in zip(runs, made(7, slope=0.0, read_noise=0.0, step_K=step_K), strict=True)
    ]
    assert asked(rounded).verdict == "none"


def test_wild_windows_are_outliers_and_no_physics() -> None:
    runs = [few_monitors(run) for run in made(8, slope=0.0, read_noise=0.0)]
    wild = runs[0].column("gyro_deg_h").copy()
    for at, size in {310: 70.0, 640: -45.0, 1130: 95.0, 1400: -60.0, 1905: 50.0, 2210: -85.0}.items():
        wild[at : at + 12] += size
    runs[0] = runs[0].replace(table=runs[0].table.assign(gyro_deg_h=wild))
    found = asked(runs, 2.0)
    assert found.verdict == "none"
    assert found.posterior.null > 0.9


def test_outliers_are_windows_that_no_other_foretells() -> None:
    none = Errors((50, 50), ((), ()))
    residual, usual = np.random.default_rng(4).standard_normal(100).clip(-3.0, 3.0), np.ones(100)
    assert none.with_outliers(residual, usual, ()).outliers == ()
    residual[60] = 9.0
    found = none.with_outliers(residual, usual, ())
    assert found.outliers == (60,)
    assert found.variances[60] > 20.0
    spread = np.sqrt(1.0 + found.variances)
    assert none.with_outliers(residual, spread, found.outliers).outliers == (60,)
    residual[60] = 1.0  # a set that explains the window
    assert none.with_outliers(residual, spread, found.outliers).outliers == ()
    assert found.without_outliers.variances == pytest.approx(0.0)


def test_a_law_within_the_region_of_a_named_mechanism_belongs_to_it() -> None:
    """A region is drivers and memory: a monitor with a rate that washes out beside it has that law missing."""
    regions = {
        "readout_incoherence": Region("readout_incoherence", "readout_incoherence", 0.0, (), ("readout_a_V", "readout_b_V")),
        "law:readout_a_V": Region("law:readout_a_V", None, 0.0, (), ("readout_a_V",), "static"),
        "rate:readout_a_V": Region("rate:readout_a_V", None, 0.0, (), ("readout_a_V",), "dynamic"),
        "loop:pressure_hPa": Region("loop:pressure_hPa", None, 0.0, (), ("pressure_hPa",), "rate-independent"),
    }

    def verdict(*keys: str) -> tuple[str, list[str]]:
        state = State(tuple(Member(Form(key, key, ()), 1.0) for key in keys), Noise(), 0.0)
        found = decided(Posterior((state,), regions))
        return found.verdict, [one.region for one in found.named]

    assert verdict("readout_incoherence", "law:readout_a_V") == ("explained", ["readout_incoherence"])
    assert verdict("readout_incoherence", "rate:readout_a_V")[0] == "unknown"
    assert verdict("readout_incoherence", "loop:pressure_hPa")[0] == "unknown"
    assert verdict("law:readout_a_V")[0] == "unknown"


def test_a_small_member_is_a_form_of_an_equation_without_departures() -> None:
    """It is told of, and no finding; a form with departures has them in the model, and what shows beside them stands."""
    drivers = {"scale_factor_nonlinearity": ("table_rate",), "scale_factor_asymmetry": ("table_rate",)}
    drivers |= {"misalignment": ("table_rate", "table_angle"), "earth_rate_leak": ("table_angle",)}
    regions = {key: Region(key, key, 0.0, (), of) for key, of in drivers.items()}
    regions |= {key: Region(key, key, 0.0, (), ("T",), "rate-independent") for key in ("thermal_hysteresis", "mode_hop")}
    smooth = (Smooth(Path(Driver(("table_rate",)))),)

    def found(**sizes: float) -> tuple[set[str], set[str]]:
        own = {key: () if key in ("misalignment", "earth_rate_leak") else smooth for key in sizes}
        state = State(tuple(Member(Form(key, key, (), own[key]), size) for key, size in sizes.items()), Noise(), 0.0)
        decision = decided(Posterior((state,), regions))
        return {one.region for one in decision.named}, set(decision.unstated)

    named, unstated = found(misalignment=50.0, scale_factor_nonlinearity=5.0, scale_factor_asymmetry=0.5, earth_rate_leak=1.0)
    assert named == {"misalignment", "scale_factor_nonlinearity", "scale_factor_asymmetry"}
    assert unstated == {"earth_rate_leak"}
    assert found(misalignment=50.0, earth_rate_leak=7.0)[0] == {"misalignment", "earth_rate_leak"}
    assert found(thermal_hysteresis=50.0, mode_hop=5.0)[0] == {"thermal_hysteresis", "mode_hop"}


@pytest.mark.parametrize("unnamed", [("law:humidity", Noise()), (None, Noise(wander=1.5))], ids=["a law", "a wander"])
def test_what_is_beside_a_mechanism_and_may_be_nothing_is_no_unknown_physics(unnamed: tuple[str | None, Noise]) -> None:
    regions = {
        "warm_up": Region("warm_up", "warm_up", 0.0, (), (), "none"),
        "law:humidity": Region("law:humidity", None, 0.0, (), ("humidity",)),
    }
    law, noise = unnamed

    def verdict(odds: float, *keys: str) -> str:
        sets = (*keys, *((law,) if law else ())), keys
        states = (tuple(Member(Form(key, key, ()), 1.0) for key in one) for one in sets)
        more, less = next(states), next(states)
        return decided(Posterior((State(more, noise, math.log(odds)), State(less, Noise(), 0.0)), regions)).verdict

    assert verdict(2.0, "warm_up") == "ambiguous"
    assert verdict(20.0, "warm_up") == "unknown"
    assert verdict(2.0) == "unknown"


def test_a_relay_of_a_hop_stays_narrow() -> None:
    relay = Relays(Driver(("temperature_block_degC",)), (0.1,), (0.0,), widest=0.17)
    for _ in range(20):
        moved = relay.nearby(0.5)
        assert all(one.up[0] - one.down[0] <= 0.17 for one in moved)
        relay = max(moved, key=lambda one: one.up[0] - one.down[0])


def test_without_a_thermometer_nothing_is_thermal() -> None:
    runs = [
        run.replace(
            table=run.table[["time_s", "gyro_deg_h"]].assign(
                angle_rad=run.column("supply_voltage_V") - 15.0, gyro_deg_h=3.0 * (run.column("supply_voltage_V") - 15.0) ** 3
            )
        )
        for run in made(9, slope=0.0, read_noise=0.0)
    ]
    rng = np.random.default_rng(9)
    noisy = [
        run.replace(table=run.table.assign(gyro_deg_h=run.column("gyro_deg_h") + rng.standard_normal(len(run)))) for run in runs
    ]
    window_s = 4.0 * Grid.of(noisy).window_s
    content = diagnose(lambda run: 0.5 * run.column("angle_rad"), noisy, window_s=window_s, black_box=False).to_mapping()
    assert content["findings"] == []
    assert content["verdict"] == "unknown"
    assert content["unexplained"]["drivers"] == ["angle_rad"]


def test_the_simulator_before_is_calibrated_by_least_squares_where_the_gyro_is_white() -> None:
    """What a slow effect seems to be without its mechanism, a random walk, weighs no window of the simulator alone."""
    runs = made(6, slope=12.0, read_noise=0.0)
    found = asked(runs, only=["light_intensity"])
    assert [finding["mechanism"] for finding in found.to_mapping()["findings"]] == ["light_intensity"]
    averaged = [run.averaged(found.train.averaging_s) for run in runs]
    table = np.concatenate([np.vander((run.column("temperature_block_degC") - 20.0) / 30.0, 4) for run in averaged])
    output = np.concatenate([run.column("gyro_deg_h") for run in averaged])
    left = output - table @ np.linalg.lstsq(table, output, rcond=None)[0]
    assert found.train.baseline_rms == pytest.approx(np.sqrt(np.mean(left**2)), rel=0.02)
