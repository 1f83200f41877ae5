"""The diagnosis of the one-model engine as scripts use it: attributes, plain data, messages, files and its page."""

from __future__ import annotations

import dataclasses
import html
import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from typer.testing import CliRunner, Result

import rlgcomp as rlg
from rlgcomp.challenge.score import Hidden, Score
from rlgcomp.cli import register_commands
from rlgcomp.cli.base import app
from rlgcomp.diagnosis.answer.fit import Estimate
from rlgcomp.diagnosis.diagnose import diagnose
from rlgcomp.diagnosis.report import text
from rlgcomp.diagnosis.report.result import Diagnosis
from rlgcomp.diagnosis.report.text import VERDICTS, place_text
from rlgcomp.diagnosis.search.process import Process
from rlgcomp.errors import InputError
from rlgcomp.physics.user import user_catalogue
from rlgcomp.recording import Recording
from rlgcomp.simulation.simulator import Simulator
from tests.own_mechanism import write_bellows
from tests.two_hour_runs import BASELINE, REAL, runs_of

FEW = ("supply_voltage", "magnetic_field", "temperature_rate")
WINDOW_S = 80.0  # twice those by default: half as many windows
COARSE: dict[str, Any] = {"window_s": 4.0 * WINDOW_S, "black_box": False}  # where details are not the matter


@pytest.fixture(scope="module")
def runs() -> list[Recording]:
    return runs_of(REAL)


@pytest.fixture(scope="module")
def found(runs: list[Recording]) -> Diagnosis:
    return diagnose(BASELINE, runs[:1], runs[2:], confirm=runs[1:2], only=FEW, window_s=WINDOW_S)


def test_what_is_taken_off_of_runs_that_lack_nothing_is_said_above_the_table() -> None:
    """Else nothing is missing, and the error falls by nine tenths all the same."""
    healthy = runs_of(BASELINE, 2)
    shifted = [
        run.replace(table=run.table.assign(gyro_deg_h=run.rate_deg_h() + 0.5 * (-1.0) ** k)) for k, run in enumerate(healthy)
    ]
    found = diagnose(BASELINE, shifted, only=("supply_voltage",), **COARSE)
    assert found.verdict == "none"
    assert "after includes run bias, which is no missing physics" in str(found)
    assert found.train.augmented_rms < 0.2 * found.train.baseline_rms


def test_a_cause_prints_without_the_fit_that_it_is_of(found: Diagnosis) -> None:
    (cause,) = found.causes
    assert cause.function is not None
    assert "supply_voltage" in repr(cause)
    assert len(repr(cause)) < 1000


def test_the_seed_is_of_p_values_and_intervals_and_of_nothing_else(runs: list[Recording]) -> None:
    healthy = runs_of(BASELINE)
    one, same, other = (diagnose(BASELINE, healthy[:1], healthy[2:], seed=seed, only=FEW[:1], **COARSE) for seed in (0, 0, 1))
    assert one.test is not None
    assert other.test is not None
    assert (one.to_mapping() | {"provenance": 0}) == (same.to_mapping() | {"provenance": 0})
    assert one.p_value != other.p_value
    assert one.test.improvement_ci95 != other.test.improvement_ci95
    assert (one.healthy, one.test.augmented_rms) == (other.healthy, other.test.augmented_rms)
    assert (one.provenance["seed"], other.provenance["seed"]) == (0, 1)


