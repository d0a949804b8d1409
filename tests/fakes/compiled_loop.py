"""A closed loop whose process looks where its machine code was kept."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from harness.motions.loop import Loop, run_loop
from harness.motions.loop_store import write_loop


def run_and_look(loop: Loop, folder: Path, told: Callable[[float], None]) -> None:
    """Run the loop; the reason of its result names what was compiled into its own folder."""
    result = run_loop(loop, told)
    compiled = sorted(path.name for path in folder.rglob("*.nb[ci]"))
    write_loop(folder, replace(result, reason=" ".join(compiled)[:200]))
