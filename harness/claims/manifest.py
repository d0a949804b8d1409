"""The manifest `claims.toml`: what is claimed, by whom, how it is checked, what must make it fail.

    [[claim]]
    id = "prop2"                    # small letters, digits, "." and "-"; the folder of its rows
    short = "…"                     # one line of the table
    says = "…"                      # the claim, in our words
    source = "proposition 2"        # equation or section of the paper, or "README.md: a sentence"
    check = "contraction.worst"     # harness/claims/checks/contraction.py, def worst
    with = { scene = "fig2" }       # its parameters
    figure = 0.97                   # as measured
    range = [0.0, 1.0]              # what it may be, and
    reason = "…"                    # why
    disposition = "confirmed"       # refuted, conditional, retracted
    claimed = [0.0, 1.0]            # what the source has, where that is a range
    condition = "…"                 # of a conditional claim; what stands instead of a retracted one
    control = { power = 2 }         # parameters with which the figure must leave the range, and
    fails = "…"                     # why it must
    slow = true                     # left out unless asked for

The words and numbers must agree with each other (`Entry`): a figure is in its range, what is
confirmed is within what is claimed, and what is refuted is apart from it.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

MANIFEST = Path(__file__).with_name("claims.toml")
DISPOSITIONS = ("confirmed", "refuted", "conditional", "retracted")
LONGEST_SHORT = 48
"""Characters of what the table says of a claim."""
TEXTS = ("id", "short", "says", "source", "check", "reason", "disposition", "fails")
NUMBERS = ("figure", "range")
TABLES = ("control",)
OPTIONAL = ("with", "claimed", "condition", "slow")

Parameters = Mapping[str, str | float | int | bool]


@dataclass(frozen=True)
class Entry:
    """A claim of the manifest; fields as in the module's list, `parameters` those of `with`.

    Raises ValueError, naming the claim and the field, for what is missing, of the wrong kind or at
    odds with another field.
    """

    id: str
    short: str
    says: str
    source: str
    check: str
    figure: float
    range: tuple[float, float]
    reason: str
    disposition: str
    control: Parameters
    fails: str
    parameters: Parameters
    claimed: tuple[float, float] | None = None
    condition: str = ""
    slow: bool = False

    def __post_init__(self) -> None:
        if not re.fullmatch(r"[a-z0-9][a-z0-9.-]*", self.id):
            self._wrong("id", "takes small letters, digits, dots and dashes")
        if len(self.short) > LONGEST_SHORT:
            self._wrong("short", f"has {len(self.short)} characters; at most {LONGEST_SHORT}")
        if self.disposition not in DISPOSITIONS:
            self._wrong("disposition", f"must be one of {', '.join(DISPOSITIONS)}")
        if not self.control:
            self._wrong("control", "is empty; name parameters for which the check must fail")
        if dict(self.parameters) == {**self.parameters, **self.control}:
            self._wrong("control", "changes nothing; name parameters for which the check must fail")
        if not self.holds(self.figure):
            self._wrong("figure", f"is outside the range {self.limits}; measure it again")
        self._agree()

    def _agree(self) -> None:
        """What is said and what is claimed fit together."""
        if self.disposition in ("conditional", "retracted") and not self.condition:
            self._wrong("condition", f"is missing; say under which a {self.disposition} one holds")
        if self.claimed is None:
            if self.disposition in ("refuted", "retracted"):
                self._wrong("claimed", f"is missing; say what was {self.disposition}, as a range")
            return
        (low, high), (least, most) = self.range, self.claimed
        if self.disposition == "confirmed" and not (least <= low and high <= most):
            self._wrong("range", f"is not within what is claimed, {_limits(self.claimed)}")
        if self.disposition == "refuted" and not (high < least or low > most):
            self._wrong("range", f"meets what is claimed, {_limits(self.claimed)}: not refuted")

    def _wrong(self, field: str, what: str) -> None:
        raise ValueError(f"claim {self.id!r}: {field} {what}")

    @property
    def arms(self) -> dict[str, Parameters]:
        """Parameters of the check and of its control."""
        return {"claim": self.parameters, "control": {**self.parameters, **self.control}}

    @property
    def limits(self) -> str:
        """The range as it is printed."""
        return _limits(self.range)

    def holds(self, figure: float) -> bool:
        """Whether a figure is in the range; NaN is not."""
        return self.range[0] <= figure <= self.range[1]


def read_manifest(path: Path = MANIFEST) -> list[Entry]:
    """The claims of a manifest, in order.

    Raises ValueError, naming file, claim, field and remedy, for whatever is wrong with it.
    """
    try:
        content = tomllib.loads(path.read_text(encoding="utf-8"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ValueError(f"{path}: is no TOML: {error}") from None
    tables = content.pop("claim", None)
    if content or not isinstance(tables, list) or not tables:
        extra = f"; remove {', '.join(content)}" if content else ""
        raise ValueError(f"{path}: holds [[claim]] tables, one at least, and nothing else{extra}")
    try:
        entries = [_entry(number, table) for number, table in enumerate(tables, 1)]
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None
    ids = [entry.id for entry in entries]
    twice = next((one for one in ids if ids.count(one) > 1), None)
    if twice is not None:
        raise ValueError(f"{path}: claim {twice!r}: id stands twice; give each its own")
    return entries


def chosen(entries: Sequence[Entry], ids: Sequence[str]) -> list[Entry]:
    """Those whose id is one of `ids` or begins with one and a dash; all where there is none.

    Raises ValueError for an id that no claim has.
    """
    for wanted in ids:
        if not any(_is(entry, wanted) for entry in entries):
            known = ", ".join(entry.id for entry in entries)
            raise ValueError(f"claim {wanted!r} is not in the manifest; it has: {known}")
    return [entry for entry in entries if not ids or any(_is(entry, one) for one in ids)]


def _is(entry: Entry, wanted: str) -> bool:
    return entry.id == wanted or entry.id.startswith(f"{wanted}-")


def _entry(number: int, table: Any) -> Entry:
    name = f"claim {table.get('id', number)!r}" if isinstance(table, dict) else f"claim {number}"
    if not isinstance(table, dict):
        raise ValueError(f"{name}: must be a table; begin it with [[claim]]")
    for field in (*TEXTS, *NUMBERS, *TABLES):
        if field not in table:
            raise ValueError(f"{name}: {field} is missing; every claim needs one")
    for field, value in table.items():
        _check_field(name, field, value)
    fields = {field: value for field, value in table.items() if field not in ("with", "range")}
    claimed = fields.pop("claimed", None)
    low, high = table["range"]
    return Entry(
        **{**fields, "figure": float(fields["figure"])},
        range=(float(low), float(high)),
        claimed=None if claimed is None else (float(claimed[0]), float(claimed[1])),
        parameters=table.get("with", {}),
    )


def _check_field(name: str, field: str, value: Any) -> None:
    """Raise ValueError for a field that there is not, or a value of the wrong kind."""
    wanted = ""
    if field in (*TEXTS, "condition"):
        wanted = "" if isinstance(value, str) and value.strip() else "a text"
    elif field == "figure":
        wanted = "" if _is_number(value) else "a number"
    elif field in ("range", "claimed"):
        two = isinstance(value, list) and len(value) == 2 and all(map(_is_number, value))
        wanted = "" if two and value[0] <= value[1] else "two numbers, the lower one first"
    elif field in ("with", "control"):
        flat = isinstance(value, dict) and all(map(_is_scalar, value.values()))
        wanted = "" if flat else "a table of numbers, texts and truth values"
    elif field == "slow":
        wanted = "" if isinstance(value, bool) else "true or false"
    else:
        known = ", ".join((*TEXTS, *NUMBERS, *TABLES, *OPTIONAL))
        raise ValueError(f"{name}: {field} is no field of a claim; it has {known}")
    if wanted:
        raise ValueError(f"{name}: {field} = {value!r}; it must be {wanted}")


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and value == value


def _is_scalar(value: Any) -> bool:
    return isinstance(value, str | int | float)


def _limits(limits: tuple[float, float]) -> str:
    return "{:.4g} … {:.4g}".format(*limits)
