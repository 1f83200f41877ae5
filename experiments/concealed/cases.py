"""A case: a simulator that lacks something, recordings of a gyro that has it, and what there was to find.

Strength of an effect = standard deviation of the part of it that the simulator cannot absorb (residual of its 100 s means over both
training runs, fitted by the simulator's columns) / standard deviation of the white noise of a 100 s mean; or of all the noise of
the 100 s means of a run, flicker and random walk among it, which for half of the units is more.
"""

from __future__ import annotations

import dataclasses
import functools
import zlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np
import numpy.typing as npt
import yaml
from scipy import linalg

from experiments.concealed import turntable
from experiments.concealed.chamber import Chamber, Unit
from experiments.concealed.effects import DRIVERLESS, INDEPENDENT, OUTSIDE, Effect, catalogued
from experiments.concealed.noise import Noise, in_pulses
from experiments.concealed.operators import first_order
from rlgcomp.files import write_json
from rlgcomp.noise.processes import NoiseModel
from rlgcomp.physics import CATALOGUE
from rlgcomp.recording import Recording
from rlgcomp.recording.formats import write

Array = npt.NDArray[np.float64]
Kind = Literal["single", "pair", "triple", "null", "open", "driverless", "table", "unequal"]
NoiseOfUnits = Literal["drawn", "whole", "white"]
KINDS: tuple[Kind, ...] = ("single", "pair", "triple", "null", "open", "driverless", "table", "unequal")
MEAN_S = 100
_KIN_OF_LAG = {"temperature_rate", "thermal_gradient", "thermal_hysteresis"}
_DRAWS = 50
_STRONGER = 5.0  # the first of two unequal effects
TRAINING, HELD_OUT = ("run0", "run1"), ("run2", "run3")


@dataclasses.dataclass(frozen=True)
class Case:
    """One case.

    Parameters
    ----------
    simulator_mapping : mapping
        Content of the simulator file that lacks the hidden effects.
    hidden : tuple of str
        Mechanisms to be named; empty for a healthy gyro. Laws outside the catalogue bear their own names.
    strength : float
        Of each hidden effect.
    sizes : mapping
        True parameters by "mechanism.parameter", where the catalogue has a parameter that corresponds.
    intervals : mapping
        By hidden effect and training run, the (start_s, end_s) in which it acts, for effects that act in part of a run.
    drivers, memory :
        Of a law outside the catalogue; no drivers where they were not recorded.
    truth_held_out : tuple of ndarray
        The gyro without noise, of each held-out run.
    oracle : tuple of ndarray
        Prediction of the held-out runs by least squares on the training runs with the true law's columns.
    white_100_s_deg_h : float
        Standard deviation of the white noise of a 100 s mean.
    noise : mapping
        The unit's, as under `noise:` in a simulator file.
    repeats : bool
        Whether held-out runs repeat the hidden effects.
    information_nats : float
        What the training runs say for the weakest of the hidden effects: half the chi-square that it adds, the noise being known
        and all else fitted. With less than about five, nobody can name one effect among twenty.
    """

    name: str
    kind: Kind
    seed: int
    independent: bool
    simulator_mapping: dict[str, Any]
    train: tuple[Recording, ...]
    test: tuple[Recording, ...]
    hidden: tuple[str, ...]
    strength: float
    sizes: Mapping[str, float]
    intervals: Mapping[str, tuple[tuple[tuple[float, float], ...], ...]]
    drivers: tuple[str, ...]
    memory: str
    truth_held_out: tuple[Array, ...]
    oracle: tuple[Array, ...]
    white_100_s_deg_h: float
    noise: dict[str, float]
    repeats: bool
    information_nats: float

    def truth(self) -> dict[str, Any]:
        """What was hidden, as plain data."""
        left_out = {"simulator_mapping", "train", "test", "truth_held_out", "oracle"}
        kept = [field.name for field in dataclasses.fields(self) if field.name not in left_out]
        return {key: getattr(self, key) for key in kept}


