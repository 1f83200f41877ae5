"""The user's own simulator: clocks that are found, causes that are not taken for clocks, functions that may do anything."""

from __future__ import annotations

import dataclasses
import math
import re
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st
from scipy import stats
from typer.testing import CliRunner

import rlgcomp as rlg
from rlgcomp.cli import register_commands
from rlgcomp.cli.base import app
from rlgcomp.diagnosis.data import Grid
from rlgcomp.diagnosis.simulators.align import clock_of, no_clocks
from rlgcomp.diagnosis.simulators.resampling import Alignment, on_rows, turning_evenly, values_at
from rlgcomp.diagnosis.simulators.user_simulator import (
    PythonSimulator,
    SimulatedRuns,
    scale_message,
)
from rlgcomp.numerics.filters import lag
from tests.few_monitors import few_monitors

register_commands()
CATALOGUE = rlg.CATALOGUE
BASE = rlg.Simulator(
    (CATALOGUE["thermal_polynomial"](), CATALOGUE["temperature_rate"]()), noise=rlg.NoiseModel(angle_random_walk_deg_sqrt_h=0.0003)
)
LACKING = BASE.with_mechanism(CATALOGUE["thermal_lag"]())
STRONG = rlg.Simulator((CATALOGUE["thermal_polynomial"](c1_deg_h_K=1e-3),), noise=BASE.noise)
GYRO_ALONE = ["time_s", "gyro_deg_h"]


@pytest.fixture(scope="module")
def run() -> rlg.Recording:
    return LACKING.simulate("short", seed=1, step_s=2.0, name="warm")


@pytest.fixture(scope="module")
def simulated(run: rlg.Recording) -> rlg.Recording:
    return BASE.predict(run).replace(name="simulated")


def moved(
    simulated: rlg.Recording, offset_s: float = 0.0, drift_ppm: float = 0.0, *, every: int = 1, epoch_s: float = 0.0
) -> rlg.Recording:
    """A simulation whose clock is late by an offset and runs slow by a drift."""
    table = simulated.table.iloc[::every]
    time_s = table["time_s"].to_numpy()
    return simulated.replace(table=table.assign(time_s=time_s - offset_s - 1e-6 * drift_ppm * time_s + epoch_s))


def align(recording: rlg.Recording, simulated: rlg.Recording, gyro: str | None = None) -> tuple[np.ndarray, Alignment]:
    """The simulation's gyro on the recording's rows, and how its clock stood."""
    found = clock_of(recording, simulated, gyro=gyro)
    return on_rows(recording, simulated, found, gyro=gyro).rate_deg_h, found


@pytest.mark.parametrize(
    ("offset_s", "drift_ppm", "every", "epoch_s"),
    [(0.0, 0.0, 1, 0.0), (31.7, 60.0, 1, 0.0), (-140.0, 0.0, 7, 0.0), (2.0, -80.0, 1, 1.7e9), (7.3, 0.0, 30, 0.0)],
)
def test_a_clock_is_found_and_taken_out(
    run: rlg.Recording, simulated: rlg.Recording, offset_s: float, drift_ppm: float, every: int, epoch_s: float
) -> None:
    rate, found = align(run, moved(simulated, offset_s, drift_ppm, every=every, epoch_s=epoch_s))
    # epochs apart: the starts are put together, which takes the offset out already
    assert found.offset_s == pytest.approx(0.0 if epoch_s else offset_s, abs=0.01 + 5.0 * found.offset_sd_s)
    assert found.drift_ppm == pytest.approx(drift_ppm, abs=1.0 + 5.0 * found.drift_ppm_sd)
    assert (found.p_value < 0.01) == (offset_s != 0.0)
    assert found.compared != "gyro_deg_h"
    expected = simulated.column("gyro_deg_h")
    assert np.sqrt(np.mean((rate - expected)[300:-300] ** 2)) < 2e-4 * (1 if every == 1 else every) * np.std(expected)


