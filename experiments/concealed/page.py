"""The rows of all cases as a page of markdown: goals, what was reached and what was reachable, and the tables behind them."""

from __future__ import annotations

import itertools
import math
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from scipy import stats

from experiments.concealed.effects import CATALOGUED
from experiments.concealed.plan import NAMED, NUISANCES
from experiments.concealed.rules import effects
from experiments.tables import show_list, show_table

Row = Mapping[str, Any]
Test = Callable[[Row], bool]
EVEN_ODDS = math.log(len(CATALOGUED))  # log Bayes factor at which one of so many causes is as probable as none
CERTAIN = 0.99
PROBABILITIES = (0.0, 0.5, 0.7, 0.9, CERTAIN, 1.01)
PERIODS_S = (0.0, 0.1, 1.0, 10.0, 100.0)
STRENGTHS = (0.25, 0.5, 1.0, 2.0, 4.0, 8.0, 16.0, 32.1)
_DEFINITIONS = """\
Strength is the root mean square of what the simulator cannot absorb of an effect (residual of its window means over all
training runs by the simulator's columns and a bias), over the standard deviation of the white noise of a window's mean.
A window is 100 s where a run takes five to ten hours; a case stretches all times alike. A set is exact where the
findings are the hidden effects and the verdict claims nothing beside them. Reachable is what an observer would name who
knows noise, forms and nonlinear parameters and has the same readings. The oracle is his prediction of the held-out
runs, amplitudes by generalised least squares, averaged over random swings before a run that nobody recorded. Intervals are
Wilson's, 95 %.
"""
_ELSEWHERE = (
    (
        "pendulum, EMPS, MEMS, balls, Liu's Table 3",
        "see the issue",
        "not of this page: `tests/test_real_data.py` and `experiments/`",
    ),
    ("four 12 h runs at 1 Hz", "≤ 5 s, ≤ 1 GiB", "not of this page: `experiments/speed`"),
)


def show(rows: Sequence[Row]) -> None:
    """Print everything."""
    done = [row for row in rows if "failure" not in row]
    print(_DEFINITIONS)
    show_table("Goals", goals(rows))
    named = [row for row in rows if row["kind"] in NAMED]
    if single := [row for row in rows if row["kind"] in ("single", "weak")]:
        show_table("One effect, by strength", by_strength(single))
        if periods := by_period(single):
            show_table("One effect, by sample period, with all times in proportion", periods)
        show_table("One effect, by cause", by_cause(single))
        show_table("One effect, by form", by_form(single))
        show_table("Injected (rows) against named (columns), one effect", confusion(single))
    if healthy := [row for row in done if row["kind"] == "healthy"]:
        show_table("Healthy gyros", null(healthy))
    if several := [row for row in rows if row["kind"] in ("pair", "triple", "unequal", "nuisance")]:
        show_table("Several at once, and effects beside other faults", by_kind(several))
    if turning := [row for row in rows if row["kind"] == "turntable"]:
        show_table("On a turntable, by cause", by_cause(turning))
    if outside := [row for row in rows if row["kind"] in ("outside", "unrecorded")]:
        show_table("Outside the catalogue, and drivers that were not recorded", by_law(outside))
    if stated := statements([row for row in done if row["kind"] in (*NAMED, "healthy")]):
        show_table("Reliability: how often what is stated with a probability is so", reliability(stated))
    if any("without_rules" in row for row in done):
        show_table("Rules of the decision beyond the model, each left out", effects(done, right))
    if wrong := [line for line in certain_and_wrong(done) if line]:
        show_list(f"Statements of probability {CERTAIN:g} or more that are wrong", wrong)
    if misses := [miss(row) for row in rows if not right(row) and "failure" not in row]:
        show_list(f"Cases not answered as wished ({len(misses)} of {len(done)}; {len(named)} have something to name)", misses)
    if failed := [f"{row['key']}: {row['failure']}" for row in rows if "failure" in row]:
        show_list("Failures", failed)


# --- what counts ---------------------------------------------------------------------------------------------------------------


def exact(row: Row) -> bool:
    """The findings are the hidden effects, and the verdict claims nothing beside them."""
    return bool(row["exact"] and row["verdict"] in (("explained", "ambiguous") if row["hidden"] else ("none",)))


def drivers_right(row: Row) -> bool:
    return bool(row["verdict"] == "unknown" and row["drivers"] == row["true_drivers"])


def law_right(row: Row) -> bool:
    return drivers_right(row) and bool(row["memory"] == row["true_memory"])


def unrecorded_right(row: Row) -> bool:
    return bool(row["verdict"] == "unknown" and not row["findings"])


