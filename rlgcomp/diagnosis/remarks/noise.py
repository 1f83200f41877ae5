"""What is said of noise: what passes for it, what wanders unrecorded, and how runs are weighed."""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Sequence
from typing import Final

import numpy as np
import numpy.typing as npt

from rlgcomp.diagnosis.account import alternatives_of
from rlgcomp.diagnosis.conclusion import UNRECORDED, Conclusion
from rlgcomp.diagnosis.fitting.fit import Fitted, noise_model
from rlgcomp.diagnosis.naming.background import Background
from rlgcomp.diagnosis.naming.evidence import log_sum_exp
from rlgcomp.diagnosis.naming.explain import Explanations
from rlgcomp.diagnosis.noise.noises import Stated
from rlgcomp.diagnosis.noise.whitening import NoiseShape
from rlgcomp.diagnosis.proof.black_box import Mismatch
from rlgcomp.diagnosis.question.own_noise import Level, differing
from rlgcomp.diagnosis.question.problem import Problem
from rlgcomp.diagnosis.question.windows import Windows
from rlgcomp.diagnosis.result.phrases import p_text, span_text, sure_text
from rlgcomp.diagnosis.result.sentences import NEAREST
from rlgcomp.noise.processes import SLOW, NoiseModel
from rlgcomp.units import PPM, SECONDS_PER_HOUR

Array = npt.NDArray[np.float64]
_SLOW: Final = 1.3  # times the white noise, from which it is said that slow noise accounts for what is left;
_SLOWER: Final = 1.1  # where noise is stated, and slow noise is found that is
_AS_STATED: Final = 2.0  # times as strong
_AS_GOOD: Final = 3.0  # log units behind the likeliest noise, from which another explains as much
_TIMES: Final = 15  # correlation times that are tried, and sizes
_OTHERWISE: Final = 1.5  # times the white noise that is stated, or less than it by so much: neither measured so badly
_SIZES_APART: Final = 4.0  # from the likeliest, at most
_ONE_SIDE: Final = 0.05  # of a posterior, beyond either bound


def wanders(explanations: Explanations, conclusion: Conclusion, after: Fitted, noise: NoiseShape) -> list[str]:
    """What to say of something unrecorded: how much it wanders, how long it remembers, and how sure that is."""
    if conclusion.laws or conclusion.within or conclusion.unrecorded <= UNRECORDED:
        return []
    swing = f", part of it to and fro in about {noise.swing_s:g} s," if math.isfinite(noise.swing_s) else ""
    problem = explanations.evidence.problem
    design = np.column_stack([problem.baseline, *(one.columns for one in explanations.candidates(conclusion.model))])
    time = _about(*correlation_time_s(problem, design, noise))
    noise_deg_h2 = after.white_deg_h**2 * float(problem.rows.white.mean())
    near = any(one.mechanisms and one.probability > NEAREST for one in alternatives_of(explanations, conclusion))
    followed = (
        "for which no law was found" if near or conclusion.instead or conclusion.denied else "that no recorded column follows"
    )
    size = math.sqrt(max(float(np.var(after.residual_deg_h)) - noise_deg_h2, 0.0))
    what, size_text = "Something wanders", f"{size:.2g} deg/h"
    if noise.at_deg_s:
        what, size_text = (
            "The scale factor wanders with something",
            f"{size / (PPM * SECONDS_PER_HOUR * noise.at_deg_s):.2g} ppm",
        )
    said = (
        f"{what} {followed}, with standard deviation {size_text} in these runs and a "
        f"correlation time {time}{swing} (probability {sure_text(conclusion.wanders, 2)}): record more monitors."
    )
    return [said, *_unless_wrong(explanations, conclusion, after.white_deg_h)]


def as_noise(problem: Problem, after: Fitted, shape: NoiseShape) -> list[str]:
    """What to say where what is left passes for noise because slow noise does."""
    times = float(np.std(after.residual_deg_h / np.sqrt(problem.rows.white))) / after.white_deg_h
    found, stated = noise_model(shape, after.white_deg_h, problem.windows[0]), problem.simulator.noise
    nothing_stated = stated is None or Stated.of(stated, problem.windows[0].white_s) is None
    if times < (_SLOW if nothing_stated else _SLOWER):
        return []
    left = f"What is left, {times:.1f} times the white noise, passes for noise with {_slow_text(found)}"
    if stated is None or nothing_stated:
        return [f"{left}. If this gyro is known to be calmer at rest, give its noise (--noise): then something unrecorded wanders."]
    limits = {name: max(getattr(stated, name), limit) for name, limit in zip(SLOW, stated.at_most, strict=True)}
    if all(getattr(found, name) <= _AS_STATED * limit for name, limit in limits.items()):
        return []
    said = " and ".join(f"{'at most ' * bool(most)}{limits[name]:.2g}" for name, most in zip(SLOW, stated.at_most, strict=True))
    return [f"{left}; {said} are stated, but what there is looks like noise rather than something unrecorded."]


def _unless_wrong(explanations: Explanations, conclusion: Conclusion, white_deg_h: float) -> list[str]:
    """What to say where something wanders because the noise that is stated is believed: noise of another strength explains as
    much."""
    problem = explanations.evidence.problem
    if Stated.of(problem.simulator.noise, problem.windows[0].white_s) is None:
        return []
    noise_log = explanations.in_training(conclusion.model).noise_log - explanations.search.noise_log_prior
    best = int(np.argmax(np.where(explanations.ordinary, noise_log, -np.inf)))
    if noise_log[best] < noise_log.max() - _AS_GOOD:
        return []
    found = noise_model(explanations.evidence.noises[best], white_deg_h, problem.windows[0])
    return [f"That rests on the noise that is stated: {_slow_text(found)} would explain as much."]


