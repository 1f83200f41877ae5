"""What may act beside effects and is no missing physics: steps of the bias, biases of runs, late columns, wrong numbers."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterator
from typing import Final

import numpy as np
import numpy.typing as npt

from rlgcomp.diagnosis import priors
from rlgcomp.diagnosis.baseline import Baseline
from rlgcomp.diagnosis.bases import Constant, EachRun, Moment, Own
from rlgcomp.diagnosis.data import Data
from rlgcomp.diagnosis.lateness import late_regions
from rlgcomp.diagnosis.selections import amplitudes_by_run
from rlgcomp.diagnosis.terms import Form, Region

Array = npt.NDArray[np.float64]
STEP: Final = "bias step"
RUN_BIAS: Final = "run bias"
_ODDS: Final = math.log(priors.NUISANCE_ODDS)
_END: Final = 3  # windows from either end of a run, where a step is none
_MOST: Final = 4  # steps
_STRIDE: Final = 4  # windows between places at which a further step is tried


def nuisances(data: Data, baseline: Baseline) -> Iterator[Region]:
    """Their regions.

    Parameters
    ----------
    data : Data
    baseline : Baseline
    """
    yield Region(STEP, None, _ODDS, (), grow=_more_steps(data), propose=_steps(data), nuisance=True)
    names = tuple(run.name for run in data.runs)
    if len(names) > 1:
        yield Region(RUN_BIAS, None, _ODDS, (Form(RUN_BIAS, "b = bias of the run", (EachRun(Constant(), names),)),), nuisance=True)
    yield from late_regions(data)
    yield from amplitudes_by_run(data, baseline)
    stated = [(mechanism, k, p.name) for mechanism in baseline.simulator.mechanisms for k, p in baseline.known(mechanism)]
    for mechanism, k, name in stated:
        key = f"{mechanism.name}:{name}"
        form = Form(key, f"{name} is not as stated", (Own(mechanism, k),))
        yield Region(key, None, _ODDS - math.log(len(stated)), (form,), nuisance=True)


def _form(data: Data, run: str, window: float) -> Form:
    window_s = data.runs[0].grid.window_s
    count = sum(len(one.full) for one in data.runs)
    return Form(STEP, "b = step from a moment on in one run", (Moment(run, window * window_s, window_s),), (), (), -math.log(count))


def _steps(data: Data) -> Callable[[Array], tuple[Form, ...]]:
    """The likeliest place of a step in each run, where means before and after differ most; and the two likeliest together."""

    def propose(residual: Array) -> tuple[Form, ...]:
        found, likeliest = [], []
        for run, rows in zip(data.runs, data.slices, strict=True):
            left = residual[rows][: len(run.windows)]
            left = left - left.mean()
            n = len(left)
            if n <= 2 * _END:
                continue
            before = np.arange(1, n)
            score = np.cumsum(left)[:-1] ** 2 / (before * (n - before))
            k = _END + int(np.argmax(score[_END : n - _END])) if n > 2 * _END + 1 else _END
            places = [_form(data, run.name, float(run.windows[k] + 1) + shift) for shift in (-0.5, 0.0, 0.5)]
            found += places
            likeliest.append((float(score[k]), places[1]))
        likeliest.sort(key=lambda one: one[0], reverse=True)
        if len(likeliest) > 1:
            (_, one), (_, other) = likeliest[:2]
            share = one.log_share + other.log_share + math.log(priors.MORE_STEPS)
            found.append(dataclasses.replace(one, lead=(*one.lead, *other.lead), log_share=share))
        return tuple(found)

    return propose


def _more_steps(data: Data) -> Callable[[Form], Iterator[Form]]:
    def grow(form: Form) -> Iterator[Form]:
        if len(form.lead) >= _MOST:
            return
        for run in data.runs:
            for window in range(_END, len(run.full) - _END, _STRIDE):
                more = _form(data, run.name, float(window))
                share = form.log_share + more.log_share + math.log(priors.MORE_STEPS * _STRIDE)
                yield dataclasses.replace(form, lead=(*form.lead, *more.lead), log_share=share)

    return grow
