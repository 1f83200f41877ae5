"""Pages: one self-contained HTML file each, of one family: the answer first, then figures, remarks and a record of the test.

A page is readable without its script, which adds zoom and hover to the figures.
"""

from __future__ import annotations

import dataclasses
import functools
import html
import importlib.metadata
import importlib.resources
import os
import platform
import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Protocol

import rlgcomp
from rlgcomp.files import sha256, write_text
from rlgcomp.report.messages import Message
from rlgcomp.report.messages.consequence import LEVELS, by_consequence, level
from rlgcomp.units import typeset

if TYPE_CHECKING:
    import pandas as pd

_KICKER: Final = '<p class="kicker">rlgcomp '
_HEAD: Final = 1 << 16  # characters of a page, within which its kicker stands
_FIRST: Final = 3  # remarks beside the answer
_HEADINGS: Final = {"decisive": "Read before use", "limiting": "Limits", "note": "What was done"}
_SIGN: Final = re.compile(r" ?(=>|===|[{};]|(?<![<>=!])=(?!=)) ?")
_CONTENTS: Final = "<!-- contents -->"
_SECTION: Final = re.compile(r'<h2 id="([^"]+)">(.*?)</h2>')
_BESIDE_RELEASE: Final = ("numpy", "scipy")


@dataclasses.dataclass(frozen=True)
class Picture:
    """A figure as a page shows it and as it is saved by itself.

    Parameters
    ----------
    name : str
        Of its file, and the beginning of its identifiers.
    title, description : str
        What it shows, in a few words; what is to be seen in it, for readers who do not see it.
    svg : str
    """

    name: str
    title: str
    description: str
    svg: str


def save_pictures(folder: Path, pictures: Iterable[Picture]) -> None:
    """Write each picture as `NAME.svg` into a folder, which is made where it does not exist."""
    folder.mkdir(exist_ok=True)
    for one in pictures:
        (folder / f"{one.name}.svg").write_text(one.svg, encoding="utf-8")


@dataclasses.dataclass(frozen=True)
class Section:
    """A section of a page: pictures, tables and notes, in this order."""

    title: str
    parts: tuple[Picture | pd.DataFrame | str, ...]


@dataclasses.dataclass(frozen=True)
class Results:
    """A page of results: the answer, and sections.

    Parameters
    ----------
    title, kind, answer : str
        Heading; what was done; the result in a sentence.
    headline : tuple of (str, str)
        Numbers with their units, the first ones to be read.
    facts : tuple of (str, str)
        What is told beside the answer, with what to do next.
    sections : tuple of Section
    remarks : tuple of Message
    footer : str
        On the files beside the page.
    badge : str
        The verdict in a word or two.
    words : tuple of str
        Names that are printed in words in remarks.
    """

    title: str
    kind: str
    answer: str
    headline: tuple[tuple[str, str], ...]
    facts: tuple[tuple[str, str], ...]
    sections: tuple[Section, ...]
    remarks: tuple[Message, ...] = ()
    footer: str = ""
    badge: str = ""
    words: tuple[str, ...] = ()

    @property
    def pictures(self) -> list[Picture]:
        """All figures."""
        return [part for section in self.sections for part in section.parts if isinstance(part, Picture)]

    def render(self, made: Mapping[str, Any], tested: Sequence[Described] = (), files: Sequence[tuple[str, str, str]] = ()) -> str:
        """The page as HTML text; parameters as of :func:`render`."""
        content = {field.name: getattr(self, field.name) for field in dataclasses.fields(self)}
        return render("results.html", made=made, tested=tested, files=files, **content)

    def write(self, path: Path, made: Mapping[str, Any], tested: Sequence[Described] = (), figures: Path | None = None) -> None:
        """Write the page, whole or not at all, with the SHA-256 of the files that are in its folder.

        Parameters
        ----------
        path : path
        made : mapping
            Provenance.
        tested : sequence of Described
            Metadata of the recordings.
        figures : path, optional
            Folder in which each figure is saved as well.
        """
        companions = sorted(file for file in path.parent.iterdir() if file.is_file()) if figures is not None else []
        write_text(path, self.render(made, tested, digests(made, companions)))
        if figures is not None:
            save_pictures(figures, self.pictures)


class Described(Protocol):
    """Metadata of a recording."""

    @property
    def unit(self) -> str: ...
    @property
    def latitude_deg(self) -> float | None: ...
    @property
    def notes(self) -> Mapping[str, Any]: ...


def render(
    template: str,
    *,
    title: str,
    remarks: Iterable[Message] = (),
    made: Mapping[str, Any] | None = None,
    tested: Sequence[Described] = (),
    files: Sequence[tuple[str, str, str]] = (),
    words: Sequence[str] = (),
    **context: Any,
) -> str:
    """A page as HTML text.

    Parameters
    ----------
    template : str
        Name of a file beside this one.
    title : str
        Its heading.
    remarks : iterable of Message
        The first stand beside the answer, the others in a section of their own.
    made : mapping, optional
        Provenance, as :func:`rlgcomp.recording.provenance.provenance` gives it.
    tested : sequence of Described
        Metadata of the recordings.
    files : sequence of (str, str, str)
        Use, name and SHA-256 of each file.
    words : sequence of str
        Names that are printed in words in remarks.
    **context
        What the template asks for besides.
    """
    ordered = by_consequence(remarks)
    text = (
        _environment()
        .get_template(template)
        .render(
            title=title,
            style=resource("style.css"),
            script=script(),
            version=rlgcomp.__version__,
            first_remarks=[(level(one), in_words(one.text, words)) for one in _beside(ordered)],
            more_remarks=_grouped(ordered, words),
            remark_count=len(ordered),
            test_record=_record(made, tested),
            test_files=files,
            made=made,
            **context,
        )
    )
    sections = [(name, heading) for name, heading in _SECTION.findall(text)]
    links = "".join(f'<li><a href="#{name}">{heading}</a></li>' for name, heading in sections)
    return text.replace(_CONTENTS, f'<nav aria-label="Contents"><ul>{links}</ul></nav>' if len(sections) > 1 else "", 1)


