"""The experiment on courses behind readings prints what it says, and courses are nearer the truth than readings."""

from __future__ import annotations

import pytest

from experiments.readings.__main__ import main


def test_courses_are_nearer_the_truth_than_readings(capsys: pytest.CaptureFixture[str]) -> None:
    main(["--units", "8"])
    rows = [line.strip("| ").split(" | ") for line in capsys.readouterr().out.splitlines() if line.startswith("| ")]
    assert rows[0][:6] == ["column", "number", "read", "alone", "together", "rate"]
    of_kind = {name: [float(one) for one in cells[:5]] for name, *cells in rows[1:]}
    assert of_kind["thermometer, rounded"][3] < 0.5 * of_kind["thermometer, rounded"][1]
    assert of_kind["readouts"][3] < of_kind["readouts"][2] < of_kind["readouts"][1]
