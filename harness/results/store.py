"""The results folder: what was replayed, in shards that are whole or absent.

    RESULTS/recordings/<label>.h5          the recordings that were replayed
    RESULTS/solves/<shard>.parquet         one row per QP, with the times of every pass
    RESULTS/study.json                     machine, versions, commit, day and arguments
    RESULTS/spent.json                     seconds spent replaying, and in the calls of solvers
    RESULTS/.lock                          held by the process that writes

A shard is (recording, solver, setting, arm); its file is described in `harness.results.shard_file`.

1. A finished pass is saved at once, rows and times in one file that is replaced in one step
   (`harness.files.whole_files`): at no moment is a killed study half of anything.
2. A study that resumes finds its shards by name.  One whose key differs was made from other
   QPs, by other code or on another machine: it refuses to mix, and says which field differs.
3. `read_results` checks the same across shards (`AGREE`).  Machines may mix in rows of accuracy;
   whoever forms a ratio of times keeps to one of them.
4. One process writes at a time (`harness.files.folder_lock`): two studies on one machine would time
   each other.  Nothing depends on clocks or on the age of files.
"""

from __future__ import annotations

import json
import os
import sys
import tempfile
import warnings
from collections.abc import Collection, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa

from harness.files.folder_lock import lock_folder
from harness.files.json_file import read_json, sealed_json
from harness.files.plain_files import Unreadable
from harness.files.whole_files import clear_leftovers, write_whole
from harness.machine.unrest import Unrest
from harness.names import NOT_KNOWN
from harness.passes.limits import TIME_LIMIT
from harness.passes.outcome import DISTURBED
from harness.recordings.recording import Recording, RecordingError, read_recording, write_recording
from harness.results.shard_file import (
    COLUMNS,
    FROM_KEY,
    FROM_PASSES,
    TIMES,
    Shard,
    ShardKey,
    StoredShard,
    StoreError,
    read_shard,
    refuse_other,
    shard_bytes,
)

__all__ = [
    "COLUMNS",
    "REPEAT_COLUMNS",
    "TIMES",
    "Shard",
    "ShardKey",
    "Store",
    "StoreError",
    "read_passes",
    "read_repeats",
    "read_results",
    "read_shards",
    "read_spent",
]

REPEAT_COLUMNS = ("problem", "solver", "settings", "arm", "repeat", "quiet", *TIMES)
"""Columns of `read_repeats`: one row per QP and pass, times in seconds."""

PASS_KEY = ("scene", "solver", "settings", "arm")
PASS_COLUMNS = (*PASS_KEY, "repeat", "pace", *Unrest._fields, "disturbed_by")
"""Columns of `read_passes`: [s] of the calibration before a pass, the fields of
`harness.machine.unrest.Unrest`, and which of them have disturbed it."""

SPENT = ("replaying", "in_passes", "in_calls")
"""Seconds of a replay: all of them, judging and storing included; those of its passes, with warm-up
and the start of processes; and those inside the calls of solvers that were timed."""

STUDY: dict[str, type] = {
    **dict.fromkeys(("machine", "clock", "libraries", "solvers", "arguments"), dict),
    **dict.fromkeys(("study", "begun", "commit"), str),
}
"""What study.json may say, and of what type; the clock's are numbers."""

AGREE: dict[str, tuple[str, ...]] = {
    "recording_digest": ("scene",),
    "versions": ("solver",),
    "time_limit": (),
    "memory_limit": (),
}
"""Fields of `ShardKey` that must be the same in all shards that share the fields beside them."""

ANEW = ", or begin the solver anew by `glambda replay --again`"
"""What else helps where a shard is of another key."""

Seen = dict[tuple[str, ...], tuple[Any, str]]
"""What shards agree on so far, and where it was first."""