def both(row: Row) -> bool:
    """The set is exact, and the step, the run biases or the wrong number is recognised."""
    return exact(row) and bool(row["nuisance_found"])


def right(row: Row) -> bool:
    """Whether a case was answered as the goals ask."""
    tests: Mapping[str, Test] = {
        "healthy": lambda one: one["verdict"] == "none",
        "outside": law_right,
        "unrecorded": unrecorded_right,
        "nuisance": both,
    }
    return "failure" not in row and tests.get(row["kind"], exact)(row)


def share(rows: Sequence[Row], test: Test) -> str:
    """Share of rows that pass, failures failing, with a 95 % interval (Wilson)."""
    if not rows:
        return "–"
    return proportion(sum("failure" not in row and test(row) for row in rows), len(rows))


def proportion(passed: int, of: int) -> str:
    """A share with its 95 % interval (Wilson)."""
    low, high = stats.binomtest(passed, of).proportion_ci(0.95, method="wilson")
    return f"{100 * passed / of:.0f} % ({passed}/{of}; {100 * low:.0f}–{100 * high:.0f})"


def reachable(rows: Sequence[Row]) -> str:
    """Share in which an observer who knows noise and forms, and has the readings, detects each effect and prefers it to its rivals.

    He detects an effect whose log Bayes factor is beyond even odds.
    """
    seen = [
        row["log_bayes_factor"] > EVEN_ODDS and (row["separation_nats"] is None or row["separation_nats"] > 0.0)
        for row in rows
        if "log_bayes_factor" in row and row["hidden"]
    ]
    return f"{100 * np.mean(seen):.0f} %" if seen else "–"


def error(rows: Sequence[Row]) -> str:
    """Median of the held-out error over the oracle's."""
    values = [row["error_to_oracle"] for row in rows if "failure" not in row]
    return f"{np.median(values):.2f}" if values else "–"


# --- goals ---------------------------------------------------------------------------------------------------------------------


def goals(rows: Sequence[Row]) -> list[dict[str, str]]:
    """What is asked, beside what was reached and what was reachable."""

    def of(*kinds: str) -> list[Row]:
        return [row for row in rows if row["kind"] in kinds]

    done = [row for row in rows if "failure" not in row]
    single = [row for row in of("single") if row["strengths"][0] >= 0.5]
    weak = {white: [row for row in of("weak") if row.get("white_noise", True) == white] for white in (True, False)}
    healthy = [row for row in of("healthy") if "failure" not in row]
    uniform = f"KS p = {stats.kstest([row['p_value'] for row in healthy], 'uniform').pvalue:.3f}" if healthy else "–"
    sure = [is_so for probability, is_so, _ in statements(done) if probability >= CERTAIN]
    lines: list[tuple[str, ...]] = [
        ("one effect, strength 0.5 to 32: exact set", "≥ 97 %", share(single, exact), reachable(single)),
        ("one effect, 0.25, white noise", "≥ 88 %", share(weak[True], exact), reachable(weak[True])),
        ("one effect, 0.25, with flicker and walk", "reachable less 5 %", share(weak[False], exact), reachable(weak[False])),
        ("two at once, weakest ≥ 1", "≥ 94 %", share(of("pair"), exact), reachable(of("pair"))),
        ("three at once, weakest ≥ 1", "≥ 85 %", share(of("triple"), exact), reachable(of("triple"))),
        ("two, five to ten times apart", "≥ 90 %", share(of("unequal"), exact), reachable(of("unequal"))),
        ("effect + step, run bias or wrong number: both", "≥ 92 %", share(of("nuisance"), both), reachable(of("nuisance"))),
        ("healthy: verdict none", "≥ 98 %", share(of("healthy"), right)),
        ("healthy: p-values uniform", "KS p > 0.05", uniform),
        ("outside the catalogue: unknown, right drivers", "≥ 95 %", share(of("outside"), drivers_right), reachable(of("outside"))),
        ("outside the catalogue: and memory", "≥ 90 %", share(of("outside"), law_right)),
        ("driver not recorded: unknown, no name", "≥ 85 %", share(of("unrecorded"), unrecorded_right), reachable(of("unrecorded"))),
        ("turntable: exact set", "≥ 97 %", share(of("turntable"), exact), reachable(of("turntable"))),
        (
            f"statements of probability ≥ {CERTAIN:g} that are wrong",
            "≤ 1 %",
            proportion(sure.count(False), len(sure)) if sure else "–",
        ),
        ("held-out error / oracle, median, one effect", "≤ 1.2", error(of("single", "weak")), "1"),
        ("held-out error / oracle, median, two or three", "≤ 1.3", error(of("pair", "triple", "unequal")), "1"),
        ("95 % interval of the improvement covers", "92 to 98 %", coverage(done)),
        *_ELSEWHERE,
        ("seconds of a case: median / longest", "≤ 15 s the longest", _longest(done, "seconds", "s")),
        ("processor seconds of a case: median / longest", "", _longest(done, "cpu_seconds", "s")),
        ("memory of the process: median / largest", "≤ 1 GiB", _longest(done, "memory_mib", "MiB")),
    ]
    heads = ("", "goal", "reached", "reachable")
    return [dict(itertools.zip_longest(heads, line, fillvalue="")) for line in lines]


