"""One diagnosis from beginning to end."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from typing import Final, Self

import numpy as np
import numpy.typing as npt

from rlgcomp.diagnosis.bank import Bank
from rlgcomp.diagnosis.baseline import Baseline
from rlgcomp.diagnosis.bases import Basis
from rlgcomp.diagnosis.black_box import BlackBox
from rlgcomp.diagnosis.clocks import clock_regions
from rlgcomp.diagnosis.data import Data, Grid, Run
from rlgcomp.diagnosis.decide import LOUDER, MORE_LEFT, Decision, decided
from rlgcomp.diagnosis.design import likely, next_experiment
from rlgcomp.diagnosis.drivers import Driver
from rlgcomp.diagnosis.fit import Fit
from rlgcomp.diagnosis.identities import Identity, identities, without_identities
from rlgcomp.diagnosis.laboratory import thermometer_of
from rlgcomp.diagnosis.noise import Noise
from rlgcomp.diagnosis.nuisances import nuisances
from rlgcomp.diagnosis.posterior import Posterior
from rlgcomp.diagnosis.prepare import SIMULATED, AnySimulator, Prepared
from rlgcomp.diagnosis.programmes import ChamberRange
from rlgcomp.diagnosis.record import Request
from rlgcomp.diagnosis.regions import OTHER_FORM, laws, named, own_bases
from rlgcomp.diagnosis.result import Diagnosis
from rlgcomp.diagnosis.scores import score
from rlgcomp.diagnosis.screen import KEPT_BY_REPEATED, Layout
from rlgcomp.diagnosis.search import Search
from rlgcomp.diagnosis.setting import Setting
from rlgcomp.diagnosis.shapes import columns_beside, likelier, renewed, wrong_amplitudes
from rlgcomp.diagnosis.states import State
from rlgcomp.diagnosis.terms import Region
from rlgcomp.diagnosis.turning import turning_regions, with_angle_rows
from rlgcomp.errors import InputError
from rlgcomp.noise.processes import NoiseModel
from rlgcomp.numerics.compiled import one_blas_thread
from rlgcomp.physics import CATALOGUE
from rlgcomp.physics.mechanism import Mechanism
from rlgcomp.physics.user import require_computable
from rlgcomp.recording import Recording, rate_name
from rlgcomp.recording.argument_checks import require_recordings, require_seed
from rlgcomp.report.messages import Message, message
from rlgcomp.units import display_unit

Array = npt.NDArray[np.float64]
_Question = tuple[Bank, list[Region], Baseline]
"""The data on their design, the regions that are weighed, and the simulator."""
_CALIBRATIONS: Final = 2  # of free shapes beside the likeliest set


@one_blas_thread
def diagnose(
    simulator: AnySimulator | None = None,
    train: Sequence[Recording] = (),
    test: Sequence[Recording] = (),
    *,
    confirm: Sequence[Recording] = (),
    simulated: Sequence[Recording] | None = None,
    mechanisms: Mapping[str, type[Mechanism]] = CATALOGUE,
    without: Sequence[str] = (),
    only: Sequence[str] = (),
    gyro: str | None = None,
    output: str | None = None,
    unit: str | None = None,
    window_s: float | None = None,
    noise: NoiseModel | None = None,
    chamber: Sequence[float] | None = None,
    black_box: bool = True,
    seed: int = 0,
    progress: Callable[[float], None] | None = None,
) -> Diagnosis:
    """Diagnose what physics a simulator is missing.

    Parameters
    ----------
    simulator : Simulator, UserSimulator or callable, optional
        Its free numbers are calibrated; or the user's own: anything with `predict_deg_h(recording)`, or a
        function of a recording.
    train : sequence of Recording
        Runs that name and fit.
    test : sequence of Recording
        Runs that decide nothing and prove.
    confirm : sequence of Recording
        Runs that take part in the choice of the set, and not in the fit.
    simulated : sequence of Recording, optional
        Instead of a simulator, its output: one recording a run, those of `train` first, then `confirm`, then `test`.
    mechanisms : mapping of str to type of Mechanism
        Candidates by name.
    without : sequence of str
        Candidates to leave out.
    only : sequence of str
        The only candidates, beside laws without a name.
    gyro : str, optional
        Gyro column, where there are several.
    output : str, optional
        Another column than a gyro's whose simulation is at fault; the simulator's numbers are in its unit.
    unit : str, optional
        Unit of the output, by default that of its column's name; "deg/h" of a gyro.
    window_s : float, optional
        Averaging time; by default such that the longest run has 400 windows.
    noise : NoiseModel, optional
        Of this gyro at rest, measured: the runs are held against it. By default it is estimated from the runs.
    chamber : (float, float, float), optional
        Lowest and highest temperature in degC and fastest ramp in degC/min for the next experiment; by default as recorded.
    black_box : bool
        Train an LS-SVM on the same runs, for comparison.
    seed : int
        Kept in the provenance.
    progress : callable, optional
        Is given the fraction done.

    Raises
    ------
    InputError
        No training run is given, or one is a test run as well; a run lacks a monitor of the simulator; a name of a candidate is
        unknown; the output is no column; the noise has no angle random walk, or the output is no gyro's.
    """
    train, test = require_recordings(train, "train"), require_recordings(test, "test") if test else []
    confirm, seed = require_recordings(confirm, "confirm") if confirm else [], require_seed(seed)
    tell = progress or (lambda fraction: None)
    candidates = _candidates(mechanisms, without, only)
    runs = Prepared.of(simulator, simulated, train, confirm, test, gyro=gyro, output=output)
    require_computable(candidates, [*runs.train, *runs.confirm, *runs.test])
    request = _request(runs, candidates, gyro, output, unit)
    request = dataclasses.replace(request, without=tuple(without), only=tuple(only), seed=seed)
    tell(0.05)
    limits = None if chamber is None else ChamberRange.of(chamber)
    engine = _Engine(runs, candidates, request, gyro, output, window_s, _measured(noise, output), limits)
    engine.data([*runs.confirm, *runs.test]).require_a_window()
    chosen = engine.posterior([*runs.train, *runs.confirm])
    tell(0.9)
    found = engine.fitted(chosen)
    if black_box:
        found = dataclasses.replace(found, black_box=engine.black_box(found))
    tell(1.0)
    return found


@dataclasses.dataclass(frozen=True)
class _Engine:
    """The steps of a diagnosis with what they share."""

    runs: Prepared
    candidates: Mapping[str, type[Mechanism]]
    request: Request
    gyro: str | None
    column: str | None
    window_s: float | None
    noise: NoiseModel | None
    chamber: ChamberRange | None
    _on_grid: dict[int, tuple[Recording, Run]] = dataclasses.field(default_factory=dict, repr=False)

    @property
    def grid(self) -> Grid:
        if self.window_s is None:
            return Grid.of(self.runs.train, every_sample=self.turns)
        return Grid.of_window(self.runs.train, self.window_s, every_sample=self.turns)

    @property
    def turns(self) -> bool:
        """Whether a table turns."""
        return self.runs.base.kind == "turntable"

    def recorded(self, binned: Recording) -> Array:
        """Bin means of the output."""
        gyro = self.gyro if self.gyro is None or self.gyro in binned else rate_name(self.gyro)  # means are in deg/h
        return binned.rate_deg_h(gyro) if self.column is None else binned.column(self.column)

    def output(self, binned: Recording) -> Array:
        """Bin means of the output less what the simulator states."""
        known = binned.column(SIMULATED) if self.runs.own else Baseline(self.runs.base).stated(binned)
        return np.asarray(self.recorded(binned) - known)

    def data(self, recordings: Sequence[Recording]) -> Data:
        """Recordings on the grid of the training runs."""
        other = tuple(name for name in (self.column, SIMULATED if self.runs.own else None) if name is not None)
        return Data(tuple(self._run(recording, other) for recording in recordings), other, self.noise)

    def _run(self, recording: Recording, other: tuple[str, ...]) -> Run:
        """A recording on the grid, computed once; columns that are derived from it are not shared."""
        key = id(recording)
        if key not in self._on_grid:
            self._on_grid[key] = recording, Run.of(recording, self.grid, self.output, other)
        return dataclasses.replace(self._on_grid[key][1], cache={}, derived={})

    def identities(self, data: Data) -> tuple[Identity, ...]:
        """Columns of which the recorded output is the rate of change or the integral."""
        return () if self.turns else identities(data, self.recorded, self.request.unit)

    def question(
        self, recordings: Sequence[Recording], beside: Array | None = None, wrong: Mapping[str, Collection[str]] | None = None
    ) -> _Question:
        """The data, the regions that are weighed, and the simulator calibrated as :meth:`Baseline.calibrated` does."""
        data, simulator = self.data(recordings), self.runs.base
        data.require_windows()
        baseline = Baseline.calibrated(simulator, data, beside, wrong)
        if self.turns:
            regions = list(turning_regions(data, self.candidates, baseline, thermometer_of(self.runs.train[0])))
            data = with_angle_rows(data, _bases(regions), self.output)
        else:
            setting = Setting(data, Driver.of(data, _thermometer(data, self.runs.train[0])))
            present = [mechanism.name for mechanism in simulator.mechanisms]
            baseline = baseline.with_own(own_bases(setting, present), data, beside)
            regions = list(named(setting, self.candidates, present))
            regions += list(laws(setting, regions))
        data = baseline.less_stated(data)
        bank = Bank(data, baseline.design(data), None if self.turns else baseline)
        clocks = clock_regions(data, bank.design, SIMULATED) if self.runs.untold and not self.turns else ()
        return bank, without_identities([*regions, *nuisances(data, baseline), *clocks], self.identities(data)), baseline

    def posterior(self, recordings: Sequence[Recording]) -> _Chosen:
        """The posterior of all sets, the simulator alone and beside the likeliest set, and messages beside it."""
        bank, regions, alone = self.question(recordings)
        absorbed = [region.mechanism for region in regions if region.mechanism == region.key and _absorbed(region, bank)]
        messages = [message("diagnosis.absorbed", mechanisms=absorbed)] if absorbed else []
        messages += [one.message() for one in self.identities(bank.data)]
        question = bank, regions, alone
        found, (bank, regions, beside) = self._settled(question, recordings)
        if _other_forms(found.best) and self._calibrates(found.best):
            plain, question = self._settled(question, recordings, other_forms=False)
            if plain.best.log_posterior > found.best.log_posterior:
                found, (bank, regions, beside) = self._settled(question, recordings)
        return _Chosen(found, alone, beside, tuple(messages))

    def _settled(
        self, question: _Question, recordings: Sequence[Recording], *, other_forms: bool = True
    ) -> tuple[Posterior, _Question]:
        """The posterior of a question, or of the one that follows from it by shapes calibrated beside the likeliest set.

        Parameters
        ----------
        question : tuple
        recordings : sequence of Recording
        other_forms : bool
            Whether other forms of the simulator's mechanisms are weighed.
        """
        for calibration in range(_CALIBRATIONS + 1):
            bank, regions, baseline = question
            found = Posterior.of(bank, [one for one in regions if other_forms or not one.key.startswith(OTHER_FORM)])
            again = self._question_beside(found.best, bank, baseline, recordings) if calibration < _CALIBRATIONS else None
            if again is None or not (wrong_amplitudes(found.best) or likelier(found.best, again[0], bank)):
                break
            question = again
        return found, question

    def _question_beside(self, state: State, bank: Bank, baseline: Baseline, recordings: Sequence[Recording]) -> _Question | None:
        """The question with free shapes of the simulator calibrated beside a set; None where they are the same.

        Shapes enter by their derivatives, and those that were calibrated to the runs as they are have met what is missing halfway:
        a member of the set may stand for what their derivatives do not reach. Beside an amplitude that is stated wrong, or beside
        jumps, they have met that as well; and another form of the same mechanism may stand for all of it.
        """
        if not self._calibrates(state):
            return None
        again = self.question(recordings, columns_beside(state, bank), wrong_amplitudes(state))
        return None if again[-1].simulator == baseline.simulator else again

    def _calibrates(self, state: State) -> bool:
        """Whether shapes of the simulator are free, and something is beside it."""
        shapes = any(Baseline(self.runs.base).free(one, "shape") for one in self.runs.base.mechanisms)
        return shapes and not self.turns and bool(state.members or state.telegraph)

    def _calibrated_last(self, state: State, baseline: Baseline, data: Data) -> tuple[State, Baseline]:
        """A set and the simulator with free shapes where they are beside the set, near where their derivatives end."""
        baseline = baseline.linearised(data)
        if not self._calibrates(state):
            return state, baseline
        bank = Bank(baseline.less_stated(data), baseline.design(data), baseline)
        beside = columns_beside(self._in_training(state, bank), bank)
        found = Baseline.calibrated(self.runs.base, data, beside, wrong_amplitudes(state))
        found = dataclasses.replace(found, own=baseline.own).linearised(data, beside)
        return renewed(state, found.simulator), found

    def fitted(self, chosen: _Chosen) -> Diagnosis:
        """The decision, fitted to the training runs alone."""
        posterior = chosen.posterior
        decision = decided(posterior)
        data, best = self.data(self.runs.train), _best(posterior, decision)
        best, baseline = self._calibrated_last(best, chosen.beside, data)
        alone = baseline if baseline.simulator == chosen.alone.simulator else chosen.alone.linearised(data)
        if self.turns:
            own = (basis for state in (best, *likely(posterior)) for member in state.members for basis in member.form.bases)
            data = with_angle_rows(data, [*_bases(posterior.regions.values()), *own], self.output)
        data, data_alone = baseline.less_stated(data), alone.less_stated(data)
        bank = Bank(data, baseline.design(data), None if self.turns else baseline)
        bank_alone = bank if alone is baseline else Bank(data_alone, alone.design(data), None if self.turns else alone)
        before = Fit(data_alone, alone, bank_alone, self._in_training(_without(best, posterior), bank_alone))
        after = Fit(data, baseline, bank, self._in_training(best, bank))
        refused = self._refused(decision, before, after)
        if refused is not None:
            decision = Decision("none", ())
            before = Fit(data_alone, alone, bank_alone, self._in_training(_null(posterior), bank_alone))
            after = Fit(data, baseline, bank, self._in_training(_best(posterior, decision), bank))
        if decision.verdict == "none" and after.excess[1] < LOUDER:
            decision = Decision("unknown", (), louder=True)
        states = likely(posterior) if decision.verdict == "ambiguous" else []
        rivals = [Fit(data, baseline, bank, self._in_training(state, bank)) for state in states]
        following, promise = next_experiment(posterior, rivals, states, self.chamber)
        read = {column for member in after.state.members for column in posterior.regions[member.form.region].drivers}
        test, lacking = _with_columns(self.runs.test, read & set(data.columns))
        return Diagnosis(
            decision,
            posterior,
            before,
            after,
            self.data([run for run in self.runs.confirm if set(data.columns) & read <= set(run.columns)]).runs,
            self.data(test).runs,
            self.candidates,
            self.request,
            preparation=(*lacking, *chosen.messages, *self.runs.messages),
            warnings=self.runs.warnings,
            alignment=self.runs.alignment,
            next_experiment=following,
            next_message=promise if refused is None else refused,
        )

    def black_box(self, found: Diagnosis) -> BlackBox | None:
        """The compensation at its best on the same split."""
        return BlackBox.of(found.before, self.recorded, self.output, [*found.confirm_runs, *found.test_runs])

    def _refused(self, decision: Decision, before: Fit, after: Fit) -> Message | None:
        """That a set is not named because it leaves more of the training runs than none does; None where it leaves less."""
        if not decision.named or after.state.key[1]:
            return None
        found = score(before, after, before.data.runs, self.request.unit)
        if found is None or found.augmented_rms <= MORE_LEFT * found.baseline_rms:
            return None
        names = [one.mechanism or one.region for one in decision.named]
        sizes = {"before": found.baseline_rms, "after": found.augmented_rms, "unit": found.unit}
        return message("diagnosis.worse_in_training", mechanisms=names, **sizes)

    def _in_training(self, state: State, bank: Bank) -> State:
        """A state of all runs that choose, as one of the training runs."""
        members = tuple(member for member in state.members if bank.scaled(member.form) is not None)
        seen = state.telegraph
        if seen is not None:
            seen = dataclasses.replace(seen, path=seen.path[: len(bank.data)])
        return dataclasses.replace(state, members=members, noise=state.noise.of_runs(len(bank.data.runs)), telegraph=seen)


@dataclasses.dataclass(frozen=True, eq=False)
class _Chosen:
    """What the runs that choose say.

    Parameters
    ----------
    posterior : Posterior
    alone, beside : Baseline
        The simulator with its free shapes calibrated alone, and beside the likeliest set.
    messages : tuple of Message
    """

    posterior: Posterior
    alone: Baseline
    beside: Baseline
    messages: tuple[Message, ...]


@dataclasses.dataclass(frozen=True, eq=False)
class Repeated:
    """Diagnoses of the same runs with this and that added to the output; what does not depend on the output is computed once.

    Free shapes of the simulator stay calibrated to the runs as they are, and are free to the first order.

    Parameters
    ----------
    bank : Bank
    regions : tuple of Region
    layout : Layout
    """

    bank: Bank
    regions: tuple[Region, ...]
    layout: Layout

    @classmethod
    @one_blas_thread
    def of(
        cls,
        simulator: AnySimulator,
        train: Sequence[Recording],
        *,
        gyro: str | None = None,
        mechanisms: Mapping[str, type[Mechanism]] = CATALOGUE,
    ) -> Self:
        """Of some runs; parameters as of :func:`diagnose`."""
        runs = Prepared.of(simulator, None, train, [], [], gyro=gyro, output=None)
        request = _request(runs, mechanisms, gyro, None, None)
        bank, regions, _ = _Engine(runs, mechanisms, request, gyro, None, None, None, None).question(runs.train)
        layout = Search(bank, regions).layout
        layout.keep(KEPT_BY_REPEATED)
        return cls(bank, tuple(regions), layout)

    @one_blas_thread
    def posterior(self, time_s: Sequence[Array], added: Sequence[Array]) -> Posterior:
        """The posterior of all sets with something added.

        Parameters
        ----------
        time_s, added : sequence of ndarray
            Times in the runs' own, and what is added there in deg/h, of each run.
        """
        runs = []
        for run, at, values in zip(self.bank.data.runs, time_s, added, strict=True):
            more = run.means(run.on_bins_of_rows(np.interp(run.recording.time_s, at, values)))
            runs.append(dataclasses.replace(run, output=run.output + more))
        data = dataclasses.replace(self.bank.data, runs=tuple(runs))
        return Posterior.of(self.bank.with_output(data), self.regions, self.layout)


def _other_forms(state: State) -> bool:
    """Whether a set has another form of a mechanism of the simulator."""
    return any(member.form.region.startswith(OTHER_FORM) for member in state.members)


def _absorbed(region: Region, bank: Bank) -> bool:
    """Whether the baseline can take the place of all of a region's forms."""
    return bool(region.forms) and all(bank.scaled(form) is None for form in region.forms)


