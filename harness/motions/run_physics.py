"""What a finished simulation says of the physics, whoever solved its QPs.

overlap       the deepest overlap of two parts at any accepted time, found anew from the corners
              of the bodies by separating axes; the stepper's φ sees active contacts only
Signorini     0 ≤ λ_N ⊥ g_Nᵀq̇ ≥ 0 at the end of each step and impulse, from the QP and x: the
              largest approach speed, the largest pull, and the work λ_N g_Nᵀq̇ h (ΛᵀVᵀGᵀq̇₊ of
              an impulse) done on contacts that separate.  Too small forces approach, too large
              ones do work: they pump energy in, and nothing in the stepper forbids it
energy        what T + V gains at steps and at impulses, and loses at impulses.  No contact
              may give energy; work of `Load`s and external impulses are not counted.  The
              multistep methods gain a little on their own, so compare with exact QPs
accuracy      ‖A(x − x*)‖ of every answer, against our method's at
              `harness.motions.in_loop.EXACT`
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import combinations

import numpy as np

from harness.judging.facts import facts_of
from harness.judging.judge import VERIFIED_WITHIN
from harness.motions.in_loop import exact
from problems import Run
from problems.bodies.bodies import GROUND
from problems.bodies.forces import Load
from problems.bodies.shapes import cross
from problems.contacts.geometry import Geometry
from problems.joints.joints import kept_apart
from problems.qp import NORMAL, ContactQP, Solution, Vector
from problems.scenes import Scene
from problems.sequence import WARM_KINDS

PUSHES = 1e-3
"""Part of the largest normal force of a QP below which a contact does not count as pushing."""


def physics_of(run: Run) -> dict[str, float]:
    """Every measure of the module but the accuracy; by name."""
    return {
        "overlap": max(0.0, float(overlap(run.scene, run.q).max())),
        "active_gap": min(0.0, float(run.gaps.min(initial=0.0))),
        "reach": reach(run),
        **signorini(run),
        **energy(run),
    }


# --- overlap -------------------------------------------------------------------------------------


def overlap(scene: Scene, q: Vector) -> Vector:
    """Deepest overlap [m] of any two parts at poses q (n, bodies, 3).

    (n,), negative if apart; parts whose circumscribed circles are apart are not looked at, nor are
    bodies that a joint lets pass each other.
    """
    pass_by = kept_apart(scene.joints)
    if any(body.is_round for body in scene.bodies):
        return _overlap_of_round(scene, q)
    parts = [(b, polygon) for b, body in enumerate(scene.bodies) for polygon in body.polygons]
    corners = [_placed(polygon, q[:, b]) for b, polygon in parts]
    deepest = np.full(len(q), -np.inf)
    for (a, one), (b, other) in combinations(zip(parts, corners, strict=True), 2):
        if a[0] != b[0] and (min(a[0], b[0]), max(a[0], b[0])) not in pass_by:
            reach = scene.bodies[a[0]].radius + scene.bodies[b[0]].radius
            near = np.hypot(*(q[:, a[0], :2] - q[:, b[0], :2]).T) <= reach
            apart = np.maximum(
                _separation(one[near], other[near]), _separation(other[near], one[near])
            )
            deepest[near] = np.maximum(deepest[near], -apart)
    for plane in scene.ground:
        normal = np.array(plane.normal) / np.hypot(*plane.normal)
        for (body, _), one in zip(parts, corners, strict=True):
            if (GROUND, body) in pass_by:
                continue
            deepest = np.maximum(deepest, -((one - plane.point) @ normal).min(axis=1))
    return deepest


def _overlap_of_round(scene: Scene, q: Vector) -> Vector:
    """`overlap` where something is round, (n,), by the contact geometry's own distances."""
    geometry = Geometry(scene.bodies, scene.ground, kept_apart(scene.joints))
    number, deepest = len(geometry.part_body), np.full(len(q), -np.inf)
    pairs = [
        (one, two)
        for one in range(geometry.n_moving)
        for two in range(one + 1, number)
        if geometry.part_body[one] != geometry.part_body[two]
        and geometry.may_touch(*geometry.part_body[[[one], [two]]])
    ]
    for i, pose in enumerate(geometry.pose(now.ravel()) for now in q):
        deepest[i] = max((geometry.penetration(pose, pair) for pair in pairs), default=-np.inf)
    return deepest


