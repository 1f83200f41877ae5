"""Messages of compensation: remarks on training runs and models, the model card, streams."""

from __future__ import annotations

import shlex
import signal as signals
from collections.abc import Mapping, Sequence
from typing import Final

from rlgcomp.report.messages.column_names import is_like_a_gyro, suggested_temperature
from rlgcomp.units import is_thermometer


def interval(*, parts: str, number: int, coverage: float, basis: str, turn_on_deg_h: float, gyros: int) -> str:
    calibrated = f"The interval was calibrated on {number} {parts}, each left out in turn"
    if gyros > 1:
        calibrated += f", with the spread between {parts} from {gyros} gyros of the same recordings"
    if basis == "unknown":
        return (
            "The interval is not known from these runs: their errors and their noise are zero. The span of the bias stands for it."
        )
    if basis == "spread":
        return (
            f"None of the {number} {parts} lies within the range of the others. The interval is their error extrapolated from each "
            "other, each left out in turn: for another one no share is promised."
        )
    if basis == "assumed":
        return (
            f"The interval was calibrated on blocks of a single run, each left out in turn. One run does not show how runs differ: "
            f"{turn_on_deg_h:.3g} deg/h from switch-on to switch-on is assumed, the standard deviation of the bias in that run."
        )
    if number == 1 and turn_on_deg_h:
        return (
            f"The interval was calibrated on blocks of a single run, each left out in turn, and on the stated repeatability of "
            f"{turn_on_deg_h:.3g} deg/h from switch-on to switch-on. Another run must not differ in more than that."
        )
    if number == 1:
        return (
            "The interval was calibrated on blocks of a single run, each left out in turn. One run does not show how runs differ: "
            "for another run no share is promised."
        )
    if number < 1.0 / (1.0 - coverage) - 1.0:
        return (
            f"{calibrated}, and aims at that share on average over {parts} of their kind. So few {parts} promise no share for the "
            "next, unless it resembles them."
        )
    return f"{calibrated}, and holds on average over {parts} of their kind."


def group_omitted(*, group: str, missing: Mapping[str, Sequence[str]]) -> str:
    lacking = ", ".join(f"{run} lacks {', '.join(columns)}" for run, columns in missing.items())
    return f"{group} omitted: {lacking}; name the column with --map, or leave that run out to use {group}."


def no_monitor(*, columns: Sequence[str], monitors: Sequence[str], lacking: Sequence[str]) -> str:
    text = f"no monitor to learn from: the runs share only {', '.join(columns)}"
    if lacking:
        text += f"; not all of them have {', '.join(lacking)}"
    monitors = [name for name in monitors if not is_like_a_gyro(name)]
    if not monitors:
        return f"{text}; map a temperature with --map"
    thermometer = suggested_temperature([name for name in monitors if not is_thermometer(name)])
    chosen = next((name for name in monitors if is_thermometer(name)), "NAME" if len(monitors) > 1 else monitors[0])
    mapped = f", or map a temperature, here probably with {thermometer}" if thermometer else ""
    return f"{text}; learn from {' or '.join(monitors)} with --features {shlex.quote(chosen)}{mapped}"


def parts_cancel(*, shares: Mapping[str, float]) -> str:
    parts = ", ".join(f"{part} {share:.0f} %" for part, share in shares.items())
    return (
        f"Parts of the model cancel each other (shares of the bias's variance: {parts}): these runs cannot tell them apart, their "
        "amplitudes are not those of the gyro, and another programme may show the difference."
    )


def zeroed_with_earth_rate(*, run: str, mean_deg_h: float, keep_mean: bool) -> str:
    kept = ", and the model was trained to keep the mean (--keep-mean)" if keep_mean else ""
    return (
        f"{run}: the gyro's mean at the start, {mean_deg_h:.4g} deg/h, is removed as the run's offset; Earth rate is lost with "
        f"it{kept}. Remove Earth rate from the recording first, or leave --offset out."
    )


def at_limits(*, parameters: Mapping[str, float]) -> str:
    values = " and ".join(f"{name} = {value:.3g}" for name, value in parameters.items())
    return (
        f"The selected {values} lies where the search ends: the runs ask for a smoother or rougher model than any tried, or "
        "cannot choose one. Train on more runs, or compare with --model dynamic by rlgcomp evaluate on runs that neither has seen; "
        "the table of the selection has the error of every candidate."
    )


def streamed(
    *,
    out: str,
    rows: int,
    found_there: int,
    left_out: Mapping[str, int],
    unfinished: bool,
    signal: int | None,
    changed: Mapping[str, int],
) -> str:
    parts = [f"{out}: {rows} rows written"]
    if found_there:
        parts.append(f"{found_there} were there already")
    parts += [f"{count} {reason} left out" for reason, count in sorted(left_out.items())]
    parts += [
        f"{count} {reason} {'undone' if 'overflow' in reason else 'taken as missing'}" for reason, count in sorted(changed.items())
    ]
    if unfinished:
        parts.append("the last line has no end and was left out")
    if signal is not None:
        parts.append(f"interrupted by {signals.Signals(signal).name}; the same command goes on from here")
    return ", ".join(parts)


