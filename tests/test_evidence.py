"""Evidence in closed form against integrals done another way; the search, the path of jumps, the measured null."""

from __future__ import annotations

import dataclasses
import itertools
import math

import numpy as np
import pandas as pd
import pytest
from scipy import stats

import rlgcomp as rlg
from rlgcomp.diagnosis.detection.detect import _credited, _of_each, _of_many, _own_p_values, _prepivoted, detect, tail_probability
from rlgcomp.diagnosis.fitting.fit import fit
from rlgcomp.diagnosis.naming.candidates import Candidate, candidates
from rlgcomp.diagnosis.naming.evidence import SIZES, Evidence, Member
from rlgcomp.diagnosis.naming.explain import explain
from rlgcomp.diagnosis.naming.search import Search, posterior
from rlgcomp.diagnosis.noise.noises import FLICKERS, WALKS, Stated, log_prior, ordinary_noise, unrecorded_cause
from rlgcomp.diagnosis.noise.whitening import NoiseShape
from rlgcomp.diagnosis.question.problem import Problem
from rlgcomp.diagnosis.question.windows import FEWEST_WINDOWS, default_window_s
from rlgcomp.noise.processes import NoiseModel
from rlgcomp.physics import CATALOGUE
from tests.small_chamber_runs import SIMULATOR, runs, with_effect


@pytest.fixture(scope="module")
def small() -> Evidence:
    problem = Problem.of(SIMULATOR, runs(NoiseShape(0.3, 0.1)), window_s=100.0)
    few = {name: CATALOGUE[name] for name in ("supply_voltage", "ambient_pressure", "temperature_rate", "thermal_lag")}
    return Evidence(problem, candidates(problem, few)[0], (NoiseShape(), NoiseShape(0.3, 0.1)))


def by_integration(evidence: Evidence, noise: int, members: tuple[Member, ...]) -> float:
    """Log evidence with the noise's size integrated on a grid, and amplitudes and baseline put into the covariance."""
    problem = evidence.problem
    y = problem.target_deg_h / evidence.scale_deg_h
    n, p = len(y), problem.baseline.shape[1]
    from tests.dense_noise import dense

    covariance = dense(problem.rows, evidence.noises[noise])
    for member in members:
        columns = evidence._table[:, evidence._slices[member.candidate]]
        covariance = covariance + columns @ columns.T * SIZES[member.size] ** 2 / columns.shape[1]
    inverse = np.linalg.inv(covariance)
    x = evidence._orthogonal
    normal = x.T @ inverse @ x
    left = float(y @ inverse @ y - y @ inverse @ x @ np.linalg.solve(normal, x.T @ inverse @ y))
    log_sigma = np.linspace(-6.0, 3.0, 4001)
    logs = -(n - p) * log_sigma - 0.5 * left * np.exp(-2.0 * log_sigma)
    integral = math.log(np.trapezoid(np.exp(logs - logs.max()), log_sigma)) + logs.max()
    return integral - 0.5 * np.linalg.slogdet(covariance)[1] - 0.5 * np.linalg.slogdet(normal)[1]


def test_closed_form_is_the_integral(small: Evidence) -> None:
    one, two = Member(0, 3), Member(2, 5)
    for noise in (0, 1):
        start = by_integration(small, noise, ())
        nothing = small.extensions(())
        for members in ((one,), (one, two)):
            expected = by_integration(small, noise, members) - start
            assert small.extensions(members).point[noise] - nothing.point[noise] == pytest.approx(expected, abs=1e-4)
    assert by_integration(small, 1, ()) - by_integration(small, 0, ()) == pytest.approx(
        float(small.extensions(()).point[1] - small.extensions(()).point[0]), abs=1e-4
    )


def test_an_extension_is_the_model_with_one_more(small: Evidence) -> None:
    held = Member(1, 4)
    extension = small.extensions((held,))
    for candidate in (0, 3):
        sizes = [small.extensions((held, Member(candidate, k))).point for k in range(len(SIZES))]
        averaged = np.log(np.mean(np.exp(np.array(sizes) - extension.point), axis=0)) + extension.point
        np.testing.assert_allclose(extension.extended[:, candidate], averaged, atol=1e-8)


