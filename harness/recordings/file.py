"""The bytes of a recording file: a seal, and behind it plain HDF5.

The first 512 bytes are a *user block*, which every HDF5 library skips; it holds the seal
(`harness.files.seal`).

1. The seal is checked before the HDF5 library sees a byte.  That library is made for sound files: a
   flipped bit can keep it busy for ever.
2. A file that was sealed by a stranger may still ask for anything.  Read is only what the writer
   writes: members that are in this very file (no links elsewhere, no virtual or external storage),
   each array one plain block that is all there (no filters, so nothing that unpacks to more than
   the file), and attributes that are single numbers or texts of fixed length.
3. Names, types and sizes are looked at before anything is allocated, and what they need is held
   against the memory that there is.  The file itself is never held in memory.
"""

from __future__ import annotations

import io
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

import h5py
import numpy as np
from numpy.typing import NDArray

from harness.files.plain_files import Unreadable, open_plain
from harness.files.seal import BLOCK, block, intact, put_seal
from harness.machine.memory import available_memory
from harness.recordings.layout import OF_DISCS, OF_HULLS, OF_SPACE, check_lengths, fields_of

FORMAT = "glambda recording"
VERSION = 3
HEADER: dict[str, type] = {"scene": str, "parameters": str, "eps": float, "gravity": float}
"""Attributes of the file that belong to the content."""
SIGNATURE = ("code_version", "digest")
"""Attributes of the file that do not."""
FILE_LIMIT = 4_000_000_000
"""Largest file [bytes]; it is made in memory."""
QP_BYTES, ENTRY_BYTES = 10_000, 500
"""Memory that the parts of a recording take beyond their arrays, at most [bytes]: of each QP with
its solution and reference, and of each event, body and polygon."""


class RecordingError(ValueError):
    """A file that is no sound recording: which file, which field, what to do.  One line."""


Wrong = Callable[[str, str], RecordingError]
"""Makes the error for (field, what is wrong)."""


class Stored(NamedTuple):
    """What a file holds: attributes by name, arrays as in `fields_of`, the stepper's counts."""

    attributes: Mapping[str, Any]
    arrays: Mapping[str, NDArray[Any]]
    counts: Mapping[str, int]


def file_bytes(stored: Stored) -> bytes:
    """The content of the file, sealed.  The same content makes the same bytes."""
    buffer = io.BytesIO()
    with h5py.File(buffer, "w", track_order=False, userblock_size=BLOCK) as file:
        for name, field in fields_of(stored.arrays).items():
            dataset = file.create_dataset(name, data=stored.arrays[name], track_times=False)
            dataset.attrs["meaning"] = field.meaning
            dataset.attrs["unit"] = field.unit
        file.attrs["format"] = np.bytes_(FORMAT)
        file.attrs["version"] = VERSION
        for name, value in sorted(stored.attributes.items()):
            file.attrs[name] = np.bytes_(value.encode()) if isinstance(value, str) else value
        group = file.create_group("counts")
        for name, count in sorted(stored.counts.items()):
            group.attrs[name] = count
    buffer.seek(0)
    buffer.write(block(f"{FORMAT} {VERSION}".encode()))
    put_seal(buffer)
    return buffer.getvalue()


def read_file(path: Path, wrong: Wrong) -> Stored:
    """Read a file whose seal is right and which holds what it should, of the right types and sizes.

    Raises `wrong(field, what)` otherwise.  Values are not looked at.
    """
    try:
        with open_plain(path, FILE_LIMIT) as file:
            return _read_open(file, wrong)
    except RecordingError:
        raise
    except FileNotFoundError:
        raise wrong("file", "there is no such file") from None
    except Unreadable as error:
        raise wrong("file", str(error)) from None
    except MemoryError:
        raise wrong("file", "there is not memory enough to read it") from None
    # The bytes are foreign: h5py raises any of these on what it cannot make sense of.
    except (OSError, RuntimeError, KeyError, TypeError, ValueError, OverflowError) as error:
        raise wrong("file", f"cannot be read as HDF5 ({str(error)[:200]})") from None


def _read_open(file: BinaryIO, wrong: Wrong) -> Stored:
    head = file.read(BLOCK)
    if not head.startswith(FORMAT.encode()):
        raise wrong("file", "begins with no seal: it is truncated, foreign or of an older version")
    version = head[len(FORMAT) :].partition(b"\n")[0].decode(errors="replace").strip()
    if version != str(VERSION):
        raise wrong("version", f"is {version[:20]!r}; this glambda reads {VERSION}")
    if not intact(file):
        raise wrong("seal", "the bytes do not match it: the file was damaged or altered")
    with h5py.File(file, "r") as opened:
        header = _read_header(opened, wrong)
        return Stored(header, _read_arrays(opened, wrong), _read_counts(opened, wrong))


