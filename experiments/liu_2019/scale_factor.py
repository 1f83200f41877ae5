"""Section 3: the scale factor against rate (table 3, figure 4), the operating rate, and how much of the curve is lock-in."""

from __future__ import annotations

import numpy as np

from experiments.tables import published, show_list, show_table
from rlgcomp.calibration.rate_dependence import RateTable, fit_lock_in, rate_table
from rlgcomp.calibration.scale_factor import conventional_scale_factors
from rlgcomp.simulation.position_table import PositionTable
from rlgcomp.units import PPM, SECONDS_PER_HOUR

PAPER_RATES = (1, 2, 3, 6, 9, 12, 15, 24, 30, 40, 50, 60)  # as the text lists them
SQRT_3 = np.sqrt(3.0)  # each of the three oblique gyros senses this share of the rate about Z


def show(quick: bool) -> None:
    """Print table 3, the choice of the operating rate and the lock-in fits beside what is published."""
    paper = published("liu_table3")
    table = RateTable(paper["rate_dps"].to_numpy(dtype=float), paper.filter(regex="^r[0-9]").to_numpy())
    printed = paper["std_printed_ppm"].to_numpy()
    fits = {
        "k0 and lock-in": fit_lock_in(table),
        "the same, first term of the root": fit_lock_in(table, form="series"),
        "the same, rates unweighted": fit_lock_in(table, weighted=False),
        "k0, lock-in and b/Ω": fit_lock_in(table, with_bias=True),
        "the same, rates unweighted ": fit_lock_in(table, with_bias=True, weighted=False),
    }
    plain, biased = fits["k0 and lock-in"], fits["k0, lock-in and b/Ω"]
    show_table(
        "Table 3 and figure 4: scale-factor error Δk_gz, ppm",
        [
            {
                "rate, deg/s": f"{rate:g}",
                "mean of 5": f"{mean:.2f}",
                "std, published": f"{published_std:g}",
                "std, ours": f"{std:.3f}",
                "left by lock-in": f"{left:+.1f}",
                "left by lock-in and b/Ω": f"{less:+.1f}",
            }
            for rate, mean, published_std, std, left, less in zip(
                table.rate_deg_s,
                table.mean_ppm,
                printed,
                table.std_ppm,
                plain.residuals["residual_ppm"],
                biased.residuals["residual_ppm"],
                strict=True,
            )
        ],
    )
    show_table(
        "Operating rate, deg/s",
        [
            {
                "rule": "std of repeats below 1 ppm from here on",
                "published": "12 (text: beyond 12, so more than 15)",
                "ours": f"{table.repeatable_from_deg_s():g}",
            },
            {
                "rule": "mean within 1 ppm of the mean of all higher rates",
                "published": "30 chosen ('around 3 ppm' from 30 on)",
                "ours": f"{table.constant_from_deg_s():g}",
            },
            {"rule": "the same within 1.2 ppm", "published": "", "ours": f"{table.constant_from_deg_s(1.2):g}"},
        ],
    )
    show_table(
        "Lock-in: Ω_L along Z, its repeatability over the five runs, and what is left",
        [
            {
                "model": name,
                "Ω_L, deg/s": f"{fit.lock_in_deg_s:.4f} ± {fit.lock_in_sd_deg_s:.4f}",
                "per gyro (/√3), deg/h": f"{fit.lock_in_deg_s / SQRT_3 * SECONDS_PER_HOUR:.0f}",
                "k0, ppm": f"{fit.offset_ppm:+.2f} ± {fit.offset_sd_ppm:.2f}",
                "b, ppm·deg/s": f"{fit.bias_ppm_deg_s:+.0f}" if fit.bias_ppm_deg_s else "",
                "χ²/dof": f"{fit.chi2:.0f}/{fit.freedom}",
            }
            for name, fit in fits.items()
        ],
    )
    correlation = table.correlation()[:6, :6][np.triu_indices(6, 1)]
    bias_deg_h = biased.bias_ppm_deg_s * PPM * SECONDS_PER_HOUR
    lock_ins = [fit.lock_in_deg_s for fit in fits.values()]
    show_list(
        "What the table supports",
        [
            f"{plain.assessment}.",
            f"The models put Ω_L between {min(lock_ins):.4f} and {max(lock_ins):.4f} deg/s; this, not the repeatability, is its "
            "error.",
            f"b/Ω takes most of what is left but would be a bias of {bias_deg_h:.2f} deg/h, {bias_deg_h / 0.02:.0f} times the 0.02 "
            "deg/h found in section 4: it stands for something else.",
            f"Repeats at 1 to 12 deg/s correlate by {correlation.min():.2f} to {correlation.max():.2f}, and Ω_L differs by "
            f"{100.0 * plain.runs['lock_in_deg_s'].std() / plain.lock_in_deg_s:.1f} % from run to run: five runs, not 65 values.",
        ],
    )
    _simulated(plain.lock_in_deg_s, quick)
    missing = [rate for rate in table.rate_deg_s if rate not in PAPER_RATES]
    apart = np.flatnonzero(np.abs(table.std_ppm - printed) > 0.0501)
    show_list(
        "Printed slips, table 3",
        [
            *(f"{table.rate_deg_s[k]:g} deg/s: std {table.std_ppm[k]:.3f} is printed as {printed[k]:g}." for k in apart),
            f"The text lists {len(PAPER_RATES)} rates, the table {len(table.rate_deg_s)}: "
            f"{', '.join(f'{rate:g}' for rate in missing)} deg/s is missing.",
        ],
    )


def _simulated(lock_in_deg_s: float, quick: bool) -> None:
    """Recordings of a gyro that has lock-in and nothing else, through the same code as the command."""
    rates = [1.0, 3.0, 12.0, 30.0, 60.0] if quick else [float(rate) for rate in PAPER_RATES]
    runs = [
        PositionTable(lock_in_deg_s=lock_in_deg_s * (1.0 + 0.02 * change)).rate_recording(
            1, seed, rates_deg_s=rates, revolutions=1, step_s=0.02, name=f"power-up {seed + 1}"
        )
        for seed, change in enumerate(np.random.default_rng(0).standard_normal(5))
    ]
    fit = fit_lock_in(rate_table(conventional_scale_factors(runs)[0])[0])
    show_table(
        "Simulated recordings, five power-ups, lock-in alone with 2 % from power-up to power-up",
        [
            {
                "Ω_L put in, deg/s": f"{lock_in_deg_s:.4f}",
                "found": f"{fit.lock_in_deg_s:.4f} ± {fit.lock_in_sd_deg_s:.4f}",
                "χ²/dof": f"{fit.chi2:.1f}/{fit.freedom}",
                "what is left": fit.assessment.text,
            }
        ],
    )
