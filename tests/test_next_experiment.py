"""The next experiment: distances against brute force, programmes within what the laboratory has, and one run that settles it."""

from __future__ import annotations

import dataclasses
import itertools

import numpy as np
import pytest

import rlgcomp as rlg
from experiments.next_experiment.__main__ import of_truth, proposed_and_run
from rlgcomp.diagnosis.diagnose import diagnose
from rlgcomp.diagnosis.noise.whitening import NoiseShape, whiten
from rlgcomp.diagnosis.programmes.feasible import LONGEST_S, ChamberRange, chamber_programmes, table_programmes
from rlgcomp.diagnosis.programmes.next_experiment import _distances, _expected, _expected_of, _Run, next_experiment, told_apart
from rlgcomp.diagnosis.question.problem import Problem
from rlgcomp.physics.mechanism import Mechanism, amplitude
from rlgcomp.recording.motion import angle_deg, rate_deg_s
from rlgcomp.simulation.programme import PRESETS, Hold, Programme, Ramp
from rlgcomp.simulation.table_programme import TableProgramme

CATALOGUE = rlg.CATALOGUE
POLYNOMIAL = CATALOGUE["thermal_polynomial"]
FREE = {"thermal_polynomial": frozenset(p.name for p in POLYNOMIAL.parameters() if p.role == "amplitude")}
BASE = rlg.Simulator((POLYNOMIAL(),), free=FREE, noise=rlg.NoiseModel(angle_random_walk_deg_sqrt_h=0.0003))
WHITE_DEG_H = 0.0018
ONE_RAMP = "start 20, hold 30, ramp 50 1, hold 60, ramp 20 1, hold 30"
LAG = CATALOGUE["thermal_lag"](k_deg_h_K=0.0007, time_constant_s=1000.0)
RATE = CATALOGUE["temperature_rate"](k_deg_h_min_K=0.008)
LIGHT = CATALOGUE["light_intensity"]()


@pytest.fixture(scope="module")
def run() -> rlg.Recording:
    return BASE.with_mechanism(LAG).simulate(ONE_RAMP, seed=0, step_s=5.0)


@pytest.fixture(scope="module")
def problem(run: rlg.Recording) -> Problem:
    return Problem.of(BASE, [run])


def test_a_rival_that_names_nothing_is_said_to() -> None:
    """Numbers of the simulator that are wrong are no missing physics."""
    assert told_apart([(LAG,), (), (LAG, RATE)]) == ("thermal_lag", "nothing missing", "thermal_lag + temperature_rate")


@pytest.mark.parametrize("shape", [NoiseShape(), NoiseShape(flicker=0.3, walk=0.2)])
def test_distances_are_those_of_least_squares(problem: Problem, shape: NoiseShape) -> None:
    """Without shapes to fit, D² is what least squares leaves of one rival's prediction."""
    past = _Run(problem.rows, problem.baseline, problem.columns, shape, WHITE_DEG_H)
    found = _distances([(RATE,), (LIGHT,)], [past])
    tables = [problem.columns(RATE), problem.columns(LIGHT), problem.baseline]
    rate, light, baseline = (whiten(problem.rows, table / WHITE_DEG_H, (shape,))[0][0] for table in tables)
    for k, (truth, weight, rival) in enumerate(
        ((rate, RATE.k_deg_h_min_K, light), (light, [p.typical for p in LIGHT.amplitude_parameters()], rate))
    ):
        target = truth @ np.atleast_1d(weight)
        design = np.column_stack([baseline, rival])
        design /= np.linalg.norm(design, axis=0)
        left = target - design @ np.linalg.lstsq(design, target, rcond=1e-12)[0]
        assert found[k, 1 - k] == pytest.approx(left @ left, rel=1e-6)
    assert np.diag(found).tolist() == [0.0, 0.0]


def test_a_cause_with_amplitudes_by_run_beside_the_rivals(run: rlg.Recording) -> None:
    other = BASE.simulate(ONE_RAMP, seed=1, step_s=5.0, name="other")
    line = CATALOGUE["periodic_interference"]()
    found = next_experiment(
        Problem.of(BASE, [run, other]), [(LAG, line), (RATE, line)], shape=NoiseShape(), white_deg_h=WHITE_DEG_H
    )
    assert found is not None
    assert 0.5 <= found.expected_probability_after <= 1.0


