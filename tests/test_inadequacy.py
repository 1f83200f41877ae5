"""A strong cause hides no other that is nothing like what its equation may leave."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

import rlgcomp as rlg
from rlgcomp.diagnosis.naming.candidates import Candidate
from rlgcomp.diagnosis.naming.evidence import Evidence
from rlgcomp.diagnosis.naming.inadequacy import A_RELAY, BY_CHANCE, follows_anything, inadequacy, is_loop, leaves_jumps, leftovers
from rlgcomp.diagnosis.naming.search import JUMPED, JUMPS, Search
from rlgcomp.diagnosis.noise.whitening import NoiseShape
from rlgcomp.diagnosis.question.problem import Problem
from rlgcomp.physics import CATALOGUE

STEP_S = 10.0
SIMULATOR = rlg.Simulator.from_mapping({"kind": "chamber", "mechanisms": [{"thermal_polynomial": {"degree": 2}}]})


def runs(*causes: dict[str, dict[str, float]]) -> list[rlg.Recording]:
    gyro = {"kind": "chamber", "mechanisms": [{"thermal_polynomial": {"degree": 2}}, *causes]}
    made = rlg.Simulator.from_mapping(gyro | {"noise": {"angle_random_walk_deg_sqrt_h": 3e-4}})
    return [made.simulate(programme, seed=seed, step_s=STEP_S) for seed, programme in enumerate(("paper", "minor-loops"))]


HOP = {"mode_hop": {"step_deg_h": 0.02, "threshold_degC": 25.3, "dead_band_K": 4.4}}
RATE = {"temperature_rate": {"k_deg_h_min_K": 0.05}}
STEADY_RATE = {"temperature_rate": {"k_deg_h_min_K": 0.015}}


@pytest.mark.parametrize("strong", [HOP, pytest.param(RATE, marks=pytest.mark.slow)])
def test_a_weak_cause_beside_a_strong_one_is_found(strong: dict[str, dict[str, float]]) -> None:
    (name,) = strong
    found = rlg.diagnose(SIMULATOR, train=runs(strong, {"magnetic_field": {"k_deg_h_uT": 3e-4}}), black_box=False)
    assert {cause.name for cause in found.causes} == {name, "magnetic_field"}
    alone = rlg.diagnose(SIMULATOR, train=runs(strong), black_box=False)
    assert [cause.name for cause in alone.causes] == [name]


def test_a_path_beside_a_plain_monitor_is_found() -> None:
    """A field's response leaves what the field does, and no jumps; without any, none are seen."""
    field = {"magnetic_field": {"k_deg_h_uT": 3e-3}}
    jumps = {"random_telegraph": {"half_step_deg_h": 0.002, "dwell_s": 4000.0}}
    both, alone = (rlg.diagnose(SIMULATOR, train=made, black_box=False) for made in (runs(field, jumps), runs(field)))
    assert {cause.name for cause in both.causes} == {"magnetic_field", "random_telegraph"}
    assert [cause.name for cause in alone.causes] == ["magnetic_field"]


def test_a_path_beside_a_rate_is_found() -> None:
    """What the equation of a rate leaves is smooth."""
    jumps = {"random_telegraph": {"half_step_deg_h": 0.002, "dwell_s": 4000.0}}
    both, alone = (rlg.diagnose(SIMULATOR, train=made, black_box=False) for made in (runs(STEADY_RATE, jumps), runs(STEADY_RATE)))
    assert {cause.name for cause in both.causes} == {"temperature_rate", "random_telegraph"}
    assert [cause.name for cause in alone.causes] == ["temperature_rate"]


def test_a_line_beside_a_strong_monitor_is_found() -> None:
    field = {"magnetic_field": {"k_deg_h_uT": 2e-3}}
    line = {"periodic_interference": {"cosine_deg_h": 0.0012, "sine_deg_h": 0.0, "frequency_hz": 0.002}}
    both = rlg.diagnose(SIMULATOR, train=runs(field, line), black_box=False)
    assert {cause.name for cause in both.causes} == {"magnetic_field", "periodic_interference"}


def test_a_line_leaves_nothing_slow() -> None:
    line = {"periodic_interference": {"cosine_deg_h": 0.02, "sine_deg_h": 0.0, "frequency_hz": 0.001}}
    made = runs(line, {"magnetic_field": {"k_deg_h_uT": 3e-4}})
    found = rlg.diagnose(SIMULATOR, train=made, black_box=False)
    assert {cause.name for cause in found.causes} == {"periodic_interference", "magnetic_field"}


