"""Export to C99: written, compiled, compared with Python sample by sample, measured, reported."""

from __future__ import annotations

import dataclasses
import logging
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt
import pandas as pd

from rlgcomp.compensation.artefact import identity
from rlgcomp.compensation.compensator import load
from rlgcomp.errors import InputError
from rlgcomp.export import toolchain as tools
from rlgcomp.export.accuracy import Bounds, bounds_of, span_deg_h
from rlgcomp.export.c_source import KINDS, Design, operations, render, state_bytes
from rlgcomp.export.expansion import expansion_of
from rlgcomp.export.golden import OK, Stream, golden_stream, stream_of
from rlgcomp.export.reduction import sized, smallest_within
from rlgcomp.export.target import REPORT, Options
from rlgcomp.export.target import written as all_written
from rlgcomp.files import to_json, whole_folder
from rlgcomp.report.messages import Message, message
from rlgcomp.scratch import temporary_folder

Array = npt.NDArray[np.float64]
logger = logging.getLogger(__name__)
_JUDGES: Final = {"unseen": "runs not trained on", "trained_on": "the training runs"}


@dataclasses.dataclass(frozen=True)
class CExport:
    """A module in C: its size and speed, its comparison with Python, and the size curve.

    Parameters
    ----------
    summary : dict
        Model, sizes, operations, speed, as plain data.
    checks : tuple of Check
    skipped : tuple of Message
        Why a toolchain was not used.
    curve : pandas.DataFrame
        Held-out stability by number of centres; empty where no size was requested.
    """

    summary: Mapping[str, Any]
    checks: tuple[tools.Check, ...]
    skipped: tuple[Message, ...]
    curve: pd.DataFrame

    @property
    def tables(self) -> Sequence[tuple[str, Sequence[Mapping[str, Any]]]]:
        """Titles and rows for people."""
        tables: list[tuple[str, Sequence[Mapping[str, Any]]]] = [
            (f"{self.summary['model']} in C99, {self.summary['precision']}", self._facts()),
            ("Every sample compared with Python", self._compared()),
        ]
        if not self.curve.empty:
            tables.append(
                ("Size against bias stability, training runs left out in turn", [self._size(row) for row in self._rows()])
            )
        return tables if self.checks else [tables[0], *tables[2:]]

    @property
    def remarks(self) -> tuple[Message, ...]:
        """Skipped toolchains, missing verification and the smallest model of the curve."""
        remarks = list(self.skipped)
        if not self.checks:
            remarks.append(message("export.not_compiled"))
        if not self.curve.empty:
            remarks.append(message("export.smallest_within_1_percent", centres=self.summary["smallest_within_1_percent"]))
        return tuple(remarks)

    def to_mapping(self) -> dict[str, Any]:
        """Everything as plain data."""
        return {
            "schema": "rlgcomp.export/1",
            **self.summary,
            "verified": bool(self.checks),
            "checks": [dataclasses.asdict(check) for check in self.checks],
            "skipped": [remark.to_mapping() for remark in self.skipped],
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
            "left out, std, deg/h": f"{row['left_out_deg_h']:.6f}",
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


def export(model: Path, out: Path, options: Options) -> CExport:
    """Write `NAME.h`, `NAME.c`, `NAME_selftest.c`, `report.md` and `report.json` into a folder, after comparing every sample.

    Parameters
    ----------
    model : path
        Artefact.
    out : path
        Folder to write.
    options : Options

    Raises
    ------
    InputError
        The artefact is damaged, its model has no form in C, the budget cannot be met, or the place cannot be written to.
    RuntimeError
        The compiled code does not agree with Python: a fault of the export. Nothing is written then either.
    """
    compensator = load(model)
    whole = expansion_of(compensator)
    expansion, curve = sized(compensator, whole, options)
    expansion.require_computable()
    name, offset_s = options.name or name_from(model), options.offset_s
    design = Design(name, compensator, expansion, options.precision, options.libm, identity(model), offset_s)
    full = expansion is whole
    golden, quiet_rows = golden_stream(compensator, expansion, full=full, offset_s=offset_s)
    streams = [golden, *(stream_of(run, compensator, expansion, full=full, offset_s=offset_s) for run in options.runs)]
    bounds = [bounds_of(stream, compensator, expansion, options.precision) for stream in streams]
    files = render(design, golden, bounds[0], quiet_rows)
    with whole_folder(out, writes=all_written(model, "c", options.name)) as folder:
        for name, text in files.items():
            (folder / name).write_text(text, encoding="ascii")
        checks, skipped, measured, step_ns = _verified(folder, design, streams, bounds, board=options.board)
        span = span_deg_h(compensator)
        allowed_within = max(
            float(each.bias_deg_h[stream.status == OK].max(initial=0.0)) for stream, each in zip(streams, bounds, strict=True)
        )
        X = np.vstack([part.X for part in compensator.training_])
        summary = {
            "target": "c",
            "name": design.name,
            "model": model.name,
            "sha256": design.sha256,
            "precision": options.precision,
            "libm": options.libm,
            "offset_s": offset_s,
            "files": sorted([*files, "report.md", REPORT]),
            "form": expansion.form,
            "kind": KINDS[expansion.form],
            "inputs": expansion.features,
            "centres": len(expansion.weights),
            "centres_of_model": len(whole.weights),
            "changed_deg_h": 0.0 if full else float(np.abs(expansion.bias_deg_h(X) - compensator.predict_rows(X)).max()),
            "table_bytes": design.table_bytes,
            "state_bytes": state_bytes(design),
            "operations": operations(design),
            "measured": measured,
            "step_ns": step_ns,
            "span_deg_h": span,
            "allowed_deg_h": allowed_within,
            "allowed_of_span": allowed_within / span,
            "smallest_within_1_percent": None if curve.empty else smallest_within(curve),
        }
        result = CExport(summary, tuple(checks), tuple(skipped), curve)
        (folder / "report.md").write_text(result.to_markdown(), encoding="utf-8")
        (folder / REPORT).write_text(to_json(result.to_mapping()) + "\n", encoding="utf-8")
    return result


def _disagreement(design: Design, found: str) -> Exception:
    """A fault of the export; in single precision the model itself may be at fault."""
    if design.precision == "double":
        return RuntimeError(found)
    return InputError(
        f"{found}. In single precision the sums of this model may cancel too much; export it with --precision double, or train a "
        "smoother one (--model dynamic)"
    )


def _verified(
    folder: Path, design: Design, streams: Sequence[Stream], bounds: Sequence[Bounds], *, board: bool
) -> tuple[list[tools.Check], list[Message], list[dict[str, Any]], dict[str, float]]:
    """Checks, what was skipped, measured sizes and nanoseconds a step, by toolchain."""
    checks: list[tools.Check] = []
    skipped: list[Message] = []
    measured: list[dict[str, Any]] = []
    step_ns: dict[str, float] = {}
    module, test = folder / f"{design.name}.c", folder / f"{design.name}_selftest.c"
    for toolchain in tools.TOOLCHAINS:
        if toolchain.board and not board:
            skipped.append(message("export.toolchain_not_requested", toolchain=toolchain.name))
            continue
        if toolchain.missing:
            skipped.append(message("export.toolchain_missing", toolchain=toolchain.name, program=toolchain.missing))
            continue
        with temporary_folder() as built:
            try:
                command = tools.build(toolchain, [module, test], built)
            except tools.ToolchainError as error:
                skipped.append(message("export.toolchain_broken", toolchain=toolchain.name, reason=str(error)))
                continue
            samples = sum(len(stream.time_s) for stream in streams)
            logger.info("%s: comparing %d samples with Python", toolchain.name, samples)  # minutes on an emulated board
            try:
                tools.selftest(toolchain, command)
            except RuntimeError as error:
                raise _disagreement(design, str(error)) from None
            for stream, allowed in zip(streams, bounds, strict=True):
                check = tools.check(toolchain, command, stream, allowed)
                if check.wrong:
                    raise _disagreement(design, f"the exported C does not agree with Python: {check}")
                checks.append(check)
            if "-O2" in toolchain.flags:
                size = tools.sizes(toolchain, module, built)
                measured += [] if size is None else [{"toolchain": tools.version(toolchain), **size}]
                if not toolchain.board:
                    step_ns[toolchain.name] = tools.time_ns(command)
    return checks, skipped, measured, step_ns


def written(name: str) -> tuple[str, ...]:
    """Names of the files, besides `report.json`."""
    return (f"{name}.h", f"{name}.c", f"{name}_selftest.c", "report.md")


def name_from(model: Path) -> str:
    """Prefix of the files and identifiers of this model."""
    plain = re.sub(r"[^a-z0-9_]", "_", model.resolve().name.lower())[:40]
    return plain if plain[:1].isalpha() else f"model_{plain}"[:40]
