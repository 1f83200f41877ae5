"""Turntable recordings made by other formulas than the package's own: every cause is named, healthy gyros are acquitted."""

from __future__ import annotations

import math
import re
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy.signal import lfilter
from scipy.special import logsumexp

import rlgcomp as rlg
from rlgcomp.diagnosis.fitting.fit import fit
from rlgcomp.diagnosis.laws.dictionary import Dictionary
from rlgcomp.diagnosis.naming.explain import explain
from rlgcomp.diagnosis.question.even_turning import evened
from rlgcomp.diagnosis.question.problem import Problem
from rlgcomp.physics.empirical_law import EmpiricalLaw
from tests.small_table_runs import BIAS_DEG_H, EFFECTS, NOISE_1S_DEG_H, SIMULATOR, motion, runs


def named(recordings: list[rlg.Recording]) -> set[str]:
    found = explain(Problem.of(SIMULATOR, recordings, window_s=50.0), rlg.CATALOGUE)
    return {name for name, _ in found.models[0].labels}


@pytest.mark.parametrize("effect", [name for name in EFFECTS if not name.startswith("lock_in")])
def test_every_cause_is_named(effect: str) -> None:
    assert named(runs(effect)) == {effect.split(",", maxsplit=1)[0].split(" ", maxsplit=1)[0]}


def test_a_healthy_gyro_is_acquitted() -> None:
    assert named(runs(None)) == set()


def test_the_angle_alone_will_do() -> None:
    assert named(runs("scale_factor_nonlinearity", 1.0, "table_rate_deg_s")) == {"scale_factor_nonlinearity"}


def accelerating(cut: slice | None = None) -> list[rlg.Recording]:
    """A healthy gyro on a table that speeds up as the recording begins, and stops as it ends, with an encoder alone."""
    made = []
    for k, target in enumerate((10.0, 30.0)):
        speeding = np.arange(0.0, target, 2.0)
        rate = np.r_[speeding, np.tile(np.repeat([target, -target], 450), 2), speeding[::-1]]
        noise = NOISE_1S_DEG_H * np.random.default_rng(k).standard_normal(len(rate))
        table = {
            "time_s": np.arange(len(rate), dtype=float),
            "gyro_deg_s": rate * (1.0 + 5e-6) + (BIAS_DEG_H + noise) / 3600.0,
            "table_angle_deg": np.cumsum(rate) % 360.0,
        }
        frame = pd.DataFrame(table)
        if cut is not None:
            frame = frame.drop(index=range(cut.start, cut.stop))
        made.append(rlg.Recording(frame, rlg.Metadata(kind="turntable"), name=f"run{k}"))
    return made


@pytest.mark.parametrize("cut", [None, slice(445, 470)], ids=["whole", "a gap in which the table turns round"])
def test_a_rate_that_an_angle_does_not_tell_is_not_used(cut: slice | None) -> None:
    """Before the first row, or within a gap, the table may have turned at any rate: the gyro is not compared with a guess."""
    recordings = accelerating(cut)
    problem = Problem.of(SIMULATOR, recordings)
    scaled = problem.baseline / np.sqrt((problem.baseline**2).mean(axis=0))
    left = problem.target_deg_h - scaled @ np.linalg.lstsq(scaled, problem.target_deg_h, rcond=None)[0]
    window_s = problem.rows.window_s
    assert np.std(left) < 1.3 * NOISE_1S_DEG_H / np.sqrt(window_s)
    found = rlg.diagnose(SIMULATOR, recordings[:1], recordings[1:])
    assert found.verdict == "none"
    assert found.test is not None
    assert found.test.baseline_std == pytest.approx(NOISE_1S_DEG_H / np.sqrt(found.test.averaging_s), rel=0.3)


