"""Painlevé's rod: a corner that slides on rough ground ahead of the centre of gravity."""

import numpy as np

from problems.bodies.bodies import box
from problems.scenes.scene import Scene


def painleve(
    length: float = 2.0,
    thickness: float = 0.02,
    angle: float = 1.1,
    mu: float = 1.6,
    slip: float = 1.0,
    spin: float = 0.0,
    fall: float = 0.0,
    density: float = 1.0,
    mu_I: float = 0.0,
    gravity: float = 9.81,
    eps: float = 1e-3,
    end_time: float = 1.0,
) -> Scene:
    """A rod pushed ahead on its lower end, where Coulomb's law has no motion, or two.

    length, thickness of the rod [m];  angle : θ between rod and ground [rad], π/2 stands upright on
    both corners of its end;  slip : speed of the lower end [m/s], positive away from the centre;
    spin : θ' [rad/s], positive where the rod rises;  fall : speed at which the lower end meets the
    ground [m/s], with an impulse at t = 0;  density [kg/m²]

    While the end slides, friction μ λ lets the gap acceleration grow by (1 − γ) a λ, with
    a = g_NᵀM⁻¹g_N and the gain γ = μ · 3 tan θ/(4 + tan²θ) of a thin rod.  Let B be what the gap
    acceleration is without a contact force, −g + (length/2) spin² sin θ.

        γ < 1, B < 0   one motion, with λ = −B/((1 − γ) a)
        γ < 1, B > 0   one motion: the end leaves the ground
        γ > 1, B < 0   none: every force presses the end further down (inconsistent)
        γ > 1, B > 0   two: the end leaves the ground, or stays there with the λ above

    γ can exceed 1 where μ > 4/3 (tan θ = 2) (Painlevé 1895; Lecornu's way out is an impulse
    without a collision, which ends the slip).  A rod that slides towards γ = 1 with B < 0 does
    not cross it: λ is large there and turns its spin, so that B = 0 and γ = 1 are met together or
    not at all (Génot and Brogliato 1999).  An upright box with thickness/length = cot θ, which
    slides on its whole side, is as inconsistent as its leading corner.

    Raises ValueError for an angle out of range.
    """
    if not 0 < angle <= np.pi / 2:
        raise ValueError(f"angle = {angle:g}; it must be above 0 and at most π/2 = 1.5708")
    body = box(length, thickness, density)
    c, s = np.cos(angle), np.sin(angle)
    # the lower right corner of the rod, turned by −θ
    x, y = c * length / 2 - s * thickness / 2, -s * length / 2 - c * thickness / 2
    omega = -spin
    return Scene(
        bodies=(body,),
        q0=np.array([[0.0, -y, -angle]]),
        v0=np.array([[slip + omega * y, -fall - omega * x, omega]]),
        mu=mu,
        mu_I=mu_I,
        gravity=gravity,
        eps=eps,
        end_time=end_time,
    )
