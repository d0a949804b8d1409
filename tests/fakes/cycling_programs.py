"""Linear programs on which the simplex method goes round for ever, and its ways round.

Most were collected by Gass and Vinjamuri 2004, Cycling in linear programming problems, Computers
and Operations Research 31.  That the data are right is a test's matter: each must have a cycle.
"""

from __future__ import annotations

from functools import cache
from math import cos, pi, sin, tan

import numpy as np

from problems.qp import Vector

Program = tuple[Vector, Vector, Vector, tuple[int, ...]]
"""E, b, c and a basis of the cycle: minimise cᵀx subject to E x = b, x ≥ 0."""


def hoffman() -> Program:
    """Hoffman 1953, Cycling in the simplex algorithm, Nat. Bureau of Standards report 2974.

    Five pairs of columns that turn by θ = 2π/5; w = 2.
    """
    theta, w = 2 * pi / 5, 2.0
    columns = [(1.0, 0.0, 0.0)]
    for i in range(5):
        c, s = cos(i * theta), sin(i * theta)
        columns += [(0.0, c, tan(theta) * s / w), (0.0, -w * s / tan(theta), c)]
    cost = [0, 0, 0, -(1 - cos(theta)) / cos(theta), w, 0, 2 * w, 4 * sin(theta) ** 2]
    cost += [-2 * w * cos(2 * theta), 4 * sin(theta) ** 2, w * (1 - 2 * cos(theta))]
    return np.array(columns).T, np.array([1.0, 0.0, 0.0]), np.array(cost, float), (0, 1, 2)


def program(rows: list[list[float]], cost: list[float], *basis: int) -> Program:
    """Each row ends with its right-hand side."""
    data = np.array(rows, float)
    return data[:, :-1], data[:, -1], np.array(cost, float), basis


PROGRAMS: dict[str, Program] = {
    "Hoffman 1953": hoffman(),
    # Beale 1955, Cycling in the dual simplex algorithm, Naval Research Logistics Quarterly 2
    "Beale 1955": program(
        [[1 / 4, -60, -1 / 25, 9, 1, 0, 0, 0],
         [1 / 2, -90, -1 / 50, 3, 0, 1, 0, 0],
         [0, 0, 1, 0, 0, 0, 1, 1]],
        [-3 / 4, 150, -1 / 50, 6, 0, 0, 0], 4, 5, 6),
    # Yudin and Gol'shtein 1965, Linear programming; two examples
    "Yudin 1965 a": program(
        [[1, 0, 2, -3, -5, 6, 0, 0],
         [0, 1, 6, -5, -3, 2, 0, 0],
         [0, 0, 3, 1, 2, 4, 1, 1]],
        [0, 0, -1, 1, -1, 1, 0], 0, 1, 6),
    "Yudin 1965 b": program(
        [[1, 0, 1, -2, -3, 4, 0, 0],
         [0, 1, 4, -3, -2, 1, 0, 0],
         [0, 0, 1, 1, 1, 1, 1, 1]],
        [0, 0, -1, 1, -1, 1, 0], 0, 1, 6),
    # Kuhn, in Balinski and Tucker 1969, Duality theory of linear programs, SIAM Review 11
    "Kuhn 1969": program(
        [[1, 0, 0, -2, -9, 1, 9, 0],
         [0, 1, 0, 1 / 3, 1, -1 / 3, -2, 0],
         [0, 0, 1, 2, 3, -1, -12, 2]],
        [0, 0, 0, -2, -3, 1, 12], 0, 1, 2),
    # Marshall and Suurballe 1969, A note on cycling in the simplex method, NRLQ 16
    "Marshall 1969": program(
        [[1, 0, 0, 0, 0.6, -6.4, 4.8, 0],
         [0, 1, 0, 0, 0.2, -1.8, 0.6, 0],
         [0, 0, 1, 0, 0.4, -1.6, 0.2, 0],
         [0, 0, 0, 1, 0, 1, 0, 1]],
        [0, 0, 0, 0, -0.4, -0.4, 1.8], 0, 1, 2, 3),
    # Solow 1984, Linear programming: an introduction to finite improvement algorithms
    "Solow 1984": program(
        [[1, 0, -7, -3, 7, 2, 0],
         [0, 1, 2, 1, -3, -1, 0]],
        [0, 0, -2, -2, 8, 2], 0, 1),
    # Chvátal 1983, Linear programming, chapter 3
    "Chvatal 1983": program(
        [[0.5, -5.5, -2.5, 9, 1, 0, 0, 0],
         [0.5, -1.5, -0.5, 1, 0, 1, 0, 0],
         [1, 0, 0, 0, 0, 0, 1, 1]],
        [-10, 57, 9, 24, 0, 0, 0], 4, 5, 6),
}  # fmt: skip


@cache
def cycle(name: str) -> list[tuple[int, ...]]:
    """Bases of a closed path of pivots, each along a negative reduced cost and of length 0."""
    E, b, c, start = PROGRAMS[name]
    path: list[tuple[int, ...]] = []
    left: set[tuple[int, ...]] = set()

    def visit(basis: tuple[int, ...]) -> list[tuple[int, ...]]:
        path.append(basis)
        tableau = np.linalg.solve(E[:, basis], np.column_stack([E, b]))
        reduced = c - c[list(basis)] @ tableau[:, :-1]
        for entering in np.flatnonzero(reduced < -1e-9):
            for i in np.flatnonzero((tableau[:, entering] > 1e-9) & (abs(tableau[:, -1]) < 1e-9)):
                after = tuple(sorted({*basis, int(entering)} - {basis[i]}))
                if after in path:
                    return path[path.index(after) :]
                found = [] if after in left else visit(after)
                if found:
                    return found
        left.add(path.pop())
        return []

    return visit(start)
