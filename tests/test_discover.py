"""Discovery: laws of other implementations found with drivers and memory, nulls left alone, and a referee for the Bayes factor."""

from __future__ import annotations

import dataclasses
import functools
import itertools
import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy import signal
from scipy.linalg import block_diag
from scipy.special import logsumexp

import rlgcomp as rlg
from rlgcomp.diagnosis.conclusion import by_another_name
from rlgcomp.diagnosis.fitting.fit import fit
from rlgcomp.diagnosis.laws.dictionary import Dictionary, differences, recorded_drivers
from rlgcomp.diagnosis.laws.discover import Discovery, discover, discover_laws
from rlgcomp.diagnosis.laws.families import Axis, Family
from rlgcomp.diagnosis.naming.background import Background
from rlgcomp.diagnosis.naming.candidates import Candidate
from rlgcomp.diagnosis.naming.evidence import SIZES
from rlgcomp.diagnosis.naming.explain import considered, explain
from rlgcomp.diagnosis.noise.noises import STEEP_WALKS, WANDERS, WANDERS_AGAINST_LAWS
from rlgcomp.diagnosis.noise.whitening import NoiseShape, simulate
from rlgcomp.diagnosis.question.problem import Problem
from rlgcomp.physics import CATALOGUE
from rlgcomp.physics.empirical_law import EmpiricalLaw
from rlgcomp.physics.mechanism import Mechanism

STEP_S = 20.0
WHITE_DEG_H = 0.002  # standard deviation of a 100 s mean
DRIVERS = ("temperature_block_degC", "temperature_shell_degC", "supply_voltage_V", "magnetic_field_uT")
NOISES = (NoiseShape(), NoiseShape(0.16, 0.1), NoiseShape(0.32, 0.25), NoiseShape(0.0, 0.0, 1.0, 3000.0))
SIMULATOR = rlg.Simulator.from_mapping({"kind": "chamber", "mechanisms": ["thermal_polynomial"]})
Effect = Callable[[pd.DataFrame], np.ndarray]


def wander(rng: np.random.Generator, n: int, correlation_s: float) -> np.ndarray:
    keep = math.exp(-STEP_S / correlation_s)
    return signal.lfilter([math.sqrt(1.0 - keep**2)], [1.0, -keep], rng.standard_normal(n + 500))[500:]


@functools.cache
def monitors(seed: int, corners: tuple[float, ...]) -> pd.DataFrame:
    """A chamber run of about ten hours: a hold and a ramp to each corner."""
    rng = np.random.default_rng(seed)
    path = [np.full(int(2400 / STEP_S), corners[0])]
    for a, b in itertools.pairwise(corners):
        path += [np.linspace(a, b, int(abs(b - a) * 60 / STEP_S)), np.full(int(3600 / STEP_S), b)]
    chamber = np.concatenate(path)
    shell, block = (signal.lfilter([1 - k], [1.0, -k], chamber - chamber[0]) + chamber[0] for k in (0.97, 0.99))
    n = len(chamber)
    return pd.DataFrame(
        {
            "time_s": STEP_S * np.arange(n),
            "temperature_block_degC": block,
            "temperature_shell_degC": shell,
            "supply_voltage_V": 15.0 + 0.02 * wander(rng, n, 3600.0),
            "magnetic_field_uT": 48.0 + 3.0 * wander(rng, n, 4000.0),
        }
    )


TRAIN = ((1, (20.0, -30.0, 50.0, 20.0)), (2, (20.0, 55.0, 10.0, 40.0, -20.0)))
TEST = ((3, (10.0, 45.0, -25.0, 30.0)), (4, (0.0, 40.0, 15.0, 50.0, -10.0)))


def runs(which: tuple[tuple[int, tuple[float, ...]], ...], effect: Effect, size: float, noisy: bool = True) -> list[rlg.Recording]:
    made = []
    for seed, corners in which:
        table = monitors(seed, corners)
        white, kicks = np.random.default_rng(seed + 100).standard_normal((2, len(table)))
        noise = WHITE_DEG_H * (math.sqrt(100.0 / STEP_S) * white + 0.1 * math.sqrt(STEP_S / 3600.0) * np.cumsum(kicks))
        t = (table["temperature_block_degC"].to_numpy() - 20.0) / 40.0
        gyro = 0.004 + 0.005 * t - 0.002 * t**3 + size * effect(table) + noisy * noise
        reading = np.random.default_rng(seed + 300).standard_normal(len(table))
        seen = table.assign(supply_voltage_V=table["supply_voltage_V"] + 3e-4 * reading)
        made.append(rlg.Recording(seen.assign(gyro_deg_h=gyro), name=f"run{seed}"))
    return made


