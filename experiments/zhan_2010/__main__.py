"""Print the paper's numbers beside ours, and draw figures 5 and 6."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib import rc_context
from matplotlib.figure import Figure

from experiments.tables import show_list, show_table
from experiments.zhan_2010 import study
from rlgcomp.report.drawing import FIT, RAW, STYLE


def main(argv: Sequence[str] | None = None) -> None:
    """Command line of the experiment."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="fewer simulated repeats")
    parser.add_argument("--out", type=Path, default=None, help="folder for figures 5 and 6 (PNG) and their points (CSV)")
    options = parser.parse_args(argv)
    paper = study.constants()
    experiments = 50 if options.quick else 1000

    print("# Chinese J. Lasers 37, 1327 (2010): scale factor of a rate-biased gyro\n")
    show_table("Conventional scale factor (figure 5)", study.conventional(paper, 3000 if options.quick else 100_000))
    show_table(f"Mounting angle (figure 6), {experiments} times 80 positions", study.angle(paper, experiments))
    show_table("Standard deviation of one mounting angle by term, arcsec", study.by_term(paper, experiments // 5))
    show_table("Scale factor, arcsec/pulse", study.scale_factor(paper, 3 if options.quick else 20))
    show_table("Error budget", study.budget(paper))
    show_list("Printed slips", study.slips(paper))
    if options.out is not None:
        options.out.mkdir(parents=True, exist_ok=True)
        _draw(paper, options.out)


def _draw(paper: dict[str, float], folder: Path) -> None:
    scale = study.figure_5(paper)
    angles = {reading: study.figure_6(paper, reading) for reading in ("uniform", "gaussian")}
    departure = (scale / scale.mean() - 1.0) / 1e-7
    pd.DataFrame({"repeat": np.arange(1, len(scale) + 1), "departure_1e-7": departure}).to_csv(folder / "figure_5.csv", index=False)
    pd.DataFrame({"beta0_deg": 10.0 * np.arange(len(angles["uniform"])), **angles}).to_csv(folder / "figure_6.csv", index=False)
    with rc_context(STYLE):
        figure = Figure(figsize=(8, 3.2), layout="constrained")
        axes = figure.subplots()
        axes.plot(departure, ".-", color=RAW, lw=0.6, ms=3)
        axes.set(title="Figure 5, simulated: conventional scale factor", xlabel="repeat", ylabel="relative departure, 10⁻⁷")
        figure.savefig(folder / "figure_5.png", dpi=110)
        figure = Figure(figsize=(8, 3.2), layout="constrained")
        axes = figure.subplots()
        for (reading, values), colour in zip(angles.items(), (RAW, FIT), strict=True):
            axes.plot(values, ".-", color=colour, lw=0.6, ms=4, label="half-width" if reading == "uniform" else "three sigma")
        axes.axhline(paper["theta_mean"], lw=0.8, color=RAW)
        axes.legend(title="largest error read as")
        axes.set(title="Figure 6, simulated: mounting angle", xlabel="position, β0 in steps of 10 deg", ylabel="θ, arcsec")
        figure.savefig(folder / "figure_6.png", dpi=110)
    for name in ("figure_5", "figure_6"):
        print(f"![]({name}.png)\n")


if __name__ == "__main__":
    main()
