"""Selection of inputs: one-way runs give no weight to what they cannot tell apart; further monitors are used where they gain."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import rlgcomp as rlg
from rlgcomp.compensation.feature_pipeline import further_monitors, nearly_standard, pipeline_for, require_no_gyro
from rlgcomp.compensation.models import MODELS
from rlgcomp.compensation.window_means import window_means

STEP_S = 10.0
LAW = (1000.0, 300.0, -80.0, 60.0)


def run(temperature: np.ndarray, seed: int, *, noise_deg_h: float = 2.3, **columns: np.ndarray) -> rlg.Recording:
    """A gyro whose bias is a cubic in temperature, its means over 100 s of this noise."""
    rng = np.random.default_rng(seed)
    u = (temperature - 20.0) / 40.0
    bias = sum(coefficient * u**power for power, coefficient in enumerate(LAW))
    table = {
        "time_s": np.arange(len(u)) * STEP_S,
        "gyro_deg_h": bias + noise_deg_h * np.sqrt(100.0 / STEP_S) * rng.standard_normal(len(u)),
        "temperature_block_degC": temperature + 0.01 * rng.standard_normal(len(u)),
    }
    return rlg.Recording(pd.DataFrame(table | columns), name=f"run {seed}")


def warm_up(start: float, rise: float, hours: float = 2.5) -> np.ndarray:
    return start + rise * (1.0 - np.exp(-np.arange(0.0, hours * 3600.0, STEP_S) / 2400.0))


def cycle(low: float, high: float, hours: float, *, phase: float = 0.0) -> np.ndarray:
    place = (np.arange(0.0, hours * 3600.0, STEP_S) / 5400.0 + phase) % 1.0
    return low + (high - low) * (1.0 - np.abs(2.0 * place - 1.0))


def residual_rms(model: rlg.Compensator, recording: rlg.Recording) -> float:
    windows = window_means(recording, model.pipeline_, model.averaging_s)
    return float(np.sqrt(np.mean((windows.y_deg_h - model.predict_rows(windows.X)) ** 2)))


@pytest.mark.parametrize("second", [(20.0, 30.0), (23.0, 28.0)], ids=["alike", "from another temperature"])
def test_two_warm_ups_leave_no_more_than_the_cubic_in_temperature(second: tuple[float, float]) -> None:
    """On a run that cools, and on one that goes up and down, where the inputs that warm-ups cannot tell apart go apart."""
    training = [run(warm_up(20.0, 30.0), 1), run(warm_up(*second), 2)]
    model, cubic = rlg.Compensator().fit(training), rlg.Compensator(MODELS["cubic"].make(), features="temperature").fit(training)
    assert model.pipeline_.names == ("temperature_block_degC",)
    for temperature in (warm_up(52.0, -30.0), cycle(20.0, 50.0, 4.0)):
        held_out = run(temperature, 3)
        assert residual_rms(model, held_out) < 1.5 * residual_rms(cubic, held_out)


def test_each_input_left_out_has_a_remark_with_the_run_that_would_tell() -> None:
    model = rlg.Compensator().fit([run(warm_up(20.0, 30.0), 1), run(warm_up(20.0, 30.0), 2)])
    remarks = [remark for remark in model.remarks_ if remark.code == "compensation.not_told_apart"]
    assert [remark.data["group"] for remark in remarks] == ["temperature_rate", "lag", "memory"]
    assert all(remark.data["company"] == "temperature" for remark in remarks)
    assert "turns" in remarks[-1].data["telling_run"]
    assert "both warms and cools" in remarks[0].data["telling_run"]  # between runs, turn-on biases differ as well


@pytest.mark.parametrize("averaging_s", [100.0, 300.0])
def test_few_windows_tell_apart_what_many_do(averaging_s: float) -> None:
    """Kinks of functions of the temperature, as many as there are windows, followed any input."""
    training = []
    for k, turns in enumerate(((20.0, 45.0, 45.0, -10.0, -10.0, 20.0), (20.0, -15.0, -15.0, 40.0, 40.0, 5.0))):
        hours = averaging_s / 100.0 * np.array([0.0, 0.15, 0.25, 0.5, 0.6, 0.8])
        temperature = np.interp(np.arange(0.0, hours[-1] * 3600.0, STEP_S), hours * 3600.0, turns)
        training.append(run(temperature, 40 + k))
    model = rlg.Compensator(rlg.CubicLeastSquares(), averaging_s=averaging_s).fit(training)
    assert sum(len(part.y_deg_h) for part in model.training_) < 60
    assert "temperature_rate" in [feature.group for feature in model.pipeline_.features]


def test_which_thermometer_leads_hangs_on_no_order_and_is_told() -> None:
    training = []
    for k in range(2):
        temperature = cycle(20.0, 50.0, 4.0, phase=k / 3.0)
        named = {"temperature_mirror_degC": temperature, "temperature_case_degC": temperature[::-1]}
        other = run(temperature, 70 + k, **dict(list(named.items())[:: (-1) ** k]))
        training.append(other.replace(table=other.table.drop(columns="temperature_block_degC")))
    models = [rlg.Compensator(rlg.CubicLeastSquares()).fit(runs) for runs in (training, training[::-1])]
    for model in models:
        assert {feature.columns[0] for feature in model.pipeline_.features if feature.group == "lag"} == {"temperature_case_degC"}
        (remark,) = [one for one in model.remarks_ if one.code == "compensation.leading_thermometer"]
        assert remark.data == {"column": "temperature_case_degC", "others": ["temperature_mirror_degC"]}


def test_a_monitor_that_only_differs_between_runs_is_told() -> None:
    training = []
    for k, level in enumerate((1.0, 1.2, 0.7)):
        temperature = cycle(20.0, 50.0, 4.0, phase=k / 3.0)
        training.append(run(temperature, 50 + k, light_intensity_V=np.full(len(temperature), level)))
    (told,) = (one for one in rlg.Compensator().fit(training).remarks_ if one.code == "compensation.constant_within_runs")
    assert told.data["inputs"] == ["light_intensity_V"]
    alike = [one.with_column("light_intensity_V", 1.0 + 0.1 * np.sin(one.time_s / 3000.0)) for one in training]
    assert not [one for one in rlg.Compensator().fit(alike).remarks_ if one.code == "compensation.constant_within_runs"]


def test_offsets_of_runs_are_no_failure_of_the_model() -> None:
    """With runs left out the error holds their whole difference; about the mean of each the model leaves its noise."""
    temperatures = [cycle(20.0, 50.0, 4.0, phase=k / 3.0) for k in range(2)]
    training = [run(one, 60 + k) for k, one in enumerate(temperatures)]
    shifted = [one.with_column("gyro_deg_h", one.rate_deg_h() + 3000.0 * (-1.0) ** k) for k, one in enumerate(training)]
    remarks = {one.code: one.data for one in rlg.Compensator(rlg.CubicLeastSquares()).fit(shifted).remarks_}
    assert "compensation.no_gain" not in remarks
    found = remarks["compensation.offsets_between"]
    assert found["within_deg_h"] < 0.1 * found["within_before_deg_h"]


def test_a_run_that_cools_is_told_where_training_only_warmed(tmp_path: Path) -> None:
    """Else the interval of two warm-ups is believed where no input that is used leaves its range. Also from the saved model."""
    model = rlg.Compensator().fit([run(warm_up(20.0, 30.0), 1), run(warm_up(22.0, 28.0), 2)])
    model.save(tmp_path / "model")
    for one in (model, rlg.load(tmp_path / "model")):
        for temperature, beyond in ((warm_up(48.0, -26.0), ["temperature_rate"]), (warm_up(21.0, 27.0), [])):
            remarks = [
                remark
                for remark in rlg.evaluate(one, [run(temperature, 3)], compare=False).remarks
                if remark.code == "evaluation.untold"
            ]
            assert [group for remark in remarks for group in remark.data["inputs"] if group == "temperature_rate"] == beyond


def test_a_run_may_lack_a_monitor_that_has_no_weight() -> None:
    """A shell thermometer whose gradient two warm-ups cannot tell apart."""
    training = [
        run(one, k, temperature_shell_degC=0.9 * one + 3.0) for k, one in enumerate((warm_up(20.0, 30.0), warm_up(22.0, 28.0)))
    ]
    model = rlg.Compensator().fit(training)
    assert model.untold_.recipe is not None
    assert "gradient" in [feature.group for feature in model.untold_.recipe.features]
    remarks = [one.code for one in rlg.evaluate(model, [run(warm_up(48.0, -26.0), 3)], compare=False).remarks]
    assert "evaluation.untold" in remarks


def test_runs_up_and_down_keep_all_groups(short_runs: list[rlg.Recording]) -> None:
    model = rlg.Compensator(rlg.CubicLeastSquares()).fit([run(cycle(20.0, 50.0, 4.0, phase=k / 3.0), k) for k in range(2)])
    assert [feature.group for feature in model.pipeline_.features] == ["temperature", "temperature_rate", "lag", "memory"]
    simulated = rlg.Compensator(rlg.CubicLeastSquares()).fit(short_runs[:2])
    assert len(simulated.pipeline_.features) == 7
    assert set(simulated.unused_) >= {"magnetic_field_uT", "pressure_hPa"}


def test_a_further_monitor_is_used_where_it_gains_and_named_where_not() -> None:
    training = []
    for k in range(3):
        rng, temperature = np.random.default_rng(100 + k), cycle(20.0, 50.0, 4.0, phase=k / 3.0)
        hours = np.arange(len(temperature)) * STEP_S / 3600.0
        supply, pressure = (np.sin(2.0 * np.pi * (hours / period + rng.uniform())) for period in (1.1, 0.7))
        recording = run(temperature, k, supply_voltage_V=15.0 + supply, pressure_hPa=1000.0 + pressure)
        training.append(recording.replace(table=recording.table.assign(gyro_deg_h=recording.rate_deg_h() + 20.0 * supply)))
    model = rlg.Compensator(rlg.CubicLeastSquares()).fit(training)
    assert "supply_voltage_V" in model.pipeline_.names
    assert list(model.unused_) == ["pressure_hPa"]
    assert model.unused_["pressure_hPa"] < 0.2


def test_two_monitors_that_gain_only_together_are_both_used() -> None:
    """Two wandering monitors whose small difference drives the gyro."""
    training = []
    for k in range(3):
        rng, temperature = np.random.default_rng(200 + k), cycle(20.0, 50.0, 4.0, phase=k / 3.0)
        hours = np.arange(len(temperature)) * STEP_S / 3600.0
        wander, apart = (5.0 * np.sin(2.0 * np.pi * (hours / period + rng.uniform())) for period in (1.1, 0.7))
        a, b = 10.0 * wander + apart, 10.0 * wander - apart
        recording = run(temperature, k, mirror_a_V=a, mirror_b_V=b)
        training.append(recording.replace(table=recording.table.assign(gyro_deg_h=recording.rate_deg_h() + 0.5 * (a - b))))
    model = rlg.Compensator(rlg.CubicLeastSquares()).fit(training)
    assert {"mirror_a_V", "mirror_b_V"} <= set(model.pipeline_.names)


def test_features_that_are_named_are_all_used() -> None:
    model = rlg.Compensator(features="temperature,lag").fit([run(warm_up(20.0, 30.0), 1), run(warm_up(20.0, 30.0), 2)])
    assert [feature.group for feature in model.pipeline_.features] == ["temperature", "lag"]
    assert not [remark for remark in model.remarks_ if remark.code == "compensation.not_told_apart"]


def test_a_table_that_turns_is_a_candidate() -> None:
    """A scale factor error is a bias that follows the table's rate: "all" takes it, and an angle never."""
    training = []
    for k in range(3):
        temperature = cycle(20.0, 50.0, 4.0, phase=k / 3.0)
        rate = 5.0 * np.sign(np.sin(np.arange(len(temperature)) * STEP_S / (500.0 + 90.0 * k)))
        recording = run(temperature, k, table_rate_deg_s=rate, table_angle_deg=np.cumsum(rate) * STEP_S)
        training.append(recording.replace(table=recording.table.assign(gyro_deg_h=recording.rate_deg_h() + 8.0 * rate)))
    model = rlg.Compensator(rlg.CubicLeastSquares()).fit(training)
    assert "table_rate_deg_s" in model.pipeline_.names
    assert not {name for name in model.pipeline_.names if "angle" in name}
    assert model.selection_.rmse is not None
    assert model.selection_.rmse * model.scaling_.y_scale_deg_h < 4.0


