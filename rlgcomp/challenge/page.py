"""The page of a revealed challenge: what was concealed beside what was found."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt
import pandas as pd

from rlgcomp.challenge.seal import CHALLENGE, SIMULATOR, Revealed
from rlgcomp.errors import InputError
from rlgcomp.files import from_json, read_text
from rlgcomp.physics import CATALOGUE
from rlgcomp.physics.mechanism import Mechanism
from rlgcomp.recording import Recording
from rlgcomp.recording.formats import read
from rlgcomp.report.drawing import FIT, INK, legend, page_figure, power, time_axis
from rlgcomp.report.messages.wording import cause_words, estimate_text, listing, percent_text
from rlgcomp.report.page import Picture, Results, Section
from rlgcomp.report.svg import picture
from rlgcomp.simulation.simulator import Simulator

Array = npt.NDArray[np.float64]
_AUGMENTED: Final = "augmented.yaml"
_PANEL_IN: Final = 2.1
_POINTS: Final = 1500  # of a line
_MOST_RUNS: Final = {"train": 1, "test": 3}


@dataclasses.dataclass(frozen=True)
class Contributions:
    """Contributions in deg/h to a run over time, their means removed."""

    title: str
    time_s: Array
    concealed: Array
    found: Array


def page_of(revealed: Revealed, challenge: Path, diagnosis: Path) -> Results:
    """The page of a revealed challenge.

    Parameters
    ----------
    revealed : Revealed
    challenge : path
        Its folder.
    diagnosis : path
        A diagnosis.json or its folder; the figure needs the `augmented.yaml` beside it.
    """
    score = revealed.score
    hidden = listing([cause_words(name) for name in revealed.hidden]) or "nothing"
    found = listing([cause_words(name) for name in revealed.found]) or "nothing"
    right = "exactly the concealed set" if score.exact else "not the concealed set"
    right = "the concealed set, up to causes that the runs cannot tell apart" if score.in_class and not score.exact else right
    facts = [
        ("Concealed", _strengths(revealed)),
        ("Found", found),
        ("Verdict", f"{score.verdict}, of the {'right' if score.verdict_right else 'wrong'} kind"),
    ]
    if revealed.improvement is not None and revealed.possible_improvement is not None:
        possible = percent_text(revealed.possible_improvement)
        gain = f"{percent_text(revealed.improvement)} less error on the runs held out; the true law gains {possible}"
        facts.append(("Gain", gain))
    if score.overlap is not None:
        facts.append(("Place", f"{percent_text(score.overlap)} overlap of the times named with the times in which it acted most"))
    facts.append(("Sealed truth", f"SHA-256 {revealed.truth_sha256}: compare it with a copy made before the diagnosis"))
    panels = _panels(revealed, challenge, diagnosis)
    note = (
        "Contribution to each run, its mean removed. A part that the simulator's own free numbers can imitate is calibrated into "
        "them, so that the two lines may differ by a smooth function of temperature."
    )
    return Results(
        title=f"Concealed was {hidden}; found was {found}",
        kind="challenge revealed",
        badge="right" if score.exact or score.in_class else "wrong",
        answer=f"The diagnosis names {right}.",
        headline=(),
        facts=tuple(facts),
        sections=(
            *((Section("Concealed and found over time", (_figure(panels), note)),) if panels else ()),
            Section(
                "Parameters",
                (
                    _parameters(revealed, diagnosis),
                    "Strength: rms that the simulator cannot fit, divided by the white noise of a 100 s mean. Off by: estimate "
                    "less truth, in standard deviations of the estimate; beyond ± 3 the stated error is too small or the law "
                    "another.",
                ),
            ),
        ),
        footer="The answers are in reveal.json beside this page.",
    )


def _strengths(revealed: Revealed) -> str:
    return ", ".join(f"{cause_words(name)} (strength {revealed.strengths[name]:.2g})" for name in revealed.hidden) or "nothing"


def _parameters(revealed: Revealed, diagnosis: Path) -> pd.DataFrame:
    """Every parameter, true and estimated."""
    content = from_json(read_text(diagnosis / "diagnosis.json" if diagnosis.is_dir() else diagnosis))
    estimates = {one["mechanism"]: one["parameters"] for one in content["findings"]}
    rows = []
    for name in dict.fromkeys([*revealed.hidden, *revealed.found]):
        one, values = estimates.get(name, {}), revealed.hidden.get(name)
        stated, units = _in_use(name, values)
        rows.append([cause_words(name), "", "–" if values is None else "concealed", "found" if name in estimates else "–", ""])
        for parameter in dict.fromkeys([*stated, *one]):
            each = one.get(parameter)
            unit = units.get(parameter, "" if each is None else each.get("unit", ""))
            value = each["value"] if each is not None and isinstance(each["value"], int | float) else None
            off = revealed.score.errors_sd.get(f"{name}.{parameter}")
            rows.append(
                [
                    "",
                    parameter,
                    f"{stated[parameter]:.4g} {unit}".strip() if parameter in stated else "–",
                    "–" if each is None or value is None else estimate_text(value, float(each.get("sd") or 0.0), unit),
                    "" if off is None else f"{off:+.1f} s.d.",
                ]
            )
    return pd.DataFrame(rows, columns=["cause", "parameter", "concealed", "found", "off by"])


def _in_use(name: str, values: Mapping[str, Any] | None) -> tuple[dict[str, float], dict[str, str]]:
    """True numbers in use of a concealed mechanism, and units; of a mechanism of the user's own all numbers, without units."""
    form = CATALOGUE.get(name)
    if form is None:
        return {key: value for key, value in (values or {}).items() if isinstance(value, int | float)}, {}
    units = {one.name: one.unit for one in form.parameters()}
    if values is None:
        return {}, units
    mechanism = form.from_mapping(values)
    used = (*mechanism.amplitude_parameters(), *mechanism.shape_parameters())
    return {one.name: values[one.name] for one in used if isinstance(values.get(one.name), int | float)}, units


