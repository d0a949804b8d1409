"""What it costs that sliding friction is taken from earlier steps (§4.1), and (4.2) at fixed h."""

from __future__ import annotations

import numpy as np

from harness.claims.checking import check
from harness.claims.checks.bead import Bead, Motion, exact, slope, step
from harness.claims.painleve import measured_growth
from harness.claims.slide import growth
from problems import scene, simulate
from problems.qp import Vector
from solvers import make_solver

LENGTHS = 0.02 / 2.0 ** np.arange(5)
"""h of the single steps [s]."""
BREAKS = 0.3
"""When a force may jump, or its derivative [s]."""


def _bead(jump: str) -> Bead:
    """A bead that slides under a force which is smooth, or that jumps, or whose slope does."""

    def force(t: float) -> Vector:
        late = max(0.0, t - BREAKS)
        extra = {"": 0.0, "slope": 6.0 * late, "value": 2.0 * (t > BREAKS)}[jump]
        return np.array([4.0, -9.81 + np.cos(5.0 * t) - extra])

    return Bead(kappa=0.4, mu=0.4, force=force, speed=1.5)


def _around(bead: Bead, h: float, jump: str) -> Motion:
    """Exact values at four times, and at the end of a step of h from the last of them.

    With a jump the step begins where it is.
    """
    start = BREAKS if jump else 0.5
    times = start + h * np.arange(-3.0, 2.0)
    if not jump:
        return exact(bead, times)
    before = exact(_bead(""), times[:4])
    after = exact(
        bead._replace(force=lambda t: bead.force(t + start), x=before.q[-1, 0],
                      speed=float(np.linalg.norm(before.v[-1]))),
        np.array([0.0, h]),
    )  # fmt: skip
    return Motion(times, *(np.concatenate([one, two[1:]]) for one, two in
                           zip(before[1:], after[1:], strict=True)))  # fmt: skip


@check
def extra_error(rule: str, jump: str = "") -> float:
    """Order in h of what the lag changes of q̇_n in one step of (BDF-2) from exact values.

    jump : "", or what jumps where the step begins: the "slope" of a force (λ̇) or its "value" (λ)
    """
    bead, errors = _bead(jump), []
    for h in LENGTHS:
        true = _around(bead, h, jump)
        past = Motion(*(values[:4] for values in true))
        _, lagged, _, _ = step(bead, past, h, 2, rule)
        _, prompt, _, _ = step(bead, past, h, 2)
        errors.append(float(np.linalg.norm(lagged - prompt)))
    return slope(LENGTHS, np.array(errors))


@check
def coulomb_residual(rule: str, jump: str = "") -> float:
    """Order in h of | |λ_F| − μ λ_N | after one step from exact values."""
    bead, found = _bead(jump), []
    for h in LENGTHS:
        past = Motion(*(values[:4] for values in _around(bead, h, jump)))
        _, _, lam, star = step(bead, past, h, 2, rule)
        found.append(bead.mu * abs(star - lam))
    return slope(LENGTHS, np.array(found))


@check
def grows(gain: float, rule: str = "(4.2)") -> float:
    """Growth per step of an error in λ, measured on the stepper, over that predicted for a rule.

    A rod slides with this gain by the paper's friction, so by (4.2): errors obey ζ² = γ(2ζ − 1).
    """
    (row,) = measured_growth(make_solver("glambda"), gain)
    return float(row["measured"]) / growth(gain, rule)


@check
def growth_factor(gain: float) -> float:
    """Growth per step of an error in λ by (4.2), measured on the stepper."""
    (row,) = measured_growth(make_solver("glambda"), gain)
    return float(row["measured"])


@check
def steps_ratio(label: str, against: str, until: float = 3.0) -> float:
    """Steps of the paper's friction rule over those of `against`, on a scene."""
    solver = make_solver("glambda")
    counts = [
        simulate(scene(label), solver, friction=rule, until=until, keep_qps=False).counts["steps"]
        for rule in ("paper", against)
    ]
    return counts[0] / counts[1]


@check
def ends_apart(label: str, mu: float = 0.5, until: float = 3.0) -> float:
    """Largest distance of the ends of a scene by the paper's friction rule and the corrected [m].

    mu : with which the corrected rule runs; the paper's has 0.5
    """
    solver = make_solver("glambda")
    one, other = (
        simulate(scene(label, mu=by), solver, friction=rule, until=until, keep_qps=False).q[-1]
        for rule, by in (("paper", 0.5), ("corrected", mu))
    )
    return float(np.abs(one - other).max())


@check
def sticks_again(label: str, friction: str, until: float = 3.0) -> float:
    """Slip → stick events of a run."""
    run = simulate(scene(label), make_solver("glambda"), friction=friction, until=until,
                   keep_qps=False)  # fmt: skip
    return float(sum(event.kind == "slip_to_stick" for event in run.event_log))
