"""How a recording tells its table's motion is no physics of the gyro: it is said, with its number, and nothing is named for it."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

import rlgcomp as rlg
from rlgcomp.diagnosis.conventions import with_mean_rates
from rlgcomp.simulation.table_programme import TableProgramme
from tests.small_table_runs import NOISE_1S_DEG_H, SIMULATOR

PROGRAMME = TableProgramme.parse("rate 3 200, rate -3 200, rate 10 200, rate -10 200, rate 30 200, rate -30 200, rest 60")


def healthy(*, angle_late_s: float = 0.0, instant: bool = False, noisy_deg_s: float = 0.0) -> rlg.Recording:
    """A healthy gyro whose angle is read late, beside a rate that is that at the instant, or noisy, or none."""
    edges_s = np.arange(0.0, PROGRAMME.duration_s)
    time_s = edges_s[1:]
    rng = np.random.default_rng(4)
    turned = np.diff(PROGRAMME.angle_deg(edges_s))
    table = {
        "time_s": time_s,
        "gyro_deg_s": turned * (1.0 + 200e-6) + (5.0 + NOISE_1S_DEG_H * rng.standard_normal(len(time_s))) / 3600.0,
        "table_angle_deg": PROGRAMME.angle_deg(time_s - angle_late_s),
    }
    if instant:
        table["table_rate_deg_s"] = (PROGRAMME.angle_deg(time_s + 1e-4) - PROGRAMME.angle_deg(time_s - 1e-4)) / 2e-4
    elif noisy_deg_s:
        table["table_rate_deg_s"] = turned + noisy_deg_s * rng.standard_normal(len(time_s))
    return rlg.Recording(pd.DataFrame(table), rlg.Metadata(kind="turntable"), name="run0")


@pytest.mark.parametrize(
    ("run", "column", "late"),
    [(healthy(angle_late_s=0.5), "table_angle_deg", 0.5), (healthy(instant=True), "table_rate_deg_s", -0.5)],
    ids=["an angle read in the middle of the sample", "a rate at the instant"],
)
def test_a_convention_is_told_with_its_number_and_no_physics_is_named(run: rlg.Recording, column: str, late: float) -> None:
    found = rlg.diagnose(SIMULATOR, [run], black_box=False)
    assert found.verdict == "none"
    (remark,) = (one for one in found.remarks if one.code == "diagnosis.time_stamp_convention")
    assert remark.data["column"] == column
    assert remark.data["late_samples"] == pytest.approx(late, abs=0.03)
    assert found.after.numbers["scale_factor"]["k_ppm"].value == pytest.approx(200.0, abs=0.5)


def test_what_is_not_told_is_left_out_and_a_plain_recording_stays_as_it_is() -> None:
    run = healthy(angle_late_s=0.5)
    (meant,), (told,) = with_mean_rates([run], None)
    assert told.data["means"] == "middle"
    assert len(meant) == round((1.0 - told.data["left_out"]) * len(run))
    assert 0.0 < told.data["left_out"] < 0.2
    over = np.diff(PROGRAMME.angle_deg(np.r_[0.0, run.time_s]))[np.isin(run.time_s, meant.time_s)]
    assert meant.column("table_rate_deg_s") == pytest.approx(over, abs=1e-6)
    plain = healthy()
    (same,), messages = with_mean_rates([plain], None)
    assert same is plain
    assert not messages


def test_a_noisy_rate_gives_its_place_to_the_encoder() -> None:
    _, (told,) = with_mean_rates([healthy(noisy_deg_s=1e-3)], None)
    assert told.data["means"] == "angle"
    assert told.data["instead"] == "table_angle_deg"
    assert abs(told.data["late_samples"]) < 0.05


def test_an_encoder_alone_tells_the_rate() -> None:
    """The same physics is found as with the rate beside it, and what was done is said."""
    run = healthy()
    assert "table_rate_deg_s" not in run
    found = rlg.diagnose(SIMULATOR, [run], black_box=False)
    assert found.verdict == "none"
    assert found.after.numbers["scale_factor"]["k_ppm"].value == pytest.approx(200.0, abs=0.5)
    (remark,) = (one for one in found.remarks if one.code == "diagnosis.rate_of_encoder")
    assert remark.data["column"] == "table_angle_deg"
    blind = run.replace(table=run.table.drop(columns="table_angle_deg"))
    with pytest.raises(rlg.InputError, match="--map table_rate_deg_s"):
        rlg.diagnose(SIMULATOR, [blind], black_box=False)
