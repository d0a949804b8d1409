"""When to factorize anew: the paper's cost model, §3.2, from counts alone.

T calls of algorithm 2 with n factorizations cost, with s steps since the last one and c s^r
conjugate gradient iterations per call,

    C(n) = C_QR n + C_0 T + c C_IT T^{r+1} n^{−r}/(r + 1),

least at the interval s* = T/n* = ((r + 1)/r · C_QR/(c C_IT))^{1/(r+1)}.  So A_F is factorized anew
when a solve needs more than c s*^r iterations; for c = r = 1, the paper's choice, that is
√(2 C_QR/C_IT).  (The printed C(n) has n^{r+1} − n^{−r}; the printed optimum follows from the form
above.)

C_QR and C_IT are counted from the sizes of A_F at the reference solution of each recorded QP, by
the formulas that the paper's method counts its own work with (`solvers.active_set.flops`).
"""

from __future__ import annotations

from dataclasses import dataclass
from math import inf

import numpy as np

from harness.recording import Recording
from problems.sequence import WARM_KINDS
from solvers.active_set.flops import cg_iteration_flops, qr_flops


@dataclass(frozen=True)
class Criterion:
    """Counted costs of one recording and what the model makes of them.

    calls : T, QPs that continue a sequence and have a free column at their reference
    rows, free : medians of m and of the number f of columns of A_F
    C_QR, C_IT : means over the calls [flops]; 0 where there are no calls
    """

    scene: str
    calls: int
    rows: float
    free: float
    C_QR: float
    C_IT: float

    @property
    def threshold(self) -> float:
        """√(2 C_QR/C_IT): more iterations than this ask for a new factorization."""
        return threshold(self.C_QR, self.C_IT) if self.calls else 0.0

    @property
    def cost_per_call(self) -> float:
        """C(n*)/T − C_0 for c = r = 1 [flops]."""
        if not self.calls:
            return 0.0
        return cost_per_call(optimal_interval(self.C_QR, self.C_IT), self.C_QR, self.C_IT)


def optimal_interval(C_QR: float, C_IT: float, c: float = 1.0, r: float = 1.0) -> float:
    """s*: calls from one factorization to the next at which C(n) is least; inf for r = 0.

    Raises ValueError for costs or c that are not positive, or a negative r.
    """
    _check(C_QR, C_IT, c, r)
    if r == 0:
        return inf
    return float(((r + 1) / r * C_QR / (c * C_IT)) ** (1 / (r + 1)))


def threshold(C_QR: float, C_IT: float, c: float = 1.0, r: float = 1.0) -> float:
    """c s*^r: a solve that needs more iterations than this calls for a new factorization."""
    interval = optimal_interval(C_QR, C_IT, c, r)
    return inf if interval == inf else c * interval**r


def cost_per_call(
    interval: float, C_QR: float, C_IT: float, c: float = 1.0, r: float = 1.0, C_0: float = 0.0
) -> float:
    """C(n)/T for n = T/interval [flops]: C_QR/s + C_0 + c C_IT s^r/(r + 1).

    Raises ValueError for an interval that is not positive and as `optimal_interval` does.
    """
    _check(C_QR, C_IT, c, r)
    if not interval > 0:
        raise ValueError(f"interval = {interval}; it must be positive")
    if interval == inf:
        return C_0 + c * C_IT if r == 0 else inf
    return C_QR / interval + C_0 + c * C_IT * interval**r / (r + 1)


def criterion_of(recording: Recording) -> Criterion:
    """Count C_QR and C_IT over the time-step QPs of a recording.

    QPs without an accepted reference, or with no free column, are left out: no R is made for them.
    """
    sizes = []
    for qp, reference in zip(recording.qps, recording.references, strict=True):
        if qp.kind not in WARM_KINDS or reference is None:
            continue
        free = (reference.x > qp.lower) & (reference.x < qp.upper)
        # Columns that the free ones already span would be passive: R does not hold them.
        f = int(np.linalg.matrix_rank(qp.dense_A[:, free])) if free.any() else 0
        if f:
            sizes.append((qp.m, f))
    if not sizes:
        return Criterion(recording.scene, 0, 0.0, 0.0, 0.0, 0.0)
    rows, columns = np.median(np.array(sizes), axis=0)
    return Criterion(
        scene=recording.scene,
        calls=len(sizes),
        rows=float(rows),
        free=float(columns),
        C_QR=float(np.mean([qr_flops(m, f) for m, f in sizes])),
        C_IT=float(np.mean([cg_iteration_flops(m, f) for m, f in sizes])),
    )


def _check(C_QR: float, C_IT: float, c: float, r: float) -> None:
    if not (C_QR > 0 and C_IT > 0 and c > 0 and r >= 0):
        raise ValueError(
            f"C_QR = {C_QR}, C_IT = {C_IT}, c = {c} must be positive and r = {r} not negative"
        )
