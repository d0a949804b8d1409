"""Tolerances of the packages that are reached through another one (CVXPY, qpsolvers).

Each entry makes the package's own options of the KKT residual and the duality gap that the accuracy
asked for allows (`Posed.residual_tolerance`, `Posed.gap_tolerance`); no residual below 1e-12 is
asked for.  HiGHS is left as it is, with 1e-7 on the diagonal of P: see its adapter for
what goes wrong without it.  quadprog has no options.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from solvers.adapters.forms import Posed

OPTIONS: dict[str, Callable[[float, float], dict[str, Any]]] = {
    "proxqp": lambda residual, gap: {
        "eps_abs": residual,
        "eps_rel": 0.0,
        "check_duality_gap": True,
        "eps_duality_gap_abs": max(gap, 1e-13),
        "eps_duality_gap_rel": 0.0,
    },
    "clarabel": lambda residual, gap: {
        "tol_feas": residual,
        "tol_gap_abs": max(gap, 1e-13),
        "tol_gap_rel": 0.0,
    },
    "osqp": lambda residual, gap: {"eps_abs": residual, "eps_rel": 0.0, "max_iter": 20_000},
    "scs": lambda residual, gap: {"eps_abs": residual, "eps_rel": 0.0, "max_iters": 20_000},
    "piqp": lambda residual, gap: {
        "eps_abs": residual,
        "eps_rel": 0.0,
        "eps_duality_gap_abs": max(gap, 1e-14),
        "eps_duality_gap_rel": 0.0,
    },
    "daqp": lambda residual, gap: {
        "primal_tol": residual,
        "dual_tol": residual,
        "eta_prox": 1e-14,
    },
    "highs": lambda residual, gap: {},
    "quadprog": lambda residual, gap: {},
}


def inner_options(variant: str, posed: Posed, asked: float) -> dict[str, Any]:
    """Options of the package `variant` for an error of `asked` in ‖A δx‖."""
    return OPTIONS[variant](posed.residual_tolerance(asked, 1e-12), posed.gap_tolerance(asked, 0.0))


def check_variant(outer: str, variant: str, known: tuple[str, ...]) -> None:
    """Raise ValueError for a package that `outer` is not used with here."""
    if variant not in known:
        raise ValueError(f"{outer}[{variant}] is unknown; choose one of {', '.join(known)}")
