"""Which backends are expected to miss A x*, on which scene, how often and why.

A miss is a row of `glambda verify` that is neither verified nor skipped: the error in A x exceeds
ten times the accuracy asked.  The counts are the measured ones at the time of writing; `glambda
verify` fails where a count rises.  A count that falls is an invitation to lower it here.
"""

from __future__ import annotations

from typing import NamedTuple

ACCURATE_CLASS = ("lotstedt", "velocity", "enumeration", "scipy_bvls", "daqp", "quadprog")
"""Never to miss once, on any recording."""


class Expected(NamedTuple):
    """Expected misses of one backend: (scene, setting) → count, and why."""

    counts: dict[tuple[str, str], int]
    reason: str


EXPECTED: dict[str, Expected] = {}
"""By the name of the backend; one that is not listed is expected to miss nothing."""

SCENES = ("fig2", "fig3", "fig4", "fig5")
"""Scenes that the counts are for.  On others only the accurate class is held to anything."""
