"""What an accident does to bytes, drawn from a seed (`tests/endurance/fuzz.py`)."""

from __future__ import annotations

import numpy as np

Random = np.random.Generator
SORTS = ("damaged", "forged", "hostile")
"""What is done to a file, see `tests/endurance/fuzz.py`; file i is of sort i modulo 3."""


def damage(rng: Random, content: bytes) -> tuple[str, bytes]:
    """What an accident does to bytes: (what, the changed bytes)."""
    n = len(content)
    changed = bytearray(content)
    start = [0, 0, max(0, n - 4096)][rng.integers(3)]  # mostly where formats keep their structure
    width = [n, 4096, 4096][rng.integers(3)]
    at = int(rng.integers(start, min(n, start + width)))
    length = int(2 ** rng.uniform(0, 10))
    kind = rng.choice(["cut", "flip", "set", "ones", "zeros", "noise", "drop", "copy", "append"])
    if kind == "cut":
        changed = changed[: int(rng.integers(n))]
    elif kind == "flip":
        for where in (at, *rng.integers(n, size=rng.integers(8))):
            changed[where] ^= 1 << int(rng.integers(8))
    elif kind == "set":
        changed[at] = int(rng.integers(256))
    elif kind in ("ones", "zeros"):
        length = min(8, length)
        changed[at : at + length] = (b"\xff" if kind == "ones" else b"\0") * length
    elif kind == "noise":
        changed[at : at + length] = rng.bytes(length)
    elif kind == "drop":
        del changed[at : at + length]
    elif kind == "copy":
        changed[at:at] = changed[at : at + length]
    else:
        changed += rng.bytes(length)
    return str(kind), bytes(changed)
