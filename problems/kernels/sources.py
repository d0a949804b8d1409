"""Which files a file rests on, found by its imports: what caches and versions are named by."""

from __future__ import annotations

import re
from collections.abc import Iterable
from pathlib import Path

ROOT = Path(__file__).parents[2]
"""The folder of the project's packages."""
IMPORT = re.compile(r"^[ \t]*from ([\w.]+) import (\([^)]*\)|[^\n]*)", re.MULTILINE)
"""The one way in which modules of the project name each other."""


def sources(files: Iterable[Path], packages: Iterable[str]) -> list[Path]:
    """The files, and all that they import, directly or not, from these packages; sorted."""
    within = tuple(packages)
    found = {file.resolve() for file in files}
    rest = list(found)
    while rest:
        text = rest.pop().read_text(encoding="utf-8")
        for module, names in IMPORT.findall(text):
            if module.partition(".")[0] not in within:
                continue
            place = ROOT.joinpath(*module.split("."))
            named = [place, *(place / name for name in re.findall(r"\w+", names))]
            new = {path.with_suffix(".py") for path in named} - found
            new = {path for path in new if path.is_file()}
            found |= new
            rest += new
    return sorted(found)


def defining(folder: Path, mark: str) -> list[Path]:
    """Files below a folder in which `mark` stands."""
    return [file for file in sorted(folder.rglob("*.py")) if mark in file.read_text("utf-8")]
