"""The next experiment of the one-model engine: distances by brute force, a programme that parts sets, and sets that none parts."""

from __future__ import annotations

import numpy as np
import pytest

from rlgcomp.diagnosis.answer.fit import Fit
from rlgcomp.diagnosis.data import Grid
from rlgcomp.diagnosis.diagnose import diagnose
from rlgcomp.diagnosis.next_experiment import design
from rlgcomp.diagnosis.next_experiment.design import distances, expected, next_experiment
from rlgcomp.diagnosis.next_experiment.laboratory import RateTable
from rlgcomp.diagnosis.next_experiment.programmes import table_programmes
from rlgcomp.diagnosis.report.result import Diagnosis
from rlgcomp.errors import InputError
from rlgcomp.recording import Recording
from rlgcomp.simulation.simulator import Simulator
from rlgcomp.simulation.table_programme import TableProgramme
from tests.few_monitors import few_monitors

NOISE = {"angle_random_walk_deg_sqrt_h": 0.0003}
BASE = Simulator.from_mapping({"kind": "chamber", "mechanisms": [{"thermal_polynomial": {"degree": 2}}], "noise": NOISE})
LAG = {"thermal_lag": {"k_deg_h_K": 0.005, "time_constant_s": 3000.0}}
RATE = {"temperature_rate": {"k_deg_h_min_K": 0.04}}


def real(missing: dict[str, dict[str, float]]) -> Simulator:
    mechanisms = [{"thermal_polynomial": {"degree": 2}}, missing]
    return Simulator.from_mapping({"kind": "chamber", "mechanisms": mechanisms, "noise": NOISE})


def asked(simulator: Simulator, runs: list[Recording], *only: str) -> Diagnosis:
    """On windows 2.5 times as long as by default."""
    return diagnose(
        simulator, [few_monitors(run) for run in runs], only=only, window_s=2.5 * Grid.of(runs).window_s, black_box=False
    )


@pytest.fixture(scope="module")
def one_ramp() -> Recording:
    return real(LAG).simulate("start 20, ramp 50 2, hold 120", step_s=40.0, name="one ramp")


@pytest.fixture(scope="module")
def found(one_ramp: Recording) -> Diagnosis:
    return asked(BASE, [one_ramp], "thermal_lag", "ageing")


def fits_of(found: Diagnosis, *names: str) -> list[Fit]:
    states = [state for name in names for state in found.posterior.states if state.key == (frozenset([name]), "")]
    return [Fit(found.before.data, found.before.baseline, found.before.bank, state) for state in states]


def test_distances_are_those_of_the_covariance_of_what_a_rival_may_be(found: Diagnosis) -> None:
    truth, rival = fits = fits_of(found, "thermal_lag", "ageing")
    (run,) = found.after.data.runs
    d = run.means(truth.predicted(run) - rival.predicted(run))
    noise = rival.state.noise.covariance(run.windows, run.white, len(run.full))
    table = np.hstack([scale * run.means(basis.columns(run)) for _, bases in rival.parts for basis, scale in bases])
    free = run.means(rival.baseline.columns(run))
    free = free / np.linalg.norm(free, axis=0)
    covariance = rival.white**2 * noise + table @ rival.solution.covariance @ table.T + 1e4 * free @ free.T
    assert distances(fits, run)[0, 1] == pytest.approx(d @ np.linalg.solve(covariance, d), rel=1e-3)


def test_expected_probabilities_are_means_over_the_log_likelihood_ratio() -> None:
    squares = np.array([[0.0, 9.0], [9.0, 0.0]])
    drawn = np.random.default_rng(0).normal(4.5, 3.0, 200_000)
    assert expected(np.array([0.7, 0.3]), squares)[0] == pytest.approx(np.mean(0.7 / (0.7 + 0.3 * np.exp(-drawn))), abs=2e-3)
    np.testing.assert_allclose(expected(np.array([0.7, 0.3]), np.zeros((2, 2))), [0.7, 0.3])


