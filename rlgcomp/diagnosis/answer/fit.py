"""The likeliest set fitted: posterior means of all weights, predictions of any run, parameters with their standard deviations."""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from rlgcomp.diagnosis import priors
from rlgcomp.diagnosis.data import Data, Grid, Run
from rlgcomp.diagnosis.evidence.bank import Bank
from rlgcomp.diagnosis.evidence.closed_form import Evidence, Member
from rlgcomp.diagnosis.forms.bases import Basis, Constant, EachRun, Moment, Own, Unsettled
from rlgcomp.diagnosis.forms.terms import Form
from rlgcomp.diagnosis.regions.baseline import Baseline
from rlgcomp.diagnosis.regions.clocks import CLOCK, Offset
from rlgcomp.diagnosis.regions.lateness import LATE_MONITOR, LATE_THERMOMETER, Late
from rlgcomp.diagnosis.regions.nuisances import BEFORE
from rlgcomp.diagnosis.regions.selections import BY_RUN, parameter_by_run
from rlgcomp.diagnosis.search.states import State
from rlgcomp.numerics.robust import LEAST_P_VALUE
from rlgcomp.physics.mechanism import Mechanism
from rlgcomp.recording import Recording
from rlgcomp.report.messages.wording import estimate_text
from rlgcomp.units import is_thermometer

Array = npt.NDArray[np.float64]
_SIDE: Final = 1.0 / 32.0  # step of the grid at which the curvature of the evidence is taken


@dataclasses.dataclass(frozen=True)
class Estimate:
    """A parameter with its standard deviation and unit."""

    value: float
    sd: float
    unit: str

    @property
    def text(self) -> str:
        """Value and standard deviation with the unit, as tables have them."""
        return estimate_text(self.value, self.sd, self.unit)

    def to_mapping(self) -> dict[str, object]:
        """`value`, `sd` and `unit`, as JSON has them."""
        return {"value": self.value, "sd": self.sd, "unit": self.unit}


class Solution(NamedTuple):
    """Numbers of the baseline, weights of all members, covariance of the weights, standard deviation of the white noise."""

    numbers: Array
    weights: Array
    covariance: Array
    white: float


