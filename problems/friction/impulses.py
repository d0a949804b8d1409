"""Impulses (2.13), (2.14), §4.3: the QP of a step with h = α₀ = 1, posed by generators.

    minimise ½‖A V c + d‖²,  c ≥ 0,   A = D⁻ᵀG,  d = D q̇₋ + D⁻ᵀF,   q̇₊ = D⁻¹(A V c + d),  Λ = V c

The friction cone |Λ_F| ≤ μ_I Σ Λ_N of a contact has the generators (1, ±μ_I) for a corner and
(1, 0, ±μ_I), (0, 1, ±μ_I) for an edge on an edge; with μ_I = 0 they are the normals alone.  When
F = 0 the kinetic energy changes by −½‖AΛ‖², never upwards, whatever μ_I.
"""

from __future__ import annotations

from typing import Literal, NamedTuple

import numpy as np
import scipy.sparse as sp

from problems.contacts.active_kernels import JOINT
from problems.contacts.assembly import Assembly
from problems.friction.newton_coulomb import newton_coulomb_impulse
from problems.qp import Indices, Vector
from problems.sequence import QPSequence

ImpulseRule = Literal["paper", "newton_coulomb"]
"""The paper's cone of impulses, or `problems.friction.newton_coulomb`."""

IMPULSE_ACCURACY = 1e-10
"""Accuracy asked of an impulse, relative to the momentum: the paper factorizes exactly there."""
LARGE_IDENTITY = 1000
"""With μ_I = 0 V takes normals as they are; of more columns than this it is not kept with the QP,
whose x are the normal multipliers then."""


class Generators(NamedTuple):
    """V (N + F, p) with Λ = V c over [normals, frictions].

    entries, row, column : of V
    normal, direction : (p,) of each generator, the second as in `ContactQP.feature`
    """

    entries: Vector
    row: Indices
    column: Indices
    normal: Indices
    direction: Indices

    def multipliers(self, c: Vector, count: int) -> Vector:
        """V c (N + F,)."""
        forces = self.entries * c[self.column]
        return np.bincount(self.row, forces, count).astype(np.float64, copy=False)

    def dense(self, count: int) -> Vector:
        """V as an array, of so many rows."""
        V = np.zeros((count, self.normal.size))
        V[self.row, self.column] = self.entries
        return V

    def sparse(self, count: int) -> sp.csr_array:
        """V in sparse rows, so many."""
        at = self.row, self.column
        return sp.csr_array((self.entries, at), shape=(count, self.normal.size))


def cone_generators(assembly: Assembly, mu_I: float) -> Generators:
    """(1, ± μ_I) for each normal with friction, 1 for the others."""
    slips = (assembly.friction_of >= 0) & (mu_I > 0)
    normal = np.repeat(np.arange(slips.size), np.where(slips, 2, 1))
    second = np.append(False, normal[1:] == normal[:-1])
    direction = np.where(slips[normal], 2 + second, 0)
    tilted = np.flatnonzero(direction)
    return Generators(
        np.append(np.ones(normal.size), np.where(second[tilted], -mu_I, mu_I)),
        np.append(normal, slips.size + assembly.friction_of[normal[tilted]]),
        np.append(np.arange(normal.size), tilted),
        *(normal, direction),
    )


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
    V = cone_generators(assembly, mu_I)
    normal, direction, rows = V.normal, V.direction, assembly.count + len(assembly.frictions)
    every = np.arange(assembly.count), np.arange(len(assembly.frictions))
    columns = assembly.scaled(*every, D)
    A = sp.csc_array(columns @ V.sparse(rows)) if sp.issparse(columns) else columns @ V.dense(rows)
    feature = assembly.active.feature[normal]
    contacts = assembly.friction_of[normal] != JOINT
    feature[contacts, 4] = direction[contacts]
    count = normal.size
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
        generators=None if identity and count > LARGE_IDENTITY else V.dense(rows),
        kind="impulse",
        t=t,
        eps0=accuracy,
    )
    c = np.asarray(solution.x)
    return qp.residual(c) / D, V.multipliers(c, rows)
