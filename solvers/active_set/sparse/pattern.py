"""Which entries the Cholesky factor of A_Fᵀ A_F can have, where A is large and sparse.

Each column of A touches two bodies, so that A_FᵀA_F couples contacts that share a body, and with a
fill-reducing order of the contacts its Cholesky factor L, which is Rᵀ of A_F = Q R, is sparse too.

    1. the contacts are put in order by minimum degree (`order`);
    2. walks up the elimination tree give the rows of L (Liu 1986); the tree is put in postorder
       (George and Liu 1981);
    3. columns that follow each other with the same rows, or nearly so, become a front: a dense
       block of L (Ashcraft and Grimes 1989).

All columns are in the pattern, whether free or not, so that it serves as long as the same contacts
are there.  Inside, columns are numbered by their place in this order.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from problems.qp import Indices
from solvers.active_set.compiled import kernel
from solvers.active_set.sparse.order import (
    Places,
    cliques,
    coupled,
    eliminated,
    node_of_columns,
    transposed,
)

Rows = NDArray[np.uint32]
"""What kernels index with: numba looks at every index that might be negative."""

SLOTS = 8
"""Entries that a column has room for, or a multiple: in the plane three for each of two bodies, and
two of the ridge by which large minimum-norm QPs are posed; in space six for each.  That it is a
constant makes products with B three times as fast."""
WIDEST = 8 * SLOTS
"""Entries of the widest column of a sparse A; with wider ones A_Fᵀ A_F is full."""
FEW_ZEROS = 0.1
"""Share of zeros that a front may hold so as to be larger."""


class Pattern(NamedTuple):
    """Patterns of A and L, columns in elimination order.

    m, indptr, indices : rows of A (m, k), and where its entries are, as given
    order : (k,) the column of A that stands at each place
    Bi : (k, width) rows of B, which is A in this order; m where a column has fewer entries; the
        width is a multiple of SLOTS
    Gp, Gi, Gx : neighbours: column c shares rows with the columns Gi[Gp[c] : Gp[c + 1]] past it,
        and entry (neighbour, c) of L stands at the places Gx
    first, front : front s has the columns first[s] … first[s + 1] − 1; column c is in front[c]
    Rp, Ri : rows of the fronts, rising: Ri[Rp[s] : Rp[s + 1]], its own columns first
    Lp : (fronts + 1,) where the blocks of L begin, each (columns, rows), the rows contiguous
    Up, Ut, Ua, Ub : fronts before s that have some of its columns among their rows: Ut, at the
        rows Ua … Ub − 1
    change : (k,) operations that taking a column into L or out of it takes, at most
    nonzeros, entries : of A, and of the lower triangle of L
    """

    m: int
    indptr: Places
    indices: Places
    order: Indices
    Bi: Rows
    Gp: Indices
    Gi: Places
    Gx: Indices
    first: Places
    front: Places
    Rp: Indices
    Ri: Rows
    Lp: Indices
    Up: Indices
    Ut: Places
    Ua: Places
    Ub: Places
    change: Indices
    nonzeros: int
    entries: int

    def fits(self, A: sp.csc_array) -> bool:
        """Whether A has this pattern."""
        same_size = self.m == A.shape[0]
        return same_size and same(self.indptr, A.indptr) and same(self.indices, A.indices)


def is_narrow(A: sp.csc_array) -> bool:
    """Whether no column of A has more than `WIDEST` entries."""
    return bool(np.diff(A.indptr).max(initial=0) <= WIDEST)


@kernel
def same(kept, given):
    """Whether two arrays hold the same numbers."""
    if kept.size != given.size:
        return False
    differ = 0
    for i in range(kept.size):
        differ |= kept[i] ^ given[i]
    return differ == 0


def make_pattern(A: sp.csc_array) -> Pattern:
    """Order the columns of A (m, k) and find the pattern of L."""
    m = A.shape[0]
    indptr, indices = np.array(A.indptr, dtype=np.int32), np.array(A.indices, dtype=np.int32)
    return Pattern(m, indptr, indices, *laid_out(m, indptr, indices))


@kernel
def laid_out(m, indptr, indices):
    """All of `Pattern` from `order` on."""
    order, (Gp, Gi), (first, front, Rp, Ri, Lp) = analyse(m, indptr, indices)
    Gx = places_in_L(Gp, Gi, first, front, Rp, Ri, Lp)
    Up, Ut, Ua, Ub = updates(first, front, Rp, Ri)
    change, entries = change_flops(first, front, Rp, Ri, Up, Ut)
    Bi, nonzeros = padded_rows(m, order, indptr, indices), indices.size
    blocks = first, front, Rp, Ri, Lp
    return (order, Bi, Gp, Gi, Gx, *blocks, Up, Ut, Ua, Ub, change, nonzeros, entries)


@kernel
def analyse(m, indptr, indices):
    """order; Gp, Gi; first, front, Rp, Ri, Lp of the `Pattern` of A.

    Columns of the same node (`order`) have the same rows in L, so that all of this is done for the
    nodes, and spread out at the end.
    """
    node, count = node_of_columns(m, indptr, indices)
    weight = np.zeros(count, np.int64)
    for v in node:
        weight[v] += 1
    Ep, Ei = cliques(m, indptr, indices, node, count)
    Np, its = transposed(count, Ep, Ei)
    nodes = eliminated(Ep, Ei, Np, its, weight)
    begin, before = coupled(Ep, Ei, Np, its, nodes)
    parent, rows, (row, found) = tree(begin, before, weight[nodes])
    later = postorder(parent, rows)
    nodes, (begin, before) = nodes[later], renamed(begin, before, later)
    Lp, Li = transposed(count, *renamed(row, found, later))
    place = np.empty(count, np.int64)
    for v in range(count):
        place[nodes[v]] = v
    start, order = transposed(count, np.arange(node.size + 1), place[node])
    return order.astype(np.int64), spread_out(begin, before, start), fronts(Lp, Li, start)


@kernel
def renamed(begin, before, order):
    """begin, before when node order[v] is called v, in a postorder: before v are the same nodes."""
    n, place = order.size, np.empty(order.size, np.int32)
    for v in range(n):
        place[order[v]] = v
    starts, named, end = np.empty_like(begin), np.empty_like(before), 0
    for v in range(n):
        starts[v] = end
        for b in range(begin[order[v]], begin[order[v] + 1]):
            named[end] = place[before[b]]
            end += 1
    starts[n] = end
    return starts, named


@kernel
def spread_out(begin, before, start):
    """Gp (k + 1,), Gi: the columns past each that it is coupled to, rising, of neighbours before
    each node; node v has the columns start[v] … start[v + 1] − 1.
    """
    n, k = start.size - 1, start[start.size - 1]
    Tp, Ti = transposed(n, begin, before)
    Gp, end = np.zeros(k + 1, np.int64), 0
    for v in range(n):
        rest = 0
        for l in range(Tp[v], Tp[v + 1]):
            rest += start[Ti[l] + 1] - start[Ti[l]]
        for c in range(start[v], start[v + 1]):
            end += start[v + 1] - 1 - c + rest
            Gp[c + 1] = end
    Gi = np.empty(end, np.int32)
    for v in range(n):
        for c in range(start[v], start[v + 1]):
            at = Gp[c]
            for own in range(c + 1, start[v + 1]):
                Gi[at] = own
                at += 1
            for l in range(Tp[v], Tp[v + 1]):
                for other in range(start[Ti[l]], start[Ti[l] + 1]):
                    Gi[at] = other
                    at += 1
    return Gp, Gi


@kernel
def padded_rows(m, order, indptr, indices):
    """Rows of the columns of B, (k, width)."""
    most = 1
    for c in order:
        most = max(most, indptr[c + 1] - indptr[c])
    Bi = np.full((order.size, SLOTS * ((most + SLOTS - 1) // SLOTS)), np.uint32(m))
    for place in range(order.size):
        c = order[place]
        for l in range(indptr[c], indptr[c + 1]):
            Bi[place, l - indptr[c]] = indices[l]
    return Bi


@kernel
def tree(begin, before, weight):
    """(n,) the parent of each node in the elimination tree, n of a root, and how many rows its
    columns of L have; row (n + 1,), found: the rows of L but for the diagonal.

    Node v has weight[v] columns.  Row v of L has the nodes on the paths of the elimination tree
    that lead from its neighbours before v towards v (Liu 1986).
    """
    n, end = begin.size - 1, 0
    parent, seen, rows = np.full(n, n, np.int32), np.full(n, -1, np.int32), weight.copy()
    row, found = np.zeros(n + 1, np.int64), np.empty(n + 2 * before.size, np.int32)
    for v in range(n):
        seen[v] = v
        if end + v > found.size:
            found = np.concatenate((found, found))
        for b in range(begin[v], begin[v + 1]):
            u = before[b]
            while seen[u] != v:
                if parent[u] == n:
                    parent[u] = v
                seen[u] = v
                rows[u] += weight[v]
                found[end] = u
                end += 1
                u = parent[u]
        row[v + 1] = end
    return parent, rows, (row, found[:end])


@kernel
def postorder(parent, rows):
    """(n,) nodes in postorder of the elimination tree, of children that of most rows last."""
    n = parent.size
    child, sibling = np.full(n + 1, -1, np.int64), np.full(n, -1, np.int64)
    most = 0
    for v in range(n):
        most = max(most, rows[v])
    for v in transposed(most + 1, np.arange(n + 1), most - rows)[1]:
        sibling[v] = child[parent[v]]
        child[parent[v]] = v
    order, stack = np.empty(n, np.int64), np.empty(n + 1, np.int64)
    stack[0] = n
    depth, done = 1, 0
    while depth > 0:
        node = stack[depth - 1]
        below = child[node]
        if below >= 0:
            child[node] = sibling[below]
            stack[depth] = below
            depth += 1
        else:
            depth -= 1
            if node < n:
                order[done] = node
                done += 1
    return order


@kernel
def fronts(Lp, Li, start):
    """first, front, Rp, Ri and Lp of the `Pattern` from Lp (n + 1,), Li: the rows of every column
    of L past the diagonal, by nodes, rising.

    A node joins the front before it if that has it for parent, and at most `FEW_ZEROS` of the
    entries of the block are zero.
    """
    n, k = start.size - 1, start[start.size - 1]
    height, lead = np.zeros(n, np.int64), np.empty(n + 1, np.int64)
    filled, count = np.empty(n, np.int64), 0  # entries of the front
    for v in range(n):
        height[v] = start[v + 1] - start[v]
        for l in range(Lp[v], Lp[v + 1]):
            height[v] += start[Li[l] + 1] - start[Li[l]]
        lead[count], filled[count] = v, triangle(start[v + 1] - start[v], height[v])
        count += 1
        while count > 1:
            last = lead[count - 1]
            if Lp[last] == Lp[last - 1] or Li[Lp[last - 1]] != last:
                break
            width = start[v + 1] - start[lead[count - 2]]
            room = triangle(width, width + height[v] - (start[v + 1] - start[v]))
            both = filled[count - 2] + filled[count - 1]
            if room - both > FEW_ZEROS * room:
                break
            count -= 1
            filled[count - 1] = both
    lead[count] = n
    first, front = np.empty(count + 1, np.int32), np.empty(k, np.int32)
    Rp, blocks = np.zeros(count + 1, np.int64), np.zeros(count + 1, np.int64)
    first[count] = k
    for s in range(count):
        last = lead[s + 1] - 1
        first[s], width = start[lead[s]], start[last + 1] - start[lead[s]]
        rows = width + height[last] - (start[last + 1] - start[last])
        Rp[s + 1], blocks[s + 1] = Rp[s] + rows, blocks[s] + width * rows
    Ri, at = np.empty(Rp[count], np.uint32), 0
    for s in range(count):
        last = lead[s + 1] - 1
        for c in range(start[lead[s]], start[last + 1]):
            Ri[at], front[c] = c, s
            at += 1
        for l in range(Lp[last], Lp[last + 1]):
            for c in range(start[Li[l]], start[Li[l] + 1]):
                Ri[at] = c
                at += 1
    return first, front, Rp, Ri, blocks


@kernel
def triangle(width, height):
    """Entries of the lower triangle of a front."""
    return width * height - width * (width - 1) // 2


@kernel
def updates(first, front, Rp, Ri):
    """Up (fronts + 1,), Ut, Ua, Ub; see `Pattern`."""
    count = first.size - 1
    Up = np.zeros(count + 1, np.int64)
    for t in range(count):
        last = -1
        for l in range(Rp[t] + first[t + 1] - first[t], Rp[t + 1]):
            if front[Ri[l]] != last:
                last = front[Ri[l]]
                Up[last + 1] += 1
    for s in range(count):
        Up[s + 1] += Up[s]
    at = Up[:-1].copy()
    Ut, Ua, Ub = (
        np.empty(Up[count], np.int32),
        np.empty(Up[count], np.int32),
        np.empty(Up[count], np.int32),
    )
    for t in range(count):
        last = -1
        for l in range(Rp[t] + first[t + 1] - first[t], Rp[t + 1]):
            s = front[Ri[l]]
            if s != last:
                last = s
                Ut[at[s]], Ua[at[s]] = t, l - Rp[t]
                at[s] += 1
            Ub[at[s] - 1] = l - Rp[t] + 1
    return Up, Ut, Ua, Ub


@kernel
def places_in_L(Gp, Gi, first, front, Rp, Ri, blocks):
    """Gx; see `Pattern`."""
    k = front.size
    Gx = np.empty(Gi.size, np.int64)
    place = np.zeros(k, np.int64)
    for s in range(first.size - 1):
        height = Rp[s + 1] - Rp[s]
        for i in range(height):
            place[Ri[Rp[s] + i]] = i
        for c in range(first[s], first[s + 1]):
            for g in range(Gp[c], Gp[c + 1]):
                Gx[g] = blocks[s] + (c - first[s]) * height + place[Gi[g]]
    return Gx


@kernel
def change_flops(first, front, Rp, Ri, Up, Ut):
    """`change` and `entries`; see `Pattern`.

    Taking a column into L takes operations along the path to the root, and for its row.
    """
    k, entries = front.size, 0
    flops = np.zeros(k, np.int64)
    for c in range(k - 1, -1, -1):
        s = front[c]
        below = Rp[s + 1] - Rp[s] - (c - first[s]) - 1
        parent = Ri[Rp[s] + c - first[s] + 1] if below > 0 else -1
        flops[c] = 4 * below + (flops[parent] if parent >= 0 else 0)
    for s in range(first.size - 1):
        row = 0
        for u in range(Up[s], Up[s + 1]):
            t = Ut[u]
            row += 2 * (first[t + 1] - first[t]) * (Rp[t + 1] - Rp[t])
        for c in range(first[s], first[s + 1]):
            flops[c] += row + 2 * (c - first[s]) * (Rp[s + 1] - Rp[s])
        entries += triangle(first[s + 1] - first[s], Rp[s + 1] - Rp[s])
    return flops, entries