@pytest.mark.parametrize("effect", ["lock_in", "lock_in of the total rate"])
def test_lock_in_is_named_and_its_rate_recovered_within_its_error(effect: str) -> None:
    problem = Problem.of(SIMULATOR, runs(effect), window_s=50.0)
    found = explain(problem, rlg.CATALOGUE)
    best = found.models[0]
    chosen = [found.evidence.candidates[member.candidate] for member in best.members]
    result = fit(problem, chosen, found.evidence.noises[int(np.argmax(best.noise_log))])
    (cause,) = result.causes
    (estimate,) = cause.estimates.values()
    assert cause.mechanism.name == "lock_in"
    assert cause.mechanism.fraction == 1.0
    assert abs(estimate.value - 0.02) < 4.0 * estimate.sd
    assert estimate.sd < 1e-4


def locking(*more: dict[str, dict[str, float]]) -> list[rlg.Recording]:
    """Runs of a gyro whose bias is behind lock-in too, of a table that rests in between."""
    said = [{"scale_factor": {"k_ppm": 30.0, "bias_deg_h": 5.5}}, {"lock_in": {"lock_in_deg_s": 0.02, "fraction": 1.0}}, *more]
    noise = {"angle_random_walk_deg_sqrt_h": 0.003}
    gyro = rlg.Simulator.from_mapping({"kind": "turntable", "mechanisms": said, "noise": noise})
    return [gyro.simulate("rates", seed=seed, name=f"run{seed}") for seed in range(3)]


@pytest.mark.parametrize(
    ("said", "asymmetry_ppm"),
    [
        ({"lock_in_deg_s": 0.02}, 0.0),
        ({"lock_in_deg_s": 0.012}, 0.0),
        ({"lock_in_deg_s": {"value": 0.05, "free": True}}, 3.0),
        *(pytest.param({"lock_in_deg_s": rate}, 3.0, marks=pytest.mark.slow) for rate in (0.02, 0.012)),
        pytest.param({"lock_in_deg_s": {"value": 0.05, "free": True}}, 0.0, marks=pytest.mark.slow),
    ],
)
def test_a_simulator_with_lock_in_is_told_what_the_light_feels(said: dict[str, object], asymmetry_ppm: float) -> None:
    """At rest the light feels the bias alone: what locks there is no missing physics, whatever lock-in rate is stated."""
    first, second, held_out = locking(*([{"scale_factor_asymmetry": {"k_ppm": asymmetry_ppm}}] if asymmetry_ppm else []))
    simulator = rlg.Simulator.from_mapping({"kind": "turntable", "mechanisms": ["scale_factor", {"lock_in": said}]})
    found = rlg.diagnose(simulator, [first, second], [held_out], black_box=False)
    assert [cause.name for cause in found.causes] == ["scale_factor_asymmetry"] * bool(asymmetry_ppm)
    assert found.verdict == ("explained" if asymmetry_ppm else "none")
    assert found.wrong == (("lock_in",) if said["lock_in_deg_s"] == 0.012 else ())
    estimates = (found.recalibration if asymmetry_ppm else found.calibration).get("lock_in")
    if estimates is not None and "lock_in_deg_s" in estimates:  # what is stated and right is left as it is
        assert abs(estimates["lock_in_deg_s"].value - 0.02) < 4.0 * estimates["lock_in_deg_s"].sd
        assert estimates["lock_in_deg_s"].sd < 0.001


def test_what_acts_elsewhere_is_named_beside_a_strong_cause() -> None:
    """An encoder's delay acts while the table speeds up; what is even in a steady rate is no error of its equation."""
    pair = [runs(name, strength) for name, strength in (("encoder_delay", 4.0), ("scale_factor_asymmetry", 4.0))]
    gyros = [one.column("gyro_deg_s") + other.column("gyro_deg_s") for one, other in zip(*pair, strict=True)]
    both = [
        run.replace(table=run.table.assign(gyro_deg_s=gyro - run.column("gyro_deg_s")))
        for run, gyro in zip(runs(None), gyros, strict=True)
    ]
    assert named(both) == {"encoder_delay", "scale_factor_asymmetry"}


