"""Make the models of this folder, with their code: `python models/make.py`.

`python models/make.py --cards` writes only cards and code anew, from the saved numbers.
"""

from __future__ import annotations

import shutil
import sys
from pathlib import Path

import rlgcomp as rlg
from rlgcomp.compensation import artefact
from rlgcomp.compensation.models import MODELS
from rlgcomp.compensation.serialisation import model_card
from rlgcomp.export.target import export

FOLDER = Path(__file__).parent
# unit: model, chamber programmes; seeds are those of the demo
RECIPES = {1: ("lssvm", ("paper", "minor-loops")), 2: ("dynamic", ("paper", "minor-loops", "slow"))}


def main(*, cards: bool) -> None:
    """Simulate, train, save, export; or write cards and code of the saved models."""
    for seed, (form, programmes) in RECIPES.items():
        path = FOLDER / f"simulated-unit-{seed}"
        if cards:
            saved = artefact.read(path)
            shutil.rmtree(path)
            artefact.write(path, saved, model_card({"remarks": [], **saved.manifest}, saved.arrays))
        else:
            unit = rlg.simulated_unit(seed)
            runs = [unit.simulate(programme, seed=k, name=f"train-{k}") for k, programme in enumerate(programmes, start=1)]
            shutil.rmtree(path, ignore_errors=True)
            rlg.Compensator(MODELS[form].make()).fit(runs).save(path)
        export(path, path / "c")
        sys.stdout.write(f"{path}: written\n")


if __name__ == "__main__":
    main(cards="--cards" in sys.argv[1:])
