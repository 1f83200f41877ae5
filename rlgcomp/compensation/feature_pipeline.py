"""The feature pipeline: an ordered list of features, run on all samples or one by one, and the choice for a set of runs."""

from __future__ import annotations

import dataclasses
import difflib
import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Final, Self

import numpy as np
import numpy.typing as npt
import pandas as pd

from rlgcomp.compensation.features import FEATURES, Difference, Feature, Lag, Level, Memory, Rate, ReadoutDifference, State
from rlgcomp.compensation.physics_terms import PhysicsTerm
from rlgcomp.errors import InputError
from rlgcomp.recording import ENCODERS, TIME, Recording, is_compensation, is_gyro
from rlgcomp.recording.columns import NEARLY
from rlgcomp.report.messages import Message, message
from rlgcomp.report.messages.column_names import is_like_a_gyro
from rlgcomp.units import is_thermometer

Array = npt.NDArray[np.float64]


@dataclasses.dataclass(frozen=True)
class FeatureRecipe:
    """An ordered list of features: the definition of a model's inputs.

    Parameters
    ----------
    features : tuple of Feature

    Raises
    ------
    InputError
        The list is empty, or two features make the same number.
    """

    features: tuple[Feature, ...]

    def __post_init__(self) -> None:
        if not self.features:
            raise InputError("a feature pipeline needs at least one feature")
        twice = sorted({name for name in self.names if self.names.count(name) > 1})
        if twice:
            raise InputError(f"the features make {', '.join(twice)} twice; name each feature once")

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the model's inputs, in order."""
        return tuple(name for feature in self.features for name in feature.names)

    @property
    def columns(self) -> tuple[str, ...]:
        """Monitor columns needed, each once."""
        return tuple(dict.fromkeys(column for feature in self.features for column in feature.columns))

    @property
    def dynamic(self) -> tuple[int, ...]:
        """Places of the inputs that depend on the history of temperature: gradient, rate, lag and memory."""
        owners = [feature.group for feature in self.features for _ in feature.names]
        return tuple(place for place, group in enumerate(owners) if group in DYNAMIC)

    @property
    def physics(self) -> tuple[int, ...]:
        """Places of the inputs that are known physics, which a model takes linearly."""
        owners = [feature.kind for feature in self.features for _ in feature.names]
        return tuple(place for place, kind in enumerate(owners) if kind == PhysicsTerm.kind)

    def transform(self, recording: Recording) -> pd.DataFrame:
        """All features of a recording, from a fresh state: one row a sample.

        Raises
        ------
        InputError
            A monitor is not in the recording, or a feature is undefined for its samples.
        """
        missing = [column for column in self.columns if column not in recording]
        if missing:
            raise InputError(
                f"{recording.name} has no {', '.join(missing)}, which the features need; "
                f"map the column with --map, or train with other --features"
            )
        samples = recording.table[list(self.columns)].to_numpy()
        values, _ = self.run(None, recording.time_s, samples)
        return pd.DataFrame(values, columns=list(self.names))

    def step(self, state: State, sample: Mapping[str, float]) -> tuple[Array, State]:
        """Features of one sample.

        Parameters
        ----------
        state : object
            None before the first sample; then what the last call returned.
        sample : mapping of str to float
            `time_s` and the monitor columns.

        Returns
        -------
        values : ndarray, shape (features,)
        state : object

        Raises
        ------
        InputError
            A value is missing, or it or a feature is not finite, or time does not increase.
        """
        wanted = (TIME, *self.columns)
        bad = [name for name in wanted if not _finite(sample.get(name))]
        if bad:
            raise InputError(f"sample: {', '.join(bad)} missing or not finite; needed are {', '.join(wanted)}, each a number")
        if state is not None and not sample[TIME] > state[0]:
            raise InputError(f"sample: time_s is {sample[TIME]}, not after {state[0]}; restart() begins a new recording")
        row = np.array([[sample[column] for column in self.columns]], dtype=np.float64)
        values, state = self.run(state, np.array([sample[TIME]], dtype=np.float64), row)
        return values[0], state

    def run(self, state: State, time_s: Array, samples: Array) -> tuple[Array, State]:
        """Features of consecutive samples, the same to the last bit however a recording is cut into pieces.

        Parameters
        ----------
        state : object
            None before the first sample; then what the last call returned.
        time_s : ndarray, shape (n,)
        samples : ndarray, shape (n, columns)
            Monitors, in the order of `columns`.

        Returns
        -------
        values : ndarray, shape (n, features)
        state : object

        Raises
        ------
        InputError
            A feature comes out not finite: of readouts whose sum is zero, or of numbers too large.
        """
        places = [[self.columns.index(column) for column in feature.columns] for feature in self.features]
        if state is None:
            state = (time_s[0], [feature.init(samples[0, place]) for feature, place in zip(self.features, places, strict=True)])
        last, states = state
        step_s = np.diff(np.r_[last, time_s])
        with np.errstate(all="ignore"):
            done = [
                feature.run(old, np.ascontiguousarray(samples[:, place]), step_s)
                for feature, old, place in zip(self.features, states, places, strict=True)
            ]
        values = np.column_stack([part for part, _ in done])
        self._require_finite(values, time_s, samples)
        return values, (time_s[-1], [new for _, new in done])

    def _require_finite(self, values: Array, time_s: Array, samples: Array) -> None:
        bad = ~np.isfinite(values)
        if not bad.any():
            return
        row = int(np.flatnonzero(bad.any(axis=1))[0])
        names = ", ".join(name for name, wrong in zip(self.names, bad[row], strict=True) if wrong)
        received = ", ".join(f"{column} = {value:g}" for column, value in zip(self.columns, samples[row].tolist(), strict=True))
        raise InputError(f"at {time_s[row]:g} s {names} is undefined for {received}; leave that sample out")

    def to_list(self) -> list[dict[str, Any]]:
        """Plain description, for the artefact."""
        return [{"kind": feature.kind, **dataclasses.asdict(feature)} for feature in self.features]  # type: ignore[call-overload]

    @classmethod
    def from_list(cls, items: Sequence[Mapping[str, Any]]) -> Self:
        """Pipeline from its plain description.

        Raises
        ------
        InputError
            A kind or a field is unknown.
        """
        features = []
        for item in items:
            feature_class = FEATURES.get(str(item.get("kind")))
            if feature_class is None:
                raise InputError(f"feature pipeline: unknown kind {item.get('kind')!r}; known are {', '.join(FEATURES)}")
            values = {key: tuple(value) if isinstance(value, list) else value for key, value in item.items() if key != "kind"}
            try:
                feature = feature_class(**values)
            except TypeError as error:
                raise InputError(f"feature pipeline: {item.get('kind')}: {error}") from None
            _require_usable(feature)
            features.append(feature)
        return cls(tuple(features))


