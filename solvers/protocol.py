"""One page per package, generated from its adapter, that could be mailed to its maintainer.

It tells what is measured: the version, what is called and how (the adapter's own words), and, for
towers of boxes of several sizes, the form that is posed and every setting that is not the package's
default, at 1e-9 of the force asked.
"""

from __future__ import annotations

import inspect
import sys
from collections.abc import Iterator
from typing import Any

import numpy as np
import scipy.sparse as sp
from tabulate import tabulate

from problems.qp import ContactQP
from solvers.adapters.package import PackageSolver
from solvers.base import Unsupported
from solvers.registry import describe, make_solver, solver_class

BOXES = 4, 15, 50, 200
DENSE = 60
"""Columns up to which A is dense, as the stepper hands it over."""
RELATIVE = 1e-9


def protocol(name: str) -> str:
    """The page of the solver called `name`, in Markdown.

    Raises ValueError for an unknown name and ImportError where its package is absent.
    """
    cls, info = solver_class(name), describe(name)
    module = inspect.getdoc(sys.modules[cls.__module__]) or ""
    facts = [
        ("package", f"{info.package} {info.version}"),
        ("warm start", info.warm_start),
        ("regularisation", info.regularisation),
        ("timed", "setup + solve, one thread, arrays ready; build, the package's own clock and the "
                  "whole call beside it"),
    ]  # fmt: skip
    parts = [
        f"# {name}",
        info.summary,
        tabulate(facts, headers=["", ""], tablefmt="github"),
        "## How it is called",
        module,
        f"The calls themselves are in `{cls.__module__.replace('.', '/')}.py`.",
    ]
    if issubclass(cls, PackageSolver):
        rows = [row for boxes in BOXES for row in _rows(name, boxes)]
        columns = ["columns", "A", "bounds", "form", "settings"]
        parts += [
            f"## Settings at {RELATIVE:g} of the force",
            tabulate(rows, headers=columns, tablefmt="github"),
        ]
    return "\n\n".join(parts) + "\n"


def _rows(name: str, boxes: int) -> Iterator[tuple[Any, ...]]:
    """What is posed for a tower, with x ≥ 0 alone and with friction."""
    for bounds in ("x ≥ 0", "friction"):
        qp = tower_qp(boxes, friction=bounds == "friction")
        solver = make_solver(name, accuracy=RELATIVE * float(np.linalg.norm(qp.d)))
        assert isinstance(solver, PackageSolver)
        stored = "CSC" if sp.issparse(qp.A) else "dense"
        try:
            built = solver.build(qp, None)
        except Unsupported as reason:
            yield qp.k, stored, bounds, "declined", str(reason)
            continue
        yield qp.k, stored, bounds, built.posed.form or solver.form, _told(built.options)


def tower_qp(boxes: int, *, friction: bool) -> ContactQP:
    """A tower of unit boxes at rest under its weight: two normals, and a tangent, per interface."""
    A = np.zeros((3 * boxes, (2 + friction) * boxes))
    arms = [(0.0, 1.0, -0.5), (0.0, 1.0, 0.5), (1.0, 0.0, 0.5)][: 2 + friction]
    for i in range(boxes):
        for j, column in enumerate(arms):
            place = len(arms) * i + j
            A[3 * i : 3 * i + 3, place] = np.array(column) * (1.0, 1.0, 6.0**0.5)
            if i:
                below = np.array(column) * (-1.0, -1.0, (1.0 if j == 2 else -1.0) * 6.0**0.5)
                A[3 * i - 3 : 3 * i, place] = below
    d = np.tile([0.0, -9.81, 0.0], boxes)
    tangent = np.arange(A.shape[1]) % len(arms) == 2
    lower, upper = np.where(tangent, -5.0, 0.0), np.where(tangent, 5.0, np.inf)
    return ContactQP(A if A.shape[1] <= DENSE else sp.csc_array(A), d, lower, upper)


def _told(options: Any) -> str:
    """Settings as `name value`; of an object, those that are not its defaults."""
    if options is None:
        return "none"
    if not isinstance(options, dict):
        default = type(options)()
        names = [name for name in dir(options) if not name.startswith("_")]
        options = {
            name: getattr(options, name)
            for name in names
            if not callable(getattr(options, name))
            and getattr(options, name) != getattr(default, name)
        }
    return ", ".join(f"`{name}` {_number(value)}" for name, value in options.items())


def _number(value: Any) -> str:
    return f"{value:.3g}" if isinstance(value, float) else str(value)
