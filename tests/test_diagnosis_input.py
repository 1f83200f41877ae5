"""What a diagnosis refuses before it computes: averaging, gyros and mechanisms that no physics can be read from."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

import rlgcomp as rlg
from rlgcomp.physics import CATALOGUE
from rlgcomp.physics.user import require_computable, user_catalogue
from rlgcomp.recording.argument_checks import require_held_out, told_apart
from tests.few_monitors import FEWER, few_monitors
from tests.two_hour_runs import BASELINE, runs_of

NOISE = rlg.NoiseModel(angle_random_walk_deg_sqrt_h=0.0003)
OWN = """
import dataclasses
import numpy as np
from rlgcomp.physics.mechanism import Mechanism, amplitude, shape

@dataclasses.dataclass(frozen=True)
class Own(Mechanism):
    name = "own"
    kind = "chamber"
    equation = "b = k_deg_h * f(T)"
    reference = "A note of this laboratory."
    drivers = ("temperature",)
    k_deg_h: float = amplitude(1e-3, "deg/h")
    tau_s: float = shape(10.0, "s", 0.0, 100.0)

    def basis(self, recording):
        (temperature,) = self.read(recording)
        return BASIS
"""


@pytest.fixture(scope="module")
def run() -> rlg.Recording:
    """Down to -20 degC, where the trial recording of a mechanism does not go."""
    return rlg.simulated_unit(1).simulate("short", seed=1, step_s=5.0, name="cold")


@pytest.fixture(scope="module")
def quiet() -> rlg.Recording:
    """Noise alone, in which a diagnosis has little to search."""
    return few_monitors(rlg.Simulator(noise=NOISE).simulate("short", seed=1, step_s=60.0, name="quiet"))


@pytest.mark.parametrize(
    ("basis", "message"),
    [
        ("np.sqrt(temperature)[:, None]", "own cannot be tried: basis is not finite on cold, .*first at row"),
        ("np.exp(1e-5 * temperature * recording.time_s**2)[:, None]", "not finite on cold, or beyond 1e"),
        ("(temperature if temperature.min() > 0.0 else 1 / 0)[:, None]", "fails on cold, line 18: ZeroDivisionError"),
        ("__import__('sys').exit(3) if temperature.min() < 0.0 else temperature[:, None]", "fails on cold, line 18: SystemExit: 3"),
        ("temperature[:64, None]", r"returns \(64, 1\) for 2520 rows"),
        ("(temperature / self.tau_s)[:, None]", "own cannot be tried with tau_s = 0: basis is not finite"),
    ],
)
def test_a_mechanism_that_fails_on_the_runs(run: rlg.Recording, tmp_path: Path, basis: str, message: str) -> None:
    (tmp_path / "own.py").write_text(OWN.replace("BASIS", basis))
    catalogue = user_catalogue([tmp_path / "own.py"])
    with pytest.raises(rlg.InputError, match=message):
        rlg.diagnose(rlg.Simulator(), [run], mechanisms=catalogue)


BY_ROWS = "signal.lfilter([0.01], [1.0, -0.99], temperature - temperature[0])[:, None]"


def test_a_lag_in_rows_instead_of_seconds_is_refused_unless_it_is_computed_from_rows(run: rlg.Recording, tmp_path: Path) -> None:
    """It is called with means over rows as well, on which its time constant would be four times as long."""
    by_rows = OWN.replace("import numpy as np", "import numpy as np\nfrom scipy import signal").replace("BASIS", BY_ROWS)
    (tmp_path / "rows.py").write_text(by_rows)
    with pytest.raises(rlg.InputError, match=r"own cannot be tried: it says something else of means over 4 rows.*recording.time_s"):
        require_computable(user_catalogue([tmp_path / "rows.py"]), [run])
    (tmp_path / "fast.py").write_text(by_rows.replace('name = "own"', 'name = "own"\n    fast = True'))
    require_computable(user_catalogue([tmp_path / "fast.py"]), [run])
    in_seconds = by_rows.replace("0.99", "np.exp(-0.002 * recording.period_s)").replace("[0.01]", "[0.002 * recording.period_s]")
    (tmp_path / "seconds.py").write_text(in_seconds)
    require_computable(user_catalogue([tmp_path / "seconds.py"]), [run])


@pytest.mark.parametrize("name", [name for name, form in CATALOGUE.items() if form.kind == "chamber" and not form.fast])
def test_what_reckons_in_seconds_is_not_refused(run: rlg.Recording, name: str) -> None:
    own = type(CATALOGUE[name].__name__, (CATALOGUE[name],), {})
    require_computable({name: own}, [run])
    if not own().amplitude_parameters():
        return  # it has no columns
    by_rows = type("ByRows", (own,), {"basis": lambda self, recording: own.basis(self, recording) * len(recording)})
    with pytest.raises(rlg.InputError, match=f"{name} cannot be tried"):  # it was tried, and would have been told
        require_computable({name: by_rows}, [run])


def own_and_few(path: Path) -> dict[str, type[rlg.Mechanism]]:
    """The user's mechanism and two of the catalogue."""
    return {name: user_catalogue([path])[name] for name in ("own", "thermal_lag", "supply_voltage")}


