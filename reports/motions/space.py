"""Bodies in space, seen from aside: frames on a sheet, and an animation.

A parallel view from above and one side.  Faces are painted from the farthest to the nearest; a ball
shows two of its great circles, so that one sees it turn, and a body without a shape is drawn as the
box of its mass and moments.  Planes are grids.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from problems.space.attitude import rotations
from problems.space.run import SpaceRun
from problems.space.scene import Pin, Plane, SpaceScene
from problems.space.solids import SIGNS, Solid
from reports.motions.film import film
from reports.motions.motion import made_again
from reports.parts.style import BODIES, FAINT, INK, PAGE_WIDTH, drawing, save

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Array = NDArray[np.float64]

AZIMUTH, ELEVATION = -0.9, 0.35
"""Of the eye [rad]: from x towards y, and above the ground."""
FACES = [(0, 1, 3, 2), (4, 5, 7, 6), (0, 1, 5, 4), (2, 3, 7, 6), (0, 2, 6, 4), (1, 3, 7, 5)]
"""Corners of `SIGNS` round each face of a box."""
CELLS = 8
"""Of the grid of a plane, each way."""
CIRCLE = np.linspace(0.0, 2 * np.pi, 49)
ACROSS = 3
"""Frames side by side."""
CAPTION, TITLE = 0.2, 0.3
"""Heights of a frame's time and of the title [in]."""


class View(NamedTuple):
    """What is seen of a run or a recording.

    t : (n,) [s];  poses : (n, bodies, 7);  reactions : (n, bodies, 6) G λ [N, N·m]
    planes, pins : none where the scene of a recording is not known
    """

    label: str
    t: Array
    poses: Array
    reactions: Array
    solids: Sequence[Solid]
    planes: Sequence[Plane] = ()
    pins: Sequence[Pin] = ()

    @classmethod
    def of(cls, source: Any) -> View | None:
        """That of a `SpaceRun` or a `Recording`; None where no bodies move in space."""
        if isinstance(source, SpaceRun):
            scene: Any = source.scene
            label, moved, solids = scene.label, source, scene.solids
        elif getattr(source, "space", None) is not None:
            scene = made_again(source.scene, source.parameters)
            label, moved, solids = source.scene, source.space, source.space.bodies()
        else:
            return None
        known = isinstance(scene, SpaceScene)
        held = (scene.planes, scene.pins) if known else ((), ())
        return cls(label, source.t, moved.poses, moved.reactions, solids, *held)


class Piece(NamedTuple):
    """A filled polygon, or a line, of points (c, 3)."""

    points: Array
    colour: str | None
    depth: float


def eye() -> Array:
    """(3, 3) rows: to the right, upwards, and towards the eye."""
    flat, high = np.cos(ELEVATION), np.sin(ELEVATION)
    towards = np.array([flat * np.cos(AZIMUTH), flat * np.sin(AZIMUTH), high])
    right = np.array([-np.sin(AZIMUTH), np.cos(AZIMUTH), 0.0])
    return np.array([right, np.cross(towards, right), towards])


