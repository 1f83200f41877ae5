"""How one row is measured: ours and each peer in turn, in the same run, and their results compared.

The ratio is the median over repeats of peer's time over ours, taken one after the other, so that whatever else the machine does
falls on both. Wall-clock and processor time are both kept: on a busy machine the second is the steadier one, but it does not see
the gain of a second thread.
"""

from __future__ import annotations

import dataclasses
import gc
import time
import tracemalloc
from collections.abc import Callable, Sequence
from typing import Any, Final

import numpy as np
from threadpoolctl import threadpool_limits

REPEATS: Final = 5
PATIENCE_S: Final = 10.0  # for all repeats of one side; what takes longer is run once


@dataclasses.dataclass(frozen=True)
class Timed:
    """Result of a peer that measures itself, in another process, with its wall-clock and processor time."""

    result: Any
    wall_s: float
    cpu_s: float


@dataclasses.dataclass(frozen=True)
class Peer:
    """Another implementation of a row's work.

    Parameters
    ----------
    name : str
    run : callable
        Does the work and returns its result, or a `Timed` one. An ImportError means that the peer is not installed.
    disagreement : callable
        (our result, its result) to one number that should be small.
    tolerance : float
        The largest disagreement allowed.
    goal : float, optional
        How many times faster we should be, at full size.
    scale : float
        The peer does this fraction of the work; its time is divided by it, and the row says so.
    """

    name: str
    run: Callable[[], Any]
    disagreement: Callable[[Any, Any], float]
    tolerance: float
    goal: float | None = None
    scale: float = 1.0


@dataclasses.dataclass(frozen=True)
class Case:
    """A row's work on data that are there.

    Parameters
    ----------
    ours : callable
    peers : sequence of Peer
    size : str
        The data, in words.
    memory : bool
        Whether the most memory that arrays take is measured as well.
    n : int
        Size of the data that grows; 0 where none does.
    parts : dict
        Seconds by part, which the work itself writes as it goes; those of the last time are shown where there is no peer.
    """

    ours: Callable[[], Any]
    peers: Sequence[Peer] = ()
    size: str = ""
    memory: bool = False
    n: int = 0
    parts: dict[str, float] = dataclasses.field(default_factory=dict)


@dataclasses.dataclass(frozen=True)
class Row:
    """One row of the table.

    Parameters
    ----------
    name : str
        As `--only` takes it.
    work : str
    prepare : callable
        (quick) to Case; quick is smaller data, whose goals are not judged. An ImportError means that what it needs is not
        installed.
    threads : int
        Threads that our side may use; BLAS has one throughout.
    goal_s : float, optional
        Our time at full size.
    goal_extra_s : float, optional
        Factor by which we may take longer than the peer.
    grown : callable, optional
        (small) to Case, for growth, where quick data are of another kind than full ones.
    """

    name: str
    work: str
    prepare: Callable[[bool], Case]
    threads: int = 1
    goal_s: float | None = None
    goal_extra_s: float | None = None
    grown: Callable[[bool], Case] | None = None


@dataclasses.dataclass(frozen=True)
class Measured:
    """One row against one peer; a row without peers has an empty peer's name.

    Times are medians in s, of the whole process for processor time; `ratio` is the median of paired ratios of wall-clock time.
    """

    row: str
    work: str
    size: str
    threads: int
    peer: str
    ours_s: float
    ours_cpu_s: float
    peer_s: float | None = None
    ratio: float | None = None
    ratio_cpu: float | None = None
    goal: str = ""
    reached: bool | None = None
    disagreement: float | None = None
    agrees: bool | None = None
    ours_MiB: float | None = None
    peer_MiB: float | None = None
    note: str = ""

    def to_mapping(self) -> dict[str, Any]:
        """Plain mapping, for JSON."""
        return dataclasses.asdict(self)


def measure(row: Row, *, quick: bool = False, repeats: int = REPEATS) -> list[Measured]:
    """Measure a row against each of its peers."""
    try:
        case = row.prepare(quick)
    except ImportError as error:
        note = f"not measured, since it is not installed: {error.name or error}"
        return [Measured(row.name, row.work, "", row.threads, "", float("nan"), float("nan"), note=note)]
    with threadpool_limits(1, user_api="blas"):
        result, _ = once(case.ours)  # compiles and warms what is compiled and warmed once
        if not case.peers:
            ours = _times(case.ours, repeats)
            return [_judged(row, _alone(row, case, ours), quick, None)]
        return [_against(row, case, peer, result, quick, repeats) for peer in case.peers]


