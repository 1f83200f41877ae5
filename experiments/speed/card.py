"""The exact LS-SVM on a torch device by number of rows, as a share of the device's own Cholesky rate.

`python -m experiments.speed.card --rows 20000 --rows 50000 --rows 100000` prints one table.
"""

from __future__ import annotations

import math
import statistics
import time
from collections.abc import Callable
from typing import Annotated, Any, Final

import numpy as np
import typer

from experiments.speed.exact import SIGMA, Array, C, training_rows
from rlgcomp.compensation.models.kkt_system import DeviceKKTSystem, device_named

HEADER: Final = (
    "rows",
    "kernel and solution s",
    "with leave-one-out s",
    "torch Cholesky s",
    "our 10¹² operations/s",
    "share of torch's rate",
    "memory GiB",
    "largest residual",
)
BLOCK: Final = 2000  # rows of the kernel made at once


def main(
    rows: Annotated[list[int], typer.Option("--rows", min=2, help="Numbers of rows, ascending; may be repeated.")],
    device: Annotated[str, typer.Option(help="auto, cpu, cuda or cuda:0.")] = "auto",
    repeats: Annotated[int, typer.Option(min=1, help="Whose median is taken, after one that is not counted.")] = 3,
) -> None:
    """A factor takes n³/3 operations. Where matrix and factor do not fit, the share is of torch's rate at the last size that did.

    Residuals are those of the equations, H alpha + b - y, over the largest y.
    """
    import torch

    place = device_named(device)
    on_card = place.type == "cuda"
    name = torch.cuda.get_device_name(place) if on_card else f"{torch.get_num_threads()} threads"
    typer.echo(f"{place} ({name}), torch {torch.__version__}\n\n| {' | '.join(HEADER)} |\n|{'---|' * len(HEADER)}")
    peer_rate = math.nan
    for n in rows:
        X, y = training_rows(n)
        if on_card:
            torch.cuda.reset_peak_memory_stats(place)
        solution_s, (alpha, intercept) = median_s(lambda X=X, y=y: _system(X, place).solve(y), place, repeats)
        fit_s, _ = median_s(lambda X=X, y=y: _fit(X, y, place), place, repeats)
        memory_GiB = torch.cuda.max_memory_allocated(place) / 2**30 if on_card else math.nan
        residual = _largest_residual(X, y, alpha, float(intercept[0]), place)
        peer_s = _cholesky_s(X, place, repeats)
        operations = n**3 / 3.0
        peer_rate = operations / peer_s if math.isfinite(peer_s) else peer_rate
        peer = f"{peer_s:.3g}" if math.isfinite(peer_s) else "does not fit"
        rate = operations / solution_s
        cells = (n, f"{solution_s:.3g}", f"{fit_s:.3g}", peer, f"{rate / 1e12:.3g}", f"{rate / peer_rate:.2f}")
        typer.echo(f"| {' | '.join(map(str, cells))} | {memory_GiB:.3g} | {residual:.1e} |")


def median_s(work: Callable[[], Any], place: Any, repeats: int) -> tuple[float, Any]:
    """Median wall-clock time of the work in s, after one run that is not counted, and its result."""
    import torch

    times, result = [], work()
    for _ in range(repeats):
        if place.type == "cuda":
            torch.cuda.synchronize(place)
        start = time.perf_counter()
        result = work()
        if place.type == "cuda":
            torch.cuda.synchronize(place)
        times.append(time.perf_counter() - start)
    return statistics.median(times), result


def _system(X: Array, place: Any) -> DeviceKKTSystem:
    return DeviceKKTSystem("gaussian", {"sigma": SIGMA}, X, str(place), np.full(len(X), C))


def _fit(X: Array, y: Array, place: Any) -> tuple[Any, Array]:
    system = _system(X, place)
    return system.solve(y), system.inverse_diagonal()


def _kernel(X: Any, rows: slice) -> Any:
    """Rows of the Gaussian kernel from differences, input by input, and not from products as the system's are."""
    import torch

    squares = torch.zeros((len(X[rows]), len(X)), dtype=torch.float64, device=X.device)
    for column in X.T:
        squares += (column[rows, None] - column).square_()
    return squares.mul_(-0.5 / SIGMA**2).exp_()


def _largest_residual(X: Array, y: Array, alpha: Array, intercept: float, place: Any) -> float:
    import torch

    at, weights = torch.as_tensor(X, device=place), torch.as_tensor(alpha, device=place)
    sums = [(_kernel(at, slice(k, k + BLOCK)) @ weights).cpu().numpy() for k in range(0, len(X), BLOCK)]
    return float(np.abs(np.concatenate(sums) + alpha / C + intercept - y).max() / np.abs(y).max())


def _cholesky_s(X: Array, place: Any, repeats: int) -> float:
    """Seconds of torch's own factor of the same matrix; not a number where the two do not fit."""
    import torch

    at = torch.as_tensor(X, device=place)
    try:
        matrix = torch.empty((len(X), len(X)), dtype=torch.float64, device=place)
        for k in range(0, len(X), BLOCK):
            matrix[k : k + BLOCK] = _kernel(at, slice(k, k + BLOCK))
        matrix.diagonal().add_(1.0 / C)
        return median_s(lambda: torch.linalg.cholesky(matrix), place, repeats)[0]
    except RuntimeError as error:
        if "out of memory" not in str(error) and "allocate" not in str(error):
            raise
        return math.nan
    finally:
        matrix = None
        if place.type == "cuda":
            torch.cuda.empty_cache()


if __name__ == "__main__":
    typer.run(main)
