"""The arrays of a recording file: their names, types, units and sizes, and both ways through.

1. `FIELDS` is the table of all datasets, but for those of bodies in space (`OF_SPACE`, `OF_HULLS`)
   and of their friction (`OF_DISCS`), which only a file with such holds; the file carries the same
   words as attributes.
2. `pack` joins the quantities of all QPs into flat arrays, in solve order.
3. `check_lengths` tells from the few small arrays of sizes how long every other must be.
4. `unpack` cuts the flat arrays up again; the types `ContactQP`, `Solution` and
   `DiscQP` check the values.

`harness.recordings.recording` says how the file is to be read and holds the digest.
"""

from __future__ import annotations

from collections.abc import Callable, Container, Iterator, Mapping, Sequence
from dataclasses import fields
from functools import reduce
from operator import or_
from typing import Any, NamedTuple

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from problems.qp import FEATURE_FIELDS, ContactQP, Solution, Status, WorkCounts
from problems.space.discs import DiscQP
from problems.space.solids import Solid

WORK = tuple(entry.name for entry in fields(WorkCounts))


class Field(NamedTuple):
    """One dataset of the file: NumPy type ("S": UTF-8 of fixed length), shape beyond the first
    axis, unit and meaning."""

    dtype: str
    columns: tuple[int | str, ...]
    unit: str
    meaning: str


FIELDS: dict[str, Field] = {
    "qps/m": Field("<i8", (), "1", "rows of A: coordinates of the bodies"),
    "qps/k": Field("<i8", (), "1", "columns of A: unknown multipliers"),
    "qps/A_nnz": Field("<i8", (), "1", "stored entries of a sparse A; -1: A is dense"),
    "qps/A_data": Field("<f8", (), "SI", "A = D^-T G (or D^-T G V): dense rows, or CSC values"),
    "qps/A_indices": Field("<i8", (), "1", "CSC row indices of sparse A"),
    "qps/A_indptr": Field("<i8", (), "1", "CSC column starts of sparse A, k+1 for each"),
    "qps/d": Field("<f8", (), "SI", "d = D c_n / h_n (3.2)"),
    "qps/D": Field("<f8", (), "kg^1/2, kg^1/2 m", "diagonal of D, M = D^T D"),
    "qps/lower": Field("<f8", (), "SI", "lower bounds, -inf allowed"),
    "qps/upper": Field("<f8", (), "SI", "upper bounds, +inf allowed"),
    "qps/mu": Field("<f8", (), "1", "friction coefficient of a tangent row's contact, else 0"),
    "qps/row_id": Field("<i8", (), "1", "identity of a row along the sequence"),
    "qps/feature": Field(
        "<i8", (len(FEATURE_FIELDS),), "1", "columns: " + ", ".join(FEATURE_FIELDS)
    ),
    "qps/V_rows": Field("<i8", (), "1", "rows l of the generators V; -1: none, x is lambda"),
    "qps/V_data": Field("<f8", (), "1", "generators V (l, k), lambda = V x, row by row"),
    "qps/kind": Field("S", (), "", "step, iteration, corrector, impulse or minimum_norm"),
    "qps/accepted": Field("|u1", (), "1", "0: the step was rejected or cut short by an event"),
    "qps/restart": Field("|u1", (), "1", "1: first QP after a discontinuity"),
    "qps/t": Field("<f8", (), "s", "end of the step"),
    "qps/h": Field("<f8", (), "s", "length of the step"),
    "qps/alpha0": Field("<f8", (), "1", "alpha_0 of the BDF formula"),
    "qps/eps0": Field("<f8", (), "as A x", "accuracy in |A dx| that the stepper asks for (3.13)"),
    "solutions/answered": Field("|u1", (), "1", "0: the stepper's solver gave no x"),
    "solutions/x": Field("<f8", (), "SI", "the stepper's own x; 0 where there is none"),
    "solutions/working_set": Field("|i1", (), "1", "-1 at lower, 0 free, 1 at upper, 2 passive"),
    "solutions/status": Field("S", (), "", "name of the solver's own status"),
    "solutions/status_text": Field("S", (), "", "the solver's own words"),
    "solutions/iterations": Field("<i8", (), "1", "the solver's own count"),
    "solutions/counted": Field("|u1", (), "1", "1: work holds counts"),
    "solutions/work": Field("<i8", (len(WORK),), "1", "columns: " + ", ".join(WORK)),
    "references/accepted": Field("|u1", (), "1", "1: the oracle's answer passed its check"),
    "references/x": Field("<f8", (), "SI", "the oracle's x, one of many where A lacks rank"),
    "references/Ax": Field("<f8", (), "SI", "the unique A x*; 0 where not accepted"),
    "references/error_bound": Field("<f8", (), "as A x", "bound on the error of references/Ax"),
    "references/proof": Field("S", (), "", "exact, bound, nearby, ill-posed; empty: no reference"),
    "bodies/polygon_count": Field("<i8", (), "1", "convex polygons of each body"),
    "bodies/corner_count": Field("<i8", (), "1", "corners of each polygon"),
    "bodies/corners": Field("<f8", (2,), "m", "corners in body coordinates, counter-clockwise"),
    "motion/t": Field("<f8", (), "s", "times of the accepted steps"),
    "motion/q": Field("<f8", ("bodies", 3), "m, m, rad", "x, y, phi of each body"),
    "motion/v": Field("<f8", ("bodies", 3), "m/s, m/s, rad/s", "velocities of each body"),
    "events/t": Field("<f8", (), "s", "time of the event"),
    "events/kind": Field("S", (), "", "impulse, slide_off, slip_to_stick, ..."),
    "events/detail": Field("S", (), "", "what happened to which contact"),
}
"""Every dataset of a file, …"""