def test_its_attributes_are_those_that_scripts_use(found: Diagnosis) -> None:
    assert found.verdict == "explained"
    (cause,) = found.causes
    assert cause.name == "supply_voltage"
    assert cause.probability > 0.99
    estimate = cause.parameters["k_deg_h_V"]
    assert abs(estimate.value - 0.5) < 4.0 * estimate.sd
    assert estimate.unit == "deg/h/V"
    assert cause.drivers == ("supply_voltage_V",)
    assert found.p_value <= found.healthy < 1e-6
    assert found.probability > 0.01
    assert found.unexplained_p_value > 0.01
    intervals = [place for place in found.where if place.regime is None]
    assert sorted({place.run for place in intervals}) == ["run0"]
    assert 0.75 < sum(place.share for place in intervals) < 1.0
    regimes = {place.regime: place.share for place in found.where if place.regime is not None}
    assert set(regimes) == {f"supply_voltage_V {way}" for way in ("rising", "falling", "steady")}
    assert sum(regimes.values()) == pytest.approx(1.0)
    assert found.test is not None
    assert found.test.improvement_ci95[0] > 0.3
    assert found.train.baseline_rms > found.train.augmented_rms
    assert isinstance(found.to_frame(), pd.DataFrame)
    assert "supply_voltage" in str(found)
    assert "supply_voltage" in found._repr_html_()
    assert found.noise.angle_random_walk_deg_sqrt_h == pytest.approx(0.0005, rel=0.15)


def test_the_function_found_is_a_table_with_units(found: Diagnosis) -> None:
    table = found.findings[0]["function"]
    assert (table["kind"], table["of"], table["of_unit"], table["unit"]) == ("static", "supply_voltage_V", "V", "deg/h")
    slope = np.polyfit(table["driver"], table["value"], 1)[0]
    assert slope == pytest.approx(0.5, rel=0.2)
    assert all(sd > 0.0 for sd in table["sd"])


def test_its_json_has_the_keys_of_the_contract(found: Diagnosis, tmp_path: Path) -> None:
    found.save(tmp_path)
    content = json.loads((tmp_path / "diagnosis.json").read_text())
    keys = {"schema", "verdict", "mismatch", "findings", "alternatives", "unexplained", "fit", "next_experiment", "remarks", "runs"}
    assert keys | {"provenance", "probability", "nothing_missing", "steps"} <= set(content)
    assert [one["run"] for one in content["runs"]["train"]] == ["run0"]
    assert [one["run"] for one in content["runs"]["confirm"]] == ["run1"]
    assert [one["run"] for one in content["runs"]["test"]] == ["run2"]
    assert content["fit"]["confirm"]["per_run"][0]["run"] == "run1"
    assert set(content["baseline"]) == {"thermal_polynomial"}
    assert all(set(one) == {"code", "data", "text"} for one in content["remarks"] + content["messages"])
    scored = Score.of(Hidden(("supply_voltage",), {"supply_voltage.k_deg_h_V": 0.5}), content)
    assert scored.exact
    assert scored.verdict_right
    assert abs(scored.errors_sd["supply_voltage.k_deg_h_V"]) < 4.0


def test_messages_are_codes_and_data(found: Diagnosis) -> None:
    headline, gain = found.messages
    assert headline.code == "diagnosis.causes"
    assert headline.data["causes"][0]["mechanism"] == "supply_voltage"
    assert gain.code == "diagnosis.gain"
    assert gain.data["improvement"] == found.test.improvement
    codes = {one.code: one.data for one in found.remarks}
    assert codes["diagnosis.confirmed"] == {"runs": ["run1"]}
    assert codes["diagnosis.only"] == {"mechanisms": list(FEW)}


def with_slow_error(found: Diagnosis, *, missing: bool) -> Diagnosis:
    """The same, with a wander of 0.3 of the white noise beside the set."""
    best, after = found.posterior.best, found.after
    noise = dataclasses.replace(after.state.noise, wander=0.3)
    posterior = dataclasses.replace(found.posterior, states=(dataclasses.replace(best, noise=noise, log_point=1e6),))
    fit = dataclasses.replace(after, state=dataclasses.replace(after.state, noise=noise))
    decision = dataclasses.replace(found.decision, verdict="unknown" if missing else "explained", wander=missing)
    return dataclasses.replace(found, posterior=posterior, after=fit, decision=decision)


