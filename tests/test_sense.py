"""Numbers that cannot be what they claim: undone and reported, taken as missing, or refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import rlgcomp as rlg
from rlgcomp.recording import Finding
from rlgcomp.recording.formats.mapping import apply_mapping
from rlgcomp.recording.repair import UnusableRecordingError, repair
from rlgcomp.recording.repair.context import Step
from rlgcomp.recording.repair.running_sense import RunningSense
from tests.cases import by_code, case

ROWS = 3000
TIME = np.arange(float(ROWS))
BLOCK = 20.0 + 30.0 * np.sin(2 * np.pi * TIME / ROWS)


def table(**columns: object) -> pd.DataFrame:
    rng = np.random.default_rng(2)
    own = {"time_s": TIME, "gyro_deg_h": 0.01 + 0.02 * rng.standard_normal(ROWS), "temperature_block_degC": BLOCK}
    return pd.DataFrame(own | columns)


def repaired(frame: pd.DataFrame, **metadata: object) -> tuple[pd.DataFrame, dict[str, Finding]]:
    result, findings = repair(frame, rlg.Metadata(**metadata), name="file")
    return result, by_code(findings)


def refused(frame: pd.DataFrame) -> dict[str, Finding]:
    with pytest.raises(UnusableRecordingError) as caught:
        repair(frame, rlg.Metadata(), name="file")
    return by_code(caught.value.findings)


@pytest.mark.parametrize("value", [-9999.0, 850.0, 32767.0, -127.0, -999.0])
@pytest.mark.parametrize("rows", [[700], [500, 900, 901], list(range(400, 430))])
def test_error_values_of_loggers_count_as_missing(value: float, rows: list[int]) -> None:
    spoilt = BLOCK.copy()
    spoilt[rows] = value
    result, found = repaired(table(temperature_block_degC=spoilt))
    assert (found["error_values"].row, found["error_values"].message.data) == (rows[0], {"values": len(rows), "written": [value]})
    assert result["temperature_block_degC"].to_numpy() == pytest.approx(BLOCK, abs=3.0)


def test_error_values_of_other_columns_and_of_the_gyro() -> None:
    gyro = table()["gyro_deg_h"].to_numpy(copy=True)
    gyro[[5, 800]] = -9999.0
    light = 2.5 + 0.01 * np.sin(TIME)
    light[100:110] = 999.9
    result, found = repaired(table(gyro_deg_h=gyro, light_intensity_V=light))
    assert len(result) == ROWS - 2
    assert result["light_intensity_V"].max() < 3.0
    assert found["error_values"].message.data == {"values": 2, "written": [-9999.0]}


@pytest.mark.parametrize("value", [-9999.0, 999.99])
@pytest.mark.parametrize("unit", ["deg/h", "deg/s", "-rad/s", "0.25 deg/h"])
@pytest.mark.parametrize("kind", ["csv", "single"])
def test_error_values_are_known_by_what_is_written_in_whatever_unit(tmp_path: Path, value: float, unit: str, kind: str) -> None:
    gyro = table()["gyro_deg_h"].to_numpy(copy=True)
    gyro[100:160] = value
    frame = table().drop(columns="gyro_deg_h").assign(rate=gyro)
    path = tmp_path / ("run.csv" if kind == "csv" else "run.parquet")
    if kind == "csv":
        frame.to_csv(path, index=False)
    else:
        frame.astype({"rate": np.float32}).to_parquet(path)
    run = rlg.read(path, columns={"gyro_deg_h": f"rate [{unit}]"})
    assert len(run) == ROWS - 60
    assert by_code(run.findings)["error_values"].message.data == {"values": 60, "written": [value]}


def test_a_stream_knows_error_values_by_what_is_written() -> None:
    frame = pd.DataFrame({"rate": 0.001 * np.sin(np.arange(100.0))})
    frame.loc[[50, 51], "rate"] = -9999.0
    mapped = apply_mapping(frame, {"gyro_deg_h": "rate [deg/s]"}, name="file")
    sense = RunningSense()
    checked = sense.checked(mapped.table, mapped.error_values)["gyro_deg_h"]
    assert np.flatnonzero(checked.isna()).tolist() == [50, 51]
    assert dict(sense.changed) == {"error values of loggers": 2}


def test_readings_that_reach_such_a_value_are_left_as_they_are() -> None:
    pressure = np.linspace(700.0, 1000.0, ROWS)
    pressure[1500] = 850.0
    result, found = repaired(table(pressure_hPa=pressure))
    assert "error_values" not in found
    assert result["pressure_hPa"].to_numpy() == pytest.approx(pressure)


def test_impossible_temperatures_are_missing_where_few_and_refused_where_many() -> None:
    few = BLOCK.copy()
    few[[10, 2000]] = [-300.0, 1234.5]
    result, found = repaired(table(temperature_block_degC=few))
    assert found["impossible_temperatures"].message.data["values"] == 2
    assert result["temperature_block_degC"].between(-11, 51).all()
    data = refused(table(temperature_block_degC=100.0 * BLOCK))["no_temperatures"].message.data
    assert data["greatest"] == pytest.approx(5000.0, abs=1.0)


def test_degrees_that_are_taken_for_kelvin_are_refused_with_the_map_that_reads_them(tmp_path: Path) -> None:
    path = tmp_path / "run.csv"
    table().rename(columns={"temperature_block_degC": "temps_1"}).to_csv(path, index=False)
    with pytest.raises(UnusableRecordingError) as caught:
        rlg.read(path, columns={"temperature_block_degC": "temps_1 [K]"})
    (found,) = [finding.message for finding in caught.value.findings if finding.severity == "refused"]
    assert (found.code, found.data["median"]) == ("recording.near_absolute_zero", pytest.approx(-253.15, abs=0.1))
    assert "--map temperature_block_degC='temps_1 [degC]'" in found.text
    assert len(rlg.read(path, columns={"temperature_block_degC": "temps_1 [degC]"})) == ROWS
    assert refused(table(temperature_block_degC=BLOCK - 273.15))["near_absolute_zero"].message.data["column"]
    cooled = repaired(table(temperature_shroud_degC=-190.0 + 0.1 * BLOCK))[1]
    assert "near_absolute_zero" not in cooled


@pytest.mark.parametrize(("steps", "modulus"), [(256.0, 256.0), (100.0, None)])
def test_a_converter_of_sixteen_bits_without_its_sign(steps: float, modulus: float | None) -> None:
    """Signed readings, of 1/256 K or 1/100 K, that a logger takes for unsigned ones."""
    counts = np.round(steps * (BLOCK - 25.0)).astype(int)
    unsigned = (counts % 65536) / steps + (25.0 if modulus else 0.0)
    if modulus:
        result, found = repaired(table(temperature_block_degC=unsigned))
        assert result["temperature_block_degC"].to_numpy() == pytest.approx(BLOCK, abs=0.01)
        assert found["counter_overflow"].message.data["modulus"] == 256.0
    else:
        assert "no_temperatures" in refused(table(temperature_block_degC=counts % 65536))


@pytest.mark.parametrize("bits", [16, 32])
def test_pulses_without_their_sign(bits: int) -> None:
    pulses = np.random.default_rng(3).integers(-40, 41, ROWS)
    result, found = repaired(table(gyro_deg_h=None).drop(columns="gyro_deg_h").assign(gyro_pulses=(pulses % 2**bits).astype(float)))
    assert result["gyro_pulses"].to_numpy() == pytest.approx(pulses)
    assert found["counter_overflow"].message.data["modulus"] == 2.0**bits


def test_a_monitor_that_counts_on_over_its_range() -> None:
    running = 60000.0 + 10.0 * TIME
    result, _ = repaired(table(flow_counts=running % 65536))
    assert np.diff(result["flow_counts"]) == pytest.approx(10.0)


def test_a_range_of_256_with_other_steps_as_wide_is_no_overflow() -> None:
    values = np.random.default_rng(4).uniform(0.0, 256.0, ROWS)
    result, found = repaired(table(field_uT=values))
    assert "counter_overflow" not in found
    assert result["field_uT"].to_numpy() == pytest.approx(values)


@pytest.mark.parametrize("times", [2, 5, 10])
@pytest.mark.parametrize("lost", [False, True])
def test_values_that_are_written_several_times_have_their_true_period(times: int, lost: bool) -> None:
    gyro = np.repeat(np.random.default_rng(5).standard_normal(ROWS // times), times)
    frame = table(gyro_deg_h=gyro, temperature_block_degC=BLOCK + 0.01 * np.random.default_rng(6).standard_normal(ROWS))
    result, found = repaired(frame.drop(index=[301, 302, 1700]).reset_index(drop=True) if lost else frame)
    assert found["repeated_values"].message.data == {"times": times, "period_s": float(times)}
    run = rlg.Recording(result)
    assert run.period_s == pytest.approx(times)
    assert abs(len(run) - ROWS // times) <= 2


def test_chance_repeats_are_no_repeated_values() -> None:
    coarse = np.round(np.random.default_rng(7).standard_normal(ROWS) * 0.4)
    assert "repeated_values" not in repaired(table(gyro_deg_h=coarse))[1]
    assert "repeated_values" not in repaired(table())[1]


@pytest.mark.parametrize("every", [30, 300])
def test_blanks_between_readings_and_held_readings_are_one(every: int) -> None:
    rows = 30 * every
    rng = np.random.default_rng(8)
    readings = np.round(20.0 + 10.0 * np.sin(np.arange(30) / 5.0), 2)
    frame = pd.DataFrame({"time_s": np.arange(float(rows)), "gyro_deg_h": rng.standard_normal(rows)})
    held = frame.assign(temperature_block_degC=np.repeat(readings, every))
    blank = held.assign(temperature_block_degC=held["temperature_block_degC"].where(np.arange(rows) % every == 0))
    first, second = (repaired(one) for one in (held, blank))
    pd.testing.assert_frame_equal(first[0], second[0])
    assert second[1]["blanks_between_readings"].message.data["interval_s"] == float(every)


def bursts(count: int = 25, samples: int = 250, period_s: float = 0.02, every_s: float = 305.0) -> rlg.Recording:
    rng = np.random.default_rng(9)
    time_s = (every_s * np.arange(count)[:, None] + period_s * np.arange(samples)).ravel()
    temperature = 20.0 + 0.004 * time_s
    return rlg.Recording(
        pd.DataFrame(
            {"time_s": time_s, "gyro_deg_h": rng.standard_normal(len(time_s)) + temperature, "temperature_block_degC": temperature}
        )
    )


@pytest.mark.parametrize(("count", "samples", "every_s"), [(25, 250, 305.0), (12, 500, 60.0)])
def test_a_burst_is_a_window(count: int, samples: int, every_s: float) -> None:
    run = bursts(count, samples, every_s=every_s)
    averaged = run.averaged(100.0)
    assert len(averaged) == count
    assert np.diff(averaged.time_s) == pytest.approx(every_s)
    assert averaged.rate_deg_h() == pytest.approx(averaged.column("temperature_block_degC"), abs=0.3)
    data = by_code(averaged.findings)["bursts"].message.data
    assert (data["bursts"], data["length_s"]) == (count, pytest.approx(0.02 * samples))
    assert len(run.averaged(1.0)) >= 4 * count


def test_shared_cases() -> None:
    assert (
        by_code(rlg.read(case("03-impossible-temperatures/sentinel9999.csv")).findings)["error_values"].message.data["values"] == 4
    )
    assert rlg.read(case("03-impossible-temperatures/temp16scaled.csv")).column("temperature_block_degC").min() < 25.0
    with pytest.raises(rlg.InputError, match="no temperatures of a gyro"):
        rlg.read(case("03-impossible-temperatures/temp16.csv"))
    for name in ("cold", "hot", "new"):
        assert (
            abs(np.median(rlg.read(case(f"03-impossible-temperatures/w16_{name}.parquet")).column("temperature_block_degC"))) < 80
        )
    assert len(rlg.read(case("14-duty-cycled-bursts/bursts.csv")).averaged()) == 25


@pytest.mark.parametrize(
    ("column", "step", "level"), [("temperature_block_degC", 0.01, 0.3), ("gyro_deg_h", 1e-4, 0.001), ("pressure_hPa", 0.1, 2.0)]
)
def test_small_numbers_of_both_signs_without_theirs(column: str, step: float, level: float) -> None:
    """A converter of 16 bits in steps of a unit: -1 step is read as 65535 of them; missing values hide nothing."""
    signed = np.rint((level * np.sin(TIME / 90.0) + 3.0 * level * np.random.default_rng(5).standard_normal(ROWS)) / step)
    read = step * (signed % 65536.0)
    read[77] = np.nan
    result, found = repaired(table(**{column: read}))
    kept = (
        np.delete(step * signed, 77)
        if column == "gyro_deg_h"
        else np.where(np.arange(ROWS) == 77, step * signed[76], step * signed)
    )
    assert result[column].to_numpy() == pytest.approx(kept, abs=1e-6)
    assert found["counter_overflow"].message.data["modulus"] == pytest.approx(65536.0 * step)


@settings(max_examples=25, deadline=None)
@given(
    st.integers(8, 32),
    st.sampled_from([1.0, 0.5, -0.0095367]),
    st.sampled_from([0.0, 25.0]),
    st.sampled_from(["gyro_deg_h", "field_uT"]),
)
def test_two_s_complement_of_any_number_of_bits(bits: int, step: float, zero: float, column: str) -> None:
    """Noise of a thirtieth of the range, so that no two values need differ by one step."""
    signed = np.rint(0.03 * 2.0**bits * np.random.default_rng(bits).standard_normal(ROWS))
    frame = table(**{column: step * (signed % 2.0**bits) + zero})
    stated = {} if step == 1.0 and not zero else {column: Step(step, zero)}
    result, findings = repair(frame, rlg.Metadata(), name="file", converters=stated)
    assert result[column].to_numpy() == pytest.approx(step * signed + zero, rel=1e-6, abs=1e-3 * abs(step))
    assert by_code(findings)["counter_overflow"].message.data["modulus"] == pytest.approx(abs(step) * 2.0**bits)


@pytest.mark.parametrize(("middle", "said"), [(2.0**23, True), (2.0**15 + 20.0, True), (3e6, False), (200.0, False)])
def test_counts_about_the_middle_of_a_range_are_questioned(middle: float, said: bool) -> None:
    counts = middle + np.random.default_rng(1).integers(-30, 31, ROWS)
    result, findings = repair(
        table(gyro_deg_h=0.5 * counts), rlg.Metadata(), name="file", converters={"gyro_deg_h": Step(0.5, 0.0)}
    )
    assert result["gyro_deg_h"].to_numpy() == pytest.approx(0.5 * counts)
    assert ("offset_binary" in by_code(findings)) == said


def test_whole_numbers_at_both_ends_of_a_range_without_jumps_between_them_are_none() -> None:
    """A level that changes once, a pulse width that is nearly off or nearly on, and values that fill their range."""
    random = np.random.default_rng(6)
    once = np.where(TIME < 1500.0, 0.0, 1000.0) + random.integers(0, 20, ROWS)
    turning = np.where(TIME % 200.0 > 90.0, 1000.0, 0.0) + random.integers(0, 12, ROWS)  # pulses of a table that stops and goes
    width = np.where(TIME % 200.0 > 90.0, 4095.0, 0.0)
    filled = random.integers(0, 4096, ROWS).astype(float)
    result, found = repaired(table(once=once, width=width, filled=filled, turning=turning))
    assert "counter_overflow" not in found
    for name, values in (("once", once), ("width", width), ("filled", filled), ("turning", turning)):
        assert (result[name].to_numpy() == values).all()


def test_a_switch_is_no_counter() -> None:
    """Fully off and fully on, in bytes and otherwise."""
    on = TIME % 200.0 > 90.0
    for values in (255.0 * on, 100.0 * on, 655.35 * on):
        result, found = repaired(table(heater=values))
        assert (result["heater"].to_numpy() == values).all()
        assert "counter_overflow" not in found
