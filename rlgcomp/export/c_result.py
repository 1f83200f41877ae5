"""What came of an export to C: facts, checks and the size curve, as tables, plain data and a page."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any, Final

import pandas as pd

from rlgcomp.export.toolchain import Check

_JUDGES: Final = {"unseen": "runs not trained on", "trained_on": "the training runs"}


@dataclasses.dataclass(frozen=True)
class CExport:
    """A module in C and what was found about it.

    Parameters
    ----------
    summary : dict
        Model, sizes, operations, speed, as plain data.
    checks : tuple of Check
    skipped : tuple of str
        Why a toolchain was not used, in sentences.
    curve : pandas.DataFrame
        Held-out stability by number of centres; empty where no size was asked for.
    """

    summary: Mapping[str, Any]
    checks: tuple[Check, ...]
    skipped: tuple[str, ...]
    curve: pd.DataFrame

    @property
    def tables(self) -> Sequence[tuple[str, Sequence[Mapping[str, Any]]]]:
        """Titles and rows for people."""
        found: list[tuple[str, Sequence[Mapping[str, Any]]]] = [
            (f"{self.summary['model']} in C99, {self.summary['precision']}", self._facts()),
            ("Every sample compared with Python", self._compared()),
        ]
        if not self.curve.empty:
            found.append(("Size against bias stability, training runs left out in turn", [self._size(row) for row in self._rows()]))
        return found if self.checks else [found[0], *found[2:]]

    @property
    def remarks(self) -> Sequence[str]:
        """What was skipped and what the curve says, in sentences."""
        said = list(self.skipped)
        if not self.checks:
            said.append("The code was not compiled: no working C compiler was found. It is unverified on this machine.")
        if not self.curve.empty:
            said.append(
                f"The smallest model within 1 % of the best on the curve has {self.summary['smallest_within_1_percent']} centres."
            )
        return said

    def to_mapping(self) -> dict[str, Any]:
        """Everything as plain data."""
        return {
            "schema": "rlgcomp.export/1",
            **self.summary,
            "verified": bool(self.checks),
            "checks": [dataclasses.asdict(check) for check in self.checks],
            "skipped": list(self.skipped),
            "curve": self.curve.to_dict("records"),
        }

    def to_markdown(self) -> str:
        """The report as a page."""
        parts = [f"# {self.summary['name']}: bias compensation in C99\n"]
        for title, rows in self.tables:
            head = list(rows[0])
            lines = [f"| {' | '.join(head)} |", "|" + "---|" * len(head)]
            lines += [f"| {' | '.join(str(row[column]) for column in head)} |" for row in rows]
            parts.append(f"## {title}\n\n" + "\n".join(lines) + "\n")
        parts += [f"- {remark}" for remark in self.remarks]
        return "\n".join(parts) + "\n"

    def _rows(self) -> list[dict[Any, Any]]:
        return self.curve.to_dict("records")

    def _size(self, row: Mapping[Any, Any]) -> dict[str, str]:
        shown = {
            "centres": f"{row['centres']:.0f}",
            "tables, bytes": f"{row['table_bytes']:.0f}",
            "left out, deg/h": f"{row['left_out_deg_h']:.6f}",
            "loss": f"{100.0 * row['left_out_loss']:+.2g} %",
        }
        for judge, runs in _JUDGES.items():
            if f"{judge}_deg_h" in row:
                shown |= {
                    f"{runs}, deg/h": f"{row[f'{judge}_deg_h']:.6f}",
                    f"loss on {runs}": f"{100.0 * row[f'{judge}_loss']:+.2g} %",
                }
        return shown

    def _facts(self) -> list[dict[str, str]]:
        summary = self.summary
        facts = {
            "model, SHA-256": summary["sha256"],
            "kind": f"{summary['kind']}, {summary['centres']} of {summary['centres_of_model']} centres, {summary['inputs']} inputs",
            "constant tables, bytes": summary["table_bytes"],
            "state, bytes": summary["state_bytes"],
        }
        for measured in summary["measured"]:
            facts[f"flash and stack, bytes ({measured['toolchain']}, -Os)"] = (
                f"{measured['flash_bytes']} and {measured['stack_bytes']}"
            )
        counted = [f"{name.replace('_', ' ')} {count}" for name, count in summary["operations"].items() if count]
        facts["operations a step"] = ", ".join(counted)
        for name, ns in summary["step_ns"].items():
            facts[f"one step here, ns ({name})"] = f"{ns:.0f}"
        facts["allowed difference within range, deg/h"] = (
            f"{summary['allowed_deg_h']:.3g} ({summary['allowed_of_span']:.2g} of the span)"
        )
        if summary["changed_deg_h"]:
            facts["changed by fewer centres, deg/h"] = f"{summary['changed_deg_h']:.3g} at most on the training rows"
        return [{"": name, " ": str(value)} for name, value in facts.items()]

    def _compared(self) -> list[dict[str, str]]:
        span = self.summary["span_deg_h"]
        return [
            {
                "built and run with": check.toolchain,
                "recording": check.stream,
                "samples": str(check.samples),
                "largest difference within range, deg/h": f"{check.largest_deg_h:.2g}",
                "of the span": f"{check.largest_deg_h / span:.2g}",
                "of what is allowed, anywhere": f"{check.share:.2g}",
            }
            for check in self.checks
        ]
