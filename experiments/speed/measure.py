"""How one row is measured: ours and each peer in turn, in the same run, and their results compared.

The ratio is the median over repeats of peer's time over ours, taken one after the other, so that whatever else the machine does
falls on both. Wall-clock and processor time are both kept, and goals are judged by both: on a busy machine the second is the
steadier one, but a ratio of it does not see the gain of a second thread.
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
PATIENCE_S: Final = 10.0  # by default, for all repeats of one side; what takes longer is run once


@dataclasses.dataclass(frozen=True)
class Timed:
    """Result of work that measures itself, in another process, with its wall-clock and processor time."""

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
    peak_MiB : callable, optional
        Most memory resident in the process of the last work, where that is another process.
    """

    ours: Callable[[], Any]
    peers: Sequence[Peer] = ()
    size: str = ""
    memory: bool = False
    n: int = 0
    parts: dict[str, float] = dataclasses.field(default_factory=dict)
    peak_MiB: Callable[[], float] | None = None


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
    sizes : sequence of callable
        () to Case, for growth over more than two sizes, in ascending order.
    goal_MiB : float, optional
        Memory at full size.
    long : bool
        It takes minutes: it is measured where it is named.
    """

    name: str
    work: str
    prepare: Callable[[bool], Case]
    threads: int = 1
    goal_s: float | None = None
    goal_extra_s: float | None = None
    grown: Callable[[bool], Case] | None = None
    sizes: Sequence[Callable[[], Case]] = ()
    goal_MiB: float | None = None
    long: bool = False


@dataclasses.dataclass(frozen=True)
class Measured:
    """One row against one peer; a row without peers has an empty peer's name.

    Times are medians in s, of the whole process for processor time; `ratio` is the median of paired ratios of wall-clock time.
    `reached` is whether its goals are reached by wall-clock time, `reached_cpu` by processor time, of which each thread takes its
    share. A row of which no number came has `failed`.
    """

    row: str
    work: str
    size: str
    threads: int
    peer: str
    ours_s: float
    ours_cpu_s: float
    peer_s: float | None = None
    peer_cpu_s: float | None = None
    ratio: float | None = None
    ratio_cpu: float | None = None
    goal: str = ""
    reached: bool | None = None
    reached_cpu: bool | None = None
    disagreement: float | None = None
    agrees: bool | None = None
    ours_MiB: float | None = None
    peer_MiB: float | None = None
    note: str = ""
    failed: bool = False

    def to_mapping(self) -> dict[str, Any]:
        """Plain mapping, for JSON."""
        return dataclasses.asdict(self)


def measure(row: Row, *, quick: bool = False, repeats: int = REPEATS, patience_s: float = PATIENCE_S) -> list[Measured]:
    """Measure a row against each of its peers.

    Parameters
    ----------
    row : Row
    quick : bool
        Small data, whose goals are not judged.
    repeats : int
        Of ours and of each peer.
    patience_s : float
        For all repeats of one side: there are fewer where these would take longer.
    """
    try:
        case = row.prepare(quick)
    except ImportError as error:
        note = f"not measured, since it is not installed: {error.name or error}"
        return [Measured(row.name, row.work, "", row.threads, "", float("nan"), float("nan"), note=note)]
    with threadpool_limits(1, user_api="blas"):
        result, first = once(case.ours)  # compiles and warms what is compiled and warmed once
        if not case.peers:
            ours = np.array([first]) if row.long else _times(case.ours, repeats, patience_s)
            return [_judged(row, _alone(row, case, ours), quick, None)]
        return [_against(row, case, peer, result, quick, repeats, patience_s) for peer in case.peers]


def growth(row: Row, repeats: int = REPEATS) -> dict[str, Any] | None:
    """How our processor time grows with the data, as an exponent of n over all sizes and from the last but one to the last.

    None for a row without a size. `MiB` is the most memory resident, of work that is a process of its own.
    """
    prepare = row.grown or row.prepare
    sizes = row.sizes or (lambda: prepare(True), lambda: prepare(False))
    numbers, seconds, peaks = [], [], []
    with threadpool_limits(1, user_api="blas"):
        for size in sizes:
            case = size()
            if not case.n:
                return None
            if case.peak_MiB is None:
                case.ours()  # compiles and warms what is compiled and warmed once
            numbers.append(case.n)
            seconds.append(float(np.min(_times(case.ours, repeats), axis=0)[1]))
            peaks += [] if case.peak_MiB is None else [case.peak_MiB()]

    def exponent(first: int) -> float:
        return float(np.log(seconds[-1] / seconds[first]) / np.log(numbers[-1] / numbers[first]))

    return {"row": row.name, "n": numbers, "cpu_s": seconds, "exponent": exponent(0), "last_exponent": exponent(-2), "MiB": peaks}


def _against(row: Row, case: Case, peer: Peer, result: Any, quick: bool, repeats: int, patience_s: float) -> Measured:
    try:
        theirs, lasted = once(peer.run)
    except ImportError as error:
        alone = _alone(row, case, _times(case.ours, repeats, patience_s))
        return dataclasses.replace(alone, peer=peer.name, note=f"peer not installed: {error.name or error}")
    disagreement = float(peer.disagreement(result, theirs))
    del theirs
    if 2.0 * min(lasted) > patience_s:
        pairs = [(once(case.ours)[1], lasted)]
    else:
        pairs = [(once(case.ours)[1], once(peer.run)[1]) for _ in range(_fitting(lasted, repeats, patience_s))]
    ours = np.array([one for one, _ in pairs])
    other = np.array([two for _, two in pairs]) / peer.scale
    ratios = other / np.maximum(ours, 1e-9)
    ratio, ratio_cpu = np.median(ratios, axis=0)
    measured = dataclasses.replace(
        _alone(row, case, ours),
        peer=peer.name,
        peer_s=float(np.median(other[:, 0])),
        peer_cpu_s=float(np.median(other[:, 1])),
        ratio=float(ratio),
        ratio_cpu=float(ratio_cpu),
        disagreement=disagreement,
        agrees=bool(disagreement <= peer.tolerance),
        peer_MiB=_peak(peer.run) if case.memory else None,
        note="; ".join(
            [f"{len(pairs)} of {repeats} repeats"] * (len(pairs) < repeats)
            + [f"ratios {ratios[:, 0].min():.3g} to {ratios[:, 0].max():.3g}"] * (len(pairs) > 1)
            + [f"peer extrapolated from {peer.scale:.2g} of the work"] * (peer.scale != 1.0)
        ),
    )
    return _judged(row, measured, quick, peer.goal)


def _alone(row: Row, case: Case, ours: Any) -> Measured:
    wall, cpu = np.median(ours, axis=0)
    peak = _peak(case.ours) if case.memory else None if case.peak_MiB is None else case.peak_MiB()
    parts = ", ".join(f"{name} {seconds:.2g} s" for name, seconds in case.parts.items())
    return Measured(row.name, row.work, case.size, row.threads, "", float(wall), float(cpu), ours_MiB=peak, note=parts)


def _judged(row: Row, measured: Measured, quick: bool, goal: float | None) -> Measured:
    goals: list[str] = []
    reached: list[tuple[bool, bool]] = []  # by wall-clock and by processor time
    share_s = measured.ours_cpu_s / row.threads
    if goal is not None and measured.ratio is not None and measured.ratio_cpu is not None:
        goals.append(f">= {goal:g} x")
        reached.append((measured.ratio >= goal, measured.ratio_cpu >= goal))
    if row.goal_s is not None:
        goals.append(f"<= {row.goal_s:g} s")
        reached.append((measured.ours_s <= row.goal_s, share_s <= row.goal_s))
    if row.goal_extra_s is not None and measured.peer_s is not None and measured.peer_cpu_s is not None:
        goals.append(f"<= + {row.goal_extra_s:g} s")
        longest = [theirs + row.goal_extra_s for theirs in (measured.peer_s, measured.peer_cpu_s)]
        reached.append((measured.ours_s <= longest[0], share_s <= longest[1]))
    if row.goal_MiB is not None and measured.ours_MiB is not None:
        goals.append(f"<= {row.goal_MiB:g} MiB")
        reached.append((measured.ours_MiB <= row.goal_MiB,) * 2)
    if not goals or quick:
        return dataclasses.replace(measured, goal=", ".join(goals))
    by_wall, by_cpu = (all(one) for one in zip(*reached, strict=True))
    return dataclasses.replace(measured, goal=", ".join(goals), reached=by_wall, reached_cpu=by_cpu)


def failed(row: Row, error: Exception) -> Measured:
    """A row whose measurement ended with an error."""
    lines = str(error).splitlines() or [""]
    note = f"failed: {type(error).__name__}: {lines[0]}"
    return Measured(row.name, row.work, "", row.threads, "", float("nan"), float("nan"), note=note, failed=True)


def once(work: Callable[[], Any]) -> tuple[Any, tuple[float, float]]:
    """Result of the work, and its wall-clock and processor time in s."""
    gc.collect()
    cpu, wall = time.process_time(), time.perf_counter()
    found = work()
    if isinstance(found, Timed):
        return found.result, (found.wall_s, found.cpu_s)
    return found, (time.perf_counter() - wall, time.process_time() - cpu)


def _fitting(lasted: tuple[float, float], repeats: int, patience_s: float) -> int:
    """How often work is repeated; that other processes are in its way makes it no longer."""
    return max(1, min(repeats, int(patience_s / max(min(lasted), 1e-9))))


def _times(work: Callable[[], Any], repeats: int, patience_s: float = PATIENCE_S) -> Any:
    first = once(work)[1]
    return np.array([first, *(once(work)[1] for _ in range(_fitting(first, repeats, patience_s) - 1))])


def _peak(work: Callable[[], Any]) -> float:
    tracemalloc.start()
    try:
        work()
        return tracemalloc.get_traced_memory()[1] / 2**20
    finally:
        tracemalloc.stop()
