"""Mechanisms of the user's, from a Python file, checked against the contract before use."""

from __future__ import annotations

import dataclasses
import inspect
import itertools
import re
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final, get_args

import numpy as np
import pandas as pd

from rlgcomp.errors import InputError
from rlgcomp.physics import CATALOGUE
from rlgcomp.physics.mechanism import FELT_RATE_DEG_S, TABLE_ANGLE, TABLE_RATE, TEMPERATURE, TURNING, Array, Mechanism, Role
from rlgcomp.physics.plugins import error_line, load_python
from rlgcomp.recording import TIME, Metadata, Recording
from rlgcomp.recording.motion import ANGLES, RATE

_NAME: Final = re.compile(r"[a-z][a-z0-9_]*")
_KINDS: Final = ("chamber", "turntable", "any")
_ROWS: Final = 64
_SCALES: Final = (1.0, -1.0, 10.0, 100.0, 1000.0)  # of the monitors' values: a threshold may be anywhere
_LARGEST: Final = 1e50  # of a column: its square and sums of it stay finite
_MEAN_S: Final = 20.0
_MEAN_ROWS: Final = (2, 10)  # of one mean, at least and at most
_NODES: Final = (8, 64)  # of the piecewise linear monitors of a smoothed run
_APART: Final = 5  # means between two nodes
_UNLIKE: Final = 0.1  # of a column's standard deviation
_IN_SECONDS: Final = (
    "diagnosis computes it from both: let its basis reckon in seconds (recording.time_s, recording.period_s), not in rows, or "
    "write fast = True in the class, and it is computed from rows alone"
)
_EXAMPLE: Final = "see 'Add a mechanism' in CONTRIBUTING.md, and rlgcomp/physics/thermal_lag.py for an example"


def user_catalogue(
    paths: Sequence[str | Path], catalogue: Mapping[str, type[Mechanism]] = CATALOGUE
) -> MappingProxyType[str, type[Mechanism]]:
    """A catalogue extended by the mechanisms of Python files.

    Parameters
    ----------
    paths : sequence of str or Path
        Files that define subclasses of :class:`rlgcomp.physics.mechanism.Mechanism`. Imported classes do not count.
    catalogue : mapping of str to type

    Raises
    ------
    InputError
        A file cannot be run or defines no mechanism, a name is taken, or a mechanism breaks the contract; all its faults are
        listed.
    """
    extended = dict(catalogue)
    for path in paths:
        module = load_python(path)
        defined = [
            member
            for member in vars(module).values()
            if inspect.isclass(member) and issubclass(member, Mechanism) and member.__module__ == module.__name__
        ]
        if not defined:
            raise InputError(f"{path} defines no mechanism: no class derived from rlgcomp.Mechanism; {_EXAMPLE}")
        for mechanism in defined:
            faults = _faults(mechanism)
            if faults:
                listed = "\n".join(f"  - {fault}" for fault in faults)
                raise InputError(f"{path}: {mechanism.__name__} is not a valid mechanism; {_EXAMPLE}:\n{listed}")
            if mechanism.name in extended:
                by = "the catalogue" if mechanism.name in catalogue else "another mechanism of these files"
                raise InputError(f"{path}: the name {mechanism.name!r} is taken by {by}; give {mechanism.__name__} another")
            extended[mechanism.name] = mechanism
    return MappingProxyType(extended)


def require_computable(mechanisms: Mapping[str, type[Mechanism]], runs: Sequence[Recording]) -> None:
    """Refuse a mechanism of the user's that fails on the runs, with its usual shapes or with one of them at a bound.

    Mechanisms of the catalogue are not checked, nor are those whose columns a run lacks.

    Raises
    ------
    InputError
        A basis raises, is not one finite real number for each row and amplitude, or differs between samples and means over windows.
    """
    for mechanism in mechanisms.values():
        if CATALOGUE.get(mechanism.name) is mechanism:
            continue
        usual = mechanism()
        forms = _forms(usual)
        for run in (run for run in runs if _readable(usual, run)):
            for phrase, form in forms.items():
                fault = _fault_on(form, run)
                if fault is not None:
                    raise InputError(f"{mechanism.name} cannot be tried{phrase}: {fault}; correct the mechanism, or its bounds")
            fault = None if usual.fast else _fault_on_means(usual, run)
            if fault is not None:
                raise InputError(f"{mechanism.name} cannot be tried: {fault}")


