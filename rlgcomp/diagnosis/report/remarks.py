"""What a diagnosis tells beside its numbers: the headline, the gain, and remarks, the most consequential first."""

from __future__ import annotations

import functools
import itertools
from collections.abc import Callable, Iterator, Mapping
from typing import Any, Final

import numpy as np

from rlgcomp.diagnosis.answer.fit import Estimate
from rlgcomp.diagnosis.answer.scores import Score
from rlgcomp.diagnosis.data import Run
from rlgcomp.diagnosis.decide import TELEGRAPH
from rlgcomp.diagnosis.equations.findings import Cause, shown_name
from rlgcomp.diagnosis.forms.drivers import Driver, Path
from rlgcomp.diagnosis.forms.memories import Plays, Preisach, Relays, rest_of
from rlgcomp.diagnosis.noise.errors import within
from rlgcomp.diagnosis.noise.hypotheses import Hypotheses
from rlgcomp.diagnosis.regions.clocks import CLOCK, largest_offset_s
from rlgcomp.diagnosis.regions.lateness import LATE, LATE_MONITOR, LATE_THERMOMETER
from rlgcomp.diagnosis.regions.nuisances import RUN_BIAS
from rlgcomp.diagnosis.regions.passages import scatter_of
from rlgcomp.diagnosis.regions.selections import BY_RUN
from rlgcomp.diagnosis.report.record import Record
from rlgcomp.physics.mechanism import Mechanism
from rlgcomp.report.messages import Message, message
from rlgcomp.report.messages.consequence import by_consequence
from rlgcomp.units import display_unit, is_thermometer

_POSSIBLE: Final = 0.05  # probability that nothing is missing from which that is told beside a finding
_RATHER_SURE: Final = 0.8  # probability that nothing is missing, below which the headline says that something may be
_UNCERTAIN: Final = 0.8  # of the set, below which the next one is told
_BEYOND: Final = 0.05  # of a driver's range, by which a test run goes beyond it,
_LASTING: Final = 0.01  # of its windows at least
_OTHER_FILE: Final = 0.1  # of the error of the test runs, by which augmented.yaml may leave another
_CANCEL: Final = -0.97  # correlation of two terms,
_LARGE: Final = 4.0  # each so many times as large as their sum
_FILE_ERROR: Final = 0.2  # of the noise of a window mean
_OTHER_NOISE: Final = 1.5
_BEATEN: Final = 0.02  # of the error, by which an LS-SVM leaves less at least
_LESS: Final = 0.05  # of the error, by which an LS-SVM that has learnt something leaves less
_LARGER: Final = 1.5  # times the mismatch, from which on a larger term is told
_LEARNT: Final = 0.5  # of what the findings leave, that recorded columns together tell where a cause follows none
_CLEAR_START: Final = 3.0  # standard deviations of what had not settled when a run began, from which on it is told
_CLEAR_LAG: Final = 3.0  # standard deviations of a lag, from which on it is told


def headline(record: Record) -> Message:
    """The verdict with what is named."""
    causes = [_cause(one) for one in record.causes]
    simulator, slow = record.request.simulator, _slow_error(record)
    if record.verdict == "none" and record.healthy < _RATHER_SURE:
        return message("diagnosis.nothing_named", simulator=simulator, probability=record.healthy)
    if record.verdict == "none":
        return message("diagnosis.nothing_missing", simulator=simulator, probability=record.healthy, p_value=record.p_value)
    if record.decision.louder:
        ratio, p_value = record.after.excess
        return message("diagnosis.louder", simulator=simulator, ratio=ratio, p_value=p_value)
    if record.laws:
        laws = [
            {"law": one.name, "drivers": one.drivers, "memory": one.memory, "probability": one.probability} | _in_runs(one)
            for one in record.laws
        ]
        return message("diagnosis.law", simulator=simulator, causes=causes, laws=laws, slow_error=slow)
    if record.decision.wander:
        probability, stated = record.posterior.of_latent("wander"), Hypotheses.of(record.after.data).stated
        return message("diagnosis.wander", simulator=simulator, causes=causes, probability=probability, stated=stated)
    return message("diagnosis.causes", simulator=simulator, causes=causes, slow_error=slow)


def _cause(one: Cause) -> dict[str, Any]:
    return {
        "mechanism": one.name,
        "probability": one.probability,
        "instead": one.indistinguishable_from,
        "perhaps_nothing": one.perhaps_nothing,
        **({"other_form": True} if one.of_simulator else {}),
    } | _in_runs(one)


