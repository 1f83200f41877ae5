"""The data of a diagnosis, which its messages, its text and its page read."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Mapping
from typing import Any, Final

import numpy as np

from rlgcomp.diagnosis.answer.black_box import REFERENCE, BlackBox
from rlgcomp.diagnosis.answer.fit import Estimate, Fit
from rlgcomp.diagnosis.answer.left_over import LeftOver, left_over
from rlgcomp.diagnosis.answer.mismatch import parts
from rlgcomp.diagnosis.answer.posterior import Posterior
from rlgcomp.diagnosis.answer.scores import Score, score
from rlgcomp.diagnosis.data import Run
from rlgcomp.diagnosis.decide import Decision
from rlgcomp.diagnosis.equations.findings import DEG_H, Cause, cause_of, in_unit
from rlgcomp.diagnosis.equations.simulator_file import SimulatorFile, noise_of, residual_of, simulator_of
from rlgcomp.diagnosis.forms.drivers import Driver
from rlgcomp.diagnosis.regions.nuisances import RUN_BIAS
from rlgcomp.diagnosis.simulators.resampling import Alignment
from rlgcomp.noise.processes import NoiseModel
from rlgcomp.physics.mechanism import Mechanism
from rlgcomp.recording import is_gyro
from rlgcomp.recording.provenance import provenance
from rlgcomp.report.messages import Message
from rlgcomp.simulation.simulator import Simulator

EVIDENCE: Final = "R. E. Kass, A. E. Raftery, J. Am. Stat. Assoc. 90, 773 (1995) (comparison of sets by their evidence)."
BOOTSTRAP: Final = "D. N. Politis, J. P. Romano, in Exploring the Limits of Bootstrap, Wiley, 1992 (circular block bootstrap)."
_ALTERNATIVES: Final = 5
_LEAST_ALTERNATIVE: Final = 1e-3
LATENT: Final = {"telegraph": ["random_telegraph"], "wander": ["unrecorded"]}


@dataclasses.dataclass(frozen=True)
class Place:
    """A place of the mismatch: the interval of a run that holds most of it, or that of a regime of the monitors.

    Parameters
    ----------
    run, channel : str
    start_s, end_s : float
        In the run's own time.
    regime : str, optional
    frequency_hz, angle_harmonic : None
        Kept for readers of `diagnosis.json`.
    share : float
        Of the sum of squares of what is missing, over all training runs; shares of regimes are of the same sum.
    p_value : float
    """

    run: str
    channel: str
    start_s: float
    end_s: float
    regime: str | None = None
    frequency_hz: None = None
    angle_harmonic: None = None
    share: float = 0.0
    p_value: float = 1.0


@dataclasses.dataclass(frozen=True)
class Alternative:
    """Another set of mechanisms and laws, the empty one included, and its probability."""

    mechanisms: tuple[str, ...]
    probability: float


@dataclasses.dataclass(frozen=True)
class NextExperiment:
    """A programme whose run would part the likely sets.

    Parameters
    ----------
    separates : tuple of str
        Sets.
    profile : str
        A programme that `rlgcomp simulate --profile` takes.
    expected_probability_after : float
        Of whichever of them is true, averaged over them.
    separation : float
        Root mean square difference of the predictions of the two likeliest, in standard deviations of all of the run's windows.
    duration_s : float
    """

    separates: tuple[str, ...]
    profile: str
    expected_probability_after: float
    separation: float
    duration_s: float


@dataclasses.dataclass(frozen=True)
class Request:
    """What was asked for beside the runs.

    Parameters
    ----------
    simulator : str
        What the baseline is called.
    unit : str
        Of the output.
    channel : str
        The output's column.
    without, only : tuple of str
        Candidates left out; the only ones, where they were named.
    not_tried : tuple of str
        Candidates whose columns the runs lack.
    own_simulator : bool
        The baseline is the user's own, so that the simulators of the result hold only what is added to it.
    seed : int
        Of the draws that p-values and intervals of the improvement are made of.
    """

    simulator: str = "the simulator"
    unit: str = DEG_H
    channel: str = "gyro_deg_h"
    without: tuple[str, ...] = ()
    only: tuple[str, ...] = ()
    not_tried: tuple[str, ...] = ()
    own_simulator: bool = False
    seed: int = 0


@dataclasses.dataclass(frozen=True, eq=False, repr=False)
class Record:
    """What is missing, how probable it is, and what it leaves of the runs.

    Parameters
    ----------
    decision : Decision
    posterior : Posterior
    before, after : Fit
        The simulator calibrated, and with the findings, fitted to the training runs.
    confirm_runs, test_runs : tuple of Run
        Runs that take part in the choice alone, and runs that decide nothing.
    catalogue : mapping of str to type of Mechanism
    request : Request
    preparation : tuple of Message
        What was done to the runs beforehand.
    warnings : tuple of Message
        What is probably wrong with the user's own simulation.
    alignment : tuple of Alignment
        How the clocks of simulated runs stand.
    next_experiment : NextExperiment, optional
    next_message : Message, optional
        What the next experiment promises, or that none parts the likely sets.
    black_box : BlackBox, optional
        The compensation at its best on the same split.
    made : mapping
        Version, date and command.
    recordings : mapping of str to mapping of str to str
        SHA-256 of files by name under "train", "confirm", "test" and "simulator".
    """

    decision: Decision
    posterior: Posterior
    before: Fit
    after: Fit
    confirm_runs: tuple[Run, ...]
    test_runs: tuple[Run, ...]
    catalogue: Mapping[str, type[Mechanism]]
    request: Request = dataclasses.field(default_factory=Request)
    preparation: tuple[Message, ...] = ()
    warnings: tuple[Message, ...] = ()
    alignment: tuple[Alignment, ...] = ()
    next_experiment: NextExperiment | None = None
    next_message: Message | None = None
    black_box: BlackBox | None = None
    made: Mapping[str, Any] = dataclasses.field(default_factory=provenance)
    recordings: Mapping[str, Mapping[str, str]] = dataclasses.field(default_factory=dict)

    # --- the verdict -----------------------------------------------------------------------------------------------------------

    @property
    def verdict(self) -> str:
        return self.decision.verdict

    @property
    def unit(self) -> str:
        """Of the output."""
        return self.request.unit

    @property
    def probability(self) -> float:
        """Of the set that is named."""
        return min(self.posterior.of_effects[self.posterior.effects_of(self.posterior.best)], 1.0)

    @property
    def healthy(self) -> float:
        """Probability that nothing is missing."""
        return min(self.posterior.null, 1.0)

    @property
    def p_value(self) -> float:
        """Of nothing missing; of as much noise as there is, where that was stated."""
        return min(self.posterior.p_value, self.after.excess[1])

    @property
    def unexplained_p_value(self) -> float:
        """Of nothing missing beside the mechanisms that are named."""
        return self.posterior.left_in_noise if self.verdict in ("explained", "ambiguous") else self.p_value

    @functools.cached_property
    def members(self) -> tuple[Cause, ...]:
        """All that is named, laws without a name included, the most probable first."""
        return tuple(cause_of(one, self.after, self.posterior, self.catalogue, self.unit) for one in self.decision.named)

    @property
    def causes(self) -> tuple[Cause, ...]:
        """The mechanisms that are named."""
        return tuple(one for one in self.members if one.named)

    @property
    def laws(self) -> tuple[Cause, ...]:
        """The laws without a name."""
        return tuple(one for one in self.members if not one.named)

    @property
    def slow_error_rms(self) -> float:
        """Standard deviation of the slow error of no recorded column that the likeliest set has; zero without one."""
        latent = self.posterior.effects_of(self.posterior.best)[1] == "wander" and self.verdict != "none"
        return self.after.white * self.after.state.wander if latent or self.decision.wander else 0.0

    @property
    def slow_error_probability(self) -> float:
        """Of a slow error of no recorded column, in whatever set."""
        return min(self.posterior.of_latent("wander"), 1.0)

    @functools.cached_property
    def alternatives(self) -> tuple[Alternative, ...]:
        """The next most probable sets."""
        ordered = sorted(self.posterior.of_effects.items(), key=lambda item: item[1], reverse=True)
        return tuple(
            Alternative(tuple(sorted([*regions, *LATENT.get(latent, [])])), p)
            for (regions, latent), p in ordered[1 : 1 + _ALTERNATIVES]
            if p > _LEAST_ALTERNATIVE
        )

    @functools.cached_property
    def where(self) -> tuple[Place, ...]:
        """Runs with the interval that holds most of the mismatch, and regimes of the driver that most of it follows."""
        if self.verdict == "none":
            return ()
        leading = max((one for one in self.members if one.drivers), key=lambda one: one.rms, default=None)
        data, column = self.after.data, None if leading is None else leading.drivers[0]
        driver = Driver.of(data, column) if column in data.columns else None
        return tuple(
            Place(
                part.run,
                self.request.channel,
                part.start_s,
                part.end_s,
                regime=None if part.regime is None else f"{column} {part.regime}",
                share=part.share,
                p_value=self.p_value,
            )
            for part in parts(self.before, self.after, driver)
        )

    # --- the runs --------------------------------------------------------------------------------------------------------------

    @functools.cached_property
    def train(self) -> Score:
        """The training runs before and after."""
        found = score(self.before, self.after, self.after.data.runs, self.unit, self.request.seed)
        assert found is not None  # noqa: S101
        return found

    @functools.cached_property
    def confirm(self) -> Score | None:
        """The runs that took part in the choice alone."""
        return score(self.before, self.after, self.confirm_runs, self.unit, self.request.seed, self.black_box)

    @functools.cached_property
    def test(self) -> Score | None:
        """The test runs: the proof."""
        return score(self.before, self.after, self.test_runs, self.unit, self.request.seed, self.black_box)

    @functools.cached_property
    def left_over(self) -> dict[str, list[LeftOver]]:
        """Runs of which more is left than noise, by group; none where a latent cause or more noise than stated accounts for it."""
        if self.latent or self.decision.louder or self.slow_error_rms:
            return {}
        biases = RUN_BIAS in self.recalibration
        parts = {"training": self.after.data.runs, "confirm": self.confirm_runs, "test": self.test_runs}
        found = {part: list(left_over(self.after, runs, biases=biases)) for part, runs in parts.items()}
        return {part: of_part for part, of_part in found.items() if of_part}

    @property
    def latent(self) -> tuple[str, ...]:
        """Named causes that follow no recorded column."""
        named = [one.name for one in self.members if not one.drivers and one.function is None]
        return (*named, *(["wander"] if self.decision.wander else []))

    @property
    def learnt(self) -> float | None:
        """Share of what the findings leave, squared and beyond white noise, that the LS-SVM predicts of runs it was not trained on.

        Each run is taken about its own mean, which a calibrated simulator has wrong where it drifts. None where the LS-SVM has no
        clearly smaller error, or where there is no such run and a finding follows a recorded column.
        """
        if self.black_box is None:
            return None
        window_s = self.train.averaging_s
        proof = self.test or self.confirm
        if proof is not None and proof.compensation_std is not None and proof.over_compensation_std_ci95 is not None:
            if proof.over_compensation_std_ci95[1] >= 0.0:
                return None
            unexplained = min(proof.augmented_std, proof.baseline_std)  # findings may have made it larger
            left, averaging_s = proof.compensation_std, window_s
        elif any(one.drivers for one in self.members):
            return None
        else:
            unexplained, left, averaging_s = self.train.baseline_std, self.black_box.left_out_rms, self.black_box.averaging_s
        mismatch = unexplained**2 - self.after.white**2
        left_of_it = left**2 - self.after.white**2 * window_s / averaging_s
        return 1.0 - max(left_of_it, 0.0) / mismatch if mismatch > 0.0 else None

    # --- simulators ------------------------------------------------------------------------------------------------------------

    @functools.cached_property
    def calibrated_file(self) -> SimulatorFile:
        return self._file(self.before)

    @functools.cached_property
    def augmented_file(self) -> SimulatorFile:
        return self._file(self.after)

    def _file(self, fit: Fit) -> SimulatorFile:
        found, channel = simulator_of(fit, self.catalogue), self.request.channel
        if is_gyro(channel):
            return found
        return dataclasses.replace(found, simulator=dataclasses.replace(found.simulator, output=channel))

    @property
    def calibrated(self) -> Simulator:
        """The simulator with its free numbers fitted as if nothing were missing."""
        return self.calibrated_file.simulator

    @property
    def augmented(self) -> Simulator:
        """The simulator with the findings."""
        return self.augmented_file.simulator

    @functools.cached_property
    def file_rms(self) -> float | None:
        """What augmented.yaml by itself leaves of the test runs; None without them, or where each run has numbers of its own."""
        if not self.test_runs or self.after.baseline.by_run:
            return None
        left = np.concatenate([residual_of(self.augmented, self.after, run) for run in self.test_runs])
        return float(np.sqrt(np.mean(left**2)))

    @property
    def noise(self) -> NoiseModel:
        return noise_of(self.after)

    @property
    def steps(self) -> list[dict[str, Any]]:
        """Steps of the bias in single training runs, each with its run, time and size."""
        found: list[dict[str, Any]] = []
        for step in self.after.steps:
            size: Any = step["size"]
            found.append({**step, "size": {**size, "unit": in_unit(size["unit"], self.unit)}})
        return found

    @property
    def calibration(self) -> dict[str, dict[str, Estimate]]:
        """Numbers of the baseline as if nothing were missing, by mechanism and name."""
        return self._numbers(self.before)

    @property
    def recalibration(self) -> dict[str, dict[str, Estimate]]:
        """The same, fitted together with the findings."""
        return self._numbers(self.after)

    def _numbers(self, fit: Fit) -> dict[str, dict[str, Estimate]]:
        return {
            name: {key: dataclasses.replace(one, unit=in_unit(one.unit, self.unit)) for key, one in numbers.items()}
            for name, numbers in fit.numbers.items()
        }

    @property
    def citations(self) -> tuple[str, ...]:
        """Sources of the mechanisms and methods that were used, each once."""
        found = [self.catalogue[cause.name].reference for cause in self.causes if cause.name in self.catalogue]
        found += [mechanism.reference for mechanism in self.augmented.mechanisms]
        found += [EVIDENCE, *([] if self.test is None else [BOOTSTRAP]), *([] if self.black_box is None else [REFERENCE])]
        return tuple(dict.fromkeys(found))

    @property
    def provenance(self) -> dict[str, Any]:
        """Version, date, command, seed, and the SHA-256 of the files that were read."""
        inputs = {file: digest for files in self.recordings.values() for file, digest in files.items()}
        return {**self.made, "seed": self.request.seed, "inputs": inputs}
