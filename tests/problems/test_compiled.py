"""Machine code does not depend on what else has been loaded, or on who compiled it."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from typing import Any, NamedTuple

import numba
import numpy as np
import pytest
from numba.core.errors import TypingError

from problems.kernels.compiled import SOURCES, cache_folder
from problems.kernels.numba_internals import in_place, known
from problems.kernels.sources import defining, sources

ROOT = Path(__file__).parents[2]
KERNELS = """
import os, sys
from pathlib import Path
import numpy as np
from problems.kernels.compiled import kernel_decorator

kernel = kernel_decorator([Path(__file__)])

@kernel
def near_root(x, times):
    for _ in range(times):
        for i in range(x.size):
            if x[i] > 1.0:
                x[i] = np.sqrt(x[i]) + 1e-3 * np.sin(x[i])
            elif x[i] < -1.0:
                x[i] = -np.cbrt(x[i]) + 1e-3 * np.cos(x[i])
            else:
                x[i] += 2.0 * np.exp(x[i]) - np.log(2.0 + x[i])
    for i in range(x.size - 2):  # too long for LLVM to put it in line
        if x[i] > x[i + 1] + x[i + 2]:
            x[i] = np.arctan(x[i + 1]) * np.sin(x[i + 2]) + np.tanh(x[i])
        elif x[i] < 0.1:
            x[i] += np.exp(-x[i + 1] ** 2) - np.arcsinh(x[i + 2]) + np.hypot(x[i], 1.0)
        else:
            x[i] -= np.log1p(abs(x[i + 1])) * np.cosh(0.1 * x[i + 2]) / (1.0 + x[i] ** 4)
    return x

@kernel
def twice(x):
    return near_root(x, 3).sum() + near_root(x, 5).sum() + near_root(x, x.size).sum()
"""
LOOK = """
from llvmlite.binding import Linkage

x = np.linspace(-3.0, 5.0, 37)
print(twice(x.copy()).hex())
library = twice.overloads[twice.signatures[0]].library
if len(sys.argv) > 1:
    print(sum(twice.stats.cache_hits.values()))
else:
    own = [f for f in library._final_module.functions if not f.is_declaration]
    copies = [f for f in own if "near_root" in f.name]
    internal = sum(f.linkage is Linkage.internal for f in copies)
    print(len(copies), internal, len(near_root.overloads))
"""


def test_a_kernel_calls_its_own_copies_of_other_kernels(tmp_path: Path) -> None:
    script = tmp_path / "kernels.py"
    script.write_text(KERNELS + LOOK)

    apart = os.environ | {"XDG_CACHE_HOME": str(tmp_path)}

    def lines(*argument: str) -> list[str]:
        run = [sys.executable, str(script), *argument]
        done = subprocess.run(run, capture_output=True, text=True, check=True, env=apart)
        return done.stdout.split()

    compiled, copies, own, kinds = lines()
    again, hits = lines("cached")
    assert int(copies) == int(own) > 0
    assert kinds == "1"  # whatever constants it is handed
    assert again == compiled and hits == "1"


ELSEWHERE = """
import numba
numba.__version__ = "0.99.0"
from pathlib import Path
import numpy as np
from problems.kernels.compiled import kernel_decorator
from problems.kernels.numba_internals import LOST, in_rows, lent, read_only

@kernel_decorator([Path(__file__)])
def total(pair):
    x, y = lent(pair)
    return (read_only(in_rows(x, 2, 3)) @ y).sum()

print(total((np.arange(6.0), np.ones(3))))
assert "0.99.0" in LOST and "longer" in LOST
"""


def test_another_numba_is_done_without_its_insides(tmp_path: Path) -> None:
    script = tmp_path / "elsewhere.py"
    script.write_text(ELSEWHERE)
    apart = os.environ | {"XDG_CACHE_HOME": str(tmp_path)}
    run = [sys.executable, str(script)]
    done = subprocess.run(run, capture_output=True, text=True, check=True, env=apart)
    assert done.stdout.split() == ["15.0"] and "0.99.0" in done.stderr


def test_a_process_given_a_cache_of_its_own_still_finds_what_was_compiled(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = cache_folder(SOURCES)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert cache_folder(SOURCES) == before and not any(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("version", "inside"),
    [("0.61.0", True), ("0.68.1", True), ("0.60.0", False), ("0.69.0rc1", False), ("1.0", False)],
)
def test_versions_whose_insides_are_known(version: str, inside: bool) -> None:
    assert known(version) is inside


def test_sources_are_the_files_that_kernels_rest_on() -> None:
    """Those that define kernels, and what they import, on and on; the stepper is none of them."""
    names = {str(path.relative_to(path.parents[2])) for path in SOURCES if "problems" in path.parts}
    for name in ("friction/kernels.py", "formulas/multistep.py", "stepping/records.py"):
        assert any(found.endswith(name) for found in names), name
    assert not any(found.endswith("stepping/stepper.py") for found in names)
    folder = Path(__file__).parents[2] / "problems"
    assert set(defining(folder, "\n@kernel\n")) <= set(SOURCES)
    assert sources([folder / "sequence.py"], []) == [folder / "sequence.py"]


class Track(NamedTuple):
    places: Any
    length: int
    scale: float


def test_what_stands_in_place_has_the_members_of_the_tuple() -> None:
    @numba.njit
    def summed(track: Any) -> Any:
        track = in_place(track)
        total = 0.0
        for i in range(track.length):
            track.places[i] += 1.0
            total += track.scale * track.places[i]
        return total

    places = np.arange(4.0)
    assert summed(Track(places, 3, 2.0)) == 2.0 * (1.0 + 2.0 + 3.0)
    assert places.tolist() == [1.0, 2.0, 3.0, 3.0]

    @numba.njit
    def misspelt(track: Any) -> Any:
        return in_place(track).place

    with pytest.raises(TypingError, match="place"):
        misspelt(Track(places, 3, 2.0))


SERVER = """
import harness.processes.our_kernels
from problems.kernels.spread import SPREAD

print(*(direct.is_ready for direct in SPREAD.values()))
"""


def test_what_makes_A_dense_is_there_before_processes_are_forked_to_solve() -> None:
    """Each would load it, or where none may write to the cache compile it, which takes 0.7 s."""
    done = subprocess.run(
        [sys.executable, "-c", SERVER], cwd=ROOT, capture_output=True, text=True, check=True
    )
    assert done.stdout.split() == ["True", "True"]