def test_a_mechanism_whose_column_is_not_recorded_is_passed_over(run: rlg.Recording, quiet: rlg.Recording, tmp_path: Path) -> None:
    (tmp_path / "own.py").write_text(
        OWN.replace('("temperature",)', '("vibration_m_s2",)').replace("BASIS", "temperature[:, None]")
    )
    catalogue = own_and_few(tmp_path / "own.py")
    require_computable(catalogue, [run])
    found = rlg.diagnose(rlg.Simulator(), [quiet], mechanisms=catalogue, black_box=False)
    (told,) = [remark for remark in found.remarks if remark.code == "diagnosis.not_tried"]
    assert told.data == {"mechanisms": ["own"]}


def test_a_mechanism_whose_place_the_simulator_takes_is_said_not_to_be_tried(quiet: rlg.Recording, tmp_path: Path) -> None:
    (tmp_path / "own.py").write_text(OWN.replace("BASIS", "np.ones((len(temperature), 1))"))
    found = rlg.diagnose(rlg.Simulator(), [quiet], mechanisms=own_and_few(tmp_path / "own.py"), black_box=False)
    (told,) = [remark for remark in found.remarks if remark.code == "diagnosis.absorbed"]
    assert told.data == {"mechanisms": ["own"]}


def test_complex_columns_are_no_mechanism(tmp_path: Path) -> None:
    (tmp_path / "own.py").write_text(OWN.replace("BASIS", "1j * temperature[:, None]"))
    with pytest.raises(rlg.InputError, match="returns complex128 values; it must return real numbers"):
        user_catalogue([tmp_path / "own.py"])


def wild(run: rlg.Recording, factor: float) -> rlg.Recording:
    """The run with so much added for an hour: longer than any knock, which would be left out."""
    hour = (run.time_s >= 100.0) & (run.time_s < 3700.0)
    return run.replace(table=run.table.assign(gyro_deg_h=run.column("gyro_deg_h") + factor * hour))


@pytest.mark.parametrize(
    ("factor", "options", "message"),
    [
        (0.0, {"window_s": 1.0}, "cold: cannot average over 1 s: one sample takes 5 s"),
        (0.0, {"window_s": 1e4}, "cold: 12600 s fill 1 windows"),
        (1e9, {}, r"cold: at row \d+ the gyro is 1e\+09 deg/h off .*mend the unit"),
    ],
)
def test_runs_that_cannot_be_diagnosed(run: rlg.Recording, factor: float, options: dict[str, Any], message: str) -> None:
    with pytest.raises(rlg.InputError, match=message):
        rlg.diagnose(rlg.Simulator(), [wild(run, factor)], **options)