def stream(seed: int, name: str) -> np.random.Generator:
    """Random numbers of a seed and a name."""
    return np.random.default_rng([seed, zlib.crc32(name.encode())])


def means(values: Array) -> Array:
    """Means over 100 s, of a column or of several."""
    rows = len(values) // MEAN_S * MEAN_S
    return np.asarray(values[:rows].reshape(-1, MEAN_S, *values.shape[1:]).mean(axis=1))


def make_case(
    kind: Kind,
    effects: Sequence[str],
    strength: float,
    seed: int,
    independent: bool,
    *,
    noise_of_units: NoiseOfUnits = "drawn",
    programmes: Mapping[str, str] | None = None,
) -> Case:
    """Make a case.

    Parameters
    ----------
    kind : {"single", "pair", "triple", "null", "open", "driverless", "table", "unequal"}
        On a turntable there is one effect or none, always of this experiment's own making. Of two unequal effects the first is five
        times as strong.
    effects : sequence of str
        Names in the catalogue, or of laws outside it (open); none for a healthy gyro.
    strength : float
        Of each of them.
    seed : int
    independent : bool
        Whether effects and noise are of this experiment's own making or rlgcomp's. Chamber and sensors always are its own.
    noise_of_units : {"drawn", "whole", "white"}
        White noise, and for half of the units flicker and random walk as well; the same, and strengths are relative to all noise of
        the 100 s means of a run about its mean, not to its white part alone; or white noise for all units. On a turntable it always
        is the first.
    programmes : mapping of str to str, optional
        Of the chamber, by run; random ones unless given.
    """
    if kind == "table":
        return _on_a_table(effects, strength, seed)
    unit = Unit.draw(stream(seed, "unit"))
    noise = Noise.draw(stream(seed, "noise"))
    if noise_of_units == "white":
        noise = Noise(noise.white)
    baseline = _baseline(stream(seed, "baseline"), effects)
    runs = (*TRAINING, *HELD_OUT)
    chambers = [unit.run(stream(seed, f"chamber:{run}"), (programmes or {}).get(run)) for run in runs]
    plain = _design(_absorbing(_known(baseline, chambers)))
    hidden = [_acting(name, seed, independent, chambers, plain) for name in effects]
    for effect in hidden:
        if effect.glitch is not None:
            chambers = [effect.glitch(chamber) for chamber in chambers]
    known = _known(baseline, chambers)
    absorbing = _absorbing(known)
    units = {
        effect.name: [
            effect.law(chamber, stream(seed, f"{effect.name}:{run}")) for chamber, run in zip(chambers, runs, strict=True)
        ]
        for effect in hidden
    }
    scale = {}
    design = _design(absorbing)
    windows = len(design) // len(TRAINING)
    noise_deg_h = noise.std_100_s_deg_h(windows) if noise_of_units == "whole" else noise.white_100_s_deg_h
    for effect in hidden:
        column = np.concatenate([means(values) for values in units[effect.name][: len(TRAINING)]])
        left = float(np.std(column - _project(design, column)))
        sign = stream(seed, f"sign:{effect.name}").choice([-1.0, 1.0])
        times = _STRONGER if kind == "unequal" and effect is hidden[0] else 1.0
        scale[effect.name] = float(sign * times * strength * noise_deg_h / left)
    weights = np.concatenate([part.weights for part in baseline])
    added = [sum((scale[name] * units[name][k] for name in scale), np.zeros(len(columns))) for k, columns in enumerate(known)]
    truth = [columns @ weights + extra for columns, extra in zip(known, added, strict=True)]
    missing = CATALOGUE[effects[0]].drivers if kind == "driverless" else ()
    recordings = []
    for k, (chamber, run) in enumerate(zip(chambers, runs, strict=True)):
        noisy = truth[k] + _noise(noise, len(truth[k]), seed, run, independent)
        recordings.append(unit.record(chamber, noisy, stream(seed, f"sensors:{run}"), without=missing, name=run))
    fitted = [
        np.column_stack([columns, *(units[effect.name][k] for effect in hidden if effect.repeats)])
        for k, columns in enumerate(absorbing)
    ]
    return Case(
        name=f"{kind}-{'+'.join(effects) or 'healthy'}-{strength:g}-{seed}{'' if independent else '-own'}",
        kind=kind,
        seed=seed,
        independent=independent,
        simulator_mapping=_mapping(baseline, noise, stream(seed, "file")),
        train=tuple(recordings[: len(TRAINING)]),
        test=tuple(recordings[len(TRAINING) :]),
        hidden=tuple(effect.name for effect in hidden),
        strength=strength,
        sizes=_sizes(hidden, scale),
        intervals={
            effect.name: tuple(_spans(effect.where(chamber), chamber.time_s) for chamber in chambers[: len(TRAINING)])
            for effect in hidden
            if effect.where is not None
        },
        drivers=hidden[0].drivers if kind == "open" else (),
        memory=hidden[0].memory if kind == "open" else "none",
        truth_held_out=tuple(truth[len(TRAINING) :]),
        oracle=_oracle(fitted, recordings, [scale[e.name] * units[e.name][k] for e in hidden if not e.repeats for k in range(2)]),
        white_100_s_deg_h=noise.white_100_s_deg_h,
        noise=noise.to_mapping(),
        repeats=all(effect.repeats for effect in hidden),
        information_nats=_information(noise, absorbing, [[scale[name] * values for values in units[name]] for name in units]),
    )


