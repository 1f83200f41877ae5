"""A directive whose commands run when the site is built: their output and figures stand below them.

    ```{executed}
    :figures: noise/allan.png
    rlgcomp allan rest.csv --out noise
    ```

All blocks of a page run one after the other in one empty folder. Options: `figures` (pictures that the block made), `pages` (HTML
pages to link), `needs` (a file of data outside the project: without it the block is shown and not run), `language` (sh or python),
`head` (number of lines of output to show). A command that fails is a warning, and warnings are errors.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import textwrap
from pathlib import Path
from typing import Any, ClassVar

from docutils import nodes
from docutils.parsers.rst import directives
from sphinx.util import logging
from sphinx.util.docutils import SphinxDirective

logger = logging.getLogger(__name__)
MADE = "_made"  # below the source folder: what the blocks leave for the site
COLUMNS = 104  # of a sentence's lines
CONTROL = re.compile(r"\x1b\[[0-9;?]*[A-Za-z]")


class Executed(SphinxDirective):
    """Run a block, and show it with its output."""

    has_content = True
    option_spec: ClassVar[dict[str, Any]] = {
        "figures": directives.unchanged,
        "pages": directives.unchanged,
        "needs": directives.unchanged,
        "alt": directives.unchanged,
        "head": directives.nonnegative_int,
        "language": directives.unchanged,
    }

    def run(self) -> list[nodes.Node]:
        code, language = "\n".join(self.content), self.options.get("language", "sh")
        shown: list[nodes.Node] = [nodes.literal_block(code, code, language=language)]
        if os.environ.get("RLGCOMP_DOCS") == "not-run":  # while pages are written: seconds instead of minutes
            return shown
        needed = self.options.get("needs")
        if needed and not (_root(self) / needed).exists():
            text = f"Not run when this site was built: {needed} was absent."
            return [*shown, nodes.note("", nodes.paragraph(text, text))]
        folder = Path(self.env.app.outdir).parent / "_run" / self.env.docname
        if not self.env.temp_data.get("executed"):
            shutil.rmtree(folder, ignore_errors=True)
            folder.mkdir(parents=True)
            self.env.temp_data["executed"] = True
        done = _done(code, language, folder, _root(self))
        output = CONTROL.sub("", done.stdout).rstrip().lstrip("\n").replace(str(folder), ".")
        if done.returncode:
            logger.warning("a block ended with %d: %s\n%s", done.returncode, code, output[-2000:], location=self.get_location())
        lines = [part for line in output.splitlines() for part in _folded(line.rstrip())]
        head = self.options.get("head", len(lines))
        text = "\n".join([*lines[:head], *(["…"] if len(lines) > head else [])])
        if text:
            shown.append(nodes.literal_block(text, text, language="text", classes=["output"]))
        return [*shown, *self._figures(folder), *self._pages(folder)]

    def _figures(self, folder: Path) -> list[nodes.Node]:
        alt = self.options.get("alt", "Figure made by the block above")
        return [nodes.image(uri=self._kept(folder, name), alt=alt) for name in self.options.get("figures", "").split()]

    def _pages(self, folder: Path) -> list[nodes.Node]:
        """Links to pages, which are copied beside the site's own."""
        shown: list[nodes.Node] = []
        up = "../" * self.env.docname.count("/")
        for name in self.options.get("pages", "").split():
            place = f"pages/{self.env.docname}/{name}"
            target = Path(self.env.app.outdir) / place
            target.parent.mkdir(parents=True, exist_ok=True)
            if not (folder / name).is_file():
                logger.warning("a block did not make %s", name, location=self.get_location())
                continue
            shutil.copyfile(folder / name, target)
            reference = nodes.reference("", "", nodes.literal(name, name), refuri=f"{up}{place}", internal=False)
            shown.append(nodes.paragraph("", "The page: ", reference, classes=["made-page"]))
        return shown

    def _kept(self, folder: Path, name: str) -> str:
        """Copy a file that a block made below the source folder; its name there."""
        place = Path(MADE) / self.env.docname / name
        target = Path(self.env.srcdir) / place
        target.parent.mkdir(parents=True, exist_ok=True)
        if (folder / name).is_file():
            shutil.copyfile(folder / name, target)
        else:
            logger.warning("a block did not make %s", name, location=self.get_location())
        return f"/{place.as_posix()}"


def _folded(line: str) -> list[str]:
    """A line as a terminal of the site's width shows it: sentences are broken between words, tables are not."""
    if "  " in line.strip() or len(line) <= COLUMNS:
        return [line]
    return textwrap.wrap(line, COLUMNS, subsequent_indent="  " if line.startswith("- ") else "", break_on_hyphens=False)


def _root(directive: SphinxDirective) -> Path:
    return Path(directive.env.srcdir).parent


def _done(code: str, language: str, folder: Path, root: Path) -> subprocess.CompletedProcess[str]:
    programs = folder.parent / ".bin"
    programs.mkdir(exist_ok=True)
    program = programs / "rlgcomp"
    if not program.exists():
        program.write_text(f'#!/bin/sh\nexec {sys.executable} -m rlgcomp "$@"\n', encoding="utf-8")
        program.chmod(0o755)
    path = os.pathsep.join(filter(None, [str(root), os.environ.get("PYTHONPATH")]))
    surroundings = {
        **os.environ, "PATH": f"{programs.resolve()}{os.pathsep}{os.environ['PATH']}", "PYTHONPATH": path, "ROOT": str(root),
        "MPLBACKEND": "agg", "OPENBLAS_NUM_THREADS": "1", "COLUMNS": "110", "SOURCE_DATE_EPOCH": "1700000000",
    }  # fmt: skip
    call = [sys.executable, "-c", code] if language == "python" else ["bash", "-euo", "pipefail", "-c", code]
    return subprocess.run(  # noqa: S603  # the blocks of this site
        call, cwd=folder, env=surroundings, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, check=False, timeout=600
    )


def setup(app: Any) -> dict[str, Any]:
    """Register the directive."""
    app.add_directive("executed", Executed)
    app.add_config_value("executed", True, "env")
    return {"version": "1", "parallel_read_safe": True}
