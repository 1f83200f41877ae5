"""Findings: each member of the likeliest set with its parameters, its function and what may stand in its place."""

from __future__ import annotations

import dataclasses
import functools
import re
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from rlgcomp.diagnosis.answer.fit import Estimate, Fit
from rlgcomp.diagnosis.answer.posterior import Posterior
from rlgcomp.diagnosis.data import Data
from rlgcomp.diagnosis.decide import Named
from rlgcomp.diagnosis.equations import equations
from rlgcomp.diagnosis.equations.functions import Function, function_of
from rlgcomp.diagnosis.equations.lines import line_of
from rlgcomp.diagnosis.equations.parameters import of_law, of_mechanism
from rlgcomp.diagnosis.equations.simulator_file import mechanisms_of
from rlgcomp.diagnosis.equations.stated import equation_of
from rlgcomp.diagnosis.equations.switches import Switch, switches_of
from rlgcomp.diagnosis.equations.time_laws import time_law_of
from rlgcomp.diagnosis.forms.terms import Form, Region
from rlgcomp.diagnosis.noise.errors import columns_of
from rlgcomp.diagnosis.regions.selections import amplitudes_have_a_mean, by_run, runs_of
from rlgcomp.errors import InputError
from rlgcomp.physics.mechanism import Mechanism
from rlgcomp.recording import Recording

Array = npt.NDArray[np.float64]
DEG_H: Final = "deg/h"
_CLEAR: Final = 0.3  # of the white noise of a window mean, from which on a departure from an equation is told


def in_unit(text: str, unit: str) -> str:
    """A unit of a gyro's parameter as that of another output: "deg/h/K" in N is "N/K"."""
    return text.replace(DEG_H, unit)


def shown_name(name: str, unit: str) -> str:
    """Name of a parameter as pages have it: where the output is no rate, without the gyro's unit, which files keep in it."""
    return name if unit == DEG_H else name.split("_deg_h", maxsplit=1)[0]


