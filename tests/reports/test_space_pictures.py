"""Scenes in space are listed, recorded, replayed and drawn like those of the plane."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from typer.testing import CliRunner

import glambda
from glambda.cli import app
from harness.recordings.recording import read_recording
from problems import scene
from reports.motions.frames import animate_scene, plot_scene
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
        run = glambda.simulate(scene(name), until=0.05)
        assert plot_scene(run, tmp_path / f"{name}.svg", frames=2).stat().st_size > 3000
        assert animate_scene(run, tmp_path / f"{name}.gif", fps=10, speed=0.1).stat().st_size > 3000


def test_the_eye_sees_without_distortion():
    np.testing.assert_allclose(eye() @ eye().T, np.eye(3), atol=1e-15)
    assert eye()[1, 2] > 0  # up is up
