r"""How far a random telegraph can be told from slow noise of its spectrum, by one who knows everything else.

Jumps between :math:`\pm a` with mean time tau between them have the covariance :math:`a^2 e^{-2|t|/\tau}`; so has an
Ornstein–Uhlenbeck process, which is what an unrecorded cause or a gyro's own noise may be. The observer here knows white noise,
half step and dwell, and that nothing else acts; he weighs the sum over all paths of jumps (hidden Markov model) against the
Gaussian process. Jumps come at any time, also within the 100 s windows.

References
----------
S. Machlup, "Noise in semiconductors: spectrum of a two-parameter random signal", J. Appl. Phys. 25, 341 (1954).
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from experiments.tables import show_table
from rlgcomp.diagnosis.naming.two_levels import log_likelihood
from rlgcomp.diagnosis.noise.whitening import NoiseShape, Rows, whiten

Array = npt.NDArray[np.float64]
WINDOW_S = 100.0
HOURS = 12.0
STRENGTHS = (0.25, 0.5, 1.0, 2.0)  # half step over the white noise of a window's mean
DWELLS_S = (600.0, 1200.0, 2400.0, 4800.0, 7200.0)
TWENTY_TO_ONE = math.log(20.0)


def telegraph(rows: Rows, dwell_s: float, draws: int, rng: np.random.Generator) -> Array:
    """Window means of signs that flip at any time, shape (n, draws); runs are independent."""
    means = np.empty((len(rows), draws))
    for part in rows.runs:
        count = part.stop - part.start
        edges_s = WINDOW_S * np.arange(count + 1)
        expected = edges_s[-1] / dwell_s
        waits_s = rng.exponential(dwell_s, (draws, int(expected + 10.0 * math.sqrt(expected) + 20.0)))
        for k, flips_s in enumerate(np.cumsum(waits_s, axis=1)):
            turns_s = np.r_[0.0, flips_s]
            signs = rng.choice([-1.0, 1.0]) * (-1.0) ** np.arange(len(flips_s))
            area = np.r_[0.0, np.cumsum(np.diff(turns_s) * signs)]
            means[part, k] = np.diff(np.interp(edges_s, turns_s, area)) / WINDOW_S
    return means


def odds(rows: Rows, strength: float, dwell_s: float, draws: int, rng: np.random.Generator) -> tuple[Array, Array]:
    """Log odds of jumps against slow noise of the same covariance, and against nothing, of as many recordings."""
    values = strength * telegraph(rows, dwell_s, draws, rng) + rng.standard_normal((len(rows), draws))
    jumps = np.array([log_likelihood(rows, column, strength, 1.0, [dwell_s])[0] for column in values.T])
    shapes = (NoiseShape(wander=strength, wander_s=0.5 * dwell_s), NoiseShape())
    whitened, log_determinant = whiten(rows, values, shapes)
    gaussian = -0.5 * ((whitened**2).sum(axis=1) + log_determinant[:, None] + len(rows) * math.log(2.0 * math.pi))
    return jumps - gaussian[0], jumps - gaussian[1]


def main(argv: Sequence[str] | None = None) -> None:
    """Command line of the experiment."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--draws", type=int, default=300, help="recordings for each strength and dwell (default 300)")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args(argv)
    rng = np.random.default_rng(options.seed)
    count = round(HOURS * 3600.0 / WINDOW_S)
    print("# A random telegraph, or slow noise: `python -m experiments.telegraph_or_noise`\n")
    for runs, label in ((2, "two training runs"), (4, "two training and two held-out runs")):
        rows = Rows(np.tile(WINDOW_S * np.arange(count), runs), np.repeat(np.arange(runs), count), np.ones(runs * count), WINDOW_S)
        table = []
        for strength in STRENGTHS:
            line = {"half step / white noise of 100 s": f"{strength:g}"}
            certain = []
            for dwell_s in DWELLS_S:
                alike, null = odds(rows, strength, dwell_s, options.draws, rng)
                certain.append(float(np.mean(alike > TWENTY_TO_ONE)))
                line[f"dwell {dwell_s:g} s"] = f"{alike.mean():.1f} (over nothing {null.mean():.0f})"
            line["decided at 20 to 1"] = f"{100.0 * np.mean(certain):.0f} %"
            table.append(line)
        show_table(f"Nats by which jumps beat slow noise of the same spectrum, {label} of {HOURS:g} h", table)


if __name__ == "__main__":
    main()
