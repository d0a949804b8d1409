"""Discs and ellipses, compiled: how far they are from a part, and what of it is nearest.

An ellipse with the semi-axes a ≥ b has the focal vector k along its major axis, |k|² = a² − b².  It
reaches from its centre, in a direction n with |n| = 1, as far as its support function says; with
τ = J n and h' its derivative as n turns,

    h(n) = √(b² + (n·k)²)    h' = (n·k)(τ·k)/h    h + h'' = a²b²/h³, the radius of curvature

and the point h n + h' τ from its centre is what reaches there.  A disc has k = 0 and h = b; a point
has b = 0, too.  An `oval` is either of the two bodies: x, y, b, k_x, k_y in the coordinates of the
body of the part that it is near.

From an edge with the normal n its distance is n·c − offset − h(n).  From a point or another oval
about the origin, with the support function H, it is the greatest of

    F(n) = n·c − H(n) − h(n),    F' = τ·c − H' − h',    F'' = −F − (the radii of curvature of both)

which is negative where they overlap.  Where F > 0 it has one maximum; the largest of all is within
a quarter turn of c, as F(n) − F(−n) = 2 n·c.  A flat ellipse bends F sharply where n is
perpendicular to its k, between the two directions of h'' = 0, and hardly elsewhere: from one such
direction to the next F' falls from above 0 to below once at most, and Newton's method in a bracket
finds where (`direction_apart`).

A round part of a body has the normal (0, 0), b as its first offset, and |k| as its second unless it
is a disc: its body's x-axis is its major axis.
"""

from __future__ import annotations

import numpy as np

from problems.kernels.compiled import kernel

MOST_TURNS = 100
"""Of n in search of a maximum; Newton's method takes ten."""
FINE = 1e-15
"""Turn of n that changes nothing any more [rad]."""


@kernel
def is_round(normal, e):
    """Whether edge e of a part with normals (E, 2) is the periphery of a disc or an ellipse, or
    none at all."""
    return normal[e, 0] == 0.0 and normal[e, 1] == 0.0


@kernel
def edges_of(offset):
    """How many edges a part with offsets (E,) has."""
    count = 0
    while count < offset.size and offset[count] < np.inf:
        count += 1
    return count


@kernel
def focal_length(offset):
    """|k| of a round part with offsets (E,) [m], 0 of a disc."""
    return offset[1] if offset.size > 1 and offset[1] < np.inf else 0.0


@kernel
def is_oblong(oval, normal, offset):
    """Whether an oval or the part that it is near is an ellipse, and no disc."""
    return oval[3] != 0.0 or oval[4] != 0.0 or (is_round(normal, 0) and focal_length(offset) > 0.0)


@kernel
def turn_between(x, y, other_x, other_y):
    """Angle from one direction of the plane to another, −π to π."""
    return np.arctan2(x * other_y - y * other_x, x * other_x + y * other_y)


@kernel
def corner_at(i, normal, offset, start):
    """Corner i of a part, where edge i begins, in the coordinates of its body."""
    x, y = normal[i, 0], normal[i, 1]
    return offset[i] * x - start[i] * y, offset[i] * y + start[i] * x


@kernel
def corner_between(before, i, normal, offset):
    """The same, where the edge before it and edge i meet: n·p of both are their offsets."""
    x_0, y_0, x_1, y_1 = normal[before, 0], normal[before, 1], normal[i, 0], normal[i, 1]
    sine = x_0 * y_1 - y_0 * x_1
    x = (offset[before] * y_1 - offset[i] * y_0) / sine
    return x, (offset[i] * x_0 - offset[before] * x_1) / sine


# --- ellipses ------------------------------------------------------------------------------------


@kernel
def support(n_x, n_y, b, k_x, k_y):
    """h(n) and h' of an ellipse [m]."""
    if k_x == 0.0 and k_y == 0.0:
        return b, 0.0
    along, across = n_x * k_x + n_y * k_y, n_x * k_y - n_y * k_x
    h = np.sqrt(b * b + along * along)
    return h, along * across / h


