"""Diagnosis on one model: what it names, and that the answer does not depend on units or habits."""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd
import pytest
from scipy import signal
from scipy.stats import norm

from rlgcomp.diagnosis import priors
from rlgcomp.diagnosis.answer.fit import Fit
from rlgcomp.diagnosis.data import Data, Grid, Run
from rlgcomp.diagnosis.diagnose import Diagnosis, diagnose
from rlgcomp.diagnosis.evidence.bank import Bank
from rlgcomp.diagnosis.evidence.closed_form import Evidence, Member
from rlgcomp.diagnosis.evidence.screen import Layout, Screen
from rlgcomp.diagnosis.evidence.variants import gains, gains_of_moves
from rlgcomp.diagnosis.forms.bases import Basis, Power, Product, Smooth
from rlgcomp.diagnosis.forms.drivers import Driver, Path, lagged
from rlgcomp.diagnosis.forms.memories import Plays, Preisach, Relays, relays
from rlgcomp.diagnosis.forms.terms import Form
from rlgcomp.diagnosis.noise.model import Noise, Whitened, relaxation, smooth_relaxation
from rlgcomp.diagnosis.regions.baseline import Baseline
from rlgcomp.diagnosis.regions.setting import Setting
from rlgcomp.diagnosis.search.process import Process, slow_columns
from rlgcomp.diagnosis.search.states import State
from rlgcomp.diagnosis.search.telegraph import telegraph, two_state
from rlgcomp.recording import Recording
from rlgcomp.simulation.simulator import Simulator
from tests.few_monitors import FEWER, few_monitors

Array = npt.NDArray[np.float64]

PROGRAMMES = (
    "start 20, hold 40, ramp -30 1, hold 60, ramp 50 1.2, hold 40, ramp 10 0.8, hold 40, ramp 35 1, hold 30",
    "start 25, hold 30, ramp 55 0.9, hold 60, ramp -20 1.1, hold 50, ramp 30 0.7, hold 30, ramp 0 1, hold 30",
)
BASELINE: dict[str, Any] = {"kind": "chamber", "mechanisms": [{"thermal_polynomial": {"degree": 3}}]}
NOISE = {"angle_random_walk_deg_sqrt_h": 0.0005}


def made(*missing: str | dict[str, Any], seed: int = 3) -> list[Recording]:
    """Runs of a gyro with what the simulator of the tests lacks."""
    real = {"kind": "chamber", "mechanisms": ["thermal_polynomial", *missing], "noise": NOISE}
    simulator = Simulator.from_mapping(real)
    return [simulator.simulate(p, seed=seed + k, step_s=10.0, name=f"run{k}") for k, p in enumerate(PROGRAMMES)]


def asked(runs: Sequence[Recording], **fewer: Any) -> Diagnosis:
    """On windows four times as long as by default: a quarter as many take half of the time."""
    return diagnose(Simulator.from_mapping(BASELINE), runs, window_s=4.0 * Grid.of(runs).window_s, black_box=False, **fewer)


def mechanisms(diagnosis: Diagnosis) -> list[str]:
    return sorted(finding["mechanism"] for finding in diagnosis.to_mapping()["findings"])


HYSTERESIS = {"thermal_hysteresis": {"law": "plays", "k1_deg_h_K": 2e-3, "radius_K": 8.0}}
CASES: list[tuple[tuple[str | dict[str, Any], ...], list[str]]] = [
    ((), []),
    (({"mode_hop": {"step_deg_h": 0.01, "threshold_degC": 22.0}},), ["mode_hop"]),
    (({"thermal_lag": {"k_deg_h_K": 2e-3, "time_constant_s": 1500.0}},), ["thermal_lag"]),
    (({"warm_up": {"initial_deg_h": 0.02, "time_constant_s": 2000.0}},), ["warm_up"]),
    (({"random_telegraph": {"half_step_deg_h": 0.01, "dwell_s": 2500.0}},), ["random_telegraph"]),
    (({"periodic_interference": {"frequency_hz": 1.0 / 1300.0}},), ["periodic_interference"]),
    (({"magnetic_field": {"k_deg_h_uT": 0.002}}, {"discharge_imbalance": {}}), ["discharge_imbalance", "magnetic_field"]),
]


