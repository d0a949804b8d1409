"""The words that rows and labels are written in."""

from __future__ import annotations

METHOD = "glambda"
"""Our own method, the default everywhere."""
PAPER = "lotstedt"
"""The paper's method; its variants are called `lotstedt[variant]`."""

DISTURBED = ",disturbed="
"""What the label of a recording made by `glambda disturb` contains, before what was done."""
STRETCHED = ",condition="
"""The same of one made by `glambda stretch`."""

NOT_KNOWN = "not known"
"""Version of a solver that cannot be imported."""


def is_own(name: str) -> bool:
    """Whether `name` is our method, the paper's or a variant: those whose work is counted."""
    return name.partition("[")[0] in (METHOD, PAPER)
