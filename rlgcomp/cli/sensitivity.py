"""Command on the smallest effect that would be found: sensitivity."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

import typer

from rlgcomp.cli.base import (
    AsJson,
    Drop,
    Gyro,
    Jobs,
    Map,
    MechanismFiles,
    OnlyOwn,
    PeriodS,
    PulseArcsec,
    Runs,
    candidates_of,
    command,
    interval_of,
    progress,
    read_runs,
    require_folder,
)
from rlgcomp.cli.ending import notify
from rlgcomp.cli.show import show_json, show_remarks, show_table, show_text
from rlgcomp.cli.simulation import SimulatorFile

if TYPE_CHECKING:
    from rlgcomp.challenge.sensitivity import Sensitivity

FILES: Final = ("sensitivity.json", "shares.csv", "curves.png", "report.html", "figures/*.svg")


@command("sensitivity", several=("--mechanisms",))
def sensitivity(
    simulator: SimulatorFile,
    runs: Runs,
    mechanism: Annotated[str, typer.Option("--mechanism", "-m", metavar="NAME", help="Mechanism to inject and find.")],
    strengths: Annotated[
        str,
        typer.Option(
            metavar="RATIO,RATIO,...", help="Strengths to try: rms that the simulator cannot fit / white noise of a 100 s mean."
        ),
    ] = "0.1,0.2,0.4,0.8,1.6",
    draws: Annotated[
        int,
        typer.Option(
            min=1, metavar="N", help="Trials a strength, each with other nonlinear parameters and signs; equal ones count once."
        ),
    ] = 6,
    seed: Annotated[int, typer.Option(min=0, metavar="N", help="Seed of the trials.")] = 0,
    out: Annotated[
        Path | None, typer.Option("--out", "-o", metavar="DIR", help="Folder for curves and trials, replaced as a whole.")
    ] = None,
    mechanisms: MechanismFiles = None,
    only_own: OnlyOwn = False,
    mapping: Map = None,
    drop: Drop = None,
    gyro: Gyro = None,
    pulse_arcsec: PulseArcsec = None,
    period_s: PeriodS = None,
    jobs: Jobs = 1,
    as_json: AsJson = False,
) -> None:
    """Smallest effect of a mechanism that would be detected, and identified, in your own recordings.

    The mechanism is injected at growing strengths, and every trial is a diagnosis of the runs. Detected: the p-value of the
    mismatch is below 0.01. Named (identified): the most probable set of mechanisms holds it, at any p-value; a faint effect may be
    named in more trials than it is detected in.

    Thirty trials on two runs of 11 h take 0.5 to 4 minutes of one core: --jobs shares them out, fewer
    --draws shorten them.

    Example: `rlgcomp sensitivity simulator.yaml cold.parquet hot.parquet --mechanism supply_voltage --jobs 2`
    """
    from rlgcomp.challenge.sensitivity import sensitivity as measure
    from rlgcomp.errors import InputError
    from rlgcomp.physics import CATALOGUE
    from rlgcomp.simulation.simulator import Simulator

    try:
        sizes = [float(word) for word in strengths.split(",")]
    except ValueError:
        raise InputError(f"--strengths is {strengths!r}; write numbers joined by commas, as 0.1,0.2,0.4") from None
    if out is not None:
        require_folder(out, FILES, simulator, runs, mechanisms)
    candidates = candidates_of(mechanisms, only_own)
    recordings = read_runs(runs, mapping, drop, pulse_arcsec, period_s=period_s)
    with progress("diagnosing") as advance:
        result = measure(
            Simulator.from_yaml(simulator, {**CATALOGUE, **candidates}),
            recordings,
            mechanism,
            strengths=sizes,
            draws=draws,
            seed=seed,
            gyro=gyro,
            catalogue=candidates,
            jobs=jobs,
            progress=advance,
        )
    if out is not None:
        _write(result, out, [Path(simulator), *(interval_of(spec)[0] for spec in runs)], [run.metadata for run in recordings])
        notify(f"{out}: report.html, sensitivity.json, shares.csv, curves.png")
    if as_json:
        show_json(result.to_mapping())
        return
    by_strength, smallest = _tables(result)
    show_table(
        f"{mechanism} in {len(recordings)} run{'s' if len(recordings) > 1 else ''}: share found, "
        f"by strength over the white noise of {result.averaging_s:g} s",
        by_strength,
    )
    show_text(f"{result.meaning}\n")
    show_table("Smallest effect found", smallest)
    show_remarks(result.remarks)


def _tables(result: Sensitivity) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
    """Shares by strength, and the smallest effects found."""
    by_strength = [
        {
            "strength": row["strength"],
            "rms, deg/h": _two_digits(row["rms_deg_h"]),
            "detected (p < 0.01)": _percent(row["detected"]),
            "named": _percent(row["named"]),
            "named or in its class": _percent(row["in_class"]),
            "named though p > 0.01": _percent(row["undetected"]),
            "trials": int(row["trials"]),
        }
        for row in result.to_frame().to_dict("records")
    ]
    smallest: list[dict[str, Any]] = []
    for criterion, curve in (("detected", result.detection), ("named or in its class", result.naming)):
        for share, size, interval in (("50 %", curve.s50, curve.s50_interval), ("90 %", curve.s90, curve.s90_interval)):
            amplitudes = [f"{key} = {value:.3g} {unit}" for key, (value, unit) in result.sizes(size).items()]
            smallest.append(
                {
                    "": f"{criterion}, {share}",
                    "strength": _two_digits(size),
                    "95 % interval": f"{interval[0]:.2g} – {interval[1]:.2g}",
                    "rms, deg/h": _two_digits(size * result.white_deg_h),
                    "that is": ", ".join(amplitudes) or "–",
                }
            )
    return by_strength, smallest


def _two_digits(number: float) -> float:
    return float(f"{number:.2g}")


def _percent(share: float) -> str:
    return f"{100 * share:.0f} %"


def _write(result: Sensitivity, out: Path, inputs: list[Path], tested: list[Any]) -> None:
    import numpy as np
    import pandas as pd

    from rlgcomp.files import whole_folder, write_json
    from rlgcomp.recording.provenance import provenance
    from rlgcomp.report.sensitivity import FoundCurve, curves_picture, sensitivity_page

    table = result.to_frame()
    tried = table["strength"].to_numpy()
    at = np.geomspace(tried.min() / 2.0, tried.max() * 2.0, 200)
    detected, named = (
        FoundCurve(label, tried, table[column].to_numpy(), at, curve.probability(at), curve.s90, curve.s90_interval)
        for label, column, curve in (
            ("detected: something is there (p < 0.01)", "detected", result.detection),
            ("named: the likeliest set holds it, or its class", "in_class", result.naming),
        )
    )
    title = f"{result.mechanism}, injected into these recordings: share of trials in which it is found"
    with whole_folder(out, writes=FILES) as folder:
        write_json(folder / "sensitivity.json", result.to_mapping())
        table.to_csv(folder / "shares.csv", index=False)
        (folder / "curves.png").write_bytes(curves_picture(title, result.white_deg_h, detected, named, result.meaning.text))
        titles = ("Shares by strength", "Smallest effect found")
        tables = {one: pd.DataFrame(rows) for one, rows in zip(titles, _tables(result), strict=True)}
        notes = (result.meaning, result.remarks)
        page = sensitivity_page(result.mechanism, result.white_deg_h, (detected, named), tables, notes)
        page.write(folder / "report.html", provenance(inputs), tested, folder / "figures")
