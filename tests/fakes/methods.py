"""Names of what solves by algorithm 2: our method, the paper's and its variants."""

from __future__ import annotations

from harness.names import METHOD, PAPER
from solvers.active_set.lotstedt import Lotstedt

METHODS = (METHOD, PAPER, *(f"{PAPER}[{variant}]" for variant in Lotstedt.variants))