OF_SPACE: dict[str, Field] = {
    "space/solids": Field("<f8", (8,), "kg, kg m^2, m", "mass, moments, sides, radius of each"),
    "space/poses": Field("<f8", ("solids", 7), "m, 1", "centre and attitude (w, x, y, z) of each"),
    "space/velocities": Field("<f8", ("solids", 6), "m/s, rad/s", "velocities of each"),
    "space/reactions": Field("<f8", ("solids", 6), "N, N m", "G lambda, all constraint forces"),
}
"""… those of one whose bodies move in space, …"""
OF_HULLS: dict[str, Field] = {
    "space/corner_count": Field("<i8", (), "1", "corners of each solid that is a polyhedron, or 0"),
    "space/corners": Field("<f8", (3,), "m", "corners in axes of the solid"),
}
"""… of one with polyhedra among them, …"""
OF_DISCS: dict[str, Field] = {
    **{
        f"discs/{name}": FIELDS[f"qps/{name}"]
        for name in (
            *("m", "k", "A_nnz", "A_data", "A_indices", "A_indptr"),
            *("d", "lower", "upper", "t"),
        )
    },
    "discs/count": Field("<i8", (), "1", "discs of each QP"),
    "discs/pairs": Field("<i8", (2,), "1", "columns i, j of A: |(x_i, x_j)| is at most the radius"),
    "discs/radius": Field("<f8", (), "SI", "radius of each disc, mu lambda_N (6.1)"),
    "discs/x": Field("<f8", (), "SI", "the stepper's own x, found by bounds alone"),
}
"""… and of one that knows the QPs with Coulomb's discs."""

MAY_BE_INFINITE = {
    *("qps/lower", "qps/upper", "references/error_bound"),
    *("discs/lower", "discs/upper"),
}


class SpaceMotion(NamedTuple):
    """How bodies in space have moved, at the accepted steps.

    solids : (s, 8) mass [kg], principal moments [kg·m²], sides of a box and radius of a ball [m]
    poses : (n, s, 7) centre [m] and attitude;  velocities : (n, s, 6) [m/s, rad/s]
    reactions : (n, s, 6) G λ [N, N·m]
    corner_count : (s,) corners of each body that is a polyhedron, or 0;  corners : of all, (c, 3)
        [m];  both None where none is
    """

    solids: NDArray[np.float64]
    poses: NDArray[np.float64]
    velocities: NDArray[np.float64]
    reactions: NDArray[np.float64]
    corner_count: NDArray[np.int64] | None = None
    corners: NDArray[np.float64] | None = None

    @classmethod
    def of(
        cls,
        bodies: Sequence[Solid],
        poses: NDArray[np.float64],
        velocities: NDArray[np.float64],
        reactions: NDArray[np.float64],
    ) -> SpaceMotion:
        """Of these bodies."""
        solids = np.array([(s.mass, *s.inertia, *s.sides, s.radius) for s in bodies])
        points = [s.points for s in bodies]
        moving = solids, poses, velocities, reactions
        if not any(points):
            return cls(*moving)
        corners = np.array([corner for own in points for corner in own])
        return cls(*moving, np.array(list(map(len, points))), corners)

    def bodies(self) -> tuple[Solid, ...]:
        """The bodies.  Raises ValueError for numbers that no body has."""
        points: list[list[Any]] = [[] for _ in self.solids]
        if self.corner_count is not None and self.corners is not None:
            ends = np.cumsum(self.corner_count)[:-1]
            points = [part.tolist() for part in np.split(self.corners, ends)]
        return tuple(
            Solid(mass, (x, y, z), radius, (a, b, c), tuple(map(tuple, own)))
            for (mass, x, y, z, a, b, c, radius), own in zip(
                self.solids.tolist(), points, strict=True
            )
        )