def is_page(path: Path) -> bool:
    """Whether a file is a page of this package."""
    try:
        with open(path, encoding="utf-8") as stream:
            return _KICKER in stream.read(_HEAD)
    except (OSError, ValueError):
        return False


def in_words(text: str, names: Sequence[str]) -> str:
    """Names in a text as words.

    >>> in_words("thermal_hysteresis, not light_intensity_V", ["thermal_hysteresis", "light_intensity"])
    'thermal hysteresis, not light_intensity_V'
    """
    several = [name for name in names if "_" in name]
    if not several:
        return text
    return re.sub(rf"\b({'|'.join(map(re.escape, several))})\b", lambda found: found[1].replace("_", " "), text)


def digests(made: Mapping[str, Any], written: Iterable[Path] = ()) -> list[tuple[str, str, str]]:
    """Use, name and SHA-256 of the files that were read, by provenance, and of those that were written and exist.

    Parameters
    ----------
    made : mapping
    written : iterable of path
    """
    read = [("read", str(name), digest or "") for name, digest in made.get("inputs", {}).items()]
    return read + [("written", path.name, sha256(path)) for path in written if path.is_file()]


def _beside(ordered: Sequence[Message]) -> Sequence[Message]:
    """The remarks beside the answer."""
    weighty = [one for one in ordered if level(one) != LEVELS[-1]]
    return (weighty or ordered)[:_FIRST]


def _grouped(ordered: Sequence[Message], words: Sequence[str]) -> list[tuple[str, list[str]]]:
    """The other remarks, by their consequence."""
    others = ordered[len(_beside(ordered)) :]
    groups = {name: [in_words(one.text, words) for one in others if level(one) == name] for name in LEVELS}
    return [(_HEADINGS[name], texts) for name, texts in groups.items() if texts]


def _record(made: Mapping[str, Any] | None, tested: Sequence[Described]) -> list[tuple[str, str]]:
    """Date, operator, unit, latitude, versions and command of a test."""
    if made is None:
        return []
    units = dict.fromkeys(one.unit for one in tested if one.unit)
    latitudes = dict.fromkeys(f"{one.latitude_deg:g}°" for one in tested if one.latitude_deg is not None)
    operators = dict.fromkeys(str(one.notes["operator"]) for one in tested if one.notes.get("operator"))
    versions = [f"rlgcomp {made['version']}", f"Python {platform.python_version()}"]
    versions += [f"{name} {importlib.metadata.version(name)}" for name in _BESIDE_RELEASE]
    return [
        ("Date", str(made["date"]).replace("T", " ").replace("+00:00", " UTC")),
        ("Operator", ", ".join(operators) or os.environ.get("RLGCOMP_OPERATOR", "") or "not stated"),
        ("Unit", ", ".join(units) or "not stated"),
        ("Latitude", ", ".join(latitudes) or "not stated"),
        ("Versions", ", ".join(versions)),
        ("Command", str(made.get("command") or "called from Python")),
        *([] if made.get("seed") is None else [("Seed", str(made["seed"]))]),
    ]


@functools.cache
def _environment() -> Any:
    import jinja2

    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("rlgcomp", "report"),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        finalize=lambda value: typeset(value) if type(value) is str else value,  # drawings and tables are markup by then
    )
    environment.filters["anchor"] = lambda text: re.sub(r"[^a-z0-9]+", "-", html.unescape(str(text)).lower()).strip("-")
    environment.filters["breakable"] = _breakable
    environment.filters["number_like"] = lambda value: bool(re.fullmatch(r"[\s\d.,:;<>=≥≤×%·⁻⁰¹²³⁴⁵⁶⁷⁸⁹()±+−–-]*", str(value)))
    return environment


def _breakable(value: object) -> Any:
    """A cell of a table as markup: long names may be broken between their parts."""
    from markupsafe import Markup, escape

    return Markup(re.sub(r"([_/])(?=\w)", r"\1<wbr>", str(escape(typeset(str(value))))))  # noqa: S704  escaped


@functools.cache
def resource(name: str) -> str:
    return importlib.resources.files("rlgcomp.report").joinpath(name).read_text(encoding="utf-8")


@functools.cache
def script() -> str:
    """The viewer without its comments, its indentation, and blanks beside signs outside of its texts."""
    bare = re.sub(r"/\*.*?\*/", "", resource("viewer.js"), flags=re.DOTALL)
    lines = [re.split(r"(\"[^\"]*\"|`[^`]*`)", line.strip()) for line in bare.splitlines()]
    tight = [[part if k % 2 else _SIGN.sub(r"\1", part) for k, part in enumerate(parts)] for parts in lines]
    return "\n".join(line for line in map("".join, tight) if line)
