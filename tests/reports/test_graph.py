"""Figure 6 of a real instant: what it counts, and that it is drawn."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from glambda.cli import app
from harness.motions.instant import instant_of, possible_constraints
from problems import scene, simulate
from reports.motions.graph import plot_graph, roman
from solvers import make_solver


def test_the_graph_is_that_of_the_run():
    made = scene("fig4")
    seen = instant_of(made, 1.2, make_solver("glambda"))
    run = simulate(made, make_solver("glambda"), until=1.2, keep_qps=False)
    assert seen.t == pytest.approx(1.2)
    np.testing.assert_allclose(seen.q, run.q[-1], atol=1e-6)
    lam = list(run.multipliers[-1].values())
    np.testing.assert_allclose(sorted(c.lam for c in seen.constraints), sorted(lam), atol=1e-5)
    for number, (one, two) in enumerate(seen.contacts):
        kinds = [c.kind for c in seen.constraints if c.contact == number]
        assert one < two and kinds.count("F") == 1 and "N" in kinds


@pytest.mark.parametrize(("n", "k"), [(3, 4), (7, 4)])
def test_possible_constraints_are_the_paper_s(n: int, k: int):
    assert possible_constraints(scene("fig4", boxes=n)) == k * k * n * (n - 1) + k * n


def test_the_broad_phase_leaves_few_of_a_long_wall():
    seen = instant_of(scene("wall", bodies=40), 0.01, make_solver("glambda"))
    active = sum(each.kind == "N" for each in seen.constraints)
    assert active < seen.near < 0.3 * seen.possible


def test_a_picture_is_drawn_and_a_network_is_refused(tmp_path: Path):
    assert [roman(n) for n in (1, 4, 9, 14, 48)] == ["I", "IV", "IX", "XIV", "XXXXVIII"]
    seen = instant_of(scene("fig5"), 0.1, make_solver("glambda"))
    assert plot_graph(seen, tmp_path / "a.svg").stat().st_size > 5000
    path = tmp_path / "b.png"
    done = CliRunner().invoke(app, ["graph", "fig2", "--at", "0.1", "-o", str(path)])
    assert done.exit_code == 0 and path.stat().st_size > 5000
    refused = CliRunner().invoke(app, ["graph", "bridge", "--at", "0.1", "-o", str(path)])
    assert refused.exit_code == 2 and "network" in refused.output
    late = CliRunner().invoke(app, ["graph", "fig2", "--at", "-1", "-o", str(path)])
    assert late.exit_code == 2 and "positive time" in late.output
