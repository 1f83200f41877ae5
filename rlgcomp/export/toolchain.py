"""Compilers and emulators found on this machine, and exported C compiled and run with them."""

from __future__ import annotations

import dataclasses
import errno
import os
import re
import shutil
import subprocess
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final

import numpy as np
import numpy.typing as npt

from rlgcomp.errors import InputError
from rlgcomp.export.accuracy import Bounds
from rlgcomp.export.golden import EITHER, INVALID, OK, Stream

Array = npt.NDArray[np.float64]
STRICT: Final = ("-std=c99", "-Wall", "-Wextra", "-Werror", "-pedantic")
SANITIZERS: Final = ("-O1", "-g", "-fsanitize=address,undefined", "-fno-sanitize-recover=all")
CORTEX_M4: Final = ("-O2", "-mcpu=cortex-m4", "-mthumb", "-mfloat-abi=hard", "-mfpu=fpv4-sp-d16")
_BOARD: Final = ("-M", "mps2-an386", "-nographic", "-monitor", "none", "-serial", "none", "-kernel")
_TEMPLATES: Final = Path(__file__).parent / "templates"
_PROBE: Final = '#include <stdio.h>\nint main(void) { double x; return scanf("%lf", &x) == 1 ? 0 : printf("-") < 0; }\n'
_LONGEST_S: Final = 600.0
_SHORT_OF: Final = (errno.ENOSPC, errno.EDQUOT, errno.EIO, errno.EROFS, errno.EMFILE, errno.ENFILE, errno.ENOMEM)


@dataclasses.dataclass(frozen=True)
class Toolchain:
    """A way to compile and run.

    Parameters
    ----------
    name : str
    compiler : str
    flags : tuple of str
    board : bool
        Bare metal, run by qemu-system-arm.
    """

    name: str
    compiler: str
    flags: tuple[str, ...]
    board: bool = False

    @property
    def missing(self) -> str | None:
        """The program that is not installed, if one is not."""
        programs = [self.compiler, "qemu-system-arm"] if self.board else [self.compiler]
        return next((program for program in programs if shutil.which(program) is None), None)


TOOLCHAINS: Final = (
    *(Toolchain(f"{compiler} -O2", compiler, ("-O2",)) for compiler in ("gcc", "clang")),
    *(Toolchain(f"{compiler}, address and undefined sanitizers", compiler, SANITIZERS) for compiler in ("gcc", "clang")),
    Toolchain("Cortex-M4 under QEMU, -O2", "arm-none-eabi-gcc", CORTEX_M4, board=True),
)
_WORKING: Final[set[tuple[Toolchain, str | None, int]]] = set()  # with their places, and the device where their programs ran


@dataclasses.dataclass(frozen=True)
class Check:
    """Exported C run on one stream of samples.

    Parameters
    ----------
    toolchain, stream : str
    samples : int
    largest_deg_h : float
        Largest difference from Python within the training range.
    share : float
        Largest ratio of a difference to the allowed deviation of its sample.
    wrong : int
        Samples with a wrong status, or with a bias or half width further off than allowed.
    """

    toolchain: str
    stream: str
    samples: int
    largest_deg_h: float
    share: float
    wrong: int


class ToolchainError(Exception):
    """A toolchain that is installed does not work on this machine; its text is the toolchain's own last line."""


def build(toolchain: Toolchain, sources: Sequence[Path], folder: Path) -> list[str]:
    """Compile and link into a folder; the command that runs the result.

    Parameters
    ----------
    toolchain : Toolchain
    sources : sequence of Path
        C files.
    folder : Path
        Where the program is put.

    Raises
    ------
    InputError
        The disk is full, or the machine is short of something else.
    ToolchainError
        Not even a trivial program can be built and run.
    RuntimeError
        A trivial program can be, the sources cannot: a fault of the export.
    """
    tried = (toolchain, shutil.which(toolchain.compiler), folder.stat().st_dev)
    if tried not in _WORKING:
        _try(toolchain, folder)
        _WORKING.add(tried)
    compiled = _compile(toolchain, sources, folder / "selftest")
    _require_room(toolchain, compiled)
    if compiled.returncode != 0:
        _try(toolchain, folder)  # it may have worked earlier alone
        raise RuntimeError(f"{toolchain.name} does not compile the exported C:\n{compiled.stderr[:2000]}")
    return _command(toolchain, folder / "selftest")


def _try(toolchain: Toolchain, folder: Path) -> None:
    """Build and run a trivial program.

    Raises
    ------
    InputError, ToolchainError
        As of :func:`build`.
    """
    probe = folder / "probe.c"
    probe.write_text(_PROBE, encoding="ascii")
    probed = _compile(toolchain, [probe], folder / "probe")
    if probed.returncode == 0:
        probed = _run(_command(toolchain, folder / "probe"), "1.0\n")
    _require_room(toolchain, probed)
    if probed.returncode != 0:
        raise ToolchainError(_last_line(probed))


