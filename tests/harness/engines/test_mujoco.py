"""MuJoCo's QPs: its own forces are their answers, and rows keep their numbers."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from glambda.cli import app
from harness.judging.facts import facts_of
from harness.judging.judge import judge
from harness.judging.recorded_answers import kkt_residual, recorded_answers
from harness.recordings.recording import Recording, read_recording, write_recording
from tests.fakes.fake_recordings import fake_recording

pytest.importorskip("mujoco")

from harness.engines.mujoco import own_models, record_mujoco

BALL = """<mujoco><option timestep="0.01" {option}/><default><geom {geom}/></default>
<worldbody><geom type="plane" size="9 9 1"/>
<body pos="0 0 {height}"><freejoint/><geom type="sphere" size="0.1" mass="2"/></body>
</worldbody></mujoco>"""


def model(folder: Path, option: str = "", geom: str = "", height: float = 0.099) -> str:
    path = folder / "ball.xml"
    path.write_text(BALL.format(option=option, geom=geom, height=height))
    return str(path)


@pytest.fixture(scope="module")
def recorded() -> dict[str, Recording]:
    return {name: record_mujoco(name, 0.4) for name in own_models()}


def test_there_are_five_models() -> None:
    assert list(own_models()) == ["arm", "gripper", "pile", "tumbling", "walker"]


def test_its_own_forces_are_the_answers(recorded: dict[str, Recording]) -> None:
    for name, recording in recorded.items():
        found = recorded_answers(recording)
        assert found is not None and found.answers == len(recording.qps) > 20, name
        assert found.verdicts["verified"] > 0.8 * found.answers, name
        assert found.kkt_median < 1e-12, name


def test_other_forces_are_not(recorded: dict[str, Recording]) -> None:
    recording = recorded["tumbling"]
    qp, x = recording.qps[-1], recording.solutions[-1].x
    assert x is not None
    facts = facts_of(qp)
    assert kkt_residual(facts, x) < 1e-6
    for wrong in (1.001 * x, x - 1e-3 * x.max(), np.zeros(qp.k)):
        assert kkt_residual(facts, wrong) > 1e-5


def test_every_kind_of_row_has_its_bounds(recorded: dict[str, Recording]) -> None:
    qp = recorded["gripper"].qps[-1]
    free = np.isinf(qp.lower) & np.isinf(qp.upper)
    dry = np.isfinite(qp.lower) & np.isfinite(qp.upper)
    assert free.sum() == 1  # the equality
    assert dry.sum() == 2 and np.allclose(qp.upper[dry], 0.1) and np.allclose(qp.lower[dry], -0.1)
    assert ((qp.lower == 0) & np.isinf(qp.upper)).sum() == qp.k - 3


def test_a_contact_of_one_ball_by_hand(tmp_path: Path) -> None:
    """k = 1: (1/m + R) f = a_ref − a₀ with f > 0."""
    qp = record_mujoco(model(tmp_path, geom='condim="1"'), 0.01).qps[0]
    A, d = qp.dense_A[:, 0], qp.d
    assert np.isclose(A[:6] @ A[:6], 0.5) and A[6] > 0
    assert np.isclose(A[:6] @ d[:6], -9.81)
    assert qp.lower.tolist() == [0.0] and np.isinf(qp.upper[0])


def test_rows_keep_their_numbers(recorded: dict[str, Recording]) -> None:
    qps = recorded["gripper"].qps
    same = [np.array_equal(a.row_id, b.row_id) for a, b in pairwise(qps) if a.k == b.k]
    assert np.mean(same) > 0.9
    x = [s.x for s in recorded["gripper"].solutions]
    a, b = x[-2], x[-1]
    assert a is not None and b is not None and np.abs(a - b).max() < 0.05 * b.max()


def test_the_rigid_twin_lacks_rank_and_has_physics() -> None:
    soft, rigid = (record_mujoco("tumbling", 0.5, rigid=each) for each in (False, True))
    assert rigid.scene == "mujoco_tumbling,rigid"
    assert recorded_answers(rigid) is None
    for twin, other in zip(rigid.qps, soft.qps, strict=True):
        assert np.array_equal(twin.dense_A, other.dense_A[: twin.m])
    qp, known = rigid.qps[-1], rigid.references[-1]
    facts = facts_of(qp)
    assert facts.rank < qp.k and known is not None
    found = judge(qp, known.x, reference=known, facts=facts)
    assert found.approach < 1e-9 and found.verdict == "verified"
    soft_facts = facts_of(soft.qps[-1])
    assert soft_facts.rank == soft.qps[-1].k
    known = soft.references[-1]
    assert known is not None
    assert np.isnan(judge(soft.qps[-1], known.x, reference=known, facts=soft_facts).approach)


def test_a_recording_survives_its_file(recorded: dict[str, Recording], tmp_path: Path) -> None:
    for recording in recorded.values():
        write_recording(tmp_path / "one.h5", recording)
        again = read_recording(tmp_path / "one.h5")
        assert again.digest == recording.digest


@pytest.mark.parametrize(
    ("option", "geom", "height", "words"),
    [
        ('cone="elliptic"', "", 0.099, "elliptic"),
        ("", "", 5.0, "no constraint"),
        ('cone="oval"', "", 0.099, "cannot read"),
    ],
)
def test_models_that_pose_no_such_qps_are_refused(
    tmp_path: Path, option: str, geom: str, height: float, words: str
) -> None:
    with pytest.raises(ValueError, match=words):
        record_mujoco(model(tmp_path, option, geom, height), 0.1)


def test_elliptic_cones_without_friction_are_bounds(tmp_path: Path) -> None:
    made = record_mujoco(model(tmp_path, 'cone="elliptic"', 'condim="1"'), 0.05)
    assert made.qps[0].k == 1


def test_the_command(tmp_path: Path) -> None:
    words = ["record", "mujoco:arm,rigid=true", "mujoco:arm", "--until", "0.1", "-o", str(tmp_path)]
    told = CliRunner().invoke(app, words)
    assert told.exit_code == 0, told.output
    assert "KKT residual" in told.output
    assert {path.name for path in tmp_path.iterdir()} == {"mujoco_arm.h5", "mujoco_arm,rigid.h5"}
    other = CliRunner().invoke(app, [*words[:-3], "0.2", "-o", str(tmp_path)])
    assert other.exit_code == 2 and "--overwrite" in other.output
    for bad in (["mujoco:nobody"], ["mujoco:arm,wheels=3"], ["mujoco:arm", "--eps", "1"]):
        refused = CliRunner().invoke(app, ["record", *bad, "-o", str(tmp_path)])
        assert refused.exit_code == 2 and refused.output.count("\n") == 1, refused.output


def test_scenes_have_answers_too() -> None:
    found = recorded_answers(fake_recording())
    assert found is not None and found.answers > 5
