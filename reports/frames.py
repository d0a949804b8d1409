"""Pictures of the bodies: a sheet of frames like the paper's figures 2 to 5, and an animation.

Each frame shows the bodies with their numbers (from 1, as in the paper; they turn with the body),
the ground, and the spring where the scene names its anchor.  The time in seconds stands under the
frame.  All frames of a sheet have the same limits and equal axes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from reports.motion import Array, Motion, frame_steps, motion_of
from reports.style import BODIES, FAINT, INK, PAGE_WIDTH, SOFT, drawing, save

if TYPE_CHECKING:
    from matplotlib.axes import Axes

FRAMES = 12
"""Pictures on a sheet unless told otherwise."""


@dataclass(frozen=True)
class Window:
    """Limits that all frames share [m], and the height of the ground (None: not in view)."""

    left: float
    right: float
    bottom: float
    top: float
    ground: float = 0.0

    @property
    def aspect(self) -> float:
        """Height over width."""
        return (self.top - self.bottom) / (self.right - self.left)


def window_of(motion: Motion, steps: Sequence[int]) -> Window:
    """The least window that holds all bodies, springs and the ground at the given steps."""
    points: list[Array] = []
    for step in steps:
        for body in range(motion.q.shape[1]):
            points.extend(motion.corners(step, body))
        spring = motion.spring(step)
        if spring is not None:
            points.append(np.stack(spring))
    everything = np.concatenate(points)
    (left, low), (right, high) = everything.min(axis=0), everything.max(axis=0)
    low = min(low, 0.0)
    margin = 0.04 * max(right - left, high - low)
    return Window(left - margin, right + margin, low - 1.5 * margin, high + margin)


def plot_scene(
    source: Any,
    path: str | Path,
    *,
    frames: int = FRAMES,
    times: Sequence[float] | None = None,
) -> Path:
    """Draw a sheet of frames of a `Run` or `Recording` into `path` (.png, .svg or .pdf).

    frames : how many pictures, spread over time and motion
    times : instead, the times wanted [s]; each picture is the nearest accepted step

    Returns the path.  Raises ValueError where there is nothing to draw.
    """
    motion = motion_of(source)
    if times is None:
        steps = frame_steps(motion, frames)
    else:
        steps = [motion.step_at(time) for time in times]
    if not steps:
        raise ValueError("times is empty; give at least one, or leave it out")
    window = window_of(motion, steps)
    columns = _columns(len(steps), window.aspect)
    rows = -(-len(steps) // columns)
    gap, caption, title = 0.12, 0.24, 0.3
    width = (PAGE_WIDTH - gap * (columns - 1)) / columns
    height = width * window.aspect
    total = title + rows * (height + caption)
    with drawing() as Figure:
        figure = Figure(figsize=(PAGE_WIDTH, total))
        figure.text(0.0, 1 - 0.07 / total, motion.label, va="top", weight="bold", size=10)
        for place, step in enumerate(steps):
            row, column = divmod(place, columns)
            left = column * (width + gap) / PAGE_WIDTH
            bottom = 1 - (title + (row + 1) * height + row * caption) / total
            axes = figure.add_axes((left, bottom, width / PAGE_WIDTH, height / total))
            draw_bodies(axes, motion, step, window)
            axes.text(
                0.5,
                -0.04 / height,
                f"{motion.t[step]:.4f} s",
                transform=axes.transAxes,
                ha="center",
                va="top",
                size=8,
                color=INK,
            )
        return save(figure, Path(path))


def animate_scene(source: Any, path: str | Path, *, fps: int = 25, speed: float = 1.0) -> Path:
    """Write the motion of a `Run` or `Recording` as an animated GIF.

    fps : pictures per second
    speed : seconds of motion shown in one second

    Returns the path.  Raises ValueError for a suffix other than .gif, or speeds that are not
    positive.
    """
    path = Path(path)
    if path.suffix.lower() != ".gif":
        raise ValueError(f"{path.name}: an animation is written as .gif")
    if not (fps > 0 and speed > 0):
        raise ValueError(f"fps = {fps} and speed = {speed} must be positive")
    from matplotlib.animation import PillowWriter

    motion = motion_of(source)
    span = motion.t[-1] - motion.t[0]
    pictures = max(1, round(span / speed * fps))
    shown = [motion.step_at(t) for t in motion.t[0] + np.arange(pictures + 1) * (span / pictures)]
    # A hundred pictures tell as much about the window as all of them.
    window = window_of(motion, [*shown[:: max(1, len(shown) // 100)], shown[-1]])
    width = 6.4 if window.aspect < 1 else 6.4 / window.aspect
    path.parent.mkdir(parents=True, exist_ok=True)
    with drawing() as Figure:
        height = width * window.aspect
        figure = Figure(figsize=(width, height + 0.3), facecolor="white")
        axes = figure.add_axes((0, 0.3 / (height + 0.3), 1, height / (height + 0.3)))
        writer = PillowWriter(fps=fps)
        with writer.saving(figure, str(path), dpi=80):
            for step in shown:
                axes.clear()
                draw_bodies(axes, motion, step, window)
                axes.text(
                    0.5,
                    -0.06 / height,
                    f"{motion.t[step]:.2f} s",
                    transform=axes.transAxes,
                    ha="center",
                    va="top",
                )
                writer.grab_frame()
    return path


def draw_bodies(axes: Axes, motion: Motion, step: int, window: Window) -> None:
    """Draw bodies, numbers, ground and spring of one step, with equal axes and no frame."""
    from matplotlib.patches import Polygon, Rectangle

    axes.set_xlim(window.left, window.right)
    axes.set_ylim(window.bottom, window.top)
    axes.set_axis_off()
    axes.add_patch(
        Rectangle(
            (window.left, window.bottom),
            window.right - window.left,
            window.ground - window.bottom,
            facecolor=FAINT,
            edgecolor="none",
            alpha=0.6,
        )
    )
    axes.plot([window.left, window.right], [window.ground] * 2, color=SOFT, linewidth=0.9, zorder=1)
    spring = motion.spring(step)
    if spring is not None:
        _draw_spring(axes, *spring)
    for body in range(motion.q.shape[1]):
        colour = BODIES[body % len(BODIES)]
        for part in motion.corners(step, body):
            axes.add_patch(
                Polygon(part, facecolor=colour, alpha=0.5, edgecolor="none", zorder=2 + body)
            )
            axes.add_patch(
                Polygon(
                    part, fill=False, edgecolor=INK, linewidth=0.8, zorder=30, joinstyle="round"
                )
            )
        x, y, phi = motion.q[step, body]
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
            zorder=31,
        )


def _number_size(axes: Axes, motion: Motion, body: int, window: Window) -> float:
    """Size of a body's number [pt]: legible, yet inside the body."""
    across = min(float(np.ptp(part, axis=0).min()) for part in motion.polygons[body])
    points = axes.get_position().width * axes.figure.get_figwidth() * 72  # type: ignore[union-attr]
    return float(np.clip(0.6 * across * points / (window.right - window.left), 3.5, 9))


def _draw_spring(axes: Axes, anchor: Array, corner: Array) -> None:
    """A zigzag from the anchor to the corner that it holds."""
    along = corner - anchor
    length = float(np.hypot(*along))
    if length > 0:
        across = np.array([-along[1], along[0]]) / length * 0.12
        share = np.concatenate([[0.0], np.linspace(0.12, 0.88, 15), [1.0]])
        side = np.zeros(share.size)
        side[2:-2] = np.where(np.arange(share.size - 4) % 2, -1.0, 1.0)
        points = anchor + share[:, None] * along + side[:, None] * across
        axes.plot(*points.T, color=SOFT, linewidth=0.8, zorder=1.5, solid_joinstyle="round")
    axes.plot(*anchor, marker="o", markersize=3.5, color=INK, zorder=32)
    axes.plot(*corner, marker="o", markersize=2, color=INK, zorder=32)


def _columns(count: int, aspect: float) -> int:
    """Frames side by side, so that the sheet is about three quarters as high as it is wide."""
    return min(
        range(2 if count > 1 else 1, min(count, 6) + 1),
        key=lambda n: abs(np.log((-(-count // n) * (aspect / n + 0.03) + 0.04) / 0.75)),
    )
