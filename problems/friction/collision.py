"""What Newton–Coulomb impulses follow from, and what comes of them."""

from __future__ import annotations

from typing import NamedTuple

from problems.contacts.active_kernels import Frictions
from problems.qp import Indices, Vector


class Collision(NamedTuple):
    """What Newton–Coulomb impulses follow from, see `problems.friction.newton_coulomb`.

    D, v, F : (3n,) with q̇₋ = v and the external impulse
    columns, layout, tangents : (entries (·, 6), bodies (·, 2)) of g_N, of the QP and of g_F
    """

    frictions: Frictions
    D: Vector
    v: Vector
    F: Vector
    columns: tuple[Vector, Indices]
    layout: tuple[Vector, Indices]
    tangents: tuple[Vector, Indices]


class Impact(NamedTuple):
    """q̇₊ (3n,), Λ_N (N,), Λ_F (F,), and the QPs that were solved for them."""

    v: Vector
    lam_N: Vector
    lam_F: Vector
    solves: int
