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

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from problems.kernels.numba_internals import lent
from problems.qp import Indices
from solvers.active_set.compiled import kernel, stage

Places = NDArray[np.int32]
Flags = NDArray[np.bool_]


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


class Quotient(NamedTuple):
    """The graph under elimination: n nodes in elements, which are lists of them.

    its, Np, many : the elements of node v are its[Np[v]] … , many[v] of them
    head, link, node : the nodes of element e are node[l], l = head[e], link[l], … until −1; the
        element that node v leaves behind has the number of given ones + v
    size, alive : of elements, how many columns they couple, and whether they are in no other
    weight, there : of nodes, how many columns they stand for, and whether they are still to come
    tail, follower : of nodes, the last, and at each the next, of those that go with it; −1
    """

    its: Places
    Np: Indices
    many: Indices
    head: Indices
    link: Indices
    node: Indices
    size: Indices
    alive: Flags
    weight: Indices
    there: Flags
    tail: Indices
    follower: Indices


class Queue(NamedTuple):
    """Nodes by their degree: those of the same one are a list in both directions; −1 ends it."""

    degree: Indices
    first: Indices
    after: Indices
    before: Indices


class Marks(NamedTuple):
    """Scratch of a step, valid where it names the pivot of that step.

    seen : (n,) nodes of the new element;  looked, outside : of other elements, how much is outside
    slots, met, others : nodes by a hash of their elements, and the next of the same hash
    """

    seen: Indices
    looked: Indices
    outside: Indices
    slots: Indices
    met: Indices
    others: Indices


@kernel
def eliminated(Ep, Ei, Np, its, weight):
    """(n,) the nodes in the order of elimination; weight (n,): how many columns each stands for.

    Np (n + 1,), its : the elements of every node
    """
    n, given = weight.size, Ep.size - 1
    graph = quotient(Ep, Ei, Np, its.copy(), weight)
    queue = by_degree(graph, given)
    marks = Marks(
        np.full(n, -1),
        *(np.full(given + n, -1), np.zeros(given + n, np.int64)),
        *(np.zeros(n, np.int64), np.full(n, -1), np.zeros(n, np.int64)),
    )
    order = np.empty(n, np.int64)
    eliminate(graph, queue, marks, order, given)
    return order


@kernel
def eliminate(graph, queue, marks, order, given):
    """Fill the order (n,); the first `given` elements are those at the beginning."""
    graph, queue, marks, order = lent(graph), lent(queue), lent(marks), lent(order)
    done, least = 0, 0
    while done < order.size:
        while queue.first[least] < 0:
            least += 1
        pivot = queue.first[least]
        new = given + pivot
        take(queue, pivot)
        done = leave(graph, order, done, pivot)
        total = merge(graph, marks, pivot, new)
        look_outside(graph, marks, pivot, new)
        done, rest = sort_out(graph, queue, marks, order, done, new, total)
        join_alike(graph, queue, marks, pivot, new)
        l = graph.head[new]
        while l >= 0:
            v = graph.node[l]
            queue.degree[v] = max(queue.degree[v] - (total - rest), 0)
            put(queue, v)
            least = min(least, queue.degree[v])
            l = graph.link[l]


@kernel
def quotient(Ep, Ei, Np, its, weight):
    """The `Quotient` graph of these elements; it writes to `its`."""
    n, given = weight.size, Ep.size - 1
    head, link = np.full(given + n, -1), np.zeros(Ei.size, np.int64)
    size, alive = np.zeros(given + n, np.int64), np.zeros(given + n, np.bool_)
    for e in range(given):
        alive[e] = True
        for l in range(Ep[e + 1] - 1, Ep[e] - 1, -1):
            link[l], head[e] = head[e], l
            size[e] += weight[Ei[l]]
    return Quotient(
        *(its, Np, Np[1:] - Np[:-1], head, link, Ei, size, alive),
        *(weight.copy(), np.ones(n, np.bool_), np.arange(n), np.full(n, -1)),
    )


@kernel
def by_degree(graph, given):
    """The `Queue` of all nodes."""
    n, most = graph.weight.size, graph.weight.sum()
    queue = Queue(np.zeros(n, np.int64), np.full(most + 1, -1), np.full(n, -1), np.full(n, -1))
    for v in range(n - 1, -1, -1):
        for a in range(graph.Np[v], graph.Np[v + 1]):
            queue.degree[v] += graph.size[graph.its[a]] - graph.weight[v]
        queue.degree[v] = min(queue.degree[v], most)
        put(queue, v)
    return queue


@stage
def put(queue, v):
    """Node v becomes the first of its degree."""
    degree, first, after, before = queue
    d = degree[v]
    after[v], before[v] = first[d], -1
    if first[d] >= 0:
        before[first[d]] = v
    first[d] = v