@pytest.mark.parametrize(("parity", "form"), [("odd", "bump"), ("even", "bump"), ("odd", "step")])
def test_a_law_of_the_rate_is_found_with_its_parity(parity: str, form: str, tmp_path: Path) -> None:
    """A hump at 6 deg/s that turns round with the rate, or does not; a jump at 8 deg/s: not two laws, one at either sign."""
    recordings = []
    for run in runs(None):
        rate = run.column("table_rate_deg_s")
        shape = np.exp(-(((np.abs(rate) - 6.0) / 2.0) ** 2) / 2.0) if form == "bump" else 1.0 * (np.abs(rate) > 8.0)
        added = 0.02 * shape * (np.sign(rate) if parity == "odd" else 1.0)
        recordings.append(run.replace(table=run.table.assign(gyro_deg_s=run.column("gyro_deg_s") + added / 3600.0)))
    found = rlg.diagnose(SIMULATOR, recordings, black_box=False)
    assert found.verdict == "unknown"
    assert not found.causes
    (law,) = (mechanism for mechanism in found.augmented.mechanisms if mechanism.empirical)
    assert isinstance(law, EmpiricalLaw)
    assert (law.parity, law.driver) == (parity, "table_rate_deg_s")
    rates = np.array([1.0, 2.0, 3.0, 5.0, 7.0, 10.0, 15.0])
    expected = 0.02 * (np.exp(-(((rates - 6.0) / 2.0) ** 2) / 2.0) if form == "bump" else 1.0 * (rates > 8.0))
    np.testing.assert_allclose(law.amplitude_deg_h * law.shaped(rates), expected, atol=0.004)
    assert found.train.augmented_rms < 1.1 * found.train.noise_floor_rms
    found.augmented.to_yaml(tmp_path / "augmented.yaml")
    again = rlg.Simulator.from_yaml(tmp_path / "augmented.yaml")
    np.testing.assert_allclose(again.predict(recordings[1]).rate_deg_h(), found.augmented.predict(recordings[1]).rate_deg_h())


def test_laws_of_a_rate_have_their_share_of_the_prior_and_the_columns_of_their_own() -> None:
    problem = Problem.of(SIMULATOR, runs(None), window_s=50.0)
    dictionary = Dictionary(problem, ["table_rate_deg_s", "temperature_block_degC"])
    assert logsumexp([family.log_prior for family in dictionary.families]) == pytest.approx(0.0, abs=1e-9)
    assert {family.parity for family in dictionary.families} == {"none", "even", "odd"}
    rng = np.random.default_rng(5)
    for family in (one for one in dictionary.families if one.parity != "none"):
        place = rng.uniform(0.1, 0.9, len(family.axes))
        fast, own = dictionary.columns(family, place[None])[:, 0], problem.columns(dictionary.law(family, place))[:, 0]
        assert fast == pytest.approx(own, abs=0.25 * float(np.ptp(own))), family
        assert np.corrcoef(fast, own)[0, 1] > 0.995, family


def test_a_simulation_of_the_errors_alone_is_refused() -> None:
    """A simulator of a turning gyro says the whole rate; what it errs by would leave a scale factor of a million ppm."""
    W, theta, T = motion(0)
    table = {"time_s": np.arange(len(W), dtype=float), "table_rate_deg_s": W, "table_angle_deg": theta, "temperature_block_degC": T}
    noise = NOISE_1S_DEG_H * np.random.default_rng(1).standard_normal(len(W))
    table["gyro_deg_h"] = 3600.0 * W + BIAS_DEG_H + noise
    run = rlg.Recording(pd.DataFrame(table), rlg.Metadata("turntable"), name="turn")
    with pytest.raises(rlg.InputError, match="errs alone; let it say all that the gyro reads"):
        rlg.diagnose(lambda recording: np.full(len(recording), BIAS_DEG_H), train=[run], black_box=False)


