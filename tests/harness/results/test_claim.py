"""Rows of a claim: stored unit by unit, continued, and refused where they are another's."""

from __future__ import annotations

from math import inf, nan
from pathlib import Path
from typing import Any

import pandas as pd
import pytest

from harness.results.claim import Claim, Row, measure
from harness.results.store import StoreError

UNITS = [{"scene": "fig2", "eps": 1e-3}, {"scene": "wall,bodies=3", "eps": 0.1 + 0.2}]


def rows_of(scene: str, eps: float) -> pd.DataFrame:
    """A row of every type, NaN, ∞ and -0 among them."""
    return pd.DataFrame(
        {
            "what": ["γ", "", "a, b"],
            "value": [eps, nan, -inf],
            "zero": [0.0, -0.0, 1e-300],
            "n": [1, -2, 2**40],
            "right": [True, False, True],
        }
    )


def told(unit: Any) -> pd.DataFrame:
    """The rows of a unit, behind what it names."""
    rows = rows_of(**unit)
    return rows.assign(**unit)[["scene", "eps", *rows]]


def claim(rows: Any = rows_of) -> Claim:
    return Claim("it", rows, UNITS)


def never(**_: Any) -> pd.DataFrame:
    raise AssertionError("measured again")


def test_rows_are_given_back_as_they_were(tmp_path: Path) -> None:
    found = measure([claim()], tmp_path)["it"]
    expected = pd.concat([told(unit) for unit in UNITS], ignore_index=True)
    pd.testing.assert_frame_equal(found, expected, check_exact=True)
    assert str(found["zero"][1]) == "-0.0"


def test_a_unit_may_have_no_rows(tmp_path: Path) -> None:
    def first_only(scene: str, eps: float) -> pd.DataFrame:
        return rows_of(scene, eps)[: 3 if scene == "fig2" else 0]

    def nothing(scene: str, eps: float) -> list[Row]:
        return []

    found = measure([claim(first_only), Claim("none", nothing, UNITS)], tmp_path)
    pd.testing.assert_frame_equal(found["it"], told(UNITS[0]))
    assert found["none"].empty and list(found["none"]) == ["scene", "eps"]


def test_what_is_there_is_not_measured_again(tmp_path: Path) -> None:
    asked: list[str] = []

    def interrupted(scene: str, eps: float) -> pd.DataFrame:
        asked.append(scene)
        if len(asked) == 2:
            raise KeyboardInterrupt
        return rows_of(scene, eps)

    with pytest.raises(KeyboardInterrupt):
        measure([claim(interrupted)], tmp_path)
    shown: list[tuple[str, float, float]] = []
    measure([claim(interrupted)], tmp_path, lambda *what: shown.append(what))
    assert asked == ["fig2", "wall,bodies=3", "wall,bodies=3"]
    assert shown == [("it: wall,bodies=3", 1, 2)]
    again = measure([Claim("it", never, UNITS)], tmp_path)["it"]
    assert len(again) == 6


@pytest.mark.parametrize("changed", ["problems", "glambda", "harness", "machine"])
def test_rows_of_other_code_or_another_machine_are_refused(tmp_path: Path, changed: str) -> None:
    measure([claim()], tmp_path)
    other = claim()
    other.made_by[changed] = "another"
    with pytest.raises(StoreError, match=f"made with {changed} .*may not be mixed"):
        measure([other], tmp_path)


def test_rows_of_another_unit_are_refused(tmp_path: Path) -> None:
    first = claim()
    measure([first], tmp_path)
    first.path(tmp_path, UNITS[1]).rename(first.path(tmp_path, UNITS[0]))
    with pytest.raises(StoreError, match="made with unit"):
        measure([claim()], tmp_path)


def test_a_damaged_file_is_refused(tmp_path: Path) -> None:
    measure([claim()], tmp_path)
    path = claim().path(tmp_path, UNITS[0])
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 1
    path.write_bytes(content)
    with pytest.raises(StoreError, match=r"seal is missing or wrong.*delete it and run again"):
        measure([claim()], tmp_path)