def _on_a_table(effects: Sequence[str], strength: float, seed: int) -> Case:
    """A gyro that turns, whose simulator has a scale factor and a bias."""
    noise = Noise.draw(stream(seed, "noise"))
    runs = (*TRAINING, *HELD_OUT)
    turns = [turntable.Turn.draw(stream(seed, f"turn:{run}")) for run in runs]
    rates = [turn.rate_deg_s.mean(axis=1) for turn in turns]
    k_ppm, bias = stream(seed, "baseline").normal(0.0, [30.0, 0.05]).tolist()
    white_1_s = 10.0 * noise.white_100_s_deg_h
    hidden = [turntable.EFFECTS[name](stream(seed, f"effect:{name}")) for name in effects]
    sizes = [turntable.sized(effect, turns[: len(TRAINING)], strength, white_1_s) for effect in hidden]
    added = [
        sum((effect.error(turn, size) for effect, size in zip(hidden, sizes, strict=True)), np.zeros(len(rate)))
        for turn, rate in zip(turns, rates, strict=True)
    ]
    delay_s = sum(size for effect, size in zip(hidden, sizes, strict=True) if effect.delays)
    encoder = stream(seed, "encoder")  # of half of the tables it is perfect
    encoder_arcsec = float(np.exp(encoder.uniform(np.log(0.003), np.log(0.05)))) if encoder.random() < 0.5 else 0.0
    recordings, truth = [], []
    for turn, rate, error, run in zip(turns, rates, added, runs, strict=True):
        gyro = 3600.0 * rate * (1.0 + 1e-6 * k_ppm) + bias + (0.0 if delay_s else error)
        noisy = gyro + noise.simulate(len(gyro), stream(seed, f"noise:{run}"))
        truth.append(gyro)
        sensors = stream(seed, f"sensors:{run}")
        recordings.append(turn.recording(noisy, sensors, name=run, delay_s=delay_s, encoder_arcsec=encoder_arcsec))
    fitted = [
        np.column_stack([3600.0 * rate, np.ones(len(rate)), *([error] if effects else [])])
        for rate, error in zip(rates, added, strict=True)
    ]
    rng = stream(seed, "file")
    mapping: dict[str, Any] = {"kind": "turntable", "mechanisms": ["scale_factor"]}
    if rng.random() < 0.5:
        wrong = {"k_ppm": k_ppm * rng.uniform(0.2, 1.8), "bias_deg_h": bias * rng.uniform(0.2, 1.8)}
        mapping["mechanisms"] = [{"scale_factor": {key: {"value": value, "free": True} for key, value in wrong.items()}}]
    if rng.random() < 0.3:
        mapping["noise"] = noise.to_mapping()
    return Case(
        name=f"table-{'+'.join(effects) or 'healthy'}-{strength:g}-{seed}",
        kind="table",
        seed=seed,
        independent=True,
        simulator_mapping=mapping,
        train=tuple(recordings[: len(TRAINING)]),
        test=tuple(recordings[len(TRAINING) :]),
        hidden=tuple(effects),
        strength=strength,
        sizes={f"{effect.name}.{effect.size}": size for effect, size in zip(hidden, sizes, strict=True) if effect.size},
        intervals={},
        drivers=(),
        memory="none",
        truth_held_out=tuple(truth[len(TRAINING) :]),
        oracle=_oracle(fitted, recordings, []),
        white_100_s_deg_h=noise.white_100_s_deg_h,
        noise=noise.to_mapping(),
        repeats=True,
        information_nats=0.5 * strength**2 * sum(map(len, rates[: len(TRAINING)])) / MEAN_S if effects else 0.0,
    )