def _with_columns(runs: Sequence[Recording], columns: set[str]) -> tuple[list[Recording], list[Message]]:
    """The runs that have columns, and a message on each other."""
    lacking = {run.name: sorted(columns - set(run.columns)) for run in runs}
    messages = [message("diagnosis.run_lacks_column", run=name, columns=lost) for name, lost in lacking.items() if lost]
    return [run for run in runs if not lacking[run.name]], messages


def _null(posterior: Posterior) -> State:
    """The likeliest state with nothing missing and nothing beside it."""
    key = State((), Noise(), 0.0).key
    return next((state for state in posterior.states if state.key == key), State((), Noise(), 0.0))


def _without(best: State, posterior: Posterior) -> State:
    """The simulator alone under the noise that the gyro has beside a set; what an effect seems to be without it is no noise.

    Jumps of a two-state process are no random walk either: under one, the beginnings of the runs would tell the constant. Least
    squares put the mean of the process into it.
    """
    if best.telegraph is not None:
        return State((), Noise(encoder=best.noise.encoder), 0.0)
    if not best.members:
        return _null(posterior)
    return State((), dataclasses.replace(best.noise, errors=None, wander=0.0), 0.0)


def _best(posterior: Posterior, decision: Decision) -> State:
    """The likeliest state; where nothing is named, the likeliest without an effect."""
    best = posterior.best
    if decision.verdict == "none" and (posterior.effects(best.key) or best.key[1]):
        return next(
            (state for state in posterior.states if not posterior.effects(state.key) and not state.key[1]), _null(posterior)
        )
    return best if posterior.sharpened is None else posterior.sharpened


