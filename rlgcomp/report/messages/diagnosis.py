"""Messages of diagnosis: the verdict, what it gains, and remarks. Units are data, because outputs differ."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final

from rlgcomp.report.messages.wording import (
    MEMORIES,
    capital,
    change_text,
    estimate_text,
    interval_text,
    listing,
    p_text,
    percent_text,
    probability_text,
    region_words,
    rms_text,
    time_text,
)


def _words(names: Sequence[str], joined: str = "and") -> str:
    """Mechanisms, laws or sets of them in a sentence."""
    return listing([region_words(name) for name in names], joined)


def _cause(cause: Mapping[str, Any]) -> str:
    instead = [*map(region_words, cause["instead"]), *(["nothing"] if cause["perhaps_nothing"] else [])]
    either = f" or, in its place, {listing(instead, 'or')}" if instead else ""
    name = region_words(f"form:{cause['mechanism']}") if cause.get("other_form") else cause["mechanism"]
    return f"{name}{either} (probability {probability_text(cause['probability'])}{_in_runs(cause)})"


def _in_runs(cause: Mapping[str, Any]) -> str:
    return f"; in {len(cause['runs'])} of {cause['of']} runs" if cause.get("runs") else ""


_SLOW: Final = "a slow error that follows no law of one or two recorded columns"


def causes(simulator: str, causes: Sequence[Mapping[str, Any]], slow_error: Mapping[str, Any] | None = None) -> str:
    return f"{capital(simulator)} lacks {listing([_cause(one) for one in causes])}.{_small(slow_error)}"


def _small(slow_error: Mapping[str, Any] | None) -> str:
    """A sentence on a slow error that is no larger than what the forms named may be off by."""
    if slow_error is None or slow_error["missing"]:
        return ""
    probability = probability_text(slow_error["probability"])
    return (
        f" {capital(_SLOW)} is in the likeliest set as well (probability {probability}; "
        f"rms {slow_error['rms']:.2g} {slow_error['unit']}), so small that the form of what is named may make it."
    )


def _lacks(simulator: str, causes: Sequence[Mapping[str, Any]]) -> str:
    """The beginning of a sentence in which something follows the causes."""
    named = f"{listing([_cause(one) for one in causes])}, and " if causes else ""
    return f"{capital(simulator)} lacks {named}"


def law(
    simulator: str,
    causes: Sequence[Mapping[str, Any]],
    laws: Sequence[Mapping[str, Any]],
    slow_error: Mapping[str, Any] | None = None,
) -> str:
    texts = [
        f"{region_words(one['law'])} ({MEMORIES[one['memory']]}; probability {probability_text(one['probability'])}{_in_runs(one)})"
        for one in laws
    ]
    form = "these forms" if len(laws) > 1 else "this form"
    also = ""
    if slow_error is not None and slow_error["missing"]:
        also = f" It lacks {_SLOW} besides (probability {probability_text(slow_error['probability'])})."
    return f"{_lacks(simulator, causes)}{listing(texts)}; no candidate mechanism has {form}.{also}{_small(slow_error)}"


def wander(simulator: str, causes: Sequence[Mapping[str, Any]], probability: float, *, stated: bool = False) -> str:
    beyond = ", beyond the slow noise that is stated" if stated else ""
    return f"{_lacks(simulator, causes)}{_SLOW}{beyond} (probability {probability_text(probability)})."


def louder(simulator: str, ratio: float, p_value: float) -> str:
    return (
        f"{capital(simulator)} leaves {ratio:.3g} times the white noise that is stated ({p_text(p_value)}), and "
        "no recorded column explains the excess."
    )


def _fall(before: float, after: float, floor: float, unit: str) -> str:
    return f"{rms_text(before, floor)} to {rms_text(after, floor)} {unit}"


def gain(
    before: float, after: float, floor: float, unit: str, improvement: float, interval: Sequence[float], averaging_s: float
) -> str:
    return (
        f"On the test runs, which decided nothing, its error falls by {percent_text(improvement)} (95 % interval "
        f"{interval_text(interval)}), from {_fall(before, after, floor, unit)} (rms of {time_text(averaging_s)} means; noise "
        f"{rms_text(floor, floor)})."
    )


def no_gain(before: float, after: float, floor: float, unit: str, improvement: float, interval: Sequence[float], **_: float) -> str:
    return f"On the test runs no gain is proven: {_fall(before, after, floor, unit)}, {change_text(improvement, interval)}."


def loss(before: float, after: float, floor: float, unit: str, improvement: float, interval: Sequence[float], **_: float) -> str:
    return (
        f"On the test runs the error grows: {_fall(before, after, floor, unit)}, {change_text(improvement, interval)}. Do not use "
        "the augmented simulator as it is."
    )


def compensation_better(
    runs: str,
    compensation: float,
    after: float,
    floor: float,
    unit: str,
    target: str,
    less_ci95: Sequence[float],
    named: bool = True,
) -> str:
    simulator = "with the findings" if named else "as calibrated"
    learns = "the output itself" if target == "output" else "what the calibrated simulator leaves"
    return (
        f"An LS-SVM that learns {learns} from the recorded columns of the training runs leaves less of the {runs} runs, "
        f"{rms_text(compensation, floor)} {unit}, than the simulator {simulator}, {rms_text(after, floor)} {unit} "
        f"({interval_text(less_ci95)} less where the mean of each run is taken out, 95 % interval): recorded columns hold more "
        "than is named."
    )


def learnt_from_columns(causes: Sequence[str], share: float) -> str:
    names = listing(["A slow error" if one == "wander" else region_words(one) for one in causes])
    return (
        f"{names} was compared with laws of one or two recorded columns alone. An LS-SVM predicts from all recorded columns "
        f"{percent_text(share)} of what the findings leave of runs that it was not trained on (squares, without noise and the mean "
        "of each run): a law of more columns, or of another form, may be what is missing there."
    )


def bias_step(run: str, at_s: float, since_start_s: float, size: float, sd: float, unit: str) -> str:
    del at_s
    return (
        f"The bias of {run} steps by {estimate_text(size, sd, unit)} {time_text(since_start_s)} after its start; no law can be "
        "learnt of one event."
    )


def run_biases(
    biases: Mapping[str, float],
    sds: Mapping[str, float],
    unit: str,
    improvement: float | None = None,
    interval: Sequence[float] | None = None,
) -> str:
    texts = [f"{run} {estimate_text(value, sds[run], unit)}" for run, value in biases.items()]
    tested = ""
    if improvement is not None:
        tested = (
            " The test runs have such biases too, which no other run tells and which stay in their error. About each run's own "
            f"mean there is {change_text(improvement, interval)}."
        )
    return f"Each run has a bias of its own: {listing(texts)}.{tested}"


def late_thermometer(column: str, lag_s: float, sd_s: float, instead: Sequence[str]) -> str:
    alike = listing([f"a fast part of {name}" for name in instead] or ["a temperature_rate"], "or")
    return (
        f"The thermometer {column} is late by {estimate_text(lag_s, sd_s, 's')}: the gyro follows the temperature before its "
        f"readings show it. No physics is missing there, unless that sensor is known to be faster: {alike} would look alike."
    )


def late_monitor(column: str, lag_s: float, sd_s: float) -> str:
    return (
        f"The column {column} is late by {estimate_text(lag_s, sd_s, 's')}: the gyro follows the quantity before its readings show "
        "it. A slow sensor or logger does that, and no physics is missing there."
    )


def wrong_number(mechanism: str, parameter: str, stated: float, found: float, sd: float, unit: str) -> str:
    return (
        f"The stated {parameter} of {mechanism} does not fit: {stated:.6g} is stated, {estimate_text(found, sd, unit)} found. If "
        "the stated value is exact, an effect of this form is missing."
    )


def indistinguishable(mechanism: str, others: Sequence[str], probabilities: Sequence[float]) -> str:
    texts = [f"{region_words(name)} ({probability_text(p, 2)})" for name, p in zip(others, probabilities, strict=True)]
    return f"These runs cannot tell {region_words(mechanism)} from {listing(texts, 'or')}."


def perhaps_nothing(mechanism: str, probability: float, rms: float, floor: float, unit: str) -> str:
    return (
        f"{region_words(mechanism)} may be nothing: the same set without it has the probability "
        f"{probability_text(probability, 2)}. Its rms is {rms:.2g} {unit}, that of the noise {rms_text(floor, floor)} {unit}."
    )


def rested(mechanism: str, column: str, value: float, unit: str) -> str:
    return (
        f"{mechanism}: every run begins as if {column} had rested at {value:.3g} {unit}".rstrip()
        + " before it. A run after another rest begins otherwise."
    )


def approximate(mechanism: str, equation: str, parameters: Sequence[str]) -> str:
    numbers, stay = listing(parameters), "stays" if len(parameters) == 1 else "stay"
    return (
        f"What {region_words(mechanism)} follows is determined, its form is not: the function found is only about {equation}, so "
        f"{numbers} of that equation {stay} undetermined; diagnosis.json and the figure give the function found."
    )


def unstated(regions: Sequence[str], named: Sequence[str]) -> str:
    return (
        f"The set, its predictions and augmented.yaml hold {_words(regions)} as well: of the columns and memory of "
        f"{_words(named, 'or')}, and taken for a part of its form, not for a finding of its own."
    )


def jumps(count: int, dwell_s: float) -> str:
    return (
        f"The slow error of no recorded column jumps {count} times in these runs, every {time_text(dwell_s)} on average, and more "
        "than two values are likelier than two; look for what is switched or set at these times."
    )


def cancelling(one: str, other: str, correlation: float, ratio: float) -> str:
    return (
        f"{region_words(one)} and {region_words(other)} nearly cancel in these runs (correlation {correlation:.3f}; each is "
        f"{ratio:.1f} times as large as both together): their sum is known, their single numbers are not."
    )


def extrapolated(run: str, column: str, recorded: Sequence[float], learnt: Sequence[float], unit: str, share: float) -> str:
    spans = (f"{low:.4g} to {high:.4g} {unit}".rstrip() for low, high in (recorded, learnt))
    return (
        f"{run} goes beyond the training runs in {column} for {percent_text(share)} of its time: {next(spans)}, trained on "
        f"{next(spans)}; there the function found is extrapolated."
    )


def noise_not_as_stated(stated: float, found: float) -> str:
    return (
        f"The angle random walk that these runs show is {found:.2g} deg/√h, {found / stated:.2g} times the {stated:.2g} deg/√h "
        "that is stated."
    )


def not_in_file(parts: Sequence[str]) -> str:
    return (
        f"augmented.yaml predicts other runs and holds nothing that belongs to single runs or sensors (histories, steps, phases, "
        f"delays): parts of {_words(parts)} are not in it."
    )


def gain_of_numbers(mechanisms: Sequence[str], before: float, after: float, floor: float, unit: str) -> str:
    return (
        f"The test runs are predicted without {_words(mechanisms)}. That their error changes from "
        f"{_fall(before, after, floor, unit)} is no gain of a finding: it is that of the simulator's own numbers, calibrated "
        "beside it."
    )


def file_gain(before: float, after: float, file: float, floor: float, unit: str, improvement: float) -> str:
    return (
        f"The gain is that of the fit. augmented.yaml by itself leaves {rms_text(file, floor)} {unit} of the test runs, "
        f"{change_text(improvement)} than the {rms_text(before, floor)} {unit} before, where the fit leaves "
        f"{rms_text(after, floor)} {unit}: the file starts every run alike, and holds no history or delay."
    )


def null_possible(probability: float) -> str:
    return f"With probability {probability_text(probability, 2)} nothing is missing."


def nothing_missing(simulator: str, probability: float, p_value: float) -> str:
    return (
        f"{capital(simulator)} lacks nothing that the training runs show (probability that nothing is missing "
        f"{probability_text(probability, 2)}; {p_text(p_value)})."
    )


def nothing_named(simulator: str, probability: float) -> str:
    return (
        f"{capital(simulator)} lacks nothing that these runs can name, though something may be missing "
        f"(probability {probability_text(1.0 - probability, 2)})."
    )


def no_programme_parts(sets: Sequence[str], separation: float) -> str:
    return (
        f"No programme within the recorded ranges can tell {_words(sets, 'from')}: their predictions differ by "
        f"{separation:.2g} standard deviations at most. A further monitor might."
    )


def next_experiment(sets: Sequence[str], profile: str, duration_s: float, expected: float) -> str:
    likely = probability_text(expected, 2)
    about = likely.replace("> ", "more than ") if likely.startswith(">") else f"about {likely}"
    return (
        f"To tell {_words(sets, 'from')}, record a run on the programme `{profile}` ({time_text(duration_s)}): the true one of "
        f"these would then have a probability of {about}."
    )


def set_uncertain(probability: float, other: str, of_other: float) -> str:
    return f"The set named has the probability {probability:.2f}; the next, {region_words(other)}, {of_other:.2f}."


def _by_run(values: Mapping[str, float], sds: Mapping[str, float], unit: str) -> str:
    return listing([f"{estimate_text(value, sds[run], unit)} in {run}" for run, value in values.items()])


def no_clock(columns: Sequence[str], drifts_ppm: Mapping[str, float], sds_ppm: Mapping[str, float], limit_ppm: float) -> str:
    drifts = _by_run(drifts_ppm, sds_ppm, "ppm")
    return (
        f"The simulation's {listing(columns)} would need time stamps that are off by {drifts}. Clocks are off by "
        f"less than {limit_ppm:g} ppm: rather a time constant of the simulator is wrong, such as its thermal model's. No time "
        "offset was taken out; if it is the clock, correct the time stamps."
    )


def clock(run: str, offset_s: float, offset_sd_s: float, drift_ppm: float, drift_sd_ppm: float, column: str) -> str:
    return (
        f"The clock of {run}'s simulation differs from the recording's: {estimate_text(offset_s, offset_sd_s, 's')} and "
        f"{estimate_text(drift_ppm, drift_sd_ppm, 'ppm')} of the time that passes were added to its time stamps (from {column})."
    )


def rows_without_simulation(run: str, not_simulated: int, turning_unevenly: int) -> str:
    parts = [f"{not_simulated} rows that its simulation does not cover"] if not_simulated else []
    if turning_unevenly:
        parts.append(
            f"{turning_unevenly} rows in which its table speeds up or slows down by more than its simulation's clock and rows "
            "determine"
        )
    return f"{run}: {listing(parts)} are left out."


def in_some_runs(mechanism: str, runs: Sequence[str], of: int) -> str:
    return (
        f"{region_words(mechanism)} acts in {listing(runs)} alone, of {of} training runs: whether it acts in another run is "
        "not known, and test runs are predicted without it."
    )


def phase_by_run(mechanism: str, rms: Mapping[str, float], unit: str) -> str:
    sizes = listing([f"{value:.3g} {unit} in {run}" for run, value in rms.items()])
    return (
        f"The phase of {region_words(mechanism)} differs from run to run and is known of no other run: test runs are predicted "
        f"without it, and it stays in their error (its rms is {sizes})."
    )


def scattered_thresholds(mechanism: str, passages: int, rms: float, unit: str) -> str:
    return (
        f"{region_words(mechanism)} switches by {rms:.2g} {unit} (rms of {passages} passages) before or after its thresholds. What "
        "moves them is not recorded: test runs and augmented.yaml have the mean thresholds, and may switch that much too early or "
        "too late."
    )


def telegraph_not_in_file(half_step: float, dwell_s: float) -> str:
    return (
        "augmented.yaml does not hold random_telegraph: when it flips is another matter in each run. Other runs, the test runs "
        "among them, are predicted without it, and it stays in their error. To simulate runs that have it, add to the mechanisms "
        f"of that file: `- random_telegraph: {{half_step_deg_h: {half_step:.4g}, dwell_s: {dwell_s:.4g}}}`."
    )


def larger_than_mismatch(terms: Mapping[str, float], mismatch: float, unit: str) -> str:
    texts = listing([f"{region_words(name)} ({rms:.3g} {unit})" for name, rms in terms.items()])
    verb = "are each" if len(terms) > 1 else "is"
    return (
        f"{texts} {verb} larger than the whole mismatch of the training runs ({mismatch:.3g} {unit}): terms cancel each other in "
        "part, or the simulator's own free terms take most of it up."
    )


def findings_worse(
    mechanisms: Sequence[str],
    runs: str,
    before: float,
    after: float,
    floor: float,
    unit: str,
    improvement: float,
    interval: Sequence[float],
    compensation: float | None = None,
) -> str:
    box = ""
    if compensation is not None:
        box = f" An LS-SVM learns nothing of them from recorded columns either: it leaves {rms_text(compensation, floor)} {unit}."
    return (
        f"What was found in the training runs does not hold in the {runs} runs: with {_words(mechanisms)} the simulator leaves "
        f"{rms_text(after, floor)} {unit} of them, without {rms_text(before, floor)} {unit}: "
        f"{change_text(improvement, interval)}.{box}"
    )


def left_over(runs: Mapping[str, Sequence[Mapping[str, Any]]], unit: str, *, named: bool) -> str:
    texts = [f"the {part} run {_left(one, unit)}" for part, of_part in runs.items() for one in of_part]
    beyond = "What is named does not describe" if named else "Noise alone does not describe"
    advice = "more runs like it for training" if len(texts) == 1 else "more runs like these for training"
    return (
        f"{beyond} {listing(texts)}. Something acts there that the other runs do not show, or a fault of the recording: look at "
        f"its output, and give {advice}."
    )


def _left(one: Mapping[str, Any], unit: str) -> str:
    ratio = f"{one['std'] / one['noise']:.2g} times its noise of {one['noise']:.2g} {unit}"
    mean = f"; its mean is off by {one['mean']:.2g} {unit}" if one["mean"] else ""
    return f"{one['run']} (about its mean {one['std']:.2g} {unit} are left, {ratio}{mean})"


def strength_by_run(
    mechanism: str, rms: Mapping[str, float], unit: str, opposite_in: Sequence[str] = (), *, has_mean: bool = False
) -> str:
    sizes = listing([f"{value:.3g} {unit} in {run}{' with the other sign' * (run in opposite_in)}" for run, value in rms.items()])
    mean = "; other runs are predicted with the mean amplitude" if has_mean else ""
    return f"The amplitude of {region_words(mechanism)} differs from run to run: rms {sizes}{mean}."


def amplitude_by_run(parameter: str, differences: Mapping[str, float], sds: Mapping[str, float], unit: str) -> str:
    sizes = _by_run(differences, sds, unit)
    return f"{parameter} of the simulator differs from run to run, from the common value by {sizes}."


def unsettled(mechanism: str, sizes: Mapping[str, float], sds: Mapping[str, float], unit: str) -> str:
    return (
        f"{region_words(mechanism)} had not settled when runs began: what came before them still acts, by "
        f"{_by_run(sizes, sds, unit)} at first. It belongs to these runs; others, the test runs among them, are predicted as if "
        "they began at rest."
    )


def clock_of_all_runs(offsets_s: Mapping[str, float], sds_s: Mapping[str, float]) -> str:
    return (
        f"The clock of the simulation is off: its time stamps are right with {_by_run(offsets_s, sds_s, 's')} added to them. No "
        "monitor tells it, all runs together do; no physics is missing there."
    )


def clock_beyond_its_runs(offsets_s: Mapping[str, float], sds_s: Mapping[str, float], most_s: float) -> str:
    return (
        f"No clock that is off by up to {most_s:.4g} s makes the simulated runs follow the recorded ones, and one further off does "
        f"({_by_run(offsets_s, sds_s, 's')}): are the files of --simulated of these runs, those of --train first, then those of "
        "--confirm and --test, each in the order of the runs? If they are not, nothing that is told here holds."
    )


_READINGS: Final = {
    "angle": "the gyro does not follow it: {instead} is used instead, which it follows at least twice as closely",
    "middle": "as where it is read in the middle of each sample",
    "instant": "as where it is the rate at the end of each sample and no mean",
}
_IN_TIME: Final = 0.05  # of a sample


def time_stamp_convention(
    run: str, column: str, means: str, instead: str, late_samples: float, sd_samples: float, left_out: float
) -> str:
    how = _READINGS[means].format(instead=instead)
    if abs(late_samples) < _IN_TIME:
        return f"{run}: {column} is in time, but {how}."
    by = "late" if late_samples > 0.0 else "ahead"
    size = estimate_text(abs(late_samples), sd_samples, "of a sample")
    lost = f" {percent_text(left_out)} of the rows do not tell how the table turned, and are left out." if left_out else ""
    return (
        f"{run}: {column} is {by} against the gyro by {size}, {how}. That is how it was recorded, or a delay of just as much, and "
        f"no physics of the gyro.{lost}"
    )


def identity(column: str, output_is: str) -> str:
    what = "its rate of change" if output_is == "rate" else "its integral over time"
    laws = "laws of its memory" if output_is == "rate" else "laws of it"
    return f"{column} is another reading of the output, which is {what}: {laws} without a name were left out."


def simulation_scaled(ratio: float, correlation: float, wrong_sign: bool, wrong_unit: bool) -> str:
    doubt = "is its sign right?" if wrong_sign else "is its unit right (gyro_deg_h holds deg/h)?"
    if wrong_sign and wrong_unit:
        doubt = "are its sign and its unit right (gyro_deg_h holds deg/h)?"
    times = f"{float(f'{ratio:.2g}'):g} times"
    return f"The recordings are about {times} the output of your simulator (correlation {correlation:.2f}): {doubt}"


TEXTS: Final = {
    "not_tried": "Not tried, because the runs lack a column that they read: {mechanisms}.",
    "left_out": "Left out of the candidates as requested: {mechanisms}.",
    "only": "Only these candidates were tried, beside laws without a name: {mechanisms}.",
    "confirmed": "{runs} took part in the choice of the set and not in the fit: given with --confirm, no proof.",
    "absorbed": "Not tried, because the simulator's own terms can take its place in these runs: {mechanisms}.",
    "run_lacks_column": "{run} lacks {columns}, which a finding reads: it takes no part in the proof.",
    "unidentified": "These runs do not determine {parameters} of {mechanism}: the error exceeds the value.",
    "no_test_runs": "No run was given with --test, so nothing is proven: the numbers are those of the training runs.",
    "beside_own_simulator": "augmented.yaml holds the findings alone: add its prediction to that of {simulator}.",
    "other_form": (
        "The form found for {mechanism} is not the catalogue's equation: {equation}; diagnosis.json and the figure give the "
        "function found."
    ),
    "file_differs": (
        "augmented.yaml predicts the training runs otherwise than the fit, by {error:.2g} times the noise of a {averaging_s:.3g} s "
        "mean."
    ),
    "rate_of_encoder": (
        "{run} has no rate of the table: it is taken as the mean over each sample, from {column}; rows of which that does not tell "
        "the rate, those at the ends and some at gaps, are left out: {rows}."
    ),
}
