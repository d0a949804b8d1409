"""What a solver says of itself: its arms, forms, versions; or why it cannot be had.

One of ours is asked here.  A stranger's is imported in a process of its own (`measured.introduce`),
whatever that does: it may crash, hang, leave, change folder, signals, rounding or the judge, and
has then changed those of a process that ends.  What it says is text, and is cut short.
"""

from __future__ import annotations

import json
import time
from dataclasses import asdict
from functools import cache
from typing import Any, NamedTuple

from harness.machine.machine import version_of
from harness.names import NOT_KNOWN
from harness.passes.starts import EVERY_ARM, has_arm
from harness.processes.process import Process, ServerLost
from solvers.registry import (
    BUILT_IN,
    SolverInfo,
    describe,
    make_solver,
    solver_names,
    target_of,
)

IMPORTING = 30.0
"""[s] that importing a solver may take."""
LONGEST = 1 << 16
"""Bytes that a solver may say of itself."""
LENGTH = 300
"""Characters of a text that are kept."""
NO_IMPORT = "cannot be imported: "
"""What the reason begins with where a solver is broken."""
RAISED: dict[str, type[Exception]] = {"ValueError": ValueError, "ImportError": ImportError}
"""What is raised as it would be if the solver were imported here."""


class About(NamedTuple):
    """arms, forms : that it has;  version : of its package and of the code around it

    raises : name of the error where it cannot be made: of `RAISED`, or "broken": its import or its
        making ends the process, or takes for ever;  reason : in words
    """

    info: SolverInfo
    version: str = NOT_KNOWN
    arms: tuple[str, ...] = ()
    forms: tuple[str, ...] = ()
    raises: str = ""
    reason: str = ""

    @property
    def broken(self) -> bool:
        """Whether it is there, and cannot be used."""
        return self.raises == "broken"


def is_stranger(name: str) -> bool:
    """Whether a solver is none of ours.  Raises ValueError for an unknown name."""
    return target_of(name) not in BUILT_IN.values()


def about(name: str, **options: Any) -> About:
    """What a solver says, made with these options.

    Raises ValueError for an unknown name or option and ImportError where its package is absent; one
    that is `broken` is told.
    """
    found = _about(name, target_of(name), tuple(options.items()))
    if found.raises in RAISED:
        raise RAISED[found.raises](found.reason)
    return found


@cache
def _about(name: str, target: str, options: tuple[tuple[str, Any], ...]) -> About:
    if target in BUILT_IN.values():
        return _read(name, said_of(name, dict(options)))
    arguments = {"solver": name, "target": target, "options": dict(options)}
    try:
        process = Process(
            "harness.processes.measured:introduce", arguments, ("harness.processes.measured",)
        )
    except ServerLost:
        return _broken(name, "the server of all processes is gone")
    try:
        return _heard(name, process)
    finally:
        process.kill()


def forget() -> None:
    """Ask anew: what stands behind a name has changed."""
    _about.cache_clear()


def said_of(solver: str, options: dict[str, Any]) -> dict[str, Any]:
    """What a solver that is imported here says of itself, or the error where it cannot be made."""
    try:
        made = type(make_solver(solver, **options))
        return {
            "raises": "",
            "info": asdict(describe(solver)),
            "version": version_of(made),
            "arms": [arm for arm in EVERY_ARM if has_arm(made, arm)],
            "forms": made.forms,
        }
    except ImportError as error:
        return {"raises": "ImportError", "reason": str(error)}
    except ValueError as error:
        return {"raises": "ValueError", "reason": str(error)}


def _heard(name: str, process: Process) -> About:
    said, ends = b"", time.monotonic() + IMPORTING
    while len(said) < LONGEST and time.monotonic() < ends:
        try:
            more = process.link.recv(LONGEST)
        except TimeoutError:
            continue
        except OSError:
            more = b""
        if more:
            said += more
            continue
        try:
            return _read(name, json.loads(said))
        except (ValueError, TypeError, AttributeError, RecursionError):
            return _broken(name, process.cause_of_death()[1])
    return _broken(name, f"its import took more than {IMPORTING:g} s{process.words.last()}")


def _broken(name: str, why: str) -> About:
    why = f"{NO_IMPORT}{why}"
    return About(SolverInfo(name, False, why), raises="broken", reason=why)


def _read(name: str, said: dict[str, Any]) -> About:
    """What was said, as texts of a limited length."""

    def text(what: Any) -> str:
        return "".join(c if c.isprintable() else " " for c in str(what)[:LENGTH])

    if said["raises"]:
        reason = text(said["reason"])
        info = SolverInfo(name, False, reason)
        return About(info, raises=text(said["raises"]), reason=reason)
    told = {key: text(value) for key, value in said["info"].items() if key not in _GIVEN}
    return About(
        SolverInfo(name, True, "", **told),
        text(said["version"]),
        tuple(map(text, said["arms"])),
        tuple(map(text, said["forms"])),
    )


_GIVEN = ("name", "available", "reason")


def solver_version(name: str) -> str:
    """Version of a solver: its package's, and a hash of the source around it.

    Raises as `about` does.
    """
    return about(name).version


def described(name: str) -> SolverInfo:
    """What `glambda solvers` says about one solver; whatever is wrong with it is the reason."""
    try:
        return about(name).info
    except ImportError as error:
        return SolverInfo(name, False, str(error))


def available() -> list[str]:
    """Names of the solvers that can be used here."""
    return [name for name in solver_names() if described(name).available]


def form_variants() -> list[str]:
    """Names of the installed packages in each form that they can be posed: "osqp[normal]", …"""
    return [f"{name}[{form}]" for name in available() for form in about(name).forms]