BEYOND_THE_PLANE = (OF_SPACE, OF_HULLS, OF_DISCS)


def fields_of(names: Container[str]) -> dict[str, Field]:
    """The datasets of a file that holds these, or should."""
    groups = (group for group in BEYOND_THE_PLANE if any(name in names for name in group))
    return reduce(or_, groups, FIELDS)


def check_lengths(
    arrays: Mapping[str, NDArray[Any]], wrong: Callable[[str, str], ValueError]
) -> None:
    """Raise `wrong(field, what)` where the sizes of the arrays do not fit together."""
    sizes = _lengths_of_qps(arrays, "qps", wrong)
    m, k, rows, polygons, corners = (
        _integers(arrays[name])
        for name in (
            *("qps/m", "qps/k", "qps/V_rows"),
            *("bodies/polygon_count", "bodies/corner_count"),
        )
    )
    n, bodies = len(m), len(polygons)
    if len(rows) != n:
        raise wrong("qps/V_rows", f"has {len(rows)} entries; there are {n} QPs")
    if min([0, *rows]) < -1:
        raise wrong("qps/V_rows", "has a number of rows below -1")
    for name, counts in (("polygon_count", polygons), ("corner_count", corners)):
        if min([0, *counts]) < 0:
            raise wrong(f"bodies/{name}", "has a negative number")
    if any(row > 0 and b == 0 for row, b in zip(rows, k, strict=True)):
        raise wrong("qps/V_rows", "asks for generators of no columns")
    sizes |= {
        "qps/V_data": sum(row * b for row, b in zip(rows, k, strict=True) if row >= 0),
        "bodies/corner_count": sum(polygons),
        "bodies/corners": sum(corners),
    }
    for name in ("qps/D", "references/Ax"):
        sizes[name] = sum(m)
    for name in ("mu", "row_id", "feature"):
        sizes[f"qps/{name}"] = sum(k)
    for name in ("solutions/x", "solutions/working_set", "references/x"):
        sizes[name] = sum(k)
    defaults = {"bodies": bodies}
    if "discs/m" in arrays:
        defaults["discs"] = len(arrays["discs/m"])
        sizes |= _lengths_of_qps(arrays, "discs", wrong)
        discs = _integers(arrays["discs/count"])
        if min([0, *discs]) < 0:
            raise wrong("discs/count", "has a negative number of discs")
        sizes["discs/x"] = sum(_integers(arrays["discs/k"]))
        sizes |= dict.fromkeys(("discs/pairs", "discs/radius"), sum(discs))
    steps, events = arrays["motion/t"].shape[0], arrays["events/t"].shape[0]
    solids = arrays["space/solids"].shape[0] if "space/solids" in arrays else 0
    sizes["space/solids"] = sizes["space/corner_count"] = solids
    if "space/corner_count" in arrays:
        counts = _integers(arrays["space/corner_count"])
        if min([0, *counts]) < 0:
            raise wrong("space/corner_count", "has a negative number of corners")
        sizes["space/corners"] = sum(counts)
    defaults |= {"motion": steps, "space": steps, "events": events}
    named = {"bodies": bodies, "solids": solids}
    for name, field in fields_of(arrays).items():
        default = defaults.get(name.partition("/")[0], n)
        columns = tuple(named[c] if isinstance(c, str) else c for c in field.columns)
        expected = (sizes.get(name, default), *columns)
        if arrays[name].shape != expected:
            raise wrong(name, f"has shape {arrays[name].shape}; the sizes ask for {expected}")


def _integers(array: NDArray[Any]) -> list[int]:
    """As Python's integers, which do not overflow."""
    return [int(value) for value in array.ravel()]


