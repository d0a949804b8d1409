"""The command line: what it prints, what it writes, and its exit codes."""

from __future__ import annotations

import importlib
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pandas as pd
import pytest
import typer
from typer.testing import CliRunner

from glambda.cli import app, simulation
from glambda.cli.app import chosen_solvers, told
from harness.processes.introduction import form_variants
from harness.recordings.recording import read_recording, write_recording
from harness.results.store import read_results
from harness.study import expected_misses, study, verify
from harness.study.expected_misses import Expected
from reports.sections import protocol
from solvers import make_solver, registry
from tests.fakes.crooked import CROOKED
from tests.fakes.fake_recordings import fake_recording

ROOT = Path(__file__).parents[2]
KEPT = "; what was finished is kept"
CONTINUES = f"{KEPT}: the same command continues"
FAST = "glambda,scipy_bvls"
runner = CliRunner()


def glambda(*arguments: object) -> Any:
    return runner.invoke(app, [str(a) for a in arguments])


@pytest.fixture(scope="module")
def fig3(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A short recording of a real scene."""
    folder = tmp_path_factory.mktemp("recorded")
    result = glambda("record", "fig3", "--until", 1, "-o", folder)
    assert result.exit_code == 0, result.output
    return folder / "fig3.h5"


def assert_told(result: Any, *words: str) -> None:
    """Exit code 2, nothing on stdout, and one line on stderr that has the words."""
    assert result.exit_code == 2, result.output
    assert result.stdout == ""
    lines = result.stderr.strip().splitlines()
    assert len(lines) == 1, result.stderr
    for word in words:
        assert word in lines[0]


def test_help_loads_nothing_heavy() -> None:
    heavy = ("numpy", "scipy", "pandas", "h5py", "matplotlib", "numba")
    code = (
        "import sys\nfrom glambda.cli import main\n"
        "try:\n    main()\nexcept SystemExit:\n    pass\n"
        f"print('loaded:', [name for name in {heavy} if name in sys.modules])"
    )
    command = [sys.executable, "-c", code, "--help"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
    assert "simulate" in done.stdout and "study" in done.stdout
    assert "loaded: []" in done.stdout


@pytest.mark.parametrize("command", sorted(typer.main.get_command(app).commands))
def test_every_command_explains_itself(command: str) -> None:
    result = glambda(command, "--help")
    assert result.exit_code == 0 and "Usage" in result.stdout


def test_scenes_and_solvers() -> None:
    listed = glambda("scenes").stdout
    assert all(name in listed for name in study.PAPER_SCENES) and "mu_I=" in listed
    listed = glambda("solvers").stdout
    assert "glambda*" in listed and "working set" in listed


def test_a_report_knows_how_a_scene_may_be_run() -> None:
    assert tuple(simulation.RUN_OPTIONS) == protocol.RUN_OPTIONS


def test_absent_solvers_are_listed_with_their_reason(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(
        registry, "_targets", lambda: {"glambda": registry.BUILT_IN["glambda"], "gone": "no_a:B"}
    )
    assert "absent: gone (No module named 'no_a')" in glambda("solvers").stdout


def test_record_twice_gives_the_same_bytes(fig3: Path, tmp_path: Path) -> None:
    assert glambda("record", "fig3", "--until", 1, "-o", tmp_path).exit_code == 0
    assert (tmp_path / "fig3.h5").read_bytes() == fig3.read_bytes()
    made = read_recording(fig3)
    assert made.parameters["run.until"] == 1.0 and made.parameters["stiffness"] == 6.0
    assert all(reference is not None for reference in made.references)
    assert made.counts["qps"] == len(made.qps)


def test_info(fig3: Path) -> None:
    result = glambda("info", fig3)
    assert result.exit_code == 0
    for word in ("fig3", read_recording(fig3).digest, "references", "√(2 C_QR/C_IT)"):
        assert word in result.stdout


def test_simulate_writes_its_files(tmp_path: Path) -> None:
    out = tmp_path / "deep" / "motion.csv"
    result = glambda("simulate", "fig3", "--until", 0.8, "--trajectory", out, "--solver", "daqp")
    assert result.exit_code == 0, result.output
    motion, events = pd.read_csv(out), pd.read_csv(out.with_suffix(".events.csv"))
    assert list(motion) == ["t", "body", "x", "y", "phi", "vx", "vy", "omega"]
    assert set(motion["body"]) == {1} and motion["t"].max() == pytest.approx(0.8)
    assert list(events) == ["t", "kind", "detail"] and "impulse" in set(events["kind"])


@pytest.mark.parametrize(
    "command",
    [
        *("record fig3", "growth tower", "closed-loop fig3", "convergence fig3", "stability"),
        *("painleve", "peers", "study", "report {results}", "criterion {fig3}", "stretch {fig3}"),
        "disturb {fig3}",
        *("replay {fig3}", "verify {fig3}"),
    ],
)
def test_an_output_that_is_no_folder_is_refused_before_the_work(
    command: str, fig3: Path, tmp_path: Path
) -> None:
    taken = tmp_path / "taken"
    taken.write_text("a file")
    words = command.format(fig3=fig3, results=tmp_path).split()
    assert_told(glambda(*words, "-o" if words[0] != "study" else "--results", taken / "deep"))
    assert taken.read_text() == "a file"


class Tired:
    """The paper's method, which ends after t = 0.5 s: it gives up, or somebody presses Ctrl-C."""

    def __init__(self, end: BaseException):
        self.end, self.inner = end, make_solver("glambda")

    def solve(self, qp: Any, start: Any = None) -> Any:
        if qp.t > 0.5:
            raise self.end
        return self.inner.solve(qp, start)


@pytest.mark.parametrize("command", ["simulate", "record", "check scene"])
@pytest.mark.parametrize(
    "large",
    [
        *("fig2,boxes=1000000000", "fig4,boxes=1e9", "tower,bodies=1000000000"),
        *("wall,bodies=1000000000", "wall,row=1000000000", "pyramid,bodies=1000000000"),
        *("heap,bodies=1000000000", "heap,corners=1000000000", "rain,bodies=1000000000"),
    ],
)
def test_a_scene_too_large_is_refused_before_it_is_made(command: str, large: str) -> None:
    name, _, parameter = large.partition(",")
    words = (f"scene {name!r}: {parameter.split('=')[0]} = 1000000000", "at most")
    assert_told(glambda(*command.split(), large), *words)


@pytest.mark.parametrize(
    ("end", "code", "words"),
    [
        (ArithmeticError("no more"), 1, "ArithmeticError: no more"),
        (KeyboardInterrupt(), 130, "interrupted"),
    ],
)
def test_a_run_that_ends_early_writes_what_it_has(
    end: BaseException, code: int, words: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("solvers.make_solver", lambda name: Tired(end))
    table, picture = tmp_path / "motion.csv", tmp_path / "motion.png"
    result = glambda("simulate", "fig3", "--trajectory", table, "--plot", picture)
    assert result.exit_code == code, result.output
    *_, line = result.stderr.strip().splitlines()
    assert words in line and f"the motion until then is in {table}" in line
    assert 0.4 < pd.read_csv(table)["t"].max() <= 0.5
    assert list(pd.read_csv(table.with_suffix(".events.csv"))) == ["t", "kind", "detail"]
    assert picture.read_bytes().startswith(b"\x89PNG")
    result = glambda("simulate", "fig3")
    assert result.exit_code == code and "is kept by --trajectory" in result.stderr


@pytest.mark.parametrize(("scene", "column"), [("bowl", "x"), ("half_wave,end_time=0.6", "i load")])
def test_what_is_no_scene_of_the_plane_keeps_its_motion_too(
    scene: str, column: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("solvers.make_solver", lambda name: Tired(ArithmeticError("no more")))
    table = tmp_path / "motion.csv"
    result = glambda("simulate", scene, "--trajectory", table)
    assert result.exit_code == 1 and f"the motion until then is in {table}" in result.stderr
    motion = pd.read_csv(table)
    assert 0.4 < motion["t"].max() <= 0.5 and column in motion


def test_simulate_draws(tmp_path: Path) -> None:
    picture = tmp_path / "fig3.png"
    result = glambda("simulate", "fig3", "--until", 0.3, "--plot", picture)
    assert result.exit_code == 0, result.output
    assert picture.read_bytes().startswith(b"\x89PNG")


def test_simulate_takes_parameters_and_a_fixed_step() -> None:
    result = glambda(*("simulate", "fig3", "--set", "mu=0.1", "--until", 0.1, "--fixed-step", 0.01))
    assert result.exit_code == 0 and "fig3,mu=0.1: t = 0.1 s" in result.stdout


def test_the_friction_rule_is_selectable(tmp_path: Path) -> None:
    command = ("record", "fig5", "--until", 0.1, "-o", tmp_path)
    assert glambda(*command).exit_code == 0
    assert glambda(*command, "--friction", "paper").exit_code == 0
    printed = read_recording(tmp_path / "fig5,friction=paper.h5")
    assert printed.parameters["run.friction"] == "paper"
    assert printed.digest != read_recording(tmp_path / "fig5.h5").digest
    assert glambda(*command, "--friction", "wet").exit_code == 2


def test_replay_stores_and_continues(fig3: Path, tmp_path: Path) -> None:
    command = ("replay", fig3, "--solvers", FAST, "--settings", "high", "-o", tmp_path)
    first = glambda(*command, "--repeats", 1)
    assert first.exit_code == 0, first.output
    rows = read_results(tmp_path)
    assert set(rows["solver"]) == set(FAST.split(","))
    assert (rows["verdict"] == "verified").all()
    assert (tmp_path / "recordings" / "fig3.h5").exists()
    shards = {p: p.stat().st_mtime_ns for p in (tmp_path / "solves").iterdir()}
    assert glambda(*command, "--repeats", 1).exit_code == 0
    assert shards == {p: p.stat().st_mtime_ns for p in (tmp_path / "solves").iterdir()}
    assert "glambda" in glambda("info", tmp_path).stdout


def test_replay_of_one_row(fig3: Path) -> None:
    result = glambda(
        *("replay", fig3, "--solvers", "glambda", "--settings", "high", "--arms", "warm"),
        *("--qp", 4),
    )
    assert result.exit_code == 0, result.output
    assert "fig3/000004" in result.stdout and "verified" in result.stdout
    assert_told(glambda("replay", fig3, "--solvers", "glambda", "--qp", 10_000), "QPs 0 to")


def test_solvers_by_group_and_without_some() -> None:
    every, fewer = chosen_solvers("all"), chosen_solvers("all,-enumeration")
    assert set(every) - set(fewer) == {"enumeration"} and set(fewer) < set(every)
    assert set(chosen_solvers("forms,glambda")) == {*form_variants(), "glambda"}


def test_replay_refuses_to_mix(fig3: Path, tmp_path: Path) -> None:
    options = ("--solvers", "scipy_bvls", "--settings", "high", "--repeats", 1, "-o", tmp_path)
    assert glambda("replay", fig3, *options).exit_code == 0
    other = tmp_path / "other" / "fig3.h5"
    write_recording(other, replace(read_recording(fig3), eps=5e-3))
    assert_told(glambda("replay", other, *options), "recording_digest", "may not be mixed")


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("simulate", "fig9"), ("unknown scene 'fig9'", "fig2")),
        (("simulate", "fig3", "--set", "mass=1"), ("no parameter 'mass'", "stiffness")),
        (("simulate", "fig3", "--set", "mu"), ("'mu' is no setting", "name=value")),
        (("simulate", "fig3", "--solver", "magic"), ("unknown solver 'magic'", "daqp")),
        (("simulate", "fig3", "--set", "end_time=0"), ("end_time = 0.0", "positive")),
        (("simulate", "fig3,mu=1,mu=2"), ("mu is given twice, 1 and 2",)),
        (("check", "recording", "absent.h5"), ("absent.h5", "name another file")),
        (("check", "recording", "."), (".: Is a directory", "name another file")),
        (("simulate", "fig3", "--until", "-1"), ("until",)),
        (("simulate", "fig3", "--plot", "x.doc"), ("--plot x.doc", ".png")),
        (("simulate", "fig3", "--plot", "folder.png"), ("--plot folder.png", "cannot be written")),
        (("record", "fig9"), ("unknown scene 'fig9'",)),
        (("record", "fig3", "--until", "0.01", "-o", "file"), ("file: ", "name another")),
        (("replay", "absent.h5"), ("absent.h5", "no such file", "glambda record")),
        (("info", "absent.h5"), ("absent.h5", "no such file")),
        (("report", "absent"), ("absent",)),
        (("verify", "absent.h5"), ("absent.h5", "no such file")),
        (("study", "--scenes", "fig9", "--solvers", "glambda"), ("unknown scene 'fig9'",)),
        (("study", "--solvers", "daqp,-daqp"), ("--solvers daqp,-daqp", "nothing is left")),
        (("study", "--solvers", "all,-magic"), ("unknown solver 'magic'",)),
    ],
)
def test_bad_input_is_told_in_one_line(
    arguments: tuple[str, ...],
    words: tuple[str, ...],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "folder.png").mkdir()
    (tmp_path / "file").touch()
    assert_told(glambda(*arguments), *words)


