"""Pictures of the bodies: a sheet of frames like the paper's figures 2 to 5, and a film.

Each frame shows the bodies with their numbers (from 1, as in the paper; they turn with the body),
the ground, springs, and joints as bars and pins.  The time in seconds stands under the frame, and
a bar at the right tells the scale.

All frames of a sheet have one scale and equal axes.  Where the bodies stay together, and where
there is one only, they also have the same limits, side by side in a grid.  Where the bodies drift
apart (figure 2) common limits would leave nothing but ground: there each frame is as wide as it
needs, and a tick on the ground marks x = 0.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from reports.motions.film import FPS, PIXELS, film
from reports.motions.motion import Array, Motion, frame_times, motion_of
from reports.motions.network import animate_network, is_network, plot_network
from reports.motions.space import View, animate_space, plot_space
from reports.parts.style import BODIES, FAINT, INK, PAGE_WIDTH, SOFT, drawing, save

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

FRAMES = 12
"""Pictures on a sheet unless told otherwise."""

LEVEL = 1e-12
"""Planes whose normals have a smaller horizontal part are level ground, others walls."""

GAP, CAPTION, TITLE = 0.12, 0.26, 0.3
"""Between frames, below each, above all [in]."""


@dataclass(frozen=True)
class Window:
    """Limits of a frame [m]."""

    left: float
    right: float
    bottom: float
    top: float

    @property
    def width(self) -> float:
        return self.right - self.left

    @property
    def height(self) -> float:
        return self.top - self.bottom

    def with_heights_of(self, others: Sequence[Window]) -> Window:
        """The same from left to right, and as low and high as any of the others."""
        low, high = min(w.bottom for w in others), max(w.top for w in others)
        return Window(self.left, self.right, low, high)


def window_of(motion: Motion, poses: Sequence[Array]) -> Window:
    """The least window, with a margin, that holds all bodies, springs, the ground and walls."""
    points = [np.concatenate(motion.corners(pose, i)) for pose in poses for i in range(len(pose))]
    points += [e for pose in poses for e in (*motion.spring_ends(pose), *motion.bar_ends(pose))]
    points += [np.array([point]) for point, normal in motion.ground if abs(normal[0]) > LEVEL]
    everything = np.concatenate(points)
    (left, low), (right, high) = everything.min(axis=0), everything.max(axis=0)
    low = min([low, *(point[1] for point, normal in motion.ground if abs(normal[0]) <= LEVEL)])
    margin = 0.06 * (high - low) + 0.02 * (right - left)
    return Window(left - margin, right + margin, low - margin, high + margin)


def plot_scene(
    source: Any,
    path: str | Path,
    *,
    frames: int = FRAMES,
    times: Sequence[float] | None = None,
) -> Path:
    """Draw a sheet of frames of a `Run` or `Recording` into `path` (.png, .svg or .pdf).

    frames : how many pictures, spread over time and motion
    times : instead, the times wanted [s]; between accepted steps the motion is taken as linear

    Of a network, its currents and voltages are drawn instead; of bodies in space, they are
    seen from aside.

    Returns the path.  Raises ValueError where there is nothing to draw.
    """
    if (view := View.of(source)) is not None:
        return plot_space(view, path, frames=frames, times=times)
    if is_network(source):
        return plot_network(source, path)
    motion = motion_of(source)
    wanted = frame_times(motion, frames) if times is None else [float(time) for time in times]
    if not wanted:
        raise ValueError("times is empty; give at least one, or leave it out")
    poses = [motion.pose(time) for time in wanted]
    rows, scale = _layout(motion, poses)
    heights = [scale * row[0].height for row in rows]
    total = TITLE + sum(heights) + CAPTION * len(rows)
    apart = len({(w.left, w.right) for row in rows for w in row}) > 1
    with drawing() as Figure:
        figure = Figure(figsize=(PAGE_WIDTH, total))
        figure.text(0.0, 1 - 0.07 / total, motion.label, va="top", weight="bold", size=10)
        draw_scale(figure, scale, 1 - 0.15 / total)
        number, bottom = 0, total - TITLE
        for row, height in zip(rows, heights, strict=True):
            bottom -= height
            left = 0.0
            for window in row:
                width = scale * window.width
                axes = figure.add_axes(
                    (left / PAGE_WIDTH, bottom / total, width / PAGE_WIDTH, height / total)
                )
                draw_bodies(axes, motion, poses[number], window, origin=apart)
                figure.text(
                    (left + width / 2) / PAGE_WIDTH,
                    (bottom - 0.05) / total,
                    f"{wanted[number]:.4f} s",
                    ha="center",
                    va="top",
                    size=8,
                )
                left += width + GAP
                number += 1
            bottom -= CAPTION
        return save(figure, Path(path))


def _layout(motion: Motion, poses: Sequence[Array]) -> tuple[list[list[Window]], float]:
    """Windows of the frames, row by row, and the scale of the sheet [in/m]."""
    common = window_of(motion, poses)
    own = [window_of(motion, [pose]) for pose in poses]
    together = np.median([window.width for window in own]) > 0.5 * common.width
    if together or len(motion.polygons) == 1:
        columns = _columns(len(poses), common.height / common.width)
        scale = (PAGE_WIDTH - GAP * (columns - 1)) / (columns * common.width)
        grid = [[common] * len(poses[i : i + columns]) for i in range(0, len(poses), columns)]
        return grid, scale
    scale = PAGE_WIDTH / max(window.width for window in own)
    rows: list[list[Window]] = []
    room = 0.0
    for window in own:
        if not rows or scale * window.width > room + 1e-9:
            rows.append([])
            room = PAGE_WIDTH
        rows[-1].append(window)
        room -= scale * window.width + GAP
    return [_justified([w.with_heights_of(row) for w in row], scale) for row in rows], scale


def _justified(row: list[Window], scale: float) -> list[Window]:
    """Widen the frames of a row until it is full."""
    spare = PAGE_WIDTH - GAP * (len(row) - 1) - scale * sum(window.width for window in row)
    more = max(spare, 0.0) / (2 * scale * len(row))
    return [Window(w.left - more, w.right + more, w.bottom, w.top) for w in row]


def _columns(count: int, aspect: float) -> int:
    """Frames side by side: a sheet about three quarters as high as wide, its last row full."""

    def fault(columns: int) -> float:
        rows = -(-count // columns)
        shape = np.log((rows * (aspect / columns + 0.03) + 0.04) / 0.75)
        return float(abs(shape)) + 0.5 * (rows * columns - count) / columns

    return min(range(2 if count > 1 else 1, min(count, 6) + 1), key=fault)


def animate_scene(
    source: Any, path: str | Path, *, fps: int = FPS, speed: float = 1.0, pixels: int = PIXELS
) -> Path:
    """Write the motion of a `Run` or `Recording` as a film, .gif or .mp4.

    fps : pictures per second;  speed : seconds of motion shown in one second
    pixels : width of a picture

    Returns the path.  Raises ValueError for another suffix, or numbers that are not positive, and
    ImportError for an MP4 where there is no FFmpeg.
    """
    path = Path(path)
    if not speed > 0:
        raise ValueError(f"speed = {speed}; it must be positive")
    if (view := View.of(source)) is not None:
        return animate_space(view, path, fps, speed, pixels)
    if is_network(source):
        return animate_network(source, path, fps, pixels)
    motion = motion_of(source)
    begin, end = float(motion.t[0]), float(motion.t[-1])
    times = np.linspace(begin, end, max(2, 1 + round((end - begin) / speed * fps)))
    poses = [motion.pose(time) for time in times]
    window = window_of(motion, poses)
    width = min(7.0, 5.0 * window.width / window.height)
    height, caption = width * window.height / window.width, 0.3
    with drawing() as Figure:
        figure = Figure(figsize=(width, height + caption))
        base = caption / (height + caption)
        axes = figure.add_axes((0, base, 1, 1 - base))
        clock = figure.text(0.5, 0.5 * base, "", ha="center", va="center")
        draw_scale(figure, width / window.width, 0.5 * base)
        with film(figure, path, fps, pixels) as take:
            for time, pose in zip(times, poses, strict=True):
                axes.clear()
                draw_bodies(axes, motion, pose, window)
                clock.set_text(f"{time:.2f} s")
                take()
    return path


def draw_scale(figure: Figure, scale: float, at: float) -> None:
    """A bar of 1, 2 or 5 · 10ⁿ m at the right of a figure, with its length.

    scale : [in/m];  at : its height, of that of the figure
    """
    from matplotlib.lines import Line2D

    width = figure.get_figwidth()
    longest = 0.15 * width / scale
    ten = 10.0 ** np.floor(np.log10(longest))
    length = float(ten * max(step for step in (1, 2, 5) if step * ten <= longest))
    right = 1 - 0.06 / width
    ends = [right - length * scale / width, right]
    figure.add_artist(Line2D(ends, [at, at], color=INK, linewidth=1.6, solid_capstyle="butt"))
    figure.text(ends[0] - 0.06 / width, at, f"{length:g} m", ha="right", va="center", size=8)


def draw_bodies(
    axes: Axes, motion: Motion, pose: Array, window: Window, *, origin: bool = False
) -> None:
    """Draw bodies, numbers, ground, springs and joints in a window of the plane, without axes.

    origin : mark x = 0 by a tick on the ground
    """
    from matplotlib.patches import Polygon

    axes.set_xlim(window.left, window.right)
    axes.set_ylim(window.bottom, window.top)
    axes.set_axis_off()
    for point, normal in motion.ground:
        _draw_half_plane(axes, np.asarray(point), np.asarray(normal), window)
    if origin and window.left < 0 < window.right:
        axes.plot([0, 0], [0, window.bottom], color=SOFT, linewidth=0.9, zorder=1)
    for ends in motion.spring_ends(pose):
        _draw_spring(axes, *ends)
    for ends in motion.bar_ends(pose):
        axes.plot(*ends.T, color=INK, linewidth=1.6, marker="o", markersize=2.5, zorder=3.5)
    for body in range(len(pose)):
        colour = BODIES[body % len(BODIES)]
        for part in motion.corners(pose, body):
            axes.add_patch(
                Polygon(part, facecolor=colour, alpha=0.5, edgecolor="none", zorder=2 + body / 100)
            )
            axes.add_patch(
                Polygon(part, fill=False, edgecolor=INK, linewidth=0.8, zorder=3, joinstyle="round")
            )
            if len(motion.polygons[body][0]) < 3:  # a spoke shows how what is round turns
                spoke = np.array([pose[body][:2] + 0.6 * (part[0] - pose[body][:2]), part[0]])
                axes.plot(*spoke.T, color=INK, linewidth=0.8, zorder=3)
        x, y, phi = pose[body]
        axes.text(
            x,
            y,
            str(body + 1),
            rotation=float(np.degrees(phi)) % 360,
            rotation_mode="anchor",
            ha="center",
            va="center_baseline",
            size=_number_size(axes, motion, body, window),
            weight="bold",
            color=INK,
            zorder=4,
            clip_on=True,
        )


def _draw_half_plane(axes: Axes, point: Array, normal: Array, window: Window) -> None:
    """What of a half plane is in the window, which clips it."""
    from matplotlib.patches import Polygon

    out = normal / np.hypot(*normal)
    middle = np.array([window.left + window.right, window.bottom + window.top]) / 2
    foot = middle - ((middle - point) @ out) * out
    along = np.array([-out[1], out[0]]) * np.hypot(window.width, window.height)
    deep = out * np.hypot(window.width, window.height)
    ends = np.array([foot - along, foot + along])
    earth = Polygon([*ends, *(ends[::-1] - deep)], facecolor=FAINT, edgecolor="none", alpha=0.6)
    axes.add_patch(earth)
    axes.plot(*ends.T, color=SOFT, linewidth=0.9, zorder=1)


def _number_size(axes: Axes, motion: Motion, body: int, window: Window) -> float:
    """Size of a body's number [pt]: legible, yet inside the body."""
    parts = motion.corners(np.zeros((body + 1, 3)), body)
    across = min(float(np.ptp(part, axis=0).min()) for part in parts)
    points = axes.get_position().width * axes.figure.get_figwidth() * 72  # type: ignore[union-attr]
    return float(np.clip(0.6 * across * points / window.width, 3.5, 9))


def _draw_spring(axes: Axes, anchor: Array, held: Array) -> None:
    """A zigzag from the anchor to the point that it holds."""
    along = held - anchor
    length = float(np.hypot(*along))
    if length > 0:
        across = np.array([-along[1], along[0]]) / length * 0.12
        share = np.concatenate([[0.0], np.linspace(0.12, 0.88, 15), [1.0]])
        side = np.zeros(share.size)
        side[2:-2] = np.where(np.arange(share.size - 4) % 2, -1.0, 1.0)
        points = anchor + share[:, None] * along + side[:, None] * across
        axes.plot(*points.T, color=SOFT, linewidth=0.8, zorder=1.5, solid_joinstyle="round")
    axes.plot(*anchor, marker="o", markersize=3.5, color=INK, zorder=4)
    axes.plot(*held, marker="o", markersize=2, color=INK, zorder=4)
