"""Monitors of a run that has not been made: they answer as those of the recordings do."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

import rlgcomp as rlg
from rlgcomp.diagnosis.next_experiment.laboratory import Laboratory
from rlgcomp.numerics.filters import lag, rate_per_min
from rlgcomp.simulation.plant import ThermalPlant
from rlgcomp.simulation.programme import Programme

BLOCK_LAG_S = 900.0


def recorded(programme: str, seed: int) -> rlg.Recording:
    """A chamber in which the block is nothing but a lag of the shell, and a voltage that follows it and wanders with a field."""
    time_s = np.arange(0.0, Programme.parse(programme).duration_s, 10.0)
    rng = np.random.default_rng(seed)
    shell = lag(Programme.parse(programme).set_point_degC(time_s), time_s, 300.0)
    wander = np.cumsum(rng.standard_normal(len(time_s)))
    wander -= wander.mean()
    table = pd.DataFrame({"time_s": time_s, "gyro_deg_h": 0.01 * rng.standard_normal(len(time_s))})
    table["temperature_block_degC"] = lag(shell, time_s, BLOCK_LAG_S) + 0.004 * rng.standard_normal(len(time_s))
    table["temperature_shell_degC"] = shell + 0.004 * rng.standard_normal(len(time_s))
    table["supply_voltage_V"] = 15.0 + 1e-3 * shell + 1e-3 * wander
    table["magnetic_field_uT"] = 48.0 + 0.1 * wander
    return rlg.Recording(table, rlg.Metadata(kind="chamber"), name=f"run{seed}")


@pytest.fixture(scope="module")
def runs() -> list[rlg.Recording]:
    cold = "start 20, hold 30, ramp -20 0.8, hold 90, ramp 40 0.8, hold 60"
    return [recorded(cold, 0), recorded("start 20, hold 20, ramp 45 1, hold 60, ramp 0 0.5, hold 60", 1)]


@pytest.fixture(scope="module")
def foreseen(runs: list[rlg.Recording]) -> rlg.Recording:
    programme = Programme.parse("start 10, hold 30, ramp 40 1, hold 60, ramp -10 0.7, hold 60, ramp 30 0.5, hold 600")
    return Laboratory.of(runs).run_of(programme, ThermalPlant(), 20.0)


def test_the_shell_leads_whatever_the_order_of_columns(runs: list[rlg.Recording]) -> None:
    found = Laboratory.of(runs)
    assert (found.lead, *found.followers) == ("temperature_shell_degC", "temperature_block_degC")


def test_a_block_follows_its_shell_as_it_did(foreseen: rlg.Recording) -> None:
    expected = lag(foreseen.column("temperature_shell_degC"), foreseen.time_s, BLOCK_LAG_S)
    np.testing.assert_allclose(foreseen.column("temperature_block_degC"), expected, atol=0.1)


def test_monitors_follow_temperature_and_wander_together(runs: list[rlg.Recording], foreseen: rlg.Recording) -> None:
    assert set(foreseen.columns) == set(runs[0].columns)
    voltage, field = foreseen.column("supply_voltage_V"), foreseen.column("magnetic_field_uT")
    of_field = 0.01 * (field - field.mean())
    design = np.column_stack([np.ones(len(field)), foreseen.column("temperature_shell_degC")])
    left = voltage - of_field - design @ np.linalg.lstsq(design, voltage - of_field, rcond=None)[0]
    assert left.std() < 0.01 * of_field.std()


def test_one_thermometer_is_its_own_lead(runs: list[rlg.Recording]) -> None:
    alone = [run.replace(table=run.table.drop(columns="temperature_shell_degC")) for run in runs]
    found = Laboratory.of(alone)
    assert (found.lead, *found.followers) == ("temperature_block_degC",)
    assert "temperature_block_degC" in found.run_of(Programme.parse("short"), ThermalPlant(), 20.0)


def test_runs_without_a_thermometer_in_common_are_refused(runs: list[rlg.Recording]) -> None:
    first, second = runs
    other = [first.replace(table=first.table.drop(columns="temperature_shell_degC")),
             second.replace(table=second.table.drop(columns="temperature_block_degC"))]  # fmt: skip
    with pytest.raises(rlg.InputError, match="no thermometer in common"):
        Laboratory.of(other)


@pytest.mark.parametrize("begins_s", [0.0, 50_000.0])
def test_what_follows_the_clock_or_a_rate_does_so_again(runs: list[rlg.Recording], begins_s: float) -> None:
    """A pressure that is a straight line in time is no ageing's rival that a programme parts; what wanders by itself is."""
    first, second = (run.replace(table=run.table.assign(time_s=run.time_s + begins_s * k)) for k, run in enumerate(runs))

    def with_pressure(run: rlg.Recording) -> rlg.Recording:
        rate = rate_per_min(run.column("temperature_block_degC"), run.time_s)
        followed = {
            "pressure_hPa": 1010.0 - 4e-4 * run.time_s,
            "light_intensity_V": 2.0 - 0.02 * rate,
            "supply_voltage_V": np.abs(rate),
        }
        return run.replace(table=run.table.assign(**followed))

    recorded = [with_pressure(first).averaged(100.0), with_pressure(second).averaged(100.0)]
    found = Laboratory.of(recorded).run_of(Programme.parse("paper"), ThermalPlant(), 100.0)
    np.testing.assert_allclose(found.column("pressure_hPa"), 1010.0 - 4e-4 * found.time_s, atol=0.02)
    alike = (("ageing", "ambient_pressure"), ("temperature_rate", "light_intensity"), ("rate_asymmetry", "supply_voltage"))
    for pair in (*alike, ("ageing", "magnetic_field"), ("temperature_rate", "rate_asymmetry")):
        forms = [rlg.CATALOGUE[name].grid(recorded)[-1] if name == "ageing" else rlg.CATALOGUE[name]() for name in pair]
        one, other = (form.basis(found)[:, 0] for form in forms)
        assert (abs(np.corrcoef(one, other)[0, 1]) > 0.999) == (pair in alike)