def test_couples_are_models_of_two(small: Evidence) -> None:
    for noise in (0, 1):
        which, gains, sizes = small.couples(noise)
        for a, b in ((0, len(which) - 1), (1, 2)):
            points = [
                small.extensions((Member(int(which[a]), k), Member(int(which[b]), k))).point[noise] for k in range(len(SIZES))
            ]
            expected = np.array(points) - small.extensions(()).point[noise] - 2.0 * math.log(len(SIZES))
            assert gains[a, b] == pytest.approx(expected.max(), abs=1e-7)
            assert sizes[a, b] == int(np.argmax(expected))


@pytest.mark.parametrize("in_couples", [True, False])
def test_causes_that_hide_each_other_are_found_in_couples(
    small: Evidence, in_couples: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What two columns have in common hides their difference, which is the effect; decoys that resemble it lead the search away."""
    rng, rows = np.random.default_rng(4), len(small.problem.rows)
    common, effect = rng.standard_normal((2, rows))
    hidden = {"supply_voltage": common + 0.1 * effect, "ambient_pressure": common - 0.1 * effect}
    decoys = {name: effect + 2.0 * rng.standard_normal(rows) for name in ("warm_up", "ageing", "temperature_rate")}
    problem = dataclasses.replace(small.problem, target_deg_h=rng.standard_normal(rows) + 0.7 * effect)
    tried = [Candidate(CATALOGUE[name](), column[:, None], 0.0) for name, column in (hidden | decoys).items()]
    monkeypatch.setattr("rlgcomp.diagnosis.naming.search.BEAM", 1)
    if not in_couples:
        monkeypatch.setattr(Search, "_couples", lambda search: {})
    best = Search(Evidence(problem, tried, (NoiseShape(),))).run()[0]
    assert (best.labels == {(name, False) for name in hidden}) == in_couples


def test_compiled_and_added_extensions_are_the_plain_ones(small: Evidence, monkeypatch: pytest.MonkeyPatch) -> None:
    wide = Candidate(CATALOGUE["thermal_polynomial"](), np.random.default_rng(3).standard_normal((len(small.problem.rows), 3)), 0.0)
    first, others = [*small.candidates[:4], wide], small.candidates[4:]
    for members in ((), (Member(1, 4),), (Member(4, 2), Member(0, 3))):
        grown = Evidence(small.problem, first, small.noises)
        grown.extensions(members)
        grown.add(others)
        fast = [grown.extensions(members), Evidence(small.problem, [*first, *others], small.noises).extensions(members)]
        with monkeypatch.context() as without:
            without.setenv("RLGCOMP_NUMBA", "0")
            plain = Evidence(small.problem, [*first, *others], small.noises).extensions(members)
        for found in fast:
            np.testing.assert_array_equal(found.best_size, plain.best_size)
            for name in ("point", "extended", "at_best_size"):
                np.testing.assert_allclose(getattr(found, name), getattr(plain, name), rtol=1e-10, atol=1e-9)


def test_a_cause_that_the_baseline_has_is_no_candidate(small: Evidence) -> None:
    before = len(small.candidates)
    small.add([Candidate(CATALOGUE["thermal_polynomial"](degree=1), small.problem.baseline[:, :2], 0.0)])
    assert len(small.candidates) == before


def test_the_search_finds_a_pair_and_says_nothing_of_nothing() -> None:
    few = {
        name: CATALOGUE[name]
        for name in ("supply_voltage", "ambient_pressure", "temperature_rate", "thermal_lag", "warm_up", "thermal_hysteresis")
    }
    hidden = (CATALOGUE["supply_voltage"](k_deg_h_V=0.08), CATALOGUE["thermal_lag"](k_deg_h_K=6e-4, time_constant_s=900.0))
    for causes in ((), hidden):
        problem = Problem.of(SIMULATOR, with_effect(runs(seed=5, hours=8.0), *causes), window_s=100.0)
        noises = ordinary_noise()
        search = Search(Evidence(problem, candidates(problem, few)[0], noises), log_prior(noises))
        models = search.run()
        assert {name for name, _ in models[0].labels} == {cause.name for cause in causes}
        assert posterior(models).sum() == pytest.approx(1.0)


def test_priors_over_sets_sum_to_one(small: Evidence) -> None:
    search = Search(small)
    labels = [(name, False) for name in search.names]
    total = sum(
        math.exp(search.log_prior(frozenset(chosen)))
        for k in range(len(labels) + 1)
        for chosen in itertools.combinations(labels, k)
    )
    assert total == pytest.approx(1.0)


@pytest.mark.parametrize(("measured", "wrong"), [(False, 0.2), (True, 1e-3)])
def test_stated_noise_is_believed_but_not_blindly(measured: bool, wrong: float) -> None:
    stated = Stated.of(NoiseModel(angle_random_walk_deg_sqrt_h=3e-4, bias_instability_deg_h=6e-4, measured=measured), 100.0)
    assert stated is not None
    assert stated.shape == NoiseShape(pytest.approx(1.0 / 3.0), 0.0)
    noises = ordinary_noise(stated)
    prior = np.exp(log_prior(noises, stated))
    assert prior.sum() == pytest.approx(1.0)
    assert noises[int(np.argmax(prior))] == stated.shape
    assert noises[int(np.argsort(prior)[-2])] == NoiseShape(min(FLICKERS, key=lambda one: abs(one - 1.0 / 3.0)), 0.0)
    usual = np.exp(log_prior(ordinary_noise()))
    assert (prior[: len(usual)] > 0.9 * wrong * usual).all()
    far = np.array([noise.walk >= 0.9 for noise in noises])
    assert prior[far].sum() < 2.0 * wrong  # else it would not matter that it was said
    assert Stated.of(NoiseModel(angle_random_walk_deg_sqrt_h=3e-4), 100.0) is None  # it does not say that noise is white
    zeros = {"bias_instability_deg_h": 0.0, "rate_random_walk_deg_h_sqrt_h": 0.0}
    white = NoiseModel.from_mapping({"angle_random_walk_deg_sqrt_h": 3e-4} | zeros)
    zero = Stated.of(white, 100.0)
    assert zero == Stated(NoiseShape())
    assert np.exp(log_prior(ordinary_noise(zero), zero))[0] > 0.5  # the first is white
    wandering, log_share = unrecorded_cause(stated)
    assert {(noise.flicker, noise.walk) for noise in wandering} == {(stated.shape.flicker, stated.shape.walk)}
    assert np.exp(log_share).sum() == pytest.approx(1.0)


def test_below_a_limit_slow_noise_is_as_likely_as_it_usually_is() -> None:
    """Of a walk of which a measurement saw nothing: an upper limit says neither that there is none nor that it is there."""
    measured = NoiseModel(3e-4, 6e-4, at_most=(0.0, 3e-4), measured=True)  # of white noise of 100 s: 1/3, and 1/6 in an hour
    stated = Stated.of(measured, 100.0)
    assert stated == Stated(NoiseShape(pytest.approx(1.0 / 3.0), 0.0), 0.0, pytest.approx(1.0 / 6.0), 1e-3, 0.35)
    noises = ordinary_noise(stated)
    prior = dict(zip(noises, np.exp(log_prior(noises, stated)), strict=True))
    assert sum(prior.values()) == pytest.approx(1.0)
    of_walks = {walk: sum(p for noise, p in prior.items() if noise.walk == walk and noise.flicker in FLICKERS) for walk in WALKS}
    assert of_walks[0.0] / of_walks[0.07] == pytest.approx(WALKS[0.0] / WALKS[0.07], rel=0.01)
    assert sum(p for walk, p in of_walks.items() if walk >= 0.9) < 5e-3


# --- the null --------------------------------------------------------------------------------------------------------------


def test_p_values_of_noise_are_uniform() -> None:
    few = {name: CATALOGUE[name] for name in ("supply_voltage", "temperature_rate", "thermal_lag", "warm_up")}
    noises = tuple(NoiseShape(f, w) for f in (0.0, 0.3) for w in (0.0, 0.2))
    shapes = (NoiseShape(), NoiseShape(0.3, 0.0), NoiseShape(0.3, 0.2))
    found = []
    for seed in range(60):
        problem = Problem.of(SIMULATOR, runs(shapes[seed % 3], seed=100 + seed), window_s=100.0)
        evidence = Evidence(problem, candidates(problem, few)[0], noises)
        prior = np.full(len(noises), -math.log(len(noises)))
        found.append(detect(evidence, prior, np.ones(4, dtype=bool), len(evidence.candidates), np.random.default_rng(seed)).p_value)
    assert stats.kstest(found, "uniform").pvalue > 0.01


def test_the_tail_goes_on_beyond_the_replicates() -> None:
    replicates = np.random.default_rng(1).exponential(size=400)
    assert tail_probability(1.0, replicates) == pytest.approx(math.exp(-1.0), abs=0.06)
    assert tail_probability(20.0, replicates) == pytest.approx(math.exp(-20.0), rel=50.0)
    assert tail_probability(20.0, replicates) < 1e-6
    assert math.isfinite(math.log(tail_probability(2000.0, replicates)))  # and tested again by its logarithm


# --- the fit ---------------------------------------------------------------------------------------------------------------


def test_parameters_are_recovered_within_their_errors() -> None:
    ratios = []
    for seed in range(12):
        true = CATALOGUE["thermal_lag"](k_deg_h_K=1e-3, time_constant_s=800.0)
        problem = Problem.of(SIMULATOR, with_effect(runs(seed=seed, hours=8.0), true), window_s=100.0)
        start = dataclasses.replace(true, time_constant_s=900.0)
        fitted = fit(problem, [Candidate(start, problem.columns(start), 0.0)], NoiseShape())
        (cause,) = fitted.causes
        ratios += [
            (cause.estimates[name].value - getattr(true, name)) / cause.estimates[name].sd
            for name in ("k_deg_h_K", "time_constant_s")
        ]
        assert fitted.white_deg_h == pytest.approx(0.002, rel=0.15)
    assert np.sqrt(np.mean(np.square(ratios))) < 1.6


def test_wrong_numbers_are_not_missing_physics() -> None:
    stated = rlg.Simulator.from_mapping(
        {"kind": "chamber", "mechanisms": [{"thermal_polynomial": {"degree": 2}}, {"supply_voltage": {"k_deg_h_V": 0.5}}]}
    )
    recordings = with_effect(runs(seed=4, hours=8.0), CATALOGUE["supply_voltage"](k_deg_h_V=0.1))
    diagnosis = rlg.diagnose(stated, train=recordings, window_s=100.0, black_box=False)
    assert diagnosis.verdict == "none"
    assert diagnosis.p_value == diagnosis.unexplained.p_value > 0.05  # that nothing is missing once they are right
    assert diagnosis.wrong == ("supply_voltage",)
    assert "supply_voltage, said to be known, do not fit; with those of these runs what it leaves is noise" in str(diagnosis)
    assert sum("supply_voltage" in remark and "do not fit" in remark for remark in diagnosis.remarks) == 1
    assert not any("depart from noise" in remark for remark in diagnosis.remarks)
    assert diagnosis.train.augmented_rms == diagnosis.train.baseline_rms
    assert any("With its own numbers the simulator is off by" in remark for remark in diagnosis.remarks)
    (voltage,) = (m for m in diagnosis.augmented.mechanisms if m.name == "supply_voltage")
    assert voltage.k_deg_h_V == pytest.approx(0.1, abs=0.02)


def test_a_shape_of_the_simulator_that_missing_causes_pulled_away_is_found_beside_them() -> None:
    """Without the causes the lag's time constant would be 1000 s, and once they are known 60 s from there on."""
    polynomial = {"thermal_polynomial": {"degree": 3}}
    k, tau = -6e-4, 3700.0
    free = {"k_deg_h_K": {"value": -3e-4, "free": True}, "time_constant_s": {"value": 3000.0, "free": True}}
    stated = rlg.Simulator.from_mapping({"kind": "chamber", "mechanisms": [polynomial, {"thermal_lag": free}]})
    gyro = [
        polynomial,
        {"thermal_lag": {"k_deg_h_K": k, "time_constant_s": tau}},
        {"mode_hop": {"step_deg_h": 0.025, "threshold_degC": 18.0, "dead_band_K": 1.0}},
        {"rate_asymmetry": {"k_deg_h_min_K": -0.03}},
    ]
    made = rlg.Simulator.from_mapping({"kind": "chamber", "mechanisms": gyro, "noise": {"angle_random_walk_deg_sqrt_h": 8e-4}})
    train = [made.simulate(programme, seed=seed, step_s=10.0) for seed, programme in enumerate(("paper", "minor-loops"))]
    diagnosis = rlg.diagnose(stated, train=train, black_box=False)
    assert {cause.name for cause in diagnosis.causes} == {"mode_hop", "rate_asymmetry"}
    assert diagnosis.calibration["thermal_lag"]["time_constant_s"].value < 1500.0
    for name, true in (("k_deg_h_K", k), ("time_constant_s", tau)):
        found = diagnosis.recalibration["thermal_lag"][name]
        assert abs(found.value - true) < 3.0 * found.sd, name
        assert found.sd < 0.2 * abs(true), name


@pytest.mark.parametrize(
    ("name", "shape", "true", "stated"),
    [
        ("thermal_lag", "time_constant_s", 1700.0, 600.0),
        pytest.param("thermal_hysteresis", "radius_K", 9.0, 25.0, marks=pytest.mark.slow),
    ],
)
def test_a_shape_that_is_stated_wrong_is_a_wrong_number(name: str, shape: str, true: float, stated: float) -> None:
    """Its amplitudes free: a gradient and a rate had been named in place of a lag's time constant."""
    polynomial = {"thermal_polynomial": {"degree": 3}}
    sizes = [p.name for p in CATALOGUE[name].parameters() if p.role == "amplitude"]
    gyro = {name: dict.fromkeys(sizes, 0.0008) | {shape: true}}
    noise = {"angle_random_walk_deg_sqrt_h": 3e-4}
    made = rlg.Simulator.from_mapping({"kind": "chamber", "mechanisms": [polynomial, gyro], "noise": noise})
    said = rlg.Simulator.from_mapping({"kind": "chamber", "mechanisms": [polynomial, {name: {shape: stated}}]})
    train = [made.simulate(programme, seed=seed, step_s=10.0) for seed, programme in enumerate(("paper", "minor-loops"))]
    diagnosis = rlg.diagnose(said, train, black_box=False)
    assert diagnosis.verdict == "none"
    assert diagnosis.wrong == (name,)
    assert diagnosis.p_value > 0.01
    found = diagnosis.recalibration[name][shape]
    assert abs(found.value - true) < 4.0 * found.sd < 0.5 * true


@pytest.mark.parametrize("radius_K", [9.0, 14.0])
def test_a_free_shape_is_found_across_valleys_of_the_misfit(radius_K: float) -> None:
    """From the stated 27 K on the misfit falls into a valley at 19 or 27 K."""
    amplitudes = {"k1_deg_h_K": 6.5e-4, "k2_deg_h_K": -1.3e-3, "k3_deg_h_K": -9.6e-4}
    loop = {"thermal_hysteresis": amplitudes | {"radius_K": radius_K}}
    free = {name: {"value": value, "free": True} for name, value in (amplitudes | {"radius_K": 27.0}).items()}
    polynomial = {"thermal_polynomial": {"degree": 3}}
    stated = rlg.Simulator.from_mapping({"kind": "chamber", "mechanisms": [polynomial, {"thermal_hysteresis": free}]})
    noise = {"angle_random_walk_deg_sqrt_h": 3e-4}
    made = rlg.Simulator.from_mapping({"kind": "chamber", "mechanisms": [polynomial, loop], "noise": noise})
    train = [made.simulate(programme, seed=seed, step_s=10.0) for seed, programme in enumerate(("paper", "minor-loops"))]
    (found,) = (m for m in Problem.of(stated, train).simulator.mechanisms if m.name == "thermal_hysteresis")
    assert found.radius_K == pytest.approx(radius_K, rel=0.02)


def test_an_unrecorded_wander_is_unknown_without_a_name() -> None:
    recordings = runs(NoiseShape(wander=1.5, wander_s=1500.0), seed=4, hours=10.0)
    diagnosis = rlg.diagnose(SIMULATOR, train=recordings, window_s=100.0, black_box=False)
    assert diagnosis.verdict == "unknown"
    assert not diagnosis.causes
    assert diagnosis.unexplained.drivers == ()
    assert any("no recorded column follows" in remark for remark in diagnosis.remarks)


@pytest.mark.parametrize(("wander", "periods_h", "named"), [(2.0, (1.65, 1.85), []), (0.0, (1.7, 1.7), ["periodic_interference"])])
def test_what_swings_at_another_period_in_each_run_is_no_line(
    wander: float, periods_h: tuple[float, float], named: list[str]
) -> None:
    recordings = [
        run.replace(
            table=run.table.assign(
                gyro_deg_h=run.column("gyro_deg_h") + 0.003 * np.sin(2.0 * np.pi * run.time_s / (3600.0 * period_h))
            )
        )
        for run, period_h in zip(runs(NoiseShape(wander=wander, wander_s=13500.0), seed=1, hours=10.0), periods_h, strict=True)
    ]
    explanations = explain(Problem.of(SIMULATOR, recordings, window_s=100.0), CATALOGUE)
    best = explanations.models[0]
    assert sorted(name for name, _ in best.labels) == named
    assert (explanations.unrecorded(best) > 0.9) == (not named)


def test_explanations_hold_probabilities_and_reasons() -> None:
    problem = Problem.of(SIMULATOR, with_effect(runs(seed=6), CATALOGUE["ambient_pressure"](k_deg_h_hPa=0.004)), window_s=100.0)
    explanations = explain(problem, CATALOGUE)
    assert explanations.models[0].labels == {("ambient_pressure", False)}
    assert explanations.probabilities.sum() == pytest.approx(1.0)
    assert "magnetic_field" in explanations.left_out


def test_a_short_run_beside_long_ones_does_not_chop_them_up() -> None:
    long, short = runs(hours=12.0), runs(hours=2.0)
    assert default_window_s(long) == 100.0
    alone = default_window_s([run.between(0.0, 900.0) for run in _each_second(short)])
    beside = default_window_s([*_each_second(long), *(run.between(0.0, 900.0) for run in _each_second(short))])
    assert alone == round(899.0 / 200.0)
    assert beside == round(899.0 / (2 * FEWEST_WINDOWS))


def _each_second(recordings: list[rlg.Recording]) -> list[rlg.Recording]:
    """Runs of the same length with a sample a second."""
    found = []
    for run in recordings:
        time_s = np.arange(0.0, run.duration_s)
        found.append(rlg.Recording(pd.DataFrame({"time_s": time_s, "gyro_deg_h": np.zeros_like(time_s)}), name=run.name))
    return found


def test_members_span_their_sums_and_nothing_else(small: Evidence) -> None:
    names = [candidate.name for candidate in small.candidates]
    pair = [Member(names.index(name), 3) for name in ("supply_voltage", "ambient_pressure")]
    voltage, pressure = (small.candidates[member.candidate].columns[:, 0] for member in pair)
    both = voltage / voltage.std() - 0.5 * pressure / pressure.std()
    assert small.spans(pair, both + 3.0 * small.problem.baseline[:, 1]) == pytest.approx(1.0, abs=1e-9)
    assert small.spans(pair[:1], both) < 0.98
    assert small.spans([], both) == 0.0
    assert small.spans(pair, small.problem.baseline[:, 1]) == 0.0


def test_a_replicate_is_ranked_among_those_of_the_noise_it_is_credited_with() -> None:
    rng = np.random.default_rng(3)
    found = rng.exponential(size=40)
    alone = _own_p_values(found, _credited(np.zeros((1, 40)), np.zeros(1), np.ones(1)))
    np.testing.assert_allclose(np.sort(alone), np.arange(1, 41) / 40.0)
    quiet = np.arange(40) < 20  # each replicate shows plainly which of two noises it is of
    likelihood = np.where(np.array([quiet, ~quiet]), 0.0, -100.0)
    weights = _credited(likelihood, np.log([0.5, 0.5]), np.array([0.5, 0.5]))
    apart = _own_p_values(np.where(quiet, found, 10.0 + found), weights)
    for members in (quiet, ~quiet):
        np.testing.assert_allclose(np.sort(apart[members]), np.arange(1, 21) / 20.0)


def test_prepivoting_in_rounds_takes_the_lean_off_p_values_of_the_quietest_noise() -> None:
    scales, rng = np.array([1.0, 1.5, 2.25, 3.4]), np.random.default_rng(5)
    prior = np.full(4, -math.log(4.0))

    def log_likelihood(shown: np.ndarray) -> np.ndarray:
        return -0.5 * (shown[None] ** 2).sum(axis=-1) / scales[:, None] ** 2 - shown.shape[-1] * np.log(scales)[:, None]

    p_values = {rounds: [] for rounds in (0, 1, 5)}
    for _ in range(600):  # the statistic is as large as the noise, of which four numbers tell
        share = np.exp(log_likelihood(rng.normal(size=(1, 4)))[:, 0])
        share /= share.sum()
        drawn = scales[rng.choice(4, size=200, p=share)]
        weights = _credited(log_likelihood(drawn[:, None] * rng.normal(size=(200, 4))), prior, share)
        replicates = drawn * np.abs(rng.normal(size=200))
        value = float(np.abs(rng.normal()))
        for rounds, found in p_values.items():
            found.append(_prepivoted(value, replicates, weights, rounds))
    off = {rounds: stats.kstest(found, "uniform").statistic for rounds, found in p_values.items()}
    assert off[5] < 0.9 * off[1] < 0.9 * 0.9 * off[0]


def test_evidence_averaged_over_candidates_is_the_same_compiled(small: Evidence, monkeypatch: pytest.MonkeyPatch) -> None:
    targets = np.random.default_rng(0).normal(size=(len(small.problem.rows), 9))
    targets[:, 0] = 3.0 * small.candidates[0].columns[:, 0] / np.std(small.candidates[0].columns[:, 0])  # all but certain
    left, weights = small.left(1, targets), np.linspace(-3.0, 0.0, len(small.candidates) - 2)
    compiled = small.averaged(1, left, weights)
    monkeypatch.setenv("RLGCOMP_NUMBA", "0")
    np.testing.assert_allclose(compiled, small.averaged(1, left, weights), rtol=1e-10, atol=1e-10)
    assert compiled[0] > 50.0 > compiled[1:].max()


def test_sums_of_lines_by_a_table_are_the_sums_of_each() -> None:
    rng = np.random.default_rng(1)
    for rows, amplitudes in ((80, 2), (700, 4), (50_000, 12)):
        shares = np.minimum(rng.exponential(amplitudes / rows, (300, 40)), 0.9)
        shares[7, :4] = 0.3, 0.99, 1.0 - 1e-9, 1.0  # lines beyond the table, and all there is
        one, other = (function(shares, rows, amplitudes, rows - 4) for function in (_of_many, _of_each))
        np.testing.assert_allclose(one, other, rtol=1e-10, atol=1e-10)
