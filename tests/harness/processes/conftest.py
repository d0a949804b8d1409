"""Whether somebody else keeps the machine busy must not decide how many passes a test sees."""

from __future__ import annotations

import pytest

from harness.machine.unrest import read
from harness.processes import isolate


@pytest.fixture(autouse=True)
def quiet(monkeypatch: pytest.MonkeyPatch) -> None:
    """No pass is disturbed: all readings are the first."""
    first = read()
    monkeypatch.setattr(isolate, "read", lambda pid: first)
