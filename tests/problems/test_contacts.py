"""Constraint functions against finite differences, edge choice, broad phase, the graph."""

import numpy as np
import pytest

from problems.bodies.bodies import GROUND, box, polygon_body
from problems.contacts.assembly import Assembly
from problems.contacts.constraint_graph import ConstraintGraph
from problems.contacts.geometry import Geometry, HalfPlane

TWO = (box(1.0, 1.0), polygon_body([(0, 0), (2, 0), (1, 1.5)]))


def geometry():
    return Geometry(TWO, (HalfPlane((0, 0), (0.3, 1)),))


def graph(mu=0.5, bodies=TWO):
    return ConstraintGraph(Geometry(bodies, (HalfPlane(),)), lambda a, b: mu)


def everything(g):
    """Every (corner, part, edge) of different bodies."""
    return np.array(
        [
            (c, p, e)
            for c in range(len(g.corner_body))
            for p in range(len(g.part_body))
            for e in range(max(int(g.part_size[p]), 1))
            if g.corner_body[c] != g.part_body[p]
        ]
    ).T


def test_normal_columns_are_the_gradient_of_phi():
    g, rng = geometry(), np.random.default_rng(1)
    where = everything(g)
    q = rng.normal(size=6)
    columns = g.columns(g.pose(q), *where)
    dense = np.zeros((6, where.shape[1]))
    for i, (a, b) in enumerate(columns.bodies):
        dense[3 * a : 3 * a + 3, i] = columns.normal[i, :3]
        if b != GROUND:
            dense[3 * b : 3 * b + 3, i] = columns.normal[i, 3:]
    step = 1e-6
    for j in range(6):
        e = step * np.eye(6)[j]
        numeric = (g.columns(g.pose(q + e), *where).phi - g.columns(g.pose(q - e), *where).phi) / (
            2 * step
        )
        np.testing.assert_allclose(dense[j], numeric, atol=1e-8)


def test_tangent_columns_are_the_slip_of_material_points():
    g, rng = geometry(), np.random.default_rng(2)
    where = everything(g)
    q, v, dt = rng.normal(size=6), rng.normal(size=6), 1e-6
    pose = g.pose(q)
    columns = g.columns(pose, *where)

    def material_point(body, point, step):
        """Where a point now at `point` on a body is after `step`."""
        if body == GROUND:
            return point
        x, w = q[3 * body : 3 * body + 2], v[3 * body : 3 * body + 3]
        c, s = np.cos(step * w[2]), np.sin(step * w[2])
        return x + step * w[:2] + np.array([[c, -s], [s, c]]) @ (point - x)

    for i, (a, b) in enumerate(columns.bodies):
        p = pose.corners[where[0][i], :2]
        slip = [material_point(a, p, s) - material_point(b, p, s) for s in (dt, -dt)]
        speed = columns.tangent[i, :3] @ v[3 * a : 3 * a + 3]
        if b != GROUND:
            speed += columns.tangent[i, 3:] @ v[3 * b : 3 * b + 3]
        assert speed == pytest.approx(
            columns.tangent[i, :2] @ (slip[0] - slip[1]) / (2 * dt), abs=1e-7
        )


def test_clearance_is_negative_inside_and_positive_outside():
    g = Geometry((box(2.0, 2.0), box(1.0, 1.0)), ())
    corner, part = np.array([6]), np.array([0])  # top right corner of the small box
    inside = g.pose(np.array([0, 0, 0, -0.2, 0.1, 0.0]))
    outside = g.pose(np.array([0, 0, 0, 2.0, 0.1, 0.0]))
    assert g.clearance(inside, corner, part)[0] == pytest.approx(0.6 - 1.0)
    assert g.clearance(outside, corner, part)[0] == pytest.approx(1.5)


