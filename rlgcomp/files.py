"""Plain data read, and written so that no half result is left: a file or a folder appears whole under its name, or not at all."""

from __future__ import annotations

import contextlib
import datetime
import errno
import fnmatch
import hashlib
import json
import math
import os
import re
import tempfile
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from rlgcomp.errors import InputError
from rlgcomp.scratch import publish_all, recover, scratch_folder

_EXPONENT: Final = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)[eE][-+]\d+$")  # as 6e-06, which YAML 1.1 takes for text
_MOST_DIGITS: Final = 300  # of a whole number that a float can hold
_MOST_NAMED: Final = 5  # names in a message
_DEEPEST: Final = 100  # levels of plain data
_MOST_PARTS: Final = 1_000_000  # of a YAML document, anchors written out
_LARGEST_TEXT: Final = 1 << 26  # bytes


@contextlib.contextmanager
def whole_file(path: str | Path, *, overwrite: bool = False, written: Callable[[Path], bool] | None = None) -> Iterator[Path]:
    """Yield a scratch path of the same name, which replaces `path` only if the block ends without an exception.

    What else the block writes into the scratch path's folder is published with it: all of these files, or none.

    Parameters
    ----------
    path : path
    overwrite, written
        As :func:`require_replaceable`.

    Raises
    ------
    InputError
        The folder does not exist, cannot be written to, `path` is a folder, or may not be replaced.
    """
    path = Path(path)
    require_writable(path)
    require_replaceable(path, overwrite=overwrite, written=written)
    with contextlib.ExitStack() as stack:
        try:
            folder = stack.enter_context(scratch_folder(path.parent))
            scratch = folder / path.name
            scratch.touch()
        except OSError as error:
            raise InputError(f"cannot write {path}: {error.strerror or error}; give another place") from None
        yield scratch
        require_replaceable(path, overwrite=overwrite, written=written)  # the work may have taken hours
        publish_all(folder)


@contextlib.contextmanager
def whole_folder(path: str | Path, *, writes: Sequence[str]) -> Iterator[Path]:
    """Yield a scratch folder that becomes `path` only if the block ends without an exception; missing parents are made.

    An existing folder is replaced only when it is empty, or an earlier run made it and nothing else was put into it since. What the
    block puts beside the scratch folder, under other names, is published with it: all of these, or none.

    Parameters
    ----------
    path : path
    writes : sequence of str
        Names of all files that are written there, as patterns of :mod:`fnmatch`, `folder/name` for those further in. The first is
        that of a file which is always written: it shows that an earlier run made the folder.

    Raises
    ------
    InputError
        As :func:`require_folder`.
    """
    require_folder(path, writes=writes)
    place = Path(path).resolve()  # what a link points to is replaced, not the link
    missing = [parent for parent in place.parents if not parent.exists()]
    with contextlib.ExitStack() as stack:
        stack.callback(_remove_empty, missing)
        try:
            place.parent.mkdir(parents=True, exist_ok=True)
            made = stack.enter_context(scratch_folder(place.parent)) / place.name
            made.mkdir()
        except OSError as error:
            raise InputError(f"cannot write {path}: {error.strerror or error}; give another place") from None
        yield made
        if place.exists():
            _require_still(path, writes, made)
        publish_all(made.parent)


def _require_still(path: str | Path, writes: Sequence[str], made: Path) -> None:
    """Raise where something was put into the folder while the work went on, which may have taken hours: what was made stays beside
    it."""
    try:
        require_folder(path, writes=writes)
    except InputError as error:
        saved = Path(tempfile.mkdtemp(prefix=f"{Path(path).resolve().name}.", dir=made.parent.parent))
        os.replace(made, saved)
        for companion in made.parent.iterdir():
            os.replace(companion, saved / companion.name)
        raise InputError(f"{error}; what was made lies in {saved}") from None


