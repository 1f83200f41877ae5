"""Export to C99: written, compiled, compared with Python sample by sample, measured, reported."""

from __future__ import annotations

import logging
import re
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from rlgcomp.compensation.artefact import identity
from rlgcomp.compensation.compensator import load
from rlgcomp.export import toolchain as tools
from rlgcomp.export.accuracy import Bounds, bounds_of, span_deg_h
from rlgcomp.export.budget import sized
from rlgcomp.export.c_result import CExport
from rlgcomp.export.c_source import KINDS, Design, operations, render, state_bytes
from rlgcomp.export.expansion import expansion_of
from rlgcomp.export.golden import OK, Stream, golden_stream, stream_of
from rlgcomp.export.reduce import smallest_within
from rlgcomp.export.target import REPORT, Options
from rlgcomp.export.target import written as all_written
from rlgcomp.files import to_json, whole_folder

Array = npt.NDArray[np.float64]
logger = logging.getLogger(__name__)


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
    design = Design(options.name or name_from(model), compensator, expansion, options.precision, options.libm, identity(model))
    full = expansion is whole
    golden, quiet_rows = golden_stream(compensator, expansion, full=full)
    streams = [golden, *(stream_of(run, compensator, expansion, full=full) for run in options.runs)]
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


def _verified(
    folder: Path, design: Design, streams: Sequence[Stream], bounds: Sequence[Bounds], *, board: bool
) -> tuple[list[tools.Check], list[str], list[dict[str, Any]], dict[str, float]]:
    """Checks, what was skipped, measured sizes and nanoseconds a step, by toolchain."""
    checks: list[tools.Check] = []
    skipped: list[str] = []
    measured: list[dict[str, Any]] = []
    step_ns: dict[str, float] = {}
    module, test = folder / f"{design.name}.c", folder / f"{design.name}_selftest.c"
    for toolchain in tools.TOOLCHAINS:
        if toolchain.board and not board:
            skipped.append(f"{toolchain.name}: skipped, as was asked")
            continue
        if toolchain.missing:
            skipped.append(f"{toolchain.name}: skipped, {toolchain.missing} is not installed")
            continue
        with tempfile.TemporaryDirectory() as built:
            try:
                command = tools.build(toolchain, [module, test], Path(built))
            except tools.ToolchainError as error:
                skipped.append(str(error))
                continue
            samples = sum(len(stream.time_s) for stream in streams)
            logger.info("%s: comparing %d samples with Python", toolchain.name, samples)  # minutes on an emulated board
            tools.selftest(toolchain, command)
            for stream, allowed in zip(streams, bounds, strict=True):
                found = tools.check(toolchain, command, stream, allowed)
                if found.wrong:
                    raise RuntimeError(f"the exported C does not agree with Python: {found}")
                checks.append(found)
            if "-O2" in toolchain.flags:
                size = tools.sizes(toolchain, module, Path(built))
                measured += [] if size is None else [{"toolchain": tools.version(toolchain), **size}]
                if not toolchain.board:
                    step_ns[toolchain.name] = tools.time_ns(command)
    return checks, skipped, measured, step_ns


def written(name: str) -> tuple[str, ...]:
    """Names of the files, besides `report.json`."""
    return (f"{name}.h", f"{name}.c", f"{name}_selftest.c", "report.md")


def name_from(model: Path) -> str:
    """What files and identifiers of this model begin with."""
    plain = re.sub(r"[^a-z0-9_]", "_", model.resolve().name.lower())[:40]
    return plain if plain[:1].isalpha() else f"model_{plain}"[:40]
