"""Orders of accuracy (§3.1): smooth stretches, a contact that is dropped, stick → slip, and t*."""

from __future__ import annotations

import numpy as np

from harness.claims.checking import check
from harness.claims.checks.bead import AB, BDF, Bead, exact, leaves_at, march, slope, step
from problems import Scene, simulate
from problems.bodies.bodies import box
from problems.bodies.forces import SpringDamper
from problems.qp import Vector
from solvers import make_solver

STEPS = (40, 80, 160, 320)
"""Steps over one second, or over what is looked at."""


def _heavy(t: float) -> Vector:
    return np.array([0.3 * np.sin(3.0 * t), -9.81 + np.cos(2.0 * t)])


def _lifting(t: float) -> Vector:
    return np.array([0.0, -9.81 + 12.0 * t])


SMOOTH = Bead(kappa=0.4, mu=0.3, force=_heavy, speed=1.5)
"""It stays on its hill."""
LEAVING = Bead(kappa=0.8, mu=0.0, force=_lifting, speed=1.0)
"""It is pulled up until λ_N = 0."""


@check
def smooth(order: int, quantity: str) -> float:
    """Global order at t = 1 of q, v, lam or phi, friction solved without a lag.

    order : r of AB-r and BDF-r
    """
    errors = []
    for n in STEPS:
        found, true = march(SMOOTH, 1.0 / n, n, order), exact(SMOOTH, np.array([0.0, 1.0]))
        far = {
            "q": np.linalg.norm(found.q[-1] - true.q[-1]),
            "v": np.linalg.norm(found.v[-1] - true.v[-1]),
            "lam": abs(found.lam[-1] - true.lam[-1]),
            "phi": abs(SMOOTH.gap(found.q[-1])),
        }
        errors.append(float(far[quantity]))
    return slope(1.0 / np.array(STEPS), np.array(errors))


@check
def dropped(order: int, quantity: str, leaves: bool = True) -> float:
    """Global order in q or v of a fixed-step run through a drop, without a restart.

    The run ends as long after the drop as it began before it; where the drop falls within its step
    is varied, and the largest error counts.  leaves=False: the run ends before the drop.
    """
    off = leaves_at(LEAVING, 1.0)
    end = off + 0.2 if leaves else 0.8 * off
    errors = []
    for n in STEPS:
        worst = 0.0
        for part in np.linspace(0.0, 0.9, 7):
            h = end / (n + part)
            found = march(LEAVING, h, n, order)
            true = exact(LEAVING, np.array([0.0, n * h]), leaves=True)
            worst = max(worst, float(np.linalg.norm(getattr(found, quantity)[-1]
                                                    - getattr(true, quantity)[-1])))  # fmt: skip
        errors.append(worst)
    return slope(end / np.array(STEPS), np.array(errors))


@check
def local_at_drop(quantity: str, order: int = 2) -> float:
    """Order in h of the error of one step, from exact values, that a drop lies in."""
    off = leaves_at(LEAVING, 1.0)
    lengths = 0.02 / 2.0 ** np.arange(5)
    errors = []
    for h in lengths:
        worst = 0.0
        for part in np.linspace(0.05, 0.95, 7):
            times = off - part * h + h * np.arange(-3.0, 2.0)
            true = exact(LEAVING, times, leaves=True)
            past = type(true)(*(values[:4] for values in true))
            _, v, _, _ = step(LEAVING, past, h, order)
            # q_n is explicit and does not see the drop; q_{n+1} does, through q̇_n
            share = h * AB[order][0] if quantity == "q" else 1.0
            worst = max(worst, share * float(np.linalg.norm(v - true.v[4])))
        errors.append(worst)
    return slope(lengths, np.array(errors))


@check
def slips(order: int, jump: float = 0.0) -> float:
    """Global order in q̇ of a fixed-step run through stick → slip.

    A body of 1 kg at rest is pulled by F = 8 t, plus `jump` from t_1 = μ g/8 on, where it begins to
    slide and v = 4 (t − t_1)² + jump (t − t_1).  μ λ_N is constant, so nothing lags.
    """
    mu, g, rate = 0.5, 9.81, 8.0
    begins = mu * g / rate
    errors = []
    for n in STEPS:
        worst = 0.0
        for part in np.linspace(0.05, 0.95, 7):
            h = 1.2 / (n + part)
            past = [0.0] * order
            for i in range(1, n + 1):
                pull = rate * i * h + (jump if i * h > begins else 0.0)
                # (4.6): friction up to μ λ_N keeps q̇_n at 0
                c = h * pull - sum(a * past[-j] for j, a in enumerate(BDF[order]) if j)
                friction = np.clip(-c / h, -mu * g, mu * g)
                past.append((c + h * friction) / BDF[order][0])
            late = n * h - begins
            worst = max(worst, abs(past[-1] - (0.5 * rate * late**2 + jump * late)))
        errors.append(worst)
    return slope(1.2 / np.array(STEPS), np.array(errors))


@check
def hit_time(speed: float, curved: bool = True) -> float:
    """Order in h of the error of t* by inverse linear interpolation, on a fall from 1 m.

    speed : of the fall at its start [m/s];  curved : whether φ is curved, by gravity
    """
    g = 9.81 if curved else 0.0
    true = (-speed + np.sqrt(speed**2 + 2 * g)) / g if curved else 1.0 / speed
    lengths = 0.1 / 2.0 ** np.arange(6)
    errors = []
    for h in lengths:
        worst = 1e-16
        for part in np.linspace(0.1, 0.9, 9):
            before, after = true - part * h, true + (1 - part) * h
            one, two = (1.0 - speed * t - 0.5 * g * t * t for t in (before, after))
            worst = max(worst, abs(before + h * one / (one - two) - true))
        errors.append(worst)
    return slope(lengths, np.array(errors))


def _sled(mu: float) -> Scene:
    """A box that slides under a spring which presses it down ever less."""
    body = box(1.0, 0.5)
    spring = SpringDamper(body=0, point=(0.0, 0.0), anchor=(0.5, -2.0), stiffness=8.0, damping=0.0)
    return Scene(
        bodies=(body,),
        q0=np.array([[0.0, 0.25, 0.0]]),
        v0=np.array([[3.0, 0.0, 0.0]]),
        forces=(spring,),
        mu=mu,
    )


@check
def stepper(friction: str, order: int = 2, mu: float = 0.3) -> float:
    """Global order in q̇ at t = 0.2 of the stepper itself with constant steps, by a friction rule.

    A box slides while a spring presses it down by a force that varies; the reference is the
    converged rule at a step 16 times shorter than the shortest.
    """
    solver, made = make_solver("glambda", accuracy=1e-13), _sled(mu)

    def last(h: float, rule: str, r: int) -> Vector:
        run = simulate(made, solver, eps=1e-9, fixed_step=h, until=0.2, friction=rule,
                       order=r, rest_speed=1e-300, h_first=h)  # fmt: skip
        return run.v[-1].ravel()

    lengths = 0.02 / 2.0 ** np.arange(4)
    true = last(lengths[-1] / 16, "corrected", 2)
    errors = np.array([np.linalg.norm(last(h, friction, order) - true) for h in lengths])
    return slope(lengths, errors)