def problem_of(effect: Effect, strength: float) -> tuple[Problem, float]:
    """Training runs with an effect, its size such that what a cubic leaves of it is `strength` times the white noise."""
    clean = Problem.of(SIMULATOR, runs(TRAIN, effect, 1.0, noisy=False))
    left = clean.target_deg_h - clean.baseline @ np.linalg.lstsq(clean.baseline, clean.target_deg_h, rcond=None)[0]
    size = strength * WHITE_DEG_H / float(np.std(left)) if strength else 0.0
    return Problem.of(SIMULATOR, runs(TRAIN, effect, size)), size


def voltage(table: pd.DataFrame) -> np.ndarray:
    return (table["supply_voltage_V"].to_numpy() - 15.0) / 0.02


def slow(table: pd.DataFrame) -> np.ndarray:
    """Forward Euler steps of a first-order lag of forty minutes."""
    y, out = voltage(table)[0], []
    for x in voltage(table):
        y += STEP_S / 2400.0 * (x - y)
        out.append(y)
    return np.array(out)


def slipping(table: pd.DataFrame) -> np.ndarray:
    """Relays, rarer the wider they are."""
    middle, half = np.meshgrid(np.linspace(-5.0, 5.0, 160), -0.5 * np.log1p(-(np.arange(12) + 0.5) / 12))
    up, down = (middle + half).ravel(), (middle - half).ravel()
    u = voltage(table)
    state = np.where(u[0] >= middle.ravel(), 1.0, -1.0)
    out = np.empty(len(u))
    for k, x in enumerate(u):
        state[x >= up], state[x <= down] = 1.0, -1.0
        out[k] = state.mean()
    return 5.0 * out


def slipping_from_below(table: pd.DataFrame) -> np.ndarray:
    """The reading had come up from zero before the run: what a play that begins at zero holds."""
    u, held, out = table["supply_voltage_V"].to_numpy(), 0.0, []
    for x in u:
        held = max(x - 0.03, min(x + 0.03, held))
        out.append(held)
    return np.array(out)


def warming(table: pd.DataFrame) -> np.ndarray:
    """A temperature times its own rate."""
    block = table["temperature_block_degC"].to_numpy()
    return (block - 20.0) * np.gradient(block, STEP_S)


LAWS: dict[str, tuple[Effect, set[str], str]] = {
    "product": (
        lambda table: voltage(table) * (table["magnetic_field_uT"].to_numpy() - 48.0) / 3.0,
        {"supply_voltage_V", "magnetic_field_uT"},
        "static",
    ),
    "threshold": (lambda table: np.maximum(voltage(table) - 0.3, 0.0), {"supply_voltage_V"}, "static"),
    "resonance": (
        lambda table: 1.0 / (1.0 + ((table["temperature_block_degC"].to_numpy() - 31.0) / 1.5) ** 2),
        {"temperature_block_degC"},
        "static",
    ),
    "warming": (warming, {"temperature_block_degC"}, "dynamic"),
    "lag": (slow, {"supply_voltage_V"}, "dynamic"),
    "hysteresis": (slipping, {"supply_voltage_V"}, "rate-independent"),
    "hysteresis from below": (slipping_from_below, {"supply_voltage_V"}, "rate-independent"),
}


def test_where_a_driver_had_come_from_is_found() -> None:
    discovery, problem, _ = found("hysteresis from below")
    assert discovery is not None
    assert discovery.mechanism.start == "from_below"
    assert ", from below" in discovery.equation
    column = problem.columns(discovery.mechanism)[:, 0]
    truth = problem.columns(dataclasses.replace(discovery.mechanism, memory="play", radius=0.03))[:, 0]
    assert abs(np.corrcoef(column, truth)[0, 1]) > 0.99


@functools.cache
def found(name: str) -> tuple[Discovery | None, Problem, float]:
    problem, size = problem_of(LAWS[name][0], 1.5)
    return discover(problem, problem.baseline, NOISES), problem, size


def test_held_out_runs_say_which_of_the_laws_it_is_that_training_hardly_tells_apart() -> None:
    """Not that there is one, nor one that training refuses."""
    problem, _ = problem_of(LAWS["threshold"][0], 0.6)
    plain = discover(problem, problem.baseline, NOISES)
    assert plain is not None
    asked: list[str] = []

    def foreseen(law: Mechanism) -> float:
        assert isinstance(law, EmpiricalLaw)
        asked.append(law.form)
        return 0.0 if law.form == plain.mechanism.form else 20.0

    other = discover(problem, problem.baseline, NOISES, foreseen=foreseen)
    assert other is not None
    assert 2 <= len(asked) <= 8
    assert other.mechanism.form in set(asked) - {plain.mechanism.form}
    assert other.log_bayes_factor == plain.log_bayes_factor
    same = discover(problem, problem.baseline, NOISES, foreseen=lambda law: 3.0)
    assert same is not None
    assert same.mechanism == plain.mechanism