def test_a_slow_error_of_the_set_is_in_the_headline(found: Diagnosis) -> None:
    """However small it is, and beside laws as well."""
    small = with_slow_error(found, missing=False)
    slow = small.messages[0].data["slow_error"]
    assert not slow["missing"]
    assert slow["rms"] == pytest.approx(0.3 * small.after.white)
    assert slow["probability"] > 0.99
    assert small.after.noise_rms / small.after.white == pytest.approx(found.after.noise_rms / found.after.white)
    assert text.slow_error_rows(small) == []
    missing = with_slow_error(found, missing=True)
    assert missing.messages[0].code == "diagnosis.wander"
    assert len(text.member_rows(missing)) == len(missing.members) + 1
    (law,) = (dataclasses.replace(one, mechanism=None) for one in missing.decision.named)
    of_law = dataclasses.replace(missing, decision=dataclasses.replace(missing.decision, named=(law,))).messages[0]
    assert of_law.code == "diagnosis.law"
    assert of_law.data["slow_error"]["missing"]
    assert found.messages[0].data["slow_error"] is None


def test_a_delay_that_is_not_stated_is_not_left_out_of_the_file(found: Diagnosis) -> None:
    def parts(**lags: Estimate) -> list[str]:
        fit = dataclasses.replace(found.after)
        vars(fit)["numbers"] = {"late thermometer": lags}
        beside = dataclasses.replace(found, after=fit)
        vars(beside)["augmented_file"] = dataclasses.replace(
            found.augmented_file, left_out=("late temperature_block_degC", "mode_hop")
        )
        codes = {one.code: one.data for one in beside.remarks}
        assert ("diagnosis.late_thermometer" in codes) == ("late temperature_block_degC" in codes["diagnosis.not_in_file"]["parts"])
        return list(codes["diagnosis.not_in_file"]["parts"])

    assert parts(temperature_block_degC=Estimate(2.0, 0.8, "s")) == ["mode_hop"]
    assert parts(temperature_block_degC=Estimate(2.0, 0.2, "s")) == ["late temperature_block_degC", "mode_hop"]


def test_a_two_state_process_has_its_name_in_the_set(found: Diagnosis) -> None:
    process = Process(1.0, 1.0, 10.0, np.ones(3), 5.0, 0.0)
    best = dataclasses.replace(found.posterior.best, process=process, log_point=1e6)
    beside = dataclasses.replace(found, posterior=dataclasses.replace(found.posterior, states=(best,)))
    assert text.likely_sets(beside)[0][0] == "supply_voltage + random_telegraph"


def test_the_file_predicts_as_the_augmented_simulator(found: Diagnosis, runs: list[Recording], tmp_path: Path) -> None:
    found.save(tmp_path)
    again = Simulator.from_yaml(tmp_path / "augmented.yaml")
    one, other = (simulator.predict(runs[2]).rate_deg_h() for simulator in (found.augmented, again))
    np.testing.assert_array_equal(one, other)
    (run,) = found.test_runs
    fitted = run.means(found.after.predicted(run))
    assert np.std(run.means(run.on_bins_of_rows(one)) - fitted) < 0.1 * found.after.white
    assert found.augmented_file.error < 0.1
    assert {"thermal_polynomial", "supply_voltage"} <= {mechanism.name for mechanism in again.mechanisms}


def test_the_augmented_simulator_lacks_nothing(found: Diagnosis, runs: list[Recording]) -> None:
    again = diagnose(found.augmented, runs[1:], only=FEW, **COARSE)
    assert again.verdict == "none"
    assert again.p_value > 0.01
    assert again.where == ()
    assert again.messages[0].code == "diagnosis.nothing_missing"


def test_the_page_holds_what_was_found(found: Diagnosis, tmp_path: Path) -> None:
    found.report(tmp_path / "report.html")
    page = html.unescape((tmp_path / "report.html").read_text())
    assert page.count("<svg") >= 3
    sentences = [one.text.replace("supply_voltage ", "supply voltage ") for one in found.messages]
    for part in (*sentences, "<h1>The simulator lacks supply voltage</h1>", "supply_voltage_V", "run1", "run2", "deg/h"):
        assert part in page


