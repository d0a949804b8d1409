"""The arithmetic of contacts, compiled: places, clearances, constraint functions, columns.

What the formulas mean is said in `problems.contacts.geometry`; a column is kept as its six entries
for the body of the corner and the body of the edge, and the numbers of these two bodies, −1 for the
ground, which does not move.  What an `arena` is: see `problems.kernels.arena`.

Positions of corners are followed by b and k of the ellipse about them, 0 at polygons' corners; what
is round is in `problems.contacts.round_kernels`.
"""

from __future__ import annotations

import numpy as np

from problems.contacts.round_kernels import is_round, oval_clearance, oval_column, support
from problems.kernels.arena import numbers, table, zeros
from problems.kernels.compiled import kernel


@kernel
def place_corners(q, body, local, arena=None):
    """Corners (C, 5), centres (n+1, 2), cos φ, sin φ (n+1,) at q (3n,); the last is the ground.

    body : (C,);  local : (C, 4) place in the body, b and |k|, that along the x-axis of the body
    """
    n = q.size // 3
    centres, cosine, sine = table(arena, n + 1, 2), numbers(arena, n + 1), numbers(arena, n + 1)
    corners = table(arena, local.shape[0], 5)
    place_into(q, body, local, corners, centres, cosine, sine)
    return corners, centres, cosine, sine


@kernel
def place_into(q, body, local, corners, centres, cosine, sine):
    """The same, written to these."""
    n = q.size // 3
    centres[n, 0], centres[n, 1], cosine[n], sine[n] = 0.0, 0.0, 1.0, 0.0
    for b in range(n):
        centres[b, 0], centres[b, 1] = q[3 * b], q[3 * b + 1]
        cosine[b], sine[b] = np.cos(q[3 * b + 2]), np.sin(q[3 * b + 2])
    for i in range(local.shape[0]):
        b, x, y = body[i], local[i, 0], local[i, 1]
        corners[i, 0] = centres[b, 0] + cosine[b] * x - sine[b] * y
        corners[i, 1] = centres[b, 1] + sine[b] * x + cosine[b] * y
        corners[i, 2] = local[i, 2]
        corners[i, 3], corners[i, 4] = cosine[b] * local[i, 3], sine[b] * local[i, 3]


@kernel
def oval_from(corners, centres, cosine, sine, i, b):
    """The oval about corner i, x, y, b, k_x, k_y, in the coordinates of body b."""
    x, y = corners[i, 0] - centres[b, 0], corners[i, 1] - centres[b, 1]
    c, s, k_x, k_y = cosine[b], sine[b], corners[i, 3], corners[i, 4]
    return c * x + s * y, c * y - s * x, corners[i, 2], c * k_x + s * k_y, c * k_y - s * k_x


@kernel
def edge_distances(corners, centres, cosine, sine, corner, part, part_body, normal, offset):
    """φ of each corner against every edge of its part, (N, E); −inf where there is no edge.

    Edges are endless here: beyond the ends of an edge what is round may be farther off than that.
    """
    phi = np.empty((corner.size, offset.shape[1]))
    for i in range(corner.size):
        p = part[i]
        b = part_body[p]
        x, y = corners[corner[i], 0] - centres[b, 0], corners[corner[i], 1] - centres[b, 1]
        local_x, local_y = cosine[b] * x + sine[b] * y, cosine[b] * y - sine[b] * x
        for e in range(offset.shape[1]):
            phi[i, e] = normal[p, e, 0] * local_x + normal[p, e, 1] * local_y - offset[p, e]
        if corners[corner[i], 2] == 0.0 and not is_round(normal[p], 0):
            continue
        oval = oval_from(corners, centres, cosine, sine, corner[i], b)
        if is_round(normal[p], 0):
            phi[i] = -np.inf
            phi[i, 0] = oval_clearance(oval, normal[p], offset[p])[0]
            continue
        for e in range(offset.shape[1]):
            n_x, n_y = normal[p, e, 0], normal[p, e, 1]
            phi[i, e] -= support(n_x, n_y, oval[2], oval[3], oval[4])[0]
    return phi


