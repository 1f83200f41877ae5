"""Messages of evaluation: remarks on a compensation tested on runs."""

from __future__ import annotations

from typing import Final

from rlgcomp.report.messages.wording import listing


def out_of_range(run: str, percent: float, inputs: list[str]) -> str:
    which = f" of {listing(inputs)}" if inputs else ""
    return f"{run}: {percent:.0f} % of the samples lie outside the training range{which}; the model extrapolates."


def untold(run: str, percent: float, inputs: list[str]) -> str:
    go, they_do = ("goes", "it does") if len(inputs) == 1 else ("go", "they do")
    return (
        f"{run}: for {percent:.0f} % of this run {listing(inputs)} {go} where no training run went, and training could not tell "
        f"what {they_do}: that is neither in the bias nor in its interval. Train on a run like this one as well."
    )


TEXTS: Final = {
    "windows_left_out": (
        "{run}: {left_out} of {windows} windows are left out, because less than {percent:.0f} % of their samples are there; all "
        "numbers rest on the other {used}."
    ),
    "trained_on": "{run} was used for training, at least in part: its residual proves nothing.",
    "model_trained_on": "{model}: {run} was used for training, at least in part: its residual proves nothing.",
    "worse": (
        "{run}: this compensation is {times:.3g} times worse than none; the 95 % interval of the factor, {factor_low:.2g} to "
        "{factor_high:.2g}, lies below 1."
    ),
    "no_gain": (
        "{run}: no gain in stability can be claimed; the 95 % interval of the factor, {factor_low:.2f} to {factor_high:.2f}, "
        "includes 1."
    ),
    "offset": (
        "{run}: the residual has a mean of {mean_deg_h:+.3g} deg/h, more than its scatter: an offset since training (switch-on, "
        "mounting, Earth rate) that no monitor explains."
    ),
    "worse_with_offset": (
        "{run}: with that offset the residual is {residual_rms_deg_h:.3g} deg/h rms, more than the {raw_rms_deg_h:.3g} deg/h of "
        "the gyro as it is: on this run the compensation does harm unless its offset is zeroed (--offset zero-at-start 600)."
    ),
    "adds_noise": (
        "{run}: the compensation adds {added_deg_h:.3g} deg/h of noise to the gyro's {floor_deg_h:.3g} deg/h, as one that "
        "reads a noisy monitor does; train without that monitor (--features)."
    ),
    "cubic_suffices": (
        "A cubic in {features} alone has a residual of {cubic_rms_deg_h:.3g} deg/h rms, no more than this model: nothing is gained "
        "over the cubic."
    ),
}
