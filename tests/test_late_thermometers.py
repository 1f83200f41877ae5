"""Late columns: told with their lag, no physics; what no plausible lag gives is still named."""

from __future__ import annotations

import dataclasses
import functools
from typing import Any

import numpy as np
import pandas as pd
import pytest
from scipy.signal import lfilter

from rlgcomp.diagnosis import priors
from rlgcomp.diagnosis.data import Data, Grid, Run
from rlgcomp.diagnosis.diagnose import Diagnosis, diagnose
from rlgcomp.diagnosis.evidence.bank import Bank
from rlgcomp.diagnosis.evidence.closed_form import Evidence, Member
from rlgcomp.diagnosis.forms.bases import Power
from rlgcomp.diagnosis.forms.drivers import Driver, Path, lagged
from rlgcomp.diagnosis.noise.errors import errors_of
from rlgcomp.diagnosis.noise.model import Noise
from rlgcomp.diagnosis.regions.baseline import Baseline
from rlgcomp.diagnosis.regions.lateness import Late, Prediction, late_bases, late_form, late_regions, white_noise
from rlgcomp.recording import Metadata, Recording
from rlgcomp.simulation.simulator import Simulator

STATIC: dict[str, Any] = {"kind": "chamber", "mechanisms": [{"thermal_polynomial": {"degree": 3}}]}
STEP_S = 10.0
NOISE = 0.02  # deg/h of a sample


def made(lag_s: float, *, slope: float = 0.01, rate: float = 0.0, behind: float = 0.0) -> list[Recording]:
    """Runs of a gyro with a slope over temperature, and what is missing; the block's thermometer is late."""
    runs = []
    for k in range(2):
        rng = np.random.default_rng([5, k])
        time_s = STEP_S * np.arange(2800)
        corners = [-1.0, -1.0, 1.2, 1.2, -0.5, -0.5, 0.5][:: 1 - 2 * k]
        chamber = 20.0 + 30.0 * np.interp(time_s, [0.0, 3e3, 8e3, 11e3, 17e3, 22e3, 2.8e4], corners)
        block = lagged(chamber, STEP_S, 600.0)
        gyro = slope * block + 1e-4 * (block - 20.0) ** 2 + NOISE * rng.standard_normal(len(block))
        gyro += rate * 60.0 * np.gradient(block, STEP_S) + behind * (lagged(block, STEP_S, 2500.0) - block)
        table = {
            "time_s": time_s,
            "gyro_deg_h": gyro,
            "temperature_block_degC": lagged(block, STEP_S, lag_s) + 0.003 * rng.standard_normal(len(block)),
            "supply_voltage_V": 15.0 + 0.02 * np.cumsum(rng.standard_normal(len(block))) / 50.0,
        }
        runs.append(Recording(pd.DataFrame(table), Metadata(kind="chamber"), name=f"run{k}"))
    return runs


def asked(runs: list[Recording], *only: str, windows: float = 3.2) -> Diagnosis:
    """On windows so many times as long as by default: the fewer, the sooner."""
    return diagnose(Simulator.from_mapping(STATIC), runs, only=only, window_s=windows * Grid.of(runs).window_s, black_box=False)


@functools.cache
def late() -> Diagnosis:
    """Of a thermometer that is late by a sixth of a window and nothing else."""
    return asked(made(35.0))


def test_a_late_thermometer_is_no_physics() -> None:
    found = late()
    assert found.verdict == "none"
    assert found.posterior.null > 0.9
    (lag,) = found.recalibration["late thermometer"].values()
    assert lag.unit == "s"
    assert 0.0 < lag.sd < 6.0
    assert abs(lag.value - 35.0) < 4.0 * lag.sd
    told = {remark.code: remark.data for remark in found.remarks}["diagnosis.late_thermometer"]
    assert told == {"column": "temperature_block_degC", "lag_s": lag.value, "sd_s": lag.sd, "instead": []}
    assert found.to_mapping()["baseline_with_findings"]["late thermometer"]["temperature_block_degC"]["value"] == lag.value


