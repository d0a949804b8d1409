"""What users write: `import glambda`, `python -m glambda`, names instead of objects."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

import glambda
from harness.recordings.recording import write_recording

TYPED = """
import glambda

run = glambda.simulate("fig4", until=0.1)
reveal_type(run.counts)
reveal_type(glambda.judge)
glambda.simulate(4)
"""


def test_a_scene_and_a_solver_are_named_or_given() -> None:
    run = glambda.simulate("fig4", until=0.05)
    same = glambda.simulate(glambda.scene("fig4"), glambda.make_solver("glambda"), until=0.05)
    other = glambda.simulate("fig4", "quadprog", until=0.05)
    assert run.q.tobytes() == same.q.tobytes()
    assert abs(other.q[-1] - run.q[-1]).max() < 1e-5
    with pytest.raises(ValueError, match="unknown scene 'fig9'"):
        glambda.simulate("fig9")
    with pytest.raises(ValueError, match="unknown solver 'nobody'"):
        glambda.simulate("fig4", "nobody")


@pytest.mark.parametrize("command", ["scenes", "solvers", "info"])
def test_what_lists_compiles_nothing(command: str, tmp_path: Path) -> None:
    home, named = tmp_path / "home", []
    if command == "info":
        named = [str(tmp_path / "few.h5")]
        write_recording(tmp_path / "few.h5", glambda.record("fig4", until=0.02))
    done = subprocess.run(
        [sys.executable, "-m", "glambda", command, *named],
        env={**os.environ, "XDG_CACHE_HOME": str(home)},
        capture_output=True,
        text=True,
        check=True,
    )
    assert not [path for path in home.rglob("*") if path.is_file()]
    assert "compiling" not in done.stderr


def test_a_recording_has_a_reference_of_every_qp() -> None:
    recording = glambda.record("fig4", until=0.02)
    assert recording.qps and None not in recording.references
    solver = glambda.make_solver("daqp", accuracy=1e-9)
    verdict = glambda.judge(recording.qps[0], solver.solve(recording.qps[0]).x)
    assert verdict.verdict == "verified"


def test_what_is_not_there_is_said() -> None:
    with pytest.raises(AttributeError, match="no attribute 'simulation'"):
        glambda.simulation  # noqa: B018


def test_the_command_is_a_module_too() -> None:
    run = [sys.executable, "-m", "glambda", "--version"]
    done = subprocess.run(run, capture_output=True, text=True, check=True)
    assert done.stdout == f"glambda {glambda.__version__}\n"


def test_a_user_s_type_checker_sees_the_types(tmp_path: Path) -> None:
    (tmp_path / "mine.py").write_text(TYPED)
    run = [sys.executable, "-m", "mypy", "mine.py", "--cache-dir", str(tmp_path / "cache")]
    said = subprocess.run(run, capture_output=True, text=True, cwd=tmp_path).stdout
    assert re.search('Revealed type is ".*dict.*str.*int', said)
    assert "judging.judge.Judgement" in said and 'has incompatible type "int"' in said
    assert "untyped" not in said and "Cannot find" not in said


def test_figures_of_results_are_drawn_one_by_one(tmp_path: Path) -> None:
    recording = glambda.recording_from(glambda.record("fig4", until=0.05).qps, "mine")
    results = tmp_path / "results"
    glambda.replay(recording, ["lotstedt", "daqp"], ["high"], results=results, isolate=False)
    for draw in (glambda.plot_accuracy, glambda.plot_cost, glambda.plot_profiles,
                 glambda.plot_outside):  # fmt: skip
        picture = draw(results, tmp_path / "figure.svg")
        assert picture.kind == "svg" and "<svg" in (picture._repr_svg_() or "")
        assert picture._repr_png_() is None and (tmp_path / "figure.svg").is_file()
        with pytest.raises(ValueError):
            draw(results, setting="paper")
    moving = glambda.plot_motion(glambda.simulate("fig4", until=0.05))
    assert (moving._repr_png_() or b"").startswith(b"\x89PNG")
    rows = glambda.load_results(results)
    assert rows["verified"].all() and {"charged", "runtime", "solver"} <= set(rows.columns)
    with pytest.raises(ValueError, match="is not a folder"):
        glambda.load_results(tmp_path / "nowhere")


def test_qps_of_one_s_own() -> None:
    qps = glambda.record("fig4", until=0.02).qps
    made = glambda.recording_from(qps, answers=[None] * len(qps))
    assert made.scene == "qps" and len(made.references) == len(qps)
    with pytest.raises(ValueError, match="there are no QPs"):
        glambda.recording_from([])
    with pytest.raises(ValueError, match=f"{len(qps)} QPs need as many answers; got 0"):
        glambda.recording_from(qps, answers=[])
    with pytest.raises(ValueError, match="an answer needs"):
        glambda.recording_from(qps, answers=[[0.0] * (qp.k + 1) for qp in qps])


def test_models_of_an_engine_are_named_too() -> None:
    pytest.importorskip("mujoco")
    assert glambda.record("mujoco:arm", until=0.05).scene == "mujoco_arm"