def _in_runs(one: Cause) -> dict[str, Any]:
    """Runs that a finding acts in, of all training runs, where they are some alone."""
    return {"runs": one.acts_in, "of": len(one.runs)} if len(one.acts_in) < len(one.runs) else {}


def _slow_error(record: Record) -> dict[str, Any] | None:
    """The slow error of no recorded column in the likeliest set, and whether it is large enough to be missing; None without one."""
    if not record.slow_error_rms:
        return None
    return {
        "probability": record.slow_error_probability,
        "rms": record.slow_error_rms,
        "unit": record.unit,
        "missing": record.decision.wander,
    }


def gain(record: Record) -> Message | None:
    """What the findings gain on the test runs; None where nothing is named."""
    if record.verdict == "none":
        return None
    if record.test is None:
        return message("diagnosis.no_test_runs")
    low, high = record.test.improvement_ci95
    data = {**_errors(record.test), "improvement": record.test.improvement, "interval": (low, high)}
    data["averaging_s"] = record.test.averaging_s
    if low > 0.0:
        return message("diagnosis.gain", **data)
    return message("diagnosis.loss", **data) if high < 0.0 else message("diagnosis.no_gain", **data)


def _errors(score: Score) -> dict[str, Any]:
    return {
        "before": score.baseline_rms,
        "after": score.augmented_rms,
        "floor": score.noise_floor_rms,
        "unit": score.unit,
    }


def remarks(record: Record) -> tuple[Message, ...]:
    """Remarks beside headline and gain, the most consequential first."""
    every = (
        *_other_runs(record),
        *_worse(record),
        *_left_over(record),
        *record.warnings,
        *_doubts(record),
        *_black_box(record),
        *_gain_of_numbers(record),
        *_selections(record),
        *_larger(record),
        *_rests(record),
        *_scatters(record),
        *_baseline(record),
        *_forms(record),
        *_extrapolations(record),
        *(() if record.next_message is None else (record.next_message,)),
        *_file(record),
        *_choices(record),
        *record.preparation,
    )
    return by_consequence(every)


def _other_runs(record: Record) -> Iterator[Message]:
    """Simulated runs that are none of the recorded ones, as a clock further off tells than any that is tried."""
    offsets_s, sds_s = _by_run(record.recalibration.get(CLOCK, {}))
    most_s = largest_offset_s(record.after.data)
    if max(map(abs, offsets_s.values()), default=0.0) > most_s:
        yield message("diagnosis.clock_beyond_its_runs", offsets_s=offsets_s, sds_s=sds_s, most_s=most_s)


def _doubts(record: Record) -> Iterator[Message]:
    if record.verdict == "none":
        return
    if record.healthy > _POSSIBLE:
        yield message("diagnosis.null_possible", probability=record.healthy)
    for cause in record.members:
        if others := cause.indistinguishable_from:
            probabilities = cause.rival_probabilities
            yield message("diagnosis.indistinguishable", mechanism=cause.name, others=others, probabilities=probabilities)
        if cause.perhaps_nothing:
            yield message(
                "diagnosis.perhaps_nothing",
                mechanism=cause.name,
                probability=cause.perhaps_nothing,
                rms=cause.rms,
                floor=record.after.noise_rms,
                unit=record.unit,
            )
    if record.probability < _UNCERTAIN and record.alternatives:
        other = record.alternatives[0]
        yield message(
            "diagnosis.set_uncertain",
            probability=record.probability,
            other=" + ".join(other.mechanisms) or "nothing",
            of_other=other.probability,
        )


def _worse(record: Record) -> Iterator[Message]:
    """Findings that make runs worse which they were not fitted to."""
    names = [one.name for one in record.members] or ["wander"] * record.decision.wander  # a wander predicts nothing
    for runs, one in (("test", record.test), ("confirm", record.confirm)):
        if names and one is not None and one.improvement_ci95[1] < 0.0:
            yield message(
                "diagnosis.findings_worse",
                mechanisms=names,
                runs=runs,
                **_errors(one),
                improvement=one.improvement,
                interval=one.improvement_ci95,
                compensation=None if _learns(one) else one.compensation_rms,
            )
            return


def _left_over(record: Record) -> Iterator[Message]:
    """Runs of which more is left than noise."""
    if record.left_over:
        runs = {part: [one._asdict() for one in of_part] for part, of_part in record.left_over.items()}
        yield message("diagnosis.left_over", runs=runs, unit=record.unit, named=record.verdict != "none")


def _learns(one: Score) -> bool:
    """Whether the LS-SVM leaves clearly less of runs than the calibrated simulator does, each run about its mean."""
    return one.compensation_std is not None and one.compensation_std < (1.0 - _LESS) * one.baseline_std


