"""One diagnosis from beginning to end."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from rlgcomp.diagnosis.engine.baseline import Baseline
from rlgcomp.diagnosis.engine.data import Data, Grid, Run
from rlgcomp.diagnosis.engine.decide import Decision, Named, decided
from rlgcomp.diagnosis.engine.drivers import Driver
from rlgcomp.diagnosis.engine.evidence import Bank
from rlgcomp.diagnosis.engine.fit import Estimate, Fit
from rlgcomp.diagnosis.engine.noise import Noise
from rlgcomp.diagnosis.engine.nuisances import nuisances
from rlgcomp.diagnosis.engine.posterior import Posterior
from rlgcomp.diagnosis.engine.regions import Setting, laws, named, own_bases
from rlgcomp.diagnosis.engine.search import State
from rlgcomp.numerics.bootstrap import drawn_squares
from rlgcomp.physics import CATALOGUE
from rlgcomp.physics.mechanism import Mechanism
from rlgcomp.recording import Recording
from rlgcomp.recording.argument_checks import require_recordings
from rlgcomp.simulation.simulator import Simulator

Array = npt.NDArray[np.float64]
SCHEMA: Final = "rlgcomp.diagnosis/1"
_BLOCKS: Final = 8  # of a run, of the bootstrap
_ALTERNATIVES: Final = 5
_LEAST_ALTERNATIVE: Final = 1e-3


@dataclasses.dataclass(frozen=True, eq=False)
class Augmented:
    """The simulator with what was found, as a predictor of recordings."""

    fit: Fit
    grid: Grid

    def predict(self, recording: Recording) -> Recording:
        """The gyro that is expected, given a recording's own monitors: the same rows, column `gyro_deg_h`."""
        table = recording.table.drop(columns=list(recording.gyro_columns))
        table.insert(1, "gyro_deg_h", self.fit.rate_deg_h(recording, self.grid))
        return recording.replace(table=table, truth=None, findings=())


