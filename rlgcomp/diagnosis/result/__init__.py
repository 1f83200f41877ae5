"""The diagnosis: what was found, where, how sure, what it gains on runs held out, and what to run next.

Its JSON form is a contract (schema rlgcomp.diagnosis/1): scripts and challenges read it, so keys are added and never changed.
"""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Mapping, Sequence
from concurrent.futures import Executor
from pathlib import Path
from typing import Any, Final, Self

import pandas as pd

from rlgcomp.diagnosis.result import sentences, wording
from rlgcomp.diagnosis.result.findings import (
    Alternative,
    Cause,
    Estimate,
    InPart,
    Law,
    Nearest,
    NextExperiment,
    Place,
    Step,
    Unexplained,
    chance,
)
from rlgcomp.diagnosis.result.fits import Alignment, Fit, RunFit, Trace, contradicted
from rlgcomp.diagnosis.result.record import DiagnosisRecord, Verdict
from rlgcomp.files import sha256, to_json, write_json
from rlgcomp.recording.provenance import provenance
from rlgcomp.report.notebook import ShownAsTable

__all__ = [
    "Alignment", "Alternative", "Cause", "Diagnosis", "Estimate", "Fit", "InPart", "Law", "Nearest",
    "NextExperiment", "Place", "RunFit", "Step", "Trace", "Unexplained", "Verdict", "chance", "contradicted",
]  # fmt: skip

SCHEMA: Final = "rlgcomp.diagnosis/1"


@dataclasses.dataclass(frozen=True, repr=False)
class Diagnosis(DiagnosisRecord, ShownAsTable):
    """What a simulator is missing: the data of :class:`~rlgcomp.diagnosis.result.record.DiagnosisRecord`, shown and kept."""

    def of_files(self, train: Sequence[Path], test: Sequence[Path] = (), simulator: Path | None = None) -> Self:
        """The same, with the SHA-256 of the files that the runs were read from, and of the simulator's."""
        files = {"train": train, "test": test} | ({} if simulator is None else {"simulator": [simulator]})
        return dataclasses.replace(
            self, recordings={part: {str(path): sha256(path) for path in paths} for part, paths in files.items()}
        )

    # --- what it says ------------------------------------------------------------------------------------------------------

    @property
    def findings(self) -> list[dict[str, Any]]:
        """The chosen set as plain data."""
        return [cause.to_mapping() for cause in self.causes]

    @property
    def sentence(self) -> str:
        """The verdict in one sentence."""
        return sentences.verdict_sentence(self)

    @property
    def citations(self) -> tuple[str, ...]:
        """Sources of the mechanisms and methods that were used, each once."""
        physics = [mechanism.reference for mechanism in self.augmented.mechanisms]
        physics += [cause.mechanism.reference for cause in self.causes]
        return tuple(dict.fromkeys([*physics, *wording.methods(self)]))

    def to_mapping(self) -> dict[str, Any]:
        """Plain data as in `diagnosis.json`: what is not a finite number is None."""
        next_up = self.next_experiment
        content = {
            "schema": SCHEMA,
            "verdict": self.verdict,
            "mismatch": {"p_value": self.p_value, "where": [dataclasses.asdict(place) for place in self.where]},
            "findings": self.findings,
            "probability": self.probability,
            "nothing_missing": self.healthy,
            "alternatives": [dataclasses.asdict(alternative) for alternative in self.alternatives],
            "unexplained": dataclasses.asdict(self.unexplained),
            "steps": [dataclasses.asdict(step) for step in self.steps],
            "in_part": [dataclasses.asdict(one) for one in self.in_part],
            "fit": {
                "train": dataclasses.asdict(self.train),
                "test": None if self.test is None else dataclasses.asdict(self.test),
            },
            "next_experiment": None if next_up is None else dataclasses.asdict(next_up),
            "sentence": self.sentence,
            "simulator": self.simulator,
            "recordings": {part: dict(files) for part, files in self.recordings.items()},
            "baseline": _plain(self.calibration),
            "baseline_with_findings": _plain(self.recalibration),
            "noise": self.noise.strengths(),
            "alignment": [dataclasses.asdict(alignment) for alignment in self.alignment],
            "remarks": list(self.remarks),
            "citations": list(self.citations),
        }
        plain: dict[str, Any] = json.loads(to_json(content))
        return plain

    def to_frame(self) -> pd.DataFrame:
        """One row a fitted parameter of each cause."""
        rows = [
            {
                "mechanism": cause.name,
                "probability": cause.probability,
                "rms_deg_h": cause.rms_deg_h,
                "parameter": name,
                "value": estimate.value,
                "sd": estimate.sd,
                "unit": estimate.unit,
                "indistinguishable_from": ", ".join(cause.indistinguishable_from),
            }
            for cause in self.causes
            for name, estimate in (cause.parameters or {"": Estimate(math.nan, math.nan)}).items()
        ]
        columns = ["mechanism", "probability", "rms_deg_h", "parameter", "value", "sd", "unit", "indistinguishable_from"]
        return pd.DataFrame(rows, columns=columns)

    def __repr__(self) -> str:
        return wording.as_text(self)

    def heading(self) -> str:
        return sentences.verdict_sentence(self)

    def plot(self, ax: Any = None, *, run: str | None = None) -> Any:
        """A run's mismatch, the function found with its band, and the rms before and after.

        Parameters
        ----------
        ax : matplotlib Axes or sequence of Axes, optional
            One for the mismatch alone, or one for each panel; by default a new figure.
        run : str, optional
            Name of the run; by default the first.

        Returns
        -------
        Axes or ndarray of Axes

        Raises
        ------
        InputError
            There is no such run.
        """
        from rlgcomp.diagnosis.result.pictures import draw

        return draw(ax, self, run)

    # --- keeping it --------------------------------------------------------------------------------------------------------

    def save(self, folder: str | Path) -> None:
        """Write `diagnosis.json` and `augmented.yaml` into a folder, which must exist."""
        write_json(Path(folder) / "diagnosis.json", self.to_mapping() | {"provenance": provenance()})
        self.augmented.to_yaml(Path(folder) / "augmented.yaml")

    def report(self, path: str | Path, executor: Executor | None = None) -> None:
        """Write the page that shows it: one self-contained HTML file. An executor, where given, draws the pictures."""
        from rlgcomp.diagnosis.result.page import write_diagnosis_report

        write_diagnosis_report(path, self, executor)


def _plain(parameters: Mapping[str, Mapping[str, Estimate]]) -> dict[str, dict[str, Any]]:
    return {name: {key: dataclasses.asdict(estimate) for key, estimate in of.items()} for name, of in parameters.items()}