def plot_space(
    view: View,
    path: str | Path,
    *,
    frames: int = 6,
    times: Sequence[float] | None = None,
) -> Path:
    """Draw frames of a motion (.png, .svg or .pdf); the options are those of `plot_scene`."""
    wanted = (
        np.linspace(view.t[0], view.t[-1], frames) if times is None else np.asarray(times, float)
    )
    if wanted.size == 0:
        raise ValueError("times is empty; give at least one, or leave it out")
    stage, columns = Stage.of(view, wanted), min(ACROSS, wanted.size)
    width = PAGE_WIDTH / columns
    height = width * stage.aspect + CAPTION
    rows = -(-wanted.size // columns)
    total = rows * height + TITLE
    with drawing() as Figure:
        figure = Figure(figsize=(PAGE_WIDTH, total))
        figure.text(0.0, 1 - 0.07 / total, view.label, va="top", weight="bold", size=10)
        for number, time in enumerate(wanted):
            row, column = divmod(number, columns)
            bottom = 1 - (TITLE + (row + 1) * height) / total
            place = column / columns, bottom + CAPTION / total
            axes = figure.add_axes((*place, 1 / columns, (height - CAPTION) / total))
            _draw(axes, view, float(time), stage)
            middle = (column + 0.5) / columns
            figure.text(middle, bottom + CAPTION / total, f"{time:.4f} s", ha="center", va="top",
                        size=8)  # fmt: skip
        return save(figure, Path(path))


def animate_space(view: View, path: Path, fps: int, speed: float, pixels: int) -> Path:
    """Write a motion as a film; the options are those of `animate_scene`."""
    length = float(view.t[-1] - view.t[0])
    times = np.linspace(view.t[0], view.t[-1], max(2, 1 + round(length / speed * fps)))
    stage = Stage.of(view, times)
    with drawing() as Figure:
        figure = Figure(figsize=(5.0, 5.0 * stage.aspect))
        axes = figure.add_axes((0, 0, 1, 1))
        with film(figure, path, fps, pixels) as take:
            for time in times:
                axes.clear()
                _draw(axes, view, float(time), stage)
                take()
    return path


def _pose(view: View, t: float) -> Array:
    """(bodies, 7) of the accepted step nearest to t."""
    return np.asarray(view.poses[int(np.argmin(np.abs(view.t - t)))])


class Stage(NamedTuple):
    """What all pictures of a motion share: limits [[left, right], [bottom, top]] [m], and planes as
    lines (2, 3)."""

    limits: Array
    lines: list[Array]

    @classmethod
    def of(cls, view: View, times: Array) -> Stage:
        every = np.concatenate([_points(view, _pose(view, float(t))) for t in times])
        seen = every @ eye()[:2].T
        low, high = seen.min(axis=0), seen.max(axis=0)
        margin = 0.08 * (high - low).max()
        lines = [line for plane in view.planes for line in _grid(plane, every)]
        return cls(np.column_stack([low - margin, high + margin]), lines)

    @property
    def aspect(self) -> float:
        """Height over width, not too far from 1."""
        width, height = self.limits[:, 1] - self.limits[:, 0]
        return float(np.clip(height / width, 0.3, 1.5))


def _points(view: View, pose: Array) -> Array:
    """(c, 3) that enclose all bodies and what holds them."""
    boxes = [_corners(solid, row) for solid, row in zip(view.solids, pose, strict=True)]
    return np.concatenate([*boxes, *_held(view, pose)])


def half_sides(solid: Solid) -> Array:
    """(3,) of a box, of that which encloses a ball, or of that with the same moments [m]."""
    if solid.radius:
        return np.full(3, solid.radius)
    if solid.is_box:
        return 0.5 * np.array(solid.sides)
    x, y, z = solid.inertia
    return np.sqrt(1.5 / solid.mass * np.maximum([y + z - x, x + z - y, x + y - z], 1e-3 * x))


def shape_of(solid: Solid) -> tuple[Array, Sequence[tuple[int, ...]]]:
    """Corners (c, 3) in axes of the body, and those round each face."""
    if solid.points:
        return solid.hull.corners, solid.hull.faces
    return SIGNS * half_sides(solid), FACES


def _corners(solid: Solid, row: Array) -> Array:
    """(c, 3) of `shape_of` in the world."""
    moved: Array = row[:3] + shape_of(solid)[0] @ rotations(row[None, 3:])[0].T
    return moved


def _held(view: View, pose: Array) -> list[Array]:
    """Lines from pins to the centres of their bodies, (2, 3) each."""
    R = rotations(pose[:, 3:])
    return [
        np.array([pose[pin.body, :3] + R[pin.body] @ pin.point, pose[pin.body, :3]])
        for pin in view.pins
    ]


def _draw(axes: Axes, view: View, t: float, stage: Stage) -> None:
    """One frame."""
    pose, (right, up, towards) = _pose(view, t), eye()
    onto = np.column_stack([right, up])
    for line in stage.lines:
        axes.plot(*(line @ onto).T, color=FAINT, linewidth=0.6, zorder=0)
    pieces: list[Piece] = []
    for body, (solid, row) in enumerate(zip(view.solids, pose, strict=True)):
        pieces += _pieces(solid, row, BODIES[body % len(BODIES)], towards)
    pieces += [Piece(line, None, float((line @ towards).mean())) for line in _held(view, pose)]
    for order, piece in enumerate(sorted(pieces, key=lambda piece: piece.depth), start=1):
        flat = piece.points @ onto
        if piece.colour is None:
            axes.plot(*flat.T, color=INK, linewidth=0.8, zorder=order)
        else:
            axes.fill(*flat.T, facecolor=piece.colour, edgecolor=INK, linewidth=0.6, zorder=order)
    axes.set_xlim(*stage.limits[0])
    axes.set_ylim(*stage.limits[1])
    axes.set_aspect("equal")
    axes.axis("off")


def _pieces(solid: Solid, row: Array, colour: str, towards: Array) -> list[Piece]:
    """What is seen of a body."""
    if solid.radius:
        return _ball(solid, row, colour, towards)
    corners = _corners(solid, row)
    seen = []
    for face in shape_of(solid)[1]:
        points = corners[list(face)]
        normal = np.cross(points[1] - points[0], points[2] - points[0])
        if normal @ (points[0] - row[:3]) * (normal @ towards) > 0:
            seen.append(Piece(points, colour, float((points @ towards).mean())))
    return seen


def _ball(solid: Solid, row: Array, colour: str, towards: Array) -> list[Piece]:
    """Its outline, and the near halves of two great circles that turn with it."""
    right, up, _ = eye()
    round_ = np.column_stack([np.cos(CIRCLE), np.sin(CIRCLE)]) * solid.radius
    depth = float(row[:3] @ towards)
    found = [Piece(row[:3] + round_ @ np.array([right, up]), colour, depth)]
    R = rotations(row[None, 3:])[0]
    for one, two in ((0, 1), (0, 2)):
        arms = round_ @ R[:, [one, two]].T
        near = np.where((arms @ towards > 0)[:, None], row[:3] + arms, np.nan)
        found.append(Piece(near, None, depth + 1e-9))
    return found


def _grid(plane: Plane, points: Array) -> list[Array]:
    """Lines (2, 3) of a plane below points (c, 3)."""
    n = np.array(plane.normal)
    first = np.cross((0.0, 1.0, 0.0) if abs(n[0]) < 0.9 else (1.0, 0.0, 0.0), n)
    first /= np.linalg.norm(first)
    frame = np.array([first, np.cross(n, first)])
    flat = (points - plane.point) @ frame.T
    middle, reach = 0.5 * (flat.max(axis=0) + flat.min(axis=0)), 0.7 * np.ptp(flat, axis=0).max()
    ticks = np.linspace(-reach, reach, CELLS + 1)
    ends = [np.array([(tick, -reach), (tick, reach)]) for tick in ticks]
    ends += [each[:, ::-1] for each in ends]
    return [np.asarray(plane.point) + (middle + each) @ frame for each in ends]
