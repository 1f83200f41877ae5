r"""The clock of a simulation that no monitor tells, judged against physics: by what it would do to the gyro in all runs together.

A simulation s whose clock is off by :math:`\delta_r` in run r leaves of the gyro

.. math:: y_r = X \beta + \sum_m \Phi_m a_m + a \, [s_r(t - \delta_r) - s_r(t)] + \epsilon

beside each likely set of causes, a being about one. That moves as the simulation itself does, where missing physics moves as a
temperature or its rate; one run hardly tells them apart, but all runs together may. Either all files are off by the same, as when a
simulator begins everything late, or each by its own, as when a logger is started by hand. The odds are those of the Bayes factor,
which averages over one number, over what further numbers cost; all sets without a clock stand against it.
"""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Final

import numpy as np
import numpy.typing as npt

from rlgcomp.diagnosis.conclusion import AMBIGUOUS, MENTIONED
from rlgcomp.diagnosis.fitting.linearised import solve
from rlgcomp.diagnosis.naming.background import Background
from rlgcomp.diagnosis.naming.candidates import Candidate
from rlgcomp.diagnosis.naming.evidence import log_sum_exp
from rlgcomp.diagnosis.naming.explain import Explanations
from rlgcomp.diagnosis.naming.inadequacy import BY_CHANCE, follows_anything, inadequacy
from rlgcomp.diagnosis.naming.search import Label, Model
from rlgcomp.diagnosis.noise.whitening import NoiseShape, norms
from rlgcomp.diagnosis.posed import Posed
from rlgcomp.diagnosis.question.events import probability_of
from rlgcomp.diagnosis.question.problem import Problem
from rlgcomp.diagnosis.result import Alternative, Cause, Diagnosis, Estimate
from rlgcomp.diagnosis.result.phrases import listing, sure_text
from rlgcomp.diagnosis.simulators.user_simulator import SimulatedRuns
from rlgcomp.errors import InputError
from rlgcomp.physics.mechanism import Mechanism
from rlgcomp.simulation.simulator import Simulator

Array = npt.NDArray[np.float64]
Group = tuple[int, ...]  # runs
CLOCK: Final = 0.1  # before the data are seen: that a clock is off which no monitor tells
OTHERS: Final = 0.5  # the same where another file's is
SURE: Final = AMBIGUOUS  # probability from which it is taken out, as a cause is named from there
DOUBTED: Final = 0.01  # and from which it is said, where something is named;
SUSPECTED: Final = 0.5  # where nothing is
CLOCK_OFFSET: Final = "clock_offset"  # its name among what a cause cannot be told from
_OFFSETS_S: Final = np.array([sign * size for size in (25.0, 50.0, 100.0, 200.0, 400.0, 800.0) for sign in (1.0, -1.0)])
_SEEN: Final = 2.6  # standard deviations
_SPREAD: Final = math.sqrt(2.0 * math.pi) / math.log(2.0)  # of a posterior, over the ratio of two offsets that are tried
_FARTHEST: Final = 0.1  # of the shortest run
_STEPS: Final = 3  # towards the likeliest offsets
_ROUNDS: Final = 3  # in which a clock is taken out and asked for again
_SETS: Final = 4  # beside which it is sought, and beside the parts of the likeliest


@dataclasses.dataclass(frozen=True)
class Clock:
    """A simulation's clock that is off.

    Parameters
    ----------
    offsets : mapping of str to Estimate
        By run, in s: the recording shows at time t what the simulation shows at t - offset. Runs that are not named are on time.
    together : bool
        All are off by the same.
    instead_of : frozenset of str
        Causes of likely sets that are not needed then.
    log_odds : float
        Logarithm of the odds that it is so.
    """

    offsets: Mapping[str, Estimate]
    together: bool
    instead_of: frozenset[str]
    log_odds: float

    @property
    def probability(self) -> float:
        """That it is so."""
        return probability_of(self.log_odds)

    @property
    def sure(self) -> bool:
        """Whether it is taken out."""
        return self.probability > SURE