def _lengths_of_qps(
    arrays: Mapping[str, NDArray[Any]], group: str, wrong: Callable[[str, str], ValueError]
) -> dict[str, int]:
    """How long the arrays of A, d and bounds of all QPs of a group must be."""
    m, k, nnz = (_integers(arrays[f"{group}/{name}"]) for name in ("m", "k", "A_nnz"))
    if not len(k) == len(nnz) == len(m):
        raise wrong(f"{group}/m", f"has {len(m)} entries, k and A_nnz {len(k)} and {len(nnz)}")
    if min([0, *m, *k]) < 0 or min([0, *nnz]) < -1:
        raise wrong(f"{group}/m", "it or another size is negative")
    sizes = {
        "A_data": sum(a * b if s < 0 else s for a, b, s in zip(m, k, nnz, strict=True)),
        "A_indices": sum(s for s in nnz if s >= 0),
        "A_indptr": sum(b + 1 for b, s in zip(k, nnz, strict=True) if s >= 0),
        "d": sum(m),
        "lower": sum(k),
        "upper": sum(k),
    }
    return {f"{group}/{name}": size for name, size in sizes.items()}


def _texts(values: Sequence[str]) -> NDArray[Any]:
    """UTF-8 strings of one fixed length, which unlike HDF5's variable ones are stored flat."""
    return np.array([value.encode() for value in values] or [b""], dtype=np.bytes_)[: len(values)]


def _join(parts: Sequence[Any], dtype: str, columns: tuple[int, ...] = ()) -> NDArray[Any]:
    """Parts one after the other; flattened where there are no further columns."""
    whole = [np.asarray(part, dtype).reshape(-1, *columns) for part in parts]
    return np.concatenate([np.empty((0, *columns), dtype), *whole])


def pack(recording: Any) -> dict[str, NDArray[Any]]:
    """The arrays of `FIELDS` for a Recording.

    Raises ValueError where its QPs, solutions, references and mu do not belong together.
    """
    qps, solutions, references = recording.qps, recording.solutions, recording.references
    if not len(qps) == len(solutions) == len(references) == len(recording.mu):
        raise ValueError(
            f"{len(qps)} QPs need as many solutions, references and mu; "
            f"got {len(solutions)}, {len(references)} and {len(recording.mu)}"
        )
    for i, (qp, solution) in enumerate(zip(qps, solutions, strict=True)):
        if not np.array_equal(qp.row_id, solution.row_id):
            raise ValueError(f"solution {i} has other row_ids than its QP")
    V = [qp.generators for qp in qps]
    flat = [polygon for body in recording.polygons for polygon in body]
    out: dict[str, Any] = {
        **_packed_qps(qps, "qps"),
        **_packed_solutions(qps, solutions),
        **_packed_references(qps, references),
        "qps/mu": _join(recording.mu, "<f8"),
        "qps/V_rows": [-1 if part is None else part.shape[0] for part in V],
        "qps/V_data": _join([part for part in V if part is not None], "<f8"),
        "bodies/polygon_count": [len(body) for body in recording.polygons],
        "bodies/corner_count": [len(polygon) for polygon in flat],
        "bodies/corners": _join(flat, "<f8", (2,)),
        "motion/t": recording.t,
        "motion/q": recording.q,
        "motion/v": recording.v,
        "events/t": [event.t for event in recording.events],
        "events/kind": [event.kind for event in recording.events],
        "events/detail": [event.detail for event in recording.events],
    }
    for name in ("D", "row_id", "feature"):
        field = FIELDS[f"qps/{name}"]
        columns = (len(FEATURE_FIELDS),) if name == "feature" else ()
        out[f"qps/{name}"] = _join([getattr(qp, name) for qp in qps], field.dtype, columns)
    for name in ("kind", "accepted", "restart", "h", "alpha0", "eps0"):
        out[f"qps/{name}"] = [getattr(qp, name) for qp in qps]
    if recording.space is not None:
        moving = zip((*OF_SPACE, *OF_HULLS), recording.space, strict=True)
        out |= {name: values for name, values in moving if values is not None}
    if recording.discs:
        out |= _packed_discs(recording.discs)
    return {
        name: _texts(out[name])
        if field.dtype == "S"
        else np.ascontiguousarray(out[name], dtype=field.dtype)
        for name, field in fields_of(out).items()
    }