def growth(row: Row, repeats: int = REPEATS) -> dict[str, Any] | None:
    """How our processor time grows from small data to full, as an exponent of n; None for a row without a size."""
    prepare = row.grown or row.prepare
    small, full = prepare(True), prepare(False)
    if not small.n:
        return None
    seconds = []
    with threadpool_limits(1, user_api="blas"):
        for case in (small, full):
            case.ours()
            seconds.append(float(np.min(_times(case.ours, repeats), axis=0)[1]))
    exponent = float(np.log(seconds[1] / seconds[0]) / np.log(full.n / small.n))
    return {"row": row.name, "n": [small.n, full.n], "cpu_s": seconds, "exponent": exponent}


def _against(row: Row, case: Case, peer: Peer, result: Any, quick: bool, repeats: int) -> Measured:
    try:
        theirs, lasted = once(peer.run)
    except ImportError as error:
        return dataclasses.replace(
            _alone(row, case, _times(case.ours, repeats)), peer=peer.name, note=f"peer not installed: {error.name or error}"
        )
    disagreement = float(peer.disagreement(result, theirs))
    del theirs
    if 2.0 * lasted[0] > PATIENCE_S:
        pairs = [(once(case.ours)[1], lasted)]
    else:
        pairs = [(once(case.ours)[1], once(peer.run)[1]) for _ in range(_fitting(lasted[0], repeats))]
    ours = np.array([one for one, _ in pairs])
    other = np.array([two for _, two in pairs]) / peer.scale
    ratio, ratio_cpu = np.median(other / np.maximum(ours, 1e-9), axis=0)
    measured = dataclasses.replace(
        _alone(row, case, ours),
        peer=peer.name,
        peer_s=float(np.median(other[:, 0])),
        ratio=float(ratio),
        ratio_cpu=float(ratio_cpu),
        disagreement=disagreement,
        agrees=bool(disagreement <= peer.tolerance),
        peer_MiB=_peak(peer.run) if case.memory else None,
        note="; ".join(
            [f"{len(pairs)} of {repeats} repeats"] * (len(pairs) < repeats)
            + [f"peer extrapolated from {peer.scale:.2g} of the work"] * (peer.scale != 1.0)
        ),
    )
    return _judged(row, measured, quick, peer.goal)


def _alone(row: Row, case: Case, ours: Any) -> Measured:
    wall, cpu = np.median(ours, axis=0)
    peak = _peak(case.ours) if case.memory else None
    parts = ", ".join(f"{name} {seconds:.2g} s" for name, seconds in case.parts.items())
    return Measured(row.name, row.work, case.size, row.threads, "", float(wall), float(cpu), ours_MiB=peak, note=parts)


def _judged(row: Row, measured: Measured, quick: bool, goal: float | None) -> Measured:
    goals, reached = [], []
    if goal is not None and measured.ratio is not None:
        goals.append(f">= {goal:g} x")
        reached.append(measured.ratio >= goal)
    if row.goal_s is not None:
        goals.append(f"<= {row.goal_s:g} s")
        reached.append(measured.ours_s <= row.goal_s)
    if row.goal_extra_s is not None and measured.peer_s is not None:
        goals.append(f"<= + {row.goal_extra_s:g} s")
        reached.append(measured.ours_s - measured.peer_s <= row.goal_extra_s)
    return dataclasses.replace(measured, goal=", ".join(goals), reached=all(reached) if goals and not quick else None)


def once(work: Callable[[], Any]) -> tuple[Any, tuple[float, float]]:
    """Result of the work, and its wall-clock and processor time in s."""
    gc.collect()
    cpu, wall = time.process_time(), time.perf_counter()
    found = work()
    if isinstance(found, Timed):
        return found.result, (found.wall_s, found.cpu_s)
    return found, (time.perf_counter() - wall, time.process_time() - cpu)


def _fitting(seconds: float, repeats: int) -> int:
    return max(1, min(repeats, int(PATIENCE_S / max(seconds, 1e-9))))


def _times(work: Callable[[], Any], repeats: int) -> Any:
    first = once(work)[1]
    return np.array([first, *(once(work)[1] for _ in range(_fitting(first[0], repeats) - 1))])


def _peak(work: Callable[[], Any]) -> float:
    tracemalloc.start()
    try:
        work()
        return tracemalloc.get_traced_memory()[1] / 2**20
    finally:
        tracemalloc.stop()
