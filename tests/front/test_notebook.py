"""docs/how_to/own_data.ipynb runs from its first cell to its last, as a script."""

from __future__ import annotations

import ast
import json
from pathlib import Path
from typing import Any

import pytest

NOTEBOOK = Path(__file__).parents[2] / "docs" / "how_to" / "own_data.ipynb"


def cells() -> list[str]:
    content = json.loads(NOTEBOOK.read_text(encoding="utf-8"))
    return ["".join(c["source"]) for c in content["cells"] if c["cell_type"] == "code"]


def shown(code: str, names: dict[str, Any]) -> Any:
    """Run a cell; what its last line is, if that is an expression."""
    *lines, last = ast.parse(code).body
    exec(compile(ast.Module(lines, []), NOTEBOOK.name, "exec"), names)
    if isinstance(last, ast.Expr):
        return eval(compile(ast.Expression(last.value), NOTEBOOK.name, "eval"), names)
    exec(compile(ast.Module([last], []), NOTEBOOK.name, "exec"), names)
    return None


def test_it_runs(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    assert 8 <= len(cells()) <= 11
    names: dict[str, Any] = {}
    results = [shown(code, names) for code in cells()]
    assert results[-1].is_file() and "daqp" in results[-1].read_text()
    assert results[-2]._repr_png_().startswith(b"\x89PNG")
    recording, same, rows = names["recording"], names["same"], names["rows"]
    assert len(recording.qps) == 40 == len(same.qps)
    assert all((one.A == other.A).all() and (one.d == other.d).all()
               for one, other in zip(recording.qps, same.qps, strict=True))  # fmt: skip
    assert set(rows["verdict"]) == {"verified"} and set(rows["arm"]) == {"cold", "warm"}


def test_it_is_stored_without_output() -> None:
    content = json.loads(NOTEBOOK.read_text(encoding="utf-8"))
    assert not any(cell.get("outputs") for cell in content["cells"])
