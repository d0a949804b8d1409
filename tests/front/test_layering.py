"""Imports point one way: problems ← solvers ← harness ← reports."""

from __future__ import annotations

import ast
import subprocess
import sys
from pathlib import Path

import pytest

from tests.conftest import ROUNDING, SLOW

ROOT = Path(__file__).parents[1]
MAY_IMPORT = {
    "problems": {"problems"},
    "solvers": {"problems", "solvers"},
    "harness": {"problems", "solvers", "harness"},
    "reports": {"problems", "harness", "reports"},
}
"""Which of the project's packages each may name.  `reports` runs no solver."""

HEAVY = (
    *("matplotlib", "osqp", "proxsuite", "clarabel", "daqp", "quadprog", "piqp", "highspy", "scs"),
    *("cvxpy", "qpsolvers"),
)
"""Optional or slow packages, which load where they are used."""

FILES = sorted(path for package in MAY_IMPORT for path in (ROOT / package).rglob("*.py"))


def imported(path: Path) -> set[str]:
    """Every module that a file names in an import, at whatever depth."""
    names = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative import"
            names.add(node.module or "")
    return names


@pytest.mark.parametrize("path", FILES, ids=lambda path: str(path.relative_to(ROOT)))
def test_imports_point_one_way(path: Path) -> None:
    package = path.relative_to(ROOT).parts[0]
    named = {name.partition(".")[0] for name in imported(path)} & set(MAY_IMPORT)
    if path.parent == ROOT / "harness" / "cli":
        return  # it alone names all four
    assert named <= MAY_IMPORT[package]


@pytest.mark.parametrize(
    "path", sorted((ROOT / "solvers").rglob("*.py")), ids=lambda p: str(p.relative_to(ROOT))
)
def test_solvers_know_the_qp_and_nothing_else_of_the_physics(path: Path) -> None:
    named = {name for name in imported(path) if name.partition(".")[0] == "problems"}
    known = {"problems.qp", "problems.qp_kernel"}
    if path.parent.name == "active_set" and path.stem == "compiled":
        known |= {"problems"}  # how kernels are compiled
    assert named <= known


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
        "import harness.study, harness.verify, harness.display",
    ],
)
def test_importing_a_package_loads_nothing_heavy(statement: str) -> None:
    assert not loaded_after(statement) & set(HEAVY)


def test_the_command_line_loads_no_numerics() -> None:
    assert not loaded_after("import harness.cli") & {"numpy", "scipy", "pandas", "h5py", *HEAVY}


def test_functions_of_the_interface_stay_functions_whichever_is_imported_first() -> None:
    code = (
        "import harness.judge, harness.replay, harness.record\n"
        "from harness.judge import Judgement\n"
        "from harness import judge, record, replay\n"
        "import harness\n"
        "assert callable(judge) and callable(record) and callable(replay)\n"
        "assert harness.judge is judge and Judgement.__module__ == 'harness.judge'\n"
    )
    subprocess.run([sys.executable, "-c", code], cwd=ROOT, check=True)


def test_modules_that_are_left_out_or_run_once_more_exist() -> None:
    known = {path.stem for path in (ROOT / "tests").rglob("test_*.py")}
    assert {name for names in (*SLOW.values(), ROUNDING) for name in names.split()} <= known
