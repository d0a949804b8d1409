"""No number stands in README.md by itself: each is a claim's, a published one, or kept in code.

Nor does any of the words that claim something, `CLAIMING`, stand there without a claim.

A number is digits, or a word for one.  Each must stand within words of README.md that are

1. the source of a claim of the manifest, and be in the claim's range or one of its parameters; or
2. in `STORED`, and agree with what is published; or
3. in `KEPT`, and equal a number that the code goes by; or
4. in `EXEMPT`, with a reason.

The first screen of the page has none that is typed: all are made from what is stored.
"""

from __future__ import annotations

import ast
import re
import tomllib
from collections.abc import Callable, Iterable
from functools import partial
from math import isclose, prod
from pathlib import Path

import pandas as pd
import pytest

from benchmarks.work_counts import ALLOWED
from harness.claims.manifest import Entry, read_manifest
from harness.judging.facts import ASKED_RELATIVE
from problems import scene, scene_names
from solvers.base import Solver

ROOT = Path(__file__).parents[2]
README = (ROOT / "README.md").read_text(encoding="utf-8")
PUBLISHED = ROOT / "reports/published"
SOURCE = "README.md: "

STAGES = Solver.__abstractmethods__
WORDS = {"two": 2.0, "three": 3.0, "four": 4.0, "five": 5.0, "six": 6.0, "seven": 7.0}
WORDS |= {"eight": 8.0, "nine": 9.0, "ten": 10.0, "eleven": 11.0, "twelve": 12.0, "twenty": 20.0}
MANY = {"hundred": 100.0, "hundreds": 100.0, "thousand": 1000.0, "thousands": 1000.0}
FEW = "|".join(WORDS)
TIMES = "|".join(MANY)
NUMBER = re.compile(
    rf"""(?<![\w.–-])(?:
        \d[\d,]*(?:\.\d+)?(?:e-?\d+)?
        |(?:(?:tens\ of|{FEW})\ )?(?:{TIMES})\b
        |(?:{FEW})\b
        |an?\ (?:second|minute|hour)\b
    )""",
    re.I | re.X,
)
CLAIMING = re.compile(r"\b(?:faster|alone|surviv\w+|caught|bit for bit|proved|never|none holds)\b")
NO_PROSE = (
    r"^```.*?^```$",  # blocks of code
    r"^    [^\n]*$",
    r"`[^`]*`",
    r"\]\([^)]*\)",  # where links lead
    r"\(\d\.\d+\)|figure \d|section \d|algorithm \d",  # of the paper
)


def prose() -> tuple[str, str]:
    """README.md with single spaces, and the same with "_" for all that is no prose."""
    masked = README
    for pattern in NO_PROSE:
        masked = re.sub(
            pattern, lambda found: re.sub(r"\S", "_", found[0]), masked, flags=re.M | re.S
        )
    plain, hidden = (re.sub(r"\s+", " ", text) for text in (README, masked))
    assert len(plain) == len(hidden)
    return plain, hidden


def value(number: str) -> float:
    """Of "1e-9", "20,000", "ten", "an hour" or "twenty thousand"; "tens of" counts as ten."""
    if number[0].isdigit():
        return float(number.replace(",", ""))
    words = {**WORDS, **MANY, "tens": 10.0}
    return prod(words.get(word, 1.0) for word in number.lower().split())


def values(words: str) -> list[float]:
    """All numbers in some words."""
    return [value(found[0]) for found in NUMBER.finditer(words)]


def of_steps() -> list[float]:
    """µs of a step alone, of the paper's scenes of boxes."""
    rows = (line.split("│") for line in (PUBLISHED / "steps.txt").read_text().splitlines())
    return [float(row[5]) for row in rows if len(row) > 5 and row[1].strip() in BOXES]


def of_growth() -> list[float]:
    """The fewest and the most columns whose time is published."""
    k = pd.read_csv(PUBLISHED / "growth/growth.csv")["k"]
    return [float(k.min()), float(k.max())]


def of_the_race(clock: str) -> list[float]:
    """By a clock, time of the best package over ours on the paper's scenes, in published races."""
    table = race_ratios()
    of_paper = table["scene"].str.fullmatch(r"fig\d") & (table["clock"] == clock)
    return [float(ratio) for ratio in table.loc[of_paper, "ratio"]]


def race_ratios() -> pd.DataFrame:
    """All published races."""
    return pd.concat(map(pd.read_csv, sorted(PUBLISHED.glob("race*/race_ratios.csv"))))


def where_a_race_is_lost() -> list[float]:
    """The most columns of a recording on which a package is faster by some clock."""
    table = race_ratios()
    return [float(table.loc[table["ratio"] < 1.0, "k"].max())]


def option(script: str, name: str) -> float:
    """Default of an option of a script."""
    (found,) = re.findall(rf'"--{name}", type=int, default=(\d+)', (ROOT / script).read_text())
    return float(found)


def oldest_python() -> float:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    return float(project["requires-python"].removeprefix(">="))


def packages() -> list[str]:
    setuptools = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["setuptools"]
    return list(setuptools["packages"]["find"]["include"])


def of_the_paper() -> float:
    return float(sum(re.fullmatch(r"fig\d", name) is not None for name in scene_names()))


def thousands(number: float) -> float:
    """1000 where "thousands" may be said of a number."""
    return 1000.0 if number >= 2000.0 else 0.0


