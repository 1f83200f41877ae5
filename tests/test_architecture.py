"""The shape of the package: what imports what, that every file is where it is announced, and what importing costs."""

from __future__ import annotations

import ast
import functools
import importlib
import pkgutil
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

import rlgcomp
import rlgcomp.diagnosis
from rlgcomp.compensation.models import MODELS
from rlgcomp.physics import CATALOGUE
from rlgcomp.recording.formats import FORMATS

PACKAGE = Path(rlgcomp.__file__).parent
# Bottom to top: a module imports only from its own row and those before it. It belongs to the longest name that it begins with.
ROWS = [
    ["errors"],
    ["units"],
    ["scratch"],
    ["files"],
    ["report.messages", "report.notebook", "report.svg", "report.drawing", "report.page"],
    ["numerics"],
    ["recording"],
    ["noise"],
    ["physics"],
    ["simulation"],
    ["calibration"],
    ["compensation"],
    ["evaluation"],
    ["report"],
    ["diagnosis"],
    ["challenge"],
    ["export"],
    ["workers"],
    ["fleet"],
    ["cli"],
    ["__main__"],
]
MOST_TOP_LEVEL_MODULES = 4  # beside errors and units: a file that belongs to a room lies in it
PUBLIC_NAMES = (  # what scripts of users rely on
    "AllanDeviation", "AngleRandomWalk", "CATALOGUE", "Calibration", "Compensator", "CubicLeastSquares", "Diagnosis",
    "Evaluation", "FeatureRecipe", "FixedSizeLSSVM", "InputError", "KernelBaselines", "LSSVMRegressor", "Mechanism",
    "Metadata", "NoiseCoefficients", "NoiseModel", "Programme", "Recording", "SequenceRegressor", "Simulator", "Triad",
    "TriadErrors", "adapt", "allan_deviation", "analyse_noise", "angle_random_walk", "calibrate_scale_factor",
    "calibrate_turntable", "diagnose", "evaluate", "fit_coefficients", "load", "overlapping_deviation", "read", "recording",
    "simulated_unit", "write",
)  # fmt: skip
ROOMS_OF_DIAGNOSIS = sorted(module.name for module in pkgutil.iter_modules([str(PACKAGE / "diagnosis")]) if module.ispkg)
MODULES = sorted(module.name for module in pkgutil.walk_packages([str(PACKAGE)], "rlgcomp."))


def _row(name: str) -> int:
    inside = name.removeprefix("rlgcomp.")
    rows = {room: k for k, row in enumerate(ROWS) for room in row if inside == room or inside.startswith(f"{room}.")}
    return rows[max(rows, key=len)]


@functools.cache
def _imports(module: str) -> list[ast.Import | ast.ImportFrom]:
    tree = ast.parse(Path(importlib.util.find_spec(module).origin).read_text(encoding="utf-8"))
    return [node for node in ast.walk(tree) if isinstance(node, ast.Import | ast.ImportFrom)]


def _imported(module: str) -> set[str]:
    found = set()
    for node in _imports(module):
        if isinstance(node, ast.ImportFrom) and node.module and node.module.startswith("rlgcomp."):
            found.add(node.module)
        elif isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names if alias.name.startswith("rlgcomp.")}
    return found


def _imported_files(module: str) -> set[str]:
    """Modules that a module imports, a module of a package by its own name; the package itself gives only names and a version."""
    files = set()
    for node in _imports(module):
        if isinstance(node, ast.ImportFrom) and node.module:
            names = {f"{node.module}.{alias.name}" for alias in node.names}
            files |= {name if name in MODULES else node.module for name in names}
        elif isinstance(node, ast.Import):
            files |= {alias.name for alias in node.names}
    return files


@pytest.mark.parametrize("module", MODULES)
def test_imports_only_from_below(module: str) -> None:
    above = {other for other in _imported(module) if _row(other) > _row(module)}
    assert not above


def _circles(imports: dict[str, set[str]]) -> list[set[str]]:
    """Largest sets of modules that reach each other."""

    def reached(start: str) -> set[str]:
        seen, waiting = set(), [start]
        while waiting:
            new = imports[waiting.pop()] - seen
            seen |= new
            waiting += new
        return seen

    reach = {module: reached(module) for module in imports}
    circles = {frozenset(other for other in reach[module] if module in reach[other]) for module in imports}
    return [set(circle) for circle in circles if len(circle) > 1]


def test_files_import_each_other_in_no_circle() -> None:
    imports = {module: (_imported_files(module) & set(MODULES)) - {module} for module in MODULES}
    circles = [{module.removeprefix("rlgcomp.") for module in circle} for circle in _circles(imports)]
    assert not circles


@pytest.mark.parametrize("package", ["rlgcomp.diagnosis", *(f"rlgcomp.diagnosis.{room}" for room in ROOMS_OF_DIAGNOSIS)])
def test_the_list_of_a_room_of_diagnosis_has_every_module_once_and_in_the_order_of_imports(package: str) -> None:
    listed = re.findall(r"^    (\w+)  ", importlib.import_module(package).__doc__, re.MULTILINE)
    depth = package.count(".") + 1
    assert sorted(listed) == sorted(_names_in(package.removeprefix("rlgcomp.").replace(".", "/")))
    later = {}
    for module in (name for name in MODULES if name.startswith(f"{package}.")):
        of = module.split(".")[depth]
        imported = {name.split(".")[depth] for name in _imported_files(module) if name.startswith(f"{package}.")}
        later |= {module: {name for name in imported if listed.index(name) > listed.index(of)}}
    assert not {module: names for module, names in later.items() if names}


