"""Every command of docs/how_to/own_data.md runs; its block of code does in `test_docs`."""

from __future__ import annotations

import importlib.util
import re
import shlex
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from typer.testing import CliRunner

from glambda.cli import app

PAGE = (Path(__file__).parents[2] / "docs" / "how_to" / "own_data.md").read_text(encoding="utf-8")
COMMANDS = re.findall(r"^    (glambda .*)$", PAGE, flags=re.M)
BALL = """<mujoco><worldbody><geom type="plane" size="9 9 1"/>
<body pos="0 0 0.1"><freejoint/><geom size="0.1"/></body></worldbody></mujoco>"""


def test_it_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    A = np.random.default_rng(0).standard_normal((5, 3))
    b = np.random.default_rng(1).standard_normal(5)
    for name in ("mine", "first", "second"):
        np.savez(f"{name}.npz", A=A, b=b, lb=np.zeros(3))
    pq.write_table(pa.table({"P": [(A.T @ A).ravel()], "q": [A.T @ b]}), "set.parquet")
    Path("model.xml").write_text(BALL)
    run = CliRunner().invoke
    made = run(app, ["record", "fig4", "--until", "0.5", "-o", "recordings"])
    assert made.exit_code == 0, made.output
    ran = 0
    for command in COMMANDS:
        if "mujoco:" in command and importlib.util.find_spec("mujoco") is None:
            continue
        words = shlex.split(command.replace("--until 5", "--until 0.1"))[1:]
        if "rigid=true" in command:
            words += ["--until", "0.1"]
        told = run(app, words)
        assert told.exit_code == 0, f"{command}\n{told.output}"
        ran += 1
    assert ran >= 8


def test_every_file_that_is_named_is_there() -> None:
    root = Path(__file__).parents[2]
    named = re.findall(r"`(harness/[\w/]+\.py)`", PAGE)
    assert named and all((root / name).is_file() for name in named)