TEXTS: Final = {
    "zeroed_by_noise": (
        "{run}: its offset is a mean over {offset_s:.6g} s ({samples} of its samples), whose noise of {noise_deg_h:.3g} deg/h goes "
        "into every corrected sample. Take the offset over a longer start, at least the averaging time."
    ),
    "zeroed_throughout": (
        "{run}: it ends after {duration_s:.6g} s, before the {offset_s:.6g} s are over that its offset is taken from: the whole "
        "run makes the offset, and nothing of it is held out. Give a shorter start."
    ),
    "turning": (
        "The gyro's means spread by {spread_deg_h:.3g} deg/h, as on a table that turns: the model learns this motion as a bias. "
        "Train on runs at rest, name the table's rate among --features (table_rate_deg_s), or state the gyro's unit."
    ),
    "turning_steadily": (
        "The gyro's mean is {mean_deg_h:.3g} deg/h, more than the Earth's rate and any bias: it turned on a table, or its unit is "
        "another. The model holds for this rate alone. Train on runs at rest, or state the gyro's unit."
    ),
    "below_noise": (
        "With runs left out the residual is {left_out_rms_deg_h:.3g} deg/h, less than the {noise_deg_h:.3g} deg/h that white noise "
        "alone leaves in the means: the runs know each other, as copies do, so this error proves nothing."
    ),
    "nearly_standard": (
        "Column {column} is not a standard name; the nearest is {nearest}. If it is meant, state --map {nearest}={column}, and "
        "the features of that monitor can be used."
    ),
    "gyro_is_no_input": (
        "Column {column} is no input: by its name, its unit or its noise it is a gyro, or made of this one, and a model that reads "
        "it would take rotation for bias. Map it as a gyro (gyro_x_deg_h, gyro_y_deg_h, ... and --gyro), leave it out with --drop, "
        "or name it with --features all,{column} if it is a monitor."
    ),
    "physics_left_out": (
        "The simulator's {mechanism} takes no part in the compensation: {reason}. The LS-SVM learns of it what its inputs show."
    ),
    "physics_worse": (
        "With runs left out this model leaves {residual_deg_h:.3g} deg/h, the default one without the physics "
        "{without_deg_h:.3g} deg/h: train without --physics, or compare both by rlgcomp evaluate on a run that neither has seen."
    ),
    "amplitudes_unknown": (
        "The amplitudes of these mechanisms cannot be told from zero, for each is less than two standard deviations: {amplitudes}."
    ),
    "not_told_apart": (
        "{group} is not used: these runs cannot tell its effect apart from that of {company}. A run that {telling_run} would."
    ),
    "like_runs_alone": (
        "The bias and its interval are for runs whose temperature goes as in these; in others the effect of {groups} is in neither."
    ),
    "offsets_between": (
        "Each of the {parts} has an offset of its own (switch-on, mounting) that the model cannot know: with {parts} left out "
        "{residual_deg_h:.3g} deg/h is left, but about the mean of each {within_deg_h:.3g} of {within_before_deg_h:.3g} deg/h. "
        "Zero the offset at the start of a run (--offset zero-at-start 600)."
    ),
    "leading_thermometer": (
        "No column is temperature_block_degC: rate, lag and memory are those of {column}, the first by name, and not of "
        "{others}. Map the one at the gyro block, as in --map temperature_block_degC={column}."
    ),
    "constant_within_runs": (
        "Hardly any change within a run, but from run to run: {inputs}. What that does cannot be told from the runs' own offsets "
        "(switch-on). Leave it out by --features, or record runs in which it changes."
    ),
    "no_gain": (
        "With {parts} left out the residual is {residual_deg_h:.3g} deg/h, no less than the {before_deg_h:.3g} deg/h before: "
        "on {parts} that it has not seen this model is worse than none. Test it on other {parts} with rlgcomp evaluate before it "
        "is used; look at its training runs with rlgcomp inspect, add more of them, or use fewer --features."
    ),
    "adapted_to_known": (
        "{unit} is one of the units that the adapted model was trained on: runs of it in that training are no test of this one."
    ),
    "other_unit": (
        "{run} is of unit {unit}, and the model was trained on {trained_unit} alone: the bias of each gyro has a course of its own."
    ),
    "on_the_processor": (
        "{rows} rows are fitted on the processor at every step of the selection, which may take many minutes. A larger "
        "--averaging-s makes fewer rows; a graphics card is faster."
    ),
    "no_overlap": (
        "No run lies within the range of the others: the interval of ± {half_width_deg_h:.3g} deg/h is how far they are off when "
        "extrapolated from each other. Add a run whose range overlaps with these."
    ),
    "turn_on_assumed": (
        "One run does not show how the bias differs from switch-on to switch-on: {turn_on_deg_h:.3g} deg/h is assumed in the "
        "interval, the standard deviation of the bias in that run. State the gyro's own with --turn-on-deg-h; with 0 the interval "
        "is that of the same run."
    ),
    "interval_unknown": (
        "The interval is not known from these runs: their errors and their noise are zero. The span of the bias, "
        "{half_width_deg_h:.3g} deg/h, stands for it."
    ),
}
