"""The diagnosis as data and as text."""

from __future__ import annotations

import dataclasses
import json
import math
from pathlib import Path

import pytest

import rlgcomp as rlg
from rlgcomp.diagnosis.result import (
    Alignment,
    Alternative,
    Cause,
    Diagnosis,
    Estimate,
    Fit,
    Law,
    Nearest,
    NextExperiment,
    Place,
    RunFit,
    Unexplained,
)
from rlgcomp.diagnosis.result.page import render
from rlgcomp.diagnosis.result.wording import memory_text, next_notes, place_text


def fit(baseline: float, augmented: float, low: float, high: float) -> Fit:
    gain = 1.0 - augmented / baseline
    run = RunFit("warm", baseline, augmented, 0.0018, baseline, augmented, gain, (low, high), 0.0031)
    return Fit(baseline, augmented, 0.0018, "deg/h", 100.0, gain, (low, high), (run,), compensation_rms=0.0031)


@pytest.fixture
def diagnosis() -> Diagnosis:
    lag = rlg.CATALOGUE["thermal_lag"](k_deg_h_K=0.003, time_constant_s=1500.0)
    calibrated = rlg.Simulator((rlg.CATALOGUE["thermal_polynomial"](),))
    return Diagnosis(
        verdict="ambiguous",
        p_value=1e-30,
        where=(Place("cold", "gyro_deg_h", 3600.0, 7200.0, "temperature_block_degC > 31, cooling", share=0.7, p_value=1e-9),),
        causes=(
            Cause(
                lag,
                0.81,
                {"k_deg_h_K": Estimate(0.003, 0.0001, "deg/h/K"), "time_constant_s": Estimate(1500.0, 60.0, "s")},
                0.004,
                ("thermal_gradient",),
                ("temperature_block_degC",),
                rival_probabilities=(0.185,),
            ),
        ),
        alternatives=(Alternative(("thermal_gradient",), 0.18), Alternative((), 0.0)),
        unexplained=Unexplained(0.4),
        train=fit(0.0043, 0.0019, 0.5, 0.6),
        test=fit(0.0045, 0.002, 0.48, 0.62),
        next_experiment=NextExperiment(("thermal_lag", "thermal_gradient"), "start 20, hold 60, ramp 50 0.5", 0.99, (0.985, 0.995)),
        calibrated=calibrated,
        augmented=calibrated.with_mechanism(lag),
        noise=rlg.NoiseModel(angle_random_walk_deg_sqrt_h=0.0003),
        calibration={"thermal_polynomial": {"c1_deg_h_K": Estimate(0.001, 0.0001, "deg/h/K")}},
        alignment=(Alignment("cold", 0.4, 0.1, 12.0, 5.0, 0.001, "temperature_block_degC"),),
        remarks=("Two runs only.",),
    )


def test_its_mapping_is_the_contract(diagnosis: Diagnosis) -> None:
    content = diagnosis.to_mapping()
    assert content["schema"] == "rlgcomp.diagnosis/1"
    assert content["verdict"] == "ambiguous"
    assert set(content["mismatch"]) >= {"p_value", "where"}
    place = {"run", "channel", "start_s", "end_s", "regime", "frequency_hz", "angle_harmonic", "share", "p_value"}
    assert set(content["mismatch"]["where"][0]) >= place
    finding = content["findings"][0]
    assert finding["mechanism"] == "thermal_lag"
    assert finding["parameters"]["time_constant_s"] == {"value": 1500.0, "sd": 60.0, "unit": "s"}
    assert finding["equation"] == rlg.CATALOGUE["thermal_lag"].equation
    assert finding["drivers"] == ["temperature_block_degC"]
    assert finding["rms"] == {"value": 0.004, "unit": "deg/h"}
    assert finding["indistinguishable_from"] == ["thermal_gradient"]
    assert content["alternatives"] == [
        {"mechanisms": ["thermal_gradient"], "probability": 0.18},
        {"mechanisms": [], "probability": 0.0},
    ]
    left = {"p_value": 0.4, "drivers": [], "memory": "none", "equation": None, "probability": None, "laws": []}
    left |= {"memory_probabilities": {}, "nearest": None}
    assert content["unexplained"] == left
    train = {"baseline_rms", "augmented_rms", "noise_floor_rms", "unit", "averaging_s"}
    assert set(content["fit"]["train"]) >= train
    assert set(content["fit"]["test"]) >= train | {"improvement", "improvement_ci95", "per_run"}
    assert content["fit"]["test"]["improvement_ci95"] == [0.48, 0.62]
    assert content["next_experiment"] == {
        "separates": ["thermal_lag", "thermal_gradient"],
        "profile": "start 20, hold 60, ramp 50 0.5",
        "expected_probability_after": 0.99,
        "if_true": [0.985, 0.995],
        "duration_s": None,
        "shows_s": None,
        "probability_of_these": 1.0,
    }


