"""Messages of export."""

from __future__ import annotations

from typing import Final


def ardupilot_constant(bias_rad_s: dict[str, float]) -> str:
    constants = ", ".join(f"{value:.4g} rad/s of {gyro}" for gyro, value in bias_rad_s.items())
    return f"ArduPilot takes the constant from its own gyro calibration, so the bias at 35 degC is not in the file: {constants}."


def smallest_within_1_percent(centres: int) -> str:
    return f"The smallest model within 1 % of the best on the curve has {centres} centre{'' if centres == 1 else 's'}."


TEXTS: Final = {
    "toolchain_not_requested": "{toolchain}: skipped, as requested",
    "toolchain_missing": "{toolchain}: skipped, {program} is not installed",
    "toolchain_broken": "{toolchain}: installed, but a trivial program cannot be built and run: {reason}",
    "not_compiled": "The code was not compiled: no working C compiler was found. It is unverified on this machine.",
    "not_compared": 'not compared with Python: onnxruntime is not installed; pip install "rlgcomp[onnx]"',
    "autopilot_range": "The cubics hold from {low_degC:.4g} to {high_degC:.4g} degC; beyond, the autopilot "
    "takes the value at the end. Its own thermometer must read as these did.",
    "px4_device": "Set {parameter} to the gyro's device ID (CAL_GYROn_ID): without it PX4 applies nothing.",
}
