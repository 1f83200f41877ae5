"""Model registry: the models of a folder, each verified (checksums, numbers, golden vectors), and compared on runs."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd

from rlgcomp.compensation.artefact import MANIFEST, SUMS, identity
from rlgcomp.compensation.compensator import Compensator, load
from rlgcomp.errors import InputError
from rlgcomp.evaluation.evaluation import evaluate
from rlgcomp.files import from_json, read_text
from rlgcomp.recording import Recording
from rlgcomp.report.messages import Message, message

REPORT: Final = "report.json"
OF_A_UNIT: Final = "model"  # in the folder that a fleet writes for a unit
_LARGEST_REPORT_BYTES: Final = 1 << 24


@dataclasses.dataclass(frozen=True)
class Entry:
    """One model of a folder.

    Parameters
    ----------
    name : str
    problem : str, optional
        Why it cannot be used; its other fields are unknown then.
    sha256 : str
        Of the whole artefact.
    schema : str
    model : str
    inputs : int
    units : str
        Gyros that it was trained on.
    hours : float
        Of training.
    left_out_rms_deg_h : float, optional
        Error with runs left out.
    half_width_deg_h : float
        Of the 90 % interval within the training range.
    bytes : int
        Of its arrays that are needed to use it.
    code : tuple of str
        Exported code next to it, by target, and whether it was made from this model.
    """

    name: str
    problem: str | None = None
    sha256: str = ""
    schema: str = ""
    model: str = ""
    inputs: int = 0
    units: str = ""
    hours: float = float("nan")
    left_out_rms_deg_h: float | None = None
    half_width_deg_h: float = float("nan")
    bytes: int = 0
    code: tuple[str, ...] = ()


@dataclasses.dataclass(frozen=True)
class ModelRegistry:
    """Models of a folder.

    Parameters
    ----------
    folder : path
    entries : tuple of Entry
        By name.
    comparison : pandas.DataFrame
        One row a model and run; empty where no runs were given: `model`, `run`, `residual_std_deg_h`, `residual_rms_deg_h`,
        `factor`, `in_interval`, `out_of_range`, `trained_on`, `problem`.
    """

    folder: Path
    entries: tuple[Entry, ...]
    comparison: pd.DataFrame

    @property
    def remarks(self) -> tuple[Message, ...]:
        """Runs that prove nothing of a model, since it was trained on them."""
        if self.comparison.empty:
            return ()
        trained_on = self.comparison[self.comparison["trained_on"]]
        pairs = zip(trained_on["model"], trained_on["run"], strict=True)
        return tuple(message("evaluation.model_trained_on", model=model, run=run) for model, run in pairs)

    @property
    def refused(self) -> tuple[Entry, ...]:
        """Models that cannot be used, or whose code was made from another model."""
        return tuple(entry for entry in self.entries if entry.problem or any("another model" in code for code in entry.code))

    def to_frame(self) -> pd.DataFrame:
        """One row a model."""
        return pd.DataFrame([dataclasses.asdict(entry) for entry in self.entries])

    def to_mapping(self) -> dict[str, Any]:
        """Everything as plain data."""
        return {
            "schema": "rlgcomp.collection/1",
            "folder": str(self.folder),
            "models": [dataclasses.asdict(entry) for entry in self.entries],
            "comparison": self.comparison.to_dict("records"),
            "remarks": [remark.to_mapping() for remark in self.remarks],
        }


def survey(folder: str | Path, runs: Sequence[Recording] = ()) -> ModelRegistry:
    """Verify every model in a folder, or the one that the folder is, and compare them on runs.

    Models are the folder's own folders, or `model` in them, as a fleet writes it: that has its unit's name.

    Raises
    ------
    InputError
        There is no such folder, or no model in it. A model that cannot be used is no error here: its entry says why.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise InputError(f"{folder} {'is no folder' if folder.exists() else 'does not exist'}; give a folder of models, or a model")
    children = [folder] if _is_model(folder) else sorted(folder.iterdir())
    places = [child if _is_model(child) else child / OF_A_UNIT for child in children]
    candidates = [place for place in places if _is_model(place)]
    if not candidates:
        raise InputError(
            f"{folder} holds no model: no folder in it, nor {OF_A_UNIT} in one, has {MANIFEST} and {SUMS}; "
            "train one with rlgcomp train"
        )
    entries = [_entry(place, of_a_unit=place.parent in children) for place in candidates]
    compared = [_on_run(entry.name, model, run) for entry, model in entries if model is not None for run in runs]
    return ModelRegistry(folder, tuple(entry for entry, _ in entries), pd.DataFrame(compared))


def _is_model(path: Path) -> bool:
    return path.is_dir() and ((path / MANIFEST).exists() or (path / SUMS).exists())


def _entry(path: Path, *, of_a_unit: bool) -> tuple[Entry, Compensator | None]:
    """Entry of a model, with the code in its folder or in the folder of its unit."""
    name = printable(path.parent.name if of_a_unit else path.name)
    unit_reports = path.parent.glob(f"*/{REPORT}") if of_a_unit else ()
    try:
        model = load(path)
        sha256 = identity(path)
        code = tuple(_code(report, sha256) for report in sorted([*path.glob(f"*/{REPORT}"), *unit_reports]))
    except InputError as error:
        return Entry(name, printable(str(error))), None
    rmse, specification = model.selection_.rmse, model.specification_
    arrays = {} if specification is None else specification.pack(model.model_)[1]
    return (
        Entry(
            name=name,
            sha256=sha256,
            schema=model.schema_,
            model="" if specification is None else specification.name,
            inputs=len(model.pipeline_.names),
            units=printable(", ".join(sorted({str(run.get("unit") or "not stated") for run in model.provenance_}))),
            hours=float(sum(float(run["hours"]) for run in model.provenance_)),
            left_out_rms_deg_h=None if rmse is None else rmse * model.scaling_.y_scale_deg_h,
            half_width_deg_h=model.interval_.inside_deg_h,
            bytes=int(sum(values.nbytes for values in arrays.values()) + 4 * model.scaling_.mean.nbytes),
            code=code,
        ),
        model,
    )


def _code(report: Path, sha256: str) -> str:
    try:
        if report.is_symlink() or report.stat().st_size > _LARGEST_REPORT_BYTES:
            raise InputError(f"{report} is no report of rlgcomp export")
        content = from_json(read_text(report))
        made_of, target = content["sha256"], printable(str(content["target"]))[:20]
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise InputError(f"{report} is no report of rlgcomp export: {type(error).__name__}") from None
    return target if made_of == sha256 else f"{target} of another model ({printable(str(made_of))[:12]})"


def _on_run(name: str, model: Compensator, run: Recording) -> dict[str, Any]:
    unknown = dict.fromkeys(("residual_std_deg_h", "residual_rms_deg_h", "factor", "in_interval", "out_of_range"), np.nan)
    try:
        (result,) = evaluate(model, [run], compare=False).runs
    except InputError as error:
        return {"model": name, "run": run.name, **unknown, "trained_on": False, "problem": printable(str(error))}
    values = {key: getattr(result, key) for key in (*unknown, "trained_on")}
    return {"model": name, "run": run.name, **values, "problem": ""}


def printable(text: str) -> str:
    """Text from an untrusted file, safe for a terminal: characters that do not print are escaped.

    >>> printable("unit 7\\x1b[2J")
    'unit 7\\\\x1b[2J'
    """
    return "".join(character if character.isprintable() else character.encode("unicode_escape").decode() for character in text)
