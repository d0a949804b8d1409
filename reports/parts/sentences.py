"""Sentences: lists, ordinals, answers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass


@dataclass(frozen=True)
class Answer:
    """A question of the study and what its numbers say.

    figure : the one number worth setting large, with its unit;  caption : what it is a number of
    sentences : the answer;  anchor : section of the page with the evidence
    """

    question: str
    figure: str
    caption: str
    sentences: Sequence[str]
    anchor: str


def join(names: Sequence[str], most: int = 6) -> str:
    """ "a, b and c"; beyond `most` names the rest is counted."""
    names = list(names)
    if len(names) > most:
        names = [*names[: most - 1], f"{len(names) - most + 1} others"]
    if len(names) < 2:
        return "".join(names)
    return ", ".join(names[:-1]) + " and " + names[-1]


def ordinal(number: int) -> str:
    """1 → 1st, 2 → 2nd, 3 → 3rd, 11 → 11th."""
    last = number % 10 if number % 100 not in (11, 12, 13) else 0
    return f"{number}{ {1: 'st', 2: 'nd', 3: 'rd'}.get(last, 'th') }"