def test_a_simulator_far_off_is_refused(run: rlg.Recording) -> None:
    class Huge:
        def predict_deg_h(self, recording: rlg.Recording) -> np.ndarray:
            return np.full(len(recording), 1e300)

    with pytest.raises(rlg.InputError, match=r"the gyro is -1e\+300 deg/h off what the simulator says"):
        rlg.diagnose(Huge(), [run])


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"gyro_deg_s": -1.0}, "reads -1 times the rate of its table (table_rate_deg_s)"),
        ({"gyro_deg_s": -1.0}, "its sense is reversed: say --map gyro_deg_s='gyro_deg_s [-deg/s]'"),
        ({"table_rate_deg_s": np.pi / 180.0}, "say --map table_rate_deg_s='table_rate_deg_s [rad/s]'"),
    ],
)
def test_a_gyro_that_does_not_turn_with_its_table_is_refused(changed: dict[str, float], said: str) -> None:
    """A scale factor of minus one would be fitted, and nothing would seem to be missing."""
    simulator = rlg.Simulator.from_mapping({"kind": "turntable", "mechanisms": ["scale_factor"]})
    made = simulator.simulate("rates", seed=1, step_s=5.0)
    table = made.table.assign(**{column: factor * made.column(column) for column, factor in changed.items()})
    with pytest.raises(rlg.InputError, match=re.escape(said)):
        rlg.diagnose(simulator, [made.replace(table=table, truth=None)])


@pytest.mark.parametrize("fast_deg_s", [40.0, 60.0])
def test_an_angle_that_turns_too_far_between_rows_is_said_to(tmp_path: Path, fast_deg_s: float) -> None:
    """40 deg/s every 5 s are 200 deg, or 160 deg backwards; the angle that runs on, and a rate, tell which."""
    simulator = rlg.Simulator.from_mapping({"kind": "turntable", "mechanisms": ["scale_factor"]})
    made = simulator.simulate(f"rate 10 900, rate {fast_deg_s} 900, rate -10 900", seed=1, step_s=5.0, name="fast")
    wrapped = made.table.drop(columns="table_rate_deg_s")
    wrapped.to_parquet(tmp_path / "fast.parquet")
    read = rlg.read(tmp_path / "fast.parquet", metadata={"kind": "turntable"})
    said = rf"fast: by gyro_deg_s the table turns up to {5.0 * fast_deg_s:.0f}[.\d]* deg from row to row, more than half a turn"
    with pytest.raises(rlg.InputError, match=said):
        rlg.diagnose(simulator, [read])
    running = wrapped.assign(table_angle_deg=np.cumsum(made.column("table_rate_deg_s") * 5.0))
    running.to_parquet(tmp_path / "fast.parquet")
    for table in (rlg.read(tmp_path / "fast.parquet", metadata={"kind": "turntable"}).table, made.table):
        assert rlg.diagnose(simulator, [made.replace(table=table, truth=None)]).verdict == "none"


def test_a_reversed_sense_is_mapped(tmp_path: Path) -> None:
    made = rlg.Simulator(kind="turntable").simulate("rates", seed=1, step_s=5.0)
    path = tmp_path / "turned.csv"
    made.table.assign(gyro_deg_s=-made.column("gyro_deg_s")).to_csv(path, index=False)
    found = rlg.read(path, columns={"gyro_deg_s": "gyro_deg_s [-deg/s]"}, metadata={"kind": "turntable"})
    np.testing.assert_allclose(found.column("gyro_deg_s"), made.column("gyro_deg_s"), rtol=1e-12)


def test_a_recording_that_is_its_own_simulation(run: rlg.Recording) -> None:
    with pytest.raises(rlg.InputError, match="the residual of cold is exactly zero"):
        rlg.diagnose(train=[run], simulated=[run])


