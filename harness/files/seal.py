"""The seal of a stored file, a sha256 of its bytes: looked at before any library sees one of them.

Whoever can write files can seal them, so a seal tells damage, not forgery.  It stands

    before the content       a block of `BLOCK` bytes, which every HDF5 library skips:
                                 glambda recording 3
                                 sha256 <64 digits>
                             The digits are of everything behind the block.
    or within it             in the last `TAIL` bytes, at the place that the format has for remarks:
                                 glambda sha256 <64 digits>
                             The digits are of the whole file, with zeros in their own place.

A file is read in pieces: to check it takes no memory, whatever its size.
"""

from __future__ import annotations

import hashlib
import io
import os
import re
from typing import BinaryIO, NamedTuple

BLOCK = 512
"""Length of a block before the content [bytes], the least that HDF5 allows."""
SEAL = b"glambda sha256 "
"""What a seal within the content begins with."""
DIGITS = 64
"""Hexadecimal digits of a seal."""
UNSEALED = b"0" * DIGITS
TAIL = 1 << 16
"""A seal within the content stands in so many bytes at the end of the file."""
PIECE = 1 << 20
"""Bytes that are read at a time."""
_BLOCK = re.compile(rb"glambda \w+ \d+\nsha256 ([0-9a-f]{64})\n+")


class _Place(NamedTuple):
    """at : where the digits stand;  start : from where on the bytes are sealed."""

    at: int
    start: int


def block(title: bytes) -> bytes:
    """A block before the content, to be sealed; title : such as b"glambda recording 3"."""
    return (title + b"\nsha256 " + UNSEALED + b"\n").ljust(BLOCK, b"\n")


def put_seal(file: BinaryIO) -> None:
    """Make the seal of an open file right, if there is a place for one."""
    place = _place_in(file)
    if place is not None:
        digits = _digits(file, place)
        file.seek(place.at)
        file.write(digits)


def sealed(content: bytes) -> bytes:
    """The content of a file with its seal made right, if there is a place for one."""
    file = io.BytesIO(content)
    put_seal(file)
    return file.getvalue()


def intact(file: BinaryIO) -> bool:
    """Whether an open file has a seal, and the right one.  Leaves the file at its beginning."""
    place = _place_in(file)
    if place is None:
        return False
    file.seek(place.at)
    kept = file.read(DIGITS)
    found = _digits(file, place)
    file.seek(0)
    return kept == found


def _place_in(file: BinaryIO) -> _Place | None:
    size = file.seek(0, os.SEEK_END)
    file.seek(0)
    head = file.read(BLOCK)
    before = _BLOCK.fullmatch(head)
    if before is not None and len(head) == BLOCK:
        return _Place(before.start(1), BLOCK)
    start = file.seek(max(0, size - TAIL))
    at = file.read(TAIL).rfind(SEAL)
    within = at >= 0 and start + at + len(SEAL) + DIGITS <= size
    return _Place(start + at + len(SEAL), 0) if within else None


def _digits(file: BinaryIO, place: _Place) -> bytes:
    """The seal that the file should have."""
    total, piece = hashlib.sha256(), bytearray(PIECE)
    at = file.seek(place.start)
    while length := file.readinto(piece):  # type: ignore[attr-defined]
        first, last = max(at, place.at), min(at + length, place.at + DIGITS)
        if first < last:
            piece[first - at : last - at] = UNSEALED[: last - first]
        total.update(memoryview(piece)[:length])
        at += length
    return total.hexdigest().encode()
