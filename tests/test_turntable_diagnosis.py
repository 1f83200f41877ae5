"""The one model where a table turns: what it names, and the rows for what varies within windows."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from rlgcomp.diagnosis.data import Data, Grid, Run
from rlgcomp.diagnosis.diagnose import Diagnosis, diagnose
from rlgcomp.diagnosis.forms.bases import Own
from rlgcomp.diagnosis.forms.drivers import Path
from rlgcomp.diagnosis.noise.model import Noise
from rlgcomp.diagnosis.regions.turntable import RatePower, TableRate, with_angle_rows
from rlgcomp.physics import CATALOGUE
from rlgcomp.physics.misalignment import Misalignment
from rlgcomp.recording import Recording
from rlgcomp.simulation.simulator import Simulator

PROGRAMME = "rest 120, rate 3 400, rate -3 400, rate 20 400, rate -20 400, sweep -4 4 600, rate 50 300, rate -50 300"
BASELINE: dict[str, Any] = {"kind": "turntable", "mechanisms": ["scale_factor"]}
BASE = Simulator.from_mapping(BASELINE)
CUBE = RatePower(Path(TableRate(("table_rate_deg_s",), half=50.0)), 3.0, odd=True)
NOISE = {"angle_random_walk_deg_sqrt_h": 0.0005}


def made(*missing: str | dict[str, Any], seed: int = 3, runs: int = 2) -> list[Recording]:
    """Runs of a gyro with what the simulator of the tests lacks."""
    simulator = Simulator.from_mapping({"kind": "turntable", "mechanisms": ["scale_factor", *missing], "noise": NOISE})
    return [simulator.simulate(PROGRAMME, seed=seed + k, name=f"run{k}") for k in range(runs)]


def asked(train: list[Recording], *tests: Recording, **options: Any) -> Diagnosis:
    """On windows three times as long as by default, of which there are a third as many."""
    return diagnose(BASE, train, tests, window_s=3.0 * Grid.of(train).window_s, black_box=False, **options)


CASES: list[tuple[tuple[str | dict[str, Any], ...], list[str]]] = [
    ((), []),
    (({"lock_in": {"lock_in_deg_s": 0.03}},), ["lock_in"]),
    (({"misalignment": {"cosine_arcsec": 0.3, "sine_arcsec": 0.2}},), ["misalignment"]),
    (
        ({"scale_factor_asymmetry": {"k_ppm": 1.0}}, {"encoder_delay": {"delay_s": 1e-5}}),
        ["encoder_delay", "scale_factor_asymmetry"],
    ),
]


@pytest.mark.parametrize(("missing", "expected"), CASES, ids=lambda value: "+".join(map(str, value))[:40] or "none")
def test_names_what_is_missing_of_a_table(missing: tuple[str | dict[str, Any], ...], expected: list[str]) -> None:
    found = asked(made(*missing)).to_mapping()
    assert sorted(finding["mechanism"] for finding in found["findings"]) == expected
    assert found["verdict"] in (("explained", "ambiguous") if expected else ("none",))


@pytest.mark.parametrize(
    "missing",
    [
        {"scale_factor_temperature": {"k_ppm_K": 0.4}},
        {"scale_factor_nonlinearity": {"k_ppm": 2.0, "order": 3}},
        {"rotation_harmonics": {"order_1": 2, "order_2": 5, "cosine_1_deg_h": 0.02, "sine_2_deg_h": 0.02}},
    ],
    ids=lambda value: next(iter(value)),
)
def test_augmented_file_holds_what_is_named_of_a_table(missing: dict[str, Any]) -> None:
    *train, test = made(missing, runs=3)
    found = asked(train, test, only=[*missing, "misalignment", "encoder_delay"])
    assert [finding["mechanism"] for finding in found.to_mapping()["findings"]] == list(missing)
    assert test.truth is not None
    without_noise = test.truth[["scale_factor", *missing]].sum(axis=1) + BASE.nominal_deg_h(test)
    off, before = (np.std(one.predict(test).rate_deg_h() - without_noise) for one in (found.augmented, found.calibrated))
    assert off < 0.3 * before
    (cause,) = found.causes
    truth = CATALOGUE[cause.name](**missing[cause.name])
    for name, one in cause.parameters.items():
        assert abs(one.value - getattr(truth, name)) < 4.0 * one.sd
    assert cause.parameters or cause.name == "rotation_harmonics"  # of two orders


@pytest.fixture(scope="module")
def data() -> Data:
    runs = made()
    grid = Grid.of(runs, every_sample=True)
    plain = Data(tuple(Run.of(run, grid, lambda binned: binned.rate_deg_h()) for run in runs))
    return with_angle_rows(plain, [Own(Misalignment()), CUBE], lambda binned: binned.rate_deg_h())


def test_rows_keep_all_of_a_term(data: Data) -> None:
    """Sums of products of all samples are those of the rows, a sample's noise being that of a window's mean times its samples."""
    for run in data.runs:
        counted = np.repeat(run.full, run.grid.bins)
        one, other = Own(Misalignment()).columns(run), CUBE.columns(run)
        for a, b in ((one, one), (one, other), (other, other)):
            rows = run.means(a).T @ run.means(b)
            assert run.grid.bins * rows == pytest.approx(a[counted].T @ b[counted], rel=2e-3, abs=1e-6 * np.abs(rows).max())


def test_noise_of_the_encoder_is_that_of_differences(data: Data) -> None:
    run, rng = data.runs[0], np.random.default_rng(4)
    readings = rng.standard_normal((run.bins + 1, 400))
    drawn = run.means(np.sqrt(run.grid.bins) * np.diff(readings, axis=0))
    stated = Noise(encoder=1.0).covariances(data)[0] - Noise().covariances(data)[0]
    assert np.mean(drawn**2, axis=1) == pytest.approx(np.diag(stated), rel=0.5)
    assert np.mean(drawn**2) == pytest.approx(np.mean(np.diag(stated)), rel=0.03)