@dataclasses.dataclass(frozen=True)
class Cause:
    """A member of the likeliest set.

    Parameters
    ----------
    name : str
        Of the mechanism; of a law without a name, its region.
    named : bool
        Whether a mechanism has this name.
    of_simulator : bool
        The simulator has this mechanism, and another form of it is found.
    probability : float
    parameters : mapping of str to Estimate
        What the runs determine of them.
    undetermined : tuple of str
        Parameters whose error exceeds their value, or all of an equation that is approximate.
    equation : str
    own_form : bool
        The equation is not the catalogue's.
    drivers : tuple of str
    memory : str
    function : Function, optional
    rms : float
        Of its contribution to window means of the training runs, about its mean.
    unit : str
        Of the output.
    departure : float
        Rms of window means of what the equation leaves of the function, where that is clear of the noise; else zero.
    approximate : bool
        The function found departs from the equation by so much that its parameters say nothing.
    indistinguishable_from : tuple of str
    rival_probabilities : tuple of float
    perhaps_nothing : float
        Probability of the set without it, where that is nearly as likely; else zero.
    mechanism : type of Mechanism, optional
        Of that name.
    runs : mapping of str to float
        Root mean square by run, where it acts in some of the training runs, or by another amplitude in each.
    opposite_in : tuple of str
        Of these, the runs where it is of the other sign than where it is largest.
    has_mean : bool
        Its amplitudes by run have a mean, which other runs are predicted with.
    switches : tuple of Switch
        Of a sum of relays, in the place of parameters.
    terms : callable
        What of it holds in other runs, as mechanisms.
    """

    name: str
    named: bool
    probability: float
    parameters: Mapping[str, Estimate]
    undetermined: tuple[str, ...]
    equation: str
    own_form: bool
    drivers: tuple[str, ...]
    memory: str
    function: Function | None = dataclasses.field(repr=False)
    rms: float
    unit: str = DEG_H
    departure: float = 0.0
    approximate: bool = False
    indistinguishable_from: tuple[str, ...] = ()
    rival_probabilities: tuple[float, ...] = ()
    perhaps_nothing: float = 0.0
    mechanism: type[Mechanism] | None = None
    of_simulator: bool = False
    runs: Mapping[str, float] = dataclasses.field(default_factory=dict)
    opposite_in: tuple[str, ...] = ()
    has_mean: bool = False
    switches: tuple[Switch, ...] = ()
    terms: Callable[[], Sequence[Mechanism]] = dataclasses.field(default=tuple, repr=False)

    @property
    def states_its_numbers(self) -> bool:
        """Whether its equation has all of its parameters by name."""
        return bool(self.parameters) and all(re.search(rf"\b{name}\b", self.equation) for name in self.parameters)

    @property
    def _of_catalogue(self) -> bool:
        return self.mechanism is not None and bool(self.parameters) and not self.own_form

    @property
    def formula(self) -> str:
        """The mechanism's equation where its parameters express the term, the form's elsewhere."""
        usual = self.mechanism().stated() if self.mechanism is not None and self._of_catalogue else self.equation
        return self.equation if self.states_its_numbers else usual

    @property
    def latex(self) -> str:
        """The formula as LaTeX; of a mechanism in words the formula of its description."""
        description = (self.mechanism.__doc__ or "") if self.mechanism is not None and self._of_catalogue else ""
        return equations.latex(self.formula, description)

    def sympy(self, *, numbers: bool = False) -> Any:
        """The formula's right side as an expression of SymPy; with `numbers`, parameters have their fitted values.

        Raises
        ------
        InputError
            SymPy is not installed, or the formula is stated in words.
        """
        expression = equations.sympy(self.formula)
        values = {name: one.value for name, one in self.parameters.items()} if numbers else {}
        return expression.subs({symbol: values[str(symbol)] for symbol in expression.free_symbols if str(symbol) in values})

    def __call__(self, recording: Recording) -> Array:
        """What it contributes to a recording's output, by its drivers, in the unit of the output; shape (n,).

        Raises
        ------
        InputError
            It has nothing that holds for other runs, or the recording lacks a driver.
        """
        terms = self.terms()
        if not terms:
            raise InputError(f"{self.name} differs from run to run: what was found of one run says nothing of another")
        rng = np.random.default_rng(0)  # no random numbers are drawn
        return np.asarray(sum(term.contribution(recording, rng) for term in terms))

    @property
    def acts_in(self) -> list[str]:
        """Runs in which it acts, of those that `runs` has."""
        return [run for run, rms in self.runs.items() if rms > 0.0]

    def to_mapping(self) -> dict[str, Any]:
        """An entry of `findings`; of a law, of `unexplained.laws`."""
        return {
            "mechanism": self.name if self.named else None,
            "probability": self.probability,
            "parameters": {name: one.to_mapping() for name, one in self.parameters.items()},
            "undetermined": list(self.undetermined),
            **({"switches": [one.to_mapping() for one in self.switches]} if self.switches else {}),
            "equation": self.equation,
            "function": {} if self.function is None else self.function.to_mapping(self.unit),
            "drivers": list(self.drivers),
            "memory": self.memory,
            **({"other_form": True} if self.of_simulator else {}),
            "rms": {"value": self.rms, "unit": self.unit},
            **({"rms_by_run": {name: {"value": rms, "unit": self.unit} for name, rms in self.runs.items()}} if self.runs else {}),
            "indistinguishable_from": list(self.indistinguishable_from),
            "rival_probabilities": list(self.rival_probabilities),
            "perhaps_nothing": self.perhaps_nothing,
        }


