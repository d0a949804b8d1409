"""Networks are recorded, read back and drawn like scenes of bodies."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import glambda
from glambda.cli import app
from harness.recordings.recording import read_recording
from problems import scene
from problems.scenes.registry import scene_kinds
from reports.motions.frames import animate_scene, plot_scene
from reports.motions.network import trace_of


def test_a_network_is_recorded_and_says_what_its_run_said(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr("reports.motions.network.PICTURES", 10)
    label = "half_wave,end_time=0.015"
    done = CliRunner().invoke(app, ["record", label, "-o", str(tmp_path)])
    assert done.exit_code == 0, done.output
    recording = read_recording(tmp_path / f"{label}.h5")
    assert recording.polygons == () and recording.q.shape[1:] == (0, 3)
    assert all(reference is not None for reference in recording.references)
    run = glambda.simulate(scene("half_wave", end_time=0.015))
    kept, seen = trace_of(recording), trace_of(run)
    np.testing.assert_allclose(kept.currents, seen.currents, atol=1e-9)
    np.testing.assert_allclose(kept.diodes["load"], seen.diodes["load"], atol=1e-7)
    assert plot_scene(recording, tmp_path / "a.png").stat().st_size > 5000
    assert animate_scene(run, tmp_path / "a.gif", fps=10).stat().st_size > 5000


def test_the_command_tells_currents_and_voltages_at_the_end():
    done = CliRunner().invoke(app, ["simulate", "bridge", "--until", "0.003"])
    assert done.exit_code == 0, done.output
    assert "D4" in done.output and "current [A]" in done.output


def test_a_recording_without_bodies_that_is_no_known_network_is_not_drawn():
    from dataclasses import replace

    recording = glambda.record(scene("half_wave", end_time=0.001))
    with pytest.raises(ValueError, match="nothing to draw"):
        trace_of(replace(recording, scene="elsewhere"))


def test_scenes_are_listed_by_kind():
    assert scene_kinds()["networks"] == ["half_wave", "bridge", "boost"]
    listed = CliRunner().invoke(app, ["scenes"]).output
    assert "Scenes: networks" in listed and "half_wave" in listed
