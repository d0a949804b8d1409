"""Figure 1: where (AB-r, BDF-r) is stable on the test equation ü + d u̇ + k u = 0 (3.6).

With D = h d and K = h² k, constant steps give the difference equations

    r = 1   (1 + D) ζ² − (2 + D − K) ζ + 1 = 0
    r = 2   (ζ − 1)((3/2 + D) ζ² − 2ζ + 1/2) + K ζ (3/2 ζ − 1/2) = 0

(AB-r for u, BDF-r for u̇; in r = 2 a root ζ = 0 has been divided out).  They are stable where no
root exceeds 1 and those of size 1 are simple.  For D ≥ 0 that is

    r = 1   0 ≤ K ≤ 4 + 2D          r = 2   0 ≤ K ≤ 4 + D

by Routh and Hurwitz with ζ = (1 + s)/(1 − s): a root leaves through ζ = −1.  Without a damper the
two are the same leapfrog, (ζ − 1)² + K ζ = 0, with a parasitic root 1/3 in r = 2.  The corners
(0, 0) and (0, 4) have a double root of size 1: there runs grow in proportion to their steps.

`region` computes the set from the roots; `measured_run` runs the stepper itself on a body in a
spring and damper at a fixed step.  The stepper takes the damper by functional iteration (3.9), with
the rate D/α₀, α₀ = 1 or 3/2: where that is not well below 1 it halves the step, and the run ends.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from harness.results.claim import Claim, Row
from problems import Scene, simulate
from problems.bodies.bodies import box
from problems.bodies.forces import SpringDamper
from problems.qp import Vector
from problems.sequence import SolvesQPs

CORNERS = ((0.0, 0.0), (0.0, 4.0))
"""(D, K) with a double root of size 1."""
STEP = 1e-2
"""Length of the steps of a measured run [s]."""
STEPS = 200
"""Most steps of a measured run."""
LARGE = 30.0
"""Size at which a run that grows may end."""
ARM = 1e4
"""Natural length of the spring [m], beyond every motion."""
SWINGS = 12
"""Steps over which the envelope of a run is taken."""


def characteristic(order: int, D: ArrayLike, K: ArrayLike) -> NDArray[np.float64]:
    """Coefficients of the polynomial in ζ, highest power first.  (..., order + 2)

    Raises ValueError for an order other than 1 and 2.
    """
    D, K = np.broadcast_arrays(np.asarray(D, float), np.asarray(K, float))
    one = np.ones_like(D)
    if order == 1:
        rows: list[Any] = [1 + D, -(2 + D - K), one]
    elif order == 2:
        rows = [1.5 + D, 1.5 * K - 3.5 - D, 2.5 - 0.5 * K, -0.5 * one]
    else:
        raise ValueError(f"order = {order}; the methods of the paper have order 1 or 2")
    return np.stack(rows, axis=-1)


def roots(order: int, D: ArrayLike, K: ArrayLike) -> NDArray[np.complex128]:
    """Roots ζ of the difference equation, largest first.  (..., order + 1)"""
    coefficients = characteristic(order, D, K)
    monic = coefficients[..., 1:] / coefficients[..., :1]
    degree = monic.shape[-1]
    companion = np.zeros((*monic.shape[:-1], degree, degree))
    companion[..., 0, :] = -monic
    companion[..., np.arange(1, degree), np.arange(degree - 1)] = 1.0
    found = np.linalg.eigvals(companion).astype(complex)
    place = np.argsort(-np.abs(found), axis=-1, kind="stable")
    return np.take_along_axis(found, place, axis=-1)


def amplification(order: int, D: ArrayLike, K: ArrayLike) -> Vector:
    """Largest |ζ|: the factor per step by which a run grows in the end."""
    return np.asarray(np.abs(roots(order, D, K)[..., 0]))


@dataclass(frozen=True, eq=False)
class Region:
    """Amplification on a grid of D = h d (columns) and K = h² k (rows)."""

    order: int
    D: Vector
    K: Vector
    growth: Vector


def region(order: int, D: ArrayLike, K: ArrayLike) -> Region:
    """The amplification over a grid of D (n,) and K (p,)."""
    D, K = np.asarray(D, float), np.asarray(K, float)
    return Region(order, D, K, amplification(order, D[None, :], K[:, None]))


def border(order: int, D: ArrayLike) -> Vector:
    """K at which the region ends above D ≥ 0."""
    return 4.0 + (2.0 if order == 1 else 1.0) * np.asarray(D, float)


@dataclass(frozen=True, eq=False)
class MeasuredRun:
    """A run of the stepper at one point of the region.

    u : displacement after each step;  w : h u̇
    eps : ε of the run, to which (3.9) is solved, in units of h u̇ at the start
    """

    order: int
    D: float
    K: float
    u: Vector
    w: Vector
    eps: float

    @property
    def size(self) -> Vector:
        """√(u² + w²), 1 at the start."""
        return np.hypot(self.u, self.w)

    @property
    def steps(self) -> int:
        """Steps of full length that were taken."""
        return self.u.size - 1

    @property
    def residual(self) -> float:
        """How far the run is from the difference equation: largest |Σ c_j u_{n−j}| over max |u|."""
        coefficients = characteristic(self.order, self.D, self.K)
        # two steps of order 1 come first, and order 2 looks two steps back
        settled = self.u[2:] if self.order == 2 else self.u
        if settled.size < coefficients.size:
            return float("nan")
        found = np.convolve(settled, coefficients, mode="valid")
        return float(np.abs(found).max() / np.abs(settled).max())

    @property
    def growth(self) -> float:
        """Factor per step, from the envelope of the second half of what is above the tolerance."""
        loud = np.flatnonzero(self.size > 100 * self.eps)
        envelope = np.log(self.size[: loud[-1] + 1])
        if envelope.size > 2 * SWINGS:
            envelope = np.lib.stride_tricks.sliding_window_view(envelope, SWINGS).max(axis=1)
        half = envelope[envelope.size // 2 :]
        if half.size < 2:
            return float("nan")
        return float(np.exp(np.polyfit(np.arange(half.size), half, 1)[0]))


def measured_run(solver: SolvesQPs, order: int, D: float, K: float) -> MeasuredRun:
    """A run of the stepper with h d = D and h² k = K, from u = 0, as far as its steps are `STEP`.

    It ends where (3.9) no longer meets its tolerance; that is absolute, so a motion that grows is
    cut off sooner.
    """
    body = box(1.0, 1.0)
    spring = SpringDamper(
        body=0,
        point=(0.0, 0.0),
        anchor=(-ARM, 0.0),
        stiffness=body.mass * K / STEP**2,
        damping=body.mass * D / STEP,
        length=ARM,
    )
    scene = Scene(
        bodies=(body,),
        q0=np.zeros((1, 3)),
        v0=np.array([[1.0 / STEP, 0.0, 0.0]]),
        ground=(),
        forces=(spring,),
        gravity=0.0,
    )
    # what twelve passes of (3.9) reach, the first two steps being of order 1
    eps = max(1e-9, 300 * D**11)
    grows = float(amplification(order, D, K))
    steps = STEPS if grows < 1.01 else min(STEPS, int(np.log(LARGE) / np.log(grows)) + 4)
    run = simulate(
        scene, solver, eps=eps / STEP, fixed_step=STEP, until=steps * STEP, rest_speed=1e-300,
        order=order,
    )  # fmt: skip
    whole = np.isclose(np.diff(run.t), STEP, rtol=1e-9)
    kept = 1 + (whole.size if whole.all() else int(np.argmin(whole)))
    return MeasuredRun(order, D, K, run.q[:kept, 0, 0], STEP * run.v[:kept, 0, 0], eps)


def checked_run(solver: SolvesQPs, order: int, D: float, K: float) -> list[Row]:
    """A run of the stepper beside the roots, one row."""
    run = measured_run(solver, order, D, K)
    row = {
        "border": float(border(order, D)),
        "amplification": float(amplification(order, D, K)),
        "steps": run.steps,
        "growth": run.growth,
        "residual": run.residual,
    }
    return [row]


def sizes_of_run(solver: SolvesQPs, order: int, D: float, K: float) -> Row:
    """√(u² + w²) at the start and after each step, a row each."""
    return {"size": measured_run(solver, order, D, K).size}


def points_to_check() -> list[tuple[int, float, float]]:
    """Points on both sides of the border, as far as twelve passes of (3.9) are enough."""
    undamped = [(order, 0.0, K) for order in (1, 2) for K in (1.0, 3.9, 4.1)]
    damped = [
        (order, D, share * float(border(order, D)))
        for order in (1, 2)
        for D in (0.1, 0.2, 0.3)
        for share in (0.3, 0.97, 1.03)
    ]
    return undamped + damped


def stability_claims(solver: SolvesQPs) -> list[Claim]:
    """The runs on both sides of the border, "runs", and those at its "corners"."""
    checked = [{"order": order, "D": D, "K": K} for order, D, K in points_to_check()]
    corners = [{"order": order, "D": D, "K": K} for order in (1, 2) for D, K in CORNERS]
    return [
        Claim("runs", partial(checked_run, solver), checked),
        Claim("corners", partial(sizes_of_run, solver), corners),
    ]