def test_it_is_json_even_where_a_number_is_not_finite(diagnosis: Diagnosis) -> None:
    broken = dataclasses.replace(diagnosis, p_value=math.nan, train=dataclasses.replace(diagnosis.train, baseline_rms=math.inf))
    content = json.loads(json.dumps(broken.to_mapping(), allow_nan=False))
    assert content["mismatch"]["p_value"] is None
    assert content["fit"]["train"]["baseline_rms"] is None


def test_files_read_back(diagnosis: Diagnosis, tmp_path: Path) -> None:
    diagnosis.save(tmp_path)
    written = json.loads((tmp_path / "diagnosis.json").read_text())
    assert written.pop("provenance")["version"] == rlg.__version__
    assert written == diagnosis.to_mapping()
    assert rlg.Simulator.from_yaml(tmp_path / "augmented.yaml").mechanisms == diagnosis.augmented.mechanisms


def test_its_text_begins_with_the_verdict(diagnosis: Diagnosis) -> None:
    lines = str(diagnosis).splitlines()
    assert " ".join(lines[:2]) == diagnosis.sentence
    assert lines[0] == "The simulator lacks thermal_lag (0.81) or thermal_gradient (0.18): these runs cannot tell which."
    gain = "On runs held out its error falls by 56 % (95 % interval 48 to 62 %), from 0.00450 to 0.00200 deg/h; the noise floor is"
    assert lines[1].startswith(gain)
    for needed in (
        "1500 ± 60 s",
        "0.00450",
        "0.00200",
        "ramp 50 0.5",
        "0.990",
        "Two runs only.",
        "12.0 ± 5.0 ppm",
        "1.00 to 2.00 h",
    ):
        assert needed in str(diagnosis)
    assert max(map(len, lines[1:])) <= 140


def test_only_what_cannot_be_told_apart_is_said_to_be_so(diagnosis: Diagnosis) -> None:
    sure = dataclasses.replace(diagnosis.causes[0], indistinguishable_from=())
    field = dataclasses.replace(sure, mechanism=rlg.CATALOGUE["magnetic_field"]())
    both = dataclasses.replace(diagnosis, causes=(field, *diagnosis.causes))
    said = "lacks magnetic_field (probability 0.810), and either thermal_lag (0.81) or thermal_gradient (0.18): these runs cannot"
    assert said in both.sentence
    assert both.sentence.count("magnetic_field") == both.sentence.count("thermal_lag") == 1


def test_a_set_that_has_no_more_than_half_is_the_likeliest_and_no_more(diagnosis: Diagnosis) -> None:
    sure = dataclasses.replace(diagnosis.causes[0], indistinguishable_from=())
    alone = dataclasses.replace(diagnosis, verdict="explained", causes=(sure,), probability=0.37)
    start = "Most likely the simulator lacks thermal_lag (probability 0.810), and that alone with probability 0.37."
    assert alone.sentence.startswith(start)
    field = dataclasses.replace(sure, mechanism=rlg.CATALOGUE["magnetic_field"]())
    both = dataclasses.replace(alone, causes=(sure, field))
    said = "magnetic_field (probability 0.810), together with probability 0.37."
    assert said in both.sentence
    assert both.to_mapping()["probability"] == 0.37
    assert "ost likely" not in dataclasses.replace(both, probability=0.6).sentence


