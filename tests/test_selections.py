"""Effects in some of the runs, amplitudes that differ from run to run: selections of a term, told in the finding."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest

import rlgcomp as rlg
from rlgcomp.diagnosis.data import Data, Grid, Run
from rlgcomp.diagnosis.diagnose import Diagnosis, diagnose
from rlgcomp.diagnosis.evidence.bank import Bank
from rlgcomp.diagnosis.forms.bases import Power
from rlgcomp.diagnosis.forms.drivers import Driver, Path
from rlgcomp.diagnosis.forms.terms import Form
from rlgcomp.diagnosis.regions.selections import EachRun, OnlyIn, selections
from tests.few_monitors import few_monitors

PROGRAMMES = (
    "start 20, hold 20, ramp -10 1, hold 40, ramp 40 1, hold 30",
    "start 30, hold 30, ramp 0 1, hold 40, ramp 25 1, hold 30",
    "start 10, hold 30, ramp 35 1.2, hold 40, ramp 0 1, hold 20",
)
FEW = ("supply_voltage", "magnetic_field", "thermal_lag", "temperature_rate", "warm_up")
BASELINE = {"kind": "chamber", "mechanisms": [{"thermal_polynomial": {"degree": 3}}]}


def made(voltages: tuple[float, ...], slopes: tuple[float, ...] = (5e-4, 5e-4, 5e-4)) -> list[rlg.Recording]:
    """Three runs, with a coefficient of the supply voltage and of the temperature in each."""
    found = []
    for k, (voltage, slope) in enumerate(zip(voltages, slopes, strict=True)):
        mechanisms: list[dict[str, Any]] = [{"thermal_polynomial": {"degree": 3, "c1_deg_h_K": slope}}]
        mechanisms += [{"supply_voltage": {"k_deg_h_V": voltage}}] if voltage else []
        noise = {"angle_random_walk_deg_sqrt_h": 5e-4}
        simulator = rlg.Simulator.from_mapping({"kind": "chamber", "mechanisms": mechanisms, "noise": noise})
        run = simulator.simulate(PROGRAMMES[k], seed=k, step_s=10.0, name=f"run{k}")
        found.append(few_monitors(run, "magnetic_field_uT"))
    return found


def further_run() -> rlg.Recording:
    """Without the effect."""
    real = BASELINE | {"noise": {"angle_random_walk_deg_sqrt_h": 5e-4}}
    run = rlg.Simulator.from_mapping(real).simulate(PROGRAMMES[0], seed=9, step_s=10.0, name="further")
    return few_monitors(run, "magnetic_field_uT")


def diagnosed(*args: Any) -> Diagnosis:
    """On windows twice as long as by default."""
    runs = made(*args)
    return diagnose(rlg.Simulator.from_mapping(BASELINE), runs, only=FEW, window_s=2.0 * Grid.of(runs).window_s, black_box=False)


@pytest.fixture(scope="module")
def in_one() -> Diagnosis:
    runs = made((0.0, 0.8, 0.0))
    window_s = 3.2 * Grid.of(runs).window_s
    return diagnose(rlg.Simulator.from_mapping(BASELINE), runs, [further_run()], only=FEW, window_s=window_s, black_box=False)


def test_an_effect_in_one_run_is_named_with_its_run(in_one: Diagnosis) -> None:
    (cause,) = in_one.causes
    assert cause.name == "supply_voltage"
    estimate = cause.parameters["k_deg_h_V"]
    assert abs(estimate.value - 0.8) < 3.0 * estimate.sd
    (told,) = (one for one in in_one.remarks if one.code == "diagnosis.in_some_runs")
    assert told.data == {"mechanism": "supply_voltage", "runs": ["run1"], "of": 3}
    (named,) = in_one.messages[0].data["causes"]
    assert (named["runs"], named["of"]) == (["run1"], 3)


def test_a_gain_in_runs_where_no_finding_acts_is_of_the_simulators_own_numbers(in_one: Diagnosis) -> None:
    (gain,) = (one for one in in_one.remarks if one.code == "diagnosis.gain_of_numbers")
    assert in_one.test is not None
    assert gain.data["mechanisms"] == ["supply_voltage"]
    assert (gain.data["before"], gain.data["after"]) == (in_one.test.baseline_rms, in_one.test.augmented_rms)
    few: dict[str, Any] = {"only": ["supply_voltage"], "window_s": in_one.train.averaging_s, "black_box": False}
    everywhere = diagnose(rlg.Simulator.from_mapping(BASELINE), made((0.8, 0.8, 0.8)), [further_run()], **few)
    assert [cause.name for cause in everywhere.causes] == ["supply_voltage"]
    assert "diagnosis.gain_of_numbers" not in {one.code for one in everywhere.remarks}


def test_its_finding_has_its_size_by_run_and_its_function(in_one: Diagnosis) -> None:
    (finding,) = in_one.to_mapping()["findings"]
    sizes = {run: one["value"] for run, one in finding["rms_by_run"].items()}
    assert sizes["run0"] == sizes["run2"] == 0.0
    assert sizes["run1"] > 0.0
    assert finding["function"]["kind"] == "static"


def test_other_runs_are_predicted_without_it(in_one: Diagnosis) -> None:
    assert in_one.augmented_file.left_out == ("supply_voltage",)
    (run,) = made((0.0, 0.8, 0.0))[1:2]
    other = run.replace(name="another run")
    fit = in_one.after
    predicted = fit.predicted(Run.of(other, fit.data.runs[0].grid, lambda binned: np.zeros(len(binned))))
    alone = fit.baseline.columns(fit.data.runs[1]) @ fit.solution.numbers
    assert predicted == pytest.approx(alone)


def test_an_effect_of_another_amplitude_in_each_run() -> None:
    """Other runs are predicted with the mean of the amplitudes, somewhat nearer to zero."""
    found = diagnosed((0.6, -0.5, 1.0))
    assert "supply_voltage" in [cause.name for cause in found.causes]
    (told,) = (one for one in found.remarks if one.code == "diagnosis.strength_by_run")
    assert told.data["mechanism"] == "supply_voltage"
    assert set(told.data["rms"]) == {"run0", "run1", "run2"}
    assert told.data["opposite_in"] == ["run1"]
    (at,) = (k for k, one in enumerate(found.after.state.members) if one.form.region == "supply_voltage")
    run = found.after.data.runs[2]
    names = ("run0", "run1", "run2", "another run")
    as_if = [dataclasses.replace(run, binned=run.binned.replace(name=name), cache={}, derived={}) for name in names]
    voltage = run.window_means(run.column("supply_voltage_V"))
    slopes = [float(np.polyfit(voltage, run.window_means(found.after.term(at, one)), 1)[0]) for one in as_if]
    assert slopes[:3] == pytest.approx([0.6, -0.5, 1.0], abs=0.2)
    (_, of_mean), (own, of_departures), *_ = found.after.parts[at][1]
    assert isinstance(own, EachRun)
    share = of_mean**2 / (of_mean**2 + of_departures**2 / 3.0)  # of a mean and three departures, all of them normal
    assert slopes[3] == pytest.approx(share * np.mean(slopes[:3]), rel=0.05)


def test_an_effect_in_all_runs_has_no_selection() -> None:
    found = diagnosed((0.6, 0.6, 0.6))
    assert [cause.name for cause in found.causes] == ["supply_voltage"]
    assert not found.causes[0].runs
    assert "rms_by_run" not in found.to_mapping()["findings"][0]


def test_a_coefficient_of_the_simulator_that_differs_from_run_to_run_is_no_missing_physics() -> None:
    slopes = (1.5e-3, -5e-4, 8e-4)
    found = diagnosed((0.0, 0.0, 0.0), slopes)
    assert found.verdict == "none"
    (told,) = (one for one in found.remarks if one.code == "diagnosis.amplitude_by_run")
    assert told.data["parameter"] == "thermal_polynomial:c1_deg_h_K"
    for run, slope in zip(("run0", "run1", "run2"), slopes, strict=True):
        assert abs(told.data["differences"][run] - (slope - np.mean(slopes))) < 3.0 * told.data["sds"][run]
        assert told.data["sds"][run] < 1e-4


def test_columns_of_selections_are_those_of_their_basis_in_some_rows() -> None:
    runs = made((0.0, 0.0, 0.0))
    grid = Grid.of(runs)
    data = Data(tuple(Run.of(run, grid, lambda binned: np.asarray(binned.rate_deg_h())) for run in runs))
    basis = Power(Path(Driver.of(data, "temperature_block_degC")), 2)
    bank = Bank(data, np.ones((len(data), 1)) / np.sqrt(len(data)))
    for selected in (OnlyIn(basis, ("run0", "run2")), EachRun(basis, ("run1", "run2"))):
        assert bank.columns(selected) == pytest.approx(data.means(selected.columns))


def test_of_many_runs_single_ones_and_all_but_one_are_tried() -> None:
    form = Form("law", "", (Power(Path(Driver(("a",)))),))
    for runs, subsets in ((1, 0), (2, 2), (4, 14), (8, 16)):
        assert len(selections(form, [f"run{k}" for k in range(runs)])) == (subsets + 2 if subsets else 0)
