"""Print the numbers of some revisions and of the working tree: `python -m experiments.house [REVISION...]`."""

from __future__ import annotations

import ast
import io
import subprocess
import sys
import tarfile
import tempfile
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

from experiments.tables import show_table

ROOT = Path(__file__).resolve().parents[2]
BEFORE = ("668a3f5", "57edf31")  # before the rooms were rebuilt, and after their first move
LONG = 400  # lines of a module that is no page any more
FEW = 3  # arguments from which a function describes them in a section


def main(revisions: list[str]) -> None:
    """One column a revision, the working tree last."""
    columns = {}
    for revision in revisions:
        with tempfile.TemporaryDirectory() as folder:
            command = ["git", "-C", str(ROOT), "archive", revision]
            tree = subprocess.run(command, capture_output=True, check=False)  # noqa: S603
            if tree.returncode:
                raise SystemExit(f"{revision}: {tree.stderr.decode().strip()}; a shallow clone has no older revisions")
            with tarfile.open(fileobj=io.BytesIO(tree.stdout)) as archive:
                archive.extractall(folder, filter="data")
            columns[revision] = numbers(Path(folder))
    columns["working tree"] = numbers(ROOT)
    names = list(columns["working tree"])
    show_table("The house", [{"": name, **{column: values[name] for column, values in columns.items()}} for name in names])


def numbers(root: Path) -> dict[str, str]:
    """The rows of one tree."""
    package = root / "rlgcomp"
    modules = {_name(file, root): ast.parse(file.read_text(encoding="utf-8")) for file in sorted(package.rglob("*.py"))}
    lines = sum((_lines(file) for file in package.rglob("*.py")), Counter[str]())
    imports = {name: _imports(name, tree, set(modules)) for name, tree in modules.items()}
    importers = Counter(target for targets in imports.values() for target in targets)
    lone = [name for name in modules if importers[name] == 1]
    functions = [(name, described) for name, tree in modules.items() for described in _functions(tree)]
    lacking = Counter(_room(name) for name, described in functions if not described)
    mechanism = next(node for node in modules["rlgcomp.physics.mechanism"].body if getattr(node, "name", "") == "Mechanism")
    hooks = [node for node in ast.iter_child_nodes(mechanism) if isinstance(node, ast.FunctionDef) and node.name[0] != "_"]
    return {
        "modules": f"{len(modules)}",
        "of them outside diagnosis": f"{sum(_room(name) != 'diagnosis' for name in modules)}",
        f"of more than {LONG} lines": f"{sum(_length(file) > LONG for file in package.rglob('*.py'))}",
        "lines of code": f"{lines['code']}",
        "lines of docstrings": f"{lines['docstring']}",
        "lines of comment": f"{lines['comment']}",
        "files at the top level": f"{len(list(package.glob('*.py')))}",
        "modules in circles of imports": f"{_in_circles(imports)}",
        "modules with one importer": f"{len(lone)}",
        "of them outside diagnosis and commands": f"{sum(_room(name) not in ('diagnosis', 'cli') for name in lone)}",
        "modules of compensation and of calibration": ", ".join(
            f"{sum(_room(name) == room for name in modules if not _is_package(name, modules))}"
            for room in ("compensation", "calibration")
        ),
        "public methods of a mechanism": f"{len(hooks)}",
        f"public functions of {FEW} arguments and more": f"{len(functions)}",
        "of them without a Parameters section": f"{sum(lacking.values())}",
        "of these in diagnosis": f"{lacking['diagnosis']}",
        "of these in commands, whose options have help texts": f"{lacking['cli']}",
        "words of docs/design.md": f"{_words(root / 'docs' / 'design.md')}",
        "words of CHANGELOG.md": f"{_words(root / 'CHANGELOG.md')}",
    }


def _name(file: Path, root: Path) -> str:
    return ".".join(file.relative_to(root).with_suffix("").parts).removesuffix(".__init__")


def _room(name: str) -> str:
    return [*name.split("."), ""][1]


def _is_package(name: str, modules: dict[str, ast.Module]) -> bool:
    return any(other.startswith(f"{name}.") for other in modules)


def _length(file: Path) -> int:
    return len(file.read_text(encoding="utf-8").splitlines())


def _words(file: Path) -> int:
    return len(file.read_text(encoding="utf-8").split())


def _lines(file: Path) -> Counter[str]:
    """Lines by kind; those of a docstring count as such, its blank ones too."""
    text = file.read_text(encoding="utf-8")
    kinds = ["" if not line.strip() else "comment" if line.strip().startswith("#") else "code" for line in text.splitlines()]
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef) and ast.get_docstring(node) is not None:
            first, last = node.body[0].lineno - 1, node.body[0].end_lineno or 0
            kinds[first:last] = ["docstring"] * (last - first)
    return Counter(kinds)


def _imports(module: str, tree: ast.Module, modules: set[str]) -> set[str]:
    """Modules of the package that a module imports, deferred imports and those for types alone included."""
    targets = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and node.module and not node.level:
            names = {f"{node.module}.{alias.name}" for alias in node.names}
            targets |= {name if name in modules else node.module for name in names}
        elif isinstance(node, ast.Import):
            targets |= {alias.name for alias in node.names}
    return (targets & modules) - {module, "rlgcomp"}


def _in_circles(imports: dict[str, set[str]]) -> int:
    """Number of modules that reach themselves; the package's own module is left out, which imports by name on first use."""

    def reaches_itself(start: str) -> bool:
        seen: set[str] = set()
        waiting = list(imports[start])
        while waiting:
            module = waiting.pop()
            if module == start:
                return True
            if module not in seen:
                seen.add(module)
                waiting += imports[module]
        return False

    return sum(reaches_itself(module) for module in imports if module != "rlgcomp")


def _functions(node: ast.AST) -> Iterator[bool]:
    """Of each public function and method of three arguments and more: whether it describes them."""
    for child in ast.iter_child_nodes(node):
        if isinstance(child, ast.ClassDef) and not child.name.startswith("_"):
            yield from _functions(child)
        if isinstance(child, ast.FunctionDef) and not child.name.startswith("_"):
            arguments = [*child.args.posonlyargs, *child.args.args, *child.args.kwonlyargs]
            if sum(argument.arg not in ("self", "cls") for argument in arguments) >= FEW:
                yield "Parameters\n" in (ast.get_docstring(child) or "")


if __name__ == "__main__":
    main(sys.argv[1:] or list(BEFORE))
