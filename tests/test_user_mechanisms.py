"""Mechanisms from a user's own file: added to the catalogue, or refused with all that is wrong and where."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import rlgcomp as rlg
from rlgcomp.physics.user import user_catalogue

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


def test_all_faults_at_once(tmp_path: Path) -> None:
    text = GOOD.replace('kind = "chamber"', 'kind = "oven"').replace('"deg/h/hPa"', '""')
    with pytest.raises(rlg.InputError, match=r"(?s)kind is 'oven'.*has no unit"):
        user_catalogue([write(tmp_path, text)])


def test_a_syntax_error_is_said_with_its_line(tmp_path: Path) -> None:
    with pytest.raises(rlg.InputError, match="line 3: invalid syntax"):
        user_catalogue([write(tmp_path, "x = 1\n\nclass A(:\n")])
