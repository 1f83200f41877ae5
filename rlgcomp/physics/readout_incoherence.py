"""Bias that follows the common shift of the two beams, as the readout difference measures it."""

from __future__ import annotations

import dataclasses

from rlgcomp.physics.mechanism import Array, Mechanism, amplitude
from rlgcomp.recording import Recording


@dataclasses.dataclass(frozen=True)
class ReadoutIncoherence(Mechanism):
    r"""Both beams wander together on the bi-planar photodiode; the two halves then see unequal fringes.

    .. math:: b = k \, \frac{A - B}{A + B}, \qquad \frac{A - B}{A + B} \approx \tanh\frac{4 s \bar{x}}{w^2}

    A, B: RMS of the two halves; x̄: mean shift of the beams; s: distance of each half from the middle; w: beam radius.
    """

    name = "readout_incoherence"
    kind = "chamber"
    equation = "b = k_deg_h * (readout_a_V - readout_b_V) / (readout_a_V + readout_b_V)"
    reference = "Temperature compensation method using readout signals of ring laser gyroscope, Opt. Express 23, 13320 (2015)."
    drivers = ("readout_a_V", "readout_b_V")

    k_deg_h: float = amplitude(0.5, "deg/h")

    def basis(self, recording: Recording) -> Array:
        a, b = self.read(recording)
        return ((a - b) / (a + b))[:, None]
