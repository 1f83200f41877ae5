"""A case on a turntable: a gyro that turns, whose simulator has a scale factor and a bias."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from experiments.concealed import observer, turntable
from experiments.concealed.case import Case, means
from experiments.concealed.chamber import WINDOW_S
from experiments.concealed.logger import Scale
from experiments.concealed.noise import Noise
from experiments.concealed.plan import Plan, stream

_PERIODS_S = (0.1, 10.0)  # with rates in proportion
_WHITE_DEG_H = (1e-3, 0.3)  # of a window's mean, at a period of 1 s


def turntable_case(plan: Plan) -> Case:
    """The case that is planned."""
    seed, rng = plan.seed, stream(plan.seed, "scale")
    period_s, white_deg_h = (math.exp(rng.uniform(*np.log(span))) for span in (_PERIODS_S, _WHITE_DEG_H))
    noise = Noise.draw(stream(seed, "noise"))
    counts = stream(seed, "runs").integers([2, 1], [4, 3])
    training = int(counts[0])
    runs = [f"run{k}" for k in range(int(counts.sum()))]
    turns = [turntable.Turn.draw(stream(seed, f"turn:{run}")) for run in runs]
    rates = [turn.rate_deg_s.mean(axis=1) for turn in turns]
    k_ppm, bias = stream(seed, "baseline").normal(0.0, [30.0, 10.0 * white_deg_h]).tolist()
    samples = round(WINDOW_S / turntable.SAMPLE_S)
    hidden = [turntable.EFFECTS[name](stream(seed, f"effect:{name}")) for name in plan.hidden]
    white_sample_deg_h = white_deg_h * math.sqrt(samples)
    sizes = [
        turntable.sized(effect, turns[:training], strength, white_sample_deg_h)
        for effect, strength in zip(hidden, plan.strengths, strict=True)
    ]
    errors = [
        sum((effect.error(turn, size) for effect, size in zip(hidden, sizes, strict=True)), np.zeros(len(rate)))
        for turn, rate in zip(turns, rates, strict=True)
    ]
    delay_s = sum(size for effect, size in zip(hidden, sizes, strict=True) if effect.delays)
    encoder = stream(seed, "encoder")  # of half of the tables it is perfect
    share = math.exp(encoder.uniform(math.log(0.2), math.log(1.5)))
    encoder_arcsec = share * white_sample_deg_h if encoder.random() < 0.5 else 0.0
    recordings, truth = [], []
    for turn, rate, error, run in zip(turns, rates, errors, runs, strict=True):
        gyro = turntable.ARCSEC * rate * (1.0 + 1e-6 * k_ppm) + bias + (0.0 if delay_s else error)
        noisy = gyro + white_deg_h * noise.simulate(len(gyro), turntable.SAMPLE_S, stream(seed, f"noise:{run}"))
        truth.append(gyro / period_s)
        sensors = stream(seed, f"sensors:{run}")
        recordings.append(turn.recording(noisy, sensors, name=run, delay_s=delay_s, encoder_arcsec=encoder_arcsec, time=period_s))
    seen = [np.asarray(run.column("table_rate_deg_s")) * period_s for run in recordings]
    designs = [
        np.column_stack([turntable.ARCSEC * rate, np.ones(len(rate)), *([error] if hidden else [])])
        for rate, error in zip(seen if delay_s else rates, errors, strict=True)
    ]
    windows = [means(design, samples) for design in designs]
    factors = observer.roots(noise, [len(block) for block in windows[:training]])
    targets = [means(run.column("gyro_deg_h") * period_s / white_deg_h, samples) for run in recordings[:training]]
    weights = white_deg_h * observer.amplitudes(factors, windows[:training], targets)
    return Case(
        plan=plan,
        simulator_mapping=_mapping(seed, k_ppm, bias / period_s, noise.to_mapping(period_s, white_deg_h / period_s)),
        train=tuple(recordings[:training]),
        test=tuple(recordings[training:]),
        forms=tuple(effect.form for effect in hidden),
        intervals={},
        drivers=(),
        memory="none",
        steps=(),
        wrong=None,
        truth_held_out=tuple(truth[training:]),
        signal_held_out=tuple(truth[training:]),
        oracle=tuple(design @ weights / period_s for design in designs[training:]),
        samples=samples,
        white_deg_h=white_deg_h / period_s,
        noise=noise,
        scale=Scale(period_s, math.sqrt(float(np.mean(np.concatenate(truth[:training]) ** 2)))),
        log_bayes_factor=_log_bayes_factor(plan, sum(map(len, rates[:training])) / samples),
        separation_nats=math.inf,
    )


def _mapping(seed: int, k_ppm: float, bias_deg_h: float, noise: dict[str, float]) -> dict[str, Any]:
    rng = stream(seed, "file")
    mapping: dict[str, Any] = {"kind": "turntable", "mechanisms": ["scale_factor"]}
    if rng.random() < 0.5:
        wrong = {"k_ppm": k_ppm * rng.uniform(0.2, 1.8), "bias_deg_h": bias_deg_h * rng.uniform(0.2, 1.8)}
        mapping["mechanisms"] = [{"scale_factor": {key: {"value": value, "free": True} for key, value in wrong.items()}}]
    return mapping | ({"noise": noise} if rng.random() < 0.2 else {})


def _log_bayes_factor(plan: Plan, windows: float) -> float:
    """Expected for the strength, as of a column orthogonal to the rest in white noise."""
    if not plan.strengths:
        return 0.0
    column = np.array([math.sqrt(windows)])
    return observer.log_bayes_factor(column, plan.strengths[0] * column)
