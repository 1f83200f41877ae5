"""Numbers for other tools, each against the tool's documented meaning by a worked number."""

from __future__ import annotations

import dataclasses
import math
import re
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import yaml
from typer.testing import CliRunner

import rlgcomp as rlg
from rlgcomp.cli import register_commands
from rlgcomp.cli.base import app
from rlgcomp.export.autopilot import ARDUPILOT_REFERENCE_DEGC, TriadCubic, ardupilot, px4
from rlgcomp.export.noise_parameters import kalibr, matlab
from rlgcomp.noise.analysis import NoiseAnalysis

register_commands()
PERIOD_S = 0.01
DEG_H = math.pi / 180.0 / 3600.0  # in rad/s


@pytest.fixture(scope="module")
def resting() -> rlg.Recording:
    """Three gyros with white noise of 0.66 deg/√h, as the ADIS16448 states; the second twice, the third half as noisy."""
    white = np.random.default_rng(1).normal(size=(3, 120_000))
    sd_deg_s = 0.66 / 60.0 / math.sqrt(PERIOD_S)
    rates = {f"gyro_{axis}_deg_s": size * sd_deg_s * row for axis, size, row in zip("xyz", (1.0, 2.0, 0.5), white, strict=True)}
    return rlg.recording({"time_s": PERIOD_S * np.arange(white.shape[1]), **rates}, metadata={"kind": "static"}, name="rest")


@pytest.fixture(scope="module")
def analyses(resting: rlg.Recording) -> list[NoiseAnalysis]:
    return [rlg.analyse_noise(resting, column) for column in resting.gyro_columns]


def test_an_angle_random_walk_in_other_units(analyses: list[NoiseAnalysis]) -> None:
    """0.66 deg/√h are 0.011 deg/s/√Hz and 1.92e-4 rad/s/√Hz, which is rad/√s."""
    noise = dataclasses.replace(analyses[0].coefficients, angle_random_walk_deg_sqrt_h=0.66, angle_random_walk_deg_sqrt_h_sd=0.06)
    found = noise.angle_random_walk_in_units()
    assert found["deg/sqrt(h)"] == (0.66, 0.06)
    assert found["deg/s/sqrt(Hz)"] == pytest.approx((0.011, 0.001))
    assert found["rad/s/sqrt(Hz)"] == found["rad/sqrt(s)"] == pytest.approx((1.9199e-4, 1.7453e-5), rel=1e-4)
    rows = {row["unit"]: (row["value"], row["sd"]) for row in noise.to_mapping()["angle_random_walk"]}
    assert rows == found


def test_kalibr_reads_the_density_of_the_noisiest_gyro(resting: rlg.Recording, analyses: list[NoiseAnalysis]) -> None:
    """Kalibr: the standard deviation of a sample is gyroscope_noise_density / sqrt(dt)."""
    read = yaml.safe_load(kalibr(analyses))
    assert read["update_rate"] == 100.0
    sample_sd_rad_s = np.deg2rad(resting["gyro_y_deg_s"]).std()
    assert read["gyroscope_noise_density"] / math.sqrt(PERIOD_S) == pytest.approx(sample_sd_rad_s, rel=0.02)
    assert read["gyroscope_noise_density"] == pytest.approx(2 * 1.9199e-4, rel=0.02)
    assert not any(key.startswith("accelerometer") for key in read)


def test_kalibr_reads_the_walk_of_the_bias(analyses: list[NoiseAnalysis]) -> None:
    """Kalibr: the bias changes by gyroscope_random_walk sqrt(dt) a sample: after an hour by K of one hour, here 3 deg/h."""
    strong = dataclasses.replace(analyses[0].coefficients, rate_random_walk_deg_h_sqrt_h=3.0, rate_random_walk_deg_h_sqrt_h_sd=0.1)
    read = yaml.safe_load(kalibr([dataclasses.replace(analyses[0], coefficients=strong)]))
    assert read["gyroscope_random_walk"] * math.sqrt(3600.0) == pytest.approx(3.0 * DEG_H, rel=1e-5)


