"""Print how far courses are from the truth, and whether what they state of their errors is so.

python -m experiments.readings --units 60
"""

from __future__ import annotations

import argparse
from collections import defaultdict
from collections.abc import Iterator, Sequence

import numpy as np
import numpy.typing as npt

from experiments.concealed.chamber import Unit
from experiments.concealed.logger import Logger
from experiments.concealed.operators import first_order
from experiments.tables import show_table
from rlgcomp.numerics.readings import Readings, readings_of
from rlgcomp.units import is_thermometer

Array = npt.NDArray[np.float64]
BINS = 2000
SEED = 9_000_000  # no case of experiments.concealed has a seed beside it
NOISY = 0.5  # of a step, from which on noise dithers a thermometer
TEXT = """Root mean square error of readings, of the course of a column by itself, and of its course with what other columns tell:
medians over columns, in steps of rounding or in standard deviations of the noise. Rate: error of the course's rate over that of
differences of readings. Last, the mean square of the error over the variance that is stated, median (10 to 90 % of columns).
"""


def bin_means(values: Array, bins: int, rows: int) -> Array:
    """Means over bins of so many rows each."""
    return np.asarray(values[: bins * rows].reshape(bins, rows).mean(axis=1), dtype=np.float64)


def main(argv: Sequence[str] | None = None) -> None:
    """Command line of the experiment."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--units", type=int, default=60)
    units = parser.parse_args(argv).units
    rows: dict[str, list[tuple[float, ...]]] = defaultdict(list)
    for number in range(units):
        for kind, row in of_unit(np.random.default_rng(SEED + number)):
            rows[kind].append(row)
    print(f"# Courses behind readings: `python -m experiments.readings --units {units}`\n")
    print(TEXT)
    show_table("Errors by kind of column", [_row(kind, of_kind) for kind, of_kind in sorted(rows.items())])


def _row(kind: str, of_kind: Sequence[tuple[float, ...]]) -> dict[str, object]:
    read, alone, together, rate, square = np.array(of_kind).T
    low, middle, high = np.quantile(square, [0.1, 0.5, 0.9])
    shares = {"read": read, "alone": alone, "together": together, "rate": rate}
    return {
        "column": kind,
        "number": len(of_kind),
        **{name: f"{np.median(one):.2f}" for name, one in shares.items()},
        "square over stated": f"{middle:.1f} ({low:.1f} to {high:.1f})",
    }


def of_unit(rng: np.random.Generator) -> Iterator[tuple[str, tuple[float, ...]]]:
    """Kind of each column of a drawn unit's run, with its row of the table."""
    chamber = Unit.draw(rng).run(rng)
    logger = Logger.draw(rng, [chamber], (), ())
    read = logger.readings(chamber, rng)
    rows = max(1, len(chamber.time_s) // BINS)
    bins = len(chamber.time_s) // rows
    recorded = {name: values[: bins * rows] for name, values in read.items() if name not in logger.absent}
    binned = {name: bin_means(values, bins, rows) for name, values in recorded.items()}
    courses = readings_of(recorded, binned)
    for name, course in courses.items():
        stated = float(np.mean(course.variance + course.rounding))
        if stated <= 0.0:
            continue
        if name in logger.lag_s:
            truth = first_order(chamber[name], chamber.step_s, logger.lag_s[name]) + logger.offset_K[name]
            kind = "thermometer, rounded" if logger.read_noise_K < NOISY * logger.resolution_K else "thermometer, noise"
            unit = logger.resolution_K if kind.endswith("rounded") else logger.read_noise_K / np.sqrt(rows)
        else:
            truth, unit = chamber[name], logger.monitor_noise[name] / np.sqrt(rows)
            kind = "light" if name.startswith("light") else "readouts" if name.startswith("readout") else "other monitors"
        true = bin_means(truth, bins, rows)
        alone = Readings.of(recorded[name], binned[name], diffuses=is_thermometer(name)).values
        sizes = [rms(one - true) / unit for one in (binned[name], alone, course.values)]
        rate = rms(np.gradient(course.values - true)) / rms(np.gradient(binned[name] - true))
        yield kind, (*sizes, rate, float(np.mean((course.values - true) ** 2 / (course.variance + course.rounding))))


def rms(values: Array) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(values**2)))


if __name__ == "__main__":
    main()