def test_a_mechanism_by_another_name_has_its_own_prior() -> None:
    """Where held-out runs prefer a curve by chance, that makes no law of what the catalogue has; a lag that is there stays one."""
    problem = problem_of(lambda table: (table["magnetic_field_uT"].to_numpy() - 48.0) / 3.0, 0.3)[0]
    lines = {name: problem.columns(EmpiricalLaw(driver=name))[:, 0] for name in ("magnetic_field_uT", "supply_voltage_V")}

    def more_usual(law: Mechanism) -> float:
        column = problem.columns(law)[:, 0]
        alike = max(abs(np.corrcoef(column, line)[0, 1]) for line in lines.values())
        return 0.8 if alike > 0.98 else -math.inf

    def by_chance(law: Mechanism) -> float:
        return 4.0 if isinstance(law, EmpiricalLaw) and law.exponent == 2 else 0.0

    plain = discover(problem, problem.baseline, NOISES, foreseen=by_chance)
    usual = discover(problem, problem.baseline, NOISES, foreseen=by_chance, more_usual=more_usual)
    assert plain is not None
    assert usual is not None
    assert (plain.mechanism.exponent, usual.mechanism.exponent) == (2, 1)
    assert usual.log_bayes_factor == plain.log_bayes_factor
    late, slower, _ = found("lag")
    again = discover(slower, slower.baseline, NOISES, more_usual=more_usual)
    assert late is not None
    assert again is not None
    assert again.mechanism == late.mechanism


def test_held_out_runs_make_sure_of_a_law_that_training_speaks_for() -> None:
    """A product at a third of the noise: training alone is not a hundred to one for it, and held-out runs without it deny it."""
    product, drivers, memory = LAWS["product"]
    problem, size = problem_of(product, 0.35)
    assert discover(problem, problem.baseline, NOISES) is None
    training = runs(TRAIN, product, size)
    alone = rlg.diagnose(SIMULATOR, train=training, black_box=False)
    borne_out = rlg.diagnose(SIMULATOR, train=training, test=runs(TEST, product, size), black_box=False)
    denied = rlg.diagnose(SIMULATOR, train=training, test=runs(TEST, product, 0.0), black_box=False)
    assert (alone.verdict, borne_out.verdict, denied.verdict) == ("none", "unknown", "none")
    assert set(borne_out.unexplained.drivers) == drivers
    assert borne_out.unexplained.memory == memory


def test_a_law_that_makes_held_out_runs_worse_is_none() -> None:
    """Not asked before, they deny it afterwards: something is there in training, and follows no column."""
    product, drivers, _ = LAWS["product"]
    _, size = problem_of(product, 2.0)
    training = runs(TRAIN, product, size)
    returns, turned = (
        rlg.diagnose(SIMULATOR, train=training, test=runs(TEST, product, times * size), black_box=False, confirm=False)
        for times in (1.0, -1.0)
    )
    assert (returns.verdict, turned.verdict) == ("unknown", "unknown")
    assert set(returns.unexplained.drivers) == drivers
    assert turned.unexplained.drivers == ()
    assert turned.unexplained.equation is None
    assert not turned.changed
    assert sum("runs held out are further off" in remark for remark in turned.remarks) == 1
    assert not any("runs held out are further off" in remark for remark in returns.remarks)


@pytest.mark.parametrize("name", LAWS)
def test_a_law_is_found_with_its_drivers_and_its_memory(name: str) -> None:
    discovery, _, _ = found(name)
    assert discovery is not None
    assert set(discovery.drivers) == LAWS[name][1]
    assert discovery.memory == LAWS[name][2]
    assert discovery.memory_probabilities[discovery.memory] > 0.9
    assert discovery.driver_probabilities[discovery.drivers] > 0.9
    assert discovery.p_value < 1e-6
    assert sum(discovery.memory_probabilities.values()) == pytest.approx(1.0)
    for driver in discovery.drivers:
        assert driver in discovery.equation


@pytest.mark.parametrize("period_K", [4.3, 6.0, 9.0, 17.0])
def test_fringes_over_temperature_are_found_however_many(period_K: float) -> None:
    problem, _ = problem_of(lambda table: np.sin(2.0 * np.pi * table["temperature_block_degC"].to_numpy() / period_K), 0.8)
    law = discover(problem, problem.baseline, NOISES)
    assert law is not None
    assert isinstance(law.mechanism, EmpiricalLaw)
    assert (law.mechanism.form, law.drivers, law.memory) == ("periodic", ("temperature_block_degC",), "static")
    assert law.mechanism.width == pytest.approx(period_K, rel=0.02)


@pytest.mark.parametrize("strength", [0.4, 0.5, 0.7])
@pytest.mark.parametrize("column", ["supply_voltage_V", "magnetic_field_uT"])
def test_a_straight_line_is_told_as_one(column: str, strength: float) -> None:
    """No play of a radius that hardly matters, no step of great width, no lag of a window or two."""
    problem, _ = problem_of(lambda table: table[column].to_numpy() - table[column].iloc[0], strength)
    law = discover(problem, problem.baseline, NOISES)
    assert law is not None
    assert law.drivers == (column,)
    assert (law.memory, law.mechanism.memory, law.mechanism.form, law.mechanism.exponent) == ("static", "static", "power", 1)
    assert law.memory_probabilities["static"] > 0.5


