"""Export to ONNX: a stateless core, features in and bias out, run by onnxruntime and compared with Python.

The graph holds the stateless part: range guard, scaling, model, interval. Filters and hysteresis memory have a state that a
runtime of tensors would have to be handed back with every sample; they stay where they are exact already, in
:meth:`rlgcomp.compensation.feature_pipeline.FeatureRecipe.step` and in the exported C. Rows are independent: a batch is any
number of them.
"""

from __future__ import annotations

import contextlib
import dataclasses
import json
import os
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt
import pandas as pd

from rlgcomp.compensation.artefact import identity
from rlgcomp.compensation.compensator import Compensator, load
from rlgcomp.errors import InputError
from rlgcomp.export.expansion import Expansion, expansion_of
from rlgcomp.export.golden import golden_stream
from rlgcomp.export.reduction import sized
from rlgcomp.export.target import REPORT, Options
from rlgcomp.export.target import written as all_written
from rlgcomp.files import to_json, whole_folder
from rlgcomp.report.messages import Message, message
from rlgcomp.scratch import temporary_folder

Array = npt.NDArray[np.float64]
OPSET: Final = 17
IR_VERSION: Final = 8
TOLERANCE_OF_SPAN: Final = {"double": 1e-9, "float": 1e-4}  # of the bias in training
_SERIES: Final = 24
_DESCRIPTION: Final = (
    "Stateless core of a ring laser gyro's bias compensation: features in, bias out. Filters and hysteresis memory are not in it; "
    "rlgcomp's FeatureRecipe.step, or the C that rlgcomp exports, computes the features sample by sample."
)


@dataclasses.dataclass(frozen=True)
class OnnxExport:
    """An ONNX file and its comparison with Python.

    Parameters
    ----------
    summary : dict
        Names, sizes, metadata.
    checks : tuple of dict
        One row a comparison: what was run, rows, largest difference and the bound on it. Empty without onnxruntime.
    remarks : tuple of Message
    """

    summary: dict[str, Any]
    checks: tuple[dict[str, Any], ...]
    remarks: tuple[Message, ...]

    @property
    def tables(self) -> Sequence[tuple[str, Sequence[Mapping[str, Any]]]]:
        """Titles and rows for people."""
        size = [{"": key, " ": str(self.summary[key])} for key in ("precision", "form", "centres", "bytes", "sha256")]
        return [("ONNX", size), *([("Compared with Python by onnxruntime", self.checks)] if self.checks else [])]

    def to_mapping(self) -> dict[str, Any]:
        """Everything as plain data."""
        return {**self.summary, "checks": list(self.checks), "remarks": [remark.to_mapping() for remark in self.remarks]}


def export(model: Path, out: Path, options: Options) -> OnnxExport:
    """Write `NAME.onnx`, `golden.csv` and `report.json` into a folder, after comparing them with Python.

    Parameters
    ----------
    model : path
        Artefact.
    out : path
        Folder to write.
    options : Options

    Raises
    ------
    InputError
        The artefact is damaged, onnx is not installed, single precision cannot carry the model, or the place cannot be written to.
    RuntimeError
        onnxruntime's answers in double precision are not Python's: a fault of the export. Nothing is written then.
    """
    compensator = load(model)
    if compensator.scaling_.linear:
        raise InputError(
            "this model has known physics, whose hysteresis and filters have a state that ONNX does not hold; export it with --to c"
        )
    whole = expansion_of(compensator)
    expansion, _ = sized(compensator, whole, options)
    name = options.name or name_from(model)
    metadata = _metadata(compensator, expansion, identity(model))
    content = graph(compensator, expansion, options.precision, metadata).SerializeToString()
    golden, _ = golden_stream(compensator, expansion, full=expansion is whole)
    streams = {"golden": golden.X[golden.valid]} | {
        run.name: compensator.pipeline_.transform(run).to_numpy() for run in options.runs
    }
    checks, remarks = _compared(content, compensator, expansion, streams, options.precision)
    summary = {
        "target": "onnx",
        "name": name,
        "precision": options.precision,
        "form": expansion.form,
        "centres": len(expansion.weights),
        "bytes": len(content),
        "opset": OPSET,
        "files": [*written(name), REPORT],
        **metadata,
    }
    result = OnnxExport(summary, checks, remarks)
    table = pd.DataFrame(streams["golden"], columns=list(compensator.pipeline_.names))
    with whole_folder(out, writes=all_written(model, "onnx", options.name)) as folder:
        (folder / f"{name}.onnx").write_bytes(content)
        table.assign(**_expected(compensator, expansion, table.to_numpy())).to_csv(
            folder / "golden.csv", index=False, float_format="%.17g"
        )
        (folder / REPORT).write_text(to_json(result.to_mapping()) + "\n", encoding="utf-8")
    return result


