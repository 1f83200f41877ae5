"""Tables that were recorded fast are asked as if they had been recorded ten times a second."""

from __future__ import annotations

import dataclasses

import numpy as np
import pandas as pd
import pytest

import rlgcomp as rlg
from rlgcomp.diagnosis.diagnose import diagnose
from rlgcomp.diagnosis.question.coarser import coarser, said_of
from rlgcomp.physics import CATALOGUE
from rlgcomp.physics.lock_in import LockIn
from rlgcomp.recording import Metadata
from rlgcomp.recording.motion import angle_deg, rate_deg_s

PROGRAMME = "rate 3 60, rate 10 60, rate 40 60, rate -3 60, rate -10 60, rate -40 60"
KINDS = CATALOGUE.values()


def fast(seed: int = 1, step_s: float = 0.01, *mechanisms: object) -> rlg.Recording:
    """A gyro on a table, a hundred samples a second."""
    simulator = rlg.Simulator.from_mapping(
        {"kind": "turntable", "mechanisms": ["scale_factor", *mechanisms], "noise": {"angle_random_walk_deg_sqrt_h": 5e-4}}
    )
    return simulator.simulate(PROGRAMME, seed=seed, step_s=step_s)


def test_what_a_slower_recorder_would_have_written() -> None:
    run = fast()
    (coarse,) = coarser([run], KINDS, 10.0)
    assert coarse.period_s == pytest.approx(0.1)
    assert len(coarse) == len(run) // 10
    many = 10 * len(coarse)
    assert coarse.rate_deg_h() == pytest.approx(run.rate_deg_h()[:many].reshape(-1, 10).mean(axis=1))
    assert coarse.time_s == pytest.approx(run.time_s[9:many:10])
    assert angle_deg(coarse) == pytest.approx(angle_deg(run)[9:many:10], abs=1e-9)
    from_angles = rlg.Recording(run.table.drop(columns="table_rate_deg_s", errors="ignore"), run.metadata, name="angles")
    (coarse,) = coarser([from_angles], KINDS, 10.0)
    assert rate_deg_s(coarse)[1:] == pytest.approx(rate_deg_s(from_angles)[:many].reshape(-1, 10).mean(axis=1)[1:], abs=1e-9)


def test_counts_are_added_up_and_no_group_spans_a_gap() -> None:
    n = 4000
    rng = np.random.default_rng(1)
    time_s = 0.01 * np.arange(1.0, n + 1)
    table = pd.DataFrame({"time_s": time_s, "gyro_pulses": rng.integers(-5, 50, n), "table_angle_deg": 0.2 * np.arange(n)})
    gap = (np.arange(n) < 1234) | (np.arange(n) >= 1301)
    run = rlg.Recording(table[gap].astype(float), Metadata(kind="turntable", pulse_arcsec=1.0), name="counts")
    (coarse,) = coarser([run], KINDS, 10.0)
    pulses = run.column("gyro_pulses")
    sums = [*pulses[:1230].reshape(-1, 10).sum(axis=1), *pulses[1234 : 1234 + 2690].reshape(-1, 10).sum(axis=1)]
    assert coarse.column("gyro_pulses") == pytest.approx(sums)
    assert len(coarse.gaps) == 1


def test_slow_tables_and_what_would_lose_something_stay_as_they_are() -> None:
    slow = fast(step_s=0.1)
    assert coarser([slow], KINDS, 10.0) == [slow]
    run = fast()
    assert coarser([run], KINDS, 0.5) == [run]  # a window would hold too few samples

    @dataclasses.dataclass(frozen=True)
    class Ones(LockIn):
        name = "ones_own"

    assert coarser([run], [*KINDS, Ones], 10.0) == [run]
    assert said_of([run], [run]) == ()


def test_the_answer_is_that_of_all_samples() -> None:
    lock_in = {"lock_in": {"lock_in_deg_s": 0.02}}
    train, test = [fast(1, 0.01, lock_in), fast(2, 0.01, lock_in)], [fast(3, 0.01, lock_in)]
    simulator = rlg.Simulator.from_mapping({"kind": "turntable", "mechanisms": ["scale_factor"]})
    found = diagnose(simulator, train, test, black_box=False)
    assert [cause.name for cause in found.causes] == ["lock_in"]
    rate = found.causes[0].parameters["lock_in_deg_s"]
    assert abs(rate.value - 0.02) < 4.0 * rate.sd
    assert [remark for remark in found.remarks if "Samples were averaged to" in remark]
