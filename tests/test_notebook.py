"""The notebook: its cells run in order, without Jupyter, and give what its text says."""

from __future__ import annotations

import functools
import json
from pathlib import Path
from typing import Any

import matplotlib as mpl
import pytest
from matplotlib import pyplot

import rlgcomp as rlg

NOTEBOOK = Path(__file__).parents[1] / "docs" / "notebook" / "rlgcomp.ipynb"


@pytest.fixture(scope="module")
def cells() -> list[dict[str, Any]]:
    return json.loads(NOTEBOOK.read_text(encoding="utf-8"))["cells"]


def test_the_cells_run(cells: list[dict[str, Any]], monkeypatch: pytest.MonkeyPatch) -> None:
    """The README's lines in Python make the same diagnosis among all candidates; here some will do, on longer windows."""
    few = {"only": ["readout_incoherence", "light_intensity", "thermal_lag"], "window_s": 100.0, "black_box": False}
    monkeypatch.setattr("rlgcomp.diagnose", functools.partial(rlg.diagnose, **few))
    names: dict[str, Any] = {}
    code = [cell for cell in cells if cell["cell_type"] == "code"]
    with mpl.rc_context({"backend": "agg"}):
        pyplot.switch_backend("agg")
        for k, cell in enumerate(code):
            exec(compile("".join(cell["source"]), f"cell {k}", "exec"), names)  # noqa: S102
        pyplot.close("all")
    assert names["evaluation"].residual_std_deg_h < 0.5 * names["evaluation"].raw_std_deg_h
    assert [cause.name for cause in names["diagnosis"].causes] == ["readout_incoherence"]
    assert names["cause"].latex.startswith(r"b = \frac{k")


def test_it_is_kept_with_its_outputs(cells: list[dict[str, Any]]) -> None:
    code = [cell for cell in cells if cell["cell_type"] == "code"]
    assert all(cell["execution_count"] for cell in code)
    kinds = [set(output.get("data", {})) for cell in code for output in cell["outputs"]]
    assert sum("image/png" in kind for kind in kinds) == 5
    assert not any(output["output_type"] == "error" for cell in code for output in cell["outputs"])
