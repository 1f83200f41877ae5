r"""The KKT system of the LS-SVM, solved by LAPACK or, for many rows, on a torch device.

In Suykens' notation, for n rows with kernel matrix :math:`\Omega_{ij} = K(x_i, x_j)`, regularisation :math:`\gamma` (`c` in this
package) and weights :math:`v_i`,

.. math:: \begin{pmatrix} 0 & 1^T \\ 1 & H \end{pmatrix} \begin{pmatrix} b \\ \alpha \end{pmatrix} =
          \begin{pmatrix} 0 \\ y \end{pmatrix}, \qquad H = \Omega + \mathrm{diag}(1 / \gamma v_i).

Further columns may stand beside the intercept's: see :mod:`rlgcomp.compensation.models.border`.

The lower right block of the inverse is :math:`C = H^{-1} - H^{-1}11^TH^{-1} / 1^TH^{-1}1`. It gives :math:`\alpha = C y` and the
residuals without a group G of rows, :math:`e_G = C_{GG}^{-1} \alpha_G`, from the same solution.

:class:`KKTSystem` keeps C, n² numbers. :class:`DeviceKKTSystem` keeps the lower triangle of H in panels of columns, each from its
diagonal block down, and factors it in place, :math:`H = L L^T`: n²/2 numbers and a few panels, 40 GB at n = 100 000 where a matrix
takes 80 GB and a library's factor as much again. Nearly all of its n³/3 multiplications are products of panels. No operation
touches 2³¹ numbers or has a leading dimension beyond a panel's. With :math:`u = L^{-1}1` and :math:`z = L^{-1}y` the solution is
:math:`b = u \cdot z / u \cdot u`, :math:`\alpha = L^{-T}(z - b u)`; the diagonal of C comes from the columns of :math:`L^{-1}`, a
panel at a time: n³/3 again.

References
----------
J. A. K. Suykens et al., *Least Squares Support Vector Machines*, World Scientific, 2002, chapter 3.
G. C. Cawley, N. L. C. Talbot, Neural Networks 17, 1467 (2004) (leave-one-out in closed form).
"""

from __future__ import annotations

import contextlib
import re
from collections.abc import Iterator, Mapping
from typing import Any, Final

import numpy as np
import numpy.typing as npt
from scipy import linalg

from rlgcomp.compensation.models.border import Border
from rlgcomp.compensation.models.coefficient_prior import coefficient_variance
from rlgcomp.compensation.models.run_biases import gain, restricted_likelihood
from rlgcomp.errors import InputError

Array = npt.NDArray[np.float64]
Tensor = Any
_DEVICES: Final = re.compile(r"auto|cpu|cuda(:[0-9]{1,3})?")
_NO_MEMORY: Final = re.compile("out of memory|allocate memory")
PANEL_WIDTH: Final = {"cpu": 384, "cuda": 2048}  # columns: small panels waste less, large ones keep a card busy
BATCH: Final = 1 << 24  # kernel values in memory while predicting