def on_time(posed: Posed, base: Simulator, simulated: SimulatedRuns | None) -> tuple[Posed, SimulatedRuns | None, Clock | None]:
    """The same asked of a simulation whose clock is right, as far as all runs together tell it; and the clock that was taken out,
    or the likeliest. Where no runs were simulated nothing changes.
    """
    if simulated is None:
        return posed, None, None
    taken_out = None
    for _ in range(_ROUNDS):
        found = sought(posed, simulated)
        if found is None or not found.sure:
            return posed, simulated, taken_out or found
        taken_out, simulated = taken_out or found, simulated.moved(found.offsets)
        runs, count = simulated.runs, len(posed.asked.train)
        test = runs[count : count + len(posed.asked.test)]
        asked = dataclasses.replace(posed.asked, train=runs[:count], test=test, predicted=simulated.predict_deg_h)
        posed = Posed.of(asked, base)
    return posed, simulated, taken_out


def sought(posed: Posed, simulated: SimulatedRuns) -> Clock | None:
    """The likeliest way in which the clock of a simulation is off; None where it cannot be, or shows nothing."""
    problem, explanations = posed.whole_windowed or posed.windowed, posed.explained
    if not problem.own_biases:  # as sets of causes are weighed
        problem = problem.with_own_biases() if explanations.own_biases() else problem.without_offsets()
    untold = [k for k, run in enumerate(problem.runs) if run.name in simulated.untold]
    if problem.simulator.kind != "chamber" or not untold:
        return None
    shifts = _Shifts.of(problem, simulated, untold)
    noises, prior = explanations.evidence.noises, explanations.search.noise_log_prior
    found = []
    for model in _sets(explanations):
        try:
            design = _design(problem, explanations, model)
        except InputError:
            continue  # a held-out run lacks what a cause reads
        background, toll = Background(problem, design, noises, prior), _toll(explanations, model)
        for groups in dict.fromkeys(((tuple(untold),), tuple((k,) for k in untold))):
            log_factor, offsets = shifts.likeliest(background, design, groups)
            found.append((model.log_posterior + log_factor - math.log(2.0) - toll, log_factor, offsets, model.labels, background))
    if not any(offsets for _, _, offsets, *_ in found):
        return None
    before = OTHERS if any(one.together for one in simulated.alignment) else CLOCK
    log_odds = explanations.log_odds_of_event([log for log, *_ in found], before, explanations.models)
    _, log_factor, offsets, beside, background = max(found, key=lambda one: one[0])
    rivals = _rivals(explanations, beside)
    if rivals:  # on the same ground as well, where held-out runs are not asked what was foreseen of them
        columns = np.column_stack([problem.columns(one.mechanism) for one in rivals])
        log_odds = min(log_odds, log_factor - float(background.log_bayes_factors(_unit(columns)).max()))
    by_name = {problem.runs[k].name: offset for k, offset in offsets.items()}
    together = len(untold) > 1 and len(set(offsets.values())) == 1 and len(offsets) == len(untold)
    if together:  # held-out runs that were not asked as well
        by_name = dict.fromkeys(sorted(simulated.untold), offsets[untold[0]])
    return Clock(by_name, together, frozenset(one.name for one in rivals), log_odds)


def _rivals(explanations: Explanations, beside: frozenset[Label]) -> list[Candidate]:
    """Causes of likely sets that are not among those beside a clock."""
    likely = [model for model, p in zip(explanations.models, explanations.probabilities, strict=True) if p > MENTIONED]
    causes = (one for model in likely for one in explanations.candidates(model))
    return [one for one in causes if not (one.known or one.mechanism.is_telegraph() or (one.name, False) in beside)]


