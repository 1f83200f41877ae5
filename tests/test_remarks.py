"""What a careful reader is told beside the numbers."""

from __future__ import annotations

import dataclasses
from types import SimpleNamespace
from typing import Any

import numpy as np
import pandas as pd
import pytest
from scipy.signal import lfilter
from scipy.stats import binomtest

import rlgcomp as rlg
from rlgcomp.diagnosis.account import alternatives_of, and_hidden, set_probability
from rlgcomp.diagnosis.conclusion import LAW, Conclusion, _less_what_reads, beyond_noise, concluded, least_p_value
from rlgcomp.diagnosis.fitting.fit import FittedCause, fit
from rlgcomp.diagnosis.naming.explain import UNTRIED, explain
from rlgcomp.diagnosis.naming.search import MISSING
from rlgcomp.diagnosis.noise.whitening import NoiseShape
from rlgcomp.diagnosis.question.free_part import OWN_BIAS
from rlgcomp.diagnosis.question.problem import Problem
from rlgcomp.diagnosis.remarks.held_out import extrapolations_of, is_worse_in_training, off_held_out, worse_in_training
from rlgcomp.diagnosis.remarks.named import _at_the_end, _behind, _beside_a_law, _instead, _not_told, _together, own_biases_of
from rlgcomp.diagnosis.remarks.noise import as_noise, correlation_time_s, other_noise
from rlgcomp.diagnosis.result import Alternative, Estimate, Fit, RunFit, Trace, Verdict
from rlgcomp.physics import CATALOGUE
from rlgcomp.physics.mechanism import Mechanism
from tests.small_chamber_runs import SIMULATOR, runs


def found(mechanism: Mechanism) -> FittedCause:
    return FittedCause(mechanism, {}, np.zeros(3), known=False)


def test_a_posterior_probability_bounds_a_p_value() -> None:
    before = MISSING[0] * (1.0 - UNTRIED) * (1.0 - LAW)
    shown = np.random.default_rng(0).standard_normal(20_000)  # of nothing, where an effect would add a variance of four
    bayes_factor = np.exp(0.5 * shown**2 * 0.8) / np.sqrt(5.0)
    nothing = 1.0 / (1.0 + bayes_factor * (1.0 - before) / before)
    p_values = np.array([least_p_value(value) for value in nothing])
    np.testing.assert_allclose(p_values, np.minimum(1.0, 1.0 / bayes_factor), rtol=1e-9)
    for level in (0.5, 0.1, 0.01, 0.001):
        assert np.mean(p_values <= level) < level
    assert least_p_value(1.0) == 1.0
    assert 0.0 < least_p_value(0.0) < 1e-300  # it has a logarithm


def test_a_shape_at_the_end_of_what_is_tried_is_said_to_be_there() -> None:
    lag = CATALOGUE["thermal_lag"]
    (said,) = _at_the_end(found(lag(time_constant_s=14400.0)))
    assert "14400 s is the largest that is tried" in said
    assert not _at_the_end(found(lag(time_constant_s=14000.0)))
    assert not _at_the_end(found(CATALOGUE["temperature_rate"]()))


def test_a_law_that_takes_the_course_of_a_named_cause_is_told_with_it() -> None:
    pressure, rate, law = (found(CATALOGUE[name]()) for name in ("ambient_pressure", "temperature_rate", "empirical_law"))
    course = np.sin(np.arange(60.0) / 9.0)
    pressure, law = (dataclasses.replace(cause, contribution_deg_h=size * course) for cause, size in ((pressure, -2.0), (law, 3.0)))
    rate = dataclasses.replace(rate, contribution_deg_h=np.cos(np.arange(60.0) / 9.0))
    (said,) = _beside_a_law([pressure, rate, law])
    assert said.startswith("ambient_pressure and the law beyond it take one course (correlation -1.00)")
    assert not _beside_a_law([pressure, rate])