def test_an_experiment_that_would_hardly_tell_is_said_to(diagnosis: Diagnosis) -> None:
    assert "to tell between thermal_lag and thermal_gradient" in str(diagnosis)
    following = NextExperiment(("thermal_lag", "thermal_gradient"), "start 20, hold 60", 0.6)
    dull = dataclasses.replace(diagnosis, next_experiment=following)
    assert "would separate thermal_lag and thermal_gradient well (expected probability 0.60);" in str(dull)
    assert "The best found: start 20, hold 60" in str(dull)
    assert "to tell between" not in str(dull)


def test_an_experiment_says_how_long_it_is_and_where_to_look(diagnosis: Diagnosis) -> None:
    rivals = ("thermal_lag", "thermal_gradient")
    following = NextExperiment(rivals, "start 20, hold 60", 0.9, (), 34_200.0, (7_200.0, 10_800.0), 0.62)
    said = str(dataclasses.replace(diagnosis, next_experiment=following))
    assert "9.5 h; °C, ramps in °C/min, holds in minutes; then diagnose again, with this run in --train as well" in said
    assert "half of what tells thermal_lag and thermal_gradient apart would show from 2.0 to 3.0 h after its start" in said
    assert "afterwards: 0.900, if it is one of these, which has probability 0.62" in said
    on_table = next_notes(dataclasses.replace(following, probability_of_these=1.0), "turntable")
    assert "rates in deg/s" in on_table[0]
    assert "one of these" not in on_table[-1]


def test_every_verdict_has_its_sentence(diagnosis: Diagnosis) -> None:
    none = dataclasses.replace(diagnosis, verdict="none", causes=(), p_value=0.3)
    assert none.sentence.startswith("The simulator lacks nothing")
    unknown = dataclasses.replace(
        diagnosis, verdict="unknown", causes=(), unexplained=Unexplained(1e-9, ("light_intensity_V",), "static", "b = ...")
    )
    assert "follows light_intensity_V (static)" in unknown.sentence
    lost = dataclasses.replace(unknown, alternatives=(), unexplained=Unexplained(1e-9))
    assert "follows no channel that was recorded" in lost.sentence
    doubtful = dataclasses.replace(none, p_value=0.01)
    assert "hardly noise alone (p = 0.01)" in doubtful.sentence
    worse = dataclasses.replace(diagnosis, verdict="explained", test=fit(0.0045, 0.0060, -0.5, -0.2))
    assert "no gain can be claimed, the error grows" in worse.sentence
    unproven = dataclasses.replace(diagnosis, verdict="explained", test=fit(0.0045, 0.0044, -0.02, 0.06))
    assert "no gain can be claimed" in unproven.sentence
    assert "(probability 0.810; in its place perhaps " in unproven.sentence
    doubted = dataclasses.replace(diagnosis, alternatives=(Alternative((), 0.2),))
    assert ", unless nothing is missing (probability 0.20):" in doubted.sentence
    assert "nothing is missing" not in dataclasses.replace(doubted, healthy=0.0).sentence  # something may wander
    assert dataclasses.replace(doubted, verdict="explained", probability=0.7).sentence.startswith("Probably the simulator lacks")
    lawful = dataclasses.replace(unknown, alternatives=(Alternative((), 0.3),))
    assert lawful.sentence.startswith("The simulator lacks something that no known mechanism explains; it follows light")
    assert "(static), unless nothing is missing (probability 0.30)." in lawful.sentence
    flips = dataclasses.replace(diagnosis.causes[0], mechanism=rlg.CATALOGUE["random_telegraph"](), indistinguishable_from=())
    fleeting = dataclasses.replace(diagnosis, verdict="explained", causes=(flips,), test=fit(0.0078, 0.0057, 0.1, 0.4))
    assert "No run foretells it in another: what changes held out is that the simulator's own numbers" in fleeting.sentence
    assert "error falls" not in fleeting.sentence
    with pytest.raises(rlg.InputError, match="verdict is 'maybe'"):
        dataclasses.replace(diagnosis, verdict="maybe")


def test_a_held_out_run_that_is_far_off_is_in_the_verdict(diagnosis: Diagnosis) -> None:
    off = dataclasses.replace(diagnosis, test=fit(0.0280, 0.0270, 0.01, 0.06))
    told = "warm is off by 15 times its noise: train on it too."
    none = dataclasses.replace(off, verdict="none", causes=(), p_value=0.5)
    assert none.heading() == f"The simulator lacks nothing that the training runs show (p = 0.5), but {told}"
    assert f"these runs cannot tell which; even so {told}" in off.sentence
    flips = dataclasses.replace(diagnosis.causes[0], mechanism=rlg.CATALOGUE["random_telegraph"](), indistinguishable_from=())
    for silent in (diagnosis, dataclasses.replace(off, verdict="unknown"), dataclasses.replace(off, causes=(flips,))):
        assert "train on" not in silent.sentence


