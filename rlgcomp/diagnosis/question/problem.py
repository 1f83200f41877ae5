"""What is to be explained: window means of recordings less what the simulator says for certain, and the columns it leaves free."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from typing import Final, Self

import numpy as np
import numpy.typing as npt

from rlgcomp.diagnosis.noise.whitening import Rows
from rlgcomp.diagnosis.question import free_part
from rlgcomp.diagnosis.question.contrasts import Contrasts
from rlgcomp.diagnosis.question.departures import departures_deg_h, not_comparable
from rlgcomp.diagnosis.question.events import BiasStep, Partly
from rlgcomp.diagnosis.question.free_part import free, stated, where_free
from rlgcomp.diagnosis.question.own_noise import beside, with_own_noise, with_rounding
from rlgcomp.diagnosis.question.pulses import step_of
from rlgcomp.diagnosis.question.shapes import shifted
from rlgcomp.diagnosis.question.windows import Windows, default_window_s, turning_deg_s, with_knee
from rlgcomp.errors import InputError
from rlgcomp.physics import CATALOGUE
from rlgcomp.physics.empirical_law import EmpiricalLaw
from rlgcomp.physics.mechanism import Mechanism
from rlgcomp.recording import TIME, Recording
from rlgcomp.simulation.simulator import Simulator

Array = npt.NDArray[np.float64]
_SWEEPS: Final = 3  # over mechanisms whose shapes are free, each beside the others


@dataclasses.dataclass(frozen=True)
class Problem:
    """What is to be explained.

    Parameters
    ----------
    windows : tuple of Windows
        One a run.
    rows : Rows
        Time, run and white variance of each row; n rows.
    target_deg_h : ndarray, shape (n,)
        Window means of the gyro less the simulator's fixed part.
    baseline : ndarray, shape (n, p)
        Columns of what is free in the simulator: amplitudes, and derivatives by shapes at their calibrated values.
    simulator : Simulator
        With its free shapes calibrated.
    channel : str
        The gyro column.
    unexplained_deg_h : tuple of ndarray
        Of each run at its full rate: the gyro less the simulator's fixed part.
    contrasts : Contrasts, optional
        Where causes act within windows as well, as on a turning table: further rows that compare samples within windows.
    held_out : int
        So many runs at the end are held out: no shape is calibrated to them.
    own_biases : bool
        Each training run has a bias of its own, as a gyro has after every switch-on.
    offsets : bool
        Each held-out run has one.
    beside : tuple of Mechanism
        Causes beside which the simulator's free shapes are calibrated.
    laws : tuple of EmpiricalLaw
        Laws that count as part of the simulator, free as far as a straight line goes: amplitudes, and derivatives by shapes.
    steps : tuple of BiasStep
        Steps of the bias, each free.
    partly : tuple of Partly
        Causes that act in a part of the training runs, each free there, and in each held-out run by itself.
    """

    windows: tuple[Windows, ...]
    rows: Rows
    target_deg_h: Array
    baseline: Array
    baseline_names: tuple[tuple[str, str], ...]
    simulator: Simulator
    channel: str
    unexplained_deg_h: tuple[Array, ...]
    contrasts: Contrasts | None = None
    held_out: int = 0
    own_biases: bool = False
    offsets: bool = True
    beside: tuple[Mechanism, ...] = ()
    laws: tuple[EmpiricalLaw, ...] = ()
    steps: tuple[BiasStep, ...] = ()
    partly: tuple[Partly, ...] = ()

    @classmethod
    def of(
        cls,
        simulator: Simulator,
        runs: Sequence[Recording],
        *,
        gyro: str | None = None,
        window_s: float | None = None,
        predicted: Callable[[Recording], Array] | None = None,
    ) -> Self:
        """The problem that runs pose to a simulator.

        Parameters
        ----------
        simulator : Simulator
        runs : sequence of Recording
        gyro : str, optional
            Column, where a run has several.
        window_s : float, optional
            Averaging time; 100 s, less for runs too short for it.
        predicted : callable, optional
            Further prediction in deg/h that is subtracted: the user's own simulator.

        Raises
        ------
        InputError
            A run is too short, or lacks a column that the simulator reads.
        """
        if not runs:
            raise InputError("no training runs; give at least one with --train")
        window_s = default_window_s(runs) if window_s is None else window_s
        windows = tuple(
            Windows.of(run, window_s, 0.0, not_comparable(simulator, run, predicted), step_of(run, gyro)) for run in runs
        )
        informed = tuple(mechanism.conditioned_on(runs) for mechanism in simulator.mechanisms)
        simulator = dataclasses.replace(simulator, mechanisms=informed).with_own_amplitudes_free()
        departures = departures_deg_h(simulator, windows, gyro, predicted)
        if simulator.kind == "chamber":
            windows = with_own_noise(with_knee(windows, departures), departures)
        elif predicted is None:
            windows = with_rounding(windows, departures)
        return cls._posed(simulator, windows, departures, runs[0].gyro_column(gyro)).with_free_part()

    @classmethod
    def _posed(cls, simulator: Simulator, windows: tuple[Windows, ...], unexplained_deg_h: tuple[Array, ...], channel: str) -> Self:
        """The problem without columns of what is free."""
        window_s = windows[0].window_s
        target = np.concatenate([part.means(values) for part, values in zip(windows, unexplained_deg_h, strict=True)])
        rows = Rows(
            np.concatenate([part.middles_s for part in windows]),
            np.repeat(np.arange(len(windows)), [int(part.kept.sum()) for part in windows]),
            np.concatenate([part.white for part in windows]),
            window_s,
            rate_deg_s=turning_deg_s(simulator.kind, windows),
        )
        return cls(windows, rows, target, np.empty((len(rows), 0)), (), simulator, channel, unexplained_deg_h)

    def joined(
        self, runs: Sequence[Recording], *, gyro: str | None = None, predicted: Callable[[Recording], Array] | None = None
    ) -> Self:
        """The problem that further runs pose beside these, each with an offset of its own; shapes stay as they were calibrated.

        Parameters
        ----------
        runs : sequence of Recording
        gyro, predicted
            As in :meth:`of`.

        Raises
        ------
        InputError
            As :meth:`of` does.
        """
        window_s, knee_s = self.rows.window_s, self.windows[0].knee_s
        more = tuple(
            Windows.of(run, window_s, knee_s, not_comparable(self.simulator, run, predicted), step_of(run, gyro)) for run in runs
        )
        departures = departures_deg_h(self.simulator, more, gyro, predicted)
        more = tuple(self.heard(part, values) for part, values in zip(more, departures, strict=True))
        together = (*self.unexplained_deg_h, *departures)
        bare = self._posed(self.simulator, (*self.windows, *more), together, self.channel)
        known = {name: getattr(self, name) for name in ("own_biases", "laws", "steps", "partly")}
        return dataclasses.replace(bare, held_out=len(runs), **known).with_free_part()

    def heard(self, windows: Windows, values_deg_h: Array) -> Windows:
        """Windows of a further run that know how loud its white noise is beside that of these; on a table, what rounding adds."""
        if self.simulator.kind != "chamber":
            known = self.windows[0]
            return dataclasses.replace(windows, white_deg_h2=known.white_deg_h2, rounded=known.rounded)
        return beside(self.windows, self.unexplained_deg_h, windows, values_deg_h)

    def with_own_biases(self) -> Self:
        """The problem in which each training run has a bias of its own."""
        return dataclasses.replace(self, own_biases=True).with_free_part()

    def calibrated_beside(self, causes: Sequence[Mechanism]) -> Self:
        """The problem with the simulator's free shapes calibrated beside causes, which may have pulled them away."""
        return dataclasses.replace(self, beside=tuple(causes)).with_free_part()

    def beside_laws(self, laws: Sequence[EmpiricalLaw]) -> Self:
        """The problem to a simulator that has laws as well."""
        return dataclasses.replace(self, laws=tuple(laws)).with_free_part()

    def with_steps(self, steps: Sequence[BiasStep]) -> Self:
        """The problem in which the bias steps."""
        return dataclasses.replace(self, steps=tuple(steps)).with_free_part()

    def with_partly(self, partly: Sequence[Partly]) -> Self:
        """The problem in which causes act in a part of the runs."""
        return dataclasses.replace(self, partly=tuple(partly)).with_free_part()

    def partly_column(self, partly: Partly) -> Array:
        """Window means of what a cause does in a part of the training runs, per unit of amplitude, shape (n,)."""
        return self.in_part(self.columns(partly.mechanism)[:, 0], partly)

    def in_part(self, column: Array, partly: Partly) -> Array:
        """A column, shape (n,), about its mean in the training runs, in a part of these."""
        inside = np.isin(self.rows.run, partly.runs).astype(np.float64)
        if partly.moment is not None:
            inside += self.step_column(partly.moment)
        return np.asarray((column - column[self.rows.run < len(self.windows) - self.held_out].mean()) * inside)

    def step_column(self, step: BiasStep) -> Array:
        """Window means of a step of one, shape (n,): contrasts do not see it."""
        part, rows = self.windows[step.run], self.rows.runs[step.run]
        column = np.zeros(len(self.rows))
        column[rows] = part.means(((part.full.time_s >= step.at_s) == step.after).astype(np.float64))
        return column

    def without_offsets(self) -> Self:
        """The problem in which held-out runs have the bias that training runs have."""
        return dataclasses.replace(self, offsets=False).with_free_part()

    def columns(self, mechanism: Mechanism) -> Array:
        """Window means of a mechanism's basis over all runs, shape (n, k); a run's own columns where its amplitudes are its own."""
        of_the_rate = mechanism.empirical and self.simulator.kind == "turntable"  # a law of what jumps within windows
        if self.contrasts is not None and (mechanism.fast or of_the_rate):
            return self.fast_columns([mechanism.basis(part.full) for part in self.windows], each_run=mechanism.each_run)
        blocks = [self.run_columns(mechanism, part) for part in self.windows]
        width = blocks[0].shape[1]
        if not mechanism.each_run:
            return np.concatenate([*blocks, np.zeros((self.rows.contrasts, width))])
        table = np.zeros((len(self.rows), width * len(blocks)))
        for k, (rows, block) in enumerate(zip(self.rows.runs, blocks, strict=True)):
            table[rows, k * width : (k + 1) * width] = block
        return table

    def scatter(self, mechanism: Mechanism) -> Array:
        """What a mechanism's law leaves open in the training rows: independent disturbances, shape (n, k)."""
        found = [mechanism.unmodelled(part.full) for part in self.windows]
        bases = [basis for basis in found if basis is not None]
        if len(bases) < len(found):
            return np.zeros((len(self.rows), 0))
        columns = self.fast_columns(bases, each_run=True)
        return np.asarray(columns[:, columns.any(axis=0)])

    def fast_columns(self, bases: Sequence[Array], *, each_run: bool = False) -> Array:
        """Window means, and contrasts where there are any, of columns at the full rate."""
        if each_run:
            return np.column_stack([self._fast_columns_of(k, basis) for k, basis in enumerate(bases)])
        means = [part.means(basis) for part, basis in zip(self.windows, bases, strict=True)]
        return np.concatenate([*means, *([] if self.contrasts is None else [self.contrasts.of(bases)])])

    def _fast_columns_of(self, k: int, basis: Array) -> Array:
        """The same of columns that are nothing but in one run."""
        table = np.zeros((len(self.rows), basis.shape[1]))
        table[self.rows.runs[k]] = self.windows[k].means(basis)
        if self.contrasts is not None:
            table[len(self.rows) - self.rows.contrasts :] = self.contrasts.of_run(k, basis)
        return table

    @property
    def ones(self) -> Array:
        """The column of a constant, shape (n,): contrasts do not see it."""
        return np.r_[np.ones(len(self.rows) - self.rows.contrasts), np.zeros(self.rows.contrasts)]

    def with_contrasts(self, mechanisms: Sequence[Mechanism]) -> Self:
        """The problem with rows that compare samples within windows, wherever these mechanisms differ there."""
        fast = [mechanism for mechanism in (*self.simulator.mechanisms, *mechanisms) if mechanism.fast]
        bases = [np.column_stack([mechanism.basis(part.full) for mechanism in fast]) for part in self.windows]
        if any(mechanism.each_run for mechanism in fast):  # directions of each run by itself
            bases = [np.column_stack([basis * (k == j) for j in range(len(bases))]) for k, basis in enumerate(bases)]
        scatter = self._scatter(mechanisms)
        contrasts = Contrasts.made(self.windows, bases, self.unexplained_deg_h, scatter)
        if contrasts is None:
            return self
        more = contrasts.count
        disturbed = [(part.means(values) ** 2).sum(axis=1) for part, values in zip(self.windows, scatter, strict=True)]
        of_samples = np.concatenate(
            [part.window_s / part.full.period_s * values for part, values in zip(self.windows, disturbed, strict=True)]
        )
        rows = dataclasses.replace(
            self.rows,
            time_s=np.r_[self.rows.time_s, np.zeros(more)],
            run=np.r_[self.rows.run, np.full(more, len(self.windows))],
            white=np.r_[self.rows.white + (of_samples / contrasts.level if contrasts.level > 0.0 else 0.0), np.ones(more)],
            contrasts=more,
            rate_within_deg_s=contrasts.of_rate() if self.simulator.kind == "turntable" else None,
        )
        target = np.r_[self.target_deg_h, contrasts.of([values[:, None] for values in self.unexplained_deg_h])[:, 0]]
        wider = dataclasses.replace(self, rows=rows, target_deg_h=target, contrasts=contrasts, baseline=np.empty((len(rows), 0)))
        return wider.with_free_part()

    def _scatter(self, candidates: Sequence[Mechanism]) -> list[Array]:
        """What laws leave open in each run at its full rate, shape (rows, k): the simulator's, and candidates' that stand out."""
        own = [mechanism for mechanism in self.simulator.mechanisms if mechanism.fast]
        kinds = dict.fromkeys(type(mechanism) for mechanism in candidates)
        more = [one for kind in kinds if kind not in map(type, own) for one in kind.evident_in(self.runs)]
        found = [[mechanism.unmodelled(part.full) for mechanism in (*own, *more)] for part in self.windows]
        none = [np.zeros((len(part.full), 0)) for part in self.windows]
        return [
            np.column_stack([empty, *(one for one in every if one is not None)]) for empty, every in zip(none, found, strict=True)
        ]

    @staticmethod
    def run_columns(mechanism: Mechanism, part: Windows) -> Array:
        """Window means of a mechanism's basis in one run."""
        if mechanism.fast:
            return part.means(mechanism.basis(part.full))
        return part.means(mechanism.basis(part.fine), of_fine=True)

    def constant(self, value_deg_h: float) -> Mechanism | None:
        """The mechanism that adds a constant bias: the simulator's own with that much more, else one that adds nothing else; None
        where the catalogue has none of this kind."""
        for kind in CATALOGUE.values():
            if kind.kind == self.simulator.kind and kind.constant:
                for own in self.simulator.mechanisms:
                    if isinstance(own, kind):
                        return dataclasses.replace(own, **{kind.constant: getattr(own, kind.constant) + value_deg_h})  # type: ignore[type-var]
                nothing = {parameter.name: 0.0 for parameter in kind.parameters() if parameter.role == "amplitude"}
                return kind(**{**nothing, **kind.constant_alone, kind.constant: value_deg_h})
        return None

    def driver(self, column: str) -> Array:
        """Window means of a recorded column, shape (n,)."""
        return np.concatenate([part.means(part.full.column(column)) for part in self.windows])

    def drivers(self, mechanism: Mechanism) -> Array:
        """Window means of what a mechanism reads, or of the time, shape (n, drivers); a run may have another thermometer of it."""
        read = ((part, mechanism.driver_columns(part.full) or (TIME,)) for part in self.windows)
        return np.vstack([np.column_stack([part.means(part.full.column(name)) for name in names]) for part, names in read])

    @property
    def runs(self) -> tuple[Recording, ...]:
        return tuple(part.full for part in self.windows)

    @property
    def fine(self) -> tuple[Recording, ...]:
        return tuple(part.fine for part in self.windows)

    def with_free_part(self) -> Self:
        """The problem with the simulator's free parameters as columns, free shapes calibrated first."""
        posed = self
        in_use = [one for one in self.simulator.mechanisms if one.amplitude_parameters()]
        shaped = [one.name for one in in_use if free(self.simulator, one, "shape")]
        for name in () if self.held_out else shaped * (_SWEEPS if len(shaped) > 1 else 1):
            mechanism = next(one for one in posed.simulator.mechanisms if one.name == name)
            posed = posed.reshaped(posed.simulator.with_mechanism(free_part.calibrated(posed, mechanism)))
        return posed.linearised({})

    def reshaped(self, simulator: Simulator) -> Self:
        """The problem with what a simulator of other shapes says for certain taken off instead."""
        target, unexplained = self.target_deg_h, list(self.unexplained_deg_h)
        for old, new in zip(self.simulator.mechanisms, simulator.mechanisms, strict=True):
            known = stated(self.simulator, old)
            if old == new or not known.any():
                continue
            change = self.columns(old) - self.columns(new)
            target = target + change @ np.resize(known, change.shape[1])
            for k, part in enumerate(self.windows):
                unexplained[k] = unexplained[k] + (old.basis(part.full) - new.basis(part.full)) @ known
        return dataclasses.replace(self, simulator=simulator, target_deg_h=target, unexplained_deg_h=tuple(unexplained))

    def moved(self, weights: Array) -> Self:
        """The problem linearised about where weights of its baseline put the simulator's free shapes: by a third at most."""
        found = dict(zip(self.baseline_names, weights.tolist(), strict=True))
        simulator = self.simulator
        amplitudes = {}
        for mechanism in self._shaped():
            shapes = free(simulator, mechanism, "shape")
            width = self.columns(mechanism).shape[1]
            own = {(mechanism.name, name) for name in free(simulator, mechanism, "amplitude")}
            amplitudes[mechanism.name] = np.resize(stated(simulator, mechanism), width)
            amplitudes[mechanism.name][where_free(simulator, mechanism, width)] = weights[[n in own for n in self.baseline_names]]
            simulator = simulator.with_mechanism(shifted(mechanism, {name: found[mechanism.name, name] for name in shapes}))
        return self.reshaped(simulator).linearised(amplitudes) if amplitudes else self

    def held(self) -> npt.NDArray[np.bool_]:
        """Which columns of the baseline are no derivatives by the simulator's free shapes, shape (p,)."""
        shapes = {(one.name, shape) for one in self._shaped() for shape in free(self.simulator, one, "shape")}
        return np.array([name not in shapes for name in self.baseline_names], dtype=np.bool_)

    def _shaped(self) -> list[Mechanism]:
        """Mechanisms of the simulator with free shapes that are columns of the baseline."""
        there = {name for name, _ in self.baseline_names}
        shaped = [one for one in self.simulator.mechanisms if one.name in there and free(self.simulator, one, "shape")]
        return [one for one in shaped if one.amplitude_parameters()]

    def linearised(self, amplitudes: Mapping[str, Array]) -> Self:
        """With the simulator's free parameters as columns: amplitudes, and derivatives by shapes where they stand.

        These are taken at the amplitudes of mechanisms by name, else at the likeliest.
        """
        columns, names = free_part.columns(self, amplitudes)
        return dataclasses.replace(self, baseline=columns, baseline_names=names)