@kernel
def curvature_radius(h, b, k_x, k_y):
    """a²b²/h³ [m], 0 of a point."""
    return (b * b + k_x * k_x + k_y * k_y) * b * b / (h * h * h) if b > 0.0 else 0.0


@kernel
def separation(angle, oval, b, k):
    """F, F' and F'' of an oval and one about the origin, b and |k| along x, at n of this angle."""
    x, y, own_b, k_x, k_y = oval
    n_x, n_y = np.cos(angle), np.sin(angle)
    one, one_turned = support(n_x, n_y, own_b, k_x, k_y)
    two, two_turned = support(n_x, n_y, b, k, 0.0)
    F = n_x * x + n_y * y - one - two
    radii = curvature_radius(one, own_b, k_x, k_y) + curvature_radius(two, b, k, 0.0)
    return F, n_x * y - n_y * x - one_turned - two_turned, -F - radii


@kernel
def highest(low, high, oval, b, k):
    """The angle between `low`, where F' > 0, and `high`, where F' ≤ 0, at which it is 0."""
    angle = 0.5 * (low + high)
    for _ in range(MOST_TURNS):
        _, first, second = separation(angle, oval, b, k)
        if first > 0.0:
            low = angle
        else:
            high = angle
        turned = angle - first / second if second < 0.0 else high
        if not low < turned < high:
            turned = 0.5 * (low + high) if first != 0.0 else angle
        if abs(turned - angle) <= FINE:
            return turned
        angle = turned
    return angle


@kernel
def inflections(b, k_x, k_y, start):
    """The turns of n from the angle `start`, 0 to π, at which h'' = 0; 0 of a disc.

    |n·k|² = b(a − b) there, so that n is arcsin √(b/(a + b)) from what is perpendicular to k.
    """
    k = np.hypot(k_x, k_y)
    if k == 0.0:
        return 0.0, 0.0
    middle = np.arctan2(k_y, k_x) + 0.5 * np.pi - start
    off = np.arcsin(np.sqrt(b / (np.sqrt(b * b + k * k) + b)))
    return (middle - off) % np.pi, (middle + off) % np.pi


@kernel
def direction_apart(oval, b, k):
    """n along which an oval is the farthest from one about the origin, b and |k| along x."""
    start = np.arctan2(oval[1], oval[0]) - 0.5 * np.pi
    one, two = inflections(oval[2], oval[3], oval[4], start)
    three, four = inflections(b, k, 0.0, start)
    best, most = start + 0.5 * np.pi, -np.inf
    low, before = 0.0, separation(start, oval, b, k)[1]
    while low < np.pi:
        high = np.pi
        for turn in (one, two, three, four):
            if low < turn < high:
                high = turn
        after = separation(start + high, oval, b, k)[1]
        if before > 0.0 >= after:
            angle = highest(start + low, start + high, oval, b, k)
            value = separation(angle, oval, b, k)[0]
            if value > most:
                best, most = angle, value
        low, before = high, after
    return np.cos(best), np.sin(best)


@kernel
def direction_between(oval, one, two):
    """Whether there is an n between two others, (2,), along which an oval is the farthest from a
    point at the origin, and n.

    It is the farthest of all unless the point is deep in the oval.
    """
    n_x, n_y = direction_apart(oval, 0.0, 0.0)
    if one[0] * n_y >= one[1] * n_x and n_x * two[1] >= n_y * two[0]:
        return True, n_x, n_y
    low = np.arctan2(one[1], one[0])
    high = low + turn_between(one[0], one[1], two[0], two[1])
    if not separation(low, oval, 0.0, 0.0)[1] > 0.0 >= separation(high, oval, 0.0, 0.0)[1]:
        return False, n_x, n_y
    angle = highest(low, high, oval, 0.0, 0.0)
    return True, np.cos(angle), np.sin(angle)


