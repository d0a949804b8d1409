"""FCLIB, the collection of frictional contact problems (HDF5), local and global; out: local, 2-D.

    local    u = W r + V λ + q, 0 = Vᵀr + R λ + s              rows of λ are equalities
    global   M v = H r + G λ + f, u = Hᵀv + w, 0 = Gᵀv + b     A = D⁻ᵀ[H G], M = DᵀD

by contact, the normal first.  Matrices are in three ways: `nz` = −1 by compressed columns, −2 by
compressed rows, else triplets.  Of triplets the library's header calls `p` the rows, and what wrote
the files takes `i` for them: what fits the shape is taken, and where both do, what wrote the files.
Solutions are not read: many files hold zeros.

Out goes W = AᵀA of the QPs of a motion in the plane, by columns.  Without tangents μ = 0, and the
file poses exactly the QP.  With friction its `math_info` is `associated`: the QP has the bounds
μ λ_N of before, which a format that knows Coulomb's law only cannot say.  An edge that lies on an
edge has one tangent for two normals, which it cannot say either: such QPs are left out.
"""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any, BinaryIO

import h5py
import numpy as np
import scipy.sparse as sp

from harness.exchange.apart import Arrays, arrays_apart
from harness.exchange.coulomb import Contacts
from harness.exchange.factors import Factor, factor
from harness.exchange.foreign import ENTRY_LIMIT, Foreign, matrix, vector
from harness.files.whole_files import write_whole
from harness.judging.contact_rows import contact_rows
from harness.judging.facts import rank_of
from harness.recordings.recording import Recording
from problems.qp import NORMAL, TANGENT, ContactQP, Indices, Matrix, Vector

SUFFIXES = (".hdf5", ".h5")
BY_COLUMNS, BY_ROWS = -1, -2
ASSOCIATED = "associated"
MATRICES, PARTS = ("W", "V", "R", "M", "H", "G"), ("m", "n", "nz", "p", "i", "x")
LOCAL = ("spacedim", "W", "V", "R", "vectors/q", "vectors/s", "vectors/mu")
GLOBAL = ("spacedim", "M", "H", "G", "vectors/f", "vectors/w", "vectors/b", "vectors/mu")
OPTIONAL = ("vectors/s", "vectors/b")


def read(file: BinaryIO) -> list[Contacts]:
    """The problem of an open file.  Raises Foreign, naming the dataset."""
    return [_problem(arrays_apart(_extract, file))]


def _extract(file: BinaryIO) -> Arrays:
    """All datasets of the problem, by name."""
    try:
        with h5py.File(file, "r") as opened:
            local, there = (_group(opened, f"fclib_{kind}") for kind in ("local", "global"))
            group, names = (local, LOCAL) if local is not None else (there, GLOBAL)
            if group is None:
                raise Foreign("file: holds neither fclib_local nor fclib_global")
            found = {"kind": np.array(local is not None)}
            for name in names:
                if name not in MATRICES:
                    if name not in OPTIONAL or _has(group, name):
                        found[name] = _numbers(group, name)
                elif _group(group, name) is not None:
                    found |= {f"{name}/{part}": _numbers(group, f"{name}/{part}") for part in PARTS}
            return found
    except Foreign:
        raise
    except MemoryError:
        raise Foreign("file: asks for more memory than there is") from None
    except Exception as error:  # the bytes are foreign: h5py raises whatever it comes upon
        raise Foreign(f"file: cannot be read as HDF5 ({str(error)[:120]})") from None


def _problem(found: Arrays) -> Contacts:
    dim = int(vector("spacedim", found["spacedim"], 1)[0])
    mu = vector("mu", found["vectors/mu"])
    if not 2 <= dim <= 3:
        raise Foreign(f"spacedim: is {dim}, and should be 2 or 3")
    return (_local if found["kind"] else _global)(found, dim, mu)


def _local(found: Arrays, dim: int, mu: Vector) -> Contacts:
    n = dim * mu.size
    W = _matrix(found, "W", (n, n))
    q = vector("q", found["vectors/q"], n)
    if "V/m" not in found:
        return Contacts(_dense(W), q, mu, dim)
    V = _matrix(found, "V", (n, None))
    free = V.shape[1]
    R = _matrix(found, "R", (free, free))
    s = vector("s", _there(found, "vectors/s"), free)
    whole = sp.block_array([[W, V], [sp.csc_array(V).T, R]])
    return Contacts(_dense(whole), np.r_[q, s], mu, dim, free=free)


