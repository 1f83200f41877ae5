"""Mechanisms from a user's own file: added to the catalogue, or refused with all faults and their lines."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import rlgcomp as rlg
from rlgcomp.cli import register_commands
from rlgcomp.cli.base import app
from rlgcomp.physics.mechanism import TABLE_ANGLE, TABLE_RATE, TEMPERATURE
from rlgcomp.physics.user import user_catalogue
from rlgcomp.recording import motion

GOOD = '''"""My physics."""

from __future__ import annotations

import dataclasses

import numpy as np

from rlgcomp.physics.mechanism import Array, Mechanism, amplitude, shape
from rlgcomp.recording import Recording


@dataclasses.dataclass(frozen=True)
class Pump(Mechanism):
    """The pump."""

    name = "pump"
    kind = "chamber"
    equation = "b = k_deg_h_hPa * (pressure_hPa - at_hPa)"
    reference = "Log book, page 12."
    drivers = ("pressure_hPa",)

    k_deg_h_hPa: float = amplitude(0.001, "deg/h/hPa")
    at_hPa: float = shape(1000.0, "hPa", 900.0, 1100.0)

    def basis(self, recording: Recording) -> Array:
        (pressure,) = self.read(recording)
        return (pressure - self.at_hPa)[:, None]
'''


def write(folder: Path, text: str, name: str = "mine.py") -> Path:
    (folder / name).write_text(text)
    return folder / name


def test_it_joins_the_catalogue_and_serves_a_simulator(tmp_path: Path) -> None:
    catalogue = user_catalogue([write(tmp_path, GOOD)])
    assert set(catalogue) == {*rlg.CATALOGUE, "pump"}
    (tmp_path / "sim.yaml").write_text("kind: chamber\nmechanisms:\n  - pump: {k_deg_h_hPa: 0.002, at_hPa: 1010}\n")
    simulator = rlg.Simulator.from_yaml(tmp_path / "sim.yaml", catalogue)
    run = simulator.simulate("short", step_s=10.0)
    expected = 0.002 * (run.column("pressure_hPa") - 1010.0)
    assert simulator.predict(run).column("gyro_deg_h") == pytest.approx(expected, abs=1e-12)
    simulator.to_yaml(tmp_path / "again.yaml")
    assert rlg.Simulator.from_yaml(tmp_path / "again.yaml", catalogue) == simulator
    assert np.ptp(expected) > 0.0


def test_two_files_and_names_that_are_taken(tmp_path: Path) -> None:
    first, second = write(tmp_path, GOOD), write(tmp_path, GOOD.replace('"pump"', '"fan"'), "other.py")
    assert {"pump", "fan"} <= set(user_catalogue([first, second]))
    with pytest.raises(rlg.InputError, match="'pump' is taken"):
        user_catalogue([first, write(tmp_path, GOOD, "copy.py")])
    with pytest.raises(rlg.InputError, match="'thermal_lag' is taken"):
        user_catalogue([write(tmp_path, GOOD.replace('"pump"', '"thermal_lag"'), "shadow.py")])


def test_what_is_imported_does_not_count(tmp_path: Path) -> None:
    with pytest.raises(rlg.InputError, match="defines no mechanism"):
        user_catalogue([write(tmp_path, "from rlgcomp.physics.warm_up import WarmUp\n")])


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("(frozen=True)", "", "not a frozen dataclass"),
        ("@dataclasses.dataclass(frozen=True)\n", "", "not a frozen dataclass"),
        ('name = "pump"', 'name = "My Pump"', "name is 'My Pump'"),
        ('    name = "pump"\n', "", "name is None"),
        ('kind = "chamber"', 'kind = "oven"', "kind is 'oven'"),
        ('equation = "b = k_deg_h_hPa * (pressure_hPa - at_hPa)"', 'equation = "linear"', "equation is 'linear'"),
        ('reference = "Log book, page 12."', 'reference = ""', "reference is ''"),
        ('drivers = ("pressure_hPa",)', 'drivers = "pressure_hPa"', "drivers is 'pressure_hPa'"),
        ('amplitude(0.001, "deg/h/hPa")', "0.001", "k_deg_h_hPa has no role"),
        ('amplitude(0.001, "deg/h/hPa")', 'amplitude(0.001, "")', "k_deg_h_hPa has no unit"),
        ("[:, None]", "", r"basis returns \(64,\).*shape \(64, 1\)"),
        ("(pressure - self.at_hPa)", "(pressure / 0.0 - self.at_hPa)", "not finite"),
        ("(pressure,) = self.read(recording)", "pressure = recording.nothing", "line 27: AttributeError"),
        ("(pressure,) = self.read(recording)", "pressure = recording.column('gyro_deg_h')", "changes with the gyro"),
        ("def basis", "def bases", "it lacks basis"),
        ("(pressure - self.at_hPa)", "0.0 * pressure", "basis is zero for k_deg_h_hPa whatever the monitors read"),
        ('"hPa", 900.0, 1100.0', '"hPa", 1100.0, 900.0', "at_hPa has its bounds reversed: from 1100 to 900"),
        ("(pressure - self.at_hPa)[:, None]", "np.empty((len(recording), 0))", "shape"),
    ],
)
def test_what_breaks_the_contract_is_named(tmp_path: Path, old: str, new: str, message: str) -> None:
    assert old in GOOD
    with (
        np.errstate(divide="ignore"),
        pytest.raises(rlg.InputError, match=rf"(?s)mine\.py: Pump is not a valid mechanism.*({message})"),
    ):
        user_catalogue([write(tmp_path, GOOD.replace(old, new, 1))])


ALIASES = {
    TEMPERATURE: "temperature_block_degC",
    TABLE_RATE: "table_rate_deg_s",
    TABLE_ANGLE: "table_angle_deg",
}


@pytest.mark.parametrize("driver", [*ALIASES, *ALIASES.values(), "angle_inner_deg", "angle_outer_deg", "felt_rate_deg_s"])
@pytest.mark.parametrize("kind", ["chamber", "turntable"])
def test_every_alias_is_read_on_a_table_and_in_a_chamber(tmp_path: Path, kind: str, driver: str) -> None:
    text = GOOD.replace('kind = "chamber"', f'kind = "{kind}"').replace('drivers = ("pressure_hPa",)', f'drivers = ("{driver}",)')
    pump = user_catalogue([write(tmp_path, text)])["pump"]
    assert pump.drivers == (driver,)
    programme = "short" if kind == "chamber" else "rate 7 60, rate -25 90"
    if driver in ALIASES and (kind == "turntable" or driver == TEMPERATURE):
        run = rlg.Simulator.from_mapping({"kind": kind, "mechanisms": []}).simulate(programme)
        turns = (pump().basis(run)[:, 0] + 1000.0 - run.column(ALIASES[driver])) / 360.0
        assert turns == pytest.approx(np.rint(turns) * (driver == TABLE_ANGLE), abs=1e-9)


def test_rate_and_angle_of_a_table_fit_together(tmp_path: Path) -> None:
    """On the trial recording as on real ones, so that a mechanism may take either from the other."""
    text = GOOD.replace('kind = "chamber"', 'kind = "turntable"')
    text = text.replace('drivers = ("pressure_hPa",)', 'drivers = ("table_rate", "table_angle")')
    text = text.replace("(pressure,) = self.read(recording)", "rate, angle = self.read(recording)")
    apart = "np.log(1e-6 - np.abs(rate[1:] - np.diff(angle) / np.diff(recording.time_s)).max())"  # not finite where they differ
    fitting = text.replace("(pressure - self.at_hPa)", f"(rate * np.cos(2.0 * np.deg2rad(angle)) + {apart})")
    assert "pump" in user_catalogue([write(tmp_path, fitting)])


@pytest.mark.parametrize(("drivers", "fast"), [(("table_rate",), True), (("table_angle_deg",), True), (("pressure_hPa",), False)])
def test_what_reads_how_a_table_turned_is_computed_at_the_full_rate(tmp_path: Path, drivers: tuple[str, ...], fast: bool) -> None:
    """Unless it says otherwise: at window means it would lose to a mechanism of the catalogue with the very same equation."""
    text = GOOD.replace('kind = "chamber"', 'kind = "turntable"').replace('("pressure_hPa",)', repr(drivers))
    assert user_catalogue([write(tmp_path, text)])["pump"].fast is fast
    source = text.replace('name = "pump"', 'name = "pump"\n    fast = False')
    assert not user_catalogue([write(tmp_path, source)])["pump"].fast


@pytest.mark.parametrize(("driver", "read"), [("table_rate", motion.rate_deg_s), ("table_angle", motion.angle_deg)])
@pytest.mark.parametrize("left_out", ["table_angle_deg", "table_rate_deg_s"])
def test_rate_and_angle_are_read_in_their_units_whichever_was_recorded(
    tmp_path: Path, driver: str, read: Callable[[rlg.Recording], np.ndarray], left_out: str
) -> None:
    text = GOOD.replace('kind = "chamber"', 'kind = "turntable"').replace('("pressure_hPa",)', f'("{driver}",)')
    pump = user_catalogue([write(tmp_path, text)])["pump"]
    run = rlg.Simulator.from_mapping({"kind": "turntable", "mechanisms": []}).simulate("rate 7 60, rate -25 90")
    run = run.replace(table=run.table.drop(columns=left_out))
    assert pump().basis(run)[:, 0] == pytest.approx(read(run) - 1000.0, abs=1e-9)


def test_a_threshold_is_not_taken_for_a_zero_basis(tmp_path: Path) -> None:
    """What begins above 990 hPa is zero where a trial's pressure is about 1."""
    text = GOOD.replace("(pressure - self.at_hPa)", "np.maximum(0.0, pressure - self.at_hPa)")
    assert "pump" in user_catalogue([write(tmp_path, text)])


