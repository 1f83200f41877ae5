"""The diagnosis as scripts use it: attributes, plain data, tables, files and a page.

Its JSON form is a contract (schema rlgcomp.diagnosis/1): scripts and challenges read it, so keys are added and never changed.
"""

from __future__ import annotations

import dataclasses
import functools
import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final, Self

import pandas as pd

from rlgcomp.diagnosis.answer.fit import Estimate
from rlgcomp.diagnosis.data import Run
from rlgcomp.diagnosis.report.page import write_page
from rlgcomp.diagnosis.report.record import Record
from rlgcomp.diagnosis.report.remarks import gain, headline, remarks
from rlgcomp.diagnosis.report.text import as_text
from rlgcomp.files import sha256, to_json, write_json
from rlgcomp.physics.mechanism import Mechanism
from rlgcomp.report.messages import Message
from rlgcomp.report.notebook import ShownAsTable

SCHEMA: Final = "rlgcomp.diagnosis/1"


@dataclasses.dataclass(frozen=True, eq=False, repr=False)
class Diagnosis(Record, ShownAsTable):
    """What a simulator is missing: the data of :class:`~rlgcomp.diagnosis.report.record.Record`, shown and kept."""

    def of_files(
        self, train: Sequence[Path], test: Sequence[Path] = (), simulator: Path | None = None, confirm: Sequence[Path] = ()
    ) -> Self:
        """The same, with the SHA-256 of the files that the runs were read from, and of the simulator's.

        Parameters
        ----------
        train, test, confirm : sequence of Path
        simulator : Path, optional
        """
        files = {"train": train, "test": test} | ({"confirm": confirm} if confirm else {})
        files |= {} if simulator is None else {"simulator": [simulator]}
        return dataclasses.replace(
            self, recordings={part: {str(path): sha256(path) for path in paths} for part, paths in files.items()}
        )

    # --- what it tells ---------------------------------------------------------------------------------------------------------

    @property
    def findings(self) -> list[dict[str, Any]]:
        """The mechanisms that are named, as plain data."""
        return [cause.to_mapping() for cause in self.causes]

    @property
    def messages(self) -> tuple[Message, ...]:
        """The headline and what it gains on the test runs."""
        gained = gain(self)
        return (headline(self),) if gained is None else (headline(self), gained)

    @property
    def sentence(self) -> str:
        """The verdict, and what it gains on the test runs."""
        return " ".join(one.text for one in self.messages)

    @functools.cached_property
    def remarks(self) -> tuple[Message, ...]:
        """Remarks, the most consequential first."""
        return remarks(self)

    def to_mapping(self) -> dict[str, Any]:
        """Plain data as in `diagnosis.json`: what is not a finite number is None."""
        plain: dict[str, Any] = json.loads(to_json(self._content()))
        return plain

    def _content(self) -> dict[str, Any]:
        laws = self.laws
        next_up = self.next_experiment
        slow = self.slow_error_probability if self.decision.wander else None
        return {
            "schema": SCHEMA,
            "verdict": self.verdict,
            "mismatch": {"p_value": self.p_value, "where": [dataclasses.asdict(place) for place in self.where]},
            "findings": self.findings,
            "probability": self.probability,
            "nothing_missing": self.healthy,
            "alternatives": [dataclasses.asdict(one) for one in self.alternatives],
            "unexplained": {
                "p_value": self.unexplained_p_value,
                "drivers": list(self.decision.drivers),
                "memory": self.decision.memory,
                "equation": "; ".join(one.equation for one in laws) or None,
                "probability": max((one.probability for one in laws), default=slow),
                "laws": [one.to_mapping() for one in laws],
            },
            "steps": self.steps,
            "fit": {
                "train": dataclasses.asdict(self.train),
                "confirm": None if self.confirm is None else dataclasses.asdict(self.confirm),
                "test": None if self.test is None else dataclasses.asdict(self.test) | {"file_rms": self.file_rms},
            },
            "black_box": None if self.black_box is None else self.black_box.to_mapping(self.unit),
            "next_experiment": None if next_up is None else dataclasses.asdict(next_up),
            "sentence": self.sentence,
            "messages": [one.to_mapping() for one in self.messages],
            "remarks": [one.to_mapping() for one in self.remarks],
            "simulator": self.request.simulator,
            "output": {"column": self.request.channel, "unit": self.unit},
            "runs": {
                "train": self._runs("train", self.after.data.runs),
                "confirm": self._runs("confirm", self.confirm_runs),
                "test": self._runs("test", self.test_runs),
            },
            "recordings": {part: dict(files) for part, files in self.recordings.items()},
            "baseline": _plain(self.calibration),
            "baseline_with_findings": _plain(self.recalibration),
            "noise": self.noise.strengths(),
            "alignment": [dataclasses.asdict(one) for one in self.alignment],
            "citations": list(self.citations),
            "provenance": self.provenance,
        }

    def _runs(self, part: str, runs: Sequence[Run]) -> list[dict[str, str | None]]:
        """Runs with their files and the SHA-256 of these, where they were read from files."""
        files = list(self.recordings.get(part, {}).items())
        known = files if len(files) == len(runs) else [(None, None)] * len(runs)
        return [{"run": run.name, "file": file, "sha256": digest} for run, (file, digest) in zip(runs, known, strict=True)]

    def to_frame(self) -> pd.DataFrame:
        """One row a fitted parameter of each finding."""
        rows = [
            {
                "mechanism": cause.name,
                "probability": cause.probability,
                "rms": cause.rms,
                "parameter": name,
                "value": estimate.value,
                "sd": estimate.sd,
                "unit": estimate.unit,
                "indistinguishable_from": ", ".join(cause.indistinguishable_from),
            }
            for cause in self.members
            for name, estimate in (cause.parameters or {"": Estimate(math.nan, math.nan, "")}).items()
        ]
        columns = ["mechanism", "probability", "rms", "parameter", "value", "sd", "unit", "indistinguishable_from"]
        return pd.DataFrame(rows, columns=columns)

    def __repr__(self) -> str:
        return as_text(self)

    def heading(self) -> str:
        return self.sentence

    def plot(self, ax: Any = None, *, run: str | None = None) -> Any:
        """A run before and after, the function of the largest finding with its band, and the rms of runs before and after.

        Parameters
        ----------
        ax : matplotlib Axes or sequence of Axes, optional
            One for the run alone, or one for each panel; by default a new figure.
        run : str, optional
            Name of the run; by default the first test run, or else the first training run.

        Returns
        -------
        Axes or ndarray of Axes

        Raises
        ------
        InputError
            There is no such run.
        """
        from rlgcomp.diagnosis.report.pictures import draw

        return draw(ax, self, run)

    # --- files -----------------------------------------------------------------------------------------------------------------

    def save(self, folder: str | Path) -> None:
        """Write `diagnosis.json` and `augmented.yaml` into a folder, which must exist."""
        write_json(Path(folder) / "diagnosis.json", self.to_mapping())
        self.augmented.to_yaml(Path(folder) / "augmented.yaml")

    def report(self, path: str | Path, *, truth: Mapping[str, Mechanism] | None = None, figures: str | Path | None = None) -> None:
        """Write the page that shows it: one self-contained HTML file.

        Parameters
        ----------
        path : path
        truth : mapping of str to Mechanism, optional
            What was concealed, by name, where it is known: it is shown beside what was found.
        figures : path, optional
            Folder in which each figure is saved as an SVG file as well.
        """
        write_page(path, self, truth=truth, figures=figures)


def _plain(numbers: Mapping[str, Mapping[str, Estimate]]) -> dict[str, dict[str, Any]]:
    return {name: {key: one.to_mapping() for key, one in of.items()} for name, of in numbers.items()}