class KKTSystem:
    """H, inverted on the processor.

    Parameters
    ----------
    gram : ndarray, shape (n, n)
        The kernel matrix Omega.
    c : ndarray, shape (n,)
        gamma v, row by row.
    border : Border, optional
        By default the intercept alone.
    """

    def __init__(self, gram: Array, c: Array, border: Border | None = None) -> None:
        n = len(gram)
        self._columns = Border.of(np.empty((n, 0))) if border is None else border
        h = gram + np.diag(1.0 / c)
        try:
            inverse = linalg.cho_solve(linalg.cho_factor(h, lower=True, check_finite=False), np.eye(n), check_finite=False)
        except linalg.LinAlgError:
            # H is not positive definite: beyond rounding only if the kernel is indefinite (sigmoid); rounded eigenvalues are lifted
            values, vectors = linalg.eigh(h, check_finite=False)
            rounding = n * np.finfo(np.float64).eps * np.abs(values).max()
            values = np.where(np.abs(values) <= rounding, max(rounding, float(np.min(1.0 / c))), values)
            inverse = (vectors / values) @ vectors.T
        self._border = inverse @ self._columns.basis
        self._total = self._columns.basis.T @ self._border
        inverse -= self._border @ linalg.solve(self._total, self._border.T, assume_a="sym")
        self._inverse = inverse
        self._effects: list[tuple[Array, Array, Array]] = []  # columns, what gives their coefficients, and the covariance of these

    def restricted_likelihood(self, Z: Array, y: Array) -> float:
        """rho of greatest restricted likelihood for runs of the indicator Z, shape (n, runs), and the output y, shape (n,)."""
        applied, alpha = self._inverse @ Z, self._inverse @ y
        rows = len(y) - self._border.shape[1] + 1
        return float(restricted_likelihood((Z.T @ applied)[None], (Z.T @ alpha)[None], np.array([y @ alpha]), rows)[0])

    def coefficient_variance(self, P: Array, y: Array, share: float) -> float:
        """v of the columns P, shape (n, k), for the output y: see :mod:`rlgcomp.compensation.models.coefficient_prior`."""
        applied, alpha = self._inverse @ P, self._inverse @ y
        M, g, q = (P.T @ applied)[None], (P.T @ alpha)[None], np.array([y @ alpha])
        return float(coefficient_variance(share, M, g, q, float(np.var(y)), len(y) - self._border.shape[1])[0])

    def add_effects(self, Z: Array, rho: float) -> None:
        """Border the system with columns, shape (n, k), of runs or of inputs, whose coefficients have the variance rho."""
        applied = self._inverse @ Z
        K = gain(np.array([rho]), (Z.T @ applied)[None])[0]
        across = Z.T @ self._border
        full = applied + self._border @ linalg.solve(self._total, across.T, assume_a="sym")  # H^-1 Z
        border = self._border - full @ gain(np.array([rho]), (Z.T @ full)[None])[0] @ across
        self._inverse -= applied @ K @ applied.T
        self._effects.append((Z, K @ applied.T, K))
        self._border, self._total = border, self._columns.basis.T @ border

    def solve(self, y: Array) -> tuple[Array, Array]:
        """alpha, shape (n,), and b and the border's coefficients, shape (1 + columns,), for the output y, shape (n,)."""
        return self._inverse @ y, self._columns.back @ linalg.solve(self._total, self._border.T @ y, assume_a="sym")

    def coefficient_variances(self) -> Array:
        """Variances of b and the border's coefficients in units of the function's scale s squared, shape (1 + columns,)."""
        back = self._columns.back
        return np.asarray(np.einsum("ij,ji->i", back, linalg.solve(self._total, back.T, assume_a="sym")))

    def effect_sizes(self, y: Array) -> list[Array]:
        """Coefficients of the columns that were added, in the order in which they were."""
        sizes: list[Array] = []
        for columns, applied, _ in reversed(self._effects):  # each of what those after it leave
            sizes.insert(0, applied @ y)
            y = y - columns @ sizes[0]
        return sizes

    def effect_variances(self) -> Array:
        """Variances of the coefficients of the columns added first, as :meth:`coefficient_variances`; the runs' come second."""
        (_, applied, own), *runs = self._effects
        variances = np.diag(own).copy()
        for Z, _, of_runs in runs:
            across = applied @ Z
            variances += np.einsum("ij,jk,ik->i", across, of_runs, across)
        return variances

    def inverse_diagonal(self) -> Array:
        """Diagonal of C, shape (n,)."""
        return np.diag(self._inverse)

    def leave_groups_out(self, alpha: Array, groups: npt.NDArray[np.generic], skipped: int | None = None) -> Array:
        """Residual of each row without its whole group, shape (n,); zero in the group of the label `skipped`."""
        residuals = np.zeros(len(alpha))
        for label in np.unique(groups):
            if label == skipped:
                continue
            rows = np.flatnonzero(groups == label)
            residuals[rows] = linalg.solve(self._inverse[np.ix_(rows, rows)], alpha[rows], assume_a="sym")
        return residuals