def _black_box(record: Record) -> Iterator[Message]:
    """Where an LS-SVM of recorded columns learns more than is named, which leaves more than noise."""
    box, learnt = record.black_box, record.learnt
    if box is None:
        return
    if record.latent and learnt is not None and learnt > _LEARNT:
        yield message("diagnosis.learnt_from_columns", causes=record.latent, share=learnt)
    for runs, one in (("test", record.test), ("confirm", record.confirm)):
        if one is None or one.over_compensation_ci95 is None or one.over_compensation_std_ci95 is None:
            continue
        if one.augmented_std <= one.noise_floor_rms or not _learns(one):
            continue
        if one.over_compensation_ci95[1] < -_BEATEN and one.over_compensation_std_ci95[1] < 0.0:
            yield message(
                "diagnosis.compensation_better",
                runs=runs,
                compensation=one.compensation_rms,
                after=one.augmented_rms,
                floor=one.noise_floor_rms,
                unit=one.unit,
                target=box.target,
                less_ci95=[1.0 - 1.0 / (1.0 - end) for end in reversed(one.over_compensation_std_ci95)],
                named=record.verdict != "none",
            )
            return


def _baseline(record: Record) -> Iterator[Message]:
    """Steps, biases of runs, late columns, stated numbers that do not fit."""
    began_s = {run.name: float(run.binned.time_s[0]) for run in record.after.data.runs}
    for step in record.steps:
        size: Mapping[str, Any] = step["size"]
        yield message(
            "diagnosis.bias_step",
            run=step["run"],
            at_s=step["at_s"],
            since_start_s=step["at_s"] - began_s[step["run"]],
            size=size["value"],
            sd=size["sd"],
            unit=size["unit"],
        )
    found = record.recalibration
    if RUN_BIAS in found:
        biases, sds = _by_run(found[RUN_BIAS])
        about = {}
        if record.test is not None and record.verdict != "none":
            about = {"improvement": record.test.improvement_std, "interval": record.test.improvement_std_ci95}
        yield message("diagnosis.run_biases", biases=biases, sds=sds, unit=record.unit, **about)
    for region, of_each in record.after.unsettled.items():
        sizes, sds = _by_run({run: one for run, one in of_each.items() if abs(one.value) > _CLEAR_START * one.sd})
        if sizes:
            yield message("diagnosis.unsettled", mechanism=region, sizes=sizes, sds=sds, unit=record.unit)
    if CLOCK in found and not any(_other_runs(record)):
        offsets_s, sds_s = _by_run(found[CLOCK])
        yield message("diagnosis.clock_of_all_runs", offsets_s=offsets_s, sds_s=sds_s)
    for key, of_runs in found.items():
        if key.endswith(BY_RUN):
            (differences, sds), unit = _by_run(of_runs), next(iter(of_runs.values())).unit
            parameter = key.removesuffix(BY_RUN)
            yield message("diagnosis.amplitude_by_run", parameter=parameter, differences=differences, sds=sds, unit=unit)
    yield from _lateness(record)
    simulator = record.after.baseline.simulator
    for mechanism in simulator.mechanisms:
        stated_names = {p.name for p in mechanism.parameters()} - simulator.free.get(mechanism.name, frozenset())
        for name, one in found.get(mechanism.name, {}).items():
            if name in stated_names:
                numbers = {"stated": getattr(mechanism, name), "found": one.value, "sd": one.sd, "unit": one.unit}
                parameter = shown_name(name, record.unit)
                yield message("diagnosis.wrong_number", mechanism=mechanism.name, parameter=parameter, **numbers)


def _by_run(estimates: Mapping[str, Estimate]) -> tuple[dict[str, float], dict[str, float]]:
    """Values and standard deviations by run."""
    return {run: one.value for run, one in estimates.items()}, {run: one.sd for run, one in estimates.items()}


def _lateness(record: Record) -> Iterator[Message]:
    """Columns that are late, thermometers with the findings whose fast parts would look alike."""
    for column, lag in _clear_lags(record, LATE_THERMOMETER).items():
        alike = [one.name for one in record.causes if one.memory == "dynamic" and column in one.drivers]
        yield message("diagnosis.late_thermometer", column=column, lag_s=lag.value, sd_s=lag.sd, instead=alike)
    for column, lag in _clear_lags(record, LATE_MONITOR).items():
        yield message("diagnosis.late_monitor", column=column, lag_s=lag.value, sd_s=lag.sd)


def _clear_lags(record: Record, kind: str) -> dict[str, Estimate]:
    """Delays of columns that are told from zero."""
    return {column: lag for column, lag in record.recalibration.get(kind, {}).items() if lag.value > _CLEAR_LAG * lag.sd}


