"""A user's own mechanisms, from a Python file of theirs, held to the contract before anything is computed with them."""

from __future__ import annotations

import dataclasses
import inspect
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final, get_args

import numpy as np
import pandas as pd

from rlgcomp.errors import InputError
from rlgcomp.physics import CATALOGUE
from rlgcomp.physics.mechanism import TEMPERATURE, Mechanism, Role
from rlgcomp.plugins import load_python, said_line
from rlgcomp.recording import TIME, Recording

_NAME: Final = re.compile(r"[a-z][a-z0-9_]*")
_KINDS: Final = ("chamber", "turntable", "any")
_ROWS: Final = 64
_EXAMPLE: Final = "see 'Add a mechanism' in CONTRIBUTING.md, and rlgcomp/physics/thermal_lag.py for an example"


def user_catalogue(
    paths: Sequence[str | Path], catalogue: Mapping[str, type[Mechanism]] = CATALOGUE
) -> MappingProxyType[str, type[Mechanism]]:
    """A catalogue with the mechanisms that Python files define added to it.

    Parameters
    ----------
    paths : sequence of str or Path
        Files that define subclasses of :class:`rlgcomp.physics.mechanism.Mechanism`. Those that a file imports do not count.
    catalogue : mapping of str to type

    Raises
    ------
    InputError
        A file cannot be run or defines no mechanism, a name is taken, or a mechanism breaks the contract: all its faults are named.
    """
    extended = dict(catalogue)
    for path in paths:
        module = load_python(path)
        found = [
            member
            for member in vars(module).values()
            if inspect.isclass(member) and issubclass(member, Mechanism) and member.__module__ == module.__name__
        ]
        if not found:
            raise InputError(f"{path} defines no mechanism: no class derived from rlgcomp.Mechanism; {_EXAMPLE}")
        for mechanism in found:
            faults = _faults(mechanism, path)
            if faults:
                listed = "\n".join(f"  - {fault}" for fault in faults)
                raise InputError(f"{path}: {mechanism.__name__} is not a valid mechanism; {_EXAMPLE}:\n{listed}")
            if mechanism.name in extended:
                raise InputError(
                    f"{path}: the name {mechanism.name!r} is taken in the catalogue; give {mechanism.__name__} another"
                )
            extended[mechanism.name] = mechanism
    return MappingProxyType(extended)


def _faults(mechanism: type[Mechanism], path: str | Path) -> list[str]:
    """What breaks the contract; what is computed is tried only once what is said is in order."""
    return _faults_said(mechanism) or _faults_computed(mechanism, path)


def _faults_said(mechanism: type[Mechanism]) -> list[str]:
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
        if field.metadata.get("role") not in get_args(Role):
            faults.append(f"{field.name} has no role; make it by amplitude(...), shape(...) or setting(...)")
        elif field.metadata["role"] != "setting" and not field.metadata["unit"]:
            faults.append(f"{field.name} has no unit; give one, '1' where it has none")
    return faults


def _faults_computed(mechanism: type[Mechanism], path: str | Path) -> list[str]:
    try:
        usual = mechanism()
        trial = _trial(usual)
        basis: Any = usual.basis(trial)
        again: Any = usual.basis(trial.replace(table=trial.table.assign(gyro_deg_h=1.0)))
        without = usual.covariance(np.zeros(1)) is None
    except Exception as error:  # noqa: BLE001 - whatever it raises is the file's fault
        return [f"it fails on a trial recording{said_line(error, path)}: {type(error).__name__}: {error}"]
    wanted = (_ROWS, len(usual.amplitude_parameters()))
    if getattr(basis, "shape", None) != wanted:
        return [
            f"basis returns {getattr(basis, 'shape', type(basis).__name__)!s} for {_ROWS} rows and {wanted[1]} amplitudes; it must "
            f"return an array of shape {wanted}, a column an amplitude"
        ]
    if not np.isfinite(basis).all():
        return ["basis is not finite on a trial recording"]
    if not np.array_equal(basis, again):
        return ["basis changes with the gyro's output or from call to call; it may read monitors only, and no random numbers"]
    if not wanted[1] and without:
        return ["it has no amplitude and no covariance; give it one parameter made by amplitude(...)"]
    return []


def _trial(mechanism: Mechanism) -> Recording:
    """Ten minutes of every column that it reads, each moving in its own way about 1, or 20 where it is a temperature."""
    time_s = 10.0 * np.arange(_ROWS)
    columns = {TIME: time_s, "gyro_deg_h": np.zeros(_ROWS)}
    for k, driver in enumerate(mechanism.driver_names()):
        column = "temperature_block_degC" if driver == TEMPERATURE else driver
        swing = np.sin(2.0 * np.pi * time_s / (300.0 + 70.0 * k))
        columns[column] = 20.0 + 15.0 * swing if column.endswith("_degC") else 1.0 + 0.2 * swing
    return Recording(pd.DataFrame(columns), name="trial")
