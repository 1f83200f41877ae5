"""The simulator: mechanisms and noise, made into recordings or driven by the monitors of a recording.

Errors refer to the output of an ideal gyro: zero in a chamber, the table's rate and the Earth's on a turntable. They add, except
those that act on the total rate (lock-in): their input is the rate with all optical errors included.
"""

from __future__ import annotations

import dataclasses
import textwrap
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Any, Final, Literal, Self, get_args

import numpy as np
import numpy.typing as npt
import pandas as pd
import yaml

from rlgcomp.errors import InputError
from rlgcomp.files import from_yaml, read_text, write_text
from rlgcomp.noise.processes import NoiseModel, stream
from rlgcomp.physics import CATALOGUE
from rlgcomp.physics.mechanism import FELT_RATE_DEG_S, Mechanism
from rlgcomp.recording import PREDICTED, Metadata, Recording
from rlgcomp.recording.argument_checks import require_seed
from rlgcomp.recording.motion import earth_rate_deg_h, rate_deg_s
from rlgcomp.recording.time_stamp_convention import reference_rate_deg_s
from rlgcomp.simulation.monitors import Beams, Monitors
from rlgcomp.simulation.plant import ThermalPlant
from rlgcomp.simulation.programme import PRESETS, Programme, name_of
from rlgcomp.simulation.table_programme import PRESETS as TABLE_PRESETS
from rlgcomp.simulation.table_programme import TableProgramme
from rlgcomp.simulation.turntable import Turntable
from rlgcomp.units import SECONDS_PER_HOUR, convert

Array = npt.NDArray[np.float64]
Kind = Literal["chamber", "turntable"]

TYPICAL_NOISE: Final = NoiseModel(angle_random_walk_deg_sqrt_h=0.0003)
_SECTIONS: Final = ("kind", "mechanisms", "noise", "plant", "beams", "table", "unit", "output")
_USUAL_PROGRAMME: Final = {"chamber": "paper", "turntable": "rates"}
_SEQUENCE: Final = "tag:yaml.org,2002:seq"
_LINE_WIDTH: Final = 110  # of a simulator as text
_GYRO_UNITS: Final = {"gyro_deg_h": "deg/h", "gyro_deg_s": "deg/s"}