@pytest.mark.parametrize("gap_in", ["simulation", "recording"])
def test_a_gap_costs_no_more_than_what_it_lacks(run: rlg.Recording, simulated: rlg.Recording, gap_in: str) -> None:
    """One of 1000 s in a ramp, over which no straight line is the temperature."""

    def with_gap(recording: rlg.Recording) -> rlg.Recording:
        return recording.replace(table=recording.table.drop(index=range(1500, 2000)), truth=None)

    run, simulated = (one.replace(table=one.table[[*GYRO_ALONE, "temperature_block_degC"]], truth=None) for one in (run, simulated))
    late = moved(simulated, 30.0)
    _, whole = align(run, late)
    rate, found = align(*((run, with_gap(late)) if gap_in == "simulation" else (with_gap(run), late)))
    assert found.offset_s == pytest.approx(30.0, abs=0.01 + 4.0 * found.offset_sd_s)
    assert found.offset_sd_s < 1.3 * whole.offset_sd_s
    assert found.drift_ppm_sd < 1.3 * whole.drift_ppm_sd
    shown = np.isfinite(rate)
    assert len(run) - 503 <= shown.sum() <= len(run) - 498
    expected = simulated.column("gyro_deg_h")
    expected = expected if gap_in == "simulation" else np.delete(expected, np.s_[1500:2000])
    assert np.abs(rate - expected)[shown][50:-50].max() < 0.01 * np.std(expected)


def test_rows_without_a_simulation_are_left_out(run: rlg.Recording, simulated: rlg.Recording) -> None:
    runs = SimulatedRuns.of([run], [simulated.replace(table=simulated.table.drop(index=range(1500, 2000)), truth=None)])
    (told,) = runs.messages
    assert told.code == "diagnosis.rows_without_simulation"
    assert told.data == {"run": "warm", "not_simulated": 500, "turning_unevenly": 0}
    assert len(runs.runs[0]) == len(run) - 500
    assert np.isfinite(runs.predict_deg_h(runs.runs[0])).all()


def test_a_wrong_time_constant_is_no_clock() -> None:
    """The simulator's block follows its shell 10 % too slowly; its clock is right."""

    def followed(recording: rlg.Recording, time_constant_s: float) -> rlg.Recording:
        shell = recording.column("temperature_shell_degC")
        block = lag(shell, recording.time_s, time_constant_s)
        return recording.replace(table=recording.table[GYRO_ALONE].assign(temperature_block_degC=block), truth=None)

    runs = [BASE.simulate(programme, seed=k, step_s=5.0, name=programme) for k, programme in enumerate(("paper", "reversed"))]
    right, slow = ([followed(one, time_constant_s) for one in runs] for time_constant_s in (2400.0, 2640.0))
    found = SimulatedRuns.of(right, slow)
    assert not any(one.taken_out for one in found.alignment)
    assert all(one.p_value < 0.01 for one in found.alignment)
    assert [one.code for one in found.warnings] == ["diagnosis.no_clock"]
    late = SimulatedRuns.of(right, [moved(one, 30.0, 100.0) for one in right])
    assert not late.warnings
    assert [one.code for one in late.messages] == ["diagnosis.clock"] * 2
    assert all(one.taken_out and abs(one.offset_s - 30.0) < 0.1 for one in late.alignment)


def test_a_drift_that_no_clock_has_is_none() -> None:
    def drifting(drift_ppm: float, *, taken_out: bool = True) -> Alignment:
        return Alignment("run", 9.0, 0.1, drift_ppm, 10.0, 1e-6, "temperature_block_degC", taken_out=taken_out)

    assert no_clocks([]) is None
    assert no_clocks([drifting(300.0), drifting(-120.0)]) is None
    assert no_clocks([drifting(300.0), drifting(-700.0, taken_out=False)]) is None
    found = no_clocks([drifting(-700.0)])
    assert found is not None
    assert (found.code, found.data["drifts_ppm"]) == ("diagnosis.no_clock", {"run": -700.0})


