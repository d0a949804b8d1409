"""Which entries the Cholesky factor of A_Fᵀ A_F can have, where A is large and sparse.

Each column of A touches two bodies, so that A_FᵀA_F couples contacts that share a body, and with a
fill-reducing order of the contacts its Cholesky factor L, which is Rᵀ of A_F = Q R, is sparse too.

    1. contacts between the same two bodies have the same neighbours and stay together, whatever
       rows each has to itself, as of a ridge;
    2. these groups are put in order by minimum degree on the contact graph (SuperLU's);
    3. the pattern of L follows from walks up the elimination tree (Liu 1986), which is then put in
       postorder (George and Liu 1981);
    4. columns that follow each other with the same rows, or nearly so, become a front: a dense
       block of L (Ashcraft and Grimes 1989).

All columns are in the pattern, whether free or not, so that it serves as long as the same contacts
are there.  Inside, columns are numbered by their place in this order.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray
from scipy.sparse.linalg import splu

from problems.qp import Indices
from solvers.active_set.compiled import kernel

Places = NDArray[np.int32]
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
    Gp: Places
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
    order = contact_order(m, indptr, indices)
    Lp, Li = fill(*neighbours(m, order, indptr, indices, True))
    order = order[postorder(Lp, Li)]
    Gp, Gi = neighbours(m, order, indptr, indices, True)
    Lp, Li = fill(Gp, Gi)
    first = fronts(Lp, Li, FEW_ZEROS)
    Rp, Ri = rows_of_fronts(first, Lp, Li)
    width, height = np.diff(first).astype(np.int64), np.diff(Rp)
    front = np.repeat(np.arange(width.size, dtype=np.int32), width)
    blocks = np.concatenate([[0], np.cumsum(width * height)])
    Up, Ut, Ua, Ub = updates(first, front, Rp, Ri)
    return Pattern(
        *(m, indptr, indices, order, padded_rows(m, order, indptr, indices)),
        *(Gp, Gi, places_in_L(Gp, Gi, first, front, Rp, Ri, blocks)),
        *(first, front, Rp, Ri, blocks, Up, Ut, Ua, Ub),
        change_flops(first, front, Rp, Ri, Up, Ut),
        int(indices.size),
        int((width * height - width * (width - 1) // 2).sum()),
    )


def contact_order(m: int, indptr: Places, indices: Places) -> Indices:
    """Fill-reducing order of the columns of A: (k,) the column at each place.

    Minimum degree on the graph whose nodes are the groups of columns that share the same rows.
    """
    k = indptr.size - 1
    if k == 0:
        return np.zeros(0, dtype=np.int64)
    group_names = labels(m, indptr, indices)
    _, first, group = np.unique(group_names, return_index=True, return_inverse=True)
    Gp, Gi = neighbours(m, first, indptr, indices, False)
    degree = np.diff(Gp)
    itself = Gi == np.repeat(np.arange(first.size, dtype=np.int32), degree)
    # dominant, so that no pivot is moved
    values = np.where(itself, 2.0 * degree.max(), 1.0)
    graph = sp.csc_array((values, Gi, Gp), shape=(first.size, first.size))
    place = splu(
        graph, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True}
    ).perm_c
    return np.argsort(place[group.ravel()], kind="stable")


@kernel
def labels(m, indptr, indices):
    """(k,) a number for each column, the same where two share the same of the m rows with others.

    The sum of random numbers, one for each row (the finalizer of splitmix64: Steele, Lea and Flood
    2014).
    """
    sharing = np.zeros(m, np.int32)
    for l in range(indptr[indptr.size - 1]):
        sharing[indices[l]] += 1
    found = np.zeros(indptr.size - 1, np.uint64)
    for c in range(found.size):
        for l in range(indptr[c], indptr[c + 1]):
            if sharing[indices[l]] == 1:
                continue
            z = np.uint64(indices[l] + 1) * np.uint64(0x9E3779B97F4A7C15)
            z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
            z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
            found[c] += z ^ (z >> np.uint64(31))
    return found


@kernel
def columns_of_rows(m, columns, indptr, indices):
    """begin (m + 1,), found: of the listed columns, which have each row, by their place, rising."""
    begin = np.zeros(m + 1, np.int32)
    for c in columns:
        for l in range(indptr[c], indptr[c + 1]):
            begin[indices[l] + 1] += 1
    for i in range(m):
        begin[i + 1] += begin[i]
    found, at = np.empty(begin[m], np.int32), begin[:-1].copy()
    for place in range(columns.size):
        for l in range(indptr[columns[place]], indptr[columns[place] + 1]):
            found[at[indices[l]]] = place
            at[indices[l]] += 1
    return begin, found


@kernel
def neighbours(m, columns, indptr, indices, past):
    """Gp (p + 1,), Gi: of p columns of A, numbered as listed, those that share a row with each.

    They rise.  past : only those past it, else all and the column itself
    """
    p = columns.size
    begin, having = columns_of_rows(m, columns, indptr, indices)
    Gp, Gi = np.zeros(p + 1, np.int32), np.empty(0, np.int32)
    seen, at = np.empty(p, np.int32), np.zeros(p, np.int32)
    for counted in (False, True):
        if counted:
            Gp[1:] = np.cumsum(at)
            at[:], Gi = Gp[:-1], np.empty(Gp[p], np.int32)
        seen[:] = -1
        for place in range(p):  # joins the lists of the others, so that these rise
            if not past:
                seen[place] = place
                if counted:
                    Gi[at[place]] = place
                at[place] += 1
            for l in range(indptr[columns[place]], indptr[columns[place] + 1]):
                for h in range(begin[indices[l]], begin[indices[l] + 1]):
                    other = having[h]
                    if seen[other] != place and (other < place or not past):
                        seen[other] = place
                        if counted:
                            Gi[at[other]] = place
                        at[other] += 1
    return Gp, Gi


def padded_rows(m: int, order: Indices, indptr: Places, indices: Places) -> Rows:
    """Rows of the columns of B, (k, width)."""
    entries = np.diff(indptr)
    slot = np.arange(SLOTS * max(1, -(-int(entries.max(initial=0)) // SLOTS)))
    there = slot < entries[order][:, None]
    source = np.where(there, indptr[:-1][order][:, None] + slot, 0)
    found = np.append(indices, np.int32(m))
    return np.ascontiguousarray(np.where(there, found[source], m), dtype=np.uint32)


@kernel
def fill(Gp, Gi):
    """Lp (k + 1,), Li: the rows of every column of L, rising, the diagonal first.

    Row c of L has the columns on the paths of the elimination tree that lead from its neighbours
    before c towards c (Liu 1986).
    """
    k = Gp.size - 1
    begin, before = columns_of_rows(k, np.arange(k), Gp, Gi)
    parent, seen = np.full(k, -1, np.int64), np.empty(k, np.int64)
    Lp, Li, at = np.zeros(k + 1, np.int64), np.empty(0, np.int32), np.zeros(k, np.int64)
    for counted in (False, True):
        if counted:
            Lp[1:] = np.cumsum(at)
            at[:], Li = Lp[:-1], np.empty(Lp[k], np.int32)
        seen[:] = -1
        for c in range(k):
            seen[c] = c
            if counted:
                Li[at[c]] = c
            at[c] += 1
            for b in range(begin[c], begin[c + 1]):
                node = before[b]
                while seen[node] != c:
                    if parent[node] < 0:
                        parent[node] = c
                    seen[node] = c
                    if counted:
                        Li[at[node]] = c
                    at[node] += 1
                    node = parent[node]
    return Lp, Li


@kernel
def postorder(Lp, Li):
    """(k,) columns in postorder of the elimination tree, of children the longest column last."""
    k = Lp.size - 1
    child, sibling = np.full(k + 1, -1, np.int64), np.full(k, -1, np.int64)
    longest_first = np.argsort(-(Lp[1:] - Lp[:-1]), kind="mergesort")
    for c in longest_first:
        parent = Li[Lp[c] + 1] if Lp[c + 1] > Lp[c] + 1 else k  # k: the root of all trees
        sibling[c] = child[parent]
        child[parent] = c
    order, stack = np.empty(k, np.int64), np.empty(k + 1, np.int64)
    stack[0] = k
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
            if node < k:
                order[done] = node
                done += 1
    return order


@kernel
def fronts(Lp, Li, few_zeros):
    """(fronts + 1,) first column of every front, and k.

    A column joins the front before it if that has its columns for parent, and few entries of the
    block are zero.
    """
    k = Lp.size - 1
    first = np.empty(k + 1, np.int32)
    filled = np.empty(k + 1, np.int64)  # entries of the front
    count = 0
    for c in range(k):
        first[count], filled[count] = c, Lp[c + 1] - Lp[c]
        count += 1
        while count > 1:
            last = first[count - 1]
            if Lp[last] - Lp[last - 1] < 2 or Li[Lp[last - 1] + 1] != last:
                break
            width = c + 1 - first[count - 2]
            height = width + Lp[c + 1] - Lp[c] - 1
            room = width * height - width * (width - 1) // 2
            both = filled[count - 2] + filled[count - 1]
            if room - both > few_zeros * room:
                break
            count -= 1
            filled[count - 1] = both
    first[count] = k
    return first[: count + 1].copy()


@kernel
def rows_of_fronts(first, Lp, Li):
    """Rp (fronts + 1,), Ri: the columns of each front, and the rows of the last of them."""
    count = first.size - 1
    Rp = np.zeros(count + 1, np.int64)
    for s in range(count):
        last = first[s + 1] - 1
        Rp[s + 1] = Rp[s] + (last - first[s]) + Lp[last + 1] - Lp[last]
    Ri = np.empty(Rp[count], np.uint32)
    for s in range(count):
        last = first[s + 1] - 1
        at = Rp[s]
        for c in range(first[s], last):
            Ri[at] = c
            at += 1
        for l in range(Lp[last], Lp[last + 1]):
            Ri[at] = Li[l]
            at += 1
    return Rp, Ri


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
    """`change`; see `Pattern`: along the path to the root, and for the row of the column."""
    k = front.size
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
    return flops
