"""Functions of members as tables: over a driver, over time, the response to a step, the path of a loop."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from types import SimpleNamespace
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from rlgcomp.diagnosis.answer.fit import Fit
from rlgcomp.diagnosis.data import Run
from rlgcomp.diagnosis.forms.bases import Basis, EachRun, Times
from rlgcomp.diagnosis.forms.drivers import Driver, Path
from rlgcomp.diagnosis.forms.memories import Curves, Followed, Plays, Preisach, Relays
from rlgcomp.diagnosis.forms.relaxations import Conduction, Distributed, Lag, Spectrum
from rlgcomp.diagnosis.forms.times import Since, SmoothSince
from rlgcomp.diagnosis.regions.selections import OnlyIn, by_run, in_all_runs, runs_of
from rlgcomp.units import display_unit

Array = npt.NDArray[np.float64]
_PLACES: Final = 41  # of a table
_LOOP: Final = 120  # of a loop's
_BEFORE: Final = 0.2  # of the fastest time constant, at which a response begins
_SETTLED: Final = 7.0  # time constants after which nothing of a step is left


@dataclasses.dataclass(frozen=True)
class Function:
    """A term as a table.

    Parameters
    ----------
    kind : {"static", "time", "response", "loop"}
        Over a driver, over the time since the run's start, over the time since a unit step of the driver, or the path of one run.
    of, of_unit : str
        What the table is over.
    at, value, sd : tuple of float
        The band is one standard deviation.
    run : str
        Of a loop.
    """

    kind: str
    of: str
    of_unit: str
    at: tuple[float, ...]
    value: tuple[float, ...]
    sd: tuple[float, ...]
    run: str = ""

    def to_mapping(self, unit: str) -> dict[str, Any]:
        """Columns with their units."""
        columns = {"driver": list(self.at), "value": list(self.value), "sd": list(self.sd)}
        run = {"run": self.run} if self.run else {}
        return {"kind": self.kind, "of": self.of, "of_unit": self.of_unit, "unit": unit, **run, **columns}


def function_of(fit: Fit, k: int) -> Function | None:
    """The k-th member as a table, where it is a function of one quantity or the path of a driver."""
    _, bases = fit.parts[k]
    form = fit.state.members[k].form
    if not bases or (by_run(form) and any(isinstance(basis, EachRun) for basis in form.lead)):
        return None
    lead = _plain(bases[0][0])
    path = getattr(lead, "path", None)
    if isinstance(path, Path):
        return _static(fit, k, path)
    if isinstance(lead, Since | SmoothSince):
        return _of_time(fit, k)
    if isinstance(lead, Lag | Conduction | Distributed | Spectrum):
        return _response(fit, k, lead.driver)
    if isinstance(lead, Relays | Plays | Followed | Curves | Preisach):
        return _loop(fit, k, lead.driver)
    return None


def means_over(fit: Fit, k: int, table: Function, run: Run) -> Array | None:
    """Window means of what the k-th member's table is over; None of a response, and of a term that is times another path."""
    lead: Any = in_all_runs(fit.parts[k][1][0][0])
    if table.kind == "response" or isinstance(lead, Times):
        return None
    if table.kind == "time":
        return run.window_means(run.elapsed_s)
    if table.kind == "loop":
        return run.window_means(lead.driver.raw(run))
    return np.asarray(lead.path.in_unit(run.window_means(lead.path.values(run))))


def _plain(basis: Basis) -> Basis:
    """A basis without its selection of runs, and without its factor."""
    return _plain(basis.basis) if isinstance(basis, OnlyIn | Times) else basis


def _tabulated(fit: Fit, k: int, columns: Mapping[int, Array], about: Mapping[int, Array] | None = None) -> tuple[Array, Array]:
    """Mean and standard deviation of a table of some of the bases of a member, by their numbers."""
    _, bases = fit.parts[k]
    edges = np.cumsum([0, *(fit.bank.columns(basis).shape[1] for basis, _ in bases)])
    places = np.concatenate([np.arange(edges[j], edges[j + 1]) for j in columns])
    table = np.hstack([columns[j] * bases[j][1] for j in columns])
    if about is not None:
        table = table - np.hstack([about[j] * bases[j][1] for j in columns])
    weights, covariance = fit.weights(k)[places], fit.covariance(k)[np.ix_(places, places)]
    return np.asarray(table @ weights), np.sqrt(np.maximum(np.einsum("ij,jk,ik->i", table, covariance, table), 0.0))