def test_a_clock_is_reported_so_that_it_can_be_corrected(run: rlg.Recording, simulated: rlg.Recording) -> None:
    """The numbers of the message are added to the time stamps, and these are right."""
    late = moved(simulated, 30.0, 100.0)
    (told,) = SimulatedRuns.of([run], [late]).messages
    assert told.code == "diagnosis.clock"
    assert told.data["run"] == "warm"
    assert told.data["column"].startswith("temperature_")
    time_s = late.time_s
    corrected = time_s + told.data["offset_s"] + 1e-6 * told.data["drift_ppm"] * (time_s - time_s[0])
    assert corrected == pytest.approx(simulated.time_s, abs=0.1)


@pytest.mark.parametrize(
    ("scale", "ratio", "wrong"),
    [
        (1.0, None, None),
        (1.3, None, None),
        (0.0, None, None),
        (3600.0, 1.0 / 3600.0, (False, True)),
        (1.0 / 3600.0, 3600.0, (False, True)),
        (-1.0, -1.0, (True, False)),
        (-3600.0, -1.0 / 3600.0, (True, True)),
        (1e-300, None, None),  # as good as a constant
    ],
)
def test_a_wrong_unit_or_sign_is_asked_about(scale: float, ratio: float | None, wrong: tuple[bool, bool] | None) -> None:
    run = STRONG.simulate("short", seed=2, step_s=10.0)
    found = scale_message([run], [scale * STRONG.predict(run).rate_deg_h()])
    if ratio is None:
        assert found is None
    else:
        assert found is not None
        assert found.code == "diagnosis.simulation_scaled"
        assert found.data["ratio"] == pytest.approx(ratio, rel=0.1)
        assert (found.data["wrong_sign"], found.data["wrong_unit"]) == wrong


def test_a_strong_missing_effect_is_no_wrong_unit() -> None:
    run = BASE.with_mechanism(CATALOGUE["magnetic_field"](k_deg_h_uT=0.05)).simulate("short", seed=2, step_s=10.0)
    expected = BASE.predict(run).rate_deg_h()
    assert np.std(run.rate_deg_h() - expected) > 2.0 * np.std(expected)
    assert scale_message([run], [expected]) is None


def test_a_wrong_sign_comes_first_among_the_remarks() -> None:
    runs = [few_monitors(STRONG.simulate("short", seed=k, step_s=20.0, name=f"run{k}")) for k in range(2)]
    turned = PythonSimulator(lambda run: -STRONG.predict(run).rate_deg_h(), "my_sim.py:gyro")
    found = rlg.diagnose(turned, runs[:1], runs[1:], only=["supply_voltage"], window_s=200.0, black_box=False)
    assert found.remarks[0].code == "diagnosis.simulation_scaled"
    assert found.remarks[0].data["wrong_sign"]


def test_without_monitors_a_sharp_signal_tells_the_time() -> None:
    rng = np.random.default_rng(5)
    time_s = np.arange(0.0, 7200.0, 2.0)
    steps = np.repeat(rng.normal(size=90), 40)
    simulation = rlg.Recording(pd.DataFrame({"time_s": time_s - 12.0, "gyro_deg_h": steps}), name="sim")
    run = rlg.Recording(pd.DataFrame({"time_s": time_s, "gyro_deg_h": 1.02 * steps + 0.1 * rng.normal(size=len(steps))}))
    rate, found = align(run, simulation)
    assert not found.taken_out  # slow physics might do it
    told = time_s <= simulation.time_s[-1]  # what it does beyond its end it does not say
    assert rate[told] == pytest.approx(np.interp(time_s, simulation.time_s, steps)[told], abs=1e-12)
    assert np.isnan(rate[~told]).all()
    assert (~told).sum() == 6
    assert found.offset_s == pytest.approx(12.0, abs=5.0 * found.offset_sd_s)
    assert found.offset_sd_s < 0.5


