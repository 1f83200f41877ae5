"""Messages of noise: Allan deviations of gyros at rest, and the angle random walk of gyros that turn."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

from rlgcomp.report.messages.wording import estimate_text, time_text, value_or_limit

# Phrase around each coefficient with its value, by name
_INDICATED: Final = {
    "angle_random_walk_deg_sqrt_h": "angle random walk, N {} deg/√h",
    "bias_instability_deg_h": "bias instability, B {} deg/h",
    "rate_random_walk_deg_h_sqrt_h": "rate random walk (K {} deg/h/√h) or a slow oscillation",
    "rate_ramp_deg_h2": "rate ramp (R {} deg/h²), motion or temperature",
}


def _p(p_value: float) -> str:
    return f"p = {p_value:.1g}" if p_value >= 1e-99 else "p < 1e-99"


def _segment(slope: float, slope_sd: float, from_s: float, to_s: float, mixed_with: str | None, **_: Any) -> str:
    mixed = f" (mixed with {mixed_with})" if mixed_with else ""
    return f"slope {estimate_text(slope, slope_sd, '1')} from {time_text(from_s)} to {time_text(to_s)}{mixed}"


def slope(coefficient: str, value: float, sd: float, upper_limit: float | None, **segment: Any) -> str:
    return f"{_segment(**segment)}: {_INDICATED[coefficient].format(value_or_limit(value, sd, upper_limit))}"


def slope_quantization(
    value: float,
    sd: float,
    upper_limit: float | None,
    read_at_s: float,
    apparent_angle_random_walk_deg_sqrt_h: float,
    largest_angle_random_walk_deg_sqrt_h: float,
    largest_at_s: float,
    **segment: Any,
) -> str:
    return (
        f"{_segment(**segment)}: quantization or residual dither (Q {value_or_limit(value, sd, upper_limit)} arcsec), not angle "
        f"random walk: an N read at {read_at_s:.3g} s would be {apparent_angle_random_walk_deg_sqrt_h:.2g} deg/√h, but the "
        f"curve at {largest_at_s:.3g} s allows no more than {largest_angle_random_walk_deg_sqrt_h:.2g} deg/√h"
    )


def slope_with_base_motion(noise: str, **segment: Any) -> str:
    return f"{_segment(**segment)}: the slope of {noise}, but the base moves"


def misfit(misfit: float, p_value: float) -> str:
    return (
        f"the five noises do not describe this curve: its variances depart from their sum by {100 * misfit:.0f} % beyond chance "
        f"({_p(p_value)}); the standard errors allow for it"
    )


def not_stationary(
    tau_s: float,
    largest_deg_h: float,
    largest_from_s: float,
    smallest_deg_h: float,
    smallest_from_s: float,
    p_value: float,
    excess_kurtosis: float,
    largest_difference_s: float,
) -> str:
    bursts = f", in bursts (excess kurtosis {excess_kurtosis:.1f}), the largest at {largest_difference_s:.6g} s"
    return (
        f"the noise is not stationary: at {tau_s:.3g} s the deviation is {largest_deg_h:.3g} deg/h in the segment from "
        f"{largest_from_s:.4g} s and {smallest_deg_h:.3g} deg/h in that from {smallest_from_s:.4g} s ({_p(p_value)})"
        f"{bursts if excess_kurtosis > 1.0 else ''}; one set of coefficients does not describe this record"
    )


def _lines(share: float, frequency_hz: Sequence[float]) -> str:
    at = ", ".join(f"{frequency:.3g}" for frequency in frequency_hz)
    return f"{100 * share:.0f} % of the variance is in narrow lines (at {at} Hz, as sampled)"


def narrow_lines(share: float, frequency_hz: Sequence[float], accelerometers: Sequence[str]) -> str:
    shown = f", which {', '.join(accelerometers)} also show{'s' if len(accelerometers) == 1 else ''}" if accelerometers else ""
    return f"{_lines(share, frequency_hz)}{shown}: residual dither of this gyro or its neighbours, or a steady vibration"


def pulse_beat(share: float, frequency_hz: Sequence[float], beat_hz: float) -> str:
    return (
        f"{_lines(share, frequency_hz)}: the mean rate makes {beat_hz:.4g} pulses a second, and the lines are multiples of it: the "
        "beat of counting whole pulses, not motion; it fades in longer averages"
    )


def base_motion(
    accelerometer: str, coherence: float, frequency_hz: float, share: float, power_correlation: float, power_p_value: float
) -> str:
    return (
        f"base motion: {accelerometer} shows it too (coherence {coherence:.2f} at {frequency_hz:.3g} Hz, {100 * share:.0f} % of "
        f"the gyro's variance; rank correlation of their powers {power_correlation:.2f}, {_p(power_p_value)})"
    )


def table_turns(columns: Sequence[str]) -> str:
    return (
        f"the table turns ({', '.join(columns)}): its motion and harmonics of the rotation are in this curve; `rlgcomp arw` "
        "estimates the noise of a turning gyro"
    )


def angle_outliers(
    *, run: str, gyro: str, places: int, first_s: float, step_arcsec: float, step_sd: float, left_out_s: float
) -> str:
    where = f"at {first_s:.6g} s" if places == 1 else f"in {places} places, first at {first_s:.6g} s"
    return (
        f"{run}, {gyro}: the angle jumps {where}, by {step_arcsec:.3g} arcsec, {step_sd:.0f} standard deviations of its noise: a "
        f"shock or a fault of the logger; {left_out_s:.2g} s around are left out."
    )


TEXTS: Final = {
    "maximum": (
        "the curve rises to a maximum at {tau_s:.3g} s and falls again: an oscillation or motion near {frequency_hz:.1g} Hz, which "
        "none of the five noises makes"
    ),
    "curve_ends_early": (
        "the curve ends at {last_tau_s:.3g} s: {gaps} gaps leave no part of {recorded_s:.3g} s longer than {longest_part_s:.3g} s, "
        "and no difference spans a gap; where single samples are missing, means over ten go further: "
        "allan_deviation(recording.averaged({averaging_s:g})) in Python"
    ),
    "base_motion_limits": "base motion is no noise of the gyro: take these deviations as upper limits, or isolate the base",
    "no_base_motion": "no accelerometer shows base motion",
    "no_accelerometer": "without an accelerometer, base motion cannot be separated from a change of the gyro's noise",
    "temperature_changes": (
        "{column} changes by {range_K:.1f} K: slow variations are drift of the gyro; Q and N hold, B, K and R do not"
    ),
    "turntable": (
        "this is a turntable recording without an encoder: motion of the table and harmonics of the rotation may be in this curve; "
        "`rlgcomp arw` estimates the noise of a turning gyro"
    ),
    "read_in_pieces": ("the recording was read in pieces: stationarity, base motion, temperature and rotation were not checked"),
    "encoder_delay_unknown": (
        "The encoder's delay is unknown: at one constant rate it is inseparable from the angle at which the gyros began to count. "
        "Record the start-up, or two rates. N does not depend on it."
    ),
    "cross_check_disagrees": (
        "{run}, {gyro} at {rate_deg_s:.4g} deg/s: the cross-check without harmonic fit disagrees (p = {p_value:.1g}). The record "
        "contains noise that is neither white nor repeats with the angle; quote neither value alone."
    ),
    "spectrum_misfit": (
        "{run}, {gyro} at {rate_deg_s:.4g} deg/s: the spectrum below {highest_hz:.3g} Hz is not the sum of the four noises "
        "(p = {p_value:.1g}), however narrow the band. Look at the figure: table motion and dither show as humps."
    ),
    "encoder_subtracted": (
        "{run}, {gyro} at {rate_deg_s:.4g} deg/s: the table's rate wandered, as gyro and encoder agree, so the encoder's motion "
        "was subtracted. Its noise widens the error of N."
    ),
    "angle_random_walk_not_resolved": (
        "{run}, {gyro} at {rate_deg_s:.4g} deg/s: N is not resolved. Take it as an upper limit, and record longer or with finer "
        "pulses."
    ),
}