@kernel
def edge_touched(oval, e, normal):
    """n·s and τ·s of what of an oval is nearest to the line of edge e, with the normal n of that.

    Less the offset of the edge the first is the distance.
    """
    x, y, b, k_x, k_y = oval
    n_x, n_y = normal[e, 0], normal[e, 1]
    h, turned = support(n_x, n_y, b, k_x, k_y)
    return n_x * x + n_y * y - h, n_x * y - n_y * x - turned


@kernel
def nearest_to_oblong(oval, normal, offset):
    """φ of an oval and a part of which one is an ellipse [m], what of the part is nearest, and n.

    See `nearest_feature` for the second.  What touches an edge is on it where the normal of the
    edge is a maximum of F, with H the support function of the whole part.  If that is positive it
    is the only one.
    """
    x, y, b, k_x, k_y = oval
    if is_round(normal, 0):
        k = focal_length(offset)
        n_x, n_y = direction_apart(oval, offset[0], k)
        reach = support(n_x, n_y, b, k_x, k_y)[0] + support(n_x, n_y, offset[0], k, 0.0)[0]
        return n_x * x + n_y * y - reach, 0, n_x, n_y
    count, E = edges_of(offset), offset.size
    nearest, most, farthest, out = -1, -np.inf, 0, -np.inf
    for e in range(count):
        height, along = edge_touched(oval, e, normal)
        value, n_x, n_y = height - offset[e], normal[e, 0], normal[e, 1]
        s_x, s_y = height * n_x - along * n_y, height * n_y + along * n_x
        on = value > most
        for other in ((e + 1) % count, (e - 1) % count):
            on = on and (count < 2 or past_corner(s_x, s_y, value, e, other, normal, offset) <= 0.0)
        if on:
            nearest, most = e, value
        if value > out:
            farthest, out = e, value
    n_x, n_y = normal[max(nearest, 0), 0], normal[max(nearest, 0), 1]
    if most <= 0.0 and count > 1:
        for i in range(count):
            before = (i - 1) % count
            p_x, p_y = corner_between(before, i, normal, offset)
            away = x - p_x, y - p_y, b, k_x, k_y
            if np.hypot(away[0], away[1]) - b <= most:
                continue
            found, u_x, u_y = direction_between(away, normal[before], normal[i])
            value = u_x * away[0] + u_y * away[1] - support(u_x, u_y, b, k_x, k_y)[0]
            if found and value > most:
                nearest, most, n_x, n_y = E + i, value, u_x, u_y
    if nearest < 0:  # an edge, at its end to rounding
        return out, farthest, normal[farthest, 0], normal[farthest, 1]
    return most, nearest, n_x, n_y


# --- discs and ellipses --------------------------------------------------------------------------


@kernel
def past_corner(x, y, distance, e, other, normal, offset):
    """How far the foot of the point (x, y) on edge e is beyond its common corner with another [m].

    distance : φ_e of the point.  With φ_o that from the other edge and α the turn from one to the
    other, it is (φ_o − φ_e cos α)/|sin α|.
    """
    cosine = normal[e, 0] * normal[other, 0] + normal[e, 1] * normal[other, 1]
    sine = normal[e, 0] * normal[other, 1] - normal[e, 1] * normal[other, 0]
    value = normal[other, 0] * x + normal[other, 1] * y - offset[other]
    return (value - distance * cosine) / abs(sine)


@kernel
def nearest_feature(x, y, normal, offset):
    """Distance of the point (x, y) from a part [m], below 0 inside, and what of it is nearest.

    x, y : in the coordinates of the part's body;  normal (E, 2), offset (E,) : its edges

    The part is no ellipse.  The second is an edge, or E + i for corner i, at which edge i begins:
    where the foot of the point is beyond it by t, its distance from the corner is √(φ_e² + t²).
    """
    if is_round(normal, 0):
        return np.hypot(x, y) - offset[0], 0
    count, E = edges_of(offset), offset.size
    best, most = 0, -np.inf
    for e in range(count):
        value = normal[e, 0] * x + normal[e, 1] * y - offset[e]
        if value > most:
            best, most = e, value
    if most <= 0.0 or count < 2:
        return most, best
    for turn in range(2):
        other = (best + 1) % count if turn == 0 else (best - 1) % count
        beyond = past_corner(x, y, most, best, other, normal, offset)
        if beyond > 0.0:
            return np.hypot(most, beyond), E + (other if turn == 0 else best)
    return most, best


