"""Damaged and forged files are refused in one line or read (`tests/endurance/fuzz.py`)."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.endurance import fuzz
from tests.endurance.damage import SORTS

FILES = 80


@pytest.mark.parametrize("sort", ["damaged", "forged"])
@pytest.mark.parametrize("kind", sorted(fuzz.KINDS))
@pytest.mark.filterwarnings("ignore::numpy.exceptions.ComplexWarning")
def test_changed_files_are_refused_or_read(kind: str, sort: str, tmp_path: Path) -> None:
    target = fuzz.target_of(kind, tmp_path)
    assert target.read()
    refused = 0
    for number in range(SORTS.index(sort), FILES, len(SORTS)):
        about = target.change(number)
        assert about[0] == sort
        try:
            same = target.read()
        except target.error as error:
            assert "\n" not in str(error) and str(target.path) in str(error), about
            assert len(str(error)) < 1000, about
            refused += 1
        else:
            assert same or sort == "forged", about
    unsealed = fuzz.KINDS[kind][0].endswith("imports")  # a changed digit may be as good
    assert refused > FILES // len(SORTS) // (4 if unsealed else 2)


def test_a_reader_that_dies_is_counted_and_the_rest_is_read(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    dying = tmp_path / "reader.py"
    dying.write_text(
        "import json, os, sys\n"
        "print(json.dumps('ready'))\n"
        "for number in range(int(sys.argv[3]), int(sys.argv[4])):\n"
        "    print(json.dumps([number, 'damaged', 'cut', 'begun']), flush=True)\n"
        "    if number == 1: os.abort()\n"
        "    print(json.dumps([number, 'damaged', 'cut', 'refused']), flush=True)\n"
    )
    monkeypatch.setattr(fuzz, "__file__", str(dying))
    found = list(fuzz.outcomes("shard", 0, 3))
    assert [outcome for *_, outcome in found] == ["refused", "crash", "refused"]
    assert found[1] == (1, "damaged", "cut: exit code -6", "crash")
