"""What a command prints: obeyed by no terminal, and not needed by anybody."""

from __future__ import annotations

import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from rich.table import Table
from rich.text import Text
from typer.testing import CliRunner

from glambda.cli import app
from glambda.terminal import Terminal
from harness.files.printable import printable
from harness.machine.unrest import Unrest
from harness.recordings.recording import write_recording
from harness.results.shard_file import Shard
from harness.results.store import Store
from problems.stepping.run import Event
from tests.fakes.fake_recordings import fake_recording
from tests.harness.results.test_store import KEY, TIMES, shard

ROOT = Path(__file__).parents[2]
STRANGE = "\x1b]0;title\x07\x1b[31mred\x1b[2J\r\x9b1m\u202eabc\u2028"
OBEYED = ("\x1b", "\x07", "\r", "\x9b", "\u202e", "\u2028")


def test_only_what_can_be_seen_is_left_of_a_text() -> None:
    assert printable("Gλ ‖x‖ 3 µs, 1,2\n\t[b]") == "Gλ ‖x‖ 3 µs, 1,2\n\t[b]"
    shown = printable(STRANGE)
    assert shown.isprintable() and "\\x1b[31mred" in shown and "\\u202e" in shown
    assert not any(letter in printable("".join(map(chr, range(0x3000)))) for letter in OBEYED)


def test_a_terminal_obeys_nothing_that_it_is_told(capsys: pytest.CaptureFixture[str]) -> None:
    made = Table(title=STRANGE)
    made.add_column(STRANGE)
    made.add_row(Text(STRANGE))
    console = Terminal()
    for each in (made, STRANGE, Text(STRANGE), "lotstedt[exact_qr] :smile: [/b]"):
        console.print(each, soft_wrap=True)
    told = capsys.readouterr().out
    assert not any(letter in told for letter in OBEYED)
    assert "lotstedt[exact_qr] :smile: [/b]" in told


@pytest.mark.parametrize("solver", ["highs", "cvxpy[highs]"])
def test_what_a_package_prints_does_not_reach_stdout(solver: str) -> None:
    """HiGHS greets every process that uses it, whoever brings it along."""
    main = "import sys; from glambda.cli import main; sys.argv[0] = 'glambda'; main()"
    command = [sys.executable, "-c", main, "simulate", "fig3", "--solver", solver]
    done = subprocess.run([*command, "--until", "0.01"], cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("fig3: t = 0.01 s") and "HiGHS" not in done.stdout


def test_highs_greets_nobody_in_python() -> None:
    code = "from solvers import make_solver; make_solver('highs')"
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True
    )
    assert done.stdout == ""


def strange_recording() -> Any:
    made = fake_recording()
    return replace(
        made,
        code_version=STRANGE,
        parameters={**made.parameters, "a": STRANGE, STRANGE: 1},
        events=tuple(Event(e.t, STRANGE, STRANGE) for e in made.events),
        solutions=tuple(replace(s, status_text=STRANGE) for s in made.solutions),
        counts={**made.counts, STRANGE: 1},
    )


def test_info_of_a_strangers_files_is_printable(tmp_path: Path) -> None:
    file = tmp_path / "fake.h5"
    write_recording(file, strange_recording())
    rows = [{**row, "kind": "step", "status_text": STRANGE} for row in shard().rows]
    Store(tmp_path / "study").save(Shard(KEY, rows, TIMES, [Unrest()] * 3, STRANGE))
    absent = tmp_path / f"{STRANGE}.h5"
    for path, code in ((file, 0), (tmp_path / "study", 0), (absent, 2)):
        told = CliRunner().invoke(app, ["info", str(path)])
        assert told.exit_code == code
        assert not any(letter in told.output for letter in OBEYED)


MUCH = """
import pathlib, sys
from glambda.cli.streams import guard_streams
guard_streams()
for _ in range(100_000):
    print("a line that nobody reads")
sys.stderr.write("and another")
pathlib.Path(sys.argv[1]).write_text("written")
"""


def unread(*command: object) -> int:
    """The exit code of a command whose words nobody reads."""
    ours, theirs = os.pipe()
    os.close(ours)
    try:
        ended = subprocess.run(
            [str(each) for each in command], cwd=ROOT, stdout=theirs, stderr=theirs, timeout=120
        )
    finally:
        os.close(theirs)
    return ended.returncode


def test_a_reader_that_leaves_costs_no_file(tmp_path: Path) -> None:
    assert unread(sys.executable, "-c", MUCH, tmp_path / "file") == 0
    assert (tmp_path / "file").read_text() == "written"


def test_simulate_writes_its_files_when_nobody_reads_its_words(tmp_path: Path) -> None:
    main = "from glambda.cli import main; main()"
    command = ("simulate", "fig3", "--until", 0.01, "--trajectory", tmp_path / "f.csv")
    assert unread(sys.executable, "-c", main, *command) == 0
    assert (tmp_path / "f.csv").stat().st_size and (tmp_path / "f.events.csv").exists()


IN_A_CALLBACK = """
import os, signal, time, weakref
from glambda.cli.streams import heed_interrupts
heed_interrupts()
signal.signal(signal.SIGINT, signal.default_int_handler)

class Thing:
    pass

thing = Thing()
seen = weakref.ref(thing, lambda _: os.kill(os.getpid(), signal.SIGINT))
try:
    del thing
    time.sleep(60)
except KeyboardInterrupt:
    print("heeded")
"""


def test_an_interrupt_in_a_callback_is_not_lost() -> None:
    run = subprocess.run(
        [sys.executable, "-c", IN_A_CALLBACK], capture_output=True, text=True, timeout=50
    )
    assert run.stdout == "heeded\n", run.stderr