@pytest.mark.parametrize(("noise", "proposed"), [(1.0, True), (1.1, False)])
def test_what_leaves_less_expected_than_is_known_is_not_proposed(problem: Problem, noise: float, proposed: bool) -> None:
    """Expected afterwards are 0.806 and 0.795; the likelier of the two has 0.8 already."""
    found = next_experiment(
        problem,
        [(LAG,), (RATE,)],
        shape=NoiseShape(),
        white_deg_h=noise * WHITE_DEG_H,
        probabilities=[0.8, 0.2],
        programmes=[Programme.parse("start 20, hold 30, ramp 20.6 1, hold 60, ramp 20 1, hold 30")],
    )
    assert (found is not None) is proposed


def test_a_shape_that_is_free_can_come_close(problem: Problem) -> None:
    """A lag imitates a rate by becoming short; a rate cannot imitate a lag."""
    past = _Run(problem.rows, problem.baseline, problem.columns, NoiseShape(), WHITE_DEG_H)
    coarse = _distances([(LAG,), (RATE,)], [past])
    fine = _distances([(LAG,), (RATE,)], [past], refine=True)
    assert fine[1, 0] < 0.1 * fine[0, 1]
    assert (fine <= coarse + 1e-9).all()


def test_expected_probability_against_draws() -> None:
    rng = np.random.default_rng(0)
    prior = np.array([0.5, 0.3, 0.2])
    distances = np.array([[0.0, 6.0, 2.0], [5.0, 0.0, 9.0], [1.0, 12.0, 0.0]])
    each = np.empty(3)
    for k in range(3):
        z = rng.standard_normal(400_000)
        against = sum(prior[j] * np.exp(-0.5 * distances[k, j] - np.sqrt(distances[k, j]) * z) for j in range(3) if j != k)
        each[k] = np.mean(prior[k] / (prior[k] + against))
    assert _expected_of(prior, distances) == pytest.approx(each, abs=4e-3)
    assert _expected_of(prior, np.zeros((3, 3))) == pytest.approx(prior)
    assert _expected_of(prior, 1e4 * (1.0 - np.eye(3))) == pytest.approx(1.0)
    unsure = np.full((3, 1), 2.0)
    halves = _expected_of(prior, distances), _expected_of(prior, distances - unsure)
    assert _expected(prior, distances, unsure) == pytest.approx(np.mean(halves, axis=0))


def test_the_ratio_of_likelihoods_comes_out_as_foretold() -> None:
    """Mean D²/2, variance D²: simulated runs, the rival fitted to each, against the distance computed without data."""
    truth = CATALOGUE["temperature_rate"](k_deg_h_min_K=0.004)
    simulator = BASE.with_mechanism(truth)
    ratios, squared = [], []
    for seed in range(40):
        problem = Problem.of(BASE, [simulator.simulate("short", seed=seed, step_s=20.0)])
        past = _Run(problem.rows, problem.baseline, problem.columns, NoiseShape(), WHITE_DEG_H)
        squared.append(_distances([(truth,), (LIGHT,)], [past])[0, 1])
        left = []
        for mechanism in (truth, LIGHT):
            design = np.column_stack([past.baseline, past.of(mechanism)])
            design /= np.linalg.norm(design, axis=0)
            target = problem.target_deg_h / WHITE_DEG_H
            residual = target - design @ np.linalg.lstsq(design, target, rcond=1e-12)[0]
            left.append(residual @ residual)
        ratios.append(0.5 * (left[1] - left[0]))
    expected = 0.5 * np.mean(squared)
    assert np.mean(ratios) == pytest.approx(expected, abs=4.0 * np.sqrt(2.0 * expected / 40) + 0.5)


def test_no_step_of_a_programme_is_empty() -> None:
    cold_start = BASE.simulate("start -30, hold 20, ramp 45 0.5, hold 20, ramp -30 0.5, hold 20", step_s=10.0)
    for run in (cold_start, cold_start.replace(metadata=rlg.Metadata())):
        found = chamber_programmes([run])
        assert found
        for programme in found:
            at = programme.start_degC
            for step in programme.steps:
                if isinstance(step, Ramp):
                    assert abs(step.to_degC - at) > 0.4
                    at = step.to_degC
            assert not any(isinstance(a, Hold) and isinstance(b, Hold) for a, b in itertools.pairwise(programme.steps))
    longest_cycle = chamber_programmes([cold_start])[0]
    assert str(longest_cycle).endswith("hold 120")
    assert longest_cycle.duration_s == pytest.approx(60.0 * (30.0 + 60.0 + 120.0 + 2.0 * 75.0 / 0.5), rel=0.02)


