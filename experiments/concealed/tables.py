"""The rows of all cases as markdown: goals beside what was reached, then every table behind them."""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from scipy import stats

from experiments.concealed.effects import INDEPENDENT
from experiments.concealed.turntable import EFFECTS
from experiments.tables import show_list, show_table

Row = Mapping[str, Any]
ENOUGH_NATS = 8.0
THRESHOLD_NATS = float(stats.chi2.isf(0.02 / len(INDEPENDENT), 1)) / 2.0  # accuses 2 % of healthy gyros of any one of the effects
PROBABILITIES = (0.0, 0.5, 0.7, 0.9, 0.99, 1.01)
_TITLES = {
    "single": "One effect",
    "pair": "Two at once",
    "triple": "Three at once",
    "unequal": "Two at once, one five times as strong",
}
NAMED = ("single", "pair", "triple", "table", "unequal")


def show(rows: Sequence[Row]) -> None:
    """Print everything."""
    failed = [row for row in rows if "failure" in row]
    done = [row for row in rows if "failure" not in row]
    _show_goals(rows)
    for kind, title in _TITLES.items():
        if chosen := [row for row in rows if row["kind"] == kind]:
            show_table(f"{title}, by strength and maker", by_strength(chosen))
    if named := [row for row in done if row["kind"] in ("single", "pair", "triple", "driverless")]:
        show_table("What flicker and random walk cost", by_noise(named))
    if singles := [row for row in rows if row["kind"] == "single"]:
        show_table("One effect, by effect", by_effect(singles))
        show_table("Injected (rows) against named (columns), one effect", confusion(singles))
    if turning := [row for row in rows if row["kind"] == "table"]:
        show_table("On a turntable, by effect", by_effect(turning, (*EFFECTS, "")))
    if healthy := [row for row in done if row["kind"] == "null"]:
        show_table("Healthy gyros", null(healthy))
    if outside := [row for row in rows if row["kind"] == "open"]:
        show_table("Outside the catalogue", by_law(outside))
    if driverless := [row for row in rows if row["kind"] == "driverless"]:
        show_table("Driver not recorded", without_driver(driverless))
    if calibration_rows := by_probability([row for row in done if row["kind"] in (*NAMED, "null")]):
        show_table("Probabilities: how often a cause that is named is there", calibration_rows)
    if parameters := by_parameter([row for row in done if row["kind"] in NAMED]):
        show_table("Parameters: (estimate - truth) / sd, where the mechanism was named", parameters)
    if misses := [miss(row) for row in rows if not right(row)]:
        show_list(f"Cases not answered as wished ({len(misses)} of {len(rows)})", misses)
    if failed:
        show_list("Failures", [f"{row['key']}: {row['failure']}" for row in failed])


# --- what counts ---------------------------------------------------------------------------------------------------------------


def right(row: Row) -> bool:
    """Whether a case was answered as the goals ask."""
    if "failure" in row:
        return False
    if row["kind"] == "null":
        return bool(row["verdict"] == "none")
    if row["kind"] == "driverless":
        return bool(row["verdict"] == "unknown" and not row["findings"])
    if row["kind"] == "open":
        return all(test(row) for test in OPEN.values())
    return bool(row["exact"])


OPEN: Mapping[str, Callable[[Row], bool]] = {
    "unknown": lambda row: row["verdict"] == "unknown",
    "drivers right": lambda row: row["drivers"] == row["true_drivers"],
    "memory right": lambda row: row["memory"] == row["true_memory"],
    "held out ≤ 2 × oracle": lambda row: row["error_to_oracle"] <= 2.0,
}


def share(rows: Sequence[Row], test: Callable[[Row], bool]) -> str:
    """Share of rows that pass, failures failing, with a 95 % interval (Clopper–Pearson)."""
    if not rows:
        return "–"
    passed = sum("failure" not in row and test(row) for row in rows)
    low, high = stats.binomtest(passed, len(rows)).proportion_ci(0.95)
    return f"{100 * passed / len(rows):.0f} % ({passed}/{len(rows)}; {100 * low:.0f}–{100 * high:.0f})"


def median(rows: Sequence[Row], key: str) -> str:
    """Median of a number, where there is one."""
    values = [row[key] for row in rows if row.get(key) is not None]
    return f"{np.median(values):.2f}" if values else "–"


