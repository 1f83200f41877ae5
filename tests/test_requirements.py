"""The lowest versions that are promised are those that CI installs and tests."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

from packaging.requirements import Requirement
from packaging.version import Version

ROOT = Path(__file__).parents[1]
TOOLS_OF_THE_SUBSET = {"pytest", "hypothesis"}  # of the extra `test`: what the tests in that environment need


def test_lowest_versions_agree_with_the_pins_that_are_tested() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    declared = [Requirement(text) for text in (*project["dependencies"], *project["optional-dependencies"]["test"])]
    names = {Requirement(text).name for text in project["dependencies"]} | TOOLS_OF_THE_SUBSET
    floors = {one.name: Version(str(one.specifier).removeprefix(">=")) for one in declared if one.name in names}
    lines = (ROOT / ".ci" / "lowest.txt").read_text(encoding="utf-8").splitlines()
    pins = dict(line.split("==") for line in lines if line and not line.startswith("#"))
    assert {name: Version(pin) for name, pin in pins.items()} == floors


def test_the_tests_that_the_lowest_versions_must_pass_are_there() -> None:
    named = re.findall(r"tests/test_\w+\.py", (ROOT / ".ci" / "lowest").read_text(encoding="utf-8"))
    assert named
    assert all((ROOT / name).is_file() for name in named)