def test_limits_of_laws() -> None:
    lag, radius, width, lead = (
        Axis("lag", 1.0, 9.0, 3),
        Axis("radius", 0.1, 0.9, 3),
        Axis("width", 0.2, 0.8, 2),
        Axis("lead", 2.0, 60.0, 1),
    )
    line, late = Family("T", "", "static", "power", 1, ()), Family("T", "", "lag", "power", 1, (lag,))
    play, bent = Family("T", "", "plays", "power", 1, (radius,)), Family("T", "", "plays", "saturation", 1, (radius, width))
    narrow, seen_late = Family("T", "", "static", "bump", 1, (width,)), Family("T", "", "static", "bump", 1, (width, lead))
    assert all(line.is_limit_of(other) for other in (late, play, bent))
    assert play.is_limit_of(bent)
    assert not any(line.is_limit_of(other) for other in (line, narrow, dataclasses.replace(late, driver="V")))
    assert not line.is_limit_of(Family("T", "", "rate", "power", 2, (lag,)))
    assert not narrow.is_limit_of(seen_late)


@pytest.mark.parametrize("name", LAWS)
def test_it_predicts_other_programmes_nearly_as_one_who_knows_it(name: str) -> None:
    """Held-out error against the noise-free truth, with the baseline refitted, against least squares with the true column."""
    discovery, problem, size = found(name)
    effect = LAWS[name][0]
    held_out = Problem.of(SIMULATOR, runs(TEST, effect, size, noisy=False))
    truth = held_out.target_deg_h
    pure = [Problem.of(SIMULATOR, runs(which, effect, size, noisy=False)) for which in (TRAIN, TEST)]
    plain = [Problem.of(SIMULATOR, runs(which, effect, 0.0, noisy=False)) for which in (TRAIN, TEST)]
    columns = [one.target_deg_h - other.target_deg_h for one, other in zip(pure, plain, strict=True)]
    errors = {}
    laws = {
        "nothing": ([np.empty((len(problem.rows), 0))], [np.empty((len(truth), 0))]),
        "law": ([problem.columns(discovery.mechanism)], [held_out.columns(discovery.mechanism)]),
        "oracle": ([columns[0][:, None]], [columns[1][:, None]]),
    }
    for who, (known, new) in laws.items():
        weights = np.linalg.lstsq(np.column_stack([problem.baseline, *known]), problem.target_deg_h, rcond=None)[0]
        errors[who] = float(np.sqrt(np.mean((np.column_stack([held_out.baseline, *new]) @ weights - truth) ** 2)))
    assert errors["law"] < 0.5 * errors["nothing"]
    assert errors["law"] < 2.0 * errors["oracle"] + 0.05 * WHITE_DEG_H


def test_the_law_is_what_the_file_says(tmp_path: Path) -> None:
    discovery, problem, _ = found("lag")
    rlg.Simulator(mechanisms=(discovery.mechanism,)).to_yaml(tmp_path / "law.yaml")
    again = rlg.Simulator.from_yaml(tmp_path / "law.yaml")
    assert again.mechanisms == (discovery.mechanism,)
    predicted = again.predict(problem.runs[0]).column("gyro_deg_h")
    law = discovery.mechanism
    assert predicted == pytest.approx(law.amplitude_deg_h * law.basis(problem.runs[0])[:, 0], abs=1e-15)
    assert discovery.to_mapping()["equation"] == law.stated()
    assert 1200.0 < law.lag_s < 4800.0


def test_a_late_thermometer_is_seen_by_a_narrow_resonance() -> None:
    """The block is at the resonance before its thermometer says so: found late by about as much, and static."""

    def true_place(table: pd.DataFrame) -> np.ndarray:
        read = table["temperature_block_degC"].to_numpy()
        return 1.0 / (1.0 + ((read + 25.0 * np.gradient(read, STEP_S) - 31.0) / 1.2) ** 2)

    problem, size = problem_of(true_place, 3.0)
    discovery = discover(problem, problem.baseline, NOISES)
    assert discovery is not None
    assert (discovery.drivers, discovery.memory) == (("temperature_block_degC",), "static")
    law = discovery.mechanism
    assert law.form == "resonance"
    assert law.lead_s == pytest.approx(25.0, abs=6.0)
    assert law.at == pytest.approx(31.0, abs=0.15)
    assert law.width == pytest.approx(1.2, rel=0.1)
    assert law.amplitude_deg_h == pytest.approx(size, rel=0.1)


