"""Small files of every foreign format, as their own tools would write them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import h5py
import numpy as np
import scipy.sparse as sp
from scipy.io import savemat

BOUNDED = {"lb": np.array([0.0, 0.0, -1.0, -np.inf]), "ub": np.array([np.inf, 2.0, 1.0, np.inf])}


def numbers(seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """A (6, 4) and b (6,)."""
    rng = np.random.default_rng(seed)
    return rng.standard_normal((6, 4)), rng.standard_normal(6)


def quadratic(seed: int = 0) -> dict[str, np.ndarray]:
    """P definite, q, an inequality of each sort, an equality and bounds."""
    A, b = numbers(seed)
    G, E = numbers(seed + 1)[0][:2], numbers(seed + 2)[0][:1]
    inside = np.array([0.5, 1.0, 0.2, -0.4])
    return {"P": A.T @ A, "q": A.T @ b, "G": G, "h": G @ inside + [0.1, 2.0], "A": E,
            "b": E @ inside, **BOUNDED}  # fmt: skip


def contacts(count: int = 3, dim: int = 2, seed: int = 0) -> tuple[np.ndarray, ...]:
    """M diagonal, H, f, w of contacts of which one is redundant, and mu."""
    rng = np.random.default_rng(seed)
    M = np.diag(rng.uniform(1.0, 3.0, dim * count))
    H = rng.standard_normal((dim * count, dim * count))
    H[:, -dim:] = H[:, :dim]
    return M, H, rng.standard_normal(len(M)) - 1.0, np.zeros(len(M)), np.full(count, 0.4)


def delassus(count: int = 3, dim: int = 2, seed: int = 0) -> tuple[np.ndarray, ...]:
    """W, q and mu of `contacts`."""
    M, H, f, w, mu = contacts(count, dim, seed)
    return H.T @ np.linalg.solve(M, H), H.T @ np.linalg.solve(M, f) + w, mu


def siconos_text(W: np.ndarray, q: np.ndarray, mu: np.ndarray, tail: str = "") -> str:
    """Dense."""
    n, dim = len(q), len(q) // len(mu)
    values = [" ".join(f"{v:.24e}" for v in part) for part in (W.ravel(order="F"), q, mu)]
    head = f"{dim}\n{len(mu)}\n0\n{n}\n{n}\n{n}\t{n}\n"
    return head + "\n".join(values) + tail + "\n"


def siconos_blocks(W: np.ndarray, q: np.ndarray, mu: np.ndarray) -> str:
    """In blocks of a contact each, all of them stored."""
    n, c = len(q), len(mu)
    dim = n // c
    ends = "\t".join(str(dim * (i + 1)) for i in range(c))
    parts = [f"{dim}\n{c}\n1\n{n}\n{n}\n{c * c}\n{c}\n{c}\n{ends}\n{ends}\n{c + 1}\n{c * c}"]
    parts.append(" ".join(str(c * i) for i in range(c + 1)))
    parts.append(" ".join(str(j) for _ in range(c) for j in range(c)))
    for i in range(c):
        for j in range(c):
            block = W[dim * i : dim * (i + 1), dim * j : dim * (j + 1)]
            parts += [str(c * i + j), " ".join(f"{v:.24e}" for v in block.ravel(order="F"))]
    parts += [" ".join(f"{v:.24e}" for v in part) for part in (q, mu)]
    return "\n".join(parts) + "\n1\n"


def put_matrix(group: h5py.Group, M: np.ndarray, way: str = "columns") -> None:
    """way : columns, rows, triplets (rows in i) or turned (rows in p, as the header says)"""
    if way in ("columns", "rows"):
        made: Any = (sp.csc_array if way == "columns" else sp.csr_array)(M)
        p, i, x, nz = made.indptr, made.indices, made.data, -1 if way == "columns" else -2
    else:
        made = sp.coo_array(M)
        rows, columns = made.coords
        p, i, x, nz = columns, rows, made.data, made.nnz
        if way == "turned":
            p, i = i, p
    parts = {"m": [M.shape[0]], "n": [M.shape[1]], "nz": [nz], "nzmax": [len(x)], "p": p, "i": i}
    for name, values in parts.items():
        group[name] = np.asarray(values, np.int32)
    group["x"] = np.asarray(x, float)


def fclib_local(path: Path, W: Any, q: Any, mu: Any, way: str = "columns") -> Path:
    with h5py.File(path, "w") as file:
        group = file.create_group("fclib_local")
        group["spacedim"] = np.array([len(q) // len(mu)], np.int32)
        put_matrix(group.create_group("W"), W, way)
        group["vectors/q"], group["vectors/mu"] = q, mu
        file["solution/r"] = np.zeros(len(q))
        file["solution/u"] = np.zeros(len(q))
    return path


def fclib_global(path: Path, parts: Any, way: str = "triplets", G: Any = None) -> Path:
    M, H, f, w, mu = parts
    with h5py.File(path, "w") as file:
        group = file.create_group("fclib_global")
        group["spacedim"] = np.array([len(w) // len(mu)], np.int32)
        put_matrix(group.create_group("M"), M, "triplets")
        put_matrix(group.create_group("H"), H, way)
        for name, value in (("f", f), ("w", w), ("mu", mu)):
            group[f"vectors/{name}"] = value
        if G is not None:
            put_matrix(group.create_group("G"), G, way)
            group["vectors/b"] = np.zeros(G.shape[1])
    return path


def maros(path: Path, seed: int = 0, general: bool = True) -> Path:
    """As the set is stored: bounds as the last rows of A, integers of one byte, 1e20 for ∞."""
    parts = quadratic(seed)
    finite = [np.where(np.isinf(v), np.sign(v) * 1e20, v) for v in (parts["lb"], parts["ub"])]
    rows = [parts["G"], parts["A"], np.eye(4)] if general else [np.eye(4)]
    low = [np.full(2, -1e20), parts["b"], finite[0]] if general else [finite[0]]
    high = [parts["h"], parts["b"], finite[1]] if general else [finite[1]]
    savemat(path, {"P": sp.csc_matrix(parts["P"]), "q": parts["q"][:, None], "r": np.uint8(0),
                   "n": np.uint8(4), "m": np.uint8(7), "A": sp.csc_matrix(np.vstack(rows)),
                   "l": np.concatenate(low)[:, None],
                   "u": np.concatenate(high)[:, None]})  # fmt: skip
    return path