@dataclasses.dataclass(frozen=True)
class Simulator:
    """A gyro as a list of mechanisms and a noise model.

    Parameters
    ----------
    mechanisms : tuple of Mechanism
        Their order does not matter. Each occurs once, but for empirical and tabulated laws.
    free : mapping of str to frozenset of str
        By mechanism, the parameters that are to be calibrated from data; the others are known.
    noise : NoiseModel, optional
        None: to be estimated from data, and of the usual size when simulating.
    monitors : Monitors
        Of kind "chamber": thermal plant, beams, readout and sensors.
    table : Turntable
        Of kind "turntable": the rate table and the room.
    kind : {"chamber", "turntable"}
    unit : str
        Serial number that its recordings bear.
    output : str, optional
        Column that it predicts, where that is no gyro: `force_N`. Amplitudes are then in its unit instead of deg/h, and it has no
        monitors of its own, so that it predicts from those of recordings alone.

    Raises
    ------
    InputError
        A mechanism appears twice or belongs to another kind of run.
    """

    mechanisms: tuple[Mechanism, ...] = ()
    free: Mapping[str, frozenset[str]] = dataclasses.field(default_factory=dict)
    noise: NoiseModel | None = None
    monitors: Monitors = dataclasses.field(default_factory=Monitors)
    table: Turntable = dataclasses.field(default_factory=Turntable)
    kind: str = "chamber"
    unit: str = "simulated"
    output: str = ""

    def __post_init__(self) -> None:
        if self.kind not in get_args(Kind):
            raise InputError(f"simulator: kind is {self.kind!r}; it must be one of {', '.join(get_args(Kind))}")
        names = [mechanism.name for mechanism in self.mechanisms if not mechanism.empirical]
        twice = sorted({name for name in names if names.count(name) > 1})
        if twice:
            raise InputError(f"simulator: {', '.join(twice)} listed twice; list each mechanism once")
        foreign = [mechanism.name for mechanism in self.mechanisms if mechanism.kind not in (self.kind, "any")]
        if foreign:
            raise InputError(f"simulator of kind {self.kind!r}: {', '.join(foreign)} belong to the other kind; write kind: first")

    def __repr__(self) -> str:
        """One line a mechanism with its parameters, and the noise."""
        count = len(self.mechanisms)
        what = f"{self.output}," if self.output else f"a {self.kind} gyro {self.unit!r}:"
        head = f"Simulator of {what} {count} mechanism{'' if count == 1 else 's'}"
        lines = [_mechanism_text(mechanism, self.free.get(mechanism.name, frozenset())) for mechanism in self.mechanisms]
        return "\n  ".join([head, *lines, f"noise: {_noise_text(self.noise)}"])

    # --- running it --------------------------------------------------------------------------------------------------------

    def simulate(
        self,
        programme: Programme | TableProgramme | str | None = None,
        *,
        seed: int = 0,
        step_s: float = 1.0,
        name: str | None = None,
    ) -> Recording:
        """Make a recording.

        Parameters
        ----------
        programme : Programme, TableProgramme or str, optional
            Of chamber or table: a programme, its text, or a preset's name; by default "paper" and "rates".
        seed : int
            Every random stream is named: leaving a mechanism out leaves all else bit-identical.
        step_s : float
            Sample period.
        name : str, optional
            Of the recording; by default the programme's and the seed, as "reversed-2".

        Returns
        -------
        Recording
            With each contribution in `truth`; they sum to the gyro's error.

        Raises
        ------
        InputError
            The programme is not understood, of the other kind, or too short; the seed is negative; its output is no gyro.
        """
        if self.output:
            raise InputError(
                f"this simulator is of {self.output}, whose monitors nothing simulates; predict from those of a recording instead"
            )
        seed = require_seed(seed)
        if programme is None:
            programme = _USUAL_PROGRAMME[self.kind]
        name = name or f"{name_of(programme, PRESETS | TABLE_PRESETS)}-{seed}"
        if isinstance(programme, str):
            programme = Programme.parse(programme) if self.kind == "chamber" else TableProgramme.parse(programme)
        if not step_s > 0.0:
            raise InputError(f"the sample period is {step_s} s; it must be positive")
        if isinstance(programme, TableProgramme) and self.kind == "turntable":
            metadata, column = self.table.metadata(), "gyro_deg_s"
            actual, recorded = self.table.simulate(programme, step_s, seed)
        elif isinstance(programme, Programme) and self.kind == "chamber":
            metadata, column = Metadata(kind="chamber"), "gyro_deg_h"
            actual, recorded = self.monitors.simulate(programme, step_s, seed)
        else:
            raise InputError(f"a simulator of kind {self.kind!r} cannot run the programme {programme}; give one of its own kind")
        there = Recording(actual.assign(**{column: 0.0}), metadata, name=name)
        contributions = self._errors(there, [mechanism.for_true_quantities() for mechanism in self.mechanisms], seed)
        noise = TYPICAL_NOISE if self.noise is None else self.noise
        contributions |= noise.simulate(len(there), step_s, seed)
        truth = pd.DataFrame(contributions, index=actual.index)
        shown = self.nominal_deg_h(there) + (truth.to_numpy().sum(axis=1) if contributions else 0.0)
        recorded.insert(1, column, convert(shown, "deg/h", _GYRO_UNITS[column]))
        notes = {"programme": str(programme), "seed": seed}
        return Recording(recorded, dataclasses.replace(metadata, unit=self.unit, notes=notes), name=name, truth=truth)

    def nominal_deg_h(self, recording: Recording, gyro: str | None = None) -> Array:
        """Output of an ideal gyro: zero in a chamber; a turntable's rate, and the Earth's where the latitude is known.

        Where a recording's rate and angle allow several time-stamp conventions, the gyro itself decides between them
        (:func:`rlgcomp.recording.time_stamp_convention.reference_rate_deg_s`).

        Parameters
        ----------
        recording : Recording
        gyro : str, optional
            Gyro column, where there are several.

        Returns
        -------
        ndarray, shape (n,)
            In deg/h.

        Raises
        ------
        InputError
            Of kind "turntable" and the recording has no column of the table's motion.
        """
        if self.kind == "chamber":
            return np.zeros(len(recording))
        readable = gyro is not None or len(recording.gyro_columns) == 1
        rate = reference_rate_deg_s(recording, recording.rate_deg_h(gyro)) if readable else rate_deg_s(recording)
        return SECONDS_PER_HOUR * rate + earth_rate_deg_h(recording)

    def predict(self, recording: Recording) -> Recording:
        """The gyro that this simulator expects, given a recording's own monitors: the same rows, without noise.

        The column is the recording's own where that is `gyro_deg_h` or `gyro_deg_s`; otherwise `gyro_deg_h` for a chamber and
        `gyro_deg_s` for a turntable. Where `output` is stated it is that one, and gyros stay as they are.

        Raises
        ------
        InputError
            A mechanism's monitor is not in the recording.
        """
        total = self.expected_deg_h(recording)
        metadata = dataclasses.replace(recording.metadata, notes={**recording.metadata.notes, PREDICTED: True})
        if self.output:
            table = recording.table.assign(**{self.output: total})
            return recording.replace(table=table, metadata=metadata, truth=None, findings=())
        own = [column for column in recording.gyro_columns if column in _GYRO_UNITS]
        column = own[0] if own else ("gyro_deg_h" if self.kind == "chamber" else "gyro_deg_s")
        table = recording.table.drop(columns=list(recording.gyro_columns))
        table.insert(1, column, convert(total, "deg/h", _GYRO_UNITS[column]))
        return recording.replace(table=table, metadata=metadata, truth=None, findings=())

    def expected_deg_h(self, recording: Recording) -> Array:
        """The same gyro alone, in deg/h, shape (n,).

        Raises
        ------
        InputError
            A mechanism's monitor is not in the recording.
        """
        predictable = [mechanism for mechanism in self.mechanisms if mechanism.repeats()]
        total = self.nominal_deg_h(recording)
        if any(mechanism.stage == "lock_in" for mechanism in predictable):
            return np.asarray(sum(self._errors(recording, predictable, 0).values(), total))
        for label, mechanism in zip(_labels(predictable), predictable, strict=True):
            total = total + mechanism.contribution(recording, stream(0, label))
        return total

    def driver_columns(self, recording: Recording) -> list[str]:
        """The columns of a recording that its mechanisms read, as :meth:`Mechanism.driver_columns` gives them."""
        return [column for mechanism in self.mechanisms for column in mechanism.driver_columns(recording)]

    def _errors(self, recording: Recording, mechanisms: Sequence[Mechanism], seed: int) -> dict[str, Array]:
        """Errors in deg/h by mechanism, in the order of the list; those that act on the total rate are computed last."""
        labelled = dict(zip(_labels(mechanisms), mechanisms, strict=True))
        errors = {
            label: mechanism.contribution(recording, stream(seed, label))
            for label, mechanism in labelled.items()
            if mechanism.stage != "lock_in"
        }
        if len(errors) < len(mechanisms):
            optical = [errors[label] for label, mechanism in labelled.items() if mechanism.stage == "light"]
            rate = rate_deg_s(recording) + (earth_rate_deg_h(recording) + sum(optical, np.zeros(len(recording)))) / SECONDS_PER_HOUR
            total = recording.replace(table=recording.table.assign(**{FELT_RATE_DEG_S: rate}))
            errors |= {
                label: mechanism.contribution(total, stream(seed, label))
                for label, mechanism in labelled.items()
                if mechanism.stage == "lock_in"
            }
        return {label: errors[label] for label in labelled}

    # --- changing it -------------------------------------------------------------------------------------------------------

    def without(self, name: str) -> Self:
        """The same simulator with one mechanism left off the list.

        Raises
        ------
        InputError
            It has no such mechanism.
        """
        if name not in [mechanism.name for mechanism in self.mechanisms]:
            raise InputError(f"the simulator has no {name!r}; it has {', '.join(mechanism.name for mechanism in self.mechanisms)}")
        return dataclasses.replace(self, mechanisms=tuple(mechanism for mechanism in self.mechanisms if mechanism.name != name))

    def with_mechanism(self, mechanism: Mechanism) -> Self:
        """The same simulator with one mechanism more, or with that one's parameters changed; laws with equal options are one."""
        others = tuple(other for other in self.mechanisms if not _same(other, mechanism))
        return dataclasses.replace(self, mechanisms=(*others, mechanism))

    def freed(self, names: Collection[str]) -> Self:
        """The same simulator with all amplitudes and nonlinear parameters of some mechanisms free."""
        fitted = {
            mechanism.name: frozenset(p.name for p in mechanism.parameters() if p.role != "setting")
            for mechanism in self.mechanisms
            if mechanism.name in names
        }
        return dataclasses.replace(self, free={**self.free, **fitted})

    def with_own_amplitudes_free(self) -> Self:
        """The same simulator with the amplitudes per run free, since stated values cannot hold for another run."""
        own = {
            mechanism.name: self.free.get(mechanism.name, frozenset()) | {p.name for p in mechanism.amplitude_parameters()}
            for mechanism in self.mechanisms
            if mechanism.each_run
        }
        return dataclasses.replace(self, free={**self.free, **own})

    # --- its file ----------------------------------------------------------------------------------------------------------

    @classmethod
    def from_yaml(cls, path: str | Path, catalogue: Mapping[str, type[Mechanism]] = CATALOGUE) -> Self:
        """Simulator from a file.

        Raises
        ------
        InputError
            The file cannot be read, a mechanism is not in the catalogue, or a value is out of bounds.
        """
        path = Path(path)
        try:
            content = from_yaml(read_text(path))
        except FileNotFoundError:
            raise InputError(f"simulator file {path} does not exist") from None
        except (OSError, ValueError) as error:
            raise InputError(f"simulator file {path}: not readable as YAML: {error}") from None
        if not isinstance(content, dict):
            raise InputError(f"simulator file {path}: expected 'kind: chamber' (or turntable) and a list of 'mechanisms:'")
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
            table=_made(Turntable, _section(content, "table"), "table"),
            kind=str(content.get("kind", "chamber")),
            unit=str(content.get("unit", "simulated")),
            output=str(content.get("output", "")),
        )

    def to_mapping(self) -> dict[str, Any]:
        """Content of its file; :meth:`from_mapping` gives the same simulator back."""
        listed: list[Any] = []
        for mechanism in self.mechanisms:
            unknowns = self.free.get(mechanism.name, frozenset())
            idle = _idle(mechanism)
            values = {
                key: {"value": value, "free": True} if key in unknowns else value
                for key, value in mechanism.to_mapping().items()
                if key not in idle
            }
            listed.append({mechanism.name: values})
        content: dict[str, Any] = {"kind": self.kind, "unit": self.unit}
        if self.output:
            content["output"] = self.output
        content["mechanisms"] = listed
        if self.noise is not None:
            content["noise"] = self.noise.to_mapping()
        for section, made in (("plant", self.monitors.plant), ("beams", self.monitors.beams), ("table", self.table)):
            if made != type(made)():
                content[section] = dataclasses.asdict(made)
        return content

    def to_yaml(self, path: str | Path) -> None:
        """Write its file, whole or not at all."""
        write_text(path, yaml.dump(self.to_mapping(), Dumper=_TablesInLines, sort_keys=False, allow_unicode=True))


