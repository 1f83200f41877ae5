"""How a table turned: rate, angle and acceleration from whichever column a recording has."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

import rlgcomp as rlg
from rlgcomp.recording import motion, time_stamp_convention
from rlgcomp.simulation.table_programme import TableProgramme

PROGRAMME = TableProgramme.parse("rate 7 60, rate -25 90, rest 30, sweep -3 3 120, rate 170 40")


def recording(*columns: str, step_s: float = 1.0, wrapped: bool = True, gyro: np.ndarray | None = None, **metadata: float):
    edges_s = np.arange(0.0, PROGRAMME.duration_s, step_s)
    angle = 40.0 + PROGRAMME.angle_deg(edges_s)
    table = {
        "time_s": edges_s[1:],
        "gyro_deg_s": np.diff(angle) / step_s if gyro is None else gyro,
        "table_angle_deg": angle[1:] % 360.0 if wrapped else angle[1:],
        "table_rate_deg_s": np.diff(angle) / step_s,
    }
    kept = {name: values for name, values in table.items() if name in ("time_s", "gyro_deg_s", *columns)}
    return rlg.Recording(pd.DataFrame(kept), rlg.Metadata(kind="turntable", **metadata), name="made")


BOTH = ("table_angle_deg", "table_rate_deg_s")


def test_rate_and_angle_come_from_each_other() -> None:
    both, angle, rate = recording(*BOTH), recording("table_angle_deg"), recording("table_rate_deg_s")
    assert motion.rate_deg_s(angle)[1:] == pytest.approx(motion.rate_deg_s(both)[1:], abs=1e-9)
    assert np.diff(motion.angle_deg(rate)) == pytest.approx(np.diff(motion.angle_deg(both)), abs=1e-9)
    assert motion.angle_deg(rate)[0] == 0.0
    assert motion.angle_deg(angle) % 360.0 == pytest.approx(angle.column("table_angle_deg"), abs=1e-9)


def test_the_rate_unwraps_what_the_angle_alone_cannot() -> None:
    """170 deg/s every 2 s is 340 degrees a row: less than half a turn backwards by the angle alone."""
    both, angle = recording(*BOTH, step_s=2.0), recording("table_angle_deg", step_s=2.0)
    true = recording("table_angle_deg", step_s=2.0, wrapped=False).column("table_angle_deg")
    assert motion.angle_deg(both) - motion.angle_deg(both)[0] == pytest.approx(true - true[0], abs=1e-9)
    assert motion.rate_deg_s(angle)[-20] == pytest.approx(170.0 - 180.0)


def test_an_angle_that_runs_on_needs_no_rate() -> None:
    """It says itself how many turns lie between two rows; one that wraps at ten turns has them undone."""
    true = recording("table_angle_deg", step_s=2.0, wrapped=False).column("table_angle_deg")
    time_s = np.arange(len(true), dtype=float)
    assert np.abs(np.diff(true)).max() > 180.0
    assert np.array_equal(motion.unwrapped_deg(true, time_s, 1.0), true)
    slow = true / 4.0
    assert motion.unwrapped_deg(slow % 1800.0, time_s, 1.0) == pytest.approx(slow, abs=1e-9)


@given(st.lists(st.floats(-170.0, 170.0), min_size=4, max_size=60), st.floats(0.0, 360.0))
def test_any_wrapped_angle_runs_on(steps: list[float], start: float) -> None:
    true = start + np.concatenate([[0.0], np.cumsum(steps)])
    found = motion.unwrapped_deg(true % 360.0, np.arange(len(true), dtype=float), 1.0)
    assert np.diff(found) == pytest.approx(np.array(steps), abs=1e-9)


def test_acceleration_is_that_of_the_programme() -> None:
    acceleration = motion.acceleration_deg_s2(recording("table_rate_deg_s", step_s=0.1))
    assert np.abs(acceleration).max() == pytest.approx(10.0, rel=1e-6)
    assert np.median(acceleration[2250:3000]) == pytest.approx(6.0 / 120.0, rel=1e-6)


@pytest.mark.parametrize("taken", motion.TAKEN)
@pytest.mark.parametrize("order", [1, 5])
def test_a_harmonic_is_the_mean_over_its_sample(order: int, taken: str) -> None:
    """Against the mean over a thousand instants of each sample; at steady rates the two agree to a part in a million."""
    run = recording(*BOTH)
    time_s = run.time_s
    steady = np.abs(motion.acceleration_deg_s2(run)) < 1e-9
    steady = steady & np.roll(steady, 1) & np.roll(steady, -1)
    instants = (np.arange(1000) + 0.5) / 1000.0 + {"before": -1.0, "at": 0.0, "after": 0.0}[taken]
    angle = np.radians(40.0 + PROGRAMME.angle_deg(time_s[:, None] + (instants if taken != "at" else np.zeros(1))))
    cosine, sine = motion.harmonic(run, order, taken)
    assert cosine[steady] == pytest.approx(np.cos(order * angle).mean(axis=1)[steady], abs=1e-5)
    assert sine[steady] == pytest.approx(np.sin(order * angle).mean(axis=1)[steady], abs=1e-5)


def test_the_gyro_says_which_reading_is_its_own() -> None:
    """A gyro that means the sample after its time stamp, one centred on it, and a tachometer noisier than the encoder."""
    angle = recording("table_angle_deg", wrapped=False).column("table_angle_deg")
    over = np.r_[40.0 - angle[0], -np.diff(angle)] * -1.0
    after = np.r_[over[1:], over[-1]]
    centred = np.diff(PROGRAMME.angle_deg(np.arange(0.5, PROGRAMME.duration_s + 0.5)))[: len(over)]
    for own, means in ((over, "angle"), (centred, "middle"), (after, "after")):
        gyro = 1.0001 * own + 0.01
        run = recording("table_angle_deg", gyro=gyro)
        reading = time_stamp_convention.reading_of(run, 3600.0 * gyro)
        assert reading.means == means
        interpolated = reading.interpolation_error_deg_s < 1e-6
        assert np.mean(interpolated) > 0.7
        assert reading.rate_deg_s[1:-1][interpolated[1:-1]] == pytest.approx(own[1:-1][interpolated[1:-1]], abs=1e-5)
    run = recording(*BOTH, gyro=over)
    noisy = run.replace(table=run.table.assign(table_rate_deg_s=over + 0.01 * np.random.default_rng(0).standard_normal(len(over))))
    assert time_stamp_convention.reference_rate_deg_s(noisy, 3600.0 * over)[1:] == pytest.approx(over[1:], abs=1e-9)


def test_a_rate_at_the_instant_tells_the_mean_over_each_sample() -> None:
    """Beside an exact encoder the encoder tells it; alone, what lies between instants does, but where the table sets off."""
    run = recording(*BOTH, step_s=0.5)
    mean = run.column("table_rate_deg_s")
    angle = PROGRAMME.angle_deg(np.r_[run.time_s - 1e-4, run.time_s + 1e-4]).reshape(2, -1)
    instant = run.replace(table=run.table.assign(table_rate_deg_s=(angle[1] - angle[0]) / 2e-4))
    late, sd = time_stamp_convention.delay_in_samples(instant, instant.column("table_rate_deg_s"), 3600.0 * mean)
    assert late == pytest.approx(-0.5, abs=max(0.05, 3.0 * sd))
    assert time_stamp_convention.reading_of(instant, 3600.0 * mean).means == "angle"
    alone = instant.replace(table=instant.table.drop(columns="table_angle_deg"))
    reading = time_stamp_convention.reading_of(alone, 3600.0 * mean)
    assert reading.means == "instant"
    interpolated = reading.interpolation_error_deg_s < 1e-6
    assert np.mean(interpolated) > 0.8
    assert reading.rate_deg_s[interpolated] == pytest.approx(mean[interpolated], abs=1e-6)


@pytest.mark.parametrize("late_s", [0.2, 0.42])
def test_an_encoder_that_is_late_by_another_part_of_a_sample_is_read_as_it_is(late_s: float) -> None:
    run = recording("table_angle_deg")
    edges_s = np.r_[0.0, run.time_s]
    gyro = np.diff(PROGRAMME.angle_deg(np.minimum(edges_s + late_s, PROGRAMME.duration_s)))
    assert time_stamp_convention.reading_of(run, 3600.0 * gyro).means == "angle"


def test_the_recorded_rate_stays_where_nothing_is_clearly_better() -> None:
    """A gyro that its encoder lags behind is late against every reading: that is a finding, not a choice of column."""
    run = recording(*BOTH, step_s=0.1)
    late = run.column("table_rate_deg_s") + 0.005 * motion.acceleration_deg_s2(run)
    assert np.array_equal(time_stamp_convention.reference_rate_deg_s(run, 3600.0 * late), run.column("table_rate_deg_s"))


def test_rows_whose_rate_an_angle_does_not_tell() -> None:
    """The ends; and after a gap, unless the table turned as evenly before it as after it."""
    assert not motion.rows_without_rate(recording(*BOTH)).any()
    run = recording("table_angle_deg")
    ends = np.isin(np.arange(len(run)), [0, 1, len(run) - 1])
    assert np.array_equal(motion.rows_without_rate(run), ends)
    uneven, even = slice(58, 75), slice(100, 110)  # 7 to -25 deg/s, and -25 deg/s all along
    gapped = run.replace(table=run.table.drop(index=[*range(uneven.start, uneven.stop), *range(even.start, even.stop)]))
    after = np.isin(gapped.time_s, [run.time_s[uneven.stop]])
    assert np.array_equal(motion.rows_without_rate(gapped), np.isin(np.arange(len(gapped)), [0, 1, len(gapped) - 1]) | after)


def test_the_earth_turns_a_table_that_says_where_it_is() -> None:
    assert motion.earth_rate_deg_h(recording(*BOTH)) == 0.0
    assert motion.earth_rate_deg_h(recording(*BOTH, latitude_deg=30.0)) == pytest.approx(0.5 * 15.041067, abs=1e-6)


def test_a_recording_that_does_not_say_how_the_table_turned_is_refused() -> None:
    for read in (motion.rate_deg_s, motion.angle_deg, motion.acceleration_deg_s2):
        with pytest.raises(rlg.InputError, match="--map table_rate_deg_s"):
            read(recording())


@pytest.mark.parametrize("encoder_deg_s", [0.0, 2e-5])
def test_a_table_that_comes_to_rest_has_no_rate_of_its_last_motion(encoder_deg_s: float) -> None:
    """Its last half second of motion is no motion of the hours it stands after that."""
    rate = np.r_[np.full(40, -0.5), -0.075, np.zeros(200)]
    angle = np.random.default_rng(0).standard_normal(len(rate) + 1) * encoder_deg_s
    table = pd.DataFrame({"time_s": np.arange(len(rate)) + 1.0, "gyro_deg_s": rate, "table_rate_deg_s": rate + np.diff(angle)})
    run = rlg.Recording(table, rlg.Metadata(kind="turntable"), name="rest")
    found = motion.averaged_at_rest(run, run.column("table_rate_deg_s"))
    assert found[41:] == pytest.approx(0.0, abs=0.1 * encoder_deg_s)
    assert found[:40] == pytest.approx(-0.5, abs=1e-4)
    assert found[40] == pytest.approx(-0.075, abs=1e-4)


def test_an_encoder_at_rest_that_changes_by_its_last_digit_now_and_then_stands() -> None:
    """It is rounded, and no more than noise enough to change a digit in one sample of fifty; the last motion stays what it was."""
    rng, digit_deg = np.random.default_rng(1), 1e-3
    rate = np.r_[np.full(40, -5.0), -0.075, np.zeros(2000), 0.4, np.full(40, 5.0), 0.2, np.zeros(2000)]
    seen = digit_deg * np.round((np.cumsum(rate) + 0.2 * digit_deg * rng.standard_normal(len(rate))) / digit_deg + 0.02)
    seen_rate = np.diff(seen, prepend=seen[0] - rate[0])
    flickers = seen_rate[60:2000] != 0.0
    assert 0 < flickers.sum() < 100
    table = pd.DataFrame({"time_s": np.arange(len(rate)) + 1.0, "gyro_deg_s": rate, "table_rate_deg_s": seen_rate})
    run = rlg.Recording(table, rlg.Metadata(kind="turntable"), name="digits")
    found = motion.averaged_at_rest(run, seen_rate)
    for rest in (slice(41, 2041), slice(2083, None)):
        assert np.ptp(found[rest]) == 0.0
        assert abs(found[rest][0]) < 2.0 * digit_deg / 2000.0
    for moving in (slice(0, 41), slice(2041, 2083)):
        np.testing.assert_array_equal(found[moving], seen_rate[moving])