def test_sets_of_a_search_under_white_noise_are_weighed_with_all_noises() -> None:
    problem = Problem.of(SIMULATOR, runs(RATE, {"magnetic_field": {"k_deg_h_uT": 3e-4}}))
    kinds = ("temperature_rate", "magnetic_field", "supply_voltage", "ambient_pressure")
    tried = [Candidate(one, problem.columns(one), 0.0) for name in kinds for one in CATALOGUE[name].grid(problem.runs)]
    evidence = Evidence(problem, tried, (NoiseShape(), NoiseShape(0.6, 0.4)))
    quiet = Search(evidence, np.array([0.0, -np.inf]))
    sought = quiet.run()
    search = Search(evidence, largest=0)
    known = search.run()
    found = {model.labels: model for model in search.consider(sought)}
    assert found.keys() > {model.labels for model in known}
    for labels, model in Search(evidence).rated(found).items():
        assert found[labels].log_evidence == pytest.approx(model.log_evidence, abs=0.5)


def path(problem: Problem) -> Candidate:
    """Jumps at times that no driver knows of."""
    return Candidate(CATALOGUE["random_telegraph"](), np.sign(np.sin(np.arange(float(len(problem.rows))) / 40.0))[:, None], 0.0)


def test_a_path_beside_a_relay_pays_more_than_all_that_it_may_be_wrong_by() -> None:
    problem = Problem.of(SIMULATOR, runs(HOP))
    hop = CATALOGUE["mode_hop"](threshold_degC=25.3, dead_band_K=4.4)
    search = Search(Evidence(problem, [Candidate(hop, problem.columns(hop), 0.0), path(problem)], (NoiseShape(),)))
    relay, jumps = ("mode_hop", False), ("random_telegraph", False)
    before = search.log_prior(frozenset({relay, jumps}))
    models = {model.labels: model for model in search.run()}
    whole = inadequacy(search.evidence.explained(models[frozenset({relay})].members, 0))
    paid = search.toll(frozenset({relay, jumps}))
    assert paid == pytest.approx(JUMPS * whole - JUMPED + whole)
    assert search.log_prior(frozenset({relay, jumps})) == pytest.approx(before - paid)
    assert search.toll(frozenset({jumps})) == search.toll(frozenset({relay})) == 0.0


def test_relays_and_loops_leave_jumps_and_what_runs_smoothly_leaves_none() -> None:
    (run, _) = runs()
    kinds = [kind for kind in CATALOGUE.values() if kind.kind == "chamber" and not kind.empirical]
    jumping = {kind.name for kind in kinds if leaves_jumps((kind.grid([run]) or (kind(),))[0], run)}
    assert jumping == {"thermal_hysteresis", "mode_hop", "periodic_interference", "random_telegraph"}
    assert all(leaves_jumps(loop, run) for loop in CATALOGUE["thermal_hysteresis"].grid([run]))


def test_a_relay_beside_a_loop_pays_more_for_it_may_be_one_of_its_relays() -> None:
    (run, _) = found = runs()
    kinds = [kind for kind in CATALOGUE.values() if kind.kind == "chamber" and not kind.empirical]
    assert {kind.name for kind in kinds if is_loop((kind.grid([run]) or (kind(),))[0], run)} == {"thermal_hysteresis"}
    loop, relay = CATALOGUE["thermal_hysteresis"](radius_K=8.0), CATALOGUE["mode_hop"](threshold_degC=25.3, dead_band_K=4.4)
    shown = 0.002 * loop.basis(run)[:, 0]
    tables = [one.table.assign(gyro_deg_h=one.column("gyro_deg_h") + shown) for one in found]
    problem = Problem.of(SIMULATOR, [one.replace(table=table) for one, table in zip(found, tables, strict=True)])
    rate = CATALOGUE["temperature_rate"]()
    tried = [Candidate(one, problem.columns(one), 0.0) for one in (loop, relay, rate)]
    search = Search(Evidence(problem, tried, (NoiseShape(),)))
    models = {model.labels: model for model in search.run()}
    label = ("thermal_hysteresis", False)
    whole = inadequacy(search.evidence.explained(models[frozenset({label})].members, 0))
    assert whole > 1.0
    assert search.toll(frozenset({label, ("mode_hop", False)})) == pytest.approx(A_RELAY * whole)
    assert search.toll(frozenset({label, ("temperature_rate", False)})) == pytest.approx(whole)


