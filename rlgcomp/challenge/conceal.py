"""Challenges: recordings of a gyro with an effect that its simulator file lacks. :mod:`rlgcomp.challenge.seal` writes them."""

from __future__ import annotations

import dataclasses
import functools
import math
import secrets
from collections.abc import Mapping, Sequence
from typing import Any, Final, Self

import numpy as np
import pandas as pd

from rlgcomp.challenge.injection import SHARE, Array, Projection, drawn, scaled, strongest_intervals
from rlgcomp.challenge.score import Hidden
from rlgcomp.errors import InputError
from rlgcomp.noise.processes import NOISES, stream
from rlgcomp.physics import CATALOGUE
from rlgcomp.physics.mechanism import Mechanism
from rlgcomp.recording import Recording
from rlgcomp.report.messages import Message, message
from rlgcomp.simulation.simulator import TYPICAL_NOISE, Simulator

RANDOM: Final = "random"
NOTHING: Final = "none"
USUAL_STRENGTH: Final = 1.0
RUNS: Final = ("train0", "train1", "test0", "test1")
TRAINING: Final = 2
PROGRAMMES: Final = {
    "chamber": ("paper", "reversed", "minor-loops", "slow"),
    "turntable": ("rates", "other-rates", "sweeps", "slow-turns"),
}
_SPREAD: Final = 0.3  # logarithm of the file's free parameters, about their values
_HOW_MANY: Final = (0.2, 0.55, 0.25)  # chances that "random" hides nothing, one, two
_DRAWS: Final = 20
_PASSES: Final = 5  # at most, until the size is near enough
_NEAR: Final = 0.01
_LARGE: Final = 5.0  # times the usual size
_AVERAGING: Final = (0.125, 0.25, 0.5, 2.0, 4.0, 8.0)  # of the windows: a diagnosis may have others,
_MOST_AVERAGED: Final = 0.1  # up to so much of a run
_HARDLY_ANY: Final = 0.1  # share of an effect that the simulator does not absorb
_SEED_BYTES: Final = 16  # more than can be tried


@dataclasses.dataclass(frozen=True)
class Challenge:
    """A challenge and its answer.

    Parameters
    ----------
    simulator : Simulator
        Without the hidden causes.
    train, test : tuple of Recording
        Held-out runs follow other programmes.
    hidden : Hidden
    mechanisms : tuple of Mechanism
        The hidden causes as they acted.
    strengths : mapping of str to float
        Of each: the part that the simulator cannot absorb over the white noise of a window mean.
    possible_rms_deg_h : float
        Residual of the true law in window means of the held-out runs: noise, and effects that differ from run to run.
    possible_by_averaging_s : mapping of float to float
        The same in means over shorter and longer times.
    seed : int
        Of all its random streams: whoever knows it can make the challenge again, and so open it.
    remarks : tuple of Message
        On hidden causes far above their usual size; empty where they were chosen at random.
    """

    simulator: Simulator
    train: tuple[Recording, ...]
    test: tuple[Recording, ...]
    hidden: Hidden
    mechanisms: tuple[Mechanism, ...]
    strengths: Mapping[str, float]
    possible_rms_deg_h: float
    possible_by_averaging_s: Mapping[float, float]
    seed: int
    remarks: tuple[Message, ...] = ()