def test_the_refined_shapes_are_the_likeliest() -> None:
    """No place beside the law found is likelier by more than a tenth of a nat, with its noise."""
    discovery, problem, _ = found("resonance")
    law = discovery.mechanism
    background = Background(problem, problem.baseline, NOISES)
    steps = itertools.product((-1.0, 0.0, 1.0), (0.97, 1.0, 1.03))
    moved = [dataclasses.replace(law, at=law.at + 0.03 * shift * law.width, width=law.width * ratio) for shift, ratio in steps]
    logs = background.log_bayes_factors(np.column_stack([problem.columns(one)[:, 0] for one in moved]))
    assert logs.max() - logs[4] < 0.1
    assert logs.min() < logs[4] - 0.1


def test_its_amplitude_is_within_its_errors() -> None:
    discovery, _, size = found("threshold")
    law = discovery.mechanism
    per_unit = 0.02 / (0.5 * (law.high - law.low))  # of the law's slope, for one unit of the effect's
    assert per_unit * law.amplitude_deg_h == pytest.approx(size, abs=4.0 * per_unit * discovery.amplitude_sd_deg_h + 0.15 * size)


@pytest.mark.parametrize("seed", range(4))
def test_noise_alone_makes_no_law(seed: int) -> None:
    quiet, _ = problem_of(voltage, 0.0)
    noise = simulate(quiet.rows, NoiseShape(0.32, 0.25), 1, np.random.default_rng(seed))[:, 0]
    problem = dataclasses.replace(quiet, target_deg_h=WHITE_DEG_H * noise)
    assert discover(problem, problem.baseline, NOISES) is None


def test_no_law_rests_on_one_window() -> None:
    """A monitor that leaves its range once, in the very window in which the gyro is wrong, does not say how they go together."""
    recordings = runs(TRAIN, lambda table: np.zeros(len(table)), 0.0)
    once = np.isin(np.arange(len(recordings[0])), np.arange(505, 510))
    table = recordings[0].table
    wrong = table.assign(
        gyro_deg_h=table["gyro_deg_h"] + 100.0 * WHITE_DEG_H * once, supply_voltage_V=table["supply_voltage_V"] + 0.5 * once
    )
    problem = Problem.of(SIMULATOR, [recordings[0].replace(table=wrong), recordings[1]])
    column = problem.driver("supply_voltage_V")
    background = Background(problem, problem.baseline, NOISES)
    assert background.log_bayes_factors(column[:, None])[0] > 100.0
    assert discover(problem, problem.baseline, NOISES) is None


def test_what_wanders_more_than_causes_are_judged_under_makes_no_law() -> None:
    """Of eight times the white noise: without such wanders and steep walks among the noises the rest passes for a law."""
    quiet, _ = problem_of(voltage, 0.0)
    noise = simulate(quiet.rows, NoiseShape(0.0, 0.0, 8.0, 4500.0), 1, np.random.default_rng(0))[:, 0]
    problem = dataclasses.replace(quiet, target_deg_h=WHITE_DEG_H * noise)
    (weaker, prior), stronger = (considered(problem, wanders=wanders)[:2] for wanders in (WANDERS, WANDERS_AGAINST_LAWS))
    gentle = np.array([noise.walk not in STEEP_WALKS for noise in weaker])
    assert discover(problem, problem.baseline, list(itertools.compress(weaker, gentle)), prior[gentle]) is not None
    assert discover(problem, problem.baseline, *stronger) is None


@pytest.mark.slow
def test_false_discoveries_are_rarer_than_one_in_a_hundred() -> None:
    """Every noise in its turn; the mean of the Bayes factor without a law is at most about one."""
    quiet, _ = problem_of(voltage, 0.0)
    dictionary = Dictionary(quiet)
    rng = np.random.default_rng(7)
    _, columns = dictionary.screening
    weights = np.concatenate([family.log_prior + weight for family, _, weight in dictionary.screening[0]])
    logs = []
    for k in range(300):
        noise = WHITE_DEG_H * simulate(quiet.rows, NOISES[k % len(NOISES)], 1, rng)[:, 0]
        background = Background(dataclasses.replace(quiet, target_deg_h=noise), quiet.baseline, NOISES)
        logs.append(float(logsumexp(background.log_bayes_factors(columns) + weights)))
    assert np.mean(np.array(logs) > math.log(100.0)) < 0.01
    assert np.mean(np.exp(logs)) < 2.0


def test_a_law_that_the_design_holds_is_not_found_again() -> None:
    discovery, problem, _ = found("threshold")
    design = np.column_stack([problem.baseline, problem.columns(discovery.mechanism)])
    assert discover(problem, design, NOISES) is None


def test_what_did_not_move_and_what_is_no_driver_are_left_out() -> None:
    train = [run.replace(table=run.table.assign(pressure_hPa=1013.0, gyro_x_deg_h=run.time_s)) for run in runs(TRAIN, voltage, 0.0)]
    assert Dictionary(Problem.of(SIMULATOR, train, gyro="gyro_deg_h")).drivers == DRIVERS


