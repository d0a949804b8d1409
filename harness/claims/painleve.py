"""Painlevé's rod: runs of the stepper where Coulomb's law has no motion, or two.

1. The first step after a jump in q̇, as h → 0: does it stay bounded (§4.2)?
2. Growth over a fixed time: by `harness.claims.slide.growth` to the power t/h, whatever the first
   step does, until the slip has ended.
3. What becomes of the rod by each friction rule, beside the impulse without a collision.
4. The rod that rises towards γ = 1 while it slides.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from harness.claims.slide import STEEPEST, growth, rod_of_gain, slide_of
from harness.results.claim import Claim, Row, claim_over
from problems import Run, scene, simulate
from problems.friction.rules import FrictionRule
from problems.qp import Vector
from problems.sequence import SolvesQPs

FLUSH = {"angle": float(np.pi / 2), "thickness": 1.0}
"""A box that slides on its whole side, two corners, with the leading corner of the same gain."""
CASES: Mapping[str, Mapping[str, float]] = {
    "one motion": {"angle": STEEPEST, "mu": 1.0},
    "none": {"angle": STEEPEST},
    "none, γ = 7.5": {"angle": STEEPEST, "mu": 10.0},
    "none, two corners": FLUSH,
    "two": {"angle": STEEPEST, "spin": 4.0},
}
"""Parameters of the scene by how many motions Coulomb's law leaves."""
RULES: tuple[tuple[FrictionRule, float], ...] = (
    ("paper", 1e-3),
    ("corrected", 1e-3),
    ("corrected", 1e-9),
)
"""Friction rule and ε of the runs with fixed steps."""
STEPS = tuple(10.0**-k for k in range(2, 9))
"""Lengths of a first step [s]."""
GAINS = (-0.5, -0.4, -0.35, -0.3, -0.1, 0.1, 0.5, 0.9, 0.95, 1.05, 1.2, 1.5, 2.0)
"""Gains whose growth per step is measured."""
SHORT = 1e-7
"""Steps in which growth is measured [s]: the rod hardly turns in them."""
FIXED_TIME = 1e-6
"""Time over which growth is measured as h → 0 [s]."""
FIXED_GAINS = (-0.4, 0.9, 1.05, 1.2)
FIXED_STEPS = (4, 8, 16, 32)
APPROACHES = (2.0, 2.5, 3.0, 3.25, 3.5)
"""Spins [rad/s] with which a rod rises towards γ = 1."""
TOLERANCES = (1e-3, 1e-4, 1e-5, 1e-6)
"""ε of the runs towards γ = 1."""


# --- the first step -------------------------------------------------------------------------------


def first_steps(solver: SolvesQPs, motions: str, rule: FrictionRule, eps: float) -> list[Row]:
    """The first step after a collision, as h → 0, one row per h.

    Columns: gain, h, jump ‖q̇_n − q̇_{n−1}‖_M, lam the largest Σ λ_N [N],
    impulse h λ [N·s], catch ‖·‖_M of the impulse without a collision.
    """
    made = scene("painleve", **{**CASES[motions], "fall": 0.1})
    rows = []
    for h in STEPS:
        run = simulate(made, solver, eps=eps, friction=rule, fixed_step=h, until=h)
        first = int(np.searchsorted(run.t, 0.0, side="right"))
        before = slide_of(made, run.q[first - 1, 0], run.v[first - 1, 0])
        lam = _normal_force(run, first)
        rows.append(
            {
                "gain": before.gain,
                "h": h,
                "jump": before.norm(run.v[first, 0] - before.v),
                "lam": lam,
                "impulse": lam * (run.t[first] - run.t[first - 1]),
                "catch": before.norm(before.catch) if before.gain >= 1 else np.nan,
            }
        )
    return rows


# --- growth over a fixed time ---------------------------------------------------------------------


class Errors(NamedTuple):
    """A run by the paper's rule with constant steps, in which the rod slides all the time.

    lam, steady : (n,) λ_N and that of steady sliding at the same state, after each step [N]
    """

    lam: Vector
    steady: Vector

    @property
    def e(self) -> Vector:
        """λ_n − λ."""
        return self.lam - self.steady


