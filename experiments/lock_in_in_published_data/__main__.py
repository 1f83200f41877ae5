"""Table 3 against a simulator with a linear scale factor: what is missing, the lock-in rate, and what lock-in leaves."""

from __future__ import annotations

import argparse
import math
from collections.abc import Sequence

from experiments.lock_in_in_published_data import study
from experiments.lock_in_in_published_data.recordings import table_3
from experiments.tables import show_list, show_table
from rlgcomp.units import SECONDS_PER_HOUR


def main(argv: Sequence[str] | None = None) -> None:
    """Command line of the experiment."""
    argparse.ArgumentParser(description=__doc__).parse_args(argv)
    table, found, models = table_3(), study.diagnosis(), study.lock_in_rates()
    print("# A linear scale factor against Sensors 19, 4754 (2019), table 3\n")
    print(f"## What the diagnosis says\n\n```\n{found}\n```\n")
    show_table(
        "The lock-in rate",
        [
            {
                "model": name,
                "W_L, deg/s": f"{rate:.4f} ± {sd:.4f}",
                "per gyro (/√3), deg/h": f"{rate / math.sqrt(3.0) * SECONDS_PER_HOUR:.0f}",
            }
            for name, (rate, sd) in models.items()
        ],
    )
    alone, error = study.fit_each().left
    parts = study.contributions_ppm(found.augmented)
    beyond = table.mean_ppm - parts["scale_factor"].to_numpy() - parts["lock_in"].to_numpy()
    show_table(
        "Scale-factor error, ppm",
        [
            {
                "rate, deg/s": f"{rate:g}",
                "mean of 5": f"{mean:+.2f}",
                "left by k0 and lock-in alone (± standard error over power-ups)": f"{left:+.1f} ± {sd:.1f}",
                "left by the diagnosis's k0 and lock-in": f"{more:+.1f}",
                "left by all it found": f"{mean - whole:+.1f}",
            }
            for rate, mean, left, sd, more, whole in zip(
                table.rate_deg_s, table.mean_ppm, alone, error, beyond, parts.sum(axis=1), strict=True
            )
        ],
    )
    (rate, sd), values = models["the diagnosis"], [value for value, _ in models.values()]
    power_up = study.fit_each().lock_in_deg_s.std(ddof=1)
    gain = 0.0 if found.test is None else found.test.improvement
    law = "".join(f": {one.equation}" for one in found.laws)
    show_list(
        "What this supports",
        [
            f"Lock-in is missing from a linear scale factor (probability {_probability(found):.4f}, p = {found.p_value:.0e}). "
            f"What three power-ups show lowers the error of the other two by {gain:.0%}.",
            f"Its rate along Z is {rate:.4f} ± {sd:.4f} deg/s. The models above put it between {min(values):.4f} and "
            f"{max(values):.4f} deg/s; a power-up shifts it by {power_up:.4f} deg/s (standard deviation), at all rates at once.",
            study.hump(alone),
            f"Of what is left the verdict is '{found.verdict}'{law}. Thirteen rates cannot say which physics that is.",
        ],
    )


def _probability(found: study.Diagnosis) -> float:
    return max((cause.probability for cause in found.causes if cause.name == "lock_in"), default=0.0)


if __name__ == "__main__":
    main()
