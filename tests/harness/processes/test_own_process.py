"""A process of its own: nothing of it is left, whoever ends first, and it says why it ended."""

from __future__ import annotations

import multiprocessing as mp
import os
import subprocess
import sys
import time
from pathlib import Path

import psutil
import pytest

from harness.processes.own_process import OwnProcess
from tests.fakes.families import LEFT, forks

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="orphans are found on Linux")

PROGRAM = """
import multiprocessing as mp, sys, time
from pathlib import Path
from harness.processes.own_process import OwnProcess
from tests.fakes.families import forks
ours, theirs = mp.Pipe()
process = OwnProcess(Path(sys.argv[1]), forks, theirs, False)
print(*ours.recv(), flush=True)
time.sleep(1000)
"""


def living(numbers: list[int]) -> list[int]:
    found = []
    for number in numbers:
        if psutil.pid_exists(number):
            process = psutil.Process(number)
            found += [number] * (process.status() != psutil.STATUS_ZOMBIE)
    return found


def wait_for_the_end_of(numbers: list[int]) -> None:
    end = time.monotonic() + 20.0
    while living(numbers) and time.monotonic() < end:
        time.sleep(0.02)
    assert not living(numbers)


def started(words: Path, dies: bool) -> tuple[OwnProcess, list[int]]:
    ours, theirs = mp.Pipe()
    process = OwnProcess(words, forks, theirs, dies)
    assert ours.poll(60)
    return process, ours.recv()


def test_what_is_killed_ends_with_all_that_it_has_forked(tmp_path: Path) -> None:
    process, numbers = started(tmp_path / "words", dies=False)
    assert living(numbers) == numbers and len(numbers) == 1 + LEFT
    assert os.getsid(numbers[0]) != os.getsid(0)
    process.kill()
    assert not process.is_alive
    wait_for_the_end_of(numbers)
    assert process.cause_of_death() == "SIGKILL: last words"


def test_what_dies_says_why_and_leaves_nothing_behind(tmp_path: Path) -> None:
    process, numbers = started(tmp_path / "words", dies=True)
    assert process.cause_of_death() == "left with exit code 3: last words"
    wait_for_the_end_of(numbers)


def test_a_process_ends_with_who_has_started_it(tmp_path: Path) -> None:
    command = [sys.executable, "-c", PROGRAM, str(tmp_path / "words")]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as program:
        assert program.stdout is not None
        numbers = [int(number) for number in program.stdout.readline().split()]
        program.kill()
    wait_for_the_end_of(numbers)