def test_a_held_out_run_without_the_column_of_a_cause_takes_no_part_in_the_proof() -> None:
    simulator = rlg.Simulator((CATALOGUE["thermal_polynomial"](),), noise=NOISE)

    def driven(seed: int) -> rlg.Recording:
        made = few_monitors(simulator.simulate("short", seed=seed, step_s=30.0, name=f"run{seed}"))
        field = 45.0 + 3.0 * np.sin(made.time_s / 900.0 + seed)
        gyro = made.column("gyro_deg_h") + 0.01 * (field - 45.0)
        return made.replace(table=made.table.assign(magnetic_field_uT=field, gyro_deg_h=gyro), truth=None)

    few = {name: CATALOGUE[name] for name in ("magnetic_field", "supply_voltage")}
    options = {"window_s": 240.0, "black_box": False}
    train, (seen, blind) = [driven(1), driven(2)], [driven(3), driven(4)]
    blind = blind.replace(table=blind.table.drop(columns="magnetic_field_uT"))
    found = rlg.diagnose(simulator, train, [seen, blind], mechanisms=few, **options)
    assert [cause.name for cause in found.causes] == ["magnetic_field"]
    (told,) = [one for one in found.remarks if one.code == "diagnosis.run_lacks_column"]
    assert told.data == {"run": "run4", "columns": ["magnetic_field_uT"]}
    assert found.test is not None
    assert [fit.run for fit in found.test.per_run] == ["run3"]
    alone = {"magnetic_field": few["magnetic_field"]}
    assert rlg.diagnose(simulator, train, [blind], mechanisms=alone, **options).test is None


def test_a_run_given_twice_is_refused_by_the_library(run: rlg.Recording) -> None:
    with pytest.raises(rlg.InputError, match="is given both to train and to test, at least in part; give another run"):
        rlg.diagnose(rlg.Simulator(), [run], [run])
    with pytest.raises(rlg.InputError, match="is given twice to train"):
        rlg.diagnose(rlg.Simulator(), [run, run.replace(name="other")])
    with pytest.raises(rlg.InputError, match="is given both to train and to confirm"):
        rlg.diagnose(rlg.Simulator(), [run], confirm=[run])
    with pytest.raises(rlg.InputError, match="magnetic_field is all that is tried and is left out as well"):
        rlg.diagnose(rlg.Simulator(), [run], only=["magnetic_field"], without=["magnetic_field"])


@pytest.mark.parametrize("step_s", [0.1, 1.0])
def test_runs_of_one_programme_on_a_turntable_are_two(step_s: float) -> None:
    """The table's rate, the same in both, is 1e5 times their noise."""
    simulator = rlg.Simulator.from_mapping({"kind": "turntable", "noise": {"angle_random_walk_deg_sqrt_h": 5e-4}})
    one, other = (simulator.simulate("rates", seed=seed, step_s=step_s, name=f"run{seed}") for seed in (1, 2))
    require_held_out([one, other], [])
    require_held_out([one], [other])
    with pytest.raises(rlg.InputError, match="run1 is given both to train and to test"):
        require_held_out([other, one], [one.between(100.0, 900.0)])