@pytest.mark.parametrize(("missing", "expected"), CASES, ids=lambda value: "+".join(map(str, value))[:40] or "none")
def test_names_what_is_missing(missing: tuple[str | dict[str, Any], ...], expected: list[str]) -> None:
    """Among all monitors where nothing is missing or two effects are, one of them of an idle monitor."""
    runs, several = made(*missing), len(expected) > 1
    found = asked([few_monitors(run) for run in runs] if len(expected) == 1 else runs, **(FEWER if several else {}))
    assert mechanisms(found) == expected
    assert found.verdict in (("explained", "ambiguous") if expected else ("none",))


def test_heating_and_cooling_by_a_coefficient_each_are_the_rate_and_its_asymmetry() -> None:
    """As the catalogue has it; by heating alone it is one asymmetric response."""
    of_rate, of_magnitude = ("temperature_rate", "rate_asymmetry")
    few: dict[str, Any] = {"only": [of_rate, of_magnitude], "window_s": 4.0 * Grid.of(made()).window_s, "black_box": False}
    for k_deg_h_min_K, names in ((0.008, [of_magnitude, of_rate]), (0.004, [of_magnitude])):
        missing = ({of_rate: {"k_deg_h_min_K": k_deg_h_min_K}}, {of_magnitude: {"k_deg_h_min_K": 0.004}})
        runs = [few_monitors(run) for run in made(*missing)]
        assert mechanisms(diagnose(Simulator.from_mapping(BASELINE), runs, **few)) == names


def test_amplitudes_that_a_form_has_no_part_of_are_not_stated() -> None:
    """One play is the third of the catalogue's three, whose radius the mechanism has; the other two are not stated."""
    hysteresis = {"k1_deg_h_K": 0.0, "k2_deg_h_K": 0.0, "k3_deg_h_K": 2e-3, "radius_K": 8.0}
    runs = [few_monitors(run) for run in made({"thermal_hysteresis": hysteresis})]
    few: dict[str, Any] = {"only": ["thermal_hysteresis"], "window_s": 4.0 * Grid.of(runs).window_s, "black_box": False}
    (cause,) = diagnose(Simulator.from_mapping(BASELINE), runs, **few).causes
    assert set(cause.parameters) == {"k3_deg_h_K", "radius_K"}
    for name, true in (("k3_deg_h_K", 2e-3), ("radius_K", 8.0)):
        assert abs(cause.parameters[name].value - true) < 4.0 * cause.parameters[name].sd


def test_mapping_has_the_keys_of_the_contract() -> None:
    runs = [few_monitors(run, "magnetic_field_uT") for run in made({"supply_voltage": {"k_deg_h_V": 0.5}})]
    few: dict[str, Any] = {
        "only": ["supply_voltage", "magnetic_field"],
        "window_s": 3.0 * Grid.of(runs).window_s,
        "black_box": False,
    }
    content = diagnose(Simulator.from_mapping(BASELINE), runs[:1], runs[1:], **few).to_mapping()
    assert {"schema", "verdict", "mismatch", "findings", "alternatives", "unexplained", "fit", "next_experiment"} <= set(content)
    (finding,) = content["findings"]
    estimate = finding["parameters"]["k_deg_h_V"]
    assert estimate["unit"] == "deg/h/V"
    assert abs(estimate["value"] - 0.5) < 4.0 * estimate["sd"]
    test = content["fit"]["test"]
    assert test["augmented_rms"] < 0.7 * test["baseline_rms"]
    assert test["improvement_ci95"][0] < test["improvement"] < test["improvement_ci95"][1]


# --- invariance ----------------------------------------------------------------------------------------------------------------


def with_table(runs: Sequence[Recording], change: Callable[[pd.DataFrame], pd.DataFrame]) -> list[Recording]:
    return [run.replace(table=change(run.table), truth=None) for run in runs]


def irrelevant(table: pd.DataFrame) -> pd.DataFrame:
    rng = np.random.default_rng(len(table))
    return table.assign(humidity_percent=40.0 + 0.01 * np.cumsum(rng.standard_normal(len(table))))


