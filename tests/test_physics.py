"""One contract for every mechanism of the catalogue."""

from __future__ import annotations

import dataclasses

import numpy as np
import pandas as pd
import pytest

import rlgcomp as rlg
from rlgcomp.noise.processes import stream
from rlgcomp.numerics.filters import lag
from rlgcomp.physics.mechanism import Mechanism

CHAMBER = {
    "thermal_polynomial",
    "temperature_rate",
    "rate_asymmetry",
    "thermal_lag",
    "thermal_gradient",
    "thermal_hysteresis",
    "mode_hop",
    "warm_up",
    "ageing",
    "light_intensity",
    "readout_incoherence",
    "discharge_imbalance",
    "supply_voltage",
    "magnetic_field",
    "ambient_pressure",
    "periodic_interference",
    "random_telegraph",
}
TURNTABLE = {
    "scale_factor",
    "scale_factor_temperature",
    "scale_factor_asymmetry",
    "scale_factor_nonlinearity",
    "lock_in",
    "misalignment",
    "earth_rate_leak",
    "rotation_harmonics",
    "encoder_delay",
}
LARGEST_DEG_H = {"chamber": 0.1, "turntable": 10.0, "any": 0.1}  # of the usual size, as a standard deviation
ALL = list(rlg.CATALOGUE.values())
LINEAR = [mechanism for mechanism in ALL if mechanism().amplitude_parameters()]
each = pytest.mark.parametrize("mechanism", ALL, ids=lambda mechanism: mechanism.name)
each_linear = pytest.mark.parametrize("mechanism", LINEAR, ids=lambda mechanism: mechanism.name)


@pytest.fixture(scope="module")
def runs() -> dict[str, rlg.Recording]:
    chamber = rlg.Simulator().simulate("minor-loops", seed=3, step_s=10.0)
    return {"chamber": chamber, "turntable": rlg.Simulator(kind="turntable").simulate("short-turns", seed=3), "any": chamber}


@pytest.fixture
def run(request: pytest.FixtureRequest, runs: dict[str, rlg.Recording]) -> rlg.Recording:
    """A run of the mechanism's own kind."""
    mechanism = request.node.callspec.params["mechanism"] if hasattr(request.node, "callspec") else None
    return runs[mechanism.kind if mechanism and mechanism.kind != "any" else "chamber"]


def amplitudes(mechanism: Mechanism) -> dict[str, float]:
    return {parameter.name: getattr(mechanism, parameter.name) for parameter in mechanism.amplitude_parameters()}


def contribution(mechanism: Mechanism, run: rlg.Recording, seed: int = 0) -> np.ndarray:
    return mechanism.contribution(run, stream(seed, mechanism.name))


@pytest.mark.parametrize(("kind", "names"), [("chamber", CHAMBER), ("turntable", TURNTABLE)])
def test_the_mechanisms_of_the_contract_are_all_there(kind: str, names: set[str]) -> None:
    assert {mechanism.name for mechanism in ALL if mechanism.kind == kind} >= names


@each
def test_its_description_is_complete(mechanism: type[Mechanism]) -> None:
    assert mechanism.name in mechanism.__module__
    assert "=" in mechanism.equation
    assert len(mechanism.reference) > 30
    assert ".. math::" in (mechanism.__doc__ or "")
    for parameter in mechanism.parameters():
        assert parameter.role in ("amplitude", "shape", "setting")
        assert parameter.low < parameter.high
        assert parameter.unit or parameter.role == "setting"
        if not parameter.choices and not isinstance(parameter.typical, str | tuple):
            assert parameter.low <= parameter.typical <= parameter.high


@each
def test_its_contribution_has_a_row_a_sample_and_is_finite(mechanism: type[Mechanism], run: rlg.Recording) -> None:
    values = contribution(mechanism(), run)
    assert values.shape == (len(run),)
    assert np.isfinite(values).all()
    assert np.ptp(values) > 0.0
    assert np.std(values) < LARGEST_DEG_H[mechanism.kind]


@each
def test_the_same_seed_gives_the_same(mechanism: type[Mechanism], run: rlg.Recording) -> None:
    assert np.array_equal(contribution(mechanism(), run, 5), contribution(mechanism(), run, 5))


