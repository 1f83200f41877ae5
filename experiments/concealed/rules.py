"""What each rule of a decision does beyond the model: every case decided once more without it, from the same posterior."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final
from unittest import mock

from rlgcomp.diagnosis import decide
from rlgcomp.diagnosis.answer.posterior import Posterior

Row = Mapping[str, Any]
OWNED: Final = "a law of the columns and memory of a named mechanism is its form"
EQUATION: Final = "a small member of the columns and memory of a named equation without departures is its form"
RULES: Final = {OWNED: "_owned", EQUATION: "_form_of_an_equation"}


def without_rules(diagnosis: Any) -> dict[str, dict[str, Any]]:
    """By rule, the verdict, names and drivers that a diagnosis would have without it, of those that change them.

    Parameters
    ----------
    diagnosis : rlgcomp.Diagnosis
        Another engine's result, which has no posterior, has no rules.
    """
    posterior = getattr(diagnosis, "posterior", None)
    if not isinstance(posterior, Posterior):
        return {}
    stated = _content(diagnosis.decision)
    contents = {rule: _content(_decided_without(posterior, function)) for rule, function in RULES.items()}
    return {rule: content for rule, content in contents.items() if content != stated}


def _decided_without(posterior: Posterior, rule: str) -> decide.Decision:
    with mock.patch.object(decide, rule, _never):
        return decide.decided(posterior)


def _never(*_: Any) -> bool:
    return False


def _content(decision: decide.Decision) -> dict[str, Any]:
    return {
        "verdict": decision.verdict,
        "findings": [one.mechanism for one in decision.named if one.mechanism is not None],
        "drivers": sorted(decision.drivers),
        "memory": decision.memory,
    }


def effects(rows: Sequence[Row], right: Callable[[Row], bool]) -> list[dict[str, Any]]:
    """A line a rule: how many answers it changes, and how many are right with it alone and without it alone.

    Parameters
    ----------
    rows : sequence of mapping
        As of :func:`experiments.concealed.score.run_case`.
    right : callable
        Whether a row is answered as the goals ask.
    """
    known = [row for row in rows if "without_rules" in row]
    lines = []
    for rule in RULES:
        changed = [(row, {**row, **_scored(row, row["without_rules"][rule])}) for row in known if rule in row["without_rules"]]
        judged = [(right(row), right(other)) for row, other in changed]
        lines.append(
            {
                "rule": rule,
                "answers changed": f"{len(changed)} of {len(known)}",
                "right with it alone": judged.count((True, False)),
                "right without it alone": judged.count((False, True)),
            }
        )
    return lines


def _scored(row: Row, content: Row) -> dict[str, Any]:
    return {**content, "exact": sorted(content["findings"]) == sorted(row["hidden"])}