@kernel
def clearances(corners, centres, cosine, sine, corner, part, part_body, normal, offset, phi=None):
    """max_e φ_e of each corner against its part, (N,), written to phi; the distance of what is
    round."""
    if phi is None:
        phi = np.empty(corner.size)
    for i in range(corner.size):
        p = part[i]
        b = part_body[p]
        x, y = corners[corner[i], 0] - centres[b, 0], corners[corner[i], 1] - centres[b, 1]
        local_x, local_y = cosine[b] * x + sine[b] * y, cosine[b] * y - sine[b] * x
        if corners[corner[i], 2] > 0.0 or is_round(normal[p], 0):
            oval = oval_from(corners, centres, cosine, sine, corner[i], b)
            phi[i] = oval_clearance(oval, normal[p], offset[p])[0]
            continue
        most = -np.inf
        for e in range(offset.shape[1]):
            value = normal[p, e, 0] * local_x + normal[p, e, 1] * local_y - offset[p, e]
            most = max(most, value)
        phi[i] = most
    return phi


@kernel
def clearance_on_path(path, h, corner, part, tables):
    """`clearances` of one corner and one part at q + h (velocity + h curvature).

    path : q, velocity, curvature;  tables : `Geometry.tables`
    """
    q, velocity, curvature = path
    corner_body, corner_local, part_body, normal, offset = tables[:5]
    state = np.zeros((2, 3))
    for side in range(2):
        b = corner_body[corner] if side == 0 else part_body[part]
        if b >= 0:
            for j in range(3):
                i = 3 * b + j
                state[side, j] = q[i] + h * (velocity[i] + h * curvature[i])
    c, s = np.cos(state[0, 2]), np.sin(state[0, 2])
    k_x, k_y = c * corner_local[corner, 3], s * corner_local[corner, 3]
    x = state[0, 0] + c * corner_local[corner, 0] - s * corner_local[corner, 1] - state[1, 0]
    y = state[0, 1] + s * corner_local[corner, 0] + c * corner_local[corner, 1] - state[1, 1]
    c, s = np.cos(state[1, 2]), np.sin(state[1, 2])
    local_x, local_y = c * x + s * y, c * y - s * x
    if corner_local[corner, 2] > 0.0 or is_round(normal[part], 0):
        oval = local_x, local_y, corner_local[corner, 2], c * k_x + s * k_y, c * k_y - s * k_x
        return oval_clearance(oval, normal[part], offset[part])[0]
    most = -np.inf
    for e in range(offset.shape[1]):
        value = normal[part, e, 0] * local_x + normal[part, e, 1] * local_y - offset[part, e]
        most = max(most, value)
    return most


@kernel
def past_tip(phi, edge):
    """Whether a corner with φ (E,) to the edges of a part is inside `edge`, and less so of another.

    See `Geometry.past_tip`.
    """
    return phi[edge] < min(0.0, phi.max())


@kernel
def least_overlap(pose, one, two, enough, parts, edges):
    """By how far two convex parts overlap [m], and the corner, part and edge of that axis.

    Of all edges of both the one whose deepest corner of the other part is the least deep; less
    than 0 where it keeps them apart.  An edge where they overlap by less than `enough` ends the
    search.

    pose : see `place_corners`;  parts : first corner, size and body of each part
    edges : normals (parts, E, 2) and offsets (parts, E)

    Of what is round: by how far it is inside the other part, which is the second where both are;
    the edge may be a corner then, see `nearest_feature`.
    """
    corners, centres, cosine, sine = pose
    (first, size, part_body), (normal, offset) = parts, edges
    if size[one] == 1 or size[two] == 1:
        p, other = (two, one) if size[one] == 1 else (one, two)
        if size[p] == 1:
            p, other = max(one, two), min(one, two)
        oval = oval_from(corners, centres, cosine, sine, first[other], part_body[p])
        phi, edge = oval_clearance(oval, normal[p], offset[p])
        return -phi, first[other], p, edge
    least, corner, part, edge = np.inf, -1, -1, -1
    for turn in range(2):
        p, other = (one, two) if turn == 0 else (two, one)
        if size[other] == 0:
            continue
        b = part_body[p]
        for e in range(max(size[p], 1)):
            x, y = normal[p, e, 0], normal[p, e, 1]
            nx, ny = cosine[b] * x - sine[b] * y, sine[b] * x + cosine[b] * y
            low, lowest = np.inf, -1
            for c in range(first[other], first[other] + size[other]):
                phi = nx * (corners[c, 0] - centres[b, 0]) + ny * (corners[c, 1] - centres[b, 1])
                if phi < low:
                    low, lowest = phi, c
            depth = offset[p, e] - low
            if depth < least:
                least, corner, part, edge = depth, lowest, p, e
            if least < enough:
                return least, corner, part, edge
    return least, corner, part, edge


