"""Features: causal, reset at every recording, and the same to the last bit in a stream, in pieces and at once."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import rlgcomp as rlg
from rlgcomp.compensation.feature_pipeline import GROUPS, pipeline_for
from rlgcomp.compensation.features import FEATURES, Difference, Lag, Level, Memory, Rate, ReadoutDifference
from rlgcomp.compensation.physics_terms import PhysicsTerm

T = "temperature_block_degC"
EVERY = rlg.FeatureRecipe(
    (
        Level(T),
        Level("light_intensity_V", smoothing_s=30.0),
        Rate(T),
        Lag(T, (100.0, 900.0)),
        Memory(T, (1.0, 5.0)),
        Difference(),
        ReadoutDifference(),
        PhysicsTerm(
            mechanism="mode_hop", parameter="step_deg_h", driver=T, memory="relays", knots=(30.0,), knots_2=(20.0,), weights=(1.0,)
        ),
    )
)


def test_every_kind_is_tried_here() -> None:
    assert {feature.kind for feature in EVERY.features} == set(FEATURES)


def test_sample_by_sample_is_the_whole_to_the_last_bit(short_runs: list[rlg.Recording]) -> None:
    run = short_runs[0]
    whole = EVERY.transform(run).to_numpy()
    state, values = None, []
    for row in run.table.to_dict("records"):
        value, state = EVERY.step(state, row)
        values.append(value)
    assert np.array_equal(np.array(values), whole)


@settings(max_examples=40, deadline=None)
@given(
    st.lists(st.tuples(st.floats(-60, 90), st.floats(0.1, 5), st.floats(0.1, 5), st.floats(1e-3, 500)), min_size=3, max_size=40),
)
def test_any_samples_and_any_steps_agree(samples: list[tuple[float, float, float, float]]) -> None:
    """Uneven steps, gaps and jumps included; the real-time box sees one sample after the other."""
    time_s = np.cumsum([step for *_, step in samples])
    rows = [
        {"time_s": t, T: a, "temperature_shell_degC": a / 2, "light_intensity_V": b, "readout_a_V": b, "readout_b_V": c}
        for t, (a, b, c, _) in zip(time_s.tolist(), samples, strict=True)
    ]
    import pandas as pd

    whole = EVERY.transform(rlg.Recording(pd.DataFrame(rows).assign(gyro_deg_h=0.0))).to_numpy()
    state, values = None, []
    for row in rows:
        value, state = EVERY.step(state, row)
        values.append(value)
    assert np.array_equal(np.array(values), whole)


def test_they_are_causal(short_runs: list[rlg.Recording]) -> None:
    run = short_runs[0]
    head = run.between(-np.inf, run.time_s[1000])
    assert np.array_equal(EVERY.transform(head).to_numpy(), EVERY.transform(run).to_numpy()[:1000])


def test_they_restart_with_every_recording(short_runs: list[rlg.Recording]) -> None:
    first = EVERY.transform(short_runs[0]).iloc[0]
    for name in first.index:
        if "lag" in name or "memory" in name or "rate" in name:
            assert first[name] == 0.0


def test_rate_and_lag_of_a_ramp(unit: rlg.Simulator) -> None:
    """On a long ramp the rate is the ramp's, and a lag is behind by rate times tau."""
    import pandas as pd

    time_s = np.arange(0.0, 20_000.0, 5.0)
    table = pd.DataFrame({"time_s": time_s, "gyro_deg_h": 0.0, T: -40.0 + time_s / 60.0})
    pipeline = rlg.FeatureRecipe((Rate(T), Lag(T, (300.0, 900.0)), Memory(T, (3.0,))))
    last = pipeline.transform(rlg.Recording(table)).iloc[-1]
    assert last["temperature_block_rate_degC_min"] == pytest.approx(1.0, rel=1e-9)
    assert last["temperature_block_lag_300s_K"] == pytest.approx(-5.0, rel=1e-6)
    assert last["temperature_block_lag_900s_K"] == pytest.approx(-15.0, rel=1e-6)
    assert last["temperature_block_memory_3_K"] == pytest.approx(-3.0)


