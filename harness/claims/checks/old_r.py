"""The old R and its criterion (§3.2): the printed rule, its premise, and what it rests on."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from math import nan

import numpy as np
import pandas as pd

from harness.claims.checking import check
from harness.claims.checks.bead import slope
from harness.claims.checks.motions import run_of
from harness.criterion.cost_model import fit_growth
from harness.criterion.enumeration_growth import fit_base, randomly
from harness.criterion.estimates import norms
from harness.criterion.factor_rules import Link, drive, fixed, paper, sequence
from harness.recordings.recording import Recording
from harness.study.record import recording_of
from problems import scene, simulate
from solvers import make_solver


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
def guesses(column: str) -> float:
    """By what the "sets" of an enumeration, or "directions", grow with each row of random QPs."""
    return fit_base(randomly(range(2, 13)), column).base