def _placed(polygon: Vector, pose: Vector) -> Vector:
    """Corners (n, c, 2) of a polygon (c, 2) at poses (n, 3)."""
    c, s = np.cos(pose[:, 2]), np.sin(pose[:, 2])
    turn = np.stack([np.stack([c, -s], axis=-1), np.stack([s, c], axis=-1)], axis=-2)
    return np.einsum("nij,cj->nci", turn, polygon) + pose[:, None, :2]


def _separation(one: Vector, other: Vector) -> Vector:
    """max over the edges of `one` of the least distance of a corner of `other` beyond it, (n,)."""
    side = np.roll(one, -1, axis=1) - one
    outward = np.stack([side[..., 1], -side[..., 0]], axis=-1)
    outward /= np.linalg.norm(side, axis=-1, keepdims=True)
    beyond = np.einsum("nei,nci->nec", outward, other) - (outward * one).sum(-1)[..., None]
    return beyond.min(axis=2).max(axis=1)


# --- Signorini -----------------------------------------------------------------------------------


def last_answers(run: Run) -> Iterator[tuple[ContactQP, Vector]]:
    """(QP, x) that each accepted step and impulse ended with."""
    kept: tuple[ContactQP, Solution] | None = None
    for qp, solution in zip(run.qps, run.solutions, strict=True):
        if not qp.accepted or qp.kind == "minimum_norm":
            continue
        if kept is not None and not (qp.t == kept[0].t and _same_event(qp, kept[0])):
            yield kept[0], np.asarray(kept[1].x)
        kept = qp, solution
    if kept is not None:
        yield kept[0], np.asarray(kept[1].x)


def _same_event(one: ContactQP, other: ContactQP) -> bool:
    return (one.kind in WARM_KINDS) == (other.kind in WARM_KINDS)


def reach(run: Run) -> float:
    """Largest gap φ [m] of a contact that carries more than `PUSHES` of the QP's largest force."""
    place = {float(t): i for i, t in enumerate(run.t)}
    farthest = 0.0
    for qp, x in last_answers(run):
        if qp.kind in WARM_KINDS and qp.t in place:
            gaps = loaded_gaps(run.scene, run.q[place[qp.t]], qp, x)
            farthest = max(farthest, float(gaps.max(initial=0.0)))
    return farthest


def loaded_gaps(scene: Scene, q: Vector, qp: ContactQP, x: Vector) -> Vector:
    """φ [m] at poses q (n, 3) of the contacts to which x gives more than `PUSHES` of the largest.

    (c,), negative where a corner is inside
    """
    normal = qp.feature[:, 4] == NORMAL
    pushes = normal & (x > PUSHES * x[normal].max(initial=0.0)) & (x > 0)
    gaps: list[float] = []
    any_round = any(body.is_round for body in scene.bodies)
    geometry = Geometry(scene.bodies, scene.ground) if any_round else None
    for body, corner, other, edge, _ in qp.feature[pushes]:
        if geometry is not None and scene.bodies[body].is_round:
            gaps.append(_gap_of_round(geometry, q, body, other, edge))
            continue
        point = _placed(np.concatenate(scene.bodies[body].polygons)[[corner]], q[[body]])[0, 0]
        if other == GROUND:
            plane = scene.ground[edge]
            gaps.append(float((point - plane.point) @ plane.normal / np.hypot(*plane.normal)))
        else:
            sides = [
                np.stack([polygon, np.roll(polygon, -1, axis=0)], axis=1)
                for polygon in scene.bodies[other].polygons
            ]
            start, end = _placed(np.concatenate(sides)[edge], q[[other]])[0]
            gaps.append(float(cross(point - start, end - start) / np.linalg.norm(end - start)))
    return np.array(gaps)


