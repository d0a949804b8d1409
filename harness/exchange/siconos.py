"""Friction contact problems of Siconos as text (.dat): W dense or in sparse blocks.  Reading only.

    dimension, contacts, storage, then by storage
      0   order twice, twice again, and the entries by columns
      1   order twice; numbers of blocks, of block rows and of block columns; where block rows end,
          where block columns end; counts and the two index arrays of a block CSR matrix; and each
          block with its number, by columns
    then q, then mu of each contact, then in newer files a flag, all separated by white space.

W and q are by contact, the normal first.
"""

from __future__ import annotations

from typing import BinaryIO

import numpy as np

from harness.exchange.coulomb import Contacts
from harness.exchange.factors import DENSE_LIMIT
from harness.exchange.foreign import Foreign, matrix, vector
from problems.qp import Vector

SUFFIXES = (".dat",)
DENSE, BLOCKS = 0, 1


def read(file: BinaryIO) -> list[Contacts]:
    """The problem of an open file.  Raises Foreign, saying where it stopped."""
    try:
        take = _Numbers(np.array(file.read().split(), dtype=np.float64))
    except (ValueError, OverflowError) as error:
        raise Foreign(f"file: holds something else than numbers ({str(error)[:80]})") from None
    dim, contacts, storage = (take.count(name) for name in ("dimension", "contacts", "storage"))
    rows, columns = take.count("order"), take.count("order")
    if not rows == columns == dim * contacts:
        raise Foreign(f"W: is {rows} × {columns}, and {contacts} contacts in {dim} dimensions need "
                      f"{dim * contacts}")  # fmt: skip
    if rows > 2 * DENSE_LIMIT:
        raise Foreign(f"W: has order {rows}, more than {2 * DENSE_LIMIT}")
    if storage == DENSE:
        if (take.count("order"), take.count("order")) != (rows, rows):
            raise Foreign(f"W: has not the order {rows} that it claims")
        W = take("W", rows * rows).reshape(rows, rows, order="F")
    elif storage == BLOCKS:
        W = _blocks(take, rows)
    else:
        raise Foreign(f"storage: is {storage}; read are {DENSE} (dense) and {BLOCKS} (blocks)")
    q, mu = take("q", rows), take("mu", contacts)
    take.end()
    return [Contacts(matrix("W", W), vector("q", q), vector("mu", mu), dim)]


class _Numbers:
    """Takes the next numbers of the file."""

    def __init__(self, values: Vector) -> None:
        self.values, self.at = values, 0

    def __call__(self, name: str, size: int) -> Vector:
        part = self.values[self.at : self.at + size]
        if part.size < size:
            raise Foreign(f"{name}: needs {size} numbers, and {part.size} are left in the file")
        self.at += size
        return part

    def counts(self, name: str, size: int) -> np.ndarray:
        """Whole numbers from 0 on."""
        part = self(name, size)
        if not ((part >= 0) & (part == np.floor(part)) & (part < 2**31)).all():
            raise Foreign(f"{name}: holds something else than whole numbers from 0 on")
        return part.astype(np.int64)

    def count(self, name: str) -> int:
        return int(self.counts(name, 1)[0])

    def end(self) -> None:
        """A flag may follow, and nothing else."""
        rest = self.values[self.at :].tolist()
        if rest not in ([], [0.0], [1.0]):
            raise Foreign(f"file: has {len(rest)} numbers after its end")


def _blocks(take: _Numbers, order: int) -> Vector:
    stored, block_rows, block_columns = (
        take.count(f"number of {what}") for what in ("blocks", "block rows", "block columns")
    )
    ends = [np.r_[0, take.counts("ends of blocks", n)] for n in (block_rows, block_columns)]
    if any((np.diff(end) <= 0).any() or end[-1] != order for end in ends):
        raise Foreign(f"ends of blocks: do not rise to {order}")
    rows_filled, filled = take.count("block index"), take.count("block index")
    starts, columns = take.counts("block index", rows_filled), take.counts("block index", filled)
    sound = filled == stored and rows_filled == block_rows + 1 and (np.diff(starts) >= 0).all()
    if not sound or starts[0] != 0 or starts[-1] != filled or (columns >= block_columns).any():
        raise Foreign("block index: is that of no block matrix")
    W, seen = np.zeros((order, order)), set()
    for row in range(block_rows):
        for block in range(starts[row], starts[row + 1]):
            if take.count("number of a block") != block:
                raise Foreign(f"block {block}: is not where it should be")
            place = (row, int(columns[block]))
            if place in seen:
                raise Foreign(f"block {block}: stands where another does")
            seen.add(place)
            (top, bottom), (left, right) = (
                end[i : i + 2].tolist() for end, i in zip(ends, place, strict=True)
            )
            size = (bottom - top, right - left)
            W[top:bottom, left:right] = take("W", size[0] * size[1]).reshape(size, order="F")
    return W
