"""Scenes in space are listed, recorded, replayed and drawn like those of the plane."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import glambda
from glambda.cli import app
from harness.recordings.file import RecordingError
from harness.recordings.recording import Recording, read_recording
from problems import scene
from reports.motions.frames import animate_scene, plot_scene
from reports.motions.player import player_data, write_player
from reports.motions.space import eye


def test_a_scene_in_space_is_recorded_and_replayed(tmp_path: Path):
    done = CliRunner().invoke(app, ["record", "bowl", "--until", "0.02", "-o", str(tmp_path)])
    assert done.exit_code == 0, done.output
    recording = read_recording(tmp_path / "bowl.h5")
    assert recording.polygons == () and recording.q.shape[1:] == (0, 3)
    assert len(recording.qps) > 2 and all(each is not None for each in recording.references)
    command = ["replay", str(tmp_path / "bowl.h5"), "--solvers", "glambda,daqp", "--repeats", "1"]
    done = CliRunner().invoke(app, [*command, "-o", str(tmp_path / "results")])
    assert done.exit_code == 0, done.output
    assert done.output.count("100%") == 4


def test_the_command_tells_where_bodies_are_and_draws_them(tmp_path: Path):
    command = ["simulate", "heavy_top", "--until", "0.02", "--plot", str(tmp_path / "top.png")]
    done = CliRunner().invoke(app, command)
    assert done.exit_code == 0, done.output
    assert "wz" in done.output and (tmp_path / "top.png").stat().st_size > 5000
    listed = CliRunner().invoke(app, ["scenes"]).output
    assert "Scenes: space" in listed and "space_pyramid" in listed
    refused = CliRunner().invoke(
        app, ["graph", "bowl", "--at", "0.1", "-o", str(tmp_path / "a.png")]
    )
    assert refused.exit_code == 2 and "in space" in refused.output


def test_pictures_and_films_show_balls_boxes_and_slopes(tmp_path: Path):
    for name in ("bowl", "slope"):
        run = glambda.simulate(scene(name), until=0.02)
        assert plot_scene(run, tmp_path / f"{name}.svg", frames=2).stat().st_size > 3000
        assert animate_scene(run, tmp_path / f"{name}.gif", fps=10, speed=0.1).stat().st_size > 3000


@pytest.fixture(scope="module")
def tower() -> Recording:
    return glambda.record("space_tower", until=0.02)


def test_a_recording_keeps_the_motion_and_is_drawn_as_the_run_is(
    tower: Recording, tmp_path: Path
) -> None:
    path, run = tmp_path / "tower.h5", glambda.simulate("space_tower", until=0.02)
    glambda.write_recording(path, tower)
    read = read_recording(path)
    assert read.digest == tower.digest and read.space is not None
    np.testing.assert_array_equal(read.space.poses, run.poses)
    np.testing.assert_array_equal(read.space.reactions, run.reactions)
    assert read.space.bodies() == run.scene.solids and "10 bodies" in repr(read)
    drawn = [
        plot_scene(each, tmp_path / f"{i}.svg", frames=2) for i, each in enumerate((read, run))
    ]
    assert drawn[0].read_bytes() == drawn[1].read_bytes()


@pytest.mark.parametrize(
    ("name", "index", "value", "words"),
    [
        ("solids", (0, 0), -1.0, "be positive"),
        ("solids", (0, 1), 1e9, "no body has such moments"),
        ("poses", (0, 0, 3), 2.0, "not of unit length"),
        ("velocities", (0, 0, 0), np.nan, "holds nan"),
    ],
)
def test_what_no_body_does_is_refused(
    tower: Recording, tmp_path: Path, name: str, index: tuple[int, ...], value: float, words: str
) -> None:
    assert tower.space is not None
    changed = getattr(tower.space, name).copy()
    changed[index] = value
    path = tmp_path / "a.h5"
    glambda.write_recording(path, replace(tower, space=tower.space._replace(**{name: changed})))
    with pytest.raises(RecordingError, match=words):
        read_recording(path)
    with pytest.raises(ValueError, match="space/poses"):
        short = tower.space._replace(poses=tower.space.poses[1:])
        glambda.write_recording(path, replace(tower, space=short))


def test_the_player_shows_boxes_and_what_carries_them(tower: Recording, tmp_path: Path) -> None:
    data = player_data(tower)
    assert tower.space is not None
    steps = len(tower.t)
    assert len(data["space"]["solids"]) == 10 and len(data["q"][0]) == 70
    assert len(data["q"]) == len(data["forces"]) == len(data["qps"]) == steps
    weight = 9.81 * float(tower.space.solids[0, 0])
    np.testing.assert_allclose(np.array(data["forces"][-1])[:, 2], weight, rtol=1e-5)
    page = write_player(tower, tmp_path / "tower.html").read_text()
    assert "function drawSpace" in page and "look from elsewhere" in page
    unknown = replace(tower, scene="stranger's")  # no planes, but still bodies
    assert player_data(unknown)["space"]["lines"] == []


def test_the_eye_sees_without_distortion():
    np.testing.assert_allclose(eye() @ eye().T, np.eye(3), atol=1e-15)
    assert eye()[1, 2] > 0  # up is up