def with_arms(which: tuple[tuple[int, tuple[float, ...]], ...], size: float) -> list[rlg.Recording]:
    """Runs with the currents of two arms, alike but for a little; that little times the field is in the gyro."""
    made = []
    for run in runs(which, voltage, 0.0):
        rng = np.random.default_rng(len(run))
        common, apart = (wander(rng, len(run), 3000.0) for _ in range(2))
        arm = 0.5 + 0.01 * common
        table = run.table.assign(discharge_current_a_mA=arm, discharge_current_b_mA=arm - 0.005 * apart)
        field = (table["magnetic_field_uT"] - 48.0) / 3.0
        made.append(run.replace(table=table.assign(gyro_deg_h=table["gyro_deg_h"] + size * apart * field)))
    return made


def test_a_product_with_the_difference_of_two_arms_is_found(tmp_path: Path) -> None:
    discovery = discover(problem := Problem.of(SIMULATOR, with_arms(TRAIN, 1.5 * WHITE_DEG_H)), problem.baseline, NOISES)
    assert discovery is not None
    assert set(discovery.drivers) == {"discharge_current_a_mA", "discharge_current_b_mA", "magnetic_field_uT"}
    assert "(discharge_current_a_mA - discharge_current_b_mA)" in discovery.equation
    assert discovery.mechanism.driver_names() == discovery.drivers
    rlg.Simulator(mechanisms=(discovery.mechanism,)).to_yaml(tmp_path / "law.yaml")
    assert rlg.Simulator.from_yaml(tmp_path / "law.yaml").mechanisms == (discovery.mechanism,)
    said, true = (Problem.of(SIMULATOR, with_arms(TEST, size)) for size in (0.0, 1.0))
    column = true.target_deg_h - said.target_deg_h
    assert np.corrcoef(said.columns(discovery.mechanism)[:, 0], column)[0, 1] ** 2 > 0.95


def test_one_arm_is_not_taken_for_the_difference() -> None:
    train = with_arms(TRAIN, 0.0)
    arm = [run.table["discharge_current_a_mA"] for run in train]
    train = [
        run.replace(table=run.table.assign(gyro_deg_h=run.table["gyro_deg_h"] + 0.4 * np.maximum(a - 0.503, 0.0)))
        for run, a in zip(train, arm, strict=True)
    ]
    discovery = discover(problem := Problem.of(SIMULATOR, train), problem.baseline, NOISES)
    assert discovery is not None
    assert discovery.drivers == ("discharge_current_a_mA",)


def test_only_columns_that_are_alike_are_taken_off_each_other() -> None:
    columns = ("a_b_V", "a_c_V", "a_c_mA", "a_c_d_V", "field_x_uT", "field_y_uT", "temperature_a_degC", "temperature_b_degC")
    moving = rlg.Recording(
        pd.DataFrame({"time_s": np.arange(9.0), "gyro_deg_h": 0.0} | {c: np.arange(9.0) ** (2 + k) for k, c in enumerate(columns)})
    )
    assert differences(columns, [moving]) == [("a_b_V", "a_c_V"), ("a_c_V", "a_c_d_V")]
    still = moving.replace(table=moving.table.assign(a_b_V=moving.table["a_c_V"] + 1.0))
    assert differences(columns, [still]) == [("a_c_V", "a_c_d_V")]


def test_two_laws_one_after_the_other() -> None:
    """A threshold in each of two monitors; the amplitudes are those of both together."""

    def both(table: pd.DataFrame) -> np.ndarray:
        field = (table["magnetic_field_uT"].to_numpy() - 48.0) / 3.0
        return 1.5 * np.maximum(voltage(table) - 0.3, 0.0) + (field > 0.4)

    problem, _ = problem_of(both, 3.0)
    found_laws = discover_laws(problem, problem.baseline, NOISES, largest=2)
    assert {law.drivers for law in found_laws} == {("supply_voltage_V",), ("magnetic_field_uT",)}
    design = np.column_stack([problem.baseline, *(problem.columns(law.mechanism) for law in found_laws)])
    amplitudes = np.linalg.lstsq(design, problem.target_deg_h, rcond=None)[0][-2:]
    for law, amplitude in zip(found_laws, amplitudes, strict=True):
        assert law.mechanism.amplitude_deg_h == pytest.approx(amplitude, abs=3.0 * law.amplitude_sd_deg_h)


def test_the_prior_adds_up_to_one() -> None:
    problem, _ = problem_of(voltage, 0.0)
    dictionary = Dictionary(problem)
    total = logsumexp([family.log_prior for family in dictionary.families])
    assert total == pytest.approx(0.0, abs=1e-9)
    for family in dictionary.families:
        places, weights = family.grid()
        assert logsumexp(weights) == pytest.approx(0.0, abs=1e-9)
        assert ((places >= 0.0) & (places <= 1.0)).all()


