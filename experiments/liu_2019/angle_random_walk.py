"""Section 5 of Liu et al. (2019): angle random walk under rotation. Tables 5 and 6, figures 8 to 13, equations 1, 14 and 15."""

from __future__ import annotations

import argparse

import numpy as np
import pandas as pd

from experiments.liu_2019.earlier_methods import classic_variance_deg_sqrt_h, each_from_differences, fast_orthogonal_search
from experiments.liu_2019.harmonic_failures import failure_row
from experiments.liu_2019.rotation_table import (
    LIU_DELAY_S,
    LIU_ORDERS,
    LIU_PULSE_ARCSEC,
    RotatingGyro,
    RotationTable,
    liu_harmonics,
    simulate_rotation,
)
from experiments.tables import published, show_frame
from experiments.work import Work
from rlgcomp.noise.allan_deviation import allan_deviation
from rlgcomp.noise.angle_random_walk import angle_random_walk
from rlgcomp.noise.constant_rate_segment import AngleRandomWalk
from rlgcomp.noise.encoder import find_legs, table_angle_deg
from rlgcomp.noise.processes import NoiseModel
from rlgcomp.recording import Recording

STEADY = RotationTable(jitter_deg_s=0.0)
WANDERING = RotationTable(wander_deg_s=3e-4)


def gyro(noise_deg_sqrt_h: float, seed: int) -> RotatingGyro:
    """A gyro with the paper's ten orders."""
    return RotatingGyro(NoiseModel(angle_random_walk_deg_sqrt_h=noise_deg_sqrt_h), liu_harmonics(seed))


def recording(
    noise_deg_sqrt_h: float, rate_deg_s: float, seed: int, hours: float, pulse_arcsec: float | None, table: RotationTable
) -> Recording:
    """One gyro at constant rate."""
    legs = ((rate_deg_s, 3600.0 * hours),)
    return simulate_rotation({"z": gyro(noise_deg_sqrt_h, seed)}, legs, seed=seed, pulse_arcsec=pulse_arcsec, table=table)


def accuracy(
    work: Work, noise: float, rate: float, hours: float, pulse: float | None, table: RotationTable, seeds: int
) -> dict[str, object]:
    """Estimates over the seeds relative to the truth: mean, spread, and the errors against their stated standard deviations."""

    def one(seed: int) -> list[float]:
        (found,) = angle_random_walk(recording(noise, rate, seed, hours, pulse, table)).gyros
        parts = (found.noise, found.whole_revolutions, found.coefficients)
        values = [(part.angle_random_walk_deg_sqrt_h / noise, part.angle_random_walk_deg_sqrt_h_sd / noise) for part in parts]
        return [*np.ravel(values).tolist(), found.agreement_p_value]

    name = f"N at {(noise, rate, hours, pulse, table)}, "
    made = np.array(work.results(name, one, [(seed,) for seed in range(seeds)]), dtype=float)
    row: dict[str, object] = {}
    for k, name in enumerate(("spectrum", "whole revolutions", "five terms")):
        value, sd = made[:, 2 * k], made[:, 2 * k + 1]
        row[name] = f"{value.mean():.4f} ± {value.std(ddof=1):.4f}"
        row[f"sd, {name}"] = f"{sd.mean():.4f}"
        row[f"rms(error/sd), {name}"] = f"{np.sqrt(np.mean(((value - 1.0) / sd) ** 2)):.2f}"
        if not k:
            row["worst"] = f"{np.abs(value - 1.0).max():.4f}"
    row["disagree (p < 0.05)"] = f"{int((made[:, 6] < 0.05).sum())} of {seeds}"
    return row


def accuracies(hours: float, seeds: int, work: Work) -> pd.DataFrame:
    """N over truth at both rates and in both modes, and with what spoils it: pulses, a wandering table."""
    cases = [
        (f"{mode}, {rate:.0f} deg/s", (noise, rate, hours, None, STEADY, seeds))
        for mode, noise in (("rate-biased .0004", 4e-4), ("dithered .0013", 1.3e-3))
        for rate in (60.0, 30.0)
    ]
    cases += [
        ("servo jitter 0.0003 deg/s, .0004, 60 deg/s", (4e-4, 60.0, hours, None, RotationTable(), seeds)),
        ("pulse 0.84″, .0004, 60 deg/s", (4e-4, 60.0, hours, LIU_PULSE_ARCSEC, RotationTable(), seeds)),
        ("pulse 0.84″, .0004, 30 deg/s", (4e-4, 30.0, hours, LIU_PULSE_ARCSEC, RotationTable(), seeds)),
        ("pulse 0.84″, .0013, 60 deg/s", (1.3e-3, 60.0, hours, LIU_PULSE_ARCSEC, RotationTable(), seeds)),
        ("speed wanders 0.0003 deg/s over 100 s, .0004", (4e-4, 60.0, hours, None, WANDERING, seeds)),
        ("speed wanders 0.0003 deg/s over 100 s, .0013", (1.3e-3, 60.0, hours, None, WANDERING, seeds)),
    ]
    return pd.DataFrame({name: accuracy(work, *arguments) for name, arguments in cases}).T


