"""A user's own mechanism file: a bellows that the ambient pressure bends, which no mechanism of the catalogue describes."""

from __future__ import annotations

from pathlib import Path

SOURCE = """
import dataclasses
from rlgcomp.physics.mechanism import Mechanism, amplitude

@dataclasses.dataclass(frozen=True)
class Bellows(Mechanism):
    name = "bellows"
    kind = "KIND"
    equation = "b = k_deg_h_hPa2 * (pressure_hPa - 1010)^2"
    reference = "A note of this laboratory."
    drivers = ("pressure_hPa",)
    k_deg_h_hPa2: float = amplitude(1e-4, "deg/h/hPa^2", positive=True)

    def basis(self, recording):
        (pressure,) = self.read(recording)
        return ((pressure - 1010.0) ** 2)[:, None]
"""


def write_bellows(path: Path, kind: str = "chamber") -> Path:
    """Write the file; `kind` is that of the mechanism."""
    path.write_text(SOURCE.replace("KIND", kind))
    return path
