"""Minimum-norm multipliers (4.8): what an old decomposition with conjugate gradients is worth."""

from __future__ import annotations

from functools import cache
from typing import Any

from harness.claims.checking import check
from harness.claims.checks.motions import run_of
from harness.criterion.minimum_norm_ways import case_rows, redundant, way_rows
from harness.study.record import recording_of


@cache
def _rows(label: str) -> Any:
    """Rows of both ways on a recording."""
    _, _, cases = redundant(recording_of(run_of(label, 1.5), "glambda"))
    return case_rows(cases), way_rows(cases)


@check
def old_over_printed(label: str, against: str = "per_step") -> float:
    """Flops of old decompositions with conjugate gradients, at the interval that is best for them.

    label : a scene with redundant QPs
    against : "per_step", over those of (4.8) with one QR per time step; "always", over those of a
        decomposition that is new at every QP
    """
    printed, ways = _rows(label)
    kept = ways[ways["way"] == "kept"].groupby("interval")["flops"].mean()
    base = printed["per_step"].mean() if against == "per_step" else kept[1.0]
    return float(kept.min() / base)