def _read_header(file: h5py.File, wrong: Wrong) -> dict[str, Any]:
    """Attributes of the file, after a look at format and version."""
    for name, value in (("format", FORMAT), ("version", VERSION)):
        found = _attribute(file, name, type(value), wrong)
        if found != value:
            raise wrong(name, f"is {str(found)[:60]!r} instead of {value!r}")
    kinds = HEADER | dict.fromkeys(SIGNATURE, str)
    return {name: _attribute(file, name, kind, wrong) for name, kind in kinds.items()}


def _read_counts(file: h5py.File, wrong: Wrong) -> dict[str, int]:
    group = _member(file, "counts", h5py.Group, wrong)
    return {name: _attribute(group, name, int, wrong) for name in sorted(group.attrs)}


def beyond_the_plane(file: h5py.File) -> list[str]:
    """Names of datasets that there should be of bodies in space, and of their friction."""
    names = {"space": OF_SPACE, "space/corners": OF_HULLS, "discs": OF_DISCS}
    return [name for there, group in names.items() if there in file for name in group]


def _read_arrays(file: h5py.File, wrong: Wrong) -> dict[str, NDArray[Any]]:
    """All arrays (`fields_of`), once their places, types and sizes are known to be sound."""
    datasets: dict[str, h5py.Dataset] = {}
    for name, field in fields_of(beyond_the_plane(file)).items():
        group, _, member = name.partition("/")
        dataset = _member(_member(file, group, h5py.Group, wrong), member, h5py.Dataset, wrong)
        kind = "S" if dataset.dtype.kind == "S" else dataset.dtype.str
        shape = dataset.shape
        if kind != field.dtype or shape is None or len(shape) != 1 + len(field.columns):
            raise wrong(name, f"has type {dataset.dtype} and shape {shape}")
        made = dataset.id.get_create_plist()
        plain = made.get_layout() == h5py.h5d.CONTIGUOUS and not made.get_external_count()
        if not plain or dataset.id.get_storage_size() != dataset.nbytes:
            raise wrong(name, "is not stored as one plain block")
        datasets[name] = dataset
    size = sum(dataset.nbytes for dataset in datasets.values())
    if size > file.id.get_filesize():
        raise wrong("file", "is smaller than the arrays it claims to hold")
    needed = (
        size
        + QP_BYTES * sum(len(datasets[name]) for name in ("qps/m", "discs/m") if name in datasets)
        + ENTRY_BYTES
        * sum(
            len(datasets[name])
            for name in ("events/t", "bodies/polygon_count", "bodies/corner_count")
        )
    )
    if needed > (there := available_memory()):
        raise wrong(
            "file", f"needs {needed / 1e9:.1f} GB of memory, and there are {there / 1e9:.1f}"
        )
    arrays = {name: np.ascontiguousarray(dataset[()]) for name, dataset in datasets.items()}
    check_lengths(arrays, wrong)
    return arrays


def _member(group: h5py.Group, name: str, kind: type, wrong: Wrong) -> Any:
    """A member of a group that is in this file, neither a link to another place nor to a file."""
    where = f"{group.name}/{name}".lstrip("/")
    link = group.get(name, getclass=True, getlink=True)
    if link is not h5py.HardLink:
        raise wrong(where, "is missing" if link is None else "is a link elsewhere")
    member = group[name]
    if not isinstance(member, kind):
        raise wrong(where, f"is no {kind.__name__.lower()}")
    return member


def _attribute(item: h5py.HLObject, name: str, kind: type, wrong: Wrong) -> Any:
    """A single number, or a text of fixed length; its type is looked at before it is read."""
    where = name if item.name == "/" else f"{item.name}/{name}".lstrip("/")
    if name not in item.attrs:
        raise wrong(where, "is missing")
    attribute = item.attrs.get_id(name)
    letters = {str: "S", float: "f", int: "iu"}[kind]
    if attribute.shape != () or attribute.dtype.kind not in letters:
        raise wrong(where, f"has type {attribute.dtype} and shape {attribute.shape}")
    value = item.attrs[name]
    return value.decode() if kind is str else kind(value)