def has_enough_nats(row: Row) -> bool:
    """Whether the recordings say enough for the effect to be named by anyone who knows the noise."""
    return bool("failure" in row or row["information_nats"] >= ENOUGH_NATS)


def exact(row: Row) -> bool:
    return bool(row["exact"])


def informed(rows: Sequence[Row]) -> str:
    """Share that an observer who knows noise and shapes would detect, accusing as few healthy gyros as is asked of rlgcomp.

    The gain of log-likelihood of the weakest effect, of I nats, is normal with mean I and variance 2 I.
    """
    nats = [row["information_nats"] for row in rows if "failure" not in row]
    return f"{100 * np.mean(stats.norm.sf(THRESHOLD_NATS, nats, np.sqrt(np.multiply(2.0, nats)))):.0f} %" if nats else "–"


def in_class(row: Row) -> bool:
    return bool(row["in_class"])


# --- tables --------------------------------------------------------------------------------------------------------------------


def _show_goals(rows: Sequence[Row]) -> None:
    show_table("Goals", goals(rows))
    if naming := without_telegraphs(rows):
        show_table("Goals of naming, where no effect is a random telegraph", naming)


def goals(rows: Sequence[Row]) -> list[dict[str, str]]:
    """What is asked, beside what was reached."""

    def some(kind: str, *strengths: float) -> list[Row]:
        return [row for row in rows if row["kind"] == kind and (not strengths or row["strength"] in strengths)]

    healthy = [row for row in some("null") if "failure" not in row]
    uniform = f"KS p = {stats.kstest([row['p_value'] for row in healthy], 'uniform').pvalue:.3f}" if healthy else "–"
    repeated = [row for row in rows if row.get("repeats") and row["kind"] in NAMED]
    seconds = [row["seconds"] for row in rows if "seconds" in row]
    cpu = f"; processor {median(rows, 'cpu_seconds')}"
    lines = [
        *((name, goal, share(chosen, test), informed(chosen)) for name, goal, chosen, test in _naming(rows)),
        ("healthy: verdict none", "≥ 98 %", share(some("null"), right)),
        ("healthy: p-values uniform", "KS p > 0.05", uniform),
        ("outside the catalogue: unknown, right drivers", "≥ 80 %", share(some("open"), lambda r: all(t(r) for t in _FIRST))),
        ("outside: memory, held out ≤ 2 × oracle as well", "≥ 80 %", share(some("open"), right)),
        ("driver not recorded: unknown, no name", "≥ 80 %", share(some("driverless"), right)),
        ("on a turntable, strength 1 and 0.5, or healthy: exact set", "≥ 97 %", share(some("table"), exact)),
        ("held-out error / oracle, median", "≤ 1.3", median(repeated, "error_to_oracle")),
        ("seconds a case, median / longest", "< 20", f"{np.median(seconds):.1f} / {max(seconds):.1f}{cpu}" if seconds else "–"),
    ]
    heads = ("", "goal", "reached", "who knows noise and shapes, from the training runs")
    return [dict(itertools.zip_longest(heads, line, fillvalue="")) for line in lines]


def without_telegraphs(rows: Sequence[Row]) -> list[dict[str, str]]:
    """The goals of naming, where no effect is a random telegraph, whose spectrum is that of slow noise."""
    found = [row for row in rows if "random_telegraph" not in row["hidden"]]
    return [
        {"": name, "goal": goal, "reached": share(chosen, test)} for name, goal, chosen, test in _naming(found) if goal and chosen
    ]


def _naming(rows: Sequence[Row]) -> list[tuple[str, str, list[Row], Callable[[Row], bool]]]:
    """What is asked of names, of which cases, and how they are judged."""

    def some(kind: str, *strengths: float) -> list[Row]:
        return [row for row in rows if row["kind"] == kind and row["strength"] in strengths]

    return [
        ("one effect, strength 1 and 0.5: exact set", "≥ 97 %", some("single", 1.0, 0.5), exact),
        ("one effect, strength 0.25: exact set", "≥ 85 %", some("single", 0.25), exact),
        ("one effect, strength 0.25: in class", "≥ 92 %", some("single", 0.25), in_class),
        ("two, strength 1: exact set", "≥ 92 %", some("pair", 1.0), exact),
        ("two, strength 0.5: exact set", "≥ 85 %", some("pair", 0.5), exact),
        ("three, strength 1: exact set", "≥ 75 %", some("triple", 1.0), exact),
        ("two, one five times as strong, the weaker 1: exact set", "", some("unequal", 1.0), exact),
        ("two, one five times as strong, the weaker 0.5: exact set", "", some("unequal", 0.5), exact),
    ]


