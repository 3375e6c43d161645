"""The import rule: stages know the types, not each other; the toolkit does not know the trainer."""

from __future__ import annotations

import ast
import importlib.util
import tomllib
from functools import cache
from graphlib import TopologicalSorter
from pathlib import Path

import pytest

from realsim.errors import EXTRA_OF

ROOT = Path(__file__).resolve().parents[1]
BASE = {
    "types",
    "contact_limits",
    "correlation",
    "errors",
    "registry",
    "files",
    "geometry",
    "meshes",
    "models",
    "notebook",
    "ordered",
    "progress",
    "resampling",
    "bags",
}
STAGES = {"capture", "feedforward", "scale", "align", "meshing", "exports", "robots", "report", "gap", "logs", "synth"}
# Who may know more: results of the gap are shown with the report's parts; scenes can hold robots.
ALSO = {"gap": {"report", "robots"}, "exports": {"robots"}, "report": set(), "synth": set()}


@cache
def imported(path: Path) -> set[str]:
    """Absolute module names that a file imports, anywhere in it."""
    names: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module and node.level == 0:
            names |= {f"{node.module}.{alias.name}" for alias in node.names}
    return names


@pytest.mark.parametrize("stage", sorted(STAGES))
def test_stage_imports_only_the_base_and_itself(stage: str) -> None:
    allowed = BASE | {stage} | ALSO.get(stage, set())
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
        assert not bound(init) & inside, init


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
    for node in ast.parse(path.read_text()).body:
        if isinstance(node, ast.Import | ast.ImportFrom):
            names |= {a.name for a in node.names} if isinstance(node, ast.Import) else {node.module or ""}
    return {name.split(".")[0] for name in names}


@pytest.mark.parametrize("package", [*EXTRA_OF, "mujoco"])
def test_core_works_without_heavy_packages(package: str) -> None:
    """Nothing imports an optional package, or MuJoCo, at module level (tests/test_api.py runs the core alone)."""
    for path in sorted((ROOT / "realsim").rglob("*.py")):
        assert package not in imported_at_once(path), f"{path} imports {package} at once"


def test_every_module_of_the_table_of_extras_has_one() -> None:
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]
    assert set(EXTRA_OF.values()) <= set(extras)


def test_every_extra_that_a_message_names_exists() -> None:
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]
    named = [
        node.args[1]
        for package in ("realsim", "trainer")
        for path in (ROOT / package).rglob("*.py")
        for node in ast.walk(ast.parse(path.read_text()))
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "MissingExtraError"
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


def test_packages_of_the_gap_have_no_circles() -> None:
    """Each can be read once those below it are known."""
    gap = ROOT / "realsim" / "gap"
    folders = [p.name for p in gap.iterdir() if (p / "__init__.py").is_file()]
    below: dict[str, set[str]] = {}
    for path in sorted(gap.rglob("*.py")):
        inside = path.relative_to(gap).parts
        parts = [name.split(".")[2] for name in imported(path) if name.startswith("realsim.gap.")]
        others = {p if p in folders else f"{p}.py" for p in parts if p in folders or (gap / f"{p}.py").is_file()}
        below.setdefault(inside[0], set()).update(others - {inside[0]})
    order = TopologicalSorter(below).static_order()  # raises CycleError with the circle
    assert set(folders) <= set(order)