@each_linear
def test_it_is_linear_in_its_amplitudes(mechanism: type[Mechanism], run: rlg.Recording) -> None:
    usual = mechanism()
    names = amplitudes(usual)
    zero = dataclasses.replace(usual, **dict.fromkeys(names, 0.0))
    assert not contribution(zero, run).any()
    double = dataclasses.replace(usual, **{name: 2.0 * value for name, value in names.items()})
    assert contribution(double, run) == pytest.approx(2.0 * contribution(usual, run), rel=1e-12, abs=1e-15)
    assert usual.basis(run).shape == (len(run), len(names))


@each_linear
def test_its_basis_spans_its_contribution(mechanism: type[Mechanism], run: rlg.Recording) -> None:
    """Least squares on its own basis gives its own amplitudes back."""
    chosen = dataclasses.replace(
        mechanism(), **{parameter.name: 0.5 * parameter.high for parameter in mechanism().amplitude_parameters()}
    )
    basis = chosen.basis(run)
    scale = np.abs(basis).max(axis=0)
    found = np.linalg.lstsq(basis / scale, contribution(chosen, run), rcond=None)[0] / scale
    assert found == pytest.approx(np.array(list(amplitudes(chosen).values())), rel=1e-6)


@each
def test_only_monitors_are_read(mechanism: type[Mechanism], run: rlg.Recording) -> None:
    other = run.replace(table=run.table.assign(**{run.gyro_columns[0]: 1e6}))
    assert np.array_equal(contribution(mechanism(), run), contribution(mechanism(), other))


@each
def test_a_missing_monitor_is_named(mechanism: type[Mechanism], run: rlg.Recording) -> None:
    bare = run.replace(table=run.table[["time_s", *run.gyro_columns]], truth=None)
    if mechanism.drivers:
        with pytest.raises(rlg.InputError, match="--map"):
            mechanism().basis(bare)
    else:
        assert len(mechanism().basis(bare)) == len(bare)


@each
def test_its_mapping_and_back(mechanism: type[Mechanism]) -> None:
    assert mechanism.from_mapping(mechanism().to_mapping()) == mechanism()
    with pytest.raises(rlg.InputError, match=f"{mechanism.name}: unknown 'nonsense'"):
        mechanism.from_mapping({"nonsense": 1.0})


@each
def test_values_out_of_bounds_are_refused(mechanism: type[Mechanism]) -> None:
    for parameter in mechanism.parameters():
        wrong = ["nowhere"] if parameter.choices else [float("nan"), None, True]
        if not parameter.choices and not isinstance(parameter.typical, str | tuple):
            wrong.append("much")
        if np.isfinite(parameter.high) and not parameter.choices:
            wrong.append(parameter.high * 1.01 + 1.0)
        for value in wrong:
            with pytest.raises(rlg.InputError, match=parameter.name):
                mechanism(**{parameter.name: value})


@each_linear
def test_amplitudes_are_bounded_for_no_gyro_up_to_1e5_deg_h(mechanism: type[Mechanism]) -> None:
    """A driver may move by a thousandth of its unit, as in a short recording; Earth rate alone has a size of its own."""
    for parameter in mechanism.parameters():
        if parameter.role == "amplitude" and parameter.unit.startswith("deg/h") and mechanism.name != "earth_rate_leak":
            assert parameter.high >= (1e8 if parameter.unit != "deg/h" else 1e5), parameter.name
            mechanism.from_mapping({parameter.name: 1e5})


@each
def test_options_are_finite_and_whole_where_they_count(mechanism: type[Mechanism]) -> None:
    """A silently rounded number would not be the stated one."""
    numbers = [p for p in mechanism.parameters() if p.role == "setting" and not isinstance(p.typical, str | tuple)]
    for parameter in numbers:
        for value in (float("inf"), float("-inf"), float("nan"), *([max(parameter.typical, 2) + 0.5] if parameter.whole else [])):
            with pytest.raises(rlg.InputError, match=rf"{parameter.name} is {value}; it must be a (finite|whole) number"):
                mechanism.from_mapping({parameter.name: value})
        assert parameter.whole == (parameter.name.startswith(("degree", "order", "exponent", "hops")))
        assert mechanism.from_mapping({parameter.name: float(parameter.typical)}) == mechanism()


def test_rate_and_asymmetry_make_two_coefficients(run: rlg.Recording) -> None:
    rate = rlg.CATALOGUE["temperature_rate"](k_deg_h_min_K=0.004)
    asymmetry = rlg.CATALOGUE["rate_asymmetry"](k_deg_h_min_K=0.001)
    slope = rate.basis(run)[:, 0]
    together = contribution(rate, run) + contribution(asymmetry, run)
    assert together == pytest.approx(np.where(slope > 0, 0.005, 0.003) * slope, abs=1e-12)


