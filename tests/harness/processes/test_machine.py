"""Machine, versions and threads: what a row says about where it comes from."""

from __future__ import annotations

import socket
import sys
from contextlib import contextmanager
from importlib import metadata
from pathlib import Path
from types import SimpleNamespace

import pytest

from harness.machine.machine import (
    library_versions,
    machine,
    machine_label,
    problems_version,
    source_hash,
)
from harness.machine.threads import VARIABLES, ask_for_one_thread, one_thread, threads_asked_for
from harness.processes.introduction import solver_version
from solvers import Solver
from solvers.registry import distribution_of


def test_no_host_names_and_no_paths() -> None:
    text = machine_label() + str(machine()) + str(library_versions()) + problems_version()
    assert str(Path.home()) not in text.replace("/ ", "") or str(Path.home()) == "/"
    assert str(Path(__file__).parents[3]) not in text
    words = text.replace(",", " ").replace("'", " ").split()
    assert socket.gethostname() not in words
    assert machine()["cpu"] and int(machine()["cores"]) >= 1


def test_versions_name_the_package_and_our_source() -> None:
    assert solver_version("glambda").startswith("glambda ")
    assert "scipy " in solver_version("scipy_bvls") and "(source " in solver_version("scipy_bvls")
    assert solver_version("lotstedt[exact_qr]") == solver_version("lotstedt")
    assert set(library_versions()) >= {"glambda", "numpy", "scipy"}


def test_the_hash_is_of_names_and_content(tmp_path: Path) -> None:
    a, b = tmp_path / "a.py", tmp_path / "b.py"
    a.write_text("x = 1")
    b.write_text("y = 2")
    before = source_hash([a, b])
    assert before == source_hash([b, a])
    b.write_text("y = 3")
    assert source_hash([a, b]) != before


def test_one_thread_is_asked_for_but_not_forced(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in VARIABLES:
        monkeypatch.delenv(name, raising=False)
    assert threads_asked_for() == "unset"
    monkeypatch.setenv(VARIABLES[0], "4")
    ask_for_one_thread()
    assert threads_asked_for() == "mixed"
    monkeypatch.setenv(VARIABLES[0], "1")
    assert threads_asked_for() == "1"


def test_loaded_libraries_are_limited_where_possible(monkeypatch: pytest.MonkeyPatch) -> None:
    limits: list[int] = []

    @contextmanager
    def threadpool_limits(limits_: int | None = None, **options: int):  # type: ignore[no-untyped-def]
        limits.append(options["limits"])
        yield

    monkeypatch.setitem(
        sys.modules, "threadpoolctl", SimpleNamespace(threadpool_limits=threadpool_limits)
    )
    with one_thread():
        pass
    assert limits == [1]
    monkeypatch.setitem(sys.modules, "threadpoolctl", None)  # not installed
    with one_thread():
        pass
    assert limits == [1]


def test_who_does_the_work_is_named() -> None:
    class Entry:
        value, dist = "mine:Mine", SimpleNamespace(name="of_mine")

    def made(name: str, **fields: str) -> type[Solver]:
        return type(name, (Solver,), {"__module__": "mine", "name": "mine", **fields})

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(metadata, "entry_points", lambda group: [Entry])
        assert distribution_of(made("Mine")) == "of_mine"
        assert distribution_of(made("Other")) == "glambda"
        assert distribution_of(made("Mine", package="numpy")) == "numpy"
