"""Record, replay, judge, measure, store; the command line.

    from harness import judge, record, replay

Each of the three is a function and lives in a module of the same name.  They are loaded on first
use, so that the command line starts at once, and they stay functions whichever is imported first.
"""

from __future__ import annotations

import importlib
import sys
from types import ModuleType
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from harness.judge import judge as judge
    from harness.record import record as record
    from harness.replay import replay as replay

__all__ = ["judge", "record", "replay"]


class _Harness(ModuleType):
    """The package: `harness.judge` is the function, also after `harness/judge.py` was imported."""

    def __getattr__(self, name: str) -> Any:
        if name in __all__:
            return getattr(importlib.import_module(f"harness.{name}"), name)
        raise AttributeError(f"module 'harness' has no attribute {name!r}")

    def __setattr__(self, name: str, value: Any) -> None:
        # Importing the submodule would bind its name here and hide the function.
        if not (name in __all__ and isinstance(value, ModuleType)):
            super().__setattr__(name, value)


sys.modules[__name__].__class__ = _Harness
