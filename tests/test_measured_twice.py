"""What two sensors measure: the light of both beams, by its own photodiode and by both halves of the readout."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from rlgcomp.diagnosis.data import Grid
from rlgcomp.diagnosis.diagnose import Diagnosis, diagnose
from rlgcomp.recording import Metadata, Recording
from rlgcomp.simulation.simulator import Simulator

STEP_S = 10.0
GAINS = 0.8, 1.1  # of both halves of the readout


def asked(*, of_light: float = 0.0, of_contrast: float = 0.0, light_error: float = 0.0) -> Diagnosis:
    """A gyro that follows the light or the contrast of its readout; the photodiode of the light has errors."""
    runs = []
    for k in range(3):
        rng = np.random.default_rng([23, k])
        n = 2400
        light, contrast = (np.cumsum(rng.standard_normal(n)) / 40.0 for _ in range(2))
        a, b = ((1.0 + 0.01 * light) * gain * (1.0 + sign * 0.01 * contrast) for gain, sign in zip(GAINS, (1.0, -1.0), strict=True))
        table = {
            "time_s": STEP_S * np.arange(n),
            "gyro_deg_h": of_light * light + of_contrast * contrast + 0.02 * rng.standard_normal(n),
            "light_intensity_V": 1.0 + 0.01 * (light + light_error * rng.standard_normal(n)),
            "readout_a_V": a,
            "readout_b_V": b,
        }
        runs.append(Recording(pd.DataFrame(table), Metadata(kind="chamber"), name=f"run{k}"))
    simulator = Simulator.from_mapping({"kind": "chamber", "mechanisms": []})
    return diagnose(simulator, runs, window_s=2.0 * Grid.of(runs).window_s, black_box=False)


def test_light_that_the_readout_measures_better_is_light() -> None:
    """It is no law of the readout's difference, and follows the columns that tell it."""
    (finding,) = asked(of_light=0.05, light_error=0.5).to_mapping()["findings"]
    assert finding["mechanism"] == "light_intensity"
    assert finding["drivers"] == ["readout_a_V", "readout_b_V"]
    assert "k_deg_h_V" not in finding["parameters"]  # which is by volt of the light's own photodiode
    k = finding["parameters"]["k"]
    assert k["value"] == pytest.approx(0.05 / (0.01 * np.mean(GAINS)), abs=4.0 * k["sd"])


def test_light_that_its_own_photodiode_measures_is_read_there() -> None:
    (finding,) = asked(of_light=0.05).to_mapping()["findings"]
    assert (finding["mechanism"], finding["drivers"]) == ("light_intensity", ["light_intensity_V"])
    k = finding["parameters"]["k_deg_h_V"]
    assert k["value"] == pytest.approx(5.0, abs=4.0 * k["sd"])


def test_halves_of_two_gains_have_the_contrast_of_equal_ones() -> None:
    (finding,) = asked(of_contrast=0.05, light_error=0.5).to_mapping()["findings"]
    assert finding["mechanism"] == "readout_incoherence"
    k = finding["parameters"]["k_deg_h"]
    slope = 1.0 - ((GAINS[0] - GAINS[1]) / sum(GAINS)) ** 2  # of the contrast over that of equal gains
    assert k["value"] == pytest.approx(5.0 / slope, rel=0.01)