def write_text(path: str | Path, text: str) -> None:
    """Write UTF-8 text, whole or not at all, over whatever file has the name."""
    with whole_file(path, overwrite=True) as scratch:
        scratch.write_text(text, encoding="utf-8")


def to_json(value: Any, *, indent: int | None = 2) -> str:
    """JSON text of plain data, numpy values and dates. What is not a finite number becomes null: JSON has no NaN."""
    plain = _plain(value)
    text = json.dumps(plain, indent=indent, ensure_ascii=False, allow_nan=False)
    half = any("\ud800" <= one <= "\udfff" for one in text) if not text.isascii() else False  # of a pair: no UTF-8 can hold it
    return json.dumps(plain, indent=indent, allow_nan=False) if half else text


def from_json(text: str | bytes, **hooks: Any) -> Any:
    """Plain data of JSON text, a whole number too large for a float as infinite, so that every bound refuses it.

    Parameters
    ----------
    text : str or bytes
        Bytes are UTF-8.
    **hooks
        Of `json.loads`.

    Raises
    ------
    ValueError
        The text is no JSON, or is nested too deep.
    """
    try:
        value = json.loads(text.decode("utf-8") if isinstance(text, bytes) else text, parse_int=_whole_number, **hooks)
    except RecursionError:
        raise ValueError("it is nested deeper than can be read") from None
    _require_shallow(value)
    return value


def from_yaml(text: str) -> Any:
    """Plain data of YAML text, of which JSON is a part; as :func:`from_json`.

    Raises
    ------
    ValueError
        The text is no YAML, holds what is no plain data, is nested too deep, or has too many parts without anchors.
    """
    import yaml

    class Loader(yaml.SafeLoader):
        """Of plain data."""

    def whole_number(loader: Loader, node: yaml.ScalarNode) -> int | float:
        return _whole_number(node.value) if len(node.value) > _MOST_DIGITS else loader.construct_yaml_int(node)

    Loader.add_constructor("tag:yaml.org,2002:int", whole_number)
    Loader.add_implicit_resolver("tag:yaml.org,2002:float", _EXPONENT, list("-+.0123456789"))
    try:
        loader = Loader(text)
        node = loader.get_single_node()
        if node is None:
            return None
        _require_expandable(node)
        return loader.construct_document(node)
    except RecursionError:
        raise ValueError("it is nested deeper than can be read") from None
    except yaml.YAMLError as error:
        raise ValueError(str(error)) from None
    except (LookupError, TypeError, AttributeError, OverflowError) as error:  # of values that are not what their tags say
        raise ValueError(f"a value is not what its tag says: {type(error).__name__}: {error}") from None


def _require_expandable(root: Any) -> None:
    """Raise where a YAML document is nested too deep, holds itself, or has too many parts once anchors stand for their content."""
    sizes: dict[int, int] = {}
    waiting = [(root, 0, False)]
    above: set[int] = set()
    while waiting:
        node, depth, visited = waiting.pop()
        inside = [one for part in node.value for one in (part if isinstance(part, tuple) else (part,))]
        inside = inside if isinstance(node.value, list) else []
        if visited:
            above.discard(id(node))
            sizes[id(node)] = 1 + sum(sizes[id(one)] for one in inside)
            if sizes[id(node)] > _MOST_PARTS:
                raise ValueError(f"its anchors make more than {_MOST_PARTS} parts of it; write what is meant")
        elif id(node) in above:
            raise ValueError("an anchor holds itself")
        elif id(node) not in sizes:
            if depth > _DEEPEST:
                raise ValueError(f"it is nested deeper than {_DEEPEST} levels")
            above.add(id(node))
            waiting.append((node, depth, True))
            waiting += [(one, depth + 1, False) for one in inside]


def _require_shallow(value: Any) -> None:
    waiting, depth = [value], 0
    while waiting:
        if depth > _DEEPEST:
            raise ValueError(f"it is nested deeper than {_DEEPEST} levels")
        lists = [one.values() if isinstance(one, dict) else one for one in waiting if isinstance(one, dict | list)]
        waiting, depth = [inner for one in lists for inner in one if isinstance(inner, dict | list)], depth + 1