def test_readout_difference_is_blind_to_power(short_runs: list[rlg.Recording]) -> None:
    run = short_runs[0]
    dimmed = run.replace(
        table=run.table.assign(readout_a_V=0.5 * run.column("readout_a_V"), readout_b_V=0.5 * run.column("readout_b_V"))
    )
    pipeline = rlg.FeatureRecipe((ReadoutDifference(),))
    assert pipeline.transform(dimmed).to_numpy() == pytest.approx(pipeline.transform(run).to_numpy(), rel=1e-12)


def test_a_pipeline_and_back() -> None:
    assert rlg.FeatureRecipe.from_list(EVERY.to_list()) == EVERY


@pytest.mark.parametrize("items", [[{"kind": "magic"}], [{"kind": "lag", "colour": 1}], [{}], []])
def test_a_wrong_pipeline_is_refused(items: list[dict[str, object]]) -> None:
    with pytest.raises(rlg.InputError):
        rlg.FeatureRecipe.from_list(items)


def test_the_pipeline_uses_the_recorded_monitors(short_runs: list[rlg.Recording]) -> None:
    everything = pipeline_for(short_runs)
    assert {feature.group for feature in everything.features} == set(GROUPS)
    without_light = [run.replace(table=run.table.drop(columns="light_intensity_V")) for run in short_runs]
    assert "light_intensity" not in {feature.group for feature in pipeline_for(without_light).features}
    assert pipeline_for(short_runs, "temperature,supply_voltage_V").names == (T, "supply_voltage_V")


def test_short_runs_have_no_long_lags(short_runs: list[rlg.Recording]) -> None:
    run = short_runs[0].between(0.0, 3000.0)
    (lag,) = pipeline_for([run], "lag").features
    assert lag.time_constants_s == (300.0, 900.0)
    (lag,) = pipeline_for([short_runs[0].between(0.0, 600.0)], "lag").features
    assert lag.time_constants_s == (200.0,)


@pytest.mark.parametrize(
    ("wanted", "message"), [("colour", "neither a group"), ("time_s", "neither a group"), ("gradient", "not every run has")]
)
def test_features_that_cannot_be_had(short_runs: list[rlg.Recording], wanted: str, message: str) -> None:
    bare = [run.replace(table=run.table.drop(columns="temperature_shell_degC")) for run in short_runs]
    with pytest.raises(rlg.InputError, match=message):
        pipeline_for(bare, wanted)


def test_no_monitor_at_all_is_refused(short_runs: list[rlg.Recording]) -> None:
    bare = [run.replace(table=run.table[["time_s", "gyro_deg_h"]]) for run in short_runs]
    with pytest.raises(rlg.InputError, match="no monitor to learn from"):
        pipeline_for(bare)


def test_a_monitor_that_is_no_feature_by_itself_is_named(short_runs: list[rlg.Recording]) -> None:
    first, second = (run.replace(table=run.table[["time_s", "gyro_deg_h", T, "temperature_shell_degC"]]) for run in short_runs[:2])
    lacking = second.replace(table=second.table.drop(columns=T))
    with pytest.raises(rlg.InputError, match=f"not all of them have {T}; learn from .* with --features temperature_shell_degC"):
        pipeline_for([first, lacking])
    own = [
        run.replace(table=run.table[["time_s", "gyro_deg_h"]].assign(**{"GyroY_dps": 1.0, "T [°C]": run.table[T]}))
        for run in (first, second)
    ]
    with pytest.raises(
        rlg.InputError, match=r"learn from T \[°C\] with --features 'T \[°C\]', or map .* --map temperature_block_degC='T \[°C\]'"
    ):
        pipeline_for(own)


@pytest.mark.parametrize("change", [{T: float("nan")}, {"time_s": 0.0}, {T: None}, {T: "20.0"}, {T: [20.0]}, {T: pd.NA}])
def test_a_wrong_sample_is_refused(change: dict[str, object]) -> None:
    pipeline = rlg.FeatureRecipe((Level(T),))
    _, state = pipeline.step(None, {"time_s": 1.0, T: 20.0})
    sample = {"time_s": 2.0, T: 20.0} | change
    with pytest.raises(rlg.InputError, match="sample"):
        pipeline.step(state, sample)
    with pytest.raises(rlg.InputError, match=f"sample: {T} missing"):
        pipeline.step(state, {"time_s": 2.0})