def with_cause(found: Diagnosis, **changes: Any) -> Diagnosis:
    """The same with another finding."""
    other = dataclasses.replace(found)
    vars(other)["members"] = tuple(dataclasses.replace(one, **changes) for one in found.members)
    return other


def told(found: Diagnosis, code: str) -> list[str]:
    """Texts of the remarks of a code."""
    return [one.text for one in found.remarks if one.code == f"diagnosis.{code}"]


def test_the_first_sentence_has_the_verdict(found: Diagnosis) -> None:
    assert str(found).startswith("Verdict: explained (each effect found has a known mechanism). The simulator lacks")
    for verdict in VERDICTS:
        other = dataclasses.replace(found, decision=dataclasses.replace(found.decision, verdict=verdict))
        assert str(other).startswith(f"Verdict: {verdict}")


def test_shares_are_those_of_all_that_is_missing(found: Diagnosis) -> None:
    rows, _ = text.place_rows(found)
    assert rows[-1][0] == text.REST
    assert sum(float(share.removesuffix(" %")) for _, share in rows) == pytest.approx(100.0, abs=1.5)
    assert text.REST in str(found)


def test_a_form_that_is_not_determined_is_told_as_that(found: Diagnosis) -> None:
    other = with_cause(found, approximate=True, parameters={}, undetermined=("k", "c"), equation="b = k f(V)")
    assert "about b = k f(V): the driver is determined, the form is not" in str(other)
    assert "so k and c of that equation stay undetermined" in told(other, "approximate")[0]
    assert "so k of that equation stays undetermined" in told(with_cause(other, undetermined=("k",)), "approximate")[0]


def test_a_term_that_is_larger_than_the_mismatch_is_told(found: Diagnosis) -> None:
    assert not told(found, "larger_than_mismatch")
    large = with_cause(found, rms=3.4 * found.train.baseline_rms)
    assert "is larger than the whole mismatch" in told(large, "larger_than_mismatch")[0]


def test_a_line_of_another_phase_in_each_run_is_told_as_that(found: Diagnosis) -> None:
    line = with_cause(found, runs={"run0": 0.0066, "run1": 0.0065}, has_mean=False)
    (sentence,) = told(line, "phase_by_run")
    assert "The phase of supply_voltage differs from run to run" in sentence
    assert "test runs are predicted without it" in sentence
    assert not told(line, "strength_by_run")
    line = with_cause(line, has_mean=True)
    assert "other runs are predicted with the mean amplitude" in told(line, "strength_by_run")[0]
    assert not told(line, "phase_by_run")


def test_biases_of_runs_are_told_beside_the_gain_about_their_means(found: Diagnosis) -> None:
    fit = dataclasses.replace(found.after)
    vars(fit)["numbers"] = {"run bias": {"run0": Estimate(0.5, 0.1, "deg/h")}}
    beside = dataclasses.replace(found, after=fit)
    assert found.test is not None
    assert f"own mean there is {100.0 * found.test.improvement_std:.0f} % less error" in told(beside, "run_biases")[0]
    assert "mean" not in told(dataclasses.replace(beside, test_runs=()), "run_biases")[0]


def test_a_two_state_process_is_told_not_to_be_in_the_file(found: Diagnosis, runs: list[Recording], tmp_path: Path) -> None:
    """It was absent without a word, and its own numbers were beyond the bounds of a simulator file."""
    numbers = {"half_step_deg_h": Estimate(1344.0, 11.0, "deg/h"), "dwell_s": Estimate(2.5, 0.4, "s")}
    beside = with_cause(found, name="random_telegraph", parameters=numbers)
    (sentence,) = told(beside, "telegraph_not_in_file")
    assert "the test runs among them, are predicted without it" in sentence
    added = sentence.partition("`- ")[2].partition("`")[0]
    (tmp_path / "gyro.yaml").write_text(f"kind: chamber\nmechanisms:\n- {added}\n")
    simulator = Simulator.from_yaml(tmp_path / "gyro.yaml")
    (telegraph,) = simulator.mechanisms
    assert telegraph.to_mapping() == {"half_step_deg_h": 1344.0, "dwell_s": 2.5}
    assert not simulator.predict(runs[0]).rate_deg_h().any()