def read_text(path: str | Path) -> str:
    """UTF-8 text of a plain file of no more than 64 MiB: nothing that people or this package write by name is larger.

    Raises
    ------
    OSError
        It cannot be read, or is no plain file: a pipe would be waited for without end.
    ValueError
        It is larger, or no UTF-8.
    """
    path = Path(path)
    if not path.is_file() and path.exists():
        raise OSError(errno.EINVAL, "it is no plain file", str(path))
    if path.stat().st_size > _LARGEST_TEXT:
        raise ValueError(f"it is larger than {_LARGEST_TEXT >> 20} MiB")
    return path.read_text(encoding="utf-8")


def _whole_number(text: str) -> int | float:
    return int(text) if len(text) <= _MOST_DIGITS else math.copysign(math.inf, -1.0 if text.startswith("-") else 1.0)


def write_json(path: str | Path, value: Any) -> None:
    """Write JSON, whole or not at all, over whatever file has the name."""
    write_text(path, to_json(value) + "\n")


def write_result(path: str | Path, value: Mapping[str, Any], *, overwrite: bool = False) -> None:
    """Write a JSON result whose `schema` begins with rlgcomp, over another such file alone.

    Parameters
    ----------
    path : path
    value : mapping
        The result, plain data.
    overwrite : bool
        Also over a file that rlgcomp did not write.

    Raises
    ------
    InputError
        As :func:`whole_file`.
    """
    with whole_file(path, overwrite=overwrite, written=is_result) as scratch:
        scratch.write_text(to_json(value) + "\n", encoding="utf-8")


