"""What strangers' files may do to a reader: nothing.  Seals, kinds of files, sizes, JSON."""

from __future__ import annotations

import io
import os
import tracemalloc
from pathlib import Path

import numpy as np
import pytest

from harness.files.json_file import read_json, sealed_json
from harness.files.plain_files import Unreadable, open_plain
from harness.files.seal import BLOCK, DIGITS, PIECE, SEAL, TAIL, UNSEALED, block, intact, sealed

PLACES = {
    "before": block(b"glambda thing 1") + b"content" * 1000,
    "within": b"content" * 1000 + SEAL + UNSEALED + b"the end",
    "alone": SEAL + UNSEALED,
    "across pieces": b"x" * (PIECE - 30) + SEAL + UNSEALED + b"y" * 100,
    "far from the end": b"x" * 99 + SEAL + UNSEALED + b"y" * (TAIL - len(SEAL) - DIGITS),
}


@pytest.mark.parametrize("place", PLACES)
def test_every_changed_byte_breaks_the_seal(place: str) -> None:
    content = sealed(PLACES[place])
    assert intact(io.BytesIO(content)) and sealed(content) == content
    assert len(content) == len(PLACES[place]) and content != PLACES[place]
    rng = np.random.default_rng(0)
    for at in (0, BLOCK // 2, len(content) - 1, *rng.integers(len(content), size=60)):
        changed = bytearray(content)
        changed[min(at, len(content) - 1)] ^= 1
        assert not intact(io.BytesIO(changed)), at
    assert not intact(io.BytesIO(content + b"x")) and not intact(io.BytesIO(content[1:]))
    assert not intact(io.BytesIO(content[:-1]))


def test_what_has_no_place_for_a_seal_stays_as_it_is() -> None:
    for content in (b"", b"x", SEAL, SEAL + UNSEALED[:-1], block(b"glambda thing 1")[:-1]):
        assert sealed(content) == content and not intact(io.BytesIO(content))
    beyond = SEAL + UNSEALED + b"y" * TAIL
    assert sealed(beyond) == beyond


def test_a_file_of_any_size_is_checked_in_little_memory(tmp_path: Path) -> None:
    path = tmp_path / "sparse"
    with open(path, "wb") as file:
        file.write(block(b"glambda thing 1"))
        file.truncate(100 * PIECE)
    tracemalloc.start()
    try:
        with open_plain(path, 200 * PIECE) as file:
            assert not intact(file)
        assert tracemalloc.get_traced_memory()[1] < 4 * PIECE
    finally:
        tracemalloc.stop()


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no named pipes here")
def test_only_plain_files_of_bounded_size_are_read(tmp_path: Path) -> None:
    pipe, link, large = tmp_path / "pipe", tmp_path / "link", tmp_path / "large"
    os.mkfifo(pipe)
    link.symlink_to("/dev/zero")
    large.write_bytes(b"12345")
    for path, words in ((pipe, "no file"), (link, "no file"), (tmp_path, "no file"), (large, "5")):
        with pytest.raises(Unreadable, match=words):
            open_plain(path, 4)
    with pytest.raises(FileNotFoundError):
        open_plain(tmp_path / "absent", 4)
    with open_plain(large, 5) as file:
        assert file.read() == b"12345"


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"", "is no JSON"),
        (b"[" * 1_000_000, "nested too deep"),
        (b'{"a":' * 1_000_000, "nested too deep"),
        (b"[1]", "no JSON object"),
        (b"\xff\xfe", "is no JSON"),
        (b'{"a": ' + b"9" * 10_000 + b"}", "is no JSON"),
        (b" " * 10_000_001, "more than 10,000,000"),
    ],
)
def test_what_is_no_json_document_is_told(tmp_path: Path, content: bytes, words: str) -> None:
    path = tmp_path / "x.json"
    path.write_bytes(content)
    with pytest.raises(Unreadable, match=words) as told:
        read_json(path)
    assert "\n" not in str(told.value) and len(str(told.value)) < 200


def test_a_sealed_document_is_read_back_and_none_else(tmp_path: Path) -> None:
    path, values = tmp_path / "x.json", {"seconds": 1.25, "name": "µ", "list": [1, None]}
    path.write_bytes(sealed_json(values))
    assert read_json(path, must_be_sealed=True) == values
    path.write_bytes(path.read_bytes().replace(b"1.25", b"1.35"))
    with pytest.raises(Unreadable, match="damaged or altered"):
        read_json(path, must_be_sealed=True)
