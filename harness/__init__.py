"""Record, replay, judge, measure, store: `from harness import judge, record, replay`.

They are loaded on first use, so that the command line starts at once.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from harness.judging.judge import judge as judge
    from harness.study.record import record as record
    from harness.study.replay import replay as replay

ROOMS = {"judge": "judging", "record": "study", "replay": "study"}
"""Function → package with a module of its name."""
__all__ = ["judge", "record", "replay"]


def __getattr__(name: str) -> Any:
    if name not in ROOMS:
        raise AttributeError(f"module 'harness' has no attribute {name!r}")
    return getattr(importlib.import_module(f"harness.{ROOMS[name]}.{name}"), name)
