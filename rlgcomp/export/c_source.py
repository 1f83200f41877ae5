"""C99 text of an expansion with its features: header, source and self-test, from the templates beside this file."""

from __future__ import annotations

import dataclasses
import math
import re
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final

import jinja2
import numpy as np
import numpy.typing as npt

import rlgcomp
from rlgcomp.compensation.compensator import Compensator
from rlgcomp.compensation.feature_pipeline import FeatureRecipe
from rlgcomp.compensation.features import ReadoutDifference
from rlgcomp.compensation.models.specification import parameters_of
from rlgcomp.compensation.physics_terms import PhysicsTerm
from rlgcomp.errors import InputError
from rlgcomp.export.accuracy import Bounds
from rlgcomp.export.c_features import feature_code, identifiers
from rlgcomp.export.c_physics import require_exportable
from rlgcomp.export.expansion import Expansion
from rlgcomp.export.golden import LONGEST_STEP_S, Stream
from rlgcomp.export.target import Precision
from rlgcomp.units import column_unit

Array = npt.NDArray[np.float64]
LANES: Final[Mapping[Precision, int]] = {"double": 8, "float": 16}
BYTES: Final[Mapping[Precision, int]] = {"double": 8, "float": 4}
KINDS: Final[Mapping[str, str]] = {
    "polynomial": "polynomial",
    "gaussian": "Gaussian kernel",
    "wide": "Gaussian kernel with its first three orders summed beforehand",
    "matern": "Matern kernel",
    "power": "polynomial kernel",
    "sigmoid": "sigmoid kernel",
}
_NAME: Final = re.compile(r"^[a-z][a-z0-9_]{0,39}$")
# exp(t) = 2^k exp(r), with Cody and Waite's split of ln 2, so that k ln2_high is exact; the series is cut below a rounding.
_EXP: Final[Mapping[Precision, Mapping[str, Any]]] = {
    "double": {
        "bits": "uint64_t",
        "shift": 52,
        "bias": 1023,
        "ln2_high": 6.93147180369123816490e-01,
        "ln2_low": 1.90821492927058770002e-10,
        "series": [1.0 / math.factorial(k) for k in range(14)],
        "error": "4e-16",
        "tiny": 1e-300,
        "root": "UINT64_C(0x1ff8000000000000)",
    },
    "float": {
        "bits": "uint32_t",
        "shift": 23,
        "bias": 127,
        "ln2_high": 0.693359375,
        "ln2_low": -2.12194440e-4,
        "series": [1.0 / math.factorial(k) for k in range(8)],
        "error": "2e-7",
        "tiny": 1e-30,
        "root": "UINT32_C(0x1fc00000)",
    },
}