def test_candidates_can_be_left_out(runs: list[Recording]) -> None:
    found = diagnose(BASELINE, runs[:1], only=FEW, without=["supply_voltage"], **COARSE)
    assert found.verdict == "unknown"
    assert found.decision.drivers == ("supply_voltage_V",)
    content = found.to_mapping()
    assert content["unexplained"]["laws"][0]["function"]["of"] == "supply_voltage_V"
    assert [one.code for one in found.messages] == ["diagnosis.law", "diagnosis.no_test_runs"]
    assert {one.code: one.data for one in found.remarks}["diagnosis.left_out"] == {"mechanisms": ["supply_voltage"]}
    with pytest.raises(InputError, match="'no_such' is no candidate"):
        diagnose(BASELINE, runs[:1], without=["no_such"])


def test_an_output_of_another_unit_is_told_in_it(runs: list[Recording], tmp_path: Path) -> None:
    with_force = [run.replace(table=run.table.assign(force_N=1e3 * run.column("gyro_deg_h")), truth=None) for run in runs]
    found = diagnose(BASELINE, with_force[:1], with_force[2:], output="force_N", only=FEW[:1], window_s=4.0 * WINDOW_S)
    assert [cause.name for cause in found.causes] == ["supply_voltage"]
    content = found.to_mapping()
    assert content["output"] == {"column": "force_N", "unit": "N"}
    assert content["findings"][0]["parameters"]["k_deg_h_V"]["unit"] == "N/V"
    assert content["findings"][0]["parameters"]["k_deg_h_V"]["value"] == pytest.approx(500.0, rel=0.2)
    assert content["fit"]["test"]["unit"] == "N"
    found.report(tmp_path / "report.html")
    assert "deg/h" not in str(found) + found.sentence
    with pytest.raises(InputError, match="output is 'torque_N_m'"):
        diagnose(BASELINE, runs[:1], output="torque_N_m")


def test_a_users_own_simulator_is_a_column(runs: list[Recording]) -> None:
    """Its output instead of itself is given in tests/test_clocks.py and tests/test_user_simulator.py."""

    def simulated(run: Recording) -> np.ndarray:
        return BASELINE.predict(run).rate_deg_h()

    found = diagnose(simulated, runs[:1], runs[2:], only=FEW[:1], **COARSE)
    assert [cause.name for cause in found.causes] == ["supply_voltage"]
    assert "diagnosis.beside_own_simulator" in {one.code for one in found.remarks}
    assert "thermal_polynomial" not in {mechanism.name for mechanism in found.augmented.mechanisms}


def test_one_of_several_gyros(runs: list[Recording]) -> None:
    two = []
    for run in runs[:1]:
        table = run.table.drop(columns="gyro_deg_h")
        table = table.assign(gyro_x_deg_s=run.column("gyro_deg_h") / 3600.0, gyro_y_deg_s=0.001 * np.arange(len(run)))
        two.append(run.replace(table=table, truth=None))
    found = diagnose(BASELINE, two[:1], gyro="gyro_x_deg_s", only=FEW[:1], **COARSE)
    assert [cause.name for cause in found.causes] == ["supply_voltage"]
    assert found.to_mapping()["output"]["column"] == "gyro_x_deg_s"


