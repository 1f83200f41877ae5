"""Run the study and print it: tables 1 to 4, figures 6 to 10, and what agrees with the paper."""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import pandas as pd

from experiments.optica_2015 import mechanisms
from experiments.optica_2015.figures import draw
from experiments.optica_2015.study import INPUTS, PUBLISHED, correlations, ratios, study_unit, summary, verdicts
from experiments.work import Work


def main(argv: Sequence[str] | None = None) -> None:
    """Command line of the experiment."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--units", type=int, default=10, help="simulated gyro units (default 10)")
    Work.add_options(parser, "optica_2015")
    parser.add_argument(
        "--mechanisms", action="store_true", help="decompose the residuals, and search the sizes behind the paper's"
    )
    parser.add_argument("--nearest", type=int, metavar="UNIT", help="search the sizes of one unit from several starts alone")
    parser.add_argument("--starts", type=int, default=2, help="of that, drawn at random (default 2)")
    parser.add_argument("--steps", type=int, default=500, help="trials from each (default 500)")
    parser.add_argument("--out", type=Path, default=None, help="folder for figures 6 to 10 (PNG) and the tables (CSV)")
    options = parser.parse_args(argv)
    work = Work.of(options)
    if options.nearest is not None:
        pieces = [(options.nearest, "proportional", start, options.steps) for start in range(1, options.starts + 1)]
        found = work.results("optica from", mechanisms.nearest, pieces)
        _print_nearest(f"Unit {options.nearest}, {options.steps} trials", found, [f"start {piece[2]}" for piece in pieces])
        return
    if options.mechanisms:
        _mechanisms(work, options.units)
        return
    units = work.results("optica", study_unit, [(seed,) for seed in range(options.units)])

    stability = summary(units)
    print(f"# Opt. Express 23, 13320 (2015) on {len(units)} simulated units, bias stability of 100 s means held out, deg/h\n")
    _print("Table 1: size of the correlation with the bias (published table is an image)", correlations(units), 2)
    _print("Table 2: cubic least squares", stability.loc[["raw", *[f"cubic, {name}" for name in INPUTS]]])
    _print("Table 3: LS-SVM", stability.loc[["raw", *[f"lssvm, {name}" for name in INPUTS]]])
    together = [
        f"{model}, {inputs}" for model in ("cubic", "lssvm") for inputs in ("readout_difference", "paper's four", "all of rlgcomp")
    ]
    _print("Table 4: methods and input vectors", stability.loc[[*together, "noise floor"]])
    _print("Figures of merit", ratios(units), 1)
    print("## What agrees, and what does not\n")
    for sentence in verdicts(units):
        print(f"- {sentence}")
    if options.out is not None:
        options.out.mkdir(parents=True, exist_ok=True)
        stability.to_csv(options.out / "stability.csv")
        for path in draw(units[0], options.out):
            print(f"\n![]({path.name})")


def _mechanisms(work: Work, units: int) -> None:
    """Print the residuals by mechanism, the rows with one size changed, and with all changed at once."""
    made = work.results("optica mechanisms", mechanisms.decomposed, [(seed,) for seed in range(units)])
    names = list(made[0]["shares"][next(iter(mechanisms.ROWS))])
    table = pd.DataFrame({row: pd.DataFrame([unit["shares"][row] for unit in made]).mean() for row in mechanisms.ROWS})
    _print("Share of each mechanism in the variance of the residual, %, mean of units", 100.0 * table.loc[names], 0)
    sizes = pd.DataFrame(
        {
            "published": pd.Series(PUBLISHED),
            "another run held out": pd.DataFrame([unit["rows"] for unit in made]).mean(),
            "windows between those of training": pd.DataFrame([unit["interleaved"] for unit in made]).mean(),
        }
    ).loc[list(PUBLISHED)]
    _print("The same rows by what is held out, deg/h, mean of units", sizes)
    pieces = [
        (seed, name, factor) for name in (*names, *mechanisms.BEAMS) for factor in mechanisms.FACTORS for seed in range(units)
    ]
    rows = pd.DataFrame(work.results("optica factor", mechanisms.with_factor, pieces))
    rows[["parameter", "factor"]] = [piece[1:] for piece in pieces]
    scan = rows.groupby(["parameter", "factor"], sort=False).mean()
    scan["distance"] = [mechanisms.distance(row) for _, row in scan.iterrows()]
    unchanged = sizes["another run held out"]
    scan.loc[("none", 1.0), :] = [*unchanged[scan.columns[:-1]], mechanisms.distance(unchanged)]
    scan.index = [f"{name} × {factor:g}" for name, factor in scan.index]
    scan.loc["published"] = [*(PUBLISHED[row] for row in scan.columns[:-1]), 0.0]
    _print("One size of every unit multiplied: mean of units, deg/h; distance: rms of the logarithms of the rows", scan)
    for law in ("proportional", "saturating"):
        found = work.results("optica nearest", mechanisms.nearest, [(seed, law) for seed in range(units)])
        units_named = [f"unit {seed}" for seed in range(units)]
        _print_nearest(f"All sizes of a unit free, bias {law} in the readout difference", found, units_named)


def _print_nearest(title: str, found: Sequence[Mapping[str, Any]], names: Sequence[str]) -> None:
    """The rows that were reached, and the factors that bring them."""
    reached = pd.DataFrame([one["rows"] for one in found], index=names)[list(PUBLISHED)]
    errors = reached / pd.Series(PUBLISHED) - 1.0
    reached["rows within 10 %"] = (errors.abs() <= mechanisms.MATCHED).sum(axis=1).astype(float)
    _print(f"{title}: the nearest rows, deg/h", reached)
    _print("The factors that bring them", pd.DataFrame([one["factors"] for one in found], index=names), 2)


def _print(title: str, table: pd.DataFrame, digits: int = 4) -> None:
    print(f"## {title}\n")
    header = ["", *map(str, table.columns)]
    print("| " + " | ".join(header) + " |")
    print("|" + "---|" * len(header))
    for name, row in table.iterrows():
        print("| " + " | ".join([str(name), *("" if pd.isna(value) else f"{value:.{digits}f}" for value in row)]) + " |")
    print()


if __name__ == "__main__":
    main()