def test_what_hides_behind_a_strong_cause_is_spoken_of_and_found_once_that_is_compensated() -> None:
    """A lag beside a rate three hundred times the noise: it could be what the rate's equation is wrong by."""
    polynomial = {"thermal_polynomial": {"degree": 2}}
    base = rlg.Simulator.from_mapping({"kind": "chamber", "mechanisms": [polynomial]})
    lag = {"thermal_lag": {"k_deg_h_K": 6e-4, "time_constant_s": 5400.0}}
    gyro = [polynomial, {"temperature_rate": {"k_deg_h_min_K": 0.1}}, lag]
    made = rlg.Simulator.from_mapping({"kind": "chamber", "mechanisms": gyro, "noise": {"angle_random_walk_deg_sqrt_h": 3e-4}})
    train = [made.simulate(programme, seed=seed, step_s=10.0) for seed, programme in enumerate(("paper", "minor-loops"))]
    problem = Problem.of(base, train)
    explanations = explain(problem, CATALOGUE)
    conclusion = concluded(problem, explanations)
    assert {name for name, _ in conclusion.model.labels} == {"temperature_rate"}
    (said,) = _behind(explanations, conclusion)
    assert said.startswith("Beside temperature_rate, thermal_lag would explain more, though no more than an equation may be")
    first = rlg.diagnose(base, train, black_box=False)
    assert said in first.remarks
    hidden = first.alternatives[0]
    assert hidden.mechanisms == ("temperature_rate", "thermal_lag")
    assert hidden.probability > 0.4
    again = rlg.diagnose(first.augmented, train, black_box=False)
    assert [cause.name for cause in again.causes] == ["thermal_lag"]


def test_as_much_hides_behind_what_might_be_in_a_causes_place() -> None:
    """Or the named set would seem less likely than one that it is more likely than."""
    found = [Alternative(("c", "b"), 0.40), Alternative(("b",), 0.08), Alternative((), 0.02)]
    shares = {one.mechanisms: one.probability for one in and_hidden(found, ("a", "b"), {"d": 0.15, "c": 0.05}, 0.5)}
    assert shares[("c", "b")] == pytest.approx(0.40 * 0.8)
    assert shares[("a", "b", "d")] == pytest.approx(0.5 * 0.15)
    assert (shares[("b",)], shares[()]) == (0.08, 0.02)
    assert sum(shares.values()) < 1.0 - 0.5 * 0.8


def test_what_passes_for_noise_because_slow_noise_does_is_said_to() -> None:
    shape = NoiseShape(walk=0.9)
    problem = Problem.of(SIMULATOR, runs(shape, seed=5, hours=10.0), window_s=100.0)
    (said,) = as_noise(problem, fit(problem, [], shape), shape)
    assert "times the white noise, passes for noise with bias instability 0 deg/h and rate random walk" in said
    assert said.endswith("give its noise (--noise): then something unrecorded wanders.")
    calm = rlg.NoiseModel(angle_random_walk_deg_sqrt_h=0.002 / 6.0, bias_instability_deg_h=1e-6)
    stated = Problem.of(dataclasses.replace(SIMULATOR, noise=calm), problem.runs, window_s=100.0)
    (said,) = as_noise(stated, fit(stated, [], shape), shape)
    assert said.endswith("; 1e-06 and 0 are stated, but what there is looks like noise rather than something unrecorded.")
    white = Problem.of(SIMULATOR, runs(seed=5), window_s=100.0)
    assert not as_noise(white, fit(white, [], NoiseShape()), NoiseShape())


def test_where_no_programme_would_tell_that_is_said_and_none_is_proposed() -> None:
    """A supply that follows the pressure: two causes of one course, whatever the chamber does."""
    pressure, supply = CATALOGUE["ambient_pressure"](k_deg_h_hPa=0.002), CATALOGUE["supply_voltage"]
    train = [SIMULATOR.with_mechanism(pressure).simulate(text, seed=k, step_s=20.0) for k, text in enumerate(("short", "paper"))]
    followed = [15.0 + 0.01 * (run.column("pressure_hPa") - 1010.0) for run in train]
    train = [run.replace(table=run.table.assign(supply_voltage_V=volts)) for run, volts in zip(train, followed, strict=True)]
    rivals = {one.name: one for one in (type(pressure), supply, CATALOGUE["temperature_rate"])}
    diagnosis = rlg.diagnose(SIMULATOR, train, mechanisms=rivals, black_box=False)
    assert diagnosis.verdict == "ambiguous"
    assert diagnosis.to_mapping()["next_experiment"] is None
    (said,) = (
        remark for remark in diagnosis.remarks if remark.startswith("No programme within the recorded ranges would tell between")
    )
    assert {name for name in rivals if name in said} == {"ambient_pressure", "supply_voltage"}
    assert said in str(diagnosis)
    assert "Next experiment" not in str(diagnosis)


