"""LS-SVMlab 1.8 in GNU Octave, as a peer: its own folds in closed form over a grid.

The toolbox is looked for where the environment variable `RLGCOMP_LSSVMLAB` says, `octave-cli` on the path.

References
----------
K. De Brabanter et al., *LS-SVMlab Toolbox User's Guide version 1.8*, ESAT-SISTA, K.U. Leuven, 2011; `crossvalidatelssvm.m`.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import tempfile
from pathlib import Path
from typing import Final

import numpy as np
import numpy.typing as npt
from scipy import io

from experiments.speed.measure import Timed

Array = npt.NDArray[np.float64]
FOLDER: Final = "RLGCOMP_LSSVMLAB"
_SCRIPT: Final = """
warning('off', 'all');
load('input.mat');
addpath(toolbox);
wall = tic; used = cputime;
squares = sum(X.^2, 2);
squares = max(squares + squares' - 2 * (X * X'), 0);
model = initlssvm(X, Y, 'f', gam(1), sig2(1), 'RBF_kernel', 'original');
model.gamcsa = gam;
model.kernel_parscsa = sig2;
cost = crossvalidatelssvm(model, Y, folds, squares, 'mse', 'mean');
wall_s = toc(wall); cpu_s = cputime - used;
save('-v6', 'result.mat', 'cost', 'wall_s', 'cpu_s');
"""


def lssvmlab(X: Array, y: Array, sigma: Array, c: Array, folds: int) -> Timed:
    """Smallest root mean square error over a grid, blocks of rows left out; the time is Octave's own, without its start.

    Raises
    ------
    ImportError
        Octave or the toolbox is not there.
    """
    toolbox = Path(os.environ.get(FOLDER, ""))
    if shutil.which("octave-cli") is None:
        raise ImportError("octave-cli is not on the path")
    if not (toolbox / "crossvalidatelssvm.m").exists():
        raise ImportError(f"{FOLDER} names no folder of LS-SVMlab 1.8")
    widths, weights = (grid.ravel() for grid in np.meshgrid(sigma, c))
    inputs = {"X": X, "Y": y[:, None], "sig2": widths**2, "gam": weights, "folds": float(folds), "toolbox": str(toolbox.absolute())}
    with tempfile.TemporaryDirectory() as folder:
        io.savemat(Path(folder) / "input.mat", inputs)
        environment = {**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
        command = ["octave-cli", "--quiet", "--norc", "--eval", _SCRIPT]
        subprocess.run(command, cwd=folder, env=environment, check=True, capture_output=True)  # noqa: S603
        result = io.loadmat(Path(folder) / "result.mat")
    return Timed(float(np.sqrt(result["cost"].min())), result["wall_s"].item(), result["cpu_s"].item())