@dataclasses.dataclass(frozen=True, eq=False)
class Diagnosis:
    """What is missing, how probable it is, and what it leaves of training and test runs.

    Parameters
    ----------
    decision : Decision
    posterior : Posterior
    before, after : Fit
        The simulator calibrated, and with what was found.
    test : tuple of Run
        Runs that decide nothing.
    catalogue : mapping of str to type of Mechanism
    """

    decision: Decision
    posterior: Posterior
    before: Fit
    after: Fit
    test: tuple[Run, ...]
    catalogue: Mapping[str, type[Mechanism]]

    @property
    def verdict(self) -> str:
        return self.decision.verdict

    @functools.cached_property
    def calibrated(self) -> Augmented:
        return Augmented(self.before, self.before.data.runs[0].grid)

    @functools.cached_property
    def augmented(self) -> Augmented:
        return Augmented(self.after, self.after.data.runs[0].grid)

    def to_mapping(self) -> dict[str, Any]:
        """Content of `diagnosis.json`."""
        decision, posterior = self.decision, self.posterior
        findings = [self._finding(one) for one in decision.named if one.mechanism is not None]
        laws_found = [posterior.regions[member.form.region] for member in self.after.state.members]
        equations = [
            member.form.equation
            for member, region in zip(self.after.state.members, laws_found, strict=True)
            if region.mechanism is None and not region.nuisance
        ]
        ordered = sorted(posterior.probabilities.items(), key=lambda item: item[1], reverse=True)
        alternatives = [
            {"mechanisms": sorted(_names(regions, latent)), "probability": p}
            for (regions, latent), p in ordered[1 : 1 + _ALTERNATIVES]
            if p > _LEAST_ALTERNATIVE
        ]
        return {
            "schema": SCHEMA,
            "verdict": decision.verdict,
            "mismatch": {"p_value": min(posterior.null, 1.0), "where": self._places()},
            "findings": findings,
            "alternatives": alternatives,
            "unexplained": {
                "p_value": min(posterior.null, 1.0),
                "drivers": list(decision.drivers),
                "memory": decision.memory,
                "equation": "; ".join(equations) or None,
            },
            "fit": {"train": self.scores(self.after.data.runs), "test": self.scores(self.test) if self.test else None},
            "probability": posterior.probabilities[posterior.best.key],
            "nothing_missing": min(posterior.null, 1.0),
            "steps": self.after.steps,
            "baseline": _plain(self.before),
            "baseline_with_findings": _plain(self.after),
            "next_experiment": None,
            "remarks": [],
        }

    def _finding(self, one: Named) -> dict[str, Any]:
        form: dict[str, Any] = {"mechanism": one.mechanism, "probability": one.probability}
        members = [member.form.region for member in self.after.state.members]
        seen = self.after.state.telegraph
        if one.region in members:
            k = members.index(one.region)
            assert one.mechanism is not None  # noqa: S101
            estimates = self.after.parameters(k, self.catalogue.get(one.mechanism))
            contribution = self.after.data.means(functools.partial(self.after.term, k))
            equation, drivers = self.after.state.members[k].form.equation, list(self.posterior.regions[one.region].drivers)
            function, rms = self.after.function(k), float(np.std(contribution))
        else:
            assert seen is not None  # noqa: S101
            window_s = self.after.data.runs[0].grid.window_s
            error = seen.sigma / np.sqrt(len(self.after.data))
            estimates = {
                "half_step_deg_h": Estimate(seen.half_step, float(error), "deg/h"),
                "dwell_s": Estimate(seen.dwell * window_s, float(seen.dwell * window_s / np.sqrt(seen.jumps)), "s"),
            }
            equation, drivers, function, rms = "b = half_step_deg_h * (+1 or -1)", [], {}, seen.half_step
        return form | {
            "parameters": {name: estimate.to_mapping() for name, estimate in estimates.items()},
            "equation": equation,
            "function": function,
            "drivers": drivers,
            "rms": {"value": rms, "unit": "deg/h"},
            "indistinguishable_from": list(one.indistinguishable_from),
        }

    def _places(self) -> list[dict[str, Any]]:
        """Share of the mismatch by run."""
        if self.decision.verdict == "none":
            return []
        before = [self.before.residual(run) for run in self.after.data.runs]
        total = sum(float(left @ left) for left in before)
        places = []
        for run, left in zip(self.after.data.runs, before, strict=True):
            places.append(
                {
                    "run": run.name,
                    "channel": run.binned.gyro_columns[0],
                    "start_s": float(run.binned.time_s[0]),
                    "end_s": float(run.binned.time_s[-1]),
                    "regime": None,
                    "frequency_hz": None,
                    "angle_harmonic": None,
                    "share": float(left @ left) / total,
                    "p_value": min(self.posterior.null, 1.0),
                }
            )
        return places

    def scores(self, runs: Sequence[Run]) -> dict[str, Any]:
        """Root mean squares of runs before and after, and the improvement with its interval."""
        pairs = [(self.before.residual(run), self.after.residual(run)) for run in runs]
        before, after = (float(np.sqrt(np.mean(np.concatenate(left) ** 2))) for left in zip(*pairs, strict=True))
        rng = np.random.default_rng(0)
        drawn = [drawn_squares(pair, block=max(1, len(pair[0]) // _BLOCKS), rng=rng)[0] for pair in pairs]
        ratios = np.sqrt(sum(b[1] for b in drawn) / sum(b[0] for b in drawn))
        low, high = np.quantile(1.0 - ratios, [0.025, 0.975])
        return {
            "baseline_rms": before,
            "augmented_rms": after,
            "noise_floor_rms": self.after.noise_rms,
            "unit": "deg/h",
            "averaging_s": self.after.data.runs[0].grid.window_s,
            "improvement": 1.0 - after / before,
            "improvement_ci95": [float(low), float(high)],
            "per_run": [
                {"run": run.name, "baseline_rms": _rms(pair[0]), "augmented_rms": _rms(pair[1])}
                for run, pair in zip(runs, pairs, strict=True)
            ],
        }


def diagnose(
    simulator: Simulator,
    train: Sequence[Recording],
    test: Sequence[Recording] = (),
    *,
    mechanisms: Mapping[str, type[Mechanism]] = CATALOGUE,
    gyro: str | None = None,
) -> Diagnosis:
    """Diagnose what physics a simulator of chamber runs is missing.

    Parameters
    ----------
    simulator : Simulator
        Of kind "chamber".
    train : sequence of Recording
        Runs that name and fit.
    test : sequence of Recording
        Runs that decide nothing.
    mechanisms : mapping of str to type of Mechanism
        Candidates.
    gyro : str, optional
        Gyro column, where there are several.

    Raises
    ------
    InputError
        No training run is given, or a run lacks a monitor of the simulator.
    """
    train, test = require_recordings(train, "train"), require_recordings(test, "test") if test else ()
    stated = Baseline(simulator)
    grid = Grid.of(train)

    def output(binned: Recording) -> Array:
        return np.asarray(binned.rate_deg_h(gyro) - stated.stated(binned))

    data = Data(tuple(Run.of(recording, grid, output) for recording in train))
    setting = Setting(data, Driver.of(data, train[0].temperature_column))
    present = [mechanism.name for mechanism in simulator.mechanisms]
    baseline = Baseline.calibrated(simulator, data)
    baseline = dataclasses.replace(baseline, own=own_bases(setting, present)).linearised(data)
    bank = Bank(data, baseline.design(data))
    known = list(named(setting, mechanisms, present))
    posterior = Posterior.of(bank, [*known, *laws(setting, known), *nuisances(data, baseline)])
    decision = decided(posterior)
    null = State((), Noise(), 0.0)
    null = next((state for state in posterior.states if state.key == null.key), null)
    best = posterior.best
    if decision.verdict == "none" and (posterior.effects(best.key) or best.key[1]):
        best = next((state for state in posterior.states if not posterior.effects(state.key) and not state.key[1]), null)
    runs = tuple(Run.of(recording, grid, output) for recording in test)
    return Diagnosis(decision, posterior, Fit(data, baseline, bank, null), Fit(data, baseline, bank, best), runs, mechanisms)


def _names(regions: frozenset[str], latent: str) -> list[str]:
    return [*regions, *({"telegraph": ["random_telegraph"], "wander": ["unrecorded"]}.get(latent, []))]


def _plain(fit: Fit) -> dict[str, dict[str, dict[str, object]]]:
    return {name: {key: one.to_mapping() for key, one in numbers.items()} for name, numbers in fit.numbers.items()}


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))