OF_RATE_AND_TEMPERATURE = {
    "an asymmetry that follows temperature": (
        lambda W, T: np.abs(W) * (T - 24.5),
        ("table_rate_deg_s", "even", "static", 1, 0.0, 24.5),
    ),
    "a scale factor with the square of temperature": (
        lambda W, T: W * (T - 24.0) ** 2,
        ("temperature_block_degC", "none", "static", 2, 24.0, 0.0),
    ),
    "what turning warms": (
        lambda W, T: lfilter([1.0 / 300.0], [1.0, 1.0 / 300.0 - 1.0], np.abs(W)),
        ("table_rate_deg_s", "even", "lag", 1, None, None),
    ),
}


@pytest.mark.parametrize("which", OF_RATE_AND_TEMPERATURE)
def test_laws_of_rate_and_temperature_are_found_and_no_cause_is_named_in_their_place(which: str) -> None:
    law, (driver, parity, memory, exponent, at, at_2) = OF_RATE_AND_TEMPERATURE[which]
    recordings = []
    for k, run in enumerate(runs(None)):
        W, _, T = motion(k)
        added = law(W, T)
        gyro = run.column("gyro_deg_s") + 0.02 * added / np.std(added) / 3600.0
        recordings.append(run.replace(table=run.table.drop(columns="table_angle_deg").assign(gyro_deg_s=gyro)))
    found = rlg.diagnose(SIMULATOR, recordings, black_box=False)
    assert (found.verdict, found.causes) == ("unknown", ())
    laws = [mechanism for mechanism in found.augmented.mechanisms if isinstance(mechanism, EmpiricalLaw)]
    expected = driver, parity, memory, exponent
    (told,) = (one for one in laws if (one.driver, one.parity, one.memory, one.exponent) == expected)
    if memory == "lag":
        assert told.lag_s == pytest.approx(300.0, rel=0.15)
    else:
        assert told.at == pytest.approx(at, abs=1.0)
        assert told.at_2 == pytest.approx(at_2, abs=1.0)


def test_by_an_encoder_alone_a_law_of_the_rate_is_found_and_no_asymmetry_in_its_place(tmp_path: Path) -> None:
    recordings = []
    for k, run in enumerate(runs(None)):
        W, theta, T = motion(k)
        added = np.abs(W) * (T - 24.5)
        gyro = run.column("gyro_deg_s") + 0.02 * added / np.std(added) / 3600.0
        table = run.table.drop(columns="table_rate_deg_s").assign(gyro_deg_s=gyro, table_angle_deg=theta)
        recordings.append(run.replace(table=table))
    assert "table_angle_deg" not in Dictionary(Problem.of(SIMULATOR, recordings)).drivers  # nothing counts its turns
    found = rlg.diagnose(SIMULATOR, recordings, black_box=False)
    assert (found.verdict, found.causes) == ("unknown", ())
    assert found.unexplained.drivers == ("table_angle_deg", "temperature_block_degC")
    assert "it follows the table's rate by table_angle_deg and temperature_block_degC" in found.sentence
    (told,) = (mechanism for mechanism in found.augmented.mechanisms if isinstance(mechanism, EmpiricalLaw))
    assert (told.driver, told.parity, told.driver_2) == ("table_rate", "even", "temperature_block_degC")
    found.augmented.to_yaml(tmp_path / "augmented.yaml")
    again = rlg.Simulator.from_yaml(tmp_path / "augmented.yaml")
    np.testing.assert_allclose(again.predict(recordings[1]).rate_deg_h(), found.augmented.predict(recordings[1]).rate_deg_h())


