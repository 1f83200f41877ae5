"""rlgcomp: from raw recordings of ring laser gyros to a deployed bias compensation, and to the physics a simulator is missing.

A **Recording** goes in on the left and comes out compensated on the right; a simulator is another source of recordings.

    read ─► Recording ─► FeatureRecipe ─► Compensator ─► evaluate ─► artefact, report
              ▲
    Simulator: mechanisms + noise + chamber programme

    turntable runs ─► Calibration, applied to raw recordings          runs at rest or turning ─► noise coefficients

Recording
    A table whose column names end in their unit, and metadata. `time_s` and a gyro column are required; everything else is kept.
    gyro_deg_h, gyro_deg_s, gyro_pulses (or gyro_x_..., y, z)      output; pulses are signed and need `pulse_arcsec`
    temperature_block_degC, temperature_shell_degC, temperature_<place>_degC
    light_intensity_V, readout_a_V, readout_b_V                     path-length-control light; RMS of the two readout photodiodes
    magnetic_field_uT, pressure_hPa, supply_voltage_V, discharge_current_a_mA, discharge_current_b_mA
    table_angle_deg, table_rate_deg_s, angle_inner_deg, angle_outer_deg, accel_x_m_s2, ...
Bias
    gyro = true rate + bias + noise; a compensation subtracts the estimated bias.
Bias stability
    Standard deviation of means over 100 s within a run.
Units
    Rates in deg/h, angles in deg or arcsec, temperature in degC, time in s. Angle random walk N in deg/sqrt(h).
Results
    Frozen objects that print in a few lines and become DataFrames. A fault of input is an `InputError`.

Rooms, each importing only from those before it (docs/design.md):
    errors units files   the one exception; constants and every unit conversion; atomic reading and writing
    report.messages      remarks and findings: code, data and text; report.drawing: pictures in one style
    numerics             filters and hysteresis operators with explicit state, compiled loops, robust statistics, linear algebra
    recording            the data type; formats, repair, outliers, motion of a table
    noise                processes; Allan deviation and coefficients; angle random walk of a rotating gyro
    physics              one file, one mechanism, for the simulator and for diagnosis
    simulation           programmes, thermal plant, readout optics, tables; the simulator
    calibration          scale factor with the mounting angle; triad on a two-axis table
    compensation         features, models, selection, intervals, streaming, artefact
    evaluation           held-out runs, comparison tables, a folder of models
    report               figures and pages
    diagnosis            the physics that a simulator is missing
    challenge export     concealed effects and sensitivity; C and ONNX
    fleet cli            many gyros; the command line, also by python -m rlgcomp
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rlgcomp.calibration.file import Calibration as Calibration
    from rlgcomp.calibration.scale_factor_calibration import calibrate_scale_factor as calibrate_scale_factor
    from rlgcomp.calibration.triad.calibrate import calibrate_turntable as calibrate_turntable
    from rlgcomp.compensation.adaptation import adapt as adapt
    from rlgcomp.compensation.compensator import Compensator as Compensator
    from rlgcomp.compensation.compensator import load as load
    from rlgcomp.compensation.feature_pipeline import FeatureRecipe as FeatureRecipe
    from rlgcomp.compensation.models.baselines import KernelBaselines as KernelBaselines
    from rlgcomp.compensation.models.cubic import CubicLeastSquares as CubicLeastSquares
    from rlgcomp.compensation.models.fixed_size import FixedSizeLSSVM as FixedSizeLSSVM
    from rlgcomp.compensation.models.lssvm import LSSVMRegressor as LSSVMRegressor
    from rlgcomp.compensation.models.sequence import SequenceRegressor as SequenceRegressor
    from rlgcomp.diagnosis.diagnose import diagnose as diagnose
    from rlgcomp.diagnosis.report.result import Diagnosis as Diagnosis
    from rlgcomp.errors import InputError as InputError
    from rlgcomp.evaluation.evaluation import Evaluation as Evaluation
    from rlgcomp.evaluation.evaluation import evaluate as evaluate
    from rlgcomp.noise.allan_deviation import AllanDeviation as AllanDeviation
    from rlgcomp.noise.allan_deviation import allan_deviation as allan_deviation
    from rlgcomp.noise.allan_deviation import fit_coefficients as fit_coefficients
    from rlgcomp.noise.allan_octaves import overlapping_deviation as overlapping_deviation
    from rlgcomp.noise.analysis import analyse_noise as analyse_noise
    from rlgcomp.noise.angle_random_walk import angle_random_walk as angle_random_walk
    from rlgcomp.noise.coefficients import NoiseCoefficients as NoiseCoefficients
    from rlgcomp.noise.constant_rate_segment import AngleRandomWalk as AngleRandomWalk
    from rlgcomp.noise.processes import NoiseModel as NoiseModel
    from rlgcomp.physics import CATALOGUE as CATALOGUE
    from rlgcomp.physics.mechanism import Mechanism as Mechanism
    from rlgcomp.recording import Metadata as Metadata
    from rlgcomp.recording import Recording as Recording
    from rlgcomp.recording.formats import read as read
    from rlgcomp.recording.formats import write as write
    from rlgcomp.recording.tables import recording as recording
    from rlgcomp.simulation.programme import Programme as Programme
    from rlgcomp.simulation.random_units import simulated_unit as simulated_unit
    from rlgcomp.simulation.simulator import Simulator as Simulator
    from rlgcomp.simulation.triad_errors import TriadErrors as TriadErrors
    from rlgcomp.simulation.two_axis_table import Triad as Triad

__version__ = "0.1.0"

# Public names and where they live. They are imported when first used, so that `import rlgcomp` costs next to nothing.
_HOMES = {
    "AllanDeviation": "noise.allan_deviation",
    "AngleRandomWalk": "noise.constant_rate_segment",
    "CATALOGUE": "physics",
    "Calibration": "calibration.file",
    "Compensator": "compensation.compensator",
    "CubicLeastSquares": "compensation.models.cubic",
    "Evaluation": "evaluation.evaluation",
    "FeatureRecipe": "compensation.feature_pipeline",
    "FixedSizeLSSVM": "compensation.models.fixed_size",
    "InputError": "errors",
    "KernelBaselines": "compensation.models.baselines",
    "LSSVMRegressor": "compensation.models.lssvm",
    "Mechanism": "physics.mechanism",
    "Metadata": "recording",
    "NoiseCoefficients": "noise.coefficients",
    "NoiseModel": "noise.processes",
    "Programme": "simulation.programme",
    "Recording": "recording",
    "SequenceRegressor": "compensation.models.sequence",
    "Simulator": "simulation.simulator",
    "Triad": "simulation.two_axis_table",
    "TriadErrors": "simulation.triad_errors",
    "adapt": "compensation.adaptation",
    "allan_deviation": "noise.allan_deviation",
    "analyse_noise": "noise.analysis",
    "angle_random_walk": "noise.angle_random_walk",
    "calibrate_scale_factor": "calibration.scale_factor_calibration",
    "calibrate_turntable": "calibration.triad.calibrate",
    "Diagnosis": "diagnosis.report.result",
    "diagnose": "diagnosis.diagnose",
    "evaluate": "evaluation.evaluation",
    "fit_coefficients": "noise.allan_deviation",
    "load": "compensation.compensator",
    "overlapping_deviation": "noise.allan_octaves",
    "read": "recording.formats",
    "recording": "recording",
    "simulated_unit": "simulation.random_units",
    "write": "recording.formats",
}
__all__ = sorted(_HOMES)  # noqa: PLE0605


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'rlgcomp' has no attribute {name!r}; it has {', '.join(__all__)}")
    home = importlib.import_module(f"rlgcomp.{_HOMES[name]}")
    value = home if name == _HOMES[name] else getattr(home, name)  # the room `recording` is itself called
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return [*globals(), *__all__]
