"""Runs on a turntable: what repeats with the angle averages out over a window, so that rows for it stand beside the window means.

Terms are evaluated at every sample. Of what varies within windows only the part in the span of some term can be told from noise: a
run's further rows are its projections on an orthonormal basis of that span. White noise stays white there; noise of the encoder's
readings, whose differences are the rate, has the covariance of differences.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Final, Self

import numpy as np
import numpy.typing as npt

from rlgcomp.diagnosis import priors
from rlgcomp.diagnosis.data import Data, Run, Within
from rlgcomp.diagnosis.forms.bases import Basis, Own, Power, Smooth, Times
from rlgcomp.diagnosis.forms.drivers import Driver, Path
from rlgcomp.diagnosis.forms.terms import Family, Form, Region, forms_of, log_odds_of_more
from rlgcomp.diagnosis.regions.baseline import Baseline
from rlgcomp.errors import InputError
from rlgcomp.physics.mechanism import Mechanism
from rlgcomp.physics.rotation_harmonics import RotationHarmonics
from rlgcomp.recording import Recording
from rlgcomp.recording.motion import ANGLES, RATE, rate_deg_s

Array = npt.NDArray[np.float64]
_NAMED: Final = math.log(priors.NAMED_ODDS)
_LAW: Final = math.log(priors.LAW_ODDS)
_SHOWN: Final = 1e-4  # share of a column's square that varies within windows, from which on it is one of the span's
_SAME: Final = 1e-6  # of the largest square of a direction of the span
_EXPONENTS: Final = (1.5, 2.0, 2.5, 3.0, 4.0, 5.0)
_ORDERS: Final = 12  # of the table's angle, of which a further one is tried
_MOST: Final = 4  # orders at once


# --- bases ---------------------------------------------------------------------------------------------------------------------


@dataclasses.dataclass(frozen=True)
class RatePower(Basis):
    """A power of the rate's magnitude, with the sign of the rate where it is odd."""

    path: Path
    exponent: float
    odd: bool

    def columns(self, run: Run) -> Array:
        rate = self.path.values(run)
        size = np.abs(rate) ** self.exponent
        return (np.sign(rate) * size if self.odd else size)[:, None]

    def nearby(self, step: float) -> tuple[Self, ...]:
        moves = self.exponent + 0.5 * step, self.exponent - 0.5 * step
        return tuple(dataclasses.replace(self, exponent=p) for p in moves if p > 0.1)

    def parameters(self) -> dict[str, float]:
        return {"order": self.exponent} if self.odd else {}


@dataclasses.dataclass(frozen=True)
class TableRate(Driver):
    """The rate of the table, of its own column or of an encoder."""

    def raw(self, run: Run) -> Array:
        key = ("table rate",)
        if key not in run.cache:
            run.cache[key] = run.on_bins(rate_deg_s(run.binned))
        return run.cache[key]


def table_rate(data: Data) -> Path:
    """The rate over the highest of the training runs."""
    rate = TableRate((RATE,))
    top = max(float(np.abs(rate.raw(run)).max()) for run in data.runs)
    return Path(dataclasses.replace(rate, half=top or 1.0))


# --- rows of what varies within windows ------------------------------------------------------------------------------------------


def with_angle_rows(data: Data, bases: Iterable[Basis], output: Callable[[Recording], Array]) -> Data:
    """The same runs with rows for what varies within windows.

    Parameters
    ----------
    data : Data
    bases : iterable of Basis
        Of the terms that are tried.
    output : callable
        The output of a recording, less what is known of it, shape (n,).
    """
    listed = list(dict.fromkeys(bases))
    runs = []
    for run in data.runs:
        waves = _span([basis.columns(run) for basis in listed], run)
        steps = np.diff(waves, axis=0, append=np.zeros((1, waves.shape[1])))
        within = Within(waves / math.sqrt(run.grid.bins), steps.T @ steps)
        rows = run.on_bins(output(run.binned)) @ within.waves
        white = np.r_[run.white, np.ones(len(rows))]
        runs.append(dataclasses.replace(run, within=within, output=np.r_[run.output, rows], white=white, derived={}))
    return dataclasses.replace(data, runs=tuple(runs))


def _span(tables: Sequence[Array], run: Run) -> Array:
    """An orthonormal basis of what columns on bins are beside their window means, zero in windows that do not count."""
    parts = []
    for table in tables:
        by_window = table.reshape(len(run.full), run.grid.bins, -1)
        varying = (by_window - by_window.mean(axis=1, keepdims=True)) * run.full[:, None, None]
        varying = varying.reshape(len(table), -1)
        size, total = np.sum(varying**2, axis=0), np.sum(table**2, axis=0)
        shown = size > _SHOWN * total
        parts.append(varying[:, shown] / np.sqrt(size[shown]))
    columns = np.hstack(parts)
    values, vectors = np.linalg.eigh(columns.T @ columns)
    used = values > _SAME * values.max(initial=0.0)
    return np.asarray(columns @ (vectors[:, used] / np.sqrt(values[used])))