def otherwise(table: pd.DataFrame) -> pd.DataFrame:
    """Time stretched, the output 1e5 times as loud, a constant added to a monitor, columns in another order."""
    other = table.assign(
        time_s=1000.0 * table["time_s"],
        gyro_deg_h=1e5 * table["gyro_deg_h"],
        supply_voltage_V=table["supply_voltage_V"] + 7.0,
    )
    return other[["time_s", *sorted(set(table.columns) - {"time_s"})]]


@pytest.fixture(scope="module")
def hysteretic() -> list[Recording]:
    return [few_monitors(run) for run in made(HYSTERESIS)]


@pytest.fixture(scope="module")
def plain(hysteretic: list[Recording]) -> Diagnosis:
    return asked(hysteretic)


def test_names_hysteresis(plain: Diagnosis) -> None:
    assert mechanisms(plain) == ["thermal_hysteresis"]
    assert plain.verdict in ("explained", "ambiguous")


def test_answer_does_not_depend_on_habits(hysteretic: list[Recording], plain: Diagnosis) -> None:
    """All changes in one diagnosis, no two of which can undo each other: the order of runs, and a column that says nothing."""
    changed = asked(with_table(with_table(hysteretic, otherwise), irrelevant)[::-1])
    assert (changed.verdict, mechanisms(changed)) == (plain.verdict, mechanisms(plain))
    one, other = (found.posterior.of_region("thermal_hysteresis") for found in (plain, changed))
    assert other == pytest.approx(one, abs=0.05)


# --- parts ---------------------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def data() -> Data:
    runs = made()
    grid = Grid.of(runs)
    return Data(tuple(Run.of(run, grid, lambda binned: binned.rate_deg_h()) for run in runs))


def test_windows_follow_from_the_runs(data: Data) -> None:
    assert 200 < max(len(run.output) for run in data.runs) <= 400
    for run in data.runs:
        assert np.allclose(
            run.means(run.column("temperature_block_degC"))[5],
            run.column("temperature_block_degC")[5 * run.grid.bins :][: run.grid.bins].mean(),
        )


def test_a_relay_switches_between_the_middles_of_bins() -> None:
    states = relays(np.array([0.0, 1.0, 2.0, 1.0, 0.0]), np.array([1.25]), np.array([0.75]), "rested")
    assert states[:, 0] == pytest.approx([0.0, 0.25, 1.0, 0.75, 0.0])


def test_a_lag_approaches_a_step() -> None:
    values = np.r_[0.0, np.ones(50)]
    assert lagged(values, 1.0, 5.0)[-1] == pytest.approx(1.0, abs=1e-3)
    ramp = np.arange(200.0)
    assert (ramp - lagged(ramp, 1.0, 5.0))[-1] == pytest.approx(5.0)


@pytest.mark.parametrize(
    ("averaged", "correlation"), [(relaxation, lambda u: np.exp(-u)), (smooth_relaxation, lambda u: (1.0 + u) * np.exp(-u))]
)
@pytest.mark.parametrize("windows", [1.0, 3.0, 40.0])
def test_relaxation_is_averaged_over_windows(
    averaged: Callable[[int, float], Array], correlation: Callable[[Array], Array], windows: float
) -> None:
    fine = 200
    lags = np.arange(4 * fine) / fine
    exact = correlation(np.abs(lags[:, None] - lags) / windows)
    means = exact.reshape(4, fine, 4, fine).mean(axis=(1, 3))
    assert averaged(4, windows) == pytest.approx(means[0], rel=1e-3)


def test_what_has_passed_through_two_relaxations_wanders_smoothly() -> None:
    """Autocorrelation of noise behind two first-order lags, of samples."""
    time, steps = 20.0, 400_000
    pole = np.exp(-1.0 / time)
    white = np.random.default_rng(1).standard_normal(steps)
    slow = signal.lfilter([1.0], [1.0, -2.0 * pole, pole**2], white)[2000:]
    found = [float(np.mean(slow[k:] * slow[: len(slow) - k])) for k in (0, 10, 20, 40)]
    assert np.array(found) / found[0] == pytest.approx(smooth_relaxation(41, time)[[0, 10, 20, 40]], abs=0.03)


