"""Models of scikit-learn that are not the package's own, as a file of skops: data, of types that are trusted by name.

skops lists the types of a file that it does not trust; any of them is refused, such as a class of the user's own. Two kinds are
trusted beside those of skops: the kernels of scikit-learn's Gaussian processes, which are plain Python, and its decision tree. A
tree's compiled code would read beyond its arrays if its numbers were wrong, so every tree is checked before the model predicts.
"""

from __future__ import annotations

import io
import zipfile
from collections.abc import Iterator
from types import ModuleType
from typing import Any, Final

import numpy as np
from sklearn.base import BaseEstimator

from rlgcomp.errors import InputError

FILE: Final = "model.skops"
LARGEST_BYTES: Final = 1 << 30  # unpacked
_KERNELS: Final = (
    "Sum", "Product", "Exponentiation", "ConstantKernel", "WhiteKernel", "RBF", "Matern", "RationalQuadratic", "ExpSineSquared",
    "DotProduct",
)  # fmt: skip
_TRUSTED: Final = frozenset({"sklearn.tree._tree.Tree", *(f"sklearn.gaussian_process.kernels.{name}" for name in _KERNELS)})
_MOST_NAMED: Final = 3


def packed(model: Any) -> bytes:
    """A fitted model of scikit-learn as the content of a file.

    Raises
    ------
    InputError
        skops is not installed, or the model holds a type that is not trusted.
    """
    name = type(model).__name__
    skops = _skops(f"{name} cannot be saved")
    try:
        content: bytes = skops.dumps(model)
        untrusted = _untrusted(skops, content)
    except Exception as error:  # noqa: BLE001  an estimator of any author may fail to be written in any way
        raise InputError(f"{name} cannot be saved: {type(error).__name__}: {str(error)[:200]}") from None
    if untrusted:
        raise InputError(f"{name} cannot be saved: {_named(untrusted)}; use other parts of scikit-learn, or a model of rlgcomp")
    return content


def unpacked(content: bytes, features: int) -> Any:
    """The model of a file's content.

    Parameters
    ----------
    content : bytes
    features : int
        Number of its inputs.

    Raises
    ------
    InputError
        skops is not installed, the content is damaged, it holds a type that is not trusted, or it is no model of so many inputs.
    """
    skops = _skops(f"{FILE} cannot be read")
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            size = sum(item.file_size for item in archive.infolist())
        if size > LARGEST_BYTES:
            raise InputError(f"{FILE} unpacks to {size} bytes; no model has more than {LARGEST_BYTES}")
        untrusted = _untrusted(skops, content)
        if untrusted:
            raise InputError(f"{FILE} is refused: {_named(untrusted)}")
        model = skops.loads(content, trusted=sorted(_TRUSTED))
        for tree in _trees(model):
            _require_sound(tree)
    except InputError:
        raise
    except Exception as error:  # noqa: BLE001  a damaged file can make the reader fail in any way
        raise InputError(f"{FILE} is damaged: {type(error).__name__}: {str(error)[:200]}") from None
    if not hasattr(model, "predict") or getattr(model, "n_features_in_", features) != features:
        raise InputError(f"{FILE} holds a {type(model).__name__}, which is no fitted model of {features} inputs")
    return model


def _untrusted(skops: ModuleType, content: bytes) -> list[str]:
    return [name for name in skops.get_untrusted_types(data=content) if name not in _TRUSTED]


def _trees(part: Any) -> Iterator[Any]:
    """Every decision tree within a model."""
    if type(part).__name__ == "Tree" and type(part).__module__ == "sklearn.tree._tree":
        yield part
    elif isinstance(part, dict):
        for item in part.values():
            yield from _trees(item)
    elif isinstance(part, list | tuple) or (isinstance(part, np.ndarray) and part.dtype == object):
        for item in np.ravel(part) if isinstance(part, np.ndarray) else part:
            yield from _trees(item)
    elif isinstance(part, BaseEstimator):
        yield from _trees(vars(part))


def _require_sound(tree: Any) -> None:
    """Refuse a tree whose nodes lead beyond it, in a circle, or to inputs that it has not."""
    left, right, feature = tree.children_left, tree.children_right, tree.feature
    node = np.arange(tree.node_count)
    inner = left != -1
    onward = all(((child[inner] > node[inner]) & (child[inner] < tree.node_count)).all() for child in (left, right))
    known = ((feature[inner] >= 0) & (feature[inner] < tree.n_features)).all()
    if not (tree.node_count and onward and known and (right[~inner] == -1).all()):
        raise InputError(f"{FILE} is damaged: a decision tree leads beyond its nodes or inputs")
    if len(tree.value) != tree.node_count:
        raise InputError(f"{FILE} is damaged: a decision tree has {tree.node_count} nodes and {len(tree.value)} values")


def _named(untrusted: list[str]) -> str:
    return f"it holds {', '.join(untrusted[:_MOST_NAMED])}, which is not among the types that may be loaded"


def _skops(what: str) -> ModuleType:
    try:
        import skops.io
    except ImportError:
        raise InputError(f"{what} without skops, which writes a model as data; pip install 'rlgcomp[python]'") from None
    return skops.io
