"""The compiled arithmetic of contacts equals its NumPy twins."""

import numpy as np
import pytest
import scipy.sparse as sp

from problems.bodies.bodies import GROUND, box, polygon_body
from problems.bodies.path import Path
from problems.bodies.shapes import cross, rotate_quarter
from problems.contacts.geometry import Geometry, HalfPlane
from problems.contacts.geometry_kernels import (
    clearances,
    column_speeds,
    column_sum,
    compliances,
    contact_columns,
    dense_columns,
    edge_distances,
    own_gains,
    place_corners,
    room_for_columns,
    sparse_columns,
)

BODIES = (box(1.0, 1.0), polygon_body([(0, 0), (2, 0), (1, 1.5)]), box(0.5, 2.0))
EXACT = {"rtol": 1e-13, "atol": 1e-13}


def turned(angle, points):
    c, s = np.cos(angle), np.sin(angle)
    return points @ np.array([[c, s], [-s, c]])


@pytest.fixture(params=range(4))
def case(request):
    """A geometry, a random q, and every (corner, part, edge) of different bodies."""
    geometry = Geometry(BODIES, (HalfPlane((0.1, -0.2), (0.3, 1)),))
    q = np.random.default_rng(request.param).normal(size=9)
    places = np.array(
        [
            (corner, part, edge)
            for corner in range(len(geometry.corner_body))
            for part in range(len(geometry.part_body))
            for edge in range(max(int(geometry.part_size[part]), 1))
            if geometry.corner_body[corner] != geometry.part_body[part]
        ]
    )
    return geometry, q, places


def world(geometry, q):
    """Corners (C, 2), and centre and angle of every body with the ground at the end."""
    state = np.vstack([q.reshape(-1, 3), np.zeros(3)])
    corners = [
        state[b, :2] + turned(state[b, 2], local[:2])
        for b, local in zip(geometry.corner_body, geometry.corner_local, strict=True)
    ]
    return np.array(corners), state


def test_places(case):
    geometry, q, _ = case
    corners, state = world(geometry, q)
    found = place_corners(q, geometry.corner_body, geometry.corner_local)
    no_ovals = np.zeros((len(corners), 3))
    twins = np.hstack([corners, no_ovals]), state[:, :2], np.cos(state[:, 2]), np.sin(state[:, 2])
    for one, twin in zip(found, twins, strict=True):
        np.testing.assert_allclose(one, twin, **EXACT)


def test_distances_and_clearances(case):
    geometry, q, places = case
    corners, state = world(geometry, q)
    corner, part = np.ascontiguousarray(places[:, :2].T)
    body = geometry.part_body[part]
    local = np.array(
        [turned(-state[b, 2], corners[c] - state[b, :2]) for c, b in zip(corner, body, strict=True)]
    )
    phi = (geometry.edge_normal[part] * local[:, None]).sum(axis=2) - geometry.edge_offset[part]
    pose = place_corners(q, geometry.corner_body, geometry.corner_local)
    shape = geometry.part_body, geometry.edge_normal, geometry.edge_offset
    np.testing.assert_allclose(edge_distances(*pose, corner, part, *shape), phi, **EXACT)
    np.testing.assert_allclose(clearances(*pose, corner, part, *shape), phi.max(axis=1), **EXACT)


def test_clearance_along_a_path(case):
    geometry, q, places = case
    rng, h = np.random.default_rng(9), 0.3
    path = Path(q, rng.normal(size=9), rng.normal(size=9))
    corner, part = np.ascontiguousarray(places[:, :2].T)
    twin = geometry.clearance(geometry.pose(path(h)), corner, part)
    found = [geometry.clearance_on_path(path, h, c, p) for c, p in zip(corner, part, strict=True)]
    np.testing.assert_allclose(found, twin, **EXACT)


def test_columns(case):
    geometry, q, places = case
    corners, state = world(geometry, q)
    corner, part, edge = places.T
    a, b = geometry.corner_body[corner], geometry.part_body[part]
    n = np.array(
        [turned(state[j, 2], x) for j, x in zip(b, geometry.edge_normal[part, edge], strict=True)]
    )
    tau = rotate_quarter(n)
    arm_a, arm_b = corners[corner] - state[a, :2], corners[corner] - state[b, :2]
    origin = np.array(
        [turned(state[j, 2], x) for j, x in zip(b, geometry.edge_origin[part, edge], strict=True)]
    )
    pose = place_corners(q, geometry.corner_body, geometry.corner_local)
    phi, g_N, g_F, bodies, along, length = columns = room_for_columns(len(places))
    contact_columns(
        *pose,
        places,
        geometry.corner_body,
        geometry.part_body,
        geometry.edge_normal,
        geometry.edge_offset,
        geometry.edge_start,
        geometry.edge_length,
        columns,
    )
    np.testing.assert_array_equal(length, geometry.edge_length[part, edge])
    offset = geometry.edge_offset[part, edge]
    np.testing.assert_allclose(phi, (n * arm_b).sum(axis=1) - offset, **EXACT)
    np.testing.assert_allclose(along, (tau * (arm_b - origin)).sum(axis=1), **EXACT)
    np.testing.assert_array_equal(bodies, np.column_stack([a, b]))
    for found, axis in ((g_N, n), (g_F, tau)):
        twin = np.column_stack([axis, cross(arm_a, axis), -axis, -cross(arm_b, axis)])
        np.testing.assert_allclose(found, twin, **EXACT)


@pytest.mark.parametrize("seed", range(4))
def test_sums_and_matrices_of_columns(seed):
    rng = np.random.default_rng(seed)
    bodies = np.array([rng.choice(5, 2, replace=False) for _ in range(20)])
    bodies[::4, 1] = GROUND
    entries, v, weights = rng.normal(size=(20, 6)), rng.normal(size=15), rng.normal(size=20)
    entries[3, 2] = 0.0
    D = rng.uniform(1, 2, 15)
    G = np.zeros((15, 20))
    for i, (a, b) in enumerate(bodies):
        G[3 * a : 3 * a + 3, i] = entries[i, :3]
        if b != GROUND:
            G[3 * b : 3 * b + 3, i] = entries[i, 3:]
    np.testing.assert_allclose(column_speeds(entries, bodies, v), G.T @ v, **EXACT)
    np.testing.assert_allclose(column_sum(entries, bodies, weights, 15), G @ weights, **EXACT)
    np.testing.assert_allclose(compliances(entries, bodies, D), (G * G).T @ D, **EXACT)
    tangent = np.roll(entries, 1, axis=1)
    T = np.zeros((15, 20))
    for i, (a, b) in enumerate(bodies):
        T[3 * a : 3 * a + 3, i] = tangent[i, :3]
        if b != GROUND:
            T[3 * b : 3 * b + 3, i] = tangent[i, 3:]
    friction_of, signs = rng.integers(-1, 3, 20), np.array([1.0, 0.0, -1.0])
    mu = rng.uniform(size=3)
    s_mu = np.where(friction_of >= 0, (signs * mu)[friction_of], 0.0)
    gains = -s_mu * ((G * T).T @ D) / ((G * G).T @ D)
    found = own_gains(entries, tangent, bodies, D, friction_of, signs, mu)
    np.testing.assert_allclose(found, gains, **EXACT)
    np.testing.assert_allclose(dense_columns(entries, bodies, D), G / D[:, None], **EXACT)
    A = sp.csc_array(sparse_columns(entries, bodies, D), shape=G.shape)
    assert A.has_canonical_format
    assert A.nnz == 3 * (bodies != GROUND).sum()
    np.testing.assert_allclose(A.toarray(), G / D[:, None], **EXACT)