def variance_reduction(h: Array, across: Array, border: Border, columns: Array) -> Array:
    """By how much the training rows reduce the variance of further rows, shape (m,).

    Parameters
    ----------
    h : ndarray, shape (n, n)
        H, with the covariance of the runs' biases.
    across : ndarray, shape (m, n)
        Kernel between the further rows and the training rows.
    border : Border
    columns : ndarray, shape (m, k)
        The border's columns of the further rows.
    """
    solved = linalg.solve(h, np.column_stack([border.basis, across.T]), assume_a="sym")
    of_border, each = np.split(solved, [border.basis.shape[1]], axis=1)
    rest = np.column_stack([np.ones(len(across)), columns]) @ border.back - across @ of_border
    uncertain = linalg.solve(border.basis.T @ of_border, rest.T, assume_a="sym")
    return np.asarray(np.einsum("ij,ji->i", across, each) - np.einsum("ij,ji->i", rest, uncertain))


class DeviceKKTSystem:
    """H, factored on a torch device.

    Parameters
    ----------
    kernel : {"gaussian", "linear", "polynomial", "sigmoid"}
    parameters : mapping
        Those that the kernel takes.
    X : ndarray, shape (n, features)
    device : str
    c : ndarray, shape (n,)
        gamma v, row by row.

    Raises
    ------
    InputError
        The device is missing or too small, or H is not positive definite.
    """

    def __init__(self, kernel: str, parameters: Mapping[str, Any], X: Array, device: str, c: Array) -> None:
        self._device = device_named(device)
        import torch

        self._kernel, self._parameters = kernel, parameters
        self._n = len(X)
        self._width = PANEL_WIDTH[self._device.type]
        with self._memory():
            self._X = _tensor(X, self._device)
            self._panels = self._factored(1.0 / _tensor(c, self._device))
            self._ones = self._forward(torch.ones((self._n, 1), dtype=torch.float64, device=self._device))

    def solve(self, y: Array) -> tuple[Array, Array]:
        """alpha, shape (n,), and b, shape (1,), for the output y, shape (n,)."""
        with self._memory():
            z = self._forward(_tensor(y, self._device)[:, None].clone())
            u = self._ones
            intercept = float((u * z).sum() / (u * u).sum())
            return _numpy(self._backward(z - intercept * u)[:, 0]), np.array([intercept])

    def inverse_diagonal(self) -> Array:
        """Diagonal of C, shape (n,)."""
        import torch

        with self._memory():
            border = self._backward(self._ones.clone())[:, 0]
            diagonal = -(border**2) / border.sum()
            for start, stop in self._spans():
                columns = torch.zeros((self._n - start, stop - start), dtype=torch.float64, device=self._device)
                columns.fill_diagonal_(1.0)
                diagonal[start:stop] += self._forward(columns, start).square_().sum(dim=0)
            return _numpy(diagonal)

    def leave_groups_out(self, alpha: Array, groups: npt.NDArray[Any]) -> Array:
        """Residual of each row without its whole group, shape (n,), in memory of the largest group's square."""
        import torch

        residuals = np.empty(self._n)
        with self._memory():
            border = self._backward(self._ones.clone())[:, 0]
            for label in np.unique(groups):
                rows = np.flatnonzero(groups == label)
                out = torch.as_tensor(rows, device=self._device)
                block = torch.outer(border[out], -border[out] / border.sum())
                for k in range(0, len(rows), self._width):
                    part = slice(k, k + self._width)
                    start = int(rows[k]) // self._width * self._width  # columns of the identity are zero above
                    columns = torch.zeros((self._n - start, len(rows[part])), dtype=torch.float64, device=self._device)
                    columns[out[part] - start, torch.arange(columns.shape[1], device=self._device)] = 1.0
                    whole = torch.zeros((self._n, columns.shape[1]), dtype=torch.float64, device=self._device)
                    whole[start:] = self._forward(columns, start)
                    block[:, part] += self._backward(whole)[out]
                right = _tensor(alpha[rows], self._device)
                residuals[rows] = _numpy(torch.linalg.solve(block, right))
        return residuals

    def variance_reduction(self, X: Array) -> Array:
        """k^T H⁻¹ k - (1 - 1^T H⁻¹ k)² / 1^T H⁻¹ 1 for each row of X, shape (m, features)."""
        values = np.empty(len(X))
        with self._memory():
            at = _tensor(X, self._device)
            for k in range(0, len(X), self._width):
                part = slice(k, k + self._width)
                v = self._forward(_gram(self._kernel, self._parameters, self._X, at[part]))
                rest = 1.0 - (self._ones * v).sum(dim=0)
                values[part] = _numpy((v * v).sum(dim=0) - rest**2 / (self._ones**2).sum())
        return values

    # --- panels --------------------------------------------------------------------------------------------------------------

    def _spans(self) -> Iterator[tuple[int, int]]:
        for start in range(0, self._n, self._width):
            yield start, min(start + self._width, self._n)

    def _factored(self, ridge: Tensor) -> list[Tensor]:
        """L, panel by panel: each made, reduced by those before it, and factored in its place."""
        import torch

        panels: list[Tensor] = []
        for start, stop in self._spans():
            panel = _gram(self._kernel, self._parameters, self._X[start:], self._X[start:stop])
            panel.diagonal().add_(ridge[start:stop])
            for k, before in enumerate(panels):
                lower = before[start - k * self._width :]
                panel.addmm_(lower, lower[: stop - start].T, alpha=-1.0)
            corner, failed = torch.linalg.cholesky_ex(panel[: stop - start])
            if int(failed):
                raise InputError(
                    f"the {self._kernel} kernel's matrix is not positive definite beyond rounding, as device={self._device.type!r} "
                    "requires; give a smaller c, the gaussian kernel, or device=None for up to some 10 000 rows"
                )
            panel[: stop - start] = corner
            if stop < self._n:
                below = panel[stop - start :]
                below.copy_(torch.linalg.solve_triangular(corner.T, below, upper=True, left=False))
            panels.append(panel)
        return panels

    def _forward(self, right: Tensor, first: int = 0) -> Tensor:
        """L⁻¹ right in place; `right` has the rows from `first`, a panel's beginning; those before are zero."""
        import torch

        for panel, (start, stop) in zip(self._panels, self._spans(), strict=True):
            if start < first:
                continue
            here = right[start - first : stop - first]
            here.copy_(torch.linalg.solve_triangular(panel[: stop - start], here, upper=False))
            right[stop - first :].addmm_(panel[stop - start :], here, alpha=-1.0)
        return right

    def _backward(self, right: Tensor) -> Tensor:
        """L^-T right in place."""
        import torch

        for panel, (start, stop) in reversed(list(zip(self._panels, self._spans(), strict=True))):
            here = right[start:stop]
            here.addmm_(panel[stop - start :].T, right[stop:], alpha=-1.0)
            here.copy_(torch.linalg.solve_triangular(panel[: stop - start].T, here, upper=True))
        return right

    @contextlib.contextmanager
    def _memory(self) -> Iterator[None]:
        """Turn torch's errors of memory into an `InputError` with advice."""
        try:
            yield
        except RuntimeError as error:
            if not _NO_MEMORY.search(str(error)):
                raise
            raise InputError(
                f"{self._n} rows do not fit into the memory of {self._device}: they need {self._n**2 * 4 / 1e9:.1f} GB and some "
                "panels; average over a longer time, or train a fixed-size model"
            ) from None


