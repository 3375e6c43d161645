"""The import rule: stages know the types, not each other; the toolkit does not know the trainer."""

import ast
import importlib.util
import tomllib
from functools import cache
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

from realsim.core.errors import EXTRA_OF

ROOT = Path(__file__).resolve().parents[1]
STAGES = {"capture", "feedforward", "scale", "align", "meshing", "export", "robots", "report", "gap", "synth"}
# Who may know more: results of the gap are shown with the report's parts; scenes can hold robots.
ALSO = {"core": set(), "gap": {"report", "robots"}, "export": {"robots"}}


@cache
def nodes(path: Path) -> list[ast.AST]:
    """What the tests look at: imports, blocks for type checkers, and errors that name an extra."""
    return [
        node
        for node in ast.walk(ast.parse(path.read_text()))
        if isinstance(node, ast.Import | ast.ImportFrom)
        or (isinstance(node, ast.If) and getattr(node.test, "id", "") == "TYPE_CHECKING")
        or (isinstance(node, ast.Call) and getattr(node.func, "id", "") == "MissingExtraError")
    ]


@cache
def imported(path: Path) -> set[str]:
    """Absolute module names that a file imports, anywhere in it."""
    names: set[str] = set()
    for node in nodes(path):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module and node.level == 0:
            names |= {f"{node.module}.{alias.name}" for alias in node.names}
    return names


@pytest.mark.parametrize("stage", sorted(STAGES | {"core"}))
def test_stage_imports_only_the_core_and_itself(stage: str) -> None:
    allowed = {"core", stage} | ALSO.get(stage, set())
    for path in sorted((ROOT / "realsim" / stage).rglob("*.py")):
        for name in imported(path):
            parts = name.split(".")
            if parts[0] == "realsim" and len(parts) > 1 and parts[1] != "__version__":
                assert parts[1] in allowed, f"{path.relative_to(ROOT)} imports {name}"


def test_realsim_never_imports_trainer() -> None:
    for path in sorted((ROOT / "realsim").rglob("*.py")):
        assert not any(n.split(".")[0] == "trainer" for n in imported(path)), path


@pytest.mark.parametrize("package", ["realsim", "trainer"])
def test_no_name_of_a_package_hides_a_module_in_it(package: str) -> None:
    """`import realsim.a.b as m` would give whatever the package calls `b` instead of the module."""
    for init in sorted((ROOT / package).rglob("__init__.py")):
        inside = {p.stem for p in init.parent.glob("*.py")} | {p.parent.name for p in init.parent.glob("*/__init__.py")}
        # `rs.export` is the function since 0.1; the package of its name is imported before it (realsim/__init__.py).
        known = {"export"} if init == ROOT / "realsim" / "__init__.py" else set()
        assert bound(init) & inside == known, init


def bound(path: Path) -> set[str]:
    """Names that a file defines or imports at its top level, modules aside."""
    names: set[str] = set()
    for node in ast.parse(path.read_text()).body:
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            names.add(node.name)
        elif isinstance(node, ast.ImportFrom):
            names |= {a.asname or a.name for a in node.names if not _is_module(f"{node.module}.{a.name}")}
    return names


@cache
def imported_at_once(path: Path) -> set[str]:
    """First parts of the module names that a file imports at its top level."""
    names: set[str] = set()
    for node in nodes(path):
        if isinstance(node, ast.Import | ast.ImportFrom) and node.col_offset == 0:
            names |= {a.name for a in node.names} if isinstance(node, ast.Import) else {node.module or ""}
    return {name.split(".")[0] for name in names}


@pytest.mark.parametrize("package", [*EXTRA_OF, "mujoco"])
def test_core_works_without_heavy_packages(package: str) -> None:
    """Nothing imports an optional package, or MuJoCo, at module level (tests/test_api.py runs the core alone)."""
    for path in sorted((ROOT / "realsim").rglob("*.py")):
        assert package not in imported_at_once(path), f"{path} imports {package} at once"
        if package == "open3d":
            whole = {n.module for n in nodes(path) if isinstance(n, ast.ImportFrom) and n.col_offset == 0}
            assert "realsim.core.open3d" not in whole, f"{path} imports it at once"


def test_every_module_of_the_table_of_extras_has_one() -> None:
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]
    assert set(EXTRA_OF.values()) <= set(extras)


def test_every_extra_that_a_message_names_exists() -> None:
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]
    named = [
        node.args[1]
        for package in ("realsim", "trainer")
        for path in (ROOT / package).rglob("*.py")
        for node in nodes(path)
        if isinstance(node, ast.Call)
    ]
    assert {arg.value for arg in named if isinstance(arg, ast.Constant)} <= set(extras)
    assert len(named) > 5


@pytest.mark.parametrize("folder", ["benchmarks", "examples", "tools"])
def test_scripts_import_what_exists(folder: str) -> None:
    """Scripts that no test runs would else be found broken by whoever runs them."""
    ours = {n for path in sorted((ROOT / folder).rglob("*.py")) for n in imported(path)}
    for name in sorted(n for n in ours if n.split(".")[0] in ("realsim", "trainer", "benchmarks")):
        module, _, attribute = name.rpartition(".")
        assert _is_module(name) or hasattr(importlib.import_module(module), attribute), f"{folder}: no {name}"


def _is_module(name: str) -> bool:
    try:
        return importlib.util.find_spec(name) is not None
    except ModuleNotFoundError:
        return False


OURS = ("realsim", "trainer", "training", "benchmarks")


@cache
def modules() -> dict[str, Path]:
    """Dotted name -> file of every module of the project."""
    found = {}
    for path in (p for package in OURS for p in sorted((ROOT / package).rglob("*.py"))):
        parts = path.relative_to(ROOT).with_suffix("").parts
        found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return found


def needed(name: str) -> set[str]:
    """Modules of the project that a module imports anywhere in its file, blocks for type checkers aside."""
    found = nodes(modules()[name])
    skipped = {id(inner) for block in found if isinstance(block, ast.If) for inner in ast.walk(block)}
    names: set[str] = set()
    for node in (n for n in found if id(n) not in skipped):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            whole = {f"{node.module}.{alias.name}" for alias in node.names} - {"realsim.__version__"}
            names |= {n if n in modules() else node.module for n in whole}
    return {n for n in names if n in modules()} - {name}


def circle(graph: dict[str, set[str]]) -> list[str] | None:
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        return list(error.args[1])
    return None


def test_no_modules_import_each_other() -> None:
    assert circle({name: needed(name) for name in modules()}) is None


def test_rooms_of_the_gap_have_no_circles() -> None:
    """A room is a folder; in case, inference and checks each folder below is one."""
    gap = ROOT / "realsim" / "gap"

    def room(name: str) -> str:
        inside = modules()[name].relative_to(gap).parts
        return "/".join(inside[:2] if inside[0] in ("case", "inference", "checks") and len(inside) > 2 else inside[:1])

    inside = [name for name in modules() if name.startswith("realsim.gap.")]
    graph: dict[str, set[str]] = {}
    for name in inside:
        others = {room(other) for other in needed(name) if other in inside}
        graph.setdefault(room(name), set()).update(others - {room(name)})
    assert circle(graph) is None