def test_the_programme_it_proposes_parts_the_sets(found: Diagnosis, one_ramp: Recording) -> None:
    fits = fits_of(found, "thermal_lag", "ageing")
    experiment, promise = next_experiment(found.posterior, fits, [fit.state for fit in fits], None)
    assert experiment is not None
    assert promise is not None
    assert promise.code == "diagnosis.next_experiment"
    assert promise.data["expected"] == experiment.expected_probability_after > 0.95
    run = real(LAG).simulate(experiment.profile, seed=1, step_s=40.0, name="next")
    after = asked(BASE, [one_ramp, run], "thermal_lag", "ageing")
    assert [cause.name for cause in after.causes] == ["thermal_lag"]
    assert after.causes[0].probability > 0.9


def test_it_is_told_where_no_programme_parts_the_sets() -> None:
    """In this plant the block's rate and its gradient to the shell are one column."""
    run = real(RATE).simulate("start 20, hold 30, ramp 50 1, hold 60, ramp 20 1, hold 30", step_s=40.0)
    found = asked(BASE, [run], "temperature_rate", "thermal_gradient")
    assert found.verdict == "ambiguous"
    assert found.next_experiment is None
    (told,) = [one for one in found.remarks if one.code == "diagnosis.no_programme_parts"]
    assert told.data["separation"] < 3.0


def test_programmes_are_on_the_scale_of_the_runs(found: Diagnosis, monkeypatch: pytest.MonkeyPatch) -> None:
    """Runs of seconds had programmes of hours, of a hundred thousand windows."""
    fits = fits_of(found, "thermal_lag", "ageing")
    monkeypatch.setattr(design, "LONGEST", 1e-3)
    assert next_experiment(found.posterior, fits, [fit.state for fit in fits], None) == (None, None)


TABLE = Simulator.from_mapping({"kind": "turntable", "mechanisms": ["scale_factor"]})
LEAN = {"misalignment": {"cosine_arcsec": 0.3, "sine_arcsec": 0.2}}


def on_table(programme: str, seed: int = 1) -> Recording:
    mechanisms = ["scale_factor", LEAN]
    noise = {"angle_random_walk_deg_sqrt_h": 0.0005}
    simulator = Simulator.from_mapping({"kind": "turntable", "mechanisms": mechanisms, "noise": noise})
    return simulator.simulate(programme, seed=seed, step_s=0.5, name=f"run{seed}")


def test_a_table_is_told_to_turn_at_other_rates() -> None:
    """At one rate a sensitivity that leans with the angle and the Earth's rate across it are one sine."""
    run = on_table("rate 10 900").between(5.0, 880.0)
    names = ["misalignment", "earth_rate_leak"]
    found = asked(TABLE, [run], *names)
    assert found.verdict == "ambiguous"
    assert found.next_experiment is not None
    assert set(found.next_experiment.separates) == set(names)
    assert found.next_experiment.expected_probability_after > 0.95
    programme = TableProgramme.parse(found.next_experiment.profile)
    assert np.abs(programme.corners[1]).max() <= 10.0
    after = asked(TABLE, [run, on_table(found.next_experiment.profile, 2)], *names)
    assert [cause.name for cause in after.causes] == ["misalignment"]
    assert after.causes[0].probability > 0.9


def test_table_programmes_turn_no_faster_than_recorded() -> None:
    run = on_table("rate 20 200, rate -20 200, rest 100")
    programmes = table_programmes([run])
    assert len(programmes) >= 6
    assert all(np.abs(one.corners[1]).max() <= 20.0 * 1.05 for one in programmes)
    assert not table_programmes([on_table("rest 300")])


def test_what_a_table_does_not_tell_is_not_foreseen() -> None:
    run = on_table("rate 20 200, rate -20 200, rest 100")
    with pytest.raises(InputError, match="what magnetic_field_uT reads in another run is not known"):
        RateTable.of([run], ["magnetic_field_uT", "table_rate"])
    foreseen = RateTable.of([run], ["table_rate"]).run_of(TableProgramme.parse("rate 5 100"))
    assert set(foreseen.columns) == {"time_s", "gyro_deg_h", "table_angle_deg", "table_rate_deg_s", "temperature_block_degC"}