def _packed_qps(qps: Sequence[Any], group: str) -> dict[str, Any]:
    """A, d, bounds and time of QPs of either sort."""
    matrices: list[Any] = [qp.A for qp in qps]
    sparse = [A for A in matrices if sp.issparse(A)]
    out = {
        "m": [A.shape[0] for A in matrices],
        "k": [A.shape[1] for A in matrices],
        "A_nnz": [A.nnz if sp.issparse(A) else -1 for A in matrices],
        "A_data": _join([A.data if sp.issparse(A) else A for A in matrices], "<f8"),
        "A_indices": _join([A.indices for A in sparse], "<i8"),
        "A_indptr": _join([A.indptr for A in sparse], "<i8"),
        "t": [qp.t for qp in qps],
        **{
            name: _join([getattr(qp, name) for qp in qps], "<f8")
            for name in ("d", "lower", "upper")
        },
    }
    return {f"{group}/{name}": values for name, values in out.items()}


def _packed_solutions(qps: Sequence[ContactQP], solutions: Sequence[Solution]) -> dict[str, Any]:
    """The datasets of the stepper's answers."""
    work = [s.work or WorkCounts() for s in solutions]
    x = [np.zeros(qp.k) if s.x is None else s.x for qp, s in zip(qps, solutions, strict=True)]
    return {
        "solutions/answered": [s.x is not None for s in solutions],
        "solutions/x": _join(x, "<f8"),
        "solutions/working_set": _join([s.working_set for s in solutions], "|i1"),
        "solutions/status": [s.status.name for s in solutions],
        "solutions/status_text": [s.status_text for s in solutions],
        "solutions/iterations": [s.iterations for s in solutions],
        "solutions/counted": [s.work is not None for s in solutions],
        "solutions/work": _join([[getattr(w, n) for n in WORK] for w in work], "<i8", (len(WORK),)),
    }


def _packed_references(qps: Sequence[ContactQP], references: Sequence[Any]) -> dict[str, Any]:
    """The datasets of the oracle's answers, 0 where there is none."""
    pairs = list(zip(qps, references, strict=True))
    return {
        "references/accepted": [ref is not None for ref in references],
        "references/error_bound": [0.0 if ref is None else ref.error_bound for ref in references],
        "references/proof": ["" if ref is None else ref.proof for ref in references],
        "references/x": _join([np.zeros(qp.k) if r is None else r.x for qp, r in pairs], "<f8"),
        "references/Ax": _join([np.zeros(qp.m) if r is None else r.Ax for qp, r in pairs], "<f8"),
    }


def _packed_discs(discs: Sequence[tuple[DiscQP, Any]]) -> dict[str, Any]:
    qps, answers = zip(*discs, strict=True)
    return {
        **_packed_qps(qps, "discs"),
        "discs/count": [len(qp.radius) for qp in qps],
        "discs/pairs": _join([qp.discs for qp in qps], "<i8", (2,)),
        "discs/radius": _join([qp.radius for qp in qps], "<f8"),
        "discs/x": _join(answers, "<f8"),
    }


def unpack(arrays: Mapping[str, NDArray[Any]]) -> dict[str, Any]:
    """The inverse of `pack`: the fields of a Recording by name.

    References are tuples (x, Ax, error_bound, proof) or None, events tuples (t, kind, detail).
    Raises ValueError or KeyError for values that the types refuse.
    """
    text = {
        name: [value.decode() for value in array.tolist()]
        for name, array in arrays.items()
        if array.dtype.kind == "S"
    }
    take = _Reader(arrays)
    indices = range(len(arrays["qps/m"]))
    qps = tuple(_unpack_qp(take, arrays, text["qps/kind"][i], i) for i in indices)
    solutions = tuple(_unpack_solution(take, arrays, text, qps[i], i) for i in indices)
    references = []
    for i, qp in enumerate(qps):
        x, Ax = take("references/x", qp.k), take("references/Ax", qp.m)
        bound = float(arrays["references/error_bound"][i])
        known = (x, Ax, bound, text["references/proof"][i])
        references.append(known if arrays["references/accepted"][i] else None)
    sizes = iter(arrays["bodies/corner_count"].tolist())
    polygons = tuple(
        tuple(take("bodies/corners", next(sizes)) for _ in range(count))
        for count in arrays["bodies/polygon_count"].tolist()
    )
    moving = [arrays[name] for name in (*OF_SPACE, *OF_HULLS) if name in arrays]
    for array in (arrays["motion/t"], arrays["motion/q"], arrays["motion/v"], *moving):
        array.setflags(write=False)
    return {
        "qps": qps,
        "solutions": solutions,
        "references": references,
        "mu": tuple(take("qps/mu", qp.k) for qp in qps),
        "polygons": polygons,
        "t": arrays["motion/t"],
        "q": arrays["motion/q"],
        "v": arrays["motion/v"],
        "space": _in_space(moving) if moving else None,
        "discs": tuple(_unpack_discs(take, arrays)) if "discs/m" in arrays else (),
        "events": list(
            zip(
                arrays["events/t"].tolist(), text["events/kind"], text["events/detail"], strict=True
            )
        ),
    }