def test_a_drifted_corner_is_still_on_its_own_edge():
    """A corner 1e-5 inside the lower edge that passes the end of the side wall (wrong edge)."""
    g = Geometry((box(2.0, 1.0), box(2.0, 1.0)), ())
    # box 2 lies on box 1, 1e-5 too deep; its left bottom corner has just passed box 1's left side
    q = np.array([0, 0.5, 0, 1e-7, 1.5 - 1e-5, 0])
    corner = 4
    phi = g.distances(g.pose(q), np.array([corner]), np.array([0]))[0]
    assert phi.argmax() == 3, "by clearance alone it would be the side wall"
    assert g.hit_edge(g.pose(q), corner, 0) == 2


@pytest.mark.parametrize("seed", range(5))
def test_near_pairs_equal_the_double_loop(seed):
    rng = np.random.default_rng(seed)
    g = Geometry([box(1, 1) for _ in range(30)], (HalfPlane(), HalfPlane((-6, 0), (1, 0))))
    q = np.column_stack([rng.uniform(-5, 5, (30, 2)), rng.uniform(0, 3, 30)]).ravel()
    pose, margin = g.pose(q), 0.3
    boxes = pose.corners[:, :2].reshape(30, 4, 2)
    low, high = boxes.min(axis=1), boxes.max(axis=1)
    expected = [
        (p, r)
        for p in range(30)
        for r in range(p + 1, 30)
        if (low[p] <= high[r] + margin).all() and (low[r] <= high[p] + margin).all()
    ]
    expected += [(p, 30) for p in range(30) if low[p, 1] <= margin]
    expected += [(p, 31) for p in range(30) if low[p, 0] + 6 <= margin]
    assert g.near_pairs(pose, margin) == sorted(expected)
    corner, part = np.indices((120, 32)).reshape(2, -1)
    near = (corner // 4 != part) & (g.clearance(pose, corner, part) <= margin)
    found = zip(*(a.tolist() for a in g.near_corners(pose, margin)), strict=True)
    assert sorted(found) == list(zip(corner[near].tolist(), part[near].tolist(), strict=True))


def test_penetration_depth():
    g = Geometry((box(2, 2), box(2, 2)), ())
    assert g.penetration(g.pose(np.array([0, 0, 0, 1.9, 0.5, 0])), (0, 1)) == pytest.approx(0.1)
    assert g.penetration(g.pose(np.array([0, 0, 0, 2.3, 0.5, 0])), (0, 1)) == pytest.approx(-0.3)


# --- the constraint graph ------------------------------------------------------------------------

FLUSH = np.array([0, 0.5, 0, 0, 1.5, 0])
BOXES = (box(1.0, 1.0), box(1.0, 1.0))


def test_edge_to_edge_is_two_normals_and_one_friction():
    g = graph(bodies=BOXES)
    pose = g.geometry.pose(FLUSH)
    assert g.insert(pose, 4, 0, 2) is not None
    assert g.insert(pose, 5, 0, 2) is not None
    assert g.insert(pose, 3, 1, 0) is None, "coincides with corner 4"
    assert g.insert(pose, 2, 1, 0) is None
    assert len(g.active()) == 2
    assert len(g.active_set().frictions) == 1
    assembly = Assembly(g, FLUSH)
    np.testing.assert_array_equal(assembly.friction_of, [0, 0])
    assert assembly.G_N.shape == (6, 2)
    assert assembly.G_F.shape == (6, 1)


def test_coincident_corners_have_equal_columns():
    """What makes a hand-over free of events: both descriptions give the same columns."""
    g = Geometry(BOXES, ())
    one = g.columns(g.pose(FLUSH), np.array([4]), np.array([0]), np.array([2]))
    other = g.columns(g.pose(FLUSH), np.array([3]), np.array([1]), np.array([0]))
    swap = [3, 4, 5, 0, 1, 2]
    np.testing.assert_allclose(one.normal[0], other.normal[0][swap], atol=1e-15)
    np.testing.assert_allclose(one.tangent[0], other.tangent[0][swap], atol=1e-15)
    shifted = g.pose(np.array([0, 0.5, 0, 0.4, 1.5, 0]))  # corner 5 has passed the right end
    assert g.partner(shifted, 5, 0, 2, 0) == (2, 1, 0)


def test_nothing_takes_over_from_a_tilted_box():
    g = Geometry(BOXES, ())
    pose = g.pose(np.array([0, 0.5, 0, 1.0, 1.6, 0.3]))
    assert g.partner(pose, 4, 0, 2, 0) is None


def test_insertion_and_deletion_keep_the_graph_consistent():
    rng = np.random.default_rng(3)
    n = 12
    bodies = [box(1.0, 1.0) for _ in range(n)]
    q = np.array([(0, 0.5 + i, 0) for i in range(n)], float).ravel()
    g = graph(bodies=bodies)
    pose = g.geometry.pose(q)
    seen = set()
    for _ in range(400):
        if g.normals and rng.random() < 0.5:
            normal = g.active()[rng.integers(len(g.normals))]
            g.remove(normal, -1e-6)
            assert g.candidates.levels()[normal.corner, normal.part] == -1e-6
        else:
            upper = int(rng.integers(1, n))
            normal = g.insert(pose, 4 * upper + int(rng.integers(2)), upper - 1, 2)
            if normal is not None:
                assert normal.row_id not in seen, "a row_id is never reused"
                seen.add(normal.row_id)
        contacts = [c for group in g.of_pair.values() for c in group]
        assert sum(len(c.normals) for c in contacts) == len(g.normals)
        assert all(c.normals and c.friction.row_id in g.frictions for c in contacts)
        assert len(contacts) == len(g.frictions)
        for body, linked in g.of_body.items():
            assert all(body in g.geometry.part_body[list(c.pair)] for c in linked)
        assert sum(map(len, g.of_body.values())) == 2 * len(contacts)


def candidates(g, before, after):
    """Pairs (corner, part) that are near and free on the way."""
    g.candidates.cover(before, after, g.active_set().place)
    corner, part = (a[g.candidates.free].tolist() for a in (g.candidates.corner, g.candidates.part))
    return set(zip(corner, part, strict=True))


def test_candidates_survive_small_motion_and_are_renewed_by_large():
    g = graph(bodies=BOXES)
    g.candidates.margin = 1.0
    near = np.array([0, 0.51, 0, 0, 1.53, 0.0])
    far = near + np.array([0, 0, 0, 0, 5.0, 0])
    assert {(4, 0), (5, 0), (2, 1), (3, 1), (0, 2), (1, 2)} <= candidates(g, near, near)
    assert candidates(g, far, far) == {(0, 2), (1, 2)}
    # a long step sees what it may hit on the way
    assert {(4, 0), (5, 0)} <= candidates(g, far, near)


def test_active_constraints_are_not_free():
    g = graph(bodies=BOXES)
    near = np.array([0, 0.5, 0, 0, 1.5, 0.0])
    before = candidates(g, near, near)
    g.insert(g.geometry.pose(near), 4, 0, 2)
    assert candidates(g, near, near) == before - {(4, 0)}
    g.remove(g.active()[0], 1e-3)
    assert candidates(g, near, near) == before


def test_reference_level_sinks_with_the_corner_and_is_forgotten_outside():
    near = graph().candidates
    near.set_level(3, 0, -1e-5)
    near.set_level(2, 1, -1e-9)
    near.set_level(2, 1, 0.0)
    near.note_clearances(np.array([-1e-6, 1e-3]))
    assert near.levels() == {(3, 0): -1e-5}
    near.note_clearances(np.array([-1e-4, 1e-3]))
    assert near.levels() == {(3, 0): -1e-4}
    near.note_clearances(np.array([2e-6, -1e-9]))
    assert near.levels() == {(2, 1): -1e-9}


def test_reference_levels_survive_a_new_list():
    g = graph(bodies=BOXES)
    near = np.array([0, 0.5, 0, 0, 1.5, 0.0])
    candidates(g, near, near)
    g.candidates.set_level(4, 0, -1e-6)
    candidates(g, near + np.array([0, 0, 0, 0.4, 0, 0]), near)
    assert g.candidates.levels() == {(4, 0): -1e-6}