def test_a_mechanism_of_the_users_is_a_candidate(runs: list[Recording], tmp_path: Path) -> None:
    own = user_catalogue([write_bellows(tmp_path / "bellows.py")])
    pressure = [run.column("pressure_hPa") for run in runs]
    scale = 0.02 / np.std((np.concatenate(pressure) - 1010.0) ** 2)
    bent = [
        run.replace(table=run.table.assign(gyro_deg_h=run.column("gyro_deg_h") + scale * (p - 1010.0) ** 2), truth=None)
        for run, p in zip(runs, pressure, strict=True)
    ]
    found = diagnose(REAL, bent[:1], bent[2:], mechanisms=own, only=["bellows", "ambient_pressure"], **COARSE)
    (cause,) = found.causes
    assert cause.name == "bellows"
    found.save(tmp_path)
    again = Simulator.from_yaml(tmp_path / "augmented.yaml", own)
    (written,) = [mechanism for mechanism in again.mechanisms if mechanism.name == "bellows"]
    assert written.to_mapping()["k_deg_h_hPa2"] == pytest.approx(scale, rel=0.3)


# --- the command ---------------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def folder(runs: list[Recording], tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("runs")
    for run in runs:
        rlg.write(run, folder / f"{run.name}.parquet")
        run.table.rename(columns={"gyro_deg_h": "force_N"}).to_csv(folder / f"{run.name}.csv", index=False)
    BASELINE.to_yaml(folder / "gyro.yaml")
    return folder


def command(folder: Path, *arguments: str) -> Result:
    register_commands()
    placed = [str(folder / one) if one.endswith((".parquet", ".csv", ".yaml")) else one for one in arguments]
    return CliRunner().invoke(
        app, ["diagnose", "--simulator", str(folder / "gyro.yaml"), *placed, "--averaging-s", str(4.0 * WINDOW_S), "--only", *FEW]
    )


@pytest.mark.usefixtures("undrawn")
def test_the_command_writes_what_it_found(folder: Path, tmp_path: Path) -> None:
    files = ("--train", "run0.parquet", "--confirm", "run1.parquet", "--test", "run2.parquet")
    result = command(folder, *files, "--json", "--out", str(tmp_path / "out"))
    assert result.exit_code == 0
    content = json.loads(result.stdout)
    assert [one["mechanism"] for one in content["findings"]] == ["supply_voltage"]
    assert [Path(one["file"]).name for one in content["runs"]["confirm"]] == ["run1.parquet"]
    assert all(len(one["sha256"]) == 64 for part in content["runs"].values() for one in part)
    assert {path.name for path in (tmp_path / "out").iterdir()} == {"diagnosis.json", "augmented.yaml", "report.html", "figures"}


@pytest.mark.usefixtures("undrawn")
def test_the_command_diagnoses_a_quantity_that_is_no_gyro(folder: Path, tmp_path: Path) -> None:
    arguments = ("--train", "run0.csv", "--output", "force_N", "--json", "--out", str(tmp_path / "out"))
    content = json.loads(command(folder, *arguments).stdout)
    assert content["output"] == {"column": "force_N", "unit": "N"}
    assert content["findings"][0]["parameters"]["k_deg_h_V"]["unit"] == "N/V"
    page = (tmp_path / "out" / "report.html").read_text()
    for unit in ("deg_h", "deg_<wbr>h", "deg/h", "deg/√h"):
        assert unit not in re.sub(r"<pre.*?</pre>|<style.*?</style>", "", page, flags=re.DOTALL)


