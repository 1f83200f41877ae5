"""Compensations with known physics: causal terms beside an LS-SVM, saved, streamed, exported, and refused where they must."""

from __future__ import annotations

import dataclasses
import itertools
import re
import shutil
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from typer.testing import CliRunner

import rlgcomp as rlg
from rlgcomp.cli import app, register_commands
from rlgcomp.compensation.feature_pipeline import FeatureRecipe
from rlgcomp.compensation.known_physics import LEARNT, known_physics, on_amplitudes
from rlgcomp.compensation.models.lssvm_search import WITHOUT_KERNEL
from rlgcomp.export import toolchain as tools
from rlgcomp.export.c_source import physics_bytes
from rlgcomp.export.target import Options, export
from rlgcomp.physics.ageing import Ageing
from rlgcomp.physics.mode_hop import ModeHop
from rlgcomp.physics.periodic_interference import PeriodicInterference
from rlgcomp.physics.random_telegraph import RandomTelegraph
from rlgcomp.physics.rate_asymmetry import RateAsymmetry
from rlgcomp.physics.supply_voltage import SupplyVoltage
from rlgcomp.physics.tabulated_law import TabulatedLaw
from rlgcomp.physics.temperature_rate import TemperatureRate
from rlgcomp.physics.thermal_gradient import ThermalGradient
from rlgcomp.physics.thermal_hysteresis import ThermalHysteresis
from rlgcomp.physics.thermal_lag import ThermalLag
from rlgcomp.physics.thermal_polynomial import ThermalPolynomial
from rlgcomp.physics.warm_up import WarmUp

T, SHELL = "temperature_block_degC", "temperature_shell_degC"
needs_gcc = pytest.mark.skipif(shutil.which("gcc") is None, reason="gcc is not installed")
register_commands()

LAWS = (
    TabulatedLaw(
        cause="a curve", driver=T, memory="none", knots=(-20.0, 0.0, 10.0, 50.0), weights=(0.0, 1e-3, -1e-3, 2e-3), slope_above=1e-4
    ),
    TabulatedLaw(
        cause="a line", driver=T, driver_2=SHELL, combination="between", share=0.4, memory="lag", time_s=400.0,
        knots=(0.0, 30.0), weights=(0.0, 1e-3), slope_below=1e-5,
    ),
    TabulatedLaw(cause="a rate", driver=T, memory="rate", time_s=600.0, knots=(-2.0, 0.0, 2.0), weights=(1e-3, 0.0, 3e-3)),
    TabulatedLaw(cause="a ladder", driver=T, memory="lags", knots=(100.0, 2000.0), weights=(1e-4, -2e-4)),
    TabulatedLaw(cause="plays", driver=T, memory="plays", knots=(1.0, 9.0), weights=(1e-4, 2e-4), start="below"),
    TabulatedLaw(cause="a rest", driver=T, memory="plays", knots=(1.0, 9.0), knots_2=(24.5, 21.0), weights=(1e-4, 2e-4)),
    TabulatedLaw(
        cause="relays", driver=T, memory="relays", knots=(20.0, 45.0), knots_2=(5.0, 30.0), weights=(1e-3, -2e-3), start="above"
    ),
    TabulatedLaw(
        cause="unknown", driver=T, memory="relays", knots=(20.0, 45.0), knots_2=(5.0, 30.0), weights=(1e-3, -2e-3), start="unknown"
    ),
    TabulatedLaw(cause="product", driver=T, driver_2=SHELL, memory="product", knots=(10.0, 12.0), weights=(1e-6,)),
    TabulatedLaw(cause="time", memory="time", knots=(0.0, 600.0, 5000.0), weights=(1e-3, 5e-4, 0.0)),
    TabulatedLaw(cause="wave", memory="wave", knots=(1e-3,), weights=(1e-4,), weights_2=(2e-4,)),
    TabulatedLaw(
        cause="contrast", driver="readout_a_V", driver_2="readout_b_V", combination="contrast", memory="none",
        knots=(-0.05, 0.05), weights=(-1e-3, 1e-3), factor=SHELL,
    ),
    TabulatedLaw(cause="late", driver=T, memory="none", knots=(0.0, 30.0), weights=(0.0, 1e-3), change="derivative", step_s=30.0),
)  # fmt: skip
MECHANISMS = (
    ThermalPolynomial(),
    TemperatureRate(),
    RateAsymmetry(),
    ThermalLag(time_constant_s=700.0),
    ThermalGradient(thermometers_late_s=20.0),
    ThermalHysteresis(law="preisach", centre_degC=15.0, span_K=80.0, start="from_below"),
    ModeHop(threshold_degC=30.0, dead_band_K=4.0, spacing_K=10.0, hops=2),
    WarmUp(terms="two", time_constant_s=900.0, slower_time_constant_s=600.0),
    Ageing(),
    SupplyVoltage(),
    PeriodicInterference(frequency_hz=1e-3),
)
SIMULATORS = {
    "mechanisms": rlg.Simulator(MECHANISMS),
    "laws": rlg.Simulator(LAWS),
    "plays": rlg.Simulator((ThermalHysteresis(), dataclasses.replace(MECHANISMS[4], thermometers_late_s=0.0))),
    "plays of all radii": rlg.Simulator((ThermalHysteresis(law="plays"), WarmUp())),
    "Bouc-Wen": rlg.Simulator((ThermalHysteresis(law="bouc_wen", start="from_above"),)),
    "Coleman-Hodgdon": rlg.Simulator((ThermalHysteresis(law="coleman_hodgdon", start="from_below"),)),
}


