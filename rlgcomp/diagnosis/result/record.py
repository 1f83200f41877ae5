"""The data of a diagnosis, which its text, its tables, its figures and its page read."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Final, Literal

import numpy as np

from rlgcomp.diagnosis.result.findings import Alternative, Cause, Estimate, InPart, NextExperiment, Place, Step, Unexplained
from rlgcomp.diagnosis.result.fits import Alignment, Fit, Trace, contradicted
from rlgcomp.errors import InputError
from rlgcomp.noise.processes import NoiseModel
from rlgcomp.simulation.simulator import Simulator

_ROUNDING: Final = 1e-9
Verdict = Literal["none", "explained", "ambiguous", "unknown"]
VERDICTS: Final = ("none", "explained", "ambiguous", "unknown")


@dataclasses.dataclass(frozen=True, repr=False)
class DiagnosisRecord:
    """What a simulator is missing, as data.

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
