"""One diagnosis from beginning to end."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence

from rlgcomp.diagnosis.answer.black_box import BlackBox
from rlgcomp.diagnosis.answer.fit import Fit
from rlgcomp.diagnosis.answer.posterior import Posterior
from rlgcomp.diagnosis.case import Case, bases_of
from rlgcomp.diagnosis.choice import Choice, calibrated_last, in_training
from rlgcomp.diagnosis.decide import LOUDER, Decision, decided
from rlgcomp.diagnosis.evidence.bank import Bank
from rlgcomp.diagnosis.next_experiment.design import likely, next_experiment
from rlgcomp.diagnosis.next_experiment.programmes import ChamberRange
from rlgcomp.diagnosis.noise.model import Noise
from rlgcomp.diagnosis.prepare import AnySimulator, Prepared
from rlgcomp.diagnosis.regions.turntable import with_angle_rows
from rlgcomp.diagnosis.report.record import Request
from rlgcomp.diagnosis.report.result import Diagnosis
from rlgcomp.diagnosis.search.states import State
from rlgcomp.errors import InputError
from rlgcomp.noise.processes import NoiseModel
from rlgcomp.numerics.compiled import one_blas_thread
from rlgcomp.physics import CATALOGUE
from rlgcomp.physics.mechanism import Mechanism
from rlgcomp.physics.user import require_computable
from rlgcomp.recording import Recording
from rlgcomp.recording.argument_checks import require_recordings, require_seed, told_apart
from rlgcomp.report.messages import Message, message
from rlgcomp.units import display_unit


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
        Of this gyro at rest, measured: the runs are held against it. By default slow noise is as the simulator states it, where it
        does, and all else is estimated from the runs.
    chamber : (float, float, float), optional
        Lowest and highest temperature in degC and fastest ramp in degC/min for the next experiment; by default as recorded.
    black_box : bool
        Train an LS-SVM on the same runs, for comparison.
    seed : int
        Of the draws that p-values and intervals of the improvement are made of.
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
    train, confirm, test = told_apart({"train": train, "confirm": confirm, "test": test})
    if output is not None:
        train, confirm, test = ([_with_a_gyro(run) for run in runs] for runs in (train, confirm, test))
    tell = progress or (lambda fraction: None)
    candidates = _candidates(mechanisms, without, only)
    runs = Prepared.of(simulator, simulated, train, confirm, test, gyro=gyro, output=output)
    require_computable(candidates, [*runs.train, *runs.confirm, *runs.test])
    request = request_of(runs, candidates, gyro, output, unit)
    request = dataclasses.replace(request, without=tuple(without), only=tuple(only), seed=seed)
    tell(0.05)
    limits = None if chamber is None else ChamberRange.of(chamber)
    case = Case(runs, candidates, request, gyro, output, window_s, _measured(noise, output))
    case.data([*runs.confirm, *runs.test]).require_a_window()
    chosen = Choice.of(case, [*runs.train, *runs.confirm])
    tell(0.9)
    found = _fitted(case, chosen, limits)
    if black_box:
        compensation = BlackBox.of(found.before, case.recorded, case.output, [*found.confirm_runs, *found.test_runs])
        found = dataclasses.replace(found, black_box=compensation)
    tell(1.0)
    return found


def _fitted(case: Case, chosen: Choice, chamber: ChamberRange | None) -> Diagnosis:
    """The decision, fitted to the training runs alone."""
    posterior = chosen.posterior
    decision = decided(posterior)
    data, best = case.data(case.runs.train), _best(posterior, decision)
    best, baseline = calibrated_last(case, best, chosen.beside, data)
    alone = baseline if baseline.simulator == chosen.alone.simulator else chosen.alone.linearised(data)
    if case.turns:
        own = (basis for state in (best, *likely(posterior)) for member in state.members for basis in member.form.bases)
        data = with_angle_rows(data, [*bases_of(posterior.regions.values()), *own], case.output)
    data, data_alone = baseline.less_stated(data), alone.less_stated(data)
    bank = Bank(data, baseline.design(data), None if case.turns else baseline)
    bank_alone = bank if alone is baseline else Bank(data_alone, alone.design(data), None if case.turns else alone)
    before = Fit(data_alone, alone, bank_alone, in_training(_without(best, posterior), bank_alone))
    after = Fit(data, baseline, bank, in_training(best, bank))
    if decision.verdict == "none" and after.excess[1] < LOUDER:
        decision = Decision("unknown", (), louder=True)
    states = likely(posterior) if decision.verdict == "ambiguous" else []
    rivals = [Fit(data, baseline, bank, in_training(state, bank)) for state in states]
    following, promise = next_experiment(posterior, rivals, states, chamber)
    read = {column for member in after.state.members for column in posterior.regions[member.form.region].drivers}
    test, lacking = _with_columns(case.runs.test, read & set(data.columns))
    return Diagnosis(
        decision,
        posterior,
        before,
        after,
        case.data([run for run in case.runs.confirm if set(data.columns) & read <= set(run.columns)]).runs,
        case.data(test).runs,
        case.candidates,
        case.request,
        preparation=(*lacking, *chosen.messages, *case.runs.messages),
        warnings=case.runs.warnings,
        alignment=case.runs.alignment,
        next_experiment=following,
        next_message=promise,
    )


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
    if best.process is not None:
        return State((), Noise(encoder=best.noise.encoder), 0.0)
    if not best.members:
        return _null(posterior)
    return State((), best.noise.of_gyro.without_wander, 0.0)


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
    return dataclasses.replace(noise, measured=True)


def _with_a_gyro(run: Recording) -> Recording:
    """A recording of another quantity that has no gyro, with one of zeros, which takes no part."""
    if run.gyro_columns:
        return run
    return Recording(run.table.assign(gyro_deg_h=0.0), run.metadata, name=run.name, findings=run.findings)


def _candidates(
    mechanisms: Mapping[str, type[Mechanism]], without: Sequence[str], only: Sequence[str]
) -> dict[str, type[Mechanism]]:
    """Candidates by name, some left out or some alone.

    Raises
    ------
    InputError
        A name is not among them, or all that is asked for is left out.
    """
    unknown = [name for name in (*without, *only) if name not in mechanisms]
    if unknown:
        raise InputError(f"{', '.join(map(repr, unknown))} is no candidate; candidates are {', '.join(mechanisms)}")
    chosen = {name: mechanism for name, mechanism in mechanisms.items() if name in only} if only else dict(mechanisms)
    rest = {name: mechanism for name, mechanism in chosen.items() if name not in without}
    if only and not rest:
        raise InputError(f"{', '.join(only)} is all that is tried and is left out as well; leave out less, or name more")
    return rest


def request_of(
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