LAWS_OF_HYSTERESIS = ("play", "plays", "preisach", "bouc_wen", "coleman_hodgdon")


@pytest.fixture(scope="module")
def runs(short_runs: list[rlg.Recording]) -> list[rlg.Recording]:
    """Short runs with a supply voltage."""
    rng = np.random.default_rng(0)
    return [
        run.replace(table=run.table.assign(supply_voltage_V=15.0 + np.cumsum(1e-4 * rng.normal(size=len(run)))))
        for run in short_runs
    ]


@pytest.fixture(scope="module")
def hybrids(runs: list[rlg.Recording]) -> dict[str, rlg.Compensator]:
    return {
        name: rlg.Compensator(rlg.LSSVMRegressor(), features="temperature,lag", physics=simulator).fit(runs[:2])
        for name, simulator in SIMULATORS.items()
    }


@pytest.fixture(scope="module")
def hybrid(hybrids: dict[str, rlg.Compensator]) -> rlg.Compensator:
    return hybrids["mechanisms"]


# --- terms -----------------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", SIMULATORS)
def test_sample_by_sample_is_the_whole_to_the_last_bit(runs: list[rlg.Recording], name: str) -> None:
    recipe = FeatureRecipe(known_physics(SIMULATORS[name], runs).terms)
    run = runs[0]
    whole = recipe.transform(run).to_numpy()
    table, state, pieces = run.table, None, []
    cuts = [0, 1, 2, 100, 400, 401, len(table)]
    for first, last in itertools.pairwise(cuts):
        part = table.iloc[first:last]
        values, state = recipe.run(state, part["time_s"].to_numpy(), part[list(recipe.columns)].to_numpy())
        pieces.append(values)
    assert np.array_equal(np.vstack(pieces), whole)
    state, rows = None, []
    for row in table.iloc[:400].to_dict("records"):
        value, state = recipe.step(state, row)
        rows.append(value)
    assert np.array_equal(np.array(rows), whole[:400])


@pytest.mark.parametrize("name", SIMULATORS)
def test_terms_survive_their_plain_description(runs: list[rlg.Recording], name: str) -> None:
    recipe = FeatureRecipe(known_physics(SIMULATORS[name], runs).terms)
    assert FeatureRecipe.from_list(recipe.to_list()) == recipe
    assert recipe.physics == tuple(range(len(recipe.names)))


HYSTERESES = [ThermalHysteresis(law=law, start=start) for law in LAWS_OF_HYSTERESIS for start in ("rested", "from_below")]