def weighed(found: Diagnosis, clock: Clock | None) -> Diagnosis:
    """A diagnosis that says what a clock is off by; whose causes share their probability with one that these runs cannot tell from
    them."""
    found = dataclasses.replace(found, remarks=(*clock_remarks(found, clock), *found.remarks))
    if clock is None or clock.sure or clock.probability < DOUBTED:
        return found
    of_clock, of_physics = clock.probability, 1.0 - clock.probability

    def shared(cause: Cause) -> Cause:
        if cause.name not in clock.instead_of:
            return cause
        rivals = *cause.indistinguishable_from, CLOCK_OFFSET
        shares = *(of_physics * share for share in cause.rival_probabilities), of_clock
        return dataclasses.replace(
            cause, probability=of_physics * cause.probability, indistinguishable_from=rivals, rival_probabilities=shares
        )

    if not any(cause.name in clock.instead_of for cause in found.causes):
        return found
    causes = tuple(sorted(map(shared, found.causes), key=lambda cause: -cause.probability))
    rest = (cause.name for cause in causes if cause.name not in clock.instead_of)
    others = (dataclasses.replace(one, probability=of_physics * one.probability) for one in found.alternatives)
    ranked = sorted([Alternative((CLOCK_OFFSET, *rest), of_clock), *others], key=lambda one: -one.probability)
    return dataclasses.replace(
        found,
        causes=causes,
        alternatives=tuple(ranked),
        probability=None if found.probability is None else of_physics * found.probability,
        verdict="ambiguous" if found.verdict == "explained" and of_physics < AMBIGUOUS else found.verdict,
    )


def clock_remarks(found: Diagnosis, clock: Clock | None) -> tuple[str, ...]:
    """What to say of a clock that all runs together told, or that they cannot tell from missing physics."""
    mend = "give simulations one, as temperature_block_degC, or make sure of their time stamps and of what drives them"
    told = {one.run: one.offset for one in found.alignment if one.together}
    if told and clock is not None:
        off = _offsets_text(told, len(found.alignment))
        sure = f"all runs together say so (probability {sure_text(clock.probability, 2)})"
        return (
            f"The simulation's clock is off by {off}: {sure}, for physics that is missing would go otherwise. It was taken out; no "
            f"monitor tells it: {mend}.",
        )
    silent = found.verdict == "none" and clock is not None and clock.probability < SUSPECTED
    if clock is None or clock.probability < DOUBTED or silent:
        return ()
    named = [cause.name for cause in found.causes if cause.name in clock.instead_of]
    what = f"What {listing(sorted(named))} {'adds' if len(named) == 1 else 'add'}" if named else "What there is"
    return (
        f"{what} may as well be the simulation's clock (probability {sure_text(clock.probability, 2)}), off by "
        f"{_offsets_text(clock.offsets, len(found.alignment))}, which no monitor tells: {mend}.",
    )


def _offsets_text(offsets: Mapping[str, Estimate], runs: int) -> str:
    if len(offsets) == runs and len(set(offsets.values())) == 1:
        return f"{next(iter(offsets.values()))} in all runs"
    return ", ".join(f"{offset} in {run}" for run, offset in offsets.items())