def test_offsets_are_said_where_they_count(diagnosis: Diagnosis) -> None:
    assert "switch-on" not in str(diagnosis)
    offset = dataclasses.replace(
        diagnosis.test, baseline_std=0.004, augmented_std=0.001, improvement_std=0.75, improvement_std_ci95=(0.7, 0.8)
    )
    assert "0.00400 before, 0.00100 after, 75.0 % (70.0 to 80.0 %)" in str(dataclasses.replace(diagnosis, test=offset))


def test_only_what_was_used_is_cited(diagnosis: Diagnosis) -> None:
    cited = diagnosis.citations
    assert rlg.CATALOGUE["thermal_lag"].reference in cited
    assert rlg.CATALOGUE["mode_hop"].reference not in cited
    assert len(set(cited)) == len(cited)
    untested = dataclasses.replace(diagnosis, test=None)
    assert not any("bootstrap" in citation for citation in untested.citations)


def test_its_frame_has_a_row_a_parameter(diagnosis: Diagnosis) -> None:
    frame = diagnosis.to_frame()
    assert list(frame["parameter"]) == ["k_deg_h_K", "time_constant_s"]
    assert dataclasses.replace(diagnosis, verdict="none", causes=()).to_frame().empty


def test_a_gain_that_is_mostly_offset_is_said_to_be_so(diagnosis: Diagnosis) -> None:
    assert diagnosis.test is not None
    assert "own mean" not in diagnosis.sentence
    offset = dataclasses.replace(diagnosis, test=dataclasses.replace(diagnosis.test, improvement_std=0.026, baseline_std=0.0033))
    assert "; 3 % about each run's own mean)" in offset.sentence


def test_what_makes_held_out_runs_worse_is_not_to_be_used(diagnosis: Diagnosis) -> None:
    worse = dataclasses.replace(diagnosis, test=fit(0.0045, 0.009, -1.2, -0.5))
    assert worse.sentence.endswith("do not use the augmented simulator as it is.")


def test_no_probability_is_nothing(diagnosis: Diagnosis) -> None:
    assert "nothing missing   < 10⁻⁶" in str(diagnosis)


def test_an_unknown_driver_is_not_among_the_recorded_ones(diagnosis: Diagnosis) -> None:
    lost = dataclasses.replace(diagnosis, verdict="unknown", causes=(), unexplained=Unexplained(0.01))
    assert "drivers none of the recorded columns" in str(lost)


def test_a_wander_has_one_probability_wherever_it_is_said(diagnosis: Diagnosis) -> None:
    left = Unexplained(0.19, probability=0.67)
    wander = dataclasses.replace(diagnosis, verdict="unknown", causes=(), alternatives=(), unexplained=left)
    assert "that no known mechanism explains (probability 0.67); it follows no channel that was recorded." in wander.sentence
    assert "noise after all" not in wander.sentence
    assert "Unexplained (probability 0.67, p-value of noise 0.19)" in str(wander)
    near = "no law was found that it follows for sure; nearest is "
    likely = dataclasses.replace(wander, alternatives=(Alternative(("ambient_pressure",), 0.4),))
    assert f"{near}ambient_pressure (probability 0.40)." in likely.sentence
    law = Nearest("b = 0.01 deg/h * pressure_hPa", ("pressure_hPa",), "static", 0.3)
    lawful = dataclasses.replace(wander, unexplained=dataclasses.replace(left, nearest=law))
    assert f"{near}b = 0.01 deg/h * pressure_hPa, which follows pressure_hPa (probability 0.30)." in lawful.sentence
    unsure = dataclasses.replace(wander, unexplained=Unexplained(0.19))
    assert "unless it is noise after all (p = 0.19)" in unsure.sentence