def published_tables(hours: float, runs: int, work: Work) -> pd.DataFrame:
    """Tables 5 and 6 run by run: published, and ours from gyros whose true N is the published mean."""

    def one(table: str, truth: dict[str, float], rate: int, run: int) -> list[dict[str, object]]:
        seed = 1000 * rate + run + (500 if table.endswith("6") else 0)
        gyros = {axis: gyro(noise, seed + k) for k, (axis, noise) in enumerate(truth.items())}
        made = simulate_rotation(gyros, ((0.0, 20.0), (float(rate), 3600.0 * hours)), seed=seed)
        return [
            {
                "table": table,
                "run": run,
                "gyro": f"g{axis}",
                "rate": rate,
                "truth": truth[axis],
                "ours": found.angle_random_walk_deg_sqrt_h,
                "sd": found.angle_random_walk_deg_sqrt_h_sd,
            }
            for axis, found in zip(truth, angle_random_walk(made).gyros, strict=True)
        ]

    pieces, printed = [], {}
    for name in ("liu_table5", "liu_table6"):
        table = published(name).set_index("run")
        single = table.loc[[str(run) for run in range(1, 4)]].astype(float)
        truth = {axis: float(single[[f"g{axis}_30dps", f"g{axis}_60dps"]].to_numpy().mean()) for axis in "xyz"}
        for run in range(1, runs + 1):
            for rate in (30, 60):
                pieces.append((name, truth, rate, run))
                printed |= {(name, run, f"g{axis}", rate): float(single.loc[str(run), f"g{axis}_{rate}dps"]) for axis in "xyz"}
    rows = [row for part in work.results(f"published, {hours} h, ", one, pieces) for row in part]
    frame = pd.DataFrame(rows)
    frame.insert(4, "published", [printed[row["table"], row["run"], row["gyro"], row["rate"]] for row in rows])
    return frame