def check(toolchain: Toolchain, command: Sequence[str], stream: Stream, bounds: Bounds) -> Check:
    """Stream samples through the self-test program and compare every one: status, bias and half width.

    Parameters
    ----------
    toolchain : Toolchain
    command : sequence of str
        As :func:`build` returned it.
    stream : Stream
        Samples, and what Python computes for them.
    bounds : Bounds
        Allowed deviation of each sample.

    Raises
    ------
    RuntimeError
        The program fails.
    """
    table = stream.samples
    text = "\n".join(" ".join(map(repr, row)) for row in table.tolist()) + "\n"
    done = _run(_with_argument(toolchain, command, "stream"), text)
    lines = done.stdout.splitlines()
    if done.returncode != 0 or len(lines) != len(table):
        raise RuntimeError(f"{toolchain.name}: {len(lines)} of {len(table)} samples of {stream.name} answered: {_last_line(done)}")
    status, bias, half_width = np.array([line.split() for line in lines], dtype=np.float64).T
    difference = np.abs(bias - stream.bias_deg_h)
    right = np.where(bounds.status == EITHER, status != INVALID, status == bounds.status)
    right &= (difference <= bounds.bias_deg_h) & (np.abs(half_width - stream.half_width_deg_h) <= bounds.half_width_deg_h)
    return Check(
        toolchain.name,
        stream.name,
        len(table),
        float(difference[stream.status == OK].max(initial=0.0)),
        float((difference / bounds.bias_deg_h).max()),
        int((~right).sum()),
    )


def selftest(toolchain: Toolchain, command: Sequence[str]) -> str:
    """Run the self-test of the golden recording and return its output.

    Raises
    ------
    RuntimeError
        It does not pass.
    """
    done = _run(command)
    if done.returncode != 0 or not done.stdout.rstrip().endswith("PASS"):
        raise RuntimeError(f"{toolchain.name}: the self-test fails: {_last_line(done)}")
    return done.stdout.strip()


def time_ns(command: Sequence[str]) -> float:
    """Nanoseconds a step on this machine."""
    return float(_run([*command, "time"]).stdout.split()[0])


def sizes(toolchain: Toolchain, source: Path, folder: Path) -> dict[str, int] | None:
    """Bytes of flash (code and tables) and of stack (all frames added up) of the module alone; None where `size` is missing.

    Parameters
    ----------
    toolchain : Toolchain
    source : Path
        The C file of the module.
    folder : Path
        Where the object file is put.
    """
    size = "arm-none-eabi-size" if toolchain.board else "size"
    if shutil.which(size) is None:
        return None
    small = [flag if flag != "-O2" else "-Os" for flag in toolchain.flags]
    command = [toolchain.compiler, *STRICT, *small, "-fstack-usage", "-c", str(source), "-o", str(folder / "module.o")]
    if _run(command).returncode != 0:
        return None
    text, data, bss = (int(part) for part in _run([size, str(folder / "module.o")]).stdout.splitlines()[1].split()[:3])
    frames = (folder / "module.su").read_text(encoding="utf-8").splitlines()
    return {
        "flash_bytes": text + data,
        "static_ram_bytes": data + bss,
        "stack_bytes": sum(int(line.split("\t")[1]) for line in frames),
    }


def version(toolchain: Toolchain) -> str:
    """First line of the compiler's version."""
    return re.sub(r"\s+", " ", _run([toolchain.compiler, "--version"]).stdout.partition("\n")[0])


def _compile(toolchain: Toolchain, sources: Sequence[Path], program: Path) -> subprocess.CompletedProcess[str]:
    extra = [f"-T{_TEMPLATES / 'cortex_m4.ld'}", "--specs=rdimon.specs", str(_TEMPLATES / "cortex_m4.c")] if toolchain.board else []
    return _run(
        [toolchain.compiler, *STRICT, *toolchain.flags, *map(str, sources), *extra, "-o", str(program), "-lm"],
        folder=program.parent,
    )


def _command(toolchain: Toolchain, program: Path) -> list[str]:
    if not toolchain.board:
        return [str(program)]
    return ["qemu-system-arm", *_BOARD, str(program), "-semihosting-config", "enable=on,target=native,arg=selftest"]


def _with_argument(toolchain: Toolchain, command: Sequence[str], argument: str) -> list[str]:
    return [*command[:-1], f"{command[-1]},arg={argument}"] if toolchain.board else [*command, argument]


def _run(command: Sequence[str], text: str = "", folder: Path | None = None) -> subprocess.CompletedProcess[str]:
    """Run a program; what it puts into TMPDIR, as compilers do, goes into a folder where one is given.

    A program that cannot be executed, or does not end, is a failed one. Where this process is short of file handles, memory or room
    on the disk, that says nothing of the program, and the error is raised.
    """
    settings: Mapping[str, str] = {**os.environ, "LC_ALL": "C"} | ({} if folder is None else {"TMPDIR": str(folder)})
    try:
        return subprocess.run(  # noqa: S603
            command, input=text, capture_output=True, text=True, check=False, timeout=_LONGEST_S, env=settings
        )
    except OSError as error:
        if error.filename != command[0]:
            raise
        return subprocess.CompletedProcess(list(command), 1, "", str(error))
    except subprocess.TimeoutExpired as error:
        return subprocess.CompletedProcess(list(command), 1, "", str(error))


def _require_room(toolchain: Toolchain, done: subprocess.CompletedProcess[str]) -> None:
    """Raise where a compiler failed for want of room, or of something else that the machine is short of."""
    lines = done.stderr.splitlines() if done.returncode != 0 else []
    reasons = [line for line in lines if any(os.strerror(number) in line for number in _SHORT_OF)]
    if reasons:
        raise InputError(f"{toolchain.name} cannot compile: {reasons[0][:300]}; make room, or give another folder by TMPDIR")


def _last_line(done: subprocess.CompletedProcess[str]) -> str:
    lines = (done.stderr.strip() or done.stdout.strip()).splitlines()
    return lines[-1][:300] if lines else f"exit code {done.returncode}"
