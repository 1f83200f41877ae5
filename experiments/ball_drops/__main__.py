"""Run it and print, ball by ball, what is missing beside gravity."""

from __future__ import annotations

import argparse
import logging
from pathlib import Path

import pandas as pd

import rlgcomp as rlg
from experiments.ball_drops import falling
from rlgcomp.physics.user import user_catalogue

FOLDER = Path("../shared/data/real/ball_drops")
GRAVITY = rlg.Simulator(
    mechanisms=(falling.Gravity(), falling.Release()),
    free={"release": frozenset({"height_m", "speed_m_s"})},
    unit="ball",
)


def drop(table: pd.DataFrame, ball: str, number: int) -> rlg.Recording:
    """One drop as a recording: the height stands where a gyro would."""
    rows = table[(table["ball"] == ball) & (table["drop"] == number)]
    columns = {"time_s": rows["t_s"], "gyro_deg_h": rows["height_m"], "velocity_mps": rows["velocity_mps"]}
    return rlg.Recording(pd.DataFrame(columns).reset_index(drop=True), name=f"{ball}, drop {number}")


def main() -> None:
    """Command line of the experiment."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path, default=FOLDER, help="folder of the drops")
    options = parser.parse_args()
    logging.getLogger("rlgcomp").setLevel(logging.ERROR)
    table = pd.read_csv(options.data / "ball_drops.csv")
    catalogue = user_catalogue([Path(falling.__file__)])
    names = ("linear_drag", "quadratic_drag")
    print("# Balls dropped from a bridge: first drop to learn from, second drop held out; rms of heights in m\n")
    print("| ball | verdict | found | also possible | p | gravity only | with what was found |\n|---|---|---|---|---|---|---|")
    for ball in dict.fromkeys(table["ball"]):
        diagnosis = rlg.diagnose(
            GRAVITY,
            train=[drop(table, ball, 1)],
            test=[drop(table, ball, 2)],
            mechanisms={name: catalogue[name] for name in names},
        )
        found = ", ".join(f"{cause.name} ({cause.probability:.2f})" for cause in diagnosis.causes) or "nothing"
        rivals = ", ".join(other for cause in diagnosis.causes for other in cause.indistinguishable_from) or "-"
        before, after = (getattr(diagnosis.test, name) for name in ("baseline_rms", "augmented_rms"))
        print(f"| {ball} | {diagnosis.verdict} | {found} | {rivals} | {diagnosis.p_value:.1g} | {before:.3f} | {after:.3f} |")


if __name__ == "__main__":
    main()