def cause_of(one: Named, fit: Fit, posterior: Posterior, catalogue: Mapping[str, type[Mechanism]], unit: str) -> Cause:
    """What is stated of a named region, by the fit of the likeliest set; the unit is that of the output."""
    members = [member.form.region for member in fit.state.members]
    rivals = posterior.instead_of(one.region)
    common: dict[str, Any] = {
        "name": one.mechanism or one.region,
        "named": one.mechanism is not None,
        "probability": one.probability,
        "unit": unit,
        "indistinguishable_from": one.indistinguishable_from,
        "rival_probabilities": tuple(min(rivals.get(name, 0.0), 1.0) for name in one.indistinguishable_from),
        "perhaps_nothing": one.perhaps_nothing,
        "mechanism": None if one.mechanism is None else catalogue.get(one.mechanism),
        "of_simulator": one.mechanism not in (None, one.region),
    }
    if one.region not in members:
        return _telegraph(fit, common)
    k, region = members.index(one.region), posterior.regions[one.region]
    form = fit.state.members[k].form
    mechanism = common["mechanism"]
    estimates: dict[str, Estimate]
    drivers = _followed(region, form, fit.data)
    of_catalogue = mechanism is not None and one.region == one.mechanism and drivers == region.drivers
    estimates, left = of_mechanism(fit, k, mechanism) if of_catalogue else ({}, ())
    named = bool(estimates)
    estimates = estimates or line_of(fit, k) or time_law_of(fit, k)
    if not estimates and not left:
        estimates, left = of_law(fit, k, unit)
    own_form = mechanism is not None and not named and "slower_share" not in estimates
    estimates = {name: dataclasses.replace(each, unit=in_unit(each.unit, unit)) for name, each in estimates.items()}
    contribution = fit.data.means(functools.partial(fit.term, k))[fit.data.of_windows]
    return Cause(
        parameters={name: each for name, each in estimates.items() if each.sd <= abs(each.value)},
        undetermined=(*left, *(name for name, each in estimates.items() if each.sd > abs(each.value))),
        approximate=bool(left),
        equation=equation_of(form, mechanism, tuple(estimates)),
        own_form=own_form,
        drivers=drivers,
        memory=region.memory,
        function=function_of(fit, k),
        rms=float(np.std(contribution)),
        departure=_departure(fit, k, contribution),
        runs=_by_run(fit, k),
        opposite_in=_opposite(fit, k),
        has_mean=amplitudes_have_a_mean(form),
        switches=() if estimates else switches_of(fit, k, unit),
        terms=functools.partial(mechanisms_of, fit, k, catalogue),
        **common,
    )


def _followed(region: Region, form: Form, data: Data) -> tuple[str, ...]:
    """Columns that a form follows: its region's, or others that measure the same, or another place's."""
    own, read = set(region.drivers) & set(data.columns), columns_of(form.lead, data)
    return read if own and read and not set(read) & own else region.drivers


def _departure(fit: Fit, k: int, contribution: Array) -> float:
    """Root mean square of what the leading bases leave of a member's window means; zero where the noise hides it."""
    member, bases = fit.parts[k]
    leading = [fit.bank.columns(basis)[fit.data.of_windows] for basis, _ in bases[: len(member.form.lead)]]
    table = np.column_stack([np.ones(len(contribution)), *leading])
    size = np.maximum(np.linalg.norm(table, axis=0), 1e-300)
    left = contribution - table / size @ np.linalg.lstsq(table / size, contribution, rcond=1e-12)[0]
    departure = float(np.std(left))
    return departure if departure > _CLEAR * fit.white else 0.0


def _by_run(fit: Fit, k: int) -> dict[str, float]:
    """Root mean squares by run of a member that is not the same in all; else none."""
    form = fit.state.members[k].form
    if not runs_of(form) and not by_run(form):
        return {}
    return {run.name: float(np.std(run.window_means(fit.term(k, run)))) for run in fit.data.runs}


def _opposite(fit: Fit, k: int) -> tuple[str, ...]:
    """Runs in which a member whose amplitudes have a mean is of the other sign than in the run where it is largest."""
    if not amplitudes_have_a_mean(fit.state.members[k].form):
        return ()
    largest = max(fit.data.runs, key=lambda run: float(np.std(run.window_means(fit.term(k, run)))))
    course = fit.term(k, largest)
    others = {}
    for run in fit.data.runs:
        named = dataclasses.replace(largest, binned=largest.binned.replace(name=run.name), cache={}, derived={})
        others[run.name] = fit.term(k, named)
    return tuple(name for name, other in others.items() if (other - other.mean()) @ (course - course.mean()) < 0.0)


def _telegraph(fit: Fit, common: Mapping[str, Any]) -> Cause:
    seen = fit.state.process
    assert seen is not None  # noqa: S101
    window_s = fit.data.runs[0].grid.window_s
    step_sd, dwell_s = seen.sigma / np.sqrt(len(fit.data)), seen.dwell * window_s
    parameters = {
        "half_step_deg_h": Estimate(seen.half_step, float(step_sd), common["unit"]),
        "dwell_s": Estimate(dwell_s, float(dwell_s / np.sqrt(seen.jumps)), "s"),
    }
    return Cause(
        parameters=parameters,
        undetermined=(),
        equation="b = half_step_deg_h * (+1 or -1)",
        own_form=False,
        drivers=(),
        memory="none",
        function=None,
        rms=seen.half_step,
        **common,
    )