def baselines(hours: float, seeds: int, work: Work) -> pd.DataFrame:
    """N over truth on a jittering table: ours, fast orthogonal search on differences of three gyros, classic variance."""
    truth = {"x": 4e-4, "y": 3.6e-4, "z": 4.2e-4}

    def one(seed: int) -> dict[str, float]:
        made = simulate_rotation(
            {axis: gyro(n, 10 * seed + k) for k, (axis, n) in enumerate(truth.items())}, ((60.0, 3600 * hours),), seed=seed
        )
        found = angle_random_walk(made).gyros
        rates = [_means(made, column, 10) for column in made.gyro_columns]
        turn_hz = abs(find_legs(made.time_s, table_angle_deg(made))[0].rate_deg_s) / 360.0
        candidates = turn_hz * np.arange(1, 59)  # below half of 20 Hz
        n = {}
        for a, b in ((0, 1), (0, 2), (1, 2)):
            left = fast_orthogonal_search(rates[a] - rates[b], 0.05, candidates).residual
            seconds = left[: len(left) // 20 * 20].reshape(-1, 20).mean(axis=1)
            curve = allan_deviation(seconds, np.arange(float(len(seconds))), [1.0])
            n[a, b] = float(curve.deviation_deg_h[0]) / 60.0
        hat = each_from_differences(n[0, 1], n[0, 2], n[1, 2])
        after = found[0].means["after_deg_h"].to_numpy()
        classic, _ = classic_variance_deg_sqrt_h(after, 1.0, np.geomspace(1.0, min(1000.0, len(after) / 12), 20))
        return {
            "spectrum": found[0].angle_random_walk_deg_sqrt_h / truth["x"],
            "fast orthogonal search, three differences": hat[0] / truth["x"],
            "(N1 + N2) / 2 over N of the difference": 0.5 * (truth["x"] + truth["y"]) / n[0, 1],
            "sqrt(N1² + N2²) over N of the difference": float(np.hypot(truth["x"], truth["y"])) / n[0, 1],
            "classic variance, third order": classic / truth["x"],
        }

    table = pd.DataFrame(work.results(f"baselines, {hours} h, ", one, [(seed,) for seed in range(seeds)]))
    return pd.DataFrame({"mean": table.mean(), "spread": table.std()})


def delays(seeds: int, work: Work) -> pd.DataFrame:
    """Encoder delay from a start-up, from two rates in one run, and from the phases at two rates in two runs, in ms."""

    def one(seed: int) -> dict[str, tuple[float, float]]:
        def made(legs: tuple[tuple[float, float], ...]) -> Recording:
            return simulate_rotation({"z": gyro(4e-4, seed)}, legs, seed=seed)

        found = {
            "start-up": angle_random_walk(made(((0.0, 30.0), (60.0, 1200.0)))),
            "60 and 30 deg/s in one run": angle_random_walk(made(((60.0, 1200.0), (30.0, 1800.0)))),
            "60 and 30 deg/s in two runs": angle_random_walk([made(((60.0, 1800.0),)), made(((30.0, 1800.0),))]),
        }
        return {name: (result.delay.delay_s, result.delay.sd_s) for name, result in found.items() if result.delay is not None}

    every = work.results("delay", one, [(seed,) for seed in range(seeds)])
    rows = {}
    for name in every[0]:
        value, sd = 1e3 * np.array([found[name] for found in every]).T
        rows[name] = {
            "delay, ms": f"{value.mean():.5f} ± {value.std(ddof=1):.5f}",
            "stated sd, ms": f"{sd.mean():.5f}",
            "truth, ms": f"{1e3 * LIU_DELAY_S:.5f}",
            "rms(error/sd)": f"{np.sqrt(np.mean(((value - 1e3 * LIU_DELAY_S) / sd) ** 2)):.2f}",
        }
    return pd.DataFrame(rows).T


def _means(made: Recording, column: str, rows: int) -> np.ndarray:
    rate = made.rate_deg_h(column)
    means = rate[: len(rate) // rows * rows].reshape(-1, rows).mean(axis=1)
    x = np.linspace(-1.0, 1.0, len(means))
    return means - np.polynomial.legendre.Legendre.fit(x, means, 5)(x)


def failures(hours: float, seeds: int, work: Work) -> pd.DataFrame:
    """The table of failure modes of seed-mathematics.md, section 2: N over truth by treatment and by fit."""
    cases: list[tuple[str, dict[str, object]]] = [
        ("global fit, 60 deg/s", {}),
        ("fits of 20 revolutions, 60 deg/s", {"treatment": "20 revolutions"}),
        ("fits in every revolution, 60 deg/s", {"treatment": "1 revolution"}),
        ("fits in every revolution, 30 deg/s", {"treatment": "1 revolution", "rate": 30.0}),
        ("no harmonic removal", {"treatment": "none"}),
        ("reshaped by 1200 samples, speed off by 1.7e-5", {"treatment": "reshaped"}),
        ("reshaped by 1200 samples, speed off by 1e-4", {"treatment": "reshaped", "speed_offset": 1e-4}),
        ("global fit, speed off by 1e-4", {"speed_offset": 1e-4}),
        ("pulse 0.01″", {"pulse": 0.01}),
        ("pulse 0.1″", {"pulse": 0.1}),
        ("pulse 0.8428″", {"pulse": LIU_PULSE_ARCSEC}),
        ("dithered .0013", {"noise": 1.3e-3}),
        ("dithered .0013, pulse 0.8428″", {"noise": 1.3e-3, "pulse": LIU_PULSE_ARCSEC}),
    ]

    def one(seed: int, choice: dict[str, object]) -> dict[str, float]:
        noise = float(choice.get("noise", 4e-4))  # type: ignore[arg-type]
        table = RotationTable(jitter_deg_s=0.0, speed_offset=float(choice.get("speed_offset", 1.7e-5)))  # type: ignore[arg-type]
        made = recording(noise, float(choice.get("rate", 60.0)), seed, hours, choice.get("pulse"), table)  # type: ignore[arg-type]
        return {name: n / noise for name, n in failure_row(made, str(choice.get("treatment", "global"))).items()}

    rows = {}
    for name, choice in cases:
        made = pd.DataFrame(work.results(f"failures, {hours} h, ", one, [(seed, choice) for seed in range(seeds)]))
        rows[name] = {column: f"{made[column].mean():.3f} ± {made[column].std():.3f}" for column in made}
    return pd.DataFrame(rows).T


def figures(hours: float) -> None:
    """What figures 8 to 13 show, in numbers."""
    made = simulate_rotation({"z": gyro(4e-4, 1)}, ((0.0, 20.0), (60.0, 3600.0 * hours)), seed=1)
    result = angle_random_walk(made)
    one: AngleRandomWalk = result.gyros[0]
    delay = result.delay
    means = one.means
    fit = one.harmonics.to_frame().set_index("order")
    truth = {k: a * np.sinc(k * 60.0 * 0.005 / 360.0) for k, a in liu_harmonics(1).items()}  # its mean over a sample
    put_in = 0.3 * -np.expm1(-hours * 3600.0 / 5400.0)
    rows: dict[str, dict[str, object]] = {
        "fig. 9: lag of the encoder at 60 deg/s, deg": {
            "published": "0.0317",
            "ours": "none" if delay is None else f"{60 * delay.delay_s:.5f} ± {60 * delay.sd_s:.5f}",
        },
        "fig. 10: orders that repeat": {"published": " ".join(map(str, LIU_ORDERS)), "ours": " ".join(map(str, fit.index))},
        "fig. 10: worst amplitude less truth, deg/h (its sd)": {
            "published": "",
            "ours": max(
                (
                    abs(fit["amplitude_deg_h"][k] - truth[k]),
                    f"{fit['amplitude_deg_h'][k] - truth[k]:.5f} ({fit['amplitude_sd_deg_h'][k]:.5f})",
                )
                for k in fit.index
                if k in truth
            )[1],
        },
        "fig. 11: trend over the run, deg/h": {
            "published": "picture",
            "ours": f"{np.ptp(means['trend_deg_h']):.3f} (put in: {put_in:.3f})",
        },
        "fig. 12: std of 1 s means before and after, deg/h": {
            "published": "picture",
            "ours": f"{(means['before_deg_h'] + means['trend_deg_h']).std():.4f}, {means['after_deg_h'].std():.4f} (60 N = 0.024)",
        },
    }
    for tau in (1.0, 10.0, 100.0, 1000.0):
        if tau <= one.after.tau_s[-1]:
            rows[f"fig. 13: root Allan variance at {tau:g} s, deg/h"] = {
                "published": "picture",
                "ours": f"{one.after.at(tau):.5f} (60 N/√τ = {0.024 / np.sqrt(tau):.5f})",
            }
    show_frame("Figures 8 to 13 (simulated at N = 0.0004, 60 deg/s)", pd.DataFrame(rows).T)
    print("Figure 8 is the flow; ours is rlgcomp.angle_random_walk. The pictures themselves: rlgcomp arw RUN --out DIR.\n")


def equations() -> None:
    """Equations 1, 14, 15 and 17 with their slips."""
    print("## Equations and printed slips\n")
    n1, n2 = 3e-4, 4e-4
    print(f"- eq. 14: 0.0317° / 60 °/s = {1e3 * 0.0317 / 60.0:.5f} ms (printed 0.5283)")
    print(
        f"- eq. 1: N of a difference is √(N₁² + N₂²), as {np.hypot(n1, n2):.1e} of {n1:.0e} and {n2:.0e}; "
        f"not their mean {0.5 * (n1 + n2):.1e}"
    )
    print("- eq. 15: R'(k) = R(k)(1 − Δt/5) + R(k+1)Δt/5 (lost minus restored) holds for a lagging encoder, which theirs is")
    print("- eq. 17/18: σ² = R²τ²/2 + K²τ/3 + (2 ln 2/π)B² + N²/τ + 3Q²/τ²: five terms, not a polynomial of fifth order")
    for name in ("liu_table5", "liu_table6"):
        table = published(name).set_index("run").astype(float)
        for column in table:
            mean, printed = table[column].iloc[:3].mean(), table[column].iloc[3]
            if abs(mean - printed) > (5.1e-6 if name.endswith("5") else 5.1e-5):
                print(f"- table {name[-1]}, {column}: mean of the three runs {mean:.6f}, printed {printed:g}")
    print()


def show(quick: bool, work: Work | None = None) -> None:
    """Print everything; `quick` takes half an hour instead of five hours, and fewer seeds."""
    work = work or Work()
    hours, seeds, few = (0.5, 3, 2) if quick else (5.0, 8, 4)
    print(f"## Section 5: angle random walk under rotation, {hours:g} h a run\n")
    equations()
    figures(hours)
    table = published_tables(hours, 1 if quick else 3, work)
    show_frame(
        "Tables 5 and 6: published, and ours on gyros whose true N is the published mean",
        table.drop(columns=["table", "run"]).set_index(table["table"] + ", run " + table["run"].astype(str)),
    )
    show_frame(f"N over truth, {seeds} seeds (Cramér–Rao of 5 h of 1 s means: 0.0053)", accuracies(hours, seeds, work))
    show_frame(f"Encoder delay, {seeds} seeds", delays(seeds, work))
    show_frame(f"Baselines, N over truth, {few} seeds", baselines(min(hours, 1.0), few, work))
    show_frame(f"What goes wrong, N over truth, {few} seeds", failures(hours, few, work))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="half an hour a run, fewer seeds")
    Work.add_options(parser, "liu_2019_angle_random_walk")
    options = parser.parse_args()
    show(options.quick, Work.of(options))
