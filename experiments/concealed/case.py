"""What a case is: a simulator that lacks something, recordings of a gyro that has it, and what there was to find.

Strength of an effect = root mean square of the part of it that the simulator cannot absorb (residual of its window means over all
training runs, fitted by the simulator's columns and a bias) / standard deviation of the white noise of a window's mean. A window
is 100 s where a run takes some ten hours; a case stretches all times alike, and the gyro is as loud as its scale says.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import yaml

from experiments.concealed.chamber import WINDOW_S
from experiments.concealed.logger import Scale
from experiments.concealed.noise import Noise
from experiments.concealed.plan import Plan
from rlgcomp.files import write_json
from rlgcomp.recording import Recording
from rlgcomp.recording.formats import write

Array = npt.NDArray[np.float64]
Spans = tuple[tuple[float, float], ...]


@dataclasses.dataclass(frozen=True)
class Case:
    """One case.

    Parameters
    ----------
    plan : Plan
    simulator_mapping : mapping
        Content of the simulator file that lacks the hidden effects.
    train, test : tuple of Recording
    forms : tuple of str
        What was drawn of each hidden effect.
    intervals : mapping
        By hidden effect and training run, the (start_s, end_s) in which it acts, for effects that act in part of a run.
    drivers, memory :
        Of a law outside the catalogue; no drivers where they were not recorded.
    steps : tuple of (str, float)
        Run and time in s of each step of the bias.
    wrong : (str, str, float, float), optional
        Mechanism, parameter, true and stated value of the number that is stated as known and wrong.
    truth_held_out : tuple of ndarray
        The gyro in deg/h without noise and without what no run repeats, of each held-out run.
    signal_held_out : tuple of ndarray
        The same with what no run repeats.
    oracle : tuple of ndarray
        Prediction of the held-out runs by :mod:`experiments.concealed.observer`.
    samples : int
        In a window.
    white_deg_h : float
        Standard deviation of the white noise of a window's mean.
    noise : Noise
    scale : Scale
    log_bayes_factor : float
        For an observer who knows noise and forms, the smallest of all hidden effects and of steps or biases beside them.
    separation_nats : float
        Log-likelihood by which he prefers an effect to the best of simple rivals, the smallest of all hidden effects.
    """

    plan: Plan
    simulator_mapping: dict[str, Any]
    train: tuple[Recording, ...]
    test: tuple[Recording, ...]
    forms: tuple[str, ...]
    intervals: Mapping[str, tuple[Spans, ...]]
    drivers: tuple[str, ...]
    memory: str
    steps: tuple[tuple[str, float], ...]
    wrong: tuple[str, str, float, float] | None
    truth_held_out: tuple[Array, ...]
    signal_held_out: tuple[Array, ...]
    oracle: tuple[Array, ...]
    samples: int
    white_deg_h: float
    noise: Noise
    scale: Scale
    log_bayes_factor: float
    separation_nats: float

    @property
    def time(self) -> float:
        """How much longer times are than those of a chamber of hours."""
        return self.samples * self.scale.period_s / WINDOW_S

    def truth(self) -> dict[str, Any]:
        """What was hidden, as plain data."""
        fields = ("forms", "intervals", "drivers", "memory", "steps", "wrong", "samples", "white_deg_h", "log_bayes_factor")
        content = {name: getattr(self, name) for name in (*fields, "separation_nats")}
        noise = self.noise.to_mapping(self.time, self.white_deg_h)
        return dataclasses.asdict(self.plan) | dataclasses.asdict(self.scale) | {"noise": noise} | content


def means(values: Array, samples: int) -> Array:
    """Means over windows of so many samples, of a column or of several."""
    rows = len(values) // samples * samples
    return np.asarray(values[:rows].reshape(-1, samples, *values.shape[1:]).mean(axis=1))


def dump(case: Case, folder: Path) -> None:
    """Write a case as files for the command line: sim.yaml, the recordings, truth.json, and the held-out truth."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "sim.yaml").write_text(yaml.safe_dump(case.simulator_mapping, sort_keys=False), encoding="utf-8")
    for recording in (*case.train, *case.test):
        write(recording, folder / f"{recording.name}.parquet")
    series = {"truth_deg_h": case.truth_held_out, "oracle_deg_h": case.oracle}
    held_out = {
        key: {run.name: means(values, case.samples) for run, values in zip(case.test, of_runs, strict=True)}
        for key, of_runs in series.items()
    }
    write_json(folder / "truth.json", case.truth() | held_out)
