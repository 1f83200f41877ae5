"""One sample that a turning gyro miscounts is no physics; what a table's own passages make of every sample stays."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

import rlgcomp as rlg
from rlgcomp.recording.count_errors import without_miscounts

SAMPLE_S = 1.0
NOISE_DEG_H = 0.03  # of a sample


def turning(
    *, delay_s: float = 0.0, encoder_arcsec: float = 0.02, pulse_arcsec: float | None = None, seed: int = 3
) -> rlg.Recording:
    """Ten minutes at each rate, 5 deg/s² between them, as an encoder and a gyro's pulses tell it."""
    rng = np.random.default_rng(seed)
    fine_s, now, pieces = SAMPLE_S / 10.0, 0.0, []
    for rate in [10.0, -10.0, 30.0, -30.0, 60.0, -60.0, 0.0, 20.0, -20.0] * 2:
        pieces += [np.linspace(now, rate, round(abs(rate - now) / 5.0 / fine_s)), np.full(round(600.0 / fine_s), rate)]
        now = rate
    angle = np.cumsum(np.concatenate(pieces)) * fine_s
    seen = np.interp(np.arange(len(angle)) * fine_s - delay_s, np.arange(len(angle)) * fine_s, angle)[::10]
    rate_deg_s = np.diff(np.round(3600.0 * seen / encoder_arcsec) * encoder_arcsec / 3600.0) / SAMPLE_S
    gyro_deg_h = (1.0 + 1e-5) * 3600.0 * np.diff(angle[::10]) / SAMPLE_S + 8.0
    gyro_deg_h += NOISE_DEG_H * rng.standard_normal(len(gyro_deg_h))
    table = {"time_s": SAMPLE_S * np.arange(1, len(gyro_deg_h) + 1), "gyro_deg_h": gyro_deg_h, "table_rate_deg_s": rate_deg_s}
    if pulse_arcsec is not None:
        counts = np.diff(np.floor(np.cumsum(table.pop("gyro_deg_h")) * SAMPLE_S / pulse_arcsec), prepend=0.0)
        table["gyro_pulses"] = counts
    return rlg.Recording(pd.DataFrame(table), rlg.Metadata("turntable", pulse_arcsec=pulse_arcsec), name="table")


def miscounted(run: rlg.Recording, rows: list[int], arcsec: float) -> rlg.Recording:
    (column,) = run.gyro_columns
    values = run.column(column).copy()
    values[rows] += arcsec / (SAMPLE_S if run.metadata.pulse_arcsec is None else run.metadata.pulse_arcsec)
    return run.replace(table=run.table.assign(**{column: values}))


def begins(run: rlg.Recording) -> list[int]:
    """The row before each passage from rate to rate."""
    changes = np.abs(np.diff(run.column("table_rate_deg_s"))) > 0.3
    return [int(row) for row in np.flatnonzero(np.diff(changes.astype(int)) == 1)]


@pytest.mark.parametrize("after", [-300, 0, 1, 2, 3])
def test_a_miscount_in_a_passage_or_a_steady_rate_lies_between_its_neighbours(after: int) -> None:
    sound = turning()
    row = begins(sound)[8] + after
    mended, said = without_miscounts(miscounted(sound, [row], 2.26), None)
    assert said is not None
    assert f"the first at {sound.time_s[row]:.6g} s, as no other passage of the table makes one" in said
    left = mended.rate_deg_h() - sound.rate_deg_h()
    assert abs(left[row]) < 5.0 * NOISE_DEG_H
    assert np.flatnonzero(left).tolist() == [row]


def test_a_count_that_comes_a_sample_late_is_told_once() -> None:
    sound = turning()
    row = begins(sound)[8] + 1
    late = miscounted(miscounted(sound, [row], -2.26), [row + 1], 2.26)
    mended, said = without_miscounts(late, None)
    assert said is not None
    assert said.startswith("table: 2 samples stand")
    assert np.abs(mended.rate_deg_h() - sound.rate_deg_h()).max() < 5.0 * NOISE_DEG_H


def test_of_whole_pulses_whole_pulses_stay() -> None:
    sound = turning(pulse_arcsec=0.5)
    mended, said = without_miscounts(miscounted(sound, [5000], 50.0), None)
    assert said is not None
    assert mended.column("gyro_pulses")[5000] == pytest.approx(sound.column("gyro_pulses")[5000], abs=1.0)
    assert np.array_equal(mended.column("gyro_pulses"), np.rint(mended.column("gyro_pulses")))


@pytest.mark.parametrize("delay_s", [0.0, 1e-5, 1e-3, 0.3])
@pytest.mark.parametrize("encoder_arcsec", [0.02, 1.0])
def test_what_every_passage_shows_is_the_gyros_own(delay_s: float, encoder_arcsec: float) -> None:
    run = turning(delay_s=delay_s, encoder_arcsec=encoder_arcsec)
    assert without_miscounts(run, None) == (run, None)


def test_what_only_one_passage_could_show_is_not_called_a_miscount() -> None:
    run = turning()
    rate = run.column("table_rate_deg_s").copy()
    rate[4000] += 5.0  # the table is struck, and the gyro, of a finite band, shows but nearly all of it
    gyro = run.rate_deg_h() + 3599.0 * (rate - run.column("table_rate_deg_s"))
    struck = run.replace(table=run.table.assign(table_rate_deg_s=rate, gyro_deg_h=gyro))
    assert without_miscounts(struck, None) == (struck, None)


def test_a_run_that_tells_no_motion_is_left_alone() -> None:
    run = turning()
    still = run.replace(table=run.table.drop(columns="table_rate_deg_s"))
    assert without_miscounts(still, None) == (still, None)


def test_a_miscount_makes_no_encoder_late() -> None:
    runs = [turning(seed=seed) for seed in (1, 2)]
    simulator = rlg.Simulator(kind="turntable").with_mechanism(rlg.CATALOGUE["scale_factor"]())
    row = begins(runs[0])[8] + 1
    found = rlg.diagnose(simulator, train=[miscounted(runs[0], [row], 2.26), runs[1]], black_box=False)
    assert (found.verdict, found.causes) == ("none", ())
    assert any("a miscount or a fault of the logger" in remark for remark in found.remarks)
