"""A Python file of the user's, loaded as a module: mechanisms to try, or a simulator to test."""

from __future__ import annotations

import dataclasses
import sys
import traceback
import types
import zlib
from collections.abc import Iterable
from pathlib import Path
from typing import Any, Final, Self

from rlgcomp.errors import InputError

_PREFIX: Final = "rlgcomp_plugin_"


def load_python(path: str | Path) -> types.ModuleType:
    """Run a Python file and return it as a module.

    While it runs its folder is on the import path, so it may import its neighbours. The same file, unchanged, gives the same
    module.

    Parameters
    ----------
    path : str or Path
        File ending in .py.

    Raises
    ------
    InputError
        There is no such file, it is no Python, or it fails while it runs; with the line and Python's own message.
    """
    path = Path(path)
    if path.suffix != ".py":
        raise InputError(f"{path}: expected a Python file, one that ends in .py")
    try:
        source = path.read_bytes()
    except FileNotFoundError:
        raise InputError(f"{path} does not exist; give the path of a Python file") from None
    except OSError as error:
        raise InputError(f"{path} cannot be read: {error.strerror}; give the path of a Python file") from None
    name = f"{_PREFIX}{path.stem}_{zlib.crc32(str(path.resolve()).encode() + source):08x}"
    if name in sys.modules:
        return sys.modules[name]
    try:
        code = compile(source, str(path), "exec", dont_inherit=True)
    except SyntaxError as error:
        raise InputError(f"{path}, line {error.lineno}: {error.msg}; correct the file") from None
    except ValueError as error:  # null bytes, before Python 3.12
        raise InputError(f"{path} is not Python: {error}") from None
    module = types.ModuleType(name)
    module.__file__ = str(path)
    sys.modules[name] = module  # dataclasses look their own module up
    folder = str(path.resolve().parent)
    sys.path.insert(0, folder)
    try:
        exec(code, module.__dict__)  # noqa: S102 - the file is the user's, given by name to be run
    except (Exception, SystemExit) as error:  # noqa: BLE001 - whatever it raises is the file's fault
        del sys.modules[name]
        raise InputError(f"{path}{error_line(error, path)}: {type(error).__name__}: {error}; correct the file") from None
    finally:
        sys.path.remove(folder)
    return module


@dataclasses.dataclass(frozen=True)
class LoadedFirst:
    """Files that another process loads when it receives this object, so that later objects can refer to their classes."""

    paths: tuple[Path, ...]

    @classmethod
    def of(cls, defined: Iterable[type]) -> Self:
        """The files of the user's in which these classes are defined; classes of the package are ignored."""
        modules = {one.__module__ for one in defined if one.__module__.startswith(_PREFIX)}
        return cls(tuple(Path(str(sys.modules[name].__file__)).resolve() for name in sorted(modules)))

    def __reduce__(self) -> tuple[Any, ...]:
        return _loaded_first, (self.paths,)


def _loaded_first(paths: tuple[Path, ...]) -> LoadedFirst:
    for path in paths:
        load_python(path)
    return LoadedFirst(paths)


def error_line(error: BaseException, path: str | Path) -> str:
    """The line of a user's file in which an exception arose, as ", line 12"; empty where it did not pass through that file."""
    lines = [frame.lineno for frame in traceback.extract_tb(error.__traceback__) if frame.filename == str(path)]
    return f", line {lines[-1]}" if lines else ""
