"""Which solvers there are, by the names of the command line.

A built-in solver is one line of `BUILT_IN`; a third party adds one by an entry point of the group
`glambda.solvers`, `name = "module:Class"`; a script adds one by `register`.  Nothing is imported
until it is asked for.  A solver whose package is absent is listed with the import error; a package
that is there but broken fails loudly.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import cache
from importlib import metadata
from typing import Any

from problems.registry import load, unknown, with_plug_ins
from solvers.base import Solver

BUILT_IN = {
    "glambda": "solvers.active_set.glambda:Glambda",
    "lotstedt": "solvers.active_set.lotstedt:Lotstedt",
    "velocity": "solvers.baselines.velocity:Velocity",
    "enumeration": "solvers.baselines.enumeration:Enumeration",
    "pgs": "solvers.baselines.pgs:ProjectedGaussSeidel",
    "scipy_bvls": "solvers.adapters.scipy_bvls:ScipyBVLS",
    "scipy_nnls": "solvers.adapters.scipy_nnls:ScipyNNLS",
    "osqp": "solvers.adapters.osqp:OSQP",
    "proxqp": "solvers.adapters.proxqp:ProxQP",
    "clarabel": "solvers.adapters.clarabel:Clarabel",
    "daqp": "solvers.adapters.daqp:DAQP",
    "quadprog": "solvers.adapters.quadprog:Quadprog",
    "piqp": "solvers.adapters.piqp:PIQP",
    "highs": "solvers.adapters.highs:HiGHS",
    "scs": "solvers.adapters.scs:SCS",
    "qpoases": "solvers.adapters.casadi:QpOASES",
    "qrqp": "solvers.adapters.casadi:Qrqp",
    "nncg": "solvers.adapters.nncg:NNCG",
    "cvxpy": "solvers.adapters.cvxpy:CVXPY",
    "qpsolvers": "solvers.adapters.qpsolvers:QPSolvers",
}
"""Name → module:class.  `name[variant]` passes `variant` to the class."""

_REGISTERED: dict[str, str] = {}
"""What `register` was given."""


@dataclass(frozen=True)
class SolverInfo:
    """One line of `glambda solvers`."""

    name: str
    available: bool
    reason: str
    package: str = ""
    version: str = ""
    form: str = ""
    warm_start: str = ""
    regularisation: str = ""
    variants: str = ""
    summary: str = ""


@cache
def _targets() -> dict[str, str]:
    return with_plug_ins("solver", BUILT_IN)


def register(name: str, target: str) -> None:
    """Make the solver at `target`, "module:Class", known as `name` in this process.

    It goes before a built-in one of the same name.  A process that is to run it as well must be
    able to import the module.
    """
    _REGISTERED[name] = target


def target_of(name: str) -> str:
    """Where the class of the solver called `name` (a variant in brackets is ignored) is found.

    Raises ValueError for an unknown name.
    """
    base, _ = _split(name)
    targets = {**_targets(), **_REGISTERED}
    if base not in targets:
        raise unknown("solver", name, targets)
    return targets[base]


def _split(name: str) -> tuple[str, str | None]:
    base, bracket, rest = name.partition("[")
    if bracket and not rest.endswith("]"):
        raise ValueError(f"solver name {name!r} lacks its closing bracket")
    return base, rest[:-1] if bracket else None


def solver_class(name: str) -> type[Solver]:
    """Class of the solver called `name` (a variant in brackets is ignored).

    Raises ValueError for an unknown name and ImportError where its package is absent.
    """
    target = target_of(name)
    cls = load(target)
    if not (isinstance(cls, type) and issubclass(cls, Solver)):
        raise ImportError(f"{target} is not a class derived from solvers.base.Solver")
    return cls


def make_solver(name: str, **options: Any) -> Solver:
    """Make the solver called `name`, such as "daqp", "lotstedt[exact_qr]" or "qpsolvers[osqp]".

    Raises ValueError for an unknown name or option and ImportError where its package is absent.
    """
    cls = solver_class(name)
    base, variant = _split(name)
    known = [entry.name for entry in fields(cls) if entry.init]
    if variant is not None:
        if "variant" not in known:
            raise ValueError(f"solver {base!r} has no variants; got {name!r}")
        options = {"variant": variant, **options}
    unknown = sorted(set(options) - set(known))
    if unknown:
        raise ValueError(
            f"solver {base!r} has no option {unknown[0]!r}; its options are: {', '.join(known)}"
        )
    return cls(**options)


def distribution_of(cls: type[Solver]) -> str:
    """Who does the work: the package that a solver names, or the one whose entry point it is."""
    if cls.package:
        return cls.package
    target = f"{cls.__module__}:{cls.__qualname__}"
    if target in BUILT_IN.values():
        return "glambda"
    for entry in metadata.entry_points(group="glambda.solvers"):
        if entry.value == target and entry.dist is not None:
            return entry.dist.name
    return "glambda"


def describe(name: str) -> SolverInfo:
    """What `glambda solvers` says about one solver; an absent package is reported, not raised."""
    try:
        cls = solver_class(name)
    except ImportError as error:
        return SolverInfo(name, False, str(error))
    package = distribution_of(cls)
    return SolverInfo(
        name=name,
        available=True,
        reason="",
        package=package,
        version=metadata.version(package),
        form=cls.form,
        warm_start=cls.warm_start,
        regularisation=cls.regularisation,
        variants=", ".join((*cls.variants, *cls.forms)),
        summary=(cls.__doc__ or "no description").strip().splitlines()[0],
    )


def solver_names() -> list[str]:
    """Names of all known solvers, built-in and plugged in, whether or not they can be imported."""
    return list({**_targets(), **_REGISTERED})


def available_solvers() -> list[str]:
    """Names of the solvers that can be used here."""
    return [name for name in solver_names() if describe(name).available]


def form_variants() -> list[str]:
    """Names of the installed packages in each form that they can be posed: "osqp[normal]", …"""
    names = available_solvers()
    return [f"{name}[{form}]" for name in names for form in solver_class(name).forms]
