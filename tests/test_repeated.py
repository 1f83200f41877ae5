"""Diagnoses of the same runs with other outputs share what does not depend on the output, and nothing else changes."""

from __future__ import annotations

import numpy as np
import pytest

from rlgcomp.challenge.injection import injected
from rlgcomp.challenge.repeated import Repeated
from rlgcomp.diagnosis.diagnose import diagnose
from rlgcomp.physics import CATALOGUE
from rlgcomp.recording import Recording
from rlgcomp.simulation.simulator import Simulator
from tests.few_monitors import few_monitors
from tests.two_hour_runs import runs_of

SIMULATOR = Simulator.from_mapping(
    {
        "kind": "chamber",
        "mechanisms": [{"thermal_polynomial": {"degree": 2}}],
        "noise": {"angle_random_walk_deg_sqrt_h": 0.0005},
    }
)
FEW = {name: CATALOGUE[name] for name in ("supply_voltage", "thermal_lag")}


@pytest.fixture(scope="module")
def runs() -> list[Recording]:
    """Rows twice as far apart as usual."""
    runs = (few_monitors(run) for run in runs_of(SIMULATOR, 2))
    return [run.replace(table=run.table.iloc[::2].reset_index(drop=True), truth=None) for run in runs]


def test_each_is_the_diagnosis_of_the_changed_runs(runs: list[Recording]) -> None:
    repeated = Repeated.of(SIMULATOR, runs, mechanisms=FEW)
    times, keys = [run.time_s for run in runs], []
    for volts in (0.0, 0.5):
        added = [volts * (run.column("supply_voltage_V") - 15.0) for run in runs]
        changed = [injected(run, values, None) for run, values in zip(runs, added, strict=True)]
        found, whole = repeated.posterior(times, added), diagnose(SIMULATOR, changed, mechanisms=FEW, black_box=False).posterior
        assert found.best.key == whole.best.key
        assert ("supply_voltage" in found.effects(found.best.key)) == (volts > 0.0)
        assert found.null == pytest.approx(whole.null, rel=1e-3)
        assert found.p_value == pytest.approx(whole.p_value, rel=1e-3)
        keys.append(found.best.key)
    again = repeated.posterior(times, [np.zeros(len(run)) for run in runs])
    assert again.best.key == keys[0]  # whatever was asked between


def test_draws_of_the_null_are_made_once(runs: list[Recording]) -> None:
    repeated = Repeated.of(SIMULATOR, runs, mechanisms={"supply_voltage": CATALOGUE["supply_voltage"]})
    zeros = [np.zeros(len(run)) for run in runs]
    first = repeated.posterior([run.time_s for run in runs], zeros)
    assert repeated.layout.drawn
    second = repeated.posterior([run.time_s for run in runs], zeros)
    assert second.in_noise == pytest.approx(first.in_noise)
    assert np.isnan(second.left_in_noise)