def _static(fit: Fit, k: int, path: Path) -> Function:
    """Bases of one path over the range of the training runs, about their mean there; of a scale factor, at the highest rate.

    A coefficient that follows a column is that of the middle of the column's range.
    """
    values = np.concatenate([path.values(run)[np.repeat(run.full, run.grid.bins)] for run in fit.data.runs])
    low, high = np.quantile(values, [0.005, 0.995])
    at = np.asarray(np.linspace(float(low), float(high), _PLACES))
    run: Any = SimpleNamespace(cache={path: at}, bins=len(at))
    bases = [in_all_runs(basis) for basis, _ in fit.parts[k][1]]
    alike = {j: _plain(basis) for j, basis in enumerate(bases) if isinstance(basis, Times) == isinstance(bases[0], Times)}
    same = {j: basis for j, basis in alike.items() if getattr(basis, "path", None) == path}
    columns = {j: basis.columns(run) for j, basis in same.items()}
    means = {j: fit.data.means(basis.columns)[fit.data.of_windows].mean(axis=0) for j, basis in same.items()}
    driver = path.driver
    of = {
        "rate": f"d({driver.symbol})/dt",
        "lag": f"lag({driver.symbol}, {path.time_s:.4g} s)",
        "delay": f"{driver.symbol}(t - {path.time_s:.4g} s)",
    }.get(path.memory, driver.symbol)
    unit = f"{driver.unit}/min" if path.memory == "rate" else driver.unit
    return _made("static", of, unit, path.in_unit(at), *_tabulated(fit, k, columns, means))


def _of_time(fit: Fit, k: int) -> Function:
    at = np.geomspace(0.5 * fit.data.runs[0].grid.window_s, fit.data.longest_s, _PLACES)
    run: Any = SimpleNamespace(cache={}, elapsed_s=at, bins=len(at))
    plain = [_plain(basis) for basis, _ in fit.parts[k][1]]
    columns = {j: basis.columns(run) for j, basis in enumerate(plain) if isinstance(basis, Since | SmoothSince)}
    return _made("time", "time since the run's start", "s", at, *_tabulated(fit, k, columns))


def _response(fit: Fit, k: int, driver: Driver) -> Function:
    """Response to a step of the driver of one unit: what is behind it dies away, and a delayed law comes to its value."""
    plain = [_plain(basis) for basis, _ in fit.parts[k][1]]
    late = {j: basis for j, basis in enumerate(plain) if isinstance(basis, Lag | Conduction | Distributed | Spectrum)}
    late = {j: basis for j, basis in late.items() if basis.driver == driver}
    times = np.concatenate([basis.mixture()[0] for basis in late.values()])
    first = min(0.5 * fit.data.runs[0].grid.window_s, _BEFORE * times.min())
    at = np.geomspace(first, max(min(_SETTLED * times.max(), fit.data.longest_s), _SETTLED * times.min()), _PLACES)
    columns: dict[int, Array] = {}
    for j, basis in late.items():
        each, weights = basis.mixture()
        final = float(isinstance(basis, Lag) and not basis.behind)
        columns[j] = (final - np.exp(-np.divide.outer(at, each)) @ weights) / driver.half
    unit = display_unit(driver.columns[0]) or "unit"
    return _made("response", f"time since a step of {driver.symbol} by 1 {unit}", "s", at, *_tabulated(fit, k, columns))


def _loop(fit: Fit, k: int, driver: Driver) -> Function:
    """The path of the run in which the driver moves most."""
    _, bases = fit.parts[k]
    selected = runs_of(fit.state.members[k].form)
    shown = [j for j, run in enumerate(fit.data.runs) if not selected or run.name in selected] or range(len(fit.data.runs))
    widest = max(shown, key=lambda j: float(np.ptp(driver.values(fit.data.runs[j]))))
    run, rows = fit.data.runs[widest], fit.data.slices[widest]
    places = np.unique(np.linspace(0, rows.stop - rows.start - 1, _LOOP).astype(np.intp))
    columns = {j: fit.bank.columns(basis)[rows][places] for j, (basis, _) in enumerate(bases)}
    means = {j: fit.bank.columns(basis)[rows].mean(axis=0) for j, (basis, _) in enumerate(bases)}
    u = run.window_means(driver.raw(run))[places]
    return _made("loop", driver.symbol, display_unit(driver.columns[0]), u, *_tabulated(fit, k, columns, means), run=run.name)


def _made(kind: str, of: str, of_unit: str, at: Array, value: Array, sd: Array, run: str = "") -> Function:
    return Function(kind, of, of_unit, tuple(at.tolist()), tuple(value.tolist()), tuple(sd.tolist()), run)