@pytest.mark.parametrize(
    ("column", "nearest"),
    [
        ("temperatur_block_degC", "temperature_block_degC"),
        ("Temp_block_degC", "temperature_block_degC"),
        ("pressure_kPa", "pressure_hPa"),
        ("suply_voltage_V", "supply_voltage_V"),
        ("cavity_volume", None),
        ("temperature_mirror_degC", None),  # a thermometer at any place is standard
    ],
)
def test_a_column_whose_name_is_nearly_standard_is_asked_about(column: str, nearest: str | None) -> None:
    temperature = cycle(20.0, 50.0, 3.0)
    recording = run(temperature, 1, **{column: np.sin(np.arange(len(temperature)) / 50.0)})
    if nearest == "temperature_block_degC":
        recording = recording.replace(table=recording.table.rename(columns={nearest: "temperature_frame_degC"}))
    remarks = [remark for remark in nearly_standard([recording]) if remark.code == "compensation.nearly_standard"]
    assert [(remark.data["column"], remark.data["nearest"]) for remark in remarks] == (
        [] if nearest is None else [(column, nearest)]
    )
    assert not nearly_standard([recording], ["temperature", column])  # asked for, so meant


def test_a_second_monitor_of_a_kind_is_not_asked_about() -> None:
    temperature = cycle(20.0, 50.0, 3.0)
    wave = np.sin(np.arange(len(temperature)) / 50.0)
    assert not nearly_standard([run(temperature, 1, supply_voltage_V=wave, supply_voltage_2_V=wave)])


