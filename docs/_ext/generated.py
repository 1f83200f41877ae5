"""Pages of the reference that the code itself states: commands, columns and units, mechanisms, messages, the Python interface."""

from __future__ import annotations

import importlib
import inspect
import pkgutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Final

_INHERITED: Final = "   :inherited-members: BaseEstimator, RegressorMixin, BaseException, object, tuple, dict"

FOLDER = "reference"
METADATA = {
    "`kind`": "`chamber`, `turntable` or `static`",
    "`unit`": "serial number of the gyro",
    "`latitude_deg`": "latitude",
    "`pulse_arcsec`": "angle of one pulse",
    "`angle_step_deg`": "resolution of the table's encoder",
    "`lead_in_s`": "first seconds that set the state of filters and are not fitted",
    "`after_start_s`": "of a recording of means: from the first sample to the middle of the first mean",
    "`columns`": "in the `.yaml`: a map of names, as `--map`",
    "`period_s`": "in the `.yaml`: sample period of a file without time",
    "anything else": "kept as a note",
}


def commands() -> Iterator[str]:
    """Every command with its help."""
    from typer.core import TyperCommand
    from typer.main import get_command

    from rlgcomp.cli import register_commands
    from rlgcomp.cli.base import app
    from rlgcomp.cli.help import COMMANDS

    register_commands()
    group: Any = get_command(app)
    yield "# Commands\n"
    yield "What `rlgcomp COMMAND --help` prints. Every command prints JSON with `--json`, and ends with 0 (done), 2 (bad input, one"
    yield "message) or 1 (internal fault)."
    yield "`rlgcomp --install-completion` makes the shell complete commands and options.\n"
    for title, names in COMMANDS.items():
        yield f"## {title}\n"
        for name in names:
            command: TyperCommand = group.commands[name]
            widths = {"terminal_width": 96, "max_content_width": 96}
            context: Any = command.make_context(name, ["--help"], resilient_parsing=True, **widths)
            text = "\n".join(line for line in command.get_help(context).splitlines() if not line.startswith("Documentation:"))
            yield f"({name})=\n\n### {name}\n\n```text\n{text.strip()}\n```\n"


def columns() -> Iterator[str]:
    """Standard columns, and every unit that is converted."""
    from rlgcomp import units
    from rlgcomp.recording.columns import STANDARD

    yield "# Columns and units\n"
    yield "Only `time_s` and a gyro are required. Any further numeric column is kept: it may be an input of a compensation and a"
    yield "driver in a diagnosis. A column whose name or unit differs is mapped, on the command line or in the `.yaml` beside the"
    yield "file ([files](../formats.md)):\n"
    yield "```sh\nrlgcomp inspect logger.csv --map gyro_deg_h='Gyro Z [deg/s]' --map temperature_block_degC='T1 [K]'\n```\n"
    yield "| column | unit | content |\n|---|---|---|"
    for name, content in STANDARD.items():
        yield f"| `{name}` | {units.typeset(units.column_unit(name) or '–')} | {content} |"
    yield "\n## Metadata\n"
    yield "Stated in the file (Parquet, HDF5), in the `.yaml` beside it, or by an option.\n"
    yield "| key | meaning |\n|---|---|"
    for key, meaning in METADATA.items():
        yield f"| {key} | {meaning} |"
    yield "\n## Units\n"
    yield "Units that are converted on the way in, with their usual spellings.\n"
    yield "| quantity [unit inside] | units |\n|---|---|"
    for quantity, table in units._DIMENSIONS.items():  # noqa: SLF001
        yield f"| {quantity} | {', '.join(f'`{unit}`' for unit in table)} |"


