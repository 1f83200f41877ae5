"""Bias that follows the magnetic field."""

from __future__ import annotations

import dataclasses

from rlgcomp.physics.mechanism import Array, Mechanism, amplitude, setting
from rlgcomp.recording import Recording


@dataclasses.dataclass(frozen=True)
class MagneticField(Mechanism):
    r"""A ring not quite plane, or mirrors under stress, make the light elliptical; the Faraday effect then splits the beams.

    .. math:: b = k \, (B - B_0)

    B is the component along the sensitive direction. The bias does not depend on the rate of rotation.
    """

    name = "magnetic_field"
    kind = "chamber"
    equation = "b = k_deg_h_uT * (magnetic_field_uT - reference_uT)"
    reference = (
        "Acta Physica Sinica 62, 054205 (2013), doi 10.7498/aps.62.054205 (ellipticity of the eigenmodes and magnetic sensitivity)."
    )
    drivers = ("magnetic_field_uT",)

    k_deg_h_uT: float = amplitude(0.001, "deg/h/uT")
    reference_uT: float = setting(48.0, "uT")

    def basis(self, recording: Recording) -> Array:
        (field,) = self.read(recording)
        return (field - self.reference_uT)[:, None]
