"""The simulator: mechanisms and noise, made into recordings or driven by the monitors of a recording."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final, Self

import numpy as np
import pandas as pd
import yaml

from rlgcomp.errors import InputError
from rlgcomp.files import write_text
from rlgcomp.noise import NoiseModel, stream
from rlgcomp.physics import CATALOGUE
from rlgcomp.physics.mechanism import Mechanism
from rlgcomp.recording import Metadata, Recording
from rlgcomp.simulation.monitors import Beams, Monitors
from rlgcomp.simulation.plant import ThermalPlant
from rlgcomp.simulation.programme import Programme

TYPICAL_NOISE: Final = NoiseModel(angle_random_walk_deg_sqrt_h=0.0003)
_SECTIONS: Final = ("kind", "mechanisms", "noise", "plant", "beams", "unit")


@dataclasses.dataclass(frozen=True)
class Simulator:
    """A gyro as a list of mechanisms and a noise model.

    Parameters
    ----------
    mechanisms : tuple of Mechanism
        Within a chamber run their errors add, so their order does not matter.
    free : mapping of str to frozenset of str
        By mechanism, the parameters that are to be calibrated from data; the others are known.
    noise : NoiseModel, optional
        None: to be estimated from data, and of the usual size when simulating.
    monitors : Monitors
        Thermal plant, beams, readout and sensors.
    kind : str
    unit : str
        Serial number that its recordings bear.

    Raises
    ------
    InputError
        A mechanism appears twice or belongs to another kind of run.
    """

    mechanisms: tuple[Mechanism, ...] = ()
    free: Mapping[str, frozenset[str]] = dataclasses.field(default_factory=dict)
    noise: NoiseModel | None = None
    monitors: Monitors = dataclasses.field(default_factory=Monitors)
    kind: str = "chamber"
    unit: str = "simulated"

    def __post_init__(self) -> None:
        if self.kind != "chamber":
            raise InputError(f"simulator: kind is {self.kind!r}; this version simulates kind 'chamber'")
        names = [mechanism.name for mechanism in self.mechanisms]
        twice = sorted({name for name in names if names.count(name) > 1})
        if twice:
            raise InputError(f"simulator: {', '.join(twice)} listed twice; list each mechanism once")
        foreign = [mechanism.name for mechanism in self.mechanisms if mechanism.kind not in (self.kind, "any")]
        if foreign:
            raise InputError(f"simulator of kind {self.kind!r}: {', '.join(foreign)} belong to another kind of run")

    # --- running it --------------------------------------------------------------------------------------------------------

    def simulate(
        self, programme: Programme | str = "paper", *, seed: int = 0, step_s: float = 1.0, name: str = "simulated"
    ) -> Recording:
        """Make a recording.

        Parameters
        ----------
        programme : Programme or str
            A chamber programme, its text, or a preset's name.
        seed : int
            Every random stream is named: leaving a mechanism out leaves all else bit-identical.
        step_s : float
            Sample period.
        name : str

        Returns
        -------
        Recording
            With each contribution in `truth`; they sum to the gyro's output.
        """
        if isinstance(programme, str):
            programme = Programme.parse(programme)
        if not step_s > 0.0:
            raise InputError(f"the sample period is {step_s} s; it must be positive")
        actual, recorded = self.monitors.simulate(programme, step_s, seed)
        there = Recording(actual.assign(gyro_deg_h=0.0), name=name)
        contributions = {
            mechanism.name: mechanism.contribution(there, stream(seed, mechanism.name)) for mechanism in self.mechanisms
        }
        noise = TYPICAL_NOISE if self.noise is None else self.noise
        contributions |= noise.simulate(len(there), step_s, seed)
        truth = pd.DataFrame(contributions, index=actual.index)
        recorded.insert(1, "gyro_deg_h", truth.to_numpy().sum(axis=1) if contributions else 0.0)
        metadata = Metadata(kind="chamber", unit=self.unit, notes={"programme": str(programme), "seed": seed})
        return Recording(recorded, metadata, name=name, truth=truth)

    def predict(self, recording: Recording) -> Recording:
        """The gyro that this simulator expects, given a recording's own monitors: the same rows, without noise.

        Raises
        ------
        InputError
            A mechanism's monitor is not in the recording.
        """
        total = np.zeros(len(recording))
        for mechanism in self.mechanisms:
            if mechanism.amplitude_parameters():
                total += mechanism.contribution(recording, stream(0, mechanism.name))
        table = recording.table.drop(columns=list(recording.gyro_columns))
        table.insert(1, "gyro_deg_h", total)
        return recording.replace(table=table, truth=None, findings=())

    # --- changing it -------------------------------------------------------------------------------------------------------

    def without(self, name: str) -> Self:
        """The same simulator with one mechanism left off the list."""
        if name not in [mechanism.name for mechanism in self.mechanisms]:
            raise InputError(f"the simulator has no {name!r}; it has {', '.join(mechanism.name for mechanism in self.mechanisms)}")
        return dataclasses.replace(self, mechanisms=tuple(mechanism for mechanism in self.mechanisms if mechanism.name != name))

    def with_mechanism(self, mechanism: Mechanism) -> Self:
        """The same simulator with one mechanism more, or with that one's parameters changed."""
        others = tuple(other for other in self.mechanisms if other.name != mechanism.name)
        return dataclasses.replace(self, mechanisms=(*others, mechanism))

    # --- its file ----------------------------------------------------------------------------------------------------------

    @classmethod
    def from_yaml(cls, path: str | Path, catalogue: Mapping[str, type[Mechanism]] = CATALOGUE) -> Self:
        """Simulator from a file.

        Raises
        ------
        InputError
            The file cannot be read, or names what is not in the catalogue or out of bounds.
        """
        path = Path(path)
        try:
            content = yaml.safe_load(path.read_text(encoding="utf-8"))
        except FileNotFoundError:
            raise InputError(f"simulator file {path} does not exist") from None
        except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
            raise InputError(f"simulator file {path}: not readable as YAML: {error}") from None
        if not isinstance(content, dict):
            raise InputError(f"simulator file {path}: expected 'kind: chamber' and a list of 'mechanisms:'")
        try:
            return cls.from_mapping(content, catalogue)
        except InputError as error:
            raise InputError(f"simulator file {path}: {error}") from None

    @classmethod
    def from_mapping(cls, content: Mapping[str, Any], catalogue: Mapping[str, type[Mechanism]] = CATALOGUE) -> Self:
        """Simulator from the content of its file; see :meth:`from_yaml`."""
        unknown = [str(key) for key in content if key not in _SECTIONS]
        if unknown:
            raise InputError(f"unknown section {', '.join(unknown)}; allowed are {', '.join(_SECTIONS)}")
        listed = content.get("mechanisms") or []
        if not isinstance(listed, list):
            raise InputError("mechanisms: must be a list, one '- name' or '- name: {parameter: value}' a line")
        mechanisms, free = [], {}
        for item in listed:
            mechanism, unknowns = _mechanism(item, catalogue)
            mechanisms.append(mechanism)
            free[mechanism.name] = unknowns
        noise = _section(content, "noise")
        return cls(
            mechanisms=tuple(mechanisms),
            free=free,
            noise=None if noise is None else NoiseModel.from_mapping(noise),
            monitors=Monitors(
                plant=_made(ThermalPlant, _section(content, "plant"), "plant"),
                beams=_made(Beams, _section(content, "beams"), "beams"),
            ),
            kind=str(content.get("kind", "chamber")),
            unit=str(content.get("unit", "simulated")),
        )

    def to_mapping(self) -> dict[str, Any]:
        """Content of its file; :meth:`from_mapping` gives the same simulator back."""
        listed: list[Any] = []
        for mechanism in self.mechanisms:
            unknowns = self.free.get(mechanism.name, frozenset())
            values = {
                key: {"value": value, "free": True} if key in unknowns else value for key, value in mechanism.to_mapping().items()
            }
            listed.append({mechanism.name: values})
        content: dict[str, Any] = {"kind": self.kind, "unit": self.unit, "mechanisms": listed}
        if self.noise is not None:
            content["noise"] = dataclasses.asdict(self.noise)
        for section, made in (("plant", self.monitors.plant), ("beams", self.monitors.beams)):
            if made != type(made)():
                content[section] = dataclasses.asdict(made)
        return content

    def to_yaml(self, path: str | Path) -> None:
        """Write its file, whole or not at all."""
        write_text(path, yaml.safe_dump(self.to_mapping(), sort_keys=False, allow_unicode=True))