def test_the_top_level_has_few_modules() -> None:
    top = {module.name for module in pkgutil.iter_modules([str(PACKAGE)]) if not module.ispkg}
    assert len(top - {"errors", "units", "__main__"}) <= MOST_TOP_LEVEL_MODULES


@pytest.mark.parametrize("module", MODULES)
def test_every_module_says_what_it_is(module: str) -> None:
    assert (importlib.import_module(module).__doc__ or "").strip()


def _names_in(folder: str) -> set[str]:
    return {module.name for module in pkgutil.iter_modules([str(PACKAGE / folder)])}


def test_every_mechanism_file_is_in_the_catalogue() -> None:
    assert _names_in("physics") - {"mechanism", "plugins", "user"} == set(CATALOGUE)


def test_every_format_file_is_in_the_list() -> None:
    assert _names_in("recording/formats") - {
        "arrow",
        "bytes_of_text",
        "channels",
        "contents",
        "dialect",
        "joining",
        "labview",
        "limits",
        "mapping",
        "numbers",
        "pieces",
    } == {form.__name__.rsplit(".", 1)[1] for form in FORMATS}


def test_every_model_file_is_in_the_list() -> None:
    modules = {name: importlib.import_module(f"rlgcomp.compensation.models.{name}") for name in _names_in("compensation/models")}
    assert {name for name, module in modules.items() if hasattr(module, "SPECIFICATION") or hasattr(module, "SPECIFICATIONS")} == {
        specification.estimator.__module__.rsplit(".", 1)[1] for specification in MODELS.values()
    }


def test_public_names_are_those_promised_exist_and_are_documented() -> None:
    assert sorted(rlgcomp.__all__) == sorted(PUBLIC_NAMES)
    for name in set(rlgcomp.__all__) - {"CATALOGUE"}:
        assert (getattr(rlgcomp, name).__doc__ or "").strip(), name
    with pytest.raises(AttributeError, match="no attribute 'absent'"):
        _ = rlgcomp.absent


_HEAVY = ["numpy", "pandas", "scipy", "sklearn", "torch", "matplotlib", "pyarrow"]


def _names_used(tree: ast.Module) -> Iterator[str]:
    """What a test imports from the package or its experiments, reads of an object, or replaces by `setattr`."""
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[0] in ("rlgcomp", "experiments"):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.Attribute) and not (isinstance(node.value, ast.Name) and node.value.id == "self"):
            yield node.attr
        elif isinstance(node, ast.Call) and getattr(node.func, "attr", "") in ("setattr", "setitem"):
            strings = (one.value for one in node.args[:2] if isinstance(one, ast.Constant) and isinstance(one.value, str))
            yield from (name.rpartition(".")[2] for name in strings)


def _modules_imported(tree: ast.Module) -> set[str]:
    return {node.module or "" for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)}


@pytest.mark.parametrize("path", sorted(Path(__file__).parent.glob("*.py")), ids=lambda path: path.stem)
def test_tests_use_public_names_and_import_no_other_test(path: Path) -> None:
    """Names between underscores are protocols of other libraries."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    imported = _modules_imported(tree)
    assert not [name for name in imported if name.removeprefix("tests.").startswith(("test_", "conftest"))]
    assert not [name for name in _names_used(tree) if name.startswith("_") and not name.endswith("_")]


@pytest.mark.parametrize(
    ("code", "heavy"),
    [
        ("import rlgcomp", _HEAVY),
        ("import rlgcomp.cli.base", _HEAVY),
        (
            "import rlgcomp, rlgcomp.diagnosis.diagnose; rlgcomp.simulated_unit(1).simulate('short', step_s=60.0)",
            ["scipy.signal", "scipy.stats", "sklearn", "torch", "matplotlib"],
        ),  # a second
    ],
)
def test_import_brings_no_heavy_library(code: str, heavy: list[str]) -> None:
    check = f"{code}; import sys; print([name for name in {heavy} if name in sys.modules])"
    assert _printed(check) == ["[]"]


def _printed(code: str) -> list[str]:
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.splitlines()


def test_a_module_that_is_imported_late_is_itself_at_its_first_use() -> None:
    """A model's module brings no heavy library either."""
    heavy = ["scipy.signal", "scipy.stats._stats_py", "torch", "matplotlib"]
    code = f"import rlgcomp.compensation.compensator, sys; print([name for name in {heavy} if name in sys.modules])"
    code += "; import scipy.stats.distributions; from scipy import stats"
    code += "; print(stats.norm.ppf(0.5), sys.modules['scipy.stats'] is scipy.stats is stats)"
    assert _printed(code) == ["[]", "0.0 True"]


def test_tests_of_optional_libraries_are_marked_as_such() -> None:
    """`.ci/run` runs those marked `needs` where the libraries are, and no others: one that skips itself would run nowhere."""
    for file in Path(__file__).parent.glob("test_*.py"):
        skips = [line for line in file.read_text(encoding="utf-8").splitlines() if "importorskip" + "(" in line]
        assert not skips or "\npytestmark = pytest.mark.needs(" in file.read_text(encoding="utf-8"), file.name
