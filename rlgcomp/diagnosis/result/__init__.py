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
from typing import Any, Final, Literal, Self

import numpy as np
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
from rlgcomp.errors import InputError
from rlgcomp.files import sha256, to_json, write_json
from rlgcomp.noise.processes import NoiseModel
from rlgcomp.report.notebook import ShownAsTable
from rlgcomp.simulation.simulator import Simulator

__all__ = [
    "Alignment", "Alternative", "Cause", "Diagnosis", "Estimate", "Fit", "InPart", "Law", "Nearest",
    "NextExperiment", "Place", "RunFit", "Step", "Trace", "Unexplained", "Verdict", "chance", "contradicted",
]  # fmt: skip

_ROUNDING: Final = 1e-9
SCHEMA: Final = "rlgcomp.diagnosis/1"
Verdict = Literal["none", "explained", "ambiguous", "unknown"]
VERDICTS: Final = ("none", "explained", "ambiguous", "unknown")


@dataclasses.dataclass(frozen=True, repr=False)
class Diagnosis(ShownAsTable):
    """What a simulator is missing.

    Parameters
    ----------
    verdict : {"none", "explained", "ambiguous", "unknown"}
    p_value : float
        Probability, if the calibrated simulator lacked nothing, that runs depart from it as far as these, or a bound of it:
        from replicates of noise (:mod:`rlgcomp.diagnosis.detection.detect`), or one over the Bayes factor of what is named.
    where : tuple of Place
    causes : tuple of Cause
        The chosen set.
    alternatives : tuple of Alternative
    unexplained : Unexplained
    train : Fit
    test : Fit, optional
        None without runs held out.
    next_experiment : NextExperiment, optional
    calibrated, augmented : Simulator
        The simulator with its free parameters fitted, without and with the causes (refitted together).
    noise : NoiseModel
        As estimated or given.
    calibration : mapping
        Fitted baseline parameters by mechanism and name, as :class:`Estimate`, as if nothing were missing.
    recalibration : mapping
        The same, fitted together with the causes.
    wrong : tuple of str
        Mechanisms of the simulator whose numbers, said to be known, do not fit.
    alignment : tuple of Alignment
        Of the user's own simulation, one entry a run.
    remarks : tuple of str
        What a careful reader should know, in sentences.
    traces : tuple of Trace
        Window means of every run, for pictures; not part of the JSON.
    simulator : str
        What the baseline is called.
    recordings : mapping of str to mapping of str to str
        Under "train" and "test": SHA-256 of the files, by name, where runs were read from files; under "simulator" that of its own.
    healthy : float, optional
        Probability that nothing is missing and nothing unrecorded wanders.
    probability : float, optional
        Of the chosen set as a whole, with the laws beyond it where there are any.
    steps : tuple of Step
        Of the bias in single training runs: they are no part of either simulator.
    in_part : tuple of InPart
        Causes that act in a part of the runs; neither are they.

    Raises
    ------
    InputError
        The verdict is none of the four, or a probability lies outside 0 to 1.
    """

    verdict: Verdict
    p_value: float
    where: tuple[Place, ...]
    causes: tuple[Cause, ...]
    alternatives: tuple[Alternative, ...]
    unexplained: Unexplained
    train: Fit
    test: Fit | None
    next_experiment: NextExperiment | None
    calibrated: Simulator
    augmented: Simulator
    noise: NoiseModel
    calibration: Mapping[str, Mapping[str, Estimate]] = dataclasses.field(default_factory=dict)
    recalibration: Mapping[str, Mapping[str, Estimate]] = dataclasses.field(default_factory=dict)
    wrong: tuple[str, ...] = ()
    alignment: tuple[Alignment, ...] = ()
    remarks: tuple[str, ...] = ()
    traces: tuple[Trace, ...] = dataclasses.field(default=(), repr=False, compare=False)
    simulator: str = "simulator"
    recordings: Mapping[str, Mapping[str, str]] = dataclasses.field(default_factory=dict)
    healthy: float | None = None
    probability: float | None = None
    steps: tuple[Step, ...] = ()
    in_part: tuple[InPart, ...] = ()

    def __post_init__(self) -> None:
        if self.verdict not in VERDICTS:
            raise InputError(f"diagnosis: verdict is {self.verdict!r}; it must be one of {', '.join(VERDICTS)}")
        for probability in [cause.probability for cause in self.causes] + [other.probability for other in self.alternatives]:
            if not -1e-9 <= probability <= 1.0 + 1e-9:
                raise InputError(f"diagnosis: a probability is {probability}; it must lie between 0 and 1")

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
    def changed(self) -> bool:
        """Whether anything was added to the simulator: where not, before and after are one."""
        if not self.traces:
            return self.train.baseline_rms != self.train.augmented_rms
        return any(
            float(np.abs(trace.before_deg_h - trace.after_deg_h).max()) > _ROUNDING * float(np.ptp(trace.before_deg_h))
            for trace in self.traces
        )

    @property
    def contradicted(self) -> bool:
        """Whether nothing is unknown but what there is instead of the causes: held-out runs deny them."""
        apart = self.steps or self.in_part or self.unexplained.probability is not None
        return self.verdict == "unknown" and not apart and contradicted(self.test, [cause.mechanism for cause in self.causes])

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

    # --- keeping it --------------------------------------------------------------------------------------------------------

    def save(self, folder: str | Path) -> None:
        """Write `diagnosis.json` and `augmented.yaml` into a folder, which must exist."""
        write_json(Path(folder) / "diagnosis.json", self.to_mapping())
        self.augmented.to_yaml(Path(folder) / "augmented.yaml")

    def report(self, path: str | Path, executor: Executor | None = None) -> None:
        """Write the page that shows it: one self-contained HTML file. An executor, where given, draws the pictures."""
        from rlgcomp.diagnosis.result.page import write_diagnosis_report

        write_diagnosis_report(path, self, executor)


def _plain(parameters: Mapping[str, Mapping[str, Estimate]]) -> dict[str, dict[str, Any]]:
    return {name: {key: dataclasses.asdict(estimate) for key, estimate in of.items()} for name, of in parameters.items()}
