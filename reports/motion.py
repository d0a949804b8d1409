"""The motion of one scene as pictures need it, from a run in memory or from a stored recording."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

PAPER_TIMES = {"fig3": (0.7302, 2.1151, 4.0002)}
"""Times printed under the paper's frames where the text keeps them [s]."""


@dataclass(frozen=True)
class Motion:
    """Where the bodies were.

    label : of the scene, such as "fig4,mu_I=0.8"
    t : (n,) times of the accepted steps [s]; a time may occur twice, before and after an impulse
    q : (n, bodies, 3) x, y [m] and φ [rad]
    polygons : per body, its convex parts, each (c, 2) in body coordinates [m]
    events : (t, kind, detail) in order
    parameters : those of the scene
    """

    label: str
    t: Array
    q: Array
    polygons: Sequence[Sequence[Array]]
    events: Sequence[tuple[float, str, str]]
    parameters: Mapping[str, Any]

    def corners(self, step: int, body: int) -> list[Array]:
        """The parts of one body in the plane at one step, each (c, 2) [m]."""
        x, y, phi = self.q[step, body]
        turn = np.array([[np.cos(phi), -np.sin(phi)], [np.sin(phi), np.cos(phi)]])
        return [np.asarray(part) @ turn.T + (x, y) for part in self.polygons[body]]

    def step_at(self, t: float) -> int:
        """Index of the accepted step nearest to time t."""
        return int(np.argmin(np.abs(self.t - t)))

    def spring(self, step: int) -> tuple[Array, Array] | None:
        """Ends of the spring in the plane, (2,) each: its anchor and the corner it holds.

        None where the parameters name no `anchor`.  The corner is the parameter `attachment` in
        the coordinates of body 1, or else its upper left corner at the start.
        """
        anchor = self.parameters.get("anchor")
        if anchor is None:
            return None
        held = self.parameters.get("attachment")
        if held is None:
            part = np.asarray(self.polygons[0][0])
            held = part[np.lexsort((part[:, 0], -part[:, 1]))[0]]
        x, y, phi = self.q[step, 0]
        cos, sin = np.cos(phi), np.sin(phi)
        a, b = np.asarray(held, float)
        return np.asarray(anchor, float), np.array([x + cos * a - sin * b, y + sin * a + cos * b])


def motion_of(source: Any) -> Motion:
    """Read the motion off a `Run`, a `Recording` or a `Motion`.

    Raises ValueError where the source holds no step at all.
    """
    if isinstance(source, Motion):
        return source
    if hasattr(source, "polygons"):
        label, parameters = str(source.scene), source.parameters
        polygons, events = source.polygons, source.events
    else:
        label, parameters = str(source.scene.label), source.scene.parameters
        polygons, events = [body.polygons for body in source.scene.bodies], source.event_log
    t, q = np.asarray(source.t, float), np.asarray(source.q, float)
    if t.size == 0:
        raise ValueError(f"{label} holds no steps, so there is nothing to draw")
    return Motion(label, t, q, polygons, [_event(entry) for entry in events], parameters)


def _event(entry: Any) -> tuple[float, str, str]:
    t, kind, *detail = entry
    return float(t), str(kind), str(detail[0]) if detail else ""


def frame_steps(motion: Motion, frames: int) -> list[int]:
    """Steps worth a picture: the first, the last, those of the paper, and others between.

    The others are spread evenly in the mean of elapsed time and of path travelled (the corners'
    way, each as a share of the whole), so that fast passages get more pictures than rest does.
    """
    if frames < 1:
        raise ValueError(f"frames = {frames}; ask for at least one picture")
    t, last = motion.t, motion.t.size - 1
    if last == 0 or t[-1] == t[0]:
        return [last]
    size = np.array([max(np.abs(p).max() for p in parts) for parts in motion.polygons])
    moved = np.diff(motion.q, axis=0) * np.stack([np.ones_like(size), np.ones_like(size), size], 1)
    path = np.concatenate([[0.0], np.cumsum(np.abs(moved).sum(axis=(1, 2)))])
    progress = (t - t[0]) / (t[-1] - t[0])
    if path[-1] > 0:
        progress = 0.5 * progress + 0.5 * path / path[-1]
    name = motion.label.partition(",")[0]
    fixed = [time for time in PAPER_TIMES.get(name, ()) if t[0] <= time <= t[-1]]
    chosen = {0, last, *(motion.step_at(time) for time in fixed)}
    # Fill the widest gap again and again: evenly spread, and the fixed pictures stay.
    while len(chosen) < frames:
        steps = sorted(chosen)
        gaps = [progress[b] - progress[a] if b - a > 1 else -1.0 for a, b in pairwise(steps)]
        widest = int(np.argmax(gaps))
        if gaps[widest] <= 0:
            break
        a, b = steps[widest], steps[widest + 1]
        middle = int(np.searchsorted(progress, 0.5 * (progress[a] + progress[b])))
        chosen.add(min(max(middle, a + 1), b - 1))
    return sorted(chosen)