def test_that_nothing_is_missing_comes_first_where_that_is_the_verdict(diagnosis: Diagnosis) -> None:
    none = dataclasses.replace(diagnosis, verdict="none", causes=(), p_value=0.3, healthy=0.79)
    shown = str(none)[str(none).index("Alternatives") :].splitlines()
    assert shown[2].split() == ["nothing", "missing", "0.790"]
    assert "0.790" not in str(dataclasses.replace(none, verdict="explained"))


def test_the_named_set_comes_first_among_sets(diagnosis: Diagnosis) -> None:
    named = dataclasses.replace(diagnosis, verdict="explained", probability=0.456)
    shown = str(named)[str(named).index("Alternatives") :].splitlines()
    assert shown[2].split() == [*" + ".join(sorted(cause.name for cause in named.causes)).split(), "(as", "above)", "0.456"]
    assert "(as above)" not in str(dataclasses.replace(named, verdict="unknown"))


def test_what_no_run_shows_has_no_column(diagnosis: Diagnosis) -> None:
    untested = dataclasses.replace(
        diagnosis, test=None, train=dataclasses.replace(diagnosis.train, compensation_rms=None, per_run=())
    )
    assert "LS-SVM" in str(diagnosis)
    assert "LS-SVM" not in str(untested)


def test_stays_in_a_regime_are_added_up(diagnosis: Diagnosis) -> None:
    stays = tuple(dataclasses.replace(diagnosis.where[0], start_s=a, end_s=a + 1800.0, share=0.3) for a in (0.0, 7200.0))
    said = str(dataclasses.replace(diagnosis, where=stays))
    assert "2 intervals, 1.00 h in all, temperature_block_degC > 31, cooling  60 %" in said


def test_a_harmonic_is_told_with_its_order(diagnosis: Diagnosis) -> None:
    sixth = rlg.CATALOGUE["rotation_harmonics"](order_1=6)
    amplitude, drivers = Estimate(0.005, 0.001, "deg/h"), ("table_rate_deg_s", "table_angle_deg")
    cause = Cause(sixth, 0.9, {"cosine_1_deg_h": amplitude}, 0.003, drivers=drivers)
    assert cause.numbers() == {"cosine_1_deg_h": "0.0050 ± 0.0010 deg/h", "order_1": "6"}
    assert cause.symbols == {"theta": "table_angle_deg"}
    mapping = cause.to_mapping()
    assert mapping["equation"] == "b = cosine_1_deg_h * cos(6 theta) + sine_1_deg_h * sin(6 theta)"
    growing = dataclasses.replace(cause, mechanism=rlg.CATALOGUE["rotation_harmonics"](order_1=6, order_3=9, scaling="rate"))
    assert "sin(9 theta)) * W / reference_deg_s" in growing.mechanism.stated()
    assert growing.symbols == {"theta": "table_angle_deg", "W": "table_rate_deg_s"}
    assert {"order_3": "9", "scaling": "rate", "reference_deg_s": "30 deg/s"}.items() <= growing.numbers().items()
    assert "order_1 = 6" in str(dataclasses.replace(diagnosis, causes=(cause,), verdict="explained"))


@pytest.mark.parametrize(
    ("name", "told", "by"),
    [
        ("light_intensity", {"reference_V": "1 V"}, "light_intensity_V"),
        ("periodic_interference", {"phase": "start"}, "time since the run's start"),
        ("thermal_polynomial", {"degree": "3", "reference_degC": "20 degC"}, "temperature"),
        ("thermal_hysteresis", {}, "temperature"),
        ("warm_up", {}, "time since the run's start"),
        ("random_telegraph", {}, "nothing recorded"),
    ],
)
def test_settings_that_make_the_law_are_told(name: str, told: dict[str, str], by: str) -> None:
    cause = Cause(rlg.CATALOGUE[name](), 0.9, {}, 0.003)
    assert cause.numbers() == told
    assert cause.driven_by == by


@pytest.mark.parametrize(("since", "by"), [("start", "time since the run's start"), ("clock", "time by the clock")])
def test_ageing_is_driven_by_the_time_that_it_counts(since: str, by: str) -> None:
    assert Cause(rlg.CATALOGUE["ageing"](since=since), 0.9, {}, 0.003).driven_by == by


