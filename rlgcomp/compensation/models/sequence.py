r"""A small neural network over the sequence of feature rows: causal dilated convolutions, trained with torch, run with numpy.

.. math:: h^{(l)}_t = \tanh\Big( \sum_{k=0}^{2} W^{(l)}_k\, h^{(l-1)}_{t - k d_l} + b^{(l)} \Big), \qquad
          \hat y_t = u \cdot h^{(L)}_t + v \cdot x_t

with dilations d = 1, 4, 16, so that an output depends on 43 rows: 72 min of 100 s means. Before the first row the
input equals that of the first row.

Reference
---------
S. Bai, J. Z. Kolter, V. Koltun, An empirical evaluation of generic convolutional and recurrent networks for sequence modeling,
arXiv:1803.01271 (2018).
"""

from __future__ import annotations

import itertools
from typing import ClassVar, Final, Self

import numpy as np
import numpy.typing as npt
from sklearn.base import BaseEstimator, RegressorMixin
from sklearn.utils.validation import check_is_fitted, validate_data

from rlgcomp.compensation.models.specification import ModelSpecification, require_number, require_shape
from rlgcomp.errors import InputError

Array = npt.NDArray[np.float64]
_DILATIONS: Final = (1, 4, 16)
_TAPS: Final = 3
_LEARNING_RATE: Final = 0.01