def test_parts_that_share_a_few_rows_are_two(run: rlg.Recording) -> None:
    middle = float(run.time_s[len(run) // 2])
    first, last = run.between(0.0, middle + 5.0 * run.period_s), run.between(middle, float(run.time_s[-1]))
    require_held_out([first], [last])
    with pytest.raises(rlg.InputError, match="is given both to train and to test"):
        require_held_out([first], [run.between(0.5 * middle, float(run.time_s[-1]))])


def test_a_held_out_run_is_sampled_at_half_the_rate_or_refused_where_no_window_is_full() -> None:
    simulator = rlg.Simulator((CATALOGUE["thermal_polynomial"](),), noise=NOISE)
    run, slower, slowest = (
        few_monitors(simulator.simulate("short", seed=seed, step_s=step_s, name=name))
        for seed, step_s, name in ((1, 5.0, "cold"), (2, 10.0, "slower"), (3, 120.0, "slowest"))
    )
    found = rlg.diagnose(simulator, [run], test=[slower], only=["warm_up"], black_box=False)
    assert found.test is not None
    assert found.test.improvement == pytest.approx(0.0, abs=0.05)
    assert found.test.baseline_rms == pytest.approx(found.train.baseline_rms, rel=0.15)  # of means over the same time
    with pytest.raises(rlg.InputError, match=r"slowest: no window of .* s is full: its samples are 120 s apart"):
        rlg.diagnose(simulator, [run], test=[slowest], only=["warm_up"])


def test_recordings_without_names_are_told_apart() -> None:
    """Each has the same name by default; a bias of one of them is that of one of them."""
    first, second = runs_of(
        rlg.Simulator.from_mapping(BASELINE.to_mapping() | {"noise": {"angle_random_walk_deg_sqrt_h": 0.0005}}), 2
    )
    tables = first.table, second.table.assign(gyro_deg_h=second.table["gyro_deg_h"] + 0.05)
    runs = [rlg.recording(table) for table in tables]
    found = rlg.diagnose(BASELINE, runs, only=["supply_voltage"], window_s=400.0, black_box=False)
    assert found.verdict == "none"
    (remark,) = (one for one in found.remarks if one.code == "diagnosis.run_biases")
    biases = remark.data["biases"]
    assert biases["train[1]"] - biases["train[0]"] == pytest.approx(0.05, abs=0.005)


def test_places_are_names_of_those_alone_that_share_one() -> None:
    runs = runs_of(BASELINE, 2)
    same = [run.replace(name="recording") for run in runs]
    named = told_apart({"train": [*same, runs[1]], "test": same[:1]})
    assert [[run.name for run in part] for part in named] == [["train[0]", "train[1]", runs[1].name], ["test[0]"]]
    assert all(run.table.equals(other.table) for run, other in zip([*same, runs[1], same[0]], [*named[0], *named[1]], strict=True))


def test_recordings_of_another_quantity_need_no_gyro(tmp_path: Path) -> None:
    """As files of a test bench have none; the law is that of the column that drives it."""
    rng, runs = np.random.default_rng(0), []
    for k in range(3):
        drive = 0.05 * np.cumsum(rng.standard_normal(2000))
        flow = 2.0 * drive + 0.3 * drive * np.abs(drive) + 0.1 * rng.standard_normal(2000)
        path = tmp_path / f"run{k}.csv"
        pd.DataFrame({"time_s": np.arange(2000.0), "flow_l_min": flow, "drive_V": drive}).to_csv(path, index=False)
        runs.append(rlg.read(path, gyro_required=False))
    found = rlg.diagnose(lambda run: 2.0 * run.column("drive_V"), runs[:2], runs[2:], output="flow_l_min", black_box=False)
    (law,) = found.laws
    assert law.drivers == ("drive_V",)
    assert found.test is not None
    assert found.test.augmented_rms < 0.2 * found.test.baseline_rms


def test_an_output_drives_nothing_though_it_is_the_thermometer() -> None:
    """The catalogue's temperature is another one's then; the output's own would explain it, or have no errors of a driver."""
    rng, runs, simulated = np.random.default_rng(7), [], {}
    for k in range(2):
        time_s = np.arange(0.0, 18_000.0, 20.0)
        case = np.interp(time_s, np.linspace(0.0, 18_000.0, 9), rng.uniform(-20.0, 50.0, 9))
        late = rlg.Recording(pd.DataFrame({"time_s": time_s, "gyro_deg_h": case, "temperature_case_degC": case}), name=f"run{k}")
        block = late.column("gyro_deg_h").copy()
        for i in range(1, len(block)):
            block[i] = block[i - 1] + 20.0 / 1500.0 * (case[i] - block[i - 1])
        table = late.table.assign(temperature_block_degC=block + 0.3 * rng.normal(size=len(block)))
        runs.append(rlg.Recording(table, name=f"run{k}"))
        simulated[f"run{k}"] = case
    found = rlg.diagnose(
        lambda run: simulated[run.name], runs, output="temperature_block_degC", unit="degC", black_box=False, **FEWER
    )
    assert "temperature_block_degC" not in {column for cause in found.causes for column in cause.drivers}
    assert [cause.name for cause in found.causes] == ["thermal_lag"]
