"""What is told of progress where there is no terminal."""

from __future__ import annotations

import io

import pytest
from rich.console import Console

from harness import progress


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """A clock that is set."""
    now = [0.0]
    monkeypatch.setattr(progress.time, "monotonic", lambda: now[0])
    return now


def test_lines_come_now_and_then_with_what_is_left(clock: list[float]) -> None:
    out = io.StringIO()
    with progress.shown("study", Console(file=out, width=200), minutes=3) as tell:
        tell("kernels", 1, 2)
        clock[0] = 100.0
        tell("kernels", 1, 2)
        tell("kernels", 2, 2)
        clock[0] = 110.0
        tell("runs", 0, 10)  # begins anew
        clock[0] = 170.0
        tell("runs", 2, 10)
        clock[0] = 171.0
        tell("runs", 3, 10)
        clock[0] = 400.0
        tell("runs", 9, 10)
    assert out.getvalue().splitlines() == [
        "study: by default some 3 minutes on two cores",
        "study: 50 % kernels, some 2 min left",
        "study: 20 % runs, some 4 min left",
        "study: 90 % runs",
    ]


def test_a_terminal_has_a_bar() -> None:
    out = io.StringIO()
    with progress.shown("study", Console(file=out, force_terminal=True, width=100)) as tell:
        tell("runs", 1, 2)
    assert "study" in out.getvalue() and "min left" not in out.getvalue()
