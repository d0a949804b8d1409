"""Foreign files, damaged or with planted errors, drawn by number (`tests/endurance/fuzz.py`).

Formats of others have no seal, so a changed digit may be as good as the old one.  What is asked:

- *damaged* and *hostile*: the file is refused, or taken for what it says, as a plain reading of it
  by NumPy, pyarrow, SciPy or h5py finds: the same P, q and bounds;
- *forged*: one number, size or name is wrong in a way that shows: it must be refused.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import scipy.sparse as sp
from scipy.io import loadmat, savemat

from harness.exchange.apart import arrays_apart
from harness.exchange.foreign import Foreign
from harness.exchange.importing import read_problems
from tests.endurance.damage import SORTS, Random, damage
from tests.harness.exchange import foreign_files as ff

Parts = dict[str, Any]
Wrong = Callable[[Random, Parts], None]


class Accepted(Exception):
    """Something wrong was taken."""


class ImportTarget:
    """A file of one format.  A subclass says how it is written and plainly read."""

    error: type[Exception] = ValueError
    ending: str
    parts: Parts
    bounded = True

    def __init__(self, folder: Path) -> None:
        self.path = folder / f"foreign.{self.ending}"
        self.parts = self.make()
        self.write(self.parts)
        self.sound = self.path.read_bytes()
        self.sort = "damaged"
        self.read()  # what is compiled for it is no hang

    def make(self) -> Parts:
        """P, q, lb and ub."""
        parts = ff.quadratic()
        return {name: parts[name] for name in ("P", "q", "lb", "ub")}

    def write(self, parts: Parts) -> None:
        raise NotImplementedError

    def plain(self) -> Parts | None:
        """P, q, lb, ub of the file as it is now; None where it has become another problem."""
        raise NotImplementedError

    def change(self, number: int) -> tuple[str, str]:
        """Put change `number` in place: (its sort, what it is)."""
        rng = np.random.default_rng([5, number])
        self.sort = SORTS[number % 3]
        if self.sort == "forged":
            wrongs = {**WRONG, **(BOUNDS if self.bounded else CONTACTS)}
            what = str(rng.choice(list(wrongs)))
            parts = {name: np.array(value, copy=True) for name, value in self.parts.items()}
            wrongs[what](rng, parts)
            self.write(parts)
            return self.sort, what
        content = self.sound
        for _ in range(1 if self.sort == "damaged" else 3):
            what, content = damage(rng, content or b"\0")
        self.path.write_bytes(content)
        return self.sort, what

    def read(self) -> bool:
        """Read the file; whether it is taken for what it says."""
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            made = read_problems(self.path)
            if self.sort == "forged":
                raise Accepted(f"{self.path} was taken")
            said = self.plain()
            one = len(made) == 1
            return said is None or (one and _same(made[0][0][-1], said, self.bounded))


def _same(qp: Any, said: Parts, bounded: bool) -> bool:
    P, q = np.asarray(said["P"], float), np.asarray(said["q"], float).ravel()
    if P.shape != (qp.k, qp.k) or q.shape != (qp.k,):
        return False
    size = float(np.abs(P).max(initial=0.0))
    same = np.allclose(qp.dense_A.T @ qp.dense_A, 0.5 * (P + P.T), rtol=0, atol=1e-7 * size)
    same &= np.allclose(qp.A.T @ qp.d, q, rtol=0, atol=1e-7 * float(np.abs(q).max(initial=0.0)))
    if bounded:
        for mine, name, fill in ((qp.lower, "lb", -np.inf), (qp.upper, "ub", np.inf)):
            theirs = np.asarray(said.get(name, np.full(qp.k, fill)), float).ravel()
            theirs = np.where(np.abs(theirs) >= 1e20, np.copysign(np.inf, theirs), theirs)
            same &= np.array_equal(mine, theirs)
    return bool(same)


def _place(rng: Random, values: np.ndarray) -> tuple[int, ...]:
    return tuple(int(rng.integers(n)) for n in values.shape)


def _put(name: str, value: float) -> Wrong:
    def change(rng: Random, parts: Parts) -> None:
        parts[name] = parts[name].astype(float)
        parts[name][_place(rng, parts[name])] = value

    return change


def _asymmetric(rng: Random, parts: Parts) -> None:
    i, j = rng.choice(len(parts["P"]), 2, replace=False)
    parts["P"][i, j] += 10.0 ** rng.uniform(-6, 3) * np.abs(parts["P"]).max()


def _indefinite(rng: Random, parts: Parts) -> None:
    values = np.linalg.eigvalsh(parts["P"])
    parts["P"] -= (values[0] + 10.0 ** rng.uniform(-6, 0) * values[-1]) * np.eye(len(values))


def _turned(rng: Random, parts: Parts) -> None:
    parts["P"] *= -1.0


def _longer(rng: Random, parts: Parts) -> None:
    name = str(rng.choice([n for n in ("q", "lb", "ub", "mu") if n in parts]))
    parts[name] = np.append(parts[name], 1.0)


def _wider(rng: Random, parts: Parts) -> None:
    parts["P"] = np.hstack([parts["P"], parts["P"][:, :1]])


def _crossed(rng: Random, parts: Parts) -> None:
    i = int(rng.choice(np.flatnonzero(np.isfinite(parts["lb"]) & np.isfinite(parts["ub"]))))
    parts["lb"][i], parts["ub"][i] = parts["ub"][i], parts["lb"][i]


def _negative(rng: Random, parts: Parts) -> None:
    parts["mu"][int(rng.integers(parts["mu"].size))] *= -1.0


WRONG: dict[str, Wrong] = {
    "NaN in P": _put("P", np.nan),
    "infinity in P": _put("P", np.inf),
    "NaN in q": _put("q", np.nan),
    "infinity in q": _put("q", -np.inf),
    "asymmetric": _asymmetric,
    "indefinite": _indefinite,
    "negative": _turned,
    "longer": _longer,
    "wider": _wider,
}
BOUNDS: dict[str, Wrong] = {
    "NaN in lb": _put("lb", np.nan),
    "lb infinite": _put("lb", np.inf),
    "crossed": _crossed,
}
CONTACTS: dict[str, Wrong] = {"NaN in mu": _put("mu", np.nan), "negative mu": _negative}


class NpzTarget(ImportTarget):
    ending = "npz"

    def write(self, parts: Parts) -> None:
        np.savez(self.path, **parts)

    def plain(self) -> Parts:
        with np.load(self.path) as file:
            return dict(file)


class ParquetTarget(ImportTarget):
    ending = "parquet"

    def write(self, parts: Parts) -> None:
        pq.write_table(pa.table({n: pa.array([v.ravel()]) for n, v in parts.items()}), self.path)

    def plain(self) -> Parts:
        (row,) = pq.read_table(self.path).to_pylist()
        said = {name: np.array(value) for name, value in row.items() if value is not None}
        return {**said, "P": said["P"].reshape(-1, said["q"].size)}


class MatTarget(ImportTarget):
    ending = "mat"

    def write(self, parts: Parts) -> None:
        eye, n = sp.csc_matrix(np.eye(len(parts["lb"]))), parts["q"].size
        big = [np.where(np.isinf(v), np.sign(v) * 1e20, v) for v in (parts["lb"], parts["ub"])]
        if np.isposinf(parts["lb"]).any():
            big[0] = parts["lb"]
        said = {"P": sp.csc_matrix(parts["P"]), "q": parts["q"][:, None], "n": n, "A": eye,
                "l": big[0][:, None], "u": big[1][:, None]}  # fmt: skip
        savemat(self.path, said)

    def plain(self) -> Parts | None:
        try:
            with open(self.path, "rb") as file:  # which may be the end of whoever reads it
                said = arrays_apart(_dense_variables, file)
        except Foreign:
            return None  # SciPy has read it a moment ago, and now died of it
        P, A = said["P"], said["A"]
        low, high = (np.asarray(said[n], float).ravel() for n in ("l", "u"))
        scale = np.diag(A)
        if not np.array_equal(A, np.diag(scale)):
            return None  # rows have become others
        low = np.where(np.abs(low) >= 1e20, np.sign(low) * np.inf, low)
        high = np.where(np.abs(high) >= 1e20, np.sign(high) * np.inf, high)
        with np.errstate(divide="ignore", invalid="ignore"):
            ends = np.sort([low / scale, high / scale], axis=0)
        free = scale == 0
        return {"P": P, "q": said["q"], "lb": np.where(free, -np.inf, ends[0]),
                "ub": np.where(free, np.inf, ends[1])}  # fmt: skip


def _dense_variables(file: Any) -> Parts:
    found = loadmat(file, variable_names=("P", "q", "A", "l", "u"))
    return {name: value.toarray() if sp.issparse(value) else value
            for name, value in found.items() if not name.startswith("__")}  # fmt: skip


class FclibTarget(ImportTarget):
    ending = "hdf5"
    bounded = False

    def make(self) -> Parts:
        return dict(zip(("P", "q", "mu"), ff.delassus(), strict=True))

    def write(self, parts: Parts) -> None:
        ff.fclib_local(self.path, parts["P"], parts["q"], parts["mu"])

    def plain(self) -> Parts:
        with h5py.File(self.path) as file:
            local = file["fclib_local"]
            W = local["W"]
            m, n, nz = (int(W[name][0]) for name in ("m", "n", "nz"))
            x, i, p = (W[name][()] for name in ("x", "i", "p"))
            if nz >= 0:
                P = sp.coo_array((x[:nz], (i[:nz], p[:nz])), shape=(m, n))
            else:
                P = (sp.csc_array if nz == -1 else sp.csr_array)((x, i, p), shape=(m, n))
            return {"P": P.toarray(), "q": local["vectors/q"][()]}


class SiconosTarget(ImportTarget):
    ending = "dat"
    bounded = False

    def make(self) -> Parts:
        return dict(zip(("P", "q", "mu"), ff.delassus(), strict=True))

    def write(self, parts: Parts) -> None:
        self.path.write_text(ff.siconos_text(parts["P"], parts["q"], parts["mu"]))

    def plain(self) -> Parts:
        numbers = np.array(self.path.read_bytes().split(), float)
        n = int(numbers[3])
        W, q = numbers[7 : 7 + n * n], numbers[7 + n * n : 7 + n * n + n]
        return {"P": W.reshape(n, n, order="F"), "q": q}


class BlocksTarget(SiconosTarget):
    def write(self, parts: Parts) -> None:
        W, q, mu = parts["P"], parts["q"], parts["mu"]
        fits = W.shape == (q.size, q.size) and q.size % mu.size == 0
        text = ff.siconos_blocks(W, q, mu) if fits else ff.siconos_text(W, q, mu)
        self.path.write_text(text)

    def plain(self) -> Parts:
        words = self.path.read_bytes().split()
        n, c, stored = int(float(words[3])), int(float(words[1])), int(float(words[5]))
        at = 8 + 2 * c + 2
        starts = [int(float(w)) for w in words[at : at + c + 1]]
        columns = [int(float(w)) for w in words[at + c + 1 : at + c + 1 + stored]]
        at += c + 1 + stored
        size = n // c
        W = np.zeros((n, n))
        for i in range(c):
            for j in columns[starts[i] : starts[i + 1]]:
                block = np.array(words[at + 1 : at + 1 + size * size], float)
                W[size * i :, size * j :][:size, :size] = block.reshape(size, size, order="F")
                at += 1 + size * size
        return {"P": W, "q": np.array(words[at : at + n], float)}