def _require_usable(feature: Any) -> None:
    """Refuse values from a file that no pipeline made here has."""
    if isinstance(feature, PhysicsTerm):
        feature.require_usable()
        return
    for field in dataclasses.fields(feature):
        value = getattr(feature, field.name)
        if isinstance(field.default, str):
            good = isinstance(value, str) and value.isprintable() and 0 < len(value) <= _LONGEST_NAME
        elif isinstance(field.default, tuple):
            good = isinstance(value, tuple) and 0 < len(value) <= _MOST_NUMBERS and all(_positive(part) for part in value)
        else:
            good = _positive(value) or value == field.default
        if not good:
            raise InputError(f"feature pipeline: {feature.kind}: {field.name} is {str(value)[:60]!r}, which is not allowed")


def _finite(value: Any) -> bool:
    try:
        return math.isfinite(value)
    except (TypeError, ValueError, OverflowError):  # None, a text, several numbers, or an int beyond all floats
        return False


def _positive(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and 0.0 < value < math.inf


GROUPS: Final = ("temperature", "gradient", "temperature_rate", "lag", "memory", "light_intensity", "readout_difference")
DYNAMIC: Final = ("gradient", "temperature_rate", "lag", "memory")
_LAGS_S: Final = (300.0, 900.0, 2700.0)
_RADII_OF_SPAN: Final = (0.05, 0.1, 0.2)
_LAGS_IN_A_RUN: Final = 3.0
_MONITORS: Final = (
    "temperature_block_degC",
    "temperature_shell_degC",
    "light_intensity_V",
    "readout_a_V",
    "readout_b_V",
    "magnetic_field_uT",
    "pressure_hPa",
    "supply_voltage_V",
    "discharge_current_a_mA",
    "discharge_current_b_mA",
)
TABLE: Final = (*ENCODERS, "table_rate_deg_s")
_COPIED: Final = 0.8  # square of the correlation of steps from sample to sample, from which on a column is made of the gyro,
_THE_SAME: Final = 1.0 - 1e-6  # and is the gyro
_LONGEST_NAME: Final = 200
_MOST_NUMBERS: Final = 64


def pipeline_for(runs: Sequence[Recording], wanted: str | Sequence[str] = "all") -> FeatureRecipe:
    """Feature pipeline for these runs.

    Parameters
    ----------
    runs : sequence of Recording
        The training runs. Only monitors that all of them have are used. Radii of the memory are 5, 10 and 20 % of their span of
        temperature; time constants of the lag are 300, 900 and 2700 s, less those that a third of the shortest run cannot show.
    wanted : str or sequence of str
        "all": every group in `GROUPS` whose monitors were recorded. Otherwise groups, or names of further columns. See also
        :func:`further_monitors`.

    Raises
    ------
    InputError
        A name is neither a group nor a column, or its monitors were not recorded.
    """
    names = feature_names(wanted)
    common = set.intersection(*(set(run.columns) for run in runs))
    features: list[Feature] = []
    for name in names:
        if name == "all":
            features += [feature for group in GROUPS for feature in _group(group, runs) if set(feature.columns) <= common]
        elif name in GROUPS:
            features += _group(name, runs)
        elif name in common and name != TIME:
            features.append(Level(name))
        else:
            raise InputError(
                f"--features {name!r} is neither a group ({', '.join(('all', *GROUPS))}) nor a column of every run "
                f"({', '.join(sorted(common - {TIME}))})"
            )
    if not features:
        monitors = [
            one for one in dict.fromkeys(one for run in runs for one in run.columns) if _is_monitor(one) and one not in TABLE
        ]
        shared = [column for column in monitors if column in common]
        lacking = [column for column in monitors if column not in common]
        raise InputError(str(message("compensation.no_monitor", columns=sorted(common), monitors=shared, lacking=lacking)))
    for feature in features:
        missing = sorted(set(feature.columns) - common)
        if missing:
            raise InputError(f"feature {feature.kind} needs {', '.join(missing)}, which not every run has")
    return FeatureRecipe(tuple(dict.fromkeys(features)))


def further_monitors(
    runs: Sequence[Recording], wanted: str | Sequence[str], pipeline: FeatureRecipe, gyro: str | None = None
) -> tuple[list[str], list[Message]]:
    """Monitors that "all" has no group for: recorded in every run, neither a gyro nor an angle, finite, and not constant.

    A column that is a gyro by its name, or moves from sample to sample as the gyro does, would take the rotation away: it is left
    out, with a remark.

    Parameters
    ----------
    runs : sequence of Recording
    wanted : str or sequence of str
        As for :func:`pipeline_for`; none unless it names "all".
    pipeline : FeatureRecipe
        With the groups.
    gyro : str, optional
        Gyro column, where there are several.
    """
    names = feature_names(wanted)
    if "all" not in names:
        return [], []
    known = {TIME, *ENCODERS, "readout_a_V", "readout_b_V", *pipeline.columns}
    common = [column for column in runs[0].columns if all(column in run for run in runs) and column not in known]
    monitors = [column for column in common if _is_monitor(column)]
    values = {column: np.concatenate([run.column(column) for run in runs]) for column in monitors}
    varying = [column for column, samples in values.items() if np.isfinite(samples).all() and np.ptp(samples) > 0.0]
    own = [column for column in varying if column not in TABLE]
    of_gyros = {*filter(is_like_a_gyro, own), *_made_of_gyro(runs, own, gyro, _COPIED)}
    refused = [column for column in own if column in of_gyros and column not in names]
    remarks = [message("compensation.gyro_is_no_input", column=column) for column in refused]
    return [column for column in varying if column not in of_gyros], remarks


def require_no_gyro(runs: Sequence[Recording], wanted: str | Sequence[str], gyro: str | None) -> None:
    """Raise `InputError` where an input that is asked for is the gyro itself, in another unit or with another sign."""
    named = [column for column in feature_names(wanted) if all(column in run for run in runs)]
    for column in _made_of_gyro(runs, named, gyro, _THE_SAME):
        raise InputError(f"--features names {column}, which is the gyro itself in another unit; an input is what else was recorded")


def _made_of_gyro(runs: Sequence[Recording], columns: Sequence[str], gyro: str | None, least: float) -> list[str]:
    """Columns that move from sample to sample as the gyro does, whose noise no monitor knows.

    Parameters
    ----------
    runs : sequence of Recording
    columns : sequence of str
    gyro : str, optional
    least : float
        Square of the correlation of the steps.
    """
    of_gyro, found = _steps(run.rate_deg_h(gyro) for run in runs), []
    for column in columns:
        own = _steps(run.column(column) for run in runs)
        if (own @ of_gyro) ** 2 > least * (own @ own) * (of_gyro @ of_gyro):
            found.append(column)
    return found


def _steps(values: Iterable[Array]) -> Array:
    """From sample to sample, of one run after the other."""
    return np.concatenate([np.diff(of_run) for of_run in values])


def nearly_standard(runs: Sequence[Recording], wanted: str | Sequence[str] = "all") -> list[Message]:
    """Remarks on columns whose name is nearly that of a standard monitor which the runs lack; a column that is asked for is meant.

    Parameters
    ----------
    runs : sequence of Recording
    wanted : str or sequence of str
        As for :func:`pipeline_for`.
    """
    columns = dict.fromkeys(column for run in runs for column in run.columns)
    lacking = {name.lower(): name for name in (*_MONITORS, *TABLE) if name not in columns}
    remarks = []
    for column in columns:
        standard = column in (*_MONITORS, *TABLE) or is_thermometer(column)
        if standard or not _is_monitor(column) or column in feature_names(wanted):
            continue
        if close := difflib.get_close_matches(column.lower(), lacking, n=1, cutoff=NEARLY):
            remarks.append(message("compensation.nearly_standard", column=column, nearest=lacking[close[0]]))
    return remarks


def _is_monitor(column: str) -> bool:
    """Whether a column may be learnt from: it is neither time nor gyro, no acceleration, and not written by a compensation."""
    return not (column == TIME or is_gyro(column) or is_compensation(column) or column.startswith("accel_"))


def omitted_groups(runs: Sequence[Recording], wanted: str | Sequence[str] = "all") -> list[Message]:
    """Remarks on groups that "all" omits because some of the runs, not all of them, lack a monitor."""
    remarks = []
    for group in GROUPS if "all" in feature_names(wanted) else ():
        for feature in _group(group, runs):
            lacking = {run.name: [column for column in feature.columns if column not in run] for run in runs}
            missing = {run: columns for run, columns in lacking.items() if columns}
            if 0 < len(missing) < len(lacking):
                remarks.append(message("compensation.group_omitted", group=group, missing=missing))
    return remarks


def feature_names(wanted: str | Sequence[str]) -> list[str]:
    """Groups and columns that are asked for, one by one."""
    if isinstance(wanted, str):
        return [name.strip() for name in wanted.split(",")]
    if not (isinstance(wanted, Iterable) and all(isinstance(name, str) for name in wanted)):
        raise InputError(f"features is {wanted!r:.60}; give 'all', names with commas between them, or a list of names")
    return list(wanted)


def _group(name: str, runs: Sequence[Recording]) -> list[Feature]:
    if name == "light_intensity":
        return [Level("light_intensity_V")]
    if name == "readout_difference":
        return [ReadoutDifference()]
    if name == "gradient":
        return [Difference("temperature_block_degC", "temperature_shell_degC")]
    column = next((run.temperature_column for run in runs if _has_thermometer(run)), None)
    if column is None:
        return []
    if name == "temperature":
        return [Level(column)]
    if name == "temperature_rate":
        return [Rate(column)]
    if name == "lag":
        longest_s = min(run.duration_s for run in runs) / _LAGS_IN_A_RUN
        return [Lag(column, tuple(tau for tau in _LAGS_S if tau <= longest_s) or (float(f"{longest_s:.2g}"),))]
    span_K = float(np.ptp(np.concatenate([run.column(column) for run in runs if column in run])))
    return [Memory(column, tuple(float(f"{share * span_K:.2g}") for share in _RADII_OF_SPAN))] if span_K > 0.0 else []


def _has_thermometer(run: Recording) -> bool:
    return any(is_thermometer(column) for column in run.columns)