def test_p_values_of_equal_clocks_are_uniform() -> None:
    """Two thermometers with noise of their own, sampled otherwise."""
    rng = np.random.default_rng(4)
    time_s = np.arange(0.0, 3000.0, 12.0)
    p_values, scaled = [], []
    for _ in range(60):
        temperature = 20.0 + 10.0 * np.sin(time_s / 400.0 + rng.uniform(0.0, 6.0))
        tables = [
            pd.DataFrame(
                {
                    "time_s": time_s,
                    "gyro_deg_h": rng.normal(size=len(time_s)),
                    "temperature_block_degC": temperature + 0.05 * rng.normal(size=len(time_s)),
                }
            )
            for _ in range(2)
        ]
        _, found = align(rlg.Recording(tables[0]), rlg.Recording(tables[1]))
        p_values.append(found.p_value)
        scaled.append(found.offset_s / found.offset_sd_s)
    assert stats.kstest(p_values, "uniform").pvalue > 1e-3
    assert np.std(scaled) == pytest.approx(1.0, abs=0.25)


def test_a_simulation_that_covers_too_little_is_refused(run: rlg.Recording, simulated: rlg.Recording) -> None:
    half = simulated.between(0.0, 0.5 * run.duration_s, name="half")
    with pytest.raises(rlg.InputError, match=r"half: it covers 50 % of warm"):
        align(run, half)


def test_what_led_up_to_the_rows_that_count_need_not_be_simulated(run: rlg.Recording, simulated: rlg.Recording) -> None:
    run, simulated = (one.replace(table=one.table.iloc[::5].reset_index(drop=True), truth=None) for one in (run, simulated))
    late = simulated.between(0.3 * run.duration_s, run.duration_s, name="late")
    with pytest.raises(rlg.InputError, match=r"late: it covers .* of warm"):
        align(run, late)
    cut = run.between(0.35 * run.duration_s, run.duration_s, keep_history=True)
    shown, _ = align(cut, late)
    whole, _ = align(cut, simulated)
    np.testing.assert_allclose(shown[cut.scored], whole[cut.scored], atol=0.01 * np.ptp(whole))
    own = simulated.between(0.35 * run.duration_s, run.duration_s, name="own")  # of the rows that count alone, from zero
    own = own.replace(table=own.table.assign(time_s=own.time_s - own.time_s[0]))
    shown, _ = align(cut, own)
    np.testing.assert_allclose(shown[cut.scored], whole[cut.scored], atol=0.01 * np.ptp(whole))


def test_one_simulation_a_run(run: rlg.Recording, simulated: rlg.Recording) -> None:
    with pytest.raises(rlg.InputError, match="1 simulated runs for 2 recordings"):
        SimulatedRuns.of([run, run], [simulated])
    runs = SimulatedRuns.of([run], [moved(simulated, 20.0)])
    assert runs.predict_deg_h(run) is runs.rates_deg_h[0]
    part = run.between(1000.0, 3000.0)
    assert runs.predict_deg_h(part) == pytest.approx(runs.rates_deg_h[0][500:1500], abs=1e-12)
    with pytest.raises(rlg.InputError, match="no simulation of it was given"):
        runs.predict_deg_h(run.replace(name="another"))


def test_simulations_in_another_order_than_the_runs_are_refused() -> None:
    unit = rlg.simulated_unit(3)
    runs = [unit.simulate(programme, seed=5, step_s=30.0, name=programme) for programme in ("paper", "reversed", "slow")]
    own = [unit.predict(run).replace(name=f"sim-{run.name}") for run in runs]
    alone = [one.replace(table=one.table[GYRO_ALONE]) for one in own]
    for right in (own, alone):
        assert len(SimulatedRuns.of(runs, right).runs) == 3
    with pytest.raises(rlg.InputError, match="sim-slow fits slow"):
        SimulatedRuns.of(runs, [alone[0], alone[2], alone[1]])


@pytest.fixture(scope="module")
def silent_pairs() -> tuple[list[rlg.Recording], list[rlg.Recording]]:
    """Runs, and what a simulator says of them whose gyro stands still."""
    unit = rlg.simulated_unit(3)
    programmes = ("paper", "reversed", "start 20, ramp 50 0.1")
    runs = [unit.simulate(programme, seed=5, step_s=30.0, name=programme) for programme in programmes]
    own = [unit.predict(run).replace(name=f"sim-{run.name}") for run in runs]
    return runs, [one.replace(table=one.table.assign(gyro_deg_h=0.01)) for one in own]


