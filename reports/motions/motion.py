"""The motion of one scene as pictures need it, from a run in memory or from a stored recording."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from problems import Scene, scene
from problems.bodies.bodies import GROUND
from problems.bodies.shapes import semi_axes

Array = NDArray[np.float64]

ROUND = 72
"""Corners that a disc or an ellipse is drawn with."""

PAPER_TIMES = {"fig3": (0.7302, 2.1151, 4.0002)}
"""Times printed under the paper's frames where the text keeps them [s]."""


LEVEL = (((0.0, 0.0), (0.0, 1.0)),)
"""The ground of a scene that is not known: the x-axis."""
Link = tuple[int, Sequence[float], int, Sequence[float]]


@dataclass(frozen=True)
class Motion:
    """Where the bodies were.

    label : of the scene, such as "fig4,mu_I=0.8"
    t : (n,) times of the accepted steps [s]; a time may occur twice, before and after an impulse
    q : (n, bodies, 3) x, y [m] and φ [rad]
    v : (n, bodies, 3) their velocities [m/s, m/s, rad/s]
    polygons : per body, its convex parts, each (c, 2) in body coordinates [m]; of a disc the one
        point (radius, 0), of an ellipse (a, 0) and (0, b)
    springs, bars : what connects two points: (body, point in its coordinates, other body, anchor
        in those of the other, or in the plane where that is the ground)
    ground : half planes that do not move, each (point [m], normal out of it)
    """

    label: str
    t: Array
    q: Array
    v: Array
    polygons: Sequence[Sequence[Array]]
    springs: Sequence[Link] = ()
    bars: Sequence[Link] = ()
    ground: Sequence[tuple[Sequence[float], Sequence[float]]] = LEVEL

    def pose(self, t: float) -> Array:
        """x, y, φ of each body at time t, (bodies, 3), linear between accepted steps."""
        flat = self.q.reshape(len(self.t), -1)
        values = [np.interp(t, self.t, column) for column in flat.T]
        return np.array(values).reshape(self.q.shape[1:])

    def corners(self, pose: Array, body: int) -> list[Array]:
        """The parts of one body in the plane, each (c, 2) [m]; what is round as a polygon."""
        return [moved(pose[body], _outline(np.asarray(part))) for part in self.polygons[body]]

    def spring_ends(self, pose: Array) -> list[Array]:
        """Ends of each spring in the plane, (2, 2): its anchor, then the point that it holds."""
        return [_ends(link, pose) for link in self.springs]

    def bar_ends(self, pose: Array) -> list[Array]:
        """Ends of each bar in the plane, (2, 2), both the same of a pin."""
        return [_ends(link, pose) for link in self.bars]


def _ends(link: Link, pose: Array) -> Array:
    places = ((link[2], link[3]), (link[0], link[1]))
    return np.stack(
        [
            np.asarray(point, float) if body == GROUND else moved(pose[body], np.asarray(point))
            for body, point in places
        ]
    )


def _outline(part: Array) -> Array:
    """Corners of a part, `ROUND` of them of what is round."""
    if len(part) > 2:
        return part
    angle = 2 * np.pi / ROUND * np.arange(ROUND)
    return np.array(semi_axes(part)) * np.column_stack([np.cos(angle), np.sin(angle)])


def moved(pose: Array, points: Array) -> Array:
    """Points of a body, (…, 2), from its own coordinates into the plane."""
    x, y, phi = pose
    cos, sin = np.cos(phi), np.sin(phi)
    moved: Array = points @ np.array([[cos, sin], [-sin, cos]]) + (x, y)
    return moved


def motion_of(source: Any) -> Motion:
    """Read the motion off a `Run`, a `Recording` or a `Motion`.

    Raises ValueError where the source holds no step at all.
    """
    if isinstance(source, Motion):
        return source
    t, q, v = (np.asarray(getattr(source, name), float) for name in ("t", "q", "v"))
    if hasattr(source, "polygons"):
        label, polygons = str(source.scene), source.polygons
        made = made_again(label, source.parameters)
    else:
        label, polygons = str(source.scene.label), [body.polygons for body in source.scene.bodies]
        made = source.scene
    if t.size == 0:
        raise ValueError(f"{label} holds no steps, so there is nothing to draw")
    ground = [(plane.point, plane.normal) for plane in made.ground] if made else LEVEL
    springs, bars = (_links(part) for part in ((made.forces, made.joints) if made else ((), ())))
    return Motion(label, t, q, v, polygons, springs, bars, ground)


def _links(acting: Sequence[Any]) -> list[Link]:
    """Those with two ends."""
    return [
        (one.body, one.point, one.other, one.anchor) for one in acting if hasattr(one, "anchor")
    ]


def made_again(label: str, parameters: Mapping[str, Any]) -> Scene | None:
    """The scene of a recording, which keeps no ground and forces; None if it is not known here."""
    own = {name: value for name, value in parameters.items() if not name.startswith("run.")}
    try:
        made: Scene = scene(label.partition(",")[0], **own)
    except ValueError:
        return None
    return made


def frame_times(motion: Motion, frames: int) -> list[float]:
    """Times worth a picture: the first, the last, those of the paper, and others between [s].

    The others are accepted steps, spread evenly in the sum of elapsed time, path travelled and
    change of velocity (each as a share of the whole), so that pictures gather where much happens.

    Raises ValueError for fewer than one frame.
    """
    if frames < 1:
        raise ValueError(f"frames = {frames}; ask for at least one picture")
    t = motion.t
    if frames == 1 or t[-1] == t[0]:
        return [float(t[-1])]
    # An angle counts by the way of the farthest corner.
    reach = [max(float(np.hypot(*np.asarray(p).T).max()) for p in ps) for ps in motion.polygons]
    weight = np.array([[1.0, 1.0, r] for r in reach])
    progress = (t - t[0]) / (t[-1] - t[0])
    for state in (motion.q, motion.v):
        change = (np.abs(np.diff(state, axis=0)) * weight).sum(axis=(1, 2))
        if change.sum() > 0:
            progress = progress + np.concatenate([[0.0], np.cumsum(change)]) / change.sum()
    fixed = PAPER_TIMES.get(motion.label.partition(",")[0], ())
    chosen = {float(t[0]), float(t[-1]), *(time for time in fixed if t[0] < time < t[-1])}
    # An impulse is a jump of velocity at one time: it must not draw all pictures to itself.
    apart = (t[-1] - t[0]) / (5 * frames)
    # Fill the widest gap again and again: the fixed pictures stay, the rest is evenly spread.
    while len(chosen) < frames:
        times = sorted(chosen)
        shares = np.interp(times, t, progress)
        roomy = np.diff(times) > 2 * apart
        widest = int(np.argmax(np.where(roomy, np.diff(shares), -1.0)))
        inside = np.flatnonzero((t > times[widest] + apart) & (t < times[widest + 1] - apart))
        if not inside.size:
            break
        middle = 0.5 * (shares[widest] + shares[widest + 1])
        chosen.add(float(t[inside[np.argmin(np.abs(progress[inside] - middle))]]))
    return sorted(chosen)
