"""What came of one call, before any judging."""

from __future__ import annotations

from dataclasses import dataclass

from problems.qp import Vector, WorkCounts

DISTURBED = "disturbed: "
"""What the status text begins with where it was not the solver's doing.  Such a row is not final:
it is tried again at once, and by whoever continues."""


@dataclass(frozen=True, eq=False)
class Outcome:
    """What came of one call, without the solver's memory.

    verdict : "skipped", "failed", "timeout" or "crashed" where that is settled before any judging,
        else None
    status : name of the solver's Status, empty if it was not reached
    warm_started : whether a start was handed over
    after_restart : whether this QP of the warm group has no predecessor
    """

    verdict: str | None
    x: Vector | None = None
    found: bool = False
    status: str = ""
    status_text: str = ""
    iterations: int | None = None
    work: WorkCounts | None = None
    warm_started: bool = False
    after_restart: bool = False
