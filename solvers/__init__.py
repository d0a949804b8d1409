"""QP → Solution: the paper's method, our own and off-the-shelf backends behind one interface."""

from solvers.base import Solver, Unsupported
from solvers.registry import available_solvers, describe, make_solver, solver_names

__all__ = [
    "Solver",
    "Unsupported",
    "available_solvers",
    "describe",
    "make_solver",
    "solver_names",
]