def test_record_takes_a_fixed_step(tmp_path: Path) -> None:
    done = glambda(
        *("record", "tower,bodies=3", "--fixed-step", 0.005, "--stops", "held"),
        *("--until", 0.02, "-o", tmp_path),
    )
    assert done.exit_code == 0, done.output
    recording = read_recording(next(tmp_path.glob("*.h5")))
    assert recording.parameters["run.fixed_step"] == 0.005
    assert recording.parameters["run.stops"] == "held"
    assert {qp.h for qp in recording.qps if qp.kind == "step"} == {0.005}


def test_bad_recordings_are_told_in_one_line(tmp_path: Path) -> None:
    path = tmp_path / "fake.h5"
    write_recording(path, fake_recording())
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2])
    assert_told(glambda("info", path), "fake.h5", "glambda record")
    path.write_text("foreign")
    assert_told(glambda("verify", path, "--solvers", "glambda"), "foreign")
    path.write_bytes(whole)
    path.write_bytes(whole.replace(b"recording 3", b"recording 2", 1))
    assert_told(glambda("replay", path, "--solvers", "glambda"), "version: is '2'")
    path.write_bytes(whole)
    with h5py.File(path, "r+") as raw:
        raw["qps/d"][0] = float("nan")
    assert_told(glambda("info", path), "seal")


