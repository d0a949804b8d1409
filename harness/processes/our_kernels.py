"""Imported by the server of all processes before it makes one that solves: the machine code of our
method, and of what makes a QP's A dense, is loaded, or made, once for all of them.

Whoever is only asked what a solver is (`measured.introduce`) needs none of it.
"""

from __future__ import annotations

from problems.kernels.spread import compile_spread
from solvers.active_set.method import compile_dense

compile_dense()
compile_spread()
