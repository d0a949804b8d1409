"""What the values of a stranger's shard must be, so that whoever reads rows need not ask.

Everybody who can seal a file can write any value of the right type.  Here is looked at what rows
are found, grouped and counted by; a number that was measured may be any that a measurement can be.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pyarrow as pa

from harness.files.sealed_parquet import Wrong
from harness.judging.facts import setting_name
from harness.judging.judge import VERDICTS
from harness.machine.unrest import Unrest
from harness.passes.starts import EVERY_ARM
from harness.recordings.recording import PROOFS
from problems.qp import KINDS, Status, Vector

KNOWN = ("problem", "found", "step", "verdict")
"""Columns in which no value may be missing."""
CHOICES: dict[str, tuple[str, ...]] = {
    "kind": KINDS,
    "verdict": VERDICTS,
    "proof": ("", *PROOFS),
    "status": ("", *Status.__members__),
}
"""What texts there may be."""
LARGEST = 2**53
"""Counts beyond this are none: float64 does not tell them from their neighbours."""


def check_key(key: Any, wrong: Wrong) -> None:
    """Raise `wrong(what)` for a key that no replay makes."""
    for name in ("scene", "solver"):
        if not (getattr(key, name) and getattr(key, name).isprintable()):
            raise wrong(f"its {name} {getattr(key, name)[:60]!r} is no name")
    try:
        known = setting_name(key.settings) == key.settings
    except ValueError:
        known = False
    if not known:
        raise wrong(f"its setting {key.settings[:60]!r} is unknown")
    if key.arm not in EVERY_ARM:
        raise wrong(f"its arm {key.arm[:60]!r} is unknown")
    for name in ("time_limit", "memory_limit"):
        if not 0 < getattr(key, name) < np.inf:
            raise wrong(f"its {name} is {getattr(key, name)}")


def check_rows(scene: str, rows: pa.Table, wrong: Wrong) -> None:
    """Raise `wrong(what)` for rows that no replay of a recording of this scene makes."""
    for name in KNOWN:
        if rows[name].null_count:
            raise wrong(f"column {name} lacks a value")
    for name, choices in CHOICES.items():
        unknown = {*rows[name].unique().to_pylist()} - {None, *choices}
        if unknown:
            raise wrong(f"column {name} holds {min(unknown)[:60]!r}, which is unknown")
    named = [f"{scene}/{step:06d}" for step in rows["step"].to_pylist()]
    if rows["problem"].to_pylist() != named or len({*named}) < len(named):
        raise wrong("column problem is not the scene and the step of each row, once")
    for field in rows.schema:
        if field.type != pa.int64():
            continue
        least = -1 if field.name == "rank" else 0  # a rank that nobody knows
        counts = rows[field.name].drop_null().to_numpy()
        if counts.size and not least <= counts.min() <= counts.max() < LARGEST:
            raise wrong(f"column {field.name} holds what is no count")


def check_times(passes: Vector, rows: pa.Table, wrong: Wrong) -> None:
    """Raise `wrong(what)` for times (passes, n, times) [s] that no clock shows; NaN: not run."""
    if (passes < 0).any() or np.isinf(passes).any():
        raise wrong("holds a time that is negative or infinite")
    verified = np.array(rows["verdict"].to_pylist()) == "verified"
    if np.isnan(rows["runtime"].to_numpy()[verified]).any():
        raise wrong("column runtime lacks the time of an answer that was verified")
    if not np.isfinite(rows["t"].drop_null().to_numpy()).all():
        raise wrong("column t holds what is no time of a motion")


def check_unrest(said: Any, count: int, wrong: Wrong) -> list[Unrest]:
    """What a shard says of the unrest in its passes.

    Raises `wrong(what)` for what no reading gives.
    """
    if not isinstance(said, list) or len(said) != count:
        raise wrong(f"does not tell the unrest of its {count} passes")
    found = []
    for values in said:
        if not isinstance(values, list) or len(values) != len(Unrest._fields):
            raise wrong(f"the unrest of a pass needs {', '.join(Unrest._fields)}")
        numbers = [np.nan if value is None else value for value in values]
        if not all(
            type(number) in (int, float) and not abs(number) == np.inf for number in numbers
        ):
            raise wrong("the unrest of a pass is no list of numbers")
        found.append(Unrest(*map(float, numbers)))
    return found
