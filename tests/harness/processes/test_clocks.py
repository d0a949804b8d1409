"""Nobody is charged less than it takes, wherever it hides it; what it does is in the fakes."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

import pandas as pd
import pytest

from harness import replay
from harness.processes import confined, isolate
from harness.processes.process import server
from solvers import registry
from tests.fakes.clock_crimes import BY_THEIR_TIME, CONFINED, PAD, targets
from tests.fakes.fake_recordings import fake_recording

pytestmark = pytest.mark.skipif(not isolate.is_available(), reason="the system cannot fork")
ADOPTS = "WorksAsItAdopts"


@pytest.fixture(scope="module")
def study(tmp_path_factory: pytest.TempPathFactory) -> Iterator[pd.DataFrame]:
    """The rows of one study in which all of them take part, one with what it starts from."""
    folder = tmp_path_factory.mktemp("study")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(registry, "_REGISTERED", targets())
        patch.setenv("TEST_OF_CLOCKS", str(folder))
        server().close()  # the next one has it in its environment
        for names, arm in ((list(targets()), "cold"), ([ADOPTS], "exact")):
            rows = replay(fake_recording(), names, arms=[arm], repeats=2, results=folder)
        yield rows
    server().close()


@pytest.mark.parametrize("name", targets())
def test_nobody_is_charged_less_than_it_takes(study: pd.DataFrame, name: str) -> None:
    if name in CONFINED and not confined.is_confined():
        pytest.skip("processes cannot be confined here")
    arm = "exact" if name == ADOPTS else "cold"
    rows = study[(study["solver"] == name) & (study["arm"] == arm) & (study["k"] > 0)]
    if arm == "exact":
        rows = rows[rows["warm_started"]]
    assert len(rows) >= 3 and (rows["verdict"] == "verified").all()
    assert (rows["runtime"] > PAD / 2).all() and (rows["call_time"] > PAD / 2).all()


def test_who_is_not_believed_is_told(study: pd.DataFrame) -> None:
    cold = study[(study["arm"] == "cold") & (study["k"] > 0)]
    told = cold.groupby("solver")["believed"].any()
    silent = {cls.__name__ for cls in BY_THEIR_TIME if cls.__name__.startswith(("Lazy", "Tells"))}
    assert not told[sorted(silent | {"PatchesTheClocks", "WorksAsItReads"})].any()


@pytest.mark.skipif(not confined.is_confined(), reason="processes cannot be confined here")
def test_a_confined_process_sees_and_changes_nothing_of_others(tmp_path: Path) -> None:
    hidden, own, free = (tmp_path / name for name in ("hidden", "own", "free"))
    for folder in (hidden, own, free):
        folder.mkdir()
        (folder / "file").write_text("what it says")
    (tmp_path / "way").symlink_to(hidden)
    us = os.getpid()
    attempts = {
        "reads what is free": lambda: (free / "file").read_text(),
        "writes its own": lambda: (own / "new").write_text("x"),
        "throws away": lambda: Path(os.devnull).write_text("x"),
        "signals itself": lambda: os.kill(os.getpid(), 0),
        "reads what is hidden": lambda: (hidden / "file").read_text(),
        "reads it by another way": lambda: (tmp_path / "way" / "file").read_text(),
        "moves it": lambda: (hidden / "file").rename(own / "file"),
        "links it": lambda: os.link(hidden / "file", own / "link"),
        "writes elsewhere": lambda: (free / "file").write_text("x"),
        "writes what is new": lambda: (free / "new").write_text("x"),
        "writes what is shared": lambda: Path("/dev/shm/glambda-test").write_text("x"),
        "signals us": lambda: os.kill(us, 0),
        "looks into us": lambda: os.open(f"/proc/{us}/mem", os.O_RDONLY),
    }
    heard, said = os.pipe()
    child = os.fork()
    if child == 0:
        confined.confine([own], [hidden])
        for name, attempt in attempts.items():
            try:
                attempt()
            except OSError:
                continue
            os.write(said, f"{name}\n".encode())
        os._exit(0)
    os.close(said)
    os.waitpid(child, 0)
    with os.fdopen(heard) as file:
        done = file.read().splitlines()
    assert done == ["reads what is free", "writes its own", "throws away", "signals itself"]


def test_all_but_what_is_hidden_is_granted(tmp_path: Path) -> None:
    for name in ("a/b/c", "a/d", "e"):
        (tmp_path / name).mkdir(parents=True)
    found = set(confined.granted({tmp_path / "a" / "b"}, tmp_path))
    assert found == {tmp_path / "a" / "d", tmp_path / "e"}
    assert list(confined.granted(set(), tmp_path)) == [tmp_path]