@kernel
def oval_clearance(oval, normal, offset):
    """φ of an oval and a part [m], and what of the part is nearest, see `nearest_feature`."""
    if is_oblong(oval, normal, offset):
        phi, e, _, _ = nearest_to_oblong(oval, normal, offset)
        return phi, e
    distance, e = nearest_feature(oval[0], oval[1], normal, offset)
    return distance - oval[2], e


@kernel
def round_place(oval, e, normal, offset, start):
    """n, n·c − H(n), along and length of an oval at a round part or at a corner of a part.

    e : see `nearest_feature`;  normal, offset, start : (E, …) of the part

    At a corner `along` is the turn of n since the edge before it, and `length` that to the edge
    after it, in units of b.
    """
    x, y, b, _, _ = oval
    if e < offset.size:
        x_0, y_0, rim, k = 0.0, 0.0, offset[0], focal_length(offset)
    else:
        (x_0, y_0), rim, k = corner_at(e - offset.size, normal, offset, start), 0.0, 0.0
    away = x - x_0, y - y_0, b, oval[3], oval[4]
    distance = np.hypot(x - x_0, y - y_0)
    if oval[3] != 0.0 or oval[4] != 0.0 or k != 0.0:
        nx, ny = direction_apart(away, rim, k)
        distance = nx * away[0] + ny * away[1]
        rim = support(nx, ny, rim, k, 0.0)[0]
    elif distance > 0.0:
        nx, ny = (x - x_0) / distance, (y - y_0) / distance
    else:
        nx, ny = 0.0, 1.0
    if e < offset.size:
        return nx, ny, distance - rim, 0.0, np.inf
    after = e - offset.size
    before = (after - 1) % edges_of(offset)
    bx, by = normal[before, 0], normal[before, 1]
    along = b * turn_between(bx, by, nx, ny)
    return nx, ny, distance, along, b * turn_between(bx, by, normal[after, 0], normal[after, 1])


@kernel
def oval_column(oval, arm, turn, e, edges, g_N, g_F):
    """φ, along and length of an oval at e of a part, see `nearest_feature`; g_N, g_F (6,).

    arm : from the centre of the part's body to the oval's;  turn : cos φ and sin φ of that body
    edges : normals (E, 2), offsets, starts, lengths (E,)

    What touches is s = c − h n − h' τ;  r_a = s − c, r_b = arm + r_a.
    """
    (bx, by), (c, s), (normal, offset, start, length) = arm, turn, edges
    x, y, b, k_x, k_y = oval
    if e >= offset.size or is_round(normal, e):
        x, y, distance, along, size = round_place(oval, e, normal, offset, start)
    else:
        distance = normal[e, 0] * x + normal[e, 1] * y - offset[e]
        along, size = normal[e, 0] * y - normal[e, 1] * x - start[e], length[e]
        x, y = normal[e, 0], normal[e, 1]
    nx, ny = c * x - s * y, s * x + c * y
    h, turned = support(x, y, b, k_x, k_y)
    g_N[0], g_N[1], g_N[2] = nx, ny, 0.0
    g_N[3], g_N[4], g_N[5] = -nx, -ny, by * nx - bx * ny
    g_F[0], g_F[1], g_F[2] = -ny, nx, -h
    g_F[3], g_F[4], g_F[5] = ny, -nx, h - bx * nx - by * ny
    if turned != 0.0:
        g_N[2] = turned
        g_N[5] -= turned
        if e < offset.size and not is_round(normal, e):
            along -= turned
    return distance - h, along, size