def mechanisms() -> Iterator[str]:
    """Every mechanism of the catalogue with its parameters."""
    from rlgcomp.physics import CATALOGUE

    yield "# Mechanisms\n"
    yield "The catalogue: what a simulator file may hold and a diagnosis tries. `rlgcomp mechanisms NAME` prints the same."
    for kind in ("chamber", "turntable", "any"):
        chosen = [form for form in CATALOGUE.values() if form.kind == kind]
        if chosen:
            yield f"\n## {({'any': 'Chamber and turntable'}).get(kind, kind.capitalize())}\n"
        for form in chosen:
            yield f"### {form.name}\n\n```text\n{form.equation}\n```\n"
            yield f"{_plain(form.reference)}\n"
            if form.drivers:
                yield f"Reads {', '.join(f'`{driver}`' for driver in form.drivers)}.\n"
            if form.parameters():
                yield "| parameter | role | usual | unit | choices |\n|---|---|---|---|---|"
                for one in form.parameters():
                    yield f"| `{one.name}` | {one.role} | {one.typical} | {one.unit} | {', '.join(one.choices)} |"
                yield ""


def messages() -> Iterator[str]:
    """Every message by its code, with the data that it carries."""
    from rlgcomp.report.messages import ROOMS, texts_of

    yield "# Messages by code\n"
    yield "A remark or a finding has a code, data with units, and a text; `--json` and all JSON files carry the three. Codes are"
    yield "stable. Where the text depends on the data by more than inserting it, the arguments are listed.\n"
    for room in ROOMS:
        yield f"## {room.__name__.rpartition('.')[2]}\n\n| code | text, with its data in braces |\n|---|---|"
        for code, text in sorted(texts_of(room).items()):
            yield f"| `{code}` | {_message(text)} |"
        yield ""


def api() -> Iterator[str]:
    """The public names by module, with links to their sources."""
    import rlgcomp

    yield "# Python\n"
    yield "`import rlgcomp as rlg` gives the names below; everything else is found in the module that is named for it. Results have"
    yield "`.plot()`, `.to_frame()` or `.to_mapping()`, and `.report(path)` where there is a page.\n"
    places: dict[str, list[str]] = {}
    for name in rlgcomp.__all__:
        value = getattr(rlgcomp, name)
        module = getattr(value, "__module__", None)
        if isinstance(module, str) and module.startswith("rlgcomp.") and name != "CATALOGUE":
            places.setdefault(module, []).append(name)
    for module in sorted(places):
        yield f"## {module}\n"
        for name in places[module]:
            if getattr(rlgcomp, name) is getattr(rlgcomp, module.rpartition(".")[2], None):  # the function hides its module
                about = inspect.getdoc(getattr(rlgcomp, name))
                yield f"```text\nrlgcomp.{name}{inspect.signature(getattr(rlgcomp, name))}\n\n{about}\n```\n"
                continue
            kind = "class" if inspect.isclass(getattr(rlgcomp, name)) else "function"
            members = f"\n   :members:\n{_INHERITED}" if kind == "class" else ""
            yield f"```{{eval-rst}}\n.. auto{kind}:: {module}.{name}{members}\n```\n"
    yield "## All modules\n\n| module | content |\n|---|---|"
    for info in pkgutil.walk_packages(rlgcomp.__path__, "rlgcomp."):
        if info.name != "rlgcomp.__main__":
            about = (inspect.getdoc(importlib.import_module(info.name)) or "").partition("\n")[0]
            yield f"| `{info.name}` | {_plain(about)} |"


def _message(text: str | Callable[..., str]) -> str:
    if isinstance(text, str):
        return _plain(text)
    names = ", ".join(f"`{name}`" for name in inspect.signature(text).parameters)
    about = (inspect.getdoc(text) or "").partition("\n")[0]
    return f"{_plain(about)} Arguments: {names}".strip()


def _plain(text: str) -> str:
    """Text as it stands, in a cell of a table."""
    text = " ".join(text.split()).replace("\\", "\\\\")
    for sign in "|*_<>[]$":
        text = text.replace(sign, f"\\{sign}")
    return text


def write_pages(app: Any) -> None:
    """Write the pages where they changed."""
    folder = Path(app.srcdir) / FOLDER
    for page in (commands, columns, mechanisms, messages, api):
        text = "\n".join(page()) + "\n"
        path = folder / f"{page.__name__}.md"
        if not path.exists() or path.read_text(encoding="utf-8") != text:
            path.write_text(text, encoding="utf-8")


def setup(app: Any) -> dict[str, Any]:
    """Write the pages before Sphinx looks for its sources."""
    app.connect("builder-inited", write_pages, priority=100)
    return {"version": "1", "parallel_read_safe": True}