@pytest.mark.parametrize("time_s", [300.0, 1200.0, 5000.0])
def test_the_correlation_time_of_what_wanders_is_within_its_bounds(time_s: float) -> None:
    """In twenty pairs of runs, nine tenths of the posterior hold it nine times in ten."""
    inside, wide = [], []
    for seed in range(20):
        rng = np.random.default_rng(seed)
        runs = []
        for k in range(2):
            keep = np.exp(-100.0 / time_s)
            wander = lfilter([np.sqrt(1.0 - keep**2)], [1.0, -keep], rng.standard_normal(400), zi=[keep * rng.standard_normal()])[0]
            gyro = 1e-3 * (rng.standard_normal(400) + 2.0 * wander)
            table = pd.DataFrame(
                {"time_s": 100.0 * np.arange(400), "gyro_deg_h": gyro, "temperature_block_degC": 20.0 + 0.1 * wander}
            )
            runs.append(rlg.Recording(table, name=f"run{k}"))
        problem = Problem.of(rlg.Simulator.from_mapping({"kind": "chamber", "mechanisms": []}), runs)
        low, high = correlation_time_s(problem, problem.baseline, NoiseShape(wander=1.2, wander_s=4500.0))
        inside.append(low <= time_s <= high)
        wide.append(high / max(low, 100.0))
    assert binomtest(sum(inside), len(inside), 0.9).pvalue > 1e-3
    assert np.median(wide) < 12.0


@pytest.mark.parametrize(
    ("rms", "std", "said"),
    [(0.0012, 0.001, None), (0.003, 0.0011, "bias of each run's own accounts for it"), (0.003, 0.003, "Take one of them among")],
)
@pytest.mark.parametrize("verdict", ["none", "explained", "ambiguous"])
def test_held_out_runs_that_are_still_off_are_spoken_of(verdict: Verdict, rms: float, std: float, said: str | None) -> None:
    left = Fit(0.005, rms, 0.001, "deg/h", 100.0, 0.0, (0.0, 0.0), baseline_std=0.005, augmented_std=std)
    found = off_held_out(verdict, left)
    assert len(found) == (said is not None)
    assert all(said is not None and said in one for one in found)
    assert all(("with all that is named" in one) == (verdict != "none") for one in found)
    assert not off_held_out("unknown", left)
    assert not off_held_out(verdict, None)
    jumps = rlg.CATALOGUE["random_telegraph"](half_step_deg_h=0.001, dwell_s=3600.0)
    assert not off_held_out(verdict, left, [jumps])


@pytest.mark.parametrize(
    ("stated", "said"), [(None, False), (0.0, False), (3e-4, False), (4e-4, False), (3e-3, True), (1e-4, True)]
)
def test_noise_that_is_stated_otherwise_is_spoken_of(stated: float | None, said: bool) -> None:
    given = None if stated is None else rlg.NoiseModel(angle_random_walk_deg_sqrt_h=stated)
    found = other_noise(given, rlg.NoiseModel(angle_random_walk_deg_sqrt_h=3e-4))
    assert len(found) == said
    assert all("these runs show 0.0003, by which they are weighed" in one for one in found)


