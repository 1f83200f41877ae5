"""The command that writes example data: example."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from rlgcomp.cli.base import AsJson, command, require_folder
from rlgcomp.cli.ending import notify
from rlgcomp.cli.show import show_json


@command("example")
def example(
    kind: Annotated[str, typer.Argument(metavar="KIND", help="chamber, turntable, noise or fleet.")],
    out: Annotated[
        Path | None,
        typer.Option("--out", "-o", metavar="DIR", help="Folder to write, replaced as a whole.", show_default="the kind's name"),
    ] = None,
    seed: Annotated[
        int, typer.Option(min=0, metavar="N", help="Seed of all random streams: the same seed gives the same files.")
    ] = 1,
    as_json: AsJson = False,
) -> None:
    """Write example data: the files that README and tutorials use.

    chamber: three chamber runs of one gyro and a simulator that lacks an effect. turntable: the scale factor of one gyro, the
    calibration of three. noise: a gyro at rest, a gyro that turns. fleet: four units and a new one. Each takes seconds.

    Example: `rlgcomp example chamber`
    """
    from rlgcomp.errors import InputError
    from rlgcomp.files import whole_folder
    from rlgcomp.simulation.examples import EXAMPLES

    if kind not in EXAMPLES:
        raise InputError(f"no example is called {kind!r}; there are {', '.join(EXAMPLES)}")
    chosen = EXAMPLES[kind]
    out = Path(kind) if out is None else out
    writes = list(chosen.files)
    require_folder(out, writes)
    with whole_folder(out, writes=writes) as folder:
        chosen.make(folder, seed)
        names = sorted(path.name for path in folder.iterdir())
    if as_json:
        show_json({"kind": kind, "out": out, "files": names})
        return
    width = max(map(len, chosen.files)) + 2
    notify(f"{out}/\n" + "\n".join(f"  {name:{width}}{content}" for name, content in chosen.files.items()))