def coverage(rows: Sequence[Row]) -> str:
    """How often the stated interval holds what the same predictions gain on average over noise."""
    stated = [row["improvement"] for row in rows if row["improvement"] is not None]
    if not stated:
        return "–"
    return proportion(sum(one["low"] <= one["expected"] <= one["high"] for one in stated), len(stated))


def _longest(rows: Sequence[Row], key: str, unit: str) -> str:
    values = [row[key] for row in rows]
    return f"{np.median(values):.1f} / {max(values):.1f} {unit}" if values else "–"


# --- tables --------------------------------------------------------------------------------------------------------------------


def by_strength(rows: Sequence[Row]) -> list[dict[str, str]]:
    """One effect in octaves of strength."""
    lines = []
    for low, high in itertools.pairwise(STRENGTHS):
        chosen = [row for row in rows if low <= row["strengths"][0] < high]
        if chosen:
            lines.append({"strength": f"{low:g} to {high:.3g}", **_columns(chosen)})
    return lines


def _columns(rows: Sequence[Row]) -> dict[str, str]:
    overlaps = [row["overlap"] for row in rows if row.get("overlap") is not None]
    return {
        "detected": share(rows, lambda row: row["verdict"] != "none"),
        "exact set": share(rows, exact),
        "reachable": reachable(rows),
        "in class": share(rows, lambda row: row["in_class"]),
        "held-out error / oracle": error(rows),
        "where: overlap": f"{np.median(overlaps):.2f}" if overlaps else "–",
    }


def by_period(rows: Sequence[Row]) -> list[dict[str, str]]:
    """One effect by how fast it is all over."""
    return [
        {"period": f"{low:g} to {high:g} s", **_columns(chosen)}
        for low, high in itertools.pairwise(PERIODS_S)
        if (chosen := [row for row in rows if low <= row.get("period_s", math.nan) < high])
    ]


def by_cause(rows: Sequence[Row]) -> list[dict[str, str]]:
    return [
        {"cause": name or "healthy", **_columns(chosen)}
        for name in dict.fromkeys((row["hidden"] or [""])[0] for row in rows)
        if (chosen := [row for row in rows if (row["hidden"] or [""])[0] == name])
    ]


def by_form(rows: Sequence[Row]) -> list[dict[str, str]]:
    """Exact sets by what was drawn, phases and counts aside."""
    forms = sorted({(row["hidden"][0], row["forms"][0]) for row in rows if row.get("forms")})
    return [
        {"cause": name, "form": form, "exact set": share(chosen, exact), "held-out error / oracle": error(chosen)}
        for name, form in forms
        if (chosen := [row for row in rows if row["hidden"] == [name] and row.get("forms") == [form]])
    ]


def by_kind(rows: Sequence[Row]) -> list[dict[str, str]]:
    several = [
        {"cases": kind, **_columns(chosen), "fault recognised": "–"}
        for kind in ("pair", "triple", "unequal")
        if (chosen := [row for row in rows if row["kind"] == kind])
    ]
    faulty = [
        {"cases": f"effect + {nuisance}", **_columns(chosen), "fault recognised": share(chosen, lambda row: row["nuisance_found"])}
        for nuisance in NUISANCES
        if (chosen := [row for row in rows if row["nuisance"] == nuisance])
    ]
    return several + faulty


def null(rows: Sequence[Row]) -> list[dict[str, str]]:
    """Calibration of the null: p-values and verdicts of healthy gyros."""
    p_values = np.array([row["p_value"] for row in rows])
    below = {f"p < {level:g}": proportion(int(np.sum(p_values < level)), len(rows)) for level in (0.5, 0.1, 0.05, 0.01)}
    verdicts = ", ".join(f"{verdict} {count}" for verdict, count in Counter(row["verdict"] for row in rows).most_common())
    return [{"cases": str(len(rows)), **below, "KS p": f"{stats.kstest(p_values, 'uniform').pvalue:.3f}", "verdicts": verdicts}]


