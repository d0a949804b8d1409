"""A process of its own: nothing of it is left, whoever ends first, and it says why it ended."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from contextlib import suppress

import psutil
import pytest

from harness.processes import process as process_module
from harness.processes.process import Process
from tests.fakes.families import LEFT

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="orphans are found on Linux")

SOME = 50_000_000
PROGRAM = """
import json, time
from harness.processes.process import Process
process = Process("tests.fakes.families:forks", {"dies": False})
process.link.settimeout(60)
print(*json.loads(process.link.recv(1000)), flush=True)
time.sleep(1000)
"""


def living(numbers: list[int]) -> list[int]:
    found = []
    for number in numbers:
        with suppress(psutil.NoSuchProcess):  # it may end between two looks
            found += [number] * (psutil.Process(number).status() != psutil.STATUS_ZOMBIE)
    return found


def wait_for_the_end_of(numbers: list[int]) -> None:
    end = time.monotonic() + 20.0
    while living(numbers) and time.monotonic() < end:
        time.sleep(0.02)
    assert not living(numbers)


def started(dies: bool) -> tuple[Process, list[int]]:
    process = Process("tests.fakes.families:forks", {"dies": dies})
    process.link.settimeout(60)
    return process, json.loads(process.link.recv(1000))


def test_what_is_killed_ends_with_all_that_it_has_forked() -> None:
    process, numbers = started(dies=False)
    assert living(numbers) == numbers and len(numbers) == 1 + LEFT
    assert os.getsid(numbers[0]) != os.getsid(0)
    assert "last words" in process.words.last()
    process.kill()
    wait_for_the_end_of(numbers)
    assert not process.folder.exists()


def test_what_dies_says_why_and_leaves_nothing_behind() -> None:
    process, numbers = started(dies=True)
    assert process.cause_of_death() == (3, "left with exit code 3: last words")
    wait_for_the_end_of(numbers)
    process.kill()


def test_one_that_seems_to_end_is_killed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(process_module, "GRACE", 0.2)
    process = Process("tests.fakes.families:says_no_more", {})
    assert process.cause_of_death()[1] == "closed the link to its parent"
    process.kill()


def test_memory_of_the_whole_family_is_seen() -> None:
    process = Process("tests.fakes.families:take_memory", {"children": 4, "bytes": SOME})
    process.link.settimeout(60)
    assert process.link.recv(4) == b"done"
    assert 4 * SOME < process.memory() < 8 * SOME
    process.kill()


def test_a_process_ends_with_who_has_started_it() -> None:
    with subprocess.Popen([sys.executable, "-c", PROGRAM], stdout=subprocess.PIPE, text=True) as p:
        assert p.stdout is not None
        numbers = [int(number) for number in p.stdout.readline().split()]
        p.kill()
    wait_for_the_end_of(numbers)
