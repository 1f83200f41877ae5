"""Documents name what exists: files, rooms, modules of experiments, commands and their options."""

from __future__ import annotations

import pkgutil
import re
from pathlib import Path
from typing import Any

import pytest
from typer.main import get_command

import rlgcomp
from rlgcomp.cli import register_commands
from rlgcomp.cli.base import app

ROOT = Path(__file__).parents[1]
DOCUMENTS = [
    *(ROOT / name for name in ("README.md", "CHANGELOG.md", "CONTRIBUTING.md", "models/README.md")),
    *sorted((ROOT / "docs").glob("*.md")),
    *sorted(path for part in ("tutorials", "howto", "explanation") for path in (ROOT / "docs" / part).glob("*.md")),
]
FOLDERS = ("rlgcomp/", "tests/", "experiments/", "models/", "docs/")
GENERATED = (
    "reference/commands.md",
    "reference/columns.md",
    "reference/messages.md",
    "reference/mechanisms.md",
    "reference/api.md",
)
EXAMPLES = ("your_", "unit-", "fleet")  # files of the reader's own


@pytest.fixture(params=DOCUMENTS, ids=lambda path: str(path.relative_to(ROOT)))
def document(request: pytest.FixtureRequest) -> Path:
    return Path(request.param)


@pytest.fixture(scope="module")
def commands() -> dict[str, Any]:
    register_commands()
    return dict(get_command(app).commands)  # type: ignore[attr-defined]


def _command_lines(document: Path) -> list[tuple[str, str]]:
    """Name and arguments of each command, in blocks and between backticks."""
    text = document.read_text(encoding="utf-8")
    return re.findall(r"(?:^|`|&& )(?:[\w./]*/)?rlgcomp ([a-z][a-z-]*)([^`\n#&|]*)", text, re.MULTILINE)


def test_paths_exist(document: Path) -> None:
    quoted = re.findall(r"`([^`\n ]+)`", document.read_text(encoding="utf-8"))
    paths = {path.rstrip("/") for path in quoted if path.startswith(FOLDERS) and not any(mark in path for mark in EXAMPLES)}
    assert not {path for path in paths if not (ROOT / path).exists()}


def test_links_lead_to_files(document: Path) -> None:
    text = re.sub(r"`[^`]*`", "", document.read_text(encoding="utf-8"))
    links = re.findall(r"\]\(([^)#\s]*[./][^)#\s]*)", text)
    written = [
        link for link in links if "://" not in link and not link.endswith(GENERATED)
    ]  # those are checked as the site is built
    assert not [link for link in written if not (document.parent / link).exists()]


def test_experiments_exist(document: Path) -> None:
    modules = set(re.findall(r"python -m (experiments[\w.]*\w)", document.read_text(encoding="utf-8")))
    places = {name: ROOT / name.replace(".", "/") for name in modules}
    assert not [name for name, at in places.items() if not ((at / "__main__.py").exists() or at.with_suffix(".py").exists())]


def test_commands_and_options_exist(document: Path, commands: dict[str, Any]) -> None:
    unknown = []
    for name, arguments in _command_lines(document):
        known = {option for parameter in commands[name].params for option in parameter.opts} if name in commands else set()
        unknown += [f"{name} {option}" for option in re.findall(r"(?<!\S)--[a-z-]+", arguments) if option not in known | {"--help"}]
        unknown += [] if name in commands else [name]
    assert not unknown


def test_every_page_is_in_the_site() -> None:
    """Every page stands in one list of contents, and every command of the README exists in its clone: CI runs them."""
    contents = "".join(path.read_text(encoding="utf-8") for path in (ROOT / "docs").rglob("*.md") if "toctree" in path.read_text())
    pages = {path.relative_to(ROOT / "docs").with_suffix("").as_posix() for path in DOCUMENTS if ROOT / "docs" in path.parents}
    assert not {page for page in pages - {"index"} if page not in contents}


def test_the_design_names_every_room() -> None:
    text = (ROOT / "docs/design.md").read_text(encoding="utf-8")
    assert not [room.name for room in pkgutil.iter_modules(rlgcomp.__path__) if f"`{room.name}`" not in text]