def test_a_scale_factor_that_follows_a_temperature_late_is_found() -> None:
    recordings = []
    for k, run in enumerate(runs(None)):
        W, _, T = motion(k)
        a = 1.0 / 1200.0
        added = W * (lfilter([a], [1.0, a - 1.0], T, zi=[(1.0 - a) * T[0]])[0] - 22.0)
        gyro = run.column("gyro_deg_s") + 0.04 * added / np.std(added) / 3600.0
        recordings.append(run.replace(table=run.table.drop(columns="table_angle_deg").assign(gyro_deg_s=gyro)))
    found = rlg.diagnose(SIMULATOR, recordings, black_box=False)
    assert (found.verdict, found.causes, found.unexplained.memory) == ("unknown", (), "dynamic")
    assert set(found.unexplained.drivers) == {"table_rate_deg_s", "temperature_block_degC"}
    laws = (mechanism for mechanism in found.augmented.mechanisms if isinstance(mechanism, EmpiricalLaw))
    (told,) = (one for one in laws if one.memory == "lag")
    assert told.lag_s == pytest.approx(1200.0, rel=0.25)


def with_error(run: rlg.Recording, error_deg_h: np.ndarray) -> rlg.Recording:
    return run.replace(table=run.table.assign(gyro_deg_s=run.column("gyro_deg_s") + error_deg_h / 3600.0))


def test_weak_orders_of_the_angle_are_found_together() -> None:
    recordings = []
    for k, run in enumerate(runs(None)):
        theta = np.radians(motion(k)[1])
        recordings.append(with_error(run, 0.002 * np.sin(3.0 * theta + 1.0) + 0.0016 * np.sin(8.0 * theta)))
    found = rlg.diagnose(SIMULATOR, recordings, black_box=False)
    (cause,) = found.causes
    assert cause.name == "rotation_harmonics"
    assert set(cause.mechanism.orders) == {3, 8}


def test_it_is_said_how_much_of_what_means_average_away_held_out_runs_show() -> None:
    first, second = runs("rotation_harmonics", strength=3.0)
    found = rlg.diagnose(SIMULATOR, [first], [second], black_box=False)
    assert [cause.name for cause in found.causes] == ["rotation_harmonics"]
    (told,) = (remark for remark in found.remarks if "average most of it away" in remark)
    shown, sd = (float(number) for number in re.search(r"show ([0-9.]+) ± ([0-9.]+) of", told).groups())
    assert abs(shown - 1.0) < 4.0 * sd < 1.0


def test_a_harmonic_that_a_temperature_makes_larger_is_unknown() -> None:
    """As large as training has it it is in no other run; each shows it."""
    recordings = []
    for k, warmer in ((0, 0.0), (1, 0.0), (0, -5.0)):
        run, (_, theta, T) = runs(None)[k], motion(k)
        T = T + warmer
        error = 0.002 * np.sin(3.0 * np.radians(theta)) * (T - 22.5)
        table = with_error(run, error).table.assign(temperature_block_degC=T)
        recordings.append(run.replace(table=table, name=f"run{len(recordings)}"))
    found = rlg.diagnose(SIMULATOR, recordings[:2], recordings[2:], black_box=False)
    assert (found.verdict, found.causes) == ("unknown", ())
    assert any("sizes of their own" in remark for remark in found.remarks)


def test_causes_that_explain_windows_within_and_spoil_their_means_are_given_up() -> None:
    """An error that goes with the square of the rate and the sine of the angle."""
    recordings = []
    for k, run in enumerate(runs(None)):
        W, theta, _ = motion(k)
        gyro = run.column("gyro_deg_s") + 2e-7 * W**2 * np.sin(np.radians(theta - 0.5 * W))
        table = run.table.drop(columns="table_rate_deg_s").assign(gyro_deg_s=gyro, table_angle_deg=theta)
        recordings.append(run.replace(table=table))
    found = rlg.diagnose(SIMULATOR, recordings, black_box=False)
    assert (found.verdict, found.causes) == ("unknown", ())
    assert found.unexplained.drivers == ("table_angle_deg",)
    assert found.train.augmented_rms <= 1.05 * found.train.baseline_rms