def test_mode_hop_comes_back_later_on_the_way_down() -> None:
    time_s = np.arange(400.0)
    temperature = np.r_[np.linspace(20, 40, 200), np.linspace(40, 20, 200)]
    table = {"time_s": time_s, "gyro_deg_h": 0.0 * time_s, "temperature_block_degC": temperature}
    step = rlg.CATALOGUE["mode_hop"](threshold_degC=30.0, dead_band_K=4.0).basis(rlg.Recording(pd.DataFrame(table)))[:, 0]
    edges = np.flatnonzero(np.diff(step))
    assert temperature[edges + 1] == pytest.approx([30.0, 26.0], abs=0.2)


def recorded(temperature: np.ndarray) -> rlg.Recording:
    """A second a row."""
    time_s = np.arange(float(len(temperature)))
    return rlg.Recording(pd.DataFrame({"time_s": time_s, "gyro_deg_h": 0.0 * time_s, "temperature_block_degC": temperature}))


def test_several_hops_are_one_step_each() -> None:
    temperature = np.r_[np.linspace(0.0, 50.0, 501), np.linspace(50.0, 0.0, 501)]
    several = rlg.CATALOGUE["mode_hop"](threshold_degC=10.0, dead_band_K=3.0, spacing_K=15.0, hops=3)
    alone = [rlg.CATALOGUE["mode_hop"](threshold_degC=level, dead_band_K=3.0) for level in (10.0, 25.0, 40.0)]
    recording = recorded(temperature)
    np.testing.assert_array_equal(several.basis(recording), sum(one.basis(recording) for one in alone))


def test_warming_up_may_take_two_terms(run: rlg.Recording) -> None:
    one = rlg.CATALOGUE["warm_up"](initial_deg_h=0.02, time_constant_s=900.0)
    two = rlg.CATALOGUE["warm_up"](
        initial_deg_h=0.02, slower_share=0.25, time_constant_s=900.0, slower_time_constant_s=5000.0, terms="two"
    )
    since_s, rng = run.time_s - run.time_s[0], np.random.default_rng(0)
    difference = two.contribution(run, rng) - 0.75 * one.contribution(run, rng)
    np.testing.assert_allclose(difference, 0.005 * np.exp(-since_s / 5000.0), atol=1e-15)


@pytest.mark.parametrize(
    ("name", "values", "nonlinear"),
    [
        ("warm_up", {}, ["time_constant_s"]),
        ("warm_up", {"terms": "two"}, ["time_constant_s", "slower_time_constant_s", "slower_share"]),
        ("mode_hop", {}, ["threshold_degC", "dead_band_K"]),
        ("mode_hop", {"hops": 2}, ["threshold_degC", "dead_band_K", "spacing_K"]),
        ("thermal_hysteresis", {"law": "plays"}, ["radius_K"]),
        ("thermal_hysteresis", {"law": "coleman_hodgdon"}, ["radius_K", "curve_centre_degC", "curve_K"]),
    ],
)
def test_an_unused_nonlinear_parameter_is_neither_free_nor_written(
    name: str, values: dict[str, object], nonlinear: list[str]
) -> None:
    simulator = rlg.Simulator.from_mapping({"kind": "chamber", "mechanisms": [{name: values}]})
    (mechanism,) = simulator.mechanisms
    amplitudes = [parameter.name for parameter in mechanism.amplitude_parameters()]
    all_nonlinear = {parameter.name for parameter in mechanism.parameters() if parameter.role == "shape"}
    assert simulator.free[name] & all_nonlinear == set(nonlinear)
    (written,) = simulator.to_mapping()["mechanisms"]
    assert {key for key, value in written[name].items() if isinstance(value, dict)} == {*amplitudes, *nonlinear}


def test_bouc_wen_does_not_forget_by_read_noise() -> None:
    rng = np.random.default_rng(2)
    course = np.interp(np.arange(20_000), [0, 4000, 9000, 13_000, 20_000], [0.0, 40.0, 40.0, -20.0, -20.0])
    hysteresis = rlg.CATALOGUE["thermal_hysteresis"](law="bouc_wen", radius_K=10.0)
    plain = hysteresis.basis(recorded(course))
    for noise_K, step_K in ((0.008, 1e-6), (0.02, 0.01)):
        read = np.round((course + noise_K * rng.standard_normal(len(course))) / step_K) * step_K
        np.testing.assert_allclose(hysteresis.basis(recorded(read)), plain, atol=0.3)