@pytest.mark.parametrize(
    ("value", "sd", "said"),
    [
        (1.2e-7, 0.9e-7, "(1.20 ± 0.90)·10⁻⁷"),
        (-8.5e-7, 1.2e-7, "(-8.5 ± 1.2)·10⁻⁷"),
        (2e-9, 1.5e-6, "(0.0 ± 1.5)·10⁻⁶"),
        (0.0012, 0.00012, "0.00120 ± 0.00012"),
        (1834.2, 41.0, "1834 ± 41"),
    ],
)
def test_value_and_deviation_have_one_power(value: float, sd: float, said: str) -> None:
    assert str(Estimate(value, sd)) == said


def test_no_probability_is_certainty(diagnosis: Diagnosis) -> None:
    sure = dataclasses.replace(diagnosis.causes[0], probability=1.0 - 1e-12, indistinguishable_from=())
    certain = dataclasses.replace(diagnosis, verdict="explained", causes=(sure,))
    assert "thermal_lag (probability > 0.999)" in certain.sentence
    assert "1.000" not in str(certain)


def test_a_place_is_told_by_the_clock_where_time_counts_from_1970() -> None:
    begun_s = 1_700_000_000.0
    assert "0.50 to 2.00 h" in place_text(Place("cold", "gyro_deg_h", 1800.0, 7200.0))
    assert "2023-11-14 22:13 to 22:43 UTC" in place_text(Place("cold", "gyro_deg_h", begun_s, begun_s + 1800.0))
    assert "2023-11-14 22:13 to 01:00 on 2023-11-15 UTC" in place_text(Place("cold", "gyro_deg_h", begun_s, begun_s + 10_000.0))


def test_the_numbers_of_a_law_have_their_deviations(diagnosis: Diagnosis) -> None:
    law = Law("b = 2 deg/h * light", ("light_intensity_V",), "dynamic", {"lag_s": Estimate(1500.0, 60.0, "s")})
    left = Unexplained(1e-9, law.drivers, law.memory, law.equation, 0.99, (law,))
    unknown = dataclasses.replace(diagnosis, verdict="unknown", causes=(), unexplained=left)
    assert "lag_s = 1500 ± 60 s" in repr(unknown)
    assert unknown.to_mapping()["unexplained"]["laws"][0]["parameters"] == {"lag_s": {"value": 1500.0, "sd": 60.0, "unit": "s"}}
    assert "1500 ± 60 s" in render(unknown)
    for said in (repr(unknown), render(unknown)):
        assert "light_intensity_V (dynamic: late, or by how fast they change)" in said


def test_a_memory_that_is_not_sure_is_said_with_what_else_it_may_be() -> None:
    shares = {"static": 0.62, "dynamic": 0.05, "rate-independent": 0.33}
    left = Unexplained(1e-9, ("pressure_hPa",), "static", "b = ...", 0.99, memory_probabilities=shares)
    assert memory_text(left) == " (static: by what they are at the moment; perhaps rate-independent 0.33)"
    sure = dataclasses.replace(left, memory_probabilities={"static": 0.95, "rate-independent": 0.05})
    assert memory_text(sure) == " (static: by what they are at the moment)"


def test_causes_that_held_out_runs_deny_are_not_claimed(diagnosis: Diagnosis) -> None:
    about = {"improvement_std_ci95": (-1.2, -0.3)}
    worse = dataclasses.replace(fit(0.0045, 0.009, -1.3, -0.4), **about)
    denied = dataclasses.replace(diagnosis, verdict="unknown", test=worse)
    assert denied.contradicted
    assert "with that it is further off the runs held out: it is not that, or not that alone" in denied.sentence
    for said in (repr(denied), render(denied)):
        assert "no channel that was recorded" not in said
    offset = dataclasses.replace(worse, improvement_std_ci95=(0.1, 0.2))  # a bias of each run's own is no reason
    slight = dataclasses.replace(fit(0.0045, 0.0046, -0.03, -0.01), improvement_std_ci95=(-0.03, -0.01))
    assert not any(dataclasses.replace(denied, test=one).contradicted for one in (offset, slight, fit(0.0045, 0.009, -1.3, 0.1)))
    jumps = dataclasses.replace(diagnosis.causes[0], mechanism=rlg.CATALOGUE["random_telegraph"]())
    assert not dataclasses.replace(denied, causes=(jumps,)).contradicted
