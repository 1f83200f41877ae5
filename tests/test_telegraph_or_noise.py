"""What tells a telegraph from slow noise: its odds by an identity, its program by its output."""

from __future__ import annotations

import numpy as np
import pytest

from experiments.telegraph_or_noise.__main__ import WINDOW_S, main, odds, telegraph
from rlgcomp.diagnosis.noise.whitening import Rows


def rows_of(count: int, runs: int = 1) -> Rows:
    return Rows(np.tile(WINDOW_S * np.arange(count), runs), np.repeat(np.arange(runs), count), np.ones(runs * count), WINDOW_S)


def test_likelihood_ratios_average_to_one() -> None:
    """Of what is false over what is true: both likelihoods are exact, but for windows that flip twice, or this is not so."""
    alike, nothing = odds(rows_of(40), 0.6, 900.0, 2_000, np.random.default_rng(2))
    for log_odds in (alike, nothing):
        ratio = np.exp(-log_odds)
        assert abs(ratio.mean() - 1.0) < 4.0 * ratio.std() / np.sqrt(len(ratio))
    assert alike.mean() > 0.0


def test_jumps_are_as_many_as_they_should_be() -> None:
    dwell_s = 1500.0
    signs = telegraph(rows_of(400, 2), dwell_s, 200, np.random.default_rng(0))
    apart = np.mean(signs[:300] * signs[10:310])
    assert apart == pytest.approx(np.exp(-2.0 * 10 * WINDOW_S / dwell_s), abs=0.02)
    assert abs(np.mean(signs[399] * signs[400])) < 0.3  # runs are independent


def test_the_program_prints_its_tables(capsys: pytest.CaptureFixture[str]) -> None:
    main(["--draws", "2"])
    said = capsys.readouterr().out
    assert said.count("decided at 20 to 1") == 2
    assert "| 0.25 |" in said
