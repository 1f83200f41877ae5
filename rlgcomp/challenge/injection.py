r"""Effects of a chosen size put into recordings.

The strength of an effect e is the part of it that the simulator cannot absorb, in units of the white noise of a window mean,

.. math:: s = \frac{\mathrm{std}\big(\bar e - P\,\bar e\big)}{\sigma}, \qquad P = B (B^\top B)^{-1} B^\top,

with the bar for window means over the training runs and B the columns of the simulator's free parameters.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from typing import Final, Self, TypeVar

import numpy as np
import numpy.typing as npt

from rlgcomp import units
from rlgcomp.diagnosis.data import Data, Grid, Run
from rlgcomp.diagnosis.regions.baseline import Baseline
from rlgcomp.errors import InputError
from rlgcomp.noise.processes import stream
from rlgcomp.numerics.robust import SD_OF_MAD, segments
from rlgcomp.physics.mechanism import Mechanism, Parameter
from rlgcomp.recording import DEFAULT_AVERAGING_S, Recording, rate_name
from rlgcomp.simulation.simulator import Simulator

Array = npt.NDArray[np.float64]
M = TypeVar("M", bound=Mechanism)
SHARE: Final = (
    "1"  # unit of an amplitude that is a share of the effect that the nonlinear parameters fix: never negative, one in nature
)
_JITTER: Final = 0.1  # of a nonlinear parameter about its point of the grid, so that no truth lies on the grid
_CYCLES: Final = 4.5  # of a line in the shortest run: fewer cannot be distinguished from a drift
_REDRAWS: Final = 20
_ALIKE: Final = 1e-6  # of an effect
_ENERGY: Final = 0.8  # share of an effect's square that its intervals hold
_EVERYWHERE: Final = 0.6  # intervals that cover more than this locate nothing
_STEP: Final = 1e-3  # of a shape, relative, for its derivative
_WINDOWS: Final = 200  # of the longest run,
_FEWEST_WINDOWS: Final = 40  # and of the shortest, at least


@dataclasses.dataclass(frozen=True, eq=False)
class Projection:
    """Window means of runs, projected off the columns of a simulator's free parameters.

    Parameters
    ----------
    recordings : tuple of Recording
    data : Data
        Their window means; the output is the gyro less what the simulator states.
    columns : ndarray, shape (n, p)
        Of the simulator's free parameters, of unit length.
    """

    recordings: tuple[Recording, ...]
    data: Data
    columns: Array

    @classmethod
    def of(cls, simulator: Simulator, recordings: Sequence[Recording], gyro: str | None = None) -> Self:
        """The projection for a simulator and runs.

        Parameters
        ----------
        simulator : Simulator
        recordings : sequence of Recording
        gyro : str, optional
            Gyro column, where there are several.

        Raises
        ------
        InputError
            A run lacks a column that the simulator reads.
        """
        lengths = [run.duration_s - run.metadata.lead_in_s for run in recordings]
        window_s = min(DEFAULT_AVERAGING_S, max(lengths) / _WINDOWS, min(lengths) / _FEWEST_WINDOWS)
        grid = Grid.of_window(recordings, window_s, every_sample=simulator.kind == "turntable")

        def output(binned: Recording) -> Array:
            column = gyro if gyro is None or gyro in binned else rate_name(gyro)  # means are in deg/h
            return binned.rate_deg_h(column) - Baseline(simulator).stated(binned)

        data = Data(tuple(Run.of(recording, grid, output) for recording in recordings))
        baseline = Baseline.calibrated(simulator, data)
        columns = np.concatenate([_window_means(run, _columns(baseline, run.recording)) for run in data.runs])
        norms = np.linalg.norm(columns, axis=0)
        return cls(tuple(recordings), data, columns / np.where(norms > 0.0, norms, 1.0))

    @property
    def window_s(self) -> float:
        return self.data.runs[0].grid.window_s

    def residual(self, means: Array) -> Array:
        """Window means, shape (n,), less their projection on the columns."""
        return np.asarray(means - self.columns @ np.linalg.lstsq(self.columns, means, rcond=1e-10)[0])

    def unabsorbed(self, errors_deg_h: Sequence[Array]) -> Array:
        """The part of an error that the simulator's free parameters cannot absorb, in window means, shape (n,).

        Parameters
        ----------
        errors_deg_h : sequence of ndarray
            The error at the full rate, one array a run.
        """
        parts = zip(self.data.runs, errors_deg_h, strict=True)
        return self.residual(np.concatenate([_window_means(run, error[:, None])[:, 0] for run, error in parts]))

    @property
    def white_deg_h(self) -> float:
        """Standard deviation of the white noise of a window mean, from differences of neighbours.

        Slow signals and outliers cancel in these.
        """
        residual = self.residual(self.data.output)
        steps = np.concatenate([np.diff(residual[rows]) for rows in self.data.slices])
        return float(SD_OF_MAD * np.median(np.abs(steps - np.median(steps))) / math.sqrt(2.0))


def _window_means(run: Run, columns: Array) -> Array:
    """Window means of columns at the recording's rows, shape (windows, k)."""
    return np.column_stack([run.window_means(run.on_bins_of_rows(column)) for column in columns.T])