def _gain_of_numbers(record: Record) -> Iterator[Message]:
    """Test runs that are predicted without any finding: their error changes by the simulator's own numbers alone."""
    if record.verdict == "none" or record.test is None or not record.members:
        return
    fit, named = record.after, {one.region for one in record.decision.named}
    acting = [k for k, member in enumerate(fit.state.members) if member.form.region in named]
    if not any(np.any(fit.term(k, run)) for k, run in itertools.product(acting, record.test_runs)):
        names = [one.name for one in record.members]
        yield message("diagnosis.gain_of_numbers", mechanisms=names, **_errors(record.test))


def _selections(record: Record) -> Iterator[Message]:
    """Findings that act in some of the runs, or by another amplitude or phase in each."""
    for cause in record.members:
        if len(cause.acts_in) < len(cause.runs):
            yield message("diagnosis.in_some_runs", mechanism=cause.name, runs=cause.acts_in, of=len(cause.runs))
        elif cause.has_mean:
            signs = {"opposite_in": cause.opposite_in, "has_mean": cause.has_mean}
            yield message("diagnosis.strength_by_run", mechanism=cause.name, rms=cause.runs, unit=cause.unit, **signs)
        elif cause.runs:  # a wave
            yield message("diagnosis.phase_by_run", mechanism=cause.name, rms=cause.runs, unit=cause.unit)


def _larger(record: Record) -> Iterator[Message]:
    """Findings that are larger than all that is missing."""
    mismatch = record.train.baseline_rms
    terms = {cause.name: cause.rms for cause in record.members if cause.rms > _LARGER * mismatch}
    if terms:
        yield message("diagnosis.larger_than_mismatch", terms=terms, mismatch=mismatch, unit=record.unit)


def _rests(record: Record) -> Iterator[Message]:
    """Where the driver of a hysteresis seems to have rested before every run."""
    names = {cause.name for cause in record.members}
    for member in record.after.state.members:
        for basis in within(member.form.lead):
            rest = rest_of(basis) if member.form.region in names and isinstance(basis, Plays | Preisach) else None
            if rest is not None:
                (column,), region = basis.driver.columns, member.form.region
                yield message("diagnosis.rested", mechanism=region, column=column, value=rest, unit=display_unit(column))


def _scatters(record: Record) -> Iterator[Message]:
    """Hops whose thresholds differ from passage to passage."""
    names = {cause.name for cause in record.members}
    for member in record.after.state.members if record.verdict != "none" else ():
        for basis in within(member.form.lead):
            if member.form.region in names and isinstance(basis, Relays) and basis.passages:
                offsets, column = np.concatenate(scatter_of(basis, record.after.data)), basis.driver.columns[0]
                unit, rms = "K" if is_thermometer(column) else display_unit(column), float(np.sqrt(np.mean(offsets**2)))
                scatter = {"passages": len(offsets), "rms": rms, "unit": unit}
                yield message("diagnosis.scattered_thresholds", mechanism=member.form.region, **scatter)


def _forms(record: Record) -> Iterator[Message]:
    for cause in record.members:
        if cause.approximate:
            yield message("diagnosis.approximate", mechanism=cause.name, equation=cause.equation, parameters=cause.undetermined)
        elif cause.undetermined:
            yield message("diagnosis.unidentified", mechanism=cause.name, parameters=cause.undetermined)
        if cause.own_form and not cause.approximate and cause.function is not None and not cause.switches:
            yield message("diagnosis.other_form", mechanism=cause.name, equation=cause.equation)
    if record.decision.unstated:
        yield message("diagnosis.unstated", regions=record.decision.unstated, named=[one.name for one in record.members])
    seen = record.after.state.process
    if record.decision.wander and seen is not None and seen.kind == "levels":
        window_s = record.after.data.runs[0].grid.window_s
        yield message("diagnosis.jumps", count=round(seen.jumps), dwell_s=seen.dwell * window_s)
    yield from _cancelling(record)


def _cancelling(record: Record) -> Iterator[Message]:
    """Terms of the augmented simulator of which only the sum is known."""
    if record.verdict == "none":
        return
    parts: dict[str, Any] = {}
    for mechanism in record.augmented.mechanisms:
        if mechanism.repeats():
            label = getattr(mechanism, "cause", "") or mechanism.name
            parts[label] = parts.get(label, 0.0) + _means(record, mechanism)
    for (one, a), (other, b) in itertools.combinations(parts.items(), 2):
        together = float(np.std(a + b))
        least = min(float(np.std(a)), float(np.std(b)))
        if least > _LARGE * together and together > 0.0:
            correlation = float(np.corrcoef(a, b)[0, 1])
            if correlation < _CANCEL:
                yield message("diagnosis.cancelling", one=one, other=other, correlation=correlation, ratio=least / together)