def test_a_shape_that_runs_do_not_show_is_said_to_be_assumed() -> None:
    """A threshold that is passed upwards alone has a dead band that nothing tells."""
    hop = CATALOGUE["mode_hop"](step_deg_h=0.004, threshold_degC=20.0, dead_band_K=6.0)
    told = {name: Estimate(getattr(hop, name), 0.1, "") for name in ("step_deg_h", "threshold_degC")}
    (said,) = _not_told(FittedCause(hop, told, np.zeros(3), known=False))
    assert said.startswith("These runs do not tell dead_band_K of mode_hop: 6 K is assumed")
    assert not _not_told(FittedCause(hop, told | {"dead_band_K": Estimate(6.0, 1.0, "K")}, np.zeros(3), known=False))
    relays = CATALOGUE["thermal_hysteresis"](law="preisach")  # it has no radius
    assert not _not_told(FittedCause(relays, {"k1_deg_h_K": Estimate(0.001, 1e-4, "deg/h/K")}, np.zeros(3), known=False))


@pytest.mark.parametrize(("std", "p_value", "said"), [(0.0014, 0.001, True), (0.0014, 0.2, False), (0.0011, 0.001, False)])
def test_one_held_out_run_that_is_off_is_spoken_of(std: float, p_value: float, said: bool) -> None:
    runs = tuple(RunFit(name, 0.005, own, 0.001, 0.005, own, 0.0, (0.0, 0.0)) for name, own in (("run2", 0.001), ("run3", std)))
    left = Fit(0.005, 0.0012, 0.001, "deg/h", 100.0, 0.0, (0.0, 0.0), runs, augmented_std=0.0012, whiteness_p_value=p_value)
    found = off_held_out("explained", left)
    assert len(found) == said
    assert all(one.startswith("run3 is off by 0.0014 deg/h about its own mean, 1.4 times the noise") for one in found)
    assert all("not by noise alone" in one for one in found)
    beyond = off_held_out("explained", left, extrapolated=["run3"])
    assert len(beyond) == said
    assert all("its predictions are extrapolated" in one and "noise alone" not in one for one in beyond)


@pytest.mark.parametrize(("after", "said"), [(0.0049, 0), (0.0052, 0), (0.0060, 1)])
def test_what_makes_the_training_runs_worse_is_not_to_be_used(after: float, said: int) -> None:
    train = Fit(0.005, after, 0.001, "deg/h", 100.0, 0.0, (0.0, 0.0), baseline_std=0.005, augmented_std=after)
    rate = [CATALOGUE["temperature_rate"]()]
    better, no_better = (Fit(0.005, left, 0.001, "deg/h", 100.0, 0.0, (0.0, 0.0)) for left in (0.004, 0.006))
    for kind, test, what in (
        ("turntable", better, "Do not use augmented.yaml"),
        ("chamber", better, "What is gained"),
        ("chamber", no_better, "no gain is proved"),
        ("chamber", None, "no gain is proved"),
    ):
        found = worse_in_training(kind, train, test, rate)
        assert len(found) == said
        assert all(what in one for one in found)
    assert is_worse_in_training(train, rate) == bool(said)
    assert not is_worse_in_training(train, [])
    assert not worse_in_training("chamber", train, better, [])


@pytest.mark.parametrize(("apart", "said"), [(1.0, "they agree"), (5.0, "have a bias each")])
def test_biases_that_agree_are_said_to(apart: float, said: str) -> None:
    estimate = Estimate(apart * 2e-4, 2e-4, "deg/h")
    (line,) = own_biases_of({"gyro": {f"{OWN_BIAS}:run0": estimate}})
    assert said in line


def test_causes_that_are_likely_each_and_not_together_are_told() -> None:
    models = [
        SimpleNamespace(labels=frozenset({("thermal_lag", False), ("mode_hop", False)})),
        SimpleNamespace(labels=frozenset({("thermal_lag", False)})),
        SimpleNamespace(labels=frozenset({("ageing", False)})),
    ]
    explanations = SimpleNamespace(models=models, probabilities=np.array([0.40, 0.31, 0.29]))
    (line,) = _together(explanations, Conclusion(models[0], (), 0.0, 0.0))
    assert "mode_hop and thermal_lag together has probability 0.40; thermal_lag alone 0.31." in line
    surer = SimpleNamespace(models=models, probabilities=np.array([0.60, 0.21, 0.19]))
    assert not _together(surer, Conclusion(models[0], (), 0.0, 0.0))


