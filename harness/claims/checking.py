"""Checks: functions of named parameters that measure one figure, known by "file.function".

A check stands in `harness.claims.checks` under `@check`.  It is run twice for a claim of the
manifest: with the claim's parameters, and with those of its negative control, an input for which
the figure must leave its range.
"""

from __future__ import annotations

import inspect
import time
from collections.abc import Callable, Iterator
from functools import wraps
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NamedTuple

from harness.claims.manifest import Entry, Parameters
from harness.names import METHOD, PAPER
from harness.progress import Progress
from harness.results.claim import Claim, Row
from harness.results.store import StoreError

Check = Callable[..., float]
HOME = "harness.claims.checks"
CLAIM, CONTROL = "claim", "control"
"""The two arms of an entry."""

_CHECKS: dict[str, Check] = {}


def check(function: Check) -> Check:
    """Register a check; what it is called with comes from the manifest."""
    _CHECKS[f"{function.__module__.removeprefix(HOME + '.')}.{function.__name__}"] = function
    return function


def check_named(name: str) -> Check:
    """The check "file.function".  Raises ValueError for one that is not registered."""
    file, _, _ = name.partition(".")
    if file.isidentifier() and find_spec(f"{HOME}.{file}") is not None:
        import_module(f"{HOME}.{file}")
    if name not in _CHECKS:
        there = ", ".join(other for other in sorted(_CHECKS) if other.startswith(f"{file}."))
        raise ValueError(
            f"{name!r} is no check; " + (f"{file}.py has {there}" if there else f"see {HOME}")
        )
    return _CHECKS[name]


def refuse_unknown(entry: Entry) -> None:
    """Raise ValueError, naming claim and field, for a check or parameters that there are not."""
    try:
        known = inspect.signature(check_named(entry.check)).parameters
    except ValueError as error:
        raise ValueError(f"claim {entry.id!r}: check = {error}") from None
    for field, given in (("with", entry.parameters), ("control", entry.control)):
        for name in given:
            if name not in known:
                raise ValueError(
                    f"claim {entry.id!r}: {field} has {name!r}, which {entry.check} does not take; "
                    f"it takes {', '.join(known)}"
                )


class Outcome(NamedTuple):
    """What came of an entry: its figure, that of its control (NaN: none), and what is wrong.

    seconds : of both;  wrong : "" where the claim stands as the manifest says
    ran : False where the entry was left out
    """

    entry: Entry
    figure: float
    control: float
    seconds: float
    wrong: str
    ran: bool = True


def judged(entry: Entry, figure: float, control: float) -> str:
    """What is wrong, or ""; a figure that is no number is wrong on either side."""
    if not entry.holds(figure):
        return f"its figure {figure:.4g} is outside {entry.limits}"
    if control != control:
        return "its negative control gave no number"
    if entry.holds(control):
        return f"its negative control passes: {control:.4g} is within {entry.limits}"
    return ""


def run(
    entries: list[Entry], folder: Path, slow: bool = False, progress: Progress | None = None
) -> Iterator[Outcome]:
    """Run entries, in order, and store their rows; slow ones only if asked.

    A slow one that is left out counts by the rows that are in the folder, of the same code.
    """
    for i, entry in enumerate(entries):
        if progress is not None:
            progress(entry.id, i, len(entries))
        yield outcome(entry, folder) if slow or not entry.slow else kept(entry, folder)


def outcome(entry: Entry, folder: Path) -> Outcome:
    """Run an entry and its control."""
    rows: dict[str, Row] = {}
    for arm, parameters in entry.arms.items():
        try:
            rows[arm] = _measured(entry, arm, parameters, folder)
        except Exception as error:
            said = f"its {'check' if arm == CLAIM else 'negative control'} raised "
            return Outcome(entry, *_figures(rows), f"{said}{type(error).__name__}: {error}")
    found = _figures(rows)
    return Outcome(entry, *found, judged(entry, found[0], found[1]))


def kept(entry: Entry, folder: Path) -> Outcome:
    """What the folder holds of an entry."""
    rows: dict[str, Row] = {}
    for arm, parameters in entry.arms.items():
        try:
            there = _stored(entry, arm, parameters).load(folder, _unit(arm, parameters))
        except StoreError:
            there = None
        if there is not None:
            rows[arm] = there.iloc[0].to_dict()
    found = _figures(rows)
    if len(rows) < len(entry.arms):
        return Outcome(entry, *found, "it was not run", ran=False)
    return Outcome(entry, *found, judged(entry, found[0], found[1]))


def _figures(rows: dict[str, Row]) -> tuple[float, float, float]:
    """Figure, control and seconds."""
    nothing = {"figure": float("nan"), "seconds": 0.0}
    one, other = rows.get(CLAIM, nothing), rows.get(CONTROL, nothing)
    return one["figure"], other["figure"], one["seconds"] + other["seconds"]


def _measured(entry: Entry, arm: str, parameters: Parameters, folder: Path) -> Row:
    """The row of one arm, stored and read back."""
    unit, claim = _unit(arm, parameters), _stored(entry, arm, parameters)
    claim.store(folder, unit)
    rows = claim.load(folder, unit)
    assert rows is not None
    row: Row = rows.iloc[0].to_dict()
    return row


def _unit(arm: str, parameters: Parameters) -> dict[str, Any]:
    return {"arm": arm, **parameters}


def _stored(entry: Entry, arm: str, parameters: Parameters) -> Claim:
    """How an arm is measured and stored."""
    function = check_named(entry.check)

    @wraps(function)
    def timed(arm: str, **parameters: Any) -> list[Row]:
        began = time.perf_counter()
        figure = float(function(**parameters))
        return [{"figure": figure, "seconds": time.perf_counter() - began}]

    return Claim(entry.id, timed, [_unit(arm, parameters)], solvers=(METHOD, PAPER))
