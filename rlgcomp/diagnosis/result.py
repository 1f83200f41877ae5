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
import numpy.typing as npt
import pandas as pd

from rlgcomp.diagnosis import wording
from rlgcomp.errors import InputError
from rlgcomp.files import sha256, to_json, write_json
from rlgcomp.noise import NoiseModel
from rlgcomp.physics.mechanism import Mechanism
from rlgcomp.simulation.simulator import Simulator

Array = npt.NDArray[np.float64]
SCHEMA: Final = "rlgcomp.diagnosis/1"
Verdict = Literal["none", "explained", "ambiguous", "unknown"]
VERDICTS: Final = ("none", "explained", "ambiguous", "unknown")


@dataclasses.dataclass(frozen=True)
class Place:
    """Where the mismatch is: a run and interval, a regime of the monitors, a frequency, or a harmonic of the table's angle.

    Parameters
    ----------
    run, channel : str
    start_s, end_s : float, optional
        Interval in the run's own time; None where the place is no interval.
    regime : str, optional
        As "temperature_block_degC > 31, cooling".
    frequency_hz, angle_harmonic : float, optional
    share : float
        Of the sum of squares that the baseline leaves beyond noise, between 0 and 1.
    p_value : float
        Corrected for everything that was searched.
    """

    run: str
    channel: str
    start_s: float | None = None
    end_s: float | None = None
    regime: str | None = None
    frequency_hz: float | None = None
    angle_harmonic: float | None = None
    share: float = 0.0
    p_value: float = 1.0


@dataclasses.dataclass(frozen=True)
class Estimate:
    """A number with its standard deviation and unit."""

    value: float
    sd: float
    unit: str = ""

    def __str__(self) -> str:
        return wording.quantity(self.value, self.sd, self.unit)


@dataclasses.dataclass(frozen=True)
class Cause:
    """A mechanism that the simulator is missing.

    Parameters
    ----------
    mechanism : Mechanism
        With the fitted parameters.
    probability : float
        That it is part of the truth: the sum over all sets that hold it.
    parameters : mapping of str to Estimate
        The fitted ones, by name.
    rms_deg_h : float
        Of its contribution at window means over the training runs.
    indistinguishable_from : tuple of str
        Mechanisms that these data cannot tell from it.
    drivers : tuple of str
        Columns that it read; by default those that it names itself.
    """

    mechanism: Mechanism
    probability: float
    parameters: Mapping[str, Estimate]
    rms_deg_h: float
    indistinguishable_from: tuple[str, ...] = ()
    drivers: tuple[str, ...] = ()

    @property
    def name(self) -> str:
        return self.mechanism.name

    def to_mapping(self) -> dict[str, Any]:
        """An entry of `findings`."""
        return {
            "mechanism": self.name,
            "probability": self.probability,
            "parameters": {name: dataclasses.asdict(estimate) for name, estimate in self.parameters.items()},
            "settings": {p.name: getattr(self.mechanism, p.name) for p in self.mechanism.parameters() if p.role == "setting"},
            "equation": self.mechanism.stated(),
            "drivers": list(self.drivers or self.mechanism.driver_names()),
            "rms": {"value": self.rms_deg_h, "unit": "deg/h"},
            "indistinguishable_from": list(self.indistinguishable_from),
            "reference": self.mechanism.reference,
        }


@dataclasses.dataclass(frozen=True)
class Alternative:
    """Another set of mechanisms, the empty one included, and its probability."""

    mechanisms: tuple[str, ...]
    probability: float


@dataclasses.dataclass(frozen=True)
class Unexplained:
    """What is left when the named mechanisms are taken out.

    Parameters
    ----------
    p_value : float
        That it is noise.
    drivers : tuple of str
        Recorded columns that it follows; empty when it follows none.
    memory : {"static", "dynamic", "rate-independent", "none"}
    equation : str, optional
        The best law found.
    """

    p_value: float
    drivers: tuple[str, ...] = ()
    memory: str = "none"
    equation: str | None = None


