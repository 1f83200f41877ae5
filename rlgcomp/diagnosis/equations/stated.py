"""Equations of forms as they were found: every symbol that their numbers have, and names and units of these numbers."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Sequence
from typing import Final

from rlgcomp.diagnosis.forms.bases import Basis, EachRun, Own, Power
from rlgcomp.diagnosis.forms.memories import Plays
from rlgcomp.diagnosis.forms.nonlinearities import Hinge, Saturation, SignedPower
from rlgcomp.diagnosis.forms.relaxations import Lag
from rlgcomp.diagnosis.forms.symmetries import Sign
from rlgcomp.diagnosis.forms.terms import Form
from rlgcomp.diagnosis.forms.times import Since
from rlgcomp.diagnosis.regions.selections import in_all_runs
from rlgcomp.physics.mechanism import Mechanism
from rlgcomp.physics.rotation_harmonics import RotationHarmonics
from rlgcomp.units import display_unit

_DECAYS: Final = ("time_constant_s", "slower_time_constant_s")


def all_names(lead: Sequence[Basis], unit: str) -> list[dict[str, tuple[str, str]]]:
    """Names and units of all leading bases, as of :func:`_names`; of several lags, and of two decays, by their time constants."""
    if are_decays(lead):
        return [{"": ("ac"[j], unit), "time_constant_s": (_DECAYS[j], "s")} for j in ranks(lead)]
    names = [_names(basis, unit, j) for j, basis in enumerate(lead)]
    if not _lags(lead):
        return names
    return [
        {own: (f"k_{j + 1}" if own == "" else f"time_constant_{j + 1}_s", of) for own, (_, of) in one.items() if own != "radius"}
        for j, one in zip(ranks(lead), names, strict=True)
    ]


def ranks(lead: Sequence[Basis]) -> list[int]:
    """Places of leading bases in the order of their time constants."""
    times = [(basis.parameters()["time_constant_s"], j) for j, basis in enumerate(lead)]
    return [sum(other < one for other in times) for one in times]


def number_of(name: str) -> int:
    """The number in a name of one of several, else zero."""
    found = re.search(r"_(\d)(?:_s)?$", name)
    return int(found[1]) if found else 0


def _lags(lead: Sequence[Basis]) -> bool:
    """Whether leading bases are several lags."""
    return len(lead) > 1 and all(isinstance(in_all_runs(basis), Lag) for basis in lead)


def are_decays(lead: Sequence[Basis]) -> bool:
    """Whether leading bases are two exponentials of the time in a run."""
    plain = [in_all_runs(basis) for basis in lead]
    return len(plain) == 2 and all(isinstance(one, Since) and one.law == "exponential" and one.of_mechanism for one in plain)


def together(lead: Sequence[Basis]) -> RotationHarmonics | None:
    """Several orders of a table's angle, each a leading basis, as one mechanism without its amplitudes; None of anything else."""
    found: RotationHarmonics | None = None
    for j, basis in enumerate(lead, 1):
        if not isinstance(basis, Own) or not isinstance(basis.mechanism, RotationHarmonics) or len(basis.mechanism.orders) > 1:
            return None
        found = dataclasses.replace(found or basis.mechanism, **{f"order_{j}": basis.mechanism.order_1})  # type: ignore[arg-type]
    return found if len(lead) > 1 else None


def equation_of(form: Form, mechanism: type[Mechanism] | None = None, names: Sequence[str] = ()) -> str:
    """A form's equation with every symbol that its numbers have: the side of a corner, a zero that was found, each of several lags.

    Parameters
    ----------
    form : Form
    mechanism : type of Mechanism, optional
        Its name in the catalogue.
    names : sequence of str
        Of its numbers.
    """
    lead = [in_all_runs(basis) for basis in form.lead if not isinstance(basis, EachRun)]
    if mechanism is not None and "slower_share" in names:
        return mechanism(terms="two").stated()  # type: ignore[call-arg]
    if (orders := together(lead)) is not None:
        return orders.stated()
    match lead:
        case [Own(column=None) as own]:
            return str(own.mechanism.stated())
        case [Hinge(fixed=False) as hinge]:
            u = _in_sum(hinge)
            return f"b = k max({u} - c, 0)" if hinge.side > 0 else f"b = k max(c - {u}, 0)"
        case [Saturation(fixed=False, even=False) as bent]:
            return f"b = k tanh(({_in_sum(bent)} - c) / w)"
        case [SignedPower(fixed=False, even=False) as power]:
            u = _in_sum(power)
            return f"b = k sgn({u} - c) |{u} - c|^p"
    if _lags(lead):
        return "b = " + " + ".join(_lag_text(form.equation, number) for number in range(1, len(lead) + 1))
    return form.equation


def _in_sum(basis: Hinge | Saturation | SignedPower) -> str:
    """What a nonlinearity is of, where something is taken off it."""
    symbol = basis.path.driver.symbol
    return symbol if len(basis.path.driver.columns) == 1 else f"({symbol})"


def _lag_text(equation: str, number: int) -> str:
    """One of several lags in the words of the equation of one."""
    text = equation.removeprefix("b = ").replace("time_constant_s", f"time_constant_{number}_s")
    return f"k_{number} {text.removeprefix('k ')}"


def _names(basis: Basis, unit: str, place: int) -> dict[str, tuple[str, str]]:
    """Names and units of a leading basis's coefficient, under no name, and of its shapes; empty of one whose equation has none."""
    basis = in_all_runs(basis)
    match basis:
        case Sign():
            return {"": ("c", unit), "w": ("w", display_unit(basis.driver.columns[0]))}
        case Lag() | Plays(spread=False):
            of = display_unit(basis.driver.columns[0])
            second = place > 0 and isinstance(basis, Plays)
            return {
                "": ("l" if second else "k", _per(unit, of)),
                "time_constant_s": ("time_constant_s", "s"),
                "radius": ("radius", of),
            }
        case Power(degree=1) | Saturation() | Hinge() | SignedPower():
            path = basis.path
            of = f"{path.driver.unit}/min" if path.driver.unit and path.memory == "rate" else path.driver.unit
            second = place > 0 and isinstance(basis, Hinge)
            if isinstance(basis, Saturation):
                return {"": ("k", unit), "c": ("c", of), "w": ("w", of)}
            if isinstance(basis, SignedPower):
                return {"": ("k", _per(unit, of, f"^{basis.exponent:.3g}")), "p": ("p", ""), "c": ("c", of)}
            return {"": ("l" if second else "k", _per(unit, of)), "c": ("d" if second else "c", of), "delay_s": ("delay_s", "s")}
    return {}


def _per(unit: str, of: str, power: str = "") -> str:
    """A unit over another."""
    return f"{unit}/{of if of.isalpha() or len(of) == 1 else f'({of})'}{power}" if of else f"{unit} per unit of the column{power}"
