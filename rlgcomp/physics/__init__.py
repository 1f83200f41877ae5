"""Error mechanisms of a ring laser gyro, one file each. To add one, write its file and its line in `CATALOGUE`.

The simulator reads this list and knows no mechanism by name. Diagnosis searches a mechanism by its `grid` and `basis`; those that
need more stand by name in its `regions/`, causal columns for compensations in `compensation/causal_forms.py`.
A test walks the folder and checks every mechanism against the contract of :mod:`rlgcomp.physics.mechanism`.
"""

from __future__ import annotations

from types import MappingProxyType
from typing import Final

from rlgcomp.physics.ageing import Ageing
from rlgcomp.physics.ambient_pressure import AmbientPressure
from rlgcomp.physics.discharge_imbalance import DischargeImbalance
from rlgcomp.physics.earth_rate_leak import EarthRateLeak
from rlgcomp.physics.encoder_delay import EncoderDelay
from rlgcomp.physics.light_intensity import LightIntensity
from rlgcomp.physics.lock_in import LockIn
from rlgcomp.physics.magnetic_field import MagneticField
from rlgcomp.physics.mechanism import Mechanism
from rlgcomp.physics.misalignment import Misalignment
from rlgcomp.physics.mode_hop import ModeHop
from rlgcomp.physics.periodic_interference import PeriodicInterference
from rlgcomp.physics.random_telegraph import RandomTelegraph
from rlgcomp.physics.rate_asymmetry import RateAsymmetry
from rlgcomp.physics.readout_incoherence import ReadoutIncoherence
from rlgcomp.physics.rotation_harmonics import RotationHarmonics
from rlgcomp.physics.scale_factor import ScaleFactor
from rlgcomp.physics.scale_factor_asymmetry import ScaleFactorAsymmetry
from rlgcomp.physics.scale_factor_nonlinearity import ScaleFactorNonlinearity
from rlgcomp.physics.scale_factor_temperature import ScaleFactorTemperature
from rlgcomp.physics.supply_voltage import SupplyVoltage
from rlgcomp.physics.tabulated_law import TabulatedLaw
from rlgcomp.physics.temperature_rate import TemperatureRate
from rlgcomp.physics.thermal_gradient import ThermalGradient
from rlgcomp.physics.thermal_hysteresis import ThermalHysteresis
from rlgcomp.physics.thermal_lag import ThermalLag
from rlgcomp.physics.thermal_polynomial import ThermalPolynomial
from rlgcomp.physics.warm_up import WarmUp

CATALOGUE: Final[MappingProxyType[str, type[Mechanism]]] = MappingProxyType(
    {
        mechanism.name: mechanism
        for mechanism in (
            ThermalPolynomial,
            TemperatureRate,
            RateAsymmetry,
            ThermalLag,
            ThermalGradient,
            ThermalHysteresis,
            ModeHop,
            WarmUp,
            Ageing,
            LightIntensity,
            ReadoutIncoherence,
            DischargeImbalance,
            SupplyVoltage,
            MagneticField,
            AmbientPressure,
            PeriodicInterference,
            RandomTelegraph,
            TabulatedLaw,
            ScaleFactor,
            ScaleFactorTemperature,
            ScaleFactorAsymmetry,
            ScaleFactorNonlinearity,
            LockIn,
            Misalignment,
            EarthRateLeak,
            RotationHarmonics,
            EncoderDelay,
        )
    }
)