@pytest.mark.parametrize("seed", [1, pytest.param(5, marks=pytest.mark.slow)])
def test_a_scale_factor_that_wanders_with_what_is_not_recorded_has_no_false_name(seed: int) -> None:
    rng = np.random.default_rng(seed)
    recordings = []
    for run in runs(None):
        rate, time_s = run.column("table_rate_deg_s"), run.time_s
        room = np.interp(time_s, np.linspace(0.0, time_s[-1], 8), rng.normal(0.0, 1.0, 8))
        gyro = run.column("gyro_deg_s") + rate * 0.5e-6 * room
        recordings.append(run.replace(table=run.table.drop(columns="temperature_block_degC").assign(gyro_deg_s=gyro)))
    found = rlg.diagnose(SIMULATOR, recordings, black_box=False)
    assert (found.verdict, found.causes) == ("unknown", ())
    (told,) = (remark for remark in found.remarks if "scale factor wanders with something" in remark)
    size_ppm = float(re.search(r"standard deviation ([0-9.e-]+) ppm", told)[1])
    assert 0.05 < size_ppm < 1.0


def stairs(seed: int, targets: tuple[int, ...], encoder_deg: float, wobble_deg: float, keep: float) -> rlg.Recording:
    """Stairs of rates with an asymmetry, read with an encoder alone: its rounding is noise of means that their insides lack."""
    rng = np.random.default_rng(seed)
    rate, pieces = 0.0, []
    for target in targets:
        pieces += [np.linspace(rate, target, int(abs(target - rate) / 2.0), endpoint=False), np.full(550, float(target))]
        rate = target
    smooth = np.concatenate(pieces)
    theta = 0.2 * np.cumsum(smooth) + wobble_deg * lfilter(
        [math.sqrt(1.0 - keep**2)], [1.0, -keep], rng.standard_normal(len(smooth))
    )
    W = np.diff(theta, prepend=theta[0]) / 0.2
    gyro = W * (1.0 + 25e-6) + (BIAS_DEG_H + 8e-4 * np.abs(W) + 0.095 * rng.standard_normal(len(W))) / 3600.0
    table = {
        "time_s": 0.2 * np.arange(len(W)),
        "gyro_deg_s": gyro,
        "table_angle_deg": np.round(theta / encoder_deg) * encoder_deg % 360.0,
    }
    return rlg.Recording(pd.DataFrame(table), rlg.Metadata(kind="turntable"), name=f"stairs-{seed}")


@pytest.mark.parametrize(("encoder_deg", "error"), [(5e-5, 0.1), (1e-4, 0.35), (2e-4, 1.0)])
def test_the_gyros_white_noise_is_told_without_what_an_encoder_rounds(encoder_deg: float, error: float) -> None:
    """0.095 deg/h a sample, the less well the more of what is seen is rounding."""
    recordings = evened([stairs(k, (10, -10, 30, -30, 60, -60, 100, -100), encoder_deg, 3e-4, 0.9) for k in (0, 1)])
    assert [run.metadata.angle_step_deg for run in recordings] == pytest.approx([encoder_deg, encoder_deg])
    part = Problem.of(SIMULATOR, recordings, window_s=20.0).windows[0]
    found = math.sqrt(part.white_deg_h2 * part.window_s / part.full.period_s)
    assert found == pytest.approx(0.095, rel=error)
    assert part.rounded * part.white_deg_h2 == pytest.approx((3600.0 * encoder_deg / part.window_s) ** 2 / 3.0)


def test_what_an_encoder_rounds_is_not_held_against_a_cause_alone() -> None:
    """An asymmetry that no law is preferred to, which is judged where that rounding is all there is."""
    targets = ((10, -10, 30, -30, 60, -60, 100, -100) * 2, (25, -45, 75, -15, -80, 50, 90, 5) * 2, (-20, 45, -80, 90, 5, -60) * 2)
    first, second, held_out = (stairs(k, rates, 1e-4, 5e-5, 0.98) for k, rates in enumerate(targets))
    diagnosis = rlg.diagnose(SIMULATOR, [first, second], [held_out], black_box=False)
    assert (diagnosis.verdict, [cause.name for cause in diagnosis.causes]) == ("explained", ["scale_factor_asymmetry"])
