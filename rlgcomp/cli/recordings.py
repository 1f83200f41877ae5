"""Commands on recordings: inspect."""

from __future__ import annotations

from rlgcomp.cli.base import AsJson, Drop, Map, PulseArcsec, Runs, command, compared, read_runs
from rlgcomp.cli.ending import notify
from rlgcomp.cli.show import show_json, show_table, show_text


@command("inspect")
def inspect(runs: Runs, mapping: Map = None, drop: Drop = None, pulse_arcsec: PulseArcsec = None, as_json: AsJson = False) -> None:
    """What a recording holds and what is wrong with it.

    Example: `rlgcomp inspect cold.parquet hot.csv --map gyro_deg_h='Gyro Z [deg/s]'`
    """
    from rlgcomp.report.inspection import outlier_findings, summarise

    recordings = read_runs(runs, mapping, drop, pulse_arcsec)
    for recording in recordings:
        for finding in outlier_findings(recording):
            notify(f"{recording.name}: {finding}")
    differences = compared(recordings)
    summaries = [
        summarise(run) | {"remarks": [one.to_mapping() for one in differences if one.data.get("run") == run.name]}
        for run in recordings
    ]
    if as_json:
        show_json(summaries)
        return
    for summary in summaries:
        unit = f", unit {summary['unit']}" if summary["unit"] else ""
        show_text(
            f"{summary['name']}: {summary['kind']}{unit}, {summary['rows']} rows every {summary['period_s']:.6g} s, "
            f"{summary['hours']:.2f} h, {summary['gaps']} gaps\n"
        )
        for title, key in (("Gyros", "gyros"), ("Columns", "columns"), ("Thermal legs", "legs")):
            if summary[key]:
                show_table(title, summary[key])
                show_text()