def by_law(rows: Sequence[Row]) -> list[dict[str, str]]:
    return [
        {
            "law": f"{name}, driver not recorded" if kind == "unrecorded" else name,
            "detected": share(chosen, lambda row: row["verdict"] != "none"),
            "unknown": share(chosen, lambda row: row["verdict"] == "unknown"),
            "no name": share(chosen, lambda row: not row["findings"]),
            "right drivers": share(chosen, lambda row: row["drivers"] == row["true_drivers"]),
            "right memory": "–" if kind == "unrecorded" else share(chosen, lambda row: row["memory"] == row["true_memory"]),
            "held-out error / oracle": "–" if kind == "unrecorded" else error(chosen),
        }
        for kind, name in dict.fromkeys((row["kind"], row["hidden"][0]) for row in rows)
        if (chosen := [row for row in rows if (row["kind"], row["hidden"][0]) == (kind, name)])
    ]


def confusion(rows: Sequence[Row]) -> list[dict[str, str]]:
    """How often each set was the answer to each effect."""
    present = [name for name in CATALOGUED if any(row["hidden"] == [name] for row in rows)]
    answers = {name: Counter(_answer(row) for row in rows if row["hidden"] == [name]) for name in present}
    columns = [name for name in (*CATALOGUED, "none", "unknown", "several", "failed") if any(a[name] for a in answers.values())]
    return [{"": name, **{column: str(counted[column] or "·") for column in columns}} for name, counted in answers.items()]


def _answer(row: Row) -> str:
    if "failure" in row:
        return "failed"
    if row["verdict"] in ("none", "unknown") and not row["findings"]:
        return str(row["verdict"])
    return str(row["findings"][0]) if len(row["findings"]) == 1 else "several"


# --- reliability ---------------------------------------------------------------------------------------------------------------


def statements(rows: Sequence[Row]) -> list[tuple[float, bool, str]]:
    """Probability, whether it is so, and "set" or "cause", of all that is stated of what is missing."""
    found = []
    for row in rows:
        hidden = row["hidden"] if row["kind"] in NAMED else []
        if row["set_probability"] is not None and (row["findings"] or row["kind"] in (*NAMED, "healthy")):
            found.append((float(row["set_probability"]), sorted(row["findings"]) == sorted(hidden), "set"))
        found += [
            (float(probability), name in hidden, "cause")
            for name, probability in zip(row["findings"], row["probabilities"], strict=True)
        ]
    return found


def reliability(stated: Sequence[tuple[float, bool, str]]) -> list[dict[str, str]]:
    """Stated probability against frequency, in bins, and the Brier score."""
    lines = []
    for of in ("set", "cause"):
        chosen = [(probability, is_so) for probability, is_so, what in stated if what == of]
        for low, high in itertools.pairwise(PROBABILITIES):
            inside = [(probability, is_so) for probability, is_so in chosen if low <= probability < high]
            if inside:
                lines.append(
                    {
                        "of": of,
                        "probability": f"{low:g} to {min(high, 1.0):g}",
                        "stated": str(len(inside)),
                        "mean": f"{100 * np.mean([p for p, _ in inside]):.1f} %",
                        "so": proportion(sum(is_so for _, is_so in inside), len(inside)),
                    }
                )
        brier = float(np.mean([(probability - is_so) ** 2 for probability, is_so in chosen])) if chosen else math.nan
        lines.append({"of": of, "probability": "all", "stated": str(len(chosen)), "mean": "", "so": f"Brier score {brier:.3f}"})
    return lines


def certain_and_wrong(rows: Sequence[Row]) -> list[str]:
    """The cases of which something is stated with certainty that is not so."""
    return [miss(row) for row in rows if any(p >= CERTAIN and not is_so for p, is_so, _ in statements([row]))]


# --- lines ---------------------------------------------------------------------------------------------------------------------


def mark(row: Row) -> str:
    """One line as a case finishes."""
    if "failure" in row:
        return f"failed {row['key']}: {row['failure']}"
    return f"{'right' if right(row) else 'WRONG'} {row['seconds']:5.1f} s  {miss(row)}"


def miss(row: Row) -> str:
    """One line on a case."""
    named = ", ".join(f"{name} {p:.3g}" for name, p in zip(row["findings"], row["probabilities"], strict=True)) or "nothing named"
    forms = f" ({'; '.join(row['forms'])})" if row["forms"] else ""
    line = (
        f"{row['name']}{forms}: {row['verdict']}, {named}, p = {row['p_value']:.2g}, log Bayes factor {row['log_bayes_factor']:.0f}"
    )
    if row["kind"] == "outside":
        line += f"; drivers {row['drivers']} for {row['true_drivers']}, {row['memory']} for {row['true_memory']}"
    if row["nuisance"]:
        line += f"; {row['nuisance']} {'' if row['nuisance_found'] else 'not '}recognised"
    return line
