"""Changes planted in a copy of the code: which claims of the manifest turn?

    python -m tests.endurance.plant_claims                 all of them; kernels compile anew
    python -m tests.endurance.plant_claims criterion       one of them

For each of `PLANTS` the packages are copied into a folder of its own, one line is changed there,
and `glambda claims --slow` runs the claims that it is about, with kernels of that folder's own.
Before, the same claims must hold in the code as it is.  Exit code 1 where they do not, or where a
claim that a change must turn still stands.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

import pandas as pd

ROOT = Path(__file__).resolve().parents[2]
PARTS = ("problems", "solvers", "harness", "reports", "glambda", "benchmarks")
"""Packages that are copied."""


class Plant(NamedTuple):
    """A change.

    path : of the file;  line : in it, once;  changed : what stands there instead
    ids : of the claims that are run;  turned : of those that must not stand any more
    """

    path: str
    line: str
    changed: str
    ids: tuple[str, ...]
    turned: frozenset[str]


PLANTS: dict[str, Plant] = {
    "sign": Plant(
        "problems/friction/rules.py",
        "found[i] = max(0.0, lam[i] + change)",
        "found[i] = max(0.0, lam[i] - change)",
        ("5-growth", "5-law", "5-extrapolated", "5-order", "4-stepper"),
        frozenset({"5-growth", "5-law"}),
    ),
    "criterion": Plant(
        "solvers/active_set/flops.py",
        "return sqrt(2 * qr_flops(m, f) / cg_iteration_flops(m, f)) if f else 0.0",
        "return float(int(sqrt(2 * qr_flops(m, f) / cg_iteration_flops(m, f))) + 1) if f else 0.0",
        ("11",),
        frozenset({"11-rule", "11-rounded"}),
    ),
    "adapter": Plant(
        "solvers/base.py",
        "        result = self.run(native)\n",
        "        result = self.run(native)\n"
        "        until = clock() + (self.name == 'quadprog') * 0.2 * (clock() - t1)\n"
        "        while clock() < until:\n"
        "            pass\n",
        ("r-adapter", "r-same"),
        frozenset({"r-adapter"}),
    ),
}
"""A wrong sign in (4.2), the criterion's limit rounded up, an adapter that is slower by a fifth."""


def planted(plant: Plant, folder: Path) -> None:
    """Copy the packages into a folder and change the line.

    Raises ValueError where the line is not there, or not once.
    """
    for part in PARTS:
        skipped = shutil.ignore_patterns("__pycache__", "published")
        shutil.copytree(ROOT / part, folder / part, ignore=skipped)
    path = folder / plant.path
    text = path.read_text(encoding="utf-8")
    if text.count(plant.line) != 1:
        raise ValueError(f"{plant.path}: {plant.line!r} stands {text.count(plant.line)} times")
    path.write_text(text.replace(plant.line, plant.changed), encoding="utf-8")


def wrong(ids: Sequence[str], code: Path, kept: Mapping[str, str]) -> set[str]:
    """Claims of the code in a folder that do not stand; `kept`: variables of its process.

    Raises RuntimeError where the command has not come to its table.
    """
    with TemporaryDirectory() as out:
        done = subprocess.run(
            [sys.executable, "-m", "glambda", "claims", *ids, "--slow", "-o", out],
            cwd=code, env={**os.environ, "PYTHONPATH": str(code), **kept},
            capture_output=True, text=True,
        )  # fmt: skip
        table = Path(out) / "claims.csv"
        if not table.exists():
            raise RuntimeError(done.stderr.strip() or done.stdout.strip())
        rows = pd.read_csv(table)
    return set(rows.loc[rows["is"] == "WRONG", "id"])


def main(arguments: Sequence[str] | None = None) -> int:
    """Print a line for each change; 1 where one was not found, or the code was wrong before."""
    parser = argparse.ArgumentParser(description="Plant changes and run the claims.")
    parser.add_argument("plants", nargs="*", metavar="PLANT", help=f"of {', '.join(PLANTS)}")
    names = parser.parse_args(arguments).plants or list(PLANTS)
    unknown = set(names) - set(PLANTS)
    if unknown:
        parser.error(f"{', '.join(sorted(unknown))} is unknown; known: {', '.join(PLANTS)}")
    failed = 0
    for name in names:
        plant = PLANTS[name]
        before = wrong(plant.ids, ROOT, {})
        with TemporaryDirectory() as folder:
            code, cache = Path(folder) / "code", Path(folder) / "cache"
            planted(plant, code)
            after = wrong(plant.ids, code, {"XDG_CACHE_HOME": str(cache)})
        found = not before and plant.turned <= after
        failed += not found
        told = f"turned {', '.join(sorted(after)) or 'nothing'}"
        told += f"; wrong before: {', '.join(sorted(before))}" if before else ""
        print(f"{name}: {'found' if found else 'NOT FOUND'}, {told}", flush=True)
    return int(failed > 0)


if __name__ == "__main__":
    sys.exit(main())