def test_a_form_of_which_departures_hold_nearly_all_is_charged_for_it(data: Data) -> None:
    """A product of two columns with a square of each beside it: of the product nothing is taken, of the squares alone a lot."""
    one, other = (Path(Driver.of(data, column)) for column in ("supply_voltage_V", "magnetic_field_uT"))
    form = Form("product", "b = k u v", (Product(one, other),), (Power(one, 2), Power(other, 2)))
    plain = dataclasses.replace(form, smooth=())
    member = Member(form, 40.0)
    noise = np.random.default_rng(6).standard_normal(len(data)) * np.sqrt(data.white)

    def charge(basis: Basis, size: float, used: Form = form) -> float:
        column = data.means(basis.columns)[:, -1]
        signal = size * column / column.std() * np.sqrt(data.white.mean())
        runs = tuple(
            dataclasses.replace(run, output=(signal + noise)[rows]) for run, rows in zip(data.runs, data.slices, strict=True)
        )
        whole = dataclasses.replace(data, runs=runs)
        set_ = (dataclasses.replace(member, form=used),)
        return Evidence(Bank(whole, np.ones((len(whole), 1))), Noise(), 0.0).given(set_).log_leading(set_)

    assert charge(Product(one, other), 40.0) > -0.5
    assert charge(Power(one, 2), 40.0) < -4.0
    assert charge(Power(one, 2), 40.0, plain) == 0.0


def test_evidence_is_the_density_of_the_data(data: Data) -> None:
    """Ratios of closed-form evidences are those of the densities, the variance integrated by quadrature."""
    rng = np.random.default_rng(5)
    short = Data(
        tuple(
            dataclasses.replace(
                run, full=run.full & (np.arange(len(run.full)) < 12), output=rng.standard_normal(12), white=np.ones(12)
            )
            for run in data.runs
        )
    )
    path = Path(Driver.of(short, "supply_voltage_V"))
    form = Form("x", "b = k u", (Power(path),), (Smooth(path, 0.5, 4),))
    bank = Bank(short, np.ones((len(short), 1)))
    evidence = Evidence(bank, Noise(flicker=0.35), 0.0)

    def log_density(members: tuple[Member, ...]) -> float:
        length = max(len(run.full) for run in short.runs)
        blocks = [Noise(flicker=0.35).covariance(run.windows, run.white, length) for run in short.runs]
        covariance = np.zeros((len(short), len(short)))
        for rows, block in zip(short.slices, blocks, strict=True):
            covariance[rows, rows] = block
        for member in members:
            for basis, scale in bank.scaled(member.form) or ():
                table = member.size * scale * bank.columns(basis)
                covariance += table @ table.T
        flat = covariance + 1e7 * np.ones_like(covariance)  # a constant of any size
        sigma = np.geomspace(0.05, 50.0, 4000)
        _, log_det = np.linalg.slogdet(flat)
        square = short.output @ np.linalg.solve(flat, short.output)
        # the constant is flat in its own unit: one power of σ belongs to it
        log_terms = -0.5 * log_det - len(short) * np.log(sigma) - 0.5 * square / sigma**2 + np.log(sigma)
        return float(np.log(np.trapezoid(np.exp(log_terms), np.log(sigma))))

    members = (Member(form, 1.8),)
    assert evidence.log_evidence(members) - evidence.log_evidence(()) == pytest.approx(
        log_density(members) - log_density(()), abs=1e-3
    )
    assert evidence.given(()).gain(form)[2] == pytest.approx(evidence.log_evidence(members))
    assert evidence.given(members).log_evidence == pytest.approx(evidence.log_evidence(members))


