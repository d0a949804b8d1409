"""The constraint graph of a scene at an instant: what figure 6 draws, and what it saves.

In a system of n bodies with k corners each, k² n(n−1) + kn constraint functions are possible (§5).
The broad phase leaves those of corners and parts that are near each other.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from problems import Scene
from problems.bodies.bodies import GROUND
from problems.contacts.geometry import Geometry
from problems.formulas.multistep import SHORTEST_STEP
from problems.qp import Vector
from problems.sequence import SolvesQPs
from problems.stepping.options import StepperOptions
from problems.stepping.stepper import Stepper


class Constraint(NamedTuple):
    """A constraint: `kind` is "N" or "F"; its contact by number; λ of the last step [N].

    at : (2,) where the corner of it, or of its contact's first normal, is [m]
    """

    kind: str
    contact: int
    lam: float
    at: Vector


class Instant(NamedTuple):
    """The graph at t [s].

    q : (n, 3);  contacts : the two bodies of each, from 1, 0 the ground
    constraints : in the order of their row_id
    possible, near : corner–edge pairs that could touch, and those that the broad phase leaves
    """

    scene: Scene
    t: float
    q: Vector
    contacts: Sequence[tuple[int, int]]
    constraints: Sequence[Constraint]
    possible: int
    near: int


def instant_of(scene: Scene, t: float, solver: SolvesQPs, **settings: Any) -> Instant:
    """Step a scene to t [s] and look at its graph.

    Raises ValueError for a time that is not positive, and what `problems.simulate` does.
    """
    if not (np.isfinite(t) and t > 0):
        raise ValueError(f"at = {t!r}; it must be a positive time")
    stepper = Stepper(scene, solver, StepperOptions.of(scene.eps, **settings), keep_qps=False)
    stepper.start()
    while stepper.system.t < t - SHORTEST_STEP and not stepper.at_rest:
        stepper.advance(t)
    return _read(scene, stepper)


def _read(scene: Scene, stepper: Stepper) -> Instant:
    system = stepper.system
    assembly = system.assembly()
    graph, columns = system.graph, assembly.columns
    place = {row_id: i for i, row_id in enumerate(assembly.normal_ids.tolist())}
    stretch = system.stretches[-1]
    lam = dict(zip(stretch.row_ids, stretch.lam[-1].tolist(), strict=True))
    numbers: dict[int, int] = {}
    contacts: list[tuple[int, int]] = []
    constraints = []
    for row_id in sorted([*graph.normals, *graph.frictions]):
        normal = graph.normals.get(row_id)
        contact = (graph.frictions[row_id] if normal is None else normal).contact
        if id(contact) not in numbers:
            numbers[id(contact)] = len(contacts)
            contacts.append(_bodies(graph.geometry, contact.pair))
        there = normal or contact.normals[0]
        at = graph.geometry.touched(
            assembly.pose, there.corner, columns.normal[place[there.row_id], :2]
        )
        kind = "F" if normal is None else "N"
        constraints.append(Constraint(kind, numbers[id(contact)], lam.get(row_id, 0.0), at))
    return Instant(
        scene=scene,
        t=system.t,
        q=system.q.reshape(-1, 3).copy(),
        contacts=contacts,
        constraints=constraints,
        possible=possible_constraints(scene),
        near=sum(_edges(graph.geometry, part) for part in graph.candidates.part.tolist()),
    )


def _bodies(geometry: Geometry, parts: tuple[int, int]) -> tuple[int, int]:
    """Numbers of the two bodies, from 1, the ground 0 and first."""
    one, two = (int(geometry.part_body[part]) for part in parts)
    return (0, one + 1) if two == GROUND else (one + 1, two + 1)


def _edges(geometry: Geometry, part: int) -> int:
    """Of a part; a half plane has one."""
    return 1 if geometry.part_body[part] == GROUND else int(geometry.part_size[part])


def possible_constraints(scene: Scene) -> int:
    """Every corner against every edge of every other body and of the ground.

    k² n(n−1) + kn for n bodies of k corners on level ground.
    """
    k = [1 if body.is_round else sum(len(part) for part in body.polygons) for body in scene.bodies]
    return sum(k) ** 2 - sum(each * each for each in k) + sum(k) * len(scene.ground)
