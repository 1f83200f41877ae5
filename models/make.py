"""Make the models of this folder, with their code: `python models/make.py`."""

from __future__ import annotations

import sys
from pathlib import Path

import rlgcomp as rlg
from rlgcomp.compensation.models import MODELS
from rlgcomp.export.target import export

FOLDER = Path(__file__).parent
# unit: model, chamber programmes; seeds are those of the demo
RECIPES = {1: ("lssvm", ("paper", "minor-loops")), 2: ("dynamic", ("paper", "minor-loops", "slow"))}


def main() -> None:
    """Simulate, train, save, export."""
    for seed, (form, programmes) in RECIPES.items():
        unit = rlg.simulated_unit(seed)
        runs = [unit.simulate(programme, seed=k, name=f"train-{k}") for k, programme in enumerate(programmes, start=1)]
        path = FOLDER / f"simulated-unit-{seed}"
        rlg.Compensator(MODELS[form].make()).fit(runs).save(path)
        export(path, path / "c")
        sys.stdout.write(f"{path}: written\n")


if __name__ == "__main__":
    main()