def errors_of(solver: SolvesQPs, gain: float, h: float, steps: int) -> Errors:
    """λ beside that of steady sliding, in so many steps of h."""
    made = rod_of_gain(gain, slip=1000.0)
    run = simulate(
        made, solver, eps=1e-9, friction="paper", fixed_step=h, until=steps * h
    )  # fmt: skip
    states = zip(run.q[1:, 0], run.v[1:, 0], strict=True)
    return Errors(
        np.array([_normal_force(run, i) for i in range(1, len(run.t))]),
        np.array([slide_of(made, q, v).steady for q, v in states]),
    )


def measured_growth(solver: SolvesQPs, gain: float, steps: int = 14) -> list[Row]:
    """Growth per step of the error in λ beside the theory, one row.

    e_n = c₁ e_{n−1} + c₂ e_{n−2} is fitted where (4.2) is in force and nothing is clipped at 0.
    Theory: c₁ = 2γ, c₂ = −γ.
    """
    found = errors_of(solver, gain, SHORT, steps)
    lam, e = found.lam, found.e
    star = 2 * lam[1:-1] - lam[:-2]
    size = np.abs(e[1:-1]) + np.abs(e[:-2])
    share = size / np.abs(found.steady[2:])
    whole = (lam[2:] > 0) & (star > 0) & (share > 1e-5) & (share < 1e3)
    kept = int(np.argmin(whole)) if not whole.all() else whole.size
    left = np.column_stack([e[1:-1], e[:-2]]) / size[:, None]
    first, second = np.linalg.lstsq(left[:kept], (e[2:] / size)[:kept], rcond=None)[0]
    row = {
        "by (4.3)": growth(gain, "(4.3)"),
        "by (4.2)": growth(gain),
        "steps": kept,
        "measured": float(np.abs(np.roots([1.0, -first, -second])).max()),
    }
    return [row]


def fixed_time(solver: SolvesQPs, gain: float, steps: int) -> list[Row]:
    """Growth of the error in λ over `FIXED_TIME` in so many steps, one row.

    Columns: h, power |ζ|^(steps − 2); size of the last two errors over that of the
    first two, predicted by the recurrence without clipping at 0, and measured; lam, the last [N].
    """
    found = errors_of(solver, gain, FIXED_TIME / steps, steps)
    theory = [1.0, gain]  # the second step is by (4.3)
    for _ in range(steps - 2):
        theory.append(gain * (2 * theory[-1] - theory[-2]))
    row = {
        "h": FIXED_TIME / steps,
        "power": growth(gain) ** (steps - 2),
        "predicted": _amplified(theory),
        "measured": _amplified(found.e),
        "lam": float(found.lam[-1]),
    }
    return [row]


def caught(solver: SolvesQPs, rule: FrictionRule, h: float) -> Row:
    """The rod without a motion, in steps of h by one of the rules, until its slip ended.

    One row per state.  Columns: end, when the slip ended [s]; error of the
    jump in q̇ against the impulse without a collision, relative, in ‖·‖_M; t [s], slip [m/s] and
    the impulse h λ [N·s] of the step to it, NaN at the start.
    """
    made = scene("painleve", **CASES["none"])
    start = slide_of(made, made.q0[0], made.v0[0])
    run = simulate(made, solver, eps=1e-6, friction=rule, fixed_step=h, until=80 * h)
    end = next(event.t for event in run.event_log if event.kind in ("slip_to_stick", "jam"))
    slip = np.array([slide_of(made, q[0], v[0]).slip for q, v in zip(run.q, run.v, strict=True)])
    # what is left of the slip where its end was located goes in the next step
    stands = (run.t >= end) & (np.abs(slip) < 1e-4 * np.abs(slip[0]))
    last = int(np.argmax(stands))
    t, lam = run.t[: last + 1], [_normal_force(run, i) for i in range(1, last + 1)]
    jump = run.v[last, 0] - run.v[0, 0]
    return {
        "end": float(end),
        "error": start.norm(jump - start.catch) / start.norm(start.catch),
        "t": t,
        "slip": slip[: last + 1],
        "impulse": [np.nan, *(np.diff(t) * lam)],
    }


# --- what becomes of it ---------------------------------------------------------------------------


