"""The tests run as the command line does: one thread, asked for before numerical libraries load.

They can be interrupted, and so can what they start, also where a shell began them in the background
and had them ignore SIGINT.  Which modules `make check` leaves out, and which `make rounding` runs
once more, is said here.

A test process holds all that the tests before have imported, hundreds of megabytes.  Garbage
collections, which passes begin with, would look through it again and again: what is there when a
module of tests begins is set aside.
"""

from __future__ import annotations

import gc
import signal
from collections.abc import Sequence
from pathlib import Path

import pytest
from hypothesis import settings

from harness.machine.threads import ask_for_one_thread

ask_for_one_thread()
signal.signal(signal.SIGINT, signal.default_int_handler)
settings.register_profile("same", derandomize=True, deadline=None)
settings.load_profile("same")

SLOW = {
    "they start, kill and wait for processes": (
        "test_cheats test_cli test_clocks test_closed_loop test_cluster test_disturbances "
        "test_introduction test_isolation test_kill test_notebook test_own_data test_plugins "
        "test_readme test_replay test_starts test_store test_streams"
    ),
    "they simulate for long": (
        "test_benchmarks test_campaigns test_cases test_convergence test_criterion test_cundall "
        "test_docs test_ellipses test_estimates test_exporting test_families test_growth "
        "test_heaps test_kept_factors test_manifest test_minimum_norm_ways test_motion_error "
        "test_mujoco test_painleve test_peers test_resumed test_stability"
    ),
    "they try thousands of problems or files": (
        "test_adapters test_certificates test_fuzz test_method_properties test_programs "
        "test_importing test_proof test_same_force test_sparse_reference"
    ),
    "they draw": (
        "test_gallery test_outside test_page_figures test_page_in_browser test_reports "
        "test_space_pictures"
    ),
}
"""Reason → modules."""
ROUNDING = (
    "test_active_set test_coulomb_lcp test_cycling_examples test_friction test_judge "
    "test_minimum_norm test_newton_coulomb test_proof test_same_force test_steps "
    "test_sparse_path test_stepper"
)
ROUNDING_SCENE = "fig4"
"""Of the tests that go through all scenes, that whose QPs are the most delicate; and of the solvers
ours, since packages come compiled and sum as they do."""
LEFT_OUT, ONCE_MORE = "not slow", "rounding"
"""What `make check` and `make rounding` give as -m."""
SLOW_ONES, DELICATE = set(" ".join(SLOW.values()).split()), set(ROUNDING.split())
_begun: set[Path] = set()
"""Modules of which a test has begun in this process."""


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """Modules of which nothing would be run are not imported either."""
    name, asked = collection_path.stem, config.option.markexpr
    if not name.startswith("test_"):
        return None
    if asked == LEFT_OUT:
        return name in SLOW_ONES or None
    marked = (
        asked != ONCE_MORE or name in DELICATE or "mark.rounding" in collection_path.read_text()
    )
    return not marked or None


def pytest_collection_modifyitems(items: Sequence[pytest.Item]) -> None:
    for item in items:
        name = item.path.stem
        if name in SLOW_ONES:
            item.add_marker(pytest.mark.slow)
        if name in DELICATE and (name != "test_same_force" or _delicate(item)):
            item.add_marker(pytest.mark.rounding)


def _delicate(item: pytest.Item) -> bool:
    from solvers.registry import BUILT_IN  # after threads have been asked for

    packages = [name for name, of in BUILT_IN.items() if of.startswith("solvers.adapters.")]
    return ROUNDING_SCENE in item.name and not any(f"[{name}-" in item.name for name in packages)


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup(item: pytest.Item) -> None:
    if item.path not in _begun:
        _begun.add(item.path)
        gc.collect()
        gc.freeze()


def pytest_terminal_summary(
    terminalreporter: pytest.TerminalReporter, config: pytest.Config
) -> None:
    if config.option.markexpr == LEFT_OUT:
        terminalreporter.section("left out by make check; make test runs them too")
        for reason, modules in SLOW.items():
            names = ", ".join(name.removeprefix("test_") for name in modules.split())
            terminalreporter.line(f"{reason}: {names}")