def test_chamber_programmes_stay_within_what_was_recorded() -> None:
    told = BASE.simulate("start 15, hold 20, ramp 40 0.8, hold 20, ramp -10 0.8, hold 20", step_s=10.0)
    silent = told.replace(metadata=rlg.Metadata())
    for run in (told, silent):
        found = chamber_programmes([run])
        assert len(found) >= 8
        for programme in found:
            assert -12.0 <= programme.corners[1].min()
            assert programme.corners[1].max() <= 42.0
            assert max(step.rate_degC_min for step in programme.steps if isinstance(step, Ramp)) <= 0.85
            assert Programme.parse(str(programme)) == programme


def test_table_programmes_turn_no_faster_than_recorded() -> None:
    table = rlg.Simulator(kind="turntable")
    run = table.simulate("rate 20 200, rate -20 200, rest 100")
    found = table_programmes([run])
    assert len(found) >= 5
    for programme in found:
        assert np.abs(programme.corners[1]).max() <= 21.1
        assert TableProgramme.parse(str(programme)) == programme
    assert float(np.abs(rate_deg_s(run)).max()) == pytest.approx(20.0, rel=1e-3)


def test_programmes_are_in_numbers_that_can_be_set() -> None:
    """Thermometers that err, and a chamber that does not quite follow: whole degrees, two digits of a rate, nothing beyond."""
    told = BASE.simulate("start 0, hold 20, ramp 40 0.5, hold 20, ramp -10 0.5, hold 20, ramp 0 0.5", step_s=10.0)
    odd = told.table.assign(temperature_block_degC=0.971 * told.column("temperature_block_degC") + 0.00312)
    for programme in chamber_programmes([rlg.Recording(odd, rlg.Metadata(kind="chamber"), name="odd")]):
        if str(programme) in PRESETS.values():
            continue
        ramps = [step for step in programme.steps if isinstance(step, Ramp)]
        assert all(value == round(value) for value in (programme.start_degC, *(ramp.to_degC for ramp in ramps)))
        assert all(ramp.rate_degC_min == float(f"{ramp.rate_degC_min:.2g}") <= 0.5 for ramp in ramps)
        assert odd["temperature_block_degC"].min() - 0.1 <= programme.corners[1].min()
        assert programme.corners[1].max() <= odd["temperature_block_degC"].max() + 0.1
        assert "-0," not in str(programme)
    narrow = odd.assign(temperature_block_degC=20.0 + 0.08 * odd["temperature_block_degC"])
    few_degrees = chamber_programmes([rlg.Recording(narrow, rlg.Metadata(kind="chamber"), name="narrow")])
    assert few_degrees[0].start_degC == 20.0
    assert all(10.0 * one.corners[1][1:] == pytest.approx(np.rint(10.0 * one.corners[1][1:])) for one in few_degrees)
    table = rlg.Simulator(kind="turntable")
    for turning in table_programmes([table.simulate("rate 37.77 200, rate -37.77 200, rest 100")]):
        rates = np.abs(turning.corners[1])
        assert all(float(f"{rate:.2g}") == rate <= 37.77 for rate in rates)
    assert not table_programmes([table.simulate("rest 300")])


def test_a_slow_chamber_goes_less_far_before_nothing_is_proposed() -> None:
    """Runs that only heat, at 0.2 K/min: to cool as well tells a rate from its magnitude, and nothing less does."""
    rate, magnitude = CATALOGUE["temperature_rate"](k_deg_h_min_K=0.02), CATALOGUE["rate_asymmetry"](k_deg_h_min_K=0.02)
    heating = ("start 20, hold 60, ramp 60 0.2, hold 60", "start -10, hold 60, ramp 40 0.2, hold 60")
    runs = [BASE.with_mechanism(rate).simulate(text, seed=k, step_s=10.0) for k, text in enumerate(heating)]
    made = chamber_programmes(runs)
    assert len(made) >= 8
    assert all(programme.duration_s <= LONGEST_S for programme in made)
    assert min(np.ptp(programme.corners[1]) for programme in made) >= 10.0
    found = next_experiment(Problem.of(BASE, runs), [(rate,), (magnitude,)], shape=NoiseShape(), white_deg_h=WHITE_DEG_H)
    assert found is not None
    assert found.expected_probability_after > 0.99


