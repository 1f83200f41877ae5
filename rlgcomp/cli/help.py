"""How `--help` looks: options in groups, names in full at 80 columns, examples as they are typed, the page of each command."""

from __future__ import annotations

import re
from typing import Any, Final

from typer.core import TyperCommand, TyperGroup

DOCUMENTATION: Final = "docs/_site/reference/commands.html"  # where README's command builds it
GROUPS: Final = {  # what stands in none of them is an option of the command's own
    "Reading files": ("mapping", "drop", "gyro", "pulse_arcsec", "period_s", "calibration", "in_pieces"),
    "Mechanisms": ("mechanisms", "files", "only_own", "without", "only"),
    "Results": ("out", "report", "export", "to", "overwrite", "as_json"),
    "Running": ("seed", "jobs", "device", "scheduler", "help", "version", "install_completion", "show_completion"),
}
COMMANDS: Final = {
    "Start": ("demo", "example"),
    "Recordings": ("inspect", "merge"),
    "Noise": ("allan", "arw"),
    "Calibration": ("scale-factor", "calibrate"),
    "Compensation": ("train", "evaluate", "compensate", "models", "export", "fleet"),
    "Simulators": ("simulate", "predict", "mechanisms"),
    "Diagnosis": ("diagnose", "sensitivity", "conceal", "reveal"),
}
_EXAMPLE: Final = re.compile(r"^[^`]*`(rlgcomp [^`]*)`\.?$", re.DOTALL)
_WORD: Final = re.compile(r"(?:--[\w-]+ (?=[^-]))?(?:'[^']*'|\S)+")  # an option with its value
_TYPES: Final = {
    " <list[str]>": "",
    " <list[path]>": "",
    " <path>": " PATH",
    " <str>": " TEXT",
    " <float>": " NUMBER",
    " <int>": " N",
}


def paragraphs(text: str) -> tuple[list[str], list[str]]:
    """Paragraphs of a docstring without its examples, and the commands of the examples.

    >>> paragraphs("Train.\\n\\nExample: `rlgcomp train a b --out m`")
    (['Train.'], ['rlgcomp train a b --out m'])
    """
    prose, examples = [], []
    for paragraph in text.split("\n\n"):
        joined = " ".join(paragraph.split())
        found = _EXAMPLE.match(joined) if joined.startswith(("Example:", "On a table:")) else None
        if found is not None:
            examples.append(found.group(1))
        elif joined:
            prose.append(joined)
    return prose, examples


def grouped_options(command: Any, context: Any) -> dict[str, list[tuple[str, str]]]:
    """Names and help of a command's parameters, by group; empty groups are left out."""
    group_of = {name: group for group, names in GROUPS.items() for name in names}
    rows: dict[str, list[tuple[str, str]]] = {group: [] for group in ("Arguments", "Options", *GROUPS)}
    for parameter in command.get_params(context):
        record = parameter.get_help_record(context)
        if record is not None:
            usual = "Arguments" if parameter.param_type_name == "argument" else "Options"
            name, text = record
            name = name.partition(" ")[0] if usual == "Arguments" else name
            for shown, word in _TYPES.items():
                name = name.replace(shown, word)
            rows[usual if usual == "Arguments" else group_of.get(parameter.name, usual)].append((name, text.replace("`", "")))
    return {group: each for group, each in rows.items() if each}


class DocumentedCommand(TyperCommand):
    """A command whose help has groups, examples and the address of its page."""

    def format_usage(self, ctx: Any, formatter: Any) -> None:
        arguments = [parameter for parameter in self.params if parameter.param_type_name == "argument"]
        pieces = [grouped_options(self, ctx)["Arguments"][k][0].strip("[]") for k in range(len(arguments))]
        pieces = [piece if one.required else f"[{piece}]" for piece, one in zip(pieces, arguments, strict=True)]
        required = [f"{one.opts[0]} {one.metavar or 'VALUE'}" for one in self.params if one not in arguments and one.required]
        formatter.write_usage(f"rlgcomp {self.name}", " ".join([*pieces, *required, "[OPTIONS]"]))

    def format_help_text(self, ctx: Any, formatter: Any) -> None:
        prose, examples = paragraphs(self.help or "")
        for paragraph in prose:
            formatter.write_paragraph()
            with formatter.indentation():
                formatter.write_text(paragraph.replace("`", ""))
        if examples:
            with formatter.section("Examples" if len(examples) > 1 else "Example"):
                for example in examples:
                    formatter.write("".join(f"{line}\n" for line in _typed(example, formatter.width - 2)))

    def format_options(self, ctx: Any, formatter: Any) -> None:
        for group, rows in grouped_options(self, ctx).items():
            with formatter.section(group):
                formatter.write_dl(rows, col_max=34)

    def format_epilog(self, ctx: Any, formatter: Any) -> None:
        formatter.write(f"\nDocumentation: {DOCUMENTATION}#{self.name}\n")


class DocumentedGroup(TyperGroup):
    """The commands in groups, each with its whole first sentence."""

    def format_options(self, ctx: Any, formatter: Any) -> None:
        for group, rows in grouped_options(self, ctx).items():
            with formatter.section(group):
                formatter.write_dl(rows, col_max=34)
        for group, names in COMMANDS.items():
            with formatter.section(group):
                rows = [(name, paragraphs(self.commands[name].help or "")[0][0].replace("`", "")) for name in names]
                formatter.write_dl(rows, col_max=34)

    def format_epilog(self, ctx: Any, formatter: Any) -> None:
        formatter.write(f"\nDocumentation: {DOCUMENTATION}\n")


def _typed(command: str, width: int) -> list[str]:
    """A command on as many lines as it needs, each but the last continued."""
    lines = [""]
    for word in _WORD.findall(command):
        if lines[-1] and len(lines[-1]) + len(word) + 5 > width:
            lines[-1] += " \\"
            lines.append("  ")
        lines[-1] += word if not lines[-1].strip() else f" {word}"
    return [f"  {line}" for line in lines]