@pytest.mark.parametrize(("start", "first"), [("rested", 0.0), ("from_below", 0.0), ("from_above", 1.0)])
def test_mode_hop_begins_where_it_came_from(start: str, first: float) -> None:
    """Within the dead band; outside it the temperature decides."""
    temperature = np.r_[np.linspace(27, 24, 100), np.linspace(24, 40, 200)]
    time_s = np.arange(300.0)
    table = {"time_s": time_s, "gyro_deg_h": 0.0 * time_s, "temperature_block_degC": temperature}
    hop = rlg.CATALOGUE["mode_hop"](threshold_degC=30.0, dead_band_K=4.0, start=start)
    step = hop.basis(rlg.Recording(pd.DataFrame(table)))[:, 0]
    assert step[0] == first
    assert set(step[(time_s > 40) & (time_s < 170)]) == {0.0}
    assert step[-1] == 1.0
    assert ("from far above" in hop.stated()) == (start == "from_above")
    outside = rlg.CATALOGUE["mode_hop"](threshold_degC=22.0, dead_band_K=4.0, start=start)
    assert outside.basis(rlg.Recording(pd.DataFrame(table)))[0, 0] == 1.0


@pytest.mark.parametrize(("half_step_deg_h", "dwell_s"), [(1e-5, 0.01), (1344.0, 122.0), (1e6, 1e5)])
def test_telegraph_may_be_that_of_any_gyro(half_step_deg_h: float, dwell_s: float) -> None:
    """Gyros of 1e-4 to 1e5 deg/h, samples every 0.001 to 60 s."""
    rlg.CATALOGUE["random_telegraph"](half_step_deg_h=half_step_deg_h, dwell_s=dwell_s)


def test_telegraph_has_its_covariance() -> None:
    telegraph = rlg.CATALOGUE["random_telegraph"](half_step_deg_h=0.004, dwell_s=500.0)
    run = rlg.Simulator(noise=rlg.NoiseModel()).simulate("start 20, hold 3000", step_s=10.0)
    series = np.array([contribution(telegraph, run, seed) for seed in range(60)])
    for lag_steps in (0, 10, 50):
        products = (series[:, : series.shape[1] - lag_steps] * series[:, lag_steps:]).mean(axis=1)
        expected = telegraph.half_step_deg_h**2 * np.exp(-20.0 * lag_steps / telegraph.dwell_s)
        assert products.mean() == pytest.approx(expected, abs=4 * products.std(ddof=1) / np.sqrt(60) + 1e-12)
    assert set(np.unique(np.abs(series))) == {0.004}


def by_equation(law: str, temperature: np.ndarray, radius: float, centre: float, span: float) -> np.ndarray:
    """The stated equation for k1 = 1, coded from its text, sample by sample."""

    def play(r: float) -> np.ndarray:
        state, out = temperature[0], []
        for t in temperature:
            state = max(t - r, min(t + r, state))
            out.append(state)
        return np.array(out)

    if law == "play":
        return play(0.25 * radius) - temperature
    if law == "plays":
        shares = (np.arange(200) + 0.5) / 200
        return np.mean([play(-radius * np.log(1.0 - share)) for share in shares], axis=0) - temperature
    if law == "preisach":
        edges = np.linspace(centre - 0.5 * span, centre + 0.5 * span, 60)
        beta, alpha = (grid[np.triu_indices(60, k=1)] for grid in np.meshgrid(edges, edges, indexing="ij"))
        weight = np.exp(-4.0 * (alpha - beta) / span)
        up, out = temperature[0] >= 0.5 * (alpha + beta), []
        for t in temperature:
            up = (up | (t >= alpha)) & (t > beta)
            out.append(radius * (weight @ np.where(up, 1.0, -1.0)) / weight.sum())
        return np.array(out)
    z, out = 0.0, [0.0]
    for step in np.diff(temperature):
        for _ in range(20):
            z += step / 20.0 * (1.0 - abs(z) / radius * (0.2 + 0.8 * np.sign(z * step)))
        out.append(z)
    return np.array(out)


@pytest.mark.parametrize("law", ["play", "plays", "preisach", "bouc_wen"])
def test_the_stated_equation_is_the_fitted_one(law: str) -> None:
    run = rlg.Simulator().simulate("minor-loops", seed=3, step_s=60.0)
    temperature = run.column(run.temperature_column)
    mechanism = rlg.CATALOGUE["thermal_hysteresis"](law=law, radius_K=9.0, centre_degC=10.0, span_K=120.0)
    ours, theirs = mechanism.basis(run)[:, 0], by_equation(law, temperature, 9.0, 10.0, 120.0)
    assert np.std(ours - theirs) < 0.04 * np.std(theirs)
    stated = {other: dataclasses.replace(mechanism, law=other).stated() for other in ("play", "plays", "preisach", "bouc_wen")}
    assert len(set(stated.values())) == 4
    assert dataclasses.replace(mechanism, start="from_below").stated() == stated[law] + "; T had come from far below"