def test_what_was_not_detected_is_an_upper_limit_and_says_so(analyses: list[NoiseAnalysis]) -> None:
    weak = dataclasses.replace(analyses[0].coefficients, rate_random_walk_deg_h_sqrt_h=0.0, rate_random_walk_deg_h_sqrt_h_sd=1.0)
    text = kalibr([dataclasses.replace(analyses[0], coefficients=weak)])
    assert "rate random walk not detected, its 95 % upper limit" in text
    assert yaml.safe_load(text)["gyroscope_random_walk"] > 0.0


def test_matlab_reads_three_gyros(analyses: list[NoiseAnalysis]) -> None:
    """MATLAB, single-sided: the standard deviation of a sample is NoiseDensity * sqrt(SampleRate)."""
    text = matlab(analyses)
    values = {
        name: [float(number) for number in numbers.split()]
        for name, numbers in re.findall(r"'(NoiseDensity|BiasInstability|RandomWalk)', \[(.*?)\]", text)
    }
    assert values["NoiseDensity"] == pytest.approx([1.9199e-4, 3.8397e-4, 0.95993e-4], rel=0.03)
    assert set(values) == {"NoiseDensity", "BiasInstability", "RandomWalk"}
    assert "'NoiseType', 'single-sided'" in text
    known = dataclasses.replace(
        analyses[0].coefficients, bias_instability_deg_h=36.0, bias_instability_deg_h_sd=1.0,
        rate_random_walk_deg_h_sqrt_h=60.0, rate_random_walk_deg_h_sqrt_h_sd=1.0,
    )  # fmt: skip
    one = matlab([dataclasses.replace(analyses[0], coefficients=known)])
    assert f"'BiasInstability', [{36.0 * DEG_H:.6e}]" in one
    assert f"'RandomWalk', [{DEG_H:.6e}]" in one  # 60 deg/h/√h are 1 deg/h/√s
    with pytest.raises(rlg.InputError, match="one gyro or three, and these are 2"):
        matlab(analyses[:2])


def chamber(axis: str, seed: int, **options: float) -> rlg.Recording:
    """One gyro of a triad whose bias is a known cubic in temperature."""
    time = 10.0 * np.arange(1500)
    temperature = 20.0 + 35.0 * np.sin(2 * np.pi * time / 9000.0)
    bias = 2.0 + 0.05 * temperature - 1e-3 * temperature**2 + options.get("cubic", 2e-5) * temperature**3
    rate = bias + 0.01 * np.random.default_rng(seed).normal(size=len(time))
    table = pd.DataFrame({"time_s": time, f"gyro_{axis}_deg_h": rate, "temperature_block_degC": temperature})
    return rlg.Recording(table, name=f"{axis}{seed}")


@pytest.fixture(scope="module")
def models() -> list[rlg.Compensator]:
    return [
        rlg.Compensator(rlg.CubicLeastSquares(), features=["temperature"]).fit([chamber(axis, seed, cubic=c) for seed in (1, 2)])
        for axis, c in (("y", 2e-5), ("z", -1e-5), ("x", 0.0))
    ]


def biases(models: list[rlg.Compensator], temperatures: np.ndarray) -> np.ndarray:
    """What the compensations subtract, in rad/s, gyros x, y, z by columns."""
    in_order = sorted(models, key=lambda model: model.gyro_)
    return DEG_H * np.column_stack([model.predict_rows(temperatures[:, None]) for model in in_order])


def test_px4_subtracts_what_the_compensation_does(models: list[rlg.Compensator]) -> None:
    """PX4: offset = x0 + x1 d + x2 d² + x3 d³ in rad/s, d = T - TREF with T clipped to TMIN and TMAX; corrected = raw - offset."""
    rows = [line.split("\t") for line in px4(TriadCubic.of(models), 1).splitlines() if not line.startswith("#")]
    parameters = {name: float(value) for _, _, name, value, _ in rows}
    assert {row[2]: row[4] for row in rows}["TC_G_ENABLE"] == "6"
    low, high, reference = (parameters[f"TC_G1_{name}"] for name in ("TMIN", "TMAX", "TREF"))
    temperatures = np.array([-40.0, -10.0, 0.0, 25.0, 50.0, 90.0])
    difference = np.clip(temperatures, low, high) - reference
    for k in range(3):
        x0, x1, x2, x3 = (parameters[f"TC_G1_X{power}_{k}"] for power in range(4))
        offset = x0 + x1 * difference + x2 * difference**2 + x3 * difference**3
        assert offset == pytest.approx(biases(models, temperatures)[:, k], rel=1e-6)
    assert parameters["TC_G1_X0_0"] + 0.0 == pytest.approx(
        DEG_H * (2.0 + 0.05 * 20.0 - 1e-3 * 400.0), rel=0.01
    )  # gyro x at 20 degC


