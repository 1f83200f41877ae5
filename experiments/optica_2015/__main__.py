"""Run the study and print it: tables 1 to 4, figures 6 to 10, and what agrees with the paper."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

import pandas as pd

from experiments.optica_2015.figures import draw
from experiments.optica_2015.study import INPUTS, correlations, ratios, study_unit, summary, verdicts
from experiments.work import Work


def main(argv: Sequence[str] | None = None) -> None:
    """Command line of the experiment."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--units", type=int, default=10, help="simulated gyro units (default 10)")
    Work.add_options(parser, "optica_2015")
    parser.add_argument("--out", type=Path, default=None, help="folder for figures 6 to 10 (PNG) and the tables (CSV)")
    options = parser.parse_args(argv)
    units = Work.of(options).results("optica", study_unit, [(seed,) for seed in range(options.units)])

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