def test_forms_together_have_the_evidence_that_each_has_alone(data: Data) -> None:
    """Forms that share their departures, and others; beside a set and beside none; a wide basis is held in fewer columns."""
    setting = Setting(data, Driver.of(data, "temperature_block_degC"))
    path = Path(Driver.of(data, "supply_voltage_V"))
    plays = [
        Form("loop", "play", (Plays(path.driver, r, spread=False),), (Smooth(path, 0.5, 8),)) for r in (0.1, 0.2, 0.3, 0.4, 0.6)
    ]
    wide = Form("wide", "relays of smooth density", (Preisach(setting.temperature, 0.4, True, 0.3, 22),), (Smooth(path, 0.5, 8),))
    forms = [*plays, wide, Form("line", "b = k u", (Power(path),))]
    bank = Bank(data, np.ones((len(data), 1)))
    bank.prepare(forms)
    assert bank.reduced(wide.lead[0]).shape[1] < bank.columns(wide.lead[0]).shape[1]
    evidence = Evidence(bank, Noise(flicker=0.35, walk=1.0), 0.0)
    for members in ((), (Member(plays[2], 5.4),)):
        given = evidence.given(members)
        table = Screen(evidence, Layout(bank, forms)).gains(given)
        for form, row in zip(forms, table, strict=True):
            alone = [evidence.log_evidence((*members, Member(form, size))) for size in priors.SIZES]
            assert row == pytest.approx(alone, abs=1e-3)
        grown = [Form("loop", "plays", (plays[0].lead[0], one.lead[0]), plays[0].smooth) for one in plays[1:]]
        for some in (grown, [*forms, *grown], grown[:1]):
            possible, table = gains(given, some)
            assert possible == tuple(some)
            for form, row in zip(some, table, strict=True):
                alone = [evidence.log_evidence((*members, Member(form, size))) for size in priors.SIZES]
                assert row == pytest.approx(alone, abs=1e-3)


@pytest.mark.parametrize("departures", [0, 8])
def test_a_sum_of_relays_has_the_evidence_that_it_has_alone_where_one_moves(data: Data, departures: int) -> None:
    """A form of many leading bases is decomposed once for all moves; beside a set, with a move to what the baseline has."""
    driver = Driver.of(data, "temperature_block_degC")
    path = Path(Driver.of(data, "supply_voltage_V"))
    lead = tuple(Relays(driver, (up,), (up - 0.2,)) for up in np.linspace(-0.6, 0.7, 7))
    form = Form("loop", "relays", lead, (Smooth(path, 0.5, departures),) if departures else ())
    moves = [
        *((k, one) for k, basis in enumerate(lead) for one in basis.nearby(0.5)),
        (2, lead[3]),
        (4, Relays(driver, (9.0,), (8.0,))),
    ]
    bank = Bank(data, np.ones((len(data), 1)))
    bank.prepare([form])
    evidence = Evidence(bank, Noise(flicker=0.35, walk=1.0), 0.0)
    for members in ((), (Member(Form("line", "b = k u", (Power(path),)), 5.4),)):
        table = gains_of_moves(evidence.given(members), form, moves)
        assert np.all(table[-1] == -np.inf)
        assert len(moves) > 20
        for move, row in zip(moves[:-1], table[:-1], strict=True):
            alone = [evidence.log_evidence((*members, Member(form.moved(*move), size))) for size in priors.SIZES]
            assert row == pytest.approx(alone, abs=1e-6)


def test_many_columns_are_whitened_as_few_are(data: Data) -> None:
    columns = np.random.default_rng(1).standard_normal((len(data), 40))
    whitened = Whitened(data, np.ones((len(data), 1)), Noise(flicker=0.35, walk=1.0))
    few = np.hstack([whitened.whiten(columns[:, k : k + 8]) for k in range(0, 40, 8)])
    assert whitened.whiten(columns) == pytest.approx(few, abs=1e-12)
    assert whitened.project(columns) == pytest.approx(whitened.off(few), abs=1e-12)


def test_whitened_noise_is_white(data: Data) -> None:
    noise, rng = Noise(flicker=0.35, walk=1.0), np.random.default_rng(1)
    length = max(len(run.full) for run in data.runs)
    roots = [np.linalg.cholesky(noise.covariance(run.windows, run.white, length)) for run in data.runs]
    drawn = np.concatenate([root @ rng.standard_normal((len(root), 40)) for root in roots])
    white = Whitened(data, np.ones((len(data), 1)), noise).whiten(drawn)
    assert np.std(white) == pytest.approx(1.0, abs=0.02)
    assert abs(np.mean(white[1:] * white[:-1])) < 0.02


