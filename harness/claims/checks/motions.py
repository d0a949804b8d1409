"""Runs that checks share."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from typing import Any, TypeVar

import numpy as np

from problems import ContactQP, Run, scene, simulate
from solvers import make_solver

Item = TypeVar("Item")


@cache
def run_of(label: str, until: float, **parameters: Any) -> Run:
    """A scene with these parameters, by our method, its QPs kept."""
    return simulate(scene(label, **parameters), make_solver("glambda"), until=until)


def qps_of(run: Run, kind: str) -> list[ContactQP]:
    """Its QPs of a kind that have columns."""
    return [qp for qp in run.qps if qp.kind == kind and qp.k > 0]


def evenly(items: Sequence[Item], count: int) -> list[Item]:
    """So many of them, from the first to the last."""
    return [items[i] for i in np.linspace(0, len(items) - 1, count).astype(int)]