def written(name: str) -> tuple[str, ...]:
    """Names of the files, besides `report.json`."""
    return (f"{name}.onnx", "golden.csv")


def name_from(model: Path) -> str:
    """Prefix of the files of this model."""
    return model.resolve().name


def graph(compensator: Compensator, expansion: Expansion, precision: str, metadata: Mapping[str, Any]) -> Any:
    """The model as an `onnx.ModelProto`.

    Input `features`, shape (batch, features); outputs `bias_deg_h`, `out_of_range` and `half_width_deg_h`, each of shape (batch,).

    Parameters
    ----------
    compensator : Compensator
    expansion : Expansion
        The exported form of its model.
    precision : {"double", "float"}
    metadata : mapping of str to object
        Written as text into the properties of the model.

    Raises
    ------
    InputError
        onnx is not installed.
    """
    try:
        import onnx
    except ImportError:
        raise InputError('exporting to ONNX needs onnx, which is not installed; pip install "rlgcomp[onnx]"') from None
    helper, real = onnx.helper, np.float64 if precision == "double" else np.float32
    kind = onnx.TensorProto.DOUBLE if precision == "double" else onnx.TensorProto.FLOAT
    made = _Nodes(onnx, real)
    low, high, interval = expansion.low, expansion.high, compensator.interval_
    beyond = made("Max", made("Max", made("Sub", low, "features"), made("Sub", "features", high)), 0.0)
    spans = made.total(made("Div", beyond, np.where(high > low, high - low, 1.0)))
    made("Greater", spans, 0.0, to="out_of_range")
    made("Add", made("Mul", spans, interval.per_span_deg_h), interval.inside_deg_h, to="half_width_deg_h")
    clipped = made("Min", made("Max", "features", expansion.least), expansion.most)
    x = made("Div", made("Sub", clipped, expansion.offset), expansion.scale)
    values = _values(made, expansion, x)
    if len(expansion.straight_deg_h):
        straight = expansion.straight_deg_h / expansion.y_scale_deg_h
        values = made("Add", values, made.total(made("Mul", made("Sub", clipped, expansion.offset), straight)))
    made("Add", made("Mul", values, expansion.y_scale_deg_h), expansion.y_mean_deg_h, to="bias_deg_h")
    body = helper.make_graph(
        made.nodes,
        "rlgcomp",
        [helper.make_tensor_value_info("features", kind, ["batch", expansion.features], ", ".join(metadata["features"]))],
        [
            helper.make_tensor_value_info("bias_deg_h", kind, ["batch"], "estimated bias of the gyro, deg/h"),
            helper.make_tensor_value_info("out_of_range", onnx.TensorProto.BOOL, ["batch"], "an input lies beyond training"),
            helper.make_tensor_value_info("half_width_deg_h", kind, ["batch"], "of the interval about the bias, deg/h"),
        ],
        made.constants,
        doc_string=_DESCRIPTION,
    )
    model = helper.make_model(
        body,
        producer_name="rlgcomp",
        opset_imports=[helper.make_opsetid("", OPSET)],
        ir_version=IR_VERSION,
        doc_string=_DESCRIPTION,
    )
    helper.set_model_props(model, {key: value if isinstance(value, str) else json.dumps(value) for key, value in metadata.items()})
    onnx.checker.check_model(model, full_check=True)
    return model