@stage
def take(queue, v):
    """Node v leaves the list of its degree."""
    degree, first, after, before = queue
    if before[v] >= 0:
        after[before[v]] = after[v]
    else:
        first[degree[v]] = after[v]
    if after[v] >= 0:
        before[after[v]] = before[v]


@stage
def leave(graph, order, done, v):
    """Node v, and all that go with it, are next in the order; returns how many are in it."""
    graph.there[v] = False
    while v >= 0:
        order[done] = v
        done += 1
        v = graph.follower[v]
    return done


@stage
def merge(graph, marks, pivot, new):
    """The elements of the pivot become one; returns how many columns it couples."""
    head, link, total = graph.head, graph.link, 0
    for a in range(graph.Np[pivot], graph.Np[pivot] + graph.many[pivot]):
        e = graph.its[a]
        if not graph.alive[e]:
            continue
        graph.alive[e] = False
        l = head[e]
        while l >= 0:
            following, v = link[l], graph.node[l]
            if graph.there[v] and marks.seen[v] != pivot:
                marks.seen[v] = pivot
                total += graph.weight[v]
                link[l], head[new] = head[new], l
            l = following
    return total


@stage
def look_outside(graph, marks, pivot, new):
    """How many columns of every other element, of a node of the new one, are outside it."""
    l = graph.head[new]
    while l >= 0:
        v = graph.node[l]
        for a in range(graph.Np[v], graph.Np[v] + graph.many[v]):
            e = graph.its[a]
            if graph.alive[e]:
                if marks.looked[e] != pivot:
                    marks.looked[e], marks.outside[e] = pivot, graph.size[e]
                marks.outside[e] -= graph.weight[v]
        l = graph.link[l]


@stage
def sort_out(graph, queue, marks, order, done, new, total):
    """Of the new element, whoever is in no other is eliminated; the others have a new degree.

    Returns how many are in the order, and how many columns the element still couples.
    """
    its, Np, many, link = graph.its, graph.Np, graph.many, graph.link
    l, kept, rest = graph.head[new], -1, total
    while l >= 0:
        v, following = graph.node[l], link[l]
        take(queue, v)
        end, coupled_to = Np[v], total - graph.weight[v]
        for a in range(Np[v], Np[v] + many[v]):
            e = its[a]
            if graph.alive[e] and marks.outside[e] > 0:
                its[end] = e
                end += 1
                coupled_to += marks.outside[e]
        if end == Np[v]:
            rest -= graph.weight[v]
            done = leave(graph, order, done, v)
        else:
            its[end] = new
            many[v] = end + 1 - Np[v]
            queue.degree[v] = min(coupled_to, queue.first.size - 1)
            link[l], kept = kept, l
        l = following
    graph.head[new], graph.size[new], graph.alive[new] = kept, rest, True
    return done, rest


@stage
def join_alike(graph, queue, marks, pivot, new):
    """Nodes of the new element that are in the same elements become one."""
    its, Np, many, link = graph.its, graph.Np, graph.many, graph.link
    l, kept = graph.head[new], -1
    while l >= 0:
        v, following, bits = graph.node[l], link[l], 0
        for a in range(Np[v], Np[v] + many[v]):
            bits += its[a]
        slot = bits % marks.met.size
        first = marks.slots[slot] if marks.met[slot] == pivot else -1
        u = first
        while u >= 0 and not alike(graph, u, v):
            u = marks.others[u]
        if u < 0:
            marks.others[v], marks.slots[slot], marks.met[slot] = first, v, pivot
            link[l], kept = kept, l
        else:
            graph.there[v] = False
            graph.weight[u] += graph.weight[v]
            queue.degree[u] -= graph.weight[v]
            graph.follower[graph.tail[u]], graph.tail[u] = v, graph.tail[v]
        l = following
    graph.head[new] = kept


@stage
def alike(graph, u, v):
    """Whether two nodes are in the same elements."""
    its, Np, many = graph.its, graph.Np, graph.many
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
def coupled(Ep, Ei, Np, its, order):
    """begin (n + 1,), before: node order[v] is called v; the nodes before each that share an
    element with it.  Np (n + 1,), its : the elements of every node."""
    n, place = order.size, np.empty(order.size, np.int32)
    for v in range(n):
        place[order[v]] = v
    begin, before, end = np.zeros(n + 1, np.int64), np.empty(max(16, 4 * Ei.size), np.int32), 0
    seen = np.full(n, -1, np.int32)
    for v in range(n):
        for a in range(Np[order[v]], Np[order[v] + 1]):
            e = its[a]
            if end + Ep[e + 1] - Ep[e] > before.size:
                before = np.concatenate((before, before))
            for l in range(Ep[e], Ep[e + 1]):  # without a branch, which could not be foretold
                u = place[Ei[l]]
                before[end] = u
                end += (u < v) & (seen[u] != v)
                seen[u] = v
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