@dataclasses.dataclass(frozen=True)
class RunFit:
    """One run before and after.

    Parameters
    ----------
    run : str
    baseline_rms, augmented_rms, noise_floor_rms : float
        Of window means, a constant offset of the run included.
    baseline_std, augmented_std : float
        About the run's own mean, which a gyro changes from switch-on to switch-on.
    improvement : float
        1 - augmented / baseline, of the rms.
    improvement_ci95 : tuple of float
        By circular block bootstrap.
    compensation_rms : float, optional
        That the black box leaves.
    """

    run: str
    baseline_rms: float
    augmented_rms: float
    noise_floor_rms: float
    baseline_std: float
    augmented_std: float
    improvement: float
    improvement_ci95: tuple[float, float]
    compensation_rms: float | None = None


@dataclasses.dataclass(frozen=True)
class Fit:
    """A set of runs before and after.

    Parameters
    ----------
    baseline_rms, augmented_rms : float
        Of window means of what the calibrated and the augmented simulator leave, a constant offset of each run included.
    noise_floor_rms : float
        What the noise model alone would leave in window means, its correlated part included.
    unit : str
    averaging_s : float
    improvement : float
        1 - augmented / baseline.
    improvement_ci95 : tuple of float
        By circular block bootstrap within runs.
    per_run : tuple of RunFit
    compensation_rms : float, optional
        What an LS-SVM leaves that was trained on the same training runs.
    baseline_std, augmented_std, compensation_std : float, optional
        The same about each run's own mean: what counts where a gyro's bias changes from switch-on to switch-on.
    improvement_std, improvement_std_ci95 : optional
        Improvement about each run's own mean.
    white_floor_rms : float, optional
        Of the white part of the noise alone.
    whiteness_p_value : float, optional
        That what the augmented simulator leaves is nothing but the noise of its model.
    """

    baseline_rms: float
    augmented_rms: float
    noise_floor_rms: float
    unit: str
    averaging_s: float
    improvement: float
    improvement_ci95: tuple[float, float]
    per_run: tuple[RunFit, ...] = ()
    compensation_rms: float | None = None
    baseline_std: float | None = None
    augmented_std: float | None = None
    compensation_std: float | None = None
    improvement_std: float | None = None
    improvement_std_ci95: tuple[float, float] | None = None
    white_floor_rms: float | None = None
    whiteness_p_value: float | None = None


@dataclasses.dataclass(frozen=True)
class Trace:
    """Window means of one run, for pictures.

    Parameters
    ----------
    run : str
    held_out : bool
    time_s : ndarray, shape (n,)
        Middle of each window.
    before_deg_h, after_deg_h : ndarray, shape (n,)
        What the calibrated and the augmented simulator leave.
    compensation_deg_h : ndarray, shape (n,), optional
        What the black box leaves.
    monitors : pandas.DataFrame
        Window means of the recorded columns that are no gyro.
    added_deg_h : mapping of str to ndarray, shape (n,)
        What each mechanism contributes that the augmented simulator has and the calibrated one lacks.
    channel : str
        Gyro column.
    """

    run: str
    held_out: bool
    time_s: Array
    before_deg_h: Array
    after_deg_h: Array
    compensation_deg_h: Array | None
    monitors: pd.DataFrame
    added_deg_h: Mapping[str, Array]
    channel: str


@dataclasses.dataclass(frozen=True)
class Alignment:
    """How the clock of the user's simulation of one run stands against that of the recording.

    Parameters
    ----------
    run : str
    offset_s, offset_sd_s : float
        The recording shows at time t what the simulation shows at t - epoch - offset - drift · (t - start).
    drift_ppm, drift_ppm_sd : float
    p_value : float
        That there is neither offset nor drift.
    compared : str
        The column both were compared in.
    epoch_s : float
        What was added to the simulation's time beforehand, because the two did not count from one epoch.
    taken_out : bool
        Offset and drift were taken out: they are significant, and nothing else explains them.
    """

    run: str
    offset_s: float
    offset_sd_s: float
    drift_ppm: float
    drift_ppm_sd: float
    p_value: float
    compared: str
    epoch_s: float = 0.0
    taken_out: bool = True