def predictions(kernel: str, parameters: Mapping[str, Any], X: Array, centres: Array, alpha: Array, device: str) -> Array:
    """Kernel sums on a device; the last bits of a row depend on the rows it is computed with.

    Parameters
    ----------
    kernel : {"gaussian", "linear", "polynomial", "sigmoid"}
    parameters : mapping
        Those that the kernel takes.
    X : ndarray, shape (m, features)
    centres : ndarray, shape (n, features)
    alpha : ndarray, shape (n,)
        Their sum is zero.
    device : str

    Returns
    -------
    ndarray, shape (m,)
        sum_i alpha_i K(x_i, x) for each row of X.
    """
    import torch

    place = device_named(device)
    at, rows, weights = (_tensor(values, place) for values in (X, centres, alpha))
    sums = np.empty(len(X))
    block = max(1, BATCH // len(centres))
    for k in range(0, len(X), block):
        part = at[k : k + block]
        if kernel == "gaussian":  # differences, not products, and less one: without cancellation
            values = torch.zeros((len(part), len(centres)), dtype=torch.float64, device=place)
            for j in range(X.shape[1]):
                values += (part[:, j, None] - rows[:, j]).square_()
            values.mul_(-0.5 / parameters["sigma"] ** 2).expm1_()
        else:
            values = _gram(kernel, parameters, part, rows)
        sums[k : k + block] = _numpy(values @ weights)
    return sums


def _gram(kernel: str, parameters: Mapping[str, Any], x: Tensor, z: Tensor) -> Tensor:
    """The kernel of :mod:`rlgcomp.compensation.models.kernels` on the device, shape (n, m)."""
    products = x @ z.T
    if kernel == "gaussian":
        products.mul_(-2.0).add_((x * x).sum(dim=1)[:, None]).add_((z * z).sum(dim=1)).clamp_(min=0.0)
        return products.mul_(-0.5 / parameters["sigma"] ** 2).exp_()
    if kernel == "polynomial":
        return products.add_(parameters["offset"]).pow_(parameters["degree"])
    if kernel == "sigmoid":
        return products.mul_(parameters["slope"]).add_(parameters["offset"]).tanh_()
    return products


def _tensor(values: npt.ArrayLike, device: Any) -> Tensor:
    import torch

    return torch.as_tensor(np.require(values, np.float64, ["C", "W"]), device=device)  # read-only ones torch warns of


def _numpy(tensor: Tensor) -> Array:
    return np.asarray(tensor.cpu().numpy(), dtype=np.float64)


def require_device(owner: Any) -> None:
    """Raise unless an estimator's `device` names one, present or not.

    Raises
    ------
    InputError
        It is neither None, "auto", "cpu", "cuda" nor "cuda:" and a number.
    """
    value = owner.device
    if value is not None and not (isinstance(value, str) and _DEVICES.fullmatch(value)):
        raise InputError(
            f"The 'device' parameter of {type(owner).__name__} must be None, 'auto', 'cpu', 'cuda' or 'cuda:0'. "
            f"Got {value!r} instead."
        )


def device_named(name: str) -> Any:
    """The torch device of this name; "auto" is a graphics card where there is one.

    Raises
    ------
    InputError
        torch is not installed, or the device is missing.
    """
    try:
        import torch
    except ImportError:
        raise InputError(
            f'device={name!r} needs torch, which is not installed; pip install "rlgcomp[torch]", or leave it out'
        ) from None
    wanted = ("cuda" if torch.cuda.is_available() else "cpu") if name == "auto" else name
    try:
        torch.empty(1, dtype=torch.float64, device=wanted)
    except (RuntimeError, AssertionError) as error:
        reason = str(error).splitlines()[0]
        raise InputError(
            f"device={name!r} is not available to torch {torch.__version__}: {reason}; give 'cpu', or leave it out"
        ) from None
    return torch.device(wanted)