def _columns(baseline: Baseline, recording: Recording) -> Array:
    """Columns of a simulator's free amplitudes, and derivatives by its free shapes, at the full rate, shape (n, p)."""
    columns = [np.ones(len(recording))]
    for mechanism in baseline.simulator.mechanisms:
        basis, free = mechanism.basis(recording), baseline.free(mechanism, "amplitude")
        columns += [basis[:, k] for k, parameter in enumerate(mechanism.amplitude_parameters()) if parameter in free]
        for parameter in baseline.free(mechanism, "shape"):
            value = float(getattr(mechanism, parameter.name))
            step = _STEP * (abs(value) or 1.0)
            moved = dataclasses.replace(mechanism, **{parameter.name: min(value + step, parameter.high)})  # type: ignore[type-var]
            columns.append((moved.basis(recording) - basis) @ baseline.amplitudes[mechanism.name])
    return np.column_stack(columns)


def drawn(kind: type[M], runs: Sequence[Recording], rng: np.random.Generator, window_s: float) -> M:
    """A mechanism with random nonlinear parameters and signs that these runs can show; sizes are about the usual ones.

    Times and frequencies are log-uniform over the range that the runs resolve, other nonlinear parameters lie about a point of the
    mechanism's grid.

    Parameters
    ----------
    kind : type of Mechanism
    runs : sequence of Recording
    rng : numpy.random.Generator
    window_s : float
        Averaging window of the diagnosis.
    """
    grid = kind.grid(runs)
    point = grid[int(rng.integers(len(grid)))] if grid else None
    shortest_s = min(run.duration_s for run in runs)
    values: dict[str, float | str] = {}
    for parameter in kind.parameters():
        if parameter.role == "amplitude":
            relative = 1.0 if parameter.unit == SHARE else rng.uniform(0.5, 1.5) * rng.choice([-1.0, 1.0])
            size = float(parameter.typical * relative)
            values[parameter.name] = abs(size) if parameter.low >= 0.0 else size
        elif parameter.choices and point is None:
            values[parameter.name] = str(rng.choice(parameter.choices))
        elif parameter.role == "setting" and point is not None:
            values[parameter.name] = getattr(point, parameter.name)
        elif parameter.role == "shape":
            value = parameter.typical if point is None else getattr(point, parameter.name)
            values[parameter.name] = _nonlinear(parameter, value, shortest_s, window_s, rng)
    return kind.from_mapping(values).for_true_quantities()


def _nonlinear(parameter: Parameter, value: float, shortest_s: float, window_s: float, rng: np.random.Generator) -> float:
    resolved = {"s": (3.0 * window_s, 0.3 * shortest_s), "Hz": (_CYCLES / shortest_s, 0.25 / window_s)}
    if parameter.unit in resolved:
        low, high = (min(max(edge, parameter.low), parameter.high) for edge in resolved[parameter.unit])
        return float(math.exp(rng.uniform(math.log(low), math.log(max(low, high)))))
    moved = value * math.exp(_JITTER * rng.standard_normal()) if value > 0.0 else value + _JITTER * rng.standard_normal()
    return float(min(max(moved, parameter.low), parameter.high))


def scaled(mechanism: M, factor: float) -> M:
    """The mechanism with its error multiplied, in canonical parameters: approximately, where these change its form a little.

    Raises
    ------
    InputError
        Its amplitudes would leave their bounds, or none of its parameters is a size.
    """
    names = [parameter.name for parameter in mechanism.amplitude_parameters()]
    if not names:
        names = [parameter.name for parameter in mechanism.shape_parameters() if parameter.unit.startswith("deg/h")]
    if not names:
        raise InputError(f"{mechanism.name}: none of its parameters is a size that could be made larger or smaller")
    made = dataclasses.replace(mechanism, **{name: factor * getattr(mechanism, name) for name in names})  # type: ignore[type-var]
    return made.canonical()


