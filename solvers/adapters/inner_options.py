"""Tolerances of the packages that are reached through another one (CVXPY, qpsolvers).

Each entry makes the package's own options of the KKT residual and the duality gap that the accuracy
asked for allows (`Posed.residual_tolerance`, `Posed.gap_tolerance`); no residual below 1e-12 is
asked for.  The reasons are in the packages' own adapters.  HiGHS is left as it is, with 1e-7 on the
diagonal of P: see its adapter for what goes wrong without it.  quadprog has no options.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from solvers.adapters.posed import Posed

NEVER = 1e-14
"""OSQP's and ProxQP's bound for certificates of infeasibility: no QP here is infeasible."""


def last_step(n: int, size: float = 0.0) -> float:
    """The proximal step of DAQP that is the last one, for n unknowns x of that `size`.

    The step is a residual, P x + q + λ.  P has entries up to 4, so that 4 n u `size` is what
    rounding makes of P x.  Never looser than DAQP's own, 1e-6.
    """
    return min(1e-15 * n * max(100.0, size), 1e-6)


Gap = Callable[[float], float]
"""The duality gap that is allowed, not below a floor."""

OPTIONS: dict[str, Callable[[Posed, float, Gap], dict[str, Any]]] = {
    "proxqp": lambda posed, residual, gap: {
        "eps_abs": residual,
        "eps_rel": 0.0,
        "check_duality_gap": True,
        "eps_duality_gap_abs": gap(1e-13),
        "eps_duality_gap_rel": posed.gap_share,
    },
    "clarabel": lambda posed, residual, gap: {
        "tol_feas": residual,
        "tol_gap_abs": gap(1e-13),
        "tol_gap_rel": posed.gap_share,
    },
    "osqp": lambda posed, residual, gap: {
        "eps_abs": residual,
        "eps_rel": 0.0,
        "eps_prim_inf": NEVER,
        "eps_dual_inf": NEVER,
        "max_iter": 20_000,
    },
    "scs": lambda posed, residual, gap: {"eps_abs": residual, "eps_rel": 0.0, "max_iters": 20_000},
    "piqp": lambda posed, residual, gap: {
        "eps_abs": residual,
        "eps_rel": 0.0,
        "eps_duality_gap_abs": gap(1e-14),
        "eps_duality_gap_rel": posed.gap_share,
    },
    "daqp": lambda posed, residual, gap: {
        "primal_tol": residual,
        "dual_tol": residual,
        "eta_prox": last_step(posed.n) * posed.force,
    },
    "highs": lambda posed, residual, gap: {},
    "quadprog": lambda posed, residual, gap: {},
}


def inner_options(variant: str, posed: Posed, asked: float) -> dict[str, Any]:
    """Options of the package `variant` for an error of `asked` in ‖A δx‖."""
    residual = posed.residual_tolerance(asked, 1e-12)
    return OPTIONS[variant](posed, residual, lambda floor: posed.gap_tolerance(asked, floor))


def check_variant(outer: str, variant: str, known: tuple[str, ...]) -> None:
    """Raise ValueError for a package that `outer` is not used with here."""
    if variant not in known:
        raise ValueError(f"{outer}[{variant}] is unknown; choose one of {', '.join(known)}")