@pytest.mark.parametrize("column", ["GyroY_dps", "rate [deg/s]", "filtered", "PULSES_B", "CNT_B", "rate2", "Impulse 2"])
def test_another_gyro_or_a_copy_of_the_gyro_is_no_input(column: str) -> None:
    """A model that reads either subtracts the rotation, and is praised for it by runs in which nothing turns."""
    runs = [run(cycle(20.0, 50.0, 3.0), seed) for seed in (1, 2)]
    rng = np.random.default_rng(0)
    other = {one.name: one.rate_deg_h() / 3600.0 if column == "filtered" else rng.standard_normal(len(one)) for one in runs}
    runs = [one.replace(table=one.table.assign(**{column: other[one.name]})) for one in runs]
    further, remarks = further_monitors(runs, "all", pipeline_for(runs, "all"))
    assert column not in further
    assert [remark.data["column"] for remark in remarks] == [column]


def test_the_gyro_itself_is_refused_as_an_input() -> None:
    one = run(cycle(20.0, 50.0, 3.0), 1)
    one = one.replace(table=one.table.assign(copy_V=-one.rate_deg_h() / 3600.0))
    with pytest.raises(rlg.InputError, match="copy_V, which is the gyro itself"):
        require_no_gyro([one], "all,copy_V", None)


