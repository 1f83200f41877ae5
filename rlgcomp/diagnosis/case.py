"""What a diagnosis weighs: the runs on one grid, the regions, and the simulator calibrated."""

from __future__ import annotations

import dataclasses
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from rlgcomp.diagnosis.data import Data, Grid, Run
from rlgcomp.diagnosis.evidence.bank import Bank
from rlgcomp.diagnosis.evidence.identities import Identity, identities, without_identities
from rlgcomp.diagnosis.forms.bases import Basis, Own
from rlgcomp.diagnosis.forms.drivers import Driver
from rlgcomp.diagnosis.forms.terms import Region
from rlgcomp.diagnosis.next_experiment.laboratory import thermometer_of
from rlgcomp.diagnosis.prepare import SIMULATED, Prepared
from rlgcomp.diagnosis.regions.baseline import Baseline, independent
from rlgcomp.diagnosis.regions.chamber import OTHER_FORM, named, own_bases
from rlgcomp.diagnosis.regions.clocks import clock_regions
from rlgcomp.diagnosis.regions.monitors import laws
from rlgcomp.diagnosis.regions.nuisances import nuisances
from rlgcomp.diagnosis.regions.setting import Setting
from rlgcomp.diagnosis.regions.turntable import turning_regions, with_angle_rows
from rlgcomp.diagnosis.report.record import Request
from rlgcomp.errors import InputError
from rlgcomp.noise.processes import NoiseModel
from rlgcomp.physics.mechanism import Mechanism
from rlgcomp.recording import Recording, rate_name
from rlgcomp.units import is_thermometer

Array = npt.NDArray[np.float64]
_OWN: Final = 1e-9  # of a law's square, which the very law of a mechanism leaves beside itself


class Question(NamedTuple):
    """The data on their design, the regions that are weighed, and the simulator."""

    bank: Bank
    regions: list[Region]
    baseline: Baseline


@dataclasses.dataclass(frozen=True)
class Case:
    """Prepared runs with what was asked of them.

    Parameters
    ----------
    runs : Prepared
    candidates : mapping of str to type of Mechanism
    request : Request
    gyro : str, optional
        Gyro column, where there are several.
    column : str, optional
        Another output than a gyro's.
    window_s : float, optional
        By default such that the longest run has 400 windows.
    noise : NoiseModel, optional
        Measured at rest; by default the slow noise that the simulator states.
    """

    runs: Prepared
    candidates: Mapping[str, type[Mechanism]]
    request: Request
    gyro: str | None = None
    column: str | None = None
    window_s: float | None = None
    noise: NoiseModel | None = None
    _on_grid: dict[int, tuple[Recording, Run]] = dataclasses.field(default_factory=dict, repr=False)

    @property
    def grid(self) -> Grid:
        if self.window_s is None:
            return Grid.of(self.runs.train, every_sample=self.turns)
        return Grid.of_window(self.runs.train, self.window_s, every_sample=self.turns)

    @property
    def turns(self) -> bool:
        """Whether a table turns."""
        return self.runs.base.kind == "turntable"

    def recorded(self, binned: Recording) -> Array:
        """Bin means of the output."""
        gyro = self.gyro if self.gyro is None or self.gyro in binned else rate_name(self.gyro)  # means are in deg/h
        return binned.rate_deg_h(gyro) if self.column is None else binned.column(self.column)

    def output(self, binned: Recording) -> Array:
        """Bin means of the output less what the simulator states."""
        known = binned.column(SIMULATED) if self.runs.own else Baseline(self.runs.base).stated(binned)
        return np.asarray(self.recorded(binned) - known)

    def data(self, recordings: Sequence[Recording]) -> Data:
        """Recordings on the grid of the training runs."""
        other = tuple(name for name in (self.column, SIMULATED if self.runs.own else None) if name is not None)
        stated = self.runs.base.noise if self.noise is None and self.column is None else self.noise
        return Data(tuple(self._run(recording, other) for recording in recordings), other, stated)

    def _run(self, recording: Recording, other: tuple[str, ...]) -> Run:
        """A recording on the grid, computed once; columns that are derived from it are not shared."""
        key = id(recording)
        if key not in self._on_grid:
            self._on_grid[key] = recording, Run.of(recording, self.grid, self.output, other)
        return dataclasses.replace(self._on_grid[key][1], cache={}, derived={})

    def identities(self, data: Data) -> tuple[Identity, ...]:
        """Columns of which the recorded output is the rate of change or the integral."""
        return () if self.turns else identities(data, self.recorded, self.request.unit)

    def baseline(
        self, recordings: Sequence[Recording], beside: Array | None = None, wrong: Mapping[str, Collection[str]] | None = None
    ) -> Baseline:
        """The simulator calibrated as :meth:`Baseline.calibrated` does, with the likeliest columns of what the engine computes."""
        return self._calibrated(self.data(recordings), beside, wrong)

    def _calibrated(self, data: Data, beside: Array | None = None, wrong: Mapping[str, Collection[str]] | None = None) -> Baseline:
        data.require_windows()
        found = Baseline.calibrated(self.runs.base, data, beside, wrong)
        return found if self.turns else found.with_own(own_bases(self._setting(data), self._present), data, beside)

    def question(self, recordings: Sequence[Recording], baseline: Baseline | None = None) -> Question:
        """The data and the regions that are weighed beside a simulator, which is calibrated where none is given."""
        data = self.data(recordings)
        baseline = self._calibrated(data) if baseline is None else baseline
        own: Sequence[Mapping[str, Basis]] = []
        if self.turns:
            regions = list(turning_regions(data, self.candidates, baseline, thermometer_of(self.runs.train[0])))
            data = with_angle_rows(data, bases_of(regions), self.output)
        else:
            setting = self._setting(data)
            own = own_bases(setting, self._present)
            regions = list(named(setting, self.candidates, self._present))
            regions += list(laws(setting, regions))
        data = baseline.less_stated(data)
        bank = Bank(data, baseline.design(data), None if self.turns else baseline)
        clocks = clock_regions(data, bank.design, SIMULATED) if self.runs.untold and not self.turns else ()
        regions = list(_without_own_laws(regions, bank, baseline, own))
        regions = without_identities([*regions, *nuisances(data, baseline), *clocks], self.identities(data))
        return Question(bank, regions, baseline)

    def _setting(self, data: Data) -> Setting:
        return Setting(data, Driver.of(data, _thermometer(data, self.runs.train[0])))

    @property
    def _present(self) -> list[str]:
        return [mechanism.name for mechanism in self.runs.base.mechanisms]


