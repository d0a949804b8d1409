"""QPs of many columns: what our method takes, and where a package is faster."""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from harness.claims.checking import check
from harness.claims.growth import STEP, sequence
from harness.judging.facts import ASKED_RELATIVE, facts_of
from harness.judging.judge import judge
from harness.names import METHOD
from harness.study.replay import replay
from problems import simulate
from problems.scenes.calm import calm_scene
from solvers import make_solver


@check
def columns_solved(bodies: int, error: float = 0.0) -> float:
    """Columns of a QP of a frictionless tower that our method solves as the judge demands, or 0.

    error : by which x is then made larger, relative
    """
    run = simulate(
        calm_scene("tower", bodies=bodies), make_solver(METHOD), until=STEP, fixed_step=STEP
    )
    qp = run.qps[-1]
    asked = ASKED_RELATIVE["high"] * facts_of(qp).scale
    x = (1.0 + error) * np.asarray(make_solver(METHOD, accuracy=asked).solve(qp).x)
    verdict = judge(qp, x, asked=asked).verdict
    return float(qp.k * (verdict == "verified"))


@check
def over_package(family: str, bodies: int, package: str) -> float:
    """Median time of our method over that of a package, warm, at `high`, interleaved."""
    with TemporaryDirectory() as folder:
        recording = sequence(Path(folder), family, bodies)
        rows = replay(recording, (METHOD, package), ("high",), ("warm",))
    times = rows.groupby("solver")["runtime"].median()
    return float(times[METHOD] / times[package])
