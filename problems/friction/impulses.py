"""Impulses (2.13), (2.14), §4.3: the QP of a step with h = α₀ = 1, posed by generators.

    minimise ½‖A V c + d‖²,  c ≥ 0,   A = D⁻ᵀG,  d = D q̇₋ + D⁻ᵀF,   q̇₊ = D⁻¹(A V c + d),  Λ = V c

The friction cone |Λ_F| ≤ μ_I Σ Λ_N of a contact has the generators (1, ±μ_I) for a corner and
(1, 0, ±μ_I), (0, 1, ±μ_I) for an edge on an edge; with μ_I = 0 they are the normals alone.  When
F = 0 the kinetic energy changes by −½‖AΛ‖², never upwards, whatever μ_I.
"""

from __future__ import annotations

from typing import Literal

import numpy as np
import scipy.sparse as sp

from problems.contacts.active_kernels import JOINT
from problems.contacts.assembly import Assembly
from problems.friction.newton_coulomb import newton_coulomb_impulse
from problems.qp import Vector
from problems.sequence import QPSequence

ImpulseRule = Literal["paper", "newton_coulomb"]
"""The paper's cone of impulses, or `problems.friction.newton_coulomb`."""

IMPULSE_ACCURACY = 1e-10
"""Accuracy asked of an impulse, relative to the momentum: the paper factorizes exactly there."""
LARGE_IDENTITY = 1000
"""With μ_I = 0 V takes normals as they are; of more columns than this it is not kept with the QP,
whose x are the normal multipliers then."""


def cone_generators(
    assembly: Assembly, mu_I: float
) -> tuple[sp.csr_array, np.ndarray, np.ndarray, np.ndarray]:
    """V (N + F, p) with Λ = V c over [normals, frictions], and per generator its normal, friction
    (or −1) and `direction` as in `ContactQP.feature`.  Returns V, normal, friction, direction."""
    n_normals, n_frictions = assembly.count, len(assembly.frictions)
    friction_of = assembly.friction_of
    slips = (friction_of >= 0) & (mu_I > 0)
    normal = np.repeat(np.arange(n_normals), np.where(slips, 2, 1))
    second = np.append(False, normal[1:] == normal[:-1])
    direction = np.where(slips[normal], 2 + second, 0)
    friction = np.where(slips[normal], friction_of[normal], -1)
    column = np.arange(normal.size)
    tilted = np.flatnonzero(friction >= 0)
    V = sp.csr_array(
        (
            np.append(np.ones(normal.size), np.where(direction[tilted] == 2, mu_I, -mu_I)),
            (
                np.append(normal, n_normals + friction[tilted]),
                np.append(column, tilted),
            ),
        ),
        shape=(n_normals + n_frictions, normal.size),
    )
    return V, normal, friction, direction


def solve_impulse(
    qps: QPSequence,
    assembly: Assembly,
    D: Vector,
    mu_I: float,
    v: Vector,
    F: Vector,
    t: float,
    rule: ImpulseRule = "paper",
) -> tuple[Vector, Vector]:
    """q̇₊ (3n,) and Λ over [normals, frictions] (N + F,) for q̇₋ = v and external impulse F."""
    accuracy = IMPULSE_ACCURACY * max(1.0, float(np.linalg.norm(D * v)))
    if rule == "newton_coulomb" and mu_I > 0 and assembly.frictions:
        return newton_coulomb_impulse(qps, assembly, D, mu_I, v, F, t, accuracy)
    V, normal, _, direction = cone_generators(assembly, mu_I)
    every = np.arange(assembly.count), np.arange(len(assembly.frictions))
    columns = assembly.scaled(*every, D)
    A = sp.csc_array(columns @ V) if sp.issparse(columns) else columns @ V.toarray()
    feature = assembly.active.feature[normal]
    contacts = assembly.friction_of[normal] != JOINT
    feature[contacts, 4] = direction[contacts]
    count = V.shape[1]
    lower, upper = np.zeros(count), np.full(count, np.inf)
    lower[~contacts], upper[~contacts] = assembly.rows.impulse_bounds()
    identity = mu_I == 0 or not assembly.frictions
    qp, solution = qps.solve(
        A=A,
        d=D * v + F / D,
        lower=lower,
        upper=upper,
        row_id=4 * assembly.normal_ids[normal] + direction,
        feature=feature,
        D=D,
        generators=None if identity and count > LARGE_IDENTITY else V.toarray(),
        kind="impulse",
        t=t,
        eps0=accuracy,
    )
    c = np.asarray(solution.x)
    return qp.residual(c) / D, V @ c
