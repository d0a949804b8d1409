"""Families of scenes whose size is a parameter: towers, brick walls, pyramids, loose heaps.

They carry the comparison of solvers from five bodies to thousands.  What differs between them is
the matrix A of the QPs, each of whose columns touches two bodies:

    tower    a chain; two normals for three coordinates, so A has full rank without friction
    wall     a grid; all normals are vertical, most multipliers are redundant
    pyramid  the same on a triangle, whose edges carry next to nothing
    heap     polygons at random angles between two walls; few rows are redundant

The bodies touch flush.  As they are by default they collapse; where solvers are compared they move
slowly, for a while (`problems.scenes.calm`).  In towers, walls and pyramids the courses slide on
each other, alternately to the right and to the left with seeded random speeds between speed/2 and
`speed`.  Without friction they slide on like this, until the first are without support.  With
friction they are at rest after some speed/(μ g), and A stands still: the directions alternate
because friction that acts one way from course to course would make a tower rock.  A tower with
friction moves on when it leans (`lean`).  The bodies of a heap start in any direction, and it goes
on settling.  ``speed=0`` starts from rest.  Under a load that grows with the depth thousands of
bricks stop within microseconds, one after the other: a wall or pyramid with friction gets beyond
them with a fixed step and ``stops="held"``.

The same parameters give the same scene on every machine, to the rounding of its sines and cosines.
"""

from __future__ import annotations

import numpy as np

from problems.bodies.bodies import Body, box
from problems.contacts.geometry import HalfPlane
from problems.qp import Indices, Vector
from problems.scenes.deposition import heap_positions
from problems.scenes.random_scenes import random_polygons, scene_generator
from problems.scenes.scene import MOST_BODIES, MOST_CORNERS, MOST_POLYGONS, Scene, at_most


@at_most(bodies=MOST_BODIES)
def tower(
    bodies: int = 10,
    width: float = 1.5,
    height: float = 1.0,
    jitter: float = 0.05,
    lean: float = 0.0,
    speed: float = 1.0,
    density: float = 1.0,
    mu: float = 0.0,
    mu_I: float = 0.0,
    seed: int = 0,
    gravity: float = 9.81,
    eps: float = 1e-3,
    end_time: float = 2.5,
) -> Scene:
    """Family: a tower of boxes, which slide on each other until it collapses.

    width, height of a box [m];  jitter : greatest offset of a box from the middle [m], 0 for
    flush sides;  lean : angle [rad] by which the tower is turned clockwise about its lower right
    corner, so that it tips;  speed : greatest speed along the edges [m/s];  density [kg/m²]

    Raises ValueError, naming the parameter, for one out of range.
    """
    rng = scene_generator(bodies, seed, jitter=jitter, lean=lean, speed=speed)
    if jitter >= width / 4:
        raise ValueError(f"jitter = {jitter:g}; the tower stands below width/4 = {width / 4:g}")
    q0 = np.zeros((bodies, 3))
    q0[:, 0] = jitter * rng.uniform(-1.0, 1.0, bodies)
    q0[:, 1] = height * (np.arange(bodies) + 0.5)
    v0 = _sliding(rng, np.arange(bodies, dtype=np.int64), speed)
    if lean:
        corner = q0[0, :2] + (width / 2, -height / 2)
        turn = np.array([(np.cos(lean), -np.sin(lean)), (np.sin(lean), np.cos(lean))])
        q0[:, :2] = corner + (q0[:, :2] - corner) @ turn
        q0[:, 2] = -lean
        v0[:, :2] = v0[:, :2] @ turn
    return Scene(
        bodies=(box(width, height, density),) * bodies,
        q0=q0,
        v0=v0,
        mu=mu,
        mu_I=mu_I,
        gravity=gravity,
        eps=eps,
        end_time=end_time,
    )


@at_most(bodies=MOST_BODIES, row=MOST_BODIES)
def wall(
    bodies: int = 23,
    row: int = 0,
    width: float = 2.0,
    height: float = 1.0,
    gap: float = 0.05,
    speed: float = 1.2,
    density: float = 1.0,
    mu: float = 0.0,
    mu_I: float = 0.0,
    seed: int = 0,
    gravity: float = 9.81,
    eps: float = 1e-3,
    end_time: float = 2.5,
) -> Scene:
    """Family: a brick wall in running bond, with a half brick at the ends of every other course.

    row : bricks in a full course, 0 for a wall about as high as it is wide;  the last course may
    not be full;  width, height of a brick, gap between two [m], 0 for flush sides;  speed :
    greatest |v_x| [m/s];  density [kg/m²]

    Raises ValueError, naming the parameter, for one out of range.
    """
    rng = scene_generator(bodies, seed, gap=gap, speed=speed)
    if gap >= width / 2:
        raise ValueError(f"gap = {gap:g}; a brick lies on two below width/2 = {width / 2:g}")
    if row < 0:
        raise ValueError(f"row = {row}; it must be the bricks of a course, or 0")
    whole, half = box(width, height, density), box((width - gap) / 2, height, density)
    per_course = row or max(1, round(np.sqrt(bodies * height / (width + gap))))
    places: list[tuple[float, float, float]] = []
    bricks: list[Body] = []
    for course in range(bodies):
        for x, is_whole in _course(per_course, course, width, gap):
            places.append((x, height * (course + 0.5), 0.0))
            bricks.append(whole if is_whole else half)
        if len(bricks) >= bodies:
            break
    q0 = np.array(places[:bodies])
    return Scene(
        bodies=tuple(bricks[:bodies]),
        q0=q0,
        v0=_sliding(rng, (q0[:, 1] / height).astype(np.int64), speed),
        mu=mu,
        mu_I=mu_I,
        gravity=gravity,
        eps=eps,
        end_time=end_time,
    )


