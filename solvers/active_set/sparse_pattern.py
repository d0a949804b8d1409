"""Which entries the Cholesky factor of A_Fᵀ A_F can have, where A is large and sparse.

Each column of A touches two bodies, so that A_FᵀA_F couples contacts that share a body, and with a
fill-reducing order of the contacts its Cholesky factor L, which is Rᵀ of A_F = Q R, is sparse too.

    1. contacts between the same two bodies have the same neighbours and stay together;
    2. these groups are put in order by minimum degree on the contact graph (SuperLU's);
    3. the pattern of L follows by merging columns along the elimination tree (George and Liu 1981).

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


class Pattern(NamedTuple):
    """Patterns of A and L, columns in elimination order.

    indptr, indices : of A (m, k), as given
    order : (k,) the column of A that stands at each place
    Bp, Bi : columns of B, which is A in this order: column c has the rows Bi[Bp[c] : Bp[c + 1]]
    Rp, Rc, Rx : rows of B: row i has the columns Rc[Rp[i] : Rp[i + 1]], rising, with the values at
        places Rx of B
    Lp, Li : columns of L, rows rising, the diagonal first
    """

    indptr: Places
    indices: Places
    order: Indices
    Bp: Places
    Bi: Places
    Rp: Places
    Rc: Places
    Rx: Places
    Lp: Indices
    Li: Places

    def fits(self, A: sp.csc_array) -> bool:
        """Whether A has this pattern."""
        return same(self.indptr, A.indptr) and same(self.indices, A.indices)


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
    m, k = A.shape
    indptr, indices = np.array(A.indptr, dtype=np.int32), np.array(A.indices, dtype=np.int32)
    order = contact_order(m, indptr, indices)
    counts = np.diff(indptr)[order]
    Bp = np.concatenate([[0], np.cumsum(counts)])
    entry = np.repeat(indptr[:-1][order] - Bp[:-1], counts) + np.arange(indices.size)
    Bi = indices[entry]
    by_row = sp.csr_array(
        sp.csc_array((np.arange(indices.size, dtype=np.int64), Bi, Bp), shape=(m, k))
    )
    Bp, Bi, Rp, Rc, Rx = (
        np.ascontiguousarray(part, dtype=np.int32)
        for part in (Bp, Bi, by_row.indptr, by_row.indices, by_row.data)
    )
    Lp, Li = fill(Bp, Bi, Rp, Rc)
    return Pattern(indptr, indices, order, Bp, Bi, Rp, Rc, Rx, Lp, Li)


def contact_order(m: int, indptr: Places, indices: Places) -> Indices:
    """Fill-reducing order of the columns of A: (k,) the column at each place.

    Minimum degree on the graph whose nodes are the groups of columns with the same rows.
    """
    k = indptr.size - 1
    if k == 0:
        return np.zeros(0, dtype=np.int64)
    # columns with the same rows have the same sum of random numbers, one for each row
    label = np.random.default_rng(0).integers(1, 2**62, m + 1, dtype=np.int64).astype(np.uint64)
    total = np.concatenate([[0], np.cumsum(label[indices], dtype=np.uint64)]).astype(np.uint64)
    _, first, group = np.unique(np.diff(total[indptr]), return_index=True, return_inverse=True)
    ones = sp.csc_array((np.ones(indices.size), indices, indptr), shape=(m, k))
    members = ones[:, first]
    graph = sp.csc_array(members.T @ members)
    graph.setdiag(2.0 * graph.sum(axis=0) + 1.0)  # dominant, so that no pivot is moved
    place = splu(
        sp.csc_matrix(graph),
        permc_spec="MMD_AT_PLUS_A",
        diag_pivot_thresh=0.0,
        options={"SymmetricMode": True},
    ).perm_c
    return np.argsort(place[group.ravel()], kind="stable")


@kernel
def fill(Bp, Bi, Rp, Rc):
    """Lp (k + 1,), Li: the rows of every column of L, rising, the diagonal first.

    The rows of column c are its neighbours past c and those of its children in the elimination
    tree; the parent of a column is its first row below the diagonal.
    """
    k = Bp.size - 1
    Lp = np.zeros(k + 1, np.int64)
    Li = np.empty(max(16, 4 * Bi.size), np.int32)
    seen = np.full(k, -1, np.int64)
    child, sibling = np.full(k, -1, np.int64), np.full(k, -1, np.int64)
    end = 0
    for c in range(k):
        if Li.size < end + k - c:
            longer = np.empty(2 * Li.size + k, np.int32)
            longer[:end] = Li[:end]
            Li = longer
        begin = end
        Li[end] = c
        end += 1
        seen[c] = c
        for b in range(Bp[c], Bp[c + 1]):
            for r in range(Rp[Bi[b] + 1] - 1, Rp[Bi[b]] - 1, -1):
                other = Rc[r]
                if other <= c:
                    break
                if seen[other] != c:
                    seen[other] = c
                    Li[end] = other
                    end += 1
        below = child[c]
        while below >= 0:
            for l in range(Lp[below] + 1, Lp[below + 1]):
                row = Li[l]
                if seen[row] != c:
                    seen[row] = c
                    Li[end] = row
                    end += 1
            below = sibling[below]
        Li[begin:end].sort()
        if end > begin + 1:
            parent = Li[begin + 1]
            sibling[c] = child[parent]
            child[parent] = c
        Lp[c + 1] = end
    return Lp, Li[:end].copy()