class _TablesInLines(yaml.SafeDumper):
    """Tables of numbers are written in lines, all else as usual."""


_TablesInLines.add_representer(tuple, lambda dumper, table: dumper.represent_sequence(_SEQUENCE, table, flow_style=True))


def _labels(mechanisms: Sequence[Mechanism]) -> list[str]:
    """Names, numbered from the second of a name on: only laws occur more than once."""
    names = [mechanism.name for mechanism in mechanisms]
    return [name if (k := names[:place].count(name)) == 0 else f"{name}_{k + 1}" for place, name in enumerate(names)]


def _idle(mechanism: Mechanism) -> frozenset[str]:
    """Parameters that are not in use and have their usual size."""
    return frozenset(p.name for p in mechanism.idle_parameters() if getattr(mechanism, p.name) == p.typical)


def _same(one: Mechanism, other: Mechanism) -> bool:
    if one.name != other.name or not one.empirical:
        return one.name == other.name
    options = [parameter.name for parameter in one.parameters() if parameter.role == "setting"]
    return all(getattr(one, name) == getattr(other, name) for name in options)


def _mechanism(item: Any, catalogue: Mapping[str, type[Mechanism]]) -> tuple[Mechanism, frozenset[str]]:
    name, parameters = next(iter(item.items())) if isinstance(item, dict) and len(item) == 1 else (item, None)
    if not isinstance(name, str) or not (parameters is None or isinstance(parameters, dict)):
        raise InputError(f"mechanisms: {item!r} is not understood; write '- name' or '- name: {{parameter: value}}'")
    if name not in catalogue:
        raise InputError(f"mechanisms: {name!r} is not in the catalogue; it has {', '.join(catalogue)}")
    fixed, freed = {}, set()
    units = {parameter.name: parameter.unit for parameter in catalogue[name].parameters()}
    for key, value in (parameters or {}).items():
        entry = value if isinstance(value, dict) else {"free": True} if value == "free" else {"value": value}
        if not (set(entry) <= {"value", "free", "unit"} and isinstance(entry.get("free", False), bool)):
            raise InputError(f"{name}: {key} is {value!r}; write a number, or {{value: NUMBER, free: true}}")
        if key in units and entry.get("unit", units[key]) != units[key]:
            raise InputError(f"{name}: {key} has the unit {entry['unit']!r}; it is read in {units[key] or 'no unit'}")
        if entry.get("free"):
            freed.add(key)
        if "value" in entry:
            fixed[key] = entry["value"]
    mechanism = catalogue[name].from_mapping(fixed)
    amplitudes = [parameter for parameter in mechanism.parameters() if parameter.role == "amplitude"]
    absent = {parameter.name for parameter in (*amplitudes, *mechanism.shape_parameters()) if parameter.name not in fixed}
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


def _mechanism_text(mechanism: Mechanism, free: frozenset[str]) -> str:
    idle, used = mechanism.idle_parameters(), mechanism.to_mapping()
    parameters = [
        f"{p.name} = {_value_text(getattr(mechanism, p.name))}{f' {p.unit}' * bool(p.unit)}{' (free)' * (p.name in free)}"
        for p in mechanism.parameters()
        if p not in idle and p.name in used
    ]
    return _wrapped(f"{mechanism.name}{': ' if parameters else ''}{', '.join(parameters)}")


def _noise_text(noise: NoiseModel | None) -> str:
    if noise is None:
        return "to be estimated"
    idle = "" if noise.dither_residual_arcsec else "dither_residual_frequency_hz"
    coefficients = [f"{name} = {_value_text(value)}" for name, value in noise.to_mapping().items() if value and name != idle]
    return _wrapped(", ".join(coefficients) or "none")


def _value_text(value: Any) -> str:
    if isinstance(value, tuple):
        return f"{len(value)} numbers"
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def _wrapped(text: str) -> str:
    return textwrap.fill(text, _LINE_WIDTH, subsequent_indent=" " * 6)