def read_in_pulses(case: Case, pulse_arcsec: float) -> Case:
    """The same case with a gyro read in whole pulses; strengths stay those without."""

    def read(recording: Recording) -> Recording:
        rng = stream(case.seed, f"pulses:{recording.name}")
        pulses = in_pulses(recording.column("gyro_deg_h"), pulse_arcsec, rng)
        return recording.replace(table=recording.table.assign(gyro_deg_h=pulses))

    return dataclasses.replace(case, train=tuple(map(read, case.train)), test=tuple(map(read, case.test)))


def dump(case: Case, folder: Path) -> None:
    """Write a case as files for the command line: sim.yaml, the recordings, truth.json, and the held-out truth."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "sim.yaml").write_text(yaml.safe_dump(case.simulator_mapping, sort_keys=False), encoding="utf-8")
    for recording in (*case.train, *case.test):
        write(recording, folder / f"{recording.name}.parquet")
    held_out = {recording.name: means(values) for recording, values in zip(case.test, case.truth_held_out, strict=True)}
    oracle = {recording.name: means(values) for recording, values in zip(case.test, case.oracle, strict=True)}
    write_json(folder / "truth.json", case.truth() | {"truth_100_s_deg_h": held_out, "oracle_100_s_deg_h": oracle})


# --- the simulator that lacks something ----------------------------------------------------------------------------------------


@dataclasses.dataclass(frozen=True)
class Part:
    """A mechanism that the simulator has: its true columns, their weights, and the catalogue's names of them."""

    name: str
    parameters: tuple[str, ...]
    weights: Array
    columns: Any
    settings: Mapping[str, float] = dataclasses.field(default_factory=dict)
    wrong_shape: Mapping[str, float] = dataclasses.field(default_factory=dict)


def _baseline(rng: np.random.Generator, hidden: Sequence[str]) -> list[Part]:
    polynomial = Part(
        "thermal_polynomial",
        ("c0_deg_h", "c1_deg_h_K", "c2_deg_h_K2", "c3_deg_h_K3"),
        rng.normal(0.0, [0.02, 2e-4, 2e-6, 2e-8]),
        lambda c: np.vander(c.block - 20.0, 4, increasing=True),
        {"degree": 3},
    )
    lag_s = float(rng.uniform(600.0, 4000.0))
    others = [
        Part("temperature_rate", ("k_deg_h_min_K",), rng.normal(0.0, 0.01, 1), lambda c: c.rate_K_min[:, None]),
        Part(
            "thermal_gradient",
            ("k_deg_h_K",),
            rng.normal(0.0, 1e-3, 1),
            lambda c: (c.block - c["temperature_shell_degC"])[:, None],
        ),
        Part("light_intensity", ("k_deg_h_V",), rng.normal(0.0, 0.2, 1), lambda c: (c["light_intensity_V"] - 1.0)[:, None]),
        Part(
            "thermal_lag",
            ("k_deg_h_K",),
            rng.normal(0.0, 1e-3, 1),
            lambda c: (first_order(c.block, 1.0, lag_s) - c.block)[:, None],
            wrong_shape={"time_constant_s": lag_s},
        ),
    ]
    chosen = others[0] if rng.random() < 0.35 else others[int(rng.integers(1, 4))] if rng.random() < 0.3 else None
    if chosen is not None and chosen.name == "thermal_lag" and set(hidden) & _KIN_OF_LAG:
        chosen = None  # with a free time constant it leaves nothing by which these could be told apart
    parts = [part for part in (polynomial, chosen) if part is not None and part.name not in hidden]
    return parts or [next(part for part in others if part.name not in hidden)]


