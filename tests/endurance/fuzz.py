"""Recordings and results from strangers: thousands of damaged and forged files, read in turn.

    python -m tests.endurance.fuzz                      3,000 of each kind, some minutes
    python -m tests.endurance.fuzz --files 200          fewer
    python -m tests.endurance.fuzz --kind shard --from 1234 --files 1      one of them again

1. Small recordings, a shard of results and a closed loop are made.
2. File number i is a change of it that is drawn from the seed i:
   - *damaged*: cut short, bits or bytes changed, a stretch overwritten, copied or left out;
   - *forged*: well-formed, with a wrong type, shape, size, link, filter, text or value, and with a
     digest and a seal that are right;
   - *hostile*: damaged, and then sealed, so that the library behind the seal gets to see it.
3. A process of its own reads one after the other.  It is watched from outside: where it dies or
   says nothing for `PATIENCE` seconds, that is counted and another goes on with the next file.

A damaged file must be refused, or be read as what it was.  A forged or hostile one must be refused,
or read: who can seal can write sound files, too.  Foreign files to be imported have no seal; what
is asked of them is said in `tests.endurance.forged_imports`.  Either way in bounded time and
memory, and a refusal is one line with the file's name.  The rest are failures, listed by number.
The exit code is 1 if a damaged or forged one is among them; what the libraries do with a hostile
one is theirs.
"""

from __future__ import annotations

import argparse
import importlib
import json
import queue
import resource
import subprocess
import sys
import tempfile
import threading
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]
KINDS = {
    "recording": ("tests.endurance.forged_recordings", "RecordingTarget"),
    "space": ("tests.endurance.forged_recordings", "SpaceTarget"),
    "shard": ("tests.endurance.forged_shards", "ShardTarget"),
    "loop": ("tests.endurance.forged_loops", "LoopTarget"),
    **{
        name: ("tests.endurance.forged_imports", target)
        for name, target in {
            "npz": "NpzTarget",
            "parquet": "ParquetTarget",
            "mat": "MatTarget",
            "fclib": "FclibTarget",
            "siconos": "SiconosTarget",
            "blocks": "BlocksTarget",
        }.items()
    },
}
"""What keeps a sound file at `path`: `change(i)` puts the i-th change of it there, and says of what
sort it is and what it is; `read()` reads it, and says whether it holds what the sound file held."""
PATIENCE = 10.0
"""Seconds without a word after which a reader counts as hanging."""
BEGIN = 120.0
"""Seconds that a reader may take to begin."""
MEMORY = 300
"""Megabytes that reading a file of some tens of kilobytes may add to the process."""
FAILURES = ("crash", "hang", "memory", "other error", "many lines", "misread")


def target_of(kind: str, folder: Path) -> Any:
    """A sound file of this kind in a folder, ready to be changed."""
    module, name = KINDS[kind]
    return getattr(importlib.import_module(module), name)(folder)


def read_files(kind: str, first: int, last: int, folder: Path) -> None:
    """The life of a reader: make and read the files of these numbers, a line of JSON for each."""
    target = target_of(kind, folder)
    print(json.dumps("ready"), flush=True)
    for number in range(first, last):
        sort, what = target.change(number)
        print(json.dumps([number, sort, what, "begun"]), flush=True)
        before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        try:
            sound = target.read()
            outcome = "read" if sound else "misread" if sort == "damaged" else "accepted"
        except target.error as error:
            text = str(error)
            outcome = "refused" if "\n" not in text and str(target.path) in text else "many lines"
        except Exception as error:
            outcome = "other error"
            what = f"{what}: {type(error).__name__}: {str(error)[:100]}"
        if resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before > 1024 * MEMORY:
            outcome = "memory"
        print(json.dumps([number, sort, what, outcome]), flush=True)


def outcomes(kind: str, first: int, last: int) -> Iterator[tuple[int, str, str, str]]:
    """(number, sort, what was changed, what came of it) of every file."""
    number = first
    while number < last:
        for found in _until_it_dies(kind, number, last):
            yield found
            number = found[0] + 1


def _until_it_dies(kind: str, first: int, last: int) -> Iterator[tuple[int, str, str, str]]:
    """What one reader makes of the files, up to the one that it does not survive."""
    with tempfile.TemporaryDirectory() as folder, subprocess.Popen(
        [sys.executable, __file__, "--reader", kind, str(first), str(last), folder],
        stdout=subprocess.PIPE, text=True, cwd=ROOT,
    ) as reader:  # fmt: skip
        lines: queue.Queue[str] = queue.Queue()
        forwarder = threading.Thread(target=_forward, args=(reader.stdout, lines))
        forwarder.start()
        number, sort, what = first, "?", "making it"
        try:
            if not lines.get(timeout=BEGIN):
                raise RuntimeError("the reader could not begin; its own words are above")
            while number < last:
                line = lines.get(timeout=PATIENCE)
                if not line:
                    yield number, sort, f"{what}: exit code {reader.wait()}", "crash"
                    return
                _, sort, what, outcome = json.loads(line)
                if outcome != "begun":
                    yield number, sort, what, outcome
                    number += 1
        except queue.Empty:
            yield number, sort, what, "hang"
        finally:
            reader.kill()
            forwarder.join()


def _forward(stream: Any, lines: queue.Queue[str]) -> None:
    for line in stream:
        lines.put(line)
    lines.put("")


def main(arguments: Sequence[str] | None = None) -> int:
    """Print how many files of each sort ended how; 1 if one was not refused or read properly."""
    parser = argparse.ArgumentParser(description="Damaged and forged files, read in turn.")
    parser.add_argument("--files", type=int, default=3000, help="of each kind")
    parser.add_argument("--from", dest="first", type=int, default=0, help="number of the first")
    parser.add_argument("--kind", choices=list(KINDS), action="append")
    chosen = parser.parse_args(arguments)
    failed = False
    for kind in chosen.kind or KINDS:
        counts: Counter[tuple[str, str]] = Counter()
        for number, sort, what, outcome in outcomes(
            kind, chosen.first, chosen.first + chosen.files
        ):
            counts[sort, outcome] += 1
            if outcome in FAILURES:
                failed |= sort != "hostile"
                print(f"FAILED: {kind} {number}, {sort}, {what}: {outcome}", flush=True)
        for (sort, outcome), count in sorted(counts.items()):
            print(f"{kind:10s} {sort:8s} {outcome:12s} {count:6d}")
    return int(failed)


if __name__ == "__main__":
    sys.path.insert(0, str(ROOT))
    if sys.argv[1:2] == ["--reader"]:
        read_files(sys.argv[2], int(sys.argv[3]), int(sys.argv[4]), Path(sys.argv[5]))
    else:
        sys.exit(main())