@pytest.mark.parametrize("law", ["play", "preisach", "bouc_wen"])
def test_hysteresis_opens_a_loop_whatever_the_speed(law: str) -> None:
    """The loop at mid span is equally wide at 1 and at 0.1 degC/min."""
    widths = []
    for rate in (1.0, 0.1):
        programme = f"start 20, ramp 50 {rate}, hold 300, ramp -10 {rate}, hold 300, ramp 50 {rate}, hold 300"
        run = rlg.Simulator().simulate(programme, step_s=30.0)
        temperature = run.column("temperature_block_degC")
        bias = contribution(rlg.CATALOGUE["thermal_hysteresis"](law=law), run)
        cold = int(np.argmin(temperature))
        hot = int(np.argmax(temperature[:cold]))
        down = np.interp(20.0, temperature[hot:cold][::-1], bias[hot:cold][::-1])
        up = np.interp(20.0, temperature[cold:], bias[cold:])
        widths.append(down - up)
    assert abs(widths[0]) > 1e-4
    assert widths[0] == pytest.approx(widths[1], rel=0.05)


def test_a_gradient_read_by_late_thermometers_is_the_gradient_itself() -> None:
    """Readings corrected for their first-order lag are the temperatures at a slab's two ends, which a simulation has."""
    time_s = np.arange(0.0, 30000.0, 20.0)
    inside, outside = (20.0 + 15.0 * np.sin(2.0 * np.pi * (time_s - late) / 9000.0) for late in (400.0, 0.0))
    late = rlg.CATALOGUE["thermal_gradient"](k_deg_h_K=1.0, thermometers_late_s=30.0)

    def contribution(mechanism: Mechanism, block: np.ndarray, shell: np.ndarray) -> np.ndarray:
        table = {"time_s": time_s, "gyro_deg_h": 0.0 * time_s, "temperature_block_degC": block, "temperature_shell_degC": shell}
        return mechanism.contribution(rlg.Recording(pd.DataFrame(table)), np.random.default_rng(0))

    read = [lag(values, time_s, 30.0) for values in (inside, outside)]
    away = slice(10, -10)
    assert contribution(late, *read)[away] == pytest.approx((inside - outside)[away], abs=0.02)
    assert np.abs(contribution(late.for_true_quantities(), *read) - (inside - outside))[away].max() > 0.05
    assert contribution(late.for_true_quantities(), inside, outside) == pytest.approx(inside - outside)
    assert "thermometers_late_s" in late.stated()
    assert not late.for_true_quantities().shape_parameters()


@pytest.mark.parametrize(
    ("name", "numbers"),
    [
        ("warm_up", {"time_constant_s": 3000.0}),
        ("ageing", {}),
        ("periodic_interference", {"frequency_hz": 1.0 / 3000.0}),
    ],
)
@pytest.mark.parametrize("gap", [False, True])
def test_means_of_samples_have_the_time_of_the_first_sample(
    runs: dict[str, rlg.Recording], name: str, numbers: dict[str, float], gap: bool
) -> None:
    """A stated line was up to a tenth of a window early in a diagnosis, which evaluates it on means of samples."""
    run = runs["chamber"]
    if gap:
        run = run.replace(table=run.table.drop(index=range(6, 36)).reset_index(drop=True), truth=None)
    mechanism = rlg.CATALOGUE[name](**numbers)
    table = pd.DataFrame({"basis": mechanism.basis(run)[:, -1]})
    averaged = run.averaged(60.0, table)
    np.testing.assert_allclose(mechanism.basis(averaged)[:, -1], averaged.column("basis"), atol=2e-3 * np.ptp(table["basis"]))
    again = averaged.averaged(300.0, averaged.table[["basis"]].rename(columns={"basis": "twice"}))
    np.testing.assert_allclose(mechanism.basis(again)[:, -1], again.column("twice"), atol=0.02 * np.ptp(table["basis"]))
    later = again.between(float(again.time_s[5]), np.inf)
    assert later.elapsed_s[0] == pytest.approx(0.5 * later.period_s, abs=10.0)  # first sample of its first mean
