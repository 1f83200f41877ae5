"""What is said of held-out runs: what they decided, how far they are off, and where predictions are extrapolated."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import Final

import numpy as np
import numpy.typing as npt

from rlgcomp.diagnosis.answer import WORSE, Answer
from rlgcomp.diagnosis.conclusion import UNRECORDED, Conclusion, acquitted
from rlgcomp.diagnosis.naming.explain import Explanations
from rlgcomp.diagnosis.result import Diagnosis, Estimate, Fit, Trace, Verdict
from rlgcomp.diagnosis.result.phrases import listing
from rlgcomp.physics.mechanism import Mechanism
from rlgcomp.units import column_unit

Array = npt.NDArray[np.float64]
_OFF: Final = 1.5  # times the noise floor, from which held-out runs are said to be off
_OFF_ALONE: Final = 1.25  # the same of one run
NOTED: Final = 0.01  # p-value below which it is said that something is there, though nothing is claimed
_AS_LIKELY: Final = 0.8  # relative probability from which training runs prefer neither of two sets
_BEYOND: Final = 0.15  # of the range of a driver in training: a run that leaves it by more is extrapolated


def turned(explanations: Explanations, conclusion: Conclusion) -> list[str]:
    """What to say where held-out runs turned what training runs alone would have named."""
    proposed = explanations.proposed
    if conclusion.laws or conclusion.unrecorded > UNRECORDED:
        return []
    if explanations.unaccounted:
        return [
            "No known mechanism accounts for the held-out runs in noise that the training runs may have: these alone decided what "
            "is named. Train on runs that go where the held-out runs go."
        ]
    if proposed is None:
        return []
    alone = proposed.nothing if acquitted(proposed) else proposed.models[0]
    before, now = (sorted(name for name, known in model.labels if not known) for model in (alone, conclusion.model))
    shares = {model.labels: p for model, p in zip(proposed.models, proposed.probabilities, strict=True)}
    if before == now or shares.get(conclusion.model.labels, 0.0) > _AS_LIKELY * shares[alone.labels]:
        return []
    said = f"{listing(before)} (probability {min(proposed.probability_of(name) for name in before):.2f})" if before else "nothing"
    if not now:
        return [f"The training runs alone would name {said}; the held-out runs do not bear it out."]
    chosen = f"the held-out runs decided for {listing(now)}, so that what is gained on them is not independent of that choice."
    return [f"The training runs alone would name {said}; {chosen}"]


def denied_by_held_out(found: Diagnosis) -> str:
    """What to say where held-out runs decided for what then makes them worse, so that training runs were asked alone."""
    named = listing([cause.name for cause in found.causes])
    return (
        f"Asked together, all runs would name {named}, with which the held-out runs are further off than without: the training "
        "runs alone decided, once it was seen that this leaves less of the held-out runs."
    )


def is_worse_in_training(train: Fit, causes: Sequence[Mechanism]) -> bool:
    """Whether all that is named makes the very runs worse that it was found in; it is not asked of causes that are drawn anew in
    every run."""
    return bool(causes) and all(cause.repeats() for cause in causes) and train.augmented_rms >= WORSE * train.baseline_rms


def worse_in_training(kind: str, train: Fit, test: Fit | None, causes: Sequence[Mechanism]) -> tuple[str, ...]:
    """What to say where it does: on a table it is wrong. In a chamber the simulator by itself follows what slow noise does to the
    training runs, which held-out runs tell."""
    if not is_worse_in_training(train, causes):
        return ()
    off = f"{train.augmented_rms:.2g} {train.unit} rms, without it by {train.baseline_rms:.2g}"
    said = f"With all that is named the training runs themselves are off by {off}"
    if kind == "turntable":
        return (
            f"{said}: what was found within windows does not hold between them. Do not use augmented.yaml; see first whether "
            "times, angles and rates are what they are taken for.",
        )
    if test is None or test.augmented_rms >= test.baseline_rms:
        return (f"{said}: no gain is proved. Hold out a run, or another one, before you use augmented.yaml.",)
    return (
        f"{said}: calibrated without it the simulator follows what slow noise does to these very runs. What is gained, held-out "
        "runs tell.",
    )


def off_held_out(
    verdict: Verdict, test: Fit | None, causes: Sequence[Mechanism] = (), extrapolated: Collection[str] = ()
) -> tuple[str, ...]:
    """What to say where held-out runs are off by more than noise, though nothing is named, or for all that is; of causes that are
    drawn anew in every run it is not asked.

    Where predictions are extrapolated (in these runs), they err by what the numbers of the training runs are uncertain by as well.
    """
    if verdict == "unknown" or test is None or test.augmented_std is None or not all(cause.repeats() for cause in causes):
        return ()
    if test.augmented_rms < _OFF * test.noise_floor_rms:
        return _off_alone(test, extrapolated)
    times = test.augmented_rms / test.noise_floor_rms
    named = "" if verdict == "none" else ", with all that is named,"
    off = f"Held-out runs{named} are off by {test.augmented_rms:.2g} {test.unit} rms, {times:.1f} times the noise"
    if test.augmented_std < _OFF * test.noise_floor_rms:
        there = listing([one.run for one in test.per_run if one.run in extrapolated])
        beside = f", or in {there}, where predictions are extrapolated, what their numbers are uncertain by" if there else ""
        return (
            f"{off}: a bias of each run's own accounts for it{beside}. If this gyro is known to repeat its bias better from "
            "switch-on to switch-on, something that differs between runs is missing.",
        )
    return (
        f"{off}, and by {test.augmented_std:.2g} about each run's own mean: they show what the training runs do not. Take one of "
        "them among the training runs.",
    )


def _off_alone(test: Fit, extrapolated: Collection[str]) -> tuple[str, ...]:
    """Of single runs that are off, though all of them together hardly are."""
    if test.whiteness_p_value is None or test.whiteness_p_value > NOTED:
        return ()
    said = []
    for one in test.per_run:
        if one.augmented_std is None or one.augmented_std < _OFF_ALONE * one.noise_floor_rms:
            continue
        times = one.augmented_std / one.noise_floor_rms
        off = f"{one.run} is off by {one.augmented_std:.2g} {test.unit} about its own mean, {times:.1f} times the noise"
        why = (
            ": its predictions are extrapolated, and err by what the numbers of the training runs are uncertain by"
            if one.run in extrapolated
            else f", and not by noise alone (p = {test.whiteness_p_value:.1g}): it shows what the training runs do not"
        )
        said.append(f"{off}{why}. Take it among them.")
    return tuple(said)


def within_windows(found: Answer) -> tuple[str, ...]:
    """What held-out runs show of causes that means of windows average away."""
    window_s = found.posed.problem.rows.window_s
    return tuple(
        f"{mechanism.name} acts within the windows of {window_s:.3g} s, whose means average most of it away. At their full rate "
        f"held-out runs show {Estimate(shown, sd, '1')} of what the training runs say of it."
        for mechanism, shown, sd in found.shown_within_windows
    )


def extrapolations_of(traces: Sequence[Trace], drivers: Collection[str]) -> dict[str, str]:
    """By held-out run in which a driver goes where it did not go in training, by window means, what to say of it; an angle goes
    round."""
    learnt = [trace.monitors for trace in traces if not trace.held_out]
    said = {}
    for trace in (one for one in traces if one.held_out):
        beyond = []
        for column in trace.monitors.columns.intersection(sorted(drivers)):
            if column_unit(column) == "deg":
                continue
            low, high = (float(extreme([extreme(table[column]) for table in learnt])) for extreme in (np.nanmin, np.nanmax))
            lowest, highest = float(np.nanmin(trace.monitors[column])), float(np.nanmax(trace.monitors[column]))
            if max(low - lowest, highest - high) > _BEYOND * (high - low) > 0.0:
                unit = column_unit(column) or ""
                beyond.append(f"{column} from {lowest:.4g} to {highest:.4g} {unit}, trained from {low:.4g} to {high:.4g}")
        if beyond:
            said[trace.run] = f"{trace.run} leaves what was trained on ({'; '.join(beyond)}): predictions are extrapolated there."
    return said