# --- regions ---------------------------------------------------------------------------------------------------------------------


def turning_regions(
    data: Data, catalogue: Mapping[str, type[Mechanism]], baseline: Baseline, temperature: str | None
) -> Iterator[Region]:
    """Regions that are searched where a table turns: those that mechanisms name, and laws of recorded columns.

    Parameters
    ----------
    data : Data
    catalogue : mapping of str to type of Mechanism
    baseline : Baseline
    temperature : str, optional
        The column that the catalogue means by temperature.
    """
    rate = table_rate(data)
    present = {mechanism.name for mechanism in baseline.simulator.mechanisms}
    binned = [run.binned for run in data.runs]
    columns = [column for column in data.columns if column not in (RATE, *ANGLES)]
    for name, mechanism in catalogue.items():
        if name in present or not mechanism.is_candidate("turntable") or not _readable(mechanism(), binned):
            continue
        families = _families(name, mechanism, data, rate, temperature if temperature in columns else None, binned)
        forms = forms_of(name, families)
        if forms:
            grow = _more_orders if name == RotationHarmonics.name else None
            yield Region(name, name, _NAMED, forms, mechanism.drivers, "static", grow)
    for column in columns:
        path = Path(Driver.of(data, column))
        smooth = Smooth(path, 0.5, 8)
        families = [Family(f"b = k {column}", [(Power(path),)], (smooth,)), Family(f"b = f({column})", [(Smooth(path),)])]
        yield Region(f"law:{column}", None, _LAW, forms_of(f"law:{column}", families), (column,))
        if column != temperature:
            key, leads = f"scale:{column}", [(Times(Power(path), rate),)]
            family = Family(f"b = k {column} * W", leads, (Times(smooth, rate),))
            yield Region(key, None, _LAW, forms_of(key, [family]), (column, RATE))


def _readable(mechanism: Mechanism, runs: Sequence[Recording]) -> bool:
    """Whether runs tell what a mechanism reads: of a rate alone no angle follows where a table turns far between rows."""
    try:
        for run in runs:
            mechanism.read(run)
    except InputError:
        return False
    return True


def _families(
    name: str, mechanism: type[Mechanism], data: Data, rate: Path, temperature: str | None, binned: Sequence[Recording]
) -> list[Family]:
    if name == "scale_factor_temperature":
        if temperature is None:
            return []
        path = Path(Driver.of(data, temperature))
        smooth = Times(Smooth(path, 0.5, 8), rate)
        return [
            Family("b = k T W", [(Times(Power(path), rate),)], (smooth,), 2.0),
            Family("b = f(T) W", [(Times(Power(path, 3), rate),), (Times(Smooth(path), rate),)], (smooth,)),
        ]
    if name == "scale_factor_asymmetry":
        even = (Smooth(rate, 0.5, 8, 1),)
        powers: list[tuple[Basis, ...]] = [(RatePower(rate, p, False),) for p in (0.8, 1.0, 1.25)]
        return [
            Family("b = k |W|", powers[1:2], even, 2.0),
            Family("b = k |W|^exponent", powers[::2], even),
            Family("b = even function of W", [(RatePower(rate, 1.0, False), Smooth(rate, 0.25, 16, 1))]),
        ]
    if name == "scale_factor_nonlinearity":
        odd = (Smooth(rate, 0.5, 8, -1),)
        return [
            Family("b = k W |W|^(order - 1)", [(RatePower(rate, p, True),) for p in _EXPONENTS], odd, 2.0),
            Family("b = odd function of W", [(Smooth(rate, 0.35, 12, -1),)]),
        ]
    return [Family(mechanism.equation, [(Own(point),) for point in mechanism.grid(binned)])]


def _more_orders(form: Form) -> Iterator[Form]:
    """The same with one more order of the table's angle."""
    first = form.lead[0]
    if len(form.lead) >= _MOST or not isinstance(first, Own):
        return
    taken = {order for basis in form.lead if isinstance(basis, Own) for order in basis.mechanism.orders}
    share = form.log_share + log_odds_of_more(len(form.lead) - 1, 1, _ORDERS)
    for order in sorted(set(range(2, _ORDERS + 1)) - taken):
        more = Own(RotationHarmonics(order_1=order, scaling=first.mechanism.scaling, taken=first.mechanism.taken))
        yield dataclasses.replace(form, lead=(*form.lead, more), log_share=share)