@pytest.mark.parametrize("order", [(1, 2, 0), (0, 0, 0), (0, 2, 1)])
def test_simulations_of_other_runs_are_refused_by_their_thermometers(
    silent_pairs: tuple[list[rlg.Recording], list[rlg.Recording]], order: tuple[int, ...]
) -> None:
    """Whatever the gyro does."""
    runs, silent = silent_pairs
    with pytest.raises(rlg.InputError, match=r"its temperature_block_degC goes another way .* in the order of the runs"):
        SimulatedRuns.of(runs, [silent[k] for k in order])


def test_simulations_of_other_runs_are_taken_where_a_thermometer_hardly_moves() -> None:
    unit = rlg.simulated_unit(3)
    rest = [unit.simulate("start 20, hold 90", seed=seed, step_s=30.0, name=f"rest-{seed}") for seed in (1, 2)]
    assert len(SimulatedRuns.of(rest, [unit.predict(run) for run in reversed(rest)]).runs) == 2


def test_units_and_axes_of_the_simulation(run: rlg.Recording, simulated: rlg.Recording) -> None:
    table = simulated.table.rename(columns={"gyro_deg_h": "gyro_x_deg_s"})
    table["gyro_x_deg_s"] /= 3600.0
    table.insert(2, "gyro_y_deg_h", 99.0)
    triad = run.replace(table=run.table.rename(columns={"gyro_deg_h": "gyro_x_deg_h"}))
    rate, _ = align(triad, simulated.replace(table=table), gyro="gyro_x_deg_h")
    assert rate == pytest.approx(simulated.column("gyro_deg_h"), abs=1e-9)


def test_polynomials_between_samples_have_the_same_bits_compiled_and_plain(monkeypatch: pytest.MonkeyPatch) -> None:
    """Beside a gap, at samples and beyond the ends as well."""
    rng = np.random.default_rng(0)
    time_s = np.r_[np.arange(0.0, 300.0, 5.0), np.arange(400.0, 470.0, 5.0), np.arange(600.0, 612.0, 5.0)]
    values = np.cumsum(rng.standard_normal(len(time_s)))
    at_s = np.r_[rng.uniform(-10.0, 620.0, 900), time_s]
    found = values_at(time_s, values, at_s)
    monkeypatch.setenv("RLGCOMP_NUMBA", "0")
    assert all(np.array_equal(one, other) for one, other in zip(found, values_at(time_s, values, at_s), strict=True))


# --- a Python function -----------------------------------------------------------------------------------------------------


def written(tmp_path: Path, code: str) -> str:
    (tmp_path / "my_sim.py").write_text("import numpy as np\nimport pandas as pd\n" + code)
    return f"{tmp_path / 'my_sim.py'}:gyro"


ANSWERS = {
    "array": "0.01 * r.column('temperature_block_degC')",
    "list": "list(0.01 * r.column('temperature_block_degC'))",
    "series": "pd.Series(0.01 * r.column('temperature_block_degC'))",
    "frame": "pd.DataFrame({'time_s': r.time_s, 'gyro_deg_h': 0.01 * r.column('temperature_block_degC')})",
    "deg_s": "pd.DataFrame({'gyro_deg_s': 0.01 / 3600 * r.column('temperature_block_degC')})",
    "recording": "r.replace(table=r.table.assign(gyro_deg_h=0.01 * r.column('temperature_block_degC')))",
}


@pytest.mark.parametrize("answer", ANSWERS.values(), ids=ANSWERS)
def test_a_function_may_answer_in_many_forms(run: rlg.Recording, tmp_path: Path, answer: str) -> None:
    simulator = PythonSimulator.load(written(tmp_path, f"def gyro(r):\n    return {answer}\n"))
    assert simulator.predict_deg_h(run) == pytest.approx(0.01 * run.column("temperature_block_degC"))


