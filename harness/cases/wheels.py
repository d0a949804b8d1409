"""Cases of what rolls: numbers of a run beside those of its one degree of freedom."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.integrate import solve_ivp

from harness.cases.bodies import Found, found, g, observed_order, run_of
from problems import scene
from problems.bodies.bodies import Body
from problems.sequence import SolvesQPs

UNTIL = 1.0
STEPS = 4e-3, 2e-3, 1e-3


def rolled(body: Body, phi: float, until: float) -> Any:
    """φ, φ̇ and x after `until` of an ellipse let go at φ that rolls, see `scenes.ellipses`."""
    a, b = body.semi_axes

    def rate(t: float, state: Any) -> tuple[float, float, float]:
        phi, spin, _ = state
        height = np.hypot(b * np.cos(phi), a * np.sin(phi))
        slope = (a * a - b * b) * np.sin(phi) * np.cos(phi) / height
        radius = (a * b) ** 2 / height**3
        inertia = body.inertia + body.mass * (height**2 + slope**2)
        moment = -body.mass * slope * (g + radius * spin * spin)
        return spin, moment / inertia, -height * spin

    start = (phi, 0.0, 0.0)
    return solve_ivp(rate, (0, until), start, method="DOP853", rtol=1e-12, atol=1e-12).y[:, -1]


def rocking(solver: SolvesQPs) -> list[Found]:
    """Angle, spin and way of an ellipse that rocks, and the energy that it has lost."""
    made = scene("rocking")
    known = rolled(made.bodies[0], float(made.q0[0, 2]), UNTIL)
    runs = [run_of(solver, "rocking", {"until": UNTIL, "fixed_step": h}) for h in STEPS]
    ends = [(run.q[-1, 0, 2], run.v[-1, 0, 2], run.q[-1, 0, 0]) for run in runs]
    names = ("angle after 1 s [rad]", "spin [rad/s]", "way [m]")
    rows = [
        found(name, value, exact, observed_order([abs(end[i] - exact) for end in ends]))
        for i, (name, value, exact) in enumerate(zip(names, ends[-1], known, strict=True))
    ]
    energy = runs[-1].kinetic_energy() + runs[-1].potential_energy()
    return [*rows, found("energy lost, of what it began with", 1 - energy[-1] / energy[0], 0.0)]