def test_many_columns_at_once_are_those_of_the_law_itself() -> None:
    """The dictionary's fast columns against the mechanism's own, on the windows."""
    problem, _ = problem_of(voltage, 0.0)
    dictionary = Dictionary(problem, ["temperature_block_degC", "supply_voltage_V"])
    rng = np.random.default_rng(5)
    for family in dictionary.families:
        place = rng.uniform(0.1, 0.9, len(family.axes))
        fast = dictionary.columns(family, place[None])[:, 0]
        own = problem.columns(dictionary.law(family, place))[:, 0]
        assert np.corrcoef(fast, own)[0, 1] > 0.995, family
        assert fast == pytest.approx(own, abs=0.25 * float(np.ptp(own))), family


def test_the_bayes_factor_against_dense_matrices() -> None:
    """The marginal likelihood written out with full covariance matrices, the design integrated over a flat prior."""
    problem, _ = problem_of(voltage, 1.0)
    column = problem.driver("supply_voltage_V") - 15.0
    shapes = (NoiseShape(), NoiseShape(0.0, 0.4), NoiseShape(0.0, 0.1, 0.8, 2000.0))
    rows = problem.rows

    def covariance(shape: NoiseShape) -> np.ndarray:
        blocks = []
        for part in rows.runs:
            t = rows.time_s[part]
            since = t - t[0] + rows.window_s
            shared = shape.walk**2 / 3600.0 * np.minimum.outer(since, since)
            shared += shape.wander**2 * np.exp(-np.abs(np.subtract.outer(t, t)) / shape.wander_s)
            blocks.append(np.diag(rows.white[part]) + shared)
        return block_diag(*blocks)

    design = problem.baseline / np.sqrt((problem.baseline**2).mean(axis=0))
    left = column - design @ np.linalg.lstsq(design, column, rcond=None)[0]
    scaled = left / np.sqrt((left**2).mean())

    def log_marginal(v: np.ndarray) -> float:
        inverse = np.linalg.inv(v)
        information = design.T @ inverse @ design
        rest = problem.target_deg_h - design @ np.linalg.solve(information, design.T @ inverse @ problem.target_deg_h)
        freedom = len(design) - design.shape[1]
        determinants = np.linalg.slogdet(v)[1] + np.linalg.slogdet(information)[1]
        return -0.5 * (determinants + freedom * math.log(rest @ inverse @ rest))

    nothing = logsumexp([log_marginal(covariance(shape)) for shape in shapes])
    with_law = logsumexp(
        [log_marginal(covariance(shape) + size**2 * np.outer(scaled, scaled)) for shape in shapes for size in SIZES]
    )
    background = Background(problem, problem.baseline, shapes)
    assert background.log_bayes_factors(column[:, None])[0] == pytest.approx(with_law - math.log(len(SIZES)) - nothing, abs=1e-5)


def test_what_stood_in_for_a_law_is_given_up_once_the_law_is_there() -> None:
    """A resonance beside a sensitivity: the catalogue alone would make it of a polynomial, a hop and whatever bends."""

    def both(table: pd.DataFrame) -> np.ndarray:
        resonance = 1.0 / (1.0 + ((table["temperature_block_degC"].to_numpy() - 26.0) / 2.0) ** 2)
        return 0.012 * resonance + 0.002 * voltage(table)

    found = rlg.diagnose(SIMULATOR, runs(TRAIN, both, 1.0), runs(TEST, both, 1.0), black_box=False)
    assert found.verdict == "unknown"
    assert [cause.name for cause in found.causes] == ["supply_voltage"]
    assert found.unexplained.drivers == ("temperature_block_degC",)
    assert found.test is not None
    assert found.test.augmented_rms < 1.15 * found.test.noise_floor_rms
    assert all("supply_voltage" in other.mechanisms for other in found.alternatives if other.probability > 0.01)


@pytest.mark.parametrize(
    "effect",
    [
        lambda table: 2e-3 * (voltage(table) > 0.3),
        pytest.param(lambda table: 3e-3 * np.tanh(voltage(table)), marks=pytest.mark.slow),
    ],
    ids=["step", "saturation"],
)
def test_a_law_of_what_a_cause_reads_takes_its_place(effect: Effect) -> None:
    """Beside an imbalance of two arms: a step of the supply is no sensitivity to it with a law on top."""
    made = []
    for run in with_arms((*TRAIN, *TEST), 0.0):
        imbalance = run.table["discharge_current_a_mA"] - run.table["discharge_current_b_mA"]
        added = effect(run.table) + 3e-3 * imbalance / imbalance.std()
        made.append(run.replace(table=run.table.assign(gyro_deg_h=run.column("gyro_deg_h") + added)))
    found = rlg.diagnose(SIMULATOR, made[:2], made[2:], black_box=False)
    assert [cause.name for cause in found.causes] == ["discharge_imbalance"]
    assert found.unexplained.drivers == ("supply_voltage_V",)
    assert len(found.unexplained.laws) == 1