def test_all_faults_at_once(tmp_path: Path) -> None:
    text = GOOD.replace('kind = "chamber"', 'kind = "oven"').replace('"deg/h/hPa"', '""')
    with pytest.raises(rlg.InputError, match=r"(?s)kind is 'oven'.*has no unit"):
        user_catalogue([write(tmp_path, text)])


def test_the_documentations_example_is_found_on_a_table_with_an_encoder_alone(tmp_path: Path) -> None:
    page = (Path(__file__).parents[1] / "docs/howto/add_a_mechanism.md").read_text(encoding="utf-8")
    example = page.partition("<<'PYTHON'\n")[2].partition("\nPYTHON\n")[0]
    catalogue = user_catalogue([write(tmp_path, example)])
    content = {"kind": "turntable", "mechanisms": [{"scale_factor": {"k_ppm": 5.0}}, {"centrifugal_stretch": {"k_deg_h": 0.05}}]}
    made = rlg.Simulator.from_mapping(content, catalogue).simulate("rates", seed=1)
    run = made.replace(table=made.table.drop(columns="table_rate_deg_s"), truth=None)
    simulator = rlg.Simulator.from_mapping({"kind": "turntable", "mechanisms": ["scale_factor"]})
    found = rlg.diagnose(simulator, [run], mechanisms=catalogue)
    assert [cause.name for cause in found.causes] == ["centrifugal_stretch"]
    estimate = found.causes[0].parameters["k_deg_h"]
    assert abs(estimate.value - 0.05) < 4.0 * estimate.sd < 0.01