def test_a_coarser_answer_is_put_on_the_rows(run: rlg.Recording, tmp_path: Path) -> None:
    code = "def gyro(r):\n    return pd.DataFrame({'time_s': r.time_s[::5], 'gyro_deg_h': r.time_s[::5]})\n"
    rate = PythonSimulator.load(written(tmp_path, code)).predict_deg_h(run)
    assert rate[:-5] == pytest.approx(run.time_s[:-5])


def test_a_function_runs_once(run: rlg.Recording, tmp_path: Path) -> None:
    code = "calls = []\ndef gyro(r):\n    calls.append(1)\n    return 0.0 * r.time_s + len(calls)\n"
    simulator = PythonSimulator.load(written(tmp_path, code))
    assert set(simulator.predict_deg_h(run)) == {1.0}
    assert set(simulator.predict_deg_h(run)) == {1.0}


@pytest.mark.parametrize("asked", ["r.column('gyro_deg_h')", "r.rate_deg_h()"])
def test_a_function_sees_no_gyro(run: rlg.Recording, tmp_path: Path, asked: str) -> None:
    simulator = PythonSimulator.load(written(tmp_path, f"def gyro(r):\n    return {asked}\n"))
    with pytest.raises(rlg.InputError, match="of warm it sees all but the gyro"):
        simulator.predict_deg_h(run)
    assert set(rlg.Simulator().predict(run).rate_deg_h()) == {0.0}


@pytest.mark.parametrize(
    ("code", "message"),
    [
        ("def gyro(r):\n    return r.column('nowhere')\n", "failed on warm, line 4: InputError: warm has no column"),
        ("def gyro(r):\n    return 1 / 0\n", "failed on warm, line 4: ZeroDivisionError: division by zero"),
        ("def gyro(r):\n    return np.zeros(3)\n", r"returned shape \(3,\) for warm"),
        ("def gyro(r):\n    return np.full(len(r), np.nan)\n", "every value must be finite"),
        ("def gyro(r):\n    return None\n", "return one number a row"),
        ("def gyro(r):\n    return 'fast'\n", "return one number a row"),
        ("def gyro(r):\n    return pd.DataFrame({'a': r.time_s, 'b': r.time_s})\n", "return one gyro column"),
        ("def gyro(r):\n    return 1j * r.time_s\n", "return one number a row"),
        ("def gyro(r):\n    return pd.DataFrame({'time_s': r.time_s[:9][::-1], 'gyro': 0.0})\n", "does not increase"),
        ("def gyro(r):\n    return pd.DataFrame({'time_s': [0.0, np.nan, 9.0], 'gyro': 0.0})\n", "does not increase"),
        ("def gyro(r):\n    return pd.DataFrame({'time_s': r.time_s[:9], 'gyro': 0.0})\n", "return the whole run"),
        ("def other(r):\n    return 0\n", "has no function 'gyro'; it has other"),
        ("gyro = 3\n", "has no function 'gyro'; it has none"),
    ],
)
def test_what_goes_wrong_in_it_is_said(run: rlg.Recording, tmp_path: Path, code: str, message: str) -> None:
    with pytest.raises(rlg.InputError, match=message):
        PythonSimulator.load(written(tmp_path, code)).predict_deg_h(run)


NUMBERS = st.lists(st.floats(), min_size=2, max_size=2)
FRAMES = st.builds(pd.DataFrame, st.dictionaries(st.sampled_from(["time_s", "gyro_deg_h", "x"]), NUMBERS))
LISTS = st.lists(st.one_of(st.floats(), st.none(), st.text(max_size=2)), max_size=4)
ANYTHING = st.one_of(st.none(), st.text(max_size=5), st.floats(), LISTS, FRAMES)


@settings(max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)
@given(answer=ANYTHING)
@example(answer=pd.DataFrame({"time_s": [-1e308, 1e308], "gyro_deg_h": [0.0, 0.0]}))
@example(answer=pd.DataFrame({"time_s": [1.7e308, -1e292], "gyro_deg_h": [0.0, 0.0]}))
@example(answer=pd.DataFrame({"gyro_deg_s": [1e308, -1e308]}))
@example(answer=pd.DataFrame({"time_s": [0.0, 1e9], "gyro_deg_h": [1e308, -1e308]}))
def test_any_answer_is_taken_or_refused(run: rlg.Recording, answer: object) -> None:
    try:
        rate = PythonSimulator(lambda _: answer, "any.py:gyro").predict_deg_h(run)
    except rlg.InputError as error:
        assert "any.py:gyro" in str(error)  # noqa: PT017
    else:
        assert rate.shape == (len(run),)
        assert np.isfinite(rate).all()