@dataclasses.dataclass(frozen=True)
class RateCubed(Mechanism):
    """What a user may write beside the catalogue's cubic, from the encoder."""

    name = "rate_cubed"
    kind = "turntable"
    equation = "b = k * W^3"
    reference = "test"
    drivers = ("table_angle_deg",)
    fast = True

    k_ppm: float = amplitude(3.0, "ppm")

    def basis(self, recording: rlg.Recording) -> np.ndarray:
        (angle,) = self.read(recording)
        rate = np.diff(angle, prepend=2.0 * angle[0] - angle[1]) / recording.period_s
        return np.asarray(3.6e-3 * rate * (rate / 40.0) ** 2)[:, None]


@pytest.mark.parametrize("encoder_alone", [True, False])
def test_one_physics_written_twice_is_not_told_apart(encoder_alone: bool) -> None:
    """The encoder runs on in the run that is foreseen as in those that were read, and turns less than half a turn a sample."""
    table = rlg.Simulator((CATALOGUE["scale_factor"](),), free={"scale_factor": frozenset({"k_ppm"})}, kind="turntable")
    run = table.simulate("rest 300, rate 30 600, rate -20 600, rate 60 600, rate -60 600, rest 300", step_s=1.0)
    read = run.table.assign(table_angle_deg=angle_deg(run))
    run = run.replace(table=read.drop(columns="table_rate_deg_s") if encoder_alone else read)
    cubic = CATALOGUE["scale_factor_nonlinearity"](k_ppm=18.75, order=3)
    given = {"shape": NoiseShape(), "white_deg_h": 0.003}
    assert next_experiment(Problem.of(table, [run]), [(RateCubed(),), (cubic,)], **given) is None
    quadratic = dataclasses.replace(cubic, order=2)
    found = next_experiment(Problem.of(table, [run]), [(RateCubed(),), (quadratic,)], **given)
    assert found is not None


@pytest.mark.parametrize("thermometers", [True, False])
def test_rivals_on_a_table_get_a_table_programme(thermometers: bool) -> None:
    table = rlg.Simulator(
        (CATALOGUE["scale_factor"](),), free={"scale_factor": frozenset({"k_ppm", "bias_deg_h"})}, kind="turntable"
    )
    run = table.simulate("rest 300, rate 30 600, rate -30 600, rate 60 600, rate -60 600, rest 300")
    if not thermometers:
        run = run.replace(table=run.table.drop(columns=[name for name in run.columns if name.startswith("temperature_")]))
    problem = Problem.of(table, [run])
    rivals = [(CATALOGUE["lock_in"](),), (CATALOGUE["scale_factor_nonlinearity"](),)]
    found = next_experiment(problem, rivals, shape=NoiseShape(), white_deg_h=0.01)
    assert found is not None
    assert TableProgramme.parse(found.profile).duration_s > 0.0
    assert found.separates == ("lock_in", "scale_factor_nonlinearity")
    assert found.expected_probability_after == pytest.approx(np.mean(found.if_true))


def test_a_table_in_another_temperature_is_proposed_where_one_was_recorded() -> None:
    """A scale factor and what temperature does to it: told apart by no rate, nor by a warmth that nobody sets."""
    noise = rlg.NoiseModel(angle_random_walk_deg_sqrt_h=0.001)
    quiet = dataclasses.replace(rlg.Simulator(kind="turntable").table, room_drift_K=0.0, warm_up_K=0.0)
    table = rlg.Simulator((CATALOGUE["misalignment"](),), kind="turntable", table=quiet, noise=noise)
    rivals = [(CATALOGUE["scale_factor"](k_ppm=5.0),), (CATALOGUE["scale_factor_temperature"](k_ppm_K=5.0 / 2.0),)]
    turning = "rate 30 600, rate -30 600, rate 60 600, rate -60 600"
    at_22 = [table.simulate(f"room 22, {turning}", seed=seed, step_s=10.0) for seed in (1, 2)]
    given = {"shape": NoiseShape(), "white_deg_h": 0.05}
    assert {one.room_degC for one in table_programmes(at_22)} == {22.0}
    assert next_experiment(Problem.of(table, at_22), rivals, **given) is None
    rested = table.simulate("room 45, rest 1200, rate 5 60", seed=3, step_s=10.0)
    assert {one.room_degC for one in table_programmes([*at_22, rested])} == {22.0, 45.0}
    found = next_experiment(Problem.of(table, [*at_22, rested]), rivals, **given)
    assert found is not None
    assert found.profile.startswith("room 45, ")
    assert found.expected_probability_after > 0.99


