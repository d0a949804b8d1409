"""Studies that are killed or interrupted, again and again: do they go on and end the same?

    python -m tests.endurance.kill          after every store operation, at 220 random moments
    python -m tests.endurance.kill --random 5 --isolated 1 --operations 10    a few of each

1. A tiny study, a scene of few QPs through a few solvers, is done without interruption.
2. The same is begun in an empty folder and killed: after its n-th operation on a file (open, write,
   fsync, rename, and in the middle of a write), for every n; and at moments drawn from a seed,
   where each solver is in the same process; and where each is in one of its own, up to three times
   while it goes on, by SIGKILL, SIGINT, SIGTERM or SIGHUP.
3. What is there is read, which must not fail, and the study is run again to its end.
4. Every table must equal that of the study without interruption, but for times; so must the
   recording and study.json, byte for byte; no other file may be left, and no process.

Operations are counted from outside: the modules that touch files are handed an `os` and an `open`
that count.  Exit code 1 if a table differs, a file cannot be read, or the study does not go on.
"""

from __future__ import annotations

import argparse
import gc
import hashlib
import os
import signal
import sys
import tempfile
import time
import uuid
from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from glambda.cli.streams import heed_interrupts
from harness.files import whole_files
from harness.results.shard_file import FROM_PASSES
from harness.results.store import Store, read_repeats, read_results
from harness.study.replay import replay
from harness.study.study import record_into