BOXES = ("fig2", "fig4", "fig5")
STORED: dict[str, Callable[[], list[float]]] = {
    "at 45 to 90 µs each on the paper's scenes of boxes": of_steps,
    "time per QP from ten columns to twenty thousand": of_growth,
    "inside the package it takes 0.37 to 1.7 times as long as ours": partial(
        of_the_race, "inside the package"
    ),
    "the best package takes 1.1 to 1.8 times as long": partial(of_the_race, "from A, d and bounds"),
    "On 60 to 90 columns a package is still ahead by one clock": where_a_race_is_lost,
}
"""Words → numbers that are published, which must lie between those of the words."""
KEPT: dict[str, Callable[[], float]] = {
    "Three boxes topple": lambda: len(scene("fig4").bodies),
    "the first of three boxes": lambda: len(scene("fig4").bodies),
    "five boxes piled up": lambda: len(scene("fig2").bodies),
    "a box on two boxes": lambda: len(scene("fig5").bodies) - 1,
    "1e-9 of ‖A A⁺d‖": lambda: ASKED_RELATIVE["high"],
    "nothing but Python ≥ 3.11": oldest_python,
    "its parts are four packages": lambda: len(packages()) - 1,
    "Four scenes": of_the_paper,
    "apart from the four scenes": of_the_paper,
    "on the four scenes and on families": of_the_paper,
    "with the four stages": lambda: len(STAGES),
    "over 5 % more work": lambda: 100.0 * ALLOWED,
    "dropped in a heap, a thousand times": lambda: option("tests/endurance/heaps.py", "count"),
    "a thousand collisions of": lambda: option("tests/endurance/collisions.py", "count"),
    "(thousands of damaged": lambda: thousands(option("tests/endurance/fuzz.py", "files")),
}
"""Words → the number that the code goes by."""
EXEMPT: dict[str, str] = {
    "by Lötstedt's 1984 method": "when the paper was printed",
    "a paper of 1984": "when the paper was printed",
    "Computing 5 (1984) 370–393": "where the paper was printed",
    "pushes two bodies": "what a contact is",
    "## Two commands": "they stand below it",
    "`make check` runs, in under a minute,": "a time of one machine; it tells its own at every run",
    "names, in under three hours": "a time of one machine; it tells its own at every run",
    "0 fine, 1 a judged failure or a motion that cannot go on, 2 bad input, 130 interrupted": (
        "tests/front/test_cli.py and test_streams.py hold exit codes"
    ),
}
"""Words → why their numbers need no run."""
ENTRIES = {
    entry.source.removeprefix(SOURCE): entry
    for entry in read_manifest()
    if entry.source.startswith(SOURCE)
}
"""Words → the claim that they are the source of."""


def alone(pattern: re.Pattern[str], known: Iterable[str]) -> list[str]:
    """Where the pattern is found in prose, but not within known words."""
    plain, hidden = prose()
    spans = [(i, i + len(words)) for words in known if (i := plain.find(words)) >= 0]
    return [
        plain[max(0, found.start() - 60) : found.end() + 40]
        for found in pattern.finditer(hidden)
        if not any(first <= found.start() and found.end() <= last for first, last in spans)
    ]


def test_every_number_is_a_claim_or_published_or_kept_or_exempt() -> None:
    found = alone(NUMBER, [*ENTRIES, *STORED, *KEPT, *EXEMPT])
    assert not found, "numbers without a claim (harness/claims/claims.toml):\n" + "\n".join(found)


def test_every_word_that_claims_is_in_a_claim() -> None:
    found = alone(CLAIMING, ENTRIES)
    assert not found, "words without a claim (harness/claims/claims.toml):\n" + "\n".join(found)


def test_the_first_screen_has_no_number_that_is_typed() -> None:
    tree = ast.parse((ROOT / "reports/page/headlines.py").read_text(encoding="utf-8"))
    texts = [node.value for node in ast.walk(tree)
             if isinstance(node, ast.Constant) and isinstance(node.value, str)]  # fmt: skip
    assert len(texts) > 50 and not [text for text in texts if re.search(r"\d", text)]


@pytest.mark.parametrize("words", [*STORED, *KEPT, *EXEMPT])
def test_words_stand_once_and_have_a_number(words: str) -> None:
    plain, _ = prose()
    assert plain.count(words) == 1 and values(words), words


@pytest.mark.parametrize("words", ENTRIES)
def test_numbers_of_a_sentence_are_those_of_its_claim(words: str) -> None:
    entry: Entry = ENTRIES[words]
    given = [float(v) for v in entry.parameters.values() if isinstance(v, int | float)]
    for number in values(words):
        assert entry.holds(number) or number in given, f"{entry.id}: {number:g} in {words!r}"


@pytest.mark.parametrize("words", STORED)
def test_published_numbers_are_between_those_of_the_sentence(words: str) -> None:
    low, high = values(words)
    found = STORED[words]()
    assert found and all(low <= number <= high for number in found), f"{words}: {found}"


def test_where_races_are_lost_by_what_a_user_waits_for_is_named() -> None:
    table = race_ratios()
    lost = table[(table["ratio"] < 1.0) & (table["clock"] == "from A, d and bounds")]
    assert set(lost["scene"] + " " + lost["arm"]) == {"mujoco_pile cold"}
    assert "on a pile of MuJoCo's, cold, less than ours" in prose()[0]


@pytest.mark.parametrize("words", KEPT)
def test_numbers_that_are_kept_in_code_are_those_of_the_sentence(words: str) -> None:
    (number,) = values(words)
    assert isclose(number, KEPT[words]()), words


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("by 1e-10 m, 20,000 or 3.11", [1e-10, 2e4, 3.11]),
        ("two scenes, twenty thousand, tens of thousands, an hour", [2.0, 2e4, 1e4, 1.0]),
        ("AB-1/AB-2, HDF5, BSD-3-Clause and someone", []),
    ],
)
def test_numbers_are_read(text: str, found: list[float]) -> None:
    assert values(text) == found
