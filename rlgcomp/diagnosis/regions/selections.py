"""Selections of a term: some of the runs, or an amplitude a run; and amplitudes of the simulator that differ from run to run."""

from __future__ import annotations

import dataclasses
import functools
import itertools
import math
from collections.abc import Iterator, Sequence
from typing import Final, Self

import numpy as np
import numpy.typing as npt

from rlgcomp.diagnosis import priors
from rlgcomp.diagnosis.data import Data, Run
from rlgcomp.diagnosis.forms.bases import Basis, EachRun, Own
from rlgcomp.diagnosis.forms.terms import Form, Region
from rlgcomp.diagnosis.regions.baseline import Baseline
from rlgcomp.physics.mechanism import Parameter

Array = npt.NDArray[np.float64]
_ALL_SUBSETS: Final = 5  # runs, up to which all subsets are tried; of more, one run and all but one
BY_RUN: Final = " by run"  # after mechanism and parameter, the key of a region


@dataclasses.dataclass(frozen=True)
class OnlyIn(Basis):
    """Another basis in some of the runs, with the same weights; nothing in others."""

    basis: Basis
    runs: tuple[str, ...]

    def columns(self, run: Run) -> Array:
        return np.asarray(self.basis.columns(run) * (run.name in self.runs))

    def weighted(self, run: Run, weights: Array) -> Array:
        return self.basis.weighted(run, weights) if run.name in self.runs else np.zeros(run.bins)

    def unsettled(self, run: Run) -> Array:
        return np.asarray(self.basis.unsettled(run) * (run.name in self.runs))

    def nearby(self, step: float) -> tuple[Self, ...]:
        return tuple(dataclasses.replace(self, basis=basis) for basis in self.basis.nearby(step))

    def parameters(self) -> dict[str, float]:
        return self.basis.parameters()

    def per_unit(self) -> float:
        return self.basis.per_unit()

    @property
    def of_mechanism(self) -> bool:
        return self.basis.of_mechanism


def in_all_runs(basis: Basis) -> Basis:
    """A basis without its selection of runs."""
    return basis.basis if isinstance(basis, OnlyIn) else basis


def selections(form: Form, runs: Sequence[str]) -> list[Form]:
    """A form in each subset of the runs, and with amplitudes that differ from run to run, as much as they are large or a little.

    Amplitudes have a mean, which is what a further run is predicted with.

    Parameters
    ----------
    form : Form
    runs : sequence of str
        All training runs.
    """
    if len(runs) < 2 or any(isinstance(basis, OnlyIn | EachRun) for basis in form.lead):
        return []
    subsets = _subsets(tuple(runs))
    share = form.log_share + math.log(priors.PART_OF_RUNS / len(subsets))
    found = [
        dataclasses.replace(
            form,
            lead=tuple(OnlyIn(basis, subset) for basis in form.lead),
            smooth=tuple(OnlyIn(basis, subset) for basis in form.smooth),
            log_share=share,
        )
        for subset in subsets
    ]
    own, share = functools.partial(EachRun, runs=tuple(runs)), form.log_share + math.log(0.5 * priors.AMPLITUDE_BY_RUN)
    strongly = dataclasses.replace(form, lead=(*form.lead, *(own(basis) for basis in form.lead)), log_share=share)
    return [*found, strongly, dataclasses.replace(form, own=(*form.own, own), log_share=share)]


def runs_of(form: Form) -> tuple[str, ...]:
    """The runs in which a form acts; none where it acts in all."""
    return next((basis.runs for basis in form.lead if isinstance(basis, OnlyIn)), ())


def by_run(form: Form) -> bool:
    """Whether a form has amplitudes by run, with a mean or (waves) without one."""
    return isinstance(form.lead[0] if form.lead else None, EachRun) or amplitudes_have_a_mean(form)


def amplitudes_have_a_mean(form: Form) -> bool:
    """Whether its amplitudes differ from run to run about a mean."""
    in_lead = any(isinstance(basis, EachRun) and basis.basis in form.lead for basis in form.lead)
    return in_lead or any(isinstance(make, functools.partial) and make.func is EachRun for make in form.own)


def parameter_by_run(key: str, baseline: Baseline) -> Parameter:
    """The amplitude of the simulator that a region of :func:`amplitudes_by_run` is of."""
    name, _, parameter = key.removesuffix(BY_RUN).partition(":")
    mechanism = next(one for one in baseline.simulator.mechanisms if one.name == name)
    return next(one for one in mechanism.amplitude_parameters() if one.name == parameter)


def _subsets(runs: tuple[str, ...]) -> list[tuple[str, ...]]:
    sizes = range(1, len(runs)) if len(runs) <= _ALL_SUBSETS else sorted({1, len(runs) - 1})
    return [subset for size in sizes for subset in itertools.combinations(runs, size)]


def amplitudes_by_run(data: Data, baseline: Baseline) -> Iterator[Region]:
    """A region for each free amplitude of the simulator: it differs from run to run.

    Parameters
    ----------
    data : Data
    baseline : Baseline
    """
    names = tuple(run.name for run in data.runs)
    columns = [
        (mechanism, k, p.name)
        for mechanism in baseline.simulator.mechanisms
        if not mechanism.each_run
        for k, p in enumerate(mechanism.amplitude_parameters())
        if p in baseline.free(mechanism, "amplitude") and p.name != mechanism.constant
    ]
    for mechanism, k, name in columns if len(names) > 1 else ():
        key = f"{mechanism.name}:{name}{BY_RUN}"
        basis = baseline.own.get(mechanism.name) or Own(mechanism, k)
        form = Form(key, f"{name} differs from run to run", (EachRun(basis, names),))
        yield Region(key, None, math.log(priors.NUISANCE_ODDS / len(columns)), (form,), nuisance=True)
