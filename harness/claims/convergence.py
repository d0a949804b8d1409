"""How the error of a motion falls with ε, and what that costs.

(3.5) chooses h so that the local error of q is ε h, an error per unit step: over a smooth stretch
the error of the motion is then proportional to ε.  To see whether it is, ε is swept with `drop_tol`
fixed and with both bounds of h; each run is compared with a reference
(`harness.claims.reference_motion`). The exponent p in error = C εᵖ is fitted to the logarithms of
all errors above rounding, and to those with ε ≤ `FINE`.
"""

from __future__ import annotations

from collections.abc import Iterable
from functools import cache
from math import sqrt
from typing import NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from harness.claims.reference_motion import (
    BOUNDS,
    STRETCHES,
    Case,
    Reference,
    cases_of,
    reference_of,
    run_case,
)
from harness.claims.stabilization import ROUNDS, TOLERANCES, compare_rules
from harness.results.claim import Claim, Row, claim_over
from problems.sequence import SolvesQPs

SWEEP = tuple(float(f"{10 ** (-k / 2):.2g}") for k in range(4, 13))
"""ε of the runs, two per decade."""
SCENES = (
    *("fig2", "fig3", "fig4", "fig5"),
    *("tower,bodies=5,lean=0.1,speed=0.01", "wall,bodies=6,speed=0.01,mu=0.3"),
)
FINE = 1e-4
"""Largest ε of the second fit."""
ROUNDING = 1e-11
"""Errors below this are not fitted [m, m/s]."""


def errors_of_run(
    case: Case, reference: Reference, solver: SolvesQPs, bound: str, eps: float
) -> list[Row]:
    """Errors of a run by one of the bounds of h, one row per stretch of time.

    Columns: steps, impulses, cpu [s], stretch, pose [m], velocity [m/s].
    """
    timed = [run_case(case, solver, eps, bound) for _ in range(ROUNDS)]
    run, cpu = timed[0][0], min(spent for _, spent in timed)
    pose, velocity = reference.errors(run)
    rows = []
    for stretch in STRETCHES:
        inside = reference.within(stretch)
        if inside.any():
            rows.append(
                {
                    "steps": run.counts["steps"],
                    "impulses": run.counts["impulses"],
                    "cpu": cpu,
                    "stretch": stretch,
                    "pose": float(pose[inside].max()),
                    "velocity": float(velocity[inside].max()),
                }
            )
    return rows


class Fit(NamedTuple):
    """error = C εᵖ, fitted: p and its standard error, and p between neighbours in ε."""

    p: float
    spread: float
    least: float
    largest: float
    points: int


NO_FIT = Fit(np.nan, np.nan, np.nan, np.nan, 0)


def fit(eps: ArrayLike, error: ArrayLike, floor: float = ROUNDING) -> Fit:
    """The exponent p over all errors above `floor`; `NO_FIT` for fewer than three."""
    eps, error = np.asarray(eps, float), np.asarray(error, float)
    kept = np.flatnonzero(error > floor)
    if kept.size < 3:
        return NO_FIT
    kept = kept[np.argsort(eps[kept])]
    x, y = np.log(eps[kept]), np.log(error[kept])
    (p, _), residual, *_ = np.polyfit(x, y, 1, full=True)
    scatter = float(residual.sum()) / (kept.size - 2)
    local = np.diff(y) / np.diff(x)
    return Fit(
        p=float(p),
        spread=sqrt(scatter / ((x - x.mean()) ** 2).sum()),
        least=float(local.min()),
        largest=float(local.max()),
        points=int(kept.size),
    )


def exponents(swept: pd.DataFrame) -> pd.DataFrame:
    """Fits by scene, bound and stretch.

    Columns: scene, bound, stretch; of the pose p, spread, least, largest, points, fine, the p for
    ε ≤ `FINE`, C, the geometric mean of error/ε; p of velocity and its spread.
    """
    rows = []
    for (label, bound, stretch), part in swept.groupby(["scene", "bound", "stretch"], sort=False):
        pose, velocity = (fit(part["eps"], part[name]) for name in ("pose", "velocity"))
        above, fine = part[part["pose"] > ROUNDING], part[part["eps"] <= FINE]
        rows.append(
            {
                "scene": label,
                "bound": bound,
                "stretch": stretch,
                **pose._asdict(),
                "fine": fit(fine["eps"], fine["pose"]).p,
                "C": float(np.exp(np.log(above["pose"] / above["eps"]).mean())),
                "p of velocity": velocity.p,
                "its spread": velocity.spread,
            }
        )
    return pd.DataFrame(rows)


def costs(swept: pd.DataFrame) -> pd.DataFrame:
    """What ε costs: steps and CPU time [s] by scene, bound and ε, one row each."""
    return swept.drop_duplicates(["scene", "bound", "eps"])[
        ["scene", "bound", "eps", "steps", "impulses", "cpu"]
    ].reset_index(drop=True)


class Converged(NamedTuple):
    """The campaign: the sweep of ε, and the rules of drift (`harness.claims.stabilization`)."""

    swept: pd.DataFrame
    drifted: pd.DataFrame


def convergence_claims(labels: Iterable[str], solver: SolvesQPs) -> list[Claim]:
    """Both parts of the campaign for these scenes; `solver` drives the runs.

    Raises ValueError for an unknown scene or parameter.
    """
    cases = {case.label: case for case in cases_of(list(labels))}

    @cache
    def known(scene: str) -> tuple[Case, Reference]:
        return cases[scene], reference_of(cases[scene], solver)

    def swept(scene: str, bound: str, eps: float) -> list[Row]:
        return errors_of_run(*known(scene), solver, bound, eps)

    def drifted(scene: str, eps: float) -> list[Row]:
        return compare_rules(*known(scene), solver, eps)

    return [
        claim_over("swept", swept, scene=cases, bound=BOUNDS, eps=SWEEP),
        claim_over("drifted", drifted, scene=cases, eps=TOLERANCES),
    ]