class Store:
    """A results folder that is written to, by this process alone as long as this object lives.

    Raises StoreError where the folder cannot be written to, and Locked where another process is
    writing into it.
    """

    def __init__(self, folder: str | os.PathLike[str]) -> None:
        self.folder = Path(folder)
        with self._written(self.folder):
            self._lock = lock_folder(self.folder, "study")
            for part in (".", "solves", "recordings"):
                clear_leftovers(self._part(part))
        read_spent(self.folder)  # refused now, and not when there is something to add

    def add_recording(self, recording: Recording) -> Path:
        """Keep a copy of the recording, and say where; another of the same label is refused."""
        path = self.folder / "recordings" / f"{recording.scene}.h5"
        if path.exists():
            try:
                digest = read_recording(path).digest
            except RecordingError as error:
                raise StoreError(f"{error}; or use another results folder") from None
            if digest == recording.digest:
                return path
            raise StoreError(
                f"{path}: holds another recording of this scene (digest {digest[:12]}…, now "
                f"{recording.digest[:12]}…); use another results folder, or delete this one"
            )
        with self._written(path):
            write_recording(path, recording)
        return path

    def load(self, key: ShardKey) -> Shard | None:
        """The shard of this key as far as it was finished, or None; also where it was disturbed, or
        where the solver could not be imported then.

        Raises StoreError if there is one of the same name that was made from or by something else.
        """
        path = self._path(key)
        if not path.exists():
            return None
        stored = read_shard(path)
        if stored.key.versions == NOT_KNOWN != key.versions:
            return None
        refuse_other(path, asdict(stored.key), asdict(key), ANEW)
        return _final(_shard_of(stored))

    def save(self, shard: Shard) -> None:
        """Write the shard over an earlier one of the same key, at once or not at all."""
        path, content = self._path(shard.key), shard_bytes(shard)
        with self._written(path):
            write_whole(path, content)

    def mend(self, shard: Shard) -> None:
        """Write a shard once more where its file is not what it was, and warn of it."""
        path = self._path(shard.key)
        try:
            same = path.read_bytes() == shard_bytes(shard)
        except OSError:
            same = False
        if not same:
            self.save(shard)
            text = f"{path}: was altered by another process; written anew from what was measured"
            warnings.warn(text, RuntimeWarning, stacklevel=2)

    def adopt(self, name: str, content: bytes) -> None:
        """File a shard that another machine has made, over one of the same name.

        Raises StoreError where it is damaged.
        """
        with tempfile.TemporaryDirectory() as elsewhere:
            arrived = Path(elsewhere) / Path(name).name
            arrived.write_bytes(content)
            path = self._path(read_shard(arrived).key)
        with self._written(path):
            write_whole(path, content)

    def made_anywhere(self, key: ShardKey) -> Shard | None:
        """As `load`, on whatever machine it was made."""
        path = self._path(key)
        if not path.exists():
            return None
        stored = read_shard(path)
        same = replace(stored.key, machine=key.machine) == key
        return _final(_shard_of(stored)) if same else None

    def refuse_mixture(self, keys: Iterable[ShardKey], again: Collection[str] = ()) -> None:
        """Raise StoreError where shards of these keys may not stand beside those that are there.

        again : solvers whose shards are to be made anew; once nothing is refused, they are removed
        """
        seen: Seen = {}
        removed = []
        for path, shard in _stored(self.folder):
            if shard.key.solver in again:
                removed.append(path)
            else:
                _agree(seen, shard.key, path, "made")
        for key in keys:
            _agree(seen, key, self._path(key), "to be made")
        for path in removed:
            with self._written(path):
                path.unlink()

    def write_study(self, description: Mapping[str, Any]) -> None:
        """Write study.json: machine, versions, commit, day, arguments."""
        path = self.folder / "study.json"
        with self._written(path):
            write_whole(path, (json.dumps(description, indent=2, sort_keys=True) + "\n").encode())

    def add_spent(self, seconds: Mapping[str, float]) -> None:
        """Add what a replay took, under the names `SPENT`, to spent.json."""
        before, path = read_spent(self.folder), self.folder / "spent.json"
        total = {name: before.get(name, 0.0) + seconds.get(name, 0.0) for name in SPENT}
        with self._written(path):
            write_whole(path, sealed_json(total))

    def _part(self, name: str) -> Path:
        """A folder in this one, which may be missing."""
        part = self.folder / name
        if part.exists() and not part.is_dir():
            raise StoreError(f"{part}: is no folder; move it away, or use another results folder")
        return part

    def _path(self, key: ShardKey) -> Path:
        return self.folder / "solves" / f"{key.name}.parquet"

    @contextmanager
    def _written(self, path: Path) -> Iterator[None]:
        """Say what is lost, and what is not, where the system refuses to write."""
        try:
            yield
        except OSError as error:
            raise StoreError(
                f"{path}: cannot be written ({error.strerror or error}); what was finished is "
                "kept: make room or give the right to write, then run the same command again"
            ) from None


def read_results(folder: str | os.PathLike[str]) -> pd.DataFrame:
    """All rows of a results folder, columns `COLUMNS`, ordered by problem, solver, settings, arm.

    Counts that a solver does not keep are NA (type Int64).

    Raises StoreError for a damaged shard, and for shards that may not stand in one table: two
    recordings of one scene, two versions of one solver, two time limits.
    """
    tables = [shard.rows for shard in read_shards(Path(folder))]
    whole = pa.concat_tables([pa.schema(list(COLUMNS.items())).empty_table(), *tables])
    frame = whole.to_pandas(types_mapper=_nullable)
    return frame.sort_values(["problem", "solver", "settings", "arm"], ignore_index=True)


def read_repeats(folder: str | os.PathLike[str]) -> pd.DataFrame:
    """Times of every pass, columns `REPEAT_COLUMNS`.  Raises StoreError like `read_results`."""
    parts = [pd.DataFrame(columns=list(REPEAT_COLUMNS))]
    for key, rows, passes, unrest in read_shards(Path(folder)):
        count, n, _ = passes.shape
        part = pd.DataFrame(passes.reshape(count * n, len(TIMES)), columns=list(TIMES))
        part["problem"] = np.tile(rows["problem"].to_numpy(), count)
        part["repeat"] = np.repeat(np.arange(count), n)
        part["quiet"] = np.repeat([each.is_quiet for each in unrest], n)
        parts.append(part.assign(solver=key.solver, settings=key.settings, arm=key.arm))
    frame = pd.concat(parts[1:] or parts)[list(REPEAT_COLUMNS)]
    order = ["problem", "solver", "settings", "arm", "repeat"]
    return frame.sort_values(order, ignore_index=True)