@dataclasses.dataclass(frozen=True, eq=False)
class Fit:
    """A set with its weights.

    Parameters
    ----------
    data : Data
    baseline : Baseline
    bank : Bank
    state : State
        The set; with no members, the simulator calibrated.
    """

    data: Data
    baseline: Baseline
    bank: Bank
    state: State

    @functools.cached_property
    def _evidence(self) -> Evidence:
        return Evidence(self.bank, self.state.noise, 0.0)

    @functools.cached_property
    def parts(self) -> tuple[tuple[Member, tuple[tuple[Basis, float], ...]], ...]:
        """Members, their bases and the scale of each."""
        return tuple(
            (member, tuple((basis, member.size * scale) for basis, scale in self.bank.scaled(member.form) or ()))
            for member in self.state.members
        )

    @functools.cached_property
    def _path(self) -> Array:
        """The process beside the set about its mean, which other runs are predicted with; shape (n,)."""
        seen = self.state.process
        return np.zeros(len(self.data)) if seen is None else seen.half_step * (seen.path - seen.path.mean())

    @functools.cached_property
    def solution(self) -> Solution:
        """The fitted numbers."""
        whitened = self._evidence.whitened
        output = whitened.project((self.data.output - self._path)[:, None])[:, 0]
        table = self._evidence.all_columns(self.state.members)
        inverse = np.linalg.inv(np.eye(table.shape[1]) + table.T @ table)
        weights = inverse @ (table.T @ output)
        square = max(float(output @ output - output @ table @ weights), 0.0) + self.data.known.square
        variance = square / whitened.freedom
        plain = [scale * self.bank.columns(basis) for _, bases in self.parts for basis, scale in bases]
        terms = np.hstack([np.empty((len(self.data), 0)), *plain]) @ weights
        design = whitened.whiten(self.data.means(self.baseline.columns))
        left = whitened.whiten((self.data.output - self._path - terms)[:, None])[:, 0]
        size = np.maximum(np.linalg.norm(design, axis=0), 1e-300)
        numbers = np.linalg.lstsq(design / size, left, rcond=1e-9)[0] / size
        return Solution(numbers, weights, variance * inverse, math.sqrt(variance))

    @property
    def white(self) -> float:
        """Standard deviation of the white noise of a window mean."""
        return self.solution.white

    @functools.cached_property
    def excess(self) -> tuple[float, float]:
        """White noise that these runs alone show, over what is stated, and the probability of as much; (1, 1) of none stated."""
        known = self.data.known
        if not known.windows:
            return 1.0, 1.0
        from scipy.stats import f

        freedom = self._evidence.whitened.freedom - known.windows
        ratio = (self.white**2 * (freedom + known.windows) - known.square) / (freedom * known.white**2)
        return math.sqrt(ratio), max(float(f.sf(ratio, freedom, known.windows)), LEAST_P_VALUE)

    @property
    def noise_rms(self) -> float:
        """Root mean square of the noise of window means about the mean of their run; a wander of something unrecorded is none."""
        noise, total, count = self.state.noise.without_wander, 0.0, 0
        for run, all_rows in zip(self.data.runs, noise.covariances(self.data), strict=True):
            covariance = all_rows[: len(run.windows), : len(run.windows)]
            total += float(np.trace(covariance) - covariance.mean() * len(covariance))
            count += len(covariance)
        return self.white * math.sqrt(total / count)

    @functools.cached_property
    def numbers(self) -> dict[str, dict[str, Estimate]]:
        """Numbers of the baseline by mechanism; stated ones that were found wrong and biases of runs among them."""
        whitened = self._evidence.whitened
        design = whitened.whiten(self.data.means(self.baseline.columns))
        size = np.maximum(np.linalg.norm(design, axis=0), 1e-300)
        spread = self.white * np.sqrt(np.diag(np.linalg.pinv((design / size).T @ (design / size), rcond=1e-12))) / size
        found: dict[str, dict[str, Estimate]] = {}
        mechanisms = {mechanism.name: mechanism for mechanism in self.baseline.simulator.mechanisms}
        for (name, parameter, unit), value, sd in zip(self.baseline.names(), self.solution.numbers, spread, strict=True):
            at = getattr(mechanisms[name], parameter) if name and parameter in _shapes(mechanisms[name]) else None
            estimate = (
                Estimate(float(value), float(sd), unit) if at is None else Estimate(at * (1.0 + value), abs(at) * float(sd), unit)
            )
            found.setdefault(name, {})[parameter] = estimate
        for k in range(len(self.parts)):
            name, more = self._stated(k)
            if more:
                found.setdefault(name, {}).update(more)
        return found

    def _stated(self, k: int) -> tuple[str, dict[str, Estimate]]:
        """Numbers of what is no physics in the k-th member, and the name they stand under; none of any other member."""
        member, ((lead, scale), *_) = self.parts[k]
        region, weights, covariance = member.form.region, self.weights(k), self.covariance(k)
        (value, *_), (sd, *_) = values, sds = (scale * weights).tolist(), (np.sqrt(np.diag(covariance)) * scale).tolist()
        match lead:
            case Own(column=int(column)):
                parameter = lead.mechanism.amplitude_parameters()[column]
                fitted = getattr(lead.mechanism, parameter.name) + value
                return lead.mechanism.name, {parameter.name: Estimate(fitted, sd, parameter.unit)}
            case EachRun(basis=Constant()):
                each = zip(lead.runs, values, sds, strict=False)
                return region, {run: Estimate(one, sd, "deg/h") for run, one, sd in each}
            case EachRun() if region.endswith(BY_RUN):
                n, unit = len(lead.runs), parameter_by_run(region, self.baseline).unit
                about = (np.eye(n) - 1.0 / n) * scale * lead.basis.per_unit()  # the mean is the simulator's
                spread = np.sqrt(np.diag(about @ covariance[:n, :n] @ about.T)).tolist()
                each = zip(lead.runs, (about @ weights[:n]).tolist(), spread, strict=True)
                return region, {run: Estimate(one, sd, unit) for run, one, sd in each}
            case Offset(offsets_s=offsets_s):
                shown = zip(lead.runs if lead.each else ("all runs",), offsets_s, values, sds, strict=False)
                return CLOCK, {run: Estimate(one * offset_s, sd * abs(offset_s), "s") for run, offset_s, one, sd in shown}
            case Late():
                window_s = scale * self.data.runs[0].grid.window_s
                kind = LATE_THERMOMETER if is_thermometer(lead.column) else LATE_MONITOR
                return kind, {lead.column: Estimate(float(weights[0] * window_s), math.sqrt(covariance[0, 0]) * window_s, "s")}
        return region, {}

    @property
    def steps(self) -> list[dict[str, object]]:
        """Steps of the bias: run, time and size."""
        found: list[dict[str, object]] = []
        for k, (_, bases) in enumerate(self.parts):
            weights, covariance = self.weights(k), self.covariance(k)
            for j, (basis, scale) in enumerate(bases):
                if isinstance(basis, Moment):
                    start = next(float(run.binned.time_s[0]) for run in self.data.runs if run.name == basis.run)
                    size = Estimate(float(weights[j] * scale), math.sqrt(covariance[j, j]) * scale, "deg/h")
                    found.append({"run": basis.run, "at_s": start + basis.at_s, "size": size.to_mapping()})
        return found

    @property
    def unsettled(self) -> dict[str, dict[str, Estimate]]:
        """What had not settled when each run began, at its first window, in the unit of the output; by mechanism and run."""
        found: dict[str, dict[str, Estimate]] = {}
        for k, (member, bases) in enumerate(self.parts):
            region = member.form.region
            own = [region.endswith(BEFORE) or isinstance(basis, Unsettled) for basis, _ in bases]
            if not any(own):
                continue
            table = np.hstack([scale * of * self.bank.columns(basis) for (basis, scale), of in zip(bases, own, strict=True)])
            firsts = zip(self.data.runs, table[[rows.start for rows in self.data.slices]], strict=True)
            found[region.removesuffix(BEFORE)] = {
                run.name: Estimate(float(first @ self.weights(k)), math.sqrt(first @ self.covariance(k) @ first), "deg/h")
                for run, first in firsts
            }
        return found

    # --- predictions -----------------------------------------------------------------------------------------------------------

    def term(self, k: int, run: Run) -> Array:
        """What the k-th member does in a run, shape (bins,)."""
        table = np.hstack([scale * basis.columns(run) for basis, scale in self.parts[k][1]])
        return np.asarray(table @ self.weights(k))

    def inside(self, k: int) -> slice:
        """Places of the k-th member's weights among all."""
        at = sum(self._width(j) for j in range(k))
        return slice(at, at + self._width(k))

    def weights(self, k: int) -> Array:
        """Weights of the k-th member's bases, shape (m,)."""
        return self.solution.weights[self.inside(k)]

    def covariance(self, k: int) -> Array:
        """Of these weights, shape (m, m)."""
        return self.solution.covariance[self.inside(k), self.inside(k)]

    def _width(self, k: int) -> int:
        return sum(self.bank.columns(basis).shape[1] for basis, _ in self.parts[k][1])

    def predicted(self, run: Run) -> Array:
        """The output less what the given simulator states, of a run on its bins, shape (bins,)."""
        total = self.baseline.columns(run) @ self.solution.numbers + self.baseline.changed(run)
        for k in range(len(self.parts)):
            total = total + self.term(k, run)
        return np.asarray(total)

    def residual(self, run: Run) -> Array:
        """What a run's window means hold beyond the fit; a two-state path is not predicted.

        Amplitudes that a run has of its own are fitted to that run: no other run tells them.
        """
        left = np.asarray(run.output[: len(run.windows)] - run.window_means(self.predicted(run)))
        own = run.window_means(self.baseline.own_columns(run))
        if own.shape[1] == 0:
            return left
        size = np.maximum(np.linalg.norm(own, axis=0), 1e-300)
        return np.asarray(left - own / size @ np.linalg.lstsq(own / size, left, rcond=1e-9)[0])

    def rate_deg_h(self, recording: Recording, grid: Grid) -> Array:
        """The output predicted at each sample of a recording, in deg/h, shape (n,)."""
        run = Run.of(recording, grid, lambda binned: np.zeros(len(binned)))
        since = recording.time_s - recording.time_s[0] + 0.5 * recording.period_s
        given = Baseline(self.baseline.given or self.baseline.simulator)
        return np.interp(since, run.elapsed_s, self.predicted(run)) + given.stated(recording)

    # --- parameters ------------------------------------------------------------------------------------------------------------

    def parameters(self, k: int, mechanism: type[Mechanism]) -> dict[str, float]:
        """Weights of the leading basis, where it is one, and its shapes in the mechanism's own names: a part of what is found."""
        member, bases = self.parts[k]
        if len(member.form.lead) != 1 or not member.form.lead[0].of_mechanism:
            return {}
        (lead,), (_, scale) = member.form.lead, bases[0]
        declared, count = mechanism.parameters(), self.bank.columns(lead).shape[1]
        amplitudes = [parameter.name for parameter in declared if parameter.role == "amplitude"]
        if count > len(amplitudes):
            return {}
        found = dict(zip(amplitudes, (self.weights(k)[:count] * (scale * lead.per_unit())).tolist(), strict=False))
        for name, value in lead.parameters().items():
            found |= next(({same.name: value} for same in declared if same.name.startswith(name)), {})
        return found

    def projected(self, columns: Array) -> Array:
        """Window means of columns, whitened by the noise of the set, less what the baseline absorbs."""
        return self._evidence.whitened.project(columns)

    def falls(self, k: int, forms: Sequence[Form]) -> list[float]:
        """Falls of the log evidence with other forms in place of the k-th member's own; infinite of one that cannot be."""
        members = self.state.members
        given = self._evidence.given((*members[:k], *members[k + 1 :]))
        at = int(np.argmin(np.abs(priors.SIZES - members[k].size)))
        here = float(given.gain(members[k].form)[at])
        return [here - float(given.gain(form)[at]) if self.bank.scaled(form) is not None else math.inf for form in forms]

    def spread(self, k: int, name: str, value: float, lead: int = 0) -> float:
        """Standard deviation of a nonlinear parameter of a leading basis, of the fall of the evidence to both sides."""
        forms = self.state.members[k].form.nearby(_SIDE)
        moved = [abs(form.lead[lead].parameters()[name] - value) for form in forms]
        near = [(by, form) for by, form in zip(moved, forms, strict=True) if by > 0.0 and self.bank.scaled(form) is not None]
        falls = self.falls(k, [form for _, form in near])
        spreads = [by / math.sqrt(2.0 * max(fall, 1e-3)) for (by, _), fall in zip(near, falls, strict=True)]
        return float(np.median(spreads)) if spreads else 0.0


def _shapes(mechanism: Mechanism) -> frozenset[str]:
    return frozenset(parameter.name for parameter in mechanism.shape_parameters())
