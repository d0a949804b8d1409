"""Aᵀd, AᵀA and Aᵀ of a QP, compiled.

At 100 columns SciPy takes 30 to 100 µs for each product of sparse matrices, most of it for looking
at what it is given, where a package may solve the whole QP in less.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
import scipy.sparse as sp

from problems.kernels.compiled import kernel
from problems.qp import ContactQP, Vector

Sizes = tuple[Vector, float, float, float, float, int, bool]
"""What a QP is like:

q : (k,) Aᵀd, the gradient at x = 0
force : ‖q‖∞;  away : how far bounds force x away from 0
shortest, longest : least and greatest square of the length of a column; 1 where there is none
fixed : rows with lower = upper;  one_sided : whether all of x ≥ 0 and nothing else is asked
"""


def dense_sizes(qp: ContactQP, A: Vector, P: Vector) -> Sizes:
    """Sizes of a QP with this dense A, P = AᵀA."""
    sizes: Sizes = _dense_sizes(P, A.T @ qp.d, qp.lower, qp.upper)
    return sizes


def sparse_sizes(qp: ContactQP, A: Any) -> Sizes:
    """Sizes of a QP with this A in CSC."""
    sizes: Sizes = _sparse_sizes(A.indptr, A.indices, A.data, qp.d, qp.lower, qp.upper)
    return sizes


def csc(shape: tuple[int, int], data: Vector, indices: Any, indptr: Any) -> sp.csc_matrix:
    """A CSC matrix of these arrays, which are not looked at."""
    made = sp.csc_matrix.__new__(sp.csc_matrix)
    vars(made).update(vars(_nothing(*shape)))  # as `copy` does, in a quarter of the time
    made.data, made.indices, made.indptr = data, indices, indptr
    return made


def transposed(A: sp.csc_matrix) -> sp.csc_matrix:
    """Aᵀ of a CSC matrix, with its rows in order.  (k, m) CSC"""
    m, k = A.shape
    return csc((k, m), *_transposed(m, A.indptr, A.indices, A.data))


def product(A: sp.csc_matrix, At: sp.csc_matrix, part: int = 0) -> sp.csc_matrix:
    """AᵀA with its rows in order; of it, with `part` 1 the upper triangle, with −1 the lower.

    Entries that are 0 by chance are stored.  (k, k) CSC
    """
    k = A.shape[1]
    arrays = A.indptr, A.indices, A.data, At.indptr, At.indices, At.data
    return csc((k, k), *_product(*arrays, part))


def dense_product(A: sp.csc_matrix, At: sp.csc_matrix) -> Vector:
    """AᵀA as an array, symmetric to the last bit.  (k, k)"""
    P: Vector = _dense_product(A.indptr, A.indices, A.data, At.indptr, At.indices, At.data)
    return P


@lru_cache(64)
def _nothing(rows: int, columns: int) -> sp.csc_matrix:
    return sp.csc_matrix((rows, columns))


@kernel
def is_one_sided(lower, upper):
    """Whether all of x ≥ 0 and nothing else is asked."""
    found = True
    for j in range(lower.size):
        found &= lower[j] == 0.0 and upper[j] == np.inf
    return found


@kernel
def is_definite(P, least):
    """Whether P has a Cholesky factor with all pivots beyond `least` times the greatest."""
    n = P.shape[0]
    left, smallest, greatest = P.copy(), np.inf, 0.0
    for j in range(n):
        pivot = left[j, j]
        if not pivot > 0.0:
            return False
        smallest, greatest = min(smallest, pivot), max(greatest, pivot)
        for i in range(j + 1, n):
            part = left[j, i] / pivot
            if part != 0.0:  # contacts that share no body
                for c in range(i, n):
                    left[i, c] -= part * left[j, c]
    return np.sqrt(smallest) > least * np.sqrt(greatest)


@kernel
def _dense_sizes(P, q, lower, upper):
    squares = np.empty(q.size)
    for j in range(q.size):
        squares[j] = P[j, j]
    return _sizes(q, squares, lower, upper)


@kernel
def _sparse_sizes(pointers, rows, entries, d, lower, upper):
    k = pointers.size - 1
    q, squares = np.zeros(k), np.zeros(k)
    for j in range(k):
        for at in range(pointers[j], pointers[j + 1]):
            q[j] += entries[at] * d[rows[at]]
            squares[j] += entries[at] * entries[at]
    return _sizes(q, squares, lower, upper)


@kernel
def _sizes(q, squares, lower, upper):
    force, away, fixed, one_sided = 0.0, 0.0, 0, True
    shortest, longest = (np.inf, 0.0) if q.size else (1.0, 1.0)
    for j in range(q.size):
        force = max(force, abs(q[j]))
        away = max(away, lower[j], -upper[j])
        shortest, longest = min(shortest, squares[j]), max(longest, squares[j])
        fixed += lower[j] == upper[j]
        one_sided &= lower[j] == 0.0 and upper[j] == np.inf
    return q, force, away, shortest, longest, fixed, one_sided


@kernel
def _transposed(m, pointers, rows, entries):
    begins = np.zeros(m + 1, pointers.dtype)
    for row in rows:
        begins[row + 1] += 1
    for i in range(m):
        begins[i + 1] += begins[i]
    place, columns, values = begins[:m].copy(), np.empty_like(rows), np.empty_like(entries)
    for j in range(pointers.size - 1):
        for at in range(pointers[j], pointers[j + 1]):
            to = place[rows[at]]
            columns[to], values[to] = j, entries[at]
            place[rows[at]] += 1
    return values, columns, begins


@kernel
def _product(pointers, rows, entries, begins, columns, values, part):
    """The other triangle, rows as they are met, and its transpose: rows in order."""
    k = pointers.size - 1
    met, ends = np.full(k, -1), np.zeros(k + 1, pointers.dtype)
    for j in range(k):
        size = ends[j]
        for at in range(pointers[j], pointers[j + 1]):
            for to in range(begins[rows[at]], begins[rows[at] + 1]):
                column = columns[to]
                if met[column] != j and (column - j) * part >= 0:
                    met[column] = j
                    size += 1
        ends[j + 1] = size
    found, data, place, end = np.empty(size, rows.dtype), np.zeros(size), np.full(k, -1), 0
    for j in range(k):
        for at in range(pointers[j], pointers[j + 1]):
            for to in range(begins[rows[at]], begins[rows[at] + 1]):
                column = columns[to]
                if (column - j) * part >= 0:
                    if place[column] < ends[j]:
                        found[end], place[column] = column, end
                        end += 1
                    data[place[column]] += entries[at] * values[to]
    return _transposed(k, ends, found, data)


@kernel
def _dense_product(pointers, rows, entries, begins, columns, values):
    k = pointers.size - 1
    P = np.zeros((k, k))
    for j in range(k):
        for at in range(pointers[j], pointers[j + 1]):
            for to in range(begins[rows[at]], begins[rows[at] + 1]):
                if columns[to] > j:
                    break
                P[j, columns[to]] += entries[at] * values[to]
    for j in range(k):
        for c in range(j):
            P[c, j] = P[j, c]
    return P