def read_passes(folder: str | os.PathLike[str]) -> pd.DataFrame:
    """What the machine did: one row per pass, columns `PASS_COLUMNS`.

    Raises StoreError like `read_results`.
    """
    found = [
        (
            *(getattr(key, name) for name in PASS_KEY),
            *(repeat, times[0, TIMES.index("pace")], *unrest, ", ".join(unrest.reasons())),
        )
        for key, _, passes, readings in read_shards(Path(folder))
        for repeat, (times, unrest) in enumerate(zip(passes, readings, strict=True))
        if len(times)
    ]
    return pd.DataFrame(found, columns=list(PASS_COLUMNS))


def read_time_limit(folder: str | os.PathLike[str]) -> float:
    """[s] per solve, of all shards; the default where there is none.

    Raises StoreError like `read_results`.
    """
    return next((shard.key.time_limit for shard in read_shards(Path(folder))), TIME_LIMIT)


def read_study(folder: str | os.PathLike[str]) -> dict[str, Any]:
    """What study.json says (`STUDY`); empty where there is none.

    Raises StoreError for one that is damaged, or says something else.
    """
    path = Path(folder) / "study.json"
    said = _document(path)
    for name, kind in STUDY.items():
        if not isinstance(said.get(name, kind()), kind):
            raise _no_document(path, f"{name}: is no {_WORDS[kind]}")
    for name, value in said.get("clock", {}).items():
        if not _is_time(value):
            raise _no_document(path, f"clock: {name[:40]}: is no number of seconds")
    return said


def read_spent(folder: str | os.PathLike[str]) -> dict[str, float]:
    """Seconds under the names `SPENT`, over all replays into a folder; empty if there was none.

    Raises StoreError where spent.json is damaged, or says something else.
    """
    path = Path(folder) / "spent.json"
    said = _document(path, must_be_sealed=True)
    if said and (set(said) != set(SPENT) or not all(map(_is_time, said.values()))):
        raise _no_document(path, f"needs numbers of seconds under {', '.join(SPENT)}")
    return {name: float(seconds) for name, seconds in said.items()}


_WORDS: dict[type, str] = {dict: "object of names and values", str: "text"}


def _document(path: Path, must_be_sealed: bool = False) -> dict[str, Any]:
    """A JSON document of the folder; empty where there is none."""
    try:
        return read_json(path, must_be_sealed=must_be_sealed)
    except FileNotFoundError:
        return {}
    except OSError as error:
        raise _no_document(path, f"cannot be read ({error.strerror or error})") from None
    except Unreadable as error:
        raise _no_document(path, str(error)) from None


def _no_document(path: Path, what: str) -> StoreError:
    return StoreError(f"{path}: {what}; delete it: nothing but words of a report depend on it")


def _is_time(value: Any) -> bool:
    """Whether a value is a number of seconds."""
    number = isinstance(value, (int, float)) and not isinstance(value, bool)
    return number and 0 <= value <= sys.float_info.max


def read_shards(folder: Path) -> Iterator[StoredShard]:
    """All shards, in order of their names.  Raises StoreError like `read_results`."""
    seen: Seen = {}
    for path, shard in _stored(folder):
        _agree(seen, shard.key, path, "made")
        yield shard


def _stored(folder: Path) -> Iterator[tuple[Path, StoredShard]]:
    """All shards with their files, whether they agree or not."""
    for path in sorted((folder / "solves").glob("*.parquet")):
        yield path, read_shard(path)


def _agree(seen: Seen, key: ShardKey, path: Path, made: str) -> None:
    """Raise StoreError where a key differs from those `seen` in what must be the same (`AGREE`).

    Who cannot be imported has no version.
    """
    for name, shared in AGREE.items():
        value = getattr(key, name)
        if value == NOT_KNOWN:
            continue
        which = (name, *(str(getattr(key, other)) for other in shared))
        first, where = seen.setdefault(which, (value, path.name))
        if first != value:
            raise StoreError(
                f"{path}: {made} with {name} {value!r}, but {where} with {first!r}; results may "
                "not be mixed: use another results folder, or delete one of them"
            )


def _final(shard: Shard) -> Shard | None:
    """The shard, unless what came of it was not the solver's doing: then it is made anew."""
    return None if any(map(is_disturbed, shard.rows)) else shard


def is_disturbed(row: Mapping[str, Any]) -> bool:
    """Whether a row says what befell the machine and not what the solver did."""
    return str(row["status_text"]).startswith(DISTURBED)


def _shard_of(stored: StoredShard) -> Shard:
    study = stored.rows["study"][0].as_py() if stored.rows.num_rows else ""
    rows = stored.rows.drop_columns([*FROM_KEY, *FROM_PASSES, "study"]).to_pylist()
    return Shard(stored.key, rows, stored.passes, stored.unrest, study)


def _nullable(kind: pa.DataType) -> Any:
    """Counts may be absent without turning into floats."""
    return pd.Int64Dtype() if kind == pa.int64() else None
