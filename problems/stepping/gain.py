"""Where friction feeds back on itself: gains γ ≥ 1, which a run reports as events.

A sliding contact presses itself: λ_N answers λ_* with the slope γ = −μ s (g_NᵀM⁻¹g_F)/(g_NᵀM⁻¹g_N),
and several contacts with the matrix λ_N'(λ_*) of `problems.friction.passes`.  As long as its
eigenvalues stay below 1 there is one λ that meets Coulomb's law with the signs s.  At γ ≥ 1 there
may be none, or another beside the one that is taken (Painlevé 1895), and the lagged rules (4.2) and
(4.3) grow from step to step.

Quiet steps cost one look at each sliding contact by itself.  Eigenvalues are computed where that
gain is 1 or more, or where the passes did not settle or were more than `QUIET_PASSES`; gains that
only several contacts have together are seen in such steps alone.
"""

from __future__ import annotations

import numpy as np

from problems.contacts.constraint_graph import Normal
from problems.contacts.geometry_kernels import own_gains
from problems.friction.kernels import QUIET_PASSES
from problems.friction.newton import largest_gain
from problems.qp import Vector
from problems.stepping.velocity import VelocityStep


class GainWatch:
    """Finds gains γ ≥ 1 in the steps of a run, each episode of them once.

    An episode ends with a step, none of whose trials failed, in which no contact has one by itself
    and the passes are quiet.

    failed : whether the last trial has
    """

    def __init__(self, D: Vector, velocity_dependent: bool):
        self._D = D
        self._velocity_dependent = velocity_dependent
        self._in_episode = False
        self.failed = False

    def calm(self) -> None:
        """A step without a gain of 1 or more has been taken."""
        self._in_episode = False

    def look(self, step: VelocityStep, signs: Vector) -> tuple[float, Normal] | None:
        """The gain at which an episode begins with this step, and its normal; else None.

        signs : (F,) s of the sliding contacts, 0 of the sticking ones
        """
        own = self._own_gains(step, signs)
        few = step.passes <= QUIET_PASSES or self._velocity_dependent
        quiet = step.settled and few and not self.failed
        self.failed = not step.settled
        if quiet and own.max(initial=0.0) < 1:
            self.calm()
            return None
        if self._in_episode:
            return None
        gain, i = self._gain(step, signs, own)
        if gain < 1:
            return None
        self._in_episode = True
        return gain, step.assembly.normals[i]

    def _own_gains(self, step: VelocityStep, signs: Vector) -> Vector:
        """γ of each normal (N,) as if it were the only one."""
        assembly = step.assembly
        if not signs.any():
            return np.zeros(0)
        columns = assembly.columns
        return own_gains(
            *(columns.normal, columns.tangent, columns.bodies, 1 / self._D**2),
            *(assembly.friction_of, signs, assembly.mu),
        )

    def _gain(self, step: VelocityStep, signs: Vector, own: Vector) -> tuple[float, int]:
        """The largest gain of the free contacts together, or of one about to lift off by itself."""
        sigma = np.where(signs != 0, signs, np.where(step.at_bound, np.sign(step.lam_F), 0.0))
        together = largest_gain(step.assembly, self._D, sigma, step.at_bound, step.lam_N)
        if own.size == 0:
            return together
        bound = step.assembly.bound(step.lam_N)[step.assembly.rubbing]
        unloaded = np.where(bound > 0, 0.0, own)
        alone = int(np.argmax(unloaded))
        return max(together, (float(unloaded[alone]), alone))
