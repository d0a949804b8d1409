"""Imports point one way: problems ← solvers ← harness ← reports ← glambda."""

from __future__ import annotations

import ast
import subprocess
import sys
from graphlib import TopologicalSorter
from pathlib import Path

import pytest

import glambda
from tests.conftest import ROUNDING, SLOW

ROOT = Path(__file__).parents[2]
MAY_IMPORT = {
    "problems": {"problems"},
    "solvers": {"problems", "solvers"},
    "harness": {"problems", "solvers", "harness"},
    "reports": {"problems", "harness", "reports"},
    "glambda": {"problems", "solvers", "harness", "reports", "glambda"},
}
"""Which of the project's packages each may name.  `reports` runs no solver."""

HEAVY = (
    *("matplotlib", "osqp", "proxsuite", "clarabel", "daqp", "quadprog", "piqp", "highspy", "scs"),
    *("cvxpy", "qpsolvers"),
)
"""Optional or slow packages, which load where they are used."""

KNOWN = {"qp", "qp_kernel", "kernels", "registry", "short"}
"""Modules of `problems` that a solver may know: the QP, how kernels are compiled, names."""

FILES = sorted(path for package in MAY_IMPORT for path in (ROOT / package).rglob("*.py"))


def imported(path: Path) -> set[str]:
    """Every module that a file names in an import, at whatever depth."""
    names = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative import"
            module = node.module or ""
            folder = ROOT.joinpath(*module.split("."))
            files = {alias.name for alias in node.names if (folder / f"{alias.name}.py").is_file()}
            names |= {f"{module}.{name}" for name in files} or {module}
    return names


@pytest.mark.parametrize("path", FILES, ids=lambda path: str(path.relative_to(ROOT)))
def test_imports_point_one_way(path: Path) -> None:
    package = path.relative_to(ROOT).parts[0]
    named = {name.partition(".")[0] for name in imported(path)} & set(MAY_IMPORT)
    assert named <= MAY_IMPORT[package]


@pytest.mark.parametrize(
    "path", sorted((ROOT / "solvers").rglob("*.py")), ids=lambda p: str(p.relative_to(ROOT))
)
def test_solvers_know_the_qp_and_nothing_else_of_the_physics(path: Path) -> None:
    named = {name for name in imported(path) if name.partition(".")[0] == "problems"}
    assert {name.removeprefix("problems.").partition(".")[0] for name in named} <= KNOWN


def test_no_file_is_missed() -> None:
    assert {path.relative_to(ROOT).parts[0] for path in FILES} == set(MAY_IMPORT)


def loaded_after(statement: str) -> set[str]:
    """Top-level modules in a fresh interpreter after a statement."""
    code = f"import sys; {statement}; print(' '.join({{m.partition('.')[0] for m in sys.modules}}))"
    out = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True
    )
    return set(out.stdout.split())


@pytest.mark.parametrize(
    "statement",
    [
        "import problems",
        "import solvers",
        "import reports",
        "from harness import judge, record, replay",
        "import harness.study.study, harness.study.verify, glambda.display.recordings",
    ],
)
def test_importing_a_package_loads_nothing_heavy(statement: str) -> None:
    assert not loaded_after(statement) & set(HEAVY)


def test_the_command_line_loads_no_numerics() -> None:
    assert not loaded_after("import glambda, glambda.cli") & {
        "numpy",
        "scipy",
        "pandas",
        "h5py",
        *HEAVY,
    }


def test_the_front_door_has_what_it_names() -> None:
    code = (
        "import glambda, harness\n"
        "assert all(getattr(glambda, name) is not None for name in dir(glambda))\n"
        "assert callable(harness.judge) and callable(harness.record) and callable(harness.replay)\n"
    )
    subprocess.run([sys.executable, "-c", code], cwd=ROOT, check=True)


def test_the_front_door_is_typed_as_it_is_loaded() -> None:
    tree = ast.parse((ROOT / "glambda" / "__init__.py").read_text(encoding="utf-8"))
    typed = {
        (alias.name, node.module)
        for node in ast.walk(tree)
        if isinstance(node, ast.ImportFrom) and node.module not in ("__future__", "typing")
        for alias in node.names
    }
    named = {(n, module) for module, names in glambda.HOMES.items() for n in names.split()}
    assert typed - {("metadata", "importlib")} == named
    assert {name for name, _ in named} | {"__version__"} == set(glambda.__all__)


def test_packages_do_not_import_each_other_in_a_circle() -> None:
    """Rooms of a floor: no circle between the files of `problems`, `solvers`, `harness` …"""
    modules = {".".join(path.relative_to(ROOT).with_suffix("").parts): path for path in FILES}
    names = {module.removesuffix(".__init__"): module for module in modules}
    graph = {
        module: {names[name] for name in imported_at_the_top(path) if name in names} - {module}
        for module, path in modules.items()
    }
    list(TopologicalSorter(graph).static_order())  # raises CycleError


def imported_at_the_top(path: Path) -> set[str]:
    """Modules that a file imports when it is imported itself."""
    found = set()
    for node in ast.parse(path.read_text(encoding="utf-8")).body:
        if isinstance(node, ast.ImportFrom) and node.module:
            found |= {node.module, *(f"{node.module}.{alias.name}" for alias in node.names)}
        elif isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
    return found


def test_modules_that_are_left_out_or_run_once_more_exist() -> None:
    known = {path.stem for path in (ROOT / "tests").rglob("test_*.py")}
    assert {name for names in (*SLOW.values(), ROUNDING) for name in names.split()} <= known
