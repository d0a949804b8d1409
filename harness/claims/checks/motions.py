"""Runs that checks share."""

from __future__ import annotations

from functools import cache
from typing import Any

from problems import ContactQP, Run, scene, simulate
from solvers import make_solver


@cache
def run_of(label: str, until: float, **parameters: Any) -> Run:
    """A scene with these parameters, by our method, its QPs kept."""
    return simulate(scene(label, **parameters), make_solver("glambda"), until=until)


def qps_of(run: Run, kind: str) -> list[ContactQP]:
    """Its QPs of a kind that have columns."""
    return [qp for qp in run.qps if qp.kind == kind and qp.k > 0]