def sized_injection(
    form: type[Mechanism], projection: Projection, size_deg_h: float, rng: np.random.Generator
) -> tuple[Mechanism, int]:
    """A mechanism with random nonlinear parameters, scaled to the part that cannot be absorbed, and the seed of its random paths.

    Parameters
    ----------
    form : type of Mechanism
    projection : Projection
    size_deg_h : float
        Standard deviation of the part that the simulator cannot absorb.
    rng : numpy.random.Generator

    Raises
    ------
    InputError
        The simulator absorbs all of it, the runs never excite it, or its amplitudes would leave their bounds.
    """
    why = f"the simulator absorbs all of it, or {', '.join(run.name for run in projection.recordings)} never excite it"
    for _ in range(_REDRAWS):
        mechanism, number = drawn(form, projection.recordings, rng, projection.window_s), int(rng.integers(2**31))
        errors = contributions(mechanism, projection.recordings, number)
        remaining, whole = float(np.std(projection.unabsorbed(errors))), np.concatenate(errors)
        if remaining > max(1e-3 * float(np.std(whole)), 1e-9 * float(np.abs(whole).max())):
            try:
                return scaled(mechanism, size_deg_h / remaining), number
            except InputError as error:
                why = str(error)
    raise InputError(f"{form.name} cannot be injected at {size_deg_h:.3g} deg/h: {why}")


def distinct_injections(plans: Sequence[tuple[Mechanism, int]], projection: Projection) -> list[tuple[Mechanism, int]]:
    """Those of injections whose effects, as far as the simulator cannot absorb them, differ."""
    distinct: list[tuple[Mechanism, int]] = []
    effects: list[Array] = []
    for mechanism, number in plans:
        effect = projection.unabsorbed(contributions(mechanism, projection.recordings, number))
        if all(np.linalg.norm(effect - other) > _ALIKE * np.linalg.norm(other) for other in effects):
            distinct.append((mechanism, number))
            effects.append(effect)
    return distinct


def contributions(mechanism: Mechanism, runs: Sequence[Recording], number: int) -> list[Array]:
    """Errors of a mechanism in deg/h, one array a run.

    Parameters
    ----------
    mechanism : Mechanism
    runs : sequence of Recording
    number : int
        Seed of its random paths.
    """
    return [mechanism.contribution(run, stream(number, f"run{k}")) for k, run in enumerate(runs)]


def strongest_intervals(projection: Projection, effect_deg_h: Array) -> Mapping[str, tuple[tuple[float, float], ...]]:
    """By run, the intervals that hold four fifths of an effect's square; none where these are most of the time.

    Parameters
    ----------
    projection : Projection
    effect_deg_h : ndarray, shape (n,)
        As :meth:`Projection.unabsorbed` gives it.
    """
    slices = projection.data.slices
    smooth = np.concatenate([np.convolve(effect_deg_h[rows] ** 2, np.ones(5) / 5.0, mode="same") for rows in slices])
    order = np.argsort(smooth)[::-1]
    enough = int(np.searchsorted(np.cumsum(smooth[order]), _ENERGY * smooth.sum())) + 1
    inside = np.zeros(len(smooth), dtype=bool)
    inside[order[:enough]] = True
    if inside.mean() > _EVERYWHERE:
        return {}
    half_s = 0.5 * projection.window_s
    spans: dict[str, tuple[tuple[float, float], ...]] = {}
    for run, rows in zip(projection.data.runs, projection.data.slices, strict=True):
        time_s = run.binned.time_s[0] + (run.windows + 0.5) * run.grid.window_s
        spans[run.name] = tuple((float(time_s[a] - half_s), float(time_s[b - 1] + half_s)) for a, b in segments(inside[rows]))
    return spans


def injected(run: Recording, error_deg_h: Array, gyro: str | None = None) -> Recording:
    """The recording with an error added to its gyro, in the unit it was recorded in; pulses stay whole.

    Parameters
    ----------
    run : Recording
    error_deg_h : ndarray, shape (n,)
    gyro : str, optional
        Gyro column, where there are several.
    """
    column = run.gyro_column(gyro)
    if column.endswith("_pulses"):
        run.rate_deg_h(column)  # raises where pulse_arcsec is missing
        angle = np.cumsum(units.convert(error_deg_h, "deg/h", "arcsec/s")) * run.period_s / float(run.metadata.pulse_arcsec or 1.0)
        added = np.diff(np.rint(angle), prepend=0.0)
    else:
        added = units.convert(error_deg_h, "deg/h", units.column_unit(column) or "deg/h")
    table = run.table
    table[column] = run.column(column) + added
    return run.replace(table=table, truth=None)