def _means(record: Record, mechanism: Mechanism) -> Any:
    return record.after.data.means(lambda run: run.on_bins(mechanism.basis(run.binned) @ mechanism.amplitude_values()))


def _extrapolations(record: Record) -> Iterator[Message]:
    """Test runs that go beyond the training runs in what a finding follows: a column, a difference, a rate of change."""
    trained = record.after.data.runs
    for run, (name, (unit, values)) in itertools.product(record.test_runs, _followed(record).items()):
        learnt = np.concatenate([one.window_means(values(one)) for one in trained])
        recorded, low, high = run.window_means(values(run)), float(learnt.min()), float(learnt.max())
        least = _BEYOND * (high - low)
        share = float(np.mean((recorded < low - least) | (recorded > high + least)))
        if share >= _LASTING:
            yield message(
                "diagnosis.extrapolated",
                run=run.name,
                column=name,
                recorded=[recorded.min(), recorded.max()],
                learnt=[low, high],
                unit=unit,
                share=np.mean((recorded < low) | (recorded > high)),
            )


def _followed(record: Record) -> dict[str, tuple[str, Callable[[Run], Any]]]:
    """Names of what the leading bases of the findings follow, with units and values on the bins of a run."""
    named = {one.region for one in record.decision.named}
    leading = [basis for member in record.after.state.members if member.form.region in named for basis in member.form.lead]
    found: dict[str, tuple[str, Callable[[Run], Any]]] = {}
    for one in within(leading):
        if isinstance(one, Driver):
            found[one.symbol] = one.unit, one.raw
        elif isinstance(one, Path) and one.memory == "rate":
            unit = f"{display_unit(one.driver.columns[0]) or '1'}/min"
            found[f"the rate of {one.driver.symbol}"] = unit, functools.partial(_raw_rate, one)
        elif isinstance(one, Mechanism):
            columns = one.driver_columns(record.after.data.runs[0].binned)
            found |= {column: (display_unit(column), functools.partial(Run.column, name=column)) for column in columns}
    return found


def _raw_rate(path: Path, run: Run) -> Any:
    return path.driver.half * path.half * path.values(run)


def _file(record: Record) -> Iterator[Message]:
    if record.request.own_simulator:
        yield message("diagnosis.beside_own_simulator", simulator=record.request.simulator)
    if record.verdict == "none":
        return
    file, alone, test = record.augmented_file, record.file_rms, record.test
    for cause in record.members:
        if cause.name == TELEGRAPH:
            half_step, dwell_s = (one.value for one in cause.parameters.values())
            yield message("diagnosis.telegraph_not_in_file", half_step=half_step, dwell_s=dwell_s)
    if test is not None and alone is not None and abs(alone - test.augmented_rms) > _OTHER_FILE * test.augmented_rms:
        yield message(
            "diagnosis.file_gain",
            before=test.baseline_rms,
            after=test.augmented_rms,
            file=alone,
            floor=test.noise_floor_rms,
            unit=test.unit,
            improvement=1.0 - alone / test.baseline_rms,
        )
    late = {f"{LATE}{column}" for kind in (LATE_THERMOMETER, LATE_MONITOR) for column in _clear_lags(record, kind)}
    parts = [part for part in file.left_out if not part.startswith(LATE) or part in late]
    if parts:
        yield message("diagnosis.not_in_file", parts=parts)
    if file.error > _FILE_ERROR:
        yield message("diagnosis.file_differs", error=file.error, averaging_s=record.train.averaging_s)


def _choices(record: Record) -> Iterator[Message]:
    """Which runs and candidates took part, and whether the noise is the stated one."""
    noise = record.after.data.noise or record.after.baseline.simulator.noise
    stated, found = 0.0 if noise is None else noise.angle_random_walk_deg_sqrt_h, record.noise.angle_random_walk_deg_sqrt_h
    if stated > 0.0 and not 1.0 / _OTHER_NOISE < found / stated < _OTHER_NOISE:
        yield message("diagnosis.noise_not_as_stated", stated=stated, found=found)
    if record.confirm_runs:
        yield message("diagnosis.confirmed", runs=[run.name for run in record.confirm_runs])
    request = record.request
    if request.only:
        yield message("diagnosis.only", mechanisms=request.only)
    if request.without:
        yield message("diagnosis.left_out", mechanisms=request.without)
    if request.not_tried:
        yield message("diagnosis.not_tried", mechanisms=request.not_tried)
