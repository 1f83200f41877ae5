"""What may act beside effects and is no missing physics: steps of the bias, biases of runs, late columns, wrong
numbers, a lag that had not settled."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterator, Sequence
from typing import Final

from rlgcomp.diagnosis import priors
from rlgcomp.diagnosis.data import Data
from rlgcomp.diagnosis.forms.bases import Constant, EachRun, Moment, Own
from rlgcomp.diagnosis.forms.terms import Family, Form, Region, forms_of, log_odds_of_more
from rlgcomp.diagnosis.forms.times import Since
from rlgcomp.diagnosis.regions.baseline import Baseline
from rlgcomp.diagnosis.regions.lateness import late_regions
from rlgcomp.diagnosis.regions.selections import amplitudes_by_run
from rlgcomp.physics.thermal_lag import ThermalLag

STEP: Final = "bias step"
RUN_BIAS: Final = "run bias"
BEFORE: Final = " before the runs"  # after a mechanism of the simulator, the key of a region
_ODDS: Final = math.log(priors.NUISANCE_ODDS)
_END: Final = 8  # windows from either end of a run, where a step would be the run's bias
_MOST: Final = 4  # steps
_STRIDE: Final = 4  # windows between places at which a step is tried


def nuisances(data: Data, baseline: Baseline) -> Iterator[Region]:
    """Their regions.

    Parameters
    ----------
    data : Data
    baseline : Baseline
    """
    steps = _steps(data)
    if steps:
        yield Region(STEP, None, _ODDS, steps, grow=_more_steps(steps), shrink=_fewer_steps(steps), nuisance=True)
    names = tuple(run.name for run in data.runs)
    if len(names) > 1:
        yield Region(RUN_BIAS, None, _ODDS, (Form(RUN_BIAS, "b = bias of the run", (EachRun(Constant(), names),)),), nuisance=True)
    yield from late_regions(data)
    yield from _unsettled(data, baseline)
    yield from amplitudes_by_run(data, baseline)
    stated = [(mechanism, k, p.name) for mechanism in baseline.simulator.mechanisms for k, p in baseline.known(mechanism)]
    for mechanism, k, name in stated:
        key = f"{mechanism.name}:{name}"
        form = Form(key, f"{name} is not as stated", (Own(mechanism, k, baseline.own.get(mechanism.name)),))
        yield Region(key, None, _ODDS - math.log(len(stated)), (form,), nuisance=True)


def _unsettled(data: Data, baseline: Baseline) -> Iterator[Region]:
    """What a lag of the simulator had not settled from when the runs began; it begins each at rest."""
    names = tuple(run.name for run in data.runs)
    for lag in (one for one in baseline.simulator.mechanisms if isinstance(one, ThermalLag)):
        key, decay = f"{lag.name}{BEFORE}", Since("exponential", lag.time_constant_s, data.longest_s)
        form = Form(key, f"b = a exp(-t / {lag.time_constant_s:.4g} s), a of each run", (EachRun(decay, names),))
        yield Region(key, None, _ODDS, (form,), memory="dynamic", nuisance=True)


def _steps(data: Data) -> tuple[Form, ...]:
    """A step at every few windows of every run, each as likely as another; polished afterwards."""
    window_s = data.runs[0].grid.window_s
    moments = [
        Moment(run.name, window * window_s, window_s, (_END * window_s, (len(run.full) - _END) * window_s))
        for run in data.runs
        for window in range(_END, len(run.full) - _END, _STRIDE)
    ]
    return forms_of(STEP, [Family("b = step from a moment on in one run", [(moment,) for moment in moments])])


def _more_steps(steps: Sequence[Form]) -> Callable[[Form], Iterator[Form]]:
    """Forms with one step more."""

    def grow(form: Form) -> Iterator[Form]:
        if len(form.lead) < _MOST:
            for step in steps:
                share = form.log_share + log_odds_of_more(len(form.lead), 1, len(steps))
                yield dataclasses.replace(form, lead=(*form.lead, *step.lead), log_share=share)

    return grow


def _fewer_steps(steps: Sequence[Form]) -> Callable[[Form], Iterator[Form]]:
    """Forms with one step less, where one is left."""

    def shrink(form: Form) -> Iterator[Form]:
        if len(form.lead) > 1:
            for k in range(len(form.lead)):
                share = form.log_share + log_odds_of_more(len(form.lead), -1, len(steps))
                yield dataclasses.replace(form, lead=(*form.lead[:k], *form.lead[k + 1 :]), log_share=share)

    return shrink