def test_what_a_chamber_can_do_may_be_told(problem: Problem) -> None:
    wider = chamber_programmes(problem.runs, ChamberRange.of((-40, 70, 2)))
    ends = [temperature for programme in wider for temperature in programme.corners[1]]
    assert (min(ends), max(ends)) == (-40.0, 70.0)
    assert max(step.rate_degC_min for one in wider for step in one.steps if isinstance(step, Ramp)) == 2.0
    narrow = chamber_programmes(problem.runs, ChamberRange.of((25, 40, 0.5)))
    assert all(25.0 - 2.0 <= one.corners[1].min() and one.corners[1].max() <= 40.0 + 2.0 for one in narrow)
    for wrong in ((70, -40, 2), (-40, 70, 0), (-40, np.inf, 2), (-40, 70)):
        with pytest.raises(rlg.InputError, match="as -40 70 2"):
            ChamberRange.of(wrong)
    with pytest.raises(rlg.InputError, match="the chamber's range is 70 -40 2"):
        diagnose(BASE, problem.runs, chamber=(70, -40, 2))


def test_it_is_said_where_rivals_differ(problem: Problem) -> None:
    """A warming and a lag, for half a day at one temperature: in the first hours. A lag and a rate: all along."""
    rest, ramps = (
        Programme.parse("start 20, hold 720"),
        Programme.parse("start 20, hold 90, ramp 50 1, hold 60, ramp 20 1, hold 30"),
    )
    warming = CATALOGUE["warm_up"](initial_deg_h=0.02, time_constant_s=2000.0)
    given = {"shape": NoiseShape(), "white_deg_h": WHITE_DEG_H}
    found = next_experiment(problem, [(warming,), (LAG,)], programmes=[rest], **given)
    assert found is not None
    assert found.duration_s == rest.duration_s
    assert found.shows_s is not None
    assert 0.0 <= found.shows_s[0] < found.shows_s[1] < 2.0 * 3600.0
    found = next_experiment(problem, [(LAG,), (RATE,)], programmes=[ramps], **given)
    assert found is not None
    assert found.shows_s is None


def test_there_is_none_where_nothing_can_be_commanded(problem: Problem) -> None:
    telegraph = CATALOGUE["random_telegraph"]()
    assert next_experiment(problem, [(telegraph,), (LAG,)], shape=NoiseShape(), white_deg_h=WHITE_DEG_H) is None
    assert next_experiment(problem, [(LAG,)], shape=NoiseShape(), white_deg_h=WHITE_DEG_H) is None


def test_the_experiment_on_experiments_runs_what_is_proposed() -> None:
    """One gyro at rest that warms up, of another implementation: told from a lag by the run that is proposed."""
    row = proposed_and_run("warm_up", "rests", 0.4, 910_200)
    assert row["verdict"] == "ambiguous"
    shares = [of_truth(row[key], "warm_up", row["rivals"]) for key in ("shares", "after")]
    assert shares[1] > max(0.9, shares[0])
    assert of_truth({"ageing": 0.2, "warm_up": 0.2, "": 0.6}, "ageing", ("warm_up",)) == pytest.approx(0.5)
    assert of_truth({}, "ageing", ("warm_up",)) == 0.0


@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.slow), pytest.param(2, marks=pytest.mark.slow)])
def test_running_it_settles_the_question(seed: int) -> None:
    """A weak lag, one short run: ambiguous. With the run that is proposed the right cause is named."""
    rivals = {name: CATALOGUE[name] for name in ("thermal_lag", "temperature_rate", "thermal_hysteresis")}
    truth = BASE.with_mechanism(LAG)
    first = truth.simulate(ONE_RAMP, seed=seed, step_s=5.0, name="first")
    before = diagnose(BASE, [first], mechanisms=rivals, black_box=False)
    assert before.verdict == "ambiguous"
    proposed = before.next_experiment
    assert proposed is not None
    assert proposed.expected_probability_after > max(cause.probability for cause in before.causes) - 0.2
    second = truth.simulate(proposed.profile, seed=seed + 50, step_s=5.0, name="second")
    after = diagnose(BASE, [first, second], mechanisms=rivals, black_box=False)
    assert [cause.name for cause in after.causes] == ["thermal_lag"]
    assert after.verdict == "explained"
    assert after.causes[0].probability > 0.95