def test_without_the_term_it_would_be_physics(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("rlgcomp.diagnosis.regions.nuisances.late_regions", lambda data: iter(()))
    assert asked(made(35.0), "thermal_lag", "temperature_rate").verdict != "none"


@pytest.mark.parametrize(
    ("missing", "name"),
    [({"behind": 0.004}, "thermal_lag"), ({"rate": 0.05}, "temperature_rate"), ({"rate": -0.01}, "temperature_rate")],
    ids=["a lag of the gyro", "a rate that no plausible lag gives", "a rate of the other sign"],
)
def test_missing_physics_beside_a_late_thermometer_is_named(missing: dict[str, float], name: str) -> None:
    found = asked(made(20.0, **missing), "thermal_lag", "temperature_rate", "thermal_gradient", "supply_voltage", windows=6.0)
    assert [cause.name for cause in found.causes] == [name]


def test_what_could_be_either_is_sure_of_neither() -> None:
    """A rate that a thermometer of a third of a window's lag would give."""
    found = asked(made(0.01, rate=0.008), "thermal_lag", "temperature_rate")
    assert max([found.posterior.null, *(cause.probability for cause in found.causes)]) < 0.99


def monitored(lag_s: float) -> list[Recording]:
    """Runs of a gyro that follows the humidity by a saturating law; the humidity's sensor is late."""
    runs = []
    for k, run in enumerate(made(0.01)):
        rng = np.random.default_rng([7, k])
        kicks = rng.standard_normal(len(run)) * np.sqrt(2.0 * STEP_S / 3600.0)
        humidity = 42.0 + 12.0 * lfilter([1.0], [1.0, -np.exp(-STEP_S / 3600.0)], kicks)
        law = 0.2 / (1.0 + np.exp(-(humidity - 42.0) / 12.0))
        read = lagged(humidity, STEP_S, lag_s) + 0.2 * rng.standard_normal(len(run))
        table = run.table.assign(gyro_deg_h=run.rate_deg_h() + law, humidity_percent=read)
        runs.append(run.replace(table=table))
    return runs


def test_any_monitor_may_be_late() -> None:
    found = asked(monitored(40.0), "thermal_lag", windows=2.0)
    assert (found.verdict, found.decision.drivers, found.decision.memory) == ("unknown", ("humidity_percent",), "static")
    assert [one.name for one in found.members] == ["law:humidity_percent"]
    (lag,) = found.recalibration["late monitor"].values()
    assert abs(lag.value - 40.0) < 4.0 * lag.sd < 20.0
    told = {remark.code: remark.data for remark in found.remarks}["diagnosis.late_monitor"]
    assert told == {"column": "humidity_percent", "lag_s": lag.value, "sd_s": lag.sd}
    assert found.augmented_file.left_out == ()
    assert found.augmented_file.error < 0.3


def test_a_monitor_in_time_is_not_told_as_late() -> None:
    found = asked(monitored(0.01), "thermal_lag")
    assert [one.name for one in found.members] == ["law:humidity_percent"]
    assert "diagnosis.late_monitor" not in {remark.code for remark in found.remarks}


# --- parts ---------------------------------------------------------------------------------------------------------------------


@functools.cache
def parts() -> tuple[Data, Baseline, Bank]:
    runs = made(35.0)
    grid = Grid.of(runs)
    data = Data(tuple(Run.of(run, grid, lambda binned: binned.rate_deg_h()) for run in runs))
    baseline = Baseline.calibrated(Simulator.from_mapping(STATIC), data)
    return data, baseline, Bank(data, baseline.design(data), baseline)


def prediction(parts_of_set: tuple[Any, ...] = ()) -> Prediction:
    data, baseline, _ = parts()
    numbers = np.linalg.lstsq(data.means(baseline.columns), data.output, rcond=1e-12)[0]
    return Prediction(baseline, numbers, parts_of_set)


def test_the_column_is_the_change_of_the_prediction_by_a_window() -> None:
    data, _, _ = parts()
    region = next(late_regions(data))
    (basis,) = late_bases(data, region, prediction())
    run = data.runs[0]
    earlier = run.with_column(basis.column, run.column(basis.column) + 0.5 * run.grid.bins * np.gradient(run.column(basis.column)))
    expected = 2.0 * (prediction().values(earlier) - prediction().values(run))
    assert np.std(run.means(basis.columns(run))[:, 0] - run.means(expected)) < 0.1 * np.std(run.means(expected))


def test_members_may_be_late_as_well() -> None:
    data, _, _ = parts()
    region = next(late_regions(data))
    static = Power(Path(Driver.of(data, "temperature_block_degC")))
    one, other = late_bases(data, region, prediction(((static, np.array([1.0])),)))
    assert np.std(one.columns(data.runs[0])) > 3.0 * np.std(other.columns(data.runs[0]))


def test_what_is_made_once_has_the_bits_of_what_is_made_anew() -> None:
    """Runs with an earlier thermometer and columns of the baseline are kept from prediction to prediction."""
    data, baseline, _ = parts()
    region = next(late_regions(data))
    static = Power(Path(Driver.of(data, "temperature_block_degC")))
    halved = Prediction(baseline, 0.5 * prediction().numbers, ())
    for one in (prediction(), halved, prediction(((static, np.array([1.0])),))):
        basis = late_bases(data, region, one)[0]
        errors = errors_of(data, one.values, one.made_of, 0.01)
        fresh = Data(tuple(dataclasses.replace(run, derived={}, cache={}) for run in data.runs))
        assert np.array_equal(data.means(basis.columns), fresh.means(basis.columns))
        anew = errors_of(fresh, one.values, one.made_of, 0.01)
        assert all(np.array_equal(a, b) for a, b in zip(errors.blocks, anew.blocks, strict=True))


def test_white_noise_is_estimated_whatever_is_missing() -> None:
    data, _, bank = parts()
    assert white_noise(data, bank.design) == pytest.approx(NOISE / np.sqrt(data.runs[0].grid.window_s / STEP_S), rel=0.15)


def test_sizes_are_those_of_plausible_lags() -> None:
    data, _, bank = parts()
    region = next(late_regions(data))
    (basis,) = late_bases(data, region, prediction())
    form = late_form(region, basis, 2.0)
    assert form is not None
    ((_, scale),) = bank.scaled(form) or ()
    ((_, plain),) = bank.scaled(type(form)(region.key, "", (basis,))) or ()
    lags = priors.SIZES * scale / plain / 2.0
    used = np.exp(form.sizes) > 0.0
    assert lags[used].min() >= priors.LATE[0]
    assert lags[used].max() == pytest.approx(priors.LATE[1])
    assert np.exp(form.sizes).sum() == pytest.approx(len(priors.SIZES))
    assert late_form(region, basis, 1e-3) is None


def test_a_lag_is_positive() -> None:
    data, baseline, bank = parts()
    region = next(late_regions(data))
    (basis,) = late_bases(data, region, prediction())
    forwards = late_form(region, basis, 2.0)
    assert forwards is not None
    mirrored = Prediction(baseline, -prediction().numbers, ())
    backwards = late_form(region, Late(basis.rate, mirrored), 2.0)
    assert backwards is not None
    evidence = Evidence(bank, Noise(), 0.0)
    member, other = Member(forwards, float(priors.SIZES[4])), Member(backwards, float(priors.SIZES[4]))
    assert evidence.given((member,)).log_evidence == pytest.approx(evidence.given((other,)).log_evidence)
    assert evidence.log_evidence((member,)) == pytest.approx(evidence.given((member,)).log_evidence + np.log(2.0), abs=1e-3)
    assert evidence.log_evidence((other,)) < evidence.log_evidence((member,)) - 10.0
