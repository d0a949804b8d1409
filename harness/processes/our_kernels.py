"""Imported by the server of all processes before it makes one that solves: the machine code of our
method is loaded, or made, once for all of them.

Whoever is only asked what a solver is (`measured.introduce`) needs none of it.
"""

from __future__ import annotations

from solvers.active_set.method import compile_dense

compile_dense()