def _global(found: Arrays, dim: int, mu: Vector) -> Contacts:
    f = vector("f", found["vectors/f"])
    M = _matrix(found, "M", (f.size, f.size))
    H = _matrix(found, "H", (f.size, dim * mu.size))
    q = vector("w", found["vectors/w"], dim * mu.size)
    free = 0
    if "G/m" in found:
        G = _matrix(found, "G", (f.size, None))
        free = G.shape[1]
        H = sp.csc_array(sp.hstack([H, G]))
        q = np.r_[q, vector("b", _there(found, "vectors/b"), free)]
    mass = factor(M, f, name="M")
    if mass.rank < f.size:
        raise Foreign(f"M: has rank {mass.rank} of {f.size}; a mass matrix is definite")
    # with M = AᵀA, A = D: D⁻ᵀH, and D⁻ᵀf = mass.d
    if sp.issparse(mass.A):
        A = sp.csc_array(sp.diags_array(1 / mass.A.diagonal()) @ H)
    else:
        A = np.linalg.solve(mass.A.T, _dense(H))
    d = mass.d
    lost = 0.0
    if q.any():  # a δ with Aᵀδ = q
        dense = _dense(A)
        shift = np.linalg.lstsq(dense.T, q, rcond=None)[0]
        lost = float(np.linalg.norm(dense.T @ shift - q) / np.linalg.norm(q))
        if lost > 1e-9:
            raise Foreign(f"w: is not in the range of Hᵀ: {lost:.1e} of it is lost")
        d = d + shift
    rank = rank_of(ContactQP(A, d, np.zeros(q.size), np.zeros(q.size)))
    made = Factor(A, d, rank, mass.asymmetry, mass.least, lost)
    return Contacts(None, np.asarray(A.T @ d), mu, dim, made=made, free=free)


def _group(parent: h5py.Group, name: str) -> h5py.Group | None:
    """A group of this very file, or None."""
    link = parent.get(name, getclass=True, getlink=True)
    if link is None:
        return None
    member = parent[name] if link is h5py.HardLink else None
    if not isinstance(member, h5py.Group):
        raise Foreign(f"{name}: is no group of this file")
    return member


def _has(group: h5py.Group, name: str) -> bool:
    outer, _, last = name.rpartition("/")
    inner = _group(group, outer)
    return inner is not None and inner.get(last, getlink=True) is not None


def _numbers(group: h5py.Group, name: str) -> np.ndarray:
    """A dataset of numbers of this very file."""
    *path, last = name.split("/")
    for step in path:
        inner = _group(group, step)
        if inner is None:
            raise Foreign(f"{name}: is missing")
        group = inner
    link = group.get(last, getclass=True, getlink=True)
    if link is not h5py.HardLink:
        raise Foreign(f"{name}: is {'missing' if link is None else 'a link elsewhere'}")
    dataset = group[last]
    if not isinstance(dataset, h5py.Dataset) or dataset.dtype.kind not in "fiu":
        raise Foreign(f"{name}: is no array of numbers")
    if dataset.size is None or dataset.size > ENTRY_LIMIT:
        raise Foreign(f"{name}: has {dataset.size} entries, more than {ENTRY_LIMIT:,}")
    made = dataset.id.get_create_plist()
    if made.get_external_count() or made.get_layout() == h5py.h5d.VIRTUAL:
        raise Foreign(f"{name}: is stored elsewhere")
    return np.asarray(dataset[()])


def _there(found: Arrays, name: str) -> np.ndarray:
    if name not in found:
        raise Foreign(f"{name}: is missing")
    return found[name]


def _matrix(found: Arrays, name: str, shape: tuple[int | None, int | None]) -> Matrix:
    m, n, nz = (
        int(_whole(f"{name}/{each}", _there(found, f"{name}/{each}"), 1)[0])
        for each in ("m", "n", "nz")
    )
    p, i = (_whole(f"{name}/{each}", _there(found, f"{name}/{each}")) for each in ("p", "i"))
    x = vector(f"{name}/x", _there(found, f"{name}/x"))
    if not (0 <= m <= ENTRY_LIMIT and 0 <= n <= ENTRY_LIMIT):
        raise Foreign(f"{name}: has shape {(m, n)}")
    if nz in (BY_COLUMNS, BY_ROWS):
        major, minor = (n, m) if nz == BY_COLUMNS else (m, n)
        count = int(p[-1]) if p.size == major + 1 else -1
        sound = (
            count == i.size == x.size and p[0] == 0 and bool((np.diff(p) >= 0).all())
            and bool(((i >= 0) & (i < minor)).all())
        )  # fmt: skip
        if not sound:
            raise Foreign(f"{name}: p and i are those of no compressed matrix {m} × {n}")
        kind: Any = sp.csc_array if nz == BY_COLUMNS else sp.csr_array
        made = kind((x, i, p), shape=(m, n))
    else:
        made = _triplets(name, (m, n), nz, p, i, x)
    made.sum_duplicates()
    return matrix(name, made, shape)


