"""Mechanisms of the user's own, from one Python file, beside those of the catalogue."""

from __future__ import annotations

import inspect
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final, get_args

import numpy as np

from rlgcomp.errors import InputError
from rlgcomp.physics import CATALOGUE
from rlgcomp.physics.mechanism import Mechanism
from rlgcomp.plugins import load_python, said_line
from rlgcomp.recording import Kind, Recording

_SAID: Final = ("name", "kind", "equation", "reference", "drivers")


def with_user_mechanisms(path: str | Path | None) -> dict[str, type[Mechanism]]:
    """The catalogue, and every mechanism that a Python file defines.

    Parameters
    ----------
    path : path, optional
        None: the catalogue alone.

    Raises
    ------
    InputError
        The file cannot be run, defines no mechanism, or one that is not complete.
    """
    catalogue = dict(CATALOGUE)
    if path is None:
        return catalogue
    module = load_python(path)
    found = [
        kind
        for kind in vars(module).values()
        if inspect.isclass(kind) and issubclass(kind, Mechanism) and kind.__module__ == module.__name__
    ]
    if not found:
        raise InputError(
            f"{path} defines no mechanism; write a frozen dataclass that subclasses rlgcomp.Mechanism, as the files in "
            "rlgcomp/physics do"
        )
    for kind in found:
        _check(kind, path)
        if kind.name in catalogue:
            raise InputError(f"{path}: {kind.__name__} is named {kind.name!r}, which is taken; give it another name")
        catalogue[kind.name] = kind
    return catalogue


def check_on(catalogue: Mapping[str, type[Mechanism]], runs: Sequence[Recording], path: str | Path) -> None:
    """Compute every mechanism of the user's once, on the first run, so that what is wrong with it is said before the work.

    Raises
    ------
    InputError
        A basis fails, or is not one finite row a sample with one column an amplitude. A missing monitor is none of these: such a
        mechanism is only left out.
    """
    for name, kind in catalogue.items():
        if name in CATALOGUE:
            continue
        mechanism = kind()
        try:
            mechanism.driver_columns(runs[0])
        except InputError:
            continue
        try:
            basis = np.asarray(mechanism.basis(runs[0]), dtype=np.float64)
        except Exception as error:  # noqa: BLE001 - whatever the user's code raises is the input's fault
            place = said_line(error, path)
            raise InputError(f"{path}{place}: {name}: {type(error).__name__}: {error}; correct its basis") from None
        wanted = (len(runs[0]), len(mechanism.amplitude_parameters()))
        if basis.shape != wanted or not np.isfinite(basis).all():
            state = "" if np.isfinite(basis).all() else ", not all of it finite"
            raise InputError(
                f"{path}: {name}: its basis has shape {basis.shape}{state}; it must be {wanted}: a row a sample, a column an "
                "amplitude"
            )


def _check(kind: type[Mechanism], path: str | Path) -> None:
    missing = [attribute for attribute in _SAID if not hasattr(kind, attribute)]
    if missing:
        raise InputError(f"{path}: {kind.__name__} does not say its {', '.join(missing)}; set them as class attributes")
    if str(kind.kind) not in get_args(Kind):
        raise InputError(f"{path}: {kind.__name__}: kind is {kind.kind!r}; it must be one of {', '.join(get_args(Kind))}")
    if inspect.isabstract(kind) or "__dataclass_params__" not in vars(kind):
        raise InputError(f"{path}: {kind.__name__} must be a frozen dataclass with a method basis(self, recording)")
    try:
        kind().parameters()
    except (KeyError, TypeError) as error:
        raise InputError(
            f"{path}: {kind.__name__} cannot be made from its defaults ({type(error).__name__}: {error}); make every field by "
            "amplitude(), shape() or setting() of rlgcomp.physics.mechanism"
        ) from None