@pytest.mark.usefixtures("undrawn")
def test_what_was_found_of_another_quantity_predicts_it(folder: Path, tmp_path: Path) -> None:
    """The file says which column it is of: without a gyro in either file, and with nothing in deg/h."""
    assert command(folder, "--train", "run0.csv", "--output", "force_N", "--out", str(tmp_path / "out")).exit_code == 0
    augmented, made = str(tmp_path / "out" / "augmented.yaml"), tmp_path / "predicted.csv"
    result = CliRunner().invoke(app, ["predict", augmented, str(folder / "run0.csv"), "--out", str(made), "--json"])
    assert result.exit_code == 0
    content = json.loads(result.stdout)
    assert (content["output"], content["columns"][-1]) == ("force_N", "force_N")
    measured, predicted = pd.read_csv(folder / "run0.csv"), pd.read_csv(made)
    assert list(predicted) == content["columns"]
    assert "gyro_deg_h" not in predicted
    left = measured["force_N"] - predicted["force_N"]
    assert left.std() < 0.8 * measured["force_N"].std()  # the rest is white noise
    assert abs(left.mean()) < 0.1 * left.std()
    measured.drop(columns="force_N").to_csv(tmp_path / "other.csv", index=False)
    for arguments, message in (
        (["simulate", augmented, "--out", str(tmp_path / "run.csv")], "this simulator is of force_N"),
        (["predict", augmented, str(tmp_path / "other.csv"), "--out", str(made)], "that the simulator predicts"),
    ):
        refused = CliRunner().invoke(app, arguments)
        assert message in f"{refused.output} {refused.exception}"


# --- in Python -----------------------------------------------------------------------------------------------------------------


def test_a_finding_is_a_formula_and_a_function(found: Diagnosis, runs: list[Recording]) -> None:
    (cause,) = found.causes
    assert cause.latex.startswith("b = ")
    values = cause(runs[2])
    (run,) = found.test_runs
    fitted = run.window_means(found.after.term(0, run))
    called = run.window_means(run.on_bins_of_rows(values))
    assert np.std(called - fitted) < 0.1 * found.after.white


@pytest.mark.needs("sympy")
def test_a_finding_is_an_expression(found: Diagnosis) -> None:
    import sympy as library

    (cause,) = found.causes
    assert library.Symbol("k_deg_h_V", real=True) in cause.sympy().free_symbols
    assert library.Symbol("k_deg_h_V", real=True) not in cause.sympy(numbers=True).free_symbols


def test_it_is_plotted_as_its_page_shows_it(found: Diagnosis) -> None:
    from matplotlib import pyplot, use

    use("agg")
    axes = found.plot()
    assert [axis.get_title(loc="left").partition(":")[0].partition(" (")[0] for axis in axes] == [
        "run2",
        "supply voltage",
        "Before and after, test runs",
    ]
    assert axes[1].get_xlabel() == "supply voltage, V"
    _, axis = pyplot.subplots()
    assert found.plot(axis, run="run0") is axis
    assert axis.get_title(loc="left").startswith("run0 (train)")
    with pytest.raises(InputError, match="run is 'run9'"):
        found.plot(run="run9")
    pyplot.close("all")


def test_it_states_when_and_how_it_was_made(found: Diagnosis) -> None:
    content = found.to_mapping()
    assert content == found.to_mapping()
    assert content["provenance"]["seed"] == 0
    assert {"version", "date", "command", "inputs"} <= set(content["provenance"])


def test_every_key_stands_on_the_page_of_the_reference(found: Diagnosis) -> None:
    page = (Path(__file__).parents[1] / "docs/reference/diagnosis_json.md").read_text(encoding="utf-8")
    cells = " ".join(row.split(" | ")[0] for row in page.splitlines() if row.startswith("| `"))
    told = {name.split(".")[0] for name in re.findall(r"`([\w.]+)", cells)}
    assert not set(found.to_mapping()) - told


def test_places_are_told_in_the_unit_of_the_run(found: Diagnosis) -> None:
    """Fault 18: runs of seconds told in hours."""
    (place, *_) = found.where
    assert place_text(place).startswith("run0 gyro_deg_h, ")
    assert place_text(dataclasses.replace(place, start_s=0.0, end_s=9000.0, regime=None)) == "run0 gyro_deg_h, 0 to 2.5 h"
    assert (
        place_text(dataclasses.replace(place, start_s=86401.5, end_s=86409.0, regime=None), 86400.0)
        == "run0 gyro_deg_h, 1.5 to 9 s"
    )
    assert place_text(dataclasses.replace(place, start_s=1.5, end_s=9.0, regime=None)) == "run0 gyro_deg_h, 1.5 to 9 s"
