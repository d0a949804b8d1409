"""The old R and its criterion (§3.2): the printed rule, its premise, and what it rests on."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from math import nan

import numpy as np
import pandas as pd

from harness.claims.checking import check
from harness.claims.checks.bead import slope
from harness.claims.checks.motions import evenly, run_of
from harness.criterion.cost_model import fit_growth
from harness.criterion.estimates import ages, norms, unit_columns
from harness.criterion.estimates import factor as factor_of
from harness.criterion.factor_rules import (
    Link,
    Rule,
    drive,
    exact,
    fixed,
    paper,
    paper_deferred,
    sequence,
)
from harness.recordings.recording import Recording
from harness.study.record import recording_of
from problems import scene, simulate
from problems.qp import FREE
from solvers import make_solver

INTERVALS = (1, 2, 3, 5, 8, 12, 18, 25, 40)
CASES, DRAWN = 60, 4
"""QPs of a recording, and random vectors for each."""


@cache
def _recording(label: str) -> Recording:
    return recording_of(run_of(label, 1.5), "glambda")


def _links(label: str) -> list[Link]:
    return sequence(_recording(label))


@check
def beyond_limit(label: str, limit: float = nan) -> float:
    """Most iterations with an old R, less √(2 C_QR/C_IT), of QPs with one direction.

    limit : another one by which to factorize; NaN is the printed rule
    """
    rule = paper() if limit != limit else replace(paper(), options={"cg_limit": limit})
    steps = drive(_links(label), rule)
    kept = steps[(steps["qr_factorizations"] == 0) & steps["warm"] & (steps["f"] > 0)]
    kept = kept[(kept["descent_directions"] == 1) & (kept["working_set_changes"] == 0)]
    return float((kept["cg_iterations"] - np.sqrt(2 * kept["C_QR"] / kept["C_IT"])).max())


@check
def cost_over_best(label: str, rule: str) -> float:
    """Flops of a rule over those of the fixed interval that is best, known from `INTERVALS`.

    rule : the printed one in the "middle" of a QP or at its "end", "exact" without conjugate
        gradients, or "best" itself
    """
    links = _links(label)
    rules: dict[str, Rule] = {"middle": paper(), "end": paper_deferred(), "exact": exact()}
    best = min(_flops(links, fixed(interval)) for interval in INTERVALS)
    return 1.0 if rule == "best" else _flops(links, rules[rule]) / best


def _flops(links: list[Link], rule: Rule) -> float:
    return float(drive(links, rule)["flops"].sum())


@check
def exponent(label: str, of: str = "cg_iterations") -> float:
    """r in c s^r, fitted to iterations per QP at ages s of R.

    of : "cg_iterations", or "age": what a method with s iterations would count
    """
    links, frames = _links(label), []
    for interval in (3, 8, 18, 40):
        steps = drive(links, fixed(interval))
        frames.append(steps[steps["warm"] & (steps["f"] > 0) & (steps["age"] > 0)])
    every = pd.concat(frames)
    growth = fit_growth(every["age"], every[of], every["chain"])
    return nan if growth is None else growth.r


@check
def cline(label: str, factor: float = 1.0) -> float:
    """Least estimate of ‖R⁻¹‖ over the true one; factor : by which estimates are made larger."""
    found = norms(_recording(label))
    return float((factor * found["estimate"] / found["inverse"]).min())


@check
def karasalo(label: str, factor: float = 1.0) -> float:
    """Largest bound on σ_min of R over the true one; factor : by which bounds are made larger."""
    found = norms(_recording(label))
    return float((factor * found["bound"] * found["inverse"]).max())


@check
def scaling(of: str) -> float:
    """Order in h of ‖G_nᵀc_n‖ ("Gc") or ‖λ_n‖ ("lambda"), on fig2 at t = 0.1."""
    lengths, sizes = 0.02 / 2.0 ** np.arange(5), []
    for h in lengths:
        run = simulate(scene("fig2"), make_solver("glambda"), fixed_step=float(h), until=0.1)
        qp, x = run.qps[-1], run.solutions[-1].x
        vector = qp.h * (qp.A.T @ qp.d) if of == "Gc" else np.asarray(x)
        sizes.append(float(np.linalg.norm(vector)))
    return slope(lengths, np.array(sizes))


@check
def error_bound(label: str, factor: float = 1.0) -> float:
    """Largest ‖A_F δp‖ over ‖R⁻¹‖ ‖v‖, v = A_FᵀA_F δp and R that of A_F; factor : of ‖R⁻¹‖.

    δp are drawn, and the one for which (3.20) is sharp.
    """
    recording, rng, most = _recording(label), np.random.default_rng(0), 0.0
    solved = list(zip(recording.qps, recording.solutions, strict=True))
    for qp, solution in evenly(solved, CASES):
        free = np.flatnonzero(solution.working_set == FREE)
        if not free.size:
            continue
        B = unit_columns(qp, free)
        inverse = factor * factor_of(B).inverse_norm
        drawn = rng.standard_normal((DRAWN, free.size))
        for p in (*drawn, np.linalg.svd(B)[2][-1]):
            moved = B @ p
            bound = inverse * np.linalg.norm(B.T @ moved)
            most = max(most, float(np.linalg.norm(moved) / bound))
    return most


@check
def inverse_grown(label: str, age: int) -> float:
    """Largest ‖R⁻¹‖ of today's A_F over that of the R of so many steps ago."""
    found = ages(_recording(label))
    found = found[found["age"] == age]
    return float((found["today"] / found["then"]).max())