@kernel
def contact_columns(
    corners,
    centres,
    cosine,
    sine,
    places,
    corner_body,
    part_body,
    normal,
    offset,
    start,
    length,
    columns,
):
    """`Columns` of places (N, 3): φ, g_N, g_F (N, 6), bodies (N, 2), along, length.

    columns : what they are written to
    """
    phi, g_N, g_F, bodies, along, lengths = columns
    for i in range(places.shape[0]):
        corner, p, e = places[i, 0], places[i, 1], places[i, 2]
        a, b = corner_body[corner], part_body[p]
        c, s = cosine[b], sine[b]
        if corners[corner, 2] > 0.0:
            edges = normal[p], offset[p], start[p], length[p]
            arm = corners[corner, 0] - centres[b, 0], corners[corner, 1] - centres[b, 1]
            oval = oval_from(corners, centres, cosine, sine, corner, b)
            phi[i], along[i], lengths[i] = oval_column(oval, arm, (c, s), e, edges, g_N[i], g_F[i])
            bodies[i, 0], bodies[i, 1] = a, b
            continue
        x, y = normal[p, e, 0], normal[p, e, 1]
        nx, ny = c * x - s * y, s * x + c * y
        ax, ay = corners[corner, 0] - centres[a, 0], corners[corner, 1] - centres[a, 1]
        bx, by = corners[corner, 0] - centres[b, 0], corners[corner, 1] - centres[b, 1]
        phi[i] = nx * bx + ny * by - offset[p, e]
        along[i] = nx * by - ny * bx - start[p, e]
        lengths[i] = length[p, e]
        g_N[i, 0], g_N[i, 1], g_N[i, 2] = nx, ny, ax * ny - ay * nx
        g_N[i, 3], g_N[i, 4], g_N[i, 5] = -nx, -ny, by * nx - bx * ny
        g_F[i, 0], g_F[i, 1], g_F[i, 2] = -ny, nx, ax * nx + ay * ny
        g_F[i, 3], g_F[i, 4], g_F[i, 5] = ny, -nx, -bx * nx - by * ny
        bodies[i, 0], bodies[i, 1] = a, b


@kernel
def room_for_columns(count):
    """φ, g_N, g_F, bodies, along and length of so many columns, of any value."""
    six, two = (count, 6), np.empty((count, 2), np.int64)
    gap, at, size = np.empty(count), np.empty(count), np.empty(count)
    return gap, np.empty(six), np.empty(six), two, at, size


@kernel
def column_speeds(entries, bodies, v, arena=None):
    """gᵀ v of each column, (N,)."""
    speed = zeros(arena, bodies.shape[0])
    for i in range(bodies.shape[0]):
        for side in range(2):
            b = bodies[i, side]
            if b >= 0:
                for j in range(3):
                    speed[i] += entries[i, 3 * side + j] * v[3 * b + j]
    return speed


@kernel
def compliances(entries, bodies, inverse_mass, arena=None):
    """gᵀ M⁻¹ g of each column, (N,)."""
    square = zeros(arena, bodies.shape[0])
    for i in range(bodies.shape[0]):
        for side in range(2):
            b = bodies[i, side]
            if b >= 0:
                for j in range(3):
                    square[i] += entries[i, 3 * side + j] ** 2 * inverse_mass[3 * b + j]
    return square


@kernel
def column_product(entries, bodies, i, f, inverse_mass):
    """gᵀ M⁻¹ f of column i with a vector (m,)."""
    product = 0.0
    for side in range(2):
        b = bodies[i, side]
        if b >= 0:
            for j in range(3):
                product += entries[i, 3 * side + j] * f[3 * b + j] * inverse_mass[3 * b + j]
    return product