def _slow_text(noise: NoiseModel) -> str:
    """How strong slow noise is."""
    return (
        f"bias instability {noise.bias_instability_deg_h:.2g} deg/h and rate random walk "
        f"{noise.rate_random_walk_deg_h_sqrt_h:.2g} deg/h/sqrt(h)"
    )


def correlation_time_s(problem: Problem, design: Array, noise: NoiseShape) -> tuple[float, float]:
    """How long what wanders beside a design remembers: bounds of nine tenths of its posterior, all times and sizes being as likely
    in their logarithms; zero and infinite where these runs set none."""
    longest = max(float(np.ptp(problem.rows.time_s[part])) for part in problem.rows.runs)
    times = np.geomspace(problem.rows.window_s, longest, _TIMES)
    sizes = noise.wander * np.geomspace(1.0 / _SIZES_APART, _SIZES_APART, _TIMES)
    tried = [dataclasses.replace(noise, wander=float(size), wander_s=float(time)) for time in times for size in sizes]
    logs = Background(problem, design, tried).log_evidence.reshape(_TIMES, -1)
    of_times = np.exp(log_sum_exp(logs) - log_sum_exp(logs.ravel()))
    below = np.cumsum(of_times) - 0.5 * of_times
    low, high = np.exp(np.interp([_ONE_SIDE, 1.0 - _ONE_SIDE], below, np.log(times)))
    return float(low if below[0] < _ONE_SIDE else 0.0), float(high if below[-1] > 1.0 - _ONE_SIDE else math.inf)


def _about(low_s: float, high_s: float) -> str:
    """Bounds of a time, in words.

    >>> _about(870.0, 2140.0), _about(0.0, 310.0), _about(5200.0, math.inf)
    ('between 900 and 2000 s', 'of 300 s or less', 'of 5000 s or more')
    """
    low, high = (f"{float(f'{time_s:.1g}'):g}" for time_s in (low_s, high_s))
    if low_s == 0.0 or high_s == math.inf:
        return f"of {high} s or less" if high_s < math.inf else f"of {low} s or more" if low_s else "that these runs do not tell"
    return f"of about {low} s" if low == high else f"between {low} and {high} s"


def other_noise(stated: NoiseModel | None, found: NoiseModel) -> tuple[str, ...]:
    """What to say where runs are plainly louder or calmer than the white noise that is stated."""
    if stated is None or not stated.angle_random_walk_deg_sqrt_h > 0.0:
        return ()
    times = found.angle_random_walk_deg_sqrt_h / stated.angle_random_walk_deg_sqrt_h
    if 1.0 / _OTHERWISE < times < _OTHERWISE:
        return ()
    return (
        f"An angle random walk of {stated.angle_random_walk_deg_sqrt_h:.2g} deg/sqrt(h) is stated; these runs show "
        f"{found.angle_random_walk_deg_sqrt_h:.2g}, by which they are weighed.",
    )


def weighed_means(model: NoiseModel, averaging_s: float) -> tuple[str, ...]:
    """What to say where means of windows are not plain, because the gyro's angle errs."""
    if model.quantization_arcsec == 0.0:
        return ()
    return (
        f"The gyro's angle errs by {model.quantization_arcsec:.2g} arcsec in each sample, as by rounding to pulses or dither "
        f"that is left: means of {averaging_s:g} s have weights that fall to zero at both ends, which are those of least variance.",
    )


def own_noises_of(mismatches: Sequence[Mismatch], white_deg_h: float) -> tuple[str, ...]:
    """What to say where runs, or parts of them, are weighed by a white noise of their own.

    Parameters
    ----------
    mismatches : sequence of Mismatch
    white_deg_h : float
        That of the middle run's windows.
    """
    said = []
    apart = [one for one in mismatches if one.windows.loudness != 1.0]
    if apart:
        p_value = differing([Level.of(one.windows, one.mismatch_deg_h) for one in mismatches])
        told = ", ".join(f"{one.run.name} {math.sqrt(one.windows.loudness):.2f} times" for one in apart)
        said.append(
            f"White noise differs between runs ({p_text(p_value)}): that of {told} the {white_deg_h:.2g} deg/h that means of "
            f"{apart[0].windows.window_s:g} s have in the middle one. Each run is weighed by its own."
        )
    told = "; ".join(f"{one.run.name} {times}" for one in mismatches if (times := _bursts_text(one.windows)))
    if told:
        said.append(
            f"White noise is not the same throughout a run: {told}. Each part is weighed by its own. Look at what shook or "
            "switched then."
        )
    return tuple(said)


def _bursts_text(windows: Windows) -> str:
    """Where a run is louder or quieter than elsewhere, and how many times; stretches that overlap are cut where they do."""
    loud = windows.bursting
    edges = np.r_[0, np.flatnonzero(np.diff(loud)) + 1, len(loud)]
    begins_s = windows.begins_s
    return ", ".join(
        f"{span_text(begins_s[first], begins_s[stop - 1] + windows.window_s)} {math.sqrt(loud[first]):.2g} times as loud"
        for first, stop in itertools.pairwise(edges.tolist())
        if loud[first] != 1.0
    )
