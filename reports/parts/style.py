"""How the figures look, and how they are written so that the same results give the same bytes.

Colours are those of Okabe and Ito (2008), which readers with any common colour vision can tell
apart; no figure relies on colour alone.  In SVG, ink and paper are two rare greys that a page
replaces by its own colours, so that one file serves a light and a dark page.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from io import BytesIO
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

RAISED = str.maketrans("-.0123456789", "⁻·⁰¹²³⁴⁵⁶⁷⁸⁹")
"""Digits of an exponent."""

DPI = 160
"""Dots per inch of a PNG."""

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
    "text.parse_math": False,  # a $ in a name is a $
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


BOTH = ".svg+png"
"""The suffix of a path that stands for two files."""


def save(figure: Figure, path: Path) -> Path:
    """Write a figure as SVG, PNG or PDF, by the suffix of `path`, or as `BOTH`; without any date.

    A PNG has a palette of 256 colours, which these figures of few need, and under half the bytes.
    """
    if path.suffix == BOTH:
        for suffix in BOTH[1:].split("+"):
            save(figure, path.with_suffix(f".{suffix}"))
        return path
    path.parent.mkdir(parents=True, exist_ok=True)
    _plain_powers(figure)
    if path.suffix == ".png":
        _save_painted(figure, path)
        return path
    undated: dict[str, dict[str, Any]] = {
        ".svg": {"metadata": {"Date": None}},
        ".pdf": {"metadata": {"CreationDate": None}, "facecolor": PAPER},
    }
    figure.savefig(path, dpi=DPI, **undated.get(path.suffix, {"facecolor": PAPER}))
    return path


def _plain_powers(figure: Figure) -> None:
    """Write the powers of logarithmic axes in letters, since no text is read as mathematics."""
    from matplotlib.ticker import Formatter, LogFormatterMathtext

    class Powers(Formatter):
        """What another formatter writes, in letters."""

        def __init__(self, inner: LogFormatterMathtext) -> None:
            self.inner = inner

        def set_axis(self, axis: Any) -> None:
            super().set_axis(axis)
            self.inner.set_axis(axis)

        def set_locs(self, locs: Any) -> None:
            self.inner.set_locs(locs)

        def __call__(self, x: float, pos: int | None = None) -> str:
            return in_letters(self.inner(x, pos))

    for axis in (axis for axes in figure.axes for axis in (axes.xaxis, axes.yaxis)):
        for ticker in (axis.major, axis.minor):
            if isinstance(ticker.formatter, LogFormatterMathtext):
                ticker.formatter = Powers(ticker.formatter)
                ticker.formatter.set_axis(axis)


def in_letters(power: str) -> str:
    r"""10⁻³ for "$\mathdefault{10^{-3}}$", as Matplotlib writes powers."""
    text = re.sub(r"^\$\\mathdefault\{(.*)\}\$$", r"\1", power).replace(r"\times", "×")
    return re.sub(r"\^\{([-.\d]+)\}", lambda exponent: exponent[1].translate(RAISED), text)


def draw_files(draw: Callable[[Path], Any], stem: Path) -> None:
    """Draw a figure into `stem`.svg and `stem`.png; `draw` hands the path on to `save`."""
    draw(stem.with_name(stem.name + BOTH))


def _save_painted(figure: Figure, path: Path) -> None:
    from PIL import Image

    painted = BytesIO()
    figure.savefig(painted, format="png", dpi=DPI, facecolor=PAPER)
    with Image.open(painted) as image:
        palette = image.convert("RGB").quantize(256, dither=Image.Dither.NONE)
        palette.save(path, optimize=True, dpi=(DPI, DPI))
