"""Runs of one gyro compared with each other: copies and faults of a laboratory are noticed, healthy runs are not."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy import fft
from scipy.ndimage import uniform_filter1d
from typer.testing import CliRunner

import rlgcomp as rlg
from rlgcomp.cli import register_commands
from rlgcomp.cli.base import app
from rlgcomp.recording.comparison import compare, noise_of_means_deg_h
from rlgcomp.recording.copies import copies, shares_means
from rlgcomp.simulation.random_units import simulated_unit

PROGRAMMES = ("short", "start 20, hold 40, ramp -20 1, hold 60, ramp 45 1, hold 30", "start 0, hold 30, ramp 50 0.7, hold 60")
ALIKE = (
    "start 20, hold 30, ramp -20 1, hold 60, ramp 45 1, hold 60",
    "start 20, hold 40, ramp 45 1, hold 60, ramp -20 1, hold 60",
    "start 0, hold 30, ramp 45 1, hold 60, ramp -20 1, hold 40, ramp 10 1, hold 30",
)
Change = Callable[[pd.DataFrame], pd.DataFrame]


def codes(runs: list[rlg.Recording]) -> dict[str, set[str]]:
    """Codes of the messages, by run."""
    found: dict[str, set[str]] = {}
    for one in compare(runs):
        found.setdefault(str(one.data["run"]), set()).add(one.code.removeprefix("recording."))
    return found


@pytest.fixture(scope="module")
def healthy() -> list[rlg.Recording]:
    unit = simulated_unit(0)
    return [unit.simulate(programme, seed=seed, step_s=5.0, name=f"run{seed}") for seed, programme in enumerate(PROGRAMMES)]


def changed(run: rlg.Recording, change: Change, name: str) -> rlg.Recording:
    return rlg.Recording(change(run.table).reset_index(drop=True), run.metadata, name=name)


@pytest.mark.parametrize("seed", range(1, 9))
def test_healthy_runs_are_not_told_apart(seed: int) -> None:
    unit = simulated_unit(seed)
    runs = [unit.simulate(programme, seed=10 * seed + k, step_s=5.0, name=f"run{k}") for k, programme in enumerate(PROGRAMMES)]
    assert not compare(runs)


def _interpolated(table: pd.DataFrame, step_s: float) -> pd.DataFrame:
    time_s = np.arange(0.0, float(table["time_s"].iloc[-1]), step_s)
    return pd.DataFrame({name: np.interp(time_s, table["time_s"], table[name]) for name in table.columns}).assign(time_s=time_s)


COPIES: dict[str, Change] = {
    "another clock": lambda table: table.assign(time_s=table["time_s"] + 12345.678),
    "an offset": lambda table: table.assign(gyro_deg_h=table["gyro_deg_h"] + 3.0),
    "another unit": lambda table: table.assign(gyro_deg_h=-2.0 * table["gyro_deg_h"]),
    "cut out": lambda table: table.iloc[300:1300],
    "thinned out": lambda table: table.iloc[2::5],
    "lost rows": lambda table: table.drop(index=range(50, 2000, 97)),
    "interpolated": lambda table: _interpolated(table, 6.0),
    "averaged": lambda table: table.iloc[: len(table) // 4 * 4].groupby(np.arange(len(table) // 4 * 4) // 4).mean(),
}


@pytest.mark.parametrize("change", COPIES.values(), ids=COPIES)
def test_a_copy_is_noticed_whatever_its_clock_offset_or_period(healthy: list[rlg.Recording], change: Change) -> None:
    runs = [*healthy, changed(healthy[1], change, "copy")]
    (shared,) = [one for one in compare(runs) if one.code == "recording.shared_noise"]
    assert {shared.data["run"], shared.data["other"]} == {"copy", "run1"}


def test_each_run_is_transformed_once_where_runs_are_as_long(monkeypatch: pytest.MonkeyPatch) -> None:
    noise, lengths = np.random.default_rng(0).normal(size=(5, 2000)), []
    tables = [pd.DataFrame({"time_s": np.arange(2000.0), "gyro_deg_h": one}) for one in noise]
    runs = [rlg.recording(table, name=str(k)) for k, table in enumerate(tables)]
    rfft = fft.rfft
    monkeypatch.setattr(fft, "rfft", lambda steps, size: lengths.append(len(steps)) or rfft(steps, size))
    assert not copies(runs, {k: run.rate_deg_h() for k, run in enumerate(runs)})
    assert lengths == [1999] * 5


def test_a_run_with_half_of_another_spliced_in_is_noticed(healthy: list[rlg.Recording]) -> None:
    rate, other = (run.column("gyro_deg_h") for run in healthy[:2])
    half = min(len(rate), len(other)) // 2
    spliced = np.r_[rate[:half], other[half : half * 2], rate[half * 2 :]]
    assert (
        "shared_noise"
        in codes([changed(healthy[0], lambda table: table.assign(gyro_deg_h=spliced), "spliced"), *healthy[1:]])["run1"]
    )


def _fahrenheit(table: pd.DataFrame) -> pd.DataFrame:
    return table.assign(**{name: 1.8 * table[name] + 32.0 for name in table.columns if name.endswith("_degC")})


def _held(table: pd.DataFrame) -> pd.DataFrame:
    return table.assign(gyro_deg_h=table["gyro_deg_h"].to_numpy()[np.arange(len(table)) // 3 * 3])


def _noise(table: pd.DataFrame) -> np.ndarray:
    scale = np.diff(table["gyro_deg_h"]).std() / np.sqrt(2.0)
    return np.random.default_rng(3).normal(0.0, scale, len(table))


def _reversed(table: pd.DataFrame) -> pd.DataFrame:
    return table.assign(gyro_deg_h=-table["gyro_deg_h"])


FAULTS: dict[str, tuple[Change, set[str]]] = {
    "degF": (_fahrenheit, {"other_noise"}),
    "light in mV": (lambda table: table.assign(light_intensity_V=1e3 * table["light_intensity_V"]), {"other_noise"}),
    "smoothed": (lambda table: table.assign(gyro_deg_h=uniform_filter1d(table["gyro_deg_h"].to_numpy(), 60)), {"other_noise"}),
    "minutes": (lambda table: table.assign(time_s=table["time_s"] / 60.0), {"other_clock"}),
    "milliseconds": (lambda table: table.assign(time_s=table["time_s"] * 1e3), {"other_clock"}),
    "deg/s": (lambda table: table.assign(gyro_deg_h=table["gyro_deg_h"] / 3600.0), {"other_noise"}),
    "held": (
        lambda table: table.assign(gyro_deg_h=table["gyro_deg_h"].to_numpy()[np.arange(len(table)) // 3 * 3]),
        {"other_noise"},
    ),
    "thermometers exchanged": (
        lambda table: table.rename(
            columns={
                "temperature_block_degC": "temperature_shell_degC",
                "temperature_shell_degC": "temperature_block_degC",
            }
        ),
        {"exchanged_thermometers"},
    ),
    "a thermometer written twice": (
        lambda table: table.assign(temperature_shell_degC=table["temperature_block_degC"]),
        {"equal_columns"},
    ),
    "zeros": (
        lambda table: table.assign(gyro_deg_h=table["gyro_deg_h"].where(np.arange(len(table)) % 100 > 0, 0.0)),
        {"frequent_value"},
    ),
    "samples held": (
        lambda table: table.assign(gyro_deg_h=table["gyro_deg_h"].where(np.arange(len(table)) % 10 > 0).ffill().bfill()),
        {"held_samples"},
    ),
    "coarse": (
        lambda table: table.assign(gyro_deg_h=(table["gyro_deg_h"] / 0.05).round() * 0.05),
        {"coarse_digit"},
    ),
    "light with another sign": (
        lambda table: table.assign(light_intensity_V=-table["light_intensity_V"]),
        {"other_level"},
    ),
    "thermometer in degF": (
        lambda table: table.assign(temperature_shell_degC=1.8 * table["temperature_shell_degC"] + 32.0),
        {"other_noise"},
    ),
    "a clock 1 % fast": (lambda table: table.assign(time_s=table["time_s"] / 1.01), {"other_period"}),
    "noise twice as large in one half": (
        lambda table: table.assign(gyro_deg_h=table["gyro_deg_h"] + 1.7 * _noise(table) * (np.arange(len(table)) > len(table) / 2)),
        {"changing_noise"},
    ),
    "a thermometer without its sign": (
        lambda table: table.assign(temperature_shell_degC=table["temperature_shell_degC"].abs()),
        {"other_course"},
    ),
}


@pytest.mark.parametrize(("change", "expected"), FAULTS.values(), ids=FAULTS)
def test_a_fault_of_one_run_is_noticed_in_that_run(healthy: list[rlg.Recording], change: Change, expected: set[str]) -> None:
    found = codes([healthy[0], changed(healthy[1], change, "faulty"), healthy[2]])
    assert expected <= found["faulty"]
    assert set(found) == {"faulty"}


def test_a_last_digit_that_hides_all_noise_tells_no_other_noise(healthy: list[rlg.Recording]) -> None:
    """What is left of the noise is that of the moments at which the digit changes, a different number of them in each run."""
    rng, runs = np.random.default_rng(0), []
    for run, slope, sd in zip(healthy, (0.002, 0.0002, 0.002), (0.02, 0.0, 0.02), strict=True):

        def humid(table: pd.DataFrame, slope: float = slope, sd: float = sd) -> pd.DataFrame:
            humidity = 40.0 + slope * np.arange(len(table)) + rng.normal(0.0, sd, len(table))
            return table.assign(humidity_percent=humidity.round(1))

        runs.append(changed(run, humid, run.name))
    assert not compare(runs)
    coarser = changed(runs[1], lambda table: table.assign(humidity_percent=1.8 * table["humidity_percent"]), "scaled")
    assert codes([runs[0], coarser, runs[2]])["scaled"]


def moving(slow: float, seed: int, *, digit: float = 0.0, noise: float = 0.01) -> rlg.Recording:
    """A short run whose temperature and gyro move as fast as several samples resolve, the gyro behind lags."""
    rng, k = np.random.default_rng(seed), np.arange(450)
    temperature = sum(np.sin(2.0 * np.pi * k / (slow * period) + rng.uniform(0.0, 6.28)) for period in (14.0, 25.0, 60.0))
    temperature = 20.0 + temperature * 3.0 / slow**0.5 + noise * rng.standard_normal(450)
    gyro = 2.0 * np.sin(2.0 * np.pi * k / (14.0 * slow)) + rng.standard_normal(450)
    temperature = np.round(temperature / digit) * digit if digit else temperature
    table = {"time_s": 7.0 * k, "temperature_block_degC": temperature, "gyro_deg_h": gyro}
    return rlg.Recording(pd.DataFrame(table), name=f"run{seed}")


def test_a_faster_course_is_no_other_noise_or_spectrum() -> None:
    assert not compare([moving(1.0, 0), *(moving(3.0, seed) for seed in range(1, 5))])
    assert codes([*(moving(1.0, seed) for seed in range(4)), moving(1.0, 4, noise=0.02)]) == {"run4": {"other_noise"}}


def test_the_same_last_digit_in_a_run_that_repeats_more_of_its_values_is_no_coarser_one() -> None:
    slow = [moving(1.0, seed, digit=0.05) for seed in range(3)]
    resting = moving(4.0, 3, digit=0.05)
    distinct = [len(np.unique(run.column("temperature_block_degC"))) / len(run) for run in (*slow, resting)]
    assert min(distinct[:3]) > 0.5 > distinct[3]
    assert not compare([*slow, resting])


def test_thermometers_that_rest_are_compared(healthy: list[rlg.Recording]) -> None:
    """Also where their only value is next to zero, by which nothing can be divided."""
    for value in (20.0, 0.0, 1e-320):
        compare([changed(run, lambda table, value=value: table.assign(temperature_shell_degC=value), run.name) for run in healthy])


@pytest.mark.parametrize("late", [80, -80])
@pytest.mark.parametrize("which", [1, 2])
def test_monitors_that_are_late_in_one_run_are_noticed(which: int, late: int) -> None:
    unit = rlg.Simulator.from_mapping(
        {
            "mechanisms": [
                {"thermal_polynomial": {"degree": 2, "c1_deg_h_K": 0.004, "c2_deg_h_K2": 0.00002}},
                {"temperature_rate": {"k_deg_h_min_K": 0.02}},
            ],
            "noise": {"angle_random_walk_deg_sqrt_h": 0.0003},
        }
    )
    runs = [unit.simulate(programme, seed=seed, step_s=5.0, name=f"run{seed}") for seed, programme in enumerate(ALIKE)]
    assert not compare(runs)

    def delayed(table: pd.DataFrame) -> pd.DataFrame:
        monitors = [name for name in table.columns if name not in ("time_s", "gyro_deg_h")]
        return table.assign(**{name: table[name].shift(late).ffill().bfill() for name in monitors})

    runs[which] = changed(runs[which], delayed, "late")
    (found,) = compare(runs)
    assert (found.code, found.data["run"]) == ("recording.other_delay", "late")
    assert found.data["delay_s"] == pytest.approx(5.0 * late, rel=0.25)


def test_a_reversed_gyro_is_noticed() -> None:
    unit = rlg.Simulator.from_mapping(
        {"mechanisms": [{"thermal_polynomial": {"degree": 2}}], "noise": {"angle_random_walk_deg_sqrt_h": 0.0003}}
    )
    rng = np.random.default_rng(0)
    runs = []
    for seed, programme in enumerate(PROGRAMMES):
        run = unit.simulate(programme, seed=seed, step_s=5.0, name=f"run{seed}")
        T = run.column("temperature_block_degC")
        runs.append(
            changed(run, lambda table, T=T: table.assign(gyro_deg_h=0.01 * T + rng.normal(0.0, 0.02, len(T))), f"run{seed}")
        )
    assert not compare(runs)
    runs[1] = changed(runs[1], _reversed, "reversed")
    assert codes(runs) == {"reversed": {"other_response"}}
    earth = [changed(run, lambda table: table.assign(gyro_deg_h=rng.normal(9.0, 0.02, len(table))), run.name) for run in runs]
    earth[2] = changed(earth[2], _reversed, "run2")
    assert codes(earth) == {"run2": {"other_sign"}}
    for two, code in ((runs[:2], "recording.other_response"), (earth[1:], "recording.other_sign")):
        (found,) = compare(two)  # of two, none tells which is wrong
        assert (found.code, {found.data["run"], found.data["other"]}) == (code, {run.name for run in two})
        assert "one of the two" in found.text
        assert "gyro_deg_h: 'COLUMN [-deg/h]'" in found.text


@pytest.mark.parametrize(("factor", "offset_deg_h"), [(-1.0, 0.0), (1.0 / 3600.0, 0.0), (1.0, 4.0)])
def test_a_sign_or_unit_is_no_offset_since_training(factor: float, offset_deg_h: float) -> None:
    """Of a run evaluated by itself: what differs from the training runs is named, and a true offset stays one."""

    def recording(seed: int) -> rlg.Recording:
        rng, time_s = np.random.default_rng(seed), np.arange(0.0, 4.0 * 3600.0, 2.0)
        temperature = 25.0 + 20.0 * np.sin(time_s / 2500.0 + seed)
        rate = 11.0 + 1e-2 * temperature + 0.02 * rng.standard_normal(len(time_s))
        table = {"time_s": time_s, "gyro_deg_h": rate, "temperature_block_degC": temperature}
        return rlg.Recording(pd.DataFrame(table), name=f"run{seed}")

    compensator = rlg.Compensator(rlg.CubicLeastSquares(), features="temperature").fit([recording(0), recording(1)])
    new = changed(recording(2), lambda table: table.assign(gyro_deg_h=factor * table["gyro_deg_h"] + offset_deg_h), "new")
    found = [one.code for one in rlg.evaluate(compensator, [new], compare=False).remarks]
    assert ("recording.other_response" in found) is (factor != 1.0)
    assert ("evaluation.offset" in found) is (factor == 1.0)


def test_two_courses_of_a_chamber_are_no_copies() -> None:
    """A thermometer that was mapped as the gyro: its ramps are alike in both runs, its noise is not."""

    def thermometer(seed: int) -> rlg.Recording:
        time_s = np.arange(0.0, 16_000.0, 2.0)
        course = np.interp(time_s, [0.0, 2000.0, 6000.0, 9000.0, 13_000.0, 16_000.0], [25.0, 25.0, -30.0 + seed, -30.0, 20.0, 20.0])
        values = course + 0.007 * np.random.default_rng(seed).standard_normal(len(time_s))
        return rlg.Recording(pd.DataFrame({"time_s": time_s, "gyro_deg_h": values}), name=f"run{seed}")

    runs = [thermometer(0), thermometer(1)]
    assert not copies(runs, {k: run.rate_deg_h() for k, run in enumerate(runs)})


def test_a_run_that_was_trained_on_is_known_by_its_noise(healthy: list[rlg.Recording]) -> None:
    compensator = rlg.Compensator(rlg.CubicLeastSquares(), features="temperature").fit(healthy[:2])
    shifted = changed(healthy[1], lambda table: table.iloc[7:].assign(time_s=table["time_s"].iloc[7:] + 4321.0), "shifted")
    evaluation = rlg.evaluate(compensator, [shifted, healthy[2]], compare=False)
    assert [run.trained_on for run in evaluation.runs] == [True, False]


def test_parts_of_one_recording_are_no_copies(healthy: list[rlg.Recording]) -> None:
    """What leads in to a part, so that filters and hysteresis are in their state, is the other part and none of its own."""
    middle, end = 0.5 * healthy[0].time_s[-1], healthy[0].time_s[-1] + 1.0
    first, second = (healthy[0].between(a, b, keep_history=True, name=f"part {a:g}") for a, b in ((0.0, middle), (middle, end)))
    assert second.metadata.lead_in_s > 0.0
    assert not copies([first, second], {0: first.rate_deg_h(), 1: second.rate_deg_h()})
    compensator = rlg.Compensator(rlg.CubicLeastSquares(), features="temperature").fit([first])
    assert not rlg.evaluate(compensator, [second], compare=False).runs[0].trained_on


def test_means_are_compared_at_every_place_of_a_window() -> None:
    rng = np.random.default_rng(0)
    rate = rng.normal(size=40_000) + 0.1 * np.sin(np.arange(40_000) / 5000.0)
    means = rate[37 : 37 + 39_900].reshape(-1, 100).mean(axis=1)
    time_s, means_time_s = np.arange(40_000.0), 100.0 * np.arange(len(means))
    assert shares_means(rate, time_s, means, means_time_s, 100.0)
    assert not shares_means(rng.normal(size=40_000), time_s, means, means_time_s, 100.0)
    assert noise_of_means_deg_h(rate, 1.0, 100.0) == pytest.approx(0.1, rel=0.1)


@pytest.mark.parametrize(("hours", "lost"), [(1.5, 0), (4.0, 1300)], ids=["short", "with a gap"])
def test_a_copy_at_another_sample_period_is_known_by_its_noise(hours: float, lost: int) -> None:
    """Means over 2 s of a run at 1 s, by another clock; a run of its own that is as short, or as broken, is none."""

    def recording(seed: int) -> pd.DataFrame:
        rng, time_s = np.random.default_rng(seed), np.arange(hours * 3600.0)
        temperature = 25.0 + 10.0 * np.sin(time_s / 1500.0 + seed)
        rate = 11.0 + 1e-3 * temperature + 0.018 * rng.standard_normal(len(time_s))
        return pd.DataFrame({"time_s": time_s, "gyro_deg_h": rate, "temperature_block_degC": temperature})

    def halved(table: pd.DataFrame, name: str) -> rlg.Recording:
        means = table.groupby(np.arange(len(table)) // 2).mean().assign(time_s=lambda means: means["time_s"] + 86400.37)
        half = len(means) // 2
        return rlg.Recording(means.drop(index=means.index[half : half + lost // 2]), name=name)

    one, other, third = map(recording, range(3))
    training = [rlg.Recording(one, name="one"), rlg.Recording(other, name="other")]
    compensator = rlg.Compensator(rlg.CubicLeastSquares(), features="temperature").fit(training)
    evaluation = rlg.evaluate(compensator, [halved(one, "copy"), halved(third, "new")], compare=False)
    assert [run.trained_on for run in evaluation.runs] == [True, False]


def test_an_error_below_the_noise_is_doubted(healthy: list[rlg.Recording]) -> None:
    """A copy has another clock and a small offset: with one left out the other knows its noise."""
    copy = changed(
        healthy[0], lambda table: table.assign(time_s=table["time_s"] + 12345.678, gyro_deg_h=table["gyro_deg_h"] + 1e-9), "copy"
    )
    compensator = rlg.Compensator(rlg.LSSVMRegressor(), averaging_s=20.0).fit([healthy[0], copy])
    assert "compensation.below_noise" in {one.code for one in compensator.remarks_}
    assert "compensation.below_noise" not in {
        one.code for one in rlg.Compensator(rlg.CubicLeastSquares()).fit(healthy[:2]).remarks_
    }


def test_commands_say_what_differs_before_they_go_on(healthy: list[rlg.Recording], tmp_path: Path) -> None:
    register_commands()
    runs = [healthy[0], changed(healthy[1], FAULTS["light in mV"][0], "faulty")]
    for run in runs:
        rlg.write(run, tmp_path / f"{run.name}.parquet")
    paths = [str(tmp_path / f"{run.name}.parquet") for run in runs]
    for arguments in (["inspect", *paths], ["train", *paths, "--model", "cubic", "--out", str(tmp_path / "model")]):
        result = CliRunner().invoke(app, arguments)
        assert result.exit_code == 0
        assert "light_intensity_V: its noise from sample to sample" in result.output


@pytest.mark.parametrize("encoder", [False, True])
def test_a_table_that_turns_is_no_chamber(encoder: bool) -> None:
    rng = np.random.default_rng(0)
    time_s = np.arange(4000.0)
    rate = np.repeat(rng.choice([-10.0, -5.0, 0.0, 5.0, 10.0], 40), 100) * 3600.0
    runs = [
        rlg.Recording(
            pd.DataFrame(
                {"time_s": time_s, "gyro_deg_h": rate + rng.normal(size=4000), "temperature_block_degC": 20.0 + 1e-3 * time_s + k}
            ),
            name=f"run{k}",
        )
        for k in range(2)
    ]
    if encoder:
        angle = {"table_angle_deg": np.cumsum(rate) / 3600.0, "table_rate_deg_s": rate / 3600.0}
        runs = [rlg.Recording(run.table.assign(**angle), rlg.Metadata("turntable"), name=run.name) for run in runs]
    compensator = rlg.Compensator(rlg.CubicLeastSquares(), features="temperature").fit(runs)
    assert "compensation.turning" in {one.code for one in compensator.remarks_}


def test_the_rounding_of_pulses_is_no_white_noise() -> None:
    """What rounding adds to one window it takes from the next: the noise of means is not that of halves of windows by √2."""
    rng = np.random.default_rng(0)
    rate, pulse = 9.3 + rng.normal(0.0, 0.05, 40_000), 0.84
    counted = pulse * np.diff(np.floor(np.cumsum(rate) / pulse), prepend=0.0)
    truth = float(np.std(counted[100:].reshape(-1, 100).mean(axis=1) - 9.3))
    assert 0.7 * truth < noise_of_means_deg_h(counted, 1.0, 100.0, pulse) < truth
    assert noise_of_means_deg_h(counted, 1.0, 100.0) > truth


def test_a_table_that_turns_steadily_is_no_chamber(short_runs: list[rlg.Recording], caplog: pytest.LogCaptureFixture) -> None:
    turned = [run.replace(table=run.table.assign(gyro_deg_h=run.rate_deg_h() + 60.0 * 3600.0)) for run in short_runs[:2]]
    compensator = rlg.Compensator(rlg.CubicLeastSquares(), features="temperature").fit(turned)
    (remark,) = [one for one in compensator.remarks_ if one.code == "compensation.turning_steadily"]
    assert remark.data["mean_deg_h"] == pytest.approx(216e3, rel=1e-3)
    assert "may hold Earth rate" not in caplog.text
