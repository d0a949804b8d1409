"""Whether somebody else keeps the machine busy must not decide how many passes a test sees."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from harness.machine.unrest import read
from harness.processes import isolate


@pytest.fixture(autouse=True, scope="module")
def quiet() -> Iterator[None]:
    """No pass is disturbed: all readings are the first."""
    first = read()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(isolate, "read", lambda pid: first)
        yield