_FIRST = (OPEN["unknown"], OPEN["drivers right"])


def by_strength(rows: Sequence[Row]) -> list[dict[str, str]]:
    """Detection and naming by strength, and by whose physics made the case."""
    lines = []
    for strength in sorted({row["strength"] for row in rows}, reverse=True):
        for independent in (True, False):
            chosen = [row for row in rows if row["strength"] == strength and row["independent"] == independent]
            lines.append(
                {
                    "strength": f"{strength:g}",
                    "physics": "independent" if independent else "rlgcomp's",
                    "detected": share(chosen, lambda row: row["detected"]),
                    "first is right": share(chosen, lambda row: row["named"]),
                    "exact set": share(chosen, exact),
                    f"exact of those with {ENOUGH_NATS:g} nats": share([row for row in chosen if has_enough_nats(row)], exact),
                    "who knows noise and shapes": informed(chosen),
                    "in class": share(chosen, in_class),
                    "error / oracle": median([row for row in chosen if row.get("repeats")], "error_to_oracle"),
                    "overlap": median(chosen, "overlap"),
                }
            )
    return lines


def by_noise(rows: Sequence[Row]) -> list[dict[str, str]]:
    """Right answers on units whose noise is white, and on units that have flicker and rate random walk as well."""
    lines = []
    for kind, strength in dict.fromkeys((row["kind"], row["strength"]) for row in rows):
        chosen = [row for row in rows if (row["kind"], row["strength"]) == (kind, strength)]
        line = {"cases": kind, "strength": f"{strength:g}"}
        for noise, white in (("white noise", True), ("flicker and walk", False)):
            units = [row for row in chosen if row["white_noise"] == white]
            line |= {noise: share(units, right), f"{noise}, in class": share(units, in_class) if kind in NAMED else "–"}
            line |= {f"{noise}, who knows noise and shapes": informed(units) if kind in NAMED else "–"}
        lines.append(line)
    return lines


def by_effect(rows: Sequence[Row], names: Sequence[str] = tuple(INDEPENDENT)) -> list[dict[str, str]]:
    """The same effect by effect; "" stands for none."""
    strengths = sorted({row["strength"] for row in rows}, reverse=True)
    lines = []
    for name in names:
        chosen = [row for row in rows if row["hidden"] == ([name] if name else [])]
        if chosen:
            lines.append(
                {
                    "effect": name or "healthy",
                    **{f"exact at {s:g}": _count([row for row in chosen if row["strength"] == s]) for s in strengths},
                    "in class": share(chosen, in_class),
                    "error / oracle": median([row for row in chosen if row.get("repeats")], "error_to_oracle"),
                    "overlap": median(chosen, "overlap"),
                }
            )
    return lines


def _count(rows: Sequence[Row]) -> str:
    return f"{sum('failure' not in row and row['exact'] for row in rows)}/{len(rows)}"


def confusion(rows: Sequence[Row]) -> list[dict[str, str]]:
    """How often each set was the answer to each effect."""
    answers = {
        name: Counter(_answer(row) for row in rows if row["hidden"] == [name])
        for name in INDEPENDENT
        if any(r["hidden"] == [name] for r in rows)
    }
    columns = [name for name in (*INDEPENDENT, "none", "unknown", "several", "failed") if any(a[name] for a in answers.values())]
    return [{"": name, **{column: str(counted[column] or "·") for column in columns}} for name, counted in answers.items()]


def _answer(row: Row) -> str:
    if "failure" in row:
        return "failed"
    if row["verdict"] in ("none", "unknown") and not row["findings"]:
        return str(row["verdict"])
    return str(row["findings"][0]) if len(row["findings"]) == 1 else "several"