def test_a_mechanism_without_a_docstring_is_described_without_one(tmp_path: Path) -> None:
    register_commands()
    bare = GOOD.replace('    """The pump."""\n\n', "")
    assert bare != GOOD
    for text, head in ((bare, "pump (chamber)\n"), (GOOD, "pump (chamber): The pump.\n")):
        done = CliRunner().invoke(app, ["mechanisms", "pump", "--mechanisms", str(write(tmp_path, text))])
        assert done.output.startswith(head), done.output


def test_a_syntax_error_is_reported_with_its_line(tmp_path: Path) -> None:
    with pytest.raises(rlg.InputError, match="line 3: invalid syntax"):
        user_catalogue([write(tmp_path, "x = 1\n\nclass A(:\n")])


def test_simulate_and_predict_take_several_files_after_one_option(tmp_path: Path) -> None:
    register_commands()
    first, second = write(tmp_path, GOOD), write(tmp_path, GOOD.replace("Pump", "Fan").replace('"pump"', '"fan"'), "other.py")
    (tmp_path / "sim.yaml").write_text("kind: chamber\nmechanisms: [pump, fan]\n")
    made, predicted = tmp_path / "run.parquet", tmp_path / "predicted.parquet"
    own = ["--mechanisms", str(first), str(second)]
    for arguments in (
        ["simulate", str(tmp_path / "sim.yaml"), "--profile", "short", "--step-s", "10", "--out", str(made), *own],
        ["predict", str(tmp_path / "sim.yaml"), str(made), "--out", str(predicted), *own],
    ):
        done = CliRunner().invoke(app, arguments)
        assert done.exit_code == 0, done.output
    run = rlg.read(made)
    assert {"pump", "fan"} <= set(run.truth.columns)
    assert rlg.read(predicted).column("gyro_deg_h") == pytest.approx(0.002 * (run.column("pressure_hPa") - 1000.0), abs=1e-9)