@dataclasses.dataclass(frozen=True)
class Design:
    """One C module: its name, model, precision and permitted library.

    Parameters
    ----------
    name : str
        Prefix of files and identifiers.
    compensator : Compensator
    expansion : Expansion
    precision : {"double", "float"}
    libm : bool
    sha256 : str
        Of the artefact.
    offset_s : float, optional
        Also a step that zeroes the offset of a recording over so many seconds at its start.
    """

    name: str
    compensator: Compensator
    expansion: Expansion
    precision: Precision
    libm: bool
    sha256: str
    offset_s: float | None = None

    def __post_init__(self) -> None:
        if not _NAME.match(self.name):
            raise InputError(
                f"--name {self.name!r} cannot begin C identifiers; it must be up to 40 small letters, digits and underscores, "
                "a letter first"
            )
        features = self.compensator.pipeline_.features
        require_exportable([one for one in features if isinstance(one, PhysicsTerm)], self.precision, libm=self.libm)

    @property
    def blocks(self) -> int:
        """Blocks of centres, the last one filled up."""
        return -(-len(self.expansion.weights) // LANES[self.precision])

    @property
    def table_bytes(self) -> int:
        """Bytes of the constant tables."""
        physics = physics_bytes(self.compensator.pipeline_, self.precision)
        return table_bytes(self.expansion, len(self.expansion.weights), self.precision) + physics


def physics_bytes(pipeline: FeatureRecipe, precision: Precision) -> int:
    """Bytes of the constant tables of known physics, which every number of centres needs."""
    terms = feature_code(pipeline, "", precision, str).terms
    return BYTES[precision] * (sum(len(values) for term in terms for _, values in term.tables) + 4 * len(terms))


def table_bytes(expansion: Expansion, centres: int, precision: Precision) -> int:
    """Bytes of the constant tables of what is learnt, with so many centres, the last block filled up.

    Parameters
    ----------
    expansion : Expansion
    centres : int
        Number of centres, which may be less than the expansion's own.
    precision : {"double", "float"}
    """
    d, lanes = expansion.features, LANES[precision]
    numbers = 7 * d + len(expansion.straight_deg_h) + -(-centres // lanes) * lanes * (d + 1)
    if expansion.form == "wide":
        numbers += d + d * (d + 1) // 2
    return BYTES[precision] * (numbers + expansion.powers.size)


def state_bytes(design: Design) -> int:
    """Bytes of the state, the only memory that lasts, on a machine with 4-byte integers and doubles aligned to 8 bytes.

    The time of the last sample, two answers and the memory; the time of a sample that was refused, aligned, two integers, and a
    byte for each relay.
    """
    code = feature_code(design.compensator.pipeline_, "", design.precision, str)
    own = -(-(8 + BYTES[design.precision] * (2 + code.slots)) // 8) * 8
    offset = 0 if design.offset_s is None else 2 * 8 + 2 * 4
    return -(-(own + offset + 8 + 2 * 4 + code.relays) // 8) * 8


def operations(design: Design) -> dict[str, int]:
    """Operations of one step, counted from its text; a multiplication counts together with its addition."""
    e = design.expansion
    code = feature_code(design.compensator.pipeline_, "", design.precision, str)
    d, padded = e.features, design.blocks * LANES[design.precision]
    a_centre = {"wide": d + 3 + series_terms(e, design.precision), "gaussian": 2 * d + 2, "matern": 2 * d + 3}.get(e.form, d + 1)
    a_centre += e.kernel_degree if e.form == "power" else 0
    whole = d * (d + 1) // 2 + 2 * d + 16 if e.form == "wide" else e.powers.size
    terms = [feature for feature in design.compensator.pipeline_.features if isinstance(feature, PhysicsTerm)]
    physics = sum(term.operators for term in code.terms) + 2 * len(terms)
    return {
        "multiply_adds": 2 * d
        + code.filters * 3
        + code.plays
        + whole
        + padded * a_centre
        + 1
        + 6 * (design.offset_s is not None)
        + physics,
        "divisions": (design.offset_s is not None)
        + code.filters
        + sum(isinstance(feature, ReadoutDifference) for feature in design.compensator.pipeline_.features),
        "exponentials": sum(len(term.table) for term in terms if term.function == "decay")
        + sum({"bouc_wen": 1, "coleman": 2}.get(term.memory, 0) for term in terms)
        + padded * (e.form in ("gaussian", "matern", "sigmoid") or (e.form == "wide" and e.largest_argument > 1.0)),
        "square_roots": padded * (e.form == "matern"),
        "comparisons": 4 * d
        + 2 * code.plays
        + code.filters
        + d
        + len(design.compensator.pipeline_.columns)
        + 2
        + sum(term.operators for term in code.terms)
        + 2 * len(terms),
    }


def series_terms(expansion: Expansion, precision: Precision) -> int:
    """Terms of r_3's series in that precision."""
    return expansion.series_terms(2.0**-54 if precision == "double" else 2.0**-26)


def render(design: Design, golden: Stream, bounds: Bounds, quiet_rows: int) -> dict[str, str]:
    """File names and their text.

    Parameters
    ----------
    design : Design
    golden : Stream
        The golden recording.
    bounds : Bounds
        Allowed deviation of each of its samples.
    quiet_rows : int
        Rows of it, from the second on, before the first disturbance.

    Raises
    ------
    InputError
        The artefact holds a number that the precision cannot hold.
    """
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("rlgcomp.export", "templates"),
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
        undefined=jinja2.StrictUndefined,
        autoescape=False,  # noqa: S701  (C, not HTML; what comes from the artefact goes through _comment_text, identifiers and number)
    )
    number = _number(design.precision)
    environment.filters["number"] = number
    environment.filters["double"] = _number("double")
    values = _values(design, number) | {
        "golden": [
            [_exact(value) for value in row]
            for row in np.column_stack(
                [
                    golden.samples,
                    golden.bias_deg_h,
                    golden.half_width_deg_h,
                    bounds.bias_deg_h,
                    bounds.half_width_deg_h,
                    bounds.status,
                ]
            )
        ],
        "quiet_rows": quiet_rows,
        "passes": 1 + 20_000 // (quiet_rows * (1 + len(design.expansion.weights) // 50)),
    }
    names = {"model.h": f"{design.name}.h", "model.c": f"{design.name}.c", "selftest.c": f"{design.name}_selftest.c"}
    return {file: environment.get_template(template).render(**values) for template, file in names.items()}


def _values(design: Design, number: Callable[[float], str]) -> dict[str, Any]:
    e, compensator, precision = design.expansion, design.compensator, design.precision
    lanes, blocks = LANES[precision], design.blocks
    table = np.zeros((blocks * lanes, e.features))
    table[: len(e.weights)] = e.centres
    weights = np.zeros(blocks * lanes)
    weights[: len(e.weights)] = e.weights
    upper = e.quadratic - 0.5 * np.diag(np.diag(e.quadratic))
    features = feature_code(compensator.pipeline_, design.name.upper(), precision, number)
    helpers = features.helpers | ({"behind"} if features.filters else set()) | ({"left_behind"} if features.plays else set())
    notes = [run.get("notes") or {} for run in compensator.provenance_]
    terms = series_terms(e, precision)
    columns = compensator.pipeline_.columns
    monitors = list(zip(identifiers(columns), map(_monitor_comment, columns), strict=True))
    return {
        "feature_lines": features.lines,
        "starts": features.starts,
        "begins": [line for term in features.terms for line in term.begins],
        "term_tables": [table for term in features.terms for table in term.tables],
        "relays": features.relays,
        "helpers": helpers,
        "steps": bool(features.filters) or any("step_s" in line for line in features.lines),
        "firsts": any("first ?" in line for line in features.lines),
        "exponentials": e.form in ("gaussian", "wide", "matern", "sigmoid") or "decay" in helpers,
        "dark": any(isinstance(feature, ReadoutDifference) for feature in compensator.pipeline_.features),
        "slots": features.slots,
        "p": design.name,
        "P": design.name.upper(),
        "e": e,
        "form": e.form,
        "real": precision,
        "libm": design.libm,
        "compensated": precision == "float",
        "exp": _EXP[precision],
        "root_function": {"double": "sqrt", "float": "sqrtf"}[precision] if design.libm else "square_root",
        "series": [1.0 / math.factorial(k) for k in range(3, 3 + terms)],
        "largest_argument": e.largest_argument if e.form == "wide" else 0.0,
        "horner": lambda series, name: _horner(series, name, number),
        "nested_powers": _nested(len(e.powers)),
        "listed": lambda numbers: ", ".join(map(number, numbers)),
        "lanes": lanes,
        "blocks": blocks,
        "centre_blocks": table.reshape(blocks, lanes, e.features).transpose(0, 2, 1),
        "weight_blocks": weights.reshape(blocks, lanes),
        "triangle": upper[np.triu_indices(e.features)],
        "interval": compensator.interval_,
        "straight": len(e.straight_deg_h) > 0,
        "offset_s": design.offset_s,
        "narrower_deg_h": 0.0
        if design.offset_s is None
        else compensator.offset_interval(design.offset_s).inside_deg_h - compensator.interval_.inside_deg_h,
        "coverage": f"{100.0 * compensator.interval_.coverage:g} %",
        "spans": np.where(e.high > e.low, e.high - e.low, 1.0),
        "version": rlgcomp.__version__,
        "model": _comment_text(design.name),
        "sha256": design.sha256,
        "kind": _comment_text(_kind(design)),
        "gyro": _comment_text(compensator.gyro_),
        "unit": _comment_text(", ".join(sorted({str(run.get("unit") or "not stated") for run in compensator.provenance_}))),
        "calibration": _comment_text(", ".join(sorted({str(note["calibration"]) for note in notes if "calibration" in note}))),
        **_gyro(design.name, compensator.gyro_),
        "rows": sum(len(part.y_deg_h) for part in compensator.training_),
        "runs": len(compensator.training_),
        "averaging_s": f"{compensator.averaging_s:g}",
        "longest_step_s": f"{LONGEST_STEP_S:.0f}",
        "table_bytes": design.table_bytes,
        "centres_of_model": len(getattr(compensator.model_, "alpha_", ())),
        "monitors": monitors,
        "inputs": list(
            zip(map(_comment_text, compensator.pipeline_.names[: e.features]), map(_short, e.low), map(_short, e.high), strict=True)
        ),
        "physics": list(map(_comment_text, compensator.pipeline_.names[e.features :])),
    }


def _number(precision: Precision) -> Callable[[float], str]:
    """C literals that read back as the number they were written from."""

    def literal(value: float) -> str:
        with np.errstate(over="ignore"):
            exact = float(value) if precision == "double" else float(np.float32(value))
        if not math.isfinite(exact):
            raise InputError(f"the model holds {value!r}, which {precision} cannot; export it with --precision double")
        text = repr(exact) if precision == "double" else f"{exact:.9g}"
        text += "" if any(mark in text for mark in ".en") else ".0"
        return text if precision == "double" else f"{text}f"

    return literal


def _short(value: float) -> str:
    return f"{value:.6g}"


def _exact(value: float) -> str:
    """A literal of the golden table, where values that are no numbers belong."""
    if math.isnan(value):
        return "NAN"
    return ("-" if value < 0 else "") + "INFINITY" if math.isinf(value) else repr(float(value))


def _horner(series: Sequence[float], name: str, number: Callable[[float], str]) -> str:
    text = number(series[-1])
    for coefficient in reversed(series[:-1]):
        text = f"{number(coefficient)} + {name} * ({text})"
    return text


def _gyro(name: str, column: str) -> dict[str, Any]:
    """Declaration of the function that corrects a gyro's output, and its rate in deg/h before."""
    pulses, rate = column.endswith("_pulses"), "sample[BIAS - 1]"
    arguments = "double gyro, double pulse_arcsec, double period_s" if pulses else "double gyro"
    return {
        "pulses": pulses,
        "gyro_arguments": arguments,
        "gyro_of_rate": f"{rate}, 1.0, 1.0" if pulses else f"{rate} / 3600.0" if column.endswith("_deg_s") else rate,
        "gyro_unit": column_unit(column),
        "correct": f"double {name}_correct_deg_h({arguments}, const {name}_result *result)",
        # arcseconds a second are degrees an hour
        "rate_deg_h": "gyro * (pulse_arcsec / period_s)" if pulses else "gyro * 3600.0" if column.endswith("_deg_s") else "gyro",
    }


def _nested(powers: int) -> str:
    text = f"POWERS[{powers - 1}][j]"
    for power in range(powers - 2, -1, -1):
        text = f"POWERS[{power}][j] + x[j] * ({text})"
    return text


def _kind(design: Design) -> str:
    model = design.compensator.model_
    parameters = ", ".join(f"{key} = {value}" for key, value in sorted(parameters_of(model).items()))
    return f"{type(model).__name__}({parameters}), as {KINDS[design.expansion.form]}"


def _monitor_comment(column: str) -> str:
    unit = column_unit(column)
    return _comment_text(column) + (f", in {unit}" if unit else "")


def _comment_text(text: str) -> str:
    """Text that a C comment can hold, wherever it came from."""
    plain = re.sub(r"[^ -~]", " ", text).replace("\\", "/")
    return re.sub(r"\?\?|\*/|/\*", "-", plain)[:200]
