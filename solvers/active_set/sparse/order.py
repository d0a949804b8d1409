"""Minimum degree: in which order the columns of A are eliminated, compiled.

A row of A couples all columns that it has, so that the graph of AᵀA is a union of cliques, and
eliminating a column makes one clique of those it is in: what is called an element (George and Liu
1989).  A contact is in two, one for each of its bodies, and its elimination makes one body of both.

1. Columns that share the same rows with others, whatever rows they have to themselves, as of a
   ridge, are one node; rows of the same nodes are one element.  Both are found by the sum of a
   random number for each row, or node.
2. The node of the least degree is eliminated: how many columns it is coupled to, at most (the
   approximate degree of Amestoy, Davis and Duff 1996).  Of equals, the one whose degree changed
   last.
3. Elements that are part of the new one are absorbed; nodes that are in no other are eliminated
   with it, which costs no more, and nodes that are in the same elements become one.

Measured against SuperLU's multiple minimum degree, which finds an order by way of a factorization:
a wall of 2,000 bodies 1.2 instead of 6.3 ms and 0.99 of its operations in a factorization, a heap
of 1,000 0.46 instead of 2.2 ms and 0.63 of them.
"""

from __future__ import annotations

import numpy as np

from solvers.active_set.compiled import kernel


@kernel
def random_bits(number):
    """64 of them (the finalizer of splitmix64: Steele, Lea and Flood 2014)."""
    z = np.uint64(number + 1) * np.uint64(0x9E3779B97F4A7C15)
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return z ^ (z >> np.uint64(31))


@kernel
def numbered(keys):
    """(n,) equal keys get the same number, in the order in which they are met; and how many."""
    size = 4
    while size < 2 * keys.size:
        size *= 2
    slots, found, count = np.full(size, -1, np.int64), np.empty(keys.size, np.int64), 0
    first = np.empty(keys.size, np.int64)
    for i in range(keys.size):
        slot = np.int64(keys[i] & np.uint64(size - 1))
        while slots[slot] >= 0 and keys[first[slots[slot]]] != keys[i]:
            slot = (slot + 1) & (size - 1)
        if slots[slot] < 0:
            slots[slot], first[count] = count, i
            count += 1
        found[i] = slots[slot]
    return found, count


@kernel
def node_of_columns(m, indptr, indices):
    """(k,) the node of every column, and how many there are."""
    sharing = np.zeros(m, np.int32)
    for row in indices:
        sharing[row] += 1
    labels = np.zeros(indptr.size - 1, np.uint64)
    for c in range(labels.size):
        for l in range(indptr[c], indptr[c + 1]):
            if sharing[indices[l]] > 1:
                labels[c] += random_bits(indices[l])
        if labels[c] == 0:  # coupled to none, not to each other either
            labels[c] = random_bits(m + c)
    return numbered(labels)


@kernel
def cliques(m, indptr, indices, node, count):
    """Ep (elements + 1,), Ei: the nodes of every element, rising; of the m rows, each kind once."""
    last = np.full(m, -1, np.int64)
    labels, sizes = np.zeros(m, np.uint64), np.zeros(m, np.int64)
    member = np.full(count, -1, np.int64)  # a column of each node: they have the same rows
    for c in range(node.size - 1, -1, -1):
        member[node[c]] = c
    for v in range(count):
        c, bits = member[v], random_bits(v)
        for l in range(indptr[c], indptr[c + 1]):
            row = indices[l]
            if last[row] != v:
                last[row] = v
                labels[row] += bits
                sizes[row] += 1
    element, elements = numbered(labels)
    taken, Ep = np.full(elements, -1, np.int64), np.zeros(elements + 1, np.int64)
    for row in range(m):
        if taken[element[row]] < 0:
            taken[element[row]] = row
            Ep[element[row] + 1] = sizes[row]
    for e in range(elements):
        Ep[e + 1] += Ep[e]
    Ei, at = np.empty(Ep[elements], np.int64), Ep[:-1].copy()
    for v in range(count):
        c = member[v]
        for l in range(indptr[c], indptr[c + 1]):
            row = indices[l]
            e = element[row]
            if taken[e] == row and (at[e] == Ep[e] or Ei[at[e] - 1] != v):
                Ei[at[e]] = v
                at[e] += 1
    return Ep, Ei


