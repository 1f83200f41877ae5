"""Command on the mechanisms that a simulator file may hold: mechanisms."""

from __future__ import annotations

import contextlib
import inspect
import math
from typing import TYPE_CHECKING, Annotated, Any

import typer

from rlgcomp.cli.base import AsJson, MechanismFiles, command
from rlgcomp.cli.show import show_json, show_table, show_text
from rlgcomp.errors import InputError

if TYPE_CHECKING:
    from rlgcomp.physics.mechanism import Mechanism, Parameter


@command("mechanisms", several=("--mechanisms",))
def mechanisms(
    name: Annotated[
        str | None, typer.Argument(metavar="[NAME]", help="Mechanism to describe; all are listed unless given.")
    ] = None,
    files: MechanismFiles = None,
    as_json: AsJson = False,
) -> None:
    """Mechanisms that a simulator file may hold and that a diagnosis tries.

    Of one mechanism: its equation, its source, and its parameters with units and bounds.

    Example: `rlgcomp mechanisms thermal_hysteresis`
    """
    from rlgcomp.physics.user import user_catalogue

    stray = next((file for file in files or [] if file.suffix != ".py"), None)
    if stray is not None:
        raise InputError(f"{stray}: expected a Python file, one that ends in .py; the name of a mechanism goes before --mechanisms")
    catalogue = user_catalogue(files or [])
    if name is not None and name not in catalogue:
        raise InputError(f"no mechanism is called {name!r}; there are {', '.join(catalogue)}")
    chosen = list(catalogue.values()) if name is None else [catalogue[name]]
    if as_json:
        show_json([_described(form) for form in chosen])
    elif name is None:
        rows = [{"mechanism": form.name, "kind": form.kind, "equation": form.equation} for form in chosen]
        show_table("Mechanisms; `rlgcomp mechanisms NAME` lists their parameters", rows)
    else:
        (form,) = chosen
        about = _headline(form)
        show_text(f"{form.name} ({form.kind}){': ' if about else ''}{about}\n\n  {form.equation}\n\n  {form.reference}\n")
        if form.drivers:
            show_text(f"It reads {', '.join(form.drivers)}.\n")
        if form.parameters():
            show_table("Parameters", [_row(parameter) for parameter in form.parameters()])
        for parameter in form.parameters():
            stated = _equations(form, parameter)
            if len(set(stated.values())) > 1:
                rows = [{parameter.name: choice, "equation": equation} for choice, equation in stated.items()]
                show_table(f"Equation, by {parameter.name}", rows)


def _headline(form: type[Mechanism]) -> str:
    """The first paragraph of its docstring, unless dataclass generated that."""
    about = inspect.getdoc(form) or ""
    return "" if about.startswith(f"{form.__name__}(") else about.partition("\n\n")[0].replace("\n", " ")


def _equations(form: type[Mechanism], parameter: Parameter) -> dict[str, str]:
    """By each choice of a setting, but for those that ask for others beside them."""
    found = {}
    for choice in parameter.choices:
        with contextlib.suppress(InputError):
            found[choice] = form(**{parameter.name: choice}).stated()
    return found


def _row(parameter: Parameter) -> dict[str, str]:
    bounds = f"{parameter.low:g} to {parameter.high:g}" if math.isfinite(parameter.high - parameter.low) else ""
    return {
        "parameter": parameter.name,
        "role": parameter.role,
        "usual": str(parameter.typical),
        "unit": parameter.unit,
        "may be": ", ".join(parameter.choices) or bounds,
    }


def _described(form: type[Mechanism]) -> dict[str, Any]:
    return {
        "mechanism": form.name,
        "kind": form.kind,
        "about": _headline(form),
        "equation": form.equation,
        "reference": form.reference,
        "drivers": list(form.drivers),
        "parameters": [
            {
                "name": parameter.name,
                "role": parameter.role,
                "unit": parameter.unit,
                "usual": parameter.typical,
                "low": parameter.low if math.isfinite(parameter.low) else None,
                "high": parameter.high if math.isfinite(parameter.high) else None,
                "choices": list(parameter.choices),
            }
            for parameter in form.parameters()
        ],
    }