def test_another_recording_is_not_replaced_unless_told_so(tmp_path: Path) -> None:
    record = ("record", "tower,bodies=3", "-o", tmp_path)
    path = tmp_path / "tower,bodies=3.h5"
    assert glambda(*record, "--until", 0.05).exit_code == 0
    whole = path.read_bytes()
    assert_told(glambda(*record, "--until", 0.06), "run.until 0.05, now 0.06; give --overwrite")
    assert_told(glambda(*record), "run.until 0.05, now")
    write_recording(path, replace(read_recording(path), gravity=1.0))  # by other code
    assert_told(glambda(*record, "--until", 0.05), "with digest")
    assert glambda(*record, "--until", 0.05, "--overwrite").exit_code == 0
    assert path.read_bytes() == whole
    path.write_bytes(whole[:1000])  # damaged, so that the remedy is to record it again
    assert glambda(*record, "--until", 0.05).exit_code == 0
    assert path.read_bytes() == whole


def test_a_debug_flag_shows_the_traceback(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("GLAMBDA_DEBUG", "1")
    assert isinstance(glambda("simulate", "fig9").exception, ValueError)


@pytest.mark.parametrize(("command", "continues"), [("record", False), ("study", True)])
def test_ctrl_c_promises_what_is_true(
    command: str, continues: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupt(*_: Any, **__: Any) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(importlib.import_module("harness.study.record"), "simulate", interrupt)
    monkeypatch.chdir(tmp_path)
    result = glambda(command, *(() if command == "record" else ("--quick",)))
    assert result.exit_code == 130
    assert "what was finished is kept" in result.stderr
    assert ("the same command continues" in result.stderr) == continues


@pytest.mark.parametrize(
    ("name", "options", "promise"),
    [
        ("replay", {"output": Path("results")}, CONTINUES),
        ("verify", {"output": Path("results")}, CONTINUES),
        ("verify", {"output": None}, ""),
        ("cases", {"output": Path("cases")}, CONTINUES),
        ("stretch", {"output": Path("recordings")}, KEPT),
        ("disturb", {"output": Path("recordings")}, KEPT),
        ("simulate", {}, ""),
    ],
)
def test_every_command_promises_what_is_true(
    name: str, options: dict[str, object], promise: str, capsys: pytest.CaptureFixture[str]
) -> None:
    def command(**options: object) -> None:
        raise KeyboardInterrupt

    command.__name__ = name
    with pytest.raises(typer.Exit):
        told(command)(**options)
    assert capsys.readouterr().err == f"\ninterrupted{promise}\n"


def test_an_absent_solver_is_bad_input(fig3: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(registry, "_targets", lambda: {"gone": "no_such_module:Solver"})
    assert_told(glambda("replay", fig3, "--solvers", "gone"), "no_such_module")


def test_verify_passes_and_fails(fig3: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    good = glambda("verify", fig3, "--solvers", FAST)
    assert good.exit_code == 0, good.output
    assert "0 missed" in good.stdout and "the same Gλ" in good.stdout
    monkeypatch.setattr(registry, "_REGISTERED", {"glambda": CROOKED["liar"]})
    bad = glambda("verify", fig3, "--solvers", "glambda")
    assert bad.exit_code == 1
    assert "FAILED" in bad.stdout and "glambda" in bad.stdout


@pytest.fixture(scope="module")
def right_rows(fig3: Path) -> pd.DataFrame:
    """Rows that are all verified, as of a backend that is expected to miss some."""
    from harness.study.replay import replay as replay_all

    rows = replay_all([fig3], ["glambda"], ["high"], repeats=1)
    return rows.assign(solver="osqp", kind="step")


def holds(rows: pd.DataFrame, missed: Sequence[int], **fields: object) -> bool:
    """Whether these misses, of the given kind, error or verdict, are among the expected ones."""
    rows = rows.copy()
    error = {"verdict": "inaccurate", "glambda_error": 1e-7}
    for name, value in {**error, **fields}.items():
        rows.loc[rows.index[list(missed)], name] = value
    return bool(verify.misses(rows)["holds"].all())


def test_expected_misses_are_a_range(
    right_rows: pd.DataFrame, monkeypatch: pytest.MonkeyPatch
) -> None:
    share = 2 / len(right_rows)
    expected = Expected(("step",), share, 1e-6, False, "because")
    monkeypatch.setattr(expected_misses, "EXPECTED", {"osqp": expected})
    assert holds(right_rows, []) and holds(right_rows, [3]) and holds(right_rows, [3, 5])
    assert not holds(right_rows, [3, 5, 7])
    assert not holds(right_rows, [3], glambda_error=2e-6)
    assert holds(right_rows, [3], glambda_error=2e-6, status="ITERATION_LIMIT")
    assert not holds(right_rows, [3], kind="impulse")
    assert not holds(right_rows, [3], verdict="claimed_wrong")
    assert holds(right_rows, [3], verdict="failed", glambda_error=np.nan)


def test_on_other_scenes_only_the_accurate_class_is_held_to_anything(
    right_rows: pd.DataFrame,
) -> None:
    mine = right_rows.assign(scene="mine")
    assert holds(mine, range(9), verdict="claimed_wrong")
    for accurate in ("daqp", "lotstedt[exact_qr]"):
        assert not holds(mine.assign(solver=accurate), [3])


def test_study_end_to_end_and_resumed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(study, "QUICK", replace(study.QUICK, until=0.3, solvers=("glambda",)))
    folder = tmp_path / "out"
    command = ("study", "--quick", "--scenes", "fig3 fig5,mu_I=0.5", "--results", folder)
    first = glambda(*command)
    assert first.exit_code == 0, first.output
    rows = read_results(folder)
    assert set(rows["scene"]) == {"fig3", "fig5,mu_I=0.5"}
    assert (rows["verdict"] == "verified").all()
    assert (folder / "report" / "index.html").exists()
    told = json.loads((folder / "study.json").read_text())
    assert told["arguments"]["until"] == 0.3 and told["machine"]["cpu"]
    assert set(rows["study"]) == {told["study"]}
    text = json.dumps(told)
    import socket

    assert str(ROOT) not in text and str(Path.home()) not in text
    assert f'"{socket.gethostname()}"' not in text
    before = {p: p.stat().st_mtime_ns for p in folder.rglob("*.parquet")}
    assert glambda(*command).exit_code == 0
    assert before == {p: p.stat().st_mtime_ns for p in folder.rglob("*.parquet")}


def test_one_miss_in_thousands_does_not_round_to_all() -> None:
    from glambda.display.rows import share

    assert share(2642, 2643) == "99.9%" and share(1, 2643) == "0.1%"
    assert share(2643, 2643) == "100%" and share(0, 7) == "0%" and share(0, 0) == "–"


@pytest.mark.parametrize(
    ("scenes", "words"), [("", "the study has no scenes"), ("fig3 fig9", "unknown scene 'fig9'")]
)
def test_a_study_that_cannot_be_writes_nothing(tmp_path: Path, scenes: str, words: str) -> None:
    folder = tmp_path / "results"
    assert_told(glambda("study", "--scenes", scenes, "--results", folder), words)
    assert not folder.exists()


def test_study_will_not_mix_two_recordings_of_a_scene(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    quick = replace(study.QUICK, scenes=("fig5",), until=0.2, solvers=("glambda",))
    monkeypatch.setattr(study, "QUICK", quick)
    assert glambda("study", "--quick", "--results", tmp_path).exit_code == 0
    monkeypatch.setattr(study, "QUICK", replace(quick, until=0.25))
    assert_told(glambda("study", "--quick", "--results", tmp_path), "another recording")


@pytest.mark.parametrize("sent", [signal.SIGINT, signal.SIGTERM])
def test_interrupted_study_keeps_what_is_finished(tmp_path: Path, sent: signal.Signals) -> None:
    """Ctrl-C, as a terminal sends it, or the end of a batch job, in the middle of a study."""
    code = (
        "import sys, dataclasses, harness.study.study as s\n"
        "s.QUICK = dataclasses.replace(s.QUICK, scenes=('fig3',), until=1.0, repeats=400)\n"
        "sys.argv = ['glambda', 'study', '--quick', '--solvers', 'scipy_bvls,glambda',\n"
        f"            '--results', {str(tmp_path)!r}]\n"
        "from glambda.cli import main\nmain()\n"
    )
    run = subprocess.Popen(
        [sys.executable, "-c", code],
        cwd=ROOT,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, "OMP_NUM_THREADS": "1"},
    )
    try:
        deadline = time.monotonic() + 120
        while len(list((tmp_path / "solves").glob("*.parquet"))) < 2:
            assert run.poll() is None, run.communicate()
            assert time.monotonic() < deadline
            time.sleep(0.05)
        run.send_signal(sent)
        _, errors = run.communicate(timeout=60)
    finally:
        run.kill()
    assert run.returncode == 130
    assert "the same command continues" in errors and "Traceback" not in errors
    rows = read_results(tmp_path)
    assert len(rows) and (rows["verdict"] == "verified").all()
    assert rows["repeats"].min() >= 1
