"""Trees of bodies in joint coordinates, after Wittenburg (1977): bilateral multipliers eliminated.

Where pins connect bodies as a tree, the velocities that they allow are q̇ = B(q) w, with w the
rates of the pins and the velocities of bodies that hang on nothing.  In them the QP of a step has
the full mass matrix M(q) = BᵀMB = RᵀR, which is factorized anew at each q, and the columns of
contacts and stops alone:

    minimise ½‖A_w x + d_w‖²,   A_w = R⁻ᵀ Bᵀ G,   d_w = R⁻ᵀ Bᵀ D d,   w = (h/α₀) R⁻¹ (A_w x + d_w)

Its x and q̇ are those of the multiplier form, in fewer rows and columns.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import scipy.linalg as sla
import scipy.sparse as sp

from problems.bodies.bodies import GROUND
from problems.joints.joints import Apart, Pin, Stop
from problems.joints.row_kernels import place_point
from problems.qp import ContactQP, Vector
from problems.scenes.scene import Scene


def allowed_velocities(scene: Scene, q: Vector) -> Vector:
    """B (3n, degrees of freedom) at q (3n,): how each joint coordinate moves each body.

    Raises ValueError for a joint other than a pin, a stop or `Apart`, and for pins that form no
    tree.
    """
    held = {}
    for joint in scene.joints:
        if isinstance(joint, Stop | Apart):
            continue
        if not isinstance(joint, Pin) or joint.body in held:
            raise ValueError(f"scene {scene.label!r}: its joints are no tree of pins: {joint}")
        held[joint.body] = joint
    n = len(scene.bodies)
    free = {body for body in range(n) if body not in held}
    size = len(held) + 3 * len(free)
    motion: dict[int, Vector] = {GROUND: np.zeros((3, size))}
    first = 0
    for body in _from_the_root(scene, held):
        rates = np.zeros((3, size))
        if body in free:
            rates[:, first : first + 3] = np.eye(3)
            first += 3
        else:
            pin = held[body]
            other = motion[pin.other]
            rates[2] = other[2]
            rates[2, first] = 1.0
            first += 1
            x, y, *centre = place_point(q, pin.other, *pin.anchor)
            own_x, own_y, *own = place_point(q, body, *pin.point)  # where drift has left it
            rates[0] = other[0] - (y - centre[1]) * other[2] + (own_y - own[1]) * rates[2]
            rates[1] = other[1] + (x - centre[0]) * other[2] - (own_x - own[0]) * rates[2]
        motion[body] = rates
    return np.vstack([motion[body] for body in range(n)])


def _from_the_root(scene: Scene, held: dict[int, Pin]) -> list[int]:
    """All bodies, each after the one that it hangs on."""
    order: list[int] = []
    waiting = list(range(len(scene.bodies)))
    while waiting:
        ready = [b for b in waiting if b not in held or held[b].other in (GROUND, *order)]
        if not ready:
            raise ValueError(f"scene {scene.label!r}: pins of bodies {waiting} form a ring")
        order += ready
        waiting = [body for body in waiting if body not in ready]
    return order


def in_joint_coordinates(qp: ContactQP, B: Vector) -> tuple[ContactQP, Vector]:
    """The QP without the columns of pins, and R⁻¹ with w = (h/α₀) R⁻¹ (A_w x + d_w).

    B : (m, degrees of freedom) of `allowed_velocities` at the q of the QP
    """
    bounded = np.isfinite(qp.lower) | np.isfinite(qp.upper)
    kept = np.flatnonzero(bounded | (qp.feature[:, 4] >= 0))
    scaled = qp.D[:, None] * B
    R = np.linalg.cholesky(scaled.T @ scaled).T
    A = sp.csc_array(qp.A)[:, kept].toarray()
    inverse = sla.solve_triangular(R, np.eye(R.shape[0]))
    basis = scaled @ inverse
    small = replace(
        qp,
        **{name: getattr(qp, name)[kept] for name in ("lower", "upper", "row_id", "feature")},
        A=basis.T @ A,
        d=basis.T @ qp.d,
        D=np.ones(R.shape[0]),
        generators=None,
    )
    return small, inverse
