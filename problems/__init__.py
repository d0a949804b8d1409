"""Physics → quadratic programs: bodies, contacts, the stepper and its scenes."""

from problems.qp import ContactQP, Solution, Status

__all__ = ["ContactQP", "Solution", "Status"]
