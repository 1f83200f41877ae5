r"""The score of a diagnosis against the hidden causes, from `diagnosis.json` alone.

Overlap of places is intersection over union of time,

.. math:: \mathrm{IoU} = \frac{\sum_r |W_r \cap H_r|}{\sum_r |W_r \cup H_r|}

over the training runs r, W the intervals that the diagnosis names and H those in which the hidden causes acted.
"""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Container, Iterable, Mapping, Sequence
from typing import Any, Self

import numpy as np

from rlgcomp.diagnosis.decide import VERDICTS
from rlgcomp.errors import InputError

Spans = Sequence[tuple[float, float]]


@dataclasses.dataclass(frozen=True)
class Hidden:
    """The hidden causes.

    Parameters
    ----------
    mechanisms : tuple of str
        Names; empty for a healthy gyro.
    parameters : mapping
        True values by "mechanism.parameter".
    intervals : mapping
        By run, the (start_s, end_s) in which the causes acted most; empty where they act throughout.
    """

    mechanisms: tuple[str, ...] = ()
    parameters: Mapping[str, float] = dataclasses.field(default_factory=dict)
    intervals: Mapping[str, Spans] = dataclasses.field(default_factory=dict)


@dataclasses.dataclass(frozen=True)
class Score:
    """How well a diagnosis answers.

    Parameters
    ----------
    verdict : str
    detected : bool
        Whether it reports that an effect is missing.
    verdict_right : bool
        `none` for a healthy gyro; `explained` or `ambiguous` otherwise.
    named : bool
        The first finding is one of the hidden (no finding at all, for a healthy gyro).
    exact : bool
        The set of findings is the hidden set.
    in_class : bool
        The hidden ones can be matched one to one with findings, each by its name or by a name in `indistinguishable_from`.
    overlap : float, optional
        Intersection over union of time; None where every hidden cause acts throughout, or no place of the diagnosis is an interval.
    errors_sd : mapping
        By "mechanism.parameter": (estimate - truth) / sd, of hidden mechanisms that were named.
    """

    verdict: str
    detected: bool
    verdict_right: bool
    named: bool
    exact: bool
    in_class: bool
    overlap: float | None
    errors_sd: Mapping[str, float]

    @classmethod
    def of(cls, hidden: Hidden, diagnosis: Mapping[str, Any]) -> Self:
        """Score a diagnosis by the content of its `diagnosis.json`.

        Raises
        ------
        InputError
            It is no diagnosis: a key of the contract is missing, or a value is impossible.
        """
        try:
            verdict = str(diagnosis["verdict"])
            findings = [str(finding["mechanism"]) for finding in diagnosis["findings"]]
            classes = [{str(finding["mechanism"]), *finding["indistinguishable_from"]} for finding in diagnosis["findings"]]
            places = [(str(place["run"]), place["start_s"], place["end_s"]) for place in diagnosis["mismatch"]["where"]]
            estimates = {
                f"{finding['mechanism']}.{name}": (estimate["value"], estimate["sd"])
                for finding in diagnosis["findings"]
                for name, estimate in finding["parameters"].items()
            }
            _require_numbers(estimates, hidden.parameters)
            _require_possible(verdict, diagnosis)
            parameters = {
                name: (float(value), float(sd or math.nan))
                for name, (value, sd) in estimates.items()
                if isinstance(value, int | float)
            }
        except InputError:
            raise
        except (KeyError, TypeError, ValueError) as error:
            raise InputError(
                f"this is no diagnosis: {type(error).__name__} {error}; give the diagnosis.json that `rlgcomp diagnose` wrote"
            ) from None
        causes = hidden.mechanisms
        timed = [place for place in places if None not in place]
        return cls(
            verdict=verdict,
            detected=verdict != "none",
            verdict_right=verdict in (("explained", "ambiguous") if causes else ("none",)),
            named=bool(findings) and findings[0] in causes if causes else not findings,
            exact=sorted(findings) == sorted(causes),
            in_class=len(classes) == len(causes)
            and any(
                all(name in members for name, members in zip(causes, order, strict=True))
                for order in itertools.permutations(classes)
            ),
            overlap=_overlap(hidden.intervals, places) if hidden.intervals and (timed or not places) else None,
            errors_sd={
                name: (parameters[name][0] - truth) / parameters[name][1]
                for name, truth in hidden.parameters.items()
                if name in parameters and parameters[name][1] > 0.0
            },
        )

    def to_mapping(self) -> dict[str, Any]:
        """Plain data."""
        return dataclasses.asdict(self) | {"errors_sd": dict(self.errors_sd)}


def _require_numbers(estimates: Mapping[str, tuple[Any, Any]], numeric: Container[str]) -> None:
    """Refuse text where an estimate belongs: a choice has no standard deviation, and is none of the hidden numbers."""
    for name, (value, sd) in estimates.items():
        numbers = [value] if sd is None else [value, sd]
        if (sd is not None or name in numeric) and not all(_finite(number) for number in numbers):
            text = repr(value) if sd is None or not _finite(value) else f"{value!r} ± {sd!r}"
            raise InputError(f"{name} is {text} in the diagnosis; it must be a number: give diagnosis.json as diagnose wrote it")


def _finite(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def _require_possible(verdict: str, diagnosis: Mapping[str, Any]) -> None:
    """Refuse an unknown verdict, findings with the verdict "none", and probabilities outside 0 to 1."""
    as_written = "give diagnosis.json as diagnose wrote it"
    if verdict not in VERDICTS:
        raise InputError(f"the verdict is {verdict!r}; it must be one of {', '.join(VERDICTS)}: {as_written}")
    if verdict == "none" and diagnosis["findings"]:
        names = ", ".join(str(finding["mechanism"]) for finding in diagnosis["findings"])
        raise InputError(f"the verdict is 'none', yet {names} is found; {as_written}")
    probabilities = {str(finding["mechanism"]): finding.get("probability") for finding in diagnosis["findings"]}
    probabilities |= {f"alternative {k}": other.get("probability") for k, other in enumerate(diagnosis.get("alternatives") or ())}
    probabilities |= {
        "mismatch.p_value": diagnosis["mismatch"].get("p_value"),
        "the findings together": diagnosis.get("probability"),
    }
    for name, value in probabilities.items():
        if value is not None and not (isinstance(value, int | float) and 0.0 <= value <= 1.0):
            raise InputError(f"the probability of {name} is {value!r}; it must be from 0 to 1: {as_written}")


def _overlap(intervals: Mapping[str, Spans], places: Iterable[tuple[str, Any, Any]]) -> float:
    located: dict[str, list[tuple[float, float]]] = {}
    for run, start, end in places:
        if start is not None and end is not None:
            located.setdefault(run, []).append((float(start), float(end)))
    both = either = 0.0
    for run in {*intervals, *located}:
        truth, found = intervals.get(run, ()), located.get(run, ())
        edges = np.unique([edge for span in (*truth, *found) for edge in span])
        for a, b in itertools.pairwise(edges.tolist()):
            hit = [any(start <= a and b <= end for start, end in spans) for spans in (truth, found)]
            both += (b - a) * all(hit)
            either += (b - a) * any(hit)
    return both / either if either > 0.0 else 0.0
