"""What keys of `glambda watch` do, without a window."""

from __future__ import annotations

from pathlib import Path

import matplotlib as mpl
import numpy as np
import pytest
from matplotlib.backend_bases import KeyEvent
from matplotlib.figure import Figure
from typer.testing import CliRunner

from glambda.cli import app
from glambda.watch import KEYS, Watch, show
from problems import scene, simulate
from solvers import make_solver


def watch(name: str, folder: Path = Path(), **parameters: float) -> Watch:
    return Watch(scene(name, **parameters), make_solver("glambda"), folder)


def run_on(each: Watch, until: float) -> None:
    each.paused = False
    while each.system.t < until:
        each.tick()


def test_it_moves_as_the_simulation_does_once_it_is_not_paused() -> None:
    each = watch("fig4")
    each.tick()
    assert each.system.t == 0.0
    each.press(" ")
    run_on(each, 0.5)
    run = simulate(scene("fig4"), make_solver("glambda"), until=each.system.t, keep_qps=False)
    np.testing.assert_allclose(each.system.q.reshape(-1, 3), run.q[-1], atol=2e-3)


def test_step_speed_and_arrows() -> None:
    each = watch("fig4")
    each.press("right")
    assert 0.0 < each.system.t <= each.system.options.h_max and each.paused
    each.press("up")
    each.press("up")
    each.press("down")
    assert each.speed == 2.0
    each.press("a")
    assert not each.shows_arrows
    each.press("x")
    assert all(hasattr(each, name) for name in KEYS.values())


def test_the_last_qp_is_saved_and_can_be_imported(tmp_path: Path) -> None:
    each = watch("fig5", tmp_path)
    each.press("right")
    path = each.save()
    assert path is not None
    with np.load(path) as arrays:
        qp = each.system.qps.qps[-1]
        np.testing.assert_array_equal(arrays["A"], qp.dense_A)
        np.testing.assert_array_equal(arrays["b"], -qp.d)
    imported = CliRunner().invoke(app, ["import", str(path), "-o", str(tmp_path / "rec")])
    assert imported.exit_code == 0, imported.output


def test_a_constraint_that_is_dropped_is_found_again_where_it_bears() -> None:
    each = watch("braking", speed=0.0)
    before = set(each.system.graph.normals)
    each.press("tab")
    each.press("d")
    assert "dropped" in each.said and set(each.system.graph.normals) < before
    each.press("d")
    each.press("d")
    assert each.said == "no constraint is active"
    run_on(each, 0.1)
    assert len(each.system.graph.normals) == 2
    assert each.system.q[1] == pytest.approx(0.5, abs=2e-3)


def test_a_constraint_that_is_introduced_holds_a_corner_back() -> None:
    each = watch("dominoes")
    run_on(each, 0.3)
    assert abs(each.system.history.v[5]) < 1e-12  # the second stands
    each.press("i")
    assert "introduced: corner 2 of body 1" in each.said
    assert each.system.history.v[5] < -1e-3


def test_pictures_and_the_window(monkeypatch: pytest.MonkeyPatch) -> None:
    mpl.use("agg")
    each = watch("fig2")
    axes = Figure().add_subplot()
    each.draw(axes)
    assert "fig2" in axes.get_title() and len(axes.patches) > 5
    import matplotlib.pyplot as plt

    monkeypatch.setattr(plt, "show", lambda: None)
    each.press(" ")
    redraw = show(each)
    first = each.system.t
    redraw()
    assert each.system.t > first > 0.0
    figure = plt.gcf()
    KeyEvent("key_press_event", figure.canvas, " ")._process()
    assert each.paused
    plt.close(figure)
