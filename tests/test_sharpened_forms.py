"""Static nonlinearities, and the set that predicts with its forms at their finest."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pandas as pd
import pytest

from rlgcomp.diagnosis.answer.fit import Fit
from rlgcomp.diagnosis.data import Data, Grid, Run
from rlgcomp.diagnosis.evidence.bank import Bank
from rlgcomp.diagnosis.forms.bases import Basis, Own, Power, Smooth
from rlgcomp.diagnosis.forms.drivers import Driver, Path
from rlgcomp.diagnosis.forms.memories import Relays
from rlgcomp.diagnosis.forms.nonlinearities import Hinge, Saturation, SignedPower
from rlgcomp.diagnosis.forms.relaxations import Distributed, Lag
from rlgcomp.diagnosis.noise.model import Noise
from rlgcomp.diagnosis.regions.baseline import Baseline
from rlgcomp.diagnosis.regions.chamber import named
from rlgcomp.diagnosis.regions.setting import Setting
from rlgcomp.diagnosis.search.process import Process
from rlgcomp.diagnosis.search.sharpening import Sharpening
from rlgcomp.diagnosis.search.states import State
from rlgcomp.physics import CATALOGUE
from rlgcomp.physics.mechanism import Mechanism, amplitude
from rlgcomp.recording import Recording
from rlgcomp.simulation.simulator import Simulator

VOLTS = Path(Driver(("supply_voltage_V",), centre=15.0, half=0.1))
WHITE = 0.01


def recording(seed: int, half_V: float = 0.1) -> Recording:
    """A supply that wanders, and a temperature; the gyro saturates with the supply."""
    rng, n = np.random.default_rng(seed), 4000
    volts = 15.0 + half_V * np.sin(np.cumsum(rng.normal(0.0, 0.02, n)))
    gyro = np.tanh((volts - 15.02) / 0.04) + WHITE * np.sqrt(10.0) * rng.standard_normal(n)
    celsius = 20.0 + 30.0 * np.sin(np.arange(n) / 700.0 + seed)
    table = {"time_s": 10.0 * np.arange(n), "gyro_deg_h": gyro, "temperature_block_degC": celsius, "supply_voltage_V": volts}
    return Recording(pd.DataFrame(table), name=f"run{seed}")


@pytest.mark.parametrize(
    "basis",
    [
        Saturation(VOLTS, 0.4, 0.2),
        Saturation(VOLTS, 0.4, even=True, fixed=True),
        Hinge(VOLTS, 0.3, 1),
        SignedPower(VOLTS, 0.6, False),
    ],
)
def test_moves_of_a_nonlinearity_differ_from_it_and_stay_within_limits(basis: Any) -> None:
    for _ in range(30):
        moves = basis.nearby(0.5)
        assert moves
        assert all(moved != basis for moved in moves)
        basis = moves[0]
    assert not basis.of_mechanism


def test_polynomials_go_on_straight_beyond_the_range() -> None:
    u = np.array([-3.0, -1.3, 0.4, 1.3, 2.3])
    run: Any = type("Stub", (), {"cache": {VOLTS: u}, "bins": 5})()
    assert Power(VOLTS).columns(run)[:, 0] == pytest.approx(u)
    square = Power(VOLTS, 2).columns(run)[:, 1]
    assert square[1:4] == pytest.approx(0.5 * (1.5 * u[1:4] ** 2 - 0.5))
    assert square[4] - square[3] == pytest.approx(0.5 * 3.0 * 1.3)
    assert square[0] - square[1] == pytest.approx(1.7 * 0.5 * 3.0 * 1.3)


def test_a_smooth_function_goes_on_as_far_as_it_is_correlated() -> None:
    u = np.linspace(-4.0, 4.0, 801)
    run: Any = type("Stub", (), {"cache": {VOLTS: u}, "bins": len(u)})()
    for width, reach in ((0.2, 1.3), (0.5, 1.5), (2.0, 3.0)):
        basis = Smooth(VOLTS, width)
        columns = basis.columns(run)
        assert basis.reach == pytest.approx(reach)
        beyond = np.abs(u) > reach + 1e-9
        assert np.ptp(columns[beyond & (u > 0)], axis=0) == pytest.approx(np.zeros(columns.shape[1]))
        assert np.ptp(columns[(u > 1.2) & (u < reach)], axis=0).max() > 1e-3


def test_nonlinearities_are_their_equations() -> None:
    run: Any = type("Stub", (), {"cache": {VOLTS: np.array([-1.0, -0.2, 0.0, 0.3, 1.6])}, "bins": 5})()
    u = run.cache[VOLTS]
    assert Saturation(VOLTS, 0.5, 0.1).columns(run)[:, 0] == pytest.approx(np.tanh((u - 0.1) / 0.5))
    assert Saturation(VOLTS, 0.5, even=True).columns(run)[:, 0] == pytest.approx(np.tanh(np.abs(u) / 0.5))
    assert Hinge(VOLTS, 0.1, -1).columns(run)[:, 0] == pytest.approx([1.1, 0.3, 0.1, 0.0, 0.0])
    assert SignedPower(VOLTS, 2.0, False).columns(run)[:, 0] == pytest.approx(u * np.abs(u))
    assert SignedPower(VOLTS, 0.5, True).columns(run)[:, 0] == pytest.approx(np.sqrt(np.abs(u)))


def test_a_mechanism_of_one_driver_is_its_own_basis_unless_that_is_a_line_over_the_driver() -> None:
    @dataclasses.dataclass(frozen=True)
    class Supply(Mechanism):
        name = "supply_voltage"
        kind = "chamber"
        equation = "b = k * (supply_voltage_V - 15)^power"
        reference = "A note of this laboratory."
        drivers = ("supply_voltage_V",)
        k_deg_h_V: float = amplitude(0.1, "deg/h/V")
        power = 1.0

        def basis(self, recording: Recording) -> Any:
            (volts,) = self.read(recording)
            return ((volts - 15.0) ** self.power)[:, None]

    class Square(Supply):
        power = 2.0

    runs = [recording(1)]
    data = Data(tuple(Run.of(run, Grid.of(runs), lambda binned: binned.rate_deg_h()) for run in runs))
    setting = Setting(data, Driver.of(data, "temperature_block_degC"))
    for mechanism, own in ((Supply, False), (Square, True)):
        region = next(named(setting, {"supply_voltage": mechanism}, ()))
        assert isinstance(region.forms[0].lead[0], Own) == own


@pytest.fixture(scope="module")
def saturating() -> tuple[Sharpening, Bank]:
    """The region of the supply beside runs whose gyro saturates with it."""
    runs = [recording(1), recording(2)]
    grid = Grid.of(runs)
    data = Data(tuple(Run.of(run, grid, lambda binned: binned.rate_deg_h()) for run in runs))
    simulator = Simulator.from_mapping({"kind": "chamber", "mechanisms": ["thermal_polynomial"]})
    baseline = Baseline(simulator).linearised(data)
    bank = Bank(data, baseline.design(data), baseline)
    setting = Setting(data, Driver.of(data, "temperature_block_degC"))
    return Sharpening(bank, list(named(setting, {"supply_voltage": CATALOGUE["supply_voltage"]}, ()))), bank


def test_the_set_that_predicts_has_the_equation_alone_where_that_is_all_there_is(saturating: tuple[Sharpening, Bank]) -> None:
    states, bank = saturating
    region = states.regions["supply_voltage"]
    given = states.evidence(Noise()).given(())
    smooth = [form for form in region.forms if isinstance(form.lead[-1], Smooth)]
    found = states.likeliest(given, smooth)
    assert found is not None
    rough = State((found[1],), Noise(), 0.0)
    fine = states.sharpened(rough)
    (member,) = fine.members
    assert isinstance(member.form.lead[0], Saturation)
    assert not member.form.departures
    half, centre = member.form.lead[0].path.driver.half, member.form.lead[0].path.driver.centre
    assert member.form.lead[0].width * half == pytest.approx(0.04, rel=0.05)
    assert centre + member.form.lead[0].centre * half == pytest.approx(15.02, abs=0.002)
    further = recording(7, half_V=0.16)  # beyond the training runs
    errors = []
    for state in (rough, fine):
        assert bank.baseline is not None
        predicted = Fit(bank.data, bank.baseline, bank, state).rate_deg_h(further, bank.data.runs[0].grid)
        wanted = np.tanh((further.column("supply_voltage_V") - 15.02) / 0.04)
        errors.append(float(np.std(predicted - wanted)))
    assert errors[1] < 0.5 * errors[0]


def test_a_form_that_is_fine_already_is_left_as_it_is(saturating: tuple[Sharpening, Bank]) -> None:
    states, _ = saturating
    region = states.regions["supply_voltage"]
    given = states.evidence(Noise()).given(())
    found = states.likeliest(given, region.forms)
    assert found is not None
    once = states.sharpened(State((found[1],), Noise(), 0.0))
    twice = states.sharpened(once)
    one, other = (states.converged(state.members, state.noise).log_point for state in (once, twice))
    assert one - 0.3 <= other < one + 1.0


def test_a_distribution_of_lags_has_one_sign_and_narrows_to_one_lag() -> None:
    rng, driver = np.random.default_rng(3), Driver(("a",))
    values = np.cumsum(rng.normal(0.0, 0.05, 400))
    grid: Any = type("Grid", (), {"bin_s": 10.0})()
    run: Any = type("Stub", (), {"grid": grid, "cache": {}, "column": lambda self, _: values})()
    one = Lag(driver, 300.0, 1.4).columns(run)
    assert Distributed(driver, 300.0, 0.05, 1.4).columns(run) == pytest.approx(one, abs=0.01 * np.std(one))
    times, weights = Distributed(driver, 300.0, 0.8, 1.4).mixture()
    assert np.all(weights > 0.0)
    assert float(weights.sum()) == pytest.approx(1.0)
    assert float(np.log(times) @ weights[:, 0]) == pytest.approx(np.log(300.0))
    assert float((np.log(times) - np.log(300.0)) ** 2 @ weights[:, 0]) == pytest.approx(0.8**2)


def test_each_threshold_of_a_relay_moves_by_itself() -> None:
    relay = Relays(Driver(("a",)), (0.3,), (0.1,), widest=0.25)
    moved = {(round(one.up[0] - 0.3, 6) != 0.0, round(one.down[0] - 0.1, 6) != 0.0) for one in relay.nearby(0.25)}
    assert moved == {(True, True), (True, False), (False, True)}
    assert all(one.up[0] - one.down[0] <= 0.25 for one in relay.nearby(0.25))


def test_a_further_run_is_between_the_states_that_training_runs_began_in() -> None:
    run: Any = type("Stub", (), {"name": "test", "cache": {}, "column": lambda self, _: np.array([0.2, 0.2, 0.5, 0.2])})()
    relay = Relays(Driver(("a",)), (0.3,), (0.1,), begins=(("run0", 0.2), ("run1", 0.2)))
    for one, first in ((relay, {0.0, 1.0}), (dataclasses.replace(relay, opposite=("run1",)), {0.5})):
        states = one.columns(run)[:, 0]
        assert states[0] in first
        assert states[3] == 1.0


def test_other_runs_are_predicted_with_the_mean_of_two_states(saturating: tuple[Sharpening, Bank]) -> None:
    _, bank = saturating
    assert bank.baseline is not None
    path = np.where(np.arange(len(bank.data)) % 4 == 0, 1.0, -1.0)
    seen = Process(3.0, 1.0, 1.0, path, 10.0, 0.0)
    plain, beside = (Fit(bank.data, bank.baseline, bank, State((), Noise(), 0.0, process=one)) for one in (None, seen))
    apart = [beside.predicted(run) - plain.predicted(run) for run in bank.data.runs]
    assert float(np.mean(np.concatenate(apart))) == pytest.approx(0.0, abs=0.05)


def test_bases_say_whether_their_weight_is_an_amplitude_of_the_mechanism() -> None:
    bases: list[Basis] = [Smooth(VOLTS), Saturation(VOLTS, 0.3)]
    assert [basis.of_mechanism for basis in bases] == [True, False]


def test_no_lag_is_polished_below_its_shortest() -> None:
    lag = Lag(Driver(("a",)), 300.0, 1.4, shortest_s=100.0)
    for _ in range(50):
        lag = min(lag.nearby(0.5), key=lambda moved: moved.time_constant_s)
    assert 100.0 <= lag.time_constant_s < 120.0