@at_most(bodies=MOST_BODIES)
def pyramid(
    bodies: int = 21,
    width: float = 2.0,
    height: float = 1.0,
    gap: float = 0.05,
    speed: float = 2.0,
    density: float = 1.0,
    mu: float = 0.0,
    mu_I: float = 0.0,
    seed: int = 0,
    gravity: float = 9.81,
    eps: float = 1e-3,
    end_time: float = 2.5,
) -> Scene:
    """Family: a pyramid of bricks, each on two of the course below, one fewer in each course.

    The lowest course is the shortest that does; the last may not be full.  width, height of a
    brick, gap between two [m], 0 for flush sides;  speed : greatest |v_x| [m/s];  density [kg/m²]

    Raises ValueError, naming the parameter, for one out of range.
    """
    rng = scene_generator(bodies, seed, gap=gap, speed=speed)
    if gap >= width / 2:
        raise ValueError(f"gap = {gap:g}; a brick lies on two below width/2 = {width / 2:g}")
    lowest = 1
    while lowest * (lowest + 1) // 2 < bodies:
        lowest += 1
    places = [
        ((brick + 0.5 * course) * (width + gap), height * (course + 0.5), 0.0)
        for course in range(lowest)
        for brick in range(lowest - course)
    ]
    q0 = np.array(places[:bodies])
    return Scene(
        bodies=(box(width, height, density),) * bodies,
        q0=q0,
        v0=_sliding(rng, (q0[:, 1] / height).astype(np.int64), speed),
        mu=mu,
        mu_I=mu_I,
        gravity=gravity,
        eps=eps,
        end_time=end_time,
    )


@at_most(bodies=MOST_POLYGONS, corners=MOST_CORNERS)
def heap(
    bodies: int = 10,
    corners: int = 0,
    size: float = 0.5,
    spread: float = 0.3,
    width: float = 0.0,
    room: float = 2.0,
    speed: float = 0.01,
    density: float = 1.0,
    mu: float = 0.3,
    mu_I: float = 0.0,
    seed: int = 0,
    gravity: float = 9.81,
    eps: float = 1e-3,
    end_time: float = 1.5,
) -> Scene:
    """Family: a loose heap of random convex polygons, whose right wall is taken away.

    corners of every polygon, 0 for 4 to 7 at random;  size : mean distance of a corner from the
    middle of the longer axis [m];  spread : relative, of the sizes;  width between the walls that
    they were heaped up between [m], 0 for about the heap's height;  room : by which the right wall
    is further out [m], 0 for a heap that leans on it;  speed : greatest |v_x|, |v_y| [m/s];
    density [kg/m²]

    Raises ValueError, naming the parameter, for one out of range, or walls that are too near.
    """
    rng = scene_generator(bodies, seed, width=width, room=room, speed=speed)
    polygons = random_polygons(rng, bodies, corners, size, spread, density, at_random=(4, 7))
    apart = width or size * max(4.0 * (1.0 + spread), 1.7 * float(np.sqrt(bodies)))
    q0 = heap_positions(polygons, apart, rng)
    v0 = np.zeros((bodies, 3))
    v0[:, :2] = speed * rng.uniform(-1.0, 1.0, (bodies, 2))
    return Scene(
        bodies=polygons,
        q0=q0,
        v0=v0,
        ground=(
            HalfPlane(),
            HalfPlane((-apart / 2, 0.0), (1.0, 0.0)),
            HalfPlane((apart / 2 + room, 0.0), (-1.0, 0.0)),
        ),
        mu=mu,
        mu_I=mu_I,
        gravity=gravity,
        eps=eps,
        end_time=end_time,
    )


def _sliding(rng: np.random.Generator, courses: Indices, speed: float) -> Vector:
    """Velocities (n, 3) along the ground: even courses to the right, odd ones to the left."""
    v0 = np.zeros((len(courses), 3))
    v0[:, 0] = speed * rng.uniform(0.5, 1.0, len(courses)) * (1 - 2 * (courses % 2))
    return v0


def _course(row: int, course: int, width: float, gap: float) -> list[tuple[float, bool]]:
    """Middles of the bricks of a course from the left, and whether each is a whole one."""
    pitch = width + gap
    if course % 2 == 0:
        return [(pitch * i, True) for i in range(row)]
    end = (width + gap) / 4  # middle of a half brick, from the middle of the brick below
    return [
        (-end, False),
        *((pitch * (i + 0.5), True) for i in range(row - 1)),
        (pitch * (row - 1) + end, False),
    ]
