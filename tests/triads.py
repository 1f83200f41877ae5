"""Simulated triads on a two-axis table, with the published errors, and their calibration, for tests of several modules."""

from __future__ import annotations

import functools

import numpy as np
import pandas as pd

import rlgcomp as rlg
from experiments.liu_2019.triads import drawn_triads
from rlgcomp.calibration.triad.calibrate import TableCalibration, calibrate_turntable
from rlgcomp.calibration.triad.estimate import TriadCalibration, calibrate_triad
from rlgcomp.calibration.triad.run import TableRun
from rlgcomp.simulation.triad_errors import TriadErrors
from rlgcomp.simulation.two_axis_table import Triad, reversing

PUBLISHED = TriadErrors(  # means of Liu 2019, Table 4
    {
        "scale_x_ppm": 9.233,
        "scale_y_ppm": 6.933,
        "scale_z_ppm": 3.433,
        "bias_x_deg_h": 0.017,
        "bias_y_deg_h": 0.011,
        "bias_z_deg_h": 0.0203,
        "alpha_gy_arcsec": 5.13,
        "delta_gx_arcsec": 3.43,
        "delta_gy_arcsec": 5.37,
        "beta_gx_arcsec": -3.67,
        "beta_gy_arcsec": -6.4,
    }
)
STEP_S = 0.005
SILENT = Triad(
    angle_random_walk_deg_sqrt_h=0.0,
    velocity_random_walk_ug_sqrt_hz=0.0,
    velocity_noise_m_s=0.0,
    whole_pulses=False,
    encoder_arcsec=0.0,
)
SHORT = {
    "step-1": reversing(30.0, revolutions=2, repeats=2, outer_start_deg=90.0),
    "step-2": reversing(30.0, revolutions=2, repeats=2),
    "step-3": reversing(30.0, outer_deg_s=60.0, revolutions=1, repeats=4),
}


def short_runs(triad: Triad, seed: int = 1) -> list[rlg.Recording]:
    return [triad.simulate(programme, seed=10 * seed + k, name=name) for k, (name, programme) in enumerate(SHORT.items())]


@functools.cache
def triad() -> Triad:
    """A triad with the published errors, residuals of its accelerometers and a tilted table."""
    return next(drawn_triads(1, PUBLISHED, seed=5))


@functools.cache
def recordings() -> list[rlg.Recording]:
    """Its three steps, shortened."""
    return short_runs(triad())


@functools.cache
def calibration() -> TriadCalibration:
    """From these recordings."""
    return calibrate_triad([TableRun.of(recording) for recording in recordings()])


@functools.cache
def turntable() -> TableCalibration:
    """All that the command reports of them."""
    return calibrate_turntable(recordings())


def readings(table: pd.DataFrame, **other: np.ndarray | pd.Series) -> rlg.Recording:
    """A recording of the noiseless triad with columns of the table replaced."""
    return rlg.Recording(table.assign(**other), SILENT.simulate(SHORT["step-2"]).metadata)