def test_ardupilot_subtracts_the_difference_from_its_own_calibration(models: list[rlg.Compensator]) -> None:
    """ArduPilot: v -= P(T) - P(calibration), P = 1e-6 (c1 + (c2 + c3 d) d) d, d = T - 35 degC, T clipped to TMIN and TMAX."""
    lines = [line.split(",") for line in ardupilot(TriadCubic.of(models), 0).splitlines() if not line.startswith("#")]
    parameters = {name: float(value) for name, value in lines}
    assert parameters["INS_TCAL1_ENABLE"] == 1.0
    temperatures = np.array([-40.0, -10.0, 0.0, 25.0, 50.0, 90.0])
    clipped = np.clip(temperatures, parameters["INS_TCAL1_TMIN"], parameters["INS_TCAL1_TMAX"])
    difference = clipped - ARDUPILOT_REFERENCE_DEGC
    for k, axis in enumerate("XYZ"):
        c1, c2, c3 = (parameters[f"INS_TCAL1_GYR{power}_{axis}"] for power in (1, 2, 3))
        correction = 1e-6 * (c1 + (c2 + c3 * difference) * difference) * difference
        expected = biases(models, temperatures)[:, k]
        assert correction - correction[3] == pytest.approx(expected - expected[3], rel=1e-6, abs=1e-13)


@pytest.mark.parametrize(
    ("models_of", "message"),
    [
        (lambda models: models[:2], "2 models; .* takes three"),
        (lambda models: [models[0], models[0], models[1]], "give one of each of the gyros"),
        (
            lambda models: [
                *models[:2],
                rlg.Compensator(rlg.LSSVMRegressor(), features=["temperature"]).fit([chamber("x", 1), chamber("x", 2)]),
            ],
            "a LSSVMRegressor on temperature_block_degC; .* train with --model cubic",
        ),
    ],
)
def test_what_an_autopilot_cannot_hold_is_refused(models_of: object, message: str, models: list[rlg.Compensator]) -> None:
    with pytest.raises(rlg.InputError, match=message):
        TriadCubic.of(models_of(models))


@pytest.mark.usefixtures("undrawn")
def test_the_commands_write_the_files(resting: rlg.Recording, models: list[rlg.Compensator], tmp_path: Path) -> None:
    rlg.write(resting, tmp_path / "rest.parquet")
    runner = CliRunner()
    run, noise = str(tmp_path / "rest.parquet"), str(tmp_path / "noise")
    done = runner.invoke(app, ["allan", run, "--to", "kalibr", "--to", "matlab", "--out", noise])
    assert done.exit_code == 0, done.output
    assert "rad/s/√Hz" in done.output
    assert {path.name for path in Path(noise).iterdir()} >= {"imu.yaml", "gyroparams.m", "allan.png"}
    for arguments, words in (
        (["--to", "kalibr"], "give its folder with --out"),
        (["--to", "x", "--out", noise], "known are kalibr"),
    ):
        refused = runner.invoke(app, ["allan", run, *arguments])
        assert refused.exit_code == 2
        assert words in " ".join(refused.output.split())
    folders = []
    for model in models:
        folders.append(str(tmp_path / model.gyro_))
        model.save(folders[-1])
    for target, file, code in (
        ("px4", "px4.params", "export.px4_device"),
        ("ardupilot", "ardupilot.param", "export.ardupilot_constant"),
    ):
        done = runner.invoke(app, ["export", *folders, "--to", target, "--out", str(tmp_path / target), "--json"])
        assert done.exit_code == 0, done.output
        assert code in done.output
        assert (tmp_path / target / file).read_text().count("gyro_x_deg_h") == 1