def _triplets(
    name: str, shape: tuple[int, int], nz: int, p: np.ndarray, i: np.ndarray, x: Vector
) -> Matrix:
    if not 0 <= nz <= min(p.size, i.size, x.size):
        raise Foreign(f"{name}: nz is {nz}, and p, i, x have {p.size}, {i.size}, {x.size} entries")
    p, i, x = p[:nz], i[:nz], x[:nz]
    for rows, columns in ((i, p), (p, i)):
        inside = (rows >= 0) & (rows < shape[0]) & (columns >= 0) & (columns < shape[1])
        if inside.all():
            return sp.csc_array((x, (rows, columns)), shape=shape)
    raise Foreign(f"{name}: p and i are no places in a matrix {shape[0]} × {shape[1]}")


def _whole(name: str, values: np.ndarray, size: int | None = None) -> np.ndarray:
    if values.dtype.kind not in "iu" or values.ndim != 1 or size not in (None, values.size):
        raise Foreign(f"{name}: holds {values.dtype} of shape {values.shape}, and should hold "
                      f"{'whole numbers' if size is None else 'one whole number'}")  # fmt: skip
    return values.astype(np.int64)


def _dense(M: Any) -> Vector:
    if max(M.shape) ** 2 > ENTRY_LIMIT:
        raise Foreign(f"matrices: have shape {M.shape}, too large to be factored")
    return M.toarray() if sp.issparse(M) else M


def write(folder: Path, recording: Recording) -> list[Path]:
    """Write LABEL_000000.hdf5, … into a folder, one for each QP whose rows are contacts in the
    plane with a normal and at most one tangent each.  Returns what is written.

    Raises ValueError where there is no such QP.
    """
    written = []
    for number, (qp, mu) in enumerate(zip(recording.qps, recording.mu, strict=True)):
        pairs = _pairs(qp)
        if pairs is None:
            continue
        path = folder / f"{recording.scene}_{number:06d}.hdf5"
        write_whole(path, _bytes(recording.scene, qp, pairs, mu))
        written.append(path)
    if not written:
        raise ValueError(
            f"{recording.scene}: no QP has contacts in the plane alone, each a normal with a "
            "tangent or none; export it as npz or qpbenchmark"
        )
    return written


def _pairs(qp: ContactQP) -> Indices | None:
    """(contacts, 2) rows: the normal, and its tangent or −1.

    None where rows are something else, or a tangent belongs to two normals.
    """
    direction = qp.feature[:, 4]
    if qp.k == 0 or qp.generators is not None or not np.isin(direction, (NORMAL, TANGENT)).all():
        return None
    tangents = {tuple(qp.feature[row, :4]): row for row in np.flatnonzero(direction == TANGENT)}
    normals = np.flatnonzero(direction == NORMAL)
    pairs = [(row, tangents.pop(tuple(qp.feature[row, :4]), -1)) for row in normals]
    members = contact_rows(qp).members
    shared = members.shape[0] and bool((members.sum(axis=1) > 1).any())
    return None if tangents or shared else np.array(pairs, np.int64)


def _bytes(name: str, qp: ContactQP, pairs: Indices, mu: Vector) -> bytes:
    rows = pairs.ravel()
    A = qp.dense_A[:, rows] * (rows >= 0)  # a tangent that there is none of moves nothing
    n = rows.size
    friction = np.where(pairs[:, 1] >= 0, mu[pairs[:, 1]], 0.0)
    said = "" if not friction.any() else ASSOCIATED
    buffer = io.BytesIO()
    with h5py.File(buffer, "w") as file:
        group = file.create_group("fclib_local")
        group["spacedim"] = np.array([2], np.int32)
        W = A.T @ A
        parts = {"m": n, "n": n, "nz": BY_COLUMNS, "nzmax": n * n, "p": n * np.arange(n + 1),
                 "i": np.tile(np.arange(n), n)}  # fmt: skip
        for each, value in parts.items():
            group[f"W/{each}"] = np.atleast_1d(np.asarray(value, np.int32))
        group["W/x"] = W.ravel()
        group["vectors/q"] = A.T @ qp.d
        group["vectors/mu"] = friction
        about = f"a QP of {name}, t = {qp.t:g} s" + (
            "; its friction bounds were lagged" if said else ""
        )
        for each, text in (("title", name), ("description", about), ("math_info", said)):
            group[f"info/{each}"] = np.bytes_(text.encode())
    return buffer.getvalue()
