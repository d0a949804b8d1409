"""Redundant collisions by the thousand: each must settle, and obey both laws.

    python -m tests.endurance.collisions                  1,000 collisions, each perturbed 5 times
    python -m tests.endurance.collisions --first 40 --count 10 --perturbed 1

A collision is a pile, boxes on boxes in a tower, a wall, a pyramid or a corner, or a heap, whose
bodies are given velocities all at once: random ones, whole numbers, or the same for all, so that
contacts tie.  With aligned boxes an interface has more contacts than the motion can tell apart.
Each is solved as it is and with positions and velocities off by 1e-14: what rounding on another
processor would make of it.  OPENBLAS_CORETYPE and NUMBA_CPU_NAME choose such a processor.

Printed is one line per collision that failed, and then the largest violations, relative to
‖q̇₋‖_M and to the impulse:

    approach    −g_Nᵀq̇₊, where a contact still closes              (Signorini)
    pull        −Λ_N, where a contact pulls
    carried     Λ_N g_Nᵀq̇₊, where an opening contact pushes
    cone        |Λ_F| − μ Σ Λ_N                                    (Coulomb)
    resisting   what friction lacks of −sign(g_Fᵀq̇₊) μ Σ Λ_N, times the slip
    momentum    M (q̇₊ − q̇₋) − G Λ
    energy      T₊ − T₋; may be positive where slip reverses (4.12)

Exit code 1 where a collision does not settle, or a law is violated by more than `TOLERANCE`.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from rich.console import Console
from rich.progress import track
from rich.table import Table

import problems.friction.newton_coulomb as newton_coulomb
from harness.machine.threads import ask_for_one_thread
from problems import Scene, scene, simulate
from problems.bodies.bodies import box
from problems.contacts.assembly import Assembly
from problems.contacts.geometry import HalfPlane
from problems.friction.impulses import solve_impulse
from problems.scenes.calm import calm_scene
from problems.sequence import QPSequence, SimulationError
from problems.stepping.options import StepperOptions
from problems.stepping.stepper import Stepper
from solvers import make_solver

TOLERANCE = 1e-8
"""Largest violation of a law, relative to ‖q̇₋‖_M."""
LAWS = ("approach", "pull", "carried", "cone", "resisting", "momentum")
PERTURBATION = 1e-14
COEFFICIENTS = (0.1, 0.3, 0.5, 0.8, 1.0, 1.5)


class Collision(NamedTuple):
    """A pile and the velocities (3n,) that its bodies have before the impulse."""

    name: str
    scene: Scene
    v: np.ndarray


@dataclass(frozen=True)
class Outcome:
    """Violations by name, and whether the passes did not settle and the LCP was asked."""

    contacts: int
    violations: dict[str, float]
    asked: bool
    seconds: float


def collision(seed: int) -> Collision:
    """The collision of this number."""
    rng = np.random.default_rng([17, seed])
    mu = float(rng.choice(COEFFICIENTS))
    kind = ("tower", "wall", "pyramid", "corner", "heap")[seed % 5]
    if kind == "corner":
        pile = cornered(int(rng.integers(2, 9)), mu)
    elif kind == "heap":
        pile = replace(fallen(int(rng.choice((10, 20))), int(rng.integers(6))), mu=mu)
    else:
        bodies = int(rng.integers(2, 11)) if kind == "tower" else int(rng.choice((6, 10, 15)))
        pile = scene(kind, bodies=bodies, mu=mu, **({} if kind == "pyramid" else {"speed": 0.0}))
    pile = replace(pile, mu_I=mu)
    n = len(pile.bodies)
    way = rng.integers(4)
    v = rng.standard_normal((n, 3))
    if way == 1:
        v = np.round(2 * v)
    elif way == 2:
        v = np.broadcast_to(np.round(2 * v[0]) * [1, 1, 0], (n, 3)).copy()
    elif way == 3:
        v[:-1] = 0.0
    if not v.any():
        v[:, 1] = -1.0
    return Collision(f"{seed} {kind} of {n}, mu = {mu}", pile, v.ravel())


@cache
def fallen(bodies: int, seed: int) -> Scene:
    """Polygons that have come down on each other."""
    heap = replace(calm_scene("heap", bodies=bodies, seed=seed), mu_I=0.0)
    run = simulate(heap, make_solver("glambda"), until=0.3, keep_qps=False)
    return replace(heap, q0=run.q[-1], v0=np.zeros_like(run.v[-1]))


def cornered(n: int, mu: float) -> Scene:
    """A stack of unit boxes that leans flush against a wall."""
    q0 = np.array([[0.5, 0.5 + i, 0.0] for i in range(n)])
    wall = HalfPlane(point=(0.0, 0.0), normal=(1.0, 0.0))
    return Scene(
        name="corner",
        bodies=tuple(box(1.0, 1.0) for _ in range(n)),
        q0=q0,
        v0=np.zeros((n, 3)),
        ground=(HalfPlane(), wall),
        mu=mu,
    )


def solved(made: Collision, perturbation: int, keep: bool = False) -> Outcome:
    """The collision, perturbed by the noise of this number (0: none), and what it violates.

    Raises SimulationError where it does not settle.
    """
    options = StepperOptions(1e-3, 1e-3, rest_speed=1e-3, impulses="newton_coulomb")
    stepper = Stepper(made.scene, make_solver("glambda"), options)
    stepper.start()
    rng = np.random.default_rng([perturbation, 3])
    off = PERTURBATION * (perturbation > 0)
    hit = Assembly(
        stepper.system.graph, stepper.system.q + off * rng.standard_normal(stepper.system.q.size)
    )
    v = made.v * (1 + off * rng.standard_normal(made.v.size))
    asked: list[int] = []
    ask = newton_coulomb.coulomb_multipliers

    def noted(*arguments: Any) -> Any:
        asked.append(1)
        return ask(*arguments)

    newton_coulomb.coulomb_multipliers = noted
    begin = time.process_time()
    try:
        after, lam = solve_impulse(
            QPSequence(make_solver("glambda"), keep=keep),
            hit,
            stepper.system.D,
            made.scene.mu_I,
            v,
            np.zeros_like(v),
            0.0,
            "newton_coulomb",
        )
    finally:
        newton_coulomb.coulomb_multipliers = ask
    spent = time.process_time() - begin
    violations = violated(hit, stepper.system.D, made.scene.mu_I, v, after, lam)
    return Outcome(len(hit.normals), violations, bool(asked), spent)


def violated(
    hit: Assembly, D: np.ndarray, mu: float, v: np.ndarray, after: np.ndarray, lam: np.ndarray
) -> dict[str, float]:
    """Violations of the laws, relative to ‖q̇₋‖_M."""
    size, N = float(np.linalg.norm(D * v)), len(hit.normals)
    lam_N, lam_F = lam[:N], lam[N:]
    every = np.arange(N), np.arange(lam_F.size)
    columns = hit.scaled(*every, D)
    columns = columns.toarray() if hasattr(columns, "toarray") else columns
    lengths = np.linalg.norm(columns, axis=0)
    speed = columns.T @ (D * after) / lengths / size  # of unit columns
    push = lam * lengths / size
    gap, slip = speed[:N], speed[N:]
    bound = np.zeros(lam_F.size)
    loaded = hit.friction_of >= 0
    np.add.at(bound, hit.friction_of[loaded], mu * lam_N[loaded])
    bound *= lengths[N:] / size
    change = D * (after - v) - columns @ lam
    return {
        "approach": float(np.max(-gap, initial=0.0)),
        "pull": float(np.max(-push[:N], initial=0.0)),
        "carried": float(np.max(push[:N] * gap, initial=0.0)),
        "cone": float(np.max(np.abs(push[N:]) - bound, initial=0.0)),
        "resisting": float(np.max(np.abs(bound * np.abs(slip) + push[N:] * slip), initial=0.0)),
        "momentum": float(np.linalg.norm(change)) / size,
        "energy": float(np.linalg.norm(D * after) ** 2 - size**2) / size**2,
    }


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--count", type=int, default=1000)
    parser.add_argument("--perturbed", type=int, default=5)
    options = parser.parse_args(arguments)
    console, failed, outcomes = Console(), 0, []
    for seed in track(range(options.first, options.first + options.count), "collisions"):
        made = collision(seed)
        for noise in range(options.perturbed + 1):
            try:
                outcome = solved(made, noise)
            except SimulationError as error:
                failed += 1
                console.print(f"{made.name}, noise {noise}: {error}")
                continue
            outcomes.append(outcome)
            worst = max(outcome.violations[law] for law in LAWS)
            if worst > TOLERANCE:
                failed += 1
                console.print(f"{made.name}, noise {noise}: {outcome.violations}")
    console.print(summary(outcomes, failed))
    return int(failed > 0)


def summary(outcomes: Sequence[Outcome], failed: int) -> Table:
    """How many settled, and the largest violations."""
    names = "collisions", "failed", "contacts", "LCP asked", *LAWS, "energy", "median, max ms"
    table = Table("of", "all", show_header=False)
    if outcomes:
        times = np.array([outcome.seconds for outcome in outcomes]) * 1e3
        contacts = [outcome.contacts for outcome in outcomes]
        worst = [
            f"{max(outcome.violations[law] for outcome in outcomes):.1e}"
            for law in (*LAWS, "energy")
        ]
        share = sum(outcome.asked for outcome in outcomes) / len(outcomes)
        spent = f"{np.median(times):.2g}, {times.max():.3g}"
        span = f"{min(contacts)}-{max(contacts)}"
        values = str(len(outcomes)), str(failed), span, f"{100 * share:.1f} %", *worst, spent
        for name, value in zip(names, values, strict=True):
            table.add_row(name, value)
    return table


if __name__ == "__main__":
    ask_for_one_thread()
    sys.exit(main())