@pytest.mark.parametrize(("offset_s", "lock_in_deg_s"), [(-20.0, 0.0), (-20.0, 0.02)])
def test_the_clock_of_a_turning_table_is_told_by_its_gyro(offset_s: float, lock_in_deg_s: float) -> None:
    """The simulation has other rows, on another clock, which drifts: rows in which the table speeds up are left out."""
    said = [{"scale_factor": {"k_ppm": 0.0, "bias_deg_h": 5.5}}]
    lock_in = [{"lock_in": {"lock_in_deg_s": lock_in_deg_s, "fraction": 1.0}}] if lock_in_deg_s else []
    noise = {"angle_random_walk_deg_sqrt_h": 0.003}
    gyro = rlg.Simulator.from_mapping({"kind": "turntable", "mechanisms": said + lock_in, "noise": noise})
    ideal = rlg.Simulator.from_mapping({"kind": "turntable", "mechanisms": said})
    runs = [gyro.simulate("rates", seed=seed, name=f"run{seed}") for seed in range(2)]
    finer = [ideal.predict(gyro.simulate("rates", seed=seed, step_s=0.5, name=f"sim{seed}")) for seed in range(2)]
    theirs = [
        run.replace(table=moved(run, offset_s, 20.0).table[["time_s", "gyro_deg_s"]], truth=None, name=run.name) for run in finer
    ]
    few = ["lock_in", "scale_factor_asymmetry", "encoder_delay"]
    window_s = 1.5 * Grid.of(runs).window_s
    found = rlg.diagnose(None, runs, simulated=theirs, only=few, window_s=window_s, black_box=False)
    assert [cause.name for cause in found.causes] == ["lock_in"] * bool(lock_in_deg_s)
    assert found.verdict == ("explained" if lock_in_deg_s else "none")
    for clock in found.alignment:
        assert clock.taken_out
        assert clock.drift_ppm == pytest.approx(20.0, abs=5.0 * clock.drift_ppm_sd)
        assert clock.offset_s == pytest.approx(offset_s, abs=0.5)  # a row's time is that of its end, and rows differ in length
    uneven = [one for one in found.remarks if one.code == "diagnosis.rows_without_simulation"]
    assert len(uneven) == 2
    assert all(one.data["turning_unevenly"] > 0 for one in uneven)


@pytest.mark.parametrize("offset_s", [0.3, -0.4])
def test_a_swing_on_another_clock_keeps_its_rows_and_its_period(offset_s: float) -> None:
    """A swing repeats, and one whole period off it looks alike; between its samples it is no straight line."""
    rng = np.random.default_rng(3)
    time_s = np.arange(1.0, 1801.0)

    def means(at_s: np.ndarray) -> np.ndarray:  # of 40 deg/s with a period of 90 s, over the second before
        angle = -40.0 * 90.0 / (2.0 * np.pi) * np.cos(2.0 * np.pi * np.array([at_s - 1.0, at_s]) / 90.0)
        return angle[1] - angle[0]

    noisy = 3600.0 * means(time_s) + 0.02 * rng.normal(size=len(time_s))
    run = rlg.Recording(
        pd.DataFrame({"time_s": time_s, "gyro_deg_h": noisy, "table_rate_deg_s": means(time_s)}),
        rlg.Metadata(kind="turntable"),
        name="swing",
    )
    simulated = rlg.Recording(pd.DataFrame({"time_s": time_s, "gyro_deg_h": 3600.0 * means(time_s + offset_s)}), name="sim")
    _, found = align(run, simulated)
    assert found.offset_s == pytest.approx(offset_s, abs=1e-3)
    found = dataclasses.replace(found, taken_out=True)
    shown = on_rows(run, simulated, found)
    even = turning_evenly(run, simulated, shown, found) & np.isfinite(shown.rate_deg_h)
    assert even.mean() > 0.98
    assert np.abs(shown.rate_deg_h - 3600.0 * means(time_s))[even].max() < 0.02


