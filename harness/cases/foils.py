"""What the paper sets itself against: Cundall's springs, and impulses by Newton and Coulomb.

Each way moves figure 4 or 5 to the time `UNTIL`; where the bodies are then is compared with the
paper's model.  The springs start from the velocities after the push, as all engines do.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from harness.peers.cundall import Cundall
from harness.peers.tasks import started
from harness.results.claim import Claim, Row, claim_over
from problems import Scene, scene, simulate
from problems.qp import Vector
from problems.scenes.labels import parse_label
from problems.sequence import SolvesQPs

SCENES = ("fig4", "fig4,mu_I=0.8", "fig5")
UNTIL = 3.0
"""End of the motions [s]: figures 4 and 5 are at rest then, fig4 with mu_I = 0.8 nearly."""
SPRING_STEPS = (1 / 960, 1 / 1920, 1 / 3840)
"""Steps of the springs [s], which are as stiff as each allows."""
IMPULSES = {"paper": "impulses of the paper", "newton_coulomb": "impulses by Newton and Coulomb"}


def foils_claim(solver: SolvesQPs) -> Claim:
    """Rows: way, steps, impulses, x of bodies 1 to 3, fastest, off the paper's by [m], [m/s]."""

    def rows(scene: str) -> list[Row]:
        return ways_of(scene, solver)

    return claim_over("foils", rows, scene=SCENES)


def ways_of(label: str, solver: SolvesQPs) -> list[Row]:
    """One row for each way to move a scene."""
    name, parameters = parse_label(label)
    made = scene(name, **parameters)
    found: list[Row] = []
    paper: Vector | None = None
    for rule, words in IMPULSES.items():
        run = simulate(made, solver, until=UNTIL, keep_qps=False, impulses=rule)
        paper = run.q[-1] if paper is None else paper
        counts = run.counts["steps"], run.counts["impulses"]
        found.append(_row(words, *counts, run.q[-1], run.v[-1], paper))
    start = started(label)
    assert isinstance(start, Scene)
    for h in SPRING_STEPS:
        moved = Cundall(start, h, damping=1.0).run([UNTIL])
        found.append(_row(f"springs, h = 1/{1 / h:.0f} s", moved.steps, 0, moved.q[-1],
                          moved.v[-1], paper))  # fmt: skip
    return found


def _row(way: str, steps: int, impulses: int, q: Vector, v: Vector, paper: Any) -> Row:
    return {
        "way": way,
        "steps": steps,
        "impulses": impulses,
        **{f"x{body}": float(x) for body, x in enumerate(q[:3, 0], start=1)},
        "fastest": float(np.abs(v).max()),
        "off": float(np.abs(q - paper).max()),
    }
