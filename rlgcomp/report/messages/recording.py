"""Messages of recording: findings of files, their column and row being named beside them, and outliers.

A function here takes `run`, the name of a recording, where a message also stands alone.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

from rlgcomp.report.messages.column_names import (
    mapped,
    of_resistance,
    of_thermistor,
    resistance_unit,
    suggested_gyro,
    suggested_time,
)
from rlgcomp.units import value_and_sd


def time_stamps_left_out(*, repeated: int, backward: int) -> str:
    kinds = [f"{repeated} repeated" if repeated else "", f"{backward} backward" if backward > 0 else ""]
    return f"{' and '.join(kind for kind in kinds if kind)} time stamps, rows left out"


def nearly_standard_target(*, nearest: str, source: str) -> str:
    return f"is no standard name and stays a further column; if {nearest} is meant, write {mapped(nearest, source)}"


def _misnamed(meant: Mapping[str, str]) -> str:
    return " and ".join(f"{target} is no standard name: write {name} in its place" for target, name in meant.items())


def no_time_column(*, columns: Sequence[str], dated: Sequence[str], meant: Mapping[str, str]) -> str:
    here = suggested_time(columns, dated)
    general = (
        "map the time with --map time_s='NAME [unit]', of two columns with 'DATE + TIME', a counter with its step, 'COUNT [4 ms]'"
    )
    how = _misnamed(meant) or (f"map the time, here probably with {here}" if here else general)
    return f"no column time_s; the columns are {_listed(columns)}; {how}; without any, give the sample period with --period-s"


def no_gyro_column(
    *, columns: Sequence[str], units: Mapping[str, str], meant: Mapping[str, str], beside: Sequence[str] = ()
) -> str:
    here = suggested_gyro([*columns, *beside], units)
    other = "map one with --map gyro_deg_h='NAME [unit]'; another quantity is diagnosed with --output COLUMN"
    how = _misnamed(meant) or (f"map one, here probably with {here}" if here else other)
    return f"no gyro column; the columns are {_listed(columns)}; {how}"


def names_in_remark(*, columns: Sequence[str]) -> str:
    return f"the columns are named in a remark above the numbers: {_listed(columns)}"


def alphabet(*, encoding: str, names: Sequence[str]) -> str:
    return (
        f"the letters are no UTF-8 and are read as {encoding}: {_listed(names)}; if the names are others, write the file in UTF-8 "
        "or map the columns by their places, as in --map gyro_deg_h='2 [deg/h]'"
    )


def no_names(*, columns: Sequence[str]) -> str:
    return (
        f"the first row holds numbers, so the columns have no names and are counted from {columns[0]} to {columns[-1]}; "
        f"name one by its place, as in --map gyro_z_deg_s={columns[-1]}"
    )


def left_out(*, rows: int, names: Sequence[str], count: int, sheet: str | None = None) -> str:
    more = f" and {count - len(names)} more" if count > len(names) else ""
    return f"the table {'has' if sheet is None else f'is the sheet {sheet}, of'} {rows} rows; not taken: {_listed(names)}{more}"


def numbers_above_names(*, rows: int, first: str) -> str:
    return f"{rows} row{'s' if rows > 1 else ''} of numbers above the line of names left out, the first {first!r}"


def units_row(*, rows: int, units: Mapping[str, str], other: Sequence[str]) -> str:
    stated = ", ".join(f"{name} in {unit}" for name, unit in units.items())
    text = f"{rows} row{'s' if rows > 1 else ''} below the names hold{'' if rows > 1 else 's'} no numbers"
    return text + (f"; taken as units: {stated}" if stated else "") + (f"; left out: {_listed(other)}" if other else "")


def repeated_columns(*, columns: Sequence[str]) -> str:
    return f"column names appear twice: {_listed(columns)}; rename one"


def _listed(names: Sequence[str]) -> str:
    return ", ".join(names) or "none"


def other_delay(*, run: str, delay_s: float) -> str:
    late = "late" if delay_s > 0.0 else "early"
    return (
        f"{run}: its gyro follows the temperature as in the other runs once the monitors are moved by {abs(delay_s):.3g} s: they "
        f"were logged {late}. Correct their clock, as with rlgcomp merge --offset-s, or leave the run out."
    )


def no_temperatures(*, values: int, least: float, greatest: float, column: str, source: str) -> str:
    text = f"{values} values between {least:.6g} and {greatest:.6g} degC are no temperatures of a gyro"
    unit = resistance_unit(source)
    if unit is not None:
        return f"{text}, and by its name {source!r} is a resistance in {unit}: {of_resistance(source, unit)}"
    return f"{text}: state the unit, or the step of the converter, with --map {column}='{source} [0.01 degC]'"


def outside_platinum(*, column: str, unit: str, least: float, greatest: float) -> str:
    return (
        f"the numbers of {column!r}, {least:.6g} to {greatest:.6g}, are all outside the range of a thermometer read as {unit}, "
        f"-200 to 850 degC by IEC 60751: it is another, or in another unit; {of_thermistor(column)}"
    )


def resistance_stated_otherwise(*, source: str, ohm: str, unit: str) -> str:
    text = f"its name {source!r} is that of a resistance in {ohm}, and it is read in {unit} as stated; if it is one"
    return f"{text}, {of_resistance(source, ohm)}"


def uneven_steps(*, share: float, period_s: float) -> str:
    return f"{100 * share:.0f} % of the steps differ from the period of {period_s:.6g} s by more than a quarter"


def missing_values(*, held: int, left_out: int) -> str:
    parts = [f"{held} held at the last value" if held else "", f"rows of {left_out} left out" if left_out else ""]
    return f"{held + left_out} values missing: {', '.join(part for part in parts if part)}"


def mostly_missing(*, share: float) -> str:
    return f"values are missing in {100 * share:.0f} % of the rows; mend the file, or --drop the columns above"


def noise_below_any_gyro(*, column: str, noise_deg_sqrt_h: float, unit: str, likely_units: Sequence[str], source: str) -> str:
    maps = " or ".join(_map(column, source, other) for other in likely_units)
    return (
        f"its white noise would be {noise_deg_sqrt_h:.1e} deg/√h, less than any gyro's, so the unit is hardly {unit}; "
        f"state the unit: {maps}; if {unit} is right, state that: {_map(column, source, unit)}"
    )


def noise_of_a_large_ring(*, column: str, noise_deg_sqrt_h: float, unit: str, likely_units: Sequence[str], source: str) -> str:
    maps = " or ".join(_map(column, source, other) for other in likely_units)
    return (
        f"its white noise is {noise_deg_sqrt_h:.1e} deg/√h, as of a ring laser with sides of metres; for any other gyro the unit "
        f"is hardly {unit}: then state it, {maps}"
    )


def unit_contradicts_table(*, column: str, slope: float, unit: str, likely_unit: str, source: str) -> str:
    return (
        f"its slope against the table's rate is {slope:.4g}, as if the gyro were in {likely_unit}: then state "
        f"{_map(column, source, likely_unit)}; otherwise table_rate_deg_s may be in another unit; if {unit} is right, state that: "
        f"{_map(column, source, unit)}"
    )


def _map(column: str, source: str, unit: str) -> str:
    return f"--map {column}='{source} [{unit}]'"


def stuck_gyro(*, value: float, samples: int, saturated: bool) -> str:
    return f"{'saturated' if saturated else 'stuck'} at {value:.6g} for {samples} samples in all, rows left out"


def stuck_monitor(*, column: str, segments: Sequence[Mapping[str, float]], run: str | None = None) -> str:
    places = ", ".join(f"at {one['value']:.6g} from {one['start_s']:.6g} to {one['end_s']:.6g} s" for one in segments)
    if run is not None:
        return f"{run}: {column} is stuck {places}: windows there are left out; --drop {column} keeps them."
    return (
        f"stuck {places}, though its other values change from sample to sample: leave these times out with RUN@START:STOP, or the "
        f"column with --drop {column}"
    )


def sample_and_hold(*, columns: Sequence[str], interval_s: float, run: str | None = None) -> str:
    subject = f"{columns[0]} is" if len(columns) == 1 else f"{len(columns)} monitors, {columns[0]} the first, are"
    text = f"{subject} read every {interval_s:.3g} s and held in between"
    return f"{text}; a diagnosis interpolates the readings" if run is None else f"{run}: {text}; the readings are interpolated."


_TREATMENTS: Final = {
    "left_out": "left out",
    "replaced": "replaced by what the table and the neighbours show",
    "interpolated": "interpolated between the neighbours",
    "as_recorded": "left as recorded",
    "in_curve": "they are in the curve: take a part without them, as RUN@START:STOP, or leave these cells empty",
    "followed": "a compensation that runs sample by sample follows them",
}


def time_in_days(*, first: float, period_s: float, source: str, counts: Sequence[str]) -> str:
    return (
        f"begins at {first:.10g} with a step of {period_s:.3g}, too short for seconds: that looks like days; map it "
        f"with --map time_s='{source} [{counts[0]}]'{''.join(f' or [{other}]' for other in counts[1:])} to know the dates, with "
        "[d] for days without dates, or with [s] if it is in seconds"
    )


def gyro_outliers(*, column: str, samples: int, first_s: float, largest_sd: float, treatment: str, run: str | None) -> str:
    text = f"{_deviating(samples, largest_sd, first_s)}: shocks or faults of the logger"
    return _treated(text, column, treatment, run, "training, evaluation and diagnosis leave them out")


def count_errors(*, column: str, samples: int, first_s: float, largest_sd: float, treatment: str, run: str | None) -> str:
    text = f"{_deviating(samples, largest_sd, first_s)}, as at no other passage of the table: count errors or faults of the logger"
    return _treated(text, column, treatment, run, "evaluation and diagnosis replace them")


def monitor_outliers(*, column: str, samples: int, first_s: float, treatment: str, run: str | None) -> str:
    deviate = f"{samples} samples deviate" if samples > 1 else "1 sample deviates"
    text = f"{deviate} from both neighbours as no other does, the first at {first_s:.6g} s: faults of the logger"
    return _treated(text, column, treatment, run, "training and diagnosis interpolate them")


def _deviating(samples: int, largest_sd: float, first_s: float) -> str:
    deviate, whose = ("samples deviate", "their") if samples > 1 else ("sample deviates", "its")
    return (
        f"{samples} {deviate} by up to {largest_sd:.0f} standard deviations from {whose} neighbours, the first at {first_s:.6g} s"
    )


def _treated(text: str, column: str, treatment: str, run: str | None, elsewhere: str) -> str:
    text = f"{text}; {elsewhere if treatment == 'inspected' else _TREATMENTS[treatment]}"
    return text if run is None else f"{run}, {column}: {text}."


def merged_clock(other: str, column: str, offset_s: float, drift_ppm: float, offset_sd_s: float, drift_sd_ppm: float | None) -> str:
    value, sd = value_and_sd(offset_s, offset_sd_s)
    text = f"by {column} {value} ± {sd} s are to be added to the time of {other}"
    if drift_sd_ppm is None:
        return f"{text}; its drift of {drift_ppm:.4g} ppm was stated"
    value, sd = value_and_sd(drift_ppm, drift_sd_ppm)
    return f"{text}, whose clock is slow by {value} ± {sd} ppm"


def merged_interpolated(columns: list[str], other: str, period_s: float) -> str:
    return f"{', '.join(columns)} of {other}, read every {period_s:.6g} s, interpolated: they are slow for their logger"


def merged_averaged(columns: list[str], other: str, period_s: float, window_s: float) -> str:
    return f"{', '.join(columns)} of {other}, read every {period_s:.6g} s, are means over {window_s:.6g} s about each row"


def joined(*, files: Sequence[str], rows: Sequence[int], pause_s: float | None) -> str:
    each = ", ".join(f"{name} ({count} rows)" for name, count in zip(files, rows, strict=True))
    pause = "" if pause_s is None else f"; the longest step from one to the next is {pause_s:.6g} s"
    return f"one recording of {len(files)} files: {each}{pause}"


def other_response(*, run: str, slope: float, other: str | None = None, trained: bool = False) -> str:
    unit = "-deg/h" if slope < 0.0 else "UNIT"
    if other is not None:
        return (
            f"{run} and {other}: the gyro of one follows the temperature {slope:.3g} times as that of the other: one of the two "
            f"has another sign or unit. {_stated_alone(unit)}"
        )
    others = "the training runs" if trained else "the other runs"
    return (
        f"{run}: its gyro follows the temperature {slope:.3g} times as in {others}: it has another sign or unit. "
        f"{_stated_alone(unit)}"
    )


def other_sign(*, run: str, mean_deg_h: float, others_deg_h: float, other: str | None = None, trained: bool = False) -> str:
    if other is not None:
        return (
            f"The gyro of {run} has a mean of {mean_deg_h:.4g} deg/h, that of {other} {others_deg_h:.4g} deg/h: the sign of one of "
            f"the two is reversed. {_stated_alone('-deg/h')}"
        )
    others = "the training runs" if trained else "the other runs"
    return (
        f"{run}: its gyro has a mean of {mean_deg_h:.4g} deg/h, {others} {others_deg_h:.4g} deg/h: its sign is reversed. "
        f"{_stated_alone('-deg/h')}"
    )


def _stated_alone(unit: str) -> str:
    return (
        "State it for that recording alone, in a file beside it of its name that ends in .yaml and instead of --map, as "
        f"columns: {{gyro_deg_h: 'COLUMN [{unit}]'}} with the file's own name of the column, or leave the run out."
    )


TEXTS: Final = {
    "unit_stated_otherwise": (
        "its name {source!r} says {named}, and it is read in {unit} as stated; if the name is right, write '{source} [{named}]'"
    ),
    # time
    "rows_without_time": "{rows} rows without a time left out",
    "time_too_coarse": (
        "{repeated} of {rows} time stamps repeat the one before: the time was written with too few digits; write more, or "
        "leave it out and give the sample period with --period-s; where rows are of several kinds, write a file of each"
    ),
    "repeated_rows": "{rows} rows repeat the row before in every column, left out",
    "newest_first": "the rows run from the last to the first: turned round",
    "time_in_steps": (
        "the stamps come in steps of {step_s:.6g} s: the time was written with too few digits for samples every {period_s:.6g} s, "
        "which is their mean step; if samples are missing instead, give the time with more digits"
    ),
    "time_runs_backwards": (
        "time runs backwards: {before_s:.9g} s is followed by {after_s:.9g} s, and {rows} rows are out of order; if a second run "
        "begins there, split the file in two; otherwise sort it"
    ),
    "time_since_1970": ("begins at {first:.4g}: that looks like {unit} since 1970; map it with --map time_s='{source} [{unit}]'"),
    "roll_over": "the clock begins again {times} times, after {clock} ({range_s:.10g} s): undone, it now runs on",
    "lost_by_counter": (
        "{source!r} counts the samples and shows that {lost} of {of} are lost: the time is its count times the sample period"
    ),
    "clock_put_forward": "from {before} to {after} the clock was put forward by an hour: undone",
    "repeated_stamps_spread": (
        "{stamps} time stamps repeat beside a step that has room for them: put back on the clock of {period_s:.6g} s"
    ),
    "unusual_period": (
        "a sample every {period_s:.3g} s, {hours:.3g} h in all: if the time is not in seconds, state its unit with "
        "--map time_s='NAME [unit]'"
    ),
    "gaps": "{gaps} gaps, the longest {longest_s:.6g} s; averages leave out windows less than 80 % full",
    "bursts": (
        "{bursts} bursts of {length_s:.4g} s with pauses between them: each is a window, in place of windows of {window_s:.4g} s"
    ),
    "dates": "read as dates, the first {written}, and counted in seconds from {first}",
    "clock_times": "clock times such as {written!r} counted in seconds from midnight",
    "ambiguous_dates": (
        "dates such as {first!r} may begin with the day or with the month; state which: --map time_s='NAME [dd/mm/yyyy]' or "
        "--map time_s='NAME [mm/dd/yyyy]'"
    ),
    "not_times": (
        "{entries} entries are neither numbers nor dates, the first {first!r}; give seconds, or dates as 2026-03-01 12:00:00 or "
        "01.03.2026 12:00:00"
    ),
    "cut_line": "the last line ends within a number, {last!r}, and without a line break: left out",
    "decimal_comma": "numbers are written with a decimal comma",
    "thousands": "signs between thousands, as in {written!r}, are no decimal signs",
    "hexadecimal": "numbers such as {written!r} are read as hexadecimal whole numbers without a sign",
    "perhaps_thousands": (
        "numbers such as {grouped!r} stand beside whole ones such as {whole!r}, and are read with a decimal sign; if it stands "
        "between thousands, write them without it"
    ),
    "repeated_header": "{rows} rows repeat the names or units of the columns, left out",
    "segments": ("{segments} segments begin again at their first time: placed by the dates of their headers, from {first} on"),
    "empty_time": "every value is missing (NaN); mend the file",
    # columns and entries
    "other_time_base": ("{columns} have {rows} rows on a time base of their own: interpolated at the {of} times of the others"),
    "too_few_rows": "{rows} rows: too short to average; at least {least} rows are needed",
    "few_usable_rows": "only {rows} usable rows are left; at least {least} are needed to average",
    "not_numbers": "{entries} entries are no numbers, the first {first!r}",
    "too_many_words": (
        "{entries} of {of} entries are no numbers, the first {first!r}; {allowed} are allowed, whose rows are left out: a gyro "
        "beyond its range has wrong means; record with a wider range, or give the rows without them, or leave these cells empty "
        "where there was no reading"
    ),
    "text_column": "{entries} of {of} entries are no numbers, the first {first!r}: left out",
    "no_numbers": "none of its {of} entries is a number, the first {first!r}: map a column of numbers, or write them as numbers",
    "words_at_the_end": "{rows} rows at the end begin with words, the first {first!r}: left out",
    "packed": "read as {factor:.9g} times its numbers plus {offset:.9g}, as its attributes scale_factor and add_offset say",
    "scale_beside": (
        "has the attribute {stated}, which is not applied; if its numbers are to be multiplied, state that in the map, as in "
        "'{source} [0.1 UNIT]'"
    ),
    "absurd_values": "{values} values are infinite or beyond {largest:.0e}: they count as missing",
    "empty_gyro": "every value is missing (NaN); leave the column out with --drop {column}, or mend the file",
    "empty_monitor": "every value is missing (NaN), left out",
    "dark_readouts": "its sum with {other} is 0 in {rows} rows: both count as missing",
    "missing_gyro_values": "{values} values missing, rows left out",
    "blanks_between_readings": (
        "is read every {interval_s:.6g} s and blank in between: the readings are held, and {left_out} rows without one are left out"
    ),
    # units
    "unit_of_name": (
        "read in {unit}, which its name {source!r} states; if it is in another, state that, as in '{source} [{wanted}]'"
    ),
    "unit_not_understood": (
        "its name {source!r} ends in {unit!r}, which may be a unit: taken as {wanted}; state which it is, as in "
        "'{source} [{wanted}]'"
    ),
    "unit_not_stated": "{source!r} states no unit that is known: taken as {wanted}; if it is in another, write '{source} [UNIT]'",
    "kelvin": "the median is {median:.1f}: that looks like kelvin; map it with --map {column}='{source} [K]'",
    "near_absolute_zero": (
        "the median is {median:.1f} degC, near absolute zero: that looks like degC taken for kelvin; map it with "
        "--map {column}='{source} [degC]', or where the column itself is 273.15 K too low with '{source} [degC] + 273.15'"
    ),
    "mean_above_earth_rate": "the mean is {mean_deg_h:.4g} deg/h: more than Earth rate; if the unit is wrong, state it with --map",
    "error_values": "{values} values are {written}, which loggers write for no reading: they count as missing",
    "counter_overflow": (
        "jumps {jumps} times by {modulus:.6g}, as a counter of few bits read without its sign: undone, the values now run on"
    ),
    "offset_binary": (
        "lies about {counts:.0f} counts, a power of two: a converter has its zero there where it counts in offset binary; if so, "
        "subtract so many steps, as of 0.5 deg/h in '{source} [0.5 deg/h] - {zero:.10g}'"
    ),
    "impossible_temperatures": (
        "{values} values between {least:.6g} and {greatest:.6g} degC are no temperatures of a gyro: they count as missing"
    ),
    "repeated_values": "every value is written {times} times: one row of each remains, every {period_s:.6g} s",
    # channels
    "dead_channel": "never changes from {value:.6g}: the channel is dead; choose another with --map or --drop",
    "saturated_gyro": (
        "has the value {value:.6g}, the end of its range, in {samples} of {rows} samples: it is saturated, and its means are wrong "
        "by what is cut off; record with a wider range, or --drop it"
    ),
    "running_sum": (
        "holds a running sum of pulses, from {least:.6g} to {greatest:.6g}: a row needs the pulses since the row before; write the "
        "differences of its rows instead, and undo overflows of the counter"
    ),
    "stuck_thermometer": "stuck for {duration_s:.0f} s while another thermometer moved, rows left out",
    "encoder_wraps": "{wraps} wraps of the encoder undone, the angle now runs on",
    "coarse_gyro": (
        "its steps of {step:.3g} {unit} are larger than its noise: {percent:.0f} % of the stretches of 50 samples hold two values "
        "at most, so that means are those of the rounding, not of the gyro. Record it with more digits, or as counts of its pulses"
    ),
    "constant_columns": "{count} columns are constant and can explain no change of the gyro: {columns}",
    "constant_column": "constant at {value:.6g}: it can explain no change of the gyro",
    # merging two loggers
    "merged_stated_clock": (
        "{offset_s:.6g} s are added to the time of {other}, whose clock is taken to be slow by {drift_ppm:.4g} ppm, as stated"
    ),
    "merged_dates": (
        "by the dates of both files {other} begins {offset_s:.6g} s after {name}; the two share no channel that would show whether "
        "their clocks agree"
    ),
    "merged_twice": "both files have it; that of {name} stays",
    "merged_uncovered": "{rows} rows are left out, which {other} does not cover",
    # outliers
    # runs compared with each other
    "shared_noise": (
        "{run} has the noise of {other} (correlation {correlation:.2f}), which no two recordings share: it is a copy, in whole or "
        "in part, whatever its clock, offset or sample period. Runs left out then prove nothing; give each recording once."
    ),
    "other_noise": (
        "{run}, {column}: its noise from sample to sample is {ratio:.3g} times that of the other runs, as of another unit, another "
        "sensor or filtered data. State the unit with --map, or leave the run or the column out."
    ),
    "other_spectrum": (
        "{run}, {column}: its noise has another spectrum than in the other runs, as of data that were interpolated, smoothed or "
        "held. Use the data as recorded, or leave the run out."
    ),
    "other_digit": (
        "{run}, {column}: its last digit is {ratio:.4g} times that of the other runs, as of another unit. State the unit with "
        "--map, or leave the run or the column out."
    ),
    "held_samples": (
        "{run}, {column}: {samples} samples repeat the one before, which no other run does: lost samples were held. Leave these "
        "rows out."
    ),
    "frequent_value": (
        "{run}, {column}: {samples} samples are {value:.6g} exactly, which no other run repeats: a value that stands for lost "
        "samples. Leave these rows out."
    ),
    "equal_columns": (
        "{run}: {column} and {other} are equal in each row, in the other runs they are not: one was written twice. Leave one out "
        "with --drop."
    ),
    "coarse_digit": (
        "{run}, {column}: its last digit is {digit:.3g}, more than the noise of {noise:.3g} in the other runs, which have finer "
        "digits. Write it with all digits, or leave the run or the column out."
    ),
    "exchanged_thermometers": (
        "{run}: {column} and {other} follow each other in the other order than in the other runs: their names are exchanged. Map "
        "them with --map, or leave the run out."
    ),
    "other_level": (
        "{run}, {column}: its median is {level:.4g}, in the other runs {others:.4g}, as of another unit or another sensor. State "
        "the unit with --map, or leave the run or the column out."
    ),
    "other_slope": (
        "{run}, {column}: it changes {ratio:.3g} times as much for each kelvin of {other} as in the other runs, as in another "
        "unit. State the unit with --map, or leave the run or the column out."
    ),
    "other_clock": (
        "{run} has a sample period of {period_s:.4g} s, the other runs {others_s:.4g} s, and the gyro's noise is the same: its "
        "time "
        "is in another unit, or it was thinned out without averaging. Map the time with its unit, as --map time_s='time_s [ms]'."
    ),
    "other_period": (
        "{run} has a sample period of {period_s:.6g} s, the other runs {others_s:.6g} s, a difference that loggers are seldom set "
        "to: one of the clocks runs fast or slow. Lags and rates of change are wrong by as much."
    ),
    "changing_noise": (
        "{run}, {column}: the noise of its second half is {ratio:.3g} times that of its first, in the other runs {others:.3g} "
        "times: something disturbed one of the halves. Leave that half out, as RUN@START:STOP."
    ),
    "other_course": (
        "{run}, {column}: it departs by {departure_K:.3g} K rms from the course that {other} foretells by the other runs, as a "
        "thermometer that lost its sign, or another run's. Leave the column or the run out."
    ),
}
