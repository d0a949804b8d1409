"""How the figures look, and how they are written so that the same results give the same bytes.

Colours are those of Okabe and Ito (2008), which readers with any common colour vision can tell
apart; no figure relies on colour alone.  In SVG, ink and paper are two rare greys that a page
replaces by its own colours, so that one file serves a light and a dark page.
"""

from __future__ import annotations

import base64
import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from matplotlib.figure import Figure

INK, SOFT, FAINT, PAPER = "#1b1c1e", "#6b6e73", "#c9ccd1", "#fdfdfc"
"""Lines and text; what stands back; grid lines; the background."""

ORANGE, SKY, GREEN, YELLOW = "#e69f00", "#56b4e9", "#009e73", "#f0e442"
BLUE, VERMILLION, PURPLE = "#0072b2", "#d55e00", "#cc79a7"

BODIES = (SKY, ORANGE, GREEN, PURPLE, YELLOW, BLUE, VERMILLION)
"""Fill of body 1, 2, …, repeated."""

COLD, WARM = BLUE, VERMILLION
"""Colours of the two arms."""

PAGE_WIDTH = 7.6
"""Width of every figure [in]."""

_SETTINGS: dict[str, Any] = {
    "figure.facecolor": "none",
    "savefig.facecolor": "none",
    "axes.facecolor": "none",
    "axes.edgecolor": SOFT,
    "axes.labelcolor": INK,
    "axes.linewidth": 0.7,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.titlesize": 9.5,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "axes.titlecolor": INK,
    "axes.labelsize": 8.5,
    "axes.axisbelow": True,
    "text.color": INK,
    "xtick.color": INK,
    "ytick.color": INK,
    "xtick.labelsize": 8,
    "ytick.labelsize": 8,
    "xtick.major.width": 0.7,
    "ytick.major.width": 0.7,
    "xtick.minor.width": 0.4,
    "ytick.minor.width": 0.4,
    "grid.color": FAINT,
    "grid.linewidth": 0.5,
    "font.family": "DejaVu Sans",
    "font.size": 8.5,
    "legend.frameon": False,
    "legend.fontsize": 8,
    "hatch.linewidth": 0.6,
    "svg.fonttype": "path",
    "svg.hashsalt": "glambda",
    "path.simplify": True,
}


@contextmanager
def drawing() -> Iterator[type[Figure]]:
    """Yield the class `Figure` with the project's style in force; the caller's is left alone.

    Figures made from the class itself need no display and leave no trace in pyplot.
    """
    import matplotlib.style
    from matplotlib.figure import Figure

    with matplotlib.style.context(["default", _SETTINGS]):
        yield Figure


def save(figure: Figure, path: Path) -> Path:
    """Write a figure as SVG, PNG or PDF, by the suffix of `path`, without any date."""
    metadata: dict[str, Any] = {"Date": None} if path.suffix == ".svg" else {}
    if path.suffix == ".png":
        metadata = {"Software": None}
    if path.suffix == ".pdf":
        metadata = {"CreationDate": None}
    opaque: dict[str, Any] = {} if path.suffix == ".svg" else {"facecolor": PAPER}
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, metadata=metadata, dpi=160, **opaque)
    return path


LARGEST_SVG = 200_000
"""A figure of more bytes than this stands in the page as PNG."""


def inline_figure(stem: Path, description: str) -> str:
    """The figure `stem`.svg, or `stem`.png where that is much smaller, ready to stand in a page.

    description : what a reader who cannot see the figure is told
    """
    label = description.replace("&", "&amp;").replace('"', "&quot;").replace("<", "&lt;")
    drawn, painted = stem.with_name(f"{stem.name}.svg"), stem.with_name(f"{stem.name}.png")
    if drawn.stat().st_size <= LARGEST_SVG:
        return _inline_svg(drawn, label)
    data = base64.b64encode(painted.read_bytes()).decode("ascii")
    return f'<img alt="{label}" src="data:image/png;base64,{data}">'


def _inline_svg(path: Path, label: str) -> str:
    """The SVG for a page that defines --ink, --soft, --faint, --paper."""
    text = path.read_text(encoding="utf-8")
    text = text[text.index("<svg") :]
    text = re.sub(r"<metadata>.*?</metadata>\s*", "", text, flags=re.DOTALL)
    text = re.sub(r' xmlns(:\w+)?="[^"]*"', "", text)
    text = re.sub(r'(<svg[^>]*?) width="[^"]*"', r"\1", text, count=1)
    text = re.sub(r'(<svg[^>]*?) height="[^"]*"', r"\1", text, count=1)
    # Parts of several figures share one page, so their names must differ.
    stem = re.sub(r"\W", "_", path.stem)
    text = re.sub(r'\bid="([^"]+)"', rf'id="{stem}-\1"', text)
    text = re.sub(r'href="#([^"]+)"', rf'href="#{stem}-\1"', text)
    text = re.sub(r"url\(#([^)]+)\)", rf"url(#{stem}-\1)", text)
    text = text.replace("xlink:href", "href")
    names = {INK: "--ink", SOFT: "--soft", FAINT: "--faint", PAPER: "--paper"}
    for colour, name in names.items():
        text = text.replace(colour, f"var({name})")
    return text.replace("<svg", f'<svg role="img" aria-label="{label}"', 1)