def _fault_on_means(mechanism: Mechanism, run: Recording) -> str | None:
    """The fault where columns of means over rows are not the means of columns; None on a run too short to show it.

    Monitors are smoothed first, so that a nonlinear mechanism does not fail by their noise.
    """
    rows = min(max(round(_MEAN_S / run.period_s), _MEAN_ROWS[0]), _MEAN_ROWS[1])
    nodes = min(len(run) // (_APART * rows), _NODES[1])
    if nodes < _NODES[0]:
        return None
    smooth = _smooth(run, nodes)
    if _fault_on(mechanism, smooth) is not None:
        return None
    with np.errstate(all="ignore"):
        columns = pd.DataFrame(np.asarray(mechanism.basis(smooth), dtype=np.float64)).add_prefix("basis_")
        means = smooth.averaged(rows * run.period_s, extra=columns)
        if _fault_on(mechanism, means) is not None:
            return f"of means over {rows} rows, {_fault_on(mechanism, means)}; {_IN_SECONDS}"
        averaged = np.column_stack([np.empty((len(means), 0)), *(means.column(str(name)) for name in columns)])
        unlike = np.std(mechanism.basis(means) - averaged, axis=0)
    size = np.std(averaged, axis=0)
    if not (unlike > _UNLIKE * size)[size > 0.0].any():
        return None
    share = np.max(unlike[size > 0.0] / size[size > 0.0])
    return (
        f"it says something else of means over {rows} rows of {run.name} than of the rows (unlike by {100.0 * share:.0f} % of its "
        f"standard deviation); {_IN_SECONDS}"
    )


def _smooth(run: Recording, nodes: int) -> Recording:
    """The run with monitors interpolated linearly between means over equal parts, without a lead-in."""
    parts = np.array_split(np.arange(len(run)), nodes)
    at_s = [run.time_s[part].mean() for part in parts]
    monitors = [name for name in run.columns if name != TIME and name not in run.gyro_columns]
    course = {name: np.interp(run.time_s, at_s, [run.column(name)[part].mean() for part in parts]) for name in monitors}
    return run.replace(table=run.table.assign(**course), metadata=dataclasses.replace(run.metadata, lead_in_s=0.0))


def _forms(usual: Mechanism) -> dict[str, Mechanism]:
    """The mechanism with its usual shapes, and with each of them at either bound, by a phrase for messages."""
    bounds = [(p.name, bound) for p in usual.parameters() if p.role == "shape" for bound in (p.low, p.high)]
    return {"": usual} | {f" with {name} = {bound:g}": dataclasses.replace(usual, **{name: bound}) for name, bound in bounds}  # type: ignore[type-var]


def _readable(mechanism: Mechanism, run: Recording) -> bool:
    try:
        mechanism.driver_columns(run)
    except InputError:
        return False
    return True


def _faults(mechanism: type[Mechanism]) -> list[str]:
    """Violations of the contract; the basis is tried only where the declarations are in order."""
    return _declaration_faults(mechanism) or _basis_faults(mechanism)


def _declaration_faults(mechanism: type[Mechanism]) -> list[str]:
    faults = []
    if inspect.isabstract(mechanism):
        faults.append(f"it lacks {', '.join(sorted(mechanism.__abstractmethods__))}")
    name = getattr(mechanism, "name", None)
    if not (isinstance(name, str) and _NAME.fullmatch(name)):
        faults.append(f"name is {name!r}; it must be a text in lower case, as 'gas_drag'")
    if getattr(mechanism, "kind", None) not in _KINDS:
        faults.append(f"kind is {getattr(mechanism, 'kind', None)!r}; it must be one of {', '.join(_KINDS)}")
    equation, reference = getattr(mechanism, "equation", None), getattr(mechanism, "reference", None)
    if not (isinstance(equation, str) and "=" in equation):
        faults.append(f"equation is {equation!r}; it must be a text such as 'b = k_deg_h_K * (T - 20)'")
    if not (isinstance(reference, str) and reference.strip()):
        faults.append(f"reference is {reference!r}; say where the physics is written down")
    drivers = getattr(mechanism, "drivers", None)
    if not (isinstance(drivers, tuple) and all(isinstance(driver, str) for driver in drivers)):
        faults.append(f"drivers is {drivers!r}; it must be a tuple of column names, as ('supply_voltage_V',), or ()")
    if not getattr(getattr(mechanism, "__dataclass_params__", None), "frozen", False):
        return [*faults, "it is not a frozen dataclass; write @dataclasses.dataclass(frozen=True) above it"]
    for field in dataclasses.fields(mechanism):  # type: ignore[arg-type]
        low, high = field.metadata.get("low", 0.0), field.metadata.get("high", 0.0)
        if field.metadata.get("role") not in get_args(Role):
            faults.append(f"{field.name} has no role; make it by amplitude(...), shape(...) or setting(...)")
        elif not low <= high:
            faults.append(f"{field.name} has its bounds reversed: from {low:g} to {high:g}; give the lower one first")
        elif field.metadata["role"] != "setting" and not field.metadata["unit"]:
            faults.append(f"{field.name} has no unit; give one, '1' where it has none")
    return faults


def _basis_faults(mechanism: type[Mechanism]) -> list[str]:
    try:
        usual = mechanism()
        trial = _trial(usual)
    except (Exception, SystemExit) as error:  # noqa: BLE001 - whatever it raises is the file's fault
        return [f"it fails{_line(mechanism, error)}: {type(error).__name__}: {error}"]
    fault = _fault_on(usual, trial)
    if fault is not None:
        return [fault]
    if not np.array_equal(usual.basis(trial), usual.basis(trial.replace(table=trial.table.assign(gyro_deg_h=1.0)))):
        return ["basis changes with the gyro's output or from call to call; it may read monitors only, and no random numbers"]
    if not usual.amplitude_parameters():
        return ["it has no amplitude; give it one parameter made by amplitude(...)"]
    return [
        f"basis is zero for {parameter.name} whatever the monitors read: it can have no effect; give it a column that is not"
        for parameter, nonzero in zip(usual.amplitude_parameters(), _nonzero_amplitudes(usual), strict=True)
        if not nonzero
    ]


def _nonzero_amplitudes(usual: Mechanism) -> list[bool]:
    """For each amplitude, whether its column is ever non-zero: with usual shapes or one at a bound, for monitors of any size."""
    nonzero = np.zeros(len(usual.amplitude_parameters()), dtype=np.bool_)
    for form, scale in itertools.product(_forms(usual).values(), _SCALES):
        if nonzero.all():
            break
        trial = _trial(usual, scale)
        if _fault_on(form, trial) is None:
            with np.errstate(all="ignore"):
                nonzero |= np.asarray(form.basis(trial) != 0.0).any(axis=0)
    return nonzero.tolist()


def _fault_on(mechanism: Mechanism, run: Recording) -> str | None:
    """The fault of its columns on a run; its own warnings are silenced, because the fault states their reason."""
    try:
        with np.errstate(all="ignore"):
            basis: Any = mechanism.basis(run)
    except (Exception, SystemExit) as error:  # noqa: BLE001 - whatever it raises is the file's fault
        return f"it fails on {run.name}{_line(type(mechanism), error)}: {type(error).__name__}: {error}"
    expected = (len(run), len(mechanism.amplitude_parameters()))
    if getattr(basis, "shape", None) != expected:
        return (
            f"basis returns {getattr(basis, 'shape', type(basis).__name__)!s} for {expected[0]} rows and {expected[1]} amplitudes; "
            f"it must return an array of shape {expected}, a column an amplitude"
        )
    if basis.dtype.kind not in "fiub":
        return f"basis returns {basis.dtype} values; it must return real numbers"
    finite = (np.abs(basis) <= _LARGEST).all(axis=1)
    if not finite.all():
        return f"basis is not finite on {run.name}, or beyond {_LARGEST:.0e}, first at row {int(np.argmin(finite))}"
    return None


def _line(mechanism: type[Mechanism], error: BaseException) -> str:
    return error_line(error, getattr(sys.modules.get(mechanism.__module__), "__file__", None) or "")


def _trial(mechanism: Mechanism, scale: float = 1.0) -> Recording:
    """A trial recording: each driver swings with its own period about a scale, temperatures about 20 degC; on a turntable also rate
    and angle of a table that turns to and fro."""
    turns = mechanism.kind == "turntable" or not TURNING.isdisjoint(mechanism.driver_names())
    step_s = 1.0 if turns else 10.0
    time_s = step_s * np.arange(_ROWS)
    columns = {TIME: time_s, "gyro_deg_h": np.zeros(_ROWS)}
    if turns:
        columns[RATE] = 3.0 + 20.0 * np.cos(0.1 * time_s)
        columns |= dict.fromkeys(ANGLES, 40.0 + np.cumsum(columns[RATE]) * step_s)
    for k, driver in enumerate(mechanism.driver_names()):
        column = "temperature_block_degC" if driver == TEMPERATURE else driver
        if column not in (TABLE_RATE, TABLE_ANGLE, *columns):
            columns[column] = _swinging(column, np.sin(2.0 * np.pi * time_s / step_s / (30.0 + 7.0 * k)), scale)
    if FELT_RATE_DEG_S in columns:
        columns[FELT_RATE_DEG_S] = columns[RATE] + 1e-3 if turns else 1e-3 * columns[FELT_RATE_DEG_S]
    metadata = Metadata(kind="turntable" if turns else "chamber")
    return Recording(pd.DataFrame(columns), metadata, name="a trial recording")


def _swinging(column: str, swing: Array, scale: float) -> Array:
    if column.endswith("_degC"):
        return np.clip(20.0 + 15.0 * scale * swing, -80.0, 150.0)
    return scale * (1.0 + 0.2 * swing)
