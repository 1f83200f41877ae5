"""Every published number of Sensors 19, 4754 (2019) beside ours: tables 3 to 7, figures 4 to 14, and the printed slips."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence

from experiments.liu_2019 import alignment, angle_random_walk, calibration, scale_factor
from experiments.work import Work

SECTIONS: dict[str, Callable[[bool, Work], None]] = {
    "scale-factor": lambda quick, work: scale_factor.show(quick),
    "calibration": calibration.show,
    "angle-random-walk": angle_random_walk.show,
    "alignment": lambda quick, work: alignment.show(quick),
}


def main(argv: Sequence[str] | None = None) -> None:
    """Command line of the experiment."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="fewer and shorter simulated runs")
    parser.add_argument("--section", choices=SECTIONS, action="append", help="only this section; may be given again")
    Work.add_options(parser, "liu_2019")
    options = parser.parse_args(argv)
    work = Work.of(options)
    print("# Sensors 19, 4754 (2019): ring laser gyros in rate-biased mode\n")
    for name in options.section or SECTIONS:
        SECTIONS[name](options.quick, work)


if __name__ == "__main__":
    main()