def test_rows_stay_where_nothing_is_known_of_the_clock() -> None:
    """Of a table at rest the gyro tells no time."""
    gyro = rlg.Simulator.from_mapping(
        {"kind": "turntable", "mechanisms": ["scale_factor"], "noise": {"angle_random_walk_deg_sqrt_h": 0.003}}
    )
    run = gyro.simulate("rates", seed=1, name="rest")
    still = run.table.assign(
        table_rate_deg_s=0.0, table_angle_deg=0.0, gyro_deg_s=run.column("gyro_deg_s") - run.column("table_rate_deg_s")
    )
    run = run.replace(table=still, truth=None)
    constant = run.replace(table=still.assign(gyro_deg_s=1e-3)[["time_s", "gyro_deg_s"]].iloc[::2], truth=None)
    _, found = align(run, constant)
    assert not math.isfinite(found.offset_sd_s)
    assert turning_evenly(run, constant, on_rows(run, constant, found), found).all()


def test_a_held_out_run_may_lack_the_thermometer_that_training_runs_have() -> None:
    runs = [few_monitors(LACKING.simulate("short", seed=seed, step_s=10.0, name=f"run{seed}")) for seed in (1, 2, 3)]
    simulations = [BASE.predict(run).replace(name=f"sim{k}") for k, run in enumerate(runs)]
    assert "temperature_shell_degC" in runs[2]
    runs[2] = runs[2].replace(table=runs[2].table.drop(columns="temperature_block_degC"))
    few = {name: CATALOGUE[name] for name in ("thermal_lag", "supply_voltage")}
    options = {"mechanisms": few, "window_s": 360.0, "black_box": False}
    diagnosis = rlg.diagnose(None, runs[:2], runs[2:], simulated=simulations, **options)
    assert diagnosis.test is None
    (told,) = [one for one in diagnosis.remarks if one.code == "diagnosis.run_lacks_column"]
    assert told.data == {"run": "run3", "columns": ["temperature_block_degC"]}
    assert diagnosis.p_value < 0.01


def test_an_output_is_never_said_to_be_in_units_of_a_gyro(run: rlg.Recording, tmp_path: Path) -> None:
    """A column that is not there is named as it was asked for, and a wrong answer is not asked for in deg/h."""
    frame = run.table.rename(columns={run.gyro_columns[0]: "force_kN"})
    frame.to_parquet(tmp_path / "run.parquet")
    simulator = written(tmp_path, "def gyro(r):\n    return np.zeros(3)\n")
    for output, message in (("force_N", r"no column 'force_N' for --output"), ("force_kN", r"in the unit of force_kN")):
        shown = CliRunner().invoke(
            app, ["diagnose", "--simulator", simulator, "--output", output, "--train", str(tmp_path / "run.parquet"), "--out",
                  str(tmp_path / "dd")],
        )  # fmt: skip
        said = " ".join(f"{shown.output} {shown.exception}".split())
        assert re.search(message, said), said
        assert "deg/h" not in said


@pytest.mark.parametrize("output", [None, "force_N"])
def test_a_simulator_that_gives_the_recording_is_refused(output: str | None) -> None:
    """Of another quantity it was a division by zero."""
    time_s = np.arange(0.0, 4000.0, 10.0)
    table = pd.DataFrame({"time_s": time_s, "gyro_deg_h": np.sin(time_s / 300.0), "level_V": np.cos(time_s / 500.0)})
    run = rlg.Recording(table.assign(force_N=table["gyro_deg_h"]), name="warm")
    with pytest.raises(rlg.InputError, match="the residual of warm is exactly zero"):
        rlg.diagnose(lambda run: np.sin(run.time_s / 300.0), train=[run], output=output, black_box=False)
