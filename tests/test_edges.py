"""A relay's levels are found one by one where no grid is fine enough."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from rlgcomp.diagnosis.fitting.fit import fit
from rlgcomp.diagnosis.naming.explain import explain
from rlgcomp.diagnosis.noise.whitening import NoiseShape
from rlgcomp.diagnosis.question.problem import Problem
from rlgcomp.physics import CATALOGUE
from tests.small_chamber_runs import SIMULATOR, runs, with_effect


@pytest.mark.parametrize(("warming_degC", "dead_band_K"), [(14.3, 4.1), (2.7, 9.6), (21.2, 0.7)])
def test_both_levels_of_a_mode_hop_are_found(warming_degC: float, dead_band_K: float) -> None:
    """Between levels that lie in the same windows nothing decides; the temperature moves by up to 3 K in one."""
    hidden = CATALOGUE["mode_hop"](step_deg_h=0.004, threshold_degC=warming_degC, dead_band_K=dead_band_K)
    problem = Problem.of(SIMULATOR, with_effect(runs(seed=5, hours=12.0), hidden), window_s=100.0)
    found = explain(problem, CATALOGUE)
    best = found.models[0]
    assert best.labels == {("mode_hop", False)}
    mechanism = found.candidates(best)[0].mechanism
    differs = problem.columns(mechanism) != problem.columns(hidden)
    assert differs.mean() < 0.03


@pytest.mark.parametrize("hops", [pytest.param(2, marks=pytest.mark.slow), 3])
def test_hops_a_wavelength_apart_are_one_cause(hops: int) -> None:
    hidden = CATALOGUE["mode_hop"](step_deg_h=0.004, threshold_degC=4.0, dead_band_K=2.5, spacing_K=11.0, hops=hops)
    problem = Problem.of(SIMULATOR, with_effect(runs(seed=5, hours=12.0), hidden), window_s=100.0)
    found = explain(problem, CATALOGUE)
    best = found.models[0]
    assert best.labels == {("mode_hop", False)}
    mechanism = found.candidates(best)[0].mechanism
    assert mechanism.hops == hops
    assert (np.round(problem.columns(mechanism)) != np.round(problem.columns(hidden))).mean() < 0.03


def test_a_warm_up_of_two_terms_is_one_cause() -> None:
    hidden = CATALOGUE["warm_up"](
        initial_deg_h=0.032, slower_share=0.375, time_constant_s=600.0, slower_time_constant_s=7000.0, terms="two"
    )
    problem = Problem.of(SIMULATOR, with_effect(runs(seed=5, hours=12.0), hidden), window_s=100.0)
    found = explain(problem, CATALOGUE)
    best = found.models[0]
    assert best.labels == {("warm_up", False)}
    (candidate,) = found.candidates(best)
    assert candidate.mechanism.terms == "two"
    (cause,) = fit(problem, [candidate], NoiseShape()).causes
    for name, estimate in cause.estimates.items():
        assert abs(estimate.value - getattr(hidden, name)) < 4.0 * estimate.sd


def test_a_loop_that_is_narrow_where_it_is_hot_is_hysteresis() -> None:
    hidden = CATALOGUE["thermal_hysteresis"](
        law="coleman_hodgdon", k1_deg_h_K=1.2e-3, radius_K=8.0, curve_centre_degC=2.0, curve_K=24.0
    )
    problem = Problem.of(SIMULATOR, with_effect(runs(seed=5, hours=12.0), hidden), window_s=100.0)
    found = explain(problem, CATALOGUE)
    best = found.models[0]
    assert best.labels == {("thermal_hysteresis", False)}
    (candidate,) = found.candidates(best)
    assert candidate.mechanism.law == "coleman_hodgdon"
    (cause,) = fit(problem, [candidate], NoiseShape()).causes
    for name, estimate in cause.estimates.items():
        assert abs(estimate.value - getattr(hidden, name)) < 4.0 * estimate.sd


def test_edges_and_parameters_are_the_same_thing() -> None:
    hop = CATALOGUE["mode_hop"](threshold_degC=20.0, dead_band_K=3.0)
    assert hop.thresholds() == (20.0, 17.0)
    assert hop.with_thresholds((25.0, 15.0)) == CATALOGUE["mode_hop"](threshold_degC=25.0, dead_band_K=10.0)
    assert hop.with_thresholds((15.0, 25.0)) is None
    assert hop.with_thresholds((40.0, 15.0)) is None
    several = dataclasses.replace(hop, hops=3, spacing_K=12.0)
    assert several.thresholds() == (20.0, 17.0, 32.0)
    assert several.with_thresholds((25.0, 15.0, 40.0)) == dataclasses.replace(
        several, threshold_degC=25.0, dead_band_K=10.0, spacing_K=15.0
    )
    assert several.with_thresholds((25.0, 15.0, 20.0)) is None
    assert all(kind().thresholds() == () for name, kind in CATALOGUE.items() if name != "mode_hop")
    assert np.isfinite(hop.thresholds()).all()


@pytest.mark.parametrize("start", ["from_below", "from_above"])
def test_a_hop_that_began_in_either_mode_is_found(start: str) -> None:
    """The runs stand within the dead band for hours at first, where a gyro that had rested would be in the other mode."""
    name = "temperature_block_degC"
    standing = [run.column(name)[np.maximum(np.arange(432) - 108, 0)] for run in runs(seed=5, hours=12.0)]
    plain = [run.replace(table=run.table.assign(**{name: t})) for run, t in zip(runs(seed=5, hours=12.0), standing, strict=True)]
    up_K = 2.0 if start == "from_below" else 5.0
    hidden = CATALOGUE["mode_hop"](step_deg_h=0.004, threshold_degC=float(standing[0][0]) + up_K, dead_band_K=7.0, start=start)
    rested = dataclasses.replace(hidden, start="rested")
    problem = Problem.of(SIMULATOR, with_effect(plain, hidden), window_s=100.0)
    assert (problem.columns(rested) != problem.columns(hidden)).mean() > 0.1
    found = explain(problem, CATALOGUE)
    best = found.models[0]
    assert best.labels == {("mode_hop", False)}
    mechanism = found.candidates(best)[0].mechanism
    assert mechanism.start == start
    assert (problem.columns(mechanism) != problem.columns(hidden)).mean() < 0.03
