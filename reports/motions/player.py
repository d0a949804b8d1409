"""A player of one recorded scene: a page that stands alone and shows what each step was made of.

1. Poses at the accepted steps, forces of the QP that belongs to each, its k and working set.
2. From stored rows, where there are some: its rank and the iterations of every backend.
3. Events as marks on the time line.

All of it is JSON in the page, rounded to `DIGITS`; `player.js` draws it.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from reports.motions.contact_forces import IMPULSE, Force, forces, qps_of_frames
from reports.motions.frames import window_of
from reports.motions.motion import Link, Motion, frame_times, motion_of
from reports.parts.style import BODIES
from reports.parts.table import write_text
from reports.parts.templates import environment_of, inlined

DIGITS = 6
"""Significant ones of what is stored in a page."""
MOST = 60_000
"""Poses that a page holds; of more, steps are left out evenly."""
LETTERS = {-1: "L", 0: "F", 1: "U", 2: "P"}
"""Members of a working set: at the lower bound, free, at the upper bound, passive."""


def write_player(
    recording: Any, path: str | Path, rows: pd.DataFrame | None = None, home: str | None = None
) -> Path:
    """Write the player of a recording and return its path.

    rows : prepared rows of one setting and arm, one per backend and QP of this scene
    home : address of the page that it belongs to

    Raises ValueError where the recording holds no steps.
    """
    data = player_data(recording, rows)
    environment = environment_of()
    page = environment.get_template("player.html.j2").render(
        scene=data["scene"],
        home=home,
        left_out=data["left_out"],
        aspect=_aspect(*data["window"]),
        **inlined(environment, style=["page.css", "player.css"], script=["player.js"]),
        data=data,
    )
    return write_text(Path(path), page + "\n")


def _aspect(left: float, right: float, bottom: float, top: float) -> str:
    """Of the picture: that of the window, neither very flat nor very high."""
    return f"{min(max((right - left) / (top - bottom), 1.0), 4.0):.3g}"


def player_data(recording: Any, rows: pd.DataFrame | None = None) -> dict[str, Any]:
    """What the player shows, as JSON has it."""
    motion = motion_of(recording)
    kept = _kept(len(motion.t), len(motion.polygons))
    numbers = np.array(qps_of_frames(recording))[kept]
    window = window_of(motion, [motion.pose(t) for t in frame_times(motion, 40)])
    found = [_forces(recording, motion, i, n) for i, n in zip(kept, numbers, strict=True)]
    return {
        "scene": motion.label,
        "left_out": len(motion.t) - len(kept),
        "colours": BODIES,
        "window": _short([window.left, window.right, window.bottom, window.top]),
        "parts": [[_short(part) for part in parts] for parts in motion.polygons],
        "springs": _ends(motion.springs),
        "bars": _ends(motion.bars),
        "ground": [_short([*point, *normal]) for point, normal in motion.ground],
        "t": [float(t) for t in motion.t[kept]],
        "q": [_short(q.ravel()) for q in motion.q[kept]],
        "qps": [_qp(recording, int(n)) for n in numbers],
        "forces": [[_entry(force) for force in each] for each in found],
        "largest": _short(_largest(found)),
        "events": [[float(e.t), str(e.kind), str(e.detail)] for e in recording.events],
        **_work(rows, numbers),
    }


def _ends(links: Sequence[Link]) -> list[list[float]]:
    """Body, point, other body, −1 for the ground, and anchor of what connects two points."""
    return [[body, *_short(point), other, *_short(anchor)] for body, point, other, anchor in links]


def _kept(steps: int, bodies: int) -> np.ndarray:
    """The steps that a page holds, the first and the last among them."""
    count = min(steps, max(2, MOST // max(bodies, 1)))
    return np.unique(np.linspace(0, steps - 1, count).round().astype(int))


def _qp(recording: Any, number: int) -> list[Any] | None:
    """Number, kind, k and members of the working set."""
    if number < 0:
        return None
    qp, solution = recording.qps[number], recording.solutions[number]
    return [number, qp.kind, qp.k, "".join(LETTERS[int(s)] for s in solution.working_set)]


def _forces(recording: Any, motion: Motion, frame: int, number: int) -> list[Force]:
    if number < 0:
        return []
    qp, solution = recording.qps[number], recording.solutions[number]
    if solution.x is None:  # the solver gave no answer
        return []
    return forces(qp, solution, motion.q[frame], recording.polygons)


def _entry(force: Force) -> list[Any]:
    return [force.body, *_short([*force.at, *force.force]), force.state]


def _largest(found: Sequence[Sequence[Force]]) -> list[float]:
    """Forces and impulses that are drawn with the longest arrow: few are larger."""
    sizes: list[list[float]] = [[], []]
    for force in (each for frame in found for each in frame):
        sizes[force.state == IMPULSE].append(float(np.hypot(*force.force)))
    return [float(np.percentile(each, 98)) or 1.0 if each else 1.0 for each in sizes]


def _work(rows: pd.DataFrame | None, numbers: np.ndarray) -> dict[str, Any]:
    """Rank, and iterations by backend, of the QP of each frame; null where nobody stored it."""
    if rows is None or rows.empty:
        return {"rank": None, "iterations": {}}
    rows = rows.assign(qp=rows["problem"].str.rpartition("/")[2].astype(int))
    rank = rows.groupby("qp")["rank"].first()
    table = rows.pivot_table(index="qp", columns="solver", values="iterations", dropna=False)
    return {
        "rank": _whole(rank.reindex(numbers)),
        "iterations": {str(name): _whole(table[name].reindex(numbers)) for name in table.columns},
    }


def _whole(values: pd.Series) -> list[int | None]:
    return [None if pd.isna(value) else int(value) for value in values]


def _short(values: Any) -> Any:
    """Numbers of any nesting, with `DIGITS` digits."""
    if np.ndim(values):
        return [_short(value) for value in values]
    return float(f"{float(values):.{DIGITS}g}")
