"""The exact LS-SVM on a torch device against torch's own Cholesky factor of the same matrix on the same device.

The ratio is the share of the Cholesky rate that is reached, kernel and all: the system is solved with one factor's work, n³/3
multiplications and additions, and a whole fit, its leave-one-out residuals included, with two. On a graphics card n is as large as
the peer's matrix and its factor allow, up to 100 000.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Iterator
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from experiments.speed.measure import Case, Peer, Row

Array = npt.NDArray[np.float64]
INPUTS: Final = 12
C, SIGMA = 100.0, 4.0
ON_CPU, QUICK, MOST = 4000, 600, 100_000
MATRICES: Final = 3  # that the peer is given room for: its matrix, the factor, and what it copies


def _case(factors: int) -> Callable[[bool], Case]:
    def prepare(quick: bool) -> Case:
        try:
            import torch
        except ImportError:
            return Case(lambda: None, [Peer("torch Cholesky", _absent, lambda ours, theirs: 0.0, 0.0)])
        from rlgcomp.compensation.models.kernels import kernel
        from rlgcomp.compensation.models.kkt_system import DeviceKKTSystem, device_named
        from rlgcomp.compensation.models.lssvm import LSSVMRegressor

        device = device_named("auto")
        n = _rows(device, quick)
        X, y = training_rows(n)
        matrix: list[Any] = []

        def ours() -> Array:
            with _one_thread():
                if factors == 1:
                    return DeviceKKTSystem("gaussian", {"sigma": SIGMA}, X, str(device), np.full(n, C)).solve(y)[0]
                return np.asarray(LSSVMRegressor(c=C, sigma=SIGMA, device=str(device)).fit(X, y).alpha_)

        def theirs() -> Any:
            with _one_thread():
                factor = torch.linalg.cholesky(matrix[0])
                if device.type == "cuda":
                    torch.cuda.synchronize(device)
                return factor

        def made() -> Any:
            """The peer's matrix, made when it is first needed, by the plain kernel, block of rows by block."""
            if not matrix:
                h = torch.empty((n, n), dtype=torch.float64, device=device)
                for k in range(0, n, 1000):
                    h[k : k + 1000] = torch.as_tensor(kernel("gaussian", {"sigma": SIGMA}, X[k : k + 1000], X), device=device)
                h.diagonal().add_(1.0 / C)
                matrix.append(h)
            return theirs()

        def apart(alpha: Array, factor: Any) -> float:
            right = torch.as_tensor(np.column_stack([np.ones(n), y]), device=device)
            ones, each = torch.cholesky_solve(right, factor).cpu().numpy().T
            expected = each - ones * (each.sum() / ones.sum())
            return float(np.abs(alpha - expected).max() / np.abs(expected).max())

        peer = Peer("torch Cholesky", made, apart, 1e-8, scale=1.0 / factors)
        return Case(ours, [peer], size=f"n = {n}, d = {INPUTS}, {device}", n=n)

    return prepare


def training_rows(n: int) -> tuple[Array, Array]:
    """Inputs, shape (n, INPUTS), and a noisy output, shape (n,)."""
    rng = np.random.default_rng(0)
    X = rng.normal(size=(n, INPUTS))
    return X, np.sin(X[:, 0]) + 0.1 * X[:, 1] + 0.1 * rng.normal(size=n)


def _absent() -> None:
    raise ImportError("torch", name="torch")


def _rows(device: Any, quick: bool) -> int:
    import torch

    if device.type != "cuda":
        return QUICK if quick else ON_CPU
    free = torch.cuda.mem_get_info(device)[0]
    most = math.isqrt(free // (8 * MATRICES)) // 1000 * 1000
    return min(10_000 if quick else MOST, most)


@contextlib.contextmanager
def _one_thread() -> Iterator[None]:
    """On a processor; a card does not care."""
    import torch

    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)


ROWS: Final = (
    Row("exact-torch", "exact LS-SVM solved on a torch device", _case(1)),
    Row("exact-torch-fit", "the same with its leave-one-out residuals, two factors' work", _case(2)),
)