def _without_own_laws(
    regions: Iterable[Region], bank: Bank, baseline: Baseline, own: Sequence[Mapping[str, Basis]]
) -> Iterator[Region]:
    """Other forms of the simulator's mechanisms without the very law of each, which is no other form.

    Where it is stated, its number is wrong (:func:`~rlgcomp.diagnosis.regions.nuisances.nuisances`); a rate of change over another
    window is of the simulator's own amplitude, and its window is chosen with the simulator.
    """
    mechanisms = {mechanism.name: mechanism for mechanism in baseline.simulator.mechanisms}
    for region in regions:
        if region.key.startswith(OTHER_FORM) and region.mechanism in mechanisms:
            bases = [Own(mechanisms[region.mechanism]), *(found[region.mechanism] for found in own if region.mechanism in found)]
            law = independent(np.hstack([bank.design, *(bank.columns(basis) for basis in bases)]))
            forms = tuple(form for form in region.forms if not any(_is_within(law, bank.columns(basis)) for basis in form.lead))
            if forms:
                yield dataclasses.replace(region, forms=forms)
        else:
            yield region


def _is_within(law: Array, columns: Array) -> bool:
    """Whether columns are combinations of orthonormal ones, shape (n, k) and (n, p)."""
    left = columns - law @ (law.T @ columns)
    return bool(np.sum(left**2) <= _OWN * np.sum(columns**2))


def bases_of(regions: Iterable[Region]) -> list[Basis]:
    """Of all forms."""
    return [basis for region in regions for form in region.forms for basis in form.bases]


def _thermometer(data: Data, recording: Recording) -> str:
    """The column that the catalogue means by temperature; where there is none beside the output, the first that varies."""
    thermometers = [column for column in recording.columns if is_thermometer(column) and column not in data.other]
    if thermometers:
        named = recording.temperature_column
        return named if named in thermometers else min(thermometers)
    if not data.columns:
        raise InputError(f"{recording.name} has no column beside the output that varies; give one that may drive it")
    return data.columns[0]