def _gap_of_round(geometry: Geometry, q: Vector, body: int, other: int, plane: int) -> float:
    """Distance [m] of what is round from the nearest part of a body, or from one half plane."""
    parts = np.flatnonzero(geometry.part_body == other)
    parts = parts[plane : plane + 1] if other == GROUND else parts
    centre = np.repeat(np.flatnonzero(geometry.corner_body == body), parts.size)
    return float(geometry.clearance(geometry.pose(q.ravel()), centre, parts).min())


def signorini(run: Run) -> dict[str, float]:
    """Largest approach speed [m/s] and pull [N] of a step, and the work [J] pumped in by all."""
    approach = pull = pumped = 0.0
    for qp, x in last_answers(run):
        direction = qp.feature[:, 4]
        normal = direction == NORMAL if qp.kind in WARM_KINDS else direction >= 0
        if not normal.any():
            continue
        speed = qp.h / qp.alpha0 * qp.gradient(x)[normal]
        force = x[normal]
        approach = max(approach, -float(speed.min()))
        if qp.kind in WARM_KINDS:
            pull = max(pull, -float(force.min()))
        pumped += qp.h * float(np.maximum(force, 0.0) @ np.maximum(speed, 0.0))
    return {"approach": approach, "pull": pull, "pumped": pumped}


# --- energy --------------------------------------------------------------------------------------


def energy(run: Run) -> dict[str, float]:
    """What T + V [J] does: gained at steps and at impulses, lost at impulses, at the end, peak T.

    Raises nothing; the work of a force that is neither conservative nor a `Load` counts as a gain.
    """
    T = run.kinetic_energy()
    total = T + run.potential_energy()
    change = np.diff(total) - _work_of_loads(run)
    instant = np.diff(run.t) == 0
    external = np.isin(run.t[1:], [impulse.t for impulse in run.scene.impulses])
    jumps = change[instant & ~external]
    return {
        "gained_at_steps": float(np.maximum(change[~instant], 0.0).sum()),
        "gained_at_impulses": float(np.maximum(jumps, 0.0).sum()),
        "lost_at_impulses": float(np.maximum(-jumps, 0.0).sum()),
        "final_energy": float(total[-1]),
        "peak_kinetic": float(T.max()),
    }


def _work_of_loads(run: Run) -> Vector:
    """Work [J] of the constant loads in each interval between accepted times."""
    work = np.zeros(len(run.t) - 1)
    for force in run.scene.forces:
        if isinstance(force, Load):
            acts = (force.start < run.t[1:]) & (run.t[1:] <= force.end)
            moved = np.diff(run.q[:, force.body], axis=0) @ np.array(force.value)
            work += np.where(acts, moved, 0.0)
    return work


# --- accuracy ------------------------------------------------------------------------------------


def accuracy_of_answers(run: Run) -> dict[str, float]:
    """‖A(x − x*)‖ of the answers, relative to ε₀ and to the scale.

    eps0_ratio, eps0_ratio_median, glambda_error : largest and median over the QPs of time steps,
        and the largest relative to the scale
    impulse_ratio : largest over the impulses, relative to their eps0
    missed : answers beyond `VERIFIED_WITHIN` ε₀ that the solver calls solved
    rank_deficient : share of the QPs of time steps whose λ is not unique

    QPs of kind minimum_norm are not looked at: they do not change A x.
    """
    steps: list[float] = []
    impulses, relative, missed, deficient = [0.0], 0.0, 0, 0
    for qp, solution in zip(run.qps, run.solutions, strict=True):
        if qp.kind == "minimum_norm" or qp.k == 0:
            continue
        error = float(np.linalg.norm(qp.A @ (np.asarray(solution.x) - exact(qp))))
        missed += solution.found and error > VERIFIED_WITHIN * qp.eps0
        if qp.kind in WARM_KINDS:
            facts = facts_of(qp)
            steps.append(error / qp.eps0)
            relative = max(relative, error / facts.scale)
            deficient += facts.rank < qp.k
        else:
            impulses.append(error / qp.eps0)
    return {
        "eps0_ratio": max(steps, default=0.0),
        "eps0_ratio_median": float(np.median(steps or [0.0])),
        "glambda_error": relative,
        "impulse_ratio": max(impulses),
        "missed": float(missed),
        "rank_deficient": deficient / max(len(steps), 1),
    }