@dataclasses.dataclass(frozen=True)
class _Shifts:
    """What offsets of a simulation's clock do to window means of runs."""

    problem: Problem
    rates_deg_h: Mapping[int, Array]
    trials_s: Array
    farthest_s: float

    @classmethod
    def of(cls, problem: Problem, simulated: SimulatedRuns, untold: Sequence[int]) -> _Shifts:
        rates = {k: simulated.predict_deg_h(problem.runs[k]) for k in untold}
        farthest_s = _FARTHEST * min(problem.runs[k].duration_s for k in untold)
        seen = [one.offset_s for one in simulated.alignment if abs(one.offset_s) > _SEEN * one.offset_sd_s]  # by one run's gyro
        trials_s = np.array([*_OFFSETS_S, *seen])
        return cls(problem, rates, trials_s[np.abs(trials_s) < farthest_s], farthest_s)

    def column(self, runs: Group, offset_s: float) -> Array:
        """Of one offset in some runs, shape (n,)."""
        column = np.zeros(len(self.problem.rows))
        for k in runs:
            part, rate = self.problem.windows[k], self.rates_deg_h[k]
            late = np.interp(part.full.time_s - offset_s, part.full.time_s, rate)
            column[self.problem.rows.runs[k]] = part.means(late - rate)
        return column

    def columns(self, offsets: Iterable[tuple[Group, float]]) -> Array:
        """Of several, shape (n, offsets)."""
        return np.column_stack([self.column(*one) for one in offsets])

    def likeliest(self, background: Background, design: Array, groups: Sequence[Group]) -> tuple[float, dict[int, Estimate]]:
        """The logarithm of the Bayes factor of offsets beside a design, runs of a group having one, and the likeliest, by run."""
        trials = len(self.trials_s)
        logs = background.few().log_bayes_factors(_unit(self.columns(itertools.product(groups, self.trials_s.tolist()))))
        logs = logs.reshape(len(groups), trials)
        pays = log_sum_exp(logs) > math.log(trials)
        if not pays.any():
            return -math.inf, {}
        begin_s = np.where(pays, self.trials_s[logs.argmax(axis=1)], self.trials_s[0])  # of what others hide a little is enough
        moved, offsets_s, sds_s = list(groups), *self._settled(groups, begin_s, design, background)
        while moved and not (seen := np.abs(offsets_s) > _SEEN * sds_s).all():
            moved = [group for group, one in zip(moved, seen, strict=True) if one]
            offsets_s, sds_s = self._settled(moved, offsets_s[seen], design, background)
        if not moved:
            return -math.inf, {}
        both = list(zip(moved, offsets_s.tolist(), sds_s.tolist(), strict=True))
        together = self.columns((group, offset_s) for group, offset_s, _ in both).sum(axis=1)
        (log_factor,) = background.log_bayes_factors(_unit(together[:, None]))  # which averages over the size of one number;
        others = np.sort(np.minimum(0.0, np.log(_SPREAD * sds_s / np.abs(offsets_s))))[1:] - math.log(trials)
        which_are_off = math.log(2.0) * len(groups) if len(groups) > 1 else 0.0
        found = {k: Estimate(offset_s, sd_s, "s") for group, offset_s, sd_s in both for k in group}
        return float(log_factor + others.sum() - which_are_off), found

    def _settled(self, groups: Sequence[Group], offsets_s: Array, design: Array, background: Background) -> tuple[Array, Array]:
        """Offsets, one a group, after steps towards the likeliest, and their standard deviations; in the noise that is likeliest
        beside them."""
        p, noise, sds_s = design.shape[1], None, offsets_s
        for _ in range(_STEPS if groups else 0):
            wider = np.column_stack([design, self.columns(zip(groups, offsets_s.tolist(), strict=True))])
            noise = noise or _likeliest_noise(self.problem, wider, background)
            weights, covariance, square = solve(self.problem, wider, noise)
            sds_s = np.abs(offsets_s) * np.sqrt(np.diag(covariance)[p:] * square / (len(wider) - wider.shape[1]))
            offsets_s = np.clip(offsets_s * weights[p:], -self.farthest_s, self.farthest_s)
        return offsets_s, sds_s


def _likeliest_noise(problem: Problem, design: Array, known: Background) -> NoiseShape:
    return known.noises[int(np.argmax(Background(problem, design, known.noises).log_evidence))]


def _unit(columns: Array) -> Array:
    """Columns of unit root mean square, shape (n, m)."""
    return math.sqrt(len(columns)) * columns / norms(columns)


def _sets(explanations: Explanations) -> list[Model]:
    """Beside which a clock is sought: the likeliest, and all parts of the first; without paths of jumps, which follow anything."""
    search = explanations.search
    still = [one for one in explanations.models if search.without_jumps(one.labels) == one.labels]
    return [one for k, one in enumerate(still) if k < _SETS or one.labels <= still[0].labels or not one.labels]


def _toll(explanations: Explanations, model: Model) -> float:
    """What the log evidence of a clock must exceed beside causes: what the equation of one may be wrong by, as far as that goes by
    temperature, as a simulation does.
    """
    evidence = explanations.evidence
    run, explained = evidence.problem.runs[0], evidence.explained_by_each(model.members, int(np.argmax(model.noise_log)))

    def alike(cause: Mechanism) -> float:
        thermal = any(name.startswith("temperature_") for name in cause.driver_columns(run))
        return 1.0 if thermal or follows_anything(cause) else BY_CHANCE

    causes = [one.mechanism for one in explanations.candidates(model)]
    each = zip(causes, explained, strict=True)
    return max((inadequacy(chi_square) * alike(cause) for cause, chi_square in each if not cause.empirical), default=0.0)


def _design(problem: Problem, explanations: Explanations, model: Model) -> Array:
    held = explanations.search.has_own_biases(model.labels)
    causes = [one for one in explanations.candidates(model) if not one.mechanism.empirical]
    baseline = (problem.with_own_biases() if held else problem).baseline
    return np.column_stack([baseline, *(problem.columns(one.mechanism) for one in causes)])