def _measured(noise: NoiseModel | None, output: str | None) -> NoiseModel | None:
    if noise is None:
        return None
    if output is not None:
        raise InputError(f"the noise given is that of a gyro, and the output is {output!r}; leave the noise out")
    if noise.angle_random_walk_deg_sqrt_h == 0.0:
        raise InputError("the noise has no angle_random_walk_deg_sqrt_h; the other noises are judged beside it")
    return noise


def _bases(regions: Iterable[Region]) -> list[Basis]:
    return [basis for region in regions for form in region.forms for basis in form.bases]


def _thermometer(data: Data, recording: Recording) -> str:
    """The column that the catalogue means by temperature; where there is none, the first that varies."""
    try:
        return recording.temperature_column
    except InputError:
        if not data.columns:
            raise InputError(f"{recording.name} has no column beside the output that varies; give one that may drive it") from None
        return data.columns[0]


def _candidates(
    mechanisms: Mapping[str, type[Mechanism]], without: Sequence[str], only: Sequence[str]
) -> dict[str, type[Mechanism]]:
    """Candidates by name, some left out or some alone.

    Raises
    ------
    InputError
        A name is not among them.
    """
    unknown = [name for name in (*without, *only) if name not in mechanisms]
    if unknown:
        raise InputError(f"{', '.join(map(repr, unknown))} is no candidate; candidates are {', '.join(mechanisms)}")
    chosen = {name: mechanism for name, mechanism in mechanisms.items() if name in only} if only else dict(mechanisms)
    return {name: mechanism for name, mechanism in chosen.items() if name not in without}


def _request(
    runs: Prepared, candidates: Mapping[str, type[Mechanism]], gyro: str | None, output: str | None, unit: str | None
) -> Request:
    """What was asked for, and which candidates the runs cannot show."""
    first = runs.train[0]
    if output is None:
        channel, unit = first.gyro_column(gyro), unit or "deg/h"
    else:
        lacking = [run.name for run in (*runs.train, *runs.confirm, *runs.test) if output not in run]
        if lacking:
            raise InputError(f"output is {output!r}, which {lacking[0]} lacks; it has {', '.join(first.columns)}")
        channel, unit = output, unit or display_unit(output) or output.rpartition("_")[2]
    kind = runs.base.kind
    present = [mechanism.name for mechanism in runs.base.mechanisms]
    tried = [one for name, one in candidates.items() if one.is_candidate(kind) and name not in present]
    not_tried = tuple(one.name for one in tried if not all(one().readable_in(run) for run in runs.train))
    own = runs.own
    return Request("your simulator" if own else "the simulator", unit, channel, not_tried=not_tried, own_simulator=own)