@kernel
def columns_product(entries, bodies, i, others, their_bodies, l, inverse_mass):
    """gᵀ M⁻¹ g of column i of these and column l of others."""
    product = 0.0
    for side in range(2):
        b = bodies[i, side]
        if b < 0:
            continue
        for other in range(2):
            if their_bodies[l, other] == b:
                for j in range(3):
                    scaled = entries[i, 3 * side + j] * inverse_mass[3 * b + j]
                    product += scaled * others[l, 3 * other + j]
    return product


@kernel
def own_gains(normal, tangent, bodies, inverse_mass, friction_of, signs, mu, arena=None):
    """γ = −μ s (g_NᵀM⁻¹g_F)/(g_NᵀM⁻¹g_N) of each normal whose contact slides, else 0, (N,)."""
    gain = zeros(arena, bodies.shape[0])
    for i in range(bodies.shape[0]):
        j = friction_of[i]
        if j < 0 or signs[j] == 0:
            continue
        square, product = 0.0, 0.0
        for side in range(2):
            b = bodies[i, side]
            if b >= 0:
                for e in range(3):
                    scaled = normal[i, 3 * side + e] * inverse_mass[3 * b + e]
                    square += scaled * normal[i, 3 * side + e]
                    product += scaled * tangent[i, 3 * side + e]
        gain[i] = -mu[j] * signs[j] * product / square
    return gain


@kernel
def column_sum(entries, bodies, weights, m, arena=None):
    """Σ g weight, (m,)."""
    total = zeros(arena, m)
    for i in range(bodies.shape[0]):
        for side in range(2):
            b = bodies[i, side]
            if b >= 0:
                for j in range(3):
                    total[3 * b + j] += entries[i, 3 * side + j] * weights[i]
    return total


@kernel
def gather_columns(normal, tangent, bodies, row, tangential, entries, where):
    """Columns that are g_F or g_N of these rows: entries (k, 6) and bodies (k, 2) are written."""
    for c in range(row.size):
        i = row[c]
        source = tangent if tangential[c] else normal
        for j in range(6):
            entries[c, j] = source[i, j]
        where[c, 0], where[c, 1] = bodies[i, 0], bodies[i, 1]


@kernel
def rows_of(entries, bodies, row, found, where):
    """Entries (F, 6) and bodies (F, 2) of these rows (F,) of others are written to the last two."""
    for c in range(row.size):
        for j in range(6):
            found[c, j] = entries[row[c], j]
        where[c, 0], where[c, 1] = bodies[row[c], 0], bodies[row[c], 1]


@kernel
def dense_columns(entries, bodies, D, A=None):
    """D⁻ᵀ G as a matrix (m, N).

    A : what it is written to, zeros or a G of the same bodies
    """
    if A is None:
        A = np.zeros((D.size, bodies.shape[0]))
    for i in range(bodies.shape[0]):
        for side in range(2):
            b = bodies[i, side]
            if b >= 0:
                for j in range(3):
                    A[3 * b + j, i] = entries[i, 3 * side + j] / D[3 * b + j]
    return A


@kernel
def sparse_columns(entries, bodies, D):
    """D⁻ᵀ G in CSC: data, row indices in order, column pointers.  Zeros stay in the pattern."""
    count = bodies.shape[0]
    pointers = np.zeros(count + 1, dtype=np.int32)
    for i in range(count):
        pointers[i + 1] = pointers[i] + 3 * ((bodies[i, 0] >= 0) + (bodies[i, 1] >= 0))
    data, rows = np.empty(pointers[count]), np.empty(pointers[count], dtype=np.int32)
    for i in range(count):
        at = pointers[i]
        first = 0 if bodies[i, 0] <= bodies[i, 1] else 1
        for side in (first, 1 - first):
            b = bodies[i, side]
            if b >= 0:
                for j in range(3):
                    rows[at] = 3 * b + j
                    data[at] = entries[i, 3 * side + j] / D[3 * b + j]
                    at += 1
    return data, rows, pointers