@pytest.mark.parametrize("mechanism", [*MECHANISMS, *LAWS, *HYSTERESES, WarmUp()], ids=str)
def test_the_causal_form_is_the_mechanism_but_for_what_looks_ahead(runs: list[rlg.Recording], mechanism: rlg.Mechanism) -> None:
    """Up to a constant, on means over the averaging time: what is left is of slopes and filters, which are half a minute late."""
    run = runs[0]
    columns = FeatureRecipe(known_physics(rlg.Simulator((mechanism,)), [run]).terms).transform(run).to_numpy()
    names = [p.name for p in mechanism.amplitude_parameters()]
    weights = np.array([float(getattr(mechanism, name)) for name in names])
    expected = (mechanism.basis(run) @ weights)[: len(run) // 100 * 100].reshape(-1, 100).mean(axis=1)
    own = columns[: len(run) // 100 * 100].reshape(-1, 100, columns.shape[1]).mean(axis=1)
    design = np.column_stack([np.ones(len(own)), own])
    residual = expected - design @ np.linalg.lstsq(design, expected, rcond=None)[0]
    allowed = 0.25 if "rate" in str(mechanism).lower() or "late" in str(mechanism) else 0.03
    assert np.std(residual) <= allowed * np.std(expected)


@pytest.mark.parametrize(
    ("changes", "field"),
    [
        ({"memory": "forever"}, "memory"),
        ({"function": "spline"}, "function"),
        ({"driver": ""}, "driver"),
        ({"driver_2": SHELL}, "driver_2"),
        ({"memory": "rate"}, "time_s"),
        ({"memory": "plays", "knots": (1.0,), "weights": ()}, "knots"),
        ({"memory": "plays", "knots": (-1.0,), "weights": (1.0,)}, "knots"),
        ({"memory": "plays", "knots": (1.0,), "knots_2": (1.0, 2.0), "weights": (1.0,)}, "knots_2"),
        ({"memory": "relays", "knots": (1.0,), "knots_2": (2.0,), "weights": (1.0,)}, "knots_2"),
        ({"function": "table", "table": (1.0, 0.0), "values": (0.0, 0.0), "cubics": (0.0,) * 4}, "table"),
        ({"function": "decay", "table": (-1.0,), "values": (1.0,)}, "table"),
        ({"function": "power", "order": 10}, "order"),
        ({"mechanism": ""}, "mechanism"),
        ({"centre": float("nan")}, "centre"),
        ({"weights": (1.0,)}, "weights"),
    ],
)
def test_terms_that_no_simulator_makes_are_refused(changes: dict[str, object], field: str) -> None:
    plain = {"kind": "physics", "mechanism": "m", "parameter": "p", "driver": T} | changes
    with pytest.raises(rlg.InputError, match=f"physics: {field} is"):
        FeatureRecipe.from_list([plain])


# --- the model -------------------------------------------------------------------------------------------------------------------


def test_the_amplitudes_are_those_of_the_simulator(unit: rlg.Simulator) -> None:
    runs = [unit.simulate("short", seed=seed) for seed in (31, 32, 33)]
    model = rlg.Compensator(features="temperature", physics=unit).fit(runs)
    table = model.amplitudes()
    errors = (table["value"] - table["given"]) / table["sd"]
    assert np.sqrt(np.mean(errors**2)) < 2.0
    assert set(table["mechanism"]) == {mechanism.name for mechanism in unit.mechanisms}
    parts = model.parts()
    assert list(parts["part"])[-1] == LEARNT
    assert parts["share"].sum() == pytest.approx(1.0)


def test_physics_that_is_worse_than_none_has_a_remark(short_runs: list[rlg.Recording]) -> None:
    """Parts of runs that hardly overlap: a cubic with an amplitude of its own carries the default model too far."""

    def part(run: rlg.Recording, first: float, last: float) -> rlg.Recording:
        return run.between(*(run.time_s[0] + share * run.duration_s for share in (first, last)))

    cut = [part(run, *shares) for run, shares in zip(short_runs, ((0.0, 0.4), (0.3, 0.7), (0.6, 1.0)), strict=False)]
    physics = rlg.Simulator((ThermalPolynomial(), SupplyVoltage()))
    model, plain = rlg.Compensator(physics=physics).fit(cut), rlg.Compensator().fit(cut)
    (remark,) = [one for one in model.remarks_ if one.code == "compensation.physics_worse"]
    assert plain.selection_.rmse is not None
    assert remark.data["without_deg_h"] == pytest.approx(plain.selection_.rmse * plain.scaling_.y_scale_deg_h, rel=1e-6)
    assert remark.data["residual_deg_h"] > 1.1 * remark.data["without_deg_h"]


def test_amplitudes_that_mean_nothing_have_a_remark(short_runs: list[rlg.Recording]) -> None:
    """A supply whose effect the noise hides; a cubic in temperature that the kernel of temperature takes off again."""
    hidden = rlg.Compensator(physics=rlg.Simulator((ThermalPolynomial(), SupplyVoltage()))).fit(short_runs)
    (remark,) = [one for one in hidden.remarks_ if one.code == "compensation.amplitudes_unknown"]
    assert "supply_voltage.k_deg_h_V" in remark.text
    doubled = rlg.Compensator(features="temperature", physics=rlg.Simulator((ThermalPolynomial(),))).fit(short_runs[:3])
    (remark,) = [one for one in doubled.remarks_ if one.code == "compensation.parts_cancel"]
    assert sum(remark.data["shares"].values()) == pytest.approx(100.0)
    assert max(remark.data["shares"].values()) > 120.0


@pytest.mark.parametrize(("sd", "told"), [(0.003, False), (0.03, True)])
def test_parts_that_oppose_each_other_cancel_only_if_they_are_uncertain(sd: float, told: bool) -> None:
    """A play less its temperature opposes a polynomial, however well both are known."""
    parts = pd.DataFrame({"part": ["thermal_polynomial", "thermal_hysteresis", LEARNT], "share": [1.25, -0.25, 0.0]})
    rows = [("thermal_polynomial", "c1_deg_h_K", 0.0134, 0.0004, 0.0), ("thermal_hysteresis", "k3_deg_h_K", 0.031, sd, 0.0)]
    amplitudes = pd.DataFrame(rows, columns=["mechanism", "parameter", "value", "sd", "given"])
    assert ("compensation.parts_cancel" in [one.code for one in on_amplitudes(parts, amplitudes)]) is told


def test_beyond_the_range_physics_goes_on_and_the_rest_keeps_its_value(unit: rlg.Simulator) -> None:
    polynomial = rlg.Simulator((ThermalPolynomial(degree=1, c1_deg_h_K=1e-3),), noise=unit.noise)
    runs = [polynomial.simulate("short", seed=seed) for seed in (1, 2)]
    model = rlg.Compensator(features="temperature", physics=polynomial).fit(runs)
    low, high = (float(f([f(run.column(T)) for run in runs])) for f in (np.min, np.max))
    temperatures = np.array([high, high + (high - low), high + 2.0 * (high - low), high + 30.0 * (high - low)])
    table = runs[0].table
    bias = [model.predict(runs[0].replace(table=table.assign(**{T: t})))["bias_deg_h"].iloc[-1] for t in temperatures]
    slope = model.amplitudes()["value"][0]
    assert np.diff(bias[:3]) == pytest.approx(slope * np.diff(temperatures[:3]), rel=0.1)
    assert bias[3] < bias[0] + 12.0 * slope * (high - low)  # bounded, whatever comes in
    alone = rlg.Compensator(features="temperature").fit(runs)
    assert alone.parts().empty
    assert alone.amplitudes().empty


@pytest.mark.parametrize("name", SIMULATORS)
def test_saved_loaded_and_streamed_it_gives_the_same_bits(
    hybrids: dict[str, rlg.Compensator], runs: list[rlg.Recording], name: str, tmp_path: Path
) -> None:
    model, run = hybrids[name], runs[2].between(0.0, 6000.0)
    model.save(tmp_path / "model")
    loaded = rlg.load(tmp_path / "model")
    whole = model.predict(run)
    pd.testing.assert_frame_equal(loaded.predict(run), whole)
    assert loaded.scaling_.linear == model.scaling_.linear
    loaded.restart()
    streamed = pd.concat([loaded.steps(run.table.iloc[:777]), loaded.steps(run.table.iloc[777:])], ignore_index=True)
    pd.testing.assert_frame_equal(streamed, whole)
    loaded.restart()
    steps = [loaded.step(row).bias_deg_h for row in run.table.iloc[:300].to_dict("records")]
    assert np.array_equal(steps, whole["bias_deg_h"].to_numpy()[:300])
    card = (tmp_path / "model" / "card.md").read_text(encoding="utf-8")
    assert "## What each part does" in card
    loaded.save(tmp_path / "again")
    assert rlg.load(tmp_path / "again").parts().equals(loaded.parts())


def test_mechanisms_without_a_causal_form_are_named(runs: list[rlg.Recording]) -> None:
    simulator = rlg.Simulator(
        (
            ThermalPolynomial(),
            RandomTelegraph(),
            TabulatedLaw(cause="spikes", driver=T, memory="none", knots=(0.0, 9.0), weights=(0.0, 1.0), change="glitch"),
            TabulatedLaw(cause="coolant", driver=T, memory="delay", time_s=60.0, knots=(0.0, 9.0), weights=(0.0, 1.0)),
        )
    )
    model = rlg.Compensator(features="temperature", physics=simulator).fit(runs[:2])
    left_out = [remark.data for remark in model.remarks_ if remark.code == "compensation.physics_left_out"]
    assert [data["mechanism"] for data in left_out] == ["random_telegraph", "spikes", "coolant"]


@pytest.mark.parametrize(
    ("simulator", "message"),
    [
        (rlg.Simulator((RandomTelegraph(),)), "differs from run to run"),
        (rlg.Simulator(()), "no mechanism beside a constant bias"),
        (rlg.Simulator(kind="turntable"), "of a turntable"),
        (rlg.Simulator((ThermalPolynomial(),), output="force_N"), "of force_N, and a compensation is of a gyro"),
        ("augmented.yaml", "give a Simulator"),
    ],
)
def test_physics_that_cannot_serve_is_refused(runs: list[rlg.Recording], simulator: object, message: str) -> None:
    with pytest.raises(rlg.InputError, match=message):
        rlg.Compensator(physics=simulator).fit(runs[:2])


def without_supply(run: rlg.Recording) -> rlg.Recording:
    return run.replace(table=run.table.drop(columns="supply_voltage_V", errors="ignore"))


def test_physics_needs_its_monitors_and_the_lssvm(runs: list[rlg.Recording], short_runs: list[rlg.Recording]) -> None:
    with pytest.raises(rlg.InputError, match="supply_voltage_V"):
        rlg.Compensator(physics=rlg.Simulator((SupplyVoltage(),))).fit([without_supply(run) for run in short_runs[:2]])
    with pytest.raises(rlg.InputError, match="physics is for the lssvm"):
        rlg.Compensator(rlg.CubicLeastSquares(), physics=SIMULATORS["plays"]).fit(runs[:2])


def test_a_manifest_whose_physics_is_not_the_models_is_refused(hybrid: rlg.Compensator, tmp_path: Path) -> None:
    from rlgcomp.compensation import artefact

    hybrid.save(tmp_path / "model")
    saved = artefact.read(tmp_path / "model")
    saved.manifest["model"]["parameters"]["linear"] = saved.manifest["model"]["parameters"]["linear"][:-1]
    del saved.manifest["schema"], saved.manifest["arrays"]
    artefact.write(tmp_path / "other", saved, "")
    with pytest.raises(rlg.InputError, match="coef_"):
        rlg.load(tmp_path / "other")


# --- C ---------------------------------------------------------------------------------------------------------------------------


@needs_gcc
@pytest.mark.parametrize(("name", "kernel"), [*((name, True) for name in SIMULATORS), ("mechanisms", False)])
def test_every_sample_of_the_c_agrees(
    hybrids: dict[str, rlg.Compensator],
    runs: list[rlg.Recording],
    name: str,
    kernel: bool,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    if not kernel:  # the same physics, and less beside it, that every compiler translates in the other case
        monkeypatch.setattr(tools, "TOOLCHAINS", tools.TOOLCHAINS[:1])
    elif name not in ("mechanisms", "laws"):  # one law each, that one compiler optimises and the other examines
        monkeypatch.setattr(tools, "TOOLCHAINS", (tools.TOOLCHAINS[1], tools.TOOLCHAINS[2]))
    model = hybrids[name]
    other = rlg.Compensator()
    other.__dict__.update(model.__dict__)
    X, y, _ = model.training_rows()
    fitted = rlg.LSSVMRegressor(c=100.0 if kernel else WITHOUT_KERNEL, sigma=3.0, linear=model.scaling_.linear)
    other.model_ = fitted.fit(X, y)
    other.save(tmp_path / "model")
    options = Options(runs=[runs[2].between(0.0, 7000.0)], board=False)
    made = export(tmp_path / "model", tmp_path / "c", "c", options)
    checks = made.to_mapping()["checks"]
    assert checks
    assert all(check["largest_deg_h"] <= 1e-12 * made.summary["span_deg_h"] for check in checks)
    assert all(check["share"] <= 1.0 for check in checks)
    assert (made.summary["centres"] > 0) == kernel
    assert made.summary["state_bytes"] > 0


def test_the_budget_of_tables_holds_those_of_known_physics(
    hybrids: dict[str, rlg.Compensator], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tools, "TOOLCHAINS", ())
    model = rlg.Compensator()
    model.__dict__.update(hybrids["laws"].__dict__)
    X, y, _ = model.training_rows()
    model.model_ = rlg.LSSVMRegressor(c=100.0, sigma=0.5, linear=model.scaling_.linear).fit(X, y)
    model.save(tmp_path / "model")
    physics = physics_bytes(model.pipeline_, "double")
    assert physics > 400
    whole = export(tmp_path / "model", tmp_path / "whole", "c", Options(board=False)).summary
    budget = whole["table_bytes"] - 1000
    small = export(tmp_path / "model", tmp_path / "small", "c", Options(board=False, max_bytes=budget))
    assert small.summary["table_bytes"] <= budget
    assert 0 < small.summary["centres"] < whole["centres"]
    sizes = small.curve.set_index("centres")["table_bytes"]
    assert sizes[small.summary["centres"]] == small.summary["table_bytes"]
    text = (tmp_path / "small" / "model.c").read_text(encoding="ascii")
    tables = re.sub(r"/\*.*?\*/", "", text[text.index("static const real LOW") : text.index("/* Infinity")], flags=re.DOTALL)
    bodies = re.findall(r"= (\{.*?\});", tables, flags=re.DOTALL)
    assert small.summary["table_bytes"] == 8 * sum(len(re.findall(r"[^{},\s]+", body)) for body in bodies)
    with pytest.raises(rlg.InputError, match=f"fewer mechanisms in --physics, whose tables take {physics} of them"):
        export(tmp_path / "model", tmp_path / "out", "c", Options(board=False, max_bytes=physics))


@pytest.mark.skipif(tools.TOOLCHAINS[-1].missing is not None, reason="no emulated Cortex-M4")
def test_a_cortex_m4_gives_what_python_gives(
    hybrid: rlg.Compensator, runs: list[rlg.Recording], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tools, "TOOLCHAINS", tools.TOOLCHAINS[-1:])
    other = rlg.Compensator()
    other.__dict__.update(hybrid.__dict__)
    X, y, _ = hybrid.training_rows()
    other.model_ = rlg.LSSVMRegressor(c=100.0, sigma=3.0, linear=hybrid.scaling_.linear).fit(X, y)
    other.save(tmp_path / "model")
    made = export(tmp_path / "model", tmp_path / "c", "c", Options(runs=[runs[2].between(0.0, 1500.0)]))
    checks = [check for check in made.to_mapping()["checks"] if "Cortex-M4" in check["toolchain"]]
    assert len(checks) == 2
    assert all(check["largest_deg_h"] <= 1e-12 * made.summary["span_deg_h"] for check in checks)


@pytest.mark.parametrize(
    ("to", "options", "message"),
    [
        ("c", Options(precision="float", board=False), "double precision"),
        ("c", Options(libm=False, board=False), "cos and sin"),
        pytest.param("onnx", Options(board=False), "export it with --to c", marks=pytest.mark.needs("onnx")),
    ],
)
def test_what_cannot_be_exported_is_refused(
    hybrid: rlg.Compensator, to: str, options: Options, message: str, tmp_path: Path
) -> None:
    hybrid.save(tmp_path / "model")
    with pytest.raises(rlg.InputError, match=message):
        export(tmp_path / "model", tmp_path / "out", to, options)


# --- the command line ---------------------------------------------------------------------------------------------------------


@pytest.mark.usefixtures("undrawn")
def test_train_with_a_simulator_file(runs: list[rlg.Recording], tmp_path: Path) -> None:
    files = []
    for k, run in enumerate(runs[:2]):
        rlg.write(run, tmp_path / f"run{k}.parquet")
        files.append(str(tmp_path / f"run{k}.parquet"))
    SIMULATORS["plays"].to_yaml(tmp_path / "augmented.yaml")
    arguments = ["train", *files, "--physics", str(tmp_path / "augmented.yaml"), "--features", "temperature"]
    done = CliRunner().invoke(app, [*arguments, "--out", str(tmp_path / "model")])
    assert done.exit_code == 0, done.output
    assert "What each part does" in done.output
    assert rlg.load(tmp_path / "model").scaling_.linear
    report = CliRunner().invoke(app, ["evaluate", str(tmp_path / "model"), files[1], "--out", str(tmp_path / "report")])
    assert report.exit_code == 0, report.output
    assert "What each part does" in (tmp_path / "report" / "report.html").read_text(encoding="utf-8")


def test_a_stream_carries_the_state_of_hysteresis_and_hops(
    hybrid: rlg.Compensator, runs: list[rlg.Recording], tmp_path: Path
) -> None:
    hybrid.save(tmp_path / "model")
    rlg.write(runs[2], tmp_path / "run.csv")
    arguments = ["compensate", str(tmp_path / "model"), str(tmp_path / "run.csv"), "--out", str(tmp_path / "clean.csv")]
    done = CliRunner().invoke(app, [*arguments, "--follow", "--idle-s", "0.1"])
    assert done.exit_code == 0, done.output
    streamed = pd.read_csv(tmp_path / "clean.csv")["compensation_deg_h"].to_numpy()
    assert np.array_equal(streamed, hybrid.predict(rlg.read(tmp_path / "run.csv"))["bias_deg_h"].to_numpy())


def test_auto_is_the_augmented_simulator_of_a_diagnosis(
    runs: list[rlg.Recording], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    given: dict[str, object] = {}

    def diagnosed(simulator: rlg.Simulator, train: list[rlg.Recording], **options: object) -> SimpleNamespace:
        given.update(simulator=simulator, runs=len(train), **options)
        return SimpleNamespace(augmented=SIMULATORS["plays"], sentence="Something was found.")

    monkeypatch.setattr("rlgcomp.diagnosis.diagnose.diagnose", diagnosed)
    rlg.write(runs[0], tmp_path / "run.parquet")
    arguments = ["train", str(tmp_path / "run.parquet"), "--physics", "auto", "--features", "temperature"]
    done = CliRunner().invoke(app, [*arguments, "--out", str(tmp_path / "model")])
    assert done.exit_code == 0, done.output
    assert [mechanism.name for mechanism in given["simulator"].mechanisms] == ["thermal_polynomial", "temperature_rate"]
    assert all(given["simulator"].free.values())
    assert given["runs"] == 1
    mechanisms = {one.mechanism for one in rlg.load(tmp_path / "model").pipeline_.features if one.kind == "physics"}
    assert mechanisms == {"thermal_hysteresis", "thermal_gradient"}


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--physics", "missing.yaml"], "missing.yaml does not exist"),
        (["--physics", "auto", "--model", "cubic"], "--physics is for --model lssvm"),
        (["--simulator", "gyro.yaml"], "--simulator is for --physics auto"),
        (["--physics", "auto", "--device", "cpu"], "--physics is for --model lssvm"),
    ],
)
def test_options_that_do_not_go_together_are_refused(
    runs: list[rlg.Recording], tmp_path: Path, arguments: list[str], message: str
) -> None:
    rlg.write(runs[0], tmp_path / "run.parquet")
    done = CliRunner().invoke(app, ["train", str(tmp_path / "run.parquet"), *arguments, "--out", str(tmp_path / "model")])
    assert done.exit_code == 2
    assert message in done.output
    assert "Traceback" not in done.output
    assert not (tmp_path / "model").exists()