def test_what_wanders_is_foreseen_no_farther_than_it_ever_went() -> None:
    """At rest for hours a random walk looks like temperature, its square, its lags and the clock, and follows none of them."""
    beyond, hours = [], "start 20, hold 300"
    for seed in range(6):
        run = recorded(hours, seed)
        rng = np.random.default_rng([seed, 1])
        warming = 5.0 * -np.expm1(-run.time_s / 3000.0)
        walks = {name: np.cumsum(rng.standard_normal(len(run))) for name in ("magnetic_field_uT", "light_intensity_V")}
        names = [name for name in run.columns if name.startswith("temperature_")]
        temperatures = {name: run.column(name) + warming for name in names}
        run = run.replace(table=run.table.assign(**walks, **temperatures))
        programme = Programme.parse("start 20, hold 30, ramp 25 0.05, hold 60, ramp 22 0.05, hold 60")
        foreseen = Laboratory.of([run]).run_of(programme, ThermalPlant(), 20.0)
        beyond += [float(np.ptp(foreseen.column(name)) / np.ptp(walk)) for name, walk in walks.items()]
    assert np.median(beyond) < 1.2
    assert max(beyond) < 2.5


def test_a_monitor_that_never_moves_is_foreseen_to_stay(runs: list[rlg.Recording]) -> None:
    still = [run.replace(table=run.table.assign(supply_voltage_V=15.0, magnetic_field_uT=0.0)) for run in runs]
    foreseen = Laboratory.of(still).run_of(Programme.parse("short"), ThermalPlant(), 20.0)
    assert foreseen.column("supply_voltage_V") == pytest.approx(15.0)
    assert foreseen.column("magnetic_field_uT") == pytest.approx(0.0, abs=1e-12)