class _Nodes:
    """Nodes of a graph, written one after the other; numbers become constants."""

    def __init__(self, onnx: Any, real: Any) -> None:
        self.onnx, self.real = onnx, real
        self.nodes: list[Any] = []
        self.constants: list[Any] = []

    def __call__(self, operator: str, *inputs: Any, to: str | None = None, **attributes: Any) -> str:
        names = [value if isinstance(value, str) else self.constant(np.asarray(value, dtype=self.real)) for value in inputs]
        output = to or f"v{len(self.nodes)}"
        self.nodes.append(self.onnx.helper.make_node(operator, names, [output], **attributes))
        return output

    def constant(self, value: npt.NDArray[Any]) -> str:
        name = f"c{len(self.constants)}"
        self.constants.append(self.onnx.numpy_helper.from_array(value, name))
        return name

    def total(self, value: str) -> str:
        """Sum over the second axis."""
        return self("ReduceSum", value, self.constant(np.array([1], dtype=np.int64)), keepdims=0)


def _values(made: _Nodes, e: Expansion, x: str) -> str:
    """v of an expansion, see :mod:`rlgcomp.export.expansion`."""
    if e.form == "polynomial":
        sums: Any = e.powers[-1]
        for row in e.powers[-2::-1]:
            sums = made("Add", made("Mul", sums, x), row)
        return made("Add", made.total(made("Mul", sums, x)), e.constant)
    squares = made.total(made("Mul", x, x))
    if e.form != "wide":
        return made("Add", _over_centres(made, e, _kernel(made, e, x, squares)), e.constant)
    half = made("Tanh", made("Mul", squares, -0.25))
    fall = made(
        "Div", made("Mul", half, 2.0), made("Sub", 1.0, half)
    )  # exp(u) - 1 = 2 tanh(u/2) / (1 - tanh(u/2)), no cancellation
    sums = made.total(made("Mul", x, made("Add", made("MatMul", x, 0.5 * e.quadratic), e.linear)))
    if len(e.weights):
        sums = made("Add", sums, _over_centres(made, e, _third_remainder(made, e, made("MatMul", x, e.centres.T))))
    return made("Add", made("Add", made("Mul", fall, e.level), made("Mul", made("Add", fall, 1.0), sums)), e.constant)


def _kernel(made: _Nodes, e: Expansion, x: str, squares: str) -> str:
    products = made("MatMul", x, e.centres.T)
    if e.form == "power":
        return made("Pow", made("Add", products, e.kernel_offset), float(e.kernel_degree))
    if e.form == "sigmoid":
        return made("Tanh", made("Add", products, e.kernel_offset))
    column = made("Unsqueeze", squares, made.constant(np.array([1], dtype=np.int64)))
    apart = made("Sub", made("Add", column, np.einsum("ij,ij->i", e.centres, e.centres)), made("Mul", products, 2.0))
    squared = made("Max", apart, 0.0)
    if e.form == "gaussian":
        return made("Exp", made("Mul", squared, -0.5))
    far = made("Sqrt", made("Mul", squared, 3.0))
    return made("Mul", made("Add", far, 1.0), made("Exp", made("Neg", far)))


def _third_remainder(made: _Nodes, e: Expansion, u: str) -> str:
    """exp(u) - 1 - u - u²/2: its series where that converges fast, the difference itself elsewhere."""
    series: Any = 1.0
    for k in range(_SERIES, 3, -1):
        series = made("Add", made("Mul", made("Div", u, float(k)), series), 1.0)
    series = made("Mul", made("Div", made("Mul", u, made("Mul", u, u)), 6.0), series)
    if e.largest_argument <= 1.0:
        return str(series)
    direct = made("Sub", made("Sub", made("Sub", made("Exp", u), 1.0), u), made("Mul", made("Mul", u, u), 0.5))
    return made("Where", made("Less", made("Abs", u), 1.0), series, direct)