def sha256(path: str | Path) -> str:
    """SHA-256 of a file, in hexadecimal."""
    with open(path, "rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple | set):
        return [_plain(item) for item in value]
    if isinstance(value, np.ndarray):
        return _plain(value.tolist())
    if isinstance(value, np.generic):
        return _plain(value.item())
    if isinstance(value, float):
        return value if np.isfinite(value) else None
    if isinstance(value, Path):
        return str(value)
    if isinstance(value, datetime.date):
        return value.isoformat()
    return value


def require_writable(path: str | Path) -> None:
    """Raise unless a file of this name could be written: for use before the work.

    Raises
    ------
    InputError
        The folder does not exist or cannot be written to.
    """
    parent = Path(path).absolute().parent
    if not parent.is_dir():
        raise InputError(f"cannot write {path}: the folder {parent} does not exist; create it first")
    _require_access(parent, path)


def require_replaceable(path: str | Path, *, overwrite: bool, written: Callable[[Path], bool] | None = None) -> None:
    """Raise where a file of this name is there and may not be replaced, what a killed process was publishing there being finished.

    Parameters
    ----------
    path : path
    overwrite : bool
        Whether a file that this package did not write may be replaced. A folder, a device or a pipe never is.
    written : callable, optional
        Whether this package wrote the file of a path; without it, it wrote none.

    Raises
    ------
    InputError
        It may not.
    """
    path = Path(path)
    recover(path.parent, reading=path.name)
    try:
        exists, is_file = path.exists() or path.is_symlink(), path.is_file()
    except OSError as error:
        raise InputError(f"cannot write {path}: {error.strerror or error}; give another place") from None
    if path.is_dir():
        raise InputError(f"{path} is a folder; give the name of a file to write")
    if exists and not is_file:
        raise InputError(f"{path} is no plain file, so it is left untouched; give another name")
    if exists and not overwrite and not (written is not None and written(path)):
        raise InputError(f"{path} exists and rlgcomp did not write it, so it is left untouched; give another name, or --overwrite")


def is_result(path: Path) -> bool:
    """Whether a file is a JSON result of this package: its `schema` begins with rlgcomp."""
    try:
        content = from_json(read_text(path))
    except (OSError, ValueError):
        return False
    return isinstance(content, dict) and str(content.get("schema")).startswith("rlgcomp.")


def require_folder(path: str | Path, *, writes: Sequence[str]) -> None:
    """Raise unless :func:`whole_folder` could write a folder of this name: for use before the work.

    Raises
    ------
    InputError
        No folder can be made there, or `path` exists and is neither empty nor what an earlier run left.
    """
    try:
        place = Path(path).resolve()
        recover(place.parent, reading=place.name)
        recover(place)  # scratch of dead processes is nothing that would be lost
        standing = next(folder for folder in (place, *place.parents) if folder.exists())
        replaceable = standing != place or (place.is_dir() and ((place / writes[0]).exists() or not any(place.iterdir())))
    except (OSError, RuntimeError) as error:  # a name too long, a folder that may not be read, links in a circle
        raise InputError(f"cannot write {path}: {getattr(error, 'strerror', None) or error}; give another place") from None
    if not replaceable:
        raise InputError(f"{path} exists and holds no {writes[0]}, so it is left untouched; give another name, or remove it first")
    if standing == place and (foreign := _foreign(place, [tuple(name.split("/")) for name in writes])):
        more = f" and {len(foreign) - _MOST_NAMED} more" if len(foreign) > _MOST_NAMED else ""
        raise InputError(
            f"{path} holds {', '.join(foreign[:_MOST_NAMED])}{more}, which an earlier run did not write and which would be lost; "
            "give another name, or move these files first"
        )
    if standing == place and Path.cwd().is_relative_to(place):
        raise InputError(f"{path} is the folder you are in, which cannot be replaced; give the name of a folder to write")
    if standing != place and not standing.is_dir():
        raise InputError(f"cannot write {path}: {standing} is no folder; give another place")
    _require_access(place.parent if standing == place else standing, path)


def require_apart(folder: str | Path, *files: str | Path) -> None:
    """Raise where a file that is read lies in a folder that is to be replaced; a file that does not exist does not.

    Raises
    ------
    InputError
        It does.
    """
    place = os.path.realpath(folder)
    for file in files:
        there = os.path.exists(file)  # noqa: PTH110  Path.exists raises where a name is too long
        if there and Path(os.path.realpath(file)).is_relative_to(place):
            raise InputError(f"{file} lies in {folder}, which is to be replaced; give another name, or move it first")


def same_file(one: str | Path, other: str | Path) -> bool:
    """Whether two names are of one file that exists, were one a link to the other."""
    try:
        return os.path.samefile(one, other)  # noqa: PTH121  Path.samefile raises where a name is too long as well
    except (OSError, ValueError):
        return False


def _foreign(folder: Path, writes: Sequence[tuple[str, ...]]) -> list[str]:
    """Entries of a folder with none of these names, which are split into parts; a folder without any such file is one entry."""
    foreign: list[str] = []
    try:
        there = sorted(folder.iterdir())
    except OSError as error:
        raise InputError(f"cannot read {folder}: {error.strerror or error}; give another place") from None
    for path in there:
        parts = [name for name in writes if fnmatch.fnmatchcase(path.name, name[0])]
        further_in = [name[1:] for name in parts if len(name) > 1]
        if path.is_dir() and not path.is_symlink() and further_in:
            foreign += [f"{path.name}/{name}" for name in _foreign(path, further_in)]
        elif path.is_dir() or len(parts) == len(further_in):
            foreign.append(path.name)
    return foreign


def _require_access(folder: Path, path: str | Path) -> None:
    if not os.access(folder, os.W_OK):
        raise InputError(f"cannot write {path}: no permission to write in {folder}")


def _remove_empty(folders: Iterable[Path]) -> None:
    """Folders that were made and hold nothing go again, the innermost first."""
    for folder in folders:
        with contextlib.suppress(OSError):
            folder.rmdir()