@pytest.mark.parametrize("of_dwells", [1.0, 3.0])
def test_two_state_recursions_sum_over_all_paths(of_dwells: float) -> None:
    """A window has one of the two values, or with a jump in it any mean between them."""
    data, step, sd, flip = np.array([0.7, -1.2, 0.4, 2.0]), 1.3, np.array([0.4, 0.8, 0.5, 0.6]), 0.2
    leave = {1.0: flip / np.sqrt(of_dwells), -1.0: flip * np.sqrt(of_dwells)}
    begin = {1.0: of_dwells / (1.0 + of_dwells), -1.0: 1.0 / (1.0 + of_dwells)}
    means = (np.arange(20000) + 0.5) / 10000.0 - 1.0
    between = norm.pdf(data[:, None], step * means, sd[:, None]) / len(means)
    total, mean, squared, jumps = 0.0, np.zeros(4), np.zeros(4), 0.0
    for path in itertools.product((-1.0, 1.0), repeat=5):  # at the ends of the windows
        weight, of_windows, of_squares = begin[path[0]], [], []
        for k, (a, b) in enumerate(itertools.pairwise(path)):
            own = between[k] if a != b else norm.pdf(data[k], step * np.array([a]), sd[k])
            weight *= own.sum() * (leave[a] if a != b else 1.0 - leave[a])
            places = means if a != b else np.array([a])
            of_windows.append(own @ places / own.sum())
            of_squares.append(own @ places**2 / own.sum())
        total, mean, squared = total + weight, mean + weight * np.array(of_windows), squared + weight * np.array(of_squares)
        jumps += weight * sum(a != b for a, b in itertools.pairwise(path))
    log_likelihood, *found, changes = two_state(data / step, (step / sd) ** 2, flip, ratio=of_dwells)
    normal = np.sum(norm.logpdf(data, 0.0, sd)) - 0.5 * np.sum((step / sd) ** 2)
    assert log_likelihood + normal == pytest.approx(np.log(total), abs=1e-6)
    assert found[0] == pytest.approx(mean / total, abs=1e-6)
    assert found[1] == pytest.approx(squared / total, abs=1e-6)
    assert changes == pytest.approx(jumps / total, abs=1e-6)


@pytest.mark.parametrize(("away", "sd"), [(3.0, 0.05), (40.0, 0.5), (40.0, 30.0), (0.2, 200.0)])
def test_a_window_with_a_jump_far_from_both_values_has_a_mean_near_the_nearer_one(away: float, sd: float) -> None:
    """Where the normal distribution function underflows, against an integral of the logarithms; one window, which surely jumps."""
    means = (np.arange(400_000) + 0.5) / 200_000.0 - 1.0
    logs = -0.5 * ((away - means) / sd) ** 2
    weights = np.exp(logs - logs.max())
    log_likelihood, mean, squared, changes = two_state(np.array([away]), np.array([sd**-2.0]), 0.5)
    of_either = np.logaddexp(-0.5 * ((away - 1.0) / sd) ** 2, -0.5 * ((away + 1.0) / sd) ** 2) - math.log(2.0)
    of_change = logs.max() + math.log(weights.mean())
    total = np.logaddexp(of_either, of_change) - math.log(2.0)
    assert log_likelihood - 0.5 * (away**2 + 1.0) / sd**2 == pytest.approx(total, abs=1e-3)
    share = math.exp(of_change - math.log(2.0) - total)
    assert changes == pytest.approx(share, abs=1e-3)
    held = 1.0 / (1.0 + math.exp(-2.0 * away / sd**2))  # of the upper value, where it does not jump
    within = weights @ means / weights.sum(), weights @ means**2 / weights.sum()
    assert mean[0] == pytest.approx(share * within[0] + (1.0 - share) * (2.0 * held - 1.0), abs=1e-4)
    assert squared[0] == pytest.approx(share * within[1] + 1.0 - share, abs=1e-4)