def _mapping(baseline: Sequence[Part], noise: Noise, rng: np.random.Generator) -> dict[str, Any]:
    wrong = bool(rng.random() < 0.5)
    listed: list[Any] = []
    for part in baseline:
        values: dict[str, Any] = dict(part.settings)
        if wrong:
            true = dict(zip(part.parameters, part.weights.tolist(), strict=True))
            values |= {key: {"value": value * rng.uniform(0.2, 1.8), "free": True} for key, value in true.items()}
            values |= {key: {"value": value * rng.uniform(0.5, 2.0), "free": True} for key, value in part.wrong_shape.items()}
        listed.append({part.name: values} if values else part.name)
    mapping: dict[str, Any] = {"kind": "chamber", "mechanisms": listed}
    if rng.random() < 0.3:
        mapping["noise"] = noise.to_mapping()
    return mapping


# --- pieces --------------------------------------------------------------------------------------------------------------------


def _acting(name: str, seed: int, independent: bool, chambers: Sequence[Chamber], design: Array) -> Effect:
    """An effect; drawn again where the training runs show nothing of it, as of a hop at a temperature that none reaches."""
    rng = stream(seed, f"effect:{name}")
    for _ in range(_DRAWS):
        effect = _effect(name, rng, independent)
        runs = zip(chambers, TRAINING, strict=False)
        shown = np.concatenate([means(effect.law(chamber, stream(seed, f"{name}:{run}"))) for chamber, run in runs])
        if np.std(shown - _project(design, shown)) > 1e-9 * np.abs(shown).max():
            return effect
    raise ValueError(f"{name}: none of {_DRAWS} draws acts in the training runs of seed {seed}")


def _known(baseline: Sequence[Part], chambers: Sequence[Chamber]) -> list[Array]:
    """Columns of what the simulator has, run by run."""
    return [np.column_stack([part.columns(chamber) for part in baseline]) for chamber in chambers]


def _absorbing(known: Sequence[Array]) -> list[Array]:
    """The same and a bias: every gyro has one, whatever its simulator lacks."""
    return [np.column_stack([columns, np.ones(len(columns))]) for columns in known]


def _design(known: Sequence[Array]) -> Array:
    """Their 100 s means over the training runs."""
    return np.vstack([means(columns) for columns in known[: len(TRAINING)]])


def _effect(name: str, rng: np.random.Generator, independent: bool) -> Effect:
    if name in OUTSIDE:
        return OUTSIDE[name](rng)
    return INDEPENDENT[name](rng) if independent else catalogued(name, rng)


def _noise(noise: Noise, samples: int, seed: int, run: str, independent: bool) -> Array:
    if independent:
        return noise.simulate(samples, stream(seed, f"noise:{run}"))
    made = NoiseModel(**noise.to_mapping()).simulate(samples, 1.0, zlib.crc32(f"{seed}:{run}".encode()))
    return np.asarray(functools.reduce(np.add, made.values()))


def _project(design: Array, target: Array) -> Array:
    size = np.maximum(np.linalg.norm(design, axis=0), 1e-300)
    solution, *_ = np.linalg.lstsq(design / size, target, rcond=None)
    return np.asarray(design / size @ solution)


