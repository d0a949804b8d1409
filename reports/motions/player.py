"""A player of one recorded scene: a page that stands alone and shows what each step was made of.

1. Poses at the accepted steps, forces of the QP that belongs to each, its k and working set.
2. From stored rows, where there are some: its rank and the iterations of every backend.
3. Events as marks on the time line.

All of it is JSON in the page, rounded to `DIGITS`; `player.js` draws it, and `player_space.js` what
moves in space.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from problems.space.solids import Solid
from reports.motions.contact_forces import IMPULSE, Force, forces, qps_of_frames
from reports.motions.frames import window_of
from reports.motions.motion import Link, Motion, frame_times, motion_of
from reports.motions.space import AZIMUTH, ELEVATION, Stage, View, shape_of
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
    scripts = ["player_space.js", "player.js"] if "space" in data else ["player.js"]
    page = environment.get_template("player.html.j2").render(
        scene=data["scene"],
        home=home,
        left_out=data["left_out"],
        aspect=_aspect(*data["window"]),
        space="space" in data,
        **inlined(environment, style=["page.css", "player.css"], script=scripts),
        data=data,
    )
    return write_text(Path(path), page + "\n")


def _aspect(left: float, right: float, bottom: float, top: float) -> str:
    """Of the picture: that of the window, neither very flat nor very high."""
    return f"{min(max((right - left) / (top - bottom), 1.0), 4.0):.3g}"


def player_data(recording: Any, rows: pd.DataFrame | None = None) -> dict[str, Any]:
    """What the player shows, as JSON has it."""
    view = View.of(recording)
    bodies = len(recording.polygons) if view is None else len(view.solids)
    kept = _kept(len(recording.t), bodies)
    numbers = np.array(qps_of_frames(recording))[kept]
    if view is None:
        shown = _in_the_plane(recording, kept, numbers)
    else:
        shown = _in_space(view, kept)
    return {
        "scene": str(recording.scene),
        "left_out": len(recording.t) - len(kept),
        "colours": BODIES,
        **shown,
        "t": [float(t) for t in recording.t[kept]],
        "qps": [_qp(recording, int(n)) for n in numbers],
        "events": [[float(e.t), str(e.kind), str(e.detail)] for e in recording.events],
        **_work(rows, numbers),
    }


def _in_the_plane(recording: Any, kept: np.ndarray, numbers: np.ndarray) -> dict[str, Any]:
    """Bodies, what connects them, and the forces at their corners."""
    motion = motion_of(recording)
    window = window_of(motion, [motion.pose(t) for t in frame_times(motion, 40)])
    found = [_forces(recording, motion, i, n) for i, n in zip(kept, numbers, strict=True)]
    return {
        "window": _short([window.left, window.right, window.bottom, window.top]),
        "parts": [[_short(part) for part in parts] for parts in motion.polygons],
        "springs": _ends(motion.springs),
        "bars": _ends(motion.bars),
        "ground": [_short([*point, *normal]) for point, normal in motion.ground],
        "q": [_short(q.ravel()) for q in motion.q[kept]],
        "forces": [[_entry(force) for force in each] for each in found],
        "largest": _short(_largest(found)),
    }


def _in_space(view: View, kept: np.ndarray) -> dict[str, Any]:
    """Bodies as polyhedra and balls, and the sum of the forces on each."""
    stage = Stage.of(view, view.t[np.linspace(0, len(view.t) - 1, 40).round().astype(int)])
    sizes = np.linalg.norm(view.reactions[:, :, :3], axis=2)
    return {
        "window": _short(stage.limits.ravel()),
        "space": {
            "solids": [_solid(solid) for solid in view.solids],
            "pins": [[pin.body, *_short(pin.point)] for pin in view.pins],
            "lines": [_short(line.ravel()) for line in stage.lines],
            "eye": [AZIMUTH, ELEVATION],
            "middle": _short(view.poses[:, :, :3].mean(axis=(0, 1))),
        },
        "q": [_short(q.ravel()) for q in view.poses[kept]],
        "forces": [_short(forces[:, :3]) for forces in view.reactions[kept]],
        "largest": _short(float(np.percentile(sizes[sizes > 0], 98)) if sizes.any() else 1.0),
    }


def _solid(solid: Solid) -> dict[str, Any]:
    """A ball by its radius, another body by its corners and faces."""
    if solid.radius:
        return {"radius": _short(solid.radius)}
    corners, faces = shape_of(solid)
    return {"corners": _short(corners), "faces": faces}


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