def test_what_is_measured_at_a_gyro_is_a_monitor() -> None:
    one = run(cycle(20.0, 50.0, 3.0), 1)
    one = one.replace(table=one.table.assign(gyro_current_mA=np.random.default_rng(0).standard_normal(len(one))))
    assert further_monitors([one], "all", pipeline_for([one], "all")) == (["gyro_current_mA"], [])


@pytest.mark.parametrize("column", ["current_b", "PLC_2", "flow_rate", "light_counts", "T_rate", "rate [K/min]", "fan_pulses"])
def test_a_second_monitor_a_rate_or_counts_of_something_else_are_candidates(column: str) -> None:
    one = run(cycle(20.0, 50.0, 3.0), 1)
    one = one.replace(table=one.table.assign(**{column: np.random.default_rng(0).standard_normal(len(one))}))
    assert further_monitors([one], "all", pipeline_for([one], "all")) == ([column], [])


def test_a_second_gyro_that_counts_pulses_takes_no_rotation_away() -> None:
    """Two gyros of one base that sways; in a new run the base turns slowly, by 8 deg/h rms, and the model lets it stand."""

    def pair(seed: int, rotation_deg_h: float = 0.0) -> rlg.Recording:
        one = run(cycle(20.0, 50.0, 4.0, phase=seed / 3.0), seed, noise_deg_h=0.3)
        turning = rotation_deg_h * np.sin(2.0 * np.pi * one.time_s / 6000.0)
        turning += 20.0 * np.sin(2.0 * np.pi * one.time_s / 2500.0 + seed)  # of both, unknown to the thermometer
        other = turning + 0.5 * np.random.default_rng(seed).standard_normal(len(one))
        table = {"gyro_deg_h": one.rate_deg_h() + turning, "PULSES_B": np.round(other * STEP_S / 0.5)}
        return one.replace(table=one.table.assign(**table))

    model = rlg.Compensator().fit([pair(1), pair(2)])
    assert "PULSES_B" not in model.pipeline_.columns
    still, turning = (model.predict(pair(3, rate))["bias_deg_h"] for rate in (0.0, 11.3))
    assert np.abs(turning - still).max() < 0.01