def test_a_law_that_is_hardly_less_likely_than_what_is_named_is_told_and_takes_its_share() -> None:
    law = SimpleNamespace(equation="b = play(pressure_hPa, 1 hPa)", drivers=("pressure_hPa",), memory="rate-independent")
    models = [SimpleNamespace(labels=frozenset(labels)) for labels in ({("ambient_pressure", False)}, {("ageing", False)}, set())]
    explanations = SimpleNamespace(models=models, probabilities=np.array([0.9, 0.1, 0.0]), unrecorded=lambda _: 0.0)
    alone, doubted = Conclusion(models[0], (), 0.0, 0.0), Conclusion(models[0], (), 0.4, 0.0, instead=law)
    assert not _instead(alone)
    assert _instead(doubted) == [
        "It may be no ambient_pressure, but a law beyond the catalogue (probability 0.40): b = play(pressure_hPa, 1 hPa), "
        "which follows pressure_hPa (rate-independent)."
    ]
    for conclusion, share in ((alone, 1.0), (doubted, 0.6)):
        assert set_probability(explanations, conclusion) == pytest.approx(0.9 * share)
        assert alternatives_of(explanations, conclusion)[0].probability == pytest.approx(0.1 * share)


@pytest.mark.parametrize(("p_value", "unknown"), [(1e-3, False), (1e-9, True)])
def test_what_no_healthy_gyro_shows_is_not_acquitted(p_value: float, unknown: bool) -> None:
    nothing = SimpleNamespace(labels=frozenset())
    ageing = SimpleNamespace(labels=frozenset({("ageing", False)}))
    silent, named = (Conclusion(model, (), 0.0, 0.1) for model in (nothing, ageing))
    assert (beyond_noise(silent, p_value, nothing).unrecorded > 0.5) == unknown
    assert beyond_noise(named, p_value, nothing) is named
    assert beyond_noise(silent, p_value, ageing) is silent


def test_an_angle_goes_round_and_is_not_extrapolated() -> None:
    def trace(held_out: bool, temperature: float, angle: float) -> Trace:
        hours = np.linspace(0.0, 1.0, 50)
        monitors = pd.DataFrame({"temperature_block_degC": temperature * hours, "table_angle_deg": angle * hours})
        return Trace("new" if held_out else "old", held_out, 3600.0 * hours, hours, hours, None, monitors, {}, "gyro_deg_s")

    drivers = {"temperature_block_degC", "table_angle_deg"}
    assert extrapolations_of([trace(False, 10.0, 100.0), trace(True, 10.0, 300.0)], drivers) == {}
    found = extrapolations_of([trace(False, 10.0, 100.0), trace(True, 30.0, 300.0)], drivers)
    said = found["new"]
    assert "temperature_block_degC from 0 to 30 degC" in said
    assert "table_angle_deg" not in said


def test_what_a_law_may_be_together_goes_with_it_and_so_do_paths_of_jumps() -> None:
    """A threshold of the light passes for a slope of it and a path of jumps."""
    names = ("light_intensity", "random_telegraph", "thermal_lag")
    tried = [SimpleNamespace(name=name, known=False, mechanism=CATALOGUE[name]()) for name in names]
    sets = [names, names[1:], names[2:], names[:1], ()]
    models = [SimpleNamespace(labels=frozenset((name, False) for name in some)) for some in sets]
    light = pd.DataFrame({"time_s": np.arange(20.0), "gyro_deg_h": 0.0, "light_intensity_V": 3.0, "temperature_block_degC": 20.0})
    explanations: Any = SimpleNamespace(
        evidence=SimpleNamespace(problem=SimpleNamespace(runs=[rlg.Recording(light)])),
        candidates=lambda _: tried,
        innocent=models[-1],
        models=models,
        search=SimpleNamespace(without_jumps=lambda labels: labels - {("random_telegraph", False)}),
    )
    law: Any = SimpleNamespace(drivers=("light_intensity_V",))
    assert _less_what_reads(explanations, explanations.models[0], law) == models[1:3]