class SequenceRegressor(RegressorMixin, BaseEstimator):  # type: ignore[misc]
    """Causal convolutional network. Rows are in time order; `groups` labels the recording of each row.

    Parameters
    ----------
    width : int, default 8
        Channels of each layer.
    weight_decay : float, default 1e-3
    epochs : int, default 300
    seed : int, default 0

    Attributes
    ----------
    kernels_ : list of ndarray, shape (taps, in, out)
    biases_ : list of ndarray, shape (out,)
    readout_ : ndarray, shape (width,)
    skip_ : ndarray, shape (features,)
    x_mean_, x_scale_ : ndarray, shape (features,)
    y_mean_, y_scale_ : float
        Scaling of inputs and output.

    Raises
    ------
    InputError
        torch is not installed: `pip install "rlgcomp[torch]"`. Only fitting needs it.
    """

    reads_sequences: ClassVar[bool] = True

    def __init__(self, width: int = 8, *, weight_decay: float = 1e-3, epochs: int = 300, seed: int = 0) -> None:
        self.width = width
        self.weight_decay = weight_decay
        self.epochs = epochs
        self.seed = seed

    def fit(self, X: npt.ArrayLike, y: npt.ArrayLike, groups: npt.ArrayLike | None = None) -> Self:
        """Train on all recordings at once.

        Parameters
        ----------
        X : array_like, shape (n, features)
        y : array_like, shape (n,)
        groups : array_like, shape (n,), optional
            Label of each row's recording; by default all rows are one.
        """
        require_number(self, "width", low=1, whole=True)
        require_number(self, "weight_decay", low=0.0)
        require_number(self, "epochs", low=1, whole=True)
        rows, outputs = validate_data(self, X, y, dtype=np.float64, y_numeric=True, ensure_min_samples=2)
        try:
            import torch
        except ImportError:
            raise InputError(
                'the sequence model is trained with torch, which is not installed; pip install "rlgcomp[torch]"'
            ) from None
        labels = np.zeros(len(outputs)) if groups is None else np.asarray(groups)
        self.x_mean_, self.y_mean_ = rows.mean(axis=0), float(outputs.mean())
        self.x_scale_ = np.where(rows.std(axis=0) > 0.0, rows.std(axis=0), 1.0)
        self.y_scale_ = float(outputs.std()) or 1.0
        runs = [np.flatnonzero(labels == label) for label in np.unique(labels)]
        inputs = [torch.tensor((rows[run] - self.x_mean_) / self.x_scale_) for run in runs]
        targets = [torch.tensor((outputs[run] - self.y_mean_) / self.y_scale_) for run in runs]

        generator = torch.Generator().manual_seed(int(self.seed))
        sizes = [rows.shape[1], *([self.width] * len(_DILATIONS))]
        kernels = [
            torch.nn.Parameter(torch.randn(_TAPS, a, b, generator=generator, dtype=torch.float64) / (_TAPS * a) ** 0.5)
            for a, b in itertools.pairwise(sizes)
        ]
        biases = [torch.nn.Parameter(torch.zeros(size, dtype=torch.float64)) for size in sizes[1:]]
        readout = torch.nn.Parameter(torch.zeros(sizes[-1], dtype=torch.float64))
        skip = torch.nn.Parameter(torch.zeros(rows.shape[1], dtype=torch.float64))
        weights = [*kernels, *biases, readout, skip]
        optimiser = torch.optim.AdamW(weights, lr=_LEARNING_RATE, weight_decay=self.weight_decay)
        schedule = torch.optim.lr_scheduler.OneCycleLR(optimiser, _LEARNING_RATE, total_steps=self.epochs + 1)
        threads = torch.get_num_threads()
        torch.set_num_threads(1)
        try:
            for _ in range(self.epochs):
                optimiser.zero_grad()
                loss = torch.zeros((), dtype=torch.float64)
                for x, target in zip(inputs, targets, strict=True):
                    hidden = x
                    for taps, bias, dilation in zip(kernels, biases, _DILATIONS, strict=True):
                        total = bias + hidden @ taps[0]
                        for k in range(1, _TAPS):
                            back = torch.clamp(torch.arange(len(hidden)) - k * dilation, min=0)
                            total = total + hidden[back] @ taps[k]
                        hidden = torch.tanh(total)
                    loss = loss + torch.sum((hidden @ readout + x @ skip - target) ** 2)
                (loss / len(outputs)).backward()
                optimiser.step()
                schedule.step()
        finally:
            torch.set_num_threads(threads)
        self.kernels_ = [taps.detach().numpy().copy() for taps in kernels]
        self.biases_ = [bias.detach().numpy().copy() for bias in biases]
        self.readout_, self.skip_ = readout.detach().numpy().copy(), skip.detach().numpy().copy()
        return self

    def predict(self, X: npt.ArrayLike) -> Array:
        """Predict one recording's rows, in time order.

        Parameters
        ----------
        X : array_like, shape (m, features)

        Returns
        -------
        ndarray, shape (m,)
        """
        check_is_fitted(self)
        rows = validate_data(self, X, dtype=np.float64, reset=False)
        x = (rows - self.x_mean_) / self.x_scale_
        hidden = x
        for taps, bias, dilation in zip(self.kernels_, self.biases_, _DILATIONS, strict=True):
            total = bias + hidden @ taps[0]
            for k in range(1, _TAPS):
                total = total + hidden[np.maximum(np.arange(len(hidden)) - k * dilation, 0)] @ taps[k]
            hidden = np.tanh(total)
        return np.asarray(self.y_mean_ + self.y_scale_ * (hidden @ self.readout_ + x @ self.skip_))


def _check(model: SequenceRegressor, features: int) -> None:
    require_number(model, "width", low=1, whole=True)
    shapes = [(_TAPS, a, b) for a, b in itertools.pairwise([features, *([model.width] * len(_DILATIONS))])]
    if [np.shape(taps) for taps in model.kernels_] != shapes or [np.shape(bias) for bias in model.biases_] != [
        shape[2:] for shape in shapes
    ]:
        raise InputError(f"its layers do not fit {features} inputs and a width of {model.width}")
    require_shape(model, "readout_", model.width)
    for name in ("skip_", "x_mean_", "x_scale_"):
        require_shape(model, name, features)
    if not (model.x_scale_ > 0.0).all():
        raise InputError("x_scale_ has values that are not positive")


SPECIFICATION: Final = ModelSpecification(
    name="sequence",
    estimator=SequenceRegressor,
    batches=lambda features: [[{"width": width, "weight_decay": decay}] for width in (4, 8) for decay in (1e-3, 1e-1)],
    numbers=("y_mean_", "y_scale_"),
    arrays=("kernels_", "biases_", "readout_", "skip_", "x_mean_", "x_scale_"),
    check=_check,
)