def _oracle(fitted: Sequence[Array], recordings: Sequence[Recording], unrepeated: Sequence[Array]) -> tuple[Array, ...]:
    """Least squares on the training runs; what no run repeats is taken off them beforehand, as one who knows it would."""
    targets = [recording.column("gyro_deg_h") for recording in recordings[: len(TRAINING)]]
    for k, values in enumerate(unrepeated):
        targets[k % len(TRAINING)] = targets[k % len(TRAINING)] - values
    design = _design(fitted)
    size = np.maximum(np.linalg.norm(design, axis=0), 1e-300)
    solution, *_ = np.linalg.lstsq(design / size, np.concatenate([means(target) for target in targets]), rcond=None)
    return tuple(columns @ (solution / size) for columns in fitted[len(TRAINING) :])


def _information(noise: Noise, known: Sequence[Array], effects: Sequence[Sequence[Array]]) -> float:
    blocks = []
    for k in range(len(TRAINING)):
        rows = means(np.column_stack([known[k], *(effect[k] for effect in effects)]))
        blocks.append(linalg.solve_triangular(linalg.cholesky(noise.covariance(len(rows), MEAN_S), lower=True), rows, lower=True))
    whitened = np.vstack(blocks)
    first = whitened.shape[1] - len(effects)
    gains = [0.0] * (not effects)
    for j in range(first, whitened.shape[1]):
        left = whitened[:, j] - _project(np.delete(whitened, j, axis=1), whitened[:, j])
        gains.append(0.5 * float(left @ left))
    return min(gains)


def _sizes(hidden: Sequence[Effect], scale: Mapping[str, float]) -> dict[str, float]:
    sizes = {f"{effect.name}.{effect.size}": scale[effect.name] for effect in hidden if effect.size}
    sizes |= {key: abs(value) for key, value in sizes.items() if key == "random_telegraph.half_step_deg_h"}
    return sizes | {f"{effect.name}.{key}": value for effect in hidden for key, value in effect.shapes.items()}


def _spans(inside: npt.NDArray[np.bool_], time_s: Array) -> tuple[tuple[float, float], ...]:
    edges = np.flatnonzero(np.diff(np.r_[False, inside, False].astype(np.int8)))
    return tuple((float(time_s[a]), float(time_s[b - 1])) for a, b in zip(edges[::2], edges[1::2], strict=True))


# --- which cases ---------------------------------------------------------------------------------------------------------------

STRENGTHS: Mapping[Kind, tuple[float, ...]] = {
    "single": (1.0, 0.5, 0.25),
    "pair": (1.0, 0.5),
    "triple": (1.0,),
    "null": (0.0,),
    "open": (1.0, 2.0),
    "driverless": (1.0, 2.0),
    "table": (1.0, 0.5),
    "unequal": (1.0, 0.5),
}


def plan(kind: Kind, cases: int, first: int = 0) -> list[tuple[Kind, tuple[str, ...], float, int, bool]]:
    """Arguments of so many cases of a kind: every effect at every strength in turn, half of them independent."""
    chosen = []
    for number in range(first, first + cases):
        rng = stream(number, f"plan:{kind}")
        names: tuple[str, ...]
        independent = bool(number // len(INDEPENDENT) % 2 == 0)
        strength = STRENGTHS[kind][number % len(STRENGTHS[kind])]
        if kind == "null":
            names = ()
            independent = number % 2 == 0
        elif kind == "open":
            names = (list(OUTSIDE)[number % len(OUTSIDE)],)
        elif kind == "driverless":
            names = (DRIVERLESS[number % len(DRIVERLESS)],)
        elif kind == "table":
            names = (*([name] if (name := [*turntable.EFFECTS, ""][number % (len(turntable.EFFECTS) + 1)]) else []),)
            independent = True
        elif kind == "single":
            names = (list(INDEPENDENT)[number % len(INDEPENDENT)],)
        else:
            possible = [name for name in INDEPENDENT if name != "thermal_polynomial"]
            names = tuple(str(name) for name in rng.choice(possible, 3 if kind == "triple" else 2, replace=False))
            independent = number // 2 % 2 == 0
        chosen.append((kind, names, strength, 100_000 * (KINDS.index(kind) + 1) + number, independent))
    return chosen
