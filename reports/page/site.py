"""The pages beside the page of a study: what other commands have stored under its results.

    RESULTS/growth/growth.md, *.csv, *.png   →   OUT/growth/index.html, and the same files

A folder under the results that holds a page in Markdown is a page of the site.  It links to all the
others and to the study, which links to it.  What is not stored is left out, and is named.
"""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

from markupsafe import Markup

from reports.claims.race import losses as race_losses
from reports.parts.table import write_text
from reports.parts.templates import environment_of, inlined

COMMANDS = {
    "cases": "cases",
    "claims": "claims",
    "closed_loop": "closed-loop",
    "convergence": "convergence",
    "criterion": "criterion",
    "growth": "growth",
    "painleve": "painleve",
    "peers": "peers",
    "race": "race",
    "stability": "stability",
}
"""Folder under the results → the command that fills it."""
KINDS = (".md", ".csv", ".png", ".svg")
"""Suffixes of what a page consists of."""


class Leaf(NamedTuple):
    """A page beside that of the study: its folder's name, and its title."""

    name: str
    title: str

    @property
    def label(self) -> str:
        """Its folder in words: short, and no other page has it."""
        return self.name.replace("_", " ")


@dataclass(frozen=True)
class Site:
    """The pages that there are, and the commands whose results are not stored.

    losses : where our method is not the fastest by the page of a race, in sentences
    """

    leaves: Sequence[Leaf] = ()
    absent: Sequence[str] = ()
    losses: Sequence[str] = ()


def write_site(results: Path, out: Path) -> Site:
    """Write every page that is stored under a results folder."""
    sources = {path.parent.name: path for path in _sources(results, out)}
    leaves = [Leaf(name, _title(path)) for name, path in sorted(sources.items())]
    for leaf in leaves:
        _write_leaf(sources[leaf.name], out / leaf.name, leaves)
    absent = [f"glambda {told}" for name, told in COMMANDS.items() if name not in sources]
    races = [sources[name].parent for name in sorted(sources) if name.startswith("race")]
    return Site(leaves, absent, [said for race in races for said in race_losses(race)])


def _sources(results: Path, out: Path) -> list[Path]:
    """The page in Markdown of each folder; one that holds a report is a study of its own."""
    found = []
    for folder in sorted(path for path in results.iterdir() if path.is_dir()):
        pages = sorted(folder.glob("*.md"))
        if pages and folder.resolve() != out.resolve() and not (folder / "findings.md").exists():
            found.append(pages[0])
    return found


def _title(page: Path) -> str:
    """The first heading."""
    lines = page.read_text(encoding="utf-8").splitlines()
    return next((line[2:].strip() for line in lines if line.startswith("# ")), page.stem)


def _write_leaf(source: Path, folder: Path, leaves: Sequence[Leaf]) -> Path:
    """Copy the files of a page and write it as HTML beside them."""
    folder.mkdir(parents=True, exist_ok=True)
    for path in source.parent.iterdir():
        if path.suffix in KINDS and path.resolve() != (folder / path.name).resolve():
            shutil.copyfile(path, folder / path.name)
    environment = environment_of()
    page = environment.get_template("leaf.html.j2").render(
        title=_title(source),
        name=folder.name,
        leaves=leaves,
        body=body_of(source.read_text(encoding="utf-8")),
        **inlined(environment, style=["page.css"], script=["page.js"]),
    )
    return write_text(folder / "index.html", page + "\n")


def body_of(text: str) -> Markup:
    """Markdown as HTML: tables scroll by themselves, and HTML in it is only text."""
    from markdown_it import MarkdownIt

    parser = MarkdownIt("commonmark", {"html": False}).enable("table")
    parser.add_render_rule("table_open", _table_open)
    parser.add_render_rule("table_close", _table_close)
    return Markup(parser.render(text))


def _table_open(*_: Any) -> str:
    return '<div class="scroll"><table>\n'


def _table_close(*_: Any) -> str:
    return "</table></div>\n"
