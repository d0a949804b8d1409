"""The list of what is where: every file is there, and names the equations that it is listed for."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
ROWS = re.findall(
    r"^\| (.+?) \| .*`([\w/]+\.py)` \|$", (ROOT / "docs" / "where.md").read_text(), re.MULTILINE
)


@pytest.mark.parametrize(("what", "file"), ROWS)
def test_what_is_listed_is_there(what: str, file: str) -> None:
    text = (ROOT / file).read_text(encoding="utf-8")
    for equation in re.findall(r"\(\d\.\d+\)", what):
        # (4.2) also as part of such as (4.2a)
        assert re.search(re.escape(equation[:-1]) + r"[a-c]?\)", text), f"{equation} in {file}"


def test_the_list_is_read() -> None:
    assert len(ROWS) > 20
