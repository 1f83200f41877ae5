"""Triads for Monte Carlo calibrations."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator

import numpy as np

from rlgcomp.noise.processes import stream
from rlgcomp.simulation.triad_errors import ACCELEROMETER, TriadErrors
from rlgcomp.simulation.two_axis_table import Triad


def drawn_triads(units_count: int, errors: TriadErrors, *, seed: int = 0, **changes: float) -> Iterator[Triad]:
    """Triads with the same gyro errors, each with other accelerometer residuals and another tilt of the table.

    Parameters
    ----------
    units_count : int
    errors : TriadErrors
        Of the gyros.
    seed : int
    **changes : float
        Other parameters of :class:`Triad`.

    Notes
    -----
    Accelerometers are calibrated to 5 ug, 2 ppm and 2 arcsec (uniform), the table stands true to 3 arcsec and 60 arcsec in azimuth
    (standard deviations).
    """
    for unit in range(units_count):
        rng = stream(seed + unit, "residuals")
        bounds = np.array([{"ug": 5.0, "ppm": 2.0, "arcsec": 2.0}[parameter.unit] for parameter in ACCELEROMETER])
        residuals = TriadErrors.of(rng.uniform(-bounds, bounds), ACCELEROMETER)
        east, north, up = rng.standard_normal(3) * (3.0, 3.0, 60.0)
        yield dataclasses.replace(Triad(gyro=errors, accelerometer=residuals, tilt_arcsec=(east, north, up)), **changes)  # type: ignore[arg-type]