def null(rows: Sequence[Row]) -> list[dict[str, str]]:
    """Calibration of the null."""
    p_values = np.array([row["p_value"] for row in rows])
    below = {f"p < {level:g}": f"{100 * np.mean(p_values < level):.1f} %" for level in (0.5, 0.1, 0.05, 0.01)}
    verdicts = Counter(row["verdict"] for row in rows)
    answers = ", ".join(f"{verdict} {count}" for verdict, count in verdicts.most_common())
    return [{"cases": str(len(rows)), **below, "KS p": f"{stats.kstest(p_values, 'uniform').pvalue:.3f}", "verdicts": answers}]


def by_law(rows: Sequence[Row]) -> list[dict[str, str]]:
    """Laws outside the catalogue."""
    return [
        {
            "law": law,
            "strength": f"{strength:g}",
            **{name: share(chosen, test) for name, test in OPEN.items()},
            "error / oracle": median(chosen, "error_to_oracle"),
        }
        for law in dict.fromkeys(row["hidden"][0] for row in rows)
        for strength in sorted({row["strength"] for row in rows})
        if (chosen := [row for row in rows if row["hidden"] == [law] and row["strength"] == strength])
    ]


def without_driver(rows: Sequence[Row]) -> list[dict[str, str]]:
    """Effects whose driver was not recorded."""
    return [
        {
            "driver": name,
            "detected": share(chosen, lambda row: row["detected"]),
            "unknown": share(chosen, lambda row: row["verdict"] == "unknown"),
            "no false name": share(chosen, lambda row: not row["findings"]),
            "says that no driver was recorded": share(chosen, lambda row: not row["drivers"]),
        }
        for name in dict.fromkeys(row["hidden"][0] for row in rows)
        if (chosen := [row for row in rows if row["hidden"] == [name]])
    ]


def by_probability(rows: Sequence[Row]) -> list[dict[str, str]]:
    """Causes that were named, by the probability they were given: their mean and the share of true ones agree, if it is honest."""
    pairs = [(p, name in row["hidden"]) for row in rows for name, p in zip(row["findings"], row["probabilities"], strict=True)]
    lines = []
    for low, high in itertools.pairwise(PROBABILITIES):
        group = [(p, true) for p, true in pairs if low <= p < high]
        if group:
            right, (least, most) = sum(true for _, true in group), (min(p for p, _ in group), max(p for p, _ in group))
            interval = stats.binomtest(right, len(group)).proportion_ci(0.95)
            lines.append(
                {
                    "probability": f"{least:.3f} to {most:.3f}",
                    "named": str(len(group)),
                    "said, mean": f"{100 * np.mean([p for p, _ in group]):.1f} %",
                    "so": f"{100 * right / len(group):.1f} % ({right}; {100 * interval.low:.0f}–{100 * interval.high:.0f})",
                }
            )
    return lines


def by_parameter(rows: Sequence[Row]) -> list[dict[str, str]]:
    """Errors over standard deviations: one, if the standard deviations are honest."""
    errors: dict[str, list[float]] = {}
    for row in rows:
        for name, error in row["errors_sd"].items():
            errors.setdefault(name, []).append(error)
    return [
        {
            "parameter": name,
            "cases": str(len(found)),
            "rms": f"{np.sqrt(np.mean(np.square(found))):.2f}",
            "median of the absolute (0.67 is right)": f"{np.median(np.abs(found)):.2f}",
            "within 2 sd": f"{100 * np.mean(np.abs(found) < 2.0):.0f} %",
        }
        for name, found in sorted(errors.items())
    ]


def mark(row: Row) -> str:
    """One line as a case finishes."""
    if "failure" in row:
        return f"failed {row['key']}: {row['failure']}"
    return f"{'right' if right(row) else 'WRONG'} {row['seconds']:5.1f} s  {miss(row)}"


def miss(row: Row) -> str:
    """One line on a case that was not answered as wished."""
    if "failure" in row:
        return f"{row['key']}: failed"
    named = ", ".join(f"{name} {p:.2f}" for name, p in zip(row["findings"], row["probabilities"], strict=True)) or "nothing"
    nats = f", {row['information_nats']:.0f} nats" if row["kind"] in NAMED else ""
    law = f"; drivers {row['drivers']} for {row['true_drivers']}, {row['memory']} for {row['true_memory']}"
    return f"{row['name']}: {row['verdict']}, {named}, p = {row['p_value']:.2g}{nats}" + (law if row["kind"] == "open" else "")
