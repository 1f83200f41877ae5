"""Messages of challenge."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final


def causes_before(mechanisms: Sequence[str]) -> str:
    return f"{', '.join(mechanisms)} found in these recordings before the injection; added to the simulator"


TEXTS: Final = {
    "far_above_usual_size": "{mechanism}: this strength makes it {ratio:.0f} × its usual size",
    "absorbed_by_the_simulator": (
        "{mechanism}: the simulator absorbs nearly all of it: this strength makes it {ratio:.0f} × its usual size, and only the "
        "errors of thermometers and averages remain of it to be found; choose a smaller --strength"
    ),
    "detected_and_named": (
        "Detected means that a residual is significant: the mismatch's p-value is below {p_value:g}. Named means that the most "
        "probable set of mechanisms holds the injected one, at any p-value, so that a faint effect may be named in more trials "
        "than it is detected in. All trials share the noise of these recordings, one realisation of it: others may show other "
        "limits, and the intervals do not include that."
    ),
    "equal_trials": (
        "{made} of {planned} trials are made and counted: the others have the same effect as one of them, for only the sign of "
        "{mechanism} can be varied; more strengths make the curves more certain, more draws do not"
    ),
    "unexplained_before": ("these recordings hold an unexplained effect before the injection (p = {p_value:.2g})"),
    "mechanism_before_kept": (
        "{mechanism} is found in these recordings before the injection, and the injection adds to it: the curves are not reliable"
    ),
    "mechanism_before_removed": ("{mechanism} is found in these recordings before the injection; it is subtracted from them"),
    "found_at_smallest_strength": (
        "every effect of the smallest strength, {strength:g}, was {criterion}: below it the curve is extrapolated; try smaller "
        "strengths"
    ),
    "missed_at_largest_strength": (
        "no effect of the largest strength, {strength:g}, was {criterion}: above it the curve is extrapolated; try larger strengths"
    ),
}
