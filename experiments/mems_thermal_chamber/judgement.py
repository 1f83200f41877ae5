"""What a physicist would make of a diagnosis of one axis, in sentences that follow from its numbers."""

from __future__ import annotations

import rlgcomp as rlg
from rlgcomp.diagnosis.answer.scores import Score

MEMORY = {
    "thermal_hysteresis": "rate-independent",
    "thermal_lag": "dynamic",
    "temperature_rate": "dynamic",
    "rate_asymmetry": "dynamic",
}
STEPS = ("mode_hop", "random_telegraph")
ONCE = ("warm_up", "ageing")
COMPLETE = 2.0  # times the noise floor: what leaves more does not describe the leg
SUPPORTED = 2  # causes that two legs can support


def held_out(found: rlg.Diagnosis) -> Score:
    """The fit of the runs held out.

    Raises
    ------
    InputError
        There are none.
    """
    if found.test is None:
        raise rlg.InputError("no run was held out; give one")
    return found.test


def memories(found: rlg.Diagnosis) -> dict[str, str]:
    """The kinds of memory of temperature that were found, by what was found."""
    named = {cause.name: MEMORY[cause.name] for cause in found.causes if cause.name in MEMORY}
    for law in found.laws:
        if law.memory in ("dynamic", "rate-independent") and any("temperature" in driver for driver in law.drivers):
            named["a law"] = law.memory
    return named


def judgement(found: rlg.Diagnosis) -> str:
    """What is found, what it is worth on the leg held out, and what is not to be believed."""
    fit = held_out(found)
    sentences = []
    remembered = memories(found)
    if remembered:
        kinds = ", ".join(f"{name} ({memory})" for name, memory in remembered.items())
        sentences.append(f"The bias remembers the temperature: {kinds}.")
    else:
        sentences.append("No memory of the temperature is found.")
    low, high = fit.improvement_ci95
    interval = f"{100 * fit.improvement:.0f} %, 95 % interval {100 * low:.0f} to {100 * high:.0f} %"
    sentences.append(f"Held out the error falls by {interval}." if low > 0.0 else f"Held out no gain can be claimed ({interval}).")
    low, high = fit.improvement_std_ci95
    shape = f"{100 * fit.improvement_std:.0f} % ({100 * low:.0f} to {100 * high:.0f} %)"
    sentences.append(f"About the leg's own mean it is {shape}" + ("." if low > 0.0 else ": the shape is not predicted."))
    left = fit.augmented_rms / fit.noise_floor_rms
    if left > COMPLETE:
        sentences.append(f"What is left is {left:.0f} times the noise: the leg is not described.")
    steps = " and ".join(cause.name for cause in found.causes if cause.name in STEPS)
    if steps:
        sentences.append(f"A MEMS has no laser modes: {steps} would be steps, as of stress let go, which two legs cannot confirm.")
    once = " and ".join(cause.name for cause in found.causes if cause.name in ONCE)
    if once:
        sentences.append(f"The unit was switched on once: {once} cannot be told from memory.")
    if len(found.causes) > SUPPORTED:
        sentences.append(f"{len(found.causes)} causes are more than two legs can support: the set is not to be believed.")
    return " ".join(sentences)