SCENE, UNTIL = "tower,bodies=3", 0.05
SOLVERS = ("glambda", "daqp", "quadprog")
REPEATS = 2
MAY_DIFFER_IN_ROWS = ("executor", *FROM_PASSES)
OF_A_PASS = ("problem", "solver", "settings", "arm", "repeat")
SIGNALS = (signal.SIGKILL, signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
WORD = "GLAMBDA_ENDURANCE"
"""Variable by which the processes of a study are found."""
MAY_DIFFER = {"spent.json", ".lock"}
"""Files that hold seconds or process numbers."""
PATIENCE = 120.0
"""Seconds after which a study counts as hanging."""
GRACE = 20.0
"""Seconds in which what it has started must end."""


def study(folder: Path, isolate: bool) -> None:
    """A study as `harness.study.study` does it, but tiny."""
    store = Store(folder)
    store.write_study({"scene": SCENE, "until": UNTIL})
    recording = record_into(folder / "recordings", SCENE, until=UNTIL)
    replay(recording, SOLVERS, ("high",), results=folder, repeats=REPEATS, isolate=isolate)


class Countdown:
    """Counts operations on files, and kills this process after (or amid) the one asked for."""

    def __init__(self, last: int, report: Path | None = None) -> None:
        self.left, self.report = last, report

    def over(self, name: str, half: Callable[[], Any] | None = None) -> None:
        """An operation is done; `half` does half of one that could be cut."""
        if self.report is not None:
            with open(self.report, "a") as file:
                file.write(name + "\n")
        self.left -= 1
        if self.left == 0:
            if half is not None:
                half()
            os.kill(os.getpid(), signal.SIGKILL)


class CountedOs:
    """`os`, whose operations on files are counted."""

    COUNTED = ("open", "write", "fsync", "replace", "ftruncate")

    def __init__(self, count: Countdown) -> None:
        self.count = count

    def __getattr__(self, name: str) -> Any:
        function = getattr(os, name)
        if name not in self.COUNTED:
            return function

        def counted(*arguments: Any) -> Any:
            result = function(*arguments)
            self.count.over(name)
            return result

        return counted


def counted_open(count: Countdown) -> Callable[..., Any]:
    """`open` for whole files: opening, half a write and a write are counted."""

    def opened(path: Path, mode: str) -> Any:
        file = open(path, mode, buffering=0)  # noqa: SIM115
        write = file.write
        count.over("open")

        class Counted:
            def __enter__(self) -> Counted:
                return self

            def __exit__(self, *error: object) -> None:
                file.close()

            def __getattr__(self, name: str) -> Any:
                return getattr(file, name)

            def write(self, content: bytes) -> None:
                count.over("half a write", lambda: write(content[: len(content) // 2]))
                write(content)
                count.over("write")

        return Counted()

    return opened


def begin(folder: Path, isolate: bool, count: Countdown | None = None) -> int:
    """Run the study in a process of its own; its number."""
    child = os.fork()
    if child:
        return child
    os.setpgid(0, 0)
    signal.signal(signal.SIGINT, signal.default_int_handler)
    heed_interrupts()
    code = 1
    try:
        if count is not None:
            counted: Any = CountedOs(count)
            whole_files.os = counted  # type: ignore[attr-defined]
            whole_files.open = counted_open(count)  # type: ignore[attr-defined]
        study(folder, isolate)
        code = 0
    except BaseException as error:
        print(f"{type(error).__name__}: {error}", file=sys.stderr)
    finally:
        os._exit(code)


def ended(child: int, seconds: float = PATIENCE) -> int | None:
    """Its exit code (negative: the signal) within so many seconds, or None."""
    until = time.monotonic() + seconds
    while time.monotonic() < until:
        done, status = os.waitpid(child, os.WNOHANG)
        if done:
            return os.waitstatus_to_exitcode(status)
        time.sleep(min(0.002, seconds / 10))
    return None


def kill(child: int, by: int = signal.SIGKILL) -> None:
    """Kill this process, not its group: what it started must look after itself."""
    os.kill(child, by)
    os.waitpid(child, 0)


def left_behind(word: str) -> int:
    """Processes of a study that live on after it, and after some patience."""
    until = time.monotonic() + GRACE
    while (count := sum(_has(path, word) for path in Path("/proc").glob("[0-9]*/environ"))) and (
        time.monotonic() < until
    ):
        time.sleep(0.1)
    return count


def _has(path: Path, word: str) -> bool:
    try:
        return f"{WORD}={word}".encode() in path.read_bytes()
    except OSError:
        return False


def content(folder: Path) -> dict[str, Any]:
    """All that must not differ: tables without times, and sums of the other files."""
    repeats = read_repeats(folder)
    found: dict[str, Any] = {
        "results": read_results(folder).drop(columns=list(MAY_DIFFER_IN_ROWS)),
        "repeats": repeats.loc[repeats["repeat"] < REPEATS, list(OF_A_PASS)],
    }
    for path in sorted(folder.rglob("*")):
        name = str(path.relative_to(folder))
        if path.suffix == ".parquet":
            found[name] = "a shard"
        elif path.is_file() and path.name not in MAY_DIFFER:
            found[name] = hashlib.sha256(path.read_bytes()).hexdigest()
    return found


def difference(found: dict[str, Any], expected: dict[str, Any]) -> str:
    """What differs, or nothing."""
    if found.keys() != expected.keys():
        return f"files: {sorted(found.keys() ^ expected.keys())}"
    for name, value in expected.items():
        if isinstance(value, pd.DataFrame):
            words = first_difference(found[name], value)
            if words:
                return f"{name}: {words}"
        elif value != found[name]:
            return name
    return ""


def first_difference(found: pd.DataFrame, expected: pd.DataFrame) -> str:
    """The first entry in which two tables differ, or nothing."""
    if found.shape != expected.shape:
        return f"has shape {found.shape} instead of {expected.shape}"
    for name in expected:
        pairs = zip(found[name], expected[name], strict=True)
        for row, (value, before) in enumerate(pairs):
            if value is not before and value != before and not (pd.isna(value) and pd.isna(before)):
                return f"row {row}, {name}: {value!r} instead of {before!r}"
    return ""


def interrupted(
    expected: dict[str, Any],
    isolate: bool,
    last: int = 0,
    moments: Sequence[tuple[float, int]] = (),
) -> str:
    """Kill a study after operation `last`, or at each of the moments [s] by a signal; then end it.

    Returns what went wrong, or nothing.
    """
    word = os.environ[WORD] = uuid.uuid4().hex
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name) / "results"
        folder.mkdir()
        if last:
            code = ended(begin(folder, isolate, Countdown(last)))
            if code != -signal.SIGKILL:
                return f"was not killed, but ended with {code}"
        for moment, by in moments:
            child = begin(folder, isolate)
            if ended(child, moment) is None:
                kill(child, by)
        try:
            read_results(folder)
            read_repeats(folder)
        except ValueError as error:
            return f"half written: {error}"
        child = begin(folder, isolate)
        code = ended(child)
        if code is None:
            kill(child)
        if code != 0:
            return f"did not go on: exit code {code}"
        if left := left_behind(word):
            return f"left {left} processes behind"
        return difference(content(folder), expected)


def operations() -> list[str]:
    """What a study without interruption does to files, in order."""
    with tempfile.TemporaryDirectory() as name:
        folder, report = Path(name) / "results", Path(name) / "operations"
        folder.mkdir()
        if ended(begin(folder, False, Countdown(-1, report))) != 0:
            raise RuntimeError("the study did not end; its own words are above")
        return report.read_text().split("\n")[:-1]


def uninterrupted(isolate: bool) -> tuple[dict[str, Any], float]:
    """What a study without interruption leaves behind, and how long it takes [s]."""
    with tempfile.TemporaryDirectory() as name:
        began = time.monotonic()
        if ended(begin(Path(name), isolate)) != 0:
            raise RuntimeError("the study did not end; its own words are above")
        return content(Path(name)), time.monotonic() - began


def main(arguments: Sequence[str] | None = None) -> int:
    """Print how many studies were killed where, and what came of them; 1 if one went wrong."""
    parser = argparse.ArgumentParser(description="Kill and interrupt studies.")
    parser.add_argument("--operations", type=int, help="so many of them; default: after each")
    parser.add_argument("--random", type=int, default=200, help="random moments, in one process")
    parser.add_argument("--isolated", type=int, default=20, help="the same, solvers in their own")
    parser.add_argument("--seed", type=int, default=0)
    chosen = parser.parse_args(arguments)
    rng = np.random.default_rng(chosen.seed)
    with tempfile.TemporaryDirectory() as folder:
        study(Path(folder), isolate=False)  # imports and compiles; the forks inherit it
    gc.freeze()  # they need not look through it for garbage
    expected, seconds = uninterrupted(isolate=False)
    names = operations()
    wanted = range(1, len(names) + 1)
    if chosen.operations is not None:
        some = min(chosen.operations, len(names))
        wanted = sorted(1 + rng.choice(len(names), some, replace=False))
    tried: Counter[str] = Counter()
    wrong: Counter[str] = Counter()

    def tell(what: str, words: str) -> None:
        tried[what] += 1
        if words:
            wrong[what] += 1
            print(f"FAILED: killed at {what}: {words}", flush=True)
        if sum(tried.values()) % 25 == 0:
            print(f"{sum(tried.values())} killed, {wrong.total()} went wrong", flush=True)

    for last in wanted:
        tell(f"{names[last - 1]}", interrupted(expected, False, last=int(last)))
    for _ in range(chosen.random):
        moments = [(t, signal.SIGKILL) for t in rng.uniform(0, seconds, rng.integers(1, 3))]
        tell("a random moment", interrupted(expected, False, moments=moments))
    if chosen.isolated:
        same, seconds = uninterrupted(isolate=True)
        words = difference(same, expected)
        if words:
            tell("no moment, solvers apart", words)
        for _ in range(chosen.isolated):
            moments = [
                (t, SIGNALS[rng.integers(len(SIGNALS))])
                for t in rng.uniform(0, seconds, rng.integers(1, 4))
            ]
            tell("a random moment, solvers apart", interrupted(expected, True, moments=moments))
    rows = [(what, count, count - wrong[what]) for what, count in tried.items()]
    rows.append(("all", tried.total(), tried.total() - wrong.total()))
    table = pd.DataFrame(rows, columns=["killed at or after", "times", "went on to the same end"])
    print(table.to_markdown(index=False))
    return int(wrong.total() > 0)


if __name__ == "__main__":
    sys.exit(main())