def conceal(
    simulator: Simulator,
    hide: str = RANDOM,
    *,
    seed: int | None = None,
    strength: float | None = None,
    step_s: float = 1.0,
    catalogue: Mapping[str, type[Mechanism]] = CATALOGUE,
) -> Challenge:
    """Make a challenge.

    The simulator's free parameters are drawn anew, about 30 % from their values, so that its numbers are wrong as well.

    Parameters
    ----------
    simulator : Simulator
    hide : str
        A mechanism, or several joined by commas. One that the simulator has is taken out of it; one that it lacks acts in the
        recordings. "random": nothing, one or two of them; "none": nothing, a healthy gyro.
    seed : int, optional
        The same seed gives the same challenge, to whoever knows or guesses it. By default a secret one is drawn.
    strength : float, optional
        Of each hidden cause. By default 1 for those that the simulator lacks, and for the others the size that they have there.
    step_s : float
        Sample period of the recordings.
    catalogue : mapping of str to type
        Mechanisms that may be hidden.

    Raises
    ------
    InputError
        The name is not in the catalogue or of the other kind, or the effect cannot be made that strong.
    """
    if strength is not None and not 0.0 < strength < math.inf:
        raise InputError(f"strength is {strength}; it must be positive")
    seed = secrets.randbits(8 * _SEED_BYTES) if seed is None else seed
    rng = stream(seed, "conceal")
    names = _chosen(simulator, hide, rng, catalogue)
    own = {mechanism.name: mechanism for mechanism in simulator.mechanisms}
    lacking = functools.reduce(Simulator.without, [name for name in names if name in own], simulator)
    remarks: list[Message] = []
    bench = _Bench.of(lacking, _moved(simulator, rng), rng, step_s)
    for name in names:
        if name not in own or strength is not None:
            known = next((mechanism for mechanism in bench.gyro.mechanisms if mechanism.name == name), None)
            sized = _sized(known, catalogue[name], bench, strength or USUAL_STRENGTH)
            bench = dataclasses.replace(bench, gyro=bench.gyro.with_mechanism(sized))
            if hide != RANDOM:  # a remark would reveal a random choice
                remarks += _size_remarks(sized, bench)
    mechanisms = tuple(mechanism for mechanism in bench.gyro.mechanisms if mechanism.name in names)
    effects = {mechanism.name: bench.unabsorbed(mechanism) for mechanism in mechanisms}
    runs = bench.stand.record(bench.gyro, RUNS)
    window_s, shortest_s = bench.projection.window_s, min(run.duration_s for run in runs[TRAINING:])
    windows_s = [time_s for factor in _AVERAGING if step_s <= (time_s := factor * window_s) <= _MOST_AVERAGED * shortest_s]
    possible = {time_s: _possible_rms_deg_h(runs[TRAINING:], mechanisms, time_s) for time_s in {window_s, *windows_s}}
    return Challenge(
        simulator=lacking,
        train=tuple(_bare(run) for run in runs[:TRAINING]),
        test=tuple(_bare(run) for run in runs[TRAINING:]),
        hidden=Hidden(
            tuple(mechanism.name for mechanism in mechanisms),
            {f"{m.name}.{key}": float(value) for m in mechanisms for key, value in _estimable(m).items()},
            strongest_intervals(bench.projection, np.sum(list(effects.values()), axis=0)) if mechanisms else {},
        ),
        mechanisms=mechanisms,
        strengths={name: float(np.std(values)) / bench.white_deg_h for name, values in effects.items()},
        possible_rms_deg_h=possible[window_s],
        possible_by_averaging_s=dict(sorted(possible.items())),
        seed=seed,
        remarks=tuple(remarks),
    )


def lacking(simulator: Simulator, name: str, *, seed: int = 0) -> Simulator:
    """A simulator without one of its mechanisms, the amplitudes of the others free and about 30 % wrong, noise to be estimated.

    Parameters
    ----------
    simulator : Simulator
    name : str
        Of the mechanism that is left out.
    seed : int
        Of the changes of the amplitudes.

    Raises
    ------
    InputError
        The simulator has no such mechanism.
    """
    others = simulator.without(name)
    free = {m.name: frozenset(parameter.name for parameter in m.amplitude_parameters()) for m in others.mechanisms}
    return _moved(dataclasses.replace(others, free=free, noise=None), stream(seed, "lacking"))


@dataclasses.dataclass(frozen=True)
class _Stand:
    """Programmes and seeds of the runs of a challenge."""

    programmes: tuple[str, ...]
    seeds: tuple[int, ...]
    step_s: float

    def record(self, gyro: Simulator, names: Sequence[str]) -> list[Recording]:
        each = zip(self.programmes, self.seeds, names, strict=False)
        return [gyro.simulate(programme, seed=seed, step_s=self.step_s, name=name) for programme, seed, name in each]


@dataclasses.dataclass(frozen=True)
class _Bench:
    """The gyro, its runs, and what the simulator without the hidden causes absorbs in its training runs."""

    gyro: Simulator
    stand: _Stand
    projection: Projection
    rng: np.random.Generator

    @classmethod
    def of(cls, lacking: Simulator, gyro: Simulator, rng: np.random.Generator, step_s: float) -> Self:
        programmes = tuple(str(name) for name in rng.permutation(PROGRAMMES[gyro.kind]))
        stand = _Stand(programmes, tuple(int.from_bytes(rng.bytes(_SEED_BYTES)) for _ in RUNS), step_s)
        return cls(gyro, stand, Projection.of(lacking, stand.record(gyro, RUNS[:TRAINING])), rng)

    def unabsorbed(self, mechanism: Mechanism) -> Array:
        """Part of a mechanism's error that the simulator cannot absorb, in window means of the training runs."""
        runs = self.stand.record(self.gyro.with_mechanism(mechanism), RUNS[:TRAINING])
        return self.projection.unabsorbed([_acting(run, mechanism.name) for run in runs])

    @property
    def white_deg_h(self) -> float:
        noise = self.gyro.noise or TYPICAL_NOISE
        white = 60.0 * noise.angle_random_walk_deg_sqrt_h / math.sqrt(self.projection.window_s)
        if white <= 0.0:
            raise InputError(
                "the simulator's noise has no angle_random_walk_deg_sqrt_h, to which a strength is a ratio; give it one"
            )
        return white


