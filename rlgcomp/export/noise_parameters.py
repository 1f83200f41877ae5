r"""Noise of gyros as other tools read it: `imu.yaml` of Kalibr and `gyroparams` of MATLAB.

Angle random walk N and rate random walk K are densities of continuous white noises: of the rate, and of the derivative of the bias.
Samples at intervals :math:`\Delta t` have the standard deviation :math:`N / \sqrt{\Delta t}`, and the bias changes from one to
the next by :math:`K \sqrt{\Delta t}`. Kalibr calls them `gyroscope_noise_density` in rad/s/√Hz and `gyroscope_random_walk` in
rad/s²/√Hz, MATLAB `NoiseDensity` in (rad/s)/√Hz and `RandomWalk` in (rad/s)·√Hz; its `BiasInstability` in rad/s is B, whose Allan
deviation is :math:`B \sqrt{2 \ln 2 / \pi}`. A coefficient that was not detected is given as its 95 % upper limit, and a comment
says so.

References
----------
Kalibr, wiki pages "IMU Noise Model" and "yaml formats", github.com/ethz-asl/kalibr.
MathWorks, gyroparams and imuSensor (Sensor Fusion and Tracking Toolbox). With `NoiseType` "single-sided" the standard deviation of
a sample is `NoiseDensity * sqrt(SampleRate)`; with "double-sided", the default, it is smaller by the root of two.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from typing import Final

import rlgcomp
from rlgcomp.errors import InputError
from rlgcomp.noise.analysis import NoiseAnalysis
from rlgcomp.noise.processes import upper_limit
from rlgcomp.units import RAD_PER_DEG, SECONDS_PER_HOUR, convert

_TO_RAD: Final = {
    "angle_random_walk_deg_sqrt_h": RAD_PER_DEG / 60.0,  # deg/√h to rad/s/√Hz
    "rate_random_walk_deg_h_sqrt_h": RAD_PER_DEG / SECONDS_PER_HOUR / 60.0,  # deg/h/√h to rad/s/√s
    "bias_instability_deg_h": float(convert(1.0, "deg/h", "rad/s")),
}
_WORDS: Final = {
    "angle_random_walk_deg_sqrt_h": "angle random walk",
    "rate_random_walk_deg_h_sqrt_h": "rate random walk",
    "bias_instability_deg_h": "bias instability",
}


@dataclasses.dataclass(frozen=True)
class _Stated:
    """A coefficient in units of rad and s, and the comment where it is a limit."""

    value: float
    comment: str


def kalibr(analyses: Sequence[NoiseAnalysis]) -> str:
    """The text of `imu.yaml`: one noise for all gyros, the largest; the accelerometers' lines are left to the user."""
    noise, walk = (
        max((_stated(analysis, name) for analysis in analyses), key=lambda stated: stated.value)
        for name in ("angle_random_walk_deg_sqrt_h", "rate_random_walk_deg_h_sqrt_h")
    )
    gyros = ", ".join(analysis.gyro for analysis in analyses)
    return f"""# Gyro noise for Kalibr, by rlgcomp {rlgcomp.__version__} from {gyros}{": the largest" if len(analyses) > 1 else ""}
gyroscope_noise_density: {noise.value:.6e}  # rad/s/sqrt(Hz), continuous time{noise.comment}
gyroscope_random_walk: {walk.value:.6e}  # rad/s^2/sqrt(Hz){walk.comment}
update_rate: {1.0 / analyses[0].deviation.period_s:.9g}  # Hz
# Kalibr also needs these, which a gyro's recording does not give:
# accelerometer_noise_density:  # m/s^2/sqrt(Hz)
# accelerometer_random_walk:  # m/s^3/sqrt(Hz)
# rostopic: /imu0
"""


def matlab(analyses: Sequence[NoiseAnalysis]) -> str:
    """The text of `gyroparams.m`, which makes `params` for one gyro or three.

    Raises
    ------
    InputError
        There are neither one nor three gyros.
    """
    if len(analyses) not in (1, 3):
        found = ", ".join(analysis.gyro for analysis in analyses)
        raise InputError(f"MATLAB's gyroparams takes one gyro or three, and these are {len(analyses)}: {found}; choose with --gyro")
    lines = []
    for name, property_name, unit in (
        ("angle_random_walk_deg_sqrt_h", "NoiseDensity", "(rad/s)/sqrt(Hz)"),
        ("bias_instability_deg_h", "BiasInstability", "rad/s"),
        ("rate_random_walk_deg_h_sqrt_h", "RandomWalk", "(rad/s)*sqrt(Hz)"),
    ):
        stated = [_stated(analysis, name) for analysis in analyses]
        numbers = " ".join(f"{one.value:.6e}" for one in stated)
        limits = [analysis.gyro for analysis, one in zip(analyses, stated, strict=True) if one.comment]
        comment = f"; 95 % upper limit of {', '.join(limits)}" if limits else ""
        lines.append(f"    '{property_name}', [{numbers}], ...  % {unit}{comment}")
    gyros = ", ".join(analysis.gyro for analysis in analyses)
    rate_hz = 1.0 / analyses[0].deviation.period_s
    body = "\n".join(lines)
    return f"""% Gyro noise for imuSensor, by rlgcomp {rlgcomp.__version__} from {gyros}
params = gyroparams( ...
{body}
    'NoiseType', 'single-sided');  % std of a sample is NoiseDensity*sqrt(SampleRate)
% imu = imuSensor('accel-gyro', 'SampleRate', {rate_hz:.9g}, 'Gyroscope', params);
"""


# Name on the command line, the file it makes and the function of its text
TARGETS: Final[Mapping[str, tuple[str, Callable[[Sequence[NoiseAnalysis]], str]]]] = {
    "kalibr": ("imu.yaml", kalibr),
    "matlab": ("gyroparams.m", matlab),
}


def _stated(analysis: NoiseAnalysis, name: str) -> _Stated:
    value, sd = getattr(analysis.coefficients, name), getattr(analysis.coefficients, f"{name}_sd")
    limit = upper_limit(value, sd)
    comment = "" if limit is None else f"; {_WORDS[name]} not detected, its 95 % upper limit"
    return _Stated(_TO_RAD[name] * (value if limit is None else limit), comment)