def _in_space(moving: Sequence[NDArray[Any]]) -> SpaceMotion:
    motion = SpaceMotion(*moving)
    motion.bodies()
    if (np.abs(np.linalg.norm(motion.poses[:, :, 3:], axis=2) - 1) > 1e-6).any():
        raise ValueError("space/poses holds an attitude that is not of unit length")
    return motion


def _unpack_discs(
    take: _Reader, arrays: Mapping[str, NDArray[Any]]
) -> Iterator[tuple[DiscQP, NDArray[np.float64]]]:
    for i, t in enumerate(arrays["discs/t"].tolist()):
        n = int(arrays["discs/count"][i])
        pairs, radius = take("discs/pairs", n), take("discs/radius", n)
        qp = DiscQP(*_unpack_posed(take, arrays, "discs", i), pairs, radius, t)
        yield qp, take("discs/x", qp.k)


def _unpack_posed(
    take: _Reader, arrays: Mapping[str, NDArray[Any]], group: str, i: int
) -> tuple[Any, Any, Any, Any]:
    """A, d and bounds of QP i of a group."""
    m, k, nnz = (int(arrays[f"{group}/{name}"][i]) for name in ("m", "k", "A_nnz"))
    A, d = _matrix(take, group, m, k, nnz), take(f"{group}/d", m)
    return A, d, take(f"{group}/lower", k), take(f"{group}/upper", k)


def _unpack_qp(take: _Reader, arrays: Mapping[str, NDArray[Any]], kind: str, i: int) -> ContactQP:
    m, k, rows = (int(arrays[f"qps/{n}"][i]) for n in ("m", "k", "V_rows"))
    A, d, lower, upper = _unpack_posed(take, arrays, "qps", i)
    return ContactQP(
        A,
        d,
        lower,
        upper,
        row_id=take("qps/row_id", k),
        feature=take("qps/feature", k),
        D=take("qps/D", m),
        generators=None if rows < 0 else take("qps/V_data", rows * k).reshape(rows, k),
        kind=kind,
        accepted=bool(arrays["qps/accepted"][i]),
        restart=bool(arrays["qps/restart"][i]),
        **{n: float(arrays[f"qps/{n}"][i]) for n in ("t", "h", "alpha0", "eps0")},
    )


def _unpack_solution(
    take: _Reader,
    arrays: Mapping[str, NDArray[Any]],
    text: Mapping[str, list[str]],
    qp: ContactQP,
    i: int,
) -> Solution:
    x = take("solutions/x", qp.k)
    counted = arrays["solutions/counted"][i]
    return Solution(
        x=x if arrays["solutions/answered"][i] else None,
        row_id=qp.row_id,
        status=Status[text["solutions/status"][i]],
        status_text=text["solutions/status_text"][i],
        working_set=take("solutions/working_set", qp.k),
        iterations=int(arrays["solutions/iterations"][i]),
        work=WorkCounts(*arrays["solutions/work"][i].tolist()) if counted else None,
    )


class _Reader:
    """Takes the next entries of a flat array; the sizes were checked before."""

    def __init__(self, arrays: Mapping[str, NDArray[Any]]) -> None:
        self.arrays = arrays
        self.at = dict.fromkeys(arrays, 0)

    def __call__(self, name: str, size: int) -> NDArray[Any]:
        start = self.at[name]
        self.at[name] = start + size
        part = self.arrays[name][start : start + size]
        part.setflags(write=False)
        return part


def _matrix(take: _Reader, group: str, m: int, k: int, nnz: int) -> Any:
    if nnz < 0:
        return take(f"{group}/A_data", m * k).reshape(m, k)
    data, indices = take(f"{group}/A_data", nnz), take(f"{group}/A_indices", nnz)
    indptr = take(f"{group}/A_indptr", k + 1)
    inside = nnz == 0 or (indices.min() >= 0 and indices.max() < m)
    if indptr[0] != 0 or indptr[-1] != nnz or (np.diff(indptr) < 0).any() or not inside:
        raise ValueError(f"{group}/A_indptr or A_indices is no CSC matrix of shape {(m, k)}")
    return sp.csc_array((data, indices, indptr), shape=(m, k))