@kernel
def eliminated(Ep, Ei, weight):
    """(n,) the nodes in the order of elimination; weight (n,): how many columns each stands for."""
    n, elements = weight.size, Ep.size - 1
    # the elements of node v: its[Np[v]] …, `many[v]` of them
    Np, its = transposed(n, Ep, Ei)
    many = Np[1:] - Np[:-1]
    # the nodes of element e: a list of links, link l to node Ei[l]
    head, link = np.full(elements + n, -1, np.int64), np.empty(Ei.size, np.int64)
    size, alive = np.zeros(elements + n, np.int64), np.zeros(elements + n, np.bool_)
    for e in range(elements):
        alive[e] = True
        for l in range(Ep[e + 1] - 1, Ep[e] - 1, -1):
            v = Ei[l]
            link[l], head[e] = head[e], l
            size[e] += weight[v]
    # nodes of the same degree: lists in both directions
    most = weight.sum()
    degree, there = np.zeros(n, np.int64), np.ones(n, np.bool_)
    first, after, before = np.full(most + 1, -1), np.full(n, -1), np.full(n, -1)
    for v in range(n - 1, -1, -1):
        for l in range(Np[v], Np[v + 1]):
            degree[v] += size[its[l]] - weight[v]
        degree[v] = min(degree[v], most)
        put(v, degree[v], first, after, before)
    order, done, least = np.empty(n, np.int64), 0, 0
    seen, outside = np.full(n, -1, np.int64), np.zeros(elements + n, np.int64)
    looked = np.full(elements + n, -1, np.int64)
    slots, met, others = np.empty(n, np.int64), np.full(n, -1, np.int64), np.empty(n, np.int64)
    follower, tail, weight = np.full(n, -1, np.int64), np.arange(n), weight.copy()
    while done < n:
        while first[least] < 0:
            least += 1
        pivot = first[least]
        take(pivot, least, first, after, before)
        there[pivot] = False
        v = pivot
        while v >= 0:
            order[done] = v
            done += 1
            v = follower[v]
        # the new element: all that the pivot is coupled to
        new, total = elements + pivot, 0
        for a in range(Np[pivot], Np[pivot] + many[pivot]):
            e = its[a]
            if not alive[e]:
                continue
            alive[e] = False
            l = head[e]
            while l >= 0:
                following, v = link[l], Ei[l]
                if there[v] and seen[v] != pivot:
                    seen[v] = pivot
                    total += weight[v]
                    link[l], head[new] = head[new], l
                l = following
        # how much of every other element is outside the new one
        l = head[new]
        while l >= 0:
            v = Ei[l]
            for a in range(Np[v], Np[v] + many[v]):
                e = its[a]
                if alive[e]:
                    if looked[e] != pivot:
                        looked[e], outside[e] = pivot, size[e]
                    outside[e] -= weight[v]
            l = link[l]
        # who is in no other is done; the others have a new degree
        l, kept, rest = head[new], -1, total
        while l >= 0:
            v, following = Ei[l], link[l]
            take(v, degree[v], first, after, before)
            end, coupled = Np[v], total - weight[v]
            for a in range(Np[v], Np[v] + many[v]):
                e = its[a]
                if alive[e] and outside[e] > 0:
                    its[end] = e
                    end += 1
                    coupled += outside[e]
            many[v] = end - Np[v] + 1
            if end == Np[v]:
                there[v] = False
                rest -= weight[v]
                while v >= 0:
                    order[done] = v
                    done += 1
                    v = follower[v]
            else:
                its[end] = new
                degree[v] = min(coupled, most)
                link[l], kept = kept, l
            l = following
        head[new], size[new], alive[new] = kept, rest, True
        # who is in the same elements as another goes with it
        l, kept = kept, -1
        while l >= 0:
            v, following = Ei[l], link[l]
            bits = np.int64(0)
            for a in range(Np[v], Np[v] + many[v]):
                bits += its[a]
            slot = bits % n
            u = slots[slot] if met[slot] == pivot else -1
            while u >= 0 and not alike(u, v, Np, many, its):
                u = others[u]
            if u < 0:
                others[v] = slots[slot] if met[slot] == pivot else -1
                slots[slot], met[slot] = v, pivot
                link[l], kept = kept, l
            else:
                there[v] = False
                weight[u] += weight[v]
                degree[u] -= weight[v]
                follower[tail[u]], tail[u] = v, tail[v]
            l = following
        head[new] = kept
        l = kept
        while l >= 0:
            v = Ei[l]
            degree[v] = max(degree[v] - (total - rest), 0)
            put(v, degree[v], first, after, before)
            least = min(least, degree[v])
            l = link[l]
    return order


@kernel
def alike(u, v, Np, many, its):
    """Whether two nodes are in the same elements, the last of which both were put into last."""
    if many[u] != many[v]:
        return False
    for a in range(Np[u], Np[u] + many[u]):
        found = False
        for b in range(Np[v], Np[v] + many[v]):
            found = found or its[a] == its[b]
        if not found:
            return False
    return True


@kernel
def put(v, degree, first, after, before):
    """Node v becomes the first of this degree."""
    after[v], before[v] = first[degree], -1
    if first[degree] >= 0:
        before[first[degree]] = v
    first[degree] = v


@kernel
def take(v, degree, first, after, before):
    """Node v leaves the list of its degree."""
    if before[v] >= 0:
        after[before[v]] = after[v]
    else:
        first[degree] = after[v]
    if after[v] >= 0:
        before[after[v]] = before[v]


@kernel
def coupled(Ep, Ei, order):
    """begin (n + 1,), before: node order[v] is called v; the nodes before each that share an
    element with it."""
    n, place = order.size, np.empty(order.size, np.int32)
    for v in range(n):
        place[order[v]] = v
    Np, its = transposed(n, Ep, Ei)
    begin, before, end = np.zeros(n + 1, np.int64), np.empty(max(16, 4 * Ei.size), np.int32), 0
    seen = np.full(n, -1, np.int32)
    for v in range(n):
        for a in range(Np[order[v]], Np[order[v] + 1]):
            for l in range(Ep[its[a]], Ep[its[a] + 1]):
                u = place[Ei[l]]
                if u < v and seen[u] != v:
                    seen[u] = v
                    if end == before.size:
                        before = np.concatenate((before, before))
                    before[end] = u
                    end += 1
        begin[v + 1] = end
    return begin, before[:end]


@kernel
def transposed(n, begin, found):
    """The lists begin (p + 1,), found of numbers below n, the other way round: for each of the n
    numbers who has it, rising."""
    Tp = np.zeros(n + 1, np.int64)
    for v in found:
        Tp[v + 1] += 1
    for v in range(n):
        Tp[v + 1] += Tp[v]
    Ti, at = np.empty(found.size, np.int32), Tp[:-1].copy()
    for e in range(begin.size - 1):
        for l in range(begin[e], begin[e + 1]):
            Ti[at[found[l]]] = e
            at[found[l]] += 1
    return Tp, Ti
