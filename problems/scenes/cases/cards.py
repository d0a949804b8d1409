"""A house of two cards: it stands if μ is at least half the tangent of their lean."""

import numpy as np

from problems.bodies.bodies import polygon_body
from problems.scenes.scene import Scene


def cards(
    lean: float = 0.4,
    mu: float = 0.3,
    length: float = 1.0,
    thickness: float = 0.01,
    gravity: float = 9.81,
    eps: float = 1e-3,
    end_time: float = 0.5,
) -> Scene:
    """Two cards lean on each other; they slide apart where mu is below tan(lean)/2 or so.

    lean from the vertical [rad];  length, thickness of a card [m], cut level below and plumb above

    Each bears its weight W on the inner end of its foot, of width w = thickness/cos(lean), and
    is held by a thrust H at its top: μ ≥ H/W = (length sin(lean)/2 − 3w/4)/(length cos(lean)).
    """
    width = thickness / np.cos(lean)
    x, y = length * np.sin(lean), length * np.cos(lean)
    left = np.array([(-x, 0.0), (-x + width, 0.0), (0.0, y - width / np.tan(lean)), (0.0, y)])
    parts = [left, (left * (-1.0, 1.0))[::-1]]
    bodies = tuple(polygon_body(part) for part in parts)
    centres = [part[0] - body.polygons[0][0] for part, body in zip(parts, bodies, strict=True)]
    return Scene(
        bodies=bodies,
        q0=np.column_stack([np.array(centres), np.zeros(2)]),
        v0=np.zeros((2, 3)),
        mu=mu,
        gravity=gravity,
        eps=eps,
        end_time=end_time,
    )