def _panels(revealed: Revealed, challenge: Path, diagnosis: Path) -> list[Contributions]:
    """Contributions to a training run and to the runs held out.

    Empty where a cause is none of the catalogue or differs from run to run, or the augmented simulator is not there.
    """
    folder = diagnosis if diagnosis.is_dir() else diagnosis.parent
    content = from_json(read_text(challenge / CHALLENGE))
    try:
        concealed = [CATALOGUE[name].from_mapping(values) for name, values in revealed.hidden.items()]
        own = {one.name for one in Simulator.from_yaml(challenge / SIMULATOR).mechanisms}
        added = [one for one in Simulator.from_yaml(folder / _AUGMENTED).mechanisms if one.name not in own]
        panels = []
        for part, role in (("train", "training"), ("test", "held out")):
            for name in content[part][: _MOST_RUNS[part]]:
                run = read(challenge / name)
                step = max(1, len(run) // _POINTS)
                lines = [_sum(mechanisms, run)[::step] for mechanisms in (concealed, added)]
                panels.append(Contributions(f"{Path(name).stem} ({role})", run.column("time_s")[::step], *lines))
    except (KeyError, InputError):
        return []
    return panels if any(np.ptp(line) > 0.0 for one in panels for line in (one.concealed, one.found)) else []


def _sum(mechanisms: Sequence[Mechanism], run: Recording) -> Array:
    """What mechanisms that repeat between runs do together in a run, its mean removed."""
    total = np.zeros(len(run))
    for one in mechanisms:
        if not one.repeats() and not one.empirical:
            raise InputError(f"{one.name} differs from run to run")
        total += one.contribution(run, np.random.default_rng(0))
    return total - total.mean()


def _figure(panels: Sequence[Contributions]) -> Picture:
    """Concealed and found over time, a panel a run."""
    longest_s = max(float(np.ptp(one.time_s)) for one in panels)
    unit_s, label = time_axis(longest_s)
    largest = max(float(np.abs(line).max()) for one in panels for line in (one.concealed, one.found))
    scale, unit = power(largest, "deg/h")
    with page_figure(0.7 + _PANEL_IN * len(panels), len(panels), 1, sharex=True, squeeze=False) as (figure, grid):
        axes = grid.ravel()
        for axis, one in zip(axes, panels, strict=True):
            at = (one.time_s - one.time_s[0]) / unit_s
            axis.plot(at, scale * one.found, color=FIT, lw=2.0, label="found")
            axis.plot(at, scale * one.concealed, "--", color=INK, lw=1.4, label="concealed (the truth)")
            axis.set_title(one.title)
            axis.set_ylabel(unit)
        legend(axes[0])
        axes[-1].set_xlabel(label)
        return picture(
            figure,
            "concealed-and-found",
            "Concealed and found",
            f"Contribution in deg/h against time, of what was found and, dashed, of what was concealed; runs: "
            f"{', '.join(one.title for one in panels)}",
        )
