"""A chamber case: one unit in its chamber, effects of drawn forms, noise, a logger, and what could be known of it."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence

import numpy as np
import numpy.typing as npt

from experiments.concealed import baseline, nuisance, observer
from experiments.concealed.case import Case, Spans, means
from experiments.concealed.chamber import SUPPLIES, WINDOW_S, Chamber, Unit, swings_degC
from experiments.concealed.effects import BLOCK, CATALOGUED, OUTSIDE, Effect
from experiments.concealed.informed import Acting, Informed
from experiments.concealed.logger import Logger, Scale
from experiments.concealed.noise import Noise
from experiments.concealed.nuisance import Nuisance
from experiments.concealed.operators import Flags, first_order
from experiments.concealed.plan import Plan, stream

Array = npt.NDArray[np.float64]
_DRAWS = 60
_LEAST_SHOWN = 1e-6  # of an effect of unit size: relays that no run passes are a constant, and its rounding is no effect
_LEAST_LEFT = 0.1  # of an effect, that the simulator cannot absorb
_MOST_HELD_OUT = 6.0  # times as large as in the training runs
_LEAST_LOOP = 0.5  # of the unabsorbed part of a hysteresis, that no function of the temperature takes
_NOTHING = 1e-9
_HISTORIES = 32  # over which a prediction is averaged
_LAG_NATS = 1.0  # what the thermometers' lag may tell of a healthy gyro


@dataclasses.dataclass(frozen=True)
class Laboratory:
    """Programmes of the chamber by run, the number of runs for training, and the sample period before times are stretched."""

    programmes: Mapping[str, str]
    training: int
    step_s: float


@dataclasses.dataclass(frozen=True)
class Bench:
    """One unit in its chamber, run by run, the first of which are for training; and the simulator that it has."""

    seed: int
    runs: tuple[str, ...]
    training: int
    chambers: tuple[Chamber, ...]
    samples: int
    parts: list[baseline.Part]
    swings: bool  # between random temperatures before every run, which nobody recorded

    @classmethod
    def of(cls, plan: Plan, laboratory: Laboratory | None) -> Bench:
        rng = stream(plan.seed, "runs")
        training, held_out = int(rng.integers(2, 7)), int(rng.integers(1, 4))
        unit = Unit.draw(stream(plan.seed, "unit"))
        programmes: Mapping[str, str | None] = dict.fromkeys(f"run{k}" for k in range(training + held_out))
        if laboratory is not None:
            training, programmes = laboratory.training, laboratory.programmes
            unit = dataclasses.replace(unit, step_s=laboratory.step_s)
        chambers: list[Chamber] = []
        for run, programme in programmes.items():
            chambers.append(unit.run(stream(plan.seed, f"chamber:{run}"), programme, chambers[-1] if chambers else None))
        parts = baseline.draw(stream(plan.seed, "baseline"), plan.hidden)
        samples, swings = round(WINDOW_S / unit.step_s), unit.before == "cycles"
        return cls(plan.seed, tuple(programmes), training, tuple(chambers), samples, parts, swings)

    def means(self, blocks: Sequence[Array]) -> Array:
        """Window means of the training runs, one under the other."""
        return np.concatenate([means(block, self.samples) for block in blocks[: self.training]])

    def columns(self, chambers: Sequence[Chamber]) -> list[Array]:
        """What the simulator has and a bias, run by run."""
        return [baseline.with_bias(baseline.columns(self.parts, chamber)) for chamber in chambers]

    def acting(self, name: str, number: int, *, plain: bool) -> Effect:
        """An effect, drawn again where training runs show nothing of it; if it is to be plain, also where they show little."""
        rng = stream(self.seed, f"effect:{number}")
        design = self.means(self.columns(self.chambers))
        for _ in range(_DRAWS):
            effect = _effect(name, rng, self.chambers[: self.training])
            values = self.values(effect)
            shown, unseen = self.means(values), np.concatenate(values[self.training :])
            if np.std(shown) < _LEAST_SHOWN:
                continue
            remainder = observer.residual(design, shown)
            loop = remainder
            if effect.memory == "rate-independent":
                span = self.means([chamber.block[:, None] for chamber in self.chambers])[:, 0]
                curve = np.polynomial.chebyshev.chebvander((span - 10.0) / 60.0, 12)
                loop = observer.residual(np.column_stack([design, curve]), shown) if BLOCK in effect.drivers else remainder
            if (
                _rms(remainder) > _LEAST_LEFT * np.std(shown)
                and _rms(loop) >= _LEAST_LOOP * _rms(remainder)
                and np.std(unseen) < _MOST_HELD_OUT * np.std(shown)
            ) or (not plain and _rms(remainder) > _NOTHING * np.std(shown)):
                return effect
        raise ValueError(f"{name}: none of {_DRAWS} draws shows in the training runs of seed {self.seed}")

    def values(self, effect: Effect, chambers: Sequence[Chamber] | None = None) -> list[Array]:
        """Of unit size, run by run; of what no two runs repeat, the mean over the training runs is part of the bias."""
        found = [
            effect.law(chamber, stream(self.seed, f"{effect.name}:{run}"))
            for chamber, run in zip(chambers or self.chambers, self.runs, strict=True)
        ]
        mean = 0.0 if effect.repeats else float(self.means(found).mean())
        return [one - mean for one in found]

    def expected(self, effect: Effect, seen: Sequence[Chamber]) -> list[Array]:
        """Of unit size for one who has the readings, run by run: held out, the mean over what may have come before a run."""
        found = self.values(effect, seen)
        if not (self.swings and effect.memory == "rate-independent"):
            return found
        for k in range(self.training, len(found)):
            rng = stream(self.seed, f"before:{self.runs[k]}")
            possible = (dataclasses.replace(seen[k], history_degC=swings_degC(rng)) for _ in range(_HISTORIES))
            found[k] = np.mean([effect.law(chamber, rng) for chamber in possible], axis=0)
        return found


@dataclasses.dataclass(frozen=True)
class _Made:
    """The gyro over the white noise of a window's mean, run by run.

    Parameters
    ----------
    sizes : list of float
        Of each effect, over unit size.
    added : list of list of ndarray
        Each effect of its size.
    nuisance : Nuisance
    predictable : list of ndarray
        What the simulator has and what runs repeat.
    signals : list of ndarray
        All but noise.
    gyro : list of ndarray
    """

    sizes: list[float]
    added: list[list[Array]]
    nuisance: Nuisance
    predictable: list[Array]
    signals: list[Array]
    gyro: list[Array]

    @classmethod
    def of(cls, plan: Plan, bench: Bench, effects: Sequence[Effect], noise: Noise) -> _Made:
        columns = bench.columns(bench.chambers)
        design = bench.means(columns)
        sizes, added = [], []
        for number, (effect, strength) in enumerate(zip(effects, plan.strengths, strict=True)):
            unit = bench.values(effect)
            sign = stream(plan.seed, f"sign:{number}").choice([-1.0, 1.0])
            sizes.append(float(sign * strength / _rms(observer.residual(design, bench.means(unit)))))
            added.append([sizes[-1] * values for values in unit])
        times_s = [chamber.time_s for chamber in bench.chambers]
        unrelated = nuisance.draw(plan.nuisance, stream(plan.seed, "nuisance"), times_s, bench.training, bench.parts, design)
        weights = np.r_[np.concatenate([part.weights for part in bench.parts]), 0.0]
        predictable = [block @ weights for block in columns]
        signals = [one + error for one, error in zip(predictable, unrelated.error, strict=True)]
        for effect, values in zip(effects, added, strict=True):
            signals = [one + value for one, value in zip(signals, values, strict=True)]
            if effect.repeats:
                predictable = [one + value for one, value in zip(predictable, values, strict=True)]
        gyro = [
            signal + noise.simulate(len(signal), chamber.step_s, stream(plan.seed, f"noise:{run}"))
            for signal, chamber, run in zip(signals, bench.chambers, bench.runs, strict=True)
        ]
        return cls(sizes, added, unrelated, predictable, signals, gyro)


def chamber_case(plan: Plan, *, laboratory: Laboratory | None = None, scale: Scale | None = None) -> Case:
    """The case that is planned.

    Parameters
    ----------
    plan : Plan
    laboratory : Laboratory, optional
        Random programmes unless given, each of which shows every effect.
    scale : Scale, optional
        Drawn unless given.
    """
    bench = Bench.of(plan, laboratory)
    bench = dataclasses.replace(bench, parts=identifiable_parts(bench, stream(plan.seed, "lag")))
    effects = [bench.acting(name, number, plain=laboratory is None) for number, name in enumerate(plan.hidden)]
    if plan.kind == "unrecorded":
        (driver,) = effects[0].drivers
        correlation_s = SUPPLIES[driver][2]
        effects = [dataclasses.replace(effects[0], correlation=lambda apart_s: np.exp(-apart_s / correlation_s))]
    needed = {driver for part in bench.parts for driver in part.drivers}
    needed |= {driver for effect in effects for driver in effect.drivers if plan.kind != "unrecorded"}
    absent = effects[0].drivers if plan.kind == "unrecorded" else ()
    logger = Logger.draw(stream(plan.seed, "logger"), bench.chambers[: bench.training], needed, absent)

    noise = Noise.draw(stream(plan.seed, "noise"))
    made = _Made.of(plan, bench, effects, noise)
    scale = scale or Scale.draw(stream(plan.seed, "scale"))
    time = scale.period_s / bench.chambers[0].step_s
    rate_deg_h = scale.size_deg_h / _rms(np.concatenate(made.gyro[: bench.training]))
    if (wrong := _stated(bench, made.nuisance.wrong, time, rate_deg_h)) is not None:
        quieter = min(1.0, baseline.largest(*wrong[:2]) / abs(wrong[3]))
        rate_deg_h, scale = quieter * rate_deg_h, dataclasses.replace(scale, size_deg_h=quieter * scale.size_deg_h)
        wrong = _stated(bench, made.nuisance.wrong, time, rate_deg_h)
    readings = [
        logger.readings(chamber, stream(plan.seed, f"sensors:{run}"))
        for chamber, run in zip(bench.chambers, bench.runs, strict=True)
    ]
    recordings = [
        logger.recording(read, rate_deg_h * values, scale.period_s, run)
        for read, values, run in zip(readings, made.gyro, bench.runs, strict=True)
    ]
    seen = [logger.reconstructed(chamber, read) for chamber, read in zip(bench.chambers, readings, strict=True)]
    acting = []
    for effect, strength, size, values in zip(effects, plan.strengths, made.sizes, made.added, strict=True):
        variance = float(np.var(bench.means(values)))
        process = None if effect.correlation is None else (variance, effect.correlation)
        acting.append(Acting(effect, strength, [size * one for one in bench.expected(effect, seen)], process))
    beside = made.nuisance
    informed = Informed(
        noise,
        bench.samples,
        bench.training,
        seen,
        logger.absent,
        bench.columns(seen),
        beside.columns,
        beside.error,
        acting,
        made.gyro,
    )
    outside = plan.kind == "outside"
    return Case(
        plan=plan,
        simulator_mapping=baseline.to_mapping(
            bench.parts, stream(plan.seed, "file"), time=time, rate_deg_h=rate_deg_h, wrong=made.nuisance.wrong
        )
        | ({"noise": noise.to_mapping(time, rate_deg_h)} if stream(plan.seed, "stated noise").random() < 0.2 else {}),
        train=tuple(recordings[: bench.training]),
        test=tuple(recordings[bench.training :]),
        forms=tuple(effect.form for effect in effects),
        intervals={
            effect.name: tuple(_spans(effect.where(chamber), time * chamber.time_s) for chamber in bench.chambers[: bench.training])
            for effect in effects
            if effect.where is not None
        },
        drivers=effects[0].drivers if outside else (),
        memory=effects[0].memory if outside else "none",
        steps=tuple((bench.runs[k], time * at_s) for k, at_s in made.nuisance.steps),
        wrong=wrong,
        truth_held_out=tuple(rate_deg_h * one for one in made.predictable[bench.training :]),
        signal_held_out=tuple(rate_deg_h * one for one in made.signals[bench.training :]),
        oracle=tuple(rate_deg_h * one for one in informed.oracle()),
        samples=bench.samples,
        white_deg_h=rate_deg_h,
        noise=noise,
        scale=scale,
        log_bayes_factor=min(informed.log_bayes_factor(), informed.log_bayes_factor_beside()),
        separation_nats=informed.separation(),
    )


# --- pieces --------------------------------------------------------------------------------------------------------------------


def _stated(
    bench: Bench, wrong: tuple[str, str, float] | None, time: float, rate_deg_h: float
) -> tuple[str, str, float, float] | None:
    if wrong is None:
        return None
    mechanism, parameter, by = wrong
    part = next(part for part in bench.parts if part.name == mechanism)
    unit, weight = rate_deg_h * time**part.power, float(part.weights[part.parameters.index(parameter)])
    return mechanism, parameter, unit * weight, unit * (weight + by)


def _effect(name: str, rng: np.random.Generator, training: Sequence[Chamber]) -> Effect:
    return {**CATALOGUED, **OUTSIDE}[name](rng, training)


def identifiable_parts(bench: Bench, rng: np.random.Generator) -> list[baseline.Part]:
    """The simulator made so weak that the lag of a thermometer tells next to nothing: else a healthy gyro would have a rate."""
    lag_s = 25.0 * rng.uniform(0.5, 1.0)
    late = [
        chamber.with_monitors(
            {c: first_order(v, chamber.step_s, lag_s) for c, v in chamber.monitors.items() if c.startswith("temp")}
        )
        for chamber in bench.chambers[: bench.training]
    ]
    weights = np.r_[np.concatenate([part.weights for part in bench.parts]), 0.0]
    prompt, read = bench.columns(bench.chambers[: bench.training]), bench.columns(late)
    remainder = observer.residual(bench.means(read), bench.means([block @ weights for block in prompt]))
    factor = min(1.0, math.sqrt(_LAG_NATS / max(0.5 * float(remainder @ remainder), 1e-12)))
    return [dataclasses.replace(part, weights=factor * part.weights) for part in bench.parts]


def _rms(values: Array) -> float:
    return math.sqrt(float(np.mean(values**2)))


def _spans(inside: Flags, time_s: Array) -> Spans:
    edges = np.flatnonzero(np.diff(np.r_[False, inside, False].astype(np.int8)))
    return tuple((float(time_s[a]), float(time_s[b - 1])) for a, b in zip(edges[::2], edges[1::2], strict=True))