def _over_centres(made: _Nodes, e: Expansion, basis: str) -> str:
    return made("Squeeze", made("MatMul", basis, e.weights[:, None]), made.constant(np.array([1], dtype=np.int64)))


def _metadata(compensator: Compensator, expansion: Expansion, sha256: str) -> dict[str, Any]:
    return {
        "schema": "rlgcomp.onnx/1",
        "sha256": sha256,
        "what": _DESCRIPTION,
        "gyro": compensator.gyro_,
        "gyro_unit": sorted({str(run.get("unit") or "not stated") for run in compensator.provenance_}),
        "features": list(compensator.pipeline_.names),
        "feature_recipe": compensator.pipeline_.to_list(),
        "unit": "deg/h",
        "reference_deg_h": expansion.reference_deg_h,
        "correction": "subtract bias_deg_h - reference_deg_h from the gyro in deg/h",
        "averaging_s": compensator.averaging_s,
        "interval": compensator.interval_.to_mapping(),
    }


def _expected(compensator: Compensator, expansion: Expansion, X: Array) -> dict[str, Any]:
    return {
        "bias_deg_h": expansion.bias_deg_h(X),
        "out_of_range": expansion.outside(X).astype(np.int64),
        "half_width_deg_h": compensator.half_widths(X),
    }


@contextlib.contextmanager
def _own_temporary_folder() -> Iterator[None]:
    """A folder for what onnxruntime writes into TMPDIR when it is imported, and leaves there: the session of its telemetry."""
    before = os.environ.get("TMPDIR")
    with temporary_folder() as folder:
        os.environ["TMPDIR"] = str(folder)
        try:
            yield
        finally:
            if before is None:
                del os.environ["TMPDIR"]
            else:
                os.environ["TMPDIR"] = before


def _compared(
    content: bytes, compensator: Compensator, expansion: Expansion, streams: Mapping[str, Array], precision: str
) -> tuple[tuple[dict[str, Any], ...], tuple[Message, ...]]:
    """Largest differences from Python, in a batch and row by row."""
    with _own_temporary_folder():
        try:
            import onnxruntime
        except ImportError:
            return (), (message("export.not_compared"),)
        if hasattr(onnxruntime, "disable_telemetry_events"):
            onnxruntime.disable_telemetry_events()
    session = onnxruntime.InferenceSession(content, providers=["CPUExecutionProvider"])
    real: Any = np.float64 if precision == "double" else np.float32
    bound = TOLERANCE_OF_SPAN[precision] * compensator.interval_.per_span_deg_h
    checks = []
    for name, X in streams.items():
        features: npt.NDArray[Any] = X.astype(real)
        expected = _expected(compensator, expansion, X)
        # a limit rounded to single precision may lie on the other side of an input
        near = [np.abs(X - limit) <= 2.0 * np.finfo(real).eps * np.abs(limit) for limit in (expansion.low, expansion.high)]
        certain = ~(near[0] | near[1]).any(axis=1)
        batch = session.run(None, {"features": features})
        single = [
            np.concatenate(parts) for parts in zip(*(session.run(None, {"features": row[None]}) for row in features), strict=True)
        ]
        for how, (bias, outside, width) in (("batch", batch), ("one by one", single)):
            off = float(np.abs(bias - expected["bias_deg_h"]).max())
            off_width = float((np.abs(width - expected["half_width_deg_h"]) / expected["half_width_deg_h"]).max())
            flags = int((outside != expected["out_of_range"])[certain].sum())
            if off > bound or flags or off_width > 1e3 * float(np.finfo(real).eps):
                difference = f"{name}, {how}: off by up to {off:.2g} deg/h of {bound:.2g}, {flags} flags differ"
                if precision == "float":
                    raise InputError(f"single precision cannot carry this model ({difference}); use --precision double")
                raise RuntimeError(f"onnxruntime does not agree with Python: {difference}")
            checks.append({"stream": name, "how": how, "rows": len(X), "largest difference, deg/h": off, "bound, deg/h": bound})
    return tuple(checks), ()