# --- the hidden causes ------------------------------------------------------------------------------------------------------------


def _chosen(simulator: Simulator, hide: str, rng: np.random.Generator, catalogue: Mapping[str, type[Mechanism]]) -> list[str]:
    if hide == NOTHING:
        return []
    allowed = [name for name, form in catalogue.items() if form.is_candidate(simulator.kind)]
    if hide == RANDOM:
        taken = [name for name in allowed if len(simulator.mechanisms) > 1 or name not in _names(simulator)]
        count = int(rng.choice(len(_HOW_MANY), p=_HOW_MANY))
        return sorted(str(name) for name in rng.choice(taken, count, replace=False))
    names = [name.strip() for name in hide.split(",")]
    unknown = [name for name in names if name not in allowed]
    if unknown or len(set(names)) < len(names):
        raise InputError(
            f"cannot hide {hide!r}: give 'random', 'none', or names from the catalogue of kind {simulator.kind!r}, each once: "
            f"{', '.join(allowed)}"
        )
    return sorted(names)


def _names(simulator: Simulator) -> list[str]:
    return [mechanism.name for mechanism in simulator.mechanisms]


def _moved(simulator: Simulator, rng: np.random.Generator) -> Simulator:
    for mechanism in simulator.mechanisms:
        free = simulator.free.get(mechanism.name, frozenset())
        values = {
            p.name: min(max(getattr(mechanism, p.name) * math.exp(_SPREAD * rng.standard_normal()), p.low), p.high)
            for p in mechanism.parameters()
            if p.name in free and p.unit != SHARE
        }
        simulator = simulator.with_mechanism(dataclasses.replace(mechanism, **values))  # type: ignore[type-var]
    return simulator


def _sized(known: Mechanism | None, form: type[Mechanism], bench: _Bench, strength: float) -> Mechanism:
    """A mechanism of the required strength: as the simulator has it, or with random nonlinear parameters."""
    why, required_deg_h = "", strength * bench.white_deg_h
    for _ in range(1 if known else _DRAWS):
        mechanism = known or drawn(form, bench.projection.recordings, bench.rng, bench.projection.window_s)
        try:
            for _ in range(_PASSES):
                rms_deg_h = max(float(np.std(bench.unabsorbed(mechanism))), np.finfo(float).tiny)
                mechanism = scaled(mechanism, required_deg_h / rms_deg_h)
                if abs(required_deg_h / rms_deg_h - 1.0) < _NEAR:
                    break
        except InputError as error:
            why = str(error)
        else:
            return mechanism
    raise InputError(f"{form.name} cannot be hidden with strength {strength:g}: {why}; choose a smaller strength or another cause")


def _size_remarks(mechanism: Mechanism, bench: _Bench) -> list[Message]:
    """A remark where an effect had to be made far larger than usual, and whether that is because the simulator absorbs it."""
    ratios = [abs(getattr(mechanism, p.name) / p.typical) for p in mechanism.amplitude_parameters() if p.typical]
    if not ratios or (ratio := float(np.median(ratios))) <= _LARGE:
        return []
    runs = bench.stand.record(bench.gyro.with_mechanism(mechanism), RUNS[:TRAINING])
    whole = float(np.std(np.concatenate([_acting(run, mechanism.name) for run in runs])))
    if float(np.std(bench.unabsorbed(mechanism))) > _HARDLY_ANY * whole:
        return [message("challenge.far_above_usual_size", mechanism=mechanism.name, ratio=ratio)]
    return [message("challenge.absorbed_by_the_simulator", mechanism=mechanism.name, ratio=ratio)]


def _acting(run: Recording, name: str) -> Array:
    truth = run.truth
    return np.zeros(len(run)) if truth is None or name not in truth else truth[name].to_numpy(dtype=np.float64)


def _possible_rms_deg_h(runs: Sequence[Recording], mechanisms: Sequence[Mechanism], window_s: float) -> float:
    names = [*NOISES, *(mechanism.name for mechanism in mechanisms if not mechanism.repeats())]
    errors = [sum((_acting(run, name) for name in names), np.zeros(len(run))) for run in runs]
    means = [
        run.averaged(window_s, extra=pd.DataFrame({"error": values})).column("error")
        for run, values in zip(runs, errors, strict=True)
    ]
    return float(np.sqrt(np.mean(np.concatenate(means) ** 2)))


def _bare(run: Recording) -> Recording:
    """The recording without truth, seed and programme."""
    metadata = dataclasses.replace(run.metadata, notes={})
    return run.replace(truth=None, metadata=metadata)


def _estimable(mechanism: Mechanism) -> dict[str, Any]:
    return {p.name: getattr(mechanism, p.name) for p in (*mechanism.amplitude_parameters(), *mechanism.shape_parameters())}
