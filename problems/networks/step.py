"""One step of a network: its QP, and the currents that its multipliers give.

With the potentials u, the voltages λ of diodes and those of open switches as multipliers, a network
is (2.1) with currents for velocities and inductances for masses. Over a step of length h by BDF,

    α₀ i_n = h a_n + b^i,    α₀ q_n = h i_n + b^q,    L a_n = e_n + G λ − R i_n − q_n/C,

so that, with M = L + (h/α₀) R + (h/α₀)²/C, a diagonal matrix,

    i_n = (h/α₀) M⁻¹ (L b^i/h − b^q/(α₀ C) + e_n + G λ) = (h/α₀) D⁻¹ (A λ + d),   A = D⁻¹G,

and min ½‖A x + d‖² within the bounds is the QP (3.2) again: λ ≥ 0 for diodes, no bounds for nodes
(Kirchhoff's law of currents, which is bilateral) and for open switches.

This differs from the paper:
 1. R i is linear and diagonal, so it joins M instead of being iterated (3.9), and branches without
    inductance are allowed;
 2. charges are taken from the same BDF formula as currents and not from AB: a capacitor without
    inductance has no inertia, and an explicit charge would be unstable.
"""

from __future__ import annotations

from typing import NamedTuple, final

import numpy as np

from problems.formulas.multistep import asked_accuracy, second_order_bdf
from problems.networks.network import Network, State
from problems.qp import Indices, Vector
from problems.sequence import QPSequence


class Past(NamedTuple):
    """What a step goes on from: the last state, the one before it, and the step between [s].

    h is 0 right after a restart, and the step is of order 1
    """

    last: State
    before: State
    h: float

    def bdf(self, h: float) -> tuple[float, Vector, Vector]:
        """α₀, b^i and b^q of a step of length h, see the module."""
        if self.h == 0:
            return 1.0, self.last.i, self.last.q
        alpha0, one, two = second_order_bdf(h / self.h)
        b_i, b_q = (
            one * new - two * old for new, old in zip(self.last[:2], self.before[:2], strict=True)
        )
        return alpha0, b_i, b_q


class NetworkStep(NamedTuple):
    """A trial of length h [s] that ends at t with `state`.

    potentials : (nodes,) u;  diodes : (b,) λ, 0 without a diode
    free : (b,) i − (h/α₀) λ/M: the current that would flow but for the diode's own voltage, which
        changes its sign where the diode blocks
    """

    t: float
    h: float
    state: State
    potentials: Vector
    diodes: Vector
    free: Vector


@final
class NetworkQPs:
    """Poses and solves the QPs of a network's steps.

    Columns: nodes, diodes, open switches; `row_id` numbers all that there are, open or not.
    """

    def __init__(self, network: Network, qps: QPSequence, eps: float):
        self.network, self.qps = network, qps
        self.accuracy = asked_accuracy(eps, iterates=False)
        self.has_diode = np.array([branch.diode for branch in network.branches])
        self.L, self.R, self.S = network.array("L"), network.array("R"), 1 / network.array("C")
        nodes, each = network.incidence(), np.eye(len(network.branches))
        self.n, self.diodes = nodes.shape[1], int(self.has_diode.sum())
        self.columns = np.hstack([nodes, each[:, self.has_diode], each])

    def kept(self, t: float) -> Indices:
        """Columns of `columns` that a step which ends at t has."""
        opened = np.flatnonzero(self.network.open_switches(t))
        return np.concatenate([np.arange(self.n + self.diodes), self.n + self.diodes + opened])

    def step(self, t: float, h: float, past: Past) -> NetworkStep:
        """Solve the step of length h that ends at t."""
        alpha0, b_i, b_q = past.bdf(h)
        D = np.sqrt(self.L + (h / alpha0) * (self.R + (h / alpha0) * self.S))
        e = self.network.voltages(t)
        row_id = self.kept(t)
        G = self.columns[:, row_id]
        lower = np.full(row_id.size, -np.inf)
        lower[self.n : self.n + self.diodes] = 0.0
        _, solution = self.qps.solve(
            A=G / D[:, None],
            d=(self.L * b_i / h - self.S * b_q / alpha0 + e) / D,
            lower=lower,
            upper=np.full(row_id.size, np.inf),
            row_id=row_id,
            D=D,
            kind="step",
            t=t,
            h=h,
            alpha0=alpha0,
            eps0=self.accuracy,
        )
        assert solution.x is not None
        v = self.L * b_i / h - self.S * b_q / alpha0 + e + G @ solution.x
        i = (h / alpha0) * v / D**2
        q = (h * i + b_q) / alpha0
        lam = np.zeros_like(i)
        lam[self.has_diode] = solution.x[self.n : self.n + self.diodes]
        a = np.divide(alpha0 * i - b_i, h, out=np.zeros_like(i), where=self.L > 0)
        free = i - (h / alpha0) * lam / D**2
        return NetworkStep(t, h, State(i, q, a), solution.x[: self.n], lam, free)
