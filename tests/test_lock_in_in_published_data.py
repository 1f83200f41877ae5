"""Liu's table 3 against a linear scale factor: real measurements, so nobody knows the answer but that the gyros locked."""

from __future__ import annotations

import numpy as np
import pytest

from experiments.tables import FOLDER

pytestmark = pytest.mark.skipif(not (FOLDER / "liu_table3.csv").is_file(), reason="the published tables are not beside the project")


def test_the_recordings_are_the_table() -> None:
    """Every published value once, and no bias can pose as a scale-factor error."""
    from experiments.lock_in_in_published_data.recordings import recording, table_3

    table = table_3()
    run = recording(table, range(5), "all")
    error_ppm = 1e6 * (run.column("gyro_deg_s") / run.column("table_rate_deg_s") - 1.0)
    assert np.sort(error_ppm) == pytest.approx(np.sort(table.error_ppm.ravel()), abs=1e-6)
    turned = run.column("table_rate_deg_s")
    assert abs(turned.mean()) < 0.1 * np.abs(turned).mean()


def test_lock_in_is_found_with_an_honest_error_and_the_hump_is_left() -> None:
    from experiments.lock_in_in_published_data import study

    found = study.diagnosis()
    (lock_in,) = [cause for cause in found.causes if cause.name == "lock_in"]
    assert lock_in.probability > 0.99
    assert found.p_value < 1e-6
    models = study.lock_in_rates()
    rate, sd = models["the diagnosis"]
    assert 0.026 < rate < 0.035  # seed-mathematics, section 4: 0.027 to 0.034 by the model
    assert sd > 0.0002
    assert found.test is not None
    assert found.test.improvement > 0.5
    assert found.augmented_file.error < 0.2  # in units of the noise of a window: the file holds what was fitted
    left, error = study.fit_each().left
    hump = (study.table_3().rate_deg_s >= 3.0) & (study.table_3().rate_deg_s <= 12.0)
    assert (left[hump] > 4.0 * error[hump]).all()
    assert "hump" in study.hump(left)