def test_a_second_law_that_is_a_mechanism_is_known_as_such() -> None:
    made = []
    for run in with_arms(TRAIN, 0.0):
        imbalance = run.table["discharge_current_a_mA"] - run.table["discharge_current_b_mA"]
        added = 4e-3 * (voltage(run.table) > 0.3) + 3e-3 * imbalance / imbalance.std()
        made.append(run.replace(table=run.table.assign(gyro_deg_h=run.column("gyro_deg_h") + added)))
    problem = Problem.of(SIMULATOR, made)
    laws = discover_laws(problem, problem.baseline, NOISES)
    of_arms = [law for law in laws if len(law.drivers) == 2]
    assert len(laws) == 2
    assert len(of_arms) == 1
    explanations = explain(problem, CATALOGUE)
    assert by_another_name(explanations, [law for law in laws if law not in of_arms] + of_arms) == of_arms


def test_a_temperature_times_its_own_rate_is_told_as_such() -> None:
    discovery, _, _ = found("warming")
    assert discovery is not None
    law = discovery.mechanism
    assert (law.driver, law.driver_2, law.memory) == ("temperature_block_degC", "temperature_block_degC", "rate")
    assert discovery.drivers == ("temperature_block_degC",)


TRUE_LAWS: dict[str, tuple[EmpiricalLaw, tuple[str, ...], tuple[str, ...]]] = {
    "power": (EmpiricalLaw(driver="supply_voltage_V", exponent=2, low=14.95, high=15.05, at=14.99), ("supply_voltage_V",), ("at",)),
    "product": (
        EmpiricalLaw(
            driver="magnetic_field_uT",
            driver_2="supply_voltage_V",
            low=40.0,
            high=56.0,
            at=47.3,
            low_2=14.95,
            high_2=15.05,
            at_2=15.0072,
        ),
        ("magnetic_field_uT", "supply_voltage_V"),
        ("at", "at_2"),
    ),
    "threshold": (
        EmpiricalLaw(driver="magnetic_field_uT", form="above", low=40.0, high=56.0, at=49.0),
        ("magnetic_field_uT",),
        ("at",),
    ),
    "lagged": (
        EmpiricalLaw(driver="magnetic_field_uT", memory="lag", low=40.0, high=56.0, at=48.0, lag_s=1500.0),
        ("magnetic_field_uT",),
        ("lag_s",),
    ),
}


@pytest.mark.parametrize("name", TRUE_LAWS)
def test_each_number_of_a_law_is_within_its_errors(name: str) -> None:
    """Of simulated laws, over noises drawn anew: amplitudes per unit of the drivers, and shapes."""
    true, drivers, shapes = TRUE_LAWS[name]
    quiet, _ = problem_of(voltage, 0.0)
    column = quiet.columns(true)[:, 0]
    size = 3.0 * WHITE_DEG_H / float(np.std(column))
    rng = np.random.default_rng(5)
    off: dict[str, list[float]] = {}
    for _ in range(6):
        noise = WHITE_DEG_H * simulate(quiet.rows, NOISES[1], 1, rng)[:, 0]
        problem = dataclasses.replace(quiet, target_deg_h=size * column + noise)
        found = discover(problem, problem.baseline, NOISES, dictionary=Dictionary(problem, drivers))
        assert found is not None
        law = found.mechanism
        assert (law.form, law.memory, law.exponent) == (true.form, true.memory, true.exponent)
        candidate = Candidate(law, problem.columns(law), 0.0)
        (cause,) = fit(problem, [candidate], NOISES[1]).causes
        assert set(cause.estimates) == {"amplitude_deg_h", *shapes}
        steep = ratio(law) / ratio(true) / size
        amplitude = cause.estimates["amplitude_deg_h"]
        off.setdefault("amplitude_deg_h", []).append((steep * amplitude.value - 1.0) / (steep * amplitude.sd))
        for shape in shapes:
            one = cause.estimates[shape]
            off.setdefault(shape, []).append((one.value - getattr(true, shape)) / one.sd)
    for errors in off.values():
        assert np.abs(errors).max() < 4.0
        assert 0.2 < np.sqrt(np.mean(np.square(errors))) < 1.9


def ratio(law: EmpiricalLaw) -> float:
    """Of the law, for amplitude one, by its drivers' units."""
    scale = (0.5 * (law.high - law.low)) ** -law.exponent
    return scale / (0.5 * (law.high_2 - law.low_2)) if law.driver_2 else scale


@pytest.mark.parametrize(("turned_deg", "offered"), [(300.0, ("table_angle_deg",)), (720.0, ())])
def test_an_angle_that_runs_on_past_a_turn_is_a_clock_and_no_driver(turned_deg: float, offered: tuple[str, ...]) -> None:
    time_s = np.arange(500.0)
    table = pd.DataFrame({"time_s": time_s, "gyro_deg_h": np.sin(time_s), "table_angle_deg": turned_deg * time_s / 499.0})
    assert recorded_drivers([rlg.Recording(table, rlg.Metadata(kind="turntable"))]) == offered