def _mechanism(item: Any, catalogue: Mapping[str, type[Mechanism]]) -> tuple[Mechanism, frozenset[str]]:
    name, given = next(iter(item.items())) if isinstance(item, dict) and len(item) == 1 else (item, None)
    if not isinstance(name, str) or not (given is None or isinstance(given, dict)):
        raise InputError(f"mechanisms: {item!r} is not understood; write '- name' or '- name: {{parameter: value}}'")
    if name not in catalogue:
        raise InputError(f"mechanisms: {name!r} is not in the catalogue; it has {', '.join(catalogue)}")
    fixed, freed = {}, set()
    for key, value in (given or {}).items():
        if isinstance(value, dict):
            if not set(value) <= {"value", "free"}:
                raise InputError(f"{name}: {key} is {value!r}; write a number, or {{value: NUMBER, free: true}}")
            if value.get("free"):
                freed.add(key)
            if "value" in value:
                fixed[key] = value["value"]
        else:
            fixed[key] = value
    mechanism = catalogue[name].from_mapping(fixed)
    absent = {parameter.name for parameter in mechanism.parameters() if parameter.role != "setting" and parameter.name not in fixed}
    return mechanism, frozenset(absent | freed)


def _section(content: Mapping[str, Any], key: str) -> Mapping[str, Any] | None:
    value = content.get(key)
    if value is None or isinstance(value, dict):
        return value
    raise InputError(f"{key}: is {value!r}; write lines such as '{key}: {{name: value}}'")


def _made(form: Any, values: Mapping[str, Any] | None, section: str) -> Any:
    allowed = [field.name for field in dataclasses.fields(form)]
    unknown = [str(key) for key in values or {} if key not in allowed]
    if unknown:
        raise InputError(f"{section}: unknown {', '.join(unknown)}; allowed are {', '.join(allowed)}")
    return form(**(values or {}))