def test_what_could_be_taken_for_it_pays() -> None:
    problem = Problem.of(SIMULATOR, runs(RATE))
    kinds = ("temperature_rate", "thermal_lag", "magnetic_field", "random_telegraph")
    tried = [Candidate(one, problem.columns(one), 0.0) for name in kinds[:3] for one in CATALOGUE[name].grid(problem.runs)[:2]]
    tried.append(path(problem))
    search = Search(Evidence(problem, tried, (NoiseShape(),)))
    alone = {label: search.log_prior(frozenset({label})) for label in ((name, False) for name in kinds)}
    before = {name: search.log_prior(frozenset({("temperature_rate", False), (name, False)})) for name in kinds[1:]}
    models = {model.labels: model for model in search.run()}
    strongest = models[frozenset({("temperature_rate", False)})]
    whole = inadequacy(search.evidence.explained(strongest.members, 0))
    toll = {name: before[name] - search.log_prior(frozenset({("temperature_rate", False), (name, False)})) for name in kinds[1:]}
    assert whole > 10.0
    assert toll["thermal_lag"] == pytest.approx(whole)
    for other in ("magnetic_field", "random_telegraph"):
        assert BY_CHANCE * whole <= toll[other] < 0.6 * whole
    assert all(search.log_prior(frozenset({label})) == prior for label, prior in alone.items())  # alone nothing pays


def test_what_hides_another_is_strong_though_it_is_worth_little_alone() -> None:
    """A lag and a warm-up that undo each other: what both are off by could be taken for ageing."""
    problem = Problem.of(SIMULATOR, runs())
    first = CATALOGUE["temperature_rate"]()
    column = problem.columns(first)[:, 0]
    ripple = column.std() * np.sin(np.arange(float(len(column))) / 15.0)
    second = CATALOGUE["thermal_lag"](time_constant_s=900.0)
    target = problem.target_deg_h + 0.2 * ripple  # the difference of the two columns below
    problem = dataclasses.replace(problem, target_deg_h=target)
    tried = [Candidate(first, column[:, None], 0.0), Candidate(second, (column + 0.1 * ripple)[:, None], 0.0)]
    search = Search(Evidence(problem, tried, (NoiseShape(),)))
    models = {model.labels: model for model in search.run()}
    both = models[frozenset({("temperature_rate", False), ("thermal_lag", False)})]
    alone = [models[frozenset({label})] for label in both.labels]
    explained = search.evidence.explained_by_each(both.members, 0)
    assert all(chi > 100.0 * search.evidence.explained(model.members, 0) for chi in explained for model in alone)
    assert min(explained) == pytest.approx(search.evidence.explained(both.members, 0), rel=0.2)


def test_one_that_stands_in_the_place_of_a_strong_cause_pays_what_that_would() -> None:
    problem = Problem.of(SIMULATOR, runs(RATE, {"magnetic_field": {"k_deg_h_uT": 3e-3}}))
    kinds = ("temperature_rate", "thermal_lag", "magnetic_field", "ambient_pressure")
    tried = [Candidate(one, problem.columns(one), 0.0) for name in kinds for one in CATALOGUE[name].grid(problem.runs)[:1]]
    search = Search(Evidence(problem, tried, (NoiseShape(),)))
    search.run()
    rate, lag, field, pressure = ((name, False) for name in kinds)
    own, instead = (search.log_prior(frozenset({cause, field})) for cause in (rate, lag))
    assert instead == own
    assert search.log_prior(frozenset({rate, lag, field})) < search.log_prior(frozenset({rate, pressure, field}))


def test_what_is_left_follows_the_drivers() -> None:
    problem = Problem.of(SIMULATOR, runs())
    lag = CATALOGUE["thermal_lag"](time_constant_s=1800.0)
    column = problem.columns(lag)[:, :1]
    evidence = Evidence(problem, [Candidate(lag, column, 0.0)], (NoiseShape(),))
    assert evidence.likeness([0], leftovers(problem, CATALOGUE["temperature_rate"]())) > 0.9
    assert evidence.likeness([0], leftovers(problem, CATALOGUE["magnetic_field"]())) < 0.5
    assert leftovers(problem, CATALOGUE["warm_up"]()).shape[0] == len(problem.rows)


def test_lines_and_paths_follow_anything() -> None:
    kinds = [kind for kind in CATALOGUE.values() if kind.kind == "chamber" and not kind.empirical]
    assert {kind.name for kind in kinds if follows_anything(kind())} == {"periodic_interference", "random_telegraph"}
