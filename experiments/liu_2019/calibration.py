"""Section 4: the three steps on a two-axis table (table 4, figures 6 and 7), and what other third steps would give."""

from __future__ import annotations

import numpy as np
import pandas as pd

from experiments.liu_2019.first_step import first_step
from experiments.liu_2019.monte_carlo import STEPS, study, summary
from experiments.liu_2019.triads import drawn_triads
from experiments.tables import published, show_list, show_table
from experiments.work import Work
from rlgcomp.calibration.triad.calibrate import predicted
from rlgcomp.calibration.triad.estimate import calibrate_triad
from rlgcomp.calibration.triad.information import Noise
from rlgcomp.calibration.triad.run import TableRun
from rlgcomp.simulation.triad_errors import GYRO, TriadErrors
from rlgcomp.simulation.two_axis_table import Triad

LATITUDE_DEG = 39.98
LOCK_IN_DEG_S = 0.0173
COLUMNS = {
    "dkgx_ppm": "scale_x_ppm",
    "dkgy_ppm": "scale_y_ppm",
    "dkgz_ppm": "scale_z_ppm",
    "egx_dph": "bias_x_deg_h",
    "egy_dph": "bias_y_deg_h",
    "egz_dph": "bias_z_deg_h",
    "alpha_gy_arcsec": "alpha_gy_arcsec",
    "delta_gx_arcsec": "delta_gx_arcsec",
    "delta_gy_arcsec_header_misprinted_delta_gx": "delta_gy_arcsec",
    "beta_gx_arcsec": "beta_gx_arcsec",
    "beta_gy_arcsec": "beta_gy_arcsec",
}
STEP_ONE = ("scale_z_ppm", "bias_z_deg_h", "beta_gx_arcsec", "beta_gy_arcsec")


def show(quick: bool, work: Work | None = None) -> None:
    """Print table 4, the first step by the paper's recursion, figures 6 and 7, and the third steps compared."""
    table = published("liu_table4").rename(columns=COLUMNS).set_index("run").astype(float)
    runs, printed = table.drop(index="mean_printed"), table.loc["mean_printed"]
    truth = TriadErrors({parameter.name: float(runs[parameter.name].mean()) for parameter in GYRO})
    seeds = 4 if quick else 40
    drawn, held = study(seeds, truth, work=work), study(seeds, truth, same_residuals=True, work=work)
    kicked = study(seeds, truth, same_residuals=True, lock_in_deg_s=LOCK_IN_DEG_S, work=work)
    _table_4(runs, printed, drawn, held, truth, seeds)
    _first_step(truth, drawn, seeds)
    triad = next(drawn_triads(1, truth, seed=500))
    _figures(triad)
    _third_steps(held, kicked)
    show_list(
        "Printed slips of section 4",
        [
            "eq. 6 to 8 exchange east and north (a tilt about east accelerates northward) and lose a minus: (ωT - sin ωT)",
            "eq. 11: the scale factor's regressor is g ω T²/2 (with reversals g ∫φ dt), printed g ω T/2; the zeros of H are lost",
            "eq. 12: the minus and plus signs are lost",
            "eq. 13 leaves out the misalignments times the turning rate: 3.7 arcsec x 30 deg/s are 1.9 deg/h, the bias is 0.017",
            "eq. 14 holds for an inner axis at rest; with both turning it does not describe the velocity",
            f"table 4: two columns are headed δ_gx; Δk_z averages {runs['scale_z_ppm'].mean():.3f}, printed "
            f"{printed['scale_z_ppm']:g}; β_gy averages {runs['beta_gy_arcsec'].mean():.2f}, printed {printed['beta_gy_arcsec']:g};"
            " the column headed angular velocity is the number of the run",
        ],
    )


