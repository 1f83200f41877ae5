"""The experiments on the scale factor and on alignment run, and print the numbers that do not depend on chance."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]


def printed(code: list[str], shared: Path) -> str:
    assert shared.is_dir()
    done = subprocess.run([sys.executable, *code], cwd=ROOT, capture_output=True, text=True, check=True)
    return done.stdout


def test_zhan_2010(shared: Path, tmp_path: Path) -> None:
    output = printed(["-m", "experiments.zhan_2010", "--quick", "--out", str(tmp_path / "figures")], shared)
    for number in ("| 0.84279066 | 0.8427906570 |", "1.0577e-06", "(0.318 + 0.500 + 0.145 + 1.000) = 2.78", "+0.0021″", "0.0064″"):
        assert number in output
    assert {path.name for path in (tmp_path / "figures").iterdir()} == {
        f"figure_{n}.{kind}" for n in (5, 6) for kind in ("png", "csv")
    }


@pytest.mark.parametrize(
    ("section", "numbers"),
    [
        ("scale_factor", ["1408/11", "66/10", "std 0.651 is printed as 0.6", "18 deg/s is missing", "0.65 to 0.97"]),
        ("alignment", ["| (19), free ε | 49 ± ", "| in quadrature | 61 ± ", "| (19), free ε | 148 ± ", "50.0° and 46.2°"]),
    ],
)
def test_sections_of_liu_2019(section: str, numbers: list[str], shared: Path) -> None:
    output = printed(["-c", f"from experiments.liu_2019 import {section}; {section}.show(True)"], shared)
    for number in numbers:
        assert number in output


def test_without_the_published_tables_there_is_a_message(tmp_path: Path) -> None:
    code = (
        f"from pathlib import Path; import experiments.tables as t; t.FOLDER = Path({str(tmp_path)!r}); t.published('liu_table3')"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 1
    assert "kept beside the project" in done.stderr
    assert "Traceback" not in done.stderr
