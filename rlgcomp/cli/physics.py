"""The known physics of `rlgcomp train`: a simulator file, or what a diagnosis of the training runs finds."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Final

from rlgcomp.cli.base import progress
from rlgcomp.cli.ending import notify

if TYPE_CHECKING:
    from collections.abc import Sequence

    from rlgcomp.recording import Recording
    from rlgcomp.simulation.simulator import Simulator

AUTO: Final = "auto"
MODEL_OF_PHYSICS: Final = "lssvm"  # that known physics goes with


def require_physics(physics: str | None, simulator: Path | None, *, model: str, device: str | None, adapted: bool) -> None:
    """Refuse options of `train` that do not go together with `--physics`.

    Parameters
    ----------
    physics : str, optional
    simulator : Path, optional
    model : str
        Its name.
    device : str, optional
    adapted : bool
        Whether a model of other units is adapted.

    Raises
    ------
    InputError
        They do not.
    """
    from rlgcomp.errors import InputError

    if simulator is not None and physics != AUTO:
        raise InputError("--simulator is for --physics auto, which diagnoses the runs against it; give both, or neither")
    if physics is None:
        return
    if model != MODEL_OF_PHYSICS or device is not None or adapted:
        other = "--adapt" if adapted else f"--device {device}" if device is not None else f"--model {model}"
        raise InputError(f"--physics is for --model {MODEL_OF_PHYSICS}, not for {other}; leave one of them out")


def physics_of(physics: str | None, simulator: Path | None, runs: Sequence[Recording], gyro: str | None) -> Simulator | None:
    """The simulator of a file, or the augmented one of a diagnosis of the training runs; None where there is to be none.

    Parameters
    ----------
    physics : str, optional
        File, or "auto".
    simulator : Path, optional
        Against which "auto" diagnoses; by default a cubic in temperature and its rate.
    runs : sequence of Recording
        The training runs.
    gyro : str, optional
        Gyro column, where there are several.

    Raises
    ------
    InputError
        A file cannot be read, or the runs cannot be diagnosed.
    """
    if physics is None:
        return None
    from rlgcomp.simulation.simulator import Simulator

    if physics != AUTO:
        return Simulator.from_yaml(physics)
    from rlgcomp.diagnosis.diagnose import diagnose
    from rlgcomp.physics.temperature_rate import TemperatureRate
    from rlgcomp.physics.thermal_polynomial import ThermalPolynomial

    cubic = Simulator((ThermalPolynomial(), TemperatureRate())).freed(["thermal_polynomial", "temperature_rate"])
    with progress("diagnosing", 100) as advance:
        diagnosis = diagnose(
            cubic if simulator is None else Simulator.from_yaml(simulator),
            runs,
            gyro=gyro,
            black_box=False,
            progress=lambda fraction: advance(round(100 * fraction), 100),
        )
    notify(diagnosis.sentence)
    augmented: Simulator = diagnosis.augmented
    return augmented