def _table_4(
    runs: pd.DataFrame, printed: pd.Series, drawn: pd.DataFrame, held: pd.DataFrame, truth: TriadErrors, seeds: int
) -> None:
    rows, repeated = summary(drawn).set_index("name"), summary(held).set_index("name")
    show_table(
        f"Table 4: three steps on {seeds} simulated triads whose errors are the published means",
        [
            {
                "parameter": f"{parameter.symbol}, {parameter.unit}",
                "published": f"{printed[parameter.name]:g}",
                "spread of 3 runs": f"{runs[parameter.name].std():.2g}",
                "ours": f"{truth.values[parameter.name] + drawn[parameter.name].mean():.4g}",
                "repeatability": f"{repeated.loc[parameter.name, 'repeatability']:.2g}",
                "rms error": f"{rows.loc[parameter.name, 'rms error']:.2g}",
                "stated sd": f"{rows.loc[parameter.name, 'stated sd']:.2g}",
                "rms(error / sd)": f"{rows.loc[parameter.name, 'rms error / sd']:.2f}",
            }
            for parameter in GYRO
        ],
    )
    noise = drawn["angle_random_walk_deg_sqrt_h"]
    show_list(
        "How table 4 was simulated",
        [
            f"angle random walk 0.0004 deg/sqrt(h), estimated from the runs themselves: {noise.mean():.5f} ± {noise.std():.5f}",
            "whole pulses of 0.84279 arcsec, 200 Hz, encoders of 3 arcsec, 20 minutes a step; accelerometers of 5 ug/sqrt(Hz)",
            "accelerometer residuals (5 ug, 2 ppm, 2 arcsec, uniform) and the table's tilt (3, 3, 60 arcsec) are drawn for every "
            "triad; for the repeatability one triad is calibrated again and again",
            "β and δ refer to the accelerometers' axes: their error is that of the accelerometers' misalignment",
        ],
    )


def _first_step(truth: TriadErrors, drawn: pd.DataFrame, seeds: int) -> None:
    off = pd.DataFrame(
        [
            {
                name: value - truth.values[name]
                for name, value in first_step(TableRun.of(triad.simulate("step-1", seed=seed))).items()
            }
            for seed, triad in enumerate(drawn_triads(seeds, truth))
        ]
    )
    show_table(
        "Step 1 by the paper's four states and recursion (signs restored): rms error",
        [
            {
                "parameter": name,
                "four states, eq. 12": f"{np.sqrt(np.mean(off[name] ** 2)):.2g}",
                "whole model": f"{np.sqrt(np.mean(drawn[name] ** 2)):.2g}",
            }
            for name in STEP_ONE
        ],
    )


def _figures(triad: Triad) -> None:
    found = calibrate_triad([TableRun.of(triad.simulate(step, seed=k, name=step)) for k, step in enumerate(STEPS)])
    first = found.curves[found.curves["run"] == "step-1"]
    picked = first.iloc[np.unique(np.geomspace(6, len(first) - 1, 6).round().astype(int))]
    symbols = {parameter.name: f"{parameter.symbol}, {parameter.unit}" for parameter in GYRO}
    show_table(
        "Figure 6: how the first step settles (one triad)",
        [
            {"time, s": f"{row['time_s']:.0f}"} | {symbols[name]: f"{row[name]:.3f} ± {row[f'{name}_sd']:.3f}" for name in STEP_ONE}
            for row in picked.to_dict("records")
        ],
    )
    show_table(
        "Figure 7: largest velocity error of a navigator on the turning table, m/s",
        [
            {
                "run": run.name,
                "direction": direction,
                "raw": f"{np.abs(run.before_m_s[:, k]).max():.3g}",
                "calibrated": f"{np.abs(run.after_m_s[:, k]).max():.2g}",
            }
            for run in found.runs
            if run.shows == "velocity"
            for k, direction in enumerate(("east", "north"))
        ],
    )


def _third_steps(held: pd.DataFrame, kicked: pd.DataFrame) -> None:
    show_table(
        "Third steps compared: standard deviations at 0.0004 deg/sqrt(h), lock-in left out of account",
        [
            {
                "third step": row["third step"],
                "slowest gyro, deg/s": f"{row['slowest_deg_s']:.1f}",
                "passages through zero": row["crossings"],
                "Δk_x, ppm": f"{row['scale_x_ppm']:.3f}",
                "α_gy, arcsec": f"{row['alpha_gy_arcsec']:.3f}",
            }
            for row in predicted(Noise(), LATITUDE_DEG).to_dict("records")
        ],
    )
    show_table(
        f"The paper's third step with kicks of a lock-in rate of {LOCK_IN_DEG_S} deg/s: repeatability",
        [
            {
                "parameter": parameter.symbol,
                "without": f"{held[parameter.name].std():.2g}",
                "with": f"{kicked[parameter.name].std():.2g}",
            }
            for parameter in GYRO
            if parameter.name in ("scale_x_ppm", "scale_y_ppm", "alpha_gy_arcsec", "delta_gx_arcsec", "delta_gy_arcsec")
        ],
    )