def outcome(solver: SolvesQPs, motions: str, rule: FrictionRule) -> list[Row]:
    """How a rule goes on, with its own steps, ε = 1e-3; one row.

    Columns: gain, reported γ of the event, end of the slip and its t, error of the
    jump against the impulse without a collision, steps, rejected.
    """
    made = scene("painleve", **CASES[motions])
    start = slide_of(made, made.q0[0], made.v0[0])
    run = simulate(made, solver, friction=rule, until=0.02)
    end = _end_of_slip(run)
    jump = run.v[end.at, 0] - run.v[0, 0]
    stops = end.kind in ("slip_to_stick", "jam")
    row = {
        "gain": start.gain,
        "reported": _reported(run),
        "end": end.kind,
        "t": end.t,
        "error": start.norm(jump - start.catch) / start.norm(start.catch)
        if stops and start.gain >= 1
        else np.nan,
        "steps": run.counts["steps"],
        "rejected": run.counts["rejected_steps"],
    }
    return [row]


def approach(solver: SolvesQPs, spin: float, eps: float) -> Row:
    """A rod that rises towards γ = 1 while it slides, by the corrected rule from γ = 0.87.

    spin : at the start [rad/s]

    One row per state until its slip ended.  Columns: end and t, how and when the slip ended; lam,
    the largest Σ λ_N before [N]; later, θ' at t = 0.15 [rad/s]; gain γ and free B.
    """
    made = scene("painleve", angle=0.7, spin=spin, slip=3.0)
    run = simulate(made, solver, eps=eps, until=0.15)
    end = _end_of_slip(run)
    slides = [slide_of(made, run.q[i, 0], run.v[i, 0]) for i in range(end.at)]
    return {
        "end": end.kind,
        "t": end.t,
        "lam": max(_normal_force(run, i) for i in range(1, end.at)),
        "later": -float(run.v[-1, 0, 2]),
        "gain": [slide.gain for slide in slides],
        "free": [slide.free for slide in slides],
    }


class Painleve(NamedTuple):
    """The rows of all claims; see `painleve_claims`."""

    firsts: pd.DataFrame
    growths: pd.DataFrame
    fixed: pd.DataFrame
    catches: pd.DataFrame
    outcomes: pd.DataFrame
    approaches: pd.DataFrame


def painleve_claims(solver: SolvesQPs) -> list[Claim]:
    """The four questions, each with its runs; `solver` drives them."""
    firsts = [
        {"motions": motions, "rule": rule, "eps": eps} for motions in CASES for rule, eps in RULES
    ]
    rules = ("paper", "corrected")
    return [
        Claim("firsts", partial(first_steps, solver), firsts),
        claim_over("growths", partial(measured_growth, solver), gain=GAINS),
        claim_over("fixed", partial(fixed_time, solver), gain=FIXED_GAINS, steps=FIXED_STEPS),
        claim_over("catches", partial(caught, solver), rule=rules, h=STEPS),
        claim_over("outcomes", partial(outcome, solver), motions=CASES, rule=rules),
        claim_over("approaches", partial(approach, solver), spin=APPROACHES, eps=TOLERANCES),
    ]


class _End(NamedTuple):
    kind: str
    t: float
    at: int


def _end_of_slip(run: Run) -> _End:
    """The first event that ends the slip, and the state after it."""
    for event in run.event_log:
        at = int(np.searchsorted(run.t, event.t))
        flies = event.kind == "drop" and not run.multipliers[min(at + 1, len(run.t) - 1)]
        if flies or event.kind in ("slip_to_stick", "jam"):
            return _End(event.kind, float(event.t), at)
    return _End("none", float(run.t[-1]), len(run.t) - 1)


def _reported(run: Run) -> float:
    """γ of the first event "gain", or NaN."""
    told = [event.detail for event in run.event_log if event.kind == "gain"]
    return float(told[0].rsplit("= ", 1)[1]) if told else np.nan


def _normal_force(run: Run, i: int) -> float:
    """Σ λ_N [N] of the i-th state: the multipliers of a body on the ground, its friction last."""
    return float(sum([*run.multipliers[i].values()][:-1]))


def _amplified(e: ArrayLike) -> float:
    """Size of the last two over that of the first two."""
    first, second, *_, before, last = np.asarray(e, float)
    return float(np.hypot(before, last) / np.hypot(first, second))