@dataclasses.dataclass(frozen=True)
class NextExperiment:
    """The programme that would tell rival explanations apart.

    Parameters
    ----------
    separates : tuple of str
    profile : str
        A chamber or turntable programme that `rlgcomp simulate --profile` takes.
    expected_probability_after : float
        Of whichever explanation is true, once that programme was run.
    """

    separates: tuple[str, ...]
    profile: str
    expected_probability_after: float


@dataclasses.dataclass(frozen=True, repr=False)
class Diagnosis:
    """What a simulator is missing.

    Parameters
    ----------
    verdict : {"none", "explained", "ambiguous", "unknown"}
    p_value : float
        That the calibrated simulator lacks nothing, given the noise it has.
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
        Fitted baseline parameters by mechanism and name, as :class:`Estimate`.
    alignment : tuple of Alignment
        Of the user's own simulation, one entry a run.
    remarks : tuple of str
        What a careful reader should know, in sentences.
    traces : tuple of Trace
        Window means of every run, for pictures; not part of the JSON.
    simulator : str
        What the baseline is called.
    recordings : mapping of str to mapping of str to str
        Under "train" and "test": SHA-256 of the files, by name, where runs were read from files.

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
    alignment: tuple[Alignment, ...] = ()
    remarks: tuple[str, ...] = ()
    traces: tuple[Trace, ...] = dataclasses.field(default=(), repr=False, compare=False)
    simulator: str = "simulator"
    recordings: Mapping[str, Mapping[str, str]] = dataclasses.field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.verdict not in VERDICTS:
            raise InputError(f"diagnosis: verdict is {self.verdict!r}; it must be one of {', '.join(VERDICTS)}")
        for probability in [cause.probability for cause in self.causes] + [other.probability for other in self.alternatives]:
            if not -1e-9 <= probability <= 1.0 + 1e-9:
                raise InputError(f"diagnosis: a probability is {probability}; it must lie between 0 and 1")

    def of_files(self, train: Sequence[Path], test: Sequence[Path] = ()) -> Self:
        """The same, with the SHA-256 of the files that the runs were read from."""
        files = {"train": train, "test": test}
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
        return wording.verdict_sentence(self)

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
            "alternatives": [dataclasses.asdict(alternative) for alternative in self.alternatives],
            "unexplained": dataclasses.asdict(self.unexplained),
            "fit": {
                "train": dataclasses.asdict(self.train),
                "test": None if self.test is None else dataclasses.asdict(self.test),
            },
            "next_experiment": None if next_up is None else dataclasses.asdict(next_up),
            "sentence": self.sentence,
            "simulator": self.simulator,
            "recordings": {part: dict(files) for part, files in self.recordings.items()},
            "baseline": {
                mechanism: {name: dataclasses.asdict(estimate) for name, estimate in parameters.items()}
                for mechanism, parameters in self.calibration.items()
            },
            "noise": dataclasses.asdict(self.noise),
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

    # --- keeping it --------------------------------------------------------------------------------------------------------

    def save(self, folder: str | Path) -> None:
        """Write `diagnosis.json` and `augmented.yaml` into a folder, which must exist."""
        write_json(Path(folder) / "diagnosis.json", self.to_mapping())
        self.augmented.to_yaml(Path(folder) / "augmented.yaml")

    def report(self, path: str | Path, executor: Executor | None = None) -> None:
        """Write the page that shows it: one self-contained HTML file. An executor, where given, draws the pictures."""
        from rlgcomp.diagnosis.page import write_diagnosis_report

        write_diagnosis_report(path, self, executor)