def test_a_two_state_process_beside_slow_noise_keeps_its_size(data: Data) -> None:
    """Under white noise alone it takes up a random walk, or further members do."""
    noise, rng = Noise(flicker=0.35, walk=3.0), np.random.default_rng(5)
    length = max(len(run.full) for run in data.runs)
    roots = [np.linalg.cholesky(noise.covariance(run.windows, run.white, length)) for run in data.runs]
    path = np.where(np.cumsum(rng.random((len(data), 10)) < 0.004).reshape(-1, 10) % 2, 1.0, -1.0).mean(axis=1)
    output = 2.5 * path + np.concatenate([root @ rng.standard_normal(len(root)) for root in roots])
    runs = [dataclasses.replace(run, output=output[rows]) for run, rows in zip(data.runs, data.slices, strict=True)]
    data, design = Data(tuple(runs)), np.ones((len(data), 1))
    columns, rest = slow_columns(data, noise)
    course = np.convolve(output, np.ones(5) / 5, "same")
    white = telegraph(data, design, np.empty((len(data), 0)), [course], data.white)
    assert white is not None
    found = telegraph(data, design, columns, [white], data.white + rest)
    assert found is not None
    assert found.log_evidence > white.log_evidence + 20.0
    assert found.half_step == pytest.approx(2.5, abs=0.15)
    assert found.sigma == pytest.approx(1.0, abs=0.1)
    assert np.mean(np.abs(found.path - path) < 0.5) > 0.97


def test_a_further_run_is_predicted_with_the_mean_of_a_two_state_process(data: Data) -> None:
    """Its path is not known there, its mean is: two dwells of three to one are no part of the bias alone."""
    path = np.where(np.arange(len(data)) % 40 < 30, 1.0, -1.0)
    runs = [
        dataclasses.replace(run, output=run.output + 0.01 * path[rows]) for run, rows in zip(data.runs, data.slices, strict=True)
    ]
    predicted = []
    for some, seen in ((data, None), (Data(tuple(runs)), Process(0.01, 1e-4, 20.0, path, 30.0, 0.0, 3.0))):
        baseline = Baseline(Simulator.from_mapping(BASELINE)).linearised(some)
        fit = Fit(some, baseline, Bank(some, baseline.design(some), baseline), State((), Noise(), 0.0, process=seen))
        predicted.append(fit.predicted(data.runs[1]))
    assert predicted[1] - predicted[0] == pytest.approx(0.01 * path.mean(), abs=1e-6)


def test_a_two_state_process_of_unequal_dwells_is_no_gain_of_runs_whose_jumps_nobody_foresees() -> None:
    """Before, the simulator's constant holds the mean of the process, as least squares find it."""
    rng, gyro = np.random.default_rng(8), Simulator.from_mapping(BASELINE | {"noise": NOISE})
    runs = []
    for k, programme in enumerate((*PROGRAMMES, PROGRAMMES[0])):
        run = few_monitors(gyro.simulate(programme, seed=20 + k, step_s=10.0, name=f"run{k}"))
        state, path = rng.random() < 0.8, []
        while sum(map(len, path)) < len(run):
            path.append(np.full(max(1, round(rng.exponential(180.0 if state else 45.0))), 0.03 if state else -0.03))
            state = not state
        runs.append(run.replace(table=run.table.assign(gyro_deg_h=run.table["gyro_deg_h"] + np.concatenate(path)[: len(run)])))
    few: dict[str, Any] = {"only": ["supply_voltage"], "window_s": 3.0 * Grid.of(runs).window_s, "black_box": False}
    found = diagnose(Simulator.from_mapping(BASELINE), runs[:2], runs[2:], **few)
    assert mechanisms(found) == ["random_telegraph"]
    data = found.before.data
    table, scored = data.means(found.before.baseline.columns), found.test
    left = data.output - table @ np.linalg.lstsq(table, data.output, rcond=1e-12)[0]
    assert found.train.baseline_rms <= 1.05 * np.sqrt(np.mean(left[data.of_windows] ** 2))
    assert scored is not None
    assert scored.improvement_ci95[0] <= 0.0 <= scored.improvement_ci95[1]
    assert "diagnosis.gain_of_numbers" in {one.code for one in found.remarks}


def test_bases_have_the_memory_that_they_name(data: Data) -> None:
    driver = Driver.of(data, "temperature_block_degC")
    run = data.runs[0]
    play = Plays(driver, 0.3, spread=False).columns(run)[:, 0] + driver.values(run)
    assert np.abs(play - driver.values(run)).max() <= 0.3 + 1e-9
    states = Relays(driver, (0.1,), (0.0,)).columns(run)
    assert states.min() == 0.0
    assert states.max() == 1.0
