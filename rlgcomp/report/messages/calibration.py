"""Messages of calibration."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

from rlgcomp.units import value_and_sd


def counter_does_not_follow(run: str, column: str, first_s: float, last_s: float, left_out: int, revolutions: int) -> str:
    when = f"at {first_s:.6g} s" if first_s == last_s else f"between {first_s:.6g} and {last_s:.6g} s"
    return f"{run}: {when} the counter does not follow {column}; {left_out} of {revolutions} revolutions are left out"


def random_walk_unknown(rates_deg_s: Sequence[float]) -> str:
    return (
        f"at {', '.join(f'{rate:.4g}' for rate in rates_deg_s)} deg/s the standard error lacks angle random walk, which one repeat "
        "does not determine; turn two revolutions or more in each direction, and sample them finely"
    )


def _lock_in_fit(chi2: float, freedom: int, largest_residual_ppm: float, rate_deg_s: float) -> str:
    return (
        f"chi-square is {chi2:.3g} with {freedom} degrees of freedom; the largest residual is {largest_residual_ppm:+.2g} ppm at "
        f"{rate_deg_s:g} deg/s"
    )


def lock_in_explains_the_curve(chi2: float, freedom: int, largest_residual_ppm: float, rate_deg_s: float) -> str:
    fit = _lock_in_fit(chi2, freedom, largest_residual_ppm, rate_deg_s)
    return f"{fit}: lock-in explains the curve within the scatter of the repeats"


def lock_in_does_not_explain_the_curve(
    chi2: float,
    freedom: int,
    largest_residual_ppm: float,
    rate_deg_s: float,
    hump_rates_deg_s: Sequence[float] | None,
    hump_ppm: Sequence[float] | None,
) -> str:
    text = _lock_in_fit(chi2, freedom, largest_residual_ppm, rate_deg_s)
    if hump_rates_deg_s is not None and hump_ppm is not None:
        text += (
            f"; the means at {hump_rates_deg_s[0]:g} to {hump_rates_deg_s[1]:g} deg/s lie {hump_ppm[0]:+.2g} to {hump_ppm[1]:+.2g} "
            "ppm above that at the highest rate, although lock-in lowers every output"
        )
    return f"{text}: lock-in alone does not explain the curve, and the standard error of lock_in_deg_s does not cover that"


def outliers(run: str, at_s: Sequence[float], limit_sd: float, margin_s: float, cut: bool) -> str:
    times = ", ".join(f"{each:.6g} s" for each in at_s)
    text = f"{run}: gyros or accelerometers deviate by {limit_sd:g} standard deviations from the encoders {times} after the start"
    if not cut:
        return f"{text}: a shock or a fault of the logger; without it no part of the run is long enough, so it stays"
    return f"{text}: a shock or a fault of the logger; the run is cut there, {margin_s:g} s on either side left out"


def angle_random_walk(angle_random_walk_deg_sqrt_h: float, estimated: bool) -> str:
    source = "estimated from these runs" if estimated else "as stated"
    return f"angle random walk {angle_random_walk_deg_sqrt_h:.3g} deg/√h, {source}"


def parameters_not_determined(parameters: Sequence[str]) -> str:
    return (
        f"these runs do not determine {', '.join(parameters)}, which {'is' if len(parameters) == 1 else 'are'} taken as zero; the "
        "inner axis turned level shows Δk_z, ε_z, β; turned upright ε_x, ε_y; both axes turned Δk_x, Δk_y, α, δ"
    )


def gyros_cross_zero_rate(run: str, crossings: Mapping[str, int], reversals: int) -> str:
    counts = ", ".join(f"{axis} {count}" for axis, count in crossings.items())
    return (
        f"{run}: the gyros pass through zero rate {counts} times, at {reversals} reversals of the table: they are not rate-biased "
        "there, and lock-in kicks them at every passage; turn the outer axis slower than 0.7 times the inner one"
    )


def gyros_hardly_turn(run: str, axes: Sequence[str], limit_deg_s: float) -> str:
    return f"{run}: gyros {' and '.join(axes)} stay below {limit_deg_s:g} deg/s: they are not rate-biased in this run"


def chi_squared_unexpected(run: str, ratio: float) -> str:
    cause = (
        "noise is larger than in the other runs, or the model lacks an effect (outliers, vibration, flexing); standard deviations "
        "may be too small"
        if ratio > 1.0
        else "noise is smaller than in the other runs; standard deviations are too large for this run"
    )
    return f"{run}: chi² is {ratio:.2g} of its expected value: {cause}"


def triad_mounting(arcsec: Sequence[float], sd_arcsec: Sequence[float]) -> str:
    angles = zip("xyz", arcsec, sd_arcsec, strict=True)
    turned = ", ".join(f"{axis} {' ± '.join(value_and_sd(angle, sd))}" for axis, angle, sd in angles)
    return f"the triad stands turned from the table's axes by {turned} arcsec; the errors above do not depend on it"


def parameters_correlated(parameters: Sequence[str], correlation: float) -> str:
    return f"{' and '.join(parameters)} are hardly separated (correlation {correlation:+.3f})"


def latitude(stated_deg: float, estimated_deg: float, sd_deg: float, error_deg: float, bias_z_shift_deg_h: float) -> str:
    estimated = " ± ".join(value_and_sd(estimated_deg, sd_deg))
    return (
        f"latitude is taken as {stated_deg:g} deg, and these runs show {estimated} deg; an error of {error_deg:g} deg shifts ε_z "
        f"by {bias_z_shift_deg_h:.2g} deg/h"
    )


TEXTS: Final = {
    # scale factor of one gyro
    "table_moved": "{run}: {segments} segments left out: {column} moved by more than {limit_deg:g} deg",
    "reference_mark_chosen": (
        "revolutions are counted from {reference_deg:g} deg of {column}, which makes {revolutions} whole ones; from 0 deg there "
        "would be {revolutions_at_zero}, as where the table starts or turns back near the mark; --reference-deg sets another"
    ),
    "segments_unpaired": (
        "{segments} segments of constant rate were left out: from one passage of {reference_deg:g} deg to the next there is no "
        "further segment in the other direction at their rate; where the table did turn back at it, another mark may keep them: "
        "--reference-deg"
    ),
    "positions_unpaired": ("{segments} runs of the position table have no partner in the other direction and were left out"),
    "outlying_repeat": (
        "at {rate_deg_s:.4g} deg/s the repeat that begins at {start_s:.6g} s is {departure_ppm:+.3g} ppm off the mean of the "
        "{others} others, which scatter by {scatter_ppm:.2g} ppm; it counts in the mean: leave it out with RUN@START:STOP"
    ),
    "mounting_angle_near_zero": (
        "the mounting angle is less than three standard errors: it is not significantly different from zero, and its estimate is "
        "biased upwards"
    ),
    "one_repeat": (
        "one repeat: the repeatability of the scale factor is unknown, so that no lock-in is stated; turn the table to and fro at "
        "each rate more often"
    ),
    "no_operating_rate": "at no rate is the scale factor repeatable and constant to 1 ppm",
    "operating_rate": "from {rate_deg_s:.4g} deg/s on the scale factor is repeatable and constant to 1 ppm",
    "lock_in_from_one_power_up": (
        "the standard errors of the lock-in fit come from repeats within a recording; a power-up changes lock-in by more, so "
        "record every rate anew after each, a recording a power-up"
    ),
    "pulse_taken_as_scale_factor": (
        "no recording holds a conventional measurement: pulse_arcsec = {pulse_arcsec:.9g} is used instead"
    ),
    # triad
    "velocity_random_walk": (
        "accelerometers' velocity random walk {velocity_random_walk_ug_sqrt_hz:.2g} µg/√Hz, estimated from these runs and "
        "including vibration; if it is far above the data sheet's, look for vibration or flexing"
    ),
    "no_accelerometers": (
        "no accelerometers (accel_x_m_s2, ... or accel_x_m_s, ...): mean rates alone are compared; they show ε_x and ε_y"
    ),
    "gyros_came_as_rates": (
        "the gyros came as rates: if they were made from whole pulses, that noise is not in the standard deviations"
    ),
    "third_step_predicted": (
        "third step {third_step}: slowest gyro {slowest_deg_s:.1f} deg/s, {crossings} passages, would give Δk_x to "
        "{scale_x_sd_ppm:.2g} ppm and α to {alpha_gy_sd_arcsec:.2g} arcsec without lock-in"
    ),
    "accelerometer_axes": (
        "β and δ refer to the accelerometers' axes: their standard deviations include {sd_arcsec:.3g} arcsec for the uncertainty "
        "of the accelerometers' calibration"
    ),
    "alpha_gy_is_a_sum": (
        "α_gy is the whole sum m12 + m21, which gyros alone cannot separate; the body's x-z plane holds the x gyro"
    ),
    "biases_differ_between_runs": (
        "from run to run the biases differ by {sd_deg_h:.2g} deg/h (standard deviation), more than noise: ε is their mean, its "
        "standard deviation includes the differences, and the next run's biases differ from it by as much"
    ),
    "biases_between_runs_unknown": (
        "each bias rests on one kind of run; its change from one switching-on to the next is in its standard deviation only where "
        "that kind is recorded more than once and the runs differ significantly, which is not the case here"
    ),
    "navigator_worse": (
        "{run}: the calibration makes its navigator worse: largest velocity error {before_m_s:.2g} m/s before, {after_m_s:.2g} m/s "
        "after"
    ),
}
